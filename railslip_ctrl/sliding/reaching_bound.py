"""The reaching condition (40) as a bound on K, and the set of disturbances it is asked over.

All in torque at the wheel: (J/r) d with d, m/s^2, what the disturbances add to s'. Neither M, J nor the disturbances
alone set it, only J/M does: the bound is the same in SI and in the as-published reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cache

import sympy as sp

from railslip_ctrl import plant
from railslip_ctrl.adhesion import published_law
from railslip_ctrl.errors import InputError
from railslip_ctrl.numeric import numeric_plant, plant_parameters
from railslip_ctrl.parameters import INITIAL_SPEED_KMH, Rail, Vehicle
from railslip_ctrl.units import KMH

from .derivation import derive

ADHESION_NOISE = 431.0
"""Standard deviation of the random adhesion force, N ([Park2008] p. 55)."""

TORQUE_FRACTION = 0.05
"""Td = 0.05 Tb exp(-4t) sin(10 pi t): its bound as a fraction of the acting brake torque ([Park2008] p. 55)."""

TORQUE_DECAY, TORQUE_FREQUENCY = 4.0, 10.0 * math.pi
"""Its decay, 1/s, and frequency, rad/s."""


@dataclass(frozen=True)
class DisturbanceBounds:
    """|Tr| <= random_torque, 0 <= Fr <= resistance, |Td| <= disturbance_torque: N*m, N, N*m.

    InputError for a bound that is negative or not finite.
    """

    random_torque: float
    resistance: float
    disturbance_torque: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"{field.name}: {value:g} is not allowed; give a finite bound >= 0")


def published_bounds(vehicle: Vehicle, *, sigmas: float, with_torque: bool = True) -> DisturbanceBounds:
    """The published run's, at 100 km/h on dry rail, the random force at `sigmas` standard deviations.

    Td is bounded by 0.05 of the torque that holds the reference slip there; `with_torque=False` leaves it out, as it
    has decayed by exp(-4) after one second.
    """
    speed = INITIAL_SPEED_KMH * KMH
    resistance = vehicle.resistance
    return DisturbanceBounds(
        random_torque=vehicle.wheel.radius * sigmas * ADHESION_NOISE,
        resistance=resistance.constant + resistance.linear * speed + resistance.quadratic * speed**2,
        disturbance_torque=TORQUE_FRACTION * holding_torque(vehicle, speed) if with_torque else 0.0,
    )


def holding_torque(vehicle: Vehicle, speed: float) -> float:
    """Brake torque, N*m, that holds the published reference slip on dry rail at a speed, m/s."""
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    slip = law.reference_slip(Rail.DRY)
    assert slip is not None, "the bristle model has a published reference"
    functions, p = numeric_plant(type(law)), plant_parameters(law, vehicle)
    sigma = slip * speed
    z = functions.rest_state(speed, sigma, 0.0, 0.0, 0.0, 0.0, p)
    return float(functions.trim_torque(speed, sigma, z, 0.0, 0.0, 0.0, p))


@cache
def torque_coefficients() -> tuple[sp.Expr, sp.Expr, sp.Expr]:
    """(J/r) d is linear in Tr, Fr and Td; its coefficients, in r, J, M. [Park2008] (40)."""
    torque = sp.expand(derive().disturbance * plant.J / plant.r)
    coefficients = tuple(sp.factor(sp.diff(torque, x)) for x in (plant.Tr, plant.Fr, plant.Td))
    rest = torque - sum(c * x for c, x in zip(coefficients, (plant.Tr, plant.Fr, plant.Td), strict=True))
    if sp.expand(rest) != 0 or any(c.has(plant.Tr, plant.Fr, plant.Td) for c in coefficients):
        raise ArithmeticError("the disturbance is not linear in Tr, Fr and Td; the plant has been changed")
    return coefficients


def largest_disturbance(vehicle: Vehicle, bounds: DisturbanceBounds) -> float:
    """max (J/r)|d| over the box, N*m, at the vehicle's mass.

    d is linear, so the maximum of |d| is at a corner; Tr and Td have both signs, so it is the sum of the sizes.
    """
    values = {plant.M: vehicle.effective_mass, plant.J: vehicle.effective_inertia, plant.r: vehicle.wheel.radius}
    sizes = [abs(float(c.subs(values))) for c in torque_coefficients()]
    extent = (bounds.random_torque, bounds.resistance, bounds.disturbance_torque)
    return sum(size * x for size, x in zip(sizes, extent, strict=True))


def least_gain(
    vehicle: Vehicle, bounds: DisturbanceBounds, *, D: float = 0.0, surface: float = 0.0, eta: float = 0.0
) -> float:
    """K_min, N*m: (40) holds for K above it. max (J/r)|d| - D |s| + (J/r) eta; never below 0.

    D in N*m/(m/s); `surface` is |s|, m/s, at which it is asked (0: down to the surface itself); eta in m/s^2.
    """
    asked = largest_disturbance(vehicle, bounds) - D * surface
    return max(0.0, asked + eta * vehicle.effective_inertia / vehicle.wheel.radius)


def reaching_time(vehicle: Vehicle, *, K: float, D: float, start: float) -> float:
    """Seconds until s = 0 from s = start (m/s) without disturbances: ln(1 + D |start|/K)/D0; inf for K = 0."""
    if K == 0.0:
        return math.inf
    return math.log1p(D * abs(start) / K) * vehicle.effective_inertia / (vehicle.wheel.radius * D)
