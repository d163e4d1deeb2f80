"""designs/from_log.py: from a rig's log to a braking train, its conclusions asserted."""

from __future__ import annotations

import numpy as np
import pytest
from project import script, show

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import load_law
from railslip_ctrl.model.vehicle import PARK2008, Rail


@pytest.mark.long
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
    assert len(poles) == 7 * 12 + 7
    assert all(pole > 0.0 for pole in poles[-7:])  # past the peak
    assert max(poles) - min(poles) > 1.0
    assert all(margins.ms <= module.MS_MAX * (1 + 1e-6) for margins in result.design.margins)
    assert len(result.true_margins) == 12
    assert max(margins.ms for margins in result.true_margins) <= module.MS_MAX
    # Past the peak the unstable pole grows as the train slows down: the loop holds it at speed, and not near the end.
    assert 2.0 < result.slowest_falling < 50.0
    # 4. The stop on the true law, dry then wet, beside the best there is: the highest mu of each rail all the way.
    vehicle = result.vehicle
    highest = mu.max() * vehicle.wheel_load / vehicle.mass  # half of it on wet rail
    at_rain = module.INITIAL_SPEED - highest * module.RAIN
    attainable = (module.INITIAL_SPEED + at_rain) / 2 * module.RAIN + (at_rain**2 - (5.0 * KMH) ** 2) / highest
    filling = module.INITIAL_SPEED * (vehicle.actuator.dead_time + vehicle.actuator.lag)
    least_lock = lock_of_the_fastest_release(vehicle, truth, at_rain, result.held.dry)
    assert least_lock > 0.2  # s; it cannot be helped
    for run in result.runs:
        assert run.stopped
        assert run.final_speed < 5.01 * KMH
        # 0.75 s of rolling while the brake fills, and 12 % for the lock and for what a margin to the peak gives away
        assert attainable < run.braking_distance < 1.12 * (attainable + filling)
        time, slip = run.signals.time, run.signals.slip
        # on dry rail, from 2 s on, as the brake needs 0.75 s: nearly all the adhesion there is
        dry = (time > 2.0) & (time < module.RAIN)
        assert np.interp(slip[dry], slips, mu).mean() > 0.95 * mu.max()
        assert slip[time < module.RAIN].max() < 1.6 * result.held.dry  # its overshoot, past the peak, and back
        # the lock by the rain: no longer than by a release at the moment it falls, and 0.75 s of the brake
        assert run.locked_fraction * run.braking_time < least_lock + 0.75
        late = time > module.RAIN + 6.0
        assert np.abs(run.signals.slip[late] - result.held.wet).mean() < 0.03
        assert run.scenario.adhesion == truth
        assert run.controller.name == "pi-lead"  # as its picture's title says
    # 5. What it prints and writes.
    show(module, result, tmp_path, monkeypatch)
    assert "On the true law the worst Ms is" in capsys.readouterr().out
    assert sorted(p.name for p in tmp_path.glob("*.png")) == ["from_log_adhesion.png", "from_log_stop.png"]
    assert load_law(tmp_path / "model.toml").on(Rail.DRY) == fit.law.model_copy(update={"reference": result.held})


def lock_of_the_fastest_release(vehicle, law, speed, slip):
    """How long the wheel stands, s, if the brake is let go at the very moment the rail turns wet: Euler's method."""
    r, N, J, h = vehicle.wheel.radius, vehicle.wheel_load, vehicle.wheel.inertia, 1e-4

    def mu(x):
        return 0.5 * (law.c1 * (1.0 - np.exp(-law.c2 * x)) - law.c3 * x)

    begin, v, omega, stood = 2.0 * mu(slip) * r * N, speed, (1.0 - slip) * speed / r, 0.0
    for i in range(30_000):
        late = i * h - vehicle.actuator.dead_time
        torque = begin * np.exp(-max(late, 0.0) / vehicle.actuator.lag)
        force = N * mu(max(1.0 - r * omega / v, 0.0))
        omega = max(omega + h * (r * force - torque) / J, 0.0)
        v -= h * force / vehicle.mass
        stood += h * (r * omega < 0.02 * v)
    return stood
