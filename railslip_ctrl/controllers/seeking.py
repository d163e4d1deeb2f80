"""The seeking controller: it finds the peak of adhesion and is told neither rail nor mass nor adhesion curve.

The parts, in the order in which a sample runs them: model of the actuator, adhesion-torque observer, predictor over the
dead time, map of adhesion and peak seeking, then fast start or inner loop, low-speed hand-over, re-adhesion. In their
formulas x is the state and p the parameters.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.numeric import adhesion_coefficient, peak

from .predictive import (
    ASSUMED,
    MEAN_TIME,
    QUICK_TIME,
    Predictive,
    actuator_model,
    fading,
    hand_over,
    observe,
    predict,
    sliding_torque,
    towards,
)

KNOTS = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.06, 0.075, 0.09, 0.105, 0.12, 0.135, 0.15, 0.17)
"""Slip ratios at which the map of adhesion has values."""


_SLIPS = 1001  # up to the peak, among which the slip held is looked for

_GROWTH = 0.7  # 1/s, largest relative rate of the reference slip, upwards: slip follows it no faster where it is low
AGAIN, RISEN = 2.0, 3.0  # in STARTING: slip stayed low, adhesion rose; 1: the first start, 0: none
_LOW_SLIP = 0.6  # of the first reference: a new start is worth its price to a slip that is lower
_START_SPEED = 1.1  # of that at which the reference fades: below, a start anew would lock more than it gains
_LOG_STEP = 0.05  # of slip, over which the elasticity of a rail just met is judged: its noise is high
_FLAT_STEPS, _FLAT_TIME = 2.0, 0.01  # in turn; s, of a step at least
_SLOW_ELASTICITY = 0.4  # below which the peak is near, and a start slows down
_SLOW_STEP = 0.1  # of ln slip, that it is taken over
SLOW_FROM = 0.003  # slip from which it does: below, bristles bend
SLOW_SHARE = 2.0  # of the holding torque, that a slow start takes
_SCATTER_TIME = 0.4  # s, of the means that scatter is taken from, and for which a reference is in doubt
_STIFF = 3.0  # relative scatter of slip over that of adhesion torque: with less the peak is far
_LEAST_SCATTER = 0.003  # relative, of adhesion torque: with less there is no noise to go by
_FAR = 2.0  # of the reference: a slip above comes back from past the peak
_CALM = 1.4  # of the mean slip: what is farther is a motion, and no scatter
_LOW_REFERENCE, _HIGHER = 0.4, 3.0  # of the first reference, below which one is low; by what it is raised in doubt
# such a ratio, share of the first reference and time, s, where it is less low: it may be right, as past beam's wet peak
_STIFFER, _FAIR_REFERENCE, _FAIR_TIME = 1.7, 0.8, 1.0
_REACHED = 0.85  # of the reference: with less slip the map does not lower it, if it is not low
_MOST_THROWN = 0.5  # slip that a start's torque adds in a dead time: with more a heavy wheel locks on a weak rail
_TINY = 1e-9  # of the map: weight of a knot never visited
_WEIGHED_TIME = 0.01  # s, that weighs 1 in the map, against its curvature
_LOWEST_SLIP = 1e-4  # whose logarithm is taken


class Seeking(Predictive):
    """A controller that seeks the peak of adhesion: what it believes of wheel and brake, and its own numbers; SI.

    Its reference is its own; `reference` only judges the slip, if it is given. InputError for a number out of its
    range, or slips or speeds that are not in order.
    """

    kind: ClassVar[str] = "seeking"
    title: ClassVar[str] = "finds the peak of adhesion, rail unknown"
    source: ClassVar[str] = "this project"
    follows_reference: ClassVar[bool] = False
    finds_slip: ClassVar[bool] = True

    reference: ReferenceSlip | None = None
    start_lead: float = quantity("s", "lead on the slip that ends the fast start", ge=0)
    start_slip: float = quantity("1", "slip, with the lead, that ends the fast start", gt=0, lt=1, default=0.12)
    elasticity: float = quantity("1", "d ln Ta/d ln slip below which the fast start ends", gt=0, lt=1, default=0.18)
    again_share: float = quantity("1", "share of the mean torque that a later start takes", gt=1, default=3.0)

    first_slip: float = quantity("1", "reference slip at the start", gt=0, lt=1, default=0.11)
    least_slip: float = quantity("1", "least reference slip", gt=0, lt=1, default=0.005)
    largest_slip: float = quantity("1", "largest reference slip", gt=0, lt=1, default=0.11)
    forgetting: float = quantity("s", "time constant with which the map forgets", gt=0, default=0.82)
    curvature: float = quantity("1", "weight of the map's curvature", gt=0, default=3e-4)
    flatness: float = quantity("1", "share of the adhesion given away for less slip", gt=0, lt=1, default=0.0056)
    rise: float = quantity("1/s", "largest rate of the reference slip, upwards", gt=0, default=0.022)
    fall: float = quantity("1/s", "largest rate of the reference slip, downwards", gt=0, default=0.36)

    knots: tuple[float, ...] = quantity("1", "slip ratios at which the map has values", default=KNOTS)

    class State(Predictive.State):
        """Besides that of the law: reference, start and map."""

        reference_slip: float = quantity("1", "slip ratio that it holds", default=0.0)
        peak: float = quantity("1", "slip ratio of the peak of the map; 0: not known yet", default=0.0)
        starting: float = quantity("1", "0: no start, 1: the first, 2: slip stayed low, 3: adhesion rose", default=0.0)
        last_log_torque: float = quantity("1", "ln of the adhesion torque of the last step of elasticity", default=0.0)
        last_log_slip: float = quantity("1", "ln of its slip; 0: none yet", default=0.0)
        flat_samples: float = quantity("1", "steps in turn over which adhesion did not rise", default=0.0)
        low_time: float = quantity("s", "time for which the slip was low", default=0.0)
        mean_torque: float = quantity("N*m", "mean of the adhesion torque", default=0.0)
        quick_torque: float = quantity("N*m", "its mean over a shorter time", default=0.0)
        slow: float = quantity("1", "1: the start is slow", default=0.0)
        step_log_torque: float = quantity(
            "1", "ln of the adhesion torque of the last step of a slow start", default=0.0
        )
        step_log_slip: float = quantity("1", "ln of its slip; 0: none yet", default=0.0)
        mean_slip: float = quantity("1", "mean of the slip ratio", default=0.0)
        mean_adhesion: float = quantity("N*m", "mean of the adhesion torque at it", default=0.0)
        slip_scatter: float = quantity("1", "variance of the slip ratio", default=0.0)
        adhesion_scatter: float = quantity("N^2*m^2", "variance of the adhesion torque", default=0.0)
        stiff_time: float = quantity("s", "time for which slip scattered little", default=0.0)
        weights: tuple[float, ...] = quantity("1", "of the map: normal matrix, diagonal and next to it", default=())
        sums: tuple[float, ...] = quantity("1", "of the map: right-hand side", default=())
        factors: tuple[float, ...] = quantity("1", "of the map: factors of the matrix", default=())
        adhesion: tuple[float, ...] = quantity("1", "of the map: adhesion coefficients at the knots", default=())

    def start(self, speed: float, period: float) -> Any:
        knots = len(self.knots)
        sizes = {"history": self._ring(period), "weights": 2 * knots, "sums": knots}
        sizes |= {"factors": 3 * knots, "adhesion": knots}
        return self.State(**{name: (0.0,) * size for name, size in sizes.items()})

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """Observe, predict, learn, then start, or hold the reference slip, or the torque after the hand-over."""
        v, omega, applied = measurement.train_speed, measurement.wheel_speed, measurement.applied_torque
        if not math.isfinite(applied):
            return state.torque_ahead
        if not (math.isfinite(v) and math.isfinite(omega)) or v <= 0.0:
            return applied
        if state.samples == 0.0:
            state.reference_slip = parameters.first_slip
            state.starting = 1.0 if v >= parameters.hand_over_speed else 0.0
            state.mean_holding = ASSUMED * parameters.wheel_load * parameters.radius
        sigma = v - parameters.radius * omega
        reference = state.reference_slip * fading(parameters, v)
        actuator_model(state, parameters, applied)
        observe(state, parameters, v, omega, reference)
        predict(state, parameters, v, sigma, reference)
        seek(state, parameters, reference)
        if state.starting > 0.0:
            if v >= parameters.hand_over_speed and state.starting > 1.0:
                state.mean_holding += parameters.period / MEAN_TIME * (state.holding_torque - state.mean_holding)
            torque = fast_start(state, parameters, v, sigma, reference)
        else:
            torque = hand_over(state, parameters, v, sliding_torque(state, parameters, reference), reference)
            readhesion(state, parameters, v, sigma / v, reference)
        state.samples += 1.0
        return min(max(torque, 0.0), parameters.torque_max)

    def described(self) -> str:
        slips = f"{self.least_slip:g} to {self.largest_slip:g}"
        return f"{self.label}, its own reference slip from {slips}, {self._gains_described()}"

    def headline(self) -> str:
        return f"seeking: finds the adhesion peak, slip {self.least_slip:.3g} to {self.largest_slip:.3g}"

    def held_slip(self, law: AdhesionLaw, speed: float, wheel_load: float) -> float:
        """The slip ratio that it comes to on a rail of constant adhesion at a speed, m/s, under a wheel load, N: the
        least within `flatness` of the peak, in the range of its reference, less below `fade_speed`; the largest where
        adhesion falls from the start."""
        top = peak(law, speed, wheel_load)
        if top.slip < self.least_slip:
            return self.largest_slip * self._kept(speed)
        slips = np.linspace(self.least_slip, top.slip, _SLIPS)
        enough = adhesion_coefficient(law, speed, slips, wheel_load) >= (1 - self.flatness) * top.coefficient
        return min(float(slips[np.argmax(enough)]), self.largest_slip) * self._kept(speed)

    @classmethod
    def _orders(cls) -> tuple[tuple[str, tuple[str, ...]], ...]:
        return ((" <= ", ("least_slip", "first_slip", "largest_slip")), *super()._orders())

    @classmethod
    def _own_rules(cls, dead_time: float) -> dict[str, float]:
        return {"start_lead": 0.9 * dead_time}


# --- the parts of a sample ----


def learn(x: Any, p: Any) -> None:
    """Weigh the adhesion of now into the map, linear between its knots of slip; what is old is forgotten."""
    knots = len(p.knots)
    kept = math.exp(-p.period / p.forgetting)
    for i in range(knots):
        x.weights[2 * i] *= kept
        x.weights[2 * i + 1] *= kept
        x.sums[i] *= kept
    slip = x.filtered_sigma / x.filtered_speed
    if x.samples * p.period <= p.dead_time + 2.0 * p.observer_time or not 0.0 < slip < p.knots[knots - 1]:
        return
    coefficient = x.adhesion_torque / (p.wheel_load * p.radius)
    j = 0
    while slip > p.knots[j + 1]:
        j += 1
    share = (slip - p.knots[j]) / (p.knots[j + 1] - p.knots[j])
    weight = p.period / _WEIGHED_TIME
    x.weights[2 * j] += weight * (1.0 - share) ** 2
    x.weights[2 * j + 1] += weight * share * (1.0 - share)
    x.weights[2 * j + 2] += weight * share**2
    x.sums[j] += weight * (1.0 - share) * coefficient
    x.sums[j + 1] += weight * share * coefficient


def forget(x: Any) -> None:
    """Empty the map."""
    for i in range(len(x.sums)):
        x.weights[2 * i] = x.weights[2 * i + 1] = x.sums[i] = 0.0


def solve_map(x: Any, p: Any) -> None:
    """The adhesion coefficients at the knots that fit what was weighed in, with little curvature: regularised least
    squares, by Cholesky's factors of a matrix with five diagonals; into the room behind the sums."""
    knots = len(p.knots)
    for i in range(knots):
        x.factors[3 * i] = x.weights[2 * i] + _TINY
        x.factors[3 * i + 1] = x.weights[2 * i + 1]
        x.factors[3 * i + 2] = 0.0
        x.adhesion[i] = x.sums[i]
    for i in range(knots - 2):
        near = p.knots[i + 1] - p.knots[i]
        far = p.knots[i + 2] - p.knots[i + 1]
        mean = 0.5 * (near + far)
        a, b, d = mean / near, -mean / near - mean / far, mean / far
        x.factors[3 * i] += p.curvature * a * a
        x.factors[3 * i + 1] += p.curvature * a * b
        x.factors[3 * i + 2] += p.curvature * a * d
        x.factors[3 * i + 3] += p.curvature * b * b
        x.factors[3 * i + 4] += p.curvature * b * d
        x.factors[3 * i + 6] += p.curvature * d * d
    for i in range(knots):  # L D L', rows of D, and of L' next to it
        pivot, first, second = x.factors[3 * i], x.factors[3 * i + 1], x.factors[3 * i + 2]
        if i + 1 < knots:
            x.factors[3 * i + 3] -= first * first / pivot
            x.factors[3 * i + 4] -= first * second / pivot
            x.adhesion[i + 1] -= first / pivot * x.adhesion[i]
        if i + 2 < knots:
            x.factors[3 * i + 6] -= second * second / pivot
            x.adhesion[i + 2] -= second / pivot * x.adhesion[i]
    for back in range(knots):
        k = knots - 1 - back
        total = x.adhesion[k]
        if k + 1 < knots:
            total -= x.factors[3 * k + 1] * x.adhesion[k + 1]
        if k + 2 < knots:
            total -= x.factors[3 * k + 2] * x.adhesion[k + 2]
        x.adhesion[k] = total / x.factors[3 * k]


def peak_of_map(x: Any, p: Any) -> Any:
    """The least slip ratio within the flatness of the map's highest adhesion."""
    knots = len(p.knots)
    best = x.adhesion[0]
    for i in range(knots):
        best = max(best, x.adhesion[i])
    enough = best * (1.0 - p.flatness)
    for i in range(knots - 1):
        low, high = x.adhesion[i], x.adhesion[i + 1]
        if low < enough <= high:
            return p.knots[i] + (enough - low) / (high - low) * (p.knots[i + 1] - p.knots[i])
    return p.largest_slip


def seek(x: Any, p: Any, reference: float) -> None:
    """Move the reference slip towards the peak of the map, at most at its rates; a reference that is not low, not down
    before the slip has reached it: the map knows nothing of the adhesion there."""
    learn(x, p)
    if int(x.samples) % 5 == 0 and x.samples * p.period > 2.0 * p.dead_time:
        solve_map(x, p)
        x.peak = peak_of_map(x, p)
    if x.peak > 0.0 and x.starting == 0.0:
        goal = min(max(x.peak, p.least_slip), p.largest_slip)
        rise = min(p.rise, _GROWTH * x.reference_slip)
        reached = x.filtered_sigma >= _REACHED * reference * x.filtered_speed
        fall = p.fall if reached or x.reference_slip < _LOW_REFERENCE * p.first_slip else 0.0
        x.reference_slip += min(max(goal - x.reference_slip, -fall * p.period), rise * p.period)


def fast_start(x: Any, p: Any, v: float, sigma: float, reference: float) -> Any:
    """The largest torque; less where it would throw a heavy wheel past the peak, and at most twice the holding torque
    once adhesion rises little with slip. It ends where the slip is about to pass the start's, or adhesion rises no
    more with it."""
    if sigma + p.start_lead * x.slip_rate >= min(p.start_slip, 0.85 * reference) * v:
        x.starting = 0.0
    slip, step = x.filtered_sigma / x.filtered_speed, _LOG_STEP if x.starting == RISEN else 1e-3
    every = int(_FLAT_TIME / p.period + 0.5)
    due = every < 2 or int(x.samples) % every == 0
    if due and x.adhesion_torque > 0.1 * p.wheel_load * p.radius and slip > _LOWEST_SLIP:
        log_torque, log_slip = math.log(x.adhesion_torque), math.log(slip)
        if x.last_log_slip == 0.0 or log_slip < x.last_log_slip - step:
            x.last_log_torque, x.last_log_slip, x.flat_samples = log_torque, log_slip, 0.0
        elif log_slip > x.last_log_slip + step:
            flat = log_torque - x.last_log_torque < p.elasticity * (log_slip - x.last_log_slip)
            x.flat_samples = x.flat_samples + 1.0 if flat else 0.0
            x.last_log_torque, x.last_log_slip = log_torque, log_slip
        gained, stepped = log_torque - x.step_log_torque, log_slip - x.step_log_slip
        if x.step_log_slip == 0.0 or not -_SLOW_STEP <= stepped <= _SLOW_STEP:
            rose = x.step_log_slip != 0.0 and stepped > 0.0 and slip > SLOW_FROM
            if rose and gained < _SLOW_ELASTICITY * stepped:
                x.slow = 1.0
            x.step_log_torque, x.step_log_slip = log_torque, log_slip
    if x.flat_samples >= _FLAT_STEPS and x.starting > 0.0:
        x.starting = 0.0
        x.reference_slip = min(max(1.2 * slip, p.least_slip), x.reference_slip)
    x.low_time, x.mean_torque, x.quick_torque = 0.0, x.adhesion_torque, x.adhesion_torque
    throw = _MOST_THROWN * v / max(p.dead_time, p.period) * p.wheel_inertia / p.radius  # N*m beyond what holds
    most = min(p.torque_max, x.holding_torque + throw)
    if x.slow > 0.0:
        rate = (SLOW_SHARE * x.holding_torque - x.torque_ahead) * (p.reaching_rate + p.switching_gain / p.layer)
        most = min(most, towards(x, p, rate))
    if x.starting > 1.0:
        return min(most, p.again_share * max(x.mean_holding, x.holding_torque))
    return most


def doubt(x: Any, p: Any) -> None:
    """Triple a low reference where slip scatters little compared with the adhesion torque: the peak is then far; one
    less low where it scatters less, and for longer. The map cannot tell, as at a constant reference its slope is that
    of the random force."""
    slip, torque = x.filtered_sigma / x.filtered_speed, x.adhesion_torque
    if not x.mean_slip / _CALM < slip < x.mean_slip * _CALM:
        x.mean_slip, x.mean_adhesion, x.slip_scatter, x.adhesion_scatter = slip, torque, 0.0, 0.0
        x.stiff_time = 0.0
    blend = p.period / _SCATTER_TIME
    slip_error, torque_error = slip - x.mean_slip, torque - x.mean_adhesion
    x.mean_slip += blend * slip_error
    x.mean_adhesion += blend * torque_error
    x.slip_scatter = (1.0 - blend) * (x.slip_scatter + blend * slip_error**2)
    x.adhesion_scatter = (1.0 - blend) * (x.adhesion_scatter + blend * torque_error**2)
    low = x.reference_slip < _LOW_REFERENCE * p.first_slip
    limit = _STIFF if low else _STIFFER
    stiff = x.slip_scatter * x.mean_adhesion**2 < limit**2 * x.adhesion_scatter * x.mean_slip**2
    stiff = stiff and x.adhesion_scatter > (_LEAST_SCATTER * x.mean_adhesion) ** 2
    stiff = stiff and slip < _FAR * x.reference_slip
    stiff = stiff and x.reference_slip < _FAIR_REFERENCE * p.first_slip
    x.stiff_time = x.stiff_time + p.period if stiff else 0.0
    if x.stiff_time > (_SCATTER_TIME if low else _FAIR_TIME):
        x.reference_slip, x.stiff_time = min(_HIGHER * x.reference_slip, p.largest_slip), 0.0


def readhesion(x: Any, p: Any, v: float, slip: float, reference: float) -> None:
    """Start anew where the slip stays far below its reference, or adhesion rises: the rail holds more than before, and
    nothing is known of its peak."""
    x.low_time = x.low_time + p.period if slip < 0.69 * reference else 0.0
    x.quick_torque += p.period / QUICK_TIME * (x.adhesion_torque - x.quick_torque)
    if slip < 1.2 * reference:
        x.mean_torque += p.period / MEAN_TIME * (x.adhesion_torque - x.mean_torque)
    else:  # what rises as the slip comes back from past the peak is no news of the rail
        x.mean_torque = x.quick_torque
    rises = x.quick_torque > 1.08 * x.mean_torque and slip < 0.85 * reference
    # with a slip above a low reference: the wheel spins up, and adhesion is more than any torque on its way can hold
    spins = p.wheel_inertia / p.radius * x.slip_rate < -0.2 * x.mean_torque
    if spins and 0.85 * reference < slip < _LOW_SLIP * p.first_slip:
        rises = x.adhesion_torque > max(1.08 * x.mean_torque, 1.03 * x.torque_ahead)
    if v <= _START_SPEED * p.fade_speed:
        return
    doubt(x, p)
    if x.low_time > p.dead_time or rises:
        x.starting, x.flat_samples, x.last_log_slip, x.low_time = RISEN if rises else AGAIN, 0.0, 0.0, 0.0
        if rises:
            x.reference_slip = max(x.reference_slip, p.first_slip)
        x.slow, x.step_log_slip, x.mean_slip = 0.0, 0.0, 0.0
        forget(x)
