"""Braking runs on a CUDA GPU, computed with the source text of `kernel` after a few replacements."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numpy as np

from railslip_ctrl.controllers.user_step import StepControl
from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.errors import InputError, check_extra
from railslip_ctrl.model.kernels import COMPILED

from . import kernel as layout
from .counted import Counted, normal
from .run import Run, Simulator, kernel_text

MEMORY_SHARE = 0.5  #: share of free device memory for the stops of one launch; the threads' stacks need the rest
_THREADS = 64  # threads of a block
_REGISTERS = 128  # largest number of registers of a thread; 128 was the fastest value in trials on an H200
_HEAD = """from numba import cuda
compiled = cuda.jit(device=True)
entry = compiled
@compiled
def sign(x):
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0)
@compiled
def whole_floor(x):
    return int(math.floor(x))
@compiled
def whole_ceil(x):
    return int(math.ceil(x))
@compiled
"""


def _local(name: str, size: str, value: str, kind: str = "float64") -> str:
    return f"{name} = cuda.local.array({size}, np.{kind})\n    for i in range({size}):\n        {name}[i] = {value}"


# CUDA needs array sizes as numbers; random numbers are computed where the CPU kernel reads them from an array
_CHANGES = {
    "np.empty((4, STATES))": "cuda.local.array((4, STATES), np.float64)",
    "np.empty(STATES)": "cuda.local.array(STATES, np.float64)",
    "fired = np.zeros(events.time.size, dtype=np.bool_)": _local("fired", "{events}", "False", "bool_"),
    "history = np.full(delay + 2, y[TORQUE])": _local("history", "{history}", "y[TORQUE]"),
    "measured = np.zeros(READ + 1)": _local("measured", "READ + 1", "0.0"),
    "summary[:] = 0.0": "for i in range(SUMMARY):\n        summary[i] = 0.0",
    "forces[int(t / a.random_hold + 1e-9)]": (
        "forces[0] * normal(forces[1], forces[2], int(t / a.random_hold + 1e-9), 0)"
    ),
    "noise[sample, 0]": "noise[0, 0] * normal(noise[1, 0], noise[1, 1], sample, 1)",
    "noise[sample, 1]": "noise[0, 1] * normal(noise[1, 0], noise[1, 1], sample, 2)",
}

_EVERY_STOP = """
@cuda.jit({options})
def every_stop(settings, event_time, event_distance, event_p, event_c, event_chosen, forces, noise, p, c, chosen, table,
               limits, y, x, tables, log, summary, status):
    i = cuda.grid(1)
    if i < y.shape[0]:
        a = Settings({settings})
        events = Events(event_time[i], event_distance[i], event_p[i], event_c[i], event_chosen[i])
        status[i] = run(a, events, forces[i], noise[i], p[i], c[i], chosen[i], tables[table[i]], limits[i], y[i], x[i],
                        log, 0, summary[i])[0]
"""


def cuda_text(text: str, events: int, history: int, options: str = "") -> str:
    """Return the source `text` of a simulation, changed for CUDA; `events` and `history` are array lengths."""
    for old, new in _CHANGES.items():
        assert text.count(old) == 1, f"the kernel has {old!r} once"
        text = text.replace(old, new.format(events=events, history=history))
    text = re.sub(r"math\.(floor|ceil)\(", r"whole_\1(", text).replace(COMPILED, _HEAD + inspect.getsource(normal))
    text = re.sub(r"\b(?:numpy|np)\.(exp|sqrt|tanh|log|cos|pi)\b", r"math.\1", text)
    text = text.replace("numpy.arctan(", "math.atan(").replace("numpy.sign(", "sign(")
    settings = ", ".join(f"settings[i, {k}]" for k in range(len(layout.Settings._fields)))
    return text + _EVERY_STOP.format(settings=settings, options=options)


def check_device() -> Any:
    """Return Numba's CUDA module; InputError without Numba's CUDA package or without a GPU."""
    cuda = import_module("numba.cuda") if find_spec("numba.cuda") else None
    if cuda is None or not cuda.is_available():
        check_extra("gpu", "--device gpu")
        raise InputError("--device: no CUDA GPU found; leave --device out, or use a machine with an NVIDIA GPU")
    return cuda


@cache
def _module(text: str) -> ModuleType:
    module = ModuleType("railslip_cuda_kernel")
    exec(compile(text, "<railslip_cuda_kernel>", "exec"), module.__dict__)
    return module


def launch(stops: Sequence[tuple[Simulator, Counted]]) -> Callable[[], tuple[Floats, Floats, Floats]]:
    """Prepare stops with the same type of adhesion law and the same controller; return a function that simulates them.

    The function returns three arrays with a row for each stop: index of the outcome, final state, and summary.
    """
    cuda, simulator, plans = check_device(), stops[0][0], [one.plan for one, _ in stops]
    history = max(int(one.settings["dead_time"] / one.settings["period"]) for one in plans) + 3
    text = kernel_text(type(simulator.scenario.adhesion), simulator.controller.source_text())
    options = "" if import_module("numba.core.config").ENABLE_CUDASIM else f"max_registers={_REGISTERS}"
    every_stop = _module(cuda_text(text, max(len(one.events.time) for one in plans) + 1, history, options)).every_stop
    tables = {plan.tables.tobytes(): plan.tables for plan in plans}  # most stops have the same rail
    places = {content: k for k, content in enumerate(tables)}
    rows = [_row(*stop, places[stop[0].plan.tables.tobytes()]) for stop in stops]
    count, columns = len(rows), [np.array(column) for column in zip(*rows, strict=True)]
    ended = np.zeros((1, 1)), np.zeros((count, layout.SUMMARY)), np.zeros(count)

    def run() -> tuple[Floats, Floats, Floats]:
        sent = [cuda.to_device(one) for one in (*columns, np.array(list(tables.values())), *ended)]
        every_stop[(count + _THREADS - 1) // _THREADS, min(_THREADS, count)](*sent)
        return sent[-1].copy_to_host(), sent[-6].copy_to_host(), sent[-2].copy_to_host()

    return run


def run_batch(stops: Sequence[tuple[Simulator, Counted]]) -> Iterator[Run]:
    """Simulate the stops and yield the runs; InputError without a GPU or for a user's Python code."""
    cuda, controller = check_device(), stops[0][0].controller
    if isinstance(controller, StepControl):
        raise InputError(f"--device: a GPU cannot run the Python code of {controller.label}; leave --device out")
    size = sum(np.asarray(one).nbytes for one in _row(*stops[0], 0)) + stops[0][0].plan.tables.nbytes
    most = max(int(min(MEMORY_SHARE * cuda.current_context().get_memory_info()[0] / size, 1e6)), 1)
    for part in (stops[first : first + most] for first in range(0, len(stops), most)):
        for (simulator, seed), status, y, summary in zip(part, *launch(part)(), strict=True):
            yield simulator.result(seed, int(status), y, summary)


def _row(simulator: Simulator, seed: Counted, table: int) -> tuple[Any, ...]:
    """Return the row of one stop in each argument of the CUDA function `every_stop`, from `settings` to `x`."""
    plan, force, noise = simulator.plan, simulator.scenario.disturbances, simulator.scenario.measurement
    hold = force.random_hold if force.random_force > 0 else 0.0
    # an event that never happens is the last one
    padded = (np.concatenate([one, np.full((1, *one.shape[1:]), end)]) for one, end in zip(
        plan.events, (np.inf, np.inf, np.nan, np.nan, -1), strict=True))  # fmt: skip
    draws = np.array([force.random_force, *seed]), np.array([[noise.speed_noise, noise.wheel_noise], seed])
    y, x = np.zeros(layout.STATES), np.array(simulator.controller.flat(simulator.start), dtype=float)
    y[layout.V] = simulator.scenario.initial_speed
    settings = {**plan.settings, "random_hold": hold}
    return tuple(settings.values()), *padded, *draws, plan.p, plan.c, plan.chosen, table, plan.limits, y, x
