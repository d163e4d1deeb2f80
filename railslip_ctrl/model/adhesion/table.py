"""Lookup table, static: interpolated adhesion coefficients by slip ratio."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, field_validator, model_validator

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import to_unit
from railslip_ctrl.model.vehicle import Rail

from .base import AdhesionLaw, Statement

MOST_KNOTS = 1000  #: largest number of points of a table; an adhesion curve has a few dozen
WET_FACTOR = 0.5  #: adhesion on wet rail over that on dry rail, as for the other laws


class LookupTable(AdhesionLaw):
    """Tabulated law Fa = N mu(lambda), odd in lambda; monotone cubics (PCHIP) interpolate mu.

    `slip` ascends strictly from 0 to at most 1, and `mu` is >= 0; a missing point (0, 0) is added. The curve ends at
    the last point. In a file:

        law = "table"
        [parameters]
        slip = [0.02, 0.05, 0.1, 0.2, 0.5]
        mu = [0.12, 0.22, 0.25, 0.23, 0.19]

    F. N. Fritsch, J. Butland: SIAM Journal on Scientific and Statistical Computing 5(2), 1984, pp. 300-304.
    """

    name: ClassVar[str] = "table"
    title: ClassVar[str] = "lookup table, static"
    source: ClassVar[str] = "a table"
    has_state: ClassVar[bool] = False

    slip: tuple[float, ...] = Field(description="slip ratios, ascending", min_length=2, max_length=MOST_KNOTS)
    mu: tuple[float, ...] = Field(description="adhesion coefficients", min_length=2, max_length=MOST_KNOTS)

    @field_validator("slip", "mu", mode="before")
    @classmethod
    def _numbers(cls, value: object) -> object:
        if not isinstance(value, (list, tuple)):
            return value
        return tuple(to_unit(each, "1", text_needs_unit=True) for each in value)

    @field_validator("slip")
    @classmethod
    def _rising(cls, slip: tuple[float, ...]) -> tuple[float, ...]:
        for low, high in itertools.pairwise(slip):
            if high <= low:
                raise InputError(f"slip: {high:g} after {low:g} is not allowed; give strictly ascending slip ratios")
        if slip[0] < 0.0 or slip[-1] > 1.0:
            worst = slip[0] if slip[0] < 0.0 else slip[-1]
            raise InputError(f"slip: {worst:g} is not allowed; give slip ratios from 0 to 1")
        return slip

    @model_validator(mode="after")
    def _one_each(self) -> Self:
        if len(self.slip) != len(self.mu):
            raise InputError(f"mu: {len(self.mu)} values for {len(self.slip)} slip ratios; give one for each ratio")
        if min(self.mu) < 0.0:
            raise InputError(f"mu: {min(self.mu):g} is not allowed; give adhesion coefficients >= 0")
        if self.slip[0] == 0.0 and self.mu[0] != 0.0:
            raise InputError(f"mu: {self.mu[0]:g} at slip 0 is not allowed; give 0, the adhesion without slip")
        return self

    @classmethod
    def parameter_names(cls) -> tuple[str, ...]:
        return ("slip", "mu")

    @classmethod
    def argument_names(cls) -> tuple[str, ...]:
        return ("*table",)

    @classmethod
    def symbols(cls) -> tuple[Any, ...]:
        # one symbol for the whole table, because its length varies
        import sympy as sp

        return (sp.Symbol("table", real=True),)

    def parameters(self) -> tuple[float, ...]:
        return (*self.slip, *self.mu)

    def wet(self) -> Self:
        if self.rail is Rail.WET:
            return self
        return self.model_copy(update={"mu": tuple(WET_FACTOR * mu for mu in self.mu), "rail": Rail.WET})

    def domain_limit(self, v: float) -> tuple[float, str]:
        limit = math.inf if self.slip[-1] == 1.0 else float(np.nextafter(self.slip[-1], 1.0))
        return limit, "the table ends there"

    @classmethod
    def statement(cls) -> Statement:
        from railslip_ctrl.core.notation import symbol

        force = _table_force()
        return Statement(
            force=force(symbol("sigma") / symbol("v"), symbol("N"), *cls.symbols()),
            functions={"TableForce": f"{__name__}:table_force", "TableSlope": f"{__name__}:table_slope"},
        )


def _table_force() -> Any:
    import sympy as sp
    from sympy.core.function import ArgumentIndexError

    class TableSlope(sp.Function):  # type: ignore[misc]
        # function of (lambda; N, table), as TableForce
        nargs = 3
        is_real = True

    class TableForce(sp.Function):  # type: ignore[misc]
        nargs = 3
        is_real = True

        def fdiff(self, argindex: int = 1) -> Any:
            if argindex != 1:
                raise ArgumentIndexError(self, argindex)
            return TableSlope(*self.args)

    return TableForce


def table_force(slip: ArrayLike, wheel_load: float, table: Iterable[float]) -> Floats | np.float64:
    """Tabulated force, N, at slip ratios of any shape; NaN above the last slip ratio of `table`."""
    ratio = np.asarray(slip, dtype=float)
    value, _ = _interpolants(tuple(table))
    return np.asarray(wheel_load * np.sign(ratio) * value(np.abs(ratio)), dtype=float)[()]


def table_slope(slip: ArrayLike, wheel_load: float, table: Iterable[float]) -> Floats | np.float64:
    """Derivative of `table_force` with respect to the slip ratio, N."""
    _, slope = _interpolants(tuple(table))
    return np.asarray(wheel_load * slope(np.abs(np.asarray(slip, dtype=float))), dtype=float)[()]


@lru_cache(maxsize=256)
def _interpolants(table: tuple[float, ...]) -> tuple[Any, Any]:
    from scipy.interpolate import PchipInterpolator

    count = len(table) // 2
    slip, mu = table[:count], table[count:]
    if slip[0] > 0.0:
        slip, mu = (0.0, *slip), (0.0, *mu)
    curve = PchipInterpolator(slip, mu, extrapolate=False)
    return curve, curve.derivative()
