"""The conditions with the actuator, through the command."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from railslip_ctrl.cli import main
from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters import PARK2008, Actuator, Rail
from railslip_ctrl.sliding.gains import PUBLISHED_LAW
from railslip_ctrl.sliding_verification import verify_with_actuator
from railslip_ctrl.sliding_verification.layered import (
    bounds_kept,
    held_under_published_disturbances,
    held_while_the_speed_falls,
    layered_design,
    layered_stability,
    rail_bounds,
    rail_plants,
)
from railslip_ctrl.sliding_verification.published import published_behind_actuator
from railslip_ctrl.sliding_verification.variants import variants_behind_actuator
from railslip_ctrl.switching import SlidingGains, largest_adaptation, layer_bound, published_loop

ACTUATOR_CONDITIONS = [
    "sliding exists behind the actuator",
    "the limit cycle behind the actuator spares the wheel",
    "the adaptive loop is stable behind the actuator",
]

BEHIND = ["the layer is stable behind the actuator", "the relay slides behind the actuator"]
LAYERED = [
    "layer stable behind the actuator",
    "bound with the actuator",
    "authority",
    "bounds kept, simulated",
    "published disturbances, simulated",
    "speed falling, simulated",
]


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as caught:
        main(["verify", *arguments])
    return caught.value.code, capsys.readouterr().out


@pytest.fixture(scope="module")
def published():
    return verify_with_actuator()


def test_published_law_fails_behind_its_actuator_in_si(published):
    conditions = {c.name: c for c in published.verification.conditions}
    # the relay's cycle takes the slip to 0.233 on dry rail, less than twice the reference, with the adaptation off
    assert [conditions[name].holds for name in ACTUATOR_CONDITIONS] == [False, True, False]
    assert all(conditions[name].claimed for name in ACTUATOR_CONDITIONS)
    assert "2 unstable poles (ideal actuator: 0)" in conditions[ACTUATOR_CONDITIONS[2]].evidence
    dry, wet = published.effects
    assert dry.cycles[0].linear.period == pytest.approx(4.12, abs=5.1e-3)
    assert (dry.cycles[0].linear_holds, wet.cycles[0].linear_holds) == (False, True)


def test_conclusion_speaks_of_what_was_found(published):
    dry = published.effects[0]
    for number in (dry.cycle_text, f"{dry.survivors.k:.3g}", f"{dry.survivors.rho:.3g} 1/s"):
        assert number in published.conclusion
    assert "So: replace the relay by a boundary layer" in published.conclusion


def test_as_published_the_wheel_is_spared_but_sliding_does_not_exist():
    vehicle = PARK2008.model_copy(update={"inertia_scale": 3.6})
    found, _effects, _told = published_behind_actuator(PUBLISHED_LAW.K, PUBLISHED_LAW.D, vehicle)
    assert [(one.name, one.holds) for one in found] == list(zip(ACTUATOR_CONDITIONS, (False, True, True), strict=True))


def test_command_prints_the_conditions_and_the_conclusion(capsys, monkeypatch, published):
    monkeypatch.setattr("railslip_ctrl.cli.verify.verify_with_actuator", lambda **_: published)
    status, out = run(capsys)
    assert status == 1
    assert "Conclusion for the brake with its actuator" in out
    status, out = run(capsys, "--json")
    content = json.loads(out)
    assert (status, content["all_hold"]) == (1, False)
    assert [c["name"] for c in content["conditions"]][-3:] == ACTUATOR_CONDITIONS


def test_the_conclusion_tells_how_near_the_as_published_adaptation_is_to_unstable(published):
    told = " ".join(published.conclusion.split())
    for rail, adhesion in ((rail, adhesion) for rail in Rail for adhesion in ("bristle", "curve")):
        loop = published_loop(rail, inertia_scale=3.6, adhesion=adhesion)
        ratio = largest_adaptation(loop) / 2.1e-8
        assert f"{adhesion} {rail} {ratio:.2f}" in told
        # the number itself, by the exact root count on either side
        assert loop.is_stable(adaptation=0.99 * ratio * 2.1e-8)
        assert not loop.is_stable(adaptation=1.01 * ratio * 2.1e-8)
    assert "bristle dry 1.05" in told


def test_robust_variants_are_not_passed_off_as_fit_for_the_actuator(capsys):
    status, out = run(capsys, "--law", "robust")
    assert status == 1
    assert "Verdict: 2 of 13 conditions do not hold." in out
    assert "railslip verify --law layered" in " ".join(out.split())
    full = verify_with_actuator(law="robust")
    assert [one.name for one in full.verification.failing] == BEHIND
    assert all(one.holds for one in full.verification.conditions if one.name not in BEHIND)
    assert "dry: UNSTABLE, stable up to K = 3.121 N m" in full.verification[BEHIND[0]].evidence
    # a K that the layer carries behind the actuator is far below what (40) asks: no K does both
    (layer, _relay), told = variants_behind_actuator(3.0, PUBLISHED_LAW.D, PARK2008)
    assert layer.holds
    assert "at most K = 3.121 N m on both rails, while the reaching condition asks more than 979.3 N m" in told


def test_the_largest_k_of_the_layer_is_the_edge_of_stability():
    loop = published_loop(Rail.DRY)
    bare = replace(loop, gains=SlidingGains(K=0.0, D=5.508, rho=1.54))
    assert bare.is_stable(relay_gain=0.99 * 3.121 / 0.2)
    assert not bare.is_stable(relay_gain=1.01 * 3.121 / 0.2)


def test_without_actuator_the_variants_keep_their_promise():
    ideal = PARK2008.model_copy(update={"actuator": Actuator(dead_time=0.0, lag=0.0)})
    full = verify_with_actuator(law="robust", vehicle=ideal)
    assert full.verification.all_hold
    assert full.conclusion == "The variants keep their promise with this actuator too."


# --- the layered law ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def layered():
    return verify_with_actuator(law="layered")


def test_the_layered_law_holds_behind_the_actuator(layered, capsys):
    assert [one.name for one in layered.verification.conditions] == LAYERED
    assert layered.verification.all_hold
    assert {one.how for one in layered.verification.conditions} == {"sampled", "simulated"}
    status, out = run(capsys, "--law", "layered", "--json")
    assert (status, json.loads(out)["all_hold"]) == (0, True)
    assert "|sigma error| below 0.209 m/s" in " ".join(layered.conclusion.split())


def test_numbers_of_the_layered_law_are_those_of_the_bound(layered):
    design = layered_design(PARK2008)
    for rail, plant in rail_plants(PARK2008).items():
        bound = layer_bound(design, plant, PARK2008.actuator, 20.0)
        assert (
            f"{rail}: |sigma error| <= {bound.error:.3f} m/s"
            in layered.verification["bound with the actuator"].evidence
        )
    assert pytest.approx(design.K) == layered.verification.K
    assert layered.verification.D is None


def test_too_little_authority_fails_and_says_how_much_is_needed(capsys):
    status, out = run(capsys, "--law", "layered", "--K", "100")
    assert status == 1
    words = " ".join(out.split())
    assert "authority: DOES NOT HOLD" in words
    assert "Remedy: give K >= 434 N m." in words
    barely = verify_with_actuator(law="layered", K=435.0).verification
    assert barely["authority"].holds


def test_a_light_train_has_no_bound_and_verify_says_so(capsys):
    status, out = run(capsys, "--law", "layered", "--inertia-scale", "0.5")
    assert status == 1
    assert "outgrows the loop" in " ".join(out.split())


def test_a_loop_that_is_unstable_in_the_layer_is_found():
    design = replace(layered_design(PARK2008), kp=5000.0)
    found = layered_stability(design, PARK2008)
    assert not found.holds
    assert "dry, 100 km/h, empty" in found.evidence


def test_simulations_that_leave_the_domain_fail_their_conditions():
    design = replace(layered_design(PARK2008), K=1.0, kp=5.0)
    found = [held_under_published_disturbances(design, PARK2008, 1), held_while_the_speed_falls(design, PARK2008)]
    assert [one.holds for one in found] == [False, False]


def test_bounds_that_a_simulation_breaks_are_not_kept():
    design = layered_design(PARK2008)
    bounds = rail_bounds(design, PARK2008)
    small = {
        rail: replace(one, at_rest=replace(one.at_rest, error=0.5 * one.at_rest.error)) for rail, one in bounds.items()
    }
    assert bounds_kept(design, bounds).holds
    assert not bounds_kept(design, small).holds
    lost = bounds_kept(replace(design, K=1.0), bounds)  # too weak for a wheel beyond the peak of its adhesion
    assert not lost.holds
    assert "is outside 0 to v" in lost.evidence


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"law": "layered", "D": 3.0}, "D: 3 is not allowed"),
        ({"law": "theirs"}, "'theirs' is not known"),
        ({"law": "layered", "K": -1.0}, "K: -1 is not allowed"),
    ],
)
def test_arguments_are_checked(arguments, words):
    with pytest.raises(InputError, match=words):
        verify_with_actuator(**arguments)


def test_plain_text_of_errata_keeps_tildes_fractions_and_no_latex():
    from railslip_ctrl.sliding.derivation import derive
    from railslip_ctrl.sliding.errata import errata

    for row in errata(derive()):
        for text in (row.printed, row.derived):
            assert not set(text) & set("{}\\"), text
