"""Checks of arguments where a call enters: their kinds, from the annotations, and the ranges of numbers.

Not pydantic's `validate_call`: it knows neither arrays nor NumPy's numbers, and its messages are several lines.
"""

from __future__ import annotations

import math
import reprlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from enum import Enum, StrEnum
from functools import cache, wraps
from inspect import unwrap
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError
from .units import shown

F = TypeVar("F", bound=Callable[..., Any])

Check = Callable[[object], Any]
"""Returns a value that is of its kind, an enumeration's name as its member; raises `_Refused` for another."""


class _Refused(Exception):
    """A value of another kind; the message names the wanted one with its article."""


def checked(function: F) -> F:
    """Check a function's arguments against its annotations: InputError in one line for one of another kind.

    An enumeration's value counts as its member. The function itself checks ranges, for example by `number`.
    """
    text: Any = unwrap(function)  # what a cache holds
    names = text.__code__.co_varnames[: text.__code__.co_argcount]

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        checks = _checks_of(text)
        given = [_apply(name, checks.get(name), value) for name, value in zip(names, args, strict=False)]
        named = {name: _apply(name, checks.get(name), value) for name, value in kwargs.items()}
        return function(*given, *args[len(given) :], **named)

    return cast(F, call)


def check_fields(record: Any) -> None:
    """As `checked`, for the fields of a frozen dataclass; called first in its `__post_init__`."""
    kind: Any = type(record)
    checks = _checks_of(kind)
    for field in fields(record):
        if field.init:
            object.__setattr__(
                record, field.name, _apply(field.name, checks.get(field.name), getattr(record, field.name))
            )


def number(
    name: str,
    value: float,
    unit: str = "",
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> float:
    """Return a finite number within its bounds; InputError, which begins with `name`, for any other."""
    value = float(_apply(name, _real, value))
    inside = (
        math.isfinite(value)
        and (gt is None or value > gt)
        and (ge is None or value >= ge)
        and (lt is None or value < lt)
        and (le is None or value <= le)
    )
    if inside:
        return value
    signs = ((">", gt), (">=", ge), ("<", lt), ("<=", le))
    bounds = " and ".join(f"{sign} {bound:g}" for sign, bound in signs if bound is not None)
    given = f"{value:g} {unit}".rstrip()
    raise InputError(f"{name}: {given} is not allowed; give a finite value {bounds}".rstrip())


def real(name: str, value: object) -> float:
    """Return a real number, finite or not; InputError for anything else."""
    return float(_apply(name, _real, value))


def reals(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return an array of real numbers, of any shape, finite or not; InputError for anything else."""
    if type(values) is float or (isinstance(values, np.ndarray) and values.dtype == np.float64):
        return np.asarray(values)
    return np.asarray(_apply(name, _real_array, values), dtype=float)


def complexes(name: str, values: ArrayLike) -> NDArray[np.complex128]:
    """Return an array of complex numbers, of any shape, finite or not; InputError for anything else."""
    if isinstance(values, np.ndarray) and values.dtype == np.complex128:
        return values
    return np.asarray(_apply(name, _array, values), dtype=complex)


def numbers(
    name: str, values: ArrayLike, unit: str = "", *, gt: float | None = None, ge: float | None = None
) -> NDArray[np.float64]:
    """Return an array of finite numbers, of any shape, each within the bounds; InputError names the first outside."""
    array = reals(name, values)
    inside = np.isfinite(array)
    if gt is not None:
        inside &= array > gt
    if ge is not None:
        inside &= array >= ge
    if not inside.all():
        number(name, float(array[~inside][0]), unit, gt=gt, ge=ge)
    return array


def _apply(name: str, check: Check | None, value: Any) -> Any:
    if check is None:
        return value
    try:
        return check(value)
    except _Refused as wanted:
        raise InputError(f"{name}: {_shown(value)} is not allowed; give {wanted}") from None


def _shown(value: object) -> str:
    """As `shown`, with what a container begins with."""
    if not isinstance(value, (list, tuple, dict)):
        return shown(value)
    try:
        return " ".join(reprlib.repr(value).split())
    except ValueError:  # an integer in it that Python refuses to print
        return shown(value)


# --- checks from annotations ---------------------------------------------------------------------------------------


@cache
def _checks_of(thing: Any) -> dict[str, Check]:
    """The checks of a function's arguments or a dataclass's fields, by name."""
    known = vars(sys.modules[thing.__module__])
    found = {}
    for name, annotation in thing.__annotations__.items():
        try:
            meant = eval(annotation, known) if isinstance(annotation, str) else annotation
        except NameError:  # imported for type checkers alone
            continue
        check = _check_of(meant)
        if check is not None and name != "return":
            found[name] = check
    return found


def _check_of(annotation: Any) -> Check | None:
    """The check of an annotation; None where anything is taken."""
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    origin, inner = get_origin(annotation), get_args(annotation)
    if annotation == ArrayLike or origin is np.ndarray:
        return _array
    if origin in (Union, UnionType):
        # text that is no name of an enumeration is not one of its members
        named = any(isinstance(member, type) and issubclass(member, StrEnum) for member in inner)
        return _any_of([_check_of(member) for member in inner if not (named and member is str)])
    if origin is Literal:
        return _one_of(inner)
    if origin is tuple and inner[-1] is not Ellipsis:
        return _tuple_of([_check_of(member) for member in inner])
    if origin in (tuple, list, Sequence):
        return _sequence_of(_check_of(inner[0]))
    if origin is type:
        return None
    kind: Any = origin or annotation
    if kind is Callable:
        return _that(callable, "a function")
    return _instance_of(kind) if isinstance(kind, type) else None


def _real(value: Any) -> Any:
    if type(value) is float:
        return value
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        raise _Refused("a number")
    return _not_too_large(value)


def _integer(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise _Refused("an integer")
    return _not_too_large(value)


def _not_too_large(value: Any) -> Any:
    try:
        float(value)
    except OverflowError:
        raise _Refused("a number of at most 308 digits") from None
    return value


def _flag(value: Any) -> Any:
    if not isinstance(value, (bool, np.bool_)):
        raise _Refused("True or False")
    return bool(value)


def _that(holds: Callable[[Any], bool], wanted: str) -> Check:
    """A check of a value as it is."""

    def check(value: object) -> object:
        if not holds(value):
            raise _Refused(wanted)
        return value

    return check


def _array(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in "fciu":
        return value
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):  # lists of several lengths
        raise _Refused("a number or an array of numbers") from None
    if array.dtype.kind == "O":
        try:
            for one in array.flat:
                _real(one)
        except _Refused as wanted:
            raise _Refused(f"a number or an array of numbers, each {wanted}") from None
    elif array.dtype.kind not in "fciu":
        raise _Refused("a number or an array of numbers")
    return value


def _real_array(value: Any) -> Any:
    if np.asarray(_array(value)).dtype.kind == "c":
        raise _Refused("a number or an array of numbers, not complex")
    return value


_PLAIN: dict[Any, Check | None] = {
    Any: None,
    object: None,
    float: _real,
    int: _integer,
    bool: _flag,
    str: _that(lambda value: isinstance(value, str), "text"),
    **dict.fromkeys((None, NoneType), _that(lambda value: value is None, "None")),
}


def _instance_of(kind: type) -> Check | None:
    if getattr(kind, "_is_protocol", False) and not getattr(kind, "_is_runtime_protocol", False):
        return None
    if issubclass(kind, Enum):
        return _member_of(kind)
    article = "an" if kind.__name__[0] in "AEIO" else "a"
    wanted = "a mapping" if kind is Mapping else f"{article} {kind.__name__}"
    return _that(lambda value: isinstance(value, kind), wanted)


def _member_of(kind: type[Enum]) -> Check:
    def check(value: object) -> Enum:
        try:
            return kind(value)
        except ValueError:
            raise _Refused(" or ".join(str(member.value) for member in kind)) from None

    return check


def _one_of(allowed: tuple[object, ...]) -> Check:
    def is_one(value: object) -> bool:
        return any(value is one or (type(value) is type(one) and value == one) for one in allowed)

    return _that(is_one, " or ".join(map(repr, allowed)))


def _any_of(members: list[Check | None]) -> Check | None:
    checks = [check for check in members if check is not None]
    if len(checks) < len(members):  # one of them takes anything
        return None

    def check(value: object) -> object:
        wanted = []
        for one in checks:
            try:
                return one(value)
            except _Refused as refused:
                wanted.append(str(refused))
        raise _Refused(" or ".join(wanted))

    return check


def _sequence_of(member: Check | None) -> Check:
    def check(value: Any) -> Any:
        if not isinstance(value, (list, tuple, range, np.ndarray)) or getattr(value, "ndim", 1) != 1:
            raise _Refused("a list")
        if member is None or (isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and member is _real):
            return value
        made = [_within(member, one) for one in value]
        return value if all(a is b for a, b in zip(made, value, strict=True)) else tuple(made)

    return check


def _tuple_of(members: list[Check | None]) -> Check:
    def check(value: Any) -> Any:
        if not isinstance(value, (list, tuple)) or len(value) != len(members):
            raise _Refused(f"a tuple of {len(members)}")
        return tuple(
            one if member is None else _within(member, one) for member, one in zip(members, value, strict=True)
        )

    return check


def _within(check: Check, value: object) -> object:
    try:
        return check(value)
    except _Refused as wanted:
        raise _Refused(f"{wanted} in place of {_shown(value)}") from None
