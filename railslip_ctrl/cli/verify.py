"""`railslip verify`."""

from __future__ import annotations

from typing import get_args

import click

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import Rail
from railslip_ctrl.report.verification import conclusion_text, verification_json, verification_text
from railslip_ctrl.verification.joint_verification import LARGEST_GAIN, LARGEST_SEED, LEAST_D, Law, verify_with_actuator
from railslip_ctrl.verification.layered import PUBLISHED_ADHESION, RailAdhesion

from .options import CaseOptions, case_options, is_file, number_option, whole_number
from .output import show
from .settings import HELP, preset

LAWS: tuple[Law, ...] = get_args(Law)


@click.command(context_settings=HELP)
@preset(
    "--law",
    "|".join(LAWS),
    "The published law with the robust variants after it, the robust variants alone, or the layered law that "
    "accounts for the actuator.",
    "paper",
)
@number_option(
    "--K",
    "N*m",
    f"Gain on sgn s of that law, N*m, 0 to {LARGEST_GAIN:g}; of the layered law > 0.",
    "Table 4's 70; "
    "robust: 1.1 times the K of equation (40) with 10 % error of Ta and v'; layered: 1.05 times the least K with "
    "10 % error of the holding torque",
    to="gain",
    ge=0,
)
@number_option(
    "--D",
    "N*m/(m/s)",
    f"Gain on s of that law, N*m/(m/s), {LEAST_D:g} to {LARGEST_GAIN:g}; the layered law has none.",
    "Table 4's 1.53 N*m/(km/h)",
    to="damping",
    gt=0,
)
@number_option(
    "--ki-min",
    "N*m/m",
    "Least integral gain of the layered law, N*m/m; a larger one corrects a wrong holding torque faster.",
    "100 times the inertia scale",
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
    ki_min: float | None,
    seed: str,
    cases: CaseOptions,
    as_json: bool,
) -> None:
    """Which stability conditions of the sliding-mode law hold, how that was decided, and on what evidence. Exit status
    1 if one fails or cannot be decided (of the published law several fail, and of the robust variants those with the
    actuator), 2 for bad input.

    The layered law is tuned and verified for any adhesion and vehicle, on the rails named, from 100 km/h; an adhesion
    file has to give its reference slip, or --slip does. The other laws take --vehicle, but no --adhesion: they contain
    the bristle model, and their conditions are decided over its published parameters. --inertia-scale must be 0.5 to
    10.

    Example: railslip verify --law layered
    """
    adhesion, vehicle = _adhesion(cases), cases.chosen_vehicle
    full = verify_with_actuator(
        law=law,  # type: ignore[arg-type]  # checked there
        vehicle=vehicle,
        K=gain,
        D=damping,
        seed=whole_number("--seed", seed, 0, LARGEST_SEED),
        adhesion=adhesion,
        ki_min=ki_min,
    )
    result = full.verification
    show(
        as_json,
        lambda: verification_json(result),
        lambda: verification_text(result, conclusion_text(full), _about(cases, adhesion)),
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
