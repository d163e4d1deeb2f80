"""The reaching condition (40) as a bound on K, and the set it is asked over; in torque at the wheel, (J/r) d.

Td is a fraction q of the acting torque, which is the law's own: Tb = Ueq + D s + K sgn s, K in it. With |q| <= c < 1

    (J/r) s' sgn s = sgn s [(J/r) d(Tr, Fr) - q Ueq] - (1 + q)(D |s| + K),

so that (40) asks K > (sgn s [...] + (J/r) eta)/(1 + q) - D |s|: D |s| helps in full, and c/(1 - c) of |Ueq|, in it
(J/r) rho e, is added. That is affine in each of 1/M, Tr, Fr, Ta, v, slip, theta_hat1 and theta_hat2 alone, and
monotone in q, hence largest at a corner of a box of them: the bound is exact over the box, with the adhesion torque a
state of its own (as in the bristle model).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
import sympy as sp

from railslip_ctrl import plant
from railslip_ctrl.adhesion import published_law
from railslip_ctrl.errors import InputError
from railslip_ctrl.numeric import numeric_plant, plant_parameters
from railslip_ctrl.parameters import INITIAL_SPEED_KMH, Rail, Vehicle
from railslip_ctrl.units import KMH

from .derivation import derive
from .gains import PUBLISHED_LAW
from .symbols import sliding_symbol

ADHESION_NOISE = 431.0
"""Standard deviation of the random adhesion force, N ([Park2008] p. 55)."""

TORQUE_FRACTION = 0.05
"""Td = 0.05 Tb exp(-4t) sin(10 pi t): its bound as a fraction of the acting brake torque ([Park2008] p. 55)."""

TORQUE_DECAY, TORQUE_FREQUENCY = 4.0, 10.0 * math.pi
"""Its decay, 1/s, and frequency, rad/s."""

LOWEST_SPEED_KMH = 5.0
"""The published stop ends here ([Park2008] p. 56)."""

_VANISHING_SLIP = 1e-9  # the bristle curve at rest falls from its largest value at slip 0+, and is 0 at 0

Range = tuple[float, float]


@dataclass(frozen=True)
class ReachingSet:
    """The box over which (40) is asked. Ranges are (lowest, highest).

    Attributes
    ----------
    random_torque : float
        |Tr| <= random_torque, N*m.
    torque_fraction : float
        c: |Td| <= c |Tb|, 0 <= c < 1.
    resistance : pair
        Fr, N.
    adhesion_torque : pair
        Ta, N*m.
    speed, slip : pair
        m/s and 1: e = (lambda_d - slip) v, omega = (1 - slip) v/r.
    mass : pair
        True mass, kg, without the inertia scale.
    theta_hat1, theta_hat2 : pair
        Estimates in the law, 1/(kg m) and m/s.

    Raises
    ------
    InputError
        A value that is not finite, a range whose ends are in the wrong order, a negative bound or c >= 1.
    """

    random_torque: float
    torque_fraction: float
    resistance: Range
    adhesion_torque: Range
    speed: Range
    slip: Range
    mass: Range
    theta_hat1: Range = (0.0, 0.0)
    theta_hat2: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):
            value = getattr(self, name)
            low, high = value if isinstance(value, tuple) else (0.0, value)
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise InputError(f"{name}: {value} is not allowed; give finite bounds, the lowest first, sizes >= 0")
        if self.torque_fraction >= 1:
            raise InputError(f"torque_fraction: {self.torque_fraction:g} is not allowed; give a fraction below 1")

    def error(self, slip_d: float) -> Range:
        """Smallest and largest e, m/s, for the reference slip."""
        ends = [(slip_d - slip) * v for slip in self.slip for v in self.speed]
        return min(ends), max(ends)

    def text(self, slip_d: float) -> str:
        """The box in one line."""
        kmh, mass, Ta = ([f"{x:.5g}" for x in pair] for pair in (_in_kmh(self.speed), self.mass, self.adhesion_torque))
        e = [f"{x:.3g}" for x in self.error(slip_d)]
        return (
            f"v {_span(kmh)} km/h, slip {_span([f'{x:.4g}' for x in self.slip])} (e {_span(e)} m/s), Ta {_span(Ta)} "
            f"N m, M {_span(mass)} kg, |Tr| <= {self.random_torque:.4g} N m, |Td| <= {self.torque_fraction:g} |Tb|"
        )


def _in_kmh(speed: Range) -> Range:
    return speed[0] / KMH, speed[1] / KMH


def _span(ends: list[str]) -> str:
    return ends[0] if ends[0] == ends[1] else f"{ends[0]}..{ends[1]}"


def reference_set(vehicle: Vehicle, *, sigmas: float, with_torque: bool = True) -> ReachingSet:
    """The mildest point of the published run: 100 km/h, dry, at the reference slip, adhesion at rest, so e = 0.

    The random force at `sigmas` standard deviations; `with_torque=False` leaves Td out, as it has decayed by exp(-4)
    after one second.
    """
    slip, speed = reference_slip(), INITIAL_SPEED_KMH * KMH
    torque = rest_adhesion_torque(vehicle, speed, slip)
    return ReachingSet(
        random_torque=vehicle.wheel.radius * sigmas * ADHESION_NOISE,
        torque_fraction=TORQUE_FRACTION if with_torque else 0.0,
        resistance=(0.0, resistance_force(vehicle, speed)),
        adhesion_torque=(torque, torque),
        speed=(speed, speed),
        slip=(slip, slip),
        mass=(vehicle.mass, vehicle.mass),
    )


def operating_set(vehicle: Vehicle, *, sigmas: float, with_torque: bool = True) -> ReachingSet:
    """The published run on dry rail: 100 to 5 km/h, from free rolling to twice the reference slip, empty to loaded.

    The adhesion torque is anything from 0 (z = 0, as at the start) to its largest at rest, whatever the slip.
    """
    speed = INITIAL_SPEED_KMH * KMH
    return replace(
        reference_set(vehicle, sigmas=sigmas, with_torque=with_torque),
        adhesion_torque=(0.0, rest_adhesion_torque(vehicle, speed, _VANISHING_SLIP)),
        speed=(LOWEST_SPEED_KMH * KMH, speed),
        slip=(0.0, 2.0 * reference_slip()),
        mass=(vehicle.mass, vehicle.mass_loaded),
    )


def reference_slip() -> float:
    """The bristle column's on dry rail."""
    slip = published_law("bristle", Rail.DRY).reference_slip(Rail.DRY)
    assert slip is not None, "the bristle model has a published reference"
    return slip


def resistance_force(vehicle: Vehicle, speed: float) -> float:
    """Fr, N, at a speed, m/s."""
    resistance = vehicle.resistance
    return resistance.constant + resistance.linear * speed + resistance.quadratic * speed**2


def rest_adhesion_torque(vehicle: Vehicle, speed: float, slip: float) -> float:
    """Ta, N*m, of the bristle model at rest on dry rail at a speed, m/s, and a slip ratio."""
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    functions, p = numeric_plant(type(law)), plant_parameters(law, vehicle)
    z = functions.rest_state(speed, slip * speed, 0.0, 0.0, 0.0, 0.0, p)
    return vehicle.wheel.radius * float(functions.force(speed, slip * speed, z, 0.0, 0.0, 0.0, p))


def holding_torque(vehicle: Vehicle, speed: float) -> float:
    """Brake torque, N*m, that holds the published reference slip on dry rail at a speed, m/s."""
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    functions, p = numeric_plant(type(law)), plant_parameters(law, vehicle)
    sigma = reference_slip() * speed
    z = functions.rest_state(speed, sigma, 0.0, 0.0, 0.0, 0.0, p)
    return float(functions.trim_torque(speed, sigma, z, 0.0, 0.0, 0.0, p))


# --- the bound, derived ---------------------------------------------------------------------------------------------

_FRACTION = sp.Symbol("q", real=True)  # Td/Tb
_SIDE = sp.Symbol("side", real=True)  # sgn s, 1 or -1
_SIZE = sp.Symbol("s_size", nonnegative=True)
_ETA = sp.Symbol("eta", nonnegative=True)
_INVERSE_MASS = sp.Symbol("m_inverse", positive=True)
_SLIP = sp.Symbol("slip", real=True)
_s, _D, _K, _e, _lambda = (sliding_symbol(name) for name in ("s", "D", "K", "e", "lambda_d"))
_HATS = tuple(sliding_symbol(f"theta{i}_hat") for i in (1, 2))
_Mn, _Mp, _Bn, _rho = (sliding_symbol(name) for name in ("Mn", "Mp", "Bn", "rho"))

BOX_VARIABLES = (_INVERSE_MASS, plant.Tr, plant.Fr, plant.Ta, plant.v, _SLIP, *_HATS)
"""What the bound is affine in, one at a time."""

_PARAMETERS = (_SIDE, _FRACTION, _SIZE, _ETA, _D, _rho, _lambda, plant.J, plant.r, _Mn, _Bn)


@cache
def required_gain() -> sp.Expr:
    """K, N*m, at which s s' = -eta |s| under (45) with theta_hat = theta and Td = q Tb; in `BOX_VARIABLES` and side.

    ArithmeticError where it is not affine in each of them, as with another plant.
    """
    made = derive()
    known = dict.fromkeys((sliding_symbol("theta1_tilde"), sliding_symbol("theta2_tilde")), 0)
    rate = made.error_dynamics.subs(known).subs(plant.Td, _FRACTION * made.adaptive_law_control)
    sign = sp.Dummy("sgn", real=True)
    on_side = sp.expand(rate.subs(sp.sign(_s), sign).subs({_s: _SIDE * _SIZE, sign: _SIDE}))
    approach = sp.expand(_SIDE * on_side).subs(_SIDE**2, 1) + _ETA
    gain = -approach.subs(_K, 0) / sp.factor(sp.diff(approach, _K))  # it is linear in K
    train = sp.solve(plant.TRAIN.subs(plant.Fa, sp.solve(plant.ADHESION_TORQUE, plant.Fa)[0]), plant.v_rate)[0]
    gain = gain.subs(plant.v_rate, train.subs(plant.M, _Mn + _Mp)).subs(_Mp, 1 / _INVERSE_MASS - _Mn)
    wheel_speed = sp.solve(plant.SLIP_VELOCITY, plant.omega)[0].subs(plant.sigma, _SLIP * plant.v)
    gain = sp.factor(gain.subs({_e: (_lambda - _SLIP) * plant.v, plant.omega: wheel_speed}))
    if any(sp.diff(gain, x, 2) != 0 for x in BOX_VARIABLES) or not _monotone_in_fraction(gain):
        raise ArithmeticError("the bound on K is not affine in what it is asked over; the plant has been changed")
    return gain


def _monotone_in_fraction(gain: sp.Expr) -> bool:
    """Whether dK/dq has a numerator without q over a square: then K has no extremum inside -c < q < c."""
    return not sp.numer(sp.cancel(sp.diff(gain, _FRACTION))).has(_FRACTION)


@cache
def _required_function() -> Callable[..., Any]:
    made: Callable[..., Any] = sp.lambdify((*BOX_VARIABLES, *_PARAMETERS), required_gain(), "numpy", cse=True)
    return made


def least_gain(
    vehicle: Vehicle,
    box: ReachingSet,
    *,
    D: float = 0.0,
    surface: float = 0.0,
    eta: float = 0.0,
    rho: float = PUBLISHED_LAW.rho,
) -> float:
    """K_min, N*m: (40) holds over the box for every K above it, and below it fails at a corner; never below 0.

    D in N*m/(m/s); `surface` is |s|, m/s, from which on it is asked (0: down to the surface itself); eta in m/s^2; the
    law's nominal parameters are the vehicle's.
    """
    scale = vehicle.inertia_scale
    inverse = tuple(1.0 / (scale * mass) for mass in box.mass)
    random = (-box.random_torque, box.random_torque)
    axes = (inverse, random, box.resistance, box.adhesion_torque, box.speed, box.slip, box.theta_hat1, box.theta_hat2)
    fractions = (-box.torque_fraction, box.torque_fraction)
    corners = np.array(list(itertools.product(*axes, (-1.0, 1.0), fractions))).T
    parameters = (surface, eta, D, rho, reference_slip(), vehicle.effective_inertia, vehicle.wheel.radius)
    nominal = (vehicle.effective_mass, vehicle.effective_viscous_friction)
    return max(0.0, float(np.max(_required_function()(*corners, *parameters, *nominal))))


def surface_needed(vehicle: Vehicle, box: ReachingSet, *, K: float, D: float) -> float:
    """|s|, m/s, from which on D |s| makes up for a K (N*m) below `least_gain`; 0 where K suffices; D > 0."""
    return max(0.0, least_gain(vehicle, box) - K) / D


def reaching_time(vehicle: Vehicle, *, K: float, D: float, start: float) -> float:
    """Seconds until s = 0 from s = start (m/s) without disturbances: ln(1 + D |start|/K)/D0; inf for K = 0."""
    if K == 0.0:
        return math.inf
    return math.log1p(D * abs(start) / K) * vehicle.effective_inertia / (vehicle.wheel.radius * D)
