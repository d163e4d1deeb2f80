"""Dahl [Dahl1976], LuGre [CanudasDeWit1995] and LuGre tyre [CanudasDeWit1999] models, as in [Park2008] (11)-(18)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from railslip_ctrl.core.units import quantity

from .base import AdhesionLaw, Statement


class Dahl(AdhesionLaw):
    """Dahl's law Fa = alpha z, z' = sigma - alpha |sigma| z/Fc; |Fa| is Fc in steady state."""

    name: ClassVar[str] = "dahl"
    title: ClassVar[str] = "Dahl model, dynamic"
    source: ClassVar[str] = "[Park2008] (11), (12)"
    has_state: ClassVar[bool] = True
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"Fc": 0.5})

    alpha: float = quantity("N/m", "stiffness of the bristles", gt=0)
    Fc: float = quantity("N", "Coulomb friction force", gt=0)

    @classmethod
    def statement(cls) -> Statement:
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


class LuGre(AdhesionLaw):
    """LuGre law Fa = alpha z + alpha1 z' + alpha2 sigma, z' = sigma - alpha |sigma| z/g.

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


class TyreLuGre(AdhesionLaw):
    """LuGre tyre law Fa = (alpha z + alpha1 z' + alpha2 sigma) N, z' = sigma - alpha |sigma| z/g.

    g = mu_c + (mu_s - mu_c) exp(-|sigma/vs|^(1/2)); the coefficients are normalised by the wheel load N.
    """

    name: ClassVar[str] = "tyre_lugre"
    title: ClassVar[str] = "LuGre tyre model, dynamic"
    source: ClassVar[str] = "[Park2008] (16)-(18)"
    has_state: ClassVar[bool] = True
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"mu_s": 0.5, "mu_c": 0.5})

    alpha: float = quantity("1/m", "normalised stiffness of the bristles", gt=0)
    alpha1: float = quantity("s/m", "normalised damping of the bristles", ge=0, default=0.0)
    alpha2: float = quantity("s/m", "normalised viscous coefficient", ge=0, default=0.0)
    mu_s: float = quantity("1", "static friction coefficient", gt=0)
    mu_c: float = quantity("1", "Coulomb friction coefficient", gt=0)
    vs: float = quantity("m/s", "Stribeck velocity", gt=0)

    @classmethod
    def statement(cls) -> Statement:
        import sympy as sp

        from railslip_ctrl.core.notation import symbol

        alpha, alpha1, alpha2, mu_s, mu_c, vs = cls.symbols()
        sigma, z, N = symbol("sigma"), symbol("z"), symbol("N")
        g = mu_c + (mu_s - mu_c) * sp.exp(-sp.sqrt(sp.Abs(sigma) / vs))
        rate = sigma - alpha * sp.Abs(sigma) * z / g
        return Statement(
            force=(alpha * z + alpha1 * rate + alpha2 * sigma) * N,
            state_rate=rate,
            steady_state=sp.sign(sigma) * g / alpha,
            state_limit=sp.Max(mu_s, mu_c) / alpha,
            parts={"g": g, "z_rate": rate},
        )
