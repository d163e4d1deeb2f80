"""Controllers known by their step: Python objects and Numba functions in runs and campaigns, and what they do wrong."""

import re
from pathlib import Path
from unittest.mock import Mock

import control as ct
import numba
import pytest
import scipy.signal
from project import refused

from railslip_ctrl import Envelope, InputError, PIController, PIGains, ReferenceSlip, judge, load_controller
from railslip_ctrl.controllers.braking import linear_control
from railslip_ctrl.controllers.files import as_control
from railslip_ctrl.controllers.linear import full_brake_torque
from railslip_ctrl.controllers.user_step import StepControl
from railslip_ctrl.core.user_files import record_in
from railslip_ctrl.simulation import built_in_scenario, simulate
from railslip_ctrl.simulation.campaign.execution import execute
from railslip_ctrl.simulation.campaign.specification import Campaign

SCENARIO = built_in_scenario("park2008")
RADIUS = SCENARIO.vehicle.wheel.radius
REFERENCE = ReferenceSlip(dry=0.132, wet=0.132)
DESIGN = PIController(PIGains(kp=1210.0, ki=1220.0))
BUILT_IN = linear_control(DESIGN, reference=REFERENCE, rule="backward", anti_windup=False)


def as_run(controller, name=None):
    return as_control(controller, SCENARIO.vehicle, SCENARIO.adhesion.reference, name)


class PI:
    period = 0.01
    name = "object"
    reference = REFERENCE

    def reset(self, t, v, omega):
        self.integral = 0.0

    def step(self, t, v, omega):
        error = 0.132 * v - (v - RADIUS * omega)
        self.integral += 0.01 * 1220.0 * error
        return 1210.0 * error + self.integral


@numba.njit
def pi(t, v, omega, x):
    error = 0.132 * v - (v - RADIUS * omega)
    x[0] += 0.01 * 1220.0 * error
    return 1210.0 * error + x[0]


@numba.njit
def proportional(t, v, omega):
    return 1210.0 * (0.132 * v - (v - RADIUS * omega))


@pytest.mark.parametrize(
    "controller", [PI(), StepControl(thing=pi, reference=REFERENCE, start_numbers=(0.0,))], ids=["own", "numba"]
)
def test_one_law_in_every_form_makes_one_run(controller):
    expected, found, again = (simulate(SCENARIO, c, seed=3) for c in (BUILT_IN, controller, controller))
    # sums in another order, over 48 s of a stable loop
    assert found.braking_distance == pytest.approx(expected.braking_distance, rel=1e-9)
    assert found.signals.command == pytest.approx(expected.signals.command, rel=1e-9, abs=1e-6)
    assert again.braking_distance == found.braking_distance  # each run begins anew


def test_a_function_without_numbers_of_its_own_is_taken_as_it_is():
    short = SCENARIO.with_changes(events=())
    expected = simulate(short, linear_control(PIController(PIGains(kp=1210.0, ki=0.0)), reference=REFERENCE))
    assert as_run(PI()).reference == REFERENCE  # its own
    for function in (proportional, proportional.py_func):
        made = as_run(function)
        assert (made.label, made.period, made.reference) == ("proportional", 0.01, None)
        assert simulate(short, function).braking_distance == pytest.approx(expected.braking_distance, rel=1e-9)


@pytest.mark.parametrize("form", ["tf", "ss", "scipy", "discrete", "PI"])
def test_a_linear_system_runs_as_it_is_given(form):
    s = ct.tf("s")
    system = 1210.0 + 1220.0 / s
    given = {"tf": system, "ss": ct.tf2ss(system), "scipy": scipy.signal.lti(system.num[0][0], system.den[0][0])}
    given = (given | {"discrete": ct.sample_system(system, 0.01, "tustin"), "PI": BUILT_IN.system})[form]
    limit, reference = full_brake_torque(SCENARIO.vehicle), SCENARIO.adhesion.reference
    own = linear_control(BUILT_IN.system, reference=reference, torque_min=0.0, torque_max=limit)
    assert (own.period, own.rule) == (0.01, "tustin")  # what a system used alone has, and what is given has
    assert linear_control(ct.sample_system(system, 0.02, "tustin"), reference=reference).period == 0.02
    assert as_run(given).torque_max == limit
    found, expected = simulate(SCENARIO, given, seed=1), simulate(SCENARIO, own, seed=1)
    # a discrete one's anti-windup has the time of its own zero, half a period more than kp/ki
    assert found.braking_distance == pytest.approx(expected.braking_distance, rel=2e-4 if form == "discrete" else 1e-9)


@pytest.mark.long
def test_a_campaign_runs_them_in_other_processes(file, tmp_path):
    text = """
import numba

class Mine:
    i = 0.0
    def step(self, t, v, omega):
        self.i += 12.2 * (v - 0.43 * omega)
        return 1210.0 - self.i

@numba.njit
def p(t, v, omega):
    return 1210.0 * (0.43 * omega - 0.868 * v)
"""
    files = [file(f"{name}.py", f"{text}CONTROLLER = {one}\n") for name, one in (("a", "Mine()"), ("b", "p"))]
    loaded = [as_run(load_controller(name), name[0]) for name in files]
    short = SCENARIO.with_changes(longest_time=2.0, events=())
    campaign = Campaign(short, (*loaded, 1210.0 + 1220.0 / ct.tf("s")), 8)
    assert campaign.controller_names == ("a", "b", "transfer-function-of-order-1")
    one, two = (execute(campaign, tmp_path / str(n), workers=n, part_runs=4) for n in (1, 2))
    assert [one.row(i) for i in (0, 7)] == [two.row(i) for i in (0, 7)]
    assert Campaign(short, campaign.controllers, 8).fingerprint == campaign.fingerprint


@pytest.mark.parametrize(("lasts", "kept"), [(0, 0), (1, 0), (3, 2)])  # the first run is for the kernel
def test_a_campaign_that_fails_keeps_its_finished_parts_or_nothing(tmp_path, lasts, kept):
    class Failing(PI):
        runs = 0

        def reset(self, t, v, omega):
            super().reset(t, v, omega)
            Failing.runs += 1
            if Failing.runs > lasts:
                raise RuntimeError("no more")

    failing = Campaign(SCENARIO.with_changes(longest_time=0.1, events=()), (Failing(),), 8)
    with pytest.raises(InputError, match=r"test_step_objects.py, line \d+: reset .* no more; "):
        execute(failing, tmp_path / "made" / "for it", workers=1, part_runs=1)
    assert len(list(tmp_path.rglob("*.parquet"))) == kept
    assert bool(list(tmp_path.iterdir())) == bool(kept)


PLAIN = "\ndef helped(t):\n    return {}['torque']\n\n"
PLAIN += "class Mine:\n    def step(self, t, v, omega):\n        BODY\n\nCONTROLLER = Mine()\n"
COMPILED = "\nimport numba\n\n@numba.njit\ndef mine(t, v, omega):\n    BODY\n\n"
COMPILED += "@numba.njit\ndef inner(t):\n    return t * nothing\n\nCONTROLLER = mine\n"


@pytest.mark.parametrize(("text", "body", "told"), [
    (PLAIN, "return 1.0 / (t - 0.5 if abs(t - 0.5) > 1e-9 else 0)", "line 7: step at t = 0.5 s fails with ZeroD"),
    (PLAIN, "return float('nan') if t > 0.3 else 0.0", "line 6: step gives nan at t = 0.31 s; "),
    (PLAIN, "return 'brake'", "line 6: step gives 'brake' at t = 0 s"),
    (PLAIN, "return helped(t)", "line 3: step at t = 0 s fails with KeyError"),
    (PLAIN, "return 0.0\n    def reset(self, t, v, omega):\n        self.nothing", "line 9: reset at t = 0 s"),
    (COMPILED, "x = 1.0\n    return v if t < 1 else x * gain", "line 7: Numba cannot compile step: NameError"),
    (COMPILED, "x = inner(t)\n    return x", "line 11: Numba cannot compile step: NameError: name 'nothing'"),
    (COMPILED, "x = [1.0]\n    return x[int(9 * t)]", "line 7: step at t = 0.12 s fails with Index"),
    (COMPILED, "if t > 0.3:\n        raise ValueError('no')\n    return 0.0", "line 7: step at t = 0.31 s "),
    (COMPILED, "if 30 < omega < 60:\n        raise ValueError('no')\n    return 4e3", "line 7: step at t = "),
])  # fmt: skip
def test_errors_of_a_step_are_one_line_with_the_user_s_line(railslip, file, text, body, told):
    err = refused(railslip("simulate", "--controller", file("mine.py", text.replace("BODY", body))))
    assert f"mine.py, {told}" in err
    assert "Failed in" not in err  # the reason, not where Numba was


def test_a_run_has_its_own_copy_or_begins_by_a_reset_and_an_interruption_interrupts():
    class Counting:
        count = 0
        reference = REFERENCE

        def step(self, t, v, omega):
            if self.count == 100:
                raise KeyboardInterrupt
            self.count += 1
            return 10.0 * self.count

    class Held(PI):
        __deepcopy__ = Mock(side_effect=TypeError("one line\nto the valve"))

    one, briefly = Counting(), SCENARIO.with_changes(longest_time=0.5, events=())
    first, second = (simulate(briefly, one, seed=None).signals.command for _ in range(2))
    assert (one.count, first[1], first.tolist()) == (0, 20.0, second.tolist())
    with pytest.raises(KeyboardInterrupt):
        simulate(SCENARIO, one)
    first, second = (simulate(briefly, Held(), seed=None).signals.torque for _ in range(2))
    assert first.tolist() == second.tolist()
    Counting.__deepcopy__ = Held.__deepcopy__
    with pytest.raises(InputError, match=r"cannot be copied for a run \(one line to the valve\).*reset\(t, v, omega\)"):
        simulate(SCENARIO, one)


@pytest.mark.parametrize(("period", "told"), [(0, "0 is not allowed; give a value >= 1e"), (1e9, "<= 180$")])
def test_a_period_that_no_run_has_is_told_with_its_controller_or_file(railslip, file, period, told):
    path = file("mine.py", KINDS.replace("{}", "Timed()").replace("dt = 0.01", f"period = {period}"))
    with pytest.raises(InputError, match=f"^controller Timed: period: .*{told}"):  # 180 s: once a run, and no more
        simulate(SCENARIO, load_controller(path))
    if not period:
        for command in ("margins --rail dry", "simulate --scenario stop --out out"):
            begins = f"railslip: error: --controller: {path}: controller mine: period: 0 is not allowed"
            assert refused(railslip(*command.split(), "--controller", path)).startswith(begins)
        assert not Path("out").exists()


KINDS = """
import control as ct

class Timed:
    dt = 0.01
    def step(self, t, v, omega):
        return 0.0

class Linear:
    def __init__(self, made):
        self.made = made
    def linear(self, point):
        return self.made(self, point)

class Stepped(Linear, Timed):
    pass

class Narrow:
    def linear(self):
        return 1.0

class Forgetful(Timed):
    def reset(self):
        pass

def step(t, v, omega):
    return 0.0

CONTROLLER = {}
"""
ALONE = "has no margins, because its linear system is not known"


@pytest.mark.parametrize(("controller", "margins", "run"), [
    ("Timed()", f"mine.py, line 6: Timed {ALONE}; add a method linear", None),
    ("step", f"mine.py, line 26: step {ALONE}; give an object with step", None),
    ("Timed", "Timed is a class; give an object of it, Timed()", "Timed is a class; give an object of it, Timed()"),
    ("Linear(lambda s, p: 200 + 5 / ct.tf('s'))", None, "Linear has only linear(operating_point)"),
    ("Linear(lambda s, p: s)", "mine.py, line 12: linear returns Linear, ", None),
    ("Stepped(lambda s, p: None)", "mine.py, line 12: linear() has an invalid result: controller: None", None),
    ("Linear(lambda s, p: p.none)", "mine.py, line 29: linear fails with AttributeError: 'OperatingPoint'", None),
    ("Narrow()", "mine.py, line 19: linear cannot be called with (operating_point): Narrow.linear() takes", None),
    ("Forgetful()", ALONE, "mine.py, line 23: reset cannot be called with (t, v, omega): Forgetful.reset() takes"),
])  # fmt: skip
def test_every_kind_has_margins_or_runs_or_says_in_a_line_why_not(file, controller, margins, run):
    mine = record_in(Path(file("mine.py", KINDS.replace("{}", controller))), "CONTROLLER", ())
    short = SCENARIO.with_changes(longest_time=0.1, events=())
    envelope = Envelope(laws="bristle", rails="dry", speeds=100, loads="empty")
    if run is None and controller.startswith(("Linear", "Narrow")):
        run = "add step(t, v, omega)"
    judged = StepControl(thing=mine) if run is None else mine  # as a command makes it of a file
    for told, ask in ((margins, lambda: judge(envelope, judged, nominal=True)), (run, lambda: simulate(short, mine))):
        if told is None:
            ask()
            continue
        with pytest.raises(InputError, match=re.escape(told)) as caught:
            ask()
        assert "\n" not in str(caught.value)
        assert "railslip_ctrl" not in str(caught.value)


@pytest.mark.parametrize(("make", "told"), [
    (lambda: simulate(SCENARIO, lambda t, v: 0.0), r"step cannot be called with \(t, v, omega\)"),
    (lambda: simulate(SCENARIO, ct.tf([190, -190], [1, -1], 1e-9)), "period: 1e-09 is not allowed; give a value >= 1e"),
    (lambda: simulate(SCENARIO, {}), "controller: dict is not a linear system"),
    (lambda: simulate(SCENARIO, "pi-lead"), "'pi-lead' .*load_controller"),
    (lambda: StepControl(thing=3), "has no step"),
])  # fmt: skip
def test_what_cannot_run_is_refused_in_a_line(make, told):
    with pytest.raises(InputError, match=told):
        make()
