"""The brake actuator in numbers, from the plant's statement: transfer function and state equation, checked to agree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.loop import Rational
from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import Actuator

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Complexes = NDArray[np.complex128]


@dataclass(frozen=True)
class _Actuation:
    """Functions made of the statement.

    response(s, tau, T): Ga; numerator(T), denominator(T): its coefficients in s without the dead time, highest first;
    delay(tau, T): the dead time.
    """

    response: Callable[..., Any]
    numerator: Callable[..., Any]
    denominator: Callable[..., Any]
    delay: Callable[..., Any]


def actuator_response(actuator: Actuator, s: Complexes) -> Complexes:
    """Ga(s), commanded to acting torque, at complex s (1/s), any shape."""
    return np.asarray(_actuation().response(s, actuator.dead_time, actuator.lag))


def actuator_lag(actuator: Actuator) -> Rational:
    """Ga without its dead time."""
    return _lag(actuator.lag)


@cache
def _lag(lag: float) -> Rational:
    made = _actuation()
    numerator, denominator = (
        np.trim_zeros(np.atleast_1d(np.asarray(f(lag), dtype=float)), "f") for f in (made.numerator, made.denominator)
    )
    return Rational.from_polynomials(numerator, denominator)


def actuator_dead_time(actuator: Actuator) -> float:
    """Dead time of Ga, s."""
    return float(_actuation().delay(actuator.dead_time, actuator.lag))


@cache
def _actuation() -> _Actuation:
    """DomainError where transfer function and state equation of the statement are not the same actuator."""
    s, tau, T, Tc = (symbol(name) for name in ("s", "tau", "T", "Tc"))
    transfer, rate = plant.actuator_transfer(), plant.actuator_lag_rate()
    rational, exponential = transfer.as_independent(sp.exp, as_Add=False)
    delay = sp.simplify(-sp.diff(sp.log(exponential), s))
    of_state = sp.solve(sp.Eq(s * plant.Tb, rate), plant.Tb)[0] / Tc
    if sp.simplify(rational - of_state) != 0 or not delay.is_positive or delay.has(s):
        raise DomainError(
            f"actuator: transfer function {transfer} and state equation Tb' = {rate} of the plant's statement do not "
            "describe one actuator with a dead time; mend the statement"
        )
    numerator, denominator = (sp.Poly(part, s).all_coeffs() for part in sp.fraction(sp.together(rational)))
    return _Actuation(
        response=sp.lambdify((s, tau, T), transfer, "numpy"),
        numerator=sp.lambdify(T, numerator, "numpy"),
        denominator=sp.lambdify(T, denominator, "numpy"),
        delay=sp.lambdify((tau, T), delay, "numpy"),
    )
