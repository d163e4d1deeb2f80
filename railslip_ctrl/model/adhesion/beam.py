"""Beam (brush) model, static: [Park2008] (5)-(9), and the closed form that replaces the printed (10)."""

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

# [Park2008] Table 1. Cx includes the contact width (N/m^2 per unit slip): 8.0e10 Pa * 0.019 m = 1.52e9. Only with this
# reading does (9) give the tabulated Kx = 274 360 N.
CONTACT_STIFFNESS = 1.52e9  # Cx, N/m^2
CONTACT_LENGTH = 0.019  # l, m
CONTACT_WIDTH = 0.019  # w, m
DECAY_H_PER_KM = 0.0013  # a, decrease of the friction coefficient with slip velocity, h/km


class Beam(AdhesionLaw):
    """Closed form of the brush model; u = Kx |lambda|/(3 mu_max N) is the share of the footprint that slides.

    For u <= 1, Fa = N mu_max [1 - (1 - u)^3] - N a sigma (3 u - 2 u^2). For u > 1 the whole footprint slides, and
    Fa = N (mu_max - a sigma); the source does not give this case. Fa is odd in sigma. Its slope jumps at u = 1.
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
        """The law with the parameters of [Park2008] Table 1, and mu_max interpolated in v0.

        The arguments are those of `AdhesionLaw.published`. For a wheel load other than the rig's 34 500 N the project
        assumes that Kx grows with the load, so that mu(lambda) does not change.
        """
        check_published_range(initial_speed_kmh, wheel_load)
        dry = cls(
            mu_max=float(np.interp(initial_speed_kmh, _INITIAL_SPEED_KMH, _MU_MAX)),
            a=DECAY_H_PER_KM / KMH,
            Kx=CONTACT_STIFFNESS * CONTACT_LENGTH**2 / 2.0 * (wheel_load / RIG_WHEEL_LOAD),
            reference=ReferenceSlip(dry=0.119, wet=0.059),
        )
        return dry.on(rail)

    def domain_limit(self, v: float) -> tuple[float, str]:
        """Slip ratio at speed `v`, m/s, at which the friction coefficient is 0, with the reason as text."""
        limit = self.mu_max / (self.a * v) if self.a > 0.0 else np.inf
        return float(limit), "the friction coefficient mu_max - a sigma is no longer positive"

    def kinks(self, v: float, wheel_load: float) -> tuple[Kink, ...]:
        """Kink at full sliding, u = 1; at slip 0 the law is continuously differentiable."""
        return (Kink(3.0 * self.mu_max * wheel_load / self.Kx, "above it the whole footprint slides"),)

    @classmethod
    def statement(cls) -> Statement:
        """The closed form, odd in sigma without `sign`, so that SymPy's derivative has no Dirac terms."""
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
    """SymPy symbols l, w, Cx, x and u of the footprint."""
    import sympy as sp

    return tuple(sp.symbols("l w Cx x u", positive=True))


def integrated_force() -> Any:
    """Derive Fa for u <= 1 and sigma > 0 by integrating the force per length over the footprint ([Park2008] (5)-(9)).

    The force per length, (6), is taken as Cx lambda x in the sticking part and mu_d w p in the sliding part, because
    the printed Cx lambda w x and mu_d p have different dimensions. Returns a SymPy expression in v, sigma, N and the
    parameters.
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
    """Equation (10) as printed, a SymPy expression in v, sigma, N, the parameters and the contact width `w`.

    The print has two errors: the first term contains w although Cx includes it, and the factor of the last term is
    1/2 instead of 1/4, which follows from (5)-(9). `width=False` drops w, `last_factor` replaces the 1/2.
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
