"""Equations and numbers of [Park2008] exactly as printed, including misprints; equation numbers are in parentheses.

The symbol `sigma_d_rate` is sigma_d' of the paper. The paper does not define Tm; here Tm is the adhesion torque Ta.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import sympy as sp

from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import beam
from railslip_ctrl.model.adhesion.base import RANDOM_FORCE as RANDOM_FORCE
from railslip_ctrl.sliding.proof import sliding_symbol as _own

_s, _e, _rho, _sigma_d_rate = _own("s"), _own("e"), _own("rho"), _own("sigma_d_rate")
_D, _K, _k, _Mn, _Mp, _Bn, _Bp = (_own(name) for name in ("D", "K", "k", "Mn", "Mp", "Bn", "Bp"))
_THETA = (_own("theta1"), _own("theta2"))
_THETA_HAT = (_own("theta1_hat"), _own("theta2_hat"))
_THETA_TILDE = (_own("theta1_tilde"), _own("theta2_tilde"))
_THETA_HAT_RATE = (_own("theta1_hat_rate"), _own("theta2_hat_rate"))
_Ta, _Tb, _Td, _Tr, _Fr, _omega = plant.Ta, plant.Tb, plant.Td, plant.Tr, plant.Fr, plant.omega
_M, _J, _B, _r = plant.M, plant.J, plant.B, plant.r

length, width, Cx, xc, mu_d, slip = sp.symbols("l w C_x x_c mu_d lambda", positive=True)
wheel_load = sp.Symbol("N", positive=True)
Fs, Fc, vs = sp.symbols("F_s F_c v_s", positive=True)

pressure = 6 * wheel_load / (length**3 * width) * ((length / 2) ** 2 - (xc - length / 2) ** 2)
"""(5): contact pressure, Pa."""
force_per_length = (Cx * slip * width * xc, mu_d * sp.Symbol("p", positive=True))
"""(6): force per length, N/m, where the contact sticks and where it slides; p is the pressure."""

travelling_stiffness = Cx * length**2 / 2  #: (9): Kx, N.
beam_force: Any = beam.printed_force()  #: (10), in v, sigma, N and the beam's parameters; both factors as printed.

bristle_coefficients = ((1 / Fs - Fc) * vs, (sp.Mul(Fs, 1 / Fs, evaluate=False) - Fc) * vs)
"""Below (24): beta = (1/Fs - Fc) vs and gamma = (Fs/Fs - Fc) vs."""

bristle_g = Fs - (Fs - Fc) * plant.sigma / vs  #: (23): g(sigma), N.

laplace, tau = sp.Symbol("s"), sp.Symbol("tau", positive=True)  # tau: time constant of the observer's filter
observer = _J * laplace / (tau * laplace + 1) * _omega + _B * _omega + _Tb  #: (27): Ta_hat(s).
observer_without_derivative = (_B + _J / tau - (_J / tau) / (tau * laplace + 1)) * _omega + _Tb  #: (28): Ta_hat(s).

_both = 1 / (_r * _M) + _r / _J  # coefficient in s' of a torque that acts on wheel and train
_drift = _both * _Ta - _r * _B / _J * _omega
_nominal = _sigma_d_rate + (1 / (_r * _Mn) + _r / _J) * _Ta - _r * _Bn / _J * _omega
_disturbance = _both * _Tr + _Fr / _M - _r / _J * _Td

s_rate = _sigma_d_rate + _drift + _disturbance - _r / _J * _Tb + _rho * _e  #: (35).
equivalent_control = _J / _r * (_sigma_d_rate + _drift + _rho * _e)  #: (36).
reaching = _disturbance - _r / _J * _own("Ur")  #: (37).
asked_rate = -_D * _s - _K * sp.sign(_s)  #: (39): s' = -D s - K sgn s.
robust_control = _D * _s + _K * sp.sign(_s)  #: (41).

reaching_product = _s * (_disturbance - _r / _J * _D * _s - _r / _J * _K * sp.sign(_s))
"""First line of (42), with D0 = (r/J) D and K0 = (r/J) K."""

control_law = equivalent_control + robust_control  #: (43).
theta = (1 / (_r * _Mp), -_r * _Bp / _J)  #: (44): theta.

adaptive_law = _J / _r * (_nominal + _THETA_HAT[0] * _Ta + _THETA_HAT[1] * _omega + _rho * _e) + robust_control  #: (45)
lyapunov = _s**2 / 2 + (_THETA_TILDE[0] ** 2 + _THETA_TILDE[1] ** 2) / (2 * _k)  #: (46).
_adaptation_part = sum(a * b for a, b in zip(_THETA_TILDE, _THETA_HAT_RATE, strict=True)) / _k
lyapunov_rate = _s * (_nominal - _r / _J * _Tb + _THETA[0] * _Ta + _THETA[1] * _omega + _rho * _e) - _adaptation_part
"""(47): V' before the law is substituted."""

lyapunov_rate_with_law = (
    -_D * _s**2 - _K * _s * sp.sign(_s) + _s * (_THETA_TILDE[0] * _Ta + _THETA_TILDE[1] * _omega) - _adaptation_part
)
"""(48): V' with the law."""

adaptation = (_k * _s * _Ta, _k * _s * _omega)  #: (49).

VISCOUS = (0.25, -0.01)  #: B = 0.25 - 0.01 t, N*m*s, t in s (p. 55).
MASS_STEP_TIME = 25.0  #: s; the mass steps from 3517 to 5276 kg and the rail turns wet (p. 55).
SPEEDS_KMH = (100.0, 5.0)  #: Speeds between which the stop is timed (p. 55, 56).
PEAK_ADHESION = MappingProxyType({"dry": 0.30, "wet": 0.15})  #: peaks of the bristle curves in Fig. 17.

TABLE3 = MappingProxyType({"beam": (0.0130, 0.0085, 0.0132, 0.0093), "bristle": (0.0080, 0.0080, 0.0102, 0.0077)})
"""Mean absolute errors of the adhesion coefficient of each model at 30, 60, 100, 140 km/h."""

TABLE3_MEANS = MappingProxyType({"beam": 0.011, "bristle": 0.0083})
TABLE3_IMPROVEMENT = 24.5  # %, of bristle over beam

TABLE5_ENERGY = MappingProxyType({"PI": 1.77e-7, "ASMC": 1.71e-7})
"""Brake energy, kN*m, as printed in Table 5; p. 56 has 1.77 10^7 and 1.71 10^7 N*m."""

TABLE5: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "PI beam": (59.5, 700.0, 1.77e7, 0.0378),
        "PI bristle": (58.9, 682.0, 1.77e7, 0.0351),
        "ASMC beam": (55.3, 607.0, 1.71e7, 0.0354),
        "ASMC bristle": (50.7, 581.0, 1.71e7, 0.0272),
    }
)
"""Table 5 by column: braking time, s; distance, m; energy; mean |slip error|, a ratio.

The energies are those of p. 56, in N*m. They are 3.6 times the energy in J.
"""

TABLE5_TIMES = tuple(row[0] for row in TABLE5.values())  #: braking times, s
