"""Conversion of numbers and text with units, and rounding to the safe side.

A plain number is in the unit that its option or key states. Text may have its own unit ("65 N*m/(km/h)"). Text without
a unit is accepted on the command line and refused in records and files. Options, TOML files and log headers accept
the same units: first those named in `TRADE_UNITS`, then those of Pint. Pint is imported only for text with a unit.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Iterator
from functools import cache
from numbers import Real
from tokenize import TokenError
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from pydantic import Field

from .errors import InputError

if TYPE_CHECKING:
    import pint

KMH = 1.0 / 3.6  #: one kilometre per hour in m/s (exact)
_LONGEST_QUANTITY = 60  # characters; longer text is refused without parsing it
_QUANTITY = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*(\D.*)?", re.DOTALL)
_NOT_FINITE = re.compile(r"\s*[+-]?(nan|inf|infinity)\s*", re.IGNORECASE)

_MINUS = str.maketrans({"\N{MINUS SIGN}": "-"})  # word processors and spreadsheets replace a hyphen by it

TRADE_UNITS = MappingProxyType(
    {"s": "s", "sec": "s", "ms": "ms", "msec": "ms", "us": "us", "min": "min", "h": "h", "hr": "h"}
    | {"m": "m", "mm": "mm", "km": "km", "kg": "kg"}
    | dict.fromkeys(("t", "tonne", "tonnes"), "tonne")
    | dict.fromkeys(("kmh", "kph", "kmph"), "km/h")
    | {"mph": "mile/h", "mps": "m/s", "rad": "rad", "rads": "rad/s", "rpm": "rpm", "upm": "rpm", "rps": "turn/s"}
    | dict.fromkeys(("rev", "revs"), "turn")
    | {"N": "N", "daN": "daN", "kN": "kN", "Nm": "N*m", "daNm": "daN*m", "kNm": "kN*m", "MNm": "MN*m"}
)
"""Names of units in railway logs, and Pint's names for these units.

Pint itself reads some names as other units: kmph as kilo-mile per hour, kNm as a textile unit. Names in another case
(RPM, KM/H) are also read by this table, if Pint has no unit of the right dimension with this spelling.
"""

_ANY_CASE = {name.lower(): unit for name, unit in TRADE_UNITS.items() if name != "MNm"}  # mnm may be mN*m or MN*m
# turns per minute if an angular speed is expected; U is German for a turn
_TURNS_PER_MINUTE = frozenset(("1/min", "/min", "min**-1", "u/min", "r/min"))
_TON = re.compile(r"k?tons?(_?f(orce)?)?", re.IGNORECASE)

# Words allowed in a unit; only these are passed to Pint. Pint's own grammar also has numbers, nested powers and words
# such as "squared"; input such as 9**9**9**9 would make it compute for ever. A digit after a name is a power (m2,
# min-1); a point or a hyphen between names is a product (N.m, N-m).
_UNIT_WORD = re.compile(
    r"\s*(?:(?P<name>[A-Za-zµμΩ]+(?:_[A-Za-zµμΩ]+)*|°[A-Za-z]*|%)"
    r"|(?P<power>(?:(?:\^|\*\*)\s*|(?<=[A-Za-z)]))-?[1-4](?![0-9]))"
    r"|(?P<one>1(?![0-9]))|(?P<open>\()|(?P<close>\))|(?P<sign>[*/·⋅∙×.-]))\s*"
)
_MOST_POWERS = 6  # largest number of powers in a unit

# Errors, besides its own, that Pint raises for an unknown name or for words in an invalid order.
_FAILURES = (
    *(ArithmeticError, AssertionError, AttributeError, LookupError, SyntaxError, TypeError, ValueError, TokenError),
)


@cache
def _registry() -> pint.UnitRegistry[Any]:
    import pint

    return pint.UnitRegistry(cache_folder=None)


def to_unit(value: object, unit: str, *, name: str = "", text_needs_unit: bool = False) -> float:
    """Return `value` as a finite number in `unit`.

    - value: a number in `unit`; or text with a number and a unit of the same dimension (names, products, quotients,
      parentheses, powers of 1 to 4). If `text_needs_unit` is False, the text may leave out the unit.
    - unit: unit of the result in Pint's spelling, for example "kg" or "N*m/(m/s)"; "1" for a pure number.
    - name: beginning of the error message.

    InputError: a value that is not a finite number, or has another dimension than `unit`.
    """
    try:
        number = _number(value, unit, text_needs_unit=text_needs_unit)
        if not math.isfinite(number):
            raise InputError(f"{number} is not allowed; give a finite number{_in(unit)}")
    except InputError as error:
        raise InputError(f"{name}: {error}" if name else str(error)) from None
    return number


def shown(value: object) -> str:
    """Return `value` as a short line for a message: text quoted and shortened, containers as "a list" or "a table"."""
    if isinstance(value, str):
        return repr(value if len(value) <= _LONGEST_QUANTITY else value[:_LONGEST_QUANTITY] + "...")
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, (list, tuple)):
        return "a list"
    if isinstance(value, int) and value.bit_length() > 200:  # Python cannot print the longest integers
        return f"an integer of {value.bit_length()} bits"
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST_QUANTITY else text[:_LONGEST_QUANTITY] + "..."


def _in(unit: str) -> str:
    return "" if unit == "1" else f" in {unit}"


def _number(value: object, unit: str, *, text_needs_unit: bool) -> float:
    if isinstance(value, str):
        return _parse(value, unit, needs_unit=text_needs_unit)
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"{shown(value)} is not a number{_in(unit)}")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{shown(value)} is too large; give a finite number{_in(unit)}") from None


def _parse(text: str, unit: str, *, needs_unit: bool) -> float:
    if _NOT_FINITE.fullmatch(text):
        return float(text)
    text = text.translate(_MINUS)
    match = _QUANTITY.fullmatch(text) if len(text) <= _LONGEST_QUANTITY else None
    if match is None:
        raise InputError(f"{shown(text)} is not a number{_in(unit)}, with or without a unit")
    number, given = float(match[1]), (match[2] or "").strip()
    if given:
        return number * factor(given, unit, of=text)
    if needs_unit and unit == "1":
        raise InputError(f"{shown(text)} is text; give the number without quotes")
    if needs_unit:
        raise InputError(
            f"{shown(text)} is text without a unit; write the unit too, or give the number of {unit} without quotes"
        )
    return number


def factor(given: str, unit: str, *, of: str = "") -> float:
    """Return the conversion factor from the unit `given` to `unit`; InputError if there is none.

    `of` is the text that contains the unit, for the error message.
    """
    words = _unit_words(given)
    if words is None:
        raise _not_a_unit(given, unit, of)
    if any(_TON.fullmatch(word) for word in words):
        raise InputError(f"{shown(of or given)} may be a tonne, a short or a long ton; write t, short_ton or long_ton")

    import pint

    registry, wrong = _registry(), False
    for reading in _readings(words, unit):
        try:
            parsed = registry.parse_units(reading)
            target = "" if unit == "1" else unit
            single, double = (float(registry.Quantity(count, parsed).to(target).magnitude) for count in (1.0, 2.0))
        except pint.DimensionalityError:
            wrong = True
            continue
        except _FAILURES:
            continue
        # for Pint a hertz is 1/s and a radian is 1, so that 1/s and hertz would both convert to rad/s
        if ("rad" in unit and "hertz" in str(parsed)) or (unit == "rad/s" and str(parsed).startswith("1 / ")):
            raise InputError(f"{shown(of or given)} may mean cycles or radians; give a number in {unit!r}")
        # a factor does not exist for decibels and for temperatures with an offset
        if math.isclose(double, 2.0 * single, rel_tol=1e-9):
            return single
    if wrong:
        raise InputError(f"{shown(of or given)} has the wrong dimension; it must be convertible to {unit!r}")
    raise _not_a_unit(given, unit, of)


def _not_a_unit(given: str, unit: str, of: str) -> InputError:
    return InputError(f"{shown(given)}{f' in {shown(of)}' if of else ''} is not a unit; give a number{_in(unit)}")


def _readings(words: list[str], unit: str) -> Iterator[str]:
    """Yield the possible meanings of a unit, as text for Pint, in the order in which they are tried."""
    if unit == "rad/s" and "".join(words).lower() in _TURNS_PER_MINUTE:
        yield "rpm"
    for known in (TRADE_UNITS, {}, _ANY_CASE):
        key = str.lower if known is _ANY_CASE else str
        yield "".join(f"({known[key(word)]})" if key(word) in known else word for word in words)


def _unit_words(given: str) -> list[str] | None:
    """Split the unit `given` into words for Pint, with "*" for a space between units; None if `given` is not a unit."""
    words: list[str] = []
    previous, position = "", 0
    given = unicodedata.normalize("NFKC", given).translate(_MINUS)  # superscripts to digits, no-break spaces to spaces
    while position < len(given):
        match = _UNIT_WORD.match(given, position)
        if match is None:
            return None
        kind = str(match.lastgroup)
        # a power follows a unit, never another power
        if kind == "power" and previous not in {"name", "close"}:
            return None
        if kind in {"name", "one", "open"} and previous in {"name", "one", "close", "power"}:
            words.append("*")
        word = match[kind].replace("^", "").replace("*", "").strip() if kind == "power" else match[kind]
        words.append(f"**{word}" if kind == "power" else "*" if kind == "sign" and word != "/" else word)
        previous, position = kind, match.end()
    return words if sum("**" in word for word in words) <= _MOST_POWERS else None


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
    """Define a field of a parameter record (`vehicle.Record`): a float in `unit`; users may give text with a unit.

    Example: `mass: float = quantity("kg", "quarter-car mass M", gt=0)`.

    - unit: unit of the field, in Pint's spelling.
    - description: meaning of the field, for documentation and messages.
    - default: default value; without it the field is required.
    - gt, ge, lt, le: bounds: greater than, at least, less than, at most.
    """
    return Field(default, gt=gt, ge=ge, lt=lt, le=le, description=description, json_schema_extra={"unit": unit})


BOUND_DIGITS = 3  #: number of significant digits of bounds and of worst cases in texts
_EXACT = 1e-12  # relative rounding error; a number this near to a rounded number is not rounded further

_SAME = 1e-6  # relative tolerance of Ms; a tuned design exceeds its bound on Ms by less than this
_LARGE = 100.0  # Ms above which a loop is practically unstable and three digits suffice


def rounded_up(value: float, digits: int = BOUND_DIGITS) -> float:
    """Round up to the least number with `digits` significant digits that is not below `value`."""
    return _rounded(value, digits, lambda scaled: math.ceil(scaled - _EXACT * abs(scaled)))


def rounded_down(value: float, digits: int = BOUND_DIGITS) -> float:
    """Round down to the largest number with `digits` significant digits that is not above `value`."""
    return _rounded(value, digits, lambda scaled: math.floor(scaled + _EXACT * abs(scaled)))


def rounded(value: float, digits: int) -> float:
    """Round to the nearest number with `digits` significant digits."""
    return _rounded(value, digits, round)


def ms_up(ms: float) -> str:
    """Text of a value of Ms, rounded up to two decimals, or to three significant digits if at least 100."""
    return f"{math.ceil(100 * ms * (1 - _SAME)) / 100:.2f}" if ms < _LARGE else f"{rounded_up(ms):g}"


def ms_down(bound: float) -> str:
    """Text of a lower bound on Ms, rounded down to two decimals, or to three significant digits if at least 100."""
    return f"{math.floor(100 * bound * (1 + _SAME)) / 100:.2f}" if bound < _LARGE else f"{rounded_down(bound):g}"


def _rounded(value: float, digits: int, rounding: Callable[[float], float]) -> float:
    if value == 0 or not math.isfinite(value):
        return value
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return float(rounding(value * 10.0**places)) / 10.0**places
