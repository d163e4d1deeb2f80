"""A warm report of the published vehicle against the import of python-control. Run with `make benchmark`."""

import subprocess
import sys
import time

MOST = 20.0  # imports of python-control: some 15 s
ROUNDS = 2


def test_a_warm_report_costs_twenty_imports_of_python_control(tmp_path):
    report = [sys.executable, "-m", "railslip_ctrl", "report", "--out", str(tmp_path / "out")]
    peer = [sys.executable, "-c", "import control"]

    def shortest(command: list[str]) -> float:
        times = []
        for _ in range(1 + ROUNDS):  # the first compiles what no earlier run did
            begin = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            times.append(time.perf_counter() - begin)
        return min(times[1:])

    took, of_peer = shortest(report), shortest(peer)
    print(f"\nreport {took:.1f} s, {took / of_peer:.1f} times import control")
    assert took <= MOST * of_peer
