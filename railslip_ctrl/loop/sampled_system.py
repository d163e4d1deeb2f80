"""A discrete controller, a zero-order hold and a continuous plant behind dead time: stability and response, exact.

Between samples the held command is constant, so that the plant seen at the samples is a difference equation
without approximation, also for a dead time that is no multiple of the period ([Astrom1997] 2):

    x[k+1] = Phi x[k] + Gamma0 u[k-d] + Gamma1 u[k-d-1],    y[k] = C x[k],    dead time = (d + fraction) h

The loop is stable if and only if all eigenvalues of this and the controller together lie inside the unit circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from railslip_ctrl.core.arguments import number
from railslip_ctrl.core.errors import InputError

from .rational import Rational
from .realisation import realise

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

# The delay chain has a state a period, and eigenvalues cost the cube of that: at this many a few seconds.
MOST_PERIODS = 500


@dataclass(frozen=True)
class HeldPlant:
    """x[k+1] = (1 + growth) x[k] + gamma0 u[k-periods] + gamma1 u[k-periods-1], y[k] = c x[k]."""

    growth: Floats
    gamma0: Floats
    gamma1: Floats
    c: Floats
    periods: int
    fraction: float
    a: Floats
    b: Floats

    @property
    def chain(self) -> int:
        """Past commands that are states."""
        return self.periods + (1 if np.any(self.gamma1) else 0)


class SampledSystem:
    """The loop of a discrete controller and a sampled continuous plant, unity negative feedback.

    Parameters
    ----------
    controller : python-control or scipy.signal system of that period, `Rational` in z, or a real number
        C, proper; u = C (reference - y) at the samples.
    plant : python-control or scipy.signal system, or `Rational` in s
        P, continuous-time, strictly proper, without dead time.
    dead_time : float
        s, >= 0, between the controller's output and the plant: actuator and computation together.
    period : float
        h, s, > 0.

    Raises
    ------
    InputError
        A system of another kind, a plant that is not strictly proper, or a time out of range.
    """

    def __init__(self, controller: Any, plant: Any, dead_time: float, period: float) -> None:
        check_period(period)
        c = Rational.from_control(controller, "controller", period=period)
        p = Rational.from_control(plant, "plant")
        if not (math.isfinite(dead_time) and dead_time >= 0):
            raise InputError(f"dead time: {dead_time} s is not allowed; give a finite value >= 0")
        if p.relative_degree < 1:
            raise InputError(
                f"sampled plant: {p.zeros.size} zeros and {p.poles.size} poles are not strictly proper; add "
                "the actuator's lag"
            )
        if c.gain == 0:
            raise InputError("sampled loop: a controller with gain 0 closes no loop; give one that is not 0")
        self._controller, self._plant = c, p
        self._dead_time, self._period = float(dead_time), float(period)

    @property
    def controller(self) -> Rational:
        """C, in z."""
        return self._controller

    @property
    def plant(self) -> Rational:
        """P, in s, without its dead time."""
        return self._plant

    @property
    def dead_time(self) -> float:
        """Dead time, s, the hold not included."""
        return self._dead_time

    @property
    def period(self) -> float:
        """h, s."""
        return self._period

    @property
    def nyquist_frequency(self) -> float:
        """pi/h, rad/s, where the frequency response ends."""
        return math.pi / self._period

    def scaled(self, factor: float) -> Self:
        """The loop with its gain multiplied by `factor`."""
        return type(self)(self._controller * factor, self._plant, self._dead_time, self._period)

    def delayed(self, extra: float) -> Self:
        """The loop with `extra` seconds more continuous dead time."""
        return type(self)(self._controller, self._plant, self._dead_time + extra, self._period)

    # -- stability ----------------------------------------------------------------------------------------

    @cached_property
    def closed_loop_matrix(self) -> Floats:
        """One sample to the next with reference 0: states of the plant, past commands (latest first), controller.

        Raises InputError with more than 500 periods in the dead time: the matrix would have as many rows.
        """
        if self._dead_time > MOST_PERIODS * self._period:
            raise InputError(
                f"period: {self._period:g} s is not allowed with {self._dead_time:g} s of dead time; give a value >= "
                f"{self._dead_time / MOST_PERIODS:.3g} (s), or use the continuous equivalent"
            )
        held, k = self.held, realise(self._controller)
        n, chain = held.c.size, held.chain
        matrix = np.zeros((n + chain + k.order,) * 2)
        of_x, of_k = slice(0, n), slice(n + chain, None)
        command = np.zeros(matrix.shape[0])
        command[of_x], command[of_k] = -k.d * held.c, k.c
        matrix[of_x, of_x] = held.growth + np.eye(n)
        for gamma, age in ((held.gamma0, held.periods), (held.gamma1, held.periods + 1)):
            if age == 0:
                matrix[of_x] += np.outer(gamma, command)
            elif age <= chain:
                matrix[of_x, n + age - 1] += gamma
        if chain:
            matrix[n] = command
            matrix[n + 1 : n + chain, n : n + chain - 1] = np.eye(chain - 1)
        matrix[of_k, of_x] = -np.outer(k.b, held.c)
        matrix[of_k, of_k] = k.a
        return matrix

    @cached_property
    def closed_loop_poles(self) -> Complexes:
        """Eigenvalues of `closed_loop_matrix`, the plane of z, largest first."""
        poles = np.linalg.eigvals(self.closed_loop_matrix).astype(np.complex128)
        return np.asarray(poles[np.argsort(-np.abs(poles))])

    @property
    def spectral_radius(self) -> float:
        """Size of the largest closed-loop pole; below 1 the loop is stable."""
        return float(np.abs(self.closed_loop_poles[0]))

    def is_stable(self) -> bool:
        """True if every closed-loop pole lies inside the unit circle."""
        return self.spectral_radius < 1

    # -- frequency response -------------------------------------------------------------------------------

    def frequency_response(self, omega: ArrayLike) -> Complexes:
        """L(exp(j omega h)), complex, of the shape of `omega` (rad/s, 0 < omega <= pi/h)."""
        return self.response_and_slope(np.asarray(omega, dtype=float))[0]

    def response_and_slope(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """L(exp(j omega h)) and d ln L/d omega (s), complex, of the shape of `omega` (rad/s, 0 < omega <= pi/h)."""
        z = np.exp(1j * omega * self._period)
        # z - 1 apart from z: a short period puts every feature of the plant next to 1
        plant, plant_slope = self._plant_response(z, np.expm1(1j * omega * self._period))
        k = self._controller
        slope = (1 / (z[..., None] - k.zeros)).sum(axis=-1) - (1 / (z[..., None] - k.poles)).sum(axis=-1) + plant_slope
        return np.asarray(k(z) * plant), np.asarray(1j * self._period * z * slope)

    @cached_property
    def dc_gain(self) -> float:
        """L at frequency 0; infinite with an integrator in controller or plant."""
        if np.any(self._plant.poles == 0) or np.any(self._controller.poles == 1):
            return math.inf
        plant, _ = self._plant_response(np.array([1.0 + 0j]), np.array([0j]))
        return float((self._controller(1.0) * plant[0]).real)

    @cached_property
    def feature_frequencies(self) -> Floats:
        """Sizes of the poles and zeros of plant and controller, those at frequency 0 left out, rad/s."""
        in_z = np.concatenate([self._controller.zeros, self._controller.poles])
        sizes = [self._plant.zeros, self._plant.poles, np.log(in_z[in_z != 0]) / self._period]
        found = np.abs(np.concatenate(sizes))
        return np.asarray(found[found > 0])

    def _plant_response(self, z: Complexes, beyond_one: Complexes) -> tuple[Complexes, Complexes]:
        """Pulse transfer function of held plant and dead time, and its logarithmic derivative with respect to z."""
        held = self.held
        resolvent = beyond_one[..., None, None] * np.eye(held.c.size) - held.growth
        driven = held.gamma0 + held.gamma1 / z[..., None]
        state = np.linalg.solve(resolvent, driven[..., None])[..., 0]
        state_slope = np.linalg.solve(resolvent, (-held.gamma1 / z[..., None] ** 2 - state)[..., None])[..., 0]
        value = state @ held.c
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (state_slope @ held.c) / value - held.periods / z
        return np.asarray(value * z ** -float(held.periods)), np.asarray(slope)

    @cached_property
    def held(self) -> HeldPlant:
        from scipy.linalg import expm

        p, h = realise(self._plant), self._period
        periods = math.floor(self._dead_time / h)
        late = max(0.0, self._dead_time - periods * h)

        def integral(time: float) -> Floats:
            """Integral of exp(a s) over [0, time]."""
            block = np.zeros((2 * p.order, 2 * p.order))
            block[: p.order, : p.order], block[: p.order, p.order :] = p.a * time, np.eye(p.order) * time
            return np.asarray(expm(block)[: p.order, p.order :])

        # the command of a sample acts late into the period, until then the one before it
        remaining = integral(h - late)
        gamma1 = (np.eye(p.order) + p.a @ remaining) @ (integral(late) @ p.b)
        return HeldPlant(p.a @ integral(h), remaining @ p.b, gamma1, p.c, periods, late / h, p.a * h, p.b * h)


def check_period(period: float) -> float:
    """Return a sampling period, s; InputError unless finite and > 0."""
    return number("period", period, "s", gt=0)
