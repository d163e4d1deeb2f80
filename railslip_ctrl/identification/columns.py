"""The columns of a log: the quantities, the names by which a header may call them, and their units.

A header cell is a name with or without a unit: "train speed [km/h]", "Wheel speed (km/h)", "brake_torque_kNm". Case,
spaces, underscores and hyphens do not count. Accepted names, any one of each row of `NAMES`:

    time              time, t, timestamp
    train_speed       train speed, v, vehicle speed, speed, reference speed
    wheel_speed       wheel speed, v wheel, vw, circumferential speed, rolling speed
    wheel_angular_speed   wheel angular speed, omega, w, angular speed, angular velocity, rotational speed, n
    brake_torque      brake torque, tb, torque, braking torque
    wheel_load        wheel load, n, load, normal force, axle load

n is what its unit says, and a wheel load without one; a wheel speed in rad/s, rpm or the like is an angular one.
Time, train speed, brake torque and one of the wheel's two speeds must be there; other columns are not read.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown, to_unit
from railslip_ctrl.core.user_files import close_match

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "time": "s",
        "train_speed": "m/s",
        "wheel_speed": "m/s",
        "wheel_angular_speed": "rad/s",
        "brake_torque": "N*m",
        "wheel_load": "N",
    }
)
"""The quantities of a log and their SI units."""

NAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "time": ("time", "t", "timestamp"),
        "train_speed": ("train speed", "v", "vehicle speed", "speed", "reference speed"),
        "wheel_speed": ("wheel speed", "v wheel", "vw", "circumferential speed", "rolling speed"),
        "wheel_angular_speed": (
            "wheel angular speed",
            "omega",
            "w",
            "angular speed",
            "angular velocity",
            "rotational speed",
            "n",
        ),
        "brake_torque": ("brake torque", "tb", "torque", "braking torque"),
        "wheel_load": ("wheel load", "n", "load", "normal force", "axle load"),
    }
)
"""Accepted names by quantity, the first the one this package writes."""

# Spellings of measurement systems that a unit grammar does not know, or reads as something else: 1/min is rad/min to
# it, but revolutions a minute in a column of speeds.
_SPELLINGS = MappingProxyType(
    {
        **{"knm": "kN*m", "nm": "N*m", "kmh": "km/h", "kph": "km/h", "rads": "rad/s", "kn": "kN"},
        **{
            "1/min": "rpm",
            "min^-1": "rpm",
            "u/min": "rpm",
            "r/min": "rpm",
            "rev/min": "rpm",
            "rev/s": "turn/s",
            "sec": "s",
        },
    }
)
_HEADER = re.compile(r"\s*(?P<name>[^\[\](]*?)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>.*)\))?\s*")
_SUFFIX = re.compile(r"(?P<name>.+)[_ ](?P<unit>kmh|ms|rads|rpm|knm|nm|kn|s|n)", re.IGNORECASE)
_PLACE = re.compile(r"[1-9]\d*")
_SUFFIX_UNITS = MappingProxyType({"ms": "m/s", "s": "s", "n": "N", "rpm": "rpm"})


@dataclass(frozen=True)
class Column:
    """Where a quantity is in a log: the column's number, its header, and what one of its unit is in SI."""

    quantity: str
    index: int
    header: str
    factor: float
    unit_given: bool


def find_columns(
    header: Sequence[str], columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> dict[str, Column]:
    """The columns of a header by quantity, in the order of `UNITS`.

    Parameters
    ----------
    header : sequence of str
        The header's cells.
    columns : mapping, optional
        Header cell by quantity, where the names above do not find it; or its place, the first being 1.
    units : mapping, optional
        Unit by quantity; wins over the header's. Without either a column is SI.

    Raises
    ------
    InputError
        An unknown quantity, a header that is not there, two columns of one name, a missing column, or a unit of
        another dimension.
    """
    columns, units = columns or {}, units or {}
    for option, given in (("--column", columns), ("--unit", units)):
        for quantity in given:
            if quantity not in UNITS:
                raise InputError(f"{option}: {quantity!r} is not a quantity of a log; choose one of {', '.join(UNITS)}")
    found: dict[str, Column] = {}
    for quantity in UNITS:
        index = _named(header, quantity, columns[quantity]) if quantity in columns else _recognised(header, quantity)
        if index is not None:
            column = _column(quantity, index, header[index], units.get(quantity))
            other = found.get(column.quantity)
            if other is not None and quantity not in columns:
                raise _several(column.quantity, header, sorted((other.index, index)))
            found[column.quantity] = column
    _check_complete(found, header)
    return found


def with_units(header: Sequence[str], units: Sequence[str]) -> list[str]:
    """A header's cells, each with its unit of a row of them, but for those that have one; `-` and nothing are none."""
    given = [_bare(unit) for unit in units]
    return [
        f"{cell.strip()} [{unit}]" if unit not in ("", "-") and not _split(cell)[1] else cell
        for cell, unit in zip(header, given, strict=True)
    ]


def is_unit(cell: str, quantity: str) -> bool:
    """Whether a cell is a unit of a quantity, in brackets or not."""
    try:
        return _column(quantity, 0, f"x [{_bare(cell)}]", None).unit_given
    except InputError:
        return False


def _bare(unit: str) -> str:
    return unit.strip().strip("[]()").strip()


def _named(header: Sequence[str], quantity: str, wanted: str) -> int:
    at = [i for i, cell in enumerate(header) if wanted.strip() in (cell.strip(), _split(cell)[0])]
    if not at and _PLACE.fullmatch(wanted.strip()) and int(wanted) <= len(header):
        return int(wanted) - 1
    if len(at) != 1:
        count = f"{len(at)} columns are" if at else "no column is"
        hint = close_match(wanted, header)
        raise InputError(
            f"--column {quantity}: {count} called {shown(wanted)}; {hint}the header has {_cells(header)}{_places(at)}"
        )
    return at[0]


def _places(at: Sequence[int]) -> str:
    """How columns that may have one name are told apart."""
    return f", or by its place: {' or '.join(str(i + 1) for i in at)}" if len(at) > 1 else ""


def _recognised(header: Sequence[str], quantity: str) -> int | None:
    names = {_plain(name) for name in NAMES[quantity]}
    at = [
        i
        for i, cell in enumerate(header)
        if {_plain(cell), _plain(_split(cell)[0])} & names and _may_be(cell, quantity)
    ]
    if len(at) > 1:
        raise _several(quantity, header, at)
    return at[0] if at else None


def _several(quantity: str, header: Sequence[str], at: Sequence[int]) -> InputError:
    cells = _cells([header[i] for i in at])
    return InputError(
        f"header: {quantity} may be any of {cells}; say which with --column {quantity}=HEADER{_places(at)}"
    )


def _may_be(cell: str, quantity: str) -> bool:
    """Whether a cell is not one of a letter that stands for another quantity: n [1/min] is no load."""
    name, unit = _split(cell)
    if _plain(name) != "n":
        return True
    return is_unit(unit, quantity) if unit else quantity == "wheel_load"


def _column(quantity: str, index: int, cell: str, unit: str | None) -> Column:
    in_header = _split(cell)[1]
    given = unit if unit is not None else in_header
    if not given:
        return Column(quantity, index, cell.strip(), 1.0, unit_given=False)
    if quantity == "wheel_speed" and is_unit(given, "wheel_angular_speed"):
        quantity = "wheel_angular_speed"
    spelled = _SPELLINGS.get(given.strip().lower(), given.strip())
    where = f"--unit {quantity}" if unit is not None else f"header, column {cell.strip()!r}"
    try:
        factor = to_unit(f"1 {spelled}", UNITS[quantity])
    except InputError:
        raise InputError(
            f"{where}: {shown(given)} is not a unit of {quantity}; give one convertible to {UNITS[quantity]!r}, "
            f"in the header or as --unit {quantity}=UNIT"
        ) from None
    return Column(quantity, index, cell.strip(), factor, unit_given=True)


def _split(cell: str) -> tuple[str, str]:
    """A header cell's name and unit, the latter empty where there is none."""
    match = _HEADER.fullmatch(cell)
    if match is None:
        return cell.strip(), ""
    name, unit = match["name"], match["square"] or match["round"] or ""
    suffix = _SUFFIX.fullmatch(name)
    if not unit and suffix is not None:
        return suffix["name"], _SUFFIX_UNITS.get(suffix["unit"].lower(), suffix["unit"])
    return name, unit


def _plain(name: str) -> str:
    return re.sub(r"[\s_\-]+", "", name).lower()


def _cells(header: Sequence[str]) -> str:
    return ", ".join(shown(cell.strip()) for cell in header[:12]) + (", ..." if len(header) > 12 else "")


def _check_complete(found: Mapping[str, Column], header: Sequence[str]) -> None:
    wheel = ("wheel_angular_speed", "wheel_speed")
    missing = [q for q in ("time", "train_speed", "brake_torque") if q not in found]
    if not any(q in found for q in wheel):
        missing.append("wheel_speed")
    if missing:
        quantity = missing[0]
        called = " or ".join(repr(name) for name in NAMES[quantity][:2])
        raise InputError(
            f"header: no column for {quantity}; call one {called}, or give --column {quantity}=HEADER "
            f"(the header has {_cells(header)})"
        )
