"""Which part of the published sliding-mode law controls the slip: feed-forward, gain or switching?

The law is (45) of [Park2008] with the gains of Table 4 (ASMC, bristle column) in their inferred units. Its equivalent
control is the adhesion torque as feed-forward plus a proportional gain (J/r) rho on the slip error e. D and K are the
gains of the robust part. The script compares K with the smallest K that meets the reaching condition (40) under the
published disturbances, at the reference and over the whole run, in SI and as published (M, J and B times 3.6).

    python designs/asmc_published.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import railslip_ctrl as rs
from railslip_ctrl import plots, reaching

KMH = 1 / 3.6  # m/s
SPEED = 100.0 * KMH  # m/s
SLIP = 0.132  # dry reference, bristle column
START = SLIP * SPEED  # m/s: sliding variable s of a rolling wheel when the brake is applied


@dataclass(frozen=True)
class Reading:
    """Numbers of the law in one interpretation ("reading") of the printed units.

    - feed_forward: torque that holds the reference slip, N m
    - proportional_gain: gain (J/r) rho + D on e, N m/(m/s); `from_surface` is its part (J/r) rho
    - integral_gain: D rho, N m/m
    - pi_gain: Kp of the PI in Table 4, N m/(m/s)
    - K: gain of the switching term, N m
    - least_K, least_K_run: smallest K that meets (40) at the reference slip and 100 km/h, and over the whole run, N m,
      each for disturbances of 1 and 3 standard deviations
    - reaching_time: time from a rolling wheel to s = 0 without disturbances, s
    """

    inertia_scale: float
    feed_forward: float
    proportional_gain: float
    from_surface: float
    integral_gain: float
    pi_gain: float
    K: float
    least_K: tuple[float, float]
    least_K_run: tuple[float, float]
    reaching_time: float


def read(inertia_scale: float) -> Reading:
    """Analyse one reading of the units."""
    vehicle = rs.PARK2008.model_copy(update={"inertia_scale": inertia_scale})
    law = rs.law.PUBLISHED_LAW
    # 1. The gains on e and on its integral, from Tb = Ueq + D s + K sgn s with s = e + rho int e.
    surface = vehicle.effective_inertia / vehicle.wheel.radius * law.rho
    dry = rs.published_law("bristle", rs.Rail.DRY)
    held = rs.operating_point(dry, vehicle, SPEED, reaching.reference_slip(), rail=rs.Rail.DRY)
    # 2. The smallest K that meets (40).
    least = [
        tuple(reaching.least_gain(vehicle, box(vehicle, sigmas=n)) for n in (1.0, 3.0))
        for box in (reaching.reference_set, reaching.operating_set)
    ]
    return Reading(
        inertia_scale=inertia_scale,
        feed_forward=held.brake_torque,
        proportional_gain=surface + law.D,
        from_surface=surface,
        integral_gain=law.D * law.rho,
        pi_gain=rs.TABLE4_PI["bristle"].kp,
        K=law.K,
        least_K=(least[0][0], least[0][1]),
        least_K_run=(least[1][0], least[1][1]),
        reaching_time=reaching.reaching_time(vehicle, K=law.K, D=law.D, start=START),
    )


def run() -> tuple[Reading, Reading]:
    """Analyse both readings: SI and as published."""
    return read(1.0), read(rs.AS_PUBLISHED_INERTIA_SCALE)


def main() -> None:
    """Print both readings; with a folder, draw K beside the smallest K that meets (40)."""
    readings = run()
    for reading in readings:
        print(f"Inertia scale {reading.inertia_scale:g}")
        print(f"  feed-forward at 100 km/h, dry      {reading.feed_forward:9.1f} N m")
        print(
            f"  gain on e: (J/r) rho + D           {reading.proportional_gain:9.1f} N m/(m/s), with (J/r) rho = "
            f"{reading.from_surface:.1f}; Kp of the PI in Table 4: {reading.pi_gain:.0f}"
        )
        print(f"  gain on the integral of e: D rho   {reading.integral_gain:9.1f} N m/m")
        print(f"  K                                  {reading.K:9.1f} N m")
        for name, least in (("at e = 0", reading.least_K), ("whole run", reading.least_K_run)):
            print(f"  least K, {name:9}, 1 and 3 sigma  {least[0]:9.1f} and {least[1]:.1f} N m")
        print(f"  time from a rolling wheel to s = 0 {reading.reaching_time:9.1f} s, undisturbed")
    print("The law acts as a feed-forward of adhesion with a proportional gain; K is far too small for sliding.")
    if len(sys.argv) > 1:
        draw(readings, Path(sys.argv[1]))


def draw(readings: tuple[Reading, Reading], folder: Path) -> None:
    """Draw K of Table 4 beside the smallest K that meets (40), and the gains on the slip velocity error."""

    figure = plots.style.new_figure(
        3.0, "ASMC of [Park2008] Table 4, bristle column: the gain K, and the gains on the slip velocity error"
    )
    switching, gains = plots.style.panels(figure, 1, 2)[0]
    asked = ("at the reference, 1 σ", "at the reference, 3 σ", "whole run, 1 σ", "whole run, 3 σ")
    for i, reading in enumerate(readings):
        bars = (reading.K, *reading.least_K, *reading.least_K_run)
        work = (reading.from_surface, reading.proportional_gain - reading.from_surface, reading.pi_gain)
        style = {"color": plots.style.line_style(i)["color"], "edgecolor": "white", "hatch": ("", "///")[i]}
        for axes, values in ((switching, bars), (gains, work)):
            places = [j - 0.2 + 0.4 * i for j in range(len(values))]
            drawn = axes.barh(places, values, height=0.4, label=f"inertia scale {reading.inertia_scale:g}", **style)
            axes.bar_label(drawn, [f"{value:.4g}" for value in values], padding=3, fontsize=plots.style.SMALL)
    switching.set_xlabel("gain of the switching term (N·m)")
    switching.set_yticks(range(5), ("K, Table 4", *(f"least by (40)\n{name}" for name in asked)))
    gains.set_xlabel("gain on the slip velocity error (N·m/(m/s))")
    gains.set_yticks(range(3), ("(J/r) ρ of the ASMC", "D of the ASMC", "Kp of the PI"))
    switching.set_title("K, and the least K by (40)", fontsize=plots.style.TEXT)
    gains.set_title("Gains on the slip velocity error", fontsize=plots.style.TEXT)
    for axes in (switching, gains):
        axes.margins(x=0.25)  # space for the printed numbers, because the bar of D is too short to see
        axes.grid(visible=False, axis="y")
        axes.invert_yaxis()
    plots.style.legend_of_figure(figure, gains, columns=2)
    folder.mkdir(parents=True, exist_ok=True)
    plots.save_figure(figure, folder / "asmc_published.png")


if __name__ == "__main__":
    main()
