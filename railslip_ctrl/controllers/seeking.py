"""The seeking controller: it finds the peak of adhesion without knowing the rail, the mass or the adhesion curve.

Each sample calibrates the wheel speed, observes the adhesion torque Ta, predicts the slip over the dead time, remembers
the highest adhesion and fits a curve to adhesion over slip. The elasticity E = d ln Ta/d ln slip of that curve ends the
approach and moves the reference slip, which the predictive sliding-mode law holds. In the formulas x is the state and p
the parameters. A reaction time is the dead time plus the time constant of the observer.
"""

from __future__ import annotations

import math
from functools import lru_cache
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
    delay_of,
    fading,
    hand_over,
    observe,
    predict,
    sliding_torque,
    torque_ago,
    towards,
)

# approach
LEAD = 0.16  # slip ratio that the torque above the holding torque adds in a reaction time
MOST = 0.22  # adhesion coefficient: largest torque above the holding torque, per wheel load and radius
WEAKEST = 0.06  # adhesion coefficient of a very weak rail: the first torque is that of such a rail
# fitted curve
PRIOR = 0.5  # adhesion coefficient: standard deviation, before any measurement, of mu from a curve without a peak
BRAKE_ERROR = 0.15  # standard deviation of dead time and lag, half of a tolerance of 30 %: samples of a changing torque
STILL = 0.1  # weight of a sample while the reference rests; also the rate of forgetting then, 1/s
PULL = 0.35  # rise of E that cancels the bias of the random force at rest, per share of the slip that the force moves
# memory and return
NARROW = 0.04  # slip of a peak below which the slip is brought back; past a wider peak the sliding-mode law does so
SHORT = 0.8  # share of a slip that counts as just below it
LESS = 0.9  # share of the highest adhesion that shows that its slip has been passed
TWICE = 2.0  # ratio to a slip that counts as far beyond it
HELD, LOW_SPEED = 0.97, 0.12  # share of the highest adhesion held after a return; by how much less at hand-over speed
SLOWLY = 8.0  # reaction times in which the remembered adhesion fades; two returns within them show swinging adhesion
RISEN = 1.05  # ratio of adhesion to what it was before that shows a better rail, above the noise of the random force
# not tuned: the plant's random force, the free wheel, the judged slip and the hand-over
_NOISE, _NOISE_HOLD = RANDOM_FORCE / RIG_WHEEL_LOAD, 0.02  # standard deviation of the adhesion coefficient; its hold, s
_ROLLING = 0.6  # share of the dead time in which the wheel rolls free even if the brake acts 30 % sooner than believed
_FLAT, _LOWEST = 0.0056, 0.002  # adhesion given away at the slip where the loop is judged; least reference slip
_SLIPS = 1001  # points of the search for that slip
WEAK, MOST_WEAK = 0.3, 1.6  # adhesion coefficient of the hand-over speed; its largest divisor on weaker rails


class Seeking(Predictive):
    """A controller that seeks the peak of adhesion; its parameters are its beliefs of wheel and brake, in SI units.

    It chooses its own reference slip; a given `reference` only judges the slip of a run. InputError for a number out of
    its range, or speeds that are not in order.
    """

    kind: ClassVar[str] = "seeking"
    title: ClassVar[str] = "finds the peak of adhesion, rail unknown"
    source: ClassVar[str] = "this project"
    follows_reference: ClassVar[bool] = False
    finds_slip: ClassVar[bool] = True

    reference: ReferenceSlip | None = None
    largest_slip: float = quantity("1", "largest reference slip", gt=0, lt=1, default=0.11)
    elasticity: float = quantity("1", "d ln Ta/d ln slip at which the reference rests", gt=0, lt=1, default=0.18)

    class State(Predictive.State):
        """State of the predictive law, and calibration, reference, fitted curve, memory and return."""

        rolling: float = quantity("1", "v/(r omega) of the free wheel", default=1.0)
        roughness: float = quantity("m^2/s^2", "variance of the slip velocity of the free wheel", default=0.0)
        turning: float = quantity("rad/s", "mean speed of the free wheel", default=0.0)
        jitter: float = quantity("rad^2/s^2", "variance of the speed of the free wheel", default=0.0)
        reference_slip: float = quantity("1", "reference slip ratio; 0: no adhesion seen yet", default=0.0)
        starting: float = quantity("1", "0: no approach, 1: the first, 2: after a rise of adhesion", default=0.0)
        moved: float = quantity("1", "change of ln reference slip in a reaction time, filtered", default=0.0)
        sums: tuple[float, ...] = quantity("1", "weighted powers of slip, 0 to 4, of the fit", default=())
        sides: tuple[float, ...] = quantity("1", "right-hand side of the fit", default=())
        curve: tuple[float, ...] = quantity("1", "a, b, c of slip/mu = a + b slip + c slip^2", default=())
        remembered_slip: float = quantity("1", "mean of the slip ratio over a short time", default=0.0)
        remembered_torque: float = quantity("N*m", "mean of the adhesion torque over that time", default=0.0)
        top_slip: float = quantity("1", "slip ratio of the highest adhesion", default=0.0)
        top_torque: float = quantity("N*m", "highest adhesion torque, fading", default=0.0)
        slip_ahead: float = quantity("m/s", "predicted slip velocity, filtered", default=0.0)
        slip_limit: float = quantity("1", "largest reference slip after a return", default=1.0)
        torque_limit: float = quantity("N*m", "largest holding torque after a return; 0: none", default=0.0)
        returning: float = quantity("1", "1: the slip is brought back from past the peak", default=0.0)
        calm: float = quantity("s", "time since the last return", default=0.0)
        swings: float = quantity("1", "half the returns soon after another; from 1 on, none follows", default=0.0)
        waiting: float = quantity("s", "remaining wait after a return", default=0.0)
        free_time: float = quantity("s", "time for which the slip has been negative", default=0.0)
        mean_torque: float = quantity("N*m", "mean of the adhesion torque", default=0.0)
        quick_torque: float = quantity("N*m", "mean of the adhesion torque over a shorter time", default=0.0)

    def start(self, speed: float, period: float) -> Any:
        sizes = {"history": self._ring(period), "sums": 5, "sides": 3, "curve": 3}
        return self.State(**{name: (0.0,) * size for name, size in sizes.items()})

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """Return the command of one sample, N*m, for the phase: approach, return, slip control or hand-over."""
        v, omega, applied = measurement.train_speed, measurement.wheel_speed, measurement.applied_torque
        if not math.isfinite(applied):
            return state.torque_ahead
        if not (math.isfinite(v) and math.isfinite(omega)) or v <= 0.0:
            return applied
        if state.samples == 0.0:
            state.mean_holding = ASSUMED * parameters.wheel_load * parameters.radius
            state.starting = 1.0 if above_hand_over(state, parameters, v) >= parameters.hand_over_speed else 0.0
            state.reference_slip = 0.0 if state.starting > 0.0 else parameters.largest_slip
        if omega > 0.0 and state.samples * parameters.period < _ROLLING * parameters.dead_time:
            calibrate(state, parameters, v, omega)
        omega *= state.rolling
        sigma = v - parameters.radius * omega
        reference = state.reference_slip * fading(parameters, v)
        actuator_model(state, parameters, applied)
        observe(state, parameters, v, omega, reference)
        predict(state, parameters, v, sigma, reference)
        noise = remember(state, parameters, v)
        seek(state, parameters, v, reference, noise)
        reference = state.reference_slip * fading(parameters, v)
        if state.returning > 0.0:
            torque = come_back(state, parameters, noise)
        elif state.starting > 0.0:
            torque = approach(state, parameters, v, sigma)
        else:
            torque = limited(state, parameters, sliding_torque(state, parameters, reference), reference)
            torque = hand_over(state, parameters, above_hand_over(state, parameters, v), torque, reference)
            restart(state, parameters, v, sigma / v, reference)
        state.samples += 1.0
        return min(max(torque, 0.0), parameters.torque_max)

    def described(self) -> str:
        return f"{self.label}, its own reference slip up to {self.largest_slip:g}, {self._gains_described()}"

    def headline(self) -> str:
        return f"seeking: finds the adhesion peak, slip up to {self.largest_slip:.3g}"

    def judged_slip(self, law: AdhesionLaw, speed: float, wheel_load: float) -> float:
        """Return the slip ratio where the loop is judged on a rail of constant adhesion; speed, m/s, wheel load, N.

        It is the smallest slip at which adhesion is at most 0.56 % below its peak, but at most `largest_slip`. If
        adhesion falls from slip 0 on, it is `largest_slip`. Below `fade_speed` it is smaller.
        """
        return min(_flat_slip(law, speed, wheel_load), self.largest_slip) * self._kept(speed)

    def slip_numbers(self) -> tuple[Any, ...]:
        return self.largest_slip, self.hand_over_speed, self.fade_speed


@lru_cache(maxsize=512)  # as many as cached peaks
def _flat_slip(law: AdhesionLaw, speed: float, wheel_load: float) -> float:
    """Return the smallest slip ratio with adhesion at most `_FLAT` below its peak; inf if adhesion only falls."""
    top = peak(law, speed, wheel_load)
    if top.slip < _LOWEST:
        return math.inf
    slips = np.linspace(_LOWEST, top.slip, _SLIPS)
    enough = adhesion_coefficient(law, speed, slips, wheel_load) >= (1 - _FLAT) * top.coefficient
    return float(slips[np.argmax(enough)])


# --- steps of a sample ----


def calibrate(x: Any, p: Any, v: float, omega: float) -> None:
    """Measure, on the free wheel, the ratio of train speed to believed wheel speed and the noise of both."""
    ratio, n = v / (p.radius * omega), x.samples + 1.0
    kept = (n - 1.0) / n
    x.roughness = kept * (x.roughness + (v * (1.0 - x.rolling / ratio)) ** 2 / n)
    x.jitter = kept * (x.jitter + (omega - x.turning) ** 2 / n)
    x.turning += (omega - x.turning) / n
    x.rolling += (ratio - x.rolling) / n


def above_hand_over(x: Any, p: Any, v: float) -> Any:
    """Return the train speed to compare with the hand-over speed, m/s: weak rails hold slip down to lower speeds."""
    held = x.mean_holding / (p.wheel_load * p.radius)
    return v * min(max(WEAK / max(held, 1e-3), 1.0), MOST_WEAK)


def quickly(x: Any, p: Any, torque: float) -> Any:
    """Return the command, N*m, that moves the torque ahead of the dead time towards `torque`, N*m.

    Its rate is the difference times the gain of the boundary layer.
    """
    return towards(x, p, (torque - x.torque_ahead) * (p.reaching_rate + p.switching_gain / p.layer))


def remember(x: Any, p: Any, v: float) -> Any:
    """Remember slip and torque of the highest adhesion, and begin a return when adhesion has fallen far past that slip.

    Returns the standard deviation of the predicted slip velocity, m/s. Memory is written only while slip rises, as the
    adhesion of bristles is highest while slip falls. It fades, but not while the slip is far past the peak.
    """
    reaction = p.dead_time + p.observer_time
    blend = 1.0 - math.exp(-p.period / (0.25 * reaction))
    x.remembered_torque += blend * (x.adhesion_torque - x.remembered_torque)
    x.remembered_slip += blend * (x.filtered_sigma / x.filtered_speed - x.remembered_slip)
    x.slip_ahead += (1.0 - math.exp(-p.period / p.observer_time)) * (x.sigma_ahead - x.slip_ahead)
    force = _NOISE * p.wheel_load * p.radius**2 / p.wheel_inertia  # m/s^2
    turning = p.radius * p.dead_time / p.observer_time  # the observed adhesion carries the noise of the wheel speed
    measured = (x.roughness + turning**2 * x.jitter) * p.period / (2.0 * p.observer_time)
    noise = math.sqrt(force**2 * _NOISE_HOLD * reaction + measured)
    slow, idle = p.period / (SLOWLY * reaction), x.returning == 0.0 and x.waiting <= 0.0
    if x.remembered_torque > x.top_torque and x.slip_rate >= 0.0 and x.remembered_slip * v > noise:
        x.top_torque, x.top_slip = x.remembered_torque, x.remembered_slip
    elif idle and x.remembered_slip < TWICE * x.top_slip:
        x.top_torque += slow * (x.remembered_torque - x.top_torque)
    if idle and x.torque_limit > 0.0:
        lift_limits(x, p, 3.0 * slow)
    known = x.top_torque > 0.5 * WEAKEST * p.wheel_load * p.radius and 0.0 < x.top_slip < NARROW
    fallen = x.adhesion_torque < x.remembered_torque < LESS * x.top_torque
    past = TWICE * x.top_slip * v
    far = x.slip_ahead > past + 3.0 * noise and x.filtered_sigma > past
    x.calm += p.period
    begins = idle and x.handed_over == 0.0 and known and fallen and far
    if begins and x.torque_limit > 0.0 and x.calm < SLOWLY * reaction:
        x.swings += 0.5
    if begins and x.swings < 1.0:
        x.returning, x.starting = 1.0, 0.0
        x.slip_limit = min(SHORT * x.top_slip, x.slip_limit)
        x.torque_limit = min(x.top_torque, x.torque_limit) if x.torque_limit > 0.0 else x.top_torque
    elif begins:
        x.slip_limit, x.torque_limit = 1.0, 0.0
        x.reference_slip = max(x.top_slip, x.reference_slip)
    x.reference_slip = min(x.reference_slip, x.slip_limit)
    return noise


def lift_limits(x: Any, p: Any, share: float) -> None:
    """Lift the limits after a return by a share of their distance to those of the peak of the fitted curve.

    That peak counts as at most the remembered one divided by `SHORT`.
    """
    if x.curve[0] > 0.0:
        root = math.sqrt(x.curve[0] * x.curve[2])
        top = min(p.wheel_load * p.radius / max(x.curve[1] + 2.0 * root, 1e-3), x.top_torque / SHORT)
        x.torque_limit += share * max(top - x.torque_limit, 0.0)
        top = min(x.curve[0] / max(root, 1e-9), x.top_slip / SHORT)
        x.slip_limit += share * max(SHORT * top - x.slip_limit, 0.0)


def held_share(x: Any, p: Any) -> Any:
    """Return the share of the highest adhesion torque that is held after a return, less at low speed."""
    return HELD - LOW_SPEED * p.hand_over_speed / max(x.speed_ahead, p.hand_over_speed)


def come_back(x: Any, p: Any, noise: float) -> Any:
    """Return the command, N*m, that brings the slip below the adhesion peak in dead time plus observer time."""
    reaction, goal = p.dead_time + p.observer_time, x.reference_slip * x.speed_ahead
    if x.slip_ahead > goal / SHORT + 3.0 * noise:
        return quickly(x, p, x.holding_torque - p.wheel_inertia / p.radius / reaction * (x.sigma_ahead - goal))
    x.returning, x.waiting, x.calm = 0.0, reaction, 0.0
    x.mean_torque = x.quick_torque = held_share(x, p) * x.top_torque
    return quickly(x, p, x.mean_torque)


def limited(x: Any, p: Any, torque: float, reference: float) -> Any:
    """Raise the command while the slip is below the reference; limit it after the slip was brought back below the peak.

    The sliding-mode law needs seconds to raise the slip on a steep curve. A torque below the highest adhesion torque
    cannot push the slip beyond the peak.
    """
    x.waiting = max(x.waiting - p.period, 0.0)
    ratio, slip = p.wheel_inertia / p.radius, x.filtered_sigma / x.filtered_speed
    highest = x.slip_ahead / x.speed_ahead if x.waiting > 0.0 else max(x.remembered_slip, slip)
    if x.handed_over == 0.0 and x.waiting <= 0.0 and highest < SHORT * reference and x.curve[0] > 0.0:
        known = LESS * p.wheel_load * p.radius * reference / denominator(x, reference)
        lead = 0.5 * lead_torque(x, p, x.speed_ahead, elasticity_at(x, max(slip, 0.0)))
        torque = max(torque, quickly(x, p, min(known, x.holding_torque + lead) + ratio * x.deceleration))
    if x.torque_limit == 0.0:
        return torque
    top = min(x.torque_limit, x.top_torque) if x.waiting > 0.0 else x.torque_limit
    most = quickly(x, p, held_share(x, p) * top + ratio * x.deceleration)
    return most if highest < reference else min(torque, most)


def lead_torque(x: Any, p: Any, v: float, seen: float) -> Any:
    """Return the torque that raises the slip by `LEAD` in a reaction time, N*m, and less of it where E is small.

    - v: train speed, m/s.
    - seen: E.
    """
    lead = LEAD * v * p.wheel_inertia / p.radius / (p.dead_time + p.observer_time)
    lead = min(lead, MOST * p.wheel_load * p.radius)
    return lead * min(max((seen - p.elasticity) / 0.5, 0.0), 1.0)


def learn(x: Any, p: Any, slip: float) -> None:
    """Add the present adhesion to the fit of slip/mu = a + b slip + c slip^2.

    Its weight is the inverse of its variance times how far the reference moves. Samples an e-fold of slip away fade.
    """
    per_load = 1.0 / (p.wheel_load * p.radius)
    mu = x.adhesion_torque * per_load
    share = p.period / (2.0 * p.observer_time)  # share of the variance that passes the filter of the observer
    slip_noise = x.roughness * share / x.filtered_speed**2
    if mu <= 0.0 or slip <= TWICE * math.sqrt(slip_noise):
        return
    variance = _NOISE**2 * _NOISE_HOLD / (2.0 * p.observer_time) + (0.01 * mu) ** 2
    variance += x.jitter * share * (p.wheel_inertia / p.observer_time * per_load) ** 2
    torque_rate = (torque_ago(x, delay_of(x, p)) - x.filtered_torque) / p.observer_time
    variance += (BRAKE_ERROR * (p.dead_time + p.lag) * torque_rate * per_load) ** 2
    relative = variance / mu**2 + slip_noise / slip**2
    power = min(max(x.moved, STILL), 1.0) * share / relative / (slip / mu) ** 2
    kept = math.exp(-p.period * (x.moved / (p.dead_time + p.observer_time) + STILL))
    for i in range(5):
        x.sums[i] = kept * x.sums[i] + power
        if i < 3:
            x.sides[i] = kept * x.sides[i] + power * slip / mu
        power *= slip
    fit(x, max(slip, SHORT * x.reference_slip), (mu / PRIOR) ** 2)


def fit(x: Any, scale: float, prior: float) -> None:
    """Fit slip/mu = a + b slip + c slip^2 by least squares, with a > 0, b >= 0, c >= 0.

    The prior on b and c prefers a curve without a peak.
    """
    s0, s1, s2, s3 = x.sums[0], x.sums[1], x.sums[2], x.sums[3]
    s11, s22 = s2 + prior, x.sums[4] + prior * scale**2
    c00, c01, c02 = s11 * s22 - s3 * s3, s2 * s3 - s1 * s22, s1 * s3 - s11 * s2
    c11, c12, c22 = s0 * s22 - s2 * s2, s1 * s2 - s0 * s3, s0 * s11 - s1 * s1
    y0, y1, y2 = x.sides[0], x.sides[1], x.sides[2]
    det = s0 * c00 + s1 * c01 + s2 * c02
    a, b, c = -1.0, 0.0, 0.0
    if det > 0.0:
        a, b = (c00 * y0 + c01 * y1 + c02 * y2) / det, (c01 * y0 + c11 * y1 + c12 * y2) / det
        c = (c02 * y0 + c12 * y1 + c22 * y2) / det
    if not (a > 0.0 and b >= 0.0 and c >= 0.0):  # then the best fit without b, without c, or without both
        ab, bb = (s11 * y0 - s1 * y1) / c22, (s0 * y1 - s1 * y0) / c22
        ac, cc = (s22 * y0 - s2 * y2) / c11, (s0 * y2 - s2 * y0) / c11
        a, b, c = y0 / s0, 0.0, 0.0
        gained = a * y0
        if ab > 0.0 and bb >= 0.0 and ab * y0 + bb * y1 > gained:
            a, b, gained = ab, bb, ab * y0 + bb * y1
        if ac > 0.0 and cc >= 0.0 and ac * y0 + cc * y2 > gained:
            a, b, c = ac, 0.0, cc
    x.curve[0], x.curve[1], x.curve[2] = a, b, c


def elasticity_at(x: Any, slip: float) -> Any:
    """Return E of the fitted curve at a slip ratio, at least -0.7; 1 while nothing is known."""
    a, bend = x.curve[0], x.curve[2] * slip**2
    return max((a - bend) / denominator(x, slip), -0.7) if a > 0.0 else 1.0


def denominator(x: Any, slip: float) -> Any:
    """Return slip/mu of the fitted curve at a slip ratio."""
    return x.curve[0] + (x.curve[1] + x.curve[2] * slip) * slip


def seek(x: Any, p: Any, v: float, reference: float, noise: float) -> None:
    """Learn, and move the reference slip within its limits; during the approach it follows the highest slip."""
    slip, old, reaction = x.filtered_sigma / x.filtered_speed, x.reference_slip, p.dead_time + p.observer_time
    if old == 0.0:
        if x.adhesion_torque > 0.5 * WEAKEST * p.wheel_load * p.radius and slip > 0.0:
            x.reference_slip = max(slip, 3.0 * noise / v)
        return
    if x.returning > 0.0 or x.handed_over != 0.0:
        return
    if x.waiting <= 0.0:
        learn(x, p, slip)
        if x.starting > 0.0:
            x.reference_slip = max(old, slip)
        else:
            follow(x, p, slip, reference)
        x.reference_slip = min(max(x.reference_slip, _LOWEST), p.largest_slip, x.slip_limit)
    moved = abs(math.log(x.reference_slip / old)) / p.period * reaction
    x.moved += p.period / reaction * (moved - x.moved)


def follow(x: Any, p: Any, slip: float, reference: float) -> None:
    """Move ln of the reference slip at the rate (E - E0)/reaction time: up from half of it on, down once it is reached.

    It moves down only while adhesion is below the remembered one, and from past the peak to just below it. At rest the
    random force moves the slip, which makes E appear too low: the correction grows with the share that it moves.
    """
    reaction = p.dead_time + p.observer_time
    held = max(x.remembered_torque, WEAKEST * p.wheel_load * p.radius)
    shaken = p.wheel_inertia / p.radius * max(x.filtered_sigma, 0.0) / (held * reaction)
    seen = elasticity_at(x, max(slip, min(x.reference_slip, slip / SHORT)))
    seen += PULL * max(1.0 - x.moved, 0.0) * min(shaken, 0.5)
    rate = (seen - p.elasticity) / reaction
    up = rate > 0.0 and slip > reference / TWICE
    if up or (rate < 0.0 and slip > SHORT * reference and x.remembered_torque < x.top_torque):
        x.reference_slip *= math.exp(rate * p.period)
    if rate > 0.0:
        x.reference_slip = max(x.reference_slip, min(x.remembered_slip, x.top_slip))
    elif slip > x.top_slip:
        x.reference_slip = max(x.reference_slip, SHORT * x.top_slip)


def approach(x: Any, p: Any, v: float, sigma: float) -> Any:
    """Return the command of an approach, N*m: the holding torque and a lead that shrinks with E.

    The approach ends where E at the predicted slip is below E0, or where the slip nears its largest reference.
    """
    if x.starting > 1.0 and above_hand_over(x, p, v) >= p.hand_over_speed:
        x.mean_holding += p.period / MEAN_TIME * (x.holding_torque - x.mean_holding)
    slip, seen = x.filtered_sigma / x.filtered_speed, 1.0
    if x.reference_slip > 0.0:
        late = 2.0 * BRAKE_ERROR * p.lag * x.slip_rate  # m/s, slip that a lag longer by the tolerance adds
        seen = elasticity_at(x, max(min((x.slip_ahead + late) / x.speed_ahead, TWICE * slip), slip))
        large = sigma + 0.9 * p.dead_time * x.slip_rate > 0.85 * p.largest_slip * v
        if large:
            x.reference_slip = p.largest_slip
        if large or seen < p.elasticity:
            x.starting = 0.0
    x.mean_torque = x.quick_torque = x.adhesion_torque
    lead = lead_torque(x, p, v, seen)
    return quickly(x, p, max(x.holding_torque + lead, WEAKEST * p.wheel_load * p.radius))


def restart(x: Any, p: Any, v: float, slip: float, reference: float) -> None:
    """Approach anew where adhesion rises below the reference slip, or the wheel rolls free: the rail has become better.

    Adhesion that rises as the slip comes back from past the peak does not count.
    """
    x.quick_torque += p.period / QUICK_TIME * (x.adhesion_torque - x.quick_torque)
    x.mean_torque += p.period / MEAN_TIME * (x.adhesion_torque - x.mean_torque)
    if slip > reference / SHORT:
        x.mean_torque = x.quick_torque
    x.free_time = x.free_time + p.period if slip < 0.0 and x.torque_limit == 0.0 else 0.0
    force = 3.0 * _NOISE * math.sqrt(_NOISE_HOLD / (2.0 * (p.observer_time + QUICK_TIME))) * p.wheel_load * p.radius
    rises = x.quick_torque > RISEN * max(x.mean_torque, x.top_torque) + force and slip < SHORT * reference
    if v > 1.1 * p.fade_speed and (x.free_time > p.dead_time or (rises and x.waiting <= 0.0)):
        x.starting, x.slip_limit, x.torque_limit, x.top_torque = 2.0, 1.0, 0.0, x.remembered_torque
        x.reference_slip, x.free_time = max(x.filtered_sigma / x.filtered_speed, _LOWEST), 0.0
        for i in range(5):
            x.sums[i] = 0.0
        for i in range(3):
            x.sides[i] = x.curve[i] = 0.0
