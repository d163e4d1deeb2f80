"""How large are the errors of margins and stabilising gains with a Pade approximation of the dead time?

The script compares Pade orders 1 to 5 with the exact dead time, for the wheel-slip loop on dry rail at 100 km/h with PI
and PI-lead, and for several dead times. A low order has the largest error in the largest stabilising proportional gain,
which is decided at high frequency.

    python analysis/pade_order.py
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from railslip_ctrl.controllers.systems import PIController, actuated_plant
from railslip_ctrl.design import stabilizing_pi
from railslip_ctrl.design.schedule import plant_at
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.rational import pade
from railslip_ctrl.model.vehicle import PARK2008, PIGains, Rail

ORDERS = (1, 2, 3, 4, 5)
ACTUATOR = PARK2008.actuator
CONTROLLERS = {
    "PI": PIController(PIGains(kp=190.0, ki=5.0)),
    "PI-lead": PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06),
}
DEAD_TIMES = (0.05, 0.15, 0.4)  # s


@dataclass(frozen=True)
class PadeErrors:
    """Relative errors, one for each Pade order, of margins and of the largest stabilising kp and ki."""

    gain_increase: dict[str, np.ndarray]
    phase: dict[str, np.ndarray]
    ms: dict[str, np.ndarray]
    largest_kp: dict[float, np.ndarray]  # by dead time, s: largest stabilising kp
    largest_ki: dict[float, np.ndarray]  # by dead time, s: largest ki at the geometric mean of the exact kp range


def run() -> PadeErrors:
    """Return all errors relative to the exact loop."""
    plant = actuated_plant(plant_at("bristle", PARK2008, Rail.DRY, 100.0), ACTUATOR)
    gain, phase, ms = {}, {}, {}
    for name, controller in CONTROLLERS.items():
        loop = DeadTimeLoop(controller.transfer_function * plant, ACTUATOR.dead_time)
        exact = loop.margins()
        rows = [loop.pade(order).margins() for order in ORDERS]
        gain[name] = np.array([m.gain_increase / exact.gain_increase - 1 for m in rows])
        phase[name] = np.array([m.phase_deg / exact.phase_deg - 1 for m in rows])
        ms[name] = np.array([m.ms / exact.ms - 1 for m in rows])
    largest_kp, largest_ki = {}, {}
    for dead_time in DEAD_TIMES:
        largest_kp[dead_time], largest_ki[dead_time] = _set_errors(plant, dead_time)
    return PadeErrors(gain, phase, ms, largest_kp, largest_ki)


def _set_errors(plant: Rational, dead_time: float) -> tuple[np.ndarray, np.ndarray]:
    exact = stabilizing_pi(plant, dead_time=dead_time)
    assert exact.kp_range is not None
    low, high = exact.kp_range
    middle = float(np.sqrt(low * high))
    kp, ki = [], []
    for order in ORDERS:
        approximate = stabilizing_pi(plant * pade(dead_time, order), dead_time=0.0)
        kp.append(approximate.kp_range[1] / high - 1 if approximate.kp_range else np.nan)
        ki.append(approximate.ki_limit(middle) / exact.ki_limit(middle) - 1)
    return np.array(kp), np.array(ki)


def main() -> None:
    """Print the tables."""
    result = run()
    print("Relative error of margins, dry, 100 km/h, by Pade order " + " ".join(f"{o:>10d}" for o in ORDERS))
    for title, table in (("gain increase", result.gain_increase), ("phase margin", result.phase), ("Ms", result.ms)):
        for name, row in table.items():
            print(f"  {title:14s} {name:38s} " + " ".join(f"{x:+10.1e}" for x in row))
    print("Relative error of the stabilising set, by dead time")
    for title, rows in (("largest kp", result.largest_kp), ("ki limit in the middle", result.largest_ki)):
        for dead_time, row in rows.items():
            print(f"  {title:24s} {dead_time:5.2f} s {'':21s} " + " ".join(f"{x:+10.1e}" for x in row))


if __name__ == "__main__":
    main()
