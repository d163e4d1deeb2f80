"""Open-loop controller that commands a given torque over time."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, ClassVar, Self

from pydantic import model_validator

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.adhesion import ReferenceSlip

from .base import Controller


class TorqueProfile(Controller):
    """Open-loop torque over time, linear between the given points, and constant before the first and after the last.

    `reference` is optional and used only to judge the slip. InputError: empty lists, lists of different lengths, or
    times that do not increase.
    """

    kind: ClassVar[str] = "torque-profile"
    title: ClassVar[str] = "torque over time, open loop"
    source: ClassVar[str] = "this project"
    no_loop: ClassVar[str] = "it has no feedback"
    follows_reference: ClassVar[bool] = False

    reference: ReferenceSlip | None = None
    times: tuple[float, ...] = quantity("s", "times, rising")
    torques: tuple[float, ...] = quantity("N*m", "torques at these times")

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if not self.times or len(self.times) != len(self.torques):
            raise InputError(
                f"torque profile: the lists have {len(self.times)} times and {len(self.torques)} torques; give as many "
                "times as torques"
            )
        for earlier, later in pairwise(self.times):
            if not later > earlier:
                raise InputError(
                    f"torque profile: time {later:g} s after {earlier:g} s is not allowed; give rising times"
                )
        return self

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """Return the torque of the profile at the time of the sample, N*m."""
        last = len(parameters.times) - 1
        if measurement.time <= parameters.times[0]:
            return parameters.torques[0]
        i = 0
        while i < last and measurement.time >= parameters.times[i + 1]:
            i += 1
        if i >= last:
            return parameters.torques[last]
        share = (measurement.time - parameters.times[i]) / (parameters.times[i + 1] - parameters.times[i])
        return parameters.torques[i] + share * (parameters.torques[i + 1] - parameters.torques[i])

    def described(self) -> str:
        count, least, most = len(self.times), min(self.torques), max(self.torques)
        return f"{self.label}, torque over time: {count} points, {least:g} to {most:g} N·m"

    def gain_values(self) -> dict[str, Any]:
        return {}
