"""Dahl model, dynamic: [Park2008] (11), (12); [Dahl1976]."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from railslip_ctrl.core.units import quantity

from .base import AdhesionLaw, Statement


class Dahl(AdhesionLaw):
    """Fa = alpha z, z' = sigma - alpha |sigma| z/Fc: Coulomb friction with presliding; constant Fc at rest."""

    name: ClassVar[str] = "dahl"
    title: ClassVar[str] = "Dahl model, dynamic"
    source: ClassVar[str] = "[Park2008] (11), (12)"
    has_state: ClassVar[bool] = True
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"Fc": 0.5})

    alpha: float = quantity("N/m", "stiffness of the bristles", gt=0)
    Fc: float = quantity("N", "Coulomb friction force", gt=0)

    @classmethod
    def statement(cls) -> Statement:
        """(11), (12)."""
        import sympy as sp

        from railslip_ctrl.core.notation import symbol

        alpha, Fc = cls.symbols()
        sigma, z = symbol("sigma"), symbol("z")
        return Statement(
            force=alpha * z,
            state_rate=sigma - alpha * sp.Abs(sigma) * z / Fc,
            steady_state=sp.sign(sigma) * Fc / alpha,
            state_limit=Fc / alpha,
        )
