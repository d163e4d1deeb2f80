"""Where a report comes from: the command, its options, and the software it ran on."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from importlib.metadata import version

from railslip_ctrl import __version__

_PACKAGES = {
    "control": "python-control",
    "numpy": "NumPy",
    "scipy": "SciPy",
    "sympy": "SymPy",
    "numba": "Numba",
    "matplotlib": "Matplotlib",
}


@dataclass(frozen=True)
class Provenance:
    """The command line, and its options with their values (names of input files among them)."""

    command: str
    options: tuple[tuple[str, str], ...]


def software() -> dict[str, str]:
    """Versions of this package, of Python, and of the libraries that computed or drew something, by name."""
    own = {"railslip_ctrl": __version__, "Python": platform.python_version()}
    return own | {shown: version(name) for name, shown in _PACKAGES.items()}
