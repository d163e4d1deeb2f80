"""A small brake rig for the tests of identification: torque ramp, wheel and train, release past half slip."""

import functools
from pathlib import Path

import numpy as np
import pytest

from railslip_ctrl.identification.curves import Options, curve_of
from railslip_ctrl.identification.identify import Identification, identify_curve
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.numeric import numeric_plant
from railslip_ctrl.model.vehicle import PARK2008, Rail

BEAM = published_law("beam", Rail.DRY)
HEADER = "time [s],train speed [km/h],wheel angular speed [rad/s],brake torque [kN*m]"


def rig_rows(law, *, runs=6, initial_speed=100 / 3.6, force_noise=431.0, interval=0.01, seed=0, loads=(1.0,)) -> Rows:
    """A log of `runs` runs, simulated side by side.

    Equations (3) and (4) without travelling resistance, by Heun's method in five steps an interval; the random force
    (N) is white, held for an interval, and the pickup of the wheel's speed has white noise, 0.01 rad/s. `loads` are
    those of the runs, one after the other and again from the first, by the published; more than one are logged.
    """
    generator, steps = np.random.default_rng(seed), 5
    wheel, h = PARK2008.wheel, interval / 5
    load = PARK2008.wheel_load * np.resize(loads, runs)
    force, p = numeric_plant(type(law)).force, (1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, load, *law.parameters())
    v = np.full(runs, initial_speed)
    omega, released = v / wheel.radius, np.zeros(runs, dtype=bool)
    samples = round(9.0 / interval)
    record = np.empty((3, samples, runs))

    def rates(v, omega, torque, noise):
        sigma = np.maximum(v - wheel.radius * omega, 0.0)
        adhesion = force(v, sigma, 0.0, 0.0, 0.0, 0.0, p) + noise * (sigma > 0.01)
        turning = (wheel.radius * adhesion - torque - wheel.viscous_friction * omega) / wheel.inertia
        return -adhesion / PARK2008.mass, turning

    for i in range(samples):
        torque = np.where(released, 0.0, 1200.0 * max(i * interval - 0.5, 0.0))
        record[:, i] = v, omega, torque
        noise = force_noise * generator.standard_normal(runs)
        for j in range(steps):
            torque = np.where(released, 0.0, 1200.0 * max(i * interval + (j + 0.5) * h - 0.5, 0.0))
            first = rates(v, omega, torque, noise)
            second = rates(v + h * first[0], omega + h * first[1], torque, noise)
            v = v + h / 2 * (first[0] + second[0])
            omega = np.minimum(omega + h / 2 * (first[1] + second[1]), v / wheel.radius)  # it only brakes
        released |= 1.0 - wheel.radius * omega / v > 0.5
    record[1] += 0.01 * generator.standard_normal(record[1].shape)
    names = ("train_speed", "wheel_angular_speed", "brake_torque")
    columns = dict(zip(names, record.transpose(0, 2, 1).reshape(3, -1), strict=True))
    logged = {} if len(loads) == 1 else {"wheel_load": np.repeat(load, samples)}
    count = samples * runs
    return Rows(np.arange(count) + 2, {"time": np.arange(count) * interval, **columns, **logged})


@functools.cache
def two_runs() -> Rows:
    """Two runs on a rig with the published beam, made once; not to be changed in place."""
    return rig_rows(BEAM, runs=2, seed=3)


def changed(rows: Rows, **columns: np.ndarray) -> Rows:
    return Rows(rows.line, {**rows.columns, **columns})


def identified(rows: Rows, model: str = "beam", **options: object) -> Identification:
    chosen = Options(model=model, **options)  # type: ignore[arg-type]
    return identify_curve(curve_of(rows, PARK2008, chosen), PARK2008, chosen)


@functools.cache
def found_in(model: str = "beam", **options: object) -> Identification:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("railslip_ctrl.identification.identify.lag_of", lambda *_, **__: None)
        return identified(two_runs(), model, **options)


def write_log(path: Path, rows: Rows) -> Path:
    c = rows.columns
    table = np.column_stack([c["time"], 3.6 * c["train_speed"], c["wheel_angular_speed"], 1e-3 * c["brake_torque"]])
    np.savetxt(path, table, delimiter=",", header=HEADER, comments="", fmt="%.9g")
    return path
