"""A linear controller as the text of its TOML file, every number of it; `controller_files` reads it back."""

from __future__ import annotations

import json
import math
from typing import Any

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design.controllers import LinearController, PIController, PolynomialController


def linear_text(control: Any) -> str:
    """The text of a `LinearControl`; InputError for a system of no period, which no file has."""
    design = control.design
    if control.period is None and not isinstance(design, PIController):
        raise InputError("period: a file of a transfer function or state space needs one; give it (s)")
    rows = {
        **_design_rows(design),
        "period": control.period,
        "torque_min": control.torque_low,
        "torque_max": control.torque_high,
        "anti_windup": control.tracking_time is None or math.isfinite(control.tracking_time),
        "tracking_time": control.tracking_time,
        "initial_torque": control.initial_torque,
        "cut_out_speed": control.cut_out_speed,
        "cut_out_torque": control.cut_out_torque,
        "rule": control.rule.value,
    }
    units = {"period": "s", "tracking_time": "s", "cut_out_speed": "m/s", "lead": "s", "lead_filter": "s"}
    units |= {"kp": "N*m/(m/s)", "ki": "N*m/m", **dict.fromkeys(rows.keys() & _TORQUES, "N*m")}
    lines = [f"kind = {json.dumps(_kind(design))}", f"name = {json.dumps(control.name)}"]
    for key, value in rows.items():
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            continue  # left out: none
        unit = f"  # {units[key]}" if key in units else ""
        lines.append(f"{key} = {_value(value)}{unit}")
    reference = control.reference
    lines += ["", "[reference]", f"dry = {reference.dry!r}", f"wet = {reference.wet!r}"]
    return "\n".join(lines) + "\n"


_TORQUES = {"torque_min", "torque_max", "initial_torque", "cut_out_torque"}


def _kind(design: LinearController) -> str:
    if isinstance(design, PIController):
        return "pi-lead" if design.lead > 0 else "pi"
    return "transfer-function" if isinstance(design, PolynomialController) else "state-space"


def _design_rows(design: LinearController) -> dict[str, Any]:
    if isinstance(design, PIController):
        lead = {"lead": design.lead, "lead_filter": design.lead_filter} if design.structure != "PI" else {}
        return {"kp": design.gains.kp, "ki": design.gains.ki, **lead}
    discrete = {} if design.period is None else {"discrete": True}
    if isinstance(design, PolynomialController):
        return {"num": design.num, "den": design.den, **discrete}
    return {"A": design.a, "B": design.b, "C": design.c, "D": design.d, **discrete}


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"
    return repr(float(value)) if isinstance(value, float) else json.dumps(value)
