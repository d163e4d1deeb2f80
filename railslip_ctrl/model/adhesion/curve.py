"""Bristle curve, static: force of the bristle model while the slip rises at a constant rate ([Park2008] Fig. 17)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.units import KMH, quantity
from railslip_ctrl.model.vehicle import Rail

from .base import AdhesionLaw, Statement, check_published_range
from .bristle import REFERENCE, published_coefficients

SLIP_ACCELERATION = 2.93  #: R of the ramp, m/s^2 (10.55 km/h/s): the value that gives the published peak at 100 km/h


class Curve(AdhesionLaw):
    """Bristle curve Fa = F(lambda): dF/ds = alpha (1 - h F) s/R, F(0) = 0, h = beta/(gamma - s), s = lambda v0.

    It is the force of the bristle model while the slip velocity s rises at the constant rate R. F is odd and valid for
    |lambda| v0 < gamma.
    """

    name: ClassVar[str] = "curve"
    title: ClassVar[str] = "bristle curve, static"
    source: ClassVar[str] = "[Park2008] (19)-(24), Fig. 17"
    has_state: ClassVar[bool] = False
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"beta": 2.0})

    alpha: float = quantity("N/m", "stiffness of the bristles", gt=0)
    beta: float = quantity("m/s/N", "inverse slope of 1/h, vs/(Fs - Fc)", gt=0)
    gamma: float = quantity("m/s", "slip velocity at which the adhesion vanishes, Fs vs/(Fs - Fc)", gt=0)
    R: float = quantity("m/s^2", "slip acceleration of the ramp", gt=0, default=SLIP_ACCELERATION)
    v0: float = quantity("m/s", "initial speed; on the ramp the slip velocity is the slip ratio times v0", gt=0)

    @classmethod
    def published(cls, rail: Rail, initial_speed_kmh: float, wheel_load: float) -> Self:
        check_published_range(initial_speed_kmh, wheel_load)
        alpha, beta, gamma = published_coefficients(initial_speed_kmh, wheel_load)
        law = cls(alpha=alpha, beta=beta, gamma=gamma, v0=initial_speed_kmh * KMH, reference=REFERENCE)
        return law.on(rail)

    def domain_limit(self, v: float) -> tuple[float, str]:
        return self.gamma / self.v0, "the slip velocity on the ramp reaches gamma, at which the adhesion vanishes"

    @classmethod
    def statement(cls) -> Statement:
        from railslip_ctrl.core.notation import symbol

        curve = _curve_function()
        return Statement(
            force=curve(symbol("sigma") / symbol("v"), *cls.symbols()),
            functions={"BristleCurve": f"{__name__}:curve_force"},
        )


def _curve_function() -> Any:
    import sympy as sp
    from sympy.core.function import ArgumentIndexError

    class BristleCurve(sp.Function):  # type: ignore[misc]
        nargs = 6
        is_real = True

        def fdiff(self, argindex: int = 1) -> Any:
            if argindex != 1:
                raise ArgumentIndexError(self, argindex)
            slip, alpha, beta, gamma, R, v0 = self.args
            s = v0 * sp.Abs(slip)  # F is odd, so dF/dlambda is even
            return v0 * alpha * (1 - beta * sp.Abs(self) / (gamma - s)) * s / R

    return BristleCurve


_DEPTH = 37.0  # the integral begins where the exponential is exp(-37), less than the rounding of the result
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)  # relative error 2e-13 for all parameters
_NEWTON_STEPS = 8  # enough for every start of the integration
_BLOCK = 256  # slip ratios computed at once; without blocks, which fit the cache, a table takes four times as long

# Between two close slip velocities 5 nodes have an error below 2e-13 under three conditions: Phi grows by at most
# _STEP, the change of its slope times the gap is at most _BEND, and gamma is at least _GAPS gaps away.
_STEP, _BEND, _GAPS = 0.4, 0.05, 10.0
_FEW_NODES, _FEW_WEIGHTS = np.polynomial.legendre.leggauss(5)


def curve_force(slip: ArrayLike, alpha: float, beta: float, gamma: float, R: float, v0: float) -> Floats | np.float64:
    """Force of the bristle curve, N, at slip ratios of any shape, accurate to 2e-13; NaN where |slip| v0 >= gamma.

    F(s) = (alpha/R) int_0^s t exp(Phi(t) - Phi(s)) dt with Phi' = (alpha beta/R) s/(gamma - s), by Gauss-Legendre
    quadrature.
    """
    lam = np.asarray(slip, dtype=float)
    s = np.abs(lam) * v0
    s = np.where(s < gamma, s, np.nan)
    c = alpha * beta / R
    flat = s.reshape(-1)
    near = _close_together(flat, c, gamma)
    integral = np.concatenate([_in_steps(flat[:near], c, gamma), _each_alone(flat[near:], c, gamma)])
    force = np.sign(lam) * (alpha / R) * integral.reshape(s.shape)
    return force[()]  # type: ignore[no-any-return]


def _each_alone(s: Floats, c: float, gamma: float) -> Floats:
    room = gamma - s
    half = 0.5 * np.log((gamma - _start_of_integration(s, c, gamma)) / room)
    integrals = np.empty(s.size)
    for first in range(0, s.size, _BLOCK):
        part = slice(first, first + _BLOCK)
        grown = half[part, None] * (1.0 - _NODES)  # ln((gamma - t)/(gamma - s))
        back = room[part, None] * np.expm1(grown)  # s - t
        value = (s[part, None] - back) * np.exp(grown - c * (gamma * grown - back))
        integrals[part] = value @ _WEIGHTS
    return np.asarray(half * room * integrals)


def _close_together(s: Floats, c: float, gamma: float) -> int:
    """Number of leading elements of `s` with gaps that are small enough for `_in_steps`."""
    if s.size < 2 or s[0] != 0:
        return 0
    gap = np.diff(s)
    with np.errstate(invalid="ignore"):
        short = (gap >= 0) & (gap <= (gamma - s[1:]) / _GAPS)
        short &= c * gamma * (gap / (gamma - s[1:])) ** 2 <= _BEND
        short &= _phi_difference(s[1:], gap, c, gamma) <= _STEP
    return 1 + int(short.size if short.all() else short.argmin())


def _in_steps(s: Floats, c: float, gamma: float) -> Floats:
    """Integrals up to each slip velocity in `s`, each computed from the integral up to the previous one."""
    if s.size < 2:
        return np.zeros(s.size)
    gap, end = np.diff(s), s[1:]
    back = 0.5 * gap * (1.0 - _FEW_NODES[:, None])
    own = 0.5 * gap * (_FEW_WEIGHTS @ ((end - back) * np.exp(-_phi_difference(end, back, c, gamma))))
    left = np.exp(-_phi_difference(end, gap, c, gamma))
    steps = zip(left.tolist(), own.tolist(), strict=True)
    return np.array(list(accumulate(steps, lambda total, step: step[0] * total + step[1], initial=0.0)))


def _phi_difference(s: Floats, back: Floats, c: float, gamma: float) -> Floats:
    """Phi(s) - Phi(s - back), without cancellation."""
    result: Floats = c * (gamma * np.log1p(back / (gamma - s)) - back)
    return result


def _start_of_integration(s: Floats, c: float, gamma: float) -> Floats:
    """Slip velocity t < s with Phi(s) - Phi(t) = _DEPTH, by Newton's method; 0 if there is none."""
    found, deep = np.zeros(s.shape), _phi_difference(s, s, c, gamma) > _DEPTH
    end = start = s[deep]
    for _ in range(_NEWTON_STEPS):
        missing = _DEPTH - _phi_difference(end, end - start, c, gamma)
        start = start - missing * (gamma - start) / (c * start)
    found[deep] = np.maximum(start, 0.0)
    return found
