"""`railslip verify`."""

from __future__ import annotations

from typing import get_args

import click

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import Rail
from railslip_ctrl.report.verification import verification_json, verification_text
from railslip_ctrl.verification.joint_verification import LARGEST_GAIN, LARGEST_SEED, LEAST_D, Law, verify
from railslip_ctrl.verification.rails import PUBLISHED_ADHESION, RailAdhesion

from .options import CaseOptions, case_options, is_file, number_option, whole_number
from .output import show
from .settings import HELP, preset

LAWS: tuple[Law, ...] = get_args(Law)


@click.command(context_settings=HELP)
@preset(
    "--law",
    "|".join(LAWS),
    "The published law with the robust variants after it, the robust variants alone, or the predictive law, which "
    "slides behind the actuator.",
    "paper",
)
@number_option(
    "--K",
    "N*m",
    f"Gain on the sign of the surface, 0 to {LARGEST_GAIN:g}: N*m; of the predictive law N*m/s.",
    "Table 4's 70; robust: 1.1 times the K of equation (40) over its box; predictive: its own rule",
    to="gain",
    ge=0,
)
@number_option(
    "--D",
    "N*m/(m/s)",
    f"Gain on s, N*m/(m/s), {LEAST_D:g} to {LARGEST_GAIN:g}; the predictive law has none.",
    "Table 4's 1.53 N*m/(km/h)",
    to="damping",
    gt=0,
)
@preset("--seed", "N", "First seed of samples and simulated runs.", "2008")
@case_options(speeds=False)
@click.pass_context
def command(
    ctx: click.Context,
    law: str,
    gain: float | None,
    damping: float | None,
    seed: str,
    cases: CaseOptions,
    as_json: bool,
) -> None:
    """Which stability conditions of the sliding-mode law hold, how that was decided, and on what evidence. Exit status
    1 if one fails or cannot be decided (of the published law several fail, and of the robust variants those with the
    actuator), 2 for bad input.

    The predictive law is decided over a box of speed, slip and load, for any static adhesion law and vehicle, on the
    rails named; the bristle model is taken by its static curve. An adhesion file has to give its reference slip, or
    --slip does. The other laws take --vehicle, but no --adhesion: they contain the bristle model. --inertia-scale must
    be 0.5 to 10.

    Example: railslip verify --law predictive
    """
    if law == "layered":
        raise InputError("--law: 'layered' was replaced by the predictive law; give --law predictive")
    adhesion, vehicle = _adhesion(cases), cases.chosen_vehicle
    result = verify(
        law=law,  # type: ignore[arg-type]  # checked there
        vehicle=vehicle,
        K=gain,
        D=damping,
        seed=whole_number("--seed", seed, 0, LARGEST_SEED),
        adhesion=adhesion,
    )
    show(
        as_json,
        lambda: verification_json(result),
        lambda: verification_text(result, _about(cases, adhesion)),
    )
    ctx.exit(0 if result.all_hold else 1)


def _adhesion(cases: CaseOptions) -> RailAdhesion:
    """The adhesion named. A file's parameters are for one rail, and say themselves what follows on the other."""
    rails = cases.chosen_rails()
    if not is_file(cases.adhesion):
        return RailAdhesion(cases.adhesion, rails, cases.slip, cases.initial_speed)
    try:
        law = cases.law(Rail.DRY)
    except InputError:  # parameters for wet rail; or a file that is refused here again
        law = cases.law(Rail.WET)
    return RailAdhesion(law, rails, cases.slip, cases.initial_speed)


def _about(cases: CaseOptions, adhesion: RailAdhesion) -> tuple[tuple[str, str], ...]:
    """Vehicle and adhesion with its reference slips, for the report's head, where any was named."""
    vehicle = cases.chosen_vehicle
    slips = ", ".join(f"{adhesion.reference(rail, vehicle):.4g} {rail}" for rail in adhesion.rails)
    source = f" ({cases.adhesion})" if is_file(cases.adhesion) else ""
    about = [] if cases.vehicle is None else [("Vehicle", vehicle.name)]
    if adhesion != PUBLISHED_ADHESION:
        about += [("Adhesion", f"{adhesion.text}{source}"), ("Reference slip", slips)]
    return tuple(about)
