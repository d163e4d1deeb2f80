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

from railslip_ctrl import plots
from railslip_ctrl.parameters import PARK2008
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.reaching_bound import least_gain, reference_set

PROBE = """
import json
from railslip_ctrl.parameters import PARK2008
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.gains import PUBLISHED_LAW
from railslip_ctrl.sliding.lyapunov_conditions import lyapunov_conditions
from railslip_ctrl.sliding.reaching_bound import least_gain, reference_set
found = {one.name: one.holds for one in lyapunov_conditions(PARK2008, PUBLISHED_LAW, seed=1)}
found["K_min"] = least_gain(PARK2008, reference_set(PARK2008, sigmas=1.0))
print(json.dumps(found))
"""


@pytest.mark.parametrize(
    ("old", "new", "changed"),
    [
        ("+ Ta - Tb - Td + Tr)  # (3)", "+ Ta + Tb - Td + Tr)  # (3)", {"derivation"}),
        ("-Fa - Fr - Tr / r)  # (4)", "-Fa - Fr + Tr / r)  # (4)", {"derivation", "K_min"}),
        ("-Fa - Fr - Tr / r)  # (4)", "Fa - Fr - Tr / r)  # (4)", {"derivation", "closed loop identity"}),
    ],
)
def test_a_flipped_sign_of_the_plant_is_noticed(tmp_path, old, new, changed):
    """The plant of a scratch copy is changed; the probe fails or its verdicts change."""
    shutil.copytree(ROOT / "railslip_ctrl", tmp_path / "railslip_ctrl", ignore=shutil.ignore_patterns("__pycache__"))
    target = tmp_path / "railslip_ctrl" / "plant.py"
    text = target.read_text(encoding="utf-8")
    assert text.count(old) == 1
    target.write_text(text.replace(old, new), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", PROBE], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        assert "Error" in done.stderr
        return
    found = json.loads(done.stdout)
    true = {name: VERDICTS[name] for name in found if name in VERDICTS}
    true["K_min"] = least_gain(PARK2008, reference_set(PARK2008, sigmas=1.0))
    different = {
        name for name, value in found.items() if value != (pytest.approx(true[name]) if name == "K_min" else true[name])
    }
    assert changed <= different
    assert derive().all_checked  # the real one


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
