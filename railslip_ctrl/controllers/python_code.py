"""A controller's step and numbers as Python that needs nothing but the standard library."""

from __future__ import annotations

import ast

from railslip_ctrl import __version__
from railslip_ctrl.model.vehicle import Rail

from .base import PERIOD, Controller
from .guard import step_parameters
from .translate import Function, read_step


def python_text(control: Controller, speed: float = 100 / 3.6) -> str:
    """The functions of the step, as the simulations run them, its numbers on dry rail, and a state at its start.

    - control: a controller with what it believes of the vehicle filled in.
    - speed: train speed at which the state starts, m/s; few controllers use it.

    InputError: a controller known by a Python step alone, or without numbers that it needs.
    """
    period = PERIOD if control.period is None else control.period
    functions = read_step(control.whole_step).all()
    constants = {name: value for one in functions.values() for name, value in one.constants.items()}
    state, parameters = control.start(speed, period), step_parameters(control, Rail.DRY, period)
    return "\n".join(
        (
            f'"""{control.label}: {control.title}; railslip_ctrl {__version__}, {control.source}. SI units.',
            "",
            "Once a period: torque = step(state, measurement, PARAMETERS), N*m; measurement has time, train_speed,",
            'wheel_speed and applied_torque. Without the guard that the C99 program has."""',
            "",
            "import math",
            "from types import SimpleNamespace",
            "",
            *(f"{name} = {value!r}" for name, value in constants.items()),
            *(text for one in functions.values() for text in ("", "", _text_of(one))),
            "",
            "",
            f"PARAMETERS = SimpleNamespace(**{_numbers(parameters)})",
            f"state = SimpleNamespace(**{_numbers({name: getattr(state, name) for name in control.state_fields()})})",
            "",
        )
    )


def _text_of(function: Function) -> str:
    lines = ast.unparse(function.node).splitlines()
    return "\n".join([lines[0], *([f'    """{function.doc}"""'] if function.doc else []), *lines[1:]])


def _numbers(values: dict[str, object]) -> str:
    shown = (f"    {name!r}: {list(value) if isinstance(value, tuple) else value!r}," for name, value in values.items())
    return "\n".join(("{", *shown, "}"))
