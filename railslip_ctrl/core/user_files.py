"""Reading of the user's files (text, TOML, Python); an error in a file is reported in one line.

Every message has the form `file: key: value is not allowed; remedy`.
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

LARGEST_FILE = 1_000_000  #: largest size of a file, bytes; a parameter file has a few thousand

# sign of the bound, and key of the bound in the error's context, by pydantic's name of the error
_RANGES = {
    "greater_than": (">", "gt"),
    "greater_than_equal": (">=", "ge"),
    "less_than": ("<", "lt"),
    "less_than_equal": ("<=", "le"),
}
_KINDS = {
    **{"string_type": "text in quotes", "bool_type": "true or false"},
    **dict.fromkeys(("int_type", "int_from_float", "int_parsing"), "an integer"),
    **dict.fromkeys(("model_type", "model_attributes_type", "dict_type"), "a table with lines key = value"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
}


def given_path(value: object, name: str = "path") -> Path:
    """Convert text or a `Path` to a `Path`; InputError, beginning with `name`, for anything else."""
    if isinstance(value, (str, os.PathLike)) and value:
        return Path(value)
    raise InputError(f"{name}: {shown(value)} is not a path; give the name of a file, as text or a Path")


def read_text(path: Path, *, where: str = "") -> str:
    """Read a parameter file: a regular file of at most `LARGEST_FILE` bytes, UTF-8 with or without byte-order mark.

    InputError for any other file; the message begins with `where`, by default the path.
    """
    where = where or file_name(path)
    content = _read_bytes(path, where)
    if len(content) > LARGEST_FILE:
        raise InputError(f"{where} is larger than {LARGEST_FILE} bytes; give a parameter file")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: byte {error.start + 1} is not UTF-8; save the file as UTF-8 text") from None
    if not text.strip() and path.suffix != ".py":  # for a Python file `record_in` reports the missing name
        raise InputError(f"{where}: the file is empty; give at least one key")
    return text


def read_toml(path: Path) -> dict[str, Any]:
    """Read the keys of a TOML file; InputError for invalid syntax, or for a file that `read_text` refuses."""
    import tomllib

    text = read_text(path)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{file_name(path)}: tables or lists are nested too deeply; use fewer levels") from None
    except ValueError as error:  # TOMLDecodeError, or an integer with more digits than Python allows
        raise InputError(f"{file_name(path)}: not valid TOML: {_flat(error)}") from None


def validated(model: type[_M], values: object, where: str) -> _M:
    """Convert a mapping or record to a `model` record; an InputError for wrong `values` begins with `where`."""
    try:
        # not model_validate: its errors begin with the name of the class, not with `where`
        return model.__pydantic_validator__.validate_python(values)  # type: ignore[no-any-return]
    except ValidationError as error:
        raise InputError(one_line(error, where, model=model)) from None


def one_line(error: ValidationError, where: str, *, model: type[BaseModel] | None = None) -> str:
    """Return a pydantic error as `where: key: value is not allowed; remedy`, with the number of further errors.

    - model: class of the record that raised the error; if it is given, the text contains units and allowed keys.
    """
    complaints = error.errors(include_url=False)
    # report an unknown key first: if it is misspelt, it also explains a missing key
    first = min(complaints, key=lambda complaint: complaint["type"] != "extra_forbidden")
    owner, field = _locate(model, first["loc"])
    key = ".".join(_key(part) for part in first["loc"])
    start = f"{where}: {key}: " if key else f"{where}: "
    more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
    reason = _reason(first, owner, field).removeprefix(f"{key}: ")  # some messages already name their key
    return f"{start}{reason}{more}"


def unknown_key(key: str, owner: type[BaseModel] | None) -> str:
    """Return the message for an unknown key of a record; `owner` is the class of the record, if known."""
    if owner is None:
        return "unknown key; remove it"
    return f"unknown key; {close_match(key, owner.model_fields)}allowed: {', '.join(owner.model_fields)}"


def close_match(given: str, allowed: Iterable[str]) -> str:
    """Return "did you mean 'x'? " for the member of `allowed` nearest to `given`, or empty text if none is near."""
    import difflib

    near = difflib.get_close_matches(given[:60], list(allowed), n=1)
    return f"did you mean {near[0]!r}? " if near else ""


def file_name(path: Path) -> str:
    """Return a path as text for a message, quoted if it contains unprintable characters."""
    text = str(path)
    return text if text.isprintable() else repr(text)


def _read_bytes(path: Path, where: str) -> bytes:
    try:
        if path.is_dir():
            raise InputError(f"{where} is a directory; give a file")
        if path.exists() and not path.is_file():  # reading a pipe or device may never end
            raise InputError(f"{where} is not a regular file; give a file")
        with path.open("rb") as file:
            return file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise InputError(f"{where}: no such file; check the path") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = getattr(error, "strerror", None) or _flat(error)
        raise InputError(f"{where} cannot be read ({reason}); check the path and its permissions") from None


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
    return f"{value:g}" if isinstance(value, float) else shown(value)  # 0, not 0.0


def _locate(model: type[BaseModel] | None, loc: tuple[int | str, ...]) -> tuple[type[BaseModel] | None, Any]:
    """Class of the record that contains the last key of `loc`, and the field of this key; each is None if unknown."""
    owner, field = model, None
    names = [part for part in loc if isinstance(part, str)]  # a number is an index in a list of records
    for depth, part in enumerate(names):
        field = owner.model_fields.get(part) if owner is not None else None
        if depth < len(names) - 1:
            inner = (field.annotation, *get_args(field.annotation)) if field is not None else ()  # `Wheel | None`
            owner = next(
                (member for member in inner if isinstance(member, type) and issubclass(member, BaseModel)), None
            )
    return owner, field


def _key(part: int | str) -> str:
    return str(part) if isinstance(part, int) or part.isidentifier() else shown(part)


def _flat(error: object) -> str:
    return " ".join(str(error).split())


def place(file: str, line: int | None) -> str:
    """Return the text "file, line n", with the path relative to the working directory if the file is inside it."""
    path = Path(file)
    near = path.is_relative_to(Path.cwd())
    return f"{file_name(path.relative_to(Path.cwd()) if near else path)}, line {line}"


def failure(error: BaseException, what: str) -> str:
    """Return an error in a user's code as one line: file and line, what failed (`what`), the error, the remedy."""
    frames = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError):
        frames.append((error.filename or "", error.lineno))
    file, line = (_user_frames(frames) or frames)[-1]
    message = f": {_flat(error)}" if str(error) else ""
    return f"{place(file, line)}: {what} fails with {type(error).__name__}{message}; correct the file"


def _user_frames(frames: list[tuple[str, int | None]]) -> list[tuple[str, int | None]]:
    not_own = (
        "<string>",  # code generated by dataclasses
        str(Path(__file__).parents[1]),
        *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")),
    )
    return [frame for frame in frames if not frame[0].startswith(not_own)]


def place_of(function: Any) -> str:
    """Return file and line of a user's function for a message; empty text for a function written in C."""
    code = getattr(getattr(function, "py_func", function), "__code__", None)
    return "" if code is None else f"{place(code.co_filename, code.co_firstlineno)}: "


def call_failure(error: BaseException, function: Any, name: str, arguments: str, when: str = "") -> str:
    """Return an error in the call of a user's function as one line of text, which contains `arguments` and `when`.

    If the function does not accept the arguments, the text begins with file and line of the function. Otherwise it
    is the text of `failure`, with file and line of the error.
    """
    frames: list[tuple[str, int | None]] = [(f.filename, f.lineno) for f in traceback.extract_tb(error.__traceback__)]
    if _user_frames(frames[1:]) or not isinstance(error, TypeError):  # the first frame is the call itself
        return failure(error, name + when)
    return f"{place_of(function)}{name} cannot be called with ({arguments}): {_flat(error)}; correct the function"


def record_in(path: Path, name: str, needed: Sequence[str]) -> Any:
    """Run a Python file and return its object `name`; InputError if the object lacks an attribute of `needed`."""
    where = file_name(path)
    text = read_text(path)
    module = ModuleType(f"railslip_{name.lower()}_{path.stem}")
    module.__file__ = str(path.resolve())
    sys.modules[module.__name__] = module  # dataclasses find their module by its name
    try:  # compiled from the text: cached bytecode may come from another file of equal size and time
        exec(compile(text, module.__file__, "exec", dont_inherit=True), module.__dict__)
    except (Exception, SystemExit) as error:  # the user's file is an input and may fail in any way
        raise InputError(failure(error, "running it")) from error
    record = getattr(module, name, None)
    missing = [attribute for attribute in needed if not hasattr(record, attribute)]
    if record is None or missing:
        lacking = f"has no {name}" if record is None else f"{name} has no {', '.join(missing)}"
        wanted = f"an object with {', '.join(needed)}" if needed else "an object"
        raise InputError(f"{where}: {lacking}; assign {wanted} to {name}")
    return record
