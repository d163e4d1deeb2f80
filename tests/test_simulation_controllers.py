"""Controllers of braking runs: their steps against the designs they are made from, and the designs' own numbers."""

import math
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from generated_code import python_law
from project import changed

from railslip_ctrl import PARK2008, PIController, PIGains, Rail, ReferenceSlip, catalogue, derive, load_scenario
from railslip_ctrl import simulation as sim
from railslip_ctrl.controllers.base import Measurement, Situation
from railslip_ctrl.controllers.braking import SURE_SHARE, braking_control, linear_control
from railslip_ctrl.controllers.linear import full_brake_torque
from railslip_ctrl.controllers.sampled import Rule
from railslip_ctrl.controllers.scheduled import GainSchedule, Scheduled, ScheduleEntry
from railslip_ctrl.controllers.slide_protection import SlideProtection
from railslip_ctrl.controllers.systems import wheel_slip_loop
from railslip_ctrl.controllers.torque_profile import TorqueProfile
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.design.schedule import plant_at
from railslip_ctrl.design.specification import family_margins
from railslip_ctrl.model.numeric import adhesion_table, numeric_plant, plant_parameters
from railslip_ctrl.report.stops import braked
from railslip_ctrl.simulation.run import kernel
from railslip_ctrl.sliding.law import gain_parameters
from railslip_ctrl.sliding.sampled_law import LARGEST

SCENARIO = sim.built_in_scenario("park2008")
REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)
RADIUS = SCENARIO.vehicle.wheel.radius
PERIOD = 0.01


class Stepped:
    def __init__(self, controller, rail=Rail.DRY):
        law, own = SCENARIO.law(rail), controller.believing(SCENARIO.vehicle)
        self.module = kernel(type(law), own.source_text(), compiled=False)
        start = own.start(SCENARIO.initial_speed, PERIOD)
        self.c = np.array([*own.row(Situation(rail, PERIOD, law), start), math.nan])
        self.x = np.array(own.flat(start))

    def __call__(self, v, omega, applied, table=None, t=0.0):
        return self.module.command(self.x, t, v, omega, applied, self.c, table)


class Plain:
    def __init__(self, controller, rail=Rail.DRY):
        own = controller.believing(SCENARIO.vehicle)
        numbers = own.parameters(Situation(rail, PERIOD, SCENARIO.law(rail)))
        held = math.nan if own.reference is None else own.reference.on(rail)
        self.parameters, self.own = SimpleNamespace(**numbers, period=PERIOD, reference_slip=held), own
        start = own.start(SCENARIO.initial_speed, PERIOD)
        fields = {name: getattr(start, name) for name in own.state_fields()}
        self.state = SimpleNamespace(**{n: list(v) if isinstance(v, tuple) else v for n, v in fields.items()})

    def __call__(self, v, omega, applied, t=0.0):
        return self.own.step(self.state, Measurement(t, v, omega, applied), self.parameters)

    @property
    def x(self):
        return np.array(self.own.flat(self.state))


def measured(count, seed):
    """Train speeds falling, m/s, and wheel speeds scattered around slip, rad/s."""
    rng = np.random.default_rng(seed)
    v = np.linspace(27.0, 2.0, count)
    return zip(v.tolist(), (v * (1 - rng.uniform(-0.2, 0.6, count)) / RADIUS).tolist(), strict=True)


@pytest.mark.parametrize("rule", list(Rule))
@pytest.mark.parametrize("tracking_time", [None, 0.5, math.inf])
@pytest.mark.parametrize("lead", [(0.0, 0.0), (0.6, 0.06)])
def test_linear_control_is_the_sampled_controller(rule, tracking_time, lead):
    windup = {"anti_windup": False} if tracking_time == math.inf else {"tracking_time": tracking_time}
    given = {"torque_min": 0.0, "torque_max": 5000.0, "rule": rule, **windup}
    control = linear_control(PIController(PIGains(kp=900.0, ki=700.0), *lead), reference=REFERENCE, **given)
    step, sampled = Stepped(control), control.sampled(PERIOD)
    x = sampled.start()
    limited, applied = 0, 0.0
    for v, omega in measured(400, seed=3):
        torque = sampled.step(x, REFERENCE.dry * v - (v - RADIUS * omega), applied)
        assert step(v, omega, applied) == torque
        assert np.array_equal(step.x, control.flat(x))
        limited += torque in (0.0, 5000.0)
        applied = min(torque, 4000.0)  # the brake's own limit, below the controller's
    assert 20 < limited < 390
    assert step(math.nan, 40.0, 1234.0) == 1234.0  # a sample that is not finite is left out
    assert np.array_equal(step.x, control.flat(x))


@pytest.mark.parametrize("rail", list(Rail))
@pytest.mark.parametrize(
    "controller",
    [
        *(catalogue.controller_named(name, SCENARIO.vehicle) for name in catalogue.NAMES if name != "asmc"),
        changed(catalogue.recommended_pi_lead(), hand_over_speed=8.0, hand_over_torque=1500.0),
        TorqueProfile(times=(0.5, 1.0, 2.0), torques=(100.0, 2000.0, 500.0)),
    ],
    ids=lambda controller: controller.label,
)
def test_a_kernel_s_step_is_the_one_that_is_written(controller, rail):
    step, plain, applied = Stepped(controller, rail), Plain(controller, rail), 0.0
    for k, (v, omega) in enumerate(measured(400, seed=11)):
        seen = math.nan if k == 200 else omega
        command = step(v, seen, applied, t=k * PERIOD)
        assert command == plain(v, seen, applied, t=k * PERIOD)
        assert np.array_equal(step.x, plain.x, equal_nan=True)  # a missing sample is in a filter for good
        applied = min(command, 4000.0)


@pytest.mark.parametrize("rail", list(Rail))
@pytest.mark.parametrize("tracking_time", [None, 2.0])
def test_scheduled_control_takes_over_without_a_bump(rail, tracking_time):
    """Against [Astrom1997] 8's PI behind a lead, its integral set anew by the gains of each sample's speed."""
    entries = [(Rail.DRY, 20.0, 300.0, 150.0), (Rail.DRY, 60.0, 900.0, 400.0), (Rail.WET, 40.0, 500.0, 0.0)]
    made = tuple(ScheduleEntry(r, v, PIGains(kp=kp, ki=ki), 2.0) for r, v, kp, ki in entries)
    schedule = GainSchedule(made, 0.6, 0.06, 5.0, 2.0)
    given = {"torque_min": 0.0, "torque_max": 5000.0, "tracking_time": tracking_time}
    control = Scheduled(schedule=schedule, reference=REFERENCE, **given)
    step = Stepped(control, rail)
    held, applied = (REFERENCE.dry if rail is Rail.DRY else REFERENCE.wet), 0.0
    before = lagged = unlimited = 0.0
    for v, omega in measured(300, seed=5):
        error = held * v - (v - RADIUS * omega)
        # backward differences of 0.06 f' + f = 0.6 e' + e and I' = ki f
        filtered = (0.06 * lagged + 0.6 * (error - before) + PERIOD * error) / (0.06 + PERIOD)
        gains = schedule.controller(v, rail).gains
        tracking = max(PERIOD, gains.kp / gains.ki) if tracking_time is None and gains.ki else tracking_time or math.inf
        share = PERIOD / tracking if gains.ki else 0.0
        integral = unlimited - gains.kp * lagged + gains.ki * PERIOD * filtered + share * (applied - unlimited)
        unlimited, before, lagged = gains.kp * filtered + integral, error, filtered
        torque = min(max(unlimited, 0.0), 5000.0)
        # sums of numbers up to 1e5 in another order, of some hundred samples
        assert step(v, omega, applied) == pytest.approx(torque, rel=1e-10, abs=1e-7)
        applied = torque
    dry = Scheduled(schedule=replace(schedule, entries=made[:2]), reference=REFERENCE)
    with pytest.raises(InputError, match="no entries for wet rail"):
        sim.Simulator(SCENARIO, dry)


def test_sliding_control_is_the_derived_law_with_the_plant_s_adhesion():
    control = catalogue.published_controller("asmc", "bristle", adaptive=True)
    step = Stepped(control)
    law, module = SCENARIO.law(Rail.DRY), python_law(derive())
    table, scale = adhesion_table(law, SCENARIO.vehicle.wheel_load), SCENARIO.vehicle.inertia_scale
    p = module.Parameters(
        J=scale * 60.35, r=RADIUS, Mn=scale * 3517.0, Bn=scale * 0.25, lambda_d=REFERENCE.dry, filter_time=0.1,
        torque_min=-LARGEST, torque_max=LARGEST, period=PERIOD,
        **gain_parameters(catalogue.published_law_gains("bristle", adaptive=True)),
    )  # fmt: skip
    state = module.start(SCENARIO.initial_speed)
    force, parameters = numeric_plant(type(law)).force, plant_parameters(law, SCENARIO.vehicle)
    for v, omega in measured(200, seed=7):
        Ta = float(RADIUS * force(v, v - RADIUS * omega, 0.0, 0.0, 0.0, 0.0, parameters))
        torque = module.law_step(state, v, omega, Ta, p)
        # the kernel reads the curve from its table, good to 1e-9 of its peak of 1e4 N
        assert step(v, omega, 0.0, table) == pytest.approx(torque, rel=1e-9, abs=1e-4)
        assert step.x == pytest.approx([getattr(state, name) for name in control.state_fields()], rel=1e-9, abs=1e-12)


def test_slide_protection_dumps_holds_and_fills_by_slip_and_deceleration():
    """By hand, at a deceleration of the wheel: 158.24 N*m a sample down, 9.89 N*m up, from 0 to 9 000 N*m; it dumps by
    deceleration where there is some slip, and fills where there is none."""
    cases = (
        *((500.0, 0.3, 0.0, 1, -1.0, 341.76), (150.0, 0.3, 0.0, 1, -1.0, 0.0), (500.0, 0.1, 0.0, 1, 0.0, 500.0)),
        *((8995.0, 0.01, 0.0, 1, 1.0, 9000.0), (500.0, 0.0, 3.0, 30, 1.0, 796.7), (5e3, 0.0, 8.0, 4, 1.0, 5039.56)),
        (5e3, 0.1, 40.0, 2, -1.0, 4841.76),
    )
    for torque, slip, deceleration, samples, valve, expected in cases:
        step, rim = Stepped(SlideProtection()), 20.0
        step.x[0] = torque
        for _ in range(samples):
            rim -= deceleration * PERIOD
            step(rim / (1.0 - slip), rim / RADIUS, torque)
        assert (step.x[3], step.x[0]) == (valve, pytest.approx(expected, abs=1e-9)), (torque, slip, deceleration)


@pytest.mark.parametrize("vehicle", [catalogue.published_vehicle(), PARK2008], ids=["as published", "SI"])
def test_the_stored_designs_keep_what_they_say(vehicle):
    margins = catalogue.margins_over_points(catalogue.recommended_pi_lead(vehicle), vehicle)
    assert (margins.stable.all(), margins.ms.size) == (True, 24)
    assert 0.99 * catalogue.MS_MAX < margins.ms.max() <= catalogue.MS_MAX
    schedule, loads = catalogue.recommended_schedule(vehicle).schedule, (vehicle, vehicle.loaded())

    def loops(rail, speed):
        controller = schedule.controller(speed / 3.6, rail)
        return [wheel_slip_loop(plant_at("curve", car, rail, speed), controller, vehicle.actuator) for car in loads]

    entries = [family_margins(loops(e.rail, e.speed_kmh)).ms.max() for e in schedule.entries]
    assert entries == pytest.approx([catalogue.MS_MAX] * 8, rel=0.005)  # the gains are rounded to 1 in about 1000
    between = family_margins([loop for rail in Rail for v in np.linspace(20, 100, 25) for loop in loops(rail, v)])
    assert between.ms.max() == pytest.approx(schedule.worst_ms, rel=0.003)
    low = schedule.lowest_speed_kmh
    held = [all(loop.is_stable() for rail in Rail for loop in loops(rail, share * low)) for share in (0.99, 1.01)]
    assert held == [False, True]


@pytest.mark.long
def test_designs_follow_another_vehicle():
    slow = PARK2008.actuator.model_copy(update={"dead_time": 1.5})
    heavier = {"mass_loaded": 6000.0, "wheel_load": 69_000.0, "wheel_load_loaded": 69_000.0}
    heavy = PARK2008.model_copy(update={**heavier, "actuator": slow})
    assert full_brake_torque(heavy) == pytest.approx(18_000.0)
    lighter = heavy.model_copy(update={"wheel_load": 40_000.0})  # by its load when loaded
    assert full_brake_torque(lighter) == pytest.approx(18_000.0)
    rates = [SlideProtection.for_vehicle(car).fill_rate * (car.actuator.dead_time + 0.6) for car in (heavy, PARK2008)]
    assert rates[0] == pytest.approx(2 * rates[1])  # by wheel load, over dead time and lag
    with pytest.raises(InfeasibleDesignError, match="give its gains"):
        catalogue.recommended_pi_lead(heavy)  # the slip runs away faster than that brake can act


@pytest.mark.parametrize("name", ["seeking", "slide-protection"])
def test_gains_and_the_bound_of_a_stop_are_those_of_the_vehicle_whatever_its_load(name, tmp_path):
    (tmp_path / "loaded.toml").write_text('extends = "stop"\nloaded = true\n[vehicle]\nmass = 4e3\nmass_loaded = 7e3\n')
    scenario = load_scenario(tmp_path / "loaded.toml")
    car = scenario.vehicle.empty()
    assert (car.mass, scenario.vehicle.mass) == (4e3, 7e3)
    own = catalogue.controller_named(name, car)
    assert catalogue.controller_named(name, scenario.vehicle) == own
    controls = (own, catalogue.recommended_pi_lead())
    limits = [braked(sim.stop(one), control).limits for one in (car, car.loaded()) for control in controls]
    assert {limit.torque_max for limit in limits} == {full_brake_torque(car)}


@pytest.mark.parametrize("name", catalogue.NAMES)
def test_every_named_controller_has_its_reference_and_period(name):
    held = ReferenceSlip(dry=0.05, wet=0.04)
    controller = catalogue.controller_named(name, catalogue.published_vehicle(), reference=held, period=0.005)
    assert (controller.reference, controller.period) == (held, 0.005)


PI, ASMC = catalogue.published_controller("pi"), catalogue.published_controller("asmc")


@pytest.mark.parametrize(("call", "words"), [
    (lambda: catalogue.controller_named("asmcc", PARK2008), "did you mean 'asmc'"),
    (lambda: catalogue.published_controller("pid"), "give 'pi' or 'asmc'"),
    (lambda: catalogue.published_controller("pi", "dahl"), "give 'beam' or 'bristle'"),
    (lambda: catalogue.published_controller("pi", adaptive=True), "choose 'asmc'"),
    (lambda: TorqueProfile(times=(0.0, 0.0), torques=(1.0, 2.0)), "time 0 s after 0 s is not allowed"),
    (lambda: TorqueProfile(times=(0.0,), torques=(math.inf,)), "finite"),
    (lambda: TorqueProfile(times=(0.0,), torques=(1.0, 2.0)), "1 times and 2 torques"),
    (lambda: SlideProtection(fill_slip=0.0), "fill_slip: 0"),
    (lambda: SlideProtection(dump_slip=1.0), "dump_slip: 1"),
    (lambda: SlideProtection(fill_slip=0.2), "fill_slip < dump_slip"),
    (lambda: changed(catalogue.recommended_schedule(), period=0.01, tracking_time=0.0), "tracking_time: 0"),
    (lambda: changed(catalogue.recommended_schedule(), period=0.01, tracking_time=0.005), "tracking time: 0.005 s"),
    (lambda: sim.Simulator(SCENARIO, changed(catalogue.recommended_schedule(), torque_min=1e9)), "torque_max: 9000 "),
    (lambda: changed(PI, torque_min=1.0, torque_max=1.0), "torque_max: 1 is not allowed; give a value > torque_min"),
    (lambda: changed(ASMC, torque_min=1.0, torque_max=1.0), "torque_max: 1 is not allowed"),
    (lambda: changed(ASMC, filter_time=0.0), "filter_time: 0"),
    (lambda: changed(ASMC, nominal_mass=-1.0), "nominal_mass: -1"),
    (lambda: changed(ASMC, nominal_viscous_friction=-1.0), "nominal_viscous_friction: -1"),
    (lambda: changed(ASMC, K=-1.0), "K: -1"),
    (lambda: changed(ASMC, box=3), "box: 3 is not allowed"),
])  # fmt: skip
def test_controllers_that_do_not_exist_are_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_an_initial_torque_is_commanded_at_once():
    """kp e + the integral's start at the first sample, by hand for the free-rolling wheel: e = lambda_d v."""
    control = changed(PI, kp=100.0, ki=0.0, initial_torque=1500.0)
    run = sim.simulate(SCENARIO, control, seed=None)
    assert run.signals.command[0] == pytest.approx(1500.0 + 100.0 * 0.132 * 100 / 3.6, rel=1e-12)
    with pytest.raises(InputError, match="initial_torque"):
        changed(control, initial_torque=math.nan)
    copied = changed(PI, period=PERIOD).model_copy(update={"kp": 100.0})
    assert copied.sampled(PERIOD) == copied.as_run  # nothing of the old gains is left in a copy
    assert copied.system.gains.kp == 100.0
    assert tomllib.loads(copied.toml)["kp"] == 100.0


def test_the_domain_of_a_law_is_linear_between_speeds():
    limits = np.array([30.0, 1.0, 4.0, 5.0, 9.0])
    limit = Stepped(catalogue.recommended_pi_lead()).module.domain_limit
    speeds = np.linspace(0.0, 33.0, 100)
    expected = np.interp(speeds, np.linspace(0.0, 30.0, 4), limits[1:])
    assert [limit(v, limits) for v in speeds] == pytest.approx(expected, rel=1e-12)


def test_a_design_brakes_from_the_torque_that_every_point_takes_and_hands_over_to_it():
    points = [plant_at("bristle", PARK2008, rail, 100.0).point for rail in Rail]
    design, sure = PIController(PIGains(kp=190.0, ki=5.0)), SURE_SHARE * points[1].brake_torque  # wet: less
    for speed_kmh, torque in ((36.0, sure), (0.0, 0.0)):
        control = braking_control(design, points, REFERENCE, name="mine", hand_over_kmh=speed_kmh)
        assert (control.hand_over_speed, control.hand_over_torque) == (pytest.approx(speed_kmh / 3.6), torque)
        assert control.initial_torque == sure
