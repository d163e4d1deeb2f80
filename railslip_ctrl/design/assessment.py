"""The stability assessment of one wheel-slip loop at one operating point: what the reports show."""

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
_POLES = 6  # closed-loop poles that are looked for


class Verdict(StrEnum):
    """What a loop is, in a word."""

    UNSTABLE = "unstable"
    NO_FEEDBACK = "no feedback"
    FRAGILE = "stable but fragile"
    ROBUST = "robust"


@dataclass(frozen=True)
class PadeRow:
    """The same loop with the dead time replaced by a Pade approximation; `margins` is None where that is unstable."""

    order: int
    margins: Margins | None


@dataclass(frozen=True)
class Assessment:
    """One loop, assessed; printed, its report.

    - label: name of the controller.
    - plant, controller, actuator: what the loop is of, SI.
    - loop: the second of a discrete controller, the last of one with delays in it, such as a seeking one.
    - limits: what no controller can beat.
    - closed_loop_poles: array, 1-D; the rightmost, 1/s; none of a `DelayedLoop`.
    - margins: none of an unstable loop.
    - pade: the same with Pade approximations.
    - verdict: in a word, of the loop and of `as_run`.
    - as_run, sampled: the sampled loop of a continuous controller that says how it is run, and its margins.
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
        return str(import_module("railslip_ctrl.report").margins_text([self]))  # a room above this one

    @property
    def stable(self) -> bool:
        """Whether every closed-loop pole lies left of the imaginary axis, also as run."""
        return self.margins is not None and (self.as_run is None or self.sampled is not None)

    @property
    def marginal(self) -> bool:
        """Whether closed-loop poles lie on the imaginary axis."""
        return bool(self.loop.root_count.marginal)

    @property
    def unstable_poles(self) -> float:
        """Number of closed-loop poles in the closed right half plane."""
        return float(self.loop.unstable_closed_loop_poles)

    @property
    def stabilizing_gain_range(self) -> tuple[float, float] | None:
        """Factors on the loop gain that stabilise; None if none does."""
        found: tuple[float, float] | None = self.loop.stabilizing_gain_range
        return found

    @property
    def point(self) -> OperatingPoint:
        """The operating point."""
        return self.plant.point

    @property
    def verdict_line(self) -> str:
        """The verdict in a sentence, with the number that decides it, and what a mass given alone left as it was."""
        alone = self.point.vehicle.mass_alone
        return f"{self._decided}. {alone}" if alone else self._decided

    @property
    def _decided(self) -> str:
        if self.verdict is Verdict.NO_FEEDBACK:
            return f"{self.verdict.value}: its gain is 0, and the wheel is stable by itself; this is no controller"
        if self.margins is not None:
            told = f"Ms {ms_up(self.margins.ms)}"
            if self.as_run is not None:
                ms = "unstable" if self.sampled is None else f"Ms {ms_up(self.sampled.ms)}"
                told += f", {ms} sampled every {self.as_run.period:g} s"
            return f"{self.verdict.value} ({told})"
        how_many = f"{self.unstable_poles:g} closed-loop pole{'' if self.unstable_poles == 1 else 's'}"
        if math.isinf(self.unstable_poles):
            how_many = "a chain of closed-loop poles"
        where = "on the imaginary axis" if self.marginal else "in the right half plane"
        usable = self.stabilizing_gain_range
        remedy = "no loop gain of this controller stabilises it"
        if usable is not None:
            remedy = f"{usable[0]:.4g} to {usable[1]:.4g} times this loop gain would stabilise it"
        return f"{self.verdict.value}: {how_many} {where}; {remedy}"


def slip_responses(
    controller: Any, plant: LinearPlant, actuator: Actuator, times: ArrayLike, *, reference: float, torque: float
) -> tuple[TimeResponse, TimeResponse]:
    """The slip velocity, m/s, after a step of its reference, m/s, and after one of torque at the wheel, N*m, at times,
    s; errors as of `closed_loop_response`."""
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
    """What the plant and the actuator leave to any controller; see `design.limits`."""
    return fundamental_limits(actuated_plant(plant, actuator), actuator.dead_time, lag=actuator.lag)


@checked
def assess(plant: LinearPlant, controller: Any, actuator: Actuator, *, label: str = "") -> Assessment:
    """Assess the loop of a linear plant, a controller and an actuator, the dead time exact.

    - plant: the wheel, from `linearize`.
    - controller: linear system; from slip error (m/s) to torque at the wheel (N*m): `PIController`, a python-control
      system, continuous or discrete, or what else `design.controllers.linear_controller` takes.
    - actuator: dead time and lag between commanded and acting torque.
    - label: name of the controller in reports; its structure unless given.

    Returns limits, the six rightmost closed-loop poles (1/s, 1-D), margins (None of an unstable loop), Pade rows and
    verdict. InputError: an argument of another kind.
    """
    controller = getattr(controller, "controller", controller)  # of a design
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
        closed_loop_poles=_poles_found(loop),
        pade=tuple(_pade_row(loop, order) for order in PADE_ORDERS) if isinstance(loop, DeadTimeLoop) else (),
    )


def _poles_found(loop: Any) -> Complexes:
    """As many of the rightmost poles as the root count confirms, up to six; none is better than a wrong one, and
    none is looked for with delays inside the controller.

    Those of a sampled loop by s = ln(z)/h, but for z = 0, which decays at once.
    """
    if isinstance(loop, SampledLoop):
        z = loop.closed_loop_poles(_POLES)
        return np.asarray(np.log(z[z != 0]) / loop.period)
    for asked in range(_POLES if isinstance(loop, DeadTimeLoop) else 0, 0, -1):
        try:
            return np.asarray(loop.closed_loop_poles(asked))
        except (SpectrumError, InputError):
            continue
    return np.array([], dtype=np.complex128)


def _verdict(margins: Sequence[Margins | None], controller: Any) -> Verdict:
    """Of the margins of every loop, None of an unstable one."""
    stable = [one for one in margins if one is not None]
    if len(stable) < len(margins):
        return Verdict.UNSTABLE
    if not isinstance(controller, Controller) and controller.transfer_function.gain == 0:  # Ms is 1: of nothing
        return Verdict.NO_FEEDBACK
    return Verdict.ROBUST if is_robust(max(one.ms for one in stable)) else Verdict.FRAGILE


def _pade_row(loop: DeadTimeLoop, order: int) -> PadeRow:
    approximate = loop.pade(order)
    return PadeRow(order, approximate.margins() if approximate.is_stable() else None)


# --- loops of one controller under one title --------------------------------------------------------------------------


@dataclass(frozen=True)
class ControllerGroup:
    """One controller in one reading of the units, at every operating point, each with its frequency response."""

    title: str
    assessments: tuple[Assessment, ...]
    curves: tuple[FrequencyCurve, ...]


_READINGS = ((1.0, "SI"), (AS_PUBLISHED_INERTIA_SCALE, "as published"))


def published_groups(points: Sequence[OperatingPoint]) -> tuple[ControllerGroup, ...]:
    """Table 4's PI gains at operating points, in SI and as published: M, J and B times 3.6."""
    groups = []
    for scale, name in _READINGS:
        title, found = f"Table 4's gains, inertia scale {scale:g} ({name})", []
        for p in points:
            car = p.vehicle.model_copy(update={"inertia_scale": scale})
            scaled = operating_point(p.law, car, p.speed, p.slip, rail=p.rail, initial_speed_kmh=p.initial_speed_kmh)
            gains = PIController(table4_gains(p.adhesion))
            found.append(assess(linearize(scaled), gains, p.vehicle.actuator, label=title))
        groups.append(controller_group(title, tuple(found)))
    return tuple(groups)


def controller_group(title: str, assessments: tuple[Assessment, ...]) -> ControllerGroup:
    """Assessed loops under one title, with frequency responses over their common band."""
    bands = [a.loop.feature_band() for a in assessments]
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return ControllerGroup(title, assessments, tuple(frequency_curve(a.loop, low, high) for a in assessments))
