"""A counterexample to the reaching condition over a `ReachingSet`: s' sgn s from the plant's numeric rates, maximised.

Independent of the bound in `reaching_bound`: the torque is that of the law, Td its fraction, s' the plant's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.adhesion import published_law
from railslip_ctrl.numeric import numeric_plant, plant_parameters
from railslip_ctrl.parameters import Rail, Vehicle
from railslip_ctrl.units import KMH

from .gains import LawGains
from .ideal_loop import control_function
from .reaching_bound import ReachingSet, reference_slip

Floats = NDArray[np.float64]

AXES = ("v", "slip", "Ta", "M", "Tr", "Td/Tb", "theta_hat1", "theta_hat2", "side")
"""Coordinates: m/s, 1, N*m, kg, N*m, 1, 1/(kg m), m/s, and sgn s by its sign."""

_GENERATIONS, _POPULATION = 120, 16  # members of it for each axis


@dataclass(frozen=True)
class Counterexample:
    """The largest s s'/|s| found, m/s^2 (negative: the condition holds there), where, and after how many points."""

    excess: float
    point: tuple[float, ...]
    evaluations: int

    def text(self) -> str:
        """The point in one line."""
        v, slip, Ta, M, Tr, fraction, _, _, side = self.point
        return (
            f"v = {v / KMH:.4g} km/h, slip {slip:.3g}, Ta = {Ta:.4g} N m, M = {M:.4g} kg, Tr = {Tr:.4g} N m, Td/Tb = "
            f"{fraction:.3g}, s {'> 0' if side > 0 else '< 0'}"
        )


def approach(points: Floats, vehicle: Vehicle, gains: LawGains, surface: float) -> Floats:
    """s' sgn s, m/s^2, at points of `AXES` (9, n) with |s| = surface, m/s, less theta_tilde' phi sgn s.

    That term is what the adaptation takes out of V'; without adaptation theta_hat = theta and it is 0. Dry rail; the
    law's nominal parameters are the vehicle's.
    """
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    v, slip, Ta, mass, Tr, fraction, theta1, theta2, side = points
    sign, slip_d, r = np.where(side >= 0, 1.0, -1.0), reference_slip(), vehicle.wheel.radius
    sigma, J, B = slip * v, vehicle.effective_inertia, vehicle.effective_viscous_friction
    M, Mn = vehicle.inertia_scale * mass, vehicle.effective_mass
    p = (M, *plant_parameters(law, vehicle)[1:])
    functions = numeric_plant(type(law))
    # the force is proportional to the adhesion state
    z = Ta / (r * functions.force(v, sigma, np.ones_like(v), 0.0, 0.0, 0.0, p))
    v_rate = functions.rates(v, sigma, z, 0.0, 0.0, Tr, p)[0]
    e, omega = slip_d * v - sigma, (v - sigma) / r
    arguments = (sign * surface, sign, e, v_rate, Ta, omega, theta1, theta2, J, r)
    Tb = control_function()(*arguments, gains.D, gains.K, gains.rho, slip_d, Mn, B)
    rates = functions.rates(v, sigma, z, Tb, fraction * Tb, Tr, p)
    unknown = ((1.0 / M - 1.0 / Mn) / r - theta1) * Ta - theta2 * omega
    return np.asarray(sign * (slip_d * rates[0] - rates[1] + gains.rho * e - unknown), dtype=float)


def search(box: ReachingSet, vehicle: Vehicle, gains: LawGains, *, seed: int, surface: float = 0.0) -> Counterexample:
    """Maximise `approach` over the box by differential evolution from random points, then locally (L-BFGS-B).

    The resistance is the vehicle's own at the speed.
    """
    from scipy.optimize import differential_evolution

    low, high = np.array(_bounds(box)).T
    evaluated = 0

    def value(x: Floats) -> Any:
        nonlocal evaluated
        points = (low + (high - low) * np.asarray(x, dtype=float).reshape(len(AXES), -1).T).T
        evaluated += points.shape[1]
        values = -approach(points, vehicle, gains, surface)
        return values if np.ndim(x) > 1 else float(values[0])

    found = differential_evolution(
        value,
        [(0.0, 1.0)] * len(AXES),
        popsize=_POPULATION,
        seed=seed,
        maxiter=_GENERATIONS,
        tol=1e-10,
        vectorized=True,
        updating="deferred",
    )
    point = low + (high - low) * found.x
    return Counterexample(-float(found.fun), tuple(float(x) for x in point), evaluated)


def _bounds(box: ReachingSet) -> tuple[tuple[float, float], ...]:
    random, fraction = box.random_torque, box.torque_fraction
    return (
        box.speed,
        box.slip,
        box.adhesion_torque,
        box.mass,
        (-random, random),
        (-fraction, fraction),
        box.theta_hat1,
        box.theta_hat2,
        (-1.0, 1.0),
    )
