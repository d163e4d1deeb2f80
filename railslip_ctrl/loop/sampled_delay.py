"""The least dead time that, added to a stable sampled loop, puts a closed-loop pole on the unit circle.

The dead time is turns - 1 + fraction periods, and theta the pole's angle: the least root of L = -1 over boxes of theta
and fraction, each carrying the first turns at which it may hold one. The box that promises the earliest root is looked
at first, and parted, narrowed to where an interval Newton step leaves room, or dropped, until it is its root.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .sampled_boxes import BoxedResponse, Expansion
from .sampled_system import SampledSystem

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# What the phase counts against ln|L| when a box is parted: by ln|L| a box can go for good, by the phase for one turn.
_OF_PHASE = 0.01
_AT_ONCE = 64  # boxes looked at together, those first in line
_MOST_BOXES = 20_000  # seconds; the loop then has |L| = 1 nearly everywhere
_TURNS_TRIED = 50  # at a time
_SHARP = 1.5e-12  # bound on ln L at which the rest of it is rounding
_TINY = 1e-9  # a box this small that still may hold a root does: two poles touch the circle there, or nearly
_SAME = 1e-9  # of the margin: a root nearer than this to another is that one


class Boxes(NamedTuple):
    """Middles and half widths, turns, whether no other turns count, and the least dead time, in periods; (n,) each."""

    theta: Floats
    half: Floats
    fraction: Floats
    half_fraction: Floats
    turns: Floats
    only: Bools
    least: Floats

    def at(self, index: NDArray[np.intp] | Bools) -> Boxes:
        """Those of an index."""
        return Boxes._make(each[index] for each in self)


def added_delay(loop: SampledSystem) -> tuple[float, float]:
    """Least added dead time at which stability is lost, s, and the frequency of the pole, rad/s; inf and NaN if never.

    Never: |L| < 1 at all fractions but for frequencies below 1e-5 of the slowest pole or zero; or not within the dead
    time that turns those by a quarter. Where 20 000 boxes decide nothing, the dead time up to which no loss is certain.
    """
    response, begin = BoxedResponse(loop), loop.dead_time / loop.period
    edges = response.first_edges()
    boxes, last = _first_boxes(edges, loop.held.periods, loop.held.fraction), math.pi / 2 / edges[0]
    found, looked_at = (math.inf, math.nan), 0
    while boxes.least.size and looked_at < _MOST_BOXES:
        order = np.argsort(boxes.least, kind="stable")
        now, later = boxes.at(order[:_AT_ONCE]), boxes.at(order[_AT_ONCE:])
        looked_at += now.least.size
        parts, roots = _part(response, now, begin)
        found = min([found, *roots])
        last = min(last, found[0] - _SAME * (found[0] - begin))
        boxes = Boxes._make(np.concatenate(each) for each in zip(later, *parts, strict=True))
        boxes = boxes.at(boxes.least < last)
    # what is left, if anything, may hold an earlier one
    found = min([found, *zip(boxes.least.tolist(), boxes.theta.tolist(), strict=True)])
    return (found[0] - begin) * loop.period, found[1] / loop.period


def _first_boxes(edges: Floats, periods: int, own: float) -> Boxes:
    """All frequencies by all fractions, those before the loop's own a turn later."""
    half, boxes = np.diff(edges) / 2, []
    for early, late, turns in ((0.0, own, periods + 2), (own, 1.0, periods + 1)):
        if late > early:
            constants = (early + late) / 2, (late - early) / 2, turns, False, turns - 1 + early
            boxes.append(Boxes._make([edges[:-1] + half, half, *(np.full(half.size, each) for each in constants)]))
    return Boxes._make(np.concatenate(each) for each in zip(*boxes, strict=True))


class Step(NamedTuple):
    """Where from the middle of a box a root would be by the linear part, and how far from there it can be; (n,)."""

    theta: Floats
    theta_room: Floats
    fraction: Floats
    fraction_room: Floats


def _part(response: BoxedResponse, boxes: Boxes, begin: float) -> tuple[list[Boxes], list[tuple[float, float]]]:
    """Parts of the boxes that may hold a root after `begin`, and (dead time, theta) of the roots found, in periods."""
    expansion = response.expand(boxes.theta, boxes.fraction)
    top, rest, level = expansion.bounds(boxes.half, boxes.half_fraction)
    still = expansion.bounds(boxes.half)[2]
    with np.errstate(invalid="ignore"):
        across = np.abs(expansion.drift.real) * boxes.half_fraction + level
        alive = (top >= 0) & ~(np.abs(expansion.value.real) > np.abs(expansion.slope.real) * boxes.half + across)
        boxes, step, alive = _next_turns(expansion, boxes, rest, across, alive)
        lag = np.minimum(np.abs(expansion.slope.imag - boxes.turns) * boxes.half, math.pi)
        turning = np.abs(expansion.slope.real) * boxes.half + still + _OF_PHASE * lag
        drifting = across - still + _OF_PHASE * np.abs(expansion.drift.imag) * boxes.half_fraction
    tiny = (boxes.half < _TINY * boxes.theta) & (boxes.half_fraction < _TINY)
    done = alive & ((rest < _SHARP) & np.isfinite(step.fraction_room) | tiny)
    dead_time = np.where(np.isfinite(step.fraction_room), boxes.turns - 1 + boxes.fraction + step.fraction, boxes.least)
    theta = np.minimum(boxes.theta + step.theta, math.pi)
    roots = [(float(dead_time[i]), float(theta[i])) for i in np.flatnonzero(done & (dead_time > begin))]
    # where the step leaves less than half of a box, the rest of it is for later turns only
    narrow = alive & ~done & (step.fraction_room < boxes.half_fraction / 2)
    later = boxes._replace(turns=boxes.turns + 1, least=boxes.turns + boxes.fraction - boxes.half_fraction)
    parts = [_narrowed(boxes, step).at(narrow), later.at((narrow | done) & ~boxes.only)]
    along = np.isinf(still) | (turning >= drifting)
    for way in (-0.5, 0.5):
        half = boxes._replace(theta=boxes.theta + way * boxes.half, half=boxes.half / 2)
        parts.append(half.at(alive & ~done & ~narrow & along))
        half = boxes._replace(
            fraction=boxes.fraction + way * boxes.half_fraction, half_fraction=boxes.half_fraction / 2
        )
        half = half._replace(least=np.maximum(boxes.least, boxes.turns - 1 + half.fraction - half.half_fraction))
        parts.append(half.at(alive & ~done & ~narrow & ~along))
    return parts, roots


def _next_turns(
    expansion: Expansion, boxes: Boxes, rest: Floats, across: Floats, alive: Bools
) -> tuple[Boxes, Step, Bools]:
    """The first turns, from their own on, at which each box may hold a root, with the interval Newton step there."""
    size, phase = expansion.value.real, expansion.value.imag - math.pi
    rise, drift, turns = expansion.slope.real, expansion.drift, boxes.turns
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # where in theta |L| may be 1
        room, to = across / np.abs(rise), -size / rise
        tight = room < boxes.half
        low = np.where(tight, np.maximum(to - room, -boxes.half), -boxes.half)
        high = np.where(tight, np.minimum(to + room, boxes.half), boxes.half)
        for _ in range(_TURNS_TRIED):
            lag = expansion.slope.imag - turns
            off = phase - turns * boxes.theta + lag * (low + high) / 2
            off -= 2 * math.pi * np.round(off / (2 * math.pi))
            wide = np.abs(lag) * (high - low) / 2 + np.abs(drift.imag) * boxes.half_fraction + rest
            middle = off - lag * (low + high) / 2
            det = rise * drift.imag - drift.real * lag
            sure = (wide < math.pi) & (np.abs(det) > 0)
            step = Step(
                np.where(sure, (drift.real * middle - drift.imag * size) / det, 0.0),
                np.where(sure, rest * (np.abs(drift.real) + np.abs(drift.imag)) / np.abs(det), np.inf),
                np.where(sure, (lag * size - rise * middle) / det, 0.0),
                np.where(sure, rest * (np.abs(rise) + np.abs(lag)) / np.abs(det), np.inf),
            )
            fits = (np.abs(off) <= wide) | ~np.isfinite(wide)
            fits &= np.abs(step.theta) <= boxes.half * (1 + _TINY) + step.theta_room
            fits &= np.abs(step.fraction) <= boxes.half_fraction * (1 + _TINY) + step.fraction_room
            alive = alive & (fits | ~boxes.only)
            if not (alive & ~fits).any():
                break
            # a turn more lowers the phase by theta
            gap = np.where(np.abs(off) <= wide, 0.0, np.mod(off - wide, 2 * math.pi))
            skipped = np.maximum(1.0, np.ceil(gap / (boxes.theta + high) - _TINY))
            turns = np.where(alive & ~fits, turns + skipped, turns)
    step = step._replace(fraction_room=np.where(fits, step.fraction_room, np.inf))
    first = boxes.fraction - boxes.half_fraction
    least = np.maximum(first, boxes.fraction + step.fraction - step.fraction_room)
    return boxes._replace(turns=turns, least=np.maximum(boxes.least, turns - 1 + least)), step, alive


def _narrowed(boxes: Boxes, step: Step) -> Boxes:
    """The part of each box that its step leaves, for its turns alone."""

    def ends(half: Floats, to: Floats, room: Floats) -> tuple[Floats, Floats]:
        low, high = np.clip(to - room, -half, half), np.clip(to + room, -half, half)
        return (low + high) / 2, (high - low) / 2

    turned, half = ends(boxes.half, step.theta, step.theta_room)
    later, half_fraction = ends(boxes.half_fraction, step.fraction, step.fraction_room)
    return boxes._replace(
        theta=boxes.theta + turned,
        half=half,
        fraction=boxes.fraction + later,
        half_fraction=half_fraction,
        only=np.ones_like(boxes.only),
    )
