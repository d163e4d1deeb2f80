"""What every controller kind is: a record of its parameters, its state, and its step in named fields.

A kind is one class in one file of this package, or of the user's. Everything else follows from the class: its TOML
file, its options, the kernel of a braking run, its C99 program, its label in reports, its verdict over an envelope.
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
"""Sampling period, s, of a controller that states none: that of common brake control units."""

LEAST_PERIOD = 1e-5
"""Shortest sampling period, s; a shorter one fills memory before it gains accuracy."""

_FIRST = 1  # place in a kernel's row of the first parameter; the reference slip ratio is before it


class Measurement(NamedTuple):
    """What a controller measures: time (s), train speed (m/s), wheel speed (rad/s), and `applied_torque` (N*m), the
    command that the brake took since the sample before."""

    time: float
    train_speed: float
    wheel_speed: float
    applied_torque: float


@dataclass(frozen=True)
class Situation:
    """For which `rail` and sampling `period` (s) the parameters of a step are made, and the `assumed` adhesion law;
    None outside a run for a controller without a law of its own."""

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
"""Fields that a controller believes of its vehicle; a field of such a name that is not given takes the vehicle's."""


_GIVEN = {*_BELIEFS, "period", "tracking_time", "torque_min", "torque_max"} | {
    *("initial_torque", "hand_over_torque", "hand_over_speed")
}
"""Numbers that are not shaped."""


class DesignNumber(NamedTuple):
    """A number of a controller that is shaped: its name, value, unit, meaning, and the most that it may be."""

    name: str
    value: float
    unit: str
    meaning: str
    most: float = math.inf


class Controller(Record):
    """Base of the controller kinds.

    A kind defines `kind`, `title`, `source`, its parameters (fields made by `quantity`), `State` (a record of its
    state, with the values at the start, if it remembers anything) and `step`, a static method. Where `step` needs other
    numbers than the fields, it also defines `Parameters` (a record of them) and `parameters`.
    """

    kind: ClassVar[str]
    """Name in files, on the command line and in tables."""
    title: ClassVar[str]
    """What it is, in a line."""
    source: ClassVar[str]
    """Where it is from."""
    Parameters: ClassVar[type[Record] | None] = None
    no_loop: ClassVar[str] = "it is not linear"
    """Why it has no linear loop, if it has none."""
    follows_reference: ClassVar[bool] = True
    """Whether it holds the reference slip; else its slip is its own."""
    by_rule: ClassVar[bool] = False
    """Whether `for_vehicle` makes it of the vehicle alone; it is then a choice by its name."""
    finds_slip: ClassVar[bool] = False
    """Whether it finds the slip to hold by itself, see `held_slip`."""

    class State(Record):
        """It remembers nothing."""

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
        """One sample: the torque to command until the next, N*m; changes `state`.

        - state: has the fields of `State`.
        - measurement: has the fields of `Measurement`.
        - parameters: has the fields of `Parameters`, or of the controller, and `period` (s), `reference_slip` (ratio).
        """
        raise NotImplementedError

    @classmethod
    def state_fields(cls) -> dict[str, Any]:
        """Names and types of the fields of a state, numbers before lists of numbers."""
        return _hints(cls.State)

    @classmethod
    def parameter_fields(cls) -> dict[str, Any]:
        """Names and types of the numbers that `step` takes."""
        return {
            name: hint for name, hint in _hints(cls.Parameters or cls).items() if _is_number(hint) and name != "period"
        }

    def start(self, speed: float, period: float) -> Any:
        """The state when the brake is applied at a train speed, m/s; `period` is that of the sampling, s."""
        return self.State()

    def parameters(self, situation: Situation) -> Mapping[str, Any]:
        """The numbers that `step` takes in a `situation`, by name, SI; without `period` and `reference_slip`."""
        return {name: getattr(self, name) for name in self.parameter_fields()}

    # --- what it says of itself ---

    @property
    def label(self) -> str:
        """Its name in reports."""
        return self.name or self.kind

    def described(self) -> str:
        """Its label and parameters, in a line."""
        told = (
            f"{name.replace('_', ' ')} {getattr(self, name):.6g}{'' if unit == '1' else f' {unit}'}"
            for name, unit in self.units().items()
            if isinstance(getattr(self, name), float) and name not in ("period", "torque_min", "torque_max")
        )
        return ", ".join([self.label, *told])

    def limits_described(self) -> str:
        """Its own torque limits, and what else it starts and works with, in a line."""
        return f"torque {torque_range(self.least_torque, self.largest_torque)}"

    def gain_values(self) -> dict[str, Any]:
        """The parameters for JSON: each name with its unit's suffix "_si" where it has a unit."""
        return {
            name if unit == "1" else f"{name}_si": getattr(self, name)
            for name, unit in self.units().items()
            if isinstance(getattr(self, name), float | tuple) and name != "period"
        }

    @property
    def least_torque(self) -> float:
        """Lower limit of its command, N*m; -inf without one."""
        least = getattr(self, "torque_min", None)
        return -math.inf if least is None else float(least)

    @property
    def largest_torque(self) -> float:
        """Upper limit of its command, N*m; inf without one."""
        most = getattr(self, "torque_max", None)
        return math.inf if most is None else float(most)

    @property
    def controlled_from(self) -> float:
        """Train speed, m/s, below which it does not control slip and holds a torque; 0: it always does."""
        return float(getattr(self, "hand_over_speed", 0.0))

    def headline(self) -> str:
        """What it is, with the numbers that matter most, for the first page of a report."""
        return self.title

    def handed_over(self) -> str:
        """What it holds below `controlled_from`."""
        return f"{getattr(self, 'hand_over_torque', 0.0):.4g} N·m"

    # --- design ---

    def design_numbers(self) -> list[DesignNumber]:
        """The numbers that are shaped: gains, then what its kind alone has, then what it has of others; not what it
        believes of the vehicle, its limits, and how it begins and ends."""
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
        """The controller with some of these numbers changed.

        - values: by name, in the unit of each number of `design_numbers`; of what is not a number, 1.
        - others: other fields.

        InputError as of its kind.
        """
        try:
            return type(self)(**{**dict(self), **values, **others})
        except InputError as error:
            raise InputError(str(error).removeprefix(f"{type(self).__name__}: ")) from None

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """The controller for a vehicle by the rule of its kind; `given` parameters are taken as they are.

        InfeasibleDesignError: the rule has no controller for the vehicle, with the reason.
        """
        return cls(**given).believing(vehicle)

    def believing(self, vehicle: Vehicle, before: Vehicle | None = None) -> Self:
        """The controller with what it believes of the vehicle filled in where its parameters do not say it, or say what
        a vehicle `before` is."""
        changed = {}
        for name in _BELIEFS.keys() & type(self).model_fields.keys():
            now, was = _BELIEFS[name](vehicle), None if before is None else _BELIEFS[name](before)
            if getattr(self, name) in (None, was) and now != was:
                changed[name] = now
        return self.model_copy(update=changed) if changed else self

    def linear(self, point: OperatingPoint | None) -> Any:
        """The linear system from slip error (m/s) to torque (N*m) at an operating point; None where it has none."""
        return None

    def loop(self, point: OperatingPoint, actuator: Actuator) -> Any:
        """The exact loop that it closes at an operating point with an `actuator`; None for that of a linear system."""
        return None

    def held_slip(self, law: AdhesionLaw, speed: float, wheel_load: float) -> float | None:
        """The slip ratio that it comes to by itself on a rail of an adhesion `law` at a train `speed`, m/s, under a
        `wheel_load`, N; None if it holds its reference."""
        return None

    def slip_numbers(self) -> tuple[Any, ...]:
        """All of its own that `held_slip` and `speeds_to_judge` depend on."""
        return (self.model_dump_json(),)

    def speeds_to_judge(self) -> tuple[float, ...]:
        """Train speeds, m/s, at which its loop changes, to be judged besides those of an envelope."""
        return ()

    def stable_and_ms(
        self, points: Sequence[OperatingPoint], brakes: Sequence[Actuator], case: tuple[Any, Any]
    ) -> tuple[Any, Any] | None:
        """Whether the loop of each case is stable as it runs, and its Ms, inf where not; None if the loops are of
        linear systems.

        - case: numbers of `points` and of `brakes`, (n,) each.
        """
        return None

    def loop_as_run(self, point: OperatingPoint, actuator: Actuator) -> Any:
        """The sampled loop that it closes at an operating point with an `actuator`; None for that of a linear
        system."""
        return None

    # --- what its step has from elsewhere ---

    def assuming(self, law: AdhesionLaw) -> Self:
        """The controller with an adhesion law to assume, if it needs one and has none."""
        return self

    @classmethod
    def outside_functions(cls, model: type[AdhesionLaw] | None) -> Mapping[str, Callable[..., Any]]:
        """Functions of numbers, by the names that its step has as `outside`: those of the assumed adhesion law too if
        there is a `model`; those that are missing are in `outside_text`."""
        return {}

    def outside_numbers(self, situation: Situation) -> Mapping[str, Any]:
        """Parameters besides `parameters`, in a `situation`, that only functions of the assumed adhesion law read."""
        return {}

    @property
    def whole_step(self) -> Callable[[Any, Any, Any], float]:
        """Its step with every function, as it runs in Python and is written in C."""
        model = None if self.model_law is None else type(self.model_law)
        return with_functions(type(self).step, self.outside_functions(model))

    @classmethod
    def described_in(cls) -> tuple[type, ...]:
        """Classes whose fields say meaning, unit and bounds of the numbers of its step, the first first."""
        return tuple(one for one in (getattr(cls, "State", None), cls.Parameters, cls) if one is not None)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Lines for the head of its C program: what it assumes, and conditions that do not hold."""
        return ()

    # --- a braking run ---

    @property
    def model_law(self) -> AdhesionLaw | None:
        """The adhesion law that it assumes; None: that of the run, if it needs one."""
        return None

    @property
    def model_follows_rail(self) -> bool:
        """Whether the law that it assumes follows the rail."""
        return True

    @classmethod
    def outside_text(cls, model: type[AdhesionLaw] | None) -> str:
        """Kernel text of the functions that its step has from `outside`; `model` is the law that it assumes."""
        return ""

    def source_text(self) -> str:
        """The text of its `command` in a kernel."""
        return _source_text(type(self), None if self.model_law is None else type(self.model_law))

    def row(self, situation: Situation, state: Any) -> tuple[float, ...]:
        """Its numbers in a kernel: reference slip, parameters in a `situation`, arrays; `state` is that of a start."""
        held = math.nan if self.reference is None else self.reference.on(situation.rail)
        values = {**self.parameters(situation), "period": situation.period, "reference_slip": held}
        layout = layout_of(type(self))
        numbers = {name: math.nan if value is None else value for name, value in values.items()}
        return (held, *layout.row(numbers, [len(getattr(state, name)) for name in layout.state_arrays]))

    @classmethod
    def flat(cls, state: Any) -> list[float]:
        """A state as the numbers that a kernel has of it."""
        layout = layout_of(cls)
        arrays = (number for name in layout.state_arrays for number in getattr(state, name))
        return [*(float(getattr(state, name)) for name in layout.state), *map(float, arrays)]

    def logged(self, state: Any) -> dict[str, int]:
        """Names of the numbers of `flat` that a run records, and their places in it."""
        layout = layout_of(type(self))
        arrays = (f"{name}_{i}" for name in layout.state_arrays for i in range(len(getattr(state, name))))
        return {name: place for place, name in enumerate((*layout.state, *arrays))}

    def __reduce__(self) -> Any:
        """Of a kind of the user's, what a process needs that cannot import its file."""
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
        """The controller of the keys of a file, `content`, at a `path`.

        `initial_speed` (m/s) is v0 of an adhesion model over v0.
        """
        return validated(cls, content, file_name(path))

    def file_keys(self) -> dict[str, Any]:
        """The keys of its file."""
        return {name: value for name, value in self if value is not None and name not in ("name", "reference")}

    @property
    def toml(self) -> str:
        """Its file: every number of it, with units; of a kind of the user's, the Python file with its class.

        InputError for a field without a value that a file without it has one of.
        """
        return self._file_text(Path())

    def _file_text(self, folder: Path) -> str:
        """As `toml`, in a folder."""
        for name, field in type(self).model_fields.items():
            if getattr(self, name) is None and field.default is not None:
                raise InputError(f"{name}: a file without it means {field.default}; give one")
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
        """Write its TOML file, which every command and `load_controller` take, to a `path`.

        InputError where it cannot be written.
        """
        path = given_path(path)
        try:
            path.write_text(self._file_text(path.parent), "utf-8")
        except OSError as error:
            raise InputError(f"{file_name(path)}: cannot be written ({error.strerror}); give another path") from None


def python_file(kind: type[Controller]) -> str | None:
    """The file of the class of a kind of the user's; None of one of the package, or typed at a prompt."""
    if kind.__module__.startswith(f"{__package__}."):
        return None
    try:
        return inspect.getsourcefile(kind)
    except TypeError:
        return None


def _sent(kind: bytes, model: type[AdhesionLaw] | None, text: str, values: dict[str, Any]) -> Controller:
    """Rebuild the controller of a kind that another process cannot import."""
    from numba import cloudpickle

    made: type[Controller] = cloudpickle.loads(kind)
    _SENT[made, model] = text
    return made.model_construct(**values)


_SENT: dict[tuple[type[Controller], type[AdhesionLaw] | None], str] = {}
"""Kernel texts of kinds whose source is in another process."""


def torque_range(least: float, most: float) -> str:
    """A range of torques, N*m, in words; an infinite end is none."""
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


# --- places of the fields in a kernel ---------------------------------------------------------------------------------


@cache
def layout_of(kind: type[Controller]) -> Layout:
    """Places of the fields of a kind in a kernel's arrays."""
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
