"""The loop the proof is about, simulated: the derived law acting at once on the plant, without the actuator.

The law is the generated one, its `control` compiled into the loop of `ideal_kernel`. A relay's s chatters within
(one step) * K0 of zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from inspect import signature
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw, published_law
from railslip_ctrl.model.kernels import module_of, module_text, plain
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Rail, Resistance, Vehicle
from railslip_ctrl.sliding.generate import generated_law, law_kernel_text
from railslip_ctrl.sliding.law import LawGains, gain_parameters

from . import ideal_kernel as loop
from .reaching import (
    ADHESION_NOISE,
    TORQUE_DECAY,
    TORQUE_FRACTION,
    TORQUE_FREQUENCY,
    disturbance_function,
    law_parameters,
    lyapunov_function,
    resistance_force,
    true_theta,
)

Floats = NDArray[np.float64]

STEP = 0.002  # s
END_SPEED = 5.0 * KMH  # the stop ends here ([Park2008] p. 56)
RUNS = 8
"""Runs of a simulated condition; seeds follow the one asked for."""

_NOISE_HELD = 0.02  # s, for which a value of the random adhesion force lasts


@dataclass(frozen=True)
class IdealDisturbances:
    """What acts on a run.

    random_share: standard deviation of the random adhesion force over the wheel load, cut at three of them, a value
    lasts 0.02 s; torque: Td = 0.05 Tb exp(-4t) sin(10 pi t); resistance: the vehicle's; slip_noise: standard deviation
    of the noise on the measured slip velocity, m/s, white over the steps.
    """

    random_share: float = 0.0
    torque: bool = False
    resistance: bool = False
    slip_noise: float = 0.0


UNDISTURBED = IdealDisturbances()
PUBLISHED = IdealDisturbances(random_share=ADHESION_NOISE, torque=True, resistance=True)
"""The published run's."""


@dataclass(frozen=True)
class IdealRun:
    """Signals of the runs, arrays (steps, seeds); NaN after the end of a stop.

    time (s, steps only), speed, sigma, s (m/s, s as measured), V (m^2/s^2; NaN without adaptation gains), theta_hat
    (steps, seeds, 2), disturbance: (J/r) d (N*m), torque (N*m); theta: true values at the end, (2,).
    """

    time: Floats
    speed: Floats
    sigma: Floats
    s: Floats
    V: Floats
    theta_hat: Floats
    disturbance: Floats
    torque: Floats
    theta: Floats


def simulate_ideal(
    vehicle: Vehicle,
    gains: LawGains,
    *,
    duration: float,
    nominal: Vehicle | None = None,
    rail: Rail = Rail.DRY,
    disturbances: IdealDisturbances = UNDISTURBED,
    seeds: Sequence[int] = (0,),
    held_speed: float | None = None,
    start_estimate: tuple[float, float] = (0.0, 0.0),
    change: tuple[float, Vehicle] | None = None,
) -> IdealRun:
    """Runs on the bristle model for `duration` seconds, or until 5 km/h.

    The law has the parameters of `nominal` (left out: of `vehicle`). A run starts free rolling at 100 km/h; with
    `held_speed`, m/s, v stays there (v' = 0 for wheel and law) and the run starts at the reference slip, at rest.
    `change`: a time, s, from which on the vehicle is another; V then counts theta_hat against that one's theta.
    DomainError where a run diverges beyond the slip the bristle model holds for.
    """
    law = published_law("bristle", rail, wheel_load=vehicle.wheel_load)
    slip = law.reference_slip(rail)
    assert slip is not None, "the bristle model has a published reference"
    steps = round(duration / STEP)
    vehicles: tuple[Vehicle, ...] = (vehicle, vehicle if change is None else change[1])
    if not disturbances.resistance:
        vehicles = tuple(one.model_copy(update={"resistance": Resistance()}) for one in vehicles)
    plants = np.array([plant_parameters(law, one) for one in vehicles])
    changed = steps if change is None else round(change[0] / STEP)
    speed = held_speed if held_speed is not None else INITIAL_SPEED_KMH * KMH
    limit = law.domain_limit(speed)[0] * speed  # does not move with v
    start = _start(law, plants[0], speed, 0.0 if held_speed is None else slip * speed)
    force, noise = _random(disturbances, seeds, steps)
    force *= vehicle.wheel_load
    rows = np.full((len(seeds), steps, loop.COLUMNS), np.nan)
    kernel = _kernel(type(law))
    settings = kernel.IdealSettings(
        *(STEP, slip, held_speed is not None, END_SPEED, limit),
        *(TORQUE_FRACTION if disturbances.torque else 0.0, TORQUE_DECAY, TORQUE_FREQUENCY),
        # the box is kept by the loop, as the generated step keeps it
        *((-np.inf, np.inf, -np.inf, np.inf) if gains.box is None else map(float, (*gains.box[0], *gains.box[1]))),
    )
    left = kernel.run(
        *(rows, np.array([*start, *start_estimate]), force, noise, plants, changed),
        settings,
        np.array(_law_of(gains, slip, vehicle, nominal or vehicle)),
        np.zeros(1),  # the bristle model is in closed form
    )
    if left != 0.0:
        raise DomainError(
            f"slip velocity: {abs(left):.4g} m/s in the ideal loop is outside the domain of adhesion {law.name!r}, "
            f"{limit:.4g} m/s; give smaller gains"
        )
    return _run(rows, force, disturbances, vehicles, changed, gains, nominal or vehicle)


def _start(law: AdhesionLaw, p: Floats, speed: float, sigma: float) -> tuple[float, float, float]:
    """v, sigma, z at rest there."""
    state = numeric_plant(type(law)).rest_state(speed, sigma, 0.0, 0.0, 0.0, 0.0, p) if sigma else 0.0
    return speed, sigma, float(state)


def _random(disturbances: IdealDisturbances, seeds: Sequence[int], steps: int) -> tuple[Floats, Floats]:
    """Random forces over the wheel load and slip noise, m/s: one row a seed, each with a generator of its own."""
    each = round(_NOISE_HELD / STEP)
    force, noise = np.empty((len(seeds), steps)), np.empty((len(seeds), steps))
    for row, seed in enumerate(seeds):
        generator = np.random.default_rng(seed)
        held = disturbances.random_share * np.clip(generator.standard_normal(steps // each + 1), -3.0, 3.0)
        force[row] = np.repeat(held, each)[:steps]
        noise[row] = disturbances.slip_noise * generator.standard_normal(steps)
    return force, noise


def _law_of(gains: LawGains, slip: float, vehicle: Vehicle, nominal: Vehicle) -> Any:
    """Parameters of the generated law with the numbers of `nominal`, wheel and inertia those of `vehicle`."""
    return law_parameters(
        **gain_parameters(replace(gains, box=None)),
        J=vehicle.effective_inertia,
        r=vehicle.wheel.radius,
        Mn=nominal.effective_mass,
        Bn=nominal.effective_viscous_friction,
        lambda_d=slip,
    )


def _run(
    rows: Floats,
    force: Floats,
    disturbances: IdealDisturbances,
    vehicles: tuple[Vehicle, ...],
    changed: int,
    gains: LawGains,
    nominal: Vehicle,
) -> IdealRun:
    """The signals to the end of the longest stop, with d and V, which the loop does without."""
    length = int(np.max(np.count_nonzero(np.isfinite(rows[:, :, loop.SPEED]), axis=1)))
    signals, random_force = rows[:, :length].transpose(2, 1, 0), force[:, :length].T
    time = np.asarray(STEP * np.arange(length), dtype=np.float64)
    parts = [slice(0, min(changed, length)), slice(min(changed, length), length)]
    d, V = np.empty((2, length, len(rows)))
    adapts = gains.k1 > 0 and gains.k2 > 0
    for part, vehicle in zip(parts, vehicles, strict=True):
        at = signals[:, part]
        theta = true_theta(vehicle, nominal)
        d[part] = _disturbance(vehicle, disturbances, time[part], at[loop.SPEED], at[loop.TORQUE], random_force[part])
        errors = (theta[0] - at[loop.THETA1], theta[1] - at[loop.THETA2])
        V[part] = lyapunov_function()(at[loop.SURFACE], *errors, gains.k1, gains.k2) if adapts else np.nan
    theta_hat = np.stack((signals[loop.THETA1], signals[loop.THETA2]), axis=-1)
    last = true_theta(vehicles[0] if changed >= length else vehicles[1], nominal)
    speed, sigma, s, torque = (signals[one] for one in (loop.SPEED, loop.SIGMA, loop.SURFACE, loop.TORQUE))
    return IdealRun(time, speed, sigma, s, V, theta_hat, d, torque, last)


def _disturbance(
    vehicle: Vehicle, disturbances: IdealDisturbances, time: Floats, speed: Floats, torque: Floats, force: Floats
) -> Floats:
    """(J/r) d, N*m, arrays (steps, seeds)."""
    M, J, r = vehicle.effective_mass, vehicle.effective_inertia, vehicle.wheel.radius
    Fr = resistance_force(vehicle, speed)
    fading = TORQUE_FRACTION * np.exp(-TORQUE_DECAY * time) * np.sin(TORQUE_FREQUENCY * time)
    Td = (fading if disturbances.torque else 0.0 * time)[:, None] * torque
    return np.asarray(disturbance_function()(r * force, Fr, Td, M, J, r) * J / r)


@cache
def _kernel(law: type[AdhesionLaw]) -> ModuleType:
    return module_of(kernel_text(law))


def kernel_text(law: type[AdhesionLaw], *, compiled: bool = True) -> str:
    """The kernel's module: the plant with a law, the generated sliding-mode law, and the loop."""
    # floats: the law, run in the interpreter, counts with them and not with NumPy's
    names = list(signature(generated_law().control).parameters)[:-1]
    arguments = ", ".join(f"float({name})" for name in names)
    joined = f"""
@compiled
def law_control(e, e_integral, omega, Ta, v_rate, theta1_hat, theta2_hat, p):
    return control({arguments}, p)

"""
    own = plain(Path(loop.__file__).read_text("utf-8"))
    return module_text(law, law_kernel_text(), joined, own, compiled=compiled)
