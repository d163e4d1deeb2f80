"""Equations of [Park2008] as they are printed, entered literally, right or wrong; and the numbers printed with them.

Nothing here is used by the law: `errata` compares it with what is derived. The source's sigma_d' is the symbol
sigma_d_rate, its Tm (never defined) is read as Ta, theta_tilde as theta - theta_hat.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import sympy as sp

from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import beam
from railslip_ctrl.sliding.proof import sliding_symbol as _own

_s, _e, _rho, _sigma_d_rate = _own("s"), _own("e"), _own("rho"), _own("sigma_d_rate")
_D, _K, _k, _Mn, _Mp, _Bn, _Bp = (_own(name) for name in ("D", "K", "k", "Mn", "Mp", "Bn", "Bp"))
_THETA = (_own("theta1"), _own("theta2"))
_THETA_HAT = (_own("theta1_hat"), _own("theta2_hat"))
_THETA_TILDE = (_own("theta1_tilde"), _own("theta2_tilde"))
_THETA_HAT_RATE = (_own("theta1_hat_rate"), _own("theta2_hat_rate"))
_Ta, _Tb, _Td, _Tr, _Fr, _omega = plant.Ta, plant.Tb, plant.Td, plant.Tr, plant.Fr, plant.omega
_M, _J, _B, _r = plant.M, plant.J, plant.B, plant.r

# --- adhesion ------------------------------------------------------------------------------------------------------

length, width, Cx, xc, mu_d, slip = sp.symbols("l w C_x x_c mu_d lambda", positive=True)
wheel_load = sp.Symbol("N", positive=True)
Fs, Fc, vs = sp.symbols("F_s F_c v_s", positive=True)


def pressure() -> Any:
    """(5): contact pressure, Pa."""
    return 6 * wheel_load / (length**3 * width) * ((length / 2) ** 2 - (xc - length / 2) ** 2)


def force_per_length() -> tuple[Any, Any]:
    """(6): the locking and the slipping branch; the pressure is left as the symbol p."""
    return Cx * slip * width * xc, mu_d * sp.Symbol("p", positive=True)


def travelling_stiffness() -> Any:
    """(9): Kx, N."""
    return Cx * length**2 / 2


def beam_force() -> Any:
    """(10), in v, sigma, N and the beam's parameters; both factors as printed."""
    return beam.printed_force()


def bristle_coefficients() -> tuple[Any, Any]:
    """Below (24): beta = (1/Fs - Fc) vs and gamma = (Fs/Fs - Fc) vs."""
    return (1 / Fs - Fc) * vs, (sp.Mul(Fs, 1 / Fs, evaluate=False) - Fc) * vs


def bristle_g() -> Any:
    """(23): g(sigma), N."""
    return Fs - (Fs - Fc) * plant.sigma / vs


# --- observer; s is Laplace's, tau the filter's time constant -------------------------------------------------------

laplace, tau = sp.Symbol("s"), sp.Symbol("tau", positive=True)


def observer() -> Any:
    """(27): Ta_hat(s)."""
    return _J * laplace / (tau * laplace + 1) * _omega + _B * _omega + _Tb


def observer_without_derivative() -> Any:
    """(28): Ta_hat(s)."""
    return (_B + _J / tau - (_J / tau) / (tau * laplace + 1)) * _omega + _Tb


# --- sliding-mode law ----------------------------------------------------------------------------------------------


def s_rate() -> Any:
    """(35)."""
    torque = 1 / (_r * _M) + _r / _J
    return (
        _sigma_d_rate
        + torque * _Ta
        + torque * _Tr
        + _Fr / _M
        - _r / _J * _Tb
        - _r * _B / _J * _omega
        - _r / _J * _Td
        + _rho * _e
    )


def equivalent_control() -> Any:
    """(36)."""
    return _J / _r * (_sigma_d_rate + (1 / (_r * _M) + _r / _J) * _Ta - _r * _B / _J * _omega + _rho * _e)


def reaching() -> Any:
    """(37)."""
    return (1 / (_r * _M) + _r / _J) * _Tr + _Fr / _M - _r / _J * _Td - _r / _J * _own("Ur")


def asked_rate() -> Any:
    """(39): s' = -D s - K sgn s."""
    return -_D * _s - _K * sp.sign(_s)


def robust_control() -> Any:
    """(41)."""
    return _D * _s + _K * sp.sign(_s)


def reaching_product() -> Any:
    """The first line of (42), D0 = (r/J) D and K0 = (r/J) K put in."""
    disturbance = (1 / (_r * _M) + _r / _J) * _Tr + _Fr / _M - _r / _J * _Td
    return _s * (disturbance - _r / _J * _D * _s - _r / _J * _K * sp.sign(_s))


def control_law() -> Any:
    """(43)."""
    return equivalent_control() + robust_control()


def theta() -> tuple[Any, Any]:
    """(44): theta."""
    return 1 / (_r * _Mp), -_r * _Bp / _J


def adaptive_law() -> Any:
    """(45)."""
    estimate = _THETA_HAT[0] * _Ta + _THETA_HAT[1] * _omega
    known = _sigma_d_rate + (1 / (_r * _Mn) + _r / _J) * _Ta - _r * _Bn / _J * _omega
    return _J / _r * (known + estimate + _rho * _e) + robust_control()


def lyapunov() -> Any:
    """(46)."""
    return _s**2 / 2 + (_THETA_TILDE[0] ** 2 + _THETA_TILDE[1] ** 2) / (2 * _k)


def lyapunov_rate() -> Any:
    """(47)."""
    uncertainty = _THETA[0] * _Ta + _THETA[1] * _omega
    known = _sigma_d_rate + (1 / (_r * _Mn) + _r / _J) * _Ta - _r * _Bn / _J * _omega
    return _s * (known - _r / _J * _Tb + uncertainty + _rho * _e) - _adaptation_part()


def lyapunov_rate_with_law() -> Any:
    """(48)."""
    return (
        -_D * _s**2
        - _K * _s * sp.sign(_s)
        + _s * (_THETA_TILDE[0] * _Ta + _THETA_TILDE[1] * _omega)
        - _adaptation_part()
    )


def _adaptation_part() -> Any:
    return sum(a * b for a, b in zip(_THETA_TILDE, _THETA_HAT_RATE, strict=True)) / _k


def adaptation() -> tuple[Any, Any]:
    """(49)."""
    return _k * _s * _Ta, _k * _s * _omega


# --- printed numbers -----------------------------------------------------------------------------------------------

RANDOM_FORCE = 431.0
"""Standard deviation of the random adhesion force, N (p. 55)."""

VISCOUS = (0.25, -0.01)
"""B = 0.25 - 0.01 t, N*m*s, t in s (p. 55)."""

MASS_STEP_TIME = 25.0
"""s; the mass steps from 3517 to 5276 kg and the rail turns wet (p. 55)."""

SPEEDS_KMH = (100.0, 5.0)
"""Speeds between which the stop is timed (p. 55, 56)."""

PEAK_ADHESION = MappingProxyType({"dry": 0.30, "wet": 0.15})
"""Peaks of the bristle curves of Fig. 17, read from it."""

TABLE3 = MappingProxyType(
    {"beam": (0.0130, 0.0085, 0.0132, 0.0093), "bristle": (0.0080, 0.0080, 0.0102, 0.0077)},
)
"""Mean absolute errors of the adhesion coefficient at 30, 60, 100, 140 km/h."""

TABLE3_MEANS = MappingProxyType({"beam": 0.011, "bristle": 0.0083})
TABLE3_IMPROVEMENT = 24.5  # per cent

TABLE5_ENERGY = MappingProxyType({"PI": 1.77e-7, "ASMC": 1.71e-7})
"""kN*m as the table has it; p. 56 has the same digits times 10^7 N*m."""

TABLE5_TIMES = (59.5, 58.9, 55.3, 50.7)
"""Braking times, s: PI beam, PI bristle, ASMC beam, ASMC bristle."""
