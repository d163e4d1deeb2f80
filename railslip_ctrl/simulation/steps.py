"""Controllers' steps, pasted one at a time into a kernel as its `command`, and the texts of kernels.

A step(x, t, v, omega, applied, c, table) gives the torque asked for, N*m, from the measured train speed (m/s) and
wheel speed (rad/s) at time t (s), and changes the controller's own state `x` in place. `applied` is the command of the
previous sample after the limits, N*m. `c` is the controller's row of numbers: c[0] is its reference slip ratio,
c[1] the wheel radius, c[-1] the scenario's reference, the rest its own. `table` belongs to the adhesion law it
assumes, if any.
"""

from __future__ import annotations

import inspect
import math
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from railslip_ctrl.design import difference
from railslip_ctrl.design.difference import linear_step
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.kernels import (
    assumed_torque,
    compiled,
    law_parameters,
    law_state,
    module_of,
    module_text,
    plain,
    prefixed,
    scalar_source,
    step,
    store_state,
)
from railslip_ctrl.sliding.generate import generated_law, law_kernel_text, law_states

if TYPE_CHECKING:
    from .step_calls import call_step  # loads Numba

# --- the steps -------------------------------------------------------------------------------------------------------


@compiled
def linear(x, t, v, omega, applied, c, table):
    """A linear controller, `design.difference.linear_step`; x: what its difference equations remember."""
    reference, radius, cut_out_speed, cut_out_torque, equations = c[0], c[1], c[2], c[3], 4
    if v < cut_out_speed:
        return cut_out_torque
    return linear_step(x, c, equations, reference * v - (v - radius * omega), applied)


@compiled
def gains_at(v, c, first, n):
    """kp and ki at a speed: linear between the schedule's n speeds, from c[first] on, the nearest entry outside."""
    last = first + n - 1
    if v <= c[first]:
        return c[first + n], c[first + 2 * n]
    if v >= c[last]:
        return c[last + n], c[last + 2 * n]
    i = first
    while v >= c[i + 1]:
        i += 1
    share = (v - c[i]) / (c[i + 1] - c[i])
    kp = c[i + n] + share * (c[i + 1 + n] - c[i + n])
    ki = c[i + 2 * n] + share * (c[i + 1 + 2 * n] - c[i + 2 * n])
    return kp, ki


@compiled
def scheduled(x, t, v, omega, applied, c, table):
    """A PI with a lead whose gains follow the train's speed, taken over without a bump in torque.

    c from 12 on: n speeds (m/s, rising), n times kp, n times ki. tracking: h/Tt, below 0: h ki/kp.
    """
    reference, radius = c[0], c[1]
    lead_p, lead_q0, lead_q1, weight_now, weight_before = c[2], c[3], c[4], c[5], c[6]
    tracking, period, torque_low, torque_high, speeds = c[7], c[8], c[9], c[10], int(c[11])
    error_before, filtered_before, unlimited = x[1], x[2], x[3]
    error = reference * v - (v - radius * omega)
    if not math.isfinite(error):
        return applied
    kp, ki = gains_at(v, c, 12, speeds)
    integral = unlimited - kp * filtered_before  # the torque goes on from where the gains before left it
    filtered = lead_p * filtered_before + lead_q0 * error + lead_q1 * error_before
    share = tracking if tracking >= 0.0 else 1.0
    if ki == 0.0:
        share = 0.0
    elif tracking < 0.0 and period * abs(ki) < abs(kp):
        share = period * abs(ki / kp)
    integral += ki * (weight_now * filtered + weight_before * filtered_before) + share * (applied - unlimited)
    x[0], x[1], x[2], x[3] = integral, error, filtered, kp * filtered + integral
    return min(max(x[3], torque_low), torque_high)


@compiled
def sliding(x, t, v, omega, applied, c, table):
    """The generated sliding-mode law, fed with Ta of the assumed adhesion law at the measured slip velocity at rest.

    c: the numbers of the generated `Parameters` in order, then those of the assumed plant and law; x: s, then `State`.
    """
    p = law_parameters(c, 2)
    # floats: the generated law, run in the interpreter, counts with them and not with NumPy's
    torque, s, state = step(law_state(x), float(v), float(omega), float(assumed_torque(v, omega, c, table)), p)
    x[0] = s
    store_state(x, state)
    return torque


@compiled
def slide_protection(x, t, v, omega, applied, c, table):
    """Rule-based slide protection: the valve dumps (-1), holds (0) or fills (1) by slip and wheel deceleration.

    x: torque asked for, filtered wheel speed r omega, whether it has started, what the valve does.
    """
    radius, dump_slip, fill_slip, dump_deceleration = c[1], c[2], c[3], c[4]
    fill_rate, dump_rate, torque_high, period, filter_time = c[5], c[6], c[7], c[8], c[9]
    rim = radius * omega
    if x[2] == 0.0:
        x[1], x[2] = rim, 1.0
    blend = period / (period + filter_time)
    deceleration = (x[1] - rim) / (period + filter_time)
    x[1] += blend * (rim - x[1])
    slip = (v - rim) / v if v > 0.0 else 0.0
    if slip > dump_slip or deceleration > dump_deceleration:
        x[3] = -1.0
    elif slip < fill_slip:
        x[3] = 1.0
    else:
        x[3] = 0.0
    if x[3] < 0.0:
        x[0] -= dump_rate * period
    elif x[3] > 0.0:
        x[0] += fill_rate * period
    x[0] = min(max(x[0], 0.0), torque_high)
    return x[0]


@compiled
def torque_profile(x, t, v, omega, applied, c, table):
    """A torque given over time: n times (s), n torques (N*m), linear in between, constant outside."""
    n, times = int(c[2]), 3
    torques = times + n
    if t >= c[times + n - 1]:
        return c[torques + n - 1]
    for i in range(n - 1):
        now, following = c[times + i], c[times + i + 1]
        if t < following:
            share = (t - now) / (following - now)
            return c[torques + i] + max(share, 0.0) * (c[torques + i + 1] - c[torques + i])
    return c[torques + n - 1]


@compiled
def called(x, t, v, omega, applied, c, table):
    """A user's Python object or Numba function, called at its address; x: the function's own numbers."""
    address = c[2]
    return call_step(address, t, v, omega, x)


# --- the texts -------------------------------------------------------------------------------------------------------


@cache
def step_text(*names: str) -> str:
    """The source of functions of this module, the last one as a kernel's `command`."""
    source = "\n\n".join(inspect.getsource(globals()[name]) for name in names)
    return source.replace(f"def {names[-1]}(", "def command(")


@cache
def linear_source() -> str:
    """The source of `linear` with its difference equations."""
    return plain(Path(difference.__file__).read_text("utf-8")) + "\n\n" + step_text("linear")


@cache
def sliding_source(model: type[AdhesionLaw] | None) -> str:
    """The generated law, the functions of the assumed adhesion law, what joins them, and `sliding`.

    Without a model of its own the law assumes the plant's, whose functions the kernel has; they are named again, so
    that the text is the same for every law.
    """
    states, after = law_states(), 2 + len(generated_law().Parameters._fields)
    own, prefix = ("", "") if model is None else (prefixed(scalar_source(model), "assumed_"), "assumed_")
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
    p, radius = c[{after}:], c[1]
    sigma = v - radius * omega
    z = {prefix}rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p, table)
    return radius * {prefix}force(v, sigma, z, 0.0, 0.0, 0.0, p, table)

"""
    return own + law_kernel_text() + glue + "\n" + step_text("sliding")


def kernel_text(law: type[AdhesionLaw], controller: str, *, compiled: bool = True) -> str:
    """The module of a law, a controller's source text and the loop of `kernel.py`, to be compiled or interpreted."""
    loop = Path(__file__).with_name("kernel.py").read_text("utf-8")
    return module_text(law, controller, plain(loop), compiled=compiled)


@cache
def kernel(law: type[AdhesionLaw], controller: str, *, compiled: bool = True) -> ModuleType:
    """The kernel module, ready to run."""
    return module_of(kernel_text(law, controller, compiled=compiled), compiled=compiled)
