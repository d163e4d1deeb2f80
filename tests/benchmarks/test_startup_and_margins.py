"""Start-up of the command against `import control`, and one loop's margins. Run with `make benchmark`.

Ratios in one run, against a peer; the ordinary tests do not time anything.
"""

import statistics
import subprocess
import sys
import time
import timeit

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


SLIP_LOOP = 1.2 * (8 * S + 1) / (8 * S) / (S - 0.25) / (0.6 * S + 1)


@pytest.mark.benchmark(group="margins")
def test_certificate_of_one_loop(benchmark):
    loop = DeadTimeLoop(SLIP_LOOP, 0.15)
    margins = min(timeit.repeat(lambda: DeadTimeLoop(SLIP_LOOP, 0.15).margins(), number=1, repeat=60))
    benchmark(loop.certificate)
    ours = benchmark.stats.stats.min
    print(f"\ncertificate {1e3 * ours:.1f} ms, {ours / margins:.1f} times the margins")
    assert ours / margins < 10  # 20 ms against 2 ms


@pytest.mark.benchmark(group="margins")
def test_one_loop_margins(benchmark):
    system = SLIP_LOOP
    benchmark(lambda: DeadTimeLoop(system, 0.15).margins())
    num, den = ct.pade(0.15, 5)
    peer = min(timeit.repeat(lambda: ct.stability_margins(system * ct.tf(num, den)), number=1, repeat=60))
    ours = benchmark.stats.stats.min  # the least disturbed round: the bound is on the code, not on its neighbours
    print(f"\nDeadTimeLoop.margins {1e3 * ours:.2f} ms, python-control with Pade 5 {1e3 * peer:.2f} ms")
    # the peer's are of an approximation, without Ms and Mt, and no proof that nothing hides; its 1.12 ms on the machine
    # where 2 ms are asked of ours
    assert ours / peer < 1.8
