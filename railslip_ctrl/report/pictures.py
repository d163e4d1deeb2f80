"""Drawing and writing of pictures; if drawing fails, the other files are still written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from railslip_ctrl.core.errors import InputError

from .export import FileContent, write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drawings: TypeAlias = "Mapping[str, Figure | Callable[[], Figure]]"  #: figures by name, or functions that make them


class Pictures:
    """Pictures of a result; if drawing fails, the pictures drawn before remain in `drawn`.

    - drawn: for each name of a picture, the contents of its files by suffix ("png", "svg").
    - failure: reason why a picture is missing; empty if none is missing.
    """

    def __init__(self) -> None:
        self.drawn: dict[str, dict[str, bytes]] = {}
        self.failure = ""

    def draw(self, figures: Callable[[], Drawings], forms: Sequence[str] = ("png", "svg")) -> None:
        """Draw the pictures of `figures()` that are not drawn yet; an error is stored in `failure`."""
        self.failure = ""
        try:
            from railslip_ctrl.report.plots.style import figure_files, standard_settings

            with standard_settings():
                for name, figure in figures().items():
                    if name not in self.drawn:
                        self.drawn[name] = figure_files(figure() if callable(figure) else figure, forms)
        except Exception as error:  # noqa: BLE001  # any failure of Matplotlib, fonts or LaTeX
            self.failure = f"{type(error).__name__}: {error}"

    def files(self) -> dict[str, bytes]:
        return {f"{name}.{form}": content for name, forms in self.drawn.items() for form, content in forms.items()}

    def write(self, directory: Path, written: Sequence[Path], files: Mapping[str, FileContent]) -> int:
        """Write `files` into `directory`; return their number plus the number of files `written` before.

        InputError: a picture is missing, or `files` cannot be written; the message lists the files that were written.
        """
        failure = self.failure
        try:
            written = [*written, *write_files(directory, files)]
        except InputError as error:
            failure = str(error)
        if failure:
            names = ", ".join(path.name for path in written)
            raise InputError(
                f"--out: not every picture could be made ({failure}); in {str(directory)!r} only these files are from "
                f"this run: {names}; do not use other files of this folder"
            )
        return len(written)


def write_results(
    directory: Path,
    results: Mapping[str, FileContent],
    figures: Callable[[], Drawings],
    forms: Sequence[str] = ("png", "svg"),
) -> int:
    """Write the files `results`, then draw and write the pictures; return the number of all files.

    InputError: a file cannot be written, or a picture cannot be drawn; `results` are written before the pictures.
    """
    written, pictures = write_files(directory, results), Pictures()
    pictures.draw(figures, forms)
    return pictures.write(directory, written, pictures.files())
