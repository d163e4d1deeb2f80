"""What a report says where no design is robust, and where none is needed; and that designs are called what they are."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
from test_html_report import SOURCE, rendered

from railslip_ctrl.adhesion import published_law
from railslip_ctrl.assessment import Verdict, limits_of
from railslip_ctrl.design import PIController
from railslip_ctrl.design.limits import least_peak
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design_check import design_check
from railslip_ctrl.design_report import loops as loops_module
from railslip_ctrl.design_report.candidates import design_names, least_ms, least_ms_gains
from railslip_ctrl.design_report.loops import loop_designs
from railslip_ctrl.errors import InfeasibleDesignError
from railslip_ctrl.linearization import linearize, operating_point
from railslip_ctrl.parameters import PARK2008, Actuator, PIGains, Rail
from railslip_ctrl.report.design_report_json import design_report_json
from railslip_ctrl.report.html.numbers import above, below, where
from railslip_ctrl.report.html.plant_sections import limits_section
from railslip_ctrl.report.html.verdict import verdict
from railslip_ctrl.report.text import design_check_text, margins_text

LONGEST = 150
"""Words of the paragraph: what is read before a reader decides to read on."""

SLOW = PARK2008.model_copy(
    update={
        "name": "Slow brake",
        "wheel": PARK2008.wheel.model_copy(update={"inertia": 38.0}),  # a light wheelset runs away sooner
        "actuator": Actuator(dead_time=0.7, lag=2.0),
    }
)


def plants_of(vehicle, name="bristle", slip=None):
    found = []
    for rail in Rail:
        law = published_law(name, rail, 100.0, vehicle.wheel_load)
        held = law.reference_slip(rail) if slip is None else slip
        found.append(linearize(operating_point(law, vehicle, 100 / 3.6, held, rail=rail, initial_speed_kmh=100.0)))
    return tuple(found)


def linear(vehicle, plants, given=None):
    """Check and designs, without what costs most and is not looked at here: speeds, known rules, responses."""
    check = design_check(vehicle, [plant.point for plant in plants], given=given)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loops_module, "speed_range", lambda *_: None)
        patch.setattr(loops_module, "_attempts", lambda *_: [])
        patch.setattr(loops_module, "_RESPONSE_TIME", 1.0)
        return check, loop_designs(check, plants, given)


def report_of(record, vehicle, plants, check, loops):
    limits = tuple(limits_of(plant, vehicle.actuator) for plant in plants)
    loops = replace(loops, attempts=record.loops.attempts)
    return replace(
        record, check=check, plants=plants, limits=limits, loops=loops, recommended=None, stops=(), table5=None
    )


# --- none is robust --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def slow(record):
    plants = plants_of(SLOW)
    check, loops = linear(SLOW, plants, PIGains(kp=300.0, ki=5.0))
    return report_of(record, SLOW, plants, check, loops)


def test_shortfall_is_the_theorem_and_what_tuning_finds(slow):
    found = slow.loops.shortfall
    assert slow.loops.recommended is None
    pole = slow.plants[0].poles.real.max()  # one real pole on either rail, the faster one on the dry
    assert found.point.rail is Rail.DRY
    assert found.limits.ms_bound == pytest.approx(math.exp(pole * 0.7), rel=1e-12)
    assert found.limits.ms_bound > ROBUST_MS
    assert found.longest_dead_time == pytest.approx(math.log(ROBUST_MS) / pole, rel=1e-9)
    assert least_peak([pole], [], found.longest_dead_time) == pytest.approx(ROBUST_MS)
    # a design of that structure at the end of the bisection, and none 2 % beyond: its tolerance is 1 % of the theorem's
    assert 0 < found.lead_dead_time < found.longest_dead_time
    assert least_ms_gains(slow.plants, SLOW, found.lead_dead_time).worst.ms <= ROBUST_MS
    beyond = found.lead_dead_time + 0.02 * found.longest_dead_time
    assert least_ms_gains(slow.plants, SLOW, beyond).worst.ms > ROBUST_MS


def test_verdict_without_a_robust_design_leads_with_the_limit_and_says_what_would_change(slow):
    found, told = slow.loops.shortfall, verdict(slow)
    paragraph = told.paragraph
    first = paragraph.split(". ")[0]
    assert "no linear controller gets Ms below 2." in f"{first}. "
    for words in (
        "bristle, dry rail, 100 km/h, slip 0.132, M 3517 kg",
        "dead time τ = 0.7 s, lag T = 2 s",
        f"p = {found.limits.unstable_pole:.3g} 1/s",
        "a PI needs less than 1",
        "Ms ≤ 2 takes a shorter dead time (any linear controller: below",
    ):
        assert words in paragraph
    assert len(paragraph.split()) <= LONGEST
    everything = " ".join([paragraph, *(f"{a} {b}" for a, b in told.numbers), *(f"{a} {b}" for a, b in told.points)])
    assert "--kp" not in everything  # gains are given; and an option is no design
    assert "plant 1" not in everything
    assert "given PI: unstable at each" in dict(told.points)["Why none"]
    assert ("Brake", "dead time 0.7 s, lag 2 s") in told.numbers


def test_the_same_words_stand_in_the_text_the_page_and_the_json(slow):
    page = rendered(slow)
    content = design_report_json(slow, page, SOURCE)
    paragraph = verdict(slow).paragraph
    assert content["verdict"]["paragraph"] == paragraph
    assert content["designs"]["no_robust_design"]["ms_lower_bound"] == slow.loops.shortfall.limits.ms_bound
    json.dumps(content, allow_nan=False)
    for text in (design_check_text(slow.check, verdict(slow)), page.replace("\N{NO-BREAK SPACE}", " ")):
        assert " ".join(paragraph.split())[:200] in " ".join(text.split())


def test_a_fragile_design_is_told_with_its_margins_and_the_same_limit(record):
    vehicle = PARK2008.model_copy(update={"name": "Slow brake", "actuator": Actuator(dead_time=0.4, lag=1.2)})
    plants = plants_of(vehicle)[:1]
    check, loops = linear(vehicle, plants)
    assert loops.recommended.worst_ms > ROBUST_MS
    assert loops.shortfall.alone == ()
    told = verdict(report_of(record, vehicle, plants, check, loops))
    paragraph = told.paragraph
    assert paragraph.startswith(
        "No robust design (Ms ≤ 2) was found for Slow brake; no linear controller gets Ms below"
    )
    assert f"The least fragile design, “{loops.recommended.name}”" in paragraph
    longest = loops.shortfall.longest_dead_time
    assert longest > vehicle.actuator.dead_time  # so that the dead time alone excludes nothing
    assert f"a higher order (not excluded up to {above(longest)} s), or a" in paragraph
    assert "not to be used without more" in paragraph
    assert len(paragraph.split()) <= LONGEST
    worst = loops.recommended.assessments[0].margins  # at the one operating point; what the paragraph leaves out
    assert (
        f"gain {above(worst.gain_decrease)} to {below(worst.gain_increase)}"
        in dict(told.numbers)["Margins at the operating points"]
    )


def test_a_fragile_design_has_its_stops_under_the_points(record):
    """The paragraph is the limit's and what would change it; nothing that a robust design's says is lost."""
    vehicle = PARK2008.model_copy(update={"name": "Slow brake", "actuator": Actuator(dead_time=0.3, lag=1.2)})
    plants = plants_of(vehicle)[:1]
    check, loops = linear(vehicle, plants)
    stops = tuple(
        replace(stop, runs=tuple(replace(one, name=loops.recommended.name) for one in stop.runs[:1]))
        for stop in record.stops
        if not stop.scenario.events
    )
    fragile = replace(report_of(record, vehicle, plants, check, loops), stops=stops)
    fragile = replace(fragile, loops=replace(fragile.loops, speeds=record.loops.speeds))
    told = verdict(fragile)
    points = dict(told.points)
    assert len(told.paragraph.split()) <= LONGEST
    for stop in stops:
        text = f"On {stop.scenario.rail} rail it stops in {stop.runs[0].run.braking_distance:.3g} m"
        assert text in points["Braking runs"]
        assert text not in told.paragraph
    assert points["Low speed"].startswith("Ms stays at most 2 from ")
    assert "see Low speed" not in points["Low speed"]
    assert len(told.points) <= 6
    # where the loop is lost is too much to be left to a point alone
    assert f", but is unstable below {above(record.loops.speeds.stable_from)} km/h" in told.paragraph


def test_remedies_are_all_named_and_the_claim_is_for_the_slips_asked(slow):
    text = verdict(slow).paragraph
    assert "no robust design (Ms ≤ 2) at reference slips 0.132 and 0.092, and none can exist there" in text
    assert "or a smaller p (smaller reference slip, --slip; more wheel inertia)." in text
    pole = slow.limits[0].unstable_pole
    heavier = SLOW.model_copy(update={"wheel": SLOW.wheel.model_copy(update={"inertia": 2 * SLOW.wheel.inertia})})
    for changed in (plants_of(SLOW, slip=0.11), plants_of(heavier)):  # they do what is said of them
        assert limits_of(changed[0], SLOW.actuator).unstable_pole < pole


def test_what_holds_one_point_alone_is_told_with_its_gains(slow):
    held = [one for one in slow.loops.shortfall.alone if one.margins is not None]
    assert held
    told = verdict(slow)
    for one in held:
        gains = one.controller.gains
        row = dict(told.numbers)[f"{one.name}, for {where(one.point)} alone"]
        assert row.startswith(f"kp {gains.kp:.4g} N·m/(m/s), ki {gains.ki:.4g} N·m/m, behind the lead")
        assert f"Ms ≤ {above(one.margins.ms)}, phase ≥ {below(one.margins.phase_deg)} deg" in row
        assert f"{where(one.point)} (Ms ≤ {above(one.margins.ms)})" in told.paragraph
    assert f"the best, “{held[0].name}” tuned for one of them alone" in told.paragraph


def test_a_bound_is_rounded_to_the_safe_side_and_the_same_everywhere(slow):
    found = slow.loops.shortfall
    bound, longest = found.limits.ms_bound, found.longest_dead_time
    least, most = below(bound), above(longest)
    assert float(least) <= bound < float(least) + 0.01
    assert longest <= float(most) < longest + 0.001
    paragraph, numbers = verdict(slow).paragraph, dict(verdict(slow).numbers)
    assert f"Ms below {least} (" in paragraph
    assert f"dead time (any linear controller: below {most} s;" in paragraph
    assert numbers["Least Ms of any linear controller"].startswith(f"{least} ")
    assert numbers["Dead time for Ms ≤ 2, any linear controller"] == f"below {most} s"
    limits = limits_section(slow)
    assert f"Ms or Mt below {least} (" in str(limits)
    table = next(block for block in limits.blocks if hasattr(block, "rows"))
    assert [row[table.head.index("Ms, Mt ≥")] for row in table.rows] == [below(one.ms_bound) for one in slow.limits]
    case = next(one for one in slow.check.groups[0].assessments if one.limits.ms_bound == bound)
    assert f"Ms or Mt below {least};" in " ".join(margins_text([case]).split())


# --- none is needed --------------------------------------------------------------------------------------------------


def test_where_the_wheel_is_stable_no_design_without_gain_is_robust_or_recommended():
    plants = plants_of(PARK2008, "beam", slip=0.03)[:1]
    assert max(plant.poles.real.max() for plant in plants) < 0
    _, loops = linear(PARK2008, plants, PIGains(kp=0.0, ki=0.0))
    names_of = design_names(PARK2008)
    for refused in ("holding PI", names_of.least_ms):
        assert "the wheel is stable by itself" in loops.refused[refused]
    idle = next(one for one in loops.designs if one.name == "given PI")
    assert (idle.stable, idle.holds) == (True, False)
    assert {one.verdict for one in idle.assessments} == {Verdict.NO_FEEDBACK}
    assert idle not in (loops.recommended, loops.best)
    most = next(one for one in loops.designs if one.name == names_of.largest_ki)
    assert most.worst_ms == pytest.approx(ROBUST_MS, rel=1e-9)  # integral action as far as that allows
    assert most.controller.gains.ki > 100.0
    assert replace(loops, designs=(idle,)).recommended is None
    with pytest.raises(InfeasibleDesignError, match="stable by itself"):
        least_ms(plants, PARK2008)


# --- names -----------------------------------------------------------------------------------------------------------


def test_a_design_is_called_pi_lead_only_where_there_is_a_lead(record):
    for one in record.loops.designs:
        if one.name.startswith("PI"):
            assert one.name.split(",")[0] == one.controller.structure
    prompt = PARK2008.model_copy(update={"mass_loaded": 6000.0, "actuator": Actuator(dead_time=0.15, lag=0.0)})
    found = design_names(prompt)
    assert (found.full_range, found.least_ms) == ("PI, full range", "PI, least Ms")
    assert found.started_dry == "PI, full range, started for dry rail"
    design = least_ms(plants_of(prompt), prompt)
    assert isinstance(design.controller, PIController)
    assert (design.name, design.controller.structure) == (found.least_ms, "PI")
    assert "lead" not in design.how
