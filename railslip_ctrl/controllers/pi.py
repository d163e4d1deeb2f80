"""PI controller, PI with a lead, and PID in series form."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, Self

from railslip_ctrl.core.errors import InfeasibleDesignError
from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.vehicle import Actuator, PIGains, Vehicle

from .base import DesignNumber
from .linear import LinearControl
from .systems import PIController

FILTER_RATIO = 0.1  #: default time constant of the filter over that of the lead: the usual N = 10 of a PID


class PI(LinearControl):
    """PI controller C(s) = (kp + ki/s) (lead s + 1)/(lead_filter s + 1), by default without lead and filter."""

    kind: ClassVar[str] = "pi"
    title: ClassVar[str] = "PI"

    kp: float = quantity("N*m/(m/s)", "proportional gain")
    ki: float = quantity("N*m/m", "integral gain")
    lead: float = quantity("s", "time constant of the lead", ge=0, default=0.0)
    lead_filter: float = quantity("s", "time constant of the lead's filter", ge=0, default=0.0)

    @cached_property
    def system(self) -> PIController:
        return PIController(PIGains(kp=self.kp, ki=self.ki), self.lead, self.lead_filter)

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Return the controller with the fields `given`; InfeasibleDesignError if kp or ki is not among them."""
        if not {"kp", "ki"} <= given.keys():
            raise InfeasibleDesignError(
                f"controller {cls.kind}: no rule gives kp and ki for a vehicle; tune the controller, or give kp and ki"
            )
        return super().for_vehicle(vehicle, **given)

    def design_numbers(self) -> list[DesignNumber]:
        """Return the numbers that a user tunes: kp, ki, and the time constants of lead and filter that are not 0."""
        return [number for number in super().design_numbers() if number.value or number.name in ("kp", "ki")]

    def headline(self) -> str:
        lead = f", lead {self.lead:.4g}/{self.lead_filter:.4g} s" if self.lead > 0 else ""
        return f"{self.system.structure}: kp {self.kp:.4g} N·m/(m/s), ki {self.ki:.4g} N·m/m{lead}"

    def gain_values(self) -> dict[str, Any]:
        return {"kp_si": self.kp, "ki_si": self.ki, "lead_s": self.lead, "lead_filter_s": self.lead_filter}

    @classmethod
    def compensator(cls, actuator: Actuator, lead: float | None, lead_filter: float | None) -> PIController:
        """Return the transfer function of lead and filter, which stays fixed while kp and ki are tuned.

        `lead` and `lead_filter` are time constants, s; None means 0. For a PI-lead, None means the lag of the
        `actuator` for the lead, and `FILTER_RATIO` times the lead for the filter.
        """
        return PIController(PIGains(kp=1.0, ki=0.0), lead or 0.0, lead_filter or 0.0)


class PILead(PI):
    """PI with a lead; by default, tuning sets the lead to the brake's lag and the filter to a tenth of this lag."""

    kind: ClassVar[str] = "pi-lead"
    title: ClassVar[str] = "PI with a lead on the actuator's lag"

    lead: float = quantity("s", "time constant of the lead", gt=0)
    lead_filter: float = quantity("s", "time constant of the lead's filter", gt=0)

    @classmethod
    def compensator(cls, actuator: Actuator, lead: float | None, lead_filter: float | None) -> PIController:
        lead = actuator.lag if lead is None else lead
        return PIController(PIGains(kp=1.0, ki=0.0), lead, FILTER_RATIO * lead if lead_filter is None else lead_filter)


class PID(PILead):
    """PID in series form: a PI-lead for which tuning also searches the lead (the derivative time)."""

    kind: ClassVar[str] = "pid"
    title: ClassVar[str] = "PID in series form"


def pi_control(design: PIController, kind: type[PI] | None = None, **fields: Any) -> PI:
    """Return a PI design as a controller of class `kind`, by default `PILead` for a design with a lead, else `PI`."""
    kind = kind or (PILead if design.lead > 0 else PI)
    times = {"lead": design.lead, "lead_filter": design.lead_filter}
    return kind(kp=design.gains.kp, ki=design.gains.ki, **times, **fields)
