"""Fixed-step simulator of the verification: the generated law on the nonlinear wheel, with exact Ta and v'.

A switch of the relay takes effect at the next step, so that s oscillates about 0 by up to (r/J) K times one step.
Braking runs (`simulation`) use another kernel, in which the law is sampled as in a brake and uses the steady-state
adhesion. The proof does not cover these runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from railslip_ctrl.controllers.translate import PARAMETERS, Layout, read_step
from railslip_ctrl.controllers.translate import kernel_text as functions_text
from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw, published_law
from railslip_ctrl.model.kernels import module_of, module_text, plain
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.numeric import adhesion_table, numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Actuator, Rail, Resistance, Vehicle
from railslip_ctrl.sliding.generate import generated_law
from railslip_ctrl.sliding.law import LawGains, gain_parameters
from railslip_ctrl.verification import reaching

from . import fixed_step_kernel as layout

END_SPEED = 5.0 * KMH  #: speed at which a stop ends, m/s ([Park2008] p. 56)
STEP = 0.002  # s; with a dead time, the largest step up to this value of which the dead time is a multiple
RUNS = 8  #: runs of a simulated condition, with consecutive seeds
_NONE = Actuator(dead_time=0.0, lag=0.0)  # ideal actuator
_NOISE_INTERVAL = 0.02  # s, over which the random adhesion force is constant


@cache
def kernel(law: type[AdhesionLaw]) -> ModuleType:
    """Compile the plant with an adhesion law, the generated sliding-mode law, and `fixed_step_kernel` as one module."""
    control = read_step(generated_law().control, {"p": PARAMETERS})
    places = Layout((), (), generated_law().Parameters._fields, (), 0)
    # float() makes the law use Python floats instead of NumPy's when the kernel is interpreted
    names = ", ".join(f"float({name})" for name in control.arguments if name != "p")
    joined = f"""
@compiled
def law_control(e, e_integral, omega, Ta, v_rate, theta1_hat, theta2_hat, p):
    return command(p, 0.0, 0.0, 0.0, 0.0, p, p, {names})

"""
    own = plain(Path(layout.__file__).read_text("utf-8"))
    return module_of(module_text(law, functions_text(control, places), joined, own))


@dataclass(frozen=True)
class FixedRun:
    """Signals of simulated runs, (steps, runs), NaN after the end of a stop; `time` is (steps,).

    `time` is in s, `speed` and `sigma` in m/s, and the acting `torque` in N*m. `s` is the sliding variable, m/s,
    computed from the measured signals.
    """

    time: Floats
    speed: Floats
    sigma: Floats
    s: Floats
    torque: Floats


def _rows(
    law: AdhesionLaw,
    vehicles: Sequence[Vehicle],
    gains: LawGains,
    start: Sequence[float],
    forces: tuple[Floats, Floats],
    *,
    reference: float,
    nominal: Vehicle,
    changed: int | None = None,
    actuator: Actuator = _NONE,
    disturbed: bool = False,
    frozen: bool = False,
    largest_slip: float = math.inf,
) -> tuple[Floats, float]:
    """Simulate runs; return the signals (columns, steps, runs) and the step size, s."""
    force, noise = forces
    delay = math.ceil(actuator.dead_time / STEP - 1e-9)
    step = actuator.dead_time / delay if delay else STEP
    limit = law.domain_limit(start[0])[0] * start[0]  # m/s, independent of v
    rows = np.full((*force.shape, layout.COLUMNS), np.nan)
    settings = kernel(type(law)).Settings(
        *(step, delay, float(actuator.lag), reference, frozen, END_SPEED, limit, largest_slip),
        *(reaching.TORQUE_FRACTION * disturbed, reaching.TORQUE_DECAY, reaching.TORQUE_FREQUENCY),
        # the kernel's loop limits theta_hat to the box, as the generated step does
        *((-np.inf, np.inf, -np.inf, np.inf) if gains.box is None else map(float, (*gains.box[0], *gains.box[1]))),
    )
    parameters = reaching.law_parameters(
        **gain_parameters(replace(gains, box=None)),
        **{"J": vehicles[0].effective_inertia, "r": vehicles[0].wheel.radius, "lambda_d": reference},
        **{"Mn": nominal.effective_mass, "Bn": nominal.effective_viscous_friction},
    )
    plants = np.array([plant_parameters(law, one) for one in (vehicles[0], vehicles[-1])])
    lost = kernel(type(law)).run(
        *(rows, np.array(start, dtype=float), force, noise, plants, rows.shape[1] if changed is None else changed),
        settings,
        np.array(parameters),
        adhesion_table(law, vehicles[0].wheel_load),
    )
    if lost >= 0:
        last = int(np.count_nonzero(np.isfinite(rows[lost, :, layout.SPEED]))) - 1
        v, sigma = rows[lost, last, : layout.SURFACE]
        raise DomainError(
            f"simulation: at {last * step:.3f} s and {v / KMH:.4g} km/h the wheel locks or leaves the law's domain: "
            f"slip velocity {sigma:.4g} m/s is outside +-{min(limit, largest_slip * v):.4g} m/s; give smaller gains"
        )
    return rows.transpose(2, 1, 0), step


@dataclass(frozen=True)
class IdealRun(FixedRun):
    """Signals of runs without actuator.

    V: Lyapunov function, m^2/s^2, NaN without adaptation gains; theta_hat: estimates, (steps, seeds, 2); disturbance:
    contribution of Tr, Fr and Td to s', times J/r, N*m; theta: true values of the estimates at the end, (2,).
    """

    V: Floats
    theta_hat: Floats
    disturbance: Floats
    theta: Floats


def simulate_ideal(
    vehicle: Vehicle,
    gains: LawGains,
    *,
    duration: float,
    nominal: Vehicle | None = None,
    disturbed: bool = False,
    slip_noise: float = 0.0,
    seeds: Sequence[int] = (0,),
    constant_speed: float | None = None,
    change: tuple[float, Vehicle] | None = None,
) -> IdealRun:
    """Simulate the law without actuator on the bristle model, dry rail, for `duration`, s, or until 5 km/h.

    - nominal: vehicle whose parameters the law uses; by default `vehicle`.
    - constant_speed: m/s; if not None, v is constant for wheel and law, and the run starts at the reference slip with
      steady-state adhesion. By default the run starts free rolling at 100 km/h.
    - disturbed: True adds the published random adhesion force (limited to three standard deviations, constant over
      0.02 s), Td = 0.05 Tb exp(-4t) sin(10 pi t), and the vehicle's resistance.
    - slip_noise: standard deviation of the noise of the slip velocity, m/s, independent in each step.
    - seeds: seeds of random force and noise, one for each run.
    - change: time, s, and the vehicle from this time on.

    DomainError if a run leaves the domain of the bristle model.
    """
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    slip, steps = reaching.reference_slip(), round(duration / STEP)
    vehicles, nominal = [vehicle, vehicle if change is None else change[1]], nominal or vehicle
    if not disturbed:
        vehicles = [one.model_copy(update={"resistance": Resistance()}) for one in vehicles]
    changed = steps if change is None else round(change[0] / STEP)
    start = [INITIAL_SPEED_KMH * KMH, 0.0, 0.0, 0.0]
    if constant_speed is not None:
        at_rest = (constant_speed, slip * constant_speed, 0.0, 0.0, 0.0, 0.0, plant_parameters(law, vehicle))
        start = [*at_rest[:2], float(numeric_plant(type(law)).rest_state(*at_rest)), 0.0]
    force, noise = _random(seeds, steps)
    force *= vehicle.wheel_load * disturbed
    known: dict[str, Any] = {"reference": slip, "nominal": nominal, "frozen": constant_speed is not None}
    rows, _ = _rows(
        *(law, vehicles, gains, start, (force, slip_noise * noise)), **known, changed=changed, disturbed=disturbed
    )
    # up to the end of the longest stop; d and V are computed here, not in the kernel
    length = int(np.max(np.count_nonzero(np.isfinite(rows[layout.SPEED]), axis=0)))
    speed, sigma, s, theta1, theta2, torque = rows[:, :length]
    time = np.asarray(STEP * np.arange(length), dtype=np.float64)
    Td = (reaching.torque_share(time) if disturbed else 0.0 * time)[:, None] * torque
    d, V = np.empty((2, *speed.shape))
    adapts = gains.k1 > 0 and gains.k2 > 0
    parts = (slice(0, min(changed, length)), slice(min(changed, length), length))
    for part, vehicle in zip(parts, vehicles, strict=True):
        M, J, r = vehicle.effective_mass, vehicle.effective_inertia, vehicle.wheel.radius
        acting = (r * force[:, :length].T[part], vehicle.resistance.force(speed[part]), Td[part])
        d[part] = reaching.derived("Tr Fr Td M J r", "disturbance")(*acting, M, J, r) * J / r
        theta = reaching.true_theta(vehicle, nominal)
        errors = (theta[0] - theta1[part], theta[1] - theta2[part])
        lyapunov = reaching.derived("s theta1_tilde theta2_tilde k1 k2", "V_matrix")
        V[part] = lyapunov(s[part], *errors, gains.k1, gains.k2) if adapts else np.nan
    theta = reaching.true_theta(vehicles[0] if changed >= length else vehicles[1], nominal)
    return IdealRun(time, speed, sigma, s, torque, V, np.stack((theta1, theta2), axis=-1), d, theta)


def _random(seeds: Sequence[int], steps: int) -> tuple[Floats, Floats]:
    each = round(_NOISE_INTERVAL / STEP)
    force, noise = np.empty((len(seeds), steps)), np.empty((len(seeds), steps))
    for row, seed in enumerate(seeds):
        generator = np.random.default_rng(seed)
        values = reaching.ADHESION_NOISE * np.clip(generator.standard_normal(steps // each + 1), -3.0, 3.0)
        force[row] = np.repeat(values, each)[:steps]
        noise[row] = generator.standard_normal(steps)
    return force, noise


def simulate_behind(
    point: OperatingPoint, gains: LawGains, actuator: Actuator, *, duration: float, offset: float, frozen: bool
) -> FixedRun:
    """Simulate an undisturbed run with actuator from an operating point; the signals are 1-D.

    The reference is the point's slip, and the law's parameters are exact. Before t = 0 the torque is that of the point.

    - duration: s; the run ends earlier at 5 km/h.
    - offset: initial slip velocity minus that of the point, m/s.
    - frozen: True keeps the speed constant for wheel and law.

    DomainError if the wheel locks, or if the slip velocity, which may be negative, leaves the adhesion law's domain.
    """
    state = (point.speed, point.sigma, point.adhesion_state or 0.0)
    hold = point.brake_torque
    if frozen:  # the slip ratio is constant if sigma' = 0
        p = plant_parameters(point.law, point.vehicle)
        rate = float(numeric_plant(type(point.law)).rates(*state, hold, 0.0, 0.0, p)[1])
        hold -= rate * point.vehicle.effective_inertia / point.vehicle.wheel.radius
    still = np.zeros((1, math.ceil(duration / STEP)))
    known: dict[str, Any] = {"reference": point.slip, "nominal": point.vehicle, "actuator": actuator, "frozen": frozen}
    known["largest_slip"] = 1.0
    start = (state[0], state[1] + offset, state[2], float(hold))
    rows, step = _rows(point.law, (point.vehicle,), gains, start, (still, still), **known)
    speed, sigma, s, _, _, torque = rows[:, np.isfinite(rows[layout.SPEED, :, 0]), 0]
    return FixedRun(np.asarray(step * np.arange(speed.size), dtype=float), speed, sigma, s, torque)
