"""Assumptions on units and details (the "reading") with which [Park2008] Table 5 is reproduced, and alternatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.controllers.sliding import FILTER_TIME, Sliding
from railslip_ctrl.core.notation import cite
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.templates import texts
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.catalogue import (
    COLUMNS,
    Column,
    published_controller,
    published_law_gains,
    published_reference,
)
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.adhesion.curve import SLIP_ACCELERATION, Curve
from railslip_ctrl.model.vehicle import (
    AS_PUBLISHED_INERTIA_SCALE,
    PARK2008,
    TABLE4_PI,
    TABLE4_PI_PRINTED,
    TABLE4_SLIDING_PRINTED,
    Actuator,
    Rail,
    Resistance,
)
from railslip_ctrl.simulation import BrakeLimits, published_scenario
from railslip_ctrl.simulation.scenario import PUBLISHED_DISTURBANCES

from . import tables


class Basis(StrEnum):
    """Basis of a rule: printed in the paper, inferred from it, or fitted to Table 5."""

    PRINTED = "printed"
    INFERRED = "inferred"
    FITTED = "fitted"


@dataclass(frozen=True)
class ReadingRule:
    """One assumption of the reading: name, value or model used, basis, and place in the paper."""

    name: str
    used: str
    basis: Basis
    where: str


def _rules() -> tuple[ReadingRule, ...]:
    numbers = {
        "scale": AS_PUBLISHED_INERTIA_SCALE,
        "slip_acceleration": SLIP_ACCELERATION,
        "wheel_load": PARK2008.wheel_load,
        "kp": TABLE4_PI["bristle"].kp,
        "ki": TABLE4_PI["bristle"].ki,
        "mass": PARK2008.mass,
        "filter_time": FILTER_TIME,
        "random_force": PUBLISHED_DISTURBANCES.random_force,
        "random_hold": PUBLISHED_DISTURBANCES.random_hold,
    }
    return tuple(
        ReadingRule(name, one["used"].format(**numbers), Basis(one["basis"]), cite("Park2008", one["where"]))
        for name, one in texts(__package__, "reading.toml").items()
    )


READING = _rules()  #: the rules, in the order of `reading.toml`


Change = Callable[[tables.Setup], tables.Setup | None]
"""Function that changes the setup of a column of Table 5; it returns None if the column does not change."""

_LOAD_RATIO = PARK2008.mass_loaded / PARK2008.mass
_FREE_TORQUE = BrakeLimits(torque_min=-1e9)  # N*m; no controller commands this torque


@dataclass(frozen=True)
class Alternative:
    """Alternative to a rule of the reading: name of the rule, name of the alternative, and change of the setup."""

    rule: str
    name: str
    change: Change


class _HalvedCurve(Curve):
    """Curve with half the dry force on wet rail at every slip; the peak slip is unchanged."""

    __module__ = Curve.__module__  # uses the generated code of the curve, as the equations are the same
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"alpha": 0.5, "beta": 2.0})


class _LoadedWetCurve(Curve):
    """Curve whose wheel load grows with the mass when the rail turns wet."""

    __module__ = Curve.__module__  # uses the generated code of the curve, as the equations are the same
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"alpha": _LOAD_RATIO, "beta": 2.0 / _LOAD_RATIO})


def _scenario(**changes: Any) -> Change:
    return lambda setup: replace(setup, scenario=setup.scenario.with_changes(**changes))


def _part(name: str, **changes: Any) -> Change:
    return lambda setup: _scenario(**{name: getattr(setup.scenario, name).model_copy(update=changes)})(setup)


def _wet_by(law: type[Curve]) -> Change:
    return lambda setup: _scenario(adhesion=law(**dict(setup.scenario.adhesion)))(setup)


def _plant(columns: Sequence[Column] = COLUMNS, **changes: Any) -> Change:
    return lambda setup: replace(setup, scenario=published_scenario(**changes)) if setup.case.gains in columns else None


def _controller(kind: type[Any], changes: Callable[[tables.Setup], dict[str, Any]]) -> Change:
    def change(setup: tables.Setup) -> tables.Setup | None:
        if not isinstance(setup.controller, kind):
            return None
        return replace(setup, controller=setup.controller.model_copy(update=changes(setup)))

    return change


def _asmc(**changes: Any) -> Change:
    return _controller(Sliding, lambda setup: changes)


def _one_reference(reference: ReferenceSlip) -> Change:
    return lambda setup: replace(
        setup, controller=published_controller(setup.case.kind, setup.case.gains, reference=reference)
    )


def _beam_model(setup: tables.Setup) -> tables.Setup | None:
    return _asmc(adhesion=published_law("beam", Rail.DRY))(setup) if setup.case.gains == "beam" else None


def _si_gains(setup: tables.Setup) -> dict[str, Any]:
    printed = TABLE4_PI_PRINTED[setup.case.gains]
    return {"kp": printed.Kp, "ki": printed.Ki}


def _rates_of_s(setup: tables.Setup) -> dict[str, Any]:
    printed, vehicle = TABLE4_SLIDING_PRINTED[setup.case.gains], setup.scenario.vehicle
    per_hour = 1.0 / 3600.0  # (39) has D in 1/h and K in km/h^2; J/r converts them to torque gains
    torque = vehicle.effective_inertia / vehicle.wheel.radius
    return {"D": torque * printed.D * per_hour, "K": torque * printed.K * KMH * per_hour}


def _adaptation(setup: tables.Setup) -> dict[str, Any]:
    gains = published_law_gains(setup.case.gains, adaptive=True)
    return {"k1": gains.k1, "k2": gains.k2}


_ANTI_WINDUP = {"torque_min": 0.0, "anti_windup": True}

ALTERNATIVES = (
    Alternative("inertia scale", "SI: M, J and B unchanged", _plant(as_published=False)),
    Alternative("energy unit", "energy in joules", lambda setup: replace(setup, energy_in_joules=True)),
    Alternative("plant law", "beam law in all columns", _plant(adhesion="beam")),
    Alternative("plant law", "beam law in the beam columns", _plant(("beam",), adhesion="beam")),
    Alternative("plant law", "dynamic bristle law", _plant(adhesion="bristle")),
    Alternative("ramp of the curve", "R 10 % less", _part("adhesion", R=0.9 * SLIP_ACCELERATION)),
    Alternative("ramp of the curve", "R 10 % more", _part("adhesion", R=1.1 * SLIP_ACCELERATION)),
    Alternative("wet rail", "half the force at every slip", _wet_by(_HalvedCurve)),
    Alternative("wheel load", "N follows M at 25 s", _wet_by(_LoadedWetCurve)),
    Alternative("PI units", "gains in N m per m/s", _controller(PI, _si_gains)),
    Alternative("PI limits", "anti-windup, Tt = Kp/Ki", _controller(PI, lambda _: _ANTI_WINDUP)),
    Alternative("references", "bristle reference in all columns", _one_reference(published_reference("bristle"))),
    Alternative("references", "beam reference in all columns", _one_reference(published_reference("beam"))),
    Alternative("ASMC units", "D and K as rates of s, (39), as printed", _controller(Sliding, _rates_of_s)),
    Alternative(
        "ASMC units",
        "rho per hour",
        _controller(Sliding, lambda setup: {"rho": TABLE4_SLIDING_PRINTED[setup.case.gains].rho / 3600.0}),
    ),
    Alternative("ASMC model", "the wet rail is not known: dry curve kept", _asmc(knows_rail=False)),
    Alternative("ASMC model", "beam model in the beam column", _beam_model),
    Alternative("ASMC nominal mass", "Mn loaded", _asmc(nominal_mass=PARK2008.mass_loaded)),
    Alternative("adaptation", "k = 2.1e-8 as printed", _controller(Sliding, _adaptation)),
    Alternative("acceleration filter", "tau 0.02 s", _asmc(filter_time=0.02)),
    Alternative("acceleration filter", "tau 0.5 s", _asmc(filter_time=0.5)),
    Alternative("actuator", "none: torque at once", _part("vehicle", actuator=Actuator(dead_time=0.0, lag=0.0))),
    Alternative("torque sign", "Tb < 0 allowed", _scenario(limits=_FREE_TORQUE)),
    Alternative(
        "resistance",
        "v in km/h",
        _part("vehicle", resistance=Resistance(quadratic=PARK2008.resistance.quadratic / KMH**2)),
    ),
    Alternative("random force", "none", _part("disturbances", random_force=0.0)),
    Alternative("noise hold", "1 ms", _part("disturbances", random_hold=0.001)),
    Alternative("noise hold", "0.1 s", _part("disturbances", random_hold=0.1)),
    Alternative("viscous friction", "B at least 0", _scenario(viscous_least=0.0)),
    Alternative("caliper", "no Td", _part("disturbances", caliper_fraction=0.0)),
    Alternative("slip error", "against each column's own reference", lambda setup: replace(setup, own_reference=True)),
)
"""Alternatives to the rules of the reading, in the order of `READING`."""


DEFAULT_SEEDS = 8
"""Runs of each column; fewer than for Table 5, because runs are compared with the same seeds."""

_UNTOUCHED = np.full(len(tables.QUANTITIES), math.nan)


@dataclass(frozen=True)
class SensitivityRow:
    """Results if one rule of the reading is replaced by an alternative.

    - results: one for each column of Table 5; a column that the alternative does not change has the reading's result.
    - rms_deviation_percent: rms deviation from Table 5 over all sixteen numbers, %; NaN if a run did not stop.
    - largest_change_percent, largest_change_of: largest change, %, of a simulated number against the reading, and the
      name of this number; NaN and "" if every changed column has a run that did not stop.
    """

    alternative: Alternative
    results: tuple[tables.CaseResult, ...]
    rms_deviation_percent: float
    largest_change_percent: float
    largest_change_of: str

    @property
    def not_stopped(self) -> dict[str, int]:
        """Number of runs that did not stop, for each column with such runs."""
        return {one.setup.case.name: len(one.failures) for one in self.results if one.failures}


@dataclass(frozen=True)
class Sensitivity:
    """Results for Table 5 with the reading (`base`) and with each alternative (`rows`).

    - seeds: number of runs of each column; all setups use the same seeds.
    """

    base: tuple[tables.CaseResult, ...]
    rows: tuple[SensitivityRow, ...]
    seeds: int

    @property
    def base_rms_deviation_percent(self) -> float:
        """Rms deviation of the reading from Table 5, %."""
        return tables.rms_deviation_percent(self.base)


def sensitivity(
    seeds: int = DEFAULT_SEEDS,
    *,
    alternatives: Sequence[Alternative] = ALTERNATIVES,
    progress: tables.Progress | None = None,
) -> Sensitivity:
    """Run the reading and each alternative to one of its rules, and compare all results with [Park2008] Table 5.

    - seeds: number of runs of each column, 2 to `MOST_SEEDS`; InputError for another number.
    - progress: called with a line of text for each alternative done.
    """
    tables.checked_seeds(seeds)
    base = tables.run_setups([tables.published_setup(case) for case in tables.CASES], seeds)
    rows = []
    for number, alternative in enumerate(alternatives, 1):
        rows.append(_row(alternative, base, seeds))
        if progress is not None:
            progress(f"sensitivity {number} of {len(alternatives)}: {alternative.name}")
    return Sensitivity(base, tuple(rows), seeds)


def _row(alternative: Alternative, base: tuple[tables.CaseResult, ...], seeds: int) -> SensitivityRow:
    changed = [alternative.change(result.setup) for result in base]
    concerned: list[tables.Setup] = [setup for setup in changed if setup is not None]
    again = iter(tables.run_setups(concerned, seeds))
    results = tuple(old if setup is None else next(again) for setup, old in zip(changed, base, strict=True))
    change, item = _largest_change(results, base)
    return SensitivityRow(alternative, results, tables.rms_deviation_percent(results), change, item)


def _largest_change(results: tuple[tables.CaseResult, ...], base: tuple[tables.CaseResult, ...]) -> tuple[float, str]:
    pairs = zip(results, base, strict=True)
    changes = np.array([100.0 * (new.mean / old.mean - 1.0) if new is not old else _UNTOUCHED for new, old in pairs])
    if np.isnan(changes).all():
        return math.nan, ""
    column, quantity = np.unravel_index(np.nanargmax(np.abs(changes)), changes.shape)
    return float(changes[column, quantity]), f"{tables.CASES[column].name} / {tables.QUANTITIES[quantity]}"
