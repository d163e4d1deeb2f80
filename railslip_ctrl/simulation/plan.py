"""From a scenario and a controller to the arrays that a kernel is given."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.numeric import adhesion_table, plant_parameters
from railslip_ctrl.model.vehicle import Rail

from .controllers import Controller, Situation, reference_slip
from .scenario import PUBLISHED_REFERENCE, Scenario, event_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

LOCKED_SHARE = 0.02
"""A wheel counts as locked where r omega < 0.02 v."""

_DOMAIN_INTERVALS = 64
_NO_LIMIT = 1e300


class Events(NamedTuple):
    """Of each event: time, distance (inf: not by it), and rows in which NaN or -1 leaves what is there."""

    time: Floats
    distance: Floats
    p: Floats
    c: Floats
    chosen: NDArray[np.int64]


@dataclass(frozen=True)
class Plan:
    settings: dict[str, float]
    events: Events
    p: Floats
    c: Floats
    chosen: NDArray[np.int64]
    tables: Floats
    limits: Floats
    samples: int


class _Laws:
    """Adhesion laws in use, each with its table and domain once."""

    def __init__(self, top_speed: float, wheel_load: float) -> None:
        self._top_speed, self._wheel_load, self._laws = top_speed, wheel_load, list[AdhesionLaw]()

    def number(self, law: AdhesionLaw) -> int:
        if law not in self._laws:
            self._laws.append(law)
        return self._laws.index(law)

    def tables(self) -> Floats:
        tables = [adhesion_table(law, self._wheel_load) for law in self._laws]
        joined = np.zeros((len(tables), max(table.size for table in tables)))
        for row, table in zip(joined, tables, strict=True):
            row[: table.size] = table
        return joined

    def limits(self) -> Floats:
        """Slip velocity that each law must stay below, m/s, on a grid of speeds; `_NO_LIMIT` where none."""
        speeds = np.linspace(0.0, self._top_speed, _DOMAIN_INTERVALS + 1)
        speeds[0] = 1e-9 * self._top_speed
        rows = [[self._top_speed, *(min(law.domain_limit(v)[0] * v, _NO_LIMIT) for v in speeds)] for law in self._laws]
        return np.array(rows)


def make_plan(scenario: Scenario, controller: Controller, period: float) -> Plan:
    laws = _Laws(scenario.initial_speed, scenario.vehicle.wheel_load)
    rail, factor = scenario.rail, scenario.adhesion_factor
    vehicle = scenario.vehicle
    law = scenario.law(rail, factor)
    p = np.array(plant_parameters(law, vehicle))
    c = _controller_row(scenario, controller, rail, _assumed(scenario, controller, rail), period)
    chosen = np.array([laws.number(law), laws.number(_assumed(scenario, controller, rail))])
    rows_p, rows_c, rows_chosen = [], [], []
    ordered = sorted(scenario.events, key=event_place)  # within a kind; `Scenario` sees to the rest
    for event in ordered:
        row_p, row_c, row_chosen = np.full(p.size, np.nan), np.full(c.size, np.nan), np.array([-1, -1])
        if event.mass is not None:
            row_p[0] = vehicle.inertia_scale * event.mass
        if event.rail is not None or event.adhesion_factor is not None:
            rail, factor = event.rail or rail, factor if event.adhesion_factor is None else event.adhesion_factor
            law = scenario.law(rail, factor)
            row_p[8:] = law.parameters()
            row_chosen[0] = laws.number(law)
        if event.rail is not None:
            assumed = _assumed(scenario, controller, rail if controller.knows_rail else scenario.rail)
            row_c, row_chosen[1] = _controller_row(scenario, controller, rail, assumed, period), laws.number(assumed)
        rows_p.append(row_p)
        rows_c.append(row_c)
        rows_chosen.append(row_chosen)
    events = Events(
        time=np.array([math.inf if e.time is None else e.time for e in ordered]),
        distance=np.array([math.inf if e.distance is None else e.distance for e in ordered]),
        p=np.array(rows_p).reshape(-1, p.size),
        c=np.array(rows_c).reshape(-1, c.size),
        chosen=np.array(rows_chosen, dtype=np.int64).reshape(-1, 2),
    )
    samples = math.ceil(scenario.longest_time / period - 1e-9)
    return Plan(_settings(scenario, period), events, p, c, chosen, laws.tables(), laws.limits(), samples)


def _assumed(scenario: Scenario, controller: Controller, rail: Rail) -> AdhesionLaw:
    """The law a controller takes for the plant's: its own, or the scenario's without what it cannot know (a patch)."""
    return scenario.law(rail) if controller.model_law is None else controller.model_law.on(rail)


def _controller_row(
    scenario: Scenario, controller: Controller, rail: Rail, assumed: AdhesionLaw, period: float
) -> Floats:
    published = PUBLISHED_REFERENCE[rail] if scenario.published_reference else math.nan
    situation = Situation(scenario, rail, assumed, period)
    head = (reference_slip(controller.reference, rail), scenario.vehicle.wheel.radius)
    return np.array([*head, *controller.row(situation), published])


def _settings(scenario: Scenario, period: float) -> dict[str, float]:
    vehicle, limits, measurement = scenario.vehicle, scenario.limits, scenario.measurement
    scale, caliper = vehicle.inertia_scale, scenario.disturbances
    least = scenario.viscous_least
    return {
        "period": period,
        "step": scenario.step,
        "dead_time": vehicle.actuator.dead_time,
        "lag_fill": vehicle.actuator.lag,
        "lag_dump": vehicle.actuator.lag if limits.dump_lag is None else limits.dump_lag,
        "rate_limit": math.inf if limits.rate is None else limits.rate,
        "torque_min": limits.torque_min,
        "torque_max": math.inf if limits.torque_max is None else limits.torque_max,
        "viscous": vehicle.effective_viscous_friction,
        "viscous_rate": scale * scenario.viscous_rate,
        "viscous_least": -math.inf if least is None else scale * least,
        "disturbance_fraction": caliper.caliper_fraction,
        "disturbance_decay": caliper.caliper_decay,
        "disturbance_frequency": caliper.caliper_frequency,
        "random_hold": 0.0,
        "final_speed": scenario.final_speed,
        "longest_time": scenario.longest_time,
        "speed_quantum": measurement.speed_quantum,
        "wheel_quantum": measurement.wheel_quantum,
        "filter_time": measurement.filter_time,
        "locked_share": LOCKED_SHARE,
    }
