"""Options that several commands share, and the operating points, scenarios and controllers that the options select."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import click
from click.core import ParameterSource

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.core.arguments import sized
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError, RailslipError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, to_unit
from railslip_ctrl.core.user_files import close_match, file_name
from railslip_ctrl.design.catalogue import BY_RULE, NAMES
from railslip_ctrl.design.envelope import Envelope, load_envelope
from railslip_ctrl.model.adhesion import (
    INITIAL_SPEED_RANGE_KMH,
    AdhesionLaw,
    ReferenceSlip,
    initial_speeds_in,
    is_over_initial_speed,
    law_classes,
    law_names,
    load_law,
    named_law,
    published_law,
    wheel_load_in,
)
from railslip_ctrl.model.linearization import OperatingPoint, operating_point
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, PIGains, Rail, Vehicle, notes_and_warnings
from railslip_ctrl.model.vehicle_files import load_vehicle
from railslip_ctrl.simulation import Scenario
from railslip_ctrl.simulation.scenario import BUILT_IN, LARGEST_STEP, LEAST_STEP, STEEPEST, load_scenario

from .output import progress
from .settings import Option, json_option, option, path_option, preset, switch

R = TypeVar("R")

_WARNED = "railslip_ctrl.warned"  # key in the command's context: set of warnings already printed
_LOAD_TOLERANCE = 0.1  # relative deviation from the log's wheel load without a warning; half-full cars deviate by this
_SPEED_TOLERANCE = 0.1  # relative deviation from the log's v0 without a warning; changes mu_max of Table 1 by 3 %

DEFAULT_ENVELOPE = "default"

_SCENARIO, _LAW = "from the scenario", "LAW|FILE.toml|FILE.py"


class Number(click.ParamType[float]):
    """Type of an option: a finite number in `unit`, or with another unit of the same dimension, within bounds."""

    name = "number"

    def __init__(self, unit: str, *, gt: float | None = None, ge: float | None = None, lt: float | None = None) -> None:
        self.unit, self.gt, self.ge, self.lt = unit, gt, ge, lt

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        option = param.opts[0] if param is not None else ""
        number = sized(option, to_unit(value, self.unit, name=option))
        for holds, sign, bound in (
            (self.gt is None or number > self.gt, ">", self.gt),
            (self.ge is None or number >= self.ge, ">=", self.ge),
            (self.lt is None or number < self.lt, "<", self.lt),
        ):
            if not holds:
                unit = "" if self.unit == "1" else f" {self.unit}"
                raise InputError(f"{option}: {number:g}{unit} is not allowed; give a value {sign} {bound:g}{unit}")
        return number


def whole_number(option: str, text: str, least: int, largest: int) -> int:
    """Return the whole number in an option's `text`; InputError if it is not one from `least` to `largest`."""
    if not (text.isascii() and text.isdigit() and len(text) <= 20 and least <= int(text) <= largest):
        raise InputError(f"{option}: {text[:60]!r} is not allowed; give a whole number from {least} to {largest}")
    return int(text)


SLIP = Number("1", gt=0, lt=1)


@dataclass(frozen=True)
class CaseOptions:
    """Values of the options that commands share: a vehicle, and its operating points or its braking run.

    Speeds in km/h, masses in kg, times in s. Options that were not given are None or empty, except options with a
    default value. A braking run does not use the default values of `adhesion` and `initial_speed`.
    """

    adhesion: str
    rails: tuple[str, ...]
    speeds: tuple[float, ...]
    initial_speed: float
    vehicle: Path | None
    loaded: bool
    masses: tuple[float, ...]
    inertia_scale: float | None
    dead_time: float | None
    lag: float | None
    slip: float | None = None
    scenario: str = BUILT_IN[0]
    step: float | None = None
    gradient: float | None = None
    torque_gain: float | None = None
    speed_scale: float | None = None
    encoder_teeth: float | None = None
    believed_radius: float | None = None

    @cached_property
    def chosen_vehicle(self) -> Vehicle:
        """Return the vehicle after --loaded and the first --mass; print the assumptions about the vehicle."""
        chosen = self.given_vehicle.loaded() if self.loaded else self.given_vehicle
        chosen = _with_mass(chosen, self.masses[0] if self.masses else None)
        print_remarks(chosen)
        return chosen

    @cached_property
    def given_vehicle(self) -> Vehicle:
        """Return the empty vehicle of --vehicle, or the published one, changed by the options for inertia and brake."""
        return self._changed(self._own_vehicle(PARK2008))

    def _own_vehicle(self, otherwise: Vehicle) -> Vehicle:
        return otherwise if self.vehicle is None else from_file("--vehicle", self.vehicle, load_vehicle)

    def _changed(self, vehicle: Vehicle) -> Vehicle:
        update: dict[str, object] = {}
        if self.inertia_scale is not None:
            update["inertia_scale"] = self.inertia_scale
        actuator = {k: v for k, v in (("dead_time", self.dead_time), ("lag", self.lag)) if v is not None}
        if actuator:
            update["actuator"] = vehicle.actuator.model_copy(update=actuator)
        return vehicle.model_copy(update=update)

    def name_points(self) -> bool:
        return bool(self.rails or self.speeds or self.masses or self.loaded or self.slip is not None) or _is_given(
            "adhesion"
        )

    def envelope(self, given: str = DEFAULT_ENVELOPE) -> Envelope:
        """Return the envelope `given`, a file or "default"; values of other options replace those of the envelope."""
        if self.masses:
            raise InputError(
                "--mass has no effect with an envelope, because a load of an envelope has a mass and a wheel load; "
                "give --loaded, or both values in the vehicle's file"
            )
        _ = self.chosen_vehicle  # prints the assumptions about the vehicle
        car = self.given_vehicle
        source, path = ("--vehicle", self.vehicle) if given.lower() == DEFAULT_ENVELOPE else ("--envelope", Path(given))
        envelope = Envelope(car) if path is None else from_file(source, path, lambda path: load_envelope(path, car))
        if self.slip == 0:
            raise InputError("--slip: 0 is not allowed with an envelope; give a value > 0")
        changes: tuple[tuple[str, str, Any], ...] = (  # the slip first, because a law may have no reference slip
            ("--slip", "reference", self.slip and {rail.value: self.slip for rail in Rail}),
            ("--rail", "rails", self.rails and self.chosen_rails()),
            ("--adhesion", "laws", _is_given("adhesion") and self.adhesion),
            ("--speed", "speeds", self.speeds),
            ("--loaded", "loads", self.loaded and "loaded"),
            ("--initial-speed", "initial_speed", _is_given("initial_speed") and self.initial_speed),
        )
        for flag, name, value in changes:
            if value:
                envelope = naming(flag, functools.partial(envelope.at, **{name: value}))
        laws_of = "--adhesion" if path is None or _is_given("adhesion") else f"{source}: {file_name(path)}: envelope"
        naming(laws_of, envelope.check_files)
        return envelope

    def law(self, rail: Rail) -> AdhesionLaw:
        load = self.chosen_vehicle.wheel_load
        if not is_file(self.adhesion):
            return published_law(self.adhesion, rail, self.initial_speed, load)
        assumed = not _is_given("initial_speed")
        return law_from_file(Path(self.adhesion), self.initial_speed, load, assumed=assumed).on(rail)

    def _takes_initial_speed(self, speed: float) -> bool:
        path = Path(self.adhesion)
        try:
            if not is_file(self.adhesion):
                published_law(self.adhesion, Rail.DRY, speed)
            elif path.suffix.lower() == ".toml":
                load_law(path, initial_speed_kmh=speed)
        except RailslipError:
            return False
        return True

    def points(self, reference: ReferenceSlip | None = None) -> list[OperatingPoint]:
        """Return the operating points, sorted by rail, then by mass, then by speed.

        Their slip is --slip if given, or else `reference`, or else the reference slip of the adhesion law.
        """
        vehicle, speeds = self.chosen_vehicle, tuple(dict.fromkeys(self.speeds)) or (100.0,)
        points = []
        for rail in self.chosen_rails():
            law = self.law(rail)
            slip = law.reference_slip(rail) if reference is None else reference.on(rail)
            slip = slip if self.slip is None else self.slip
            if slip is None:
                raise InputError(f"--slip: adhesion {self.adhesion!r} has no reference slip; give --slip X")
            for mass, speed in itertools.product(dict.fromkeys(self.masses) or (None,), speeds):
                car, v0, (limit, reason) = _with_mass(vehicle, mass), self.initial_speed, law.domain_limit(speed * KMH)
                if self.slip is None and slip >= limit:
                    raise InputError(
                        f"--speed: the reference slip {slip:g} at {speed:g} km/h is outside the domain of adhesion "
                        f"{law.name!r}: {reason}; give a lower --speed, or a --slip below {limit:.4g}"
                    )
                points.append(operating_point(law, car, speed * KMH, slip, rail=rail, initial_speed_kmh=v0))
        if max(speeds) > self.initial_speed:
            other = f", or --initial-speed {max(speeds):g}" if self._takes_initial_speed(max(speeds)) else ""
            warn(
                f"--speed: {max(speeds):g} km/h is above the initial speed v0 = {self.initial_speed:g} km/h, which a "
                f"braking train does not exceed; give a lower --speed{other}"
            )
        return points

    def chosen_rails(self) -> tuple[Rail, ...]:
        for rail in self.rails:
            if rail.lower() not in tuple(Rail):
                raise InputError(f"--rail: {rail!r} is not a rail condition; choose dry or wet")
        return tuple(dict.fromkeys(Rail(rail.lower()) for rail in self.rails)) or tuple(Rail)

    def run_scenario(self) -> Scenario:
        scenario = naming("--scenario", lambda: load_scenario(self.scenario))
        vehicle = self._run_vehicle(scenario.vehicle)
        print_remarks(vehicle)
        self._check_run(scenario)
        start = self.speeds[0] * KMH if self.speeds else scenario.initial_speed
        changes: dict[str, Any] = {"initial_speed": start}
        if self.step is not None:
            changes["step"] = self.step
        if self.gradient is not None:
            changes["gradient"] = self.gradient
        errors = (
            ("limits", {"torque_gain": self.torque_gain}),
            ("measurement", {"speed_scale": self.speed_scale, "encoder_teeth": self.encoder_teeth}),
            ("beliefs", {"radius": self.believed_radius}),
        )
        for name, given in errors:
            update = {key: value for key, value in given.items() if value is not None}
            if update:
                record = getattr(scenario, name)
                changes[name] = type(record)(**{**dict(record), **update})  # the constructor checks the values
        if self.rails:
            (changes["rail"],) = self.chosen_rails()
        v0 = self.law_speed(start)
        if _is_given("adhesion") or scenario.has_named_law:
            name = self.adhesion if _is_given("adhesion") else scenario.adhesion.name
            changes["adhesion"] = self._run_law(name, vehicle, v0)
        elif _is_given("initial_speed"):
            raise InputError(
                "--initial-speed selects adhesion parameters, but the scenario gives them already; leave "
                "--initial-speed out"
            )
        if not math.isclose(v0, start):
            warn(
                f"--initial-speed: the adhesion law holds for stops from {v0 / KMH:g} km/h, but this run begins at "
                f"{start / KMH:g} km/h (--speed); give the same speed unless this is intended"
            )
        return scenario.for_vehicle(vehicle).with_changes(**changes)

    def law_speed(self, start: float) -> float:
        """Return v0 of a run's adhesion law, m/s: --initial-speed, or else `start`, the initial speed of the run."""
        return self.initial_speed * KMH if _is_given("initial_speed") else start

    def _check_run(self, scenario: Scenario) -> None:
        if self.step is not None and self.step > LARGEST_STEP:
            raise InputError(f"--step: {self.step:g} s is not allowed; give a value <= {LARGEST_STEP:g} s")
        if self.speeds and not self.speeds[0] * KMH > scenario.final_speed:
            final = f"{scenario.final_speed / KMH:g} km/h"
            raise InputError(
                f"--speed: {self.speeds[0]:g} km/h is not allowed, because the run ends at {final}; give a higher speed"
            )

    def _run_law(self, name: str, vehicle: Vehicle, v0: float) -> AdhesionLaw:
        if is_file(name):
            return law_from_file(Path(name), v0 / KMH, vehicle.wheel_load)
        try:
            return named_law(name, vehicle, v0)
        except InputError:
            low, high = INITIAL_SPEED_RANGE_KMH
            if _is_given("initial_speed") or low <= v0 / KMH <= high:
                raise
            option = "--speed" if self.speeds else "--scenario"
            raise InputError(
                f"{option}: the run begins at {v0 / KMH:g} km/h, outside {low:g} to {high:g} km/h, the range of v0 of "
                f"adhesion {name!r}; give a v0 inside this range with --initial-speed"
            ) from None

    def _run_vehicle(self, own: Vehicle) -> Vehicle:
        vehicle = self._own_vehicle(own)
        if vehicle.inertia_scale != own.inertia_scale and self.inertia_scale is None:
            progress(
                f"note: --vehicle: the file's inertia scale {vehicle.inertia_scale:g} replaces the scenario's "
                f"{own.inertia_scale:g}; give --inertia-scale to change it"
            )
        vehicle = self._changed(vehicle.loaded() if self.loaded else vehicle)
        for mass in self.masses:
            vehicle = vehicle.model_copy(update={"mass": mass, "mass_loaded": max(mass, vehicle.mass_loaded)})
        return vehicle


def _with_mass(vehicle: Vehicle, mass: float | None) -> Vehicle:
    return vehicle if mass is None else vehicle.with_mass(mass)


def print_remarks(vehicle: Vehicle) -> None:
    """Print the assumptions about a vehicle on standard error."""
    for note in notes_and_warnings(vehicle):
        progress(f"note: {vehicle.name}: {note}")


def number_option(
    name: str,
    unit: str,
    text: str,
    default_text: str,
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    **kind: Any,
) -> Option:
    """Return a Click option whose value is a number in `unit`, or a number with its own unit."""
    metavar = {"1": "X", "km/h": "KMH"}.get(unit) or (unit.upper() if unit.isalpha() else "X")
    return option(name, metavar, text, default_text, type=Number(unit, gt=gt, ge=ge, lt=lt), **kind)


def case_options(*, speeds: bool = True, masses: bool = False, run: bool = False, over: bool = False) -> Option:
    """Return a decorator that adds the options for vehicle and operating points to a command, as one argument `cases`.

    - speeds: whether there is an option --speed; False for a command that simulates whole stops.
    - masses: whether --mass may be repeated.
    - run: whether the options are for one braking run; values that are not given come from the scenario.
    - over: whether the options are for an envelope; values that are not given come from the envelope.
    """

    def collected(function: Callable[..., Any]) -> Any:
        @functools.wraps(function)
        def called(**given: Any) -> Any:
            for name in ("rails", "speeds", "masses"):
                value = given.get(name)
                given[name] = value if isinstance(value, tuple) else () if value is None else (value,)
            cases = {field.name: given.pop(field.name) for field in fields(CaseOptions) if field.name in given}
            return function(cases=CaseOptions(**cases), **given)

        command: Any = called
        for add in reversed(_options(speeds, masses, run, over)):
            command = add(command)
        return command

    return collected


def _options(speeds: bool, masses: bool, run: bool, over: bool) -> list[Option]:
    of_envelope = "the envelope's" if over else None
    laws = f"{', '.join(law_names())}; a file with a law and its parameters; or a Python file with your own law"
    law = f"Adhesion law: {laws} (the file is run)."
    rail = (
        ("Rail at the start of the run.", _SCENARIO) if run else ("Rail condition; repeatable.", of_envelope or "both")
    )
    v0 = "Speed v0 at the start of braking, km/h, 30 to 140; the adhesion law depends on it."
    begin = ("Speed at which the brake is applied, km/h.", _SCENARIO)
    speed = begin if run else ("Train speed, km/h; repeatable.", of_envelope or "100; with an envelope: the envelope's")
    vehicle = "Vehicle file: .toml, or .yaml of railtoolkit; published adhesion is scaled with the wheel load."
    mass = f"Quarter-car mass M, kg; the wheel load does not change{'; repeatable' * masses}."
    scale = (
        "Factor on M, J and B, in runs also on the stiffness of a published dynamic law. 1: SI; 3.6: units as in the "
        "paper."
    )
    unnamed = _SCENARIO if run else of_envelope or "bristle; with an envelope: the envelope's"
    late = "Actuator dead time, s; ignored by linearize."
    own = "the vehicle's"
    of_law = [
        option("--adhesion", _LAW, law, unnamed, default="bristle"),
        option("--rail", "dry|wet", *rail, to="rails", multiple=not run),
        number_option(
            "--initial-speed", "km/h", v0, "--speed" if run else str(INITIAL_SPEED_KMH), default=INITIAL_SPEED_KMH, gt=0
        ),
    ]
    of_speed = [number_option("--speed", "km/h", *speed, to="speeds", multiple=not run, gt=0)] if speeds else []
    of_vehicle = [
        path_option("--vehicle", "FILE", vehicle, _SCENARIO if run else "the published vehicle"),
        switch("--loaded", "Use the vehicle's loaded mass and wheel load."),
        *([] if over else [number_option("--mass", "kg", mass, own, to="masses", multiple=masses, gt=0)]),
        number_option("--inertia-scale", "1", scale, _SCENARIO if run else f"{own}, 1", gt=0),
        number_option("--dead-time", "s", late, own, ge=0),
        number_option("--lag", "s", "Actuator lag, s.", own, ge=0),
        json_option,
    ]
    if run:
        scenario = "Published run as in the paper or in SI, a plain stop, or a file."
        of_run = [
            preset("--scenario", f"{'|'.join(BUILT_IN)}|FILE.toml", scenario, BUILT_IN[0]),
            number_option("--step", "s", "Largest step of the integration, s.", _SCENARIO, ge=LEAST_STEP),
            number_option(
                "--gradient", "1", "Gradient, ratio of rise to length; negative downhill.", _SCENARIO, ge=-STEEPEST
            ),
            number_option("--torque-gain", "1", "Ratio of acting to commanded brake torque.", _SCENARIO, gt=0),
            number_option("--speed-scale", "1", "Factor on the measured train speed.", _SCENARIO, gt=0),
            number_option(
                "--encoder-teeth",
                "1",
                "Number of teeth of the wheel encoder; 0: no encoder error.",
                _SCENARIO,
                ge=0,
            ),
            number_option("--believed-radius", "m", "Wheel radius that controllers assume, m.", _SCENARIO, gt=0),
        ]
        return [*of_run, *of_law, *of_speed, *of_vehicle]
    static = ", ".join(name for name, law in law_classes().items() if not law.has_state)
    point = f"Slip ratio of the operating point, 0 < X < 1, or 0 with a static law ({static})."
    slip, kind = (point, Number("1", ge=0, lt=1)) if speeds else ("Reference slip ratio, 0 < X < 1.", SLIP)
    return [*of_law, *of_speed, option("--slip", "X", slip, "the law's published reference", type=kind), *of_vehicle]


def envelope_options(default_text: str) -> Option:
    """Return a decorator that adds the options for a verdict over an envelope; the help ends with `default_text`."""
    nominal = switch("--nominal", "Judge the envelope without tolerances.")
    text = (
        "Judge over an envelope: a TOML file, or default, which is the table [envelope] of the vehicle's file, or the "
        "default envelope if the file has no such table. --rail, --adhesion, --speed, --slip and --loaded change it."
    )
    envelope = option("--envelope", "default|FILE", text, default_text)
    return lambda function: envelope(nominal(function))


def gain_options(default_text: str) -> Option:
    """Return a decorator that adds the options for the PI gains; their help shows `default_text` as the default."""
    kp = 'Proportional gain, N*m/(m/s), or with a unit ("65 N*m/(km/h)").'
    ki = 'Integral gain, N*m/m, or with a unit ("27 N*m/(km/h)/s"); give both gains or neither.'
    of_kp = number_option("--kp", "N*m/(m/s)", kp, default_text)
    of_ki = number_option("--ki", "N*m/m", ki, default_text)
    return lambda function: of_kp(of_ki(function))


def naming(option: str, make: Callable[[], R]) -> R:
    """Return `make()`; if it raises an error, begin the message with the name of the `option`."""
    try:
        return make()
    except InputError as error:
        word = option.removeprefix("--").split(":")[0].replace("-", " ")
        message = str(error).removeprefix("Envelope: ")
        for prefix in (f"{word}: ", f"{word}s: ", "laws: " if word == "adhesion" else ""):
            message = message.removeprefix(prefix)
        has_name = message.startswith(f"{word} '")  # adhesion 'beam': ...
        raise InputError(f"{option}{message.removeprefix(word) if has_name else f': {message}'}") from None
    except InfeasibleDesignError as error:
        raise InfeasibleDesignError(f"{option}: {str(error).removeprefix('controller: ')}") from None


def from_file(option: str, path: Path, load: Callable[[Path], R]) -> R:
    """Return `load(path)`; if it raises an error, begin the message with the name of the `option`."""
    if str(path) in ("", "."):
        raise InputError(f"{option}: {str(path)!r} is not a file; give the path of a file")
    return naming(option, lambda: load(path))


def is_file(text: str) -> bool:
    """Return True if `text`, the value of --adhesion or --controller, names a file."""
    return text.lower().endswith((".toml", ".py"))


def law_from_file(path: Path, initial_speed: float, wheel_load: float | None, *, assumed: bool = False) -> AdhesionLaw:
    """Load an adhesion law from a file; warn if it was identified at another initial speed v0 or wheel load.

    - initial_speed: v0, km/h, for a law that depends on v0.
    - wheel_load: wheel load at which the law is used, N; None: no warning about the wheel load.
    - assumed: true if the user has not given v0, so that v0 is the default.
    """
    law = from_file("--adhesion", path, functools.partial(load_law, initial_speed_kmh=initial_speed))
    if path.suffix.lower() == ".py":  # a Python file does not state wheel load and v0
        return law
    if wheel_load is not None:
        _warn_of_wheel_load(law, path, wheel_load)
    _warn_of_initial_speed(path, initial_speed, assumed=assumed)
    return law


def _warn_of_wheel_load(law: AdhesionLaw, path: Path, wheel_load: float) -> None:
    load = from_file("--adhesion", path, wheel_load_in)
    if load is not None and law.has_forces() and abs(wheel_load / load - 1.0) > _LOAD_TOLERANCE:
        warn(
            f"--adhesion: {path} was identified at a wheel load of {load:g} N and is used at {wheel_load:g} N; the "
            "law's force parameters do not scale with the load"
        )


def _warn_of_initial_speed(path: Path, initial_speed: float, *, assumed: bool) -> None:
    if is_over_initial_speed(path):
        if assumed:
            warn(
                f"--adhesion: {path} depends on the initial speed v0; {initial_speed:g} km/h is assumed; give "
                "--initial-speed to change it"
            )
        return
    bounds = from_file("--adhesion", path, initial_speeds_in)
    if bounds is not None and not (
        bounds[0] * (1.0 - _SPEED_TOLERANCE) <= initial_speed <= bounds[1] * (1.0 + _SPEED_TOLERANCE)
    ):
        speeds = " to ".join(dict.fromkeys(f"{speed:.4g}" for speed in bounds))
        warn(
            f"--adhesion: {path} was identified at an initial speed v0 of {speeds} km/h and is used at "
            f"{initial_speed:g} km/h (--initial-speed); the adhesion depends on v0"
        )


def warn(message: str) -> None:
    """Print a warning on standard error, unless this command has printed it already."""
    warned = click.get_current_context().meta.setdefault(_WARNED, set())
    if message not in warned:
        warned.add(message)
        click.echo(f"railslip: warning: {message}", err=True)


def _is_given(option: str) -> bool:
    return click.get_current_context().get_parameter_source(option) is ParameterSource.COMMANDLINE


def refuse_given(*options: str, because: str) -> None:
    """Raise InputError if the current command line has one of the `options`, because the command would ignore it.

    `because` states in which case the command ignores these options, for example "with --no-html".
    """
    for flag in (f"--{name.replace('_', '-')}" for name in options if _is_given(name)):
        raise InputError(f"{flag} has no effect {because}; leave {flag} out")


def chosen_gains(kp: float | None, ki: float | None) -> PIGains | None:
    """Return the given gains; None if neither is given; InputError if only one is given."""
    if (kp is None) != (ki is None):
        given, missing = ("--kp", "--ki") if ki is None else ("--ki", "--kp")
        raise InputError(f"{missing}: missing, but {given} is given; give both gains, or leave out {given}")
    return None if kp is None or ki is None else PIGains(kp=kp, ki=ki)


_TITLES_BY_RULE = "; ".join(f"{name} ({kind.title})" for name, kind in BY_RULE.items())


def controller_option(default_text: str, **kind: Any) -> Option:
    """Return the option --controller, which is equal in all commands; the help shows `default_text` as its default."""
    text = (
        f"Controller: pi or asmc of Park et al., Table 4; pi-lead or scheduled of this project; {_TITLES_BY_RULE}; "
        "a file with a controller's parameters; or a Python file with your own controller (the file is run)."
    )
    return option("--controller", f"{'|'.join(NAMES)}|FILE.toml|FILE.py", text, default_text, **kind)


def controller_from_file(text: str, vehicle: Vehicle, reference: ReferenceSlip | None, law_speed: float) -> Controller:
    """Load a controller file for a vehicle; error messages begin with the option's name.

    `reference` is used if the file has no reference slip. `law_speed` is v0, m/s, of an adhesion law in the file.
    """
    from railslip_ctrl.controllers.files import as_control, load_controller

    path = Path(text)
    loaded = naming("--controller", lambda: load_controller(path, initial_speed=law_speed))
    return naming(f"--controller: {file_name(path)}", lambda: as_control(loaded, vehicle, reference, path.stem))


def controller_name(text: str) -> str:
    """Return a controller name in its standard form; the message for an unknown name suggests another."""
    name = text.strip().lower().replace("_", "-")
    if name not in NAMES:
        raise InputError(
            f"--controller: {name!r} is not known; {close_match(name, NAMES)}choose one of {', '.join(NAMES)}, or "
            "give FILE.toml or FILE.py"
        )
    return name
