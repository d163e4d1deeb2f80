"""The page of `railslip design`: what it is answered, who may ask, the command and the notebook."""

import http.client
import json
import math
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

import railslip_ctrl as rs
from railslip_ctrl.core.units import ms_up
from railslip_ctrl.design.envelope_tuning import operating_plants
from railslip_ctrl.design.gain_map import Screen, gain_levels, hard_plants
from railslip_ctrl.design.stabilizing import intersection, stabilizing_pi
from railslip_ctrl.design.workbench import Workbench
from railslip_ctrl.page.answers import ANSWERS, POINTS
from railslip_ctrl.page.server import LARGEST_REQUEST, Dispatcher, PageServer

HELD = {"dry": 0.1, "wet": 0.07}
ENVELOPE = rs.Envelope(speeds=(20, 100), laws="bristle", loads="empty", reference=HELD)
DESIGN = {"kind": "pi-lead", "values": {"kp": 330.0, "ki": 129.0, "lead": 0.6, "lead_filter": 0.06}, "reference": HELD}
CAR, PI_LEAD = (
    rs.PARK2008,
    rs.PILead(kp=330.0, ki=129.0, lead=0.6, lead_filter=0.06, reference=HELD, period=0.01, rule="tustin"),
)


def unpacked(content):
    (length,) = struct.unpack("<I", content[:4])
    head, at, arrays = json.loads(content[4 : 4 + length]), 4 + length, {}
    for name, size in head["arrays"].items():
        arrays[name] = np.frombuffer(content, "<f4", size, at)
        at += 4 * size
    assert at == len(content)
    return head, arrays


class Client:
    """A browser without a screen."""

    def __init__(self, address):
        self.port, self.token = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/([0-9a-f]{40})/", address).groups()

    def send(self, method="POST", path="loop", body=b"", token=None, **headers):
        """Status, headers and content."""
        given = {"Content-Type": "application/json", **{name.replace("_", "-"): one for name, one in headers.items()}}
        connection = http.client.HTTPConnection("127.0.0.1", int(self.port), timeout=60)
        connection.request(method, f"/{self.token if token is None else token}/{path}", body, given)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, answer.headers, content

    def ask(self, what, **asked):
        status, _, content = self.send(path=what, body=json.dumps(asked).encode())
        assert status == 200, content
        return unpacked(content)

    def refused(self, status, told, **sent):
        found, _, content = self.send(**sent)
        assert found == status
        assert re.search(told, json.loads(content)["error"]), content


@contextmanager
def served(bench, port=0):
    with Dispatcher(bench).opened() as dispatcher, PageServer(dispatcher, port) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield Client(server.address)
        finally:
            server.shutdown()


@pytest.fixture(scope="module")
def page():
    with served(Workbench(ENVELOPE)) as client:
        yield client


# --- what it is answered ----------------------------------------------------------------------------------------------


def test_the_loop_shown_is_the_exact_one_of_the_worst_operating_point(page):
    head, arrays = page.ask("loop", design=DESIGN)
    worst = rs.judge(ENVELOPE, PI_LEAD, nominal=True).worst
    m = worst.margins
    assert (head["where"], head["stable"]) == (worst.case.description, True)
    told = ("ms", "phase_margin_deg", "delay_margin_s", "gain_increase", "gain_decrease")
    assert [head[name] for name in told] == [m.ms, m.phase_deg, m.delay_s, m.gain_increase, m.gain_decrease]
    assert head["frequencies"]["ms"] == m.ms_frequency
    assert {array.size for array in arrays.values()} == {POINTS}
    # the response from its parts, by hand; digits of a 32-bit float
    s = 1j * arrays["omega"].astype(float)
    plant = rs.linearize(worst.point)
    wheel = plant.gain * np.prod([s - z for z in plant.zeros], axis=0) / np.prod([s - p for p in plant.poles], axis=0)
    expected = (330 + 129 / s) * (0.6 * s + 1) / (0.06 * s + 1) * np.exp(-0.15 * s) / (0.6 * s + 1) * wheel
    np.testing.assert_allclose(arrays["re"] + 1j * arrays["im"], expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(arrays["db"], 20 * np.log10(np.abs(expected)), atol=1e-3)
    np.testing.assert_allclose(np.exp(1j * np.radians(arrays["phase"])), expected / np.abs(expected), atol=2e-3)
    loop = rs.wheel_slip_loop(worst.point, PI_LEAD)
    np.testing.assert_allclose(arrays["step"], loop.step_response(arrays["time"].astype(float)).output, atol=1e-4)
    assert abs(arrays["load"][-1]) < 0.02 * np.abs(arrays["load"]).max()  # the integral takes the load away


def test_an_unstable_loop_is_shown_with_the_gains_that_would_do(page):
    design = {**DESIGN, "values": {**DESIGN["values"], "kp": 5000.0}}
    head, arrays = page.ask("loop", design=design)
    assert (head["stable"], head["ms"], head["phase_margin_deg"]) == (False, None, None)
    assert 0 < head["range"][0] < head["range"][1] < 1
    assert arrays["step"].size == POINTS


def test_the_verdict_is_that_of_margins_and_its_words(page):
    for what, nominal in (("envelope", True), ("verdict", False)):
        head, _ = page.ask(what, design=DESIGN)
        judged = rs.judge(ENVELOPE, PI_LEAD, nominal=nominal)
        assert (head["verdict"], head["line"]) == (judged.verdict, judged.verdict_line)
        assert head["map"]["operating"] == judged.map.operating.tolist()
        assert head["least"] == {
            name: judged.least(name, largest=name == "gain_decrease")[0]
            for name in ("phase_deg", "delay_s", "gain_increase", "gain_decrease")
        }
    head, _ = page.ask("envelope", design=DESIGN)
    assert list(head["points"])[head["hardest"]] == judged.worst.case.description
    limits = [rs.fundamental_limits(rs.actuated_plant(one, CAR.actuator), 0.15).ms_bound
              for one in operating_plants(ENVELOPE.points(nominal=True))]  # fmt: skip
    assert np.max(head["bounds"]) == pytest.approx(max(limits), rel=1e-12)


def test_the_stops_are_those_of_simulate(page):
    head, arrays = page.ask("stops", design=DESIGN)
    control = Workbench(ENVELOPE).control("pi-lead", DESIGN["values"])
    for rail in ("dry", "wet"):
        run = rs.simulate(rs.stop(CAR, rail, adhesion="bristle"), control, seed=0)
        assert head["descriptions"][rail] == str(run)
        assert arrays[f"{rail} time"][-1] == pytest.approx(run.braking_time, abs=0.02)
        assert arrays[f"{rail} slip"].max() == pytest.approx(run.max_slip, rel=0.1)  # of some samples
    wet = arrays["patch time"][arrays["patch reference"] < 0.1]
    assert 2.5 < wet[0] < 4.0  # s; the patch begins 3 s at the first speed away
    assert wet[-1] < arrays["patch time"][-1]


def test_the_map_is_the_stabilising_region_and_its_contours_have_their_ms():
    plants = operating_plants(ENVELOPE.points(nominal=True))
    levels = gain_levels(PI_LEAD, plants, CAR.actuator)
    assert [level.ms for level in levels][:3] == [None, 4.0, 3.0]
    lead = rs.PIController(rs.PIGains(kp=1.0, ki=0.0), 0.6, 0.06).transfer_function
    systems = [lead * rs.actuated_plant(plant, CAR.actuator) for plant in plants]
    region = intersection([stabilizing_pi(system, 0.15) for system in systems])
    for level in levels[:5]:
        for ki, ((low, high),) in level.rows[2:-2:3]:
            for end, inwards in ((low, 1e-3), (high, -1e-3)):
                inner, outer = end + inwards * (high - low), end - inwards * (high - low)
                if level.ms is None:
                    assert (region.contains(inner, ki), region.contains(outer, ki)) == (True, False)
                    continue
                ms = [max(loop.margins().ms for loop in region.loops(kp, ki)) for kp in (inner, outer)]
                # the samples of frequency between which the gains are nearly straight: a few per mille
                assert ms[0] < level.ms * 1.01
                assert ms[1] > level.ms * 0.99
    few = gain_levels(PI_LEAD, hard_plants(plants), CAR.actuator)
    assert few[3].rows[-1][0] == pytest.approx(levels[3].rows[-1][0], rel=0.1)
    assert not gain_levels(PI_LEAD.model_copy(update={"lead": 0.0, "lead_filter": 3.0}), plants, CAR.actuator)


def test_the_map_comes_first_at_the_hardest_points_then_at_all(page):
    plants = operating_plants(ENVELOPE.points(nominal=True))
    for asked, few, shown in (({}, True, hard_plants(plants)), ({"all": True}, False, plants)):
        head, _ = page.ask("region", design=DESIGN, **asked)
        levels = gain_levels(PI_LEAD, shown, CAR.actuator)
        assert (head["few"], [one["ms"] for one in head["levels"]]) == (few, [one.ms for one in levels])
        assert head["levels"][1]["rows"][0][0] == levels[1].rows[0][0]


@pytest.mark.parametrize(("kp", "ki"), [(330, 129), (100, 20), (1500, 100), (600, 600), (200, 100), (383, 234)])
def test_the_loop_that_is_looked_at_is_the_worst(kp, ki):
    points = rs.Envelope(reference=HELD).points(nominal=True)
    control = PI_LEAD.with_design_numbers({"kp": float(kp), "ki": float(ki)})
    loops = [rs.wheel_slip_loop(plant, control) for plant in points.plants]
    ms = [loop.margins().ms if loop.is_stable() else math.inf for loop in loops]
    assert ms[Screen.of(points).hardest(control.system)] == max(ms)


def test_a_map_of_two_numbers_of_any_kind(page):
    start, _ = page.ask("start", design=DESIGN)
    one = start["kinds"]["transfer-function"]
    values = {number["name"]: number["value"] for number in one["sliders"]}
    assert list(values) == ["b2", "b1", "b0", "a2", "a1", "a0"]
    design = {"kind": "transfer-function", "values": values, "reference": HELD}
    ours, theirs = (page.ask("loop", design=one)[0]["ms"] for one in (DESIGN, design))
    assert theirs == pytest.approx(ours, rel=1e-9)  # the PI-lead as a ratio of polynomials
    head, _ = page.ask("region", design=design, axes=["b1", "a1"])
    middle = head["m"][len(head["x"]) // 2][len(head["y"]) // 2]
    assert middle == pytest.approx(ours, rel=1e-9)
    assert None in np.ravel(head["m"]).tolist()


@pytest.mark.parametrize("kind", ["predictive", "seeking", "slide-protection"])
def test_kinds_by_rule_have_their_numbers_and_stops(page, kind):
    start, _ = page.ask("start")
    values = {number["name"]: number["value"] for number in start["kinds"][kind]["sliders"]}
    design = {"kind": kind, "values": values, "reference": HELD}
    head, arrays = page.ask("loop", design=design)
    stops, _ = page.ask("stops", design=design)
    assert "to 5 km/h in" in stops["descriptions"]["wet"]
    if kind == "slide-protection":
        assert "has no margins" in head["no_loop"]
        return
    verdict, _ = page.ask("envelope", design=design)
    control = getattr(rs, kind.title()).for_vehicle(CAR, **({} if kind == "seeking" else {"reference": HELD}))
    worst = rs.judge(ENVELOPE, control, nominal=True).points.plants[head["point"]]
    m = rs.wheel_slip_loop(worst, control).margins()
    assert [head[name] for name in ("ms", "phase_margin_deg", "delay_margin_s")] == [m.ms, m.phase_deg, m.delay_s]
    time, step, load = (arrays[name] for name in ("time", "step", "load"))
    assert arrays["phase"].max() < 0  # deg; an integrator, and at most an unstable pole, then lag
    size = np.hypot(arrays["re"], arrays["im"])
    np.testing.assert_allclose(np.cos(np.radians(arrays["phase"])), arrays["re"] / size, atol=1e-4)
    assert time.size == step.size == load.size == POINTS
    assert 0.14 < time[np.argmax(np.abs(step) > 0)] < 0.18  # s; nothing before the dead time
    assert step[-1] == pytest.approx(1.0, abs=0.02)
    assert abs(load[-1]) < 0.02 * np.abs(load).max()
    assert verdict["line"] == rs.judge(ENVELOPE, control, nominal=True).verdict_line
    point = {**design, "values": {**values, "layer": 10 * values["layer"]}}
    assert page.ask("loop", design=point)[0]["ms"] != head["ms"]


def test_points_are_made_again_only_if_the_slips_change():
    bench = Workbench(ENVELOPE)
    begun = bench.control("seeking", {})
    for one in begun.design_numbers():
        changed = bench.control("seeking", {one.name: 0.98 * one.value})
        new = bench.points(changed)
        again = Workbench(ENVELOPE).points(changed)
        assert new[0] == again[0]
        assert [plant.point for plant in new[1].plants] == [plant.point for plant in again[1].plants], one.name
        assert (bench.points(begun)[1] is new[1]) == (changed.slip_numbers() == begun.slip_numbers())


@pytest.mark.long
def test_tuning_is_that_of_tune(page):
    found = page.ask("tune", design=DESIGN, ms_max=1.8)[0]["values"]
    best = rs.tune(ENVELOPE, "pi-lead", 1.8, nominal=True, lead=0.6, lead_filter=0.06).controller
    assert found == {"kp": best.kp, "ki": best.ki, "lead": 0.6, "lead_filter": best.lead_filter}
    page.refused(
        422,
        "cannot be met.* railslip report names the brake that this vehicle needs$",
        path="tune",
        body=json.dumps({"design": DESIGN, "ms_max": 1.05}).encode(),
    )


def test_files_make_the_same_controller(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    saved = page.ask("file", design=DESIGN, name="controller.toml")[0]["text"]
    (tmp_path / "shaped.toml").write_text(saved, "utf-8")
    judged = rs.judge(ENVELOPE, rs.load_controller("shaped.toml"), nominal=True)
    assert judged.worst.ms == page.ask("loop", design=DESIGN)[0]["ms"]
    script = page.ask("file", design=DESIGN, name="design.py")[0]["text"]
    names = {"__name__": "design"}
    exec(compile(script, "design.py", "exec"), names)
    assert names["controller"].toml == saved
    assert names["envelope"] == ENVELOPE
    exec(compile(script, "design.py", "exec"), {"__name__": "__main__"})
    assert (tmp_path / "controller.toml").read_text("utf-8") == saved


@pytest.mark.parametrize("kind", ["pi", "pid", "predictive", "seeking", "slide-protection", "transfer-function"])
def test_the_script_of_each_kind_runs(page, kind, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    kinds = page.ask("start")[0]["kinds"]
    values = {number["name"]: number["value"] for number in kinds[kind]["sliders"]}
    design = {"kind": kind, "values": values, "reference": HELD}
    script = page.ask("file", design=design, name="design.py")[0]["text"]
    exec(compile(script, "design.py", "exec"), {"__name__": "__main__"})
    told = capsys.readouterr().out
    assert "stop, wet rail" in told
    assert ("Ms <= 2 at" in told) == ("rs.judge" in script) == kinds[kind]["loop"]
    assert rs.load_controller("controller.toml").kind == kind


@pytest.mark.long
def test_the_report_is_of_the_design_that_was_sent(page):
    """The page of the button is well formed and has the worst Ms of `judge`."""
    text = page.ask("file", design=DESIGN, name="report.html")[0]["text"]
    assert text.startswith("<!DOCTYPE html>")
    assert (text.count("<html"), text.rstrip().endswith("</html>")) == (1, True)
    worst = rs.judge(ENVELOPE, PI_LEAD, nominal=True).worst
    shown = " ".join(re.sub(r"<[^>]+>", " ", text).split())
    assert f"pi-lead is stable with every tolerance from 20 km/h up; Ms, sampled: {ms_up(worst.run_ms)}" in shown


def test_a_controller_and_a_law_of_the_user_s_own(tmp_path):
    law = rs.published_law("curve", "dry")
    envelope = rs.Envelope(speeds=100, rails="dry", laws=(law,), loads="empty", reference=HELD)
    with served(Workbench(envelope, PI_LEAD.model_copy(update={"torque_max": 7000.0}))) as client:
        assert client.ask("envelope", design=DESIGN)[0]["verdict"] in ("robust", "fragile")
        assert "torque_max = 7000.0" in client.ask("file", design=DESIGN, name="controller.toml")[0]["text"]
        told = json.dumps({"design": DESIGN, "name": "design.py"}).encode()
        client.refused(422, "save controller.toml", path="file", body=told)


# --- who may ask ------------------------------------------------------------------------------------------------------


def test_only_who_has_the_token_and_comes_from_the_page_is_answered(page):
    good = json.dumps({"design": DESIGN}).encode()
    own = f"127.0.0.1:{page.port}"
    for headers in ({}, {"Origin": f"http://{own}"}, {"Host": f"localhost:{page.port}"}):
        assert page.send(body=good, **headers)[0] == 200
    for sent in (
        {"token": "0" * 40}, {"token": ""}, {"token": page.token[:-1]}, {"token": f"{page.token}%C3%A9"},
        {"Host": "evil.example"}, {"Host": f"evil.example:{page.port}"}, {"Host": "127.0.0.1"},
        {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": f"https://{own}"},
    ):  # fmt: skip
        for method, path in (("POST", "loop"), ("GET", "page.js")):
            status, _, content = page.send(method, path, body=good, **sent)
            assert (status, b"arrays" in content, b"use strict" in content) == (403, False, False), sent
    listening = socket.create_connection(("127.0.0.1", int(page.port)))
    assert listening.getpeername()[0] == "127.0.0.1"
    listening.close()


def test_the_page_loads_nothing_from_elsewhere(page):
    for path, kind in (("", "html"), ("page.css", "css"), ("page.js", "javascript")):
        status, headers, content = page.send("GET", path)
        assert (status, headers["Content-Type"]) == (200, f"text/{kind}; charset=utf-8")
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["Cache-Control"] == "no-store"  # the address has the token
        assert (headers["X-Content-Type-Options"], headers["Referrer-Policy"]) == ("nosniff", "no-referrer")
        assert not re.search(rb"https?://|url\(|@import|innerHTML|eval\(", content)
    for path in ("../server.py", "page.html", "%2e%2e/server.py", "loop"):
        assert page.send("GET", path)[0] == 404


@pytest.mark.parametrize(
    ("body", "status", "told"),
    [
        (b"", 400, "JSON"),
        (b"{", 400, "JSON"),
        (b"\xff\xfe", 400, "JSON"),
        (b"[" * 20_000, 400, "JSON"),
        (b"[]", 400, "JSON object"),
        (b'{"turn": ' + b"9" * 5000 + b"}", 400, "too long a number"),
        (b'{"turn": "x"}', 422, "turn: 'x' is not allowed"),
        (b'{"turn": -1}', 422, "turn: -1 is not allowed"),
        (b'{"turn": true}', 422, "turn: True is not allowed"),
        (b"{}", 422, "give kind"),
        (b'{"design": {"kind": 1, "values": {}}}', 422, "give kind"),
        (b'{"design": {"kind": "pi", "values": {"kp": "1"}}}', 422, "kp: '1' is not allowed"),
        (b'{"design": {"kind": "pi", "values": {"kp": NaN}}}', 422, "kp: nan is not allowed"),
        (b'{"design": {"kind": "pi", "values": {"kp": 1e999}}}', 422, "kp: inf is not allowed"),
        (b'{"design": {"kind": "pi", "values": {"kp": 1e300}}}', 422, r"kp: 1e\+300 .* 1e-12 to 1e\+12"),
        (b'{"design": {"kind": "pi", "values": {"kp": ' + b"9" * 400 + b"}}}", 422, "at most 308 digits"),
        (b'{"design": {"kind": "pi", "values": {"kp": true}}}', 422, "kp: True is not allowed"),
        (b'{"design": {"kind": "pi", "values": {"nonsense": 1}}}', 422, "nonsense: unknown key"),
        (b'{"design": {"kind": "no", "values": {}}}', 422, "kind: 'no' is not offered"),
        (
            b'{"design": {"kind": "pi-lead", "values": {"lead": -1}}}',
            422,
            r"lead: -1 is not allowed; give a value > 0 \(s\)",
        ),
        (b'{"design": {"kind": "pi-lead", "values": {}, "reference": {"dry": 2}}}', 422, "dry|wet"),
        (b'{"design": {"kind": "transfer-function", "values": {"b99": 1}}}', 422, "'b99' .*b0 to b11"),
        (b'{"design": {"kind": "transfer-function", "values": {"b0": 1, "a0": 0}}}', 422, "denominator"),
        (b'{"design": {"kind": "transfer-function", "values": {"b1": 1, "a0": 1}}}', 422, "not proper|proper"),
    ],
    ids=lambda one: str(one)[:60],
)
def test_what_is_no_question_is_refused_in_a_line_and_the_page_goes_on(page, body, status, told):
    page.refused(status, told, body=body)
    assert page.ask("loop", design=DESIGN)[0]["stable"]


@pytest.mark.long
def test_extreme_numbers_are_answered_or_refused(page):
    for name, value in (
        ("kp", 1e12),
        ("kp", -1e12),
        ("ki", 1e12),
        ("ki", 0),
        ("kp", 0),
        ("lead", 1e12),
        ("lead", 1e-12),
    ):
        body = json.dumps({"design": {**DESIGN, "values": {**DESIGN["values"], name: value}}}).encode()
        for what in ("loop", "envelope", "region"):
            status, _, content = page.send(path=what, body=body)
            assert status in (200, 422), (name, value, what, content)


def test_an_address_without_its_last_slash_leads_to_the_page(page):
    connection = http.client.HTTPConnection("127.0.0.1", int(page.port), timeout=60)
    connection.request("GET", f"/{page.token}?x=1")
    answer = connection.getresponse()
    assert (answer.status, answer.headers["Location"], answer.read()) == (308, f"/{page.token}/", b"")
    connection.close()


def test_large_and_shapeless_requests_are_refused(page):
    page.refused(413, "Content-Length", body=b" " * (LARGEST_REQUEST + 1))
    for length in ("-1", "x", "9" * 30):
        page.refused(413, "Content-Length", Content_Length=length)
    page.refused(404, "application/json", body=b"{}", Content_Type="text/plain")  # what a foreign form could send
    page.refused(404, "start, loop", path="nothing", body=b"{}")
    assert page.send("DELETE")[0] == 501


def test_the_newest_question_of_a_tab_wins(page):
    dispatcher = Dispatcher(Workbench(ENVELOPE))
    asked = {"design": DESIGN}
    assert dispatcher.answer("loop", "one tab", 7, asked)
    assert dispatcher.answer("loop", "one tab", 6, asked) is None
    assert dispatcher.answer("loop", "another tab", 1, asked)
    assert dispatcher.answer("start", "one tab", 1, {})
    for i in range(2000):  # tabs that come and go
        dispatcher._newest[f"{i}", "loop"] = 1
    assert dispatcher.answer("loop", "one tab", 8, asked)
    assert len(dispatcher._newest) <= 64 * len(ANSWERS)


@pytest.mark.long
def test_a_thousand_requests_at_once_leave_the_page_alive(page):
    def one(i):
        try:
            token = page.token if i % 2 else "0" * 40
            return page.send(
                path=("loop", "envelope")[i % 4 == 1], body=json.dumps({"design": DESIGN}).encode(), token=token
            )[0]
        except OSError:
            return 0

    with ThreadPoolExecutor(200) as pool:
        found = list(pool.map(one, range(1000)))
    assert set(found) <= {0, 200, 403, 503}
    assert found.count(200) > 100
    silent = [socket.create_connection(("127.0.0.1", int(page.port))) for _ in range(40)]
    assert page.ask("loop", design=DESIGN)[0]["stable"]
    for connection in silent:
        connection.close()


# --- the command, and the notebook ------------------------------------------------------------------------------------


def started(*words, folder):
    code = "from railslip_ctrl.cli import main; main()"
    command = [sys.executable, "-c", code, "design", "--no-browser", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)
    return process, process.stdout.readline().strip()


def ended(process):
    process.send_signal(signal.SIGINT)
    rest, told = process.communicate(timeout=60)
    return process.returncode, rest, told


@pytest.mark.long
def test_the_command_prints_its_address_and_serves_until_it_is_interrupted(tmp_path):
    process, address = started(
        "--rail", "dry", "--speed", "100", "--slip", "0.1", "--kp", "100", "--ki", "10", folder=tmp_path
    )
    head, _ = Client(address).ask("start")
    assert (head["kind"], head["fixed"], head["reference"]) == ("pi", True, {"dry": 0.1, "wet": 0.1})
    assert {one["name"]: one["value"] for one in head["kinds"]["pi"]["sliders"]} == {"kp": 100.0, "ki": 10.0}
    status, rest, told = ended(process)
    assert (status, rest) == (0, "")
    assert told.splitlines()[-1] == "railslip: the page is no longer served"


OWN = """
from railslip_ctrl.controllers.pi import PILead
class Mine(PILead):
    kind = "mine"
CONTROLLER = Mine(kp=330.0, ki=129.0, lead=0.6, lead_filter=0.06)
"""


@pytest.mark.long
@pytest.mark.parametrize("own", [False, True])
def test_an_interrupt_ends_the_command_at_once_whatever_it_computes(tmp_path, own):
    """Reports and verdicts are pending; those of the user's own class are computed in the process of the command."""
    (tmp_path / "mine.py").write_text(OWN, "utf-8")
    process, address = started(*(("--controller", "mine.py") if own else ()), folder=tmp_path)
    client, design = Client(address), {**DESIGN, "kind": "mine" if own else "pi-lead"}
    client.ask("envelope", design=design)

    def ask(i):
        with suppress(OSError, http.client.HTTPException):
            body = json.dumps({"design": design, "client": str(i), "name": "report.html"}).encode()
            client.send(path="file" if i < 2 else "verdict", body=body)

    for i in range(12):
        threading.Thread(target=ask, args=(i,), daemon=True).start()
    time.sleep(3)
    begun = time.monotonic()
    status, _, told = ended(process)
    assert (status, told.splitlines()[0]) == (0, "railslip: the page is no longer served")
    assert time.monotonic() - begun < 3


@pytest.mark.long
def test_a_port_of_one_s_own_keeps_its_token(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    words = ("--rail", "dry", "--speed", "100", "--port", port)
    process, address = started(*words, folder=tmp_path)
    refused, nothing = started(*words, folder=tmp_path)  # the port is taken
    assert (nothing, refused.wait(60)) == ("", 2)
    assert f"error: --port: {port} " in refused.communicate()[1]
    ended(process)
    process, again = started(*words, folder=tmp_path)
    assert again == address
    ended(process)


@pytest.mark.long
def test_a_script_without_a_guard_serves_the_page_too(tmp_path):
    script = f"""
import railslip_ctrl as rs
from test_page import DESIGN, ENVELOPE, Client
with rs.design_page(ENVELOPE) as page:
    for what in ("envelope", "region", "envelope"):
        print(Client(page.address).send(path=what, body={json.dumps({"design": DESIGN})!r}.encode())[0])
"""
    (tmp_path / "mine.py").write_text(script, "utf-8")
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    ran = subprocess.run(
        [sys.executable, "mine.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert ran.stdout.split() == ["200", "200", "200"], ran.stderr


def test_a_notebook_shows_the_page_in_a_frame():
    with rs.design_page(ENVELOPE, rs.tune(ENVELOPE, "pi-lead", 2.0)) as shown:
        client = Client(shown.address)
        assert f'src="{shown.address}"' in shown._repr_html_()
        assert (
            "frame-ancestors http://127.0.0.1:* http://localhost:*"
            in client.send("GET", "")[1]["Content-Security-Policy"]
        )
        head, _ = client.ask("start")
        assert head["kind"] == "pi-lead"
    with pytest.raises(OSError, match="refused"):
        client.send("GET", "")
    with pytest.raises(rs.InputError, match="named parameters"):
        rs.design_page(ENVELOPE, lambda t, v, omega: 0.0)
    with pytest.raises(rs.InputError, match="port: 70000"):
        rs.design_page(ENVELOPE, port=70_000)
