"""Which margins and stops does a slip controller reach that knows neither rail nor mass nor adhesion curve?

The vehicle is the published one, in SI. The gains follow from wheel and brake by rules. The loop is judged with every
tolerance at the slip that the controller finds, and the stops are compared with the bound. The theory page "A
controller that seeks the peak" has the equations of the controller.

    python designs/seeking.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import railslip_ctrl as rs
from railslip_ctrl import bound, plots

VEHICLE = rs.PARK2008
ENVELOPE = rs.Envelope(VEHICLE, speeds=(20, 60, 100))  # above the hand-over speed, 14 km/h
LAWS, RAILS = ("curve", "bristle", "beam"), ("dry", "wet")
SEED = 0


@dataclass(frozen=True)
class Row:
    """Stop of the seeking controller from 100 to 5 km/h, empty: `distance`, m, and highest slip.

    `bound` is a lower bound on the distance of any controller with this brake. `attainable` is the distance of a
    controller that knows the rail, without noise.
    """

    law: str
    rail: str
    bound: float
    attainable: float
    distance: float
    max_slip: float


@dataclass(frozen=True)
class Design:
    """The controller, its judgement over the envelope, the certificate of its worst operating point, its stops."""

    control: rs.Seeking
    judgement: rs.Judgement
    certified_ms: tuple[float, float]
    rows: tuple[Row, ...]


def run() -> Design:
    """Compute gains, verdict, certificate and stops from the vehicle."""
    # 1. The gains: kappa 0.27/theta, k 0.3/theta, K 0.23 N r/(theta + T), observer 0.34 theta, deceleration 0.52 theta.
    control = rs.Seeking.for_vehicle(VEHICLE)
    # 2. The exact loop at every operating point; the delays of brake and model differ by the tolerance.
    judgement = rs.judge(ENVELOPE, control)
    # 3. Certified bounds of Ms at the worst point, by ball arithmetic.
    certificate = judgement.worst.loop.certificate()
    # 4. Stops on unknown rails, compared with the bound and with the attainable stop.
    rows = tuple(braked(control, law, rail) for law in LAWS for rail in RAILS)
    return Design(control, judgement, certificate.ms, rows)


def braked(control: rs.Seeking, law: str, rail: str) -> Row:
    """Simulate one stop, and compare it with the bound and the attainable stop."""
    scenario = rs.stop(VEHICLE, rail, adhesion=law)
    limited = scenario.with_changes(limits=rs.BrakeLimits(torque_max=control.torque_max))
    stopped = rs.simulate(limited, control, seed=SEED)
    least, attainable = bound.clairvoyant_stop(limited), bound.attainable_stop(limited)
    distances = least.braking_distance, attainable.braking_distance, stopped.braking_distance
    return Row(law, rail, *distances, stopped.max_slip)


def main() -> None:
    """Print gains, verdict and stops; with a folder, draw the worst Ms over speed and load."""
    design = run()
    control = design.control
    print(
        f"Dead time {control.dead_time:g} s, lag {control.lag:g} s, J {control.wheel_inertia:g} kg m^2, "
        f"r {VEHICLE.wheel.radius:g} m:\n  {control.described()}"
    )
    print(design.judgement)
    print(f"Worst operating point, certified: Ms in [{design.certified_ms[0]:.10f}, {design.certified_ms[1]:.10f}]")
    print("law      rail   bound   attainable   seeking    excess   highest slip")
    for row in design.rows:
        over = 100 * (row.distance / row.attainable - 1)
        print(
            f"{row.law:8} {row.rail:4} {row.bound:7.1f} {row.attainable:12.1f} {row.distance:9.1f} {over:8.1f} %"
            f" {row.max_slip:12.2f}"
        )
    if len(sys.argv) > 1:
        draw(design, Path(sys.argv[1]))


def draw(design: Design, folder: Path) -> None:
    """Draw the worst Ms over speed and load."""
    folder.mkdir(parents=True, exist_ok=True)
    plots.save_figure(design.judgement.map.plot(), folder / "seeking_map.png")


if __name__ == "__main__":
    main()
