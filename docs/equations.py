"""Equations (1) to (49) of [Park2008] in the order of the paper, read from the code that states or derives them.

Each equation is in the form of the package. If the print differs, its erratum (`railslip_ctrl.paper.errata`) follows.
This module itself contains only formulas that the package does not use: (1), (26), (29), (34), (38), and (7) and (8) of
the beam model. `tests/test_docs.py` integrates (7) and (8) and compares with `adhesion.beam.integrated_force`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from railslip_ctrl.core.notation import latex_names, symbol
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import law_class
from railslip_ctrl.model.adhesion.beam import Beam, integrated_force
from railslip_ctrl.model.adhesion.bristle import published_coefficients
from railslip_ctrl.model.vehicle import PARK2008
from railslip_ctrl.paper import printed
from railslip_ctrl.paper.errata import Erratum, adhesion_torque, corrected_observer
from railslip_ctrl.sliding.derivation import UNCERTAIN, Derivation
from railslip_ctrl.sliding.proof import SLIDING_NOTATION, sliding_symbol

SOURCE = "Park2008"

_ADHESION_LATEX = {
    **{name: f"{name[0]}_{name[1:]}" for name in ("Fs", "Fc", "vs", "Kx", "Cx")},
    "mu_max": r"\mu_\mathrm{max}",
    "mu_s": r"\mu_s",
    "mu_c": r"\mu_c",
    "mu_d": r"\mu_d",
    "x_c": "x_c",
    "l_h": "l_h",
    "C_x": "C_x",
    "F_s": "F_s",
    "F_c": "F_c",
    "v_s": "v_s",
}


@dataclass(frozen=True)
class Equation:
    """One numbered equation in the form of the package.

    `lines` are LaTeX, one formula each. `home` is the object of the package that states or derives the equation, or
    empty. `note` states a difference from the paper.
    """

    number: int
    title: str
    lines: tuple[str, ...]
    home: str
    note: str = ""

    def errata(self, rows: Sequence[Erratum]) -> list[Erratum]:
        """Return the rows of the errata that name this equation."""
        return [row for row in rows if self.number in numbers_in(row.where)]

    def prints(self, row: Erratum) -> bool:
        """True if the printed formula of an erratum belongs to this equation only."""
        alone = re.fullmatch(rf"\({self.number}\)(, .*)?", row.where) is not None
        return alone or _PRINTED_IN.get(row.where) == self.number


_PRINTED_IN = {"(22)-(24)": 24, "(38)-(39) with (41)": 39, "(47)-(48)": 48}
"""Number of the equation in the printed formula, for errata that name several equations."""


def numbers_in(where: str) -> set[int]:
    """Return the equation numbers in a reference to the paper: "(22)-(24)" gives 22, 23 and 24."""
    numbers = set()
    for first, last in re.findall(r"\((\d+)\)(?:-\((\d+)\))?", where):
        numbers |= set(range(int(first), int(last or first) + 1))
    return numbers


def tex(expression: sp.Basic) -> str:
    """Return an expression as LaTeX with the symbols of [Park2008]."""
    own = {sp.Symbol(name, **kind): text for name, text in _ADHESION_LATEX.items() for kind in ({}, {"positive": True})}
    sliding = {sliding_symbol(name): entry.latex for name, entry in SLIDING_NOTATION.items()}
    text = sp.latex(expression, symbol_names={**latex_names(), **own, **sliding})
    return str(text).replace(r"\operatorname{sign}", r"\operatorname{sgn}").replace(r"\:", r"\ ")


def _is(left: str, right: sp.Basic) -> str:
    return f"{left} = {tex(right)}"


def _eq(equation: sp.Eq) -> str:
    return _is(tex(equation.lhs), equation.rhs)


def plant_equations() -> list[Equation]:
    """Return (1) to (4): plant."""
    mu = sp.Function("mu")(plant.slip)
    home = "railslip_ctrl.model.plant"
    return [
        Equation(
            1, "adhesion coefficient", (_is("F_a", mu * symbol("N")),), "railslip_ctrl.model.adhesion.base.Statement"
        ),
        Equation(2, "slip", (_eq(plant.SLIP_VELOCITY), _eq(plant.SLIP_RATIO)), home),
        Equation(
            3,
            "wheel",
            (_eq(plant.WHEEL), _eq(plant.ADHESION_TORQUE)),
            home,
            "The paper adds the random adhesion torque $T_r$ only in (35); here it is part of the plant.",
        ),
        Equation(
            4,
            "train",
            (_eq(plant.TRAIN), _eq(plant.RESISTANCE)),
            home,
            "$F_r$ is the travelling resistance. The paper adds the random force, $T_r/r$, only in (35); here "
            "it is part of the plant.",
        ),
    ]


@dataclass(frozen=True)
class BeamParts:
    """Right-hand sides of (5) to (9) in SymPy; `mu_d` is (7), `sticking` the length lh of (8)."""

    pressure: sp.Expr
    per_length: tuple[sp.Expr, sp.Expr]
    mu_d: sp.Expr
    sticking: sp.Expr
    stiffness: sp.Expr


def beam_parts() -> BeamParts:
    """Return the parts of the beam model; the branches of (6) follow from (9) and from full sliding."""
    mu_max, a, Kx = Beam.symbols()
    length, slip, x, N = printed.length, printed.slip, printed.xc, printed.wheel_load
    sticking = length * (1 - Kx * slip / (3 * mu_max * N))
    mu_d = mu_max - a * slip * plant.v * length / (length - sp.Symbol("l_h", positive=True))
    locking = printed.Cx * slip * x
    sliding = printed.mu_d * printed.width * sp.Symbol("p", positive=True)
    return BeamParts(printed.pressure, (locking, sliding), mu_d, sticking, printed.travelling_stiffness)


def beam_force_in_u() -> sp.Expr:
    """Return the adhesion force (10) as a function of u = Kx lambda/(3 mu_max N), for sigma > 0."""
    mu_max, _a, Kx = Beam.symbols()
    u, N = sp.Symbol("u", positive=True), symbol("N")
    force = sp.expand(integrated_force().subs(plant.v, Kx * plant.sigma / (3 * mu_max * N * u)))
    return sp.collect(sp.expand(force), plant.sigma, lambda factor: sp.factor(sp.expand(factor)))


def beam_equations() -> list[Equation]:
    """Return (5) to (10): beam model."""
    parts = beam_parts()
    home = "railslip_ctrl.model.adhesion.beam"
    locking, sliding = parts.per_length
    mu_max, _a, Kx = Beam.symbols()
    share = Kx * symbol("slip") / (3 * mu_max * symbol("N"))
    branches = (
        rf"f_x = {tex(locking)} \quad \text{{for }} x_c \le l_h",
        rf"f_x = {tex(sliding)} \quad \text{{beyond}}",
    )
    return [
        Equation(5, "contact pressure", (_is("p", parts.pressure),), f"{home}.integrated_force"),
        Equation(6, "force per length", branches, f"{home}.integrated_force"),
        Equation(7, "friction where the footprint slides", (_is(r"\mu_d", parts.mu_d),), f"{home}.integrated_force"),
        Equation(8, "length of the sticking part", (_is("l_h", parts.sticking),), f"{home}.integrated_force"),
        Equation(9, "travelling stiffness", (_is("K_x", parts.stiffness),), f"{home}.integrated_force"),
        Equation(
            10,
            "adhesion force",
            (_is("F_a", beam_force_in_u()), _is("u", share)),
            f"{home}.Beam",
            r"For $u \le 1$. For larger $u$ the whole footprint slides, which the paper does not treat: "
            rf"$F_a = {tex(Beam.statement().force.args[1][0])}$.",
        ),
    ]


def dynamic_equations() -> list[Equation]:
    """Return (11) to (18): Dahl, LuGre and the LuGre tyre model."""
    rows = []
    for first, name in ((11, "dahl"), (13, "lugre"), (16, "tyre_lugre")):
        law = law_class(name)
        statement, home = law.statement(), f"{law.__module__}.{law.__name__}"
        rate, force = _is(r"\dot z", statement.state_rate), _is("F_a", _in_the_rate(statement))
        if name == "dahl":
            rows += [Equation(first, f"{law.title}: state", (rate,), home), Equation(12, "Dahl force", (force,), home)]
            continue
        alpha = law.symbols()[0]
        stribeck = sp.simplify((statement.steady_state * alpha).subs(plant.sigma, _positive()))
        g = _is(r"g(\sigma)", stribeck.subs(_positive(), sp.Abs(plant.sigma)))
        rows += [
            Equation(
                first, f"{law.title}: state", (rate,), home, r"The denominator is $g(\sigma)$ of the next equation."
            ),
            Equation(first + 1, f"{law.title}: Stribeck curve", (g,), home),
            Equation(first + 2, f"{law.title}: force", (force,), home, rf"With $\dot z$ from ({first})."),
        ]
    return rows


def _in_the_rate(statement: object) -> sp.Expr:
    """Return the adhesion force with the rate of z as one symbol."""
    return statement.force.subs(statement.state_rate, sp.Symbol(r"\dot{z}"))  # type: ignore[attr-defined]


def _positive() -> sp.Symbol:
    return sp.Symbol("sigma_positive", positive=True)


def bristle_equations() -> list[Equation]:
    """Return (19) to (24): bristle model."""
    law = law_class("bristle")
    statement = law.statement()
    alpha, beta, gamma = law.symbols()
    home = f"{law.__module__}.{law.__name__}"
    h = beta / (gamma - sp.Abs(plant.sigma))
    inverse = sp.Symbol(r"h(\sigma)")
    with_h = sp.expand(sp.cancel(statement.state_rate.subs(beta, inverse * (gamma - sp.Abs(plant.sigma)))))
    along = with_h.subs(sp.Abs(plant.sigma), plant.sigma).subs(plant.z, plant.Fa / alpha) / plant.sigma
    along = sp.factor(sp.expand(alpha * along))
    coefficients = (printed.vs / (printed.Fs - printed.Fc), printed.Fs * printed.vs / (printed.Fs - printed.Fc))
    return [
        Equation(19, "rate of the force over the slip path", (_is(r"\frac{\mathrm{d}F_a}{\mathrm{d}x}", along),), home),
        Equation(20, "force of the bristles", (_is("F_a", statement.force),), home),
        Equation(21, "rate of the force in time", (_is(r"\dot F_a", alpha * sp.Symbol(r"\dot{z}")),), home),
        Equation(
            22,
            "state",
            (_is(r"\dot z", statement.state_rate),),
            home,
            r"The print has $\sigma$ instead of $|\sigma|$; with it $z$ would diverge for $\sigma < 0$.",
        ),
        Equation(23, "Stribeck curve, linear", (_is(r"g(\sigma)", printed.bristle_g),), home),
        Equation(
            24,
            "inverse of the Stribeck curve",
            (_is(r"h(\sigma)", h), _is(r"\beta", coefficients[0]), _is(r"\gamma", coefficients[1])),
            home,
        ),
    ]


def observer_equations() -> list[Equation]:
    """Return (25) to (29): observer."""
    home, torque = "railslip_ctrl.paper.errata", adhesion_torque()
    hat, rate = sliding_symbol("Ta_hat"), printed.laplace * plant.omega
    return [
        Equation(25, "adhesion torque from the wheel", (_is("T_a", torque),), f"{home}.adhesion_torque"),
        Equation(26, "adhesion torque, Laplace domain", (_is("T_a", torque.subs(plant.omega_rate, rate)),), home),
        Equation(27, "observer", (_is(r"\hat T_a", corrected_observer()),), f"{home}.corrected_observer"),
        Equation(
            28,
            "observer without a derivative",
            (_is(r"\hat T_a", printed.observer_without_derivative),),
            "railslip_ctrl.paper.printed",
            "This is the printed form. It equals the printed (27) and has the same error.",
        ),
        Equation(
            29,
            "estimated adhesion coefficient",
            (_is(r"\hat\mu", hat / (symbol("N") * plant.r)),),
            "railslip_ctrl.identification.observer",
        ),
    ]


def coefficient_equations() -> list[Equation]:
    """Return (30) to (32), fitted to values of the function that evaluates them."""
    speeds = np.array([30.0, 85.0, 140.0])
    values = np.array([published_coefficients(v, PARK2008.wheel_load) for v in speeds]).T
    units = (("alpha", r"\mathrm{N/m}", 1.0), ("beta", r"\mathrm{(km/h)/N}", KMH), ("gamma", r"\mathrm{km/h}", KMH))
    rows = []
    for number, (name, unit, scale), row in zip((30, 31, 32), units, values, strict=True):
        quadratic = np.polyfit(speeds, row / scale, 2)  # three points: exact to rounding
        powers = ("", r"\,v_0", r"\,v_0^2")
        terms = " ".join(_number(c) + power for c, power in zip(quadratic[::-1], powers, strict=True))
        line = rf"\{name} = {terms.lstrip('+')}\ {unit}"
        home = "railslip_ctrl.model.adhesion.bristle.published_coefficients"
        rows.append(Equation(number, rf"{name} over the initial speed", (line,), home, "$v_0$ in km/h, 30 to 140."))
    return rows


def _number(value: float) -> str:
    """Return a number with four digits, as in the paper."""
    mantissa, exponent = f"{value:+.3e}".split("e")
    return rf"{mantissa} \times 10^{{{int(exponent)}}}"


def surface_equations(d: Derivation) -> list[Equation]:
    """Return (33) to (37): surface and equivalent control."""
    home = "railslip_ctrl.sliding.derivation.Derivation"
    Ueq, Ur = sliding_symbol("Ueq"), sliding_symbol("Ur")
    return [
        Equation(33, "sliding variable", (_is("s", d.s), _is("e", d.error)), home),
        Equation(34, "brake torque", (_is("T_b", sp.Add(Ueq, Ur, evaluate=False)),), home),
        Equation(35, "rate of the sliding variable", (_is(r"\dot s", d.s_rate),), home),
        Equation(36, "equivalent control", (_is("U_{eq}", d.equivalent_control),), home),
        Equation(37, "rate of the sliding variable under the equivalent control", (_is(r"\dot s", d.reaching),), home),
    ]


def reaching_equations(d: Derivation) -> list[Equation]:
    """Return (38) to (43): reaching the surface."""
    home = "railslip_ctrl.sliding.derivation.Derivation"
    rate, no_damping = sp.factor(d.closed_rate.subs(UNCERTAIN)), {sliding_symbol("D"): 0}
    asked = _is(r"\dot s", printed.asked_rate.subs(no_damping))
    disturbance = tex(d.disturbance)
    return [
        Equation(
            38,
            "reaching law, sign only",
            (_is(r"\dot s", rate.subs(no_damping)),),
            home,
            f"Follows from (41) with $D = 0$ and without disturbances; the print has ${asked}$.",
        ),
        Equation(39, "reaching law", (_is(r"\dot s", rate),), home, "Follows from (41) without disturbances."),
        Equation(
            40,
            "lower bound of the gains",
            (
                rf"D_0 \left|s\right| + K_0 > \left|{disturbance}\right| + \eta",
                r"D_0 = \frac{r}{J} D, \quad K_0 = \frac{r}{J} K",
            ),
            home,
        ),
        Equation(41, "robust control", (_is("U_r", d.robust_term),), home),
        Equation(42, "reaching condition", (_is(r"s \dot s", d.reaching_product) + r" < -\eta \left|s\right|",), home),
        Equation(43, "control law", (_is("T_b", d.control_law),), home),
    ]


def adaptive_equations(d: Derivation) -> list[Equation]:
    """Return (44) to (49): adaptation."""
    home = "railslip_ctrl.sliding.derivation.Derivation"
    theta = [_is(rf"\theta_{i}", one) for i, one in enumerate(d.theta, 1)]
    rates = [_is(rf"\dot{{\hat\theta}}_{i}", one) for i, one in enumerate(d.adaptation_matrix, 1)]
    return [
        Equation(44, "unknown coefficients", (*theta, _is(r"\phi", sp.Matrix(d.phi))), home),
        Equation(45, "adaptive control law", (_is("T_b", d.adaptive_law_control),), home),
        Equation(46, "Lyapunov function", (_is("V", d.V),), home, "With the scalar gain of the paper."),
        Equation(47, "rate of the Lyapunov function", (_is(r"\dot V", d.V_rate),), home),
        Equation(48, "rate of the Lyapunov function under the law", (_is(r"\dot V", d.V_rate_final),), home),
        Equation(49, "adaptation", tuple(rates), home, "With one gain for each component, so that the units agree."),
    ]


def groups(d: Derivation) -> dict[str, list[Equation]]:
    """Return all equations, grouped by the name of the file that shows them."""
    return {
        "plant": plant_equations(),
        "beam": beam_equations(),
        "dynamic": dynamic_equations(),
        "bristle": bristle_equations(),
        "observer": observer_equations(),
        "coefficients": coefficient_equations(),
        "surface": surface_equations(d),
        "reaching": reaching_equations(d),
        "adaptive": adaptive_equations(d),
    }
