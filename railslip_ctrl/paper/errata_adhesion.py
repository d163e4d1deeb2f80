"""Errata of the adhesion models and the observer: [Park2008] (6), (9), (10), (22)-(24), (27), (28)."""

from __future__ import annotations

import sympy as sp

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import beam, published_law
from railslip_ctrl.model.vehicle import PARK2008, Rail

from . import printed
from .erratum import Erratum, compared


def adhesion_errata() -> tuple[Erratum, ...]:
    """The rows, in the order of the equations."""
    return (_force_per_length(), _beam_force(), *_bristle_coefficients(), _observer(), _observer_forms())


def _force_per_length() -> Erratum:
    """(6): what must multiply each branch is solved for, from (5), (9) and the full sliding force mu_d N."""
    length, slip, mu_d, xc, N = printed.length, printed.slip, printed.mu_d, printed.xc, printed.wheel_load
    locking, slipping = printed.force_per_length()
    p = sp.Symbol("p", positive=True)
    a, b = sp.symbols("a b")
    stiffness = sp.integrate(a * locking / slip, (xc, 0, length))
    sliding = sp.integrate(b * slipping.subs(p, printed.pressure()), (xc, 0, length))
    factors = sp.solve([stiffness - printed.travelling_stiffness(), sliding - mu_d * N], [a, b])
    derived = (locking * factors[a], slipping * factors[b])
    w = beam.CONTACT_WIDTH
    kx = beam.CONTACT_STIFFNESS * beam.CONTACT_LENGTH**2 / 2
    return compared(
        "(6)",
        (locking, slipping),
        derived,
        sign_and_size=(
            f"as printed the locking force is {w:g} times the one of (9) ({w * kx:.4g} N, not Kx = {kx:.0f} N, per "
            f"unit slip), and the force of full sliding 1/w = {1 / w:.3g} 1/m times mu_d N, in another unit; "
            f"Cx as tabulated is {beam.CONTACT_STIFFNESS / w:.2g} Pa times w"
        ),
        explanation="(9) with the tabulated Cx has the contact width in it already; the pressure (5) is per area and "
        "needs it. The factors were solved for from Kx lambda at small slip and mu_d N at full slip.",
    )


def _beam_force() -> Erratum:
    derived, as_printed = beam.integrated_force(), printed.beam_force()
    half = beam.printed_force(width=False)
    mended = beam.printed_force(width=False, last_factor=sp.Rational(1, 4))
    law = published_law("beam", Rail.DRY, 100.0, PARK2008.wheel_load)
    values = dict(zip(type(law).symbols(), law.parameters(), strict=True))
    values |= {plant.v: 100.0 * KMH, sp.Symbol("N", positive=True): PARK2008.wheel_load}
    values[sp.Symbol("w", positive=True)] = beam.CONTACT_WIDTH

    def at(expression: sp.Expr, slip: float) -> float:
        return float(expression.subs(plant.sigma, slip * plant.v).subs(values))

    full = law.kinks(100.0 * KMH, PARK2008.wheel_load)[0].slip
    mends = bool(sp.expand(mended - derived) == 0)
    return compared(
        "(10)",
        (as_printed,),
        (derived,),
        sign_and_size=(
            f"v0 = 100 km/h: at slip 0.001 printed {at(as_printed, 0.001):.0f} N, derived {at(derived, 0.001):.0f} N; "
            f"at full slip {full:.4f} the 1/2 alone gives {at(half, full) / at(derived, full):.3f} of the force"
        ),
        explanation="(6) integrated over the footprint with (5), (7)-(9). The first term must not have w and the last "
        f"factor is 1/4, not 1/2: mended, the print {'equals' if mends else 'still differs from'} the integral.",
    )


def _bristle_coefficients() -> tuple[Erratum, Erratum]:
    """beta and gamma of (24) solved for from h = 1/g, (13) beside (22)."""
    sigma, Fs, Fc, vs = plant.sigma, printed.Fs, printed.Fc, printed.vs
    beta, gamma = sp.symbols("beta gamma")
    # beta/(gamma - sigma) = 1/g for every sigma: coefficients of sigma in beta g - (gamma - sigma)
    equation = sp.Poly(sp.expand(beta * printed.bristle_g() - (gamma - sigma)), sigma)
    found = sp.solve(equation.coeffs(), [beta, gamma], dict=True)[0]
    derived = tuple(_positive_first(found[name]) for name in (beta, gamma))
    law = published_law("bristle", Rail.DRY, 100.0, PARK2008.wheel_load)
    fitted = dict(zip(type(law).parameter_names(), law.parameters(), strict=True))
    static = fitted["gamma"] / fitted["beta"]
    literal = compared(
        "(22)-(24)",
        printed.bristle_coefficients(),
        derived,
        sign_and_size=(
            f"v0 = 100 km/h: (31), (32) give Fs = gamma/beta = {static:.0f} N; with a Coulomb force of any size above "
            f"1/Fs = {1 / static:.1e} N the printed beta is negative, the fitted one is +{fitted['beta']:.4g} (m/s)/N"
        ),
        explanation="The brackets are missing: 1/(Fs - Fc) and Fs/(Fs - Fc) are meant; as printed units do not fit.",
    )
    bracketed = compared(
        "(24) with brackets",
        (vs / (Fs - Fc), Fs * vs / (Fs - Fc)),
        derived,
        sign_and_size="no difference",
        explanation="h = 1/g with (23), by comparing (13) with (22), solved for beta and gamma.",
    )
    return literal, bracketed


def _positive_first(fraction: sp.Expr) -> sp.Expr:
    """-a/(c - b) written as a/(b - c)."""
    numerator, denominator = sp.fraction(sp.cancel(fraction))
    return -numerator / sp.expand(-denominator) if numerator.could_extract_minus_sign() else numerator / denominator


def _observer() -> Erratum:
    """(27) against Ta/(tau s + 1), the only thing the filter should do to Ta."""
    s, tau = printed.laplace, printed.tau
    true = sp.solve(plant.WHEEL.subs({plant.omega_rate: s * plant.omega, plant.Td: 0, plant.Tr: 0}), plant.Ta)[0]
    derived = true / (tau * s + 1)
    as_printed = printed.observer()
    jump = [sp.limit(sp.diff(expression, plant.Tb), s, sp.oo) for expression in (as_printed, derived)]
    return compared(
        "(27)",
        (as_printed,),
        (derived,),
        sign_and_size=f"of a step of Tb a share of {jump[0]} is in Ta_hat at once; filtered as a whole, {jump[1]}",
        explanation="Only J omega' is filtered; Ta_hat is then not a filtered Ta and rings with every change of the "
        "brake torque. Filtering all three terms gives Ta/(tau s + 1).",
    )


def _observer_forms() -> Erratum:
    return compared(
        "(28) = (27)",
        (printed.observer_without_derivative(),),
        (printed.observer(),),
        sign_and_size="no difference",
        explanation="The two printed forms of the observer are the same transfer function.",
    )
