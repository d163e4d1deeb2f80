"""Records from the user's Python files, by the name that the file gives them.

Such a file is run as a script is: give only files that you trust.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from railslip_ctrl.errors import InputError

from .validation import file_name, read_text


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
        message = " ".join(str(error).split())
        raise InputError(f"{where}: running it fails with {type(error).__name__}: {message}; mend the file") from error
    found = getattr(module, name, None)
    missing = [attribute for attribute in needed if not hasattr(found, attribute)]
    if found is None or missing:
        lacking = f"has no {name}" if found is None else f"{name} has no {', '.join(missing)}"
        raise InputError(f"{where}: {lacking}; name a record that has {', '.join(needed)} so")
    return found
