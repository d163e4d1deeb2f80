"""Columns of a log that are late or off zero: named, and corrected by --delay and --zero."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from project import refused
from rig_logs import identified, rig_rows

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.identification.cleaning import LONGEST_DELAY, Alignment
from railslip_ctrl.identification.curves import Options, curve_of
from railslip_ctrl.identification.identify import Identification
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.observer import Encoder
from railslip_ctrl.identification.virtual_rig import RigTest, published_tests, run_tests
from railslip_ctrl.model.vehicle import PARK2008

BEAM = published_tests("beam")[2]
HALF = BEAM.interval / 2


def found_by(test: RigTest, *, seed: int = 0, **options) -> Identification:
    rows = run_tests(test, tests=6, seed=seed)
    return identified(rows, test.law.name, initial_speed=test.initial_speed, **options)


def errors(found: Identification) -> dict[str, float]:
    return {p.name: p.value / getattr(BEAM.law, p.name) - 1.0 for p in found.chosen.fit.parameters}


def delayed(delays: dict[str, float]) -> tuple[Rows, Rows]:
    """Rows whose columns are each late by their delay, and as they would be without. Parabolas of time."""
    time = np.sort(np.random.default_rng(0).uniform(0.0, 10.0, 2000))

    def rows(delay):
        columns = {
            name: (k + 1.0) * (time - delay.get(name, 0.0)) ** 2
            for k, name in enumerate(("train_speed", "wheel_angular_speed", "brake_torque"))
        }
        return Rows(np.arange(2000), {"time": time, **columns})

    return rows(delays), rows(
        dict.fromkeys(("train_speed", "wheel_angular_speed", "brake_torque"), delays["wheel_angular_speed"])
    )


def cut(rows: Rows, *, into: int):
    edges = [0, *sorted(np.random.default_rng(into).integers(0, len(rows), into - 1).tolist()), len(rows)]
    return (rows.part(a, b) for a, b in itertools.pairwise(edges))


@pytest.mark.parametrize("into", [1, 7, 400])
def test_columns_are_brought_to_the_wheel_s_time_however_a_log_is_cut(into):
    delays = {"wheel_angular_speed": 0.03, "brake_torque": 0.2, "train_speed": -0.05}
    rows, expected = delayed(delays)
    parts = list(Alignment(delays, {}, "log").rows(cut(rows, into=into)))
    found = {name: np.concatenate([part.columns[name] for part in parts]) for name in rows.columns}
    assert np.concatenate([part.line for part in parts]).tolist() == rows.line.tolist()
    inside = (rows.columns["time"] > 0.3) & (rows.columns["time"] < 9.7)  # beyond, the ends are held
    assert (found["wheel_angular_speed"] == rows.columns["wheel_angular_speed"]).all()  # its noise stays as it was
    for name in ("train_speed", "brake_torque"):
        # straight between rows up to 0.05 s apart: off by less than 3 * 2 * 0.05^2 / 8
        assert found[name][inside] == pytest.approx(expected.columns[name][inside], abs=2e-3)


def test_zeros_are_taken_off():
    rows, _ = delayed({"wheel_angular_speed": 0.0})
    (part,) = (p for p in Alignment({}, {"brake_torque": 35.0}, "log").rows(iter([rows])) if len(p))
    assert part.columns["brake_torque"] == pytest.approx(rows.columns["brake_torque"] - 35.0)
    assert part.columns["train_speed"] is not None


@pytest.fixture(scope="module")
def counted() -> RigTest:
    """A rig whose wheel has an encoder of 1024 lines: its speed is the mean over the interval before."""
    return dataclasses.replace(BEAM, encoder=Encoder(4096))


def test_an_encoder_s_speed_is_half_an_interval_late_and_corrected(counted):
    """Without a word it would cost a quarter of the falling branch."""
    late = found_by(counted, seed=3)  # of 40 seeds, 39 intervals hold mu_max and a, 40 Kx, as of 99 % they should
    assert abs(errors(late)["a"]) > 0.15
    (text,) = (text for text in late.warnings if "seems to be late by" in text)
    # the mean over an interval is not quite a delay of half of it: a fifth of it off at most
    assert float(text.split("late by ")[1].split(" s")[0]) == pytest.approx(HALF, abs=0.2 * BEAM.interval)
    assert "half an interval, as a difference of counts is: --delay wheel_angular_speed=0.005 undoes it" in text
    right = found_by(counted, seed=3, delays={"wheel_angular_speed": HALF})
    assert not any("seems to be" in text for text in right.warnings)
    for p in right.chosen.fit.parameters:
        assert p.interval[0] <= getattr(BEAM.law, p.name) <= p.interval[1]
    assert abs(errors(right)["mu_max"]) < 0.01 < abs(errors(late)["mu_max"])


def test_columns_in_step_are_not_called_late():
    assert not any("seems to be" in text for text in found_by(published_tests("bristle")[2], seed=1).warnings)


def test_corrections_that_cannot_be_are_refused(tmp_path, railslip):
    path = tmp_path / "log.csv"
    path.write_text("time [s],v [m/s],omega [rad/s],torque [N*m]\n0,30,69,0\n")
    for arguments, text in (
        (("--delay", "wheel=0.1"), "--delay: 'wheel' is no quantity of a log; "),
        (("--delay", "time=0.1"), "choose one of train_speed, "),
        (("--delay", "brake_torque=3"), f"--delay brake_torque: 3 s is not allowed; give at most {LONGEST_DELAY:g} s"),
        (("--zero", "brake_torque=1 kg"), "--zero brake_torque"),
        (("--zero", "wheel_load=10"), "log.csv: no column wheel_load to correct; it has time, "),
    ):
        assert text in refused(railslip("identify", path, *arguments))


# --- wheel loads that vary -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("factors", [(0.9, 1.1), pytest.param((0.6, 1.4, 1.0), marks=pytest.mark.long)])
def test_a_law_that_depends_on_the_load_is_taken_at_the_load_of_each_row(factors):
    """Beam: at the mean load of the log its highest mu came out 2 % off, beyond its interval."""
    truth = BEAM.law
    (rows,) = rig_rows(truth, loads=factors, seed=4)
    found = identified(rows)
    for p in found.chosen.fit.parameters:
        assert p.interval[0] <= getattr(truth, p.name) <= p.interval[1]
        assert p.stderr < 0.1 * p.value


def test_rows_whose_wheel_does_not_press_on_the_rail_are_left_out():
    (rows,) = rig_rows(BEAM.law, loads=(1.0, 1.0), runs=2, seed=4)
    rows.columns["wheel_load"][300:305] *= -1.0
    curve = curve_of(rows, PARK2008, Options())
    assert any("5 impossible rows left out; line 302: wheel load -" in text for text in curve.warnings)
    assert curve.bins.most.max() < 0.6
    rows.columns["wheel_load"][:] *= -1.0
    with pytest.raises(InputError, match="does not press on the rail"):
        curve_of(rows, PARK2008, Options())
