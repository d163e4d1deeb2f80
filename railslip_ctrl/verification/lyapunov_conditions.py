"""The paper's Lyapunov argument, condition by condition, decided with SymPy on the derived expressions."""

from __future__ import annotations

import sympy as sp

from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import Vehicle
from railslip_ctrl.sliding.derivation import Derivation, derive
from railslip_ctrl.sliding.gains import LawGains
from railslip_ctrl.sliding.identities import identical
from railslip_ctrl.sliding.symbols import sliding_symbol

from .closed_loop_samples import identity_errors
from .reaching_bound import least_gain, reference_set, surface_needed
from .robust import RATE, TILDE, gain_units
from .verdict import Condition

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
