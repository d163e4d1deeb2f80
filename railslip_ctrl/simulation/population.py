"""Random stops, to test controllers on vehicles and rails for which they were not tuned; each seed gives one stop.

A stop can be simulated without errors, or with errors of sensors, brake and assumed parameters; vehicle and rail are
the same in both cases.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from railslip_ctrl.controllers.base import PERIOD
from railslip_ctrl.controllers.linear import full_brake_torque
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, law_class
from railslip_ctrl.model.adhesion.polach import Polach
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import PARK2008, Actuator, Rail, Vehicle

from .scenario import Beliefs, BrakeLimits, Event, Measurement, Scenario, stop

CHECK = 9000  #: seeds below this number are for development, the others only for checks

SPEED_SCALE, RADIUS, GAIN, BRAKE = 0.02, 0.02, 0.15, 0.3
"""Largest relative errors of measured train speed, assumed radius, torque gain, and assumed dead time and lag."""

SPEED_NOISE = 0.05  #: standard deviation of the noise of each sample of the train speed, m/s
TEETH = (80, 200)  #: smallest and largest number of teeth of the wheel-speed encoder
PITCH_ERROR = 0.01  #: standard deviation of the position error of an encoder edge, in tooth pitches


@dataclass(frozen=True)
class Peak:
    """Peak of an adhesion curve: slip ratio and adhesion coefficient."""

    slip: float
    mu: float


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def random_vehicle(rng: np.random.Generator) -> Vehicle:
    """Return a random vehicle.

    Its wheel load is 30 to 120 kN, the wheel radius 0.36 to 0.46 m, the wheel inertia 40 to 150 kg m^2, the dead time
    of the brake 0.06 to 0.3 s, and its lag 0.15 to 0.8 s.
    """
    load = _log_uniform(rng, 30e3, 120e3)
    wheel = {"radius": rng.uniform(0.36, 0.46), "inertia": rng.uniform(40.0, 150.0)}
    dead_time = _log_uniform(rng, 0.06, 0.3)
    lag = _log_uniform(rng, 0.15, 0.8)
    of_load = {"mass": load / 9.81, "mass_loaded": load / 9.81, "wheel_load": load, "wheel_load_loaded": load}
    changed = {"wheel": PARK2008.wheel.model_copy(update=wheel), "actuator": Actuator(dead_time=dead_time, lag=lag)}
    return PARK2008.model_copy(update={"name": "random", **of_load, **changed})


def one_hump(rng: np.random.Generator, wheel_load: float = 0.0) -> AdhesionLaw:
    """Return a random adhesion curve with one peak, as a table; it does not depend on the wheel load.

    The peak is at a slip ratio of 0.008 to 0.15, where mu is 0.05 to 0.35. Let x be the slip divided by the slip of the
    peak. For x < 1, mu is proportional to 1 - (1 - x)^a. For x > 1, mu falls towards a plateau of 0.35 to 0.95 times
    the peak value; the difference from the plateau is proportional to 1/(1 + ((x - 1)/w)^2). a and w are random.
    """
    slip = _log_uniform(rng, 0.008, 0.15)
    mu, a, plateau = rng.uniform(0.05, 0.35), rng.uniform(1.5, 4.0), rng.uniform(0.35, 0.95)
    w = _log_uniform(rng, 0.5, 6.0)
    down = np.geomspace(1e-2, 1.0 / slip - 1.0, 45)
    return _table(slip, mu, a, down, plateau + (1.0 - plateau) / (1.0 + (down / w) ** 2))


def two_stage(rng: np.random.Generator, wheel_load: float = 0.0) -> AdhesionLaw:
    """Return a random adhesion curve like that of `one_hump`, on which adhesion rises again at large slip.

    The peak is at a slip ratio of 0.008 to 0.03. At slip ratio 0.25, mu is 0.7 to 1.1 times the peak value.
    """
    slip, mu, a = _log_uniform(rng, 0.008, 0.03), rng.uniform(0.05, 0.35), rng.uniform(1.5, 4.0)
    plateau, w, again = rng.uniform(0.5, 0.95), _log_uniform(rng, 0.5, 6.0), rng.uniform(0.7, 1.1)
    down = np.geomspace(1e-2, 1.0 / slip - 1.0, 45)
    fallen = plateau + (1.0 - plateau) / (1.0 + (down / w) ** 2)
    rising = np.clip((1.0 + down) * slip / 0.25, 0.0, 1.0)
    return _table(slip, mu, a, down, fallen + np.maximum(again - fallen, 0.0) * rising)


def _table(slip: float, mu: float, a: float, down: np.ndarray, shares: np.ndarray) -> AdhesionLaw:
    up = np.linspace(0.0, 1.0, 25)
    slips = np.append(slip * np.concatenate([up, 1.0 + down])[:-1], 1.0)
    values = mu * np.concatenate([1.0 - (1.0 - up) ** a, shares])
    return law_class("table").model_validate({"slip": tuple(slips), "mu": tuple(values), "reference": _reference(slip)})


def _reference(slip: float) -> ReferenceSlip:
    return ReferenceSlip(dry=0.8 * slip, wet=0.8 * slip)


def polach(rng: np.random.Generator, wheel_load: float) -> AdhesionLaw:
    """Return Polach's law with random parameters near Polach's own parameters for dry and wet rail.

    The semi-axes of the contact ellipse are proportional to the cube root of `wheel_load`, N.
    """
    axis = 6e-3 * (wheel_load / PARK2008.wheel_load) ** (1 / 3)
    k = _log_uniform(rng, 0.2, 1.0)
    return Polach(
        **{"kA": k, "kS": k * rng.uniform(0.3, 0.5), "mu0": rng.uniform(0.1, 0.5), "A": rng.uniform(0.3, 0.6)},
        **{"Bw": _log_uniform(rng, 0.1, 0.8), "a": axis, "b": axis, "reference": _reference(0.03)},
    )


def burckhardt(rng: np.random.Generator, wheel_load: float = 0.0) -> AdhesionLaw:
    """Return Burckhardt's curve with random parameters for rails."""
    c1, c2, fall = rng.uniform(0.06, 0.35), 1.0 / _log_uniform(rng, 0.002, 0.04), rng.uniform(0.2, 0.7)
    return law_class("burckhardt").model_validate({"c1": c1, "c2": c2, "c3": fall * c1, "reference": _reference(0.05)})


def bristle(rng: np.random.Generator, wheel_load: float) -> AdhesionLaw:
    """Return the bristle model with random parameters.

    mu is 0.08 to 0.35 at slip velocity 0 and falls to zero at a slip velocity of 30 to 90 m/s. The stiffness is 0.5 to
    2 times the stiffness in [Park2008], scaled in proportion to `wheel_load`, N.
    """
    mu, gamma = rng.uniform(0.08, 0.35), _log_uniform(rng, 30.0, 90.0)
    alpha = 2.2e4 * wheel_load / PARK2008.wheel_load * _log_uniform(rng, 0.5, 2.0)
    given = {"alpha": alpha, "beta": gamma / (mu * wheel_load), "gamma": gamma, "reference": _reference(0.1)}
    return law_class("bristle").model_validate(given)


def lugre(rng: np.random.Generator, wheel_load: float) -> AdhesionLaw:
    """Return the LuGre model with random parameters.

    The coefficient of static friction is 0.08 to 0.35, that of Coulomb friction 0.4 to 0.9 times as large. The Stribeck
    velocity is 1 to 6 m/s. Stiffness and damping are proportional to `wheel_load`, N. At the wheel load of [Park2008]
    the stiffness is 0.5 to 2 times 22 kN/m, and the damping coefficients alpha1 and alpha2 are 310 and 21 N*s/m.
    """
    mu, vs = rng.uniform(0.08, 0.35), _log_uniform(rng, 1.0, 6.0)
    share = wheel_load / PARK2008.wheel_load
    given = {"alpha": 2.2e4 * share * _log_uniform(rng, 0.5, 2.0), "alpha1": 310.0 * share, "alpha2": 21.0 * share}
    given |= {"Fs": mu * wheel_load, "Fc": rng.uniform(0.4, 0.9) * mu * wheel_load, "vs": vs}
    return law_class("lugre").model_validate({**given, "reference": _reference(0.1)})


FAMILIES: Mapping[str, Callable[[np.random.Generator, float], AdhesionLaw]] = MappingProxyType(
    {
        "one hump": one_hump,
        "changing": one_hump,
        "two stage": two_stage,
        "polach": polach,
        "burckhardt": burckhardt,
        "bristle": bristle,
        "lugre": lugre,
    }
)
"""Functions that return a random adhesion law, by name; "changing" also changes the rail once during the stop."""


def random_stop(seed: int, *, family: str = "one hump", errors: bool = False) -> Scenario:
    """Return the random stop of a seed, from 100 to 5 km/h, with a largest command of the full brake torque.

    - family: name of the random adhesion law in `FAMILIES`.
    - errors: True adds random errors of sensors, brake and assumed parameters; the constants of this module bound them.
    """
    rng = np.random.default_rng(seed)
    vehicle = random_vehicle(rng)
    law = FAMILIES[family](rng, vehicle.wheel_load)
    scenario = stop(vehicle, Rail.DRY, adhesion=law)
    high = full_brake_torque(vehicle)
    changes: dict[str, object] = {"limits": BrakeLimits(torque_max=high)}
    if family == "changing":
        first, then = (Rail.DRY, Rail.WET) if rng.uniform() < 0.5 else (Rail.WET, Rail.DRY)
        changes |= {"rail": first, "events": (Event(distance=rng.uniform(20.0, 150.0), rail=then),)}
    if errors:
        changes |= _errors(np.random.default_rng((seed, 1)), vehicle, high)
    return scenario.with_changes(**changes)


def _errors(rng: np.random.Generator, vehicle: Vehicle, high: float) -> dict[str, object]:
    scale, radius, gain = (1.0 + rng.uniform(-bound, bound) for bound in (SPEED_SCALE, RADIUS, GAIN))
    dead_time, lag = 1.0 + rng.uniform(-BRAKE, BRAKE, size=2)
    teeth = rng.integers(*TEETH, endpoint=True)
    edge = PITCH_ERROR * 2.0 * math.pi / teeth  # the speed is the angle between two edges over a sampling period
    actuator = vehicle.actuator
    return {
        "limits": BrakeLimits(torque_max=high, torque_gain=gain),
        "beliefs": Beliefs(
            radius=vehicle.wheel.radius * radius / scale,  # `scale` on the measured train speed has the same effect
            dead_time=actuator.dead_time * dead_time,
            lag=actuator.lag * lag,
        ),
        "measurement": Measurement(speed_noise=SPEED_NOISE, wheel_noise=math.sqrt(2.0) * edge / PERIOD),
    }


def peak_of(law: AdhesionLaw, speed: float, wheel_load: float) -> Peak:
    """Return the adhesion peak of a law at a speed, m/s, and a wheel load, N."""
    top = peak(law, speed, wheel_load)
    return Peak(top.slip, top.coefficient)
