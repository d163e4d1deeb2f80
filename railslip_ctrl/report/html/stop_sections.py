"""Section about the braking runs."""

from __future__ import annotations

import math

from railslip_ctrl.design_report import DesignReport, Stop, StopRun
from railslip_ctrl.simulation import Run
from railslip_ctrl.simulation.designed import INITIAL_SHARE
from railslip_ctrl.units import KMH

from .blocks import Block, Group, Items, Paragraph, Picture, Section, Table
from .numbers import NONE, listed, minus, short
from .typography import typeset

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
        "the dynamic model below, has another bound, which is not given here."
    )
    groups = [_stop_group(i, stop) for i, stop in enumerate(report.stops, start=1)]
    laws = Paragraph(_adhesion(report), strong=True)
    return Section("stops", "Braking runs", (intro, laws, *_layered(report), *groups))


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


def _layered(report: DesignReport) -> list[Block]:
    """Why the layered law is in no table of the runs, and what its own stops were."""
    full = report.sliding.layered
    if full is None:
        return []
    own = next((one for one in full.verification.conditions if one.name == _LAYERED_STOPS), None)
    text = (
        "The layered law is not in these tables: it acts about the holding torque of a rail that it has to know, and "
        "starts with that torque applied, while these controllers measure only speeds. A common table would compare "
        "unlike tasks. Nor do these begin alike: PI-lead commands at once what even wet rail surely takes "
        f"({INITIAL_SHARE:g} of wheel load times radius), while the integral of the published PI begins at nought. "
        "The command railslip simulate prints initial torque, torque limits and anti-windup of each."
    )
    if own is not None:
        text += f" Its own stops, from 100 to 5 km/h without disturbance: {own.evidence}"
    return [Paragraph(typeset(text))]


def _stop_group(i: int, stop: Stop) -> Group:
    blocks: list[Block] = [Paragraph(_stop_finding(stop), strong=True), _stop_table(stop)]
    missing = tuple(f"{one.name}: none. {one.reason}." for one in stop.runs if one.run is None)
    if missing:
        blocks.append(Items(missing))
    ran = [one for one in stop.runs if one.run is not None]
    if ran:
        told = "; ".join(f"{one.name}: {_words(one)}" for one in ran)
        blocks.append(
            Picture(
                f"stop-{i}",
                f"{stop.title[0].upper()}{stop.title[1:]}: speeds, slip and torque over time, a row a controller; "
                f"{_law(stop)}. Commands far above the acting torque are cut off.",
                "Time series of train and wheel speed, slip with its reference, and torque commanded and acting. "
                f"{told}.",
            )
        )
    if stop.dynamic:
        blocks += [_dynamic_table(stop), Paragraph(_dynamic_finding(stop))]
    return Group(f"stop-group-{i}", stop.title[0].upper() + stop.title[1:], tuple(blocks))


def _law(stop: Stop) -> str:
    law = stop.scenario.adhesion
    return f"{'dynamic' if law.has_state else 'static'} adhesion law {law.name}"


def _words(one: StopRun) -> str:
    run = one.run
    assert run is not None, "only runs are told"
    end = f"{short(run.braking_distance)} m in {short(run.braking_time, 3)} s"
    return f"stops in {end}" if run.stopped else f"{run.outcome.value} within {end}"


def _stop_finding(stop: Stop) -> str:
    shortest, bound = stop.shortest, stop.bound
    locked = [one.name for one in stop.runs if one.run is not None and one.run.locked_fraction > 0]
    if shortest is None:
        return "No controller stops the train."
    name = next(one.name for one in stop.runs if one.run is shortest)
    text = f"Shortest: {name}, {short(shortest.braking_distance)} m"
    if bound is not None and math.isfinite(bound.braking_distance):
        over = 100 * (shortest.braking_distance / bound.braking_distance - 1)
        text += (
            f", {over:.0f} % over the {short(bound.braking_distance)} m below which no controller can stop on this law"
        )
    text += below_reference(name, shortest)
    return text + (f". The wheel locks with: {', '.join(locked)}." if locked else ". No wheel locks.")


def below_reference(name: str, run: Run) -> str:
    """That a controller's run never came to the slip it was to hold, if so; a clause to append."""
    slips = run.controller.reference
    if run.max_slip >= min(slips.dry, slips.wet):
        return ""
    return f"; the slip of {name} stays below its reference throughout (at most {short(run.max_slip, 2)})"


def _stop_table(stop: Stop) -> Table:
    rows = []
    for one in stop.runs:
        run = one.run
        if run is None:
            continue
        rows.append(
            (
                one.name,
                run.outcome.value,
                short(run.braking_time),
                short(run.braking_distance),
                short(run.brake_energy / 1e6),
                short(run.mean_abs_slip_error, 3),
                short(run.max_slip, 3),
                f"{100 * run.locked_fraction:.2g}",
                short(run.max_torque / 1e3, 3),
            )
        )
    if stop.bound is not None:
        bound = (short(stop.bound.braking_time), short(stop.bound.braking_distance))
        rows.append(("least possible", "bound", *bound, *(NONE,) * 5))
    head = (
        "Controller", "Outcome", "Time, s", "Distance, m", "Energy, MJ", "Mean |slip error|, -",
        "Highest slip, -", "Locked, %", "Highest torque, kN·m",
    )  # fmt: skip
    return Table(
        f"{_from_to(stop)}, {_law(stop)}. Slip error: mean over time against the controller's own reference; locked: "
        "share of the time with rω < 0.02 v.",
        head,
        rows,
        wide=True,
    )


def _from_to(stop: Stop) -> str:
    scenario = stop.scenario
    start, end = scenario.initial_speed / KMH, scenario.final_speed / KMH
    return f"From {start:g} to {end:g} km/h, M {scenario.vehicle.mass:g} kg at the start, noise seed {stop.seed}"


def _dynamic_table(stop: Stop) -> Table:
    rows = []
    for one in stop.dynamic:
        curve = stop.run_of(one.name)
        for law, run in (("static curve", curve), ("dynamic bristle model", one.run)):
            if run is None:
                rows.append((one.name, law, one.reason or NONE, *(NONE,) * 5))
                continue
            rows.append(
                (
                    one.name,
                    law,
                    run.outcome.value,
                    short(run.braking_time),
                    short(run.braking_distance),
                    short(run.mean_abs_slip_error, 3),
                    short(run.max_slip, 3),
                    f"{100 * run.locked_fraction:.2g}",
                )
            )
    head = (
        "Controller", "Adhesion", "Outcome", "Time, s", "Distance, m", "Mean |slip error|, -", "Highest slip, -",
        "Locked, %",
    )  # fmt: skip
    return Table(
        f"The linear controllers again with the dynamic bristle model, which the margins are for, beside the static "
        f"curve. {_from_to(stop)}.",
        head,
        rows,
        wide=True,
    )


def _dynamic_finding(stop: Stop) -> str:
    """By how much the dynamic law changes the stops."""
    told = []
    for one in stop.dynamic:
        curve = stop.run_of(one.name)
        if one.run is None or curve is None:
            continue
        if one.run.stopped and curve.stopped:
            change = minus(f"{100 * (one.run.braking_distance / curve.braking_distance - 1):+.1f} %")
            lost = ", and the wheel locks" if one.run.locked_fraction > curve.locked_fraction == 0 else ""
            told.append(f"{one.name} stops in {short(one.run.braking_distance)} m, {change}{lost}")
        else:
            told.append(f"{one.name}: {_words(one)}")
    return f"With the dynamic model in place of its curve: {'; '.join(told)}."
