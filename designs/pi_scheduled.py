"""Does one gain set suffice, or must the gains follow speed and rail?

A PI-lead is tuned at each speed and rail for the largest ki with Ms <= 1.8. This schedule is compared with the single
gain set that has the smallest worst Ms over the same range. The script also finds the lowest speed at which some gains
stabilise the loop.

    python designs/pi_scheduled.py [FOLDER for the schedule and the picture]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import railslip_ctrl as rs
from railslip_ctrl import plots

SPEEDS_KMH = (20.0, 40.0, 70.0, 100.0)
MS_MAX = 1.8
LEAD, LEAD_FILTER = 0.6, 0.06  # s
SINGLE = rs.PIController(rs.PIGains(kp=229.4, ki=5.0), LEAD, LEAD_FILTER)  # result of designs/pi_lead.py
ENVELOPE = rs.Envelope(speeds=SPEEDS_KMH, slip=(0.75, 0.9, 1.0, 1.1), laws="bristle")


@dataclass(frozen=True)
class ScheduledDesign:
    """The schedule, the verdict on the single gain set, and the lowest speeds with a stable loop."""

    schedule: rs.schedule.GainSchedule
    single: rs.Judgement
    single_suffices: bool
    lowest_pi: float  # km/h, any PI, dry rail, law `curve`
    lowest_lead: float  # km/h, any PI with the lead
    lowest_single: float  # km/h, this gain set


def run() -> ScheduledDesign:
    """Tune, check, and find the lowest speed on the curve law, whose pole grows as 1/v."""
    schedule = rs.schedule.schedule_gains(SPEEDS_KMH, ms_max=MS_MAX, lead=LEAD, lead_filter=LEAD_FILTER)
    single = rs.judge(ENVELOPE, SINGLE)
    actuator = rs.PARK2008.actuator

    def dry_curve(speed_kmh: float):  # type: ignore[no-untyped-def]
        return rs.plant_at("curve", rs.PARK2008, rs.Rail.DRY, speed_kmh)

    return ScheduledDesign(
        schedule=schedule,
        single=single,
        single_suffices=bool(single.ms.max() <= MS_MAX),
        lowest_pi=rs.schedule.lowest_stabilisable_speed(dry_curve, actuator),
        lowest_lead=rs.schedule.lowest_stabilisable_speed(dry_curve, actuator, lead=LEAD, lead_filter=LEAD_FILTER),
        lowest_single=rs.schedule.lowest_held_speed(dry_curve, SINGLE, actuator),
    )


def main() -> None:
    """Print the schedule and the verdicts; with a folder, write the schedule and draw the margins."""
    result = run()
    print("rail  speed   kp N*m/(m/s)   ki N*m/m   worst Ms")
    for e in result.schedule.entries:
        print(f"{e.rail:4s}  {e.speed_kmh:5.0f}   {e.gains.kp:12.1f}   {e.gains.ki:8.1f}   {e.worst_ms:8.3f}")
    word = "suffices" if result.single_suffices else "does not suffice"
    print(f"\nOne gain set (kp 229.4, ki 5) {word} for Ms <= {MS_MAX}: worst Ms {result.single.ms.max():.4g}.")
    print("With the schedule the same Ms allows many times the ki.")
    print(f"Dry, static curve: a PI can stabilise the loop down to {result.lowest_pi:.3g} km/h, a PI with lead to")
    print(f"{result.lowest_lead:.3g} km/h, this gain set to {result.lowest_single:.3g} km/h; below, hand over.")
    print(f"The schedule itself: worst Ms {result.schedule.worst_ms:.4g} between its entries, stable down to", end=" ")
    print(f"{result.schedule.lowest_speed_kmh:.3g} km/h on the bristle model.")
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "pi_scheduled.json").write_text(result.schedule.to_json() + "\n", encoding="utf-8")
        draw(result, folder)


def draw(result: ScheduledDesign, folder: Path) -> None:
    """Draw the margins of the schedule and of the single gain set over speed, dry and wet."""

    speeds = [SPEEDS_KMH[0] + (SPEEDS_KMH[-1] - SPEEDS_KMH[0]) * i / 40 for i in range(41)]
    sweeps = [
        rs.schedule.sweep_speed(
            {"scheduled": lambda v, rail=rail: result.schedule.controller(v / 3.6, rail), "one gain set": SINGLE},
            speeds,
            rail=rail,
        )
        for rail in rs.Rail
    ]
    points = ", ".join(f"{speed:g}" for speed in SPEEDS_KMH)
    title = f"PI-lead, scheduled for the largest ki with Ms ≤ {MS_MAX:g} at {points} km/h, and one gain set"
    figure = plots.sweep_figure(sweeps, title=title)
    plots.save_figure(figure, folder / "pi_scheduled_margins.png")


if __name__ == "__main__":
    main()
