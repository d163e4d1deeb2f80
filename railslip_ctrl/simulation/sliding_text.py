"""The derived sliding-mode law as text for a kernel, and what joins it to the step."""

from __future__ import annotations

from functools import cache

from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.kernels import prefixed, scalar_source
from railslip_ctrl.sliding.generate import generated_law, law_kernel_text, law_states

from .kernel_text import step_text
from .steps import sliding as steps


@cache
def sliding_source(model: type[AdhesionLaw] | None) -> str:
    """The generated law, the functions of the assumed adhesion law, what joins them, and the step.

    Without a model of its own the law assumes the plant's, whose functions the kernel has; they are named again, so
    that the text is the same for every law.
    """
    states, after = law_states(), steps.FIRST + len(generated_law().Parameters._fields)
    glue = f"""
@compiled
def law_state(x):
    # no sample of a simulation is left out, so that there is no command to be held
    return State({", ".join(f"float(x[{1 + i}])" for i in range(len(states)))}, 0.0, 0.0, 1.0)


@compiled
def store_state(x, state):
    {"; ".join(f"x[{1 + i}] = state[{i}]" for i in range(len(states)))}


@compiled
def assumed_torque(v, omega, c, table):
    p = c[{after}:]
    sigma = v - c[1] * omega
    z = {{prefix}}rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p, table)
    return c[1] * {{prefix}}force(v, sigma, z, 0.0, 0.0, 0.0, p, table)

"""
    own = "" if model is None else prefixed(scalar_source(model), "assumed_")
    return (
        own + law_kernel_text() + glue.replace("{prefix}", "" if model is None else "assumed_") + step_text("sliding")
    )
