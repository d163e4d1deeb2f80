"""Scenarios and controllers: their files, `--controller` in every command, and `railslip simulate`."""

import itertools
import json
import math
import re
from functools import partial
from pathlib import Path

import control as ct
import numpy as np
import pandas as pd
import pytest
from project import changed

import railslip_ctrl as rs
from railslip_ctrl import PARK2008, InputError, PIGains, Rail, ReferenceSlip, catalogue, load_scenario, published_law
from railslip_ctrl import simulation as sim
from railslip_ctrl.controllers.braking import linear_control
from railslip_ctrl.controllers.files import load_controller
from railslip_ctrl.controllers.pi import PI, PID
from railslip_ctrl.controllers.seeking import Seeking
from railslip_ctrl.controllers.slide_protection import SlideProtection
from railslip_ctrl.controllers.sliding import Sliding
from railslip_ctrl.controllers.systems import PIController, StateSpaceController
from railslip_ctrl.controllers.torque_profile import TorqueProfile
from railslip_ctrl.design.catalogue import published_controller, published_reference
from railslip_ctrl.identification.logs import find_columns
from railslip_ctrl.model.numeric import adhesion_coefficient
from railslip_ctrl.report.simulation import CSV_COLUMNS, write_simulation_csv
from railslip_ctrl.report.stops import as_run
from railslip_ctrl.simulation import built_in_scenario, simulate
from railslip_ctrl.simulation.campaign.specification import load_campaign

DESIGNS = Path(__file__).resolve().parent.parent / "designs"
SCENARIOS, CONTROLLERS = DESIGNS / "scenarios", DESIGNS / "controllers"


@pytest.fixture
def toml(file):
    return lambda text, name="mine.toml": file(name, text)


def test_the_published_scenario_by_name_and_as_a_file():
    assert load_scenario(SCENARIOS / "park2008.toml") == sim.built_in_scenario("park2008") == load_scenario("park2008")
    with pytest.raises(InputError, match="choose one of park2008, park2008-si, stop, or give a TOML file"):
        load_scenario("park2007")


def test_the_leaf_patch_takes_its_adhesion_away_and_gives_it_back():
    scenario = load_scenario(SCENARIOS / "leaf_patch.toml")
    assert scenario.vehicle.mass == pytest.approx(68_000 / 6)  # kg, railtoolkit, six axles
    run = sim.simulate(scenario, SlideProtection(), seed=None)
    assert run.stopped
    place, slip, force = run.signals.distance, run.signals.slip, run.signals.adhesion_force
    law = published_law("curve", Rail.DRY, 100.0, scenario.vehicle.wheel_load)
    inside, outside = (place > 120.01) & (place < 219.99), (place < 119.99) | (place > 220.01)  # a sample is < 0.03 m
    assert inside.sum() > 300
    for where, there in ((inside, law.weakened(0.45)), (outside, law)):
        # the coefficient at a load of 1 N is the force; the run reads it from a table good to 1e-9 of its 3e4 N
        expected = np.sign(slip[where]) * adhesion_coefficient(there, 1.0, np.abs(slip[where]), 1.0)
        assert force[where] == pytest.approx(expected, abs=1e-3)


def test_a_file_changes_only_what_it_names_of_the_one_that_it_extends(toml):
    base = sim.built_in_scenario("park2008")
    text = 'extends = "park2008"\nstep = "2 ms"\n[disturbances]\nrandom_force = "0.5 kN"\n'
    mine = load_scenario(toml(text, "first.toml"))
    disturbances = base.disturbances.model_copy(update={"random_force": 500.0})
    assert mine == base.model_copy(update={"name": "first", "step": 0.002, "disturbances": disturbances})
    own = EVERY_FIELD[EVERY_FIELD.index("[vehicle]") :]
    mine = load_scenario(toml(f'extends = "first.toml"\nname = "second"\nrail = "wet"\n{own}'))
    assert (mine.name, mine.rail, mine.step, mine.vehicle.mass) == ("second", Rail.WET, 0.002, 3000.0)
    assert mine.events[0].mass == 4000.0  # the loaded one of its vehicle


EVERY_FIELD = """
name = "all of it"
adhesion = "bristle"
rail = "wet"
adhesion_factor = 0.9
initial_speed = "80 km/h"
final_speed = 2.0
longest_time = "2 min"
viscous_rate = -0.02
viscous_least = 0.1
step = 0.0005
published_reference = true
inertia_scale = 2.0
loaded = true
disturbances = {random_force = 100.0, caliper_frequency = "12 rad/s"}
measurement = {speed_noise = "0.1 km/h"}
limits = {torque_min = 10.0, torque_max = "8 kN*m", rate = "20 kN*m/s", dump_lag = 0.3}
events = [
  {distance = "100 m", rail = "wet", adhesion_factor = 0.5},
  {time = 10.0, rail = "dry", adhesion_factor = 0.5, mass = "3.5 t"},
]
[vehicle]
mass = "3 t"
mass_loaded = "4 t"
wheel_load = "30 kN"
wheel = {radius = "450 mm", inertia = 70.0, viscous_friction = 0.3}
actuator = {dead_time = "100 ms", lag = 0.4}
"""


def test_every_field_can_be_given(toml):
    mine = load_scenario(toml(EVERY_FIELD))
    assert (mine.vehicle.mass, mine.vehicle.inertia_scale, mine.vehicle.wheel.radius) == (4000.0, 2.0, 0.45)
    assert mine.vehicle.wheel_load == pytest.approx(40_000.0)  # loaded, in proportion to the mass
    scaled = published_law("bristle", Rail.DRY, 80.0, mine.vehicle.wheel_load)
    assert mine.adhesion.alpha == pytest.approx(2.0 * scaled.alpha)
    assert mine.disturbances.caliper_frequency == 12.0
    assert mine.limits == sim.BrakeLimits(torque_min=10.0, torque_max=8000.0, rate=20_000.0, dump_lag=0.3)
    assert mine.events == (
        sim.Event(distance=100.0, rail=Rail.WET, adhesion_factor=0.5),
        sim.Event(time=10.0, rail=Rail.DRY, adhesion_factor=0.5, mass=3500.0),
    )
    assert mine.measurement.speed_noise == pytest.approx(0.1 / 3.6)
    assert set(mine.given()) == set(sim.Scenario.model_fields)  # nothing was left out


def test_another_vehicle_takes_adhesion_and_load_with_it():
    heavy = PARK2008.model_copy(update={"wheel_load": 69_000.0, "mass_loaded": 7000.0, "inertia_scale": 3.6})
    mine = sim.built_in_scenario("park2008").for_vehicle(heavy)
    assert mine.events[0].mass == 7000.0
    assert mine.adhesion == published_law("curve", Rail.DRY, 100.0, 69_000.0)
    assert mine.has_named_law
    own = mine.with_changes(adhesion=mine.adhesion.weakened(0.9))
    assert own.for_vehicle(PARK2008).adhesion == own.adhesion


NO_LAG = "[vehicle]\nmass = 3e3\nmass_loaded = 4e3\nactuator = {dead_time = 0.1, lag = 0.0}\n"
BOTH_KINDS = 'events = [{time = 20.0, rail = "dry", adhesion_factor = 1.0}, {distance = 100.0, rail = "wet"}]'


@pytest.mark.parametrize(("text", "words"), [
    ("final_sped = 1.0", "final_sped: unknown key; did you mean 'final_speed'"),
    ('final_speed = "1 kg"', "final_speed: '1 kg' has the wrong dimension"),
    ("final_speed = 60.0", "give a value < initial_speed"),
    ("limits = 3", "limits: 3 is not allowed; give a table"),
    ("[limits]\nrat = 1.0", "limits.rat: unknown key; did you mean 'rate'"),
    ('[[events]]\nrail = "wet"', "event: .*time and distance"),
    ("[[events]]\ntime = 1.0", "give rail, adhesion_factor or mass"),
    ('vehicle = "none.toml"', "vehicle: .*no such file"),
    ("[vehicle]\nmas = 1.0", "vehicle: mas: unknown key; did you mean 'mass'"),
    ('adhesion = "bristel"', "adhesion: .*is not a law"),
    ("adhesion = 3", "adhesion: 3 is not allowed"),
    ('initial_speed = "200 km/h"', "outside 30 to 140 km/h"),
    ("step = 1e-9", "step: 1e-09 is not allowed; give a value >= 1e-05"),
    ('extends = "park2009"', "extends: .*'park2009'; choose park2008"),
    ('extends = "mine.toml"', "extends: a chain of 8 files"),
    ('extends = "none.toml"\nadhesion = "curve"\ninitial_speed = 20.0', "none.toml: no such file"),
    ('vehicle = "park2008"\nadhesion = "curve"', "initial_speed: missing"),
    ('vehicle = "park2008"\ninitial_speed = 20.0', "adhesion: missing"),
    ('adhesion = "curve"\ninitial_speed = 20.0', "vehicle: missing"),
    (f"{NO_LAG}[limits]\nrate = 100.0", "give lag > 0"),
    (f"{NO_LAG}[limits]\ndump_lag = 0.2", "give lag > 0"),
    (BOTH_KINDS, "rail and adhesion_factor in each"),
])  # fmt: skip
def test_scenario_files_are_refused_in_one_line(toml, text, words):
    alone = text.startswith(("extends", 'vehicle = "park', 'adhesion = "curve"'))
    with pytest.raises(InputError, match=words) as caught:
        load_scenario(toml(text if alone else f'extends = "park2008"\n{text}'))
    assert "\n" not in str(caught.value)
    assert "none.toml" in str(caught.value) or "mine.toml" in str(caught.value)


def test_controllers_as_files(toml):
    """The designs, [Park2008] Table 4 as printed, a schedule and a profile."""
    own, designs = catalogue.published_vehicle(), (("pi_lead", "pi-lead"), ("slide_protection", "slide-protection"))
    for name, design in designs:
        assert load_controller(CONTROLLERS / f"{name}.toml").believing(own) == catalogue.controller_named(design, own)
    pi = load_controller(toml('kind = "pi"\nkp = "650 N*m/(km/h)"\nki = "27 N*m/(km/h)/s"\nanti_windup = false\n'))
    assert (pi.kp, pi.ki, pi.anti_windup) == (pytest.approx(2340.0), pytest.approx(97.2), False)
    keys = 'K = 70\nD = "1.53 N*m/(km/h)"\nrho = 1.54\nnominal_mass = 3517\nknows_rail = false\n'
    asmc, published = load_controller(toml(f'kind = "asmc"\n{keys}')), catalogue.published_controller("asmc")
    assert math.isclose(asmc.D, published.D, rel_tol=1e-12)  # 1.53 N*m/(km/h) through Pint
    assert changed(asmc, D=published.D, knows_rail=True) == published
    schedule = catalogue.recommended_schedule()
    toml(schedule.schedule.to_json(), "schedule.json")
    text = 'kind = "scheduled"\nschedule = "schedule.json"\ntorque_max = 9000\ntorque_min = 0\ntracking_time = 2\n'
    assert load_controller(toml(text)).believing(own) == schedule
    profile = load_controller(toml('kind = "torque-profile"\ntimes = [0, 2.5]\ntorques = [0, 4000]\nperiod = 0.01\n'))
    assert profile == TorqueProfile(times=(0.0, 2.5), torques=(0.0, 4000.0), period=0.01, name="torque-profile")


def test_a_model_over_v0_is_taken_at_the_run_s_initial_speed(toml):
    over = "initial_speed_range = [60, 100]\npolynomials = {mu_max = [0.4, -0.001], a = [0.003], Kx = [3e5]}"
    toml(f'law = "beam"\n{over}', "law.toml")
    path = toml('kind = "asmc"\nK = 70\nD = 5.5\nrho = 1.54\nadhesion = "law.toml"\n', "controller.toml")
    with pytest.raises(InputError, match=r"controller\.toml: .*law\.toml: polynomials .*initial speed"):
        load_controller(path)
    for speed_kmh in (60.0, 80.0):
        law = load_controller(path, initial_speed=speed_kmh / 3.6).model_law
        assert law.mu_max == pytest.approx(0.4 - 0.001 * speed_kmh, rel=1e-12)  # km/h to m/s and back
    toml('extends = "park2008"\ninitial_speed = "70 km/h"\n', "slow.toml")
    text = 'scenario = "slow.toml"\nruns = 1\n[[controller]]\ncontroller = "controller.toml"\n'
    (controller,) = load_campaign(toml(text, "campaign.toml")).controllers
    assert controller.model_law.mu_max == pytest.approx(0.33, rel=1e-12)


@pytest.mark.parametrize(("record", "given", "positive"), [
    (PI, {"kp": 1.0, "ki": 1.0, "lead_filter": 0.5}, {"tracking_time", "radius"}),
    (Sliding, {"K": 1.0, "D": 1.0, "rho": 1.0}, {"D", "rho", "filter_time", "radius", "wheel_inertia", "wheel_load",
        "inertia_scale", "nominal_mass"}),
    (SlideProtection, {"fill_slip": 1e-10}, {"fill_slip", "dump_slip", "dump_deceleration", "fill_rate", "dump_rate",
        "torque_max", "filter_time", "radius"}),
    (sim.Beliefs, {}, {"radius", "wheel_inertia", "wheel_load"}),
    (sim.Disturbances, {}, {"random_hold"}),
    (sim.Measurement, {}, {"speed_scale"}),
    (sim.BrakeLimits, {"torque_min": -1.0, "torque_max": 1.0}, {"rate", "dump_lag", "torque_gain"}),
])  # fmt: skip
def test_numbers_of_files_are_not_negative_and_some_are_positive(record, given, positive):
    any_sign = {"kp", "ki", "torque_min", "torque_max", "initial_torque", "hand_over_torque"}
    fields = {name: info.json_schema_extra for name, info in record.model_fields.items() if name != "period"}
    for name in (name for name, extra in fields.items() if isinstance(extra, dict) and "unit" in extra):
        for value in (1.0 if name == "encoder_teeth" else 1e-9, 0.0, -1e-9):
            if value > 0.0 or (name not in positive and (value == 0.0 or name in any_sign)):
                assert getattr(record(**{**given, name: value}), name) == value
            else:
                with pytest.raises(ValueError, match=name):
                    record(**{**given, name: value})


S = ct.tf("s")
HELD = ReferenceSlip(dry=0.1317, wet=0.0923)
NOTCHED = 240.123456789 * (1 + 0.02 / S) * (0.6 * S + 1) / (0.05 * S + 1) * (S**2 + S + 400) / (S + 20) ** 2
ALL = {"torque_min": 0.0, "torque_max": 9000.1, "tracking_time": 1.0 / 3.0, "initial_torque": 1500.7, "radius": 0.41}
ALL |= {"hand_over_speed": 5.0 / 3.6, "hand_over_torque": 1111.1}
ADAPTIVE = published_controller("asmc", adaptive=True, knows_rail=False)
made = partial(linear_control, reference=HELD, name="mine")
CONTROLS = {
    "pi": made(PIController(PIGains(kp=1.0 / 3.0, ki=0.0))),
    "pi-lead": made(PIController(PIGains(kp=229.1, ki=5.3), 0.6, 0.06), **{**ALL, "name": 'a "b" ä', "period": 0.02}),
    "pid": made(PIController(PIGains(kp=229.1, ki=5.3), 0.6, 0.06), kind=PID, period=None, rule="backward"),
    "filtered": made(PIController(PIGains(kp=229.1, ki=5.3), 0.0, 0.06)),
    "transfer function": made(NOTCHED, rule="tustin", **ALL),
    "state space": made(ct.tf2ss(NOTCHED), **ALL),
    "factored": made(ct.zpk([-1.0], [0.0, -3.0], 7.0), anti_windup=False),
    "discrete": made(ct.sample_system(NOTCHED, 0.02, "tustin")),
    "a number": made(300.0),
    "scheduled": changed(catalogue.recommended_schedule(), torque_max=9000.1, tracking_time=1.0 / 3.0),
    "asmc": changed(ADAPTIVE, box=((-1e-5, 0.1), (0.0, 1.0 / 3.0))),
    "slide protection": SlideProtection(name="mine", reference=HELD, fill_slip=0.1 / 3.0),
    "seeking": Seeking.for_vehicle(PARK2008, name="mine", period=0.005),
    "torque profile": TorqueProfile(name="mine", times=(0.0, 1.0 / 3.0), torques=(0.0, 4000.1)),
}


@pytest.mark.parametrize("name", CONTROLS)
def test_what_is_saved_is_loaded_again(tmp_path, name):
    path = tmp_path / "c.toml"
    CONTROLS[name].save(path)
    assert load_controller(path) == CONTROLS[name]


PUBLISHED = published_reference("bristle")
STATES = {
    "A = []\nB = []\nC = []\nD = 0.5": ((), (), (), 0.5),
    "A = -1\nB = 2\nC = 3": (((-1.0,),), (2.0,), (3.0,)),
    "a = [[0, 1], [-1, -2]]\nb = [[0], [1]]\nc = [[3, 4]]\nd = [[5]]": (((0, 1), (-1, -2)), (0, 1), (3, 4), 5.0),
}
DESIGN = PIController(PIGains(kp=0.5, ki=0.5))


@pytest.mark.parametrize(("text", "control"), [
    ('kind = "pi"\nkp = 0.5\nki = 0.5', PI(kp=0.5, ki=0.5, name="pi")),
    ('kind = "pi"\nkp = 0.5\nki = 0.5',
     linear_control(DESIGN, reference=PUBLISHED, name="pi", period=None, rule="backward")),
    ('kind = "asmc"\nK = 0.5\nD = 0.5\nrho = 0.5\nnominal_mass = 0.5\nfilter_time = 0.5',
     Sliding(K=0.5, D=0.5, rho=0.5, reference=PUBLISHED, nominal_mass=0.5, filter_time=0.5, name="asmc")),
    ('kind = "slide-protection"\nfill_rate = 0.5\ntorque_max = 0.5\nfilter_time = 0.5\ndump_slip = 0.3',
     SlideProtection(fill_rate=0.5, torque_max=0.5, filter_time=0.5, dump_slip=0.3, name="slide-protection")),
    *((f'kind = "state-space"\n{text}',
       linear_control(StateSpaceController(*own), reference=PUBLISHED, name="state-space", period=0.01))
      for text, own in STATES.items()),
])  # fmt: skip
def test_what_a_file_leaves_out_is_the_controller_s_own(toml, text, control):
    assert load_controller(toml(text)) == control


def test_what_has_no_file_is_told(tmp_path):
    for control, told in (
        (made(NOTCHED, period=None), "period: .* 0.01; give a value"),
        (SlideProtection(period=None), "period: .* 0.01; give a value"),
        (changed(CONTROLS["pi"], reference=None), "reference: .* dry=0.132 wet=0.092; give a value"),
    ):
        with pytest.raises(InputError, match=told):
            control.save(tmp_path / "c.toml")
    with pytest.raises(InputError, match="cannot be written"):
        CONTROLS["pi"].save(tmp_path / "none" / "c.toml")
    curve, slips = published_law("curve", "dry"), [ReferenceSlip(dry=dry, wet=0.07) for dry in (0.08, 0.1)]
    design = rs.tune(rs.Envelope(laws=[curve.model_copy(update={"reference": slip}) for slip in slips], speeds=100))
    with pytest.raises(InputError, match="different reference slips"):
        design.save(tmp_path / "c.toml")
    assert rs.simulate(rs.stop(), design).controller.reference.dry == 0.132  # the law's of the run


GIVEN = 'kind = "pi"\nkp = 1.0\nki = 1.0'
TF, SS = 'kind = "transfer-function"', 'kind = "state-space"'


@pytest.mark.parametrize(("text", "told"), [
    (f"{TF}\nnum = [1.0]", "den: missing"),
    (f"{TF}\nnum = [1.0, 0.0]\nden = [1.0]", "not proper"),
    (f"{TF}\nnum = [1.0]\nden = [0.001, 1.0]", "pole of 1000 1/s; give a value <= 0.002"),
    (f"{TF}\nnum = []\nden = [1.0]", "num: the list is empty"),
    (f"{SS}\nA = [[0.0]]\nB = [1.0, 2.0]\nC = [1.0]", "do not fit"),
    (f"{SS}\nA = [[0.0, 1.0], [2.0]]\nB = [1.0, 2.0]\nC = [1.0, 2.0]", "A: some rows have 1 numbers, others 2"),
    (f"{SS}\nA = [0.0, 1.0]\nB = [1.0, 2.0]\nC = [1.0, 1.0]", "mine.toml: A: "),
    (f"{SS}\nA = [[0.0]]\nB = [[1.0, 2.0]]\nC = 1.0", "mine.toml: B: "),
    (f"{SS}\nA = [[0.0]]\nB = 1.0\nC = [[1.0], [2.0]]", "mine.toml: C: "),
    (f"{SS}\nA = 1.0\na = 1.0\nB = 1.0\nC = 1.0", "A, B, C, D: "),
    ('kind = "pi-lead"\nkp = 1.0\nki = 1.0', "lead: missing"),
    ("kind = 3", "kind: 3 is "),
    ("kp = 1.0", "missing; choose one of asmc"),
    ('kind = "pi-led"', "did you mean 'pi-lead'"),
    (f'{GIVEN}\nrule = "euler"', "rule: 'euler' is not allowed; give 'tustin' or"),
    (f"{GIVEN}\nled = 0.6", "led: unknown key; did you mean 'lead'"),
    (f"{GIVEN}\nlead = 0.6", "lead filter: 0 s"),
    ('kind = "pi"\nkp = "1 kg"\nki = 1.0', "kp: '1 kg' has the wrong dimension"),
    (f"{GIVEN}\nperiod = 1e-9", "period: 1e-09 is not allowed"),
    ('kind = "asmc"\nK = 1.0\nD = 1.0\nrho = 1.0\nadhesion = "curve"', "is not a TOML file"),
    ('kind = "slide-protection"\nfill_slip = 0.5', "fill_slip < dump_slip < 1"),
    ('kind = "torque-profile"\ntimes = [0]\ntorques = []', "1 times and 0 torques"),
    (f"{GIVEN}\ntorque_hi = 1.0", "period, reference, radius, torque_min, torque_max, anti_windup"),
    (f"{GIVEN}\ntorque_min = 1.0\ntorque_max = 1.0", "give a value > torque_min = 1"),
    (f"{GIVEN}\ntorque_high = 2.0", "torque_high: unknown key; did you mean"),
    (f"{GIVEN}\ncut_out_speed = 2.0", "cut_out_speed: unknown key"),
])  # fmt: skip
def test_a_file_that_is_wrong_is_told(toml, text, told):
    with pytest.raises(InputError, match=r"mine\.toml: ") as caught:
        load_controller(toml(text))
    assert (told in str(caught.value), "\n" in str(caught.value)) == (True, False)


CASE = ("--adhesion", "bristle", "--rail", "dry", "--speed", "100")
WHEEL = rs.plant_at("bristle", PARK2008, Rail.DRY, 100.0)


def test_margins_of_a_transfer_function_through_the_command(railslip, toml):
    """PI, lead and a second-order part: by NumPy on a fine grid of frequencies."""
    c = 240 * (S + 0.02) / S * (0.6 * S + 1) / (0.06 * S + 1)
    c = c * (S**2 + 25 * S + 625) / (S**2 + 45 * S + 2000) * 3.2
    num, den = c.num[0][0].tolist(), c.den[0][0].tolist()
    path = toml(f'kind = "transfer-function"\nnum = {num}\nden = {den}\nperiod = "1 ms"\ntorque_max = "9 kN*m"\n')
    status, out, _ = railslip("margins", *CASE, "--controller", path, "--json")
    (found,) = json.loads(out)["cases"]
    assert (status, found["stable"], found["sampled"]["period_s"]) == (0, True, 0.001)
    s = 1j * np.geomspace(1e-3, 1e3, 4000)
    states = np.linalg.solve(s[:, None, None] * np.eye(len(WHEEL.A)) - WHEEL.A, np.tile(WHEEL.B, (s.size, 1, 1)))
    sigma = states[:, :, 0] @ WHEEL.C[WHEEL.outputs.index("sigma")]
    response = c(s) * sigma / (0.6 * s + 1) * np.exp(-0.15 * s)
    # the peak of a grid of 4 000 frequencies lies at most 1e-5 below the true one
    assert np.max(1 / np.abs(1 + response)) == pytest.approx(found["ms"], rel=1e-4)
    assert found["sampled"]["ms"] == pytest.approx(found["ms"], rel=5e-3)  # nearly the continuous loop


def test_a_file_is_judged_at_the_slip_that_it_holds_unless_told(railslip, toml):
    path = toml('kind = "pi"\nkp = 190\nki = 5\nreference = { dry = 0.07, wet = 0.05 }\n')
    for words, slips in (((), [0.07, 0.05]), (("--slip", "0.1"), [0.1, 0.1])):
        cases = json.loads(railslip("margins", "--controller", path, *words, "--json")[1])["cases"]
        assert [case["slip"] for case in cases] == slips


@pytest.mark.long
def test_what_tune_writes_is_the_same_controller_in_every_command(railslip, tmp_path):
    file = tmp_path / "best.toml"
    case = ("--adhesion", "curve", "--speed", "60", "--speed", "100", "--slip", "0.1")
    words = ("--structure", "pi-lead", "--ms-max", "2", "--envelope", "default", "--out", file, "--json")
    tuned = json.loads(railslip("tune", *case, *words)[1])
    judged = json.loads(railslip("margins", *case, "--envelope", "default", "--controller", file, "--json")[1])
    assert judged["worst"] == tuned["worst"]
    envelope = rs.Envelope(laws="curve", speeds=(60, 100), reference={"dry": 0.1, "wet": 0.1})
    best = rs.tune(envelope, structure="pi-lead", ms_max=2.0)
    assert (tuned["kp_si"], tuned["ki_si"], len(tuned["cases"])) == (best.controller.kp, best.controller.ki, 8)
    as_reported = as_run(best.controller.system, best.judgement, 60.0, "best")
    assert as_reported.toml == file.read_text("utf-8")
    loads = (rs.PARK2008, rs.PARK2008.loaded())
    cases = itertools.product(("dry", "wet"), (60, 100), loads)
    points = (rs.operating_point(rs.published_law("curve", r), car, v / 3.6, 0.1, rail=r) for r, v, car in cases)
    takes = [point.brake_torque for point in points]
    assert as_reported.initial_torque == as_reported.hand_over_torque == pytest.approx(0.8 * min(takes), rel=1e-12)
    wet = rs.stop(rail="wet")
    stop = ("--scenario", "stop", "--rail", "wet", "--seed", "3", "--controller", file, "--json")
    expected = rs.simulate(wet, best, seed=3, record_every=None)
    assert json.loads(railslip("simulate", *stop)[1])["braking_distance_m"] == expected.braking_distance
    many = rs.campaign(wet, [best, rs.load_controller(file)], runs=3).controllers
    tuned_runs, file_runs = (many[name].measures["braking_distance_m"].moments for name in ("pi-lead", "best"))
    assert tuned_runs == file_runs


@pytest.fixture
def simulated(railslip, file):
    return partial(railslip, "simulate")


def energy(mass, speed_kmh):
    return pytest.approx(0.5 * (mass + 60.35 / 0.43**2) * (speed_kmh / 3.6) ** 2)


SI = "--scenario park2008-si"
TABLE_4 = {"kp_si": 2340.0, "ki_si": 97.2, "lead_s": 0.0, "lead_filter_s": 0.0}
GAINS = {"kp_si": 190.0, "ki_si": 5.0, "lead_s": 0.0, "lead_filter_s": 0.0}
ENDLESS = "--scenario free.toml --controller"
NONE = dict.fromkeys(("braking_time_s", "braking_distance_m", "brake_energy_j", "mean_abs_slip_error"))
CASES = [
    ("", {"scenario": "park2008", "controller": "pi", "gains": "bristle", "seed": 0, "inertia_scale": 3.6}),
    ("--gains beam --seed 7", {"gains": "beam", "seed": 7}),
    (f"{SI} --inertia-scale 3.6", {"braking_time_s": pytest.approx(59.0, abs=1.0), "gain_values": TABLE_4}),
    ("--no-noise", {"seed": None, "random_force_j": 0.0}),
    (f"{SI} --kp 190 --ki 5 --step 2e-3", {"gain_values": GAINS, "gains": None, "step_s": 2e-3, "inertia_scale": 1.0}),
    (f"{SI} --period 0.01 --slip 0.1", {"period_s": 0.01, "reference_slip": {"dry": 0.1, "wet": 0.1}}),
    (f"{SI} --controller asmc --speed 80", {"starting_j": energy(3517, 80)}),
    ("--adhesion beam --controller pi-lead", {"adhesion": "beam", "reference_slip": {"dry": 0.119, "wet": 0.059}}),
    ("--adhesion bristle --no-noise", {"adhesion": "bristle", "reference_slip": {"dry": 0.132, "wet": 0.092}}),
    ("--controller asmc", {"max_slip": pytest.approx(0.4, abs=0.2), "first_lock_s": None}),
    ("--controller asmc --unknown-rail", {"max_slip": 1.0, "first_lock_s": pytest.approx(54.6, abs=1)}),
    ("--vehicle train.toml --loaded", {"vehicle": "train", "inertia_scale": 1.0, "starting_j": energy(4000, 100)}),
    (f"{ENDLESS} huge.toml", {**NONE, "stopped": False, "outcome": "not a number"}),
]


@pytest.mark.parametrize(("words", "expected"), CASES)
def test_options_reach_the_run(simulated, file, words, expected):
    file("train.toml", "mass = 3000\nmass_loaded = 4000\n")
    file("free.toml", 'extends = "park2008"\n[limits]\ntorque_min = -1e308\n')
    file("huge.toml", 'kind = "torque-profile"\ntimes = [0, 1]\ntorques = [0, -1e308]\n')
    status, out, err = simulated(*words.split(), "--json")
    found = json.loads(out)
    assert status == (0 if expected.get("stopped", True) else 1), err
    assert {name: (found | found["energy_balance"])[name] for name in expected} == expected
    if "train" in words:
        assert re.search(r"inertia scale 1 .*\b3\.6", err)
        assert "No travelling resistance is given" in err
        assert f"mass 4000 kg, wheel load {4000 * 9.80665:g} N" in simulated(*words.split())[1]
    if not found["stopped"]:
        assert f"NO STOP: {found['outcome']}, after" in simulated(*words.split())[1]


def test_json_has_the_contract_s_keys_and_the_run_s_numbers(simulated):
    found = json.loads(simulated("--scenario", "park2008", "--gains", "beam", "--seed", "7", "--json")[1])
    keys = "braking_time_s braking_distance_m brake_energy_j mean_abs_slip_error max_slip locked_fraction max_torque_nm"
    assert found.keys() >= {*keys.split(), "scenario", "controller", "gains", "inertia_scale", "seed", "stopped"}
    run = simulate(built_in_scenario("park2008"), published_controller("pi", "beam"), seed=7)
    for name in ("braking_time_s", "braking_distance_m", "mean_abs_slip_error", "mean_abs_slip_error_published"):
        assert found[name] == getattr(run, name.removesuffix("_s").removesuffix("_m"))
    assert found["mean_abs_slip_error_published"] != found["mean_abs_slip_error"]  # 0.119/0.059 is held


def test_the_csv_is_the_record(tmp_path):
    run = simulate(built_in_scenario("park2008-si"), published_controller("asmc"), seed=2, record_every=10)
    write_simulation_csv(run, tmp_path / "run.csv", internal=True)
    back = pd.read_csv(tmp_path / "run.csv")
    assert tuple(CSV_COLUMNS) == sim.Signals._fields
    assert list(back)[: len(CSV_COLUMNS)] == list(CSV_COLUMNS.values())
    assert list(back)[len(CSV_COLUMNS) :] == [f"controller {name}" for name in run.controller_signals]
    record = pd.DataFrame({**run.signals._asdict(), **run.controller_signals})
    # 12 digits are written
    np.testing.assert_allclose(back.to_numpy(), record.to_numpy(), rtol=1e-11, atol=1e-300)
    found = find_columns(list(back))  # as `railslip identify` reads it
    units = {"time": "s", "train_speed": "m/s", "wheel_angular_speed": "rad/s", "brake_torque": "N*m"}
    headers = {name: f"{name.replace('_', ' ')} [{unit}]" for name, unit in units.items()}
    assert {name: column.header for name, column in found.items()} == headers


@pytest.mark.parametrize("log_period", ["0.01", "2.5"])
def test_events_are_told_in_order_of_happening(simulated, file, log_period):
    own = "{distance = 1e5, mass = 5e3}, {time = 9, mass = 4e3}, {distance = 100, mass = 3800}, {time = 1, mass = 3700}"
    file("events.toml", f'extends = "park2008-si"\nrail = "wet"\nevents = [{own}]')
    signals = simulate(load_scenario("events.toml"), published_controller("pi"), seed=0).signals
    at = np.interp(100.0, signals.distance, signals.time)  # rows every 1 ms, the train's speed all but constant
    assert signals.mass[np.searchsorted(signals.time, at + 0.001)] == 3800.0  # as the plant had it
    arguments = ("--scenario", "events.toml", "--log-period", log_period)
    found = json.loads(simulated(*arguments, "--json")[1])["events"]
    assert [event["mass"] for event in found] == [3700.0, 3800.0, 4000.0, 5000.0]
    assert [event["reached"] for event in found] == [True, True, True, False]
    # the cubic between rows 2.5 s apart: a few ms of smooth change, and the noise in the speed at its ends
    assert found[1]["happened_at_s"] == pytest.approx(at, abs=1e-6 if log_period == "0.01" else 0.02)
    assert found[3]["happened_at_s"] is None
    lines = [line for line in simulated(*arguments)[1].splitlines() if line.startswith("Event")]
    assert [line.split()[2] for line in lines] == ["1", "100", "9", "100000"]
    assert f"(at {found[1]['happened_at_s']:.4g} s)" in lines[1]
    assert ["NOT REACHED" in line for line in lines] == [False, False, False, True]


def test_a_log_period_between_samples_is_said_and_a_folder_takes_report_series_and_pictures(simulated):
    arguments = ("--csv", "run.csv", "--log-period")
    message = simulated(*arguments, "0.0137")[2]
    assert all(fact in message for fact in ("--log-period", "0.0137 s", "rows are 0.014 s apart"))
    assert np.diff(pd.read_csv("run.csv")["time [s]"])[:-1] == pytest.approx(0.014)  # the last is the stop
    assert "--log-period" not in simulated(*arguments, "0.03")[2]
    assert "--log-period" not in simulated("--log-period", "0.0137")[2]  # nothing is written
    status, _, err = simulated("--controller", "scheduled", "--out", "run")
    assert (status, "wrote 5 files to run" in err) == (0, True)
    written = {path.name for path in Path("run").iterdir()}
    assert written == {f"simulation.{form}" for form in ("txt", "json", "csv", "png", "svg")}
