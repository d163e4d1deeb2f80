"""The scripts of designs/ and of the observers, run and their numbers asserted."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from project import ROOT, script

from railslip_ctrl import Rail, load_law


@pytest.mark.parametrize("path", sorted((ROOT / "designs").glob("*.py")), ids=lambda path: path.stem)
def test_a_design_script_needs_names_from_the_top_alone(path):
    named = re.findall(r"^\s*(?:from|import) (railslip_ctrl[\w.]*)", path.read_text("utf-8"), flags=re.M)
    assert set(named) == {"railslip_ctrl"}


# numbers of oracles.md of the project's specification among them, in the digits that are printed
PRINTED = {
    "designs/pi_published": (3, "unstable: 2 closed-loop poles", "0.05859 to 0.2288 times this loop gain",
        "0.02832 to 0.3106 times", "Phase margin 6.37644 deg", "Phase margin 8.23774 deg"),
    "designs/pi_dry": (1, "kp between 127.4 and 573.1", "0.7982 rad/s", "Phase margin 10.0144 deg",
        "Ms = max |S| 5.73152", "Ms = max |S| 5.57903", "stable but fragile"),
    "designs/pi_wet": (1, "Ms = max |S| 2.18385", "unstable: 2 closed-loop poles", "both rails", "worst Ms 5.502."),
    "designs/pi_robust": (1, "kp in (127.4, 573.1)", "ki >= 5: 5.416 at kp = 21",
        "with ki near 0: 4.693. Even the best PI is fragile", "100.0 % of the loops stable fragile: Ms 5.42 (Ms 5.55",
        "Ms 42.09", "89.3 % of the loops stable unstable"),
    "designs/pi_lead": (4, "kp 229.4 N*m/(m/s), ki 5: worst Ms 1.4291", "0.02 s: worst Ms 1.325",
        "0.06 s: worst Ms 1.429", "0.12 s: worst Ms 1.606", "0.30 s: worst Ms 2.345",
        "sampled every 59 ms: Ms 1.515 at dry"),
    "designs/pi_scheduled": (1, "dry 20 335.6 326.5 1.800", "wet 100 313.5 226.9 1.800",
        "does not suffice for Ms <= 1.8: worst Ms 1.997", "loop down to 14.3 km/h",
        "lead to 4.02 km/h", "this gain set to 11.8 km/h", "worst Ms 1.817 between its entries"),
    "designs/compare_designs": (2, "no controller has Ms or Mt below 1.13; PI: phase margin <= 12.3 deg, Ms >= 4.67",
        "best PI dry 5.42 10.7", "PI-lead dry 1.43 41.3", "Smith predictor dry no stable loop",
        "filtered Smith predictor dry 1.32", "observer with prediction dry 1.41 42.9", "SIMC rule dry no stable loop",
        "a hidden mode"),
    "designs/predictive_sliding": (2, "kappa 1.8 1/s, k 2 1/s, K 4549 N*m/s, phi 511.8 N*m", "stable from 60 km/h up",
        "hands over below 14 km/h", "reaching within the torque limits proved over the box", "authority counterexample",
        "brake gain 5.47 % 511.8 reaching within the torque limits", "lowest speed 40.1 km/h", "release certified at 8",
        "dry 178.4 m 179.5 m 1.00 84.0 % of samples 14 to 30 km/h", "wet 285.0 m 284.6 m 0.11 90.5 %"),
    "designs/asmc_published": (1, "gain on e: (J/r) rho + D 221.6 N m/(m/s), with (J/r) rho = 216.1",
        "gain on the integral of e: D rho 8.5", "gain on e: (J/r) rho + D 783.6",
        "least K, at e = 0 , 1 and 3 sigma 484.5 and 910.6 N m", "least K, whole run, 1 and 3 sigma 887.2 and",
        "6.5 s, undisturbed", "23.3 s, undisturbed", "K is far too small for sliding"),
    "analysis/errata": (0, "12 agree, 21 do not"),
    "analysis/lyapunov_asmc": (1, "12 of 28 conditions do not hold in SI", "As published (M, J and B times 3.6) the"),
    # rms errors in N*m by formula, simulated, and in adhesion: Table 3 has 0.0138
    "analysis/observer_tradeoff": (3, "printed (27): 100 % of a step of the brake torque", "corrected: 0 % of a step",
        "380 383 0.0256 corrected", "234 236 0.0158 Kalman", "132 132 0.0089"),
    # [Park2008] p. 52: less adhesion at higher initial speed, with either model
    "analysis/model_curves": (2, "30 km/h: peak 0.3547 at slip 0.1319",
        "100 km/h: peak 0.2483 at slip 0.0897, published reference 0.119", "30 km/h: peak 0.3390",
        "100 km/h: peak 0.2992 at slip 0.1288, published reference 0.132",
        "bristle v0 = 100 km/h: falls from 0.3274 at slip 0", "Table 3: bristle over beam 23.0 %"),
    # p. 56: the PI keeps a large error, the ASMC stays near its reference; its burst after 25 s is the larger one
    "analysis/figures_17_to_21": (5, "curve dry: peak 0.299 at slip 0.129", "curve wet: peak 0.153 at slip 0.096",
        "PI beam: 58.9 s, 699 m", "slip error -0.030 on dry rail, highest slip 0.36 after", "slip error -0.054 on dry",
        "ASMC bristle: 50.2 s, 581 m", "error +0.008 on", "highest slip 0.42", "error +0.009 on", "highest slip 0.45"),
    "analysis/pade_order": (0, "gain increase PI-lead +9.6e-02 +1.7e-03 +1.4e-05", "phase margin PI +6.8e-04 +1.5e-07",
        "largest kp 0.15 s +9.1e-03 +1.5e-05 +1.1e-08"),
    "analysis/margin_map": (1, "PI 211/5: 6804 cases, 92.83 % stable; unstable: curve",
        "PI-lead 229/5: 6804 cases, 94.14 % stable; un", "stable from 80 km/h up, there Ms 3.88",
        "bristle: 100 % / 2.09"),
}  # fmt: skip
QUICK = ("designs/pi_dry", "designs/pi_wet")


@pytest.mark.parametrize("path", [pytest.param(x, marks=[pytest.mark.long] * (x not in QUICK)) for x in PRINTED])
def test_a_script_prints_its_numbers_and_draws_its_pictures(ran, path):
    _, out, pictures = ran(f"{path}.py")
    printed, (drawn, *words) = " ".join(out.split()), PRINTED[path]
    assert ([one for one in words if one not in printed], len(pictures)) == ([], drawn)


@pytest.mark.long
def test_own_controller(ran):
    found, out, pictures = ran("designs/own_controller.py", runs=8)
    assert (found["check"].verdict, found["check"].usable_from_kmh) == ("robust", 10)
    assert found["loop"].margins().ms == pytest.approx(1.920, abs=1e-3)
    assert found["check"].worst_with_tolerances.ms == pytest.approx(4.02, abs=0.01)
    assert found["stop"].braking_distance == pytest.approx(321.4, abs=0.1)
    medians = [one.measures["braking_distance_m"].quantiles[0.5].value for one in found["many"].controllers.values()]
    assert medians == pytest.approx([321.0, 315.5], abs=0.2)  # of 200 runs; those of 8 differ by less
    assert (len(pictures), "robust: Ms 1.92" in out) == (4, True)
    assert len((ROOT / "designs" / "own_controller.py").read_text().splitlines()) <= 40


@pytest.mark.long
def test_seeking_campaign(capsys, monkeypatch):
    module = script("analysis/seeking_campaign.py")
    stops = module.run((50, 51))
    believed = [stop for stop in stops if stop.law in ("curve", "bristle", "beam") and stop.brake == 1.0]
    assert np.median([stop.over for stop in believed]) < 7.0
    assert max(stop.over for stop in believed) < 13.0
    # bristles swing, in slip the more the slower the train is, and lock at last; curve does with a slow brake
    assert not any(stop.locked_at_kmh > 6 for stop in stops if stop.law in module.LAWS[:3])
    steep = [stop.over for stop in stops if (stop.law, stop.rails, stop.brake) == ("polach", "dry", 1.0)]
    assert np.median(steep) < 20.0  # 13 of these four stops; 35 where the end of the start sets no reference slip

    def again(seeds, controllers=("seeking",), laws=()):
        return [replace(stop, controller=name) for name in controllers for stop in stops]

    monkeypatch.setattr(module, "run", again)
    monkeypatch.setattr(module, "tolerated", lambda name: None)
    monkeypatch.setattr(sys, "argv", ["seeking_campaign.py", "2", "50"])
    module.main()
    assert capsys.readouterr().out.count("\n") == 2 + 6 + 1 + 3 * 7 + 1 + 25


# excess over the bound, %: median, 95 %, worst; highest slip; locked above 5 km/h, %; filled torque, kN*m; tolerances
SIDE_BY_SIDE = {
    "asmc": (21.9, 57.6, 79.5, 1.00, 24.0, 5.6, "-", "-", "-", "-"),
    "slide-protection": (73.8, 133.4, 173.6, 1.00, 30.9, 17.2, "-", "-", "-", "-"),
    "pi-lead": (16.6, 41.3, 47.9, 1.00, 11.6, 4.6, "0.45-3.05", "+-100 %", "+-91 %", "80 km/h"),
    "predictive": (14.8, 38.1, 44.1, 1.00, 0.8, 10.5, "0.26-2.11", "+-82 %", "+-55 %", "-"),
    "seeking": (6.1, 14.0, 33.0, 1.00, 0.0, 13.9, "0.24-2.17", "+-100 %", "+-56 %", "14 km/h"),
}


@pytest.mark.long
def test_controllers_side_by_side():
    """900 stops each, and the tolerances of the loops."""
    module = script("analysis/seeking_campaign.py")
    stops = module.run(range(10), controllers=module.CONTROLLERS, laws=module.LAWS[:3])
    for name, (*numbers, gain, dead_time, lag, start) in SIDE_BY_SIDE.items():
        found = module.numbers([stop for stop in stops if stop.controller == name])
        near = (0.2, 1.0, 3.0, 0.1, 0.5, 0.3)  # the rarest stops hang on the last digit of a sum
        for value, expected, most in zip((*found[:5], found[6]), numbers, near, strict=True):
            assert value == pytest.approx(expected, abs=max(most, 0.02 * expected)), name
        assert module.cells(module.tolerated(name)) == (gain, dead_time, lag, start), name


@pytest.mark.long
def test_seeking(ran):
    found, _, pictures = ran("designs/seeking.py")
    # the certified bounds are one rounding apart, as is the floating-point number from them
    assert found.certified_ms[0] * (1 - 1e-12) <= found.judgement.worst.ms <= found.certified_ms[1] * (1 + 1e-12)
    rows = {(row.law, row.rail): row for row in found.rows}
    assert rows["curve", "dry"].distance == pytest.approx(141.8, abs=1.0)  # of one seed
    assert rows["curve", "wet"].distance == pytest.approx(256.6, abs=1.5)
    for row in found.rows:
        assert row.bound < row.attainable < row.distance < 1.09 * row.attainable  # of one seed; 1.08 on beam wet
    assert (found.certified_ms[0], found.judgement.worst.ms) == pytest.approx((1.92538, 1.92538), abs=1e-5)
    assert (found.judgement.verdict, len(pictures)) == ("robust", 1)


@pytest.mark.long
def test_from_log(ran, tmp_path):
    result, out, pictures = ran("designs/from_log.py")
    module = script("designs/from_log.py")
    truth, fit, held = module.TRUE_LAW, result.found.chosen.fit, result.held
    assert (fit.model.name, len(result.true_margins)) == (truth.name, 12)
    assert all(p.interval[0] <= getattr(truth, p.name) <= p.interval[1] for p in fit.parameters)
    assert all(p.stderr < 0.06 * p.value for p in fit.parameters)
    # the slip held is on the rise, for the true law too, and gives away little of its adhesion
    slips = np.linspace(0.01, 0.5, 4000)
    mu = truth.c1 * (1.0 - np.exp(-truth.c2 * slips)) - truth.c3 * slips  # [Burckhardt]'s closed form
    assert held.dry < slips[np.argmax(mu)]
    assert np.interp(held.dry, slips, mu) > 0.97 * mu.max()
    # the design was made for a family that holds the true plants, pole by pole, and keeps its promise on them
    poles = [float(plant.poles[0].real) for plant in result.plants]
    assert (len(poles), min(poles[-7:]) > 0.0, max(poles) - min(poles) > 1.0) == (7 * 12 + 7, True, True)
    assert max(margins.ms for margins in result.design.margins) <= module.MS_MAX * (1 + 1e-6)
    assert max(margins.ms for margins in result.true_margins) <= module.MS_MAX
    # past the peak the unstable pole grows as the train slows down: the loop holds it at speed, and not near the end
    assert 2.0 < result.slowest_falling < 50.0
    # stops on the true law, dry then wet: on dry rail, once the brake is filled, nearly all of its adhesion
    for run in result.runs:
        time, slip, dry = run.signals.time, run.signals.slip, run.signals.time < module.RAIN
        assert np.interp(slip[(time > 2.0) & dry], slips, mu).mean() > 0.95 * mu.max()
        assert (run.stopped, slip[dry].max() < 1.6 * held.dry) == (True, True)  # its overshoot, past the peak, and back
        assert np.abs(slip[time > module.RAIN + 6.0] - held.wet).mean() < 0.03
    assert "On the true law the worst Ms is" in out
    assert pictures == {"from_log_adhesion.png", "from_log_stop.png"}
    assert load_law(tmp_path / "model.toml").on(Rail.DRY) == fit.law.model_copy(update={"reference": held})
