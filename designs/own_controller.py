"""Is a PID with filter and notch robust on a coach, and how does it brake in 200 runs?

python designs/own_controller.py [FOLDER]
"""

import sys
from pathlib import Path

import control as ct

import railslip_ctrl as rs

S = ct.tf("s")
PID = 1030 + 80 / S + 370 * S / (0.015 * S + 1)  # N*m/(m/s), from slip error to torque
NOTCH = (S**2 + 32 * S + 80**2) / (S**2 + 80 * S + 80**2)  # at the pitch frequency of a bogie, 80 rad/s


def run(runs: int = 200) -> dict:
    """Return verdict, worst loop, one stop on wet rail, and many stops beside a tuned PI-lead."""
    envelope = rs.load_envelope(Path(__file__).parent / "vehicles" / "coach.toml")
    start = {"torque_min": 0, "torque_max": 15e3, "tracking_time": 2, "initial_torque": 6e3}  # N*m, s
    mine = rs.linear_control(PID * NOTCH, reference=envelope.reference, name="pid", period=0.01, **start)
    check, wet = rs.judge(envelope, mine), rs.stop(envelope.vehicle, "wet", speed_kmh=100)
    many = rs.campaign(wet, [mine, rs.tune(envelope, structure="pi-lead", ms_max=2)], runs=runs)
    loop = rs.wheel_slip_loop(check.worst.point, PID * NOTCH)
    return {"check": check, "loop": loop, "stop": rs.simulate(wet, mine, seed=7), "many": many}


def main() -> None:
    """Print the results; with a folder, draw them."""
    found = run()
    print(found["check"], found["check"].worst.description, found["stop"], found["many"].table(), sep="\n\n")
    for folder in map(Path, sys.argv[1:]):
        loop, pictures = found["loop"], {"map": found["check"].map.plot(), "stop": found["stop"].plot()}
        for name, figure in {**pictures, "bode": loop.bode_plot(), "nyquist": loop.nyquist_plot()}.items():
            figure.savefig(folder / f"own_controller_{name}.png")


if __name__ == "__main__":
    main()
