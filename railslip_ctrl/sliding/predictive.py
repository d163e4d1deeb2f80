"""Derivation of the predictive sliding-mode law from the equations of the plant, and of the loop of its boundary layer.

The command acts directly on S', the rate of the sliding variable S (relative degree one). A model of the brake's lag
gives T_plus, the torque that acts one dead time later, and the reduction of [Artstein1982] removes the dead time from
the slip error. The plant is `plant.WHEEL`, `plant.TRAIN` and the actuator of `plant`. The surface and the reaching law
are chosen. Everything else is derived, and a machine check decides each step. `proof` explains the symbols; units are
SI. Each rate has its own symbol.
"""

from __future__ import annotations

from functools import cache

import sympy as sp

from railslip_ctrl.core.notation import symbol
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model import plant

from .derivation import UNCERTAIN, accelerations, derive_surface
from .proof import Checked, DerivationStep, identical, linear_solution, sliding_symbol, step, vanishes

e, e_hat, lambda_d, lambda_d_rate, a = map(sliding_symbol, ("e", "e_hat", "lambda_d", "lambda_d_rate", "a"))
H, H_hat, H_hat_rate, T_plus, S, u = map(sliding_symbol, ("H", "H_hat", "H_hat_rate", "T_plus", "S", "u"))
kappa, k, K, g, phi, sat = map(sliding_symbol, ("kappa", "k", "K", "g", "phi", "sat"))
theta, tau_o = map(sliding_symbol, ("theta", "tau_o"))
E, Q, Qa, G, A = map(sliding_symbol, ("E", "Q", "Qa", "G", "A"))
_r, _J, _T = plant.r, plant.J, symbol("T")


@dataclass(frozen=True)
class PredictiveDerivation(Checked):
    """The predictive law: SymPy expressions in SI, with the symbols of `proof.PREDICTIVE_NOTATION`.

    - steps: steps of the derivation, in order.
    - holding_torque: H as a function of Ta, Tr, Td, omega, a, lambda_d and lambda_d_rate, N*m.
    - reduced_rate: e_hat' as a function of T_plus, H and H_hat_rate, m/s^2.
    - surface: S as a function of H_hat, e_hat and T_plus, N*m.
    - surface_rate: S' for any command u, N*m/s.
    - control_law: u, N*m; `sat` is S/phi, limited to -1 and 1.
    - disturbance: d, the part of S' due to the error of the estimate H_hat, N*m/s.
    - closed_rate: S' under the law, N*m/s.
    - sliding_rate: e_hat' on S = 0, m/s^2.
    - authority: largest K that the brake can follow while it releases and while it applies, N*m/s.
    - pole: p in H' = (J/r) p e', the pole of the slip error e on a static adhesion curve of slope Fa_slope, 1/s.
    - small_gain: bound of the loop gain from H' to H', dimensionless; below 1 the motion in the layer is stable.
    - loop: loop transfer function in the layer as a function of s, E, Q, Qa, G, A and Ga, dimensionless.
    - relative_degrees: relative degrees from the command to the published law's s and to S.
    """

    holding_torque: sp.Expr
    reduced_rate: sp.Expr
    surface: sp.Expr
    surface_rate: sp.Expr
    control_law: sp.Expr
    disturbance: sp.Expr
    closed_rate: sp.Expr
    sliding_rate: sp.Expr
    authority: tuple[sp.Expr, sp.Expr]
    pole: sp.Expr
    small_gain: sp.Expr
    loop: sp.Expr
    relative_degrees: tuple[int, int]


@cache
def derive_predictive() -> PredictiveDerivation:
    """Derive the predictive law; the result is cached."""
    plant_step, train, wheel = accelerations()
    error_step, holding = _holding_torque(wheel)
    reduction_steps, reduced = _reduction()
    law_steps, law = _law(reduced)
    motion_steps, sliding, authority = _motion(reduced, law)
    pole_step, pole = _pole(holding, train)
    gain_steps, small_gain = _small_gain(reduced, law)
    loop_step, loop = _layer(holding, law)
    degree_step, degrees = _relative_degrees(law)
    return PredictiveDerivation(
        **law,
        steps=(
            *(plant_step, error_step, _in_the_train_s_motion(holding, train), _ahead()),
            *(*reduction_steps, *law_steps, *motion_steps, pole_step, *gain_steps),
            *(loop_step, degree_step),
        ),
        holding_torque=holding,
        reduced_rate=reduced,
        sliding_rate=sliding,
        authority=authority,
        pole=pole,
        small_gain=small_gain,
        loop=loop,
        relative_degrees=degrees,
    )


def _holding_torque(wheel: sp.Expr) -> tuple[DerivationStep, sp.Expr]:
    t = sp.Symbol("t", real=True)
    v_t, omega_t, reference_t = (sp.Function(name)(t) for name in ("v", "omega", "lambda_d"))
    reference = linear_solution(plant.SLIP_RATIO.subs(plant.slip, lambda_d), plant.sigma)
    error = reference - plant.SLIP_VELOCITY.rhs
    moving = {plant.v: v_t, plant.omega: omega_t, lambda_d: reference_t}
    rates = {v_t.diff(t): -a, omega_t.diff(t): wheel, reference_t.diff(t): lambda_d_rate}
    rate = sp.expand(error.subs(moving).diff(t).subs(rates).subs({now: name for name, now in moving.items()}))
    torque = linear_solution(rate, plant.Tb)
    inertia = _J / _r * (a * (1 - lambda_d) + plant.v * lambda_d_rate)
    shown = plant.Ta + plant.Tr - plant.Td - plant.B * plant.omega + inertia
    motion = plant.motion()
    wheel_speed = linear_solution(plant.SLIP_VELOCITY, plant.omega)
    stated = lambda_d * motion.v_rate - motion.sigma_rate + plant.v * lambda_d_rate
    in_plant = {a: -motion.v_rate, plant.Ta: plant.ADHESION_TORQUE.rhs, plant.omega: wheel_speed}
    made = step(
        "holding torque",
        (sp.Matrix([sliding_symbol("e_rate"), H]), sp.Matrix([-_r / _J * (plant.Tb - H), shown])),
        identical(torque, shown),
        identical(rate, -_r / _J * (plant.Tb - torque)),
        identical((-_r / _J * (plant.Tb - shown)).subs(in_plant), stated),
    )
    return made, shown


def _in_the_train_s_motion(holding: sp.Expr, train: sp.Expr) -> DerivationStep:
    inside = sp.expand(holding.subs(a, -train))
    shown = sp.collect(inside, (plant.Ta, plant.Tr, plant.Fr))
    at_reference = {
        plant.omega: linear_solution(plant.SLIP_VELOCITY, plant.omega).subs(plant.sigma, lambda_d * plant.v),
        plant.Ta: plant.ADHESION_TORQUE.rhs,
        plant.Fr: plant.RESISTANCE.rhs,
        lambda_d_rate: 0,
    }
    trim = plant.trim_torque().subs(plant.sigma, lambda_d * plant.v)
    return step("holding torque in the train's motion", (H, shown), identical(inside.subs(at_reference), trim))


def _ahead() -> DerivationStep:
    s, tau, Tc = symbol("s"), symbol("tau"), symbol("Tc")
    lag, late = plant.actuator_lag_rate(), sp.Dummy("T_plus(t - theta)", real=True)
    rate = lag.subs({plant.Tb: T_plus, Tc: u})
    transfer = linear_solution(s * T_plus - rate, T_plus) / u * sp.exp(-tau * s)
    difference = lag - lag.subs(plant.Tb, late)
    return step(
        "torque ahead of the dead time",
        (sliding_symbol("T_plus_rate"), rate),
        identical(difference, -(plant.Tb - late) / _T),
        vanishes(transfer - plant.actuator_transfer()),
    )


def _reduction() -> tuple[tuple[DerivationStep, ...], sp.Expr]:
    t, x = sp.symbols("t x", real=True)
    torque, holding, estimate, error = (sp.Function(name) for name in ("T_plus", "H", "H_hat", "e"))
    error_rate = -_r / _J * (torque(x - theta) - holding(x))
    under_way = sp.Integral(torque(x), (x, t - theta, t))
    predicted = error(t) - _r / _J * (under_way - theta * estimate(t))
    names = {error(t).diff(t): error_rate.subs(x, t), estimate(t).diff(t): H_hat_rate}
    rate = sp.expand(predicted.diff(t).subs(names)).subs({torque(t): T_plus, holding(t): H})
    shown_rate = -_r / _J * (T_plus - H - theta * H_hat_rate)
    definition = e - _r / _J * (sliding_symbol("under_way") - theta * H_hat)
    reduced = step(
        "dead time removed",
        (sp.Matrix([e_hat, sliding_symbol("e_hat_rate")]), sp.Matrix([definition, shown_rate])),
        not rate.atoms(sp.core.function.AppliedUndef),
        identical(rate, shown_rate),
    )
    # e(t + theta) by integrating e' over the next dead time; the torque's integral becomes one over the last dead time
    span = (x, t, t + theta)
    torque_ahead = sp.Integral(torque(x - theta), span).transform(x - theta, x)
    surplus = sp.Integral(holding(x), span) - theta * estimate(t)
    ahead = error(t) - _r / _J * (torque_ahead - sp.Integral(holding(x), span))
    left_over = sp.expand(ahead - predicted - _r / _J * surplus)
    constant = sp.Integral(holding(x) - estimate(t), span).expand().doit() - surplus
    prediction = step(
        "error of the prediction",
        (sliding_symbol("prediction_error"), _r / _J * sliding_symbol("H_surplus")),
        left_over == 0,
        constant.doit().equals(0) is True,
    )
    return (reduced, prediction), shown_rate


def _law(reduced: sp.Expr) -> tuple[tuple[DerivationStep, ...], dict[str, sp.Expr]]:
    surface = H_hat + _J / _r * kappa * e_hat - T_plus
    ahead = plant.actuator_lag_rate().subs({plant.Tb: T_plus, symbol("Tc"): u})
    parts = {H_hat: H_hat_rate, e_hat: reduced, T_plus: ahead}
    rate = sum(sp.diff(surface, one) * its_rate for one, its_rate in parts.items())
    shown_rate = H_hat_rate - kappa * (T_plus - H - theta * H_hat_rate) - (u - T_plus) / _T
    known = rate.subs({H: H_hat, H_hat_rate: 0})
    asked = -k * S - K * sat
    law = T_plus + _T * (-kappa * (T_plus - H_hat) + k * S + K * sat)
    solved = linear_solution(known - asked, u)
    disturbance = kappa * (H - H_hat) + (1 + kappa * theta) * H_hat_rate
    closed = sp.expand(rate.subs(u, law))
    S_rate = sliding_symbol("S_rate")
    steps = (
        step(
            "predictive surface",
            (sp.Matrix([S, S_rate]), sp.Matrix([surface, shown_rate])),
            identical(rate, shown_rate),
            identical(sp.diff(rate, u), -1 / _T),
        ),
        step("predictive law", (u, law), identical(solved, law), identical(known.subs(u, law), asked)),
        step("rate of S under the law", (S_rate, disturbance + asked), identical(closed, disturbance + asked)),
    )
    made = {"surface": surface, "surface_rate": shown_rate, "control_law": law, "disturbance": disturbance}
    return steps, {**made, "closed_rate": disturbance + asked}


def _motion(
    reduced: sp.Expr, law: dict[str, sp.Expr]
) -> tuple[tuple[DerivationStep, ...], sp.Expr, tuple[sp.Expr, sp.Expr]]:
    d, size = sliding_symbol("d"), sp.Dummy("|d|", positive=True)
    product = S * (d - k * S - K * sp.sign(S))
    bound = -(K - size) * sp.Abs(S)
    on_surface = linear_solution(law["surface"], T_plus)
    sliding = -kappa * e_hat + _r / _J * (H - H_hat + theta * H_hat_rate)
    least, torque_max = law["control_law"].subs({sat: -1, S: 0}), sliding_symbol("torque_max")
    down = T_plus / _T - kappa * (T_plus - H_hat)
    up = (torque_max - T_plus) / _T + kappa * (T_plus - H_hat)
    released, applied = (law["surface_rate"].subs(u, limit) for limit in (0, torque_max))
    steps = (
        step(
            "reaching the predictive surface",
            (sliding_symbol("S_times_S_rate"), product),
            identical(S * law["closed_rate"].subs(sat, sp.sign(S)), product.subs(d, law["disturbance"])),
            identical(bound - product, sp.Abs(S) * size - S * d + k * S**2),
        ),
        step(
            "boundary layer",
            (sliding_symbol("S_rate"), d - g * S),
            identical(law["closed_rate"].subs(sat, S / phi), law["disturbance"] - (k + K / phi) * S),
        ),
        step(
            "motion on the surface",
            (sliding_symbol("e_hat_rate"), sliding),
            identical(reduced.subs(T_plus, on_surface), sliding),
        ),
        step(
            "authority",
            (sp.Matrix([sliding_symbol("K_down"), sliding_symbol("K_up")]), sp.Matrix([down, up])),
            identical(linear_solution(least, K), down),
            identical(linear_solution(law["control_law"].subs({sat: 1, S: 0}) - torque_max, K), up),
            identical(released, law["disturbance"] + down),
            identical(applied, law["disturbance"] - up),
        ),
    )
    return steps, sliding, (down, up)


def _pole(holding: sp.Expr, train: sp.Expr) -> tuple[DerivationStep, sp.Expr]:
    slope, rest = sliding_symbol("Fa_slope"), sp.Dummy("Fa_0", real=True)
    force = rest + slope * plant.sigma
    stated = {plant.Ta: plant.ADHESION_TORQUE.rhs.subs(plant.Fa, force), plant.Fr: plant.RESISTANCE.rhs}
    wheel_speed = linear_solution(plant.SLIP_VELOCITY, plant.omega)
    inside = (
        holding.subs(a, -train).subs({**stated, plant.omega: wheel_speed}).subs(plant.sigma, lambda_d * plant.v - e)
    )
    pole = _r / _J * sp.diff(inside, e)
    shown = -(_r**2 / _J + (1 - lambda_d) / plant.M) * slope - plant.B / _J
    usual = sp.diff(plant.motion().sigma_rate.subs(plant.Fa, force), plant.sigma)
    made = step(
        "pole of the error",
        (sliding_symbol("p"), shown),
        identical(pole, shown),
        identical(usual - pole, -lambda_d * slope / plant.M),
    )
    return made, shown


def _small_gain(reduced: sp.Expr, law: dict[str, sp.Expr]) -> tuple[tuple[DerivationStep, DerivationStep], sp.Expr]:
    # the bound of the loop gain is the sum of the L1 norms of the impulse responses
    p, s = sliding_symbol("p"), sp.Symbol("s", positive=True)
    lag = theta + tau_o
    observed = tau_o * H_hat_rate  # H - H_hat, as tau_o H_hat' = H - H_hat
    shown = (1 + kappa * lag) * H_hat_rate
    observer = step(
        "observer",
        (sliding_symbol("d"), shown),
        identical(law["disturbance"].subs(H, H_hat + observed), shown),
        vanishes(linear_solution(tau_o * s * H_hat - (H - H_hat), H_hat) - H / (tau_o * s + 1)),
    )
    # Laplace transforms of T_plus, e_hat, S and e' = -(r/J)(E T_plus - H), with H as input
    estimate, more = Q * H, 1 + kappa * lag
    equations = (
        s * e_hat - reduced.subs(H_hat_rate, s * estimate),
        S - law["surface"].subs(H_hat, estimate),
        s * S - (more * s * estimate - g * S),
    )
    found = sp.solve(equations, (T_plus, e_hat, S), dict=True)[0]
    gain = (H - E * found[T_plus]) / (s * H)  # from H' to (J/r) e'
    kernels = ((1 - Q * E) / s, -kappa * lag * Q * E / (s + kappa), more * Q * E * s / ((s + g) * (s + kappa)))
    filtered = {Q: 1 / (tau_o * s + 1)}
    x = sp.Symbol("x", positive=True)
    first = sp.integrate(sp.exp(-s * x), (x, 0, theta)) + E * sp.integrate(sp.exp(-x / tau_o - s * x), (x, 0, sp.oo))
    norms = (
        theta + sp.integrate(sp.exp(-x / tau_o), (x, 0, sp.oo)),
        -kernels[1].subs({Q: 1, E: 1}).subs(s, 0),
        more / g * (1 + sp.integrate(kappa * sp.exp(-kappa * x), (x, 0, sp.oo))),
    )
    quantity = 2 * p * (lag + more / g)
    # the kernels of Q, E, kappa/(s + kappa) and g/(s + g) are not negative and have integral 1
    made = step(
        "small gain",
        (sliding_symbol("small_gain"), quantity),
        vanishes((gain - sum(kernels)).subs(filtered)),
        vanishes((sp.expand(first).subs(sp.exp(-theta * s), E) - kernels[0]).subs(filtered)),
        vanishes(p * sum(norms) - quantity),
    )
    return (observer, made), quantity


def _layer(holding: sp.Expr, law: dict[str, sp.Expr]) -> tuple[DerivationStep, sp.Expr]:
    s, Ga, back = symbol("s"), sliding_symbol("Ga"), sp.Dummy("Tb_back", real=True)
    ahead = plant.actuator_lag_rate().subs({plant.Tb: T_plus, symbol("Tc"): u})
    # the observer filters Ta and omega by Q, the deceleration by Qa; the wheel accelerates by (v' - sigma')/r
    spin = (A * plant.Tb - s * G * plant.Tb) / _r
    torque = linear_solution(plant.WHEEL.subs(UNCERTAIN), plant.Ta).subs({plant.omega_rate: spin, plant.Tb: E * T_plus})
    filtered = {plant.Ta: Q * torque, plant.omega: Q * plant.omega, a: -Qa * A * plant.Tb, lambda_d_rate: 0}
    observed = sp.expand(holding.subs(UNCERTAIN).subs(filtered, simultaneous=True))
    equations = (
        H_hat - observed,
        e_hat + G * plant.Tb + _r / _J * ((1 - E) / s * T_plus - theta * H_hat),
        S - law["surface"],
        u - law["control_law"].subs(sat, S / phi),
        s * T_plus - ahead,
        back - Ga * u,
    )
    found = sp.solve(equations, (H_hat, e_hat, S, u, T_plus, back), dict=True, simplify=False)[0]
    more = kappa + g + g * kappa * theta
    above = s * Ga * (_T * s + 1) * _J / _r * (more * (s * Q * G + ((1 - lambda_d) * Qa - Q) * A) + g * kappa * G)
    below = (s + kappa) * (s + g) - g * kappa * E - s * more * Q * E
    loop = above / below
    made = step(
        "loop of the layer",
        (sliding_symbol("L"), loop),
        identical(sp.cancel(-found[back] / plant.Tb), loop.subs(g, k + K / phi)),
    )
    return made, loop


def _relative_degrees(law: dict[str, sp.Expr]) -> tuple[DerivationStep, tuple[int, int]]:
    Tc = symbol("Tc")
    published = derive_surface("proportional")["s_rate"]
    behind_the_lag = sp.diff(published, plant.Tb) * plant.actuator_lag_rate()
    degrees = (
        next(n for n, rate in enumerate((published, behind_the_lag), 1) if rate.has(Tc)),
        next(n for n, rate in enumerate((law["surface_rate"],), 1) if rate.has(u)),
    )
    made = step(
        "relative degree",
        (sp.Matrix([sliding_symbol("degree_s"), sliding_symbol("degree_S")]), sp.Matrix(degrees)),
        identical(sp.diff(behind_the_lag, Tc), -_r / (_J * _T)),
    )
    return made, degrees
