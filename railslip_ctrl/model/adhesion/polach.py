"""Static adhesion law of Polach, made for wheel and rail near the adhesion limit."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.vehicle import Rail

from .base import AdhesionLaw, Statement

SHEAR_MODULUS = 84e9  #: G of steel, Pa
SEMI_AXIS = 6e-3  #: semi-axes a and b of the contact ellipse, m
KALKER_C11 = 4.12  #: Kalker's coefficient c11 of longitudinal creep, dimensionless


class Polach(AdhesionLaw):
    """Polach's law Fa = (2 N mu/pi) [kA e/(1 + (kA e)^2) + arctan(kS e)], e = G pi a b c11 lambda/(4 N mu).

    mu = mu0 [(1 - A) exp(-Bw |sigma|) + A]. Fa is odd in sigma, finite for every slip and without kinks. The contact
    ellipse is assumed to be the same for every wheel load.
    """

    name: ClassVar[str] = "polach"
    title: ClassVar[str] = "Polach model, static"
    source: ClassVar[str] = (
        "O. Polach: Creep forces in simulations of traction vehicles running on adhesion limit. Wear 258, 2005, "
        "pp. 992-1000. doi:10.1016/j.wear.2004.03.046"
    )
    has_state: ClassVar[bool] = False
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"mu0": 0.5})
    published_sets: ClassVar[Mapping[Rail, Mapping[str, float]]] = MappingProxyType(
        {
            Rail.DRY: MappingProxyType({"kA": 1.0, "kS": 0.4, "mu0": 0.55, "A": 0.4, "Bw": 0.6}),
            Rail.WET: MappingProxyType({"kA": 0.3, "kS": 0.1, "mu0": 0.30, "A": 0.4, "Bw": 0.2}),
        }
    )

    kA: float = quantity("1", "reduction of the stiffness in the area of adhesion", gt=0)
    kS: float = quantity("1", "reduction of the stiffness in the area of slip", gt=0)
    mu0: float = quantity("1", "friction coefficient at slip velocity 0", gt=0)
    A: float = quantity("1", "friction coefficient at infinite slip velocity over mu0", gt=0, le=1)
    Bw: float = quantity("s/m", "decay of the friction coefficient with slip velocity (B in the source)", ge=0)
    G: float = quantity("Pa", "shear modulus", gt=0, default=SHEAR_MODULUS)
    a: float = quantity("m", "semi-axis of the contact ellipse, along the rail", gt=0, default=SEMI_AXIS)
    b: float = quantity("m", "semi-axis of the contact ellipse, across the rail", gt=0, default=SEMI_AXIS)
    c11: float = quantity("1", "Kalker's coefficient of longitudinal creep", gt=0, default=KALKER_C11)

    @classmethod
    def statement(cls) -> Statement:
        import sympy as sp

        from railslip_ctrl.core.notation import symbol

        kA, kS, mu0, A, Bw, G, a, b, c11 = cls.symbols()
        v, sigma, N = symbol("v"), symbol("sigma"), symbol("N")
        mu = mu0 * ((1 - A) * sp.exp(-Bw * sp.Abs(sigma)) + A)
        e = G * sp.pi * a * b * c11 * (sigma / v) / (4 * N * mu)
        force = 2 * N * mu / sp.pi * (kA * e / (1 + (kA * e) ** 2) + sp.atan(kS * e))
        return Statement(force=force, parts={"mu": mu, "e": e})
