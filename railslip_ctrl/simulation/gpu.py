"""Braking runs on a CUDA GPU: the kernel's own text with a few lines changed, one thread a stop."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numpy as np

from railslip_ctrl.controllers.user_step import StepControl
from railslip_ctrl.core.arguments import Floats, Integers
from railslip_ctrl.core.errors import InputError, check_extra
from railslip_ctrl.model.kernels import COMPILED

from . import kernel as layout
from .counted import Counted, normal
from .run import Run, Simulator, kernel_text

MEMORY_SHARE = 0.5
"""Of the free memory of the device, for the stops of one launch; the rest is for the stacks of the threads."""

_THREADS = 64  # of a block
_REGISTERS = 128  # of a thread; with more, fewer stops run at once: an H200 made 157 000 a second, and so 221 000

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
"""

# what allocates gets its size as a number; draws are worked out where the CPU reads them
_CHANGES = (
    (
        "k, new = np.empty((4, STATES)), np.empty(STATES)",
        "k, new = cuda.local.array((4, STATES), np.float64), cuda.local.array(STATES, np.float64)",
    ),
    (
        "fired = np.zeros(events.time.size, dtype=np.bool_)",
        "fired = cuda.local.array({events}, np.bool_)\n    for i in range({events}):\n        fired[i] = False",
    ),
    (
        "history = np.full(delay + 2, y[TORQUE])",
        "history = cuda.local.array({history}, np.float64)\n    for i in range({history}):\n"
        "        history[i] = y[TORQUE]",
    ),
    (
        "measured = np.zeros(READ + 1)",
        "measured = cuda.local.array(READ + 1, np.float64)\n    for i in range(READ + 1):\n        measured[i] = 0.0",
    ),
    ("summary[:] = 0.0", "for i in range(SUMMARY):\n        summary[i] = 0.0"),
    (
        "forces[int(t / a.random_hold + 1e-9)]",
        "forces[0] * normal(forces[1], forces[2], int(t / a.random_hold + 1e-9), 0)",
    ),
    ("noise[sample, 0]", "noise[0, 0] * normal(noise[1, 0], noise[1, 1], sample, 1)"),
    ("noise[sample, 1]", "noise[0, 1] * normal(noise[1, 0], noise[1, 1], sample, 2)"),
)

_EVERY_STOP = """
@cuda.jit({options})
def every_stop(settings, event_time, event_distance, event_p, event_c, event_chosen, forces, noise, p, c, chosen, table,
               tables, limits, y, x, log, summary, status):
    i = cuda.grid(1)
    if i < y.shape[0]:
        a = Settings({settings})
        events = Events(event_time[i], event_distance[i], event_p[i], event_c[i], event_chosen[i])
        status[i] = run(a, events, forces[i], noise[i], p[i], c[i], chosen[i], tables[table[i]], limits[i], y[i], x[i],
                        log, 0, summary[i])[0]
"""


def cuda_text(text: str, events: int, history: int, options: str = "") -> str:
    """A kernel's text for CUDA, with room for a number of `events` and `history` samples of the dead time."""
    for old, new in _CHANGES:
        assert text.count(old) == 1, f"the kernel has {old!r} once"
        text = text.replace(old, new.format(events=events, history=history) if "{" in new else new)
    settings = ", ".join(f"settings[i, {k}]" for k in range(len(layout.Settings._fields)))
    head = f"{_HEAD}\n\n@compiled\n{inspect.getsource(normal)}"
    text = re.sub(r"math\.(floor|ceil)\(", r"whole_\1(", text).replace(COMPILED, head)
    text = re.sub(r"\b(?:numpy|np)\.(exp|sqrt|tanh|log|cos|pi)\b", r"math.\1", text)
    text = text.replace("numpy.arctan(", "math.atan(").replace("numpy.sign(", "sign(")
    return text + _EVERY_STOP.format(settings=settings, options=options)


def check_device() -> Any:
    """Numba's CUDA. InputError without it, or without a GPU."""
    if find_spec("numba.cuda") is None:
        check_extra("gpu", "--device gpu")
    from numba import cuda

    if not cuda.is_available():
        check_extra("gpu", "--device gpu")
        raise InputError(
            "--device: gpu is not there, CUDA finds none; leave it out, or use a machine with an NVIDIA GPU"
        )
    return cuda


@cache
def _module(text: str) -> ModuleType:
    module = ModuleType("railslip_cuda_kernel")
    exec(compile(text, "<railslip_cuda_kernel>", "exec"), module.__dict__)
    return module


class Launch:
    """Stops of one adhesion law and one controller, made ready on the host. InputError without a GPU."""

    def __init__(self, simulators: Sequence[Simulator], seeds: Sequence[Counted]) -> None:
        self._cuda = check_device()
        from numba.core import config

        plans = [one.plan for one in simulators]
        history = max(int(one.settings["dead_time"] / one.settings["period"]) for one in plans) + 3
        events = max(len(one.events.time) for one in plans) + 1
        text = kernel_text(type(simulators[0].scenario.adhesion), simulators[0].controller.source_text())
        options = "" if config.ENABLE_CUDASIM else f"max_registers={_REGISTERS}"
        self._kernel = _module(cuda_text(text, events, history, options)).every_stop
        tables = {plan.tables.tobytes(): plan.tables for plan in plans}  # most stops of a campaign have one rail
        places = {content: k for k, content in enumerate(tables)}
        own = _arrays(simulators, seeds, [places[plan.tables.tobytes()] for plan in plans])
        self._count, log = len(plans), np.zeros((1, 1))
        ended = np.zeros((self._count, layout.SUMMARY)), np.zeros(self._count)
        self._given = [*own[:12], np.array(list(tables.values())), *own[12:], log, *ended]

    def run(self) -> tuple[Floats, Floats, Floats]:
        """Outcomes, states and summaries, a row a stop."""
        sent = [self._cuda.to_device(one) for one in self._given]
        blocks = (self._count + _THREADS - 1) // _THREADS
        self._kernel[blocks, min(_THREADS, self._count)](*sent)
        status, y, summary = (sent[k].copy_to_host() for k in (-1, -5, -2))
        return status, y, summary


def run_batch(simulators: Sequence[Simulator], seeds: Sequence[Counted]) -> Iterator[Run]:
    """One run of each simulator, all of one adhesion law and one controller. InputError without a GPU."""
    cuda = check_device()
    if isinstance(simulators[0].controller, StepControl):
        label = simulators[0].controller.label
        raise InputError(f"--device: controller {label} is a Python step, which a GPU has not; leave --device out")
    size = sum(one.nbytes for one in (*_arrays(simulators[:1], seeds[:1], [0]), simulators[0].plan.tables))
    most = max(int(min(MEMORY_SHARE * cuda.current_context().get_memory_info()[0] / size, 1e6)), 1)
    for first in range(0, len(simulators), most):
        part = slice(first, first + most)
        found = Launch(simulators[part], seeds[part]).run()
        for simulator, seed, status, y, summary in zip(simulators[part], seeds[part], *found, strict=True):
            yield simulator.result(seed, int(status), y, summary, None)


def _arrays(simulators: Sequence[Simulator], seeds: Sequence[Counted], table: Sequence[int]) -> list[Floats | Integers]:
    """Arguments of `every_stop` without tables, a row a stop; events padded by one that never happens."""
    rows = []
    for simulator, seed, place in zip(simulators, seeds, table, strict=True):
        plan, scenario = simulator.plan, simulator.scenario
        force, noise = scenario.disturbances, scenario.measurement
        settings = [*({**plan.settings, "random_hold": force.random_hold if force.random_force > 0 else 0.0}).values()]
        time, distance, p, c, chosen = plan.events
        events = (
            *(np.append(one, np.inf) for one in (time, distance)),
            *(np.vstack([one, np.full(one.shape[1], np.nan)]) for one in (p, c)),
            np.vstack([chosen, np.full(chosen.shape[1], -1)]),
        )
        draws = np.array([force.random_force, *seed]), np.array([[noise.speed_noise, noise.wheel_noise], seed])
        x = np.array(simulator.controller.flat(simulator.start), dtype=float)
        y = np.zeros(layout.STATES)
        y[layout.V] = scenario.initial_speed
        rows.append((settings, *events, *draws, plan.p, plan.c, plan.chosen, place, plan.limits, y, x))
    return [np.array(column) for column in zip(*rows, strict=True)]
