"""The errata: which printed equations and numbers follow, and the sizes of those that do not."""

from __future__ import annotations

import pytest
import sympy as sp

from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import beam
from railslip_ctrl.paper import printed
from railslip_ctrl.paper.errata import Erratum, compared, errata, random_disturbance
from railslip_ctrl.sliding.derivation import derive

AGREE = {
    *("(24) with brackets", "(28) = (27)", "(35)", "(36)", "(37)", "(41)", "(42)", "(43)"),
    *("(44), theta_2", "(45)", "(46)", "(47) with (45)"),
}

SIZES = {
    "(6)": ("0.019 times", "274360 N", "8e+10 Pa"),
    "(10)": ("printed -120 N, derived 271 N", "0.0985", "0.500 of the force"),
    "(22)-(24)": ("11297 N", "negative"),
    "(27)": ("a share of 1 is in Ta_hat at once; filtered as a whole, 0",),
    "(38)-(39) with (41)": ("same sign", "140.3"),
    "F_r in (4) and (35)": ("0.123 m/s^2", "486 N", "0.138 m/s^2"),
    "(44), theta_1": ("3517 -> 5276 kg", "+1.322e-03", "-2.205e-04", "other sign, 6.00 times"),
    "(47)-(48)": ("same sign", "140.3 times too large"),
    "(49)": ("k1 in s**2/(kg**2*m**4), k2 in 1",),
    "p. 54, invariant set theorem": ("one equation for two errors", "0.0893 m^2/s^2", "25 s"),
    "(40) with Table 4": ("K0 = (r/J) K = 0.499", "1.581", "3.2 times", "27.6 m/s of 27.8 m/s", "75.2 m/s", "977 N*m"),
    "B = 0.25 - 0.01 t": ("zero at 25 s", "-0.345"),
    "Table 3": ("0.0110 and 0.008475", "23.0 % better", "24.5 % from 0.011 and 0.0083"),
    "Table 4, Kp": ("beam: as printed 1.44e+06", "bristle: as printed 2.34e+06", "a factor of 1000"),
    "Table 4, Ki": ("beam: as printed 54 ", "bristle: as printed 27 ", "a factor of 0.278"),
    "Table 4, D, K, rho": ("4.25e-04 1/s", "5.40e-03 m/s^2", "5.51 N*m/(m/s)", "70 N*m", "beam: ", "5.83 N*m/(m/s)"),
    "Table 5, energy": ("1.77e-04 J", "4.87e+06 J", "1.75e+07"),
    "Table 5 / (4), braking time": ("2.94 m/s^2", "9.0 s", "46.8 s"),
}


@pytest.fixture(scope="module")
def rows() -> dict[str, Erratum]:
    return {row.where: row for row in errata(derive())}


def test_every_row_is_decided_as_expected(rows) -> None:
    assert {where for where, row in rows.items() if row.agrees} == AGREE
    assert {where for where, row in rows.items() if not row.agrees} == set(SIZES)


@pytest.mark.parametrize("where", SIZES)
def test_size_in_the_paper_s_numbers(rows, where) -> None:
    for text in SIZES[where]:
        assert text in rows[where].sign_and_size


def test_differences_are_shown_and_nothing_is_where_they_agree(rows) -> None:
    for row in rows.values():
        assert row.printed_latex
        assert row.derived_latex
        assert row.explanation
        assert "\\" not in row.printed + row.derived
        if row.how == "symbolic":
            zeros = row.difference_latex.replace(r"\left[\begin{matrix}0\\0\end{matrix}\right]", "0")
            assert (zeros == "0") is row.agrees


def test_what_only_a_simulation_shows_says_so(rows) -> None:
    for where in ("Table 5, energy", "Table 5 / (4), braking time", "p. 54, invariant set theorem"):
        assert "simulation" in rows[where].explanation


def test_10_with_both_factors_mended_is_the_integral() -> None:
    mended = beam.printed_force(width=False, last_factor=sp.Rational(1, 4))
    assert sp.simplify(mended - beam.integrated_force()) == 0
    assert sp.simplify(printed.beam_force() - beam.integrated_force()) != 0


def test_pressure_carries_the_load() -> None:
    """(5) integrated over the footprint is N."""
    total = sp.integrate(printed.pressure() * printed.width, (printed.xc, 0, printed.length))
    assert sp.simplify(total - printed.wheel_load) == 0


def test_random_disturbance_against_the_formula() -> None:
    """(1/(rM) + r/J) Tr with Tr = 431 N * 0.43 m, worked by hand."""
    assert random_disturbance(derive()) == pytest.approx((1 / (0.43 * 3517) + 0.43 / 60.35) * 431 * 0.43, rel=1e-12)


def test_compared_shows_sign_and_difference() -> None:
    row = compared("x", (plant.Ta, plant.Tb), (-plant.Ta, plant.Tb), sign_and_size="", explanation="")
    assert (row.agrees, row.printed, row.derived) == (False, "(Ta, Tb)", "(-Ta, Tb)")
    assert row.difference_latex == r"\left[\begin{matrix}2 T_a\\0\end{matrix}\right]"
