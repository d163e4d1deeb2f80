"""report.html in a real headless browser, at the widths of a phone, of A4 and of a desk, and printed."""

import base64
import re
import shutil

import pytest

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
A4 = 794  # CSS pixels

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(BROWSER is None or DRIVER is None, reason="no chromium with chromium-driver"),
]

# A browser without a network: it looks for nothing by itself.
_FLAGS = ("headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", "no-first-run")
_FLAGS += ("disable-background-networking", "disable-component-update", "disable-sync")

_WIDER = "return document.documentElement.scrollWidth > document.documentElement.clientWidth"
_CUT = """return [...document.querySelectorAll(".scroll")].filter((one) => one.offsetParent !== null
  && one.scrollWidth > one.clientWidth + 1).map((one) => one.innerText.slice(0, 60))"""
_UNSEEN = """return [...document.images].filter((one) => {
  const box = one.getBoundingClientRect();
  return !one.complete || one.naturalWidth === 0 || box.width < 100 || box.height < 50;
}).map((one) => one.alt)"""
_LOADED = """return performance.getEntriesByType("resource").map((one) => one.name)
  .filter((name) => !name.startsWith("data:"))"""
_TORN = """const style = (names, key) => [...document.querySelectorAll(names)].map((one) => getComputedStyle(one)[key]);
return [...style("h2, h3, caption, summary", "breakAfter"), ...style("figure, .short, .finding, tr", "breakInside")]
  .filter((value) => value !== "avoid").concat(style("figure", "float").filter((value) => value !== "left"))"""
_OPEN = 'return [...document.querySelectorAll("details")].filter((one) => one.open).length'


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*_FLAGS, f"user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture
def show(browser, full_report):
    """Shows the page at a width in CSS pixels, and runs scripts in it; nothing is complained of."""

    def shown(width):
        screen = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        browser.get((full_report[0] / "report.html").as_uri())
        assert [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")] == []
        return browser.execute_script

    return shown


@pytest.mark.parametrize("width", [390, A4, 1200])  # of a phone, of a page, of a desk
def test_page_fits_shows_every_figure_and_loads_nothing(show, width):
    """That each link has a target is looked at in the page's text, `html_page`."""
    run = show(width)
    assert (run("return innerWidth"), run(_WIDER), run(_UNSEEN), run(_LOADED)) == (width, False, [], [])
    assert run("return document.images.length") >= 4
    assert run(_CUT) == []
    run("document.querySelector('nav a[href=\"#stops\"]').click()")
    # the section is where the eye is; a pixel of rounding
    assert abs(run("return document.getElementById('stops').getBoundingClientRect().top")) < 2


def test_prints_on_a4_with_everything_opened(browser, show):
    run = show(A4)
    before = run(_OPEN)
    run("dispatchEvent(new Event('beforeprint'))")
    assert run(_OPEN) == run("return document.querySelectorAll('details').length")
    run("dispatchEvent(new Event('afterprint'))")
    assert run(_OPEN) == before == 0
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True, "printBackground": True})
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", base64.b64decode(printed["data"]))
    assert 3 <= len(boxes) <= 12  # beyond, pages are left half-empty, as those before a figure once were
    for width, height in boxes:
        # points; a browser rounds A4 to its own pixels, three quarters of a point each
        assert (float(width), float(height)) == pytest.approx((595.0, 842.0), abs=1.0)


def test_print_is_not_made_smaller_and_keeps_together_what_belongs_together(browser, show):
    run = show(680)  # CSS pixels between the margins of A4, 180 mm: a wider page is printed smaller
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        run("dispatchEvent(new Event('beforeprint'))")
        assert (run(_WIDER), run(_TORN)) == (False, [])
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
