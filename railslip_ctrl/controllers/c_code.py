"""Any controller as C99, with its guard: a header and a source file, translated from the Python that its runs have.

Fields of the records become fields of structures, the functions of the step and of `guard` become functions
(`c_function`). Numbers are of one type, double, or float if `..._FLOAT32` is defined. A generated sliding-mode law has
such a program without a controller's numbers (`law_program`).
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
from .guard import Guard, Status, guarded, is_good, step_parameters, taken
from .translate import MATH, MEASURED, MEASUREMENT, PARAMETERS, STATE, Function, read_step

if TYPE_CHECKING:
    from railslip_ctrl.sliding.code import LawCode

_PREFIX = "slip_"
"""Before the names of a step's functions, which may be those of other functions of the program or of C."""
_BOUNDS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))


@dataclass(frozen=True)
class CProgram:
    """The header and the source file of a controller, and the prefix of their names."""

    header: str
    source: str
    prefix: str

    @property
    def in_one_file(self) -> str:
        """Both as one translation unit."""
        _, _, after_include = self.source.partition('.h"\n')
        return self.header + after_include


@dataclass(frozen=True)
class Member:
    """A field of a structure: name, meaning with unit, what it must be, length if it is an array, number."""

    name: str
    comment: str
    rules: tuple[str, ...]
    length: int | None = None
    value: Any = 0.0

    @property
    def declaration(self) -> str:
        """In a structure."""
        return f"{c_name(self.name)}{'' if self.length is None else f'[{max(self.length, 1)}]'};"

    @property
    def initialiser(self) -> str:
        """Its number, or its numbers."""
        if self.length is None:
            return _real(self.value)
        return "{" + ", ".join(map(_real, self.value or (0.0,))) + "}"


def c_program(
    control: Controller, vehicle: Vehicle, *, name: str = "", rail: Rail = Rail.DRY, notes: Iterable[str] = ()
) -> CProgram:
    """A controller with its numbers as C99.

    - control: a controller.
    - vehicle: what it believes where its parameters do not say it; its name stands in the header.
    - name: of the two files, without ending; left out, the controller's label.
    - rail: whose reference slip is set at first.
    - notes: lines for the head of the header.

    InputError: a controller known by a Python step alone, or without numbers that it needs.
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


LAW_INPUTS = {"v": "train_speed", "omega": "wheel_speed", "Ta": "adhesion_torque"}
"""Arguments of the generated law's step, and of the step in C."""


def law_program(code: LawCode, *, name: str = "asmc") -> CProgram:
    """A generated sliding-mode law as C99, with its guard; `name` is that of the two files, without ending.

    The numbers are the user's: the default parameters have zeros, most of which init refuses. The numbers of an
    adhesion law that come with the law are definitions in the header.
    """
    law = module_of(code.python)
    step = read_step(law.law_step, {"state": STATE, "p": PARAMETERS})
    state = _state_members((law.State,), law.State.__annotations__, law.start)
    parameters = [
        Member(one, *_described((law.Parameters,), one), value=law.Parameters._field_defaults.get(one, 0.0))
        for one in law.Parameters._fields
    ]
    limits = {one: info.get_default() for one, info in Guard.model_fields.items() if not info.is_required()}
    limits = dict.fromkeys(Guard.model_fields, 0.0) | limits
    numbers = {one.rail: [f".adhesion_{key} = {value!r}" for key, value in one.parameters] for one in code.numbers}

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
    """The program of a step: members of its state and parameters, numbers of its guard, head by operation count, and
    the initialisers of an adhesion law on each rail."""
    prefix = f"railslip_{_stem(name)}"
    limits = [Member(one, *_described((Guard,), one), value=value) for one, value in guard.items()]
    functions, count = _functions(prefix, step, {STATE: state, PARAMETERS: law})
    lengths = [one.length for one in (*state, *law) if one.length is not None]
    paragraphs = head(count(max(lengths, default=1)))
    places = {STATE: "&state->law", MEASUREMENT: "&m", PARAMETERS: "&parameters->law"}
    inputs = [one for one in step.arguments if one not in step.roles]
    own = {
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "name": name,
        "head": "\n".join(
            f" * {line}".rstrip() for one in paragraphs for line in textwrap.wrap(commented(one), WIDTH - 4) or [""]
        ),
        "macros": [
            _wrapped(f"#define {prefix.upper()}_ADHESION_{rail.name} {', '.join(entries)}", "").replace("\n", " \\\n")
            for rail, entries in adhesion.items()
        ],
        "state": state,
        "guard_state": [Member(one, *_described((Guard.State,), one), value=value) for one, value in Guard.State()],
        "parameters": law,
        "limits": limits,
        "statuses": list(Status),
        "math": [one for one in MATH if one != "isfinite"],
        "functions": functions,
        "step": f"{_PREFIX}{step.name}",
        "given": ", ".join(places[step.roles[one]] if one in step.roles else LAW_INPUTS[one] for one in step.arguments),
        "more": [LAW_INPUTS[one] for one in inputs if LAW_INPUTS[one] not in MEASURED],
        "wrapped": _wrapped,
        "real": _real,
        "guard": guard,
        "checks": [*_checks("law", law), *_checks("limits", limits)],
    }
    templates = environment("railslip_ctrl.controllers")
    header, source = (templates.get_template(f"controller.{one}.jinja").render(own) for one in ("h", "c"))
    return CProgram(header, source, prefix)


def _stem(name: str) -> str:
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower() or "controller"


def _functions(prefix: str, step: Function, members: Mapping[str, list[Member]]) -> tuple[list[str], Any]:
    """Texts of the functions in order, and their operations as a function of the longest loop."""
    measured = {MEASUREMENT: f"{prefix}_measurement"}
    lengths = {(role, one.name): one.length for role, own in members.items() for one in own if one.length is not None}
    of_law = Structures({STATE: f"{prefix}_law", PARAMETERS: f"{prefix}_parameters_law", **measured}, lengths, _PREFIX)
    of_guard = Structures({STATE: f"{prefix}_guard", PARAMETERS: f"{prefix}_limits", **measured})
    found = [CFunction(one, of_law) for one in step.all().values()]
    found += [CFunction(read_step(one), of_guard) for one in (is_good, taken, guarded)]

    def operations(bound: int) -> int:
        known: dict[str, int] = {}
        for one in found:
            known[one.name] = one.operations(bound, known)
        return known[step.name] + sum(known[each.__name__] for each in (is_good, taken, guarded))

    return [one.text for one in found], operations


# --- fields -----------------------------------------------------------------------------------------------------------


def _state_members(owners: Iterable[type], names: Iterable[str], start: Callable[[float], Any]) -> list[Member]:
    """The state with its numbers at the start; "train_speed" for one that begins as that."""
    slow, fast = start(1.0), start(2.0)
    found = []
    for name in names:
        value, other = getattr(slow, name), getattr(fast, name)
        length = len(value) if isinstance(value, tuple | list) else None
        if (value, other) == (1.0, 2.0):
            value = "train_speed"
        elif repr(value) != repr(other):  # of NaN too
            raise InputError(
                f"state: {name} at the start is neither the train speed nor the same at every speed; set it in the "
                "first sample"
            )
        found.append(Member(name, *_described(owners, name), length, value))
    return found


def _parameter_members(control: Controller, step: Function, values: Mapping[str, Any]) -> list[Member]:
    """The parameters that a step reads, with their numbers."""
    read = {
        node.attr
        for one in step.all().values()
        for node in ast.walk(one.node)
        if isinstance(node, ast.Attribute) and one.role(node.value) == PARAMETERS
    }
    owners, found = (type(control), *control.described_in()), []
    for name in dict.fromkeys(("period", *control.parameter_fields(), *values)):
        if name not in read and name != "period":
            continue
        comment, rules = _described(owners, name)
        length = len(values[name]) if isinstance(values[name], tuple | list) else None
        found.append(Member(name, comment, rules if length is None else (), length, values[name]))
    return found


_OF_EVERY_STEP = {
    "period": ("sampling period, s", (f"{{}} >= REAL({LEAST_PERIOD})",)),
    "reference_slip": ("reference slip ratio, 1", ("{} > REAL(0.0)", "{} < REAL(1.0)")),
}
"""Parameters that every step has."""


def _described(owners: Iterable[type], name: str) -> tuple[str, tuple[str, ...]]:
    """Meaning with unit of a field, and its bounds as conditions on {}; empty where no owner has the field.

    An owner is a record, or a class of a generated law, whose fields are annotated with meaning and bounds.
    """
    if name in _OF_EVERY_STEP:
        return _OF_EVERY_STEP[name]
    for owner in owners:
        if issubclass(owner, Record):
            if (info := owner.model_fields.get(name)) is None or info.description is None:
                continue
            extra = info.json_schema_extra
            unit = f", {extra['unit']}" if isinstance(extra, dict) and "unit" in extra else ""
            bounds = ((sign, getattr(one, key, None)) for one in info.metadata for key, sign in _BOUNDS)
            rules = tuple(f"{{}} {sign} {_real(float(bound))}" for sign, bound in bounds if bound is not None)
            return commented(f"{info.description}{unit}"), rules
        elif (hint := owner.__annotations__.get(name)) is not None:
            meaning, *bounds_ = hint.__metadata__
            return meaning, tuple(f"{{}} {sign} {_real(float(x))}" for sign, x in map(str.split, bounds_))
    return "", ()


def _checks(part: str, members: list[Member]) -> Iterator[tuple[str, int | None, tuple[str, ...]]]:
    """Of each field its text, length, and the conditions that `init` asks of it."""
    for one in members:
        text = f"parameters->{part}.{c_name(one.name)}"
        finite = f"is_finite({text}{'' if one.length is None else '[i]'})"
        if part == "law" and one.name in ("torque_min", "torque_max"):
            finite = f"{text} <= REAL(HUGE_VAL)"  # without a limit it is infinite, but never NaN
        given = one.value == one.value  # NaN stands for a parameter that is left out
        yield text, one.length, (finite, *(rule.format(text) for rule in one.rules)) if given else ()


def _real(value: Any) -> str:
    if value == "train_speed":
        return "train_speed"
    return number(float(value))


def _wrapped(text: str, margin: str = "    ") -> str:
    """Text in lines of a block."""
    lines = textwrap.wrap(margin + text, WIDTH, subsequent_indent=margin + "    ", break_long_words=False)
    return "\n".join(lines)


def _operations(count: int) -> str:
    return (
        f"A call of the step function takes at most {count} operations on numbers, whatever is measured; a loop "
        "without a fixed end counts as long as the longest array. It allocates nothing and does not recurse."
    )


def _head(control: Controller, vehicle: Vehicle, period: float) -> tuple[str, ...]:
    """What the header says first."""
    digest = hashlib.sha256(control.toml.encode()).hexdigest()
    over = control.controlled_from
    below = f"Below {over / KMH:.4g} km/h it does not control slip; it then holds {control.handed_over()}."
    return (
        f"Slip controller {control.label!r}: {control.title} ({control.source}).",
        f"Written by railslip_ctrl {__version__}: do not edit. SHA-256 of its controller file: {digest}.",
        "",
        f"Vehicle: {vehicle.name}. SI units throughout: m, s, kg, N, rad. Call the init function once when the brake "
        f"is applied, and the step function every {period:g} s.",
        below if over > 0 else "It controls slip at every speed.",
    )
