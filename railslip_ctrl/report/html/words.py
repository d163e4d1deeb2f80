"""Findings in words that more than one place of the report says: controllers, stops, what ends at low speed."""

from __future__ import annotations

import math
from collections.abc import Sequence

from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.design_report import RangeLine, SlowEnd, SpeedRange, StopRun
from railslip_ctrl.simulation import Run
from railslip_ctrl.simulation.clairvoyant import ClairvoyantStop

from .numbers import above, listed, short

USUAL_END_KMH = 5.0
"""Where the stops of the tables end, as those of [Park2008]."""

_MUCH = 1.03  # of the shortest distance, that the longest is


def controller_words(controller: PIController) -> str:
    """Gains and lead."""
    text = f"kp {short(controller.gains.kp)} N·m/(m/s), ki {short(controller.gains.ki)} N·m/m"
    if controller.lead > 0:
        text += f", behind the lead ({controller.lead:g} s + 1)/({controller.lead_filter:g} s + 1)"
    return text


def reference_of(run: Run) -> float:
    """The slip ratio that the controller of a run without a change of rail holds."""
    return float(getattr(run.controller.reference, run.scenario.rail.value))


def distance_spread(one: StopRun) -> str:
    """Braking distance with its range over the noise seeds where several were run."""
    assert one.run is not None, "only runs are told"
    told = f"{short(one.run.braking_distance, 4)} m"
    if len(one.distances) < 2:
        return told
    low, high = (short(end, 4) for end in (min(one.distances), max(one.distances)))
    return f"{told} ({low} to {high} m over {len(one.distances)} noise seeds)"


def distances(one: StopRun) -> str:
    """Braking distance, with both its ends where it changes much between noise seeds."""
    assert one.run is not None, "only runs are told"
    ends = [short(end, 3) for end in (min(one.distances, default=0.0), max(one.distances, default=0.0))]
    much = len(one.distances) > 1 and max(one.distances) > _MUCH * min(one.distances)
    return f"{' to '.join(ends)} m" if much else f"{short(one.run.braking_distance, 3)} m"


def percent_over(run: Run, bound: ClairvoyantStop | None) -> str:
    """By how much a stop is over the least possible on its law; empty without a bound."""
    if bound is None or not math.isfinite(bound.braking_distance):
        return ""
    over = 100 * (run.braking_distance / bound.braking_distance - 1)
    return f", {over:.0f} % over the least possible {short(bound.braking_distance, 3)} m"


def load_words(line: RangeLine, speeds: SpeedRange) -> str:
    """Which load a line is of."""
    masses = {one.mass for one in speeds.lines}
    if len(masses) == 1:
        return f"M {line.mass:g} kg"
    return "empty" if line.mass == min(masses) else "loaded"


def lost_words(speeds: SpeedRange) -> str:
    """Where stability ends as the train slows down, of every law and rail where it does."""
    ends: dict[tuple[str, str], float] = {}
    for line in speeds.lines:
        if not line.holds_throughout:
            key = (line.law, str(line.rail))
            ends[key] = max(ends.get(key, 0.0), line.stable_from)
    told = [
        f"{'at every speed' if math.isinf(end) else f'below {above(end)} km/h'} on {rail} rail with the law {law}"
        for (law, rail), end in ends.items()
    ]
    return f"the loop is unstable {listed(told)}"


def slow_words(ends: Sequence[SlowEnd]) -> str:
    """What the controller's continued stops do at the end."""
    told = []
    for end in ends:
        beyond = end.first_beyond(2 * end.reference, end.from_kmh)
        where = f"{end.rail} rail, law {end.law}"
        if math.isnan(beyond):
            told.append(f"{where}: slip at most {short(end.highest_slip(end.from_kmh), 2)}, no lock")
        else:
            lock = f"locked from {short(end.locks_at, 2)} km/h" if not math.isnan(end.locks_at) else "no lock"
            told.append(f"{where}: slip over twice its reference from {short(beyond, 2)} km/h, {lock}")
    first = ends[0]
    return f"Runs continued with it from {first.from_kmh:g} down to {first.least_kmh:g} km/h: {'; '.join(told)}."


def policy_words(ends: Sequence[SlowEnd]) -> str:
    """The torque to hold in place of slip control, what came of it, and whether that is advice."""
    first = ends[0]
    locked = [f"{end.rail} rail, law {end.law}" for end in ends if end.cut_out.locked_fraction > 0]
    usual, least = (max(end.highest_slip_cut_out(speed) for end in ends) for speed in (USUAL_END_KMH, first.least_kmh))
    held = f"from {first.from_kmh:g} km/h down slip control cut out and {short(first.torque)} N·m held in its place"
    slips = f"slip ratio at most {short(usual, 2)} down to {USUAL_END_KMH:g} km/h, {short(least, 2)} down to"
    found = f"{slips} {first.least_kmh:g} km/h"
    if locked:
        tried = f"{held}; locked on {listed(locked)}, {found}"
        return f"The design has no policy of its own there. Tried, and no remedy: {tried}."
    return (
        f"The design has no policy of its own there. Use: {held}, the torque that the full-range design begins with. "
        "In "
        f"runs from free rolling no wheel locks with it, {found}."
    )
