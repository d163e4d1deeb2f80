"""An adhesion law in JSON: its name, where its parameters are from, and the parameters."""

from __future__ import annotations

from typing import Any

from railslip_ctrl.model.adhesion import AdhesionLaw


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
