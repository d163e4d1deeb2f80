"""railslip_ctrl: wheel-slip control design for trains.

The names below load on first use, so that importing the package, or running a command, costs only what it needs.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .design import stabilizing_pi as stabilizing_pi
    from .design.tuning import tune_pi as tune_pi
    from .loop import DeadTimeLoop as DeadTimeLoop
    from .loop import Margins as Margins

__version__ = "0.1.0"

_HOME = {
    "DeadTimeLoop": ".loop",
    "Margins": ".loop",
    "stabilizing_pi": ".design",
    "tune_pi": ".design.tuning",
}

__all__ = ["DeadTimeLoop", "Margins", "__version__", "stabilizing_pi", "tune_pi"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name], __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
