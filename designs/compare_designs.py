"""How do the published PI, the best PI, tuning rules, PI-lead, Smith predictors and an observer compare?

The plant is the bristle model in SI on dry and on wet rail at 100 km/h, with the published actuator and its exact dead
time. For each design the table has the margins of the true loop (not of a predictor's model), the noise gain and the
torque rate, or the reason why the loop is unstable. The script also prints the margins that no controller can exceed.

The PI and the PI-lead have the same gains on both rails. The predictors, the observer and the rules are designed for
each rail; on the other rail their margins are worse.

    python designs/compare_designs.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import railslip_ctrl as rs
from railslip_ctrl import PARK2008, PIController, Rail, deadtime, plots, responses, tuning

SPEED_KMH = 100.0
KI_MIN = 5.0  # N*m/m
ACTUATOR = PARK2008.actuator
FEEDBACK_POLES = (-0.1, -1.0, -1.67, -8.6)  # 1/s: integrator, slip, actuator lag, bristles
OBSERVER_POLES = (-30.0, -21.0, -8.6)  # 1/s
RULE_TIME = 1.0  # s, closed-loop time constant for the Rotstein-Lewin rule
KMH = 1 / 3.6


@dataclass(frozen=True)
class Row:
    """One design on one rail; if it is unstable, `margins` and `effort` are None and `reason` states the cause."""

    design: str
    rail: Rail
    margins: rs.Margins | None
    effort: rs.limits.Effort | None
    reason: str


@dataclass(frozen=True)
class Comparison:
    """Rows of the table, limits by rail, and for dry rail the step responses and gangs of four (S, T, PS and CS)."""

    rows: tuple[Row, ...]
    limits: dict[Rail, rs.limits.Limits]
    reference: dict[str, responses.TimeResponse]
    load: dict[str, responses.TimeResponse]
    gangs: dict[str, deadtime.GangOfFour]

    def row(self, design: str, rail: Rail) -> Row:
        """Return the row of a design on a rail."""
        return next(row for row in self.rows if (row.design, row.rail) == (design, rail))


def plants() -> dict[Rail, rs.Rational]:
    """Return, by rail, the system from commanded torque to slip velocity, without the dead time."""
    return {rail: rs.actuated_plant(rs.plant_at("bristle", PARK2008, rail, SPEED_KMH), ACTUATOR) for rail in Rail}


def best(both: list[rs.Rational], lead: float, lead_filter: float) -> PIController:
    """Return the PI with a given lead that has the smallest worst Ms over both plants."""
    compensator = PIController(rs.PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function
    tuned = rs.tune_pi(both, ACTUATOR.dead_time, minimise_ms=True, ki_min=KI_MIN, compensator=compensator)
    return PIController(rs.PIGains(kp=tuned.kp, ki=tuned.ki), lead, lead_filter)


def fixed_designs(both: list[rs.Rational]) -> dict[str, PIController]:
    """Return the designs that are one transfer function for both rails."""
    return {
        "published PI (Table 4)": PIController(rs.TABLE4_PI["bristle"]),
        "best PI": best(both, 0.0, 0.0),
        "PI-lead": best(both, ACTUATOR.lag, 0.06),
    }


def predictors(plant: rs.Rational, lead: rs.Rational) -> dict[str, Callable[[], rs.compensators.Compensator]]:
    """Return functions by name, each of which designs a dead-time compensator when it is called."""
    tau = ACTUATOR.dead_time
    return {
        "Smith predictor": lambda: rs.compensators.smith_predictor(plant, tau, lead),
        "filtered Smith predictor": lambda: rs.compensators.filtered_smith_predictor(plant, tau, lead, filter_time=0.1),
        "observer with prediction": lambda: rs.compensators.observer_compensator(
            plant, tau, feedback_poles=FEEDBACK_POLES, observer_poles=OBSERVER_POLES
        ),
    }


def rows_for(rail: Rail, plant: rs.Rational, fixed: dict[str, PIController]) -> list[Row]:
    """Return the rows of every design on one rail."""
    tau = ACTUATOR.dead_time
    rows = [plain_row(name, rail, plant, controller.transfer_function) for name, controller in fixed.items()]
    lead = fixed["PI-lead"].transfer_function
    made: dict[str, Callable[[], rs.compensators.Compensator | tuning.RuleTuning]] = {
        "SIMC rule": lambda: tuning.simc_pi(plant, tau),
        "Rotstein-Lewin rule": lambda: tuning.rotstein_lewin(plant, tau, closed_loop_time=RULE_TIME),
        **predictors(plant, lead),
    }
    for name, make in made.items():
        rows.append(tried(name, rail, lambda name=name, make=make: made_row(name, rail, plant, make())))
    return rows


def tried(name: str, rail: Rail, make: Callable[[], Row]) -> Row:
    """Return the row that `make` returns, or a row with the reason if the design is unstable."""
    try:
        return make()
    except (rs.InputError, rs.RailslipError) as error:
        return Row(name, rail, None, None, str(error))


def plain_row(name: str, rail: Rail, plant: rs.Rational, controller: rs.Rational) -> Row:
    """Return the row of a design that is a transfer function."""
    loop = rs.DeadTimeLoop(controller * plant, ACTUATOR.dead_time)
    if not loop.is_stable():
        return Row(
            name, rail, None, None, f"unstable: {loop.unstable_closed_loop_poles:g} poles in the right half plane"
        )
    effort = rs.limits.control_effort(controller, plant, ACTUATOR.dead_time, lag=ACTUATOR.lag)
    return Row(name, rail, loop.margins(), effort, "")


def made_row(name: str, rail: Rail, plant: rs.Rational, design: rs.compensators.Compensator | tuning.RuleTuning) -> Row:
    """Return the row of a rule or a dead-time compensator, with the margins of its true loop."""
    if isinstance(design, tuning.RuleTuning):
        return plain_row(name, rail, plant, design.transfer_function())
    margins = design.margins()  # raises UnstableLoopError for an unstable design
    effort = rs.limits.control_effort(design.controller, plant, ACTUATOR.dead_time, lag=ACTUATOR.lag)
    return Row(name, rail, margins, effort, "")


def run() -> Comparison:
    """Compute the table, the limits and the responses."""
    by_rail = plants()
    fixed = fixed_designs(list(by_rail.values()))
    rows = [row for rail, plant in by_rail.items() for row in rows_for(rail, plant, fixed)]
    limits = {r: rs.fundamental_limits(p, ACTUATOR.dead_time, lag=ACTUATOR.lag) for r, p in by_rail.items()}
    wheel = rs.plant_at("bristle", PARK2008, Rail.DRY, SPEED_KMH)
    bare = rs.Rational(wheel.zeros, wheel.poles, wheel.gain)
    lag = rs.Rational(np.array([]), np.array([-1 / ACTUATOR.lag]), 1 / ACTUATOR.lag)
    shown = {name: fixed[name].transfer_function for name in ("best PI", "PI-lead")}
    tau = ACTUATOR.dead_time
    compensators = {name: make() for name, make in predictors(by_rail[Rail.DRY], shown["PI-lead"]).items()}
    stable = {name: design.controller for name, design in compensators.items() if design.is_stable()}
    return Comparison(
        rows=tuple(rows),
        limits=limits,
        reference={
            n: responses.step_response(c, bare, tau, final_time=30.0, actuator=lag, reference=KMH)
            for n, c in shown.items()
        },
        load={
            n: responses.disturbance_response(c, bare, tau, final_time=30.0, actuator=lag, disturbance=100.0)
            for n, c in shown.items()
        },
        gangs={
            n: deadtime.gang_of_four(c, rs.DeadTimeLoop(by_rail[Rail.DRY], tau), 0.01, 100.0)
            for n, c in {**shown, **stable}.items()
        },
    )


def main() -> None:
    """Print the table; with a folder, draw the responses and the gang of four."""
    result = run()
    for rail, limits in result.limits.items():
        print(f"{rail} rail: unstable pole {limits.unstable_pole:.3g} 1/s; no controller has Ms or Mt below", end=" ")
        print(f"{limits.ms_bound:.3g}", end="")
        for structure in (limits.pi, limits.pi_lead):
            if structure is not None:
                print(f"; {structure.structure}: phase margin <= {structure.phase_deg:.3g} deg", end="")
                print(f", Ms >= {structure.ms_bound:.3g}", end="")
        print(".")
    print(f"\n{'design':26s} {'rail':4s} {'Ms':>6s} {'phase':>7s} {'delay':>7s} {'gain -':>7s} {'gain +':>7s}", end=" ")
    print(f"{'noise gain':>10s} {'torque rate, N·m/s, on 1 km/h of':>33s}")
    print(f"{'':26s} {'':4s} {'-':>6s} {'deg':>7s} {'s':>7s} {'-':>7s} {'-':>7s} {'N·m/(m/s)':>10s}", end=" ")
    print(f"{'reference':>16s} {'slip':>16s}")
    notes: list[str] = []
    for row in result.rows:
        text = line(row)
        if not text:
            if row.reason not in notes:
                notes.append(row.reason)
            text = f"no stable loop ({notes.index(row.reason) + 1})"
        print(f"{row.design:26s} {row.rail:4s} {text}")
    for number, note in enumerate(notes, start=1):
        print(f"({number}) {note}")
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def line(row: Row) -> str:
    """Return the numbers of a row as text; empty for an unstable design."""
    if row.margins is None or row.effort is None:
        return ""
    m, e = row.margins, row.effort
    return (
        f"{m.ms:6.3g} {m.phase_deg:7.3g} {m.delay_s:7.3g} {m.gain_decrease:7.3g} {m.gain_increase:7.3g} "
        f"{e.noise_gain:10.4g} {e.reference_rate:16.4g} {e.disturbance_rate:16.4g}"
    )


def draw(result: Comparison, folder: Path) -> None:
    """Draw, on dry rail, the responses of best PI and PI-lead, and the gangs of four of all stable designs."""

    folder.mkdir(parents=True, exist_ok=True)
    title = "Bristle model, dry rail, 100 km/h, slip 0.132; dead time exact"
    figure = plots.response_figure(
        result.reference,
        result.load,
        title=title,
        reference_label="step of 1 km/h of the reference slip velocity",
        load_label="step of 100 N·m of torque at the wheel",
    )
    plots.save_figure(figure, folder / "compare_designs_responses.png")
    plots.save_figure(plots.gang_of_four_figure(result.gangs, title=title), folder / "compare_designs_gang_of_four.png")


if __name__ == "__main__":
    main()
