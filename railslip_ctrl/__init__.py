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
    from .design import assessment as assessment
    from .design import common_pi as common_pi
    from .design import compensators as compensators
    from .design import controllers as controllers
    from .design import gain_for_crossover as gain_for_crossover
    from .design import intersection as intersection
    from .design import limits as limits
    from .design import most_phase as most_phase
    from .design import schedule as schedule
    from .design import stabilizing_pi as stabilizing_pi
    from .design import tuning as tuning
    from .design import wheel_slip_loop as wheel_slip_loop
    from .design.assessment import Assessment as Assessment
    from .design.assessment import assess as assess
    from .design.controllers import SampledController as SampledController
    from .design.envelope import Envelope as Envelope
    from .design.envelope import load_envelope as load_envelope
    from .design.envelope_tuning import tune as tune
    from .design.judging import Judgement as Judgement
    from .design.judging import judge as judge
    from .design.limits import fundamental_limits as fundamental_limits
    from .design.schedule import plant_at as plant_at
    from .design.tuning import tune_pi as tune_pi
    from .identification import curves as curves
    from .identification import fits as fits
    from .identification import virtual_rig as virtual_rig
    from .identification.identify import Identification as Identification
    from .identification.identify import identify as identify
    from .loop import DeadTimeLoop as DeadTimeLoop
    from .loop import Margins as Margins
    from .loop import Rational as Rational
    from .loop import deadtime as deadtime
    from .loop import responses as responses
    from .model import adhesion as adhesion
    from .model import numeric as numeric
    from .model.adhesion import ReferenceSlip as ReferenceSlip
    from .model.adhesion import load_law as load_law
    from .model.adhesion import published_law as published_law
    from .model.linearization import LinearPlant as LinearPlant
    from .model.linearization import linearize as linearize
    from .model.linearization import nonlinear_plant as nonlinear_plant
    from .model.linearization import operating_point as operating_point
    from .model.vehicle import AS_PUBLISHED_INERTIA_SCALE as AS_PUBLISHED_INERTIA_SCALE
    from .model.vehicle import PARK2008 as PARK2008
    from .model.vehicle import TABLE4_PI as TABLE4_PI
    from .model.vehicle import Actuator as Actuator
    from .model.vehicle import PIGains as PIGains
    from .model.vehicle import Rail as Rail
    from .model.vehicle import Vehicle as Vehicle
    from .model.vehicle_files import load_vehicle as load_vehicle
    from .report import plots as plots
    from .report.identification import model_toml as model_toml
    from .simulation import Disturbances as Disturbances
    from .simulation import Event as Event
    from .simulation import LinearControl as LinearControl
    from .simulation import Run as Run
    from .simulation import Scenario as Scenario
    from .simulation import ScheduledControl as ScheduledControl
    from .simulation import Simulator as Simulator
    from .simulation import StepControl as StepControl
    from .simulation import built_in_scenario as built_in_scenario
    from .simulation import catalogue as catalogue
    from .simulation import simulate as simulate
    from .simulation import stop as stop
    from .simulation.campaign.statistics import campaign as campaign
    from .simulation.catalogue import slide_protection as slide_protection
    from .simulation.controller_files import load_controller as load_controller
    from .simulation.run_comparison import RunComparison as RunComparison
    from .simulation.run_comparison import compare_runs as compare_runs
    from .simulation.scenario import load_scenario as load_scenario
    from .sliding import law as law
    from .sliding.derivation import derive as derive
    from .verification import actuator_effects as actuator_effects
    from .verification import fixed_step as fixed_step
    from .verification import joint_verification as joint_verification
    from .verification import layered as layered
    from .verification import limit_cycles as limit_cycles
    from .verification import reaching as reaching
    from .verification import relay_loop as relay_loop

__version__ = "0.1.0"

_HOME = {
    "AS_PUBLISHED_INERTIA_SCALE": ".model.vehicle",
    "Actuator": ".model.vehicle",
    "Assessment": ".design.assessment",
    "CommonPI": ".design",
    "DeadTimeLoop": ".loop",
    "Disturbances": ".simulation",
    "DomainError": ".core.errors",
    "Envelope": ".design.envelope",
    "Event": ".simulation",
    "Identification": ".identification.identify",
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
    "Rational": ".loop",
    "ReferenceSlip": ".model.adhesion",
    "Run": ".simulation",
    "RunComparison": ".simulation.run_comparison",
    "SampledController": ".design.controllers",
    "Scenario": ".simulation",
    "ScheduledControl": ".simulation",
    "Simulator": ".simulation",
    "StepControl": ".simulation",
    "TABLE4_PI": ".model.vehicle",
    "UnstableLoopError": ".core.errors",
    "Vehicle": ".model.vehicle",
    "actuated_plant": ".design",
    "actuator_effects": ".verification",
    "adhesion": ".model",
    "assess": ".design.assessment",
    "assessment": ".design",
    "built_in_scenario": ".simulation",
    "campaign": ".simulation.campaign.statistics",
    "catalogue": ".simulation",
    "common_pi": ".design",
    "compare_runs": ".simulation.run_comparison",
    "compensators": ".design",
    "controllers": ".design",
    "curves": ".identification",
    "deadtime": ".loop",
    "derive": ".sliding.derivation",
    "fits": ".identification",
    "fixed_step": ".verification",
    "fundamental_limits": ".design.limits",
    "gain_for_crossover": ".design",
    "identify": ".identification.identify",
    "intersection": ".design",
    "joint_verification": ".verification",
    "judge": ".design.judging",
    "law": ".sliding",
    "layered": ".verification",
    "limits": ".design",
    "limit_cycles": ".verification",
    "linearize": ".model.linearization",
    "load_controller": ".simulation.controller_files",
    "load_envelope": ".design.envelope",
    "load_law": ".model.adhesion",
    "load_scenario": ".simulation.scenario",
    "load_vehicle": ".model.vehicle_files",
    "model_toml": ".report.identification",
    "most_phase": ".design",
    "nonlinear_plant": ".model.linearization",
    "numeric": ".model",
    "operating_point": ".model.linearization",
    "plant_at": ".design.schedule",
    "plots": ".report",
    "published_law": ".model.adhesion",
    "reaching": ".verification",
    "relay_loop": ".verification",
    "responses": ".loop",
    "schedule": ".design",
    "simulate": ".simulation",
    "slide_protection": ".simulation.catalogue",
    "stabilizing_pi": ".design",
    "stop": ".simulation",
    "tune": ".design.envelope_tuning",
    "tune_pi": ".design.tuning",
    "tuning": ".design",
    "virtual_rig": ".identification",
    "wheel_slip_loop": ".design",
}

__all__ = [
    "AS_PUBLISHED_INERTIA_SCALE",
    "PARK2008",
    "TABLE4_PI",
    "Actuator",
    "Assessment",
    "CommonPI",
    "DeadTimeLoop",
    "Disturbances",
    "DomainError",
    "Envelope",
    "Event",
    "Identification",
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
    "Rational",
    "ReferenceSlip",
    "Run",
    "RunComparison",
    "SampledController",
    "Scenario",
    "ScheduledControl",
    "Simulator",
    "StepControl",
    "UnstableLoopError",
    "Vehicle",
    "__version__",
    "actuated_plant",
    "actuator_effects",
    "adhesion",
    "assess",
    "assessment",
    "built_in_scenario",
    "campaign",
    "catalogue",
    "common_pi",
    "compare_runs",
    "compensators",
    "controllers",
    "curves",
    "deadtime",
    "derive",
    "fits",
    "fixed_step",
    "fundamental_limits",
    "gain_for_crossover",
    "identify",
    "intersection",
    "joint_verification",
    "judge",
    "law",
    "layered",
    "limit_cycles",
    "limits",
    "linearize",
    "load_controller",
    "load_envelope",
    "load_law",
    "load_scenario",
    "load_vehicle",
    "model_toml",
    "most_phase",
    "nonlinear_plant",
    "numeric",
    "operating_point",
    "plant_at",
    "plots",
    "published_law",
    "reaching",
    "relay_loop",
    "responses",
    "schedule",
    "simulate",
    "slide_protection",
    "stabilizing_pi",
    "stop",
    "tune",
    "tune_pi",
    "tuning",
    "virtual_rig",
    "wheel_slip_loop",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = import_module(_HOME[name], __name__)
    return getattr(home, name) if hasattr(home, name) else import_module(f"{_HOME[name]}.{name}", __name__)


def __dir__() -> list[str]:
    return sorted(__all__)
