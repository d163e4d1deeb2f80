"""Scenario of a braking run, SI: vehicle, rail, disturbances, sensors, brake limits, events and integration step."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Self

from pydantic import Field, InstanceOf, SerializeAsAny, field_validator, model_validator

from railslip_ctrl.controllers.base import LEAST_PERIOD
from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError, MissingParametersError
from railslip_ctrl.core.units import KMH, quantity, shown, to_unit
from railslip_ctrl.core.user_files import close_match, file_name, given_path, read_toml, validated
from railslip_ctrl.model.adhesion import AdhesionLaw, load_law, named_law
from railslip_ctrl.model.adhesion.base import RANDOM_FORCE, RANDOM_SHARE
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, INITIAL_SPEED_KMH, PARK2008, Rail, Record, Vehicle
from railslip_ctrl.model.vehicle_files import load_vehicle, vehicle_from_keys

from .paths import numbers, replaced

LEAST_STEP = LEAST_PERIOD  #: s, smallest step of the integration
LARGEST_STEP = 1.0  #: s, largest step of the integration; the slip changes faster than any longer step
STEEPEST = 0.15  #: largest gradient, ratio; no adhesion railway is steeper


class Event(Record):
    """Change of rail, adhesion factor or mass at a time or at a distance; None leaves a quantity unchanged.

    The new `adhesion_factor` replaces the previous factor. With factor 1 the adhesion is that of the adhesion law.
    """

    time: float | None = quantity("s", "time of the event", ge=0, default=None)
    distance: float | None = quantity("m", "distance of the event from where the brake is applied", ge=0, default=None)
    rail: Rail | None = Field(None, description="rail condition from then on")
    adhesion_factor: float | None = quantity("1", "factor on the rail's adhesion", gt=0, default=None)
    mass: float | None = quantity("kg", "quarter-car mass M", gt=0, default=None)

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.time is None) == (self.distance is None):
            raise InputError("event: time and distance are both given or both missing; give exactly one of them")
        if self.rail is None and self.adhesion_factor is None and self.mass is None:
            raise InputError("event: no change is given; give rail, adhesion_factor or mass")
        return self


def event_position(event: Event) -> float:
    """Return the time, s, of an event, or its distance, m, if it has no time."""
    position = event.distance if event.time is None else event.time
    assert position is not None, "an event has a time or a distance"
    return position


class Disturbances(Record):
    """Disturbances: a random adhesion force, and a disturbance torque of the brake caliper.

    The force is Gaussian and changes to a new value after each `random_hold`. The torque is
    Td = caliper_fraction Tb exp(-caliper_decay t) sin(caliper_frequency t); Tb is the acting brake torque.
    """

    random_force: float = quantity("N", "standard deviation of the random adhesion force", ge=0, default=0.0)
    random_hold: float = quantity("s", "time for which a random force is held", gt=0, default=0.02)
    caliper_fraction: float = quantity("1", "amplitude at t = 0 over the acting torque", ge=0, default=0.0)
    caliper_decay: float = quantity("1/s", "decay rate of the caliper's oscillation", ge=0, default=4.0)
    caliper_frequency: float = quantity("rad/s", "frequency of the caliper's oscillation", ge=0, default=10.0 * math.pi)


class Measurement(Record):
    """Sensors of train speed and wheel speed: scale error, noise, rounding, wheel encoder, and low-pass filter.

    At each sample, the encoder provides the last tooth that has passed, and the time at which it passed. The measured
    wheel speed is the angle between the teeth of two samples divided by the difference of their times. It is a mean
    over this time difference, and therefore delayed by half the time difference. If no tooth has passed since the last
    sample, the measured speed is limited to the value that it would have if a tooth passed now.
    """

    speed_scale: float = quantity("1", "measured train speed over the true one", gt=0, default=1.0)
    encoder_teeth: float = quantity("1", "number of teeth of the wheel encoder; 0: no encoder", ge=0, default=0.0)
    speed_noise: float = quantity("m/s", "standard deviation of the train speed's noise, per sample", ge=0, default=0.0)
    wheel_noise: float = quantity(
        "rad/s", "standard deviation of the wheel speed's noise, per sample", ge=0, default=0.0
    )
    speed_quantum: float = quantity("m/s", "resolution of the train speed; 0: not rounded", ge=0, default=0.0)
    wheel_quantum: float = quantity("rad/s", "resolution of the wheel speed; 0: not rounded", ge=0, default=0.0)
    filter_time: float = quantity("s", "time constant of the filter on both speeds; 0: none", ge=0, default=0.0)

    @field_validator("encoder_teeth")
    @classmethod
    def _at_least_one_tooth(cls, teeth: float) -> float:
        if 0 < teeth < 1:
            raise InputError(f"encoder_teeth: {teeth:g} is not allowed; give at least 1, or 0 for no encoder")
        return teeth


class BrakeLimits(Record):
    """Limits and gain of the brake, in addition to dead time and lag.

    If `dump_lag` is given, it is the lag while the torque falls. After dead time and lag, the acting torque is
    `torque_gain` times the commanded torque; a gain other than 1 models a change of the pad friction.
    """

    torque_gain: float = quantity("1", "acting torque over commanded torque", gt=0, default=1.0)
    torque_min: float = quantity("N*m", "least commanded torque", default=0.0)
    torque_max: float | None = quantity("N*m", "largest commanded torque", default=None)
    rate: float | None = quantity("N*m/s", "largest rate of the acting torque", gt=0, default=None)
    dump_lag: float | None = quantity("s", "time constant of falling torque", gt=0, default=None)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.torque_max is not None and not self.torque_min < self.torque_max:
            raise InputError(
                f"torque_max: {self.torque_max:g} is not allowed; give a value > torque_min = {self.torque_min:g} (N*m)"
            )
        return self


class Beliefs(Record):
    """Wrong vehicle parameters that the controllers assume; for a parameter that is None they assume the true value."""

    radius: float | None = quantity("m", "wheel radius", gt=0, default=None)
    wheel_inertia: float | None = quantity("kg*m^2", "wheel inertia", gt=0, default=None)
    wheel_load: float | None = quantity("N", "wheel load", gt=0, default=None)
    dead_time: float | None = quantity("s", "dead time of the actuator", ge=0, default=None)
    lag: float | None = quantity("s", "lag of the actuator", ge=0, default=None)

    def of(self, vehicle: Vehicle) -> Vehicle:
        """Return a copy of a vehicle with the parameters that the controllers assume for it."""
        wheel = {"radius": self.radius, "inertia": self.wheel_inertia}
        actuator = {"dead_time": self.dead_time, "lag": self.lag}
        own = {"wheel_load": self.wheel_load}
        parts: list[tuple[Record, dict[str, float | None]]] = [(vehicle.wheel, wheel), (vehicle.actuator, actuator)]
        changed = [part.model_copy(update=_given(values)) for part, values in parts]
        return vehicle.model_copy(update={"wheel": changed[0], "actuator": changed[1], **_given(own)})


def _given(values: dict[str, float | None]) -> dict[str, float]:
    return {name: value for name, value in values.items() if value is not None}


class Scenario(Record):
    """Conditions of a braking run that begins at `initial_speed`, without slip, and ends at `final_speed`.

    The coefficient of viscous friction at time t is that of the vehicle plus `viscous_rate` t, but at least
    `viscous_least`. All three numbers are multiplied by the inertia scale. `published_scenario` returns the run of
    [Park2008] p. 55.

    InputError: a value that is not allowed; a final speed that is not below the initial speed; a rate limit or dump lag
    for a brake without lag; or events that change the adhesion, some at a time and others at a distance, unless each
    of them sets both rail and adhesion factor. Otherwise the adhesion would depend on the order of these events, which
    is not known.
    """

    name: str = Field(description="for reports")
    vehicle: Vehicle = Field(description="the quarter car")
    adhesion: SerializeAsAny[InstanceOf[AdhesionLaw]] = Field(description="adhesion law, of dry rail if rails differ")
    rail: Rail = Field(Rail.DRY, description="rail condition at the start")
    adhesion_factor: float = quantity("1", "factor on the rail's adhesion at the start", gt=0, default=1.0)
    initial_speed: float = quantity("m/s", "speed at which the brake is applied", gt=0)
    final_speed: float = quantity("m/s", "speed at which the run ends", gt=0, default=5.0 * KMH)
    longest_time: float = quantity("s", "time after which the run is ended", gt=0, le=36_000.0, default=180.0)
    events: tuple[Event, ...] = Field((), description="changes of rail, adhesion and mass on the way")
    disturbances: Disturbances = Field(Disturbances(), description="disturbances of the wheel")
    measurement: Measurement = Field(Measurement(), description="measurement of the speeds")
    limits: BrakeLimits = Field(BrakeLimits(), description="limits of the actuator")
    beliefs: Beliefs = Field(Beliefs(), description="vehicle parameters that the controllers assume")
    gradient: float = quantity(
        "1", "rise of the track over its length, downhill negative", ge=-STEEPEST, le=STEEPEST, default=0.0
    )
    viscous_rate: float = quantity("N*m", "rate of change of the viscous torque coefficient", default=0.0)
    viscous_least: float | None = quantity("N*m*s", "least viscous torque coefficient; none: no limit", default=None)
    step: float = quantity("s", "largest step of the integration", ge=LEAST_STEP, le=LARGEST_STEP, default=1e-3)
    published_reference: bool = Field(
        False, strict=True, description="also report the slip error for [Park2008]'s reference, 0.132 dry, 0.092 wet"
    )

    @model_validator(mode="after")
    def _speeds(self) -> Self:
        if not self.final_speed < self.initial_speed:
            raise InputError(
                f"final_speed: {self.final_speed:g} is not allowed; give a value < initial_speed = "
                f"{self.initial_speed:g} (m/s)"
            )
        return self

    @model_validator(mode="after")
    def _events_have_one_order(self) -> Self:
        of_adhesion = [e for e in self.events if e.rail is not None or e.adhesion_factor is not None]
        both_kinds = len({event.time is None for event in of_adhesion}) > 1
        if both_kinds and any(event.rail is None or event.adhesion_factor is None for event in of_adhesion):
            raise InputError(
                "events: some change the adhesion at a time, others at a distance, so that their order is not known; "
                "give both rail and adhesion_factor in each of these events, so that each sets the adhesion completely"
            )
        return self

    @model_validator(mode="after")
    def _limits_need_a_lag(self) -> Self:
        if self.vehicle.actuator.lag == 0 and (self.limits.rate is not None or self.limits.dump_lag is not None):
            raise InputError("limits: a rate limit and a dump lag need an actuator with a lag; give lag > 0 (s)")
        return self

    @property
    def believed_vehicle(self) -> Vehicle:
        """Vehicle with the parameters that a controller assumes unless it sets its own."""
        return self.beliefs.of(self.vehicle)

    def law(self, rail: Rail, factor: float = 1.0) -> AdhesionLaw:
        """Return the adhesion law on a rail, with the adhesion multiplied by `factor` (ratio)."""
        law = self.adhesion.on(rail)
        return law if factor == 1.0 else law.weakened(factor)

    @property
    def has_named_law(self) -> bool:
        """True if the adhesion law is a published law with the parameters for this vehicle and this initial speed."""
        try:
            return self.adhesion == named_law(self.adhesion.name, self.vehicle, self.initial_speed)
        except (InputError, MissingParametersError):
            return False

    def for_vehicle(self, vehicle: Vehicle) -> Self:
        """Return a copy of the scenario for another vehicle.

        The random force is scaled in proportion to the wheel load, and a published adhesion law gets the parameters for
        this wheel load. An event that sets the old vehicle's loaded mass sets the new
        vehicle's loaded mass in the copy.
        """
        events = tuple(
            event.model_copy(update={"mass": vehicle.mass_loaded}) if event.mass == self.vehicle.mass_loaded else event
            for event in self.events
        )
        law = named_law(self.adhesion.name, vehicle, self.initial_speed) if self.has_named_law else self.adhesion
        share = vehicle.wheel_load / self.vehicle.wheel_load
        noise = self.disturbances.model_copy(update={"random_force": share * self.disturbances.random_force})
        return self.with_changes(vehicle=vehicle, events=events, adhesion=law, disturbances=noise)

    def with_changes(self, **changes: Any) -> Self:
        """Return a copy in which the fields `changes` are changed; InputError as for `Scenario`."""
        given = {name: value for name, value in (self.given() | changes).items() if value is not None}
        return validated(type(self), given, self.name)

    def given(self) -> dict[str, Any]:
        """Fields that are not None, by name."""
        return {name: value for name, value in self if value is not None}


PUBLISHED_DISTURBANCES = Disturbances(random_force=RANDOM_FORCE, random_hold=0.02, caliper_fraction=0.05)
"""Disturbances of [Park2008] p. 55; `random_hold` is fitted so that results agree with Table 5 of the paper."""


@checked
def published_scenario(*, as_published: bool = True, adhesion: str = "curve") -> Scenario:
    """Return the run of [Park2008] p. 55, from 100 to 5 km/h: at 25 s the mass rises and the rail turns wet.

    - as_published: True for mass, inertia and friction multiplied by 3.6, which reproduces Table 5 of the paper with
      the law "curve"; False for the values in SI units.
    - adhesion: name of the adhesion law.
    """
    scale = AS_PUBLISHED_INERTIA_SCALE if as_published else 1.0
    vehicle = PARK2008.model_copy(update={"inertia_scale": scale})
    return Scenario(
        name="park2008" if as_published else "park2008-si",
        vehicle=vehicle,
        adhesion=named_law(adhesion, vehicle),
        initial_speed=INITIAL_SPEED_KMH * KMH,
        events=(Event(time=25.0, rail=Rail.WET, mass=PARK2008.mass_loaded),),
        disturbances=PUBLISHED_DISTURBANCES,
        viscous_rate=-0.01,  # B = 0.25 - 0.01 t
        published_reference=True,
    )


@checked
def stop(
    vehicle: Vehicle = PARK2008,
    rail: Rail | str = Rail.DRY,
    *,
    speed_kmh: float = INITIAL_SPEED_KMH,
    adhesion: str | AdhesionLaw = "curve",
) -> Scenario:
    """Return the scenario of a stop on one rail, down to 5 km/h, with the random force of [Park2008].

    - vehicle: the vehicle; the random force is proportional to its wheel load.
    - rail: "dry" or "wet", for the whole stop.
    - speed_kmh: speed at which the brake is applied, km/h.
    - adhesion: an adhesion law, or the name of a published law, which then gets the parameters for this wheel load and
      speed.

    InputError: an unknown rail or law, or a speed that is not allowed.
    """
    speed = speed_kmh * KMH
    noise = PUBLISHED_DISTURBANCES.model_copy(update={"random_force": RANDOM_SHARE * vehicle.wheel_load})
    law = adhesion if isinstance(adhesion, AdhesionLaw) else named_law(adhesion, vehicle, speed)
    return Scenario(
        name="stop", vehicle=vehicle, adhesion=law, rail=Rail(rail), initial_speed=speed, disturbances=noise
    )


def with_patch(scenario: Scenario, begin: float, length: float) -> Scenario:
    """Return the scenario with a wet patch of the given `length`, m, that begins at the braking distance `begin`, m."""
    ends = Event(distance=begin, rail=Rail.WET), Event(distance=begin + length, rail=scenario.rail)
    return scenario.with_changes(events=ends)


BUILT_IN = ("park2008", "park2008-si", "stop")  #: names of the scenarios that come with the package


@checked
def built_in_scenario(name: str) -> Scenario:
    """Return a built-in scenario by its name in `BUILT_IN`; InputError for another name.

    "park2008" and "park2008-si" are the results of `published_scenario`, "stop" is that of `stop`.
    """
    if name not in BUILT_IN:
        raise InputError(f"scenario: unknown name {name!r}; choose one of {', '.join(BUILT_IN)}, or give a TOML file")
    return stop() if name == "stop" else published_scenario(as_published=name == "park2008")


_TABLES = ("disturbances", "measurement", "limits", "beliefs")
_LONGEST_CHAIN = 8  # largest number of scenario files that extend one another; a longer chain is probably circular


class _Keys(Scenario):
    """Keys of a scenario file: the fields of `Scenario`, and keys that change them."""

    extends: str | None = None
    loaded: bool = False
    inertia_scale: float | None = quantity("1", "factor on M, J and B", gt=0, default=None)
    changes: dict[str, float] = Field({}, description='numbers by path ("vehicle.wheel.radius"), SI, set last')


@checked
def load_scenario(source: str | Path) -> Scenario:
    """Load a scenario, SI; `source` is a built-in name ("park2008", "park2008-si", "stop") or a TOML file.

    InputError: one line with the file, the key, the value and what is allowed.
    """
    path = given_path(source, "scenario")
    return _from_file(path, ()) if path.suffix.lower() == ".toml" else built_in_scenario(str(source))


def _from_file(path: Path, chain: tuple[Path, ...]) -> Scenario:
    where = file_name(path)
    if len(chain) >= _LONGEST_CHAIN:
        raise InputError(
            f"{where}: extends: a chain of {len(chain)} files is too long; let one of them extend a built-in scenario"
        )
    keys = read_toml(path)
    base = _extended(keys["extends"], path, chain) if "extends" in keys else None
    content = {} if base is None else base.given()
    own = {name: value for name, value in keys.items() if name not in ("vehicle", "adhesion", *_TABLES)}
    content |= {"name": path.stem, **own}
    for table in (name for name in _TABLES if name in keys):
        if not isinstance(keys[table], dict):
            fault = f"{shown(keys[table])} is not allowed; give a table with lines key = value"
            raise InputError(f"{where}: {table}: {fault}")
        extended = {} if base is None else getattr(base, table).model_dump(exclude_none=True)
        content[table] = {**extended, **keys[table]}
    content |= _vehicle_and_law(keys, base, path)
    read = validated(_Keys, content, where)
    made = Scenario(**{name: value for name, value in read.given().items() if name in Scenario.model_fields})
    for name in read.changes:
        if name not in (known := numbers(made)):
            near = close_match(name, known).rstrip() or f"give one of {', '.join(known)}"
            raise InputError(f"{where}: changes: {name!r} is not a number of the scenario; {near}")
    return replaced(made, read.changes, where) if read.changes else made


def _extended(name: Any, path: Path, chain: tuple[Path, ...]) -> Scenario:
    if not isinstance(name, str):
        raise InputError(f"{file_name(path)}: extends: {shown(name)} is not allowed; give a scenario's name or file")
    if name in BUILT_IN:
        return built_in_scenario(name)
    if not name.lower().endswith(".toml"):
        raise InputError(
            f"{file_name(path)}: extends: unknown name {shown(name)}; choose {' or '.join(BUILT_IN)}, or a TOML file"
        )
    return _from_file(path.parent / name, (*chain, path))


def _vehicle_and_law(keys: dict[str, Any], base: Scenario | None, path: Path) -> dict[str, Any]:
    """Return the fields vehicle, adhesion and events of a scenario, from its file and the extended scenario `base`."""
    where = file_name(path)
    if "vehicle" not in keys and base is None:
        return {}
    vehicle = _vehicle(keys["vehicle"], path) if "vehicle" in keys or base is None else base.vehicle
    if "inertia_scale" in keys:
        scale = to_unit(keys["inertia_scale"], "1", name=f"{where}: inertia_scale", text_needs_unit=True)
        vehicle = vehicle.model_copy(update={"inertia_scale": scale})
    if keys.get("loaded") is True:
        vehicle = vehicle.loaded()
    found: dict[str, Any] = {"vehicle": vehicle}
    speed = None if base is None else base.initial_speed
    if "initial_speed" in keys:
        speed = to_unit(keys["initial_speed"], "m/s", name=f"{where}: initial_speed", text_needs_unit=True)
    if "adhesion" in keys:
        found["adhesion"] = _law(keys["adhesion"], vehicle, speed, path)
    elif base is not None and speed is not None and speed > 0:
        follows = base.has_named_law
        found["adhesion"] = _law(base.adhesion.name, vehicle, speed, path) if follows else base.adhesion
    if base is not None and "events" not in keys:
        found["events"] = base.for_vehicle(vehicle).events
    return found


def _vehicle(given: Any, path: Path) -> Vehicle:
    where = f"{file_name(path)}: vehicle"
    if isinstance(given, dict):
        return vehicle_from_keys(given, path, where=where)
    if not isinstance(given, str):
        raise InputError(f"{where}: {shown(given)} is not allowed; give a file's name or a table [vehicle]")
    if given == "park2008":
        return PARK2008
    try:
        return load_vehicle(path.parent / given)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _law(given: Any, vehicle: Vehicle, speed: float | None, path: Path) -> AdhesionLaw:
    where = f"{file_name(path)}: adhesion"
    if not isinstance(given, str):
        raise InputError(f"{where}: {shown(given)} is not allowed; give a law's name or file")
    try:
        if given.lower().endswith((".toml", ".py")):
            return load_law(path.parent / given, initial_speed_kmh=None if speed is None else speed / KMH)
        if speed is None:
            raise InputError(f"initial_speed: missing, but the adhesion law {given!r} needs it; give a speed (m/s)")
        return named_law(given, vehicle, speed)
    except (InputError, MissingParametersError) as error:
        raise InputError(f"{where}: {error}") from None
