"""What a log or its options have wrong, told where it is read: in the report, the model's file, or the refusal."""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib

import numpy as np
import pytest
from log_texts import log_text, read, write
from project import refused
from rig_logs import rig_rows, write_log

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.identification import fits
from railslip_ctrl.identification import identify as job
from railslip_ctrl.identification.curves import curve_of
from railslip_ctrl.identification.identify import Identification, Options, identify_curve
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.models import check_options
from railslip_ctrl.identification.motion import slip_ramp
from railslip_ctrl.identification.record import Record
from railslip_ctrl.identification.timing import Lag, lag_warning
from railslip_ctrl.model.adhesion import load_law, published_law
from railslip_ctrl.model.vehicle import PARK2008, Rail
from railslip_ctrl.report.identification import identification_text, model_toml
from railslip_ctrl.report.identification_json import identification_json

RADIUS, LOAD = PARK2008.wheel.radius, PARK2008.wheel_load


pytestmark = pytest.mark.usefixtures("without_lag_search")


@pytest.fixture(scope="module")
def rows() -> Rows:
    """Two runs on a rig with the published beam."""
    return rig_rows(published_law("beam", Rail.DRY), runs=2, seed=3)[0]


@pytest.fixture(scope="module")
def found(rows) -> Identification:
    return identified(rows)


def changed(rows: Rows, **columns: np.ndarray) -> Rows:
    return Rows(rows.line, {**rows.columns, **columns})


def identified(rows: Rows, model: str = "table", **options) -> Identification:
    options = Options(model=model, **options)
    return identify_curve(curve_of(rows, PARK2008, options), PARK2008, options)


# --- the ramp of a test that a gap has parted ----------------------------------------------------------------------


def ramps(cut: bool, tests: int = 6) -> Record:
    """Tests whose slip speeds up as 0.1 t^2, 2 s each, 10 s apart; with a gap of 80 ms in all but the last."""
    parts = []
    for k in range(tests):
        t = 0.01 * np.arange(200)
        piece = np.where((t > 1.2) & (t < 1.28), -1, (t >= 1.28).astype(int)) if cut and k < tests - 1 else 0 * t
        kept = piece >= 0
        parts.append((10.0 * k + t[kept], 0.1 * t[kept] ** 2, 2 * k + piece[kept]))
    time, slip, run = (np.concatenate(each) for each in zip(*parts, strict=True))
    speed, even = np.full(len(time), 25.0), np.ones(len(time))
    return Record(time, speed, (1.0 - slip) * speed / RADIUS, even, even, run)


@pytest.mark.parametrize("cut", [False, True])
def test_the_ramp_is_that_of_the_whole_test(cut):
    """Slip 0.1 t^2 reaches 0.3 after 1.73 s: by 0.3/1.74 a second on average, to the row."""
    ramp, spread = slip_ramp(ramps(cut), RADIUS, 0.3, 25.0)
    assert ramp == pytest.approx(25.0 * 0.1 * 1.74, rel=1e-9)
    assert spread == pytest.approx(0.0, abs=1e-9)


# --- where warnings are --------------------------------------------------------------------------------------------


def test_warnings_and_notes_are_in_the_report_the_file_and_json(rows):
    odd = changed(rows, wheel_speed=1.16 * RADIUS * rows.columns["wheel_angular_speed"])
    found = identified(changed(odd, wheel_load=np.full(len(rows), 3.2 * LOAD)), initial_speed=60.0)
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


def test_nothing_is_told_of_a_sound_log(rows):
    both = changed(rows, wheel_speed=RADIUS * rows.columns["wheel_angular_speed"])
    found = identified(changed(both, wheel_load=np.full(len(rows), 1.3 * LOAD)), initial_speed=30.0)
    assert found.warnings == ()


def test_a_given_ramp_far_from_the_logs_is_told(found):
    own = found.setting.slip_acceleration
    for factor in (0.25, 1.0, 4.0):
        told = job._against_the_log(found.curve, found.setting, Options(slip_acceleration=factor * own))
        assert any("--slip-acceleration is" in text for text in told) == (factor != 1.0)


def test_criteria_of_too_few_samples_are_told_in_json(found):
    few = dataclasses.replace(found, scores=(dataclasses.replace(found.chosen, independent=23.0),))
    told = identification_json(few)["models_note"]
    assert told.startswith("AIC and BIC are of 23 independent samples, too few")
    assert told in " ".join(identification_text(few).split())
    many = dataclasses.replace(found, scores=(dataclasses.replace(found.chosen, independent=1e4),))
    assert identification_json(many)["models_note"] is None


def test_which_rows_of_a_large_log_are_followed_is_told(found):
    large = dataclasses.replace(found, curve=dataclasses.replace(found.curve, record_stride=4))
    sentence = "take 20000 rows at most, in whole runs spread evenly over the log, here one run of 4"
    assert sentence in " ".join(identification_text(large).split())
    assert sentence in identification_json(large)["log"]["rows_followed_note"]
    assert identification_json(found)["log"]["rows_followed_note"] is None


# --- cells, lines, stamps ------------------------------------------------------------------------------------------

LOADED = "time [s],train speed [km/h],wheel speed [km/h],brake torque [kN*m],wheel load [kN]"


@pytest.mark.parametrize("block_bytes", [4000, 4 << 20])
def test_an_empty_column_that_is_not_needed_is_none(tmp_path, block_bytes):
    plain = log_text(1500).splitlines()[1:]
    path = write(tmp_path, "\n".join([LOADED, *(line + "," for line in plain)]) + "\n")
    rows, log = read(path, block_bytes=block_bytes)
    assert len(rows) == 1500
    assert "wheel_load" not in rows.columns
    assert log.broken.count == 0
    assert "column 'wheel load [kN]' is empty in 1000 rows" in log.notes[0]
    filled = write(tmp_path, "\n".join([LOADED, *(line + (",34" if i > 900 else ",") for i, line in enumerate(plain))]))
    rows, log = read(filled, block_bytes=block_bytes)
    assert "wheel_load" in rows.columns
    assert log.broken.count == 901


def test_a_column_that_is_needed_may_not_be_empty(tmp_path):
    path = write(tmp_path, log_text(30).replace(",1.5", ","))
    with pytest.raises(InputError, match="line 2: a value is missing"):
        read(path)


def test_a_date_for_a_time_is_told(tmp_path):
    path = write(tmp_path, log_text(30).replace("\n0.", "\n2026-01-01T00:00:0."))
    with pytest.raises(InputError, match=r"is a date or a time of day, not a number.*give the time in s"):
        read(path)


@pytest.mark.parametrize(("cut", "kept"), [(1, True), (4, True), (5, False), (9, False)])
def test_a_last_line_without_its_end_counts_if_it_has_all_cells(tmp_path, cut, kept):
    text = log_text(30).replace(",1.5\n", ",1.50\n")  # the end, 1.50 and its separator: five characters
    rows, log = read(write(tmp_path, text[:-cut]))
    assert len(rows) == 29 + kept
    assert log.broken.count == (not kept)
    assert any("ends without a line end: line 31" in note for note in log.notes) == kept


# --- units ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e-3, "s")])
def test_a_wrong_unit_of_time_is_refused_by_its_name(rows, factor, unit):
    with pytest.raises(InputError, match=rf"the time seems to be in {unit}, .* give --unit time={unit}$"):
        curve_of(changed(rows, time=factor * rows.columns["time"]), PARK2008, Options())


def test_no_delay_is_advised_that_is_refused():
    assert "--delay" not in (told := lag_warning(Lag(3.2, 0.1), 10.0, "wheel_angular_speed", {}))
    assert "check the unit of the time" in told
    assert "--delay wheel_angular_speed=0.02 undoes it" in lag_warning(Lag(0.02, 1e-4), 0.01, "wheel_angular_speed", {})


def test_speeds_of_two_units_are_refused_by_their_ratio(rows):
    with pytest.raises(InputError, match=r"times the train's: .* \(km/h and m/s are 3.6 apart\), .*swapped") as error:
        curve_of(changed(rows, train_speed=3.6 * rows.columns["train_speed"]), PARK2008, Options())
    assert "radius may be" not in str(error.value)
    assert "--bound" not in str(error.value)


# --- options -------------------------------------------------------------------------------------------------------


def test_a_fixed_value_outside_its_bounds_is_refused():
    check_options(("beam",), {"mu_max": 0.2}, {"mu_max": (0.1, 0.3)})
    with pytest.raises(InputError, match=r"--fix mu_max: 0.5 is outside --bound mu_max, 0.1 to 0.3"):
        check_options(("beam",), {"mu_max": 0.5}, {"mu_max": (0.1, 0.3)})


def test_a_value_that_was_fixed_is_named_as_the_cause(railslip, rows, tmp_path):
    log = write_log(tmp_path / "log.csv", rows)
    message = refused(railslip("identify", log, "--model", "beam", "--fix", "mu_max=1e9"))
    assert "--fix mu_max=1e+09 is given" in message


# --- one model's domain --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("signs", [{"train_speed": -1.0}, {"train_speed": -1.0, "wheel_angular_speed": -1.0}])
def test_a_train_that_runs_backward_is_named(rows, signs):
    with pytest.raises(InputError, match="train speed is negative in 1800 rows, and positive in 0; reverse its sign"):
        curve_of(changed(rows, **{n: rows.columns[n] * sign for n, sign in signs.items()}), PARK2008, Options())


def test_options_that_leave_no_row_are_named(rows):
    with pytest.raises(InputError, match=r"the rows are corrected by --delay brake_torque=0.1, --zero train_speed=30"):
        curve_of(rows, PARK2008, Options(delays={"brake_torque": 0.1}, zeros={"train_speed": 30.0}))
    with pytest.raises(InputError, match="after the start the observer settles for 250 s; give a smaller --tau"):
        curve_of(rows, PARK2008, Options(time_constant=50.0))


def test_columns_of_one_name_are_told_apart_by_their_place(tmp_path):
    lines = [f"{0.01 * k:.2f},10,20,21,0" for k in range(50)]
    path = write(tmp_path, "\n".join(["time,train speed,omega,omega,brake torque", *lines, ""]))
    with pytest.raises(InputError, match="say which with --column wheel_angular_speed=HEADER, or by its place: 3 or 4"):
        read(path)
    with pytest.raises(InputError, match=r"2 columns are called 'omega'; .*, or by its place: 3 or 4"):
        read(path, columns={"wheel_angular_speed": "omega"})
    for place, value in (("3", 20.0), ("4", 21.0)):
        rows, _ = read(path, columns={"wheel_angular_speed": place})
        assert set(rows.columns["wheel_angular_speed"]) == {value}
    with pytest.raises(InputError, match="no column is called '6'"):
        read(path, columns={"wheel_angular_speed": "6"})


def test_a_shift_that_a_better_model_does_without_is_no_lag(rows, monkeypatch):
    """A model that is not the log's may follow the motion better with a column shifted: that is no delay to undo."""
    monkeypatch.setattr("railslip_ctrl.identification.candidates.OF_EACH_KIND", ("burckhardt", "beam"))
    monkeypatch.setattr(job, "lag_of", lambda fit, *_: Lag(-0.08, 0.01) if fit.model.name == "burckhardt" else None)
    (told,) = identified(rows, model="burckhardt").warnings
    assert "burckhardt follows the wheel's motion best with its speed shifted by -0.08 s, which beam, a better" in told
    monkeypatch.setattr(job, "lag_of", lambda *_: Lag(-0.08, 0.01))
    (told,) = identified(rows, model="burckhardt").warnings
    assert "seems to be early by 0.08 s" in told


def test_a_law_of_a_wet_log_has_no_slip_for_dry_rail(rows, tmp_path):
    found = identified(rows, model="burckhardt", rail=Rail.WET)
    (tmp_path / "model.toml").write_text(model_toml(found))
    content = tomllib.loads(model_toml(found))
    assert content["reference_slip"] == {"wet": found.reference.wet}
    assert load_law(tmp_path / "model.toml").reference_slip(Rail.WET) == found.reference.wet


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


def test_numbers_beyond_all_measurement_are_refused_in_one_line(rows, recwarn):
    torque = rows.columns["brake_torque"].copy()
    torque[::10] = 1e300
    with pytest.raises(InputError, match=r"brake torque 1e\+300 N\*m is beyond any wheel") as caught:
        curve_of(changed(rows, brake_torque=torque), PARK2008, Options())
    assert "--zero" not in str(caught.value)
    assert not list(recwarn)


def test_a_copy_of_a_log_is_no_other_test(railslip, rows, tmp_path):
    first, copy = write_log(tmp_path / "a.csv", rows), write_log(tmp_path / "b.csv", rows)
    assert "b.csv is a copy of " in refused(railslip("identify", first, copy, "--model", "beam"))


def test_the_observed_rows_do_not_go_where_the_model_goes(railslip, rows, tmp_path):
    log, out = write_log(tmp_path / "a.csv", rows), tmp_path / "fitted"
    for file in (out, out / "model.toml"):
        line = refused(railslip("identify", log, "--model", "beam", "--out", out, "--observed", file))
        assert line.startswith("railslip: error: --observed: ")
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_a_symmetric_interval_ends_at_a_bound():
    assert fits._inside(1.0, 0.5, 0.0, math.inf) == (0.0, 1.0 + fits.NORMAL_QUANTILE * 0.5)
    assert fits._inside(1.0, 0.5, -1.0, 2.0) == (1.0 - fits.NORMAL_QUANTILE * 0.5, 2.0)
    assert fits._inside(1.0, 0.1, 0.0, 2.0) is None
    assert fits._inside(1.0, math.nan, 0.0, 2.0) is None


def test_bounds_the_wrong_way_round_are_told():
    with pytest.raises(InputError, match=r"--bound mu_max: 0.4:0.2 is not allowed; give the lower bound first"):
        identified(rig_rows(published_law("beam", Rail.DRY), runs=2, seed=3)[0], "beam", bounds={"mu_max": (0.4, 0.2)})
