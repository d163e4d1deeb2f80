"""The verification's simulator, in fixed steps: a law on the nonlinear wheel, behind the brake actuator or without it.

`simulate_ideal` is the loop that the proof is about: the generated law acts at once on the plant. A relay's s chatters
within (one step) * K0 of zero.

`simulate_fine` has dead time and lag, in steps that divide the dead time: the command is a list that is read one dead
time later. A relay's switch is seen at the next sample, so that instants are good to one step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType

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
from .relay_loop import OMEGA_UNIT_FACTOR, SlidingGains

END_SPEED = 5.0 * KMH  #: m/s, where a stop ends ([Park2008] p. 56)
STEP = 0.002  # s, without an actuator
RUNS = 8  #: runs of a simulated condition; seeds follow the one asked for
_NOISE_HELD = 0.02  # s, for which a value of the random adhesion force lasts
_LEAST_CROSSINGS = 3  # upward crossings of a signal that make two periods


@cache
def kernel(law: type[AdhesionLaw]) -> ModuleType:
    """The compiled steps with an adhesion law."""
    return module_of(kernel_text(law))


def kernel_text(law: type[AdhesionLaw], *, compiled: bool = True) -> str:
    """The kernel's module: the plant with a law, the generated sliding-mode law, and the steps."""
    control = read_step(generated_law().control, {"p": PARAMETERS})
    places = Layout((), (), generated_law().Parameters._fields, (), 0)
    # floats: the law, run in the interpreter, counts with them and not with NumPy's
    names = ", ".join(f"float({name})" for name in control.arguments if name != "p")
    joined = f"""
@compiled
def law_control(e, e_integral, omega, Ta, v_rate, theta1_hat, theta2_hat, p):
    return command(p, 0.0, 0.0, 0.0, 0.0, p, p, {names})

"""
    own = plain(Path(layout.__file__).read_text("utf-8"))
    return module_text(law, functions_text(control, places), joined, own, compiled=compiled)


# --- without an actuator ----------------------------------------------------------------------------------------------


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
    disturbed: bool = False,
    slip_noise: float = 0.0,
    seeds: Sequence[int] = (0,),
    held_speed: float | None = None,
    change: tuple[float, Vehicle] | None = None,
) -> IdealRun:
    """Runs on the bristle model, dry rail, for `duration` seconds, or until 5 km/h.

    The law has the parameters of `nominal` (left out: of `vehicle`). A run starts free rolling at 100 km/h; with
    `held_speed`, m/s, v stays there (v' = 0 for wheel and law) and the run starts at the reference slip, at rest.
    `disturbed`: by the published random adhesion force, cut at three standard deviations, a value lasting 0.02 s, by
    Td = 0.05 Tb exp(-4t) sin(10 pi t) and the vehicle's resistance; `slip_noise`: standard deviation of the measured
    slip velocity, m/s, white over the steps; `seeds`: of both, a run each.
    `change`: a time, s, from which on the vehicle is another; V then counts theta_hat against that one's theta.
    DomainError where a run diverges beyond the slip the bristle model holds for.
    """
    law = published_law("bristle", Rail.DRY, wheel_load=vehicle.wheel_load)
    slip = reaching.reference_slip()
    steps = round(duration / STEP)
    vehicles: tuple[Vehicle, ...] = (vehicle, vehicle if change is None else change[1])
    if not disturbed:
        vehicles = tuple(one.model_copy(update={"resistance": Resistance()}) for one in vehicles)
    plants = np.array([plant_parameters(law, one) for one in vehicles])
    changed = steps if change is None else round(change[0] / STEP)
    speed = held_speed if held_speed is not None else INITIAL_SPEED_KMH * KMH
    limit = law.domain_limit(speed)[0] * speed  # does not move with v
    sigma, z = 0.0, 0.0
    if held_speed is not None:
        sigma = slip * speed
        z = float(numeric_plant(type(law)).rest_state(speed, sigma, 0.0, 0.0, 0.0, 0.0, plants[0]))
    force, noise = _random(seeds, steps)
    force *= vehicle.wheel_load * disturbed
    noise *= slip_noise
    rows = np.full((len(seeds), steps, layout.COLUMNS), np.nan)
    settings = kernel(type(law)).IdealSettings(
        *(STEP, slip, held_speed is not None, END_SPEED, limit),
        *(reaching.TORQUE_FRACTION * disturbed, reaching.TORQUE_DECAY, reaching.TORQUE_FREQUENCY),
        # the box is kept by the loop, as the generated step keeps it
        *((-np.inf, np.inf, -np.inf, np.inf) if gains.box is None else map(float, (*gains.box[0], *gains.box[1]))),
    )
    parameters = reaching.law_parameters(
        **gain_parameters(replace(gains, box=None)),
        J=vehicle.effective_inertia,
        r=vehicle.wheel.radius,
        Mn=(nominal or vehicle).effective_mass,
        Bn=(nominal or vehicle).effective_viscous_friction,
        lambda_d=slip,
    )
    left = kernel(type(law)).run(
        *(rows, np.array([speed, sigma, z]), force, noise, plants, changed),
        settings,
        np.array(parameters),
        np.zeros(1),  # the bristle model is in closed form
    )
    if left != 0.0:
        raise DomainError(
            f"slip velocity: {abs(left):.4g} m/s in the ideal loop is outside the domain of adhesion {law.name!r}, "
            f"{limit:.4g} m/s; give smaller gains"
        )
    return _run(rows, force, disturbed, vehicles, changed, gains, nominal or vehicle)


def _random(seeds: Sequence[int], steps: int) -> tuple[Floats, Floats]:
    """Random forces over the wheel load, and noise of variance 1: one row a seed, each with a generator of its own."""
    each = round(_NOISE_HELD / STEP)
    force, noise = np.empty((len(seeds), steps)), np.empty((len(seeds), steps))
    for row, seed in enumerate(seeds):
        generator = np.random.default_rng(seed)
        held = reaching.ADHESION_NOISE * np.clip(generator.standard_normal(steps // each + 1), -3.0, 3.0)
        force[row] = np.repeat(held, each)[:steps]
        noise[row] = generator.standard_normal(steps)
    return force, noise


def _run(
    rows: Floats,
    force: Floats,
    disturbed: bool,
    vehicles: tuple[Vehicle, ...],
    changed: int,
    gains: LawGains,
    nominal: Vehicle,
) -> IdealRun:
    """The signals to the end of the longest stop, with d and V, which the loop does without."""
    length = int(np.max(np.count_nonzero(np.isfinite(rows[:, :, layout.SPEED]), axis=1)))
    speed, sigma, s, theta1, theta2, torque = rows[:, :length].transpose(2, 1, 0)
    time = np.asarray(STEP * np.arange(length), dtype=np.float64)
    Td = (reaching.torque_share(time) if disturbed else 0.0 * time)[:, None] * torque
    d, V = np.empty((2, length, len(rows)))
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
    return IdealRun(time, speed, sigma, s, V, np.stack((theta1, theta2), axis=-1), d, torque, theta)


# --- behind the actuator ----------------------------------------------------------------------------------------------


SteppedLaw = Callable[[float, float, float, float], tuple[float, float]]
"""Torque commanded now, N*m, and s, m/s, of speed, slip velocity (m/s), v' (m/s^2) and the step (s) to advance by."""


@dataclass(frozen=True)
class FineRun:
    """Signals of a run, arrays of one shape: s, m/s, m/s, m/s, N*m (commanded), N*m (acting)."""

    time: Floats
    speed: Floats
    sigma: Floats
    surface: Floats
    command: Floats
    torque: Floats

    def after(self, start: float) -> FineRun:
        """The part from a time, s, on."""
        kept = self.time >= start
        return FineRun(*(getattr(self, name)[kept] for name in self.__dataclass_fields__))


def holding_torque(point: OperatingPoint) -> float:
    """Torque, N*m, at which sigma' = 0 with the speed frozen; `point.brake_torque` has lambda' = 0 instead."""
    p = plant_parameters(point.law, point.vehicle)
    state = (point.speed, point.sigma, point.adhesion_state or 0.0, point.brake_torque)
    sigma_rate = float(numeric_plant(type(point.law)).rates(*state, 0.0, 0.0, p)[1])
    return point.brake_torque - sigma_rate * point.vehicle.effective_inertia / point.vehicle.wheel.radius


def slip_velocity_limit(law: AdhesionLaw, speed: float) -> float:
    """Slip velocity, m/s, at which the wheel locks or the adhesion law's domain ends; both signs."""
    return min(1.0, law.domain_limit(speed)[0]) * speed


def simulate_fine(
    point: OperatingPoint,
    controller: SteppedLaw,
    actuator: Actuator,
    *,
    duration: float,
    step: float = 1e-3,
    disturbance: Callable[[float], float] | None = None,
    offset: float = 0.0,
    frozen: bool = True,
    end_speed: float = 0.0,
) -> FineRun:
    """Run from an operating point, held until t = 0 by its own torque, `duration` s or until the speed is `end_speed`.

    The controller is called once a step, s, which is made smaller so that it divides the dead time. `disturbance`:
    torque at the wheel, N*m, over time, s; adds to the brake's. `offset`: initial slip velocity above the point's, m/s.
    `frozen`: the speed is held. DomainError where the wheel locked or left the adhesion law's domain on either side.
    """
    delay = math.ceil(actuator.dead_time / step - 1e-9)
    h = actuator.dead_time / delay if delay else step
    count = math.ceil(duration / h)
    hold = holding_torque(point) if frozen else point.brake_torque
    load = disturbance or (lambda t: 0.0)
    fixed = (float(actuator.lag), frozen, np.array(plant_parameters(point.law, point.vehicle)))
    advance, table = kernel(type(point.law)).advance, adhesion_table(point.law, point.vehicle.wheel_load)
    state = [point.speed, point.sigma + offset, point.adhesion_state or 0.0, float(hold)]
    *_, v_rate = advance(*state, hold, *(load(0.0),) * 3, 0.0, *fixed, table)
    log = np.empty((count, 6))
    commands = [hold] * delay
    for n in range(count):
        t = n * h
        v, sigma, _, torque = state
        if v <= end_speed:
            return FineRun(*log[:n].T)
        limit = slip_velocity_limit(point.law, v)
        if not -limit < sigma < limit:
            raise DomainError(
                f"simulation: the wheel is lost at {t:.3f} s and {v / KMH:.4g} km/h: slip velocity {sigma:.4g} m/s is "
                f"outside +-{limit:.4g} m/s"
            )
        command, surface = controller(v, sigma, v_rate, h)
        commands.append(command)
        acting = torque if actuator.lag > 0 else commands[n]
        log[n] = (t, v, sigma, surface, command, acting)
        # the delayed command over the step: both its ends are known if there is a dead time
        now = 0.5 * (commands[n] + commands[n + 1]) if delay else command
        *state, v_rate = advance(*state, float(now), load(t), load(t + 0.5 * h), load(t + h), h, *fixed, table)
    return FineRun(*log.T)


def whole_periods(run: FineRun) -> tuple[float, FineRun]:
    """Period of s, s, and the part of a run from its first to its last upward crossing of zero.

    DomainError where s does not cross zero upwards at least three times.
    """
    s = run.surface
    up = np.flatnonzero((s[:-1] <= 0) & (s[1:] > 0))
    if up.size < _LEAST_CROSSINGS:
        raise DomainError(f"oscillation: s crosses zero {up.size} times upwards; simulate longer, or it does not cycle")
    ends = up[[0, -1]]
    instants = run.time[ends] - s[ends] / (s[ends + 1] - s[ends]) * (run.time[ends + 1] - run.time[ends])
    period = float((instants[1] - instants[0]) / (up.size - 1))
    return period, FineRun(*(getattr(run, name)[up[0] : up[-1]] for name in run.__dataclass_fields__))


def slip_range(run: FineRun) -> tuple[float, float]:
    """Least and largest slip ratio of a run."""
    slip = run.sigma / run.speed
    return float(slip.min()), float(slip.max())


@dataclass(frozen=True)
class HeldRun:
    """Whether a run held the wheel: the slip's range, the time, s, at the end; NaN where the wheel is `lost`, and how.

    `held`: the slip stayed between 0 and twice the reference, to the end asked for, at which the run `ended`.
    """

    slip_range: tuple[float, float]
    time: float
    held: bool
    lost: str | None = None
    ended: bool = True


def held_run(simulated: Callable[[], FineRun], reference: float, *, before: float = math.inf) -> HeldRun:
    """How a simulation went about a reference slip ratio; it has not ended where it goes on to `before`, s."""
    try:
        run = simulated()
    except DomainError as error:
        return HeldRun((math.nan, math.nan), math.nan, False, str(error), ended=False)
    (low, high), end = slip_range(run), float(run.time[-1])
    return HeldRun((low, high), end, end < before and low > 0.0 and high < 2.0 * reference, ended=end < before)


class PublishedLaw:
    """The generated law with the plant's own parameters, for `simulate_fine`: [Park2008] (45) with (49).

    Holds int e, theta and the adhesion model's state, which starts at the point's. The point's slip is the reference,
    its law the adhesion model; `frozen`: the reference is held, so that sigma_d' = 0.
    """

    def __init__(self, point: OperatingPoint, gains: SlidingGains, *, frozen: bool = True) -> None:
        self.point, self.frozen = point, frozen
        self.integral, self.theta = 0.0, (0.0, 0.0)
        self.z = point.adhesion_state or 0.0
        self._functions, self._p = numeric_plant(type(point.law)), plant_parameters(point.law, point.vehicle)
        M, J, B, r = self._p[:4]
        k2 = OMEGA_UNIT_FACTOR * gains.k
        self._parameters = reaching.law_parameters(
            **{"J": J, "r": r, "Mn": M, "Bn": B, "lambda_d": point.slip},
            **{"rho": gains.rho, "D": gains.D, "K": gains.K, "k1": gains.k, "k2": k2},
        )

    def __call__(self, v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        """See `SteppedLaw`."""
        r = self._p[3]
        e, omega = self.point.slip * v - sigma, (v - sigma) / r
        Ta = r * float(self._functions.force(v, sigma, self.z, 0.0, 0.0, 0.0, self._p))
        measured = (e, self.integral, omega, Ta, 0.0 if self.frozen else v_rate)
        torque, s, *rates = generated_law().control(*measured, *self.theta, self._parameters)
        self.integral += step * e
        self.theta = (self.theta[0] + step * rates[0], self.theta[1] + step * rates[1])
        if self.point.law.has_state:
            middle = self.z + 0.5 * step * self._z_rate(v, sigma, self.z)
            self.z += step * self._z_rate(v, sigma, middle)
        return torque, s

    def _z_rate(self, v: float, sigma: float, z: float) -> float:
        return float(self._functions.rates(v, sigma, z, 0.0, 0.0, 0.0, self._p)[2])
