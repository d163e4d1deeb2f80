"""The sliding variable and its rate, from the plant's statement: [Park2008] (33), (35)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import sympy as sp

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.sources import cite
from railslip_ctrl.model import plant

from .identities import identical, linear_solution
from .steps import Step, step
from .symbols import sliding_symbol

Reference = Literal["proportional", "constant"]
"""sigma_d = lambda_d v, or sigma_d constant."""

s, e, e_integral, rho = (sliding_symbol(name) for name in ("s", "e", "e_integral", "rho"))
lambda_d, sigma_d = sliding_symbol("lambda_d"), sliding_symbol("sigma_d")
_SIGMA_RATE = sliding_symbol("sigma_rate")


@dataclass(frozen=True)
class Surface:
    """The sliding variable.

    Attributes
    ----------
    definition : Expr
        s in `e` and `e_integral`, (33).
    error : Expr
        e in v and sigma.
    reference_rate : Expr
        sigma_d': lambda_d v_rate, with the measured or estimated v', or 0.
    rate : Expr
        s' in (Ta, Tr, Fr, Tb, Td, omega, v_rate, e) and the parameters, (35).
    disturbance : Expr
        What Tr, Fr and Td, which no law knows, add to s': a part of `rate`.
    steps : tuple of Step
    """

    definition: sp.Expr
    error: sp.Expr
    reference_rate: sp.Expr
    rate: sp.Expr
    disturbance: sp.Expr
    steps: tuple[Step, ...]


UNCERTAIN = {plant.Tr: 0, plant.Fr: 0, plant.Td: 0}
"""What is dropped where the source says "uncertainties are neglected" (p. 53)."""


def derive_surface(reference: Reference) -> Surface:
    """s and s' for a reference; InputError for another word."""
    if reference not in get_args(Reference):
        raise InputError(f"reference: {reference!r} is not known; choose one of {', '.join(get_args(Reference))}")
    plant_step, train, wheel = _accelerations()
    slip_step, sigma_rate = _slip_rate(train, wheel)
    error, error_rate, definition, surface_step, rate_form = _differentiated(reference)
    rate = sp.expand(rate_form.subs(_SIGMA_RATE, sigma_rate))
    reference_rate = sp.expand(error_rate + _SIGMA_RATE)
    rate_step = step(
        "rate of s",
        (sliding_symbol("s_rate"), grouped_rate(rate)),
        statement="The rate of the sliding variable with the plant in it. Fr is the travelling resistance of (4).",
        done="sigma' of the plant put into the differentiated surface.",
        source=cite("Park2008", "(35)"),
        holds=(_rate_is_the_plant_s(reference, error, rate, train),),
        check="equal to s' of the plant as it is linearised and simulated, proved and at random points",
    )
    return Surface(
        definition=definition,
        error=error,
        reference_rate=reference_rate,
        rate=grouped_rate(rate),
        disturbance=grouped_rate(sp.expand(rate - rate.subs(UNCERTAIN))),
        steps=(plant_step, slip_step, surface_step, rate_step),
    )


def _accelerations() -> tuple[Step, sp.Expr, sp.Expr]:
    """v' and omega' in Ta, Fr, omega from the statement, and the step that shows them."""
    force = linear_solution(plant.ADHESION_TORQUE, plant.Fa)
    train = sp.expand(linear_solution(plant.TRAIN.subs(plant.Fa, force), plant.v_rate))
    wheel = sp.expand(linear_solution(plant.WHEEL, plant.omega_rate))
    v, omega, r, M, J = plant.v, plant.omega, plant.r, plant.M, plant.J
    # kinetic energy can leave only by slip, resistance, brake and bearing: fails for a wrong sign in (3) or (4)
    power = M * v * train + J * omega * wheel
    slip_velocity = v - r * omega
    losses = (plant.Ta + plant.Tr) / r * slip_velocity + plant.Fr * v + (plant.Tb + plant.Td + plant.B * omega) * omega
    residual = sp.Matrix([plant.WHEEL.lhs - plant.WHEEL.rhs, plant.TRAIN.lhs - plant.TRAIN.rhs])
    solved = {plant.omega_rate: wheel, plant.v_rate: train, plant.Fa: force}
    made = step(
        "accelerations",
        (sp.Matrix([plant.v_rate, plant.omega_rate]), sp.Matrix([train, wheel])),
        statement="Equations of motion of the quarter car, the random adhesion torque Tr in both.",
        done="(3) and (4) solved for the accelerations, Fa = Ta/r.",
        source=cite("Park2008", "(3), (4)"),
        holds=(
            *(identical(row.subs(solved), sp.Integer(0)) for row in residual),
            identical(power, -losses),
        ),
        check="residuals of (3) and (4) vanish; M v v' + J omega omega' = -(power lost in slip, resistance, brake)",
    )
    return made, train, wheel


def _slip_rate(train: sp.Expr, wheel: sp.Expr) -> tuple[Step, sp.Expr]:
    """sigma' with v' kept apart, so that a measured v' may stand for it."""
    definition = plant.SLIP_VELOCITY.rhs
    rate = sp.expand(sp.diff(definition, plant.v) * train + sp.diff(definition, plant.omega) * wheel)
    made = step(
        "slip acceleration",
        (_SIGMA_RATE, rate),
        statement="The rate of the slip velocity.",
        done="sigma = v - r omega differentiated, the accelerations put in.",
        source=cite("Park2008", "(2), (3), (4)"),
        holds=(identical(_in_plant_variables(rate), plant.motion().sigma_rate),),
        check="equal to sigma' of the plant statement, proved and at random points",
    )
    return made, rate


def _differentiated(reference: Reference) -> tuple[sp.Expr, sp.Expr, sp.Expr, Step, sp.Expr]:
    """(e, e', s, the step, s') by differentiating (33) along time; s' in sigma', v' and e."""
    t, x = sp.symbols("t x", real=True)
    v_t, sigma_t = sp.Function("v")(t), sp.Function("sigma")(t)
    at_reference = linear_solution(plant.SLIP_RATIO.subs(plant.slip, lambda_d), plant.sigma).subs(plant.v, v_t)
    reference_t = at_reference if reference == "proportional" else sigma_d
    error_t = reference_t - sigma_t
    surface_t = error_t + rho * sp.Integral(error_t.subs(t, x), (x, 0, t))
    names = {v_t.diff(t): plant.v_rate, sigma_t.diff(t): _SIGMA_RATE}
    error_rate = error_t.diff(t).subs(names)
    surface_rate = sp.expand(surface_t.diff(t).subs(names))
    # the derivative of the integral is the error itself
    integral_rate = surface_rate.coeff(rho)
    rate_form = surface_rate - sp.expand(rho * integral_rate) + rho * e
    error = error_t.subs({v_t: plant.v, sigma_t: plant.sigma})
    made = step(
        "sliding variable",
        (s, e + rho * e_integral),
        statement=f"s = e + rho times the integral of e, with e = {error}; then s' = e' + rho e.",
        done=f"The error of the {reference} reference, e' = {error_rate}; (33) differentiated along time.",
        source=cite("Park2008", "(33)"),
        holds=(identical(integral_rate.subs({v_t: plant.v, sigma_t: plant.sigma}), error),),
        check="the integral's rate is e; the coefficient of rho in s' was compared with e",
    )
    return error, error_rate, e + rho * e_integral, made, rate_form


def _in_plant_variables(expression: sp.Expr) -> sp.Expr:
    """Ta, Fr and omega replaced by Fa, the resistance's formula and (v - sigma)/r, as `plant.motion` has them."""
    wheel_speed = linear_solution(plant.SLIP_VELOCITY, plant.omega)
    return expression.subs(
        {
            plant.Ta: plant.ADHESION_TORQUE.rhs,
            plant.Fr: plant.RESISTANCE.rhs,
            plant.omega: wheel_speed,
        }
    )


def _rate_is_the_plant_s(reference: Reference, error: sp.Expr, rate: sp.Expr, train: sp.Expr) -> bool:
    motion = plant.motion()
    slope = sp.diff(error, plant.v) * motion.v_rate + sp.diff(error, plant.sigma) * motion.sigma_rate
    expected = slope + rho * error
    derived = _in_plant_variables(rate.subs({plant.v_rate: train, e: error}))
    return identical(derived, expected)


def grouped_rate(rate: sp.Expr) -> sp.Expr:
    """The terms of s' by what they multiply, as the source writes them."""
    return sp.collect(rate, (plant.Ta, plant.Tr, plant.omega, plant.Tb, plant.Td))
