"""What was not checked: the section that closes the report."""

from __future__ import annotations

from railslip_ctrl.design_report import DesignReport
from railslip_ctrl.design_report.stops import SPREAD_SEEDS
from railslip_ctrl.reproduction.table5 import DEFAULT_SEEDS
from railslip_ctrl.units import KMH

from .blocks import Items, Section
from .numbers import listed, short


def unchecked_section(report: DesignReport) -> Section:
    """What the report does not answer."""
    return Section("unchecked", "What was not checked", (Items(unchecked(report)),))


def unchecked(report: DesignReport) -> tuple[str, ...]:
    """What the report does not answer, a text each."""
    points = [plant.point for plant in report.plants]
    speeds = listed(f"{speed:g} km/h" for speed in dict.fromkeys(point.speed_kmh for point in points))
    rails = listed(f"{rail} rail" for rail in dict.fromkeys(point.rail for point in points))
    mass = points[0].vehicle.mass
    texts = [
        f"Margins hold at the operating points only: {speeds}, {rails}, M {mass:g} kg, the slips of the table "
        f"above{_over_speed(report)}. Other speeds, loads and slips: --speed, --mass and --slip. Tolerances of "
        "dead time and lag: railslip_ctrl.design.judging.",
        *_laws(report),
        "The speed is frozen in every linear loop. A stop passes through all speeds; the braking runs do, the "
        "margins do not.",
        *_handing_over(report),
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
        f"Braking runs have one noise seed; the spread of the distances is over {len(SPREAD_SEEDS)} of them, and of "
        "the "
        "published run there is none. Statistics over many: railslip campaign.",
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
    return tuple(texts)


def _over_speed(report: DesignReport) -> str:
    """What margins over speed hold at, where there is a design to have them."""
    if report.loops.speeds is None:
        return ""
    return "; those of the recommended design over speed at the slips of its own table"


def _handing_over(report: DesignReport) -> list[str]:
    """What of the hand-over to a held torque was run, and what was not; nothing where none was."""
    ends = [(stop, end) for stop in report.stops for end in stop.slow if end.handed_over]
    if not ends:
        return []
    stop, first = ends[0]
    seeds = len({one.seed for one in first.handed_over})
    loads = ", empty and loaded" if len({one.mass for one in first.handed_over}) > 1 else ""
    torques = listed(f"{short(torque)} N·m" for torque in dict.fromkeys(end.torque for _, end in ends))
    return [
        f"Handing over from slip control to a held torque was run in stops from {stop.scenario.initial_speed / KMH:g} "
        f"km/h ({seeds} noise seeds{loads}) at {first.from_kmh:g} km/h and to {torques} only, each law and rail by "
        f"itself, down to {first.least_kmh:g} km/h. Not run: another speed of hand-over, another torque, and a rail or "
        "a load that is not the one assumed after it."
    ]


def _laws(report: DesignReport) -> list[str]:
    if not any(stop.dynamic for stop in report.stops):
        return []
    return [
        "Margins are for the dynamic bristle model, braking runs for its static curve: only the linear controllers "
        "were run with both, and the nonlinear ones (sliding mode, slide protection) never with the dynamic model. No "
        "bound on the braking distance is given for the dynamic model."
    ]
