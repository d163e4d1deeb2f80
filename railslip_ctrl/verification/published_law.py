"""The published law's conditions: the Lyapunov argument decided with SymPy, reaching and theta by numbers over sets.

Where s' and V' of the plant's numeric rates are compared with the derived expressions, at random states, the law is
the one generated for the controller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.numeric import adhesion_coefficient, numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, INITIAL_SPEED_KMH, Rail, Vehicle
from railslip_ctrl.sliding.derivation import Derivation, derive
from railslip_ctrl.sliding.law import LawGains
from railslip_ctrl.sliding.proof import identical, sliding_symbol

from .ideal_loop import PUBLISHED, RUNS, IdealDisturbances, IdealRun, simulate_ideal
from .reaching import (
    ADHESION_NOISE,
    TORQUE_FRACTION,
    ReachingSet,
    control_function,
    generated_control,
    law_parameters,
    least_gain,
    operating_set,
    reaching_time,
    reference_set,
    resistance_force,
    surface_needed,
    true_theta,
)
from .robust import LAYER_WIDTH, RATE, TILDE, gain_units
from .verdict import Condition

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
    v_rate = functions.rates(v, sigma, z, 0.0, 0.0, draw["Tr"], p)[0]
    e = draw["lambda_d"] * v - sigma
    known = {
        **draw,
        "Ta": r * force,
        "omega": (v - sigma) / r,
        "Fr": resistance_force(vehicle, v),
        "r": r,
        "e": e,
        "v_rate": v_rate,
    }
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


# --- the Lyapunov argument --------------------------------------------------------------------------------------------


_s, _D, _K, _k = (sliding_symbol(name) for name in ("s", "D", "K", "k"))
_Mn, _Mp = sliding_symbol("Mn"), sliding_symbol("Mp")
_STATE = (_s, *TILDE)
_IDENTITY_TOLERANCE = 1e-10  # a hundred times the rounding of sums of ten terms over 1e5 points


def lyapunov_conditions(vehicle: Vehicle, gains: LawGains, *, seed: int) -> tuple[Condition, ...]:
    """All of them, for a vehicle and gains where numbers are given."""
    made = derive()
    return (
        derivation_checked(made),
        positive_definite(made),
        cross_term_vanishes(made),
        _identity(vehicle, seed),
        negative_semidefinite(made),
        with_disturbances(made, vehicle, gains),
        barbalat(made),
        invariant_set(made),
        estimates_converge(made),
        one_unit(),
    )


def derivation_checked(made: Derivation) -> Condition:
    """Every machine check of the derivation."""
    failed = [one.name for one in made.steps if not one.checked]
    return Condition(
        "derivation",
        "Every step from (3), (4), (33) to the adaptive law passes its machine check.",
        not failed,
        "symbolic",
        f"{len(made.steps)} steps checked" if not failed else "failed: " + ", ".join(failed),
    )


def positive_definite(made: Derivation) -> Condition:
    """(46)."""
    hessian = sp.hessian(made.V, _STATE)
    constant = not any(entry.has(*_STATE) for entry in hessian)
    minors = [hessian[:n, :n].det() for n in (1, 2, 3)]
    origin = made.V.subs(dict.fromkeys(_STATE, 0))
    quadratic = identical(made.V, (sp.Matrix([_STATE]) * hessian * sp.Matrix(_STATE))[0] / 2)
    holds = constant and origin == 0 and quadratic and all(minor.is_positive for minor in minors)
    return Condition(
        "V positive definite",
        "V of (46) is positive definite and radially unbounded in (s, theta_tilde) for k > 0.",
        bool(holds),
        "symbolic",
        f"V = {made.V} is a quadratic form with constant Hessian, leading minors {', '.join(map(str, minors))} > 0, so "
        "V >= min(1, 1/k) |(s, theta_tilde)|^2/2.",
        claimed=True,
    )


def cross_term_vanishes(made: Derivation) -> Condition:
    """(47)-(49)."""
    rate = made.V_rate.subs(dict(zip(RATE, made.adaptation, strict=True)))
    left = sp.expand(rate)
    expected = -plant.r / plant.J * (_D * _s**2 + _K * sp.Abs(_s))
    holds = not left.has(*TILDE) and identical(left, expected)
    return Condition(
        "V' identity",
        "With theta constant, no disturbance and theta_hat' = k s phi the cross term of V' vanishes: "
        "V' = -(r/J)(D s^2 + K |s|).",
        bool(holds),
        "symbolic",
        f"theta_hat' = {made.adaptation} is solved from the cross term and put back; V' = {made.V_rate_final}. "
        "(48) prints it without r/J.",
        claimed=True,
    )


def _identity(vehicle: Vehicle, seed: int) -> Condition:
    errors = identity_errors(vehicle, seed=seed)
    worst = max(errors.surface_rate, errors.lyapunov_rate)
    return Condition(
        "closed loop identity",
        f"s' and V' computed from the plant's numeric rates equal the derived ones to {_IDENTITY_TOLERANCE:g}.",
        worst <= _IDENTITY_TOLERANCE,
        "sampled",
        f"{errors.samples} random states and parameters (seed {seed}): largest relative difference "
        f"{errors.surface_rate:.1e} of s', {errors.lyapunov_rate:.1e} of V'. Set: 5 to 140 km/h, slip 0.01 to 0.5, "
        "M, J, B and theta_hat about the published ones, |Tr| <= 600 N m, |Td| <= 300 N m, bristle model.",
    )


def negative_semidefinite(made: Derivation) -> Condition:
    """(48)."""
    holds = bool((-made.V_rate_final).is_nonnegative)
    return Condition(
        "V' <= 0, ideal",
        "V' <= 0 for every s and theta_tilde when D, K, r, J > 0, theta is constant, Ta and v' are known exactly and "
        "nothing disturbs.",
        holds,
        "symbolic",
        f"-V' = {-made.V_rate_final} is a sum of products of positive factors; it is zero on all of s = 0, so V' is "
        "semidefinite only.",
        claimed=True,
    )


def with_disturbances(made: Derivation, vehicle: Vehicle, gains: LawGains) -> Condition:
    """What (47) drops."""
    # with the resistance alone at (J/r) d = K + x, V' at s = x/(2 D) is (r/J) x^2/(4 D) > 0
    x = sp.Symbol("x", positive=True)
    resistance = (_Mn + _Mp) * plant.r / plant.J * (_K + x)
    chosen = {plant.Tr: 0, plant.Td: 0, plant.Fr: resistance}
    rate = sp.simplify(made.V_rate_disturbed.subs(chosen).subs(_s, x / (2 * _D)))
    positive = bool(rate.is_positive)
    mildest = reference_set(vehicle, sigmas=1.0)
    asked, reach = least_gain(vehicle, mildest), surface_needed(vehicle, mildest, K=gains.K, D=gains.D)
    numbers = (
        f"With the published disturbances (1 sigma, at the reference slip, Td of the acting torque) (J/r) max|d| = "
        f"{asked:.4g} N m: V' can be positive for all |s| < {reach:.4g} m/s at K = {gains.K:g} N m."
        if reach > 0
        else f"At K = {gains.K:g} N m the published disturbances (1 sigma, {asked:.4g} N m) do not reach that size."
    )
    return Condition(
        "V' <= 0, disturbed",
        "V' <= 0 remains true with the published disturbances (1 sigma), which (47) drops.",
        positive and reach <= 0,
        "symbolic",
        f"V' = s d - D0 s^2 - K0 |s|. Where (J/r) d = K + x with x > 0, V' = {rate} > 0 at s = x/(2D). {numbers}",
        claimed=True,
    )


def barbalat(made: Derivation) -> Condition:
    """Hypotheses of Barbalat's lemma in the ideal case."""
    phi_squared = sum(one**2 for one in made.phi)
    error = sum(a * b for a, b in zip(TILDE, made.phi, strict=True))
    # Cauchy-Schwarz with its remainder: (theta_tilde' phi)^2 = 2 k V phi'phi - k s^2 phi'phi - (a square)
    square = (TILDE[0] * made.phi[1] - TILDE[1] * made.phi[0]) ** 2
    bounded = identical(2 * _k * made.V * phi_squared - error**2, _k * _s**2 * phi_squared + square)
    ideal = made.error_dynamics - made.disturbance_perturbed
    form = identical(ideal, error - plant.r / plant.J * (_D * _s + _K * sp.sign(_s)))
    integrable = bool(sp.expand(-made.V_rate_final - plant.r / plant.J * _D * _s**2).is_nonnegative)
    return Condition(
        "Barbalat, ideal",
        "Without disturbances, theta constant and phi bounded: s and s' are bounded and s^2 integrable, so s -> 0.",
        bounded and form and integrable,
        "symbolic",
        "V does not grow, so |s| <= sqrt(2 V(0)) and |theta_tilde| <= sqrt(2 k V(0)); D0 int s^2 dt <= V(0). "
        "(theta_tilde' phi)^2 = 2 k V |phi|^2 - k s^2 |phi|^2 - (theta1_tilde omega - theta2_tilde Ta)^2, so "
        "|s'| <= sqrt(2 k V(0)) |phi| + D0 |s| + K0: s is uniformly continuous. Needed besides: |Ta| <= r mu N, "
        "omega <= v/r, and no end of time; a stop ends after some ten seconds, so the limit says little of it.",
    )


def invariant_set(made: Derivation) -> Condition:
    """The theorem the paper names."""
    outside = [one for one in (plant.Ta, plant.omega) if sp.diff(made.error_dynamics, one) != 0]
    speed = sp.solve(plant.SLIP_VELOCITY, plant.omega)[0]
    motion = plant.motion().v_rate
    # any motion will do, whatever its sign: v is a state that s' depends on and the error system does not hold
    moves = sp.expand(motion) != 0 and sp.diff(speed, plant.v) != 0
    mass_step = made.theta[0].subs(_Mp, sp.Symbol("m1", positive=True)) - made.theta[0].subs(_Mp, 0)
    autonomous = not (outside and moves)
    return Condition(
        "invariant-set theorem",
        "The error system in (s, theta_tilde) is autonomous, as the invariant-set theorem needs.",
        autonomous,
        "symbolic",
        f"s' contains {', '.join(map(str, outside))}, no functions of (s, theta_tilde): omega = {speed} and "
        f"v' = {motion} is not 0 in braking. At 25 s the mass step adds {sp.factor(mass_step)} to theta1, and B = "
        "0.25 - 0.01 t moves theta2: time enters explicitly. With v as a state there is no compact invariant set: v "
        "reaches 0 in finite time.",
        claimed=True,
    )


def estimates_converge(made: Derivation) -> Condition:
    """A rest of the error system with theta_tilde != 0, while phi keeps its direction."""
    c = sp.Symbol("c", positive=True)
    rest = {TILDE[0]: c * made.phi[1], TILDE[1]: -c * made.phi[0], _s: 0}
    ideal = made.error_dynamics - made.disturbance_perturbed
    adaptation = [rate.subs(rest) for rate in made.adaptation]
    still = sp.expand(ideal.subs(rest)) == 0 and all(rate == 0 for rate in adaptation)
    level = sp.factor(made.V.subs(rest))
    rates = {one: sp.Symbol(f"{one}_rate", real=True) for one in made.phi}
    turns = sp.factor(sum(rest[a] * rates[b] for a, b in zip(TILDE, made.phi, strict=True)))
    stays = still and made.V_rate_final.subs(rest) == 0 and level != 0
    return Condition(
        "theta_hat converges",
        "V -> 0, that is theta_hat -> theta.",
        not stays,
        "symbolic",
        f"Counterexample at constant omega and Ta (held speed): s = 0, theta_tilde = c (omega, -Ta) with any c: "
        f"theta_tilde' phi = 0, so s' = 0, theta_hat' = 0, V' = 0 while V = {level} > 0. In a stop it is no rest: "
        f"theta_tilde' phi changes at {turns}. Convergence needs a phi that keeps turning (persistent excitation).",
        claimed=True,
    )


def one_unit() -> Condition:
    """k of (46), (49)."""
    first, second = gain_units()
    return Condition(
        "scalar gain k",
        "One k has a unit that fits both components of theta_hat' = k s phi (the paper: dimensionless).",
        first == second,
        "symbolic",
        f"From s' = theta' phi: k has the unit {first} for theta1 (Ta) and {second} for theta2 (omega). In SI the "
        "printed k = 2.1e-8 is k1 = 2.1e-8 and k2 = 12.96 * 2.1e-8.",
        claimed=True,
    )


# --- reaching, the boundary layer, theta as it is ---------------------------------------------------------------------


STEP_TIME = 25.0
"""s, when mass and rail change ([Park2008] p. 55)."""

FRICTION_RATE = -0.01
"""N m s per s, of B = 0.25 - 0.01 t ([Park2008] p. 55); before the inertia scale."""

DRIFT_NOISE = 0.1
"""Standard deviation, m/s, of the slip noise the drift is shown with (0.36 km/h)."""

DRIFT_TIME = 20.0  # s
_LONGEST_STOP = 80.0  # s


def reaching_conditions(vehicle: Vehicle, gains: LawGains, *, seed: int) -> tuple[Condition, ...]:
    """All of them, for the published law with these gains."""
    seeds = tuple(range(seed, seed + RUNS))
    return (
        reaching(vehicle, gains),
        counterexample(vehicle, gains, seed),
        reaching_simulated(vehicle, gains, seeds),
        published_layer(vehicle, gains),
        constant_parameters(vehicle, gains),
        drift(vehicle, gains, seed),
    )


def reaching(vehicle: Vehicle, gains: LawGains) -> Condition:
    """(40) for the published disturbances, exact over two boxes."""
    box = operating_set(vehicle, sigmas=1.0)
    asked = _least(vehicle, gains, box)
    other = 1.0 if vehicle.inertia_scale != 1.0 else AS_PUBLISHED_INERTIA_SCALE
    rescaled = vehicle.model_copy(update={"inertia_scale": other})
    again = _least(rescaled, gains, operating_set(rescaled, sigmas=1.0))
    return Condition(
        "reaching condition (40)",
        "D |s| + K > (J/r)|(1/(r M) + r/J) Tr + Fr/M - (r/J) Td| + (J/r) eta for all s, eta -> 0, Td = q Tb with the "
        "acting Tb = Ueq + D s + K sgn s, |q| <= 0.05; Ta and v' known exactly.",
        asked < gains.K,
        "symbolic",
        "(1 - c)(K + D|s|) > max[(J/r)|d(Tr, Fr)| + c |Ueq|], c = 0.05, at a corner of the box. "
        f"K = {gains.K:g} N m against, at s = 0: {_at_reference(vehicle, gains)}. Over the box ({box.text()}): 1 sigma "
        f"K_min = {asked:.1f} N m, {_ratio(asked, gains.K)} K, 3 sigma "
        f"{_least(vehicle, gains, operating_set(vehicle, sigmas=3.0)):.1f} N m; "
        f"at inertia scale {other:g} (J/r) rho e weighs {other / vehicle.inertia_scale:.3g} times: "
        f"{again:.1f} N m (1 sigma). {_needed(vehicle, gains)}",
        claimed=True,
    )


def _least(vehicle: Vehicle, gains: LawGains, box: ReachingSet) -> float:
    return least_gain(vehicle, box, rho=gains.rho)


def _at_reference(vehicle: Vehicle, gains: LawGains) -> str:
    """K_min where e = 0, with and without Td."""
    cases = []
    for sigmas in (1.0, 3.0):
        for torque in (True, False):
            value = _least(vehicle, gains, reference_set(vehicle, sigmas=sigmas, with_torque=torque))
            words = f"{sigmas:g} sigma {'with' if torque else 'without'} Td"
            cases.append(f"{words}: K_min = {value:.1f} N m, {_ratio(value, gains.K)} K")
    return "at the reference slip, 100 km/h, e = 0: " + "; ".join(cases)


def _needed(vehicle: Vehicle, gains: LawGains) -> str:
    """|s| from which on D |s| makes up for K, at the reference, 1 sigma: the statement of the errata too."""
    with_torque, without = (
        surface_needed(vehicle, reference_set(vehicle, sigmas=1.0, with_torque=torque), K=gains.K, D=gains.D)
        for torque in (True, False)
    )
    return (
        f"At the reference (1 sigma) D|s| makes up for K from |s| = {with_torque:.1f} m/s on, without Td from "
        f"{without:.1f} m/s, D = {gains.D:.4g} N m/(m/s)."
    )


def _ratio(value: float, K: float) -> str:
    return f"{value / K:.2f} times" if K > 0 else "against no"


def counterexample(vehicle: Vehicle, gains: LawGains, seed: int) -> Condition:
    """The worst s s' < 0 of (42) over a box."""
    box = operating_box(vehicle)
    known = worst_point(box, vehicle, gains, seed=seed)
    unknown = worst_point(box, vehicle, gains, seed=seed, estimated=False)
    return Condition(
        "s s' < -eta |s| over the box",
        "Under (45) with exact estimates s s' < -eta |s| with some eta > 0 at every point of the operating box.",
        known.excess < 0 and unknown.excess < 0,
        "sampled",
        f"Largest s s'/|s| found, theta_hat = theta: {known.excess:.4g} m/s^2 at {known.text()}; theta_hat = 0: "
        f"{unknown.excess:.4g} m/s^2 at {unknown.text()}. Box: {box.text()}, dry rail, adhesion at rest. Differential "
        f"evolution from its 64 corners and 64 random points (seed {seed}), then L-BFGS-B; "
        f"{known.evaluations + unknown.evaluations} evaluations.",
        claimed=True,
    )


def reaching_simulated(vehicle: Vehicle, gains: LawGains, seeds: tuple[int, ...]) -> Condition:
    """|s| and the sign of s s' along disturbed ideal stops."""
    run = simulate_ideal(vehicle, gains, duration=_LONGEST_STOP, disturbances=PUBLISHED, seeds=seeds)
    fall = np.diff(0.5 * run.s**2, axis=0)
    valid = np.isfinite(fall)
    share = float(np.mean(fall[valid] < 0))
    finite = np.abs(run.s[np.isfinite(run.s)])
    touched, inside = _after_first_zero(run)
    return Condition(
        "sliding reached and kept",
        f"In the ideal loop (no actuator) s reaches 0 and stays within {LAYER_WIDTH:g} m/s under the published "
        "disturbances.",
        touched and inside == 1.0,
        "simulated",
        f"{len(seeds)} stops from 100 km/h, free rolling, dry, seeds {seeds[0]} to {seeds[-1]}, inertia scale "
        f"{vehicle.inertia_scale:g}: s^2 falls in {100 * share:.1f} % of the steps; after s first crosses 0, |s| < "
        f"{LAYER_WIDTH:g} m/s in {100 * inside:.1f} % of the time. |s| is {np.mean(finite):.3g} m/s on average, at "
        f"most {np.max(finite):.3g}: D|s| <= {gains.D * np.max(finite):.3g} N m, K {gains.K:g} N m, (J/r)|d| up to "
        f"{np.nanmax(np.abs(run.disturbance)):.4g} N m. Undisturbed and with theta known, s = {run.s[0, 0]:.3g} m/s "
        f"takes {reaching_time(vehicle, K=gains.K, D=gains.D, start=float(run.s[0, 0])):.3g} s to vanish.",
        claimed=True,
    )


def _after_first_zero(run: IdealRun) -> tuple[bool, float]:
    """Whether s changes sign in every run, and the share of the time after it with |s| in the layer."""
    crossed = np.cumsum(np.abs(np.diff(np.sign(run.s), axis=0, prepend=np.sign(run.s[:1]))) > 1, axis=0) > 0
    after = crossed & np.isfinite(run.s)
    if not np.all(np.any(after, axis=0)):
        return False, 0.0
    return True, float(np.mean(np.abs(run.s[after]) < LAYER_WIDTH))


def published_layer(vehicle: Vehicle, gains: LawGains) -> Condition:
    """A boundary layer in the published law: its ultimate bound in closed form."""
    largest = _least(vehicle, gains, reference_set(vehicle, sigmas=1.0))
    bound = ultimate_bound(largest, gains, LAYER_WIDTH)
    return Condition(
        "boundary layer with K",
        f"sat(s/Phi) for sgn s, Phi = {LAYER_WIDTH:g} m/s, K and D unchanged: |s| ends inside the layer.",
        bound <= LAYER_WIDTH,
        "symbolic",
        f"|s| ends below (J/r)d/(D + K/Phi) where that is within Phi, else below ((J/r)d - K)/D. With (J/r)d = "
        f"{largest:.4g} N m (1 sigma, Td, at the reference): {bound:.4g} m/s; the train runs at "
        f"{INITIAL_SPEED_KMH * KMH:.4g} m/s.",
    )


def ultimate_bound(torque: float, gains: LawGains, layer: float) -> float:
    """Ultimate bound of |s|, m/s, for (J/r)|d| <= torque (N m), d effective: inside the layer, else outside it."""
    inside = torque / (gains.D + gains.K / layer)
    return inside if inside <= layer else (torque - gains.K) / gains.D


@dataclass(frozen=True)
class ParameterStep:
    """What happens to V at 25 s: speed then (m/s; None where the stop is over), theta1's step, V's step, and theta2's.

    `jump` is V's for theta_tilde = 0 before it, m^2/s^2; `friction_level` what theta2_tilde is worth after 25 s of
    B = 0.25 - 0.01 t with theta2_hat fixed.
    """

    speed: float | None
    end: float
    theta_step: float
    jump: float
    friction_level: float
    surface_step: float | None


def parameter_step(vehicle: Vehicle, gains: LawGains) -> ParameterStep:
    """V's jump at 25 s, after an undisturbed ideal stop up to it."""
    run = simulate_ideal(vehicle, gains, duration=_LONGEST_STOP)
    alive = run.time[np.isfinite(run.speed[:, 0])]
    end = float(alive[-1])
    reached = end > STEP_TIME
    speed = float(np.interp(STEP_TIME, run.time, run.speed[:, 0])) if reached else None
    theta = true_theta(vehicle.loaded(), vehicle)
    worn = vehicle.wheel.model_copy(
        update={"viscous_friction": vehicle.wheel.viscous_friction + FRICTION_RATE * STEP_TIME}
    )
    theta2 = float(true_theta(vehicle.model_copy(update={"wheel": worn}), vehicle)[1])
    return ParameterStep(
        speed,
        end,
        float(theta[0]),
        _share(float(theta[0]), gains.k1),
        _share(theta2, gains.k2),
        None if speed is None else _reference_step() * speed,
    )


def _share(theta: float, k: float) -> float:
    return theta**2 / (2.0 * k) if k > 0 else math.inf


def _reference_step() -> float:
    """Step of the reference slip, wet less dry, bristle model."""
    slips = [published_law("bristle", rail).reference_slip(rail) for rail in (Rail.WET, Rail.DRY)]
    assert slips[0] is not None, "the bristle model has published references"
    assert slips[1] is not None
    return slips[0] - slips[1]


def constant_parameters(vehicle: Vehicle, gains: LawGains) -> Condition:
    """theta' = 0 of (47)."""
    here = parameter_step(vehicle, gains)
    lines = [_step_text(here, vehicle)]
    if here.speed is None and vehicle.inertia_scale != AS_PUBLISHED_INERTIA_SCALE:
        published = vehicle.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})
        lines.append(_step_text(parameter_step(published, gains), published))
    return Condition(
        "theta constant",
        "theta is constant during a stop, as (47) assumes (theta_tilde' = -theta_hat').",
        here.jump == 0.0 and here.friction_level == 0.0,
        "simulated",
        f"At 25 s M steps {vehicle.mass:g} to {vehicle.mass_loaded:g} kg, B = 0.25 - 0.01 t moves theta2 all the time "
        f"(until then worth V = {here.friction_level:.3g} m^2/s^2). " + " ".join(lines),
        claimed=True,
    )


def _step_text(step: ParameterStep, vehicle: Vehicle) -> str:
    jump = (
        f"Inertia scale {vehicle.inertia_scale:g}: theta1 steps by {step.theta_step:.4g} 1/(kg m); from theta_tilde "
        f"= 0 V jumps by {step.jump:.4g} m^2/s^2, as much as |s| = {math.sqrt(2 * step.jump):.3g} m/s; "
    )
    if step.speed is None or step.surface_step is None:
        return jump + f"but the undisturbed ideal stop is over at {step.end:.3g} s."
    return jump + (
        f"the undisturbed ideal stop is then at {3.6 * step.speed:.4g} km/h, where the change of reference to the wet "
        f"one moves s by {step.surface_step:.3g} m/s besides."
    )


# --- drift ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drift:
    """Drift of theta_hat at held speed, along the direction that s does not see.

    theta_hat moves on (k1 Ta, k2 omega) with s; w = (k2 omega, -k1 Ta) is at right angles to that and is moved only by
    noise that s and phi share. Rates of w' theta_hat: `predicted`, `mean` and `standard_error` over the seeds;
    `per_second` is the mean as torque (J/r) |Ta theta1_hat'|, N m per s.
    """

    predicted: float
    mean: float
    standard_error: float
    noiseless: float
    per_second: float


def measured_drift(vehicle: Vehicle, gains: LawGains, seeds: tuple[int, ...]) -> Drift:
    """Drift at 100 km/h held, dry, from theta_hat = theta, slip noise `DRIFT_NOISE`, over `DRIFT_TIME`."""
    speed = INITIAL_SPEED_KMH * KMH
    quiet = simulate_ideal(vehicle, gains, duration=DRIFT_TIME, held_speed=speed)
    run = simulate_ideal(
        vehicle,
        gains,
        duration=DRIFT_TIME,
        held_speed=speed,
        disturbances=IdealDisturbances(slip_noise=DRIFT_NOISE),
        seeds=seeds,
    )
    r, sigma = vehicle.wheel.radius, float(quiet.sigma[0, 0])
    omega = (speed - sigma) / r
    torque, slope = _adhesion_torque(vehicle, speed, sigma)
    across = np.array([gains.k2 * omega, -gains.k1 * torque])
    rates = (run.theta_hat[-1] - run.theta_hat[0]) @ across / run.time[-1]
    noiseless = float((quiet.theta_hat[-1, 0] - quiet.theta_hat[0, 0]) @ across / quiet.time[-1])
    # s has -n, Ta slope * n, omega -n/r, so E[s (omega Ta - Ta omega)] = -n^2 (omega slope + Ta/r); the wheel's own
    # chatter is in s and omega alike, and too quick for the adhesion to follow
    chatter = max(0.0, float(np.var(run.s)) - DRIFT_NOISE**2)
    noise = DRIFT_NOISE**2 * (omega * slope + torque / r)
    predicted = -gains.k1 * gains.k2 * (noise + chatter * torque / r)
    mean = float(np.mean(rates))
    # theta_hat' phi stays 0, so theta1_hat' = (w' theta_hat') omega/(k2 omega^2 + k1 Ta^2)
    first = mean * omega / (gains.k2 * omega**2 + gains.k1 * torque**2)
    per_second = abs(first * torque) * vehicle.effective_inertia / r
    return Drift(predicted, mean, float(np.std(rates, ddof=1) / math.sqrt(len(seeds))), noiseless, per_second)


def _adhesion_torque(vehicle: Vehicle, speed: float, sigma: float) -> tuple[float, float]:
    """Ta, N m, and dTa/dsigma, N m/(m/s), of the bristle model at rest on dry rail."""
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    h = 1e-4 * speed
    slips = np.array([sigma - h, sigma, sigma + h]) / speed
    low, middle, high = (
        vehicle.wheel.radius
        * vehicle.wheel_load
        * np.asarray(adhesion_coefficient(law, speed, slips, vehicle.wheel_load))
    )
    return float(middle), float((high - low) / (2.0 * h))


_DRIFT_RUNS = 32
_EXPLAINED = 0.05  # of the drift, that the prediction, of second order in the noise, may miss


def drift(vehicle: Vehicle, gains: LawGains, seed: int) -> Condition:
    """Noise and theta_hat."""
    seeds = tuple(range(seed, seed + _DRIFT_RUNS))
    found = measured_drift(vehicle, replace(gains, layer=0.0), seeds)
    drifts = abs(found.mean) > 4.0 * found.standard_error
    explained = abs(found.mean - found.predicted) < _EXPLAINED * abs(found.mean) + 4.0 * found.standard_error
    prediction = f"predicted from noise and chatter {found.predicted:.3g}"
    prediction += "" if explained else ", which does not explain it"
    return Condition(
        "theta_hat bounded under noise",
        "With noise on the measured slip the estimates of (49) do not drift.",
        not drifts,
        "simulated",
        f"Noise of {DRIFT_NOISE:g} m/s is in s, omega and Ta alike: E[s phi] has a part that no mean of s can cancel "
        f"in both components. Along (k2 omega, -k1 Ta) theta_hat moves at {found.mean:.3g} +- "
        f"{found.standard_error:.1g} per s ({prediction}, without noise {found.noiseless:.1g}), "
        f"without end. Set: ideal loop, 100 km/h held for {DRIFT_TIME:g} s, dry, {len(seeds)} runs, seeds {seeds[0]} "
        f"to {seeds[-1]}. With the printed k the parts it moves apart are worth {found.per_second:.1g} N m per s each: "
        "harmless within a stop, unbounded in principle; projection or a leak bounds it.",
    )
