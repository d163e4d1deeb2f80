"""What the Python interface refuses: one line with the quantity, its value and what to give, and no other error."""

import importlib
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from fractions import Fraction
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike
from project import changed

import railslip_ctrl
from railslip_ctrl import (
    Campaign,
    DeadTimeLoop,
    PIController,
    RailslipError,
    built_in_scenario,
    linearize,
    operating_point,
)
from railslip_ctrl.core.arguments import checked, complexes, number, numbers
from railslip_ctrl.design.catalogue import published_controller
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.identification.curves import Options
from railslip_ctrl.loop import Rational
from railslip_ctrl.model import vehicle
from railslip_ctrl.model.adhesion import law_class, published_law
from railslip_ctrl.model.vehicle import PARK2008, Actuator, PIGains, Rail, Vehicle, Wheel

LAW = published_law("bristle", Rail.DRY)
POINT = operating_point(LAW, PARK2008, 27.0, 0.13)
PLANT = linearize(POINT)
PI = PIController(PIGains(kp=1200.0, ki=1200.0))
LAG = Rational(np.array([]), np.array([-1.0]), 1.0)
LOOP = DeadTimeLoop(LAG, 0.1)
REGION = railslip_ctrl.stabilizing_pi(LAG, 0.1)
VEHICLE = PARK2008.model_dump()


class Thing:
    def __repr__(self) -> str:
        return "<a thing>"


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(RailslipError) as caught:
        call()
    text = str(caught.value)
    assert text.isprintable()  # so also one line
    assert isinstance(caught.value, ValueError)
    return text


RECORDS: list[tuple[Callable[[], object], str]] = [
    (lambda: Wheel(radius=-1.0, inertia=60.0), "Wheel: radius: -1 is not allowed; give a value > 0 (m)"),
    (lambda: Actuator(dead_time=0.1), "Actuator: lag: missing; give it (s): time constant of the first-order lag"),
    (lambda: Actuator(dead_time=0.1, lag=0.6, delay=0.1), "Actuator: delay: unknown key; allowed: dead_time, lag"),
    (lambda: PIGains(kp=True, ki=1.0), "PIGains: kp: True is not a number in N*m/(m/s)"),
    (lambda: law_class("table")(slip=(0.1, 0.2), mu=(0.1, "0.2")), "LookupTable: mu: '0.2' is text; give the number"),
    (lambda: Vehicle(**VEHICLE | {"wheel": {"radius": -1.0, "inertia": 60.0}}), "Vehicle: wheel.radius: -1 is not a"),
    (lambda: Vehicle(**VEHICLE | {"mass_loaded": 3e3}), "Vehicle: mass_loaded: 3000 is not allowed; give a value >= m"),
    (lambda: setattr(PARK2008, "mass", 1.0), "Vehicle: mass cannot be set; "),
    (lambda: PARK2008.model_copy(update={"mas": 4000.0}), "Vehicle: mas: unknown key; did you mean 'mass'? allowed: "),
    (lambda: changed(published_controller("pi"), name=2), "PI: name: 2 is not allowed; give text"),
    (lambda: Rail.of(Thing()), "rail: <a thing> is not a rail condition; choose dry or wet"),
]


@pytest.mark.parametrize(("make", "line"), RECORDS)
def test_a_record_refuses_in_one_line_of_the_package(make: Callable[[], object], line: str) -> None:
    assert refusal(make).startswith(line)


ROOMS = ("model.adhesion", "design", "loop", "simulation")

VALID: dict[str, object] = {
    "actuator": PARK2008.actuator, "adhesion": "curve", "controller": PI, "dead_time": 0.1, "found": None,
    "controllers": {"pi": published_controller("pi")}, "options": Options(), "law": LAW, "loop": LOOP,
    "envelope": Envelope(laws="bristle", rails="dry", speeds=60), "name": "bristle", "omega": 1.0,
    "path": "law.toml", "plant": PLANT, "plants": [PLANT], "point": POINT, "rail": Rail.DRY, "reference_slip": 0.1,
    "region": REGION, "regions": [REGION], "seeds": [0], "source": "stop", "slip": 0.1, "speed": 27.0,
    "scenario": built_in_scenario("park2008"), "speed_kmh": 100.0, "vehicle": PARK2008, "kp": [1.0], "ki": [1.0],
    "derivative_filter": 0.1, "system": PI, "event": "lock",
    "campaign": Campaign(built_in_scenario("park2008"), (published_controller("pi"),), 1),
}  # fmt: skip
"""What the arguments without a default may be, by name; and of a function of its own where it means another thing."""

OWN: dict[str, dict[str, object]] = {
    "campaign": {"controllers": [PI]},
    "fundamental_limits": {"plant": LAG},
    "plant_at": {"law": "bristle"},
    "save_c": {"controller": published_controller("pi"), "path": "law.c"},
    "simulate": {"controller": published_controller("pi")},
    "stabilizing_pi": {"plant": LAG},
    "stabilizing_pid": {"plant": LAG, "derivative_time": 0.1},
    "tune_pi": {"plants": LAG},
}


def functions() -> dict[str, Callable[..., object]]:
    """What takes arguments, at the top and in the rooms."""
    modules = [railslip_ctrl, *(importlib.import_module(f"railslip_ctrl.{room}") for room in ROOMS)]
    found = {name: getattr(module, name) for module in modules for name in module.__all__}
    found |= {one.__name__: one for one in (vehicle.vehicle_warnings, vehicle.notes_and_warnings, vehicle.table4_gains)}
    return {name: thing for name, thing in found.items() if inspect.isfunction(thing)}


@pytest.mark.parametrize("name", functions())
def test_no_function_takes_what_is_of_no_kind(name: str) -> None:
    function = functions()[name]
    taken = [one for one in inspect.signature(function).parameters.values() if one.kind is not one.VAR_KEYWORD]
    given = {one.name: VALID[one.name] for one in taken if one.default is one.empty} | OWN.get(name, {})
    for argument in taken:
        told = refusal(lambda: function(**{**given, argument.name: Thing()}))  # noqa: B023
        assert "thing" in told.lower(), argument.name


class Side(StrEnum):
    LEFT = "left"
    RIGHT = "right"


@checked
def taker(
    real: float = 0.0,
    whole: int = 0,
    flag: bool = False,
    text: str = "",
    side: Side = Side.LEFT,
    mode: Literal["fast", "slow"] = "fast",
    pair: tuple[float, int] = (0.0, 0),
    several: Sequence[float] = (),
    array: ArrayLike = 0.0,
    table: Mapping[str, float] | None = None,
    function: Callable[[float], float] = math.sin,
    anything: Any = None,
) -> tuple[object, ...]:
    return real, whole, flag, text, side, mode, pair, several, array, table, function, anything


KINDS: dict[str, tuple[tuple[object, ...], tuple[object, ...]]] = {
    "real": (
        (1, 1.5, np.float64(2.0), np.float32(1.0), np.int64(3), Fraction(1, 3), math.inf),
        ("1", None, True, np.True_, 1j, [1.0], Thing()),
    ),
    "whole": ((1, np.int64(2)), (1.0, True, "1", None)),
    "flag": ((True, np.True_), (1, 0, None, "yes")),
    "text": (("a", Side.LEFT), (1, None, b"a")),
    "side": ((Side.RIGHT, "left"), ("up", None, 1, [])),
    "mode": (("slow",), ("FAST", None, 1)),
    "pair": (((1, 2), [1.5, 2]), ((1, 2, 3), (1, 2.5), 1, "ab")),
    "several": (([], [1, 2.0], (1,), np.array([1.0])), (1.0, "12", [1, "a"], np.ones((1, 1)), {1, 2})),
    "array": ((1, [1, 2], [[1.0]], np.ones((2, 2)), 1j, []), ("1", None, [1, None], [1, [2, 3]], True, Thing())),
    "table": ((None, {"a": 1}), ([], 1)),
    "function": ((math.cos, int), (1, "sin")),
    "anything": ((None, 1, Thing()), ()),
}
"""Values that an argument of `taker` takes, and those that it refuses."""


@pytest.mark.parametrize("name", KINDS)
def test_a_value_is_taken_if_of_its_kind(name: str) -> None:
    taken, refused = KINDS[name]
    for value in taken:
        assert taker(**{name: value})
    for value in refused:
        assert refusal(lambda: taker(**{name: value})).startswith(f"{name}: ")  # noqa: B023


def test_a_number_out_of_its_bounds_is_refused_alone_and_in_an_array() -> None:
    for bounds, value, wanted in (
        ({"gt": 0}, 0, " > 0"),
        ({"ge": 0, "lt": 1}, 1.0, " >= 0 and < 1"),
        ({"le": 5}, 6, " <= 5"),
        ({}, -math.inf, ""),
    ):
        line = f"x: {value:g} m is not allowed; give a finite value{wanted}"
        assert refusal(lambda: number("x", value, "m", **bounds)) == line  # noqa: B023
    assert number("x", 0.5, "m", gt=0, ge=0.5, lt=1, le=0.5) == 0.5
    for bounds in ({"gt": 0}, {"ge": 1}):
        assert refusal(lambda: numbers("x", [2, 0], "m", **bounds)).startswith("x: 0 m is not allowed")  # noqa: B023
    assert (numbers("x", [[1, 0]], ge=0).shape, complexes("x", 1j).shape) == ((1, 2), ())
    for call in (lambda: number("x", 10**400), lambda: numbers("x", [10**400])):
        assert "308 digits" in refusal(call)
    told = "x: [1, 1j] is not allowed; give a number or an array of numbers, not complex"
    assert refusal(lambda: numbers("x", [1, 1j])) == told
