"""Railway bristle model, dynamic: [Park2008] (19)-(24), (30)-(32)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, Self

from railslip_ctrl.core.units import KMH, quantity
from railslip_ctrl.model.vehicle import Rail

from .base import RIG_WHEEL_LOAD, AdhesionLaw, ReferenceSlip, Statement, check_published_range

REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)  #: [Park2008] p. 55


class Bristle(AdhesionLaw):
    """Railway bristle model Fa = alpha z, z' = sigma - alpha h |sigma| z, h = beta/(gamma - |sigma|).

    [Park2008] prints sigma instead of |sigma|; z would diverge for sigma < 0. In steady state Fa = (gamma - sigma)/beta
    for sigma > 0. The law is valid for |sigma| < gamma.
    """

    name: ClassVar[str] = "bristle"
    title: ClassVar[str] = "railway bristle model, dynamic"
    source: ClassVar[str] = "[Park2008] (19)-(24), (30)-(32)"
    has_state: ClassVar[bool] = True
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"beta": 2.0})

    alpha: float = quantity("N/m", "stiffness of the bristles", gt=0)
    beta: float = quantity("m/s/N", "inverse slope of 1/h, vs/(Fs - Fc)", gt=0)
    gamma: float = quantity("m/s", "slip velocity at which the adhesion vanishes, Fs vs/(Fs - Fc)", gt=0)

    @classmethod
    def published(cls, rail: Rail, initial_speed_kmh: float, wheel_load: float) -> Self:
        alpha, beta, gamma = published_coefficients(initial_speed_kmh, wheel_load)
        return cls(alpha=alpha, beta=beta, gamma=gamma, reference=REFERENCE).on(rail)

    def domain_limit(self, v: float) -> tuple[float, str]:
        return self.gamma / v, "the slip velocity reaches gamma, at which the adhesion vanishes"

    @classmethod
    def statement(cls) -> Statement:
        import sympy as sp

        from railslip_ctrl.core.notation import symbol

        alpha, beta, gamma = cls.symbols()
        sigma, z = symbol("sigma"), symbol("z")
        h = beta / (gamma - sp.Abs(sigma))
        return Statement(
            force=alpha * z,
            state_rate=sigma - alpha * h * sp.Abs(sigma) * z,
            steady_state=sp.sign(sigma) / (alpha * h),
            sigma_limit=gamma,
            state_limit=gamma / (alpha * beta),  # Fs/alpha, as gamma = Fs vs/(Fs - Fc), beta = vs/(Fs - Fc)
            parts={"h": h},
        )


def published_coefficients(initial_speed_kmh: float, wheel_load: float) -> tuple[float, float, float]:
    """Parameters alpha (N/m), beta ((m/s)/N) and gamma (m/s) for dry rail by [Park2008] (30)-(32).

    The unit that the source prints for alpha is wrong; N/m gives the published peaks. For a wheel load other than
    34 500 N, alpha and beta are scaled on the assumption that mu does not change with the load.
    """
    check_published_range(initial_speed_kmh, wheel_load)
    v0 = initial_speed_kmh
    load = wheel_load / RIG_WHEEL_LOAD
    alpha = 5.455e4 - 3.641e2 * v0 + 3.798e-1 * v0**2  # (30), N/m
    beta_kmh = 1.873e-2 - 6.059e-5 * v0 + 5.500e-8 * v0**2  # (31), (km/h)/N
    gamma_kmh = 2.345e2 - 8.620e-1 * v0 + 1.053e-4 * v0**2  # (32), km/h
    return alpha * load, beta_kmh * KMH / load, gamma_kmh * KMH
