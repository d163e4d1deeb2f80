"""Linear controllers as systems, and the loop that a controller closes around the wheel.

The loop transfer function is L(s) = C(s) Ga(s) P(s): C from the slip-velocity error e = lambda_d v - sigma to the
commanded brake torque, Ga the brake actuator with its dead time, P from acting torque to -e. More torque gives
more slip, so that P > 0 and the feedback is negative.
"""

from __future__ import annotations

import functools
import inspect
from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import check_fields, checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, shown
from railslip_ctrl.core.user_files import call_failure, place_of
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.rational import realise
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint, linearize
from railslip_ctrl.model.vehicle import Actuator, PIGains

from .base import Controller


@dataclass(frozen=True)
class PIController:
    """C(s) = (kp + ki/s) (lead s + 1)/(lead_filter s + 1).

    - gains: kp in N*m/(m/s), ki in N*m/m.
    - lead: time constant of the lead (lead s + 1), s, >= 0; 0: none. It adds phase: one equal to the actuator's lag
      cancels that.
    - lead_filter: time constant of the lag (lead_filter s + 1) that bounds the lead's gain at high frequency, s, >= 0;
      > 0 with a lead, or C is not proper. Without a lead it filters the error.

    InputError: a field of another kind, a negative or non-finite time constant, or a lead without a filter.
    """

    gains: PIGains
    lead: float = 0.0
    lead_filter: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        number("lead", self.lead, "s", ge=0)
        number("lead filter", self.lead_filter, "s", ge=0)
        if self.lead > 0 and self.lead_filter == 0:
            raise InputError(f"lead filter: 0 s with a lead of {self.lead:g} s is not proper; give a value > 0")

    @property
    def structure(self) -> str:
        """ "PI" or "PI-lead"."""
        return "PI-lead" if self.lead > 0 or self.lead_filter > 0 else "PI"

    @property
    def transfer_function(self) -> Rational:
        """C(s) in factored form."""
        return pi_transfer_function(self.gains.kp, self.gains.ki) * _first_order(self.lead, self.lead_filter)


def pi_transfer_function(kp: float, ki: float) -> Rational:
    """kp + ki/s in factored form; ki = 0 has no integrator."""
    if ki == 0:
        return Rational(np.array([]), np.array([]), kp)
    zeros = np.array([]) if kp == 0 else np.array([-ki / kp])
    return Rational(zeros, np.array([0.0]), kp or ki)


def _first_order(lead: float, lag: float) -> Rational:
    """(lead s + 1)/(lag s + 1)."""
    zeros = np.array([-1 / lead]) if lead > 0 else np.array([])
    poles = np.array([-1 / lag]) if lag > 0 else np.array([])
    return Rational(zeros, poles, (lead or 1.0) / (lag or 1.0))


class _System:
    """What records of systems share; a `period` of s makes a discrete-time one."""

    period: Any
    transfer_function: Any

    def __post_init__(self) -> None:
        check_fields(self)
        if self.period is not None:
            number("period", self.period, "s", gt=0)
        _ = self.transfer_function

    @property
    def structure(self) -> str:
        """What it is, in words."""
        system = self.transfer_function
        if system.poles.size == 0 and self.period is None:
            return f"gain {system.gain:g} N*m/(m/s)"
        return f"{'' if self.period is None else 'discrete '}transfer function of order {system.poles.size}"


@dataclass(frozen=True)
class PolynomialController(_System):
    """C = num/den, a ratio of polynomials.

    - num, den: coefficients of descending powers of s, C in N*m/(m/s); with a `period` of z.
    - period: of a discrete-time controller, s; left out, it is continuous.

    InputError: coefficients that are not finite, a denominator 0, more zeros than poles, or a period that is not > 0.
    """

    num: tuple[float, ...]
    den: tuple[float, ...]
    period: float | None = None

    @cached_property
    def transfer_function(self) -> Rational:
        """C(s), or C(z), in factored form."""
        return Rational.from_polynomials(self.num, self.den)


@dataclass(frozen=True)
class StateSpaceController(_System):
    """C as x' = a x + b e, torque = c x + d e (of a discrete one x of the next sample for x').

    - a, b, c, d: tuples of float; n by n, n, n and a number; SI, torque in N*m for e in m/s.
    - period: as of `PolynomialController`, s.

    InputError: shapes that do not fit, entries that are not finite, or a period that is not > 0.
    """

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    d: float = 0.0
    period: float | None = None

    @cached_property
    def transfer_function(self) -> Rational:
        """C(s), or C(z), in factored form."""
        order = len(self.a)
        if any(len(part) != order for part in (*self.a, self.b, self.c)):
            shape = f"{order} by {max(map(len, self.a), default=0)}, {len(self.b)} and {len(self.c)}"
            raise InputError(f"state space: shapes {shape} do not fit; give n by n, n and n")
        a = np.array(self.a, dtype=float).reshape(order, order)
        return Rational.from_state_space(a, np.array(self.b), np.array(self.c), np.array([self.d]))


def system_words(design: LinearController) -> str:
    """Structure and numbers of a linear controller, in a line."""
    if isinstance(design, PIController):
        kp, ki = design.gains.kp, design.gains.ki
        text = f"{design.structure}: kp {kp:.6g} N·m/(m/s), ki {ki:.6g} N·m/m"
        text += f"   ({kp * KMH:.5g} N·m per km/h, {ki * KMH:.5g} N·m per km/h per s)"
        lead = f", lead ({design.lead:g} s + 1)/({design.lead_filter:g} s + 1): a series PID"
        return text + lead * (design.structure != "PI")
    numbers = ((name, value) for name, value in asdict(design).items() if value is not None)
    return f"{design.structure}: " + ", ".join(f"{name} {plain_number(value)}" for name, value in numbers)


def plain_number(value: float | tuple[Any, ...]) -> str:
    """A number, or a list of them, with six digits."""
    return f"[{' '.join(map(plain_number, value))}]" if isinstance(value, tuple) else f"{value:.6g}"


LinearController = PIController | PolynomialController | StateSpaceController
"""The records that any linear controller becomes."""


@checked
def linear_controller(controller: Any, point: OperatingPoint | None = None) -> LinearController:
    """A linear controller as a record, from slip error e (m/s) to torque (N*m).

    - controller: linear system; `PIGains`, `PIController`, python-control TransferFunction or StateSpace, scipy.signal
      system, `Rational`, a real number, or an object with `linear(operating_point)` that returns one of these.
    - point: what `linear` is asked for.

    InputError: what is none of these: a step object or function has no margins.
    """
    if isinstance(controller, PIController | PolynomialController | StateSpaceController):
        return controller
    if isinstance(controller, PIGains):
        return PIController(controller)
    _check_object(controller)
    if isinstance(controller, Controller):
        return _linear_kind(controller, point)
    if callable(linear := linear_of(controller)):
        return _linear_at(point, linear, _name(controller))
    if has_step(controller):
        raise step_alone(controller)
    dt = getattr(controller, "dt", None)
    if dt is True:
        raise InputError("controller: its sampling period is not given (dt = True); give dt in s")
    period = float(dt) if dt else None
    system = Rational.from_control(controller, "controller", period=period)
    if system.poles.size == 0:
        return PolynomialController((system.gain,), (1.0,), period)
    if hasattr(controller, "A"):
        rows = np.asarray(controller.A, dtype=float)
        b, c, d = (tuple(np.ravel(matrix).tolist()) for matrix in (controller.B, controller.C, controller.D))
        return StateSpaceController(tuple(map(tuple, rows.tolist())), b, c, float(d[0]), period)
    if hasattr(controller, "num"):
        one = hasattr(controller, "ninputs")
        num, den = (controller.num[0][0], controller.den[0][0]) if one else (controller.num, controller.den)
        num, den = (tuple(np.atleast_1d(each).astype(float).tolist()) for each in (num, den))
        return PolynomialController(num, den, period)
    made = realise(system)
    return StateSpaceController(
        tuple(map(tuple, made.a.tolist())), tuple(made.b.tolist()), tuple(made.c.tolist()), float(made.d), period
    )


def _check_object(controller: Any) -> None:
    """Refuse a name and a class."""
    if isinstance(controller, str):
        raise InputError(
            f"controller: {shown(controller)} is a name; give the controller, of a file by load_controller"
        )
    if inspect.isclass(controller):
        raise InputError(f"controller: {controller.__name__} is a class; give an object of it, {controller.__name__}()")


def _linear_kind(controller: Controller, point: OperatingPoint | None) -> LinearController:
    """The linear system of a controller of a kind; InputError where it has none."""
    system = controller.linear(point)
    if system is None:
        raise InputError(
            f"controller: {controller.label} has no margins: {controller.no_loop}; simulate and campaign run it"
        )
    return system  # type: ignore[no-any-return]


def linear_of(controller: Any) -> Any:
    """Its `linear`, or None; InputError where it is there and cannot be had, such as a property that fails."""
    try:
        return controller.linear
    except Exception as error:  # a user's property may fail in any way
        kept = inspect.getattr_static(controller, "linear", None)
        if kept is None:
            return None
        told = call_failure(error, getattr(kept, "fget", kept), "linear", "")
        raise InputError(f"controller {_name(controller)}: {told}") from error


def _linear_at(point: OperatingPoint | None, linear: Any, name: str) -> LinearController:
    """What the method `linear` of a user's object gives at a point."""
    if point is None:
        raise InputError(f"controller {name}: it is linear at an operating point; give one")
    try:
        made = linear(point)
    except InputError:
        raise
    except Exception as error:  # a user's method may fail in any way
        raise InputError(f"controller {name}: {call_failure(error, linear, 'linear', 'operating_point')}") from error
    if isinstance(made, _System) or not hasattr(made, "linear"):
        try:
            return linear_controller(made)
        except InputError as error:
            raise InputError(f"controller {name}: {place_of(linear)}what linear gives is refused: {error}") from None
    raise InputError(
        f"controller {name}: {place_of(linear)}linear gives {_name(made)}, which is no system; give python-control's"
    )


def is_function(thing: Any) -> bool:
    """Whether it is called itself: a function, a method, or Numba's."""
    return inspect.isroutine(thing) or isinstance(thing, functools.partial) or hasattr(thing, "py_func")


def is_system(controller: Any) -> bool:
    """Whether it is a linear system as it stands: python-control's and SciPy's have ports and a `dt`."""
    ported = hasattr(controller, "ninputs") or hasattr(controller, "inputs")
    return (ported and hasattr(controller, "dt")) or isinstance(controller, Rational | PIController)


def has_step(controller: Any) -> bool:
    """Whether it is known by its step: a function, or an object with `step` that is no linear system.

    Of a linear system of scipy.signal `step` is its response, and a step object may have a `dt`.
    """
    if isinstance(controller, Controller):
        return False
    return is_function(controller) or (hasattr(controller, "step") and not is_system(controller))


def step_alone(controller: Any) -> InputError:
    """The refusal of margins for what is known by its step."""
    where = place_of(getattr(controller, "step", controller))
    lacking = "an object that has step and" if is_function(controller) else "it"
    return InputError(
        f"controller: {where}{_name(controller)} is known by its step alone and has no margins; give {lacking} a "
        "method linear(operating_point) that returns a python-control system"
    )


def _name(thing: Any) -> str:
    return getattr(thing, "__name__", type(thing).__name__)


@checked
def controller_system(controller: Any, point: OperatingPoint | None = None) -> Rational:
    """C(s) of a continuous linear `controller`, N*m/(m/s), at a `point`; arguments and errors of `linear_controller`.

    InputError also for a discrete one, whose margins are those of `sampled.sampled_loop`.
    """
    if isinstance(controller, Rational):
        return controller
    design = linear_controller(controller, point)
    if not isinstance(design, PIController) and design.period is not None:
        raise InputError(
            f"controller: a discrete-time system (dt = {design.period:g}) has no transfer function in s; its margins "
            "are those of wheel_slip_loop"
        )
    return design.transfer_function


def polynomials(controller: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Numerator and denominator of a continuous linear `controller`, coefficients of descending powers of s."""
    num, den = (one.coeffs()[::-1] for one in controller_system(controller).polynomials)
    return tuple(map(float, num)), tuple(map(float, den))


@checked
def actuated_plant(plant: LinearPlant, actuator: Actuator) -> Rational:
    """From commanded torque (N*m) to -e (m/s) without the dead time.

    - plant: the wheel.
    - actuator: its lag, s, is put before the wheel.

    Returns m/s over N*m, SISO.
    """
    if plant.speed_state:
        wheel = Rational.from_state_space(plant.A, plant.B, -plant.C[plant.outputs.index("error")], 0.0)
    else:
        wheel = Rational(plant.zeros, plant.poles, plant.gain)  # with v frozen -e is sigma
    return _first_order(0.0, actuator.lag) * wheel


@checked
def wheel_slip_loop(plant: LinearPlant | OperatingPoint, controller: Any, actuator: Actuator | None = None) -> Any:
    """L(s) = C(s) Ga(s) P(s), the dead time exact; of a discrete controller the sampled loop, as exact.

    Of a kind with a loop of its own, such as the seeking controller, that loop.

    - plant: P, from torque at the wheel (N*m) to -e (m/s); with the speed frozen that is sigma.
    - controller: linear system, or a kind with a loop; C, from slip error e = lambda_d v - sigma (m/s) to torque
      (N*m): see `linear_controller`.
    - actuator: Ga, dead time and lag, s. [Park2008] p. 55. Left out, that of the operating point's vehicle.

    Returns L, dimensionless, SISO, closed by unity negative feedback: a `DeadTimeLoop`, of a controller with a dt a
    `SampledLoop`, of a loop with delays inside a `DelayedLoop`.
    InputError: an argument of another kind, or a controller without a transfer function.
    """
    if isinstance(plant, OperatingPoint):
        plant = linearize(plant)
    actuator = plant.point.vehicle.actuator if actuator is None else actuator
    if isinstance(controller, Controller) and (loop := controller.loop(plant.point, actuator)) is not None:
        return loop
    design = controller if isinstance(controller, Rational) else linear_controller(controller, plant.point)
    if isinstance(design, PolynomialController | StateSpaceController) and design.period is not None:
        return SampledLoop(design.transfer_function, actuated_plant(plant, actuator), actuator.dead_time, design.period)
    return DeadTimeLoop(controller_system(design) * actuated_plant(plant, actuator), actuator.dead_time)
