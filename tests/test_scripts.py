"""The scripts of designs/, run and their numbers asserted."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from railslip_ctrl.parameters import Rail

ROOT = Path(__file__).resolve().parent.parent


def script(path: str):
    """Import a script by its path, as a reader would run it."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_pi_published(tmp_path, capsys, monkeypatch):
    module = script("designs/pi_published.py")
    result = module.run()
    for rail in Rail:
        assert result.si[rail].unstable_poles == 2
        _low, high = result.si[rail].stabilizing_gain_range
        assert high < 0.32 < 1  # a third of the published gain, at the most, would hold
    assert result.as_published[Rail.DRY].margins.phase_deg == pytest.approx(6.376, abs=1e-3)
    assert result.as_published[Rail.WET].margins.phase_deg == pytest.approx(8.238, abs=1e-3)
    monkeypatch.setattr(sys, "argv", ["pi_published.py", str(tmp_path)])
    module.main()
    assert len(list(tmp_path.glob("*.png"))) == 3
    assert capsys.readouterr().out.count("Verdict:") == 4


def test_pi_dry(capsys):
    module = script("designs/pi_dry.py")
    design = module.run()
    assert design.proportional_range == pytest.approx((127.4, 573.1), abs=0.06)
    assert design.crossover == pytest.approx(0.7982, abs=5e-5)
    assert design.shaped.margins.phase_deg == pytest.approx(10.01, abs=5e-3)
    assert design.rounded.margins.ms == pytest.approx(5.579, abs=5.1e-4)  # oracles.md of the project's specification
    assert not design.shaped.margins.ms < 2
    module.main()
    assert "stable but fragile" in capsys.readouterr().out


def test_pi_wet_needs_the_dry_gains_when_the_rail_dries(capsys):
    module = script("designs/pi_wet.py")
    design = module.run()
    assert design.wet.margins.ms == pytest.approx(2.18, abs=5e-3)
    assert not design.same_on_dry.stable
    assert design.holding.worst_ms == pytest.approx(5.502, abs=5.1e-4)
    module.main()
    assert "One PI for both rails" in capsys.readouterr().out
