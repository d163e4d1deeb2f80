"""The adaptive sliding-mode law, derived step by step from the equations of the plant ([Park2008] (33)-(49)).

Symbols are those of `core.notation` and `sliding.proof`: real SymPy symbols, with `sympy.sign` for sgn. Tb > 0 brakes,
theta_tilde = theta - theta_hat. The plant is `plant.WHEEL`, `plant.TRAIN`, `plant.SLIP_VELOCITY`. The surface (33), the
reaching law and the Lyapunov function V are chosen. Everything else is derived, and SymPy checks each step.
The record `Derivation` extends `Adaptation`, which extends `Reaching`.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Literal

import sympy as sp

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import law_class

from .proof import Checked, DerivationStep, identical, linear_solution, sliding_symbol, step, vanishes

Reference = Literal["proportional", "constant"]  #: sigma_d = lambda_d v, or sigma_d constant

s, e, e_integral, rho = (sliding_symbol(name) for name in ("s", "e", "e_integral", "rho"))
lambda_d, sigma_d = sliding_symbol("lambda_d"), sliding_symbol("sigma_d")
_SIGMA_RATE = sliding_symbol("sigma_rate")


UNCERTAIN = {plant.Tr: 0, plant.Fr: 0, plant.Td: 0}
"""Substitution for the source's "uncertainties are neglected" (p. 53): disturbances set to zero."""


def derive_surface(reference: Reference) -> dict[str, Any]:
    """Derive the sliding variable s and its rate s' for a reference; return some fields of `Reaching`."""
    plant_step, train, wheel = accelerations()
    motion, slip_velocity = plant.motion(), plant.SLIP_VELOCITY.rhs
    # v' stays a symbol, so that a measured v' can replace it
    sigma_rate = sp.expand(sp.diff(slip_velocity, plant.v) * train + sp.diff(slip_velocity, plant.omega) * wheel)
    moves = identical(_in_plant_variables(sigma_rate), motion.sigma_rate)
    slip_step = step("slip acceleration", (_SIGMA_RATE, sigma_rate), moves)
    error, error_rate, definition, surface_step, rate_form = _differentiated(reference)
    rate = sp.expand(rate_form.subs(_SIGMA_RATE, sigma_rate))
    slope = sp.diff(error, plant.v) * motion.v_rate + sp.diff(error, plant.sigma) * motion.sigma_rate
    own = identical(_in_plant_variables(rate.subs({plant.v_rate: train, e: error})), slope + rho * error)
    rate_step = step("rate of s", (sliding_symbol("s_rate"), grouped_rate(rate)), own)
    return {
        "steps": (plant_step, slip_step, surface_step, rate_step),
        "s": definition,
        "error": error,
        "reference_rate": sp.expand(error_rate + _SIGMA_RATE),
        "s_rate": grouped_rate(rate),
        "disturbance": grouped_rate(sp.expand(rate - rate.subs(UNCERTAIN))),
    }


def accelerations() -> tuple[DerivationStep, sp.Expr, sp.Expr]:
    """Solve the equations of train and wheel for v' and omega'; return (derivation step, v', omega')."""
    force = linear_solution(plant.ADHESION_TORQUE, plant.Fa)
    train = sp.expand(linear_solution(plant.TRAIN.subs(plant.Fa, force), plant.v_rate))
    wheel = sp.expand(linear_solution(plant.WHEEL, plant.omega_rate))
    v, omega, r, M, J = plant.v, plant.omega, plant.r, plant.M, plant.J
    # only slip, resistance, brake and bearing dissipate energy: this check fails for a wrong sign in (3) or (4)
    power = M * v * train + J * omega * wheel
    slip_velocity = v - r * omega
    losses = (plant.Ta + plant.Tr) / r * slip_velocity + plant.Fr * v + (plant.Tb + plant.Td + plant.B * omega) * omega
    residual = sp.Matrix([plant.WHEEL.lhs - plant.WHEEL.rhs, plant.TRAIN.lhs - plant.TRAIN.rhs])
    solved = {plant.omega_rate: wheel, plant.v_rate: train, plant.Fa: force}
    made = step(
        "accelerations",
        (sp.Matrix([plant.v_rate, plant.omega_rate]), sp.Matrix([train, wheel])),
        *(identical(row.subs(solved), sp.Integer(0)) for row in residual),
        identical(power, -losses),
    )
    return made, train, wheel


def _differentiated(reference: Reference) -> tuple[sp.Expr, sp.Expr, sp.Expr, DerivationStep, sp.Expr]:
    t, x = sp.symbols("t x", real=True)
    v_t, sigma_t = sp.Function("v")(t), sp.Function("sigma")(t)
    at_reference = linear_solution(plant.SLIP_RATIO.subs(plant.slip, lambda_d), plant.sigma).subs(plant.v, v_t)
    reference_t = at_reference if reference == "proportional" else sigma_d
    error_t = reference_t - sigma_t
    surface_t = error_t + rho * sp.Integral(error_t.subs(t, x), (x, 0, t))
    names = {v_t.diff(t): plant.v_rate, sigma_t.diff(t): _SIGMA_RATE}
    error_rate = error_t.diff(t).subs(names)
    surface_rate = sp.expand(surface_t.diff(t).subs(names))
    # the derivative of the integral is the error itself
    integral_rate = surface_rate.coeff(rho)
    rate_form = surface_rate - sp.expand(rho * integral_rate) + rho * e
    error = error_t.subs({v_t: plant.v, sigma_t: plant.sigma})
    made = step(
        "sliding variable",
        (s, e + rho * e_integral),
        identical(integral_rate.subs({v_t: plant.v, sigma_t: plant.sigma}), error),
        error=error,
        reference=reference,
        error_rate=error_rate,
    )
    return error, error_rate, e + rho * e_integral, made, rate_form


def _in_plant_variables(expression: sp.Expr) -> sp.Expr:
    wheel_speed = linear_solution(plant.SLIP_VELOCITY, plant.omega)
    stated = {plant.Ta: plant.ADHESION_TORQUE.rhs, plant.Fr: plant.RESISTANCE.rhs}
    return expression.subs({**stated, plant.omega: wheel_speed})


def grouped_rate(rate: sp.Expr) -> sp.Expr:
    """Collect the terms of s' by torques and omega, as [Park2008] does."""
    return sp.collect(rate, (plant.Ta, plant.Tr, plant.omega, plant.Tb, plant.Td))


Ueq, Ur, D, K, D0, K0 = (sliding_symbol(name) for name in ("Ueq", "Ur", "D", "K", "D0", "K0"))
_S_RATE, _ZERO = sliding_symbol("s_rate"), sp.Integer(0)


@dataclass(frozen=True)
class Reaching(Checked):
    """Sliding variable, its rate, and the law for known parameters. `Derivation` describes the fields."""

    s: sp.Expr
    error: sp.Expr
    reference_rate: sp.Expr
    s_rate: sp.Expr
    disturbance: sp.Expr
    equivalent_control: sp.Expr
    reaching: sp.Expr
    robust_term: sp.Expr
    control_law: sp.Expr
    closed_rate: sp.Expr
    reaching_product: sp.Expr


def derive_reaching(reference: Reference) -> Reaching:
    """Derive the law for known plant parameters: equivalent control (36) plus robust term (41)."""
    surface = derive_surface(reference)
    rate, known, d = surface["s_rate"], surface["s_rate"].subs(UNCERTAIN), surface["disturbance"]
    equivalent = linear_solution(known, plant.Tb)
    reaching = grouped_rate(sp.expand(rate.subs(plant.Tb, equivalent + Ur)))
    # Ur for which s' without disturbances is -D0 s - K0 sgn s, in D = (J/r) D0 and K = (J/r) K0
    sign = sp.Dummy("sgn", real=True)  # stands for sgn s, which `solve` would split into cases
    in_rates = linear_solution(reaching.subs(UNCERTAIN) + D0 * s + K0 * sign, Ur)
    robust = sp.expand(in_rates.subs({D0: plant.r / plant.J * D, K0: plant.r / plant.J * K})).subs(sign, sp.sign(s))
    law = grouped(equivalent) + robust
    closed = sp.expand(rate.subs(plant.Tb, equivalent + robust))
    product = sp.expand(s * closed)
    slowed, size = plant.r / plant.J * (D * s + K * sp.sign(s)), sp.Dummy("|d|", positive=True)
    bound = sp.Abs(s) * (size - plant.r / plant.J * (D * sp.Abs(s) + K))
    slack = sp.Abs(s) * size - s * d  # not negative, since x <= |x|
    steps = (
        *surface["steps"],
        step("equivalent control", (Ueq, grouped(equivalent)), identical(known.subs(plant.Tb, equivalent), _ZERO)),
        step(
            "reaching dynamics",
            (_S_RATE, reaching),
            reaching.free_symbols <= d.free_symbols | {Ur},
            identical(reaching, d + sp.diff(rate, plant.Tb) * Ur),
        ),
        step(
            "robust control",
            (Ur, robust),
            identical(reaching.subs(UNCERTAIN).subs(Ur, robust), -slowed),
            identical(robust, D * s + K * sp.sign(s)),
        ),
        step(
            "control law",
            (plant.Tb, law),
            identical(closed, d - slowed),
            identical(rate.subs(plant.Tb, law), d - slowed),
        ),
        step("reaching condition", (sliding_symbol("s_times_s_rate"), product), identical(bound - product, slack)),
    )
    return Reaching(
        **surface | {"steps": steps},
        equivalent_control=grouped(equivalent),
        reaching=reaching,
        robust_term=robust,
        control_law=law,
        closed_rate=closed,
        reaching_product=product,
    )


def grouped(control: sp.Expr) -> sp.Expr:
    """Write a torque as [Park2008] does: J/r times a bracket with terms in Ta and omega."""
    factor = plant.J / plant.r
    inside = sp.collect(sp.expand(control / factor), (plant.Ta, plant.omega))
    return sp.Mul(factor, inside, evaluate=False)


Mn, Mp, Bn, Bp = (sliding_symbol(name) for name in ("Mn", "Mp", "Bn", "Bp"))
k, k1, k2 = (sliding_symbol(name) for name in ("k", "k1", "k2"))
THETA = tuple(sliding_symbol(f"theta{i}") for i in (1, 2))
THETA_HAT = tuple(sliding_symbol(f"theta{i}_hat") for i in (1, 2))
THETA_TILDE = tuple(sliding_symbol(f"theta{i}_tilde") for i in (1, 2))
THETA_HAT_RATE = tuple(sliding_symbol(f"theta{i}_hat_rate") for i in (1, 2))
PHI = (plant.Ta, plant.omega)

TRUE = {plant.M: Mn + Mp, plant.B: Bn + Bp}  #: substitution of the true parameters: nominal value and perturbation
NOMINAL = {plant.M: Mn, plant.B: Bn}  #: substitution of the nominal parameters
_V_RATE = sliding_symbol("V_rate")


@dataclass(frozen=True)
class Lyapunov:
    """Lyapunov function, its rate, and the adaptive law that follows from them. `Derivation` describes the fields."""

    V: sp.Expr
    V_rate: sp.Expr
    cross_term: sp.Expr
    adaptation: tuple[sp.Expr, ...]
    V_rate_final: sp.Expr
    V_rate_disturbed: sp.Expr


@dataclass(frozen=True)
class Adaptation(Reaching, Lyapunov):
    """Extends `Reaching` by the adaptive law and the Lyapunov function, for one gain k and for two gains k1, k2."""

    theta: tuple[sp.Expr, ...]
    adaptive_law_control: sp.Expr
    error_dynamics: sp.Expr
    disturbance_perturbed: sp.Expr
    V_matrix: sp.Expr
    adaptation_matrix: tuple[sp.Expr, ...]


@cache
def derive_adaptation(reference: Reference) -> Adaptation:
    """Derive theta, the law with theta_hat, the error dynamics and the adaptive laws, with Ta as a symbol."""
    reaching = derive_reaching(reference)
    known = reaching.s_rate.subs(UNCERTAIN)
    uncertainty = sp.expand(known.subs(TRUE) - known.subs(NOMINAL))
    theta = tuple(sp.factor(sp.diff(uncertainty, variable)) for variable in PHI)
    disturbance = reaching.disturbance.subs(TRUE)
    equivalent = linear_solution(_with_theta(known, THETA_HAT), plant.Tb)
    law = grouped(equivalent) + reaching.robust_term
    true = tuple(hat + tilde for hat, tilde in zip(THETA_HAT, THETA_TILDE, strict=True))
    error_dynamics = sp.expand(_with_theta(known, true).subs(plant.Tb, law)) + disturbance
    scalar, matrix = (_lyapunov(error_dynamics, disturbance, gains) for gains in ((k, k), (k1, k2)))
    # independent check: s' of the true plant under the law, with theta_tilde = theta - theta_hat by definition
    plant_rate = reaching.s_rate.subs(TRUE).subs(plant.Tb, law)
    errors = {tilde: a - hat for tilde, a, hat in zip(THETA_TILDE, theta, THETA_HAT, strict=True)}
    taken = sum(tilde * variable for tilde, variable in zip(THETA_TILDE, PHI, strict=True))
    falls = plant.r / plant.J * (D * s**2 + K * sp.Abs(s))
    steps = (
        *reaching.steps,
        step(
            "perturbed parameters",
            (sp.Matrix(THETA), sp.Matrix(theta)),
            identical(uncertainty - sum(a * b for a, b in zip(theta, PHI, strict=True)), _ZERO),
            not any(sp.diff(part, variable) != 0 for part in theta for variable in PHI),
            identical(theta[0], (1 / (Mn + Mp) - 1 / Mn) / plant.r),
        ),
        step("adaptive control law", (plant.Tb, law), identical(plant_rate, error_dynamics.subs(errors))),
        step(
            "error dynamics",
            (_S_RATE, sp.collect(error_dynamics, plant.Tr)),
            identical(error_dynamics, taken + disturbance - plant.r / plant.J * (D * s + K * sp.sign(s))),
        ),
        *_function_steps(scalar),
        _adaptation_step("adaptive law", scalar),
        _adaptation_step("adaptive law, matrix gain", matrix),
        step(
            "rate of V, ideal",
            (_V_RATE, scalar.V_rate_final),
            *(identical(one.V_rate_final, -falls) for one in (scalar, matrix)),
        ),
        step(
            "rate of V, disturbed",
            (_V_RATE, scalar.V_rate_disturbed),
            *(identical(one.V_rate_disturbed, s * disturbance - falls) for one in (scalar, matrix)),
        ),
    )
    return Adaptation(
        **vars(reaching) | {"steps": steps},
        **vars(scalar),
        theta=theta,
        adaptive_law_control=law,
        error_dynamics=error_dynamics,
        disturbance_perturbed=disturbance,
        V_matrix=matrix.V,
        adaptation_matrix=matrix.adaptation,
    )


def _with_theta(known: sp.Expr, theta: tuple[sp.Expr, ...]) -> sp.Expr:
    return known.subs(NOMINAL) + sum(a * b for a, b in zip(theta, PHI, strict=True))


def _lyapunov(error_dynamics: sp.Expr, disturbance: sp.Expr, gains: tuple[sp.Symbol, ...]) -> Lyapunov:
    V = s**2 / 2 + sum(tilde**2 / (2 * gain) for tilde, gain in zip(THETA_TILDE, gains, strict=True))
    ideal = error_dynamics - disturbance
    # theta is constant: theta_tilde' = -theta_hat'
    adaptation_part = sum(sp.diff(V, tilde) * -rate for tilde, rate in zip(THETA_TILDE, THETA_HAT_RATE, strict=True))
    rate = sp.expand(sp.diff(V, s) * ideal + adaptation_part)
    cross = sp.expand(rate - rate.subs(dict.fromkeys(THETA_TILDE, 0)))
    # the cross term is linear in theta_tilde: it vanishes for every theta_tilde if each coefficient does
    solution = sp.solve([sp.diff(cross, tilde) for tilde in THETA_TILDE], THETA_HAT_RATE, dict=True)[0]
    adaptation = tuple(solution[symbol] for symbol in THETA_HAT_RATE)
    final = sp.factor(sp.expand(rate.subs(solution)).subs(s * sp.sign(s), sp.Abs(s)))
    return Lyapunov(V, rate, cross, adaptation, final, final + sp.diff(V, s) * disturbance)


def _function_steps(scalar: Lyapunov) -> tuple[DerivationStep, DerivationStep]:
    hessian = sp.hessian(scalar.V, (s, *THETA_TILDE))
    second = [sp.diff(scalar.cross_term, a, b) for a in THETA_TILDE for b in THETA_TILDE]
    rest = scalar.V_rate - scalar.cross_term
    positive = all(minor.is_positive for minor in (hessian[:n, :n].det() for n in (1, 2, 3)))
    return step("Lyapunov function", (sliding_symbol("V"), scalar.V), positive), step(
        "rate of V",
        (_V_RATE, scalar.V_rate),
        all(entry == 0 for entry in second),
        not rest.has(*THETA_TILDE),
        vanishes(scalar.cross_term.subs(dict.fromkeys(THETA_TILDE, 0))),
    )


def _adaptation_step(name: str, function: Lyapunov) -> DerivationStep:
    solved = dict(zip(THETA_HAT_RATE, function.adaptation, strict=True))
    return step(
        name,
        (sp.Matrix(THETA_HAT_RATE), sp.Matrix(function.adaptation)),
        identical(function.cross_term.subs(solved), sp.Integer(0)),
    )


@cache
def _statement_steps() -> tuple[DerivationStep, ...]:
    ratio = plant.SLIP_RATIO.rhs.subs(plant.sigma, plant.SLIP_VELOCITY.rhs)
    rolls, locks = (ratio.subs(plant.omega, omega) for omega in (plant.v / plant.r, 0))
    grows = bool(sp.diff(ratio, plant.omega).is_negative)
    power, coefficients = sp.expand(plant.v * plant.RESISTANCE.rhs), (plant.Fr0, plant.Fr1, plant.Fr2)
    parts = [sp.diff(power, coefficient) for coefficient in coefficients]
    whole = sum(part * coefficient for part, coefficient in zip(parts, coefficients, strict=True))
    brakes = all(part.is_positive for part in parts) and identical(power, whole)
    s_laplace, tau, Tc = (symbol(name) for name in ("s", "tau", "Tc"))
    transfer, rate = plant.actuator_transfer(), plant.actuator_lag_rate()
    # the dead time multiplies the command by exp(-tau s)
    from_rate = sp.solve(sp.Eq(s_laplace * plant.Tb, rate), plant.Tb)[0].subs(Tc, sp.exp(-tau * s_laplace))
    poles = sp.solve(sp.denom(sp.together(from_rate)), s_laplace)
    return (
        step("slip ratio", (plant.slip, ratio), rolls == 0, locks == 1, grows),
        step("travelling resistance", (plant.Fr, plant.RESISTANCE.rhs), brakes),
        step(
            "actuator",
            (sp.Matrix([sliding_symbol("Ga"), sliding_symbol("Tb_rate")]), sp.Matrix([transfer, rate])),
            vanishes(transfer - from_rate),
            transfer.subs(s_laplace, 0) == 1,
            len(poles) == 1 and bool(poles[0].is_negative),
        ),
    )


@dataclass(frozen=True)
class Derivation(Adaptation):
    """Adaptive sliding-mode law and the steps of its derivation, as formulas in Ta, omega, v_rate (measured v') and e.

    Torques are in N*m, s' is in m/s^2. Numbers in parentheses are equations of [Park2008].

    - reference: "proportional" or "constant", as in `derive`.
    - adhesion: name of the adhesion law, None if Ta is an argument.
    - steps: steps of the derivation, from first to last.
    - s: surface as a function of e and e_integral, (33).
    - error, reference_rate: e as a function of v, sigma and the reference; sigma_d'.
    - s_rate: s' in (Ta, Tr, Fr, Tb, Td, omega, v_rate, e) with M, J, B, r, (35).
    - disturbance: contribution d of Tr, Fr and Td to s', as a function of the mass M.
    - disturbance_perturbed: d with the mass replaced by M = Mn + Mp (nominal mass plus perturbation).
    - equivalent_control, robust_term, control_law: Ueq (36), Ur (41), Tb (43).
    - reaching: s' under Ueq + Ur, with Ur as a symbol, (37).
    - closed_rate, reaching_product: s' and s s' under `control_law` with the disturbances, (42).
    - theta: true values of the unknown coefficients, as functions of r, J, Mn, Mp, Bp; (44) with its error corrected.
    - phi: the regressor (Ta, omega).
    - adaptive_law_control: Tb with Mn, Bn and theta_hat, (45).
    - error_dynamics: s' under `adaptive_law_control` and disturbances, as a function of theta_tilde.
    - V: s^2/2 + theta_tilde1^2/(2 k) + theta_tilde2^2/(2 k), (46).
    - V_rate: V' under `adaptive_law_control` without disturbances, for any theta_hat' and theta_tilde, (47).
    - cross_term: terms of V_rate that contain theta_tilde, (48).
    - adaptation: theta_hat' for which the cross term vanishes for every theta_tilde, (49).
    - V_rate_final: V' with this adaptation, -(r/J)(D s^2 + K |s|); V_rate_disturbed: V' with disturbances too.
    - V_matrix, adaptation_matrix: V and adaptation with two gains, k1 and k2, of consistent units.
    - estimation_disturbance: change of s' if estimates Ta_hat and v_rate_hat replace Ta and v_rate.
    - adhesion_torque: Ta as a function of v, sigma, z, N and the adhesion law's parameters; None without a law.
    - adhesion_state_rate: z', m/s, of a dynamic adhesion law; None otherwise.
    - law_in_adhesion: `adaptive_law_control` with Ta replaced by `adhesion_torque`.
    """

    reference: str
    adhesion: str | None
    estimation_disturbance: sp.Expr
    adhesion_torque: sp.Expr | None
    adhesion_state_rate: sp.Expr | None
    law_in_adhesion: sp.Expr
    phi: tuple[sp.Expr, ...] = PHI


@checked
@cache
def derive(*, reference: Reference = "proportional", law: str | None = None) -> Derivation:
    """Derive the sliding-mode law, [Park2008] (33)-(49). The first call takes a few seconds; the result is cached.

    - reference: "proportional" (reference slip velocity lambda_d v) or "constant".
    - law: name of the adhesion law that gives Ta; by default Ta is an argument of the law.

    Returns equations and steps as SymPy expressions, SI; no arrays. InputError: an unknown reference or law.
    """
    adaptive = derive_adaptation(reference)
    estimates_step, estimation = _estimates(adaptive)
    adhesion_steps, torque, state_rate, closed = _with_adhesion(law, adaptive)
    return Derivation(
        **vars(adaptive) | {"steps": (*adaptive.steps, estimates_step, *_statement_steps(), *adhesion_steps)},
        reference=reference,
        adhesion=None if law is None else law_class(law).name,
        estimation_disturbance=estimation,
        adhesion_torque=torque,
        adhesion_state_rate=state_rate,
        law_in_adhesion=closed,
    )


def _estimates(adaptive: Adaptation) -> tuple[DerivationStep, sp.Expr]:
    estimates = {plant.Ta: sliding_symbol("Ta_hat"), plant.v_rate: sliding_symbol("v_rate_hat")}
    law = adaptive.adaptive_law_control
    with_estimates = adaptive.s_rate.subs(plant.Tb, law.subs(estimates))
    difference = sp.expand(with_estimates - adaptive.s_rate.subs(plant.Tb, law))
    back = {symbol: true for true, symbol in estimates.items()}
    shown = sum(
        sp.collect(sp.expand(sp.diff(difference, true)), true) * (true - estimate)
        for true, estimate in estimates.items()
    )
    made = step(
        "estimates in the law",
        (sliding_symbol("s_rate_change"), shown),
        vanishes(difference.subs(back)),
        vanishes(difference - shown),
    )
    return made, sp.sympify(shown)


def _with_adhesion(
    law: str | None, adaptive: Adaptation
) -> tuple[tuple[DerivationStep, ...], sp.Expr | None, sp.Expr | None, sp.Expr]:
    control = adaptive.adaptive_law_control
    if law is None:
        return (), None, None, control
    chosen = law_class(law)
    closed = plant.close(chosen)
    torque = plant.ADHESION_TORQUE.rhs.subs(plant.Fa, closed.force)
    closed_control = control.subs(plant.Ta, torque)
    # s' from the rates of `plant.close`, with theta_hat = 0, Mp = Bp = 0, is d - (r/J)(D s + K sgn s)
    nominal = {**dict.fromkeys(THETA_HAT, 0), Mn: plant.M, Bn: plant.B}
    wheel_speed = linear_solution(plant.SLIP_VELOCITY, plant.omega)
    measured = {plant.omega: wheel_speed, plant.v_rate: closed.rates[0], e: adaptive.error}
    sigma_rate = closed.rates[1].subs(plant.Tb, closed_control.subs(nominal).subs(measured))
    rate = sp.diff(adaptive.error, plant.v) * closed.rates[0] + sp.diff(adaptive.error, plant.sigma) * sigma_rate
    expected = adaptive.disturbance.subs(plant.Fr, plant.RESISTANCE.rhs) - plant.r / plant.J * (D * s + K * sp.sign(s))
    made = step(
        "adhesion law",
        (plant.Ta, torque),
        vanishes(rate + rho * adaptive.error - expected),
        title=chosen.title,
        source=chosen.source,
    )
    return (made,), torque, closed.rates[2] if chosen.has_state else None, closed_control
