"""Is a controller that is designed only from a log robust on the true adhesion law?

The steps are observer, fit, operating points, robust design, margins and braking runs. The vehicle is a Siemens Desiro
Classic (railtoolkit/rolling-stock-data, CC BY 4.0), and a simulated brake rig writes the log for its wheel. The design
uses only the log, and must be robust for every law within the uncertainty of the fit.

The brake starts at a torque that dry rail supports. Wet rail has half of this adhesion. The brake reacts after 0.75 s,
so no command can prevent a lock when the rail turns wet. The design is judged by the time until the wheel rolls again,
and by the whole stop.

    python designs/from_log.py [FOLDER for the log, the fitted model and the pictures]
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import railslip_ctrl as rs
from railslip_ctrl import PIController, Rail, adhesion, fits, numeric, plots, tuning, virtual_rig

KMH = 1 / 3.6  # m/s
VEHICLE = Path(__file__).parent / "vehicles" / "desiro_classic.toml"
TRUE_LAW = adhesion.law_class("burckhardt").model_validate(
    {"c1": 0.31, "c2": 24.0, "c3": 0.11}
)  # used by the rig, unknown to the design
INITIAL_SPEED = 100.0 * KMH
RANDOM_SHARE = 431.0 / 34_500.0  # random adhesion force of [Park2008], as a share of the wheel load
TESTS = 12  # number of tests in the log
SPEEDS_KMH = (10.0, 30.0, 100.0)
HELD_SHARE = 0.98  # adhesion at the reference slip over peak adhesion: at the peak a small disturbance starts a slide
MS_MAX = 2.0  # upper end of the range that [Astrom1998] calls reasonable
INITIAL_SHARE = 0.9  # initial torque over the torque that the weakest law within the uncertainty allows
FALLING = 1.5  # slip beyond the peak at which the loop is checked over reference slip; nearly reached at the start
LEAD_FILTER = 0.1  # time constant of the lead's filter over that of the lead; the latter is the actuator's lag
PERIOD = 0.02  # s, sampling period of the controller
RAIN = 5.0  # s, time from the start of braking until the rail turns wet
SEEDS = (0, 1, 2)


@dataclass(frozen=True)
class FromLog:
    """Results of every step, in order."""

    vehicle: rs.Vehicle
    found: rs.Identification
    held: rs.ReferenceSlip
    plants: tuple[rs.LinearPlant, ...]  # of all laws within the uncertainty, at all operating points
    design: tuning.PIDesign
    controller: PIController
    true_margins: tuple[rs.Margins, ...]  # with the true law
    runs: tuple[rs.Run, ...]  # with the true law
    slowest_falling: float  # km/h, lowest speed at which the loop is stable beyond the peak for all laws


def rig_log(vehicle: rs.Vehicle, path: Path) -> Path:
    """Write the log of the rig's tests with the vehicle's wheel, and return its path."""
    test = virtual_rig.RigTest(
        vehicle, TRUE_LAW, INITIAL_SPEED, rate=8000.0, random_force=RANDOM_SHARE * vehicle.wheel_load, torque_noise=50.0
    )
    virtual_rig.write_log(virtual_rig.run_tests(test, tests=TESTS, seed=1), path)
    return path


def laws_within(fit: fits.Fit) -> list[adhesion.AdhesionLaw]:
    """Return the fitted law, and the laws at the ends of the axes of its joint 99 % confidence ellipsoid."""
    from scipy.stats import chi2

    size, axes = np.linalg.eigh(fit.covariance)
    reach = np.sqrt(chi2.ppf(fits.CONFIDENCE, len(size)) * size) * axes
    values = [fit.values, *(fit.values + sign * axis for axis in reach.T for sign in (-1, 1))]
    return [fit.model.make(each, fit.law.rail) for each in values]


def held_slip(found: rs.Identification) -> rs.ReferenceSlip:
    """Return the slip below the peak at which the fitted law has `HELD_SHARE` of its peak adhesion."""
    law, load = found.chosen.fit.law, found.setting.wheel_load

    def slip(rail: Rail) -> float:
        top = numeric.peak(law.on(rail), INITIAL_SPEED, load).slip
        slips = np.linspace(0.01 * top, top, 400)
        mu = [float(numeric.adhesion_coefficient(law.on(rail), INITIAL_SPEED, each, load)) for each in slips]
        return float(np.interp(HELD_SHARE * mu[-1], mu, slips))

    return rs.ReferenceSlip(dry=slip(Rail.DRY), wet=slip(Rail.WET))


def operating_plants(
    laws: list[adhesion.AdhesionLaw], vehicle: rs.Vehicle, held: rs.ReferenceSlip
) -> tuple[rs.LinearPlant, ...]:
    """Return the plants of each law at the reference slip: both rails, all speeds, empty and loaded."""
    return tuple(
        rs.linearize(rs.operating_point(law.on(rail), each, speed=speed * KMH, slip=getattr(held, rail)))
        for law in laws
        for rail in Rail
        for speed in SPEEDS_KMH
        for each in (vehicle, vehicle.loaded())
    )


def run(folder: Path | None = None) -> FromLog:
    """Compute all steps from the log to the runs; the log is written to `folder` or to a temporary folder."""
    vehicle = rs.load_vehicle(VEHICLE)
    # 1. The log, and the laws fitted to it.
    with tempfile.TemporaryDirectory() as scratch:
        log = rig_log(vehicle, (folder or Path(scratch)) / "rig.csv")
        found = rs.identify(log, vehicle)
    # 2. Every law that the log allows, at every operating point.
    held, laws = held_slip(found), laws_within(found.chosen.fit)
    plants = (*operating_plants(laws, vehicle, held), *(past_peak(law, vehicle, held, INITIAL_SPEED) for law in laws))
    # 3. One PI-lead for all of them. The largest ki with Ms <= MS_MAX.
    actuator = vehicle.actuator
    lead, lead_filter = actuator.lag, LEAD_FILTER * actuator.lag
    shape = PIController(rs.PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function
    design = rs.tune_pi(
        [rs.actuated_plant(plant, actuator) for plant in extremes(plants)],
        actuator.dead_time,
        ms_max=MS_MAX,
        compensator=shape,
    )
    controller = PIController(rs.PIGains(kp=design.kp, ki=design.ki), lead, lead_filter)
    # 4. Its margins with the true law, and the stop on it.
    true_plants = operating_plants([TRUE_LAW], vehicle, held)
    margins = tuple(rs.wheel_slip_loop(plant, controller, actuator).margins() for plant in true_plants)
    simulator = braking(vehicle, controller, held, initial_torque(laws, vehicle, held))
    return FromLog(
        vehicle,
        found,
        held,
        plants,
        design,
        controller,
        margins,
        tuple(simulator.run(s, record_every=5) for s in SEEDS),
        slowest_falling(laws, vehicle, controller, held),
    )


def past_peak(law: adhesion.AdhesionLaw, vehicle: rs.Vehicle, held: rs.ReferenceSlip, speed: float) -> rs.LinearPlant:
    """Return the plant on dry rail beyond the peak, at a speed in m/s."""
    return rs.linearize(rs.operating_point(law, vehicle, speed=speed, slip=FALLING * held.dry))


def initial_torque(laws: list[adhesion.AdhesionLaw], vehicle: rs.Vehicle, held: rs.ReferenceSlip) -> float:
    """Return a torque, N*m, that dry rail supports with every law."""
    takes = [float(numeric.adhesion_coefficient(law, INITIAL_SPEED, held.dry, vehicle.wheel_load)) for law in laws]
    return INITIAL_SHARE * min(takes) * vehicle.wheel_load * vehicle.wheel.radius


def slowest_falling(
    laws: list[adhesion.AdhesionLaw], vehicle: rs.Vehicle, controller: PIController, held: rs.ReferenceSlip
) -> float:
    """Return the lowest speed, km/h, down to which the loop is stable beyond the peak for all laws."""
    actuator = vehicle.actuator
    for speed in np.arange(100.0, 0.0, -2.0):
        for law in laws:
            plant = past_peak(law, vehicle, held, speed * KMH)
            if not rs.wheel_slip_loop(plant, controller, actuator).is_stable():
                return float(speed + 2.0)
    return 2.0


def extremes(plants: tuple[rs.LinearPlant, ...]) -> list[rs.LinearPlant]:
    """Return the plants r/J/(s - p) with the smallest and the largest pole p, and up to seven between them."""
    by_pole = sorted(plants, key=lambda plant: float(plant.poles[0].real))
    return [by_pole[i] for i in np.unique(np.linspace(0, len(by_pole) - 1, 9).astype(int))]


def braking(vehicle: rs.Vehicle, controller: PIController, held: rs.ReferenceSlip, begin: float) -> rs.Simulator:
    """Return the simulator of a stop from 100 km/h on the true law; the rail turns wet during the stop.

    `begin` is the first torque, N*m. The tracking time of the anti-windup is kp/ki, the integral time of the PI.
    """
    scenario = rs.Scenario(
        name="from-log",
        vehicle=vehicle,
        adhesion=TRUE_LAW,
        initial_speed=INITIAL_SPEED,
        events=(rs.Event(time=RAIN, rail=Rail.WET),),
        disturbances=rs.Disturbances(random_force=RANDOM_SHARE * vehicle.wheel_load),
    )
    limit = vehicle.wheel.radius * vehicle.wheel_load  # torque at an adhesion coefficient of 1, which no rail reaches
    control = rs.linear_control(
        controller,
        reference=held,
        name="pi-lead",
        period=PERIOD,
        torque_min=0.0,
        torque_max=limit,
        tracking_time=controller.gains.kp / controller.gains.ki,
        initial_torque=begin,
    )
    return rs.Simulator(scenario, control)


def main() -> None:
    """Print the steps; with a folder, keep the log, the law's file and pictures."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    result = run(folder)
    fit, held = result.found.chosen.fit, result.held
    print(f"{result.vehicle.name}: {result.found.curve.survey.used} rows under brake, best model {fit.model.name!r}")
    for p in fit.parameters:
        print(f"  {p.name} = {p.value:.4g}, 99 % from {p.interval[0]:.4g} to {p.interval[1]:.4g}")
    print(f"Reference slip: {held.dry:.4g} dry, {held.wet:.4g} wet.")
    poles = [float(plant.poles[0].real) for plant in result.plants]
    print(f"{len(poles)} plants within the uncertainty, slip poles from {min(poles):.3g} to {max(poles):.3g} 1/s.")
    print(f"PI-lead: kp {result.design.kp:.4g} N*m/(m/s), ki {result.design.ki:.4g} N*m/m, Ms <= {MS_MAX:g} at all.")
    print(f"On the true law the worst Ms is {max(m.ms for m in result.true_margins):.4g}.")
    print(
        f"Beyond the peak, at slip {FALLING * held.dry:.2g}, the loop is stable down to {result.slowest_falling:.0f} "
        "km/h, for every law within the uncertainty."
    )
    for run_ in result.runs:
        print(
            f"Seed {run_.seed}: {run_.outcome} after {run_.braking_distance:.1f} m and {run_.braking_time:.2f} s, mean "
            f"slip error {run_.mean_abs_slip_error:.4f}, locked for {run_.locked_fraction * run_.braking_time:.2g} s "
            "after the rail turned wet"
        )
    if folder is not None:
        draw(result, folder)


def draw(result: FromLog, folder: Path) -> None:
    """Draw the fitted models and the stop, and write the law as a file for `--adhesion`."""

    held = replace(result.found, reference=result.held)  # the file has the design's reference slip
    (folder / "model.toml").write_text(rs.model_toml(held), encoding="utf-8")
    plots.save_figure(plots.adhesion_figure((result.found,)), folder / "from_log_adhesion.png")
    plots.save_figure(result.runs[0].plot(), folder / "from_log_stop.png")


if __name__ == "__main__":
    main()
