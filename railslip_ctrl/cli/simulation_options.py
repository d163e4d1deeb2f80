"""The options that name a braking run's scenario and controller."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.model.adhesion import ReferenceSlip, law_names
from railslip_ctrl.model.vehicle import Rail, Vehicle, remarks
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

from .options import Quantity, chosen_gains, is_law_file, law_from_file, warn
from .output import progress

F = TypeVar("F", bound=Callable[..., Any])
R = TypeVar("R")

_TABLE_4 = ("pi", "asmc")


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
            return _law(name, vehicle, v0)
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


def _law(name: str, vehicle: Vehicle, v0: float) -> Any:
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
