"""Stops continued to walking pace: what becomes of slip where its control ends, and of a torque held in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from railslip_ctrl.adhesion import AdhesionLaw
from railslip_ctrl.errors import InputError, RailslipError
from railslip_ctrl.numeric import peak
from railslip_ctrl.parameters import Vehicle
from railslip_ctrl.simulation import LinearControl, Scenario, Simulator
from railslip_ctrl.simulation.designed import SPEEDS_KMH
from railslip_ctrl.simulation.run import Signals
from railslip_ctrl.simulation.scenario import Disturbances
from railslip_ctrl.units import KMH

from .records import SlowEnd, SlowRun

START_KMH = min(SPEEDS_KMH)
"""Where the range ends that the designs are tuned for, and slip control can be handed over to a held torque."""

HANDED_OVER = f", handed over at {START_KMH:g} km/h"
"""What the name of a design that does so ends with."""

SLOWEST_KMH = 1.0
"""Where a stop that is continued below its usual end is given up."""


def handing_over(controller: LinearControl, torque: float) -> LinearControl:
    """The controller with slip control handed over, at `START_KMH`, to a held torque, N*m."""
    return replace(controller, cut_out_speed=START_KMH * KMH, cut_out_torque=torque)


def slow_ends(
    scenario: Scenario,
    name: str,
    controller: LinearControl,
    laws: Sequence[AdhesionLaw],
    seeds: Sequence[int],
    torque: float,
) -> tuple[SlowEnd, ...]:
    """How the stop of a controller called `name` ends on each law, by itself and handed over to a `torque`, N*m.

    Left out is what a law does not allow, and what does not come down to the speed at which slip control ends.
    """
    found = []
    for law in laws:
        try:
            found.append(_slow_end(scenario.with_changes(adhesion=law), name, controller, seeds, torque))
        except RailslipError:
            continue
    return tuple(found)


def _slow_end(scenario: Scenario, name: str, controller: LinearControl, seeds: Sequence[int], torque: float) -> SlowEnd:
    vehicle, usual, start = scenario.vehicle, scenario.final_speed / KMH, START_KMH
    reference = float(getattr(controller.reference, scenario.rail.value))
    whole = scenario.with_changes(final_speed=SLOWEST_KMH * KMH)
    quiet = whole.with_changes(disturbances=Disturbances())

    def at(load: Vehicle) -> dict[str, Any]:
        return {"vehicle": load, "adhesion": scenario.adhesion.at_wheel_load(load.wheel_load / vehicle.wheel_load)}

    def ends(whole: Scenario, controller: LinearControl, seeds: Sequence[int | None]) -> tuple[SlowRun, ...]:
        made = [Simulator(whole.with_changes(**at(load)), controller) for load in vehicle.loads()]
        return tuple(_end(one, seed, reference, start, usual) for one in made for seed in seeds)

    return SlowEnd(
        name=name,
        law=scenario.adhesion.name,
        rail=scenario.rail,
        reference=reference,
        from_kmh=start,
        usual_kmh=usual,
        least_kmh=SLOWEST_KMH,
        torque=torque,
        friction_needed=_friction_needed(vehicle, torque),
        friction_there=peak(scenario.adhesion.on(scenario.rail), start * KMH, vehicle.wheel_load).coefficient,
        controlled=ends(whole, controller, seeds),
        undisturbed=ends(quiet, controller, [None]),
        handed_over=ends(whole, handing_over(controller, torque), seeds),
    )


def _friction_needed(vehicle: Vehicle, torque: float) -> float:
    """Adhesion coefficient that a held torque takes at constant slip, travelling resistance left out.

    J omega' = r Fa - Tb with omega' = -Fa/(r M) of a wheel that slows down with the train ([Park2008] (3), (4)):
    mu = Tb/(N (r + J/(r M))).
    """
    r = vehicle.wheel.radius
    return torque / (vehicle.wheel_load * (r + vehicle.effective_inertia / (r * vehicle.effective_mass)))


def _end(simulator: Simulator, seed: int | None, reference: float, start: float, usual: float) -> SlowRun:
    # every step is looked at: between rows 50 ms apart slip rises by a hundredth
    run = simulator.run(0 if seed is None else seed, record_every=1)
    assert run.signals is not None, "the run is recorded"
    slow: Signals = Signals(*(one[run.signals.speed < start * KMH] for one in run.signals))
    before_end = slow.slip[slow.speed >= usual * KMH]
    if not before_end.size:
        raise InputError(f"stop: it does not come below {start:g} km/h; give a longer time")
    return SlowRun(
        mass=run.scenario.vehicle.mass,
        seed=seed,
        highest_slip=float(slow.slip.max()),
        highest_slip_usual=float(before_end.max()),
        beyond_kmh=_first(slow, slow.slip > 2.0 * reference),
        locked_kmh=_first(slow, slow.locked > 0),
    )


def _first(signals: Signals, there: np.ndarray) -> float:
    """Speed, km/h, at the first of the rows where something is so; NaN if there is none."""
    rows = np.flatnonzero(there)
    return float(signals.speed[rows[0]] / KMH) if rows.size else float("nan")
