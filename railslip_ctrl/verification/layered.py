"""A sliding-mode design that accounts for the actuator: lead on the surface, a boundary layer of known margins, bounds.

    s = e + rho int e,    s_lead = (lead s + 1)/(lead_filter s + 1) s,    Tb = hold + K sat(s_lead/layer)

With lead = the actuator's lag, the actuator's state counts in s_lead. Within the layer the law is the linear controller
C = (K/layer)(1 + rho/s)(lead s + 1)/(lead_filter s + 1), whose margins with the dead time are exact. A torque
|d| <= d_max at the wheel, from rest at the operating point, then gives for all times

    |x| <= ||h_x||_1 d_max,    x = sigma error, s, Tb - hold,

h_x the impulse responses from d (L1 norm as gain between bounded signals: [DahlehPearson1987]). The layer is not left,
and so the bounds hold, if K >= ||h_Tb||_1 d_max. This replaces [Park2008] (40): with the actuator K must exceed the
disturbance by the factor ||T||_1, T = L/(1 + L).

What the wheel's nonlinearity adds to the linearisation counts as a torque too; it depends on the size of the error, so
that the bound solves R = ||h||_1 (d_max + remainder(R)), the remainder sampled over the box |sigma error| <= R. Speed
frozen throughout.

Gains: the PI of least worst Ms over the rails with the lead in the loop, as layer and rho. Integral gain and
disturbance grow with the inertia scale, which leaves the guaranteed error about as it is. K only widens the layer: it
is what the bound asks, and what a holding torque known to `HOLD_ERROR` asks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from railslip_ctrl.controllers.systems import PIController, actuated_plant
from railslip_ctrl.core.arguments import Floats, check_fields, number
from railslip_ctrl.core.errors import DomainError, InfeasibleDesignError, InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.tuning import tune_pi
from railslip_ctrl.loop import DeadTimeLoop, Margins, Rational
from railslip_ctrl.loop.rational import realise
from railslip_ctrl.loop.responses import closed_loop_response
from railslip_ctrl.model.adhesion import AdhesionLaw, law_class, published_law
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint, linearize, operating_point
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Actuator, PIGains, Rail, Vehicle

from .fixed_step import holding_torque, simulate_fine
from .reaching import ADHESION_NOISE, TORQUE_DECAY, TORQUE_FRACTION, TORQUE_FREQUENCY
from .relay_loop import actuator_lag


@dataclass(frozen=True)
class RailAdhesion:
    """An adhesion law, the rails it is taken on, and the reference slip.

    `law`: a published law by name, whose parameters follow rail, wheel load, initial speed (30 to 140 km/h) and, in the
    stiffness of a dynamic law, the inertia scale, as a change of units demands; or a law with parameters of its own,
    taken as they are, on wet rail by `AdhesionLaw.wet`. `slip`: reference slip ratio on every rail, 0 to 1; left out,
    the law's own. InputError for a value outside its range, no rail, or dry rail asked of parameters for wet rail.
    """

    law: AdhesionLaw | str = "bristle"
    rails: tuple[Rail, ...] = tuple(Rail)
    slip: float | None = None
    initial_speed_kmh: float = INITIAL_SPEED_KMH

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.rails:
            raise InputError("rail: none is given; give dry, wet or both")
        object.__setattr__(self, "rails", tuple(rail for rail in Rail if rail in self.rails))
        if self.slip is not None:
            number("slip", self.slip, gt=0, lt=1)
        if isinstance(self.law, str):
            object.__setattr__(self, "law", law_class(self.law).name)
        else:
            for rail in self.rails:
                self.law.on(rail)  # refuses dry rail for a wet rail's parameters

    def on(self, rail: Rail, vehicle: Vehicle) -> AdhesionLaw:
        """The law on a rail under a vehicle's wheel."""
        if isinstance(self.law, AdhesionLaw):
            return self.law.on(rail)
        law = published_law(self.law, rail, self.initial_speed_kmh, vehicle.wheel_load)
        stiffness = getattr(law, "alpha", None)
        if law.has_state and stiffness is not None:
            return law.model_copy(update={"alpha": vehicle.inertia_scale * stiffness})
        return law

    def reference(self, rail: Rail, vehicle: Vehicle) -> float:
        """Slip ratio held on a rail; InputError where there is none."""
        slip = self.slip if self.slip is not None else self.on(rail, vehicle).reference_slip(rail)
        if slip is None:
            remedy = "`slip` X" if isinstance(self.law, str) else "[reference_slip] in its file, or `slip` X"
            raise InputError(f"slip: adhesion {self.name!r} has no reference slip; give {remedy}")
        return slip

    def point(self, rail: Rail, vehicle: Vehicle, *, speed_kmh: float = INITIAL_SPEED_KMH) -> OperatingPoint:
        """The reference slip on a rail."""
        slip = self.reference(rail, vehicle)
        return operating_point(self.on(rail, vehicle), vehicle, speed_kmh * KMH, slip, rail=rail)

    def plants(self, vehicle: Vehicle, *, speed_kmh: float = INITIAL_SPEED_KMH) -> dict[Rail, LinearPlant]:
        """The linear plants at the reference slip on each rail, speed frozen."""
        return {rail: linearize(self.point(rail, vehicle, speed_kmh=speed_kmh)) for rail in self.rails}

    @property
    def name(self) -> str:
        """The law's name."""
        return self.law if isinstance(self.law, str) else self.law.name

    @property
    def text(self) -> str:
        """The law in words."""
        if isinstance(self.law, AdhesionLaw):
            return f"{self.name} law as given"
        return f"{self.name} model" if self.name == "bristle" else f"published {self.name} law"

    @property
    def rails_text(self) -> str:
        """The rails in words: "dry and wet"."""
        return " and ".join(self.rails)

    def tells_rails_apart(self, vehicle: Vehicle) -> bool:
        """Whether there are two rails, and the law or its reference slip differs between them."""
        kinds = {(self.on(rail, vehicle).parameters(), self.reference(rail, vehicle)) for rail in self.rails}
        return len(kinds) > 1


PUBLISHED_ADHESION = RailAdhesion()  #: the published bristle model at its reference slips, on both rails


def load_cases(vehicle: Vehicle) -> dict[str, Vehicle]:
    """The vehicle empty and loaded, by these words; where both are one, that one by its mass."""
    loaded = vehicle.loaded()
    if (loaded.mass, loaded.wheel_load) == (vehicle.mass, vehicle.wheel_load):
        return {f"{vehicle.mass:g} kg": vehicle}
    return {"empty": vehicle, "loaded": loaded}


# --- the design -------------------------------------------------------------------------------------------------------


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
    """Gains of the layered law, SI; InputError for a value outside these ranges.

    kp = K/layer, N*m/(m/s), > 0; ki = rho K/layer, N*m/m, >= 0; lead, lead_filter, s, >= 0 and > 0; K, authority, N*m,
    > 0.
    """

    kp: float
    ki: float
    lead: float
    lead_filter: float
    K: float

    def __post_init__(self) -> None:
        for name in ("kp", "lead_filter", "K"):
            number(name, getattr(self, name), gt=0)
        for name in ("ki", "lead"):
            number(name, getattr(self, name), ge=0)

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
        return PIController(PIGains(kp=self.kp, ki=self.ki), self.lead, self.lead_filter).transfer_function


def layer_loop(design: LayeredDesign, plant: LinearPlant, actuator: Actuator) -> DeadTimeLoop:
    """The loop of a `design` within the layer: `plant` (speed frozen) behind the `actuator`, dead time exact."""
    return DeadTimeLoop(design.controller * actuator_lag(actuator) * _wheel(plant), actuator.dead_time)


def _wheel(plant: LinearPlant) -> Rational:
    if plant.speed_state:
        raise InputError("plant: the speed is a state; linearise with the speed frozen (speed_state=False)")
    return Rational(plant.zeros, plant.poles, plant.gain)


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

    @property
    def norms(self) -> tuple[float, float, float]:
        """L1 norms of error, surface, (m/s)/(N*m), and command: gains from a torque at the wheel, to 1e-4."""
        sizes = np.abs([self.error, self.surface, self.command])
        error, surface, command = np.sum(np.diff(self.time) * 0.5 * (sizes[:, 1:] + sizes[:, :-1]), axis=1).tolist()
        return error, surface, command


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
    time, wheel = _times(actuator.dead_time or actuator.lag or _IDEAL_SCALE, _DECAYS / slowest), _wheel(plant)
    lag, start = actuator_lag(actuator), realise(wheel).b  # what an impulse of torque leaves
    response = closed_loop_response(
        design.controller, wheel, actuator.dead_time, time=time, actuator=lag, initial_plant_state=start
    )
    e = -response.output
    integral = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (e[1:] + e[:-1]))])
    return Impulse(time, e, e + design.rho * integral, response.control)


def _times(scale: float, end: float) -> Floats:
    fine = min(end, _FINE_DEAD_TIMES * scale)
    first = np.linspace(0.0, fine, math.ceil(fine / scale * _PER_DEAD_TIME) + 1)
    rest = np.linspace(fine, end, math.ceil((end - fine) / scale * _PER_DEAD_TIME / _COARSER) + 1)
    return np.concatenate([first, rest[1:]])


# --- bounds ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LayerBound:
    """What the design guarantees at one operating point with the speed frozen.

    margins: of the loop within the layer, exact; |torque at the wheel| <= disturbance, N*m; |sigma error| <= offset,
    m/s, at t = 0, everything else being at rest; remainder: torque that stands for the wheel's nonlinearity within the
    bound, N*m; error: ultimate bound on |sigma error|, m/s, at all times if the offset is 0; largest_error, surface,
    command: bounds at all times on |sigma error|, |s| and |Tb - hold|, m/s, m/s, N*m; reaching_time: s from which on
    the offset adds less than a hundredth of itself to `error`, 0 without offset; K: the design's authority, N*m.
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
    """What a layered design guarantees at one operating point, speed frozen; arguments as of `LayerBound`.

    `impulse`: `torque_impulse` of the three, where it is known already. InputError for a disturbance or offset that is
    negative or not finite; InfeasibleDesignError where the loop within the layer is unstable, or the wheel's
    nonlinearity outgrows it.
    """
    number("disturbance", disturbance, ge=0)
    number("offset", offset, ge=0)
    impulse = impulse or torque_impulse(design, plant, actuator)
    gains, start = np.array(impulse.norms), offset / plant.gain
    peaks = start * np.array([np.abs(one).max() for one in (impulse.error, impulse.surface, impulse.command)])
    remainder = _fixed_remainder(plant, gains[0], disturbance, peaks[0])
    at_rest = gains * (disturbance + remainder)
    largest, surface, command = (at_rest + peaks).tolist()
    late = np.flatnonzero(start * np.abs(impulse.error) > _NEGLIGIBLE * offset)
    reaching_time = float(impulse.time[late[-1]]) if offset > 0 else 0.0
    margins, error = layer_loop(design, plant, actuator).margins(), float(at_rest[0])
    known = (margins, disturbance, offset, remainder, error, largest, surface, command, reaching_time)
    return LayerBound(*known, design.K)


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
    side = np.linspace(-1.0, 1.0, _BOX_POINTS)
    if not point.law.has_state:
        return float(np.abs(_left_out(plant, radius * side, 0.0 * side)[0]).max()) / plant.gain
    (_, a_z), (z_sigma, decay) = plant.A
    left_out, extent = 0.0, 0.0
    for _ in range(_ROUNDS):
        new = (abs(z_sigma) * radius + left_out) / abs(decay)
        of_sigma, of_z = _left_out(plant, *np.meshgrid(radius * side, new * side))
        left_out = float(np.abs(of_z).max())
        if abs(new - extent) <= _SETTLED * new or not math.isfinite(left_out):
            break
        extent = new
    return (float(np.abs(of_sigma).max()) + abs(float(a_z / decay)) * left_out) / plant.gain


def _left_out(plant: LinearPlant, sigma: Floats, z: Floats) -> Floats:
    """sigma' and z' of the wheel less those at the point and less the linear ones; deviations in m/s and m."""
    point: OperatingPoint = plant.point
    functions, p = numeric_plant(type(point.law)).rates, plant_parameters(point.law, point.vehicle)
    rest = point.adhesion_state or 0.0
    here = functions(point.speed, point.sigma + sigma, rest + z, point.brake_torque, 0.0, 0.0, p)
    at = functions(point.speed, point.sigma, rest, point.brake_torque, 0.0, 0.0, p)
    a = plant.A if point.law.has_state else np.diag([plant.A[0, 0], 0.0])
    return np.array([here[i] - at[i] - a[i - 1, 0] * sigma - a[i - 1, 1] * z for i in (1, 2)])


# --- tuned for a vehicle and its adhesion -----------------------------------------------------------------------------


Torque = Callable[[float], float]


def bounded_disturbance(vehicle: Vehicle) -> float:
    """Torque at the wheel the bound is asked for, N*m."""
    return DISTURBANCE * vehicle.wheel_load * vehicle.wheel.radius * vehicle.inertia_scale


SPEEDS_KMH = (5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0)  #: where the stability of a stop is decided, of any law
LEAD_FILTER_SHARE = 0.1  #: time constant of the lead's filter over that of the lag, as in designs/pi_lead.py
LEAST_INTEGRAL_GAIN = 100.0  #: N*m/m, times the inertia scale
DISTURBANCE = 20.0 / (PARK2008.wheel_load * PARK2008.wheel.radius)  # the published vehicle's is 20 N*m
"""Torque at the wheel the bound is asked for, over wheel load and radius, times the inertia scale."""

OFFSET = 0.1  #: error at t = 0 that must be taken in, m/s
HOLD_ERROR = 0.1  #: share of the holding torque by which it may be known wrongly
AUTHORITY_MARGIN = 1.05  #: K over what is asked of it

DURATION, STEP = 15.0, 5e-3  # s; the step is a twelfth of the lead's filter
_NOISE_HELD = 0.02  # s
_NO_LAG_FILTER = 0.01  # s, of the lead filter where the actuator has no lag


@dataclass(frozen=True)
class RailBounds:
    """One rail: the linear plant, and the bounds from rest and from `OFFSET`."""

    plant: LinearPlant
    at_rest: LayerBound
    from_offset: LayerBound


def layered_design(
    vehicle: Vehicle,
    adhesion: RailAdhesion = PUBLISHED_ADHESION,
    *,
    K: float | None = None,
    ki_min: float | None = None,
) -> LayeredDesign:
    """Tuned gains; K, N*m, is `AUTHORITY_MARGIN` times `least_authority` if left out.

    The integral gain is at least `ki_min`, N*m/m, > 0; left out, `LEAST_INTEGRAL_GAIN` times the inertia scale.
    InfeasibleDesignError where nothing stabilises every rail.
    """
    actuator, plants = vehicle.actuator, adhesion.plants(vehicle)
    lead_filter = LEAD_FILTER_SHARE * actuator.lag or _NO_LAG_FILTER
    lead = PIController(PIGains(kp=1.0, ki=0.0), actuator.lag, lead_filter).transfer_function
    least = LEAST_INTEGRAL_GAIN * vehicle.inertia_scale if ki_min is None else ki_min
    loops = [actuated_plant(plant, actuator) for plant in plants.values()]
    names = [plant.point.words for plant in plants.values()]
    tuned = tune_pi(loops, actuator.dead_time, minimise_ms=True, ki_min=least, compensator=lead, names=names)
    design = LayeredDesign(tuned.kp, tuned.ki, actuator.lag, lead_filter, 1.0 if K is None else K)
    return design if K is not None else replace(design, K=AUTHORITY_MARGIN * least_authority(design, vehicle, adhesion))


def least_authority(design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION) -> float:
    """Largest |Tb - hold|, N*m, on any rail, empty and loaded: of the bound from `OFFSET`, and for a hold wrong by
    `HOLD_ERROR`.

    Where the wheel's nonlinearity leaves no bound, that of the linear loop takes its place.
    """
    asked = []
    for laden in load_cases(vehicle).values():
        plants = adhesion.plants(laden).values()
        impulses = [(plant, torque_impulse(design, plant, laden.actuator)) for plant in plants]
        try:
            asked += [bounds.from_offset.command for bounds in rail_bounds(design, laden, adhesion).values()]
        except InfeasibleDesignError:
            height = bounded_disturbance(laden)
            asked += [
                impulse.norms[2] * height + OFFSET / plant.gain * float(np.abs(impulse.command).max())
                for plant, impulse in impulses
            ]
        for plant, impulse in impulses:  # the linear loop's answer to a hold that is wrong from t = 0 on
            means = 0.5 * (impulse.command[1:] + impulse.command[:-1])
            peak = float(np.abs(np.cumsum(np.diff(impulse.time) * means)).max())
            asked.append(HOLD_ERROR * holding_torque(plant.point) * peak)
    return max(asked)


def rail_bounds(
    design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> dict[Rail, RailBounds]:
    """Bounds at 100 km/h for |d| <= `bounded_disturbance`; InfeasibleDesignError where none exists."""
    found = {}
    for rail, plant in adhesion.plants(vehicle).items():
        rest, away = (_bound(design, plant.point, offset) for offset in (0.0, OFFSET))
        for one in (rest, away):
            if isinstance(one, InfeasibleDesignError):
                raise one
        found[rail] = RailBounds(plant, rest, away)
    return found


def _bound(design: LayeredDesign, point: OperatingPoint, offset: float) -> Any:
    """The bound, or why there is none. K only enters what it is compared with, and a stop's points come up again."""
    found = _bound_of(replace(design, K=1.0), point, offset)
    return found if isinstance(found, InfeasibleDesignError) else replace(found, K=design.K)


@lru_cache(maxsize=128)
def _bound_of(design: LayeredDesign, point: OperatingPoint, offset: float) -> LayerBound | InfeasibleDesignError:
    try:
        plant, impulse = _impulse_of(design, point)
        height = bounded_disturbance(point.vehicle)
        return layer_bound(design, plant, point.vehicle.actuator, height, offset=offset, impulse=impulse)
    except InfeasibleDesignError as error:
        return error


@lru_cache(maxsize=4)
def _impulse_of(design: LayeredDesign, point: OperatingPoint) -> tuple[LinearPlant, Impulse]:
    plant = linearize(point)
    return plant, torque_impulse(design, plant, point.vehicle.actuator)


def lowest_speeds(
    design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> tuple[float | None, float | None]:
    """Speeds, km/h, from 100 on down to which every rail and load has a property; None: not even there.

    That from rest the bound on the slip is within 0 and twice the reference; and that besides K is enough, from rest
    and from `OFFSET`.
    """
    held: float | None = None
    kept: float | None = None
    keeps = True
    for speed_kmh in reversed(SPEEDS_KMH):
        for rail, laden in product(adhesion.rails, load_cases(vehicle).values()):
            point = adhesion.point(rail, laden, speed_kmh=speed_kmh)
            rest, away = (_bound(design, point, offset) for offset in (0.0, OFFSET))
            if isinstance(rest, InfeasibleDesignError) or rest.error >= point.sigma:
                return held, kept
            keeps &= rest.layer_kept and isinstance(away, LayerBound) and away.layer_kept
        held, kept = speed_kmh, speed_kmh if keeps else kept
    return held, kept


# --- simulations ----------------------------------------------------------------------------------------------------


class LayeredLaw:
    """Tb = hold + K sat(s_lead/layer), s_lead = (lead s + 1)/(lead_filter s + 1) applied to e + rho int e.

    `slip`: reference slip ratio; `hold`: torque around which the layer works, N*m, or a function of the speed, m/s. The
    integral rests where the layer is left and e drives farther out of it; the torque is not below 0.
    """

    def __init__(self, slip: float, hold: float | Callable[[float], float], *, design: LayeredDesign) -> None:
        self.slip, self.hold, self.design = slip, hold, design
        self.integral, self.filtered = 0.0, 0.0  # at rest before t = 0

    def __call__(self, v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        """See `fixed_step.SteppedLaw`; the surface returned is s_lead."""
        d = self.design
        e = self.slip * v - sigma
        s = e + d.rho * self.integral
        led = self.filtered + d.lead / d.lead_filter * (s - self.filtered)
        self.filtered += (1 - math.exp(-step / d.lead_filter)) * (s - self.filtered)
        if abs(led) < d.layer or led * e < 0.0:
            self.integral += step * e
        hold = self.hold(v) if callable(self.hold) else self.hold
        return max(0.0, hold + d.K * max(-1.0, min(1.0, led / d.layer))), led


def bounded_torques(height: float, impulse: Impulse) -> dict[str, Torque]:
    """Torques within +-height, N*m, over time, s: a step, sines, held noise, and the worst for the linear loop."""
    noise = np.random.default_rng(1).uniform(-height, height, 1000)
    worst = np.sign(np.interp(DURATION - np.arange(0.0, DURATION, STEP), impulse.time, impulse.error, right=0.0))
    return {
        "step": lambda t: height,
        "sine 0.5 rad/s": lambda t: height * math.sin(0.5 * t),
        "sine 2 rad/s": lambda t: height * math.sin(2.0 * t),
        "noise held 0.02 s": lambda t: float(noise[int(t / _NOISE_HELD) % noise.size]),
        # the impulse response backwards in time: every push adds up at the end
        "worst case": lambda t: height * float(worst[min(int(t / STEP), worst.size - 1)]),
    }


def random_torque(point: OperatingPoint, seed: int, duration: float) -> Torque:
    """The published random force, cut at 3 sigma, as a torque at the wheel, N*m, over time, s."""
    vehicle = point.vehicle
    count = math.ceil(duration / _NOISE_HELD) + 2
    force = ADHESION_NOISE * vehicle.wheel_load * np.clip(np.random.default_rng(seed).standard_normal(count), -3.0, 3.0)
    # what sigma' gets from 1 N*m of Tr, and that over the (r/J) it gets from a torque at the wheel
    rates, p = numeric_plant(type(point.law)).rates, plant_parameters(point.law, vehicle)
    state = (point.speed, point.sigma, point.adhesion_state or 0.0, point.brake_torque, 0.0)
    of_random = float(rates(*state, 1.0, p)[1] - rates(*state, 0.0, p)[1])
    torque = of_random * vehicle.effective_inertia * force  # (J/r) r force
    return lambda t: float(torque[int(t / _NOISE_HELD)])


def published_torque(design: LayeredDesign, point: OperatingPoint, seed: int, duration: float) -> Torque:
    """`random_torque`, and the published Td: 0.05 of the largest torque the law can ask for, hold + K."""
    random, largest = random_torque(point, seed, duration), TORQUE_FRACTION * (holding_torque(point) + design.K)
    return lambda t: random(t) + largest * math.exp(-TORQUE_DECAY * t) * math.sin(TORQUE_FREQUENCY * t)


def run_errors(
    design: LayeredDesign, plant: LinearPlant, torque: Torque, *, offset: float = 0.0
) -> tuple[float, float]:
    """Largest |sigma error| (m/s) and |Tb - hold| (N*m) of the nonlinear wheel with the actuator, speed frozen.

    DomainError where the wheel leaves the adhesion law's domain.
    """
    point, hold = plant.point, holding_torque(plant.point)
    law = LayeredLaw(point.slip, hold, design=design)
    actuator = point.vehicle.actuator
    run = simulate_fine(point, law, actuator, duration=DURATION, step=STEP, disturbance=torque, offset=offset)
    return float(np.abs(run.sigma - point.sigma).max()), float(np.abs(run.command - hold).max())


def bounded_errors(design: LayeredDesign, bounds: RailBounds) -> dict[str, tuple[float, float]]:
    """`run_errors` from rest under each of `bounded_torques`."""
    impulse = torque_impulse(design, bounds.plant, bounds.plant.point.vehicle.actuator)
    torques = bounded_torques(bounds.at_rest.disturbance, impulse)
    return {name: run_errors(design, bounds.plant, torque) for name, torque in torques.items()}
