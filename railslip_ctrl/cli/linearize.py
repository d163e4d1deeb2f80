"""`railslip linearize`."""

from __future__ import annotations

from pathlib import Path

import click

from railslip_ctrl.linearization import linearize
from railslip_ctrl.report import linear_plant_json, linearize_text

from .options import case_options, chosen_points, chosen_vehicle
from .output import print_json


@click.command()
@case_options
@click.option("--speed-state", is_flag=True, help="Keep the train speed as a state instead of freezing it.")
def command(
    adhesion: str,
    rails: tuple[str, ...],
    speeds: tuple[float, ...],
    initial_speed: float,
    slip: float | None,
    vehicle: Path | None,
    loaded: bool,
    mass: float | None,
    inertia_scale: float | None,
    as_json: bool,
    speed_state: bool,
) -> None:
    """Operating point and linearisation, from brake torque at the wheel to sigma, lambda and the tracking error.

    Example: railslip linearize --rail dry --speed 100 --speed 40
    """
    chosen = chosen_vehicle(vehicle, loaded, mass, inertia_scale)
    points = chosen_points(chosen, adhesion, rails, speeds, initial_speed, slip)
    plants = [linearize(point, speed_state=speed_state) for point in points]
    if as_json:
        print_json({"cases": [linear_plant_json(plant) for plant in plants]})
    else:
        click.echo(linearize_text(plants), nl=False)
