"""Controllers of a user's own that are known by their step: a Python object or a function, or the same for Numba.

The kernel calls the step where it is, once a sample, with time (s), measured train speed (m/s) and wheel speed (rad/s);
it returns the torque to command until the next, N*m. Nothing of the user's is compiled into the kernel.
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

ADDRESS = 1  #: place of the step's address in a controller's row


class UserStep:
    """A user's `thing`: an object with `step(t, v, omega)`, or a function, of Python or Numba's."""

    def __init__(self, thing: Any) -> None:
        self.thing = thing
        if not callable(self.function):
            raise InputError(
                f"controller: {type(thing).__name__} has no step(t, v, omega); give a linear system, or an object or "
                "a function that returns a torque"
            )

    @property
    def function(self) -> Any:
        """The step itself."""
        return self.thing if is_function(self.thing) else getattr(self.thing, "step", None)

    @property
    def is_numba(self) -> bool:
        """Whether it is compiled, and may run without the interpreter."""
        return hasattr(self.function, "py_func")

    def __reduce__(self) -> tuple[Any, ...]:
        from numba import cloudpickle

        module = sys.modules.get(type(self.thing).__module__)
        if module is not None and not getattr(module, "__spec__", None):  # of a file that no worker can import
            cloudpickle.register_pickle_by_value(module)
        return _unpacked, (cloudpickle.dumps(self.thing),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, UserStep) and self.thing is other.thing

    def __hash__(self) -> int:
        return id(self.thing)

    @property
    def fingerprint(self) -> str:
        """A hash of its source and what it holds."""
        of = getattr(self.thing, "py_func", self.thing)
        try:
            source = inspect.getsource(of if inspect.isfunction(of) else type(of))
        except (OSError, TypeError):  # typed at a prompt
            source = repr(of)
        held = sorted((name, repr(value)) for name, value in getattr(self.thing, "__dict__", {}).items())
        kept = [] if self.is_numba else held
        return hashlib.sha256(repr((source, kept)).encode()).hexdigest()


def _unpacked(content: bytes) -> UserStep:
    from numba import cloudpickle

    return UserStep(cloudpickle.loads(content))


class StepControl(Controller):
    """A controller known by its step.

    - thing: an object with `step(t, v, omega) -> torque` and, if it remembers, `reset(t, v, omega)`, called once before
      the first sample; or such a function, of Python's or Numba's. A run has its own copy of an object that can be
      copied. SI.
    - start_numbers: what a function remembers, at the start, 1-D, in units of its own: with them it is step(t, v,
      omega, x), where x is an array of them that it changes.

    Its `reference` only judges the slip: the step has its own. InputError: a step that cannot be called.
    """

    kind: ClassVar[str] = "step"
    title: ClassVar[str] = "a step of the user's"
    source: ClassVar[str] = "the user"
    no_loop: ClassVar[str] = "it is known by its step alone"
    follows_reference: ClassVar[bool] = False

    period: float | None = quantity("s", "sampling period; every step if None", ge=LEAST_PERIOD, default=PERIOD)
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
        """What the object says of itself at an operating point; InputError where it says nothing, or no system."""
        return linear_controller(self.thing.thing, point)

    @property
    def whole_step(self) -> Callable[[Any, Any, Any], float]:
        raise InputError(f"controller {self.label}: it is known by a Python step alone; give a kind of controller")

    def source_text(self) -> str:
        return f"""
from railslip_ctrl.controllers.step_calls import call_step


@compiled
def command({", ".join(ARGUMENTS)}):
    return call_step(_c[{ADDRESS}], _t, _v, _omega, _x)
"""

    def row(self, situation: Situation, state: Any) -> tuple[float, ...]:
        held = math.nan if self.reference is None else self.reference.on(situation.rail)
        return (held, math.nan)  # room for the address, which each run has its own of

    def described(self) -> str:
        return self.label

    def opened(self, v: float, omega: float) -> PythonCall | NumbaCall:
        """The step made ready for one run, which begins at train speed `v`, m/s, and wheel speed `omega`, rad/s."""
        return NumbaCall(self) if self.thing.is_numba else PythonCall(self, v, omega)

    def refused(self, torque: Any, t: float) -> InputError:
        """Of what is no torque, at time t, s."""
        return InputError(
            f"controller {self.label}: {place_of(self.thing.function)}step gives {shown(torque)} at t = {t:g} s; give "
            "a finite torque (N*m)"
        )

    def failed(self, error: BaseException, t: float, what: str = "step") -> InputError:
        """Of an error in the step, or in another method, at time t, s."""
        function = self.thing.function if what == "step" else getattr(self.thing.thing, what)
        told = call_failure(error, function, what, "t, v, omega" + ", x" * bool(self.start_numbers), f" at t = {t:g} s")
        return InputError(f"controller {self.label}: {told}")


class PythonCall:
    """A step called back in the interpreter, once a sample, at its `address`."""

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
            except BaseException as error:  # noqa: BLE001  # told when the kernel is left: none passes through it
                self._error = error, t
                return nan

        self._kept = STEP(called)
        self.address = address_of(self._kept)

    def _reset(self, v: float, omega: float) -> Callable[..., Any]:
        step = self._control.thing
        if is_function(step.thing):
            return step.function  # type: ignore[no-any-return]
        try:
            thing = copy.deepcopy(step.thing)
        except Exception as error:  # the user's object may fail in any way
            if not hasattr(step.thing, "reset"):
                told = " ".join(str(error).split())
                raise InputError(
                    f"controller {self._control.label}: it has no reset and cannot be copied for a run ({told}); give "
                    "it reset(t, v, omega)"
                ) from error
            thing = step.thing
        if hasattr(thing, "reset"):
            try:
                thing.reset(0.0, v, omega)
            except Exception as error:  # as above
                raise self._control.failed(error, 0.0, "reset") from error
        return thing.step  # type: ignore[no-any-return]

    def check(self, t: float, v: float, omega: float, x: Floats, *, ended: bool) -> None:
        """Raise what went wrong in it by time t, s."""
        if self._error is not None:
            error, at = self._error
            if not isinstance(error, Exception):  # an interruption
                raise error
            raise self._control.failed(error, at) from error
        if self._torque is not None:
            raise self._control.refused(*self._torque)


class NumbaCall:
    """A step compiled by Numba, called without the interpreter at its `address`."""

    def __init__(self, control: StepControl) -> None:
        self._control, self._count = control, len(control.start_numbers)
        self._kept = _compiled(control.thing.function, self._count, control.label)
        self.address = int(self._kept.address)

    def check(self, t: float, v: float, omega: float, x: Floats, *, ended: bool) -> None:
        """Raise why the run `ended` at time t, s, for want of a number: says the function, run in the interpreter."""
        if not ended:
            return
        numbers = (x,) if self._count else ()
        try:
            torque = self._control.thing.function.py_func(t, v, omega, *numbers)
        except Exception as error:  # the user's
            raise self._control.failed(error, t) from error
        if not (isinstance(torque, Real) and math.isfinite(torque)):
            raise self._control.refused(torque, t)


_COMPILED: dict[tuple[int, int], tuple[Any, Any]] = {}


def _compiled(function: Any, count: int, name: str) -> Any:
    """The function as a C function, once a process."""
    from numba import carray, cfunc, types
    from numba.core.errors import NumbaError

    found = _COMPILED.get((id(function), count))
    if found is not None:
        return found[1]
    nan = math.nan

    def without(t, v, omega, x):  # type: ignore[no-untyped-def]
        try:
            return float(function(t, v, omega))
        except Exception:  # noqa: BLE001  # as Numba knows it
            return nan

    def remembering(t, v, omega, x):  # type: ignore[no-untyped-def]
        try:
            return float(function(t, v, omega, carray(x, (count,))))
        except Exception:  # noqa: BLE001  # as above
            return nan

    number = types.float64
    signature = number(number, number, number, types.CPointer(number))
    try:
        made = cfunc(signature)(remembering if count else without)
    except (NumbaError, ValueError, TypeError) as error:  # the latter of what is no number
        raise InputError(f"controller {name}: {_compile_failure(function, error)}") from None
    _COMPILED[id(function), count] = function, made
    return made


def _compile_failure(function: Any, error: BaseException) -> str:
    """File and line of the user's code that Numba stopped at, and its reason in a line."""
    reason = numba_reason(error)
    missing = re.match(r"NameError: name '(\w+)'", reason)
    code = function.py_func.__code__
    where = (_use_of(missing[1], function) if missing else None) or _stopped_at(str(error))
    where = where or (code.co_filename, code.co_firstlineno)
    return f"{place(*where)}: Numba cannot compile step: {reason}"


def numba_reason(error: BaseException) -> str:
    """Why Numba cannot compile something, in a line."""
    told = [line.strip() for line in str(error).splitlines()]
    told = [line for line in told if line and not line.startswith(("Failed", "-", "File", "During"))]
    reason = next(iter(told), "")
    if reason.endswith(":"):  # of a call, which the next line shows
        reason += " " + " ".join(told[1:2]).removeprefix(">>> ")
    return " ".join(reason.split())[:200]


def _stopped_at(text: str) -> tuple[str, int] | None:
    """File and line of the user's that Numba's message tells first, which is the innermost; its paths are relative."""
    not_own = (__file__, *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")))
    found = ((os.path.abspath(file), int(line)) for file, line in re.findall(r'File "([^"]+)", line (\d+)', text))
    return next((one for one in found if not one[0].startswith(not_own)), None)


def _use_of(name: str, function: Any, seen: tuple[Any, ...] = ()) -> tuple[str, int] | None:
    """File and line where a Numba function, or one that it calls, uses a global `name`: of one that is not there
    Numba tells the name alone."""
    of = function.py_func
    for one in dis.get_instructions(of):
        if one.opname == "LOAD_GLOBAL" and one.argval == name and one.positions is not None:
            return of.__code__.co_filename, one.positions.lineno or of.__code__.co_firstlineno
    bound = inspect.getclosurevars(of)
    called = [one for one in (*bound.globals.values(), *bound.nonlocals.values()) if hasattr(one, "py_func")]
    inside = (_use_of(name, one, (*seen, function)) for one in called if one not in seen)
    return next((found for found in inside if found is not None), None)


def _numbers_at(address: int, count: int) -> Floats:
    import ctypes

    return np.ctypeslib.as_array((ctypes.c_double * count).from_address(address))
