"""An adhesion law in JSON: its name, where its parameters are from, and the parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from railslip_ctrl.core.errors import RailslipError
from railslip_ctrl.model.adhesion import AdhesionLaw, published_law
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH


def law_json(law: AdhesionLaw, source: str) -> dict[str, Any]:
    """The law: name, source, the rail its parameters are for, and each parameter's value (SI) and unit."""
    return {
        "name": law.name,
        "source": source,
        "rail": law.rail.value,
        "parameters": {
            name: {"value": list(value) if isinstance(value, tuple) else value, "unit": unit}
            for name, (value, unit) in law.numbers().items()
        },
    }


# --- whose an adhesion law is: published, or the user's own, and what tables, texts and pictures call it -------------


PUBLISHED, GIVEN = "published", "given"
"""Sources of a law that is from no file."""


def law_words(law: AdhesionLaw, source: str) -> str:
    """The law in words: its name if published, else "beam as given (model.toml)"."""
    if source == PUBLISHED:
        return law.name
    return f"{law.name} as given" + ("" if source == GIVEN else f" ({source})")


def source_of(law: AdhesionLaw, published: Callable[[], AdhesionLaw]) -> str:
    """The file that a law is from; else whether its numbers are those of what `published` makes."""
    if law.file is not None:
        return law.file
    return PUBLISHED if _is(law, published) else GIVEN


def source_at(point: OperatingPoint) -> str:
    """`source_of` a point's law, published for its rail, v0 and wheel load."""
    return source_of(point.law, lambda: _published_at(point))


def words_at(point: OperatingPoint) -> str:
    """`law_words` of a point's law."""
    return law_words(point.law, source_at(point))


def _published_at(point: OperatingPoint) -> AdhesionLaw:
    v0 = INITIAL_SPEED_KMH if point.initial_speed_kmh is None else point.initial_speed_kmh
    return published_law(point.adhesion, point.rail, v0, point.vehicle.wheel_load)


def _is(law: AdhesionLaw, published: Callable[[], AdhesionLaw]) -> bool:
    """Whether a law has the numbers of what `published` makes; not if there is no such law."""
    try:
        other = published()
    except RailslipError:
        return False
    return type(other) is type(law) and other.parameters() == law.parameters()
