"""Certainty about gains: a root count in balls alone, and a whole rectangle of PI gains that stabilises.

The gains with a pole at j omega are those with ki + j omega kp = R(omega), R = -j omega/P(j omega): one pair a
frequency. If R keeps out of the rectangle at every omega > 0 and one of its points is stable, all are.
"""

from __future__ import annotations

import math

import numpy as np
from flint import arb, ctx

from railslip_ctrl.core.arguments import number, numbers
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.crossings import SIZE, ExactLoop, Response
from railslip_ctrl.loop.stability import root_count

from .intervals import Interval

_BITS = 80
_OUTWARD = 16.0  # factor by which the ends of the frequencies looked at move out until a bound holds beyond them
_MOST_PARTS = 5_000


def certainly_stable(loop: DeadTimeLoop) -> bool:
    """Whether every closed-loop pole lies left of the imaginary axis, by balls alone."""
    return root_count(Response(loop.system, loop.dead_time), certain=True).stable


def certain_rectangle(plant: Rational, dead_time: float, kp: Interval, ki: Interval) -> bool:
    """Whether (kp + ki/s) plant(s) exp(-dead_time s) is shown to be stable for all gains of a closed rectangle."""
    for name, ends, least in (("kp", kp, None), ("ki", ki, 0.0)):
        low, high = numbers(name, ends).tolist() if np.shape(ends) == (2,) else (math.nan, math.nan)
        if math.isnan(low):
            raise InputError(f"{name}: {ends!r} is not allowed; give two finite ends, the lower first")
        number(name, low, gt=least)
        if number(name, high) < low:
            raise InputError(f"{name}: from {low:g} to {high:g} is not allowed; give ascending ends")
    middle = (sum(kp) / 2, sum(ki) / 2)
    controller = Rational.from_polynomials([*middle], [1.0, 0.0])
    if not certainly_stable(DeadTimeLoop(controller * plant, dead_time)):
        return False
    integrated = Response(plant * Rational(np.array([]), np.array([0.0]), 1.0), dead_time)
    with ctx.workprec(_BITS):
        band = _band(Response(plant, dead_time), integrated, kp, ki)
        return band is not None and _keeps_out(integrated, *band, kp, ki)


def _band(plant: Response, integrated: Response, kp: Interval, ki: Interval) -> Interval | None:
    """Frequencies below and above which no gain of the rectangle puts a pole on the axis; None if none are found.

    Below, |R| = 1/|P/s| < ki; above, |P| (|kp| + ki/omega) < 1. Both are monotone there.
    """
    low, high = _ends(integrated)[0], _ends(plant)[1]
    most = max(abs(kp[0]), abs(kp[1]))
    for _ in range(60):
        below = 1 / abs(integrated.exact.value(arb(low))[0]) < ki[0]
        size = abs(plant.exact.value(arb(high))[0])
        beyond = size.max(arb(abs(plant.system.feedthrough))) * (most + arb(ki[1]) / high) < 1
        if below and beyond:
            return low, high
        low, high = (low if below else low / _OUTWARD), (high if beyond else high * _OUTWARD)
    return None


def _ends(response: Response) -> Interval:
    """A frequency below and one above all at which |L| turns back, jumps or vanishes."""
    roots = np.concatenate([response.system.zeros, response.system.poles])
    found = [float(w.mid()) for w, _ in ExactLoop(response.system, response.dead_time).frequencies(SIZE)]
    found += np.abs(roots[roots != 0]).tolist()
    return (min(found) / 2, max(found) * 2) if found else (1.0, 1.0)


def _keeps_out(integrated: Response, low: float, high: float, kp: Interval, ki: Interval) -> bool:
    """Whether R stays out of the rectangle between two frequencies, rad/s."""
    left, parts = [(low, high)], 0
    while left:
        a, b = left.pop()
        parts += 1
        middle = math.sqrt(a * b)
        if parts > _MOST_PARTS or not a < middle < b:
            return False
        if not _outside(integrated, a, middle, b, kp, ki):
            left += [(a, middle), (middle, b)]
    return True


def _outside(integrated: Response, low: float, middle: float, high: float, kp: Interval, ki: Interval) -> bool:
    """Whether a disc that holds R over a part lies beside the rectangle."""
    value, slope = integrated.exact.value(arb(middle))
    half = arb(max(high - middle, middle - low)) * (1 + arb(2) ** -50)
    r = -1 / value
    radius = abs(r) * (half * abs(slope) + half * half / 2 * _bend(integrated, low, high)).expm1()
    if not radius.is_finite():
        return False
    beside = r.real + radius < ki[0] or r.real - radius > ki[1]
    below = r.imag + radius < min(kp[0] * low, kp[0] * high)
    return bool(beside or below or r.imag - radius > max(kp[1] * low, kp[1] * high))


def _bend(response: Response, low: float, high: float) -> arb:
    """A bound on |d^2 ln L/d omega^2| over a part."""
    bound = float(response.bend(np.array([low]), np.array([high]))[0])
    return arb(bound * (1 + 1e-12))  # a sum of positive terms in doubles
