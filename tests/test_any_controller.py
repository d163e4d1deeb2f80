"""Any linear controller wherever a PI is taken: loops, assessments, sweeps, effort, tuning, reports."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
import scipy.signal

from railslip_ctrl import assess, linearize, wheel_slip_loop
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design import (
    PIController,
    StateSpaceController,
    actuated_plant,
    controller_system,
    linear_controller,
)
from railslip_ctrl.design.controllers import SampledController, sampled_loop
from railslip_ctrl.design.limits import control_effort
from railslip_ctrl.design.schedule import sweep_speed
from railslip_ctrl.design.tuning import tune_pi
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.responses import step_response
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.linearization import operating_point
from railslip_ctrl.model.vehicle import PARK2008, PIGains, Rail
from railslip_ctrl.report import margins_json, margins_text
from railslip_ctrl.simulation import LinearControl

S = ct.tf("s")
PI_LEAD = PIController(PIGains(kp=229.0, ki=5.0), lead=0.6, lead_filter=0.06)
SYSTEM = (229.0 + 5.0 / S) * (0.6 * S + 1) / (0.06 * S + 1)
NUM, DEN = SYSTEM.num[0][0], SYSTEM.den[0][0]
REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)


class Described:
    """A step object that says what it is at an operating point."""

    def step(self, t: float, v: float, omega: float) -> float:
        return 0.0

    def linear(self, point: object) -> ct.TransferFunction:
        return SYSTEM


class Mute:
    def step(self, t: float, v: float, omega: float) -> float:
        return 0.0


KINDS = {
    "PI-lead": PI_LEAD,
    "tf": SYSTEM,
    "ss": ct.tf2ss(SYSTEM),
    "zpk": ct.zpk(SYSTEM.zeros(), SYSTEM.poles(), NUM[0] / DEN[0]),
    "scipy lti": scipy.signal.lti(NUM, DEN),
    "scipy ss": scipy.signal.lti(NUM, DEN).to_ss(),
    "scipy zpk": scipy.signal.lti(NUM, DEN).to_zpk(),
    "Rational": PI_LEAD.transfer_function,
    "linear": Described(),
    "run": LinearControl(SYSTEM, REFERENCE, period=0.01),
}


@pytest.fixture(scope="module")
def plant():
    law = published_law("bristle", Rail.DRY)
    return linearize(operating_point(law, PARK2008, 100 / 3.6, 0.132, rail=Rail.DRY))


@pytest.mark.parametrize("kind", KINDS)
def test_one_controller_in_every_form_closes_one_loop(plant, kind):
    expected = assess(plant, PI_LEAD, PARK2008.actuator).margins
    found = assess(plant, KINDS[kind], PARK2008.actuator)
    # zeros and poles of polynomials and pencils are good to some 1e-13
    assert (found.margins.ms, found.margins.delay_s) == pytest.approx((expected.ms, expected.delay_s), rel=1e-9)
    assert wheel_slip_loop(plant.point, KINDS[kind]).margins().ms == pytest.approx(expected.ms, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_design_script_asks_takes_every_form(plant, kind):
    controller, lagged = controller_system(KINDS[kind], plant.point), actuated_plant(plant, PARK2008.actuator)
    effort = control_effort(controller, lagged, 0.15, lag=0.6)
    assert effort.high_frequency_gain == pytest.approx(2290.0, rel=1e-9)
    swept = sweep_speed({"mine": KINDS[kind], "of the speed": lambda v: KINDS[kind]}, [60.0])
    assert swept.margins["mine"].ms == pytest.approx(swept.margins["of the speed"].ms, rel=1e-12)
    if kind not in ("linear", "run"):  # these are controllers, not systems
        found, expected = (step_response(c, lagged, 0.15, final_time=2.0).output[-1] for c in (KINDS[kind], controller))
        assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("lead", [(0.6 * S + 1) / (0.06 * S + 1), scipy.signal.lti([0.6, 1], [0.06, 1])])
def test_a_compensator_to_tune_behind_is_any_system(plant, lead):
    lagged = actuated_plant(plant, PARK2008.actuator)
    own = PIController(PIGains(kp=1.0, ki=0.0), 0.6, 0.06).transfer_function
    tuned, expected = (tune_pi([lagged], 0.15, ms_max=2.0, compensator=c) for c in (lead, own))
    assert (tuned.kp, tuned.ki) == pytest.approx((expected.kp, expected.ki), rel=1e-6)


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (Mute(), "Mute is known by its step alone and has no margins; give it a method linear"),
        ("pi", "controller: str is not a linear system"),
        (True, "controller: bool is not a linear system"),
        (ct.tf([1.0, 0.0, 0.0], [1.0, 1.0]), "not proper"),
        (ct.ss([[0.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]), "not SISO"),
        (ct.tf([1.0], [1.0, -0.5], True), r"dt = True\); give dt in s"),
    ],
)
def test_what_is_no_linear_controller_is_refused_with_the_reason(plant, controller, words):
    with pytest.raises(InputError, match=words):
        wheel_slip_loop(plant, controller)


def test_a_gain_alone_is_a_controller_and_shapes_that_do_not_fit_are_none(plant):
    expected = wheel_slip_loop(plant, PIController(PIGains(kp=190.0, ki=0.0))).margins().ms
    for gain in (
        190,
        190.0,
        ct.ss([], [], [], [[190.0]]),
        ct.tf([190.0], [1.0]),
        StateSpaceController((), (), (), 190.0),
    ):
        assert wheel_slip_loop(plant, gain).margins().ms == pytest.approx(expected, rel=1e-12)
    for a, b, c in ((((1.0, 2.0),), (1.0,), (1.0,)), (((1.0,),), (1.0, 2.0), (1.0,)), ((), (1.0,), ())):
        with pytest.raises(InputError, match="do not fit; give n by n, n and n"):
            StateSpaceController(a, b, c)


def test_an_object_linear_at_a_point_needs_one():
    with pytest.raises(InputError, match="linear at an operating point; give one"):
        controller_system(Described())


# --- discrete ones ---------------------------------------------------------------------------------------------------


def test_a_discrete_controller_has_the_margins_of_its_sampled_loop(plant):
    sampled = ct.sample_system(SYSTEM, 0.05, "tustin")
    loop = wheel_slip_loop(plant, sampled)
    assert isinstance(loop, SampledLoop)
    expected = sampled_loop(SampledController(PI_LEAD, 0.05), plant, PARK2008.actuator)
    # python-control's polynomials lose digits next to z = 1
    assert loop.margins().ms == pytest.approx(expected.margins().ms, rel=1e-6)
    found = assess(plant, sampled, PARK2008.actuator)
    assert found.margins.delay_s == pytest.approx(expected.margins().delay_s, rel=1e-6)
    assert found.closed_loop_poles.real.max() < 0
    json = margins_json(found)
    assert (json["controller"]["period"], json["open_loop_unstable_poles"]) == (0.05, 1)
    assert "discrete transfer function of order 2" in margins_text([found])
    with pytest.raises(InputError, match=r"dt = 0.05\) has no transfer function in s"):
        controller_system(sampled)


def test_a_sampled_loop_takes_systems_of_its_period(plant):
    c, p = ct.tf([0.5], [1.0, -0.2], 0.1), ct.tf([1.0], [1.0, 1.0])
    expected = SampledLoop(Rational.from_polynomials([0.5], [1, -0.2]), Rational.from_control(p), 0.05, 0.1)
    for systems in ((c, p), (ct.tf2ss(c), ct.tf2ss(p)), (scipy.signal.dlti([0.5], [1, -0.2], dt=0.1), p)):
        assert SampledLoop(*systems, 0.05, 0.1).margins().ms == pytest.approx(expected.margins().ms, rel=1e-9)
    with pytest.raises(InputError, match=r"controller: a system with dt = 0.1 s does not go with a period of 0.2 s"):
        SampledLoop(c, p, 0.05, 0.2)
    with pytest.raises(InputError, match="plant: a discrete-time system"):
        SampledLoop(c, c, 0.05, 0.1)
    with pytest.raises(InputError, match="controller: a system with dt = 0 s does not go"):
        SampledLoop(PI_LEAD, p, 0.05, 0.1)
    with pytest.raises(InputError, match=r"plant: a discrete-time system \(dt = 0.1\)"):
        SampledLoop(c, SampledController(PI_LEAD, 0.1), 0.05, 0.1)


def test_margins_of_what_runs_stand_beside_the_continuous_ones(plant):
    control = LinearControl(SYSTEM, REFERENCE, period=0.1, rule="tustin")
    found = assess(plant, control, PARK2008.actuator)
    expected = sampled_loop(control.sampled(0.1), plant, PARK2008.actuator).margins()
    assert found.sampled.ms == expected.ms > found.margins.ms
    assert margins_json(found)["sampled"]["ms"] == expected.ms
    assert assess(plant, LinearControl(SYSTEM, REFERENCE, period=1e-4), PARK2008.actuator).as_run is None
    assert "As run, sampled every 0.1 s: Ms 1.58" in margins_text([found])


@pytest.mark.parametrize("kind", KINDS)
def test_records_of_a_controller_are_equal_where_their_numbers_are(plant, kind):
    record = linear_controller(KINDS[kind], plant.point)
    assert linear_controller(record) is record
    assert record == linear_controller(KINDS[kind], plant.point)
    omega = np.array([0.1, 1.0, 10.0])
    assert record.transfer_function(1j * omega) == pytest.approx(SYSTEM(1j * omega), rel=1e-9)
