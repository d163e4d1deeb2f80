"""Results of `railslip linearize`, `margins` and `tune` as text, and verdicts and tuned designs as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import RenderableType

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.systems import LinearController, describe_system, plain_number
from railslip_ctrl.core.units import BOUND_DIGITS, ms_down, ms_up, rounded_up
from railslip_ctrl.design.assessment import Assessment, assess
from railslip_ctrl.design.envelope import ERRORS, Envelope
from railslip_ctrl.design.envelope_tuning import Design
from railslip_ctrl.design.judging import Judgement, WorstCase
from railslip_ctrl.design.tuning import TunedCases
from railslip_ctrl.loop import Certificate, Margins
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.model.vehicle import Actuator, Rail, Vehicle, notes_and_warnings

from .document import (
    MARGIN_HEAD,
    Facts,
    Paragraph,
    Picture,
    Section,
    Table,
    above,
    below,
    counted,
    fixed,
    heading,
    ms_text,
    render,
    roots_text,
)
from .export import (
    PUBLISHED,
    case_json,
    controller_json,
    exported,
    law_json,
    law_text_at,
    margin_numbers,
    margins_json,
    source_at,
)

if TYPE_CHECKING:
    from .recommendation import Released


def _matrix(matrix: Iterable[Iterable[float]]) -> str:
    return "[" + "; ".join(" ".join(f"{x:.7g}" for x in row) for row in matrix) + "]"


def case_title(point: OperatingPoint) -> str:
    """Describe an operating point in one line."""
    return f"{law_text_at(point)}, {point.place}, inertia scale {point.vehicle.inertia_scale:g}" + (
        "" if point.initial_speed_kmh is None else f", v0 {point.initial_speed_kmh:g} km/h"
    )


def controller_text(controller: LinearController | Controller) -> str:
    """Describe a linear system or a controller by its name and its parameters."""
    return controller.described() if isinstance(controller, Controller) else describe_system(controller)


def _actuator(actuator: Actuator) -> str:
    return f"dead time {actuator.dead_time:g} s (exact), lag {actuator.lag:g} s"


def vehicle_line(vehicle: Vehicle) -> str:
    """Return the vehicle's name, source and wheel load in one line."""
    source = f"  {vehicle.source}" if vehicle.source else ""
    return f"{vehicle.name}{source}, wheel load {vehicle.wheel_load:g} N"


def _loads(empty: float, loaded: float, unit: str) -> str:
    if empty == loaded:
        return f"{empty:g} {unit}"  # the vehicle has one load case, or only its loaded state is used
    return f"{empty:g} {unit} empty, {loaded:g} {unit} loaded"


def vehicle_facts(vehicle: Vehicle) -> list[tuple[str, str]]:
    """Return name and value of each vehicle parameter, with its unit, and notes and warnings on the vehicle."""
    wheel, resistance = vehicle.wheel, vehicle.resistance
    rows = [
        ("Vehicle", vehicle.name + (f"  {vehicle.source}" if vehicle.source else "")),
        ("Quarter-car mass M", _loads(vehicle.mass, vehicle.mass_loaded, "kg")),
        ("Wheel load N", _loads(vehicle.wheel_load, vehicle.wheel_load_loaded, "N")),
        (
            "Wheel",
            f"radius {wheel.radius:g} m, inertia {wheel.inertia:g} kg·m², "
            f"viscous friction {wheel.viscous_friction:g} N·m·s",
        ),
        (
            "Travelling resistance",
            f"{resistance.constant:.5g} + {resistance.linear:.5g} v + {resistance.quadratic:.5g} v² N, v in m/s",
        ),
        ("Brake actuator", _actuator(vehicle.actuator)),
        ("Inertia scale", f"{vehicle.inertia_scale:g} on M, J and B"),
    ]
    return rows + [("Note", note) for note in notes_and_warnings(vehicle)]


def law_facts(points: Iterable[OperatingPoint]) -> list[tuple[str, str]]:
    """Describe the adhesion law of each rail, and how its wet parameters follow from the dry ones."""
    distinct = {(point.rail, point.law.parameters()): point for point in points}
    dry = next((point.law for point in distinct.values() if point.rail is Rail.DRY), None)
    return [
        (f"Adhesion law, {point.rail} rail", f"{law_text_at(point)}: {_parameters(point.law)}{_wet_rule(point, dry)}")
        for point in distinct.values()
    ]


def _parameters(law: AdhesionLaw) -> str:
    units = {name: "" if unit == "1" else f" {unit.replace('*', '·')}" for name, (_, unit) in law.numbers().items()}
    return ", ".join(f"{name} {plain_number(value)}{units[name]}" for name, (value, _) in law.numbers().items())


def _wet_rule(point: OperatingPoint, dry: AdhesionLaw | None) -> str:
    if point.rail is not Rail.WET or source_at(point) == PUBLISHED:
        return ""
    if dry is not None:
        derived = dry.wet().parameters() == point.law.parameters()
        return f"; computed from the dry parameters: {_factors(dry)}" if derived else ""
    rule = _factors(point.law.model_copy(update={"rail": Rail.DRY}))
    return f"; given for wet rail or computed from dry parameters ({rule})" if rule else ""


def _factors(dry: AdhesionLaw) -> str:
    texts = []
    wet = dry.wet().numbers()
    for name, (value, _) in dry.numbers().items():
        columns = zip(np.atleast_1d(wet[name][0]), np.atleast_1d(value), strict=True)
        ratios = [new / old for new, old in columns if old != 0.0]
        if ratios and ratios[0] != 1.0:
            texts.append(f"{name} × {ratios[0]:g}")
    return ", ".join(texts) or "no parameter changes"


def linearize_text(plants: Sequence[LinearPlant]) -> str:
    """Return each operating point and its linearised plant as text."""
    parts: list[RenderableType] = []
    for plant in plants:
        point = plant.point
        num, den = plant.transfer_function()
        frozen = "speed as a state" if plant.speed_state else "speed frozen"
        rows = [
            ("Vehicle", vehicle_line(point.vehicle)),
            (
                "Operating point",
                f"slip velocity {point.sigma:.6g} m/s, adhesion coefficient {point.adhesion_coefficient:.5g}",
            ),
            ("Adhesion force", f"{point.adhesion_force:.7g} N"),
            ("Brake torque", f"{point.brake_torque:.7g} N·m (λ' = 0, travelling resistance included)"),
            ("Residual", f"{point.residual:.1e} (relative error of the equilibrium of λ and the adhesion state)"),
            ("States", ", ".join(plant.states)),
            ("Input", ", ".join(plant.inputs) + " at the wheel, N·m (without the actuator)"),
            ("Outputs", ", ".join(plant.outputs) + f" (error = {point.slip:g} v − sigma)"),
            ("A", _matrix(plant.A)),
            ("B", _matrix(plant.B)),
            ("C", _matrix(plant.C)),
            ("D", _matrix(plant.D)),
            ("Poles, 1/s", roots_text(plant.poles)),
            ("Zeros, 1/s", roots_text(plant.zeros) + "   (torque to sigma)"),
            ("sigma/torque", f"({polynomial_text(num)}) / ({polynomial_text(den)})   (m/s)/(N·m)"),
        ]
        parts += [heading(f"Linearisation, {frozen}: {case_title(point)}"), Facts(rows), ""]
    return render(parts[:-1])


def polynomial_text(coefficients: Iterable[float]) -> str:
    """Return a polynomial in s as text; the first of `coefficients` belongs to the highest power."""
    values = list(coefficients)
    terms: list[str] = []
    for i, value in enumerate(values):
        power = len(values) - 1 - i
        symbol = "" if power == 0 else " s" if power == 1 else f" s^{power}"
        sign = " - " if value < 0 else " + " if terms else ""
        terms.append(f"{sign}{abs(value):.6g}{symbol}")
    return "".join(terms)


def margins_text(assessments: Sequence[Assessment], certificates: Sequence[Certificate] = ()) -> str:
    """Return the stability margins of each loop as text, with its certificate if there is one."""
    parts: list[RenderableType] = []
    for assessment, certificate in zip_longest(assessments, certificates):
        parts += [*_assessment(assessment), *_certificate(certificate), ""]
    return render(parts[:-1])


def _assessment(assessment: Assessment) -> list[RenderableType]:
    limits = assessment.limits
    p = limits.unstable_pole
    poles = assessment.closed_loop_poles
    rows = [
        ("Vehicle", vehicle_line(assessment.point.vehicle)),
        ("Controller", controller_text(assessment.controller)),
        ("Actuator", _actuator(assessment.actuator)),
        ("Plant poles, 1/s", roots_text(assessment.plant.poles)),
        ("Limits", _limits(assessment) if p > 0 else "none, because the plant has no unstable pole"),
        ("Open loop", counted(assessment.loop.open_loop_unstable_poles, "unstable pole")),
    ]
    if poles.size:
        rows.append(("Closed-loop poles, 1/s", f"{roots_text(poles)}   (the rightmost {poles.size}, dead time exact)"))
    parts: list[RenderableType] = [heading(f"Stability margins: {case_title(assessment.point)}"), Facts(rows)]
    if (m := assessment.margins) is not None:
        pairs = zip(m.gain_crossovers, m.phase_margins_deg, strict=True)
        crossovers = ", ".join(f"{w:.5g} rad/s ({phase:+.4g} deg)" for w, phase in pairs) or "none"
        parts += ["", _margin_table(assessment, m), f"Gain crossovers: {crossovers}\n"]
    if assessment.pade:
        parts += _pade_part(assessment)
    if assessment.as_run is not None:
        m = assessment.sampled
        numbers = "unstable"
        if m is not None:
            numbers = f"Ms {ms_up(m.ms)}"
            if not math.isnan(m.phase_deg):  # NaN if only the continuous loop has a phase margin
                numbers += f", phase margin {m.phase_deg:.4g} deg, delay margin {m.delay_s:.4g} s"
        parts.append(f"Sampled loop, period {assessment.as_run.period:g} s: {numbers}")
    parts.append(f"Verdict: {assessment.verdict_line}")
    return parts


def _certificate(certificate: Certificate | None) -> list[RenderableType]:
    if certificate is None:
        return []
    if not certificate.stable:
        poles = f"{certificate.unstable_poles:g} in the closed right half plane"
        axis = f"; one is on the imaginary axis or within 2^-{certificate.bits} of it" if certificate.marginal else ""
        return [f"Certificate: unstable, closed-loop poles: {poles}{axis}"]
    rows = [
        (name, *map(str, ends), unit)
        for name, unit, ends in (
            ("Gain increase", "×", certificate.gain_increase),
            ("Gain decrease", "×", certificate.gain_decrease),
            ("Phase margin", "deg", certificate.phase_deg),
            ("Delay margin", "s", certificate.delay_s),
            ("Ms = max |S|", "-", certificate.ms),
            ("Mt = max |T|", "-", certificate.mt),
        )
        if ends is not None
    ]
    balls = f"ball arithmetic, {certificate.bits} bits; |S| and |T| bounded on {certificate.parts} frequency intervals"
    return ["", Table(("Certified", "Lowest", "Highest", "Unit"), rows), f"Certificate: stable; {balls}"]


def _limits(assessment: Assessment) -> str:
    limits = assessment.limits
    against = "< 1, which a PI requires" if limits.actuator_product < 1 else ">= 1, so no PI stabilises the plant"
    text = (
        f"unstable pole p = {limits.unstable_pole:.5g} 1/s (a slip error doubles in {limits.doubling_time:.3g} s); "
        f"p (dead time + lag) = {limits.actuator_product:.4g} {against}"
    )
    if (least := ms_down(limits.ms_bound)) != "1.00":  # 1.00 is no limit
        text += f"; no controller has Ms or Mt below {least}"
    for structure in (limits.pi, limits.pi_lead):
        if structure is None:
            continue
        name = "a PI" if structure.structure == "PI" else "a PI with a lead that cancels the lag"
        if structure.feasible:
            phase = fixed(rounded_up(structure.phase_deg, BOUND_DIGITS), BOUND_DIGITS)
            text += f"; {name}: phase margin <= {phase} deg, Ms >= {ms_down(structure.ms_bound)}"
        else:
            text += f"; {name} cannot stabilise the plant"
    return text


def _decibel(factor: float) -> str:
    return f"{20 * math.log10(factor):+.2f} dB" if 0 < factor < math.inf else ""


def _margin_table(assessment: Assessment, m: Margins) -> RenderableType:
    low, high = m.disk_gain_range
    disk = f"gain {low:.4g} to {fixed(high, 4)}, phase ±{m.disk_phase_deg:.4g} deg at the same time"
    rows = [
        ("Gain increase", fixed(m.gain_increase, 6), "×", fixed(m.gain_increase_frequency), _decibel(m.gain_increase)),
        ("Gain decrease", _decrease(m, 6), "×", fixed(m.gain_decrease_frequency), _decibel(m.gain_decrease)),
        ("Phase margin", fixed(m.phase_deg, 6), "deg", fixed(m.phase_frequency), "smallest of all gain crossovers"),
        ("Delay margin", fixed(m.delay_s, 6), "s", fixed(m.delay_frequency), "added dead time that destabilises"),
        ("Ms = max |S|", fixed(m.ms, 6), "-", fixed(m.ms_frequency), f"distance to −1: {1 / m.ms:.4g}"),
        ("Mt = max |T|", fixed(m.mt, 6), "-", fixed(m.mt_frequency), ""),
        ("Disk margin", fixed(m.disk, 6), "-", fixed(m.disk_frequency), disk),
    ]
    usable = assessment.stabilizing_gain_range
    if usable is not None:
        factors = f"{usable[0]:.5g} to {fixed(usable[1])}"
        rows.append(("Stabilising gain", factors, "×", "", "factor on the controller's gain"))
    return Table(("Margin", "Value", "Unit", "At ω, rad/s", ""), rows, text_columns=(2, 4))


def _decrease(m: Margins, digits: int) -> str:
    return fixed(m.gain_decrease, digits) if m.gain_decrease > 0 else "unbounded"


def _pade_part(assessment: Assessment) -> list[RenderableType]:
    exact, orders = assessment.margins, assessment.pade
    if exact is None and all(row.margins is None for row in orders):
        first, last = orders[0].order, orders[-1].order
        return [f"Pade approximation of the dead time: orders {first} to {last} also give an unstable loop"]
    rows = []
    for row in orders:
        error = "" if (row.margins is None) == (exact is None) else "wrong verdict"
        if row.margins is not None and exact is not None:
            percent = 100 * (row.margins.ms / exact.ms - 1)
            error = f"{percent:+.2g} %" if abs(percent) >= 1e-9 else "< 1e-9 %"
        rows.append([str(row.order), *_pade_cells(row.margins), error])
    rows.append(["exact", *_pade_cells(exact), ""])
    head = ("Order", "Closed loop", "Gain increase", "Gain decrease", "Phase, deg", "Delay, s", "Ms", "Ms error")
    return ["Pade approximation of the dead time, compared with the exact loop:", Table(head, rows)]


def _pade_cells(m: Margins | None) -> list[str]:
    if m is None:
        return ["unstable", "-", "-", "-", "-", "-"]
    return ["stable", fixed(m.gain_increase), _decrease(m, 5), fixed(m.phase_deg), fixed(m.delay_s), fixed(m.ms)]


def judgement_json(judgement: Judgement) -> dict[str, Any]:
    """Return a judgement as JSON; `cases` has the margins of each operating point without tolerances."""
    points = judgement.points
    operating = [points.case(int(i)) for i in np.flatnonzero(points.operating)]
    margins = [margins_json(assess(case.plant, judgement.controller, case.actuator)) for case in operating]
    cases = [numbers | {"load": case.load} for numbers, case in zip(margins, operating, strict=True)]
    return {**judgement.table(), "cases": cases}


def judgement_text(judgement: Judgement) -> str:
    """Return the verdict, the worst cases, and the worst Ms over speed and load as text."""
    return render(judgement_parts(judgement))


def judgement_parts(judgement: Judgement) -> list[RenderableType]:
    """Return the content of `judgement_text` as Rich objects."""
    used, robust = judgement.usable_from_kmh, judgement.robust_from_kmh
    operating = int(judgement.points.operating.sum())
    over = "At all speeds" if used is None or used <= min(judgement.envelope.speeds) else f"From {used:g} km/h up"
    rows = [
        ("Envelope", envelope_text(judgement.envelope)),
        ("Points", f"{len(judgement.points)}, {operating} of them operating points (without tolerances)"),
        ("Stable", "not at the highest speed" if used is None else f"from {used:g} km/h up"),
        ("Robust", "not at the highest speed" if robust is None else f"from {robust:g} km/h up"),
    ]
    # the first line of the judgement is its verdict
    verdict, *notes = str(judgement).splitlines()
    return [
        heading("Verdict over the envelope"),
        Facts(rows),
        Table((over, "", "Case"), list(worst_rows(judgement)), text_columns=(2,)),
        _map_table(judgement),
        *notes,
        f"Verdict: {verdict}",
    ]


def envelope_text(envelope: Envelope) -> str:
    """Describe an envelope in one line."""
    car, table = envelope.vehicle, envelope.table()
    lists = [", ".join(table[name]) for name in ("rails", "laws", "loads")]
    speeds = f"{', '.join(f'{v:g}' for v in envelope.speeds)} km/h"
    names = ["slip", "dead_time", "lag", "radius", *(name for name in ERRORS if table[name] != [1.0])]
    factors = (f"{name.replace('_', ' ')} {', '.join(f'{x:g}' for x in table[name])}" for name in names)
    slips = [f"{value:g} {rail}" for rail, value in table.get("reference", {}).items() if rail in table["rails"]]
    return "; ".join(
        [car.name, *lists, speeds, *([f"slip {', '.join(slips)}"] if slips else []), f"factors on {'; '.join(factors)}"]
    )


def worst_rows(judged: Judgement) -> Iterator[tuple[str, str, str]]:
    """Yield name, value and case of the worst Ms and the smallest margins, at speeds from `usable_from_kmh` up."""
    name, value, where = worst_cells(judged.worst)
    yield f"Worst {name}", value, where
    if not judged.nominal:
        name, value, where = worst_cells(judged.worst_with_tolerances)
        yield f"Worst {name.replace('Ms', 'Ms with tolerances')}", value, where
    if judged.worst.margins is None:
        return
    kind = f"nominal{_kind_of(judged.worst)}"
    (phase, phase_at), (delay, delay_at) = judged.least("phase_deg"), judged.least("delay_s")
    (low, low_at), (high, high_at) = judged.least("gain_decrease", largest=True), judged.least("gain_increase")
    where = low_at.description if low_at == high_at else f"low: {low_at.description}; high: {high_at.description}"
    yield f"Phase margin, {kind}", f"{below(phase)} deg", phase_at.description
    yield f"Delay margin, {kind}", f"{below(delay)} s", delay_at.description
    yield f"Gain range, {kind}", f"{above(low)} to {below(high)}", where


def worst_cells(worst: WorstCase) -> tuple[str, str, str]:
    """Return name, value and case of the worst Ms, of the continuous or of the sampled loop, whichever Ms is larger."""
    if worst.as_run is None or worst.run_ms <= worst.ms:
        return f"Ms{_kind_of(worst)}", ms_text(worst.ms), worst.case.description
    return "Ms, sampled", ms_text(worst.run_ms), f"{worst.run_case.description}; continuous {ms_text(worst.ms)}"


def _kind_of(worst: WorstCase) -> str:
    return ", sampled" if isinstance(worst.loop, SampledLoop) else "" if worst.as_run is None else ", continuous"


def _map_table(judgement: Judgement) -> RenderableType:
    ms_map = judgement.map
    kinds = {"": ms_map.operating} | ({} if judgement.nominal else {", tolerances": ms_map.with_tolerances})
    head = ["Speed, km/h", *(f"Worst Ms, {load}{kind}" for kind in kinds for load in ms_map.loads)]
    rows = [
        [f"{speed:g}", *(ms_text(float(ms)) for values in kinds.values() for ms in values[i])]
        for i, speed in enumerate(ms_map.speeds_kmh.tolist())
    ]
    return Table(head, rows)


def tuning_json(tuned: TunedCases, judgement: Judgement | None = None) -> dict[str, Any]:
    """Return a tuned design as JSON, with the verdict if `judgement` is given; gains that were not found are null."""
    design = tuned.design
    margins: Sequence[Margins | None] = [None] * len(tuned.points)
    worst = None
    if design is not None:
        margins = design.margins
        worst = exported(design.worst, "ms", phase_margin_deg="phase_deg", delay_margin_s="delay_s")
        worst["case"] = case_json(tuned.points[design.worst.ms_member])
    return {
        **exported(tuned, "reason", structure="kind.kind", lead_s="lead", lead_filter_s="lead_filter"),
        **exported(design, kp_si="kp", ki_si="ki"),
        "ms_max_asked": tuned.specification.ms_max,
        "worst": worst,
        "cases": [
            {**case_json(point), "adhesion_law": law_json(point.law, source_at(point)), **margin_numbers(m)}
            for point, m in zip(tuned.points, margins, strict=True)
        ],
        "feasible": design is not None,
        **({} if judgement is None else judgement.table()),
    }


def by_rule_json(design: Design) -> dict[str, Any]:
    """Return a controller computed from the vehicle alone, and its verdict over an envelope, as JSON."""
    head = {"structure": design.structure, "reason": design.reason, "controller": controller_json(design.controller)}
    return {**head, "feasible": not design.reason, **design.judgement.table()}


def by_rule_text(design: Design) -> str:
    """Return a controller computed from the vehicle alone, and its verdict over an envelope, as text."""
    control, rows = design.controller, []
    for name, field in type(control).model_fields.items():
        extra, value = field.json_schema_extra, getattr(control, name)
        if isinstance(extra, dict) and isinstance(value, float):
            unit = str(extra["unit"])
            rows.append((name, f"{value:.6g}", "" if unit == "1" else unit, field.description or ""))
    parts: list[RenderableType] = [
        heading(f"Parameters computed for {design.judgement.points.vehicle.name}: {design.structure}"),
        Table(("Key", "Value", "Unit", "Meaning"), rows, text_columns=(2, 3)),
    ]
    parts += ["", f"Infeasible: {design.reason}"] if design.reason else []
    return render([*parts, "", *judgement_parts(design.judgement)])


def tuning_text(tuned: TunedCases, judgement: Judgement | None = None) -> str:
    """Return a tuned design as text, with the verdict if `judgement` is given, otherwise with all margins."""
    design, points = tuned.design, tuned.points
    name = tuned.kind.title
    # if the design is infeasible, its reason names the operating points
    at = "" if design is None else f" at {counted(len(points), 'operating point')}"
    parts: list[RenderableType] = [heading(f"Tuning: {name}{at}")]
    laws = ", ".join(dict.fromkeys(law_text_at(point) for point in points))
    known = [("Adhesion", laws), ("Specification", tuned.asked)]
    if design is None:
        return render([*parts, Facts([*known, ("Result", f"infeasible: {tuned.reason}")])])
    known += [
        ("Controller", controller_text(tuned.controller(design))),
        ("Worst phase margin", f"{fixed(design.worst.phase_deg)} deg"),
        ("Worst delay margin", f"{fixed(design.worst.delay_s)} s"),
    ]
    parts.append(Facts(known))
    if judgement is not None:
        return render([*parts, "", *judgement_parts(judgement)])
    verdict = f"worst Ms {ms_up(design.worst.ms)} at {case_title(points[design.worst.ms_member])}"
    alone = next((f". {point.vehicle.mass_alone}" for point in points if point.vehicle.mass_alone), "")
    parts += [_case_table(points, design.margins), f"Verdict: {verdict}; tolerances are not checked{alone}"]
    return render(parts)


def _case_table(points: Sequence[OperatingPoint], margins: Sequence[Margins]) -> RenderableType:
    rows = []
    for p, m in zip(points, margins, strict=True):
        where = f"{p.rail}, {p.speed_kmh:g} km/h, {p.vehicle.mass:g} kg"
        numbers = (fixed(x, 4) for x in (m.gain_increase, m.phase_deg, m.delay_s, m.ms, m.mt))
        rows.append((where, _decrease(m, 4), *numbers))
    return Table(("Case", *MARGIN_HEAD), rows)


def no_lock_section(released: Sequence[Released]) -> Section | None:
    """Section on stops for which it is proved that a brake release prevents a lock; None if `released` is empty."""
    rows = []
    for item in released:
        if item.certified is None:
            continue
        outside = item.certified.outside_kmh
        speeds = "none" if outside is None else f"{outside[0]:.0f} to {outside[1]:.0f}"
        case = (item.stop.law, item.stop.load, str(item.stop.rail), str(item.certified.inside.size))
        rows.append((*case, below(100 * item.certified.share), speeds))
    left_out = dict.fromkeys(item.reason for item in released if item.certified is None)
    if not released:
        return None
    reasons = "".join(f" Not certified: {reason.removeprefix('adhesion: ')}." for reason in left_out)
    if not rows:
        return Section("no-lock", "No lock after a release", (Paragraph(f"No stop is certified.{reasons}"),))
    text = (
        "The table gives the share of the samples (every 0.1 s above the hand-over speed) at which the wheel certainly "
        "does not lock if the brake is released at once. Interval arithmetic proves it for static adhesion laws, a "
        "constant rail condition, vehicle and brake as given, a random force of at most 3 standard deviations and a "
        "caliper disturbance of at most 5 % of its torque. Each row is the longest stop of its noise seeds. The proof "
        f"does not cover a stop without release. Outside the certified region the wheel may or may not lock.{reasons}"
    )
    head = ("Law", "Load", "Rail", "Samples", "Inside, %", "Outside at, km/h")
    alt = "Largest certified torque over slip at several speeds, one panel per rail, with the trajectory of a stop."
    return Section(
        "no-lock",
        "No lock after a release",
        (
            Paragraph(text),
            Table(head, rows, caption="Samples inside the certified region."),
            Picture("no-lock", "Certified no-lock region with the longest stop on each rail.", alt),
        ),
    )
