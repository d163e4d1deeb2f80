"""Does the predictive sliding-mode law slide with a real brake, and what is proved about it?

The vehicle is the published one, in SI; on dry rail its reference slip is beyond the peak. Rules give the gains. The
loop inside the boundary layer is analysed exactly. The script decides whether the stability conditions hold without
noise, for slips near the reference and speeds from 60 km/h up. The theory page "Sliding-mode laws" derives the law.

On dry rail, noise locks the wheel at the end of the stop, at speeds that the proof and the no-lock region do not cover.

    python designs/predictive_sliding.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import railslip_ctrl as rs
from railslip_ctrl import no_lock, plots, predictive

VEHICLE, LAW, RAILS = rs.PARK2008, "curve", ("dry", "wet")
KMH = 1 / 3.6  # m/s
SPEEDS_KMH = np.array([100.0, 80.0, 60.0, 40.0, 25.0])  # speeds of the no-lock region
SLIPS = np.linspace(0.0, 0.36, 13)
SEED = 0


@dataclass(frozen=True)
class Stop:
    """A stop from 100 to 5 km/h without and with noise, the no-lock region, and the noisy samples in this region."""

    rail: str
    runs: tuple[rs.Run, rs.Run]
    region: Any
    released: Any


@dataclass(frozen=True)
class Design:
    """Law with its gains, verdict on the loop in the boundary layer, stability conditions, and stops."""

    control: rs.Predictive
    judgement: rs.Judgement
    proof: Any
    stops: tuple[Stop, ...]


def run() -> Design:
    """Compute gains, verdict, conditions and stops from the vehicle."""
    # 1. The gains: kappa 0.27/theta, k 0.3/theta, K 0.23 N r/(theta + T), phi 0.75 theta K, observer 0.34 theta.
    control = rs.Predictive.for_vehicle(VEHICLE)
    # 2. The exact loop inside the boundary layer, at every operating point, with the tolerances of the brake.
    judgement = rs.judge(rs.Envelope(VEHICLE, laws=LAW), control)
    # 3. The conditions of the sliding mode, over a box of speed, slip and load, by interval arithmetic.
    proof = predictive.verify_predictive(VEHICLE, predictive.RailAdhesion(LAW))
    # 4. Stops, and the torques from which a released wheel is proved not to lock.
    return Design(control, judgement, proof, tuple(braked(control, rail) for rail in RAILS))


def braked(control: rs.Predictive, rail: str) -> Stop:
    """Simulate one stop without and with noise."""
    scenario = rs.stop(VEHICLE, rail, adhesion=LAW)
    quiet = scenario.with_changes(disturbances=rs.Disturbances())
    runs = (rs.simulate(quiet, control, seed=None), rs.simulate(scenario, control, seed=SEED))
    law = scenario.law(scenario.rail)
    region = no_lock.no_lock(law, VEHICLE, SPEEDS_KMH, SLIPS, torque_max=control.torque_max)
    return Stop(rail, runs, region, no_lock.released_run(runs[1], above=control.hand_over_speed))


def surface(seen: rs.Run, control: rs.Predictive) -> np.ndarray:
    """Return S over a run, N*m, from the controller's state; NaN after the reference begins to fade."""
    x, held = seen.controller_signals, seen.signals.speed >= control.fade_speed
    error = np.where(held, seen.signals.reference, np.nan) * x["speed_ahead"] - x["sigma_ahead"]
    return x["holding_torque"] + control.wheel_inertia / control.radius * control.kappa * error - x["torque_ahead"]


def main() -> None:
    """Print the design and its stops; with a folder, draw the surface and the certified region."""
    design = run()
    print(f"Gains by rule: {design.control.described()}\n{design.judgement}\n")
    for one in design.proof.conditions:
        print(f"{one.name:36s} {one.how or 'not decided'}")
    print("\nlargest tolerance, the others as in the box   |S| falls to, N*m   condition not proved beyond")
    for one in design.proof.tolerances:
        value = f"{100 * one.value:.3g} %" if one.unit == "%" else f"{one.value:.3g} {one.unit}"
        limit = one.limited_by or "not limited in the range tried"
        print(f"{one.name.replace('_', ' '):16s} {value:28s} {one.tube:19.4g}   {limit}")
    print("\nrail   without noise   noise     highest slip   released, certain not to lock   not certain at")
    for stop in design.stops:
        (quiet, seen), (slow, fast) = stop.runs, stop.released.outside_kmh
        stopped = f"{stop.rail:4} {quiet.braking_distance:13.1f} m {seen.braking_distance:7.1f} m {seen.max_slip:14.2f}"
        print(f"{stopped} {100 * stop.released.share:19.1f} % of samples   {slow:.0f} to {fast:.0f} km/h")
    if len(sys.argv) > 1:
        draw(design, Path(sys.argv[1]))


def draw(design: Design, folder: Path) -> None:
    """Draw S and the slip over time, and the no-lock region with the runs."""
    folder.mkdir(parents=True, exist_ok=True)
    figure = plots.style.new_figure(4.4, "Predictive sliding-mode law on its reference slip")
    axes, layer = plots.style.panels(figure, 2, 2, sharex="col", sharey="row"), design.control.layer / 1e3
    for stop, (top, low) in zip(design.stops, axes.T, strict=True):
        proved = next(one.value for one in design.proof.tolerances if one.name == "lowest_speed") * KMH
        for i, (seen, name) in enumerate(zip(stop.runs, ("without noise", f"seed {SEED}"), strict=True)):
            look = {"label": name, "linewidth": 1.6 - i, **plots.style.line_style(i), "linestyle": "-"}
            top.plot(seen.signals.time, surface(seen, design.control) / 1e3, **look)
            low.plot(seen.signals.time, seen.signals.slip, **look)
        top.axhspan(-layer, layer, color="0.85", label="boundary layer")
        low.plot(seen.signals.time, seen.signals.reference, color="black", linestyle=":")
        for ax, label in ((top, "surface S (kN·m)"), (low, "slip ratio λ (-)")):
            at, look = seen.signals.time[np.argmax(seen.signals.speed < proved)], {"color": "black", "linestyle": "--"}
            ax.axvline(at, label="below the lowest speed of the proof", **look)
            ax.set(ylabel=label, xlabel="time (s)")
            ax.label_outer()
        top.set_title(f"{stop.rail} rail", fontsize=plots.style.TEXT)
    plots.style.legend_of_figure(figure, axes[0, 0], columns=3)
    plots.save_figure(figure, folder / "predictive_sliding_surface.png")
    shown = {f"{stop.rail} rail, {LAW}, seed {SEED}": (stop.region, stop.released) for stop in design.stops}
    figure = plots.no_lock_figure(shown, title="Predictive sliding-mode law: certified no-lock region")
    plots.save_figure(figure, folder / "predictive_sliding_region.png")


if __name__ == "__main__":
    main()
