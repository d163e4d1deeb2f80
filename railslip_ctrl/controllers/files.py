"""The kinds by name, their files, and whatever is given as a controller.

kind = "pi"                       # a kind's name; the keys are its parameters, plain numbers SI
kp = "336 N*m/(km/h)"
ki = 1220.0
torque_max = "9 kN*m"
hand_over_speed = "20 km/h"       # below it slip is not controlled and hand_over_torque commanded; left out: never
hand_over_torque = 1862.0

[reference]                       # slip ratio to be held; left out: 0.132 dry, 0.092 wet
dry = 0.132
wet = 0.092

A file of a kind of the user's also has `python`, the Python file with its class. A Python file is run and assigns a
controller, or the class of a kind, to `CONTROLLER`.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeGuard

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown
from railslip_ctrl.core.user_files import close_match, file_name, given_path, read_toml, record_in, validated
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.vehicle import Vehicle

from .base import Controller
from .braking import linear_control
from .linear import full_brake_torque
from .pi import PI
from .systems import has_step, is_system, linear_controller, linear_of
from .user_step import StepControl

if TYPE_CHECKING:
    from collections.abc import Mapping


@cache
def controller_kinds() -> Mapping[str, type[Controller]]:
    """The kinds that a file may have, by name."""
    found: dict[str, type[Controller]] = {}
    names = {one.name for one in pkgutil.iter_modules([str(Path(__file__).parent)])} - {"step_calls"}  # it loads Numba
    for name in names:
        module = importlib.import_module(f"{__package__}.{name}")
        for value in vars(module).values():
            if is_kind(value) and value.__module__ == module.__name__ and value is not StepControl:
                found[value.kind] = value
    return MappingProxyType(dict(sorted(found.items())))


def _check_kind(kind: type[Controller], where: str) -> None:
    """InputError for a class that lacks what a kind has."""
    for name in ("kind", "title", "source"):
        if not isinstance(getattr(kind, name, None), str):
            raise InputError(f"{where}: {kind.__name__} has no {name}; give it kind, title and source, texts")
    if kind.step is Controller.step:
        raise InputError(f"{where}: {kind.__name__} has no step; give it step(state, measurement, parameters)")
    if not isinstance(inspect.getattr_static(kind, "step"), staticmethod):
        raise InputError(f"{where}: {kind.__name__}.step is no static method; write @staticmethod above it")


def is_kind(thing: Any) -> TypeGuard[type[Controller]]:
    """Whether it is the class of a kind."""
    return inspect.isclass(thing) and issubclass(thing, Controller) and "kind" in vars(thing)


@cache
def structures() -> Mapping[str, type[Controller]]:
    """The kinds that `tune` makes: those with gains kp and ki, and those with a loop of their own; by name."""
    made = {name: kind for name, kind in controller_kinds().items() if issubclass(kind, PI)}
    own = {name: kind for name, kind in controller_kinds().items() if kind.loop is not Controller.loop}
    return MappingProxyType({**made, **own})


def structure_named(name: str | type[Controller]) -> type[Controller]:
    """The class of a kind that `tune` makes: by its name, by a Python file that assigns it to CONTROLLER, or itself.

    InputError for anything else.
    """
    if isinstance(name, str) and name.lower().endswith(".py"):
        path, name = Path(name), _from_python(Path(name))
        if not is_kind(name):
            raise InputError(f"structure: {file_name(path)} assigns no class of a kind to CONTROLLER; give one")
    if is_kind(name):
        if name.loop is Controller.loop and name.linear is Controller.linear:
            raise InputError(f"structure: {name.kind} cannot be tuned: {name.no_loop}; simulate and campaign run it")
        return name
    if name not in structures():
        raise InputError(f"structure: {shown(name)} is not known; choose one of {', '.join(structures())}")
    return structures()[str(name)]


@checked
def load_controller(path: str | Path, *, initial_speed: float | None = None) -> Any:
    """Read a controller.

    - path: the TOML file; the module says what is in it. A Python file is run as a script is: give only those you
      trust.
    - initial_speed: v0 of the run, m/s, at which an adhesion model of its own is taken that has polynomials of v0; not
      needed without.

    Returns what a run takes (SI); of a Python file its `CONTROLLER`: a linear system, a step object, a function, a
    controller, or the class of a kind. InputError: one line naming the file, the key, the value and what is allowed; of
    a Python file that fails, its line.
    """
    path = given_path(path)
    where = file_name(path)
    if path.suffix.lower() == ".py":
        return _from_python(path)
    content = read_toml(path)
    made = _kind_of(content, path, where)
    keys = {name: value for name, value in content.items() if name not in ("kind", "python")}
    if not keys.get("name"):
        keys["name"] = made.kind
    try:
        return made.from_keys(keys, path, initial_speed)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None


def _kind_of(content: dict[str, Any], path: Path, where: str) -> type[Controller]:
    """The class of the kind that a file names."""
    kind, kinds = content.get("kind"), controller_kinds()
    if isinstance(python := content.get("python"), str):
        given = _from_python(path.parent / python)
        own: Any = given if inspect.isclass(given) else type(given)
        if not is_kind(own) or own.kind != kind:
            raise InputError(f"{where}: kind: {shown(kind)} is not the kind that {python} assigns to CONTROLLER")
        return own
    if not isinstance(kind, str) or kind not in kinds:
        given = "missing" if kind is None else f"{shown(kind)} is not one"
        near = close_match(kind, kinds) if isinstance(kind, str) else ""
        raise InputError(f"{where}: kind: {given}; {near}choose one of {', '.join(kinds)}")
    return kinds[kind]


def _from_python(path: Path) -> Any:
    """What a Python file calls `CONTROLLER`; InputError, which names the file, for what is no controller."""
    found = record_in(path, "CONTROLLER", ())
    own: Any = found if inspect.isclass(found) else type(found)
    if issubclass(own, Controller):
        _check_kind(own, f"{file_name(path)}: CONTROLLER")
    if isinstance(found, Controller) or is_kind(found) or (has_step(found) and not inspect.isclass(found)):
        return found
    if inspect.isclass(found) or not callable(linear_of(found)):
        try:
            linear_controller(found)
        except InputError as error:
            told = str(error).removeprefix("controller: ")
            raise InputError(f"{file_name(path)}: CONTROLLER: {told}") from None
    return found


def as_control(
    controller: Any, vehicle: Vehicle, reference: ReferenceSlip | None, name: str | None = None
) -> Controller:
    """Whatever is given as a controller, as one that runs on a vehicle that it believes to have.

    - controller: a `Controller` or a design that has one; the class of a kind, which is made for the vehicle by its
      rule; a linear system (`systems.linear_controller`), sampled every 10 ms or at its own period, by Tustin's rule,
      within 0 and the vehicle's full brake, with anti-windup; or anything else with a step, called at its `period`.
    - vehicle: what the controller believes where its parameters do not say it.
    - reference, name: where it says none.

    InputError for what is none of these, or a linear one without a reference slip.
    """
    if isinstance(own := getattr(controller, "controller", None), Controller):
        controller = own
    made: Any = controller.for_vehicle(vehicle) if is_kind(controller) else controller
    if isinstance(made, Controller):
        if made.reference is None and made.follows_reference:
            if reference is None:
                raise _no_reference()
            made = made.model_copy(update={"reference": reference})
        return made.believing(vehicle)  # type: ignore[no-any-return]
    own_reference, told = getattr(controller, "reference", None), own_name(controller) or name
    if has_step(controller) and not inspect.isclass(controller):
        period = {} if getattr(controller, "period", None) is None else {"period": controller.period}
        told = told or getattr(controller, "__name__", None) or type(controller).__name__
        fields = {"thing": controller, "reference": own_reference, "name": str(told), **period}
        return validated(StepControl, fields, f"controller {told}")
    if not is_system(controller) and callable(linear_of(controller)) and not inspect.isclass(controller):
        raise InputError(
            f"controller: {type(controller).__name__} is linear at an operating point and has no step to run by; give "
            "it step(t, v, omega)"
        )
    design, held = linear_controller(controller), own_reference or reference
    if held is None:
        raise _no_reference()
    told = told or design.structure.removesuffix(" N*m/(m/s)").lower().replace(" ", "-")
    limits = {"torque_min": 0.0, "torque_max": full_brake_torque(vehicle)}
    return linear_control(design, reference=held, name=told, **limits).believing(vehicle)


def _no_reference() -> InputError:
    return InputError("controller: neither it nor the adhesion law has a reference slip; give it a reference")


def own_name(controller: Any) -> str | None:
    """The name that a controller was given; None without one, as of python-control's systems named sys[3]."""
    name = getattr(controller, "name", None)
    return None if not name or "[" in str(name) else str(name)
