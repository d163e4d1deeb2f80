"""Can it be? The adhesion that a log shows and that a model fitted to it has, beside what steel on steel has.

What lies outside comes from a wrong unit, wheel load or vehicle, or from a log that does not show what is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import Vehicle

from .fits import Fit, Parameter
from .models import Setting
from .record import Record

Floats = NDArray[np.float64]

HIGHEST_MU, LOWEST_MU = 0.7, 0.01
"""Adhesion coefficients of steel on steel: some 0.6 with sand, 0.02 with leaves."""

IMPOSSIBLE_MU = 1.0
"""A highest adhesion coefficient above this is refused.

Adhesion is friction at most, and that of clean dry steel on steel in air is 0.6 to 0.8 in every handbook: more than the
wheel load itself is pulled only where bare metals seize, as in vacuum. A law that has it would lead every command that
takes it astray, so that no warning will do.
"""

_UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {"brake_torque": {"N*m": 1.0, "kN*m": 1e3}, "wheel_load": {"N": 1.0, "kN": 1e3}}
)
_LIMITS: Mapping[str, str] = MappingProxyType(
    {
        "beam": "mu_max",
        "polach": "mu0",
        "lugre": "Fs by wheel load",
        **dict.fromkeys(("bristle", "bristle_rest", "curve"), "gamma/beta by wheel load"),
    }
)


def unit_hint(mu: float, factors: Mapping[str, float]) -> str:
    """The option with a unit that makes an adhesion coefficient an ordinary one; empty where none does.

    `factors` are what one of the unit that was read is in SI, by quantity, of the columns of the log.
    """
    found, other = [], math.nan
    for quantity, units in _UNITS.items():
        for unit, factor in units.items():
            ratio = factor / factors.get(quantity, factor)
            made = mu * ratio if quantity == "brake_torque" else mu / ratio
            if ratio != 1.0 and LOWEST_MU <= made <= HIGHEST_MU:
                found.append(f"{quantity} seems to be in {unit} (--unit {quantity}={unit})")
                other = made
    return f"{', or '.join(found)}, which would make it {other:.2g}" if found else ""


def mu_warning(mean_mu: Floats, factors: Mapping[str, float]) -> str | None:
    """A sentence where the mean of mu, by bins, is higher or lower than steel on steel has it; else None.

    `factors` as of `unit_hint`.
    """
    highest = float(mean_mu.max(initial=-math.inf))
    if LOWEST_MU <= highest <= HIGHEST_MU:
        return None
    return (
        f"the highest mean adhesion coefficient is {highest:.3g}, where steel on steel has {LOWEST_MU:g} to "
        f"{HIGHEST_MU:g}: {_units_or(highest, factors)}"
    )


def _units_or(mu: float, factors: Mapping[str, float]) -> str:
    return (
        unit_hint(mu, factors)
        or "check the unit of the brake torque (--unit), the wheel load and the wheel's radius (--vehicle)"
    )


class ImpossibleFitError(InputError):
    """A fit with adhesion that cannot be."""


# --- the fit -------------------------------------------------------------------------------------------------------


def highest_mu(found: Fit, setting: Setting, speeds: tuple[float, float]) -> tuple[str, float]:
    """The highest adhesion coefficient of a fitted model, and what it is called: its peak or its limit of friction.

    The peak is that at the lowest or the highest of the `speeds`, m/s. InputError for a law whose force is nowhere one
    that brakes.
    """
    law = found.model.make_force_law(found.values, found.law.rail)
    try:
        top = max(peak(law, speed, setting.wheel_load).coefficient for speed in speeds)
    except DomainError:
        raise InputError(
            "fitted to this log its adhesion is nowhere positive; check units, the wheel's radius and load (--vehicle)"
        ) from None
    limit = _limit_of_friction(found, setting.wheel_load)
    return (f"limit of friction ({_LIMITS[found.model.name]})", limit) if limit > top else ("peak", top)


def _limit_of_friction(found: Fit, wheel_load: float) -> float:
    """Adhesion coefficient that a model tends to as it slides slowly; NaN for one without such a parameter.

    A log too short of slip leaves it free while the peak, up to slip 1, may look like any other.
    """
    given = {**found.model.known, **{p.name: p.value for p in found.parameters}}
    match found.model.name:
        case "beam" | "polach" as name:
            return float(given[_LIMITS[name]])  # type: ignore[arg-type]
        case "lugre":
            return float(given["Fs"]) / wheel_load  # type: ignore[arg-type]
        case "bristle" | "bristle_rest" | "curve":
            return float(given["gamma"]) / float(given["beta"]) / wheel_load  # type: ignore[arg-type]
    return math.nan


_OTHER_DECELERATION = 1.15  # ratio: mass, load and the pull of what is not in the model are known to less
_SLOWED = 0.02  # of its speed that the train loses in the runs: on a rig that keeps its speed this tells nothing


def deceleration_ratio(record: Record, vehicle: Vehicle) -> float:
    """By how much more the train slows down in the runs than the wheel's own adhesion and the resistance make it.

    By momentum from the first row to the last of each run, of the wheel (3) and of the train (4) [Park2008]: the
    adhesion force is what is left of the brake torque when the wheel has been turned slower. NaN where the train hardly
    slows down, or no torque is left.
    """
    inside = np.diff(record.run) == 0
    step = np.diff(record.time)[inside]
    v, omega, torque = ((x[1:] + x[:-1])[inside] / 2.0 for x in (record.speed, record.omega, record.torque))
    lost, turned = (-float(np.diff(x)[inside].sum()) for x in (record.speed, record.omega))
    begins = np.flatnonzero(np.diff(record.run, prepend=-1))
    friction = vehicle.effective_viscous_friction * omega
    adhesion = float(step @ (torque + friction)) - vehicle.effective_inertia * turned
    terms = vehicle.resistance
    resistance = float(step @ (terms.constant + terms.linear * v + terms.quadratic * v**2))
    asked = (adhesion / vehicle.wheel.radius + resistance) / vehicle.effective_mass
    if not lost > _SLOWED * float(record.speed[begins].sum()) or not asked > 0.0:
        return math.nan
    return lost / asked


def deceleration_differs(ratio: float) -> bool:
    """Whether a ratio of decelerations is another than 1; not where it is not known."""
    return not math.isnan(ratio) and not 1.0 / _OTHER_DECELERATION < ratio < _OTHER_DECELERATION


def deceleration_warning(ratio: float) -> str | None:
    """A sentence where the train slows down as the adhesion of its wheel does not make it; else None."""
    if not deceleration_differs(ratio):
        return None
    return (
        f"the train slows down {ratio:.3g} times as much as the adhesion of this wheel makes its mass: the unit or the "
        "scale of the brake torque (--unit brake_torque=), or the mass (--vehicle), is wrong and mu with it, unless "
        "other brakes or a slope act on the train"
    )


def check_fit(
    found: Fit, setting: Setting, speeds: tuple[float, float], seen: float, factors: Mapping[str, float]
) -> None:
    """ImpossibleFitError for a fit with adhesion above `IMPOSSIBLE_MU`, InputError for one that is nowhere positive.

    `seen` is the highest mean mu of the log itself, which tells the likely cause; `speeds` as of `highest_mu`,
    `factors` as of `unit_hint`.
    """
    what, value = highest_mu(found, setting, speeds)
    if value <= IMPOSSIBLE_MU:
        return
    cause = _units_or(seen, factors)
    if LOWEST_MU <= seen <= HIGHEST_MU:
        # a log that stays below the peak leaves the limit free: its stiffness can still be had, within a bound
        name = _LIMITS.get(found.model.name, "")
        bound = f"--bound {name}=0:{HIGHEST_MU:g}" if name in found.model.names else "another --model"
        cause = (
            f"the log itself shows {seen:.2g}, so that it does not tell this model, or the vehicle is another one; "
            f"check --vehicle and the wheel load, give a log with more slip, or {bound}"
        )
    given = [name for name in setting.fixed if name in found.model.known]
    if given:
        values = ", ".join(f"--fix {name}={setting.fixed[name]:g}" for name in given)
        cause = f"{values} is given: leave it out, or give another value; else {cause}"
    raise ImpossibleFitError(
        f"fitted to this log its highest adhesion coefficient, the {what}, is {value:.3g}, above {IMPOSSIBLE_MU:g}, "
        f"which no steel on steel in air has; {cause}"
    )


def fit_doubts(
    found: Fit, setting: Setting, speeds: tuple[float, float], seen: float, factors: Mapping[str, float]
) -> tuple[str, ...]:
    """What is not to be believed of a fit that is no impossible one, a sentence each; arguments as of `check_fit`."""
    what, value = highest_mu(found, setting, speeds)
    ordinary = LOWEST_MU <= value <= HIGHEST_MU
    doubts = []
    if not ordinary:
        doubts.append(
            f"the fitted {found.model.name} has a highest adhesion coefficient, its {what}, of {value:.3g}, where "
            f"steel on steel has {LOWEST_MU:g} to {HIGHEST_MU:g}: {_units_or(value, factors)}"
        )
    cause = (
        "likely this log does not tell it, or the model is not this log's; a wrong unit of the brake torque (--unit), "
        "wheel load or vehicle (--vehicle) does the same"
        if ordinary and LOWEST_MU <= seen <= HIGHEST_MU
        else "likely by a wrong unit of the brake torque (--unit), wheel load or vehicle (--vehicle)"
    )
    untold = [f"{p.name} of {p.value:.4g}" for p in found.parameters if p.is_untold]
    if untold:
        doubts.append(
            f"the fitted {', '.join(untold)} may as well be any other by this log, and is near to where it was first "
            "looked for: give a log with more slip, a known value (--fix), or another --model"
        )
    ends = zip(found.parameters, found.model.lower, found.model.upper, strict=True)
    doubts += [_at_bound(p, low, high, setting, cause) for p, low, high in ends if "bound" in p.status]
    return tuple(doubts)


def _at_bound(p: Parameter, low: float, high: float, setting: Setting, cause: str) -> str:
    side, bound = ("lower", low) if "lower" in p.status else ("upper", high)
    if bound in setting.bounds.get(p.name, ()):
        cause = "which is given by --bound: the log asks for a value beyond it"
    # the smallest number stands for a nought that is open
    end = "infinity" if math.isinf(bound) else f"{0.0 if bound < _NOUGHT else bound:.4g}"
    return f"the fitted {p.name} of {p.value:.4g} rests on its {side} bound, {end}: {cause}"


_NOUGHT = 1e-11
