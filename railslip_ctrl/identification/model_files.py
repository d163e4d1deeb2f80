"""A fitted law as the TOML file that every command takes with `--adhesion FILE`."""

from __future__ import annotations

import math
from collections.abc import Iterable

from railslip_ctrl.adhesion import AdhesionLaw, ReferenceSlip


def law_toml(law: AdhesionLaw, *, reference: ReferenceSlip | None, comments: Iterable[str] = ()) -> str:
    """The text of a law's file: numbers with all their digits, so that reading it gives the same law.

    `comments` go to its head, a line each.
    """
    lines = [*(f"# {' '.join(comment.split())}" for comment in comments)]
    lines += [f'law = "{law.name}"', f'condition = "{law.rail.value}"', "", "[parameters]"]
    for name in law.parameter_names():
        info = type(law).model_fields[name]
        extra = info.json_schema_extra
        unit = f"{extra['unit']}, " if isinstance(extra, dict) and extra.get("unit", "1") != "1" else ""
        lines.append(f"{name} = {_number(getattr(law, name))}  # {unit}{info.description}")
    if reference is not None:
        lines += ["", "[reference_slip]", f"dry = {reference.dry!r}", f"wet = {reference.wet!r}"]
    return "\n".join(lines) + "\n"


def _number(value: object) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_number(each) for each in value) + "]"
    number = float(value)  # type: ignore[arg-type]
    assert math.isfinite(number), "records refuse other numbers"
    return repr(number)
