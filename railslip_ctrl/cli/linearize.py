"""The command `railslip linearize`."""

from __future__ import annotations

import click

from railslip_ctrl.model.linearization import linearize
from railslip_ctrl.report import linear_plant_json, linearize_text

from .options import CaseOptions, case_options
from .output import show
from .settings import HELP, switch


@click.command(context_settings=HELP)
@case_options()
@switch("--speed-state", "Keep the train speed as a state instead of holding it constant.")
def command(cases: CaseOptions, as_json: bool, speed_state: bool) -> None:
    """Linearise the plant from brake torque at the wheel to slip velocity, slip ratio and tracking error.

    Exit status 0, or 2 for bad input.

    Example: railslip linearize --rail dry --speed 100 --speed 40
    """
    plants = [linearize(point, speed_state=speed_state) for point in cases.points()]
    show(as_json, lambda: {"cases": [linear_plant_json(plant) for plant in plants]}, lambda: linearize_text(plants))
