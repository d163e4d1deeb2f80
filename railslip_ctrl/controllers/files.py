"""Lists the kinds of controllers, reads controller files, and converts any controller object to a `Controller`.

Example of a controller file:

kind = "pi"                       # name of the kind; the other keys are its parameters; plain numbers are SI
kp = "336 N*m/(km/h)"
ki = 1220.0
torque_max = "9 kN*m"
hand_over_speed = "20 km/h"       # speed below which hand_over_torque is commanded; without this key: none
hand_over_torque = 1862.0

[reference]                       # reference slip ratio; without this table: 0.132 dry, 0.092 wet
dry = 0.132
wet = 0.092

The file of a kind that the user defines also has the key `python`: the name of the Python file with the class. A Python
file is run; it must assign a controller, or the class of a kind, to `CONTROLLER`.
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
    """Return the controller classes of this package; the keys are the values of `kind` in controller files."""
    kinds: dict[str, type[Controller]] = {}
    names = {module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)])}
    for name in names - {"step_calls"}:  # this module loads Numba
        module = importlib.import_module(f"{__package__}.{name}")
        for value in vars(module).values():
            if is_kind(value) and value.__module__ == module.__name__ and value is not StepControl:
                kinds[value.kind] = value
    return MappingProxyType(dict(sorted(kinds.items())))


def _check_kind(kind: type[Controller], where: str) -> None:
    for name in ("kind", "title", "source"):
        if not isinstance(getattr(kind, name, None), str):
            raise InputError(
                f"{where}: class {kind.__name__} has no attribute {name}; define the class attributes kind, title and "
                "source as texts"
            )
    if kind.step is Controller.step:
        raise InputError(
            f"{where}: class {kind.__name__} has no method step; define a static step(state, measurement, parameters)"
        )
    if not isinstance(inspect.getattr_static(kind, "step"), staticmethod):
        raise InputError(f"{where}: {kind.__name__}.step is not a static method; write @staticmethod above it")


def is_kind(thing: Any) -> TypeGuard[type[Controller]]:
    """Return True if an object is a class derived from `Controller` that defines the attribute `kind`."""
    return inspect.isclass(thing) and issubclass(thing, Controller) and "kind" in vars(thing)


@cache
def structures() -> Mapping[str, type[Controller]]:
    """Return the controller classes that `tune` can tune (PI, and classes that define `loop`); keys are their names."""
    with_gains = {name: kind for name, kind in controller_kinds().items() if issubclass(kind, PI)}
    with_loop = {name: kind for name, kind in controller_kinds().items() if kind.loop is not Controller.loop}
    return MappingProxyType({**with_gains, **with_loop})


def structure_named(name: str | type[Controller]) -> type[Controller]:
    """Return a controller class that `tune` can tune; InputError if there is none.

    `name` is a name in `structures`, the name of a Python file that assigns the class to CONTROLLER, or a class.
    """
    if isinstance(name, str) and name.lower().endswith(".py"):
        path, name = Path(name), _from_python(Path(name))
        if not is_kind(name):
            raise InputError(f"structure: CONTROLLER in {file_name(path)} is not a class; assign a Controller class")
    if is_kind(name):
        if name.loop is Controller.loop and name.linear is Controller.linear:
            raise InputError(f"structure: {name.kind} cannot be tuned: {name.no_loop}; use simulate or campaign")
        return name
    if name not in structures():
        raise InputError(f"structure: {shown(name)} is not known; choose one of {', '.join(structures())}")
    return structures()[str(name)]


@checked
def load_controller(path: str | Path, *, initial_speed: float | None = None) -> Any:
    """Read a controller from a TOML or Python file.

    - path: TOML file as described in this module, or a Python file. A Python file is run; use only files that you
      trust.
    - initial_speed: initial speed v0 of the run, m/s; needed if the file sets an adhesion law that depends on v0.

    Returns a `Controller`; for a Python file its object `CONTROLLER`, which may also be a controller class, a linear
    system, an object with a method `step`, or a function. InputError: a file with an invalid key or value, or a Python
    file that fails.
    """
    path = given_path(path)
    where = file_name(path)
    if path.suffix.lower() == ".py":
        return _from_python(path)
    content = read_toml(path)
    kind = _kind_of(content, path, where)
    keys = {name: value for name, value in content.items() if name not in ("kind", "python")}
    if not keys.get("name"):
        keys["name"] = kind.kind
    try:
        return kind.from_keys(keys, path, initial_speed)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None


def _kind_of(content: dict[str, Any], path: Path, where: str) -> type[Controller]:
    kind, kinds = content.get("kind"), controller_kinds()
    if isinstance(python := content.get("python"), str):
        given = _from_python(path.parent / python)
        own: Any = given if inspect.isclass(given) else type(given)
        if not is_kind(own) or own.kind != kind:
            remedy = f"give kind = {own.kind!r}" if is_kind(own) else "assign a controller class to CONTROLLER"
            raise InputError(
                f"{where}: kind: {shown(kind)} is not the kind of the variable CONTROLLER in {python}; {remedy}"
            )
        return own
    if not isinstance(kind, str) or kind not in kinds:
        fault = "is missing" if kind is None else f"{shown(kind)} is not known"
        near = close_match(kind, kinds) if isinstance(kind, str) else ""
        raise InputError(f"{where}: kind: {fault}; {near}choose one of {', '.join(kinds)}")
    return kinds[kind]


def _from_python(path: Path) -> Any:
    controller = record_in(path, "CONTROLLER", ())
    is_class = inspect.isclass(controller)
    kind: Any = controller if is_class else type(controller)
    if issubclass(kind, Controller):
        _check_kind(kind, f"{file_name(path)}: CONTROLLER")
    if isinstance(controller, Controller) or is_kind(controller) or (has_step(controller) and not is_class):
        return controller
    if is_class or not callable(linear_of(controller)):
        try:
            linear_controller(controller)
        except InputError as error:
            message = str(error).removeprefix("controller: ")
            raise InputError(f"{file_name(path)}: CONTROLLER: {message}") from None
    return controller


def as_control(
    controller: Any, vehicle: Vehicle, reference: ReferenceSlip | None, name: str | None = None
) -> Controller:
    """Convert any object that can serve as a controller to a `Controller` for a vehicle.

    - controller: a `Controller`, a design with an attribute `controller`, a controller class, a linear system, a
      function, or an object with a method `step`. Tustin's rule samples a linear system every 10 ms or at its own
      period, and its torque is limited to the range from 0 to the full brake. A function or a method `step` is
      called every 10 ms, or at the period in the attribute `period`, s.
    - vehicle: vehicle whose parameters the controller assumes if it does not set them itself.
    - reference, name: reference slip ratio and name, used if the controller has none.

    InputError for any other object, or if a controller that tracks a reference slip is given no reference slip.
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
    own_reference, label = getattr(controller, "reference", None), own_name(controller) or name
    if has_step(controller) and not inspect.isclass(controller):
        period = {} if getattr(controller, "period", None) is None else {"period": controller.period}
        label = label or getattr(controller, "__name__", None) or type(controller).__name__
        fields = {"thing": controller, "reference": own_reference, "name": str(label), **period}
        return validated(StepControl, fields, f"controller {label}")
    if not is_system(controller) and callable(linear_of(controller)) and not inspect.isclass(controller):
        raise InputError(
            f"controller: {type(controller).__name__} has only linear(operating_point), which cannot run; add "
            "step(t, v, omega)"
        )
    design, slips = linear_controller(controller), own_reference or reference
    if slips is None:
        raise _no_reference()
    label = label or design.structure.removesuffix(" N*m/(m/s)").lower().replace(" ", "-")
    limits = {"torque_min": 0.0, "torque_max": full_brake_torque(vehicle)}
    return linear_control(design, reference=slips, name=label, **limits).believing(vehicle)


def _no_reference() -> InputError:
    return InputError("controller: neither the controller nor the adhesion law has a reference slip; set `reference`")


def own_name(controller: Any) -> str | None:
    """Return the name that the user gave a controller; None for python-control's default names, such as sys[3]."""
    name = getattr(controller, "name", None)
    return None if not name or "[" in str(name) else str(name)
