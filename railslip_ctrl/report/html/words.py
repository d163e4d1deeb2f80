"""Findings in words that more than one place of the report says: controllers, stops, what ends at low speed."""

from __future__ import annotations

import math
from collections.abc import Sequence

from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.design_report import DesignReport, RangeLine, SlowEnd, SlowRun, SpeedRange, Stop, StopRun
from railslip_ctrl.simulation import Run
from railslip_ctrl.simulation.clairvoyant import ClairvoyantStop

from .numbers import above, below, listed, short

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


def outcome_words(one: StopRun) -> str:
    """What became of a controller's runs: of the one that is shown, or the seeds with which the train does not stop."""
    assert one.run is not None, "only runs are told"
    if one.stops or not one.run.stopped:
        return one.run.outcome.value
    return f"does not stop with noise {seeds_words(one.endless_seeds)}"


def seeds_words(seeds: Sequence[int]) -> str:
    """Noise seeds by number."""
    return f"seed{'s' if len(seeds) > 1 else ''} {listed(map(str, seeds))}"


def locks_elsewhere(report: DesignReport, one: StopRun, stop: Stop) -> str:
    """That a controller locks the wheel on another rail than that of a stop, if so; to be appended."""
    rails = [str(rail) for rail in report.locks_on(one.name) if rail is not stop.scenario.rail]
    return f" (locks on {listed(rails)} rail)" if rails and not stop.scenario.events else ""


def distance_spread(one: StopRun) -> str:
    """Braking distance, with its range over the noise seeds where several were run; of a train that stops with all."""
    assert one.run is not None, "only runs are told"
    told = f"{short(one.run.braking_distance, 4)} m"
    if len(one.distances) < 2:
        return told
    low, high = (short(end, 4) for end in (min(one.distances), max(one.distances)))
    return f"{told} ({low} to {high} m over {len(one.distances)} noise seeds)"


def distances(one: StopRun) -> str:
    """Braking distance, with both its ends where it changes much between noise seeds; "no stop" if with one of them."""
    assert one.run is not None, "only runs are told"
    if not one.stops:
        return "no stop"
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
    return load_of(line.mass, speeds.lines)


def load_of(mass: float, among: Sequence[RangeLine] | Sequence[SlowRun]) -> str:
    """A mass, kg, in a word, where there are two."""
    masses = {one.mass for one in among}
    if len(masses) == 1:
        return f"M {mass:g} kg"
    return "empty" if mass == min(masses) else "loaded"


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
    """What the controller's continued stops do at the end, and what of it the disturbances do."""
    first, told = ends[0], [f"{end.rail} rail, law {end.law}: {_slow_word(end)}" for end in ends]
    text = (
        f"Runs continued with it from {first.from_kmh:g} down to {first.least_kmh:g} km/h, {_how_many(first)}: "
        f"{'; '.join(told)}."
    )
    if any(_lock_is_the_disturbance(end) for end in ends):
        text += (
            " A wheel that locks in these runs and not in the undisturbed one is locked by the disturbance: a force "
            "moves the slip velocity by as much at any speed, and the slip ratio by the more the slower the train is."
        )
    return text


def _slow_word(end: SlowEnd) -> str:
    locked = [one.locked_kmh for one in end.controlled if one.locks]
    beyond = [one.beyond_kmh for one in end.controlled if not math.isnan(one.beyond_kmh)]
    if not beyond:
        return f"slip at most {short(_highest(end.controlled), 2)}, no lock"
    text = f"slip over twice its reference from {short(max(beyond), 2)} km/h at the highest"
    text += f", {_locks(locked, len(end.controlled))}" if locked else ", no lock"
    quiet = [one.locked_kmh for one in end.undisturbed if one.locks]
    alone = _locks(quiet, len(end.undisturbed)) if quiet else f"slip at most {short(_highest(end.undisturbed), 2)}"
    return f"{text} (undisturbed: {alone})"


def _locks(speeds: Sequence[float], count: int) -> str:
    return f"locked in {len(speeds)} of {count}, from {short(max(speeds), 2)} km/h at the highest"


def _lock_is_the_disturbance(end: SlowEnd) -> bool:
    return any(one.locks for one in end.controlled) and not any(one.locks for one in end.undisturbed)


def _highest(runs: Sequence[SlowRun]) -> float:
    return max(one.highest_slip for one in runs)


def _how_many(end: SlowEnd) -> str:
    """Of how many runs the numbers of an end are."""
    seeds, masses = ({getattr(one, what) for one in end.controlled} for what in ("seed", "mass"))
    return f"{len(seeds)} noise seeds{', empty and loaded' if len(masses) > 1 else ''}"


def policy_words(ends: Sequence[SlowEnd]) -> str:
    """The torque to hold in place of slip control, what came of it, and whether that is advice."""
    first = ends[0]
    runs = [(end, one) for end in ends for one in end.handed_over]
    early = [end for end in ends if end.held_locks_at > end.usual_kmh]
    held = f"from {first.from_kmh:g} km/h down slip control handed over to {short(first.torque)} N·m held in its place"
    highest = max(one.highest_slip_usual for _, one in runs)
    found = f"slip ratio at most {short(highest, 2)} down to {first.usual_kmh:g} km/h"
    if early:
        where = [f"{end.rail} rail, law {end.law}, from {short(end.held_locks_at, 2)} km/h" for end in early]
        tried = f"{held}; locked on {'; on '.join(where)}; {found}"
        return f"The design has no policy of its own there. Tried, and no remedy: {tried}. {_instead(ends)}"
    late = [one.locked_kmh for _, one in runs if one.locks]
    below = f"; below, {_locks(late, len(runs))}" if late else f", and no lock down to {first.least_kmh:g} km/h"
    return (
        f"The design has no policy of its own there. Use: {held}, the torque that it begins with. In the same runs "
        f"with that hand-over no wheel locks above {first.usual_kmh:g} km/h, {found}{below}."
    )


def _instead(ends: Sequence[SlowEnd]) -> str:
    """What follows where the torque held locks the wheel before the usual end: what keeps it rolling longest."""
    first = ends[0]
    held = max(end.held_locks_at for end in ends if not math.isnan(end.held_locks_at))
    alone = max((end.locks_at for end in ends if end.locks_at > end.usual_kmh), default=math.nan)
    if math.isnan(alone):
        beyond = max((end.lost_at for end in ends if not math.isnan(end.lost_at)), default=math.nan)
        slips = "" if math.isnan(beyond) else f", though slip passes twice its reference from {above(beyond, 2)} km/h"
        return f"What follows: leave slip control on; its own runs lock no wheel above {first.usual_kmh:g} km/h{slips}."
    control, torque = f"slip control down to {above(alone, 2)} km/h", f"the torque held down to {above(held, 2)} km/h"
    best, other = (control, torque) if alone <= held else (torque, control)
    return (
        f"What follows: use {best}, which keeps the wheel rolling longest ({other}). Below "
        f"{above(min(alone, held), 2)} km/h neither does, and slip control by this brake has to hand over to a limit "
        f"of the brake itself: {_torque_limit(ends)}."
    )


def _torque_limit(ends: Sequence[SlowEnd]) -> str:
    """The torque to stay below, from the friction there is; where that is enough for the torque held, that one."""
    least = min((end for end in ends if not math.isnan(end.held_locks_at)), key=lambda end: end.torque_there)
    asks = (
        f"the {short(least.torque, 3)} N·m held ask for an adhesion coefficient of {short(least.friction_needed, 2)}, "
        f"where {least.rail} rail has at most {short(least.friction_there, 2)} by the law {least.law} at rest, "
        f"{least.from_kmh:g} km/h"
    )
    if least.friction_needed >= least.friction_there:
        return f"a torque below {below(least.torque_there, 2)} N·m; {asks}"
    return (
        f"a torque below the {short(least.torque, 3)} N·m held, which runs have to find (railslip simulate), as "
        f"friction at rest does not tell it: {asks}, and it locks nevertheless"
    )
