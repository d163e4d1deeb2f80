"""The derived law as a program: the sampled controller of `sampled_law`, printed in Python and in C99."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import ModuleType

from .code_c import c_source
from .code_python import python_source
from .derivation import Derivation
from .sampled_law import SampledLaw, sampled_law


@dataclass(frozen=True)
class LawCode:
    """Source texts of the law, and what they name."""

    law: SampledLaw
    python: str
    c: str


@cache
def generate(derivation: Derivation) -> LawCode:
    """The law of a derivation as Python and C99 source."""
    law = sampled_law(derivation)
    return LawCode(law, python_source(law), c_source(law))


@cache
def python_law(derivation: Derivation) -> ModuleType:
    """The generated Python, ready to call: `Parameters`, `State`, `init`, `control`, `valid`, `step`.

    `control` is the continuous law: a pure function of what is measured, the estimates and the parameters, to
    (torque, s, theta1_hat_rate, theta2_hat_rate). `step(state, v, omega[, Ta], p)` gives (torque, s, new state).
    """
    module = ModuleType("railslip_asmc")
    exec(compile(generate(derivation).python, "<generated sliding-mode law>", "exec"), module.__dict__)
    return module
