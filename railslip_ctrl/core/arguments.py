"""Checks of the arguments of public functions: types against the annotations, and ranges of numbers.

pydantic's `validate_call` is not used, because it supports neither arrays nor NumPy's numbers, and its messages have
several lines.
"""

from __future__ import annotations

import math
import operator
import reprlib
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
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

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class _Refused(Exception):
    """A value has the wrong type; the message names the expected type, for example "a number"."""


def checked(function: F) -> F:
    """Decorator that checks the arguments of a function against its annotations; InputError for a wrong type.

    Text such as "dry" is converted to the enumeration member with this value. The function itself must check ranges,
    for example by `number`.
    """
    plain: Any = unwrap(function)  # the function without a cache around it
    names = plain.__code__.co_varnames[: plain.__code__.co_argcount]

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        kinds = _kinds_of(plain)
        given = [_apply(name, kinds.get(name, Any), value) for name, value in zip(names, args, strict=False)]
        named = {name: _apply(name, kinds.get(name, Any), value) for name, value in kwargs.items()}
        return function(*given, *args[len(given) :], **named)

    return cast(F, call)


def check_fields(record: Any) -> None:
    """Check the types of the fields of a frozen dataclass, as `checked` does; call it first in `__post_init__`."""
    kind: Any = type(record)
    kinds = _kinds_of(kind)
    for name in (field.name for field in fields(record) if field.init):
        object.__setattr__(record, name, _apply(name, kinds.get(name, Any), getattr(record, name)))


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
    """Return `value` if it is a finite number within the bounds; otherwise raise InputError, beginning with `name`.

    - unit: unit of the bounds, for the message.
    - gt, ge, lt, le: bounds: greater than, at least, less than, at most.
    """
    value = real(name, value)
    compared = ((">", gt, operator.gt), (">=", ge, operator.ge), ("<", lt, operator.lt), ("<=", le, operator.le))
    given_bounds = [(sign, bound, holds) for sign, bound, holds in compared if bound is not None]
    if math.isfinite(value) and all(holds(value, bound) for _, bound, holds in given_bounds):
        return value
    bounds = " and ".join(f"{sign} {bound:g}" for sign, bound, _ in given_bounds)
    given = f"{value:g} {unit}".rstrip()
    raise InputError(f"{name}: {given} is not allowed; give a finite value {bounds}".rstrip())


SMALLEST, LARGEST = 1e-12, 1e12
"""Smallest and largest magnitude of an input number; no vehicle needs a magnitude outside this range."""


def sized(name: str, value: float) -> float:
    """Return `value` if it is 0 or its magnitude is from `SMALLEST` to `LARGEST`; otherwise InputError."""
    value = number(name, value)
    if value != 0 and not SMALLEST <= abs(value) <= LARGEST:
        raise InputError(f"{name}: {value:g} is not plausible; give 0 or a magnitude of {SMALLEST:g} to {LARGEST:g}")
    return value


def real(name: str, value: object) -> float:
    """Return a real number, finite or not; InputError for anything else."""
    return float(_apply(name, float, value))


def reals(name: str, values: ArrayLike) -> Floats:
    """Return an array of real numbers, of any shape, finite or not; InputError for anything else."""
    if type(values) is float or (isinstance(values, np.ndarray) and values.dtype == np.float64):
        return np.asarray(values)
    if np.asarray(array := _apply(name, ArrayLike, values)).dtype.kind == "c":
        raise InputError(f"{name}: {_shown(values)} is not allowed; give {_ARRAY}, not complex")
    return np.asarray(array, dtype=float)


def complexes(name: str, values: ArrayLike) -> Complexes:
    """Return an array of complex numbers, of any shape, finite or not; InputError for anything else."""
    if isinstance(values, np.ndarray) and values.dtype in (np.complex128, np.float64):
        return values.astype(complex, copy=False)
    return np.asarray(_apply(name, ArrayLike, values), dtype=complex)


def numbers(
    name: str, values: ArrayLike, unit: str = "", *, gt: float | None = None, ge: float | None = None
) -> Floats:
    """Return an array of finite numbers within the bounds of `number`; InputError names the first wrong value."""
    array = reals(name, values)
    inside = np.isfinite(array) & (gt is None or array > gt) & (ge is None or array >= ge)
    if not inside.all():
        number(name, float(array[~inside][0]), unit, gt=gt, ge=ge)
    return array


def _apply(name: str, kind: Any, value: Any) -> Any:
    try:
        return _converted(kind, value)
    except _Refused as wanted:
        raise InputError(f"{name}: {_shown(value)} is not allowed; give {wanted}") from None


def _shown(value: object) -> str:
    if not isinstance(value, (list, tuple, dict)):
        return shown(value)
    try:
        return " ".join(reprlib.repr(value).split())
    except ValueError:  # it contains an integer too long for Python to print
        return shown(value)


_ARRAY = "a number or an array of numbers"
_KIND_NAMES = {Mapping: "a mapping", str: "text", NoneType: "None", Callable: "a function"}


@cache
def _kinds_of(thing: Any) -> dict[str, Any]:
    known = vars(sys.modules[thing.__module__])
    kinds = {}
    for name, annotation in thing.__annotations__.items():
        with suppress(NameError):  # a name that is imported only for type checkers
            kinds[name] = eval(annotation, known) if isinstance(annotation, str) else annotation
    return kinds


@cache
def _parts(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Origin and arguments of an annotation, for example Union and the types in the union."""
    origin, inner = get_origin(kind) or kind, get_args(kind)
    if kind == ArrayLike or origin is np.ndarray:
        return ArrayLike, ()
    if origin in (Union, UnionType):
        # str | (enumeration of text) accepts only the texts of the enumeration: str is left out
        named = any(isinstance(member, type) and issubclass(member, StrEnum) for member in inner)
        return Union, tuple(member for member in inner if not (named and member is str))
    if getattr(origin, "_is_protocol", False) and not getattr(origin, "_is_runtime_protocol", False):
        return Any, ()
    return (NoneType if origin is None else origin), inner


def _converted(kind: Any, value: Any) -> Any:
    if type(value) is kind and kind is not tuple:
        return _not_too_large(value) if kind is int else value
    origin, inner = _parts(kind)
    if origin is ArrayLike:
        return _array(value)
    if origin is Union:
        return _any_of(inner, value)
    if origin in (tuple, list, Sequence):
        return _members(origin, inner, value)
    if origin is Literal:
        return _required(
            any(type(value) is type(choice) and value == choice for choice in inner),
            value,
            " or ".join(map(repr, inner)),
        )
    if origin in (float, int):
        value = value.item() if isinstance(value, np.generic | np.ndarray) and value.ndim == 0 else value
        abstract, wanted = (Real, "a number") if origin is float else (Integral, "an integer")
        _required(isinstance(value, abstract) and not isinstance(value, (bool, np.bool_)), value, wanted)
        return _not_too_large(value)
    if origin is bool:
        return bool(_required(isinstance(value, (bool, np.bool_)), value, "True or False"))
    if origin is Callable:
        return _required(callable(value), value, _KIND_NAMES[Callable])
    if not isinstance(origin, type) or origin in (Any, object, type):
        return value
    if issubclass(origin, Enum):
        return _member_of(origin, value)
    article = "an" if origin.__name__[0] in "AEIO" else "a"
    return _required(isinstance(value, origin), value, _KIND_NAMES.get(origin, f"{article} {origin.__name__}"))


def _required(holds: bool, value: Any, wanted: str) -> Any:
    if not holds:
        raise _Refused(wanted)
    return value


def _not_too_large(value: Any) -> Any:
    try:
        float(value)
    except OverflowError:
        raise _Refused("a number of at most 308 digits") from None
    return value


def _array(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in "fciu":
        return value
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):  # nested lists of different lengths
        raise _Refused(_ARRAY) from None
    if array.dtype.kind == "O":
        try:
            for member in array.flat:
                _converted(float, member)
        except _Refused as wanted:
            raise _Refused(f"{_ARRAY}, each {wanted}") from None
    return _required(array.dtype.kind in "fciuO", value, _ARRAY)


def _member_of(kind: type[Enum], value: object) -> Enum:
    try:
        return kind(value)
    except ValueError:
        raise _Refused(" or ".join(str(member.value) for member in kind)) from None


def _any_of(kinds: tuple[Any, ...], value: object) -> object:
    wanted = []
    for kind in kinds:
        try:
            return _converted(kind, value)
        except _Refused as refused:
            wanted.append(str(refused))
    raise _Refused(" or ".join(wanted))


def _members(origin: Any, inner: tuple[Any, ...], value: Any) -> Any:
    if origin is tuple and inner[-1] is not Ellipsis:
        _required(isinstance(value, (list, tuple)) and len(value) == len(inner), value, f"a tuple of {len(inner)}")
        return tuple(_within(kind, member) for kind, member in zip(inner, value, strict=True))
    one_row = isinstance(value, (list, tuple, range, np.ndarray)) and getattr(value, "ndim", 1) == 1
    _required(one_row, value, "a list")
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and inner[0] is float:
        return value
    made = [_within(inner[0], member) for member in value]
    return value if all(a is b for a, b in zip(made, value, strict=True)) else tuple(made)


def _within(kind: Any, value: object) -> object:
    try:
        return _converted(kind, value)
    except _Refused as wanted:
        raise _Refused(f"{wanted} in place of {_shown(value)}") from None
