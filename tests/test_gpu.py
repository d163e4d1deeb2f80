"""Stops on a GPU: draws by a counter, the text for CUDA in Numba's simulator, and, where a GPU is at hand, there."""

import json
import math
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from gpu_runs import brief, difference, vehicles
from project import ROOT, refused
from scipy import stats

import railslip_ctrl as rs
from railslip_ctrl.controllers.user_step import StepControl
from railslip_ctrl.simulation import gpu
from railslip_ctrl.simulation.counted import Counted, normal


def on_gpu() -> bool:
    try:
        gpu.check_device()
    except rs.InputError:
        return False
    return "NUMBA_ENABLE_CUDASIM" not in os.environ


needs_gpu = pytest.mark.skipif(not on_gpu(), reason="needs an NVIDIA GPU and the extra gpu; here there is none")


def test_draws_are_those_of_philox():
    """Known answer of Philox4x32-10 for a counter and keys of zero, Random123's file kat_vectors."""
    first, second = 0x6627E8D5_E169C58D, 0xBC57AC4C_9B00DBD8
    expected = math.sqrt(-2.0 * math.log(first / 2**64)) * math.cos(2.0 * math.pi * second / 2**64)
    assert normal(0, 0, 0, 0) == pytest.approx(expected, rel=1e-14)
    draws = normal(12, 2**32 - 1, np.arange(20_000)[:, None], np.array([0, 1]))
    assert draws[7, 1] == normal(12, 2**32 - 1, 7, 1)  # a number, or an array
    assert stats.kstest(draws.ravel(), "norm").pvalue > 1e-3
    assert abs(np.corrcoef(draws.T)[0, 1]) < 4.0 / math.sqrt(20_000)


def test_the_text_for_cuda_gives_the_stops_of_the_cpu(tmp_path):
    environment = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1"}
    words = [sys.executable, "tests/gpu_runs.py", str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert len(found) > 12
    assert max(found.values()) < 1e-12  # NumPy's and the C library's functions round differently


@pytest.mark.skipif(on_gpu(), reason="there is a GPU")
def test_without_a_gpu_one_line_says_so(file, railslip):
    name = file("few.toml", 'scenario = "stop"\nruns = 2\ncontroller = [{ controller = "pi" }]\n')
    assert "gpu" in refused(railslip("campaign", name, "--out", "out", "--device", "gpu"))
    assert "choose cpu or gpu" in refused(railslip("campaign", name, "--out", "out", "--device", "tpu"))


def test_what_a_gpu_cannot_run_is_refused(monkeypatch):
    monkeypatch.setattr(gpu, "check_device", lambda: None)
    step = rs.Simulator(brief(), lambda t, v, omega: 1000.0)
    assert isinstance(step.controller, StepControl)
    with pytest.raises(rs.InputError, match=r"GPU cannot run .*; leave --device out"):
        next(gpu.run_batch([(step, Counted(0, 0))]))


@needs_gpu
def test_a_thousand_stops_on_a_gpu_are_those_of_the_cpu():
    scenario = rs.stop(rs.PARK2008, "wet").with_changes(measurement={"speed_noise": 0.02})
    controller = rs.Seeking.for_vehicle(rs.PARK2008)
    stops = [rs.Simulator(scenario.with_changes(vehicle=one), controller) for one in vehicles(1000)]
    assert difference(stops) < 1e-9


@needs_gpu
def test_a_gpu_makes_150_000_seeking_stops_a_second():
    """Of 18 s, integrated at 1 ms, on an H100 or H200; with one stop's quantities, so that only the device works."""
    stop = rs.Simulator(rs.stop(rs.PARK2008, "wet"), rs.Seeking.for_vehicle(rs.PARK2008))
    launched = gpu.launch([(stop, Counted(i, 0)) for i in range(200_000)])
    launched()  # compiles
    begun = time.perf_counter()
    launched()
    assert 200_000 / (time.perf_counter() - begun) > 150_000
