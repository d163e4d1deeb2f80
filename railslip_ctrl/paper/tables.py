"""Tables 3 and 5, adhesion curves and further facts of [Park2008], compared with computed results.

The errors in Table 3 cannot be recomputed, only their means.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.sliding import Sliding
from railslip_ctrl.controllers.systems import PIController
from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.notation import cite
from railslip_ctrl.core.processes import cpu_count
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.templates import filled, texts
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.assessment import Assessment, assess
from railslip_ctrl.design.catalogue import COLUMNS, Column, Kind, published_controller, published_reference
from railslip_ctrl.model.adhesion import RIG_WHEEL_LOAD, published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import Peak, adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, INITIAL_SPEED_KMH, PARK2008, TABLE4_PI, Rail
from railslip_ctrl.simulation import Run, Scenario, Simulator, published_scenario, simulate
from railslip_ctrl.verification.actuator_effects import largest_adaptation, published_loop
from railslip_ctrl.verification.lyapunov_runs import judge_run

from . import printed
from .printed import TABLE5

QUANTITIES = ("braking_time_s", "braking_distance_m", "brake_energy_published_reading", "mean_abs_slip_error")
"""Names of the quantities of Table 5."""

MOST_SEEDS = 100_000  #: largest number of runs of a column

Progress = Callable[[str], None]


@dataclass(frozen=True)
class TableColumn:
    """A column of Table 5: kind of controller, and the column of Table 4 that gives its gains and reference."""

    kind: Kind
    gains: Column

    @property
    def name(self) -> str:
        return f"{self.kind.upper()} {self.gains}"


CASES = (
    TableColumn("pi", "beam"),
    TableColumn("pi", "bristle"),
    TableColumn("asmc", "beam"),
    TableColumn("asmc", "bristle"),
)
"""The columns of Table 5, in its order."""


@dataclass(frozen=True)
class Setup:
    """Scenario and controller of a column of Table 5.

    - own_reference: if true, the slip error is the distance from the controller's reference slip; if false, from 0.132
      on dry and 0.092 on wet rail.
    - energy_in_joules: if true, the energy is in J; if false, the energy in J is multiplied by the inertia scale.
    """

    case: TableColumn
    scenario: Scenario
    controller: Controller
    own_reference: bool = False
    energy_in_joules: bool = False

    def numbers(self, run: Run) -> tuple[float, ...]:
        """Values of the `QUANTITIES` for a run: time, s; distance, m; energy, see `Setup`; slip error, a ratio."""
        unit = 1.0 if self.energy_in_joules else self.scenario.vehicle.inertia_scale
        error = run.mean_abs_slip_error if self.own_reference else run.mean_abs_slip_error_published
        return run.braking_time, run.braking_distance, unit * run.brake_energy, error


def published_setup(case: TableColumn) -> Setup:
    """Setup of a column of Table 5, with the units and assumptions of `reading.READING`."""
    return Setup(case, published_scenario(), published_controller(case.kind, case.gains))


@dataclass(frozen=True)
class CaseResult:
    """Runs of a setup.

    - values: shape (runs, 4), the `QUANTITIES` of each run; NaN if the run did not stop.
    - failures: outcomes of the runs that did not stop.
    """

    setup: Setup
    values: Floats
    failures: tuple[str, ...]

    @property
    def mean(self) -> Floats:
        """Means over the runs, shape (4,); NaN unless every run stopped."""
        return np.asarray(self.values.mean(axis=0))

    @property
    def standard_error(self) -> Floats:
        """Standard errors of the means, shape (4,); NaN for a single run."""
        runs = self.values.shape[0]
        if runs < 2:
            return np.full(len(QUANTITIES), math.nan)
        return np.asarray(self.values.std(axis=0, ddof=1) / math.sqrt(runs))


def checked_seeds(seeds: int) -> int:
    """Return the number of seeds; InputError if it is not 2 to `MOST_SEEDS`."""
    if not 2 <= seeds <= MOST_SEEDS:
        raise InputError(f"seeds: {seeds} is not allowed; give a whole number from 2 to {MOST_SEEDS}")
    return seeds


def run_setups(setups: Sequence[Setup], seeds: int, *, progress: Progress | None = None) -> tuple[CaseResult, ...]:
    """Run each setup with the seeds 0, 1, ... on all cores; a setup without random force runs once.

    `progress` is called after each setup.
    """
    results = []
    with ThreadPoolExecutor(cpu_count()) as pool:  # threads suffice, as a run releases the interpreter's lock
        for setup in setups:
            simulator = Simulator(setup.scenario, setup.controller)
            noisy = setup.scenario.disturbances.random_force > 0
            first = simulator.run(0 if noisy else None)  # before the threads, so that the kernel is compiled only once
            runs = [first, *pool.map(simulator.run, range(1, seeds if noisy else 1))]
            values = [setup.numbers(run) if run.stopped else (math.nan,) * len(QUANTITIES) for run in runs]
            failures = tuple(str(run.outcome) for run in runs if not run.stopped)
            results.append(CaseResult(setup, np.array(values), failures))
            if progress is not None:
                progress(f"{setup.case.name}: {len(runs)} runs done (setup {len(results)} of {len(setups)})")
    return tuple(results)


def published_runs(*, seed: int = 0) -> dict[str, Run]:
    """Simulate each column of Table 5 once; return the runs by column name. Every 20th step is recorded."""
    setups = [published_setup(case) for case in CASES]
    return {s.case.name: simulate(s.scenario, s.controller, seed=seed, record_every=20) for s in setups}


TOLERANCE_PERCENT = 4.0
"""Largest accepted deviation, %: single runs scatter by up to 5 % in slip error, and the paper reports one run."""

DEFAULT_SEEDS = 256  #: number of runs of each column


@dataclass(frozen=True)
class Row:
    """One number of [Park2008] Table 5, published and obtained, with the standard error of the obtained mean.

    `item` names column and quantity, for example "Table 5 / PI beam / braking_time_s".
    """

    item: str
    published: float
    obtained: float
    standard_error: float
    tolerance_percent: float
    source: str

    @property
    def deviation_percent(self) -> float:
        """Deviation of the obtained number in % of the published one; NaN if a run did not stop."""
        return 100.0 * (self.obtained / self.published - 1.0)

    @property
    def within(self) -> bool:
        return abs(self.deviation_percent) <= self.tolerance_percent


@dataclass(frozen=True)
class Table5:
    """Comparison with Table 5: a row for each number, the runs of each column, and the number of seeds."""

    rows: tuple[Row, ...]
    results: tuple[CaseResult, ...]
    seeds: int

    @property
    def rms_deviation_percent(self) -> float:
        """Root mean square of the deviations of the rows, %; NaN if a run did not stop."""
        return rms_deviation_percent(self.results)

    @property
    def within(self) -> bool:
        return all(row.within for row in self.rows)


def table5(seeds: int = DEFAULT_SEEDS, *, progress: Progress | None = None) -> Table5:
    """Run the four columns and compare them with [Park2008] Table 5.

    - seeds: runs of each column, 2 to `MOST_SEEDS`; InputError for another number.
    - progress: called with a line of text for each column done.
    """
    results = run_setups([published_setup(case) for case in CASES], checked_seeds(seeds), progress=progress)
    rows = tuple(
        Row(
            item=f"Table 5 / {result.setup.case.name} / {quantity}",
            published=published,
            obtained=float(mean),
            standard_error=float(error),
            tolerance_percent=TOLERANCE_PERCENT,
            source=cite("Park2008", "Table 5"),
        )
        for result in results
        for quantity, published, mean, error in zip(
            QUANTITIES, TABLE5[result.setup.case.name], result.mean, result.standard_error, strict=True
        )
    )
    return Table5(rows, results, seeds)


def rms_deviation_percent(results: tuple[CaseResult, ...]) -> float:
    """Root mean square of the deviations of all columns from Table 5, %; NaN if a run did not stop."""
    shares = [result.mean / np.array(TABLE5[result.setup.case.name]) - 1.0 for result in results]
    values = [100.0 * share for one in shares for share in one.tolist()]
    return math.sqrt(sum(value**2 for value in values) / len(values))


ADHESION_REGIME = (0.0193, 0.0138)  #: errors of beam and bristle while adhesion rises with slip, Figs. 14 and 15.

NOT_REPRODUCIBLE = (
    "The eight errors themselves cannot be recomputed: they refer to the mean of the rig's measurements, which "
    "[Park2008] shows only as marks in Fig. 13, and the slips over which they are averaged are not given. "
    "railslip identify makes the same comparison for a given log."
)


@dataclass(frozen=True)
class Table3:
    """Mean errors of the adhesion coefficient (ratios) of beam and bristle model, from [Park2008] Table 3.

    - improvement_percent: decrease of the mean error from beam to bristle, %.
    - improvement_of_printed_means_percent: decrease of the printed mean error from beam to bristle, %.
    - improvement_in_adhesion_regime_percent: decrease of the printed error while adhesion rises with slip, %.
    """

    beam_mean: float
    bristle_mean: float
    improvement_percent: float
    improvement_of_printed_means_percent: float
    improvement_in_adhesion_regime_percent: float
    not_reproducible: str = NOT_REPRODUCIBLE
    source: str = cite("Park2008", "Table 3")

    @property
    def improvement_follows_from_printed_means(self) -> bool:
        return abs(self.improvement_of_printed_means_percent - printed.TABLE3_IMPROVEMENT) <= 0.05


def table3() -> Table3:
    """Recompute the means and improvements of Table 3."""
    beam, bristle = (sum(row) / len(row) for row in printed.TABLE3.values())
    return Table3(
        beam_mean=beam,
        bristle_mean=bristle,
        improvement_percent=_improvement(beam, bristle),
        improvement_of_printed_means_percent=_improvement(*printed.TABLE3_MEANS.values()),
        improvement_in_adhesion_regime_percent=_improvement(*ADHESION_REGIME),
    )


def _improvement(before: float, after: float) -> float:
    return 100.0 * (1.0 - after / before)


SPEEDS_KMH = (30.0, 60.0, 100.0, 140.0)  #: initial braking speeds of the rig tests, [Park2008] Table 1

LAWS = ("beam", "curve", "bristle")  #: beam model; bristle model along a slip ramp, and in steady state

_POINTS = 801  # number of points of a curve


@dataclass(frozen=True)
class ModelCurve:
    """Curve of mu = Fa/N over slip ratio at the speed v0, with its peak.

    `reference` is the published reference slip ratio; None if v0 is not 100 km/h.
    """

    law: str
    rail: Rail
    initial_speed_kmh: float
    slip: Floats
    coefficient: Floats
    peak: Peak
    reference: float | None

    @property
    def rises(self) -> bool:
        return bool(self.peak.slip > self.slip[1])


def model_curves(
    laws: Sequence[str] = LAWS,
    *,
    speeds_kmh: Sequence[float] = SPEEDS_KMH,
    rails: Sequence[Rail] = (Rail.DRY,),
    largest_slip: float = 1.0,
) -> tuple[ModelCurve, ...]:
    """Adhesion curves of [Park2008] Figs. 13 to 15 at the rig's wheel load, ordered by law, then speed, then rail.

    - speeds_kmh: initial speeds v0, km/h, 30 to 140.
    - largest_slip: largest slip ratio; a curve ends earlier if the domain of its law does.

    InputError: unknown law, or speed out of range. MissingParametersError: law without published parameters.
    """
    return tuple(_curve(law, rail, v0, largest_slip) for law in laws for v0 in speeds_kmh for rail in rails)


def _curve(name: str, rail: Rail, v0: float, largest_slip: float) -> ModelCurve:
    law, speed = published_law(name, rail, v0), v0 * KMH
    end = min(largest_slip, law.domain_limit(speed)[0] * (1.0 - 1e-9))
    # a dynamic law has no steady state at slip 0, so its curve starts just above
    slip = np.linspace(1e-6 if law.has_state else 0.0, end, _POINTS)
    return ModelCurve(
        law=name,
        rail=rail,
        initial_speed_kmh=v0,
        slip=slip,
        coefficient=np.asarray(adhesion_coefficient(law, speed, slip, RIG_WHEEL_LOAD)),
        peak=peak(law, speed, RIG_WHEEL_LOAD),
        reference=law.reference_slip(rail) if v0 == INITIAL_SPEED_KMH else None,
    )


def wet_and_dry() -> tuple[ModelCurve, ...]:
    """Curves of [Park2008] Fig. 17, dry and wet, up to slip 0.5 at 100 km/h: the laws `curve` and `beam`."""
    return model_curves(("curve", "beam"), speeds_kmh=(INITIAL_SPEED_KMH,), rails=tuple(Rail), largest_slip=0.5)


SLIDING_SHARES = (0.65, 0.85)
"""Lowest and highest share of time with s s' < 0 for "three quarters"; it is 1 in sliding, 1/2 for a random s."""

SLOW = 3.0
"""Ratio of braking times with and without adaptation above which the adaptation has failed."""

LATE_SHARE = 0.5  #: locking in this last share of the braking time is late

_SEED = 0  # seed of the runs with noise


@dataclass(frozen=True)
class Fact:
    """Fact about the published runs: statement, computed numbers, whether it holds, and method."""

    name: str
    statement: str
    found: str
    holds: bool
    how: str


def published_facts(*, progress: Progress | None = None) -> tuple[Fact, ...]:
    """Compute further facts of the published runs; the texts are in `facts.toml`."""
    facts = []
    for decide in (pi_margins, no_sliding, reaching_fails, wet_rail_unknown, adaptation_unstable, si_stops_early):
        facts.append(decide())
        if progress is not None:
            progress(f"facts: {facts[-1].name}")
    return tuple(facts)


def pi_loop(column: Column, inertia_scale: float) -> Assessment:
    """Assess the loop with the PI gains and reference slip of a column of [Park2008] Table 4, with the actuator.

    The plant is the dry bristle model at 100 km/h, with M, J and B multiplied by `inertia_scale`.
    """
    vehicle = PARK2008.model_copy(update={"inertia_scale": inertia_scale})
    law = published_law("bristle", Rail.DRY)
    slip = published_reference(column).dry
    plant = linearize(operating_point(law, vehicle, INITIAL_SPEED_KMH * KMH, slip, rail=Rail.DRY))
    return assess(plant, PIController(TABLE4_PI[column]), vehicle.actuator)


def _fact(name: str, holds: bool, **numbers: Any) -> Fact:
    statement, found, how = (
        filled(texts(__package__, "facts.toml")[name][part], numbers) for part in ("statement", "found", "how")
    )
    return Fact(name, statement, found, holds, how)


def pi_margins() -> Fact:
    """Fact: the PI loops are barely stable as published, and unstable in SI."""
    scale = AS_PUBLISHED_INERTIA_SCALE
    published = {column: pi_loop(column, scale) for column in COLUMNS}
    si = {column: pi_loop(column, 1.0) for column in COLUMNS}
    margins = {column: one.margins.phase_deg for column, one in published.items() if one.margins is not None}
    barely = len(margins) == len(COLUMNS) and all(phase < 30.0 for phase in margins.values())
    unstable = {column: one.unstable_poles for column, one in si.items()}
    holds = barely and not any(one.stable for one in si.values())
    return _fact("PI loops barely stable", holds, scale=scale, margins=margins, unstable=unstable)


def no_sliding() -> Fact:
    """Fact: the sliding variable s meets s s' < 0 only part of the time, even without noise."""
    shares = {c: judge_run(published_scenario(), _asmc(c), seed=None).condition("sliding").share for c in COLUMNS}
    low, high = SLIDING_SHARES
    return _fact("no sliding", all(low < share < high for share in shares.values()), shares=shares)


def reaching_fails() -> Fact:
    """Fact: the reaching condition, [Park2008] (40), fails with the gains of Table 4 and the published noise."""
    judged = {column: judge_run(published_scenario(), _asmc(column), seed=_SEED) for column in COLUMNS}
    shares = {column: one.condition("reaching (40)").share for column, one in judged.items()}
    return _fact("(40) fails", all(share < 1.0 for share in shares.values()), shares=shares, seed=_SEED)


def wet_rail_unknown() -> Fact:
    """Fact: the ASMC locks the wheel if it still assumes a dry rail after 25 s, when the rail is wet."""
    scenario, runs, holds = published_scenario(), {}, True
    change = _rail_change(scenario)
    for column in COLUMNS:
        run = simulate(scenario, _asmc(column, knows_rail=False), seed=_SEED)
        known = simulate(scenario, _asmc(column), seed=_SEED, record_every=None)
        signals = run.signals
        assert signals is not None, "the run was recorded"
        runs[column] = {
            "slip": float(signals.slip[signals.time > change].mean()),
            **{"locking": _locking(run), "end": _end(run)},
            **{"distance": run.braking_distance, "known": known.braking_distance},
        }
        holds = holds and run.locked_fraction > 0 and known.locked_fraction == 0
    return _fact("wet rail unknown", holds, runs=runs, change=change, seed=_SEED)


def adaptation_unstable() -> Fact:
    """Fact: with the actuator, the adaptation with the printed gain k makes the loop unstable."""
    loop = published_loop(Rail.DRY, inertia_scale=AS_PUBLISHED_INERTIA_SCALE, adhesion="curve")
    ratio = largest_adaptation(loop) / loop.gains.k1
    scenario, runs, holds = published_scenario(), {}, ratio < 1.0
    for column in COLUMNS:
        adaptive, plain = (
            simulate(scenario, _asmc(column, adaptive=on), seed=_SEED, record_every=None) for on in (True, False)
        )
        runs[column] = {"end": _end(adaptive), "plain": plain.braking_time}
        holds = holds and (not adaptive.stopped or adaptive.braking_time > SLOW * plain.braking_time)
    numbers = {"slow": SLOW, "longest": scenario.longest_time, "ratio": ratio, "runs": runs, "seed": _SEED}
    return _fact("printed adaptation unstable", holds, **numbers)


def si_stops_early() -> Fact:
    """Fact: with SI inertias the stop ends before the rail turns wet."""
    scenario = published_scenario(as_published=False)
    end = _rail_change(scenario)
    highest = peak(scenario.law(Rail.DRY), scenario.initial_speed, scenario.vehicle.wheel_load).slip
    runs, holds = {}, True
    for case in CASES:
        run = simulate(scenario, published_controller(case.kind, case.gains), seed=_SEED)
        holds = holds and run.stopped and run.braking_time < end
        if case.kind == "asmc":
            assert run.signals is not None, "the run was recorded"
            over = np.flatnonzero(run.signals.slip > highest)
            holds = holds and over.size > 0 and run.first_lock > (1.0 - LATE_SHARE) * run.braking_time
        locking = _locking(run) if case.kind == "asmc" else ""
        runs[case.name] = {"end": _end(run), "locking": locking, "highest": run.max_slip}
    return _fact("SI stops before the rail turns wet", holds, runs=runs, change=end, peak=highest, seed=_SEED)


def _asmc(column: Column, *, knows_rail: bool = True, adaptive: bool = False) -> Sliding:
    controller = published_controller("asmc", column, knows_rail=knows_rail, adaptive=adaptive)
    assert isinstance(controller, Sliding), "the ASMC is the sliding-mode law"
    return controller


def _rail_change(scenario: Scenario) -> float:
    return next(event.time for event in scenario.events if event.rail is Rail.WET and event.time is not None)


def _end(run: Run) -> str:
    return f"{run.braking_time:.1f} s" if run.stopped else f"{run.outcome} by {run.braking_time:.0f} s"


def _locking(run: Run) -> str:
    if np.isnan(run.first_lock):
        return "never locked"
    return f"locked from {run.first_lock:.1f} s for {100 * run.locked_fraction:.1f} % of the time"
