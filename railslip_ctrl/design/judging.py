"""Verdict on a controller over a whole envelope; the dead time of every loop is exact."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field, fields
from functools import cached_property
from importlib import import_module
from itertools import compress, product
from typing import Any

import numpy as np

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.files import is_kind
from railslip_ctrl.controllers.sampled import SampledController, loop_as_run, run_period, sampled_peak
from railslip_ctrl.controllers.systems import PIController, has_step, linear_controller, linear_of, wheel_slip_loop
from railslip_ctrl.core.arguments import Flags, Floats, checked
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, ms_up
from railslip_ctrl.loop import Margins
from railslip_ctrl.loop.batch import BatchMargins, batch_margins
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.linearization import LinearPlant
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import Actuator

from .envelope import ERRORS, Case, Envelope, EnvelopePoints
from .limits import least_peak
from .specification import is_robust

_LOOKED_AT = 3  # cases of each speed whose sampled loop is computed too: sampling may reorder nearly equal Ms
_ROUGH, _ROUGH_GRID = ("phase_deg", "delay_s", "gain_decrease", "gain_increase"), 400
_ROUGHLY_LEAST = 2  # number of cases with the least margins on the grid, whose margins are then computed exactly
_ROUNDING = 1 - 1e-9  # factor that allows for the rounding of a speed converted from m/s to km/h
_ENGINES_AGREE = 1e-6  # relative difference of Ms computed for many loops at once and for one; both are exact to 1e-9


@dataclass(frozen=True)
class WorstCase:
    """Case with the largest Ms, with the loop of this case and the loop's margins (None if it is unstable).

    `run_case` is the case whose sampled loop has the largest Ms, `as_run` is this sampled loop, and `sampled` its
    margins. `as_run` is None if no sampled loop was computed besides `loop`.
    """

    case: Case
    loop: Any
    margins: Margins | None
    run_case: Case
    as_run: Any = None
    sampled: Margins | None = None

    @property
    def point(self) -> Any:
        return self.case.point

    @property
    def ms(self) -> float:
        return math.inf if self.margins is None else self.margins.ms

    @property
    def run_ms(self) -> float:
        """Ms of the worst sampled loop, inf if it is unstable; NaN without a sampled loop."""
        if self.as_run is None:
            return math.nan
        return math.inf if self.sampled is None else self.sampled.ms

    @property
    def loop_description(self) -> str:
        return f"{_kept(self.margins)} at {self.case.description}"

    @property
    def description(self) -> str:
        """Text with Ms of the loop and of the sampled loop, each with its case."""
        if self.as_run is None or self.margins is self.sampled is None:
            return self.loop_description
        run = f"{_kept(self.sampled)} if sampled every {self.as_run.period:g} s"
        if self.run_case is self.case:
            return f"{_kept(self.margins)} ({run}) at {self.case.description}"
        return f"{self.loop_description} ({run} at {self.run_case.description})"

    def table(self) -> dict[str, Any]:
        """Case, Ms, phase margin (deg), delay margin (s) as JSON; None if a value is infinite or the loop unstable."""
        m = self.margins
        values = [None] * 3 if m is None else [x if math.isfinite(x) else None for x in (m.ms, m.phase_deg, m.delay_s)]
        names = ("ms", "phase_margin_deg", "delay_margin_s")
        table: dict[str, Any] = {**dict(zip(names, values, strict=True)), "case": self.case.table()}
        if self.as_run is not None:
            table["sampled"] = {"period_s": self.as_run.period, "ms": None if self.sampled is None else self.sampled.ms}
            if self.run_case is not self.case:
                table["sampled"]["case"] = self.run_case.table()
        return table


def _kept(margins: Margins | None) -> str:
    return "unstable" if margins is None else f"Ms {ms_up(margins.ms)}"


@dataclass(frozen=True)
class MsMap:
    """Worst Ms at each speed and load; sampled loops are included.

    - speeds_kmh: train speeds, km/h, (m,), ascending.
    - loads: names of the loads, (n,).
    - operating: worst Ms over the operating points with this speed and load, (m, n).
    - with_tolerances: worst Ms over all cases with this speed and load, (m, n).

    Ms is inf where a loop is unstable, and NaN at a speed and load without a case.
    """

    speeds_kmh: Floats
    loads: tuple[str, ...]
    operating: Floats
    with_tolerances: Floats

    def plot(self) -> Any:
        """Return the map as a matplotlib figure."""
        plots = import_module("railslip_ctrl.report.plots")  # a package that imports this one
        return plots.ms_map_figure({"": self}, title="Worst Ms over speed and load")


@dataclass(frozen=True)
class Judgement:
    """Margins of a controller in all n cases of an envelope, and the verdict that follows; made by `judge`.

    - controller: linear system that was judged.
    - envelope: envelope with the reference slips at which the controller was judged.
    - nominal: whether only the operating points were judged.
    - points: cases of the envelope.
    - margins: margins of each case, NaN for an unstable loop. In cases with tolerances the gain margins are NaN; for a
      discrete controller all margins except Ms are NaN there. For a seeking controller only Ms is computed.
    """

    controller: Any
    envelope: Envelope
    nominal: bool
    points: EnvelopePoints
    margins: BatchMargins
    _loops: dict[tuple[Any, ...], tuple[Any, Margins | None]] = field(default_factory=dict, repr=False, compare=False)

    @property
    def stable(self) -> Flags:
        """Whether the loop of each case is stable, (n,)."""
        return self.margins.stable

    @cached_property
    def ms(self) -> Floats:
        """Ms of each case, (n,), inf if the loop is unstable; Ms of the sampled loop if `as_it_runs` is true."""
        return np.where(self.stable, self.margins.ms, np.inf)

    @cached_property
    def sampled_ms(self) -> Floats:
        """Ms of the sampled loop of each case, (n,), inf if the loop is unstable; NaN where it is not computed.

        For a continuous controller with a sampling period Ms is computed at every operating point. At each speed it is
        also computed in the three cases with the largest Ms of the continuous loop and in the case with the smallest
        delay margin, because sampling affects these most.
        """
        ms = np.full(len(self.points), np.nan)
        if self.as_it_runs:
            return self.ms
        if getattr(self.controller, "as_run", None) is None:
            return ms
        computed = self.points.operating.copy()
        for speed in np.unique(self.points.speed_kmh):
            cases = np.flatnonzero(self.points.speed_kmh == speed)
            computed[cases[np.argsort(self.ms[cases])[-_LOOKED_AT:]]] = True
            computed[cases[np.argmin(np.where(self.stable[cases], self.margins.delay_s[cases], 0.0))]] = True
        for i in np.flatnonzero(computed).tolist():
            plant, actuator = _of(self.points, i)
            loop = loop_as_run(plant, self.controller, actuator)
            ms[i] = np.nan if loop is None else sampled_peak(loop)
        return ms

    @cached_property
    def run_ms(self) -> Floats:
        """Larger of `ms` and `sampled_ms` of each case, (n,); `ms` if `sampled_ms` is NaN."""
        return np.fmax(self.ms, self.sampled_ms)

    @property
    def verdict(self) -> str:
        """Verdict "robust", "fragile" or "unstable" on the continuous and the sampled loops.

        A robust controller has Ms <= 2 at every operating point and is stable with every tolerance. A fragile
        controller is stable at every operating point, but not robust.
        """
        return self._verdict(np.ones(len(self.points), dtype=bool))

    @cached_property
    def usable_from_kmh(self) -> float | None:
        """Lowest speed at and above which every loop is stable and slip is controlled; None if there is none."""
        return self._lowest(self._stable)

    @cached_property
    def robust_from_kmh(self) -> float | None:
        """Lowest speed at and above which the verdict is "robust" and slip is controlled; None if there is none."""
        return self._lowest(lambda cases: self._verdict(cases) == "robust")

    @cached_property
    def worst(self) -> WorstCase:
        """Operating point of largest Ms at speeds from `usable_from_kmh` up; at all speeds if that is None."""
        return self._worst(self._usable & self.points.operating)

    @cached_property
    def worst_with_tolerances(self) -> WorstCase:
        """Case of largest Ms, with tolerances, at speeds from `usable_from_kmh` up; at all speeds if that is None."""
        return self._worst(self._usable)

    def least(self, margin: str, *, largest: bool = False) -> tuple[float, Case]:
        """Smallest value of a margin over the operating points at speeds from `usable_from_kmh` up, and its case.

        `margin` is the name of a margin of `Margins`. If `largest`, return the largest value instead.
        """
        sign = -1.0 if largest else 1.0
        cases = np.flatnonzero(self._usable & self.points.operating)
        values = getattr(self.margins, margin)[cases]
        if np.isnan(values).any():  # a seeking controller: the batch has only Ms
            cases = cases[np.argsort(sign * self._rough[margin][cases])[:_ROUGHLY_LEAST]]
            values = np.array([getattr(self._loop(i, wheel_slip_loop)[1], margin) for i in cases.tolist()])
        index = int(np.argmin(sign * values))
        return float(values[index]), self.points.case(int(cases[index]))

    @cached_property
    def _rough(self) -> dict[str, Floats]:
        margins_by_name = {name: np.full(len(self.points), np.nan) for name in _ROUGH}
        for i in np.flatnonzero(self.points.operating).tolist():
            plant, actuator = _of(self.points, i)
            margins = _rough_margins(wheel_slip_loop(plant, self.controller, actuator))
            for name, value in zip(_ROUGH, margins, strict=True):
                margins_by_name[name][i] = value
        return margins_by_name

    @cached_property
    def map(self) -> MsMap:
        """Map of the worst Ms over speed and load."""
        speed, load = self.points.speed_kmh, self.points.load
        speeds, loads = np.unique(speed), tuple(dict.fromkeys(load.tolist()))

        def worst(chosen: Flags) -> Floats:
            table = np.full((speeds.size, len(loads)), np.nan)
            columns = np.array([loads.index(one) for one in load[chosen].tolist()], dtype=int)
            np.fmax.at(table, (np.searchsorted(speeds, speed[chosen]), columns), self.run_ms[chosen])
            return table

        return MsMap(speeds, loads, worst(self.points.operating), worst(np.ones(len(self.points), dtype=bool)))

    def by_axis(self) -> dict[str, dict[Any, tuple[float, float]]]:
        """Share of stable loops and worst Ms of the stable loops, by envelope quantity ("rail", ...) and its value."""
        plants, actuators = self.points.plants, self.points.actuators
        of_plants = {
            "law": [plant.point.adhesion for plant in plants],
            "rail": [plant.point.rail.value for plant in plants],
            "speed_kmh": [round(plant.point.speed_kmh, 9) for plant in plants],
            "load": list(self.points.loads),
            "slip / reference": list(self.points.slip_factors),
            "radius_m": [plant.point.vehicle.wheel.radius for plant in plants],
            **{name: [error[i] for error in self.points.errors] for i, name in enumerate(ERRORS)},
        }
        of_actuators = {"dead_time_s": [a.dead_time for a in actuators], "lag_s": [a.lag for a in actuators]}
        labels = {name: np.array(values)[self.points.plant] for name, values in of_plants.items()}
        labels |= {name: np.array(values)[self.points.actuator] for name, values in of_actuators.items()}
        return {
            axis: {value: self._summary(of == value) for value in dict.fromkeys(of.tolist())}
            for axis, of in labels.items()
        }

    @property
    def verdict_line(self) -> str:
        """Text: verdict, deciding case, and lowest speed at and above which all loops are stable."""
        everywhere = np.ones(len(self.points), dtype=bool)
        line = self._decided(everywhere)
        if self.verdict != "unstable" and not self.nominal and self._stable(everywhere):
            line += f"; with tolerances {self.worst_with_tolerances.description}"
        if self.usable_from_kmh is None and self._in_use.any():
            return f"{line}; unstable at the highest speed too, {max(self.envelope.speeds):g} km/h{self._handed_over}"
        if (self.usable_from_kmh or 0.0) > max(min(self.envelope.speeds), self.hand_over_kmh / _ROUNDING):
            line += f"; stable from {self.usable_from_kmh:g} km/h up, there {self.worst_with_tolerances.description}"
        left_out = len(self.points.skipped)
        return line + (f"; cases left out: {left_out}" if left_out else "") + self._handed_over

    @property
    def hand_over_kmh(self) -> float:
        """Hand-over speed of the controller, km/h: below it the controller does not control slip; 0 if it has none."""
        return self.controller.controlled_from / KMH if isinstance(self.controller, Controller) else 0.0

    @property
    def verdict_in_use(self) -> str | None:
        """Verdict over the speeds from `hand_over_kmh` up; None if all speeds of the envelope are below it."""
        return self._verdict(self._in_use) if self._in_use.any() else None

    def __str__(self) -> str:
        robust = int(np.count_nonzero([is_robust(ms) for ms in self.run_ms.tolist()]))
        lines = [self.verdict_line, f"Ms <= 2 at {robust} of {len(self.points)} points"]
        lines += [f"left out: {case}" for case in self.points.skipped]
        return "\n".join([*lines, *self.slip_notes])

    @property
    def slip_notes(self) -> tuple[str, ...]:
        """Notes on the slips at which the controller was judged."""
        if not finds_slip(self.controller):
            return self.envelope.knife_edges()
        points = [plant.point for plant in self.points.plants]
        slips = [one.slip for one, factor in zip(points, self.points.slip_factors, strict=True) if factor == 1]
        past = sum(one.slip > peak(one.law, one.speed, one.vehicle.wheel_load).slip for one in points)
        return (
            f"judged at the slip that the controller finds, {min(slips):.3g} to {max(slips):.3g} depending on rail "
            f"and speed, and at this slip times the factors; {100 * past / len(points):.0f} % of these slips are past "
            "the peak",
        )

    def table(self) -> dict[str, Any]:
        """Judgement for JSON, in SI except for speeds in km/h."""
        return {
            "verdict": self.verdict,
            "nominal": self.nominal,
            "usable_from_kmh": self.usable_from_kmh,
            "robust_from_kmh": self.robust_from_kmh,
            "hand_over_kmh": self.hand_over_kmh or None,
            "verdict_in_use": self.verdict_in_use,
            "worst": self.worst.table(),
            "worst_with_tolerances": self.worst_with_tolerances.table(),
            "envelope": self.envelope.table(),
            "points": len(self.points),
            "skipped": list(self.points.skipped),
            "knife_edges": list(self.slip_notes),
        }

    @property
    def _usable(self) -> Flags:
        return self.points.speed_kmh >= (self.usable_from_kmh or 0.0)

    @cached_property
    def _in_use(self) -> Flags:
        return self.points.speed_kmh > _ROUNDING * self.hand_over_kmh

    @property
    def _handed_over(self) -> str:
        if self._in_use.all():
            return ""
        hand_over = f"; hands over below {self.hand_over_kmh:.4g} km/h"
        return (
            f"{hand_over}, in use {self._decided(self._in_use)}"
            if self._in_use.any()
            else f"{hand_over}, which is above every judged speed"
        )

    def _decided(self, cases: Flags) -> str:
        verdict = self._verdict(cases)
        tolerances = verdict == "fragile" and not self._stable(cases)
        worst = self._worst(cases if tolerances else cases & self.points.operating)
        case = worst.description.removeprefix("unstable at ") if verdict == "unstable" else worst.description
        return f"{verdict}{' at the operating points' if self.nominal else ''}: {case}"

    def _summary(self, chosen: Flags) -> tuple[float, float]:
        stable = self.stable & chosen
        return float(stable.sum() / chosen.sum()), float(self.ms[stable].max()) if stable.any() else math.inf

    def _verdict(self, cases: Flags) -> str:
        ms = self.run_ms[cases & self.points.operating]
        if not np.isfinite(ms).all():
            return "unstable"
        return "robust" if self._stable(cases) and (ms.size == 0 or is_robust(float(ms.max()))) else "fragile"

    def _stable(self, cases: Flags) -> bool:
        return bool(np.isfinite(self.run_ms[cases]).all())

    def _lowest(self, holds: Any) -> float | None:
        speeds, lowest = self.points.speed_kmh, None
        for speed in np.unique(speeds)[::-1].tolist():
            if not (holds(speeds == speed) and self._in_use[speeds == speed].all()):
                break
            lowest = speed
        return lowest

    def _worst(self, chosen: Flags) -> WorstCase:
        index = self._largest(self.ms, chosen)
        known = np.isfinite(self.ms[index]) and not np.isnan(self.sampled_ms[chosen]).all()
        run_index = self._largest(self.sampled_ms, chosen) if known else index
        case = self.points.case(index)
        run_case = case if run_index == index else self.points.case(run_index)
        (loop, margins), (run, sampled) = self._loop(index, wheel_slip_loop), self._loop(run_index, loop_as_run)
        worst = WorstCase(case, loop, margins, run_case, run, sampled)
        ms = worst.run_ms if self.as_it_runs else worst.ms
        assert ms == self.ms[index] or math.isclose(ms, self.ms[index], rel_tol=_ENGINES_AGREE)
        return worst

    @cached_property
    def as_it_runs(self) -> bool:
        """True if all loops of the controller are sampled loops."""
        return isinstance(self.controller, Controller) and type(self.controller).loop is not Controller.loop

    def _loop(self, index: int, made: Callable[..., Any]) -> tuple[Any, Margins | None]:
        key = made, int(self.points.plant[index]), int(self.points.actuator[index])
        if key not in self._loops:
            plant, actuator = _of(self.points, index)
            loop = made(plant, self.controller, actuator)
            self._loops[key] = loop, loop.margins() if loop is not None and loop.is_stable() else None
        return self._loops[key]

    def _largest(self, ms: Floats, chosen: Flags) -> int:
        unstable = np.flatnonzero(chosen & np.isinf(ms))
        if not unstable.size:
            return int(np.argmax(np.where(chosen, np.nan_to_num(ms), -1.0)))
        poles = np.array([float(plant.poles.real.max(initial=-np.inf)) for plant in self.points.plants])
        times = np.array([one.dead_time + one.lag for one in self.points.actuators])
        hardness = poles[self.points.plant[unstable]] * times[self.points.actuator[unstable]]
        return int(unstable[np.argmax(hardness)])


@checked
def judge(envelope: Envelope, controller: Any, nominal: bool = False) -> Judgement:
    """Judge a linear controller over an envelope, with exact dead times.

    The operating points have the reference slips of the envelope, or those of the controller if the envelope has none.
    A controller that searches for its slip, such as the seeking controller, is judged at the slip that it finds with
    each adhesion law.

    - envelope: operating points and tolerances.
    - controller: linear system from slip error e = lambda_d v - sigma (m/s) to torque (N*m), in any form
      that `wheel_slip_loop` accepts as `controller`. A continuous system without a sampling period is judged twice: as
      continuous, and as sampled every 10 ms by Tustin's rule.
    - nominal: if true, only the operating points are judged, without tolerances.

    InputError: a controller without margins, or an envelope without points.
    """
    controller = getattr(controller, "controller", controller)  # the controller of a design
    if is_kind(controller):
        controller = controller.for_vehicle(envelope.vehicle)
    if isinstance(controller, Controller):
        controller = controller.believing(envelope.vehicle)
    envelope = envelope_for(envelope, controller)
    runs = isinstance(controller, Controller) or hasattr(controller, "as_run") or has_step(controller)
    if not (runs or callable(linear_of(controller))):
        design = linear_controller(controller)
        if isinstance(design, PIController) or design.period is None:
            controller = SampledController(design, run_period(design))
    points = envelope.points(nominal=nominal, slip_of=controller.judged_slip if finds_slip(controller) else None)
    return judge_points(envelope, controller, points, nominal=nominal)


def envelope_for(envelope: Envelope, controller: Any) -> Envelope:
    """Return the envelope with the controller's reference slips, unless the envelope has reference slips.

    For a controller that searches for its slip, the speeds at which its loop changes are added to the envelope instead.
    """
    reference = getattr(controller, "reference", None)
    if finds_slip(controller):
        own = [round(speed / KMH, 9) for speed in controller.speeds_to_judge()]
        inside = [speed for speed in own if min(envelope.speeds) < speed < max(envelope.speeds)]
        return envelope.at(speeds=sorted({*envelope.speeds, *inside}))
    if envelope.reference or not isinstance(reference, ReferenceSlip):
        return envelope
    return envelope.at(reference=reference)


def bounds_over(points: EnvelopePoints, over: MsMap) -> Floats:
    """Return the lower bound of Ms for all linear controllers at each speed and load of the map `over`, (m, n)."""
    bounds = np.ones((over.speeds_kmh.size, len(over.loads)))
    for plant, load in zip(points.plants, points.loads, strict=True):
        poles, zeros = (roots[roots.real > 0] for roots in (plant.poles, plant.zeros))
        at = int(np.argmin(np.abs(over.speeds_kmh - plant.point.speed_kmh))), over.loads.index(load)
        bounds[at] = max(bounds[at], least_peak(poles, zeros, points.vehicle.actuator.dead_time))
    return bounds


def finds_slip(controller: Any) -> bool:
    """Return True if a controller searches for its slip instead of tracking a reference slip."""
    return isinstance(controller, Controller) and controller.finds_slip


def judge_points(envelope: Envelope, controller: Any, points: EnvelopePoints, *, nominal: bool = False) -> Judgement:
    """Judge a controller in the cases `points` of an envelope, which the caller has computed."""
    return Judgement(controller, envelope, nominal, points, margins_at(controller, points))


def margins_at(
    controller: Any, points: EnvelopePoints, factors: Floats | None = None, *, gain_margins: bool = False
) -> BatchMargins:
    """Return the margins of a controller in every case.

    - factors: factors on the loop gain; all cases with the first factor come first, then those with the second.
    - gain_margins: if true, gain margins are computed in every case, and Ms is not computed. By default Ms is computed
      in every case, and gain margins at the operating points only.
    """
    if isinstance(controller, Controller):
        own = controller.stable_and_ms(
            [plant.point for plant in points.plants], points.actuators, (points.plant, points.actuator)
        )
        if own is not None:
            columns = {one.name: np.full(len(points), np.nan) for one in fields(BatchMargins)}
            columns["stable"], columns["ms"] = own
            return BatchMargins(**columns)
    used = np.unique(points.plant).tolist()
    if callable(linear_of(controller)):
        designs = [linear_controller(controller, points.plants[i].point) for i in used]
    else:
        designs = [linear_controller(controller)] * len(used)
    if any(not isinstance(design, PIController) and design.period is not None for design in designs):
        return _one_by_one(controller, points)
    parts = {key: design.transfer_function for key, design in {id(one): one for one in designs}.items()}
    loops = [(parts[id(design)], points.system(i)) for i, design in zip(used, designs, strict=True)]
    times = factors if factors is not None else np.ones(1)
    lags = np.array([one.lag for one in points.actuators])[points.actuator]
    dead_times = np.array([one.dead_time for one in points.actuators])[points.actuator]
    columns = {one.name: np.full((times.size, len(points)), np.nan) for one in fields(BatchMargins)}
    shapes = np.array([(c.zeros.size + g.zeros.size, c.poles.size + g.poles.size) for c, g in loops])
    loop_of = np.searchsorted(used, points.plant)
    groups = (points.operating, ~points.operating) if factors is None else (np.ones(len(points), dtype=bool),)
    kinds = product(np.unique(shapes, axis=0).tolist(), (lags > 0, lags == 0), groups)
    for shape, braked, kind in kinds:
        alike = (shapes == shape).all(axis=1)
        mine = np.flatnonzero(alike[loop_of] & braked & kind)
        if not mine.size:
            continue
        row = (np.cumsum(alike) - 1)[loop_of[mine]]  # index of each case's loop among those of this shape
        some = list(compress(loops, alike.tolist()))
        z = np.array([np.concatenate([c.zeros, g.zeros]) for c, g in some], dtype=complex)[row]
        p = np.array([np.concatenate([c.poles, g.poles]) for c, g in some], dtype=complex)[row]
        gain = np.array([c.gain * g.gain for c, g in some])[row]
        if lags[mine[0]] > 0:
            p, gain = np.column_stack([p, -1 / lags[mine]]), gain / lags[mine]
        n = times.size
        part = batch_margins(
            np.tile(z, (n, 1)),
            np.tile(p, (n, 1)),
            np.outer(times, gain).ravel(),
            np.tile(dead_times[mine], n),
            gain_margins=gain_margins or (factors is None and bool(points.operating[mine[0]])),
            peaks=not gain_margins,
        )
        for name, column in columns.items():
            column[:, mine] = getattr(part, name).reshape(n, mine.size)
    flat = {name: column.ravel() for name, column in columns.items()}
    return BatchMargins(**{**flat, "stable": flat["stable"] == 1})


def _rough_margins(loop: Any) -> tuple[float, float, float, float]:
    low, high = loop.feature_band()
    omega = np.geomspace(low, high, _ROUGH_GRID)
    response = loop.response(omega)
    size, left = np.log(np.abs(response)), np.unwrap(np.angle(-response))  # phase from -180 deg
    crosses = np.flatnonzero(np.diff(size > 0))
    omegas, phases = (_at_zero(size, other, crosses) for other in (omega, left))
    turns = np.flatnonzero(np.diff(response.imag > 0) & (response.real[1:] < 0))
    factors = np.exp(-_at_zero(response.imag, size, turns))
    return (
        np.degrees(np.abs(np.mod(phases + np.pi, 2 * np.pi) - np.pi)).min(initial=180.0),
        (np.mod(phases, 2 * np.pi) / omegas).min(initial=np.inf),
        factors[factors < 1].max(initial=0.0),
        factors[factors > 1].min(initial=np.inf),
    )


def _at_zero(values: Floats, others: Floats, at: Any) -> Floats:
    share = values[at] / (values[at] - values[at + 1])
    return np.asarray(others[at] + share * (others[at + 1] - others[at]))


def _of(points: EnvelopePoints, index: int) -> tuple[LinearPlant, Actuator]:
    return points.plants[int(points.plant[index])], points.actuators[int(points.actuator[index])]


def _one_by_one(controller: Any, points: EnvelopePoints) -> BatchMargins:
    columns = {one.name: np.full(len(points), np.nan) for one in fields(BatchMargins)}
    for index in range(len(points)):
        plant, actuator = _of(points, index)
        loop = wheel_slip_loop(plant, controller, actuator)
        assert isinstance(loop, SampledLoop), "the loop of a discrete controller is sampled"
        columns["ms"][index] = sampled_peak(loop)
        columns["stable"][index] = math.isfinite(columns["ms"][index])
        if points.operating[index] and columns["stable"][index]:
            margins = loop.margins()
            for name in columns.keys() - {"stable"}:
                columns[name][index] = getattr(margins, name, np.nan)
    return BatchMargins(**{**columns, "stable": columns["stable"] == 1})
