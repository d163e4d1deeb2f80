"""Errata of [Park2008]: comparison of printed equations and numbers with ours. The texts are in `errata.toml`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import sympy as sp

from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.templates import filled, texts
from railslip_ctrl.core.units import KMH, to_unit
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import beam, published_law
from railslip_ctrl.model.adhesion.bristle import REFERENCE
from railslip_ctrl.model.adhesion.curve import SLIP_ACCELERATION
from railslip_ctrl.model.numeric import adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import (
    AS_PUBLISHED_INERTIA_SCALE,
    PARK2008,
    TABLE4_PI,
    TABLE4_PI_PRINTED,
    TABLE4_SLIDING_PRINTED,
    Rail,
)
from railslip_ctrl.sliding.derivation import THETA_TILDE, UNCERTAIN, Derivation
from railslip_ctrl.sliding.law import PUBLISHED_LAW
from railslip_ctrl.sliding.proof import latex, plain, sliding_symbol, vanishes
from railslip_ctrl.verification.reaching import least_gain, operating_set, reference_set, surface_needed

from . import printed

How = Literal["symbolic", "computed", "argument"]


@dataclass(frozen=True)
class Erratum:
    """A printed equation, number or claim of [Park2008], compared with ours.

    - where: equation, table or page of [Park2008].
    - printed, derived: printed expression and ours, as plain text.
    - printed_latex, derived_latex: both expressions in LaTeX.
    - difference_latex: difference of the expressions in LaTeX; "0" if they agree.
    - agrees: true if the difference is proved to be zero.
    - how: comparison of expressions ("symbolic") or numbers ("computed"), or an argument in words ("argument").
    - sign_and_size: the difference, computed with the paper's own numbers.
    - explanation: the error, and the equation or number that we use instead.
    """

    where: str
    printed_latex: str
    derived_latex: str
    difference_latex: str
    printed: str
    derived: str
    agrees: bool
    how: How
    sign_and_size: str
    explanation: str


def compared(
    where: str, printed: Sequence[sp.Expr], derived: Sequence[sp.Expr], *, text: str | None = None, **numbers: Any
) -> Erratum:
    """Make an erratum from printed and derived expressions, one pair or a column of pairs.

    `numbers` are filled into the text of `errata.toml` with the key `text`, by default `where`.
    """
    differences = (a - b for a, b in zip(printed, derived, strict=True))
    difference = [sp.Integer(0) if vanishes(one) else sp.factor_terms(sp.expand(one)) for one in differences]
    agrees = not any(difference)
    template = texts(__package__, "errata.toml")[text or where]
    return Erratum(
        where=where,
        printed_latex=column(printed),
        derived_latex=column(derived),
        difference_latex=column(difference),
        printed=_text(printed),
        derived=_text(derived),
        agrees=agrees,
        how="symbolic",
        sign_and_size=filled(template["size"], {"agrees": agrees, **numbers}),
        explanation=filled(template["explanation"], {"agrees": agrees, **numbers}),
    )


def column(entries: Sequence[sp.Expr]) -> str:
    """LaTeX of one expression, or of several as a column."""
    return latex(entries[0]) if len(entries) == 1 else latex(sp.Matrix(entries))


def stated(
    where: str, how: How, numbers: Mapping[str, Any], *, by_column: Mapping[str, Mapping[str, Any]] | None = None
) -> Erratum:
    """Make an erratum of a printed number or claim that disagrees with ours.

    `numbers` are filled into the text of `errata.toml` with the key `where`. `by_column` has further numbers for each
    column of a table.
    """
    template = texts(__package__, "errata.toml")[where]
    printed, derived, explanation = (filled(template[name], numbers) for name in ("printed", "derived", "explanation"))
    columns = {name: filled(template["size"], {**numbers, **more}) for name, more in (by_column or {"": {}}).items()}
    alike = len(set(columns.values())) == 1
    size = next(iter(columns.values())) if alike else "; ".join(f"{name}: {text}" for name, text in columns.items())
    plain_texts = _without_latex(printed), _without_latex(derived)
    return Erratum(where, printed, derived, r"\text{see size}", *plain_texts, False, how, size, explanation)


def _text(entries: Sequence[sp.Expr]) -> str:
    return plain(entries[0]) if len(entries) == 1 else plain(sp.Matrix(entries))


# Replacements from LaTeX to plain text, in this order: decorations first, then notation, innermost braces first.
_LATEX = (
    (r"\\(?:mathrm|text|operatorname)\s*\{([^{}]*)\}", r"\1"),
    (r"\\tilde\s*\{?\\?(\w+)\}?", r"\1~"),
    (r"\\hat\s*\{?\\?(\w+)\}?", r"\1^"),
    (r"\\dot\s*\{?\\?(\w+)\}?", r"\1'"),
    (r"\\left|\\right", ""),
    (r"\\[ ,;]", " "),
    (r"\\times", "*"),
    (r"\\ge\b", ">="),
    (r"\\le\b", "<="),
    (r"\\%", "%"),
    (r"\\quad", " "),
    (r"\^\{([^{}]*)\}", r"^\1"),
    (r"_\{([^{}]*)\}", r"_\1"),
)
_FRACTION = re.compile(r"\\frac\{([^{}]*)\}\{([^{}]*)\}")
_BRACES = re.compile(r"\{([^{}]*)\}")


def _without_latex(text: str) -> str:
    for pattern, replacement in _LATEX:
        text = re.sub(pattern, replacement, text)
    while _FRACTION.search(text) or _BRACES.search(text):
        text = _FRACTION.sub(r"(\1)/(\2)", text) if _FRACTION.search(text) else _BRACES.sub(r"\1", text, count=1)
    return re.sub(r" +", " ", re.sub(r"\\(?=[a-zA-Z])", "", text)).strip()


def _force_per_length() -> Erratum:
    length, slip, mu_d, xc, N = printed.length, printed.slip, printed.mu_d, printed.xc, printed.wheel_load
    locking, slipping = printed.force_per_length
    p = sp.Symbol("p", positive=True)
    a, b = sp.symbols("a b")
    stiffness = sp.integrate(a * locking / slip, (xc, 0, length))
    sliding = sp.integrate(b * slipping.subs(p, printed.pressure), (xc, 0, length))
    # factors of the two branches with which (9) and the full sliding force mu_d N result
    factors = sp.solve([stiffness - printed.travelling_stiffness, sliding - mu_d * N], [a, b])
    derived = (locking * factors[a], slipping * factors[b])
    kx = beam.CONTACT_STIFFNESS * beam.CONTACT_LENGTH**2 / 2
    return compared("(6)", (locking, slipping), derived, w=beam.CONTACT_WIDTH, kx=kx, stiffness=beam.CONTACT_STIFFNESS)


def _beam_force() -> Erratum:
    derived, as_printed = beam.integrated_force(), printed.beam_force
    half = beam.printed_force(width=False)
    mended = beam.printed_force(width=False, last_factor=sp.Rational(1, 4))
    law = published_law("beam", Rail.DRY, 100.0, PARK2008.wheel_load)
    values = dict(zip(type(law).symbols(), law.parameters(), strict=True))
    values |= {plant.v: 100.0 * KMH, sp.Symbol("N", positive=True): PARK2008.wheel_load}
    values[sp.Symbol("w", positive=True)] = beam.CONTACT_WIDTH

    def at(expression: sp.Expr, slip: float) -> float:
        return float(expression.subs(plant.sigma, slip * plant.v).subs(values))

    full = law.kinks(100.0 * KMH, PARK2008.wheel_load)[0].slip
    return compared(
        "(10)",
        (as_printed,),
        (derived,),
        printed_force=at(as_printed, 0.001),
        derived_force=at(derived, 0.001),
        full=full,
        half=at(half, full) / at(derived, full),
        mends=bool(sp.expand(mended - derived) == 0),
    )


def _bristle_coefficients() -> tuple[Erratum, Erratum]:
    sigma, Fs, Fc, vs = plant.sigma, printed.Fs, printed.Fc, printed.vs
    beta, gamma = sp.symbols("beta gamma")
    # beta/(gamma - sigma) = 1/g for every sigma: coefficients of sigma in beta g - (gamma - sigma)
    equation = sp.Poly(sp.expand(beta * printed.bristle_g - (gamma - sigma)), sigma)
    solution = sp.solve(equation.coeffs(), [beta, gamma], dict=True)[0]
    derived = tuple(_positive_first(solution[name]) for name in (beta, gamma))
    law = published_law("bristle", Rail.DRY, 100.0, PARK2008.wheel_load)
    fitted = dict(zip(type(law).parameter_names(), law.parameters(), strict=True))
    beta_fitted = fitted["beta"]
    return (
        compared(
            "(22)-(24)", printed.bristle_coefficients, derived, static=fitted["gamma"] / beta_fitted, beta=beta_fitted
        ),
        compared("(24) with brackets", (vs / (Fs - Fc), Fs * vs / (Fs - Fc)), derived),
    )


def _positive_first(fraction: sp.Expr) -> sp.Expr:
    """Rewrite -a/(c - b) as a/(b - c)."""
    numerator, denominator = sp.fraction(sp.cancel(fraction))
    return -numerator / sp.expand(-denominator) if numerator.could_extract_minus_sign() else numerator / denominator


def adhesion_torque() -> sp.Expr:
    """Adhesion torque Ta, [Park2008] (25), from omega', omega and Tb; the unmeasured Td and Tr in (3) are set to 0."""
    return sp.expand(sp.solve(plant.WHEEL.subs({plant.Td: 0, plant.Tr: 0}), plant.Ta)[0])


def corrected_observer() -> sp.Expr:
    """Observer [Park2008] (27), corrected: Ta/(tau s + 1) as a function of Tb and omega."""
    true = adhesion_torque().subs(plant.omega_rate, printed.laplace * plant.omega)
    return true / (printed.tau * printed.laplace + 1)


def passed_at_once(observer: sp.Expr) -> sp.Expr:
    """Fraction of a step of the brake torque Tb that appears in the observer's estimate immediately."""
    return sp.limit(sp.diff(observer, plant.Tb), printed.laplace, sp.oo)


def _observer() -> Erratum:
    as_printed, derived = printed.observer, corrected_observer()
    jump = [passed_at_once(expression) for expression in (as_printed, derived)]
    return compared("(27)", (as_printed,), (derived,), jump=jump)


_R = PARK2008.wheel.radius
_RATIO = PARK2008.wheel.radius / PARK2008.wheel.inertia
_MASS = (PARK2008.mass, PARK2008.mass_loaded)


def law_errata(derivation: Derivation) -> tuple[Erratum, ...]:
    """Compare the equations of the sliding-mode law and of its proof with `derivation`, in the order of the paper."""

    def agrees(where: str, as_printed: sp.Expr, derived: sp.Expr, note: str = "") -> Erratum:
        return compared(where, (_named(as_printed, derivation),), (derived,), text="as derived", note=note)

    d = derivation
    closed_rate = sp.factor(d.closed_rate.subs(UNCERTAIN))
    return (
        agrees("(35)", printed.s_rate, d.s_rate, "with Fr read as the travelling resistance of (4)"),
        agrees("(36)", printed.equivalent_control, d.equivalent_control),
        agrees("(37)", printed.reaching, d.reaching),
        agrees("(41)", printed.robust_control, d.robust_term, "for s' = -D0 s - K0 sgn s"),
        agrees("(42)", printed.reaching_product, d.reaching_product, "(first line)"),
        agrees("(43)", printed.control_law, d.control_law),
        compared("(38)-(39) with (41)", (printed.asked_rate,), (closed_rate,), ratio=_RATIO),
        _random_force(d),
        _theta1(d),
        agrees("(44), theta_2", printed.theta[1], d.theta[1]),
        agrees("(45)", printed.adaptive_law, d.adaptive_law_control, "with theta corrected"),
        agrees("(46)", printed.lyapunov, d.V, "(chosen, not derived)"),
        _lyapunov_rate(d),
        compared("(47)-(48)", (printed.lyapunov_rate_with_law,), (d.V_rate,), ratio=_RATIO),
        compared("(49)", printed.adaptation, d.adaptation_matrix, units=_gain_units(d)),
        _invariant_set(d),
    )


def _named(expression: sp.Expr, derivation: Derivation) -> sp.Expr:
    """Replace the symbol sigma_d' of the printed equations by the derived rate of the reference."""
    return expression.subs(sliding_symbol("sigma_d_rate"), derivation.reference_rate)


def _random_force(derivation: Derivation) -> Erratum:
    """Erratum: if Fr is the random adhesion force, (35) contains it twice, as Fr and in Tr, but the plant once."""
    force = sp.Symbol("F_random", real=True)
    twice = printed.s_rate.subs({plant.Fr: force, plant.Tr: plant.r * force})
    once = derivation.s_rate.subs({plant.Fr: 0, plant.Tr: plant.r * force})
    return compared(
        "F_r in (4) and (35)",
        (_named(twice, derivation),),
        (once,),
        force=printed.RANDOM_FORCE,
        mass=_MASS[0],
        travelling=PARK2008.resistance.quadratic * (printed.SPEEDS_KMH[0] / 3.6) ** 2,
    )


def _theta1(derivation: Derivation) -> Erratum:
    first, derived = printed.theta[0], derivation.theta[0]
    values = {sliding_symbol("Mn"): _MASS[0], sliding_symbol("Mp"): _MASS[1] - _MASS[0], plant.r: _R}
    sizes = tuple(float(expression.subs(values)) for expression in (first, derived))
    return compared("(44), theta_1", (first,), (derived,), masses=_MASS, sizes=sizes)


def _lyapunov_rate(derivation: Derivation) -> Erratum:
    names = ("theta1", "theta2")
    errors = {
        error: sliding_symbol(name) - sliding_symbol(f"{name}_hat")
        for error, name in zip(THETA_TILDE, names, strict=True)
    }
    before = _named(printed.lyapunov_rate, derivation).subs(plant.Tb, derivation.adaptive_law_control)
    return compared("(47) with (45)", *((sp.expand(rate.subs(errors)),) for rate in (before, derivation.V_rate)))


def _gain_units(derivation: Derivation) -> list[str]:
    kg, m, sec = sp.symbols("kg m s", positive=True)
    units = {plant.r: m, plant.J: kg * m**2, plant.Ta: kg * m**2 / sec**2, plant.omega: 1 / sec}
    named = {"s": m / sec, "Mn": kg, "Mp": kg, "Bp": kg * m**2 / sec, "k1": sp.Integer(1), "k2": sp.Integer(1)}
    units |= {sliding_symbol(name): unit for name, unit in named.items()}
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
    numbers = {
        "ideal_latex": latex(ideal),
        "names": ", ".join(latex(symbol) for symbol in driven),
        "driven": driven,
        "at_rest": sp.expand(ideal).subs(sliding_symbol("s"), 0),
        "jump": _lyapunov_jump(derivation),
        "step_time": printed.MASS_STEP_TIME,
    }
    return stated("p. 54, invariant set theorem", "argument", numbers)


def _lyapunov_jump(derivation: Derivation) -> float:
    light, heavy = (AS_PUBLISHED_INERTIA_SCALE * mass for mass in _MASS)
    masses = {sliding_symbol("Mn"): light, sliding_symbol("Mp"): heavy - light, plant.r: _R}
    theta1 = float(derivation.theta[0].subs(masses))
    gain = TABLE4_SLIDING_PRINTED["bristle"].k
    at = {sliding_symbol("s"): 0, THETA_TILDE[0]: theta1, THETA_TILDE[1]: 0, sliding_symbol("k"): gain}
    return float(derivation.V.subs(at))


def _strict_product(derivation: Derivation) -> Erratum:
    s, eta = sliding_symbol("s"), sp.Symbol("eta", positive=True)
    sides = [side.subs(s, 0) for side in (derivation.reaching_product, -eta * sp.Abs(s))]
    return stated("(42), strict", "symbolic", {"left": sides[0], "right": sides[1]})


def _bristle_maximum() -> Erratum:
    v, load = printed.SPEEDS_KMH[0] * KMH, PARK2008.wheel_load
    law, curve = (published_law(name, Rail.DRY, wheel_load=load) for name in ("bristle", "curve"))
    sigma, parameters = plant.sigma, dict(zip(type(law).symbols(), law.parameters(), strict=True))
    rest = (type(law).statement().steady_state * type(law).symbols()[0]).subs(parameters)
    slope = float(sp.diff(rest.subs(sp.sign(sigma), 1).subs(sp.Abs(sigma), sigma), sigma))
    slip = REFERENCE.dry
    least, at = (float(adhesion_coefficient(law, v, x, load)) for x in (1e-9, slip))
    numbers = {"slope": slope, "first": least, "at": at, "slip": slip, "ramp": SLIP_ACCELERATION}
    ramps = {R: peak(curve.model_copy(update={"R": R}), v, load).slip for R in (1.0, SLIP_ACCELERATION, 10.0)}
    return stated("Fig. 17, bristle maximum", "computed", {**numbers, "ramps": ramps})


def _reference_slips() -> Erratum:
    v, load = printed.SPEEDS_KMH[0] * KMH, PARK2008.wheel_load
    peaks = {
        f"{name} {rail}": peak(published_law(name, rail, wheel_load=load), v, load).slip
        for name in ("beam", "curve")
        for rail in Rail
    }
    references = {
        name: tuple(published_law(name, rail, wheel_load=load).reference_slip(rail) for rail in Rail)
        for name in ("beam", "bristle")
    }
    return stated("p. 46, slip of the largest adhesion", "computed", {"peaks": peaks, "references": references})


def _reaching_gain(derivation: Derivation) -> Erratum:
    D, K = PUBLISHED_LAW.D, PUBLISHED_LAW.K
    resistance = PARK2008.resistance.quadratic * (printed.SPEEDS_KMH[0] * KMH) ** 2 / PARK2008.mass
    # effect of one standard deviation of the random adhesion force on s', m/s^2
    random = {plant.Tr: _R * printed.RANDOM_FORCE, plant.Fr: 0, plant.Td: 0}
    wheel = {plant.r: _R, plant.J: PARK2008.wheel.inertia, plant.M: PARK2008.mass}
    d = float(derivation.disturbance.subs(wheel | random)) + resistance
    K0 = _RATIO * K
    boxes = [reference_set(PARK2008, sigmas=1.0, with_torque=torque) for torque in (False, True)]
    without, needed = (surface_needed(PARK2008, box, K=K, D=D) for box in boxes)
    numbers = {
        **{"K0": K0, "d": d, "without": without, "needed": needed, "K": K, "speed": printed.SPEEDS_KMH[0] * KMH},
        "least": _RATIO * least_gain(PARK2008, boxes[1]),
        "widest": least_gain(PARK2008, operating_set(PARK2008, sigmas=3.0)),
    }
    return stated("(40) with Table 4", "computed", numbers)


def _viscous() -> Erratum:
    t = sp.Symbol("t", real=True)
    B = printed.VISCOUS[0] + printed.VISCOUS[1] * t
    end = printed.TABLE5_TIMES[0]
    numbers = {"zero": float(sp.solve(B, t)[0]), "last": float(B.subs(t, end)), "end": end}
    return stated("B = 0.25 - 0.01 t", "computed", numbers)


def _table3() -> Erratum:
    means = {name: sum(row) / len(row) for name, row in printed.TABLE3.items()}
    rounded = printed.TABLE3_MEANS
    numbers = {
        **means,
        "printed": rounded,
        "claimed": printed.TABLE3_IMPROVEMENT,
        "improvement": 100.0 * (1.0 - means["bristle"] / means["beam"]),
        "rounded": 100.0 * (1.0 - rounded["bristle"] / rounded["beam"]),
    }
    return stated("Table 3", "computed", numbers)


def _values(rows: Iterable[float]) -> str:
    return r",\ ".join(f"{value:g}" for value in rows)


def _table4_kp() -> Erratum:
    one = to_unit("1 N*h", "N*m/(m/s)")
    same = to_unit("1 kN*m/(km/h)", "N*m/(m/s)") / one
    sizes = {name: {"printed": row.Kp * one, "reading": TABLE4_PI[name].kp} for name, row in TABLE4_PI_PRINTED.items()}
    values = _values(row.Kp for row in TABLE4_PI_PRINTED.values())
    return stated("Table 4, Kp", "computed", {"values": values, "same": same}, by_column=sizes)


def _table4_ki() -> Erratum:
    sizes = {
        name: {"printed": to_unit(f"{row.Ki} N", "N*m/m"), "reading": TABLE4_PI[name].ki}
        for name, row in TABLE4_PI_PRINTED.items()
    }
    values = _values(row.Ki for row in TABLE4_PI_PRINTED.values())
    return stated("Table 4, Ki", "computed", {"values": values}, by_column=sizes)


def _table4_asmc() -> Erratum:
    rows = TABLE4_SLIDING_PRINTED
    D, K, rho = (_values(dict.fromkeys(row[i] for row in rows.values())) for i in range(3))
    sizes = {name: _sliding_sizes(*row[:3]) for name, row in rows.items()}
    return stated("Table 4, D, K, rho", "computed", {"D": D, "K": K, "rho": rho}, by_column=sizes)


def _sliding_sizes(D: float, K: float, rho: float) -> dict[str, float]:
    rates = {
        "D0": to_unit(f"{D} 1/h", "1/s"),
        "K0": to_unit(f"{K} km/h^2", "m/s^2"),
        "rho0": to_unit(f"{rho} 1/h", "1/s"),
    }
    return {**rates, "D_read": D / KMH, "K_read": K, "ratio": _RATIO}


def _energy() -> Erratum:
    v0, v1 = (speed * KMH for speed in printed.SPEEDS_KMH)
    scale, energy = AS_PUBLISHED_INERTIA_SCALE, printed.TABLE5_ENERGY["PI"]
    kinetic = 0.5 * scale * PARK2008.mass * (v0**2 - v1**2)
    numbers = {"digits": energy * 1e7, "joules": energy * 1e14 / scale / 1e6, "kinetic": kinetic, "scale": scale}
    return stated("Table 5, energy", "computed", numbers)


def _duration() -> Erratum:
    v0, v1 = (speed * KMH for speed in printed.SPEEDS_KMH)
    decelerations = {rail: mu * PARK2008.wheel_load / PARK2008.mass for rail, mu in printed.PEAK_ADHESION.items()}
    times = {rail: (v0 - v1) / a for rail, a in decelerations.items()}
    numbers = {
        "printed": (min(printed.TABLE5_TIMES), max(printed.TABLE5_TIMES)),
        "times": times,
        "deceleration": decelerations["dry"],
        "heavy": times["wet"] * PARK2008.mass_loaded / PARK2008.mass,
        "least": _least_time(AS_PUBLISHED_INERTIA_SCALE, v0, v1),
        "scale": AS_PUBLISHED_INERTIA_SCALE,
        "step_time": printed.MASS_STEP_TIME,
    }
    return stated("Table 5 / (4), braking time", "computed", numbers)


def _least_time(scale: float, v0: float, v1: float) -> float:
    """Braking time, s, from v0 to v1 at peak adhesion; at `MASS_STEP_TIME` the rail gets wet and the mass rises."""
    load = PARK2008.wheel_load
    dry = printed.PEAK_ADHESION["dry"] * load / (scale * PARK2008.mass)
    wet = printed.PEAK_ADHESION["wet"] * load / (scale * PARK2008.mass_loaded)
    left = v0 - v1 - dry * printed.MASS_STEP_TIME
    return (v0 - v1) / dry if left <= 0 else printed.MASS_STEP_TIME + left / wet


def errata(derivation: Derivation) -> tuple[Erratum, ...]:
    """Compare all checked equations and numbers of [Park2008] with ours; `derivation` derives the published law."""
    return (
        *(_force_per_length(), _beam_force(), *_bristle_coefficients(), _observer()),
        compared("(28) = (27)", (printed.observer_without_derivative,), (printed.observer,)),
        *law_errata(derivation),
        *(_strict_product(derivation), _bristle_maximum(), _reference_slips()),
        *(_reaching_gain(derivation), _viscous(), _table3(), _table4_kp(), _table4_ki(), _table4_asmc()),
        *(_energy(), _duration()),
    )
