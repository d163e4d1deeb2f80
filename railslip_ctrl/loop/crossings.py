"""All gain and phase crossovers of L(s) = G(s) exp(-tau s).

Gain crossovers and the extrema of |L| and of its phase are roots of polynomials (`exact`). Between them both are
monotone, so that the phase at the ends of a piece tells how many phase crossovers it has; each is then refined to the
last bits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .exact import GAIN, PHASE, SIZE, ExactLoop
from .rational import Rational
from .rootfinding import monotone_roots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

# Phase crossovers are listed wherever |L| is above this (or what the caller asks), and at least these many: with dead
# time there are infinitely many, whose gains 1/|L| grow without bound beyond the last feature of a strictly proper L.
SMALLEST_LISTED = 1e-2
_LISTED_ALWAYS = 20
_MOST_LISTED = 5_000
# Of a phase over pi, for each root's angle and for tau omega; nearer to an odd number balls decide the side.
_ROUNDING = 1e-15


@dataclass(frozen=True)
class Response:
    """L(j omega) with its logarithmic derivatives; G and tau held together."""

    system: Rational
    dead_time: float

    @property
    def is_rational(self) -> bool:
        """Whether L is a ratio of polynomials, which `exact` has."""
        return self.dead_time == 0

    @cached_property
    def exact(self) -> ExactLoop:
        """Its polynomials."""
        return ExactLoop(self.system, self.dead_time)

    @cached_property
    def gain_crossovers(self) -> Floats:
        """All omega > 0 with |L(j omega)| = 1, ascending, rad/s; a touch is among them. None if |L| is 1 everywhere."""
        return np.array([float(omega.mid()) for omega, _ in self.exact.frequencies(GAIN)])

    @cached_property
    def crossover_phases(self) -> tuple[Floats, Floats]:
        """arg L/pi at each of `gain_crossovers`, as an odd number and a signed rest in [-1, 1] that is 0 on L = -1
        alone; balls decide where rounding could matter."""
        return self.phases_at_crossovers()

    def phases_at_crossovers(self, *, certain: bool = False) -> tuple[Floats, Floats]:
        """As `crossover_phases`, by balls everywhere, if that is to be `certain`."""
        return _phases(self, [(omega, GAIN, i) for i, omega in enumerate(self.gain_crossovers.tolist())], certain)

    def phase_error(self, omega: Floats) -> Floats:
        """Bound on the rounding of `angle` over pi: of each angle and of tau omega."""
        half_turns = self.dead_time * omega + self.system.poles.size
        return np.asarray(_ROUNDING * (8 + self.system.poles.size + half_turns))

    def phase(self, omega: Floats) -> tuple[Floats, Floats]:
        """Continuous phase of L, rad, and its derivative."""
        return self.angle(omega), self.angle_slope(omega)

    def log_size(self, omega: Floats) -> Floats:
        """ln|L|."""
        return self.system.log_size(omega)

    def log_size_slope(self, omega: Floats) -> Floats:
        """d ln|L|/d omega."""
        return self.system.log_size_slope(omega)

    def angle(self, omega: Floats) -> Floats:
        """Continuous phase of L, rad."""
        _, size, imag, turns, at_zero = self._angles
        return np.asarray(np.arctan2(omega[..., None] - imag, size) @ turns + (at_zero - self.dead_time * omega))

    def angle_slope(self, omega: Floats) -> Floats:
        """Its derivative."""
        weight, size, imag, _, _ = self._angles
        distance = np.hypot(size, omega[..., None] - imag)
        return np.asarray((weight / distance / distance).sum(axis=-1) - self.dead_time)

    @cached_property
    def _angles(self) -> tuple[Floats, Floats, Floats, Floats, float]:
        """Of each root off the axis or on it what `angle` and `angle_slope` sum up; a right one turns the other way."""
        real, imag = self._both.real, self._both.imag
        right = real > 0
        turned = float(self.system.gain < 0) + float(self._signs[right].sum())
        size = np.abs(real)
        turns = np.where(right, -self._signs, self._signs)
        return size * turns, size, imag.copy(), turns, np.pi * turned

    def log_slope(self, omega: Floats) -> NDArray[np.complex128]:
        """d ln L(j omega)/d omega, complex."""
        return np.asarray(self.system.log_slope(omega) - 1j * self.dead_time)

    def value_and_slope(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """L(j omega) and d ln L/d omega, complex, at omega > 0 off the axis roots, 1-D: in one go, for searches."""
        value, slope, _ = self._value_and_slopes(omega)
        return value, slope

    def value_and_slopes(self, omega: Floats) -> tuple[Complexes, Complexes, Complexes]:
        """As `value_and_slope`, with d^2 ln L/d omega^2."""
        value, slope, inverse = self._value_and_slopes(omega)
        return value, slope, (inverse * inverse) @ self._signs

    def _value_and_slopes(self, omega: Floats) -> tuple[Complexes, Complexes, Complexes]:
        zeros = self.system.zeros.size
        with np.errstate(all="ignore"):
            s = 1j * omega
            away = s[:, None] - self._both
            inverse = 1 / away
            value = np.exp(-self.dead_time * s) * self.system.gain
            paired = away[:, :zeros] * inverse[:, zeros : 2 * zeros]
            value *= paired.prod(axis=1) * inverse[:, 2 * zeros :].prod(axis=1)
            slope = 1j * (inverse @ self._signs - self.dead_time)
        return value, slope, inverse

    @cached_property
    def _both(self) -> Complexes:
        """Zeros and then poles."""
        return np.concatenate([self.system.zeros, self.system.poles])

    @cached_property
    def _signs(self) -> Floats:
        return np.repeat([1.0, -1.0], [self.system.zeros.size, self.system.poles.size])

    def bend(self, low: Floats, high: Floats) -> Floats:
        """A bound on |d^2 ln L/d omega^2| between two frequencies."""
        roots = self._both
        offset = roots.imag - np.clip(roots.imag, low[:, None], high[:, None])
        with np.errstate(divide="ignore"):
            return np.asarray((1 / (roots.real**2 + offset**2)).sum(axis=-1))

    def __call__(self, omega: Floats) -> NDArray[np.complex128]:
        """L(j omega)."""
        value = self.system(1j * omega)
        with np.errstate(invalid="ignore"):
            turned = value * np.exp(-1j * self.dead_time * omega)
        return np.asarray(np.where(np.isinf(value), value, turned))


@dataclass(frozen=True)
class Pieces:
    """Parts of the axis omega > 0, ascending, on each of which |L| and its phase are monotone and |L| - 1 has one sign.

    Attributes
    ----------
    low, high : arrays, shape (n,)
        Ends, rad/s; the first may begin at 0, the last end at infinity.
    size, half_turns : arrays, shape (2, n)
        ln|L| and arg L/pi at, or in the limit to, both ends.
    """

    low: Floats
    high: Floats
    size: Floats
    half_turns: Floats

    def ends(self, response: Response, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """`size` and `half_turns` of parts of these pieces that reach from `low` to `high`, rad/s."""
        owner = np.searchsorted(self.low, low, side="right") - 1
        found = []
        for omega, known, end in ((low, self.low[owner], 0), (high, self.high[owner], 1)):
            inner = omega != known
            values = np.array([self.size[end, owner], self.half_turns[end, owner]])
            values[:, inner] = response.log_size(omega[inner]), response.angle(omega[inner]) / np.pi
            found.append(values)
        size, half_turns = np.stack(found, axis=1)
        return size, half_turns


def pieces(response: Response) -> Pieces:
    """The pieces of a loop, decided by its polynomials."""
    exact, system = response.exact, response.system
    if system.gain == 0:
        return Pieces(np.array([0.0]), np.array([np.inf]), np.full((2, 1), -np.inf), np.zeros((2, 1)))
    roots = np.concatenate([system.zeros, system.poles])
    on_axis = np.unique(roots.imag[(roots.real == 0) & (roots.imag > 0)])
    kinds = {kind: exact.frequencies(kind) for kind in (GAIN, SIZE, PHASE)}
    found = [(float(w.mid()), kind, i) for kind, balls in kinds.items() for i, (w, _) in enumerate(balls)]
    inner = np.array([omega for omega, _, _ in found])
    odd, rest = _phases(response, found)
    half = odd + rest
    half = np.where((half == odd) & (rest != 0), np.nextafter(odd, np.where(rest > 0, np.inf, -np.inf)), half)
    edges, at = np.unique(np.concatenate([inner, on_axis]), return_index=True)
    ends = []
    for towards in (np.inf, 0.0):  # what the pieces above and below each edge have there
        beside = np.nextafter(on_axis, towards)
        size = np.concatenate([response.log_size(inner), response.log_size(beside)])
        half_turns = np.concatenate([half, response.angle(beside) / np.pi])
        ends.append(np.array([size[at], half_turns[at]]))
    low, high = limits(response)
    values = np.stack([np.column_stack([low, ends[0]]), np.column_stack([ends[1], high])], axis=1)
    return Pieces(np.append(0.0, edges), np.append(edges, np.inf), *values)


def limits(response: Response) -> tuple[tuple[float, float], tuple[float, float]]:
    """ln|L| and arg L/pi as omega tends to 0 and to infinity, the latter exact multiples of a half."""
    zeros, poles, gain = response.system.zeros, response.system.poles, response.system.gain
    turned = float(gain < 0)
    integrators = np.count_nonzero(poles == 0) - np.count_nonzero(zeros == 0)
    right = np.count_nonzero(zeros.real > 0) - np.count_nonzero(poles.real > 0)
    level = math.log(abs(gain)) + float(
        np.log(np.abs(zeros[zeros != 0])).sum() - np.log(np.abs(poles[poles != 0])).sum()
    )
    at_zero = (level if integrators == 0 else math.copysign(math.inf, integrators), turned + right - integrators / 2)
    small = -math.inf if response.system.relative_degree else math.log(abs(gain))
    return at_zero, (small, -math.inf if response.dead_time > 0 else _turned_at_infinity(response))


def _turned_at_infinity(response: Response) -> float:
    """arg G/pi as omega tends to infinity."""
    return float(response.system.gain < 0) - response.system.relative_degree / 2


def frequency_nodes(response: Response) -> Floats:
    """Frequencies, rad/s, ascending, that follow every feature of L; for curves and searches, not for decisions."""
    roots = np.concatenate([response.system.zeros, response.system.poles])
    scales = np.concatenate([np.abs(roots), response.gain_crossovers, [1 / (response.dead_time or np.inf)]])
    scales = scales[scales > 0] if np.any(scales > 0) else np.ones(1)
    low, high = 1e-4 * scales.min(), 1e4 * scales.max()
    parts = [np.geomspace(low, high, int(16 * np.log10(high / low)) + 2)]
    for root in roots[roots.imag > 0]:
        width = max(abs(root.real), 1e-8 * root.imag)
        if width < root.imag:
            offset = np.geomspace(0.05 * width, root.imag, int(8 * np.log10(root.imag / width)) + 8)
            parts += [root.imag - offset[:-1], root.imag + offset]
    return np.setdiff1d(np.concatenate(parts), roots.imag[roots.real == 0])


def _phases(response: Response, found: list[tuple[float, str, int]], certain: bool = False) -> tuple[Floats, Floats]:
    """As `Response.crossover_phases`, at frequencies (rad/s, kind, number)."""
    omega = np.array([one for one, _, _ in found])
    half = response.angle(omega) / np.pi
    odd = 2 * np.floor(half / 2) + 1
    rest = half - odd
    for i in np.flatnonzero((np.abs(rest) <= response.phase_error(omega)) | certain).tolist():
        odd[i], rest[i] = response.exact.offset(*found[i][1:])
    return odd, rest


def phase_crossovers(response: Response, cut: Pieces, *, smallest: float = SMALLEST_LISTED) -> Floats:
    """Frequencies omega > 0 with arg L = pi modulo 2 pi, ascending, rad/s.

    Complete wherever |L| >= smallest and for the first 20; beyond, with dead time, there are infinitely many.
    """
    start, end = cut.half_turns
    rising = end > start
    # odd numbers 2 k + 1 behind the start, the end included but at infinity, where it is not reached
    first = np.where(rising, np.floor((start - 1) / 2) + 1, np.ceil((start - 1) / 2) - 1)
    last = np.where(rising, np.floor((end - 1) / 2), np.ceil((end - 1) / 2))
    if np.isinf(cut.high[-1]) and end[-1] == 2 * last[-1] + 1:
        last[-1] += -1 if rising[-1] else 1
    count = np.maximum(np.where(rising, last - first, first - last) + 1, 0)
    steps = _listed(response, cut, count, smallest)
    at, step = np.repeat(np.arange(count.size), [one.size for one in steps]), np.concatenate(steps)
    return np.unique(located(response, cut, at, 2 * (first[at] + np.where(rising[at], step, -step)) + 1))


def located(response: Response, cut: Pieces, at: NDArray[np.intp], odd: Floats) -> Floats:
    """Frequencies, rad/s, inside the pieces number `at` where arg L is `odd` times pi."""
    low, high, target = cut.low[at], cut.high[at], np.pi * odd
    first, last = cut.half_turns[0, at], cut.half_turns[1, at]
    with np.errstate(all="ignore"):
        start = low + (high - low) * ((odd - first) / (last - first))
        start = np.where(high > 4 * low, np.sqrt(low * high), start)
        if response.dead_time > 0:  # in the last piece the dead time turns the most
            start = np.where(np.isinf(high), (_turned_at_infinity(response) - odd) * np.pi / response.dead_time, start)
    scale = np.where(low > 0, 2 * low, np.where(np.isinf(high), 1 / (response.dead_time or 1.0), 0.5 * high))
    start = np.where((start > low) & (start < high) & np.isfinite(start), start, scale)

    def away(omega: Floats, index: NDArray[np.intp]) -> tuple[Floats, Floats]:
        angle, slope = response.phase(omega)
        return angle - target[index], slope

    return monotone_roots(away, start, low, high, np.where(last > first, -1.0, 1.0))


def _listed(response: Response, cut: Pieces, count: Floats, smallest: float) -> list[Floats]:
    """Numbers, from 0 at its start, of the crossovers to list of each piece, given how many it has."""
    least, listed, total = math.log(smallest), [], 0
    for i, number in enumerate(count.tolist()):
        start, end = cut.size[:, i].tolist()
        wanted = min(number, _LISTED_ALWAYS - total) if total < _LISTED_ALWAYS else 0
        if max(start, end) >= least:
            wanted = max(wanted, min(number, _until(response, cut, least) if math.isinf(number) else number))
        if wanted <= _MOST_LISTED:
            steps = np.arange(wanted)
        else:  # too many: those next to either end, where |L| is nearest to 1 and where it is largest
            steps = np.arange(_MOST_LISTED // 2, dtype=float)
            if math.isfinite(number):
                steps = np.concatenate([steps, number - 1 - steps[::-1]])
        listed.append(steps)
        total += steps.size
    return listed


def _until(response: Response, cut: Pieces, least: float) -> float:
    """How many phase crossovers the last piece has up to where ln|L| has fallen to `least`; inf if it never does."""
    if cut.size[1, -1] >= least:
        return math.inf
    top = max(cut.low[-1], 1 / response.dead_time)
    while response.log_size(np.array([top]))[0] > least:
        top *= 2
    return float((cut.half_turns[0, -1] - response.angle(np.array([top]))[0] / np.pi) // 2 + 1)
