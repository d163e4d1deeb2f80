"""`railslip margins`."""

from __future__ import annotations

from itertools import zip_longest

import click

from railslip_ctrl.assessment import assess
from railslip_ctrl.design import PIController
from railslip_ctrl.design.judging import judge
from railslip_ctrl.design.tuning_cases import FILTER_RATIO
from railslip_ctrl.errors import InputError
from railslip_ctrl.linearization import linearize
from railslip_ctrl.parameters import table4_gains
from railslip_ctrl.report import margins_json, margins_text
from railslip_ctrl.report.judging import judgement_json, judgement_text

from .options import CaseOptions, Quantity, case_options, chosen_gains, envelope_options, gain_options
from .output import print_json, print_text
from .settings import HELP


@click.command(context_settings=HELP)
@case_options
@envelope_options("the points of those options")
@gain_options
@click.option(
    "--lead",
    default=0.0,
    type=Quantity("s", ge=0),
    metavar="S",
    help="Time constant of a lead (S s + 1)/(F s + 1) after the PI, s.  [default: none]",
)
@click.option(
    "--lead-filter",
    type=Quantity("s", ge=0),
    metavar="F",
    help="Its filter time constant F, s.  [default: a tenth of the lead]",
)
@click.option(
    "--certify", is_flag=True, help="Enclosures of all margins by ball arithmetic, relative width at most 1e-9."
)
@click.pass_context
def command(
    ctx: click.Context,
    cases: CaseOptions,
    as_json: bool,
    envelope: str | None,
    nominal: bool,
    kp: float | None,
    ki: float | None,
    lead: float,
    lead_filter: float | None,
    certify: bool,
) -> None:
    """Stability margins of the wheel-slip loop with a PI, the dead time exact, at the operating points named, or one
    verdict over an envelope. Exit status 1 if a loop (of an envelope: at an operating point) is unstable, 2 for bad
    input.

    Example: railslip margins --rail dry --kp 190 --ki 5
    """
    gains, time = chosen_gains(kp, ki), FILTER_RATIO * lead if lead_filter is None else lead_filter

    def controller(adhesion: str) -> PIController:
        return PIController(gains or table4_gains(adhesion), lead, time)

    if envelope is not None:
        if certify:
            raise InputError("--certify: goes with operating points; leave --envelope out")
        judgement = judge(controller(cases.adhesion), cases.envelope(envelope), nominal)
        if as_json:
            print_json(judgement_json(judgement))
        else:
            print_text(judgement_text, judgement)
        ctx.exit(1 if judgement.verdict == "unstable" else 0)
    assessments = [
        assess(linearize(point), controller(point.adhesion), point.vehicle.actuator) for point in cases.points()
    ]
    certificates = [assessment.loop.certificate() for assessment in assessments] if certify else []
    if as_json:
        pairs = zip_longest(assessments, certificates)
        print_json({"cases": [margins_json(*pair) for pair in pairs]})
    else:
        print_text(margins_text, assessments, certificates)
    ctx.exit(0 if all(assessment.stable for assessment in assessments) else 1)
