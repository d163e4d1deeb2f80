"""report.html: structure, numbers, what it says of another vehicle, and that nothing in it loads from elsewhere."""

from __future__ import annotations

import html
import json
import math
import re
from dataclasses import replace

import pytest
from html_page import LARGEST_BYTES, Page

from railslip_ctrl.assessment import limits_of
from railslip_ctrl.design_check import design_check
from railslip_ctrl.design_report import assemble
from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters import PARK2008
from railslip_ctrl.plots.design_report import linear_figures, run_figures
from railslip_ctrl.report.html import Provenance, design_report_html
from railslip_ctrl.report.html.numbers import listed, short
from railslip_ctrl.report.html.page import css_string

SOURCE = Provenance("railslip report", (("--out", "railslip-report (default)"),))
SECTIONS = (
    "vehicle", "adhesion", "linearisation", "limits", "region", "margins", "designs", "sliding", "stops",
    "reproduction", "errata", "unchecked", "sources", "provenance",
)  # fmt: skip
TINY = b'<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>'


# --- the report of the command, once --------------------------------------------------------------------------------

pytestmark = pytest.mark.xdist_group("html report")


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


# --- the page from a record -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def record():
    """A report in this process, the sliding-mode law left undecided and the paper's runs few."""
    from railslip_ctrl.cli.options import CaseOptions

    points = CaseOptions("bristle", (), (), 100.0, None, None, False, (), None, None, None).points()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assemble, "_verified", lambda law, vehicle: f"{law}: not asked here")
        patch.setattr(assemble, "SEEDS", 2)
        patch.setattr(assemble, "published_facts", lambda: ())
        return assemble.design_report(design_check(PARK2008, points), points, workers=1)


def rendered(record, pictures=None):
    names = [*linear_figures(record), *run_figures(record)] if pictures is None else pictures
    return design_report_html(record, dict.fromkeys(names, TINY), SOURCE)


@pytest.fixture(scope="module")
def names(record):
    return [*linear_figures(record), *run_figures(record)]


def test_limit_is_the_closed_form(record, names):
    rows = Page.parsed(rendered(record, names)).rows("limits")
    for row, plant in zip(rows[1:], record.plants, strict=True):
        pole = plant.poles.real.max()  # one real unstable pole, no zero right of the axis: exp(p tau)
        assert float(row[4]) == pytest.approx(math.exp(pole * PARK2008.actuator.dead_time), rel=5.1e-4)
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
    assert assemble._verified("paper", PARK2008).startswith("inertia scale: 99")


def test_stop_in_words_agrees_with_its_numbers(record):
    stop = record.stops[-1]
    assert stop.scenario.name == "park2008"
    stopped = {one.name: one.run.braking_distance for one in stop.runs if one.run is not None}
    assert stop.shortest is not None
    assert stop.shortest.braking_distance == min(stopped.values())
    assert stop.bound is not None
    assert all(stop.bound.braking_distance < distance for distance in stopped.values())
    # [Park2008] Table 5: 682 and 581 m; single runs scatter by less than the reproduction's tolerance of 4 %
    assert stopped["published PI"] == pytest.approx(682, rel=0.04)
    assert stopped["published ASMC"] == pytest.approx(581, rel=0.04)


def test_region_marks_only_what_a_picture_of_it_can_show(record):
    region = record.region
    low, high = region.kp_range
    assert region.near(region.chosen["holding PI"])
    assert not region.near(region.chosen["published PI"])  # 2340 N*m/(m/s); the region ends at 573
    assert not region.near((high + 0.3 * (high - low), 1.0))


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


def test_page_checker_sees_what_is_wrong():
    broken = (
        '<html lang="en"><p id="a">x</p><p id="a">y</p><a href="#gone">z</a><img src="https://x.y/z.png">'
        '<link rel="stylesheet" href="style.css"><style>b { background: url(http://x) }</style></html>'
    )
    found = " ".join(Page.parsed(broken).problems())
    for word in ("id a", "#gone", "alt", "https://x.y/z.png", "style.css", "url("):
        assert word in found


def test_no_html_leaves_the_page_out(tmp_path, railslip):
    status, _, err = railslip("report", "--rail", "wet", "--no-html", "--out", tmp_path / "x")
    assert status == 0
    assert "report.html" not in err
    assert not (tmp_path / "x" / "report.html").exists()


def test_provenance_is_a_command_that_can_be_typed_again(full_report):
    page = Page.parsed((full_report[0] / "report.html").read_text("utf-8"))
    assert re.search(r"railslip report --speed 100.0 --out \S+", page.text)
    assert ["--adhesion", "bristle (default)"] in page.rows("provenance")
    assert ["--speed", "100.0"] in page.rows("provenance")
