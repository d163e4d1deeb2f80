"""The adhesion-torque observer as printed and as corrected, derived from the wheel's equation: [Park2008] (25)-(28).

Both are sums of two transfers: from the measured brake torque and from the measured speed of the wheel to the estimate
Ta_hat. Put behind the wheel they become transfers from what acts on the wheel, and from the noise of both sensors.
Laplace's s; tau is the observer's time constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import sympy as sp

from railslip_ctrl.core.notation import symbol
from railslip_ctrl.model import plant

s = symbol("s")
tau = sp.Symbol("tau", positive=True)


@dataclass(frozen=True)
class Transfers:
    """Ta_hat = torque * Tb + speed * omega, both measured; expressions in s, tau, J, B (1 and N*m*s)."""

    torque: sp.Expr
    speed: sp.Expr


@dataclass(frozen=True)
class WheelTransfers:
    """From what acts on the wheel, and from sensor noise, to Ta_hat; the wheel's equation (3) is in them.

    Attributes
    ----------
    adhesion : Expr
        From the true Ta (and Tr, which is part of the adhesion torque).
    brake : Expr
        From the acting, measured Tb.
    disturbance : Expr
        From Td, which is not measured.
    torque_noise, speed_noise : Expr
        From what the sensors add to Tb (N*m) and to omega (rad/s).
    """

    adhesion: sp.Expr
    brake: sp.Expr
    disturbance: sp.Expr
    torque_noise: sp.Expr
    speed_noise: sp.Expr


@cache
def adhesion_torque() -> sp.Expr:
    """(25): Ta in omega', omega and Tb, from (3) without the torques that nobody measures (Td = Tr = 0)."""
    return sp.expand(sp.solve(plant.WHEEL.subs({plant.Td: 0, plant.Tr: 0}), plant.Ta)[0])


def printed() -> Transfers:
    """(27): only J omega' goes through the filter."""
    rate = sp.diff(adhesion_torque(), plant.omega_rate) * plant.omega_rate
    rest = adhesion_torque() - rate
    return _transfers(rate.subs(plant.omega_rate, s * plant.omega) / (tau * s + 1) + rest)


def printed_without_derivative() -> Transfers:
    """(28): (B + J/tau - (J/tau)/(tau s + 1)) omega + Tb, as printed."""
    J, B = plant.J, plant.B
    return Transfers(torque=sp.Integer(1), speed=B + J / tau - (J / tau) / (tau * s + 1))


def corrected() -> Transfers:
    """Every term of (26) through the filter."""
    return _transfers(adhesion_torque().subs(plant.omega_rate, s * plant.omega) / (tau * s + 1))


def behind_the_wheel(observer: Transfers) -> WheelTransfers:
    """The observer's transfers with omega from the wheel's equation (3) in them."""
    acting = {plant.Ta: "adhesion", plant.Tb: "brake", plant.Td: "disturbance"}
    equation = plant.WHEEL.subs({plant.omega_rate: s * plant.omega, plant.Tr: 0})
    wheel = sp.solve(equation, plant.omega)[0]
    estimate = observer.torque * plant.Tb + observer.speed * wheel
    by_torque = {name: sp.factor(sp.together(sp.diff(estimate, torque))) for torque, name in acting.items()}
    return WheelTransfers(**by_torque, torque_noise=observer.torque, speed_noise=observer.speed)


def passed_at_once(transfer: sp.Expr) -> sp.Expr:
    """The share of a step that is in the estimate at once: the transfer at infinite s."""
    return sp.limit(transfer, s, sp.oo)


def _transfers(estimate: sp.Expr) -> Transfers:
    return Transfers(*(sp.together(sp.diff(estimate, measured)) for measured in (plant.Tb, plant.omega)))
