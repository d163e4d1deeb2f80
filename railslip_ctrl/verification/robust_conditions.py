"""The robust variants' conditions: what `robust` proves, for numbers that meet its hypotheses, and seen in runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Vehicle
from railslip_ctrl.sliding.gains import LawGains

from .ideal_loop import PUBLISHED, IdealRun, simulate, true_theta
from .reaching_bound import (
    LOWEST_SPEED_KMH,
    TORQUE_DECAY,
    TORQUE_FRACTION,
    TORQUE_FREQUENCY,
    least_gain,
    reference_slip,
    tolerated_error,
    wet_share,
)
from .reaching_conditions import RUNS
from .reaching_search import search
from .robust import (
    SIGMAS,
    boundary_layer,
    dead_zone,
    effective_torque,
    gain_units,
    layered_design,
    leak,
    leaking_design,
    matrix_gain,
    projection,
    robust_set,
    slowest_rate,
)
from .verdict import Condition

_EXACT = (0.0, 0.0)  # error of an estimate
_DURATION = 60.0  # s; longer than any stop of these designs
_SAMPLES = 100_000
_RISE_TOLERANCE = 1e-3
"""Largest rise of V in a run, relative to V(0), put down to the steps of 2 ms."""

_BESIDE = 1e-3
"""How far beside K_min the search shows that the bound is tight."""

_BOUND_TOLERANCE = 0.01
"""A sampled relay overshoots a bound by one step of K0: this fraction of it is put down to that."""


def robust_conditions(vehicle: Vehicle, *, K: float | None, D: float, seed: int) -> tuple[Condition, ...]:
    """All of them; K of the design unless given (N m), D in N m/(m/s)."""
    layered, leaking = layered_design(vehicle, K=K, D=D), leaking_design(vehicle, K=K, D=D)
    largest = effective_torque(vehicle)
    seeds = tuple(range(seed, seed + RUNS))
    return (
        _units(),
        gain(vehicle, layered, largest),
        _gain_search(vehicle, layered, largest, seed),
        rail_mistaken(vehicle, layered),
        boundary_layer_bound(layered, largest),
        boundary_layer_runs(vehicle, layered, largest, seeds),
        dead_zone_condition(layered, largest),
        _projection(),
        _projection_samples(vehicle, layered, seed),
        _dead_zone_runs(vehicle, layered, largest, seeds),
        leak_condition(vehicle, leaking),
        _leak_runs(vehicle, leaking, seeds),
    )


def _units() -> Condition:
    variant = matrix_gain()
    first, second = gain_units()
    return Condition(
        "matrix gain",
        "theta_hat_i' = k_i s phi_i: units fit and the cross term of V' vanishes for any k_i > 0.",
        variant.proved and first != second,
        "symbolic",
        f"k1 in {first}, k2 {'dimensionless' if second == '1' else 'in ' + second}: V' = {variant.result} without "
        "disturbances.",
    )


def gain(vehicle: Vehicle, gains: LawGains, largest: float) -> Condition:
    """(40) over the box of the design, and the errors of the estimates that K bears."""
    box = robust_set(vehicle)
    exact = replace(box, torque_error=_EXACT, rate_error=_EXACT)
    tolerated = {
        "Ta_hat": tolerated_error(vehicle, exact, "torque_error", K=gains.K),
        "v_rate_hat": tolerated_error(vehicle, exact, "rate_error", K=gains.K),
    }
    holds = largest < gains.K
    return Condition(
        "robust gain",
        "K > (J/r) d_max: (40) down to s = 0 over the box, empty to loaded (mass and wheel load), the estimates Ta_hat "
        "and v'_hat wrong.",
        holds,
        "symbolic",
        f"K = {gains.K:.4g} N m, asked {largest:.4g} N m, with exact estimates {least_gain(vehicle, exact):.4g} N m. "
        f"Box: {box.text()}, theta_hat in the projection's box.",
        down_to_kmh=LOWEST_SPEED_KMH if holds else None,
        tolerated=tolerated,
    )


def _gain_search(vehicle: Vehicle, gains: LawGains, largest: float, seed: int) -> Condition:
    """The plant's own s s' at this K, and beside the bound whether it is tight."""
    box = robust_set(vehicle)
    own = search(box, vehicle, gains, seed=seed)
    below, above = (
        search(box, vehicle, replace(gains, K=factor * largest), seed=seed) for factor in (1 - _BESIDE, 1 + _BESIDE)
    )
    return Condition(
        "robust gain, search",
        "No point of that box has s s' >= 0 at s -> 0 under the law with this K.",
        own.excess < 0,
        "sampled",
        f"Largest s s'/|s| found: {own.excess:.4g} m/s^2 at {own.text()}; at K_min less {100 * _BESIDE:g} % "
        f"{below.excess:+.2g}, at K_min and {100 * _BESIDE:g} % more {above.excess:+.2g} m/s^2. Corners, random "
        f"points (seed {seed}), then L-BFGS-B: {own.evaluations + below.evaluations + above.evaluations} points.",
        down_to_kmh=LOWEST_SPEED_KMH if own.excess < 0 else None,
    )


def rail_mistaken(vehicle: Vehicle, gains: LawGains) -> Condition:
    """(40) where Ta_hat is that of the other rail."""
    box = robust_set(vehicle)
    wet = wet_share(vehicle)
    (low, high), (least, most) = box.torque_error, box.adhesion_torque
    taken_for_wet = replace(box, torque_error=(wet * (1.0 + low) - 1.0, high))
    taken_for_dry = replace(
        box, torque_error=(low, (1.0 + high) / wet - 1.0), adhesion_torque=(wet * least, wet * most)
    )
    asked = {
        "dry taken for wet": least_gain(vehicle, taken_for_wet),
        "wet taken for dry": least_gain(vehicle, taken_for_dry),
    }
    holds = max(asked.values()) < gains.K
    return Condition(
        "robust gain, rail mistaken",
        "K > (J/r) d_max with the Ta_hat of the other rail too.",
        holds,
        "symbolic",
        f"K = {gains.K:.4g} N m, asked {', '.join(f'{value:.4g} N m ({name})' for name, value in asked.items())}, the "
        f"wet rail's Ta being {wet:.3g} of the dry one's.",
        down_to_kmh=LOWEST_SPEED_KMH if holds else None,
    )


def layer_bound(gains: LawGains, largest: float) -> float:
    """Ultimate bound of |s|, m/s, inside the layer: (J/r)d_max/(D + K/Phi)."""
    return largest / (gains.D + gains.K / gains.layer)


def boundary_layer_bound(gains: LawGains, largest: float) -> Condition:
    """Its closed-form bound, for (J/r)|d| <= largest (N m)."""
    variant = boundary_layer()
    met = largest <= gains.K + gains.D * gains.layer
    holds = variant.proved and met
    return Condition(
        "boundary layer, bound",
        "sat(s/Phi), theta known, (J/r)d_max <= K + D Phi: |s| ends below (J/r)d_max/(D + K/Phi) <= Phi.",
        holds,
        "symbolic",
        (f"|s| <= {layer_bound(gains, largest):.4g} m/s" if met else "K + D Phi is less, so no bound in the layer")
        + f": K = {gains.K:.4g} N m, D = {gains.D:.4g} N m/(m/s), Phi = {gains.layer:g} m/s, (J/r)d_max = "
        f"{largest:.4g} N m. {variant.argument}.",
        down_to_kmh=LOWEST_SPEED_KMH if holds else None,
    )


def boundary_layer_runs(vehicle: Vehicle, gains: LawGains, largest: float, seeds: tuple[int, ...]) -> Condition:
    """Disturbed ideal stops against that bound."""
    still = replace(gains, k1=0.0, k2=0.0, box=None, dead_zone=False)
    run = simulate(vehicle, still, duration=_DURATION, disturbances=PUBLISHED, seeds=seeds)
    disturbed = float(np.nanmax(np.abs(effective_disturbance(run, gains))))
    met = largest <= gains.K + gains.D * gains.layer
    if met:
        bound = layer_bound(gains, largest)
        reached, highest = _after_entry(run, gains.layer, bound)
        kept = math.isfinite(reached) and highest <= bound * (1 + _BOUND_TOLERANCE) and disturbed <= largest
        seen = f"|s| below {highest:.4g} m/s from {reached:.3g} s on, bound {bound:.4g}"
    else:
        kept, seen = False, f"no bound within the layer to stay below; |s| up to {np.nanmax(np.abs(run.s)):.4g} m/s"
    return Condition(
        "boundary layer, runs",
        "In disturbed ideal stops |s| stays below the ultimate bound, itself within the layer, once it is inside.",
        kept,
        "simulated",
        f"{seen}; (J/r)|d| up to {disturbed:.4g} of {largest:.4g} N m. {_runs_text(vehicle, seeds)}, theta known.",
        down_to_kmh=LOWEST_SPEED_KMH if kept else None,
    )


def _runs_text(vehicle: Vehicle, seeds: tuple[int, ...]) -> str:
    return (
        f"{len(seeds)} stops, dry, seeds {seeds[0]} to {seeds[-1]}, published disturbances cut at {SIGMAS:g} sigma, "
        "exact estimates"
    )


def effective_disturbance(run: IdealRun, gains: LawGains) -> np.ndarray:
    """(J/r) d of s' = theta_tilde' phi + h (d - D0 s - K0 sat), N*m, along a run with the published Td."""
    switched = np.clip(run.s / gains.layer, -1.0, 1.0) if gains.layer > 0 else np.sign(run.s)
    fraction = TORQUE_FRACTION * np.exp(-TORQUE_DECAY * run.time) * np.sin(TORQUE_FREQUENCY * run.time)
    q = fraction[:, None]
    return np.asarray((run.disturbance + q * (gains.D * run.s + gains.K * switched)) / (1.0 + q))


def _after_entry(run: IdealRun, layer: float, bound: float) -> tuple[float, float]:
    """Latest first time inside the bound, s (inf where a run never is), and the largest |s| after each run's own."""
    size = np.abs(run.s)
    inside = size <= bound
    if not np.all(np.any(inside, axis=0)):
        return math.inf, layer
    first = np.argmax(inside, axis=0)
    rows = np.arange(len(run.time))[:, None]
    after = np.where(rows >= first, size, np.nan)
    return float(run.time[np.max(first)]), float(np.nanmax(after))


def dead_zone_condition(gains: LawGains, largest: float) -> Condition:
    """V' with the dead zone, the projection beside it, for (J/r)|d| <= largest (N m)."""
    variant = dead_zone()
    met = gains.box is not None and largest <= gains.K + gains.D * gains.layer
    holds = variant.proved and projection().proved and met
    return Condition(
        "dead zone in the adaptation",
        "theta_hat_i' = k_i s_D phi_i, s_D = s - Phi sat(s/Phi), theta_hat held in the box by the projection, V in "
        "s_D: V' <= -(1 - c) D0 s_D^2 for all |d| <= d_max, so |s| -> [0, Phi] with theta unknown (constant).",
        holds,
        "symbolic",
        f"Needs (J/r)d_max = {largest:.4g} <= K + D Phi = {gains.K + gains.D * gains.layer:.4g} N m and the projection"
        f"{'' if gains.box is not None else ', which there is none of'}: {variant.argument}; s_D^2 is integrable and "
        "s_D' bounded (Barbalat).",
        down_to_kmh=LOWEST_SPEED_KMH if holds else None,
    )


def _projection() -> Condition:
    variant = projection()
    return Condition(
        "projection",
        "theta_hat held in a box that contains theta, its rate cut to 0 where it would leave: V' is not larger than "
        "without, and theta_hat is bounded whatever disturbs.",
        variant.proved,
        "symbolic",
        f"{variant.argument}.",
    )


def _projection_samples(vehicle: Vehicle, gains: LawGains, seed: int) -> Condition:
    """The cross term at random points, faces included."""
    worst = largest_cross_term(gains, seed=seed)
    assert gains.box is not None, "the design has one"
    sides = ", ".join(f"[{low:.3g}, {high:.3g}]" for low, high in gains.box)
    theta = true_theta(vehicle.loaded(), vehicle)
    contains = all(low <= value <= high for value, (low, high) in zip(theta, gains.box, strict=True))
    return Condition(
        "projection, samples",
        "The cross term of V' under projection is not positive, and the box contains the loaded vehicle's theta.",
        worst <= 0.0 and contains,
        "sampled",
        f"{_SAMPLES} points (seed {seed}): theta and theta_hat in the box {sides}, half of theta_hat on a face, |s| "
        f"<= 4 m/s, 0 <= Ta <= 6000 N m, 0 <= omega <= 70 rad/s: largest cross term {worst:.3g} m^2/s^3.",
    )


def projected(rate: np.ndarray, hat: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The rate with what would leave the box set to 0; arrays of one shape."""
    leaves = ((hat >= high) & (rate > 0)) | ((hat <= low) & (rate < 0))
    return np.where(leaves, 0.0, rate)


def largest_cross_term(gains: LawGains, *, seed: int, samples: int = _SAMPLES) -> float:
    """Largest sum theta_tilde_i (s phi_i - theta_hat_i'/k_i), m^2/s^3, at random points of the box and its faces."""
    assert gains.box is not None, "projection needs a box"
    generator = np.random.default_rng(seed)
    low, high = np.array(gains.box).T[:, :, None]
    fraction = generator.random((2, samples))
    onto = generator.integers(0, 4, (2, samples))
    fraction = np.where(onto == 0, 0.0, np.where(onto == 1, 1.0, fraction))
    hat = np.where(onto == 1, high, low + (high - low) * fraction)
    theta = low + (high - low) * generator.random((2, samples))
    s = generator.uniform(-4.0, 4.0, samples)
    phi = np.stack((generator.uniform(0, 6000, samples), generator.uniform(0, 70, samples)))
    free = s * phi  # the law's rate over its gain: the gains do not matter to the sign
    return float(np.max(np.sum((theta - hat) * (free - projected(free, hat, low, high)), axis=0)))


def _dead_zone_runs(vehicle: Vehicle, gains: LawGains, largest: float, seeds: tuple[int, ...]) -> Condition:
    """The whole design on a loaded vehicle it takes for empty."""
    loaded = vehicle.loaded()
    run = simulate(loaded, gains, nominal=vehicle, duration=_DURATION, disturbances=PUBLISHED, seeds=seeds)
    V = layered_lyapunov(run, gains)
    rise = _largest_rise(V) / float(V[0, 0])
    assert gains.box is not None, "the design has one"
    low, high = np.array(gains.box).T
    hats = run.theta_hat[np.isfinite(run.theta_hat[..., 0])]
    boxed = bool(np.all((hats >= low) & (hats <= high)))
    reached, highest = _after_entry(run, gains.layer, gains.layer)
    disturbed = float(np.nanmax(np.abs(effective_disturbance(run, gains))))
    within = highest <= gains.layer * (1 + _BOUND_TOLERANCE)
    holds = rise <= _RISE_TOLERANCE and boxed and math.isfinite(reached) and within and disturbed <= largest
    return Condition(
        "layer, dead zone, projection: runs",
        "The whole design on a loaded vehicle it takes for empty: V never rises, |s| stays in the layer once there, "
        "theta_hat in its box.",
        holds,
        "simulated",
        f"Largest rise of V {rise:.1e} V(0), |s| <= {highest:.4g} m/s from {reached:.3g} s on (Phi = {gains.layer:g}), "
        f"theta_hat in its box: {'yes' if boxed else 'no'}; (J/r)|d| up to {disturbed:.4g} of {largest:.4g} N m. "
        f"{_runs_text(vehicle, seeds)}, M = {loaded.mass:g} kg taken for {vehicle.mass:g}.",
        down_to_kmh=LOWEST_SPEED_KMH if holds else None,
    )


def layered_lyapunov(run: IdealRun, gains: LawGains) -> np.ndarray:
    """V with s_D in place of s, m^2/s^2: V less s^2/2 plus s_D^2/2."""
    outside = np.maximum(np.abs(run.s) - gains.layer, 0.0)
    return np.asarray(run.V - 0.5 * run.s**2 + 0.5 * outside**2)


def _largest_rise(V: np.ndarray) -> float:
    """Largest rise above an earlier lowest value."""
    known = np.where(np.isfinite(V), V, np.inf)
    lowest = np.minimum.accumulate(known, axis=0)
    with np.errstate(invalid="ignore"):
        return float(np.nanmax(V - lowest))


@dataclass(frozen=True)
class LeakBound:
    """V(t) <= V(0) exp(-c t) + level (1 - exp(-c t)): c in 1/s, V in m^2/s^2; `surface` is |s| at that level, m/s.

    `gain`: what (40) asks of K, N*m, over the theta_hat that V <= max(V(0), level) allows, from free rolling at 100
    km/h with theta_hat = 0: with a larger K that set is invariant.
    """

    rate: float
    level: float
    surface: float
    start: float
    gain: float


def leak_bound(vehicle: Vehicle, gains: LawGains) -> LeakBound:
    """For the loaded vehicle's theta, the largest."""
    theta = true_theta(vehicle.loaded(), vehicle)
    k = (gains.k1, gains.k2)
    of_theta = sum(float(one) ** 2 / (2.0 * gain) for one, gain in zip(theta, k, strict=True))
    c = min(slowest_rate(vehicle, gains.D), gains.leak)
    level = gains.leak * of_theta / c
    start = 0.5 * (reference_slip() * INITIAL_SPEED_KMH * KMH) ** 2 + of_theta
    # |theta_tilde_i| <= sqrt(2 k_i V), and theta is between 0, empty, and the loaded vehicle's
    reach = [math.sqrt(2.0 * gain * max(start, level)) for gain in k]
    first, second = ((min(0.0, float(x)) - w, max(0.0, float(x)) + w) for x, w in zip(theta, reach, strict=True))
    asked = least_gain(vehicle, replace(robust_set(vehicle), theta_hat1=first, theta_hat2=second))
    return LeakBound(c, level, math.sqrt(2.0 * level), start, asked)


def leak_condition(vehicle: Vehicle, gains: LawGains) -> Condition:
    """The bound, over the set of theta_hat that it makes invariant itself."""
    variant, bound = leak(), leak_bound(vehicle, gains)
    holds = variant.proved and bound.gain < gains.K
    return Condition(
        "sigma-modification, bound",
        "theta_hat_i' = k_i s phi_i - ell theta_hat_i: V' <= -c V + ell V_theta, c = min(2 h D0, ell), h >= "
        f"{1 - TORQUE_FRACTION:g}, V_theta = sum theta_i^2/(2 k_i): V ends below ell V_theta/c.",
        holds,
        "symbolic",
        f"K = {gains.K:.4g} N m, asked {bound.gain:.4g} N m over the theta_hat in V <= "
        f"{max(bound.start, bound.level):.4g} m^2/s^2, a set that is then invariant. V ends below {bound.level:.4g} "
        "m^2/s^2, |s| below "
        f"{bound.surface:.3g} m/s (ell = {gains.leak:.3g} 1/s, loaded). {variant.argument}.",
        down_to_kmh=LOWEST_SPEED_KMH if holds else None,
    )


def _leak_runs(vehicle: Vehicle, gains: LawGains, seeds: tuple[int, ...]) -> Condition:
    loaded = vehicle.loaded()
    run = simulate(loaded, gains, nominal=vehicle, duration=_DURATION, disturbances=PUBLISHED, seeds=seeds)
    bound = leak_bound(vehicle, gains)
    decay = np.exp(-bound.rate * run.time)[:, None]
    envelope = run.V[0] * decay + bound.level * (1.0 - decay)
    share = float(np.nanmax(run.V / envelope))
    met = bound.gain < gains.K
    disturbed = float(np.nanmax(np.abs(effective_disturbance(run, gains))))
    holds = met and share <= 1.0 + _BOUND_TOLERANCE and disturbed <= bound.gain
    return Condition(
        "sigma-modification, runs",
        "In disturbed ideal stops V stays below V(0) exp(-c t) + (ell V_theta/c)(1 - exp(-c t)).",
        holds,
        "simulated",
        f"V at most {share:.4g} of that envelope (1 at the start); at the end |s| <= {_final(run):.3g} m/s. "
        + ("" if met else f"K < {bound.gain:.4g} N m: the envelope is not proved. ")
        + f"{_runs_text(vehicle, seeds)}, M = {loaded.mass:g} kg taken for {vehicle.mass:g}.",
        down_to_kmh=LOWEST_SPEED_KMH if holds else None,
    )


def _final(run: IdealRun) -> float:
    """Largest |s| over the last second of the shortest run."""
    end = int(np.min(np.sum(np.isfinite(run.s), axis=0)))
    last = run.s[max(0, end - round(1.0 / run.time[1])) : end]
    return float(np.max(np.abs(last)))
