"""How much robustness does a lead that cancels the brake's lag give, and how much noise does it add?

The pneumatic lag of 0.6 s makes a PI without lead fragile. A lead (0.6 s + 1)/(0.06 s + 1) cancels most of the lag and
raises the gain at high frequency tenfold. One gain set then has Ms below 1.5 at twelve operating points. A smaller time
constant of the filter gives more robustness and more noise of the torque.

    python designs/pi_lead.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import railslip_ctrl as rs
from railslip_ctrl import PARK2008, PIController, PIGains, Rail, assessment, plots, sampled, schedule, tuning

ACTUATOR = PARK2008.actuator
KI_MIN = 5.0  # N*m/m
DELAY_SHARE = 0.05  # share of the delay margin that the zero-order hold uses
FILTERS = (0.02, 0.06, 0.12, 0.2, 0.3)  # s


@dataclass(frozen=True)
class LeadDesign:
    """Results: optimum, optima with other filters, sampled loop, sweeps over speed and slip."""

    design: tuning.PIDesign
    controller: PIController
    by_filter: dict[float, tuning.PIDesign]
    period: float  # s; the delay of the hold, half a period, is `DELAY_SHARE` of the delay margin
    sampled_ms: float  # at the worst point
    speed_sweep: schedule.MarginSweep
    slip_sweep: schedule.MarginSweep


def tune(lead_filter: float) -> tuning.PIDesign:
    """Return the PI-lead with the smallest worst Ms over the twelve points."""
    plants = [
        rs.actuated_plant(rs.plant_at("bristle", PARK2008.model_copy(update={"mass": mass}), rail, speed), ACTUATOR)
        for rail in Rail
        for speed in (20.0, 60.0, 100.0)
        for mass in (3517.0, 5276.0)
    ]
    lead = PIController(PIGains(kp=1.0, ki=0.0), ACTUATOR.lag, lead_filter).transfer_function
    return rs.tune_pi(plants, ACTUATOR.dead_time, minimise_ms=True, ki_min=KI_MIN, compensator=lead)


def run() -> LeadDesign:
    """Compute the optimum, the optima with other filters, the sampled loop and the sweeps."""
    by_filter = {lead_filter: tune(lead_filter) for lead_filter in FILTERS}
    design = by_filter[0.06]
    controller = PIController(PIGains(kp=design.kp, ki=design.ki), ACTUATOR.lag, 0.06)
    worst = rs.plant_at("bristle", PARK2008, Rail.DRY, 100.0)
    period = 2 * DELAY_SHARE * design.margins[design.worst.delay_member].delay_s
    controllers = {"PI-lead": controller, "PI (190, 5)": PIController(PIGains(kp=190.0, ki=5.0))}
    return LeadDesign(
        design=design,
        controller=controller,
        by_filter=by_filter,
        period=period,
        sampled_ms=sampled.sampled_loop(worst, rs.SampledController(controller, period), ACTUATOR).margins().ms,
        speed_sweep=schedule.sweep_speed(controllers, [5.0 + 5 * i for i in range(28)]),
        slip_sweep=schedule.sweep_slip(controllers, [0.004 * i for i in range(5, 101)]),
    )


def main() -> None:
    """Print the design; with a folder, draw margins against speed and slip."""
    result = run()
    print(
        f"PI-lead: kp {result.design.kp:.4g} N*m/(m/s), ki {result.design.ki:g}: worst Ms {result.design.worst.ms:.5g}"
    )
    for lead_filter, design in result.by_filter.items():
        gain = design.kp * ACTUATOR.lag / lead_filter
        print(f"  filter {lead_filter:5.2f} s: worst Ms {design.worst.ms:.4g}, noise gain {gain:.4g} N*m/(m/s)")
    print(f"sampled every {1000 * result.period:.0f} ms: Ms {result.sampled_ms:.4g} at dry, 100 km/h, empty")
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def draw(result: LeadDesign, folder: Path) -> None:
    """Draw the margins over speed and over slip, and the loops at the twelve points."""

    folder.mkdir(parents=True, exist_ok=True)
    figure = plots.sweep_figure(
        [result.speed_sweep, result.slip_sweep], title="PI-lead and PI: margins over speed and slip"
    )
    plots.save_figure(figure, folder / "pi_lead_sweeps.png")
    draw_family(result, folder)


def draw_family(result: LeadDesign, folder: Path) -> None:
    """Draw the Bode, Nyquist and Nichols diagrams of the twelve operating points, empty beside loaded."""

    groups = []
    for mass in (3517.0, 5276.0):
        vehicle = PARK2008.model_copy(update={"mass": mass})
        plants = [rs.plant_at("bristle", vehicle, rail, speed) for rail in Rail for speed in (20.0, 60.0, 100.0)]
        assessments = tuple(rs.assess(plant, result.controller, ACTUATOR) for plant in plants)
        groups.append(assessment.controller_group(f"PI-lead, {mass:g} kg", assessments))
    for name, draw_one in (
        ("bode", plots.bode_figure),
        ("nyquist", plots.nyquist_figure),
        ("nichols", plots.nichols_figure),
    ):
        plots.save_figure(draw_one(tuple(groups)), folder / f"pi_lead_family_{name}.png")


if __name__ == "__main__":
    main()
