"""The reading of [Park2008] under which Table 5 comes out, rule by rule, and where each comes from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from railslip_ctrl.core.sources import cite
from railslip_ctrl.model.adhesion.curve import SLIP_ACCELERATION
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008, TABLE4_PI
from railslip_ctrl.simulation.catalogue import FILTER_TIME
from railslip_ctrl.simulation.scenario import PUBLISHED_DISTURBANCES


class Basis(StrEnum):
    """Where a rule comes from: the paper prints it, it follows from the paper, or it was fitted to Table 5."""

    PRINTED = "printed"
    INFERRED = "inferred"
    FITTED = "fitted"


@dataclass(frozen=True)
class Rule:
    """One rule of the reading: its name, what is used, its basis, and where in the paper it is or bears on."""

    name: str
    used: str
    basis: Basis
    where: str


_P, _I, _F = Basis.PRINTED, Basis.INFERRED, Basis.FITTED
_SCALE = f"{AS_PUBLISHED_INERTIA_SCALE:g}"
_PI = TABLE4_PI["bristle"]

READING = (
    Rule(
        "run",
        "100 to 5 km/h from free rolling; at 25 s M 3517 to 5276 kg and dry to wet; one quarter car",
        _P,
        cite("Park2008", "pp. 54-56"),
    ),
    Rule(
        "inertia scale",
        f"M, J and B times {_SCALE}: v integrated in km/h with forces in N; in SI 50 to 60 s are impossible",
        _I,
        cite("Park2008", "(4), Table 5"),
    ),
    Rule(
        "energy unit",
        f"printed energy = {_SCALE} times the integral of Tb omega, which follows from the same units",
        _I,
        cite("Park2008", "Table 5, Fig. 20"),
    ),
    Rule(
        "plant law",
        "the bristle model in all four columns (printed), as the static curve of Fig. 17 (inferred)",
        _I,
        cite("Park2008", "p. 54, Fig. 17"),
    ),
    Rule(
        "ramp of the curve",
        f"slip acceleration R = {SLIP_ACCELERATION:g} m/s^2",
        _F,
        cite("Park2008", "(19)-(24), Fig. 17"),
    ),
    Rule("wet rail", "beta doubled: adhesion about half", _I, cite("Park2008", "p. 55, Fig. 17")),
    Rule(
        "wheel load",
        f"N = {PARK2008.wheel_load:g} N throughout; it does not follow M",
        _I,
        cite("Park2008", "Table 1, p. 55"),
    ),
    Rule(
        "PI units",
        f"Kp in N m per km/h, Ki in N m per km/h per s: bristle column {_PI.kp:g} N m/(m/s), {_PI.ki:g} N m/m",
        _I,
        cite("Park2008", "Table 4"),
    ),
    Rule(
        "PI limits",
        "none but the brake's Tb >= 0, and no anti-windup",
        _I,
        cite("Park2008", "p. 55"),
    ),
    Rule(
        "references",
        "each column holds its own reference slip: beam 0.119/0.059, bristle 0.132/0.092",
        _P,
        cite("Park2008", "p. 55, Fig. 17"),
    ),
    Rule(
        "ASMC units",
        "D in N m per km/h and K in N m, added as torque; rho per second",
        _I,
        cite("Park2008", "(41), (45), Table 4"),
    ),
    Rule(
        "ASMC model",
        "Ta from the plant's own curve at the measured slip (printed: (20), (22)), which turns wet with the rail",
        _I,
        cite("Park2008", "pp. 54-55"),
    ),
    Rule("ASMC nominal mass", f"Mn = {PARK2008.mass:g} kg throughout", _I, cite("Park2008", "(45), p. 55")),
    Rule("adaptation", "off, k = 0: with the printed k behind the actuator the stop goes on for minutes", _I,
         cite("Park2008", "(49), Table 4")),
    Rule(
        "acceleration filter",
        f"v' from s/(tau s + 1) (printed) with tau = {FILTER_TIME:g} s (any value serves)",
        _I,
        cite("Park2008", "p. 54, Fig. 16"),
    ),
    Rule("actuator", "lag 0.6 s and dead time 0.15 s in all columns", _P, cite("Park2008", "p. 55")),
    Rule("torque sign", "Tb >= 0: a brake does not drive", _I, cite("Park2008", "Fig. 20")),
    Rule("resistance", "Fr = 0.63 v^2 N with v in m/s", _I, cite("Park2008", "p. 55")),
    Rule(
        "random force",
        f"Gaussian, {PUBLISHED_DISTURBANCES.random_force:g} N, in (3) and (4) both",
        _P,
        cite("Park2008", "(35), p. 55"),
    ),
    Rule(
        "noise hold",
        f"each random force held for {PUBLISHED_DISTURBANCES.random_hold:g} s",
        _F,
        cite("Park2008", "p. 55"),
    ),
    Rule("viscous friction", "B = 0.25 - 0.01 t, negative after 25 s", _P, cite("Park2008", "p. 55")),
    Rule("caliper", "Td = 0.05 Tb exp(-4 t) sin(10 pi t) with the acting Tb", _P, cite("Park2008", "p. 55")),
    Rule(
        "slip error",
        "against 0.132/0.092 in every column: Fig. 21 draws one reference; mean over time until 5 km/h",
        _I,
        cite("Park2008", "Table 5, Fig. 21"),
    ),
)  # fmt: skip
"""The rules, in the order of what they bear on."""
