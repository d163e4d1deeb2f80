"""Faults of a log that its rows tell: coarse speeds, a torque's zero, a wrong wheel, lateness, regripping, loads."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.identify import Options, _different_loads, curve_of, identify_curve
from railslip_ctrl.identification.observer.sensors import Encoder
from railslip_ctrl.identification.outliers import OutlierFilter
from railslip_ctrl.identification.regripping import Regripping
from railslip_ctrl.identification.resolution import Resolution, step_of
from railslip_ctrl.identification.rows import Rows
from railslip_ctrl.identification.timing import Lag, lag_warning
from railslip_ctrl.identification.virtual_rig import RigTest, run_tests
from railslip_ctrl.model.adhesion import law_class, published_law
from railslip_ctrl.model.vehicle import PARK2008, Rail

BURCKHARDT = law_class("burckhardt").model_validate({"c1": 0.31, "c2": 24.0, "c3": 0.11})
RADIUS = PARK2008.wheel.radius


def rig(name: str = "burckhardt", speed_kmh: float = 100.0, *, tests: int = 2, seed: int = 0, **measured) -> Rows:
    law = BURCKHARDT if name == "burckhardt" else published_law(name, Rail.DRY, speed_kmh, PARK2008.wheel_load)
    log = run_tests(RigTest(PARK2008, law, speed_kmh * KMH, **measured), tests=tests, seed=seed)
    return Rows(np.arange(log.time.size) + 2, dataclasses.asdict(log))


def changed(rows: Rows, **columns: np.ndarray) -> Rows:
    return Rows(rows.line, {**rows.columns, **columns})


def told(rows: Rows, **options) -> list[str]:
    """What is said of a log, but for its pauses between tests."""
    warnings = curve_of(rows, PARK2008, Options(**options)).warnings
    return [text for text in warnings if "gap of 30" not in text]


@pytest.fixture(scope="module")
def rows() -> Rows:
    return rig(tests=3)


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
        outliers.add(changed(rows, wheel_angular_speed=omega))
        outliers.finish()
        assert outliers.count == count
    (text,) = told(rows)
    share = 100.0 * RADIUS * step / (speed * KMH)
    assert f"'wheel_angular_speed [rad/s]' in steps of {step:.4g}, {share:.2g} % of slip at the initial speed" in text


# --- rolling freely ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("zero", [100.0, 300.0, 1000.0, -500.0, -2000.0])
def test_a_torque_s_zero_is_told_whatever_it_is(rows, zero):
    (text,) = (t for t in told(changed(rows, brake_torque=rows.columns["brake_torque"] + zero)) if "--zero" in t)
    assert f"the brake torque reads {zero:.4g} N*m where the wheel rolls freely" in text
    assert f"--zero brake_torque={zero:.4g} takes it off" in text


def test_a_zero_that_is_not_the_log_s_is_told(rows):
    (text,) = told(rows, zeros={"brake_torque": 500.0})
    assert "leave --zero brake_torque out" in text
    off = changed(rows, brake_torque=rows.columns["brake_torque"] + 800.0)
    (text,) = told(off, zeros={"brake_torque": 500.0})
    assert "reads 300 N*m beside the 500 N*m that is taken off" in text
    assert "--zero brake_torque=800 takes it off" in text
    for name, value in (("wheel_angular_speed", 0.5), ("train_speed", -0.3)):
        (text,) = (t for t in told(rows, zeros={name: value}) if "free rolling" in t)
        assert f"without the --zero {name}={value:.4g} that is given" in text
        assert "leave it out" in text


@pytest.mark.parametrize("factor", [0.9, 0.997, 1.003, 1.1])
def test_a_wrong_radius_is_told_as_one(rows, factor):
    wrong = changed(rows, wheel_angular_speed=factor * rows.columns["wheel_angular_speed"])
    (text,) = (t for t in told(wrong) if "free rolling" in t)
    radius = float(text.split("the wheel radius may be ")[1].split(" m")[0])
    # four digits are told; the slip without brake is known to 3 of 10 000 here, and some 1e-4 more from friction
    assert radius == pytest.approx(RADIUS / factor, rel=6e-4)


@pytest.mark.parametrize("factor", [0.5, 2.0, 3.6])
def test_a_wrong_unit_is_told_as_one(rows, factor):
    wrong = changed(rows, wheel_angular_speed=factor * rows.columns["wheel_angular_speed"])
    try:
        text = " ".join(told(wrong))
    except InputError as error:
        text = str(error)
    assert f"the wheel's speed is {factor:.3g} times the train's: check the units of wheel_angular_speed" in text


@pytest.mark.parametrize("speed", [30.0, 100.0])
@pytest.mark.parametrize("name", ["beam", "bristle", "burckhardt", "polach"])
def test_nothing_is_said_of_a_log_without_fault(name, speed):
    for seed in range(3):
        assert told(rig(name, speed, seed=seed)) == []


# --- lateness ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("late", [0.01, 0.1, -0.02])
def test_a_lag_is_found_however_large(late):
    rows = rig()
    time, omega = rows.columns["time"], rows.columns["wheel_angular_speed"]
    delayed = changed(rows, wheel_angular_speed=np.interp(time - late, time, omega))
    options = Options(model="burckhardt")
    found = identify_curve(curve_of(delayed, PARK2008, options), PARK2008, options)
    (text,) = (text for text in found.warnings if "seems to be" in text)
    value, error = (float(x.split(" ")[0]) for x in text.split(" by ")[1].split(" ± "))
    assert value == pytest.approx(abs(late), abs=3.0 * error)
    assert error < 0.003  # a third of the interval: one that is no use would pass as well
    assert float(text.split("--delay wheel_angular_speed=")[1].split(" ")[0]) == pytest.approx(late, abs=3.0 * error)


def test_a_lag_is_told_with_what_undoes_it():
    half = lag_warning(Lag(0.0046, 0.001), 0.01, "wheel_speed", {})
    assert "late by 0.0046 s ± 0.001 s" in half
    assert "half an interval, as a difference of counts is: --delay wheel_speed=0.005 undoes it" in half
    more = lag_warning(Lag(0.03, 0.001), 0.01, "wheel_speed", {"wheel_speed": 0.005})
    assert "more than the --delay wheel_speed=0.005 that is given" in more
    assert more.endswith("--delay wheel_speed=0.035 undoes it")
    early = lag_warning(Lag(-0.02, float("nan")), 0.01, "wheel_speed", {})
    assert "early by 0.02 s beside" in early
    assert early.endswith("--delay wheel_speed=-0.02 undoes it")


# --- regripping ----------------------------------------------------------------------------------------------------


def test_rows_of_a_wheel_that_regrips_are_no_part_of_the_curve():
    """At 30 km/h the slip is back within a few rows: bins beside slip 0.2 had a standard deviation of 0.06."""
    curve = curve_of(rig("beam", 30.0, tests=6), PARK2008, Options())
    assert curve.survey.regripping > 20  # some seven rows a run
    past = curve.bins.low >= 0.1
    assert curve.bins.deviation[past].max() < 0.01  # the random force, through the observer


@pytest.mark.parametrize("cut", [500, 153, 156])
def test_a_wheel_regrips_while_its_slip_falls_under_a_torque_let_go(cut):
    time = 0.01 * np.arange(500)
    torque = np.where(time < 1.5, 4000.0, 4000.0 * np.exp(-(time - 1.5) / 0.05))
    slip = np.where(time < 1.55, 0.3 * time / 1.55, 0.3 * np.exp(-(time - 1.55) / 0.1))
    regripping = Regripping(0.05)
    parts = [
        regripping.add(*(x[at] for x in (time, slip, torque))) for at in (slice(cut), slice(cut, None)) if cut < 500
    ]
    found = np.concatenate(parts) if parts else regripping.add(time, slip, torque)
    assert not found[:155].any()  # the slip still grows
    assert found[165:220].all()  # two time constants later it is seen to fall
    held = Regripping(0.05).add(time, 0.1 + 0.02 * np.sin(time), 4000.0 + 300.0 * np.sin(time))
    assert not held.any()  # torque and slip go up and down by a brake that is moved, not let go


# --- wheel loads ---------------------------------------------------------------------------------------------------


def test_wheel_loads_that_differ_are_told(rows):
    second = rows.columns["time"] > rows.columns["time"][len(rows) // 2]
    factor = np.where(second, 1.2, 1.0)
    loads = {"wheel_load": factor * rows.columns["wheel_load"], "brake_torque": factor * rows.columns["brake_torque"]}
    (text,) = (t for t in told(changed(rows, **loads)) if "wheel load" in t)
    assert "lies between 3.45e+04 and 4.14e+04 N from run to run" in text
    logs = [
        SimpleNamespace(curve=SimpleNamespace(name=name), setting=SimpleNamespace(wheel_load=load))
        for name, load in (("a.csv", 3.0e4), ("b.csv", 3.1e4), ("c.csv", 4.0e4))
    ]
    (text,) = _different_loads(logs)
    assert "between 3e+04 N (a.csv) and 4e+04 N (c.csv)" in text
    assert "their mean, 3.367e+04 N" in text
    assert _different_loads(logs[:2]) == ()
