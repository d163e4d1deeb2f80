"""What is allowed of a vehicle and yet far from what vehicles have: nearly always a number in another unit.

Nothing is refused for it. A range is wide enough for trams, railcars, locomotives and wagons, empty and loaded: what is
outside is a factor of ten or a thousand off, or the whole vehicle in place of the part that one wheelset carries.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.units import KMH

from .records import GRAVITY, Vehicle

_SPEED = 100.0 * KMH  # at which travelling resistance is looked at


@dataclass(frozen=True)
class UsualRange:
    """Between which bounds a quantity of vehicles lies.

    Attributes
    ----------
    key : str
        Of the vehicle's file.
    unit : str
        Of the quantity.
    low, high : float
        The bounds, as multiples of `of`.
    why : str
        Where they come from, in words.
    value : callable
        Of a vehicle, the quantity in `unit`.
    of : callable
        Of a vehicle, what the bounds are multiples of, in `unit`; left out, 1.
    other_units : mapping
        Units that a number may have been meant in, each with its size in `unit`.
    after : tuple of str
        Keys that `of`, or the quantity itself if left out, is computed from: nothing new is said of what follows from
        an implausible number.
    remedy : str
        Where none of `other_units` gives a usual value.
    """

    key: str
    unit: str
    low: float
    high: float
    why: str
    value: Callable[[Vehicle], float]
    of: Callable[[Vehicle], float] = lambda _: 1.0
    other_units: Mapping[str, float] = field(default_factory=dict)
    after: tuple[str, ...] = ()
    remedy: str = "check the number and its unit"


def _resistance(vehicle: Vehicle) -> float:
    terms = vehicle.resistance
    return terms.constant + terms.linear * _SPEED + terms.quadratic * _SPEED * _SPEED


_QUARTER = "the quarter car is what one wheelset carries: 3 to 6 t of a tram, 22.5 t on main lines, 40 t of heavy haul"
_ONE_WHEELSET = "divide the mass of a whole vehicle by the number of its axles, and give the unit"
_CARRIES = "a wheelset carries the weight of the quarter car, in braking somewhat more or less"

USUAL_RANGES = (
    UsualRange(
        "mass", "kg", 1000.0, 45_000.0, _QUARTER, lambda v: v.mass, other_units={"t": 1000.0}, remedy=_ONE_WHEELSET,
    ),
    UsualRange(
        "mass_loaded", "kg", 1000.0, 45_000.0, _QUARTER, lambda v: v.mass_loaded, other_units={"t": 1000.0},
        after=("mass",), remedy=_ONE_WHEELSET,
    ),
    UsualRange(
        "wheel_load", "N", 0.5, 1.5, _CARRIES, lambda v: v.wheel_load, lambda v: v.mass * GRAVITY, {"kN": 1000.0},
        ("mass",),
    ),
    UsualRange(
        "wheel_load_loaded", "N", 0.5, 1.5, _CARRIES, lambda v: v.wheel_load_loaded,
        lambda v: v.mass_loaded * GRAVITY, {"kN": 1000.0}, ("mass", "mass_loaded", "wheel_load"),
    ),
    UsualRange(
        "radius", "m", 0.15, 0.75, "half the diameter: 0.36 m on rolling-road wagons, 1.25 m on locomotives",
        lambda v: v.wheel.radius, other_units={"mm": 1e-3, "cm": 1e-2},
    ),
    UsualRange(
        # rotation_mass - 1 of the railtoolkit schema, 0.02 of a loaded wagon to 0.3 of a motored axle, with room
        "inertia", "kg*m^2", 0.005, 0.5, "what turns adds 2 % to 30 % to the mass, as J/r^2",
        lambda v: v.wheel.inertia, lambda v: v.mass * v.wheel.radius**2, after=("mass", "radius"),
    ),
    UsualRange(
        "viscous_friction", "N*m*s", 0.0, 0.01, "at 100 km/h drag takes less than a hundredth of the weight",
        lambda v: v.wheel.viscous_friction, lambda v: v.wheel_load * v.wheel.radius**2 / _SPEED,
        after=("mass", "wheel_load", "radius"),
    ),
    UsualRange(
        "resistance", "N at 100 km/h", 0.0, 0.05, "on the level trains roll with 0.2 % to 2 % of their weight",
        _resistance, lambda v: v.wheel_load, after=("mass", "wheel_load"),
    ),
    UsualRange(
        "dead_time", "s", 0.0, 2.0, "pneumatic brakes begin to act within a second, electric ones at once",
        lambda v: v.actuator.dead_time, other_units={"ms": 1e-3},
    ),
    UsualRange(
        "lag", "s", 0.0, 10.0, "brake cylinders fill in 3 to 5 s, of goods trains in 18 to 30 s, about three lags",
        lambda v: v.actuator.lag, other_units={"ms": 1e-3},
    ),
)  # fmt: skip
"""The ranges, those that others are computed from first."""


@checked
def doubts(vehicle: Vehicle) -> tuple[str, ...]:
    """Return a sentence for each number of a vehicle that is far from what vehicles have.

    Parameters
    ----------
    vehicle : Vehicle
        SI; its own M, J and B are looked at, not those times `inertia_scale`.

    Returns
    -------
    tuple of str
        Each names the key, the value, the usual range with its reason, and the remedy; empty for a plausible vehicle.

    Raises
    ------
    InputError
        What is given is no vehicle.
    """
    found: dict[str, str] = {}
    for usual in USUAL_RANGES:
        value, scale = usual.value(vehicle), usual.of(vehicle)
        low, high = usual.low * scale, usual.high * scale
        if not low <= value <= high and not found.keys() & set(usual.after):
            found[usual.key] = (
                f"{usual.key} = {_plain(value, 6)} {usual.unit} is taken as given, but is outside the usual "
                f"{_plain(low)} to {_plain(high)} {usual.unit} ({usual.why}); {_remedy(usual, value, low, high)}."
            )
    return tuple(found.values())


@checked
def remarks(vehicle: Vehicle) -> tuple[str, ...]:
    """Return all that a reader of a vehicle's numbers is told: what was assumed (`Vehicle.notes`), then `doubts`.

    Parameters
    ----------
    vehicle : Vehicle
        SI.

    Returns
    -------
    tuple of str
        A sentence each.

    Raises
    ------
    InputError
        What is given is no vehicle.
    """
    return (*vehicle.notes, *doubts(vehicle))


def _remedy(usual: UsualRange, value: float, low: float, high: float) -> str:
    for unit, size in usual.other_units.items():
        if low <= value * size <= high:
            return f'if {_plain(value, 6)} {unit} is meant, give "{_plain(value, 6)} {unit}"'
    return usual.remedy


def _plain(value: float, digits: int = 3) -> str:
    """A number of so many significant digits, below a million without a power of ten."""
    return f"{float(f'{value:.{digits}g}'):g}"
