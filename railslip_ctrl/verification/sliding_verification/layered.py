"""The layered law with a lead on the actuator's lag, tuned for a vehicle and its adhesion, its bounds and runs at
frozen speed.

Gains: the PI of least worst Ms over the rails with the lead in the loop, as layer and rho (`switching.layered`).
Integral gain and disturbance grow with the inertia scale, which leaves the error that is guaranteed about as it is.
K only widens the layer, and costs nothing within it: it is what the bound asks, and what a holding torque that is
known to `HOLD_ERROR` asks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from railslip_ctrl.core.errors import InfeasibleDesignError
from railslip_ctrl.design import PIController, actuated_plant
from railslip_ctrl.design.tuning import tune_pi
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint, linearize
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import PARK2008, PIGains, Rail, Vehicle
from railslip_ctrl.verification.reaching_bound import ADHESION_NOISE, TORQUE_DECAY, TORQUE_FRACTION, TORQUE_FREQUENCY
from railslip_ctrl.verification.switching import (
    LayerBound,
    LayeredDesign,
    induced_gains,
    layer_bound,
)
from railslip_ctrl.verification.switching.layered import Impulse, torque_impulse
from railslip_ctrl.verification.switching.simulate import holding_torque, simulate
from railslip_ctrl.verification.switching.stepped import LayeredLaw

from .published import SPEEDS_KMH
from .rail_adhesion import PUBLISHED_ADHESION, RailAdhesion, load_cases

Torque = Callable[[float], float]


def bounded_disturbance(vehicle: Vehicle) -> float:
    """Torque at the wheel the bound is asked for, N*m."""
    return DISTURBANCE * vehicle.wheel_load * vehicle.wheel.radius * vehicle.inertia_scale


LEAD_FILTER_SHARE = 0.1
"""Time constant of the lead's filter over that of the lag, as in designs/pi_lead.py."""

LEAST_INTEGRAL_GAIN = 100.0
"""N*m/m, times the inertia scale."""

DISTURBANCE = 20.0 / (PARK2008.wheel_load * PARK2008.wheel.radius)
"""Torque at the wheel the bound is asked for, over wheel load and radius, times the inertia scale: of the published
vehicle 20 N*m."""

OFFSET = 0.1
"""Error at t = 0 that must be taken in, m/s."""

HOLD_ERROR = 0.1
"""Share of the holding torque by which it may be known wrongly."""

AUTHORITY_MARGIN = 1.05
"""K over what is asked of it."""

DURATION, STEP = 15.0, 5e-3  # s; the step is a twelfth of the lead's filter
_NOISE_HELD = 0.02  # s
_NO_LAG_FILTER = 0.01  # s, of the lead filter where the actuator has no lag


@dataclass(frozen=True)
class RailBounds:
    """One rail: the linear plant, and the bounds from rest and from `OFFSET`."""

    plant: LinearPlant
    at_rest: LayerBound
    from_offset: LayerBound


def layered_design(
    vehicle: Vehicle,
    adhesion: RailAdhesion = PUBLISHED_ADHESION,
    *,
    K: float | None = None,
    ki_min: float | None = None,
) -> LayeredDesign:
    """Tuned gains; K, N*m, is `AUTHORITY_MARGIN` times `least_authority` if left out.

    The integral gain is at least `ki_min`, N*m/m, > 0; left out, `LEAST_INTEGRAL_GAIN` times the inertia scale.
    InfeasibleDesignError where nothing stabilises every rail.
    """
    actuator, plants = vehicle.actuator, adhesion.plants(vehicle)
    lead_filter = LEAD_FILTER_SHARE * actuator.lag or _NO_LAG_FILTER
    lead = PIController(PIGains(kp=1.0, ki=0.0), actuator.lag, lead_filter).transfer_function
    least = LEAST_INTEGRAL_GAIN * vehicle.inertia_scale if ki_min is None else ki_min
    loops = [actuated_plant(plant, actuator) for plant in plants.values()]
    names = [plant.point.words for plant in plants.values()]
    tuned = tune_pi(loops, actuator.dead_time, minimise_ms=True, ki_min=least, compensator=lead, names=names)
    design = LayeredDesign(tuned.kp, tuned.ki, actuator.lag, lead_filter, 1.0 if K is None else K)
    return design if K is not None else replace(design, K=AUTHORITY_MARGIN * least_authority(design, vehicle, adhesion))


def least_authority(design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION) -> float:
    """Largest |Tb - hold|, N*m, on any rail, empty and loaded: of the bound from `OFFSET`, and for a hold wrong by
    `HOLD_ERROR`.

    Where the wheel's nonlinearity leaves no bound, that of the linear loop takes its place.
    """
    asked = []
    for laden in load_cases(vehicle).values():
        plants = adhesion.plants(laden).values()
        try:
            asked += [bounds.from_offset.command for bounds in rail_bounds(design, laden, adhesion).values()]
        except InfeasibleDesignError:
            asked += [_linear_command(design, plant) for plant in plants]
        asked += [_hold_command(design, plant) for plant in plants]
    return max(asked)


def _hold_command(design: LayeredDesign, plant: LinearPlant) -> float:
    """Peak of |Tb - hold|, N*m, of the linear loop where hold is wrong by `HOLD_ERROR` from t = 0 on."""
    impulse = torque_impulse(design, plant, plant.point.vehicle.actuator)
    means = 0.5 * (impulse.command[1:] + impulse.command[:-1])
    peak = float(np.abs(np.cumsum(np.diff(impulse.time) * means)).max())
    return HOLD_ERROR * holding_torque(plant.point) * peak


def _linear_command(design: LayeredDesign, plant: LinearPlant) -> float:
    """Bound of |Tb - hold|, N*m, from `OFFSET` without the wheel's nonlinearity."""
    vehicle = plant.point.vehicle
    impulse = torque_impulse(design, plant, vehicle.actuator)
    of_offset = OFFSET / plant.gain * float(np.abs(impulse.command).max())
    gains = induced_gains(design, plant, vehicle.actuator)
    return gains.command * bounded_disturbance(vehicle) + of_offset


def rail_bounds(
    design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> dict[Rail, RailBounds]:
    """Bounds at 100 km/h for |d| <= `bounded_disturbance`; InfeasibleDesignError where none exists."""
    found = {}
    for rail, plant in adhesion.plants(vehicle).items():
        rest, away = (_bound(design, plant, offset) for offset in (0.0, OFFSET))
        if isinstance(rest, InfeasibleDesignError):
            raise rest
        if isinstance(away, InfeasibleDesignError):
            raise away
        found[rail] = RailBounds(plant, rest, away)
    return found


def _bound(design: LayeredDesign, plant: LinearPlant, offset: float) -> LayerBound | InfeasibleDesignError:
    """The bound, or why there is none. K only enters what it is compared with, and a stop's points come up again."""
    found = _bound_of(replace(design, K=1.0), plant.point, offset)
    return found if isinstance(found, InfeasibleDesignError) else replace(found, K=design.K)


@lru_cache(maxsize=128)
def _bound_of(design: LayeredDesign, point: OperatingPoint, offset: float) -> LayerBound | InfeasibleDesignError:
    try:
        plant, impulse = _impulse_of(design, point)
        height = bounded_disturbance(point.vehicle)
        return layer_bound(design, plant, point.vehicle.actuator, height, offset=offset, impulse=impulse)
    except InfeasibleDesignError as error:
        return error


@lru_cache(maxsize=4)
def _impulse_of(design: LayeredDesign, point: OperatingPoint) -> tuple[LinearPlant, Impulse]:
    plant = linearize(point)
    return plant, torque_impulse(design, plant, point.vehicle.actuator)


@dataclass(frozen=True)
class LowestSpeeds:
    """Speeds, km/h, from 100 on down to which every rail and load has the property; None: not even there.

    `held`: from rest the bound on the slip is within 0 and twice the reference; `kept`: K is enough, from rest and from
    `OFFSET`.
    """

    held: float | None
    kept: float | None


def lowest_speeds(design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION) -> LowestSpeeds:
    """The bounds at each of `SPEEDS_KMH`, from the highest on."""
    held: float | None = None
    kept: float | None = None
    keeps = True
    for speed_kmh in reversed(SPEEDS_KMH):
        for laden in load_cases(vehicle).values():
            for plant in adhesion.plants(laden, speed_kmh=speed_kmh).values():
                rest, away = (_bound(design, plant, offset) for offset in (0.0, OFFSET))
                if isinstance(rest, InfeasibleDesignError) or rest.error >= plant.point.sigma:
                    return LowestSpeeds(held, kept)
                keeps &= rest.layer_kept and isinstance(away, LayerBound) and away.layer_kept
        held, kept = speed_kmh, speed_kmh if keeps else kept
    return LowestSpeeds(held, kept)


# --- simulations ----------------------------------------------------------------------------------------------------


def bounded_torques(height: float, impulse: Impulse) -> dict[str, Torque]:
    """Torques within +-height, N*m, over time, s: a step, sines, held noise, and the worst for the linear loop."""
    noise = np.random.default_rng(1).uniform(-height, height, 1000)
    worst = np.sign(np.interp(DURATION - np.arange(0.0, DURATION, STEP), impulse.time, impulse.error, right=0.0))
    return {
        "step": lambda t: height,
        "sine 0.5 rad/s": lambda t: height * math.sin(0.5 * t),
        "sine 2 rad/s": lambda t: height * math.sin(2.0 * t),
        "noise held 0.02 s": lambda t: float(noise[int(t / _NOISE_HELD) % noise.size]),
        # the impulse response backwards in time: every push adds up at the end
        "worst case": lambda t: height * float(worst[min(int(t / STEP), worst.size - 1)]),
    }


def random_torque(point: OperatingPoint, seed: int, duration: float) -> Torque:
    """The published random force, cut at 3 sigma, as a torque at the wheel, N*m, over time, s."""
    vehicle = point.vehicle
    count = math.ceil(duration / _NOISE_HELD) + 2
    force = ADHESION_NOISE * vehicle.wheel_load * np.clip(np.random.default_rng(seed).standard_normal(count), -3.0, 3.0)
    # what sigma' gets from 1 N*m of Tr, and that over the (r/J) it gets from a torque at the wheel
    rates, p = numeric_plant(type(point.law)).rates, plant_parameters(point.law, vehicle)
    state = (point.speed, point.sigma, point.adhesion_state or 0.0, point.brake_torque, 0.0)
    of_random = float(rates(*state, 1.0, p)[1] - rates(*state, 0.0, p)[1])
    torque = of_random * vehicle.effective_inertia * force  # (J/r) r force
    return lambda t: float(torque[int(t / _NOISE_HELD)])


def published_torque(design: LayeredDesign, point: OperatingPoint, seed: int, duration: float) -> Torque:
    """`random_torque`, and the published Td: 0.05 of the largest torque the law can ask for, hold + K."""
    random, largest = random_torque(point, seed, duration), TORQUE_FRACTION * (holding_torque(point) + design.K)
    return lambda t: random(t) + largest * math.exp(-TORQUE_DECAY * t) * math.sin(TORQUE_FREQUENCY * t)


def run_errors(
    design: LayeredDesign, plant: LinearPlant, torque: Torque, *, offset: float = 0.0
) -> tuple[float, float]:
    """Largest |sigma error| (m/s) and |Tb - hold| (N*m) of the nonlinear wheel with the actuator, speed frozen.

    DomainError where the wheel leaves the adhesion law's domain.
    """
    point, hold = plant.point, holding_torque(plant.point)
    law = LayeredLaw(point.slip, hold, design=design)
    actuator = point.vehicle.actuator
    run = simulate(point, law, actuator, duration=DURATION, step=STEP, disturbance=torque, offset=offset)
    return float(np.abs(run.sigma - point.sigma).max()), float(np.abs(run.command - hold).max())


def bounded_errors(design: LayeredDesign, bounds: RailBounds) -> dict[str, tuple[float, float]]:
    """`run_errors` from rest under each of `bounded_torques`."""
    impulse = torque_impulse(design, bounds.plant, bounds.plant.point.vehicle.actuator)
    torques = bounded_torques(bounds.at_rest.disturbance, impulse)
    return {name: run_errors(design, bounds.plant, torque) for name, torque in torques.items()}
