"""Transfer functions of linear controllers, and the wheel-slip loop of a controller.

The loop transfer function is L(s) = C(s) Ga(s) P(s). C is the controller, from the slip-velocity error e = lambda_d v -
sigma to the commanded brake torque. Ga is the brake actuator with its dead time. P is the wheel, from acting torque to
-e. More torque gives more slip, so that P > 0 and the feedback is negative.
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
    """PI controller with optional lead, C(s) = (kp + ki/s) (lead s + 1)/(lead_filter s + 1).

    - gains: kp in N*m/(m/s), ki in N*m/m.
    - lead: time constant of the lead (lead s + 1), s, >= 0; 0: no lead. A lead adds phase; if it equals the actuator's
      lag, it cancels the lag.
    - lead_filter: time constant of the filter 1/(lead_filter s + 1), s, >= 0, which bounds the gain at high frequency.
      It must be > 0 with a lead, so that C is proper. Without a lead it filters the error.

    InputError: a field of wrong type, a negative or non-finite time constant, or a lead without a filter.
    """

    gains: PIGains
    lead: float = 0.0
    lead_filter: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        number("lead", self.lead, "s", ge=0)
        number("lead filter", self.lead_filter, "s", ge=0)
        if self.lead > 0 and self.lead_filter == 0:
            raise InputError(f"lead filter: 0 s is not allowed with a lead of {self.lead:g} s; give a value > 0 (s)")

    @property
    def structure(self) -> str:
        """Name of the structure, "PI" or "PI-lead"."""
        return "PI-lead" if self.lead > 0 or self.lead_filter > 0 else "PI"

    @property
    def transfer_function(self) -> Rational:
        """Transfer function C(s) in factored form."""
        return pi_transfer_function(self.gains.kp, self.gains.ki) * _first_order(self.lead, self.lead_filter)


def pi_transfer_function(kp: float, ki: float) -> Rational:
    """Return kp + ki/s in factored form; if ki = 0, it is the gain kp without an integrator."""
    if ki == 0:
        return Rational(np.array([]), np.array([]), kp)
    zeros = np.array([]) if kp == 0 else np.array([-ki / kp])
    return Rational(zeros, np.array([0.0]), kp or ki)


def _first_order(lead: float, lag: float) -> Rational:
    """Return the transfer function (lead s + 1)/(lag s + 1)."""
    zeros = np.array([-1 / lead]) if lead > 0 else np.array([])
    poles = np.array([-1 / lag]) if lag > 0 else np.array([])
    return Rational(zeros, poles, (lead or 1.0) / (lag or 1.0))


class _System:
    """Base class of linear systems; a system with a sampling `period`, s, is discrete."""

    period: Any
    transfer_function: Any

    def __post_init__(self) -> None:
        check_fields(self)
        if self.period is not None:
            number("period", self.period, "s", gt=0)
        _ = self.transfer_function

    @property
    def structure(self) -> str:
        system = self.transfer_function
        if system.poles.size == 0 and self.period is None:
            return f"gain {system.gain:g} N*m/(m/s)"
        return f"{'' if self.period is None else 'discrete '}transfer function of order {system.poles.size}"


@dataclass(frozen=True)
class PolynomialController(_System):
    """Transfer function C = num/den as a ratio of polynomials, N*m/(m/s).

    - num, den: coefficients of descending powers of s, or of z for a discrete controller.
    - period: sampling period of a discrete controller, s; None for a continuous one.

    InputError: coefficients that are not finite, a denominator of zero, more zeros than poles, or a period that is not
    > 0.
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
    """State-space controller x' = a x + b e, torque = c x + d e; if discrete, x' is the next x.

    - a, b, c, d: tuples of n rows of n numbers (a) and of n numbers (b, c), and a number (d); e in m/s, torque in N*m.
    - period: sampling period of a discrete controller, s; None for a continuous one.

    InputError: lengths that do not match n, entries that are not finite, or a period that is not > 0.
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
            raise InputError(f"state space: the shapes {shape} of a, b and c do not fit; give n by n, n and n")
        a = np.array(self.a, dtype=float).reshape(order, order)
        return Rational.from_state_space(a, np.array(self.b), np.array(self.c), np.array([self.d]))


def describe_system(design: LinearController) -> str:
    """Describe structure and numbers of a linear controller in one line."""
    if isinstance(design, PIController):
        kp, ki = design.gains.kp, design.gains.ki
        text = f"{design.structure}: kp {kp:.6g} N·m/(m/s), ki {ki:.6g} N·m/m"
        text += f"   ({kp * KMH:.5g} N·m per km/h, {ki * KMH:.5g} N·m per km/h per s)"
        lead = f", lead ({design.lead:g} s + 1)/({design.lead_filter:g} s + 1): a series PID"
        return text + lead * (design.structure != "PI")
    numbers = ((name, value) for name, value in asdict(design).items() if value is not None)
    return f"{design.structure}: " + ", ".join(f"{name} {plain_number(value)}" for name, value in numbers)


def plain_number(value: float | tuple[Any, ...]) -> str:
    """Return a number, or nested tuples of numbers, as text with six significant digits."""
    return f"[{' '.join(map(plain_number, value))}]" if isinstance(value, tuple) else f"{value:.6g}"


LinearController = PIController | PolynomialController | StateSpaceController


@checked
def linear_controller(controller: Any, point: OperatingPoint | None = None) -> LinearController:
    """Convert a linear controller, from slip error e (m/s) to torque (N*m), to a `LinearController`.

    - controller: `PIGains`, `PIController`, python-control TransferFunction or StateSpace, scipy.signal system,
      `Rational`, a real number, or an object with a method `linear(operating_point)` that returns one of these.
    - point: operating point with which the method `linear` is called.

    InputError: any other object, for example a function, or an object that has a method `step` but no `linear`.
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
        nested = hasattr(controller, "ninputs")  # python-control nests the coefficients, SciPy does not
        num, den = (controller.num[0][0], controller.den[0][0]) if nested else (controller.num, controller.den)
        num, den = (tuple(np.atleast_1d(each).astype(float).tolist()) for each in (num, den))
        return PolynomialController(num, den, period)
    parts = realise(system)
    return StateSpaceController(
        tuple(map(tuple, parts.a.tolist())), tuple(parts.b.tolist()), tuple(parts.c.tolist()), float(parts.d), period
    )


def _check_object(controller: Any) -> None:
    if isinstance(controller, str):
        raise InputError(
            f"controller: {shown(controller)} is text; give a controller object, or read the file with load_controller"
        )
    if inspect.isclass(controller):
        raise InputError(f"controller: {controller.__name__} is a class; give an object of it, {controller.__name__}()")


def _linear_kind(controller: Controller, point: OperatingPoint | None) -> LinearController:
    system = controller.linear(point)
    if system is None:
        raise InputError(
            f"controller: {controller.label} has no margins: {controller.no_loop}; use simulate or campaign instead"
        )
    return system  # type: ignore[no-any-return]


def linear_of(controller: Any) -> Any:
    """Return the attribute `linear` of an object, or None; InputError if it is a property that fails."""
    try:
        return controller.linear
    except Exception as error:  # a user's property may fail in any way
        attribute = inspect.getattr_static(controller, "linear", None)
        if attribute is None:
            return None
        message = call_failure(error, getattr(attribute, "fget", attribute), "linear", "")
        raise InputError(f"controller {_name(controller)}: {message}") from error


def _linear_at(point: OperatingPoint | None, linear: Any, name: str) -> LinearController:
    if point is None:
        raise InputError(f"controller {name}: its linear system depends on the operating point; give `point`")
    try:
        system = linear(point)
    except InputError:
        raise
    except Exception as error:  # a user's method may fail in any way
        raise InputError(f"controller {name}: {call_failure(error, linear, 'linear', 'operating_point')}") from error
    if isinstance(system, _System) or not hasattr(system, "linear"):
        try:
            return linear_controller(system)
        except InputError as error:
            raise InputError(f"controller {name}: {place_of(linear)}linear() has an invalid result: {error}") from None
    raise InputError(
        f"controller {name}: {place_of(linear)}linear returns {_name(system)}, which is not a linear system; return a "
        "python-control system"
    )


def is_function(thing: Any) -> bool:
    """Return True for a function, a method, or a function compiled by Numba."""
    return inspect.isroutine(thing) or isinstance(thing, functools.partial) or hasattr(thing, "py_func")


def is_system(controller: Any) -> bool:
    """Return True for a linear system; python-control and SciPy systems are recognized by their inputs and `dt`."""
    has_inputs = hasattr(controller, "ninputs") or hasattr(controller, "inputs")
    return (has_inputs and hasattr(controller, "dt")) or isinstance(controller, Rational | PIController)


def has_step(controller: Any) -> bool:
    """Return True for a function, and for an object with a method `step` that is not a linear system."""
    if isinstance(controller, Controller):
        return False
    # the method `step` of a linear system of scipy.signal computes the step response
    return is_function(controller) or (hasattr(controller, "step") and not is_system(controller))


def step_alone(controller: Any) -> InputError:
    """Return the InputError for a user's controller without a method `linear`, whose margins cannot be computed."""
    where = place_of(getattr(controller, "step", controller))
    remedy = "give an object with step and with" if is_function(controller) else "add"
    return InputError(
        f"controller: {where}{_name(controller)} has no margins, because its linear system is not known; {remedy} a "
        "method linear(operating_point) that returns a python-control system"
    )


def _name(thing: Any) -> str:
    return getattr(thing, "__name__", type(thing).__name__)


@checked
def controller_system(controller: Any, point: OperatingPoint | None = None) -> Rational:
    """Return the transfer function C(s), N*m/(m/s), of a continuous linear controller at an operating point.

    Arguments and errors are those of `linear_controller`. A discrete controller also raises InputError.
    """
    if isinstance(controller, Rational):
        return controller
    design = linear_controller(controller, point)
    if not isinstance(design, PIController) and design.period is not None:
        raise InputError(
            f"controller: a discrete-time system (dt = {design.period:g}) has no transfer function in s; use "
            "wheel_slip_loop for its margins"
        )
    return design.transfer_function


def polynomials(controller: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return numerator and denominator of a continuous linear controller, in descending powers of s."""
    num, den = (polynomial.coeffs()[::-1] for polynomial in controller_system(controller).polynomials)
    return tuple(map(float, num)), tuple(map(float, den))


@checked
def actuated_plant(plant: LinearPlant, actuator: Actuator) -> Rational:
    """Return the transfer function, (m/s)/(N*m), of brake lag and wheel in series, without the dead time.

    Its input is the commanded torque, its output -e, the negative slip error. `plant` is the linear wheel. Only
    the lag, s, of the `actuator` is used.
    """
    if plant.speed_state:
        wheel = Rational.from_state_space(plant.A, plant.B, -plant.C[plant.outputs.index("error")], 0.0)
    else:
        wheel = Rational(plant.zeros, plant.poles, plant.gain)  # with constant v, -e is sigma
    return _first_order(0.0, actuator.lag) * wheel


@checked
def wheel_slip_loop(plant: LinearPlant | OperatingPoint, controller: Any, actuator: Actuator | None = None) -> Any:
    """Return the loop L(s) = C(s) Ga(s) P(s) with exact dead time; for a discrete controller the exact sampled loop.

    - plant: the wheel P, from acting torque (N*m) to -e (m/s), as an operating point or its linear plant.
    - controller: C, from slip error e = lambda_d v - sigma (m/s) to commanded torque (N*m); an object that
      `linear_controller` accepts, or a `Controller` that computes its loop itself (method `loop`).
    - actuator: the brake Ga with dead time and lag, s; by default that of the operating point's vehicle.

    Returns the dimensionless loop for unity negative feedback: the result of the controller's method `loop` if this
    computes one; otherwise a `SampledLoop` for a discrete and a `DeadTimeLoop` for a continuous controller. InputError:
    an argument of wrong type, or a controller without a transfer function.
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
