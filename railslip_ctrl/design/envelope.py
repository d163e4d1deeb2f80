"""The design envelope: all operating points at which a design must work, and the tolerances around each.

The envelope is a table of the vehicle's TOML file, or of a file of its own. Every key is optional; the defaults are:

    [envelope]
    rails = ["dry", "wet"]
    laws = ["bristle", "curve"]           # or files, relative to this file
    speeds = [10, 20, 40, 60, 80, 100]    # km/h
    loads = ["empty", "loaded"]           # mass and wheel load together
    slip = [0.6, 1.0, 1.25]               # factors on the reference slip
    dead_time = [0.7, 1.0, 1.3]           # factors
    lag = [0.7, 1.0, 1.3]
    radius = [0.94, 1.0]                  # worn wheel
    torque_gain = [1.0]                   # acting torque over commanded torque
    speed_scale = [1.0]                   # measured train speed over true train speed
    believed_radius = [1.0]               # radius assumed by the controller over true radius
    reference = { dry = 0.132, wet = 0.092 }    # an example; default: the reference slips of each law
    initial_speed = 100                   # km/h, at most 140; v0 in the parameters of the published laws
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, InstanceOf, field_validator, model_validator

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import DomainError, InputError, KinkError, MissingParametersError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, quantity, shown, to_unit
from railslip_ctrl.core.user_files import file_name, given_path, read_toml, validated
from railslip_ctrl.loop import Rational
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, load_law, published_law, wheel_load_in
from railslip_ctrl.model.adhesion.base import INITIAL_SPEED_RANGE_KMH
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint, linearize, operating_point
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Actuator, Rail, Record, Vehicle
from railslip_ctrl.model.vehicle_files import load_vehicle, with_laws_beside

Load = Literal["empty", "loaded"]
Law = str | Path | InstanceOf[AdhesionLaw]
SlipFunction = Callable[[AdhesionLaw, float, float], float]
"""Function of adhesion law, train speed (m/s) and wheel load (N) that returns the slip ratio to hold."""

ERRORS = ("torque_gain", "speed_scale", "believed_radius")
_FACTORS = ("slip", "dead_time", "lag", "radius", *ERRORS)

_SPEED_SHARES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)  # default speeds, relative to the speed limit of a vehicle that has one

_LAW_FILES = (".toml", ".py")
_MOST_CASES = 500_000  # more cases would fill memory; the default envelope has 2592
_FASTEST = 1000.0  # km/h, above the speed of any train and the domain of any law
_KNIFE_EDGE = 0.05  # relative distance to the peak slip below which a small change of slip moves a pole past 0


class Envelope(Record):
    """Operating points at which a design must work, and tolerances around each of them.

    Each combination of rail, law, speed and load is an operating point at the reference slip, with dead time, lag and
    wheel radius of the vehicle. Around each operating point all combinations of the factors `slip`, `dead_time`, `lag`,
    `radius`, `torque_gain`, `speed_scale` and `believed_radius` are cases with tolerances. With `speed_scale` and
    `believed_radius` the controller measures the slip with an error and keeps the true slip at a wrong value. These two
    factors do not change the slip of a seeking controller. The mu of a published law depends on the load; a law from a
    file has the same mu at every load. `reference` replaces the reference slip of every law.

    A field that is not given has the value of the table [envelope] in the vehicle's file, or the default. The default
    speeds go up to the vehicle's speed limit, if it has one.

    InputError: an empty list; too many cases; a value of wrong type; a value that is not finite and positive (dead time
    and lag may be 0); an unknown law; a factor with which the reference slip would be 1 or more.
    """

    vehicle: Vehicle = Field(PARK2008, description="the quarter car with its brake")
    rails: tuple[Rail, ...] = Field(tuple(Rail), description="rail conditions")
    laws: tuple[Law, ...] = Field(("bristle", "curve"), description="adhesion laws: names, files, or records")
    speeds: tuple[float, ...] = quantity("km/h", "train speeds", default=(10.0, 20.0, 40.0, 60.0, 80.0, 100.0))
    loads: tuple[Load, ...] = Field(("empty", "loaded"), description="empty, loaded")
    slip: tuple[float, ...] = quantity("1", "factors on the reference slip", default=(0.6, 1.0, 1.25))
    dead_time: tuple[float, ...] = quantity("1", "factors on the actuator's dead time", default=(0.7, 1.0, 1.3))
    lag: tuple[float, ...] = quantity("1", "factors on the actuator's lag", default=(0.7, 1.0, 1.3))
    radius: tuple[float, ...] = quantity("1", "factors on the radius, which the controller knows", default=(0.94, 1.0))
    torque_gain: tuple[float, ...] = quantity("1", "factors on the commanded torque", default=(1.0,))
    speed_scale: tuple[float, ...] = quantity("1", "factors on the measured train speed", default=(1.0,))
    believed_radius: tuple[float, ...] = quantity(
        "1", "factors on the radius assumed by the controller", default=(1.0,)
    )
    reference: ReferenceSlip | None = Field(None, description="reference slips in place of those of the laws")
    initial_speed: float = quantity("km/h", "v0, at which the brake is applied", gt=0, default=INITIAL_SPEED_KMH)

    def __init__(self, vehicle: Vehicle = PARK2008, /, **values: Any) -> None:
        car = values.setdefault("vehicle", vehicle)
        if isinstance(car, (str, Path)):
            raise InputError(f"Envelope: vehicle: {shown(str(car))} is not a Vehicle; read the file with load_vehicle")
        own = _up_to_speed_limit(json.loads(car.envelope), car) if isinstance(car, Vehicle) else {}
        super().__init__(**{**own, **values})

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # as in `Record`

    @field_validator("laws", mode="before")
    @classmethod
    def _each_a_law(cls, value: Any) -> Any:
        for one in value:
            if not isinstance(one, (str, Path, AdhesionLaw)):
                raise InputError(f"{shown(one)} is not a law; give a name, a file, or an AdhesionLaw")
        return value

    @field_validator("rails", "laws", "speeds", "loads", *_FACTORS, mode="before")
    @classmethod
    def _a_list(cls, value: object) -> object:
        if isinstance(value, dict):
            raise InputError(f"{shown(value)} is not allowed; give a list")
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if isinstance(value, (str, Path, AdhesionLaw)) or not isinstance(value, Iterable):
            value = (value,)
        values = tuple(x.item() if isinstance(x, np.generic) else x for x in value)
        if not values:
            raise InputError("the list is empty; give at least one value")
        return tuple(x for i, x in enumerate(values) if x not in values[:i])

    @field_validator("speeds", mode="before")
    @classmethod
    def _in_kmh(cls, value: object) -> object:
        return tuple(to_unit(x, "km/h", text_needs_unit=True) for x in value) if isinstance(value, tuple) else value

    @field_validator("speeds", *_FACTORS)
    @classmethod
    def _positive(cls, values: tuple[float, ...], info: Any) -> tuple[float, ...]:
        may_vanish = info.field_name in ("dead_time", "lag")
        is_speed = info.field_name == "speeds"
        bad = [x for x in values if not ((x > 0 or (may_vanish and x == 0)) and (x <= _FASTEST or not is_speed))]
        if bad:
            bounds = ">= 0" if may_vanish else f"> 0 and <= {_FASTEST:g} (km/h)" if is_speed else "> 0"
            raise InputError(f"{bad[0]:g} is not allowed; give finite values {bounds}")
        return values

    @model_validator(mode="after")
    def _laws_and_slips_are_valid(self) -> Self:
        self._check([law for law in self.laws if not _is_file(law)])
        return self

    @model_validator(mode="after")
    def _cases_are_not_too_many(self) -> Self:
        counts = {name: len(getattr(self, name)) for name in ("rails", "laws", "loads", "speeds")}
        counts |= {name: len({1.0, *getattr(self, name)}) for name in _FACTORS}
        if (cases := math.prod(counts.values())) > _MOST_CASES:
            counts_text = " x ".join(f"{n} {count}" for n, count in counts.items() if count > 1 or n not in ERRORS)
            raise InputError(f"{counts_text} values make {cases} cases, more than {_MOST_CASES}; give fewer values")
        return self

    @property
    def law_speed(self) -> float:
        """Speed v0 of the published laws, km/h: the initial speed.

        If the initial speed equals the vehicle's speed limit, it is clipped to the range for which the laws are valid.
        """
        low, high = INITIAL_SPEED_RANGE_KMH
        limit = self.vehicle.speed_limit
        follows = limit is not None and math.isclose(self.initial_speed, limit / KMH, rel_tol=1e-6)
        return min(max(self.initial_speed, low), high) if follows else self.initial_speed

    def check_files(self) -> None:
        """Read the law files; InputError if a file is invalid."""
        self._check([law for law in self.laws if _is_file(law)])

    def _check(self, laws: list[Any]) -> None:
        for rail, law in product(self.rails, laws):
            try:
                law_on_rail = _law(law, rail, self.vehicle, self)
            except MissingParametersError as error:
                raise InputError(str(error)) from None
            if self.reference is not None or law_on_rail.reference_slip(rail) is not None:
                _reference(self, law_on_rail, rail)

    def at(self, **changes: Any) -> Envelope:
        """Return a copy of the envelope with other values of the fields named in `changes`."""
        return type(self)(**{**{name: getattr(self, name) for name in type(self).model_fields}, **changes})

    def table(self) -> dict[str, Any]:
        """Fields of the envelope, except the vehicle, as a dictionary for TOML or JSON."""
        named = [law.file or law.name if isinstance(law, AdhesionLaw) else str(law) for law in self.laws]
        reference = {} if self.reference is None else {"reference": self.reference.model_dump()}
        numeric = {name: list(getattr(self, name)) for name in _FACTORS}
        return {
            "rails": [rail.value for rail in self.rails],
            "laws": named,
            "speeds": list(self.speeds),
            "loads": list(self.loads),
            **numeric,
            **reference,
            "initial_speed": self.initial_speed,
        }

    def points(self, *, nominal: bool = False, slip_of: SlipFunction | None = None) -> EnvelopePoints:
        """Return all cases, ordered by rail, law, load, speed, radius, slip, errors, dead time and lag.

        - nominal: if true, only the operating points, without tolerances.
        - slip_of: function of adhesion law, speed (m/s) and wheel load (N) that returns the slip ratio of an operating
          point; by default the reference slip is used.

        A case without linear plant (outside the law's domain, or at a kink) is skipped, and the reason is recorded.
        InputError if no case remains, a law cannot be read, or no reference slip is known.
        """
        return _points(self, nominal, slip_of)

    def knife_edges(self) -> tuple[str, ...]:
        """Return a warning for each law and rail whose reference slip is within 5 % of an adhesion peak."""
        warnings: dict[str, str] = {}
        for rail, law, _, load in _laws(self):
            slip = _reference(self, law, rail)
            for speed in self.speeds:
                top = peak(law, speed * KMH, load.wheel_load).slip
                if abs(slip / top - 1) <= _KNIFE_EDGE:
                    warnings.setdefault(
                        f"{law.name}, {rail}",
                        f"{law.name}, {rail} rail: the reference slip {slip:.4g} is {_beside(slip, top)} the adhesion "
                        f"peak at {top:.4g}: small changes of slip change the margins; choose a smaller reference slip",
                    )
        return tuple(warnings.values())


def _beside(held: float, top: float) -> str:
    share = abs(held / top - 1)
    return f"{100 * share:.2g} % {'above' if held > top else 'below'}"


@checked
def load_envelope(path: str | Path, vehicle: Vehicle | None = None) -> Envelope:
    """Read the table `[envelope]` of a TOML file, speeds in km/h.

    - path: a vehicle's file, or a file with the envelope alone. Paths of laws are relative to this file. A vehicle's
      file without the table has the default envelope.
    - vehicle: quarter car; by default the vehicle of the file.

    InputError: a file that cannot be read, or has neither an envelope nor a vehicle.
    """
    path = given_path(path)
    where = file_name(path)
    if not path.is_file():
        raise InputError(f"{where} is not a file; give the path of a file with a table [envelope]")
    content = read_toml(path) if path.suffix.lower() == ".toml" else {}
    of_vehicle = path.suffix.lower() != ".toml" or bool(content.keys() & {"mass", "rolling_stock"})
    if not of_vehicle and "envelope" not in content:
        raise InputError(f"{where} has no table [envelope]; write one, or give a vehicle's file")
    if not of_vehicle and (vehicle is None or len(content) > 1):
        key = next((key for key in content if key != "envelope"), None)
        no_vehicle = f"{where} has no vehicle; give a vehicle too"
        raise InputError(no_vehicle if key is None else f"{where}: {key}: unknown key; remove it")
    car = load_vehicle(path) if vehicle is None else vehicle
    table = content.get("envelope", {})
    if not isinstance(table, dict):
        raise InputError(f"{where}: envelope: {table!r} is not allowed; write a table [envelope]")
    if "vehicle" in table:
        raise InputError(f"{where}: envelope.vehicle: unknown key; write the vehicle's keys before [envelope]")
    table = with_laws_beside(table, path)
    return validated(Envelope, {**_up_to_speed_limit(table, car), "vehicle": car}, f"{where}: envelope")


def _up_to_speed_limit(table: dict[str, Any], vehicle: Vehicle) -> dict[str, Any]:
    """If the vehicle has a speed limit and the table has no `speeds`, add speeds up to this limit; return the table."""
    if vehicle.speed_limit is None or "speeds" in table:
        return table
    limit = round(vehicle.speed_limit / KMH, 6)
    return {"speeds": tuple(round(share * limit, 6) for share in _SPEED_SHARES), "initial_speed": limit, **table}


@dataclass(frozen=True)
class Case:
    """One case of an envelope: an operating point, or a variation of it within the tolerances.

    - point: operating point; its vehicle has the load, wheel radius and actuator of the case.
    - load: "empty" or "loaded".
    - slip_factor: slip over reference slip.
    - nominal: vehicle of the envelope, empty and without tolerances.
    - errors: three ratios: acting torque over commanded torque, measured train speed over true train speed, wheel
      radius assumed by the controller over true wheel radius.
    """

    point: OperatingPoint
    load: str
    slip_factor: float
    nominal: Vehicle
    errors: tuple[float, ...] = (1.0, 1.0, 1.0)

    @property
    def actuator(self) -> Actuator:
        return self.point.vehicle.actuator

    @cached_property
    def plant(self) -> LinearPlant:
        return linearize(self.point)

    @property
    def description(self) -> str:
        """Operating point and tolerances as text: "curve, dry, loaded, 100 km/h, dead time +30 %"."""
        point, car = self.point, self.point.vehicle
        changed = (
            ("slip", self.slip_factor, 1.0),
            ("dead time", car.actuator.dead_time, self.nominal.actuator.dead_time),
            ("lag", car.actuator.lag, self.nominal.actuator.lag),
            ("radius", car.wheel.radius, self.nominal.wheel.radius),
            *((name.replace("_", " "), error, 1.0) for name, error in zip(ERRORS, self.errors, strict=True)),
        )
        tolerances = [f"{name} {100 * (x / of - 1):+.3g} %" for name, x, of in changed if x != of]
        return ", ".join([point.adhesion, point.rail.value, self.load, f"{point.speed_kmh:.4g} km/h", *tolerances])

    def table(self) -> dict[str, Any]:
        """The case for JSON, in SI except for the speed in km/h."""
        point, car = self.point, self.point.vehicle
        return {
            "adhesion": point.adhesion,
            "rail": point.rail.value,
            "speed_kmh": point.speed_kmh,
            "slip": point.slip,
            "load": self.load,
            "mass_kg": car.mass,
            "wheel_load_n": car.wheel_load,
            "dead_time_s": car.actuator.dead_time,
            "lag_s": car.actuator.lag,
            "radius_m": car.wheel.radius,
            **dict(zip(ERRORS, self.errors, strict=True)),
        }


@dataclass(frozen=True)
class EnvelopePoints:
    """The n cases of an envelope, each a linear plant with an actuator.

    - plants: linearised plants; the vehicle of a plant has the load and wheel radius of the case.
    - loads, slip_factors, errors: load, slip factor and errors of each plant, as in `Case`.
    - actuators: the vehicle's actuator, then actuators with other dead times and lags within the tolerances.
    - plant, actuator: (n,), indices into `plants` and `actuators` for each case.
    - operating: (n,), True for each case that is an operating point (all factors are 1).
    - skipped: description of each combination that has no linear plant, with the reason.
    - made: transfer functions that `system` has computed, by index of the plant.
    """

    vehicle: Vehicle
    plants: tuple[LinearPlant, ...]
    loads: tuple[str, ...]
    slip_factors: tuple[float, ...]
    errors: tuple[tuple[float, ...], ...]
    actuators: tuple[Actuator, ...]
    plant: NDArray[np.intp]
    actuator: NDArray[np.intp]
    operating: NDArray[np.bool_]
    skipped: tuple[str, ...]
    made: dict[int, Rational] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return int(self.plant.size)

    def system(self, plant: int) -> Rational:
        """Transfer function of the plant with index `plant`, from torque at the wheel (N*m) to slip velocity (m/s)."""
        if plant not in self.made:
            of = self.plants[plant]
            self.made[plant] = Rational(of.zeros, of.poles, of.gain)
        return self.made[plant]

    @cached_property
    def speed_kmh(self) -> NDArray[np.float64]:
        """Train speed of each case, km/h, (n,)."""
        return np.array([round(plant.point.speed_kmh, 9) for plant in self.plants])[self.plant]

    @property
    def load(self) -> NDArray[np.str_]:
        """Load of each case, (n,)."""
        return np.array(self.loads)[self.plant]

    def take(self, chosen: NDArray[Any]) -> EnvelopePoints:
        """Return the cases selected by `chosen`: an array of indices, or of flags, (n,)."""
        some = {name: getattr(self, name)[chosen] for name in ("plant", "actuator", "operating")}
        return replace(self, **some)

    def case(self, index: int) -> Case:
        i = int(self.plant[index])
        point = self.plants[i].point
        car = point.vehicle.model_copy(update={"actuator": self.actuators[int(self.actuator[index])]})
        return Case(
            OperatingPoint(**{**vars(point), "vehicle": car}),
            self.loads[i],
            self.slip_factors[i],
            self.vehicle,
            self.errors[i],
        )


def _points(envelope: Envelope, nominal: bool, slip_of: SlipFunction | None) -> EnvelopePoints:
    car = envelope.vehicle
    # if the given list lacks the factor 1, that factor is used for the operating points alone
    lags, dead_times, radii, slips = (
        (1.0,) if nominal else tuple(dict.fromkeys((1.0, *getattr(envelope, name))))
        for name in ("lag", "dead_time", "radius", "slip")
    )
    errors = list(product(*((1.0,) if nominal else dict.fromkeys((1.0, *getattr(envelope, n))) for n in ERRORS)))
    factors = list(product(dead_times, lags))
    actuators = [Actuator(dead_time=a * car.actuator.dead_time, lag=b * car.actuator.lag) for a, b in factors]
    around = [
        i
        for i, (a, b) in enumerate(factors)
        if a in envelope.dead_time and b in envelope.lag and actuators[i] not in actuators[:i]
    ]
    members = list(product(_laws(envelope), envelope.speeds, radii, slips, errors))
    found: list[tuple[LinearPlant, str, float, tuple[float, ...]]] = []
    cases: list[tuple[int, int, bool]] = []
    skipped = []
    for (rail, law, load, loaded), speed, radius, slip, wrong in members:
        try:
            own = _reference(envelope, law, rail) if slip_of is None else slip_of(law, speed * KMH, loaded.wheel_load)
            gain, scale, belief = wrong
            known = slip_of is not None or scale == belief
            true = slip * own if known else 1 - (1 - slip * own) * scale / belief
            plant = _plant(envelope, law, _worn(loaded, radius), speed, true, rail, gain * belief)
        except (DomainError, KinkError) as error:
            skipped.append(f"{law.name}, {rail}, {load}, {speed:g} km/h, slip {slip:g} times the reference: {error}")
            continue
        as_given = radius == slip == 1.0 and set(wrong) == {1.0}
        listed = all(one in getattr(envelope, name) for name, one in zip(ERRORS, wrong, strict=True))
        tolerated = around if listed and radius in envelope.radius and slip in envelope.slip else []
        mine = dict.fromkeys([*([0] if as_given else []), *([] if nominal else tolerated)])
        cases += [(len(found), i, as_given and i == 0) for i in mine]
        found.append((plant, load, slip, wrong))
    if not cases:
        raise InputError(
            "envelope: no case is left; " + (f"the first left out: {skipped[0]}" if skipped else "give more values")
        )
    plants, loads, slip_factors, of_errors = zip(*found, strict=True)
    plant_of, actuator_of, operating = (np.array(column) for column in zip(*cases, strict=True))
    return EnvelopePoints(
        car, plants, loads, slip_factors, of_errors, tuple(actuators), plant_of, actuator_of, operating, tuple(skipped)
    )


def _plant(
    envelope: Envelope, law: AdhesionLaw, car: Vehicle, speed: float, slip: float, rail: Rail, gain: float
) -> LinearPlant:
    v0 = envelope.initial_speed
    point = operating_point(law, car, speed * KMH, slip, rail=rail, initial_speed_kmh=v0)
    return linearize(point if gain == 1.0 else replace(point, gain=gain))


def _worn(car: Vehicle, factor: float) -> Vehicle:
    if factor == 1.0:
        return car
    return car.model_copy(update={"wheel": car.wheel.model_copy(update={"radius": factor * car.wheel.radius})})


def _laws(envelope: Envelope) -> Iterator[tuple[Rail, AdhesionLaw, str, Vehicle]]:
    car = envelope.vehicle
    loads = {name: car if name == "empty" else car.loaded() for name in envelope.loads}
    distinct = {
        name: loaded for i, (name, loaded) in enumerate(loads.items()) if loaded not in list(loads.values())[:i]
    }
    for rail, law, (name, loaded) in product(envelope.rails, envelope.laws, distinct.items()):
        yield rail, _law(law, rail, loaded, envelope), name, loaded


def _law(law: str | Path | AdhesionLaw, rail: Rail, loaded: Vehicle, envelope: Envelope) -> AdhesionLaw:
    """Return a law on a rail at the wheel load of the vehicle `loaded`.

    A user's law has the same mu at every wheel load. Its parameters are for the wheel load that the law or its file
    states or, by default, for that of the empty vehicle.
    """
    found_at: float | None = None
    if isinstance(law, AdhesionLaw):
        given, found_at = law, law.of_wheel_load
    elif not _is_file(law):
        return published_law(str(law), rail, envelope.law_speed, loaded.wheel_load)
    else:
        given, found_at = _law_of_file(Path(law), envelope)
    return given.on(rail).at_wheel_load(loaded.wheel_load / (found_at or envelope.vehicle.wheel_load))


def _law_of_file(path: Path, envelope: Envelope) -> tuple[AdhesionLaw, float | None]:
    try:
        return load_law(path, initial_speed_kmh=envelope.initial_speed), wheel_load_in(path)
    except InputError as error:
        raise InputError(f"Envelope: laws: {error}") from None


def _is_file(law: str | Path | AdhesionLaw) -> bool:
    return not isinstance(law, AdhesionLaw) and Path(law).suffix.lower() in _LAW_FILES


def _reference(envelope: Envelope, law: AdhesionLaw, rail: Rail) -> float:
    given = envelope.reference
    slip = law.reference_slip(rail) if given is None else float(getattr(given, rail.value))
    if slip is not None and slip * max(envelope.slip) >= 1:
        of = "" if given is not None else f" of {law.name}"
        raise InputError(
            f"slip: a factor of {max(envelope.slip):g} on the reference slip {slip:.4g}{of}, {rail} rail, gives a slip "
            f"of at least 1 (locked wheel); give factors < {1 / slip:.4g}, or a smaller reference slip"
        )
    if slip is None:
        raise InputError(
            f"envelope: adhesion {law.name!r} has no reference slip; give one in the envelope, reference = {{ dry = "
            "0.13, wet = 0.09 }"
        )
    return slip
