"""From the rows of a log to samples: what is observed of the adhesion, whole runs, torques between rows."""

import math

import numpy as np
import pytest

from railslip_ctrl import PARK2008, InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.observed import AdhesionStream, Observer, Recorder

LOAD = PARK2008.wheel_load
V100 = 100.0 * KMH


def ramp_rows(noise=0.0):
    """Slip rising from 0 at 0.02 1/s at constant speed, and the torque that goes with mu = 2 slip."""
    generator, count = np.random.default_rng(0), 2000
    time = np.cumsum(0.005 * generator.uniform(0.5, 1.5, count))
    slip, radius = 0.02 * time, PARK2008.wheel.radius
    omega = V100 * (1 - slip) / radius
    torque = 2 * slip * LOAD * radius + 0.02 * V100 / radius * PARK2008.wheel.inertia
    torque = torque - PARK2008.wheel.viscous_friction * omega
    omega = omega + noise * generator.standard_normal(count)
    columns = {"time": time, "train_speed": np.full(count, V100), "wheel_angular_speed": omega, "brake_torque": torque}
    return Rows(np.arange(count) + 2, columns)


@pytest.mark.parametrize(("observer", "lag"), [(Observer.CORRECTED, 1.0), (Observer.KALMAN, math.sqrt(2.0))])
def test_observed_mu_stands_over_the_slip_it_belongs_to(observer, lag):
    """The lag of the observer is in mu and in slip alike: a straight line stays the line it is.

    1/(tau s + 1) is tau late; 1/(tau^2 s^2 + sqrt(2) tau s + 1) is sqrt(2) tau late.
    """
    stream = AdhesionStream(PARK2008, observer=observer)
    observed = stream.add(ramp_rows())
    assert len(observed) > 1500
    # the start is not known to the observer: exp(-20) of it is left after 20 time constants, and rounding
    late = observed.time > observed.time[0] + 20 * stream.time_constant
    assert observed.mu[late] == pytest.approx(2 * observed.slip[late], rel=1e-6)
    behind = 0.02 * observed.time[late] - observed.slip[late]
    assert behind.mean() == pytest.approx(0.02 * lag * stream.time_constant, rel=0.01 if lag == 1.0 else 0.05)
    if observer is Observer.CORRECTED:
        spread = (observed.slip2 - observed.slip**2)[200:]  # of an exponential window: (rate tau)^2
        # the square is taken to run straight between samples too: (interval/tau)^2 of it
        assert spread == pytest.approx(np.full(spread.size, (0.02 * stream.time_constant) ** 2), rel=1e-2)


@pytest.mark.parametrize("observer", [Observer.CORRECTED, Observer.KALMAN])
def test_observed_samples_do_not_depend_on_the_blocks(observer):
    rows = ramp_rows(noise=0.01)
    whole, stream = AdhesionStream(PARK2008, observer=observer).add(rows), AdhesionStream(PARK2008, observer=observer)
    parts = [stream.add(rows.part(start, start + 77)) for start in range(0, len(rows), 77)]
    for name in ("time", "slip", "slip3", "speed", "mu"):
        joined, expected = np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name)
        if observer is Observer.CORRECTED:
            assert joined == pytest.approx(expected, rel=1e-12, abs=1e-14)
        elif name == "mu":  # the nominal interval, which the gain is for, is the first block's median
            assert np.median(np.abs(joined - expected)) < 0.1 * np.std(expected - 2 * whole.slip)


def test_a_gap_restarts_the_observer_and_is_told():
    rows = ramp_rows()
    kept = np.ones(len(rows), dtype=bool)
    kept[800:1000] = False
    stream, time = AdhesionStream(PARK2008), rows.columns["time"]
    observed = stream.add(rows.where(kept))
    assert (stream.survey.gap_count, stream.survey.runs) == (1, 2)
    assert stream.survey.gaps == [(1002, pytest.approx(time[1000] - time[799]))]
    after = observed.time[observed.time > time[999]]
    assert after[0] >= time[1000] + 5 * stream.time_constant  # what the observer does not know yet is not used
    assert observed.mu == pytest.approx(2 * observed.slip, rel=0.01)


def test_impossible_rows_are_left_out_when_few_and_refused_when_many():
    rows, stream = ramp_rows(), AdhesionStream(PARK2008)
    rows.columns["wheel_angular_speed"][[500, 501]] = 5000.0
    stream.add(rows)
    stream.check("log")
    assert stream.survey.implausible == 2
    assert stream.survey.first_implausible.startswith("line 502: wheel speed 7740 km/h is beyond any train")
    fast, stream = ramp_rows(), AdhesionStream(PARK2008)
    fast.columns["wheel_angular_speed"] *= 1.8
    stream.add(fast)
    with pytest.raises(InputError, match=r"log: line \d+: wheel speed .* far above the train's.*check columns"):
        stream.check("log")


def test_wheel_speed_and_wheel_load_columns_are_used():
    rows, stream = ramp_rows(), AdhesionStream(PARK2008)
    rows.columns["wheel_speed"] = rows.columns.pop("wheel_angular_speed") * PARK2008.wheel.radius
    rows.columns["wheel_load"] = np.full(len(rows), 2 * LOAD)
    observed = stream.add(rows)
    assert stream.survey.wheel_load == pytest.approx(2 * LOAD)
    late = observed.time > 2.0  # the start is forgotten by then, up to rounding of differences
    assert observed.mu[late] == pytest.approx(observed.slip[late], rel=1e-7)


def test_a_record_is_whole_runs_however_its_rows_come():
    generator = np.random.default_rng(5)
    used = np.repeat(generator.uniform(size=60) < 0.6, 50)
    rows = np.vstack([np.arange(used.size, dtype=float), np.ones((4, used.size))])
    apart = np.zeros(used.size, dtype=bool)
    apart[1234] = True
    whole, parts = Recorder(700), Recorder(700)
    whole.add(rows, used, apart)
    for start in range(0, used.size, 77):
        at = slice(start, start + 77)
        parts.add(rows[:, at], used[at], apart[at])
    record = whole.record()
    assert 0 < len(record) <= 700
    assert np.array_equal(record.time, parts.record().time)
    begins = np.flatnonzero(np.diff(used.astype(int), prepend=0) == 1)
    kept = record.time.astype(int)
    for run in np.unique(record.run):
        of_run = kept[record.run == run]
        assert np.array_equal(np.diff(of_run), np.ones(of_run.size - 1))
        assert of_run[0] in begins or apart[of_run[0]]
        assert of_run[-1] + 1 == used.size or not used[of_run[-1] + 1] or apart[of_run[-1] + 1]
