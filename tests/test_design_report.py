"""`railslip report`: what is recommended, its numbers, its files and its page, that in a real browser too."""

import base64
import json
import math
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import product

import control as ct
import numpy as np
import pytest
from html_page import LARGEST_BYTES, Page
from project import ROOT, changed
from test_envelope import COACH, own_loop
from test_laws import LAW

from railslip_ctrl import (
    PI,
    Envelope,
    SampledController,
    judge,
    linearize,
    load_controller,
    load_envelope,
    load_vehicle,
    operating_point,
)
from railslip_ctrl.cli.margins import given_controller
from railslip_ctrl.controllers.seeking import Seeking
from railslip_ctrl.controllers.systems import PIController, wheel_slip_loop
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design.catalogue import published_controller
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.vehicle import PARK2008, Actuator, PIGains, Rail
from railslip_ctrl.report import candidates, recommendation
from railslip_ctrl.report import design_report as pages
from railslip_ctrl.report.design_json import design_report_json
from railslip_ctrl.report.design_report import design_report_text, design_sections, first_page
from railslip_ctrl.report.document import Paragraph
from railslip_ctrl.report.page import page
from railslip_ctrl.report.plots import style
from railslip_ctrl.report.plots.designs import report_drawings
from railslip_ctrl.report.recommendation import design_report, restricted
from railslip_ctrl.report.stops import CHANGES, laws_of_stops, rolling_loops, stop_scenario
from railslip_ctrl.simulation import simulate, stop

MOST_WORDS, MOST_FIRST_WORDS, MOST_LINES, MOST_NUMBERS = 3500, 60, 40, 10  # the contract's
ENVELOPE = Envelope(PARK2008, laws="curve", speeds=(10, 100), loads="loaded")
SMALL = "--speed 10 --speed 100 --kp 190 --ki 5 --loaded --adhesion curve"  # over ENVELOPE, with gains given
SOURCE = "railslip report"
TINY = b'<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>'
GIVEN = PIController(PIGains(kp=190.0, ki=5.0))


def told(report):
    first = first_page(report)
    beside = ("Yours", "Choice", "Runner-up", "Remedy", "Stops")
    words = " ".join([first.headline, first.subject, *(text for name, text in first.lines if name not in beside)])
    assert len(words.split()) <= MOST_FIRST_WORDS
    return first, dict(first.lines), {name: value for name, value, _ in first.rows}


def swinging(one, **more):
    signals = one.run.signals._replace(slip=one.reference * np.sin(one.run.signals.time))
    return replace(one, run=replace(one.run, signals=signals, **more))


@pytest.fixture(scope="module")
def full_report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "out"
    command = [sys.executable, "-m", "railslip_ctrl", "report", *SMALL.split(), "--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True)
    return folder, done.stdout, done.stderr


@pytest.fixture(scope="module")
def content(full_report):
    return json.loads((full_report[0] / "report.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def shown(full_report):
    return Page((full_report[0] / "report.html").read_text("utf-8"))


def rendered(report):
    names = dict.fromkeys(("map", "loop", "stops", "gains", "responses", "adhesion", "no-lock"), TINY)
    return page(first_page(report), design_sections(report), names, SOURCE, report.date, 1.0)


def test_the_first_page_is_printed_and_the_page_is_well_formed_loads_nothing_and_is_short(full_report, content, shown):
    folder, out, err = full_report
    assert len(out.splitlines()) <= MOST_LINES
    assert (folder / "report.txt").read_text("utf-8") == out
    assert f"{folder / 'report.html'}" in out.replace("\n", "")
    assert {path.name for path in folder.iterdir()} == set(content["files"])
    assert "in a browser" in err
    assert (folder / "report.html").stat().st_size < LARGEST_BYTES
    assert shown.problems() == []
    assert len(shown.pictures) == sum(name.endswith(".png") for name in content["files"]) >= 4
    assert len(shown.text.split()) <= MOST_WORDS


def test_the_recommendation_is_what_judge_says_of_its_file(content, full_report):
    control = load_controller(full_report[0] / "recommended.toml")
    said, judged, above = content["recommended"], judge(ENVELOPE, control), control.hand_over_speed * 3.6
    assert (said["verdict"], said["stable_from_kmh"]) == (judged.verdict, judged.usable_from_kmh)
    assert said["usable_from_kmh"] == pytest.approx(max(judged.robust_from_kmh, above), rel=1e-9)
    assert content["envelope"]["speeds"] == pytest.approx(judged.envelope.speeds)  # with its own
    assert said["map"]["operating"] == judged.map.operating.tolist()
    judged = restricted(judged, above * (1 - 1e-9))
    assert said["worst"] == judged.worst.table()
    assert said["worst_with_tolerances"] == judged.worst_with_tolerances.table()


def test_the_share_of_the_stops_inside_the_certified_region_is_told(content, shown, full_report):
    found = {(one["load"], one["rail"]): one for one in content["no_lock"]}
    assert found.keys() == {("loaded", "dry"), ("loaded", "wet")}
    for one in found.values():
        assert (0.5 < one["share"] <= 1.0, one["reason"]) == (True, "")
        assert one["outside_kmh"] is None or one["outside_kmh"][1] < 40.0  # the slow wheel locks in less time
    assert "certainly does not lock if the brake is released" in shown.text
    assert (full_report[0] / "no-lock.png").is_file()


def test_the_command_that_is_printed_gives_the_stop_to_the_digit(full_report, content, shown, railslip):
    """The longest of all laws, loads and seeds; text and page have the same command."""
    out = full_report[1]
    command = " ".join(out.partition(" stop: ")[2].split())
    assert command in shown.text
    run = json.loads(railslip(*shlex.split(command)[1:], "--json")[1])
    said = max((one for one in content["stops"] if one["rail"] == "dry"), key=lambda one: one["braking_distance_m"])
    longest = said["braking_distance_m"]
    assert longest == max(said["distances_m"]) == said["distances_m"][said["seed"]]
    assert all(run[name] == said[name] for name in ("braking_distance_m", "braking_time_s", "max_slip"))
    assert f"{longest:.4g} m " in out.partition("Stop, dry")[2].partition("Stop, wet")[0]


def test_the_title_of_the_map_is_true_of_its_numbers(robust):
    judged = robust.judgement
    shown = report_drawings(robust)["map"]().get_suptitle()
    assert np.any(judged.sampled_ms > judged.ms)  # so that the cells are not those of the continuous loop
    assert ("sampled" in shown, "continuous time" in shown) == (True, False)


def test_given_gains_are_judged_and_run_beside(content, shown):
    (given,) = content["given"]
    judged = judge(ENVELOPE, SampledController(GIVEN, 0.01))  # as it runs
    assert (given["verdict"], given["worst"]) == (judged.verdict, judged.worst.table())
    assert {one["rail"] for one in given["stops"]} == {"dry", "wet"}
    assert [row[0] for row in shown.rows("given")[1:]] == ["recommended", "given PI"]


@pytest.mark.long
def test_a_law_of_one_s_own_in_a_python_file_is_reported_on(railslip, file):
    """Its class cannot be sent to another process."""
    narrow = ("--speed", "100", "--rail", "dry", "--no-html", "--out", "out", "--json")
    status, out, _ = railslip("report", "--adhesion", file("mine.py", LAW), *narrow)
    assert (status, json.loads(out)["stops"][0]["adhesion"]) == (0, "kalker")


MINE = """
import control as ct
SYSTEM = ct.tf([137.4, 232.0, 5.0], [0.06, 1.0, 0.0])
class Mine:
    period = 0.01
    def reset(self, t, v, omega):
        self.error = 0.0
    def step(self, t, v, omega):
        return 1500.0
"""
OWN = (
    'kind = "transfer-function"\nnum = [137.4, 232, 5]\nden = [0.06, 1, 0]\nperiod = "10 ms"\n'
    'torque_max = "5 kN*m"\ninitial_torque = "1.5 kN*m"\n[reference]\ndry = 0.1\nwet = 0.07\n'
)


@pytest.mark.long
def test_a_controller_of_a_file_is_judged_and_runs_as_simulate_runs_it(railslip, file):
    case = ("--adhesion", "curve", "--rail", "dry", "--controller", file("tf.toml", OWN))
    narrow = ("--speed", "100", "--loaded", "--nominal", "--no-html", "--out", "out")
    status, out, err = railslip("report", *case, *narrow, "--json")
    assert status == 0, err
    (given,) = json.loads(out)["given"]
    assert given["worst"]["case"]["slip"] == 0.1  # its own
    plant = linearize(operating_point(published_law("curve", "dry"), PARK2008.loaded(), 100 / 3.6, 0.1))
    s, first = ct.tf("s"), given["stops"][0]
    mine = (232 + 5 / s + 137.4 * s) / (0.06 * s + 1)
    assert given["worst"]["ms"] == pytest.approx(wheel_slip_loop(plant, mine).margins().ms, rel=1e-6)
    again = railslip("simulate", "--scenario", "stop", "--loaded", *case, "--seed", first["seed"], "--json")[1]
    assert first["braking_distance_m"] == json.loads(again)["braking_distance_m"]


def test_a_controller_without_margins_runs_beside_and_is_told_as_not_judged(robust, file):
    mute = load_controller(file("mute.py", MINE + "CONTROLLER = Mine()\n"))
    given = {"mute.py": mute, "sliding": published_controller("asmc")}
    rivals = [recommendation._rival(name, one, robust.envelope, False) for name, one in given.items()]
    beside = replace(robust, rivals=tuple(rivals))
    lines = [text for name, text in first_page(beside).lines if name == "Yours"]
    assert [text.split(" is ")[0] for text in lines] == [f"NOT JUDGED: {name}" for name in given]
    found = design_report_json(beside)["given"]
    assert [one["reason"] for one in found] == ["known only by its step function", "not linear"]
    assert [one["verdict"] for one in found] == [None, None]
    assert all({stop["rail"] for stop in one["stops"]} == {"dry", "wet"} for one in found)
    first = found[0]["stops"][0]
    scenario = stop(PARK2008, first["rail"], speed_kmh=robust.envelope.initial_speed)
    assert first["braking_distance_m"] == simulate(scenario, mute, seed=first["seed"]).braking_distance


def test_an_unstable_controller_is_told_on_the_first_page_with_its_stops(robust):
    wild = recommendation._rival("wild", PIController(PIGains(kp=1e6, ki=2.0)), robust.envelope, False)
    beside = replace(robust, rivals=(wild,))
    line = told(beside)[1]["Yours"]
    assert line.startswith("UNSTABLE: wild is not stable with every tolerance at the highest speed; unstable at ")
    longest = max((one for one in wild.stops if one.rail == "dry"), key=lambda one: one.distance)
    assert f"dry {longest.distance:.4g} m (curve, {longest.load}: " in line
    (shown,) = pages._rivals(beside).blocks
    assert [row[0] for row in shown.rows] == ["recommended", "wild"]
    assert (shown.head[-1], shown.rows[-1][:2]) == ("Longest stops, curve, empty", ("wild", "unstable"))


def test_a_controller_that_has_no_reference_holds_the_envelope_s(file):
    name, held = file("mine.py", MINE + "CONTROLLER = SYSTEM\n"), ReferenceSlip(dry=0.1, wet=0.07)
    point = operating_point(published_law("curve", "dry"), PARK2008, 100 / 3.6, 0.1)
    assert given_controller(name, point, None, held).reference == held
    assert given_controller(name, point, None).reference == point.law.reference


PROJECT_S = [load_vehicle(ROOT / "designs" / "vehicles" / name) for name in ("coach.toml", "desiro_classic.toml")]


@pytest.mark.long
@pytest.mark.parametrize("vehicle", [PARK2008, *PROJECT_S, COACH], ids=["published", "coach", "railcar", "at the peak"])
def test_no_random_point_of_an_envelope_is_worse_than_the_report_s_own_worst(vehicle):
    """2 000 loops anywhere within the ranges of the envelope in use, each linearised and solved by itself."""
    found = design_report(Envelope(vehicle), sliding=False)
    judged, envelope, rng = found.in_use, found.in_use.envelope, np.random.default_rng(4)
    worst, seeks = {True: judged.worst, False: judged.worst_with_tolerances}, isinstance(found.control, Seeking)
    controller = found.control if seeks else found.control.system

    def held(law, speed, load):
        if seeks:
            return found.control.judged_slip(law, speed, load)
        return law.reference_slip(law.rail) if envelope.reference is None else getattr(envelope.reference, law.rail)

    ranges = [getattr(envelope, name) for name in ("slip", "dead_time", "lag", "radius")]
    made = found.control.loop_as_run if seeks else None  # of the seeking controller the sampled loop is judged
    for k in range(2000):
        operating = k % 4 == 0  # at the operating points only the speed is between those judged
        factors = [1.0 if operating else rng.uniform(min(these), max(these)) for these in ranges]
        speed = rng.uniform(min(envelope.speeds), max(envelope.speeds))
        place = rng.choice(envelope.laws), rng.choice(envelope.rails), speed, rng.choice(envelope.loads)
        loop = own_loop(found.vehicle, controller, *place, *factors, held, envelope.law_speed, made)
        assert loop.is_stable() or worst[operating].margins is None
        if loop.is_stable():
            most = worst[operating].run_ms if seeks else worst[operating].ms
            assert loop.margins().ms <= most * (1 + 1e-6), (place, factors)


@pytest.fixture(scope="module")
def robust():
    made = candidates.rule_trial

    def locked(name, *given):
        trial = made(name, *given)
        return replace(trial, above_kmh=None, reason="a wheel locks") if name == "seeking" else trial

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recommendation, "cpu_count", lambda: 1)  # all of it here, where the next line holds
        patch.setattr(candidates, "rule_trial", locked)
        return design_report(Envelope(PARK2008, speeds=(10, 100), loads="empty", lag=1.0), sliding=False)


@pytest.fixture(scope="module")
def hopeless():
    slow = PARK2008.model_copy(update={"name": "Slow brake", "actuator": Actuator(dead_time=1.5, lag=2.0)})
    only = {"laws": "bristle", "rails": "dry", "loads": "empty", "speeds": (60, 100)}
    return design_report(Envelope(slow, **only, slip=1.0, dead_time=1.0, lag=1.0, radius=1.0), sliding=False)


def test_a_robust_design_is_to_be_used_and_its_numbers_are_within_the_page(robust):
    first, lines, worst = told(robust)
    assert robust.in_use.verdict == "robust"
    assert first.headline == "USE ABOVE 10 km/h"  # below the lowest speed judged the file holds a torque
    assert "no slip control; holds" in lines["Below 10 km/h"]
    assert ("adhesion peak" in lines["To do"]) == bool(robust.judgement.envelope.knife_edges())
    assert len(first.rows) <= MOST_NUMBERS
    ms, run_ms = float(worst["Worst Ms, sampled"]), robust.in_use.worst.run_ms
    assert ms == pytest.approx(run_ms, abs=0.01)  # two decimals, rounded up
    assert ms >= run_ms * (1 - 1e-6) > robust.in_use.worst.ms
    assert f"(Ms {worst['Worst Ms, sampled']} if sampled" in robust.in_use.verdict_line
    least = float(robust.in_use.margins.phase_deg[robust.in_use.points.operating].min())
    assert float(worst["Phase margin, nominal, continuous"].split()[0]) == pytest.approx(least, rel=5e-3)


def test_the_first_page_tells_speeds_without_a_use_and_stops_near_the_edge(robust):
    """Were the design used from 100 km/h up and controlled slip from 5 km/h on; were the highest speed judged 60."""
    unused = replace(robust, above_kmh=100.0, control=changed(robust.control, hand_over_speed=5 / 3.6))
    _, lines, _ = told(unused)
    assert lines["5 to 100 km/h"].endswith("not robust.")
    assert "another protection below 100 km/h" in lines["To do"]
    lost = judge(robust.envelope, PIController(PIGains(kp=804.0, ki=694.0)))
    choice = replace(robust.best, design=replace(robust.best.design, judgement=lost))
    trials = (replace(robust.trials[0], choice=choice), *robust.trials[1:])
    _, lines, _ = told(replace(unused, trials=trials))
    assert lines["5 to 100 km/h"].endswith("unstable with tolerances at 10 km/h.")
    short = replace(robust, envelope=robust.envelope.at(speeds=(10, 60)))
    assert first_page(short).headline == "USE FROM 10 TO 60 km/h"
    slid = replace(robust.stops[0], run=replace(robust.stops[0].run, max_slip=0.8), others=(), errors="lag +30 %")
    _, lines, numbers = told(replace(robust, harder_stops=(slid,)))
    assert ("Slip exceeds 0.5 in 1 stop." in lines["Risk"], numbers["Highest slip"]) == (True, "0.8")
    low = {"max_slip": 1.0, "locked_fraction": 0.1}
    locked = replace(slid, run=replace(slid.run, **low), locked_from=9 / 3.6)  # below the hand-over
    said = dict(first_page(replace(robust, harder_stops=(slid, locked, slid))).lines)["Risk"]
    assert said.startswith(f"Below 10 km/h a wheel locks in 1 of {len(robust.stops) + 3} stops.")


def test_of_those_that_qualify_the_one_with_the_shortest_mean_stop_is_taken(robust):
    """The mean has errors and a changing rail in it; within 2 % robustness decides, then air."""
    first, good = robust.trials[0], robust.qualified
    assert first.choice is robust.best
    runs = [run for one in (*first.stops, *first.harder) for run in one.runs]
    assert first.distance() == pytest.approx(np.mean([run.braking_distance for run in runs]), rel=1e-12)
    assert min(one.distance() for one in good) >= first.distance() / (1 + candidates.TIE)
    assert all(one.locked == 0 and one.judgement.robust_from_kmh is not None for one in good if one.judgement)
    left = [one for one in robust.trials if one.reason.startswith(candidates.NOT_RUN)]
    assert all(not one.harder and one.above_kmh is None for one in left)
    limit = (1 + candidates._NEAR) * first.distance_as_given() / (1 + candidates.TIE)
    assert not left or min(one.distance_as_given() for one in left) > limit
    kinds = {one.choice.structure for one in robust.trials}
    assert kinds >= {"pi-lead", "predictive", "seeking", "slide-protection"}

    def trial(scale, ms, air):
        stops = [replace(one, run=replace(one.run, braking_distance=scale), others=(), air=air) for one in first.stops]
        made = replace(first, stops=tuple(stops), harder=())
        made.__dict__["worst_ms"] = ms
        return made

    far, near, robuster, saving = trial(104, 1.1, 1), trial(100, 3, 1), trial(101.9, 2, 1), trial(101.9, 2, 0.5)
    assert candidates.ordered([far, near, robuster, saving]) == [saving, robuster, near, far]
    assert candidates.ordered([far, near, saving, robuster], "robustness") == [far, saving, robuster, near]
    with pytest.raises(InputError, match="prefer: 'air'"):
        design_report(ENVELOPE, prefer="air")
    locks = replace(trial(50, 1, 1), above_kmh=None)
    assert candidates.ordered([locks, far]) == [far, locks]


def numbers_of(text):
    return [float(one) for one in re.findall(r"-?\d+\.?\d*", text.replace("−", "-"))]


def test_no_statement_contradicts_a_table_beside_it(robust):
    second = candidates._with_harder(robust.trials[1], robust.envelope)
    second = replace(second, above_kmh=10.0, reason="")  # or there is one alone
    robust = replace(robust, trials=(robust.trials[0], second, *robust.trials[2:]))
    first, lines, _ = told(robust)
    _, ran, rest = pages._candidates(robust).blocks
    table = [dict(zip(ran.head, row, strict=True)) for row in ran.rows]
    best, other = robust.qualified[:2]
    assert f"mean stop {table[0]['Mean stop, m']} m" in lines["Choice"]
    assert f"mean stop {table[1]['Mean stop, m']} m" in lines["Runner-up"]
    assert numbers_of(lines["Runner-up"].replace("+", " "))[-1] == round(
        100 * (other.distance() / best.distance() - 1), 1
    )
    assert f"{len(robust.qualified)} of {len(robust.trials)} candidates qualify" in lines["Choice"]
    assert numbers_of(lines["Stops"])[0] == len(robust.stops)
    assert all(law in lines["Stops"] for law in {one.law for one in (*robust.stops, *robust.harder_stops)})
    assert "slide-protection" in [row["Candidate"] for row in table]
    used = [row["Candidate"] for row in table if row["Used from, km/h"] != "–"]
    assert len(used) == len(robust.qualified)
    assert not {*used} & {row[0] for row in rest.rows}  # who qualifies has no reason why not
    assert {row[0] for row in rest.rows} >= {row["Candidate"] for row in table} - {*used}
    every = (*robust.stops, *robust.harder_stops)
    for name, _, where in first.rows:
        if name.startswith("Stop, "):
            here = [one for one in every if one.rail == name.split(", ")[1]]
            begins = {round(one.run.scenario.initial_speed * 3.6, 6) for one in here}
            assert begins == {numbers_of(name)[0]}
            locked = sum(one.locks for one in here)
            assert (f"locks in {locked} of {len(here)}" in where) == bool(locked)
    # a tolerance that is nearly unstable is never under "USE"
    assert best.worst_ms <= candidates.NEARLY_UNSTABLE
    wild = replace(best)
    wild.__dict__["worst_ms"] = 84.0
    assert "nearly unstable" in "; ".join(candidates._lacks(wild, best.judgement))
    near = replace(best)
    near.__dict__["worst_ms"] = 19.0
    assert not list(candidates._lacks(near, best.judgement))
    assert "nearly unstable: Ms 19" in dict(first_page(replace(robust, trials=(near,))).lines)["Risk"]
    # the dashed line of the map is told where it is drawn, and there alone
    captions = {one.name: one.caption for one in first.pictures}
    figure = report_drawings(robust)["map"]()
    drawn = any(line.get_linestyle() == "--" for ax in figure.axes for line in ax.lines)
    assert ("dashed line" in captions["map"]) == drawn
    assert pages._sampled_ms(robust) in captions["loop"]


def test_a_controller_of_one_s_own_is_compared_with_what_the_recommended_is(robust):
    mine = recommendation._rival("mine", GIVEN, robust.envelope, True)
    said = dict(first_page(replace(robust, rivals=(mine,))).lines)["Yours"]
    assert "over the bound" not in said
    assert {one.attainable for one in mine.stops if one.law == "curve"} == {
        one.attainable for one in robust.stops if one.law == "curve"
    }


def test_a_controller_whose_hand_over_is_above_every_speed_is_not_called_unstable(robust):
    always = PI(kp=190.0, ki=5.0, hand_over_speed=120 / 3.6)
    mine = recommendation._rival("mine", always, robust.envelope, False)
    said = dict(first_page(replace(robust, rivals=(mine,))).lines)["Yours"]
    assert "120 km/h" in said
    assert "at the highest speed" not in said


def test_the_rows_of_the_stops_belong_to_the_runs_that_they_name(robust):
    def rows(report):
        return {name: (value, where) for name, value, where in pages._rows(report)}

    wrong = [stop for stop in robust.harder_stops if stop.errors != CHANGES]
    longest = max(stop.distance for stop in wrong)
    assert numbers_of(rows(robust)["Longest stop with errors"][0])[0] == pytest.approx(longest, rel=1e-3)
    for report in (robust, replace(robust, harder_stops=())):
        runs = [run for stop in (*report.stops, *report.harder_stops) for run in stop.runs]
        slipped = max(runs, key=lambda run: run.max_slip)
        assert numbers_of(rows(report)["Highest slip"][1])[-1] == pytest.approx(slipped.braking_distance, rel=1e-3)
    over = robust.control.controlled_from  # the hand-over speed; the wheel locks in one stop above it, in one below
    low, high = (
        replace(stop, run=replace(stop.run, locked_fraction=0.1), rail=Rail.WET, locked_from=speed)
        for stop, speed in zip(robust.stops, (0.9 * over, 2.0 * over), strict=False)
    )
    wet = next(name for name in rows(robust) if name.startswith("Stop, wet"))
    here = [stop for stop in (*robust.stops, *robust.harder_stops) if stop.rail is Rail.WET and not stop.locks]
    for more, text in (
        ((low,), f"locks in 1 of {len(here) + 1} stops, only below"),
        ((low, high), ", in 1 only below"),
    ):
        assert text in rows(replace(robust, stops=tuple(here), harder_stops=more))[wet][1]
    best = replace(robust.trials[0], harder=(low, high))
    (reason,) = [text for text in candidates._lacks(best, best.judgement) if "locks" in text]
    assert f"at {2.0 * over * 3.6:.0f} km/h" in reason


def test_stops_with_errors_and_a_changing_rail(robust):
    wrong = [one for one in robust.harder_stops if one.errors != CHANGES]
    laws = {one.law for one in robust.stops}
    assert laws == {"curve", "polach", "bristle"}
    assert len(wrong) == 8 * len(laws)
    gains = [one.run.scenario.limits.torque_gain for one in wrong if one.law == "curve"]
    scales = [one.run.scenario.measurement.speed_scale for one in wrong if one.law == "curve"]
    pairs = list(zip(gains, scales, strict=True))
    assert {pairs.count(pair) for pair in product((0.85, 1.15), (0.98, 1.02))} == {2}
    assert len({one.run.scenario.vehicle.wheel.radius for one in wrong}) == 2
    assert {one.run.scenario.measurement.encoder_teeth for one in wrong} == {0.0, 80.0}
    assert simulate(wrong[0].run.scenario, robust.control, seed=0).max_slip == wrong[0].run.max_slip
    changing = [one for one in robust.harder_stops if one.errors == CHANGES]
    assert [[e.rail for e in one.run.scenario.events] for one in changing] == [["wet", "dry"]] * len(laws)


@pytest.mark.parametrize("limit", [80.0, 160.0])
def test_speeds_follow_from_the_vehicle_s_limit(limit):
    car = PARK2008.model_copy(update={"speed_limit": limit / 3.6})
    envelope = Envelope(car)
    assert (max(envelope.speeds), envelope.initial_speed) == (limit, limit)
    assert envelope.law_speed == min(limit, 140.0)
    law = next(plant.point.law for plant in envelope.points(nominal=True).plants if plant.point.law.name == "curve")
    assert law == published_law("curve", law.rail, envelope.law_speed, car.wheel_load)
    blank = candidates.unjudged(envelope)
    made = [stop_scenario(envelope, blank.points, name, "empty", "wet") for name in laws_of_stops(blank)]
    assert {round(one.initial_speed * 3.6, 6) for one in made} == {limit}
    assert Envelope(car, speeds=(20, 60)).speeds == (20.0, 60.0)


def test_the_speed_limit_of_a_vehicle_file_counts_with_and_without_its_table_of_the_envelope(tmp_path):
    path = tmp_path / "car.toml"
    path.write_text('name = "Car"\nmass = 3517.0\nspeed_limit = "160 km/h"\n[envelope]\nloads = ["empty"]\n', "utf-8")
    envelope = load_envelope(path)
    assert (max(envelope.speeds), envelope.initial_speed, envelope.loads) == (160.0, 160.0, ("empty",))
    railtoolkit = load_envelope(ROOT / "designs/vehicles/siemens_desiro_classic.yaml")
    assert (max(railtoolkit.speeds), railtoolkit.initial_speed) == (120.0, 120.0)
    coach = load_envelope(ROOT / "designs/vehicles/coach.toml")  # its table gives speeds
    assert (max(coach.speeds), coach.initial_speed) == (100.0, 100.0)


def test_where_none_qualifies_the_least_bad_is_told_with_the_reason_and_what_was_tried(robust):
    trials = [replace(one, above_kmh=None, reason="a wheel locks in 3 of 42 stops") for one in robust.trials]
    lost = replace(robust, trials=tuple(trials), above_kmh=None)
    first, lines, _ = told(lost)
    assert "QUALIFIES" in first.headline
    assert lines["Why"] == "A wheel locks in 3 of 42 stops."
    assert "; slide protection: " in lines["Choice"]
    assert "25 % of dead time" in lines["Remedy"]
    remedy = candidates.Remedy("dead time 0.1 s and lag 0.3 s", robust.trials[0])
    lines = dict(first_page(replace(lost, remedy=remedy)).lines)
    assert lines["Remedy"].startswith("a brake with dead time 0.1 s and lag 0.3 s: PI-lead")
    assert len(design_report_text(lost, first, "").splitlines()) <= MOST_LINES
    assert Page(rendered(lost)).problems() == []
    content = json.loads(json.dumps(design_report_json(lost), allow_nan=False))
    assert content["recommended"]["usable_from_kmh"] is None
    assert [one["reason"] for one in content["trials"]] == [one.reason for one in trials]


def test_a_slow_brake_is_reported_with_all_that_was_tried(hopeless):
    first, _, _ = told(hopeless)
    assert hopeless.control is not None
    assert first.headline.startswith(("NO CONTROLLER QUALIFIES", "USE"))
    assert Page(rendered(hopeless)).problems() == []
    content = json.loads(json.dumps(design_report_json(hopeless), allow_nan=False))
    assert {one["structure"] for one in content["trials"]} >= {"seeking", "predictive", "slide-protection"}


def test_notes_that_the_page_leaves_out_are_counted(robust, monkeypatch):
    skipped = tuple(f"case {i}" for i in range(12))
    many = replace(robust.judgement, points=replace(robust.judgement.points, skipped=skipped))
    monkeypatch.setattr(type(robust), "judgement", many)
    texts = [block.text for block in pages._envelope(robust).blocks if isinstance(block, Paragraph)]
    left_out = len(skipped) + len(many.slip_notes) - sum(text.startswith("Case") for text in texts)
    assert left_out > 0
    assert texts[-1].startswith(f"{left_out} more notes")


def test_a_judgement_over_fewer_speeds_is_that_of_the_smaller_envelope(robust):
    some = restricted(robust.judgement, 100.0)
    again = judge(some.envelope, robust.judgement.controller)
    assert len(some.points) == len(again.points)
    assert some.worst.table() == again.worst.table()
    np.testing.assert_allclose(some.margins.phase_deg, again.margins.phase_deg, rtol=1e-9)  # batches of other sizes


def test_gains_around_the_design_are_worst_cases_of_exact_loops(robust):
    found, points = robust.gains, robust.in_use.points
    i, j, design = np.argmin(np.abs(found.kp - found.chosen[0])), 0, robust.control.system
    c = PIController(PIGains(kp=float(found.kp[i]), ki=float(found.ki[j])), design.lead, design.lead_filter)
    cases = [points.case(int(n)) for n in np.flatnonzero(points.operating)]
    loops = [wheel_slip_loop(case.plant, c, case.actuator) for case in cases]
    assert len(loops) == found.points
    worst = max(loop.margins().ms if loop.is_stable() else math.inf for loop in loops)
    assert found.ms[i, j] == pytest.approx(worst, rel=1e-6)  # batch and scalar engine
    figure = report_drawings(robust)["gains"]()
    figure.draw_without_rendering()
    numbers, box = [text.get_window_extent() for text in figure.axes[0].texts], figure.axes[0].bbox
    assert len(numbers) > 2
    assert all(np.all(box.min < one.min) and np.all(one.max < box.max) for one in numbers)


def test_the_bound_is_that_of_the_brake_and_what_is_held_is_told(robust):
    assert any(one.bound for one in robust.stops)
    for one in (one for one in robust.stops if one.bound is not None):
        assert one.run.braking_distance > one.bound.braking_distance
        signals = one.run.signals
        controlled = signals.slip[signals.speed * 3.6 > 10.0]  # below, the file holds a torque
        assert 0 < controlled.size < signals.slip.size
        assert one.settled_slip == np.median(controlled[controlled.size // 2 :])
        assert one.reached == (one.settled_slip >= 0.95 * one.reference)
    for name, value, where in first_page(robust).rows:
        if name.startswith("Stop, "):  # the longest of all laws and loads, under the head "worst"
            rail = name.split(", ")[1]
            worst = max((one for one in robust.stops if one.rail == rail), key=lambda one: one.run.braking_distance)
            assert float(value.removesuffix(" m")) == pytest.approx(worst.run.braking_distance, rel=1e-3)  # 4 digits
            assert where.startswith(f"{worst.law}, {worst.load}: ")
    slow = [replace(one, settled_slip=0.5 * one.reference) for one in robust.stops]
    assert "below its reference" in told(replace(robust, stops=tuple(slow)))[1]["To do"]


def test_a_stop_in_which_the_wheel_oscillates_is_told(robust):
    assert not any(one.swings for one in robust.stops)
    assert "oscillates" not in told(robust)[1].get("Risk", "")
    swings = replace(robust, stops=(swinging(robust.stops[0]), *robust.stops[1:]))
    assert "curve the wheel oscillates" in told(swings)[1]["Risk"]
    swung = swinging(robust.trials[0].stops[0], braking_distance=1.0)
    below = replace(swung, cut_out=1.01 * swung.run.signals.speed.max())
    assert (swung.swings, below.swings) == (True, False)  # not the controller's doing


def test_the_seeking_controller_is_judged_and_runs_the_same_stops(robust):
    trial, stops = robust.seeking, {(one.law, one.load, one.rail): one for one in robust.stops}
    judged = trial.judgement
    assert judged.ms.tolist() == judge(robust.envelope, trial.control, nominal=judged.nominal).ms.tolist()
    assert {(one.law, one.load, one.rail) for one in trial.stops} == stops.keys()
    alone = simulate(stop(robust.vehicle, "wet"), trial.control, seed=0)
    (same,) = (one for one in trial.stops if (one.law, one.load, one.rail) == ("curve", "empty", "wet"))
    assert same.runs[0].braking_distance == alone.braking_distance
    assert {one["reference_slip"] for one in design_report_json(robust)["seeking"]} == {None}


@pytest.mark.long
def test_the_seeking_controller_is_recommended_where_it_is_best(tmp_path):
    only = {"laws": "curve", "speeds": 60, "loads": "empty", "slip": 1.0, "radius": 1.0, "dead_time": 1.0, "lag": 1.0}
    found = design_report(Envelope(PARK2008, **only), sliding=False)
    assert (found.best.structure, found.above_kmh, found.in_use.verdict) == ("seeking", 60.0, "robust")
    others = [trial.distance() for trial in found.trials if trial is not found.seeking]
    assert found.seeking.distance() < min(others)
    (tmp_path / "seeking.toml").write_text(found.control.toml, "utf-8")
    assert load_controller(tmp_path / "seeking.toml") == Seeking.for_vehicle(PARK2008, name="seeking")
    page, content = first_page(found), design_report_json(found)
    assert (page.headline.startswith("USE"), "seeking" in page.subject) == (True, True)
    assert content["recommended"]["controller"]["kind"] == "seeking"
    assert content["recommended"]["worst"]["ms"] == found.judgement.worst.ms
    points, slips = [plant.point for plant in found.in_use.points.plants], {}
    for one in found.stops:
        known = [point.slip for point in points if point.rail is one.rail]
        if not min(known) <= one.settled_slip <= max(known):
            slips.setdefault(one.rail, set()).add(one.settled_slip)
    assert {one.rail: set(one.slips) for one in found.unjudged_slips} == slips != {}
    for one in found.unjudged_slips:  # by the scalar engine
        cases = product([point for point in points if point.rail is one.rail], one.slips)
        loops = [operating_point(p.law, p.vehicle, p.speed, slip, rail=p.rail) for p, slip in cases]
        ms = max(found.control.loop_as_run(point, PARK2008.actuator).margins().ms for point in loops)
        assert one.ms == pytest.approx(ms, rel=1e-6)  # as the two engines agree
    assert "outside the envelope" in rendered(found)


def test_a_loop_about_free_rolling_is_told_of_a_law_that_oscillates(robust):
    """A loop that takes torque away too late drives a wheel on a spring: Re C Ga < 0 at its frequency."""
    swung = swinging(next(one for one in robust.stops if one.law == "bristle"))
    (found,) = rolling_loops((swung,), robust.control.system, robust.judgement)
    car, actuator, design = robust.vehicle, robust.vehicle.actuator, robust.control.system
    alpha = published_law("bristle", "dry", wheel_load=car.wheel_load).alpha
    spring = alpha * (car.wheel.radius**2 / car.wheel.inertia + 1 / car.mass)
    assert found.frequency == pytest.approx(math.sqrt(spring), rel=1e-6)  # but for the friction
    s = 1j * found.frequency
    control = (design.gains.kp + design.gains.ki / s) * (design.lead * s + 1) / (design.lead_filter * s + 1)
    assert found.stable == ((control * np.exp(-s * actuator.dead_time) / (actuator.lag * s + 1)).real > 0)
    blocks = pages._stops(replace(robust, rolling=(found,))).blocks
    text = [block.text for block in blocks if isinstance(block, Paragraph)]
    assert len(text) == 2
    assert f"{found.frequency / (2 * math.pi):.2g} Hz" in text[1]


A4 = 794  # CSS pixels

# A browser without a network: it looks for nothing by itself.
FLAGS = (
    *("headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", "no-first-run"),
    *("disable-background-networking", "disable-component-update", "disable-sync"),
)
WIDER = "return document.documentElement.scrollWidth > document.documentElement.clientWidth"
CUT = """return [...document.querySelectorAll(".scroll")].filter((one) => one.offsetParent !== null
  && !one.closest("figure") && one.scrollWidth > one.clientWidth + 1).map((one) => one.innerText.slice(0, 60))"""
UNSEEN = """return [...document.images].filter((one) => {
  const box = one.getBoundingClientRect();
  return !one.complete || one.naturalWidth === 0 || box.width < 100 || box.height < 50;
}).map((one) => one.alt)"""
SCALES = "return [...document.images].map((one) => one.getBoundingClientRect().width / one.naturalWidth)"
LOADED = """return performance.getEntriesByType("resource").map((one) => one.name)
  .filter((name) => !name.startsWith("data:"))"""
TORN = """const style = (names, key) => [...document.querySelectorAll(names)].map((one) => getComputedStyle(one)[key]);
return [...style("h2, h3, caption, summary", "breakAfter"), ...style("figure, .short, .finding, tr", "breakInside")]
  .filter((value) => value !== "avoid").concat(style("figure", "float").filter((value) => value !== "left"))"""
OPEN = 'return [...document.querySelectorAll("details")].filter((one) => one.open).length'


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options, names = webdriver.ChromeOptions(), ("chromium", "chromium-browser", "google-chrome")
    options.binary_location, driver = next(filter(None, map(shutil.which, names)), ""), shutil.which("chromedriver")
    if not (options.binary_location and driver):
        pytest.skip("no chromium with chromium-driver")
    for flag in (*FLAGS, f"user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with webdriver.Chrome(options=options, service=Service(driver)) as found:
        yield found


@pytest.fixture
def show(browser, full_report):
    def shown(width):
        screen = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        browser.get((full_report[0] / "report.html").as_uri())
        assert [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")] == []
        return browser.execute_script

    return shown


@pytest.mark.long
@pytest.mark.parametrize("width", [390, A4, 1200])  # of a phone, of a page, of a desk
def test_the_page_in_a_browser_fits_shows_every_figure_and_loads_nothing(show, width):
    """That each link has a target is looked at in the page's text, `html_page`."""
    run = show(width)
    assert (run("return innerWidth"), run(WIDER), run(UNSEEN), run(LOADED)) == (width, False, [], [])
    assert run("return document.images.length") >= 4
    assert run(CUT) == []
    assert style.SMALL * 4 / 3 * min(run(SCALES)) > 9.0  # pixels of the smallest letters
    run("document.querySelector('nav a[href=\"#stops\"]').click()")
    # the section is where the eye is; a pixel of rounding
    assert abs(run("return document.getElementById('stops').getBoundingClientRect().top")) < 2


@pytest.mark.long
def test_prints_on_a4_with_everything_opened_and_together_what_belongs_together(browser, show):
    run = show(A4)
    before = run(OPEN)
    run("dispatchEvent(new Event('beforeprint'))")
    assert run(OPEN) == run("return document.querySelectorAll('details').length")
    run("dispatchEvent(new Event('afterprint'))")
    assert run(OPEN) == before == 0
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True, "printBackground": True})
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", base64.b64decode(printed["data"]))
    assert 3 <= len(boxes) <= 12  # beyond, pages are left half-empty, as those before a figure once were
    for width, height in boxes:
        # points; a browser rounds A4 to its own pixels, three quarters of a point each
        assert (float(width), float(height)) == pytest.approx((595.0, 842.0), abs=1.0)
    run = show(680)  # CSS pixels between the margins of A4, 180 mm: a wider page is printed smaller
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    run("dispatchEvent(new Event('beforeprint'))")
    assert (run(WIDER), run(TORN)) == (False, [])
