"""Writes a controller as Python code that needs only the standard library."""

from __future__ import annotations

import ast

from railslip_ctrl import __version__
from railslip_ctrl.model.vehicle import Rail

from .base import PERIOD, Controller
from .guard import step_parameters
from .translate import Function, read_step


def python_text(control: Controller, speed: float = 100 / 3.6) -> str:
    """Return the text of a Python program: the control law `step`, the parameters on dry rail, and the initial state.

    - control: a controller with values for all assumed vehicle parameters, set for example by `Controller.believing`.
    - speed: initial train speed, m/s.

    InputError if the controller is a user's Python object or function, or if a required adhesion law or reference slip
    is missing.
    """
    period = PERIOD if control.period is None else control.period
    functions = read_step(control.whole_step).all()
    constants = {name: value for function in functions.values() for name, value in function.constants.items()}
    state, parameters = control.start(speed, period), step_parameters(control, Rail.DRY, period)
    return "\n".join(
        (
            f'"""{control.label}: {control.title}; railslip_ctrl {__version__}, {control.source}. SI units.',
            "",
            "Call torque = step(state, measurement, PARAMETERS), N*m, once a period. A measurement has time,",
            'train_speed, wheel_speed and applied_torque. The guard of the C99 program is not included."""',
            "",
            "import math",
            "from types import SimpleNamespace",
            "",
            *(f"{name} = {value!r}" for name, value in constants.items()),
            *(text for function in functions.values() for text in ("", "", _text_of(function))),
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
