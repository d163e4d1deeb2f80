"""Controllers from the user's Python files: the record that the file names `CONTROLLER`.

Such a file is run as a script is: give only files that you trust.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters.validation import file_name, read_text

from .controllers import Controller

NAME = "CONTROLLER"
"""What the file has to call its controller."""

_NEEDED = ("name", "period", "reference", "states", "knows_rail", "model_law", "source", "row", "start")


def controller_in(path: Path) -> Controller:
    """Run a Python file and take its controller.

    Raises
    ------
    InputError
        One line: the file cannot be read or run, or has no `CONTROLLER` with what `controllers.Controller` asks for.
    """
    where = file_name(path)
    read_text(path)  # what cannot be read is refused as any other file is
    module_name = f"railslip_controller_{path.stem}"
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
    found = getattr(module, NAME, None)
    missing = [name for name in _NEEDED if not hasattr(found, name)]
    if found is None or missing:
        lacking = f"has no {NAME}" if found is None else f"{NAME} has no {', '.join(missing)}"
        raise InputError(f"{where}: {lacking}; name a record that has {', '.join(_NEEDED)} so")
    controller: Controller = found
    return controller
