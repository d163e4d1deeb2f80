"""Sections about linear loops: margins against Pade, designs side by side."""

from __future__ import annotations

import math

from railslip_ctrl.assessment import Assessment
from railslip_ctrl.design import PIController
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design_check import ControllerGroup
from railslip_ctrl.design_report import DesignReport, LoopDesign, LoopDesigns
from railslip_ctrl.report.text import controller_text
from railslip_ctrl.units import KMH

from .blocks import Block, Details, Facts, Items, Paragraph, Picture, Section, Table
from .numbers import MARGIN_HEAD, NONE, above, listed, margin_cells, roots, short, where

SETTLED = 0.02
"""Share of a step within which a response counts as settled."""

_BACK, _BACK_WORD = 0.1, "tenth"  # of the largest deviation


def margins_section(report: DesignReport) -> Section:
    """Every loop's margins, dead time exact, and what Pade approximations would have said."""
    groups, drawn = report.whole_check.groups, report.check.groups
    rows = [
        (group.title if i == 0 else "", where(one.point), *margin_cells(one.margins), one.verdict.value)
        for group in groups
        for i, one in enumerate(group.assessments)
    ]
    loops = sum(len(group.assessments) for group in groups)
    return Section(
        "margins",
        "Margins, exact against Padé",
        (
            *_whose(report),
            Paragraph(
                "The dead time is exact: stability is decided by counting the roots of the quasi-polynomial, and "
                "margins come from all crossovers ([WaltonMarshall1987]). Robust means "
                f"Ms ≤ {ROBUST_MS:g}, the upper end of what is usual for design ([Astrom1998], [Astrom2021] 13): the "
                f"gain may then rise by {short(ROBUST_MS / (ROBUST_MS - 1), 2)} and fall to "
                f"{short(ROBUST_MS / (ROBUST_MS + 1), 2)} of its value, and the phase margin is at least "
                f"{short(math.degrees(2 * math.asin(0.5 / ROBUST_MS)), 2)} deg. Disk margins: [Seiler2020]. Of an "
                "unstable loop there are no margins, and none are printed."
            ),
            Table(
                "Margins of each controller at each operating point. Gain − and gain +: the factors by which the "
                "loop gain may "
                "fall and rise; delay: added dead time that destabilises.",
                ("Controller", "Case", *MARGIN_HEAD, "Verdict"),
                rows,
                wide=True,
            ),
            *_recommended(report),
            _bode(drawn),
            _nichols(drawn),
            _nyquist(drawn),
            _pade_table(groups),
            Paragraph(_pade_finding(groups), strong=True),
            *(_loop_details(group, one) for group in groups for one in group.assessments),
            Paragraph(f"{loops} loops in all; each is opened above with its poles, and is in report.json."),
        ),
    )


def _whose(report: DesignReport) -> tuple[Paragraph, ...]:
    """That Table 4's gains are another vehicle's, in a report about a vehicle that is not the paper's."""
    if report.table5 is not None:
        return ()
    return (
        Paragraph(
            "Table 4's gains were made for the vehicle of [Park2008]: here they are a comparison and no proposal, and "
            "inertia scale 3.6 is that paper's mix of units."
        ),
    )


def _recommended(report: DesignReport) -> tuple[Picture, ...]:
    group = report.recommended
    if group is None:
        return ()
    told = "; ".join(f"{where(a.point)}: {a.verdict_line}" for a in group.assessments)
    return (
        Picture(
            "recommended",
            f"{group.title}: magnitude and continuous phase of the open loop, dead time exact (dots: gain crossovers), "
            f"and its Nyquist curve near −1 with the circle of Ms = {ROBUST_MS:g}.",
            f"Magnitude, phase and Nyquist curve of the open loops of the recommended design. {told}.",
        ),
    )


def _bode(groups: tuple[ControllerGroup, ...]) -> Picture:
    told = "; ".join(
        f"{group.title}, {where(a.point)}: {a.verdict_line}" for group in groups for a in group.assessments
    )
    return Picture(
        "bode",
        "Bode plots of the open loops, the phase continuous and the dead time exact. Dots: gain crossovers.",
        f"Magnitude and phase of the open loops over frequency, one column a controller. {told}.",
    )


def _nyquist(groups: tuple[ControllerGroup, ...]) -> Picture:
    told = "; ".join(
        f"{group.title}, {where(a.point)}: {a.loop.open_loop_unstable_poles} open-loop and {a.unstable_poles:g} "
        "closed-loop "
        "unstable poles"
        for group in groups
        for a in group.assessments
    )
    return Picture(
        "nyquist",
        "Nyquist plots: the whole curve with its radius compressed (top) and the neighbourhood of −1 (bottom). P and "
        "Z: "
        "unstable poles of the open and closed loop, N: turns around −1.",
        f"Nyquist curves of the open loops around the point −1, one column a controller. {told}.",
    )


def _nichols(groups: tuple[ControllerGroup, ...]) -> Picture:
    told = "; ".join(
        f"{group.title}, {where(a.point)}: {a.verdict_line}" for group in groups for a in group.assessments
    )
    return Picture(
        "nichols",
        "Nichols plots: magnitude over continuous phase, the dead time exact. Crosses: the critical point −1; "
        "dash-dotted: Ms = 2.",
        f"Magnitude over phase of the open loops, one column a controller. {told}.",
    )


def _pade_table(groups: tuple[ControllerGroup, ...]) -> Table:
    orders = [row.order for row in groups[0].assessments[0].pade]
    rows = [
        (
            group.title if i == 0 else "",
            where(one.point),
            *(_ms(row.margins) for row in one.pade),
            _ms(one.margins),
        )
        for group in groups
        for i, one in enumerate(group.assessments)
    ]
    head = ("Controller", "Case", *(f"Padé {order}" for order in orders), "exact")
    return Table("Ms with Padé approximations of rising order in place of the dead time, and exact.", head, rows)


def _ms(margins: object) -> str:
    return "unstable" if margins is None else short(margins.ms, 5)  # type: ignore[attr-defined]


def _pade_finding(groups: tuple[ControllerGroup, ...]) -> str:
    found = [one for group in groups for one in group.assessments]
    wrong = sum((row.margins is None) != (one.margins is None) for one in found for row in one.pade)
    errors = [
        (abs(one.pade[0].margins.ms / one.margins.ms - 1), one)
        for one in found
        if one.margins is not None and one.pade[0].margins is not None
    ]
    verdicts = (
        "no order gives a wrong verdict on stability" if wrong == 0 else f"{wrong} verdicts on stability are wrong"
    )
    if not errors:
        return f"Padé against exact: {verdicts}."
    worst, one = max(errors, key=lambda pair: pair[0])
    return (
        f"Padé against exact: {verdicts}; the first order is off by up to {100 * worst:.2g} % in Ms "
        f"({one.label}, {where(one.point)})."
    )


def _loop_details(group: ControllerGroup, one: Assessment) -> Details:
    rows = [
        ("Controller", controller_text(one.controller)),
        ("Operating point", f"slip {one.point.slip:g}, M {one.point.vehicle.mass:g} kg, inertia scale "
         f"{one.point.vehicle.inertia_scale:g}"),
        ("Plant poles", roots(one.plant.poles)),
        ("Closed-loop poles", f"{roots(one.closed_loop_poles)} (rightmost, dead time exact, [Breda2005])"),
    ]  # fmt: skip
    usable = one.stabilizing_gain_range
    rows.append(
        (
            "Stabilising gain",
            "none" if usable is None else f"{short(usable[0])} to {short(usable[1])} times this loop gain",
        )
    )
    if one.margins is not None:
        crossovers = zip(one.margins.gain_crossovers, one.margins.phase_margins_deg, strict=True)
        rows.append(
            ("Gain crossovers", ", ".join(f"{short(w)} rad/s ({short(p, 3)} deg)" for w, p in crossovers) or "none")
        )
        rows.append(("Disk margin", f"{short(one.margins.disk)}, phase ± {short(one.margins.disk_phase_deg)} deg"))
    return Details(f"{group.title}: {where(one.point)}", one.verdict_line, (Facts(tuple(rows)),))


# --- designs --------------------------------------------------------------------------------------------------------


def designs_section(report: DesignReport) -> Section:
    """The designs side by side, what they cost, and what was tried and is of no use."""
    loops = report.loops
    blocks: list[Block] = [Paragraph(_best(report), strong=True), _gain_table(loops), _design_table(loops)]
    if any(one.needs_hold for one in loops.designs):
        blocks.append(
            Paragraph(
                "The layered law stands here as the linear loop that it is within its boundary layer. It acts about a "
                "holding torque that has to be known, so that it is not recommended as a controller by itself; what "
                "becomes of it outside the layer, and with a wrong holding torque, is in the section on sliding mode."
            )
        )
    if loops.refused:
        blocks.append(Items(tuple(f"{name}: none. {reason}." for name, reason in loops.refused.items())))
    if loops.gangs:
        blocks += _pictures(loops)
    blocks += _attempts(loops)
    return Section("designs", "Designs side by side", tuple(blocks))


def _best(report: DesignReport) -> str:
    best, taken = report.loops.best, report.loops.recommended
    if best is None or taken is None:
        return "None of these designs holds every operating point, or is a controller by itself: none is recommended."
    standing = "Recommended" if taken.robust else "None is robust. The least fragile"
    endless = report.endless(taken.name)
    but = f"the train does not stop with it {listed(endless)}" if endless else "the verdict says why"
    standing = "Of the best standing by its margins alone" if endless and taken.robust else standing
    text = f"{standing}: {taken.name}, worst Ms {above(taken.worst_ms)}; {but}."
    if best is taken:
        return text
    return f"{text} The least worst Ms at these points, {above(best.worst_ms)}, has {best.name}: shown to compare."


def _gain_table(loops: LoopDesigns) -> Table:
    rows = []
    for one in loops.designs:
        kp, ki = one.controller.gains.kp, one.controller.gains.ki
        rows.append(
            (
                one.name,
                one.how,
                _lead(one.controller) if one.controller.lead > 0 else NONE,
                short(kp),
                short(ki),
                short(kp * KMH),
                short(ki * KMH),
            )
        )
    head = ("Design", "How", "Lead", "kp, N·m/(m/s)", "ki, N·m/m", "kp, N·m/(km/h)", "ki, N·m/(km/h)/s")
    return Table("The designs: where they come from and their gains.", head, rows, wide=True)


def _lead(controller: PIController) -> str:
    """The lead as a fraction that no narrow column breaks."""
    text = f"({controller.lead:g} s + 1)/\N{WORD JOINER}({controller.lead_filter:g} s + 1)"
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def _design_table(loops: LoopDesigns) -> Table:
    rows = [row for one in loops.designs for row in _design_rows(one)]
    head = ("Design", "Case", *MARGIN_HEAD, "Noise gain, N·m/(m/s)", "Torque rate, N·m/s", "Verdict")
    return Table(
        "Margins and effort. Noise gain: torque per slip-velocity noise; torque rate: largest rate of the acting "
        "torque on a "
        "step of 1 km/h of the reference.",
        head,
        rows,
        wide=True,
    )


def _step_table(loops: LoopDesigns) -> Table:
    rows = []
    for name, step in loops.reference.items():
        load = loops.load[name]
        settled = step.settling_time(step.reference, SETTLED * step.reference)
        back = load.settling_time(0.0, _BACK * load.largest_output)
        rows.append(
            (
                name,
                short(100 * step.overshoot, 3),
                _within(settled, step.time[-1]),
                short(load.largest_output / KMH, 3),
                _within(back, load.time[-1]),
            )
        )
    head = (
        "Design", "Overshoot, %", f"Within {100 * SETTLED:g} % after, s", "Largest slip velocity, km/h",
        f"Back to a {_BACK_WORD} of it after, s",
    )  # fmt: skip
    return Table(
        f"Linear responses, {where(loops.shown_at)}, slip {loops.shown_at.slip:g}: to a step of the reference "
        "(overshoot "
        f"and settling), and to a step of {loops.load_step:g} N·m of torque at the wheel (largest slip and return). An "
        "unstable plant cannot be held without overshoot.",
        head,
        rows,
    )


def _within(time: float, end: float) -> str:
    return f"> {end:g}" if math.isinf(time) else short(time, 3)


def _design_rows(one: LoopDesign) -> list[tuple[str, ...]]:
    rows = []
    for i, (assessment, effort) in enumerate(zip(one.assessments, one.efforts, strict=True)):
        cost = (NONE, NONE) if effort is None else (short(effort.noise_gain, 3), short(effort.reference_rate, 3))
        name = one.name if i == 0 else ""
        rows.append((name, where(assessment.point), *margin_cells(assessment.margins), *cost, assessment.verdict.value))
    return rows


def _pictures(loops: LoopDesigns) -> list[Block]:
    at = f"{where(loops.shown_at)}, slip {loops.shown_at.slip:g}"
    responses = Picture(
        "responses",
        f"Responses to a step of the reference (left) and of a torque at the wheel (right), {at}; dead time exact.",
        f"Slip velocity and commanded torque over time after two steps, for {listed(loops.reference)}.",
    )
    gang = Picture(
        "gang",
        f"The gang of four, {at}: sensitivity, complementary sensitivity, disturbance to slip, noise to torque.",
        f"Four panels of magnitudes over frequency for {listed(loops.gangs)}.",
    )
    shown: list[Block] = [responses, _step_table(loops)] if loops.reference else []
    return [*shown, gang]


def _attempts(loops: LoopDesigns) -> list[Block]:
    rows = [
        (one.name, where(one.point), *margin_cells(one.margins), _reason(one.reason) or "holds its operating point")
        for one in loops.attempts
    ]
    table = Table(
        "A known rule ([Skogestad2003]) and two predictors ([Smith1957], [NormeyRico2009]), each made for one "
        "operating point with its exact model, which flatters them.",
        ("Design", "Case", *MARGIN_HEAD, "What comes of it"),
        rows,
        wide=True,
    )
    failed = sum(one.margins is None for one in loops.attempts)
    told = f"{failed} of {len(rows)} {'does' if failed == 1 else 'do'} not hold"
    return [Details("Known rules and predictors", told, (table,))]


def _reason(text: str) -> str:
    """A reason without the advice for a programmer that follows it."""
    return text.split("; use ")[0]
