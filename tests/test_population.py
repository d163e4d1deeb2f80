"""The population of random stops, and the table that the controllers are compared in."""

import sys

import numpy as np
import pytest
from project import script

from railslip_ctrl.simulation.population import FAMILIES, one_hump, peak_of, random_stop


@pytest.mark.parametrize("family", FAMILIES)
def test_a_seed_is_one_vehicle_and_rail_with_and_without_errors(family):
    plain, wrong = (random_stop(7, family=family, errors=errors) for errors in (False, True))
    assert plain == random_stop(7, family=family)
    assert (plain.vehicle, plain.adhesion, plain.events) == (wrong.vehicle, wrong.adhesion, wrong.events)
    assert plain.believed_vehicle == plain.vehicle
    brake, believed = wrong.vehicle.actuator, wrong.believed_vehicle.actuator
    assert 0.7 <= believed.dead_time / brake.dead_time <= 1.3
    assert 0.7 <= believed.lag / brake.lag <= 1.3
    assert 0.85 <= wrong.limits.torque_gain <= 1.15
    assert abs(wrong.believed_vehicle.wheel.radius / wrong.vehicle.wheel.radius - 1.0) <= 1.02 / 0.98 - 1.0


def test_a_hump_has_its_peak_where_it_was_drawn():
    for seed in range(20):
        slip = np.exp(np.random.default_rng(seed).uniform(np.log(0.008), np.log(0.15)))
        top = peak_of(one_hump(np.random.default_rng(seed)), 27.0, 5e4)
        assert top.slip == pytest.approx(slip, rel=1e-3)
        assert 0.05 <= top.mu <= 0.35


@pytest.mark.long
def test_the_table_of_the_population(capsys, monkeypatch):
    """Of 24 development stops."""
    module = script("analysis/population.py")
    stops = module.run(range(24))
    mine = [one for one in stops if one.controller == "seeking" and not one.errors]
    assert np.median([one.over for one in mine]) < 12.0
    rules = [one for one in stops if one.controller == "slide protection" and not one.errors]
    assert np.median([one.over for one in rules]) > 40.0
    monkeypatch.setattr(module, "run", lambda *_, **__: stops)
    monkeypatch.setattr(sys, "argv", ["population.py", "24", "0"])
    module.main()
    out = capsys.readouterr().out
    assert out.startswith("one hump, seeds 0 to 23")
    assert out.count("\n  peak ") + out.count("\n  hand-over ") >= 12
