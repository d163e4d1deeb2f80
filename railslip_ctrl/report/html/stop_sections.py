"""Section about the braking runs."""

from __future__ import annotations

from railslip_ctrl.design_report import DesignReport, Stop, StopRun
from railslip_ctrl.design_report.candidates import design_names
from railslip_ctrl.design_report.slow_end import HANDED_OVER
from railslip_ctrl.design_report.stops import HOLDING, RELAY
from railslip_ctrl.law_sources import PUBLISHED, law_words
from railslip_ctrl.simulation import LinearControl, Run
from railslip_ctrl.units import KMH

from .blocks import Block, Group, Items, Paragraph, Picture, Section, Table
from .numbers import NONE, listed, minus, short
from .sliding_sections import decided_for
from .typography import typeset
from .words import locks_elsewhere, outcome_words, percent_over, reference_of, seeds_words

_LAYERED_STOPS = "speed falling, simulated"


def stops_section(report: DesignReport) -> Section:
    """The same stop with every controller."""
    if not report.stops:
        text = "No braking run: the adhesion law cannot be had on the rails asked for."
        return Section("stops", "Braking runs", (Paragraph(text),))
    intro = Paragraph(
        "Nonlinear runs of the quarter car through the brake's dead time and lag, with the published random force "
        "and caliper disturbance, the same noise for every controller. The bound is the stop of a controller that "
        "knows the rail ahead: on the adhesion law of the same run no controller can stop in less. Another law, as "
        f"the dynamic model below, has another bound, which is not given here.{_alone(report)}"
    )
    groups = [_stop_group(i, stop, report) for i, stop in enumerate(report.stops, start=1)]
    laws = Paragraph(_adhesion(report), strong=True)
    return Section("stops", "Braking runs", (intro, laws, *_compared(report), *_layered(report), *groups))


def _alone(report: DesignReport) -> str:
    """Which controllers have no run with the dynamic law."""
    names = list(dict.fromkeys(name for stop in report.stops if stop.dynamic for name in stop.without_dynamic))
    return f" Without a run on the dynamic model: {listed(names)}." if names else ""


def _adhesion(report: DesignReport) -> str:
    """Which adhesion law the runs have, and which the margins."""
    asked = report.plants[0].point.law
    if not any(stop.dynamic for stop in report.stops):
        own = sorted({stop.scenario.adhesion.name for stop in report.stops})
        return f"Adhesion: the margins above are for the law {asked.name}; the runs have {listed(own)}."
    return (
        "Two adhesion laws. The margins above are for the dynamic bristle model at rest; the braking runs below have "
        "its static curve, which is the force that the same model builds along a slip ramp ([Park2008] Fig. 17). "
        "Why: the reading under which [Park2008] Table 5 comes out has that curve in every column, so that its "
        "controllers are run over what they were published for (railslip reproduce --sensitivity has the dynamic "
        "model in its place); and the curve has a peak that a reference slip can be compared with, while the model "
        "at rest falls from the start. What that changes is "
        "shown: on each rail the linear controllers are run again with the dynamic model, in a table of their own. A "
        "margin of this report and a run with the static curve do not vouch for each other."
    )


def _compared(report: DesignReport) -> list[Block]:
    """What the controllers are that stand in the tables to compare, and not in the pictures."""
    names = design_names(report.check.vehicle)
    there = {
        one.name: one.run.controller
        for stop in report.stops
        for one in stop.runs
        if one.run is not None and isinstance(one.run.controller, LinearControl)
    }
    linear = [name for name in (HOLDING, names.least_ms) if name in there]
    texts = []
    if linear and names.full_range in there:
        several = len(linear) > 1
        texts.append(
            f"{listed(linear)}: the design{'s of those names' if several else ' of that name'}, with "
            f"limits, anti-windup and initial torque of {names.full_range}."
        )
    if names.started_dry in there:
        dry, sure = (short(there[name].initial_torque) for name in (names.started_dry, names.full_range))
        texts.append(
            f"{names.started_dry}: begun with {dry} N·m in place of {sure} N·m; wet rail does not take it, and slip "
            "control has to bring it down."
        )
    handed = next((one for name, one in there.items() if name.endswith(HANDED_OVER)), None)
    if handed is not None:
        texts.append(
            f"{HANDED_OVER.removeprefix(', ')}: below that speed {short(handed.cut_out_torque)} N·m are commanded, and "
            "slip is not controlled."
        )
    if RELAY in there:
        full = short(there[RELAY].torque_high)
        texts.append(f"{RELAY}: {full} N·m while the slip is below the reference, none above.")
    return [Paragraph("To compare, in the tables only:"), Items(tuple(texts))] if texts else []


def _layered(report: DesignReport) -> list[Block]:
    """Why the layered law is in no table of the runs, and what its own stops were."""
    full, names = report.sliding.layered, design_names(report.check.vehicle)
    if full is None:
        return []
    own = next((one for one in full.verification.conditions if one.name == _LAYERED_STOPS), None)
    text = (
        "The layered law is not in these tables: it acts about the holding torque of a rail that it has to know, and "
        "starts with that torque applied, while these controllers measure only speeds. A common table would compare "
        f"unlike tasks.{_begins(report, names.full_range)} "
        "The command railslip simulate prints initial torque, torque limits and anti-windup of each."
    )
    if own is not None:
        other = decided_for(report)
        text += f" Its own stops, from 100 to 5 km/h without disturbance{f', {other}' if other else ''}: {own.evidence}"
    return [Paragraph(typeset(text))]


def _begins(report: DesignReport, name: str) -> str:
    runs = (one.run for stop in report.stops for one in stop.runs if one.name == name and one.run is not None)
    controller = next((run.controller for run in runs), None)
    if not isinstance(controller, LinearControl):
        return ""
    return (
        f" Nor do these begin alike: {name} commands at once what even wet rail takes, "
        f"{short(controller.initial_torque)} N·m, while the integral of the published PI begins at nought."
    )


def _stop_group(i: int, stop: Stop, report: DesignReport) -> Group:
    """A stop; of a controller that is no design either, its reason is told once, beside the designs."""
    blocks: list[Block] = [Paragraph(_stop_finding(stop, report), strong=True), _stop_table(stop)]
    missing = tuple(
        f"{one.name}: none. {'The reason is beside the designs' if one.name in report.loops.refused else one.reason}."
        for one in stop.runs
        if one.run is None
    )
    if missing:
        blocks.append(Items(missing))
    if stop.dynamic:
        blocks += [_dynamic_table(stop), Paragraph(_dynamic_finding(stop))]
    ran = [one for one in stop.runs if one.run is not None and one.drawn]
    if ran:
        told = "; ".join(f"{one.name}: {_words(one)}" for one in ran)
        blocks.append(
            Picture(
                f"stop-{i}",
                f"{stop.title[0].upper()}{stop.title[1:]}: speeds, slip and torque over time, a row a controller; "
                f"{_law(stop)}. {_seed_shown(stop)} Commands far above the acting torque are cut off.",
                "Time series of train and wheel speed, slip with its reference, and torque commanded and acting. "
                f"{told}.",
            )
        )
    return Group(f"stop-group-{i}", stop.title[0].upper() + stop.title[1:], tuple(blocks))


def _seed_shown(stop: Stop) -> str:
    """Which of the noise seeds is drawn, and with which others a wheel locks that does not in the picture."""
    told = [
        f"{one.name} does not lock the wheel with it, but does with {seeds_words(one.locking_seeds)}"
        for one in stop.runs
        if one.run is not None and one.drawn and one.locking_seeds and stop.seed not in one.locking_seeds
    ]
    return f"Noise seed {stop.seed}{': ' if told else ''}{'; '.join(told)}."


def _law(stop: Stop) -> str:
    law = stop.scenario.adhesion
    return f"{'dynamic' if law.has_state else 'static'} adhesion law {law_words(law, law.file or PUBLISHED)}"


def _words(one: StopRun) -> str:
    run = one.run
    assert run is not None, "only runs are told"
    end = f"{short(run.braking_distance)} m in {short(run.braking_time, 3)} s"
    return f"stops in {end}" if run.stopped else f"{run.outcome.value} within {end}"


def _stop_finding(stop: Stop, report: DesignReport) -> str:
    shortest, unlocked = stop.shortest, stop.shortest_unlocked
    locked = [one.name for one in stop.runs if one.run is not None and one.locks]
    if shortest is None:
        return "No controller stops the train."
    text = _told("Shortest", shortest, stop)
    if unlocked is not shortest and unlocked is not None:
        here = f"Shortest without a locked wheel here{locks_elsewhere(report, unlocked, stop)}"
        text += f" {_told(here, unlocked, stop)}"
    return f"{text} The wheel locks with: {'; '.join(locked)}." if locked else f"{text} No wheel locks."


def _told(what: str, one: StopRun, stop: Stop) -> str:
    run = one.run
    assert run is not None, "only runs are told"
    text = f"{what}: “{one.name}”, {short(run.braking_distance)} m{percent_over(run, stop.bound)}"
    return f"{text}{below_reference(one)}."


def below_reference(one: StopRun) -> str:
    """That a controller's runs never came to the slip it was to hold, if so; a clause to append."""
    assert one.run is not None, "only runs are told"
    slips = one.run.controller.reference
    if one.highest_slip >= min(slips.dry, slips.wet):
        return ""
    return f"; the slip of “{one.name}” stays below its reference throughout (at most {short(one.highest_slip, 2)})"


def _stop_table(stop: Stop) -> Table:
    rows = []
    spread = any(one.distances for one in stop.runs)
    for one in stop.runs:
        run = one.run
        if run is None:
            continue
        rows.append(
            (
                one.name,
                outcome_words(one),
                _if_stopped(run, run.braking_time),
                _if_stopped(run, run.braking_distance),
                *([_spread(one)] if spread else []),
                _if_stopped(run, run.brake_energy / 1e6),
                _if_stopped(run, run.mean_abs_slip_error, 3),
                short(one.highest_slip, 3),
                f"{100 * one.most_locked:.2g}",
                short(run.max_torque / 1e3, 3),
            )
        )
    if stop.bound is not None:
        bound = (short(stop.bound.braking_time), short(stop.bound.braking_distance))
        rows.append(("least possible", "bound", *bound, *(NONE,) * (6 if spread else 5)))
    head = (
        "Controller", "Outcome", "Time, s", "Distance, m", *(["Spread, m"] if spread else []), "Energy, MJ",
        "Mean |slip error|, -", "Highest slip, -", "Locked, %", "Highest torque, kN·m",
    )  # fmt: skip
    count = max(len(one.distances) for one in stop.runs)
    seeds = (
        f" Spread: the distance over {count} noise seeds; highest slip and locked: of the worst of them."
        if spread
        else " One noise seed, without a spread."
    )
    return Table(
        f"{_from_to(stop)}, {_law(stop)}.{seeds} Slip error: mean over time against the controller's own reference; "
        "locked: share of the time with rω < 0.02 v.",
        head,
        rows,
        wide=True,
    )


def _if_stopped(run: Run, value: float, digits: int = 4) -> str:
    """A number of a stop; none of a run that did not stop, which has it only up to where the run was given up."""
    return short(value, digits) if run.stopped else NONE


def _spread(one: StopRun) -> str:
    return f"{min(one.distances):.1f}–{max(one.distances):.1f}" if len(one.distances) > 1 else NONE


def _from_to(stop: Stop) -> str:
    scenario = stop.scenario
    start, end = scenario.initial_speed / KMH, scenario.final_speed / KMH
    return f"From {start:g} to {end:g} km/h, M {scenario.vehicle.mass:g} kg at the start, noise seed {stop.seed}"


def _dynamic_table(stop: Stop) -> Table:
    rows = []
    for one in stop.dynamic:
        curve = stop.run_of(one.name)
        if one.run is None:
            rows.append((one.name, one.reason or NONE, *(NONE,) * 8))
            continue
        run = one.run
        change = NONE
        if curve is not None and curve.stopped and run.stopped:
            change = minus(f"{100 * (run.braking_distance / curve.braking_distance - 1):+.1f}")
        rows.append(
            (
                one.name,
                outcome_words(one),
                _if_stopped(run, run.braking_time),
                _if_stopped(run, run.braking_distance),
                _spread(one),
                change,
                _if_stopped(run, run.mean_abs_slip_error, 3),
                short(one.highest_slip, 3),
                short(one.highest_slip_kmh, 3),
                f"{100 * one.most_locked:.2g}",
            )
        )
    head = (
        "Controller", "Outcome", "Time, s", "Distance, m", "Spread, m", "Against the curve, %",
        "Mean |slip error|, -", "Highest slip, -", "at, km/h", "Locked, %",
    )  # fmt: skip
    return Table(
        f"The linear controllers again with the dynamic bristle model, which the margins are for. {_from_to(stop)}; "
        "highest slip, with the speed at which it comes, and locked: of the worst of the noise seeds.",
        head,
        rows,
        wide=True,
    )


def _dynamic_finding(stop: Stop) -> str:
    """What the dynamic law changes."""
    runs = [one for one in stop.dynamic if one.run is not None]
    locked = [one.name for one in runs if one.run is not None and one.locks]
    passed = [one.name for one in runs if one.run is not None and one.highest_slip > 2 * reference_of(one.run)]
    text = "With the dynamic model in place of its curve "
    text += f"the wheel locks with: {'; '.join(locked)}." if locked else "no wheel locks."
    return text + (f" Slip over twice the reference: {'; '.join(passed)}." if passed else "")
