"""The conditions of the sliding-mode law: verdicts, their numbers, and that a changed plant changes them."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from project import script, show

from railslip_ctrl import plant, plots
from railslip_ctrl.errors import DomainError, InputError
from railslip_ctrl.parameters import PARK2008
from railslip_ctrl.report.verification import verification_text
from railslip_ctrl.sliding import reaching_bound, robust
from railslip_ctrl.sliding.closed_loop_samples import AXES, operating_box, surface_rate, worst_point
from railslip_ctrl.sliding.conditions import verify
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.errata import errata
from railslip_ctrl.sliding.gains import PUBLISHED_LAW, LawGains
from railslip_ctrl.sliding.ideal_loop import Disturbances, simulate, true_theta
from railslip_ctrl.sliding.reaching_bound import (
    holding_torque,
    least_gain,
    operating_set,
    reaching_time,
    reference_set,
    reference_slip,
    rest_adhesion_torque,
    surface_needed,
)
from railslip_ctrl.sliding.reaching_conditions import (
    Drift,
    drift,
    measured_drift,
    parameter_step,
    reaching_simulated,
    ultimate_bound,
)
from railslip_ctrl.sliding.reaching_search import approach, search
from railslip_ctrl.sliding.robust import (
    boundary_layer,
    dead_zone,
    design_gain,
    effective_disturbance,
    effective_torque,
    gain_units,
    layered_design,
    leak,
    leaking_design,
    matrix_gain,
    parameter_box,
    projection,
    robust_set,
)
from railslip_ctrl.sliding.robust_conditions import (
    boundary_layer_bound,
    boundary_layer_runs,
    dead_zone_condition,
    largest_cross_term,
    layer_bound,
    leak_bound,
    projected,
)
from railslip_ctrl.sliding_verification import FullVerification

AS_PUBLISHED = PARK2008.model_copy(update={"inertia_scale": 3.6})

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
    }


def test_report_shows_every_condition_and_lists_the_failed_claims(paper):
    text = verification_text(paper)
    for one in paper.conditions:
        assert f"{one.name}: {'holds' if one.holds else 'DOES NOT HOLD'} ({one.how})" in text
    assert "Verdict: 10 of 27 conditions do not hold." in text
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
    strong = verify(law="robust", K=985.0)
    assert strong.all_hold
    assert "all 11 conditions hold" in verification_text(strong)
    # 870 N m is above 866.4, what Td = 0.05 of the holding torque would ask at the reference
    weak = verify(law="robust", K=870.0)
    assert not weak["robust gain"].holds
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
    assert "the dead zone alone would not" in found.evidence
    assert not dead_zone_condition(replace(gains, box=None), largest).holds


# --- the bound on K -------------------------------------------------------------------------------------------------


def test_least_gain_by_hand():
    # [Tr (1 + J/(r^2 M)) + J Fr/(r M) + c Ueq]/(1 - c), published numbers, 1 sigma; Ueq (36) at e = 0
    J, r, M, c, v = 60.35, 0.43, 3517.0, 0.05, 100 / 3.6
    Tr, Fr, sigma = 0.43 * 431, 0.63 * v**2, 0.132 * v
    box = reference_set(PARK2008, sigmas=1.0)
    Ta = box.adhesion_torque[0]
    v_rate = -(Ta / r + Fr + Tr / r) / M
    Ueq = J / r * (0.132 * v_rate + (1 / (r * M) + r / J) * Ta) - 0.25 * (v - sigma) / r
    without = Tr * (1 + J / (r**2 * M)) + J / (r * M) * Fr
    assert least_gain(PARK2008, reference_set(PARK2008, sigmas=1.0, with_torque=False)) == pytest.approx(
        without, rel=1e-12
    )
    assert least_gain(PARK2008, box) == pytest.approx((without + c * Ueq) / (1 - c), rel=1e-12)
    # D |s| helps in full, eta costs J/r over 1 - c
    moved = least_gain(PARK2008, box, D=5.0, surface=2.0, eta=0.3)
    assert moved == pytest.approx((without + c * Ueq + 0.3 * J / r) / (1 - c) - 5.0 * 2.0, rel=1e-12)
    assert least_gain(PARK2008, box, D=100.0, surface=50.0) == 0.0
    assert surface_needed(PARK2008, box, K=70.0, D=5.0) == pytest.approx(((without + c * Ueq) / (1 - c) - 70.0) / 5.0)
    assert surface_needed(PARK2008, box, K=900.0, D=5.0) == 0.0


def test_an_error_costs_its_part_of_the_feedback():
    # e > 0 at the same Ta: c/(1 - c) (J/r)(rho e), and B/r e less wheel speed
    box = reference_set(PARK2008, sigmas=1.0)
    e, c, J, r = 2.0, 0.05, 60.35, 0.43
    slip = reference_slip() - e / box.speed[0]
    moved = least_gain(PARK2008, replace(box, slip=(slip, slip)), rho=1.54)
    rest = least_gain(PARK2008, box, rho=1.54)
    assert moved - rest == pytest.approx(c / (1 - c) * (J / r * 1.54 - 0.25 / r) * e, rel=1e-9)
    assert box.error(reference_slip()) == (0.0, 0.0)
    assert operating_set(PARK2008, sigmas=1.0).error(0.132) == pytest.approx((-0.132 / 3.6 * 100, 0.132 / 3.6 * 100))


@pytest.mark.parametrize("vehicle", [PARK2008, AS_PUBLISHED])
@pytest.mark.parametrize("surface", [0.0, 2.0])
@pytest.mark.parametrize("box", [robust_set, lambda vehicle: operating_set(vehicle, sigmas=1.0)])
def test_the_bound_is_tight_for_the_nonlinear_plant(vehicle, surface, box):
    """A K just below it has a counterexample, one just above none: searched, and at random points."""
    asked = box(vehicle)
    least = least_gain(vehicle, asked, D=PUBLISHED_LAW.D, surface=surface)
    below, above = (replace(PUBLISHED_LAW, K=factor * least) for factor in (0.999, 1.001))
    assert search(asked, vehicle, below, seed=3, surface=surface).excess > 0
    assert search(asked, vehicle, above, seed=3, surface=surface).excess < 0
    generator = np.random.default_rng(0)
    ends = [asked.speed, asked.slip, asked.adhesion_torque, asked.mass]
    ends += [(-x, x) for x in (asked.random_torque, asked.torque_fraction)]
    low, high = np.array([*ends, asked.theta_hat1, asked.theta_hat2, (-1.0, 1.0)]).T
    points = low[:, None] + (high - low)[:, None] * generator.random((9, 100_000))
    assert np.max(approach(points, vehicle, above, surface)) < 0


def test_the_effective_disturbance_is_what_the_bound_is_over():
    # d solved from s' against the bound's own formula: K_min is (J/r) d where s > 0 and q = -c
    expression = effective_disturbance()
    assert not {"s", "D", "K"} & {str(symbol) for symbol in expression.free_symbols}
    assert effective_torque(PARK2008) == pytest.approx(979.3, abs=0.05)
    assert design_gain(PARK2008) == pytest.approx(1.1 * effective_torque(PARK2008))
    assert effective_torque(PARK2008) > least_gain(PARK2008, operating_set(PARK2008, sigmas=3.0))  # theta_hat


def test_a_plant_for_which_the_bound_is_no_bound_is_refused(monkeypatch):
    made = derive()
    for module, function, term, words in (
        (reaching_bound, reaching_bound.required_gain, plant.Tr**2, "not affine"),
        (robust, robust.effective_disturbance, robust.s * plant.Tr, "depends on s, D or K"),
    ):
        changed = replace(made, error_dynamics=made.error_dynamics + term)
        monkeypatch.setattr(module, "derive", lambda changed=changed: changed)
        with pytest.raises(ArithmeticError, match=words):
            function.__wrapped__()


def test_holding_torque_is_the_adhesion_torque_less_what_slows_the_wheel():
    v = 100 / 3.6
    Ta = rest_adhesion_torque(PARK2008, v, reference_slip())
    a = (Ta / 0.43 + 0.63 * v**2) / 3517
    omega = (1 - 0.132) * v / 0.43
    # J omega' with lambda' = 0
    assert holding_torque(PARK2008, v) == pytest.approx(Ta - 0.25 * omega + 60.35 * (1 - 0.132) * a / 0.43, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"random_torque": -1.0}, "random_torque"),
        ({"torque_fraction": 1.0}, "torque_fraction: 1 is not allowed"),
        ({"slip": (0.2, 0.1)}, "slip"),
        ({"mass": (math.nan, 1.0)}, "mass"),
    ],
)
def test_sets_are_checked(change, word):
    with pytest.raises(InputError, match=f"^{word}"):
        replace(operating_set(PARK2008, sigmas=1.0), **change)


def test_reaching_time_is_the_simulated_one():
    exact = replace(PUBLISHED_LAW, k1=0.0, k2=0.0, K=400.0)
    run = simulate(PARK2008, exact, duration=5.0)
    expected = reaching_time(PARK2008, K=400.0, D=exact.D, start=float(run.s[0, 0]))
    crossed = run.time[np.argmax(run.s[:, 0] <= 0.0)]
    assert crossed == pytest.approx(expected, abs=0.01)  # five steps
    assert math.isinf(reaching_time(PARK2008, K=0.0, D=1.0, start=1.0))


# --- counterexample -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("estimated", [True, False])
def test_the_worst_point_really_violates_and_no_random_point_is_worse(estimated):
    box = operating_box(PARK2008)
    worst = worst_point(box, PARK2008, PUBLISHED_LAW, seed=3, estimated=estimated)
    low, high = np.array(box.bounds).T
    point = np.array(worst.point)
    assert np.all((point >= low) & (point <= high))
    s = point[-1]
    rate = surface_rate(point[:, None], PARK2008, PUBLISHED_LAW, estimated=estimated)[0]
    assert s * rate > 0
    assert np.sign(s) * rate == pytest.approx(worst.excess)
    others = low + (high - low) * np.random.default_rng(0).random((50_000, len(AXES)))
    others = np.vstack((others, list(itertools.product(*box.bounds)))).T
    values = np.sign(others[-1]) * surface_rate(others, PARK2008, PUBLISHED_LAW, estimated=estimated)
    assert np.max(values) <= worst.excess * 1.01  # the search stops within 1 % of the supremum


def test_a_large_gain_leaves_no_counterexample():
    strong = replace(PUBLISHED_LAW, K=3000.0)
    assert worst_point(operating_box(PARK2008), PARK2008, strong, seed=1).excess < 0


# --- simulation of the ideal loop -----------------------------------------------------------------------------------


def test_V_falls_in_the_ideal_loop_and_theta_need_not_converge():
    run = simulate(PARK2008.loaded(), PUBLISHED_LAW, nominal=PARK2008, duration=20.0)
    V = run.V[np.isfinite(run.V[:, 0]), 0]
    assert np.max(np.diff(V)) < 1e-4 * V[0]  # chatter of the sampled relay
    assert V[-1] < 1e-3 * V[0]
    alive = np.isfinite(run.theta_hat[:, 0, 1])
    left = run.theta - run.theta_hat[alive][-1, 0]
    assert abs(left[1]) > 1e-6  # theta2 = 0 was the initial estimate: it has been moved away from it, and stays away


def test_V_rate_of_a_run_converges_to_the_derived_one(monkeypatch):
    gains = replace(PUBLISHED_LAW, K=0.0)  # no chatter: V' = -D0 s^2
    errors = []
    for step in (0.002, 0.0005):  # the torque is held over a step, so the error is of first order in it
        monkeypatch.setattr("railslip_ctrl.sliding.ideal_loop.STEP", step)
        run = simulate(PARK2008, gains, duration=3.0)
        rate = np.gradient(run.V[:, 0], run.time)
        expected = -PARK2008.wheel.radius / PARK2008.wheel.inertia * gains.D * run.s[:, 0] ** 2
        errors.append(np.max(np.abs(rate - expected)[5:-5]))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_drift_is_the_predicted_one_and_needs_noise():
    found = measured_drift(PARK2008, PUBLISHED_LAW, tuple(range(16)))
    assert found.mean == pytest.approx(found.predicted, rel=0.05)
    assert abs(found.mean) > 10 * found.standard_error
    assert abs(found.noiseless) < 1e-3 * abs(found.mean)


def test_a_relay_that_chatters_adds_its_own_drift():
    found = measured_drift(PARK2008, replace(PUBLISHED_LAW, K=2000.0), (0, 1, 2))
    assert found.predicted == pytest.approx(found.mean, rel=0.05)
    assert abs(found.predicted) > 1.4 * 2.13e-13  # what the noise alone would give


def test_a_drift_that_the_prediction_misses_is_said_not_to_be_explained(monkeypatch):
    from railslip_ctrl.sliding import reaching_conditions

    found = Drift(-2e-13, -3e-13, 6e-16, 0.0, 1e-3)
    monkeypatch.setattr(reaching_conditions, "measured_drift", lambda *_: found)
    assert "which does not explain it" in drift(PARK2008, PUBLISHED_LAW, 1).evidence
    monkeypatch.setattr(reaching_conditions, "measured_drift", lambda *_: replace(found, predicted=-3e-13))
    assert "does not explain" not in drift(PARK2008, PUBLISHED_LAW, 1).evidence


@pytest.mark.parametrize("scale", [1.0, 3.6])
def test_step_of_V_at_25_s(scale):
    vehicle = PARK2008.model_copy(update={"inertia_scale": scale})
    step = parameter_step(vehicle, PUBLISHED_LAW)
    theta = (1 / 5276 - 1 / 3517) / scale / 0.43
    assert step.theta_step == pytest.approx(theta, rel=1e-12)
    assert step.jump == pytest.approx(theta**2 / (2 * 2.1e-8), rel=1e-12)
    assert (step.speed is None) == (scale == 1.0)


def test_a_diverging_run_leaves_the_domain():
    with pytest.raises(DomainError, match=r"^slip velocity: .* smaller gains$"):
        simulate(PARK2008, replace(PUBLISHED_LAW, D=1e8), duration=5.0)


def test_with_enough_gain_sliding_is_reached_and_kept():
    strong = replace(PUBLISHED_LAW, K=1000.0)
    assert reaching_simulated(PARK2008, strong, (1, 2)).holds


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
        assert set(one) == {"name", "statement", "holds", "how", "evidence"}
        assert one["how"] in ("symbolic", "sampled", "simulated")
        assert one["holds"] is ("behind the actuator" not in one["name"])


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
    assert "Without the actuator 10 of 27 conditions do not hold in SI" in out
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
