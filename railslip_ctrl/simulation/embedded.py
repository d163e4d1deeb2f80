"""Writes a controller as a C99 program; a comment in the program states the effect of single precision."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from railslip_ctrl.controllers.base import PERIOD, Controller, Measurement
from railslip_ctrl.controllers.c_code import c_program
from railslip_ctrl.controllers.files import as_control
from railslip_ctrl.controllers.guard import mutable, step_parameters
from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.user_files import file_name, given_path
from railslip_ctrl.model.vehicle import PARK2008, Rail, Vehicle

from .run import Simulator
from .scenario import stop

_SEED = 0  # seed of the random force in the stops that compare single with double precision


@checked
def save_c(controller: Any, path: str | Path, vehicle: Vehicle = PARK2008) -> tuple[Path, Path]:
    """Write a controller as C99: a source file, and a header beside it.

    - controller: what `simulate` accepts, except a user's Python object or function. A controller that assumes
      the adhesion law of the run gets the law of a stop on dry rail.
    - path: path of the source file, which ends in .c.
    - vehicle: vehicle that gives the parameters of wheel, brake and load that the controller does not set itself. Stops
      of this vehicle are simulated to compare single with double precision.

    Returns the paths of the source file and of the header. InputError if the controller cannot be written in C, or if a
    file cannot be written.
    """
    path = given_path(path)
    if path.suffix.lower() != ".c":
        raise InputError(f"{file_name(path)}: the name does not end in .c; give the path of the C source file")
    control = as_control(controller, vehicle, None)
    control = control.assuming(stop(vehicle, Rail.DRY).law(Rail.DRY))
    if control.period is None:
        control = control.model_copy(update={"period": PERIOD})
    deviation = f"{single_precision_deviation(control, vehicle):.2g} N*m"
    note = (
        f"Single precision changes the command by at most {deviation}: compared with double precision in stops of "
        "this vehicle from 100 km/h on dry and on wet rail, with the same measurements."
    )
    program = c_program(control, vehicle, name=path.stem, notes=("", note))
    written = path, path.with_suffix(".h")
    try:
        for file, content in zip(written, (program.source, program.header), strict=True):
            file.write_text(content, "utf-8")
    except OSError as error:
        raise InputError(f"{file_name(path)} cannot be written ({error.strerror}); give another path") from None
    return written


def single_precision_deviation(control: Controller, vehicle: Vehicle, rails: Sequence[Rail] = tuple(Rail)) -> float:
    """Return the largest difference, N*m, between the commands in single and in double precision.

    Both commands are computed from the measurements of a stop on each of the `rails`, simulated in double precision.
    """
    largest, step = 0.0, control.whole_step
    for rail in rails:
        scenario = stop(vehicle, rail)
        simulator = Simulator(scenario, control)
        run = simulator.run(_SEED, record_every=1)
        assert run.signals is not None, "the run is recorded"
        signals, single = run.signals, np.float32
        state = mutable(control.start(scenario.initial_speed, simulator.period))
        state = SimpleNamespace(**{name: _single(value) for name, value in vars(state).items()})
        values = step_parameters(simulator.controller, rail, simulator.period)
        parameters = SimpleNamespace(**{name: _single(value) for name, value in values.items()})
        before = 0.0
        rows = zip(signals.time, signals.measured_speed, signals.measured_wheel_speed, signals.command, strict=True)
        for time, v, omega, command in rows:
            m = Measurement(single(time), single(v), single(omega), single(before))  # type: ignore[arg-type]
            torque = float(step(state, m, parameters))
            limits = scenario.limits
            torque = min(max(torque, limits.torque_min), np.inf if limits.torque_max is None else limits.torque_max)
            largest = max(largest, abs(torque - float(command)))
            before = float(command)
    return largest


def _single(value: Any) -> Any:
    return [np.float32(x) for x in value] if isinstance(value, list | tuple) else np.float32(value)
