"""Rule-based wheel slide protection."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Self

from pydantic import model_validator

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.vehicle import Record, Vehicle

from .base import LEAST_PERIOD, Controller
from .linear import adhesion_share, full_brake_torque


class SlideProtection(Controller):
    """The valve dumps where the slip is above `dump_slip` or the wheel decelerates by more than `dump_deceleration`,
    fills where the slip is below `fill_slip`, and holds in between; the torque asked for moves by `fill_rate` and
    `dump_rate` between 0 and `torque_max`, which a driver's full brake asks for. `reference` only judges the slip, if
    it is given.

    The defaults are a baseline: slips and deceleration of the size that wheel slide protection in service acts on
    (slips of 5 to 30 %), the rates slow enough for the published brake's lag and dead time that the wheel does not lock
    in either built-in scenario. InputError unless fill_slip < dump_slip.
    """

    kind: ClassVar[str] = "slide-protection"
    title: ClassVar[str] = "rule-based slide protection: dump, hold or fill"
    source: ClassVar[str] = "[Park2008] Fig. 3"
    no_loop: ClassVar[str] = "its valve has three positions, and it is not linear"
    follows_reference: ClassVar[bool] = False
    by_rule: ClassVar[bool] = True

    period: float | None = quantity("s", "sampling period", ge=LEAST_PERIOD, default=0.01)
    reference: ReferenceSlip | None = None
    radius: float | None = quantity("m", "wheel radius that it believes; the vehicle's if left out", gt=0, default=None)
    fill_slip: float = quantity("1", "slip to fill below", gt=0, lt=1, default=0.05)
    dump_slip: float = quantity("1", "slip to dump above", gt=0, lt=1, default=0.15)
    dump_deceleration: float = quantity("m/s^2", "wheel deceleration to dump above", gt=0, default=4.5)
    fill_rate: float = quantity("N*m/s", "rate of filling", gt=0, default=2000.0)
    dump_rate: float = quantity("N*m/s", "rate of dumping", gt=0, default=16000.0)
    torque_max: float = quantity("N*m", "full brake", gt=0, default=9000.0)
    filter_time: float = quantity("s", "filter of the deceleration", gt=0, default=0.02)

    class State(Record):
        """Valve, filter and torque; it begins released, and takes the wheel's speed at the first sample."""

        torque_asked: float = quantity("N*m", "torque asked for", default=0.0)
        filtered_rim_speed: float = quantity("m/s", "filtered wheel speed r omega", default=0.0)
        started: float = quantity("1", "1 after the first sample", default=0.0)
        valve: float = quantity("1", "-1 dumps, 0 holds, 1 fills", default=1.0)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.fill_slip < self.dump_slip:
            raise InputError(
                f"slide protection: slips {self.fill_slip:g} and {self.dump_slip:g} are not allowed; give "
                "0 < fill_slip < dump_slip < 1"
            )
        return self

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """The valve's position by slip and wheel deceleration, and the torque that it moves."""
        speed = measurement.train_speed
        rim = parameters.radius * measurement.wheel_speed
        if not (math.isfinite(speed) and math.isfinite(rim)):
            return state.torque_asked
        if state.started == 0.0:
            state.filtered_rim_speed, state.started = rim, 1.0
        blend = parameters.period / (parameters.period + parameters.filter_time)
        deceleration = (state.filtered_rim_speed - rim) / (parameters.period + parameters.filter_time)
        state.filtered_rim_speed += blend * (rim - state.filtered_rim_speed)
        slip = (speed - rim) / speed if speed > 0.0 else 0.0
        if slip > parameters.dump_slip or deceleration > parameters.dump_deceleration:
            state.valve = -1.0
        elif slip < parameters.fill_slip:
            state.valve = 1.0
        else:
            state.valve = 0.0
        if state.valve < 0.0:
            state.torque_asked -= parameters.dump_rate * parameters.period
        elif state.valve > 0.0:
            state.torque_asked += parameters.fill_rate * parameters.period
        state.torque_asked = min(max(state.torque_asked, 0.0), parameters.torque_max)
        return state.torque_asked

    def described(self) -> str:
        return (
            f"{self.label}, fills below slip {self.fill_slip:g} by {self.fill_rate:g} N·m/s, dumps above "
            f"{self.dump_slip:g} or {self.dump_deceleration:g} m/s² by {self.dump_rate:g} N·m/s"
        )

    def limits_described(self) -> str:
        return f"{super().limits_described()}, filter of deceleration {self.filter_time:g} s"

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Its rates and full brake in proportion to what the vehicle's adhesion can take; the slips as they are."""
        share, fields = adhesion_share(vehicle, vehicle.wheel_load), cls.model_fields
        rates = {name: share * fields[name].default for name in ("fill_rate", "dump_rate")}
        return cls(**{**rates, "torque_max": full_brake_torque(vehicle), **given}).believing(vehicle)
