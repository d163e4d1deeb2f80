"""The derived law without SymPy: its gains, and its generated Python text, committed by `make generate`.

The head of the generated file has a hash of the sources it came from; where it does not
fit, the law is derived at once.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.kernels.text import plain
from railslip_ctrl.model.parameters import TABLE4_SLIDING_PRINTED


@dataclass(frozen=True)
class LawGains:
    """Gains of the law (45) and of its robust variants; InputError for one that is not finite or below its bound.

    K, gain on the switching term, N*m, >= 0; D, gain on s, N*m/(m/s), > 0, added to the torque like K; rho, weight of
    the integral in s, 1/s, > 0; k1, k2, adaptation gains, s^2/(kg^2 m^4) and 1, >= 0: theta_hat_i' = k_i s phi_i;
    layer, width Phi of the boundary layer, m/s, 0 is sgn s; leak, rate of sigma-modification, 1/s, >= 0: theta_hat_i' =
    k_i s phi_i - leak theta_hat_i; box, projection: bounds of theta_hat1 (1/(kg m)) and theta_hat2 (m/s); dead_zone:
    the adaptation is driven by s - Phi sat(s/Phi) in place of s.
    """

    K: float
    D: float
    rho: float
    k1: float = 0.0
    k2: float = 0.0
    layer: float = 0.0
    leak: float = 0.0
    box: tuple[tuple[float, float], tuple[float, float]] | None = None
    dead_zone: bool = False

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self) if f.name not in ("box", "dead_zone")):
            value, positive = getattr(self, name), name in ("D", "rho")
            if not (math.isfinite(value) and (value > 0 if positive else value >= 0)):
                sign = ">" if positive else ">="
                raise InputError(f"{name}: {value:g} is not allowed; give a finite value {sign} 0")


def gain_parameters(gains: LawGains) -> dict[str, float]:
    """The generated law's parameters of those names, from the record of the robust variants.

    InputError for a box without width: 0 .. 0 in the generated law is no projection.
    """
    values = {name: getattr(gains, name) for name in ("K", "D", "rho", "k1", "k2", "leak")}
    values |= {"boundary": gains.layer, "dead_zone": float(gains.dead_zone)}
    for i, (low, high) in enumerate(gains.box or (), 1):
        if not low < high:
            raise InputError(
                f"box: {low:g} .. {high:g} of theta{i}_hat is not allowed; give a lower bound below the upper"
            )
        values |= {f"theta{i}_min": low, f"theta{i}_max": high}
    return values


_PRINTED = TABLE4_SLIDING_PRINTED["bristle"]

# In km/h theta1 is 3.6 times its SI value and s is too, so k1 = k; theta2 has the same value, s and omega do not.
PUBLISHED_LAW = LawGains(K=_PRINTED.K, D=3.6 * _PRINTED.D, rho=_PRINTED.rho, k1=_PRINTED.k, k2=3.6**2 * _PRINTED.k)
"""[Park2008] Table 4, ASMC, bristle column, as it must be read: K in N*m, D in N*m per km/h, rho in 1/s."""


# --- the generated law ---

HOLD_TIME = 0.1
"""s, for which samples that are left out hold the last command: shorter than the dead time of the published brake."""

KEPT = ("command", "missing", "ready")
"""Fields of the generated state that are not the law's but are for samples left out and parameters refused."""

PACKAGE = Path(__file__).parents[1]

SOURCES = (
    *("model/plant.py", "core/notation.py", "sliding/code_python.py", "sliding/derivation.py", "sliding/law.py"),
    *("sliding/proof.py", "sliding/sampled_law.py"),
)
"""What the text of the law without adhesion follows from."""


def sources_hash() -> str:
    """SHA-256 of the text of `SOURCES`."""
    return hashlib.sha256("".join(file_hash(PACKAGE / name) for name in SOURCES).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a text file; line ends do not count."""
    return hashlib.sha256(path.read_text(encoding="utf-8").encode("utf-8")).hexdigest()


LAW_FILE = PACKAGE / "model" / "_generated" / "sliding_law.py"

_HEAD = "# mypy: ignore-errors\n"


@cache
def law_source() -> str:
    """Python source of the law of [Park2008] (45) with Ta as an argument, as `code.generate(derive())` gives it."""
    if LAW_FILE.is_file():
        text = LAW_FILE.read_text(encoding="utf-8")
        if f" {sources_hash()}." in text:
            return text.removeprefix(_HEAD)
    return _derived()


@cache
def generated_law() -> Any:
    """The law as a module: `Parameters`, `State`, `init`, `control`, `valid`, `step`."""
    module = ModuleType("railslip_sliding_law")
    exec(compile(law_source(), "<generated sliding-mode law>", "exec"), module.__dict__)
    return module


def law_states() -> tuple[str, ...]:
    """The law's states, in order: the fields of `State` but for `KEPT`, which stand last."""
    return tuple(name for name in generated_law().State._fields if name not in KEPT)


@cache
def law_kernel_text() -> str:
    """The law's functions for a kernel, and `law_parameters(c, first)`: its parameters, in order from c[first] on."""
    fields = len(generated_law().Parameters._fields)
    numbers = ", ".join(f"float(c[first + {i}])" for i in range(fields))
    text = re.sub(r"^def ", "@compiled\ndef ", plain(law_source()), flags=re.MULTILINE)
    return f"{text}\n\n@compiled\ndef law_parameters(c, first):\n    return Parameters({numbers})\n\n"


def generate_law() -> str:
    """Text of the committed file."""
    return _HEAD + _derived()


def _derived() -> str:
    from .code import generate
    from .derivation import derive

    return generate(derive()).python
