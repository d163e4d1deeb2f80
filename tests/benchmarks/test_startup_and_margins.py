"""Start-up of the command against `import control`, and one loop's margins. Run with `make benchmark`.

Ratios in one run, against a peer; the ordinary tests do not time anything.
"""

from __future__ import annotations

import io
import os
import statistics
import subprocess
import sys
import tarfile
import time
import timeit
from pathlib import Path

import control as ct
import pytest

from railslip_ctrl import DeadTimeLoop

S = ct.tf("s")


def seconds(command: list[str], rounds: int = 7) -> float:
    """Median wall time of a process, one warm-up first."""
    times = []
    for _ in range(rounds + 1):
        begin = time.perf_counter()
        subprocess.run(command, capture_output=True, check=False)
        times.append(time.perf_counter() - begin)
    return statistics.median(times[1:])


@pytest.mark.benchmark(group="start-up")
def test_margins_command_against_import_control(benchmark):
    peer = seconds([sys.executable, "-c", "import control"])
    ours = benchmark.pedantic(seconds, args=([sys.executable, "-m", "railslip_ctrl", "margins"],), rounds=1)
    print(f"\nrailslip margins {ours:.2f} s, import control {peer:.2f} s, ratio {ours / peer:.2f}")
    assert ours / peer <= 1.6


AS_IT_WAS = "5de5618"
"""The last commit before the engine decided by isolated roots: the nodes of a grid separated its crossovers."""

SLIP_LOOP = 1.2 * (8 * S + 1) / (8 * S) / (S - 0.25) / (0.6 * S + 1)
ALONE = """
import time
import control as ct
from railslip_ctrl import DeadTimeLoop
s = ct.tf("s")
system = 1.2 * (8 * s + 1) / (8 * s) / (s - 0.25) / (0.6 * s + 1)
times = []
for _ in range(60):
    begin = time.perf_counter()
    DeadTimeLoop(system, 0.15).margins()
    times.append(time.perf_counter() - begin)
print(min(times))
"""


def seconds_as_it_was(folder) -> float | None:
    """Least time of one loop's margins by the engine as it was; None where its commit is not at hand."""
    root = Path(__file__).parents[2]
    archive = subprocess.run(
        ["git", "-C", root, "archive", AS_IT_WAS, "railslip_ctrl"], capture_output=True, check=False
    )
    if archive.returncode:
        return None
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(folder, filter="data")
    run = subprocess.run(
        [sys.executable, "-c", ALONE], env=os.environ | {"PYTHONPATH": str(folder)}, capture_output=True
    )
    return float(run.stdout)


@pytest.mark.benchmark(group="margins")
def test_certificate_of_one_loop(benchmark):
    loop = DeadTimeLoop(SLIP_LOOP, 0.15)
    margins = min(timeit.repeat(lambda: DeadTimeLoop(SLIP_LOOP, 0.15).margins(), number=1, repeat=60))
    benchmark(loop.certificate)
    ours = benchmark.stats.stats.min
    print(f"\ncertificate {1e3 * ours:.1f} ms, {ours / margins:.1f} times the margins")
    assert ours / margins < 10  # 20 ms against 2 ms


@pytest.mark.benchmark(group="margins")
def test_one_loop_margins(benchmark, tmp_path):
    system = SLIP_LOOP
    benchmark(lambda: DeadTimeLoop(system, 0.15).margins())
    num, den = ct.pade(0.15, 5)
    peer = min(timeit.repeat(lambda: ct.stability_margins(system * ct.tf(num, den)), number=1, repeat=60))
    ours = benchmark.stats.stats.min  # the least disturbed round: the bound is on the code, not on its neighbours
    before = seconds_as_it_was(tmp_path)
    told = "not at hand" if before is None else f"{1e3 * before:.2f} ms"
    print(
        f"\nDeadTimeLoop.margins {1e3 * ours:.2f} ms, python-control with Pade 5 {1e3 * peer:.2f} ms, engine of "
        f"{AS_IT_WAS} {told}"
    )
    # the peer's are of an approximation, without Ms and Mt, and no proof that nothing hides; its 1.12 ms on the machine
    # where 2 ms are asked of ours
    assert ours / peer < 1.8
    assert before is None or ours < 1.25 * before  # level with it; the rest is for what else the machine does
