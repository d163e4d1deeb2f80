"""The observers' script, run and its numbers asserted; the figures of a record."""

from __future__ import annotations

import numpy as np
import pytest
from project import script, show


@pytest.fixture(scope="module")
def module():
    return script("analysis/observer_tradeoff.py")


@pytest.fixture(scope="module")
def result(module):
    return module.run()


def test_what_the_printed_form_does_wrong(module, result):
    printed, corrected, _ = module.NAMES
    assert result.passed_at_once == {printed: 1.0, corrected: 0.0}
    after = result.trial.time[1:] >= result.trial.release_time
    worst = {name: np.abs(error[after]).max() for name, error in result.errors.items()}
    # the released brake torque, 6.5 kN*m, stands in the printed estimate as 2 kN*m of adhesion that was not there
    assert result.errors[printed].min() < -1900
    assert result.errors[corrected].min() > -700
    assert worst[printed] > 1.4 * worst[corrected] > 1.4 * worst[module.NAMES[2]]


def test_best_settings(module, result):
    printed, corrected, kalman = (result.curves[name] for name in module.NAMES)
    # flat minima: the settings to 2 %, the errors to 1 N*m
    assert (printed.best, corrected.best) == pytest.approx((0.0304, 0.0490), rel=0.02)
    totals = [curve.at_best.total for curve in (printed, corrected, kalman)]
    assert totals == pytest.approx([379.4, 234.4, 131.6], abs=1.0)
    for curve in (printed, corrected, kalman):
        # one draw of the noise over a thousand samples with memory
        assert curve.at_best.simulated == pytest.approx(curve.at_best.total, rel=0.05)
    mu = result.coefficient_errors
    assert mu[module.NAMES[1]] == pytest.approx(corrected.at_best.total / (34_500 * 0.43))
    assert mu[module.NAMES[2]] < 0.0138 < mu[module.NAMES[1]]  # Table 3's error of the bristle model in adhesion


def test_sampling_faster_helps_the_kalman_filter_only(module, result):
    intervals = sorted(result.by_interval)
    by_name = {n: [result.by_interval[h][n][1] for h in intervals] for n in module.NAMES}
    for name in module.NAMES[:2]:
        assert by_name[name] == sorted(by_name[name], reverse=True)
    kalman = by_name[module.NAMES[2]]
    assert kalman[0] == pytest.approx(kalman[1], rel=0.02)
    assert kalman[0] < kalman[-1]
    assert all(k < c < p for p, c, k in zip(*by_name.values(), strict=True))


@pytest.mark.long
def test_script_prints_and_draws(module, result, tmp_path, capsys, monkeypatch):
    show(module, result, tmp_path / "pictures", monkeypatch)
    out = capsys.readouterr().out
    assert "printed (27): 100 % of a step of the brake torque" in out
    assert len(list((tmp_path / "pictures").glob("observer_*.png"))) == 3
