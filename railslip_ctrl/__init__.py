"""railslip_ctrl: wheel-slip control design for trains.

The public names of the package load on first use, so that an import or a command is fast. All other names are in the
following packages, whose docstrings say where to begin. A package imports only from packages before it: `core`,
`model`, `loop`, `sliding`, `controllers`, `design`, `simulation`, `verification`, `identification`, `paper`, `report`,
`page` and `cli`.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

__version__ = "0.1.0"

_HOME = {
    alias.name: f".{line.module}"
    for line in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(line, ast.ImportFrom)
    for alias in line.names
}
"""Module of each public name, read from the stub file that type checkers and editors use."""

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = import_module(_HOME[name], __name__)
    return getattr(home, name) if hasattr(home, name) else import_module(f"{_HOME[name]}.{name}", __name__)


def __dir__() -> list[str]:
    return sorted(__all__)
