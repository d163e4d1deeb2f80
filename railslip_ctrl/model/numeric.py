"""Numeric functions of the plant, generated from its SymPy equations: one module per adhesion law.

`make generate` writes the modules to `_generated/`, so that numeric evaluation does not import SymPy. If the sources of
a module have changed, its functions are generated in memory, and the start takes longer.

The functions have the names of the fields of `plant.ClosedPlant` and take (v, sigma, z, Tb, Td, Tr, p). Speeds are
in m/s, z in m and torques in N*m; they are numbers, or arrays of equal shape. `p` is the tuple of `plant_parameters`.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from functools import cache, lru_cache
from pathlib import Path
from types import ModuleType
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.records import dataclass

from .adhesion import AdhesionLaw
from .vehicle import GRAVITY, Vehicle

PACKAGE = Path(__file__).parents[1]
GENERATED = PACKAGE / "model" / "_generated"

WORKS = ("brake", "slip", "viscous", "resistance", "random_force", "disturbance")  #: energy sinks of train and wheel
NumericPlant: TypeAlias = ModuleType  #: module with the numeric functions of an adhesion law


def plant_parameters(law: AdhesionLaw, vehicle: Vehicle, gradient: float = 0.0) -> tuple[float, ...]:
    """Parameters `p` of the numeric functions, SI: M, J, B, r, Fr0, Fr1, Fr2, N, then the law's parameters.

    M, J and B are multiplied by the inertia scale. Fr0 includes the component of the weight along a track with a
    `gradient` (rise over length, a ratio).
    """
    inertias = (vehicle.effective_mass, vehicle.effective_inertia, vehicle.effective_viscous_friction)
    along = vehicle.resistance.constant + vehicle.mass * GRAVITY * gradient
    resistance = (along, vehicle.resistance.linear, vehicle.resistance.quadratic)
    return (*inertias, vehicle.wheel.radius, *resistance, vehicle.wheel_load, *law.parameters())


@cache
def numeric_plant(law: type[AdhesionLaw]) -> NumericPlant:
    """Numeric functions of an adhesion law."""
    if _is_committed(law):
        return importlib.import_module(f"{__package__}._generated.{law.name}")
    module = ModuleType(f"generated_{law.name}")
    exec(compile(source(law), f"<generated for {law.name}>", "exec"), module.__dict__)
    return module


@cache
def source(law: type[AdhesionLaw]) -> str:
    """Text of the numeric module of an adhesion law: the committed file, or new text if the sources have changed."""
    if _is_committed(law):
        return (GENERATED / f"{law.name}.py").read_text(encoding="utf-8")
    return generate(law)


def generate(law: type[AdhesionLaw]) -> str:
    """Generate the text of the numeric module of a law."""
    from .plant import numeric_text  # imports SymPy

    return numeric_text(law, sources_hash(law))


def _is_committed(law: type[AdhesionLaw]) -> bool:
    path = GENERATED / f"{law.name}.py"
    return path.is_file() and f'SOURCES_SHA256 = "{sources_hash(law)}"' in path.read_text(encoding="utf-8")


def sources_hash(law: type[AdhesionLaw]) -> str:
    """SHA-256 of the sources from which the numeric module of a law is generated."""
    law_file = Path(sys.modules[law.__module__].__file__ or "")
    digest = hashlib.sha256()
    for path in (PACKAGE / "model" / "plant.py", PACKAGE / "core" / "notation.toml", law_file):
        digest.update(path.read_text(encoding="utf-8").encode("utf-8"))  # read as text: independent of line ends
    return digest.hexdigest()


def adhesion_coefficient(law: AdhesionLaw, speed: float, slip: ArrayLike, wheel_load: float) -> Floats | np.float64:
    """Adhesion coefficient mu = Fa/N in steady state (z' = 0 for a dynamic law).

    - speed: v, m/s, > 0.
    - slip: slip ratios, any shape.
    - wheel_load: N, > 0.

    DomainError: a speed or slip outside the domain of the `law`.
    """
    sigma = np.asarray(slip, dtype=float) * speed
    law.check_domain(speed, sigma)
    functions, p = numeric_plant(type(law)), (*_NO_VEHICLE, wheel_load, *law.parameters())
    z = functions.rest_state(speed, sigma, 0.0, 0.0, 0.0, 0.0, p)
    coefficient = functions.force(speed, sigma, z, 0.0, 0.0, 0.0, p) / wheel_load
    return np.asarray(coefficient, dtype=float)[()]


# Any values of M, J, B, r, Fr0, Fr1 and Fr2: the adhesion force depends only on the wheel load N.
_NO_VEHICLE = (1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)

_PEAK_GRID = 4001  # slip ratios of the grid that brackets the peak
_LOWEST_SLIP = 1e-6  # lowest slip ratio of the grid


@dataclass(frozen=True)
class Peak:
    """Slip ratio and adhesion coefficient at the peak of the steady-state adhesion curve."""

    slip: float
    coefficient: float


@lru_cache(maxsize=512)  # all plants of an envelope with the same law, speed and wheel load share the peak
def peak(law: AdhesionLaw, speed: float, wheel_load: float) -> Peak:
    """Peak of mu over the slip ratio, at a speed in m/s and a wheel load in N.

    If mu is largest at slip 0 (bristle, Dahl, LuGre), the returned peak is at slip 1e-6.
    """
    from scipy.optimize import minimize_scalar

    limit = min(1.0, law.domain_limit(speed)[0] * (1.0 - 1e-9))
    grid = np.linspace(_LOWEST_SLIP, limit, _PEAK_GRID)
    values = np.asarray(adhesion_coefficient(law, speed, grid, wheel_load))
    best = int(np.argmax(values))
    if best == 0:
        return Peak(float(grid[0]), float(values[0]))
    optimum = minimize_scalar(
        lambda slip: -adhesion_coefficient(law, speed, slip, wheel_load),
        bounds=(grid[best - 1], grid[min(best + 1, _PEAK_GRID - 1)]),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return Peak(float(optimum.x), -float(optimum.fun))


TABLE_INTERVALS = 4096  #: intervals of a table; the interpolated bristle curve is then accurate to 1e-11


@lru_cache(maxsize=32)  # the controllers of a campaign share the rails; a table costs as much as half a run
def adhesion_table(law: AdhesionLaw, wheel_load: float) -> Floats:
    """Table of the force over slip ratios 0 to 1 at a wheel load, N, for a law without closed form; [0] for other laws.

    The first element is the number of intervals per unit of slip. Then each node has two elements: the force, N, and
    the derivative of the force by slip ratio, times the distance of two nodes, N.
    """
    if not has_table(type(law)):
        return np.zeros(1)
    speed = 1.0  # m/s; any speed would do, because the force depends only on the slip ratio
    last = min(1.0, law.domain_limit(speed)[0] * (1.0 - 1e-6))
    slip = np.linspace(0.0, last, TABLE_INTERVALS + 1)
    functions, p = numeric_plant(type(law)), (*_NO_VEHICLE, wheel_load, *law.parameters())
    force, _, slope, _ = functions.force_and_gradient(speed, slip * speed, 0.0, 0.0, 0.0, 0.0, p)
    table = np.empty(2 * slip.size + 1)
    table[0] = TABLE_INTERVALS / last
    table[1::2], table[2::2] = force, slope * speed / table[0]
    table.flags.writeable = False
    return table


def has_table(law: type[AdhesionLaw]) -> bool:
    """True if kernels read the law's force from a table."""
    return "tabulated(" in source(law)
