"""The derived sliding-mode law as text for a kernel, and what joins it to the step."""

from __future__ import annotations

import re
from functools import cache
from types import ModuleType
from typing import Any

from railslip_ctrl.adhesion import AdhesionLaw
from railslip_ctrl.scalar_code import scalar_source
from railslip_ctrl.sliding.generated import law_source

from .compilation import plain, prefixed, step_text


@cache
def generated_law() -> Any:
    """The law as a module: `Parameters`, `State`, `step`."""
    module = ModuleType("railslip_sliding_law")
    exec(compile(law_source(), "<generated sliding-mode law>", "exec"), module.__dict__)
    return module


@cache
def sliding_source(model: type[AdhesionLaw] | None) -> str:
    """The generated law, the functions of the assumed adhesion law, what joins them, and the step.

    Without a model of its own the law assumes the plant's, whose functions the kernel has; they are named again, so
    that the text is the same for every law.
    """
    law, first = generated_law(), 2
    fields, states = law.Parameters._fields, law.State._fields
    after = first + len(fields)
    glue = f"""
@compiled
def law_parameters(c):
    return Parameters({", ".join(f"float(c[{first + i}])" for i in range(len(fields)))})


@compiled
def law_state(x):
    return State({", ".join(f"float(x[{1 + i}])" for i in range(len(states)))})


@compiled
def store_state(x, state):
    {"; ".join(f"x[{1 + i}] = state[{i}]" for i in range(len(states)))}


@compiled
def assumed_torque(v, omega, c, table):
    p = c[{after}:]
    sigma = v - c[1] * omega
    z = {{prefix}}rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p, table)
    return c[1] * {{prefix}}adhesion_force(v, sigma, z, 0.0, 0.0, 0.0, p, table)

"""
    own = "" if model is None else prefixed(plain(scalar_source(model)), "assumed_")
    law_text = re.sub(r"^def ", "@compiled\ndef ", plain(law_source()), flags=re.MULTILINE)
    return own + law_text + glue.replace("{prefix}", "" if model is None else "assumed_") + step_text("sliding")
