"""Base class of all kinds of controllers.

A kind of controller is one class in one file, of this package or of the user. The class has the parameters as fields,
the state as a record, and the control law as a function `step`. The package derives everything else from the class:
TOML file, options, kernel of a braking run, C99 program, label in reports, verdict over an envelope.
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
"""Default sampling period, s; common in brake control units."""

LEAST_PERIOD = 1e-5
"""Shortest allowed sampling period, s; a shorter one needs more memory without being more accurate."""

_FIRST = 1  # index of the first parameter in a kernel's row, which begins with the reference slip ratio


class Measurement(NamedTuple):
    """Measurements of one sample: time (s), train speed (m/s), wheel speed (rad/s), and `applied_torque` (N*m).

    `applied_torque` is the command since the previous sample, after the limits of the brake.
    """

    time: float
    train_speed: float
    wheel_speed: float
    applied_torque: float


@dataclass(frozen=True)
class Situation:
    """Conditions of a step: the `rail`, the sampling `period` (s), and the `assumed` adhesion law.

    Outside a run, `assumed` is None for a controller without an adhesion law of its own.
    """

    rail: Rail
    period: float
    assumed: AdhesionLaw | None


_ASSUMED: Mapping[str, Callable[[Vehicle], float]] = MappingProxyType(
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
"""Fields for the vehicle parameters that a controller assumes, each with a function that reads it from a vehicle."""


_NOT_TUNED = {*_ASSUMED, "period", "tracking_time", "torque_min", "torque_max"} | {
    *("initial_torque", "hand_over_torque", "hand_over_speed")
}
"""Fields that are not design numbers: assumed vehicle parameters, period, limits, start and hand-over."""


class DesignNumber(NamedTuple):
    """A number that a user tunes: its name, value, unit, meaning, and upper bound `most`."""

    name: str
    value: float
    unit: str
    meaning: str
    most: float = math.inf


class Controller(Record):
    """Base of the controller kinds.

    A kind defines `kind`, `title`, `source`, its parameters (fields made by `quantity`) and the static method `step`.
    If it has a memory, it also defines `State`, a record whose defaults are the initial values. If `step` needs other
    numbers than the fields, the kind defines `Parameters`, a record of these numbers, and the method `parameters`.
    """

    kind: ClassVar[str]
    """Name in files, on the command line and in tables."""
    title: ClassVar[str]
    """Description in one line."""
    source: ClassVar[str]
    """Source of the control law."""
    Parameters: ClassVar[type[Record] | None] = None
    no_loop: ClassVar[str] = "it is not linear"
    """Reason why the controller has no linear loop, as a text for messages."""
    follows_reference: ClassVar[bool] = True
    """Whether the controller tracks `reference`; otherwise `reference` is optional and only used to judge the slip."""
    by_rule: ClassVar[bool] = False
    """Whether `for_vehicle` needs only the vehicle, so that `--controller` accepts the name of the kind."""
    finds_slip: ClassVar[bool] = False
    """Whether the controller searches for its reference slip during the run; see `held_slip`."""

    class State(Record):
        """State of a controller; without fields for a controller without memory."""

    name: str = Field("", description="name in reports; the kind's name if left out")
    period: float | None = quantity(
        "s", "sampling period; the integration step of the run if left out", ge=LEAST_PERIOD, default=None
    )
    reference: ReferenceSlip | None = Field(REFERENCE, description="reference slip ratio")

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
        - parameters: has the fields of `Parameters` (of the controller if `Parameters` is None), and also `period` (s)
          and `reference_slip` (ratio).
        """
        raise NotImplementedError

    @classmethod
    def state_fields(cls) -> dict[str, Any]:
        """Names and types of the fields of the state."""
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
        """Text of the label and the parameters, in one line."""
        parameters = (
            f"{name.replace('_', ' ')} {getattr(self, name):.6g}{'' if unit == '1' else f' {unit}'}"
            for name, unit in self.units().items()
            if isinstance(getattr(self, name), float) and name not in ("period", "torque_min", "torque_max")
        )
        return ", ".join([self.label, *parameters])

    def limits_described(self) -> str:
        """Text of the torque limits, the initial torque and the anti-windup, in one line."""
        return f"torque {torque_range(self.least_torque, self.largest_torque)}"

    def gain_values(self) -> dict[str, Any]:
        """Parameters by name, for JSON; the name of a quantity with a unit ends in "_si"."""
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
        """Train speed, m/s, below which the controller commands a torque without slip control; 0: never."""
        return float(getattr(self, "hand_over_speed", 0.0))

    def headline(self) -> str:
        """Name with the most important numbers, for the first page of a report."""
        return self.title

    def handed_over(self) -> str:
        """Text of the torque that the controller commands below `controlled_from`."""
        return f"{getattr(self, 'hand_over_torque', 0.0):.4g} N·m"

    # --- design ---

    def design_numbers(self) -> list[DesignNumber]:
        """Numbers that a user tunes: first kp and ki, then fields that the kind itself defines, then inherited fields.

        Assumed vehicle parameters, period, limits, start and hand-over are left out.
        """
        inherited = {name for base in type(self).__mro__[1:] for name in getattr(base, "model_fields", ())}
        shaped = [n for n in self.units() if n not in _NOT_TUNED and isinstance(getattr(self, n), float)]
        numbers = []
        for name in sorted(shaped, key=lambda name: 0 if name in ("kp", "ki") else 1 + (name in inherited)):
            field = type(self).model_fields[name]
            bounds = [getattr(mark, end) for mark in field.metadata for end in ("lt", "le") if hasattr(mark, end)]
            most = float(min(bounds, default=math.inf))
            numbers.append(DesignNumber(name, getattr(self, name), self.units()[name], field.description or name, most))
        return numbers

    def with_design_numbers(self, values: Mapping[str, float], **others: Any) -> Self:
        """Copy of the controller with some design numbers changed.

        - values: new design numbers by name, in the units of `design_numbers`.
        - others: new values of other fields.

        InputError as for a new controller.
        """
        try:
            return type(self)(**{**dict(self), **values, **others})
        except InputError as error:
            raise InputError(str(error).removeprefix(f"{type(self).__name__}: ")) from None

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Make the controller for a vehicle by the rule of its kind; `given` parameters replace those of the rule.

        InfeasibleDesignError, with the reason, if the rule gives no controller for the vehicle.
        """
        return cls(**given).believing(vehicle)

    def believing(self, vehicle: Vehicle, before: Vehicle | None = None) -> Self:
        """Copy that assumes the parameters of a `vehicle` where its own are None or equal those of vehicle `before`."""
        changed = {}
        for name in _ASSUMED.keys() & type(self).model_fields.keys():
            now, was = _ASSUMED[name](vehicle), None if before is None else _ASSUMED[name](before)
            if getattr(self, name) in (None, was) and now != was:
                changed[name] = now
        return self.model_copy(update=changed) if changed else self

    def linear(self, point: OperatingPoint | None) -> Any:
        """Linear system from slip error (m/s) to torque (N*m) at an operating point; None if there is none."""
        return None

    def loop(self, point: OperatingPoint, actuator: Actuator) -> Any:
        """Exact loop at an operating point with an `actuator`; None if `linear` gives the loop."""
        return None

    def held_slip(self, law: AdhesionLaw, speed: float, wheel_load: float) -> float | None:
        """Slip ratio at which to judge the loop, for an adhesion `law`, a train `speed`, m/s, and a `wheel_load`, N.

        None if the loop is judged at the reference slip.
        """
        return None

    def slip_numbers(self) -> tuple[Any, ...]:
        """Parameters on which `held_slip` and `speeds_to_judge` depend."""
        return (self.model_dump_json(),)

    def speeds_to_judge(self) -> tuple[float, ...]:
        """Train speeds, m/s, at which the loop changes; they are judged in addition to the speeds of an envelope."""
        return ()

    def stable_and_ms(
        self, points: Sequence[OperatingPoint], brakes: Sequence[Actuator], case: tuple[Any, Any]
    ) -> tuple[Any, Any] | None:
        """Stability and Ms of the sampled loop in n cases, Ms inf if unstable; None if `linear` gives the loop.

        - case: for each case its index in `points` and its index in `brakes`, (n,) each.
        """
        return None

    def loop_as_run(self, point: OperatingPoint, actuator: Actuator) -> Any:
        """Sampled loop at an operating point with an `actuator`; None if `linear` gives the loop."""
        return None

    # --- functions and numbers outside the step ---

    def assuming(self, law: AdhesionLaw) -> Self:
        """Copy that assumes the adhesion `law`, if the controller needs a law and has none of its own."""
        return self

    @classmethod
    def outside_functions(cls, model: type[AdhesionLaw] | None) -> Mapping[str, Callable[..., Any]]:
        """Python functions, by name, that replace those marked as `outside` in the module of the step.

        With a `model`, they include the functions of this adhesion law; `outside_text` defines the others.
        """
        return {}

    def outside_numbers(self, situation: Situation) -> Mapping[str, Any]:
        """Parameters, by name, that only the functions of the assumed adhesion law read, in a `situation`."""
        return {}

    @property
    def whole_step(self) -> Callable[[Any, Any, Any], float]:
        """Step with all functions that it calls, as used in Python and in the C program."""
        model = None if self.model_law is None else type(self.model_law)
        return with_functions(type(self).step, self.outside_functions(model))

    @classmethod
    def described_in(cls) -> tuple[type, ...]:
        """Classes whose fields give meaning, unit and bounds of states and parameters, in order of priority."""
        return tuple(owner for owner in (getattr(cls, "State", None), cls.Parameters, cls) if owner is not None)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Lines for the head of the C program: assumptions, and conditions that are not met."""
        return ()

    # --- a braking run ---

    @property
    def model_law(self) -> AdhesionLaw | None:
        """Adhesion law that the controller assumes; None for the law of the run."""
        return None

    @property
    def model_follows_rail(self) -> bool:
        """Whether the assumed adhesion law changes when the rail changes."""
        return True

    @classmethod
    def outside_text(cls, model: type[AdhesionLaw] | None) -> str:
        """Kernel text of the functions marked as `outside` that the step calls; `model` is the assumed law."""
        return ""

    def source_text(self) -> str:
        """Kernel text that defines `command`, the step of the controller."""
        return _source_text(type(self), None if self.model_law is None else type(self.model_law))

    def row(self, situation: Situation, state: Any) -> tuple[float, ...]:
        """Numbers that a kernel reads: reference slip, then the parameters in a `situation`; `state`: initial state."""
        slip = math.nan if self.reference is None else self.reference.on(situation.rail)
        values = {**self.parameters(situation), "period": situation.period, "reference_slip": slip}
        layout = layout_of(type(self))
        numbers = {name: math.nan if value is None else value for name, value in values.items()}
        return (slip, *layout.row(numbers, [len(getattr(state, name)) for name in layout.state_arrays]))

    @classmethod
    def flat(cls, state: Any) -> list[float]:
        """Numbers of a `state` as a list, in the order of a kernel's state array."""
        layout = layout_of(cls)
        arrays = (number for name in layout.state_arrays for number in getattr(state, name))
        return [*(float(getattr(state, name)) for name in layout.state), *map(float, arrays)]

    def logged(self, state: Any) -> dict[str, int]:
        """Names of the state's numbers that a run records, and their indices in `flat`."""
        layout = layout_of(type(self))
        arrays = (f"{name}_{i}" for name in layout.state_arrays for i in range(len(getattr(state, name))))
        return {name: place for place, name in enumerate((*layout.state, *arrays))}

    def __reduce__(self) -> Any:
        """Pickle the controller; for a user's kind also its class, because another process cannot import its file."""
        module = sys.modules.get(type(self).__module__)
        if module is None or getattr(module, "__spec__", None) is not None:
            return super().__reduce__()
        from numba import cloudpickle

        cloudpickle.register_pickle_by_value(module)
        model = None if self.model_law is None else type(self.model_law)
        return _rebuilt, (cloudpickle.dumps(type(self)), model, self.source_text(), dict(self))

    # --- files ---

    @classmethod
    def from_keys(cls, content: Mapping[str, Any], path: Path, initial_speed: float | None) -> Self:
        """Make the controller from `content`, the keys of the file at a `path`.

        `initial_speed` is the initial speed v0, m/s, for an adhesion law that depends on v0.
        """
        return validated(cls, content, file_name(path))

    def file_keys(self) -> dict[str, Any]:
        """Keys of the TOML file with their values."""
        return {name: value for name, value in self if value is not None and name not in ("name", "reference")}

    @property
    def toml(self) -> str:
        """Text of the TOML file: every number with its unit, and the name of the Python file of a user's kind.

        InputError for a field that is None although its default is not.
        """
        return self._file_text(Path())

    def _file_text(self, folder: Path) -> str:
        """Text of the TOML file with paths relative to a folder."""
        for name, field in type(self).model_fields.items():
            if getattr(self, name) is None and field.default is not None:
                raise InputError(
                    f"{name}: None cannot be saved; a file without the key means {field.default}; give a value"
                )
        lines, tables = [f"kind = {_toml(self.kind)}", f"name = {_toml(self.label)}"], list[str]()
        if (python := python_file(type(self))) is not None:
            lines.append(f"python = {_toml(os.path.relpath(python, folder))}")
        units = self.units()
        for name, value in self.file_keys().items():
            if isinstance(value, Record):
                tables += ["", f"[{name}]", *(f"{key} = {_toml(inner)}" for key, inner in value if inner is not None)]
            else:
                unit = units.get(name, "1")
                lines.append(f"{name} = {_toml(value)}" + (f"  # {unit}" if unit != "1" else ""))
        if self.reference is not None:
            tables += ["", "[reference]", f"dry = {self.reference.dry!r}", f"wet = {self.reference.wet!r}"]
        return "\n".join([*lines, *tables]) + "\n"

    def save(self, path: str | Path) -> None:
        """Write the controller to a TOML file at a `path`; every command and `load_controller` read it.

        InputError if the file cannot be written.
        """
        path = given_path(path)
        try:
            path.write_text(self._file_text(path.parent), "utf-8")
        except OSError as error:
            raise InputError(f"{file_name(path)}: cannot be written ({error.strerror}); give another path") from None


def python_file(kind: type[Controller]) -> str | None:
    """Name of the Python file of a user's kind; None for a kind of the package, or defined at a prompt."""
    if kind.__module__.startswith(f"{__package__}."):
        return None
    try:
        return inspect.getsourcefile(kind)
    except TypeError:
        return None


def _rebuilt(kind: bytes, model: type[AdhesionLaw] | None, text: str, values: dict[str, Any]) -> Controller:
    """Rebuild a pickled controller whose kind cannot be imported."""
    from numba import cloudpickle

    made: type[Controller] = cloudpickle.loads(kind)
    _RECEIVED[made, model] = text
    return made.model_construct(**values)


_RECEIVED: dict[tuple[type[Controller], type[AdhesionLaw] | None], str] = {}
"""Kernel texts of kinds that another process has defined, by kind and assumed adhesion law."""


def torque_range(least: float, most: float) -> str:
    """Range of torques, N*m, as text without infinite ends."""
    low = f"at least {least:g} N·m" if math.isfinite(least) else ""
    high = f"at most {most:g} N·m" if math.isfinite(most) else ""
    return " and ".join(filter(None, (low, high))) or "unlimited"


def _toml(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, dict | Record):
        entries = (f"{name} = {_toml(inner)}" for name, inner in dict(value).items() if inner is not None)
        return "{" + ", ".join(entries) + "}"
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
    if (kind, model) in _RECEIVED:
        return _RECEIVED[kind, model]
    step = with_functions(kind.step, kind.outside_functions(None))
    return kind.outside_text(model) + kernel_text(read_step(step), layout_of(kind))
