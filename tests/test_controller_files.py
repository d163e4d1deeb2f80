"""Controllers' files, written and read, and `--controller` in every command."""

import itertools
import json
import math

import control as ct
import numpy as np
import pytest
from project import refused

import railslip_ctrl as rs
from railslip_ctrl import PARK2008, InputError, PIGains, Rail, load_controller
from railslip_ctrl.design import PIController, StateSpaceController
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.report.stops import as_run
from railslip_ctrl.simulation import LinearControl, SlideProtection, SlidingControl
from railslip_ctrl.simulation.catalogue import published_reference
from railslip_ctrl.sliding.law import LawGains

S = ct.tf("s")
HELD = ReferenceSlip(dry=0.1317, wet=0.0923)
NOTCHED = 240.123456789 * (1 + 0.02 / S) * (0.6 * S + 1) / (0.05 * S + 1) * (S**2 + S + 400) / (S + 20) ** 2
ALL = {"torque_low": 0.0, "torque_high": 9000.1, "tracking_time": 1.0 / 3.0, "initial_torque": 1500.7}
ALL |= {"cut_out_speed": 5.0 / 3.6, "cut_out_torque": 1111.1}
CONTROLS = {
    "pi": LinearControl(PIController(PIGains(kp=1.0 / 3.0, ki=0.0)), HELD),
    "pi-lead": LinearControl(PIController(PIGains(kp=229.1, ki=5.3), 0.6, 0.06), HELD, 'a "b" ä', 0.02, **ALL),
    "filtered": LinearControl(PIController(PIGains(kp=229.1, ki=5.3), 0.0, 0.06), HELD, tracking_time=None),
    "transfer function": LinearControl(NOTCHED, HELD, "mine", 0.01, rule="tustin", **ALL),
    "state space": LinearControl(ct.tf2ss(NOTCHED), HELD, "mine", 0.01, **ALL),
    "factored": LinearControl(ct.zpk([-1.0], [0.0, -3.0], 7.0), HELD, "mine", 0.01, tracking_time=math.inf),
    "discrete": LinearControl(ct.sample_system(NOTCHED, 0.02, "tustin"), HELD, "mine", tracking_time=None),
    "a number": LinearControl(300.0, HELD, "mine", 0.01),
}


@pytest.mark.parametrize("name", CONTROLS)
def test_what_is_saved_is_loaded_again(tmp_path, name):
    path = tmp_path / "c.toml"
    CONTROLS[name].save(path)
    assert load_controller(path) == CONTROLS[name]


PUBLISHED = published_reference("bristle")
AS_BEFORE = {"period": None, "rule": "backward"}  # of a PI's file without either
TWO_STATES = ((0.0, 1.0), (-1.0, -2.0)), (0.0, 1.0), (3.0, 4.0), 5.0
STATES = {
    "A = []\nB = []\nC = []\nD = 0.5": ((), (), (), 0.5),
    "A = -1\nB = 2\nC = 3": (((-1.0,),), (2.0,), (3.0,)),
    "a = [[0, 1], [-1, -2]]\nb = [[0], [1]]\nc = [[3, 4]]\nd = [[5]]": TWO_STATES,
}
IN_FEW_WORDS = {
    'kind = "pi"\nkp = 0.5\nki = 0.5': LinearControl(PIController(PIGains(kp=0.5, ki=0.5)), PUBLISHED, **AS_BEFORE),
    'kind = "asmc"\nK = 0.5\nD = 0.5\nrho = 0.5\nnominal_mass = 0.5\nfilter_time = 0.5': SlidingControl(
        LawGains(K=0.5, D=0.5, rho=0.5), PUBLISHED, nominal_mass=0.5, filter_time=0.5
    ),
    'kind = "pi"\nkp = 1.0\nki = 1.0\ntorque_low = 0.5\ntorque_high = 2.0': LinearControl(  # as written earlier
        PIController(PIGains(kp=1.0, ki=1.0)), PUBLISHED, torque_low=0.5, torque_high=2.0, **AS_BEFORE
    ),
    'kind = "slide-protection"\nfill_rate = 0.5\ntorque_max = 0.5\nfilter_time = 0.5\ndump_slip = 0.3': SlideProtection(
        PUBLISHED, fill_rate=0.5, torque_high=0.5, filter_time=0.5, dump_slip=0.3
    ),
} | {
    f'kind = "state-space"\n{text}': LinearControl(StateSpaceController(*matrices), PUBLISHED, "state-space", 0.01)
    for text, matrices in STATES.items()
}


@pytest.mark.parametrize("text", IN_FEW_WORDS)
def test_what_a_file_leaves_out_is_the_controller_s_own(tmp_path, text):
    path = tmp_path / "c.toml"
    path.write_text(text)
    assert load_controller(path) == IN_FEW_WORDS[text]


def test_what_has_no_file_is_told(tmp_path):
    with pytest.raises(InputError, match="period: a file of a transfer function or state space needs one"):
        LinearControl(NOTCHED, HELD, period=None).save(tmp_path / "c.toml")
    with pytest.raises(InputError, match="cannot be written"):
        CONTROLS["pi"].save(tmp_path / "none" / "c.toml")
    curve, slips = published_law("curve", "dry"), [ReferenceSlip(dry=dry, wet=0.07) for dry in (0.08, 0.1)]
    design = rs.tune(rs.Envelope(laws=[curve.model_copy(update={"reference": slip}) for slip in slips], speeds=100))
    with pytest.raises(InputError, match="different slips"):
        design.save(tmp_path / "c.toml")
    assert rs.simulate(rs.stop(), design).controller.reference.dry == 0.132  # the law's of the run


PI = 'kind = "pi"\nkp = 1.0\nki = 1.0'
TF, SS = 'kind = "transfer-function"', 'kind = "state-space"'


@pytest.mark.parametrize(("text", "told"), [
    (f"{TF}\nnum = [1.0]", "den: missing"),
    (f"{TF}\nnum = [1.0, 0.0]\nden = [1.0]", "not proper"),
    (f"{TF}\nnum = [1.0]\nden = [0.001, 1.0]", "pole of 1000 1/s; give a value <= 0.002"),
    (f"{TF}\nnum = []\nden = [1.0]", "num: is empty"),
    (f"{SS}\nA = [[0.0]]\nB = [1.0, 2.0]\nC = [1.0]", "do not fit"),
    (f"{SS}\nA = [[0.0, 1.0], [2.0]]\nB = [1.0, 2.0]\nC = [1.0, 2.0]", "A: has rows of 1 and of 2 numbers"),
    (f"{SS}\nA = [0.0, 1.0]\nB = [1.0, 2.0]\nC = [1.0, 1.0]", "A: give its rows"),
    (f"{SS}\nA = [[0.0]]\nB = [[1.0, 2.0]]\nC = 1.0", "B: is not of one input"),
    (f"{SS}\nA = [[0.0]]\nB = 1.0\nC = [[1.0], [2.0]]", "C: is not of one input"),
    (f"{SS}\nA = 1.0\na = 1.0\nB = 1.0\nC = 1.0", "in both cases"),
    ('kind = "pi-lead"\nkp = 1.0\nki = 1.0', "lead: missing"),
    ("kind = 3", "kind: 3 is not one"),
    ("kp = 1.0", "kind: missing; choose one of pi"),
    ('kind = "pid"', "kind: 'pid' is not one; did you mean 'pi'"),
    (f'{PI}\nrule = "euler"', "rule: 'euler' is not allowed; give 'tustin' or"),
    (f"{PI}\nled = 0.6", "led: unknown key; did you mean 'lead'"),
    (f"{PI}\nlead = 0.6", "lead filter: 0 s"),
    ('kind = "pi"\nkp = "1 kg"\nki = 1.0', "kp: '1 kg' has the wrong dimension"),
    (f"{PI}\nperiod = 1e-9", "period: 1e-09 is not allowed"),
    ('kind = "asmc"\nK = 1.0\nD = 1.0\nrho = 1.0\nadhesion = "curve"', "is not a TOML file"),
    ('kind = "slide-protection"\nfill_slip = 0.5', "0 < fill_slip < dump_slip < 1"),
    ('kind = "torque-profile"\ntimes = [0]\ntorques = []', "1 times and 0 torques"),
    (f"{PI}\ntorque_hi = 1.0", "period, reference, torque_min, torque_max, anti_windup"),
    (f"{PI}\ntorque_min = 1.0\ntorque_max = 1.0", "give a value > torque_min = 1"),
    (f"{PI}\ntorque_max = 1.0\ntorque_high = 2.0", "torque_high: torque_max is given too"),
])  # fmt: skip
def test_a_file_that_is_wrong_is_told(tmp_path, text, told):
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"c\.toml: ") as caught:
        load_controller(path)
    assert (told in str(caught.value), "\n" in str(caught.value)) == (True, False)


CASE = ("--adhesion", "bristle", "--rail", "dry", "--speed", "100")
WHEEL = rs.plant_at("bristle", PARK2008, Rail.DRY, 100.0)


def test_margins_of_a_transfer_function_through_the_command(railslip, tmp_path):
    """PI, lead and a second-order part: by NumPy on a fine grid of frequencies."""
    c = 240 * (S + 0.02) / S * (0.6 * S + 1) / (0.06 * S + 1)
    c = c * (S**2 + 25 * S + 625) / (S**2 + 45 * S + 2000) * 3.2
    path, num, den = tmp_path / "c.toml", c.num[0][0].tolist(), c.den[0][0].tolist()
    path.write_text(f'kind = "transfer-function"\nnum = {num}\nden = {den}\nperiod = "1 ms"\ntorque_max = "9 kN*m"\n')
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


@pytest.mark.parametrize(("words", "told"), [
    ("asmc", "controller: asmc is not linear and has no margins"),
    ("nope", "--controller: 'nope' is not one"),
    ("discrete.py --certify", "--certify: the loop of a discrete controller has no"),
    ("discrete.py --lead 0.6", "--lead: does not go with --controller"),
    ("discrete.py --kp 1 --ki 1", "--kp: does not go with a controller from a file"),
])  # fmt: skip
def test_margins_refuses_in_one_line(railslip, file, words, told):
    file("discrete.py", "import control as ct\nCONTROLLER = ct.tf([190.0], [1.0], 0.05)\n")
    assert told in refused(railslip("margins", *CASE, "--controller", *words.split()))


def test_a_file_is_judged_at_the_slip_that_it_holds_unless_told(railslip, tmp_path):
    file = tmp_path / "pi.toml"
    file.write_text('kind = "pi"\nkp = 190\nki = 5\nreference = { dry = 0.07, wet = 0.05 }\n')
    for words, slips in (((), [0.07, 0.05]), (("--slip", "0.1"), [0.1, 0.1])):
        cases = json.loads(railslip("margins", "--controller", file, *words, "--json")[1])["cases"]
        assert [case["slip"] for case in cases] == slips


@pytest.mark.long
def test_what_tune_writes_is_the_same_controller_in_every_command(railslip, tmp_path):
    """Judged, run and counted alike; it starts and hands over as the report's design does."""
    file = tmp_path / "best.toml"
    case = ("--adhesion", "curve", "--speed", "60", "--speed", "100", "--slip", "0.1")
    words = ("--structure", "pi-lead", "--ms-max", "2", "--envelope", "default", "--out", file, "--json")
    tuned = json.loads(railslip("tune", *case, *words)[1])
    judged = json.loads(railslip("margins", *case, "--envelope", "default", "--controller", file, "--json")[1])
    assert judged["worst"] == tuned["worst"]
    envelope = rs.Envelope(laws="curve", speeds=(60, 100), reference={"dry": 0.1, "wet": 0.1})
    best = rs.tune(envelope, structure="pi-lead", ms_max=2.0)
    assert (tuned["kp_si"], tuned["ki_si"], len(tuned["cases"])) == (best.gains.kp, best.gains.ki, 8)
    as_reported = as_run(rs.PIController(best.gains, best.lead, best.lead_filter), best.judgement, 60.0, "best")
    assert as_reported.toml == file.read_text("utf-8")
    loads = (rs.PARK2008, rs.PARK2008.loaded())
    cases = itertools.product(("dry", "wet"), (60, 100), loads)
    points = (rs.operating_point(rs.published_law("curve", r), car, v / 3.6, 0.1, rail=r) for r, v, car in cases)
    takes = [point.brake_torque for point in points]
    assert as_reported.initial_torque == as_reported.cut_out_torque == pytest.approx(0.8 * min(takes), rel=1e-12)
    wet = rs.stop(rail="wet")
    stop = ("--scenario", "stop", "--rail", "wet", "--seed", "3", "--controller", file, "--json")
    expected = rs.simulate(wet, best, seed=3, record_every=None)
    assert json.loads(railslip("simulate", *stop)[1])["braking_distance_m"] == expected.braking_distance
    many = rs.campaign(wet, [best, rs.load_controller(file)], runs=3).controllers
    tuned_runs, file_runs = (many[name].measures["braking_distance_m"].moments for name in ("pi-lead", "best"))
    assert tuned_runs == file_runs
