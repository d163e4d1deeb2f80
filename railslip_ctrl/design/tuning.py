"""Tuning of PI gains: by a specification for one or more plants ([Astrom1998]), by hand, or by published rules."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np

from railslip_ctrl.controllers.pi import PI, PID, PILead
from railslip_ctrl.controllers.systems import PIController, actuated_plant, pi_transfer_function
from railslip_ctrl.core.arguments import checked, number, numbers
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError, UnstableLoopError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import DeadTimeLoop, Margins, Rational
from railslip_ctrl.loop.crossings import bracketed_roots
from railslip_ctrl.loop.deadtime import frequency_curve
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.model.vehicle import Actuator, PIGains

from .specification import Specification, Worst, family_margins, worst_of
from .tuning_search import Family, largest_ki, least_ms

__all__ = ["PIDesign", "Specification", "pi_for_crossover", "pi_transfer_function", "tune_pi"]


@dataclass(frozen=True)
class PIDesign:
    """Tuned PI gains with the margins of every plant and the worst value of each margin.

    The unit of kp is that of the plant's input over that of the plant's output; ki is in this unit per second.
    """

    kp: float
    ki: float
    worst: Worst
    margins: tuple[Margins, ...]
    specification: Specification


@checked
def tune_pi(
    plants: Any,
    dead_time: float | Sequence[float] = 0.0,
    *,
    ms_max: float | None = None,
    phase_min_deg: float | None = None,
    delay_min_s: float | None = None,
    crossover: tuple[float, float] | None = None,
    minimise_ms: bool = False,
    ki_min: float | None = None,
    compensator: Any = None,
    names: Sequence[str] = (),
) -> PIDesign:
    """Tune one PI, kp + ki/s, for all plants.

    - plants: python-control system, `Rational`, or a sequence of them: transfer functions from controller output to
      controlled variable, without the dead time. Feedback is negative.
    - dead_time: dead time, s, one value for all plants, or one for each.
    - ms_max: largest Ms of every loop, a ratio, > 1.
    - phase_min_deg, delay_min_s: smallest phase margin, deg, and smallest delay margin, s, of every loop.
    - crossover: lowest and highest gain crossover, rad/s; see `Specification`.
    - minimise_ms: if true, minimise the worst Ms under the other requirements; by default maximise ki. If all plants
      are stable, gains of almost 0 have the smallest Ms; in this case maximise ki with `ms_max` instead.
    - ki_min: smallest ki, > 0, in the unit of kp per second, for `minimise_ms`.
    - compensator: python-control system, `Rational`, or a real number; a further transfer function in series with the
      PI, such as a lead.
    - names: names of the plants in messages; by default numbers.

    The gains meet the specification exactly, and ki is a local maximum. The search covers kp up to four times the
    largest kp that stabilises with small ki. With `ms_max` up to 50 the search can miss a larger ki only if the allowed
    ki form a range narrower than 4 %. Without `ms_max` it tries values of ki 25 % apart.

    InfeasibleDesignError: no PI meets the specification; the message has the best achievable value. InputError: no
    plants, an argument of wrong type, or a contradictory specification.
    """
    specification = Specification(ms_max, phase_min_deg, delay_min_s, crossover)
    systems = _systems(plants, compensator)
    family = Family(systems, _dead_times(plants, dead_time), compensator is not None, tuple(names))
    if names and len(names) != len(systems):
        raise InputError(f"names: {len(names)} for {len(systems)} plants; give one name for each plant, or none")
    if minimise_ms:
        if ki_min is None:
            raise InputError("ki_min: None is not allowed with minimise_ms; give the smallest ki, > 0")
    elif ki_min is not None:
        raise InputError("ki_min is used only with minimise_ms; leave ki_min out to maximise ki")
    return _tuned(family, specification, ki_min)


def _tuned(family: Family, specification: Specification, ki_min: float | None) -> PIDesign:
    if ki_min is not None:
        kp, ki = least_ms(family, specification, number("ki_min", ki_min, gt=0))
    elif specification == Specification(crossover=specification.crossover):
        raise InputError("specification: nothing bounds ki; give ms_max, phase_min_deg or delay_min_s")
    else:
        kp, ki = largest_ki(family, specification)
    loops = family.loops(kp, ki)
    worst = worst_of(family_margins(loops))
    assert worst is not None  # only stable gains are returned
    return PIDesign(kp, ki, worst, tuple(loop.margins() for loop in loops), specification)


@checked
def pi_for_crossover(plant: Any, dead_time: float, crossover: float, phase_margin_deg: float) -> tuple[float, float]:
    """Return (kp, ki) of the PI whose loop has a given gain crossover with a given phase margin.

    - plant, dead_time: plant without dead time, and dead time, s, >= 0.
    - crossover: frequency at which |L| is 1, rad/s, > 0.
    - phase_margin_deg: phase margin at this frequency, deg, in (0, 180).

    InfeasibleDesignError: this PI does not stabilise the plant, needs ki < 0, or has a smaller phase margin at another
    crossover.
    """
    number("crossover", crossover, "rad/s", gt=0)
    number("phase margin", phase_margin_deg, "deg", gt=0, lt=180)
    system = Rational.from_control(plant, "plant")
    at = DeadTimeLoop(system, dead_time)(1j * crossover)
    wanted = -np.exp(1j * math.radians(phase_margin_deg)) / at
    kp, ki = float(wanted.real), float(-wanted.imag * crossover)
    required = f"crossover {crossover:g} rad/s with phase margin {phase_margin_deg:g} deg"
    if ki < 0:
        raise InfeasibleDesignError(
            f"{required} needs ki = {ki:.4g} < 0, because the plant's phase is too low at this frequency; choose a "
            "smaller phase margin or another crossover, or add a lead"
        )
    loop = DeadTimeLoop(pi_transfer_function(kp, ki) * system, dead_time)
    if not loop.is_stable():
        raise InfeasibleDesignError(
            f"{required} gives kp = {kp:.4g}, ki = {ki:.4g}, which does not stabilise the plant "
            f"({loop.unstable_closed_loop_poles:g} unstable poles); choose another crossover"
        )
    smallest = loop.margins().phase_deg
    if smallest < phase_margin_deg * (1 - 1e-9):
        raise InfeasibleDesignError(
            f"{required} is met, but at a second gain crossover of the loop the phase margin is {smallest:.4g} deg; "
            "give a different crossover"
        )
    return kp, ki


def _systems(plants: Any, compensator: Any) -> list[Rational]:
    members = list(plants) if isinstance(plants, (list, tuple)) else [plants]
    if not members:
        raise InputError("plants: none is given; give at least one")
    extra = Rational.from_control(1.0 if compensator is None else compensator, "compensator")
    systems = [extra * Rational.from_control(plant, "plants") for plant in members]
    if not all(system.gain for system in systems):
        raise InputError(
            "plants: a plant in series with the compensator has gain 0; give plants and compensator with nonzero gains"
        )
    return systems


def _dead_times(plants: Any, dead_time: float | Sequence[float]) -> list[float]:
    count = len(plants) if isinstance(plants, (list, tuple)) else 1
    values: list[float] = np.atleast_1d(numbers("dead_time", dead_time, "s", ge=0)).tolist()
    if len(values) not in (1, count):
        raise InputError(f"dead_time: {len(values)} values for {count} plants; give one value, or one for each plant")
    return values * count if len(values) == 1 else values


_LEAD_FACTORS = (0.3, 0.5, 0.8, 1.2, 1.8, 3.0)  # derivative times of the first grid, relative to the actuator's lag


@dataclass(frozen=True)
class TunedCases:
    """Gains of a `kind` of controller, tuned to a `specification` at some operating points, SI.

    If no gains meet the specification, `design` is None, and `reason` states why. `lead` and `lead_filter` are in s.
    """

    kind: type[PI]
    points: tuple[OperatingPoint, ...]
    specification: Specification
    ki_min: float | None
    lead: float
    lead_filter: float
    design: PIDesign | None
    reason: str

    @property
    def asked(self) -> str:
        goal = "maximise ki" if self.ki_min is None else f"minimise Ms with ki >= {self.ki_min:g} N*m/m"
        return ", ".join(filter(None, [goal, self.specification.description]))

    def controller(self, design: PIDesign) -> PIController:
        return PIController(PIGains(kp=design.kp, ki=design.ki), self.lead, self.lead_filter)


def tune_cases(
    plants: Sequence[LinearPlant],
    actuator: Actuator,
    *,
    kind: type[PI] = PI,
    specification: Specification,
    ki_min: float | None = None,
    lead: float | None = None,
    lead_filter: float | None = None,
) -> TunedCases:
    """Tune one controller for all plants; if no gains meet the specification, the result has a `reason` and no design.

    - kind: class of the controller: `PI` has no lead; `PILead` has a lead in series with kp + ki/s; for a `PID` the
      time constant of this lead is searched between 0.3 and 3 times the actuator's lag.
    - lead: time constant of the lead of a `PILead`, s; by default the actuator's lag.
    - lead_filter: time constant of the lead's filter, s; by default a tenth of the lead.
    - ki_min: smallest ki, N*m/m. If it is given, the worst Ms is minimised; otherwise ki is maximised.

    InputError: a lead for a plain PI or a PID, or a contradictory specification.
    """
    if not issubclass(kind, PILead) and (lead is not None or lead_filter is not None):
        given = "lead" if lead is not None else "lead filter"
        raise InputError(f"{given} has no effect with structure {kind.kind!r}; choose 'pi-lead' or 'pid'")
    if issubclass(kind, PID) and lead is not None:
        raise InputError("lead: structure 'pid' computes the lead's time constant; to set it yourself choose 'pi-lead'")
    tuned = partial(_tune, plants, actuator, kind, specification, ki_min, lead_filter)
    if issubclass(kind, PID):
        return _searched(tuned, actuator.lag or actuator.dead_time or 1.0)
    return tuned(lead)


def _searched(tuned: Callable[[float | None], TunedCases], lag: float) -> TunedCases:
    from scipy.optimize import minimize_scalar

    tried: dict[float, TunedCases] = {}

    def cost(log_time: float) -> float:
        cases = tried[log_time] = tried.get(log_time) or tuned(math.exp(log_time))
        if cases.design is None:
            return 1e30
        return -cases.design.ki if cases.ki_min is None else cases.design.worst.ms

    grid = [math.log(lag * factor) for factor in _LEAD_FACTORS]
    best = int(np.argmin([cost(x) for x in grid]))
    if tried[grid[best]].design is None:
        return tried[grid[len(grid) // 2]]
    ends = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    minimize_scalar(lambda x: cost(float(x)), bounds=ends, method="bounded", options={"xatol": 2e-3})
    return tried[min(tried, key=cost)]


def _tune(
    plants: Sequence[LinearPlant],
    actuator: Actuator,
    kind: type[PI],
    specification: Specification,
    ki_min: float | None,
    lead_filter: float | None,
    lead: float | None,
) -> TunedCases:
    compensator = kind.compensator(actuator, lead, lead_filter)
    shape = compensator.transfer_function
    points = tuple(plant.point for plant in plants)
    family = Family(
        [shape * actuated_plant(plant, actuator) for plant in plants],
        [actuator.dead_time] * len(points),
        compensated=True,
        names=tuple(point.description for point in points),
    )
    design, reason = None, ""
    try:
        design = _tuned(family, specification, ki_min)
    except InfeasibleDesignError as error:
        reason = str(error)
    return TunedCases(kind, points, specification, ki_min, compensator.lead, compensator.lead_filter, design, reason)


# Integral time relative to dead time plus lag. The corner of the integral action is then far below the crossover and
# costs less than 2 deg of phase margin, while the offset still decays.
_INTEGRAL_TIME = 50.0


@dataclass(frozen=True)
class CommonPI:
    """PI gains with the smallest worst Ms over some operating points, at a fixed integral time.

    - controller: the PI.
    - worst_ms: largest Ms over the operating points, a ratio.
    - integral_time: kp/ki, s.
    - gain_range: interval of kp that stabilises all operating points at this integral time, N*m/(m/s).
    """

    controller: PIController
    worst_ms: float
    integral_time: float
    gain_range: tuple[float, float]


@checked
def common_pi(plants: Sequence[LinearPlant], actuator: Actuator) -> CommonPI:
    """Return the PI that minimises the worst Ms over `plants`, with a fixed integral time.

    The integral time kp/ki is 50 times the sum of dead time and lag of the `actuator`. kp is in N*m/(m/s), ki in N*m/m.
    InfeasibleDesignError: no kp stabilises all plants, or all plants are stable, so that gain 0 has the smallest Ms.
    InputError: no plant is given.
    """
    from scipy.optimize import minimize_scalar

    if not plants:
        raise InputError("common PI: no operating point is given; give at least one")
    if not any(np.any(plant.poles.real >= 0) for plant in plants):
        raise InfeasibleDesignError(
            "the wheel is stable without control at every operating point, and zero gain has the smallest Ms; maximise "
            "ki with a bound on Ms instead"
        )
    integral_time = _INTEGRAL_TIME * ((actuator.dead_time + actuator.lag) or 0.02)
    shape = Rational(np.array([-1 / integral_time]), np.array([0.0]), 1.0)
    loops = [DeadTimeLoop(shape * actuated_plant(plant, actuator), actuator.dead_time) for plant in plants]
    low, high = _common_range(plants, loops, actuator)

    def worst_ms(log_kp: float) -> float:
        try:
            return max(loop.scaled(math.exp(log_kp)).margins().ms for loop in loops)
        except UnstableLoopError:
            return math.inf

    top = min(high, 1e6 * (low or 1.0))
    ends = math.log(low or 1e-6 * top), math.log(top)
    # Ms is quasi-convex in ln kp inside the stabilising range
    best = minimize_scalar(worst_ms, bounds=ends, method="bounded", options={"xatol": 1e-10})
    kp = math.exp(best.x)
    controller = PIController(PIGains(kp=kp, ki=kp / integral_time))
    return CommonPI(controller, float(best.fun), integral_time, (low, high))


def _common_range(
    plants: Sequence[LinearPlant], loops: Sequence[DeadTimeLoop], actuator: Actuator
) -> tuple[float, float]:
    ranges = [loop.stabilizing_gain_range for loop in loops]
    stabilisable = [r for r in ranges if r is not None]
    low, high = max((r[0] for r in stabilisable), default=0.0), min((r[1] for r in stabilisable), default=0.0)
    if len(stabilisable) == len(ranges) and low < high:
        return low, high
    texts = "; ".join(
        f"{plant.point.rail} {plant.point.speed_kmh:g} km/h: "
        + ("none" if r is None else f"{r[0]:.4g} to {r[1]:.4g} N*m/(m/s)")
        + " (unstable pole times (dead time + lag) "
        + f"{max(plant.poles.real.max(), 0) * (actuator.dead_time + actuator.lag):.3g})"
        for plant, r in zip(plants, ranges, strict=True)
    )
    raise InfeasibleDesignError(f"no single PI stabilises all operating points; stabilising kp: {texts}")


@checked
def most_phase(loop: DeadTimeLoop) -> tuple[float, float]:
    """Return the frequency, rad/s, at which the continuous phase of a `loop` is largest, and this phase, rad.

    InputError: the phase has no maximum.
    """
    curve = frequency_curve(loop, *loop.feature_band())
    top = int(np.argmax(curve.phase_deg))
    if top in (0, curve.omega.size - 1):
        raise InputError("loop shaping: the phase of this loop has no maximum; choose the crossover by hand")
    low, high = curve.omega[[top - 1]], curve.omega[[top + 1]]
    omega = float(bracketed_roots(lambda w, _: loop.phase_slope(w), low, high)[0])
    return omega, float(loop.phase(omega))


@checked
def gain_for_crossover(loop: DeadTimeLoop, omega: float) -> float:
    """Return the factor on the gain of a `loop` that puts a gain crossover at the frequency `omega`, rad/s, > 0.

    InputError: omega is not finite and positive.
    """
    number("crossover", omega, "rad/s", gt=0)
    return float(1 / np.abs(loop(1j * omega)))


# Largest relative imaginary part of a real root, due to rounding; a triple root of a polynomial is below it.
_REAL = 1e-3


class Kind(StrEnum):
    """Type of the slowest pole of a model."""

    STABLE = "stable"
    INTEGRATING = "integrating"
    UNSTABLE = "unstable"


@dataclass(frozen=True)
class FirstOrderModel:
    """First-order model with dead time of a plant.

    It is gain exp(-theta s) divided by (T s + 1) if stable, by (T s - 1) if unstable, and by s if integrating.

    - gain: output over input, (m/s)/(N*m) for the wheel; per second if integrating.
    - time_constant: T, s; inf if integrating.
    - dead_time: theta, s.
    """

    kind: Kind
    gain: float
    time_constant: float
    dead_time: float

    @property
    def transfer_function(self) -> Rational:
        if self.kind is Kind.INTEGRATING:
            return Rational(np.array([]), np.array([0.0]), self.gain)
        sign = 1.0 if self.kind is Kind.UNSTABLE else -1.0
        return Rational(np.array([]), np.array([sign / self.time_constant]), self.gain / self.time_constant)


@dataclass(frozen=True)
class RuleTuning:
    """Controller C(s) = kp + ki/s + kd s of a tuning rule, which may fail to stabilise the full plant.

    - gains: kp, N*m/(m/s), and ki, N*m/m, for the wheel.
    - derivative_gain: kd, N*m/(m/s^2) for the wheel; 0 for a PI.
    - model: first-order model of the plant.
    - closed_loop_time: tuning parameter of the rule, s.
    """

    rule: str
    gains: PIGains
    derivative_gain: float
    model: FirstOrderModel
    closed_loop_time: float

    def transfer_function(self, derivative_filter: float = 0.0) -> Rational:
        """Return C(s) with the derivative part kd s/(derivative_filter s + 1).

        InputError for a PID unless the filter is > 0 s.
        """
        tf, kp, ki, kd = derivative_filter, self.gains.kp, self.gains.ki, self.derivative_gain
        number("derivative filter", tf, "s", gt=0 if kd else None, ge=0)
        num = [kp * tf + kd, kp + ki * tf, ki]
        return Rational.from_polynomials(num, [tf, 1.0, 0.0])


@checked
def first_order_model(plant: Any, dead_time: float) -> FirstOrderModel:
    """Reduce a plant with real poles to first order by the half rule ([Skogestad2003]).

    - plant: linear system from command to output, without the dead time. Its poles and zeros are real, and at most one
      pole is >= 0.
    - dead_time: dead time, s, >= 0.

    [Skogestad2003] does not cover unstable plants; here all lags of an unstable plant are added to the dead time.

    InputError: a plant with other poles or zeros, or negative zeros with time constants above the model's dead time.
    """
    number("dead time", dead_time, "s", ge=0)
    plant = Rational.from_control(plant, "plant")
    roots = np.concatenate([plant.poles, plant.zeros])
    if plant.poles.size == 0 or np.any(np.abs(roots.imag) > _REAL * np.abs(roots)) or np.any(plant.zeros == 0):
        raise InputError(
            "first-order model: the plant has complex roots, a zero at the origin, or no pole; give a plant with real "
            "poles and zeros, or tune it with tune_pi"
        )
    poles, zeros = plant.poles.real, plant.zeros.real
    if np.count_nonzero(poles >= 0) > 1:
        raise InputError(
            "first-order model: the plant has several poles with real part >= 0; the rules allow at most one"
        )
    lags = np.sort(-1 / poles[poles < 0])[::-1]
    unstable, integrating = poles[poles > 0], poles[poles == 0]
    # value at s = 0 without the factor of the slow pole
    rest = Rational(plant.zeros, plant.poles[plant.poles != 0], plant.gain).dc_gain
    if unstable.size:
        kind, gain, time_constant, half = Kind.UNSTABLE, -rest, float(1 / unstable[0]), 0.0
    elif integrating.size:
        kind, gain, time_constant = Kind.INTEGRATING, rest, math.inf
        half = lags[0] / 2 if lags.size else 0.0
    else:
        kind, gain, half = Kind.STABLE, rest, lags[1] / 2 if lags.size > 1 else 0.0
        time_constant, lags = float(lags[0] + half), lags[1:]
    theta = dead_time + float(lags.sum() - half + (1 / zeros[zeros > 0]).sum())
    leads = -1 / zeros[zeros < 0]
    if np.any(leads > theta):
        raise InputError(
            f"first-order model: a zero of time constant {leads.max():.4g} s is slower than the effective dead time "
            f"{theta:.4g} s; cancel it in the controller first"
        )
    theta -= float(leads.sum())
    if theta < 0:
        raise InputError(
            f"first-order model: the negative zeros of the plant reduce the model's dead time to {theta:.4g} s, but "
            "the tuning rules need a dead time >= 0; cancel the zeros in the controller first"
        )
    return FirstOrderModel(kind, float(gain), time_constant, theta)


@checked
def simc_pi(plant: Any, dead_time: float, *, closed_loop_time: float | None = None) -> RuleTuning:
    """Return the PI of the SIMC rule ([Skogestad2003]) for the first-order model of a plant.

    With gain k, time constant T and dead time theta of the model, the rule is kp = T/(k (tau_c + theta)), with integral
    time min(T, 4 (tau_c + theta)).

    - plant, dead_time: plant without dead time, and dead time, s, as in `first_order_model`.
    - closed_loop_time: tau_c, s, > -theta; by default theta ("tight control").

    InputError: an unstable plant, a model without dead time if `closed_loop_time` is not given, or an error of
    `first_order_model`.
    """
    model = first_order_model(plant, dead_time)
    if model.kind is Kind.UNSTABLE:
        raise InputError(
            f"SIMC: the plant has an unstable pole at {1 / model.time_constant:.4g} 1/s; the rule holds for stable and "
            "integrating plants only; use rotstein_lewin or tune_pi"
        )
    tau_c = model.dead_time if closed_loop_time is None else closed_loop_time
    total = tau_c + model.dead_time
    if closed_loop_time is None and total == 0:
        raise InputError("SIMC: the model has no dead time, so that tau_c has no default; give closed_loop_time")
    number("closed-loop time", tau_c, "s", gt=-model.dead_time)
    if model.kind is Kind.INTEGRATING:
        kp, integral_time = 1 / (model.gain * total), 4 * total
    else:
        kp, integral_time = model.time_constant / (model.gain * total), min(model.time_constant, 4 * total)
    return RuleTuning("SIMC PI", PIGains(kp=kp, ki=kp / integral_time), 0.0, model, tau_c)


@checked
def rotstein_lewin(plant: Any, dead_time: float, *, closed_loop_time: float, derivative: bool = False) -> RuleTuning:
    """Return a PI or PID for an unstable first-order plant with dead time, by internal model control ([Rotstein1991]).

    The first-order model has gain k, time constant T and dead time theta; the tuning parameter is lambda. With alpha =
    lambda (lambda/T + 2) the PI has kp = T alpha/(k lambda^2) and integral time alpha. The PID is this PI in series
    with (theta s/2 + 1). If theta > 0, lambda must lie in an interval that [Rotstein1991] gives as a graph.

    - plant, dead_time: plant without dead time, and dead time, s, as in `first_order_model`.
    - closed_loop_time: lambda, s, > 0.
    - derivative: true for a PID, false for a PI.

    InputError: the plant is not unstable; no PI (theta >= T) or no PID (theta >= 2 T) stabilises the model; lambda is
    not > 0; or an error of `first_order_model`.
    """
    model = first_order_model(plant, dead_time)
    if model.kind is not Kind.UNSTABLE:
        raise InputError(f"Rotstein-Lewin: the plant is {model.kind.value}; the rule is for unstable ones; use simc_pi")
    lam, k, t, half = closed_loop_time, model.gain, model.time_constant, model.dead_time / 2 if derivative else 0.0
    number("closed-loop time", lam, "s", gt=0)
    most = (2 if derivative else 1) * t
    if model.dead_time >= most:
        raise InputError(
            f"Rotstein-Lewin: the effective dead time {model.dead_time:.4g} s is not < {most:.4g} s, the limit for a "
            f"{'PID' if derivative else 'PI'}; shorten the dead time or cancel the lag"
        )
    alpha = lam * (lam / t + 2)
    kp = t * (alpha + half) / (k * lam**2)
    gains = PIGains(kp=kp, ki=kp / (alpha + half))
    name = "Rotstein-Lewin PID" if derivative else "Rotstein-Lewin PI"
    return RuleTuning(name, gains, kp * alpha * half / (alpha + half), model, lam)
