"""Any linear controller wherever a PI is taken; sampled ones: difference equations, anti-windup, margins."""

import dataclasses
import math

import control as ct
import numpy as np
import pytest
import scipy.signal
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.signal import lfilter

from railslip_ctrl import PARK2008, DeadTimeLoop, PIController, PIGains, Rail, Rational, assess, plant_at
from railslip_ctrl.controllers.braking import linear_control
from railslip_ctrl.controllers.sampled import (
    Rule,
    SampledController,
    sampled_loop,
)
from railslip_ctrl.controllers.systems import (
    StateSpaceController,
    actuated_plant,
    controller_system,
    linear_controller,
    wheel_slip_loop,
)
from railslip_ctrl.core.errors import InputError, UnstableLoopError
from railslip_ctrl.design.schedule import sweep_speed
from railslip_ctrl.loop import sampled
from railslip_ctrl.loop.rational import realise
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.report import margins_json, margins_text

S = ct.tf("s")
LEAD = PIController(PIGains(kp=229.0, ki=5.0), lead=0.6, lead_filter=0.06)
SYSTEM = (229.0 + 5.0 / S) * (0.6 * S + 1) / (0.06 * S + 1)
NUM, DEN = SYSTEM.num[0][0], SYSTEM.den[0][0]
REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)


class Described:
    def step(self, t: float, v: float, omega: float) -> float:
        return 0.0

    def linear(self, point: object) -> ct.TransferFunction:
        return SYSTEM


KINDS = {
    "PI-lead": LEAD,
    "tf": SYSTEM,
    "ss": ct.tf2ss(SYSTEM),
    "zpk": ct.zpk(SYSTEM.zeros(), SYSTEM.poles(), NUM[0] / DEN[0]),
    "scipy lti": scipy.signal.lti(NUM, DEN),
    "scipy zpk": scipy.signal.lti(NUM, DEN).to_zpk(),
    "Rational": LEAD.transfer_function,
    "linear": Described(),
    "run": linear_control(SYSTEM, reference=REFERENCE, period=0.01),
}


@pytest.fixture(scope="module")
def plant():
    return plant_at("bristle", PARK2008, Rail.DRY, 100.0)


@pytest.mark.parametrize("kind", KINDS)
def test_one_controller_in_every_form_is_one_controller(plant, kind):
    expected = assess(plant, LEAD, PARK2008.actuator).margins
    found = assess(plant, KINDS[kind], PARK2008.actuator)
    # zeros and poles of polynomials and pencils are good to some 1e-13
    assert (found.margins.ms, found.margins.delay_s) == pytest.approx((expected.ms, expected.delay_s), rel=1e-9)
    assert wheel_slip_loop(plant.point, KINDS[kind]).margins().ms == pytest.approx(expected.ms, rel=1e-9)
    record = linear_controller(KINDS[kind], plant.point)
    assert linear_controller(record) is record
    assert record == linear_controller(KINDS[kind], plant.point)
    assert controller_system(KINDS[kind], plant.point)(2j) == pytest.approx(SYSTEM(2j), rel=1e-9)
    swept = sweep_speed({"mine": KINDS[kind], "of the speed": lambda v: KINDS[kind]}, [60.0])
    assert swept.margins["mine"].ms == pytest.approx(swept.margins["of the speed"].ms, rel=1e-12)


def test_a_gain_alone_is_a_controller_and_shapes_that_do_not_fit_are_none(plant):
    expected = wheel_slip_loop(plant, PIController(PIGains(kp=190.0, ki=0.0))).margins().ms
    forms = (190, 190.0, ct.ss([], [], [], [[190.0]]), ct.tf([190.0], [1.0]), StateSpaceController((), (), (), 190.0))
    for form in forms:
        assert wheel_slip_loop(plant, form).margins().ms == pytest.approx(expected, rel=1e-12)
    with pytest.raises(InputError, match=r"dt = True\); give dt in s"):
        wheel_slip_loop(plant, ct.tf([1.0], [1.0, -0.5], True))
    with pytest.raises(InputError, match="depends on the operating point"):
        controller_system(Described())
    for a, b, c in ((((1.0, 2.0),), (1.0,), (1.0,)), (((1.0,),), (1.0, 2.0), (1.0,)), ((), (1.0,), ())):
        with pytest.raises(InputError, match="do not fit; give n by n, n and n"):
            StateSpaceController(a, b, c)


def test_a_discrete_controller_has_the_margins_of_its_sampled_loop(plant):
    sampled = ct.sample_system(SYSTEM, 0.05, "tustin")
    loop = wheel_slip_loop(plant, sampled)
    assert isinstance(loop, SampledLoop)
    expected = loop_of(LEAD, 0.05, plant)
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


def test_margins_of_what_runs_stand_beside_the_continuous_ones(plant):
    control = linear_control(SYSTEM, reference=REFERENCE, period=0.1, rule="tustin")
    found = assess(plant, control, PARK2008.actuator)
    expected = sampled_loop(plant, control.sampled(0.1), PARK2008.actuator).margins()
    assert found.sampled.ms == expected.ms > found.margins.ms
    assert margins_json(found)["sampled"]["ms"] == expected.ms
    assert assess(plant, linear_control(SYSTEM, reference=REFERENCE, period=1e-4), PARK2008.actuator).as_run is None
    assert "period 0.1 s: Ms 1.58" in margins_text([found])


ACTUATOR = PARK2008.actuator
PERIOD = r"period: .* s is not allowed; give a finite value > 0"
PLAIN = PIController(PIGains(kp=190.0, ki=5.0))
INTEGRATOR = Rational(np.array([]), np.array([0.0]), 1.0)


def loop_of(design, period: float, plant, **given) -> SampledLoop:
    return sampled_loop(plant, SampledController(design, period), ACTUATOR, **given)


def gain(value: float) -> Rational:
    return Rational(np.array([]), np.array([]), value)


LEADING = 240 * (1 + 0.02 / S) * (0.6 * S + 1) / (0.05 * S + 1)
ANY = {
    "PID with filter and notch": LEADING * (S**2 + S + 400) / (S + 20) ** 2,
    "double integrator": (3.0 * S**2 + 2.0 * S + 1.0) / (S**2 * (0.1 * S + 1)),
    "no direct path": 100 / ((0.3 * S + 1) * (0.1 * S + 1) * (0.05 * S + 1)),
}
PIS = {
    "PI": PLAIN,
    "PI-lead": LEAD,
    "P": PIController(PIGains(kp=190.0, ki=0.0)),
    "I": PIController(PIGains(kp=0.0, ki=5.0)),
    "PI without direct path": PIController(PIGains(kp=-0.05, ki=5.0)),  # kp + ki h/2 = 0 by Tustin's rule
    "filtered P": PIController(PIGains(kp=190.0, ki=0.0), lead_filter=0.1),
    "filtered PI": PIController(PLAIN.gains, lead_filter=0.1),
}


def run(controller: SampledController, errors: np.ndarray) -> np.ndarray:
    x = controller.start()
    return np.array([controller.step(x, float(error)) for error in errors])


@pytest.mark.parametrize("rule", list(Rule))
@pytest.mark.parametrize("name", [*PIS, *ANY])
def test_steps_equal_the_transfer_function_on_random_errors(name, rule):
    controller = SampledController((PIS | ANY)[name], 0.02, rule=rule)
    errors = np.random.default_rng(3).normal(size=400)
    c = controller.transfer_function
    numerator, denominator = (np.atleast_1d(np.real(np.poly(roots))) for roots in (c.zeros, c.poles))
    late = np.zeros(denominator.size - numerator.size)  # descending powers of z, as ascending ones of 1/z
    expected = lfilter(np.append(late, c.gain * numerator), denominator, errors)
    # the expanded polynomials of a double integrator lose some digits
    assert run(controller, errors) == pytest.approx(expected, abs=1e-11 * np.max(np.abs(expected)))


@pytest.mark.parametrize("design", [LEAD, *ANY.values()], ids=["PI-lead", *ANY])
def test_rules_are_those_of_python_control(design):
    made = LEAD.transfer_function
    system = ct.zpk(made.zeros, made.poles, made.gain) if design is LEAD else design
    z = np.exp(1j * np.array([0.1, 1.0, 30.0]))
    for rule, method in ((Rule.TUSTIN, "tustin"), (Rule.BACKWARD, "backward_diff")):
        expected = ct.sample_system(ct.tf2ss(system) if method == "backward_diff" else system, 0.02, method)
        # python-control's expanded polynomials lose digits near z = 1
        assert SampledController(design, 0.02, rule=rule).transfer_function(z) == pytest.approx(expected(z), rel=1e-6)


def test_a_discrete_controller_runs_as_it_is():
    rng = np.random.default_rng(8)
    c = ct.tf([2.0, -1.9, 0.3], [1.0, -1.7, 0.72], 0.02)
    errors = rng.normal(size=200)
    expected = lfilter(c.num[0][0], c.den[0][0], errors)
    for design in (c, ct.tf2ss(c)):
        assert run(SampledController(design, 0.02), errors) == pytest.approx(expected, rel=1e-9)
    with pytest.raises(InputError, match=r"period: 0.01 s .* discrete controller, 0.02 s"):
        SampledController(c, 0.01)
    with pytest.raises(InputError, match="dt = True"):
        SampledController(ct.tf([1.0], [1.0, -0.5], True), 0.01)


def test_a_pole_too_fast_for_the_rule_is_refused():
    with pytest.raises(InputError, match=r"pole of 1000 1/s; give a value <= 0.002 \(s\), or the backward rule"):
        SampledController(1 / (1e-3 * S + 1), 0.01)
    assert SampledController(1 / (1e-3 * S + 1), 0.01, rule=Rule.BACKWARD).transfer_function(1.0) == pytest.approx(1.0)
    for pole, h, rule in (
        (0.5, 0.1, Rule.TUSTIN),
        (0.5, 3.0, Rule.TUSTIN),
        (-100.0, 0.02, Rule.TUSTIN),
        (-0.5, 1.5, Rule.BACKWARD),
    ):
        slow_enough = SampledController(1 / (S - pole), h, rule=rule)
        assert slow_enough.transfer_function(1.0) == pytest.approx(-1 / pole)
    with pytest.raises(InputError, match=r"pole of 100 1/s; give a value <= 0\.01"):
        SampledController(1 / (S - 100), 0.01, rule=Rule.BACKWARD)


# zeros and poles of controllers and poles of plants, of loops that cross at 1 rad/s with Ms <= 2: drawn at random
SATURATED = [
    ([-0.004, -0.534], [0, -3.362], [0, -2.72]),
    ([-0.086, -0.581, -0.981 + 8.539j, -0.981 - 8.539j, -0.4], [0, -2.037, -8.596, -8.596, -0.084], [-0.3, -1.42]),
    ([-0.191, 7.769j, -7.769j, -1.199, -0.65], [0, -7.769, -7.769, -6.69, -1.054], [-0.04, -7.21]),
    ([-0.174, -0.016, -0.93], [0, -0.01, -1.175], [-0.08, -8.47]),
    ([-0.234], [0], [-0.11, -4.65]),
]


@pytest.mark.parametrize("rule", list(Rule))
def test_a_saturated_controller_of_any_order_comes_back_as_the_unlimited_one_does(rule):
    """After a step whose torque is limited, and after a load beyond it for 10 s: overshoot, and how long at the limit.

    Of 1000 loops like these, none was above 0 and 5.3 s, and 0.03 and 0.7 s.
    """
    h, wound = 0.05, []
    for zeros, poles, of_plant in SATURATED:
        plant = Rational([], of_plant, 1.0)
        c = Rational(zeros, poles, float(1 / abs(Rational(zeros, poles, 1.0)(1j) * plant(1j))))
        made = realise(plant)
        n = made.b.size
        block = expm(np.block([[made.a, made.b[:, None]], [np.zeros((1, n + 1))]]) * h)
        a, b = block[:n, :n], block[:n, n]

        def run(controller, reference, load, a=a, b=b, row=made.c):
            x, state, y, asked = controller.start(), 0 * b, [], []
            for disturbance in load:
                y.append(float(row @ state))
                state = a @ state + b * (controller.step(x, reference - y[-1]) + disturbance)
                asked.append(abs(x.unlimited_torque))
            return np.array(y), np.array(asked)

        unlimited, nothing = SampledController(c, h, rule=rule), np.zeros(500)
        free, asked = run(unlimited, 1.0, nothing)
        steady = abs(1 / plant(0.0)) if np.all(plant.poles != 0) else 0.0
        limit = max(1.1 * steady, 0.9 * steady + 0.1 * asked.max())
        limited = dataclasses.replace(unlimited, torque_min=-limit, torque_max=limit)
        y, asked = run(limited, 1.0, nothing)
        assert y.max() <= max(1.0, free.max()) + 0.001
        assert np.sum(asked[np.argmax(y > 0.9) :] > limit) * h <= 6.0
        load = np.where(np.arange(500) < 200, -1.2 * limit, 0.0)
        free, (y, asked) = run(unlimited, 0.0, load)[0], run(limited, 0.0, load)
        assert y.max() / -y.min() <= free.max() / -free.min() + 0.04
        back = 200 + np.argmax(y[200:] > 0.1 * y.min())
        assert np.sum(asked[back:] > limit) * h <= 1.0
        y, _ = run(dataclasses.replace(limited, tracking_time=math.inf), 0.0, load)
        wound.append(y.max() / -y.min() - free.max() / -free.min())
    assert np.max(wound) > 0.5


def test_the_tracking_time_left_out_is_that_of_the_slowest_zero():
    """Without one that of the fastest pole; of an integrator alone the period; of a discrete one by (1 - z)/h."""
    discrete = ct.tf([1.0, -0.99], [1.0, -1.0], 0.02)
    for design, time in (
        (ANY["PID with filter and notch"], 50.0),
        (ANY["no direct path"], 0.05),
        (1 / S, 0.02),
        (discrete, 2.0),
    ):
        assert SampledController(design, 0.02)._tracking_rates[0] == pytest.approx(1 / time)


def test_integrator_with_proportional_control_closed_form():
    # y+ = (1 - K h) y is stable for 0 < K h < 2; one period later z^2 - z + K h for K h < 1
    m = SampledLoop(gain(0.7), INTEGRATOR, 0.0, 0.5).margins()
    assert m.gain_increase == pytest.approx(2 / 0.35, rel=1e-12)
    assert m.gain_increase_frequency == pytest.approx(2 * np.pi, rel=1e-14)
    m = SampledLoop(gain(0.7), INTEGRATOR, 0.5, 0.5).margins()
    assert m.gain_increase == pytest.approx(1 / 0.35, rel=1e-12)
    assert m.gain_increase_frequency == pytest.approx(np.pi / 3 / 0.5, rel=1e-11)  # z = exp(j pi/3)
    assert m.gain_decrease == 0.0
    # with gain 2, x[k+1] = -x[k]: a pole on the unit circle is counted
    loop = SampledLoop(gain(2.0), Rational(np.array([]), np.array([0.0]), 0.1), 0.0, 10.0)
    m = loop.scaled(0.5).margins()
    assert (m.gain_increase, m.gain_increase_frequency, m.gain_decrease) == pytest.approx((2.0, math.pi / 10, 0.0))
    assert (m.ms, m.ms_frequency, m.mt) == pytest.approx((2.0, math.pi / 10, 1.0), rel=1e-12)  # S = 1 - 1/z, T = 1/z
    with pytest.raises(UnstableLoopError) as caught:
        loop.margins()
    assert (caught.value.unstable_poles, caught.value.stabilizing_gain_range) == (1, (0.0, pytest.approx(1.0)))


@pytest.mark.parametrize("design", [PLAIN, LEAD], ids=["PI", "PI-lead"])
@pytest.mark.parametrize("period", [0.01, 0.03, 0.09])
def test_gain_and_delay_margins_are_where_an_eigenvalue_reaches_the_circle(plant, design, period):
    loop = loop_of(design, period, plant)
    m = loop.margins()
    for limit in (m.gain_increase, m.gain_decrease):
        outward = 1 + 1e-8 if limit > 1 else 1 - 1e-8
        assert not loop.scaled(limit * outward).is_stable()
        assert loop.scaled(limit / outward).is_stable()
    assert loop.stabilizing_gain_range == pytest.approx((m.gain_decrease, m.gain_increase), rel=1e-12)
    assert loop.delayed(m.delay_s * (1 - 1e-8)).is_stable()
    assert not loop.delayed(m.delay_s * (1 + 1e-8)).is_stable()


@pytest.mark.parametrize("computation", [0.0, 0.004])
def test_short_periods_converge_to_the_continuous_margins(plant, computation):
    # the hold costs h/2: order 1 against the continuous design, order 2 against the equivalent with that delay
    periods, system = (0.04, 0.02, 0.01, 0.005), controller_system(LEAD) * actuated_plant(plant, ACTUATOR)
    delay = ACTUATOR.dead_time + computation
    without = DeadTimeLoop(system, delay).margins()
    sampled = [loop_of(LEAD, h, plant, computation=computation).margins() for h in periods]
    held = [DeadTimeLoop(system, delay + h / 2).margins() for h in periods]
    for name in ("ms", "mt", "phase_deg", "delay_s", "gain_increase", "gain_decrease", "disk"):
        exact, equivalent = (np.array([getattr(one, name) for one in each]) for each in (sampled, held))
        losses = np.log2(np.abs(exact - getattr(without, name)))
        assert losses[:-1] - losses[1:] == pytest.approx([1.0, 1.0, 1.0], abs=0.1), name
        gaps = np.log2(np.abs(exact - equivalent)[1:])  # the longest period is not yet in the asymptotic range
        assert gaps[:-1] - gaps[1:] == pytest.approx([2.0, 2.0], abs=0.2), name


def test_unstable_sampled_loop_has_no_margins_and_says_which_gains_would_do(plant):
    wild, held = loop_of(LEAD, 0.05, plant).scaled(20.0), loop_of(LEAD, 0.05, plant).margins()
    low, high = wild.stabilizing_gain_range
    assert (20 * low, 20 * high) == pytest.approx((held.gain_decrease, held.gain_increase), rel=1e-9)
    with pytest.raises(UnstableLoopError, match="unstable with 2 pole") as caught:
        wild.margins()
    assert caught.value.stabilizing_gain_range == (low, high)
    with pytest.raises(UnstableLoopError, match="no factor on the loop gain"):
        loop_of(LEAD, 0.05, plant, computation=2.0).margins()


@pytest.mark.parametrize(("make", "message"), [
    *((lambda _, h=h: SampledController(PLAIN, h), PERIOD) for h in (0.0, -0.1, math.nan, math.inf)),
    *((lambda _, h=h: SampledLoop(gain(1.0), INTEGRATOR, 0.0, h), PERIOD) for h in (0.0, -0.1, math.nan, math.inf)),
    (lambda _: SampledController(LEAD, 0.13), r"period: 0.13 s .* lead filter of 0.06 s; give a value <= 0.12"),
    (lambda _: SampledController(PLAIN, 0.02, torque_min=1.0, torque_max=1.0), "give low < high"),
    (lambda _: SampledController(PLAIN, 0.02, torque_max=math.nan), "give low < high"),
    (lambda _: SampledController(PLAIN, 0.02, tracking_time=0.01), r"tracking time: 0.01 s .* >= the period 0.02"),
    (lambda _: SampledController(PLAIN, 0.02, rule="euler"), "rule: 'euler' is not allowed; give tustin or back"),
    (lambda _: SampledController(PLAIN, 0.02, torque_min=0.0).start(torque=-5.0), "initial torque: -5"),
    (lambda _: SampledLoop(gain(1.0), gain(1.0), 0.1, 0.1), "strictly proper"),
    (lambda _: SampledLoop(gain(0.0), INTEGRATOR, 0.1, 0.1), r"controller: .*gain .*\b0\b"),
    (lambda _: SampledLoop(gain(1.0), INTEGRATOR, -1.0, 0.1), "dead time: -1"),
    (lambda plant: loop_of(PLAIN, 1e-5, plant).margins(), r"period: 1e-05 s .* give a value >= 0.0003"),
    (lambda plant: loop_of(PLAIN, 0.01, plant, computation=-1.0), "computation: -1"),
])  # fmt: skip
def test_bad_controllers_and_loops_are_refused_in_one_line(plant, make, message):
    with pytest.raises(InputError, match=message) as caught:
        make(plant)
    assert "\n" not in str(caught.value)
    assert SampledController(LEAD, 0.13, rule="backward").rule is Rule.BACKWARD  # Tustin's rule refuses it


# --- verdicts that no grid may decide: the delay margin over fractions of the period, narrow peaks ------------------


class FractionalModel:
    """PI control kp + ki h/(z - 1) of k (zero - s)/zero/(lag s + 1)^2 behind any dead time, with NumPy and SciPy alone.

    The period is 1 s; states: the lag's two, the integral, and the commands that are under way.
    """

    def __init__(self, zero: float, lag: float, kp: float, ki: float) -> None:
        self.a = np.array([[0.0, 1.0], [-(lag**-2), -2 / lag]])
        self.c = np.array([1.0, -1 / zero]) / lag**2
        self.kp, self.ki = kp, ki
        plant = Rational(np.array([zero]), np.full(2, -1 / lag), -1 / (zero * lag**2))
        self.loop = SampledLoop(Rational(np.array([1 - ki / kp]), np.array([1.0]), kp), plant, 0.0, 1.0)

    def driven(self, times: np.ndarray) -> np.ndarray:
        block = np.zeros((times.size, 3, 3))
        block[:, :2, :2], block[:, 1, 2] = self.a * times[:, None, None], times
        return expm(block)[:, :2, 2]

    def radius(self, dead_times: np.ndarray) -> np.ndarray:
        whole = int(dead_times[0])
        now = self.driven(1 - (dead_times - whole))
        before = self.driven(np.ones(1)) - now
        command = np.zeros(4 + whole)
        command[:2], command[2] = -self.kp * self.c, 1.0
        matrix = np.zeros((dead_times.size, 4 + whole, 4 + whole))
        matrix[:, :2, :2], matrix[:, 2, 2], matrix[:, 2, :2] = expm(self.a), 1.0, -self.ki * self.c
        matrix[:, :2, 3 + whole] = before
        if whole:
            matrix[:, :2, 2 + whole] += now
            matrix[:, 4:, 3:-1] = np.eye(whole)
        else:
            matrix[:, :2] += now[:, :, None] * command
        matrix[:, 3] = command
        return np.abs(np.linalg.eigvals(matrix)).max(axis=1)

    def first_loss(self, dead_time: float, periods: int) -> float:
        """Least added dead time at which a scan in 64ths of a period, then bisected, finds the loop unstable, s."""
        for whole in range(int(dead_time), int(dead_time) + periods):
            times = whole + np.arange(64) / 64
            times = times[times > dead_time]
            unstable = np.flatnonzero(self.radius(times) >= 1) if times.size else times
            if unstable.size:
                high = times[unstable[0]]
                low = max(dead_time, high - 1 / 64)
                return brentq(lambda t: self.radius(np.array([t]))[0] - 1, low, high, xtol=1e-14) - dead_time
        return math.inf


def test_delay_margin_is_the_first_loss_of_stability_that_a_scan_of_eigenvalues_finds(monkeypatch):
    looked_at, part = [], sampled._part
    monkeypatch.setattr(sampled, "_part", lambda *given: looked_at.append(given[1].least.size) or part(*given))
    rng, beyond, checked = np.random.default_rng(15), 0, 0
    while checked < 16:
        zero, lag = 10 ** rng.uniform(-0.5, 0.7), 10 ** rng.uniform(-1, 0.3)
        model = FractionalModel(zero, lag, rng.uniform(0.05, 1.2), rng.uniform(0.005, 0.4))
        dead_time = rng.uniform(0.2, 2.5)
        if model.radius(np.array([dead_time]))[0] >= 1:
            continue
        checked += 1
        margin, expected = model.loop.delayed(dead_time).margins().delay_s, model.first_loss(dead_time, 8)
        if math.isinf(expected):
            beyond += 1
            assert margin > 7
        else:
            # the eigenvalues are good to some 1e-15, and the radius grows by more than 1e-5 of the added share
            assert margin == pytest.approx(expected, rel=1e-9)
    assert beyond < 8  # most are decided by the scan
    assert sum(looked_at) < 7_700  # boxes; bounds looser than need be show here alone


RESONANT = {
    # resonance, its damping, the dip beside it, its damping, gain, dead time; period 0.1 s; with a lag of 1 s
    "peak": (15.806749, 4.306e-6, 15.804366, 8.014e-5, 0.441226, 0.146655),
    "crossovers": (0.39231810, 1.0538e-4, 0.39216351, 2.843e-6, 0.742162, 0.08961),
    "phase crossover above 1": (0.33770287, 7.1609e-5, 0.33804286, 1.0664e-4, 2.012753, 0.131492),
}


def resonant(resonance, damping, dip, damping_dip, k, dead_time) -> SampledLoop:
    poles, zeros = (np.roots([1, 2 * z * w, w * w]) for w, z in ((resonance, damping), (dip, damping_dip)))
    return SampledLoop(gain(1.0), Rational(zeros, np.append(poles, -1.0), k), dead_time, 0.1)


@pytest.mark.parametrize("name", RESONANT)
def test_no_resonance_is_too_narrow_to_be_seen(name):
    # a grid of 40 points a decade sees none of these: Ms 1.06 for 11.9, gain margin 20.9 for 1.10, no crossover for two
    resonance, loop = RESONANT[name][0], resonant(*RESONANT[name])
    m = loop.margins()
    top = loop.nyquist_frequency
    grid = np.union1d(resonance * (1 + np.linspace(-2e-3, 2e-3, 200_000)), np.geomspace(1e-4, top, 2000))
    response = loop.response(grid[grid <= top])
    # the grid's step is a few hundredths of the narrowest peak's width
    assert m.ms == pytest.approx(np.max(np.abs(1 / (1 + response))), rel=1e-3)
    assert m.mt == pytest.approx(np.max(np.abs(response / (1 + response))), rel=1e-3)
    assert 1 / m.disk == pytest.approx(np.max(np.abs(1 / (1 + response) - 0.5)), rel=1e-3)
    crossings = np.count_nonzero(np.diff(np.abs(response) > 1))
    assert crossings <= m.gain_crossovers.size <= crossings + 1
    for limit in (m.gain_increase, m.gain_decrease):
        if 0 < limit < math.inf:
            outward = 1e-9 if limit > 1 else -1e-9
            assert not loop.scaled(limit * (1 + outward)).is_stable()
            assert loop.scaled(limit * (1 - outward)).is_stable()


@pytest.mark.parametrize(("poles", "k", "crossover", "phase_margin"), [
    ([-1e-7], 1e-6, 1e-7 * math.sqrt(99), math.pi - math.atan(math.sqrt(99))),
    ([0.0, -1.0], 1.2e-5, 1.2e-5, math.pi / 2 - 1.2e-5),  # near the lowest frequency that is looked at, 1e-5 of a pole
])  # fmt: skip
def test_a_loop_far_slower_than_its_period_has_the_margins_of_the_continuous_one(poles, k, crossover, phase_margin):
    m = SampledLoop(gain(1.0), Rational(np.array([]), np.array(poles), k), 0.0, 1.0).margins()
    assert m.gain_crossovers == pytest.approx([crossover], rel=1e-6)  # the hold is half a second of days
    assert m.delay_s == pytest.approx(phase_margin / crossover, rel=1e-5)  # and half a second in some 1e5


def test_two_phase_crossovers_side_by_side_hold_the_gains_that_stabilise():
    # k (s + 1)^2/s^3: the phase rises past -180 deg by 1e-4 rad before the dead time turns it back
    grid = np.linspace(1.5, 4.0, 2001)

    def delayed(dead_time: float) -> SampledLoop:
        return SampledLoop(gain(1.0), Rational(np.full(2, -1.0), np.zeros(3), 1.0), dead_time, 0.1)

    loop = delayed(brentq(lambda d: np.angle(-delayed(d).response(grid)).max() - 1e-4, 0.2, 0.35))
    limits = loop.stabilizing_gain_range
    low, high = limits
    assert low < high < 1.1 * low
    within = [loop.scaled(edge * (1 + move)).is_stable() for edge in limits for move in (-1e-7, 1e-7)]
    assert within == [False, True, True, False]
