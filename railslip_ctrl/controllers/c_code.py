"""Writes a controller as C99, with the guard for bad samples and locked wheels, in a header and a source file.

The module `c_function` translates the Python functions that simulations call. All numbers in C are double, or float if
the macro PREFIX_FLOAT32 is defined, where PREFIX is the program's name in capitals.
"""

from __future__ import annotations

import ast
import hashlib
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from railslip_ctrl import __version__
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.templates import environment
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.vehicle import Rail, Record, Vehicle
from railslip_ctrl.sliding.law import module_of

from .base import LEAST_PERIOD, PERIOD, Controller
from .c_function import WIDTH, CFunction, Structures, c_name, commented, number
from .guard import Guard, Status, guarded, is_good, step_parameters, valid_applied_torque
from .translate import MATH, MEASURED, MEASUREMENT, PARAMETERS, STATE, Function, read_step

if TYPE_CHECKING:
    from railslip_ctrl.sliding.code import LawCode

_PREFIX = "slip_"  # of the translated C functions, so that their names differ from others in the program
_BOUNDS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))


@dataclass(frozen=True)
class CProgram:
    """C program of a controller: text of the header file, text of the source file, and prefix of all public names."""

    header: str
    source: str
    prefix: str

    @property
    def in_one_file(self) -> str:
        _, _, after_include = self.source.partition('.h"\n')
        return self.header + after_include


@dataclass(frozen=True)
class Member:
    """Field of a C structure; `length` is None unless it is an array. In the C conditions `rules`, {} is the value."""

    name: str
    comment: str
    rules: tuple[str, ...]
    length: int | None = None
    value: Any = 0.0

    @property
    def declaration(self) -> str:
        return f"{c_name(self.name)}{'' if self.length is None else f'[{max(self.length, 1)}]'};"

    @property
    def initialiser(self) -> str:
        if self.length is None:
            return _real(self.value)
        return "{" + ", ".join(map(_real, self.value or (0.0,))) + "}"


def c_program(
    control: Controller, vehicle: Vehicle, *, name: str = "", rail: Rail = Rail.DRY, notes: Iterable[str] = ()
) -> CProgram:
    """Return a controller as a C99 program whose default parameters are the numbers of the controller.

    - control: the controller.
    - vehicle: provides the vehicle parameters that the controller does not set itself.
    - name: name of the two files, without ending; by default the controller's label.
    - rail: rail for which the default parameters, for example the reference slip, are computed.
    - notes: lines for the comment at the top of the header.

    InputError if the controller is a user's Python object or function, or if a required adhesion law or reference slip
    is missing.
    """
    control = control.believing(vehicle)
    period = PERIOD if control.period is None else control.period
    step, values = read_step(control.whole_step), step_parameters(control, rail, period)
    state = _state_members(control.described_in(), control.state_fields(), lambda speed: control.start(speed, period))
    law = _parameter_members(control, step, values)
    guard = dict(Guard.for_controller(control, vehicle, period))

    def head(operations: int) -> Iterable[str]:
        return (*_head(control, vehicle, period), _operations(operations), *notes, *control.cautions)

    return _program(name or _stem(control.label), step, state, law, guard, head)


# C names of the arguments of the generated law
LAW_INPUTS = {"v": "train_speed", "omega": "wheel_speed", "Ta": "adhesion_torque"}


def law_program(code: LawCode, *, name: str = "asmc") -> CProgram:
    """Return a generated sliding-mode law and its guard as a C99 program; `name` is the file name without ending.

    The law's parameters are 0 by default. The C function init rejects most of them if they are 0, so the user of the
    program must set them. If the law was generated from an adhesion file, the header has macros with the parameters of
    this file.
    """
    law = module_of(code.python)
    step = read_step(law.law_step, {"state": STATE, "p": PARAMETERS})
    state = _state_members((law.State,), law.State.__annotations__, law.start)
    parameters = [
        Member(field, *_described((law.Parameters,), field), value=law.Parameters._field_defaults.get(field, 0.0))
        for field in law.Parameters._fields
    ]
    limits = {field: info.get_default() for field, info in Guard.model_fields.items() if not info.is_required()}
    limits = dict.fromkeys(Guard.model_fields, 0.0) | limits
    numbers = {rows.rail: [f".adhesion_{key} = {value!r}" for key, value in rows.parameters] for rows in code.numbers}

    def head(operations: int) -> Iterable[str]:
        return (*code.head, "", _operations(operations))

    return _program(name, step, state, parameters, limits, head, numbers)


def _program(
    name: str,
    step: Function,
    state: list[Member],
    law: list[Member],
    guard: Mapping[str, float],
    head: Callable[[int], Iterable[str]],
    adhesion: Mapping[Rail, list[str]] = MappingProxyType({}),
) -> CProgram:
    prefix = f"railslip_{_stem(name)}"
    limits = [Member(field, *_described((Guard,), field), value=value) for field, value in guard.items()]
    functions, count = _functions(prefix, step, {STATE: state, PARAMETERS: law})
    lengths = [member.length for member in (*state, *law) if member.length is not None]
    paragraphs = head(count(max(lengths, default=1)))
    addresses = {STATE: "&state->law", MEASUREMENT: "&m", PARAMETERS: "&parameters->law"}
    inputs = [name for name in step.arguments if name not in step.roles]
    context = {
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "name": name,
        "head": "\n".join(
            f" * {line}".rstrip() for text in paragraphs for line in textwrap.wrap(commented(text), WIDTH - 4) or [""]
        ),
        "macros": [
            _wrapped(f"#define {prefix.upper()}_ADHESION_{rail.name} {', '.join(entries)}", "").replace("\n", " \\\n")
            for rail, entries in adhesion.items()
        ],
        "state": state,
        "guard_state": [
            Member(field, *_described((Guard.State,), field), value=value) for field, value in Guard.State()
        ],
        "parameters": law,
        "limits": limits,
        "statuses": list(Status),
        "math": [function for function in MATH if function != "isfinite"],
        "functions": functions,
        "step": f"{_PREFIX}{step.name}",
        "arguments": ", ".join(
            addresses[step.roles[name]] if name in step.roles else LAW_INPUTS[name] for name in step.arguments
        ),
        "more": [LAW_INPUTS[name] for name in inputs if LAW_INPUTS[name] not in MEASURED],
        "wrapped": _wrapped,
        "real": _real,
        "guard": guard,
        "checks": [*_checks("law", law), *_checks("limits", limits)],
    }
    templates = environment("railslip_ctrl.controllers")
    header, source = (templates.get_template(f"controller.{ending}.jinja").render(context) for ending in ("h", "c"))
    return CProgram(header, source, prefix)


def _stem(name: str) -> str:
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower() or "controller"


def _functions(prefix: str, step: Function, members: Mapping[str, list[Member]]) -> tuple[list[str], Any]:
    measured = {MEASUREMENT: f"{prefix}_measurement"}
    lengths = {
        (role, member.name): member.length
        for role, fields in members.items()
        for member in fields
        if member.length is not None
    }
    of_law = Structures({STATE: f"{prefix}_law", PARAMETERS: f"{prefix}_parameters_law", **measured}, lengths, _PREFIX)
    of_guard = Structures({STATE: f"{prefix}_guard", PARAMETERS: f"{prefix}_limits", **measured})
    functions = [CFunction(function, of_law) for function in step.all().values()]
    functions += [CFunction(read_step(function), of_guard) for function in (is_good, valid_applied_torque, guarded)]

    def operations(bound: int) -> int:
        counts: dict[str, int] = {}
        for function in functions:
            counts[function.name] = function.operations(bound, counts)
        return counts[step.name] + sum(counts[own.__name__] for own in (is_good, valid_applied_torque, guarded))

    return [function.text for function in functions], operations


def _state_members(owners: Iterable[type], names: Iterable[str], start: Callable[[float], Any]) -> list[Member]:
    slow, fast = start(1.0), start(2.0)
    members = []
    for name in names:
        value, other = getattr(slow, name), getattr(fast, name)
        length = len(value) if isinstance(value, tuple | list) else None
        if (value, other) == (1.0, 2.0):
            value = "train_speed"
        elif repr(value) != repr(other):  # the text of NaN equals that of NaN
            raise InputError(
                f"state: the initial value of {name} is neither a constant nor the train speed; give a constant, and "
                "compute the value in the first call of step"
            )
        members.append(Member(name, *_described(owners, name), length, value))
    return members


def _parameter_members(control: Controller, step: Function, values: Mapping[str, Any]) -> list[Member]:
    read = {
        node.attr
        for function in step.all().values()
        for node in ast.walk(function.node)
        if isinstance(node, ast.Attribute) and function.role(node.value) == PARAMETERS
    }
    owners, members = (type(control), *control.described_in()), []
    for name in dict.fromkeys(("period", *control.parameter_fields(), *values)):
        if name not in read and name != "period":
            continue
        comment, rules = _described(owners, name)
        length = len(values[name]) if isinstance(values[name], tuple | list) else None
        members.append(Member(name, comment, rules if length is None else (), length, values[name]))
    return members


# meaning and bounds of the parameters that every controller has
_OF_EVERY_STEP = {
    "period": ("sampling period, s", (f"{{}} >= REAL({LEAST_PERIOD})",)),
    "reference_slip": ("reference slip ratio, 1", ("{} > REAL(0.0)", "{} < REAL(1.0)")),
}


def _described(owners: Iterable[type], name: str) -> tuple[str, tuple[str, ...]]:
    """Return the meaning and unit of the field `name`, and C conditions on its value, which is written as {}."""
    if name in _OF_EVERY_STEP:
        return _OF_EVERY_STEP[name]
    for owner in owners:
        if issubclass(owner, Record):
            if (info := owner.model_fields.get(name)) is None or info.description is None:
                continue
            extra = info.json_schema_extra
            unit = f", {extra['unit']}" if isinstance(extra, dict) and "unit" in extra else ""
            bounds = ((sign, getattr(mark, key, None)) for mark in info.metadata for key, sign in _BOUNDS)
            rules = tuple(f"{{}} {sign} {_real(float(bound))}" for sign, bound in bounds if bound is not None)
            return commented(f"{info.description}{unit}"), rules
        elif (hint := owner.__annotations__.get(name)) is not None:
            meaning, *bounds_ = hint.__metadata__
            return meaning, tuple(f"{{}} {sign} {_real(float(x))}" for sign, x in map(str.split, bounds_))
    return "", ()


def _checks(part: str, members: list[Member]) -> Iterator[tuple[str, int | None, tuple[str, ...]]]:
    for member in members:
        text = f"parameters->{part}.{c_name(member.name)}"
        finite = f"is_finite({text}{'' if member.length is None else '[i]'})"
        if part == "law" and member.name in ("torque_min", "torque_max"):
            finite = f"{text} <= REAL(HUGE_VAL)"  # infinite without a limit, but never NaN
        is_set = member.value == member.value  # NaN marks a parameter without a value
        yield text, member.length, (finite, *(rule.format(text) for rule in member.rules)) if is_set else ()


def _real(value: Any) -> str:
    if value == "train_speed":
        return "train_speed"
    return number(float(value))


def _wrapped(text: str, margin: str = "    ") -> str:
    lines = textwrap.wrap(margin + text, WIDTH, subsequent_indent=margin + "    ", break_long_words=False)
    return "\n".join(lines)


def _operations(count: int) -> str:
    return (
        f"A call of the step function takes at most {count} arithmetic operations for any measurement; this number "
        "assumes that loops without a fixed end are as long as the longest array. The function does not allocate or "
        "recurse."
    )


def _head(control: Controller, vehicle: Vehicle, period: float) -> tuple[str, ...]:
    digest = hashlib.sha256(control.toml.encode()).hexdigest()
    hand_over = control.controlled_from
    below = f"Below {hand_over / KMH:.4g} km/h the controller does not control slip, but holds {control.handed_over()}."
    return (
        f"Slip controller {control.label!r}: {control.title} ({control.source}).",
        f"Written by railslip_ctrl {__version__}: do not edit. SHA-256 of its controller file: {digest}.",
        "",
        f"Vehicle: {vehicle.name}. All units are SI: m, s, kg, N, rad. Call the init function once when the brake "
        f"is applied, then the step function every {period:g} s.",
        below if hand_over > 0 else "The controller controls slip at every speed.",
    )
