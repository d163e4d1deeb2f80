"""An independent check of loops L = G exp(-tau s) by balls and bisection of the axis: python-flint alone.

G is zeros, poles (doubles, taken as exact) and gain. The axis is divided until on each part |L| is certainly below 1,
or above 1, or 1 + L (or what else is asked) certainly is not 0.
"""

from __future__ import annotations

import math
from itertools import zip_longest

from flint import acb, arb, ctx

J = acb(0, 1)
MOST_PARTS = 20_000
_CLIMBS = 12  # parts of the axis from which a peak is looked for
OUTSIDE = 1e-12  # relative: how far beyond its enclosure a margin is certainly used up


class UndecidedError(Exception):
    """The parts became too narrow, or too many."""


class Loop:
    """L on balls; `gain` may be complex (a phase change)."""

    def __init__(self, zeros, poles, gain, tau, square=None):
        self.zeros, self.poles = [acb(complex(z)) for z in zeros], [acb(complex(p)) for p in poles]
        self.gain, self.tau = acb(gain), arb(tau)
        squares = [_square_on_axis(roots) for roots in (self.poles, self.zeros)]
        size = self.gain.real**2 + self.gain.imag**2 if square is None else square
        gap = [d - size * n for d, n in zip_longest(*squares, fillvalue=arb(0))]
        self.gap = gap[next((i for i, c in enumerate(gap) if c != 0), len(gap)) :]
        self.gap_slope = [k * c for k, c in enumerate(self.gap)][1:]
        self.biggest = max([abs(r).upper() for r in [*self.zeros, *self.poles]] + [arb(0)])

    def without_delay(self, s, inverse=False):
        """G at s, or 1/G."""
        above, below = (self.poles, self.zeros) if inverse else (self.zeros, self.poles)
        value = 1 / self.gain if inverse else self.gain
        for a, b in zip_longest(above, below):  # (s - a)/(s - b) = 1 + (b - a)/(s - b) is narrow far from both
            value *= (s - a) if b is None else 1 / (s - b) if a is None else 1 + (b - a) / (s - b)
        return value

    def below_one(self, omega, inverse=False):
        """Whether |L|, or |1/L|, is below 1 for all omega > 0 of a ball: the sign of |D|^2 - |N|^2, expanded."""
        x = omega * omega
        gap = _value(self.gap, x)
        if not (gap > 0 or gap < 0):  # from the middle, with the slope over the ball
            away = x - x.mid()
            gap = _value(self.gap, arb(x.mid())) + _value(self.gap_slope, x) * away
        return gap < 0 if inverse else gap > 0

    def at(self, omega, inverse=False):
        """L(j omega), or 1/L."""
        turn = self.tau * J * omega
        return self.without_delay(J * omega, inverse) * (turn if inverse else -turn).exp()

    def slope(self, omega, inverse=False):
        """dL/d omega, or that of 1/L."""
        s, rate = J * omega, acb(-self.tau)
        for a, b in zip_longest(self.zeros, self.poles):
            rate += -1 / (s - b) if a is None else (a - b) / ((s - a) * (s - b))
        return self.at(omega, inverse) * J * (-rate if inverse else rate)

    def beyond(self, radius, inverse=False):
        """G, or 1/G, on |s| >= radius."""
        u = (1 / radius) * arb(0, 1)
        above, below = (self.poles, self.zeros) if inverse else (self.zeros, self.poles)
        u, value = acb(u, u), 1 / self.gain if inverse else self.gain
        for a, b in zip_longest(above, below):
            if a is None:
                value *= u / (1 - b * u)
            elif b is None:
                return acb(arb(0, math.inf))
            else:
                value *= (1 - a * u) / (1 - b * u)
        return value


def _value(coefficients, x):
    total = arb(0)
    for c in reversed(coefficients):
        total = total * x + c
    return total


def _square_on_axis(roots):
    """Coefficients of |prod(j omega - roots)|^2 in omega^2, ascending; of a pair the upper root stands for both."""
    found = [arb(1)]
    for r in roots:
        a, b = r.real, r.imag
        # |j w - a|^2 = x + a^2; the pair's |a^2 + b^2 - x - 2 a j w|^2 = x^2 + 2 (a^2 - b^2) x + (a^2 + b^2)^2
        factor = (
            [a * a, arb(1)] if b == 0 else [(a * a + b * b) ** 2, 2 * (a * a - b * b), arb(1)] if b > 0 else [arb(1)]
        )
        found = [
            sum((found[i] * factor[k - i] for i in range(len(found)) if 0 <= k - i < len(factor)), arb(0))
            for k in range(len(found) + len(factor) - 1)
        ]
    return found


def cover(test, top):
    """Divide [0, top] until `test(low, high)` holds on each part."""
    left, count, narrowest = [(arb(0), top)], 0, arb(2) ** (16 - ctx.prec)
    while left:
        low, high = left.pop()
        count += 1
        if test(low, high):
            continue
        if count > MOST_PARTS or high - low < high * narrowest or high < top * narrowest**8:
            raise UndecidedError
        middle = high / 8 if low == 0 else (low * high).sqrt() if high > 4 * low else (low + high) / 2
        middle = middle.mid()
        left += [(middle, high), (low, middle)]


def radius_where(decided, loop):
    """The first of growing radii beyond which something is decided."""
    radius = (4 * loop.biggest + 1 / (1 + loop.tau)).upper()
    for _ in range(400):
        if decided(radius):
            return radius
        radius = radius * 8
    raise UndecidedError


def half_count(loop):
    """Zeros of D + N exp(-tau s) right of the axis, as far as the upper half of the axis and arc counts them."""
    retarded, turned = [], arb(0)

    def arc(radius):
        small, large = loop.beyond(radius), loop.beyond(radius, inverse=True)
        retarded[:] = [abs(small) < 1 or (loop.tau == 0 and (1 + small).real > 0)]
        return retarded[0] or (loop.tau == 0 and abs(large) < 1)

    top = radius_where(arc, loop)

    def follow(low, high):
        """Add the change of arg(D + N exp(-tau s)), written as D (1 + L) or as N exp(-tau s) (1 + 1/L)."""
        nonlocal turned
        omega = low.union(high)
        if loop.below_one(omega) or not _may_be_zero(1 + loop.at(omega)):
            roots, delay, inverse = loop.poles, arb(0), False
        elif loop.below_one(omega, inverse=True):
            roots, delay, inverse = loop.zeros, loop.tau, True
        else:
            return False
        ends = [1 + loop.at(one, inverse) for one in (low, high)]
        turned += (ends[1] / ends[0]).arg() - delay * (high - low)
        for root in roots:
            turned += ((J * high - root) / (J * low - root)).arg()
        return True

    cover(follow, top)
    roots = loop.poles if retarded[0] else loop.zeros
    ending = sum(((J * top - root).arg() for root in roots), arb(0))
    ending += (1 + loop.at(top, inverse=not retarded[0])).arg()
    return (ending - turned) / (2 * arb.pi())


def _may_be_zero(value):
    return not value.is_finite() or value.contains(0)


def poles_right(zeros, poles, gain, tau, phase=0.0):
    """Closed-loop poles right of the axis, exactly; inf for a chain of them. `phase` in rad delays every frequency."""
    gain = arb(gain)
    if gain == 0:
        return sum(p.real > 0 for p in poles)
    if len(zeros) == len(poles) and tau > 0 and abs(gain) >= 1:
        return math.inf
    for bits in (100, 400, 2000):
        with ctx.workprec(bits):
            try:
                turns = [J * phase, -J * phase] if phase else [acb(0)]
                halves = [half_count(Loop(zeros, poles, gain * turn.exp(), tau, gain * gain)) for turn in turns]
                found = (sum(halves) if phase else 2 * halves[0]).unique_fmpz()
                if found is not None:
                    return int(found)
            except UndecidedError:
                continue
    raise UndecidedError


# -- certificates --------------------------------------------------------------------------------------------------


def keeps_gain(zeros, poles, gain, tau, low, high):
    """Whether no factor on the gain from `low` to `high` puts a pole on the axis."""
    loop = Loop(zeros, poles, gain, tau)

    def free(a, b):
        omega = a.union(b)
        if abs(loop.without_delay(J * omega)) * high < 1 or abs(loop.without_delay(J * omega, True)) < low:
            return True
        for inverse, least, most in ((False, -1 / arb(low), -1 / arb(high)), (True, -arb(high), -arb(low))):
            middle = arb(omega.mid())
            tangent = loop.at(middle, inverse) + loop.slope(omega, inverse) * (omega - middle)
            for value in (loop.at(omega, inverse), tangent):
                if value.is_finite() and (not value.imag.contains(0) or value.real > most or value.real < least):
                    return True
        return False

    def far(radius):
        value = loop.beyond(radius)
        return abs(value) * high < 1 or abs(loop.beyond(radius, True)) < low or (tau == 0 and value.real > -1 / high)

    cover(free, radius_where(far, loop))
    return True


def keeps_crossovers(zeros, poles, gain, tau, allowed):
    """Whether at every |L| = 1 the turn of L from -1, rad in (0, 2 pi), is `allowed(turn, omega)`."""
    loop = Loop(zeros, poles, gain, tau)

    def free(a, b):
        omega = a.union(b)
        if loop.below_one(omega) or loop.below_one(omega, inverse=True):
            return True
        value = loop.at(omega)
        return value.is_finite() and allowed(value.arg() + arb.pi(), omega)

    cover(free, radius_where(lambda r: abs(loop.beyond(r)) < 1 or abs(loop.beyond(r, True)) < 1, loop))
    return True


def peak_within(zeros, poles, gain, tau, a, b, low, high):
    """Whether the peak of |a + b L|/|1 + L| over the axis is at least `low` and at most `high`."""
    loop, most, parts = Loop(zeros, poles, gain, tau), arb(high), []
    through = loop.gain * (1 if len(zeros) == len(poles) else 0)
    through = -abs(through) if tau > 0 else through
    limit = abs(a + b * through) / abs(1 + through)

    def far(radius):
        small, large = loop.beyond(radius), loop.beyond(radius, True)
        if tau == 0 and abs(a + b * small) / abs(1 + small) < most:
            return True
        return any(
            abs(one) < 1 and (abs(c) + abs(d) * abs(one)) / (1 - abs(one)) < most
            for one, c, d in ((small, a, b), (large, b, a))
        )

    def value_at(omega):
        inverse = not abs(loop.at(omega)) < 2
        one = loop.at(omega, inverse)
        return abs(a * one + b if inverse else a + b * one) / abs(1 + one)

    def below(low_end, high_end):
        omega, middle = low_end.union(high_end), ((low_end + high_end) / 2).mid()
        for inverse, c, d in ((False, a, b), (True, b, a)):
            size = abs(loop.without_delay(J * omega, inverse))
            bound = (abs(c) + abs(d) * size) / (1 - size)
            if size < 1 and bound < most:
                if not bound < low:
                    parts.append((value_at(middle), low_end, high_end))
                return True
            value, slope, here = loop.at(omega, inverse), loop.slope(omega, inverse), loop.at(middle, inverse)
            rate = 2 * (most**2 * (1 + value).conjugate() * slope - (c + d * value).conjugate() * d * slope).real
            gap = most**2 * abs(1 + here) ** 2 - abs(c + d * here) ** 2
            if gap.is_finite() and rate.is_finite() and gap - abs(rate) * (high_end - low_end) / 2 > 0:
                parts.append((value_at(middle), low_end, high_end))
                return True
        at_middle = value_at(middle)
        if at_middle > most:
            raise UndecidedError
        return False

    cover(below, radius_where(far, loop))
    if value_at(arb(0)) >= low or limit >= low:
        return True
    highest = sorted(parts, key=lambda part: float(part[0]))[-_CLIMBS:]
    return any(_climbed(value_at, *ends) >= low for _, *ends in reversed(highest))


def _climbed(value_at, low, high):
    """The peak near a part, by golden section."""
    width = high - low
    low, high = (low - width).max(low / 2).mid(), (high + width).mid()
    ratio = (arb(5).sqrt() - 1) / 2
    for _ in range(90):
        left, right = (high - ratio * (high - low)).mid(), (low + ratio * (high - low)).mid()
        if value_at(left) > value_at(right):
            high = right
        else:
            low = left
    return value_at(((low + high) / 2).mid())


def refused(zeros, poles, gain, tau, c):
    """What a certificate says wrongly about a stable loop; an empty list accepts it. Each end is moved out by `OUTSIDE`
    before it is tried, so that an end that is the margin itself is not asked to differ from it."""
    plain = zeros, poles, gain, tau

    def out(enclosure):
        return arb(enclosure[0]) * (1 - arb(OUTSIDE)), arb(enclosure[1]) * (1 + arb(OUTSIDE))

    def kept(check, *arguments):
        try:
            return check(*plain, *arguments)
        except UndecidedError:
            return False

    def lost(factor=1.0, delay=0.0, phase=0.0):
        return poles_right(zeros, poles, gain * arb(factor), arb(tau) + arb(delay), phase) > 0

    with ctx.workprec(160):
        up, down, delay, degrees = map(out, (c.gain_increase, c.gain_decrease, c.delay_s, c.phase_deg))
        phase = [one * arb.pi() / 180 if one.is_finite() else arb(4) for one in degrees]
        checks = {
            "stable": lambda: poles_right(*plain) == 0,
            "gain_increase": lambda: not up[1].is_finite() or lost(up[1]),
            "gain_decrease": lambda: down[0] == 0 or lost(down[0]),
            "gain": lambda: kept(keeps_gain, down[1].max(arb(1e-6)), up[0].min(arb(1e6))),
            "phase": lambda: kept(keeps_crossovers, lambda t, _: t > phase[0] and 2 * arb.pi() - t > phase[0]),
            "phase_deg": lambda: not degrees[1].is_finite() or lost(phase=phase[1]),
            "delay": lambda: delay[0] == 0 or kept(keeps_crossovers, lambda t, w: t > delay[0] * w),
            "delay_s": lambda: not delay[1].is_finite() or lost(delay=delay[1].max(arb(1e-300))),
            "ms": lambda: kept(peak_within, 1, 0, *out(c.ms)),
            "mt": lambda: kept(peak_within, 0, 1, *out(c.mt)),
        }
        return [name for name, check in checks.items() if not check()]
