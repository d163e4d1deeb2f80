"""A sliding-mode design that accounts for the actuator: lead on the surface, a boundary layer of known margins, bounds.

    s = e + rho int e,    s_lead = (lead s + 1)/(lead_filter s + 1) s,    Tb = hold + K sat(s_lead/layer)

With lead = the actuator's lag, s_lead is a surface in which the actuator's state counts. Within the layer the law is
the linear controller C = (K/layer)(1 + rho/s)(lead s + 1)/(lead_filter s + 1), whose margins with the dead time are
exact.
A torque |d| <= d_max at the wheel, from rest at the operating point, then gives for all times

    |x| <= ||h_x||_1 d_max,    x = sigma error, s, Tb - hold,

h_x the impulse responses from d. The layer is not left, and so the bounds hold, if K >= ||h_Tb||_1 d_max. This
replaces [Park2008] (40): with the actuator K must exceed the disturbance by the factor ||T||_1, T = L/(1 + L). (L1 norm
as gain between bounded signals: [DahlehPearson1987].)

What the wheel's nonlinearity adds to the linearisation counts as a torque too; it depends on the size of the error,
so that the bound solves R = ||h||_1 (d_max + remainder(R)). The remainder is sampled over the box |sigma error| <= R.
Speed frozen throughout.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.errors import DomainError, InfeasibleDesignError, InputError
from railslip_ctrl.loop import DeadTimeLoop, Margins, Rational
from railslip_ctrl.loop.rational import realise
from railslip_ctrl.loop.responses import closed_loop_response
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Actuator

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_PER_DEAD_TIME = 60  # samples: trapezoids then miss below 1e-4 of the norm (checked against twice as many)
_FINE_DEAD_TIMES = 100  # for so long; later the response is slow and a tenth of the samples does
_COARSER = 10
_DECAYS = 14.0  # time constants of the slowest pole integrated over: exp(-14) = 1e-6 of the slow part is left
_BOX_POINTS = 61  # a side of the box over which the remainder is sampled
_ROUNDS = 200  # of the fixed-point iteration, which contracts where the bound exists
_SETTLED = 1e-9
_NEGLIGIBLE = 0.01  # of the offset: what is left of it when it counts as gone
_IDEAL_SCALE = 0.01  # s, of the samples with neither dead time nor lag

_OUTGROWN = (
    "disturbance: the wheel's nonlinearity outgrows the loop (no bound, or one outside the adhesion law's domain; the "
    "iteration stood at {:.4g}); give a smaller disturbance or offset, or more gain"
)


@dataclass(frozen=True)
class LayeredDesign:
    """Gains of the layered law, SI.

    Parameters
    ----------
    kp, ki : float
        K/layer, N*m/(m/s), and rho K/layer, N*m/m; kp > 0, ki >= 0.
    lead, lead_filter : float
        s; lead >= 0, lead_filter > 0.
    K : float
        Authority, N*m, > 0.

    Raises
    ------
    InputError
        A value outside these ranges.
    """

    kp: float
    ki: float
    lead: float
    lead_filter: float
    K: float

    def __post_init__(self) -> None:
        for name in ("kp", "ki", "lead", "lead_filter", "K"):
            value, positive = getattr(self, name), name in ("kp", "lead_filter", "K")
            if not (math.isfinite(value) and (value > 0 if positive else value >= 0)):
                raise InputError(f"{name}: {value} is not allowed; give a finite value {'> 0' if positive else '>= 0'}")

    @property
    def layer(self) -> float:
        """Boundary layer of s_lead, m/s."""
        return self.K / self.kp

    @property
    def rho(self) -> float:
        """1/s."""
        return self.ki / self.kp

    @property
    def controller(self) -> Rational:
        """C(s) within the layer."""
        integral = self.ki > 0
        pi = Rational(np.array([-self.rho] if integral else []), np.array([0.0] if integral else []), self.kp)
        zeros = np.array([-1 / self.lead]) if self.lead > 0 else np.array([])
        return pi * Rational(zeros, np.array([-1 / self.lead_filter]), (self.lead or 1.0) / self.lead_filter)


@dataclass(frozen=True)
class InducedGains:
    """L1 norms of the impulse responses from a torque at the wheel, by exact responses and quadrature to 1e-4.

    error and surface (s without lead) in (m/s)/(N*m), command in N*m/(N*m).
    """

    error: float
    surface: float
    command: float


def layer_loop(design: LayeredDesign, plant: LinearPlant, actuator: Actuator) -> DeadTimeLoop:
    """The loop of a `design` within the layer: `plant` (speed frozen) behind the `actuator`, dead time exact."""
    system = design.controller * _lag(actuator) * _wheel(plant)
    return DeadTimeLoop(system, actuator.dead_time)


def _wheel(plant: LinearPlant) -> Rational:
    if plant.speed_state:
        raise InputError("plant: the speed is a state; linearise with the speed frozen (speed_state=False)")
    return Rational(plant.zeros, plant.poles, plant.gain)


def _lag(actuator: Actuator) -> Rational:
    if actuator.lag == 0:
        return Rational(np.array([]), np.array([]), 1.0)
    return Rational(np.array([]), np.array([-1 / actuator.lag]), 1 / actuator.lag)


def induced_gains(design: LayeredDesign, plant: LinearPlant, actuator: Actuator) -> InducedGains:
    """L1 norms of the loop of a `design` within the layer: `plant` (speed frozen) behind the `actuator`.

    Raises
    ------
    InfeasibleDesignError
        That loop is unstable.
    """
    return _gains_of(torque_impulse(design, plant, actuator))


def _gains_of(impulse: Impulse) -> InducedGains:
    signals = (impulse.error, impulse.surface, impulse.command)
    return InducedGains(*(_norm(impulse.time, signal) for signal in signals))


@dataclass(frozen=True)
class Impulse:
    """Response within the layer to a torque impulse of 1 N*m*s at the wheel at t = 0, dead time exact.

    time in s; error (lambda_d v - sigma) and surface (s) in m/s, command (Tb - hold) in N*m. An offset x of sigma at
    t = 0 is an impulse of x J/r.
    """

    time: Floats
    error: Floats
    surface: Floats
    command: Floats


def torque_impulse(design: LayeredDesign, plant: LinearPlant, actuator: Actuator) -> Impulse:
    """The impulse response the bounds are made of, until its slowest part has decayed to 1e-6.

    Raises InfeasibleDesignError where the loop within the layer is unstable.
    """
    loop = layer_loop(design, plant, actuator)
    if not loop.is_stable():
        raise InfeasibleDesignError(
            f"layered design: kp = {design.kp:.4g}, ki = {design.ki:.4g} do not stabilise the loop within the layer; "
            "tune them for this plant and actuator"
        )
    slowest = -float(loop.closed_loop_poles(4)[0].real)
    time = _times(actuator.dead_time or actuator.lag or _IDEAL_SCALE, _DECAYS / slowest)
    wheel = _wheel(plant)
    response = closed_loop_response(
        design.controller,
        wheel,
        actuator.dead_time,
        time=time,
        actuator=_lag(actuator),
        initial_plant_state=realise(wheel).b,  # what an impulse of torque leaves
    )
    e = -response.output
    integral = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (e[1:] + e[:-1]))])
    return Impulse(time, e, e + design.rho * integral, response.control)


def _times(scale: float, end: float) -> Floats:
    fine = min(end, _FINE_DEAD_TIMES * scale)
    first = np.linspace(0.0, fine, math.ceil(fine / scale * _PER_DEAD_TIME) + 1)
    rest = np.linspace(fine, end, math.ceil((end - fine) / scale * _PER_DEAD_TIME / _COARSER) + 1)
    return np.concatenate([first, rest[1:]])


def _norm(time: Floats, signal: Floats) -> float:
    return float(np.sum(np.diff(time) * 0.5 * (np.abs(signal[1:]) + np.abs(signal[:-1]))))


# --- bounds ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LayerBound:
    """What the design guarantees at one operating point with the speed frozen.

    Attributes
    ----------
    margins : Margins
        Of the loop within the layer, exact.
    disturbance, offset : float
        |d| <= disturbance, N*m; |sigma error| at t = 0, m/s, everything else being at rest.
    remainder : float
        Torque that stands for the wheel's nonlinearity within the bound, N*m.
    error : float
        Ultimate bound on |sigma error|, m/s; at all times if the offset is 0.
    largest_error, surface, command : float
        Bounds at all times on |sigma error|, |s| and |Tb - hold|: m/s, m/s, N*m.
    reaching_time : float
        s from which on the offset adds less than a hundredth of itself to `error`; 0 without offset.
    K : float
        The design's authority, N*m.
    """

    margins: Margins
    disturbance: float
    offset: float
    remainder: float
    error: float
    largest_error: float
    surface: float
    command: float
    reaching_time: float
    K: float

    @property
    def layer_kept(self) -> bool:
        """The condition K >= |Tb - hold| under which the bounds hold."""
        return self.command <= self.K

    def slip_error(self, speed: float) -> float:
        """Ultimate bound on |lambda_d - lambda| at a speed, m/s."""
        return self.error / speed


def layer_bound(
    design: LayeredDesign,
    plant: LinearPlant,
    actuator: Actuator,
    disturbance: float,
    *,
    offset: float = 0.0,
    impulse: Impulse | None = None,
) -> LayerBound:
    """What a layered design guarantees at one operating point.

    Parameters
    ----------
    design : LayeredDesign
    plant : LinearPlant
        With the speed frozen.
    actuator : Actuator
    disturbance : float
        Bound on |torque at the wheel|, N*m, >= 0.
    offset : float
        Bound on |error of the slip velocity| at t = 0, m/s, >= 0.
    impulse : Impulse, optional
        `torque_impulse` of the three, where it is known already.

    Raises
    ------
    InputError
        A disturbance or offset that is negative or not finite.
    InfeasibleDesignError
        The loop within the layer is unstable, or the wheel's nonlinearity outgrows it: no bound follows.
    """
    for name, value in (("disturbance", disturbance), ("offset", offset)):
        if not (math.isfinite(value) and value >= 0):
            raise InputError(f"{name}: {value} is not allowed; give a finite value >= 0")
    impulse = impulse or torque_impulse(design, plant, actuator)
    gains = _gains_of(impulse)
    start = offset / plant.gain
    of_offset = start * float(np.abs(impulse.error).max())
    remainder = _fixed_remainder(plant, gains.error, disturbance, of_offset)
    total = disturbance + remainder
    late = np.flatnonzero(start * np.abs(impulse.error) > _NEGLIGIBLE * offset)
    return LayerBound(
        margins=layer_loop(design, plant, actuator).margins(),
        disturbance=disturbance,
        offset=offset,
        remainder=remainder,
        error=gains.error * total,
        largest_error=gains.error * total + of_offset,
        surface=gains.surface * total + start * float(np.abs(impulse.surface).max()),
        command=gains.command * total + start * float(np.abs(impulse.command).max()),
        reaching_time=float(impulse.time[late[-1]]) if offset > 0 else 0.0,
        K=design.K,
    )


def _fixed_remainder(plant: LinearPlant, gain: float, disturbance: float, of_offset: float) -> float:
    """The torque w, N*m, that solves w = remainder(gain (disturbance + w) + of_offset), from 0 upwards."""
    remainder = 0.0
    for _ in range(_ROUNDS):
        new = _remainder_torque(plant, gain * (disturbance + remainder) + of_offset)
        if new - remainder <= _SETTLED * (disturbance + new):
            return new
        remainder = new
    raise InfeasibleDesignError(_OUTGROWN.format(remainder))


def _remainder_torque(plant: LinearPlant, radius: float) -> float:
    """Largest torque, N*m, equivalent to what the linearisation leaves out for |sigma error| <= radius (m/s).

    In the adhesion state z it is filtered by z's own first-order decay, whose L1 norm is 1/|a_zz|.
    """
    point = plant.point
    try:
        point.law.check_domain(point.speed, np.array([point.sigma - radius, point.sigma + radius]))
    except DomainError:
        raise InfeasibleDesignError(_OUTGROWN.format(radius)) from None
    if not point.law.has_state:
        sigma = np.linspace(-radius, radius, _BOX_POINTS)
        return float(np.abs(_left_out(plant, sigma, np.zeros_like(sigma))[0]).max()) / plant.gain
    (_, a_z), (z_sigma, decay) = plant.A
    left_out, extent = 0.0, 0.0
    for _ in range(_ROUNDS):
        new = (abs(z_sigma) * radius + left_out) / abs(decay)
        sigma, z = np.meshgrid(np.linspace(-radius, radius, _BOX_POINTS), np.linspace(-new, new, _BOX_POINTS))
        of_sigma, of_z = _left_out(plant, sigma, z)
        left_out = float(np.abs(of_z).max())
        if abs(new - extent) <= _SETTLED * new or not math.isfinite(left_out):
            break
        extent = new
    return (float(np.abs(of_sigma).max()) + abs(float(a_z / decay)) * left_out) / plant.gain


def _left_out(plant: LinearPlant, sigma: Floats, z: Floats) -> tuple[Floats, Floats]:
    """sigma' and z' of the wheel less those at the point and less the linear ones; deviations in m/s and m."""
    point: OperatingPoint = plant.point
    functions, p = numeric_plant(type(point.law)).rates, plant_parameters(point.law, point.vehicle)
    rest = point.adhesion_state or 0.0
    here = functions(point.speed, point.sigma + sigma, rest + z, point.brake_torque, 0.0, 0.0, p)
    at = functions(point.speed, point.sigma, rest, point.brake_torque, 0.0, 0.0, p)
    a = plant.A
    of_sigma = here[1] - at[1] - a[0, 0] * sigma
    if not point.law.has_state:
        return np.asarray(of_sigma), np.zeros_like(sigma)
    return np.asarray(of_sigma - a[0, 1] * z), np.asarray(here[2] - at[2] - a[1, 0] * sigma - a[1, 1] * z)
