"""The page of `railslip design` in headless Chromium: what one can do on it."""

import json
import shutil
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from test_page import ENVELOPE, PI_LEAD, served

import railslip_ctrl as rs
from railslip_ctrl.core.units import ms_down, ms_up
from railslip_ctrl.design.workbench import Workbench

WIDE = rs.Envelope(laws="bristle", loads="empty")
IDLE = "Object.values(requests).every((request) => !request.pending && !request.repeat)"

FLAGS = ("headless=new", "no-sandbox", "disable-gpu", "hide-scrollbars", "window-size=1300,1000")
NAMES = ("chromium", "chromium-browser", "google-chrome")
TEXT = "return document.getElementById(arguments[0]).textContent"


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options, driver = webdriver.ChromeOptions(), shutil.which("chromedriver")
    options.binary_location = next(filter(None, map(shutil.which, NAMES)), "")
    if not (options.binary_location and driver):
        pytest.skip("no chromium with chromium-driver")
    folder = tmp_path_factory.mktemp("downloads")
    for flag in (*FLAGS, f"user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with webdriver.Chrome(options=options, service=Service(driver)) as found:
        found.folder = folder
        found.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(folder)})
        yield found


class Tab:
    """The page in a browser."""

    def __init__(self, driver, address):
        self.driver = driver
        if address is not None:
            driver.get(address)
        self.until("return document.getElementById('ms').textContent", lambda ms: ms != "…")

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def until(self, script, holds=bool, seconds=60):
        end = time.monotonic() + seconds
        while not holds(found := self.run(script)):
            assert time.monotonic() < end, (script, found, self.text("message"))
            time.sleep(0.05)
        return found

    def text(self, name):
        return self.run(TEXT, name)

    def number(self, name):
        return float(self.text(name).replace("−", "-").split()[0].rstrip("°"))

    def settled(self):
        shown = "!document.getElementById('answer').classList.contains('stale')"
        self.until(f"return verdict !== null && {IDLE} && {shown}")
        return self

    def type(self, name, text):
        field = self.driver.find_element("id", name)
        field.clear()
        field.send_keys(text)
        field.send_keys("\t")

    def complaints(self):
        return [one["message"] for one in self.driver.get_log("browser") if one["level"] in ("SEVERE", "WARNING")]


@pytest.fixture(scope="module")
def wide():
    with served(Workbench(WIDE, PI_LEAD)) as client:
        yield client


@pytest.fixture
def tab(chromium, wide):
    chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    chromium.get("about:blank")
    found = Tab(chromium, f"http://127.0.0.1:{wide.port}/{wide.token}/")
    yield found
    assert found.complaints() == []


def drag(tab, *steps):
    from selenium.webdriver.common.action_chains import ActionChains

    chain = (
        ActionChains(tab.driver, duration=20)
        .move_to_element(tab.driver.find_element("id", "gain-map"))
        .click_and_hold()
    )
    for step in steps:
        chain.move_by_offset(*step)
    chain.release().perform()


@pytest.mark.long
def test_dragging_changes_the_gains_and_every_answer_follows(tab):
    tab.until("return region !== null && region.levels.length > 3")
    before = tab.run("return {...design.values}")
    drag(tab, (20, 10), (30, -20))
    after = tab.settled().run("return {...design.values}")
    assert after["kp"] != before["kp"]
    assert after["ki"] != before["ki"]
    judged = rs.judge(WIDE, PI_LEAD.with_design_numbers(after))
    assert tab.text("verdict") == judged.verdict_line
    assert tab.text("ms") == ms_up(judged.worst.ms)
    assert tab.number("phase-margin") == pytest.approx(judged.worst.margins.phase_deg, rel=5e-3)
    assert tab.number("delay-margin") == pytest.approx(judged.worst.margins.delay_s, rel=5e-3)
    assert tab.run("return document.getElementById('verdict').className") == judged.verdict
    drawn = """const one = document.getElementById(arguments[0]);
      return new Set(one.getContext('2d').getImageData(0, 0, one.width, one.height).data).size"""
    for name in ("gain-map", "nyquist", "bode", "step", "stop", "envelope-map"):
        assert tab.run(drawn, name) > 10, name
    tab.driver.find_element("id", "undo").click()
    assert tab.run("return {...design.values}") == before
    tab.driver.find_element("id", "redo").click()
    assert tab.run("return {...design.values}") == after


@pytest.mark.long
def test_the_keyboard_alone_suffices(tab):
    from selenium.webdriver.common.keys import Keys

    tab.until("return region !== null && region.levels.length > 3")
    focused, seen = "return document.activeElement.id || document.activeElement.tagName", []
    body = tab.driver.find_element("tag name", "body")
    for _ in range(60):
        body.send_keys(Keys.TAB)
        seen.append(tab.run(focused))
        body = tab.driver.switch_to.active_element
        if seen[-1] == "BODY" or seen.count(seen[0]) > 1:
            break
    wanted = {
        "kp",
        "ki",
        "kp-slider",
        "kind",
        "best",
        "most",
        "undo",
        "pin",
        "copy",
        "save",
        "script",
        "report",
        "gain-map",
        "nyquist",
        "stop",
    }
    assert wanted - {"undo"} <= set(seen)
    map_, (kp, ki) = tab.driver.find_element("id", "gain-map"), tab.run("return [design.values.kp, design.values.ki]")
    map_.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_DOWN)
    assert tab.run("return [design.values.kp, design.values.ki]") == pytest.approx([1.02 * kp, ki / 1.02], rel=1e-6)
    map_.send_keys(Keys.SHIFT + Keys.ARROW_RIGHT)
    map_.send_keys(Keys.ALT + Keys.ARROW_RIGHT)
    assert tab.run("return design.values.kp") == pytest.approx(1.02 * kp * 1.1 * 1.002, rel=1e-6)
    tab.driver.find_element("id", "bode").send_keys(Keys.ARROW_RIGHT)
    assert "rad/s" in tab.text("bode-read")
    unnamed = """return [...document.querySelectorAll("input, select, button, canvas")].filter((one) => one.offsetParent
      && !(one.getAttribute("aria-label") || one.textContent.trim() || one.labels?.length)).map((one) => one.id)"""
    assert tab.run(unnamed) == []


@pytest.mark.long
def test_hovering_reads_values_and_a_pinned_design_stays(tab):
    from selenium.webdriver.common.action_chains import ActionChains

    tab.settled()
    for name, told in (
        ("nyquist", "rad/s: L ="),
        ("bode", " dB, "),
        ("step", "after the step"),
        ("stop", "km/h, slip"),
        ("envelope-map", "any controller"),
    ):
        canvas = tab.driver.find_element("id", name)
        ActionChains(tab.driver).move_to_element_with_offset(canvas, 10, 5).perform()
        assert told in tab.text(f"{name}-read"), name
    stale = "takeEnvelope(envelope, arguments[0]); return document.getElementById('answer').classList.contains('stale')"
    assert [tab.run(stale, outdated) for outdated in (True, False)] == [True, False]
    tab.driver.find_element("id", "pin").click()
    tab.type("kp", "250")
    assert tab.run("return [pinned.design.values.kp === design.values.kp, design.values.kp]") == [False, 250]


@pytest.mark.long
def test_what_is_typed_wrong_costs_nothing(tab):
    tab.settled()
    tab.type("kp", "300")
    tab.type("ki", "12x")
    assert "ki, N·m/m: “12x” is not a number" in tab.text("message")
    assert tab.run("return [design.values.kp, document.getElementById('ki').getAttribute('aria-invalid')]") == [
        300,
        "true",
    ]
    tab.type("ki", "1e300")
    tab.until("return document.getElementById('message').textContent", lambda told: "1e+300" in told)
    tab.type("ki", "55")
    tab.settled()
    assert tab.text("message") == ""
    tab.type("ms-max", "0.5")
    tab.driver.find_element("id", "most").click()
    assert "Ms ≤: “0.5” is not allowed" in tab.text("message")
    tab.driver.get_log("browser")  # a refused question is one there


@pytest.mark.long
def test_the_address_has_the_whole_design(chromium, wide, tab):
    tab.type("kp", "290")
    tab.type("slip-wet", "0.06")
    tab.until("return location.hash", lambda words: "kp=290" in words and "slip.wet=0.06" in words)
    address = tab.driver.current_url
    chromium.get("about:blank")
    again = Tab(chromium, address)
    assert again.run("return [design.values.kp, design.values.ki, design.reference.wet]") == [290, 129, 0.06]
    wrong = address.replace("kp=290", "kp=much&nonsense=3&slip.dry=5").replace("lead=0.6", "lead=0.5")
    chromium.get("about:blank")
    again = Tab(chromium, wrong)
    told = again.text("message")
    assert "kp: “much” is not a number" in told
    assert "slip.dry: “5” is not between 0 and 1" in told
    assert again.run("return design.reference.dry") == 0.1
    assert "pi-lead" in told
    assert "“nonsense”" in told
    assert again.run("return design.values.lead") == 0.5
    chromium.get("about:blank")
    again = Tab(chromium, f"{address.partition('#')[0]}#kind=pi&kp=80&ki=2")
    assert again.run("return [design.kind, design.values]") == ["pi", {"kp": 80, "ki": 2}]


@pytest.mark.long
def test_the_saved_file_is_what_other_commands_take(chromium, tab, railslip):
    tab.type("kp", "310")
    tab.settled()
    for button, name in (("save", "controller.toml"), ("script", "design.py")):
        (chromium.folder / name).unlink(missing_ok=True)
        tab.driver.find_element("id", button).click()
        end = time.monotonic() + 30
        while not (chromium.folder / name).exists() and time.monotonic() < end:
            time.sleep(0.05)
        assert ("--envelope default, with the --vehicle" in tab.text("message")) == (name == "controller.toml")
    words = (
        "--adhesion",
        "bristle",
        "--envelope",
        "default",
        "--controller",
        chromium.folder / "controller.toml",
        "--json",
    )
    status, out, err = railslip("margins", *words)
    worst = json.loads(out)["worst"]["ms"]  # both loads of the published vehicle have one wheel load: empty is worse
    assert status == 0, err
    assert tab.text("ms") == ms_up(worst)
    status, out, err = railslip(
        "simulate", "--scenario", "stop", "--controller", chromium.folder / "controller.toml", "--json"
    )
    assert (status, json.loads(out)["stopped"]) == (0, True), err
    assert "kp': 310" in (chromium.folder / "design.py").read_text("utf-8")


@pytest.mark.long
def test_buttons_find_gains(tab):
    tab.settled()
    tab.type("ms-max", "1.8")
    tab.driver.find_element("id", "most").click()
    tab.until("return document.getElementById('most').disabled")
    tab.until("return !document.getElementById('most').disabled")
    assert tab.settled().number("ms") == pytest.approx(1.77, abs=0.04)  # 1.8 as it runs, sampled
    ki = tab.run("return design.values.ki")
    tab.driver.find_element("id", "best").click()
    tab.until("return document.getElementById('best').disabled")
    tab.until("return !document.getElementById('best').disabled")
    assert tab.settled().number("ms") < 1.45
    assert tab.run("return design.values.ki") < ki
    tab.driver.find_element("id", "rule").click()
    assert tab.run("return design.values.kp") == 330


@pytest.mark.long
@pytest.mark.parametrize("kind", ["pi", "pid", "predictive", "seeking", "slide-protection", "transfer-function"])
def test_every_kind_is_shaped(tab, kind):
    set_ = (
        "const one = document.getElementById(arguments[0]); one.value = arguments[1]; one.dispatchEvent(new Event({}))"
    )
    tab.run(set_.format("'change'"), "kind", kind)
    tab.until(f"return design.kind === '{kind}' && stops !== null && {IDLE}")
    assert tab.driver.find_element("id", "best").is_displayed() == (kind in ("pi", "pid"))
    first = tab.run("return Object.keys(design.values)[0]")
    tab.run(set_.format("'input'"), f"{first}-slider", 520)
    tab.until(f"return {IDLE} && !document.getElementById('answer').classList.contains('stale')")
    assert "braking" in tab.text("verdict") if kind == "slide-protection" else tab.text("verdict") != "…"
    if kind == "transfer-function":
        tab.type("num", "200, 40")
        tab.type("den", "0.06, 1, 0")
        tab.settled()
        assert tab.run("return design.values") == {"b1": 200, "b0": 40, "a2": 0.06, "a1": 1, "a0": 0}
        tab.type("num", "1, a")
        assert "Numerator: give" in tab.text("message")
        tab.run(set_.format("'change'"), "kind", "pi")
        assert tab.text("message") == ""


def test_numbers_are_rounded_as_in_the_verdict_and_an_axis_has_two_ticks(tab):
    values = [1.0, 1.4141, 1.995001, 2.0, 2.0000001, 2.005, 12.3412, 99.991]
    told = tab.run("return arguments[0].map((ms) => [msText(ms), boundText(ms)])", values)
    assert told == [[ms_up(ms), ms_down(ms)] for ms in values]
    axes = [[80, 880, False, 4], [400, 640, True, 4], [-1.5, 6.5, False, 4], [520, 580, True, 3], [1, 1e9, True, 3]]
    for found in tab.run("return arguments[0].map(([low, high, ...rest]) => ticksOf([low, high], ...rest))", axes):
        assert 2 <= len(found) <= 12


def test_a_change_of_kind_leaves_nothing_of_the_old_kind(tab):
    change = "$('kind').value = arguments[0]; chooseKind();"
    seen = "[...document.querySelectorAll('.sampled-too')].map((each) => !each.hidden)"
    slips = "[$('slip-dry-slider'), $('slip-wet')].map((each) => each.disabled)"
    for kind, sampled, own in (("pi", True, False), ("seeking", False, True), ("slide-protection", False, True)):
        found = tab.run(f"{change} dragTo({{clientX: 9, clientY: 9}}); return [{seen}, {slips}]", kind)
        assert found == [[sampled] * 3, [own] * 2], kind  # a drag before the new map comes has no effect
        assert tab.text("map-read") == ""
        assert tab.driver.find_element("id", "own-slip").is_displayed() == own


@pytest.mark.long
@pytest.mark.parametrize(("width", "dark"), [(390, False), (390, True), (800, False), (1300, True)])
def test_it_fits_phones_tables_and_desks(chromium, tab, width, dark):
    screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
    tab.settled()
    assert tab.run("return [innerWidth, document.documentElement.scrollWidth]") == [width, width]
    wider = """return [...document.querySelectorAll("main *")].filter((one) => one.offsetParent
      && one.getBoundingClientRect().right > innerWidth + 1).map((one) => one.id || one.tagName)"""
    assert tab.run(wider) == []
    corner = "return [...document.getElementById('nyquist').getContext('2d').getImageData(1, 1, 1, 1).data].slice(0, 3)"
    assert (sum(tab.run(corner)) < 150) == dark
    tab.run("const one = document.getElementById('kind'); one.value = 'slide-protection'; chooseKind()")
    tab.until("return kindNow().loop === false && stops !== null")
    scheme[0]["value"] = "light" if dark else "dark"
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
    tab.until(f"return colours.paper === '{'#ffffff' if dark else '#14171c'}'")
    for name in ("envelope-map", "gain-map"):
        assert (sum(tab.run(corner.replace("nyquist", name))) < 150) != dark
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


@pytest.mark.long
def test_two_tabs_do_not_disturb_each_other(chromium, wide, tab):
    first = chromium.current_window_handle
    tab.type("kp", "280")
    chromium.switch_to.new_window("tab")
    other = Tab(chromium, f"http://127.0.0.1:{wide.port}/{wide.token}/")
    other.type("kp", "420")
    found = {420: other.settled().text("ms")}
    chromium.close()
    chromium.switch_to.window(first)
    found[280] = tab.settled().text("ms")
    envelope = WIDE
    for kp, ms in found.items():
        control = PI_LEAD.with_design_numbers({"kp": float(kp), "ki": tab.run("return design.values.ki")})
        assert ms == ms_up(rs.judge(envelope, control, nominal=True).worst.ms)


@pytest.mark.long
def test_the_page_left_open_goes_on_when_the_server_is_there_again(chromium):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    bench = Workbench(ENVELOPE)
    with served(bench, port) as client:
        chromium.get("about:blank")
        tab = Tab(chromium, f"http://127.0.0.1:{port}/{client.token}/").settled()
        before = tab.text("ms")
    tab.type("kp", "250")
    tab.until("return document.getElementById('message').textContent", lambda told: "does not answer" in told)
    tab.type("ki", "60")
    assert tab.run("return [design.values.kp, design.values.ki]") == [250, 60]
    with served(bench, port):
        tab.until("return document.getElementById('message').hidden")
        tab.settled()
        assert tab.text("ms") != before
    chromium.get("about:blank")
    chromium.get_log("browser")


@pytest.mark.long
def test_it_works_in_the_frame_of_a_notebook(chromium, wide):
    class Notebook(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()
            self.wfile.write(f'<iframe src="http://127.0.0.1:{wide.port}/{wide.token}/" height=900></iframe>'.encode())

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Notebook) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        chromium.get("about:blank")
        chromium.get(f"http://localhost:{server.server_port}/")
        chromium.switch_to.frame(0)
        assert float(Tab(chromium, None).settled().text("ms")) > 1
        chromium.switch_to.default_content()
        chromium.get("about:blank")
        server.shutdown()


@pytest.mark.long
def test_an_old_address_says_what_to_do(chromium, wide):
    chromium.get(f"http://127.0.0.1:{wide.port}/{'0' * 40}/")
    assert "printed address" in chromium.find_element("tag name", "body").text
    chromium.get_log("browser")
