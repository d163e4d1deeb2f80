"""Draw the page of `railslip design` in headless Chromium, for README.md and the site.

python docs/page_picture.py PICTURE.png
"""

from __future__ import annotations

import shutil
import sys
import time
from pathlib import Path
from typing import Any

import railslip_ctrl as rs

WIDTH, HEIGHT = 1300, 1400  # CSS pixels of the window: room for the maps and the four plots
SECONDS = 120.0  # longest time to wait for the answers of the server
BUSY = "return verdict === null || !region || region.few || Object.values(requests).some((request) => request.pending)"
SHAPED = "pin(); Object.assign(design.values, {kp: 365, ki: 120}); designChanged(true)"


def browser() -> Any:
    """Return headless Chromium; chromedriver must be installed."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome") or ""
    for flag in ("headless=new", "no-sandbox", "disable-gpu", "hide-scrollbars", f"window-size={WIDTH},{HEIGHT}"):
        options.add_argument(f"--{flag}")
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    screen = {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    return driver


def settled(tab: Any) -> None:
    """Wait until the page has received every answer from the server, at most `SECONDS`."""
    end = time.monotonic() + SECONDS
    time.sleep(1.0)  # until the page has sent its requests
    while tab.execute_script(BUSY) and time.monotonic() < end:
        time.sleep(0.2)


def picture(path: Path) -> None:
    """Draw the published vehicle at smaller reference slips: gains of the rule in grey, and gains with a smaller ki."""
    reference = rs.ReferenceSlip(dry=0.1, wet=0.07)
    with rs.design_page(rs.Envelope(reference=reference)) as page, browser() as tab:
        tab.get(page.address)
        settled(tab)
        tab.execute_script(SHAPED)
        settled(tab)
        tab.save_screenshot(str(path))


if __name__ == "__main__":
    picture(Path(sys.argv[1]))
