"""Equations of motion of the quarter car and its actuator in SymPy: [Park2008] (1)-(4) and p. 55.

All functions of the plant are derived from these equations. sigma = v - r omega and Fa are positive in braking. The
random adhesion torque Tr is r times the random part of the adhesion force.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import sympy as sp
from sympy.printing.numpy import NumPyPrinter
from sympy.printing.pycode import PythonCodePrinter

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.core.records import dataclass

from .adhesion import AdhesionLaw

ARGUMENTS = ("v", "sigma", "z", "Tb", "Td", "Tr")  #: arguments of every derived function: m/s, m/s, m, N*m, N*m, N*m
VEHICLE_PARAMETERS = ("M", "J", "B", "r", "Fr0", "Fr1", "Fr2", "N")  #: the parameters of the law follow them
STATES = ("v", "sigma", "z")  #: a static law has no z, and its z' is 0
JACOBIAN_COLUMNS = ("v", "sigma", "z", "Tb")  #: variables of the derivatives of the rates

v, omega, sigma, slip, z = (symbol(name) for name in ("v", "omega", "sigma", "slip", "z"))
Fa, Ta, Tb, Td, Tr, Fr = (symbol(name) for name in ("Fa", "Ta", "Tb", "Td", "Tr", "Fr"))
M, J, B, r, Fr0, Fr1, Fr2 = (symbol(name) for name in ("M", "J", "B", "r", "Fr0", "Fr1", "Fr2"))
v_rate, omega_rate = symbol("v_rate"), symbol("omega_rate")

SLIP_VELOCITY = sp.Eq(sigma, v - r * omega)
SLIP_RATIO = sp.Eq(slip, sigma / v)  # (2)
ADHESION_TORQUE = sp.Eq(Ta, r * Fa)
RESISTANCE = sp.Eq(Fr, Fr0 + Fr1 * v + Fr2 * v**2)
WHEEL = sp.Eq(J * omega_rate, -B * omega + Ta - Tb - Td + Tr)  # (3)
TRAIN = sp.Eq(M * v_rate, -Fa - Fr - Tr / r)  # (4)


def actuator_transfer() -> sp.Expr:
    """Transfer function from commanded to acting brake torque ([Park2008] p. 55)."""
    s, tau, T = symbol("s"), symbol("tau"), symbol("T")
    return sp.exp(-tau * s) / (T * s + 1)


def actuator_lag_rate() -> sp.Expr:
    """Rate Tb' of the acting torque, N*m/s; Tc is the command after the dead time, N*m."""
    return (symbol("Tc") - Tb) / symbol("T")


@dataclass(frozen=True)
class Motion:
    """Rates of v, omega, sigma and slip ratio: m/s^2, rad/s^2, m/s^2, 1/s."""

    v_rate: sp.Expr
    omega_rate: sp.Expr
    sigma_rate: sp.Expr
    slip_rate: sp.Expr


@cache
def motion() -> Motion:
    """Derive the rates of speed, wheel speed, slip velocity and slip ratio from [Park2008] (3) and (4)."""
    wheel_speed = sp.solve(SLIP_VELOCITY, omega)[0]
    known = {ADHESION_TORQUE.lhs: ADHESION_TORQUE.rhs, RESISTANCE.lhs: RESISTANCE.rhs}
    train = sp.expand(sp.solve(TRAIN, v_rate)[0].subs(known))
    wheel = sp.expand(sp.solve(WHEEL, omega_rate)[0].subs(known).subs(omega, wheel_speed))
    definition = SLIP_VELOCITY.rhs
    sigma_rate = sp.expand(sp.diff(definition, v) * train + sp.diff(definition, omega) * wheel)
    ratio = SLIP_RATIO.rhs
    slip_rate = sp.expand(sp.diff(ratio, v) * train + sp.diff(ratio, sigma) * sigma_rate)
    return Motion(train, wheel, sigma_rate, slip_rate)


@cache
def trim_torque() -> sp.Expr:
    """Brake torque Tb, N*m, with which the slip ratio is constant."""
    return sp.expand(sp.solve(motion().slip_rate, Tb)[0])


def powers(force: sp.Expr) -> tuple[sp.Expr, ...]:
    """Power, W, that each energy sink of `numeric.WORKS` takes from the kinetic energy of train and wheel."""
    wheel_speed = sp.solve(SLIP_VELOCITY, omega)[0]
    kinetic = sp.expand(M * v * motion().v_rate + J * wheel_speed * motion().omega_rate)
    sinks = ((Tb,), (Fa,), (B,), (Fr0, Fr1, Fr2), (Tr,), (Td,))
    parts = tuple(sp.factor(-sum(sp.diff(kinetic, factor) * factor for factor in group)) for group in sinks)
    assert sp.expand(kinetic + sum(parts)) == 0, "the powers sum to the rate of the kinetic energy"
    return tuple(part.subs(Fa, force) for part in parts)


@dataclass(frozen=True)
class ClosedPlant:
    """Plant with an adhesion law, as expressions in `ARGUMENTS`, `VEHICLE_PARAMETERS` and the parameters of the law."""

    force: sp.Expr  # adhesion force, N
    force_and_gradient: tuple[sp.Expr, ...]  # `force`, then its derivatives with respect to `STATES`
    rest_state: sp.Expr  # z at which z' = 0, m (0 for a static law)
    rates: tuple[sp.Expr, ...]  # v', sigma', z': m/s^2, m/s^2, m/s
    rates_and_powers: tuple[sp.Expr, ...]  # `rates`, then the power of each of `numeric.WORKS`, W
    jacobian: tuple[tuple[sp.Expr, ...], ...]  # derivatives of `rates` (rows) with respect to `JACOBIAN_COLUMNS`
    trim_torque: sp.Expr  # Tb with lambda' = 0, N*m


def close(law: type[AdhesionLaw]) -> ClosedPlant:
    """Insert the equations of an adhesion law; InputError if a parameter has the name of a plant symbol."""
    taken = {*ARGUMENTS, *VEHICLE_PARAMETERS} & set(law.parameter_names())
    if taken:
        raise InputError(f"adhesion {law.name!r}: parameter {min(taken)!r} is the name of a plant symbol; rename it")
    statement, general, zero = law.statement(), motion(), sp.Integer(0)
    state_rate = zero if statement.state_rate is None else statement.state_rate
    force = statement.force
    rates = (general.v_rate.subs(Fa, force), general.sigma_rate.subs(Fa, force), state_rate)
    columns = tuple(symbol(name) for name in JACOBIAN_COLUMNS)
    return ClosedPlant(
        force=force,
        force_and_gradient=(force, *(_derivative(force, symbol(name)) for name in STATES)),
        rest_state=zero if statement.steady_state is None else statement.steady_state,
        rates=rates,
        rates_and_powers=(*rates, *powers(force)),
        jacobian=tuple(tuple(_derivative(rate, column) for column in columns) for rate in rates),
        trim_torque=trim_torque().subs(Fa, force),
    )


def _derivative(expression: sp.Expr, variable: sp.Symbol) -> sp.Expr:
    # at a jump, where the derivative has a Dirac term, the law has a kink
    return sp.diff(expression, variable).replace(sp.DiracDelta, lambda *_: sp.Integer(0))


def numeric_text(law: type[AdhesionLaw], sources_hash: str) -> str:
    """Generate the text of the numeric module of an adhesion law."""
    closed, own = close(law), law.statement().functions
    in_force = {type(function).__name__ for function in closed.force.atoms(sp.Function)}
    # names of the functions in a kernel that interpolate the table
    readers = {name: "tabulated" if name in in_force else "tabulated_slope" for name in own}
    imports = [
        f"from {path.split(':')[0]} import {path.split(':')[1]} as {readers[name]}" for name, path in own.items()
    ]
    head = [
        f'"""Plant with the adhesion law {law.name!r}. Generated by `make generate`: do not edit."""',
        "# mypy: ignore-errors",
        *("", "import numpy", "from numpy import where"),
        *(["", *imports] if imports else []),
        *("", f'SOURCES_SHA256 = "{sources_hash}"'),
    ]
    printer = _NumericPrinter(readers)
    names = [*VEHICLE_PARAMETERS, *law.argument_names()]
    functions = [_function_text(name, value, ARGUMENTS, names, printer) for name, value in vars(closed).items()]
    lag = f"\n\ndef lag_rate(Tb, Tc, T):\n    return {printer.doprint(actuator_lag_rate())}\n"
    return "\n".join(head) + "\n" + "".join(functions) + lag


class _NumericPrinter(NumPyPrinter):  # type: ignore[misc]
    """Printer of NumPy code that Numba compiles; `readers` maps SymPy function classes to the names to print."""

    def __init__(self, readers: dict[str, str]) -> None:
        super().__init__()
        self.readers = readers

    _print_Relational = PythonCodePrinter._print_Relational

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:
        base, exponent = expr.as_base_exp()
        if not (base.is_Symbol and exponent.is_Integer and exponent not in (-1, 2)):
            return str(self._hprint_Pow(expr, rational=rational, sqrt="numpy.sqrt"))
        product = "(" + "*".join([self._print(base)] * abs(int(exponent))) + ")"
        return product if exponent > 0 else f"(1/{product})"

    def _print_Piecewise(self, expr: Any) -> str:
        *cases, (last, condition) = expr.args
        rest = self._print(last) if condition is sp.true else self._print_case(last, condition, "numpy.nan")
        for value, condition in reversed(cases):
            rest = self._print_case(value, condition, rest)
        return rest

    def _print_case(self, value: Any, condition: Any, rest: str) -> str:
        return f"where({self._print(condition)}, {self._print(value)}, {rest})"

    def _print_And(self, expr: Any) -> str:
        return f"({' & '.join(map(self._print, expr.args))})"

    def _print_Or(self, expr: Any) -> str:
        return f"({' | '.join(map(self._print, expr.args))})"

    def _print_Max(self, expr: Any) -> str:
        return self._folded("numpy.maximum", expr)

    def _print_Min(self, expr: Any) -> str:
        return self._folded("numpy.minimum", expr)

    def _folded(self, name: str, expr: Any) -> str:
        *others, printed = map(self._print, expr.args)
        for other in others:
            printed = f"{name}({other}, {printed})"
        return str(printed)

    def _print_Function(self, expr: Any) -> str:
        reader = self.readers.get(type(expr).__name__)
        if reader is None:
            return str(super()._print_Function(expr))
        return f"{reader}({', '.join(map(self._print, expr.args))}, *nodes)"


def _function_text(name: str, value: Any, arguments: tuple[str, ...], parameters: list[str], printer: Any) -> str:
    # the underscore keeps the names of temporaries apart from the symbols of the law
    temporaries, flat = sp.cse(_flatten(value), symbols=sp.numbered_symbols("_x"))
    used = {str(symbol) for each in (*(e for _, e in temporaries), *flat) for symbol in each.free_symbols}
    # a constant (z' of a static law) is printed as a float: one type for all laws
    printed = iter([f"{each}.0" if each.is_Integer else printer.doprint(each) for each in flat])
    lines = [
        f"def {name}({', '.join(arguments)}, p, *nodes):",
        *(f"    {p} = p[{i}]" for i, p in enumerate(parameters) if p in used),
        *(f"    {p[1:]} = p[{i}:]" for i, p in enumerate(parameters) if p[0] == "*" and p[1:] in used),
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
