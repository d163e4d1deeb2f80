"""A counterexample to the reaching condition over a `ReachingSet`: s' sgn s from the plant's numeric rates, maximised.

Independent of the bound in `reaching_bound`: the torque is that of the law, Td its fraction, s' the plant's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Rail, Vehicle
from railslip_ctrl.sliding.gains import LawGains

from .ideal_loop import control_function
from .reaching_bound import ReachingSet, reference_slip

Floats = NDArray[np.float64]

AXES = ("v", "slip", "Ta", "M", "Tr", "Td/Tb", "theta_hat1", "theta_hat2", "a", "b", "side")
"""Coordinates: m/s, 1, N*m, kg, N*m, 1, 1/(kg m), m/s, Ta_hat/Ta - 1, v'_hat/v' - 1, and sgn s by its sign."""

_RANDOM_POINTS, _STARTS = 20_000, 2


@dataclass(frozen=True)
class Counterexample:
    """The largest s s'/|s| found, m/s^2 (negative: the condition holds there), where, and after how many points."""

    excess: float
    point: tuple[float, ...]
    evaluations: int

    def text(self) -> str:
        """The point in one line."""
        v, slip, Ta, M, Tr, fraction, _, _, a, b, side = self.point
        return (
            f"v = {v / KMH:.4g} km/h, slip {slip:.3g}, Ta = {Ta:.4g} N m, M = {M:.4g} kg, Tr = {Tr:.4g} N m, Td/Tb = "
            f"{fraction:.3g}, Ta_hat {100 * a:+.3g} %, v' {100 * b:+.3g} %, s {'> 0' if side > 0 else '< 0'}"
        )


def approach(points: Floats, vehicle: Vehicle, gains: LawGains, surface: float) -> Floats:
    """s' sgn s, m/s^2, at points of `AXES` (11, n) with |s| = surface, m/s, less theta_tilde' phi_hat sgn s.

    That term is what the adaptation takes out of V'; without adaptation theta_hat = theta and it is 0. Dry rail; the
    law's nominal parameters are the vehicle's.
    """
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    v, slip, Ta, mass, Tr, fraction, theta1, theta2, a, b, side = points
    sign, slip_d, r = np.where(side >= 0, 1.0, -1.0), reference_slip(), vehicle.wheel.radius
    sigma, J, B = slip * v, vehicle.effective_inertia, vehicle.effective_viscous_friction
    M, Mn = vehicle.inertia_scale * mass, vehicle.effective_mass
    p = (M, *plant_parameters(law, vehicle)[1:])
    functions = numeric_plant(type(law))
    # the force is proportional to the adhesion state
    z = Ta / (r * functions.force(v, sigma, np.ones_like(v), 0.0, 0.0, 0.0, p))
    v_rate = functions.rates(v, sigma, z, 0.0, 0.0, Tr, p)[0]
    e, omega = slip_d * v - sigma, (v - sigma) / r
    Ta_hat = (1.0 + a) * Ta
    arguments = (sign * surface, sign, e, (1.0 + b) * v_rate, Ta_hat, omega, theta1, theta2, J, r)
    Tb = control_function()(*arguments, gains.D, gains.K, gains.rho, slip_d, Mn, B)
    rates = functions.rates(v, sigma, z, Tb, fraction * Tb, Tr, p)
    unknown = ((1.0 / M - 1.0 / Mn) / r - theta1) * Ta_hat - theta2 * omega
    return np.asarray(sign * (slip_d * rates[0] - rates[1] + gains.rho * e - unknown), dtype=float)


def search(box: ReachingSet, vehicle: Vehicle, gains: LawGains, *, seed: int, surface: float = 0.0) -> Counterexample:
    """Largest `approach` over the corners of the box and random points in it, then uphill from the best (L-BFGS-B).

    The resistance is the vehicle's own at the speed.
    """
    from scipy.optimize import minimize

    corners = np.array(list(product((0.0, 1.0), repeat=len(AXES)))).T
    inside = np.random.default_rng(seed).random((len(AXES), _RANDOM_POINTS))
    evaluated = 0

    def value(shares: Floats) -> Floats:
        nonlocal evaluated
        columns = shares.reshape(len(AXES), -1)
        evaluated += columns.shape[1]
        return approach(points_of(box, columns), vehicle, gains, surface)

    tried = np.hstack((corners, inside))
    starts = tried[:, np.argsort(value(tried))[-_STARTS:]].T
    found = [minimize(lambda x: -float(value(x)[0]), x, bounds=[(0.0, 1.0)] * len(AXES)) for x in starts]
    best = min(found, key=lambda one: float(one.fun))
    return Counterexample(-float(best.fun), tuple(points_of(box, best.x[:, None])[:, 0].tolist()), evaluated)


def points_of(box: ReachingSet, shares: Floats) -> Floats:
    """Points of `AXES` at shares 0 to 1 of the box's sides, both (11, n); Ta and Tr grow with the share of the mass."""
    random, fraction = box.random_torque, box.torque_fraction
    sides = (
        box.speed,
        box.slip,
        box.adhesion_torque,
        box.mass,
        (-random, random),
        (-fraction, fraction),
        box.theta_hat1,
        box.theta_hat2,
        box.torque_error,
        box.rate_error,
        (-1.0, 1.0),
    )
    low, high = np.array(sides).T[:, :, None]
    points = np.asarray(low + (high - low) * shares, dtype=float)
    points[[2, 4]] *= 1.0 + (box.heavier - 1.0) * shares[3]
    return points
