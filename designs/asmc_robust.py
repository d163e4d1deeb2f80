"""A sliding-mode law that accounts for the brake actuator, beside the published one.

Behind 0.6 s of lag and 0.15 s of dead time the published relay cannot slide: it cycles, and on dry rail the printed
adaptation makes the loop unstable. Here the surface gets a lead on the lag, the relay a boundary layer whose linear
loop has exact margins on dry and wet rail, and K follows from the bound: it must exceed the disturbance times the L1
norm of the loop. What error is then guaranteed, under which conditions, and does the nonlinear wheel keep it?

    python designs/asmc_robust.py
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from railslip_ctrl.design import PIController, actuated_plant
from railslip_ctrl.design.tuning import tune_pi
from railslip_ctrl.loop import Margins
from railslip_ctrl.parameters import AS_PUBLISHED_INERTIA_SCALE, PARK2008, PIGains, Rail
from railslip_ctrl.switching import (
    ActuatorEffect,
    LayerBound,
    LayeredDesign,
    actuator_effect,
    conclusion,
    cycle_table,
    layer_bound,
    published_loop,
)
from railslip_ctrl.switching.layered import Impulse, torque_impulse
from railslip_ctrl.switching.simulate import holding_torque, simulate
from railslip_ctrl.switching.stepped import LayeredLaw

ACTUATOR = PARK2008.actuator
LEAD_FILTER = 0.06  # s: a tenth of the lag, as in designs/pi_lead.py
OFFSET = 0.1  # m/s: error at t = 0 that must be taken in
DURATION, STEP = 15.0, 2.5e-3  # s


@dataclass(frozen=True)
class Target:
    """One reading: its inertia scale, least integral gain (N*m/m), disturbance (N*m) and authority K (N*m)."""

    inertia_scale: float
    ki_min: float
    disturbance: float
    K: float


TARGETS = {
    "SI": Target(1.0, ki_min=100.0, disturbance=20.0, K=450.0),
    "as published": Target(AS_PUBLISHED_INERTIA_SCALE, ki_min=300.0, disturbance=50.0, K=850.0),
}


@dataclass(frozen=True)
class RobustDesign:
    """One reading: the published law's fate, the design, its bounds by rail, and the largest errors simulated.

    `published` holds the bristle model and the static curve the paper's results come from, both rails.
    `simulated[rail][name]` is (largest |sigma error|, largest |Tb - hold|) from rest, m/s and N*m.
    """

    published: tuple[ActuatorEffect, ...]
    design: LayeredDesign
    margins: dict[Rail, Margins]
    at_rest: dict[Rail, LayerBound]
    from_offset: dict[Rail, LayerBound]
    simulated: dict[Rail, dict[str, tuple[float, float]]]


def tune(target: Target) -> LayeredDesign:
    """The PI gains of least worst Ms over both rails with the lead, turned into a layer and K."""
    loops = {rail: published_loop(rail, inertia_scale=target.inertia_scale) for rail in Rail}
    lead = PIController(PIGains(kp=1.0, ki=0.0), ACTUATOR.lag, LEAD_FILTER).transfer_function
    plants = [actuated_plant(loop.plant, ACTUATOR) for loop in loops.values()]
    tuned = tune_pi(plants, ACTUATOR.dead_time, minimise_ms=True, ki_min=target.ki_min, compensator=lead)
    return LayeredDesign(tuned.kp, tuned.ki, ACTUATOR.lag, LEAD_FILTER, target.K)


def disturbances(height: float, impulse: Impulse) -> dict[str, Callable[[float], float]]:
    """Torques within +-height, N*m, over time, s: a step, sines, held noise, and the worst for the linear loop."""
    noise = np.random.default_rng(1).uniform(-height, height, 1000)
    worst = np.sign(np.interp(DURATION - np.arange(0.0, DURATION, STEP), impulse.time, impulse.error, right=0.0))

    return {
        "step": lambda t: height,
        "sine 0.5 rad/s": lambda t: height * math.sin(0.5 * t),
        "sine 2 rad/s": lambda t: height * math.sin(2.0 * t),
        "noise held 0.02 s": lambda t: float(noise[int(t / 0.02) % noise.size]),
        # the impulse response backwards in time: every push adds up at the end
        "worst case": lambda t: height * float(worst[min(int(t / STEP), worst.size - 1)]),
    }


def check(design: LayeredDesign, target: Target, rail: Rail) -> dict[str, tuple[float, float]]:
    """Simulate the nonlinear wheel from rest, speed frozen, under each disturbance."""
    plant = published_loop(rail, inertia_scale=target.inertia_scale).plant
    point, hold = plant.point, holding_torque(plant.point)
    found = {}
    for name, torque in disturbances(target.disturbance, torque_impulse(design, plant, ACTUATOR)).items():
        law = LayeredLaw(point.slip, hold, design=design)
        run = simulate(point, law, ACTUATOR, duration=DURATION, step=STEP, disturbance=torque)
        found[name] = (float(np.abs(run.sigma - point.sigma).max()), float(np.abs(run.command - hold).max()))
    return found


def design_for(target: Target) -> RobustDesign:
    """Published law, design, bounds and check in one reading."""
    design = tune(target)
    loops = {rail: published_loop(rail, inertia_scale=target.inertia_scale) for rail in Rail}
    at_rest = {r: layer_bound(design, loops[r].plant, ACTUATOR, target.disturbance) for r in Rail}
    return RobustDesign(
        published=tuple(
            actuator_effect(published_loop(rail, inertia_scale=target.inertia_scale, adhesion=adhesion))
            for adhesion in ("bristle", "curve")
            for rail in Rail
        ),
        design=design,
        margins={rail: bound.margins for rail, bound in at_rest.items()},
        at_rest=at_rest,
        from_offset={r: layer_bound(design, loops[r].plant, ACTUATOR, target.disturbance, offset=OFFSET) for r in Rail},
        simulated={rail: check(design, target, rail) for rail in Rail},
    )


def run() -> dict[str, RobustDesign]:
    """Both readings."""
    return {name: design_for(target) for name, target in TARGETS.items()}


def main() -> None:
    """Print the fate of the published law and the design with its bounds."""
    result = run()
    effects = [effect for found in result.values() for effect in found.published]
    print("THE PUBLISHED LAW BEHIND THE ACTUATOR\n")
    print(cycle_table(effects))
    print(f"\n{conclusion(effects)}\n")
    print("THE LAYERED LAW WITH A LEAD ON THE LAG\n")
    for name, found in result.items():
        d = found.design
        print(f"{name}: K {d.K:g} N*m, layer {d.layer:.3f} m/s, rho {d.rho:.4f} 1/s (kp {d.kp:.1f}, ki {d.ki:.1f})")
        for rail, bound in found.at_rest.items():
            offset = found.from_offset[rail]
            print(
                f"  {rail.value}: Ms {bound.margins.ms:.3f}; |d| <= {bound.disturbance:g} N*m keeps |sigma error| <= "
                f"{bound.error:.3f} m/s, |s| <= {bound.surface:.3f} m/s, |Tb - hold| <= {bound.command:.0f} N*m; from "
                f"an error of {offset.offset:g} m/s it is below {offset.error + 0.01 * offset.offset:.3f} m/s after "
                f"{offset.reaching_time:.1f} s, if K >= {offset.command:.0f} N*m"
            )
            for what, (error, command) in found.simulated[rail].items():
                print(f"    simulated, {what}: {error:.3f} m/s, {command:.0f} N*m")


if __name__ == "__main__":
    main()
