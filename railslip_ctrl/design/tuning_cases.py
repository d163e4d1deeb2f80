"""Tuning at named operating points, with the structures that the command offers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.model.vehicle import Actuator, PIGains

from .controllers import PIController, actuated_plant
from .tuning import PIDesign, Specification, tune_pi

STRUCTURES = ("pi", "pi-lead", "pid")
_LEAD_FACTORS = (0.3, 0.5, 0.8, 1.2, 1.8, 3.0)  # derivative times looked at first, over the actuator's lag
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
        goal = "maximise ki" if self.ki_min is None else f"minimise Ms with ki >= {self.ki_min:g} N*m/m"
        return ", ".join(filter(None, [goal, self.specification.words]))

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
        (Td s + 1)/(Tf s + 1) with Td searched between 0.3 and 3 times the actuator's lag.
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
        raise InputError(f"--structure: {structure!r} is not known; choose one of {', '.join(STRUCTURES)}")
    if structure == "pi" and (lead is not None or lead_filter is not None):
        raise InputError("--lead: does not go with structure 'pi'; choose 'pi-lead' or 'pid'")
    if structure == "pid" and lead is not None:
        raise InputError("--lead: structure 'pid' searches its derivative time itself; choose 'pi-lead' to fix it")
    if structure == "pid":
        return _searched(plants, actuator, specification, ki_min, lead_filter)
    time = 0.0 if structure == "pi" else (lead if lead is not None else actuator.lag)
    return _tune(plants, actuator, structure, specification, ki_min, time, _filter(time, lead_filter))


def _filter(lead: float, given: float | None) -> float:
    return given if given is not None else FILTER_RATIO * lead


def _cost(tuned: TunedCases) -> float:
    """What the specification minimises: Ms, or minus ki."""
    if tuned.design is None:
        return math.inf
    return -tuned.design.ki if tuned.ki_min is None else tuned.design.worst.ms


def _searched(
    plants: Sequence[LinearPlant],
    actuator: Actuator,
    specification: Specification,
    ki_min: float | None,
    lead_filter: float | None,
) -> TunedCases:
    """PID: the derivative time that serves the specification best, between 0.3 and 3 times the actuator's lag."""
    from scipy.optimize import minimize_scalar

    base = actuator.lag or actuator.dead_time or 1.0
    tried: dict[float, TunedCases] = {}

    def at(log_time: float) -> TunedCases:
        if log_time not in tried:
            lead = math.exp(log_time)
            tried[log_time] = _tune(plants, actuator, "pid", specification, ki_min, lead, _filter(lead, lead_filter))
        return tried[log_time]

    grid = [math.log(base * factor) for factor in _LEAD_FACTORS]
    best = min(range(len(grid)), key=lambda i: _cost(at(grid[i])))
    if at(grid[best]).design is None:
        return at(grid[len(grid) // 2])
    ends = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    minimize_scalar(lambda x: min(_cost(at(float(x))), 1e30), bounds=ends, method="bounded", options={"xatol": 2e-3})
    return min(tried.values(), key=_cost)


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
            names=[plant.point.words for plant in plants],
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
