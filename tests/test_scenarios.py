"""Scenarios and controllers from files: what they read, and what they refuse in one line."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from railslip_ctrl import PARK2008, InputError, Rail, catalogue, load_scenario, published_law
from railslip_ctrl import simulation as sim
from railslip_ctrl.model.numeric import adhesion_coefficient
from railslip_ctrl.simulation.campaign.specification import load_campaign
from railslip_ctrl.simulation.controller_files import PIKeys, SlidingKeys, load_controller

DESIGNS = Path(__file__).resolve().parent.parent / "designs"
SCENARIOS, CONTROLLERS = DESIGNS / "scenarios", DESIGNS / "controllers"


@pytest.fixture
def file(tmp_path):
    """A function that writes a file and gives its path."""

    def write(text, name="mine.toml"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def test_the_published_scenario_by_name_and_as_a_file():
    assert load_scenario(SCENARIOS / "park2008.toml") == sim.built_in_scenario("park2008") == load_scenario("park2008")
    with pytest.raises(InputError, match="choose one of park2008, park2008-si, stop, or give a TOML file"):
        load_scenario("park2007")


def test_the_leaf_patch_takes_its_adhesion_away_and_gives_it_back():
    scenario = load_scenario(SCENARIOS / "leaf_patch.toml")
    assert scenario.vehicle.mass == pytest.approx(68_000 / 6)  # kg, railtoolkit, six axles
    run = sim.simulate(scenario, sim.SlideProtection(catalogue.recommended_pi_lead().reference), seed=None)
    assert run.stopped
    place, slip, force = run.signals.distance, run.signals.slip, run.signals.adhesion_force
    law = published_law("curve", Rail.DRY, 100.0, scenario.vehicle.wheel_load)
    inside, outside = (place > 120.01) & (place < 219.99), (place < 119.99) | (place > 220.01)  # a sample is < 0.03 m
    assert inside.sum() > 300
    for where, there in ((inside, law.weakened(0.45)), (outside, law)):
        # the coefficient at a load of 1 N is the force; the run reads it from a table good to 1e-9 of its 3e4 N
        expected = np.sign(slip[where]) * adhesion_coefficient(there, 1.0, np.abs(slip[where]), 1.0)
        assert force[where] == pytest.approx(expected, abs=1e-3)


def test_a_file_changes_only_what_it_names_of_the_one_that_it_extends(file):
    base = sim.built_in_scenario("park2008")
    text = 'extends = "park2008"\nstep = "2 ms"\n[disturbances]\nrandom_force = "0.5 kN"\n'
    mine = load_scenario(file(text, "first.toml"))
    disturbances = base.disturbances.model_copy(update={"random_force": 500.0})
    assert mine == base.model_copy(update={"name": "first", "step": 0.002, "disturbances": disturbances})
    own = EVERY_FIELD[EVERY_FIELD.index("[vehicle]") : EVERY_FIELD.index("[disturbances]")]
    mine = load_scenario(file(f'extends = "first.toml"\nname = "second"\nrail = "wet"\n{own}'))
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
[vehicle]
mass = "3 t"
mass_loaded = "4 t"
wheel_load = "30 kN"
wheel = {radius = "450 mm", inertia = 70.0, viscous_friction = 0.3}
actuator = {dead_time = "100 ms", lag = 0.4}
[disturbances]
random_force = 100.0
caliper_frequency = "12 rad/s"
[measurement]
speed_noise = "0.1 km/h"
[limits]
torque_min = 10.0
torque_max = "8 kN*m"
rate = "20 kN*m/s"
dump_lag = 0.3
[[events]]
distance = "100 m"
rail = "wet"
adhesion_factor = 0.5
[[events]]
time = 10.0
rail = "dry"
adhesion_factor = 0.5
mass = "3.5 t"
"""


def test_every_field_can_be_given(file):
    mine = load_scenario(file(EVERY_FIELD))
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
BOTH_KINDS = (
    '[[events]]\ntime = 20.0\nrail = "dry"\nadhesion_factor = 1.0\n[[events]]\ndistance = 100.0\nrail = "wet"\n'
)


@pytest.mark.parametrize(("text", "words"), [
    ("final_sped = 1.0", "final_sped: unknown key; did you mean 'final_speed'"),
    ('final_speed = "1 kg"', "final_speed: '1 kg' has the wrong dimension"),
    ("final_speed = 60.0", "give a value < initial_speed"),
    ("limits = 3", "limits: 3 is not allowed; give a table"),
    ("[limits]\nrat = 1.0", "limits.rat: unknown key; did you mean 'rate'"),
    ('[[events]]\nrail = "wet"', "give either time or distance"),
    ("[[events]]\ntime = 1.0", "changes nothing"),
    ('vehicle = "none.toml"', "vehicle: .*no such file"),
    ("[vehicle]\nmas = 1.0", "vehicle: mas: unknown key; did you mean 'mass'"),
    ('adhesion = "bristel"', "adhesion: .*is not a law"),
    ("adhesion = 3", "adhesion: 3 is not allowed"),
    ('initial_speed = "200 km/h"', "outside 30 to 140 km/h"),
    ("step = 1e-9", "step: 1e-09 is not allowed; give a value >= 1e-05"),
    ('extends = "park2009"', "extends: 'park2009' is not one; choose park2008"),
    ('extends = "mine.toml"', "files extend one another"),
    ('extends = "none.toml"\nadhesion = "curve"\ninitial_speed = 20.0', "none.toml: no such file"),
    ('vehicle = "park2008"\nadhesion = "curve"', "needs initial_speed"),
    ('vehicle = "park2008"\ninitial_speed = 20.0', "adhesion: missing"),
    ('adhesion = "curve"\ninitial_speed = 20.0', "vehicle: missing"),
    (f"{NO_LAG}[limits]\nrate = 100.0", "give lag > 0"),
    (f"{NO_LAG}[limits]\ndump_lag = 0.2", "give lag > 0"),
    (BOTH_KINDS, "give rail and adhesion_factor in each"),
])  # fmt: skip
def test_scenario_files_are_refused_in_one_line(file, text, words):
    alone = text.startswith(("extends", 'vehicle = "park', 'adhesion = "curve"'))
    with pytest.raises(InputError, match=words) as caught:
        load_scenario(file(text if alone else f'extends = "park2008"\n{text}'))
    assert "\n" not in str(caught.value)
    assert "none.toml" in str(caught.value) or "mine.toml" in str(caught.value)


def test_controllers_as_files(file):
    """The designs, [Park2008] Table 4 as printed, a schedule and a profile."""
    assert load_controller(CONTROLLERS / "pi_lead.toml") == catalogue.recommended_pi_lead()
    assert load_controller(CONTROLLERS / "slide_protection.toml") == catalogue.slide_protection()
    pi = load_controller(file('kind = "pi"\nkp = "650 N*m/(km/h)"\nki = "27 N*m/(km/h)/s"\nanti_windup = false\n'))
    assert (pi.design.gains.kp, pi.design.gains.ki, pi.tracking_time) == pytest.approx((2340.0, 97.2, math.inf))
    keys = 'K = 70\nD = "1.53 N*m/(km/h)"\nrho = 1.54\nnominal_mass = 3517\nknows_rail = false\n'
    asmc, published = load_controller(file(f'kind = "asmc"\n{keys}')), catalogue.published_controller("asmc")
    assert math.isclose(asmc.gains.D, published.gains.D, rel_tol=1e-12)  # 1.53 N*m/(km/h) through Pint
    assert replace(asmc, gains=published.gains, knows_rail=True) == published
    schedule = catalogue.recommended_schedule()
    file(schedule.schedule.to_json(), "schedule.json")
    text = 'kind = "scheduled"\nschedule = "schedule.json"\ntorque_max = 9000\ntorque_min = 0\ntracking_time = 2\n'
    assert load_controller(file(text)) == schedule
    profile = load_controller(file('kind = "torque-profile"\ntimes = [0, 2.5]\ntorques = [0, 4000]\nperiod = 0.01\n'))
    assert profile == sim.TorqueProfile((0.0, 2.5), (0.0, 4000.0), profile.reference, period=0.01)


OVER_V0 = (
    'law = "beam"\ninitial_speed_range = [60, 100]\npolynomials = {mu_max = [0.4, -0.001], a = [0.003], Kx = [3e5]}'
)
WITH_MODEL = 'kind = "asmc"\nK = 70\nD = 5.5\nrho = 1.54\nadhesion = "law.toml"\n'


def test_a_model_over_v0_is_taken_at_the_run_s_initial_speed(file):
    file(OVER_V0, "law.toml")
    path = file(WITH_MODEL, "controller.toml")
    with pytest.raises(InputError, match=r"controller\.toml: .*law\.toml: its parameters are polynomials"):
        load_controller(path)
    for speed_kmh in (60.0, 80.0):
        law = load_controller(path, initial_speed=speed_kmh / 3.6).model_law
        assert law.mu_max == pytest.approx(0.4 - 0.001 * speed_kmh, rel=1e-12)  # km/h to m/s and back
    file('extends = "park2008"\ninitial_speed = "70 km/h"\n', "slow.toml")
    text = 'scenario = "slow.toml"\nruns = 1\n[[controller]]\ncontroller = "controller.toml"\n'
    (controller,) = load_campaign(file(text, "campaign.toml")).controllers
    assert controller.model_law.mu_max == pytest.approx(0.33, rel=1e-12)


ANY_SIGN = {"kp", "ki", "torque_low", "torque_high", "initial_torque", "cut_out_torque", "torque_min", "torque_max"}


@pytest.mark.parametrize(("record", "given", "positive"), [
    (PIKeys, {"kind": "pi", "kp": 1.0, "ki": 1.0}, {"tracking_time"}),
    (SlidingKeys, {"kind": "asmc", "K": 1.0, "D": 1.0, "rho": 1.0}, {"D", "rho", "nominal_mass", "filter_time"}),
    (sim.Disturbances, {}, {"random_hold"}),
    (sim.Measurement, {}, set()),
    (sim.BrakeLimits, {"torque_min": -1.0, "torque_max": 1.0}, {"rate", "dump_lag"}),
])  # fmt: skip
def test_numbers_of_files_are_not_negative_and_some_are_positive(record, given, positive):
    fields = {name: info.json_schema_extra for name, info in record.model_fields.items() if name != "period"}
    for name in (name for name, extra in fields.items() if isinstance(extra, dict) and "unit" in extra):
        for value in (1e-9, 0.0, -1e-9):
            if value > 0.0 or name in ANY_SIGN or (value == 0.0 and name not in positive):
                assert getattr(record(**{**given, name: value}), name) == value
            else:
                with pytest.raises(ValueError, match=name):
                    record(**{**given, name: value})
