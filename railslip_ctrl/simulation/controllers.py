"""Controllers of a braking run as records; each has its step in `steps`, which the kernel runs."""

from __future__ import annotations

import math
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from railslip_ctrl.core.arguments import check_fields, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.core.user_files import file_name, given_path
from railslip_ctrl.design.controllers import (
    PERIOD,
    LinearController,
    PIController,
    Rule,
    SampledController,
    linear_controller,
    start_state,
    state_names,
)
from railslip_ctrl.design.schedule import GainSchedule
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.numeric import plant_parameters
from railslip_ctrl.model.vehicle import PIGains, Rail
from railslip_ctrl.sliding.generate import generated_law, law_states
from railslip_ctrl.sliding.law import LawGains, gain_parameters

from .steps import linear_source, sliding_source, step_text

if TYPE_CHECKING:
    from railslip_ctrl.model.linearization import OperatingPoint

    from .scenario import Scenario


@dataclass(frozen=True)
class Situation:
    """What a controller is told of the vehicle and the rail when its row of numbers is made.

    `assumed` is the adhesion law it may use as its model, on the rail it believes in.
    """

    scenario: Scenario
    rail: Rail
    assumed: AdhesionLaw
    period: float


@runtime_checkable
class Controller(Protocol):
    """What the simulation needs of a controller.

    - name: for reports.
    - period: sampling period, s; None samples at every step of the scenario.
    - reference: slip ratio to be held, by rail; None: it holds none, and a run has no slip error.
    - states: names of what the controller remembers, in order, for the log.
    - knows_rail: whether it is told when the rail changes (its reference follows, and its model where it has one).
    """

    @property
    def name(self) -> str: ...
    @property
    def period(self) -> float | None: ...
    @property
    def reference(self) -> ReferenceSlip | None: ...
    @property
    def states(self) -> tuple[str, ...]: ...
    @property
    def knows_rail(self) -> bool: ...
    @property
    def model_law(self) -> AdhesionLaw | None: ...

    def source(self) -> str:
        """Text of its `command`, to be put into a kernel."""

    def row(self, situation: Situation) -> tuple[float, ...]:
        """Its numbers from the third on, in a `situation`: see `steps`; SI."""

    def start(self, speed: float) -> tuple[float, ...]:
        """Its state when the brake is applied at a `speed`, m/s."""


class Filed:
    """What controllers that a file holds share."""

    @property
    def toml(self) -> str:
        """The text that `save` writes."""
        files = import_module("railslip_ctrl.simulation.controller_files")  # which imports these records
        return str(files.control_text(self))

    def save(self, path: str | Path) -> None:
        """Write the TOML file at `path` that every command and `load_controller` take.

        InputError where it cannot be written.
        """
        write_text(path, self.toml)


def write_text(path: str | Path, text: str) -> None:
    """Write a file of a controller. InputError where it cannot be written."""
    path = given_path(path)
    try:
        path.write_text(text, "utf-8")
    except OSError as error:
        raise InputError(f"{file_name(path)}: cannot be written ({error.strerror}); give another path") from None


@dataclass(frozen=True)
class LinearControl(Filed):
    """A linear controller, sampled, with limits and anti-windup; see `design.controllers.SampledController`.

    - design: linear system; `PIController`, a python-control system or what else `design.controllers.linear_controller`
      takes.
    - reference: slip ratio to be held, by rail.
    - name: for reports.
    - period: sampling period, s, 10 ms unless said; None samples at every step, a discrete design at its own.
    - torque_low, torque_high: the controller's own limits, N*m.
    - tracking_time, rule: as of `SampledController`, Tustin's rule unless said (the built-in controllers and files of a
      PI without a rule have the backward difference: their numbers were made with it, and differ by up to 2e-4 in the
      distance of a stop); a tracking time of inf: no anti-windup, None: that of the slowest zero, kp/ki of a PI, as in
      a file.
    - initial_torque: N*m, from the start: a torque that the rail surely takes, which need not be built up first; where
      an integral starts, added to the torque of a controller without one.
    - cut_out_speed, cut_out_torque: below that measured train speed, m/s, slip is no longer controlled and that torque,
      N*m, is commanded; a speed of 0: never.
    - model_law, knows_rail: as of `Controller`: no adhesion law, and the reference follows the rail.

    InputError: an initial or cut-out torque that is not finite, a cut-out speed that is not or is negative; as of
    `SampledController`, where the period is known.
    """

    design: Any
    reference: ReferenceSlip
    name: str = "pi"
    period: float | None = PERIOD
    torque_low: float = -math.inf
    torque_high: float = math.inf
    tracking_time: float | None = None
    rule: Rule = Rule.TUSTIN
    initial_torque: float = 0.0
    cut_out_speed: float = 0.0
    cut_out_torque: float = 0.0
    model_law: None = None
    knows_rail: bool = True

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "design", linear_controller(self.design))
        own = None if isinstance(self.design, PIController) else self.design.period
        if own is not None and self.period in (None, PERIOD):
            object.__setattr__(self, "period", own)
        number("initial torque", self.initial_torque, "N*m")
        number("cut-out speed", self.cut_out_speed, "m/s", ge=0)
        number("cut-out torque", self.cut_out_torque, "N*m")
        _ = self.as_run

    @property
    def states(self) -> tuple[str, ...]:
        """Those of the difference equations, the error before and the torque before its limits."""
        return (*state_names(self.design), "error", "unlimited_torque")

    def linear(self, point: OperatingPoint) -> LinearController:
        """The design, the same at every operating point."""
        return self.design  # type: ignore[no-any-return]

    def sampled(self, period: float) -> SampledController:
        """The difference equations at a period, s."""
        return SampledController(self.design, period, self.torque_low, self.torque_high, self.rule, self.tracking_time)

    @property
    def as_run(self) -> SampledController | None:
        """The difference equations, where they do not follow the step of the scenario."""
        return None if self.period is None else self.sampled(self.period)

    def source(self) -> str:
        return linear_source()

    def row(self, situation: Situation) -> tuple[float, ...]:
        return (self.cut_out_speed, self.cut_out_torque, *self.sampled(situation.period).numbers)

    def start(self, speed: float) -> tuple[float, ...]:
        return start_state(self.design, self.initial_torque)


@dataclass(frozen=True)
class ScheduledControl:
    """A `GainSchedule`, sampled: PI gains over speed and rail with one lead, taken over without a bump in torque.

    - schedule: the gains.
    - reference, name, period, torque_low, torque_high, rule, initial_torque, model_law, knows_rail: as of
      `LinearControl`.
    - tracking_time: as of `LinearControl`, s; None follows the gains, kp/ki.

    InputError: as of `LinearControl`.
    """

    schedule: GainSchedule
    reference: ReferenceSlip
    name: str = "scheduled"
    period: float | None = PERIOD
    torque_low: float = 0.0
    torque_high: float = math.inf
    tracking_time: float | None = None
    rule: Rule = Rule.TUSTIN
    initial_torque: float = 0.0
    model_law: None = None
    knows_rail: bool = True

    states = ("integral", "error", "filtered_error", "unlimited_torque")

    def __post_init__(self) -> None:
        check_fields(self)
        number("initial torque", self.initial_torque, "N*m")
        if self.period is not None:
            self._lead(self.period)

    def linear(self, point: OperatingPoint) -> PIController:
        """The PI at an operating point's speed and rail."""
        return self.schedule.controller(point.speed, point.rail)

    def source(self) -> str:
        return step_text("gains_at", "scheduled")

    def row(self, situation: Situation) -> tuple[float, ...]:
        """Lead, the integrator's weights, h/Tt, period, limits, then speeds and gains of the rail."""
        h, rail = situation.period, situation.rail
        by_rail = [sorted({e.speed_kmh * KMH for e in self.schedule.entries if e.rail is one}) for one in Rail]
        speeds = by_rail[tuple(Rail).index(rail)] or [situation.scenario.initial_speed]  # none: the schedule refuses
        designs = [self.schedule.controller(speed, rail).gains for speed in speeds]
        p, q0, q1 = self._lead(h)
        now, before = (h * 0.5, h * 0.5) if self.rule is Rule.TUSTIN else (h, 0.0)
        tracking = -1.0 if self.tracking_time is None else h / self.tracking_time
        return (
            *(p, q0, q1, now, before, tracking, h, self.torque_low, self.torque_high, float(len(speeds))),
            *(*speeds, *(gains.kp for gains in designs), *(gains.ki for gains in designs)),
            *(0.0,) * (3 * (max(map(len, by_rail)) - len(speeds))),  # rows of both rails have one length
        )

    def _lead(self, h: float) -> tuple[float, float, float]:
        """p, q0, q1 of the lead (q0 z + q1)/(z - p), the same at all speeds; InputError as of `SampledController`."""
        design = PIController(PIGains(kp=1.0, ki=0.0), self.schedule.lead, self.schedule.lead_filter)
        sampled = SampledController(design, h, self.torque_low, self.torque_high, self.rule, self.tracking_time)
        made = sampled.transfer_function
        return float(np.sum(made.poles).real), made.gain, -made.gain * float(np.sum(made.zeros).real)

    def start(self, speed: float) -> tuple[float, ...]:
        return (self.initial_torque, 0.0, 0.0, self.initial_torque)


@dataclass(frozen=True)
class SlidingControl:
    """The sliding-mode law that `sliding.derivation` derives, [Park2008] (45), sampled.

    Ta comes from an adhesion law at the measured slip velocity, its state at rest: the plant's own, or `model_law`. On
    a change of rail that the controller knows (`knows_rail`) its model turns wet too; else it keeps what it had and
    only the reference changes.

    - gains: K, D, rho, k1, k2 and the boundary layer, SI.
    - reference, name, period, torque_low, torque_high: as of `LinearControl`.
    - nominal_mass, nominal_viscous_friction: Mn, kg, and Bn, N*m*s, before the inertia scale; None takes the vehicle's
      at the start.
    - filter_time: time constant of the filter that estimates v', s.
    - anti_windup: integral and estimates rest while the torque is at a limit.
    - knows_rail, model_law: as above.

    InputError: limits without a torque in between, a filter time or mass that is not positive, a negative friction.
    """

    gains: LawGains
    reference: ReferenceSlip
    name: str = "asmc"
    period: float | None = None
    nominal_mass: float | None = None
    nominal_viscous_friction: float | None = None
    filter_time: float = 0.1
    torque_low: float = -math.inf
    torque_high: float = math.inf
    anti_windup: bool = False
    knows_rail: bool = True
    model_law: AdhesionLaw | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        number("filter time", self.filter_time, "s", gt=0)
        if self.nominal_mass is not None:
            number("nominal mass", self.nominal_mass, "kg", gt=0)
        if self.nominal_viscous_friction is not None:
            number("nominal viscous friction", self.nominal_viscous_friction, "N*m*s", ge=0)
        if not self.torque_low < self.torque_high:
            low, high = self.torque_low, self.torque_high
            raise InputError(f"torque limits: low {low:g} and high {high:g} N*m are not allowed; give low < high")

    @property
    def states(self) -> tuple[str, ...]:
        """s, then the generated law's."""
        return ("s", *law_states())

    def source(self) -> str:
        return sliding_source(None if self.model_law is None else type(self.model_law))

    def row(self, situation: Situation) -> tuple[float, ...]:
        """The generated `Parameters`, then mass, wheel and law of the assumed adhesion."""
        vehicle, scale = situation.scenario.vehicle, situation.scenario.vehicle.inertia_scale
        nominal_viscous = self.nominal_viscous_friction
        numbers = {
            "J": vehicle.effective_inertia,
            "r": vehicle.wheel.radius,
            "Mn": scale * (vehicle.mass if self.nominal_mass is None else self.nominal_mass),
            "Bn": scale * (vehicle.wheel.viscous_friction if nominal_viscous is None else nominal_viscous),
            "lambda_d": reference_slip(self.reference, situation.rail),
            "filter_time": self.filter_time,
            "torque_min": self.torque_low,
            "torque_max": self.torque_high,
            "period": situation.period,
            "anti_windup": float(self.anti_windup),
            **gain_parameters(self.gains),
        }
        fields, defaults = generated_law().Parameters._fields, generated_law().Parameters._field_defaults
        own = (numbers[name] if name in numbers else defaults[name] for name in fields)
        return (*own, *plant_parameters(situation.assumed, vehicle))

    def start(self, speed: float) -> tuple[float, ...]:
        return (0.0, *(speed if name == "v_filtered" else 0.0 for name in law_states()))


@dataclass(frozen=True)
class TorqueProfile:
    """A torque given over time, linear in between and constant after; open loop.

    - times, torques: s, rising; N*m, one for each time.
    - reference: what the slip error is taken against, if anything; the torque does not follow it.
    - name, period, knows_rail, model_law: as of `LinearControl`.

    InputError: lists of different lengths, or times that do not rise.
    """

    times: tuple[float, ...]
    torques: tuple[float, ...]
    reference: ReferenceSlip | None = None
    name: str = "torque-profile"
    period: float | None = None
    knows_rail: bool = True
    model_law: None = None

    states = ()

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.times or len(self.times) != len(self.torques):
            raise InputError(
                f"torque profile: {len(self.times)} times and {len(self.torques)} torques; give as many of each"
            )
        for earlier, later in pairwise(self.times):
            if not later > earlier:
                raise InputError(f"torque profile: time {later:g} s after {earlier:g} s is not allowed; they must rise")
        if not all(map(math.isfinite, (*self.times, *self.torques))):
            raise InputError("torque profile: give finite times (s) and torques (N*m)")

    def source(self) -> str:
        return step_text("torque_profile")

    def row(self, situation: Situation) -> tuple[float, ...]:
        return (float(len(self.times)), *self.times, *self.torques)

    def start(self, speed: float) -> tuple[float, ...]:
        return ()


@dataclass(frozen=True)
class SlideProtection:
    """Rule-based wheel slide protection: dump, hold or fill by slip and wheel deceleration ([Park2008] Fig. 3).

    The valve dumps where the slip is above `dump_slip` or the wheel decelerates by more than `dump_deceleration`
    (m/s^2), fills where the slip is below `fill_slip`, and holds in between; the torque asked for moves by `fill_rate`
    and `dump_rate` (N*m/s) between 0 and `torque_high` (N*m), which a driver's full brake asks for. The wheel's
    deceleration is filtered with `filter_time` (s). `reference` only judges the slip, if it is given; `name`, `period`,
    `knows_rail`, `model_law` as of `LinearControl`.

    The defaults are a baseline: slips and deceleration of the size that wheel slide protection in service acts on
    (slips of 5 to 30 %), the rates slow enough for the published brake's lag and dead time that the wheel does not lock
    in either built-in scenario.

    InputError unless 0 < fill_slip < dump_slip < 1 and all rates are positive.
    """

    reference: ReferenceSlip | None = None
    fill_slip: float = 0.05
    dump_slip: float = 0.15
    dump_deceleration: float = 4.5
    fill_rate: float = 2000.0
    dump_rate: float = 16000.0
    torque_high: float = 9000.0
    filter_time: float = 0.02
    name: str = "slide-protection"
    period: float | None = 0.01
    knows_rail: bool = True
    model_law: None = None

    states = ("torque_asked", "filtered_rim_speed", "started", "valve")

    def __post_init__(self) -> None:
        check_fields(self)
        if not 0 < self.fill_slip < self.dump_slip < 1:
            raise InputError(
                f"slide protection: slips {self.fill_slip:g} and {self.dump_slip:g} are not allowed; give "
                "0 < fill_slip < dump_slip < 1"
            )
        for name in ("dump_deceleration", "fill_rate", "dump_rate", "torque_high", "filter_time"):
            number(f"slide protection: {name}", getattr(self, name), gt=0)

    def source(self) -> str:
        return step_text("slide_protection")

    def row(self, situation: Situation) -> tuple[float, ...]:
        return (
            *(self.dump_slip, self.fill_slip, self.dump_deceleration, self.fill_rate, self.dump_rate),
            *(self.torque_high, situation.period, self.filter_time),
        )

    def start(self, speed: float) -> tuple[float, ...]:
        return (0.0, 0.0, 0.0, 1.0)  # released; the wheel's speed is taken at the first sample


def reference_slip(reference: ReferenceSlip | None, rail: Rail) -> float:
    """The slip ratio to be held on a rail; NaN without a reference."""
    if reference is None:
        return math.nan
    return reference.wet if rail is Rail.WET else reference.dry
