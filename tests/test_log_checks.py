"""What a log shows to be wrong, told in a line; columns that are late or off zero, found and corrected."""

import ast
import dataclasses
import itertools
import re
from string import Formatter

import numpy as np
import pytest
from project import ROOT, refused
from rig_logs import BEAM, changed, identified, rig_rows, two_runs

from railslip_ctrl import PARK2008, InputError, Rail
from railslip_ctrl.core.templates import texts
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification import identify as job
from railslip_ctrl.identification.cleaning import Alignment, OutlierFilter, Resolution, step_of
from railslip_ctrl.identification.curves import Options, curve_of
from railslip_ctrl.identification.identify import Lag
from railslip_ctrl.identification.log_checks import FreeRolling, mu_findings
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.observed import Readhesion
from railslip_ctrl.identification.observer import Encoder, FilterObserver
from railslip_ctrl.identification.virtual_rig import RigTest, published_tests, run_tests
from railslip_ctrl.model.adhesion import law_class, published_law

BURCKHARDT = law_class("burckhardt").model_validate({"c1": 0.31, "c2": 24.0, "c3": 0.11})
RADIUS, LOAD = PARK2008.wheel.radius, PARK2008.wheel_load


def rig(name: str = "burckhardt", speed_kmh: float = 100.0, *, tests: int = 2, seed: int = 0, **measured) -> Rows:
    law = BURCKHARDT if name == "burckhardt" else published_law(name, Rail.DRY, speed_kmh, LOAD)
    return run_tests(RigTest(PARK2008, law, speed_kmh * KMH, **measured), tests=tests, seed=seed)


def told(rows: Rows, about: str = "", **options) -> list[str]:
    """What is said of a log, or of a thing in it, but for its pauses between tests."""
    warnings = curve_of(rows, PARK2008, Options(**options)).warnings
    return [text for text in warnings if "gap of 30" not in text and about in text]


def scaled(rows: Rows, **factors: float) -> Rows:
    return changed(rows, **{name: factor * rows.columns[name] for name, factor in factors.items()})


@pytest.fixture(scope="module")
def three() -> Rows:
    """Three tests on the virtual rig."""
    return rig(tests=3)


@pytest.fixture
def rows() -> Rows:
    return two_runs()


def test_the_step_of_values_is_found_where_there_is_one():
    noise, time = np.random.default_rng(0).standard_normal(4096), 0.01 * np.arange(4096)
    for values in (noise, 4000.0 * np.maximum(time - 1.0, 0.0), np.sin(time), np.zeros(4096)):
        assert step_of(values) == 0.0
    assert step_of(np.round(50.0 + noise, 1)) == pytest.approx(0.1)
    coarse, resolution = np.round(10.0 * np.sin(time)), Resolution()
    for values in (coarse, 3.0 * coarse, np.zeros(9)):
        resolution.add("train_speed", values)
    assert (resolution["train_speed"], resolution["brake_torque"]) == (pytest.approx(1.0), 0.0)


@pytest.mark.parametrize(("speed", "counts", "interval"), [(30.0, 512, 0.01), (100.0, 100, 0.01), (100.0, 8192, 0.002)])
def test_the_rarer_counts_of_an_encoder_are_its_step_and_no_outliers(speed, counts, interval):
    """Hundreds of rows were left out, and the others gave a wheel radius 1.4 to 2.5 % off."""
    rows = rig(speed_kmh=speed, encoder=Encoder(counts), interval=interval)
    omega, step = rows.columns["wheel_angular_speed"], Encoder(counts).angle_step / interval
    assert step_of(omega) == pytest.approx(step, rel=1e-6)  # of time stamps that are rounded
    glitched, spiked = omega.copy(), omega.copy()
    glitched[::97] += 0.3 * step  # four in a hundred of the differences are no steps then
    assert step_of(glitched) == pytest.approx(step, rel=0.05)
    spiked[20] += 8.0 * step
    for values, count in ((omega, 0), (spiked, 1)):
        outliers = OutlierFilter()
        list(outliers.rows(iter([changed(rows, wheel_angular_speed=values)])))
        assert outliers.count == count
    (text,) = told(rows)
    share = 100.0 * RADIUS * step / (speed * KMH)
    assert f"'wheel_angular_speed [rad/s]' in steps of {step:.4g}, {share:.2g} % of slip at the initial speed" in text


def test_nothing_is_said_of_a_log_without_fault():
    for name, speed in (("beam", 30.0), ("bristle", 100.0), ("burckhardt", 30.0), ("polach", 100.0)):
        assert told(rig(name, speed)) == [], name


@pytest.mark.parametrize(("offset", "zeros", "words"), [
    (-2000.0, {}, "reads -2000 N.m where the wheel rolls freely, .*=-2000 takes it off"),
    (0.0, {"brake_torque": 500.0}, "leave `zeros` brake_torque out"),
    (800.0, {"brake_torque": 500.0}, "reads 300 N.m beside the 500 N.m that is taken off.*=800 takes it off"),
    (0.0, {"wheel_angular_speed": 0.5}, "without the `zeros` wheel_angular_speed=0.5 that is given .*leave it out"),
    (0.0, {"train_speed": -0.3}, "without the `zeros` train_speed=-0.3 that is given .*leave it out"),
])  # fmt: skip
def test_a_zero_that_is_wrong_is_told(three, offset, zeros, words):
    texts = told(changed(three, brake_torque=three.columns["brake_torque"] + offset), zeros=zeros)
    assert sum(re.search(words, text) is not None for text in texts) == 1


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.003, 2.0, 3.6])
def test_a_wrong_radius_or_unit_is_told_as_one(three, factor):
    try:
        text = " ".join(told(scaled(three, wheel_angular_speed=factor)))
    except InputError as error:
        text = str(error)
    if 0.8 < factor < 1.2:
        radius = float(text.split("the wheel radius may be ")[1].split(" m")[0])
        # four digits are told; the slip without brake is known to 3 of 10 000 here, and some 1e-4 more from friction
        assert radius == pytest.approx(RADIUS / factor, rel=6e-4)
    else:
        assert f"the wheel's speed is {factor:.3g} times the train's: check the units of wheel_angular_speed" in text
        assert ("(km/h and m/s are 3.6 apart)" in text) == (factor == 3.6)


def rolled(slip: np.ndarray, torque: float = 0.0, deceleration: float = 0.0):
    """What `FreeRolling` finds in rows from 100 km/h on, a hundred a second."""
    time, rolling = 0.01 * np.arange(len(slip)), FreeRolling(PARK2008)
    speed = 100.0 * KMH - deceleration * time
    rolling.add(np.stack([time, speed, (1.0 - slip) * speed / RADIUS, 0.0 * time + torque, 0.0 * time + LOAD]))
    return rolling.found()


def test_a_wheel_recovering_is_not_rolling_freely_nor_one_braked_so_that_the_train_slows():
    found = rolled(np.random.default_rng(0).normal(-0.013, 0.002, 5000))
    assert (found.slip, found.torque) == (pytest.approx(-0.013, abs=5 * found.slip_error), 0.0)
    # of a median of means: 1.25 sigma over root n, and windows that lie half over each other
    assert found.slip_error == pytest.approx(1.25 * 0.002 / np.sqrt(5000), rel=0.3)
    assert rolled(np.linspace(0.5, 0.0, 200)) is rolled(np.empty(0)) is None
    # 3000 N*m on the rig's flywheels are 2 m/s^2; the same reading on a train that only coasts is a torque's zero
    assert rolled(np.full(300, 0.01), 3000.0, 3000.0 / (RADIUS * PARK2008.mass)) is None
    assert rolled(np.full(300, 0.01), 3000.0, 0.14).torque == pytest.approx(3000.0)


@pytest.mark.parametrize(("late", "log", "known"), [
    (0.1, {}, 0.003),
    # of more rows than a lag is looked for in
    pytest.param(0.05, {"tests": 1, "interval": 1e-3, "rate": 2300.0}, 0.005, marks=pytest.mark.long),
    pytest.param(-0.02, {}, 0.003, marks=pytest.mark.long),
])  # fmt: skip
def test_a_lag_is_found_however_large(late, log, known):
    """And known to a third of the interval, of a single run to half of it: an error of any size would hold it too."""
    rows = rig(**log)
    time, omega = rows.columns["time"], rows.columns["wheel_angular_speed"]
    found = identified(changed(rows, wheel_angular_speed=np.interp(time - late, time, omega)), "burckhardt")
    (text,) = (text for text in found.warnings if "seems to be" in text)
    error = float(text.split(" ± ")[1].split(" ")[0])
    assert error < known
    assert float(text.split("`delays` wheel_angular_speed=")[1].split(" ")[0]) == pytest.approx(late, abs=3.0 * error)


def test_a_shift_that_a_better_model_does_without_is_no_lag(rows, monkeypatch):
    """A model that is not the log's may follow the motion better with a column shifted: that is no delay to undo."""
    monkeypatch.setattr(job, "OF_EACH_KIND", ("burckhardt", "beam"))
    monkeypatch.setattr(job, "lag_of", lambda fit, *_: Lag(-0.08, 0.01) if fit.model.name == "burckhardt" else None)
    (told,) = identified(rows, model="burckhardt").warnings
    assert "burckhardt follows the wheel's motion best with its speed shifted by -0.08 s, which beam, a better" in told
    monkeypatch.setattr(job, "lag_of", lambda *_: Lag(-0.08, 0.01))
    (told,) = identified(rows, model="burckhardt").warnings
    assert "seems to be early by 0.08 s" in told


@pytest.mark.long
def test_an_encoder_s_speed_is_half_an_interval_late_and_corrected():
    """Without a word it would cost a quarter of the falling branch. An encoder of 1024 lines; its speed is a mean."""
    test = dataclasses.replace(published_tests("beam")[2], encoder=Encoder(4096))
    rows, delays = run_tests(test, tests=6, seed=3), ({}, {"wheel_angular_speed": 0.005})  # of 40 seeds, 39 hold it
    late, right = (identified(rows, initial_speed=test.initial_speed, delays=each) for each in delays)
    # the mean over an interval is not quite a delay of half of it: a fifth of it off at most
    words = "late by 0.00[3-7].* half an interval, as a difference of counts is: `delays` wheel_angular_speed=0.005 und"
    assert [re.search(words, text) is not None for text in late.warnings if "seems to be" in text] == [True]
    assert not any("seems to be" in text for text in right.warnings)
    assert abs(late.chosen.fit.parameters[1].value / test.law.a - 1.0) > 0.15
    for p in right.chosen.fit.parameters:
        assert p.interval[0] <= getattr(test.law, p.name) <= p.interval[1]


@pytest.mark.parametrize("cuts", [[], [3, 4, 500, 1990], list(range(5, 2000, 5))])
def test_columns_are_brought_to_the_wheel_s_time_and_zero_however_a_log_is_cut(cuts):
    """Parabolas of time, each late by its delay; the torque reads 35 too much."""
    time, late = np.sort(np.random.default_rng(0).uniform(0.0, 10.0, 2000)), 0.03
    delays = {"wheel_angular_speed": late, "brake_torque": 0.2, "train_speed": -0.05}
    columns = {name: (time - delay) ** 2 for name, delay in delays.items()}
    rows = Rows(np.arange(2000), {"time": time, **columns, "brake_torque": columns["brake_torque"] + 35.0})
    blocks = (rows.part(a, b) for a, b in itertools.pairwise([0, *cuts, 2000]))
    parts = list(Alignment(delays, {"brake_torque": 35.0}, "log").rows(blocks))
    found = {name: np.concatenate([part.columns[name] for part in parts]) for name in rows.columns}
    assert np.concatenate([part.line for part in parts]).tolist() == rows.line.tolist()
    assert (found["wheel_angular_speed"] == columns["wheel_angular_speed"]).all()  # its noise stays as it was
    inside = (time > 0.3) & (time < 9.7)  # beyond, the ends are held
    for name in ("train_speed", "brake_torque"):
        # straight between rows up to 0.05 s apart: off by less than 2 * 0.05^2 / 8
        assert found[name][inside] == pytest.approx((time[inside] - late) ** 2, abs=7e-4)


@pytest.mark.parametrize(("option", "value", "text"), [
    ("--delay", "time=0.1", "--delay: 'time' is no quantity of a log; choose one of train_speed, "),
    ("--delay", "brake_torque=3", "--delay brake_torque: 3 s is not allowed; give at most 2 s"),
    ("--zero", "wheel_load=10", "log.csv: no column wheel_load to correct; it has time, "),
])  # fmt: skip
def test_corrections_that_cannot_be_are_refused(tmp_path, railslip, option, value, text):
    (tmp_path / "log.csv").write_text("time [s],v [m/s],omega [rad/s],torque [N*m]\n0,30,69,0\n")
    assert text in refused(railslip("identify", tmp_path / "log.csv", option, value))


@pytest.mark.parametrize("cut", [500, 153, 156])
def test_a_wheel_regrips_while_its_slip_falls_under_a_torque_let_go(cut):
    time = 0.01 * np.arange(500)
    torque = np.where(time < 1.5, 4000.0, 4000.0 * np.exp(-(time - 1.5) / 0.05))
    slip = np.where(time < 1.55, 0.3 * time / 1.55, 0.3 * np.exp(-(time - 1.55) / 0.1))
    low_pass, cuts = FilterObserver.of(PARK2008, 0.05), sorted({0, cut, 500})
    readhesion, signals = Readhesion(low_pass), (time, slip, torque)
    found = np.concatenate([readhesion.add(*(x[a:b] for x in signals)) for a, b in itertools.pairwise(cuts)])
    assert not found[:155].any()  # the slip still grows
    assert found[165:220].all()  # two time constants later it is seen to fall
    held = Readhesion(low_pass).add(time, 0.1 + 0.02 * np.sin(time), 4000.0 + 300.0 * np.sin(time))
    assert not held.any()  # torque and slip go up and down by a brake that is moved, not let go


@pytest.mark.parametrize("factors", [(0.9, 1.1), pytest.param((0.6, 1.4, 1.0), marks=pytest.mark.long)])
def test_a_law_that_depends_on_the_load_is_taken_at_the_load_of_each_row(factors):
    """Beam: at the mean load of the log its highest mu came out 2 % off, beyond its interval."""
    found = identified(rig_rows(BEAM, loads=factors, seed=4))
    for p in found.chosen.fit.parameters:
        assert p.interval[0] <= getattr(BEAM, p.name) <= p.interval[1]
        assert p.stderr < 0.1 * p.value


def test_wheel_loads_that_differ_are_told(three):
    factor = np.where(three.columns["time"] > three.columns["time"][len(three) // 2], 1.2, 1.0)
    loads = {"wheel_load": factor * three.columns["wheel_load"], "brake_torque": factor * three.columns["brake_torque"]}
    (text,) = told(changed(three, **loads), "wheel load")
    assert "lies between 3.45e+04 and 4.14e+04 N from run to run" in text
    (text,) = job.different_loads([("a.csv", 3.0e4), ("b.csv", 3.1e4), ("c.csv", 4.0e4)])
    assert "between 3e+04 N (a.csv) and 4e+04 N (c.csv)" in text
    assert "their mean, 3.367e+04 N" in text
    assert job.different_loads([("a.csv", 3.0e4), ("b.csv", 3.1e4)]) == ()


def test_adhesion_that_steel_does_not_have_is_told(rows):
    """A torque in kgf*m read as one in daN*m or so: ten times the adhesion."""
    (text,) = told(scaled(rows, brake_torque=9.80665), "the highest mean adhesion coefficient is ")
    assert 2.0 < float(text.split("coefficient is ")[1].split(",")[0]) < 10.0
    assert not told(rows, "adhesion coefficient is")
    assert "is 0.004," in next(mu_findings(np.array([0.004]), {})).text


def test_one_log_of_several_speeds_says_which_v0_it_is_taken_at():
    fast, slow = (rig_rows(BEAM, runs=1, seed=k, initial_speed=v * KMH) for k, v in ((0, 100.0), (1, 50.0)))
    slow.columns["time"] = slow.columns["time"] + 30.0
    (text,) = told(fast.then(slow), "braking begins between")
    # the train has lost a little when the slip comes to 0.005
    assert re.search(r"between (4[5-9]|50)[.\d]* and (9[5-9]|100)[.\d]* km/h: v0.* is taken as 100 km/h", text)
    assert not told(fast, "braking begins")


@pytest.mark.long
def test_what_gaps_cost_is_told():
    """0.06 s of every 0.8 s are missing: of 0.74 s under brake the observer settles for 0.25 s."""
    rows = rig_rows(BEAM, runs=2, interval=0.0025, seed=5)  # irregular sampling has short intervals too
    time = rows.columns["time"]
    survey = curve_of(rows.where(time % 0.8 > 0.06), PARK2008, Options()).survey
    assert survey.lost_share == pytest.approx(0.25 / 0.74, abs=0.05)  # some ten stretches under brake, two of them cut
    assert told(rows.where(time % 0.8 > 0.06), f"{100 * survey.lost_share:.2g} % of the braking data")
    with pytest.raises(InputError, match="rows under brake can be used: after the start and each of "):
        told(rows.where(time % 0.3 > 0.06))


BACKWARD = "train speed is negative in 1800 rows, and positive in 0; reverse its sign"


@pytest.mark.parametrize(("factors", "options", "message"), [
    ({"time": 1e3}, {}, "the time seems to be in ms, .* give `units` time=ms$"),
    ({"time": 1e-3}, {}, "the time seems to be in s, .* give `units` time=s$"),
    ({"train_speed": 3.6}, {}, r"times the train's: .* \(km/h and m/s are 3.6 apart\), and that no .* swapped$"),
    ({"train_speed": -1.0}, {}, BACKWARD),
    ({"train_speed": -1.0, "wheel_angular_speed": -1.0}, {}, BACKWARD),
    ({"brake_torque": -1.0}, {}, "negative in .* rows with slip, and positive in 0; reverse its sign: torque that"),
    ({"brake_torque": 1e300}, {}, r"brake torque 1.*e\+30. N\*m is beyond any wheel \(\d+ such rows\); check"),
    ({}, {"delays": {"brake_torque": 0.1}, "zeros": {"train_speed": 30.0}}, "the rows are corrected by `delays` br"),
    ({}, {"time_constant": 50.0}, "after the start the observer settles for 250 s; give a smaller `time_constant`"),
])  # fmt: skip
def test_what_leaves_no_row_is_refused_with_its_cause(rows, recwarn, factors, options, message):
    with pytest.raises(InputError, match=message):
        told(scaled(rows, **factors), **options)
    assert not list(recwarn)


def test_every_sentence_is_used_and_has_its_numbers():
    sentences = texts("railslip_ctrl.identification", "words.toml")
    sources = [path.read_text("utf-8") for path in (ROOT / "railslip_ctrl" / "identification").glob("*.py")]
    calls = [node for text in sources for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    used = set()
    for call in (call for call in calls if getattr(call.func, "id", "") == "told"):
        given = {keyword.arg for keyword in call.keywords}
        for name in {part.value for part in ast.walk(call.args[0]) if isinstance(part, ast.Constant)}:
            wanted = {re.split(r"[.\[]", field)[0] for _, field, *_ in Formatter().parse(sentences[name]) if field}
            assert None in given or wanted <= given, name  # None: a mapping of numbers
            used.add(name)
    others = [name for name in sentences.keys() - used if not any(f'"{name}"' in text for text in sources)]
    assert not others
