"""railslip_ctrl: wheel-slip control design for trains.

The names below load on first use, so that importing the package, or running a command, costs only what it needs. What
is not here is in the packages: `loop`, `design`, `sliding`, `switching`, `simulation`, `reproduction`, `campaign`,
`observer`, `identification`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .adhesion import load_law as load_law
    from .adhesion import published_law as published_law
    from .assessment import assess as assess
    from .campaign.execution import campaign as campaign
    from .design import PIController as PIController
    from .design import stabilizing_pi as stabilizing_pi
    from .design import wheel_slip_loop as wheel_slip_loop
    from .design.envelope import Envelope as Envelope
    from .design.envelope import load_envelope as load_envelope
    from .design.envelope_tuning import tune as tune
    from .design.judging import judge as judge
    from .design.tuning import tune_pi as tune_pi
    from .errors import DomainError as DomainError
    from .errors import InfeasibleDesignError as InfeasibleDesignError
    from .errors import InputError as InputError
    from .errors import KinkError as KinkError
    from .errors import MissingParametersError as MissingParametersError
    from .errors import RailslipError as RailslipError
    from .errors import UnstableLoopError as UnstableLoopError
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
    from .simulation import LinearControl as LinearControl
    from .simulation import Scenario as Scenario
    from .simulation import StepControl as StepControl
    from .simulation import built_in_scenario as built_in_scenario
    from .simulation import simulate as simulate
    from .simulation import stop as stop
    from .simulation.controller_files import load_controller as load_controller
    from .sliding.derivation import derive as derive

__version__ = "0.1.0"

_HOME = {
    "Actuator": ".parameters",
    "DeadTimeLoop": ".loop",
    "DomainError": ".errors",
    "Envelope": ".design.envelope",
    "InfeasibleDesignError": ".errors",
    "InputError": ".errors",
    "KinkError": ".errors",
    "LinearControl": ".simulation",
    "Margins": ".loop",
    "MissingParametersError": ".errors",
    "PARK2008": ".parameters",
    "PIController": ".design",
    "PIGains": ".parameters",
    "Rail": ".parameters",
    "RailslipError": ".errors",
    "Scenario": ".simulation",
    "StepControl": ".simulation",
    "UnstableLoopError": ".errors",
    "Vehicle": ".parameters",
    "assess": ".assessment",
    "built_in_scenario": ".simulation",
    "campaign": ".campaign",
    "derive": ".sliding.derivation",
    "judge": ".design.judging",
    "linearize": ".linearization",
    "load_controller": ".simulation.controller_files",
    "load_envelope": ".design.envelope",
    "load_law": ".adhesion",
    "load_vehicle": ".parameters",
    "nonlinear_plant": ".linearization",
    "operating_point": ".linearization",
    "published_law": ".adhesion",
    "simulate": ".simulation",
    "stabilizing_pi": ".design",
    "stop": ".simulation",
    "tune": ".design.envelope_tuning",
    "tune_pi": ".design.tuning",
    "wheel_slip_loop": ".design",
}

__all__ = [
    "PARK2008",
    "Actuator",
    "DeadTimeLoop",
    "DomainError",
    "Envelope",
    "InfeasibleDesignError",
    "InputError",
    "KinkError",
    "LinearControl",
    "Margins",
    "MissingParametersError",
    "PIController",
    "PIGains",
    "Rail",
    "RailslipError",
    "Scenario",
    "StepControl",
    "UnstableLoopError",
    "Vehicle",
    "__version__",
    "assess",
    "built_in_scenario",
    "campaign",
    "derive",
    "judge",
    "linearize",
    "load_controller",
    "load_envelope",
    "load_law",
    "load_vehicle",
    "nonlinear_plant",
    "operating_point",
    "published_law",
    "simulate",
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
