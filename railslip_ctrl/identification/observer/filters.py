"""The adhesion-torque observer on samples, as printed and corrected: [Park2008] (27), (28), Fig. 11.

Between samples torque and speed are taken to run straight, and the first-order filter is solved exactly for that,
whatever the intervals: with h the interval, q = h/tau and u = B omega + Tb,

    y[k] = exp(-q) y[k-1] + (1 - exp(-q)) J (omega[k] - omega[k-1])/h + w0 u[k-1] + w1 u[k],
    w1 = 1 - (1 - exp(-q))/q,  w0 = 1 - exp(-q) - w1,

is the corrected estimate. As printed u is not filtered: w0 = w1 = 0, and Ta_hat = y + u.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.model.vehicle import Vehicle

from .forms import SampledForm
from .recursion import linear_recursion
from .samples import Complexes, Estimates, Floats, checked_samples, checked_step, require


class Form(StrEnum):
    """PRINTED filters J omega' alone (27); CORRECTED filters every term, so that Ta_hat = Ta/(tau s + 1)."""

    PRINTED = "printed"
    CORRECTED = "corrected"


@dataclass(frozen=True)
class FilterState:
    """After a sample: `time` (s), `torque` (N*m), speed `omega` (rad/s); `filtered` (N*m) is what the filter holds."""

    time: float
    torque: float
    omega: float
    filtered: float


@dataclass(frozen=True)
class FilterObserver:
    """Ta_hat from the measured brake torque (N*m) and the wheel's angular speed (rad/s).

    Td is not known to it: the corrected estimate is (Ta + Tr - Td)/(tau s + 1).

    Parameters
    ----------
    inertia, viscous_friction : float
        Effective J (kg m^2, > 0) and B (N m s, >= 0) of the wheel.
    time_constant : float
        tau of the filter, s, > 0.
    form : Form
        Corrected unless asked otherwise.

    Raises
    ------
    InputError
        A number out of range; in `start`, `step` and `run` a sample that is not finite, or not after the one before.
    """

    inertia: float
    viscous_friction: float
    time_constant: float
    form: Form = Form.CORRECTED

    def __post_init__(self) -> None:
        require("inertia", self.inertia, "kg*m^2")
        require("viscous_friction", self.viscous_friction, "N*m*s", zero_allowed=True)
        require("time_constant", self.time_constant, "s")

    @classmethod
    def of(cls, vehicle: Vehicle, time_constant: float, form: Form = Form.CORRECTED) -> Self:
        """The observer of a vehicle's wheel, with its inertia scale."""
        return cls(vehicle.effective_inertia, vehicle.effective_viscous_friction, time_constant, form)

    def transfers(self, s: ArrayLike) -> tuple[Complexes, Complexes]:
        """From measured torque (1) and measured speed (N*m*s) to Ta_hat, at complex s (rad/s)."""
        point = np.asarray(s, dtype=complex)
        low = np.asarray(1 / (self.time_constant * point + 1), dtype=complex)
        if self.form is Form.PRINTED:
            return np.ones_like(low), np.asarray(self.inertia * point * low + self.viscous_friction)
        return low, np.asarray((self.inertia * point + self.viscous_friction) * low)

    def sampled(self, interval: float) -> SampledForm:
        """The recursion at a constant interval, s."""
        require("interval", interval, "s")
        q = interval / self.time_constant
        share = -math.expm1(-q)
        rate, B = share * self.inertia / interval, self.viscous_friction
        transition, output = np.array([[1 - share]]), np.eye(1)
        if self.form is Form.PRINTED:
            return SampledForm(
                transition, np.array([[0.0, -rate]]), np.array([[0.0, rate]]), output, np.array([1.0, B]), interval
            )
        w1 = 1 - share / q
        w0 = share - w1
        return SampledForm(
            transition, np.array([[w0, w0 * B - rate]]), np.array([[w1, w1 * B + rate]]), output, np.zeros(2), interval
        )

    def start(self, time: float, torque: float, omega: float) -> tuple[float, FilterState]:
        """The first sample: the wheel is taken to turn steadily, so that Ta_hat = B omega + Tb.

        `time` in s, `torque` in N*m, `omega` in rad/s.
        """
        checked_samples([time], [torque], [omega], after=None)
        steady = self.viscous_friction * omega + torque
        return steady, FilterState(time, torque, omega, steady if self.form is Form.CORRECTED else 0.0)

    def step(self, state: FilterState, time: float, torque: float, omega: float) -> tuple[float, FilterState]:
        """Ta_hat (N*m) after a sample, and the `state` after it; pure.

        `time` in s, `torque` in N*m, `omega` in rad/s.
        """
        h = checked_step(time, torque, omega, after=state.time)
        q = h / self.time_constant
        share = -math.expm1(-q)
        now, before = (self.viscous_friction * w + tb for w, tb in ((omega, torque), (state.omega, state.torque)))
        filtered = (1 - share) * state.filtered + share * self.inertia * (omega - state.omega) / h
        if self.form is Form.PRINTED:
            return filtered + now, FilterState(time, torque, omega, filtered)
        w1 = 1 - share / q
        filtered += (share - w1) * before + w1 * now
        return filtered, FilterState(time, torque, omega, filtered)

    def run(
        self, time: ArrayLike, torque: ArrayLike, omega: ArrayLike, state: FilterState | None = None
    ) -> Estimates[FilterState]:
        """`step` over columns of samples (s, N*m, rad/s), regular or not; from `start` without a state.

        Chunks of a long log give the same estimates as the log in one piece, each run from the state before it.
        """
        t, tb, w = checked_samples(time, torque, omega, after=None if state is None else state.time)
        if state is None:
            first, state = self.start(float(t[0]), float(tb[0]), float(w[0]))
            rest = self._after(state, t[1:], tb[1:], w[1:])
            return Estimates(np.concatenate([[first], rest.adhesion_torque]), rest.state)
        return self._after(state, t, tb, w)

    def _after(self, state: FilterState, t: Floats, tb: Floats, w: Floats) -> Estimates[FilterState]:
        if t.size == 0:
            return Estimates(np.empty(0), state)
        h = np.diff(t, prepend=state.time)
        q = h / self.time_constant
        share = -np.expm1(-q)
        u = self.viscous_friction * w + tb
        forcing = share * self.inertia * np.diff(w, prepend=state.omega) / h
        if self.form is Form.CORRECTED:
            w1 = 1 - share / q
            before = np.concatenate([[self.viscous_friction * state.omega + state.torque], u[:-1]])
            forcing += (share - w1) * before + w1 * u
        initial = np.array([state.filtered])
        y = linear_recursion((1 - share)[:, None, None], forcing[:, None], initial)[:, 0]
        end = FilterState(float(t[-1]), float(tb[-1]), float(w[-1]), float(y[-1]))
        return Estimates(y if self.form is Form.CORRECTED else y + u, end)
