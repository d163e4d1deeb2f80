"""Braking runs against python-control and C, and the start of a process. Run with `make benchmark`.

Ratios in one run, against a peer; the ordinary tests do not time anything. The run is the published one with the PI
"bristle", 58 s at 1 ms, unless said otherwise.
"""

import ctypes
import math
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control as ct
import numba
import numpy as np
import pytest

from railslip_ctrl import TABLE4_PI, PIController, PIGains, ReferenceSlip, StepControl
from railslip_ctrl.model.numeric import adhesion_table, plant_parameters
from railslip_ctrl.simulation import LinearControl, Simulator, TorqueProfile, published_scenario
from railslip_ctrl.simulation.steps import kernel

REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)
GAINS = TABLE4_PI["bristle"]
PEER_SPAN = 1.0  # s of simulated time for python-control, 58 times as much for the run


def published_pi() -> LinearControl:
    """The gains as the peers run them: by the backward difference, without anti-windup."""
    return LinearControl(PIController(GAINS), REFERENCE, period=None, tracking_time=math.inf, rule="backward")


def shortest(call: Callable[[], Any], rounds: int) -> float:
    """Least wall time of some calls, s: the code's, not its neighbours'."""
    times = []
    for _ in range(rounds):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return min(times)


def python_control_loop(p: tuple[float, ...], table: np.ndarray) -> tuple[Any, int]:
    """The closed loop as one `nlsys`, dead time by a fifth-order Pade; states (v, sigma, Tb, integral, Pade).

    Its right-hand side is the kernel's, in plain Python: the interconnection of separate systems would be slower.
    """
    vehicle, law = published_scenario().vehicle, type(published_scenario().adhesion)
    plant = kernel(law, TorqueProfile((0.0,), (0.0,), REFERENCE).source(), compiled=False)
    delay = ct.tf2ss(*ct.pade(vehicle.actuator.dead_time, 5))
    A, B, C, D = delay.A, delay.B[:, 0], delay.C[0], float(delay.D[0, 0])

    def update(t: float, x: np.ndarray, u: np.ndarray, params: object) -> np.ndarray:
        v, sigma, torque, integral = (float(value) for value in x[:4])
        error = 0.132 * v - sigma
        command = max(GAINS.kp * error + integral, 0.0)
        td = 0.05 * torque * math.exp(-4.0 * t) * math.sin(10.0 * math.pi * t)
        v_rate, sigma_rate, _ = plant.rates(v, sigma, 0.0, torque, td, vehicle.wheel.radius * float(u[0]), p, table)
        delayed = float(C @ x[4:]) + D * command
        lag = (delayed - torque) / vehicle.actuator.lag
        return np.concatenate([[v_rate, sigma_rate, lag, GAINS.ki * error], A @ x[4:] + B * command])

    return ct.nlsys(update, None, inputs=1, states=4 + A.shape[0]), A.shape[0]


@pytest.mark.benchmark(group="braking run")
def test_a_run_against_python_control(benchmark):
    scenario = published_scenario()
    simulator = Simulator(scenario, published_pi())
    run = simulator.run(0, record_every=1)
    benchmark(simulator.run, 0)
    ours = benchmark.stats.stats.min / run.braking_time
    law = scenario.adhesion
    p, table = plant_parameters(law, scenario.vehicle), adhesion_table(law, scenario.vehicle.wheel_load)
    system, order = python_control_loop(p, table)
    t = np.arange(round(PEER_SPAN / 1e-3) + 1) * 1e-3
    forces, start = run.signals.random_force[: t.size], np.array([scenario.initial_speed] + [0.0] * (3 + order))
    begin = time.perf_counter()
    found = ct.input_output_response(system, t, forces, start, solve_ivp_kwargs={"max_step": 1e-3})
    theirs = (time.perf_counter() - begin) / PEER_SPAN
    print(
        f"\na simulated second: {1e6 * ours:.0f} us, {1e6 * benchmark.stats.stats.min / run.steps:.3f} us a step; "
        f"python-control, RK45 with steps of at most 1 ms, Pade 5, from {PEER_SPAN:g} s: {theirs:.2f} s; "
        f"ratio {theirs / ours:.0f}"
    )
    # the same loop but for the approximate delay and forces that the peer interpolates
    assert found.states[0, -1] == pytest.approx(run.signals.speed[t.size - 1], rel=1e-3)
    assert theirs / ours >= 100


@pytest.mark.benchmark(group="braking run")
def test_what_a_user_s_controller_costs(benchmark):
    """60 s at a sample each 10 ms, the wheel far from locking: a PI by gains, as a system, an object, for Numba."""
    scenario = published_scenario().with_changes(longest_time=60.0, events=(), final_speed=0.1)
    radius = scenario.vehicle.wheel.radius

    class Own:
        reference = REFERENCE

        def reset(self, t: float, v: float, omega: float) -> None:
            self.integral = 0.0

        def step(self, t: float, v: float, omega: float) -> float:
            error = 0.05 * v - (v - radius * omega)
            self.integral += 0.01 * 100.0 * error
            return 500.0 * error + self.integral

    @numba.njit
    def own(t, v, omega, x):
        error = 0.05 * v - (v - radius * omega)
        x[0] += 0.01 * 100.0 * error
        return 500.0 * error + x[0]

    held = ReferenceSlip(dry=0.05, wet=0.05)
    built_in = LinearControl(PIController(PIGains(kp=500.0, ki=100.0)), held, period=0.01)
    simulators = {
        "gains": Simulator(scenario, built_in),
        "system": Simulator(scenario, LinearControl(500.0 + 100.0 / ct.tf("s"), held, period=0.01)),
        "Numba": Simulator(scenario, StepControl(own, held, start_numbers=(0.0,))),
        "object": Simulator(scenario, Own()),
    }
    runs = {name: simulator.run(0) for name, simulator in simulators.items()}
    assert all(run.braking_time == 60.0 for run in runs.values())
    benchmark(simulators["object"].run, 0)
    best = dict.fromkeys(simulators, math.inf)
    for _ in range(30):  # in turn, so that all meet the same neighbours
        for name, simulator in simulators.items():
            best[name] = min(best[name], shortest(lambda simulator=simulator: simulator.run(0), 1))
    print("\na run of 60 s, 6000 samples: " + ", ".join(f"{name} {1e3 * best[name]:.2f} ms" for name in best))
    assert best["object"] - best["gains"] <= 15e-3
    assert max(best["system"], best["Numba"]) <= 1.10 * best["gains"]


def c_functions() -> str:
    """`rates_and_powers` and `stiffness` of the curve in C99, from the statement, and its table."""
    import sympy as sp
    from sympy.printing.c import C99CodePrinter

    from railslip_ctrl.model import plant

    law = type(published_scenario().adhesion)
    closed = plant.close(law)
    names = [*plant.VEHICLE_PARAMETERS, *law.parameter_names()]

    class Printer(C99CodePrinter):
        def _print_Function(self, expression):
            if type(expression).__name__ in law.statement().functions:
                return f"tabulated({self._print(expression.args[0])}, table)"
            return super()._print_Function(expression)

    def function(name: str, expressions: tuple) -> str:
        temporaries, printed = sp.cse(list(expressions), symbols=sp.numbered_symbols("_x"))
        used = {str(s) for e in (*(e for _, e in temporaries), *printed) for s in e.free_symbols}
        print_ = Printer().doprint
        lines = [f"double {n} = p[{i}];" for i, n in enumerate(names) if n in used]
        lines += [f"double {target} = {print_(e)};" for target, e in temporaries]
        lines += [f"out[{i}] = {print_(e)};" for i, e in enumerate(printed)]
        arguments = ", ".join(f"double {n}" for n in plant.ARGUMENTS)
        body = "\n    ".join(lines)
        return (
            f"static void {name}({arguments}, const double *p, const double *table, double *out) {{\n    {body}\n}}\n"
        )

    j = closed.jacobian
    return function("rates_and_powers", closed.rates_and_powers) + function("stiffness", (*j[1][1:3], *j[2][1:3]))


def c_loop(folder: Path, simulator: Simulator, seed: int) -> Callable[[], np.ndarray]:
    """`braking_run.c` with its generated functions, compiled with -O2: a call makes a run and gives its summary."""
    text = Path(__file__).with_name("braking_run.c").read_text("utf-8")
    source, library = folder / "run.c", folder / "run.so"
    source.write_text(text.replace("/* GENERATED */", c_functions()), encoding="utf-8")
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(source), "-lm"], check=True)
    run = ctypes.CDLL(str(library)).run
    plan, scenario = simulator._plan, simulator.scenario
    forces, _, hold = simulator._draw(seed)
    s, event = plan.settings, scenario.events[0]
    settings = np.array(
        [
            *(s[n] for n in ("period", "step", "dead_time", "lag_fill", "viscous", "viscous_rate")),
            *(s[f"disturbance_{n}"] for n in ("fraction", "decay", "frequency")),
            *(hold, s["final_speed"], s["longest_time"], plan.limits[0, 0], event.time),
            *(scenario.vehicle.inertia_scale * event.mass, GAINS.kp, GAINS.ki, REFERENCE.dry, REFERENCE.wet, 0.0),
        ]
    )
    limits = np.ascontiguousarray(plan.limits[:, 1:])

    def pointer(array: np.ndarray) -> Any:
        return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    def call() -> np.ndarray:
        p, y, summary = plan.p.copy(), np.zeros(11), np.zeros(9)
        y[0] = scenario.initial_speed
        size = ctypes.c_long(plan.tables.shape[1])
        assert run(*map(pointer, (settings, forces, p, plan.tables)), size, *map(pointer, (limits, y, summary))) == 0
        return np.array([summary[0], y[4], y[5], summary[1] / summary[0], summary[7]])

    return call


@pytest.mark.benchmark(group="braking run")
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_a_run_against_the_same_loop_in_c(benchmark, tmp_path):
    simulator = Simulator(published_scenario(), published_pi())
    peer = c_loop(tmp_path, simulator, 0)
    run = simulator.run(0)
    found = (run.braking_time, run.braking_distance, run.brake_energy, run.mean_abs_slip_error, run.energies.booked)
    assert found == pytest.approx(peer(), rel=1e-9)  # the same arithmetic
    benchmark(simulator.run, 0)
    ours, theirs = shortest(lambda: simulator.run(0), 20), shortest(peer, 20)
    print(f"\na run {1e3 * ours:.1f} ms, in C with -O2 {1e3 * theirs:.1f} ms, ratio {ours / theirs:.2f}")
    assert ours / theirs <= 2


ONE_RUN = """
from railslip_ctrl.design import PIController
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.vehicle import TABLE4_PI
from railslip_ctrl.simulation import LinearControl, built_in_scenario, simulate
reference = ReferenceSlip(dry=0.132, wet=0.092)
simulate(built_in_scenario("park2008"), LinearControl(PIController(TABLE4_PI["bristle"]), reference, period=None))
"""


@pytest.mark.benchmark(group="start-up")
def test_a_warm_process_with_one_run_against_import_control(benchmark):
    def seconds(text: str) -> float:
        return shortest(lambda: subprocess.run([sys.executable, "-c", text], check=True, capture_output=True), 1)

    seconds(ONE_RUN)  # compiles where nothing is kept
    pairs = [(seconds(ONE_RUN), seconds("import control")) for _ in range(7)]
    benchmark.pedantic(seconds, args=(ONE_RUN,), rounds=1)
    ours, theirs = (statistics.median(times) for times in zip(*pairs, strict=True))
    print(f"\na process with one run {ours:.2f} s, import control {theirs:.2f} s, ratio {ours / theirs:.2f}")
    assert ours / theirs <= 2.5
