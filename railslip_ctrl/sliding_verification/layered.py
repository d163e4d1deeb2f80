"""The layered law with a lead on the actuator's lag, tuned for a vehicle, and its conditions behind the actuator.

Gains: the PI of least worst Ms over dry and wet rail with the lead in the loop, as layer and rho (`switching.layered`).
Integral gain and disturbance grow with the inertia scale, which leaves the error that is guaranteed about as it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from railslip_ctrl.design import PIController, actuated_plant
from railslip_ctrl.design.tuning import tune_pi
from railslip_ctrl.errors import DomainError, InfeasibleDesignError
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.parameters import INITIAL_SPEED_KMH, PIGains, Rail, Vehicle
from railslip_ctrl.sliding.ideal_loop import disturbance_function
from railslip_ctrl.sliding.reaching_bound import ADHESION_NOISE, TORQUE_DECAY, TORQUE_FRACTION, TORQUE_FREQUENCY
from railslip_ctrl.sliding.verdict import Condition, Verification
from railslip_ctrl.switching import (
    LayerBound,
    LayeredDesign,
    induced_gains,
    layer_bound,
    layer_loop,
    published_loop,
)
from railslip_ctrl.switching.effects import ActuatorEffect
from railslip_ctrl.switching.layered import Impulse, torque_impulse
from railslip_ctrl.switching.simulate import holding_torque, simulate
from railslip_ctrl.switching.stepped import LayeredLaw
from railslip_ctrl.units import KMH

Torque = Callable[[float], float]

LEAD_FILTER_SHARE = 0.1
"""Time constant of the lead's filter over that of the lag, as in designs/pi_lead.py."""

LEAST_INTEGRAL_GAIN = 100.0
"""N*m/m, times the inertia scale."""

DISTURBANCE = 20.0
"""Torque at the wheel the bound is asked for, N*m, times the inertia scale."""

OFFSET = 0.1
"""Error at t = 0 that must be taken in, m/s."""

AUTHORITY_MARGIN = 1.05
"""K over what the bound asks of it."""

SPEEDS_KMH = (5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0)
"""Where the layer's stability is decided."""

RUNS = 4
"""Simulated runs with the published disturbances, each rail."""

DURATION, STEP = 15.0, 2.5e-3  # s
_FALLING = 5.5  # s times the inertia scale: down to a third of the speed on dry rail
_NOISE_HELD = 0.02  # s
_GONE = 0.01  # share of the offset that counts as gone in a bound's reaching time
_NO_LAG_FILTER = 0.01  # s, of the lead filter where the actuator has no lag


@dataclass(frozen=True)
class RailBounds:
    """One rail: the linear plant, and the bounds from rest and from `OFFSET`."""

    plant: LinearPlant
    at_rest: LayerBound
    from_offset: LayerBound


def rail_plants(vehicle: Vehicle, *, speed_kmh: float = INITIAL_SPEED_KMH) -> dict[Rail, LinearPlant]:
    """The bristle model at its reference slip on either rail, speed frozen."""
    scale = vehicle.inertia_scale
    return {
        rail: published_loop(rail, inertia_scale=scale, vehicle=vehicle, speed=speed_kmh * KMH).plant for rail in Rail
    }


def layered_design(vehicle: Vehicle, *, K: float | None = None) -> LayeredDesign:
    """Tuned gains; K, N*m, is `AUTHORITY_MARGIN` times the largest command of the bound from `OFFSET` if left out.

    Where the wheel's nonlinearity leaves no bound, that of the linear loop takes its place. InfeasibleDesignError where
    nothing stabilises both rails.
    """
    actuator, plants = vehicle.actuator, rail_plants(vehicle)
    lead_filter = LEAD_FILTER_SHARE * actuator.lag or _NO_LAG_FILTER
    lead = PIController(PIGains(kp=1.0, ki=0.0), actuator.lag, lead_filter).transfer_function
    least = LEAST_INTEGRAL_GAIN * vehicle.inertia_scale
    loops = [actuated_plant(plant, actuator) for plant in plants.values()]
    tuned = tune_pi(loops, actuator.dead_time, minimise_ms=True, ki_min=least, compensator=lead)
    design = LayeredDesign(tuned.kp, tuned.ki, actuator.lag, lead_filter, 1.0 if K is None else K)
    if K is not None:
        return design
    try:
        asked = max(bounds.from_offset.command for bounds in rail_bounds(design, vehicle).values())
    except InfeasibleDesignError:
        asked = max(_linear_command(design, plant) for plant in plants.values())
    return replace(design, K=AUTHORITY_MARGIN * asked)


def _linear_command(design: LayeredDesign, plant: LinearPlant) -> float:
    """Bound of |Tb - hold|, N*m, from `OFFSET` without the wheel's nonlinearity."""
    vehicle = plant.point.vehicle
    impulse = torque_impulse(design, plant, vehicle.actuator)
    of_offset = OFFSET / plant.gain * float(np.abs(impulse.command).max())
    gains = induced_gains(design, plant, vehicle.actuator)
    return gains.command * DISTURBANCE * vehicle.inertia_scale + of_offset


def rail_bounds(design: LayeredDesign, vehicle: Vehicle) -> dict[Rail, RailBounds]:
    """Bounds for |d| <= `DISTURBANCE` times the inertia scale; InfeasibleDesignError where none exists."""
    height, actuator = DISTURBANCE * vehicle.inertia_scale, vehicle.actuator
    return {
        rail: RailBounds(
            plant,
            layer_bound(design, plant, actuator, height),
            layer_bound(design, plant, actuator, height, offset=OFFSET),
        )
        for rail, plant in rail_plants(vehicle).items()
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


# --- conditions -----------------------------------------------------------------------------------------------------


def verify_layered(
    vehicle: Vehicle, *, K: float | None, seed: int
) -> tuple[Verification, tuple[ActuatorEffect, ...], str]:
    """The conditions, no analyses of the published law, and the conclusion."""
    design = layered_design(vehicle, K=K)
    conditions = [layered_stability(design, vehicle)]
    try:
        bounds = rail_bounds(design, vehicle)
    except InfeasibleDesignError as error:
        bounds = {}
        conditions.append(_bound_condition(False, str(error), vehicle))
    else:
        conditions += _bounded(design, bounds, vehicle)
    conditions += [
        held_under_published_disturbances(design, vehicle, seed),
        held_while_the_speed_falls(design, vehicle),
    ]
    found = Verification("layered", vehicle.inertia_scale, design.K, None, seed, tuple(conditions))
    return found, (), _conclusion(found, design, bounds)


def layered_stability(design: LayeredDesign, vehicle: Vehicle) -> Condition:
    """The loop within the layer over the stop, by the exact root count."""
    margins, unstable = {}, []
    for loaded in (False, True):
        for speed_kmh in SPEEDS_KMH:
            for rail, plant in rail_plants(vehicle.loaded() if loaded else vehicle, speed_kmh=speed_kmh).items():
                loop = layer_loop(design, plant, vehicle.actuator)
                name = f"{rail}, {speed_kmh:g} km/h, {'loaded' if loaded else 'empty'}"
                if loop.is_stable():
                    margins[name] = loop.margins().ms
                else:
                    unstable.append(name)
    worst = max(margins, key=lambda name: margins[name], default=None)
    least = "" if worst is None else f"; largest Ms {margins[worst]:.3f} ({worst})"
    return Condition(
        "layer stable behind the actuator",
        "With dead time and lag the loop within the layer is stable on both rails, at every speed, empty and loaded.",
        not unstable,
        "sampled",
        f"kp = K/layer = {design.kp:.4g} N m/(m/s), ki = rho kp = {design.ki:.4g} N m/m, lead {design.lead:g} s over "
        f"{design.lead_filter:g} s. Exact root counts, bristle model, reference slip, {len(margins) + len(unstable)} "
        f"points ({SPEEDS_KMH[0]:g} to {SPEEDS_KMH[-1]:g} km/h, dry and wet, empty and loaded): "
        f"{'all stable' if not unstable else 'unstable at ' + '; '.join(unstable)}{least}.",
    )


def _bound_condition(holds: bool, evidence: str, vehicle: Vehicle) -> Condition:
    return Condition(
        "bound with the actuator",
        f"|torque at the wheel| <= {DISTURBANCE * vehicle.inertia_scale:g} N m, from rest, keeps the slip between 0 "
        "and twice the reference.",
        holds,
        "sampled",
        evidence,
    )


def _bounded(design: LayeredDesign, bounds: dict[Rail, RailBounds], vehicle: Vehicle) -> list[Condition]:
    """Bound, authority, offset, and the simulations that must keep them."""
    listed = "; ".join(
        f"{rail}: |sigma error| <= {one.at_rest.error:.3f} m/s (a slip of "
        f"{one.at_rest.slip_error(one.plant.point.speed):.4f}), |s| <= {one.at_rest.surface:.3f} m/s, the wheel's "
        f"nonlinearity in it as {one.at_rest.remainder:.2g} N m"
        for rail, one in bounds.items()
    )
    held = all(one.at_rest.error < one.plant.point.sigma for one in bounds.values())
    asked = "; ".join(
        f"{rail}: {one.at_rest.command:.0f} N m from rest, {one.from_offset.command:.0f} N m from an error of "
        f"{OFFSET:g} m/s, then below {one.from_offset.error + _GONE * OFFSET:.3f} m/s after "
        f"{one.from_offset.reaching_time:.1f} s"
        for rail, one in bounds.items()
    )
    return [
        _bound_condition(
            held,
            "L1 norms of the loop's impulse responses, dead time exact; the remainder of the linearisation sampled "
            f"over the bound's own box, to a fixed point. {listed}. 100 km/h, speed frozen, bristle model.",
            vehicle,
        ),
        Condition(
            "authority",
            "K >= ||h_Tb||_1 (|d| + remainder): the layer is not left, from rest and from the offset. It "
            "stands for (40).",
            all(one.at_rest.layer_kept and one.from_offset.layer_kept for one in bounds.values()),
            "sampled",
            f"The same norms and points. K = {design.K:.4g} N m, layer {design.layer:.3f} m/s; asked {asked}.",
        ),
        bounds_kept(design, bounds),
    ]


def bounds_kept(design: LayeredDesign, bounds: dict[Rail, RailBounds]) -> Condition:
    """The nonlinear wheel against the bounds."""
    lines, kept = [], True
    for rail, one in bounds.items():
        try:
            errors = bounded_errors(design, one)
            start = [run_errors(design, one.plant, lambda _: 0.0, offset=sign * OFFSET) for sign in (1.0, -1.0)]
        except DomainError as error:
            lines.append(f"{rail}: {error}")
            kept = False
            continue
        name = max(errors, key=lambda key: errors[key][0])
        largest, command = errors[name][0], max(command for _, command in errors.values())
        kept &= largest <= one.at_rest.error and command <= one.at_rest.command
        kept &= all(e <= one.from_offset.largest_error and c <= one.from_offset.command for e, c in start)
        lines.append(
            f"{rail}: |sigma error| up to {largest:.3f} of {one.at_rest.error:.3f} m/s ({name}), |Tb - hold| up to "
            f"{command:.0f} of {one.at_rest.command:.0f} N m; from the offset {max(c for _, c in start):.0f} of "
            f"{one.from_offset.command:.0f} N m"
        )
    return Condition(
        "bounds kept, simulated",
        "The nonlinear wheel with lag and dead time stays within the bounds under torques of that size.",
        kept,
        "simulated",
        f"{'; '.join(lines)}. Step, sines, held noise and the linear loop's worst case from rest, and offsets of "
        f"+-{OFFSET:g} m/s, {DURATION:g} s each, steps of {1e3 * STEP:g} ms, 100 km/h frozen.",
    )


def held_under_published_disturbances(design: LayeredDesign, vehicle: Vehicle, seed: int) -> Condition:
    """The published disturbances, which no L1 bound covers."""
    lines, held = [], True
    for rail, plant in rail_plants(vehicle).items():
        try:
            found = [run_errors(design, plant, published_torque(design, plant, seed + i)) for i in range(RUNS)]
        except DomainError as error:
            lines.append(f"{rail}: {error}")
            held = False
            continue
        largest = max(error for error, _ in found)
        held &= largest < plant.point.sigma
        lines.append(
            f"{rail}: |sigma error| up to {largest:.3f} m/s of a reference {plant.point.sigma:.3f} m/s, |Tb - hold| up "
            f"to {max(command for _, command in found):.0f} of {design.K:.0f} N m"
        )
    return Condition(
        "published disturbances, simulated",
        "Under the published random force (431 N, cut at 3 sigma) and Td the slip stays between 0 and twice the "
        "reference.",
        held,
        "simulated",
        f"{'; '.join(lines)}. {RUNS} runs of {DURATION:g} s a rail, seeds {seed} to {seed + RUNS - 1}, 100 km/h "
        "frozen. The force is larger than the torque of the bound, and the layer is left for moments, but it is too "
        "quick for the wheel: seen here, not proved.",
    )


def held_while_the_speed_falls(design: LayeredDesign, vehicle: Vehicle) -> Condition:
    """The speed falls, which the bound leaves out."""
    lines, held = [], True
    for rail, plant in rail_plants(vehicle).items():
        point = plant.point
        law = LayeredLaw(point.slip, point.brake_torque, design=design)
        try:
            run = simulate(
                point, law, vehicle.actuator, duration=_FALLING * vehicle.inertia_scale, step=STEP, frozen=False
            )
        except DomainError as error:
            lines.append(f"{rail}: {error}")
            held = False
            continue
        slip = run.sigma / run.speed
        held &= bool(slip.max() < 2.0 * point.slip and slip.min() > 0.0)
        lines.append(
            f"{rail}: slip {slip.min():.4f} to {slip.max():.4f} about {point.slip:g}, down to "
            f"{run.speed[-1] / KMH:.3g} km/h"
        )
    return Condition(
        "speed falling, simulated",
        "With the speed falling, which the bound has frozen, the slip stays between 0 and twice the reference.",
        held,
        "simulated",
        f"{'; '.join(lines)}. From 100 km/h at rest, undisturbed, {_FALLING * vehicle.inertia_scale:.3g} s, the law "
        "holding on to the torque of 100 km/h.",
    )


def _conclusion(found: Verification, design: LayeredDesign, bounds: dict[Rail, RailBounds]) -> str:
    """What the law promises and under which conditions, or why not to use it as it is."""
    failing = [one.name for one in found.failing]
    if failing:
        asked = max((one.from_offset.command for one in bounds.values()), default=math.nan)
        remedy = (
            f"give K >= {asked:.0f} N m" if asked > design.K else "leave K out, or choose another vehicle or actuator"
        )
        return f"Do not use the layered law like this; not met: {'; '.join(failing)}. Remedy: {remedy}."
    worst = max(one.at_rest.error for one in bounds.values())
    height = next(iter(bounds.values())).at_rest.disturbance
    slowest = max((one.from_offset for one in bounds.values()), key=lambda bound: bound.reaching_time)
    later = max(one.from_offset.error for one in bounds.values()) + _GONE * OFFSET
    asked = max(one.from_offset.command for one in bounds.values())
    return (
        f"Behind the actuator this law keeps |sigma error| below {worst:.3f} m/s on dry and wet rail at 100 km/h for "
        f"every torque error up to {height:g} N m, and from an error of {OFFSET:g} m/s below {later:.3f} m/s after "
        f"{slowest.reaching_time:.1f} s, if {asked:.0f} N m are there either way of the holding torque (K = "
        f"{design.K:.0f} N m). The holding torque has to be known that well; the published random force and the "
        "falling speed are covered by simulation only."
    )
