"""Gains of the law, and what its generated text has in it without SymPy."""

from __future__ import annotations

import hashlib
import linecache
from pathlib import Path
from types import MappingProxyType, ModuleType

from railslip_ctrl.core.arguments import number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.vehicle import TABLE4_SLIDING_PRINTED


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
        for name in ("D", "rho"):
            number(name, getattr(self, name), gt=0)
        for name in ("K", "k1", "k2", "layer", "leak"):
            number(name, getattr(self, name), ge=0)


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


# Printed are D in 1/h, meant as N*m per km/h, K in km/h^2, meant as N*m, rho in 1/h, meant as 1/s, and one k. In km/h
# theta1 is 3.6 times its SI value and s is too, so k1 = k; theta2 has the same value, s and omega do not.
TABLE4_LAWS = MappingProxyType(
    {
        column: LawGains(K=row.K, D=3.6 * row.D, rho=row.rho, k1=row.k, k2=3.6**2 * row.k)
        for column, row in TABLE4_SLIDING_PRINTED.items()
    }
)
"""[Park2008] Table 4, ASMC, by column, as it must be read, SI."""

PUBLISHED_LAW = TABLE4_LAWS["bristle"]


# --- what generated code shares ---------------------------------------------------------------------------------------

NOT_HOLDING = (
    *("V' <= 0, disturbed", "invariant-set theorem", "theta_hat converges", "scalar gain k"),
    *("reaching condition (40)", "s s' < -eta |s| over the box", "sliding reached and kept", "boundary layer with K"),
    *("theta constant", "theta_hat bounded under noise", "sliding exists behind the actuator"),
    *("the law behind the actuator spares the wheel", "the adaptive loop is stable behind the actuator"),
)
"""Conditions that `joint_verification` finds not to hold for the published law; deciding them takes half a minute."""

CAUTIONS = (
    "Conditions that do NOT hold for this law, with the published vehicle, gains and disturbances (railslip verify "
    "reports why, and decides them for other numbers):",
    *(f"- {name}" for name in NOT_HOLDING),
)
"""`NOT_HOLDING` as paragraphs for the head of a program."""

PACKAGE = Path(__file__).parents[1]

SOURCES = (
    *("model/plant.py", "core/notation.toml", "sliding/code.py", "sliding/derivation.py", "sliding/law.py"),
    *("sliding/notation.toml", "sliding/proof.py", "sliding/sampled_law.py", "sliding/templates/law.py.jinja"),
)
"""What the text of the law without adhesion follows from."""


def sources_hash() -> str:
    """SHA-256 of the text of `SOURCES`."""
    return hashlib.sha256("".join(file_hash(PACKAGE / name) for name in SOURCES).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a text file; line ends do not count."""
    return hashlib.sha256(path.read_text(encoding="utf-8").encode("utf-8")).hexdigest()


def module_of(text: str) -> ModuleType:
    """The module of the law's text; its functions can be read again from their source, as a kernel needs."""
    name = f"<sliding-mode law {hashlib.sha256(text.encode()).hexdigest()[:16]}>"
    linecache.cache[name] = len(text), None, text.splitlines(keepends=True), name
    module = ModuleType("railslip_asmc")
    exec(compile(text, name, "exec", dont_inherit=True), module.__dict__)
    return module
