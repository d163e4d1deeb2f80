"""Sections that close the report: errata of the paper, what was not checked, sources."""

from __future__ import annotations

from railslip_ctrl.design_report import DesignReport
from railslip_ctrl.reproduction.table5 import DEFAULT_SEEDS

from .blocks import Block, Details, Facts, Items, Paragraph, Section
from .numbers import listed


def errata_section(report: DesignReport) -> Section:
    """Where the paper's print does not follow from its own statement."""
    wrong = [one for one in report.errata if not one.agrees]
    right = [one for one in report.errata if one.agrees]
    blocks: list[Block] = [
        Paragraph(
            f"{len(report.errata)} equations, numbers and claims of [Park2008] were derived or computed again: "
            f"{len(right)} "
            f"agree, {len(wrong)} do not.",
            strong=True,
        )
    ]
    for one in wrong:
        rows = (
            ("Printed", one.printed),
            ("Follows", one.derived),
            ("Size", one.sign_and_size),
            ("Decided", one.how),
        )
        blocks.append(Details(one.where, "differs", (Facts(rows), Paragraph(one.explanation))))
    blocks.append(Paragraph(f"Found to agree: {listed(one.where for one in right)}."))
    return Section("errata", "Errata found", tuple(blocks))


def unchecked_section(report: DesignReport) -> Section:
    """What the report does not answer."""
    points = [plant.point for plant in report.plants]
    speeds = listed(f"{speed:g} km/h" for speed in dict.fromkeys(point.speed_kmh for point in points))
    rails = listed(f"{rail} rail" for rail in dict.fromkeys(point.rail for point in points))
    mass = points[0].vehicle.mass
    texts = [
        f"Margins hold at the operating points only: {speeds}, {rails}, M {mass:g} kg, the slips of the table above. "
        "Other "
        "speeds, loads and slips: --speed, --mass and --slip. Tolerances of dead time and lag: "
        "railslip_ctrl.design.robustness.",
        "The speed is frozen in every linear loop. A stop passes through all speeds; the braking runs do, the "
        "margins do not.",
        "One quarter car: no pitching of body or bogie, no other wheelset, no running gear that twists or rolls.",
        "Adhesion is the law's, with its parameters: no measurement of this rail or this wheel is in it unless the "
        "law was "
        "fitted to one (railslip identify).",
        "Loops are in continuous time. Sampling, quantised and noisy speed sensors are in "
        "railslip_ctrl.design.sampled and in "
        "scenarios of railslip simulate, not here.",
        "The brake is a dead time and a lag. Valves that saturate in rate, and brake cylinders that fill and empty "
        "differently, "
        "are in scenarios of railslip simulate, not here.",
        "Each braking run has one noise seed; statistics over many: railslip campaign.",
    ]
    if report.table5 is not None:
        texts.append(
            f"The paper's numbers are means of {report.table5.seeds} seeds here; railslip reproduce takes "
            f"{DEFAULT_SEEDS}. Table "
            "3's errors are against rig data that were never printed, and cannot be computed again."
        )
    else:
        texts.append("The published gains were made for another vehicle; here they are only a comparison.")
    for name, reason in {**report.loops.refused, **report.sliding.reasons}.items():
        texts.append(f"Not available for this vehicle: {name} ({reason}).")
    return Section("unchecked", "What was not checked", (Items(tuple(texts)),))
