"""Section about the recommended design over speed: margins down to walking pace, and what stops do there."""

from __future__ import annotations

import math
from collections.abc import Sequence

from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design_report import DesignReport, RangeLine, SlowEnd, SlowRun, SpeedRange
from railslip_ctrl.law_sources import PUBLISHED, law_words, source_at
from railslip_ctrl.linearization import OperatingPoint
from railslip_ctrl.simulation.designed import SPEEDS_KMH

from .blocks import Block, Items, Paragraph, Picture, Section, Table
from .numbers import NONE, above, listed, short
from .words import load_of, load_words, lost_words, policy_words, slow_words

RANGE = "range"
"""Anchor of the section, and name of its picture."""


def range_section(report: DesignReport) -> Section:
    """Margins of the recommended design at every speed, law, rail and load; None of them where none is recommended."""
    speeds = report.loops.speeds
    title = "The recommended design over speed"
    if speeds is None:
        return Section(RANGE, title, (Paragraph("No design is recommended, so that there is none to show."),))
    points = [plant.point for plant in report.plants]
    blocks: list[Block] = [Paragraph(range_finding(speeds), strong=True), Paragraph(_how(speeds, points))]
    if endless := report.endless(speeds.name):
        told = f"It stands here by its margins alone: the train does not stop with it {listed(endless)}."
        blocks.insert(0, Paragraph(told, strong=True))
    blocks += [_ms_table(speeds), _picture(speeds), _worst_table(speeds)]
    ends = [end for stop in report.stops for end in stop.slow if end.name == speeds.name]
    if ends:
        blocks += [_end_table(ends), Paragraph(f"{slow_words(ends)} {policy_words(ends)}", strong=True)]
    blocks.append(Paragraph("Every margin of every law, rail and load at every speed is in report.json."))
    if speeds.skipped:
        blocks.append(Items(speeds.skipped))
    return Section(RANGE, title, tuple(blocks))


def range_finding(speeds: SpeedRange) -> str:
    """Where the design is robust, where it is stable, and where it is not."""
    low, high = min(SPEEDS_KMH), max(SPEEDS_KMH)
    text = f"{speeds.name}: from {low:g} to {high:g} km/h the largest Ms is {_worst(speeds.worst_ms(low, high))}"
    if math.isfinite(speeds.robust_from):
        text += f"; Ms ≤ {ROBUST_MS:g} everywhere {_from(speeds.robust_from, speeds)}"
    if speeds.stable_from > speeds.least_kmh:
        return f"{text}; {lost_words(speeds)}. The other loops are stable down to {speeds.least_kmh:g} km/h."
    return f"{text}; every loop is stable down to {speeds.least_kmh:g} km/h."


def _from(speed: float, speeds: SpeedRange) -> str:
    return f"from {short(max(speed, speeds.least_kmh), 3)} km/h up"


def _how(speeds: SpeedRange, points: Sequence[OperatingPoint]) -> str:
    own = list(dict.fromkeys(line.law for line in speeds.lines if not line.tuned))
    told = f" The design was not tuned for the law {own[0]}, which this report is about." if own else ""
    source = source_at(points[0])
    if source != PUBLISHED:
        told += f" {points[0].adhesion} is the law {law_words(points[0].law, source)}, not the published one."
    return (
        "The loop is linearised at each speed in turn, the speed frozen, at the slip ratio of the table below"
        f"{_other_slips(speeds, points)}; the dead time is exact. The speed at which stability ends is found by "
        "bisection. A train slows down through these speeds, so that a loop that is unstable only below some speed is "
        f"lost only if it is there for long enough: what a whole stop does is in the runs.{told}"
    )


def _other_slips(speeds: SpeedRange, points: Sequence[OperatingPoint]) -> str:
    """Which laws are not at the slips asked for, but at the published reference slips."""
    asked = {(point.rail, point.slip) for point in points}
    other = list(dict.fromkeys(line.law for line in speeds.lines if (line.rail, line.slip) not in asked))
    if not other:
        return ""
    slips = list(dict.fromkeys(f"{point.slip:g}" for point in points))
    laws = f"the law{'s' if len(other) > 1 else ''} {listed(other)} at the published reference slips"
    return f": {laws}, not at the {listed(slips)} of the operating points asked for"


def _worst(ms: float) -> str:
    """The largest of many Ms, rounded up as every worst Ms is, with a digit more, as it was tuned to a limit."""
    return "unstable" if math.isinf(ms) or math.isnan(ms) else above(ms, 4)


def _name(line: RangeLine, speeds: SpeedRange) -> tuple[str, str, str]:
    return line.law, str(line.rail), load_words(line, speeds)


def _ms_table(speeds: SpeedRange) -> Table:
    rows = [
        (
            *_name(line, speeds),
            f"{line.slip:g}",
            *(_cell(line, speed) for speed in speeds.shown_kmh),
            _end(line.stable_from, line),
            _end(line.robust_from, line),
        )
        for line in speeds.lines
    ]
    head = (
        "Law",
        "Rail",
        "Load",
        "Slip, -",
        *(f"{speed:g}" for speed in speeds.shown_kmh),
        "Stable from",
        f"Ms ≤ {ROBUST_MS:g} from",
    )
    return Table(
        f"Ms of {speeds.name} at each speed, km/h; ×: unstable. Last two columns: the lowest speed, km/h, from which "
        "on "
        "the loop is stable, and robust; ≤: at all speeds.",
        head,
        rows,
        wide=True,
    )


def _cell(line: RangeLine, speed: float) -> str:
    i = line.at(speed)
    return short(float(line.margins.ms[i]), 3) if line.margins.stable[i] else "×"


def _end(speed: float, line: RangeLine) -> str:
    if math.isinf(speed):
        return "none"
    return f"≤ {speed:g}" if speed <= line.speeds_kmh[0] else f"{speed:.2f}"


def _picture(speeds: SpeedRange) -> Picture:
    return Picture(
        RANGE,
        f"{speeds.name}: Ms (top) and phase margin (bottom) over speed, of the worse of empty and loaded. A line ends "
        f"where the loop is unstable, and an upright line marks the speed. Grey: Ms above {ROBUST_MS:g}.",
        f"Ms and phase margin over speed, a line a law and rail. {range_finding(speeds)}",
    )


def _worst_table(speeds: SpeedRange) -> Table:
    """The worst of all lines at each speed."""
    rows: list[tuple[str, ...]] = []
    for speed in speeds.shown_kmh:
        at = [(line, line.at(speed)) for line in speeds.lines]
        stable = [(line, i) for line, i in at if line.margins.stable[i]]
        count = f"{len(stable)} of {len(at)}"
        if not stable:
            rows.append((f"{speed:g}", count, *(NONE,) * 6))
            continue
        line, i = max(stable, key=lambda pair: float(pair[0].margins.ms[pair[1]]))
        of = line.margins
        values = (of.ms[i], of.gain_decrease[i], of.gain_increase[i], of.phase_deg[i], of.delay_s[i])
        rows.append(
            (
                f"{speed:g}",
                count,
                *(short(float(x), 3) for x in values),
                f"{line.law}, {line.rail}, {load_words(line, speeds)}",
            )
        )
    head = ("Speed, km/h", "Stable", "Ms", "Gain −", "Gain +", "Phase, deg", "Delay, s", "Worst of the stable ones")
    return Table(f"Margins of {speeds.name} at each speed, of the stable loop with the largest Ms.", head, rows)


def _end_table(ends: list[SlowEnd]) -> Table:
    first = ends[0]
    rows = [
        (str(end.rail), end.law, what, load_of(mass, end.controlled), *_end_cells(group))
        for end in ends
        for what, runs in (
            ("with it", end.controlled),
            ("with it, undisturbed", end.undisturbed),
            (f"{short(end.torque)} N·m held", end.handed_over),
        )
        for mass, group in _by_mass(runs)
    ]
    head = (
        "Rail", "Law", f"Below {first.from_kmh:g} km/h", "Load", "Runs",
        f"Highest slip down to {first.usual_kmh:g} km/h, -", f"down to {first.least_kmh:g} km/h, -",
        "Slip over twice its reference from, km/h", "Locked", "Locked from, km/h",
    )  # fmt: skip
    return Table(
        f"The end of the stop, continued to {first.least_kmh:g} km/h: with the controller, the same without random "
        f"force and caliper torque, and handed over at {first.from_kmh:g} km/h to a held torque. Slips and speeds are "
        "the highest of the runs, read from every step.",
        head,
        rows,
        wide=True,
    )


def _by_mass(runs: Sequence[SlowRun]) -> list[tuple[float, list[SlowRun]]]:
    masses = dict.fromkeys(one.mass for one in runs)
    return [(mass, [one for one in runs if one.mass == mass]) for mass in masses]


def _end_cells(runs: Sequence[SlowRun]) -> tuple[str, ...]:
    locked = [one.locked_kmh for one in runs if one.locks]
    beyond = [one.beyond_kmh for one in runs if not math.isnan(one.beyond_kmh)]
    return (
        str(len(runs)),
        short(max(one.highest_slip_usual for one in runs), 3),
        short(max(one.highest_slip for one in runs), 3),
        short(max(beyond), 3) if beyond else "never",
        str(len(locked)),
        short(max(locked), 3) if locked else "never",
    )
