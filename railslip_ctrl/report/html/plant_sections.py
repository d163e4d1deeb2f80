"""Sections about what is given: vehicle and units, adhesion, linearisation, limits, stabilising gains."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from railslip_ctrl.design.limits import Limits, StructureLimit
from railslip_ctrl.design_report import DesignReport, GainRegion, LawCurve
from railslip_ctrl.law_sources import words_at
from railslip_ctrl.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.notation import NOTATION
from railslip_ctrl.parameters import doubts
from railslip_ctrl.report.text import law_facts, vehicle_facts

from .blocks import Block, Details, Facts, Group, Items, Paragraph, Picture, Section, Table
from .formulas import formula, matrix, transfer_function
from .numbers import NONE, above, below, listed, roots, short, where
from .typography import signs, typeset


def vehicle_section(report: DesignReport) -> Section:
    """The quarter car, the units, what was assumed."""
    vehicle = report.check.vehicle
    rows = tuple((name, value) for name, value in vehicle_facts(vehicle) if name != "Note")
    blocks: list[Block] = [Facts(rows)]
    if vehicle.notes:
        blocks += [Paragraph("Assumed, because the vehicle's file does not say it:"), Items(tuple(vehicle.notes))]
    else:
        blocks.append(Paragraph("Nothing was assumed: every parameter above was given."))
    if doubtful := doubts(vehicle):
        blocks += [Paragraph("To be checked, as all of this report rests on it:", strong=True), Items(doubtful)]
    blocks.append(
        Paragraph(
            typeset(
                "Numbers are SI unless a unit is written beside them; speeds are in km/h where they say so. The "
                "inertia scale multiplies M, J and B and nothing else: 1 is SI, 3.6 the reading under which the "
                "results printed in [Park2008] come out (speeds integrated in km/h with forces in N). Torque and slip "
                "are positive in braking: σ = v − rω, λ = σ/v, e = λ_d v − σ."
            )
        )
    )
    used = [(formula(one.latex), _unit(one.unit), typeset(one.meaning)) for one in NOTATION.values()]
    symbols = Table("Symbols and their units.", ("Symbol", "Unit", "Meaning"), used)
    blocks.append(Details("Symbols", f"{len(used)}", (symbols,)))
    return Section("vehicle", "Vehicle and units", tuple(blocks))


def adhesion_section(report: DesignReport) -> Section:
    """Curves, peaks, operating points."""
    curves = report.curves
    rows = [
        (
            _curve_name(curve),
            str(curve.rail),
            f"{curve.speed_kmh:g}",
            short(curve.peak.coefficient),
            short(curve.peak.slip) if curve.peak.slip > curve.slip[1] else "0 (falls from the start)",
            ", ".join(f"{point.slip:g}" for point in curve.points) or NONE,
            ", ".join(short(point.adhesion_coefficient) for point in curve.points) or NONE,
        )
        for curve in curves
    ]
    asked = next(curve for curve in curves if curve.asked)
    others = list(dict.fromkeys(curve.law for curve in curves if not curve.asked))
    told = f"The report is about the law {_curve_name(asked)} ({asked.title})."
    beside = f" Drawn beside it: {listed(others)}." if others else ""
    points = "; ".join(
        f"{where(point)}: slip {point.slip:g}, μ {short(point.adhesion_coefficient)}"
        for point in (plant.point for plant in report.plants)
    )
    return Section(
        "adhesion",
        "Adhesion and operating points",
        (
            Paragraph(told + beside + " A wheel held where adhesion falls with slip is unstable by itself."),
            Picture(
                "adhesion",
                "Adhesion coefficient at rest over the slip ratio. Circles: the operating points of this report; "
                "triangles: the peaks.",
                f"Curves of the adhesion coefficient over slip for {listed(dict.fromkeys(c.law for c in curves))}, one "
                f"panel a rail. Operating points: {points}.",
            ),
            Table(
                "Peak of each curve, and the operating points on it.",
                ("Law", "Rail", "Speed, km/h", "Peak μ, -", "at slip, -", "Operating slip, -", "μ there, -"),
                rows,
            ),
            Facts(tuple(law_facts(plant.point for plant in report.plants))),
        ),
    )


def _curve_name(curve: LawCurve) -> str:
    """The law's name, which tells the user's own parameters from the published ones."""
    point = next(iter(curve.points), None)
    return curve.law if point is None else words_at(point)


def linear_section(report: DesignReport) -> Section:
    """Operating points and matrices, rail by rail."""
    rails = dict.fromkeys(plant.point.rail for plant in report.plants)
    groups = tuple(
        Group(
            f"linear-{rail}",
            f"{rail.capitalize()} rail",
            tuple(block for p in report.plants if p.point.rail is rail for block in _plant_blocks(p)),
        )
        for rail in rails
    )
    units = listed(
        f"{_LETTERS.get(name, name)} in {_unit(NOTATION[name].unit)}"
        for name in dict.fromkeys(s for p in report.plants for s in p.states)
    )
    intro = Paragraph(
        "Linearised at constant slip with the speed frozen: input brake torque at the wheel, N·m (the actuator is not "
        f"in it); states {units}; outputs σ, λ and the control error e. Every matrix follows from the one symbolic "
        "statement of the plant, and all of them are in report.json."
    )
    return Section("linearisation", "Linearisation", (intro, *groups))


def _plant_blocks(plant: LinearPlant) -> tuple[Block, ...]:
    point = plant.point
    num, den = plant.transfer_function()
    rows = (
        ("Slip velocity σ", f"{short(point.sigma, 5)} m/s at slip {point.slip:g} and {point.speed_kmh:g} km/h"),
        ("Adhesion force Fa", f"{short(point.adhesion_force, 6)} N (μ = {short(point.adhesion_coefficient, 5)})"),
        ("Brake torque Tb", f"{short(point.brake_torque, 6)} N·m, at which λ′ = 0"),
        ("States; outputs", f"{_letters(plant.states)}; {_letters(plant.outputs)}"),
        ("A, B", _beside(matrix(plant.A), matrix(plant.B))),
        ("C, D", _beside(matrix(plant.C), matrix(plant.D))),
        ("Poles", roots(plant.poles)),
        ("Zeros, torque to σ", roots(plant.zeros)),
        ("σ/torque", transfer_function(num, den, r"\frac{\mathrm{m/s}}{\mathrm{N\cdot m}}")),
    )
    return (Facts(rows),)


def _beside(first: Markup, second: Markup) -> Markup:
    return Markup("{}, {}").format(first, second)


_LETTERS = {"sigma": "σ", "lambda": "λ", "error": "e", "omega": "ω"}


def _letters(names: tuple[str, ...]) -> str:
    return ", ".join(_LETTERS.get(name, name) for name in names)


def _unit(unit: str) -> str:
    """A unit as it is printed; what has none is a ratio."""
    return "-" if unit == "1" else signs(unit)


# --- limits ---------------------------------------------------------------------------------------------------------


def limits_section(report: DesignReport) -> Section:
    """What no controller can beat at each operating point."""
    actuator = report.check.vehicle.actuator
    rows, found = [], [(p.point, limits) for p, limits in zip(report.plants, report.limits, strict=True)]
    for point, limits in found:
        rows.append(
            (
                where(point),
                short(limits.unstable_pole),
                short(limits.doubling_time, 3),
                short(limits.actuator_product, 3),
                below(limits.ms_bound),
                short(limits.bode_integral, 3),
                *_structure_cells(limits.pi),
                *_structure_cells(limits.pi_lead),
                _crossover(limits),
            )
        )
    head = (
        "Case", "Unstable pole p, 1/s", "Doubles in, s", "p (τ + T), -", "Ms, Mt ≥", "∫ ln|S| dω, rad/s",
        "PI: phase ≤, deg", "PI: Ms ≥",
        "PI-lead: phase ≤, deg", "PI-lead: Ms ≥", "Crossover, rad/s",
    )  # fmt: skip
    return Section(
        "limits",
        "Limits: what no controller can beat",
        (
            Paragraph(
                f"The brake answers after a dead time τ = {actuator.dead_time:g} s and a lag T = {actuator.lag:g} s. "
                f"{_race(found)} What S gains at some frequencies it loses at others: the integral of ln|S| over the "
                "frequency is π times the sum of the unstable poles, and 0 where there is none (Bode's integral, "
                "[Astrom2021] 14.2). These are theorems, not results of tuning; only the crossover range is a rule of "
                "thumb (gain crossover frequency inequality, [Astrom2021] 14.3). Bounds are rounded to the side that "
                "claims less. A dash: the theorem does not apply."
            ),
            Table("Limits by operating point; a PI needs p (τ + T) < 1.", head, rows, wide=True),
        ),
    )


def _race(found: Sequence[tuple[OperatingPoint, Limits]]) -> str:
    """Where the wheel runs away meanwhile, and what that costs; where it does not, nothing has to be held."""
    away = [(limits.ms_bound, where(point)) for point, limits in found if limits.unstable_pole > 0]
    if not away:
        return (
            f"At {_points(len(found))} the wheel has no unstable pole: it does not run away meanwhile, and no bound on "
            "Ms or Mt above 1 follows from the plant."
        )
    here = "" if len(away) == len(found) else f" at {len(away)} of the {len(found)} operating points"
    bound, case = max(away)
    if below(bound) == "1":  # as every loop's: without dead time feedback may be as fast as the sensor lets it
        best = (
            "The unstable pole alone puts no bound on Ms or Mt above 1 here, as there is next to no dead time; a PI or "
            "a PI behind a lead has one where the table gives it"
        )
    else:
        best = (
            f"No linear controller gets Ms or Mt below {below(bound)} ({case}; interpolation at the unstable pole, "
            "[Astrom2021] 14.4, [Sarason1967]); a PI or a PI behind a lead gets less far still"
        )
    return (
        f"Meanwhile the wheel runs away{here}. {best}, as its phase margin is at most the plant's largest phase above "
        "−180 deg, and Ms ≥ 1/(2 sin(phase margin/2)) at the gain crossover."
    )


def _structure_cells(limit: StructureLimit | None) -> tuple[str, str]:
    if limit is None:
        return NONE, NONE
    return (above(limit.phase_deg), below(limit.ms_bound)) if limit.feasible else ("none holds", NONE)


def _crossover(limits: Limits) -> str:
    if limits.crossover_range is None:
        return "none"
    low, high = limits.crossover_range
    return f"{short(low, 3)} to {short(high, 3)}" if math.isfinite(high) else f"above {short(low, 3)}"


def _points(count: int) -> str:
    return "the operating point" if count == 1 else f"each of the {count} operating points"


# --- stabilising gains ----------------------------------------------------------------------------------------------


def _at_holding(report: DesignReport) -> str:
    """The range of kp along the line of the holding PI's integral time, which is another one."""
    holding = report.check.holding
    if holding is None:
        return ""
    low, high = holding.gain_range
    return (
        f"; along the line ki = kp/({holding.integral_time:g} s), on which the holding PI was found, "
        f"{_kp_between(low, high)}"
    )


def _kp_between(low: float, high: float) -> str:
    return f"kp above {short(low)}, without bound" if math.isinf(high) else f"kp from {short(low)} to {short(high)}"


def _drawn_up_to(region: GainRegion) -> str:
    """Where the picture of a region that goes on without bound ends."""
    kp = [strip.kp[-1] for strip in region.strips if strip.kp_cut]
    ki = [strip.ki_high.max() for strip in region.strips if strip.ki_cut]
    ends = [f"kp up to {short(max(kp), 3)} N·m/(m/s)"] if kp else []
    ends += [f"ki up to {short(max(ki), 3)} N·m/m"] if ki else []
    return f"The region goes on without bound; drawn is {listed(ends)}." if ends else ""


def region_section(report: DesignReport) -> Section:
    """The stabilising region, or why there is none."""
    region = report.region
    marks = [
        f"{name}: kp {short(kp)} N·m/(m/s), ki {short(ki)} N·m/m"
        + ("" if region.near((kp, ki)) or region.grid is None else ", outside the picture")
        for name, (kp, ki) in region.chosen.items()
    ]
    if region.kp_range is None:
        text = f"No plain PI to draw a region of. Reason: {region.reason}."
        return Section("region", "Stabilising gains", (Paragraph(text, strong=True), Items(tuple(marks))))
    between = f"{_kp_between(*region.kp_range)}"
    if region.grid is None:
        text = f"A plain PI stabilises {_points(len(report.plants))} with {between}, in N·m/(m/s). Not drawn"
        return Section("region", "Stabilising gains", (Paragraph(f"{text}: {region.reason}."), Items(tuple(marks))))
    ends = _drawn_up_to(region)
    without_ki_bound = all(strip.ki_cut for strip in region.strips)
    return Section(
        "region",
        "Stabilising gains",
        (
            Paragraph(
                f"All plain PI that stabilise {_points(len(report.plants))}: over all ki, {between}, in N·m/(m/s), and "
                f"{'every ki' if without_ki_bound else 'ki up to the outline'}{_at_holding(report)}. The outline is "
                "exact: "
                "D-decomposition ([Gryazina2008], "
                "[Silva2005]) and root count ([WaltonMarshall1987]), the dead time not approximated. Inside "
                "it the worst Ms, phase margin and delay margin over the operating points."
            ),
            Picture(
                "region",
                "The stabilising region of a PI with contours of the worst Ms (left), phase margin (middle) and delay "
                "margin (right)." + (f" {ends}" if ends else ""),
                f"Grey region in the plane of kp and ki, {between}, in N·m/(m/s), with contours. {ends} Marked: "
                f"{'; '.join(marks)}.",
            ),
            Items(tuple(marks)),
        ),
    )
