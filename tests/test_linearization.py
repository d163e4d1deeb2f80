"""Operating points and linear plants against published values, python-control, closed forms, a nonlinear simulation."""

from __future__ import annotations

import importlib
import math
import sys
from pathlib import Path

import control as ct
import numpy as np
import pytest
from sample_laws import ALL_LAWS, DYNAMIC_LAWS, sample_law

import railslip_ctrl.model.adhesion
from railslip_ctrl.core.errors import DomainError, InputError, KinkError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design import PIController
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.responses import disturbance_response, step_response
from railslip_ctrl.model.adhesion import law_class, published_law
from railslip_ctrl.model.adhesion.beam import Beam
from railslip_ctrl.model.linearization import _residual, linearize, nonlinear_plant, operating_point
from railslip_ctrl.model.numeric import adhesion_coefficient, numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import PARK2008, PIGains, Rail

V100 = 100.0 * KMH
BRISTLE = published_law("bristle", Rail.DRY)


def bristle_point(slip: float = 0.132):  # type: ignore[no-untyped-def]
    return operating_point(BRISTLE, PARK2008, V100, slip)


def static_pole(slope: float) -> float:
    """Of a force with a slope over the slip velocity, N/(m/s)."""
    return -(1 / 3517 + 0.43**2 / 60.35) * slope - 0.25 / 60.35  # system.md, section 2


# --- published and independent values ------------------------------------------------------------------------------


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


def test_residual_is_the_share_of_a_torque_too_much_in_what_cancels() -> None:
    """Of the terms of lambda': r/J times each torque at the wheel, and v' (here of a train so light that it counts)."""
    wheel = PARK2008.wheel.model_copy(update={"viscous_friction": 30.0})
    vehicle = PARK2008.model_copy(update={"mass": 50.0, "wheel": wheel})
    point = operating_point(published_law("beam", Rail.DRY), vehicle, V100, 0.1)
    functions, p = numeric_plant(Beam), plant_parameters(point.law, vehicle)
    state = (V100, point.sigma, 0.0, point.brake_torque)
    (J, B, r), rate = p[1:4], functions.rates(*state, 0.0, 0.0, p)[0]
    assert 2.0 * abs(rate) > r / J * point.brake_torque > 0.0
    terms = r / J * (point.brake_torque + r * point.adhesion_force + B * V100 / r) - rate
    assert _residual(functions, (*state[:3], state[3] + 1.0), p) == pytest.approx(r / J / terms, rel=1e-3)  # 1 N*m


def test_inertia_scale_and_mass_enter() -> None:
    scaled = operating_point(BRISTLE, PARK2008.model_copy(update={"inertia_scale": 3.6}), V100, 0.132)
    # trim torque: r Fa - B omega + (J/M)(...): the ratio J/M stays, B omega grows 3.6 times
    omega = (1 - 0.132) * V100 / 0.43
    assert scaled.brake_torque - bristle_point().brake_torque == pytest.approx(-2.6 * 0.25 * omega, rel=1e-10)
    loaded = linearize(operating_point(BRISTLE, PARK2008.loaded(), V100, 0.132))
    assert loaded.poles[0].real < linearize(bristle_point()).poles[0].real


# --- derivatives ---------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(("name", "slip"), [("polach", 0.05), ("burckhardt", 0.05), ("curve", 0.2), ("beam", 0.05)])
def test_the_pole_of_a_static_law_is_its_slope(name: str, slip: float) -> None:
    law, h = published_law(name, Rail.WET), 1e-6
    high, low = (adhesion_coefficient(law, V100, s, PARK2008.wheel_load) for s in (slip + h, slip - h))
    plant = linearize(operating_point(law, PARK2008, V100, slip))
    # truncation h^2 and rounding eps/h
    assert plant.poles == pytest.approx([static_pole(PARK2008.wheel_load * (high - low) / (2 * h * V100))], rel=1e-6)
    # dFa/dlambda at 0: Kx for the beam (9); 0 for the curve, which starts as alpha s^2/(2 R)
    for other, slope in (("beam", 274_360.0), ("curve", 0.0)):
        at_zero = linearize(operating_point(published_law(other, Rail.DRY), PARK2008, V100, 0.0))
        assert at_zero.poles[0].real == pytest.approx(static_pole(slope / V100), rel=1e-12)  # rounding


# --- refusals ------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("rail", Rail)
def test_kink_of_the_beam(rail: Rail) -> None:
    law = published_law("beam", rail)
    (kink,) = law.kinks(V100, PARK2008.wheel_load)
    for off in (-0.5e-9, 0.0, 0.5e-9):
        with pytest.raises(KinkError, match="whole footprint"):
            linearize(operating_point(law, PARK2008, V100, kink.slip * (1 + off)))
    below, above = (linearize(operating_point(law, PARK2008, V100, kink.slip * (1 + off))) for off in (-3e-9, 3e-9))
    assert abs(below.poles[0] - above.poles[0]) > 0.1  # the derivative does jump there


WRONG_LAW = """
from typing import ClassVar
from railslip_ctrl.model.adhesion.base import Statement
from railslip_ctrl.model.adhesion.dahl import Dahl

class WrongRest(Dahl):
    name: ClassVar[str] = "wrong_rest"

    @classmethod
    def statement(cls):
        right = super().statement()
        return Statement(force=right.force, state_rate=right.state_rate, steady_state=right.steady_state / 2)
"""


def test_a_law_with_a_wrong_rest_state_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "wrong_rest.py").write_text(WRONG_LAW)
    monkeypatch.setattr(
        railslip_ctrl.model.adhesion, "__path__", [*railslip_ctrl.model.adhesion.__path__, str(tmp_path)]
    )
    importlib.invalidate_caches()
    law = law_class("wrong_rest").model_validate({"alpha": 1e4, "Fc": 9e3})
    for slip in (0.1, 0.01):
        with pytest.raises(DomainError, match=r"not at rest \(residual 5.0e-01"):  # z'/sigma = 1 - alpha z/Fc, z halved
            operating_point(law, PARK2008, V100, slip)
    sys.modules.pop("railslip_ctrl.model.adhesion.wrong_rest")


# --- small signals: an integration that shares nothing with the linear loop but the plant ----------------------------

STEP = 1e-3  # s; the dead time is 150 steps
FINAL = 6.0
SMALL = 1e-5  # m/s of reference, against a slip velocity of 3.7 m/s: its square is below every tolerance here


def nonlinear_response(controller: PIController, *, reference: float, load: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed frozen, bristle law, Heun steps with the dead-time buffer exact; deviations of sigma, m/s."""
    point, rates, p = bristle_point(), numeric_plant(type(BRISTLE)).rates, plant_parameters(BRISTLE, PARK2008)
    lag, delay = PARK2008.actuator.lag, round(PARK2008.actuator.dead_time / STEP)
    gains, lead, lead_filter = controller.gains, controller.lead, controller.lead_filter
    # with the speed frozen the point of constant slip drifts at sigma' = lambda v'; the deviation is measured from it
    drift = float(rates(V100, point.sigma, point.adhesion_state, point.brake_torque, 0.0, 0.0, p)[1])
    buffer = [0.0] * (delay + 1)

    def filtered(x: np.ndarray) -> tuple[float, float]:
        error = reference - (x[0] - point.sigma)
        return error, error if lead_filter == 0 else x[4] + (error - x[4]) * lead / lead_filter

    def slope(x: np.ndarray, delayed: float) -> np.ndarray:
        error, led = filtered(x)
        _, sigma_rate, z_rate = (float(q) for q in rates(V100, x[0], x[1], x[2] + load, 0.0, 0.0, p))
        filter_rate = 0.0 if lead_filter == 0 else (error - x[4]) / lead_filter
        lagged = (point.brake_torque + delayed - x[2]) / lag
        return np.array([sigma_rate - drift, z_rate, lagged, gains.ki * led, filter_rate])

    x, out = np.array([point.sigma, point.adhesion_state, point.brake_torque, 0.0, 0.0]), [0.0]
    for _ in range(round(FINAL / STEP)):
        buffer.append(gains.kp * filtered(x)[1] + x[3])
        before, after = buffer[-delay - 1], buffer[-delay]
        first = slope(x, before)
        x = x + 0.5 * STEP * (first + slope(x + STEP * first, after))
        out.append(x[0] - point.sigma)
    return np.arange(len(out)) * STEP, np.array(out)


@pytest.mark.parametrize(
    "controller",
    [PIController(PIGains(kp=190.0, ki=5.0)), PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)],
    ids=["PI", "PI-lead"],
)
@pytest.mark.parametrize("kind", ["reference", "load"])
def test_step_responses_equal_a_nonlinear_simulation_of_small_steps(controller: PIController, kind: str) -> None:
    plant = linearize(bristle_point())
    wheel = Rational(plant.zeros, plant.poles, plant.gain)
    lag = Rational(np.array([]), np.array([-1 / 0.6]), 1 / 0.6)
    respond, height = (step_response, SMALL) if kind == "reference" else (disturbance_response, 1e-3)
    sizes = {"reference": height, "load": 0.0} if kind == "reference" else {"reference": 0.0, "load": height}
    time, simulated = nonlinear_response(controller, **sizes)
    linear = respond(controller.transfer_function, wheel, 0.15, time=time, actuator=lag, height=height)
    # Heun at 1 ms with a filter of 60 ms: (h/T)^2 ~ 3e-4 of the response's size, and first order at its jumps
    assert np.abs(simulated - linear.output).max() < 3e-3 * np.abs(linear.output).max()
