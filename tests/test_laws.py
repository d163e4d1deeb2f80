"""Adhesion laws against [Park2008], their sources, closed forms and independent integration; their files, as the
commands take them."""

import itertools
import json
import math
import re
import sys

import mpmath
import numpy as np
import pytest
import sympy as sp
from project import recipe, refused
from sample_laws import ALL_LAWS, UNPUBLISHED, sample_law
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator

from railslip_ctrl import PARK2008, DomainError, InputError, MissingParametersError, Rail, adhesion, operating_point
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import ReferenceSlip, law_class, load_law, published_law
from railslip_ctrl.model.adhesion.base import curtius_kniffler
from railslip_ctrl.model.adhesion.beam import Beam, integrated_force, printed_force
from railslip_ctrl.model.adhesion.burckhardt import SURFACES, Burckhardt
from railslip_ctrl.model.adhesion.curve import curve_force
from railslip_ctrl.model.adhesion.polach import Polach
from railslip_ctrl.model.adhesion.table import LookupTable, table_force, table_slope
from railslip_ctrl.model.numeric import adhesion_coefficient, numeric_plant, peak, plant_parameters
from railslip_ctrl.report.export import source_at
from railslip_ctrl.report.text import case_title

LOAD = 34_500.0
V100 = 100.0 * KMH
DRY, WET = Rail.DRY, Rail.WET

# Published and tabulated values hold to their printed digits: half a unit of the last one.
FIVE_DIGITS, FOUR_DIGITS, THREE_DIGITS = 0.5e-5, 0.5e-4, 0.5e-3


def forces(name: str, rail: Rail = DRY):
    law = sample_law(name, rail)
    return numeric_plant(type(law)), plant_parameters(law, PARK2008)


@pytest.mark.parametrize(("name", "rail", "v0", "slip", "mu", "digits"), [
    ("beam", DRY, 100, 0.0897, 0.2483, FOUR_DIGITS),
    ("beam", WET, 100, 0.0448, None, FOUR_DIGITS),
    ("beam", DRY, 30, 0.1319, 0.3547, FOUR_DIGITS),
    ("curve", DRY, 100, 0.129, 0.299, THREE_DIGITS),
    ("curve", WET, 100, 0.096, 0.153, THREE_DIGITS),
    ("polach", DRY, 100, 0.0142, 0.42778, FOUR_DIGITS),
    ("polach", WET, 100, 0.0388, 0.23867, FOUR_DIGITS),
    ("burckhardt", WET, 100, 0.13069, 0.80391, FIVE_DIGITS),
    ("bristle", DRY, 100, 1e-6, 0.32744, FIVE_DIGITS),  # falls from the start: 11 296.6 N there
])  # fmt: skip
def test_peaks(name: str, rail: Rail, v0: float, slip: float, mu: float | None, digits: float) -> None:
    found = peak(published_law(name, rail, v0), v0 * KMH, LOAD)
    assert found.slip == pytest.approx(slip, abs=digits)
    assert mu is None or found.coefficient == pytest.approx(mu, abs=digits)


@pytest.mark.parametrize(("name", "rail", "slip", "mu", "digits"), [
    # mu_max - a sigma = 0.261 - 0.0013 * 100 slip, exact in the tabulated digits; rounding only
    *(("beam", DRY, slip, mu, 1e-14) for slip, mu in ((0.2, 0.2350), (0.5, 0.1960), (1.0, 0.1310))),
    *(("polach", DRY, slip, mu, FIVE_DIGITS) for slip, mu in ((0.01, 0.42182), (0.1, 0.27965))),
    *(("polach", WET, slip, mu, FIVE_DIGITS) for slip, mu in ((0.01, 0.19947), (0.1, 0.21584))),
    ("bristle", DRY, 0.132, 0.29850, FIVE_DIGITS),
])  # fmt: skip
def test_coefficients(name: str, rail: Rail, slip: float, mu: float, digits: float) -> None:
    assert adhesion_coefficient(published_law(name, rail), V100, slip, LOAD) == pytest.approx(mu, abs=digits)


def test_parameters_of_table_1_and_30_to_32() -> None:
    beam, bristle = published_law("beam", DRY), published_law("bristle", DRY)
    assert beam.Kx == pytest.approx(274_360.0, rel=1e-15)  # (9) gives it exactly
    for v0, mu_max in ((30, 0.360), (45, 0.335), (60, 0.310), (100, 0.261), (140, 0.226)):
        assert published_law("beam", DRY, v0).mu_max == pytest.approx(mu_max, rel=1e-14)
    for rail, slip in ((DRY, 0.0985), (WET, 0.0492)):  # full slip, and references beyond it
        (kink,) = published_law("beam", rail).kinks(V100, LOAD)
        assert kink.slip == pytest.approx(slip, abs=FOUR_DIGITS)
        assert beam.reference_slip(rail) > kink.slip
    # printed digits of (30)-(32) evaluated at v0 = 100 km/h
    assert bristle.alpha == pytest.approx(21_938.0, abs=0.5)
    assert bristle.beta / KMH == pytest.approx(0.013221, abs=0.5e-6)
    assert bristle.gamma / KMH == pytest.approx(149.353, abs=0.5e-3)
    for name, dry, wet in (("beam", 0.119, 0.059), ("bristle", 0.132, 0.092), ("curve", 0.132, 0.092)):  # p. 55
        law = published_law(name, DRY)
        assert (law.reference_slip(DRY), law.reference_slip(WET)) == (dry, wet)


def test_curtius_kniffler() -> None:
    assert curtius_kniffler(V100) == pytest.approx(0.21308, abs=FIVE_DIGITS)
    assert curtius_kniffler(np.array([[0.0], [10.0]])) == pytest.approx(np.array([[7.5 / 44 + 0.161], [0.25475]]))
    for speed in (-1e-9, math.nan, math.inf, [1.0, -1.0]):
        with pytest.raises(DomainError, match="speed"):
            curtius_kniffler(speed)


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize("v0", [30.0, 100.0, 140.0])
def test_curve_is_the_bristle_model_along_a_ramp(v0: float, rail: Rail) -> None:
    """Independent integration of the ramp's differential equation."""
    law = published_law("curve", rail, v0)
    s = np.linspace(0.0, min(1.0, 0.98 * law.domain_limit(V100)[0]), 80) * law.v0

    def rate(s, force):
        return law.alpha * (1.0 - law.beta * force / (law.gamma - s)) * s / law.R

    solution = solve_ivp(rate, (0.0, s[-1]), [0.0], t_eval=s, method="DOP853", rtol=1e-12, atol=1e-8)
    force = adhesion_coefficient(law, V100, s / law.v0, 1.0)
    # the integrator's tolerance per step, some hundreds of steps
    np.testing.assert_allclose(force, solution.y[0], rtol=1e-10, atol=1e-6)


def test_curve_is_odd_and_nan_outside_its_domain() -> None:
    slip, (p, fast) = np.linspace(0.0, 1.0, 11), (published_law("curve", DRY, v0).parameters() for v0 in (100.0, 140.0))
    np.testing.assert_array_equal(curve_force(-slip, *p), -curve_force(slip, *p))
    many = np.linspace(0.0, 1.0, 700).reshape(7, 100)  # several blocks, the last not full
    alone = [float(curve_force(slip, *p)) for slip in many.flat]
    np.testing.assert_allclose(curve_force(many, *p), np.reshape(alone, many.shape), rtol=2e-13)  # as stated
    found = curve_force(np.array([0.83, -0.9, 0.82, 0.0, -0.82]), *fast)
    assert np.isnan(found).tolist() == [True, True, False, False, False]


@pytest.mark.parametrize(
    "factors", [(1, 1, 1, 1), (9.4, 3.7, 0.45, 0.3), (0.08, 0.2, 2.6, 5.0), (14.0, 0.1, 0.7, 0.06)]
)
def test_curve_is_its_integral_far_from_the_published_parameters(factors) -> None:
    *own, v0 = published_law("curve", DRY, 100.0).parameters()
    alpha, beta, gamma, R = p = [float(value * factor) for value, factor in zip(own, factors, strict=True)]
    slip = np.linspace(0.0, min(1.0, 0.99 * gamma / v0), 4097)
    rising, falling = curve_force(slip, *p, v0), curve_force(slip[::-1], *p, v0)[::-1]
    np.testing.assert_allclose(falling, rising, rtol=2e-13)
    for i in (1, 2, 40, 700, 4096):
        with mpmath.workdps(40):
            s = mpmath.mpf(float(slip[i] * v0))

            def grown(t, s=s):
                return mpmath.mpf(alpha) * beta / R * (gamma * mpmath.log((gamma - t) / (gamma - s)) - (s - t))

            parts = [s * k / 16 for k in range(17)]
            integral = alpha / R * mpmath.quad(lambda t, grown=grown: t * mpmath.exp(-grown(t)), parts)
        assert (rising[i], falling[i]) == pytest.approx((float(integral),) * 2, rel=2e-13)


def test_beam_closed_form_is_the_integral_of_its_equations() -> None:
    """[Park2008] (10) must be the integral of (6) with (5), (7)-(9); the print with both errors mended is."""
    mu_max, a, Kx = Beam.symbols()
    v, sigma, N = symbol("v"), symbol("sigma"), symbol("N")
    u = Kx * sigma / v / (3 * mu_max * N)
    closed = N * mu_max * (1 - (1 - u) ** 3) - N * a * sigma * (3 * u - 2 * u**2)
    assert sp.simplify(integrated_force() - closed) == 0
    positive = sp.Symbol("sigma_p", positive=True)
    statement = Beam.statement().force.args[0].expr  # the branch |u| <= 1
    assert sp.simplify((statement - closed).subs(sigma, positive)) == 0
    assert sp.simplify(printed_force(width=False, last_factor=sp.Rational(1, 4)) - integrated_force()) == 0


# of alpha and so on: a, a1, a2 and d of Fa = a z + a1 z' + a2 sigma, z' = sigma - d z
DYNAMIC = {
    "dahl": lambda s, alpha, Fc: (alpha, 0.0, 0.0, alpha * s / Fc),
    "bristle": lambda s, alpha, beta, gamma: (alpha, 0.0, 0.0, alpha * s * beta / (gamma - s)),
    "lugre": lambda s, alpha, a1, a2, Fs, Fc, vs: (
        *(alpha, a1, a2, alpha * s / (Fc + (Fs - Fc) * math.exp(-((s / vs) ** 2)))),
    ),
    "tyre_lugre": lambda s, alpha, a1, a2, mu_s, mu_c, vs: (
        *(LOAD * alpha, LOAD * a1, LOAD * a2, alpha * s / (mu_c + (mu_s - mu_c) * math.exp(-math.sqrt(s / vs)))),
    ),
}


@pytest.mark.parametrize("name", DYNAMIC)
def test_dynamic_laws_as_printed(name: str) -> None:
    """(11)-(22); at rest z = sigma/d."""
    functions, p = forces(name)
    for sigma, z in ((0.7, 0.2), (6.0, -0.3)):
        a, a1, a2, d = DYNAMIC[name](sigma, *p[8:])
        rate, at = sigma - d * z, (20.0, sigma, z, 0.0, 0.0, 0.0, p)
        assert functions.rates(*at)[2] == pytest.approx(rate, rel=1e-13)
        assert functions.force(*at) == pytest.approx(a * z + a1 * rate + a2 * sigma, rel=1e-13)
        assert functions.rest_state(20.0, sigma, 0.0, 0.0, 0.0, 0.0, p) == pytest.approx(sigma / d, rel=1e-13)


def printed_polach(law: Polach, slip: float, v: float, load: float) -> float:
    mu = law.mu0 * ((1 - law.A) * math.exp(-law.Bw * abs(slip) * v) + law.A)
    e = law.G * math.pi * law.a * law.b * law.c11 * slip / (4 * load * mu)
    return 2 * mu / math.pi * (law.kA * e / (1 + (law.kA * e) ** 2) + math.atan(law.kS * e))


def printed_burckhardt(law: Burckhardt, slip: float, *_: float) -> float:
    return law.c1 * (1 - math.exp(-law.c2 * slip)) - law.c3 * slip


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize(("name", "printed"), [("polach", printed_polach), ("burckhardt", printed_burckhardt)])
def test_static_laws_as_printed_and_finite(name: str, printed, rail: Rail) -> None:
    law, (functions, p) = published_law(name, rail), forces(name, rail)
    for v in (0.3, V100):
        for slip in (0.0, 1e-9, 1e-4, 0.01, 0.13, 0.6, 1.0):
            for load in (LOAD, 60e3):
                # 1 - exp(-x) of Burckhardt's printed form loses eps absolutely for small x
                expected = pytest.approx(printed(law, slip, v, load), rel=1e-13, abs=4e-16)
                assert adhesion_coefficient(law, v, slip, load) == expected
    for slip in (-50.0, 50.0):  # a wheel that spins backwards at a crawl; warnings of overflow are errors here
        rows = functions.jacobian(0.1, slip * 0.1, 0.0, 0.0, 0.0, 0.0, p)
        assert np.isfinite(np.array(rows, dtype=float)).all()


@pytest.mark.parametrize("surface", sorted(SURFACES))
def test_burckhardt_peak_and_domain_in_closed_form(surface: str) -> None:
    """mu' = 0 at log(c1 c2/c3)/c2."""
    law = Burckhardt(**SURFACES[surface])
    found, slip = peak(law, V100, LOAD), math.log(law.c1 * law.c2 / law.c3) / law.c2
    assert found.slip == pytest.approx(slip, rel=1e-6)  # a flat maximum is found to the root of rounding
    assert found.coefficient == pytest.approx(printed_burckhardt(law, slip), rel=1e-13)
    assert law.domain_limit(V100)[0] > 1.0
    short = Burckhardt(c1=0.3, c2=5.0, c3=0.5)
    limit, _ = short.domain_limit(V100)
    assert 0.0 < limit < 1.0
    assert printed_burckhardt(short, limit) == pytest.approx(0.0, abs=1e-15)  # rounding
    short.check_domain(V100, 0.999 * limit * V100)
    with pytest.raises(DomainError, match="no longer positive"):
        short.check_domain(V100, limit * V100)
    assert Burckhardt(c1=0.3, c2=1.0, c3=0.5).domain_limit(V100)[0] == pytest.approx(0.0, abs=1e-15)  # never positive
    assert Burckhardt(c1=0.05, c2=306.39, c3=0.0).domain_limit(V100)[0] == math.inf


@pytest.mark.parametrize("name", ALL_LAWS)
def test_parameters_are_positive_but_for_some_and_slips_are_from_0_to_1(name: str) -> None:
    law, may_be_nought = sample_law(name), {"beam": "a", "polach": "Bw", "burckhardt": "c3"}
    may_be_nought |= dict.fromkeys(("lugre", "tyre_lugre"), "alpha1 alpha2")
    for key in law.parameter_names():
        for value in (1e-9, 0.0, -1e-9):
            if value > 0.0 or (value == 0.0 and key in may_be_nought.get(name, "").split()):
                assert getattr(type(law)(**{**dict(law), key: value}), key) == value
            else:
                with pytest.raises(ValueError, match=key):
                    type(law)(**{**dict(law), key: value})
    for slip in (-1e-9, 1.0001, math.nan, math.inf):
        with pytest.raises(DomainError, match=r"slip: \S+ is not allowed; .*0 <= slip <= 1"):
            law.check_domain(10.0, np.array([0.1, slip * 10.0]))
    for v in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(DomainError, match="speed"):
            law.check_domain(v, 0.1)


@pytest.mark.parametrize(("name", "factors"), [
    *(("beam", {"mu_max": 0.5}), ("bristle", {"beta": 2.0}), ("curve", {"beta": 2.0}), ("dahl", {"Fc": 0.5})),
    *(("lugre", {"Fs": 0.5, "Fc": 0.5}), ("tyre_lugre", {"mu_s": 0.5, "mu_c": 0.5})),
    *(("polach", {"mu0": 0.5}), ("burckhardt", {"c1": 0.5, "c3": 0.5})),
])  # fmt: skip
def test_a_wet_rail_scales_some_parameters(name: str, factors: dict[str, float]) -> None:
    law = sample_law(name)
    key = law.parameter_names()[0]
    law = law.model_copy(update={key: 1.01 * getattr(law, key)})  # other parameters than those of a published set
    wet = law.wet()
    once, twice = law.weakened(0.5), law.weakened(0.25)
    for each in law.parameter_names():
        assert getattr(once, each) == getattr(wet, each) == factors.get(each, 1.0) * getattr(law, each)
        assert getattr(twice, each) * getattr(law, each) == pytest.approx(getattr(once, each) ** 2)
    assert (wet.rail, wet.wet()) == (WET, wet)  # not halved twice
    with pytest.raises(InputError, match="for wet rail"):
        wet.on(DRY)


@pytest.mark.parametrize("name", ["bristle", "curve", "beam"])
def test_another_wheel_load_keeps_mu(name: str) -> None:
    """This project's assumption for loads the rig did not run."""
    slip, light = np.linspace(0.01, 0.5, 20), published_law(name, DRY).at_wheel_load(0.5 / LOAD)
    at_rig = adhesion_coefficient(published_law(name, DRY), V100, slip, LOAD)
    for law, load in ((published_law(name, DRY, 100.0, 50e3), 50e3), (light, 0.5)):
        np.testing.assert_allclose(adhesion_coefficient(law, V100, slip, load), at_rig, rtol=1e-13)  # rounding
    assert light.parameters() == pytest.approx(published_law(name, DRY, 100.0, 0.5).parameters(), rel=1e-14)


def test_refusals_of_published_laws() -> None:
    assert published_law("bristle", "wet") == published_law("bristle", WET) == published_law("bristle", "dry").on("wet")
    assert law_class("Tyre-LuGre") is law_class("tyre_lugre")
    cases = [((name, DRY), "gives no parameters; .* TOML") for name in sorted(UNPUBLISHED)]
    rig = itertools.product(("beam", "bristle", "curve"), (29.999, 140.001, math.nan))
    cases += [((name, DRY, v0), "30 to 140 km/h") for name, v0 in rig]
    loads = itertools.product(("bristle", "polach"), (0.0, math.inf))
    cases += [((name, DRY, 100.0, load), "wheel load") for name, load in loads]
    for arguments, match in (*cases, (("no such law", DRY), ", ".join(adhesion.law_names()))):
        with pytest.raises(MissingParametersError if "TOML" in match else InputError, match=match):
            published_law(*arguments)


def test_domains_of_bristle_curve_and_beam() -> None:
    v = 140.0 * KMH
    for name in ("bristle", "curve"):  # [Park2008] (32)
        law = published_law(name, DRY, 140.0)
        limit, _ = law.domain_limit(v)
        assert limit == pytest.approx(0.828, abs=THREE_DIGITS)
        law.check_domain(v, 0.8277 * v)
        with pytest.raises(DomainError, match="gamma"):
            law.check_domain(v, limit * v * (1 + 1e-12))  # beyond rounding
    beam = published_law("beam", WET, 140.0)
    assert beam.domain_limit(v)[0] == pytest.approx(0.113 / (0.0013 * 140.0), rel=1e-12)  # mu_max/(a v), rounding
    with pytest.raises(DomainError, match="no longer positive"):
        beam.check_domain(v, 0.7 * v)
    assert Beam(mu_max=0.2, a=0.0, Kx=1e5).domain_limit(10.0)[0] == math.inf
    # a peak is looked for within the domain, to its very end
    assert peak(LookupTable(slip=(0.1, 0.5), mu=(0.1, 0.2)), V100, LOAD).slip == pytest.approx(0.5, abs=1e-7)


def test_table_is_pchip_through_the_origin_odd_half_on_wet_rail_and_ends_with_its_last_knot() -> None:
    table = LookupTable(slip=(0.02, 0.05, 0.1, 0.2, 0.5), mu=(0.12, 0.22, 0.25, 0.23, 0.19))
    slip, knots = np.linspace(0.0, 0.5, 301), table.parameters()
    expected = PchipInterpolator([0.0, *table.slip], [0.0, *table.mu])(slip)
    assert adhesion_coefficient(table, 20.0, slip, LOAD) == pytest.approx(expected, rel=1e-14)
    assert table_force(-slip, LOAD, knots) == pytest.approx(-LOAD * expected)
    assert np.isnan(table_force(0.51, LOAD, knots))
    assert peak(table, 20.0, LOAD).slip == pytest.approx(0.1, rel=1e-6)
    for one in (0.0, 0.013, 0.04, 0.13, 0.33):
        difference = (table_force(one + 1e-6, LOAD, knots) - table_force(one - 1e-6, LOAD, knots)) / 2e-6
        # at 0 the odd curve has the second derivative's jump, which is 1e-5 of the slope over h
        assert table_slope(one, LOAD, knots) == pytest.approx(difference, rel=1e-5) == table_slope(-one, LOAD, knots)
    p = plant_parameters(table, PARK2008)
    gradient = numeric_plant(LookupTable).force_and_gradient(20.0, 2.6, 0.0, 0.0, 0.0, 0.0, p)
    slope = table_slope(0.13, PARK2008.wheel_load, knots)
    assert gradient[1:3] == pytest.approx((-slope * 0.13 / 20.0, slope / 20.0))
    wet = table.on(WET)
    assert wet.mu == tuple(mu / 2 for mu in table.mu)
    assert wet.on(WET) is wet
    with pytest.raises(InputError, match=r"adhesion 'table': .*factor of 0\.5"):
        table.weakened(0.5)
    with pytest.raises(DomainError, match=r"stay below slip 0\.5$"):
        adhesion_coefficient(table, 20.0, 0.500001, LOAD)
    whole = LookupTable(slip=(0.1, 0.2, 1.0), mu=(0.2, 0.15, 0.1))
    assert adhesion_coefficient(whole, 20.0, 1.0, LOAD) == pytest.approx(0.1)
    assert math.isinf(whole.domain_limit(20.0)[0])


LUGRE = """
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
SLIPS = "dry = 0.13\nwet = 0.09"
OVER = f"polynomials.Fc = [6000, -10]\ninitial_speed_range = [30, 140]\n{LUGRE.replace('Fc = 6000', '')}"


REFUSED_TABLES = [
    *(("slip = [0.1, 1.2]\nmu = [0.1, 0.2]", "slip"), ("slip = [-0.1, 0.2]\nmu = [0.1, 0.2]", "slip")),
    *(("slip = [0.1]\nmu = [0.1]", "slip"), ("slip = [0.1, 0.2, 0.3]\nmu = [0.1, 0.2]", "mu")),
    *(("slip = [0.1, 0.2]\nmu = [0.1, -0.2]", "mu"), ("slip = [0.0, 0.2]\nmu = [0.1, 0.2]", "mu")),
]


def test_laws_from_files(file) -> None:
    law = load_law(file("law.toml", LUGRE))
    # order of the law's fields; 10.3 kN and 17 km/h converted, left-out damping 0
    assert law.parameters() == pytest.approx((2.0e4, 0.0, 0.0, 10_300.0, 6000.0, 17 / 3.6), rel=1e-14)
    assert law.reference == ReferenceSlip(dry=0.13, wet=0.09)
    for v0, Fc in ((30.0, 5700.0), (100.0, 5000.0), (140.0, 4600.0)):  # the ends of its range too
        assert load_law(file("law.toml", OVER), initial_speed_kmh=v0).Fc == Fc
    only_wet = 'law = "dahl"\ncondition = "wet"\nparameters = {alpha = 1e4, Fc = 5e3}\nreference_slip.wet = 0.05'
    wet = load_law(file("law.toml", only_wet))
    assert (wet.reference_slip(WET), wet.on(WET).parameters()) == (0.05, (1e4, 5e3))
    over = LUGRE.replace(SLIPS, "initial_speed = [30, 140]\ndry = [0.1, 0.2]\nwet = [0.1, 0.1]")
    with pytest.raises(InputError, match=r"reference_slip .*initial speed.*\(km/h\)"):
        load_law(file("law.toml", over))
    assert load_law(file("law.toml", over), initial_speed_kmh=85.0).reference_slip(DRY) == pytest.approx(0.15)
    text = 'law = "table"\n[parameters]\nslip = [0.02, "10 %"]\nmu = [0.1, 0.2]'
    assert load_law(file("law.toml", text)).slip == (0.02, 0.1)


@pytest.mark.parametrize(("old", "new", "message"), [
    ('law = "lugre"', "", "law: missing; give it"),
    ('law = "lugre"', 'law = "hunt"', "law: adhesion: 'hunt' is not a law"),
    ('law = "lugre"', 'law = "lugre"\ncondition = "icy"', "condition: 'icy' is not allowed"),
    ('law = "lugre"', 'law = "lugre"\nwheel_load = -3', "wheel_load: -3 is not allowed; give a value > 0 (N)"),
    ("alpha = 2.0e4", "", "parameters: alpha: missing; give it (N/m)"),
    ("alpha = 2.0e4", "alpha = -1", "parameters: alpha: -1 is not allowed; give a value > 0 (N/m)"),
    ("alpha = 2.0e4", 'alpha = 2.0e4\nrail = "wet"', "parameters.rail: unknown key"),
    ("dry = 0.13", "dry = 1.3", "reference_slip: dry: 1.3 is not allowed; give a value < 1"),
    ("dry = 0.13", "icy = 0.13", "reference_slip: icy: unknown key"),
    (SLIPS, "initial_speed = [30, 140]\ndry = 0.13\nwet = [1, 1]", "reference_slip: dry: 0.13 is not allowed; give a"),
    (SLIPS, "initial_speed = [30, 140]\ndry = [1]\nwet = [1, 1]", "reference_slip: dry, wet: 1 and 2 slips for 2"),
    (SLIPS, "initial_speed = [30, 30]\ndry = [1, 1]\nwet = [1, 1]", "reference_slip: initial_speed: "),
    *((LUGRE, f'law = "table"\n[parameters]\n{lists}', f"parameters: {told}: ") for lists, told in REFUSED_TABLES),
    (LUGRE, 'law = "lugre"\nparameters = 3', "parameters: 3 is not allowed; give a table"),
    (LUGRE, OVER.replace("[6000, -10]", "6000"), "polynomials: Fc: 6000 is not allowed; give a list"),
    (LUGRE, OVER.replace("[6000, -10]", "[]"), "polynomials: Fc: a list is not allowed; give a list"),
    (LUGRE, OVER.replace("-10", "true"), "polynomials: Fc: True is not a number"),
    (LUGRE, OVER.replace("[30, 140]", "[30, 90]"), "initial speed: 100 km/h is outside 30 to 90"),
    *((LUGRE, OVER.replace("[30, 140]", ends), "initial_speed_range: ") for ends in ("[140, 30]", "[30]", '"30"')),
])  # fmt: skip
def test_bad_files_get_one_clear_line(file, old: str, new: str, message: str) -> None:
    path = file("law.toml", LUGRE.replace(old, new))
    with pytest.raises(InputError) as caught:
        load_law(path, initial_speed_kmh=100.0)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert str(caught.value).isprintable()


PARAMETERS = "[parameters]\nc1 = 0.3\nc2 = 30.0\nc3 = 0.2\n"
BOTH = "[reference_slip]\ndry = 0.1\nwet = 0.1\n"
OVER_V0 = (
    'law = "burckhardt"\ninitial_speed_range = [30, 140]\n[polynomials]\nc1 = [0.4, -1e-3]\nc2 = [30]\nc3 = [0.2]\n'
)

BEAM = """law = "beam"
[parameters]
mu_max = 0.3
a = 0.004
Kx = "300 kN"
[reference_slip]
dry = 0.1
wet = 0.07
"""

LAW = f"""{recipe("kalker.py")}
from railslip_ctrl.model.adhesion import ReferenceSlip

LAW = Kalker(friction=0.3, creep=20.0, reference=ReferenceSlip(dry=0.02, wet=0.01))
"""


AT = {"linearize": ("--speed", "20", "--rail", "dry"), "derive": ("--format", "c"), "margins": ("--speed", "20")}


@pytest.mark.parametrize("command", AT)
def test_a_law_of_another_v0_or_over_v0_is_told_in_every_command(railslip, file, command):
    slow = ("--adhesion", file("slow.toml", f'law = "burckhardt"\ninitial_speed_range = [28, 30]\n{PARAMETERS}{BOTH}'))
    assert (adhesion.initial_speeds_in(slow[1]), adhesion.is_over_initial_speed(slow[1])) == ((28.0, 30.0), False)
    status, _, err = railslip(command, *slow, *AT[command])
    facts = re.search(r"slow\.toml .*\bv0 of 28 to 30 km/h .*\b100 km/h", err) is not None
    assert (status in (0, 1), err.count("\n"), facts) == (True, 1, True)  # once, whatever the number of rails
    assert "v0" not in railslip(command, *slow, "--initial-speed", "32", *AT[command])[2]  # within a tenth

    over = ("--adhesion", file("over.toml", OVER_V0 + BOTH))
    assert adhesion.is_over_initial_speed(over[1])
    status, _, err = railslip(command, *over, *AT[command])
    assert re.search(r"over\.toml .*\bv0\b.*\b100 km/h.*; give --initial-speed", err)
    assert status in (0, 1)
    assert "v0" not in railslip(command, *over, "--initial-speed", "100", *AT[command])[2]
    assert "outside 30 to 140" in refused(railslip(command, *over, "--initial-speed", "160", *AT[command]))


def test_a_law_found_at_another_wheel_load_is_told(railslip, file):
    name = file("heavy.toml", BEAM.replace("[parameters]", 'wheel_load = "50 kN"\n[parameters]'))
    assert adhesion.wheel_load_in(name) == 50e3
    assert re.search(r"wheel load of 50000 N .*\b34500 N", railslip("linearize", "--adhesion", name)[2])


def test_a_law_without_a_reference_slip_is_refused_alike(railslip, file):
    law = file("bare.toml", f'law = "burckhardt"\n{PARAMETERS}')
    for command in ("linearize", "margins", "tune --ms-max 2", "verify --law predictive", "simulate"):
        told = refused(railslip(*command.split(), "--adhesion", law))
        assert re.search(r"--slip: .*'(bare.toml|burckhardt)' has no reference slip", told)
    assert "--slip: adhesion 'polach' has no reference slip" in refused(railslip("simulate", "--adhesion", "polach"))
    for given, slips in ((("--slip", "0.1"), (0.1, 0.1)), (("--gains", "beam"), (0.119, 0.059))):
        status, out, _ = railslip("simulate", "--adhesion", law, *given, "--no-noise", "--json")
        assert (status, json.loads(out)["reference_slip"]) == (0, dict(zip(("dry", "wet"), slips, strict=True)))


def test_a_law_of_one_s_own_in_a_python_file(railslip, file, monkeypatch):
    """Its force by hand, and its one pole, which is its slope there: 0 where it has reached mu."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)  # nor is a text taken for one of its length and second
    name = file("mine.py", LAW)
    poles = []
    for slip in ((), ("--slip", "0.5")):
        status, out, err = railslip("linearize", "--adhesion", name, "--rail", "dry", *slip, "--json")
        assert (status, err) == (0, "")
        found = json.loads(out)["cases"][0]
        poles.append(found["poles"][0][0])
        if not slip:
            assert (found["adhesion"], found["slip"]) == ("kalker", 0.02)
            assert found["adhesion_force_n"] == pytest.approx(34500 * 0.3 * math.tanh(4 / 3), rel=1e-12)  # rounding
    slopes = [20.0 * 34_500 / math.cosh(20.0 * slip / 0.3) ** 2 / (100 / 3.6) for slip in (0.02, 0.5)]
    expected = [-(1 / 3517 + 0.43**2 / 60.35) * slope - 0.25 / 60.35 for slope in slopes]
    assert poles == pytest.approx(expected, rel=1e-12)
    assert f"--adhesion: {name}: " in refused(railslip("derive", "--adhesion", name))
    assert "no such file" in refused(railslip("linearize", "--adhesion", "none.py"))
    for text, told in (
        ("LAW = 3\n", ": LAW has no statement, parameters"),
        ("law = 3\n", ": has no LAW"),
        ("1/0\n", ", line 1: running it fails with ZeroDivisionError: division by zero; "),
        (f"{LAW}LAW = Kalker\n", ": LAW is "),
    ):
        assert f"--adhesion: other.py{told}" in refused(railslip("linearize", "--adhesion", file("other.py", text)))
    text = "from railslip_ctrl.model.adhesion.burckhardt import Burckhardt\nLAW = Burckhardt(c1=0.3, c2=30.0, c3=0.2)\n"
    assert load_law(file("set.py", text)) == Burckhardt(c1=0.3, c2=30.0, c3=0.2)
    assert load_law("set.py") == load_law(file("set.toml", f'law = "burckhardt"\n{PARAMETERS}'))


ASKED = {
    "linearize": ("--rail", "dry"),
    "margins": ("--rail", "dry", "--kp", "190", "--ki", "5"),
    "tune": ("--rail", "dry", "--minimise-ms", "--ki-min", "5"),
    "simulate": ("--no-noise", "--controller", "pi-lead"),
}


@pytest.mark.parametrize("command", [pytest.param(x, marks=[pytest.mark.long] * (x == "tune")) for x in ASKED])
def test_text_and_json_tell_a_file_s_law_from_the_published_one(railslip, file, command):
    def adhesion_law(law):
        found = json.loads(railslip(command, "--adhesion", law, *ASKED[command], "--json")[1])
        return found.get("cases", [found])[0]["adhesion_law"]

    def text(law):
        return " ".join(railslip(command, "--adhesion", law, *ASKED[command])[1].split())

    file("model.toml", BEAM)
    values = {"mu_max": (0.3, "1"), "a": (0.004, "s/m"), "Kx": (300e3, "N")}
    parameters = {name: {"value": value, "unit": unit} for name, (value, unit) in values.items()}
    mine = {"name": "beam", "source": "model.toml", "rail": "dry", "parameters": parameters}
    assert adhesion_law("model.toml") == mine
    assert "beam as given (model.toml)" in text("model.toml")
    one = adhesion_law("beam")
    assert (one["name"], one["source"]) == ("beam", "published")
    assert one["parameters"]["mu_max"]["value"] == 0.261  # [Park2008] Table 1, at 100 km/h
    assert ("beam" in text("beam"), "as given" in text("beam")) == (True, False)


def test_a_published_law_with_a_number_changed_is_told_as_given():
    beam = published_law("beam", "dry")
    laws = (beam.model_copy(update={"mu_max": 0.3}), beam)
    points = [operating_point(law, PARK2008, 20.0, 0.05) for law in laws]
    assert [source_at(point) for point in points] == ["given", "published"]
    assert case_title(points[0]).startswith("beam as given, dry rail, 72 km/h")


@pytest.mark.parametrize("command", ["linearize", "margins", "tune", "report", "simulate", "verify"])
def test_a_wet_log_s_law_asks_for_wet_rail_by_its_option(railslip, file, command):
    name = file("fitted.toml", BEAM.replace("[parameters]", 'condition = "wet"\n[parameters]'))
    more = {"tune": ASKED["tune"][2:], "verify": ("--law", "predictive"), "report": ("--out", "never")}.get(command, ())
    told = refused(railslip(command, "--adhesion", name, *more))
    assert told.startswith("railslip: error: --adhesion 'beam' of fitted.toml: its parameters are for wet rail")
    assert "wet rail" in told.partition(";")[2]
    if command in ASKED:
        assert railslip(command, "--adhesion", name, *more, "--rail", "wet")[0] in (0, 1)
