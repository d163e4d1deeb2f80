"""What else the published runs show, each statement decided by a run or computed; the words are in `facts.toml`."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from railslip_ctrl.core.templates import filled
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design import PIController
from railslip_ctrl.design.assessment import Assessment, assess
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, INITIAL_SPEED_KMH, PARK2008, TABLE4_PI, Rail
from railslip_ctrl.simulation import Run, Scenario, Signals, SlidingControl, published_scenario, simulate
from railslip_ctrl.simulation.catalogue import COLUMNS, Column, published_controller
from railslip_ctrl.verification.actuator_effects import largest_adaptation, published_loop
from railslip_ctrl.verification.lyapunov_runs import judge_run

from .tables import CASES, Progress

SLIDING_SHARES = (0.65, 0.85)
"""Share of the time with s s' < 0 that counts as about three quarters: neither sliding (1) nor chance (1/2)."""

SLOW = 3.0
"""A stop so many times longer than without the adaptation counts as lost: no stopping distance allows for it."""

LATE_SHARE = 0.5
"""Locking in this last share of the stop's time counts as late."""


@dataclass(frozen=True)
class Fact:
    """One finding about the published runs: what is said, what was found, whether it holds and how that was decided."""

    name: str
    statement: str
    found: str
    holds: bool
    how: str


def published_facts(*, seed: int = 0, progress: Progress | None = None) -> tuple[Fact, ...]:
    """What else the published runs show; takes some seconds; `seed` is the noise's."""
    decisions: tuple[Callable[[], Fact], ...] = (
        pi_margins,
        no_sliding,
        partial(reaching_fails, seed),
        partial(wet_rail_unknown, seed),
        partial(adaptation_unstable, seed),
        partial(si_stops_early, seed),
    )
    facts = []
    for decide in decisions:
        facts.append(decide())
        if progress is not None:
            progress(f"facts: {facts[-1].name}")
    return tuple(facts)


def pi_loop(column: Column, inertia_scale: float) -> Assessment:
    """A column's PI on the dry bristle model at 100 km/h and the column's reference slip, through the actuator."""
    vehicle = PARK2008.model_copy(update={"inertia_scale": inertia_scale})
    controller = published_controller("pi", column)
    law = published_law("bristle", Rail.DRY)
    plant = linearize(operating_point(law, vehicle, INITIAL_SPEED_KMH * KMH, controller.reference.dry, rail=Rail.DRY))
    return assess(plant, PIController(TABLE4_PI[column]), vehicle.actuator)


def _fact(name: str, holds: bool, **numbers: Any) -> Fact:
    """The fact of a name with its words of `facts.toml`."""
    statement, found, how = (filled(_texts()[name][part], numbers) for part in ("statement", "found", "how"))
    return Fact(name, statement, found, holds, how)


@cache
def _texts() -> dict[str, dict[str, str]]:
    return tomllib.loads(Path(__file__).with_name("facts.toml").read_text("utf-8"))


def pi_margins() -> Fact:
    """Barely stable as published, unstable in SI."""
    scale = AS_PUBLISHED_INERTIA_SCALE
    published = {column: pi_loop(column, scale) for column in COLUMNS}
    si = {column: pi_loop(column, 1.0) for column in COLUMNS}
    margins = {column: one.margins.phase_deg for column, one in published.items() if one.margins is not None}
    barely = len(margins) == len(COLUMNS) and all(phase < 30.0 for phase in margins.values())
    unstable = {column: one.unstable_poles for column, one in si.items()}
    holds = barely and not any(one.stable for one in si.values())
    return _fact("PI loops barely stable", holds, scale=scale, margins=margins, unstable=unstable)


def no_sliding() -> Fact:
    """s s' < 0 only part of the time, though nothing random acts."""
    shares = {c: judge_run(published_scenario(), _asmc(c), seed=None).condition("sliding").share for c in COLUMNS}
    low, high = SLIDING_SHARES
    return _fact("no sliding", all(low < share < high for share in shares.values()), shares=shares)


def reaching_fails(seed: int) -> Fact:
    """(40) with Table 4's gains and the published noise."""
    judged = {column: judge_run(published_scenario(), _asmc(column), seed=seed) for column in COLUMNS}
    shares = {column: one.condition("reaching (40)").share for column, one in judged.items()}
    return _fact("(40) fails", all(share < 1.0 for share in shares.values()), shares=shares, seed=seed)


def wet_rail_unknown(seed: int) -> Fact:
    """The ASMC that keeps the dry curve after 25 s."""
    scenario, runs, holds = published_scenario(), {}, True
    change = _rail_change(scenario)
    for column in COLUMNS:
        run = simulate(scenario, _asmc(column, knows_rail=False), seed=seed)
        known = simulate(scenario, _asmc(column), seed=seed, record_every=None)
        signals = _recorded(run)
        runs[column] = {
            "slip": float(signals.slip[signals.time > change].mean()),
            **{"locking": _locking(run), "end": _end(run)},
            **{"distance": run.braking_distance, "known": known.braking_distance},
        }
        holds = holds and run.locked_fraction > 0 and known.locked_fraction == 0
    return _fact("wet rail unknown", holds, runs=runs, change=change, seed=seed)


def adaptation_unstable(seed: int) -> Fact:
    """The printed k behind the printed actuator."""
    loop = published_loop(Rail.DRY, inertia_scale=AS_PUBLISHED_INERTIA_SCALE, adhesion="curve")
    ratio = largest_adaptation(loop) / loop.gains.k
    scenario, runs, holds = published_scenario(), {}, ratio < 1.0
    for column in COLUMNS:
        adaptive, plain = (
            simulate(scenario, _asmc(column, adaptive=on), seed=seed, record_every=None) for on in (True, False)
        )
        runs[column] = {"end": _end(adaptive), "plain": plain.braking_time}
        holds = holds and (not adaptive.stopped or adaptive.braking_time > SLOW * plain.braking_time)
    numbers = {"slow": SLOW, "longest": scenario.longest_time, "ratio": ratio, "runs": runs, "seed": seed}
    return _fact("printed adaptation unstable", holds, **numbers)


def si_stops_early(seed: int) -> Fact:
    """The same run with SI inertias."""
    scenario = published_scenario(as_published=False)
    end = _rail_change(scenario)
    highest = peak(scenario.law(Rail.DRY), scenario.initial_speed, scenario.vehicle.wheel_load).slip
    runs, holds = {}, True
    for case in CASES:
        run = simulate(scenario, published_controller(case.kind, case.gains), seed=seed)
        holds = holds and run.stopped and run.braking_time < end
        if case.kind == "asmc":
            over = np.flatnonzero(_recorded(run).slip > highest)
            holds = holds and over.size > 0 and run.first_lock > (1.0 - LATE_SHARE) * run.braking_time
        locking = _locking(run) if case.kind == "asmc" else ""
        runs[case.name] = {"end": _end(run), "locking": locking, "highest": run.max_slip}
    return _fact("SI stops before the rail turns wet", holds, runs=runs, change=end, peak=highest, seed=seed)


def _asmc(column: Column, *, knows_rail: bool = True, adaptive: bool = False) -> SlidingControl:
    controller = published_controller("asmc", column, knows_rail=knows_rail, adaptive=adaptive)
    assert isinstance(controller, SlidingControl), "the ASMC is the sliding-mode law"
    return controller


def _rail_change(scenario: Scenario) -> float:
    """When the rail turns wet, s."""
    return next(event.time for event in scenario.events if event.rail is Rail.WET and event.time is not None)


def _recorded(run: Run) -> Signals:
    assert run.signals is not None, "the run was recorded"
    return run.signals


def _end(run: Run) -> str:
    return f"{run.braking_time:.1f} s" if run.stopped else f"{run.outcome} by {run.braking_time:.0f} s"


def _locking(run: Run) -> str:
    if np.isnan(run.first_lock):
        return "never locked"
    return f"locked from {run.first_lock:.1f} s for {100 * run.locked_fraction:.1f} % of the time"
