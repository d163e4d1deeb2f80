"""Operating points and linear plants against published values, python-control, closed forms, a nonlinear simulation."""

import math
from dataclasses import replace
from typing import ClassVar

import control as ct
import numpy as np
import pytest
from sample_laws import ALL_LAWS, DYNAMIC_LAWS, sample_law

from railslip_ctrl import PARK2008, DomainError, InputError, KinkError, Rail, published_law
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion.base import Statement
from railslip_ctrl.model.adhesion.lugre import Dahl
from railslip_ctrl.model.linearization import linearize, linearize_rolling, nonlinear_plant, operating_point
from railslip_ctrl.model.numeric import adhesion_coefficient

V100 = 100.0 * KMH
BRISTLE = published_law("bristle", Rail.DRY)


def bristle_point(slip: float = 0.132):  # type: ignore[no-untyped-def]
    return operating_point(BRISTLE, PARK2008, V100, slip)


def static_pole(slope: float) -> float:
    """Of a force with a slope over the slip velocity, N/(m/s)."""
    return -(1 / 3517 + 0.43**2 / 60.35) * slope - 0.25 / 60.35  # system.md, section 2


def test_the_published_operating_point() -> None:
    """Dry, 100 km/h, slip 0.132, 3517 kg; tolerance half a unit of the last digit."""
    point = bristle_point()
    assert point.brake_torque == pytest.approx(4787.78, abs=0.005)
    assert point.adhesion_coefficient == pytest.approx(0.29850, abs=0.5e-5)
    assert (point.adhesion, point.rail, point.slip) == ("bristle", Rail.DRY, 0.132)
    assert point.speed_kmh == pytest.approx(100.0, rel=1e-15)
    assert point.residual < 1e-14  # a few roundings
    plant = linearize(point)
    assert plant.poles.real == pytest.approx([0.82083763, -8.63596062], abs=0.5e-8)
    assert (plant.poles.imag == 0.0).all()
    np.testing.assert_allclose(plant.C, [[1, 0], [1 / V100, 0], [-1, 0]], rtol=1e-15)
    np.testing.assert_allclose(plant.B, [[0.43 / 60.35], [0.0]], rtol=1e-14)  # r/J
    # z eliminated at rest: the slope of the static characteristic Fa = (gamma - sigma)/beta
    reduced = plant.A[0, 0] - plant.A[0, 1] * plant.A[1, 0] / plant.A[1, 1]
    assert reduced == pytest.approx(static_pole(-1.0 / BRISTLE.parameters()[1]), rel=1e-12)  # closed form
    assert reduced == pytest.approx(0.91, abs=0.005)
    full = linearize(point, speed_state=True)
    assert full.states == ("v", "sigma", "z")
    np.testing.assert_allclose(full.C, [[0, 1, 0], [-0.132 / V100, 1 / V100, 0], [0.132, -1, 0]], rtol=1e-15)
    np.testing.assert_array_equal(plant.A, full.A[1:, 1:])
    # Freezing the speed is a good approximation of the slip mode: v moves by (Fa + Fr)/M = 3 m/s^2 only through
    # the 1/M terms, 5 % of r^2/J; here the unstable pole moves by less than 1e-3 of itself.
    assert full.poles[0].real == pytest.approx(plant.poles[0].real, rel=1e-3)


def test_a_published_law_is_refused_for_a_vehicle_of_another_wheel_load() -> None:
    """mu would be that of other forces: 0.084 in place of 0.2985 at the coach's load."""
    coach = PARK2008.model_copy(update={"wheel_load": 122.6e3})
    with pytest.raises(InputError, match=r"a wheel load of 34500 N, and the vehicle has 122600 N; give published_law"):
        operating_point(BRISTLE, coach, V100, 0.132)
    mu = bristle_point().adhesion_coefficient
    own = published_law("bristle", Rail.DRY, wheel_load=coach.wheel_load)
    for law in (own, BRISTLE.at_wheel_load(coach.wheel_load / PARK2008.wheel_load)):
        assert operating_point(law, coach, V100, 0.132).adhesion_coefficient == pytest.approx(mu, rel=1e-12)
    # one without forces is of any load
    assert operating_point(published_law("burckhardt", Rail.DRY), coach, V100, 0.132).adhesion_coefficient > 0.2


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize("name", ALL_LAWS)
def test_against_python_control(name: str, rail: Rail) -> None:
    law = sample_law(name, rail)
    slip = law.reference_slip(rail) or 0.11
    point = operating_point(law, PARK2008, 70.0 * KMH, slip)
    ours, frozen = linearize(point, speed_state=True), linearize(point)
    system = nonlinear_plant(law, PARK2008, reference_slip=slip)
    z = [] if point.adhesion_state is None else [point.adhesion_state]
    theirs = ct.linearize(system, [point.speed, point.sigma, *z], [point.brake_torque, 0.0, 0.0], eps=1e-6)
    # forward differences with step 1e-6: truncation 1e-6 f''/2 and rounding 1e-16 * 1e2/1e-6
    tolerance = {"rtol": 2e-6, "atol": 2e-6}
    np.testing.assert_allclose(theirs.A, ours.A, **tolerance)
    np.testing.assert_allclose(theirs.A[1:, 1:], frozen.A, **tolerance)
    np.testing.assert_allclose(theirs.B[:, :1], ours.B, **tolerance)
    np.testing.assert_allclose(theirs.B[:, 1], theirs.B[:, 0], **tolerance)  # Td beside Tb in (3)
    random = {"v": -1 / (0.43 * 3517), "sigma": -1 / (0.43 * 3517) - 0.43 / 60.35, "z": 0.0}  # Tr in (3) and (4)
    np.testing.assert_allclose(theirs.B[:, 2], [random[name] for name in ours.states], **tolerance)
    np.testing.assert_allclose(theirs.C[:3], ours.C, **tolerance)
    np.testing.assert_allclose(theirs.C[3:, :2], [[1.0, 0.0], [1 / 0.43, -1 / 0.43]], **tolerance)  # v and omega
    np.testing.assert_array_equal(theirs.D[:3, :1], ours.D)
    assert system.state_labels == list(ours.states)
    assert system.output_labels == ["sigma", "lambda", "error", "v", "omega"]
    for speed in (5.0, 40.0, 100.0):
        for each in (0.001, 0.05, 0.6):
            at = operating_point(law, PARK2008, speed * KMH, each)
            z = [] if at.adhesion_state is None else [at.adhesion_state]
            rate = system.dynamics(0.0, [at.speed, at.sigma, *z], [at.brake_torque, 0.0, 0.0])
            # lambda' = (sigma' - lambda v')/v; accelerations of 100 m/s^2 cancel to rounding
            assert rate[1] - each * rate[0] == pytest.approx(0.0, abs=1e-11)


@pytest.mark.parametrize("name", ALL_LAWS)
@pytest.mark.parametrize("speed_state", [False, True])
def test_poles_zeros_and_transfer_function(name: str, speed_state: bool) -> None:
    plant = linearize(operating_point(sample_law(name), PARK2008, V100, 0.12), speed_state=speed_state)
    system = plant.to_control()
    assert system.state_labels == list(plant.states)
    assert system.input_labels == ["brake_torque"]
    assert system.output_labels == ["sigma", "lambda", "error"]
    to_sigma = system["sigma", "brake_torque"]
    # two ways to the same eigenvalues: roundings of entries of order 1e3
    np.testing.assert_allclose(np.sort_complex(plant.poles), np.sort_complex(ct.poles(to_sigma)), atol=1e-9)
    np.testing.assert_allclose(np.sort_complex(plant.zeros), np.sort_complex(ct.zeros(to_sigma)), atol=1e-9)
    num, den = plant.transfer_function()
    s = 0.3 + 1.7j
    assert np.polyval(num, s) / np.polyval(den, s) == pytest.approx(complex(to_sigma(s)), rel=1e-9)
    assert plant.speed_state is speed_state


def test_the_pole_of_a_static_law_is_its_slope() -> None:
    for name, slip in (("polach", 0.05), ("burckhardt", 0.05), ("curve", 0.2), ("beam", 0.02)):
        law, h = published_law(name, Rail.WET), 1e-6
        high, low = (adhesion_coefficient(law, V100, s, PARK2008.wheel_load) for s in (slip + h, slip - h))
        plant = linearize(operating_point(law, PARK2008, V100, slip))
        slope = PARK2008.wheel_load * (high - low) / (2 * h * V100)
        assert plant.poles == pytest.approx([static_pole(slope)], rel=1e-6)  # truncation h^2 and rounding eps/h
    # dFa/dlambda at 0: Kx for the beam (9); 0 for the curve, which starts as alpha s^2/(2 R); Polach's whatever mu is
    polach, tyre = (published_law(other, Rail.WET) for other in ("polach", "burckhardt"))
    stiffness = (polach.kA + polach.kS) / 2 * polach.G * polach.a * polach.b * polach.c11
    slopes = {
        "beam": 274_360.0,
        "curve": 0.0,
        "polach": stiffness,
        "burckhardt": 34_500.0 * (tyre.c1 * tyre.c2 - tyre.c3),
    }
    for other, slope in slopes.items():
        at_zero = linearize(operating_point(published_law(other, Rail.WET), PARK2008, V100, 0.0))
        assert at_zero.poles[0].real == pytest.approx(static_pole(slope / V100), rel=1e-12)  # rounding


def test_points_out_of_range() -> None:
    for slip in (1.0, -0.1, 1.5, math.nan, math.inf):
        with pytest.raises(DomainError, match="locked wheel" if slip == 1.0 else "0 <= slip < 1"):
            bristle_point(slip)
    for speed in (0.0, -3.0, math.nan, math.inf):
        with pytest.raises(DomainError, match="speed"):
            operating_point(published_law("beam", Rail.DRY), PARK2008, speed, 0.1)
    with pytest.raises(DomainError, match="gamma"):
        operating_point(published_law("bristle", Rail.DRY, 140.0), PARK2008, 140 * KMH, 0.83)
    for name in DYNAMIC_LAWS:
        with pytest.raises(KinkError, match="undefined"):
            operating_point(sample_law(name), PARK2008, V100, 0.0)


@pytest.mark.parametrize("name", DYNAMIC_LAWS)
def test_a_rolling_wheel_swings_against_its_bristles(name: str) -> None:
    """Closed form: with z' = sigma and F = F_z z + F_s sigma, s^2 + (k F_s + B/J) s + k F_z, k = 1/M + r^2/J."""
    law, k = sample_law(name), 1 / 3517 + 0.43**2 / 60.35
    plant = linearize_rolling(law, PARK2008, V100)
    load = PARK2008.wheel_load if name == "tyre_lugre" else 1.0  # its coefficients are normalised
    friction = load * (getattr(law, "alpha1", 0.0) + getattr(law, "alpha2", 0.0))
    expected = np.roots([1.0, k * friction + 0.25 / 60.35, k * load * law.alpha])  # type: ignore[attr-defined]
    np.testing.assert_allclose(np.sort_complex(plant.poles), np.sort_complex(expected), rtol=1e-9)
    assert (plant.point.slip, plant.point.adhesion_state, plant.point.adhesion_force) == (0.0, 0.0, 0.0)
    static = published_law("curve", Rail.DRY)
    at_0 = linearize(operating_point(static, PARK2008, V100, 0.0))
    np.testing.assert_array_equal(linearize_rolling(static, PARK2008, V100).A, at_0.A)


@pytest.mark.parametrize("rail", Rail)
def test_kink_of_the_beam(rail: Rail) -> None:
    law = published_law("beam", rail)
    (kink,) = law.kinks(V100, PARK2008.wheel_load)
    for off in (-0.5e-9, 0.0, 0.5e-9):
        with pytest.raises(KinkError, match="whole footprint"):
            linearize(operating_point(law, PARK2008, V100, kink.slip * (1 + off)))
    below, above = (linearize(operating_point(law, PARK2008, V100, kink.slip * (1 + off))) for off in (-3e-9, 3e-9))
    assert abs(below.poles[0] - above.poles[0]) > 0.1  # the derivative does jump there


def test_a_law_with_a_wrong_rest_state_is_found_out() -> None:
    class WrongRest(Dahl):
        name: ClassVar[str] = "wrong_rest"

        @classmethod
        def statement(cls) -> Statement:
            right = super().statement()
            return replace(right, steady_state=right.steady_state / 2)

    law = WrongRest(alpha=1e4, Fc=9e3)
    for slip in (0.1, 0.01):
        with pytest.raises(DomainError, match=r"not at rest \(residual 5.0e-01"):  # z'/sigma = 1 - alpha z/Fc, z halved
            operating_point(law, PARK2008, V100, slip)
