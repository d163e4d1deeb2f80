"""The robust variants' conditions: what `robust` proves, for numbers that meet its hypotheses, and seen in runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from railslip_ctrl.parameters import Vehicle

from .gains import LawGains
from .ideal_loop import PUBLISHED, IdealRun, simulate, true_theta
from .reaching_bound import TORQUE_DECAY, TORQUE_FRACTION, TORQUE_FREQUENCY, reference_slip
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
        _gain(vehicle, layered, largest),
        _gain_search(vehicle, layered, largest, seed),
        boundary_layer_bound(layered, largest),
        boundary_layer_runs(vehicle, layered, largest, seeds),
        dead_zone_condition(layered, largest),
        _projection(),
        _projection_samples(vehicle, layered, seed),
        _dead_zone_runs(vehicle, layered, largest, seeds),
        _leak(vehicle, leaking, largest),
        _leak_runs(vehicle, leaking, largest, seeds),
    )


def _units() -> Condition:
    variant = matrix_gain()
    first, second = gain_units()
    return Condition(
        "matrix gain",
        "theta_hat_i' = k_i s phi_i, Gamma = diag(k1, k2): units fit and the cross term of V' vanishes for any "
        "k_i > 0.",
        variant.proved and first != second,
        "symbolic",
        f"k1 in {first}, k2 {'dimensionless' if second == '1' else 'in ' + second}; {variant.argument}: "
        f"V' = {variant.result} without disturbances.",
    )


def _gain(vehicle: Vehicle, gains: LawGains, largest: float) -> Condition:
    return Condition(
        "robust gain",
        "K > (J/r) d_max: the reaching condition (40) down to s = 0, with Td a fraction of the torque K is part of.",
        largest < gains.K,
        "symbolic",
        f"K = {gains.K:.4g} N m against {largest:.4g} N m, the maximum of [(J/r)|d(Tr, Fr)| + c |Ueq|]/(1 - c), c = "
        f"{TORQUE_FRACTION:g}, over: {robust_set(vehicle).text(reference_slip())}, theta_hat in the box of the "
        f"projection, Tr at {SIGMAS:g} sigma; the torque acts at once (no actuator).",
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
        f"Largest s s'/|s| of the plant's numeric rates found: {own.excess:.4g} m/s^2 at {own.text()}; at K_min less "
        f"{100 * _BESIDE:g} % {below.excess:+.2g}, at K_min and {100 * _BESIDE:g} % more {above.excess:+.2g} m/s^2. "
        f"Differential evolution from random points (seed {seed}), then L-BFGS-B; "
        f"{own.evaluations + below.evaluations + above.evaluations} evaluations.",
    )


def layer_bound(gains: LawGains, largest: float) -> float:
    """Ultimate bound of |s|, m/s, inside the layer: (J/r)d_max/(D + K/Phi)."""
    return largest / (gains.D + gains.K / gains.layer)


def boundary_layer_bound(gains: LawGains, largest: float) -> Condition:
    """Its closed-form bound, for (J/r)|d| <= largest (N m)."""
    variant = boundary_layer()
    met = largest <= gains.K + gains.D * gains.layer
    return Condition(
        "boundary layer, bound",
        "sat(s/Phi), theta known, (J/r)d_max <= K + D Phi: |s| ends below (J/r)d_max/(D + K/Phi) <= Phi.",
        variant.proved and met,
        "symbolic",
        f"{variant.result}: {variant.argument}. K = {gains.K:.4g} N m, D = {gains.D:.4g} N m/(m/s), Phi = "
        f"{gains.layer:g} m/s, (J/r)d_max = {largest:.4g} N m: "
        + (f"|s| <= {layer_bound(gains, largest):.4g} m/s." if met else "K + D Phi is less, so no bound in the layer."),
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
        f"{_runs_text(vehicle, seeds)}, published disturbances cut at {SIGMAS:g} sigma, theta known: {seen}; "
        f"(J/r)|d| up to {disturbed:.4g} of {largest:.4g} N m.",
    )


def _runs_text(vehicle: Vehicle, seeds: tuple[int, ...]) -> str:
    return (
        f"{len(seeds)} stops from 100 km/h, free rolling, dry, seeds {seeds[0]} to {seeds[-1]}, inertia scale "
        f"{vehicle.inertia_scale:g}"
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
    return Condition(
        "dead zone in the adaptation",
        "theta_hat_i' = k_i s_D phi_i, s_D = s - Phi sat(s/Phi), held in the box by the projection, V in s_D: V' <= "
        "-(1 - c) D0 s_D^2 for all |d| <= d_max, so s_D -> 0 with theta unknown (constant).",
        variant.proved and projection().proved and gains.box is not None and largest <= gains.K + gains.D * gains.layer,
        "symbolic",
        f"{variant.argument}. s_D^2 is integrable and s_D' bounded, so |s| -> [0, Phi] (Barbalat); theta_hat is "
        f"bounded by V and rests inside the layer, noise within it moves nothing. Needs (J/r)d_max = {largest:.4g} <= "
        f"K + D Phi = {gains.K + gains.D * gains.layer:.4g} N m. d_max counts theta_hat in the box: the projection, "
        "which never adds to V', keeps it there; the dead zone alone would not.",
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
    return Condition(
        "layer, dead zone, projection: runs",
        "The whole design on a loaded vehicle it takes for empty: V never rises, |s| stays in the layer once there, "
        "theta_hat in its box.",
        rise <= _RISE_TOLERANCE and boxed and math.isfinite(reached) and within and disturbed <= largest,
        "simulated",
        f"{_runs_text(vehicle, seeds)}, published disturbances cut at {SIGMAS:g} sigma, M = {loaded.mass:g} kg taken "
        f"for {vehicle.mass:g}: largest rise of V {rise:.1e} V(0), |s| <= {highest:.4g} m/s from {reached:.3g} s on "
        f"(Phi = {gains.layer:g}), theta_hat in its box: {'yes' if boxed else 'no'}; (J/r)|d| up to {disturbed:.4g} of "
        f"{largest:.4g} N m.",
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
    """V(t) <= V(0) exp(-c t) + level (1 - exp(-c t)): c in 1/s, V in m^2/s^2; `surface` is |s| at that level, m/s."""

    rate: float
    level: float
    surface: float


def leak_bound(vehicle: Vehicle, gains: LawGains) -> LeakBound:
    """For the loaded vehicle's theta."""
    theta = true_theta(vehicle.loaded(), vehicle)
    of_theta = float(theta[0] ** 2 / (2 * gains.k1) + theta[1] ** 2 / (2 * gains.k2))
    c = min(slowest_rate(vehicle, gains.D), gains.leak)
    level = gains.leak * of_theta / c
    return LeakBound(c, level, math.sqrt(2.0 * level))


def _leak(vehicle: Vehicle, gains: LawGains, largest: float) -> Condition:
    variant = leak()
    bound = leak_bound(vehicle, gains)
    return Condition(
        "sigma-modification, bound",
        "theta_hat_i' = k_i s phi_i - ell theta_hat_i, K >= (J/r)d_max: V' <= -c V + ell V_theta, c = min(2 h D0, "
        f"ell), h >= {1 - TORQUE_FRACTION:g}, V_theta = sum theta_i^2/(2 k_i): V ends below ell V_theta/c.",
        variant.proved and largest <= gains.K,
        "symbolic",
        f"{variant.argument}. ell = 2 h D0 = {gains.leak:.3g} 1/s, loaded vehicle's theta: V ends below "
        f"{bound.level:.4g} m^2/s^2, |s| below {bound.surface:.3g} m/s: looser than the layer. "
        "d_max counts theta_hat in the box of the projection, which the leak does not enforce: the runs show it.",
    )


def _leak_runs(vehicle: Vehicle, gains: LawGains, largest: float, seeds: tuple[int, ...]) -> Condition:
    loaded = vehicle.loaded()
    run = simulate(loaded, gains, nominal=vehicle, duration=_DURATION, disturbances=PUBLISHED, seeds=seeds)
    bound = leak_bound(vehicle, gains)
    decay = np.exp(-bound.rate * run.time)[:, None]
    envelope = run.V[0] * decay + bound.level * (1.0 - decay)
    share = float(np.nanmax(run.V / envelope))
    met = largest <= gains.K
    disturbed = float(np.nanmax(np.abs(effective_disturbance(run, gains))))
    return Condition(
        "sigma-modification, runs",
        "In disturbed ideal stops V stays below V(0) exp(-c t) + (ell V_theta/c)(1 - exp(-c t)).",
        met and share <= 1.0 + _BOUND_TOLERANCE and disturbed <= largest,
        "simulated",
        f"{_runs_text(vehicle, seeds)}, published disturbances cut at {SIGMAS:g} sigma, M = {loaded.mass:g} kg taken "
        f"for {vehicle.mass:g}: V at most {share:.4g} of that envelope (1 at the start); at the end |s| <= "
        f"{_final(run):.3g} m/s." + ("" if met else f" K < {largest:.4g} N m: the envelope is not proved."),
    )


def _final(run: IdealRun) -> float:
    """Largest |s| over the last second of the shortest run."""
    end = int(np.min(np.sum(np.isfinite(run.s), axis=0)))
    last = run.s[max(0, end - round(1.0 / run.time[1])) : end]
    return float(np.max(np.abs(last)))
