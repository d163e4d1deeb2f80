"""The public API: what `import railslip_ctrl` and its rooms offer is there, listed and documented."""

import ast
import dataclasses
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pydantic
import pytest

import railslip_ctrl
from railslip_ctrl.core import errors
from railslip_ctrl.core.notation import SOURCES
from railslip_ctrl.identification.observer import TorqueObserver
from railslip_ctrl.simulation.campaign.specification import Distribution
from railslip_ctrl.simulation.controllers import Controller

ROOT = Path(railslip_ctrl.__file__).parent
ROOMS = (*("model.adhesion", "design", "loop", "simulation", "simulation.campaign"), "identification.observer")

ENTRIES = {
    "identification.identify": ("Identification", "Options", "identify", "identify_several"),
    "identification.virtual_rig": (
        *("BrakeCourse", "BrakeTrial", "Measurements", "ObserverErrors", "TradeOff"),
        *("brake_trial", "measured", "observer_errors", "trade_off"),
    ),
    "design.controllers": ("SampledController",),
    "design.specification": ("Specification",),
    "model.vehicle": (
        *("GRAVITY", "INITIAL_SPEED_KMH", "PARK2008", "Actuator", "PIGains", "Rail", "Record", "Resistance", "Vehicle"),
        *("Wheel", "doubts", "remarks", "table4_gains"),
    ),
    "model.vehicle_files": ("load_vehicle",),
    "model.linearization": ("LinearPlant", "OperatingPoint"),
    "sliding.derivation": ("Derivation",),
    "verification.joint_verification": ("verify_with_actuator",),
}
"""What is public of the modules that do not list their names."""

PROTOCOLS = (TorqueObserver, Controller, Distribution)
"""What public classes implement without inheriting it."""

UNIT = re.compile(
    r"(?<![\w'])(?:s|m|N|J|rad|deg|kg|1/s|km/h|m/s|%|SI)(?![\w'])|kg\*?m|N\*m|N m|/s\b"
    r"|\b(?:[Rr]atios?|share|[Ff]actors?|[Nn]umber of|dimensionless|units?|as printed)\b"
)
"""A unit, or a word that says that there is none or where it is given."""

SHAPE = re.compile(r"\d-D|\bshape|of one length|array,? \([\w, ]+\)|\b[a-z] by [a-z0-9]\b")


def public() -> dict[str, Any]:
    """Everything offered at the top, by the rooms that list their names, and the other entries."""
    found = {f"railslip_ctrl.{name}": getattr(railslip_ctrl, name) for name in railslip_ctrl.__all__}
    offered = {room: importlib.import_module(f"railslip_ctrl.{room}").__all__ for room in ROOMS}
    for room, names in (offered | ENTRIES).items():
        module = importlib.import_module(f"railslip_ctrl.{room}")
        found |= {f"{room}.{name}": getattr(module, name) for name in names}
    return found


FUNCTIONS = {name: inspect.unwrap(thing) for name, thing in public().items() if inspect.isroutine(thing)}
CLASSES = {name: thing for name, thing in public().items() if inspect.isclass(thing)}
THINGS = FUNCTIONS | CLASSES


def test_the_top_lists_what_it_offers() -> None:
    tree = ast.parse((ROOT / "__init__.pyi").read_text(encoding="utf-8"))
    imported = [alias for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert all(alias.name == alias.asname for alias in imported)  # else a type checker takes the name for private
    assert {alias.name for alias in imported} == set(railslip_ctrl.__all__) - {"__version__"}
    assert dir(railslip_ctrl) == sorted(railslip_ctrl.__all__)
    with pytest.raises(AttributeError, match="no attribute 'derivee'"):
        _ = railslip_ctrl.derivee


def test_every_error_of_the_package_is_at_the_top_and_a_builtin_too() -> None:
    own = {name for name, thing in vars(errors).items() if inspect.isclass(thing) and issubclass(thing, Exception)}
    assert own <= set(railslip_ctrl.__all__)
    for name in own - {"RailslipError"}:
        bases = getattr(errors, name).__mro__
        assert errors.RailslipError in bases
        assert any(base.__module__ == "builtins" and base not in (Exception, BaseException, object) for base in bases)


def test_no_room_takes_its_names_from_the_top_and_every_source_key_resolves() -> None:
    """What is at the top is of rooms of every height: the import contract does not see through it. [Name2008] cites."""
    for path in ROOT.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for names in re.findall(r"from (?:railslip_ctrl|\.+) import \(?([\w\s,]+)", text):
            assert not set(re.findall(r"\w+", names)) & set(railslip_ctrl._HOME), path.relative_to(ROOT)
        keys = re.findall(r"\[([A-Z][A-Za-z]+(?:19|20)\d\d[a-z]?)\]", text)
        assert set(keys) <= set(SOURCES), path.relative_to(ROOT)


@pytest.mark.parametrize("name", THINGS)
def test_every_argument_and_field_is_documented_and_every_number_has_its_unit_and_shape(name: str) -> None:
    """The first paragraph of a class may give unit and shape of all its fields."""
    thing = THINGS[name]
    text, asked = documentation(thing), arguments_of(thing)
    assert text, f"{name} has no docstring"
    missing = [argument for argument in asked if not entry(text, argument)]
    assert not missing, f"{name}: {', '.join(missing)} not in its docstring"
    assert not unsaid(text, asked, general=text.partition("\n\n")[0] if inspect.isclass(thing) else "")


@pytest.mark.parametrize("name", [name for name, thing in CLASSES.items() if not issubclass(thing, Exception)])
def test_every_public_method_says_what_it_takes(name: str) -> None:
    """With its unit and shape; in its own docstring, or that of what it implements, or else in the class's."""
    thing = CLASSES[name]
    (node,) = ast.parse(inspect.getsource(thing)).body
    for method in (one for one in node.body if isinstance(one, ast.FunctionDef) and one.name[0] != "_"):
        bases = (base for base in (*thing.__mro__, *PROTOCOLS) if method.name in vars(base))
        said = [vars(base)[method.name].__doc__ or "" for base in bases]
        assert any(said), f"{name}.{method.name} has no docstring"
        own, whole = inspect.cleandoc("\n\n".join(map(inspect.cleandoc, said))), documentation(thing)
        for argument in (*method.args.args, *method.args.kwonlyargs):
            if argument.arg not in ("self", "cls") and argument.annotation is not None:
                asked = {argument.arg: ast.unparse(argument.annotation)}
                told = any(entry(text, argument.arg) and not unsaid(text, asked, general="") for text in (own, whole))
                assert told, f"{name}.{method.name}: {argument.arg} is not in its docstring with its unit and shape"


def documentation(thing: Any) -> str:
    """The docstring of a function, or those of a class and of the package's classes it is made from."""
    if not inspect.isclass(thing):
        return inspect.getdoc(thing) or ""
    own = (base for base in thing.__mro__ if base.__module__.startswith("railslip_ctrl"))
    return "\n\n".join(inspect.cleandoc(base.__doc__ or "") for base in own)


def arguments_of(thing: Any) -> dict[str, str]:
    """Arguments of a function, or fields of a class, and their types."""
    if not inspect.isclass(thing):
        return {name: str(argument.annotation) for name, argument in inspect.signature(thing).parameters.items()}
    if issubclass(thing, pydantic.BaseModel):
        return {field: str(info.annotation) for field, info in thing.model_fields.items()}
    if dataclasses.is_dataclass(thing):
        return {field.name: str(field.type) for field in dataclasses.fields(thing) if not field.name.startswith("_")}
    return {field: str(thing.__annotations__[field]) for field in getattr(thing, "_fields", ())}


def entry(text: str, name: str) -> str:
    """What a docstring says of an argument: its entry in a list, else the sentences that name it; "" if nothing."""
    block = re.search(rf"^- (?:[\w, ]*[ ,])?{name}(?:,[\w, ]*)?(?::.*)?$(?:\n {{2}}.*)*", text, flags=re.M)
    if block:
        return block[0]
    sentences = re.split(r"(?<=[.;])\s+|\n\n", text)
    return " ".join(sentence for sentence in sentences if re.search(rf"(?<!\w){name}(?!\w)", sentence))


def unsaid(text: str, annotations: dict[str, str], *, general: str) -> list[str]:
    """Numbers that have no unit, and arrays that have no shape, in what is said of them or in general."""
    found = []
    for name, annotation in annotations.items():
        array = re.search(r"ArrayLike|Floats|NDArray|Complexes", annotation)
        if annotation.startswith("Callable") or not (array or re.search(r"\bfloat\b", annotation)):
            continue
        said = entry(text, name)
        for pointed_at in re.findall(r"[Aa]s (?:of|for)\s+`(?:[\w.]+\.)?(\w+)`", said)[:1]:
            said += "".join(entry(documentation(THINGS[one]), name) for one in THINGS if one.endswith(f".{pointed_at}"))
        found += [] if UNIT.search(said) or UNIT.search(general) else [f"{name}: no unit in {said!r}"]
        found += [] if not array or SHAPE.search(said) or SHAPE.search(general) else [f"{name}: no shape in {said!r}"]
    return found
