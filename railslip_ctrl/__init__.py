"""railslip_ctrl: wheel-slip control design for trains.

The names below load on first use, so that importing the package, or running a command, costs only what it needs. What
is not here is in the packages: `loop`, `design`, `sliding`, `switching`, `simulation`, `reproduction`, `campaign`,
`observer`, `identification`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .adhesion import ReferenceSlip as ReferenceSlip
    from .adhesion import load_law as load_law
    from .adhesion import published_law as published_law
    from .assessment import Assessment as Assessment
    from .assessment import assess as assess
    from .campaign.execution import campaign as campaign
    from .design import HoldingDesign as HoldingDesign
    from .design import IntersectionRegion as IntersectionRegion
    from .design import PIController as PIController
    from .design import actuated_plant as actuated_plant
    from .design import gain_for_crossover as gain_for_crossover
    from .design import holding_gains as holding_gains
    from .design import intersection as intersection
    from .design import most_phase as most_phase
    from .design import stabilizing_pi as stabilizing_pi
    from .design import wheel_slip_loop as wheel_slip_loop
    from .design.envelope import Envelope as Envelope
    from .design.envelope import load_envelope as load_envelope
    from .design.envelope_tuning import tune as tune
    from .design.judging import Judgement as Judgement
    from .design.judging import judge as judge
    from .design.limits import fundamental_limits as fundamental_limits
    from .design.schedule import plant_at as plant_at
    from .design.tuning import tune_pi as tune_pi
    from .errors import DomainError as DomainError
    from .errors import InfeasibleDesignError as InfeasibleDesignError
    from .errors import InputError as InputError
    from .errors import KinkError as KinkError
    from .errors import MissingParametersError as MissingParametersError
    from .errors import RailslipError as RailslipError
    from .errors import UnstableLoopError as UnstableLoopError
    from .linearization import LinearPlant as LinearPlant
    from .linearization import linearize as linearize
    from .linearization import nonlinear_plant as nonlinear_plant
    from .linearization import operating_point as operating_point
    from .loop import DeadTimeLoop as DeadTimeLoop
    from .loop import Margins as Margins
    from .parameters import PARK2008 as PARK2008
    from .parameters import Actuator as Actuator
    from .parameters import PIGains as PIGains
    from .parameters import Rail as Rail
    from .parameters import Vehicle as Vehicle
    from .parameters import load_vehicle as load_vehicle
    from .run_comparison import compare_runs as compare_runs
    from .simulation import LinearControl as LinearControl
    from .simulation import Scenario as Scenario
    from .simulation import StepControl as StepControl
    from .simulation import built_in_scenario as built_in_scenario
    from .simulation import simulate as simulate
    from .simulation import stop as stop
    from .simulation.controller_files import load_controller as load_controller
    from .simulation.designed import slide_protection as slide_protection
    from .simulation.files import load_scenario as load_scenario
    from .sliding.derivation import derive as derive

__version__ = "0.1.0"

_HOME = {
    "Actuator": ".parameters",
    "Assessment": ".assessment",
    "DeadTimeLoop": ".loop",
    "DomainError": ".errors",
    "Envelope": ".design.envelope",
    "HoldingDesign": ".design",
    "InfeasibleDesignError": ".errors",
    "InputError": ".errors",
    "IntersectionRegion": ".design",
    "Judgement": ".design.judging",
    "KinkError": ".errors",
    "LinearControl": ".simulation",
    "LinearPlant": ".linearization",
    "Margins": ".loop",
    "MissingParametersError": ".errors",
    "PARK2008": ".parameters",
    "PIController": ".design",
    "PIGains": ".parameters",
    "Rail": ".parameters",
    "RailslipError": ".errors",
    "ReferenceSlip": ".adhesion",
    "Scenario": ".simulation",
    "StepControl": ".simulation",
    "UnstableLoopError": ".errors",
    "Vehicle": ".parameters",
    "actuated_plant": ".design",
    "assess": ".assessment",
    "built_in_scenario": ".simulation",
    "campaign": ".campaign",
    "compare_runs": ".run_comparison",
    "derive": ".sliding.derivation",
    "fundamental_limits": ".design.limits",
    "gain_for_crossover": ".design",
    "holding_gains": ".design",
    "intersection": ".design",
    "judge": ".design.judging",
    "linearize": ".linearization",
    "load_controller": ".simulation.controller_files",
    "load_envelope": ".design.envelope",
    "load_law": ".adhesion",
    "load_scenario": ".simulation.files",
    "load_vehicle": ".parameters",
    "most_phase": ".design",
    "nonlinear_plant": ".linearization",
    "operating_point": ".linearization",
    "plant_at": ".design.schedule",
    "published_law": ".adhesion",
    "simulate": ".simulation",
    "slide_protection": ".simulation.designed",
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
    "DeadTimeLoop",
    "DomainError",
    "Envelope",
    "HoldingDesign",
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
    "compare_runs",
    "derive",
    "fundamental_limits",
    "gain_for_crossover",
    "holding_gains",
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
