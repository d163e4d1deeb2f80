"""Base class of all controllers.

The fields of a controller class are the parameters of the controller, its record `State` is the memory, and its static
method `step` is the control law. The package derives everything else from this class: the TOML file, the command-line
options, the compiled simulation and the C99 program.
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

PERIOD = 0.01  #: default sampling period, s; common in brake control units
LEAST_PERIOD = 1e-5  #: shortest sampling period, s; a shorter one needs more memory and is not more accurate
_FIRST = 1  # index of the first parameter in the numbers of `Controller.row`, after the reference slip ratio


class Measurement(NamedTuple):
    """Measurements of one sample: time (s), train speed (m/s), wheel speed (rad/s), and `applied_torque` (N*m).

    `applied_torque` is the previous command, limited by the brake.
    """

    time: float
    train_speed: float
    wheel_speed: float
    applied_torque: float


@dataclass(frozen=True)
class Situation:
    """Conditions on which the parameters of `step` depend: `rail`, sampling `period` (s), `assumed` adhesion law.

    In a braking run, `assumed` is the law that the controller sets, or else the law of the run. In a C
    or Python program, `assumed` is None if the controller sets no law.
    """

    rail: Rail
    period: float
    assumed: AdhesionLaw | None


# fields that are assumed vehicle parameters, with functions that compute them for a vehicle
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

# fields that a user does not tune
_NOT_TUNED = {*_ASSUMED, "period", "tracking_time", "torque_min", "torque_max"} | {
    *("initial_torque", "hand_over_torque", "hand_over_speed")
}


class DesignNumber(NamedTuple):
    """A number that a user tunes: its name, value, unit and meaning, and the largest value `most` that is allowed."""

    name: str
    value: float
    unit: str
    meaning: str
    most: float = math.inf


class Controller(Record):
    """Base class of the controllers.

    A derived class defines `kind`, `title`, `source`, its parameters (fields made by `quantity`) and the static method
    `step`. A controller with memory also defines `State`, a record whose defaults are the initial values. If `step`
    reads numbers that are computed from the fields, the class also defines `Parameters`, a record of these numbers, and
    the method `parameters`, which computes them.
    """

    kind: ClassVar[str]
    """Name of this kind of controller in files, on the command line and in tables."""
    title: ClassVar[str]
    """Description of the control law in a few words."""
    source: ClassVar[str]
    """Where the control law comes from, for example a publication."""
    Parameters: ClassVar[type[Record] | None] = None
    no_loop: ClassVar[str] = "it is not linear"
    """Reason why the controller has no linear loop, which messages state after its name."""
    follows_reference: ClassVar[bool] = True
    """Whether the controller tracks `reference`; otherwise `reference` is optional and only used to judge the slip."""
    by_rule: ClassVar[bool] = False
    """Whether `for_vehicle` computes all parameters from the vehicle; `--controller` then accepts the kind's name."""
    finds_slip: ClassVar[bool] = False
    """Whether the controller searches for its reference slip in a run; `judged_slip` returns the expected slip."""

    class State(Record):
        """State of a controller; a controller without memory has no fields here."""

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

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> float:
        """Compute the torque to command until the next sample, N*m, and update `state`.

        - state: has the fields of `State`.
        - measurement: has the fields of `Measurement`.
        - parameters: has the fields of `Parameters` or, if the class defines no `Parameters`, the fields of the
          controller; also `period` (sampling period, s) and `reference_slip` (ratio).
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
        """Initial state when the brake is applied at a train `speed`, m/s; `period` is the sampling period, s."""
        return self.State()

    def parameters(self, situation: Situation) -> Mapping[str, Any]:
        """Names and values (SI) of the parameters of `step` in a `situation`, without period and reference slip."""
        return {name: getattr(self, name) for name in self.parameter_fields()}

    @property
    def label(self) -> str:
        """Name of the controller in reports."""
        return self.name or self.kind

    def described(self) -> str:
        """One line with the label and the parameters."""
        parameters = (
            f"{name.replace('_', ' ')} {getattr(self, name):.6g}{'' if unit == '1' else f' {unit}'}"
            for name, unit in self.units().items()
            if isinstance(getattr(self, name), float) and name not in ("period", "torque_min", "torque_max")
        )
        return ", ".join([self.label, *parameters])

    def limits_described(self) -> str:
        """One line with the torque limits and, for controllers that have them, initial torque and anti-windup."""
        return f"torque {torque_range(self.least_torque, self.largest_torque)}"

    def gain_values(self) -> dict[str, Any]:
        """Parameters by name, for JSON output; "_si" is appended to the name of a parameter that has a unit."""
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
        """Train speed, m/s, below which the slip is not controlled; 0 if it is controlled at all speeds."""
        return float(getattr(self, "hand_over_speed", 0.0))

    def headline(self) -> str:
        """Name of the controller with its most important numbers, for the first page of a report."""
        return self.title

    def handed_over(self) -> str:
        """Description, in words, of the torque that the controller commands below the speed `controlled_from`."""
        return f"{getattr(self, 'hand_over_torque', 0.0):.4g} N·m"

    def design_numbers(self) -> list[DesignNumber]:
        """Parameters that a user tunes: first kp and ki, then the fields of the class itself, then inherited fields."""
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
        """Copy of the controller with new design numbers.

        `values` maps names of design numbers to their new values, in the units of `design_numbers`. `others` are new
        values of other fields. InputError for a value that the class does not allow.
        """
        try:
            return type(self)(**{**dict(self), **values, **others})
        except InputError as error:
            raise InputError(str(error).removeprefix(f"{type(self).__name__}: ")) from None

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Make the controller for a vehicle; the class computes the parameters that are not `given`.

        InfeasibleDesignError, with the reason, if the class cannot compute them.
        """
        return cls(**given).believing(vehicle)

    def believing(self, vehicle: Vehicle, before: Vehicle | None = None) -> Self:
        """Copy in which vehicle parameters that are None, or equal to those of `before`, come from `vehicle`."""
        changed = {}
        for name in _ASSUMED.keys() & type(self).model_fields.keys():
            now, was = _ASSUMED[name](vehicle), None if before is None else _ASSUMED[name](before)
            if getattr(self, name) in (None, was) and now != was:
                changed[name] = now
        return self.model_copy(update=changed) if changed else self

    def linear(self, point: OperatingPoint | None) -> Any:
        """Linear system from slip error (m/s) to torque (N*m) at a `point`; None if the controller is not linear."""
        return None

    def loop(self, point: OperatingPoint, actuator: Actuator) -> Any:
        """Exact loop at an operating point with an `actuator`; None if the caller must compute it from `linear`."""
        return None

    def judged_slip(self, law: AdhesionLaw, speed: float, wheel_load: float) -> float | None:
        """Slip ratio that the controller holds on an adhesion `law` at a train `speed`, m/s, and a `wheel_load`, N.

        Stability and margins are computed at this slip ratio or, if the method returns None, at the reference slip.
        """
        return None

    def slip_numbers(self) -> tuple[Any, ...]:
        """Parameters that determine the results of `judged_slip` and `speeds_to_judge`, as a key for a cache."""
        return (self.model_dump_json(),)

    def speeds_to_judge(self) -> tuple[float, ...]:
        """Train speeds, m/s, at which margins are computed in addition to the speeds of the envelope."""
        return ()

    def stable_and_ms(
        self, points: Sequence[OperatingPoint], brakes: Sequence[Actuator], case: tuple[Any, Any]
    ) -> tuple[Any, Any] | None:
        """Stability and Ms (inf if unstable) of n sampled loops; None if the caller must compute them from `linear`.

        - points, brakes: operating points and actuators.
        - case: two index arrays, (n,) each: loop i has operating point case[0][i] and actuator case[1][i].
        """
        return None

    def loop_as_run(self, point: OperatingPoint, actuator: Actuator) -> Any:
        """Sampled loop at an operating point with an `actuator`; None if the caller must compute it from `linear`."""
        return None

    def assuming(self, law: AdhesionLaw) -> Self:
        """Copy that assumes the adhesion `law`; unchanged if the controller needs no law or sets its own."""
        return self

    @classmethod
    def outside_functions(cls, model: type[AdhesionLaw] | None) -> Mapping[str, Callable[..., Any]]:
        """Names and Python definitions of the functions marked `outside`; `model` is the assumed adhesion law."""
        return {}

    def outside_numbers(self, situation: Situation) -> Mapping[str, Any]:
        """Names and values of the parameters that only functions marked `outside` read in a `situation`."""
        return {}

    @property
    def whole_step(self) -> Callable[[Any, Any, Any], float]:
        """The method `step`, in which the functions marked as `outside` are replaced by their Python definitions."""
        model = None if self.model_law is None else type(self.model_law)
        return with_functions(type(self).step, self.outside_functions(model))

    @classmethod
    def described_in(cls) -> tuple[type, ...]:
        """Classes that are searched, in this order, for the description of a state or parameter."""
        return tuple(owner for owner in (getattr(cls, "State", None), cls.Parameters, cls) if owner is not None)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Lines for the first comment of the C program: assumptions, and required conditions that are not met."""
        return ()

    @property
    def model_law(self) -> AdhesionLaw | None:
        """Adhesion law that the controller assumes; None if it assumes the adhesion law of the braking run."""
        return None

    @property
    def model_follows_rail(self) -> bool:
        """Whether the assumed adhesion law changes when the rail changes."""
        return True

    @classmethod
    def outside_text(cls, model: type[AdhesionLaw] | None) -> str:
        """Source text of the functions marked `outside` in the compiled simulation; `model` is the assumed law."""
        return ""

    def source_text(self) -> str:
        """Source text of the function `command`: the method `step`, translated for the compiled simulation."""
        return _source_text(type(self), None if self.model_law is None else type(self.model_law))

    def row(self, situation: Situation, state: Any) -> tuple[float, ...]:
        """Reference slip, parameters in a `situation` and array lengths of `state`, for the compiled simulation."""
        slip = math.nan if self.reference is None else self.reference.on(situation.rail)
        values = {**self.parameters(situation), "period": situation.period, "reference_slip": slip}
        layout = layout_of(type(self))
        numbers = {name: math.nan if value is None else value for name, value in values.items()}
        return (slip, *layout.row(numbers, [len(getattr(state, name)) for name in layout.state_arrays]))

    @classmethod
    def flat(cls, state: Any) -> list[float]:
        """Numbers of a `state` as a list, in the order that the compiled simulation uses."""
        layout = layout_of(cls)
        arrays = (number for name in layout.state_arrays for number in getattr(state, name))
        return [*(float(getattr(state, name)) for name in layout.state), *map(float, arrays)]

    def logged(self, state: Any) -> dict[str, int]:
        """Names of the state variables that a run records, and their indices in the list of `flat`."""
        layout = layout_of(type(self))
        arrays = (f"{name}_{i}" for name in layout.state_arrays for i in range(len(getattr(state, name))))
        return {name: place for place, name in enumerate((*layout.state, *arrays))}

    def __reduce__(self) -> Any:
        """Pickle the controller, and also a user's class, because another process cannot import the user's file."""
        module = sys.modules.get(type(self).__module__)
        if module is None or getattr(module, "__spec__", None) is not None:
            return super().__reduce__()
        from numba import cloudpickle

        cloudpickle.register_pickle_by_value(module)
        model = None if self.model_law is None else type(self.model_law)
        return _rebuilt, (cloudpickle.dumps(type(self)), model, self.source_text(), dict(self))

    @classmethod
    def from_keys(cls, content: Mapping[str, Any], path: Path, initial_speed: float | None) -> Self:
        """Make the controller from the `content` of the file `path` for a run with this `initial_speed`, m/s."""
        return validated(cls, content, file_name(path))

    def file_keys(self) -> dict[str, Any]:
        """Keys of the TOML file with their values."""
        return {name: value for name, value in self if value is not None and name not in ("name", "reference")}

    @property
    def toml(self) -> str:
        """Text of the TOML file; InputError for a field that is None although its default is not."""
        return self._file_text(Path())

    def _file_text(self, folder: Path) -> str:
        for name, field in type(self).model_fields.items():
            if getattr(self, name) is None and field.default is not None:
                raise InputError(
                    f"{name}: None cannot be saved, because a file without this key means {field.default}; give a value"
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
        """Write the controller to a TOML file at a `path`; InputError if the file cannot be written."""
        path = given_path(path)
        try:
            path.write_text(self._file_text(path.parent), "utf-8")
        except OSError as error:
            raise InputError(f"{file_name(path)} cannot be written ({error.strerror}); give another path") from None


def python_file(kind: type[Controller]) -> str | None:
    """Return the Python file that defines a user's controller class; None for any other class."""
    if kind.__module__.startswith(f"{__package__}."):
        return None
    try:
        return inspect.getsourcefile(kind)
    except TypeError:
        return None


def _rebuilt(kind: bytes, model: type[AdhesionLaw] | None, text: str, values: dict[str, Any]) -> Controller:
    from numba import cloudpickle

    made: type[Controller] = cloudpickle.loads(kind)
    _RECEIVED[made, model] = text
    return made.model_construct(**values)


# source texts of controller classes from another process, by class and type of the assumed adhesion law
_RECEIVED: dict[tuple[type[Controller], type[AdhesionLaw] | None], str] = {}


def torque_range(least: float, most: float) -> str:
    """Return text for the torque range from `least` to `most`, N*m; an infinite limit is left out."""
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


@cache
def layout_of(kind: type[Controller]) -> Layout:
    """Return the positions of a controller class's states and parameters in the arrays of the compiled simulation."""
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
