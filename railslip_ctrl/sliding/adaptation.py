"""Perturbed parameters and the adaptive law that removes them from V': [Park2008] (44)-(49), corrected."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from railslip_ctrl.core.sources import cite
from railslip_ctrl.model import plant

from .identities import identical, linear_solution, vanishes
from .reaching import D, K, Reaching, grouped
from .steps import Step, step
from .surface import UNCERTAIN, Surface, s
from .symbols import sliding_symbol

Mn, Mp, Bn, Bp = (sliding_symbol(name) for name in ("Mn", "Mp", "Bn", "Bp"))
k, k1, k2 = (sliding_symbol(name) for name in ("k", "k1", "k2"))
THETA = tuple(sliding_symbol(f"theta{i}") for i in (1, 2))
THETA_HAT = tuple(sliding_symbol(f"theta{i}_hat") for i in (1, 2))
THETA_TILDE = tuple(sliding_symbol(f"theta{i}_tilde") for i in (1, 2))
THETA_HAT_RATE = tuple(sliding_symbol(f"theta{i}_hat_rate") for i in (1, 2))
PHI = (plant.Ta, plant.omega)

TRUE = {plant.M: Mn + Mp, plant.B: Bn + Bp}
"""The true parameters in nominal and perturbation."""

NOMINAL = {plant.M: Mn, plant.B: Bn}


@dataclass(frozen=True)
class Lyapunov:
    """A Lyapunov function and the adaptive law that follows from it, for adaptation gains (k, k) or (k1, k2).

    Attributes
    ----------
    V : Expr
        s^2/2 + theta_tilde1^2/(2 k1) + theta_tilde2^2/(2 k2).
    V_rate : Expr
        V' under the adaptive control law, theta_hat' and theta_tilde still free, disturbances dropped, (47)-(48).
    cross_term : Expr
        What of V' has theta_tilde in it.
    adaptation : tuple of Expr
        theta_hat' for which the cross term vanishes whatever theta_tilde is, (49).
    V_rate_final : Expr
        V' with it: -(r/J)(D s^2 + K |s|).
    V_rate_disturbed : Expr
        The same with the disturbances kept.
    """

    V: sp.Expr
    V_rate: sp.Expr
    cross_term: sp.Expr
    adaptation: tuple[sp.Expr, ...]
    V_rate_final: sp.Expr
    V_rate_disturbed: sp.Expr


@dataclass(frozen=True)
class Adaptation:
    """The adaptive law; attributes as in `derivation.Derivation`."""

    theta: tuple[sp.Expr, ...]
    adaptive_law_control: sp.Expr
    error_dynamics: sp.Expr
    disturbance: sp.Expr
    scalar: Lyapunov
    matrix: Lyapunov
    steps: tuple[Step, ...]


def derive_adaptation(surface: Surface, reaching: Reaching) -> Adaptation:
    """theta, the law with theta_hat, the error dynamics and the adaptive laws."""
    known = surface.rate.subs(UNCERTAIN)
    uncertainty = sp.expand(known.subs(TRUE) - known.subs(NOMINAL))
    theta = tuple(sp.factor(sp.diff(uncertainty, variable)) for variable in PHI)
    disturbance = surface.disturbance.subs(TRUE)
    law = _law(known, reaching.robust_term)
    error_dynamics = _error_dynamics(known, law, disturbance)
    scalar = _lyapunov(error_dynamics, disturbance, (k, k))
    matrix = _lyapunov(error_dynamics, disturbance, (k1, k2))
    steps = (
        _theta_step(uncertainty, theta),
        _control_step(surface, law, theta, error_dynamics),
        _error_step(error_dynamics, disturbance),
        _function_step(scalar),
        _rate_step(scalar, error_dynamics),
        _adaptation_step(scalar, "adaptive law", "(49)", "theta constant, so theta_tilde' = -theta_hat'."),
        _adaptation_step(matrix, "adaptive law, matrix gain", "(49), corrected", _MATRIX),
        _final_step(scalar, matrix),
        _disturbed_step(scalar, matrix, disturbance),
    )
    return Adaptation(theta, law, error_dynamics, disturbance, scalar, matrix, steps)


_MATRIX = "The two components have different units, so each has a gain of its own: k1 in s^2/(kg^2 m^4), k2 a number."


def _with_theta(known: sp.Expr, theta: tuple[sp.Expr, ...]) -> sp.Expr:
    """s' without disturbances: the nominal one plus theta' phi."""
    return known.subs(NOMINAL) + sum(a * b for a, b in zip(theta, PHI, strict=True))


def _law(known: sp.Expr, robust: sp.Expr) -> sp.Expr:
    equivalent = linear_solution(_with_theta(known, THETA_HAT), plant.Tb)
    return grouped(equivalent) + robust


def _error_dynamics(known: sp.Expr, law: sp.Expr, disturbance: sp.Expr) -> sp.Expr:
    true = tuple(hat + tilde for hat, tilde in zip(THETA_HAT, THETA_TILDE, strict=True))
    return sp.expand(_with_theta(known, true).subs(plant.Tb, law)) + disturbance


def _lyapunov(error_dynamics: sp.Expr, disturbance: sp.Expr, gains: tuple[sp.Symbol, ...]) -> Lyapunov:
    V = s**2 / 2 + sum(tilde**2 / (2 * gain) for tilde, gain in zip(THETA_TILDE, gains, strict=True))
    ideal = error_dynamics - disturbance
    # theta is constant: theta_tilde' = -theta_hat'
    adaptation_part = sum(sp.diff(V, tilde) * -rate for tilde, rate in zip(THETA_TILDE, THETA_HAT_RATE, strict=True))
    rate = sp.expand(sp.diff(V, s) * ideal + adaptation_part)
    cross = sp.expand(rate - rate.subs(dict.fromkeys(THETA_TILDE, 0)))
    # it is linear in theta_tilde: it vanishes for every theta_tilde where each coefficient does
    solution = sp.solve([sp.diff(cross, tilde) for tilde in THETA_TILDE], THETA_HAT_RATE, dict=True)[0]
    adaptation = tuple(solution[symbol] for symbol in THETA_HAT_RATE)
    final = sp.factor(sp.expand(rate.subs(solution)).subs(s * sp.sign(s), sp.Abs(s)))
    return Lyapunov(V, rate, cross, adaptation, final, final + sp.diff(V, s) * disturbance)


def _theta_step(uncertainty: sp.Expr, theta: tuple[sp.Expr, ...]) -> Step:
    remainder = uncertainty - sum(a * b for a, b in zip(theta, PHI, strict=True))
    by_mass = (1 / (Mn + Mp) - 1 / Mn) / plant.r
    return step(
        "perturbed parameters",
        (sp.Matrix(THETA), sp.Matrix(theta)),
        statement="With M = Mn + Mp and B = Bn + Bp, s' is the nominal one plus theta' phi, phi = (Ta, omega).",
        done="s' with the true parameters less s' with the nominal ones; theta are its coefficients.",
        source=cite("Park2008", "(44), corrected: printed theta1 = 1/(r Mp)"),
        holds=(
            identical(remainder, sp.Integer(0)),
            not any(sp.diff(part, variable) != 0 for part in theta for variable in PHI),
            identical(theta[0], by_mass),
        ),
        check="nothing is left over, theta is free of phi, theta1 = (1/r)(1/M - 1/Mn); proved and at random points",
    )


def _control_step(surface: Surface, law: sp.Expr, theta: tuple[sp.Expr, ...], error_dynamics: sp.Expr) -> Step:
    # independent of the way taken: the true plant's s' under the law, theta_tilde = theta - theta_hat by definition
    true = surface.rate.subs(TRUE).subs(plant.Tb, law)
    errors = {tilde: a - hat for tilde, a, hat in zip(THETA_TILDE, theta, THETA_HAT, strict=True)}
    return step(
        "adaptive control law",
        (plant.Tb, law),
        statement="The law with nominal parameters and the estimate theta_hat.",
        done="s' = 0 solved for Tb with theta_hat for theta and the disturbances dropped; robust control added.",
        source=cite("Park2008", "(45)"),
        holds=(identical(true, error_dynamics.subs(errors)),),
        check="s' of the plant with the true parameters under the law equals the error dynamics, "
        "proved and at random points",
    )


def _error_step(error_dynamics: sp.Expr, disturbance: sp.Expr) -> Step:
    expected = (
        sum(tilde * variable for tilde, variable in zip(THETA_TILDE, PHI, strict=True))
        + disturbance
        - plant.r / plant.J * (D * s + K * sp.sign(s))
    )
    return step(
        "error dynamics",
        (sliding_symbol("s_rate"), sp.collect(error_dynamics, plant.Tr)),
        statement="s' = theta_tilde' phi + d - (r/J)(D s + K sgn s), with d the disturbance at the true mass.",
        done="The law put into s', theta = theta_hat + theta_tilde.",
        source=cite("Park2008", "(45), (47)"),
        holds=(identical(error_dynamics, expected),),
        check="compared term by term, proved and at random points",
    )


def _function_step(scalar: Lyapunov) -> Step:
    hessian = sp.hessian(scalar.V, (s, *THETA_TILDE))
    return step(
        "Lyapunov function",
        (sliding_symbol("V"), scalar.V),
        statement="V is a positive quadratic form of s and the estimation errors.",
        done="Chosen as in the source.",
        source=cite("Park2008", "(46)"),
        holds=(all(minor.is_positive for minor in (hessian[:n, :n].det() for n in (1, 2, 3))),),
        check="leading minors of its Hessian are positive for k > 0",
    )


def _rate_step(scalar: Lyapunov, error_dynamics: sp.Expr) -> Step:
    second = [sp.diff(scalar.cross_term, a, b) for a in THETA_TILDE for b in THETA_TILDE]
    rest = scalar.V_rate - scalar.cross_term
    return step(
        "rate of V",
        (sliding_symbol("V_rate"), scalar.V_rate),
        statement="V' without disturbances, theta_hat' still free; theta is constant, so theta_tilde' = -theta_hat'.",
        done="V differentiated along the error dynamics.",
        source=cite("Park2008", "(47), (48), corrected"),
        holds=(
            all(entry == 0 for entry in second),
            not rest.has(*THETA_TILDE),
            vanishes(scalar.cross_term.subs(dict.fromkeys(THETA_TILDE, 0))),
        ),
        check="the cross term is linear in theta_tilde and holds all of it",
    )


def _adaptation_step(function: Lyapunov, name: str, source: str, note: str) -> Step:
    solved = dict(zip(THETA_HAT_RATE, function.adaptation, strict=True))
    return step(
        name,
        (sp.Matrix(THETA_HAT_RATE), sp.Matrix(function.adaptation)),
        statement=f"theta_hat' for which the cross term of V' vanishes for every theta_tilde. {note}",
        done="The coefficients of theta_tilde in V' set to zero and solved for theta_hat'.",
        source=cite("Park2008", source),
        holds=(identical(function.cross_term.subs(solved), sp.Integer(0)),),
        check="put back, the cross term is 0, proved and at random points",
    )


def _final_step(scalar: Lyapunov, matrix: Lyapunov) -> Step:
    expected = -plant.r / plant.J * (D * s**2 + K * sp.Abs(s))
    return step(
        "rate of V, ideal",
        (sliding_symbol("V_rate"), scalar.V_rate_final),
        statement="Without disturbances V' = -(r/J)(D s^2 + K |s|): not positive, and zero wherever s is.",
        done="The adaptive law put into V'.",
        source=cite("Park2008", "(48), corrected by the factor r/J"),
        holds=(identical(scalar.V_rate_final, expected), identical(matrix.V_rate_final, expected)),
        check="for the scalar and the matrix gain, s sgn s = |s|; proved and at random points",
    )


def _disturbed_step(scalar: Lyapunov, matrix: Lyapunov, disturbance: sp.Expr) -> Step:
    expected = s * disturbance - plant.r / plant.J * (D * s**2 + K * sp.Abs(s))
    return step(
        "rate of V, disturbed",
        (sliding_symbol("V_rate"), scalar.V_rate_disturbed),
        statement="With the disturbance d = (1/(r M) + r/J) Tr + Fr/M - (r/J) Td the sign of V' is no longer settled.",
        done="The disturbances kept.",
        source="follows from the error dynamics; the source drops them from (47)",
        holds=(identical(scalar.V_rate_disturbed, expected), identical(matrix.V_rate_disturbed, expected)),
        check="for the scalar and the matrix gain, proved and at random points",
    )
