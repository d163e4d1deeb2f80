"""LuGre model, dynamic: [Park2008] (13)-(15); [CanudasDeWit1995]."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from railslip_ctrl.core.units import quantity

from .base import AdhesionLaw, Statement


class LuGre(AdhesionLaw):
    """Fa = alpha z + alpha1 z' + alpha2 sigma, z' = sigma - alpha |sigma| z/g.

    g = Fc + (Fs - Fc) exp(-(sigma/vs)^2).
    """

    name: ClassVar[str] = "lugre"
    title: ClassVar[str] = "LuGre model, dynamic"
    source: ClassVar[str] = "[Park2008] (13)-(15)"
    has_state: ClassVar[bool] = True
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"Fs": 0.5, "Fc": 0.5})

    alpha: float = quantity("N/m", "stiffness of the bristles", gt=0)
    alpha1: float = quantity("N*s/m", "damping of the bristles", ge=0, default=0.0)
    alpha2: float = quantity("N*s/m", "viscous coefficient", ge=0, default=0.0)
    Fs: float = quantity("N", "static friction force", gt=0)
    Fc: float = quantity("N", "Coulomb friction force", gt=0)
    vs: float = quantity("m/s", "Stribeck velocity", gt=0)

    @classmethod
    def statement(cls) -> Statement:
        """(13)-(15)."""
        import sympy as sp

        from railslip_ctrl.core.notation import symbol

        alpha, alpha1, alpha2, Fs, Fc, vs = cls.symbols()
        sigma, z = symbol("sigma"), symbol("z")
        g = Fc + (Fs - Fc) * sp.exp(-((sigma / vs) ** 2))
        rate = sigma - alpha * sp.Abs(sigma) * z / g
        return Statement(
            force=alpha * z + alpha1 * rate + alpha2 * sigma,
            state_rate=rate,
            steady_state=sp.sign(sigma) * g / alpha,
            state_limit=sp.Max(Fs, Fc) / alpha,
            parts={"g": g, "z_rate": rate},
        )
