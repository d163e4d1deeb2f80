"""Adhesion laws against [Park2008], the closed forms and independent integration."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from sample_laws import ALL_LAWS, UNPUBLISHED, sample_law
from scipy.integrate import solve_ivp
from sympy.core.function import ArgumentIndexError

from railslip_ctrl.core.errors import DomainError, InputError, MissingParametersError
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import ReferenceSlip, law_class, law_names, load_law, published_law
from railslip_ctrl.model.adhesion.beam import CONTACT_WIDTH, Beam, integrated_force, printed_force
from railslip_ctrl.model.adhesion.bristle import Bristle
from railslip_ctrl.model.adhesion.curve import Curve, curve_force
from railslip_ctrl.model.adhesion.table import Table
from railslip_ctrl.model.numeric import adhesion_coefficient, numeric_plant, peak, plant_parameters
from railslip_ctrl.model.vehicle import PARK2008, Rail

LOAD = 34_500.0
V100 = 100.0 * KMH

# Published and tabulated values hold to their printed digits: half a unit of the last one.
FOUR_DIGITS = 0.5e-4
THREE_DIGITS = 0.5e-3


# --- published and independent values ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("v0", "rail", "slip", "mu"),
    [(100, Rail.DRY, 0.0897, 0.2483), (100, Rail.WET, 0.0448, None), (30, Rail.DRY, 0.1319, 0.3547)],
)
def test_beam_peak(v0: float, rail: Rail, slip: float, mu: float | None) -> None:
    found = peak(published_law("beam", rail, v0), v0 * KMH, LOAD)
    assert found.slip == pytest.approx(slip, abs=FOUR_DIGITS)
    if mu is not None:
        assert found.coefficient == pytest.approx(mu, abs=FOUR_DIGITS)


@pytest.mark.parametrize(("slip", "mu"), [(0.2, 0.2350), (0.5, 0.1960), (1.0, 0.1310)])
def test_beam_beyond_full_slip(slip: float, mu: float) -> None:
    # mu_max - a sigma = 0.261 - 0.0013 * 100 slip, exact in the tabulated digits; rounding only
    assert adhesion_coefficient(published_law("beam", Rail.DRY), V100, slip, LOAD) == pytest.approx(mu, abs=1e-14)


@pytest.mark.parametrize(("rail", "slip"), [(Rail.DRY, 0.0985), (Rail.WET, 0.0492)])
def test_beam_full_slip_and_references_beyond_it(rail: Rail, slip: float) -> None:
    law = published_law("beam", rail)
    (kink,) = law.kinks(V100, LOAD)
    assert kink.slip == pytest.approx(slip, abs=FOUR_DIGITS)
    reference = law.reference_slip(rail)
    assert reference is not None
    assert reference > kink.slip


def test_beam_tabulated_stiffness() -> None:
    law = published_law("beam", Rail.DRY)
    assert isinstance(law, Beam)
    assert law.Kx == pytest.approx(274_360.0, rel=1e-15)  # [Park2008] Table 1; (9) gives it exactly


@pytest.mark.parametrize(("v0", "mu_max"), [(30, 0.360), (45, 0.335), (60, 0.310), (100, 0.261), (140, 0.226)])
def test_beam_interpolates_table_1(v0: float, mu_max: float) -> None:
    law = published_law("beam", Rail.DRY, v0)
    assert isinstance(law, Beam)
    assert law.mu_max == pytest.approx(mu_max, rel=1e-14)


def test_a_rail_may_be_named_and_nothing_else_is_taken_for_dry() -> None:
    assert published_law("bristle", "wet") == published_law("bristle", Rail.WET)
    assert published_law("bristle", "dry").on("wet") == published_law("bristle", Rail.WET)
    for wrong in ("icy", "Wet", None, 3):
        with pytest.raises(InputError, match=r"rail: .* is not allowed; give dry or wet"):
            published_law("beam", wrong)


def test_bristle_coefficients_at_100_kmh() -> None:
    law = published_law("bristle", Rail.DRY)
    assert isinstance(law, Bristle)
    # printed digits of (30)-(32) evaluated at v0 = 100 km/h
    assert law.alpha == pytest.approx(21_938.0, abs=0.5)
    assert law.beta / KMH == pytest.approx(0.013221, abs=0.5e-6)
    assert law.gamma / KMH == pytest.approx(149.353, abs=0.5e-3)


def test_bristle_steady_force() -> None:
    law = published_law("bristle", Rail.DRY)
    assert LOAD * adhesion_coefficient(law, V100, 1e-12, LOAD) == pytest.approx(11_296.6, abs=0.05)
    assert adhesion_coefficient(law, V100, 0.132, LOAD) == pytest.approx(0.29850, abs=0.5e-5)


@pytest.mark.parametrize(("rail", "slip", "mu"), [(Rail.DRY, 0.129, 0.299), (Rail.WET, 0.096, 0.153)])
def test_curve_peak(rail: Rail, slip: float, mu: float) -> None:
    found = peak(published_law("curve", rail), V100, LOAD)
    assert found.slip == pytest.approx(slip, abs=THREE_DIGITS)
    assert found.coefficient == pytest.approx(mu, abs=THREE_DIGITS)


@pytest.mark.parametrize("name", ["bristle", "tyre_lugre"])
def test_peak_of_a_falling_law_is_at_its_lower_end(name: str) -> None:
    assert peak(sample_law(name), V100, LOAD).slip == 1e-6


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize("v0", [30.0, 100.0, 140.0])
def test_curve_is_the_bristle_model_along_a_ramp(v0: float, rail: Rail) -> None:
    """Independent integration of the ramp's differential equation."""
    law = published_law("curve", rail, v0)
    assert isinstance(law, Curve)
    s = np.linspace(0.0, min(1.0, 0.98 * law.domain_limit(V100)[0]), 80) * law.v0
    solution = solve_ivp(
        lambda s, force: law.alpha * (1.0 - law.beta * force / (law.gamma - s)) * s / law.R,
        (0.0, s[-1]),
        [0.0],
        t_eval=s,
        method="DOP853",
        rtol=1e-12,
        atol=1e-8,
    )
    force = adhesion_coefficient(law, V100, s / law.v0, 1.0)
    # the integrator's tolerance per step, some hundreds of steps
    np.testing.assert_allclose(force, solution.y[0], rtol=1e-10, atol=1e-6)


def test_curve_derivative_is_the_ramp_equation() -> None:
    """Central difference of the quadrature against the SymPy function's derivative, away from 0."""
    law = published_law("curve", Rail.DRY)
    assert isinstance(law, Curve)
    p, h = law.parameters(), 1e-5
    for slip in (0.01, 0.1, 0.132, 0.5, 0.95):
        difference = (curve_force(slip + h, *p) - curve_force(slip - h, *p)) / (2 * h)
        s, force = slip * law.v0, curve_force(slip, *p)
        derivative = law.v0 * law.alpha * (1 - law.beta * force / (law.gamma - s)) * s / law.R
        # truncation h^2/6 F''' and rounding eps F/h, both below 1e-5 of 1e5 N
        assert difference == pytest.approx(derivative, rel=1e-6, abs=1e-2)


def test_curve_has_no_symbolic_derivative_by_its_parameters() -> None:
    with pytest.raises(ArgumentIndexError):
        Curve.statement().force.fdiff(2)


def test_curve_outside_its_domain_is_nan() -> None:
    p = published_law("curve", Rail.DRY, 140.0).parameters()
    assert np.isnan(curve_force(np.array([0.83, -0.9]), *p)).all()
    assert np.isfinite(curve_force(np.array([0.82, 0.0, -0.82]), *p)).all()


def test_curve_is_odd() -> None:
    p = published_law("curve", Rail.DRY).parameters()
    slip = np.linspace(0.0, 1.0, 11)
    np.testing.assert_array_equal(curve_force(-slip, *p), -curve_force(slip, *p))


# --- the beam's derivation and errata ------------------------------------------------------------------------------


def test_beam_closed_form_is_the_integral_of_its_equations() -> None:
    """[Park2008] (10) must be the integral of (6) with (5), (7)-(9)."""
    mu_max, a, Kx = Beam.symbols()
    v, sigma, N = symbol("v"), symbol("sigma"), symbol("N")
    u = Kx * sigma / v / (3 * mu_max * N)
    closed = N * mu_max * (1 - (1 - u) ** 3) - N * a * sigma * (3 * u - 2 * u**2)
    assert sp.simplify(integrated_force() - closed) == 0
    positive = sp.Symbol("sigma_p", positive=True)
    statement = Beam.statement().force.args[0].expr  # the branch |u| <= 1
    assert sp.simplify((statement - closed).subs(sigma, positive)) == 0


def test_beam_print_with_both_errors_mended_is_the_integral() -> None:
    mended = printed_force(width=False, last_factor=sp.Rational(1, 4))
    assert sp.simplify(mended - integrated_force()) == 0


def _printed_number(expression: sp.Expr, slip: float) -> float:
    law = published_law("beam", Rail.DRY)
    values = dict(zip(Beam.symbols(), law.parameters(), strict=True))
    values |= {symbol("v"): V100, symbol("sigma"): slip * V100, symbol("N"): LOAD}
    return float(expression.subs(values).subs(sp.Symbol("w", positive=True), CONTACT_WIDTH))


def test_printed_beam_force_is_negative_for_small_slip() -> None:
    """Erratum of (10): as printed, with w and 1/2, about -120 N at slip 0.001 (+271 N follows from (5)-(9))."""
    assert _printed_number(printed_force(), 0.001) == pytest.approx(-120.0, abs=5.0)  # two digits given
    assert _printed_number(integrated_force(), 0.001) > 0.0


def test_printed_beam_force_is_half_at_full_slip() -> None:
    """Erratum of (10): with the 1/2 (and without w) half the force at u = 1."""
    (kink,) = published_law("beam", Rail.DRY).kinks(V100, LOAD)
    half = _printed_number(printed_force(width=False), kink.slip)
    assert half / _printed_number(integrated_force(), kink.slip) == pytest.approx(0.5, rel=1e-12)  # rounding


# --- the dynamic laws as printed ------------------------------------------------------------------------------------


def dahl(p: list[float], s: float) -> tuple[float, ...]:
    alpha, Fc = p
    return alpha, 0.0, 0.0, alpha * s / Fc


def bristle(p: list[float], s: float) -> tuple[float, ...]:
    alpha, beta, gamma = p
    return alpha, 0.0, 0.0, alpha * s * beta / (gamma - s)


def lugre(p: list[float], s: float) -> tuple[float, ...]:
    alpha, alpha1, alpha2, Fs, Fc, vs = p
    return alpha, alpha1, alpha2, alpha * s / (Fc + (Fs - Fc) * math.exp(-((s / vs) ** 2)))


def tyre_lugre(p: list[float], s: float) -> tuple[float, ...]:
    alpha, alpha1, alpha2, mu_s, mu_c, vs = p
    decay = alpha * s / (mu_c + (mu_s - mu_c) * math.exp(-math.sqrt(s / vs)))
    return LOAD * alpha, LOAD * alpha1, LOAD * alpha2, decay


@pytest.mark.parametrize("printed", [dahl, bristle, lugre, tyre_lugre], ids=lambda printed: printed.__name__)
def test_dynamic_laws_as_printed(printed: Callable[[list[float], float], tuple[float, ...]]) -> None:
    """(11)-(22): Fa = a z + a1 z' + a2 sigma, z' = sigma - d z; at rest z = sigma/d."""
    law = sample_law(printed.__name__)
    functions, p = numeric_plant(type(law)), plant_parameters(law, PARK2008)
    for sigma, z in ((0.7, 0.2), (6.0, -0.3)):
        a, a1, a2, d = printed(list(law.parameters()), sigma)
        rate = sigma - d * z
        assert functions.rates(20.0, sigma, z, 0.0, 0.0, 0.0, p)[2] == pytest.approx(rate, rel=1e-13)
        force = a * z + a1 * rate + a2 * sigma
        assert functions.force(20.0, sigma, z, 0.0, 0.0, 0.0, p) == pytest.approx(force, rel=1e-13)
        assert functions.rest_state(20.0, sigma, 0.0, 0.0, 0.0, 0.0, p) == pytest.approx(sigma / d, rel=1e-13)


MAY_BE_NOUGHT = {
    *(("beam", "a"), ("polach", "Bw"), ("burckhardt", "c3")),
    *((law, name) for law in ("lugre", "tyre_lugre") for name in ("alpha1", "alpha2")),
}


@pytest.mark.parametrize("name", ALL_LAWS)
def test_parameters_are_positive_but_for_some(name: str) -> None:
    law = sample_law(name)
    for key in law.parameter_names():
        for value in (1e-9, 0.0, -1e-9):
            if value > 0.0 or (value == 0.0 and (name, key) in MAY_BE_NOUGHT):
                assert getattr(type(law)(**{**dict(law), key: value}), key) == value
            else:
                with pytest.raises(ValueError, match=key):
                    type(law)(**{**dict(law), key: value})


# --- wet rail, wheel load ------------------------------------------------------------------------------------------


def test_wet_scaling() -> None:
    for name, key, factor in [
        ("beam", "mu_max", 0.5),
        ("bristle", "beta", 2.0),
        ("curve", "beta", 2.0),
        ("dahl", "Fc", 0.5),
        ("lugre", "Fs", 0.5),
        ("lugre", "Fc", 0.5),
        ("tyre_lugre", "mu_s", 0.5),
        ("tyre_lugre", "mu_c", 0.5),
    ]:
        dry, wet = sample_law(name), sample_law(name, Rail.WET)
        assert getattr(wet, key) == factor * getattr(dry, key)
        changed = {k for k in dry.parameter_names() if getattr(dry, k) != getattr(wet, k)}
        assert changed == set(dry.wet_factors)
        assert wet.rail is Rail.WET
        assert wet.wet() is wet  # not halved twice
        with pytest.raises(InputError, match="for wet rail"):
            wet.on(Rail.DRY)


@pytest.mark.parametrize("name", ["bristle", "curve", "beam"])
def test_another_wheel_load_keeps_mu(name: str) -> None:
    """This project's assumption for loads the rig did not run."""
    slip = np.linspace(0.01, 0.5, 20)
    at_rig = adhesion_coefficient(published_law(name, Rail.DRY), V100, slip, LOAD)
    other = adhesion_coefficient(published_law(name, Rail.DRY, 100.0, 50e3), V100, slip, 50e3)
    np.testing.assert_allclose(other, at_rig, rtol=1e-13)  # rounding
    light = published_law(name, Rail.DRY).at_wheel_load(0.5 / LOAD)
    np.testing.assert_allclose(adhesion_coefficient(light, V100, slip, 0.5), at_rig, rtol=1e-13)
    assert light.parameters() == pytest.approx(published_law(name, Rail.DRY, 100.0, 0.5).parameters(), rel=1e-14)


def test_less_adhesion_is_what_halves_it_on_wet_rail_and_a_law_that_does_not_say_what_does_is_refused() -> None:
    law = sample_law("lugre")
    once, twice = law.wet(), law.weakened(0.25)
    for key in law.parameter_names():
        assert getattr(twice, key) * getattr(law, key) == pytest.approx(getattr(once, key) ** 2)
    with pytest.raises(InputError, match="with less adhesion"):
        Table(slip=(0.1, 0.5), mu=(0.2, 0.1)).weakened(0.5)


@pytest.mark.parametrize(
    ("name", "dry", "wet"), [("beam", 0.119, 0.059), ("bristle", 0.132, 0.092), ("curve", 0.132, 0.092)]
)
def test_published_reference_slips(name: str, dry: float, wet: float) -> None:
    """[Park2008] p. 55."""
    law = published_law(name, Rail.DRY)
    assert (law.reference_slip(Rail.DRY), law.reference_slip(Rail.WET)) == (dry, wet)


# --- refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(UNPUBLISHED))
def test_laws_without_published_parameters_say_where_to_give_them(name: str) -> None:
    with pytest.raises(MissingParametersError, match=r"--adhesion FILE\.toml"):
        published_law(name, Rail.DRY)
    assert sample_law(name).reference_slip(Rail.DRY) is None


@pytest.mark.parametrize("name", ["beam", "bristle", "curve"])
@pytest.mark.parametrize("v0", [29.999, 140.001, math.nan, -5.0])
def test_initial_speed_out_of_the_published_range(name: str, v0: float) -> None:
    with pytest.raises(InputError, match="30 to 140 km/h"):
        published_law(name, Rail.DRY, v0)


@pytest.mark.parametrize("load", [0.0, -1.0, math.inf, math.nan])
def test_wheel_load_must_be_positive(load: float) -> None:
    with pytest.raises(InputError, match="wheel load"):
        published_law("bristle", Rail.DRY, 100.0, load)


@pytest.mark.parametrize("name", ALL_LAWS)
@pytest.mark.parametrize("slip", [-1e-9, 1.0001, math.nan, math.inf])
def test_slip_outside_0_to_1(name: str, slip: float) -> None:
    with pytest.raises(DomainError, match=r"slip: .* is outside 0 to 1"):
        sample_law(name).check_domain(10.0, np.array([0.1, slip * 10.0]))


@pytest.mark.parametrize("v", [0.0, -1.0, math.nan, math.inf])
def test_speed_must_be_positive_and_finite(v: float) -> None:
    with pytest.raises(DomainError, match="speed"):
        sample_law("bristle").check_domain(v, 0.1)


@pytest.mark.parametrize("name", ["bristle", "curve"])
def test_bristle_leaves_its_domain_at_0_828_for_140_kmh(name: str) -> None:
    """[Park2008] (32) at v0 = 140 km/h."""
    law = published_law(name, Rail.DRY, 140.0)
    limit, _ = law.domain_limit(140.0 * KMH)
    assert limit == pytest.approx(0.828, abs=THREE_DIGITS)
    law.check_domain(140.0 * KMH, 0.8277 * 140.0 * KMH)
    with pytest.raises(DomainError, match="gamma"):
        law.check_domain(140.0 * KMH, limit * 140.0 * KMH * (1 + 1e-12))  # beyond rounding


def test_beam_friction_coefficient_must_stay_positive() -> None:
    law = published_law("beam", Rail.WET, 140.0)
    limit, _ = law.domain_limit(140.0 * KMH)
    assert limit == pytest.approx(0.113 / (0.0013 * 140.0), rel=1e-12)  # mu_max/(a v), rounding
    with pytest.raises(DomainError, match="no longer positive"):
        law.check_domain(140.0 * KMH, 0.7 * 140.0 * KMH)
    assert Beam(mu_max=0.2, a=0.0, Kx=1e5).domain_limit(10.0)[0] == math.inf


def test_unknown_law_lists_the_names() -> None:
    assert {"beam", "bristle", "curve", "dahl", "lugre", "tyre_lugre"} <= set(law_names())
    with pytest.raises(InputError, match=", ".join(law_names())):
        law_class("no such law")
    assert law_class("Tyre-LuGre") is law_class("tyre_lugre")


# --- files ---------------------------------------------------------------------------------------------------------

LUGRE_FILE = """
law = "lugre"
[parameters]
alpha = 2.0e4
Fs = "10.3 kN"
Fc = 6000
vs = "17 km/h"
[reference_slip]
dry = 0.13
wet = 0.09
"""


def test_law_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "law.toml"
    path.write_text(LUGRE_FILE)
    law = load_law(path)
    # order of the law's fields; 10.3 kN and 17 km/h converted, left-out damping 0
    assert law.parameters() == pytest.approx((2.0e4, 0.0, 0.0, 10_300.0, 6000.0, 17 / 3.6), rel=1e-14)
    assert law.reference == ReferenceSlip(dry=0.13, wet=0.09)
    assert law.wet().parameters() == pytest.approx((2.0e4, 0.0, 0.0, 5150.0, 3000.0, 17 / 3.6), rel=1e-14)


def test_wet_parameters_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "law.toml"
    path.write_text(
        'law = "dahl"\ncondition = "wet"\n[parameters]\nalpha = 1e4\nFc = 5e3\n[reference_slip]\nwet = 0.05\n'
    )
    law = load_law(path)
    assert law.reference_slip(Rail.WET) == 0.05
    assert law.on(Rail.WET).parameters() == (1e4, 5e3)
    with pytest.raises(InputError):
        law.on(Rail.DRY)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('law = "lugre"', "", 'key "law"'),
        ('law = "lugre"', 'law = "hunt"', "'hunt' is not a law"),
        ('law = "lugre"', 'law = "lugre"\nspeed = 3', "unknown key 'speed'"),
        ('law = "lugre"', 'law = "lugre"\ncondition = "icy"', "'icy' is not allowed"),
        ("alpha = 2.0e4", "", "parameters: alpha: missing; give it .N/m."),
        ("alpha = 2.0e4", "alpha = -1", "parameters: alpha: -1 is not allowed; give a value > 0 .N/m."),
        ("alpha = 2.0e4", "alpha = nan", "parameters: alpha: nan is not allowed; give a finite number"),
        ("alpha = 2.0e4", 'alpha = "3 km/h"', "parameters: alpha: .*wrong dimension"),
        ("alpha = 2.0e4", 'alpha = 2.0e4\nrail = "wet"', "unknown key 'parameters.rail'"),
        ("dry = 0.13", "dry = 1.3", "reference_slip: dry: 1.3 is not allowed; give a value < 1"),
        ("dry = 0.13", "icy = 0.13", "unknown key 'reference_slip.icy'"),
        (LUGRE_FILE, 'law = "lugre"\nparameters = 3', "is not a table"),
        (LUGRE_FILE, "", "empty"),
        (LUGRE_FILE, "law = ", "not valid TOML"),
    ],
)
def test_bad_files_get_one_clear_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "law.toml"
    path.write_text(LUGRE_FILE.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_law(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dry", ["0.13", '["a", "b"]'])
def test_reference_slips_over_the_initial_speed_are_one_for_each(tmp_path: Path, dry: str) -> None:
    path = tmp_path / "law.toml"
    path.write_text(
        LUGRE_FILE.replace("dry = 0.13\nwet = 0.09", f"initial_speed = [30, 140]\ndry = {dry}\nwet = [1, 1]")
    )
    with pytest.raises(InputError, match=r"reference_slip\.dry': give as many slips as speeds, 2"):
        load_law(path, initial_speed_kmh=100.0)


def test_files_that_are_no_text(tmp_path: Path) -> None:
    binary = tmp_path / "law.bin"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="byte 1 is not UTF-8; save the file as UTF-8 text"):
        load_law(binary)
    for missing, words in ((tmp_path / "no.toml", "no such file; check the path"), (tmp_path, "is a directory")):
        with pytest.raises(InputError, match=words):
            load_law(missing)
