"""Controllers' files: TOML, read and written, and Python files, which are run and assign to `CONTROLLER`.

kind = "pi"                       # one of `KINDS`
kp = "336 N*m/(km/h)"             # the keys of its kind, see the classes below; plain numbers are SI
ki = 1220.0
lead = "0.6 s"
lead_filter = 0.06
torque_min = 0.0
torque_max = "9 kN*m"
tracking_time = 2.0
cut_out_speed = "20 km/h"         # below it slip is not controlled and cut_out_torque commanded; left out: never
cut_out_torque = 1862.0

[reference]                       # slip ratio to be held; left out: 0.132 dry, 0.092 wet,
                                  # none if the kind holds none
dry = 0.132
wet = 0.092

A "transfer-function" has num and den, a "state-space" A, B, C and D, from slip error (m/s) to torque (N*m), and a
period of 10 ms and Tustin's rule unless said. Unless said the others are sampled at every step, and by the backward
difference, as they were before files had a rule; what is saved says both.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
from abc import abstractmethod
from pathlib import Path
from typing import Any, ClassVar

from pydantic import model_validator

from railslip_ctrl.core import user_files
from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, quantity, shown
from railslip_ctrl.design import controllers
from railslip_ctrl.design.schedule import GainSchedule
from railslip_ctrl.design.seeking import SeekingGains
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, load_law
from railslip_ctrl.model.vehicle import PIGains, Record
from railslip_ctrl.sliding.law import LawGains

from .catalogue import FILTER_TIME, published_reference
from .controllers import Controller, LinearControl, ScheduledControl, SlideProtection, SlidingControl, TorqueProfile
from .scenario import LEAST_STEP
from .seeking import SeekingControl


class ControllerKeys(Record):
    """Keys of every kind."""

    kind: str
    name: str | None = None
    period: float | None = quantity("s", "sampling period; every step if left out", ge=LEAST_STEP, default=None)
    reference: ReferenceSlip | None = None

    makes: ClassVar[type]

    def of(self, record: type) -> dict[str, Any]:
        """The keys that are fields of a record."""
        names = {field.name for field in dataclasses.fields(record)} & type(self).model_fields.keys()
        return {name: getattr(self, name) for name in names}

    def fields(self) -> dict[str, Any]:
        """What the controller's record takes of the keys."""
        return {**self.of(self.makes), "name": self.name or self.kind}

    def made(self, path: Path, initial_speed: float | None) -> Controller:
        """The controller; `path` is that of the file, `initial_speed` as of `load_controller`."""
        return self.makes(**self.fields())  # type: ignore[no-any-return]


class Limited(ControllerKeys):
    """Keys of the kinds that hold a reference slip, with torque limits of their own."""

    reference: ReferenceSlip = published_reference("bristle")
    torque_min: float | None = quantity("N*m", "least torque; left out: none", default=None)
    torque_max: float | None = quantity("N*m", "largest torque; left out: none", default=None)

    def fields(self) -> dict[str, Any]:
        low = -math.inf if self.torque_min is None else self.torque_min
        high = math.inf if self.torque_max is None else self.torque_max
        if not low < high:
            raise InputError(f"torque_max: {high:g} is not allowed; give a value > torque_min = {low:g} (N*m)")
        return {**super().fields(), "torque_low": low, "torque_high": high}


class LinearKeys(Limited):
    """Keys of the linear kinds: anti-windup by back-calculation unless switched off."""

    anti_windup: bool = True
    tracking_time: float | None = quantity("s", "of the anti-windup; left out: the slowest zero's", gt=0, default=None)
    initial_torque: float = quantity("N*m", "torque at the start", default=0.0)
    cut_out_speed: float = quantity("m/s", "train speed below which slip is not controlled", ge=0, default=0.0)
    cut_out_torque: float = quantity("N*m", "torque commanded there", default=0.0)
    rule: controllers.Rule = controllers.Rule.BACKWARD
    makes = LinearControl

    @abstractmethod
    def design(self) -> controllers.LinearController:
        """The design of these keys."""

    def fields(self) -> dict[str, Any]:
        tracking = self.tracking_time if self.anti_windup else math.inf
        return {**super().fields(), "design": self.design(), "tracking_time": tracking}


class PIKeys(LinearKeys):
    """`kind = "pi"`: gains, and a lead where it is given."""

    kp: float = quantity("N*m/(m/s)", "proportional gain")
    ki: float = quantity("N*m/m", "integral gain")
    lead: float = quantity("s", "time constant of a lead", ge=0, default=0.0)
    lead_filter: float = quantity("s", "its filter", ge=0, default=0.0)

    def design(self) -> controllers.PIController:
        return controllers.PIController(PIGains(kp=self.kp, ki=self.ki), self.lead, self.lead_filter)


class PILeadKeys(PIKeys):
    """`kind = "pi-lead"`: with the lead."""

    lead: float = quantity("s", "time constant of the lead", gt=0)
    lead_filter: float = quantity("s", "its filter", gt=0)


class SystemKeys(LinearKeys):
    """Keys of systems: continuous, or `discrete` with the period."""

    period: float | None = quantity("s", "sampling period", ge=LEAST_STEP, default=controllers.PERIOD)
    rule: controllers.Rule = controllers.Rule.TUSTIN
    discrete: bool = False

    @property
    def own_period(self) -> float | None:
        return self.period if self.discrete else None


class TransferFunctionKeys(SystemKeys):
    """`kind = "transfer-function"`: coefficients of descending powers of s (of z), N*m/(m/s)."""

    num: tuple[float, ...] = quantity("1", "numerator")
    den: tuple[float, ...] = quantity("1", "denominator")

    def design(self) -> controllers.PolynomialController:
        for name, given in (("num", self.num), ("den", self.den)):
            if not given:
                raise InputError(f"{name}: is empty; give at least one coefficient")
        return controllers.PolynomialController(self.num, self.den, self.own_period)


class StateSpaceKeys(SystemKeys):
    """`kind = "state-space"`: x' = A x + B e, torque = C x + D e, SI; lists, A by rows, B and C flat or as matrices."""

    A: tuple[tuple[float, ...], ...] = quantity("1", "by rows")
    B: tuple[float, ...] = quantity("1", "of the error")
    C: tuple[float, ...] = quantity("1", "of the torque")
    D: float = quantity("1", "from error to torque", default=0.0)

    @model_validator(mode="before")
    @classmethod
    def _as_matrices(cls, content: dict[str, Any]) -> dict[str, Any]:
        """As other tools write them too: keys in lower case, B a column, C and D in rows, numbers without brackets."""
        found = {key.upper() if key in ("a", "b", "c", "d") else key: value for key, value in content.items()}
        if len(found) < len(content):
            raise InputError("A, B, C, D: one is given in both cases; give it once")
        if isinstance(found.get("A"), int | float):
            found["A"] = [[found["A"]]]
        if "B" in found:
            found["B"] = [_only(row) for row in _listed(found["B"])]
        if "C" in found:
            found["C"] = _listed(_only(found["C"]))
        if "D" in found:
            found["D"] = _only(_only(found["D"]))
        if any(not isinstance(row, list | tuple) for row in _listed(found.get("A", []))):
            raise InputError("A: give its rows, [[...], ...]")
        lengths = sorted({len(row) for row in found.get("A", [])})
        if len(lengths) > 1:
            raise InputError(f"A: has rows of {lengths[0]} and of {lengths[-1]} numbers; give n rows of n")
        for key, shape in (("B", "n numbers or n rows of one"), ("C", "n numbers or one row of n")):
            if any(isinstance(entry, list) for entry in found.get(key, ())):
                raise InputError(f"{key}: is not of one input and one output; give {shape}")
        return found

    def design(self) -> controllers.StateSpaceController:
        return controllers.StateSpaceController(self.A, self.B, self.C, self.D, self.own_period)


def _listed(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _only(value: Any) -> Any:
    """The entry of a list of one; else the value."""
    return value[0] if isinstance(value, list | tuple) and len(value) == 1 else value


class SlidingKeys(Limited):
    """`kind = "asmc"`: gains of `LawGains`, nominal vehicle, and the adhesion model, the plant's if left out.

    A model over the initial speed v0 (`adhesion.load_law`) is taken at that of the run.
    """

    K: float = quantity("N*m", "gain on sgn s", ge=0)
    D: float = quantity("N*m/(m/s)", "gain on s", gt=0)
    rho: float = quantity("1/s", "weight of the integral in s", gt=0)
    k1: float = quantity("s^2/(kg^2*m^4)", "adaptation gain of theta1_hat", ge=0, default=0.0)
    k2: float = quantity("1", "adaptation gain of theta2_hat", ge=0, default=0.0)
    layer: float = quantity("m/s", "boundary layer", ge=0, default=0.0)
    leak: float = quantity("1/s", "sigma-modification", ge=0, default=0.0)
    dead_zone: bool = False
    nominal_mass: float | None = quantity("kg", "Mn; left out: the vehicle's", gt=0, default=None)
    nominal_viscous_friction: float | None = quantity("N*m*s", "Bn; left out: the vehicle's", ge=0, default=None)
    filter_time: float = quantity("s", "of the filter that estimates v'", gt=0, default=FILTER_TIME)
    anti_windup: bool = False
    knows_rail: bool = True
    adhesion: str | None = None
    makes = SlidingControl

    def made(self, path: Path, initial_speed: float | None) -> Controller:
        law = None if self.adhesion is None else _model(path.parent / self.adhesion, initial_speed)
        return SlidingControl(LawGains(**self.of(LawGains)), model_law=law, **self.fields())


class ScheduledKeys(Limited):
    """`kind = "scheduled"`: a file written by `GainSchedule.to_json`."""

    schedule: str
    tracking_time: float | None = quantity("s", "of the anti-windup; left out: kp/ki", gt=0, default=None)
    initial_torque: float = quantity("N*m", "the integral's start", default=0.0)
    rule: controllers.Rule = controllers.Rule.BACKWARD
    makes = ScheduledControl

    def made(self, path: Path, initial_speed: float | None) -> Controller:
        schedule = GainSchedule.from_json(user_files.read_text(path.parent / self.schedule))
        return ScheduledControl(**{**self.fields(), "schedule": schedule})


class SlideProtectionKeys(ControllerKeys):
    """`kind = "slide-protection"`: thresholds and rates, those of `SlideProtection` if left out."""

    fill_slip: float = quantity("1", "slip to fill below", gt=0, lt=1, default=SlideProtection.fill_slip)
    dump_slip: float = quantity("1", "slip to dump above", gt=0, lt=1, default=SlideProtection.dump_slip)
    dump_deceleration: float = quantity(
        "m/s^2", "wheel deceleration to dump above", gt=0, default=SlideProtection.dump_deceleration
    )
    fill_rate: float = quantity("N*m/s", "rate of filling", gt=0, default=SlideProtection.fill_rate)
    dump_rate: float = quantity("N*m/s", "rate of dumping", gt=0, default=SlideProtection.dump_rate)
    torque_max: float = quantity("N*m", "full brake", gt=0, default=SlideProtection.torque_high)
    filter_time: float = quantity("s", "filter of the deceleration", gt=0, default=SlideProtection.filter_time)
    period: float | None = quantity("s", "sampling period", ge=LEAST_STEP, default=SlideProtection.period)
    makes = SlideProtection

    def fields(self) -> dict[str, Any]:
        return {**super().fields(), "torque_high": self.torque_max}


class SeekingKeys(ControllerKeys):
    """`kind = "seeking"`: the fields of `SeekingGains`; those with a default may be left out."""

    gains: SeekingGains
    period: float = quantity("s", "sampling period", ge=LEAST_STEP, default=controllers.PERIOD)
    makes = SeekingControl


class TorqueProfileKeys(ControllerKeys):
    """`kind = "torque-profile"`: times, s, and torques, N*m, as lists of numbers, or of texts with units."""

    times: tuple[float, ...] = quantity("s", "times, rising")
    torques: tuple[float, ...] = quantity("N*m", "torques at them")
    makes = TorqueProfile


KINDS: dict[str, type[ControllerKeys]] = {
    "pi": PIKeys,
    "pi-lead": PILeadKeys,
    "transfer-function": TransferFunctionKeys,
    "state-space": StateSpaceKeys,
    "asmc": SlidingKeys,
    "scheduled": ScheduledKeys,
    "slide-protection": SlideProtectionKeys,
    "seeking": SeekingKeys,
    "torque-profile": TorqueProfileKeys,
}


_OLD = {"torque_low": "torque_min", "torque_high": "torque_max"}  # keys of files written earlier


@checked
def load_controller(path: str | Path, *, initial_speed: float | None = None) -> Any:
    """Read a controller.

    - path: the TOML file; the module says what is in it. A Python file is run as a script is: give only those you
      trust.
    - initial_speed: v0 of the run, m/s, at which a model of its own is taken that has polynomials of v0; not needed
      without.

    Returns what a run takes (SI); of a Python file its `CONTROLLER`: a linear system, a step object or a function.
    InputError: one line naming the file, the key, the value and what is allowed; of a Python file that fails, its line.
    """
    path = user_files.given_path(path)
    where = user_files.file_name(path)
    if path.suffix.lower() == ".py":
        return _python_controller(path)
    content = user_files.read_toml(path)
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        given = "missing" if kind is None else f"{shown(kind)} is not one"
        near = user_files.close_match(kind, KINDS) if isinstance(kind, str) else ""
        raise InputError(f"{where}: kind: {given}; {near}choose one of {', '.join(KINDS)}")
    for old, key in _OLD.items():
        if old in content and key in content:
            raise InputError(f"{where}: {old}: {key} is given too; give {key} alone")
        if old in content and key in KINDS[kind].model_fields:
            content[key] = content.pop(old)
    keys = user_files.validated(KINDS[kind], content, where)
    try:
        return keys.made(path, initial_speed)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _python_controller(path: Path) -> Any:
    """What a Python file calls `CONTROLLER`; InputError, which names the file, for what is no controller."""
    found = user_files.record_in(path, "CONTROLLER", ())
    if inspect.isclass(found) or not (
        controllers.has_step(found)
        or callable(controllers.linear_of(found))
        or (not controllers.is_system(found) and isinstance(found, Controller))
    ):
        try:
            controllers.linear_controller(found)
        except InputError as error:
            told = str(error).removeprefix("controller: ")
            raise InputError(f"{user_files.file_name(path)}: CONTROLLER: {told}") from None
    return found


def _model(path: Path, initial_speed: float | None) -> AdhesionLaw:
    if path.suffix.lower() != ".toml":
        raise InputError(f"adhesion: {path.name!r} is not a TOML file; give one with a law and its parameters")
    return load_law(path, initial_speed_kmh=None if initial_speed is None else initial_speed / KMH)


def control_text(control: LinearControl | SeekingControl) -> str:
    """A linear or seeking controller as the text of its file, every number of it.

    InputError for a system of no period, which no file has.
    """
    if isinstance(control, SeekingControl):
        kind, told = "seeking", _lines(SeekingKeys, {"period": control.period})
        told += ["", "[gains]", *_lines(SeekingGains, control.gains.model_dump())]
    else:
        kind, told = _linear_lines(control)
    held, slips = list[str](), control.reference
    if slips is not None:
        held = ["", "[reference]", f"dry = {slips.dry!r}", f"wet = {slips.wet!r}"]
    return "\n".join([f"kind = {json.dumps(kind)}", f"name = {json.dumps(control.name)}", *told, *held]) + "\n"


def _linear_lines(control: LinearControl) -> tuple[str, list[str]]:
    """Kind and lines of a linear controller."""
    if control.period is None and not isinstance(control.design, controllers.PIController):
        raise InputError("period: a file of a transfer function or state space needs one; give it (s)")
    kind, own = _design_keys(control.design)
    content = {
        **own,
        "period": control.period,
        "torque_min": control.torque_low,
        "torque_max": control.torque_high,
        "anti_windup": control.tracking_time is None or math.isfinite(control.tracking_time),
        "tracking_time": control.tracking_time,
        "initial_torque": control.initial_torque,
        "cut_out_speed": control.cut_out_speed,
        "cut_out_torque": control.cut_out_torque,
        "rule": control.rule.value,
    }
    return kind, _lines(KINDS[kind], content)


def _lines(record: type[Record], content: dict[str, Any]) -> list[str]:
    """Keys of a record with their values and units."""
    lines = []
    for key, value in content.items():
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            continue  # left out: none
        extra: Any = record.model_fields[key].json_schema_extra or {}
        unit = extra.get("unit", "1")
        lines.append(f"{key} = {_toml(value)}" + (f"  # {unit}" if unit != "1" else ""))
    return lines


def _design_keys(design: controllers.LinearController) -> tuple[str, dict[str, Any]]:
    """Kind and keys of a design."""
    if isinstance(design, controllers.PIController):
        lead = {"lead": design.lead, "lead_filter": design.lead_filter} if design.structure != "PI" else {}
        return "pi-lead" if design.lead > 0 else "pi", {"kp": design.gains.kp, "ki": design.gains.ki, **lead}
    discrete = {} if design.period is None else {"discrete": True}
    if isinstance(design, controllers.PolynomialController):
        return "transfer-function", {"num": design.num, "den": design.den, **discrete}
    return "state-space", {"A": design.a, "B": design.b, "C": design.c, "D": design.d, **discrete}


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(float(value)) if isinstance(value, float) else json.dumps(value)
