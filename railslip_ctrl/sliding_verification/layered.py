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

import numpy as np

from railslip_ctrl.design import PIController, actuated_plant
from railslip_ctrl.design.tuning import tune_pi
from railslip_ctrl.errors import InfeasibleDesignError
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.parameters import PIGains, Rail, Vehicle
from railslip_ctrl.sliding.ideal_loop import disturbance_function
from railslip_ctrl.sliding.reaching_bound import ADHESION_NOISE, TORQUE_DECAY, TORQUE_FRACTION, TORQUE_FREQUENCY
from railslip_ctrl.switching import (
    LayerBound,
    LayeredDesign,
    induced_gains,
    layer_bound,
)
from railslip_ctrl.switching.layered import Impulse, torque_impulse
from railslip_ctrl.switching.simulate import holding_torque, simulate
from railslip_ctrl.switching.stepped import LayeredLaw

from .rail_adhesion import PUBLISHED_ADHESION, RailAdhesion

Torque = Callable[[float], float]

LEAD_FILTER_SHARE = 0.1
"""Time constant of the lead's filter over that of the lag, as in designs/pi_lead.py."""

LEAST_INTEGRAL_GAIN = 100.0
"""N*m/m, times the inertia scale."""

DISTURBANCE = 20.0
"""Torque at the wheel the bound is asked for, N*m, times the inertia scale."""

OFFSET = 0.1
"""Error at t = 0 that must be taken in, m/s."""

HOLD_ERROR = 0.1
"""Share of the holding torque by which it may be known wrongly."""

AUTHORITY_MARGIN = 1.05
"""K over what is asked of it."""

DURATION, STEP = 15.0, 2.5e-3  # s
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
    """Largest |Tb - hold|, N*m, on any rail: of the bound from `OFFSET`, and for a hold wrong by `HOLD_ERROR`.

    Where the wheel's nonlinearity leaves no bound, that of the linear loop takes its place.
    """
    plants = adhesion.plants(vehicle).values()
    try:
        asked = [bounds.from_offset.command for bounds in rail_bounds(design, vehicle, adhesion).values()]
    except InfeasibleDesignError:
        asked = [_linear_command(design, plant) for plant in plants]
    return max(*asked, *(_hold_command(design, plant) for plant in plants))


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
    return gains.command * DISTURBANCE * vehicle.inertia_scale + of_offset


def rail_bounds(
    design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> dict[Rail, RailBounds]:
    """Bounds for |d| <= `DISTURBANCE` times the inertia scale; InfeasibleDesignError where none exists."""
    height, actuator = DISTURBANCE * vehicle.inertia_scale, vehicle.actuator
    return {
        rail: RailBounds(
            plant,
            layer_bound(design, plant, actuator, height),
            layer_bound(design, plant, actuator, height, offset=OFFSET),
        )
        for rail, plant in adhesion.plants(vehicle).items()
    }


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


def published_torque(design: LayeredDesign, plant: LinearPlant, seed: int) -> Torque:
    """The published random force (cut at 3 sigma) and Td as a torque at the wheel, N*m, over time, s.

    Td is 0.05 of the largest torque the law can ask for, hold + K.
    """
    vehicle = plant.point.vehicle
    r, M, J = vehicle.wheel.radius, vehicle.effective_mass, vehicle.effective_inertia
    count = math.ceil(DURATION / _NOISE_HELD) + 1
    force = ADHESION_NOISE * np.clip(np.random.default_rng(seed).standard_normal(count), -3.0, 3.0)
    # s' = -sigma' with the speed frozen, and a torque at the wheel takes (r/J) of it from s'
    torque = -np.asarray(disturbance_function()(r * force, 0.0, 0.0, M, J, r)) * J / r
    largest = TORQUE_FRACTION * (holding_torque(plant.point) + design.K)
    return lambda t: (
        float(torque[int(t / _NOISE_HELD)]) + largest * math.exp(-TORQUE_DECAY * t) * math.sin(TORQUE_FREQUENCY * t)
    )


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
