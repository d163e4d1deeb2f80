"""Linear controllers as they brake: sampled, with limits, anti-windup and a hand-over at low speed."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import asdict
from functools import cached_property
from typing import Any, ClassVar, Self

from pydantic import Field, model_validator

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import quantity, shown
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.vehicle import PARK2008, Record, Vehicle

from .base import LEAST_PERIOD, PERIOD, Controller, DesignNumber, Situation
from .sampled import Rule, SampledController, linear_step, state_names
from .systems import LinearController, PolynomialController, StateSpaceController, system_words

TORQUE_LIMIT = 9000.0
"""Full brake of the published vehicle, N*m: twice what the best adhesion, 0.3 of its wheel load, can take."""

_MOST_COEFFICIENTS = 12  # of a polynomial that is shaped by its coefficients

TRACKING_TIME = 2.0
"""Tracking time of the anti-windup, s; 1 to 5 s differ by less than 1 % in braking distance."""


def full_brake_torque(vehicle: Vehicle) -> float:
    """The largest torque of a vehicle's brake, N*m, at which designs are limited and bounds taken: `TORQUE_LIMIT`, in
    proportion to wheel load, loaded where that is more, times radius."""
    return TORQUE_LIMIT * adhesion_share(vehicle, max(vehicle.wheel_load, vehicle.wheel_load_loaded))


def adhesion_share(vehicle: Vehicle, wheel_load: float) -> float:
    """The torque that the adhesion of a wheel load (N) takes, over that of the published vehicle."""
    return wheel_load * vehicle.wheel.radius / (PARK2008.wheel_load * PARK2008.wheel.radius)


class LinearControl(Controller):
    """Base of the linear kinds: the error e = lambda_d v - sigma goes through difference equations, see
    `sampled.SampledController`.

    Below `hand_over_speed` the slip is not controlled, and `hand_over_torque` is commanded. InputError: limits without
    a torque in between, or a period or tracking time out of the range of `SampledController`.
    """

    source: ClassVar[str] = "[Astrom1997] 8, 9"

    period: float | None = quantity("s", "sampling period; every step if left out", ge=LEAST_PERIOD, default=None)
    radius: float | None = quantity("m", "wheel radius that it believes; the vehicle's if left out", gt=0, default=None)
    torque_min: float | None = quantity("N*m", "least torque; none if left out", default=None)
    torque_max: float | None = quantity("N*m", "largest torque; none if left out", default=None)
    anti_windup: bool = Field(True, description="whether the states follow a torque that is limited")
    tracking_time: float | None = quantity(
        "s", "tracking time of the anti-windup; that of the slowest zero if left out", gt=0, default=None
    )
    initial_torque: float = quantity("N*m", "torque at the start", default=0.0)
    hand_over_speed: float = quantity("m/s", "train speed below which it does not control slip", ge=0, default=0.0)
    hand_over_torque: float = quantity("N*m", "torque that it commands there", default=0.0)
    rule: Rule = Field(Rule.BACKWARD, description="how the system becomes a difference equation")

    class State(Record):
        """What the difference equations remember."""

        error: float = quantity("m/s", "slip error of the sample before", default=0.0)
        unlimited_torque: float = quantity("N*m", "torque of the sample before, without limits", default=0.0)
        states: tuple[float, ...] = quantity("1", "states of the difference equations", default=())
        room: tuple[float, ...] = quantity("1", "their next values", default=())

    class Parameters(Record):
        """The difference equations with limits and hand-over."""

        radius: float = quantity("m", "wheel radius")
        hand_over_speed: float = quantity("m/s", "speed below which it does not control slip")
        hand_over_torque: float = quantity("N*m", "torque that it commands there")
        torque_min: float = quantity("N*m", "least torque")
        torque_max: float = quantity("N*m", "largest torque")
        direct: float = quantity("N*m/(m/s)", "from the error to the torque")
        output: tuple[float, ...] = quantity("1", "from the states to the torque")
        now: tuple[float, ...] = quantity("1", "from the error to the states")
        before: tuple[float, ...] = quantity("1", "from the error before to the states")
        tracking: tuple[float, ...] = quantity("1", "from what the brake took less what was asked to the states")
        transition: tuple[float, ...] = quantity("1", "from the states to the next ones, by rows")

    @property
    @abstractmethod
    def system(self) -> LinearController:
        """The linear system, from slip error (m/s) to torque (N*m)."""

    @model_validator(mode="after")
    def _can_run(self) -> Self:
        _ = self.system, self.as_run
        return self

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """The difference equations on the slip error; below the hand-over speed a held torque."""
        if measurement.train_speed < parameters.hand_over_speed:
            return parameters.hand_over_torque
        slip_velocity = measurement.train_speed - parameters.radius * measurement.wheel_speed
        error = parameters.reference_slip * measurement.train_speed - slip_velocity
        return linear_step(state, parameters, error, measurement.applied_torque)

    def start(self, speed: float, period: float) -> Record:
        return self.State(**self.sampled(period).at_rest(self.initial_torque))

    def parameters(self, situation: Situation) -> Mapping[str, Any]:
        own = {name: getattr(self, name) for name in ("radius", "hand_over_speed", "hand_over_torque")}
        return {**own, **self.sampled(situation.period).numbers}

    def logged(self, state: Record) -> dict[str, int]:
        places = super().logged(state)
        own = (name for name in places if name.startswith("states_"))
        named = {name: places[one] for name, one in zip(state_names(self.system), own, strict=True)}
        return {**named, "error": places["error"], "unlimited_torque": places["unlimited_torque"]}

    def linear(self, point: OperatingPoint | None) -> LinearController:
        return self.system

    def sampled(self, period: float) -> SampledController:
        """The difference equations at a period, s."""
        tracking = self.tracking_time if self.anti_windup else math.inf
        return SampledController(self.system, period, self.least_torque, self.largest_torque, self.rule, tracking)

    @cached_property
    def as_run(self) -> SampledController | None:
        """The difference equations, where they do not follow the step of the run."""
        return None if self.period is None else self.sampled(self.period)

    def described(self) -> str:
        return f"{self.label}, {system_words(self.system)}"

    def limits_described(self) -> str:
        return super().limits_described() + windup_words(self, self.anti_windup)

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Within 0 and the vehicle's full brake, with anti-windup."""
        return cls(**{"torque_min": 0.0, "torque_max": full_brake_torque(vehicle), **given}).believing(vehicle)


def windup_words(control: Any, anti_windup: bool) -> str:
    """Start, anti-windup and rule of a linear or scheduled controller, for its `limits_described`."""
    tracking = "by its gains" if control.tracking_time is None else f"{control.tracking_time:g} s"
    windup = tracking if anti_windup else "none"
    return f", initial torque {control.initial_torque:g} N·m, anti-windup {windup}, rule {control.rule.value}"


class SystemControl(LinearControl):
    """Base of linear systems of any order, continuous or `discrete`."""

    period: float | None = quantity("s", "sampling period", ge=LEAST_PERIOD, default=PERIOD)
    rule: Rule = Field(Rule.TUSTIN, description="how the system becomes a difference equation")
    discrete: bool = Field(False, description="whether it is one already, at its period")

    def gain_values(self) -> dict[str, Any]:
        numbers = {name: value for name, value in asdict(self.system).items() if value is not None}
        return {"structure": self.system.structure, **numbers}

    @property
    def _own_period(self) -> float | None:
        return self.period if self.discrete else None


class TransferFunction(SystemControl):
    """C = num/den: coefficients of descending powers of s, or of z if it is discrete."""

    kind: ClassVar[str] = "transfer-function"
    title: ClassVar[str] = "ratio of polynomials"

    num: tuple[float, ...] = quantity("1", "numerator, N*m for m/s")
    den: tuple[float, ...] = quantity("1", "denominator")

    @cached_property
    def system(self) -> LinearController:
        for name, given in (("num", self.num), ("den", self.den)):
            if not given:
                raise InputError(f"{name}: is empty; give at least one coefficient")
        return PolynomialController(self.num, self.den, self._own_period)

    def design_numbers(self) -> list[DesignNumber]:
        """Its coefficients: b2, b1, b0 of the numerator and a2, a1, a0 of the denominator, by their power."""
        parts = {"b": self.num, "a": self.den}
        return [
            DesignNumber(f"{letter}{power}", value, "1", f"coefficient of the power {power}")
            for letter, part in parts.items()
            for power, value in zip(range(len(part) - 1, -1, -1), part, strict=True)
        ]

    def with_design_numbers(self, values: Mapping[str, float], **others: Any) -> Self:
        """Of the coefficients in `values` alone: others are 0, and the order is that of the highest."""
        powers: dict[str, dict[int, float]] = {"b": {}, "a": {}}
        for name, value in values.items():
            letter, power = name[:1], name[1:]
            if letter not in powers or not (
                power.isascii() and power.isdigit() and int(power[:3]) < _MOST_COEFFICIENTS
            ):
                raise InputError(f"{shown(name)} is no coefficient; give b0 to b{_MOST_COEFFICIENTS - 1}, a0 and so on")
            powers[letter][int(power)] = value
        num, den = (tuple(one.get(i, 0.0) for i in range(max(one, default=0), -1, -1)) for one in powers.values())
        return super().with_design_numbers({}, num=num, den=den, **others)


class StateSpace(SystemControl):
    """x' = A x + B e, torque = C x + D e, SI; of a discrete one x of the next sample for x'.

    Matrices as other tools write them too: keys in lower case, B a column, C and D in rows, numbers without brackets.
    """

    kind: ClassVar[str] = "state-space"
    title: ClassVar[str] = "linear system by its matrices"

    A: tuple[tuple[float, ...], ...] = quantity("1", "by rows")
    B: tuple[float, ...] = quantity("1", "from the error")
    C: tuple[float, ...] = quantity("1", "to the torque")
    D: float = quantity("1", "from error to torque", default=0.0)

    @model_validator(mode="before")
    @classmethod
    def _as_matrices(cls, content: dict[str, Any]) -> dict[str, Any]:
        found = {key.upper() if key in ("a", "b", "c", "d") else key: value for key, value in content.items()}
        if len(found) < len(content):
            raise InputError("A, B, C, D: one is given in both cases; give it once")
        if isinstance(found.get("A"), int | float):
            found["A"] = [[found["A"]]]
        if "B" in found:
            found["B"] = [_only(row) for row in _listed(found["B"])]
        if "C" in found:
            found["C"] = _listed(_only(found["C"]))
        if "D" in found:
            found["D"] = _only(_only(found["D"]))
        if any(not isinstance(row, list | tuple) for row in _listed(found.get("A", []))):
            raise InputError("A: give its rows, [[...], ...]")
        lengths = sorted({len(row) for row in found.get("A", [])})
        if len(lengths) > 1:
            raise InputError(f"A: has rows of {lengths[0]} and of {lengths[-1]} numbers; give n rows of n")
        for key, shape in (("B", "n numbers or n rows of one"), ("C", "n numbers or one row of n")):
            if any(isinstance(entry, list) for entry in found.get(key, ())):
                raise InputError(f"{key}: is not of one input and one output; give {shape}")
        return found

    @cached_property
    def system(self) -> LinearController:
        return StateSpaceController(self.A, self.B, self.C, self.D, self._own_period)


def _listed(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _only(value: Any) -> Any:
    """The entry of a list of one; else the value."""
    return value[0] if isinstance(value, list | tuple) and len(value) == 1 else value
