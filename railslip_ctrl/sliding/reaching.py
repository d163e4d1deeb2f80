"""Equivalent and robust control for known parameters: [Park2008] (36), (37), (41), (43), (42)."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from railslip_ctrl.core.sources import cite
from railslip_ctrl.model import plant

from .identities import identical, linear_solution
from .steps import Step, step
from .surface import UNCERTAIN, Surface, grouped_rate, s
from .symbols import sliding_symbol

Ueq, Ur, D, K, D0, K0 = (sliding_symbol(name) for name in ("Ueq", "Ur", "D", "K", "D0", "K0"))
_S_RATE = sliding_symbol("s_rate")


@dataclass(frozen=True)
class Reaching:
    """The law for known parameters.

    Attributes
    ----------
    equivalent_control : Expr
        Ueq, N*m, (36).
    reaching : Expr
        s' with Tb = Ueq + Ur, in the symbol Ur, (37).
    robust_term : Expr
        Ur = D s + K sgn s, N*m, (41).
    control_law : Expr
        Tb, N*m, (43).
    closed_rate : Expr
        s' under the control law, the disturbances kept.
    reaching_product : Expr
        s s' under the control law, (42).
    steps : tuple of Step
    """

    equivalent_control: sp.Expr
    reaching: sp.Expr
    robust_term: sp.Expr
    control_law: sp.Expr
    closed_rate: sp.Expr
    reaching_product: sp.Expr
    steps: tuple[Step, ...]


def derive_reaching(surface: Surface) -> Reaching:
    """The law from s'."""
    equivalent = linear_solution(surface.rate.subs(UNCERTAIN), plant.Tb)
    reaching = grouped_rate(sp.expand(surface.rate.subs(plant.Tb, equivalent + Ur)))
    robust = _robust(reaching)
    law = equivalent + robust
    closed = sp.expand(surface.rate.subs(plant.Tb, law))
    product = sp.expand(s * closed)
    return Reaching(
        equivalent_control=grouped(equivalent),
        reaching=reaching,
        robust_term=robust,
        control_law=grouped(equivalent) + robust,
        closed_rate=closed,
        reaching_product=product,
        steps=(
            _equivalent_step(surface, equivalent),
            _reaching_step(surface, reaching),
            _robust_step(reaching, robust),
            _law_step(surface, grouped(equivalent) + robust, closed),
            _product_step(surface, product),
        ),
    )


def grouped(control: sp.Expr) -> sp.Expr:
    """A control as the source writes it: J/r times a bracket by Ta and omega."""
    factor = plant.J / plant.r
    inside = sp.collect(sp.expand(control / factor), (plant.Ta, plant.omega))
    return sp.Mul(factor, inside, evaluate=False)


def _robust(reaching: sp.Expr) -> sp.Expr:
    """Ur for which s' without disturbances is -D0 s - K0 sgn s, in D = (J/r) D0 and K = (J/r) K0."""
    sign = sp.Dummy("sgn", real=True)  # `solve` would split sgn s into cases
    asked = -D0 * s - K0 * sign
    in_rates = linear_solution(reaching.subs(UNCERTAIN) - asked, Ur)
    ratio = plant.r / plant.J
    return sp.expand(in_rates.subs({D0: ratio * D, K0: ratio * K})).subs(sign, sp.sign(s))


def _equivalent_step(surface: Surface, equivalent: sp.Expr) -> Step:
    return step(
        "equivalent control",
        (Ueq, grouped(equivalent)),
        statement="The torque that keeps s constant when nothing is uncertain.",
        done="s' = 0 solved for Tb with Tr, Fr and Td dropped.",
        source=cite("Park2008", "(36)"),
        holds=(identical(surface.rate.subs(UNCERTAIN).subs(plant.Tb, equivalent), sp.Integer(0)),),
        check="put back into s' without uncertainties it gives 0, proved and at random points",
    )


def _reaching_step(surface: Surface, reaching: sp.Expr) -> Step:
    kept = surface.disturbance.free_symbols | {Ur}
    return step(
        "reaching dynamics",
        (_S_RATE, reaching),
        statement="With Tb = Ueq + Ur only the uncertainties and Ur are left in s'.",
        done="Tb = Ueq + Ur put into s'.",
        source=cite("Park2008", "(34), (37)"),
        holds=(
            reaching.free_symbols <= kept,
            identical(reaching, surface.disturbance + sp.diff(surface.rate, plant.Tb) * Ur),
        ),
        check="no measured quantity is left, and it is the disturbance plus (ds'/dTb) Ur",
    )


def _robust_step(reaching: sp.Expr, robust: sp.Expr) -> Step:
    found = reaching.subs(UNCERTAIN).subs(Ur, robust)
    ratio = plant.r / plant.J
    return step(
        "robust control",
        (Ur, robust),
        statement="s' = -D0 s - K0 sgn s is asked for, with D0 = (r/J) D and K0 = (r/J) K.",
        done="The reaching dynamics without disturbances solved for Ur.",
        source=cite("Park2008", "(39), (41)"),
        holds=(identical(found, -ratio * (D * s + K * sp.sign(s))), identical(robust, D * s + K * sp.sign(s))),
        check="put back it gives -(r/J)(D s + K sgn s), and it has the form of (41); proved and at random points",
    )


def _law_step(surface: Surface, law: sp.Expr, closed: sp.Expr) -> Step:
    expected = surface.disturbance - plant.r / plant.J * (D * s + K * sp.sign(s))
    return step(
        "control law",
        (plant.Tb, law),
        statement="The law for known parameters; sigma_d' and Ta have to be estimated.",
        done="Equivalent and robust control added.",
        source=cite("Park2008", "(43)"),
        holds=(identical(closed, expected), identical(surface.rate.subs(plant.Tb, law), expected)),
        check="s' of the plant under the law is the disturbance - (r/J)(D s + K sgn s), proved and at random points",
    )


def _product_step(surface: Surface, product: sp.Expr) -> Step:
    ratio = plant.r / plant.J
    size = sp.Dummy("|d|", positive=True)
    bound = sp.Abs(s) * (size - ratio * D * sp.Abs(s) - ratio * K)
    slack = sp.Abs(s) * size - s * surface.disturbance  # not negative, since x <= |x|
    return step(
        "reaching condition",
        (sliding_symbol("s_times_s_rate"), product),
        statement="s s' <= |s| (|d| - D0 |s| - K0) with d the disturbance: below -eta |s| where (40) holds.",
        done="s times s'; the bound differs from it by |s||d| - s d >= 0.",
        source=cite("Park2008", "(40), (42)"),
        holds=(identical(bound - product, slack),),
        check="bound - s s' = |s||d| - s d, proved and at random points",
    )
