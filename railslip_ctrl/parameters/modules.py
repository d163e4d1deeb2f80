"""Records from the user's Python files, by the name that the file gives them.

Such a file is run as a script is: give only files that you trust.
"""

from __future__ import annotations

import sys
import sysconfig
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from railslip_ctrl.errors import InputError

from .validation import file_name, read_text


def place(file: str, line: int | None) -> str:
    """A line of a user's file, named from where we are."""
    path = Path(file)
    near = path.is_relative_to(Path.cwd())
    return f"{file_name(path.relative_to(Path.cwd()) if near else path)}, line {line}"


def failure(error: BaseException, what: str) -> str:
    """File and line of the user's code in which `what` failed, how, and what to do; one line."""
    frames = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError):
        frames.append((error.filename or "", error.lineno))
    file, line = (_own(frames) or frames)[-1]
    message = " ".join(str(error).split())
    told = f": {message}" if message else ""
    return f"{place(file, line)}: {what} fails with {type(error).__name__}{told}; mend the file"


def _own(frames: list[tuple[str, int | None]]) -> list[tuple[str, int | None]]:
    """Those of the user's code."""
    not_own = (str(Path(__file__).parents[1]), *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")))
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
    return f"{place_of(function)}{name} cannot be called with ({arguments}): {' '.join(str(error).split())}; mend it"


def record_in(path: Path, name: str, needed: Sequence[str]) -> Any:
    """Run a Python file and take what it calls `name`.

    Raises
    ------
    InputError
        One line: the file cannot be read or run, or has no `name` with the attributes `needed`.
    """
    where = file_name(path)
    text = read_text(path)
    module = ModuleType(f"railslip_{name.lower()}_{path.stem}")
    module.__file__ = str(path.resolve())
    sys.modules[module.__name__] = module  # dataclasses look their module up by its name
    try:  # of its text: what Python keeps compiled of a file may be of another of equal length and second
        exec(compile(text, module.__file__, "exec", dont_inherit=True), module.__dict__)
    except Exception as error:  # the user's file may fail in any way, and is an input
        raise InputError(failure(error, "running it")) from error
    found = getattr(module, name, None)
    missing = [attribute for attribute in needed if not hasattr(found, attribute)]
    if found is None or missing:
        lacking = f"has no {name}" if found is None else f"{name} has no {', '.join(missing)}"
        wanted = f"a record that has {', '.join(needed)}" if needed else "it"
        raise InputError(f"{where}: {lacking}; name {wanted} so")
    return found
