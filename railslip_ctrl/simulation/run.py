"""Simulation of one braking run of a scenario with a controller: results, time series and times of events."""

from __future__ import annotations

import math
from enum import StrEnum
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, Self, TypeAlias
from zipfile import BadZipFile

import numpy as np

from railslip_ctrl.controllers.base import Controller, Situation
from railslip_ctrl.controllers.files import as_control
from railslip_ctrl.controllers.user_step import ADDRESS, StepControl, numba_reason
from railslip_ctrl.core.arguments import Floats, Integers, checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import by_content, dataclass
from railslip_ctrl.core.units import KMH, shown
from railslip_ctrl.core.user_files import file_name
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.adhesion.bristle import REFERENCE
from railslip_ctrl.model.kernels import module_of, module_text, plain
from railslip_ctrl.model.numeric import WORKS, adhesion_table, plant_parameters
from railslip_ctrl.model.vehicle import GRAVITY, Rail

from . import kernel as layout
from .counted import Counted, normal
from .scenario import LEAST_STEP, Event, Scenario, event_position

LOCKED_SHARE = 0.02  #: a wheel is reported as locked while r omega < 0.02 v
REACHED_SHARE = 0.95  #: the reference slip is reported as reached from 0.95 times its value

_DOMAIN_INTERVALS = 64  # intervals of the grid of speeds for the limits of an adhesion law's domain
_NO_LIMIT = 1e300  # m/s, replaces an infinite limit of the slip velocity

LARGEST_SPACING = 2**31  #: largest `record_every`, samples between two rows of a record; no run has more samples
GIVEN_DRAWS = -1  #: value of `Run.seed` if the random numbers were given as a `Noise`


class Outcome(StrEnum):
    """Reason why a run ended."""

    STOPPED = "stopped"
    OUT_OF_TIME = "did not stop"
    OUTSIDE_DOMAIN = "left the adhesion law's domain"
    NOT_FINITE = "not a number"
    TOO_STIFF = "too stiff for the step"


_OUTCOMES = tuple(Outcome)  # in the order of the outcome numbers that the kernel returns


@dataclass(frozen=True)
class Energies:
    """Energy balance of train and wheel, J.

    - starting, final: kinetic energy when the brake is applied, and at the end of the run.
    - booked: kinetic energy that events add by a change of mass.
    - works: energy taken from train and wheel by each effect, with the keys `numeric.WORKS`: brake torque, slip in the
      contact, viscous friction, travelling resistance, random force, caliper disturbance.
    """

    starting: float
    booked: float
    works: dict[str, float]
    final: float

    @property
    def error(self) -> float:
        """Error of the energy balance, as a ratio to the starting energy."""
        return (self.starting + self.booked - sum(self.works.values()) - self.final) / self.starting


@by_content
class Signals(NamedTuple):
    """Time series of a run: arrays of equal length, SI.

    - time (s), distance (m), speed (train, m/s), slip_velocity (m/s), slip (ratio), wheel_speed (rad/s).
    - adhesion_state: state z of the adhesion law, m; adhesion_force, random_force: N.
    - command, torque, disturbance: commanded torque, acting brake torque and caliper disturbance Td, N*m.
    - mass: effective mass, kg; reference: reference slip ratio; locked: 1 while the wheel is locked, else 0.
    - measured_speed (m/s), measured_wheel_speed (rad/s): speeds that the controller receives.
    """

    time: Floats
    distance: Floats
    speed: Floats
    slip_velocity: Floats
    slip: Floats
    wheel_speed: Floats
    adhesion_state: Floats
    adhesion_force: Floats
    random_force: Floats
    command: Floats
    torque: Floats
    disturbance: Floats
    mass: Floats
    reference: Floats
    locked: Floats
    measured_speed: Floats
    measured_wheel_speed: Floats


@by_content
class Noise(NamedTuple):
    """Standard normal random numbers of a run: ratios of random force or sensor noise to the standard deviation.

    - force: numbers for the random force, in order of time, 1-D; each is used for the time `random_hold`, s.
    - sensors: numbers for the noise of train speed and wheel speed, array (n, 2) with a row for each sample.
    - seed: seed of further random numbers, if the run is longer than these arrays.
    """

    force: Floats
    sensors: Floats
    seed: int = 0

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read the random numbers from the file `path` of `numpy.savez`, which `campaign --rare` writes.

        InputError if the file cannot be read or has other contents.
        """
        try:
            with np.load(path) as file:
                return cls(file["force"].ravel(), file["sensors"].reshape(-1, 2), int(file["seed"]))
        except FileNotFoundError:
            raise InputError(f"{file_name(path)}: no such file; check the path") from None
        except (OSError, EOFError, ValueError, LookupError, AttributeError, TypeError, BadZipFile):
            raise InputError(
                f"{file_name(path)} contains no random numbers of a run; give a seed, or a stop.npz of campaign --rare"
            ) from None


Draws: TypeAlias = int | np.random.SeedSequence | Noise | Counted | None
"""Source of random force and sensor noise: a seed, the random numbers themselves (`Noise`), or None for neither."""


@dataclass(frozen=True)
class Run:
    """Results of a braking run.

    - scenario, controller, seed: inputs of the run. `seed` is `GIVEN_DRAWS` if a `Noise` was given instead of a seed,
      and None if the run had no noise or its seed was not an integer.
    - outcome: `STOPPED` if the train reached the final speed; otherwise the reason why the run ended at `braking_time`.
    - braking_time, braking_distance, final_speed: time, s, distance, m, and speed, m/s, at the end of the run.
    - energies: energy balance.
    - mean_abs_slip_error: mean over time of |slip - reference|, slip ratio; NaN for a controller without a reference.
    - mean_abs_slip_error_published: the same mean for the reference slip ratio of [Park2008], 0.132 dry, 0.092 wet; NaN
      unless `scenario.published_reference` is True and the controller has a reference.
    - max_slip: highest slip ratio; locked_fraction: share of time with r omega < 0.02 v.
    - first_lock: time at which r omega first fell below 0.02 v, s; NaN if never.
    - max_torque: largest acting torque, N*m.
    - max_torque_rate, rms_torque_rate: largest and root-mean-square rate of the acting torque, N*m/s.
    - steps: number of integration steps.
    - signals: time series; None if they were not recorded.
    - controller_signals: states of the controller by name, in their units, 1-D arrays of the length of `signals.time`.
    """

    scenario: Scenario
    controller: Controller
    seed: int | None
    outcome: Outcome
    braking_time: float
    braking_distance: float
    final_speed: float
    energies: Energies
    mean_abs_slip_error: float
    mean_abs_slip_error_published: float
    max_slip: float
    locked_fraction: float
    first_lock: float
    max_torque: float
    max_torque_rate: float
    rms_torque_rate: float
    steps: int
    signals: Signals | None
    controller_signals: dict[str, Floats]

    def __str__(self) -> str:
        scenario, lock = self.scenario, "no lock"
        error, references = "", self._references()
        if references:
            reference = f"the reference {' and '.join(dict.fromkeys(f'{slip:g}' for slip in references))}"
            average = f"; mean deviation {self.mean_abs_slip_error:.3g} from {reference}"
            error = average if self.reached else f"; never at {reference}"
        if not math.isnan(self.first_lock):
            lock = f"locked {100 * self.locked_fraction:.2g} % of the time, first at {self.first_lock:.3g} s"
        return (
            f"{scenario.name}, {scenario.rail} rail, {scenario.vehicle.name}, {self.controller.label}: "
            f"{'' if self.stopped else f'{self.outcome.value}; '}from {scenario.initial_speed / KMH:.4g} to "
            f"{self.final_speed / KMH:.3g} km/h in {self.braking_time:.4g} s and {self.braking_distance:.4g} m\n"
            f"highest slip {self.max_slip:.3g}{error}; {lock}\n"
            f"highest torque {self.max_torque:.4g} N*m; rms of its rate {self.rms_torque_rate:.3g} N*m/s"
        )

    def plot(self) -> Any:
        """Return a matplotlib figure of speeds, slip, torque and adhesion over time; InputError without `signals`."""
        if self.signals is None:
            raise InputError("run: the time series were not recorded; simulate with record_every=1")
        plots = import_module("railslip_ctrl.report.plots.runs")  # imported here, because `report` imports this
        return plots.simulation_figure(self)

    @property
    def stopped(self) -> bool:
        """True if the train reached the final speed."""
        return self.outcome is Outcome.STOPPED

    @property
    def reached(self) -> bool:
        """True if the slip reached 0.95 times the smallest reference slip, or if the controller has no reference."""
        return self.max_slip >= REACHED_SHARE * min(self._references(), default=0.0)

    def _references(self) -> list[float]:
        reference = self.controller.reference
        if reference is None:
            return []
        rails = (self.scenario.rail, *(one.rail for one in self.scenario.events if one.rail is not None))
        return [reference.on(rail) for rail in rails]

    @property
    def brake_energy(self) -> float:
        """Work of the brake torque, J: the integral of Tb omega over time."""
        return self.energies.works["brake"]


@checked
def simulate(
    scenario: Scenario,
    controller: Any,
    *,
    seed: Draws = 0,
    record_every: int | None = 1,
    compiled: bool = True,
) -> Run:
    """Simulate a scenario with a controller.

    - scenario: vehicle, rail, adhesion law, speeds and disturbances, SI.
    - controller: a Controller, a linear system, or an object or function that computes the brake torque, N*m;
      `controllers.files.as_control` lists what is accepted.
    - seed: seed of random force and measurement noise; equal seeds give equal runs. None: no force and no noise. A
      `Noise` contains the random numbers themselves.
    - record_every: number of samples between two rows of `signals`; None: no signals.
    - compiled: False runs the simulation in the Python interpreter, hundreds of times slower, with the same result.

    InputError: a seed or record_every out of range, an event that the adhesion law does not support, a sampling period
    of the controller below `LEAST_STEP`, or a user's step that fails or returns no torque.
    """
    return Simulator(scenario, controller, compiled=compiled).run(seed, record_every=record_every)


class Simulator:
    """A scenario and a controller, prepared once for many runs; arguments and InputError are those of `simulate`."""

    @checked
    def __init__(self, scenario: Scenario, controller: Any, *, compiled: bool = True) -> None:
        control = as_control(controller, scenario.believed_vehicle, scenario.adhesion.reference)
        self.scenario, self.controller, self._compiled = scenario, control, compiled
        self.period = scenario.step if control.period is None else control.period
        number(f"controller {control.label}: period", self.period, "s", ge=LEAST_STEP, le=scenario.longest_time)
        self.start = control.start(scenario.initial_speed, self.period)
        self.plan = make_plan(scenario, control, self.start, self.period)

    @cached_property
    def _kernel(self) -> Any:
        return kernel(type(self.scenario.adhesion), self.controller.source_text(), compiled=self._compiled)

    @checked
    def run(self, seed: Draws = 0, *, record_every: int | None = None) -> Run:
        """Simulate one run; `seed`, `record_every` and InputError are those of `simulate`."""
        if record_every is not None:
            number("record_every", record_every, ge=1, le=LARGEST_SPACING)
        plan, kernel_ = self.plan, self._kernel
        forces, noise, hold = self._draw(seed)
        every = record_every or 0
        start = self.controller.flat(self.start)
        rows = (plan.samples + every - 1) // every + 1 if every else 0
        log = np.empty((rows, layout.COLUMNS + len(start)))
        y, x = np.zeros(layout.STATES), np.array(start, dtype=float)
        y[layout.V] = self.scenario.initial_speed
        summary = np.empty(layout.SUMMARY)
        c, call = plan.c.copy(), None
        if isinstance(self.controller, StepControl):
            v = self.scenario.initial_speed
            call = self.controller.opened(v, v / self.scenario.vehicle.wheel.radius)
            c[ADDRESS] = call.address
        settings = kernel_.Settings(**{**plan.settings, "random_hold": hold})
        events = kernel_.Events(*plan.events)
        try:
            status, written = kernel_.run(
                settings, events, forces, noise, plan.p.copy(), c, plan.chosen.copy(), plan.tables, plan.limits, y, x,
                log, every, summary,
            )  # fmt: skip
        except Exception as error:
            if not type(error).__module__.startswith("numba."):
                raise
            why = numba_reason(error)
            raise InputError(f"controller {self.controller.label}: Numba cannot compile its step: {why}") from None
        if call is not None:
            v, omega = y[layout.V], (y[layout.V] - y[layout.SIGMA]) / self.scenario.vehicle.wheel.radius
            ended = _OUTCOMES[status] is Outcome.NOT_FINITE
            call.check(float(summary[layout.END_TIME]), float(v), float(omega), x, ended=ended)
        return self.result(seed, status, y, summary, log[:written] if every else None)

    def _draw(self, seed: Draws) -> tuple[Floats, Floats, float]:
        """Return random forces, N, sensor noise, (samples, 2), and the hold time of a force, s; 0 without forces."""
        disturbances, measurement = self.scenario.disturbances, self.scenario.measurement
        spread = np.array([measurement.speed_noise, measurement.wheel_noise])
        if seed is None:
            return np.zeros(1), np.zeros((0, 2)), 0.0
        hold = disturbances.random_hold if disturbances.random_force > 0 else 0.0
        holds = int(self.plan.samples * self.period / hold) + 2 if hold else 0
        force, noise = _standard(seed, holds, self.plan.samples if spread.any() else 0)
        return disturbances.random_force * force, spread * noise, hold

    def result(self, seed: Draws, status: int, y: Floats, summary: Floats, log: Floats | None = None) -> Run:
        """Return the `Run` for the arrays that the integration loop has computed.

        - seed: source of the random numbers.
        - status: index of the outcome in `Outcome`.
        - y, summary, log: final state (1-D), summary (1-D) and log (2-D), SI; `kernel` defines their indices.
        """
        time = float(summary[layout.END_TIME])
        works = {name: float(y[layout.WORK + i]) for i, name in enumerate(WORKS)}
        starting, booked, final = (
            float(summary[i]) for i in (layout.STARTING_ENERGY, layout.BOOKED, layout.FINAL_ENERGY)
        )

        def mean(i: int) -> float:
            return float(summary[i]) / time if time > 0 else math.nan

        states = self.controller.logged(self.start)
        kept = GIVEN_DRAWS if isinstance(seed, Noise) else None
        if not (seed is None or isinstance(seed, np.random.SeedSequence | Counted | Noise)):
            kept = int(seed)
        return Run(
            scenario=self.scenario,
            controller=self.controller,
            seed=kept,
            outcome=_OUTCOMES[status],
            braking_time=time,
            braking_distance=float(y[layout.DISTANCE]),
            final_speed=float(y[layout.V]),
            energies=Energies(starting, booked, works, final),
            mean_abs_slip_error=mean(layout.SLIP_ERROR),
            mean_abs_slip_error_published=mean(layout.SLIP_ERROR_SCENARIO),
            max_slip=float(summary[layout.HIGHEST_SLIP]),
            locked_fraction=mean(layout.LOCKED_TIME),
            first_lock=float(summary[layout.FIRST_LOCK]),
            max_torque=float(summary[layout.HIGHEST_TORQUE]),
            max_torque_rate=float(summary[layout.HIGHEST_TORQUE_RATE]),
            rms_torque_rate=math.sqrt(max(mean(layout.TORQUE_RATE_SQUARED), 0.0)),
            steps=int(summary[layout.SUBSTEPS]),
            signals=None if log is None else _signals(log, self.scenario),
            controller_signals={} if log is None else {n: log[:, layout.COLUMNS + i] for n, i in states.items()},
        )


_COLUMNS = {
    "time": layout.TIME,
    "distance": layout.DISTANCE,
    "speed": layout.V,
    "slip_velocity": layout.SIGMA,
    "adhesion_state": layout.Z,
    "adhesion_force": layout.FORCE,
    "random_force": layout.RANDOM,
    "command": layout.COMMAND,
    "torque": layout.TORQUE,
    "disturbance": layout.DISTURBANCE,
    "mass": layout.MASS,
    "reference": layout.REFERENCE,
    "locked": layout.LOCKED,
    "measured_speed": layout.MEASURED_V,
    "measured_wheel_speed": layout.MEASURED_OMEGA,
}


def _signals(log: Floats, scenario: Scenario) -> Signals:
    v, sigma = log[:, layout.V], log[:, layout.SIGMA]
    logged = {name: log[:, column] for name, column in _COLUMNS.items()}
    return Signals(**logged, slip=sigma / v, wheel_speed=(v - sigma) / scenario.vehicle.wheel.radius)


def _standard(seed: int | np.random.SeedSequence | Noise | Counted, holds: int, samples: int) -> tuple[Floats, Floats]:
    if isinstance(seed, Counted):
        return normal(*seed, np.arange(holds), 0), normal(*seed, np.arange(samples)[:, None], np.array([1, 2]))
    if isinstance(seed, Noise):
        force, sensors = _standard(seed.seed, holds, samples)
        force[: len(seed.force)], sensors[: len(seed.sensors)] = seed.force[:holds], seed.sensors[:samples]
        return force, sensors
    if not isinstance(seed, np.random.SeedSequence):
        if not 0 <= seed < 2**63:
            raise InputError(f"seed: {shown(seed)} is not allowed; give an integer from 0 to 2^63 - 1")
        seed = np.random.SeedSequence(seed)
    children = [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, i)) for i in range(2)]
    of_force, of_noise = map(np.random.default_rng, children)
    return of_force.standard_normal(holds), of_noise.standard_normal((samples, 2))


def kernel_text(law: type[AdhesionLaw], controller: str, *, compiled: bool = True) -> str:
    """Return the source text of a simulation: adhesion law, the source text `controller`, and the loop of `kernel`."""
    loop = Path(layout.__file__).read_text("utf-8")
    return module_text(law, controller, plain(loop), compiled=compiled)


@cache
def kernel(law: type[AdhesionLaw], controller: str, *, compiled: bool = True) -> ModuleType:
    """Return the module with the text of `kernel_text`; Numba compiles its functions if `compiled` is True."""
    return module_of(kernel_text(law, controller, compiled=compiled), compiled=compiled)


@dataclass(frozen=True)
class Plan:
    """Arguments of `kernel.run` that do not depend on the noise; `samples` is the largest number of samples."""

    settings: dict[str, float]
    events: layout.Events
    p: Floats
    c: Floats
    chosen: Integers
    tables: Floats
    limits: Floats
    samples: int


class _Laws:
    """Adhesion laws of a run, each with a wheel load, N; equal laws with equal loads are stored once."""

    def __init__(self, top_speed: float) -> None:
        self._top_speed, self._laws = top_speed, dict[tuple[AdhesionLaw, float], int]()

    def number(self, law: AdhesionLaw, wheel_load: float) -> int:
        return self._laws.setdefault((law, wheel_load), len(self._laws))

    def tables(self) -> Floats:
        tables = [adhesion_table(law, wheel_load) for law, wheel_load in self._laws]
        joined = np.zeros((len(tables), max(table.size for table in tables)))
        for row, table in zip(joined, tables, strict=True):
            row[: table.size] = table
        return joined

    def limits(self) -> Floats:
        """Return the domains of the laws, m/s, a row for each law.

        The first number is the highest speed of a grid from 0. Then follows, for each speed of the grid, the largest
        slip velocity at which the law is defined.
        """
        speeds = np.linspace(0.0, self._top_speed, _DOMAIN_INTERVALS + 1)
        speeds[0] = 1e-9 * self._top_speed
        rows = [
            [self._top_speed, *(min(law.domain_limit(v)[0] * v, _NO_LIMIT) for v in speeds)] for law, _ in self._laws
        ]
        return np.array(rows)


def make_plan(scenario: Scenario, controller: Controller, start: Any, period: float) -> Plan:
    """Return the arguments of `kernel.run`; `start` is the initial state of the controller, `period` its period, s."""
    laws, vehicle = _Laws(scenario.initial_speed), scenario.vehicle
    rail, factor = scenario.rail, scenario.adhesion_factor
    load, believed_load = vehicle.wheel_load, getattr(controller, "wheel_load", vehicle.wheel_load)
    law = scenario.law(rail, factor)
    p = np.array(plant_parameters(law, vehicle, scenario.gradient))
    c = _controller_row(scenario, controller, start, Situation(rail, period, _assumed(scenario, controller, rail)))
    chosen = np.array([laws.number(law, load), laws.number(_assumed(scenario, controller, rail), believed_load)])
    ordered = sorted(scenario.events, key=event_position)  # `Scenario` refuses events whose order is not known
    events = layout.Events(
        time=np.array([math.inf if e.time is None else e.time for e in ordered]),
        distance=np.array([math.inf if e.distance is None else e.distance for e in ordered]),
        p=np.full((len(ordered), p.size), np.nan),
        c=np.full((len(ordered), c.size), np.nan),
        chosen=np.full((len(ordered), 2), -1, dtype=np.int64),
    )
    for event, row_p, row_c, row_chosen in zip(ordered, events.p, events.c, events.chosen, strict=True):
        if event.mass is not None:
            row_p[layout.P_MASS] = vehicle.inertia_scale * event.mass
            row_p[layout.P_RESISTANCE] = vehicle.resistance.constant + event.mass * GRAVITY * scenario.gradient
        if event.rail is not None or event.adhesion_factor is not None:
            rail, factor = event.rail or rail, factor if event.adhesion_factor is None else event.adhesion_factor
            law = scenario.law(rail, factor)
            row_p[layout.P_LAW :] = law.parameters()
            row_chosen[0] = laws.number(law, load)
        if event.rail is not None:
            assumed = _assumed(scenario, controller, rail if controller.model_follows_rail else scenario.rail)
            row_c[:] = _controller_row(scenario, controller, start, Situation(rail, period, assumed))
            row_chosen[1] = laws.number(assumed, believed_load)
    samples = math.ceil(scenario.longest_time / period - 1e-9)
    return Plan(_settings(scenario, period), events, p, c, chosen, laws.tables(), laws.limits(), samples)


def _assumed(scenario: Scenario, controller: Controller, rail: Rail) -> AdhesionLaw:
    """Return the law that the controller assumes: `model_law`, else the scenario's law with adhesion factor 1."""
    return scenario.law(rail) if controller.model_law is None else controller.model_law.on(rail)


def _controller_row(scenario: Scenario, controller: Controller, start: Any, situation: Situation) -> Floats:
    compared = scenario.published_reference and controller.reference is not None
    published = REFERENCE.on(situation.rail) if compared else math.nan
    return np.array([*controller.row(situation, start), published])


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
        "torque_gain": limits.torque_gain,
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
        "speed_scale": measurement.speed_scale,
        "encoder_teeth": measurement.encoder_teeth,
        "speed_quantum": measurement.speed_quantum,
        "wheel_quantum": measurement.wheel_quantum,
        "filter_time": measurement.filter_time,
        "locked_share": LOCKED_SHARE,
    }


class LoggedEvent(NamedTuple):
    """An event of a run and the time, s, at which it happened; the time is NaN if it did not happen."""

    event: Event
    time: float

    @property
    def reached(self) -> bool:
        return not math.isnan(self.time)

    @property
    def text(self) -> str:
        """Start and changes of the event as text, for example "from 25 s: wet rail, M 5276 kg"."""
        event = self.event
        place = f"from {event.time:g} s" if event.time is not None else f"from {event.distance:g} m"
        changes = [
            *([f"{event.rail} rail"] if event.rail is not None else []),
            *([f"{event.adhesion_factor:g} times the rail's adhesion"] if event.adhesion_factor is not None else []),
            *([f"M {event.mass:g} kg"] if event.mass is not None else []),
        ]
        when = f" (at {self.time:.4g} s)" if event.time is None else ""
        return f"{place}: {', '.join(changes)}{when if self.reached else ' (NOT REACHED)'}"


def events_log(run: Run) -> tuple[LoggedEvent, ...]:
    """Return the events of a run in order of time, then the events that did not happen.

    If an event is at a distance, the run must have `signals`, from which the time of this event is computed.
    """
    found = [LoggedEvent(event, _time(event, run)) for event in run.scenario.events]
    return tuple(sorted(found, key=lambda one: one.time if one.reached else math.inf))


def _time(event: Event, run: Run) -> float:
    if event.time is not None:
        return event.time if event.time < run.braking_time else math.nan
    assert event.distance is not None, "an event has a time or a distance"
    if not event.distance < run.braking_distance:
        return math.nan
    from scipy.interpolate import CubicHermiteSpline  # imported here because most runs do not need it

    assert run.signals is not None, "the run was recorded"
    on = np.diff(run.signals.distance, prepend=-math.inf) > 0  # a run that ends early repeats its last row
    distance, time, speed = (series[on] for series in (run.signals.distance, run.signals.time, run.signals.speed))
    return float(CubicHermiteSpline(distance, time, 1.0 / speed)(event.distance))
