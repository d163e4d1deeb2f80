"""railslip_ctrl: wheel-slip control design for trains.

The names below load on first use, so that importing the package, or running a command, costs only what it needs. What
is not here is in the rooms, each a package whose docstring says where to begin, from the ground up: `core`, `model`,
`loop`, `sliding`, `design`, `simulation`, `verification`, `identification`, `paper`, `report`, `cli`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .core.errors import DomainError as DomainError
    from .core.errors import InfeasibleDesignError as InfeasibleDesignError
    from .core.errors import InputError as InputError
    from .core.errors import KinkError as KinkError
    from .core.errors import MissingParametersError as MissingParametersError
    from .core.errors import RailslipError as RailslipError
    from .core.errors import UnstableLoopError as UnstableLoopError
    from .design import CommonPI as CommonPI
    from .design import IntersectionRegion as IntersectionRegion
    from .design import PIController as PIController
    from .design import actuated_plant as actuated_plant
    from .design import common_pi as common_pi
    from .design import gain_for_crossover as gain_for_crossover
    from .design import intersection as intersection
    from .design import most_phase as most_phase
    from .design import stabilizing_pi as stabilizing_pi
    from .design import wheel_slip_loop as wheel_slip_loop
    from .design.assessment import Assessment as Assessment
    from .design.assessment import assess as assess
    from .design.envelope import Envelope as Envelope
    from .design.envelope import load_envelope as load_envelope
    from .design.envelope_tuning import tune as tune
    from .design.judging import Judgement as Judgement
    from .design.judging import judge as judge
    from .design.limits import fundamental_limits as fundamental_limits
    from .design.schedule import plant_at as plant_at
    from .design.tuning import tune_pi as tune_pi
    from .loop import DeadTimeLoop as DeadTimeLoop
    from .loop import Margins as Margins
    from .model.adhesion import ReferenceSlip as ReferenceSlip
    from .model.adhesion import load_law as load_law
    from .model.adhesion import published_law as published_law
    from .model.linearization import LinearPlant as LinearPlant
    from .model.linearization import linearize as linearize
    from .model.linearization import nonlinear_plant as nonlinear_plant
    from .model.linearization import operating_point as operating_point
    from .model.vehicle import PARK2008 as PARK2008
    from .model.vehicle import Actuator as Actuator
    from .model.vehicle import PIGains as PIGains
    from .model.vehicle import Rail as Rail
    from .model.vehicle import Vehicle as Vehicle
    from .model.vehicle_files import load_vehicle as load_vehicle
    from .simulation import LinearControl as LinearControl
    from .simulation import Scenario as Scenario
    from .simulation import StepControl as StepControl
    from .simulation import built_in_scenario as built_in_scenario
    from .simulation import simulate as simulate
    from .simulation import stop as stop
    from .simulation.campaign.statistics import campaign as campaign
    from .simulation.catalogue import slide_protection as slide_protection
    from .simulation.controller_files import load_controller as load_controller
    from .simulation.run_comparison import compare_runs as compare_runs
    from .simulation.scenario import load_scenario as load_scenario
    from .sliding.derivation import derive as derive

__version__ = "0.1.0"

_HOME = {
    "Actuator": ".model.vehicle",
    "Assessment": ".design.assessment",
    "CommonPI": ".design",
    "DeadTimeLoop": ".loop",
    "DomainError": ".core.errors",
    "Envelope": ".design.envelope",
    "InfeasibleDesignError": ".core.errors",
    "InputError": ".core.errors",
    "IntersectionRegion": ".design",
    "Judgement": ".design.judging",
    "KinkError": ".core.errors",
    "LinearControl": ".simulation",
    "LinearPlant": ".model.linearization",
    "Margins": ".loop",
    "MissingParametersError": ".core.errors",
    "PARK2008": ".model.vehicle",
    "PIController": ".design",
    "PIGains": ".model.vehicle",
    "Rail": ".model.vehicle",
    "RailslipError": ".core.errors",
    "ReferenceSlip": ".model.adhesion",
    "Scenario": ".simulation",
    "StepControl": ".simulation",
    "UnstableLoopError": ".core.errors",
    "Vehicle": ".model.vehicle",
    "actuated_plant": ".design",
    "assess": ".design.assessment",
    "built_in_scenario": ".simulation",
    "campaign": ".simulation.campaign.statistics",
    "common_pi": ".design",
    "compare_runs": ".simulation.run_comparison",
    "derive": ".sliding.derivation",
    "fundamental_limits": ".design.limits",
    "gain_for_crossover": ".design",
    "intersection": ".design",
    "judge": ".design.judging",
    "linearize": ".model.linearization",
    "load_controller": ".simulation.controller_files",
    "load_envelope": ".design.envelope",
    "load_law": ".model.adhesion",
    "load_scenario": ".simulation.scenario",
    "load_vehicle": ".model.vehicle_files",
    "most_phase": ".design",
    "nonlinear_plant": ".model.linearization",
    "operating_point": ".model.linearization",
    "plant_at": ".design.schedule",
    "published_law": ".model.adhesion",
    "simulate": ".simulation",
    "slide_protection": ".simulation.catalogue",
    "stabilizing_pi": ".design",
    "stop": ".simulation",
    "tune": ".design.envelope_tuning",
    "tune_pi": ".design.tuning",
    "wheel_slip_loop": ".design",
}

__all__ = [
    "PARK2008",
    "Actuator",
    "Assessment",
    "CommonPI",
    "DeadTimeLoop",
    "DomainError",
    "Envelope",
    "InfeasibleDesignError",
    "InputError",
    "IntersectionRegion",
    "Judgement",
    "KinkError",
    "LinearControl",
    "LinearPlant",
    "Margins",
    "MissingParametersError",
    "PIController",
    "PIGains",
    "Rail",
    "RailslipError",
    "ReferenceSlip",
    "Scenario",
    "StepControl",
    "UnstableLoopError",
    "Vehicle",
    "__version__",
    "actuated_plant",
    "assess",
    "built_in_scenario",
    "campaign",
    "common_pi",
    "compare_runs",
    "derive",
    "fundamental_limits",
    "gain_for_crossover",
    "intersection",
    "judge",
    "linearize",
    "load_controller",
    "load_envelope",
    "load_law",
    "load_scenario",
    "load_vehicle",
    "most_phase",
    "nonlinear_plant",
    "operating_point",
    "plant_at",
    "published_law",
    "simulate",
    "slide_protection",
    "stabilizing_pi",
    "stop",
    "tune",
    "tune_pi",
    "wheel_slip_loop",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name], __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
