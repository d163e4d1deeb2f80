"""A fitted law as the TOML file that every command takes with `--adhesion FILE`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.vehicle import Rail


def law_toml(
    law: AdhesionLaw,
    *,
    reference: ReferenceSlip | None,
    wheel_load: float,
    speeds_kmh: tuple[float, float] | None = None,
    comments: Iterable[str] = (),
) -> str:
    """The text of a law's file: numbers with all their digits, so that reading it gives the same law.

    `wheel_load` is that of the log, N, `speeds_kmh` the lowest and the highest initial speed in it; `comments` go to
    its head, a line each.
    """
    lines = [*(f"# {' '.join(comment.split())}" for comment in comments)]
    lines += _head(law, wheel_load, speeds_kmh)
    lines += ["", "[parameters]"]
    for name in law.parameter_names():
        info = type(law).model_fields[name]
        extra = info.json_schema_extra
        unit = f"{extra['unit']}, " if isinstance(extra, dict) and extra.get("unit", "1") != "1" else ""
        lines.append(f"{name} = {_number(getattr(law, name))}  # {unit}{info.description}")
    if reference is not None:
        held = (f"{name} = {getattr(reference, name)!r}" for name in _held_on(law, (reference,)))
        lines += ["", "[reference_slip]", *held]
    return "\n".join(lines) + "\n"


def _held_on(law: AdhesionLaw, references: Iterable[ReferenceSlip]) -> tuple[str, ...]:
    """The rails for which a law's file has a slip to hold: what was found on wet rail alone says nothing of dry."""
    wet_alone = law.rail is Rail.WET and all(each.dry == each.wet for each in references)
    return (Rail.WET.value,) if wet_alone else tuple(ReferenceSlip.model_fields)


def _head(law: AdhesionLaw, wheel_load: float, speeds_kmh: tuple[float, float] | None) -> list[str]:
    lines = [f'law = "{law.name}"', f'condition = "{law.rail.value}"']
    if speeds_kmh is not None:
        lines.append(f"initial_speed_range = {_number(speeds_kmh)}  # km/h, v0 that the parameters are for")
    return [*lines, f"wheel_load = {wheel_load!r}  # N, of the log; forces among the parameters are those of this load"]


def polynomials_toml(
    law: AdhesionLaw,
    coefficients: Mapping[str, Sequence[float]],
    speeds_kmh: tuple[float, float],
    *,
    references: Mapping[float, ReferenceSlip],
    wheel_load: float,
    comments: Iterable[str] = (),
) -> str:
    """The text of a file with the parameters over the initial speed: `coefficients` of powers of v0 in km/h, SI.

    `law` gives name and rail condition, `speeds_kmh` the range, `references` the slips to hold by v0 in km/h, none if
    there are none; `wheel_load` and `comments` as of `law_toml`.
    """
    lines = [*(f"# {' '.join(comment.split())}" for comment in comments)]
    lines += _head(law, wheel_load, speeds_kmh)
    lines += ["", "[polynomials]  # of the initial speed v0 in km/h: constant, factor of v0, of v0^2"]
    lines += [f"{name} = {_number(tuple(coefficients[name]))}" for name in law.parameter_names()]
    if references:
        speeds = tuple(sorted(references))
        lines += [
            "",
            "[reference_slip]  # at these initial speeds, straight between",
            f"initial_speed = {_number(speeds)}",
        ]
        for name in _held_on(law, references.values()):
            lines.append(f"{name} = {_number(tuple(getattr(references[speed], name) for speed in speeds))}")
    return "\n".join(lines) + "\n"


def _number(value: object) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_number(each) for each in value) + "]"
    number = float(value)  # type: ignore[arg-type]
    assert math.isfinite(number), "records refuse other numbers"
    return repr(number)
