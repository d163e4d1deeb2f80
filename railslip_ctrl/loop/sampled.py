"""A discrete controller, a zero-order hold and a continuous plant behind dead time: `SampledLoop`, exact.

Between samples the held command is constant, so that the plant seen at the samples is a difference equation
without approximation, also for a dead time that is no multiple of the period ([Astrom1997] 2):

    x[k+1] = Phi x[k] + Gamma0 u[k-d] + Gamma1 u[k-d-1],    y[k] = C x[k],    dead time = (d + fraction) h

The loop is stable if and only if all eigenvalues of this and the controller together lie inside the unit circle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.core.arguments import checked, complexes, number, numbers
from railslip_ctrl.core.errors import InputError

from .crossings import Response
from .deadtime import Loop, unstable_error
from .margins import RESPONSES, Margins
from .rational import Rational, realise
from .responses import TimeResponse, given_times, pieces_at
from .rootfinding import bracketed_roots
from .sampled_delay import ROUNDING, BoxedResponse, added_delay
from .stability import RootCount

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

# The delay chain has a state a period, and eigenvalues cost the cube of that: at this many a few seconds.
MOST_PERIODS = 500
MOST_SAMPLES = 200_000  # of a step response: a second or two

_ONE = 1e-9  # ln|L| that counts as 0 all along an interval
_SWAY = 0.75  # largest change of arg L from the middle of an interval, rad: less than an eighth of a turn
_PEAK = 1e-6  # by so much in ratio a peak may be higher than it is said to be, if another is as high
_NARROWEST = 1e-7  # half of an interval over its frequency: no further into a zero or pole of L on the circle
_GAINS_EQUAL = 1e-9  # two gain limits that agree this well are one


@dataclass(frozen=True)
class HeldPlant:
    """x[k+1] = (1 + growth) x[k] + gamma0 u[k-periods] + gamma1 u[k-periods-1], y[k] = c x[k]."""

    growth: Floats
    gamma0: Floats
    gamma1: Floats
    c: Floats
    periods: int
    fraction: float
    a: Floats
    b: Floats

    @property
    def chain(self) -> int:
        """Past commands that are states."""
        return self.periods + (1 if np.any(self.gamma1) else 0)

    def flow(self, lengths: Floats) -> Floats:
        """What takes state and held command on by lengths in periods: (n, order + 1, order + 1)."""
        from scipy.linalg import expm

        driven = np.zeros((self.c.size + 1,) * 2)
        driven[:-1, :-1], driven[:-1, -1] = self.a, self.b
        return np.asarray(expm(driven * lengths[:, None, None]))


class SampledLoop(Loop):
    """The loop of a discrete controller and a sampled continuous plant, unity negative feedback.

    Parameters
    ----------
    controller : python-control or scipy.signal system of that period, `Rational` in z, or a real number
        C, proper; u = C (reference - y) at the samples.
    plant : python-control or scipy.signal system, or `Rational` in s
        P, continuous-time, strictly proper, without dead time.
    dead_time : float
        s, >= 0, between the controller's output and the plant: actuator and computation together.
    period : float
        h, s, > 0.

    Raises
    ------
    InputError
        A system of another kind, a plant that is not strictly proper, or a time out of range.

    Notes
    -----
    `2 * loop`, `loop / 2`, `C * loop` (C discrete) and `-loop` are loops; `loop(z)` is L(z).
    """

    def __init__(self, controller: Any, plant: Any, dead_time: float, period: float) -> None:
        check_period(period)
        c = Rational.from_control(controller, "controller", period=period)
        p = Rational.from_control(plant, "plant")
        if not (math.isfinite(dead_time) and dead_time >= 0):
            raise InputError(f"dead time: {dead_time} s is not allowed; give a finite value >= 0")
        if p.relative_degree < 1:
            raise InputError(
                f"sampled plant: {p.zeros.size} zeros and {p.poles.size} poles are not strictly proper; add "
                "the actuator's lag"
            )
        if c.gain == 0:
            raise InputError("sampled loop: a controller with gain 0 closes no loop; give one that is not 0")
        self._controller, self._plant = c, p
        self._dead_time, self._period = float(dead_time), float(period)
        self._dt = self._period

    @property
    def controller(self) -> Rational:
        """C, in z."""
        return self._controller

    @property
    def plant(self) -> Rational:
        """P, in s, without its dead time."""
        return self._plant

    @property
    def dead_time(self) -> float:
        """Dead time, s, the hold not included."""
        return self._dead_time

    @property
    def period(self) -> float:
        """h, s."""
        return self._period

    @property
    def nyquist_frequency(self) -> float:
        """pi/h, rad/s, where the frequency response ends."""
        return math.pi / self._period

    def __repr__(self) -> str:
        order = self._controller.poles.size + self._plant.poles.size
        return f"SampledLoop(order {order}, {self._dead_time:g} s, period {self._period:g} s)"

    def scaled(self, factor: float) -> SampledLoop:
        """The loop with its gain multiplied by `factor`, not 0, of either sign. InputError for one not finite."""
        return SampledLoop(self._controller * number("gain factor", factor), self._plant, self._dead_time, self._period)

    def __mul__(self, other: Any) -> SampledLoop:
        """Series connection with a discrete-time SISO system of the loop's period, or a change of gain."""
        if isinstance(other, Loop):
            raise InputError("factor: a loop is not accepted beside a sampled loop; multiply its controller")
        factor = Rational.from_control(other, "factor", period=self._period)
        return SampledLoop(factor * self._controller, self._plant, self._dead_time, self._period)

    def delayed(self, extra: float) -> SampledLoop:
        """The loop with `extra` seconds more continuous dead time."""
        return SampledLoop(self._controller, self._plant, self._dead_time + extra, self._period)

    # -- stability ----------------------------------------------------------------------------------------

    @cached_property
    def closed_loop_matrix(self) -> Floats:
        """One sample to the next with reference 0: states of the plant, past commands (latest first), controller.

        Raises InputError with more than 500 periods in the dead time: the matrix would have as many rows.
        """
        if self._dead_time > MOST_PERIODS * self._period:
            raise InputError(
                f"period: {self._period:g} s is not allowed with {self._dead_time:g} s of dead time; give a value >= "
                f"{self._dead_time / MOST_PERIODS:.3g} (s), or use the continuous equivalent"
            )
        held, k = self.held, realise(self._controller)
        n, chain = held.c.size, held.chain
        matrix = np.zeros((n + chain + k.order,) * 2)
        of_x, of_k = slice(0, n), slice(n + chain, None)
        command = np.zeros(matrix.shape[0])
        command[of_x], command[of_k] = -k.d * held.c, k.c
        matrix[of_x, of_x] = held.growth + np.eye(n)
        for gamma, age in ((held.gamma0, held.periods), (held.gamma1, held.periods + 1)):
            if age == 0:
                matrix[of_x] += np.outer(gamma, command)
            elif age <= chain:
                matrix[of_x, n + age - 1] += gamma
        if chain:
            matrix[n] = command
            matrix[n + 1 : n + chain, n : n + chain - 1] = np.eye(chain - 1)
        matrix[of_k, of_x] = -np.outer(k.b, held.c)
        matrix[of_k, of_k] = k.a
        return matrix

    @cached_property
    def _closed_loop_poles(self) -> Complexes:
        poles = np.linalg.eigvals(self.closed_loop_matrix).astype(np.complex128)
        return np.asarray(poles[np.argsort(-np.abs(poles))])

    @checked
    def closed_loop_poles(self, count: int = 6) -> Complexes:
        """Eigenvalues of `closed_loop_matrix`, the plane of z, the `count` largest, largest first."""
        return self._closed_loop_poles[: int(number("count", count, ge=1))]

    @property
    def spectral_radius(self) -> float:
        """Size of the largest closed-loop pole; below 1 the loop is stable."""
        return float(np.abs(self._closed_loop_poles[0]))

    @cached_property
    def root_count(self) -> RootCount:
        """Closed-loop poles on or outside the unit circle, as far as eigenvalues in doubles tell."""
        sizes = np.abs(self._closed_loop_poles)
        return RootCount(float(np.count_nonzero(sizes >= 1)), bool(np.any(sizes == 1)))

    @property
    def open_loop_unstable_poles(self) -> int:
        """Poles of controller and plant outside the unit circle."""
        return int(np.count_nonzero(np.abs(self._controller.poles) > 1) + np.count_nonzero(self._plant.poles.real > 0))

    @property
    def integrators(self) -> int:
        """Poles of controller and plant at z = 1."""
        return int(np.count_nonzero(self._controller.poles == 1) + np.count_nonzero(self._plant.poles == 0))

    def poles(self) -> Complexes:
        """Poles of L in z, open loop, as python-control has them of a system: those at 0 are the dead time's."""
        plant = np.exp(self._plant.poles * self._period)
        return np.concatenate([self._controller.poles, plant, np.zeros(self.held.chain)])

    # -- responses ----------------------------------------------------------------------------------------

    def __call__(self, z: ArrayLike) -> Complexes:
        """L(z) at complex z, of its shape; `loop.response(omega)` is the frequency response. inf + 0j at 1 with an
        integrator, NaN at 0."""
        z = complexes("z", z)
        at_pole = (z == 1) & (self.integrators > 0)
        elsewhere = np.where(at_pole, 2.0, z)
        with np.errstate(all="ignore"):
            value = self._controller(elsewhere) * self._plant_response(elsewhere, elsewhere - 1)[0]
        return np.asarray(np.where(at_pole, np.inf, value))

    def response(self, omega: ArrayLike) -> Complexes:
        """L(exp(j omega h)), complex, of the shape of `omega` (rad/s, > 0; up to pi/h it says all)."""
        return self.response_and_slope(numbers("omega", omega, "rad/s", gt=0))[0]

    def phase(self, omega: ArrayLike) -> Floats:
        """Continuous phase of L(exp(j omega h)), rad, with dead time. 0 < omega <= pi/h, rad/s, any shape."""
        omega = numbers("omega", omega, "rad/s", gt=0)
        nodes = np.union1d(_nodes(self, peaks=False), omega)
        first = nodes[:1]  # where z - 1 is j omega h
        begin = Response(self._plant, 0.0).angle(first)
        begin += Response(self._controller.shifted(1.0), 0.0).angle(first * self._period)
        phase = np.unwrap(np.concatenate([begin, np.angle(self.response(nodes))]))[1:]
        return np.asarray(phase[np.searchsorted(nodes, omega)])

    def feature_band(self) -> tuple[float, float]:
        """Frequencies, rad/s, between which everything about L happens, up to pi/h; for plots."""
        low = np.concatenate([self.feature_frequencies, self.gain_crossovers, [self.nyquist_frequency]]).min()
        return float(low / 10), self.nyquist_frequency

    def step_response(self, time: ArrayLike) -> TimeResponse:
        """Response of the closed loop to a unit step of the reference at t = 0, between samples too, exact.

        The step is seen by the sample at t = 0; `control` is held between samples, its `control_rate` 0.

        Parameters
        ----------
        time : array, shape (n,), or float
            s, >= 0, ascending; of one number, the end of 1001 times from 0.
        """
        times = given_times(*((None, time) if np.ndim(time) == 0 else (time, None)))
        at, inside = pieces_at(times, self._period)
        states, commands = self._run(int(at[-1]) + 1)
        held, age = self.held, at + 1  # of a command, in `commands`: none acts before its time
        parts = np.stack([np.minimum(inside, held.fraction), np.maximum(inside - held.fraction, 0)])
        x = states[at]
        for length, delay in zip(parts, (held.periods + 1, held.periods), strict=True):
            command = commands[np.maximum(age - delay, 0)]
            with np.errstate(over="ignore", invalid="ignore"):
                x = (held.flow(length) @ np.concatenate([x, command[:, None]], axis=1)[..., None])[:, :-1, 0]
        with np.errstate(over="ignore", invalid="ignore"):
            output, control = x @ held.c, commands[age]
        acting = commands[np.maximum(pieces_at(times - self._dead_time, self._period)[0] + 1, 0)]
        if not np.isfinite(output).all():
            raise InputError(f"time: {times[-1]:g} s is not allowed; the response overflows before it; give less")
        return TimeResponse(
            times, output, control, acting, 1 - output, np.zeros_like(output), self._dead_time, 1.0, 0.0, 0.0
        )

    def _run(self, count: int) -> tuple[Floats, Floats]:
        """The plant's states at some number of samples, and the commands, behind a 0 for those before."""
        if count > MOST_SAMPLES:
            raise InputError(
                f"time: {count} samples are not allowed; give a time <= {MOST_SAMPLES * self._period:.3g} s"
            )
        held, k = self.held, realise(self._controller)
        states, commands = np.zeros((count, held.c.size)), np.zeros(count + 1)
        inner = np.zeros(k.order)
        with np.errstate(over="ignore", invalid="ignore"):
            for i in range(count):
                error = 1 - held.c @ states[i]
                commands[i + 1] = k.c @ inner + k.d * error
                inner = k.a @ inner + k.b * error
                if i + 1 < count:
                    now, before = (commands[max(i + 1 - age, 0)] for age in (held.periods, held.periods + 1))
                    states[i + 1] = states[i] + held.growth @ states[i] + held.gamma0 * now + held.gamma1 * before
        return states, commands

    # -- margins ------------------------------------------------------------------------------------------

    @cached_property
    def gain_crossovers(self) -> Floats:
        """All omega up to pi/h with |L| = 1, rad/s, ascending; also of an unstable loop."""
        nodes = _nodes(self, peaks=False)
        return _gain_crossovers(self, nodes, self.response(nodes))

    @property
    def stabilizing_gain_range(self) -> tuple[float, float] | None:
        """Interval of factors on the loop gain that stabilises: the one that holds 1 if the loop is stable, else
        the nearest to 1 in ratio; None if there is none."""
        return _stabilizing_range(self)

    def margins(self) -> Margins:
        """All margins of the sampled loop, as the record of the continuous one.

        Frequencies are > 0 and end at pi/h, which stands for infinity. Crossovers and peaks are bracketed by
        frequencies between which bounds show that none is hidden, and refined to rounding. The delay margin is not
        read off a crossover: more dead time changes the pulse transfer function itself (what the hold lets through
        between samples); see `sampled_delay`.

        Raises
        ------
        UnstableLoopError
            The closed loop is not stable: says by how many poles, and which gain factors would stabilise it.
        """
        if self.is_stable():
            return _margins(self)
        count = int(self.root_count.right)
        poles = f"{count} pole{'' if count == 1 else 's'} on or outside the unit circle"
        raise unstable_error(f"sampled loop (period {self._period:g} s)", poles, count, self.stabilizing_gain_range)

    # -- the functions behind -----------------------------------------------------------------------------

    def response_and_slope(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """`response` and d ln L/d omega (s), complex, of the shape of `omega`."""
        z = np.exp(1j * omega * self._period)
        # z - 1 apart from z: a short period puts every feature of the plant next to 1
        plant, plant_slope = self._plant_response(z, np.expm1(1j * omega * self._period))
        k = self._controller
        slope = (1 / (z[..., None] - k.zeros)).sum(axis=-1) - (1 / (z[..., None] - k.poles)).sum(axis=-1) + plant_slope
        return np.asarray(k(z) * plant), np.asarray(1j * self._period * z * slope)

    @cached_property
    def dc_gain(self) -> float:
        """L at frequency 0; infinite with an integrator in controller or plant."""
        if np.any(self._plant.poles == 0) or np.any(self._controller.poles == 1):
            return math.inf
        plant, _ = self._plant_response(np.array([1.0 + 0j]), np.array([0j]))
        return float((self._controller(1.0) * plant[0]).real)

    @cached_property
    def feature_frequencies(self) -> Floats:
        """Sizes of the poles and zeros of plant and controller, those at frequency 0 left out, rad/s."""
        in_z = np.concatenate([self._controller.zeros, self._controller.poles])
        sizes = [self._plant.zeros, self._plant.poles, np.log(in_z[in_z != 0]) / self._period]
        found = np.abs(np.concatenate(sizes))
        return np.asarray(found[found > 0])

    def _plant_response(self, z: Complexes, beyond_one: Complexes) -> tuple[Complexes, Complexes]:
        """Pulse transfer function of held plant and dead time, and its logarithmic derivative with respect to z."""
        held = self.held
        resolvent = beyond_one[..., None, None] * np.eye(held.c.size) - held.growth
        driven = held.gamma0 + held.gamma1 / z[..., None]
        state = np.linalg.solve(resolvent, driven[..., None])[..., 0]
        state_slope = np.linalg.solve(resolvent, (-held.gamma1 / z[..., None] ** 2 - state)[..., None])[..., 0]
        value = state @ held.c
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (state_slope @ held.c) / value - held.periods / z
        return np.asarray(value * z ** -float(held.periods)), np.asarray(slope)

    @cached_property
    def held(self) -> HeldPlant:
        from scipy.linalg import expm

        p, h = realise(self._plant), self._period
        periods = math.floor(self._dead_time / h)
        late = max(0.0, self._dead_time - periods * h)

        def integral(time: float) -> Floats:
            """Integral of exp(a s) over [0, time]."""
            block = np.zeros((2 * p.order, 2 * p.order))
            block[: p.order, : p.order], block[: p.order, p.order :] = p.a * time, np.eye(p.order) * time
            return np.asarray(expm(block)[: p.order, p.order :])

        # the command of a sample acts late into the period, until then the one before it
        remaining = integral(h - late)
        gamma1 = (np.eye(p.order) + p.a @ remaining) @ (integral(late) @ p.b)
        return HeldPlant(p.a @ integral(h), remaining @ p.b, gamma1, p.c, periods, late / h, p.a * h, p.b * h)


def _margins(loop: SampledLoop) -> Margins:
    """Of a stable one."""
    nodes = _nodes(loop)
    response, slope = loop.response_and_slope(nodes)
    crossovers = _gain_crossovers(loop, nodes, response)
    limits = _gain_limits(loop, nodes, response)
    up = min((g for g in limits if g[0] > 1), default=(math.inf, math.nan))
    down = max((g for g in limits if g[0] < 1), default=(0.0, math.nan))
    signed = np.angle(-loop.response(crossovers), deg=True)  # of -L: 0 at the critical point
    smallest = int(np.argmin(np.abs(signed))) if signed.size else None
    delay, delay_frequency = added_delay(loop)
    (ms, ms_frequency), (mt, mt_frequency), (disk, disk_frequency) = _peaks(loop, nodes, response, slope)
    return Margins(
        gain_increase=up[0],
        gain_increase_frequency=up[1],
        gain_decrease=down[0],
        gain_decrease_frequency=down[1],
        phase_deg=math.inf if smallest is None else abs(float(signed[smallest])),
        phase_frequency=math.nan if smallest is None else float(crossovers[smallest]),
        delay_s=delay,
        delay_frequency=delay_frequency,
        ms=ms,
        ms_frequency=ms_frequency,
        mt=mt,
        mt_frequency=mt_frequency,
        disk=1.0 / disk,
        disk_frequency=disk_frequency,
        gain_crossovers=crossovers,
        phase_margins_deg=signed,
        phase_crossovers=np.array([frequency for _, frequency in limits]),
        phase_crossover_gains=np.array([factor for factor, _ in limits]),
    )


def _gain_crossovers(loop: SampledLoop, nodes: Floats, response: Complexes) -> Floats:
    size = np.log(np.abs(response))
    told = np.abs(size) > ROUNDING  # else its sign says nothing, as near 0 where L(0) = 1
    return _roots(loop, nodes[told], size[told], lambda value: np.log(np.abs(value)))


def _stabilizing_range(loop: SampledLoop) -> tuple[float, float] | None:
    """The interval of loop-gain factors that stabilises and holds 1, else the nearest to 1 in ratio."""
    nodes = _nodes(loop, peaks=False)
    limits = _gain_limits(loop, nodes, loop.response(nodes))
    edges = [0.0, *sorted(factor for factor, _ in limits), math.inf]
    intervals = [(low, high) for low, high in pairwise(edges) if high > low * (1 + _GAINS_EQUAL)]

    def distance(interval: tuple[float, float]) -> float:
        low, high = interval
        return 0.0 if low <= 1 <= high else abs(math.log(high if high < 1 else low))

    for low, high in sorted(intervals, key=distance):
        inside = math.sqrt(low * high) if low > 0 and high < math.inf else (0.5 * high if low == 0 else 2 * low)
        if loop.scaled(1.0 if math.isinf(inside) else inside).is_stable():
            return low, high
    return None


def _nodes(loop: SampledLoop, peaks: bool = True) -> Floats:
    """Frequencies up to pi/h, rad/s, ascending, between any two of which nothing is hidden.

    |L| - 1 and the phase less 180 deg each cross 0 at most once, and |S|, |T| and |S - 1/2| rise or fall, or stay
    below what they are at one of the nodes; halves of an interval are looked at until their bounds show it.
    """
    response, turns = BoxedResponse(loop), loop.held.periods + 1
    edges = response.first_edges()
    nodes, best = [edges], np.log(np.maximum(_at_zero(loop), 1e-300))
    theta, half = (edges[:-1] + edges[1:]) / 2, np.diff(edges) / 2
    while theta.size:
        expansion = response.expand(theta, np.full(theta.size, loop.held.fraction))
        logarithm, slope = expansion.value - 1j * turns * theta, expansion.slope - 1j * turns
        (_, rest, level), (_, twice, _) = expansion.bounds(half), expansion.bounds(2 * half)
        slack = twice / half  # of the slope, by Cauchy's estimate
        apart, change = np.abs(logarithm.real), np.abs(slope.real) * half + level
        sure = (apart > change) | (np.abs(slope.real) > slack) | (apart + change < _ONE)
        off = np.remainder(logarithm.imag, 2 * np.pi) - np.pi
        sway = np.abs(slope.imag) * half + rest
        sure &= (sway < _SWAY) & ((np.abs(off) > sway) | (np.abs(slope.imag) > slack))
        if peaks:
            value = np.exp(logarithm)
            heights, slopes = (
                np.array(each) for each in zip(*(shape(value, slope) for shape in RESPONSES), strict=True)
            )
            best = np.maximum(best, np.log(heights.max(axis=1)))
            rests = _shape_rests(value, np.abs(slope) * half, rest)
            bound = np.log(heights) + np.abs(slopes) * half + rests
            slacks = _shape_rests(value, np.abs(slope) * half * 2, twice) / half
            sure &= ((bound <= best[:, None] + _PEAK) | (np.abs(slopes) > slacks)).all(axis=0)
        parted = ~sure & (half > _NARROWEST * theta)
        theta, half = theta[parted], half[parted] / 2
        nodes.append(theta)
        theta, half = np.concatenate([theta - half, theta + half]), np.concatenate([half, half])
    return np.asarray(np.sort(np.concatenate(nodes)) / loop.period)


def _shape_rests(loop: Complexes, linear: Floats, rest: Floats) -> Floats:
    """How far ln of S, T and S - 1/2 can be from linear, (3, n), where ln L changes by `linear` and at most `rest`."""
    grown = np.expm1(linear + rest)

    def of_sum(part: Complexes) -> Floats:  # ln(1 + part (exp(u) - 1))
        moved = np.abs(part) * grown
        return np.asarray(np.abs(part) * (grown - linear) - np.log1p(-np.minimum(moved, 1)) - moved)

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # 1 + L by L, or L times 1 + 1/L by 1/L: whichever is less
        plus, plus_inverse = of_sum(loop / (1 + loop)), of_sum(1 / (1 + loop))
        minus, minus_inverse = of_sum(loop / (1 - loop)), of_sum(1 / (1 - loop))
        found = [
            np.fmin(plus, rest + plus_inverse),
            np.fmin(rest + plus, plus_inverse),
            np.fmin(plus + minus, plus_inverse + minus_inverse),
        ]
    return np.asarray(np.where(np.isnan(found), np.inf, found))


def _at_zero(loop: SampledLoop) -> Floats:
    """|S|, |T| and |S - 1/2| at frequency 0; with an integrator any |L| far beyond 1 gives the limit."""
    start = np.array([loop.dc_gain if math.isfinite(loop.dc_gain) else 1e100], dtype=complex)
    with np.errstate(invalid="ignore"):  # the slope of S - 1/2 where L = 1
        return np.array([shape(start, np.zeros(1, dtype=complex))[0][0] for shape in RESPONSES])


def _roots(loop: SampledLoop, nodes: Floats, values: Floats, function: Callable[[Complexes], Floats]) -> Floats:
    """Refined zeros of a real function of L between nodes where it changes sign."""
    at = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    return bracketed_roots(lambda w, _: function(loop.response(w)), nodes[at], nodes[at + 1])


def _gain_limits(loop: SampledLoop, nodes: Floats, response: Complexes) -> list[tuple[float, float]]:
    """Loop-gain factors that put a pole on the unit circle, each with its frequency, by frequency."""
    limits = []
    dc, end = loop.dc_gain, float(response[-1].real)  # L is real at pi/h
    if -math.inf < dc < 0:
        limits.append((-1 / dc, 0.0))
    sideways = np.where(response.real < 0, response.imag, np.nan)
    sideways[-1] = 0.0
    found = _roots(loop, nodes, sideways, lambda value: value.imag / np.abs(value))
    size = np.abs(loop.response(found))
    limits += [(float(1 / s), float(w)) for s, w in zip(size, found, strict=True)]
    if end < 0:
        limits.append((-1 / end, float(nodes[-1])))
    return limits


def _peaks(loop: SampledLoop, nodes: Floats, response: Complexes, slope: Complexes) -> list[tuple[float, float]]:
    """Largest |S|, |T| and |S - 1/2| over 0 <= omega <= pi/h, and where, rad/s."""
    peaks = [_peak(loop, shape, nodes, *shape(response, slope)) for shape in RESPONSES]
    return [max(peak, (float(value), 0.0)) for peak, value in zip(peaks, _at_zero(loop), strict=True)]


def _peak(
    loop: SampledLoop,
    shape: Callable[[Complexes, Complexes], tuple[Floats, Floats]],
    nodes: Floats,
    value: Floats,
    rise: Floats,
) -> tuple[float, float]:
    """Largest value of one closed-loop response on (0, pi/h] and where, from its values and slopes at the nodes."""
    top = np.flatnonzero((value[1:-1] >= value[:-2]) & (value[1:-1] >= value[2:])) + 1
    # the peak lies on the side to which the response still rises
    rising = rise[top] > 0
    low, high = np.where(rising, nodes[top], nodes[top - 1]), np.where(rising, nodes[top + 1], nodes[top])
    refined = bracketed_roots(lambda w, _: shape(*loop.response_and_slope(w))[1], low, high)
    height = shape(*loop.response_and_slope(refined))[0]
    at = np.concatenate([refined, nodes[[0, -1]], nodes[top]])
    heights = np.concatenate([height, value[[0, -1]], value[top]])
    best = int(np.argmax(heights))
    return float(heights[best]), float(at[best])


def check_period(period: float) -> float:
    """Return a sampling period, s; InputError unless finite and > 0."""
    return number("period", period, "s", gt=0)
