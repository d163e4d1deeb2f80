"""Options that the commands share, and the operating points, scenarios and controllers they name."""

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
from railslip_ctrl.core.errors import DomainError, InfeasibleDesignError, InputError, RailslipError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, to_unit
from railslip_ctrl.core.user_files import close_match, file_name
from railslip_ctrl.design.catalogue import BY_RULE, NAMES
from railslip_ctrl.design.envelope import Envelope, load_envelope
from railslip_ctrl.model.adhesion import (
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
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, PIGains, Rail, Vehicle, remarks
from railslip_ctrl.model.vehicle_files import load_vehicle
from railslip_ctrl.simulation import Scenario
from railslip_ctrl.simulation.scenario import BUILT_IN, LARGEST_STEP, LEAST_STEP, STEEPEST, load_scenario

from .output import progress
from .settings import Option, json_option, option, path_option, preset, switch

R = TypeVar("R")

_TOLD = "railslip_ctrl.told"  # in the command's context: its warnings
_LOAD_TOLERANCE = 0.1  # share by which a load may differ from that of the log: an empty and a half-full car
_SPEED_TOLERANCE = 0.1  # share by which v0 may differ: mu_max of [Park2008] Table 1 then changes by 3 %

DEFAULT_ENVELOPE = "default"

_SCENARIO, _LAW = "the scenario's", "LAW|FILE.toml|FILE.py"


class Number(click.ParamType[float]):
    """A finite number in `unit`, or text with a unit of that dimension, within bounds."""

    name = "number"

    def __init__(self, unit: str, *, gt: float | None = None, ge: float | None = None, lt: float | None = None) -> None:
        self.unit, self.gt, self.ge, self.lt = unit, gt, ge, lt

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; raise InputError naming the option, the value and the bound."""
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
    """The number that an option was given as `text`; InputError, which names it, for one out of range or no number."""
    if not (text.isascii() and text.isdigit() and len(text) <= 20 and least <= int(text) <= largest):
        raise InputError(f"{option}: {text[:60]!r} is not allowed; give a whole number from {least} to {largest}")
    return int(text)


SLIP = Number("1", gt=0, lt=1)


@dataclass(frozen=True)
class CaseOptions:
    """What the common options say: a vehicle, and the operating points or the braking run it is looked at in.

    Speeds in km/h, masses in kg, times in s. None, or empty, where an option was left out; `adhesion` and
    `initial_speed` then have their defaults, in whose place a run has its scenario's.
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
        """The vehicle, with the (first) mass given; what was assumed of it is said on standard error."""
        chosen = self.given_vehicle.loaded() if self.loaded else self.given_vehicle
        chosen = _with_mass(chosen, self.masses[0] if self.masses else None)
        tell_remarks(chosen)
        return chosen

    @cached_property
    def given_vehicle(self) -> Vehicle:
        """The vehicle of the file, empty, with the brake given."""
        return self._changed(self._own_vehicle(PARK2008))

    def _own_vehicle(self, otherwise: Vehicle) -> Vehicle:
        return otherwise if self.vehicle is None else from_file("--vehicle", self.vehicle, load_vehicle)

    def _changed(self, vehicle: Vehicle) -> Vehicle:
        """A vehicle with the inertia scale and the brake given."""
        update: dict[str, object] = {}
        if self.inertia_scale is not None:
            update["inertia_scale"] = self.inertia_scale
        actuator = {k: v for k, v in (("dead_time", self.dead_time), ("lag", self.lag)) if v is not None}
        if actuator:
            update["actuator"] = vehicle.actuator.model_copy(update=actuator)
        return vehicle.model_copy(update=update)

    def name_points(self) -> bool:
        """Whether an option names operating points."""
        return bool(self.rails or self.speeds or self.masses or self.loaded or self.slip is not None) or _is_given(
            "adhesion"
        )

    def envelope(self, given: str = DEFAULT_ENVELOPE) -> Envelope:
        """The envelope of a file, or the vehicle's own, or the default; the options that name points narrow it."""
        if self.masses:
            raise InputError(
                "--mass: changes M alone, and the loads of an envelope are mass and wheel load; give --loaded, or both "
                "in the vehicle's file"
            )
        _ = self.chosen_vehicle  # says what is assumed of it
        car = self.given_vehicle
        source, path = ("--vehicle", self.vehicle) if given.lower() == DEFAULT_ENVELOPE else ("--envelope", Path(given))
        found = Envelope(car) if path is None else from_file(source, path, lambda path: load_envelope(path, car))
        if self.slip == 0:
            raise InputError("--slip: 0 is not allowed with an envelope; give a value > 0")
        named: tuple[tuple[str, str, Any], ...] = (  # the slip first, of which the laws may have none
            ("--slip", "reference", self.slip and {rail.value: self.slip for rail in Rail}),
            ("--rail", "rails", self.rails and self.chosen_rails()),
            ("--adhesion", "laws", _is_given("adhesion") and self.adhesion),
            ("--speed", "speeds", self.speeds),
            ("--loaded", "loads", self.loaded and "loaded"),
            ("--initial-speed", "initial_speed", _is_given("initial_speed") and self.initial_speed),
        )
        for flag, name, value in named:
            if value:
                found = naming(flag, functools.partial(found.at, **{name: value}))
        laws_of = "--adhesion" if path is None or _is_given("adhesion") else f"{source}: {file_name(path)}: envelope"
        naming(laws_of, found.check_files)
        return found

    def law(self, rail: Rail) -> AdhesionLaw:
        """The adhesion law on a rail, at the vehicle's wheel load."""
        load = self.chosen_vehicle.wheel_load
        if not is_file(self.adhesion):
            return published_law(self.adhesion, rail, self.initial_speed, load)
        assumed = not _is_given("initial_speed")
        return law_from_file(Path(self.adhesion), self.initial_speed, load, assumed=assumed).on(rail)

    def _takes_initial_speed(self, speed: float) -> bool:
        """Whether the law has parameters at another v0, km/h."""
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
        """The operating points, in the order rail, mass, speed; at a `reference` slip, the law's without, but at that
        of the option before either."""
        vehicle, speeds = self.chosen_vehicle, tuple(dict.fromkeys(self.speeds)) or (100.0,)
        found = []
        for rail in self.chosen_rails():
            law = self.law(rail)
            held = law.reference_slip(rail) if reference is None else reference.on(rail)
            held = held if self.slip is None else self.slip
            if held is None:
                raise InputError(f"--slip: adhesion {self.adhesion!r} has no reference slip; give --slip X")
            try:
                for mass, speed in itertools.product(dict.fromkeys(self.masses) or (None,), speeds):
                    car, v0 = _with_mass(vehicle, mass), self.initial_speed
                    found.append(operating_point(law, car, speed * KMH, held, rail=rail, initial_speed_kmh=v0))
            except DomainError as error:
                if self.slip is not None:
                    raise
                raise InputError(f"--speed: the law's own {' '.join(str(error).split(': ', 1))}") from None
        if max(speeds) > self.initial_speed:
            other = f", or --initial-speed {max(speeds):g}" if self._takes_initial_speed(max(speeds)) else ""
            warn(
                f"--speed: {max(speeds):g} km/h is above {self.initial_speed:g} km/h, the v0 at which the brake is "
                f"applied, which a braking train does not reach again; give another{other}"
            )
        return found

    def chosen_rails(self) -> tuple[Rail, ...]:
        """The rail conditions named, each once and in the order given; both if none is."""
        for rail in self.rails:
            if rail.lower() not in tuple(Rail):
                raise InputError(f"--rail: {rail!r} is not a rail condition; choose dry or wet")
        return tuple(dict.fromkeys(Rail(rail.lower()) for rail in self.rails)) or tuple(Rail)

    # --- a braking run ----------------------------------------------------------------------------------------------

    def run_scenario(self) -> Scenario:
        """The scenario with what was given changed; what was assumed of its vehicle is said on standard error."""
        scenario = naming("--scenario", lambda: load_scenario(self.scenario))
        vehicle = self._run_vehicle(scenario.vehicle)
        tell_remarks(vehicle)
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
                changes[name] = type(record)(**{**dict(record), **update})  # checked anew
        if self.rails:
            (changes["rail"],) = self.chosen_rails()
        v0 = self.law_speed(start)
        if _is_given("adhesion") or scenario.has_named_law:
            name = self.adhesion if _is_given("adhesion") else scenario.adhesion.name
            changes["adhesion"] = self._run_law(name, vehicle, v0)
        elif _is_given("initial_speed"):
            raise InputError("--initial-speed: this scenario's adhesion has parameters of its own; leave it out")
        if not math.isclose(v0, start):
            warn(
                f"--initial-speed: the adhesion is that of brakes applied at {v0 / KMH:g} km/h, but this run begins at "
                f"{start / KMH:g} km/h (--speed)"
            )
        return scenario.for_vehicle(vehicle).with_changes(**changes)

    def law_speed(self, start: float) -> float:
        """v0 of the adhesion law of a run, m/s: its own `start`, unless it is given."""
        return self.initial_speed * KMH if _is_given("initial_speed") else start

    def _check_run(self, scenario: Scenario) -> None:
        """Refuse what the scenario would refuse, by the names of the options."""
        if self.step is not None and self.step > LARGEST_STEP:
            raise InputError(f"--step: {self.step:g} s is not allowed; give a value <= {LARGEST_STEP:g} s")
        if self.speeds and not self.speeds[0] * KMH > scenario.final_speed:
            final = f"{scenario.final_speed / KMH:g} km/h"
            raise InputError(
                f"--speed: {self.speeds[0]:g} km/h is not allowed; give a value > {final}, at which the run ends"
            )

    def _run_law(self, name: str, vehicle: Vehicle, v0: float) -> AdhesionLaw:
        """The adhesion law of a run; a complaint of v0, m/s, names the option that it came from."""
        try:
            if is_file(name):
                return law_from_file(Path(name), v0 / KMH, vehicle.wheel_load)
            return named_law(name, vehicle, v0)
        except InputError as error:
            if _is_given("initial_speed") or not str(error).startswith("initial speed: "):
                raise
            option = "--speed:" if self.speeds else "--scenario: its initial speed"
            message = str(error).removeprefix("initial speed: ")
            raise InputError(f"{option} {message}; give the law's v0 with --initial-speed") from None

    def _run_vehicle(self, own: Vehicle) -> Vehicle:
        """The scenario's vehicle or the file's, with what was given of it."""
        vehicle = self._own_vehicle(own)
        if vehicle.inertia_scale != own.inertia_scale and self.inertia_scale is None:
            progress(
                f"note: --vehicle: inertia scale {vehicle.inertia_scale:g}, the file's, in place of the scenario's "
                f"{own.inertia_scale:g}; give --inertia-scale for another"
            )
        vehicle = self._changed(vehicle.loaded() if self.loaded else vehicle)
        for mass in self.masses:
            vehicle = vehicle.model_copy(update={"mass": mass, "mass_loaded": max(mass, vehicle.mass_loaded)})
        return vehicle


def _with_mass(vehicle: Vehicle, mass: float | None) -> Vehicle:
    return vehicle if mass is None else vehicle.with_mass(mass)


def tell_remarks(vehicle: Vehicle) -> None:
    """What was assumed of a vehicle, on standard error."""
    for note in remarks(vehicle):
        progress(f"note: {vehicle.name}: {note}")


def number_option(
    name: str,
    unit: str,
    text: str,
    left_out: str,
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    **kind: Any,
) -> Option:
    """As `option`, for a `Number` in a unit, after which the help calls it."""
    metavar = {"1": "X", "km/h": "KMH"}.get(unit) or (unit.upper() if unit.isalpha() else "X")
    return option(name, metavar, text, left_out, type=Number(unit, gt=gt, ge=ge, lt=lt), **kind)


def case_options(*, speeds: bool = True, masses: bool = False, run: bool = False, over: bool = False) -> Option:
    """The options that name a vehicle and where it is looked at, handed to the command as one `CaseOptions`.

    Without `speeds` for whole stops, with several `masses`, each combined with every rail and speed, for a `run`, which
    takes one of each, or `over` an envelope, which has what is left out, and whose loads are not a mass alone.
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
    laws = f"{', '.join(law_names())}; a file with a law and its parameters; or a Python file with a law of your own"
    law = f"Adhesion law: {laws}, which is run."
    rail = ("Rail at the start.", _SCENARIO) if run else ("Rail condition; repeatable.", of_envelope or "both")
    v0 = "Speed v0 at the start of braking, km/h, 30 to 140; the adhesion law depends on it."
    begin = ("Speed at which the brake is applied, km/h.", _SCENARIO)
    speed = begin if run else ("Train speed, km/h; repeatable.", of_envelope or "100; an envelope has its own")
    vehicle = "Vehicle: .toml, or a railtoolkit .yaml; published adhesion is scaled with its wheel load."
    mass = f"Quarter-car mass M, kg; the wheel load stays{'; repeatable' * masses}."
    scale = (
        "Factor on M, J and B, in runs also on the stiffness of a published dynamic law. 1: SI; 3.6: units as in the "
        "paper."
    )
    unnamed = _SCENARIO if run else of_envelope or "bristle; an envelope has its own"
    late = "Actuator dead time, s; linearize leaves it out."
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
        scenario = "The published run as published or in SI, a plain stop, or a file."
        of_run = [
            preset("--scenario", f"{'|'.join(BUILT_IN)}|FILE.toml", scenario, BUILT_IN[0]),
            number_option("--step", "s", "Largest step of the integration, s.", _SCENARIO, ge=LEAST_STEP),
            number_option(
                "--gradient", "1", "Gradient, ratio of rise to length; downhill negative.", _SCENARIO, ge=-STEEPEST
            ),
            number_option("--torque-gain", "1", "Factor on the commanded torque, which acts.", _SCENARIO, gt=0),
            number_option("--speed-scale", "1", "Factor on the measured train speed.", _SCENARIO, gt=0),
            number_option(
                "--encoder-teeth",
                "1",
                "Teeth of the wheel's encoder, ratio of a turn to one; 0: none.",
                _SCENARIO,
                ge=0,
            ),
            number_option("--believed-radius", "m", "Wheel radius that controllers believe, m.", _SCENARIO, gt=0),
        ]
        return [*of_run, *of_law, *of_speed, *of_vehicle]
    static = ", ".join(name for name, law in law_classes().items() if not law.has_state)
    point = f"Slip ratio of the operating point, 0 < X < 1, or 0 with a static law ({static})."
    slip, kind = (point, Number("1", ge=0, lt=1)) if speeds else ("Reference slip ratio held, 0 < X < 1.", SLIP)
    return [*of_law, *of_speed, option("--slip", "X", slip, "the law's published reference", type=kind), *of_vehicle]


def envelope_options(left_out: str) -> Option:
    """The options that ask for a verdict over an envelope; `left_out` says what holds without them."""
    nominal = switch("--nominal", "Judge an envelope without tolerances.")
    text = (
        "Judge a whole envelope: the vehicle's own ([envelope] in its file) or the default, or that of a TOML file; "
        "--rail, --adhesion, --speed, --slip and --loaded narrow it."
    )
    envelope = option("--envelope", "default|FILE", text, left_out)
    return lambda function: envelope(nominal(function))


def gain_options(left_out: str) -> Option:
    """The options that give the PI gains; `left_out` says what holds without them."""
    kp = 'Proportional gain, N*m/(m/s), or with a unit ("65 N*m/(km/h)").'
    ki = 'Integral gain, N*m/m, or with a unit ("27 N*m/(km/h)/s"); both or neither.'
    of_kp, of_ki = number_option("--kp", "N*m/(m/s)", kp, left_out), number_option("--ki", "N*m/m", ki, left_out)
    return lambda function: of_kp(of_ki(function))


def naming(option: str, made: Callable[[], R]) -> R:
    """What is made, with the option named in its complaint."""
    try:
        return made()
    except InputError as error:
        word = option.removeprefix("--").split(":")[0].replace("-", " ")
        message = str(error).removeprefix("Envelope: ")
        for named in (f"{word}: ", f"{word}s: ", "laws: " if word == "adhesion" else ""):
            message = message.removeprefix(named)
        of_name = message.startswith(f"{word} '")  # adhesion 'beam': ...
        raise InputError(f"{option}{message.removeprefix(word) if of_name else f': {message}'}") from None
    except InfeasibleDesignError as error:
        raise InfeasibleDesignError(f"{option}: {str(error).removeprefix('controller: ')}") from None


def from_file(option: str, path: Path, load: Callable[[Path], R]) -> R:
    """What `load` makes of the file, with the option named in its complaint."""
    if str(path) in ("", "."):
        raise InputError(f"{option}: {str(path)!r} is not a file; give its path")
    return naming(option, lambda: load(path))


def is_file(text: str) -> bool:
    """Whether --adhesion or --controller names a file."""
    return text.lower().endswith((".toml", ".py"))


def law_from_file(path: Path, initial_speed: float, wheel_load: float | None, *, assumed: bool = False) -> AdhesionLaw:
    """The law in a file, at v0 in km/h; warns where it was found at another v0 or wheel load (N) than it is used at.

    `assumed` is whether nobody gave v0, and it is the default.
    """
    law = from_file("--adhesion", path, functools.partial(load_law, initial_speed_kmh=initial_speed))
    if path.suffix.lower() == ".py":  # which says neither
        return law
    if wheel_load is not None:
        _warn_of_wheel_load(law, path, wheel_load)
    _warn_of_initial_speed(path, initial_speed, assumed=assumed)
    return law


def _warn_of_wheel_load(law: AdhesionLaw, path: Path, wheel_load: float) -> None:
    found = from_file("--adhesion", path, wheel_load_in)
    if found is not None and law.has_forces() and abs(wheel_load / found - 1.0) > _LOAD_TOLERANCE:
        warn(
            f"--adhesion: {path} was found at a wheel load of {found:g} N and is used at {wheel_load:g} N; forces "
            "among its parameters do not grow with the load"
        )


def _warn_of_initial_speed(path: Path, initial_speed: float, *, assumed: bool) -> None:
    if is_over_initial_speed(path):
        if assumed:
            warn(
                f"--adhesion: {path} changes with the initial speed v0, and is taken at {initial_speed:g} km/h; give "
                "--initial-speed for another"
            )
        return
    found = from_file("--adhesion", path, initial_speeds_in)
    if found is not None and not (
        found[0] * (1.0 - _SPEED_TOLERANCE) <= initial_speed <= found[1] * (1.0 + _SPEED_TOLERANCE)
    ):
        speeds = " to ".join(dict.fromkeys(f"{speed:.4g}" for speed in found))
        warn(
            f"--adhesion: {path} was found at an initial speed v0 of {speeds} km/h and is used at {initial_speed:g} "
            "km/h (--initial-speed); the adhesion changes with it"
        )


def warn(message: str) -> None:
    """A warning on standard error, said once a command."""
    told = click.get_current_context().meta.setdefault(_TOLD, set())
    if message not in told:
        told.add(message)
        click.echo(f"railslip: warning: {message}", err=True)


def _is_given(option: str) -> bool:
    """Whether an option was given to the command that runs."""
    return click.get_current_context().get_parameter_source(option) is ParameterSource.COMMANDLINE


def refuse_given(*options: str, because: str) -> None:
    """InputError for an option that was given to the command that runs, and is not used."""
    for name in filter(_is_given, options):
        raise InputError(f"--{name.replace('_', '-')}: is not used {because}; leave it out")


def chosen_gains(kp: float | None, ki: float | None) -> PIGains | None:
    """The gains given, both or neither (then None: Table 4's are meant)."""
    if (kp is None) != (ki is None):
        given, missing = ("--kp", "--ki") if ki is None else ("--ki", "--kp")
        raise InputError(f"{missing}: is missing beside {given}; give both gains, or neither for Table 4's")
    return None if kp is None or ki is None else PIGains(kp=kp, ki=ki)


# --- controllers ------------------------------------------------------------------------------------------------------


_RULED = "; ".join(f"{name}, {kind.title}" for name, kind in BY_RULE.items())


def controller_option(left_out: str, **kind: Any) -> Option:
    """`--controller`, the same in every command; `left_out` says what holds where it is not given."""
    text = (
        f"Table 4's PI or ASMC; this project's designs, pi-lead and scheduled; {_RULED}; a file with a controller's "
        "numbers, or a Python file with one of your own, which is run."
    )
    return option("--controller", f"{'|'.join(NAMES)}|FILE.toml|FILE.py", text, left_out, **kind)


def controller_from_file(text: str, vehicle: Vehicle, reference: ReferenceSlip | None, law_speed: float) -> Controller:
    """The controller of a file, ready to run; `reference` and `law_speed` (m/s) where the file says none.

    InputError that names the option.
    """
    from railslip_ctrl.controllers.files import as_control, load_controller

    path = Path(text)
    given = naming("--controller", lambda: load_controller(path, initial_speed=law_speed))
    return naming(f"--controller: {file_name(path)}", lambda: as_control(given, vehicle, reference, path.stem))


def controller_name(text: str) -> str:
    """One of `NAMES`; InputError, with the nearest, for another."""
    name = text.strip().lower().replace("_", "-")
    if name not in NAMES:
        raise InputError(
            f"--controller: {name!r} is not one; {close_match(name, NAMES)}choose one of {', '.join(NAMES)}, or "
            "give FILE.toml or FILE.py"
        )
    return name
