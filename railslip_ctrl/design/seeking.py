"""The gains of the seeking slip controller, from vehicle and actuator.

It is told neither rail nor mass nor adhesion curve. Its parts are in `simulation.seeking_step`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, reduce
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from pydantic import model_validator

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, quantity
from railslip_ctrl.loop.quasi import DelayedLoop, DelayedRatio, QuasiPolynomial
from railslip_ctrl.loop.quasi_batch import QuasiPolynomials, stable_and_peak
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.linearization import OperatingPoint, linearize
from railslip_ctrl.model.numeric import adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import Actuator, Record, Vehicle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Rows = NDArray[np.intp]

FADED = 0.7
"""Share of the reference slip that is left at the hand-over."""

_RUN_AWAY = 16.0  # m/s of slip in a dead time, were all adhesion of mu = 1 lost; the published vehicle's: 15.9
_QUICKEST = 0.44  # of x: with less, a brake 30 % quicker than believed makes the loop unstable
_HAND_OVER = 4.2  # that, over the speed below which the slip ratio is not held: 14 km/h for the published vehicle
_FADE = 27 / 13  # the speed below which the reference fades, over that
_LEAST_HAND_OVER_KMH = 5
_SLIPS = 1001  # up to the peak, among which the slip held is looked for


class SeekingGains(Record):
    """All numbers of a seeking controller: what it believes of wheel and actuator, and what it does with that; SI.

    InputError for a number out of its range, or slips or speeds that are not in order.
    """

    structure: ClassVar[str] = "seeking"

    inertia: float = quantity("kg*m^2", "wheel inertia J", gt=0)
    viscous_friction: float = quantity("N*m*s", "viscous friction B", ge=0)
    wheel_load: float = quantity("N", "wheel load, by which its map is scaled", gt=0)
    dead_time: float = quantity("s", "dead time theta of the actuator", ge=0)
    lag: float = quantity("s", "lag of the actuator", ge=0)
    torque_high: float = quantity("N*m", "largest torque", gt=0)

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


@checked
def seeking_gains(vehicle: Vehicle, torque_high: float) -> SeekingGains:
    """The gains for a vehicle, by rules in its dead time theta: kappa = 0.152 x/theta, torque time
    0.75 x theta, observer 0.34 x theta, deceleration 0.52 theta, start lead 0.9 theta; hand-over below
    N r^2 theta/(4.2 J), in whole km/h and at least 5, and the reference fades from 27/13 of that speed on. The factors
    were searched for over stops, x for Ms <= 2 on light and heavy vehicles, stable with their tolerances.

    x = 16 m/s J/(N r^2 theta), from 0.44 to 1: under a heavy load for its wheel the slip runs away sooner past the
    peak, so that the torque must follow sooner; and the noise of J omega' is less of N r, so that less of it need be
    filtered.
    N r^2 theta/J is the slip velocity it runs away by in a dead time without adhesion, of mu = 1: at the hand-over 4.2
    times the train's speed.

    Parameters
    ----------
    vehicle : Vehicle
        Its wheel, wheel load and actuator; its mass is not used.
    torque_high : float
        Largest torque of the brake, N*m.

    Raises
    ------
    InputError
        A brake without dead time, or a torque that is not positive.
    """
    dead_time = vehicle.actuator.dead_time
    if dead_time <= 0:
        raise InputError(f"seeking: dead_time {dead_time:g} s is not allowed; its gains go by it, give one > 0")
    run_away = vehicle.wheel_load * vehicle.wheel.radius**2 * dead_time / vehicle.effective_inertia
    quick = min(max(_RUN_AWAY / run_away, _QUICKEST), 1.0)
    hand_over_kmh = max(round(run_away / _HAND_OVER / KMH), _LEAST_HAND_OVER_KMH)
    return SeekingGains(
        inertia=vehicle.effective_inertia,
        viscous_friction=vehicle.inertia_scale * vehicle.wheel.viscous_friction,
        wheel_load=vehicle.wheel_load,
        dead_time=dead_time,
        lag=vehicle.actuator.lag,
        torque_high=torque_high,
        kappa=0.152 * quick / dead_time,
        torque_time=0.75 * quick * dead_time,
        observer_time=0.34 * quick * dead_time,
        deceleration_time=0.52 * dead_time,
        start_lead=0.9 * dead_time,
        hand_over_speed=hand_over_kmh * KMH,
        fade_speed=round(_FADE * hand_over_kmh) * KMH,
    )


@checked
def seeking_loop(point: OperatingPoint, gains: SeekingGains, actuator: Actuator | None = None) -> DelayedLoop:
    """The exact loop of the inner part at a point, broken at the acting torque; its reference is the point's slip.

    The speed is frozen. With E = exp(-theta s), Q = 1/(tau_o s + 1) of the observer, Qa of the
    deceleration, G and A from the acting torque to sigma and v', lambda the slip ratio: L = E J/r [(1 + kappa theta)
    (s Q G + ((1 - lambda) Qa - Q) A) + kappa (G - lambda theta Qa A)] / [tau_c s + 1 + kappa (1 - E)/s -
    (1 + kappa theta) Q E]. It runs sampled; this is the loop of a short period.

    Parameters
    ----------
    point : OperatingPoint
    gains : SeekingGains
        What the controller believes of wheel and brake, and its own numbers.
    actuator : Actuator, optional
        The brake, s; left out, as believed.

    Returns
    -------
    DelayedLoop
        Of the believed dead time and the brake's, dimensionless.
    """
    brake = Actuator(dead_time=gains.dead_time, lag=gains.lag) if actuator is None else actuator
    above, undelayed, delayed = _blocks(point, gains)
    lag = np.array([brake.lag, 1.0])
    numerator = QuasiPolynomial([[0.0], above], [0.0, brake.dead_time], removed=1)
    parts = [np.convolve(undelayed, lag), np.convolve(delayed, lag)]
    denominator = QuasiPolynomial(parts, [0.0, gains.dead_time], removed=1)
    return DelayedLoop(DelayedRatio(numerator, denominator))


def seeking_margins(
    points: Sequence[OperatingPoint], gains: SeekingGains, brakes: Sequence[Actuator], case: tuple[Rows, Rows]
) -> tuple[NDArray[np.bool_], Floats]:
    """Whether the loop of each `case`, (numbers of points, numbers of brakes), is stable, and its Ms, inf where not."""
    blocks = [_blocks(point, gains) for point in points]
    lag, dead_time = (np.array([getattr(one, name) for one in brakes])[case[1]] for name in ("lag", "dead_time"))
    stable, ms = np.zeros(lag.size, dtype=bool), np.full(lag.size, np.inf)
    kinds = np.array([tuple(part.size for part in parts) for parts in blocks])
    for kind in np.unique(kinds, axis=0):
        mine = np.flatnonzero((kinds == kind).all(axis=1)[case[0]])
        above, undelayed, delayed = (np.array([blocks[i][k] for i in case[0][mine].tolist()]) for k in range(3))
        none, believed = np.zeros(mine.size), np.full(mine.size, gains.dead_time)
        numerator = QuasiPolynomials((none[:, None], above), (none, dead_time[mine]), removed=1)
        parts = tuple(
            np.column_stack([lag[mine, None] * part, none]) + np.column_stack([none, part])
            for part in (undelayed, delayed)
        )
        denominator = QuasiPolynomials(parts, (none, believed), removed=1)
        stable[mine], ms[mine] = stable_and_peak(numerator, denominator)
    return stable, ms


@lru_cache(64)  # the actuators of an envelope follow each other at a point
def _blocks(point: OperatingPoint, gains: SeekingGains) -> tuple[Floats, Floats, Floats]:
    """Of the loop without the brake: numerator, and the parts of the denominator without and with the delay."""
    den, sigma, v_rate = _responses(point)
    more, slip, ratio = 1 + gains.kappa * gains.dead_time, point.slip, gains.inertia / point.vehicle.wheel.radius
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
