"""The conditions of the sliding-mode law: verdicts, their numbers, and that a changed plant changes them."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from project import script, show
from sliding_cases import AS_PUBLISHED

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.parameters import PARK2008
from railslip_ctrl.paper.errata import errata
from railslip_ctrl.report import plots
from railslip_ctrl.report.verification import verification_text
from railslip_ctrl.sliding.code_python import NOT_HOLDING
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.law import PUBLISHED_LAW, LawGains
from railslip_ctrl.verification.ideal_loop import Disturbances, simulate
from railslip_ctrl.verification.joint_verification import FullVerification, verify
from railslip_ctrl.verification.published_law import ultimate_bound
from railslip_ctrl.verification.reaching import SEARCHED, approach, points_of, true_theta
from railslip_ctrl.verification.robust import (
    boundary_layer,
    boundary_layer_bound,
    boundary_layer_runs,
    dead_zone,
    dead_zone_condition,
    effective_torque,
    gain_units,
    largest_cross_term,
    layer_bound,
    layered_design,
    leak,
    leak_bound,
    leaking_design,
    matrix_gain,
    parameter_box,
    projected,
    projection,
    robust_set,
)

VERDICTS = {
    "derivation": True,
    "V positive definite": True,
    "V' identity": True,
    "closed loop identity": True,
    "V' <= 0, ideal": True,
    "V' <= 0, disturbed": False,
    "Barbalat, ideal": True,
    "invariant-set theorem": False,
    "theta_hat converges": False,
    "scalar gain k": False,
    "reaching condition (40)": False,
    "s s' < -eta |s| over the box": False,
    "sliding reached and kept": False,
    "boundary layer with K": False,
    "theta constant": False,
    "theta_hat bounded under noise": False,
    "matrix gain": True,
    "robust gain": True,
    "robust gain, search": True,
    "robust gain, rail mistaken": False,
    "boundary layer, bound": True,
    "boundary layer, runs": True,
    "dead zone in the adaptation": True,
    "projection": True,
    "projection, samples": True,
    "layer, dead zone, projection: runs": True,
    "sigma-modification, bound": True,
    "sigma-modification, runs": True,
}


@pytest.fixture(scope="module")
def paper():
    return verify()


@pytest.fixture(scope="module")
def as_published():
    return verify(vehicle=AS_PUBLISHED)


# --- verdicts -------------------------------------------------------------------------------------------------------


def test_verdicts_of_the_published_law(paper):
    assert {one.name: one.holds for one in paper.conditions} == VERDICTS
    assert not paper.all_hold
    assert {one.how for one in paper.conditions} == {"symbolic", "sampled", "simulated"}
    claimed = {one.name for one in paper.failing if one.claimed}
    assert claimed == {name for name, holds in VERDICTS.items() if not holds} - {
        "boundary layer with K",
        "theta_hat bounded under noise",
        "robust gain, rail mistaken",
    }


def test_the_head_of_generated_code_names_the_conditions_that_do_not_hold(paper):
    """The published law's, which stand before the variants'; those behind the actuator: test_sliding_verification."""
    published = list(VERDICTS)[: list(VERDICTS).index("matrix gain")]
    failing = [name for name in published if not paper[name].holds]
    assert failing == [name for name in NOT_HOLDING if "actuator" not in name]


def test_report_shows_every_condition_and_lists_the_failed_claims(paper):
    text = verification_text(paper)
    for one in paper.conditions:
        assert f"{one.name}: {'holds' if one.holds else 'DOES NOT HOLD'} ({one.how})" in text
    assert "Verdict: 11 of 28 conditions do not hold." in text
    assert "Claimed or relied on by [Park2008]:\n  - V' <= 0, disturbed" in text
    assert max(map(len, text.splitlines())) <= 110


def test_numbers_in_the_evidence(paper):
    reaching = paper["reaching condition (40)"].evidence
    for number in ("484.5 N m, 6.92 times K", "221.9 N m", "910.6 N m", "627.0 N m", "550.5 N m", "656.7 N m"):
        assert number in reaching
    row = next(row for row in errata(derive()) if row.where == "(40) with Table 4")
    for text in (reaching, row.sign_and_size):  # one statement in both places
        assert "75.2 m/s" in text
        assert "27.6 m/s" in text
    assert "seeds 2008 to 2015" in paper["sliding reached and kept"].evidence
    assert "1.157 m^2/s^2" in paper["theta constant"].evidence  # SI
    assert "0.08929 m^2/s^2" in paper["theta constant"].evidence  # as published
    with pytest.raises(KeyError):
        paper["no such condition"]


def test_a_gain_above_the_bound_makes_the_reaching_condition_hold():
    strong = verify(law="robust", K=1540.0)
    assert [one.name for one in strong.failing] == ["robust gain, rail mistaken"]
    assert verify(law="robust", K=4000.0).all_hold
    # enough for exact estimates, not for an adhesion torque that is wrong by a tenth
    weak = verify(law="robust", K=1077.2)
    assert not weak["robust gain"].holds
    assert weak["robust gain"].tolerated["Ta_hat"] == pytest.approx(0.0185, abs=1e-4)
    assert "Tolerated, each alone: Ta_hat +-1.85 %" in verification_text(weak)
    assert not weak["robust gain, search"].holds
    assert not weak["boundary layer, bound"].holds
    assert not weak["sigma-modification, bound"].holds
    assert not weak["sigma-modification, runs"].holds  # below a bound that is not proved is no promise
    assert weak["projection"].holds


def test_as_published_the_verdicts_are_the_same(as_published):
    assert {one.name: one.holds for one in as_published.conditions} == VERDICTS
    assert as_published.inertia_scale == 3.6
    assert "25.62 km/h" in as_published["theta constant"].evidence


def test_without_a_bound_the_runs_do_not_keep_it():
    """K = 0: (J/r) d_max/D is 178 m/s, six times the train's speed, and every run stays below that."""
    gains = layered_design(PARK2008, K=0.0)
    found = boundary_layer_runs(PARK2008, gains, effective_torque(PARK2008), (1,))
    assert not found.holds
    assert "no bound within the layer" in found.evidence
    assert "K + D Phi is less" in boundary_layer_bound(gains, effective_torque(PARK2008)).evidence


def test_dead_zone_needs_the_box_its_bound_is_over():
    gains, largest = layered_design(PARK2008), effective_torque(PARK2008)
    found = dead_zone_condition(gains, largest)
    assert found.holds
    assert not dead_zone_condition(replace(gains, box=None), largest).holds


# --- robust variants ------------------------------------------------------------------------------------------------


def test_robust_derivations_are_proved():
    for variant in (boundary_layer(), dead_zone(), projection(), leak(), matrix_gain()):
        assert variant.proved, variant.name
    assert gain_units() == ("kg^-2 m^-4 s^2", "1")


def test_layer_bound_is_reached_by_a_constant_disturbance():
    gains = layered_design(PARK2008)
    largest = effective_torque(PARK2008)
    J, r = PARK2008.wheel.inertia, PARK2008.wheel.radius
    s, h = 2.0, 1e-4
    for _ in range(100_000):
        s += h * r / J * (largest - gains.D * s - gains.K * np.clip(s / gains.layer, -1, 1))
    assert s == pytest.approx(layer_bound(gains, largest), rel=1e-6)
    assert ultimate_bound(largest, gains, gains.layer) == pytest.approx(s, rel=1e-6)


def test_without_the_gain_the_layer_bound_is_that_of_D_alone():
    assert ultimate_bound(461.3, PUBLISHED_LAW, 0.2) == pytest.approx((461.3 - 70.0) / PUBLISHED_LAW.D)


def test_projection_is_needed_and_never_raises_V():
    gains = layered_design(PARK2008)
    assert largest_cross_term(gains, seed=5) <= 0.0
    for theta in (true_theta(PARK2008, PARK2008), true_theta(PARK2008.loaded(), PARK2008)):
        assert all(low <= value <= high for value, (low, high) in zip(theta, gains.box, strict=True))
    rates = projected(np.array([1.0, 1.0, -1.0]), np.array([2.0, 1.0, 2.0]), np.zeros(3), np.full(3, 2.0))
    assert rates.tolist() == [0.0, 1.0, -1.0]


def test_projection_and_leak_hold_the_estimate_where_the_published_law_does_not():
    # an estimate far outside: with noise it stays where s does not see it, projected or leaking it comes back
    noise = Disturbances(slip_noise=0.1)
    far = (0.0, 0.05)
    common = {"duration": 4.0, "held_speed": 100 / 3.6, "disturbances": noise, "start_estimate": far}
    box = parameter_box(PARK2008)
    free = simulate(PARK2008, replace(PUBLISHED_LAW, K=900.0), **common)
    boxed = simulate(PARK2008, replace(PUBLISHED_LAW, K=900.0, box=box), **common)
    leaking = simulate(PARK2008, leaking_design(PARK2008), **common)
    assert abs(free.theta_hat[-1, 0, 1] - 0.05) < 1e-3
    assert boxed.theta_hat[-1, 0, 1] <= box[1][1]
    assert leaking.theta_hat[-1, 0, 1] < 0.05 * math.exp(-0.9 * leaking_design(PARK2008).leak * 4.0)


def test_the_set_of_the_leak_is_invariant():
    """V(0) = s^2/2 + theta1^2/(2 k1) bounds |theta_tilde_i| by sqrt(2 k_i V(0)); on its edge no point has V' > 0."""
    gains = leaking_design(PARK2008)
    bound = leak_bound(PARK2008, gains)
    theta = np.array(true_theta(PARK2008.loaded(), PARK2008))
    start = 0.5 * (0.132 * 100 / 3.6) ** 2 + theta[0] ** 2 / (2 * 2.1e-8)
    assert bound.start == pytest.approx(start, rel=1e-12)
    assert effective_torque(PARK2008) < bound.gain < gains.K
    # V' = s s' + ... from the plant's own rates at random points of the edge, the loaded vehicle taken for empty
    k = np.array([gains.k1, gains.k2])[:, None]
    generator = np.random.default_rng(0)
    on_sphere = generator.standard_normal((3, 100_000))
    on_sphere *= np.sqrt(2 * start) / np.linalg.norm(on_sphere, axis=0)
    s, tilde = on_sphere[0], on_sphere[1:] * np.sqrt(k)
    hat = theta[:, None] - tilde
    shares = generator.integers(0, 2, (len(SEARCHED), s.size)).astype(float)
    shares[3] = 1.0
    points = points_of(robust_set(PARK2008), shares)
    points[6:8], points[-1] = hat, s
    slopes = [approach(points, PARK2008, gains, surface) for surface in (0.0, 1.0)]
    rate = np.abs(s) * (slopes[0] + np.abs(s) * (slopes[1] - slopes[0])) + gains.leak * np.sum(tilde * hat / k, axis=0)
    assert np.max(rate) < 0.0


def test_leak_bound():
    bound = leak_bound(PARK2008, leaking_design(PARK2008))
    theta = (1 / 5276 - 1 / 3517) / 0.43
    assert bound.level == pytest.approx(theta**2 / (2 * 2.1e-8), rel=1e-9)  # ell = c
    assert bound.surface == pytest.approx(math.sqrt(2 * bound.level))


@pytest.mark.parametrize(
    ("change", "word"), [({"K": -1.0}, "K"), ({"D": 0.0}, "D"), ({"rho": math.nan}, "rho"), ({"leak": -1.0}, "leak")]
)
def test_gains_are_checked(change, word):
    with pytest.raises(InputError, match=f"^{word}: "):
        LawGains(**{"K": 1.0, "D": 1.0, "rho": 1.0, **change})


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"K": -1.0}, "K: -1 is not allowed"),
        ({"K": 1e9}, "K: 1e\\+09"),
        ({"D": 0.0}, "D: 0 "),
        ({"seed": -1}, "seed: -1"),
        ({"vehicle": PARK2008.model_copy(update={"inertia_scale": 100.0})}, "inertia scale: 100"),
        ({"law": "theirs"}, "law: 'theirs'"),
    ],
)
def test_verify_checks_its_arguments(arguments, word):
    with pytest.raises(InputError, match=word):
        verify(**arguments)


# --- command --------------------------------------------------------------------------------------------------------


def test_json_of_the_robust_law(railslip):
    status, out, err = railslip("verify", "--law", "robust", "--seed", "7", "--json")
    assert (status, err) == (1, "")
    content = json.loads(out)
    assert set(content) == {"conditions", "all_hold"}
    assert content["all_hold"] is False
    for one in content["conditions"]:
        assert set(one) == {"name", "statement", "holds", "how", "evidence", "down_to_kmh", "tolerated_errors"}
        assert one["how"] in ("symbolic", "sampled", "simulated")
        assert one["holds"] is not any(words in one["name"] for words in ("behind the actuator", "mistaken"))
    gain = next(one for one in content["conditions"] if one["name"] == "robust gain")
    assert gain["down_to_kmh"] == 5.0
    assert gain["tolerated_errors"]["Ta_hat"] > 0.1


def test_the_published_law_exits_with_1(railslip, monkeypatch, paper):
    full = FullVerification(paper, (), "")
    monkeypatch.setattr("railslip_ctrl.cli.verify.verify_with_actuator", lambda **_: full)
    status, out, err = railslip("verify", "--json")
    assert (status, err) == (1, "")
    content = json.loads(out)
    assert {one["name"]: one["holds"] for one in content["conditions"]} == VERDICTS
    assert content["all_hold"] is False
    status, out, _err = railslip("verify")
    assert status == 1
    assert out.startswith("Conditions of the sliding-mode law")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--law", "theirs"), ("--law", "theirs", "paper, robust, layered")),
        (("--K", "-3"), ("--K", "-3", ">= 0")),
        (("--K", "1e6"), ("--K", "1e+06", "10000")),
        (("--K", "5 kg"), ("--K",)),
        (("--D", "0"), ("--D", "> 0")),
        (("--law", "layered", "--D", "3"), ("--D: 3", "layered law has no D")),
        (("--D", "0.01"), ("--D", "0.01", "0.1", "N*m/(m/s)")),
        (("--law", "layered", "--K", "0"), ("--K: 0 is not allowed", "> 0 up to 10000 (N*m)")),
        (("--inertia-scale", "50"), ("--inertia-scale", "50", "10")),
        (("--inertia-scale", "nan"), ("--inertia-scale",)),
        (("--seed", "-1"), ("--seed", "-1", "whole number")),
        (("--seed", "1.5"), ("--seed", "1.5")),
        (("--seed", "99999999999999"), ("--seed", "2147483648")),
    ],
)
def test_bad_options_are_one_line_and_exit_2(railslip, arguments, words):
    status, out, err = railslip("verify", *arguments)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    for word in words:
        assert word in err


def test_help_says_what_is_allowed(railslip):
    status, out, _ = railslip("verify", "--help")
    words = " ".join(out.split())
    assert status == 0
    for text in ("N*m, 0 to 10000; of the layered law > 0", "N*m/(m/s), 0.1 to 10000", "M, J and B, 0.5 to 10"):
        assert text in words


def test_layered_law_without_K_is_refused_before_any_work(railslip, monkeypatch):
    monkeypatch.setattr("railslip_ctrl.cli.verify.verify_with_actuator", None)
    status, out, err = railslip("verify", "--law", "layered", "--K", "0")
    assert (status, out) == (2, "")
    assert err.startswith("railslip: --K: 0") or "--K: 0" in err


# --- scripts --------------------------------------------------------------------------------------------------------


def test_lyapunov_asmc(tmp_path, capsys, monkeypatch, paper, as_published):
    module = script("analysis/lyapunov_asmc.py")
    monkeypatch.setattr(module, "verify", lambda vehicle, seed: paper if vehicle == PARK2008 else as_published)
    si, published = module.run()
    for result in (si, published):
        assert result.largest_rise(result.ideal) < 1e-4
        assert result.largest_rise(result.disturbed) > 1e-2
    drawn = []
    save = plots.save_figure
    monkeypatch.setattr(plots, "save_figure", lambda figure, path: (drawn.append(figure), save(figure, path)))
    show(module, (si, published), tmp_path, monkeypatch)
    assert (tmp_path / "lyapunov_asmc.png").exists()
    out = capsys.readouterr().out
    assert "Without the actuator 11 of 28 conditions do not hold in SI" in out
    assert "As published (M, J and B times 3.6) the same fail." in out
    assert max(map(len, out.splitlines())) <= 110
    assert out.count("V along an ideal stop") == 2
    # the published mass step: in SI the stop is over, as published V jumps by what verify says
    assert si.stepped is None
    i = np.searchsorted(published.stepped.time, 25.0 - 1e-9)
    hat, theta = published.stepped.theta_hat[i, 0, 0], published.stepped.theta[0]
    # theta2 does not change; theta1 was 0
    assert published.jump() == pytest.approx(((theta - hat) ** 2 - hat**2) / (2 * 2.1e-8), rel=1e-2)  # s moves on too
    assert "0.08929" in paper["theta constant"].evidence
    told = f"V jumps by {published.jump():+.4f} m^2/s^2 (with theta_hat = theta before it: +0.0893)"
    assert told in " ".join(out.split())
    assert 0 < si.plateau() < 1e-3 * si.ideal.V[0, 0]
    labels = [text.get_text() for axes in drawn[0].axes for text in axes.get_legend().get_texts()]
    assert "3517 kg, 5276 kg from 25 s on, undisturbed" in labels
    assert all("law's mass 3517 kg, theta_hat from 0" in axes.get_title() for axes in drawn[0].axes)
    assert all("plateau" in axes.texts[0].get_text() for axes in drawn[0].axes)
