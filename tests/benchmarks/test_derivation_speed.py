"""`railslip derive` and `railslip verify` as whole processes, cold, against `python -c "import sympy"`.

Run with `make benchmark`; the ordinary tests do not time anything.
"""

import subprocess
import sys
import time

import pytest


def seconds(command: list[str]) -> float:
    """Wall time of a process."""
    begin = time.perf_counter()
    subprocess.run(command, capture_output=True, check=False)
    return time.perf_counter() - begin


@pytest.mark.parametrize(("command", "most"), [("derive", 8.0), ("verify", 30.0)])
def test_derive_and_verify_are_quick(benchmark, command, most):
    peer = min(seconds([sys.executable, "-c", "import sympy"]) for _ in range(3))
    run = [sys.executable, "-m", "railslip_ctrl", command]
    benchmark.pedantic(seconds, args=(run,), rounds=1)
    ours = benchmark.stats.stats.min
    print(f"\nrailslip {command} {ours:.1f} s, import sympy {peer:.2f} s, ratio {ours / peer:.0f}")
    assert ours <= most
