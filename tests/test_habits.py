"""What users do without reading first: options that do not go together, controllers without names, loops in algebra."""

import copy
import dataclasses
import importlib
import json
import math
import operator
import pickle
import pkgutil
import re
from types import SimpleNamespace

import control as ct
import numpy as np
import pandas as pd
import pytest
from project import refused

import railslip_ctrl as rs
from railslip_ctrl.core import records
from railslip_ctrl.report.campaign import campaign_json, campaign_text
from railslip_ctrl.report.simulation import CSV_COLUMNS
from railslip_ctrl.simulation.campaign.specification import Campaign

S = ct.tf("s")


class Ramp:
    def __init__(self, reference=None):
        self.reference = reference

    def step(self, t, v, omega):
        return min(600.0 * t, 1500.0)


def test_a_step_object_runs_on_a_law_without_a_reference_slip_and_has_no_slip_error():
    scenario = rs.stop(adhesion="polach", speed_kmh=40)
    assert scenario.adhesion.reference is None
    run = rs.simulate(scenario, Ramp())
    assert run.stopped
    assert math.isnan(run.mean_abs_slip_error)
    assert np.isnan(run.signals.reference).all()
    assert "reference" not in str(run)
    with_own = rs.simulate(scenario, Ramp(rs.ReferenceSlip(dry=0.1, wet=0.1)))
    assert with_own.mean_abs_slip_error == pytest.approx(0.1, rel=0.01)  # the slip stays below 0.001
    many = rs.campaign(scenario, [Ramp(), Ramp()], runs=2)
    told = json.loads(json.dumps(campaign_json(many), allow_nan=False))["controllers"]
    assert list(told) == ["Ramp", "Ramp 2"]
    assert told["Ramp"]["measures"]["mean_abs_slip_error"]["mean"]["value"] is None
    assert told["Ramp"]["measures"]["braking_time_s"]["count"] == 2
    assert "nan" not in campaign_text(many)


def test_controllers_without_a_name_get_numbers_in_a_campaign():
    given = [5 + 1 / S, 6 + 1 / S, ct.tf([1.0], [1.0, 1.0], name="mine"), lambda t, v, w: 0.0, lambda t, v, w: 1.0]
    order = "transfer-function-of-order-1"
    expected = (order, f"{order} 2", "mine", "<lambda>", "<lambda> 2")
    assert Campaign(rs.stop(), tuple(given), 1).controller_names == expected
    plain = rs.linear_control(5 + 1 / S, reference=rs.ReferenceSlip(dry=0.1, wet=0.1))
    assert Campaign(rs.stop(), (plain, plain), 1).controller_names == ("transfer-function", "transfer-function 2")


@pytest.mark.parametrize("controller", ["seeking", "slide-protection", "ramp.py", "profile.toml"])
def test_no_error_is_told_against_a_reference_that_is_not_used(railslip, file, controller):
    file("ramp.py", "class Ramp:\n    def step(self, t, v, omega):\n        return 1000.0\nCONTROLLER = Ramp()\n")
    file("profile.toml", 'kind = "torque-profile"\ntimes = [0, 1]\ntorques = [0, 1000]\n')
    words = ("simulate", "--controller", controller, "--scenario", "park2008-si", "--csv", "run.csv")
    found = json.loads(railslip(*words, "--json")[1])
    keys = ("mean_abs_slip_error", "mean_abs_slip_error_published", "reference_slip")
    assert {found[key] for key in keys} == {None}
    assert "slip error" not in railslip(*words)[1]
    assert list(pd.read_csv("run.csv")) == list(CSV_COLUMNS.values())
    railslip(*words, "--internal")
    own = list(pd.read_csv("run.csv"))[len(CSV_COLUMNS) :]
    assert bool(own) == (controller in ("seeking", "slide-protection"))  # the others remember nothing


UNUSED = [
    ("simulate --controller seeking --period 0.1", r"period 0.1 s is not allowed .* <= 0.0125 \(s\)"),
    ("tune --structure seeking --period 0.1", r"period 0.1 s is not allowed .* <= 0.0125 \(s\)"),
    ("tune --structure pi-lead --ms-max 2 --lead-filter 0.01 --period 0.1 --speed 100 --rail dry --out a.toml",
     "period: 0.1 s is not allowed with a lead filter of 0.01 s; give a value <= 0.02"),
    ("simulate --controller seeking --slip 0.1", "--slip: 0.1 has no effect with seeking"),
    ("simulate --controller slide-protection --gains beam", "--gains: beam has no effect with slide-protection"),
    ("simulate --no-noise --seed 3", "--seed has no effect with --no-noise"),
    ("simulate --internal", "--internal has no effect without --csv"),
    ("margins --nominal", "--nominal has no effect without --envelope"),
    ("tune --ms-max 2 --speed 100 --nominal", "--nominal has no effect at operating points"),
    ("tune --ms-max 2 --speed 100 --period 0.02", "--period has no effect at operating points without --out"),
    ("report --no-html --fresh", "--fresh has no effect with --no-html"),
    ("campaign many.toml --out many --internal", "--internal has no effect without --replay"),
    ("campaign many.toml --out many --replay 0 --workers 1", "--workers has no effect with --replay"),
    ("campaign slip.toml --out many", "slip: 0.1 has no effect with seeking"),
]  # fmt: skip


@pytest.mark.parametrize(("words", "told"), UNUSED, ids=[words for words, _ in UNUSED])
def test_an_option_that_would_not_be_used_is_refused(railslip, file, words, told):
    file("many.toml", 'scenario = "stop"\nruns = 1\n[[controller]]\ncontroller = "pi"\n')
    file("slip.toml", 'scenario = "stop"\nruns = 1\n[[controller]]\ncontroller = "seeking"\nslip = 0.1\n')
    assert re.search(told, refused(railslip(*words.split())))


def test_load_law_takes_what_the_option_adhesion_takes(railslip, file):
    head = "from railslip_ctrl.model.adhesion.burckhardt import Burckhardt\n"
    file("law.py", f"{head}LAW = Burckhardt(c1=0.28, c2=24.0, c3=0.11, reference=dict(dry=0.09, wet=0.05))\n")
    file("law.toml", 'law = "burckhardt"\nparameters = {c1 = 0.28, c2 = 24, c3 = 0.11}\n'
         "reference_slip = {dry = 0.09, wet = 0.05}\n")  # fmt: skip
    assert rs.load_law("law.py") == rs.load_law("law.toml")
    file("run.toml", 'extends = "stop"\nadhesion = "law.py"\n')
    assert rs.load_scenario("run.toml").adhesion == rs.load_law("law.py")
    for load, name in ((rs.load_law, "LAW"), (rs.load_controller, "CONTROLLER")):
        with pytest.raises(rs.InputError, match=rf"empty\.py: has no {name}"):
            load(file("empty.py", "\n"))
    for given in ("law.py", "polach", "beam"):
        law = rs.load_law(given, initial_speed_kmh=90)
        told = json.loads(railslip("linearize", "--adhesion", given, "--initial-speed", "90", "--rail", "dry",
                                   "--speed", "80", "--slip", "0.08", "--json")[1])["cases"][0]  # fmt: skip
        point = rs.operating_point(law, rs.PARK2008, speed=80 / 3.6, slip=0.08, rail="dry")
        assert told["A"] == rs.linearize(point).A.tolist()


TUNED = [
    ("--structure pi --phase-min 50 --delay-min 0.1", {"structure": "pi", "phase_min": 50, "delay_min": 0.1}),
    ("--structure pi-lead --minimise-ms --ki-min 3 --lead 0.5", {"minimise_ms": True, "ki_min": 3, "lead": 0.5}),
    ("--structure pi-lead --ms-max 2 --period 0.02 --nominal", {"period": 0.02, "nominal": True}),
]


@pytest.mark.parametrize(("words", "given"), TUNED)
def test_tune_gives_the_same_as_the_command(railslip, words, given):
    envelope = rs.Envelope(speeds=(60, 100), laws="curve", rails="dry", reference={"dry": 0.1, "wet": 0.1})
    found = rs.tune(envelope, **given)
    where = "--envelope default --speed 60 --speed 100 --adhesion curve --rail dry --slip 0.1 --json"
    told = json.loads(railslip("tune", *words.split(), *where.split())[1])
    assert (told["kp_si"], told["ki_si"]) == (found.controller.kp, found.controller.ki)
    for alone in ({"ki_min": 3}, {"minimise_ms": True}, {"structure": "seeking", "phase_min": 50}):
        with pytest.raises(rs.InputError, match=r"minimise_ms and ki_min|has no effect with 'seeking'"):
            rs.tune(envelope, **alone)


DELAYED = rs.DeadTimeLoop(2 / (S * (0.5 * S + 1)), dead_time=0.2)
POINT = rs.operating_point(rs.published_law("bristle", "dry"), rs.PARK2008, speed=27.0, slip=0.1)
SAMPLED = rs.wheel_slip_loop(POINT, ct.tf([190.0, -189.95], [1.0, -1.0], 0.01))
SEEKING = rs.wheel_slip_loop(POINT, rs.Seeking.for_vehicle(rs.PARK2008))


@pytest.mark.parametrize("loop", [DELAYED, SAMPLED, SEEKING], ids=lambda loop: type(loop).__name__)
def test_the_algebra_of_a_loop_is_that_of_its_frequency_response(loop):
    system = ct.tf([1.0, 0.5], [1.0, 0.3], loop.dt or 0)
    omega = loop.frequency_response().omega
    z = np.exp(1j * omega * loop.dt) if loop.dt else 1j * omega
    L, G = loop.response(omega), system(z)
    for made, expected in (
        (1 / (1 + loop), 1 / (1 + L)), (loop / (loop + 1), L / (1 + L)), (1 - loop, 1 - L), (loop - 1.0, L - 1),
        (loop.feedback(), L / (1 + L)), (ct.feedback(loop, 1), L / (1 + L)), (loop.feedback(loop, 1), L / (1 - L * L)),
        (ct.feedback(loop, system), L / (1 + L * G)), (ct.parallel(loop, system), L + G), (system + loop, L + G),
        (loop / system, L / G), (np.float64(2) + loop, 2 + L), (loop + loop, 2 * L),
    ):  # fmt: skip
        np.testing.assert_allclose(np.ravel(made.frdata), expected, rtol=1e-9)
    for made, expected in ((ct.series(loop, system), L * G), (ct.negate(loop), -L)):
        np.testing.assert_allclose(made.response(omega), expected, rtol=1e-9)


def test_two_loops_in_series_add_their_dead_times():
    twice = DELAYED * DELAYED
    assert twice.dead_time == pytest.approx(0.4)
    assert twice(1j) == pytest.approx(DELAYED(1j) ** 2, rel=1e-12)


def test_functions_of_python_control_take_a_loop_or_say_what_to_call():
    m = DELAYED.margins()
    gain, phase, _, at = ct.margin(DELAYED)
    assert (gain, phase, at) == pytest.approx((m.gain_increase, m.phase_deg, m.phase_frequency), rel=1e-4)  # splines
    assert ct.stability_margins(DELAYED)[2] == pytest.approx(1 / m.ms, rel=1e-4)
    omega = [0.1, 0.5, 1.0]
    assert np.ravel(ct.frequency_response(DELAYED, omega).frdata) == pytest.approx(DELAYED.response(omega))
    assert (ct.dcgain(DELAYED), *ct.zeros(DELAYED), *sorted(ct.poles(DELAYED).real)) == (math.inf, -2.0, 0.0)
    model = DELAYED.to_tf(6)
    assert "Pade of order 6" in model.name
    exact = DELAYED.step_response([0, 1, 2, 3]).output
    assert ct.step_response(model.feedback(), [0, 1, 2, 3]).outputs == pytest.approx(exact, abs=1e-4)
    for name in ("bode_plot", "nyquist_plot", "nichols_plot", "singular_values_plot", "nyquist_response", "damp"):
        with pytest.raises(AttributeError, match=r"^DeadTimeLoop .*loop\.frequency_response\(omega\)"):
            getattr(ct, name)(DELAYED)
    for refuse in (
        *(lambda: ct.step_response(DELAYED, omega), lambda: ct.root_locus_map(DELAYED)),
        *(lambda: ct.frd(DELAYED, omega), lambda: np.array(DELAYED)),
    ):
        with pytest.raises((AttributeError, TypeError), match=r"^DeadTimeLoop .*loop\.to_tf\(order\)"):
            refuse()


@pytest.mark.parametrize("omega", [2.0, [2.0], [3.0, 1.0], [1.0, 1.0, 2.0], [1.0, 2.0]])
@pytest.mark.parametrize("loop", [DELAYED, SAMPLED, SEEKING], ids=lambda loop: type(loop).__name__)
def test_a_frequency_response_takes_one_frequency_and_any_order(loop, omega):
    record = loop.frequency_response(omega)
    assert np.ravel(record.omega) == pytest.approx(np.ravel(omega))
    assert np.ravel(record.frdata) == pytest.approx(np.ravel(loop.response(omega)))


@pytest.mark.parametrize("loop", [DELAYED, SAMPLED, SEEKING], ids=lambda loop: type(loop).__name__)
def test_an_attribute_error_within_a_property_keeps_its_text(loop, monkeypatch):
    def fails(*_):
        raise AttributeError("module 'flint' has no attribute 'acb_poly'")

    for name in ("root_count", "gain_crossovers"):
        monkeypatch.setattr(type(loop), name, property(fails))
        with pytest.raises(AttributeError, match="module 'flint' has no attribute 'acb_poly'"):
            getattr(loop, name)
    with pytest.raises(AttributeError, match="has no attribute 'margin'"):
        _ = loop.margin


ENVELOPE = rs.Envelope(speeds=(60, 100), laws="curve", rails="dry", reference={"dry": 0.1, "wet": 0.1})
SCENARIO = rs.stop(speed_kmh=30)
RESULTS = {
    "operating_point": lambda k: rs.operating_point(POINT.law, rs.PARK2008, speed=27.0 + k, slip=0.1),
    "linearize": lambda k: rs.linearize(rs.operating_point(POINT.law, rs.PARK2008, speed=27.0 + k, slip=0.1)),
    "loop": lambda k: rs.DeadTimeLoop((2 + k) / (S + 1), dead_time=0.2),
    "seeking loop": lambda k: (2 + k) * rs.wheel_slip_loop(POINT, rs.Seeking.for_vehicle(rs.PARK2008)),
    "margins": lambda k: rs.DeadTimeLoop((2 + k) / (S + 1), dead_time=0.2).margins(),
    "certificate": lambda k: rs.DeadTimeLoop((2 + k) / (S + 1), dead_time=0.2).certificate(),
    "step_response": lambda k: rs.DeadTimeLoop((2 + k) / (S + 1), dead_time=0.2).step_response(3.0),
    "sampled margins": lambda k: ((1 + 0.01 * k) * SAMPLED).margins(),
    "assess": lambda k: rs.assess(rs.linearize(POINT), 190.0 + k + 5 / S, rs.PARK2008.actuator),
    "limits": lambda k: rs.fundamental_limits((2 + k) / (S - 0.1), 0.2 + 0.1 * k),
    "region": lambda k: rs.stabilizing_pi((2 + k) / (S + 1), 0.2),
    "judge": lambda k: rs.judge(ENVELOPE, 190.0 + k + 5 / S),
    "tune": lambda k: rs.tune(ENVELOPE, "pi", 2.0 + 0.1 * k),
    "seeking": lambda k: rs.tune(ENVELOPE.at(initial_speed=100 + k), "seeking", 50.0),
    "simulate": lambda k: rs.simulate(SCENARIO, 190 + 5 / S, seed=k),
    "compare": lambda k: rs.compare_runs(SCENARIO, {"pi": 190 + 5 / S}, [k]),
    "campaign": lambda k: rs.campaign(SCENARIO, [190 + 5 / S], runs=2, seed=k),
    "case": lambda k: Campaign(SCENARIO, (190 + 5 / S,), 3).case(k),
    "derive": lambda k: rs.derive(reference=("proportional", "constant")[k]),
}


@pytest.mark.parametrize("name", RESULTS)
def test_results_are_equal_by_content(name):
    one, again, other = (RESULTS[name](k) for k in (0, 0, 1))
    assert one == again
    assert not operator.ne(one, again)
    assert one != other
    assert one in [other, again]
    assert one != 1
    if name != "derive":  # SymPy's functions are others when copied
        assert copy.deepcopy(one) == one == pickle.loads(pickle.dumps(one))
    try:
        assert hash(one) == hash(again)
    except TypeError as error:
        assert "unhashable" in str(error)  # noqa: PT017  # a record with a list or a mapping


def test_every_dataclass_of_the_package_compares_by_content():
    for module in pkgutil.walk_packages(rs.__path__, "railslip_ctrl."):
        if module.name.endswith(("__main__", "_kernel")):
            continue
        for kind in vars(importlib.import_module(module.name)).values():
            if isinstance(kind, type) and kind.__module__ == module.name and dataclasses.is_dataclass(kind):
                assert kind.__eq__ is records._equal, kind
            if isinstance(kind, type) and issubclass(kind, tuple) and kind.__module__ == module.name:
                arrays = "Floats" in str(vars(kind).get("__annotations__"))
                assert not arrays or kind.__eq__ is records.same or kind.__name__ in INTERNAL, kind


INTERNAL = ("Boxes", "Errors", "Expansion", "Levels", "Step")  # no result holds one


def test_arrays_and_numbers_that_are_no_number_compare_by_content():
    system = ct.tf([1.0], [1.0, 2.0])
    for one, other in (
        (np.array([1.0, np.nan]), np.array([1.0, np.nan])), ((float("nan"), 1), (float("nan"), 1)),
        ({"a": np.eye(2)}, {"a": np.eye(2)}), (system, ct.tf([1.0], [1.0, 2.0])), (ct.ss(system), ct.ss(system)),
    ):  # fmt: skip
        assert records.same(one, other)
    for one, other in (
        (np.zeros(2), np.zeros(3)), (np.zeros(1), 0.0), (np.zeros(1), [0.0]), (math.nan, 0.0), ({"a": 1}, {"b": 1}),
        (system, ct.tf([1.0], [1.0, 2.0], 0.1)), (system, 1), ((1, 2), (1,)), (np.array(["a"]), np.array(["b"])),
    ):  # fmt: skip
        assert not records.same(one, other)


def test_numbers_of_numpy_are_numbers():
    assert rs.simulate(SCENARIO, 190 + 5 / S, seed=np.int64(3)) == rs.simulate(SCENARIO, 190 + 5 / S, seed=3)
    assert rs.stop(speed_kmh=np.array(50.0)) == rs.stop(speed_kmh=50.0) == rs.stop(speed_kmh=np.float32(50.0))
    assert rs.DeadTimeLoop(1 / (S + 1), np.array(0.5)) == rs.DeadTimeLoop(1 / (S + 1), 0.5)


def test_a_notebook_shows_a_result_in_words():
    shown = []
    rs.judge(ENVELOPE, 190 + 5 / S)._repr_pretty_(SimpleNamespace(text=shown.append), False)
    assert shown == [str(rs.judge(ENVELOPE, 190 + 5 / S))]
