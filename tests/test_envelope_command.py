"""`margins` and `tune` over an envelope, and what a mass given alone leaves as it was."""

from __future__ import annotations

import json

import pytest
from sample_vehicles import COACH

from railslip_ctrl.core.errors import InfeasibleDesignError
from railslip_ctrl.design import PIController, envelope_tuning
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.envelope_tuning import held_slips, tune
from railslip_ctrl.design.judging import judge
from railslip_ctrl.design.specification import Specification
from railslip_ctrl.design.tuning import tune_cases
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.vehicle import PIGains
from railslip_ctrl.model.vehicle_files import load_vehicle

COACH_FILE = """
name = "Coach, quarter car"
mass = 11000
mass_loaded = 17437
[wheel]
radius = 0.46
inertia = 90
viscous_friction = 0.25
[actuator]
dead_time = "120 ms"
lag = "0.4 s"
[resistance]
constant = 100
linear = 0
quadratic = 0.6
"""
GAINS = ("--kp", "1100", "--ki", "60", "--lead", "0.4")
FAST = PIController(PIGains(kp=1100.0, ki=60.0), lead=0.4, lead_filter=0.04)


@pytest.fixture
def coach(tmp_path):
    path = tmp_path / "coach.toml"
    path.write_text(COACH_FILE, encoding="utf-8")
    return path


def test_margins_over_the_default_envelope_are_those_of_judge(railslip, coach):
    status, out, err = railslip("margins", "--vehicle", coach, *GAINS, "--envelope", "default", "--json")
    found, judged = json.loads(out), judge(FAST, Envelope(load_vehicle(coach)))
    assert (status, err) == (1, "")
    assert {key: found[key] for key in judged.table()} == json.loads(json.dumps(judged.table()))
    assert set(found["worst"]["case"]) == {
        "adhesion", "rail", "speed_kmh", "slip", "load", "mass_kg", "wheel_load_n", "dead_time_s", "lag_s", "radius_m",
    }  # fmt: skip
    assert len(found["cases"]) == 48
    assert {case["load"] for case in found["cases"]} == {"empty", "loaded"}
    assert {case["wheel_load_n"] for case in found["cases"]} == {COACH.wheel_load, COACH.wheel_load_loaded}
    stable = [case["stable"] for case in found["cases"]]
    assert stable == judged.stable[judged.points.operating].tolist()


def test_options_narrow_the_envelope_and_files_have_it(railslip, coach, tmp_path):
    named = ("--rail", "wet", "--speed", "60", "--slip", "0.07", "--loaded", "--adhesion", "curve")
    narrow = json.loads(railslip("margins", "--vehicle", coach, *GAINS, *named, "--envelope", "default", "--json")[1])
    envelope = narrow["envelope"]
    assert [envelope[key] for key in ("rails", "laws", "speeds", "loads")] == [["wet"], ["curve"], [60.0], ["loaded"]]
    assert envelope["reference"]["wet"] == narrow["worst"]["case"]["slip"] == 0.07
    assert narrow["worst"]["case"]["wheel_load_n"] == COACH.wheel_load_loaded
    own = '[envelope]\nrails = ["wet"]\nlaws = "curve"\nspeeds = 60\nloads = "loaded"\n'
    own += "reference = {dry = 0.07, wet = 0.07}\n"
    (tmp_path / "envelope.toml").write_text(own, encoding="utf-8")
    file = tmp_path / "envelope.toml"
    assert json.loads(railslip("margins", "--vehicle", coach, *GAINS, "--envelope", file, "--json")[1]) == narrow
    coach.write_text(COACH_FILE + own, encoding="utf-8")  # of the vehicle's own file
    assert json.loads(railslip("margins", "--vehicle", coach, *GAINS, "--envelope", "default", "--json")[1]) == narrow


def test_the_text_says_verdict_worst_and_map_and_nominal_says_so(railslip):
    arguments = ("margins", "--kp", "229.4", "--ki", "5", "--lead", "0.6", "--speed", "20", "--speed", "60")
    status, out, _ = railslip(*arguments, "--envelope", "default")
    assert status == 0
    assert "Verdict: fragile: unstable at curve, dry, empty, 20 km/h, slip +25 %" in out
    assert "Usable from  60 km/h" in out
    assert "432, of them 16 operating points" not in out
    assert "knife's edge" in out
    status, out, _ = railslip(*arguments, "--envelope", "default", "--nominal")
    assert status == 0
    assert "Verdict: robust at the operating points: Ms 1.57 at curve, dry, empty, 20 km/h" in out
    assert "with tolerances" not in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--mass", "4000"), "--mass: changes M alone, and the loads of an envelope are mass and wheel load"),
        (("--certify",), "--certify: goes with operating points"),
        (("--slip", "0"), "reference.dry: 0 is not allowed"),
    ],
)
def test_what_no_envelope_has_is_refused(railslip, arguments, message):
    status, out, err = railslip("margins", "--envelope", "default", *arguments)
    assert (status, out) == (2, "")
    assert message in err
    assert railslip("margins", "--envelope", "missing.toml")[0] == 2


def test_a_mass_given_alone_is_told_in_the_verdict(railslip, coach):
    _, out, err = railslip("margins", "--vehicle", coach, *GAINS, "--rail", "wet", "--mass", "17437")
    assert "M alone was changed: the wheel load stayed at 107873 N." in out.splitlines()[-1]
    assert "the wheel load stayed" in err
    for own in (("--mass", "11000"), ("--loaded",), ("--loaded", "--mass", "17437")):
        assert "stayed" not in "".join(railslip("margins", "--vehicle", coach, *GAINS, *own)[1:])


# --- tune -----------------------------------------------------------------------------------------------------------


def test_tune_holds_empty_and_loaded_together_and_is_judged(railslip, coach):
    envelope = Envelope(load_vehicle(coach), rails="dry", laws="bristle", speeds=(60, 100))
    best = tune(envelope, "pi-lead", 2.5)
    again = judge(best, envelope)
    assert best.judgement.ms == pytest.approx(again.ms, rel=1e-12)
    assert again.ms[again.points.operating].max() == pytest.approx(2.5, rel=1e-9)
    assert again.worst.case.load == "loaded"
    # the true load, not the mass alone: with the wheel load as it was, Ms is less
    alone = COACH.model_copy(update={"mass": COACH.mass_loaded})
    assert judge(best, Envelope(alone, rails="dry", laws="bristle", speeds=(60, 100), loads="empty")).worst.ms < 2.45
    assert (best.reference.dry, best.reference.wet) == (0.132, 0.132)  # of dry rail alone
    assert str(best).startswith("PI-lead: kp ")
    arguments = ("--vehicle", coach, "--rail", "dry", "--adhesion", "bristle", "--speed", "60", "--speed", "100")
    status, out, _ = railslip(
        "tune", *arguments, "--structure", "pi-lead", "--ms-max", "2.5", "--envelope", "default", "--json"
    )
    found = json.loads(out)
    assert (status, found["kp_si"], found["ki_si"]) == (0, best.gains.kp, best.gains.ki)
    assert {key: found[key] for key in again.table()} == json.loads(json.dumps(best.judgement.table()))
    assert len(found["cases"]) == 4


def test_tune_judges_the_envelope_unless_points_are_named(railslip):
    whole = json.loads(railslip("tune", "--structure", "pi-lead", "--ms-max", "2", "--json")[1])
    assert not whole["feasible"]
    assert whole["reason"].endswith("from 20 km/h up it can")
    named = railslip("tune", "--structure", "pi-lead", "--ms-max", "2", "--speed", "100", "--mass", "4000")[1]
    assert "of the operating points alone. M alone was changed: the wheel load stayed at 34500 N." in " ".join(
        named.split()
    )
    over = ("tune", "--structure", "pi-lead", "--ms-max", "2", "--speed", "100", "--envelope", "default")
    assert "Verdict: robust: Ms 2" in railslip(*over)[1]
    assert "Verdict: robust at the operating points: Ms 2" in railslip(*over, "--nominal")[1]


def test_tune_says_that_no_speed_will_do():
    with pytest.raises(InfeasibleDesignError, match="at no speed of the envelope it can"):
        tune(Envelope(COACH, speeds=(60, 100), rails="dry", laws="curve"), "pi", 1.1)
    with pytest.raises(InfeasibleDesignError, match="from 60 km/h up it can"):
        tune(Envelope(speeds=(20, 40, 60, 100), rails="dry", laws="curve"), "pi-lead", 1.15)


def test_the_slips_held_are_those_of_every_law():
    mine = published_law("bristle", "dry").model_copy(update={"reference": ReferenceSlip(dry=0.1, wet=0.08)})
    for axes, held in (({}, (0.132, 0.092)), ({"rails": "wet"}, (0.092, 0.092)), ({"laws": [mine, "curve"]}, None)):
        envelope = Envelope(speeds=60, **axes)
        found = held_slips(envelope, envelope.points(nominal=True))
        assert (found and (found.dry, found.wet)) == held


def test_an_infeasible_tune_tells_early(monkeypatch):
    """What the slowest and the fastest points refuse all refuse; from which speed it can is found by halving."""
    asked = []

    def counted(plants, *arguments, **options):
        asked.append(len(plants))
        return tune_cases(plants, *arguments, **options)

    monkeypatch.setattr(envelope_tuning, "tune_cases", counted)
    envelope = Envelope(rails="dry", laws="curve", loads="empty", speeds=range(4, 101, 4))
    with pytest.raises(InfeasibleDesignError, match=r"at 4 and 100 km/h alone: .*; from 16 km/h up it can"):
        tune(envelope, "pi-lead", 1.8)
    assert sum(asked) < 2 * len(envelope.speeds)  # each speed in turn: 25 + 24 + 23 + 22
    for speed, can in ((12, False), (16, True)):  # halving finds what asking all above a speed says
        some = envelope.at(speeds=range(speed, 101, 4))
        assert (envelope_tuning.tune_over(some, Specification(1.8), "pi-lead")[1] is not None) == can


def test_what_tune_writes_is_judged_the_same_and_a_transfer_function_too(railslip, coach, tmp_path):
    file = tmp_path / "best.toml"
    case = ("--vehicle", coach, "--envelope", "default", "--adhesion", "curve", "--speed", "60", "--speed", "100")
    _, out, _ = railslip(
        "tune", *case, "--structure", "pi-lead", "--ms-max", "2", "--slip", "0.1", "--out", file, "--json"
    )
    tuned = json.loads(out)
    _, out, _ = railslip("margins", *case, "--controller", file, "--json")  # with the slip of its file
    judged = json.loads(out)
    for key in ("verdict", "worst", "worst_with_tolerances"):
        assert judged[key] == tuned[key]
    mine = tmp_path / "mine.py"
    mine.write_text("import control as ct\nCONTROLLER = ct.tf([440.0, 1124, 60], [0.04, 1, 0])  # FAST\n")
    _, out, _ = railslip("margins", *case, "--controller", mine, "--json")
    expected = judge(FAST, Envelope(load_vehicle(coach), laws="curve", speeds=(60, 100))).worst.ms
    assert json.loads(out)["worst"]["ms"] == pytest.approx(expected, rel=1e-9)
