"""The seeking controller: it finds the peak of adhesion and is told neither rail nor mass nor adhesion curve.

The parts, in the order in which a sample runs them: model of the actuator, adhesion-torque observer, predictor over the
dead time, map of adhesion and peak seeking, then fast start or inner loop, low-speed hand-over, re-adhesion. In their
formulas x is the state and p the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, reduce
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from pydantic import model_validator

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, quantity
from railslip_ctrl.loop.quasi import DelayedLoop, DelayedRatio, QuasiPolynomial
from railslip_ctrl.loop.quasi_batch import QuasiPolynomials, stable_and_peak
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.linearization import OperatingPoint, linearize
from railslip_ctrl.model.numeric import adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import Actuator, Record, Vehicle

from .base import LEAST_PERIOD, PERIOD, Controller
from .linear import TORQUE_LIMIT, adhesion_share

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Rows = NDArray[np.intp]

KNOTS = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.06, 0.075, 0.09, 0.105, 0.12, 0.135, 0.15, 0.17)
"""Slip ratios at which the map of adhesion has values."""

_SAMPLES_OF_DEAD_TIME = 12  # least, in a dead time: more add at most 4 % to Ms
_SPARE = 3  # samples of the torque history beyond the dead time

FADED = 0.7
"""Share of the reference slip that is left at the hand-over."""

_LOST = 16.0  # m/s of slip in a dead time, were all adhesion of mu = 1 lost; the published vehicle's: 15.9
_QUICKEST = 0.44  # of x: with less, a brake 30 % quicker than believed makes the loop unstable
_HAND_OVER = 4.2  # that, over the speed below which the slip ratio is not held: 14 km/h for the published vehicle
_FADE = 27 / 13  # the speed below which the reference fades, over that
_LEAST_HAND_OVER_KMH = 5
_SLIPS = 1001  # up to the peak, among which the slip held is looked for

_MEAN_TIME = 0.5  # s, of the means that a rise of adhesion and the hand-over are judged by
QUICK_TIME = 0.05  # s
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
_ASSUMED = 0.1  # adhesion coefficient of a rail of which nothing is known yet, at the hand-over
_LOCKED = 0.9  # slip of a wheel that turns no more, at the hand-over
# slip that has run away before; share of the torque to be held meanwhile, and afterwards
_RUN_AWAY, _LET_GO, _LESS = 0.25, 0.5, 0.8
_REACHED = 0.85  # of the reference: with less slip the map does not lower it, if it is not low
_MOST_THROWN = 0.5  # slip that a start's torque adds in a dead time: with more a heavy wheel locks on a weak rail
_TINY = 1e-9  # of the map: weight of a knot never visited
_WEIGHED_TIME = 0.01  # s, that weighs 1 in the map, against its curvature
_LOWEST_SLIP = 1e-4  # whose logarithm is taken


class Seeking(Controller):
    """A controller that seeks the peak of adhesion: what it believes of wheel and brake, and its own numbers; SI.

    Its reference is its own; `reference` only judges the slip, if it is given. InputError for a number out of its
    range, or slips or speeds that are not in order.
    """

    kind: ClassVar[str] = "seeking"
    title: ClassVar[str] = "finds the peak of adhesion, rail unknown"
    source: ClassVar[str] = "this project"
    follows_reference: ClassVar[bool] = False
    finds_slip: ClassVar[bool] = True
    no_loop: ClassVar[str] = "its loop is that of its inner part"

    period: float = quantity(
        "s",
        "sampling period; at most the 0.05 s of its quickest filter",
        ge=LEAST_PERIOD,
        le=QUICK_TIME,
        default=PERIOD,
    )
    reference: ReferenceSlip | None = None
    radius: float | None = quantity("m", "wheel radius that it believes; the vehicle's if left out", gt=0, default=None)
    wheel_inertia: float | None = quantity("kg*m^2", "wheel inertia J", gt=0, default=None)
    viscous_friction: float | None = quantity("N*m*s", "viscous friction B", ge=0, default=None)
    wheel_load: float | None = quantity("N", "wheel load, by which its map is scaled", gt=0, default=None)
    dead_time: float | None = quantity("s", "dead time theta of the actuator", ge=0, default=None)
    lag: float | None = quantity("s", "lag of the actuator", ge=0, default=None)
    torque_max: float = quantity("N*m", "largest torque", gt=0)

    kappa: float = quantity("1/s", "rate at which the inner loop takes away the slip error", gt=0)
    torque_time: float = quantity("s", "time constant that the acting torque is given", gt=0)
    observer_time: float = quantity("s", "time constant of the adhesion-torque observer", gt=0)
    deceleration_time: float = quantity("s", "time constant of the train's deceleration", gt=0)

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

    fade_speed: float = quantity("m/s", "speed below which the reference slip fades", gt=0, default=29 * KMH)
    hand_over_speed: float = quantity("m/s", "speed below which it is handed over", gt=0, default=14 * KMH)
    last_speed: float = quantity("m/s", "speed at which the last share is reached", ge=0, default=2 * KMH)
    hand_over_share: float = quantity("1", "share of the mean torque at the hand-over", gt=0, le=1, default=0.84)
    last_share: float = quantity("1", "share of the mean torque at the last speed", gt=0, le=1, default=0.2)

    knots: tuple[float, ...] = quantity("1", "slip ratios at which the map has values", default=KNOTS)

    class State(Record):
        """Model of the brake, observer, reference, start and map."""

        samples: float = quantity("1", "samples since the start", default=0.0)
        torque_ahead: float = quantity("N*m", "acting torque ahead of the dead time, modelled", default=0.0)
        filtered_omega: float = quantity("rad/s", "wheel speed, filtered", default=0.0)
        filtered_torque: float = quantity("N*m", "acting torque, filtered", default=0.0)
        filtered_sigma: float = quantity("m/s", "slip velocity, filtered", default=0.0)
        filtered_speed: float = quantity("m/s", "train speed, filtered", default=0.0)
        slow_speed: float = quantity("m/s", "train speed behind the filter of the deceleration", default=0.0)
        adhesion_torque: float = quantity("N*m", "adhesion torque, estimated", default=0.0)
        deceleration: float = quantity("m/s^2", "deceleration of the train, estimated", default=0.0)
        holding_torque: float = quantity("N*m", "torque that holds the slip", default=0.0)
        sigma_ahead: float = quantity("m/s", "slip velocity predicted for a dead time ahead", default=0.0)
        speed_ahead: float = quantity("m/s", "train speed predicted for a dead time ahead", default=0.0)
        slip_rate: float = quantity("m/s^2", "rate of the slip velocity", default=0.0)
        reference_slip: float = quantity("1", "slip ratio that it holds", default=0.0)
        peak: float = quantity("1", "slip ratio of the peak of the map; 0: not known yet", default=0.0)
        starting: float = quantity("1", "0: no start, 1: the first, 2: slip stayed low, 3: adhesion rose", default=0.0)
        last_log_torque: float = quantity("1", "ln of the adhesion torque of the last step of elasticity", default=0.0)
        last_log_slip: float = quantity("1", "ln of its slip; 0: none yet", default=0.0)
        flat_samples: float = quantity("1", "steps in turn over which adhesion did not rise", default=0.0)
        low_time: float = quantity("s", "time for which the slip was low", default=0.0)
        mean_torque: float = quantity("N*m", "mean of the adhesion torque", default=0.0)
        quick_torque: float = quantity("N*m", "its mean over a shorter time", default=0.0)
        mean_holding: float = quantity("N*m", "mean of the holding torque", default=0.0)
        handed_over: float = quantity("1", "1: handed over, 0: not, -1: the slip has run away", default=0.0)
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
        history: tuple[float, ...] = quantity("N*m", "torque ahead of the last samples, in a ring", default=())
        weights: tuple[float, ...] = quantity("1", "of the map: normal matrix, diagonal and next to it", default=())
        sums: tuple[float, ...] = quantity("1", "of the map: right-hand side", default=())
        factors: tuple[float, ...] = quantity("1", "of the map: factors of the matrix", default=())
        adhesion: tuple[float, ...] = quantity("1", "of the map: adhesion coefficients at the knots", default=())

    def start(self, speed: float, period: float) -> Record:
        assert self.dead_time is not None, "filled in by `believing`"
        knots = len(self.knots)
        sizes = {"history": math.ceil(self.dead_time / period) + _SPARE, "weights": 2 * knots, "sums": knots}
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
            state.mean_holding = _ASSUMED * parameters.wheel_load * parameters.radius
        sigma = v - parameters.radius * omega
        reference = state.reference_slip * fading(parameters, v)
        actuator_model(state, parameters, applied)
        observe(state, parameters, v, omega, reference)
        predict(state, parameters, v, sigma)
        seek(state, parameters, reference)
        if state.starting > 0.0:
            if v >= parameters.hand_over_speed and state.starting > 1.0:
                state.mean_holding += parameters.period / _MEAN_TIME * (state.holding_torque - state.mean_holding)
            torque = fast_start(state, parameters, v, sigma, reference)
        else:
            torque = hand_over(state, parameters, v, inner_loop(state, parameters, reference), reference)
            readhesion(state, parameters, v, sigma / v, reference)
        state.samples += 1.0
        return min(max(torque, 0.0), parameters.torque_max)

    def described(self) -> str:
        return (
            f"{self.label}, its own reference slip from {self.least_slip:g} to {self.largest_slip:g}, kappa "
            f"{self.kappa:.4g} 1/s, torque time {self.torque_time:.4g} s, observer {self.observer_time:.4g} s"
            f", for a dead time of {self.dead_time:g} s and a lag of {self.lag:g} s"
        )

    def headline(self) -> str:
        return f"seeking: finds the adhesion peak, slip {self.least_slip:.3g} to {self.largest_slip:.3g}"

    def handed_over(self) -> str:
        first, last = 100 * self.hand_over_share, 100 * self.last_share
        return f"{first:g} % of its mean torque, {last:g} % at {self.last_speed / KMH:.3g} km/h"

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

    def speeds_to_judge(self) -> tuple[float, ...]:
        """Where it hands over, and where the slip that it holds begins to fade: the worst may be one of these."""
        return self.hand_over_speed, self.fade_speed

    def _kept(self, speed: float) -> float:
        """The share of the reference slip that is held at a speed, m/s."""
        return float(np.interp(speed, [self.hand_over_speed, self.fade_speed], [FADED, 1.0]))

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        orders = (
            (" <= ", ("least_slip", "first_slip", "largest_slip")),
            (" <= ", ("last_share", "hand_over_share")),
            (" < ", ("last_speed", "hand_over_speed", "fade_speed")),  # it divides by their differences
        )
        for order, names in orders:
            values = [getattr(self, name) for name in names]
            if values != sorted(values if order == " <= " else set(values)):
                told = ", ".join(f"{value:g}" for value in values)
                raise InputError(f"{names[0]}: {told} are not in order; give {order.join(names)}")
        return self

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, *, period: float | None = None, **given: Any) -> Self:
        """The gains for a vehicle, by rules in its dead time theta: kappa = 0.152 x/theta, torque time 0.75 x theta,
        observer 0.34 x theta, deceleration 0.52 theta, start lead 0.9 theta; hand-over below N r^2 theta/(4.2 J), in
        whole km/h and at least 5, and the reference fades from 27/13 of that speed on. The factors were searched for
        over stops, x for Ms <= 2 on light and heavy vehicles, stable with their tolerances.

        x = 16 m/s J/(N r^2 theta), from 0.44 to 1: under a heavy load for its wheel the slip runs away sooner past the
        peak, so that the torque must follow sooner; and the noise of J omega' is less of N r, so that less of it need
        be filtered. N r^2 theta/J is the slip velocity it runs away by in a dead time without adhesion, of mu = 1: at
        the hand-over 4.2 times the train's speed. The largest torque is what an empty wheel bears until the dead time
        is over.

        - vehicle: its wheel, wheel load and actuator count; its mass does not.
        - period: sampling period, s; left out 10 ms, or a twelfth of the dead time if that is less, with which sampling
          adds at most 4 % to Ms. A longer one is refused.

        InputError: a brake without dead time, or a period beyond that.
        """
        dead_time = vehicle.actuator.dead_time
        if dead_time <= 0:
            raise InputError(f"seeking: dead_time {dead_time:g} s is not allowed; its gains go by it, give one > 0")
        run_away = vehicle.wheel_load * vehicle.wheel.radius**2 * dead_time / vehicle.effective_inertia
        quick = min(max(_LOST / run_away, _QUICKEST), 1.0)
        hand_over_kmh = max(round(run_away / _HAND_OVER / KMH), _LEAST_HAND_OVER_KMH)
        longest = dead_time / _SAMPLES_OF_DEAD_TIME
        if period is not None and period > longest:
            raise InputError(
                f"seeking: period {period:g} s is not allowed with a dead time of {dead_time:g} s; give a value <= "
                f"{longest:.4g} (s), a twelfth of that"
            )
        rules = {
            "torque_max": TORQUE_LIMIT * adhesion_share(vehicle, vehicle.wheel_load),
            "kappa": 0.152 * quick / dead_time,
            "torque_time": 0.75 * quick * dead_time,
            "observer_time": 0.34 * quick * dead_time,
            "deceleration_time": 0.52 * dead_time,
            "start_lead": 0.9 * dead_time,
            "hand_over_speed": hand_over_kmh * KMH,
            "fade_speed": round(_FADE * hand_over_kmh) * KMH,
            "period": min(PERIOD, longest) if period is None else period,
        }
        return cls(**{**rules, **given}).believing(vehicle)

    def loop(self, point: OperatingPoint, actuator: Actuator | None = None) -> DelayedLoop:
        """The exact loop of the inner part at a point, broken at the acting torque; its reference is the point's slip.

        The speed is frozen. With E = exp(-theta s), Q = 1/(tau_o s + 1) of the observer, Qa of the deceleration, G and
        A from the acting torque to sigma and v', lambda the slip ratio: L = E J/r [(1 + kappa theta) (s Q G +
        ((1 - lambda) Qa - Q) A) + kappa (G - lambda theta Qa A)] / [tau_c s + 1 + kappa (1 - E)/s - (1 + kappa theta) Q
        E]. It runs sampled; this is the loop of a short period.

        - point: of wheel and rail.
        - actuator: the brake, s; left out, as believed.

        Returns the loop of the believed dead time and the brake's, dimensionless.
        """
        assert self.dead_time is not None, "filled in by `believing`"
        assert self.lag is not None, "as above"
        brake = Actuator(dead_time=self.dead_time, lag=self.lag) if actuator is None else actuator
        above, undelayed, delayed = _blocks(point, self)
        lag = np.array([brake.lag, 1.0])
        numerator = QuasiPolynomial([[0.0], above], [0.0, brake.dead_time], removed=1)
        parts = [np.convolve(undelayed, lag), np.convolve(delayed, lag)]
        denominator = QuasiPolynomial(parts, [0.0, self.dead_time], removed=1)
        return DelayedLoop(DelayedRatio(numerator, denominator))

    def stable_and_ms(
        self, points: Sequence[OperatingPoint], brakes: Sequence[Actuator], case: tuple[Rows, Rows]
    ) -> tuple[NDArray[np.bool_], Floats]:
        """As `Controller.stable_and_ms`, of `loop`."""
        assert self.dead_time is not None, "filled in by `believing`"
        blocks = [_blocks(point, self) for point in points]
        lag, dead_time = (np.array([getattr(one, name) for one in brakes])[case[1]] for name in ("lag", "dead_time"))
        stable, ms = np.zeros(lag.size, dtype=bool), np.full(lag.size, np.inf)
        kinds = np.array([tuple(part.size for part in parts) for parts in blocks])
        for kind in np.unique(kinds, axis=0):
            mine = np.flatnonzero((kinds == kind).all(axis=1)[case[0]])
            above, undelayed, delayed = (np.array([blocks[i][k] for i in case[0][mine].tolist()]) for k in range(3))
            none, believed = np.zeros(mine.size), np.full(mine.size, self.dead_time)
            numerator = QuasiPolynomials((none[:, None], above), (none, dead_time[mine]), removed=1)
            parts = tuple(
                np.column_stack([lag[mine, None] * part, none]) + np.column_stack([none, part])
                for part in (undelayed, delayed)
            )
            denominator = QuasiPolynomials(parts, (none, believed), removed=1)
            stable[mine], ms[mine] = stable_and_peak(numerator, denominator)
        return stable, ms


@lru_cache(64)  # the actuators of an envelope follow each other at a point
def _blocks(point: OperatingPoint, gains: Seeking) -> tuple[Floats, Floats, Floats]:
    """Of the loop without the brake: numerator, and the parts of the denominator without and with the delay."""
    assert gains.dead_time is not None, "filled in by `believing`"
    assert gains.lag is not None, "as above"
    assert gains.wheel_inertia is not None, "as above"
    den, sigma, v_rate = _responses(point)
    more, slip, ratio = 1 + gains.kappa * gains.dead_time, point.slip, gains.wheel_inertia / point.vehicle.wheel.radius
    s, observer, slow, lag, torque = (
        np.array([tau, one])
        for tau, one in (
            *((1.0, 0.0), (gains.observer_time, 1.0), (gains.deceleration_time, 1.0)),
            *((gains.lag, 1.0), (gains.torque_time, 1.0)),
        )
    )
    both = _product(observer, slow, sigma)
    turning = _product(_sum((1 - slip) * observer, -slow), v_rate)
    holding = _sum(_product(s, slow, sigma), turning)
    error = _sum(both, -slip * gains.dead_time * _product(observer, v_rate))
    above = ratio * _product(_sum(more * holding, gains.kappa * error), lag, s)
    undelayed = _sum(_product(observer, torque, s), gains.kappa * observer)
    delayed = -_sum(gains.kappa * observer, more * s)
    return above, _product(undelayed, den, slow), _product(delayed, den, slow)


def _product(*polynomials: Floats) -> Floats:
    return reduce(np.convolve, polynomials)


def _sum(*polynomials: Floats) -> Floats:
    return reduce(lambda one, other: np.asarray(np.polyadd(one, other)), polynomials)


def _responses(point: OperatingPoint) -> tuple[Floats, Floats, Floats]:
    """Common denominator, and numerators of acting torque to sigma and to v', the speed frozen."""
    plant, moving = linearize(point), linearize(point, speed_state=True)
    den = np.asarray(np.poly(plant.A).real, dtype=float)
    sigma = np.array([[float(name == "sigma") for name in plant.states]])
    found = [np.asarray(np.poly(plant.A - plant.B @ row).real - den, dtype=float) for row in (sigma, moving.A[:1, 1:])]
    return den, found[0], found[1]


# --- the parts of a sample ----


def actuator_model(x: Any, p: Any, applied: float) -> None:
    """Acting torque ahead of the dead time, from the command that the brake took; into its history."""
    k, ring = int(x.samples), len(x.history)
    if k > 0:
        x.torque_ahead += (1.0 - math.exp(-p.period / p.lag) if p.lag > 0.0 else 1.0) * (applied - x.torque_ahead)
    x.history[k % ring] = x.torque_ahead


def torque_ago(x: Any, samples: float) -> Any:
    """The modelled torque a number of samples ago, N*m; 0 before the first, in between linear."""
    k, ring, whole = int(x.samples), len(x.history), int(samples)
    share = samples - whole
    late = x.history[(k - whole) % ring] if k >= whole else 0.0
    later = x.history[(k - whole - 1) % ring] if k > whole else 0.0
    return (1.0 - share) * late + share * later


def observe(x: Any, p: Any, v: float, omega: float, reference: float) -> None:
    """Adhesion torque Ta = (J omega' + B omega + T)/(tau_o s + 1), and the torque that holds the reference slip."""
    sigma = v - p.radius * omega
    if x.samples == 0.0:
        x.filtered_omega, x.filtered_sigma, x.filtered_speed, x.slow_speed = omega, sigma, v, v
    blend, slow = 1.0 - math.exp(-p.period / p.observer_time), 1.0 - math.exp(-p.period / p.deceleration_time)
    acting = torque_ago(x, p.dead_time / p.period)
    x.filtered_omega += blend * (omega - x.filtered_omega)
    x.filtered_torque += blend * (acting - x.filtered_torque)
    x.filtered_sigma += blend * (sigma - x.filtered_sigma)
    x.filtered_speed += blend * (v - x.filtered_speed)
    rate = blend / (1.0 - blend) / p.period  # of a filtered value to its derivative
    x.slip_rate = rate * (sigma - x.filtered_sigma)
    spin = rate * (omega - x.filtered_omega)
    x.adhesion_torque = p.wheel_inertia * spin + p.viscous_friction * x.filtered_omega + x.filtered_torque
    x.slow_speed += slow * (v - x.slow_speed)
    x.deceleration = slow / (1.0 - slow) / p.period * (x.slow_speed - v)
    turning = p.wheel_inertia / p.radius * x.deceleration * (1.0 - reference)
    x.holding_torque = x.adhesion_torque + turning - p.viscous_friction * x.filtered_omega


def predict(x: Any, p: Any, v: float, sigma: float) -> None:
    """Slip velocity and train speed when a command of now acts, the adhesion torque as it is."""
    count = p.dead_time / p.period
    under_way = 0.0
    for i in range(int(count)):
        under_way += torque_ago(x, float(i)) * p.period
    under_way += (count - int(count)) * p.period * torque_ago(x, count)
    x.sigma_ahead = sigma + p.radius / p.wheel_inertia * (under_way - p.dead_time * x.holding_torque)
    x.speed_ahead = v - p.dead_time * x.deceleration


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
        i = knots - 1 - back
        total = x.adhesion[i]
        if i + 1 < knots:
            total -= x.factors[3 * i + 1] * x.adhesion[i + 1]
        if i + 2 < knots:
            total -= x.factors[3 * i + 2] * x.adhesion[i + 2]
        x.adhesion[i] = total / x.factors[3 * i]


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


def fading(p: Any, v: float) -> Any:
    """The share of the reference slip to be held at a speed."""
    if v >= p.fade_speed:
        return 1.0
    return 0.7 + 0.3 * max(v - p.hand_over_speed, 0.0) / (p.fade_speed - p.hand_over_speed)


def quick_torque(x: Any, p: Any, wanted: float) -> Any:
    """The command that gives the acting torque the time constant tau_c towards what is wanted."""
    quick = max(p.lag / p.torque_time, 1.0 - math.exp(-p.period / p.torque_time))  # the latter of a brake without lag
    return x.torque_ahead + quick * (wanted - x.torque_ahead)


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
        most = min(most, quick_torque(x, p, SLOW_SHARE * x.holding_torque))
    if x.starting > 1.0:
        return min(most, p.again_share * max(x.mean_holding, x.holding_torque))
    return most


def inner_loop(x: Any, p: Any, reference: float) -> Any:
    """The command that brings the predicted slip to the reference with kappa, the acting torque in tau_c."""
    error = reference * x.speed_ahead - x.sigma_ahead
    wanted = x.holding_torque + p.wheel_inertia / p.radius * p.kappa * error
    below = min(max((error / (reference * x.speed_ahead) - 0.25) / 0.75, 0.0), 1.0)
    if below > 0.0:
        wanted = max(wanted, x.holding_torque * (1.0 + 0.3 * below))
    return quick_torque(x, p, wanted)


def hand_over(x: Any, p: Any, v: float, torque: float, reference: float) -> Any:
    """Below the hand-over speed at most a share of what held the slip before, which falls with the square of the speed
    lost; that share itself from where the slip is below its reference: then nothing is fed back, and the brake's lag is
    left alone. But before that a slip that has run away is let go, and a wheel that has locked at any time; afterwards
    less is held."""
    if v >= p.hand_over_speed:
        x.mean_holding += p.period / _MEAN_TIME * (x.holding_torque - x.mean_holding)
        return torque
    slip = x.filtered_sigma / x.filtered_speed
    if slip > _LOCKED or (x.handed_over <= 0.0 and slip > _RUN_AWAY):
        x.handed_over = -1.0
    elif x.handed_over <= 0.0 and max(slip, x.sigma_ahead / x.speed_ahead) < reference:
        x.mean_holding *= _LESS if x.handed_over < 0.0 else 1.0
        x.handed_over = 1.0
    slow = min((p.hand_over_speed - v) / (p.hand_over_speed - p.last_speed), 1.0)
    held = (p.hand_over_share - (p.hand_over_share - p.last_share) * slow**2) * x.mean_holding
    if slip > _LOCKED:
        return 0.0
    if x.handed_over > 0.0:
        return held
    return min(torque, _LET_GO * held if slip > _RUN_AWAY else held)


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
        x.mean_torque += p.period / _MEAN_TIME * (x.adhesion_torque - x.mean_torque)
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
