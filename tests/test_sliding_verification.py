"""The conditions with the actuator, through the command."""

from __future__ import annotations

import json

import pytest

from railslip_ctrl.cli import main
from railslip_ctrl.parameters import PARK2008
from railslip_ctrl.sliding_verification import verify_with_actuator

ACTUATOR_CONDITIONS = [
    "sliding exists behind the actuator",
    "the limit cycle behind the actuator spares the wheel",
    "the adaptive loop is stable behind the actuator",
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
    assert [conditions[name].holds for name in ACTUATOR_CONDITIONS] == [False, False, False]
    assert all(conditions[name].claimed for name in ACTUATOR_CONDITIONS)
    assert "2 unstable poles (ideal actuator: 0)" in conditions[ACTUATOR_CONDITIONS[2]].evidence
    dry, wet = published.effects
    assert dry.cycles[0].exact.period == pytest.approx(4.12, abs=5.1e-3)
    assert (dry.holds_the_wheel, wet.holds_the_wheel) == (False, True)


def test_conclusion_speaks_of_what_was_found(published):
    dry = published.effects[0]
    for number in (f"{dry.cycles[0].exact.period:.2f} s", f"{dry.survivors.k:.3g}", f"{dry.survivors.rho:.3g} 1/s"):
        assert number in published.conclusion
    assert "So: replace the relay by a boundary layer" in published.conclusion


def test_as_published_the_wheel_is_spared_but_sliding_does_not_exist():
    vehicle = PARK2008.model_copy(update={"inertia_scale": 3.6})
    conditions = {c.name: c.holds for c in verify_with_actuator(vehicle=vehicle).verification.conditions}
    assert [conditions[name] for name in ACTUATOR_CONDITIONS] == [False, True, True]


def test_command_prints_the_conditions_and_the_conclusion(capsys):
    status, out = run(capsys)
    assert status == 1
    assert "Conclusion for the brake with its actuator" in out
    status, out = run(capsys, "--json")
    content = json.loads(out)
    assert (status, content["all_hold"]) == (1, False)
    assert [c["name"] for c in content["conditions"]][-3:] == ACTUATOR_CONDITIONS


def test_robust_variants_hold_and_have_no_actuator_conditions(capsys):
    status, out = run(capsys, "--law", "robust", "--json")
    content = json.loads(out)
    assert (status, content["all_hold"]) == (0, True)
    assert not {c["name"] for c in content["conditions"]} & set(ACTUATOR_CONDITIONS)


def test_robust_variants_are_not_passed_off_as_fit_for_the_actuator():
    full = verify_with_actuator(law="robust")
    assert full.verification.all_hold
    assert "dry: UNSTABLE" in full.conclusion
    assert "designs/asmc_robust.py" in full.conclusion


def test_plain_text_of_errata_keeps_tildes_fractions_and_no_latex():
    from railslip_ctrl.sliding.derivation import derive
    from railslip_ctrl.sliding.errata import errata

    for row in errata(derive()):
        for text in (row.printed, row.derived):
            assert not set(text) & set("{}\\"), text
