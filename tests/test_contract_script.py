"""A design script from start to end, on a coach whose file has its envelope: the length of the way is the promise."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from project import ROOT

SCRIPT = """
import control as ct
import railslip_ctrl as rs

car = rs.load_vehicle("coach.toml")
envelope = rs.Envelope(car, speeds=range(10, 101, 10))        # rails, laws, loads, slip, tolerances: the defaults
s = ct.tf("s")
mine = 240 * (1 + 0.02 / s) * (0.6 * s + 1) / (0.05 * s + 1)  # N*m/(m/s)

check = rs.judge(mine, envelope)        # over every point, exact
print(check)
check.map.plot()                        # worst Ms over speed and load
loop = rs.wheel_slip_loop(check.worst.point, mine)
loop.bode_plot(); loop.nyquist_plot()

best = rs.tune(envelope, structure="pi-lead", ms_max=2.0)
best.save("best.toml")                  # what every command takes with --controller
run = rs.simulate(rs.stop(car, "wet", speed_kmh=100), best, seed=7)
print(run); run.plot()
many = rs.campaign(rs.stop(car, "wet"), [mine, best], runs=8)
print(many.table())
"""


@pytest.mark.long
def test_the_script_runs_from_start_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    for path in (ROOT / "designs" / "vehicles").iterdir():
        (tmp_path / path.name).write_text(path.read_text("utf-8"), "utf-8")
    monkeypatch.chdir(tmp_path)
    found: dict = {}
    exec(SCRIPT, found)
    plt.close("all")
    assert found["envelope"].reference.dry == 0.1  # of the file
    assert found["check"].verdict == "unstable"
    # of the loop that runs: with less ki than Ms 2 of the continuous one leaves
    assert 1.95 < found["best"].judgement.worst.ms < 2.0
    assert found["best"].judgement.verdict == "robust"
    assert found["run"].stopped
    assert found["run"].braking_distance < found["many"].controllers["transfer-function-of-order-2"].measures[
        "braking_distance_m"].moments.low  # fmt: skip
    assert "8 of 8" in capsys.readouterr().out
