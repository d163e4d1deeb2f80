"""A fine simulation of a slip controller, the brake actuator and the nonlinear wheel, to check predictions by.

Fixed steps that divide the dead time: classical Runge-Kutta for wheel and lag between samples, the command a list that
is read one dead time later. A relay's switch is seen at the next sample, so that instants are good to one step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.kernels import module_of, module_text, plain
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.numeric import adhesion_table, numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Actuator
from railslip_ctrl.sliding.generate import generated_law

from .reaching import law_parameters
from .relay_loop import OMEGA_UNIT_FACTOR, FeedForward, SlidingGains

Floats = NDArray[np.float64]


_State = tuple[float, float, float, float]  # v, sigma, z, acting torque
_Stepped = tuple[float, float, float, float, float]  # and v'

END_SPEED = 5.0 * KMH
"""m/s, where a stop ends ([Park2008] p. 56)."""

_LEAST_CROSSINGS = 3  # upward crossings of a signal that make two periods


class SteppedLaw(Protocol):
    """What the simulation asks for a command."""

    def command(self, v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        """Torque commanded now, N*m, and s, m/s, from speed (m/s), slip velocity (m/s), v' (m/s^2); advances by
        `step`, s."""


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
    """Run from an operating point, held until t = 0 by its own torque, `duration` seconds or until the speed is
    `end_speed`.

    The controller is called once a step, s, which is made smaller so that it divides the dead time. `disturbance`:
    torque at the wheel, N*m, over time, s; adds to the brake's. `offset`: initial slip velocity above the point's, m/s.
    `frozen`: the speed is held; else it falls as it brakes. InputError for a duration or step that is not positive and
    finite; DomainError where the wheel locked or left the adhesion law's domain on either side (or is not a number).
    Slip below 0, a wheel released, is within it.
    """
    if not (math.isfinite(duration) and duration > 0 and math.isfinite(step) and step > 0):
        raise InputError(f"simulation: duration {duration} s and step {step} s; give finite values > 0")
    delay = math.ceil(actuator.dead_time / step - 1e-9)
    h = actuator.dead_time / delay if delay else step
    count = math.ceil(duration / h)
    hold = holding_torque(point) if frozen else point.brake_torque
    advance, load = _stepping(point, actuator, frozen), disturbance or _nothing
    state = (point.speed, point.sigma + offset, point.adhesion_state or 0.0, float(hold))
    *_, v_rate = advance(state, hold, (load(0.0),) * 3, 0.0)
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
        command, surface = controller.command(v, sigma, v_rate, h)
        commands.append(command)
        acting = torque if actuator.lag > 0 else commands[n]
        log[n] = (t, v, sigma, surface, command, acting)
        # the delayed command over the step: both its ends are known if there is a dead time
        now = 0.5 * (commands[n] + commands[n + 1]) if delay else command
        *after, v_rate = advance(state, float(now), (load(t), load(t + 0.5 * h), load(t + h)), h)
        state = (after[0], after[1], after[2], after[3])
    return FineRun(*log.T)


def _nothing(_t: float) -> float:
    return 0.0


@cache
def _kernel(law: type[AdhesionLaw]) -> ModuleType:
    return module_of(kernel_text(law))


def kernel_text(law: type[AdhesionLaw], *, compiled: bool = True) -> str:
    """The step's module for a law."""
    own = Path(__file__).with_name("step_kernel.py").read_text("utf-8")
    return module_text(law, plain(own), compiled=compiled)


def _stepping(point: OperatingPoint, actuator: Actuator, frozen: bool) -> Callable[..., _Stepped]:
    """The step of (state, command, loads, h)."""
    p = np.array(plant_parameters(point.law, point.vehicle))
    table, lag = adhesion_table(point.law, point.vehicle.wheel_load), float(actuator.lag)
    run = _kernel(type(point.law)).run

    def advance(state: _State, command: float, loads: tuple[float, float, float], h: float) -> _Stepped:
        stepped: _Stepped = run(*state, command, *loads, h, lag, frozen, p, table)
        return stepped

    return advance


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


def switch(s: float, layer: float) -> float:
    """sgn(s), or sat(s/layer)."""
    if layer > 0:
        return max(-1.0, min(1.0, s / layer))
    return math.copysign(1.0, s) if s else 0.0


def slip_range(run: FineRun) -> tuple[float, float]:
    """Least and largest slip ratio of a run."""
    slip = run.sigma / run.speed
    return float(slip.min()), float(slip.max())


class PublishedLaw:
    """The generated law with the plant's own parameters, for `simulate_fine`: [Park2008] (45) with (49).

    Holds int e, theta and the adhesion model's state, which starts at the point's. The point's slip is the reference,
    its law the adhesion model; `layer`, m/s, > 0 replaces the relay by K sat(s/layer); `frozen`: the reference is held,
    so that sigma_d' = 0.
    """

    def __init__(
        self,
        point: OperatingPoint,
        gains: SlidingGains,
        *,
        feed_forward: FeedForward = FeedForward.MODEL,
        layer: float = 0.0,
        frozen: bool = True,
    ) -> None:
        self.point, self.frozen, self.feed_forward = point, frozen, feed_forward
        self.integral, self.theta = 0.0, (0.0, 0.0)
        self.z = point.adhesion_state or 0.0
        self._functions, self._p = numeric_plant(type(point.law)), plant_parameters(point.law, point.vehicle)
        M, J, B, r = self._p[:4]
        k2 = OMEGA_UNIT_FACTOR * gains.k
        self._parameters = law_parameters(
            **{"J": J, "r": r, "Mn": M, "Bn": B, "lambda_d": point.slip, "boundary": layer},
            **{"rho": gains.rho, "D": gains.D, "K": gains.K, "k1": gains.k, "k2": k2},
        )

    def command(self, v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        """See `fine_simulation.Controller`."""
        r = self._p[3]
        e, omega = self.point.slip * v - sigma, (v - sigma) / r
        measured = (e, self.integral, omega, r * self._force(v, sigma), 0.0 if self.frozen else v_rate)
        torque, s, *rates = generated_law().control(*measured, *self.theta, self._parameters)
        self.integral += step * e
        self.theta = (self.theta[0] + step * rates[0], self.theta[1] + step * rates[1])
        if self.point.law.has_state and self.feed_forward is FeedForward.MODEL:
            middle = self.z + 0.5 * step * self._z_rate(v, sigma, self.z)
            self.z += step * self._z_rate(v, sigma, middle)
        return torque, s

    def _force(self, v: float, sigma: float) -> float:
        z = self.z
        if self.feed_forward is FeedForward.OFF:
            return self.point.adhesion_force
        if self.feed_forward is FeedForward.REST:
            z = float(self._functions.rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, self._p))
        return float(self._functions.force(v, sigma, z, 0.0, 0.0, 0.0, self._p))

    def _z_rate(self, v: float, sigma: float, z: float) -> float:
        return float(self._functions.rates(v, sigma, z, 0.0, 0.0, 0.0, self._p)[2])
