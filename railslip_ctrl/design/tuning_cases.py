"""Tuning at named operating points, with the structures that the command offers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from railslip_ctrl.errors import InfeasibleDesignError, InputError
from railslip_ctrl.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.parameters import Actuator, PIGains

from .controllers import PIController, actuated_plant
from .tuning import PIDesign, Specification, tune_pi

STRUCTURES = ("pi", "pi-lead", "pid")
FILTER_RATIO = 0.1
"""Time constant of a lead's filter over that of the lead, unless given: the high-frequency gain is 10 times kp."""


@dataclass(frozen=True)
class TunedCases:
    """What was asked of a structure at some operating points, and the design, or None and the reason."""

    structure: str
    points: tuple[OperatingPoint, ...]
    specification: Specification
    ki_min: float | None
    lead: float
    lead_filter: float
    design: PIDesign | None
    reason: str

    @property
    def asked(self) -> str:
        """The specification in words."""
        s = self.specification
        parts = ["maximise ki" if self.ki_min is None else f"minimise Ms with ki >= {self.ki_min:g} N*m/m"]
        if s.ms_max is not None:
            parts.append(f"Ms <= {s.ms_max:g}")
        if s.phase_min_deg is not None:
            parts.append(f"phase margin >= {s.phase_min_deg:g} deg")
        if s.delay_min_s is not None:
            parts.append(f"delay margin >= {s.delay_min_s:g} s")
        return ", ".join(parts)

    def controller(self, design: PIDesign) -> PIController:
        """The controller with the design's gains."""
        return PIController(PIGains(kp=design.kp, ki=design.ki), self.lead, self.lead_filter)


def tune_cases(
    plants: Sequence[LinearPlant],
    actuator: Actuator,
    *,
    structure: str = "pi",
    specification: Specification,
    ki_min: float | None = None,
    lead: float | None = None,
    lead_filter: float | None = None,
) -> TunedCases:
    """Tune one controller for all the plants; an infeasible specification is a result, with its reason.

    Parameters
    ----------
    structure : {"pi", "pi-lead", "pid"}
        PI; PI with a lead at the actuator's lag (or `lead`, s); or PID in the series form (kp + ki/s)
        (Td s + 1)/(Tf s + 1) with Td searched as well.
    ki_min : float
        Given: minimise the worst Ms with ki at least this, N*m/m. None: maximise ki.
    lead_filter : float
        s; a tenth of the lead if not given.

    Raises
    ------
    InputError
        Unknown structure, a lead for a plain PI, or a contradictory specification.
    """
    if structure not in STRUCTURES:
        raise InputError(f"structure: {structure!r} is not known; choose one of {', '.join(STRUCTURES)}")
    if structure == "pi" and (lead is not None or lead_filter is not None):
        raise InputError("lead: does not go with structure 'pi'; choose 'pi-lead' or 'pid'")
    if structure == "pid" and lead is not None:
        raise InputError("lead: structure 'pid' searches its derivative time itself; choose 'pi-lead' to fix it")
    times = [0.0] if structure == "pi" else [lead if lead is not None else actuator.lag]
    if structure == "pid":
        base = actuator.lag or actuator.dead_time
        times = [base * factor for factor in (0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0)]
    tried = [_tune(plants, actuator, structure, specification, ki_min, t, _filter(t, lead_filter)) for t in times]
    feasible = [t for t in tried if t.design is not None]
    if structure == "pid" and feasible:
        best = min(feasible, key=_cost)
        return _refined(plants, actuator, specification, ki_min, best, lead_filter)
    return feasible[0] if feasible else tried[len(tried) // 2]


def _filter(lead: float, given: float | None) -> float:
    return given if given is not None else FILTER_RATIO * lead


def _cost(tuned: TunedCases) -> float:
    """What the specification minimises: Ms, or minus ki."""
    if tuned.design is None:
        return math.inf
    return -tuned.design.ki if tuned.ki_min is None else tuned.design.worst.ms


def _refined(
    plants: Sequence[LinearPlant],
    actuator: Actuator,
    specification: Specification,
    ki_min: float | None,
    best: TunedCases,
    lead_filter: float | None,
) -> TunedCases:
    """A finer search of the derivative time around the best one found."""
    tried = [best]
    for factor in (0.86, 0.93, 1.08, 1.16):
        lead = best.lead * factor
        tried.append(_tune(plants, actuator, "pid", specification, ki_min, lead, _filter(lead, lead_filter)))
    return min(tried, key=_cost)


def _tune(
    plants: Sequence[LinearPlant],
    actuator: Actuator,
    structure: str,
    specification: Specification,
    ki_min: float | None,
    lead: float,
    lead_filter: float,
) -> TunedCases:
    compensator = PIController(PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function
    design, reason = None, ""
    try:
        design = tune_pi(
            [actuated_plant(plant, actuator) for plant in plants],
            actuator.dead_time,
            ms_max=specification.ms_max,
            phase_min_deg=specification.phase_min_deg,
            delay_min_s=specification.delay_min_s,
            minimise_ms=ki_min is not None,
            ki_min=ki_min,
            compensator=compensator,
        )
    except InfeasibleDesignError as error:
        reason = str(error)
    return TunedCases(
        structure,
        tuple(plant.point for plant in plants),
        specification,
        ki_min,
        lead,
        lead_filter,
        design,
        reason,
    )
