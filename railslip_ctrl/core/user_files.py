"""Reading the user's files: text, TOML, and the checker's complaints as one line.

A message reads `file: key: value is not allowed; remedy`, whatever was wrong with the file.
"""

from __future__ import annotations

import os
import sys
import sysconfig
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from .errors import InputError
from .units import shown

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails


_M = TypeVar("_M", bound=BaseModel)

LARGEST_FILE = 1_000_000  #: bytes; a parameter file has a few thousand, and a parser should not be handed a disk image

# pydantic's names of the range violations: (sign, key of the bound in the error's context)
_RANGES = {
    "greater_than": (">", "gt"),
    "greater_than_equal": (">=", "ge"),
    "less_than": ("<", "lt"),
    "less_than_equal": ("<=", "le"),
}
_KINDS = {
    **{"string_type": "text in quotes", "bool_type": "true or false"},
    **dict.fromkeys(("int_type", "int_from_float", "int_parsing"), "an integer"),
    **dict.fromkeys(("model_type", "model_attributes_type", "dict_type"), "a table of keys"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
}


def given_path(value: object, name: str = "path") -> Path:
    """Return a path given as text or as a `Path`; InputError, which begins with `name`, for anything else."""
    if isinstance(value, (str, os.PathLike)) and value:
        return Path(value)
    raise InputError(f"{name}: {shown(value)} is not a path; give the name of a file, as text or a Path")


def read_text(path: Path, *, where: str = "") -> str:
    """The text of a parameter file: regular, UTF-8 with or without a byte-order mark, at most `LARGEST_FILE` bytes.

    InputError, which begins with `where` or else the path, for any other.
    """
    where = where or file_name(path)
    content = _read_bytes(path, where)
    if len(content) > LARGEST_FILE:
        raise InputError(f"{where}: is larger than {LARGEST_FILE} bytes; give a parameter file")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: byte {error.start + 1} is not UTF-8; save the file as UTF-8 text") from None
    if not text.strip() and path.suffix != ".py":  # a Python file has no keys: it lacks a name
        raise InputError(f"{where}: the file is empty; give at least one key")
    return text


def read_toml(path: Path) -> dict[str, Any]:
    """The keys of a TOML file; InputError as of `read_text`, or with the line of a syntax error."""
    import tomllib

    text = read_text(path)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{file_name(path)}: is nested too deeply; give plain tables of keys") from None
    except ValueError as error:  # TOMLDecodeError is one; so is an integer of more digits than Python reads
        raise InputError(f"{file_name(path)}: not valid TOML: {_flat(error)}") from None


def validated(model: type[_M], values: object, where: str) -> _M:
    """The record that `values`, a mapping of its keys or a record, make; InputError as `one_line` says it."""
    try:
        # not model_validate, in which a record calls itself by the name of its class
        return model.__pydantic_validator__.validate_python(values)  # type: ignore[no-any-return]
    except ValidationError as error:
        raise InputError(one_line(error, where, model=model)) from None


def one_line(error: ValidationError, where: str, *, model: type[BaseModel] | None = None) -> str:
    """A pydantic error as one line for the user: `where: key: value is not allowed; remedy`, and how many more.

    With `model`, the record that refused, the line gives the unit of a number and the allowed keys.
    """
    complaints = error.errors(include_url=False)
    # a misspelt key is why another is missing
    first = min(complaints, key=lambda complaint: complaint["type"] != "extra_forbidden")
    owner, field = _locate(model, first["loc"])
    key = ".".join(_key(part) for part in first["loc"])
    start = f"{where}: {key}: " if key else f"{where}: "
    more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
    reason = _reason(first, owner, field).removeprefix(f"{key}: ")  # a check may name its key itself
    return f"{start}{reason}{more}"


def unknown_key(key: str, owner: type[BaseModel] | None) -> str:
    """Return the complaint about a key that its record, where that is known, does not have."""
    if owner is None:
        return "unknown key; remove it"
    return f"unknown key; {close_match(key, owner.model_fields)}allowed: {', '.join(owner.model_fields)}"


def close_match(given: str, allowed: Iterable[str]) -> str:
    """Return "did you mean 'x'? " for the nearest of `allowed`, or nothing when none is near."""
    import difflib

    near = difflib.get_close_matches(given[:60], list(allowed), n=1)
    return f"did you mean {near[0]!r}? " if near else ""


def file_name(path: Path) -> str:
    """Return a path for an error: as given, quoted if it could break the line."""
    text = str(path)
    return text if text.isprintable() else repr(text)


def _read_bytes(path: Path, where: str) -> bytes:
    try:
        if path.is_dir():
            raise InputError(f"{where}: is a directory; give a file")
        if path.exists() and not path.is_file():  # a pipe or device may never end
            raise InputError(f"{where}: is not a regular file; give a file")
        with path.open("rb") as file:
            return file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise InputError(f"{where}: no such file; check the path") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        told = getattr(error, "strerror", None) or _flat(error)
        raise InputError(f"{where}: cannot be read ({told}); check the path and its permissions") from None


def _reason(complaint: ErrorDetails, owner: type[BaseModel] | None, field: Any) -> str:
    kind, value, context = complaint["type"], complaint["input"], complaint.get("ctx", {})
    extra = getattr(field, "json_schema_extra", None)
    unit = extra.get("unit", "1") if isinstance(extra, dict) else "1"
    in_unit = "" if unit == "1" else f" ({unit})"
    if kind in _RANGES:
        sign, bound = _RANGES[kind]
        return f"{_number(value)} is not allowed; give a value {sign} {context[bound]:g}{in_unit}"
    if kind == "value_error":
        return _flat(context["error"])
    if kind == "missing":
        meaning = getattr(field, "description", None)
        return f"missing; give it{in_unit}" + (f": {meaning}" if meaning else "")
    if kind == "extra_forbidden":
        return unknown_key(str(complaint["loc"][-1]), owner)
    if kind == "is_instance_of":
        return f"{shown(value)} is not allowed; give an instance of {context['class']}"
    if kind in ("enum", "literal_error"):
        return f"{shown(value)} is not allowed; give {context['expected']}"
    if kind in _KINDS:
        return f"{shown(value)} is not allowed; give {_KINDS[kind]}"
    return f"{shown(value)} is not allowed; {_flat(complaint['msg'])}"


def _number(value: object) -> str:
    """A number as a user writes it: converted already, it is a float, and 0 should not read 0.0."""
    return f"{value:g}" if isinstance(value, float) else shown(value)


def _locate(model: type[BaseModel] | None, loc: tuple[int | str, ...]) -> tuple[type[BaseModel] | None, Any]:
    """The record that holds the last key of `loc`, and its field there, each None where there is none."""
    owner, field = model, None
    names = [part for part in loc if isinstance(part, str)]  # a number is a place in a list of records
    for depth, part in enumerate(names):
        field = owner.model_fields.get(part) if owner is not None else None
        if depth < len(names) - 1:
            inner = (field.annotation, *get_args(field.annotation)) if field is not None else ()  # `Wheel | None`
            owner = next((one for one in inner if isinstance(one, type) and issubclass(one, BaseModel)), None)
    return owner, field


def _key(part: int | str) -> str:
    return str(part) if isinstance(part, int) or part.isidentifier() else shown(part)


def _flat(error: object) -> str:
    """A foreign message as one line."""
    return " ".join(str(error).split())


# --- records from the user's Python files ----------------------------------------------------------------------------


def place(file: str, line: int | None) -> str:
    """A line of a user's file, its path relative to the working directory."""
    path = Path(file)
    near = path.is_relative_to(Path.cwd())
    return f"{file_name(path.relative_to(Path.cwd()) if near else path)}, line {line}"


def failure(error: BaseException, what: str) -> str:
    """One line: file and line of the user's code in which `what` failed, the error, and the remedy."""
    frames = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError):
        frames.append((error.filename or "", error.lineno))
    file, line = (_own(frames) or frames)[-1]
    told = f": {_flat(error)}" if str(error) else ""
    return f"{place(file, line)}: {what} fails with {type(error).__name__}{told}; mend the file"


def _own(frames: list[tuple[str, int | None]]) -> list[tuple[str, int | None]]:
    """Those of the user's code; <string> is what dataclasses write."""
    not_own = (
        "<string>",
        str(Path(__file__).parents[1]),
        *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")),
    )
    return [frame for frame in frames if not frame[0].startswith(not_own)]


def place_of(function: Any) -> str:
    """Where a user's function is written, for a message; nothing of one that is written in C."""
    code = getattr(getattr(function, "py_func", function), "__code__", None)
    return "" if code is None else f"{place(code.co_filename, code.co_firstlineno)}: "


def call_failure(error: BaseException, function: Any, name: str, arguments: str, when: str = "") -> str:
    """As `failure`, of a call of a user's function; where it cannot even be called, with its place and arguments."""
    frames: list[tuple[str, int | None]] = [(f.filename, f.lineno) for f in traceback.extract_tb(error.__traceback__)]
    if _own(frames[1:]) or not isinstance(error, TypeError):  # the first is of the call itself
        return failure(error, name + when)
    return f"{place_of(function)}{name} cannot be called with ({arguments}): {_flat(error)}; mend it"


def record_in(path: Path, name: str, needed: Sequence[str]) -> Any:
    """Run a Python file and take what it calls `name`; InputError where that lacks an attribute `needed`."""
    where = file_name(path)
    text = read_text(path)
    module = ModuleType(f"railslip_{name.lower()}_{path.stem}")
    module.__file__ = str(path.resolve())
    sys.modules[module.__name__] = module  # dataclasses look their module up by its name
    try:  # of its text: what Python keeps compiled of a file may be of another of equal length and second
        exec(compile(text, module.__file__, "exec", dont_inherit=True), module.__dict__)
    except (Exception, SystemExit) as error:  # the user's file may fail in any way, and is an input
        raise InputError(failure(error, "running it")) from error
    found = getattr(module, name, None)
    missing = [attribute for attribute in needed if not hasattr(found, attribute)]
    if found is None or missing:
        lacking = f"has no {name}" if found is None else f"{name} has no {', '.join(missing)}"
        wanted = f"a record that has {', '.join(needed)}" if needed else "it"
        raise InputError(f"{where}: {lacking}; name {wanted} so")
    return found
