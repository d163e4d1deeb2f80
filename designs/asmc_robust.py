"""A sliding-mode law that accounts for the brake actuator, beside the published one.

Behind 0.6 s of lag and 0.15 s of dead time the published relay cannot slide: it cycles, and on dry rail the printed
adaptation makes the loop unstable. Here the surface gets a lead on the lag, the relay a boundary layer whose linear
loop has exact margins on dry and wet rail, and K follows from the bound: it must exceed the disturbance times the L1
norm of the loop. What error is then guaranteed, under which conditions, and does the nonlinear wheel keep it? The
design is the one `railslip verify --law layered` decides.

    python designs/asmc_robust.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import railslip_ctrl as rs
from railslip_ctrl import Rail, actuator_effects, fixed_step, layered, limit_cycles, plots, relay_loop

KMH = 1 / 3.6  # m/s
READINGS = {"SI": 1.0, "as published": rs.AS_PUBLISHED_INERTIA_SCALE}
WORST = "worst case"
ADHESIONS = ("bristle", "curve")  # the model of the design, and the curve the paper's results come from


@dataclass(frozen=True)
class RobustDesign:
    """One reading: the published law's fate, the design, its bounds by rail, and the largest errors simulated.

    `published` holds the bristle model and the static curve the paper's results come from, both rails; `advice` the
    gains of the published structure that were checked together over a stop.
    `simulated[rail][name]` is (largest |sigma error|, largest |Tb - hold|) from rest, m/s and N*m; `worst[rail]` the
    run under the linear loop's worst disturbance.
    """

    published: tuple[actuator_effects.ActuatorEffect, ...]
    advice: actuator_effects.JointAdvice
    design: layered.LayeredDesign
    bounds: dict[Rail, layered.RailBounds]
    simulated: dict[Rail, dict[str, tuple[float, float]]]
    worst: dict[Rail, fixed_step.FineRun]


def design_for(inertia_scale: float) -> RobustDesign:
    """Published law, design, bounds and check in one reading."""
    vehicle = rs.PARK2008.model_copy(update={"inertia_scale": inertia_scale})
    design = layered.layered_design(vehicle)
    bounds = layered.rail_bounds(design, vehicle)
    return RobustDesign(
        published=tuple(
            actuator_effects.actuator_effect(
                actuator_effects.published_loop(rail, inertia_scale=inertia_scale, adhesion=adhesion)
            )
            for adhesion in ADHESIONS
            for rail in Rail
        ),
        advice=actuator_effects.joint_advice(
            actuator_effects.stop_loops(
                relay_loop.TABLE4_SLIDING["bristle"].K, relay_loop.TABLE4_SLIDING["bristle"].D, vehicle
            )
        ),
        design=design,
        bounds=bounds,
        simulated={rail: layered.bounded_errors(design, one) for rail, one in bounds.items()},
        worst={rail: worst_run(design, one) for rail, one in bounds.items()},
    )


def worst_run(design: layered.LayeredDesign, bounds: layered.RailBounds) -> fixed_step.FineRun:
    """The nonlinear wheel from rest under the worst disturbance of the linear loop."""
    point, actuator = bounds.plant.point, bounds.plant.point.vehicle.actuator
    impulse = layered.torque_impulse(design, bounds.plant, actuator)
    torque = layered.bounded_torques(bounds.at_rest.disturbance, impulse)[WORST]
    law = layered.LayeredLaw(point.slip, fixed_step.holding_torque(point), design=design)
    return fixed_step.simulate_fine(
        point, law, actuator, duration=layered.DURATION, step=layered.STEP, disturbance=torque
    )


def run() -> dict[str, RobustDesign]:
    """Both readings."""
    return {name: design_for(scale) for name, scale in READINGS.items()}


def bounds_table(found: RobustDesign) -> str:
    """What is guaranteed, one row a rail."""
    lines = [
        f"{'rail':5}{'Ms':>7}{'|d| N*m':>9}{'|error| m/s':>13}{'|s| m/s':>9}{'|Tb-hold| N*m':>15}"
        f"{'from ' + format(layered.OFFSET, 'g') + ' m/s: below':>22}{'after s':>9}{'K N*m >=':>10}"
    ]
    for rail, one in found.bounds.items():
        rest, offset = one.at_rest, one.from_offset
        lines.append(
            f"{rail.value:5}{rest.margins.ms:7.3f}{rest.disturbance:9g}{rest.error:13.3f}{rest.surface:9.3f}"
            f"{rest.command:15.0f}{offset.error + 0.01 * layered.OFFSET:22.3f}"
            f"{offset.reaching_time:9.1f}{offset.command:10.0f}"
        )
    return "\n".join(lines)


def simulated_table(found: RobustDesign) -> str:
    """Largest errors (m/s) and torques about the hold (N*m) of the simulations beside the bounds, rails in columns."""
    lines = [f"{'simulated':20}" + "".join(f"{rail.value + ': m/s':>12}{'N*m':>8}" for rail in found.simulated)]
    for name in found.simulated[Rail.DRY]:
        cells = (found.simulated[rail][name] for rail in found.simulated)
        lines.append(f"{name:20}" + "".join(f"{error:12.3f}{command:8.0f}" for error, command in cells))
    bounds = ((one.at_rest.error, one.at_rest.command) for one in found.bounds.values())
    return "\n".join([*lines, f"{'bound':20}" + "".join(f"{e:12.3f}{c:8.0f}" for e, c in bounds)])


def main() -> None:
    """Print the fate of the published law and the design with its bounds; with a folder, draw the worst runs."""
    result = run()
    effects = [effect for found in result.values() for effect in found.published]
    print("THE PUBLISHED LAW BEHIND THE ACTUATOR\n")
    print(cycle_table(effects))
    print()
    print(survivors_table(effects))
    print()
    print("THE LAYERED LAW WITH A LEAD ON THE LAG")
    for name, found in result.items():
        d = found.design
        print(f"\n{name}: K {d.K:.0f} N*m, layer {d.layer:.3f} m/s, rho {d.rho:.4f} 1/s (kp {d.kp:.1f}, ki {d.ki:.1f})")
        print(bounds_table(found))
        print()
        print(simulated_table(found))
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def cycle_table(effects: list[actuator_effects.ActuatorEffect]) -> str:
    """Limit cycles of some `effects` as text.

    For each K the wheel's, then the linearised loop's and the describing function's error.
    """
    lines = [
        f"{'case':28} {'K':>5} {'period s':>9} {'s m/s':>7} {'slip':>7} {'torque N*m':>10} "
        f"{'lin. T':>7} {'lin. slip':>10} {'DF T':>6} {'DF s':>6}"
    ]
    for effect in effects:
        if effect.own_cycle is None:
            lines.append(f"{effect.name:28} {effect.loop.gains.K:5.0f} {'--':>9}")
        lines += [f"{effect.name:28} {cycle.linear.K:5.0f} {_row(cycle)}" for cycle in effect.cycles]
    return "\n".join(
        [
            *lines,
            "Adaptation off, speed frozen. lost: the wheel locks; --: no stable cycle; DF: describing function against "
            "the wheel.",
            "*: beyond the linearisation: over the swing the wheel's response changes by over "
            f"{limit_cycles.LINEAR_CHANGE:.0%}, or the slip leaves the model.",
        ]
    )


def _row(cycle: actuator_effects.RelayCycle) -> str:
    c, linear = cycle.actual, cycle.linear
    own = f"{'lost':>9} {'-':>7} {'-':>7} {'-':>10}"
    errors = f"{'-':>6} {'-':>6}"
    if c is not None:
        own = f"{c.period:9.3f} {c.surface_amplitude:7.3f} {c.slip_amplitude:7.4f} {c.torque_amplitude:10.1f}"
        errors = f"{100 * cycle.period_error:+5.1f}% {100 * cycle.amplitude_error:+5.1f}%"
    mark = " " if cycle.linear_holds else "*"
    return f"{own} {linear.period:7.3f} {linear.slip_amplitude:9.4f}{mark} {errors}"


def survivors_table(effects: list[actuator_effects.ActuatorEffect]) -> str:
    """What survives the actuator, one row a case: unstable poles with the printed k, and the largest gains."""
    lines = [
        f"{'case':28}{'poles':>6}{'largest k':>11}{'K N*m':>8}{'rho 1/s':>9}{'D':>8}{'K/layer':>9}   "
        "(printed: k 2.1e-08, K 70, rho 1.54, D 5.51)"
    ]
    for effect in effects:
        left = effect.survivors
        lines.append(
            f"{effect.name:28}{effect.unstable_actual:6.0f}{left.k:11.2e}{left.K:8.1f}{left.rho:9.2f}{left.D:8.1f}"
            f"{left.relay_gain:9.1f}"
        )
    return "\n".join(lines)


def draw(result: dict[str, RobustDesign], folder: Path) -> None:
    """Slip velocity error and commanded torque of the worst runs, with their bounds, both readings, and the setting."""

    figure = plots.style.new_figure(
        5.6, "Layered law: worst runs, and bounds no disturbance of that size can exceed (thin)"
    )
    grid = plots.style.panels(figure, 2, len(result), sharex=True)
    for column, (name, found) in enumerate(result.items()):
        for rail, one in found.bounds.items():
            point, run = one.plant.point, found.worst[rail]
            rest, style = one.at_rest, plots.style.rail_style(rail)
            signals = (
                (run.sigma - point.sigma, rest.error),
                (run.command - fixed_step.holding_torque(point), rest.command),
            )
            for axes, (signal, bound) in zip(grid[:, column], signals, strict=True):
                axes.plot(run.time, signal, label=f"{rail.value}, bound ±{bound:.3g}", **style)
                for side in (-bound, bound):
                    axes.axhline(side, linewidth=0.7, **style)
        first = found.bounds[Rail.DRY]
        height, at = first.at_rest.disturbance, first.plant.point
        setting = f"{at.speed / KMH:.3g} km/h frozen, {at.vehicle.mass:g} kg, from the reference slip at rest"
        grid[0, column].set_title(f"{name}: worst torque within ±{height:g} N·m\n{setting}", fontsize=plots.style.SMALL)
        grid[1, column].set_xlabel("time (s)")
        for axes, drop in zip(grid[:, column], (0.05, 0.2), strict=True):
            plots.style.legend_below(axes, drop, columns=2)
    grid[0, 0].set_ylabel("slip velocity error (m/s)")
    grid[1, 0].set_ylabel("torque about the hold (N·m)")
    folder.mkdir(parents=True, exist_ok=True)
    plots.save_figure(figure, folder / "asmc_robust.png")


if __name__ == "__main__":
    main()
