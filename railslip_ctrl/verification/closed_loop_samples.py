"""The closed loop at random states: s' and V' from the plant's numeric rates, and the worst point of s s' in a box.

The rates are those the simulation uses (`numeric`); where s' and V' are compared with the derived expressions the law
is the one generated for the controller.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Rail, Vehicle
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.gains import LawGains

from .ideal_loop import control_function, generated_control, law_parameters
from .reaching_bound import ADHESION_NOISE, TORQUE_FRACTION

Floats = NDArray[np.float64]

AXES = ("speed_kmh", "slip", "mass_kg", "random_force_n", "torque_fraction", "s")
"""Coordinates of the box: km/h, 1, kg, N at the empty wheel load, Td/Tb, m/s."""

_RANDOM_STARTS, _GENERATIONS = 64, 100


@dataclass(frozen=True)
class Box:
    """Bounds of the coordinates `AXES`, in their units."""

    bounds: tuple[tuple[float, float], ...]

    def text(self) -> str:
        """The box in one line."""
        names = ("v {}..{} km/h", "slip {}..{}", "M {}..{} kg", "random force {}..{} N", "Td/Tb {}..{}", "s {}..{} m/s")
        parts = [name.format(f"{a:g}", f"{b:g}") for name, (a, b) in zip(names, self.bounds, strict=True)]
        return ", ".join(parts)


def operating_box(vehicle: Vehicle, *, sigmas: float = 3.0, surface: float = 1.0) -> Box:
    """The published run: 5 to 100 km/h, empty to loaded, slips up to twice the reference, |s| up to `surface`, m/s."""
    force = sigmas * ADHESION_NOISE * vehicle.wheel_load
    fraction = TORQUE_FRACTION
    return Box(
        (
            (5.0, 100.0),
            (0.01, 0.264),
            (vehicle.mass, vehicle.mass_loaded),
            (-force, force),
            (-fraction, fraction),
            (-surface, surface),
        )
    )


def surface_rate(points: Floats, vehicle: Vehicle, gains: LawGains, *, estimated: bool = True) -> Floats:
    """s', m/s^2, at points of `AXES` (6, n), from the plant's rates on dry rail with the adhesion at rest, under (45).

    `estimated`: theta_hat = theta (the law's best case); else theta_hat = 0 and the nominal mass is the vehicle's.
    s is free of e: any s belongs to some integral of e. Adhesion and random force grow with the wheel load, linear in
    the mass from empty to loaded; the estimates of Ta and v' are right.
    """
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    slip_d = law.reference_slip(Rail.DRY)
    speed_kmh, slip, mass, force, fraction, s = points
    v, r, scale = speed_kmh * KMH, vehicle.wheel.radius, vehicle.inertia_scale
    sigma, J, B = slip * v, vehicle.effective_inertia, vehicle.effective_viscous_friction
    M, Mn = scale * mass, vehicle.effective_mass
    p = (M, *plant_parameters(law, vehicle)[1:])
    functions = numeric_plant(type(law))
    loads = (vehicle.wheel_load, vehicle.wheel_load_loaded)
    heavier = np.interp(mass, (vehicle.mass, vehicle.mass_loaded), loads) / vehicle.wheel_load
    z = heavier * functions.rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p)  # the force is proportional to it
    Tr = r * heavier * force
    Ta = r * functions.force(v, sigma, z, 0.0, 0.0, Tr, p)
    v_rate = functions.rates(v, sigma, z, 0.0, 0.0, Tr, p)[0]
    e = slip_d * v - sigma
    theta = (1.0 / M - 1.0 / Mn) / r if estimated else 0.0 * M
    arguments = (s, np.sign(s), e, v_rate, Ta, (v - sigma) / r, theta, 0.0, J, r)
    Tb = control_function()(*arguments, gains.D, gains.K, gains.rho, slip_d, Mn, B)
    rates = functions.rates(v, sigma, z, Tb, fraction * Tb, Tr, p)
    return np.asarray(slip_d * rates[0] - rates[1] + gains.rho * e, dtype=float)


@dataclass(frozen=True)
class WorstPoint:
    """The largest s s'/|s| = s' sgn s, m/s^2, found in a box, and where (coordinates `AXES`)."""

    excess: float
    point: tuple[float, ...]
    evaluations: int

    def text(self) -> str:
        """The point in one line."""
        names = ("v = {:.4g} km/h", "slip {:.4g}", "M = {:.5g} kg", "random force {:.4g} N", "Td/Tb {:.3g}", "s {:.3g}")
        return ", ".join(name.format(x) for name, x in zip(names, self.point, strict=True)) + " m/s"


def worst_point(box: Box, vehicle: Vehicle, gains: LawGains, *, seed: int, estimated: bool = True) -> WorstPoint:
    """Maximise s' sgn s over a box by differential evolution from its corners and random points, then locally."""
    from scipy.optimize import differential_evolution

    generator = np.random.default_rng(seed)
    low, high = np.array(box.bounds).T
    corners = np.array(list(product(*box.bounds)))
    inside = low + (high - low) * generator.random((_RANDOM_STARTS, len(AXES)))
    evaluated = 0

    def value(x: Floats) -> Any:
        nonlocal evaluated
        points = np.asarray(x, dtype=float).reshape(len(AXES), -1)
        evaluated += points.shape[1]
        values = -np.sign(points[-1]) * surface_rate(points, vehicle, gains, estimated=estimated)
        return values if np.ndim(x) > 1 else float(values[0])

    found = differential_evolution(
        value,
        box.bounds,
        init=np.vstack((corners, inside)),
        seed=seed,
        maxiter=_GENERATIONS,
        tol=1e-8,
        vectorized=True,
        updating="deferred",
    )
    return WorstPoint(-float(found.fun), tuple(float(x) for x in found.x), evaluated)


# --- identity of the closed loop ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class IdentityErrors:
    """Largest relative differences of s' and V', plant against derivation, over the samples."""

    surface_rate: float
    lyapunov_rate: float
    samples: int


def identity_errors(vehicle: Vehicle, *, seed: int, samples: int = 100_000) -> IdentityErrors:
    """s' and V' of the plant's rates under (45) and (49) against the derived ones, at random states and parameters.

    States: 5 to 140 km/h, slip 0.01 to 0.5, z up to twice that at rest, |s| < 2 m/s; parameters: M, J, B, gains,
    theta_hat and disturbances within a factor of 2 about the published ones, both signs where both make sense.
    Relative to the sum of the sizes of the terms, so that cancellation does not count as error.
    """
    generator = np.random.default_rng(seed)
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    draw = {name: generator.uniform(low, high, samples) for name, (low, high) in _ranges(vehicle).items()}
    v, slip = draw.pop("v"), draw.pop("slip")
    sigma, r = slip * v, vehicle.wheel.radius
    base = plant_parameters(law, vehicle)
    mass, friction = draw["Mn"] + draw["Mp"], draw["Bn"] + draw["Bp"]
    p = (mass, draw["J"], friction, *base[3:])
    functions = numeric_plant(type(law))
    z = draw.pop("z") * functions.rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p)
    force = functions.force(v, sigma, z, 0.0, 0.0, draw["Tr"], p)
    fr = vehicle.resistance.constant + vehicle.resistance.linear * v + vehicle.resistance.quadratic * v**2
    v_rate = functions.rates(v, sigma, z, 0.0, 0.0, draw["Tr"], p)[0]
    e = draw["lambda_d"] * v - sigma
    known = {**draw, "Ta": r * force, "omega": (v - sigma) / r, "Fr": fr, "r": r, "e": e, "v_rate": v_rate}
    Tb, known["s"], *hat_rates = _generated_law(known)
    rates = functions.rates(v, sigma, z, Tb, draw["Td"], draw["Tr"], p)
    surface = draw["lambda_d"] * rates[0] - rates[1] + draw["rho"] * e
    theta = ((1.0 / mass - 1.0 / draw["Mn"]) / r, -draw["Bp"] * r / draw["J"])
    known |= {f"theta{i}_tilde": theta[i - 1] - draw[f"theta{i}_hat"] for i in (1, 2)}
    lyapunov = known["s"] * surface
    lyapunov -= sum(known[f"theta{i}_tilde"] * rate / draw["k"] for i, rate in zip((1, 2), hat_rates, strict=True))
    derived_s, derived_V = _derived(known)
    scale = np.abs(rates[0]) + np.abs(rates[1]) + r / draw["J"] * np.abs(Tb) + np.abs(surface)
    scale += sum(np.abs(known[f"theta{i}_tilde"] * known[name]) for i, name in ((1, "Ta"), (2, "omega")))
    return IdentityErrors(
        float(np.max(np.abs(surface - derived_s) / scale)),
        float(np.max(np.abs(lyapunov - derived_V) / (np.abs(draw["s"]) * scale + 1e-300))),
        samples,
    )


def _ranges(vehicle: Vehicle) -> dict[str, tuple[float, float]]:
    M, J, B = vehicle.effective_mass, vehicle.effective_inertia, vehicle.effective_viscous_friction
    return {
        "v": (5 * KMH, 140 * KMH),
        "slip": (0.01, 0.5),
        "z": (0.0, 2.0),
        "lambda_d": (0.02, 0.3),
        "s": (-2.0, 2.0),
        "rho": (0.5, 3.0),
        "D": (1.0, 50.0),
        "K": (10.0, 2000.0),
        "k": (1e-9, 1e-6),
        "J": (0.5 * J, 2.0 * J),
        "Mn": (0.5 * M, 2.0 * M),
        "Mp": (-0.4 * M, 2.0 * M),
        "Bn": (0.0, 2.0 * B),
        "Bp": (-2.0 * B, 2.0 * B),
        "theta1_hat": (-1e-3, 1e-3),
        "theta2_hat": (-1e-2, 1e-2),
        "Tr": (-600.0, 600.0),
        "Td": (-300.0, 300.0),
    }


def _generated_law(known: dict[str, Any]) -> Floats:
    """The generated law at the drawn values, each with parameters of its own."""
    names = ("J", "Mn", "Bn", "lambda_d", "rho", "D", "K")
    drawn = zip(*(known[name].tolist() for name in (*names, "k")), strict=True)
    parameters = (law_parameters(r=known["r"], k1=k, k2=k, **dict(zip(names, row, strict=True))) for *row, k in drawn)
    return generated_control({**known, "e_integral": (known["s"] - known["e"]) / known["rho"]}, parameters)


@cache
def _derived_functions() -> tuple[tuple[str, ...], Any]:
    made = derive()
    pair = (made.error_dynamics, made.V_rate_disturbed)
    symbols = sorted(set().union(*(one.free_symbols for one in pair)), key=str)
    return tuple(str(one) for one in symbols), sp.lambdify(symbols, pair, "numpy", cse=True)


def _derived(known: dict[str, Any]) -> tuple[Floats, Floats]:
    names, function = _derived_functions()
    first, second = function(*(known[name] for name in names))
    return first, second
