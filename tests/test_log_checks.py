"""What a log or its options show to be wrong: told in a line where it is read, in the report, the file and JSON."""

from __future__ import annotations

import dataclasses
import json
import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from project import refused
from rig_logs import changed, identified, rig_rows, write_log

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification import identify as job
from railslip_ctrl.identification.cleaning import OutlierFilter, Resolution, step_of
from railslip_ctrl.identification.curves import Options, curve_of
from railslip_ctrl.identification.identify import Identification, Lag
from railslip_ctrl.identification.log_checks import FreeRolling, mu_findings
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.models import check_options
from railslip_ctrl.identification.observed import Readhesion
from railslip_ctrl.identification.observer import Encoder, FilterObserver
from railslip_ctrl.identification.virtual_rig import RigTest, run_tests
from railslip_ctrl.model.adhesion import law_class, load_law, published_law
from railslip_ctrl.model.numeric import adhesion_coefficient
from railslip_ctrl.model.vehicle import PARK2008, Rail
from railslip_ctrl.report.identification import identification_json, identification_text, model_toml

BEAM = published_law("beam", Rail.DRY)
BURCKHARDT = law_class("burckhardt").model_validate({"c1": 0.31, "c2": 24.0, "c3": 0.11})
RADIUS, LOAD = PARK2008.wheel.radius, PARK2008.wheel_load

without_lag_search = pytest.mark.usefixtures("no_lag_search")


@pytest.fixture
def no_lag_search(monkeypatch):
    """It takes most of the time, and has tests of its own."""
    monkeypatch.setattr(job, "lag_of", lambda *_: None)


def rig(name: str = "burckhardt", speed_kmh: float = 100.0, *, tests: int = 2, seed: int = 0, **measured) -> Rows:
    law = BURCKHARDT if name == "burckhardt" else published_law(name, Rail.DRY, speed_kmh, LOAD)
    return run_tests(RigTest(PARK2008, law, speed_kmh * KMH, **measured), tests=tests, seed=seed)


def told(rows: Rows, **options) -> list[str]:
    """What is said of a log, but for its pauses between tests."""
    warnings = curve_of(rows, PARK2008, Options(**options)).warnings
    return [text for text in warnings if "gap of 30" not in text]


@pytest.fixture(scope="module")
def three() -> Rows:
    """Three tests on the virtual rig."""
    return rig(tests=3)


@pytest.fixture(scope="module")
def rows() -> Rows:
    """Two runs on a rig with the published beam."""
    return rig_rows(BEAM, runs=2, seed=3)[0]


@pytest.fixture(scope="module")
def found(rows) -> Identification:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(job, "lag_of", lambda *_: None)
        return identified(rows, "table")


# --- values in steps -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("counts", [100, 512, 4096])
def test_the_step_of_an_encoder_is_found(counts):
    omega = rig("beam", encoder=Encoder(counts), tests=1).columns["wheel_angular_speed"]
    assert step_of(omega) == pytest.approx(
        Encoder(counts).speed_step(0.01), rel=1e-6
    )  # of time stamps that are rounded
    glitched = omega.copy()
    glitched[::97] += 0.3 * step_of(omega)  # four in a hundred of the differences are no steps then
    assert step_of(glitched) == pytest.approx(step_of(omega), rel=0.05)


def test_what_does_not_come_in_steps_has_none():
    generator, time = np.random.default_rng(0), 0.01 * np.arange(4096)
    for values in (generator.standard_normal(4096), 4000.0 * np.maximum(time - 1.0, 0.0), np.sin(time), np.zeros(4096)):
        assert step_of(values) == 0.0
    assert step_of(np.round(50.0 + generator.standard_normal(4096), 1)) == pytest.approx(0.1)
    resolution = Resolution()
    for values in (np.round(10.0 * np.sin(time)), 3.0 * np.round(10.0 * np.sin(time)), np.zeros(9)):
        resolution.add("train_speed", values)
    assert resolution["train_speed"] == pytest.approx(1.0)
    assert resolution["brake_torque"] == 0.0


@pytest.mark.parametrize(("speed", "counts", "interval"), [(30.0, 512, 0.01), (100.0, 100, 0.01), (100.0, 8192, 0.002)])
def test_the_rarer_counts_of_an_encoder_are_no_outliers(speed, counts, interval):
    """Hundreds of rows were left out, and the others gave a wheel radius 1.4 to 2.5 % off."""
    rows = rig(speed_kmh=speed, encoder=Encoder(counts), interval=interval)
    step = Encoder(counts).speed_step(interval)
    spiked = rows.columns["wheel_angular_speed"].copy()
    spiked[20] += 8.0 * step
    for omega, count in ((rows.columns["wheel_angular_speed"], 0), (spiked, 1)):
        outliers = OutlierFilter()
        list(outliers.rows(iter([changed(rows, wheel_angular_speed=omega)])))
        assert outliers.count == count
    (text,) = told(rows)
    share = 100.0 * RADIUS * step / (speed * KMH)
    assert f"'wheel_angular_speed [rad/s]' in steps of {step:.4g}, {share:.2g} % of slip at the initial speed" in text


# --- rolling without brake -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("zero", [100.0, 1000.0, -2000.0])
def test_a_torque_s_zero_is_told_whatever_it_is(three, zero):
    (text,) = (t for t in told(changed(three, brake_torque=three.columns["brake_torque"] + zero)) if "--zero" in t)
    assert f"the brake torque reads {zero:.4g} N*m where the wheel rolls freely" in text
    assert f"--zero brake_torque={zero:.4g} takes it off" in text


def test_a_zero_that_is_not_the_log_s_is_told(three):
    (text,) = told(three, zeros={"brake_torque": 500.0})
    assert "leave --zero brake_torque out" in text
    off = changed(three, brake_torque=three.columns["brake_torque"] + 800.0)
    (text,) = told(off, zeros={"brake_torque": 500.0})
    assert "reads 300 N*m beside the 500 N*m that is taken off" in text
    assert "--zero brake_torque=800 takes it off" in text
    for name, value in (("wheel_angular_speed", 0.5), ("train_speed", -0.3)):
        (text,) = (t for t in told(three, zeros={name: value}) if "free rolling" in t)
        assert f"without the --zero {name}={value:.4g} that is given" in text
        assert "leave it out" in text


@pytest.mark.parametrize("factor", [0.9, 1.003])
def test_a_wrong_radius_is_told_as_one(three, factor):
    wrong = changed(three, wheel_angular_speed=factor * three.columns["wheel_angular_speed"])
    (text,) = (t for t in told(wrong) if "free rolling" in t)
    radius = float(text.split("the wheel radius may be ")[1].split(" m")[0])
    # four digits are told; the slip without brake is known to 3 of 10 000 here, and some 1e-4 more from friction
    assert radius == pytest.approx(RADIUS / factor, rel=6e-4)


@pytest.mark.parametrize("factor", [0.5, 2.0, 3.6])
def test_a_wrong_unit_is_told_as_one(three, factor):
    wrong = changed(three, wheel_angular_speed=factor * three.columns["wheel_angular_speed"])
    try:
        text = " ".join(told(wrong))
    except InputError as error:
        text = str(error)
    assert f"the wheel's speed is {factor:.3g} times the train's: check the units of wheel_angular_speed" in text


@pytest.mark.parametrize("speed", [30.0, 100.0])
@pytest.mark.parametrize("name", ["beam", "bristle", "burckhardt", "polach"])
def test_nothing_is_said_of_a_log_without_fault(name, speed):
    assert told(rig(name, speed)) == []


def test_a_wheel_that_recovers_after_each_brake_does_not_hide_a_wrong_radius(rows):
    """Half of the rows without brake are of a wheel coming back from half slip, as on a rig that records a second."""
    time = rows.columns["time"]
    released = np.concatenate([[False], np.diff(rows.columns["brake_torque"]) < -1000.0])
    since = time - np.maximum.accumulate(np.where(released, time, -np.inf))
    kept = ~((since > 1.0) & (since < 4.0))
    shown = rows.where(kept)
    shown.columns["wheel_angular_speed"] = 1.012 * shown.columns["wheel_angular_speed"]
    warnings = curve_of(shown, PARK2008, Options()).warnings
    assert any("the wheel radius may be 0.42" in text for text in warnings)


def rolling_rows(slip: np.ndarray, torque: np.ndarray | float = 0.0) -> np.ndarray:
    """Rows as `FreeRolling` takes them, at 100 km/h, a hundred a second."""
    count = len(slip)
    speed = np.full(count, 100.0 * KMH)
    omega = (1.0 - slip) * speed / PARK2008.wheel.radius
    load = np.full(count, PARK2008.wheel_load)
    return np.stack([0.01 * np.arange(count), speed, omega, np.broadcast_to(torque, count), load])


def test_a_wheel_recovering_is_not_rolling_freely():
    rolling, recovering = FreeRolling(PARK2008), FreeRolling(PARK2008)
    rolling.add(rolling_rows(np.random.default_rng(0).normal(-0.013, 0.002, 5000)))
    recovering.add(rolling_rows(np.linspace(0.5, 0.0, 200)))
    found = rolling.found()
    assert found.slip == pytest.approx(-0.013, abs=5 * found.slip_error)
    # of a median of means: 1.25 sigma over root n, and windows that lie half over each other
    assert found.slip_error == pytest.approx(1.25 * 0.002 / np.sqrt(5000), rel=0.3)
    assert found.torque == 0.0
    assert recovering.found() is None
    assert FreeRolling(PARK2008).found() is None


@pytest.mark.parametrize("sizes", [[700, 300], [1, 13, 400, 586]])
def test_free_rolling_does_not_depend_on_the_blocks(sizes):
    rows = rolling_rows(np.random.default_rng(1).normal(0.0, 0.001, 1000), 120.0)
    whole, parts = FreeRolling(PARK2008), FreeRolling(PARK2008)
    whole.add(rows)
    for part in np.split(rows, np.cumsum(sizes)[:-1], axis=1):
        parts.add(part)
    assert parts.found() == whole.found()


def test_a_constant_torque_that_slows_the_train_is_braking():
    """3000 N*m on the rig's flywheels: 2 m/s^2. The same reading on a train that only coasts is a torque's zero."""
    braking, coasting = (rolling_rows(np.full(300, 0.01), 3000.0) for _ in range(2))
    time = braking[0]
    for rows, deceleration in ((braking, 3000.0 / (PARK2008.wheel.radius * PARK2008.mass)), (coasting, 0.14)):
        ratio = 1.0 - deceleration * time / rows[1]
        rows[1], rows[2] = ratio * rows[1], ratio * rows[2]
    found = []
    for rows in (braking, coasting):
        rolling = FreeRolling(PARK2008)
        rolling.add(rows)
        found.append(rolling.found())
    assert found[0] is None
    assert found[1].torque == pytest.approx(3000.0)


# --- lateness ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("late", [0.1, pytest.param(-0.02, marks=pytest.mark.long)])
def test_a_lag_is_found_however_large(late):
    rows = rig()
    time, omega = rows.columns["time"], rows.columns["wheel_angular_speed"]
    delayed = changed(rows, wheel_angular_speed=np.interp(time - late, time, omega))
    found = identified(delayed, "burckhardt")
    (text,) = (text for text in found.warnings if "seems to be" in text)
    value, error = (float(x.split(" ")[0]) for x in text.split(" by ")[1].split(" ± "))
    assert value == pytest.approx(abs(late), abs=3.0 * error)
    assert error < 0.003  # a third of the interval: one that is no use would pass as well
    assert float(text.split("--delay wheel_angular_speed=")[1].split(" ")[0]) == pytest.approx(late, abs=3.0 * error)


def test_a_shift_that_a_better_model_does_without_is_no_lag(rows, monkeypatch):
    """A model that is not the log's may follow the motion better with a column shifted: that is no delay to undo."""
    monkeypatch.setattr("railslip_ctrl.identification.identify.OF_EACH_KIND", ("burckhardt", "beam"))
    monkeypatch.setattr(job, "lag_of", lambda fit, *_: Lag(-0.08, 0.01) if fit.model.name == "burckhardt" else None)
    (told,) = identified(rows, model="burckhardt").warnings
    assert "burckhardt follows the wheel's motion best with its speed shifted by -0.08 s, which beam, a better" in told
    monkeypatch.setattr(job, "lag_of", lambda *_: Lag(-0.08, 0.01))
    (told,) = identified(rows, model="burckhardt").warnings
    assert "seems to be early by 0.08 s" in told


# --- readhesion ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cut", [500, 153, 156])
def test_a_wheel_regrips_while_its_slip_falls_under_a_torque_let_go(cut):
    time = 0.01 * np.arange(500)
    torque = np.where(time < 1.5, 4000.0, 4000.0 * np.exp(-(time - 1.5) / 0.05))
    slip = np.where(time < 1.55, 0.3 * time / 1.55, 0.3 * np.exp(-(time - 1.55) / 0.1))
    readhesion = Readhesion(FilterObserver.of(PARK2008, 0.05))
    parts = [
        readhesion.add(*(x[at] for x in (time, slip, torque))) for at in (slice(cut), slice(cut, None)) if cut < 500
    ]
    found = np.concatenate(parts) if parts else readhesion.add(time, slip, torque)
    assert not found[:155].any()  # the slip still grows
    assert found[165:220].all()  # two time constants later it is seen to fall
    low_pass = FilterObserver.of(PARK2008, 0.05)
    held = Readhesion(low_pass).add(time, 0.1 + 0.02 * np.sin(time), 4000.0 + 300.0 * np.sin(time))
    assert not held.any()  # torque and slip go up and down by a brake that is moved, not let go


# --- loads, adhesion, speeds, time ---------------------------------------------------------------------------------


def test_wheel_loads_that_differ_are_told(three):
    second = three.columns["time"] > three.columns["time"][len(three) // 2]
    factor = np.where(second, 1.2, 1.0)
    loads = {"wheel_load": factor * three.columns["wheel_load"], "brake_torque": factor * three.columns["brake_torque"]}
    (text,) = (t for t in told(changed(three, **loads)) if "wheel load" in t)
    assert "lies between 3.45e+04 and 4.14e+04 N from run to run" in text
    logs = [
        SimpleNamespace(curve=SimpleNamespace(name=name), setting=SimpleNamespace(wheel_load=load))
        for name, load in (("a.csv", 3.0e4), ("b.csv", 3.1e4), ("c.csv", 4.0e4))
    ]
    (text,) = job._different_loads(logs)
    assert "between 3e+04 N (a.csv) and 4e+04 N (c.csv)" in text
    assert "their mean, 3.367e+04 N" in text
    assert job._different_loads(logs[:2]) == ()


def test_adhesion_that_steel_does_not_have_is_told(rows):
    """A torque in kgf*m read as one in daN*m or so: ten times the adhesion."""
    scaled = changed(rows, brake_torque=9.80665 * rows.columns["brake_torque"])
    warnings = curve_of(scaled, PARK2008, Options()).warnings
    (text,) = (text for text in warnings if "the highest mean adhesion coefficient is " in text)
    assert 2.0 < float(text.split("coefficient is ")[1].split(",")[0]) < 10.0
    assert not any("adhesion coefficient is" in text for text in curve_of(rows, PARK2008, Options()).warnings)
    assert not list(mu_findings(np.array([0.2, 0.3]), {}))
    assert "is 0.004," in next(mu_findings(np.array([0.004]), {})).text


def test_one_log_of_several_speeds_says_which_v0_it_is_taken_at():
    fast, slow = (rig_rows(BEAM, runs=1, seed=k, initial_speed=v * KMH)[0] for k, v in ((0, 100.0), (1, 50.0)))
    slow.columns["time"] = slow.columns["time"] + 30.0
    warnings = curve_of(fast.then(slow), PARK2008, Options()).warnings
    (text,) = (text for text in warnings if "braking begins between" in text)
    begin, end = (float(x) for x in text.split("between ")[1].split(" km/h")[0].split(" and "))
    assert 45.0 < begin < 51.0  # the train has lost a little when the slip comes to 0.005
    assert 95.0 < end < 101.0
    assert "is taken as 100 km/h" in text
    assert not any("braking begins" in text for text in curve_of(fast, PARK2008, Options()).warnings)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e-3, "s")])
def test_a_wrong_unit_of_time_is_refused_by_its_name(rows, factor, unit):
    with pytest.raises(InputError, match=rf"the time seems to be in {unit}, .* give --unit time={unit}$"):
        curve_of(changed(rows, time=factor * rows.columns["time"]), PARK2008, Options())


def test_speeds_of_two_units_are_refused_by_their_ratio(rows):
    with pytest.raises(InputError, match=r"times the train's: .* \(km/h and m/s are 3.6 apart\), .*swapped") as error:
        curve_of(changed(rows, train_speed=3.6 * rows.columns["train_speed"]), PARK2008, Options())
    assert "radius may be" not in str(error.value)
    assert "--bound" not in str(error.value)


@pytest.mark.parametrize("signs", [{"train_speed": -1.0}, {"train_speed": -1.0, "wheel_angular_speed": -1.0}])
def test_a_train_that_runs_backward_is_named(rows, signs):
    with pytest.raises(InputError, match="train speed is negative in 1800 rows, and positive in 0; reverse its sign"):
        curve_of(changed(rows, **{n: rows.columns[n] * sign for n, sign in signs.items()}), PARK2008, Options())


def test_options_that_leave_no_row_are_named(rows):
    with pytest.raises(InputError, match=r"the rows are corrected by --delay brake_torque=0.1, --zero train_speed=30"):
        curve_of(rows, PARK2008, Options(delays={"brake_torque": 0.1}, zeros={"train_speed": 30.0}))
    with pytest.raises(InputError, match="after the start the observer settles for 250 s; give a smaller --tau"):
        curve_of(rows, PARK2008, Options(time_constant=50.0))


def test_numbers_beyond_all_measurement_are_refused_in_one_line(rows, recwarn):
    torque = rows.columns["brake_torque"].copy()
    torque[::10] = 1e300
    with pytest.raises(InputError, match=r"brake torque 1e\+300 N\*m is beyond any wheel") as caught:
        curve_of(changed(rows, brake_torque=torque), PARK2008, Options())
    assert "--zero" not in str(caught.value)
    assert not list(recwarn)


# --- where it is told ----------------------------------------------------------------------------------------------


@without_lag_search
def test_warnings_and_notes_are_in_the_report_the_file_and_json(rows):
    odd = changed(rows, wheel_speed=1.16 * RADIUS * rows.columns["wheel_angular_speed"])
    found = identified(changed(odd, wheel_load=np.full(len(rows), 3.2 * LOAD)), "table", initial_speed=60.0)
    told = (
        f"wheel load of the log is {3.2 * LOAD:.4g} N on average, that of the vehicle {LOAD:.4g} N",
        "wheel speed is 1.16 times the angular speed",
        "--initial-speed is 216 km/h, and the highest train speed of the log 100 km/h",
    )
    text, file = " ".join(identification_text(found).split()), model_toml(found)
    for sentence in told:
        assert sum(sentence in each for each in found.warnings) == 1
        assert sentence in text
        assert any(line.startswith("# Warning: ") and sentence in line for line in file.splitlines())
        assert any(sentence in each for each in identification_json(found)["log"]["warnings"])
    assert f"(the log's; the vehicle's is {LOAD:g} N)" in text


def test_a_given_ramp_far_from_the_logs_is_told(found):
    own = found.setting.slip_acceleration
    for factor in (0.25, 1.0, 4.0):
        told = job._against_the_log(found.curve, found.setting, Options(slip_acceleration=factor * own))
        assert any("--slip-acceleration is" in text for text in told) == (factor != 1.0)


def test_which_rows_of_a_large_log_are_followed_is_told(found):
    large = dataclasses.replace(found, curve=dataclasses.replace(found.curve, record_stride=4))
    sentence = "take 20000 rows at most, in whole runs spread evenly over the log, here one run of 4"
    assert sentence in " ".join(identification_text(large).split())
    assert sentence in identification_json(large)["log"]["rows_followed_note"]
    assert identification_json(found)["log"]["rows_followed_note"] is None


# --- models and options --------------------------------------------------------------------------------------------


def test_a_fixed_value_outside_its_bounds_is_refused():
    check_options(("beam",), {"mu_max": 0.2}, {"mu_max": (0.1, 0.3)})
    with pytest.raises(InputError, match=r"--fix mu_max: 0.5 is outside --bound mu_max, 0.1 to 0.3"):
        check_options(("beam",), {"mu_max": 0.5}, {"mu_max": (0.1, 0.3)})


@without_lag_search
def test_a_value_that_was_fixed_is_named_as_the_cause(railslip, rows, tmp_path):
    log = write_log(tmp_path / "log.csv", rows)
    message = refused(railslip("identify", log, "--model", "beam", "--fix", "mu_max=1e9"))
    assert "--fix mu_max=1e+09 is given" in message


@without_lag_search
def test_a_law_of_a_wet_log_has_no_slip_for_dry_rail(rows, tmp_path):
    found = identified(rows, model="burckhardt", rail=Rail.WET)
    (tmp_path / "model.toml").write_text(model_toml(found))
    content = tomllib.loads(model_toml(found))
    assert content["reference_slip"] == {"wet": found.reference.wet}
    assert load_law(tmp_path / "model.toml").reference_slip(Rail.WET) == found.reference.wet


@without_lag_search
def test_a_model_without_a_peak_does_not_end_the_run(rows, found, monkeypatch):
    table, beam = found, identified(rows, "beam")
    candidates, drift = job.Candidates(found.curve, PARK2008, found.setting), job.drift

    def fails(fit, *args, **options):
        if fit.model.name == "beam":
            raise DomainError("stay below slip 0")
        return drift(fit, *args, **options)

    monkeypatch.setattr(job, "drift", fails)
    scores, chosen, _, without = job._chosen((beam.chosen, table.chosen), candidates)
    assert (chosen, scores) == (table.chosen, (table.chosen,))
    assert without == ("log: beam: stay below slip 0",)
    with pytest.raises(InputError, match="stay below slip 0"):
        job._chosen((beam.chosen,), candidates)
    assert json.dumps(identification_json(table))


def test_a_copy_of_a_log_is_no_other_test(railslip, rows, tmp_path):
    first, copy = write_log(tmp_path / "a.csv", rows), write_log(tmp_path / "b.csv", rows)
    assert "b.csv is a copy of " in refused(railslip("identify", first, copy, "--model", "beam"))


def test_the_observed_rows_do_not_go_where_the_model_goes(railslip, rows, tmp_path):
    log, out = write_log(tmp_path / "a.csv", rows), tmp_path / "fitted"
    for file in (out, out / "model.toml"):
        line = refused(railslip("identify", log, "--model", "beam", "--out", out, "--observed", file))
        assert line.startswith("railslip: error: --observed: ")
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


@without_lag_search
def test_a_log_that_stays_below_the_peak_has_no_slip_to_hold(railslip, rows, tmp_path):
    """The peak of a formula beyond all data is the formula's alone: up to 1.7 times the true one, and once slip 1."""
    speed, omega = rows.columns["train_speed"], rows.columns["wheel_angular_speed"]
    below = (1.0 - PARK2008.wheel.radius * omega / speed < 0.03).reshape(2, -1)
    kept = np.logical_and.accumulate(below, axis=1).ravel()
    path = write_log(tmp_path / "below.csv", rows.where(kept))
    status, out, _ = railslip("identify", path, "--model", "beam", "--out", tmp_path / "fitted")
    assert status == 0
    told = re.search(r"mu_max: by this log it is not less than (0\.\d+) \(99 %\), and has no upper end", out)
    assert 0.5 * BEAM.mu_max < float(told[1]) < BEAM.mu_max  # the rise alone leaves it free upwards
    assert "Reference: none; the slip of this log goes up to 0.0" in out
    assert "and the model's peak lies beyond; give a log that goes past the peak" in " ".join(out.split())
    assert "[reference_slip]" not in (tmp_path / "fitted" / "model.toml").read_text()
    found = json.loads((tmp_path / "fitted" / "identification.json").read_text())
    assert found["reference_slip"] is None
    assert all(peak["reference_slip"] is None for peak in found["peaks"] if peak["rail"] == "dry")
    assert all(peak["slip"] is not None for peak in found["peaks"])  # where the formula has it is told
    assert found["log"]["sliding_from"] == "the highest mean mu of the log"
    assert found["log"]["sliding_from_slip"] == found["log"]["data_peak_slip"]


def test_the_peak_of_a_table_is_known_to_its_knots_at_best(found):
    """Its peak rests on a knot whatever the values are: the derivative by them is nought, the uncertainty is not."""
    knots = np.array(found.chosen.fit.model.known["slip"])
    peak = found.own_peak
    top = int(np.argmin(np.abs(knots - peak.slip)))
    assert peak.slip == pytest.approx(knots[top], abs=1e-6)
    reach = 2.576 * peak.slip_stderr
    assert reach >= 0.99 * max(knots[top] - knots[top - 1], knots[top + 1] - knots[top])
    # the truth, in the closed form of the published beam, is inside
    slips = np.linspace(0.01, 0.6, 6000)
    mu = [float(adhesion_coefficient(BEAM, 100.0 * KMH, slip, PARK2008.wheel_load)) for slip in slips]
    assert abs(slips[int(np.argmax(mu))] - peak.slip) < reach
