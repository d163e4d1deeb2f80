"""Errata of the sliding-mode law and its proof: [Park2008] (35)-(49), compared with the derivation."""

from __future__ import annotations

import sympy as sp

from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008, TABLE4_SLIDING_PRINTED
from railslip_ctrl.sliding.adaptation import THETA_TILDE
from railslip_ctrl.sliding.derivation import Derivation
from railslip_ctrl.sliding.identities import vanishes
from railslip_ctrl.sliding.surface import UNCERTAIN
from railslip_ctrl.sliding.symbols import latex, sliding_symbol

from . import printed
from .erratum import Erratum, compared, told

_R = PARK2008.wheel.radius
_RATIO = PARK2008.wheel.radius / PARK2008.wheel.inertia
_MASS = (PARK2008.mass, PARK2008.mass_loaded)


def law_errata(derivation: Derivation) -> tuple[Erratum, ...]:
    """The rows, in the order of the equations."""
    return (
        *_known_parameters(derivation),
        _asked_rate(derivation),
        _random_force(derivation),
        *_theta(derivation),
        *_adaptive(derivation),
        *_lyapunov_rate(derivation),
        _adaptation(derivation),
        _invariant_set(derivation),
    )


def _named(expression: sp.Expr, derivation: Derivation) -> sp.Expr:
    """The printed sigma_d' as the reference has it."""
    return expression.subs(sliding_symbol("sigma_d_rate"), derivation.reference_rate)


def _known_parameters(derivation: Derivation) -> tuple[Erratum, ...]:
    pairs = (
        ("(35)", printed.s_rate(), derivation.s_rate, "with Fr read as the travelling resistance of (4)"),
        ("(36)", printed.equivalent_control(), derivation.equivalent_control, ""),
        ("(37)", printed.reaching(), derivation.reaching, ""),
        ("(41)", printed.robust_control(), derivation.robust_term, "for s' = -D0 s - K0 sgn s"),
        ("(42)", printed.reaching_product(), derivation.reaching_product, "(first line)"),
        ("(43)", printed.control_law(), derivation.control_law, ""),
    )
    return tuple(
        _expected_to_agree(where, as_printed, derived, note, derivation) for where, as_printed, derived, note in pairs
    )


def _expected_to_agree(where: str, as_printed: sp.Expr, derived: sp.Expr, note: str, derivation: Derivation) -> Erratum:
    left = _named(as_printed, derivation)
    agrees = vanishes(left - derived)
    return compared(
        where,
        (left,),
        (derived,),
        sign_and_size="no difference" if agrees else "see the difference",
        explanation=" ".join(("Follows from (3), (4) and (33)" if agrees else "Does not follow", note)).strip() + ".",
    )


def _asked_rate(derivation: Derivation) -> Erratum:
    derived = derivation.closed_rate.subs(UNCERTAIN)
    return compared(
        "(38)-(39) with (41)",
        (printed.asked_rate(),),
        (sp.factor(derived),),
        sign_and_size=f"same sign; printed J/r = {1 / _RATIO:.1f} times as fast (r/J = {_RATIO:.3e} 1/(kg m))",
        explanation="(37) with (41) has the factor r/J. Table 4's 1/h and km/h^2 are the units of (39); in (41) D and "
        "K are added to a torque. That they are meant as torque is an inference.",
    )


def _random_force(derivation: Derivation) -> Erratum:
    """Fr as a random force: the plant has it through Tr once, (35) would have it twice."""
    force = sp.Symbol("F_random", real=True)
    twice = printed.s_rate().subs({plant.Fr: force, plant.Tr: plant.r * force})
    once = derivation.s_rate.subs({plant.Fr: 0, plant.Tr: plant.r * force})
    speed = printed.SPEEDS_KMH[0] / 3.6
    travelling = PARK2008.resistance.quadratic * speed**2
    return compared(
        "F_r in (4) and (35)",
        (_named(twice, derivation),),
        (once,),
        sign_and_size=(
            f"the random force of {printed.RANDOM_FORCE:g} N counts {printed.RANDOM_FORCE / _MASS[0]:.3f} m/s^2 twice, "
            f"not once; the travelling resistance, {travelling:.0f} N at 100 km/h, i.e. "
            f"{travelling / _MASS[0]:.3f} m/s^2, is left out"
        ),
        explanation="One symbol stands for the travelling resistance in (4) and for the random force in (35). Here "
        "Fr is the travelling resistance and the random force enters through Tr, in (3) and (4) both.",
    )


def _theta(derivation: Derivation) -> tuple[Erratum, Erratum]:
    first, second = printed.theta()
    values = {
        sliding_symbol("Mn"): _MASS[0],
        sliding_symbol("Mp"): _MASS[1] - _MASS[0],
        plant.r: _R,
    }
    numbers = [float(expression.subs(values)) for expression in (first, derivation.theta[0])]
    return (
        compared(
            "(44), theta_1",
            (first,),
            (derivation.theta[0],),
            sign_and_size=(
                f"{_MASS[0]:g} -> {_MASS[1]:g} kg: printed {numbers[0]:+.3e}, derived {numbers[1]:+.3e} 1/(kg m): "
                f"{'other' if numbers[0] * numbers[1] < 0 else 'same'} sign, {abs(numbers[0] / numbers[1]):.2f} times "
                "the size"
            ),
            explanation="1/M - 1/Mn is not 1/Mp: theta1 = (1/r)(1/M - 1/Mn). (T_m in (44) is never defined; it is Ta.) "
            "The law does not use theta1's formula, only its estimate, so it is not wrong in itself.",
        ),
        _expected_to_agree("(44), theta_2", second, derivation.theta[1], "", derivation),
    )


def _adaptive(derivation: Derivation) -> tuple[Erratum, Erratum]:
    return (
        _expected_to_agree(
            "(45)", printed.adaptive_law(), derivation.adaptive_law_control, "with theta corrected", derivation
        ),
        _expected_to_agree("(46)", printed.lyapunov(), derivation.V, "(chosen, not derived)", derivation),
    )


def _lyapunov_rate(derivation: Derivation) -> tuple[Erratum, Erratum]:
    theta = [sliding_symbol("theta1"), sliding_symbol("theta2")]
    hat = [sliding_symbol("theta1_hat"), sliding_symbol("theta2_hat")]
    errors = dict(zip(THETA_TILDE, (a - b for a, b in zip(theta, hat, strict=True)), strict=True))
    # (47) before the law is put in: put the derived law in, and it must be the derived V'
    before = _named(printed.lyapunov_rate(), derivation).subs(plant.Tb, derivation.adaptive_law_control)
    first = compared(
        "(47) with (45)",
        (sp.expand(before.subs(errors)),),
        (sp.expand(derivation.V_rate.subs(errors)),),
        sign_and_size="no difference without disturbances",
        explanation="(47) is V' of the plant without disturbances; put (45) in (the text cites (46)) to get (48).",
    )
    second = compared(
        "(47)-(48)",
        (printed.lyapunov_rate_with_law(),),
        (derivation.V_rate,),
        sign_and_size=f"same sign; printed J/r = {1 / _RATIO:.1f} times too large (r/J = {_RATIO:.3e} 1/(kg m))",
        explanation="V' = -(r/J)(D s^2 + K |s|) + cross term: the factor r/J is lost; and the text cites (46) where "
        "(45) is put in. The disturbances of (35) are dropped in silence.",
    )
    return first, second


def _adaptation(derivation: Derivation) -> Erratum:
    units = _gain_units(derivation)
    return compared(
        "(49)",
        printed.adaptation(),
        derivation.adaptation_matrix,
        sign_and_size=f"units that follow: k1 in {units[0]}, k2 in {units[1]} (kg, m, s); printed: one number, "
        "dimensionless",
        explanation="The formula with scalar k makes the cross term vanish too, but the components of theta and phi "
        "have different units: a diagonal matrix gain is needed. With speeds in km/h the second component counts "
        "12.96 times as much as the first beside its value in SI.",
    )


def _gain_units(derivation: Derivation) -> list[str]:
    """Units of k1, k2 from theta' = k s phi, by putting units for symbols in the derived theta and phi."""
    kg, m, sec = sp.symbols("kg m s", positive=True)
    units = {
        plant.r: m,
        plant.J: kg * m**2,
        plant.Ta: kg * m**2 / sec**2,
        plant.omega: 1 / sec,
        sliding_symbol("s"): m / sec,
        sliding_symbol("Mn"): kg,
        sliding_symbol("Mp"): kg,
        sliding_symbol("Bp"): kg * m**2 / sec,
        sliding_symbol("k1"): sp.Integer(1),
        sliding_symbol("k2"): sp.Integer(1),
    }
    found = []
    for theta, rate in zip(derivation.theta, derivation.adaptation_matrix, strict=True):
        gain = theta.subs(units, simultaneous=True) / sec / rate.subs(units, simultaneous=True)
        found.append(str(sp.simplify(gain).as_coeff_Mul()[1]))
    return found


def _invariant_set(derivation: Derivation) -> Erratum:
    state = {sliding_symbol("s"), *THETA_TILDE}
    ideal = derivation.error_dynamics - derivation.disturbance_perturbed
    known = {plant.r, plant.J, sliding_symbol("D"), sliding_symbol("K")}
    driven = sorted((symbol for symbol in sp.expand(ideal).free_symbols - state - known), key=str)
    at_rest = sp.expand(ideal).subs(sliding_symbol("s"), 0)
    jump = _lyapunov_jump(derivation)
    names = ", ".join(latex(symbol) for symbol in driven)
    return told(
        "p. 54, invariant set theorem",
        r"\text{asymptotic stability}",
        rf"\dot s = {latex(ideal)},\quad ({names})\text{{ functions of time}}",
        how="argument",
        sign_and_size=(
            f"on s = 0 what is required is {at_rest} = 0, one equation for two errors; in the as-published reading V "
            f"jumps by theta1^2/(2k) = {jump:.3g} m^2/s^2 when the mass steps at {printed.MASS_STEP_TIME:g} s, as if s "
            f"had jumped to {(2 * jump) ** 0.5:.3g} m/s"
        ),
        explanation="The error system depends on time through "
        + ", ".join(map(str, driven))
        + ", so the invariant set theorem does not apply. Barbalat's lemma gives s -> 0 in the ideal case; theta_hat "
        "need not converge. What the actuator does is no part of the proof; it takes a simulation or `verify` to show.",
    )


def _lyapunov_jump(derivation: Derivation) -> float:
    """Step of V, m^2/s^2, when the mass does: theta1^2/(2 k1), as-published reading, where k1 in SI is Table 4's k."""
    light, heavy = (AS_PUBLISHED_INERTIA_SCALE * mass for mass in _MASS)
    masses = {sliding_symbol("Mn"): light, sliding_symbol("Mp"): heavy - light, plant.r: _R}
    theta1 = float(derivation.theta[0].subs(masses))
    gain = TABLE4_SLIDING_PRINTED["bristle"].k
    at = {sliding_symbol("s"): 0, THETA_TILDE[0]: theta1, THETA_TILDE[1]: 0, sliding_symbol("k"): gain}
    return float(derivation.V.subs(at))
