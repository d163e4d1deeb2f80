"""report.html: structure, numbers, what it says of another vehicle, and that nothing in it loads from elsewhere."""

from __future__ import annotations

import base64
import html
import json
import logging
import math
import re
from dataclasses import replace

import pytest
from html_page import LARGEST_BYTES, Page
from markupsafe import Markup

from railslip_ctrl.adhesion import published_law
from railslip_ctrl.assessment import assess, limits_of
from railslip_ctrl.cli.report import _may_write
from railslip_ctrl.design.schedule import lowest_held_speed, plant_at
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design_report import assemble
from railslip_ctrl.design_report.loops import gain_region
from railslip_ctrl.errors import InputError
from railslip_ctrl.kernels import compilation
from railslip_ctrl.linearization import linearize, operating_point
from railslip_ctrl.parameters import PARK2008, Actuator, Rail
from railslip_ctrl.plots.design_report import linear_drawings, run_drawings
from railslip_ctrl.report.design_report_json import KEY_OF_SECTION
from railslip_ctrl.report.html import design_report_html
from railslip_ctrl.report.html.formulas import transfer_function
from railslip_ctrl.report.html.numbers import listed, short
from railslip_ctrl.report.html.page import css_string
from railslip_ctrl.report.html.sliding_sections import decided
from railslip_ctrl.report.html.typography import typeset, with_units
from railslip_ctrl.report.html.verdict import verdict
from railslip_ctrl.report.provenance import Provenance
from railslip_ctrl.sliding.verdict import Condition
from railslip_ctrl.sliding_verification.layered import layered_design
from railslip_ctrl.switching import layer_loop

SOURCE = Provenance("railslip report", (("--out", "railslip-report (default)"),))
SECTIONS = (
    "vehicle", "adhesion", "linearisation", "limits", "region", "designs", "range", "margins", "stops", "sliding",
    "unchecked", "paper-law", "reproduction", "errata", "sources", "provenance",
)  # fmt: skip
TINY = b'<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>'


# --- the report of the command, once --------------------------------------------------------------------------------


def test_the_command_writes_one_page_beside_the_rest_and_says_so(full_report):
    folder, out, err = full_report
    assert {"report.html", "report.txt", "report.json", "bode.png", "nyquist.svg"} <= {p.name for p in folder.iterdir()}
    assert out.startswith("Wheel-slip control: design check")
    assert "report.html in a browser" in err
    assert "conditions of the published sliding-mode law" in err  # progress


def test_page_is_well_formed_and_loads_nothing(full_report):
    text = (full_report[0] / "report.html").read_text("utf-8")
    page = Page.parsed(text)
    assert len(text.encode()) < LARGEST_BYTES
    assert page.problems() == []
    assert page.figures >= 9
    assert page.tables >= 10


def test_contents_lead_to_every_section_in_order(full_report):
    page = Page.parsed((full_report[0] / "report.html").read_text("utf-8"))
    assert tuple(link for link in page.links if link != "top") == SECTIONS
    assert [identity for identity in page.ids if identity in SECTIONS] == list(SECTIONS)


def test_margins_are_those_of_the_json(full_report):
    folder = full_report[0]
    content = json.loads((folder / "report.json").read_text())
    rows = Page.parsed((folder / "report.html").read_text("utf-8")).rows("margins")
    cases = [case for group in content["groups"] for case in group["cases"]]
    shown = [row for row in rows if row[-1] in ("unstable", "stable but fragile", "robust") and len(row) == 9]
    assert len(shown) == len(cases)
    for row, case in zip(shown, cases, strict=True):
        numbers = ("gain_decrease", "gain_increase", "phase_margin_deg", "delay_margin_s", "ms", "mt")
        if not case["stable"]:
            assert set(row[2:8]) == {"–"}
            continue
        # four digits are shown
        assert [float(cell) for cell in row[2:8]] == pytest.approx([case[name] for name in numbers], rel=5.1e-4)


def test_published_numbers_are_in_it(full_report):
    text = html.unescape((full_report[0] / "report.html").read_text("utf-8"))
    for number in ("4787.78", "0.82084", "−8.636"):  # operating point and poles, oracle of the issue: dry, 100 km/h
        assert number in text
    rows = Page.parsed(text).rows("reproduction")
    assert sum(row[0] in ("PI beam", "PI bristle", "ASMC beam", "ASMC bristle") for row in rows) == 16
    for printed in ("59.5", "700", "0.0378", "50.7", "581", "0.0272"):  # [Park2008] Table 5
        assert any(printed in row for row in rows)


@pytest.fixture(scope="module")
def content(full_report):
    return json.loads((full_report[0] / "report.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def page(full_report):
    return Page.parsed((full_report[0] / "report.html").read_text("utf-8"))


def near(cell):
    """What a cell shows, within a digit of its last."""
    text = cell.replace("−", "-")
    digits = re.sub(r"^0+", "", text.lstrip("-").replace(".", ""))
    return pytest.approx(float(text), rel=10.0 ** (1 - max(len(digits), 1)))


def test_json_has_a_key_for_every_section(content):
    assert {KEY_OF_SECTION.get(name, name) for name in SECTIONS} <= set(content)
    assert content["verdict"]["paragraph"]
    assert all(content[KEY_OF_SECTION.get(name, name)] for name in SECTIONS)


def test_limits_and_linearisation_are_those_of_the_json(content, page):
    rows = page.rows("limits")[1:]
    assert len(rows) == len(content["limits"]) == len(content["linearisation"])
    for row, one, plant in zip(rows, content["limits"], content["linearisation"], strict=True):
        names = ("unstable_pole_rad_s", "doubling_time_s", "pole_times_dead_time_and_lag", "ms_lower_bound")
        assert [one[name] for name in names] == [near(cell) for cell in row[1:5]]
        assert one["bode_integral_rad_s"] == near(row[5])
        assert one["bode_integral_rad_s"] == pytest.approx(math.pi * one["unstable_pole_rad_s"])  # one unstable pole
        matrices = next(
            row[1] for row in page.rows("linearisation") if row[0] == "A, B" and f"{-plant['A'][1][1]:.6g}" in row[1]
        )
        shown = [float(x.replace("−", "-")) for x in re.findall(r"−?\d+\.?\d*", matrices)]
        entries = [x for line in (*plant["A"], *plant["B"]) for x in line]
        assert shown == pytest.approx(entries, rel=5.1e-6)  # six digits


def test_designs_and_stops_are_those_of_the_json(content, page):
    cases = [case for design in content["designs"]["designs"] for case in design["cases"]]
    rows = [
        row
        for row in page.rows("designs")
        if len(row) == 11 and row[-1] in ("unstable", "stable but fragile", "robust")
    ]
    assert len(rows) == len(cases)
    for row, case in zip(rows, cases, strict=True):
        assert row[-1] == case["verdict"]
        assert (case["ms"] is None) if row[6] == "–" else case["ms"] == near(row[6])
    runs = [run for stop in content["stops"] for run in stop["runs"]]
    dynamic = [run for stop in content["stops"] for run in stop["runs_with_the_dynamic_law"]]
    assert {"published PI", "PI-lead, full range", "holding PI", "PI-lead, least Ms"} <= {
        one["name"] for one in dynamic
    }
    rows = [row for row in page.rows("stops") if row[1] == "stopped"]
    shown = [one for stop in content["stops"] for one in (*stop["runs"], *stop["runs_with_the_dynamic_law"])]
    assert len(shown) == len(runs) + len(dynamic) == len(rows)
    for row, one in zip(rows, shown, strict=True):
        assert row[0] == one["name"]
        assert one["run"]["braking_distance_m"] == near(row[3])
        if one["distances_m"]:
            assert row[4] == f"{min(one['distances_m']):.1f}–{max(one['distances_m']):.1f}"


def test_speed_range_is_that_of_the_json(content, page):
    lines = content["range"]["lines"]
    rows = page.rows("range")
    head = next(row for row in rows if row[:3] == ["Law", "Rail", "Load"])
    shown = [row for row in rows if len(row) == len(head) and row[0] in ("curve", "bristle")]
    assert len(shown) == len(lines) == 8  # two laws, two rails, empty and loaded
    speeds = content["range"]["speeds_kmh"]
    for row, line in zip(shown, lines, strict=True):
        assert row[:2] == [line["adhesion"], line["rail"]]
        assert row[3] == f"{line['slip']:g}"
        for name, cell in list(zip(head, row, strict=True))[4:-2]:
            i = speeds.index(float(name))
            assert (cell == "×") is not line["stable"][i]
            assert cell == "×" or line["ms"][i] == near(cell)
    assert content["range"]["stable_from_kmh"] == pytest.approx(max(line["stable_from_kmh"] for line in lines))


def test_sliding_reproduction_and_errata_are_those_of_the_json(content, page):
    for law in ("paper", "layered"):
        conditions = content["sliding"][law]["conditions"]
        claims = [one for one in conditions if one["claimed_by_the_paper"]]
        for part in (claims, [one for one in conditions if one not in claims]):
            held = sum(one["holds"] for one in part)
            assert not part or f"{held} of {len(part)} hold" in page.text
    wrong = sum(not one["agrees"] for one in content["errata"])
    assert page.text.count(": differs") == wrong
    rows = [row for row in page.rows("reproduction") if len(row) == 7 and row[0] != "Column"]
    for row, one in zip(rows, content["reproduction"]["rows"], strict=True):
        assert one["deviation_percent"] == pytest.approx(float(row[4].replace("−", "-")), abs=0.0051)
    assert all(" ".join(text.split()) in " ".join(page.text.split()) for text in content["unchecked"])
    assert content["provenance"]["software"]["NumPy"] in page.text
    assert content["adhesion"][0]["parameters"]
    assert len(content["region"]["margins"]["ms"]) == len(content["region"]["margins"]["kp_si"])


def test_every_figure_is_beside_the_page_as_the_page_has_it(full_report, content):
    folder = full_report[0]
    text = (folder / "report.html").read_text("utf-8")
    embedded = {base64.b64decode(one) for one in re.findall(r"data:image/svg\+xml;base64,([^\"]+)", text)}
    beside = {path.read_bytes() for path in folder.glob("*.svg")}
    assert embedded == beside
    assert {path.stem for path in folder.glob("*.svg")} == {path.stem for path in folder.glob("*.png")}
    assert {path.name for path in folder.iterdir()} == set(content["files"])
    assert (folder / "nichols.svg").exists()
    assert set(content["files"]) == set(_may_write(page=True))  # what is looked at before the work


def test_verdict_is_a_paragraph_numbers_and_six_points_at_most(full_report, content):
    text = (full_report[0] / "report.html").read_text("utf-8")
    section = text[text.index('id="verdict"') : text.index("<nav")]
    assert section.count("<p") == 1
    assert 1 <= section.count("<li>") == len(content["verdict"]["points"]) <= 6
    assert section.count("<tr>") == len(content["verdict"]["numbers"])
    assert len(content["verdict"]["paragraph"].split()) < 180  # what is read in a minute
    taken = content["designs"]["recommended"]
    design = next(one for one in content["designs"]["designs"] if one["name"] == taken)
    assert design["stable"]
    assert f"the design “{taken}”, kp {design['kp_si']:g} N·m/(m/s)" in content["verdict"]["paragraph"]
    assert "Not covered." in section


def test_text_on_the_terminal_and_in_the_file_begins_with_the_same_verdict(full_report, content):
    folder, out, _ = full_report
    assert (folder / "report.txt").read_text("utf-8") == out
    words = " ".join(out.split())
    assert " ".join(content["verdict"]["paragraph"].split()) in words
    assert words.index("Verdict") < words.index("Quarter-car mass")
    assert "use this" not in words


def test_only_the_verdict_says_what_to_use(page):
    assert page.text.count("Recommended for") == 1
    assert "Use the layered law" not in page.text
    assert "recommendation of this report is that of the verdict" in " ".join(page.text.split())


def test_progress_tells_the_time_and_compiling_at_most_once(full_report):
    lines = full_report[2].splitlines()
    stages = [line for line in lines if re.match(r"railslip: +\d+\.\d s  \S", line)]
    assert len(stages) >= 10
    assert sum("compiling" in line for line in lines) <= 1
    assert len(stages) + sum("compiling" in line for line in lines) == len(lines)


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(railslip):
    status, out, err = railslip("report", "--out", "/proc/nope")
    assert (status, out) == (2, "")
    assert err == "railslip: error: --out: '/proc/nope' cannot be made or written to; choose another folder\n"


# --- the page from a record -----------------------------------------------------------------------------------------


def rendered(record, pictures=None):
    names = [*linear_drawings(record), *run_drawings(record)] if pictures is None else pictures
    return design_report_html(record, dict.fromkeys(names, TINY), SOURCE)


@pytest.fixture(scope="module")
def names(record):
    return [*linear_drawings(record), *run_drawings(record)]


def test_limit_is_the_closed_form(record, names):
    rows = Page.parsed(rendered(record, names)).rows("limits")
    for row, plant in zip(rows[1:], record.plants, strict=True):
        pole = plant.poles.real.max()  # one real unstable pole, no zero right of the axis: exp(p tau)
        bound = math.exp(pole * PARK2008.actuator.dead_time)
        assert bound - 0.01 < float(row[4]) <= bound  # three digits, down: what no controller gets below
        assert limits_of(plant, PARK2008.actuator).unstable_pole == pole


def test_what_a_vehicle_is_called_is_text_wherever_it_stands(record, names):
    name = '</style><script>alert(1)</script> & "Co" {{ 7*7 }} é'
    vehicle = PARK2008.model_copy(update={"name": name, "notes": ("<b>guessed</b>",)})
    text = rendered(replace(record, check=replace(record.check, vehicle=vehicle)), names)
    assert text.count("<script>") == 1  # the page's own
    assert "<b>guessed" not in text
    assert "&lt;b&gt;guessed&lt;/b&gt;" in text
    page = Page.parsed(text)
    assert page.problems() == []
    assert name in page.text


def test_another_vehicle_has_its_notes_and_not_the_paper_s_numbers(record, names):
    vehicle = PARK2008.model_copy(update={"name": "Another", "notes": ("axles = 4 assumed",)})
    text = rendered(replace(record, check=replace(record.check, vehicle=vehicle), table5=None, facts=()), names)
    page = Page.parsed(text)
    assert "axles = 4 assumed" in page.text
    assert "Left out: the printed results are of the published vehicle, and this report is about Another" in page.text
    assert not any(row[0] == "ASMC beam" for row in page.rows("reproduction"))


def test_a_doubtful_number_of_the_vehicle_stands_in_its_section(record, names):
    vehicle = PARK2008.model_copy(update={"actuator": PARK2008.actuator.model_copy(update={"dead_time": 150.0})})
    told = {}
    for one in (vehicle, PARK2008):
        page = Page.parsed(rendered(replace(record, check=replace(record.check, vehicle=one)), names))
        told[one.actuator.dead_time] = page.text
    assert "dead_time = 150 s is taken as given, but is outside the usual 0 to 2 s" in told[150.0]
    assert "To be checked" in told[150.0]
    assert "To be checked" not in told[0.15]


def test_what_could_not_be_had_says_why(record, names):
    region = replace(record.region, grid=None, strips=(), kp_range=None, reason="no kp stabilises")
    loops = replace(record.loops, refused={"holding PI": "none holds both"})
    page = Page.parsed(rendered(replace(record, region=region, loops=loops), names))
    for told in ("paper: not asked here", "no kp stabilises", "holding PI: none. none holds both"):
        assert told in page.text
    assert "Not available for this vehicle: layered (layered: not asked here)" in page.text


def test_a_picture_that_is_missing_is_an_error(record, names):
    with pytest.raises(KeyError, match="adhesion"):
        rendered(record, [name for name in names if name != "adhesion"])


def test_a_section_that_a_vehicle_does_not_allow_is_told_not_raised(monkeypatch):
    def refuse(**_):
        raise InputError("inertia scale: 99 is not allowed; give a value from 0.5 to 10")

    monkeypatch.setattr(assemble, "verify_with_actuator", refuse)
    assert assemble._verified("paper", PARK2008, fresh=True).value.startswith("inertia scale: 99")


def test_stop_in_words_agrees_with_its_numbers(record):
    stop = record.stops[-1]
    assert stop.scenario.name == "park2008"
    stopped = {one.name: one.run.braking_distance for one in stop.runs if one.run is not None}
    assert stop.shortest is not None
    assert stop.shortest.run.braking_distance == min(stopped.values())
    assert stop.bound is not None
    assert all(stop.bound.braking_distance < distance for distance in stopped.values())
    # [Park2008] Table 5: 682 and 581 m; single runs scatter by less than the reproduction's tolerance of 4 %
    assert stopped["published PI"] == pytest.approx(682, rel=0.04)
    assert stopped["published ASMC"] == pytest.approx(581, rel=0.04)


def test_linear_controllers_are_run_again_with_the_dynamic_law(record):
    dry, wet, published = record.stops
    assert published.dynamic == ()
    for stop in (dry, wet):
        assert not stop.scenario.adhesion.has_state
        for one in stop.dynamic:
            again, before = one.run.scenario, stop.scenario
            assert again.adhesion.name == "bristle"
            assert again.adhesion.has_state
            assert again.with_changes(adhesion=before.adhesion) == before
            assert one.run.seed == stop.run_of(one.name).seed


def test_recommended_is_robust_before_it_is_broad_and_broad_before_it_is_most_robust(record):
    loops = record.loops
    broad = next(one for one in loops.designs if one.over_range)
    assert loops.recommended is broad
    assert broad.worst_ms > loops.best.worst_ms  # the least worst Ms is not what decides
    fragile = next(one for one in loops.designs if one.stable and one.worst_ms > ROBUST_MS)
    assert replace(loops, designs=(fragile, loops.best)).recommended is loops.best
    assert replace(loops, designs=(fragile, replace(fragile, over_range=True))).recommended.over_range
    assert replace(loops, designs=tuple(one for one in loops.designs if not one.stable)).recommended is None
    (layered,) = (one for one in loops.designs if one.needs_hold)
    assert layered.stable
    assert replace(loops, designs=(layered,)).recommended is None


def test_layered_law_stands_beside_the_designs_with_its_own_gains(record):
    (layered,) = (one for one in record.loops.designs if one.needs_hold)
    design = layered_design(PARK2008)
    gains = layered.controller.gains
    # K widens the layer and is not in C: K/layer and rho K/layer are the same for the K that its bound asks for
    assert (gains.kp, gains.ki) == pytest.approx((design.K / design.layer, design.rho * design.K / design.layer))
    assert layered.assessments[0].margins.ms == pytest.approx(
        layer_loop(design, record.plants[0], PARK2008.actuator).margins().ms, rel=1e-9
    )


def test_verdict_tells_where_the_recommended_design_overshoots_with_the_dynamic_law(record):
    dry = next(one for one in record.stops[0].dynamic if one.name == record.loops.recommended.name)
    assert dry.highest_slip >= dry.run.max_slip > 2 * 0.132  # [Park2008] p. 55: the reference on dry rail
    told = f"{dry.highest_slip:.2g} on dry rail (reference 0.132), at {dry.highest_slip_kmh:.2g} km/h"
    assert told in verdict(record).paragraph
    stops = tuple(replace(stop, dynamic=()) for stop in record.stops)
    assert "overshoots" not in verdict(replace(record, stops=stops)).text


def test_speed_at_which_stability_ends_is_the_known_one_of_the_schedule_module(record):
    """`lowest_held_speed` looks for it over another grid, with the root count at every speed."""
    speeds = record.loops.speeds
    line = speeds.first_lost
    assert (line.law, line.rail) == ("curve", Rail.DRY)
    taken = record.loops.recommended.controller

    def plant(speed):
        return plant_at("curve", PARK2008, Rail.DRY, speed)

    # this bisection ends within 1e-3 km/h, the other within 1e-6
    assert speeds.stable_from == pytest.approx(lowest_held_speed(plant, taken, PARK2008.actuator), abs=2e-3)
    assert speeds.robust_from == pytest.approx(
        lowest_held_speed(plant, taken, PARK2008.actuator, ms_max=ROBUST_MS, low_kmh=15.0, high_kmh=25.0), abs=2e-3
    )
    # the claim it is recommended by, over the speeds that it was tuned for; gains are rounded after tuning
    assert speeds.worst_ms(20.0, 100.0) == pytest.approx(ROBUST_MS, rel=5e-3)
    told = verdict(record).paragraph
    assert f"unstable below {speeds.stable_from:.3g} km/h on dry rail with the law curve" in told


def test_range_has_the_margins_of_single_loops(record):
    speeds = record.loops.speeds
    line = next(one for one in speeds.lines if (one.law, one.rail, one.mass) == ("bristle", Rail.WET, PARK2008.mass))
    point = operating_point(published_law("bristle", Rail.WET, 100.0, PARK2008.wheel_load), PARK2008, 5 / 3.6, 0.092)
    alone = assess(linearize(point), record.loops.recommended.controller, PARK2008.actuator).margins
    i = line.at(5.0)
    assert (line.margins.ms[i], line.margins.phase_deg[i]) == pytest.approx((alone.ms, alone.phase_deg), rel=1e-6)


def test_what_is_most_robust_by_its_ms_has_runs_to_show_what_it_costs(record):
    for stop in record.stops[:2]:
        least, taken = (stop.run_of(name) for name in ("PI-lead, least Ms", "PI-lead, full range"))
        assert least.braking_distance > taken.braking_distance
    assert f"{least.braking_distance:.3g} m on wet rail to stop" in dict(verdict(record).points)["Why this one"]


def test_without_a_recommendation_nothing_is_said_of_speeds(record, names):
    loops = replace(record.loops, designs=tuple(one for one in record.loops.designs if not one.stable), speeds=None)
    bare = replace(record, loops=loops, recommended=None)
    found = verdict(bare)
    assert "none of the designs" in found.paragraph
    assert found.numbers == ()
    assert "No design is recommended" in Page.parsed(rendered(bare, names)).text


def test_provenance_says_what_was_kept(record, names):
    assert "all of it was computed in this run" in Page.parsed(rendered(record, names)).text
    kept = replace(record, from_cache=("errata of the paper",))
    told = " ".join(Page.parsed(rendered(kept, names)).text.split())
    assert "an earlier report of the same version and source kept: errata of the paper. What of that depends" in told
    assert "errata and the paper's numbers depend on none" in told


def test_region_marks_only_what_a_picture_of_it_can_show(record):
    region = record.region
    low, high = region.kp_range
    assert region.near(region.chosen["holding PI"])
    assert not region.near(region.chosen["published PI"])  # 2340 N*m/(m/s); the region ends at 573
    assert not region.near((high + 0.3 * (high - low), 1.0))


@pytest.mark.parametrize("lag", [0.6, 0.0])
def test_a_region_without_bound_is_drawn_up_to_gains_that_are_said(record, names, lag):
    """Without dead time kp has none, and without a lag ki has none either."""
    vehicle = PARK2008.model_copy(update={"actuator": Actuator(dead_time=0.0, lag=lag)})
    region = gain_region(replace(record.check, vehicle=vehicle), record.plants)
    assert (region.reason, math.isinf(region.kp_range[1])) == ("", True)
    text = Page.parsed(rendered(replace(record, region=region), names)).text
    assert f"kp above {short(region.kp_range[0])}, without bound" in text
    (strip,) = region.strips
    told = f"The region goes on without bound; drawn is kp up to {short(strip.kp[-1], 3)} N·m/(m/s)"
    assert told + (f" and ki up to {short(strip.ki_high.max(), 3)} N·m/m." if lag == 0.0 else ".") in text
    inside = [gains for gains in region.chosen.values() if region.near(gains)]
    assert inside
    assert all(kp < strip.kp[-1] and ki < strip.ki_high.max() for kp, ki in inside)  # nearly in is not in


def test_no_bound_of_one_is_called_a_limit(record, names):
    """Ms >= 1 is every loop's: it follows from no unstable pole."""
    assert "No linear controller gets Ms or Mt below" in Page.parsed(rendered(record, names)).text
    limits = tuple(replace(one, ms_bound=1.0) for one in record.limits)
    text = Page.parsed(rendered(replace(record, limits=limits), names)).text
    assert "No linear controller gets Ms or Mt below" not in text
    assert "The unstable pole alone puts no bound on Ms or Mt above 1 here" in text


# --- parts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (2253.4, 3, "2250"),
        (0.131249, 4, "0.1312"),
        (-0.5, 4, "−0.5"),
        (1.77e7, 4, "1.77·10⁷"),
        (2.5e-9, 4, "2.5·10⁻⁹"),
        (math.inf, 4, "∞"),
        (math.nan, 4, "–"),
        (99999.7, 4, "100000"),
    ],
)
def test_short_numbers(value, digits, text):
    assert short(value, digits) == text


@pytest.mark.parametrize(("words", "text"), [((), "none"), (("a",), "a"), (("a", "b", "c"), "a, b and c")])
def test_listed(words, text):
    assert listed(words) == text


def test_css_string_can_be_read_back_and_ends_no_style():
    text = 'A "b" </style> é.2'
    escaped = css_string(text)
    assert not set('"<>/') & set(escaped)
    assert re.sub(r"\\([0-9a-f]{6}) ", lambda found: chr(int(found[1], 16)), escaped) == text


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("V' = -r*(D*s**2 + K*Abs(s))/J", "V′ = −r·(D·s² + K·|s|)/J"),
        ("theta1_tilde**2/(2*k)", "θ̃₁²/(2·k)"),
        ("c**2*(Ta**2 + omega**2)/(2*k)", "c²·(Ta² + ω²)/(2·k)"),
        ("theta_hat' = k s phi", "θ̂′ = k s φ"),
        ("k**(-2), kg^-2 m^-4", "k⁻², kg⁻² m⁻⁴"),
        ("70 N m, 5 N*m/(m/s)", "70 N·m, 5 N·m/(m/s)"),
        ("k = 2.1e-08 <= 3", "k = 2.1·10⁻⁸ ≤ 3"),
        ("K_min < d_max", "K<sub>min</sub> &lt; d<sub>max</sub>"),
        ("(44), theta_1; x_12", "(44), θ<sub>1</sub>; x_12"),
        ("the law's own, not the rest's; pp. 54-56", "the law&#39;s own, not the rest&#39;s; pp. 54-56"),
        ("see `railslip verify --law layered`.", "see <code>railslip verify --law layered</code>."),
        ("a thetan, alphabet", "a thetan, alphabet"),
    ],
)
def test_terminal_text_is_set_as_print(text, printed):
    assert str(typeset(text)) == printed


@pytest.mark.parametrize("make", [str, Markup])
def test_a_number_and_its_unit_stay_on_one_line(make):
    text = make("from 20 km/h, 5 % of 0.8 1/s, 4 stops, 2 N·m, 3 sections of 7 <b>")
    kept = with_units(text)
    assert type(kept) is make
    assert kept.replace(" ", "_").replace("\N{NO-BREAK SPACE}", " ") == (
        "from_20 km/h,_5 %_of_0.8 1/s,_4_stops,_2 N·m,_3_sections_of_7_<b>"
    )


def test_transfer_function_is_typeset():
    shown = Page.parsed(str(transfer_function([0.5, 2.0], [1.0, 0.0, -3e-7], r"\mathrm{m}"))).text
    assert shown == "0.5s+2s2−3·10−7m"


@pytest.mark.parametrize(
    ("how", "holds", "word"),
    [
        ("symbolic", True, "proved"),
        ("sampled", True, "held in all samples"),
        ("simulated", True, "held in all runs"),
        ("symbolic", False, "refuted"),
        ("simulated", False, "failed in runs"),
    ],
)
def test_what_was_sampled_is_not_called_proved(how, holds, word):
    assert decided(Condition("a", "b", holds, how, "c")) == word


def test_compilation_is_told_once(caplog):
    logger = logging.getLogger(compilation.__name__)
    with assemble._compilation_told(at_most=1):
        for law in ("curve", "bristle"):
            logger.warning("compiling %s", law)
    assert [record.getMessage() for record in caplog.records] == ["compiling curve"]
    logger.warning("compiling again")
    assert len(caplog.records) == 2


def test_page_checker_sees_what_is_wrong():
    broken = (
        '<html lang="en"><p id="a">x</p><p id="a">y</p><a href="#gone">z</a><img src="https://x.y/z.png">'
        '<link rel="stylesheet" href="style.css"><style>b { background: url(http://x) }</style></html>'
    )
    found = " ".join(Page.parsed(broken).problems())
    for word in ("id a", "#gone", "alt", "https://x.y/z.png", "style.css", "url("):
        assert word in found


def test_provenance_is_a_command_that_can_be_typed_again(full_report):
    page = Page.parsed((full_report[0] / "report.html").read_text("utf-8"))
    assert re.search(r"railslip report --speed 100.0 --out \S+", page.text)
    assert ["--adhesion", "bristle (default)"] in page.rows("provenance")
    assert ["--speed", "100.0"] in page.rows("provenance")
