"""Predictive sliding-mode law: it acts on the slip error that is predicted over the dead time.

In the functions of this module, x is the state and p are the parameters.
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
from railslip_ctrl.model.linearization import OperatingPoint, linearize
from railslip_ctrl.model.vehicle import Actuator, Record, Vehicle

from .base import LEAST_PERIOD, PERIOD, Controller
from .linear import full_brake_torque
from .predictive_sampled import KEPT, SampledLaw, linear_wheel, sampled_laws

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Rows = NDArray[np.intp]

QUICK_TIME = 0.05  # s, shortest filter time of the seeking law

_SAMPLES_OF_DEAD_TIME = 12  # fewest samples in a dead time: with fewer, Ms exceeds 2 for light and heavy vehicles
_SPARE = 3  # samples of the torque history in addition to the dead time
FADED = 0.7  # share of the reference slip that remains at the hand-over
_LOST = 16.0  # m/s, slip velocity gained in one dead time if mu falls by 1; 15.9 for the published vehicle
_QUICKEST = 0.44  # smallest x of `for_vehicle`: below it, a brake 30 % faster than assumed makes the loop unstable
_HAND_OVER = 4.2  # slip velocity gained in one dead time over hand-over speed; gives 14 km/h for the published vehicle
_FADE = 27 / 13  # speed below which the reference fades, over the hand-over speed
_LEAST_HAND_OVER_KMH = 5  # km/h, smallest hand-over speed
MEAN_TIME = 0.5  # s, time constant of the mean of the holding torque
ASSUMED = 0.1  # adhesion coefficient assumed for the hand-over while the rail is unknown
_LOCKED = 0.9  # slip ratio above which a wheel counts as locked, below the hand-over speed
# slip ratio of a runaway before the hand-over; torque shares during the runaway, and afterwards
_RUN_AWAY, _RUN_AWAY_SHARE, _AFTERWARDS = 0.25, 0.5, 0.8


class Predictive(Controller):
    """Predictive sliding-mode law that tracks a reference slip; it has gains, and assumed values of wheel and brake.

    T+ is the torque that acts one dead time later, H the torque that holds the reference slip, e_hat the slip error
    predicted over the dead time. The surface is S = H + (J/r) kappa e_hat - T+. The command is u = T+ + T [-kappa (T+ -
    H) + k S + K sat(S/phi)], from 0 to `torque_max`; `sliding.predictive` derives the law. InputError unless
    `last_speed` < `hand_over_speed` < `fade_speed` and `last_share` <= `hand_over_share`.
    """

    kind: ClassVar[str] = "predictive"
    title: ClassVar[str] = "sliding-mode law that predicts over the dead time"
    source: ClassVar[str] = "this project"
    by_rule: ClassVar[bool] = True

    period: float = quantity(
        "s",
        "sampling period; at most the 0.05 s of its quickest filter",
        ge=LEAST_PERIOD,
        le=QUICK_TIME,
        default=PERIOD,
    )
    radius: float | None = quantity("m", "assumed wheel radius; the vehicle's if left out", gt=0, default=None)
    wheel_inertia: float | None = quantity("kg*m^2", "wheel inertia J", gt=0, default=None)
    viscous_friction: float | None = quantity("N*m*s", "viscous friction B", ge=0, default=None)
    wheel_load: float | None = quantity("N", "wheel load", gt=0, default=None)
    dead_time: float | None = quantity("s", "dead time theta of the actuator", ge=0, default=None)
    lag: float | None = quantity("s", "lag T of the actuator", ge=0, default=None)
    torque_max: float = quantity("N*m", "largest torque", gt=0)

    kappa: float = quantity("1/s", "rate at which the predicted slip error decays on the surface", gt=0)
    reaching_rate: float = quantity("1/s", "k, rate at which the surface is reached from far", ge=0)
    switching_gain: float = quantity("N*m/s", "K, lowest rate at which the surface is reached", gt=0)
    layer: float = quantity("N*m", "phi, boundary layer of the surface", gt=0)
    observer_time: float = quantity("s", "time constant of the adhesion-torque observer", gt=0)
    deceleration_time: float = quantity("s", "time constant of the train's deceleration", gt=0)

    fade_speed: float = quantity("m/s", "speed below which the reference slip fades", gt=0, default=29 * KMH)
    hand_over_speed: float = quantity("m/s", "speed below which slip is not controlled", gt=0, default=14 * KMH)
    last_speed: float = quantity("m/s", "speed at which the last share is reached", ge=0, default=2 * KMH)
    hand_over_share: float = quantity("1", "share of the mean torque at the hand-over", gt=0, le=1, default=0.84)
    last_share: float = quantity("1", "share of the mean torque at the last speed", gt=0, le=1, default=0.2)

    class State(Record):
        """Model of the brake, observer, prediction and hand-over."""

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
        mean_holding: float = quantity("N*m", "mean of the holding torque", default=0.0)
        handed_over: float = quantity("1", "1: handed over, 0: not, -1: the slip has run away", default=0.0)
        history: tuple[float, ...] = quantity("N*m", "torque_ahead of the last samples, in a ring", default=())

    def start(self, speed: float, period: float) -> Record:
        return self.State(history=(0.0,) * self._ring(period))

    def _ring(self, period: float) -> int:
        assert self.dead_time is not None, "filled in by `believing`"
        return math.ceil(self.dead_time / period) + _SPARE

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """Return the torque, N*m, that tracks the reference slip; at low speed a share of the mean holding torque."""
        v, omega, applied = measurement.train_speed, measurement.wheel_speed, measurement.applied_torque
        if not math.isfinite(applied):
            return state.torque_ahead
        if not (math.isfinite(v) and math.isfinite(omega)) or v <= 0.0:
            return applied
        if state.samples == 0.0:
            state.mean_holding = ASSUMED * parameters.wheel_load * parameters.radius
        reference = parameters.reference_slip * fading(parameters, v)
        actuator_model(state, parameters, applied)
        observe(state, parameters, v, omega, reference)
        predict(state, parameters, v, v - parameters.radius * omega, reference)
        torque = hand_over(state, parameters, v, sliding_torque(state, parameters, reference), reference)
        state.samples += 1.0
        return min(max(torque, 0.0), parameters.torque_max)

    def described(self) -> str:
        return f"{self.label}, {self._gains_described()}"

    def _gains_described(self) -> str:
        return (
            f"kappa {self.kappa:.4g} 1/s, k {self.reaching_rate:.4g} 1/s, K {self.switching_gain:.4g} N*m/s, phi "
            f"{self.layer:.4g} N*m, observer {self.observer_time:.4g} s, for a dead time of {self.dead_time:g} s and a "
            f"lag of {self.lag:g} s"
        )

    def handed_over(self) -> str:
        first, last = 100 * self.hand_over_share, 100 * self.last_share
        return f"{first:g} % of its mean torque, {last:g} % at {self.last_speed / KMH:.3g} km/h"

    def speeds_to_judge(self) -> tuple[float, ...]:
        return self.hand_over_speed, self.fade_speed

    def _kept(self, speed: float) -> float:
        return float(np.interp(speed, [self.hand_over_speed, self.fade_speed], [FADED, 1.0]))

    @classmethod
    def _orders(cls) -> tuple[tuple[str, tuple[str, ...]], ...]:
        return (
            (" <= ", ("last_share", "hand_over_share")),
            (" < ", ("last_speed", "hand_over_speed", "fade_speed")),  # the law divides by their differences
        )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for order, names in self._orders():
            values = [getattr(self, name) for name in names]
            if values != sorted(values if order == " <= " else set(values)):
                given = ", ".join(f"{value:g}" for value in values)
                raise InputError(f"{names[0]}: {given} are not in order; give {order.join(names)}")
        return self

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, *, period: float | None = None, **given: Any) -> Self:
        """Compute the gains from the wheel and the brake of a vehicle, with dead time theta and lag T.

        kappa = 0.27 x/theta, k = 0.3/theta, K = 0.23 N r/(theta + T), phi = 0.75 x theta K. The time constants are 0.34
        x theta for the observer and 0.52 theta for the deceleration. The hand-over speed is N r^2 theta/(4.2 J),
        rounded to whole km/h, at least 5 km/h; the reference fades below 27/13 times this speed. The factors were found
        from stops on many rails: halving or doubling a factor changes the distances less than the random force does.
        Light and heavy vehicles have Ms <= 2, and their loops are stable with the tolerances. The largest torque is the
        full brake torque.

        N r^2 theta/J is the slip velocity gained in one dead time if mu falls by 1. x is 16 m/s divided by it,
        limited to 0.44 .. 1: with a larger wheel load N, the slip runs away sooner past the peak, and the torque must
        follow sooner.

        - vehicle: vehicle whose wheel, wheel load and actuator are used; its mass is not used.
        - period: sampling period, s, at most a twelfth of the dead time; by default 10 ms, or a twelfth of the dead
          time if this is shorter.

        InputError: a brake without dead time, or too long a period.
        """
        dead_time = vehicle.actuator.dead_time
        if dead_time <= 0:
            raise InputError(f"{cls.kind}: dead_time {dead_time:g} s is not allowed; the gains need a value > 0 (s)")
        run_away = vehicle.wheel_load * vehicle.wheel.radius**2 * dead_time / vehicle.effective_inertia
        quick = min(max(_LOST / run_away, _QUICKEST), 1.0)
        hand_over_kmh = max(round(run_away / _HAND_OVER / KMH), _LEAST_HAND_OVER_KMH)
        longest = dead_time / _SAMPLES_OF_DEAD_TIME
        if period is not None and period > longest:
            raise InputError(
                f"{cls.kind}: period {period:g} s is not allowed with a dead time of {dead_time:g} s; give a value <= "
                f"{longest:.4g} (s), a twelfth of the dead time"
            )
        switching = 0.23 * vehicle.wheel_load * vehicle.wheel.radius / (dead_time + vehicle.actuator.lag)
        rules = {
            "torque_max": full_brake_torque(vehicle),
            "kappa": 0.27 * quick / dead_time,
            "reaching_rate": 0.3 / dead_time,
            "switching_gain": switching,
            "layer": 0.75 * quick * dead_time * switching,
            "observer_time": 0.34 * quick * dead_time,
            "deceleration_time": 0.52 * dead_time,
            "hand_over_speed": hand_over_kmh * KMH,
            "fade_speed": round(_FADE * hand_over_kmh) * KMH,
            "period": min(PERIOD, longest) if period is None else period,
        }
        return cls(**{**rules, **cls._own_rules(dead_time), **given}).believing(vehicle)

    @classmethod
    def _own_rules(cls, dead_time: float) -> dict[str, float]:
        return {}

    def loop(self, point: OperatingPoint, actuator: Actuator | None = None) -> DelayedLoop:
        """Return the exact loop in the boundary layer, opened at the acting torque; it tracks the slip of `point`.

        The train speed is constant. The symbols are g = k + K/phi, E = exp(-theta s), the filters Q = 1/(tau_o s + 1)
        of the observer and Qa of the deceleration, the transfer functions G and A from the acting torque to sigma and
        v', and the slip ratio lambda: L = E J/r [(1 + kappa/g + kappa theta) (s Q G + ((1 - lambda) Qa - Q) A) + kappa
        G] / [s/g + 1 + kappa/g + kappa (1 - E)/s - (1 + kappa/g + kappa theta) Q E]. The law is taken as
        continuous in time; `loop_as_run` is the sampled loop.

        - point: operating point of wheel and rail.
        - actuator: dead time and lag of the brake, s; by default those that the law assumes.

        Returns the dimensionless loop with the dead times of the model and of the brake.
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
        stable, ms = np.zeros(case[0].size, dtype=bool), np.full(case[0].size, np.inf)
        for mine, loops in sampled_laws(self, points, brakes, case):
            stable[mine], ms[mine] = loops.stable_and_ms
        return stable, ms

    def loop_as_run(self, point: OperatingPoint, actuator: Actuator) -> SampledLaw:
        first = np.zeros(1, dtype=np.intp)
        loops = next(sampled_laws(self, [point], [actuator], (first, first)))[1]
        return SampledLaw(loops, linear_wheel(point), actuator)


def _blocks(point: OperatingPoint, law: Predictive) -> tuple[Floats, Floats, Floats]:
    """Return the loop's numerator without the brake, and its denominator's terms without and with the dead time."""
    assert law.dead_time is not None, "filled in by `believing`"
    assert law.lag is not None, "as above"
    assert law.wheel_inertia is not None, "as above"
    den, sigma, v_rate = _responses(point)
    slip, ratio = point.slip, law.wheel_inertia / point.vehicle.wheel.radius
    quick = 1 / (law.reaching_rate + law.switching_gain / law.layer)
    own, more = 1 + law.kappa * quick, 1 + law.kappa * quick + law.kappa * law.dead_time
    s, observer, slow, lag, torque = (
        np.array([tau, one])
        for tau, one in (
            *((1.0, 0.0), (law.observer_time, 1.0), (law.deceleration_time, 1.0)),
            *((law.lag, 1.0), (quick, own)),
        )
    )
    both = _product(observer, slow, sigma)
    turning = _product(_sum((1 - slip) * observer, -slow), v_rate)
    holding = _sum(_product(s, slow, sigma), turning)
    above = ratio * _product(_sum(more * holding, law.kappa * both), lag, s)
    undelayed = _sum(_product(observer, torque, s), law.kappa * observer)
    delayed = -_sum(law.kappa * observer, more * s)
    return above, _product(undelayed, den, slow), _product(delayed, den, slow)


def _product(*polynomials: Floats) -> Floats:
    return reduce(np.convolve, polynomials)


def _sum(*polynomials: Floats) -> Floats:
    return reduce(lambda one, other: np.asarray(np.polyadd(one, other)), polynomials)


@lru_cache(KEPT)
def _responses(point: OperatingPoint) -> tuple[Floats, Floats, Floats]:
    """Return the denominator and numerators of the responses of sigma and v' to the torque, at constant speed."""
    plant, moving = linearize(point), linearize(point, speed_state=True)
    den = np.asarray(np.poly(plant.A).real, dtype=float)
    sigma = np.array([[float(name == "sigma") for name in plant.states]])
    found = [np.asarray(np.poly(plant.A - plant.B @ row).real - den, dtype=float) for row in (sigma, moving.A[:1, 1:])]
    return den, found[0], found[1]


def actuator_model(x: Any, p: Any, applied: float) -> None:
    """Update the model of the torque that acts one dead time later, and its history, from the applied torque."""
    k, ring = int(x.samples), len(x.history)
    if k > 0:
        x.torque_ahead += (1.0 - math.exp(-p.period / p.lag) if p.lag > 0.0 else 1.0) * (applied - x.torque_ahead)
    x.history[k % ring] = x.torque_ahead


def delay_of(x: Any, p: Any) -> Any:
    """Return the dead time in samples, at most the length of the history less 2."""
    return min(p.dead_time / p.period, len(x.history) - 2.0)


def torque_ago(x: Any, samples: float) -> Any:
    """Return the modelled torque `torque_ahead` of the state, N*m, `samples` samples before now; at first 0."""
    k, ring, whole = int(x.samples), len(x.history), int(samples)
    share = samples - whole
    late = x.history[(k - whole) % ring] if k >= whole else 0.0
    later = x.history[(k - whole - 1) % ring] if k > whole else 0.0
    return (1.0 - share) * late + share * later


def observe(x: Any, p: Any, v: float, omega: float, reference: float) -> None:
    """Estimate the adhesion torque Ta = (J omega' + B omega + T)/(tau_o s + 1) and the torque that holds the slip."""
    sigma = v - p.radius * omega
    if x.samples == 0.0:
        x.filtered_omega, x.filtered_sigma, x.filtered_speed, x.slow_speed = omega, sigma, v, v
    blend, slow = 1.0 - math.exp(-p.period / p.observer_time), 1.0 - math.exp(-p.period / p.deceleration_time)
    acting = torque_ago(x, delay_of(x, p))
    x.filtered_omega += blend * (omega - x.filtered_omega)
    x.filtered_torque += blend * (acting - x.filtered_torque)
    x.filtered_sigma += blend * (sigma - x.filtered_sigma)
    x.filtered_speed += blend * (v - x.filtered_speed)
    rate = blend / (1.0 - blend) / p.period  # factor from a filter's error to the derivative of its output
    x.slip_rate = rate * (sigma - x.filtered_sigma)
    spin = rate * (omega - x.filtered_omega)
    x.adhesion_torque = p.wheel_inertia * spin + p.viscous_friction * x.filtered_omega + x.filtered_torque
    x.slow_speed += slow * (v - x.slow_speed)
    x.deceleration = slow / (1.0 - slow) / p.period * (x.slow_speed - v)
    turning = p.wheel_inertia / p.radius * x.deceleration * (1.0 - reference)
    x.holding_torque = x.adhesion_torque + turning - p.viscous_friction * x.filtered_omega


def predict(x: Any, p: Any, v: float, sigma: float, reference: float) -> None:
    """Predict slip velocity and train speed for the time when the present command acts, at constant adhesion torque."""
    count = delay_of(x, p)
    under_way = 0.0
    for i in range(int(count)):
        under_way += torque_ago(x, float(i)) * p.period
    under_way += (count - int(count)) * p.period * torque_ago(x, count)
    slowing = p.dead_time * x.deceleration
    x.speed_ahead = v - slowing
    added = p.radius / p.wheel_inertia * (under_way - p.dead_time * x.holding_torque)
    x.sigma_ahead = sigma + added - reference * slowing  # H holds the slip ratio, so the slip velocity falls with v


def fading(p: Any, v: float) -> Any:
    """Return the factor on the reference slip at train speed v: 1 from the fade speed up, 0.7 at hand-over speed."""
    if v >= p.fade_speed:
        return 1.0
    return 0.7 + 0.3 * max(v - p.hand_over_speed, 0.0) / (p.fade_speed - p.hand_over_speed)


def towards(x: Any, p: Any, rate: float) -> Any:
    """Return the command at which torque_ahead changes at the given rate, N*m/s."""
    return x.torque_ahead + max(p.lag, p.period) * rate


def sliding_torque(x: Any, p: Any, reference: float) -> Any:
    """Command of the law: k S + K sat(S/phi) brings S to 0; on S = 0 the predicted slip error decays at rate kappa."""
    error = reference * x.speed_ahead - x.sigma_ahead
    held = x.holding_torque
    surface = held + p.wheel_inertia / p.radius * p.kappa * error - x.torque_ahead
    reached = p.reaching_rate * surface + p.switching_gain * min(max(surface / p.layer, -1.0), 1.0)
    return towards(x, p, reached - p.kappa * (x.torque_ahead - held))


def hand_over(x: Any, p: Any, v: float, torque: float, reference: float) -> Any:
    """Limit the torque below the hand-over speed to a share of the mean holding torque.

    The share falls with the fourth power of the decrease of speed since the hand-over. Once the slip is below the
    reference, this torque is commanded without feedback. Until then, a runaway slip halves the torque. If the wheel
    locks, the torque is 0. After a runaway slip or a lock, the mean holding torque is reduced by 20 %.
    """
    if v >= p.hand_over_speed:
        x.mean_holding += p.period / MEAN_TIME * (x.holding_torque - x.mean_holding)
        return torque
    slip = x.filtered_sigma / x.filtered_speed
    if slip > _LOCKED or (x.handed_over <= 0.0 and slip > _RUN_AWAY):
        x.handed_over = -1.0
    elif x.handed_over <= 0.0 and max(slip, x.sigma_ahead / x.speed_ahead) < reference:
        x.mean_holding *= _AFTERWARDS if x.handed_over < 0.0 else 1.0
        x.handed_over = 1.0
    slow = min((p.hand_over_speed - v) / (p.hand_over_speed - p.last_speed), 1.0)
    held = (p.hand_over_share - (p.hand_over_share - p.last_share) * slow**4) * x.mean_holding
    if slip > _LOCKED:
        return 0.0
    if x.handed_over > 0.0:
        return held
    return min(torque, _RUN_AWAY_SHARE * held if slip > _RUN_AWAY else held)
