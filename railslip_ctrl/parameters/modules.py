"""Records from the user's Python files, by the name that the file gives them.

Such a file is run as a script is: give only files that you trust.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
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
    read_text(path)  # what cannot be read is refused as any other file is
    module_name = f"railslip_{name.lower()}_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    assert spec is not None, "a path that ends in .py has a specification"
    assert spec.loader is not None, "and a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look their module up by its name
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # the user's file may fail in any way, and is an input
        message = " ".join(str(error).split())
        raise InputError(f"{where}: running it fails with {type(error).__name__}: {message}; mend the file") from error
    found = getattr(module, name, None)
    missing = [attribute for attribute in needed if not hasattr(found, attribute)]
    if found is None or missing:
        lacking = f"has no {name}" if found is None else f"{name} has no {', '.join(missing)}"
        raise InputError(f"{where}: {lacking}; name a record that has {', '.join(needed)} so")
    return found
