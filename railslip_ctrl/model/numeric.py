"""Numeric functions of the plant, generated from its SymPy statement.

`make generate` writes one module a law to `_generated/`, which is committed, so that evaluating
numbers needs no SymPy. Each carries a hash of the sources it came from (`plant.py`, `notation.py`, the law's
file); where it does not fit, and for a law without one, the functions are generated in memory instead: an edited
plant or a new law works at once, only slower.

Generated functions take (v, sigma, z, Tb, Td, Tr, p): m/s, m/s, m, N*m three times, and the flat tuple of
`plant_parameters`. They are vectorised: arguments may be numbers or arrays of one shape. A static
law ignores `z`.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
import types
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .adhesion import AdhesionLaw
from .vehicle import Vehicle

PACKAGE = Path(__file__).parents[1]
GENERATED = "railslip_ctrl.model._generated"


@dataclass(frozen=True)
class NumericPlant:
    """The plant with one adhesion law, in numbers. Arguments are those of the module's generated functions.

    Attributes
    ----------
    law : type
        The adhesion law.
    generated_in_memory : bool
        True where no committed module fits the sources.
    force : callable
        Adhesion force Fa, N.
    force_gradient : callable
        Its derivatives with respect to v, sigma and z, a tuple.
    rest_state : callable
        z at rest, m (0 for a static law).
    rates : callable
        The tuple (v', sigma', z'), m/s^2, m/s^2, m/s.
    jacobian : callable
        Derivatives of the rates (rows) with respect to v, sigma, z, Tb (columns), nested tuples, 3 by 4.
    trim_torque : callable
        Tb with lambda' = 0, N*m.
    """

    law: type[AdhesionLaw]
    generated_in_memory: bool
    force: Callable[..., Any]
    force_gradient: Callable[..., Any]
    rest_state: Callable[..., Any]
    rates: Callable[..., Any]
    jacobian: Callable[..., Any]
    trim_torque: Callable[..., Any]


FUNCTIONS = ("force", "force_gradient", "rest_state", "rates", "jacobian", "trim_torque")
"""The generated functions: the attributes of `plant.ClosedPlant` of the same names."""


def plant_parameters(law: AdhesionLaw, vehicle: Vehicle) -> tuple[float, ...]:
    """The flat tuple `p`: M, J, B (effective), r, Fr0, Fr1, Fr2, N, then the law's parameters; SI."""
    resistance = vehicle.resistance
    return (
        vehicle.effective_mass,
        vehicle.effective_inertia,
        vehicle.effective_viscous_friction,
        vehicle.wheel.radius,
        resistance.constant,
        resistance.linear,
        resistance.quadratic,
        vehicle.wheel_load,
        *law.parameters(),
    )


@cache
def numeric_plant(law: type[AdhesionLaw]) -> NumericPlant:
    """Numeric functions of the plant with a law: the committed ones where they fit the sources, else generated now."""
    module = _committed(law)
    in_memory = module is None
    if module is None:
        module = types.ModuleType(f"{GENERATED}.{law.name}")
        exec(compile(generate(law), f"<generated for {law.name}>", "exec"), module.__dict__)
    return NumericPlant(law, in_memory, **{name: getattr(module, name) for name in FUNCTIONS})


def _committed(law: type[AdhesionLaw]) -> types.ModuleType | None:
    name = f"{GENERATED}.{law.name}"
    if importlib.util.find_spec(name) is None:
        return None
    module = importlib.import_module(name)
    return module if sources_hash(law) == module.SOURCES_SHA256 else None


def sources_hash(law: type[AdhesionLaw]) -> str:
    """SHA-256 of the text of the sources a law's generated module depends on."""
    law_file = Path(sys.modules[law.__module__].__file__ or "")
    digest = hashlib.sha256()
    for path in (PACKAGE / "model" / "plant.py", PACKAGE / "core" / "notation.py", law_file):
        digest.update(path.read_text(encoding="utf-8").encode("utf-8"))  # read as text: line ends do not count
    return digest.hexdigest()


# --- use -----------------------------------------------------------------------------------------------------------


def adhesion_coefficient(
    law: AdhesionLaw, speed: float, slip: ArrayLike, wheel_load: float
) -> NDArray[np.float64] | np.float64:
    """mu = Fa/N with the adhesion state at rest, at one speed (m/s), for slip ratios of any shape; wheel load in N.

    DomainError where the law does not hold.
    """
    ratio = np.asarray(slip, dtype=float)
    law.check_domain(speed, ratio * speed)
    functions = numeric_plant(type(law))
    p = (*_NO_VEHICLE, wheel_load, *law.parameters())
    sigma = ratio * speed
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


# --- generation ----------------------------------------------------------------------------------------------------


def generate(law: type[AdhesionLaw]) -> str:
    """Text of the numeric module of a law."""
    from . import plant

    closed = plant.close(law)
    printer = _printer({"user_functions": {name: path.split(":")[1] for name, path in closed.functions.items()}})
    names = [*plant.VEHICLE_PARAMETERS, *law.argument_names()]
    imports = [f"from {path.split(':')[0]} import {path.split(':')[1]}" for path in closed.functions.values()]
    head = [
        f'"""Plant with the adhesion law {law.name!r}. Generated by `make generate`: do not edit."""',
        "# mypy: ignore-errors",
        *("", "import numpy"),
        *(["", *imports] if imports else []),
        *("", f'SOURCES_SHA256 = "{sources_hash(law)}"'),
    ]
    functions = [_function_text(name, getattr(closed, name), plant.ARGUMENTS, names, printer) for name in FUNCTIONS]
    return "\n".join(head) + "\n" + "".join(functions)


def _printer(settings: dict[str, Any]) -> Any:
    """SymPy's printer for NumPy, but for what is slow there: powers beyond the square, and `select`."""
    import sympy as sp
    from sympy.printing.numpy import NumPyPrinter

    class Printer(NumPyPrinter):  # type: ignore[misc]
        def _print_Pow(self, expr: Any, rational: bool = False) -> str:
            base, exponent = expr.as_base_exp()
            if not (base.is_Symbol and exponent.is_Integer and exponent not in (-1, 2)):
                return str(super()._print_Pow(expr, rational=rational))
            product = "(" + "*".join([self._print(base)] * abs(int(exponent))) + ")"
            return product if exponent > 0 else f"{product}**(-1.0)"

        def _print_Piecewise(self, expr: Any) -> str:
            *cases, (last, condition) = expr.args
            rest = self._print(last) if condition is sp.true else self._print_case(last, condition, "numpy.nan")
            for value, condition in reversed(cases):
                rest = self._print_case(value, condition, rest)
            return rest

        def _print_case(self, value: Any, condition: Any, rest: str) -> str:
            return f"numpy.where({self._print(condition)}, {self._print(value)}, {rest})"

    return Printer(settings)


def _function_text(name: str, value: Any, arguments: tuple[str, ...], parameters: list[str], printer: Any) -> str:
    import sympy as sp

    # A function of the statement's own letters may not meet a temporary of the same name, hence the underscore.
    temporaries, flat = sp.cse(_flatten(value), symbols=sp.numbered_symbols("_x"))
    printed = iter([printer.doprint(expression) for expression in flat])
    lines = [
        f"def {name}({', '.join(arguments)}, p):",
        f"    {', '.join(parameters)} = p",
        *(f"    {target} = {printer.doprint(expression)}" for target, expression in temporaries),
        f"    return {_nested_text(value, printed)}",
    ]
    return "\n\n" + "\n".join(lines) + "\n"


def _flatten(value: Any) -> list[Any]:
    return [item for part in value for item in _flatten(part)] if isinstance(value, tuple) else [value]


def _nested_text(value: Any, printed: Any) -> str:
    if not isinstance(value, tuple):
        return str(next(printed))
    return "(" + ", ".join(_nested_text(part, printed) for part in value) + ")"
