"""Beam (brush) model, static: [Park2008] (5)-(9), and a closed form instead of (10), which has two errors."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np

from railslip_ctrl.core.units import KMH, quantity
from railslip_ctrl.model.vehicle import Rail

from .base import RIG_WHEEL_LOAD, AdhesionLaw, Kink, ReferenceSlip, Statement, check_published_range

# [Park2008] Table 1: maximum adhesion coefficient by initial speed, interpolated linearly.
_INITIAL_SPEED_KMH = (30.0, 60.0, 100.0, 140.0)
_MU_MAX = (0.360, 0.310, 0.261, 0.226)

# [Park2008] Table 1. Only if Cx includes the contact width, 8.0e10 Pa * 0.019 m, does (9) give the tabulated Kx.
CONTACT_STIFFNESS = 1.52e9  # Cx, N/m^2
CONTACT_LENGTH = 0.019  # l, m
CONTACT_WIDTH = 0.019  # w, m
DECAY_H_PER_KM = 0.0013  # a, decrease of the friction coefficient with slip velocity, h/km


class Beam(AdhesionLaw):
    """Closed form of the brush model; u = Kx |lambda|/(3 mu_max N) is the share of the footprint that slides.

    For u <= 1, Fa = N mu_max [1 - (1 - u)^3] - N a sigma (3 u - 2 u^2). For u > 1 the whole footprint slides, and
    Fa = N (mu_max - a sigma); [Park2008] does not give this case. Fa is odd in sigma.
    """

    name: ClassVar[str] = "beam"
    title: ClassVar[str] = "beam (brush) model, static"
    source: ClassVar[str] = "[Park2008] (5)-(10)"
    has_state: ClassVar[bool] = False
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"mu_max": 0.5})

    mu_max: float = quantity("1", "maximum adhesion coefficient", gt=0)
    a: float = quantity("s/m", "decrease of the friction coefficient with slip velocity", ge=0)
    Kx: float = quantity("N", "travelling stiffness, force per unit slip at slip 0", gt=0)

    @classmethod
    def published(cls, rail: Rail, initial_speed_kmh: float, wheel_load: float) -> Self:
        check_published_range(initial_speed_kmh, wheel_load)
        dry = cls(
            mu_max=float(np.interp(initial_speed_kmh, _INITIAL_SPEED_KMH, _MU_MAX)),
            a=DECAY_H_PER_KM / KMH,
            Kx=CONTACT_STIFFNESS * CONTACT_LENGTH**2 / 2.0 * (wheel_load / RIG_WHEEL_LOAD),
            reference=ReferenceSlip(dry=0.119, wet=0.059),
        )
        return dry.on(rail)

    def domain_limit(self, v: float) -> tuple[float, str]:
        limit = self.mu_max / (self.a * v) if self.a > 0.0 else np.inf
        return float(limit), "the friction coefficient mu_max - a sigma is no longer positive"

    def kinks(self, v: float, wheel_load: float) -> tuple[Kink, ...]:
        return (Kink(3.0 * self.mu_max * wheel_load / self.Kx, "above it the whole footprint slides"),)

    @classmethod
    def statement(cls) -> Statement:
        """Equations without `sign`, so that SymPy's derivative has no Dirac terms."""
        import sympy as sp

        from railslip_ctrl.core.notation import symbol

        mu_max, a, Kx = cls.symbols()
        v, sigma, N = symbol("v"), symbol("sigma"), symbol("N")
        u = Kx * (sigma / v) / (3 * mu_max * N)
        partial = N * mu_max * (3 * u - 3 * u * sp.Abs(u) + u**3) - N * a * sigma * (3 * sp.Abs(u) - 2 * u**2)
        return Statement(
            force=sp.Piecewise(
                (partial, sp.Abs(u) <= 1),
                (N * (mu_max - a * sigma), u > 1),
                (-N * (mu_max + a * sigma), True),
            ),
            parts={"u": u},
        )


def _contact_symbols() -> tuple[Any, ...]:
    import sympy as sp

    return tuple(sp.symbols("l w Cx x u", positive=True))


def integrated_force() -> Any:
    """Integrate the force per length over the footprint, for u <= 1 and sigma > 0 ([Park2008] (5)-(9)).

    The force per length is Cx lambda x where the footprint sticks and mu_d w p where it slides. The dimensions of the
    printed terms Cx lambda w x and mu_d p in (6) differ.
    """
    import sympy as sp

    from railslip_ctrl.core.notation import symbol

    mu_max, a, Kx = Beam.symbols()
    v, sigma, N = symbol("v"), symbol("sigma"), symbol("N")
    length, w, Cx, x, u = _contact_symbols()
    slip = sigma / v
    pressure = 6 * N / (length**3 * w) * ((length / 2) ** 2 - (x - length / 2) ** 2)  # (5)
    sticking = length * (1 - u)  # (8)
    mu_d = mu_max - a * slip * v * length / (length - sticking)  # (7)
    force = sp.integrate(Cx * slip * x, (x, 0, sticking)) + sp.integrate(mu_d * w * pressure, (x, sticking, length))
    force = force.subs(Cx, 2 * Kx / length**2)  # (9)
    return sp.simplify(force.subs(u, Kx * slip / (3 * mu_max * N)))


def printed_force(*, width: bool = True, last_factor: Any = None) -> Any:
    """Equation (10) of [Park2008] as printed, with two errors.

    The first term contains the contact width w although Cx includes it; `width=False` leaves it out. The factor of the
    last term is 1/2, but 1/4 follows from (5)-(9); `last_factor` replaces the 1/2.
    """
    import sympy as sp

    from railslip_ctrl.core.notation import symbol

    mu_max, a, Kx = Beam.symbols()
    v, sigma, N = symbol("v"), symbol("sigma"), symbol("N")
    w = _contact_symbols()[1]
    slip = sigma / v
    factor = sp.Rational(1, 2) if last_factor is None else last_factor
    first = Kx * slip * (w if width else 1) * (1 - Kx * slip / (3 * mu_max * N)) ** 2  # Cx l^2/2 = Kx, (9)
    return (
        first
        + Kx * slip / 2
        - sp.Rational(3, 2) * N * a * sigma
        - factor
        * mu_max
        * N
        * (1 - 3 * N * a * sigma / (Kx * slip))
        * (1 - (1 - 2 * Kx * slip / (3 * mu_max * N)) ** 3)
    )
