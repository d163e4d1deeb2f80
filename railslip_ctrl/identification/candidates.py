"""The models of a log, fitted to be compared; intervals are for the chosen one, as they take most of the time."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.model.vehicle import Vehicle

from .comparison import compare
from .curves import Curve
from .fits import Fit, fit
from .models import SLIDING_ALONE, Setting, fit_model, shape_of
from .motion import along_the_motion, is_followed
from .plausibility import ImpossibleFitError, check_fit
from .reference import peak_of_law
from .regimes import Regimes, regimes_of, regimes_of_data

DRIFT_SPEEDS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Speeds at which a fit is looked at, of the initial speed."""

OF_EACH_KIND = ("bristle", "beam", "burckhardt")
"""Models that are followed along the motion: one that builds up, one with a kink, a smooth one."""

_NO_PEAK = (*SLIDING_ALONE, "table")  # or one that lies on a knot


def speeds_looked_at(setting: Setting) -> tuple[float, float]:
    """The lowest and the highest speed at which a fit is looked at, m/s."""
    return DRIFT_SPEEDS[0] * setting.initial_speed, DRIFT_SPEEDS[-1] * setting.initial_speed


@dataclass(frozen=True)
class Fitted:
    """The fits; why models have none, a sentence each; and which of these for adhesion that cannot be."""

    fits: tuple[Fit, ...]
    failures: tuple[str, ...]
    impossible: tuple[str, ...]


class Candidates:
    """What can be fitted to a curve.

    Attributes
    ----------
    curve : Curve
    vehicle : Vehicle
    setting : Setting
    regimes : Regimes
        Parted at the peak of the best of the models fitted that follow the whole curve by a formula; without one,
        where the data's mu is highest.
    """

    def __init__(self, curve: Curve, vehicle: Vehicle, setting: Setting, regimes: Regimes | None = None) -> None:
        self.curve, self.vehicle, self.setting = curve, vehicle, setting
        self.regimes = regimes or regimes_of_data(curve.cells)

    def fitted(self, names: Sequence[str]) -> Fitted:
        """The models of some names, with the intervals of a single one."""
        fits: list[Fit] = []
        failures, impossible, alone = [], [], len(names) == 1
        for name in sorted(names, key=SLIDING_ALONE.__contains__):  # last: the others tell where sliding begins
            if name in SLIDING_ALONE:
                self.regimes = self._regimes_of(fits)
            try:
                fits.append(self._fit(name, profiles=alone))
            except InputError as error:
                failures.append(f"{self.curve.name}: {error}" if alone else f"{self.curve.name}: {name}: {error}")
                impossible += [name] if isinstance(error, ImpossibleFitError) else []
        self.regimes = self._regimes_of(fits)
        return Fitted(tuple(fits), tuple(failures), tuple(impossible))

    def with_intervals(self, found: Fit) -> Fit:
        """A fit of these with the intervals of its parameters; as it is where it has them."""
        return found if found.with_profiles else self._fit(found.model.name, profiles=True)

    def better_followed(self, found: Fit) -> Fit:
        """The best of some models that can be followed along the motion, where it is better than one of the user's."""
        free = Candidates(self.curve, self.vehicle, replace(self.setting, fixed={}, bounds={}))
        others = free.fitted([name for name in OF_EACH_KIND if name != found.model.name]).fits
        return compare([found, *others], self.curve.cells)[0].fit

    def _fit(self, name: str, *, profiles: bool) -> Fit:
        """One model. InputError where it cannot be fitted, or has adhesion that cannot be."""
        curve, setting = self.curve, self.setting
        model = fit_model(name, curve.cells, shape_of(curve.cells, curve.peak_slip), setting)
        known = (curve.cells, curve.stretches, setting, self.regimes.boundary, curve.time_constant)
        first = fit(model, *known, profiles=profiles and not is_followed(model, curve.record))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try what overflows
            found = along_the_motion(first, curve.record, self.vehicle, curve.cells, setting, profiles=profiles)
            check_fit(found, setting, speeds_looked_at(setting), curve.highest_mu, curve.factors)
        return replace(found, with_profiles=profiles)

    def _regimes_of(self, fits: Sequence[Fit]) -> Regimes:
        whole, own = [each for each in fits if each.model.name not in _NO_PEAK], regimes_of_data(self.curve.cells)
        if not whole:
            return own
        best, setting = compare(whole, self.curve.cells)[0].fit, self.setting
        law = best.model.make_force_law(best.values, setting.rail)
        with suppress(DomainError):
            found = peak_of_law(law, setting.initial_speed, setting.wheel_load)
            return regimes_of(found.slip, best.model.name, self.curve.cells, own)
        return own
