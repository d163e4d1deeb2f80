"""What else the plant states, checked by what it must do: slip ratio, travelling resistance, actuator."""

from __future__ import annotations

import sympy as sp

from railslip_ctrl.core.notation import symbol
from railslip_ctrl.core.sources import cite
from railslip_ctrl.model import plant

from .identities import identical, vanishes
from .steps import Step, step
from .symbols import sliding_symbol


def statement_steps() -> tuple[Step, ...]:
    """The steps, one an equation."""
    return _slip_ratio(), _resistance(), _actuator()


def _slip_ratio() -> Step:
    ratio = plant.SLIP_RATIO.rhs.subs(plant.sigma, plant.SLIP_VELOCITY.rhs)
    rolling = ratio.subs(plant.omega, plant.v / plant.r)
    return step(
        "slip ratio",
        (plant.slip, ratio),
        statement="The reference is a slip ratio: sigma_d is the slip velocity at which lambda = lambda_d.",
        done="sigma of the statement put into lambda.",
        source=cite("Park2008", "(2)"),
        holds=(rolling == 0, ratio.subs(plant.omega, 0) == 1, bool(sp.diff(ratio, plant.omega).is_negative)),
        check="0 for a rolling wheel, 1 for a locked one, growing as the wheel slows",
    )


def _resistance() -> Step:
    coefficients = (plant.Fr0, plant.Fr1, plant.Fr2)
    power = sp.expand(plant.v * plant.RESISTANCE.rhs)
    parts = [sp.diff(power, coefficient) for coefficient in coefficients]
    whole = sum(part * coefficient for part, coefficient in zip(parts, coefficients, strict=True))
    return step(
        "travelling resistance",
        (plant.Fr, plant.RESISTANCE.rhs),
        statement="Resistance of the train, its coefficients >= 0; the paper has the last alone.",
        done="Taken from the statement.",
        source=cite("Park2008", "(4), p. 55"),
        holds=(all(part.is_positive for part in parts), identical(power, whole)),
        check="each coefficient takes power from a moving train, and nothing else is in it",
    )


def _actuator() -> Step:
    s, tau, Tc = (symbol(name) for name in ("s", "tau", "Tc"))
    transfer, rate = plant.actuator_transfer(), plant.actuator_lag_rate()
    # the command after the dead time is exp(-tau s) of the command
    from_rate = sp.solve(sp.Eq(s * plant.Tb, rate), plant.Tb)[0].subs(Tc, sp.exp(-tau * s))
    poles = sp.solve(sp.denom(sp.together(from_rate)), s)
    return step(
        "actuator",
        (
            sp.Matrix([sliding_symbol("Ga"), sliding_symbol("Tb_rate")]),
            sp.Matrix([transfer, rate]),
        ),
        statement="Dead time and lag from commanded to acting torque (s: Laplace variable). The law leaves them out.",
        done="Transfer function and state equation taken from the statement; Tc is the command a dead time ago.",
        source=cite("Park2008", "p. 55"),
        holds=(
            vanishes(transfer - from_rate),
            transfer.subs(s, 0) == 1,
            len(poles) == 1 and bool(poles[0].is_negative),
        ),
        check="the state equation's Laplace transform is Ga; Ga(0) = 1, its pole is negative",
    )
