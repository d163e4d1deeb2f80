"""Exact sampled loop of the predictive law, including the wheel and the dead time.

Within the boundary layer the law is linear. At a constant train speed its loop is L = N/D, where N and D are functions
of w = z - 1, and D depends only on the controller. N contains the responses of the wheel to a command that is held for
one period ([Astrom1997] 2). The closed loop is stable if the winding number of D + N along the unit circle equals the
number of unstable poles of the wheel, which are the only poles of D + N outside the circle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop.margins import Margins
from railslip_ctrl.model.linearization import OperatingPoint, linearize
from railslip_ctrl.model.vehicle import Actuator

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    Rows = NDArray[np.intp]

KEPT = 1024  #: number of operating points whose linear wheel is cached; an envelope with tolerances has 300 to 400
_GRID, _LOWEST = 250, 1e-3  # number of frequencies of the first grid; lowest frequency times (dead time + lag)
_REFINEMENTS, _FINE_GRID = 5, 9  # number of refinements at a peak, points of each; relative error of the peak 1e-9
_TURN = 1.0  # rad, largest change of the angle of D + N between frequencies, which makes the winding number reliable
_NARROWEST = 1e-9  # rad/s, smallest interval of frequencies; it would be smaller only at a zero on the circle
_TERMS, _SMALL = 14, 0.5  # terms of the series of exp, largest norm of its argument: error 0.5^15/15! = 2e-17


@dataclass(frozen=True)
class SampledLaws:
    """Sampled loops of one predictive law with n linear wheels of the same order.

    - law: the controller, a `Predictive` with a sampling period.
    - slip: reference slip ratio, (n,).
    - unstable: number of unstable poles of the wheel, (n,).
    - pole: denominator of the wheel's responses, coefficients in descending powers of w, (n, order).
    - sigma, speed: numerators of the responses of the slip velocity and of the change of train speed in a period,
      (n, 2, order). Index 0 belongs to the latest command that acts within a period, index 1 to the command before it.
    - periods: number of whole periods in the brake's dead time, (n,).
    """

    law: Any
    slip: Floats
    unstable: Rows
    pole: Floats
    sigma: Floats
    speed: Floats
    periods: Rows

    @property
    def period(self) -> float:
        return float(self.law.period)

    def parts(self, omega: Floats, row: Rows) -> tuple[Complexes, Complexes]:
        """Return D and N of the loop gain L = N/D, for the loops with indices `row`, (n,).

        `omega`, rad/s, (n, k) or (1, k), is at most pi/h, with the sampling period h.
        """
        law, h = self.law, self.period
        turn = 1j * omega * h
        w, z = np.expm1(turn), np.exp(turn)
        slower, blend, slow = (
            -math.expm1(-h / tau) if tau > 0 else 1.0 for tau in (law.lag, law.observer_time, law.deceleration_time)
        )
        count = law.dead_time / h
        whole = int(count)
        gain, lag = law.reaching_rate + law.switching_gain / law.layer, max(law.lag, h)
        ahead, observed, braked = slower / (w + slower), blend * z / (w + blend), slow * z / (w + slow)
        acting = (1 - (count - whole)) * z**-whole + (count - whole) * z ** -(whole + 1.0)
        with np.errstate(invalid="ignore"):
            before = np.where(w == 0, whole, -np.expm1(-turn * whole) / (w / z))  # sum of z^-i
        under_way = h * (before + (count - whole) * acting)
        held = gain * (1 + law.kappa * law.dead_time) + law.kappa
        own = 1 - ahead * (1 - lag * (gain * (1 + law.kappa * under_way) + law.kappa) + lag * held * observed * acting)
        behind = np.exp(-turn * self.periods[row, None]) / _horner(self.pole[row], w)
        responses = []
        for numerator in (self.sigma[row], self.speed[row]):
            first, second = (_horner(numerator[:, i], w) for i in (0, 1))
            responses.append((first + second / z) * behind)
        sigma, rate = responses[0], responses[1] / (z * h)
        slip = self.slip[row, None]
        holding = observed * sigma * w / (z * h) + ((1 - slip) * braked - observed) * rate
        wheel = lag * law.wheel_inertia / law.radius * (held * holding + gain * law.kappa * sigma)
        return own, wheel

    @cached_property
    def stable_and_ms(self) -> tuple[NDArray[np.bool_], Floats]:
        """Stability of each loop, (n,), and its Ms, (n,); Ms is inf for an unstable loop."""
        lowest = _LOWEST / (self.law.dead_time + self.law.lag)
        grid = np.append(0.0, np.geomspace(lowest, math.pi / self.period, _GRID))
        every = np.arange(self.slip.size)
        own, wheel = self.parts(grid[None, :], every)
        stable = self._windings(grid, own + wheel) == self.unstable
        ms = np.full(every.size, np.inf)
        rows = np.flatnonzero(stable)
        if rows.size:
            omega, size = np.broadcast_to(grid, (rows.size, grid.size)), np.abs(own / (own + wheel[rows]))
            for _ in range(_REFINEMENTS):
                top = size.argmax(axis=1)
                low, high = (np.clip(top + side, 0, omega.shape[1] - 1) for side in (-1, 1))
                some = np.arange(rows.size)
                omega = np.linspace(omega[some, low], omega[some, high], _FINE_GRID, axis=1)
                near, far = self.parts(omega, rows)
                size = np.abs(near / (near + far))
            ms[rows] = size.max(axis=1)
        return stable, ms

    def _windings(self, grid: Floats, values: Complexes) -> Rows:
        """Return the winding number of D + N along the unit circle for each loop, (n,)."""
        change = np.angle(values[:, 1:] / values[:, :-1])
        total = np.where(np.abs(change) <= _TURN, change, 0.0).sum(axis=1)
        row, at = np.nonzero(np.abs(change) > _TURN)
        low, high, first, last = grid[at], grid[at + 1], values[row, at], values[row, at + 1]
        while row.size:  # halve the steps until the angle changes little in each
            middle = (low + high) / 2
            own, wheel = self.parts(middle[:, None], row)
            value = (own + wheel)[:, 0]
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
            first, last = np.concatenate([first, value]), np.concatenate([value, last])
            row, change = np.concatenate([row, row]), np.angle(last / first)
            done = (np.abs(change) <= _TURN) | (high - low < _NARROWEST)
            np.add.at(total, row[done], change[done])
            row, low, high, first, last = row[~done], low[~done], high[~done], first[~done], last[~done]
        return np.asarray(np.rint(total / math.pi), dtype=np.intp)


@dataclass(frozen=True)
class SampledLaw:
    """Sampled loop of the predictive law with one linear wheel (result of `linear_wheel`) and an actuator."""

    of: SampledLaws
    wheel: Floats
    brake: Actuator

    @property
    def period(self) -> float:
        return self.of.period

    def response(self, omega: Floats) -> Complexes:
        """Return the loop gain L at `omega`, rad/s, 1-D, at most pi/h with the sampling period h."""
        own, wheel = self.of.parts(np.asarray(omega)[None, :], np.zeros(1, dtype=np.intp))
        return np.asarray((wheel / own)[0])

    def is_stable(self) -> bool:
        return bool(self.of.stable_and_ms[0][0])

    def margins(self) -> Margins:
        """Return a record of margins that contains only Ms; the other margins are NaN or empty."""
        empty: dict[str, Any] = dict.fromkeys(Margins.__dataclass_fields__, math.nan)
        lists = ("gain_crossovers", "phase_margins_deg", "phase_crossovers", "phase_crossover_gains")
        empty |= dict.fromkeys(lists, np.zeros(0))
        return Margins(**{**empty, "ms": float(self.of.stable_and_ms[1][0])})

    def responses(self, end: float, points: int, *, reference: float, torque: float) -> tuple[Floats, Floats, Floats]:
        """Return times, s, and two step responses of the slip velocity, m/s: to the reference and to a torque.

        There are at most `points` times, at sampling instants up to `end`, s. The reference slip velocity steps by
        `reference`, m/s; the disturbance torque at the wheel steps by `torque`, N*m.
        """
        every = max(math.ceil(end / (points * self.period)), 1)
        later = np.linalg.matrix_power(self._sample(), every)
        count = min(int(end / (every * self.period)) + 1, points)
        states = np.zeros((len(later), 2))  # two columns per time, doubled until all are there
        states[-2, 0], states[-1, 1] = reference, torque
        while states.shape[1] < 2 * count:
            states = np.hstack([states, later @ states])
            later = later @ later
        times = np.asarray(np.arange(count) * (every * self.period))
        return times, states[0, : 2 * count : 2], states[0, 1 : 2 * count : 2]

    def _sample(self) -> Floats:
        """Return the matrix from the state of the closed loop at a sample to its state at the next sample."""
        law, h, whole, periods = self.of.law, self.period, int(self.of.law.dead_time / self.period), self.of.periods[0]
        share, inertia = law.dead_time / h - whole, law.wheel_inertia / law.radius
        driven = _driven(self.wheel[None], np.array([self.brake.lag]) if self.brake.lag > 0 else None)[0]
        n, speed = len(driven) - 1, len(self.wheel) - 1
        driven = np.pad(driven, (0, 1))
        driven[: speed + 1, n + 1] = self.wheel[:, -1]
        late = max(self.brake.dead_time - periods * h, 0.0)
        # each quantity is a row vector of weights on the state
        every = np.eye(n + whole + periods + 9)
        wheel, ahead, command, (turning, acted, slow), (reference, torque) = np.split(
            every, np.cumsum([n, whole + 2, periods + 2, 3])
        )
        slower, blend, slowing = (
            -math.expm1(-h / tau) if tau > 0 else 1.0 for tau in (law.lag, law.observer_time, law.deceleration_time)
        )
        ahead = np.vstack([ahead[0] + slower * (command[0] - ahead[0]), ahead[:-1]])
        acting = (1 - share) * ahead[whole] + share * ahead[whole + 1]
        train = wheel[speed]
        omega, observed = (train - wheel[0]) / law.radius, acted + blend * (acting - acted)
        deceleration = slowing / h * (slow - train)
        holding = law.wheel_inertia * blend / h * (omega - turning) + observed
        holding = holding + inertia * deceleration * (1 - self.of.slip[0])
        under_way = h * (ahead[:whole].sum(axis=0) + share * acting)
        error = reference - wheel[0] - (under_way - law.dead_time * holding) / inertia
        surface = holding + inertia * law.kappa * error - ahead[0]
        gain = law.reaching_rate + law.switching_gain / law.layer
        new = ahead[0] + max(law.lag, h) * (gain * surface - law.kappa * (ahead[0] - holding))
        command = np.vstack([new, command[:-1]])
        for length, age in ((late, periods + 1), (h - late, periods)):
            wheel = (_exponential(driven[None] * length)[0] @ np.vstack([wheel, command[age], torque]))[:n]
        filters = turning + blend * (omega - turning), observed, slow + slowing * (train - slow)
        return np.vstack([wheel, ahead, command, *filters, reference, torque])


def sampled_laws(
    law: Any, points: Sequence[OperatingPoint], brakes: Sequence[Actuator], case: tuple[Rows, Rows]
) -> Iterator[tuple[Rows, SampledLaws]]:
    """Yield groups of sampled loops of equal order: the indices of the loops, and the loops.

    `law` is a `Predictive`. Loop i has operating point case[0][i] of `points` and actuator case[1][i] of `brakes`.
    """
    wheels = [linear_wheel(point) for point in points]
    slips = np.array([point.slip for point in points])
    lag, dead_time = (np.array([getattr(brake, name) for brake in brakes])[case[1]] for name in ("lag", "dead_time"))
    order = np.array([wheel.shape[0] for wheel in wheels])[case[0]]
    for size, braked in sorted({(int(n), bool(lagged)) for n, lagged in zip(order, lag > 0, strict=True)}):
        mine = np.flatnonzero((order == size) & ((lag > 0) == braked))
        of = case[0][mine]
        distinct, back = np.unique(of, return_inverse=True)
        matrices = np.array([wheels[i] for i in distinct])
        unstable = (np.linalg.eigvals(matrices[:, :-1, :-2]).real > 0).sum(axis=1)
        driven = _driven(matrices[back], lag[mine] if braked else None)
        yield mine, _sampled(law, slips[of], unstable[back], driven, dead_time[mine], matrices.shape[1] - 1)


@lru_cache(KEPT)
def linear_wheel(point: OperatingPoint) -> Floats:
    """Return the linearised motion of wheel and train as a matrix, (m + 1, m + 2).

    The m + 1 states are the slip velocity, the state of the adhesion law if it has one, and the train speed. A row
    gives the rate of one state; the columns belong to the m + 1 states and the acting torque. The rates do not depend
    on the train speed.
    """
    plant, moving = linearize(point), linearize(point, speed_state=True)
    m = len(plant.states)
    matrix = np.zeros((m + 1, m + 2))
    matrix[:m, :m], matrix[:m, -1] = plant.A, plant.B[:, 0]
    matrix[m, :m], matrix[m, -1] = moving.A[0, 1:], moving.B[0, 0]
    return matrix


def _driven(wheels: Floats, lag: Floats | None) -> Floats:
    """Return matrices of wheel, train and brake, (n, d, d); the last state is the command, which is constant."""
    n, m = wheels.shape[0], wheels.shape[1]
    size = m + 1 if lag is None else m + 2
    matrices = np.zeros((n, size, size))
    matrices[:, :m, :m], matrices[:, :m, m] = wheels[:, :, :-1], wheels[:, :, -1]
    if lag is not None:
        matrices[:, m, m], matrices[:, m, m + 1] = -1 / lag, 1 / lag
    return matrices


def _sampled(law: Any, slip: Floats, unstable: Rows, driven: Floats, dead_time: Floats, speed: int) -> SampledLaws:
    h, d = float(law.period), driven.shape[1] - 1
    periods = np.floor(dead_time / h + 1e-9).astype(np.intp)
    late = np.maximum(dead_time - periods * h, 0.0)
    late[late < 1e-9 * h] = 0.0
    before, after = (_exponential(driven * time[:, None, None]) for time in (late, h - late))
    whole = before @ after
    growth, now = whole[:, :d, :d] - np.eye(d), after[:, :d, d]
    earlier = np.einsum("nij,nj->ni", after[:, :d, :d], before[:, :d, d])
    identity, pole = np.broadcast_to(np.eye(d), growth.shape), [np.ones(slip.size)]
    rows = [identity]
    for k in range(1, d + 1):  # Leverrier's algorithm for the matrices of the adjugate and the determinant
        product = growth @ rows[-1]
        pole.append(-np.trace(product, axis1=1, axis2=2) / k)
        rows.append(product + pole[-1][:, None, None] * identity)
    gammas = np.stack([now, earlier], axis=1)
    answers = np.einsum("knij,ncj->ncik", np.array(rows[:d]), gammas)  # (n, command, state, power)
    # no rate depends on the speed, so that w is a factor of the determinant and of the slip velocity's numerator
    sigma, gained = answers[:, :, 0, : d - 1], answers[:, :, speed, :]
    return SampledLaws(law, slip, unstable, np.array(pole[:d]).T, sigma, gained, periods)


def _exponential(matrices: Floats) -> Floats:
    norm = np.abs(matrices).sum(axis=2).max(initial=0.0)
    halvings = max(math.ceil(math.log2(norm / _SMALL)), 0) if norm > 0 else 0
    small = matrices / 2**halvings
    identity = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    series = identity
    for k in range(_TERMS, 0, -1):
        series = identity + small @ series / k
    for _ in range(halvings):
        series = series @ series
    return np.asarray(series)


def _horner(coefficients: Floats, w: Complexes) -> Complexes:
    value: Complexes = coefficients[:, 0, None].astype(complex)
    for k in range(1, coefficients.shape[1]):
        value = value * w + coefficients[:, k, None]
    return value
