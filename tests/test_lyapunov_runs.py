"""V, V' and the bound of (40) along nonlinear runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis import lyapunov_along_runs
from railslip_ctrl import PARK2008, ReferenceSlip
from railslip_ctrl.report.plots import adaptation_figure, lyapunov_runs_figure, save_figure
from railslip_ctrl.report.verification import lyapunov_runs_text
from railslip_ctrl.simulation import SlidingControl, published_scenario
from railslip_ctrl.sliding.law import PUBLISHED_LAW
from railslip_ctrl.verification.lyapunov_runs import LyapunovRun, judge_run

REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)
SI = published_scenario(as_published=False)

Runs = dict[tuple[str, bool, bool], LyapunovRun]


@pytest.fixture(scope="module")
def si_runs() -> Runs:
    return lyapunov_along_runs.run(as_published=False)


@pytest.fixture(scope="module")
def published_runs() -> Runs:
    return lyapunov_along_runs.run(as_published=True)


def test_the_proof_is_borne_out_without_actuator_and_noise(si_runs: Runs) -> None:
    """In SI Fr alone disturbs, which K covers: (42) and V' <= 0 must then hold at every sample."""
    ideal = si_runs["k = 0", False, False]
    assert all(condition.holds for condition in ideal.conditions)
    adaptive = si_runs["printed k", False, False]
    assert adaptive.condition("Lyapunov, theta constant").holds
    assert not adaptive.condition("Lyapunov").holds  # B(t) drifts: nothing in the proof covers it


@pytest.mark.long
def test_as_published_the_caliper_breaks_the_bound_for_a_moment(published_runs: Runs) -> None:
    """Td = 0.05 Tb exp(-4t) sin(10 pi t) beats K = 70 N m early on, and only then."""
    reaching = published_runs["k = 0", False, False].condition("reaching (40)")
    assert 0.0 < reaching.first_violation < 1.0
    assert reaching.share > 0.99


def test_with_the_actuator_there_is_no_sliding(si_runs: Runs) -> None:
    assert si_runs["k = 0", True, False].condition("sliding").share < 0.3
    assert si_runs["k = 0", True, True].condition("reaching (40)").share < 0.5


@pytest.mark.long
def test_as_published_the_train_slides_little_and_the_printed_adaptation_keeps_it_from_stopping(
    published_runs: Runs,
) -> None:
    """published.md: s s' < 0 three quarters of the time without noise; with k = 2.1e-8 three times as long a stop."""
    assert published_runs["k = 0", True, False].condition("sliding").share == pytest.approx(0.75, abs=0.01)
    assert published_runs["k = 0", True, True].condition("reaching (40)").share < 0.5
    with_k, without = (published_runs[name, True, True].run for name in ("printed k", "k = 0"))
    assert with_k.braking_time > 3 * without.braking_time
    ideal = published_runs["printed k", False, True].run
    assert ideal.braking_time < 1.1 * without.braking_time  # it is the actuator, not the adaptation alone


def test_the_recorded_rate_is_the_derivative_of_s() -> None:
    """s' from the plant's rates against differences of the recorded s, where nothing jumps."""
    scenario = SI.with_changes(events=(), longest_time=3.0)
    law = replace(PUBLISHED_LAW, k1=0.0, k2=0.0)
    signals = judge_run(scenario, SlidingControl(law, REFERENCE), seed=None).signals
    middle = 0.5 * (signals.s_rate[1:] + signals.s_rate[:-1])
    # the law's integral is backward Euler: its e is one sample ahead, rho e' h off
    assert np.diff(signals.s) / np.diff(signals.time) == pytest.approx(middle, abs=0.02)


def test_theta_steps_with_the_mass() -> None:
    """(44) corrected: theta1 = (1/r)(1/M - 1/Mn), here worked out by hand for 3517 -> 5276 kg."""
    scenario = SI.with_changes(events=({"time": 1.0, "mass": 5276.0},), longest_time=2.0)
    theta = judge_run(scenario, SlidingControl(PUBLISHED_LAW, REFERENCE), seed=None).signals.theta
    assert theta[0, 0] == 0.0
    assert theta[-1, 0] == pytest.approx((1 / 5276 - 1 / 3517) / PARK2008.wheel.radius, rel=1e-12)


@pytest.mark.long
def test_report_and_figure(tmp_path: Path, si_runs: Runs) -> None:
    cases = [(lyapunov_along_runs.label(case), judged) for case, judged in si_runs.items()]
    text = lyapunov_runs_text(cases)
    assert ("k = 0, ideal " in text, "never" in text) == (True, True)
    for draw, chosen in ((lyapunov_runs_figure, cases[:4]), (adaptation_figure, cases[4:])):
        save_figure(draw(chosen, "title"), tmp_path / "runs.png")  # which is looked at, conftest.py
