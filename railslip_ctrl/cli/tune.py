"""The command `railslip tune`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NoReturn

import click

from railslip_ctrl.controllers.base import PERIOD, Controller
from railslip_ctrl.controllers.braking import braking_control
from railslip_ctrl.controllers.files import structure_named, structures
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.controllers.sampled import loop_as_run, sampled_peak
from railslip_ctrl.controllers.systems import PIController
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import ms_up
from railslip_ctrl.design.envelope_tuning import Design, by_rule, hand_over_of, tune_over
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design.tuning import Specification, tune_cases
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.linearization import OperatingPoint, linearize
from railslip_ctrl.model.vehicle import Rail, Vehicle
from railslip_ctrl.report.export import check_file
from railslip_ctrl.report.text import by_rule_json, by_rule_text, tuning_json, tuning_text
from railslip_ctrl.simulation.embedded import save_c
from railslip_ctrl.simulation.scenario import LEAST_STEP

from .options import DEFAULT_ENVELOPE, CaseOptions, case_options, envelope_options, number_option, refuse_given
from .output import progress, show
from .settings import HELP, path_option, preset, switch


@click.command(context_settings=HELP)
@case_options(masses=True)
@envelope_options("the vehicle's own or the default, unless operating points are given")
@preset(
    "--structure",
    f"{'|'.join(structures())}|FILE.py",
    "Kind of controller: "
    + "; ".join(f"{name} ({kind.title})" for name, kind in structures().items())
    + "; or a Python file with your own class.",
    "pi",
)
@number_option("--ms-max", "1", "Largest allowed Ms (ratio); ki is maximised.", "none", gt=1)
@number_option("--phase-min", "deg", "Smallest allowed phase margin, deg.", "none", ge=0)
@number_option("--delay-min", "s", "Smallest allowed delay margin, s.", "none", ge=0)
@switch("--minimise-ms", "Minimise the worst Ms instead of maximising ki; needs --ki-min.")
@number_option("--ki-min", "N*m/m", "Smallest allowed integral gain, N*m/m.", "none", gt=0)
@number_option("--lead", "s", "Lead time constant of pi-lead, s.", "the actuator's lag", gt=0)
@number_option("--lead-filter", "s", "Time constant of the lead's filter, s.", "a tenth of the lead", gt=0)
@number_option(
    "--period",
    "s",
    "Sampling period of the controller, s; at most twice the time constant of the lead's filter, for predictive and "
    "seeking at most a twelfth of the dead time.",
    f"{PERIOD:g}, or the largest allowed if that is less",
    ge=LEAST_STEP,
)
@path_option("--out", "FILE.toml|FILE.c", "Write the controller as a file for --controller, or as a C99 program.")
@click.pass_context
def command(
    ctx: click.Context,
    cases: CaseOptions,
    as_json: bool,
    envelope: str | None,
    nominal: bool,
    structure: str,
    ms_max: float | None,
    phase_min: float | None,
    delay_min: float | None,
    minimise_ms: bool,
    ki_min: float | None,
    lead: float | None,
    lead_filter: float | None,
    period: float | None,
    out: Path | None,
) -> None:
    """Find one set of gains for all operating points of an envelope, empty and loaded.

    The result is judged with tolerances, and as a sampled loop. Without --envelope, options for rail, adhesion, slip,
    speed or load restrict the tuning to their operating points, in continuous time. Exit status 1 if the specification
    cannot be met, 2 for bad input.

    Example: railslip tune --structure pi-lead --ms-max 1.8 --envelope default --speed 60 --speed 100
    """
    specification, judgement = Specification(ms_max, phase_min, delay_min), None
    leads = {"lead": lead, "lead_filter": lead_filter}
    _check_out(out)
    kind = structure_named(structure)
    if not issubclass(kind, PI):
        if minimise_ms or {phase_min, delay_min, ki_min, lead, lead_filter} != {None}:
            raise InputError(
                f"--structure {structure}: the parameters of this controller are computed from the vehicle; leave "
                "out all tuning options except --ms-max"
            )
        judged = cases.envelope(envelope or DEFAULT_ENVELOPE)
        _by_rule(ctx, by_rule(kind, judged, ms_max or ROBUST_MS, nominal=nominal, period=period), out, as_json)
    _check_asked(specification, minimise_ms, ki_min)
    if envelope is None and cases.name_points():
        refuse_given("nominal", because="at operating points")
        if out is None:
            refuse_given("period", because="at operating points without --out")
        points = cases.points()
        plants, actuator = [linearize(point) for point in points], points[0].vehicle.actuator
        tuned = tune_cases(plants, actuator, kind=kind, specification=specification, ki_min=ki_min, **leads)
        if out is not None and tuned.design is not None:
            _saved(kind, tuned.controller(tuned.design), points, out, period)
    else:
        judged = cases.envelope(envelope or DEFAULT_ENVELOPE)
        tuned, design = tune_over(judged, specification, kind, ki_min=ki_min, nominal=nominal, period=period, **leads)
        judgement = None if design is None else design.judgement
        if design is not None and judgement is not None and out is not None:
            _write(design, out, judged.vehicle)
            if hand_over := hand_over_of(judgement):
                progress(f"below {hand_over:g} km/h this controller holds a constant torque and does not control slip")
    if out is not None and tuned.design is not None:
        progress(f"wrote {out}")
    show(as_json, lambda: tuning_json(tuned, judgement), lambda: tuning_text(tuned, judgement))
    ctx.exit(0 if tuned.design is not None else 1)


def _check_out(out: Path | None) -> None:
    if out is not None:
        if out.suffix.lower() not in (".toml", ".c"):
            raise InputError(f"--out: {str(out)!r} is neither a TOML file nor a C program; give FILE.toml or FILE.c")
        check_file(out, "--out")


def _write(control: Design | Controller, out: Path, vehicle: Vehicle) -> None:
    if out.suffix.lower() == ".c":
        save_c(control, out, vehicle)
    else:
        control.save(out)


def _by_rule(ctx: click.Context, design: Design, out: Path | None, as_json: bool) -> NoReturn:
    try:
        if out is not None and not design.reason:
            _write(design, out, design.judgement.envelope.vehicle)
            progress(f"wrote {out}")
    finally:
        show(as_json, lambda: by_rule_json(design), lambda: by_rule_text(design))
    ctx.exit(1 if design.reason else 0)


def _check_asked(specification: Specification, minimise_ms: bool, ki_min: float | None) -> None:
    if minimise_ms != (ki_min is not None):
        raise InputError("--minimise-ms and --ki-min need each other; give both, or only --ms-max to maximise ki")
    if not minimise_ms and specification == Specification():
        raise InputError(
            "--ms-max is missing; give --ms-max, --phase-min or --delay-min, or --minimise-ms with --ki-min"
        )


def _saved(
    kind: type[PI], controller: PIController, points: list[OperatingPoint], out: Path, period: float | None
) -> None:
    control = braking_control(controller, points, _references(points), name=out.stem, period=period, kind=kind)
    _write(control, out, points[0].vehicle)
    runs = [loop_as_run(linearize(point), control, point.vehicle.actuator) for point in points]
    worst = max((sampled_peak(run) for run in runs if run is not None), default=0.0)
    result = "is unstable" if math.isinf(worst) else f"has Ms {ms_up(worst)}"
    progress(f"the worst loop with the controller sampled every {control.period:g} s {result}")


def _references(points: list[OperatingPoint]) -> ReferenceSlip:
    # without an operating point on a rail, the law's reference slip, or else the slip on the other rail
    by_rail = {point.rail: point.slip for point in points}
    other, law = points[0].slip, points[0].law.reference
    dry, wet = (by_rail.get(rail, getattr(law, rail.value, other)) for rail in (Rail.DRY, Rail.WET))
    return ReferenceSlip(dry=dry, wet=wet)
