"""The seeking controller: it finds the peak of adhesion and is told neither rail nor mass nor adhesion curve.

The parts, in the order in which a sample runs them: calibration, model of the actuator, adhesion-torque observer,
predictor over the dead time, map of adhesion and peak seeking, memory, then fast start, return, or inner loop with
low-speed hand-over and re-adhesion. In their formulas x is the state and p the parameters.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.adhesion.base import RANDOM_FORCE, RIG_WHEEL_LOAD
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
_MOST_THROWN = 0.4  # slip that a start's torque adds in a dead time: with more a heavy wheel locks on a weak rail
_ROLLING = 0.6  # of the dead time, for which the wheel rolls free for certain, with a brake 30 % quicker than believed
_NOISE, _NOISE_HOLD = RANDOM_FORCE / RIG_WHEEL_LOAD, 0.02  # deviation of the random adhesion coefficient; s, its hold
# memory, times in reaction times (dead time and observer): mean of slip and adhesion; fading of the highest adhesion
_MEMORY, _FADING = 0.25, 8.0
_GONE = 0.85  # of the highest adhesion: with less, at a multiple of its slip, the peak has been passed
_FAR_PAST, _CERTAIN = 2.0, 3.0  # that multiple, of the slip predicted, and the deviations of its noise beyond
_NARROW = 0.03  # slip of the highest adhesion, below which slip returns: past a wider peak the law brings it back
_BACK, _HELD, _FILLED = 0.82, 0.95, 0.9  # after a return: of the slip, and of the adhesion, of the peak; at first
_WAIT = 2.0  # reaction times of this first share
_SOON = 6.0  # reaction times: a return so soon after another is of an adhesion that swings, and not past a peak
_RECOVERS = 0.05  # logarithm of these limits gained, over that of the train speed lost: adhesion rises as it slows
_STIFF_SHARE, _RAISED = 0.8, 8.0  # of the reference, with less slip the torque limit rises; in reaction times
_RESOLVED = 0.5  # reaction times within which slip passes the peak on its way back, if its adhesion is to be measured
_RISEN = 1.05  # of the highest adhesion: with more the rail has changed
_SURE = 3.0  # noise deviations, of slip: a step of the start's elasticity is longer
WEAK, MOST_WEAK = 0.3, 1.6  # adhesion coefficient that the hand-over speed is for; by what it is divided at most
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
        rolling: float = quantity("1", "v/(r omega) of the free wheel", default=1.0)
        roughness: float = quantity("m^2/s^2", "variance of the slip velocity of the free wheel", default=0.0)
        turning: float = quantity("rad/s", "mean speed of the free wheel", default=0.0)
        jitter: float = quantity("rad^2/s^2", "its variance", default=0.0)
        remembered_slip: float = quantity("1", "mean of the slip ratio over a short time", default=0.0)
        remembered_torque: float = quantity("N*m", "mean of the adhesion torque over that time", default=0.0)
        top_slip: float = quantity("1", "slip ratio of the highest adhesion", default=0.0)
        top_torque: float = quantity("N*m", "highest adhesion torque, fading", default=0.0)
        slip_ahead: float = quantity("m/s", "predicted slip velocity, filtered", default=0.0)
        slip_limit: float = quantity("1", "largest reference slip after a return", default=1.0)
        torque_limit: float = quantity("N*m", "largest holding torque after a return; 0: none", default=0.0)
        returning: float = quantity("1", "1: slip returns from past the peak", default=0.0)
        farthest: float = quantity("1", "largest slip ratio of the return", default=0.0)
        crossing: float = quantity("s", "time near the peak on the way back", default=0.0)
        crossed_torque: float = quantity("N*m", "highest adhesion torque there", default=0.0)
        calm: float = quantity("s", "time since the last return", default=0.0)
        swings: float = quantity("1", "1: adhesion swings, and no slip returns", default=0.0)
        waiting: float = quantity("s", "rest of the time for which less is held after a return", default=0.0)
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
            state.mean_holding = ASSUMED * parameters.wheel_load * parameters.radius
            state.starting = 1.0 if above_hand_over(state, parameters, v) >= parameters.hand_over_speed else 0.0
        if omega > 0.0 and state.samples * parameters.period < _ROLLING * parameters.dead_time:
            calibrate(state, parameters, v, omega)
        omega *= state.rolling
        sigma = v - parameters.radius * omega
        reference = state.reference_slip * fading(parameters, v)
        actuator_model(state, parameters, applied)
        observe(state, parameters, v, omega, reference)
        predict(state, parameters, v, sigma, reference)
        seek(state, parameters, reference)
        noise = remember(state, parameters, v)
        if state.returning > 0.0:
            torque = come_back(state, parameters, noise)
        elif state.starting > 0.0:
            speed = above_hand_over(state, parameters, v)
            if speed >= parameters.hand_over_speed and state.starting > 1.0:
                state.mean_holding += parameters.period / MEAN_TIME * (state.holding_torque - state.mean_holding)
            torque = fast_start(state, parameters, v, sigma, reference)
        else:
            torque = limited(state, parameters, sliding_torque(state, parameters, reference), reference)
            torque = hand_over(state, parameters, above_hand_over(state, parameters, v), torque, reference)
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


def calibrate(x: Any, p: Any, v: float, omega: float) -> None:
    """The scale of the train speed over the believed radius, of the free wheel, and the noise of both speeds."""
    ratio, n = v / (p.radius * omega), x.samples + 1.0
    kept = (n - 1.0) / n
    x.roughness = kept * (x.roughness + (v * (1.0 - x.rolling / ratio)) ** 2 / n)
    x.jitter = kept * (x.jitter + (omega - x.turning) ** 2 / n)
    x.turning += (omega - x.turning) / n
    x.rolling += (ratio - x.rolling) / n


def above_hand_over(x: Any, p: Any, v: float) -> Any:
    """The train speed as the hand-over sees it: slip is held down to a lower speed where there is less adhesion."""
    held = x.mean_holding / (p.wheel_load * p.radius)
    return v * min(max(WEAK / max(held, 1e-3), 1.0), MOST_WEAK)


def measured_noise(x: Any, p: Any, variance: float) -> Any:
    """Deviation behind the observer's filter of white noise of a variance."""
    return math.sqrt(variance * p.period / (2.0 * p.observer_time))


def remember(x: Any, p: Any, v: float) -> Any:
    """Slip and torque of the highest adhesion; a return begins where adhesion falls far past that slip.

    Gives the deviation of the predicted slip velocity, m/s. Only a slip that rises tells of a peak: with bristles
    adhesion swings, and is highest as slip falls.
    """
    reaction = p.dead_time + p.observer_time
    blend = 1.0 - math.exp(-p.period / (_MEMORY * reaction))
    x.remembered_torque += blend * (x.adhesion_torque - x.remembered_torque)
    x.remembered_slip += blend * (x.filtered_sigma / x.filtered_speed - x.remembered_slip)
    x.slip_ahead += (1.0 - math.exp(-p.period / p.observer_time)) * (x.sigma_ahead - x.slip_ahead)
    force = _NOISE * p.wheel_load * p.radius**2 / p.wheel_inertia  # m/s^2
    turning = p.radius * p.dead_time / p.observer_time  # of the wheel speed's noise, by the observed adhesion
    noise = math.sqrt(
        force**2 * _NOISE_HOLD * reaction + measured_noise(x, p, x.roughness + turning**2 * x.jitter) ** 2
    )
    if x.remembered_torque > x.top_torque and x.slip_rate >= 0.0:
        x.top_torque, x.top_slip = x.remembered_torque, x.remembered_slip
    elif x.returning == 0.0:
        x.top_torque += p.period / (_FADING * reaction) * (x.remembered_torque - x.top_torque)
    slower = _RECOVERS * p.period * max(x.deceleration, 0.0) / v
    x.slip_limit = min(x.slip_limit * (1.0 + slower), 1.0)
    low = 1.0 - max(x.remembered_slip, 0.0) / (_STIFF_SHARE * x.reference_slip)
    if x.returning == 0.0 and x.waiting <= 0.0 and low > 0.0 and x.reference_slip * v > 2.0 * noise:
        slower += p.period / (_RAISED * reaction) * low
    x.torque_limit *= 1.0 + slower
    known = x.top_torque > 0.4 * ASSUMED * p.wheel_load * p.radius and 0.0 < x.top_slip < _NARROW
    fallen = x.adhesion_torque < x.remembered_torque < _GONE * x.top_torque
    far = x.slip_ahead > _FAR_PAST * x.top_slip * v + _CERTAIN * noise and x.filtered_sigma > 1.5 * x.top_slip * v
    x.calm += p.period
    begins = x.returning == 0.0 and x.waiting <= 0.0 and x.handed_over == 0.0 and known and fallen and far
    if begins and x.torque_limit > 0.0 and x.calm < _SOON * reaction:
        x.swings, x.slip_limit, x.torque_limit = 1.0, 1.0, 0.0
        x.reference_slip = max(x.top_slip, x.reference_slip)
    elif begins and x.swings == 0.0:
        x.returning, x.starting, x.farthest, x.crossing, x.crossed_torque = 1.0, 0.0, 0.0, 0.0, 0.0
        x.slip_limit = min(_BACK * x.top_slip, x.slip_limit)
        most = _HELD * x.top_torque
        x.torque_limit = min(most, x.torque_limit) if x.torque_limit > 0.0 else most
    x.reference_slip = min(x.reference_slip, x.slip_limit)
    return noise


def quickly(x: Any, p: Any, torque: float) -> Any:
    """The command with which the torque ahead of the dead time comes to a torque, by the gain of the law's layer."""
    return towards(x, p, (torque - x.torque_ahead) * (p.reaching_rate + p.switching_gain / p.layer))


def come_back(x: Any, p: Any, noise: float) -> Any:
    """The torque that brings the slip back below the peak in a reaction time. If slip passes the peak slowly enough,
    its adhesion is measured anew: the rail may have changed."""
    reaction = p.dead_time + p.observer_time
    goal = x.reference_slip * x.speed_ahead
    x.farthest = max(x.farthest, x.remembered_slip)
    if x.remembered_slip < min(2.0 * x.top_slip, 0.7 * x.farthest):
        x.crossing += p.period
        x.crossed_torque = max(x.crossed_torque, x.remembered_torque)
    if x.slip_ahead > 1.2 * goal + 2.0 * noise:
        return quickly(x, p, x.holding_torque - p.wheel_inertia / p.radius / reaction * (x.sigma_ahead - goal))
    if x.crossing > _RESOLVED * reaction and x.crossed_torque < x.top_torque:
        x.top_torque = x.crossed_torque
        x.torque_limit = _HELD * x.top_torque
    x.returning, x.waiting, x.low_time, x.calm = 0.0, _WAIT * reaction, 0.0, 0.0
    x.mean_torque, x.quick_torque = _FILLED * x.top_torque, _FILLED * x.top_torque
    return quickly(x, p, _FILLED * x.top_torque)


def limited(x: Any, p: Any, torque: float, reference: float) -> Any:
    """After a return, the torque limit as long as the slip is below its reference, and no more at any slip: a torque
    below the highest adhesion cannot run past the peak."""
    x.waiting = max(x.waiting - p.period, 0.0)
    if x.torque_limit == 0.0:
        return torque
    held = min(x.torque_limit, _FILLED * x.top_torque) if x.waiting > 0.0 else x.torque_limit
    most = quickly(x, p, held + p.wheel_inertia / p.radius * x.deceleration)
    low = max(x.remembered_slip, x.filtered_sigma / x.filtered_speed) < reference
    return most if low else min(torque, most)


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
    slip = x.filtered_sigma / x.filtered_speed
    blurred = _SURE * measured_noise(x, p, x.roughness) / max(x.filtered_sigma, _LOWEST_SLIP * v)
    step, slow_step = max(_LOG_STEP if x.starting == RISEN else 1e-3, blurred), max(_SLOW_STEP, blurred)
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
        if x.step_log_slip == 0.0 or not -slow_step <= stepped <= slow_step:
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
        most = min(most, quickly(x, p, SLOW_SHARE * x.holding_torque))
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
    if x.torque_limit > 0.0:  # after a return a rise is above the highest adhesion before it
        rises = rises and x.waiting <= 0.0 and x.quick_torque > _RISEN * x.top_torque
    # with a slip above a low reference: the wheel spins up, and adhesion is more than any torque on its way can hold
    spins = p.wheel_inertia / p.radius * x.slip_rate < -0.2 * x.mean_torque
    if x.waiting <= 0.0 and spins and 0.85 * reference < slip < _LOW_SLIP * p.first_slip:
        rises = x.adhesion_torque > max(1.08 * x.mean_torque, 1.03 * x.torque_ahead)
    if v <= _START_SPEED * p.fade_speed:
        return
    if x.torque_limit > 0.0:
        x.low_time = 0.0
    else:
        doubt(x, p)
    if x.low_time > p.dead_time or rises:
        x.starting, x.flat_samples, x.last_log_slip, x.low_time = RISEN if rises else AGAIN, 0.0, 0.0, 0.0
        x.slip_limit, x.torque_limit, x.top_torque = 1.0, 0.0, x.remembered_torque
        if rises:
            x.reference_slip = max(x.reference_slip, p.first_slip)
        x.slow, x.step_log_slip, x.mean_slip = 0.0, 0.0, 0.0
        forget(x)
