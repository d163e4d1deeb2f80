"""What a report says of vehicles, laws and slips that are not the published ones, and of what was not checked."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from figure_checks import defects
from html_page import Page
from test_html_report import SOURCE, rendered
from test_no_robust_design import SLOW, plants_of

from railslip_ctrl.adhesion import load_law, published_law
from railslip_ctrl.assessment import limits_of
from railslip_ctrl.design_check import design_check
from railslip_ctrl.design_report import assemble
from railslip_ctrl.design_report.loops import law_curves
from railslip_ctrl.linearization import linearize, operating_point
from railslip_ctrl.parameters import PARK2008, Rail
from railslip_ctrl.plots.design_report import run_drawings
from railslip_ctrl.plots.style import PAGE_HEIGHT
from railslip_ctrl.report.design_report_json import design_report_json
from railslip_ctrl.report.html.closing_sections import unchecked
from railslip_ctrl.report.html.numbers import above, below
from railslip_ctrl.report.html.plant_sections import adhesion_section, limits_section
from railslip_ctrl.report.html.range_sections import range_section
from railslip_ctrl.report.html.sliding_sections import tally
from railslip_ctrl.report.html.verdict import verdict
from railslip_ctrl.report.text import design_check_text, law_facts
from railslip_ctrl.report.verification import verification_json, verification_text
from railslip_ctrl.sliding.verdict import Condition, Verification
from railslip_ctrl.sliding_verification import FullVerification, verify_with_actuator

BEAM = """law = "beam"
{condition}
[parameters]
mu_max = 0.35
a = 0.01
Kx = 800000.0
"""


def words(text):
    return " ".join(str(text).split())


def told(section):
    """All text of a section."""
    found = []
    for block in section.blocks:
        found += [str(getattr(block, name, "")) for name in ("text", "caption", "head", "rows", "items")]
    return words(re.sub("<[^>]*>", "", " ".join(found)))


# --- hand-over, slips ------------------------------------------------------------------------------------------------


def test_what_was_run_of_the_hand_over_is_said_where_there_is_one(record):
    (text,) = [one for one in unchecked(record) if one.startswith("Handing over")]
    end = record.stops[0].slow[0]
    assert {one.seed for one in end.handed_over} == {one.seed for one in end.controlled}
    assert f"{len({one.seed for one in end.handed_over})} noise seeds, empty and loaded" in text
    assert "stops from 100 km/h" in text  # with slip control until then, not from free rolling
    assert f"at {end.from_kmh:g} km/h and to {end.torque:.4g} N·m" in text
    without = replace(record, stops=tuple(replace(stop, slow=()) for stop in record.stops))
    assert not any("Handing over" in one for one in unchecked(without))


def test_picture_of_a_stop_fills_the_page_and_names_the_file_of_its_law(record):
    """Legends once made its panels narrow; their letters are as large as they print."""
    stop = record.stops[0]
    law = stop.scenario.adhesion.model_copy(update={"file": "leaves.toml"})
    own = replace(stop, scenario=stop.scenario.with_changes(adhesion=law))
    figure = run_drawings(replace(record, stops=(own,)))["stop-1"]()
    figure.canvas.draw()
    assert f"adhesion law {law.name} as given (leaves.toml)" in " ".join(figure.get_suptitle().split())
    row = figure.axes[:3]
    # numbers and labels between and beside three panels take a fifth of the width
    assert sum(ax.get_position().width for ax in row) > 0.77
    assert figure.get_figheight() <= PAGE_HEIGHT
    assert defects(figure) == []


def test_margins_over_speed_are_spoken_of_where_there_are_any(record):
    assert "recommended design over speed" in unchecked(record)[0]
    bare = replace(record, loops=replace(record.loops, speeds=None))
    assert "recommended design" not in unchecked(bare)[0]


def test_range_says_the_slip_of_each_law_and_which_are_not_those_asked_for(record):
    speeds = record.loops.speeds
    assert "not at the" not in told(range_section(record))  # all at the slips asked for, which are the published ones
    table = next(b for b in range_section(record).blocks if "Slip, -" in getattr(b, "head", ()))
    column = table.head.index("Slip, -")
    assert [row[column] for row in table.rows] == [f"{line.slip:g}" for line in speeds.lines]
    asked = replace(record, plants=plants_of(PARK2008, slip=0.05))
    text = told(range_section(asked))
    assert (
        "the laws curve and bristle at the published reference slips, not at the 0.05 of the operating points" in text
    )


# --- conditions that are not decided ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lawless():
    """The layered law of a vehicle for which there is none."""
    return verify_with_actuator(law="layered", vehicle=SLOW)


def test_without_a_law_its_conditions_are_not_decided(lawless, record):
    found = lawless.verification
    assert [one.name for one in found.failing] == ["layer stable behind the actuator"]
    assert len(found.undecided) == 7
    assert not found.all_hold
    assert all("no law to decide it by" in one.evidence for one in found.undecided)
    assert tally(found.conditions) == "0 of 8 hold; 1 does not (1 failed in samples); 7 were not decided"
    text = words(verification_text(found, lawless.conclusion))
    assert "Verdict: 1 of 8 conditions does not hold, 7 were not decided." in text
    assert "authority: NOT DECIDED" in text
    content = verification_json(found)
    assert content["all_hold"] is False
    assert [(one["holds"], one["how"]) for one in content["conditions"]] == [(False, "sampled"), *[(None, None)] * 7]
    sliding = replace(record.sliding, layered=lawless)
    page = rendered(replace(record, sliding=sliding))
    told_page = words(Page.parsed(page).text)
    assert "1 does not (1 failed in samples); 7 were not decided" in told_page
    assert "none, as there is no law" in told_page
    listed = design_report_json(replace(record, sliding=sliding), page, SOURCE)["sliding"]["layered"]
    assert [one["holds"] for one in listed["conditions"]] == [False, *[None] * 7]


def test_the_command_ends_as_where_a_condition_fails(lawless, railslip, monkeypatch):
    monkeypatch.setattr("railslip_ctrl.cli.verify.verify_with_actuator", lambda **_: lawless)
    status, out, _ = railslip("verify", "--law", "layered")
    assert status == 1
    assert "7 were not decided" in words(out)


def test_the_layered_law_is_told_with_the_adhesion_it_was_decided_for(record):
    one = Verification("layered", 1.0, 1500.0, None, 2008, (Condition("a", "b", True, "sampled", "c"),))
    full = FullVerification(one, (), "")
    decided = replace(record, sliding=replace(record.sliding, layered=full))
    assert "not for" not in dict(verdict(decided).points)["Sliding mode"]
    for plants, which in ((plants_of(PARK2008, "beam"), "the law beam"), (plants_of(PARK2008, slip=0.1), "slip 0.1")):
        other = dict(verdict(replace(decided, plants=plants)).points)["Sliding mode"]
        assert f"decided for the published bristle model at its reference slips, not for {which}" in other


# --- rounding --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "down", "up"), [(2.7497, "2.74", "2.75"), (0.47978, "0.479", "0.48"), (2.0, "2", "2")]
)
def test_rounding_to_either_side(value, down, up):
    assert (below(value), above(value)) == (down, up)


# --- stable wheels ---------------------------------------------------------------------------------------------------


def test_of_a_stable_wheel_no_unstable_pole_is_spoken_of(record):
    stable = plants_of(PARK2008, "beam", slip=0.03)
    limits = tuple(limits_of(plant, PARK2008.actuator) for plant in stable)
    text = told(limits_section(replace(record, plants=stable, limits=limits)))
    assert "the wheel has no unstable pole" in text
    assert "runs away" not in text
    assert "No linear controller" not in text


def test_points_where_the_wheel_runs_away_are_counted(record):
    plants = (record.plants[0], plants_of(PARK2008, "beam", slip=0.03)[1])
    limits = tuple(limits_of(plant, PARK2008.actuator) for plant in plants)
    mixed = replace(record, plants=plants, limits=limits)
    assert "At 1 of its 2 operating points the wheel runs away" in dict(verdict(mixed).points)["Why this one"]
    assert "Meanwhile the wheel runs away at 1 of the 2 operating points." in told(limits_section(mixed))
    assert "At its 2 operating points the wheel runs away" in dict(verdict(record).points)["Why this one"]


# --- the user's own law ----------------------------------------------------------------------------------------------


def own_points(rails=tuple(Rail), condition=""):
    Path("leaves.toml").write_text(BEAM.format(condition=condition))
    law = load_law("leaves.toml")
    return [operating_point(law.on(rail), PARK2008, 100 / 3.6, 0.05, rail=rail) for rail in rails]


def test_parameters_of_a_law_stand_in_page_and_text_with_the_wet_rule(record, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    points = own_points()
    plants = tuple(linearize(point) for point in points)
    page = told(adhesion_section(replace(record, plants=plants, curves=law_curves(plants))))
    text = words(design_check_text(design_check(PARK2008, points)))
    for place in (page, text):
        assert "beam as given (leaves.toml): mu_max 0.35, a 0.01 s/m, Kx 800000 N" in place
        assert "mu_max 0.175, a 0.01 s/m, Kx 800000 N; wet by the rule of the law: mu_max × 0.5" in place
    assert "about the law beam as given (leaves.toml)" in page
    wet = published_law("beam", Rail.WET, 100.0, PARK2008.wheel_load)
    published = dict(law_facts(plant.point for plant in plants_of(PARK2008, "beam")))["Adhesion law, wet rail"]
    assert published.startswith(f"beam: mu_max {wet.mu_max:.6g}, ")
    assert "rule" not in published


def test_wet_parameters_as_given_are_not_called_derived(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ((_, alone),) = law_facts(own_points((Rail.WET,), 'condition = "wet"'))
    assert "mu_max 0.35" in alone
    assert "; given for wet rail, or wet by the rule of the law from dry ones: mu_max × 0.5" in alone


def test_results_of_an_earlier_report_depend_on_the_vehicle_only_where_that_is_so():
    """What the provenance says: the errata are found again for any vehicle, the conditions for their own alone."""
    looked = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assemble, "look_up", lambda name, given="": looked.setdefault(name, given) and None)
        assemble._found_before(SLOW)
    assert looked["errata"] == ""
    assert SLOW.name in looked["conditions-layered"]
