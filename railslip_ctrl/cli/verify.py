"""The command `railslip verify`."""

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
    "paper: the published law, then the robust variants; robust: only the robust variants; predictive: the predictive "
    "law, whose sliding condition includes the actuator.",
    "paper",
)
@number_option(
    "--K",
    "N*m",
    f"Gain on the sign of s, 0 to {LARGEST_GAIN:g} N*m; for the predictive law in N*m/s.",
    "70, of Park et al., Table 4; robust: 1.1 times the K that (40) of Park et al. needs over the box; predictive: "
    "computed from the vehicle",
    to="gain",
    ge=0,
)
@number_option(
    "--D",
    "N*m/(m/s)",
    f"Gain on s, N*m/(m/s), {LEAST_D:g} to {LARGEST_GAIN:g}; not for the predictive law.",
    "1.53 N*m/(km/h), of Park et al., Table 4",
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
    """Decide which stability conditions of a sliding-mode law hold, and show method and evidence.

    Exit status 1 if a condition fails or cannot be decided, 2 for bad input. The published law fails several
    conditions. Its robust variants fail the conditions that include the actuator.

    The predictive law is verified over ranges of speed, slip and load, on the given rails, for any vehicle and any
    static adhesion law. The bristle model is replaced by its static curve. The reference slip comes from the adhesion
    file or from --slip. The other laws take --vehicle but no --adhesion, because they contain the bristle model.
    --inertia-scale must be 0.5 to 10.

    Example: railslip verify --law predictive
    """
    if law == "layered":
        raise InputError("--law: 'layered' was replaced by the predictive law; give --law predictive")
    adhesion, vehicle = _adhesion(cases), cases.chosen_vehicle
    result = verify(
        law=law,  # type: ignore[arg-type]  # `verify` checks it
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
    rails = cases.chosen_rails()
    if not is_file(cases.adhesion):
        return RailAdhesion(cases.adhesion, rails, cases.slip, cases.initial_speed)
    try:  # a file has parameters for one rail, and the law for the other rail is derived from it
        law = cases.law(Rail.DRY)
    except InputError:  # the parameters are for wet rail; a faulty file raises the error again below
        law = cases.law(Rail.WET)
    return RailAdhesion(law, rails, cases.slip, cases.initial_speed)


def _about(cases: CaseOptions, adhesion: RailAdhesion) -> tuple[tuple[str, str], ...]:
    vehicle = cases.chosen_vehicle
    slips = ", ".join(f"{adhesion.reference(rail, vehicle):.4g} {rail}" for rail in adhesion.rails)
    source = f" ({cases.adhesion})" if is_file(cases.adhesion) else ""
    about = [] if cases.vehicle is None else [("Vehicle", vehicle.name)]
    if adhesion != PUBLISHED_ADHESION:
        about += [("Adhesion", f"{adhesion.text}{source}"), ("Reference slip", slips)]
    return tuple(about)
