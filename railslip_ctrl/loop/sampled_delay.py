"""Bounds on ln L of a sampled loop over boxes of frequency and fraction of the period, and the delay margin by them.

With z = exp(j theta), m = 1 - fraction and turns = 1 + whole periods of dead time the response is (the modified
z-transform, [Astrom1997] 2)

    L = K(z) c (z - Phi)^-1 (G(1) + (z - 1) G(m)) z^-turns,    G(m) = integral of exp(a s) b over [0, m].

Its numerator is a polynomial in z, and G is entire: the sizes of the Taylor coefficients at the middle of a box,
summed, bound what ln L is from its linear part anywhere in the box.

The dead time is turns - 1 + fraction periods, and theta the pole's angle: the delay margin is the least root of L = -1
over boxes, each carrying the first turns at which it may hold one. The box that promises the earliest root is looked
at first, and parted, narrowed to where an interval Newton step leaves room, or dropped, until it is its root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]

ROUNDING = 1e-12  # of ln L, many times what is seen
# Slower than this share of the slowest pole or zero L is its asymptote, and a crossover is rounding of |L(0)| = 1.
_BELOW_FEATURES = 1e-5
_CELL_RATIO = 1.5
# What the phase counts against ln|L| when a box is parted: by ln|L| a box can go for good, by the phase for one turn.
_OF_PHASE = 0.01
_AT_ONCE = 64  # boxes looked at together, those first in line
_MOST_BOXES = 20_000  # seconds; the loop then has |L| = 1 nearly everywhere
_TURNS_TRIED = 50  # at a time
_SHARP = 1.5e-12  # bound on ln L at which the rest of it is rounding
_TINY = 1e-9  # a box this small that still may hold a root does: two poles touch the circle there, or nearly
_SAME = 1e-9  # of the margin: a root nearer than this to another is that one


@dataclass(frozen=True)
class Expansion:
    """ln(L z^turns) about the middles of boxes: `value`, and its slopes to theta and to the fraction, complex, (n,).

    `near` holds the reciprocal distances to poles and zeros, (n, roots), with `signs` 1 for a zero and -1 for a pole;
    `taylor` the numerator's Taylor coefficients in z over its value, (n, order + 1), `drifts` those of its derivative
    to 1 - fraction, `follows` how each follows the components of G, (n, order + 1, order).
    """

    of: BoxedResponse
    fraction: Floats
    turn: Complexes
    value: Complexes
    slope: Complexes
    drift: Complexes
    near: Floats
    signs: Floats
    taylor: Complexes
    drifts: Complexes
    follows: Complexes

    def bounds(self, half: Floats, half_fraction: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """The largest ln|L| in the boxes; the largest distances of ln L and of ln|L| from their linear parts; or inf.

        `half` and `half_fraction` are half the widths, (n,). The second holds for complex theta in the disk of radius
        `half` too. The third is far less at low frequency, where a delay turns L and leaves |L| as it is.
        """
        # each power of z - middle by its size; in the third the first power by its part along the circle
        reach = np.expm1(half)  # |z - middle|
        powers: Floats = reach[:, None] ** np.arange(self.taylor.shape[1])
        powers[:, 0] = 0.0
        beyond = powers.copy()
        beyond[:, 1] = reach - half
        moved, curved = (np.abs(self.taylor) * powers).sum(axis=1), (np.abs(self.taylor) * beyond).sum(axis=1)
        linear = np.abs(self.taylor[:, 1]) * half
        if half_fraction is not None:
            bend = self.of.bend(self.fraction, half_fraction)[:, :, None]
            along = np.stack([self.follows[:, 0], self.follows[:, 1] * self.turn[:, None]], axis=1)
            bent, sideways = (np.abs(self.follows) @ bend)[:, :, 0], (np.abs(along.real) @ bend)[:, :, 0]
            drifts = np.abs(self.drifts) * half_fraction[:, None]
            moved += drifts[:, 0] + bent[:, 0] + ((drifts + bent) * powers).sum(axis=1)
            curved += sideways[:, 0] + ((drifts + bent) * beyond).sum(axis=1)
            curved += half * (sideways[:, 1] + np.abs((self.drifts[:, 1] * self.turn).real) * half_fraction)
            linear = linear + drifts[:, 0]
        apart = np.minimum(self.near * reach[:, None], 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            roots, log = -np.log1p(-apart), -np.log1p(-np.minimum(moved, 1))
            top = self.value.real + np.where(self.signs > 0, np.log1p(apart), roots).sum(axis=1) + np.log1p(moved)
            apart = roots.sum(axis=1) - self.near.sum(axis=1) * half
            found = np.array([top, log - linear + apart, log - moved + curved + apart]) + ROUNDING
        top, rest, level = np.where(np.isnan(found), np.inf, found)
        return top, rest, level


class BoxedResponse:
    """The response of a `SampledLoop` as its expansions need it; time is counted in periods."""

    def __init__(self, loop: Any) -> None:
        self._held, self._controller = loop.held, loop.controller
        held = self._held
        self._a, self._b, self._c, self._growth = held.a, held.b, held.c, held.growth
        n = held.c.size
        self._plant_poles = np.expm1(loop.plant.poles * loop.period)
        poles = np.concatenate([self._plant_poles, loop.controller.poles - 1])
        self._roots = np.concatenate([poles, loop.controller.zeros - 1])  # of z - 1
        self._signs = np.repeat([-1.0, 1.0], [poles.size, loop.controller.zeros.size])
        # [[bound, 1, 0], [0, 0, 1], [0, 0, 0]] with |exp(a m)| <= exp(bound m): its exponential holds the integrals
        self._bound = np.diag(np.ones(2 * n), n)
        self._bound[:n, :n] = np.where(np.eye(n) > 0, held.a, np.abs(held.a))
        self._whole = self._reached(np.ones(1))[0]
        self._slowest = min(np.pi, float(loop.feature_frequencies.min(initial=np.inf)) * loop.period)

    def first_edges(self) -> Floats:
        """Values of theta from which to part further, from far below the slowest pole or zero to pi."""
        low = _BELOW_FEATURES * self._slowest
        return np.geomspace(low, np.pi, 2 + int(np.log(np.pi / low) / np.log(_CELL_RATIO)))

    def _reached(self, m: Floats) -> Floats:
        """G(m), (n, order)."""
        return np.asarray(self._held.flow(m)[:, :-1, -1])

    def bend(self, fraction: Floats, half: Floats) -> Floats:
        """Bound on what G is from linear about `fraction` within `half`, by components, (n, order)."""
        from scipy.linalg import expm

        n, (halves, at) = self._c.size, np.unique(half, return_inverse=True)
        with np.errstate(over="ignore", invalid="ignore"):
            powers = expm(self._bound * halves[:, None, None])[at]
        once, twice = powers[:, :n, n : 2 * n], powers[:, :n, 2 * n :]
        ends, at = np.unique(1 - np.stack([fraction, fraction + half]), return_inverse=True)
        # |G''| at the middle, and where m is least: from each on exp(a m) is less than exp of the bounding matrix
        curved = np.abs((self._reached(ends) @ self._a.T + self._b) @ self._a.T)[at.reshape(2, -1)][..., None]
        after, before = twice @ curved[0], (half[:, None, None] * once - twice) @ curved[1]
        return np.asarray(np.maximum(after, before)[:, :, 0])

    def expand(self, theta: Floats, fraction: Floats) -> Expansion:
        """The expansion about points, theta in rad per period and the fraction, (n,) each."""
        n, beyond = self._c.size, np.expm1(1j * theta)
        fractions, at = np.unique(fraction, return_inverse=True)
        reached = self._reached(1 - fractions)[at]
        speed = reached @ self._a.T + self._b  # G' = a G + b
        near = 1 / (beyond[:, None] - self._roots)
        resolvent = np.linalg.inv(beyond[:, None, None] * np.eye(n) - self._growth)
        # c adj(z - Phi)/det(middle - Phi) by powers of z - middle: the resolvent's series times its denominator
        rows = np.zeros((theta.size, n + 1, n), dtype=complex)
        row = self._c @ resolvent
        for k in range(n):
            rows[:, k] = row
            row = -(row[:, None] @ resolvent)[:, 0]
        for k in range(n):
            rows[:, 1:n] += rows[:, : n - 1] * near[:, k, None, None]
        through = rows * beyond[:, None, None]
        through[:, 1:] += rows[:, :-1]
        numerator = rows @ self._whole + (through @ reached[:, :, None])[:, :, 0]
        drift = (through @ speed[:, :, None])[:, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = numerator / numerator[:, :1]
            drifts = drift / numerator[:, :1]
            return Expansion(
                of=self,
                fraction=fraction,
                turn=1j * np.exp(1j * theta),
                value=np.log(self._controller(np.exp(1j * theta)) * numerator[:, 0]),
                slope=1j * np.exp(1j * theta) * (relative[:, 1] + near @ self._signs),
                drift=-drifts[:, 0],
                near=np.abs(near),
                signs=self._signs,
                taylor=relative,
                drifts=drifts,
                follows=through / numerator[:, :1, None],
            )


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


def added_delay(loop: Any) -> tuple[float, float]:
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
