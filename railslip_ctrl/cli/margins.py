"""The command `railslip margins`."""

from __future__ import annotations

from functools import partial
from itertools import zip_longest
from typing import Any

import click

from railslip_ctrl.controllers.pi import FILTER_RATIO
from railslip_ctrl.controllers.systems import PIController
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.assessment import assess
from railslip_ctrl.design.judging import finds_slip, judge
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.linearization import OperatingPoint, linearize
from railslip_ctrl.model.vehicle import PIGains, table4_gains
from railslip_ctrl.report import margins_json, margins_text
from railslip_ctrl.report.text import judgement_json, judgement_text

from . import options
from .output import show
from .settings import HELP, option, switch


@click.command(context_settings=HELP)
@options.case_options()
@options.envelope_options("none; margins are computed at operating points")
@options.gain_options("those of Park et al., Table 4")
@options.controller_option("a PI of --kp, --ki and --lead")
@option(
    "--lead",
    "S",
    "Time constant of a lead (S s + 1)/(F s + 1) after the PI, s.",
    "none",
    type=options.Number("s", ge=0),
)
@option("--lead-filter", "F", "Filter time constant F, s.", "a tenth of the lead", type=options.Number("s", ge=0))
@switch("--certify", "Also compute proven bounds of all margins, with a relative width of at most 1e-9.")
@click.pass_context
def command(
    ctx: click.Context,
    cases: options.CaseOptions,
    as_json: bool,
    envelope: str | None,
    nominal: bool,
    controller: str | None,
    kp: float | None,
    ki: float | None,
    lead: float | None,
    lead_filter: float | None,
    certify: bool,
) -> None:
    """Compute stability margins with the exact dead time at operating points, or a verdict over an envelope.

    The controller is linear, predictive or seeking; with a discrete controller the loop is computed as a sampled loop.
    A controller from a file is judged at its own reference slip, or at --slip if given. Exit status 1 if a loop is
    unstable, 2 for bad input.

    Example: railslip margins --rail dry --kp 190 --ki 5
    """
    gains = options.chosen_gains(kp, ki)
    time = lead or 0.0
    pi_of = partial(PIController, lead=time, lead_filter=FILTER_RATIO * time if lead_filter is None else lead_filter)
    given: Any = None
    if controller is not None:
        for option, value in (("--lead", lead), ("--lead-filter", lead_filter)):
            if value is not None:
                raise InputError(f"{option} has no effect with --controller; give only one of the two options")
    if envelope is not None:
        if certify:
            raise InputError("--certify is only for operating points; leave --envelope out")
        judged = cases.envelope(envelope)
        if controller is not None:
            point = judged.points(nominal=True).plants[0].point
            given = given_controller(controller, point, gains, judged.reference)
        judgement = judge(judged, given or pi_of(gains or table4_gains(cases.adhesion)), nominal)
        show(as_json, lambda: judgement_json(judgement), lambda: judgement_text(judgement))
        ctx.exit(1 if judgement.verdict == "unstable" else 0)
    options.refuse_given("nominal", because="without --envelope")
    points = cases.points()
    if controller is not None:
        given = given_controller(controller, points[0], gains)
        points = cases.points(None if finds_slip(given) else getattr(given, "reference", None))
        below = given.controlled_from / KMH
        slow = [point.speed_kmh for point in points if point.speed_kmh < below * (1 - 1e-9)]
        if slow:
            options.warn(
                f"--controller: slip is not controlled below {below:.4g} km/h, but the loop is judged at "
                f"{min(slow):g} km/h; give a higher --speed"
            )
    assessments = [
        assess(linearize(point), given or pi_of(gains or table4_gains(point.adhesion)), point.vehicle.actuator)
        for point in points
    ]
    if certify and any(isinstance(assessment.loop, SampledLoop) for assessment in assessments):
        raise InputError("--certify: the loop of a discrete controller has no certificate; leave --certify out")
    certificates = [assessment.loop.certificate() for assessment in assessments] if certify else []
    pairs = zip_longest(assessments, certificates)
    show(
        as_json,
        lambda: {"cases": [margins_json(*pair) for pair in pairs]},
        lambda: margins_text(assessments, certificates),
    )
    ctx.exit(0 if all(assessment.stable for assessment in assessments) else 1)


def given_controller(
    text: str, point: OperatingPoint, gains: PIGains | None, reference: ReferenceSlip | None = None
) -> Any:
    """Return the controller given by `text`, the value of --controller.

    A controller without a reference slip gets `reference`. If `reference` is None, the controller gets the reference
    slip of the adhesion law or, if the law has none, the slip of the operating point.
    """
    from railslip_ctrl.design.catalogue import controller_named, default_column

    slips = reference or point.law.reference or ReferenceSlip(dry=point.slip, wet=point.slip)
    if options.is_file(text):
        if gains is not None:
            raise InputError(f"--kp has no effect with a controller from a file; write the gain into {text}")
        return options.controller_from_file(text, point.vehicle, slips, point.speed)
    name = options.controller_name(text)
    return controller_named(name, point.vehicle, column=default_column(point.law), gains=gains, reference=slips)
