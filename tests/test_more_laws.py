"""Polach, Burckhardt, Curtius-Kniffler, the table: published values, closed forms, their way through the package."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import sympy as sp
from project import refused
from scipy.interpolate import PchipInterpolator

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw, law_class, law_names, load_law, published_law
from railslip_ctrl.model.adhesion.base import curtius_kniffler
from railslip_ctrl.model.adhesion.burckhardt import SURFACES, Burckhardt
from railslip_ctrl.model.adhesion.polach import Polach
from railslip_ctrl.model.adhesion.table import Table, table_force, table_slope
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import adhesion_coefficient, numeric_plant, peak, plant_parameters
from railslip_ctrl.model.vehicle import PARK2008, Rail

LOAD = 34_500.0
V100 = 100.0 * KMH
LAWS = ("burckhardt", "polach")

# Published and tabulated values hold to their printed digits: half a unit of the last one.
FIVE_DIGITS = 0.5e-5
FOUR_DIGITS = 0.5e-4


def printed_polach(law: Polach, slip: float, v: float, load: float) -> float:
    """Force, N, as the source prints it."""
    mu = law.mu0 * ((1 - law.A) * math.exp(-law.Bw * abs(slip) * v) + law.A)
    e = law.G * math.pi * law.a * law.b * law.c11 * slip / (4 * load * mu)
    return 2 * load * mu / math.pi * (law.kA * e / (1 + (law.kA * e) ** 2) + math.atan(law.kS * e))


def printed_burckhardt(law: Burckhardt, slip: float) -> float:
    """Coefficient as printed, made odd."""
    s = abs(slip)
    return math.copysign(law.c1 * (1 - math.exp(-law.c2 * s)) - law.c3 * s, slip)


def polach(rail: Rail = Rail.DRY) -> Polach:
    law = published_law("polach", rail)
    assert isinstance(law, Polach)
    return law


def burckhardt(rail: Rail = Rail.DRY) -> Burckhardt:
    law = published_law("burckhardt", rail)
    assert isinstance(law, Burckhardt)
    return law


# --- published values ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rail", "slip", "mu"),
    [(Rail.DRY, 0.01, 0.42182), (Rail.DRY, 0.1, 0.27965), (Rail.WET, 0.01, 0.19947), (Rail.WET, 0.1, 0.21584)],
)
def test_polach_oracle_coefficients(rail: Rail, slip: float, mu: float) -> None:
    assert adhesion_coefficient(polach(rail), V100, slip, LOAD) == pytest.approx(mu, abs=FIVE_DIGITS)


@pytest.mark.parametrize(("rail", "slip", "mu"), [(Rail.DRY, 0.0142, 0.42778), (Rail.WET, 0.0388, 0.23867)])
def test_polach_oracle_peaks(rail: Rail, slip: float, mu: float) -> None:
    found = peak(polach(rail), V100, LOAD)
    assert found.slip == pytest.approx(slip, abs=FOUR_DIGITS)
    assert found.coefficient == pytest.approx(mu, abs=FIVE_DIGITS)


def test_burckhardt_oracle_peak_on_wet_asphalt() -> None:
    found = peak(burckhardt(Rail.WET), V100, LOAD)
    assert found.slip == pytest.approx(0.13069, abs=FIVE_DIGITS)
    assert found.coefficient == pytest.approx(0.80391, abs=FIVE_DIGITS)


@pytest.mark.parametrize("surface", sorted(SURFACES))
def test_burckhardt_peak_in_closed_form(surface: str) -> None:
    """mu' = 0 at log(c1 c2/c3)/c2."""
    law = Burckhardt(**SURFACES[surface])
    found = peak(law, V100, LOAD)
    slip = math.log(law.c1 * law.c2 / law.c3) / law.c2
    assert found.slip == pytest.approx(slip, rel=1e-6)  # a flat maximum is found to the root of rounding
    assert found.coefficient == pytest.approx(printed_burckhardt(law, slip), rel=1e-13)


def test_curtius_kniffler_oracle() -> None:
    assert curtius_kniffler(V100) == pytest.approx(0.21308, abs=FIVE_DIGITS)
    assert curtius_kniffler(0.0) == pytest.approx(7.5 / 44.0 + 0.161, rel=1e-15)
    assert np.shape(curtius_kniffler(V100)) == ()
    many = curtius_kniffler(np.array([[0.0, 10.0], [20.0, V100]]))
    assert many.shape == (2, 2)
    assert many[1, 1] == curtius_kniffler(V100)
    assert np.all(np.diff(many.ravel()) < 0.0)


@pytest.mark.parametrize("speed", [-1e-9, math.nan, math.inf, [1.0, -1.0]])
def test_curtius_kniffler_wants_a_speed(speed: float | list[float]) -> None:
    with pytest.raises(DomainError, match="speed"):
        curtius_kniffler(speed)


def test_curtius_kniffler_is_no_law() -> None:
    assert set(LAWS) <= set(law_names())
    assert "envelope" not in law_names()


# --- the statements ------------------------------------------------------------------------------------------------

SLIPS = (0.0, 1e-9, 1e-4, 0.01, 0.13, 0.6, 1.0)


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize("v", [0.3, 10.0, V100])
@pytest.mark.parametrize("load", [LOAD, 60e3])
def test_statements_are_the_printed_formulas(rail: Rail, v: float, load: float) -> None:
    for slip in SLIPS:
        expected = printed_polach(polach(rail), slip, v, load) / load
        assert adhesion_coefficient(polach(rail), v, slip, load) == pytest.approx(expected, rel=1e-13)
        expected = printed_burckhardt(burckhardt(rail), slip)
        # 1 - exp(-x) of the printed form loses eps absolutely for small x
        assert adhesion_coefficient(burckhardt(rail), v, slip, load) == pytest.approx(expected, rel=1e-13, abs=4e-16)


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize("name", LAWS)
def test_odd_in_slip(name: str, rail: Rail) -> None:
    law = published_law(name, rail)
    p = plant_parameters(law, PARK2008)
    force = numeric_plant(type(law)).force
    for slip in SLIPS:
        for v in (0.5, V100):
            assert force(v, -slip * v, 0.0, 0.0, 0.0, 0.0, p) == -force(v, slip * v, 0.0, 0.0, 0.0, 0.0, p)


@pytest.mark.parametrize("slip", [-50.0, 50.0])
@pytest.mark.parametrize("name", LAWS)
def test_numbers_stay_finite_far_outside(name: str, slip: float) -> None:
    """A wheel that spins backwards at a crawl; warnings of overflow are errors here."""
    law = published_law(name, Rail.DRY)
    p, v = plant_parameters(law, PARK2008), 0.1
    rows = numeric_plant(type(law)).jacobian(v, slip * v, 0.0, 0.0, 0.0, 0.0, p)
    assert np.isfinite(np.array(rows, dtype=float)).all()


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("slip", [-0.3, -0.01, 0.004, 0.0142, 0.13, 0.5, 0.95])
def test_jacobian_by_central_differences(name: str, rail: Rail, slip: float) -> None:
    law = published_law(name, rail)
    functions, p = numeric_plant(type(law)), plant_parameters(law, PARK2008)
    state = np.array([V100, slip * V100, 0.0, 4000.0])

    def rates(x: np.ndarray) -> np.ndarray:
        return np.array(functions.rates(*x, 0.0, 0.0, p), dtype=float)

    analytic = np.array(functions.jacobian(*state, 0.0, 0.0, p), dtype=float)
    for column, step in enumerate((1e-3, 1e-5, 1e-3, 1.0)):
        shift = step * np.eye(4)[column]
        difference = (rates(state + shift) - rates(state - shift)) / (2 * step)
        # truncation: step^2/6 times the third derivative, at most 1e-5 of the slope; rounding eps*1e2/1e-5
        np.testing.assert_allclose(analytic[:, column], difference, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("rail", Rail)
def test_slip_0_is_no_kink(rail: Rail) -> None:
    """Both laws have the same slope from both sides; of the Polach model it does not depend on mu."""
    law = polach(rail)
    stiffness = (law.kA + law.kS) / 2 * law.G * law.a * law.b * law.c11
    tyre = burckhardt(rail)
    for each, slope in ((law, stiffness), (tyre, LOAD * (tyre.c1 * tyre.c2 - tyre.c3))):
        assert each.kinks(V100, LOAD) == ()
        plant = linearize(operating_point(each, PARK2008, V100, 0.0))
        expected = -(1 / 3517 + 0.43**2 / 60.35) * slope / V100 - 0.25 / 60.35  # system.md, section 2
        assert plant.poles[0].real == pytest.approx(expected, rel=1e-12)  # rounding
        p, h = plant_parameters(each, PARK2008), 1e-7 * V100
        force = numeric_plant(type(each)).force
        for side in (-h, h):  # one-sided: the slope has changed by some 1e-5 of itself at most
            assert force(V100, side, 0.0, 0.0, 0.0, 0.0, p) / side == pytest.approx(slope / V100, rel=1e-5)


# --- parameter sets ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LAWS)
def test_published_sets_know_no_initial_speed_but_want_a_load(name: str) -> None:
    for rail in Rail:
        law = published_law(name, rail)
        assert (law.rail, law.reference_slip(rail)) == (rail, None)
        assert published_law(name, rail, 250.0) == law
    for load in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(InputError, match="wheel load"):
            published_law(name, Rail.DRY, 100.0, load)


@pytest.mark.parametrize("name", LAWS)
def test_published_dry_law_becomes_the_published_wet_one(name: str) -> None:
    dry, wet = published_law(name, Rail.DRY), published_law(name, Rail.WET)
    assert dry.wet() == wet == dry.on(Rail.WET)
    assert wet.wet() is wet
    with pytest.raises(InputError, match="for wet rail"):
        wet.on(Rail.DRY)


@pytest.mark.parametrize(
    "law",
    [Polach(kA=0.9, kS=0.4, mu0=0.5, A=0.4, Bw=0.6, a=5e-3), Burckhardt(**SURFACES["snow"])],
    ids=lambda law: law.name,
)
def test_wet_rail_halves_the_coefficients_of_other_parameters(law: AdhesionLaw) -> None:
    wet = law.wet()
    assert wet.rail is Rail.WET
    for key in law.parameter_names():
        assert getattr(wet, key) == getattr(law, key) * law.wet_factors.get(key, 1.0)
    # far beyond the peak mu itself; the Polach model gets there as arctan does, by e
    ratio = adhesion_coefficient(wet, V100, 0.99, LOAD) / adhesion_coefficient(law, V100, 0.99, LOAD)
    assert ratio == pytest.approx(0.5, rel=0.03)


def test_user_parameters_from_a_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "law.toml"
    file.write_text(
        'law = "polach"\n[parameters]\nkA = 1\nkS = 0.4\nmu0 = 0.55\nA = 0.4\nBw = "0.6 s/m"\n'
        'G = "84 GPa"\na = "6 mm"\nb = "6 mm"\n[reference_slip]\ndry = 0.014\nwet = 0.038\n'
    )
    law = load_law(file)
    assert law.parameters() == pytest.approx(polach().parameters(), rel=1e-14)
    assert law.on(Rail.WET).parameters()[:5] == (0.3, 0.1, 0.30, 0.4, 0.2)
    assert law.on(Rail.WET).reference_slip(Rail.WET) == 0.038


@pytest.mark.parametrize("surface", sorted(SURFACES))
def test_burckhardt_sets_hold_up_to_the_locked_wheel(surface: str) -> None:
    law = Burckhardt(**SURFACES[surface])
    assert law.domain_limit(V100)[0] > 1.0
    assert adhesion_coefficient(law, V100, 1.0, LOAD) > 0.0


def test_burckhardt_coefficient_must_stay_positive() -> None:
    law = Burckhardt(c1=0.3, c2=5.0, c3=0.5)
    limit, _ = law.domain_limit(V100)
    assert 0.0 < limit < 1.0
    assert printed_burckhardt(law, limit) == pytest.approx(0.0, abs=1e-15)  # rounding
    with pytest.raises(DomainError, match="no longer positive"):
        law.check_domain(V100, limit * V100)
    law.check_domain(V100, 0.999 * limit * V100)
    assert Burckhardt(c1=0.3, c2=1.0, c3=0.5).domain_limit(V100)[0] == pytest.approx(0.0, abs=1e-15)  # never positive
    assert Burckhardt(c1=0.05, c2=306.39, c3=0.0).domain_limit(V100)[0] == math.inf


# --- through the package -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize("name", LAWS)
def test_linearize_gives_the_pole_of_a_static_law(name: str, rail: Rail) -> None:
    law, slip, h = published_law(name, rail), 0.05, 1e-6
    plant = linearize(operating_point(law, PARK2008, V100, slip))
    assert plant.states == ("sigma",)
    high, low = (adhesion_coefficient(law, V100, s, LOAD) for s in (slip + h, slip - h))
    slope = LOAD * (high - low) / (2 * h * V100)
    expected = -(1 / 3517 + 0.43**2 / 60.35) * slope - 0.25 / 60.35
    assert plant.poles[0].real == pytest.approx(expected, rel=1e-6)  # truncation h^2 and rounding eps/h
    assert not numeric_plant(law_class(name)).generated_in_memory


@pytest.mark.parametrize("name", LAWS)
def test_command_linearize_json(name: str, railslip) -> None:
    status, out, err = railslip("linearize", "--adhesion", name, "--slip", "0.05", "--json")
    assert (status, err) == (0, "")
    cases = json.loads(out)["cases"]
    assert [case["rail"] for case in cases] == ["dry", "wet"]
    for case in cases:
        law = published_law(name, Rail(case["rail"]))
        assert (case["adhesion"], case["slip"], case["states"]) == (name, 0.05, ["sigma"])
        mu = adhesion_coefficient(law, V100, 0.05, LOAD)
        assert case["adhesion_force_n"] == pytest.approx(LOAD * mu, rel=1e-13)
        expected = linearize(operating_point(law, PARK2008, V100, 0.05)).poles[0].real
        assert case["poles"][0][0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_command_wants_a_slip(name: str, railslip) -> None:
    status, out, err = railslip("linearize", "--adhesion", name)
    assert (status, out) == (2, "")
    assert "give --slip X" in err


# --- the table law -------------------------------------------------------------------------------------------------

TABLE = Table(slip=(0.02, 0.05, 0.1, 0.2, 0.5), mu=(0.12, 0.22, 0.25, 0.23, 0.19))
V = 20.0


def test_table_is_pchip_through_the_origin_and_odd():
    slip = np.linspace(0.0, 0.5, 301)
    expected = PchipInterpolator([0.0, *TABLE.slip], [0.0, *TABLE.mu])(slip)
    assert adhesion_coefficient(TABLE, V, slip, LOAD) == pytest.approx(expected, rel=1e-14)
    assert table_force(-slip, LOAD, TABLE.parameters()) == pytest.approx(-LOAD * expected)
    assert np.isnan(table_force(0.51, LOAD, TABLE.parameters()))
    assert adhesion_coefficient(TABLE, V, np.array(TABLE.slip), LOAD) == pytest.approx(TABLE.mu, rel=1e-14)
    assert np.all(np.diff(expected[slip <= 0.1]) > 0.0)  # no overshoot between knots
    assert np.all(np.diff(expected[slip >= 0.1]) < 0.0)
    assert peak(TABLE, V, LOAD).slip == pytest.approx(0.1, rel=1e-6)


def test_table_slope_against_differences_and_the_jacobian():
    for slip in (0.0, 0.013, 0.04, 0.13, 0.33):
        h = 1e-6
        difference = table_force(slip + h, LOAD, TABLE.parameters()) - table_force(slip - h, LOAD, TABLE.parameters())
        # at 0 the odd curve has the second derivative's jump, which is 1e-5 of the slope over h
        assert table_slope(slip, LOAD, TABLE.parameters()) == pytest.approx(difference / (2 * h), rel=1e-5)
        assert table_slope(-slip, LOAD, TABLE.parameters()) == table_slope(slip, LOAD, TABLE.parameters())
    functions, p = numeric_plant(Table), plant_parameters(TABLE, PARK2008)
    assert not functions.generated_in_memory
    gradient = functions.force_gradient(V, 0.13 * V, 0.0, 0.0, 0.0, 0.0, p)
    slope = table_slope(0.13, PARK2008.wheel_load, TABLE.parameters())
    assert gradient[1] == pytest.approx(slope / V)
    assert gradient[0] == pytest.approx(-slope * 0.13 / V)


def test_table_linearizes_like_the_law_it_tabulates():
    law = law_class("burckhardt").model_validate({"c1": 0.31, "c2": 24.0, "c3": 0.11})
    slips = np.linspace(0.0, 1.0, 400) ** 2
    table = Table(slip=tuple(slips), mu=tuple(np.asarray(adhesion_coefficient(law, V, slips, LOAD))))
    (pole,), (expected,) = (linearize(operating_point(each, PARK2008, V, 0.2)).poles for each in (table, law))
    assert pole == pytest.approx(expected, rel=1e-3)  # slopes of PCHIP are of second order in the spacing


def test_table_statement_differentiates_to_its_slope():
    force = Table.statement().force
    name = type(sp.diff(force, sp.Symbol("sigma", real=True)).atoms(sp.Function).pop()).__name__
    assert name == "TableSlope"


def test_table_on_wet_rail_is_half():
    wet = TABLE.on(Rail.WET)
    assert wet.mu == tuple(mu / 2 for mu in TABLE.mu)
    assert wet.on(Rail.WET) is wet


def test_table_ends_with_its_last_knot():
    with pytest.raises(DomainError, match="its table ends there"):
        adhesion_coefficient(TABLE, V, 0.500001, LOAD)
    assert adhesion_coefficient(TABLE, V, 0.5, LOAD) == pytest.approx(0.19)
    whole = Table(slip=(0.1, 0.2, 1.0), mu=(0.2, 0.15, 0.1))
    assert adhesion_coefficient(whole, V, 1.0, LOAD) == pytest.approx(0.1)
    assert math.isinf(whole.domain_limit(V)[0])


def test_table_from_a_file(railslip, tmp_path):
    path = tmp_path / "law.toml"
    path.write_text('law = "table"\n[parameters]\nslip = [0.02, "10 %", 0.5]\nmu = [0.12, 0.25, 0.19]\n')
    assert load_law(path).slip == (0.02, 0.1, 0.5)
    status, out, _ = railslip("linearize", "--adhesion", path, "--slip", "0.05", "--rail", "dry", "--json")
    assert status == 0
    assert json.loads(out)["cases"][0]["adhesion"] == "table"


@pytest.mark.parametrize(
    ("slip", "mu", "words"),
    [
        ("[0.1, 0.1]", "[0.1, 0.2]", "rise strictly"),
        ("[0.1, 1.2]", "[0.1, 0.2]", "from 0 to 1"),
        ("[-0.1, 0.2]", "[0.1, 0.2]", "from 0 to 1"),
        ("[0.1, 0.2, 0.3]", "[0.1, 0.2]", "2 values for 3 slip ratios"),
        ("[0.1, 0.2]", "[0.1, -0.2]", ">= 0"),
        ("[0.0, 0.2]", "[0.1, 0.2]", "no adhesion without slip"),
        ("[0.1]", "[0.1]", "at least 2"),
        ('[0.1, "2 kg"]', "[0.1, 0.2]", "dimension"),
        ('"steep"', "[0.1, 0.2]", "give a list"),
        ("[0.1, nan]", "[0.1, 0.2]", "finite"),
    ],
)
def test_tables_that_are_refused(railslip, tmp_path, slip, mu, words):
    path = tmp_path / "law.toml"
    path.write_text(f'law = "table"\n[parameters]\nslip = {slip}\nmu = {mu}\n')
    assert words in refused(railslip("linearize", "--adhesion", path, "--slip", "0.05"))
