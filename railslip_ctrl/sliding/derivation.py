"""The adaptive sliding-mode law, derived step by step from the plant's statement ([Park2008] (33)-(49)).

Symbols are those of `notation` and `sliding.symbols`; plain SymPy, real, `sympy.sign` for sgn. s' is positive where s
grows, Tb > 0 brakes, theta_tilde = theta - theta_hat. Nothing of the law is typed in: the plant is `plant.WHEEL`,
`plant.TRAIN`, `plant.SLIP_VELOCITY`; what is chosen (not derived) is the surface (33), the reaching law asked for and
V. Every step carries the outcome of a machine check.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import sympy as sp

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.sources import cite
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import law_class

from .adaptation import PHI, Adaptation, derive_adaptation
from .identities import linear_solution, vanishes
from .reaching import D, K, Reaching, derive_reaching
from .statement_steps import statement_steps
from .steps import Step, step
from .surface import Reference, Surface, derive_surface, e, s
from .symbols import sliding_symbol


@dataclass(frozen=True)
class Derivation:
    """The law and all that leads to it.

    Expressions are in Ta (`plant.Ta`), omega, v_rate (v', measured), e and the parameters; only `law_in_adhesion`
    has Ta replaced by an adhesion law.

    Attributes
    ----------
    reference : str
        "proportional" (sigma_d = lambda_d v, sigma_d' = lambda_d v') or "constant".
    adhesion : str or None
        Name of the adhesion law put in for Ta, or None.
    steps : tuple of Step
        In order; `all_checked` tells whether every check holds.
    s, error, reference_rate : Expr
        s in e and e_integral (33); e in v, sigma and the reference; sigma_d'.
    s_rate : Expr
        s' in (Ta, Tr, Fr, Tb, Td, omega, v_rate, e) with M, J, B, r, (35).
    disturbance : Expr
        d: what Tr, Fr and Td add to s', at the true mass M. `disturbance_perturbed` has M = Mn + Mp.
    equivalent_control, reaching, robust_term, control_law : Expr
        (36); s' with Ueq + Ur in the symbol Ur (37); Ur (41); Tb (43). N*m but for `reaching`, m/s^2.
    closed_rate, reaching_product : Expr
        s' and s s' under `control_law` with the disturbances, (42).
    theta : tuple of Expr
        The unknown coefficients, true values, in r, J, Mn, Mp, Bp: (44) corrected.
    phi : tuple of Expr
        (Ta, omega).
    adaptive_law_control : Expr
        Tb with Mn, Bn and theta_hat, (45).
    error_dynamics : Expr
        s' under it in theta_tilde, with the disturbances.
    V, V_rate, cross_term, adaptation, V_rate_final, V_rate_disturbed
        As in `adaptation.Lyapunov`, scalar gain k, (46)-(49).
    V_matrix, adaptation_matrix
        The same for gains k1, k2 (diagonal matrix gain): units right.
    estimation_disturbance : Expr
        What the estimates Ta_hat and v_rate_hat in place of Ta and v_rate add to s' under `adaptive_law_control`.
    adhesion_torque, adhesion_state_rate : Expr or None
        Ta of the law, N*m, in v, sigma, z, N and the law's parameters; z', m/s, of a dynamic one.
    law_in_adhesion : Expr
        `adaptive_law_control` with that torque; the same as it without a law.
    """

    reference: str
    adhesion: str | None
    steps: tuple[Step, ...]
    s: sp.Expr
    error: sp.Expr
    reference_rate: sp.Expr
    s_rate: sp.Expr
    disturbance: sp.Expr
    disturbance_perturbed: sp.Expr
    equivalent_control: sp.Expr
    reaching: sp.Expr
    robust_term: sp.Expr
    control_law: sp.Expr
    closed_rate: sp.Expr
    reaching_product: sp.Expr
    theta: tuple[sp.Expr, ...]
    phi: tuple[sp.Expr, ...]
    adaptive_law_control: sp.Expr
    error_dynamics: sp.Expr
    V: sp.Expr
    V_rate: sp.Expr
    cross_term: sp.Expr
    adaptation: tuple[sp.Expr, ...]
    V_rate_final: sp.Expr
    V_rate_disturbed: sp.Expr
    V_matrix: sp.Expr
    adaptation_matrix: tuple[sp.Expr, ...]
    estimation_disturbance: sp.Expr
    adhesion_torque: sp.Expr | None
    adhesion_state_rate: sp.Expr | None
    law_in_adhesion: sp.Expr

    @property
    def all_checked(self) -> bool:
        """True where the check of every step holds."""
        return all(one.checked for one in self.steps)


@checked
@cache
def derive(*, reference: Reference = "proportional", law: str | None = None) -> Derivation:
    """Derive the sliding-mode law; takes a few seconds, and the result is kept. [Park2008] (33)-(45).

    Parameters
    ----------
    reference : str
        "proportional": slip velocity lambda_d v to be held; or "constant".
    law : str, optional
        Name of the adhesion law put in place of Ta; left out, Ta is an argument.

    Returns
    -------
    Derivation
        Equations and steps as SymPy expressions in SI, by name; no arrays.

    Raises
    ------
    InputError
        An unknown reference or law.
    """
    surface, reaching, adaptive = _whatever_the_adhesion(reference)
    estimates_step, estimation = _estimates(surface, adaptive)
    adhesion_steps, torque, state_rate, closed = _with_adhesion(law, surface, adaptive)
    scalar, matrix = adaptive.scalar, adaptive.matrix
    return Derivation(
        reference=reference,
        adhesion=None if law is None else law_class(law).name,
        steps=(*surface.steps, *reaching.steps, *adaptive.steps, estimates_step, *_statement_steps(), *adhesion_steps),
        s=surface.definition,
        error=surface.error,
        reference_rate=surface.reference_rate,
        s_rate=surface.rate,
        disturbance=surface.disturbance,
        disturbance_perturbed=adaptive.disturbance,
        equivalent_control=reaching.equivalent_control,
        reaching=reaching.reaching,
        robust_term=reaching.robust_term,
        control_law=reaching.control_law,
        closed_rate=reaching.closed_rate,
        reaching_product=reaching.reaching_product,
        theta=adaptive.theta,
        phi=PHI,
        adaptive_law_control=adaptive.adaptive_law_control,
        error_dynamics=adaptive.error_dynamics,
        V=scalar.V,
        V_rate=scalar.V_rate,
        cross_term=scalar.cross_term,
        adaptation=scalar.adaptation,
        V_rate_final=scalar.V_rate_final,
        V_rate_disturbed=scalar.V_rate_disturbed,
        V_matrix=matrix.V,
        adaptation_matrix=matrix.adaptation,
        estimation_disturbance=estimation,
        adhesion_torque=torque,
        adhesion_state_rate=state_rate,
        law_in_adhesion=closed,
    )


@cache
def _whatever_the_adhesion(reference: Reference) -> tuple[Surface, Reaching, Adaptation]:
    """What is derived with Ta as an argument, once for all adhesion laws."""
    surface = derive_surface(reference)
    reaching = derive_reaching(surface)
    return surface, reaching, derive_adaptation(surface, reaching)


@cache
def _statement_steps() -> tuple[Step, ...]:
    return statement_steps()


def _estimates(surface: Surface, adaptive: Adaptation) -> tuple[Step, sp.Expr]:
    """What estimates of Ta and v' in the law add to s'."""
    estimates = {plant.Ta: sliding_symbol("Ta_hat"), plant.v_rate: sliding_symbol("v_rate_hat")}
    law = adaptive.adaptive_law_control
    with_estimates = surface.rate.subs(plant.Tb, law.subs(estimates))
    difference = sp.expand(with_estimates - surface.rate.subs(plant.Tb, law))
    back = {symbol: true for true, symbol in estimates.items()}
    shown = sum(
        sp.collect(sp.expand(sp.diff(difference, true)), true) * (true - estimate)
        for true, estimate in estimates.items()
    )
    made = step(
        "estimates in the law",
        (sliding_symbol("s_rate_change"), shown),
        statement="Ta and v' are not measured: the law has estimates of them, and their errors add to d.",
        done="Ta_hat and v_rate_hat put into the law, its s' less the one with the true values.",
        source=cite("Park2008", "p. 54, below (43)"),
        holds=(vanishes(difference.subs(back)), vanishes(difference - shown)),
        check="zero where the estimates are right, linear in their errors, proved",
    )
    return made, sp.sympify(shown)


def _with_adhesion(
    law: str | None, surface: Surface, adaptive: Adaptation
) -> tuple[tuple[Step, ...], sp.Expr | None, sp.Expr | None, sp.Expr]:
    """The step, torque, state rate and control law with an adhesion law in place of Ta."""
    control = adaptive.adaptive_law_control
    if law is None:
        return (), None, None, control
    chosen = law_class(law)
    closed = plant.close(chosen)
    torque = plant.ADHESION_TORQUE.rhs.subs(plant.Fa, closed.force)
    closed_control = control.subs(plant.Ta, torque)
    made = step(
        "adhesion law",
        (plant.Ta, torque),
        statement=f"Ta of the {chosen.title}, at the measured slip velocity.",
        done="Ta = r Fa put into the law.",
        source=chosen.source,
        holds=(_closed_plant_slides(closed, surface, closed_control),),
        check="s' from the closed plant's rates under the law is the error dynamics with this torque, proved",
    )
    return (made,), torque, closed.rates[2] if chosen.has_state else None, closed_control


def _closed_plant_slides(closed: plant.ClosedPlant, surface: Surface, control: sp.Expr) -> bool:
    """s' from the rates of `plant.close`, with theta_hat = 0, Mp = Bp = 0, is d - (r/J)(D s + K sgn s)."""
    exact = dict.fromkeys((sliding_symbol("theta1_hat"), sliding_symbol("theta2_hat")), 0)
    nominal = {sliding_symbol("Mn"): plant.M, sliding_symbol("Bn"): plant.B}
    wheel_speed = linear_solution(plant.SLIP_VELOCITY, plant.omega)
    measured = {plant.omega: wheel_speed, plant.v_rate: closed.rates[0], e: surface.error}
    torque = control.subs(exact).subs(nominal).subs(measured)
    slope = [sp.diff(surface.error, x) for x in (plant.v, plant.sigma)]
    rate = slope[0] * closed.rates[0] + slope[1] * closed.rates[1].subs(plant.Tb, torque)
    rate += sliding_symbol("rho") * surface.error
    expected = surface.disturbance.subs(plant.Fr, plant.RESISTANCE.rhs)
    expected -= plant.r / plant.J * (D * s + K * sp.sign(s))
    return vanishes(rate - expected)
