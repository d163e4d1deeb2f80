"""The design envelope, the verdict over it, the controller tuned or selected for it, and the commands."""

import json
import math
from collections import defaultdict

import control as ct
import numpy as np
import pytest
from project import changed, refused

from railslip_ctrl import Envelope, judge, load_controller, load_envelope, load_vehicle
from railslip_ctrl.controllers.braking import linear_control
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.controllers.predictive import Predictive
from railslip_ctrl.controllers.sampled import sampled_loop
from railslip_ctrl.controllers.seeking import Seeking
from railslip_ctrl.controllers.systems import PIController, wheel_slip_loop
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.design.assessment import Verdict, assess
from railslip_ctrl.design.envelope_tuning import REACH_SHARE, common_reference, operating_plants, select, tune
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.linearization import operating_point
from railslip_ctrl.model.vehicle import GRAVITY, PARK2008, Actuator, PIGains, Rail, Resistance, Vehicle, Wheel

COACH = Vehicle(
    name="Coach, quarter car",
    mass=11_000.0,
    mass_loaded=17_437.0,
    wheel_load=11_000.0 * GRAVITY,
    wheel_load_loaded=17_437.0 * GRAVITY,  # 171 kN
    wheel=Wheel(radius=0.46, inertia=90.0, viscous_friction=0.25),
    resistance=Resistance(constant=100.0, quadratic=0.6),
    actuator=Actuator(dead_time=0.12, lag=0.4),
)
"""A four-axle coach whose load, brake and wheel all differ from those of the published vehicle."""

S = ct.tf("s")
SMALL = Envelope(COACH, speeds=(20, 100), slip=(0.6, 1.0), dead_time=(1.0, 1.3), lag=(1.0, 1.3))


def test_the_default_is_the_documented_one_and_operating_points_are_there_whatever_factors_are_combined():
    envelope, points = Envelope(COACH), Envelope(COACH).points()
    assert (len(points), points.operating.sum(), points.skipped) == (2 * 2 * 6 * 2 * 3 * 3 * 3 * 2, 2 * 2 * 6 * 2, ())
    names = ("slip", "dead_time", "lag", "radius")
    assert [getattr(envelope, name) for name in names] == [(0.6, 1.0, 1.25), *2 * [(0.7, 1.0, 1.3)], (0.94, 1.0)]
    only = Envelope(COACH, laws="curve", rails="dry", speeds=60, loads="loaded", slip=(0.5, 1.25), radius=0.94)
    points, nominal = only.points(), only.points(nominal=True)
    assert (len(points), len(nominal), nominal.operating.sum()) == (1 + 2 * 9, 1, 1)
    assert [(points.case(i).point.slip, i) for i in np.flatnonzero(points.operating)] == [(0.132, 0)]
    assert {points.case(i).point.vehicle.wheel.radius for i in range(1, len(points))} == {0.94 * COACH.wheel.radius}
    assert nominal.case(0).description == "curve, dry, loaded, 60 km/h"
    assert points.case(2).description == "curve, dry, loaded, 60 km/h, slip -50 %, lag -30 %, radius -6 %"


def test_every_case_is_its_own_combination():
    points = SMALL.points()
    cases = [points.case(i) for i in range(len(points))]
    tables = [case.table() for case in cases]
    assert len({tuple(table.values()) for table in tables}) == len(points) == 2**8
    for i, (case, table) in enumerate(zip(cases, tables, strict=True)):
        loaded, point = COACH.loaded() if table["load"] == "loaded" else COACH, case.point
        assert (table["mass_kg"], table["wheel_load_n"]) == (loaded.mass, loaded.wheel_load)
        assert (table["radius_m"], case.actuator) == (point.vehicle.wheel.radius, points.actuators[points.actuator[i]])
        assert np.array_equal(points.plants[points.plant[i]].A, case.plant.A)
        assert table["slip"] == pytest.approx(case.slip_factor * point.law.reference_slip(point.rail), rel=1e-12)
    factors = [{round(table[key] / of, 9) for table in tables} for key, of in (("dead_time_s", 0.12), ("lag_s", 0.4))]
    assert factors == [set(SMALL.dead_time), set(SMALL.lag)]


def test_laws_of_files_follow_the_wheel_load_with_mu_as_it_was(file):
    rig = published_law("bristle", Rail.DRY)
    parameters = "\n".join(f"{name} = {value!r}" for name, (value, _) in rig.numbers().items())
    told = f'law = "bristle"\nwheel_load = 34500\n[parameters]\n{parameters}\n[reference_slip]\ndry = 0.1\nwet = 0.08\n'
    file("mine.toml", told)
    envelope = load_envelope(
        file("car.toml", '[envelope]\nlaws = ["mine.toml", "bristle"]\nspeeds = ["10 m/s"]'), COACH
    )
    assert envelope.speeds == (36.0,)
    points = envelope.at(reference={"dry": 0.1, "wet": 0.08}).points(nominal=True)
    by_law = defaultdict(list)
    for case in map(points.case, range(len(points))):
        by_law[case.point.rail, case.load].append(case.point.adhesion_coefficient)
    assert len(by_law) == 4
    for first, second in by_law.values():
        assert first == pytest.approx(second, rel=1e-9)
    # a record has the load it was made for; where that is not known, it is the empty vehicle's
    own = published_law("bristle", Rail.DRY, wheel_load=COACH.wheel_load)
    for law in (rig, own, own.model_copy(update={"of_wheel_load": None})):
        cases = Envelope(COACH, laws=law, rails="dry", speeds=36).points(nominal=True)
        mu = [cases.case(i).point.adhesion_coefficient for i in range(2)]
        assert mu == pytest.approx([operating_point(rig, PARK2008, 10.0, 0.132).adhesion_coefficient] * 2, rel=1e-9)


def test_an_envelope_of_a_vehicle_begins_with_the_table_of_its_file(file):
    file("law.toml", 'law = "polach"\n[parameters]\n')
    axes = 'laws = ["law.toml", "curve"]\nspeeds = ["10 m/s"]\nreference = {dry = 0.1, wet = 0.07}'
    path = file("coach.toml", f"mass = 11000\n[envelope]\n{axes}")
    car = load_vehicle(path)
    assert Envelope(car) == load_envelope(path)
    assert Envelope(car, speeds=60) == load_envelope(path).at(speeds=60)  # what is given wins
    assert Envelope(car.model_copy(update={"mass_loaded": 12e3})).speeds == (36.0,)  # a changed one keeps it
    assert Envelope(PARK2008) == Envelope()
    own = load_envelope(file("own.toml", "[envelope]\nspeeds = [20]"), car)
    assert own.reference is None  # a file of its own stands for itself
    with pytest.raises(InputError, match="speeds: 0 is not allowed"):
        Envelope(load_vehicle(file("coach.toml", "mass = 11000\n[envelope]\nspeeds = [0]")))


@pytest.mark.parametrize(("text", "match"), [
    ("[envelope]\nspeeds = []", "envelope: speeds: the list is empty"),
    ('[envelope]\nspeeds = ["3 kg"]', "speeds: '3 kg' has the wrong dimension"),
    ("[envelope]\nspeeds = {a = 1}", "envelope: speeds: .* is not allowed; give a list"),
    ("[envelope]\nlag = [-1]", "envelope: lag: -1 is not allowed"),
    ("[envelope]\nslip = [0.1, 7.6]", "slip: .* 7.6 on .* 0.132 of bristle, dry rail, .* factors < 7.576"),
    ("[envelope]\nslip = 5\nreference = {dry = 0.1, wet = 0.25}", "slip 0.25, wet rail, .* factors < 4"),
    ('[envelope]\nlaws = ["curve", "foo"]', "'foo' is not a law"),
    ('[envelope]\nlaws = ["table"]', "envelope: adhesion 'table': .* gives no parameters"),
    ("[envelope]\nlaws = [1]", "envelope: laws: 1 is not a law; give a name, a file"),
    ("[envelope]\nspeeds = [1e9]", r"envelope: speeds: 1e\+09 is not allowed; .* <= 1000 \(km/h\)"),
    ("[envelope]\nslip = [[1]]", "envelope: slip.0: a list is not allowed; give a number"),
    ('[envelope]\nloads = ["half"]', "envelope: loads.0: 'half' is not allowed; give 'empty' or 'loaded'"),
    ("[envelope]\nvehicle = 3", "envelope.vehicle: unknown key"),
    ("envelope = 3", "write a table"),
    ("rails = ['dry']", r"has no table \[envelope\]"),
    ("rail = 3\n[envelope]", "rail: unknown key"),
])  # fmt: skip
def test_bad_files_are_refused_in_one_line(file, text: str, match: str):
    with pytest.raises(InputError, match=match) as caught:
        load_envelope(file("envelope.toml", text), PARK2008)
    assert "\n" not in str(caught.value)


def test_too_many_cases_are_told_with_the_file_and_the_count_of_each_list(file, railslip):
    slips = [round(0.7 + 0.01 * i, 2) for i in range(60)]  # 1 is one of them
    path = file("mine.toml", f"[envelope]\nspeeds = {list(range(1, 101))}\nslip = {slips}")
    err = refused(railslip("margins", "--envelope", path))
    assert err.startswith("railslip: error: --envelope: mine.toml: envelope: rails 2 x ")
    assert "speeds 100 x slip 60 x dead_time 3 x lag 3 x radius 2 values make 864000 cases, more than 500000;" in err
    with pytest.raises(InputError, match="more than 500000"):  # 489600 with one slip less
        Envelope(speeds=range(1, 101), slip=slips[:34]).at(slip=slips[:35])


@pytest.mark.parametrize("option", ["--envelope", "--vehicle"])
def test_a_law_s_file_that_is_not_there_is_told_with_the_file_that_names_it(tmp_path, railslip, option):
    path = tmp_path / "mine.toml"
    own = "mass = 3517\n" if option == "--vehicle" else ""
    path.write_text(f'{own}[envelope]\nlaws = ["nosuch.py"]', encoding="utf-8")
    words = ("margins", option, path, *(("--envelope", "default") if own else ()))
    status, out, err = railslip(*words)
    assert (status, out) == (2, "")
    told = err.splitlines()[-1]  # after what is assumed of the vehicle
    assert told.startswith(f"railslip: error: {option}: {path}: envelope: laws: {tmp_path / 'nosuch.py'}: no such file")
    assert railslip(*words, "--adhesion", "curve", "--nominal", "--speed", "60")[0] in (0, 1)  # in place of it
    with pytest.raises(InputError, match=f"^Envelope: laws: {tmp_path / 'nosuch.py'}: no such file"):
        load_envelope(path, PARK2008).points()


def test_an_envelope_without_points_a_vehicle_or_a_reference_is_refused_and_what_is_not_reached_left_out(file):
    path = file("envelope.toml", "[envelope]")
    polach = Envelope(laws="polach")
    (kink,) = published_law("beam", Rail.DRY).kinks(10.0, PARK2008.wheel_load)
    on_it = Envelope(laws="beam", rails="dry", speeds=36, reference={"dry": kink.slip, "wet": 0.1})
    for make, match in (
        (lambda: Envelope("coach.toml"), r"^Envelope: vehicle: 'coach\.toml' is not a Vehicle"),
        (lambda: load_envelope(path), "has no vehicle"),
        (polach.points, "adhesion 'polach' has no reference slip"),
        (lambda: on_it.points(nominal=True), "no case is left; .*beam, dry, empty"),
    ):
        with pytest.raises(InputError, match=match):
            make()
    assert len(polach.at(reference={"dry": 0.02, "wet": 0.02}, speeds=60, loads="empty").points(nominal=True)) == 2
    slips = {"dry": 2 * kink.slip, "wet": 0.1}
    points = Envelope(laws=("bristle", "beam"), rails="dry", speeds=36, slip=(0.5, 1.0), reference=slips).points()
    assert min(len(points), len(points.skipped)) > 0
    assert all("slip 0.5 times the reference: " in told and "kink" in told for told in points.skipped)


def test_a_reference_slip_beside_the_peak_is_told():
    slips = np.linspace(0.1, 0.16, 601)  # to 1e-4
    law = published_law("curve", Rail.DRY)
    top = slips[np.argmax([operating_point(law, PARK2008, 20.0, slip).adhesion_force for slip in slips])]
    assert top == pytest.approx(0.1288, abs=1e-4)
    told = Envelope(rails="dry").knife_edges()
    assert [one.split(":")[0] for one in told] == ["curve, dry rail"]  # the bristle law falls from the start
    assert "0.132 is 2.5 % above the adhesion peak at 0.1288" in told[0]
    assert Envelope(rails="dry", reference={"dry": 0.11, "wet": 0.07}).knife_edges() == ()


PI_LEAD = PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)
FAST = PIController(PIGains(kp=1100.0, ki=60.0), lead=0.4, lead_filter=0.04)  # for the coach

PROMPT = COACH.model_copy(update={"actuator": Actuator(dead_time=0.05, lag=0.0)})


def own_loop(
    car, controller, adhesion, rail, speed, load, slip, dead_time, lag, radius, held=None, v0_kmh=100.0, made=None
):
    loaded = car.loaded() if load == "loaded" else car
    law = published_law(adhesion, rail, v0_kmh, loaded.wheel_load)
    wheel = loaded.wheel.model_copy(update={"radius": radius * car.wheel.radius})
    brake = Actuator(dead_time=dead_time * car.actuator.dead_time, lag=lag * car.actuator.lag)
    worn = loaded.model_copy(update={"wheel": wheel, "actuator": brake})
    reference = held(law, speed / 3.6, loaded.wheel_load) if held else law.reference_slip(law.rail)
    point = operating_point(law, worn, speed / 3.6, slip * reference, rail=rail, initial_speed_kmh=v0_kmh)
    return made(point, brake) if made else wheel_slip_loop(point, controller)


ONE_SPEED = Envelope(laws="bristle", rails="dry", speeds=100, loads="empty")
DISCRETE = ct.sample_system((229.4 + 5.0 / S) * (0.6 * S + 1) / (0.06 * S + 1), 0.05, "tustin")


@pytest.mark.parametrize(("envelope", "controller"), [
    *((Envelope(), PI_LEAD), (ONE_SPEED, DISCRETE)),
    *(pytest.param(Envelope(one), FAST, marks=pytest.mark.long) for one in (COACH, PROMPT)),
], ids=["published", "discrete", "coach", "prompt"])  # fmt: skip
def test_every_case_has_the_margins_of_its_loop_and_the_worst_are_the_worst_of_them(envelope, controller):
    judged, car = judge(envelope, controller), envelope.vehicle
    points, rng = judged.points, np.random.default_rng(16)
    if controller is DISCRETE:  # the margins of the other cases need not be worked out
        assert np.array_equal(np.isfinite(judged.margins.delay_s), points.operating)
    for i in rng.choice(len(points), min(75, len(points) // 5), replace=False).tolist():
        case = points.case(i)
        place = case.point.adhesion, case.point.rail, case.point.speed_kmh, case.load, case.slip_factor
        brake, nominal = case.actuator, car.actuator
        factors = brake.dead_time / nominal.dead_time, brake.lag / (nominal.lag or 1.0)
        loop = own_loop(car, controller, *place, *factors, case.point.vehicle.wheel.radius / car.wheel.radius)
        assert judged.ms[i] == pytest.approx(loop.margins().ms if loop.is_stable() else math.inf, rel=1e-7)
    usable = points.speed_kmh >= (judged.usable_from_kmh or 0.0)
    for worst, cases in ((judged.worst, usable & points.operating), (judged.worst_with_tolerances, usable)):
        assert worst.ms == pytest.approx(judged.ms[cases].max(), rel=1e-7)
        again = wheel_slip_loop(worst.case.point, controller)  # where it says
        assert worst.ms == (again.margins().ms if again.is_stable() else math.inf)


def test_the_verdict_is_of_the_operating_points_and_of_the_tolerances():
    on_bristle = Envelope(laws="bristle", speeds=(20, 60, 100))
    judged = judge(on_bristle, PI_LEAD)
    assert judged.verdict_line == (
        "robust: Ms 1.43 (Ms 1.45 if sampled every 0.01 s) at bristle, dry, empty, 100 km/h; with tolerances Ms 2.02 "
        "(Ms 2.05 if sampled every 0.01 s) at bristle, dry, empty, 100 km/h, slip +25 %, dead time +30 %, lag +30 %"
    )
    assert judged.usable_from_kmh == judged.robust_from_kmh == 20.0
    # on the curve every operating point is well damped, but past its peak a slow brake loses the wheel at low speed
    both = on_bristle.at(laws=("bristle", "curve"))
    judged, nominal = judge(both, PI_LEAD), judge(both, PI_LEAD, nominal=True)
    assert (judged.verdict, nominal.verdict) == ("fragile", "robust")
    assert nominal.verdict_line.startswith("robust at the operating points: Ms 1.57 (Ms 1.59 if sampled")
    assert judged.worst.ms <= nominal.worst.ms
    assert judged.usable_from_kmh == judged.robust_from_kmh == 60.0
    assert judged.worst.point.speed_kmh >= 60.0
    assert f"stable from 60 km/h up, there {judged.worst_with_tolerances.description}" in str(judged)
    assert judged.worst_with_tolerances.ms == pytest.approx(44.51, abs=0.01)
    slow = judge(both.at(speeds=(10, 100)), PI_LEAD)
    assert (slow.verdict, slow.usable_from_kmh) == ("unstable", 100.0)
    nowhere = judge(Envelope(speeds=(60, 100)), PIController(PIGains(kp=1e6, ki=1.0)))
    assert (nowhere.verdict, nowhere.usable_from_kmh, nowhere.robust_from_kmh) == ("unstable", None, None)
    assert (nowhere.worst.margins, nowhere.table()["worst"]["ms"]) == (None, None)
    assert "unstable at the highest speed too, 100 km/h" in nowhere.verdict_line


def test_a_bare_system_is_judged_as_it_runs_and_at_one_point_alike():
    """Ms is 1.99 in continuous time and 2.03 sampled every 10 ms: one verdict, whatever asks."""
    bare = 489 * (1 + 0.02 / S) * (0.6 * S + 1) / (0.06 * S + 1)
    envelope = Envelope(laws="bristle", rails="wet", loads="empty", speeds=(60, 100))
    found = judge(envelope, bare, nominal=True)
    same = judge(envelope, linear_control(bare, reference=ReferenceSlip(dry=0.132, wet=0.092)), nominal=True)
    assert found.worst.ms < 2 < found.worst.run_ms == same.worst.run_ms
    assert found.verdict == same.verdict == "fragile"
    case = found.worst.run_case
    assert assess(case.plant, same.controller, case.actuator).verdict is Verdict.FRAGILE
    assert assess(case.plant, bare, case.actuator).verdict is Verdict.ROBUST  # it says nothing of a period


def test_least_margins_are_those_of_exact_loops_where_the_batch_has_ms_alone():
    control = Seeking.for_vehicle(COACH)
    found = judge(Envelope(COACH, laws="bristle", rails="dry", speeds=(30, 100)), control, nominal=True)
    exact = [wheel_slip_loop(one, control).margins() for one in found.points.plants]
    for name, sign in (("phase_deg", 1), ("delay_s", 1), ("gain_decrease", -1), ("gain_increase", 1)):
        least = min(exact, key=lambda margins, name=name, sign=sign: sign * getattr(margins, name))
        assert found.least(name, largest=sign < 0)[0] == getattr(least, name)


def test_a_controller_that_hands_over_is_judged_over_all_speeds_and_told_as_in_use(railslip, tmp_path):
    envelope = Envelope(speeds=(20, 60, 100))
    control = linear_control(PI_LEAD, reference=ReferenceSlip(dry=0.132, wet=0.092), hand_over_speed=60 / 3.6)
    judged, above = (
        judge(envelope, control),
        judge(envelope.at(speeds=(60, 100)), changed(control, hand_over_speed=0.0)),
    )
    assert (judged.verdict, judged.hand_over_kmh) == ("fragile", 60.0)
    assert judged.verdict_in_use == above.verdict == "robust"
    assert f"hands over below 60 km/h, in use robust: {above.worst.description}" in judged.verdict_line
    assert judge(envelope, changed(control, hand_over_speed=30.0)).verdict_in_use is None
    control.save(tmp_path / "c.toml")
    words = ("--controller", tmp_path / "c.toml", "--rail", "dry", "--speed")
    warning = railslip("margins", *words, "59")[2]
    assert ("below 60 km/h" in warning, "59 km/h" in warning) == (True, True)
    assert railslip("margins", *words, "60")[2] == ""


def test_the_verdict_on_a_controller_with_a_period_follows_what_runs():
    envelope = Envelope(laws="bristle", rails="dry", speeds=(60, 100), loads="empty")
    reference = ReferenceSlip(dry=0.132, wet=0.092)
    assert judge(envelope, PI_LEAD).verdict == "robust"
    verdicts = {}
    for period in (0.02, 0.3, 1.0):
        control = linear_control(PI_LEAD, reference=reference, period=period, rule="backward")
        found = judge(envelope, control)
        verdicts[period] = (found.verdict, found.usable_from_kmh, found.robust_from_kmh)
        for worst in (found.worst, found.worst_with_tolerances):
            run = sampled_loop(worst.case.plant, control.sampled(period), worst.case.actuator)
            ms = run.margins().ms if run.is_stable() else None
            assert worst.table()["sampled"] == {"period_s": period, "ms": ms}
            assert worst.ms == wheel_slip_loop(worst.case.plant, PI_LEAD, worst.case.actuator).margins().ms
        assert f"sampled every {period:g} s) at bristle" in found.verdict_line
    assert verdicts == {0.02: ("robust", 60.0, 60.0), 0.3: ("fragile", 60.0, None), 1.0: ("unstable", None, None)}


def test_the_worst_sampled_case_may_be_that_of_least_delay_margin_and_an_inconspicuous_ms():
    lead = PIController(PIGains(kp=335.9, ki=44.7), lead=0.456, lead_filter=0.0456)
    control = linear_control(lead, reference=ReferenceSlip(dry=0.132, wet=0.092), period=0.1, rule="backward")
    axes = {"laws": ("curve", "bristle"), "rails": "wet", "loads": "empty", "slip": (0.1, 1.0, 1.25), "lag": 1.0}
    found = judge(Envelope(COACH, speeds=100, dead_time=(0.7, 1.0, 1.3), radius=1.0, **axes), control)
    cases = [found.points.case(i) for i in range(len(found.points))]
    every = [sampled_loop(case.plant, control.sampled(0.1), case.actuator).margins().ms for case in cases]
    worst = int(np.argmax(every))
    assert (worst, np.count_nonzero(found.ms > found.ms[worst])) == (np.argmin(found.margins.delay_s), 6)
    assert max(np.delete(every, worst)) < 0.99 * every[worst]
    assert found.worst_with_tolerances.run_ms == every[worst]
    assert np.nanmax(found.sampled_ms) == pytest.approx(every[worst], rel=1e-6)  # by a grid


ONE_LAW = Envelope(speeds=(20, 40, 100), rails="dry", laws="curve", loads="empty", radius=1.0)


@pytest.fixture(scope="module")
def selection():
    return select(ONE_LAW)


def test_the_best_is_robust_at_a_smaller_slip_and_its_judgement_is_that_of_judge(selection):
    best = selection.best
    assert (best.structure, best.reference_factor) == ("pi", 0.75)
    assert best.design.controller.reference.dry == pytest.approx(0.099)
    again = judge(ONE_LAW, best.design)  # at the design's own reference
    assert again.verdict == best.design.judgement.verdict == "robust"
    assert again.ms == pytest.approx(best.design.judgement.ms, rel=1e-12)
    assert again.worst.point.slip == best.design.controller.reference.dry
    assert [c.rank for c in selection.choices] == sorted(c.rank for c in selection.choices)
    assert len(selection.choices) == 6
    assert str(selection).startswith("PI, 75 % of the reference slip: robust: Ms")


@pytest.mark.parametrize("envelope", [ONE_LAW, pytest.param(Envelope(speeds=40.0), marks=pytest.mark.long)])
def test_no_gains_of_a_grid_do_more_than_those_chosen(selection, envelope):
    selected = selection if envelope is ONE_LAW else select(envelope, ["pi-lead"], [1.0])
    (found,) = (one for one in selected.choices if (one.structure, one.reference_factor) == ("pi-lead", 1.0))
    mine, gains = found.design.judgement.robust_from_kmh, found.design.controller
    assert mine is not None
    for kp in gains.kp * np.geomspace(0.2, 5.0, 9):
        for ki in gains.ki * np.array([0.1, 1.0, 1.2]):  # the search ends at 1.05, its gains are 1.1 apart
            other = PIController(
                PIGains(kp=kp, ki=ki), found.design.controller.lead, found.design.controller.lead_filter
            )
            judged = judge(envelope.at(reference=gains.reference), other)
            robust = math.inf if judged.robust_from_kmh is None else judged.robust_from_kmh
            assert robust > mine if ki > gains.ki else robust >= mine


def test_where_none_is_robust_the_least_ms_is_given_up_by_a_twentieth_for_ki(monkeypatch):
    monkeypatch.setattr("railslip_ctrl.design.envelope_tuning._INTEGRAL_TIMES", 64.0 * 2.0 ** -np.arange(0, 2, 0.25))
    brake = Actuator(dead_time=0.15, lag=0.3)
    envelope = ONE_LAW.at(vehicle=PARK2008.model_copy(update={"actuator": brake}), speeds=100.0, laws="bristle")
    (found,) = select(envelope, ["pi"], [1.0]).choices
    gains, (plant,) = found.design.controller, operating_plants(envelope.points(nominal=True))

    def least(time):
        loops = [wheel_slip_loop(plant, PIController(PIGains(kp=kp, ki=kp / time))) for kp in range(180, 260, 4)]
        return min(loop.margins().ms for loop in loops)

    slowest = least(64 * 0.45)
    assert slowest > 2.0
    # grids of kp: 1 % of the interval here, 5 % there
    assert 0.99 * least(gains.kp / gains.ki) <= found.design.judgement.worst.ms <= 1.055 * slowest
    assert least(gains.kp / gains.ki / 2**0.25) > 1.045 * slowest


def test_the_time_to_the_reference_is_that_of_the_integral(selection):
    (found,) = (one for one in selection.choices if (one.structure, one.reference_factor) == ("pi-lead", 1.0))
    points = [plant.point for plant in found.design.judgement.points.plants if plant.point.slip == 0.132]
    start, gains, times = 0.8 * min(point.brake_torque for point in points), found.design.controller, []
    for point in (p for p in points if p.speed_kmh > 99):
        # counted in steps of a millisecond, error and gains held
        error, torque, time = (
            point.slip * point.speed,
            start + gains.kp * point.slip * point.speed,
            0.0,
        )
        while torque < point.brake_torque:
            torque, time = torque + 1e-3 * gains.ki * error, time + 1e-3
        times.append((time, PARK2008.mass * (100 / 3.6) / point.adhesion_force))
    assert found.reach_s == pytest.approx(max(time for time, _ in times), abs=2e-3)
    assert found.stop_s in [pytest.approx(stop, rel=1e-12) for _, stop in times]
    assert found.reaches == (found.reach_s <= REACH_SHARE * found.stop_s)
    assert ("reaches its reference in" in found.description) != found.reaches


def test_where_nothing_holds_there_is_no_best_and_without_lag_no_lead():
    late = COACH.model_copy(update={"actuator": Actuator(dead_time=1.5, lag=0.0)})
    found = select(ONE_LAW.at(vehicle=late, speeds=(20.0,), laws="bristle"))
    assert found.best is None
    assert {c.structure for c in found.choices} == {"pi"}
    assert "no gains" in str(found)


COACH_FILE = """
mass = 11000
mass_loaded = 17437
wheel = {radius = 0.46, inertia = 90, viscous_friction = 0.25}
actuator = {dead_time = "120 ms", lag = "0.4 s"}
resistance = {constant = 100, linear = 0, quadratic = 0.6}
"""


def test_options_narrow_the_envelope_and_files_have_it(railslip, file):
    file("coach.toml", COACH_FILE)

    def found(*more):
        gains = ("--kp", "1100", "--ki", "60", "--lead", "0.4")
        return json.loads(railslip("margins", "--vehicle", "coach.toml", *gains, *more, "--json")[1])

    named = ("--rail", "wet", "--speed", "60", "--slip", "0.07", "--loaded", "--adhesion", "curve")
    narrow = found(*named, "--envelope", "default")
    envelope, case = narrow["envelope"], narrow["worst"]["case"]
    assert [envelope[key] for key in ("rails", "laws", "speeds", "loads")] == [["wet"], ["curve"], [60.0], ["loaded"]]
    assert envelope["reference"]["wet"] == case["slip"] == 0.07
    assert case["wheel_load_n"] == COACH.wheel_load_loaded
    axes = 'rails = ["wet"]\nlaws = "curve"\nspeeds = 60\nloads = "loaded"\nreference = {dry = 0.07, wet = 0.07}\n'
    assert found("--envelope", file("envelope.toml", f"[envelope]\n{axes}")) == narrow
    file("coach.toml", f"{COACH_FILE}[envelope]\n{axes}")  # of the vehicle's own file
    assert found("--envelope", "default") == narrow
    for arguments, message in (
        (("--mass", "4000"), "--mass has no effect with an envelope"),
        (("--certify",), "--certify is only for operating points"),
        (("--slip", "0"), "--slip: 0 is not allowed with an envelope"),
    ):
        assert message in refused(railslip("margins", "--envelope", "default", *arguments))
    assert railslip("margins", "--envelope", "missing.toml")[0] == 2


@pytest.mark.long
def test_tune_holds_empty_and_loaded_together_and_is_judged():
    envelope = Envelope(COACH, rails="dry", laws="bristle", speeds=(60, 100))
    best = tune(envelope, "pi-lead", 2.5)
    again = judge(envelope, best)
    assert best.judgement.ms == pytest.approx(again.ms, rel=1e-12)
    assert 2.5 * (1 - 2e-3) <= again.run_ms[again.points.operating].max() <= 2.5
    assert again.worst.case.load == "loaded"
    # the true load, not the mass alone: with the wheel load as it was, Ms is less
    alone = COACH.model_copy(update={"mass": COACH.mass_loaded})
    assert judge(Envelope(alone, rails="dry", laws="bristle", speeds=(60, 100), loads="empty"), best).worst.ms < 2.45
    assert str(best).startswith("pi-lead, PI-lead: kp ")


@pytest.mark.parametrize("period", [0.01, pytest.param(0.05, marks=pytest.mark.long)])
def test_what_is_tuned_is_what_runs(period, tmp_path):
    """The sampled loop of the saved file by python-control, of dead time 15 or 3 periods, on a fine grid."""
    slip = {"dry": 0.1, "wet": 0.1}
    envelope = Envelope(rails="dry", laws="bristle", speeds=(60, 100), loads="empty", reference=slip)
    best = tune(envelope.at(slip=1.0, dead_time=1.0, lag=1.0, radius=1.0), "pi-lead", 2.0, period=period)
    best.save(tmp_path / "best.toml")
    control = load_controller(tmp_path / "best.toml")
    assert (control.period, control.rule.value) == (period, "tustin")
    z, gains = np.exp(1j * np.geomspace(1e-3, np.pi, 20_000)), control
    lead = (gains.lead * S + 1) / (gains.lead_filter * S + 1)
    c = ct.sample_system((gains.kp + gains.ki / S) * lead, period, "tustin")
    ms, lag = [], ct.ss(ct.tf([1], [0.6, 1]))
    for plant in operating_plants(envelope.points(nominal=True)):
        held = ct.sample_system(ct.ss(plant.A, plant.B, plant.C[:1], plant.D[:1]) * lag, period, "zoh")
        ms.append((1 / np.abs(1 + c(z) * held(z) * z ** -round(0.15 / period))).max())
    found = best.judgement
    assert found.sampled_ms[found.points.operating] == pytest.approx(ms, rel=1e-6)
    assert 1.99 < max(ms) <= 2.0 * (1 + 1e-6)
    assert found.worst.ms < found.worst.run_ms
    assert found.verdict == "robust"


@pytest.mark.long
def test_tune_says_that_no_speed_will_do():
    with pytest.raises(InfeasibleDesignError, match="no speed "):
        tune(Envelope(COACH, speeds=(60, 100), rails="dry", laws="curve"), "pi", 1.1)
    with pytest.raises(InfeasibleDesignError, match=r"\b60 km/h"):
        tune(Envelope(speeds=(20, 40, 60, 100), rails="dry", laws="curve"), "pi-lead", 1.15)
    # found by halving
    envelope = Envelope(rails="dry", laws="curve", loads="empty", speeds=range(4, 101, 12))
    with pytest.raises(InfeasibleDesignError, match=r"at 4 and 100 km/h alone: .*;.* 16 km/h"):
        tune(envelope, "pi-lead", 1.8)
    assert tune(envelope.at(speeds=range(16, 101, 12)), "pi-lead", 1.8).judgement.worst.ms <= 1.8 * (1 + 1e-9)


def test_the_slips_held_are_those_of_every_law():
    mine = published_law("bristle", "dry").model_copy(update={"reference": ReferenceSlip(dry=0.1, wet=0.08)})
    for axes, held in (({}, (0.132, 0.092)), ({"rails": "wet"}, (0.092, 0.092)), ({"laws": [mine, "curve"]}, None)):
        envelope = Envelope(speeds=60, **axes)
        found = common_reference(envelope, envelope.points(nominal=True))
        assert (found and (found.dry, found.wet)) == held


def test_errors_of_sensors_and_brake_are_tolerances():
    pi = PI(kp=250.0, ki=60.0, reference=ReferenceSlip(dry=0.06, wet=0.06))
    errors = {"torque_gain": (0.85, 1.15), "speed_scale": (0.98,), "believed_radius": (1.02,)}
    narrow = {"laws": ("curve",), "rails": ("dry",), "speeds": (60,), "loads": ("empty",), "slip": (1.0,)}
    narrow |= {"dead_time": (1.0,), "lag": (1.0,), "radius": (1.0,)}
    found = judge(Envelope(PARK2008, **narrow, **errors), pi)
    cases = [found.points.case(i) for i in range(len(found.points))]
    assert [case.errors for case in cases] == [(1.0, 1.0, 1.0), (0.85, 0.98, 1.02), (1.15, 0.98, 1.02)]
    errors = "torque gain -15 %, speed scale -2 %, believed radius +2 %"
    assert cases[1].description == f"curve, dry, empty, 60 km/h, {errors}"
    assert cases[1].table()["speed_scale"] == 0.98
    rolled = 0.94 * cases[1].point.speed * 0.98 / 1.02  # r omega of which the measured slip is 0.06
    for case, gain in zip(cases[1:], (0.85, 1.15), strict=True):
        assert case.point.slip == pytest.approx(1 - rolled / case.point.speed, rel=1e-12)
        point = operating_point(case.point.law, PARK2008, 60 / 3.6, case.point.slip)
        scaled = wheel_slip_loop(point, PIController(PIGains(kp=250.0, ki=60.0))).scaled(gain * 1.02)
        assert found.ms[cases.index(case)] == pytest.approx(scaled.margins().ms, rel=1e-9)
    seeking = judge(Envelope(PARK2008, **narrow, torque_gain=(1.0, 1.15)), Predictive.for_vehicle(PARK2008))
    assert seeking.ms[0] != seeking.ms[1]
    assert set(found.by_axis()["torque_gain"]) == {1.0, 0.85, 1.15}
