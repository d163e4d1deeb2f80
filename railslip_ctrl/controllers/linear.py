"""Linear controllers: sampled, with torque limits, with anti-windup, and with a constant torque at low speed."""

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
from .systems import LinearController, PolynomialController, StateSpaceController, describe_system

TORQUE_LIMIT = 9000.0  #: N*m, full brake torque of the vehicle of [Park2008]: twice that at an adhesion of 0.3
_MOST_COEFFICIENTS = 12  # largest number of coefficients of a polynomial on the design page
TRACKING_TIME = 2.0  #: s, of the anti-windup; from 1 to 5 s the braking distance changes by less than 1 %


def full_brake_torque(vehicle: Vehicle) -> float:
    """Return the full brake torque of a vehicle, N*m, the default upper limit of commands.

    `TORQUE_LIMIT` is scaled in proportion to wheel radius times the larger of `wheel_load` and `wheel_load_loaded`.
    """
    return TORQUE_LIMIT * adhesion_share(vehicle, max(vehicle.wheel_load, vehicle.wheel_load_loaded))


def adhesion_share(vehicle: Vehicle, wheel_load: float) -> float:
    """Return wheel radius times `wheel_load`, N, divided by this product for the vehicle of [Park2008]."""
    return wheel_load * vehicle.wheel.radius / (PARK2008.wheel_load * PARK2008.wheel.radius)


class LinearControl(Controller):
    """Base class of the linear controllers, whose input is the slip error e = lambda_d v - sigma, m/s.

    `sampled.SampledController` converts the controller to difference equations. Below `hand_over_speed` the controller
    commands `hand_over_torque` without slip control. InputError: torque_min >= torque_max, or a period or
    tracking time that `SampledController` does not allow.
    """

    source: ClassVar[str] = "[Astrom1997] 8, 9"

    period: float | None = quantity("s", "sampling period; integration step if left out", ge=LEAST_PERIOD, default=None)
    radius: float | None = quantity("m", "assumed wheel radius; the vehicle's if left out", gt=0, default=None)
    torque_min: float | None = quantity("N*m", "smallest torque; none if left out", default=None)
    torque_max: float | None = quantity("N*m", "largest torque; none if left out", default=None)
    anti_windup: bool = Field(True, description="whether the states are corrected while the torque is limited")
    tracking_time: float | None = quantity(
        "s", "tracking time of the anti-windup; that of the slowest zero if left out", gt=0, default=None
    )
    initial_torque: float = quantity("N*m", "torque at the start", default=0.0)
    hand_over_speed: float = quantity("m/s", "train speed below which slip is not controlled", ge=0, default=0.0)
    hand_over_torque: float = quantity("N*m", "torque below this speed", default=0.0)
    rule: Rule = Field(Rule.BACKWARD, description="rule that converts the system to a difference equation")

    class State(Record):
        """States of the difference equations, and slip error and torque of the previous sample."""

        error: float = quantity("m/s", "slip error of the previous sample", default=0.0)
        unlimited_torque: float = quantity("N*m", "torque of the previous sample, without limits", default=0.0)
        states: tuple[float, ...] = quantity("1", "states of the difference equations", default=())
        room: tuple[float, ...] = quantity("1", "temporary values of the next states", default=())

    class Parameters(Record):
        """Parameters of `step`: coefficients of the difference equations, torque limits, hand-over speed and torque."""

        radius: float = quantity("m", "wheel radius")
        hand_over_speed: float = quantity("m/s", "speed below which slip is not controlled")
        hand_over_torque: float = quantity("N*m", "torque below this speed")
        torque_min: float = quantity("N*m", "smallest torque")
        torque_max: float = quantity("N*m", "largest torque")
        direct: float = quantity("N*m/(m/s)", "gain from the error to the torque")
        output: tuple[float, ...] = quantity("1", "gains from the states to the torque")
        now: tuple[float, ...] = quantity("1", "gains from the error to the states")
        before: tuple[float, ...] = quantity("1", "gains from the previous error to the states")
        tracking: tuple[float, ...] = quantity("1", "gains from applied minus unlimited torque to the states")
        transition: tuple[float, ...] = quantity("1", "matrix from the states to the next states, by rows")

    @property
    @abstractmethod
    def system(self) -> LinearController:
        """Linear system from slip error (m/s) to torque (N*m)."""

    @model_validator(mode="after")
    def _can_run(self) -> Self:
        _ = self.system, self.as_run
        return self

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """Return the torque by the difference equations; below the hand-over speed return the hand-over torque."""
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
        indices = super().logged(state)
        states = (name for name in indices if name.startswith("states_"))
        named = {name: indices[key] for name, key in zip(state_names(self.system), states, strict=True)}
        return {**named, "error": indices["error"], "unlimited_torque": indices["unlimited_torque"]}

    def linear(self, point: OperatingPoint | None) -> LinearController:
        return self.system

    def sampled(self, period: float) -> SampledController:
        """Return the difference equations for a sampling period, s."""
        tracking = self.tracking_time if self.anti_windup else math.inf
        return SampledController(self.system, period, self.least_torque, self.largest_torque, self.rule, tracking)

    @cached_property
    def as_run(self) -> SampledController | None:
        """Difference equations for the sampling period; None if the period is the integration step of the run."""
        return None if self.period is None else self.sampled(self.period)

    def described(self) -> str:
        return f"{self.label}, {describe_system(self.system)}"

    def limits_described(self) -> str:
        return super().limits_described() + describe_windup(self, self.anti_windup)

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Return the controller with the fields `given`; by default the torque is from 0 to the full brake torque."""
        return cls(**{"torque_min": 0.0, "torque_max": full_brake_torque(vehicle), **given}).believing(vehicle)


def describe_windup(control: Any, anti_windup: bool) -> str:
    """Return text with initial torque, anti-windup and discretisation rule of a linear or scheduled controller."""
    tracking = "by its gains" if control.tracking_time is None else f"{control.tracking_time:g} s"
    windup = tracking if anti_windup else "none"
    return f", initial torque {control.initial_torque:g} N·m, anti-windup {windup}, rule {control.rule.value}"


class SystemControl(LinearControl):
    """Base class of the controllers that are linear systems of any order, continuous or `discrete`."""

    period: float | None = quantity("s", "sampling period", ge=LEAST_PERIOD, default=PERIOD)
    rule: Rule = Field(Rule.TUSTIN, description="rule that converts a continuous system to a difference equation")
    discrete: bool = Field(False, description="whether the system is discrete with this sampling period")

    def gain_values(self) -> dict[str, Any]:
        numbers = {name: value for name, value in asdict(self.system).items() if value is not None}
        return {"structure": self.system.structure, **numbers}

    @property
    def _own_period(self) -> float | None:
        return self.period if self.discrete else None


class TransferFunction(SystemControl):
    """Transfer function C = num/den, with coefficients of descending powers of s, or of z if discrete."""

    kind: ClassVar[str] = "transfer-function"
    title: ClassVar[str] = "ratio of polynomials"

    num: tuple[float, ...] = quantity("1", "numerator, N*m for m/s")
    den: tuple[float, ...] = quantity("1", "denominator")

    @cached_property
    def system(self) -> LinearController:
        for name, coefficients in (("num", self.num), ("den", self.den)):
            if not coefficients:
                raise InputError(f"{name}: the list is empty; give at least one coefficient")
        return PolynomialController(self.num, self.den, self._own_period)

    def design_numbers(self) -> list[DesignNumber]:
        """Return the coefficients, named b0, b1, ... in num and a0, a1, ... in den by the power of s or z."""
        parts = {"b": self.num, "a": self.den}
        return [
            DesignNumber(f"{letter}{power}", value, "1", f"coefficient of the power {power}")
            for letter, part in parts.items()
            for power, value in zip(range(len(part) - 1, -1, -1), part, strict=True)
        ]

    def with_design_numbers(self, values: Mapping[str, float], **others: Any) -> Self:
        """Return a transfer function with the coefficients `values`, whose keys are the names from `design_numbers`.

        Coefficients that are not in `values` are 0. `others` are new values of fields other than num and den.
        """
        powers: dict[str, dict[int, float]] = {"b": {}, "a": {}}
        for name, value in values.items():
            letter, power = name[:1], name[1:]
            if letter not in powers or not (
                power.isascii() and power.isdigit() and int(power[:3]) < _MOST_COEFFICIENTS
            ):
                last = _MOST_COEFFICIENTS - 1
                raise InputError(f"{shown(name)} is not a coefficient; give b0 to b{last} and a0 to a{last}")
            powers[letter][int(power)] = value
        num, den = (tuple(part.get(i, 0.0) for i in range(max(part, default=0), -1, -1)) for part in powers.values())
        return super().with_design_numbers({}, num=num, den=den, **others)


class StateSpace(SystemControl):
    """State-space controller x' = A x + B e, torque = C x + D e, SI; if discrete, x' is the next x.

    Keys in lower case, B as a column, C and D as rows, and a single number without brackets are also accepted.
    """

    kind: ClassVar[str] = "state-space"
    title: ClassVar[str] = "linear system by its matrices"

    A: tuple[tuple[float, ...], ...] = quantity("1", "state matrix by rows")
    B: tuple[float, ...] = quantity("1", "gains from the error to the rates of the states")
    C: tuple[float, ...] = quantity("1", "gains from the states to the torque")
    D: float = quantity("1", "gain from the error to the torque", default=0.0)

    @model_validator(mode="before")
    @classmethod
    def _as_matrices(cls, content: dict[str, Any]) -> dict[str, Any]:
        keys = {key.upper() if key in ("a", "b", "c", "d") else key: value for key, value in content.items()}
        if len(keys) < len(content):
            raise InputError("A, B, C, D: the same matrix is given in upper and in lower case; give it once")
        if isinstance(keys.get("A"), int | float):
            keys["A"] = [[keys["A"]]]
        if "B" in keys:
            keys["B"] = [_single(row) for row in _listed(keys["B"])]
        if "C" in keys:
            keys["C"] = _listed(_single(keys["C"]))
        if "D" in keys:
            keys["D"] = _single(_single(keys["D"]))
        if any(not isinstance(row, list | tuple) for row in _listed(keys.get("A", []))):
            raise InputError("A: the value is not a list of rows; give [[...], ...]")
        lengths = sorted({len(row) for row in keys.get("A", [])})
        if len(lengths) > 1:
            raise InputError(f"A: some rows have {lengths[0]} numbers, others {lengths[-1]}; give n rows of n numbers")
        for key, shape in (("B", "n numbers or n rows of one number"), ("C", "n numbers or one row of n numbers")):
            if any(isinstance(entry, list) for entry in keys.get(key, ())):
                raise InputError(f"{key}: the matrix has several inputs or outputs; give {shape}")
        return keys

    @cached_property
    def system(self) -> LinearController:
        return StateSpaceController(self.A, self.B, self.C, self.D, self._own_period)


def _listed(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _single(value: Any) -> Any:
    return value[0] if isinstance(value, list | tuple) and len(value) == 1 else value
