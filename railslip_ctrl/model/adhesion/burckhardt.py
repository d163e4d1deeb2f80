"""Burckhardt's static adhesion law of road tyres, for comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.vehicle import Rail

from .base import AdhesionLaw, Statement

SURFACES: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "dry asphalt": MappingProxyType({"c1": 1.2801, "c2": 23.99, "c3": 0.52}),
        "wet asphalt": MappingProxyType({"c1": 0.86, "c2": 33.82, "c3": 0.35}),
        "snow": MappingProxyType({"c1": 0.1946, "c2": 94.129, "c3": 0.0646}),
    }
)


class Burckhardt(AdhesionLaw):
    """Burckhardt's law Fa = N mu, mu = c1 (1 - exp(-c2 lambda)) - c3 lambda for lambda >= 0, odd in lambda.

    It describes a tyre on a road; its adhesion coefficients are about three times those of a wheel on a rail.
    """

    name: ClassVar[str] = "burckhardt"
    title: ClassVar[str] = "Burckhardt curve (road tyre), static"
    source: ClassVar[str] = "M. Burckhardt: Fahrwerktechnik: Radschlupf-Regelsysteme. Vogel, Wuerzburg, 1993"
    has_state: ClassVar[bool] = False
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"c1": 0.5, "c3": 0.5})
    published_sets: ClassVar[Mapping[Rail, Mapping[str, float]]] = MappingProxyType(
        {Rail.DRY: SURFACES["dry asphalt"], Rail.WET: SURFACES["wet asphalt"]}
    )

    c1: float = quantity("1", "limit of the rising part of the curve", gt=0)
    c2: float = quantity("1", "rate of the rise with slip", gt=0)
    c3: float = quantity("1", "slope of the fall with slip", ge=0)

    def domain_limit(self, v: float) -> tuple[float, str]:
        reason = "the adhesion coefficient is no longer positive"
        if self.c3 == 0.0:
            return math.inf, reason
        from scipy.special import lambertw

        # zero of the asymptote; x = c2 (lambda - zero) solves x exp(x) = -c2 zero exp(-c2 zero)
        zero = self.c1 / self.c3
        x = lambertw(-self.c2 * zero * math.exp(-self.c2 * zero)).real
        return max(0.0, float(zero + x / self.c2)), reason

    @classmethod
    def statement(cls) -> Statement:
        """Equations in t = tanh(x/2), x = c2 lambda, with 1 - exp(-x) = 2 t/(1 + t).

        exp can overflow, and `sign` has no derivative at 0.
        """
        import sympy as sp

        from railslip_ctrl.core.notation import symbol

        c1, c2, c3 = cls.symbols()
        slip = symbol("sigma") / symbol("v")
        t = sp.tanh(c2 * slip / 2)
        return Statement(force=symbol("N") * (c1 * 2 * t / (1 + sp.Abs(t)) - c3 * slip), parts={"t": t})
