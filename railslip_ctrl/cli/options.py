"""Options that the commands share, and the operating points, scenarios and controllers they name."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import click
from click.core import ParameterSource

from railslip_ctrl.core.errors import InfeasibleDesignError, InputError, RailslipError
from railslip_ctrl.core.units import KMH, to_unit
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.design.envelope import Envelope, load_envelope
from railslip_ctrl.model.adhesion import (
    AdhesionLaw,
    ReferenceSlip,
    initial_speeds_in,
    is_over_initial_speed,
    law_classes,
    law_in,
    law_names,
    load_law,
    published_law,
    wheel_load_in,
)
from railslip_ctrl.model.linearization import OperatingPoint, operating_point
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, PIGains, Rail, Vehicle, remarks
from railslip_ctrl.model.vehicle_files import load_vehicle
from railslip_ctrl.simulation import Scenario
from railslip_ctrl.simulation.catalogue import (
    COLUMNS,
    NAMES,
    Column,
    controller_named,
    default_column,
    is_tuned_when_asked,
    published_reference,
    reference_of,
)
from railslip_ctrl.simulation.controllers import Controller
from railslip_ctrl.simulation.scenario import BUILT_IN, LARGEST_STEP, LEAST_STEP

from .output import progress

F = TypeVar("F", bound=Callable[..., Any])
R = TypeVar("R")

_TABLE_4 = ("pi", "asmc")

# Sizes of numbers taken from the command line: far beyond any vehicle, and far inside the range of doubles.
_SMALLEST, _LARGEST = 1e-12, 1e12
_TOLD = "railslip_ctrl.told"  # in the command's context: its warnings
_LOAD_TOLERANCE = 0.1  # share by which a load may differ from that of the log: an empty and a half-full car
_SPEED_TOLERANCE = 0.1  # share by which v0 may differ: mu_max of [Park2008] Table 1 then changes by 3 %

DEFAULT_ENVELOPE = "default"

LAW_FILES = (".toml", ".py")
"""How the name of a file ends that --adhesion takes."""


class Quantity(click.ParamType[float]):
    """A finite number in `unit`, or text with a unit of that dimension, within bounds."""

    name = "number"

    def __init__(self, unit: str, *, gt: float | None = None, ge: float | None = None, lt: float | None = None) -> None:
        self.unit, self.gt, self.ge, self.lt = unit, gt, ge, lt

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; raise InputError naming the option, the value and the bound."""
        option = param.opts[0] if param is not None else ""
        number = to_unit(value, self.unit, name=option)
        if number != 0 and not _SMALLEST <= abs(number) <= _LARGEST:
            raise InputError(
                f"{option}: {number:g} is beyond any vehicle; give a size between {_SMALLEST:g} and {_LARGEST:g}"
            )
        for holds, sign, bound in (
            (self.gt is None or number > self.gt, ">", self.gt),
            (self.ge is None or number >= self.ge, ">=", self.ge),
            (self.lt is None or number < self.lt, "<", self.lt),
        ):
            if not holds:
                unit = "" if self.unit == "1" else f" {self.unit}"
                raise InputError(f"{option}: {number:g}{unit} is not allowed; give a value {sign} {bound:g}{unit}")
        return number


@dataclass(frozen=True)
class CaseOptions:
    """What the common options say: a vehicle, and the operating points it is looked at in."""

    adhesion: str
    rails: tuple[str, ...]
    speeds: tuple[float, ...]
    initial_speed: float
    slip: float | None
    vehicle: Path | None
    loaded: bool
    masses: tuple[float, ...]
    inertia_scale: float | None
    dead_time: float | None
    lag: float | None

    @cached_property
    def chosen_vehicle(self) -> Vehicle:
        """The vehicle, with the (first) mass given; what was assumed of it is said on standard error."""
        chosen = self.given_vehicle.loaded() if self.loaded else self.given_vehicle
        chosen = _with_mass(chosen, self.masses[0] if self.masses else None)
        for note in remarks(chosen):
            click.echo(f"railslip: note: {chosen.name}: {note}", err=True)
        return chosen

    @cached_property
    def given_vehicle(self) -> Vehicle:
        """The vehicle of the file, empty, with the brake given."""
        chosen = PARK2008 if self.vehicle is None else from_file("--vehicle", self.vehicle, load_vehicle)
        update: dict[str, object] = {}
        if self.inertia_scale is not None:
            update["inertia_scale"] = self.inertia_scale
        actuator = {k: v for k, v in (("dead_time", self.dead_time), ("lag", self.lag)) if v is not None}
        if actuator:
            update["actuator"] = chosen.actuator.model_copy(update=actuator)
        return chosen.model_copy(update=update)

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
        if given.lower() != DEFAULT_ENVELOPE:
            found = from_file("--envelope", Path(given), lambda path: load_envelope(path, car))
        elif self.vehicle is not None:
            found = from_file("--vehicle", self.vehicle, lambda path: load_envelope(path, car))
        else:
            found = Envelope(car)
        slips = {} if self.slip is None else {"reference": {rail.value: self.slip for rail in Rail}}
        named: dict[str, Any] = {
            "rails": self.rails and self.chosen_rails(),
            "laws": _is_given("adhesion") and (self.adhesion,),
            "speeds": self.speeds,
            "loads": self.loaded and ("loaded",),
            "initial_speed": _is_given("initial_speed") and self.initial_speed,
            **slips,
        }
        return found.at(**{name: value for name, value in named.items() if value})

    def law(self, rail: Rail) -> AdhesionLaw:
        """The adhesion law on a rail, at the vehicle's wheel load."""
        return _law(self.adhesion, rail, self.initial_speed, self.chosen_vehicle.wheel_load)

    def _takes_initial_speed(self, speed: float) -> bool:
        """Whether the law has parameters at another v0, km/h."""
        path = Path(self.adhesion)
        try:
            if not is_law_file(self.adhesion):
                published_law(self.adhesion, Rail.DRY, speed)
            elif path.suffix.lower() == ".toml":
                load_law(path, initial_speed_kmh=speed)
        except RailslipError:
            return False
        return True

    def points(self) -> list[OperatingPoint]:
        """The operating points, in the order rail, mass, speed."""
        vehicle, speeds = self.chosen_vehicle, tuple(dict.fromkeys(self.speeds)) or (100.0,)
        if max(speeds) > self.initial_speed:
            other = f", or --initial-speed {max(speeds):g}" if self._takes_initial_speed(max(speeds)) else ""
            warn(
                f"--speed: {max(speeds):g} km/h is above {self.initial_speed:g} km/h, the v0 at which the brake is "
                f"applied, which a braking train does not reach again; give another{other}"
            )
        found = []
        for rail in self.chosen_rails():
            law = self.law(rail)
            held = self.slip if self.slip is not None else law.reference_slip(rail)
            if held is None:
                raise InputError(f"--slip: adhesion {self.adhesion!r} has no reference slip; give --slip X")
            found += [
                operating_point(
                    law,
                    _with_mass(vehicle, mass),
                    speed * KMH,
                    held,
                    rail=rail,
                    initial_speed_kmh=self.initial_speed,
                )
                for mass, speed in itertools.product(dict.fromkeys(self.masses) or (None,), speeds)
            ]
        return found

    def chosen_rails(self) -> tuple[Rail, ...]:
        """The rail conditions named, each once and in the order given; both if none is."""
        for rail in self.rails:
            if rail.lower() not in tuple(Rail):
                raise InputError(f"--rail: {rail!r} is not a rail condition; choose dry or wet")
        return tuple(dict.fromkeys(Rail(rail.lower()) for rail in self.rails)) or tuple(Rail)


def _with_mass(vehicle: Vehicle, mass: float | None) -> Vehicle:
    return vehicle if mass is None else vehicle.with_mass(mass)


def case_options(function: F) -> F:
    """The options that name a vehicle and its operating points, handed to the command as one `CaseOptions`."""
    return _collected(function, multiple_masses=False)


def family_options(function: F) -> F:
    """As `case_options`, with the mass repeatable too: every mass is combined with every rail and speed."""
    return _collected(function, multiple_masses=True)


def stop_options(function: F) -> F:
    """As `case_options` without the speed, for a command that looks at whole stops."""
    return _collected(function, multiple_masses=False, speeds=False)


def _collected(function: F, *, multiple_masses: bool, speeds: bool = True) -> F:
    @functools.wraps(function)
    def wrapped(**given: Any) -> Any:
        if not speeds:
            given["speeds"] = ()
        if not multiple_masses:
            mass = given.pop("mass")
            given["masses"] = () if mass is None else (mass,)
        cases = CaseOptions(**{field.name: given.pop(field.name) for field in fields(CaseOptions)})
        return function(cases=cases, **given)

    options = [*_point_options(speeds=speeds), _mass_option(multiple=multiple_masses), *_actuator_options()]
    command = cast(F, wrapped)
    for option in reversed(options):
        command = option(command)
    return command


def _mass_option(*, multiple: bool) -> Any:
    return click.option(
        "--mass",
        "masses" if multiple else "mass",
        multiple=multiple,
        type=Quantity("kg", gt=0),
        metavar="KG",
        help="Quarter-car mass M, kg; the wheel load stays"
        + ("; repeatable." if multiple else ".")
        + "  [default: the vehicle's]",
    )


def _point_options(*, speeds: bool) -> list[Any]:
    speed = click.option(
        "--speed",
        "speeds",
        multiple=True,
        type=Quantity("km/h", gt=0),
        metavar="KMH",
        help="Train speed, km/h; repeatable.  [default: 100]",
    )
    return [
        click.option(
            "--adhesion",
            default="bristle",
            show_default=True,
            metavar="LAW|FILE.toml|FILE.py",
            help=f"Adhesion law: {', '.join(law_names())}; a file with a law and its parameters; or a Python file with "
            "a law of your own, which is run.",
        ),
        click.option(
            "--rail",
            "rails",
            multiple=True,
            metavar="dry|wet",
            help="Rail condition; repeatable.  [default: both]",
        ),
        *([speed] if speeds else []),
        click.option(
            "--initial-speed",
            default=INITIAL_SPEED_KMH,
            show_default=True,
            type=Quantity("km/h", gt=0),
            metavar="KMH",
            help="Speed v0 at which the brake was applied, km/h, 30 to 140; a parameter of the adhesion law.",
        ),
        _slip_option(of_point=speeds),
        click.option(
            "--vehicle",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="Vehicle: .toml, or a railtoolkit .yaml.  [default: the published vehicle]",
        ),
        click.option("--loaded", is_flag=True, help="Use the vehicle's loaded mass and wheel load."),
        click.option(
            "--inertia-scale",
            type=Quantity("1", gt=0),
            metavar="X",
            help="Factor on M, J and B: 1 is SI, 3.6 the as-published reading.  [default: the vehicle's, 1]",
        ),
        click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else."),
    ]


def _slip_option(*, of_point: bool) -> Any:
    """The slip of an operating point, or that held through whole stops."""
    static = ", ".join(name for name, law in law_classes().items() if not law.has_state)
    return click.option(
        "--slip",
        type=Quantity("1", ge=0, lt=1) if of_point else Quantity("1", gt=0, lt=1),
        metavar="X",
        help=(
            f"Slip ratio of the operating point, 0 < X < 1, or 0 with a static law ({static})."
            if of_point
            else "Reference slip ratio held, 0 < X < 1."
        )
        + "  [default: the law's published reference]",
    )


def _actuator_options() -> list[Any]:
    return [
        click.option(
            "--dead-time",
            type=Quantity("s", ge=0),
            metavar="S",
            help="Actuator dead time, s; it is in loops, not in the linearised plant.  [default: the vehicle's]",
        ),
        click.option("--lag", type=Quantity("s", ge=0), metavar="S", help="Actuator lag, s.  [default: the vehicle's]"),
    ]


def envelope_options(left_out: str) -> Callable[[F], F]:
    """The options that ask for a verdict over an envelope; `left_out` says what holds without them."""
    nominal = click.option(
        "--nominal", is_flag=True, help="Judge its operating points alone, without tolerances around them."
    )
    envelope = click.option(
        "--envelope",
        metavar="default|FILE",
        help="Judge a whole envelope: the vehicle's own ([envelope] in its file) or the default, or that of a TOML "
        f"file; --rail, --adhesion, --speed, --slip and --loaded narrow it.  [default: {left_out}]",
    )
    return lambda function: envelope(nominal(function))


def gain_options(function: F) -> F:
    """The options that give the PI gains."""
    for option in (
        click.option(
            "--ki",
            type=Quantity("N*m/m"),
            metavar="X",
            help='Integral gain, N*m/m, or with a unit ("27 N*m/(km/h)/s"); both or neither.  [default: Table 4\'s]',
        ),
        click.option(
            "--kp",
            type=Quantity("N*m/(m/s)"),
            metavar="X",
            help='Proportional gain, N*m/(m/s), or with a unit ("65 N*m/(km/h)").  [default: Table 4\'s]',
        ),
    ):
        function = option(function)
    return function


def from_file(option: str, path: Path, load: Callable[[Path], R]) -> R:
    """What `load` makes of the file, with the option named in its complaint."""
    if str(path) in ("", "."):
        raise InputError(f"{option}: {str(path)!r} is not a file; give its path")
    try:
        return load(path)
    except InputError as error:
        raise InputError(f"{option}: {error}") from None


def _law(adhesion: str, rail: Rail, initial_speed: float, wheel_load: float) -> AdhesionLaw:
    if not is_law_file(adhesion):
        return published_law(adhesion, rail, initial_speed, wheel_load)
    return law_from_file(Path(adhesion), initial_speed, wheel_load, assumed=not _is_given("initial_speed")).on(rail)


def is_law_file(adhesion: str) -> bool:
    """Whether --adhesion names a file."""
    return adhesion.lower().endswith(LAW_FILES)


def law_from_file(path: Path, initial_speed: float, wheel_load: float | None, *, assumed: bool = False) -> AdhesionLaw:
    """The law in a file, at v0 in km/h; warns where it was found at another v0 or wheel load (N) than it is used at.

    `assumed` is whether nobody gave v0, and it is the default.
    """
    if path.suffix.lower() == ".py":
        return from_file("--adhesion", path, law_in)
    law = from_file("--adhesion", path, functools.partial(load_law, initial_speed_kmh=initial_speed))
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


def chosen_gains(kp: float | None, ki: float | None) -> PIGains | None:
    """The gains given, both or neither (then None: Table 4's are meant)."""
    if (kp is None) != (ki is None):
        given, missing = ("--kp", "--ki") if ki is None else ("--ki", "--kp")
        raise InputError(f"{missing}: is missing beside {given}; give both gains, or neither for Table 4's")
    return None if kp is None or ki is None else PIGains(kp=kp, ki=ki)


# --- the options that name a braking run's scenario and controller ---------------------------------------------------


@dataclass(frozen=True)
class ScenarioOptions:
    """What the options say of the scenario."""

    scenario: str
    adhesion: str | None
    rail: str | None
    speed: float | None
    initial_speed: float | None
    vehicle: Path | None
    loaded: bool
    mass: float | None
    inertia_scale: float | None
    dead_time: float | None
    lag: float | None
    step: float | None

    def chosen(self) -> Scenario:
        """The scenario with what was given changed; what was assumed of its vehicle is said on standard error."""
        from railslip_ctrl.simulation.scenario import load_scenario

        scenario = _naming("--scenario", lambda: load_scenario(self.scenario))
        vehicle = self._vehicle(scenario.vehicle)
        for note in remarks(vehicle):
            progress(f"note: {vehicle.name}: {note}")
        self._check(scenario)
        changes: dict[str, Any] = {"initial_speed": scenario.initial_speed if self.speed is None else self.speed * KMH}
        if self.step is not None:
            changes["step"] = self.step
        if self.rail is not None:
            if self.rail.lower() not in tuple(Rail):
                raise InputError(f"--rail: {self.rail!r} is not a rail condition; choose dry or wet")
            changes["rail"] = Rail(self.rail.lower())
        v0 = self.law_speed(changes["initial_speed"])
        if self.adhesion is not None:
            changes["adhesion"] = self._law(self.adhesion, vehicle, v0)
        elif scenario.has_named_law:
            changes["adhesion"] = self._law(scenario.adhesion.name, vehicle, v0)
        elif self.initial_speed is not None:
            raise InputError("--initial-speed: this scenario's adhesion has parameters of its own; leave it out")
        if not math.isclose(v0, changes["initial_speed"]):
            run = f"{changes['initial_speed'] / KMH:g} km/h"
            warn(
                f"--initial-speed: the adhesion is that of brakes applied at {v0 / KMH:g} km/h, but this run begins at "
                f"{run} (--speed)"
            )
        return scenario.for_vehicle(vehicle).with_changes(**changes)

    def law_speed(self, initial_speed: float) -> float:
        """v0 of adhesion laws, m/s: the run's, unless it is given."""
        return initial_speed if self.initial_speed is None else self.initial_speed * KMH

    def _check(self, scenario: Scenario) -> None:
        """Refuse what the scenario would refuse, by the names of the options."""
        if self.step is not None and self.step > LARGEST_STEP:
            raise InputError(f"--step: {self.step:g} s is not allowed; give a value <= {LARGEST_STEP:g} s")
        if self.speed is not None and not self.speed * KMH > scenario.final_speed:
            final = f"{scenario.final_speed / KMH:g} km/h"
            raise InputError(
                f"--speed: {self.speed:g} km/h is not allowed; give a value > {final}, at which the run ends"
            )

    def _law(self, name: str, vehicle: Vehicle, v0: float) -> Any:
        """The adhesion law; a complaint of v0 names the option that it came from."""
        try:
            return _run_law(name, vehicle, v0)
        except InputError as error:
            if self.initial_speed is not None or not str(error).startswith("initial speed: "):
                raise
            option = "--scenario: its initial speed" if self.speed is None else "--speed:"
            message = str(error).removeprefix("initial speed: ")
            raise InputError(f"{option} {message}; give the law's v0 with --initial-speed") from None

    def _vehicle(self, own: Vehicle) -> Vehicle:
        """The scenario's vehicle or the file's, with what was given of it."""
        vehicle = own
        if self.vehicle is not None:
            from railslip_ctrl.model.vehicle_files import load_vehicle

            path = self.vehicle
            vehicle = _naming("--vehicle", lambda: load_vehicle(path))
            if vehicle.inertia_scale != own.inertia_scale and self.inertia_scale is None:
                progress(
                    f"note: --vehicle: inertia scale {vehicle.inertia_scale:g}, the file's, in place of the scenario's "
                    f"{own.inertia_scale:g}; give --inertia-scale for another"
                )
        if self.loaded:
            vehicle = vehicle.loaded()
        update: dict[str, Any] = {}
        if self.mass is not None:
            update = {"mass": self.mass, "mass_loaded": max(self.mass, vehicle.mass_loaded)}
        if self.inertia_scale is not None:
            update["inertia_scale"] = self.inertia_scale
        actuator = {k: v for k, v in (("dead_time", self.dead_time), ("lag", self.lag)) if v is not None}
        if actuator:
            update["actuator"] = vehicle.actuator.model_copy(update=actuator)
        return vehicle.model_copy(update=update)


@dataclass(frozen=True)
class ControllerOptions:
    """What the options say of the controller."""

    controller: str
    gains: str | None
    kp: float | None
    ki: float | None
    slip: float | None
    unknown_rail: bool
    adaptive: bool
    period: float | None

    def chosen(self, scenario: Scenario, law_speed: float) -> tuple[Controller, str | None]:
        """The controller, and the column of Table 4 that its gains are from, if any.

        `law_speed`, m/s, is v0 of an adhesion model of the controller's own.
        """
        if is_controller_file(self.controller):
            return self._from_file(scenario, law_speed), None
        name = controller_name(self.controller)
        gains = chosen_gains(self.kp, self.ki)
        column = self._column(scenario)
        reference = self._reference(scenario, column)
        if is_tuned_when_asked(name, scenario.vehicle, gains):
            progress(f"tuning {name} for {scenario.vehicle.name}; this takes some seconds")
        made = _naming(
            "--controller",
            lambda: controller_named(
                name,
                scenario.vehicle,
                column=column,
                gains=gains,
                reference=reference,
                knows_rail=not self.unknown_rail,
                adaptive=self.adaptive,
                period=self.period,
            ),
        )
        return made, column if name in _TABLE_4 and gains is None else None

    def _column(self, scenario: Scenario) -> Column:
        if self.gains is None:
            return default_column(scenario.adhesion)
        for column in COLUMNS:
            if column == self.gains.lower():
                return column
        raise InputError(f"--gains: {self.gains!r} is not a column of Table 4; choose {' or '.join(COLUMNS)}")

    def _reference(self, scenario: Scenario, column: Column) -> ReferenceSlip:
        if self.slip is not None:
            return ReferenceSlip(dry=self.slip, wet=self.slip)
        if self.gains is not None:
            return published_reference(column)
        return reference_of(scenario.adhesion, "--slip", "--slip X, or --gains for that of Table 4")

    def _from_file(self, scenario: Scenario, law_speed: float) -> Controller:
        for option, given in (
            ("--gains", self.gains),
            ("--kp", self.kp),
            ("--ki", self.ki),
            ("--slip", self.slip),
            ("--period", self.period),
            ("--unknown-rail", self.unknown_rail or None),
            ("--adaptive", self.adaptive or None),
        ):
            if given is not None:
                raise InputError(f"{option}: does not go with a controller from a file; put it into {self.controller}")
        return controller_from_file(self.controller, scenario.vehicle, scenario.adhesion.reference, law_speed)


def collected(function: F) -> F:
    """The options of scenario and controller, handed to the command as `scenario_options`, `controller_options`."""

    @functools.wraps(function)
    def wrapped(**given: Any) -> Any:
        scenario = ScenarioOptions(**{field.name: given.pop(field.name) for field in fields(ScenarioOptions)})
        controller = ControllerOptions(**{field.name: given.pop(field.name) for field in fields(ControllerOptions)})
        return function(scenario_options=scenario, controller_options=controller, **given)

    command = cast(F, wrapped)
    for option in reversed([*_scenario_options(), *_controller_options()]):
        command = option(command)
    return command


def _scenario_options() -> list[Any]:
    def number(name: str, unit: str, text: str, **bounds: float) -> Any:
        return click.option(name, type=Quantity(unit, **bounds), metavar=unit.upper().replace("/", ""), help=text)

    return [
        click.option(
            "--scenario",
            default=BUILT_IN[0],
            show_default=True,
            metavar=f"{'|'.join(BUILT_IN)}|FILE.toml",
            help="The published run in the as-published reading or in SI, or a file.",
        ),
        click.option(
            "--adhesion",
            metavar="LAW|FILE.toml|FILE.py",
            help=f"The plant's adhesion law: {', '.join(law_names())}; a file with a law and its parameters; or a "
            "Python file with a law of your own, which is run.  [default: the scenario's]",
        ),
        click.option("--rail", metavar="dry|wet", help="Rail at the start.  [default: the scenario's]"),
        number("--speed", "km/h", "Speed at which the brake is applied, km/h.  [default: the scenario's]", gt=0),
        number("--initial-speed", "km/h", "v0 of a published adhesion law, km/h, 30 to 140.  [default: --speed]", gt=0),
        click.option(
            "--vehicle",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="Vehicle: .toml, or a railtoolkit .yaml; published adhesion follows its wheel load.  "
            "[default: the scenario's]",
        ),
        click.option("--loaded", is_flag=True, help="Use the vehicle's loaded mass and wheel load from the start."),
        number(
            "--mass", "kg", "Quarter-car mass M at the start, kg; the wheel load stays.  [default: the vehicle's]", gt=0
        ),
        click.option(
            "--inertia-scale",
            type=Quantity("1", gt=0),
            metavar="X",
            help="Factor on M, J and B, and on the stiffness of a published dynamic law.  [default: the scenario's]",
        ),
        number("--dead-time", "s", "Actuator dead time, s.  [default: the vehicle's]", ge=0),
        number("--lag", "s", "Actuator lag, s.  [default: the vehicle's]", ge=0),
        number("--step", "s", "Largest step of the integration, s.  [default: the scenario's]", ge=LEAST_STEP),
    ]


def controller_option(default: str | None, *, multiple: bool = False, otherwise: str = "") -> Callable[[F], F]:
    """`--controller`, the same in every command; `otherwise` says what holds where it is not given."""
    told = f"  [default: {otherwise}]" if otherwise else ""
    return click.option(
        "--controller",
        default=default,
        show_default=default is not None,
        multiple=multiple,
        metavar=f"{'|'.join(NAMES)}|FILE.toml|FILE.py",
        help="Table 4's PI or ASMC, this project's designs, a rule-based slide protection, a file with a controller's "
        f"numbers, or a Python file with one of your own, which is run.{told}",
    )


def is_controller_file(text: str) -> bool:
    """Whether a controller is named by its file."""
    return text.lower().endswith((".toml", ".py"))


def controller_from_file(text: str, vehicle: Vehicle, reference: ReferenceSlip | None, law_speed: float) -> Controller:
    """The controller of a file, ready to run; `reference` and `law_speed` (m/s) where the file says none.

    InputError that names the option.
    """
    from railslip_ctrl.simulation.controller_files import load_controller
    from railslip_ctrl.simulation.step_objects import as_control

    path = Path(text)
    return _naming(
        "--controller",
        lambda: as_control(load_controller(path, initial_speed=law_speed), vehicle, reference, path.stem),
    )


def controller_name(text: str) -> str:
    """One of `NAMES`; InputError, with the nearest, for another."""
    name = text.strip().lower().replace("_", "-")
    if name not in NAMES:
        raise InputError(
            f"--controller: {name!r} is not one; {close_match(name, NAMES)}choose one of {', '.join(NAMES)}, or "
            "give FILE.toml or FILE.py"
        )
    return name


def _controller_options() -> list[Any]:
    return [
        controller_option("pi"),
        click.option(
            "--gains",
            metavar="|".join(COLUMNS),
            help="Column of Table 4: gains and reference slip.  [default: gains of beam for the beam law, else of "
            "bristle; slip of the law]",
        ),
        click.option(
            "--slip",
            type=Quantity("1", gt=0, lt=1),
            metavar="X",
            help="Reference slip on either rail.  [default: the adhesion law's; with --gains the column's]",
        ),
        click.option(
            "--unknown-rail", is_flag=True, help="asmc: its adhesion model stays dry when the rail turns wet."
        ),
        click.option("--adaptive", is_flag=True, help="asmc: with the printed adaptation."),
        click.option(
            "--period",
            type=Quantity("s", ge=LEAST_STEP),
            metavar="S",
            help="The controller's sampling period, s.  [default: every step; slide-protection 0.01]",
        ),
    ]


def _run_law(name: str, vehicle: Vehicle, v0: float) -> Any:
    if is_law_file(name):
        return law_from_file(Path(name), v0 / KMH, vehicle.wheel_load)
    from railslip_ctrl.simulation.scenario import named_law

    return named_law(name, vehicle, v0)


def _naming(option: str, made: Callable[[], R]) -> R:
    """What is made, with the option named in its complaint."""
    try:
        return made()
    except InputError as error:
        message = str(error).removeprefix(f"{option.removeprefix('--')}: ")
        raise InputError(f"{option}: {message}") from None
    except InfeasibleDesignError as error:
        raise InfeasibleDesignError(f"{option}: {str(error).removeprefix('controller: ')}") from None
