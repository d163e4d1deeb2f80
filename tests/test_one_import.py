"""A design script with names from the top alone: envelope, verdict, tuning, runs and campaigns fit together."""

from __future__ import annotations

import ast

import control as ct
import pytest
from project import ROOT

import railslip_ctrl as rs
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.adhesion import ReferenceSlip

S = ct.tf("s")
MINE = 330 * (1 + 0.02 / S) * (0.6 * S + 1) / (0.06 * S + 1)


@pytest.fixture(scope="module")
def best():
    return rs.tune(rs.Envelope(speeds=(60, 100), laws="curve", reference={"dry": 0.1, "wet": 0.07}))


def test_a_tuned_controller_of_laws_that_hold_different_slips_has_no_file():
    law, slips = rs.published_law("curve", "dry"), [ReferenceSlip(dry=dry, wet=0.07) for dry in (0.08, 0.1)]
    laws = [law.model_copy(update={"reference": held}) for held in slips]
    design = rs.tune(rs.Envelope(laws=laws, speeds=100))
    with pytest.raises(InputError, match="different slips"):
        design.save("never.toml")
    assert rs.simulate(rs.stop(), design).controller.reference.dry == 0.132  # the law's of the run


def test_a_run_tells_what_became_of_it(best):
    run = rs.simulate(rs.stop(rail="wet"), best, seed=7)
    told = str(run)
    assert "stop, wet rail" in told
    assert f"{run.braking_distance:.4g} m" in told
    assert "no lock" in told
    assert len(run.plot().axes) == 4
    relay = rs.LinearControl(1e6 * ct.tf([1], [1]), best.reference, period=0.01, torque_low=0, torque_high=2e4)
    locked = rs.simulate(rs.stop(rail="wet"), relay, record_every=None)
    assert f"locked {100 * locked.locked_fraction:.2g} %" in str(locked)
    with pytest.raises(InputError, match="record_every"):
        locked.plot()


@pytest.mark.parametrize("script", sorted((ROOT / "designs").glob("*.py")), ids=lambda path: path.stem)
def test_a_design_script_needs_names_from_the_top_alone(script):
    """No room is named in an import, so that a room may be rebuilt without its users."""
    tree = ast.parse(script.read_text("utf-8"))
    modules = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    modules += [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    assert {name for name in modules if name.startswith("railslip_ctrl")} == {"railslip_ctrl"}
