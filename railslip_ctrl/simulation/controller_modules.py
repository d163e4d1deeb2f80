"""Controllers from the user's Python files: the record that the file names `CONTROLLER`.

Such a file is run as a script is: give only files that you trust.
"""

from __future__ import annotations

from pathlib import Path

from railslip_ctrl.parameters.modules import record_in

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
    controller: Controller = record_in(path, NAME, _NEEDED)
    return controller
