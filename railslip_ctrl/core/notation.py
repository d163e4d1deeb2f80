"""Symbols of the plant: name in formulas and code, LaTeX, unit, meaning. Those of an adhesion law are its fields."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class Notation:
    """One symbol. `positive` is what SymPy may assume of it; every symbol is real."""

    name: str
    latex: str
    unit: str
    meaning: str
    positive: bool = False


_ENTRIES = (
    Notation("v", "v", "m/s", "train speed", positive=True),
    Notation("omega", r"\omega", "rad/s", "angular speed of the wheel"),
    Notation("sigma", r"\sigma", "m/s", "slip velocity v - r omega, positive in braking"),
    Notation("slip", r"\lambda", "1", "slip ratio sigma/v"),
    Notation("z", "z", "m", "adhesion state: mean deflection of the bristles"),
    Notation("Fa", "F_a", "N", "adhesion force of the rail on the wheel, against the motion of the train"),
    Notation("Ta", "T_a", "N*m", "adhesion torque r Fa, drives the wheel"),
    Notation("Tb", "T_b", "N*m", "brake torque acting on the wheel"),
    Notation("Td", "T_d", "N*m", "disturbance torque, in the sense of the brake torque"),
    Notation("Tr", "T_r", "N*m", "random adhesion torque, r times the random adhesion force"),
    Notation("Fr", "F_r", "N", "travelling resistance"),
    Notation("N", "N", "N", "wheel load", positive=True),
    Notation("M", "M", "kg", "quarter-car mass (effective)", positive=True),
    Notation("J", "J", "kg*m^2", "moment of inertia of the wheel (effective)", positive=True),
    Notation("B", "B", "N*m*s", "viscous torque coefficient (effective)"),
    Notation("r", "r", "m", "wheel radius", positive=True),
    Notation("Fr0", "F_{r0}", "N", "travelling resistance, constant term"),
    Notation("Fr1", "F_{r1}", "N/(m/s)", "travelling resistance, coefficient of v"),
    Notation("Fr2", "F_{r2}", "N/(m/s)^2", "travelling resistance, coefficient of v^2"),
    Notation("v_rate", r"\dot v", "m/s^2", "acceleration of the train"),
    Notation("omega_rate", r"\dot\omega", "rad/s^2", "angular acceleration of the wheel"),
    Notation("s", "s", "1/s", "Laplace variable"),
    Notation("tau", r"\tau", "s", "dead time of the actuator", positive=True),
    Notation("T", "T", "s", "time constant of the actuator's lag", positive=True),
    Notation("Tc", "T_c", "N*m", "brake torque commanded of the lag, after the dead time"),
)

NOTATION = MappingProxyType({entry.name: entry for entry in _ENTRIES})
"""The table, by name."""


def symbol(name: str) -> Any:
    """The SymPy symbol of a name in `NOTATION`; KeyError for another name. Imports SymPy."""
    import sympy as sp

    entry = NOTATION[name]
    return sp.Symbol(name, positive=True) if entry.positive else sp.Symbol(name, real=True)


def latex_names() -> dict[Any, str]:
    """What `sympy.latex(..., symbol_names=...)` needs to print the table's symbols as the source does."""
    return {symbol(entry.name): entry.latex for entry in _ENTRIES}
