"""The SymPy statement of the plant against the equations it must imply."""

from __future__ import annotations

import pytest
import sympy as sp
from sample_laws import ALL_LAWS, DYNAMIC_LAWS

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.notation import NOTATION, latex_names, symbol
from railslip_ctrl.core.units import quantity
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import law_class
from railslip_ctrl.model.adhesion.dahl import Dahl

v, sigma, Fa, Tb, Td, Tr = (symbol(name) for name in ("v", "sigma", "Fa", "Tb", "Td", "Tr"))
M, J, B, r = (symbol(name) for name in ("M", "J", "B", "r"))
RESISTANCE = sum(symbol(f"Fr{power}") * v**power for power in range(3))


def test_sigma_rate_is_the_combination_of_3_and_4() -> None:
    """sigma' = -(1/M + r^2/J) Fa + (r/J)(Tb + Td + B omega) - Fr/M, plus Tr as it enters [Park2008] (35)."""
    omega = (v - sigma) / r
    expected = -(1 / M + r**2 / J) * Fa + r / J * (Tb + Td + B * omega) - RESISTANCE / M - (1 / (r * M) + r / J) * Tr
    assert sp.simplify(plant.motion().sigma_rate - expected) == 0


def test_energy_balance() -> None:
    """Invariant: d/dt (M v^2/2 + J omega^2/2) = -Fa sigma - Fr v - (Tb + Td + B omega) omega - Tr sigma/r."""
    omega = (v - sigma) / r
    motion = plant.motion()
    power = M * v * motion.v_rate + J * omega * motion.omega_rate
    losses = Fa * sigma + RESISTANCE * v + (Tb + Td + B * omega) * omega + Tr * sigma / r
    assert sp.simplify(power + losses) == 0


def test_trim_torque_stops_the_slip_ratio() -> None:
    assert sp.simplify(plant.motion().slip_rate.subs(Tb, plant.trim_torque())) == 0
    assert plant.trim_torque().has(symbol("Fr2"))  # travelling resistance is in it


@pytest.mark.parametrize("name", ALL_LAWS)
def test_closed_plant_has_only_known_symbols(name: str) -> None:
    law = law_class(name)
    closed = plant.close(law)
    known = {symbol(n) for n in (*plant.ARGUMENTS, *plant.VEHICLE_PARAMETERS)} | set(law.symbols())
    for expression in (closed.force, closed.rest_state, closed.trim_torque, *closed.rates):
        assert expression.free_symbols <= known


@pytest.mark.parametrize("name", DYNAMIC_LAWS)
def test_rest_state_is_at_rest(name: str) -> None:
    closed = plant.close(law_class(name))
    slip_velocity = sp.Symbol("sigma_p", positive=True)
    for sign in (1, -1):
        at_rest = closed.rates[2].subs(symbol("z"), closed.rest_state).subs(sigma, sign * slip_velocity)
        assert sp.simplify(at_rest) == 0


@pytest.mark.parametrize("name", [name for name in ALL_LAWS if name != "curve"])
def test_laws_are_odd(name: str) -> None:
    """Force and state rate change sign with sigma and z (the curve is a numeric function: tested in test_adhesion)."""
    closed = plant.close(law_class(name))
    slip_velocity = sp.Symbol("sigma_p", positive=True)
    z = symbol("z")
    for expression in (closed.force, closed.rates[2]):
        mirrored = expression.subs({sigma: -slip_velocity, z: -z}, simultaneous=True)
        assert sp.simplify(sp.piecewise_fold(mirrored + expression.subs(sigma, slip_velocity))) == 0


def test_actuator() -> None:
    """[Park2008] p. 55: the lag's state equation has Ga's rational part as its transfer function."""
    s, tau, Tc = (symbol(name) for name in ("s", "tau", "Tc"))
    lag = sp.solve(sp.Eq(s * Tb, plant.actuator_lag_rate()), Tb)[0] / Tc
    assert sp.simplify(lag * sp.exp(-tau * s) - plant.actuator_transfer()) == 0


def test_parameter_named_like_a_plant_symbol_is_refused() -> None:
    class Clash(Dahl):
        M: float = quantity("kg", "clashes with the mass", gt=0)

    with pytest.raises(InputError, match="'M' is the name of a plant symbol"):
        plant.close(Clash)


def test_notation_is_complete() -> None:
    assert set(plant.ARGUMENTS) | set(plant.VEHICLE_PARAMETERS) <= set(NOTATION)
    assert sp.latex(plant.WHEEL.lhs, symbol_names=latex_names()) == r"J \dot\omega"
