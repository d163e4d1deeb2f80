"""Conditions of the published law: Lyapunov argument, reaching, boundary layer and adaptation."""

from __future__ import annotations

import math
from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
import sympy as sp

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, INITIAL_SPEED_KMH, Rail, Vehicle
from railslip_ctrl.sliding.derivation import THETA_HAT_RATE as RATE
from railslip_ctrl.sliding.derivation import THETA_TILDE as TILDE
from railslip_ctrl.sliding.derivation import Derivation, derive
from railslip_ctrl.sliding.generate import generated_law
from railslip_ctrl.sliding.law import LawGains
from railslip_ctrl.sliding.proof import identical, sliding_symbol
from railslip_ctrl.verification import reaching

from .fixed_step import RUNS, simulate_ideal
from .robust import LAYER_WIDTH, gain_units
from .verdict import CORNERS, Condition, checked_at


def identity_errors(vehicle: Vehicle, *, seed: int, samples: int = 100_000) -> dict[str, Any]:
    """Compare the derived s' and V' with those of the plant under the law [Park2008] (45), (49), at random points.

    Returns a dictionary of the largest differences, relative to the sum of the magnitudes of the terms.
    """
    M, J, B = vehicle.effective_mass, vehicle.effective_inertia, vehicle.effective_viscous_friction
    ranges = {
        **{"v": (5 * KMH, 140 * KMH), "slip": (0.01, 0.5), "z": (0.0, 2.0), "lambda_d": (0.02, 0.3), "s": (-2.0, 2.0)},
        **{"rho": (0.5, 3.0), "D": (1.0, 50.0), "K": (10.0, 2000.0), "k": (1e-9, 1e-6), "J": (0.5 * J, 2.0 * J)},
        **{"Mn": (0.5 * M, 2.0 * M), "Mp": (-0.4 * M, 2.0 * M), "Bn": (0.0, 2.0 * B), "Bp": (-2.0 * B, 2.0 * B)},
        **{"theta1_hat": (-1e-3, 1e-3), "theta2_hat": (-1e-2, 1e-2), "Tr": (-600.0, 600.0), "Td": (-300.0, 300.0)},
    }
    generator = np.random.default_rng(seed)
    functions, base = reaching.bristle_plant(vehicle)
    draw = {name: generator.uniform(low, high, samples) for name, (low, high) in ranges.items()}
    v, slip, r = draw.pop("v"), draw.pop("slip"), vehicle.wheel.radius
    sigma, omega = slip * v, (v - slip * v) / r
    mass, friction = draw["Mn"] + draw["Mp"], draw["Bn"] + draw["Bp"]
    p = (mass, draw["J"], friction, *base[3:])
    z = draw.pop("z") * functions.rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p)
    Ta = r * functions.force(v, sigma, z, 0.0, 0.0, draw["Tr"], p)
    v_rate = functions.rates(v, sigma, z, 0.0, 0.0, draw["Tr"], p)[0]
    e = draw["lambda_d"] * v - sigma
    known = {**draw, "Ta": Ta, "omega": omega, "Fr": vehicle.resistance.force(v), "r": r, "e": e, "v_rate": v_rate}
    # evaluate the generated law for each sample with its own parameters
    control = generated_law().control
    names = ("J", "Mn", "Bn", "lambda_d", "rho", "D", "K")
    drawn = zip(*(known[name].tolist() for name in (*names, "k")), strict=True)
    parameters = (
        reaching.law_parameters(r=known["r"], k1=k, k2=k, **dict(zip(names, row, strict=True))) for *row, k in drawn
    )
    signals = {**known, "e_integral": (known["s"] - known["e"]) / known["rho"]}
    columns = (signals[name].tolist() for name in list(signature(control).parameters)[:-1])
    Tb, known["s"], *hat_rates = np.array([control(*row) for row in zip(*columns, parameters, strict=False)]).T
    rates = functions.rates(v, sigma, z, Tb, draw["Td"], draw["Tr"], p)
    surface = draw["lambda_d"] * rates[0] - rates[1] + draw["rho"] * e
    theta = ((1.0 / mass - 1.0 / draw["Mn"]) / r, -draw["Bp"] * r / draw["J"])
    known |= {f"theta{i}_tilde": theta[i - 1] - draw[f"theta{i}_hat"] for i in (1, 2)}
    lyapunov = known["s"] * surface
    lyapunov -= sum(known[f"theta{i}_tilde"] * rate / draw["k"] for i, rate in zip((1, 2), hat_rates, strict=True))
    pair = (derive().error_dynamics, derive().V_rate_disturbed)
    symbols = sorted(set().union(*(one.free_symbols for one in pair)), key=str)
    derived = sp.lambdify(symbols, pair, "numpy", cse=True)
    derived_s, derived_V = derived(*(known[str(one)] for one in symbols))
    scale = np.abs(rates[0]) + np.abs(rates[1]) + r / draw["J"] * np.abs(Tb) + np.abs(surface)
    scale += sum(np.abs(known[f"theta{i}_tilde"] * known[name]) for i, name in ((1, "Ta"), (2, "omega")))
    return {
        "surface_rate": float(np.max(np.abs(surface - derived_s) / scale)),
        "lyapunov_rate": float(np.max(np.abs(lyapunov - derived_V) / (np.abs(draw["s"]) * scale + 1e-300))),
        "samples": samples,
    }


_s, _D, _K, _k = (sliding_symbol(name) for name in ("s", "D", "K", "k"))
_Mn, _Mp = sliding_symbol("Mn"), sliding_symbol("Mp")
_STATE = (_s, *TILDE)
_IDENTITY_TOLERANCE = 1e-10  # relative; 100 times the largest rounding error of a sum of ten terms over 1e5 points


def lyapunov_conditions(vehicle: Vehicle, gains: LawGains, *, seed: int) -> tuple[Condition, ...]:
    """Decide whether the conditions of the Lyapunov argument hold."""
    made, errors, (k1_unit, k2_unit) = derive(), identity_errors(vehicle, seed=seed), gain_units()
    failed = [one.name for one in made.steps if not one.checked]
    identity = max(errors["surface_rate"], errors["lyapunov_rate"]) <= _IDENTITY_TOLERANCE
    compared = {**errors, "seed": seed, "tolerance": _IDENTITY_TOLERANCE}
    falls, units = bool((-made.V_rate_final).is_nonnegative), {"k1_unit": k1_unit, "k2_unit": k2_unit}
    return (
        Condition("derivation", not failed, "symbolic", {"steps": len(made.steps), "failed": failed}),
        positive_definite(made),
        cross_term_vanishes(made),
        Condition("closed loop identity", identity, checked_at(errors["samples"]), compared),
        Condition("V' <= 0, ideal", falls, "symbolic", {"minus_V_rate": -made.V_rate_final}, claimed=True),  # (48)
        with_disturbances(made, vehicle, gains),
        barbalat(made),
        invariant_set(made),
        estimates_converge(made),
        Condition("scalar gain k", k1_unit == k2_unit, "symbolic", units, claimed=True),  # k of (46), (49)
    )


def positive_definite(made: Derivation) -> Condition:
    """Decide whether V of [Park2008] (46) is positive definite."""
    hessian = sp.hessian(made.V, _STATE)
    constant = not any(entry.has(*_STATE) for entry in hessian)
    minors = [hessian[:n, :n].det() for n in (1, 2, 3)]
    origin = made.V.subs(dict.fromkeys(_STATE, 0))
    quadratic = identical(made.V, (sp.Matrix([_STATE]) * hessian * sp.Matrix(_STATE))[0] / 2)
    holds = constant and origin == 0 and quadratic and all(minor.is_positive for minor in minors)
    numbers = {"V": made.V, "minors": minors}
    return Condition("V positive definite", bool(holds), "symbolic", numbers, claimed=True)


def cross_term_vanishes(made: Derivation) -> Condition:
    """Decide whether the cross term of V' vanishes with the adaptation, [Park2008] (47)-(49)."""
    rate = made.V_rate.subs(dict(zip(RATE, made.adaptation, strict=True)))
    left = sp.expand(rate)
    expected = -plant.r / plant.J * (_D * _s**2 + _K * sp.Abs(_s))
    holds = not left.has(*TILDE) and identical(left, expected)
    numbers = {"adaptation": made.adaptation, "V_rate": made.V_rate_final}
    return Condition("V' identity", bool(holds), "symbolic", numbers, claimed=True)


def with_disturbances(made: Derivation, vehicle: Vehicle, gains: LawGains) -> Condition:
    """Decide whether V' <= 0 with the disturbances, which [Park2008] (47) neglects."""
    # with the resistance alone at (J/r) d = K + x, V' at s = x/(2 D) is (r/J) x^2/(4 D) > 0
    x = sp.Symbol("x", positive=True)
    chosen = {plant.Tr: 0, plant.Td: 0, plant.Fr: (_Mn + _Mp) * plant.r / plant.J * (_K + x)}
    rate = sp.simplify(made.V_rate_disturbed.subs(chosen).subs(_s, x / (2 * _D)))
    mildest = reaching.reference_set(vehicle, sigmas=1.0)
    asked = reaching.least_gain(vehicle, mildest)
    surface = reaching.surface_needed(vehicle, mildest, K=gains.K, D=gains.D)
    numbers = {"V_rate": rate, "asked": asked, "surface": surface, "K": gains.K}
    holds = bool(rate.is_positive) and surface <= 0
    return Condition("V' <= 0, disturbed", holds, "symbolic", numbers, claimed=True)


def barbalat(made: Derivation) -> Condition:
    """Decide whether the hypotheses of Barbalat's lemma hold without disturbances."""
    phi_squared = sum(one**2 for one in made.phi)
    error = sum(a * b for a, b in zip(TILDE, made.phi, strict=True))
    # Cauchy-Schwarz with its remainder: (theta_tilde' phi)^2 = 2 k V |phi|^2 - k s^2 |phi|^2 - (a square)
    square = (TILDE[0] * made.phi[1] - TILDE[1] * made.phi[0]) ** 2
    bounded = identical(2 * _k * made.V * phi_squared - error**2, _k * _s**2 * phi_squared + square)
    ideal = made.error_dynamics - made.disturbance_perturbed
    form = identical(ideal, error - plant.r / plant.J * (_D * _s + _K * sp.sign(_s)))
    integrable = bool(sp.expand(-made.V_rate_final - plant.r / plant.J * _D * _s**2).is_nonnegative)
    return Condition("Barbalat, ideal", bounded and form and integrable, "symbolic")


def invariant_set(made: Derivation) -> Condition:
    """Decide whether the error system is autonomous, as the invariant-set theorem of [Park2008] requires."""
    outside = [one for one in (plant.Ta, plant.omega) if sp.diff(made.error_dynamics, one) != 0]
    speed = sp.solve(plant.SLIP_VELOCITY, plant.omega)[0]
    motion = plant.motion().v_rate
    # v changes, and s' depends on v through omega, but v is not a state of the error system
    moves = sp.expand(motion) != 0 and sp.diff(speed, plant.v) != 0
    mass_step = made.theta[0].subs(_Mp, sp.Symbol("m1", positive=True)) - made.theta[0].subs(_Mp, 0)
    numbers = {"outside": outside, "omega": speed, "v_rate": motion, "mass_step": sp.factor(mass_step)}
    return Condition("invariant-set theorem", not (outside and moves), "symbolic", numbers, claimed=True)


def estimates_converge(made: Derivation) -> Condition:
    """Decide whether theta_hat converges to theta."""
    # the counterexample is an equilibrium with theta_tilde != 0 at a constant regressor phi
    c = sp.Symbol("c", positive=True)
    rest = {TILDE[0]: c * made.phi[1], TILDE[1]: -c * made.phi[0], _s: 0}
    ideal = made.error_dynamics - made.disturbance_perturbed
    adaptation = [rate.subs(rest) for rate in made.adaptation]
    still = sp.expand(ideal.subs(rest)) == 0 and all(rate == 0 for rate in adaptation)
    level = sp.factor(made.V.subs(rest))
    rates = {one: sp.Symbol(f"{one}_rate", real=True) for one in made.phi}
    turns = sp.factor(sum(rest[a] * rates[b] for a, b in zip(TILDE, made.phi, strict=True)))
    stays = still and made.V_rate_final.subs(rest) == 0 and level != 0
    return Condition("theta_hat converges", not stays, "symbolic", {"level": level, "turns": turns}, claimed=True)


STEP_TIME = 25.0  #: time at which mass and rail change, s ([Park2008] p. 55)
FRICTION_RATE = -0.01  #: rate of B = 0.25 - 0.01 t, N m s per s ([Park2008] p. 55); before the inertia scale
DRIFT_NOISE = 0.1  #: standard deviation of the slip noise in the drift simulation, m/s (0.36 km/h)
DRIFT_TIME = 20.0  # duration of the drift simulation, s
_LONGEST_STOP = 80.0  # s; longer than any stop


def reaching_conditions(vehicle: Vehicle, gains: LawGains, *, seed: int) -> tuple[Condition, ...]:
    """Decide whether the conditions on reaching, boundary layer and theta hold for the published law."""
    return (
        reaching_bound(vehicle, gains),
        counterexample(vehicle, gains, seed),
        reaching_simulated(vehicle, gains, tuple(range(seed, seed + RUNS))),
        published_layer(vehicle, gains),
        constant_parameters(vehicle, gains),
        drift(vehicle, gains, seed),
    )


def reaching_bound(vehicle: Vehicle, gains: LawGains) -> Condition:
    """Decide whether the reaching condition, [Park2008] (40), holds over the published run.

    The random force is bounded at one standard deviation. The result has the least K for other operating ranges too.
    """
    other = 1.0 if vehicle.inertia_scale != 1.0 else AS_PUBLISHED_INERTIA_SCALE
    rescaled = vehicle.model_copy(update={"inertia_scale": other})
    box, others_box = (reaching.operating_set(one, sigmas=1.0) for one in (vehicle, rescaled))
    at_reference = {
        (sigmas, torque): reaching.reference_set(vehicle, sigmas=sigmas, with_torque=torque)
        for sigmas in (1.0, 3.0)
        for torque in (True, False)
    }
    surface, without = (
        reaching.surface_needed(vehicle, at_reference[1.0, torque], K=gains.K, D=gains.D) for torque in (True, False)
    )
    least = reaching.least_gain(vehicle, box, rho=gains.rho)
    numbers = {
        **{"K": gains.K, "D": gains.D, "inertia_scale": vehicle.inertia_scale, "box": box, "one_sigma": least},
        "at_reference": [
            (*case, reaching.least_gain(vehicle, one, rho=gains.rho)) for case, one in at_reference.items()
        ],
        "three_sigma": reaching.least_gain(vehicle, reaching.operating_set(vehicle, sigmas=3.0), rho=gains.rho),
        "other_scale": other,
        "other_one_sigma": reaching.least_gain(rescaled, others_box, rho=gains.rho),
        **{"surface": surface, "surface_without_torque": without},
    }
    return Condition("reaching condition (40)", least < gains.K, CORNERS, numbers, claimed=True)


def counterexample(vehicle: Vehicle, gains: LawGains, seed: int) -> Condition:
    """Search the range of the published run for a point where s s' < -eta |s|, [Park2008] (42), fails."""
    box = reaching.operating_set(vehicle, sigmas=3.0)
    known, unknown = (reaching.search(box, vehicle, gains, seed=seed, known_mass=flag) for flag in (True, False))
    numbers = {"known": known, "unknown": unknown, "box": box, "seed": seed}
    how = checked_at(known.evaluations + unknown.evaluations)
    return Condition("s s' < -eta |s| over the box", max(known.excess, unknown.excess) < 0, how, numbers, claimed=True)


def reaching_simulated(vehicle: Vehicle, gains: LawGains, seeds: tuple[int, ...]) -> Condition:
    """Decide by simulation of disturbed stops without actuator whether s reaches 0 and then stays within the layer."""
    run = simulate_ideal(vehicle, gains, duration=_LONGEST_STOP, disturbed=True, seeds=seeds)
    fall = np.diff(0.5 * run.s**2, axis=0)
    finite, start = np.abs(run.s[np.isfinite(run.s)]), float(run.s[0, 0])
    # s must change its sign in every run; `inside` is the share of the time afterwards with |s| in the layer
    crossed = np.cumsum(np.abs(np.diff(np.sign(run.s), axis=0, prepend=np.sign(run.s[:1]))) > 1, axis=0) > 0
    after = crossed & np.isfinite(run.s)
    touched = bool(np.all(np.any(after, axis=0)))
    inside = float(np.mean(np.abs(run.s[after]) < LAYER_WIDTH)) if touched else 0.0
    numbers = {
        **{"layer": LAYER_WIDTH, "seeds": seeds, "inertia_scale": vehicle.inertia_scale, "K": gains.K, "D": gains.D},
        "falling": float(np.mean(fall[np.isfinite(fall)] < 0)),
        "inside": inside,
        "mean": float(np.mean(finite)),
        "largest": float(np.max(finite)),
        "disturbance": float(np.nanmax(np.abs(run.disturbance))),
        "start": start,
        "reaching_time": reaching.reaching_time(vehicle, K=gains.K, D=gains.D, start=start),
    }
    holds = touched and inside == 1.0
    return Condition("sliding reached and kept", holds, "simulated", numbers, claimed=True)


def published_layer(vehicle: Vehicle, gains: LawGains) -> Condition:
    """Add a boundary layer to the published law and decide whether |s| finally stays within the layer."""
    largest = reaching.least_gain(vehicle, reaching.reference_set(vehicle, sigmas=1.0), rho=gains.rho)
    inside = largest / (gains.D + gains.K / LAYER_WIDTH)
    bound = inside if inside <= LAYER_WIDTH else (largest - gains.K) / gains.D
    numbers = {"layer": LAYER_WIDTH, "largest": largest, "bound": bound, "speed": INITIAL_SPEED_KMH * KMH}
    return Condition("boundary layer with K", bound <= LAYER_WIDTH, CORNERS, numbers)


def parameter_step(vehicle: Vehicle, gains: LawGains) -> dict[str, Any]:
    """Return the effects of changed parameters, as in the paper at 25 s, in a stop without disturbances and actuator.

    - end, speed: end of the stop, s; speed at 25 s, m/s (None if the stop ends earlier).
    - theta_step: step of theta1 when the mass changes, 1/(kg m).
    - jump: step of V when the mass changes, m^2/s^2; theta_tilde is 0 before the change.
    - friction_level: V, m^2/s^2, due to theta2_tilde at 25 s, with B = 0.25 - 0.01 t and constant theta2_hat.
    - surface_step: step of s, m/s, if the reference slip becomes that of wet rail (None if the stop ends earlier).
    """
    run = simulate_ideal(vehicle, gains, duration=_LONGEST_STOP)
    end = float(run.time[np.isfinite(run.speed[:, 0])][-1])
    speed = float(np.interp(STEP_TIME, run.time, run.speed[:, 0])) if end > STEP_TIME else None
    theta1 = float(reaching.true_theta(vehicle.loaded(), vehicle)[0])
    friction = vehicle.wheel.viscous_friction + FRICTION_RATE * STEP_TIME
    theta2 = float(reaching.true_theta(reaching.with_friction(vehicle, friction), vehicle)[1])
    jump, level = (theta**2 / (2.0 * k) if k > 0 else math.inf for theta, k in ((theta1, gains.k1), (theta2, gains.k2)))
    step = None if speed is None else (reaching.reference_slip(Rail.WET) - reaching.reference_slip()) * speed
    levels = {"jump": jump, "friction_level": level, "surface_step": step}
    return {"speed": speed, "end": end, "theta_step": theta1, **levels}


def constant_parameters(vehicle: Vehicle, gains: LawGains) -> Condition:
    """Decide whether theta' = 0, as [Park2008] (47) assumes."""
    here = parameter_step(vehicle, gains)
    steps = {vehicle.inertia_scale: here}
    if here["speed"] is None:
        published = vehicle.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})
        steps.setdefault(AS_PUBLISHED_INERTIA_SCALE, parameter_step(published, gains))
    masses = {"mass": vehicle.mass, "mass_loaded": vehicle.mass_loaded}
    holds = here["jump"] == 0.0 and here["friction_level"] == 0.0
    numbers = {**masses, "friction_level": here["friction_level"], "steps": steps}
    return Condition("theta constant", holds, "simulated", numbers, claimed=True)


def measured_drift(vehicle: Vehicle, gains: LawGains, seeds: tuple[int, ...]) -> dict[str, float]:
    """Simulate the drift of theta_hat due to slip noise, at constant 100 km/h on dry rail, from theta_hat = theta.

    The drift is the mean rate, over `DRIFT_TIME`, of k2 omega theta1_hat - k1 Ta theta2_hat, which s does not change at
    constant Ta and omega. Returns `mean` and `standard_error` over the seeds, the `predicted` drift, the drift without
    noise (`noiseless`), and `per_second`, the rate of torque (J/r) |Ta theta1_hat'|, N*m/s, due to the mean drift.
    """
    speed = INITIAL_SPEED_KMH * KMH
    settings: dict[str, Any] = {"duration": DRIFT_TIME, "constant_speed": speed}
    quiet = simulate_ideal(vehicle, gains, **settings)
    run = simulate_ideal(vehicle, gains, slip_noise=DRIFT_NOISE, seeds=seeds, **settings)
    r, sigma = vehicle.wheel.radius, float(quiet.sigma[0, 0])
    omega = (speed - sigma) / r
    h = 1e-4 * speed
    low, torque, high = (
        reaching.rest_adhesion_torque(vehicle, speed, x / speed) for x in (sigma - h, sigma, sigma + h)
    )
    slope = (high - low) / (2.0 * h)
    across = np.array([gains.k2 * omega, -gains.k1 * torque])
    rates = (run.theta_hat[-1] - run.theta_hat[0]) @ across / run.time[-1]
    noiseless = float((quiet.theta_hat[-1, 0] - quiet.theta_hat[0, 0]) @ across / quiet.time[-1])
    # the noise n changes s by -n, Ta by slope * n, omega by -n/r: E[s (omega Ta - Ta omega)] = -n^2 (omega slope +
    # Ta/r); chatter of the wheel is in s and omega alike, and too fast for the adhesion to follow
    chatter = max(0.0, float(np.var(run.s)) - DRIFT_NOISE**2)
    noise = DRIFT_NOISE**2 * (omega * slope + torque / r)
    predicted = -gains.k1 * gains.k2 * (noise + chatter * torque / r)
    mean = float(np.mean(rates))
    # theta_hat stays orthogonal to phi = (Ta, omega), so theta1_hat' Ta + theta2_hat' omega = 0
    first = mean * omega / (gains.k2 * omega**2 + gains.k1 * torque**2)
    per_second = abs(first * torque) * vehicle.effective_inertia / r
    error = float(np.std(rates, ddof=1) / math.sqrt(len(seeds)))
    rest = {"noiseless": noiseless, "per_second": per_second}
    return {"predicted": predicted, "mean": mean, "standard_error": error, **rest}


_DRIFT_RUNS = 32  # seeds of the drift simulation
_EXPLAINED = 0.05  # largest relative error of the predicted drift, which is of second order in the noise


def drift(vehicle: Vehicle, gains: LawGains, seed: int) -> Condition:
    """Decide whether theta_hat drifts under measurement noise."""
    seeds = tuple(range(seed, seed + _DRIFT_RUNS))
    found = measured_drift(vehicle, replace(gains, layer=0.0), seeds)
    mean, error = found["mean"], found["standard_error"]
    explained = abs(mean - found["predicted"]) < _EXPLAINED * abs(mean) + 4.0 * error
    numbers = {"noise": DRIFT_NOISE, "duration": DRIFT_TIME, "seeds": seeds, "drift": found, "explained": explained}
    return Condition("theta_hat bounded under noise", abs(mean) <= 4.0 * error, "simulated", numbers)
