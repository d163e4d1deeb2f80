"""A flipped sign of the plant is noticed by the conditions; the published law's script."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import pytest
from project import ROOT, script, show
from test_verification import VERDICTS

from railslip_ctrl.report import plots

PROBE = """
import json, sys
from pathlib import Path

sys.dont_write_bytecode = True  # of one text of the plant would be taken for another's


def probe(text):
    Path("railslip_ctrl/model/plant.py").write_text(text, encoding="utf-8")
    for name in [name for name in sys.modules if name.startswith("railslip_ctrl")]:
        del sys.modules[name]
    from railslip_ctrl.model.parameters import PARK2008
    from railslip_ctrl.sliding.law import PUBLISHED_LAW
    from railslip_ctrl.verification.published_law import lyapunov_conditions
    from railslip_ctrl.verification.reaching import least_gain, reference_set

    found = {one.name: one.holds for one in lyapunov_conditions(PARK2008, PUBLISHED_LAW, seed=1)}
    return found | {"K_min": least_gain(PARK2008, reference_set(PARK2008, sigmas=1.0))}


def outcome(text):
    try:
        return probe(text)
    except Exception as error:
        return {"error": repr(error)}


print(json.dumps([outcome(text) for text in json.load(sys.stdin)]))
"""

FLIPS = (
    ("+ Ta - Tb - Td + Tr)  # (3)", "+ Ta + Tb - Td + Tr)  # (3)", {"derivation"}),
    ("-Fa - Fr - Tr / r)  # (4)", "-Fa - Fr + Tr / r)  # (4)", {"derivation", "K_min"}),
    ("-Fa - Fr - Tr / r)  # (4)", "Fa - Fr - Tr / r)  # (4)", {"derivation", "closed loop identity"}),
)


@pytest.fixture(scope="module")
def probed(tmp_path_factory):
    """What a scratch copy of the package says, as it is and with each of `FLIPS` in its plant.

    One process, which imports the copy anew for each.
    """
    folder = tmp_path_factory.mktemp("flipped")
    ignore = shutil.ignore_patterns("plant.*.pyc")  # the other modules stay compiled
    shutil.copytree(ROOT / "railslip_ctrl", folder / "railslip_ctrl", ignore=ignore)
    text = (folder / "railslip_ctrl" / "model" / "plant.py").read_text(encoding="utf-8")
    assert all(text.count(old) == 1 for old, _, _ in FLIPS)
    asked = json.dumps([text, *(text.replace(old, new) for old, new, _ in FLIPS)])
    command, environment = [sys.executable, "-c", PROBE], {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, input=asked, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


@pytest.mark.parametrize("which", range(len(FLIPS)), ids=[new for _, new, _ in FLIPS])
def test_a_flipped_sign_of_the_plant_is_noticed(probed, which):
    """The plant of a scratch copy is changed; the probe fails or its verdicts change."""
    sound, found, changed = probed[0], probed[1 + which], FLIPS[which][2]
    assert sound == {name: VERDICTS[name] for name in sound if name in VERDICTS} | {"K_min": sound["K_min"]}
    if "error" in found:
        return
    different = {name for name, value in found.items() if value != pytest.approx(sound[name])}
    assert changed <= different


def test_asmc_published(tmp_path, capsys, monkeypatch):
    module = script("designs/asmc_published.py")
    si, published = module.run()
    assert si.from_surface == pytest.approx(60.35 / 0.43 * 1.54)
    assert published.proportional_gain == pytest.approx(783.6, abs=0.05)
    for reading in (si, published):
        assert reading.least_K[0] > 6.5 * reading.K
        assert reading.feed_forward > 60 * reading.K
        assert reading.integral_gain < 10
    assert si.reaching_time == pytest.approx(6.5, abs=0.05)
    assert published.reaching_time == pytest.approx(3.6 * si.reaching_time)
    for reading in (si, published):
        assert reading.least_K_run[0] > reading.least_K[0]
    drawn, save = [], plots.save_figure
    monkeypatch.setattr(plots, "save_figure", lambda figure, path: (drawn.append(figure), save(figure, path)))
    show(module, (si, published), tmp_path, monkeypatch)
    assert "far too small to make it slide" in capsys.readouterr().out
    assert (tmp_path / "asmc_published.png").exists()
    # D is no longer than a line beside the PI's gain: the number stands at the bar
    assert "5.508" in [text.get_text() for text in drawn[0].axes[1].texts]
