"""A map of margins: our batch against python-control with a fifth-order Pade, speed and accuracy in one run.

Run with `make benchmark`, for the speed of one core with `taskset -c 0 make benchmark`.
"""

import os
import time

import control as ct
import numpy as np
import pytest
from test_loop_batch import slip_loops

from railslip_ctrl.loop.batch import batch_margins

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
    gain_error = np.abs(peer[:, 0] / found.gain_increase[chosen] - 1)
    phase_error = np.abs(peer[:, 1] - found.phase_deg[chosen])
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(
        f"\npython-control, Pade {PADE_ORDER}, against exact, {chosen.size} stable loops: gain margin off by up to "
        f"{gain_error.max():.1e} (median {np.median(gain_error):.1e}) relative, phase margin by up to "
        f"{phase_error.max():.1e} deg (median {np.median(phase_error):.1e})"
    )
    assert np.median(phase_error) < 1e-3  # the two ask the same question
    if ours is not None:
        print(
            f"batch_margins, all margins: {ours:.0f} loops/s over {len(found)} stable loops ({cores} core(s) allowed); "
            f"python-control, gain, phase and modulus margins: {theirs:.0f} loops/s; ratio {ours / theirs:.1f}"
        )
        assert ours / theirs > 5
