"""Numbers with units: the one place where text becomes SI.

Inside the package every number is SI. At its edges (command line, TOML) a plain number is in the unit the
option or key states, and a string may carry its own unit ("65 N*m/(km/h)"); it is converted here and
refused when its dimension is wrong. Pint is imported only when a string carries a unit.
"""

from __future__ import annotations

import math
import re
import tokenize
from functools import cache
from typing import TYPE_CHECKING, Any

from pydantic import Field

from .errors import InputError

if TYPE_CHECKING:
    import pint

# A quantity is short; the bound keeps nonsense out of the unit parser.
_LONGEST_QUANTITY = 60
_QUANTITY = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-zµ°%(][\w*/^().·²³µ°% -]*)?\s*$")

KMH = 1.0 / 3.6
"""One kilometre per hour in m/s (exact)."""


# What the unit parser raises on malformed text, besides its own errors (all of which derive from these).
_UNIT_PARSER_FAILURES = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    RecursionError,
    SyntaxError,
    TypeError,
    ValueError,
    tokenize.TokenError,
)


@cache
def _registry() -> pint.UnitRegistry[Any]:
    import pint

    return pint.UnitRegistry(cache_folder=None)


def to_unit(value: object, unit: str, *, name: str) -> float:
    """Return `value` as a finite number of `unit`.

    Parameters
    ----------
    value : number or str
        A number is taken to be in `unit` already; a string may be a number or a number with a unit of the
        same dimension.
    unit : str
        Unit of the result, in Pint's spelling: "kg", "N*m/(m/s)", "km/h", "1" for a pure number.
    name : str
        What to call the quantity in an error.

    Raises
    ------
    InputError
        Not a number, not finite, or of another dimension.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise InputError(f"{name}: {value!r} is not a number{_in(unit)}")
    if isinstance(value, str):
        value = _parse(value, unit, name)
    number = float(value)
    if not math.isfinite(number):
        raise InputError(f"{name}: {number} is not allowed; give a finite number{_in(unit)}")
    return number


def _in(unit: str) -> str:
    return "" if unit == "1" else f" in {unit}"


def _parse(text: str, unit: str, name: str) -> float:
    if text.strip().lower() in {"nan", "inf", "+inf", "-inf", "infinity", "-infinity"}:
        return float(text)
    match = _QUANTITY.match(text) if len(text) <= _LONGEST_QUANTITY else None
    if match is None:
        raise InputError(f"{name}: {text[:_LONGEST_QUANTITY]!r} is not a number{_in(unit)}, with or without a unit")
    number, given = float(match[1]), match[2]
    if given is None:
        return number
    return number * _factor(given.strip(), unit, name, text)


def _factor(given: str, unit: str, name: str, text: str) -> float:
    import pint

    registry = _registry()
    try:
        return float(registry.Quantity(1.0, registry.parse_units(given)).to("" if unit == "1" else unit).magnitude)
    except pint.DimensionalityError:
        raise InputError(f"{name}: {text!r} has the wrong dimension; it must be convertible to {unit!r}") from None
    except _UNIT_PARSER_FAILURES:
        raise InputError(f"{name}: {given!r} in {text!r} is not a unit; give a number{_in(unit)}") from None


def quantity(
    unit: str,
    description: str,
    *,
    default: Any = ...,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> Any:
    """A field of a parameter record (`parameters.Record`): a float in `unit` that may be given as a string with a unit.

    Written `mass: float = quantity("kg", "quarter-car mass M", gt=0)`; without `default` the field is required.
    """
    return Field(default, gt=gt, ge=ge, lt=lt, le=le, description=description, json_schema_extra={"unit": unit})
