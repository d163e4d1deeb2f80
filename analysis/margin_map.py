"""Where in the operating range does a controller hold, and with what margin?

Rail, speed 5 to 140 km/h, mass empty and loaded, slip from half to one and a half times the reference (through the
adhesion peak), actuator dead time and lag +-30 %, three adhesion laws: several thousand loops per controller, each with
its dead time exact. Printed as a table by axis with the worst case, drawn as maps over speed and slip.

    python analysis/margin_map.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from railslip_ctrl.design import PIController
from railslip_ctrl.design.robustness import OperatingRange, Robustness, range_cases, robustness_of
from railslip_ctrl.parameters import PIGains

CONTROLLERS = {
    "PI 211/5": PIController(PIGains(kp=210.6, ki=5.0)),  # designs/pi_robust.py
    "PI-lead 229/5": PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06),  # designs/pi_lead.py
}


@dataclass(frozen=True)
class MarginMaps:
    """Each controller over the same cases."""

    results: dict[str, Robustness]


def run(operating_range: OperatingRange | None = None) -> MarginMaps:
    """Both controllers over the range (the whole one if none is given)."""
    cases, skipped = range_cases(operating_range or OperatingRange())
    return MarginMaps({name: robustness_of(c, cases, skipped) for name, c in CONTROLLERS.items()})


def main() -> None:
    """Print the tables; with a folder, draw the maps."""
    result = run()
    for name, robust in result.results.items():
        print(f"\n{name}: {len(robust.cases)} cases, {100 * robust.stable_share:.2f} % stable")
        print("  worst case: " + ", ".join(f"{axis} {_text(value)}" for axis, value in robust.worst.axes.items()))
        for axis, values in robust.by_axis().items():
            cells = (f"{_text(v)}: {100 * share:.0f} % / {ms:.3g}" for v, (share, ms) in values.items())
            print(f"  {axis} (stable / worst Ms of the stable): " + ",  ".join(cells))
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def draw(result: MarginMaps, folder: Path) -> None:
    """A map for each adhesion law."""
    from railslip_ctrl.plots import margin_map_figure, save_figure

    folder.mkdir(parents=True, exist_ok=True)
    about = "Worst Ms over mass and actuator ±30 %; kp/ki in N·m/(m/s) and N·m/m"
    for law in ("bristle", "curve", "beam"):
        figure = margin_map_figure(result.results, law, title=f"{about}, {law}")
        save_figure(figure, folder / f"margin_map_{law}.png")


if __name__ == "__main__":
    main()
