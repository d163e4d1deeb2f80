"""Commands as whole processes against an import in the same session. Run with `make benchmark`.

The ordinary tests do not time anything.
"""

import statistics
import subprocess
import sys
import time

import pytest


def seconds(command: list[str]) -> float:
    """Wall time of a process."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, *command], capture_output=True, check=False)
    return time.perf_counter() - begin


def several(command: list[str], rounds: int) -> list[float]:
    """Wall times of some processes, one warm-up first, which compiles what no earlier run did."""
    return [seconds(command) for _ in range(rounds + 1)][1:]


@pytest.mark.benchmark(group="start-up")
def test_margins_command_against_import_control(benchmark):
    peer = statistics.median(several(["-c", "import control"], 7))
    command = ["-m", "railslip_ctrl", "margins"]
    ours = benchmark.pedantic(lambda: statistics.median(several(command, 7)), rounds=1)
    print(f"\nrailslip margins {ours:.2f} s, import control {peer:.2f} s, ratio {ours / peer:.2f}")
    assert ours / peer <= 1.6


@pytest.mark.parametrize(("command", "most"), [("derive", 8.0), ("verify", 30.0)])
def test_derive_and_verify_are_quick(benchmark, command, most):
    """Cold, in seconds, beside the import of SymPy."""
    peer = min(seconds(["-c", "import sympy"]) for _ in range(3))
    ours = benchmark.pedantic(seconds, args=(["-m", "railslip_ctrl", command],), rounds=1)
    print(f"\nrailslip {command} {ours:.1f} s, import sympy {peer:.2f} s, ratio {ours / peer:.0f}")
    assert benchmark.stats.stats.min <= most


def test_a_warm_report_costs_twenty_imports_of_python_control(tmp_path):
    took = min(several(["-m", "railslip_ctrl", "report", "--out", str(tmp_path / "out")], 2))
    assert any((tmp_path / "out").iterdir())
    of_peer = min(several(["-c", "import control"], 2))
    print(f"\nreport {took:.1f} s, {took / of_peer:.1f} times import control")
    assert took <= 20.0 * of_peer  # some 15 s
