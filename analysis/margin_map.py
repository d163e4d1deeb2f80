"""Where in the design envelope is the loop of a controller stable, and with which Ms?

The envelope has both rails, speeds from 5 to 140 km/h, the empty and the loaded vehicle, slips from 0.5 to 1.5 times
the reference (through the adhesion peak), dead time and lag of the actuator +-30 %, and three adhesion laws. These are
several thousand loops for each controller, each with its exact dead time. The script prints a table for each axis with
the worst case, and draws a map over speed and load.

    python analysis/margin_map.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
from pathlib import Path

from railslip_ctrl.controllers.systems import PIController
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.judging import Judgement, judge
from railslip_ctrl.model.vehicle import PIGains

CONTROLLERS = {
    "PI 211/5": PIController(PIGains(kp=210.6, ki=5.0)),  # designs/pi_robust.py
    "PI-lead 229/5": PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06),  # designs/pi_lead.py
}
ENVELOPE = Envelope(
    laws=("bristle", "curve", "beam"),
    speeds=(5, 10, 20, 40, 60, 80, 100, 120, 140),
    slip=(0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5),
    radius=1.0,
)


def run(envelope: Envelope = ENVELOPE) -> dict[str, Judgement]:
    """Judge both controllers over the envelope."""
    return {name: judge(envelope, controller) for name, controller in CONTROLLERS.items()}


def main() -> None:
    """Print the tables; with a folder, draw the maps."""
    result = run()
    for name, judged in result.items():
        print(f"\n{name}: {len(judged.points)} cases, {100 * judged.stable.mean():.2f} % stable; {judged.verdict_line}")
        for axis, values in judged.by_axis().items():
            cells = (f"{_text(v)}: {100 * share:.0f} % / {ms:.3g}" for v, (share, ms) in values.items())
            print(f"  {axis} (stable / worst Ms of the stable loops): " + ",  ".join(cells))
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def draw(result: dict[str, Judgement], folder: Path) -> None:
    """Draw the maps of both controllers."""
    from railslip_ctrl.report.plots import ms_map_figure, save_figure

    folder.mkdir(parents=True, exist_ok=True)
    title = "Worst Ms over rail, law, slip and actuator ±30 %; kp/ki in N·m/(m/s) and N·m/m"
    figure = ms_map_figure({name: judged.map for name, judged in result.items()}, title=title)
    save_figure(figure, folder / "margin_map.png")


if __name__ == "__main__":
    main()
