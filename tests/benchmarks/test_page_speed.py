"""From the slider to the painted frame: the design page beside a Bokeh server that does the same work, in one run.

Each step moves the gain kp: four plots of 600 points and exact margins. The aim is 30 ms in the median and 60 ms at
95 % of two cores that do nothing else. Without Bokeh, which is no dependency, only the page is measured.
"""

import importlib.util
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from test_page_browser import Tab, chromium  # noqa: F401  # a fixture

import railslip_ctrl as rs

STEPS = 60
OURS = """const done = arguments[2], slider = document.getElementById(arguments[1]), times = [];
const next = () => {
  if (times.length === arguments[0]) return done(times);
  const begin = performance.now();
  const seen = new MutationObserver(() => {
    seen.disconnect();
    requestAnimationFrame(() => setTimeout(() => { times.push(performance.now() - begin); setTimeout(next, 50); }));
  });
  seen.observe(document.body, { attributes: true, attributeFilter: ["data-painted"] });
  slider.value = 400 + 2 * times.length;
  slider.dispatchEvent(new Event("input"));
};
next();"""
THEIRS = """const done = arguments[1], page = Bokeh.documents[0], times = [];
const slider = page.get_model_by_name("kp"), told = page.get_model_by_name("ms");
const next = () => {
  if (times.length === arguments[0]) return done(times);
  const begin = performance.now();
  const seen = () => {
    told.properties.text.change.disconnect(seen);
    requestAnimationFrame(() => setTimeout(() => { times.push(performance.now() - begin); setTimeout(next, 50); }));
  };
  told.properties.text.change.connect(seen);
  slider.value = 300 + times.length;
};
next();"""

SOON = """const done = arguments[2], begin = performance.now(), slider = document.getElementById(arguments[0]);
envelope = stops = null;
slider.value = arguments[1];
slider.dispatchEvent(new Event("input"));
const look = () => (envelope && stops ? done(performance.now() - begin) : setTimeout(look, 2));
look();"""


def told(name: str, times: list[float]) -> float:
    median, most = np.percentile(times[5:], [50, 95])
    print(f"\n{name}: slider to painted frame {median:.1f} ms, 95 % within {most:.1f} ms")
    return float(median)


def followed(chromium, name):  # noqa: F811
    times = [chromium.execute_async_script(SOON, name, 480 + i) for i in range(9)]
    print(f"envelope and braking runs: {np.median(times):.0f} ms, the longest {max(times):.0f} ms")


def test_slider_to_painted_frame(chromium, tmp_path):  # noqa: F811
    chromium.set_script_timeout(120)
    held = {"dry": 0.1, "wet": 0.07}
    with rs.design_page(rs.Envelope(reference=held)) as page:
        tab = Tab(chromium, page.address).settled()
        tab.until("return region && !region.few", seconds=120)
        ours = told("design page", chromium.execute_async_script(OURS, STEPS, "kp-slider"))
        followed(chromium, "kp-slider")
        for kind in ("predictive", "seeking"):
            tab.run("document.getElementById('kind').value = arguments[0]; chooseKind()", kind)
            tab.until(f"return design.kind === '{kind}' && region && region.m", seconds=120)
            tab.settled()
            told(kind, chromium.execute_async_script(OURS, STEPS, "layer-slider"))
            followed(chromium, "layer-slider")
    if importlib.util.find_spec("bokeh") is None:
        pytest.skip("no Bokeh to compare with; pip install bokeh")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    app = Path(__file__).with_name("bokeh_page.py")
    command = [sys.executable, "-m", "bokeh", "serve", "--port", str(port), str(app)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            for _ in range(120):
                time.sleep(0.5)
                try:
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/bokeh_page").read()
                    break
                except OSError:
                    continue
            chromium.get(f"http://127.0.0.1:{port}/bokeh_page")
            ready = "return Boolean(window.Bokeh?.documents[0]?.get_model_by_name('ms'))"
            while not chromium.execute_script(ready):
                time.sleep(0.2)
            time.sleep(2)
            theirs = told("Bokeh server", chromium.execute_async_script(THEIRS, STEPS))
        finally:
            server.terminate()
    assert ours < theirs
