"""Gains of the sliding-mode law, and helpers of its generated code that need no SymPy."""

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
    """Gains of the law of [Park2008] (45) and of its robust variants.

    - K: gain of the switching term, N*m, >= 0.
    - D: gain on the sliding variable s, N*m/(m/s), > 0; D s is a torque.
    - rho: weight of the integral of the slip error in s, 1/s, > 0.
    - k1, k2: adaptation gains, s^2/(kg^2 m^4) and 1, >= 0: theta_hat_i' = k_i s phi_i with phi = (Ta, omega).
    - layer: half width Phi of the boundary layer, m/s, >= 0; with 0 the law switches by sgn s.
    - leak: rate of the sigma-modification, 1/s, >= 0: theta_hat_i' = k_i s phi_i - leak theta_hat_i.
    - box: projection bounds of theta_hat1 (1/(kg m)) and theta_hat2 (m/s); None for no projection.
    - dead_zone: if true, s - Phi sat(s/Phi) drives the adaptation instead of s.

    InputError for a gain that is not finite or is out of its range.
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
    """Return the generated law's parameters for `gains`; InputError unless lower projection bound < upper bound."""
    # in the generated code equal bounds mean no projection
    values = {name: getattr(gains, name) for name in ("K", "D", "rho", "k1", "k2", "leak")}
    values |= {"boundary": gains.layer, "dead_zone": float(gains.dead_zone)}
    for i, (low, high) in enumerate(gains.box or (), 1):
        if not low < high:
            raise InputError(
                f"box: bounds {low:g} .. {high:g} of theta{i}_hat are not allowed; give a lower bound below the upper"
            )
        values |= {f"theta{i}_min": low, f"theta{i}_max": high}
    return values


# The paper prints D in 1/h (meant: N*m per km/h), K in km/h^2 (N*m), rho in 1/h (1/s), and one k. With speeds in km/h,
# theta1, s and omega are 3.6 times their SI values, and theta2 is unchanged: theta_hat_i' = k s phi_i becomes k1 = k
# and k2 = 3.6^2 k in SI.
TABLE4_LAWS = MappingProxyType(
    {
        column: LawGains(K=row.K, D=3.6 * row.D, rho=row.rho, k1=row.k, k2=3.6**2 * row.k)
        for column, row in TABLE4_SLIDING_PRINTED.items()
    }
)
"""Gains of [Park2008] Table 4, ASMC, by column, in SI; their units are read so that Table 5 is reproduced."""

PUBLISHED_LAW = TABLE4_LAWS["bristle"]


NOT_HOLDING = (
    *("V' <= 0, disturbed", "invariant-set theorem", "theta_hat converges", "scalar gain k"),
    *("reaching condition (40)", "s s' < -eta |s| over the box", "sliding reached and kept", "boundary layer with K"),
    *("theta constant", "theta_hat bounded under noise", "sliding exists behind the actuator"),
    *("the law behind the actuator spares the wheel", "the adaptive loop is stable behind the actuator"),
)
"""Names of the conditions that fail for the published law. `joint_verification` finds them in half a minute."""

CAUTIONS = (
    "Conditions that do NOT hold for this law, with the published vehicle, gains and disturbances (railslip verify "
    "reports why, and decides them for other numbers):",
    *(f"- {name}" for name in NOT_HOLDING),
)
"""Paragraphs for the head of a generated program, which list the conditions of `NOT_HOLDING`."""

PACKAGE = Path(__file__).parents[1]

SOURCES = (
    *("model/plant.py", "core/notation.toml", "sliding/code.py", "sliding/derivation.py", "sliding/law.py"),
    *("sliding/notation.toml", "sliding/proof.py", "sliding/sampled_law.py", "sliding/templates/law.py.jinja"),
)
"""Source files of the generated law that takes Ta as an argument."""


def sources_hash() -> str:
    """Return the SHA-256 of all files of `SOURCES`."""
    return hashlib.sha256("".join(file_hash(PACKAGE / name) for name in SOURCES).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a text file, independent of its line ends."""
    return hashlib.sha256(path.read_text(encoding="utf-8").encode("utf-8")).hexdigest()


def module_of(text: str) -> ModuleType:
    """Make a module from the law's text, and register the text so that `inspect` finds the source of its functions."""
    name = f"<sliding-mode law {hashlib.sha256(text.encode()).hexdigest()[:16]}>"
    linecache.cache[name] = len(text), None, text.splitlines(keepends=True), name
    module = ModuleType("railslip_asmc")
    exec(compile(text, name, "exec", dont_inherit=True), module.__dict__)
    return module
