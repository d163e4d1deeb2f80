"""Robust variants of the published law, derived and verified: boundary layer, dead zone, projection, leak, matrix gain.

The variants use the derived error dynamics and the Lyapunov function V with an adaptation gain for each component of
theta. Let Td = q Tb with the acting torque Tb. Then s' = theta_tilde' phi + h (d - D0 s - K0 sgn s) with h = 1 + q > 0,
and the law's regressor is phi = (Ta_hat, omega). The effective disturbance d includes the errors of Ta_hat and v'_hat,
but not s, D or K (`effective_disturbance`). d_max bounds |d|, m/s^2, and (J/r) d_max is the least K with which the
reaching condition, [Park2008] (40), holds. The actuator is not included: the torque acts at once. Each
condition is decided by a proof with checked hypotheses, at points of a box, or by simulated runs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import sympy as sp

from railslip_ctrl.controllers.linear import full_brake_torque
from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Rail, Vehicle
from railslip_ctrl.sliding.derivation import THETA, D, Derivation, K, derive, k1, k2, s
from railslip_ctrl.sliding.derivation import THETA_HAT as HAT
from railslip_ctrl.sliding.derivation import THETA_HAT_RATE as RATE
from railslip_ctrl.sliding.derivation import THETA_TILDE as TILDE
from railslip_ctrl.sliding.law import PUBLISHED_LAW, LawGains
from railslip_ctrl.sliding.proof import identical
from railslip_ctrl.verification import reaching

from .fixed_step import RUNS, IdealRun, simulate_ideal
from .verdict import BY_CORNERS, CORNERS, Condition, checked_at

GAINS = (k1, k2)
LAYER = sp.Symbol("Phi", positive=True)
LEAK = sp.Symbol("ell", positive=True)
d, d_max = sp.Symbol("d", real=True), sp.Symbol("d_max", nonnegative=True)
SHARE = sp.Symbol("h", positive=True)  # 1 + Td/Tb
# differences in the proofs: s minus a bound, d_max minus d, gain minus the least gain of (40)
_outside = sp.Symbol("x", positive=True)
_below, _spare = sp.Symbol("y", nonnegative=True), sp.Symbol("m", nonnegative=True)

D0, K0 = plant.r / plant.J * D, plant.r / plant.J * K

SIGMAS = 3.0  #: bound of the random adhesion force in the designs, standard deviations
ESTIMATE_ERROR = 0.1  #: relative error of Ta_hat and of v'_hat in the designs
BRAKE_GAIN = 0.15  #: relative error of the brake's gain (friction of the pads), either way
INERTIA_ERROR = 0.05  #: relative error of the law's J
GAIN_MARGIN = 1.1  #: ratio of K to the least gain of (40)
LAYER_WIDTH = 0.2  # half width of the boundary layer, m/s: 0.7 % of slip at 100 km/h
_BOX_MARGIN = 0.1  # margin of `parameter_box` at either side, relative to the farthest theta
LOWEST_FRICTION = -0.25  # B at the end of the longest published stop, N m s: the printed 0.25 - 0.01 t at 50 s


@cache
def effective_disturbance() -> sp.Expr:
    """Derive d of s' = theta_tilde' phi + h (d - D0 s - K0 sgn s), m/s^2; ArithmeticError if d contains s, D or K."""
    effective = sp.expand((reaching.effective_rate(derive(), SHARE) + SHARE * (D0 * s + K0 * sp.sign(s))) / SHARE)
    if effective.has(s, D, K, *TILDE):
        raise ArithmeticError(
            "the effective disturbance depends on s, D or K, because the plant or the law was changed; adapt the proof"
        )
    return effective


def _error_rate(made: Derivation) -> sp.Expr:
    effective_disturbance()  # raises ArithmeticError if s' does not have this form
    ideal = made.error_dynamics - made.disturbance_perturbed
    known = ideal.subs(dict.fromkeys(TILDE, 0))
    return sp.expand(ideal - known + SHARE * (known + d))


def _lyapunov_rate(made: Derivation, error_rate: sp.Expr) -> sp.Expr:
    rate = sp.diff(made.V_matrix, s) * error_rate
    return rate - sum(sp.diff(made.V_matrix, a) * b for a, b in zip(TILDE, RATE, strict=True))


@cache
def boundary_layer_proved() -> bool:
    """Prove that |s| falls to d_max/(D0 + K0/Phi) with sat(s/Phi) and known theta, if d_max <= K0 + D0 Phi."""
    known = _error_rate(derive()).subs(dict.fromkeys(TILDE, 0))
    inside = known.subs(sp.sign(s), s / LAYER)
    bound = sp.solve(inside.subs(d, d_max), s)[0]
    # above the bound s falls at least at the rate h x (D0 + K0/Phi); for s < 0 by symmetry, because s' is odd in (s, d)
    beyond = inside.subs(d, d_max - _below).subs(s, bound + _outside)
    above = known.subs(sp.sign(s), 1).subs(s, LAYER + _outside).subs(d, d_max - _below)
    entered = sp.expand(above.subs(d_max, K0 + D0 * LAYER - _spare))
    odd = identical(known.subs({s: -s, d: -d}, simultaneous=True), -known)
    falls = sp.expand(sp.simplify(beyond)).equals(sp.expand(-SHARE * (_below + (D0 + K0 / LAYER) * _outside)))
    within = sp.simplify(LAYER - bound.subs(d_max, K0 + D0 * LAYER - _spare)).is_nonnegative
    return bool(odd and falls and sp.expand(-entered).is_positive and within)


@cache
def dead_zone_proved() -> bool:
    """Prove V' <= -h D0 s_D^2 for the dead zone; s_D = s - Phi sat(s/Phi) replaces s in V and in the adaptation."""
    made = derive()
    above = _error_rate(made).subs(sp.sign(s), 1)
    # s > Phi, with s_D = x; s < -Phi follows by symmetry
    value = (made.V_matrix.subs(s, s - LAYER)).diff(s) * above
    value -= sum(sp.diff(made.V_matrix, a) * b for a, b in zip(TILDE, RATE, strict=True))
    adaptation = sp.solve([sp.diff(value, a) for a in TILDE], RATE, dict=True)[0]
    final = value.subs(adaptation).subs(s, LAYER + _outside)
    final = sp.expand(final.subs(d, d_max - _below).subs(d_max, K0 + D0 * LAYER - _spare))
    drives = [(adaptation[a] - gain * (s - LAYER) * p) for a, gain, p in zip(RATE, GAINS, made.phi, strict=True)]
    adapts = all(sp.expand(one) == 0 for one in drives) and not final.has(*TILDE)
    return bool(adapts and sp.expand(-final - SHARE * D0 * _outside**2).is_nonnegative)


@cache
def projection_proved() -> bool:
    """Prove: if theta_hat is projected onto a box that contains theta, the cross term of V' is <= 0, and 0 inside."""
    made = derive()
    rate = sp.expand(_lyapunov_rate(made, _error_rate(made)))
    cross = sp.expand(rate - rate.subs(dict.fromkeys(TILDE, 0)))
    free = dict(zip(RATE, made.adaptation_matrix, strict=True))
    distance, push = sp.Symbol("w", nonnegative=True), sp.Symbol("g", positive=True)
    signs = []
    for i, (tilde, phi) in enumerate(zip(TILDE, made.phi, strict=True)):
        other = {TILDE[1 - i]: 0}
        signs.append(sp.expand(cross.subs(free)) == 0)
        # upper face: theta_tilde = -w, and s phi_i = g > 0 points outward; lower face: both signs change
        for side in (1, -1):
            at_face = cross.subs(other).subs({RATE[0]: 0, RATE[1]: 0}).subs(tilde, -side * distance)
            signs.append(bool((-at_face).subs(s, side * push / phi).is_nonnegative))
    return all(signs)


@cache
def leak_proved() -> bool:
    """Prove V' <= -c V + ell V_theta with c = min(2 h D0, ell), for K0 >= d_max and an adaptation with leak ell.

    theta_hat_i' = k_i s phi_i - ell theta_hat_i, V_theta = sum theta_i^2/(2 k_i), D0 = (r/J) D and K0 = (r/J) K.
    """
    made = derive()
    rate = _lyapunov_rate(made, _error_rate(made))
    leaking = {a: free - LEAK * hat for a, free, hat in zip(RATE, made.adaptation_matrix, HAT, strict=True)}
    hats = {hat: theta - tilde for hat, theta, tilde in zip(HAT, THETA, TILDE, strict=True)}
    rate = sp.expand(rate.subs(leaking).subs(hats))
    of_theta = sum(theta**2 / (2 * gain) for theta, gain in zip(THETA, GAINS, strict=True))
    of_error = sum(tilde**2 / (2 * gain) for tilde, gain in zip(TILDE, GAINS, strict=True))
    bound = -2 * SHARE * D0 * s**2 / 2 - LEAK * of_error + LEAK * of_theta
    # the slack is |s| (K0 - d sgn s), positive by (40), and the squares ell theta_hat^2/(2 k)
    slack = sp.expand(bound - rate)
    squares = sum(LEAK * (theta - tilde) ** 2 / (2 * g) for theta, tilde, g in zip(THETA, TILDE, GAINS, strict=True))
    rest = SHARE * (K0 * s * sp.sign(s) - s * d)
    return identical(slack, squares + rest)


@cache
def matrix_gain() -> tuple[bool, sp.Expr]:
    """Prove for theta_hat_i' = k_i s phi_i that V' = -(r/J)(D s^2 + K |s|) for any gains > 0; return (verdict, V')."""
    made = derive()
    rate = _lyapunov_rate(made, _error_rate(made).subs({d: 0, SHARE: 1}))
    final = sp.expand(rate.subs(dict(zip(RATE, made.adaptation_matrix, strict=True))))
    expected = -D0 * s**2 - K0 * s * sp.sign(s)
    return identical(final, expected), sp.factor(final)


def gain_units() -> tuple[str, str]:
    """Return the units of k1 and k2, from s' = theta' phi and theta_hat_i' = k_i s phi_i."""
    kg, metre, second = units = sp.symbols("kg m s", positive=True)
    found = []
    for phi in (kg * metre**2 / second**2, 1 / second):  # Ta, omega
        theta_rate = metre / second**2 / phi / second
        powers = sp.Mul(theta_rate / (metre / second * phi)).as_powers_dict()
        found.append(" ".join(f"{unit}^{powers[unit]}" for unit in units if powers[unit]) or "1")
    return found[0], found[1]


def robust_set(vehicle: Vehicle) -> reaching.ReachingSet:
    """Return the box for which K is designed: `reaching.operating_set` with errors of estimates, brake gain and J."""
    first, second = parameter_box(vehicle)
    wrong = (-ESTIMATE_ERROR, ESTIMATE_ERROR)
    box = reaching.operating_set(vehicle, sigmas=SIGMAS)
    inertia = (-INERTIA_ERROR, INERTIA_ERROR)
    estimates: dict[str, Any] = {"theta_hat1": first, "theta_hat2": second, "torque_error": wrong, "rate_error": wrong}
    return replace(box, **estimates, inertia_error=inertia, brake_gain=BRAKE_GAIN)


def effective_torque(vehicle: Vehicle) -> float:
    """Return (J/r) d_max over `robust_set`, N*m: the least gain K above which [Park2008] (40) holds."""
    return reaching.least_gain(vehicle, robust_set(vehicle))


def design_gain(vehicle: Vehicle) -> float:
    """Return the gain K, N*m: `GAIN_MARGIN` times the least K of (40) over `robust_set`."""
    return GAIN_MARGIN * effective_torque(vehicle)


def dead_zone_design(vehicle: Vehicle, *, K: float | None = None, D: float = PUBLISHED_LAW.D) -> LawGains:
    """Return gains with boundary layer, dead zone, projection and matrix gain; K by default from `design_gain`."""
    K = design_gain(vehicle) if K is None else K
    return replace(PUBLISHED_LAW, K=K, D=D, layer=LAYER_WIDTH, dead_zone=True, box=parameter_box(vehicle))


def leaking_design(vehicle: Vehicle, *, K: float | None = None, D: float = PUBLISHED_LAW.D) -> LawGains:
    """Return gains with relay and leak; K, N*m, by default `GAIN_MARGIN` times the entry `gain` of `leak_bound`."""
    # with a smaller leak the bound decays more slowly, with a larger leak not faster
    leaking = replace(PUBLISHED_LAW, D=D, leak=slowest_rate(vehicle, D))
    return replace(leaking, K=GAIN_MARGIN * leak_bound(vehicle, leaking)["gain"] if K is None else K)


def slowest_rate(vehicle: Vehicle, D: float) -> float:
    """Return the slowest decay rate 2 h D0, 1/s, for the smallest h (`least_share`)."""
    return 2.0 * least_share() * vehicle.wheel.radius / vehicle.effective_inertia * D


def least_share() -> float:
    """Return the smallest h, the ratio of acting to commanded torque, over the errors of brake gain and Td."""
    return (1.0 - reaching.TORQUE_FRACTION) * (1.0 - BRAKE_GAIN)


def parameter_box(vehicle: Vehicle) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return ranges of theta1 and theta2, with a margin, for all loads and friction down to `LOWEST_FRICTION`."""
    first, second = (
        (min(0.0, corner) - _BOX_MARGIN * abs(corner), max(0.0, corner) + _BOX_MARGIN * abs(corner))
        for corner in farthest_theta(vehicle).tolist()
    )
    return first, second


def farthest_theta(vehicle: Vehicle) -> Floats:
    """Return theta of the loaded vehicle with friction `LOWEST_FRICTION`, for a law that assumes `vehicle`."""
    far = reaching.with_friction(vehicle, LOWEST_FRICTION).model_copy(update={"mass": vehicle.mass_loaded})
    return reaching.true_theta(far, vehicle)


_DURATION = 60.0  # s; longer than any stop of these designs
_RISE_TOLERANCE = 1e-3  #: accepted rise of V in a run, relative to V(0); steps of 2 ms cause a smaller rise
_BOUND_TOLERANCE = 0.01  #: accepted relative excess over a bound: a sampled relay overshoots by K0 times one step


def robust_conditions(vehicle: Vehicle, *, K: float | None, D: float, seed: int) -> tuple[Condition, ...]:
    """Decide which conditions of the robust variants hold with K, N*m (None: K of each design), and D, N*m/(m/s)."""
    gains, leaking = dead_zone_design(vehicle, K=K, D=D), leaking_design(vehicle, K=K, D=D)
    largest, bound = effective_torque(vehicle), leak_bound(vehicle, leaking)
    seeds, size = tuple(range(seed, seed + RUNS)), gains.layer
    # met: the layer is wide enough for (J/r) d_max = largest, N*m; bound: ultimate bound of |s|, m/s
    layer: dict[str, Any] = {"met": largest <= gains.K + D * size, "bound": largest / (D + gains.K / size)}
    layer |= {"largest": largest, "K": gains.K, "D": D, "layer": size}
    (proved, rate), (first, second) = matrix_gain(), gain_units()
    box, theta = parameter_box(vehicle), reaching.true_theta(vehicle.loaded(), vehicle).tolist()
    contained = all(low <= value <= high for value, (low, high) in zip(theta, box, strict=True))
    units = {"k1_unit": first, "k2_unit": second, "V_rate": rate}
    layered = boundary_layer_proved() and layer["met"]
    adapted = dead_zone_proved() and projection_proved() and layer["met"]
    leak = {"least_share": least_share(), "K": leaking.K, "bound": bound, "leak": leaking.leak}
    return (
        Condition("matrix gain", proved and first != second, "symbolic", units),
        gain(vehicle, gains, largest),
        *(_gain_search(vehicle, gains, seed, limited=limited) for limited in (False, True)),
        rail_mistaken(vehicle, gains),
        _down_to_5_kmh("boundary layer, bound", layered, BY_CORNERS, layer),
        boundary_layer_runs(vehicle, gains, layer, seeds),
        _down_to_5_kmh("dead zone in the adaptation", adapted, BY_CORNERS, layer),
        Condition("projection", projection_proved() and contained, "symbolic", {"box": box, "theta": theta}),
        _dead_zone_runs(vehicle, gains, largest, seeds),
        _down_to_5_kmh("sigma-modification, bound", leak_proved() and bound["gain"] < leaking.K, BY_CORNERS, leak),
        _leak_runs(vehicle, leaking, bound, seeds),
    )


def _down_to_5_kmh(name: str, holds: bool, how: str, numbers: dict[str, Any], **more: Any) -> Condition:
    return Condition(name, holds, how, numbers, down_to_kmh=reaching.LOWEST_SPEED_KMH if holds else None, **more)


def gain(vehicle: Vehicle, gains: LawGains, largest: float) -> Condition:
    """Decide whether (40) holds over `robust_set`; find the largest errors of Ta_hat and v'_hat for this K."""
    box = robust_set(vehicle)
    exact = replace(box, torque_error=(0.0, 0.0), rate_error=(0.0, 0.0))
    tolerated = {
        "Ta_hat": reaching.tolerated_error(vehicle, exact, "torque_error", K=gains.K),
        "v_rate_hat": reaching.tolerated_error(vehicle, exact, "rate_error", K=gains.K),
    }
    numbers = {"K": gains.K, "asked": largest, "asked_exact": reaching.least_gain(vehicle, exact), "box": box}
    return _down_to_5_kmh("robust gain", largest < gains.K, CORNERS, numbers, tolerated=tolerated)


def _gain_search(vehicle: Vehicle, gains: LawGains, seed: int, *, limited: bool) -> Condition:
    box = robust_set(vehicle)
    if limited:
        box = replace(box, torque_limits=(0.0, full_brake_torque(vehicle)))
    own = reaching.search(box, vehicle, gains, seed=seed)
    name = "robust gain, torque limits" if limited else "robust gain, search"
    numbers = {"own": own, "seed": seed, "K": gains.K, "limits": box.torque_limits}
    return _down_to_5_kmh(name, own.excess < 0, checked_at(own.evaluations), numbers)


def rail_mistaken(vehicle: Vehicle, gains: LawGains) -> Condition:
    """Decide whether (40) holds if Ta_hat is computed for the wrong rail: dry for wet, or wet for dry."""
    box = robust_set(vehicle)
    on_wet, on_dry = (reaching.vanishing_slip_torque(vehicle, rail) for rail in (Rail.WET, Rail.DRY))
    wet = on_wet / on_dry
    (low, high), (least, most) = box.torque_error, box.adhesion_torque
    mistaken: dict[str, dict[str, Any]] = {
        "dry taken for wet": {"torque_error": (wet * (1.0 + low) - 1.0, high)},
        "wet taken for dry": {
            "torque_error": (low, (1.0 + high) / wet - 1.0),
            "adhesion_torque": (wet * least, wet * most),
        },
    }
    asked = {name: reaching.least_gain(vehicle, replace(box, **changes)) for name, changes in mistaken.items()}
    numbers = {"K": gains.K, "asked": asked, "wet_share": wet}
    return _down_to_5_kmh("robust gain, rail mistaken", max(asked.values()) < gains.K, CORNERS, numbers)


def boundary_layer_runs(vehicle: Vehicle, gains: LawGains, layer: dict[str, Any], seeds: tuple[int, ...]) -> Condition:
    """Decide by simulated stops with disturbances, boundary layer and known theta whether |s| stays below its bound."""
    still = replace(gains, k1=0.0, k2=0.0, box=None, dead_zone=False)
    run = simulate_ideal(vehicle, still, duration=_DURATION, disturbed=True, seeds=seeds)
    kept, numbers = _in_the_layer(run, gains, layer["bound"], layer["largest"])
    if not layer["met"]:
        kept, numbers["highest"] = False, float(np.nanmax(np.abs(run.s)))
    return _down_to_5_kmh("boundary layer, runs", kept, "simulated", {**layer, **numbers, "seeds": seeds})


def largest_disturbance(run: IdealRun, gains: LawGains) -> float:
    """Return the largest effective disturbance (J/r)|d|, N*m, of a run with the published disturbance torque."""
    switched = np.clip(run.s / gains.layer, -1.0, 1.0) if gains.layer > 0 else np.sign(run.s)
    q = reaching.torque_share(run.time)[:, None]
    return float(np.nanmax(np.abs((run.disturbance + q * (gains.D * run.s + gains.K * switched)) / (1.0 + q))))


def _in_the_layer(run: IdealRun, gains: LawGains, bound: float, largest: float) -> tuple[bool, dict[str, Any]]:
    """Check that |s| falls below `bound` in all runs and stays there, with a disturbance of at most `largest`, N*m."""
    size, disturbed = np.abs(run.s), largest_disturbance(run, gains)
    first, reached, highest = np.argmax(size <= bound, axis=0), math.inf, gains.layer
    if np.all(np.any(size <= bound, axis=0)):
        after = np.arange(len(run.time))[:, None] >= first
        reached, highest = float(run.time[np.max(first)]), float(np.nanmax(np.where(after, size, np.nan)))
    kept = math.isfinite(reached) and highest <= bound * (1 + _BOUND_TOLERANCE) and disturbed <= largest
    return kept, {"reached": reached, "highest": highest, "disturbed": disturbed}


def _unknown_load_run(vehicle: Vehicle, gains: LawGains, seeds: tuple[int, ...]) -> IdealRun:
    return simulate_ideal(vehicle.loaded(), gains, nominal=vehicle, duration=_DURATION, disturbed=True, seeds=seeds)


def _dead_zone_runs(vehicle: Vehicle, gains: LawGains, largest: float, seeds: tuple[int, ...]) -> Condition:
    run = _unknown_load_run(vehicle, gains, seeds)
    V = run.V - 0.5 * run.s**2 + 0.5 * np.maximum(np.abs(run.s) - gains.layer, 0.0) ** 2
    rise = float(np.nanmax(V - np.fmin.accumulate(V, axis=0))) / float(V[0, 0])
    assert gains.box is not None, "`dead_zone_design` sets it"
    low, high = np.array(gains.box).T
    hats = run.theta_hat[np.isfinite(run.theta_hat[..., 0])]
    boxed = bool(np.all((hats >= low) & (hats <= high)))
    kept, along = _in_the_layer(run, gains, gains.layer, largest)
    numbers = {
        **{"rise": rise, "layer": gains.layer, "boxed": boxed, "seeds": seeds, **along},
        **{"largest": largest, "mass": vehicle.mass, "mass_loaded": vehicle.mass_loaded},
    }
    holds = rise <= _RISE_TOLERANCE and boxed and kept
    return _down_to_5_kmh("layer, dead zone, projection: runs", holds, "simulated", numbers)


def leak_bound(vehicle: Vehicle, gains: LawGains) -> dict[str, float]:
    """Return the numbers of the bound with leak, V(t) <= V(0) exp(-rate t) + level (1 - exp(-rate t)), by name.

    - rate: decay rate, 1/s.
    - level: ultimate bound of V, m^2/s^2.
    - start: V(0), m^2/s^2, if the wheel rolls freely at 100 km/h and theta_hat = 0.
    - surface: |s| for V = level, m/s.
    - gain: least K of (40), N*m, over the set V <= max(V(0), level); with a larger K this set is invariant.
    """
    theta = farthest_theta(vehicle)
    k = (gains.k1, gains.k2)
    of_theta = sum(float(one) ** 2 / (2.0 * gain) for one, gain in zip(theta, k, strict=True))
    c = min(slowest_rate(vehicle, gains.D), gains.leak)
    level = gains.leak * of_theta / c
    start = 0.5 * (reaching.reference_slip() * INITIAL_SPEED_KMH * KMH) ** 2 + of_theta
    # |theta_tilde_i| <= sqrt(2 k_i V), and theta is between 0 (empty vehicle) and that of the loaded vehicle
    reach = [math.sqrt(2.0 * gain * max(start, level)) for gain in k]
    first, second = ((min(0.0, float(x)) - w, max(0.0, float(x)) + w) for x, w in zip(theta, reach, strict=True))
    asked = reaching.least_gain(vehicle, replace(robust_set(vehicle), theta_hat1=first, theta_hat2=second))
    return {"rate": c, "level": level, "surface": math.sqrt(2.0 * level), "start": start, "gain": asked}


def _leak_runs(vehicle: Vehicle, gains: LawGains, bound: dict[str, float], seeds: tuple[int, ...]) -> Condition:
    run = _unknown_load_run(vehicle, gains, seeds)
    decay = np.exp(-bound["rate"] * run.time)[:, None]
    share = float(np.nanmax(run.V / (run.V[0] * decay + bound["level"] * (1.0 - decay))))
    met = bound["gain"] < gains.K
    end = int(np.min(np.sum(np.isfinite(run.s), axis=0)))
    final = float(np.max(np.abs(run.s[max(0, end - round(1.0 / run.time[1])) : end])))  # the shortest run's last second
    numbers = {
        **{"share": share, "final": final, "met": met, "bound": bound, "K": gains.K, "seeds": seeds},
        **{"mass": vehicle.mass, "mass_loaded": vehicle.mass_loaded},
    }
    holds = met and share <= 1.0 + _BOUND_TOLERANCE and largest_disturbance(run, gains) <= bound["gain"]
    return _down_to_5_kmh("sigma-modification, runs", holds, "simulated", numbers)
