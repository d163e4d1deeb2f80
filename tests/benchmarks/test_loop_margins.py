"""One loop's margins and certificate, a map of margins, and a verdict over an envelope of 5 000 points.

Run with `make benchmark`, for the speed of one core with `taskset -c 0 make benchmark`. Ratios in one run, against
python-control with a fifth-order Pade; the ordinary tests do not time anything.
"""

import time
import timeit

import control as ct
import numpy as np
import pytest
from test_loop_batch import slip_loops

from railslip_ctrl import DeadTimeLoop, Envelope, PIController, PIGains, judge
from railslip_ctrl.loop.batch import batch_margins

S = ct.tf("s")

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


POINTS = 5000
SECONDS = 2.0


def test_5000_points_are_judged_in_two_seconds():
    controller = PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)
    envelope = Envelope(speeds=[8 * i for i in range(1, 13)])
    judge(controller, Envelope(speeds=60))  # imports
    times = []
    for _ in range(3):
        begin = time.process_time()
        judged = judge(controller, envelope)
        assert judged.worst.ms <= judged.worst_with_tolerances.ms
        times.append(time.process_time() - begin)
    assert len(judged.points) >= POINTS
    print(f"\n{len(judged.points)} points judged, worst case by the scalar engine included: {min(times):.2f} s")
    assert min(times) <= SECONDS


LOOPS = 20_000
PEER_LOOPS = 200  # the peer takes milliseconds a loop
PADE_ORDER = 5


def peer_margins(zeros, poles, gain, dead_time):
    """Gain factor that destabilises upward and smallest phase margin, the way a python-control user gets them."""
    num, den = ct.pade(dead_time, PADE_ORDER)
    loop = ct.tf(gain * np.poly(zeros).real, np.poly(poles).real) * ct.tf(num, den)
    factors, phases, *_ = ct.stability_margins(loop, returnall=True)
    return np.min(factors[factors > 1], initial=np.inf), np.min(np.abs((phases + 180) % 360 - 180), initial=np.inf)


@pytest.mark.benchmark(group="margin map")
def test_margin_map_against_python_control_with_pade(benchmark):
    arguments = slip_loops(LOOPS, lead=True)
    # stable loops only: the others have no margins, and would flatter the speed
    stable = batch_margins(*arguments).stable
    arguments = tuple(a[stable] for a in arguments)
    found = benchmark(batch_margins, *arguments)
    # without --benchmark-enable nothing is timed: then only the accuracy is looked at
    ours = len(found) / benchmark.stats.stats.median if benchmark.stats else None
    chosen = np.arange(PEER_LOOPS)
    begin = time.perf_counter()
    peer = np.array([peer_margins(*(a[i] for a in arguments)) for i in chosen])
    theirs = chosen.size / (time.perf_counter() - begin)
    phase_error = np.abs(peer[:, 1] - found.phase_deg[chosen])
    assert np.median(phase_error) < 1e-3  # the two ask the same question
    if ours is not None:
        print(f"\nbatch_margins {ours:.0f} loops/s, python-control {theirs:.0f} loops/s, ratio {ours / theirs:.1f}")
        assert ours / theirs > 5
