"""Conditions of the predictive sliding-mode law with its actuator, proved over boxes, and the largest tolerances.

T+ is the torque that acts one dead time later, H the torque that holds the reference slip, H_hat the estimate of H.
`sliding.predictive` derives the rate of the sliding variable S:

    S' = kappa (H - H_hat) + (1 + kappa theta) H_hat' - k S - K sat(S/phi).

H is the sum of two parts: one whose rate is bounded by R, and one that may jump but is bounded by n (random force, and
errors of the modelled dead time, lag and inertia). The observer consists of filters with gain 1; tau is their larger
time constant. Therefore

    |H - H_hat| <= tau R + 2 n,    |H_hat'| <= R.

These bounds hold once the observer has settled. If K > d = kappa (tau R + 2 n) + (1 + kappa theta) R, then |S| falls
to phi + 2 (1 + kappa theta) n, the half width of the tube; for n = 0 the tube is the boundary layer. The claim is empty
if the tube is wider than the box. The torque differs from H by at most

    dT = |S| + (J/r) kappa |e_hat| + (theta + tau) R + 2 n,    R = R0 + P dT,

with P the largest magnitude of the slip pole and R0 the largest |H'| for dT = 0. dT and R are finite if
P (theta + tau) < 1. The small gain of `sliding.predictive` is evaluated with P and the slower time constant tau.
`boxes.largest` encloses P, R0 and the range of H over the box of speed, slip, load and rail. The rest is arithmetic on
balls. The law is in continuous time, with a constant reference slip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import cache, lru_cache
from typing import Any, NamedTuple, Self

import numpy as np
import sympy as sp
from flint import arb

from railslip_ctrl.controllers.predictive import Predictive
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.linearization import operating_point
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Rail, Vehicle

from .boxes import Box, Largest, adhesion_on_balls, largest, on_balls, upper
from .no_lock import no_lock
from .rails import RailAdhesion
from .reaching import ADHESION_NOISE, Range, load_ratio
from .verdict import Condition, Tolerance, Verification

PROVED, COUNTEREXAMPLE = "proved over the box", "counterexample"
REACHING_AT_ONCE = "reaching at once"

_INFINITE = arb.pos_inf()
_LEAST_SLIP = 1e-4  # lower limit of the box's slip, because the laws are enclosed for slip > 0 only
_LEAST_LAG = 1e-3  # s; replaces a lag of 0, by which the bounds would divide
_LOWEST_KMH = 10.0  #: lowest speed of the search for the lowest speed, km/h


@dataclass(frozen=True)
class PredictiveBox:
    """Ranges of the quantities over which the conditions are decided; mass and wheel load range from empty to loaded.

    - speed_kmh: range of train speeds, km/h.
    - slip: half width of the range of slip ratios, relative to the reference slip.
    - surface, error: largest |S|, N*m, and largest |e_hat|, m/s.
    - brake_gain, dead_time, lag, radius, train_speed, inertia: largest relative errors of the law's model.
    - random_force: bound of the random force as a multiple of its standard deviation, which is proportional to the
      wheel load.
    """

    speed_kmh: tuple[float, float] = (60.0, INITIAL_SPEED_KMH)
    slip: float = 0.05
    surface: float = 600.0
    error: float = 0.5
    brake_gain: float = 0.0
    dead_time: float = 0.0
    lag: float = 0.0
    radius: float = 0.0
    train_speed: float = 0.0
    inertia: float = 0.0
    random_force: float = 0.0


#: relative errors that the law must tolerate together; separate conditions include the random force
ASKED = {"brake_gain": 0.15, "dead_time": 0.1, "lag": 0.1, "radius": 0.01, "train_speed": 0.01, "inertia": 0.05}
RANDOM_FORCE = 3.0  #: bound of the random force, standard deviations


_F, _F_slip, _F_v = sp.symbols("F F_slip F_v", real=True)
_reference = sp.Symbol("lambda_d", positive=True)
_off = sp.Symbol("off", real=True)  # torque minus the holding torque, N*m
_KNOWN = (plant.v, plant.slip, plant.M, plant.J, plant.B, plant.r, plant.Fr0, plant.Fr1, plant.Fr2, _reference)


@cache
def holding_torque() -> tuple[sp.Expr, ...]:
    """Derive (H, P, R0, -v'): holding torque (N*m), bounds P (1/s) and R0 (N*m/s) of its rate, and deceleration.

    H is the torque for which e' = 0, e = lambda_d v - sigma. If the torque is H + off, |H'| <= R0 + P |off|.
    """
    motion = plant.motion()
    known = {plant.Td: 0, plant.Tr: 0, plant.sigma: plant.slip * plant.v, plant.Fa: _F}
    v_rate, sigma_rate = motion.v_rate.subs(known), motion.sigma_rate.subs(known)
    hold = sp.expand(sp.solve(_reference * v_rate - sigma_rate, plant.Tb)[0])
    decelerating = -plant.J / plant.r * (1 - _reference) * v_rate
    slip_rate = (sigma_rate.subs(plant.Tb, hold + _off) - plant.slip * v_rate) / plant.v

    def rate(part: sp.Expr) -> sp.Expr:
        along = sp.diff(part, _F) * (_F_slip * slip_rate + _F_v * v_rate)
        return sp.expand(along + sp.diff(part, plant.v) * v_rate + sp.diff(part, plant.slip) * slip_rate)

    # the observer filters the parts of H that come from wheel and train separately: their magnitudes are added
    # each part is a factor times a shorter expression, because SymPy may not finish the factorization of the product
    parts = ((1, rate(hold - decelerating)), (decelerating / v_rate, rate(v_rate)))
    pole = sum(sp.Abs(factor) * sp.Abs(sp.cancel(sp.diff(one, _off))) for factor, one in parts)
    drift = sum(sp.Abs(factor * v_rate) * sp.Abs(sp.cancel(one.subs(_off, 0) / v_rate)) for factor, one in parts)
    return hold, pole, drift, -v_rate


_POLE_WIDTH = 0.02  # relative width of the enclosure of P, which is part of d
_DRIFT_WIDTH = 1e-3  # width of the enclosure of R0 over the wheel load, 1/s; 1 % of K


class Extremes(NamedTuple):
    """Enclosures of the largest -H, H, P, R0 and -v' (`holding_torque`) over speed, slip and load."""

    lowest: Largest
    highest: Largest
    pole: Largest
    drift: Largest
    deceleration: Largest


@dataclass(frozen=True)
class RailCase:
    """Rail with its adhesion law at the empty wheel load; with `scaled` the force is proportional to the wheel load."""

    rail: Rail
    law: AdhesionLaw
    scaled: bool
    reference: float

    @classmethod
    def of(cls, adhesion: RailAdhesion, rail: Rail, vehicle: Vehicle) -> Self:
        heavy = vehicle.model_copy(update={"wheel_load": load_ratio(vehicle) * vehicle.wheel_load})
        laws = [adhesion.on(rail, one) for one in (vehicle, heavy)]
        return cls(rail, laws[0], laws[0].parameters() != laws[1].parameters(), adhesion.reference(rail, vehicle))


@cache
def _expressions() -> Callable[..., Any]:
    return on_balls([*_KNOWN, _F, _F_slip, _F_v], holding_torque())


def evaluated(case: RailCase, vehicle: Vehicle, point: Mapping[str, arb]) -> list[arb]:
    """Return H, P, R0 and -v' (`holding_torque`) at a point of `speed` (m/s), `slip` and `load` (0 empty, 1 loaded)."""
    v, slip, load = point["speed"], point["slip"], point["load"]
    M = arb(vehicle.effective_mass) * (1 + load * (arb(vehicle.mass_loaded) / vehicle.mass - 1))
    share = 1 + load * (arb(load_ratio(vehicle)) - 1)
    N = arb(vehicle.wheel_load)
    forces = adhesion_on_balls(case.law)(v, slip, N if case.scaled else N * share)
    if case.scaled:
        forces = [one * share for one in forces]
    resistance = (vehicle.resistance.constant, vehicle.resistance.linear, vehicle.resistance.quadratic)
    wheel = (vehicle.effective_inertia, vehicle.effective_viscous_friction, vehicle.wheel.radius)
    known = [arb(one) for one in (*wheel, *resistance, case.reference)]
    found: list[arb] = _expressions()(v, slip, M, *known, *forces)
    return found


@cache
def extremes(case: RailCase, vehicle: Vehicle, speed_kmh: tuple[float, float], slip: tuple[float, float]) -> Extremes:
    """Enclose the largest values (`Extremes`) over a range of speeds and a range of slips, from empty to loaded."""
    box: Box = {"speed": (speed_kmh[0] * KMH, speed_kmh[1] * KMH), "slip": slip, "load": (0.0, 1.0)}

    def enclosed(index: int, sign: float = 1.0, *, relative: float = 0.01, absolute: float = 0.0) -> Largest:
        def value(point: Mapping[str, arb]) -> arb:
            return sign * evaluated(case, vehicle, point)[index]

        return largest(value, box, relative=relative, absolute=absolute)

    pole, drift = enclosed(1, relative=_POLE_WIDTH), enclosed(2, absolute=_DRIFT_WIDTH * vehicle.wheel_load)
    return Extremes(enclosed(0, -1.0), enclosed(0), pole, drift, enclosed(3))


@dataclass(frozen=True)
class Demand:
    """Bounds on a rail for all values in a box, rounded to the safe side; equations are in the module docstring.

    - loop: loop gain P (theta + tau) plus the effect of the inertia's error; it must be below 1.
    - small_gain: bound of the small gain with P in place of the slip pole.
    - surface: largest |S| in the box, N*m.
    - kick: change of S' by a jump of the random force from one bound to the other, N*m/s, without other changes of H.
    - d: bound of the disturbance of S', N*m/s, which K must exceed.
    - at_once: bound of the disturbance of S', N*m/s, that includes the rate of H_hat after a jump of H.
    - tube: half width of the tube about S = 0, N*m.
    - hold: least and largest holding torque H, N*m.
    - carried: largest K, N*m/s, for which the command on S = 0 stays within the torque limits, while the torque falls
      and while it rises.
    - left: rate of S towards 0, N*m/s, with the command at the lower and at the upper torque limit.
    - off: largest deviation dT of the torque from H, N*m.
    - rate: largest rate R of H, N*m/s.
    - jump: bound n of the part of H that may jump, N*m.
    - found: enclosures of H, P, R0 and the deceleration over speed, slip and load.

    If `loop` can be >= 1, the bounds from `left` on are infinite.
    """

    loop: float
    small_gain: float
    surface: float
    kick: float
    hold: Range
    carried: Range
    found: Extremes
    left: Range = (-math.inf, -math.inf)
    d: float = math.inf
    at_once: float = math.inf
    tube: float = math.inf
    off: float = math.inf
    rate: float = math.inf
    jump: float = math.inf


@lru_cache(512)  # several conditions use the same result
def demand(
    gains: Predictive, vehicle: Vehicle, case: RailCase, box: PredictiveBox, *, attained: bool = False
) -> Demand:
    """Compute the bounds over a box; if `attained`, from values of H, P, R0 and -v' that occur in the box."""
    assert gains.lag is not None, "`believing` sets it"
    kappa, theta, lag = arb(gains.kappa), arb(gains.dead_time), arb(max(gains.lag, _LEAST_LAG))
    ratio = arb(gains.wheel_inertia) / gains.radius
    tau, seen = arb(max(gains.observer_time, gains.deceleration_time)), arb(box.radius) + box.train_speed
    # errors of radius and train speed change the measured slip by at most their sum
    shift, half = upper(seen / (1 - seen)), box.slip * case.reference
    slip = max(case.reference - half - shift, _LEAST_SLIP), case.reference + half + shift
    found = extremes(case, vehicle, box.speed_kmh, slip)
    low, high, pole, drift, fall = (arb(one.attained if attained else one.bound) for one in found)

    def most(value: arb) -> float:
        return -upper(-value) if attained else upper(value)

    def least(value: arb) -> float:
        return -most(-value)

    heavy = arb(vehicle.wheel_load) * load_ratio(vehicle)
    lever = arb(vehicle.wheel.radius) + ratio * (1 - arb(case.reference)) / vehicle.effective_mass
    force = arb(box.random_force) * ADHESION_NOISE * heavy * lever
    gain, late = arb(box.brake_gain), arb(box.dead_time) * theta + arb(box.lag) * lag
    ahead = arb(box.surface) + ratio * kappa * box.error  # largest T+ minus H_hat
    steepest = kappa * ahead + arb(gains.reaching_rate) * box.surface + gains.switching_gain  # largest rate of T+
    fixed, steady = force + late * (1 + gain) * steepest, drift + gain * steepest
    lowest, highest = -low / (1 + gain), high / (1 - gain)
    hold, carried = (lowest, highest), (lowest / lag, (gains.torque_max - highest) / lag)
    loop, more = pole * (theta + tau) + 2 * arb(box.inertia), 1 + kappa * theta
    layer_gain = arb(gains.reaching_rate) + arb(gains.switching_gain) / gains.layer
    small_gain = 2 * pole * (theta + tau + (1 + kappa * (theta + tau)) / layer_gain)
    quickest = min(gains.observer_time, gains.deceleration_time)
    kick = -upper(-(more / gains.observer_time - kappa) * 2 * arb(box.random_force) * ADHESION_NOISE * heavy * lever)
    known = Demand(
        *(most(loop), most(small_gain), box.surface, kick),
        *((least(lowest), most(highest)), (least(carried[0]), least(carried[1])), found),
    )
    if not loop < 1:
        return known
    off = (ahead + (theta + tau) * steady + 2 * fixed) / (1 - loop)
    rate, jump = steady + pole * off, fixed + box.inertia * off
    # effect of errors of radius, train speed and inertia on the deceleration in H and e_hat', and on the prediction
    wrong = 2 * seen * ratio * fall + (arb(box.radius) + box.inertia) * off
    d = kappa * (tau * rate + 2 * jump + wrong) + more * rate

    def left(level: arb) -> float:
        # least rate of S towards 0 with the command at a torque limit, whose distance to H_hat is `level`
        ends = (gains.layer - ratio * kappa * box.error, ahead)
        return least(arb.min(*((level + one) / lag - kappa * one for one in ends)))

    return replace(
        known,
        left=(left(hold[0] - jump), left(gains.torque_max - hold[1] - jump)),
        d=most(d),
        at_once=most(d + more * 2 * jump / quickest),
        tube=most(gains.layer + 2 * more * jump),
        off=most(off),
        rate=most(rate),
        jump=most(jump),
    )


@dataclass(frozen=True)
class Kept:
    """Invariant set |S| <= `surface` (N*m), |e_hat| <= `error` (m/s), in which |e| <= `slip_error` (m/s).

    The bounds are infinite if no invariant set was found. `inside` is true if the slip stays in the box at every speed.
    """

    surface: float = math.inf
    error: float = math.inf
    slip_error: float = math.inf
    inside: bool = False


_ROUNDS = 40  # largest number of iterations; with enough margin each one halves the error
_INFLATED = 1.01  # size of the set that is tested for invariance, relative to the fixed point of the iteration


def kept(gains: Predictive, vehicle: Vehicle, case: RailCase, box: PredictiveBox) -> Kept:
    """Find an invariant set within the boundary layer by iteration; interval arithmetic checks that it is invariant."""
    ratio, theta = arb(gains.radius) / gains.wheel_inertia, arb(gains.dead_time)
    tau = arb(max(gains.observer_time, gains.deceleration_time))

    def mapped(surface: float, error: float) -> tuple[float, float, float]:
        one = demand(gains, vehicle, case, replace(box, surface=surface, error=error))
        if one.d == math.inf:
            return (math.inf,) * 3
        jump = arb(one.jump)
        S = (
            one.d / (arb(gains.reaching_rate) + arb(gains.switching_gain) / gains.layer)
            + 2 * (1 + gains.kappa * theta) * jump
        )
        late = (theta + tau) * one.rate + 2 * jump
        e = ratio * ((S + late + gains.kappa * theta * jump) / gains.kappa + theta * jump)
        return upper(S), upper(e), upper(e + ratio * theta * late)

    surface, error = 0.0, 0.0
    for _ in range(_ROUNDS):
        before, (surface, error, _) = surface, mapped(surface, error)
        if not surface < gains.layer:
            return Kept()
        if surface - before < (_INFLATED - 1.0) / 10.0 * surface:
            break
    surface, error = _INFLATED * surface, _INFLATED * error
    after = mapped(surface, error)
    if not (after[0] <= surface <= gains.layer and after[1] <= error):
        return Kept()
    room = box.slip * case.reference * box.speed_kmh[0] * KMH
    return Kept(surface, error, after[2], after[2] < room)


class Case(NamedTuple):
    """Law, vehicle and rails of a verification."""

    gains: Predictive
    vehicle: Vehicle
    rails: tuple[RailCase, ...]
    adhesion: RailAdhesion


REACHING, WITHIN = "reaching", "reaching within the torque limits"
HOLDS: Mapping[str, Callable[[Predictive, Demand], bool]] = {
    "bounded deviation": lambda gains, one: one.loop < 1.0,
    "small gain": lambda gains, one: one.small_gain < 1.0,
    REACHING: lambda gains, one: one.d < gains.switching_gain and one.tube <= one.surface,
    WITHIN: lambda gains, one: one.d < min(one.left) and one.tube <= one.surface,
    "authority": lambda gains, one: min(one.carried) >= gains.switching_gain,
    "reaching at once": lambda gains, one: one.at_once < gains.switching_gain,
}
"""Conditions over a box by name; each function takes the gains and the bounds (`Demand`) and returns the verdict."""

STAYS = "the slip stays in the box"


def decided(name: str, case: Case, box: PredictiveBox) -> tuple[bool | None, dict[str, Any]]:
    """Decide the condition `name` over a box on every rail; return verdict and numbers.

    `name` is `STAYS` or a key of `HOLDS`. The verdict is False if values of H or P that occur in the box, or a jump of
    the random force, break the condition on a rail. It is None if the condition is undecided; for the conditions on
    reaching it is never False, because d is only a bound. For them the box is made as wide as the tube.
    """
    if name in (REACHING, WITHIN):
        box = widened(case, box)
    found = {one.rail: demand(case.gains, case.vehicle, one, box) for one in case.rails}
    numbers: dict[str, Any] = {"found": found, "gains": case.gains, "box": box, "fails": []}
    if name == STAYS:
        sets = {one.rail: kept(case.gains, case.vehicle, one, box) for one in case.rails}
        return all(one.inside for one in sets.values()) or None, {**numbers, "sets": sets}
    holds = HOLDS[name]
    if all(holds(case.gains, one) for one in found.values()):
        return True, numbers
    if name == REACHING_AT_ONCE:
        most = case.gains.switching_gain + case.gains.reaching_rate * case.gains.layer
        fails = [rail for rail, one in found.items() if one.kick > most]
    elif name in (REACHING, WITHIN):
        fails = []
    else:
        least = {one.rail: demand(case.gains, case.vehicle, one, box, attained=True) for one in case.rails}
        fails = [rail for rail, one in least.items() if not holds(case.gains, one)]
    return (False if fails else None), {**numbers, "fails": fails}


_WIDER = 1.01  # factor on the tube with which the range of |S| is widened


def widened(case: Case, box: PredictiveBox) -> PredictiveBox:
    """Return the box with a range of |S| that contains the tube of every rail; the given box if none is found."""
    wide = box
    for _ in range(_ROUNDS):
        tube = max(demand(case.gains, case.vehicle, one, wide).tube for one in case.rails)
        if tube <= wide.surface:
            return wide
        if math.isinf(tube):
            break
        wide = replace(wide, surface=_WIDER * tube)
    return box


def released(case: Case) -> Condition:
    """Decide whether a wheel cannot lock after its brake is released at the reference slip and the holding torque."""
    speeds, rows = PredictiveBox().speed_kmh, []
    heavy = {"wheel_load": load_ratio(case.vehicle) * case.vehicle.wheel_load, "mass": case.vehicle.mass_loaded}
    for laden in (case.vehicle, case.vehicle.model_copy(update=heavy)):
        for one in case.rails:
            law = case.adhesion.on(one.rail, laden)
            hold = [operating_point(law, laden, v * KMH, one.reference, rail=one.rail).brake_torque for v in speeds]
            found = no_lock(law, laden, np.array(speeds), np.array([one.reference]), torque_max=3.0 * max(hold))
            least = zip(speeds, hold, found.torque[:, 0].tolist(), strict=True)
            rows += [(f"{one.rail}, {laden.mass:g} kg, {v:g} km/h", *torques) for v, *torques in least]
    holds = all(certified > hold for _, hold, certified in rows)
    how = f"certified at {len(rows)} points" if holds else None
    return Condition("no lock after a release", holds or None, how, {"rows": rows})


def conditions(case: Case) -> tuple[Condition, ...]:
    """Decide which conditions hold for exact parameters, with the errors `ASKED`, and with random force."""
    exact = PredictiveBox()
    boxes = {
        **dict.fromkeys(("bounded deviation", "small gain", REACHING, WITHIN, "authority", STAYS), exact),
        **dict.fromkeys(("bounded deviation, tolerances", "reaching, tolerances"), box_with(**ASKED)),
        **{
            f"{name}, random force": replace(exact, random_force=RANDOM_FORCE)
            for name in ("reaching", REACHING_AT_ONCE)
        },
    }
    made = [released(case)]
    for name, box in boxes.items():
        holds, numbers = decided(name.split(",")[0], case, box)
        how = None if holds is None else PROVED if holds else COUNTEREXAMPLE
        made.append(Condition(name, holds, how, numbers))
    return (*made[1:], made[0])


_STEPS = 7  # steps of the bisection, which resolve 1 % of the range


class _Quantity(NamedTuple):
    field: str
    most: float
    unit: str


QUANTITIES = (
    *(_Quantity(name, 0.5, "%") for name in ("brake_gain", "dead_time", "lag", "inertia")),
    *(_Quantity(name, 0.05, "%") for name in ("radius", "train_speed")),
    *(_Quantity("random_force", RANDOM_FORCE, "sigma"), _Quantity("slip", 0.5, "%"), _Quantity("surface", 4e3, "N*m")),
    _Quantity("lowest_speed", _LOWEST_KMH, "km/h"),
)


def box_with(**changes: Any) -> PredictiveBox:
    """Return `PredictiveBox()` with some fields changed; `lowest_speed`, km/h, is the lower end of `speed_kmh`."""
    exact = PredictiveBox()
    if "lowest_speed" in changes:
        changes["speed_kmh"] = (changes.pop("lowest_speed"), exact.speed_kmh[1])
    return replace(exact, **changes)


def tolerances(case: Case) -> tuple[Tolerance, ...]:
    """Find the largest error of each of `QUANTITIES` for which the conditions that hold without errors still hold.

    `limited_by` is empty if these conditions hold over the whole range that is tried. Empty if reaching is not proved
    without errors.
    """
    exact = PredictiveBox()
    holding = [name for name in ("bounded deviation", REACHING, WITHIN, STAYS) if decided(name, case, exact)[0]]

    def broken(name: str, value: float) -> str:
        box = box_with(**{name: value})
        return next((one for one in holding if not decided(one, case, box)[0]), "")

    def bisected(name: str, good: float, bad: float) -> tuple[float, str]:
        limit = broken(name, bad)
        if not limit:
            return bad, ""
        for _ in range(_STEPS):
            middle = 0.5 * (good + bad)
            found = broken(name, middle)
            good, bad, limit = (good, middle, found) if found else (middle, bad, limit)
        return good, limit

    def tube(name: str, value: float) -> float:
        wide = widened(case, box_with(**{name: value}))
        return max(demand(case.gains, case.vehicle, one, wide).tube for one in case.rails)

    starts = {**vars(exact), "lowest_speed": exact.speed_kmh[0]}
    found = []
    for name, most, unit in QUANTITIES if {REACHING, WITHIN} <= set(holding) else ():
        value, limit = bisected(name, starts[name], most)
        found.append(Tolerance(name, value, limit, unit, tube(name, value)))
    return tuple(found)


def verify_predictive(
    vehicle: Vehicle, adhesion: RailAdhesion, *, K: float | None = None, seed: int = 0
) -> Verification:
    """Decide which conditions of the predictive law hold for a static adhesion law; `curve` replaces `bristle`.

    K: switching gain, N*m/s; by default that of `Predictive.for_vehicle`. InputError for another law with a state, or
    for a law without interval enclosure.
    """
    static = replace(adhesion, law="curve") if adhesion.law == "bristle" else adhesion
    gains = Predictive.for_vehicle(vehicle, **({} if K is None else {"switching_gain": K}))
    case = Case(gains, vehicle, tuple(RailCase.of(static, rail, vehicle) for rail in static.rails), static)
    box = PredictiveBox()
    shown = {one.name: getattr(box, one.name) for one in fields(box)}
    shown |= {"mass_kg": (vehicle.mass, vehicle.mass_loaded), "rails": static.rails, "adhesion": static.text}
    known = ("predictive", vehicle.inertia_scale, gains.switching_gain, None, seed)
    return Verification(*known, conditions(case), box=shown, tolerances=tolerances(case))
