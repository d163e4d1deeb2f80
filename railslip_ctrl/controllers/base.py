"""Base class of all controller kinds: a record of parameters, a state, and a step in named fields.

A kind is one class in one file of this package or of the user's. Everything else follows from the class: its TOML file,
its options, the kernel of a braking run, its C99 program, its label in reports, its verdict over an envelope.
"""

from __future__ import annotations

import inspect
import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, get_origin, get_type_hints

from pydantic import Field, model_validator

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import quantity
from railslip_ctrl.core.user_files import file_name, given_path, validated
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.adhesion.bristle import REFERENCE
from railslip_ctrl.model.vehicle import Rail, Record, Vehicle

from .translate import Layout, kernel_text, outside, read_step, with_functions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from railslip_ctrl.model.linearization import OperatingPoint
    from railslip_ctrl.model.vehicle import Actuator

__all__ = ["LEAST_PERIOD", "PERIOD", "Controller", "DesignNumber", "Measurement", "Situation", "outside"]

PERIOD = 0.01
"""Default sampling period, s: that of common brake control units."""

LEAST_PERIOD = 1e-5
"""Shortest sampling period, s; a shorter one fills memory and gains no accuracy."""

_FIRST = 1  # index of the first parameter in a kernel's row, which begins with the reference slip ratio


class Measurement(NamedTuple):
    """Measurements of one sample: time (s), train speed (m/s), wheel speed (rad/s), and `applied_torque` (N*m).

    `applied_torque` is the command that the brake took since the sample before.
    """

    time: float
    train_speed: float
    wheel_speed: float
    applied_torque: float


@dataclass(frozen=True)
class Situation:
    """Conditions of a step: the `rail`, the sampling `period` (s), and the `assumed` adhesion law.

    The law is None outside a run for a controller without its own law.
    """

    rail: Rail
    period: float
    assumed: AdhesionLaw | None


_BELIEFS: Mapping[str, Callable[[Vehicle], float]] = MappingProxyType(
    {
        "radius": lambda vehicle: vehicle.wheel.radius,
        "wheel_inertia": lambda vehicle: vehicle.effective_inertia,
        "viscous_friction": lambda vehicle: vehicle.effective_viscous_friction,
        "wheel_load": lambda vehicle: vehicle.wheel_load,
        "dead_time": lambda vehicle: vehicle.actuator.dead_time,
        "lag": lambda vehicle: vehicle.actuator.lag,
        "inertia_scale": lambda vehicle: vehicle.inertia_scale,
        "nominal_mass": lambda vehicle: vehicle.mass,
        "nominal_viscous_friction": lambda vehicle: vehicle.wheel.viscous_friction,
    }
)
"""Fields that state what a controller believes about its vehicle; a field left out takes the vehicle's value."""


_GIVEN = {*_BELIEFS, "period", "tracking_time", "torque_min", "torque_max"} | {
    *("initial_torque", "hand_over_torque", "hand_over_speed")
}
"""Numbers that are not design numbers: beliefs, limits, start and hand-over."""


class DesignNumber(NamedTuple):
    """A number that a user tunes: its name, value, unit, meaning, and upper bound."""

    name: str
    value: float
    unit: str
    meaning: str
    most: float = math.inf


class Controller(Record):
    """Base of the controller kinds.

    A kind defines `kind`, `title`, `source`, its parameters (fields made by `quantity`), `step`, a static method, and,
    if it has a memory, `State` (a record of its state with the values at the start). If `step` needs other numbers than
    the fields, the kind also defines `Parameters` (a record of them) and `parameters`.
    """

    kind: ClassVar[str]
    """Name in files, on the command line and in tables."""
    title: ClassVar[str]
    """Description in one line."""
    source: ClassVar[str]
    """Source of the control law."""
    Parameters: ClassVar[type[Record] | None] = None
    no_loop: ClassVar[str] = "it is not linear"
    """Reason why it has no linear loop, if it has none."""
    follows_reference: ClassVar[bool] = True
    """Whether it holds the reference slip; otherwise it has its own slip."""
    by_rule: ClassVar[bool] = False
    """Whether `for_vehicle` needs the vehicle alone; its name is then a choice of `--controller`."""
    finds_slip: ClassVar[bool] = False
    """Whether it finds the slip to hold by itself; see `held_slip`."""

    class State(Record):
        """State of a controller without memory."""

    name: str = Field("", description="its name in reports; the kind's if left out")
    period: float | None = quantity(
        "s", "sampling period; every step of the run if left out", ge=LEAST_PERIOD, default=None
    )
    reference: ReferenceSlip | None = Field(REFERENCE, description="slip ratio to be held")

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        if not self.least_torque < self.largest_torque:
            least, most = self.least_torque, self.largest_torque
            raise InputError(f"torque_max: {most:g} is not allowed; give a value > torque_min = {least:g} (N*m)")
        return self

    # --- the algorithm ---

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> float:
        """Compute the torque to command until the next sample, N*m, and update `state`.

        - state: has the fields of `State`.
        - measurement: has the fields of `Measurement`.
        - parameters: has the fields of `Parameters`, or of the controller, and `period` (s), `reference_slip` (ratio).
        """
        raise NotImplementedError

    @classmethod
    def state_fields(cls) -> dict[str, Any]:
        """Names and types of the fields of the state, numbers before lists of numbers."""
        return _hints(cls.State)

    @classmethod
    def parameter_fields(cls) -> dict[str, Any]:
        """Names and types of the numbers that `step` reads."""
        return {
            name: hint for name, hint in _hints(cls.Parameters or cls).items() if _is_number(hint) and name != "period"
        }

    def start(self, speed: float, period: float) -> Any:
        """State when the brake is applied at a train speed, m/s; `period` is the sampling period, s."""
        return self.State()

    def parameters(self, situation: Situation) -> Mapping[str, Any]:
        """Numbers that `step` reads in a `situation`, by name, SI; without `period` and `reference_slip`."""
        return {name: getattr(self, name) for name in self.parameter_fields()}

    # --- description ---

    @property
    def label(self) -> str:
        """Name in reports."""
        return self.name or self.kind

    def described(self) -> str:
        """Label and parameters in one line."""
        parameters = (
            f"{name.replace('_', ' ')} {getattr(self, name):.6g}{'' if unit == '1' else f' {unit}'}"
            for name, unit in self.units().items()
            if isinstance(getattr(self, name), float) and name not in ("period", "torque_min", "torque_max")
        )
        return ", ".join([self.label, *parameters])

    def limits_described(self) -> str:
        """Its torque limits, initial torque and anti-windup in one line."""
        return f"torque {torque_range(self.least_torque, self.largest_torque)}"

    def gain_values(self) -> dict[str, Any]:
        """Parameters for JSON; a name has the suffix "_si" of its unit, if it has a unit."""
        return {
            name if unit == "1" else f"{name}_si": getattr(self, name)
            for name, unit in self.units().items()
            if isinstance(getattr(self, name), float | tuple) and name != "period"
        }

    @property
    def least_torque(self) -> float:
        """Lower limit of the command, N*m; -inf without a limit."""
        least = getattr(self, "torque_min", None)
        return -math.inf if least is None else float(least)

    @property
    def largest_torque(self) -> float:
        """Upper limit of the command, N*m; inf without a limit."""
        most = getattr(self, "torque_max", None)
        return math.inf if most is None else float(most)

    @property
    def controlled_from(self) -> float:
        """Train speed, m/s, below which it holds a torque instead of controlling slip; 0 if it always controls slip."""
        return float(getattr(self, "hand_over_speed", 0.0))

    def headline(self) -> str:
        """Name with the most important numbers, for the first page of a report."""
        return self.title

    def handed_over(self) -> str:
        """Description of the torque that it holds below `controlled_from`."""
        return f"{getattr(self, 'hand_over_torque', 0.0):.4g} N·m"

    # --- design ---

    def design_numbers(self) -> list[DesignNumber]:
        """Numbers that a user tunes: gains first, then those of its own kind, then inherited ones.

        Beliefs about the vehicle, limits, start and hand-over are left out.
        """
        inherited = {name for base in type(self).__mro__[1:] for name in getattr(base, "model_fields", ())}
        shaped = [n for n in self.units() if n not in _GIVEN and isinstance(getattr(self, n), float)]
        found = []
        for name in sorted(shaped, key=lambda name: 0 if name in ("kp", "ki") else 1 + (name in inherited)):
            field = type(self).model_fields[name]
            bounds = [getattr(mark, end) for mark in field.metadata for end in ("lt", "le") if hasattr(mark, end)]
            most = float(min(bounds, default=math.inf))
            found.append(DesignNumber(name, getattr(self, name), self.units()[name], field.description or name, most))
        return found

    def with_design_numbers(self, values: Mapping[str, float], **others: Any) -> Self:
        """Copy of the controller with some design numbers changed.

        - values: by name, in the units of `design_numbers`.
        - others: other fields.

        InputError as for a new controller.
        """
        try:
            return type(self)(**{**dict(self), **values, **others})
        except InputError as error:
            raise InputError(str(error).removeprefix(f"{type(self).__name__}: ")) from None

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Make the controller for a vehicle by the rule of its kind; `given` parameters replace those of the rule.

        InfeasibleDesignError, with the reason, if the rule has no controller for the vehicle.
        """
        return cls(**given).believing(vehicle)

    def believing(self, vehicle: Vehicle, before: Vehicle | None = None) -> Self:
        """Copy in which the beliefs that are not set, or are those of a vehicle `before`, are those of a vehicle."""
        changed = {}
        for name in _BELIEFS.keys() & type(self).model_fields.keys():
            now, was = _BELIEFS[name](vehicle), None if before is None else _BELIEFS[name](before)
            if getattr(self, name) in (None, was) and now != was:
                changed[name] = now
        return self.model_copy(update=changed) if changed else self

    def linear(self, point: OperatingPoint | None) -> Any:
        """Linear system from slip error (m/s) to torque (N*m) at an operating point, or None."""
        return None

    def loop(self, point: OperatingPoint, actuator: Actuator) -> Any:
        """Exact loop at an operating point with an `actuator`; None if `linear` gives the loop."""
        return None

    def held_slip(self, law: AdhesionLaw, speed: float, wheel_load: float) -> float | None:
        """Slip ratio that it finds under an adhesion `law`, at a train `speed`, m/s, and a `wheel_load`, N.

        None if it holds its reference.
        """
        return None

    def slip_numbers(self) -> tuple[Any, ...]:
        """All of its own that `held_slip` and `speeds_to_judge` depend on."""
        return (self.model_dump_json(),)

    def speeds_to_judge(self) -> tuple[float, ...]:
        """Train speeds, m/s, at which its loop changes; they are judged in addition to those of an envelope."""
        return ()

    def stable_and_ms(
        self, points: Sequence[OperatingPoint], brakes: Sequence[Actuator], case: tuple[Any, Any]
    ) -> tuple[Any, Any] | None:
        """Stability and Ms of each case's sampled loop, Ms inf if unstable; None if `linear` gives the loop.

        - case: indices in `points` and in `brakes`, (n,) each.
        """
        return None

    def loop_as_run(self, point: OperatingPoint, actuator: Actuator) -> Any:
        """Sampled loop at an operating point with an `actuator`; None if `linear` gives the loop."""
        return None

    # --- functions and numbers outside the step ---

    def assuming(self, law: AdhesionLaw) -> Self:
        """Copy that assumes an adhesion law, if it needs one and has none."""
        return self

    @classmethod
    def outside_functions(cls, model: type[AdhesionLaw] | None) -> Mapping[str, Callable[..., Any]]:
        """Functions that the step calls as `outside`, by name.

        With a `model`, functions of this adhesion law are included; `outside_text` has the others.
        """
        return {}

    def outside_numbers(self, situation: Situation) -> Mapping[str, Any]:
        """Parameters in a `situation` that only functions of the assumed adhesion law read."""
        return {}

    @property
    def whole_step(self) -> Callable[[Any, Any, Any], float]:
        """Step with all its functions, as Python runs it and as the C program has it."""
        model = None if self.model_law is None else type(self.model_law)
        return with_functions(type(self).step, self.outside_functions(model))

    @classmethod
    def described_in(cls) -> tuple[type, ...]:
        """Classes whose fields have meaning, unit and bounds of the step's numbers, in order of priority."""
        return tuple(one for one in (getattr(cls, "State", None), cls.Parameters, cls) if one is not None)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Lines for the head of its C program: assumptions, and conditions that are not met."""
        return ()

    # --- a braking run ---

    @property
    def model_law(self) -> AdhesionLaw | None:
        """Adhesion law that it assumes; None for the law of the run."""
        return None

    @property
    def model_follows_rail(self) -> bool:
        """Whether the assumed law follows the rail."""
        return True

    @classmethod
    def outside_text(cls, model: type[AdhesionLaw] | None) -> str:
        """Kernel text of the functions that the step calls as `outside`; `model` is the assumed law."""
        return ""

    def source_text(self) -> str:
        """Text of its `command` in a kernel."""
        return _source_text(type(self), None if self.model_law is None else type(self.model_law))

    def row(self, situation: Situation, state: Any) -> tuple[float, ...]:
        """Its numbers in a kernel: reference slip, parameters in a `situation`, arrays; `state` is the initial one."""
        held = math.nan if self.reference is None else self.reference.on(situation.rail)
        values = {**self.parameters(situation), "period": situation.period, "reference_slip": held}
        layout = layout_of(type(self))
        numbers = {name: math.nan if value is None else value for name, value in values.items()}
        return (held, *layout.row(numbers, [len(getattr(state, name)) for name in layout.state_arrays]))

    @classmethod
    def flat(cls, state: Any) -> list[float]:
        """State as a list of numbers, in the order of a kernel."""
        layout = layout_of(cls)
        arrays = (number for name in layout.state_arrays for number in getattr(state, name))
        return [*(float(getattr(state, name)) for name in layout.state), *map(float, arrays)]

    def logged(self, state: Any) -> dict[str, int]:
        """Names of the numbers of `flat` that a run records, and their indices."""
        layout = layout_of(type(self))
        arrays = (f"{name}_{i}" for name in layout.state_arrays for i in range(len(getattr(state, name))))
        return {name: place for place, name in enumerate((*layout.state, *arrays))}

    def __reduce__(self) -> Any:
        """Rebuild information for another process, which cannot import the file of a user's kind."""
        module = sys.modules.get(type(self).__module__)
        if module is None or getattr(module, "__spec__", None) is not None:
            return super().__reduce__()
        from numba import cloudpickle

        cloudpickle.register_pickle_by_value(module)
        model = None if self.model_law is None else type(self.model_law)
        return _sent, (cloudpickle.dumps(type(self)), model, self.source_text(), dict(self))

    # --- files ---

    @classmethod
    def from_keys(cls, content: Mapping[str, Any], path: Path, initial_speed: float | None) -> Self:
        """Make the controller from the keys of a file, `content`, at a `path`.

        `initial_speed` (m/s) is v0 of an adhesion model that depends on v0.
        """
        return validated(cls, content, file_name(path))

    def file_keys(self) -> dict[str, Any]:
        """Keys of its TOML file."""
        return {name: value for name, value in self if value is not None and name not in ("name", "reference")}

    @property
    def toml(self) -> str:
        """Text of its TOML file: every number with its unit, and the Python file of a user's kind.

        InputError for a field that is None although its default is not.
        """
        return self._file_text(Path())

    def _file_text(self, folder: Path) -> str:
        """Text of its TOML file with paths relative to a folder."""
        for name, field in type(self).model_fields.items():
            if getattr(self, name) is None and field.default is not None:
                raise InputError(f"{name}: has no value, but a file without it means {field.default}; give a value")
        lines, tables = [f"kind = {_toml(self.kind)}", f"name = {_toml(self.label)}"], list[str]()
        if (python := python_file(type(self))) is not None:
            lines.append(f"python = {_toml(os.path.relpath(python, folder))}")
        units = self.units()
        for name, value in self.file_keys().items():
            if isinstance(value, Record):
                tables += ["", f"[{name}]", *(f"{key} = {_toml(one)}" for key, one in value if one is not None)]
            else:
                unit = units.get(name, "1")
                lines.append(f"{name} = {_toml(value)}" + (f"  # {unit}" if unit != "1" else ""))
        if self.reference is not None:
            tables += ["", "[reference]", f"dry = {self.reference.dry!r}", f"wet = {self.reference.wet!r}"]
        return "\n".join([*lines, *tables]) + "\n"

    def save(self, path: str | Path) -> None:
        """Write its TOML file to a `path`; every command and `load_controller` read it.

        InputError if it cannot be written.
        """
        path = given_path(path)
        try:
            path.write_text(self._file_text(path.parent), "utf-8")
        except OSError as error:
            raise InputError(f"{file_name(path)}: cannot be written ({error.strerror}); give another path") from None


def python_file(kind: type[Controller]) -> str | None:
    """Python file of a user's kind; None for a kind of the package, or of an interactive session."""
    if kind.__module__.startswith(f"{__package__}."):
        return None
    try:
        return inspect.getsourcefile(kind)
    except TypeError:
        return None


def _sent(kind: bytes, model: type[AdhesionLaw] | None, text: str, values: dict[str, Any]) -> Controller:
    """Rebuild a controller whose kind cannot be imported."""
    from numba import cloudpickle

    made: type[Controller] = cloudpickle.loads(kind)
    _SENT[made, model] = text
    return made.model_construct(**values)


_SENT: dict[tuple[type[Controller], type[AdhesionLaw] | None], str] = {}
"""Kernel texts of the kinds whose source is in another process."""


def torque_range(least: float, most: float) -> str:
    """Range of torques, N*m, as text without infinite ends."""
    low = f"at least {least:g} N·m" if math.isfinite(least) else ""
    high = f"at most {most:g} N·m" if math.isfinite(most) else ""
    return " and ".join(filter(None, (low, high))) or "unlimited"


def _toml(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, dict | Record):
        return "{" + ", ".join(f"{name} = {_toml(one)}" for name, one in dict(value).items() if one is not None) + "}"
    return (
        repr(float(value))
        if isinstance(value, float)
        else json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    )


# --- layout of the fields in a kernel ---------------------------------------------------------------------------------


@cache
def layout_of(kind: type[Controller]) -> Layout:
    """Indices of the fields of a kind in a kernel's arrays."""
    parameters, state = kind.parameter_fields(), kind.state_fields()
    arrays = tuple(name for name, hint in parameters.items() if get_origin(hint) is tuple)
    scalars = (*(name for name in parameters if name not in arrays), "period", "reference_slip")
    state_arrays = tuple(name for name, hint in state.items() if get_origin(hint) is tuple)
    return Layout(tuple(name for name in state if name not in state_arrays), state_arrays, scalars, arrays, _FIRST)


def _hints(record: type[Record]) -> dict[str, Any]:
    hints = get_type_hints(record)
    return {name: hints[name] for name in record.model_fields}


def _is_number(hint: Any) -> bool:
    return hint in (float, bool, int, float | None) or hint == tuple[float, ...]


@cache
def _source_text(kind: type[Controller], model: type[AdhesionLaw] | None) -> str:
    if (kind, model) in _SENT:
        return _SENT[kind, model]
    step = with_functions(kind.step, kind.outside_functions(None))
    return kind.outside_text(model) + kernel_text(read_step(step), layout_of(kind))
