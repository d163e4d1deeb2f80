"""Numeric functions of the plant, generated from its SymPy statement: one text a law, for arrays and for kernels.

`make generate` writes it to `_generated/`, so that evaluating numbers needs no SymPy. It carries a hash of its sources
(`plant.py`, `notation.toml`, the law's file); where that does not fit, it is generated in memory: an edited plant or a
new law works at once, only slower.

The functions are those of `plant.ClosedPlant` by name, and take (v, sigma, z, Tb, Td, Tr, p): m/s, m/s, m, N*m three
times, and the flat tuple of `plant_parameters`; numbers or arrays of one shape. A static law ignores `z`. In a kernel
(`kernels`) they take a table after `p`, from which a force without a closed form is read.
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

WORKS = ("brake", "slip", "viscous", "resistance", "random_force", "disturbance")
"""What takes energy from train and wheel, in the order of `plant.powers`."""


NumericPlant: TypeAlias = ModuleType  #: the module of these functions of a law, and `lag_rate`


def plant_parameters(law: AdhesionLaw, vehicle: Vehicle, gradient: float = 0.0) -> tuple[float, ...]:
    """The flat tuple `p`: M, J, B (effective), r, Fr0, Fr1, Fr2, N, then the law's parameters; SI.

    The weight along a `gradient`, rise over length, is part of Fr0; the inertia scale leaves weight as it is.
    """
    inertias = (vehicle.effective_mass, vehicle.effective_inertia, vehicle.effective_viscous_friction)
    along = vehicle.resistance.constant + vehicle.mass * GRAVITY * gradient
    resistance = (along, vehicle.resistance.linear, vehicle.resistance.quadratic)
    return (*inertias, vehicle.wheel.radius, *resistance, vehicle.wheel_load, *law.parameters())


@cache
def numeric_plant(law: type[AdhesionLaw]) -> NumericPlant:
    """The functions of a law: the committed one where it fits the sources, else generated now."""
    if _is_committed(law):
        return importlib.import_module(f"{__package__}._generated.{law.name}")
    module = ModuleType(f"generated_{law.name}")
    exec(compile(source(law), f"<generated for {law.name}>", "exec"), module.__dict__)
    return module


@cache
def source(law: type[AdhesionLaw]) -> str:
    """The text of `numeric_plant`."""
    if _is_committed(law):
        return (GENERATED / f"{law.name}.py").read_text(encoding="utf-8")
    return generate(law)


def generate(law: type[AdhesionLaw]) -> str:
    """The text of `numeric_plant`, generated now."""
    from .plant import numeric_text  # imports SymPy

    return numeric_text(law, sources_hash(law))


def _is_committed(law: type[AdhesionLaw]) -> bool:
    path = GENERATED / f"{law.name}.py"
    return path.is_file() and f'SOURCES_SHA256 = "{sources_hash(law)}"' in path.read_text(encoding="utf-8")


def sources_hash(law: type[AdhesionLaw]) -> str:
    """SHA-256 of the text of the sources a law's generated module depends on."""
    law_file = Path(sys.modules[law.__module__].__file__ or "")
    digest = hashlib.sha256()
    for path in (PACKAGE / "model" / "plant.py", PACKAGE / "core" / "notation.toml", law_file):
        digest.update(path.read_text(encoding="utf-8").encode("utf-8"))  # read as text: line ends do not count
    return digest.hexdigest()


# --- use -----------------------------------------------------------------------------------------------------------


def adhesion_coefficient(law: AdhesionLaw, speed: float, slip: ArrayLike, wheel_load: float) -> Floats | np.float64:
    """mu = Fa/N with the adhesion state at rest, at one speed (m/s), for slip ratios of any shape; wheel load in N.

    DomainError where the law does not hold.
    """
    sigma = np.asarray(slip, dtype=float) * speed
    law.check_domain(speed, sigma)
    functions, p = numeric_plant(type(law)), (*_NO_VEHICLE, wheel_load, *law.parameters())
    z = functions.rest_state(speed, sigma, 0.0, 0.0, 0.0, 0.0, p)
    coefficient = functions.force(speed, sigma, z, 0.0, 0.0, 0.0, p) / wheel_load
    return np.asarray(coefficient, dtype=float)[()]


_NO_VEHICLE = (1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)  # the force depends on nothing of the vehicle but N

_PEAK_GRID = 4001
_LOWEST_SLIP = 1e-6


@dataclass(frozen=True)
class Peak:
    """Highest adhesion coefficient at rest, and its slip ratio."""

    slip: float
    coefficient: float


@lru_cache(maxsize=512)  # the tolerances of an envelope have the peak in common
def peak(law: AdhesionLaw, speed: float, wheel_load: float) -> Peak:
    """Peak of mu over the slip ratio within the law's domain, at a speed in m/s and a wheel load in N.

    A law that falls from the start (bristle, Dahl, LuGre) has it at the lowest slip looked at, 1e-6.
    """
    from scipy.optimize import minimize_scalar

    limit = min(1.0, law.domain_limit(speed)[0] * (1.0 - 1e-9))
    grid = np.linspace(_LOWEST_SLIP, limit, _PEAK_GRID)
    values = np.asarray(adhesion_coefficient(law, speed, grid, wheel_load))
    best = int(np.argmax(values))
    if best == 0:
        return Peak(float(grid[0]), float(values[0]))
    found = minimize_scalar(
        lambda slip: -adhesion_coefficient(law, speed, slip, wheel_load),
        bounds=(grid[best - 1], grid[min(best + 1, _PEAK_GRID - 1)]),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return Peak(float(found.x), -float(found.fun))


TABLE_INTERVALS = 4096
"""Intervals of a table over the slip ratio: the cubic between nodes is then good to 1e-11 of the bristle curve."""


@lru_cache(maxsize=32)  # a campaign gives the same rails to many controllers, and a table costs as much as half a run
def adhesion_table(law: AdhesionLaw, wheel_load: float) -> Floats:
    """The law's force over the slip ratio 0 to 1 at a wheel load, N, for a law with functions without a closed form.

    Layout: nodes per unit of slip, then value (N) and slope (N per unit slip, times the node distance) in turn. A law
    in closed form needs none and has one of a single zero. Where the law's domain ends before slip 1, so does it.
    """
    if not has_table(type(law)):
        return np.zeros(1)
    speed = 1.0  # a function of the slip ratio alone: any speed gives the same table
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
    """Whether kernels read a law's force from a table."""
    return "tabulated(" in source(law)
