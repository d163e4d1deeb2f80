"""designs/from_log.py: from a rig's log to a braking train, its conclusions asserted."""

from __future__ import annotations

import numpy as np
import pytest
from project import script, show

from railslip_ctrl.adhesion import load_law
from railslip_ctrl.parameters import PARK2008, Rail
from railslip_ctrl.units import KMH


def test_from_log(tmp_path, capsys, monkeypatch):
    module = script("designs/from_log.py")
    result = module.run()
    truth, fit = module.TRUE_LAW, result.found.chosen.fit
    # 1. The vehicle is not the paper's, and the log tells its law and its parameters.
    assert result.vehicle.wheel_load > 3.0 * PARK2008.wheel_load
    # ten digits in the log
    assert result.found.setting.wheel_load == pytest.approx(result.vehicle.wheel_load, rel=1e-9)
    assert fit.model.name == truth.name
    for p in fit.parameters:
        assert p.interval[0] <= getattr(truth, p.name) <= p.interval[1]
        assert p.stderr < 0.06 * p.value
    # 2. The slip held is on the rise, for the true law too, and gives away little of its adhesion.
    slips = np.linspace(0.01, 0.5, 4000)
    mu = truth.c1 * (1.0 - np.exp(-truth.c2 * slips)) - truth.c3 * slips  # [Burckhardt]'s closed form
    assert result.held.dry < slips[np.argmax(mu)]
    assert np.interp(result.held.dry, slips, mu) > 0.97 * mu.max()
    # 3. The design was made for a family that holds the true plants, pole by pole, and keeps its promise on them.
    poles = [float(plant.poles[0].real) for plant in result.plants]
    assert len(poles) == 7 * 12
    assert max(poles) - min(poles) > 1.0
    assert all(margins.ms <= module.MS_MAX * (1 + 1e-6) for margins in result.design.margins)
    assert len(result.true_margins) == 12
    assert max(margins.ms for margins in result.true_margins) <= module.MS_MAX
    # 4. The stop on the true law, dry then wet: no lock, and near what that rail can give.
    highest = mu.max() * result.vehicle.wheel_load / result.vehicle.mass
    wet = 0.5 * highest  # half the adhesion on wet rail
    shortest = module.INITIAL_SPEED**2 / (2.0 * highest)
    longest = module.INITIAL_SPEED**2 / (2.0 * wet)
    for run in result.runs:
        assert run.stopped
        assert run.final_speed < 5.01 * KMH
        assert run.locked_fraction == 0.0
        assert shortest < run.braking_distance < 1.1 * longest
        # half of the adhesion gone at once: the wheel runs towards the lock, as the brake is 0.75 s late, and is caught
        late = run.signals.time > module.RAIN + 6.0
        assert np.abs(run.signals.slip[late] - result.held.wet).mean() < 0.03
        assert run.scenario.adhesion == truth
        assert run.controller.name == "pi-lead"  # as its picture's title says
    # 5. What it prints and writes.
    show(module, result, tmp_path, monkeypatch)
    assert "On the true law the worst Ms is" in capsys.readouterr().out
    assert sorted(p.name for p in tmp_path.glob("*.png")) == ["from_log_adhesion.png", "from_log_stop.png"]
    assert load_law(tmp_path / "model.toml").on(Rail.DRY) == fit.law.model_copy(
        update={"reference": result.found.reference}
    )
