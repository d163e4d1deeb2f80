"""Controllers whose control law (step) is a user's object or function, in Python or compiled by Numba.

The compiled simulation calls the step by its memory address, once a sample. The same compiled simulation is therefore
used for all steps.
"""

from __future__ import annotations

import copy
import dis
import hashlib
import inspect
import math
import os
import re
import sys
import sysconfig
from collections.abc import Callable
from numbers import Real
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from pydantic import field_validator

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import quantity, shown
from railslip_ctrl.core.user_files import call_failure, place, place_of
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.linearization import OperatingPoint

from .base import LEAST_PERIOD, PERIOD, Controller, Situation
from .systems import is_function, linear_controller
from .translate import ARGUMENTS

ADDRESS = 1  #: index of the step's address among the controller's numbers in a kernel


class UserStep:
    """A user's control law: a Python or Numba function, or an object with a method `step(t, v, omega)`."""

    def __init__(self, thing: Any) -> None:
        self.thing = thing
        if not callable(self.function):
            raise InputError(
                f"controller: {type(thing).__name__} has no step(t, v, omega); give a linear system, or an object or "
                "a function that returns a torque"
            )

    @property
    def function(self) -> Any:
        return self.thing if is_function(self.thing) else getattr(self.thing, "step", None)

    @property
    def is_numba(self) -> bool:
        return hasattr(self.function, "py_func")

    def __reduce__(self) -> tuple[Any, ...]:
        from numba import cloudpickle

        module = sys.modules.get(type(self.thing).__module__)
        if module is not None and not getattr(
            module, "__spec__", None
        ):  # a module loaded from a file, which other processes cannot import
            cloudpickle.register_pickle_by_value(module)
        return _unpacked, (cloudpickle.dumps(self.thing),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, UserStep) and self.thing is other.thing

    def __hash__(self) -> int:
        return id(self.thing)

    @property
    def fingerprint(self) -> str:
        of = getattr(self.thing, "py_func", self.thing)
        try:
            source = inspect.getsource(of if inspect.isfunction(of) else type(of))
        except (OSError, TypeError):  # defined at a prompt, without a source file
            source = repr(of)
        attributes = sorted((name, repr(value)) for name, value in getattr(self.thing, "__dict__", {}).items())
        return hashlib.sha256(repr((source, [] if self.is_numba else attributes)).encode()).hexdigest()


def _unpacked(content: bytes) -> UserStep:
    from numba import cloudpickle

    return UserStep(cloudpickle.loads(content))


class StepControl(Controller):
    """Controller whose control law is a user's Python object or function.

    - thing: a function step(t, v, omega), in Python or compiled by Numba, or an object with the method `step(t, v,
      omega)`. t is the time, s, v the train speed, m/s, omega the wheel speed, rad/s; the result is the torque, N*m.
      Each run copies the object and, before the first sample, calls the object's method `reset(t, v, omega)` if it has
      one. An object that cannot be copied needs `reset`.
    - start_numbers: initial values, 1-D, in any units, of the state array x of a function step(t, v, omega, x), which
      updates x.

    `reference` is used only to judge the slip. InputError if `thing` has no step that can be called.
    """

    kind: ClassVar[str] = "step"
    title: ClassVar[str] = "user's step"
    source: ClassVar[str] = "the user"
    no_loop: ClassVar[str] = "only its step is known"
    follows_reference: ClassVar[bool] = False

    period: float | None = quantity("s", "sampling period; integration step if None", ge=LEAST_PERIOD, default=PERIOD)
    reference: ReferenceSlip | None = None
    thing: Any = None
    start_numbers: tuple[float, ...] = ()

    @field_validator("thing", mode="before")
    @classmethod
    def _as_step(cls, thing: Any) -> UserStep:
        return thing if isinstance(thing, UserStep) else UserStep(thing)

    @classmethod
    def state_fields(cls) -> dict[str, Any]:
        return {"numbers": tuple[float, ...]}

    def start(self, speed: float, period: float) -> Any:
        return SimpleNamespace(numbers=self.start_numbers)

    def logged(self, state: Any) -> dict[str, int]:
        return {f"x{i + 1}": i for i in range(len(self.start_numbers))}

    def linear(self, point: OperatingPoint | None) -> Any:
        return linear_controller(self.thing.thing, point)

    @property
    def whole_step(self) -> Callable[[Any, Any, Any], float]:
        raise InputError(
            f"controller {self.label}: a controller given as a Python object or function cannot be exported; "
            "write a class derived from Controller"
        )

    def source_text(self) -> str:
        return f"""
from railslip_ctrl.controllers.step_calls import call_step


@compiled
def command({", ".join(ARGUMENTS)}):
    return call_step(_c[{ADDRESS}], _t, _v, _omega, _x)
"""

    def row(self, situation: Situation, state: Any) -> tuple[float, ...]:
        slip = math.nan if self.reference is None else self.reference.on(situation.rail)
        return (slip, math.nan)  # each run replaces NaN by the address of its step

    def described(self) -> str:
        return self.label

    def opened(self, v: float, omega: float) -> PythonCall | NumbaCall:
        """Prepare the step for one run, which begins at train speed `v`, m/s, and wheel speed `omega`, rad/s."""
        return NumbaCall(self) if self.thing.is_numba else PythonCall(self, v, omega)

    def refused(self, torque: Any, t: float) -> InputError:
        """Return the InputError for an invalid `torque` (N*m) that the step returned at time t, s."""
        return InputError(
            f"controller {self.label}: {place_of(self.thing.function)}step gives {shown(torque)} at t = {t:g} s; "
            "return a finite torque (N*m)"
        )

    def failed(self, error: BaseException, t: float, what: str = "step") -> InputError:
        """Return the InputError for an `error` that the user's method `what` raised at time t, s."""
        function = self.thing.function if what == "step" else getattr(self.thing.thing, what)
        arguments = "t, v, omega" + ", x" * bool(self.start_numbers)
        message = call_failure(error, function, what, arguments, f" at t = {t:g} s")
        return InputError(f"controller {self.label}: {message}")


class PythonCall:
    """Python step wrapped as a C function, which the simulation calls by its `address`."""

    def __init__(self, control: StepControl, v: float, omega: float) -> None:
        from .step_calls import STEP, address_of

        self._control = control
        self._error: tuple[BaseException, float] | None = None
        self._torque: tuple[Any, float] | None = None
        step = self._reset(v, omega)
        finite, nan, count = math.isfinite, math.nan, len(control.start_numbers)

        def called(t: float, v: float, omega: float, x: int) -> float:
            try:
                torque = step(t, v, omega) if not count else step(t, v, omega, _numbers_at(x, count))
                if torque.__class__ is float and finite(torque):
                    return torque
                if not isinstance(torque, Real) or isinstance(torque, bool) or not finite(torque):
                    self._torque = torque, t
                    return nan
                return float(torque)
            except BaseException as error:  # noqa: BLE001  # none may pass through the kernel; `check` raises it
                self._error = error, t
                return nan

        self._callback = STEP(called)
        self.address = address_of(self._callback)

    def _reset(self, v: float, omega: float) -> Callable[..., Any]:
        step = self._control.thing
        if is_function(step.thing):
            return step.function  # type: ignore[no-any-return]
        try:
            thing = copy.deepcopy(step.thing)
        except Exception as error:  # the user's object may fail in any way
            if not hasattr(step.thing, "reset"):
                reason = " ".join(str(error).split())
                raise InputError(
                    f"controller {self._control.label}: the object cannot be copied for a run ({reason}) and has "
                    "no method reset(t, v, omega); add this method"
                ) from error
            thing = step.thing
        if hasattr(thing, "reset"):
            try:
                thing.reset(0.0, v, omega)
            except Exception as error:  # the user's object may fail in any way
                raise self._control.failed(error, 0.0, "reset") from error
        return thing.step  # type: ignore[no-any-return]

    def check(self, t: float, v: float, omega: float, x: Floats, *, ended: bool) -> None:
        """Raise InputError if the step failed or returned an invalid torque."""
        if self._error is not None:
            error, at = self._error
            if not isinstance(error, Exception):  # KeyboardInterrupt and the like
                raise error
            raise self._control.failed(error, at) from error
        if self._torque is not None:
            raise self._control.refused(*self._torque)


class NumbaCall:
    """Step compiled by Numba to a C function, which the simulation calls by its `address`."""

    def __init__(self, control: StepControl) -> None:
        self._control, self._count = control, len(control.start_numbers)
        self._compiled = _compiled(control.thing.function, self._count, control.label)
        self.address = int(self._compiled.address)

    def check(self, t: float, v: float, omega: float, x: Floats, *, ended: bool) -> None:
        """Raise InputError if the run `ended` because the step returned an invalid torque."""
        if not ended:
            return
        numbers = (x,) if self._count else ()
        try:
            torque = self._control.thing.function.py_func(t, v, omega, *numbers)  # again, to find the error
        except Exception as error:  # the user's function may fail in any way
            raise self._control.failed(error, t) from error
        if not (isinstance(torque, Real) and math.isfinite(torque)):
            raise self._control.refused(torque, t)


_COMPILED: dict[tuple[int, int], tuple[Any, Any]] = {}  # each process compiles a function only once


def _compiled(function: Any, count: int, name: str) -> Any:
    from numba import carray, cfunc, types
    from numba.core.errors import NumbaError

    compiled = _COMPILED.get((id(function), count))
    if compiled is not None:
        return compiled[1]
    nan = math.nan

    def without_state(t, v, omega, x):  # type: ignore[no-untyped-def]
        try:
            return float(function(t, v, omega))
        except Exception:  # noqa: BLE001  # Numba supports only this class of exceptions
            return nan

    def with_state(t, v, omega, x):  # type: ignore[no-untyped-def]
        try:
            return float(function(t, v, omega, carray(x, (count,))))
        except Exception:  # noqa: BLE001  # Numba supports only this class of exceptions
            return nan

    number = types.float64
    signature = number(number, number, number, types.CPointer(number))
    try:
        c_function = cfunc(signature)(with_state if count else without_state)
    except (NumbaError, ValueError, TypeError) as error:  # TypeError if the result is not a number
        raise InputError(f"controller {name}: {_compile_failure(function, error)}") from None
    _COMPILED[id(function), count] = function, c_function
    return c_function


def _compile_failure(function: Any, error: BaseException) -> str:
    reason = numba_reason(error)
    missing = re.match(r"NameError: name '(\w+)'", reason)
    code = function.py_func.__code__
    # Numba's message for a missing global names no line
    where = (_use_of(missing[1], function) if missing else None) or _stopped_at(str(error))
    where = where or (code.co_filename, code.co_firstlineno)
    return f"{place(*where)}: Numba cannot compile step: {reason}"


def numba_reason(error: BaseException) -> str:
    """Return the reason that a Numba error message states, in one line."""
    lines = [line.strip() for line in str(error).splitlines()]
    lines = [line for line in lines if line and not line.startswith(("Failed", "-", "File", "During"))]
    reason = next(iter(lines), "")
    if reason.endswith(":"):  # the next line shows the call
        reason += " " + " ".join(lines[1:2]).removeprefix(">>> ")
    return " ".join(reason.split())[:200]


def _stopped_at(text: str) -> tuple[str, int] | None:
    libraries = (__file__, *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")))
    lines = ((os.path.abspath(file), int(line)) for file, line in re.findall(r'File "([^"]+)", line (\d+)', text))
    # Numba names the innermost call first
    return next((line for line in lines if not line[0].startswith(libraries)), None)


def _use_of(name: str, function: Any, seen: tuple[Any, ...] = ()) -> tuple[str, int] | None:
    of = function.py_func
    for instruction in dis.get_instructions(of):
        if instruction.opname == "LOAD_GLOBAL" and instruction.argval == name and instruction.positions is not None:
            return of.__code__.co_filename, instruction.positions.lineno or of.__code__.co_firstlineno
    bound = inspect.getclosurevars(of)
    called = [value for value in (*bound.globals.values(), *bound.nonlocals.values()) if hasattr(value, "py_func")]
    inside = (_use_of(name, other, (*seen, function)) for other in called if other not in seen)
    return next((use for use in inside if use is not None), None)


def _numbers_at(address: int, count: int) -> Floats:
    import ctypes

    return np.ctypeslib.as_array((ctypes.c_double * count).from_address(address))
