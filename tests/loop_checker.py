"""An independent check of loops L = G exp(-tau s) by the argument principle in balls: python-flint alone.

G is zeros, poles and gain, doubles taken as exact. The axis is parted until on each part |L| certainly is below or
above 1, or L is not -1; enclosures are tried at both ends, each moved out by `OUTSIDE`, and so may have no width.
"""

import math
from itertools import zip_longest

from flint import acb, arb, arb_poly, ctx, fmpq, fmpq_poly

J, BITS, MOST_PARTS, OUTSIDE = acb(0, 1), 400, 20_000, 1e-12


def exact(value):
    return value if isinstance(value, fmpq) else fmpq(*float(value).as_integer_ratio())


def square(roots):
    """|prod(j omega - roots)|^2 in omega^2; of a pair the upper root stands for both."""
    found = fmpq_poly([1])
    for a, b in ((exact(r.real), exact(r.imag)) for r in map(complex, roots) if r.imag >= 0):
        found *= fmpq_poly([(a * a + b * b) ** 2, 2 * (a * a - b * b), 1]) if b else fmpq_poly([a * a, 1])
    return found


class Loop:
    """L on balls, turned back by a phase, rad."""

    def __init__(self, zeros, poles, gain, tau, phase=0.0):
        self.zeros, self.poles = [acb(complex(z)) for z in zeros], [acb(complex(p)) for p in poles]
        gain, self.tau, self.gain = exact(gain), arb(exact(tau)), acb(exact(gain)) * (-J * phase).exp()
        gap = square(poles) - gain * gain * square(zeros)
        while gap.degree() > 0 and gap[0] == 0:
            gap = gap.right_shift(1)
        self.gap = arb_poly(gap), arb_poly(gap.derivative())

    def at(self, s, inverse=False, delayed=True):
        """L(s), or 1/L, of a ball or a series, with its delay or without."""
        above, below = (self.poles, self.zeros) if inverse else (self.zeros, self.poles)
        value = 1 / self.gain if inverse else self.gain
        for a, b in zip_longest(above, below):  # (s - a)/(s - b) = 1 + (b - a)/(s - b) is narrow far from both
            value = value * ((s - a) if b is None else 1 / (s - b) if a is None else 1 + (b - a) / (s - b))
        return value * (s * (self.tau if inverse else -self.tau)).exp() if delayed else value

    def rate(self, omega):
        """d ln G/ds at j omega."""
        return sum(1 / (J * omega - z) for z in self.zeros) - sum(1 / (J * omega - p) for p in self.poles)

    def cover(self, test, decided):
        radius, value = max([abs(r).upper() for r in self.zeros + self.poles] + [1 / (1 + self.tau)]), None
        while value is None or not decided(value):
            radius, value = radius.mid() * 8, self.gain
            u = acb(arb(0, 1), arb(0, 1)) / radius
            for a, b in zip_longest(self.zeros, self.poles):
                value = value * (u if a is None else 1 - a * u) / (1 - b * u)
        left = [(arb(0), radius)]
        for _ in range(MOST_PARTS):
            if not left:
                return radius, value
            low, high = left.pop()
            if not test(low, high):
                middle = high / 8 if low == 0 else (low * high).sqrt() if high > 4 * low else (low + high) / 2
                left += [(middle.mid(), high), (low, middle.mid())]
        raise ArithmeticError("undecided")

    def half_count(self):
        """Zeros of D (1 + L) = N exp(-tau s) (1 + 1/L) right of the axis, as far as its upper half counts them."""
        turned = arb(0)

        def follow(low, high):
            nonlocal turned
            omega = low.union(high)
            x, value = omega * omega, 1 + self.at(J * omega)
            gap = self.gap[0](arb(x.mid())) + self.gap[1](x) * (x - x.mid())
            if gap.contains(0) and (not value.is_finite() or value.contains(0)):
                return False
            inverse = gap < 0
            turned += ((1 + self.at(J * high, inverse)) / (1 + self.at(J * low, inverse))).arg()
            turned -= self.tau * (high - low) if inverse else 0
            turned += sum(((J * high - r) / (J * low - r)).arg() for r in (self.zeros if inverse else self.poles))
            return True

        top, end = self.cover(follow, lambda g: abs(g) < 1 or (self.tau == 0 and (abs(g) > 1 or (1 + g).real > 0)))
        large = abs(end) > 1
        ending = sum((J * top - r).arg() for r in (self.zeros if large else self.poles))
        return (ending + (1 + self.at(J * top, large)).arg() - turned) / (2 * arb.pi())

    def avoids(self, least, most, lag, delay):
        """Whether k L exp(-j (phi + omega x)) is not -1 anywhere on the axis: for no k from `least` to `most`, |phi| up
        to `lag` and x from 0 to `delay`."""

        def outside(size, angle, omega):
            if not angle.is_finite():
                return False
            away, half = angle - omega * delay / 2 - arb.pi(), lag + omega * delay / 2
            away = abs(away - 2 * arb.pi() * round(float(away.mid()) / (2 * math.pi)))
            return size * most < 1 or size * least > 1 or half < away < 2 * arb.pi() - half

        def test(low, high):
            omega, middle = low.union(high), ((low + high) / 2).mid()
            x, here = omega * omega, self.at(J * middle)
            gap = self.gap[0](arb(x.mid())) + self.gap[1](x) * (x - x.mid())
            bare, inverse = (abs(self.at(J * omega, turned, delayed=False)) for turned in (False, True))
            if (least == most == 1 and not gap.contains(0)) or bare * most < 1 or inverse < least:
                return True
            change = (self.rate(omega) - self.tau) * J * (omega - middle)  # of ln L from the middle
            return outside(abs(here) * change.real.exp(), here.arg() + change.imag, omega)

        def far(g):
            return abs(g) * most < 1 or (self.tau == delay == 0 and outside(abs(g), g.arg(), arb(0)))

        try:
            self.cover(test, far)
        except ArithmeticError:
            return False
        return True

    def exceeds(self, a, b, most):
        """Whether |a + b L|/|1 + L| comes above `most` on the axis, or tends to what is."""
        through = (-abs(self.gain) if self.tau > 0 else self.gain.real) * (len(self.zeros) == len(self.poles))
        found = [abs(a + b * through) > most * abs(1 + through)]

        def bounded(g, inverse):
            return any(x < 1 and (c + d * x) / (1 - x) < most for x, c, d in ((abs(g), a, b), (abs(inverse), b, a)))

        def below(low, high):
            omega, middle = low.union(high), ((low + high) / 2).mid()
            for inverse, c, d in ((False, a, b), (True, b, a)):
                here, value = self.at(J * middle, inverse), self.at(J * omega, inverse)
                slope = value * (self.rate(omega) - self.tau) * (-J if inverse else J)
                gap = most**2 * abs(1 + here) ** 2 - abs(c + d * here) ** 2
                found[0] = found[0] or gap < 0
                rise = 2 * (most**2 * (1 + value).conjugate() * slope - (c + d * value).conjugate() * d * slope).real
                if found[0] or gap > abs(rise) * (high - low) / 2:
                    return True
            return bounded(*(self.at(J * omega, inverse, delayed=False) for inverse in (False, True)))

        def far(g):
            return found[0] or bounded(g, 1 / g) or (self.tau == 0 and abs(a + b * g) < most * abs(1 + g))

        self.cover(below, far)
        return found[0]


def poles_right(zeros, poles, gain, tau, phase=0.0):
    """Closed-loop poles right of the axis, exactly; inf for a chain of them. `phase`, rad, delays every frequency."""
    if len(zeros) == len(poles) and tau > 0 and abs(gain) >= 1:
        return math.inf
    with ctx.workprec(BITS):
        found = sum(Loop(zeros, poles, gain, tau, turn).half_count() for turn in (phase, -phase))
        return int(found.unique_fmpz())


def refused(zeros, poles, gain, tau, c):
    def peak(a, b, ends):
        with ctx.workprec(BITS):
            loop = Loop(zeros, poles, gain, tau)
            tried = ends[0] * (1 - OUTSIDE), ends[1] * (1 + OUTSIDE)
            return [loop.exceeds(a, b, arb(one)) for one in tried] == [True, False]

    def limit(ends, most, changed, region):
        near, far = exact(min(ends[0] * (1 - OUTSIDE), most)), ends[1] * (1 + OUTSIDE)
        with ctx.workprec(BITS):
            clear = Loop(zeros, poles, gain, tau).avoids(*map(arb, region(near)))
        return clear and (far == math.inf or poles_right(zeros, poles, *changed(far)) > 0)

    down = [1 / x if x else math.inf for x in reversed(c.gain_decrease)]
    checks = {
        "stable": poles_right(zeros, poles, gain, tau) == 0,
        "gain_increase": limit(c.gain_increase, 1e6, lambda x: (exact(gain) * exact(x), tau), lambda x: (1, x, 0, 0)),
        "gain_decrease": limit(down, 1e6, lambda x: (exact(gain) * exact(1 / x), tau), lambda x: (1 / x, 1, 0, 0)),
        "phase_deg": limit(
            c.phase_deg, 180.0, lambda x: (gain, tau, math.radians(x)), lambda x: (1, 1, arb.pi() * arb(x) / 180, 0)
        ),
        "delay_s": limit(c.delay_s, 1e3 * (tau + 1), lambda x: (gain, exact(tau) + exact(x)), lambda x: (1, 1, 0, x)),
        "ms": peak(1, 0, c.ms),
        "mt": peak(0, 1, c.mt),
    }
    return [name for name, right in checks.items() if not right]
