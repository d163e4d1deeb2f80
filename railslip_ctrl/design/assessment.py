"""Assess one wheel-slip loop at one operating point: margins, limits and verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.sampled import loop_as_run
from railslip_ctrl.controllers.systems import (
    PIController,
    actuated_plant,
    controller_system,
    linear_controller,
    wheel_slip_loop,
)
from railslip_ctrl.core.arguments import Complexes, checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import ms_up
from railslip_ctrl.loop import DeadTimeLoop, Margins, Rational, SpectrumError
from railslip_ctrl.loop.deadtime import FrequencyCurve, frequency_curve
from railslip_ctrl.loop.responses import TimeResponse, closed_loop_response
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint, linearize, operating_point
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, Actuator, table4_gains

from .limits import Limits, fundamental_limits
from .specification import is_robust

PADE_ORDERS = (1, 2, 3, 4, 5)
_POLES = 6  # number of closed-loop poles computed


class Verdict(StrEnum):
    """Verdict on a loop: "unstable", "no feedback", "stable but fragile" or "robust"."""

    UNSTABLE = "unstable"
    NO_FEEDBACK = "no feedback"
    FRAGILE = "stable but fragile"
    ROBUST = "robust"


@dataclass(frozen=True)
class PadeRow:
    """Margins of a loop with a Pade approximation of the dead time; `margins` is None if that loop is unstable."""

    order: int
    margins: Margins | None


@dataclass(frozen=True)
class Assessment:
    """Assessment of one loop at one operating point; `print` shows it as a report.

    - label: name of the controller.
    - plant, controller, actuator: parts of the loop, SI.
    - loop: a `SampledLoop` for a discrete controller, a `DelayedLoop` for a controller with delays (such as the
      seeking controller), and a `DeadTimeLoop` for all other controllers.
    - limits: bounds that plant and actuator set for any controller.
    - closed_loop_poles: rightmost closed-loop poles, 1/s, 1-D; empty for a `DelayedLoop`.
    - margins: margins of `loop`; None if `loop` is unstable.
    - pade: margins with Pade approximations of the dead time, order 1 to 5.
    - verdict: the worse of the verdicts on `loop` and `as_run`.
    - as_run: loop with the continuous controller sampled at its period; None if the controller is discrete or has no
      period, or if the period is so short that sampling makes no difference.
    - sampled: margins of `as_run`; None if `as_run` is None or unstable.
    """

    label: str
    plant: LinearPlant
    controller: Any
    actuator: Actuator
    loop: Any
    limits: Limits
    closed_loop_poles: Complexes
    margins: Margins | None
    pade: tuple[PadeRow, ...]
    verdict: Verdict
    as_run: Any = None
    sampled: Margins | None = None

    def __str__(self) -> str:
        return str(import_module("railslip_ctrl.report").margins_text([self]))  # a package that imports this one

    @property
    def stable(self) -> bool:
        """True if `loop` is stable, and `as_run` too if there is one."""
        return self.margins is not None and (self.as_run is None or self.sampled is not None)

    @property
    def marginal(self) -> bool:
        """True if closed-loop poles are on the imaginary axis."""
        return bool(self.loop.root_count.marginal)

    @property
    def unstable_poles(self) -> float:
        """Number of closed-loop poles in the closed right half plane."""
        return float(self.loop.unstable_closed_loop_poles)

    @property
    def stabilizing_gain_range(self) -> tuple[float, float] | None:
        """Interval of the factors on the loop gain with which the loop is stable; None if no factor stabilises it."""
        interval: tuple[float, float] | None = self.loop.stabilizing_gain_range
        return interval

    @property
    def point(self) -> OperatingPoint:
        """Operating point of the plant."""
        return self.plant.point

    @property
    def verdict_line(self) -> str:
        """Verdict, with Ms or the number of unstable poles, and a note if the mass changed without the wheel load."""
        alone = self.point.vehicle.mass_alone
        return f"{self._decided}. {alone}" if alone else self._decided

    @property
    def _decided(self) -> str:
        if self.verdict is Verdict.NO_FEEDBACK:
            return f"{self.verdict.value}: the gain is 0 and the wheel is stable without control"
        if self.margins is not None:
            numbers = f"Ms {ms_up(self.margins.ms)}"
            if self.as_run is not None:
                ms = "unstable" if self.sampled is None else f"Ms {ms_up(self.sampled.ms)}"
                numbers += f", {ms} if sampled every {self.as_run.period:g} s"
            return f"{self.verdict.value} ({numbers})"
        poles = f"{self.unstable_poles:g} closed-loop pole{'' if self.unstable_poles == 1 else 's'}"
        if math.isinf(self.unstable_poles):
            poles = "a chain of closed-loop poles"
        half_plane = "on the imaginary axis" if self.marginal else "in the right half plane"
        usable = self.stabilizing_gain_range
        remedy = "no loop gain of this controller stabilises it"
        if usable is not None:
            remedy = f"{usable[0]:.4g} to {usable[1]:.4g} times this loop gain would stabilise it"
        return f"{self.verdict.value}: {poles} {half_plane}; {remedy}"


def slip_responses(
    controller: Any, plant: LinearPlant, actuator: Actuator, times: ArrayLike, *, reference: float, torque: float
) -> tuple[TimeResponse, TimeResponse]:
    """Return the responses of the slip velocity, m/s, to a step of its reference and to a step of torque at the wheel.

    `controller` is a linear system from slip error (m/s) to torque (N*m), `plant` the wheel, `actuator` the brake.
    `times` is in s. `reference`, m/s, and `torque`, N*m, are the sizes of the steps.
    """
    lag = np.array([-1 / actuator.lag] if actuator.lag > 0 else [], dtype=complex)
    brake = Rational(lag[:0], lag, 1 / (actuator.lag or 1.0))
    loop = partial(
        closed_loop_response,
        controller_system(controller),
        Rational(plant.zeros, plant.poles, plant.gain),
        actuator.dead_time,
        time=times,
        actuator=brake,
    )
    return loop(reference=reference), loop(disturbance=torque)


def limits_of(plant: LinearPlant, actuator: Actuator) -> Limits:
    """Return the limits that plant and actuator set for any controller."""
    return fundamental_limits(actuated_plant(plant, actuator), actuator.dead_time, lag=actuator.lag)


@checked
def assess(plant: LinearPlant, controller: Any, actuator: Actuator, *, label: str = "") -> Assessment:
    """Assess the loop of a linear plant, a controller and an actuator with exact dead time.

    - plant: the wheel, from `linearize`.
    - controller: linear system from slip error (m/s) to torque at the wheel (N*m); anything that
      `controllers.systems.linear_controller` accepts.
    - actuator: dead time and lag between commanded and acting torque.
    - label: name of the controller in reports; by default its structure.

    InputError: an argument of wrong type.
    """
    controller = getattr(controller, "controller", controller)  # a design contains its controller
    if isinstance(controller, Controller):
        controller = controller.believing(plant.point.vehicle)
    loop = wheel_slip_loop(plant, controller, actuator)
    own = isinstance(controller, Controller) and controller.loop(plant.point, actuator) is not None
    design = controller if own else linear_controller(controller, plant.point)
    margins = loop.margins() if loop.is_stable() else None
    run = None if isinstance(loop, SampledLoop) else loop_as_run(plant, controller, actuator)
    sampled = run.margins() if run is not None and run.is_stable() else None
    return Assessment(
        label=label or (design.kind if isinstance(design, Controller) else design.structure),
        plant=plant,
        controller=design,
        actuator=actuator,
        loop=loop,
        limits=limits_of(plant, actuator),
        margins=margins,
        verdict=_verdict((margins,) if run is None else (margins, sampled), design),
        as_run=run,
        sampled=sampled,
        closed_loop_poles=_rightmost_poles(loop),
        pade=tuple(_pade_row(loop, order) for order in PADE_ORDERS) if isinstance(loop, DeadTimeLoop) else (),
    )


def _rightmost_poles(loop: Any) -> Complexes:
    """Return up to six rightmost closed-loop poles, 1/s; fewer if the root count does not confirm all of them."""
    if isinstance(loop, SampledLoop):
        z = loop.closed_loop_poles(_POLES)
        return np.asarray(np.log(z[z != 0]) / loop.period)
    for count in range(_POLES if isinstance(loop, DeadTimeLoop) else 0, 0, -1):
        try:
            return np.asarray(loop.closed_loop_poles(count))
        except (SpectrumError, InputError):
            continue
    return np.array([], dtype=np.complex128)


def _verdict(margins: Sequence[Margins | None], controller: Any) -> Verdict:
    stable = [m for m in margins if m is not None]
    if len(stable) < len(margins):
        return Verdict.UNSTABLE
    if not isinstance(controller, Controller) and controller.transfer_function.gain == 0:  # Ms is 1 without feedback
        return Verdict.NO_FEEDBACK
    return Verdict.ROBUST if is_robust(max(m.ms for m in stable)) else Verdict.FRAGILE


def _pade_row(loop: DeadTimeLoop, order: int) -> PadeRow:
    approximate = loop.pade(order)
    return PadeRow(order, approximate.margins() if approximate.is_stable() else None)


@dataclass(frozen=True)
class ControllerGroup:
    """Assessments and frequency responses of one controller at every operating point."""

    title: str
    assessments: tuple[Assessment, ...]
    curves: tuple[FrequencyCurve, ...]


_READINGS = ((1.0, "SI"), (AS_PUBLISHED_INERTIA_SCALE, "as published"))


def published_groups(points: Sequence[OperatingPoint]) -> tuple[ControllerGroup, ...]:
    """Assess the PI gains of [Park2008] Table 4 at operating points, in SI and as published (M, J, B times 3.6)."""
    groups = []
    for scale, name in _READINGS:
        title, assessments = f"Table 4's gains, inertia scale {scale:g} ({name})", []
        for p in points:
            car = p.vehicle.model_copy(update={"inertia_scale": scale})
            scaled = operating_point(p.law, car, p.speed, p.slip, rail=p.rail, initial_speed_kmh=p.initial_speed_kmh)
            gains = PIController(table4_gains(p.adhesion))
            assessments.append(assess(linearize(scaled), gains, p.vehicle.actuator, label=title))
        groups.append(controller_group(title, tuple(assessments)))
    return tuple(groups)


def controller_group(title: str, assessments: tuple[Assessment, ...]) -> ControllerGroup:
    """Return assessed loops as a group, with frequency responses over a common frequency band."""
    bands = [a.loop.feature_band() for a in assessments]
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return ControllerGroup(title, assessments, tuple(frequency_curve(a.loop, low, high) for a in assessments))
