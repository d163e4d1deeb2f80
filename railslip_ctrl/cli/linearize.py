"""`railslip linearize`."""

from __future__ import annotations

import click

from railslip_ctrl.linearization import linearize
from railslip_ctrl.report import linear_plant_json, linearize_text

from .options import CaseOptions, case_options
from .output import print_json


@click.command()
@case_options
@click.option("--speed-state", is_flag=True, help="Keep the train speed as a state instead of freezing it.")
def command(
    cases: CaseOptions,
    as_json: bool,
    speed_state: bool,
) -> None:
    """Operating point and linearisation, from brake torque at the wheel to sigma, lambda and the tracking error.

    Example: railslip linearize --rail dry --speed 100 --speed 40
    """
    plants = [linearize(point, speed_state=speed_state) for point in cases.points()]
    if as_json:
        print_json({"cases": [linear_plant_json(plant) for plant in plants]})
    else:
        click.echo(linearize_text(plants), nl=False)
