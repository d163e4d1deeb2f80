"""Rule-based wheel slide protection by a dump, hold and fill valve."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Self

from pydantic import model_validator

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.adhesion.base import RANDOM_SHARE
from railslip_ctrl.model.vehicle import GRAVITY, Record, Vehicle

from .base import LEAST_PERIOD, Controller
from .linear import full_brake_torque

_WEAK_RAIL, _BEST_RAIL = 0.05, 0.35  # adhesion coefficients of a very slippery rail and of the best rail
_DUMPED = 0.8  # torque dumped in dead time plus lag over load times radius: 0.35 of the best rail, 0.45 for the wheel
_FILTER_TIME = 0.05  # s, default time constant of the wheel-speed filter


class SlideProtection(Controller):
    """Slide protection with a valve: it dumps at large slip, fills at small slip, and holds the torque in between.

    The valve dumps if the slip is above `dump_slip`, or if it is above `fill_slip` and the wheel decelerates by more
    than `dump_deceleration`. It fills if the slip is below `fill_slip`, and otherwise holds. The commanded torque rises
    at `fill_rate` or falls at `dump_rate`, and stays between 0 and `torque_max`, the full brake. `reference` is
    optional and used only to judge the slip. The default slips are in the range in which wheel slide protection in
    service acts (5 to 30 %). InputError unless fill_slip < dump_slip.
    """

    kind: ClassVar[str] = "slide-protection"
    title: ClassVar[str] = "rule-based slide protection: dump, hold or fill"
    source: ClassVar[str] = "[Park2008] Fig. 3"
    no_loop: ClassVar[str] = "a valve with three positions is not linear"
    follows_reference: ClassVar[bool] = False
    by_rule: ClassVar[bool] = True

    period: float | None = quantity("s", "sampling period", ge=LEAST_PERIOD, default=0.01)
    reference: ReferenceSlip | None = None
    radius: float | None = quantity("m", "assumed wheel radius; the vehicle's if left out", gt=0, default=None)
    fill_slip: float = quantity("1", "slip below which the valve fills", gt=0, lt=1, default=0.07)
    dump_slip: float = quantity("1", "slip above which the valve dumps", gt=0, lt=1, default=0.15)
    dump_deceleration: float = quantity("m/s^2", "wheel deceleration above which the valve dumps", gt=0, default=4.75)
    fill_rate: float = quantity("N*m/s", "rate of filling", gt=0, default=989.0)
    dump_rate: float = quantity("N*m/s", "rate of dumping", gt=0, default=15824.0)
    torque_max: float = quantity("N*m", "torque of the full brake", gt=0, default=9000.0)
    filter_time: float = quantity("s", "time constant of the wheel-speed filter", gt=0, default=_FILTER_TIME)

    class State(Record):
        """State of the controller; initially the torque is 0, and the first sample sets the filtered wheel speed."""

        torque_asked: float = quantity("N*m", "commanded torque", default=0.0)
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
        """Set the valve according to slip and wheel deceleration, and return the commanded torque, N*m."""
        speed = measurement.train_speed
        rim = parameters.radius * measurement.wheel_speed
        if not (math.isfinite(speed) and math.isfinite(rim)):
            return state.torque_asked
        if state.started == 0.0:
            state.filtered_rim_speed, state.started = rim, 1.0
        blend = parameters.period / (parameters.period + parameters.filter_time)
        deceleration = (state.filtered_rim_speed - rim) / (parameters.period + parameters.filter_time)
        state.filtered_rim_speed += blend * (rim - state.filtered_rim_speed)
        slip = (speed - state.filtered_rim_speed) / speed if speed > 0.0 else 0.0
        slides = slip > parameters.fill_slip and deceleration > parameters.dump_deceleration
        if slip > parameters.dump_slip or slides:
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
        return f"{super().limits_described()}, wheel-speed filter {self.filter_time:g} s"

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Return the controller with thresholds and rates for a vehicle.

        The brake reacts to a slide after its dead time plus its lag. In this time, filling raises the torque by 0.05
        times wheel load times radius, which the adhesion of a very slippery rail can transmit. Dumping lowers the
        torque by 0.8 times wheel load times radius. `dump_deceleration` is the sum of the train's deceleration on the
        best rail (0.35 g) and the deceleration of the rim by a random force of 0.0125 times the wheel load ([Park2008]
        p. 55). The filter attenuates oscillations of the wheel speed that are not slides.
        """
        wheel, actuator = vehicle.wheel, vehicle.actuator
        time = actuator.dead_time + actuator.lag or cls.model_fields["period"].default
        most = vehicle.wheel_load * wheel.radius
        shaken = RANDOM_SHARE * vehicle.wheel_load * wheel.radius**2 / wheel.inertia
        rules = {
            "fill_rate": _WEAK_RAIL * most / time,
            "dump_rate": _DUMPED * most / time,
            "dump_deceleration": round(_BEST_RAIL * GRAVITY + shaken, 2),
            "torque_max": full_brake_torque(vehicle),
        }
        return cls(**{**rules, **given}).believing(vehicle)
