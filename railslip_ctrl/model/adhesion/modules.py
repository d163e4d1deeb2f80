"""Adhesion laws from the user's Python files: the record that the file names `LAW`, of a class of its own or ours.

Such a file is run as a script is: give only files that you trust.
"""

from __future__ import annotations

from pathlib import Path

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.parameters.modules import record_in
from railslip_ctrl.model.parameters.validation import file_name, given_path

from .base import AdhesionLaw

NAME = "LAW"
"""What the file has to call its law."""


@checked
def law_in(path: str | Path) -> AdhesionLaw:
    """Run the Python file at a path and take its law, with its parameters and reference slips.

    Raises
    ------
    InputError
        One line: the file cannot be read or run, or its `LAW` is no record of an `AdhesionLaw`.
    """
    path = given_path(path)
    law = record_in(path, NAME, ("statement", "parameters"))
    if not isinstance(law, AdhesionLaw):
        raise InputError(
            f"{file_name(path)}: {NAME} is no adhesion law with its parameters; name a record of a subclass of "
            f"AdhesionLaw so, {NAME} = MyLaw(...)"
        )
    return law.model_copy(update={"file": file_name(path)})
