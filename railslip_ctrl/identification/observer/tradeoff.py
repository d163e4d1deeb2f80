"""Lag against noise: how far an observer is from the true adhesion torque, split into the two, and its best setting.

The lag's error is what the observer does to a brake trial with perfect sensors, the half interval by which an encoder's
speed is late included; the noise's is the H2 norm. They are independent, so that their squares add.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .responses import AdhesionObserver
from .samples import Floats
from .sensors import Encoder, TorqueSensor, noise_deviation
from .trial import Trial, measured

_LOG_TOLERANCE = 1e-4  # of the setting's logarithm; the error is flat at its minimum


@dataclass(frozen=True)
class ObserverErrors:
    """Root mean square errors of Ta_hat over a trial from the time the brake is applied, N*m.

    Before that an observer settles from its first sample.

    Attributes
    ----------
    lag : float
        With perfect sensors.
    noise : float
        Standard deviation that the sensors' noise gives the estimate, from the H2 norm.
    simulated : float
        On counts of the encoder and noise drawn for the torque: an independent check of `total`.
    """

    lag: float
    noise: float
    simulated: float

    @property
    def total(self) -> float:
        """lag and noise together."""
        return math.hypot(self.lag, self.noise)


@dataclass(frozen=True)
class TradeOff:
    """Errors over a setting: tau (s) of the filter, or the walk ((N*m)^2/s) of the Kalman filter.

    Attributes
    ----------
    settings : array, 1-D
    errors : tuple of ObserverErrors
        At the settings.
    best : float
        The setting with the least total error, between the first and last of `settings`, in their unit.
    at_best : ObserverErrors
    """

    settings: Floats
    errors: tuple[ObserverErrors, ...]
    best: float
    at_best: ObserverErrors


def estimated(observer: AdhesionObserver, trial: Trial) -> Floats:
    """Ta_hat (N*m) with perfect sensors, at all times of a trial but the first; speed by difference of the angle."""
    speed = np.diff(trial.angle) / np.diff(trial.time)
    return observer.run(trial.time[1:], trial.brake_torque[1:], speed).adhesion_torque


def observer_errors(
    observer: AdhesionObserver, trial: Trial, encoder: Encoder, sensor: TorqueSensor, *, seed: int
) -> ObserverErrors:
    """Errors of one observer over a trial.

    Parameters
    ----------
    observer : AdhesionObserver
    trial : Trial
        The truth.
    encoder, sensor : Encoder, TorqueSensor
        What measures the wheel's speed and the brake torque.
    seed : int
        Of the torque's noise.
    """
    braked = trial.time[1:] >= trial.brake_time
    truth = trial.adhesion_torque[1:]
    seen = measured(trial, encoder, sensor, seed=seed)
    noisy = observer.run(seen.time, seen.torque, seen.omega).adhesion_torque
    return ObserverErrors(
        lag=_rms((estimated(observer, trial) - truth)[braked]),
        noise=noise_deviation(observer.sampled(trial.interval), encoder, sensor),
        simulated=_rms((noisy - truth)[braked]),
    )


def trade_off(
    make: Callable[[float], AdhesionObserver],
    settings: ArrayLike,
    trial: Trial,
    encoder: Encoder,
    sensor: TorqueSensor,
    *,
    seed: int,
) -> TradeOff:
    """Errors over a setting of the observer, and the best setting between its first and last value.

    Parameters
    ----------
    make : callable
        The observer for a setting.
    settings : array, 1-D
        > 0, growing: tau (s) of the filter, or the walk ((N*m)^2/s) of the Kalman filter.
    trial, encoder, sensor, seed
        As of `observer_errors`.
    """
    from scipy.optimize import minimize_scalar

    values = np.asarray(settings, dtype=float)

    def errors(setting: float) -> ObserverErrors:
        return observer_errors(make(setting), trial, encoder, sensor, seed=seed)

    found = minimize_scalar(
        lambda logarithm: errors(math.exp(logarithm)).total,
        bounds=(math.log(values[0]), math.log(values[-1])),
        method="bounded",
        options={"xatol": _LOG_TOLERANCE},
    )
    best = math.exp(found.x)
    return TradeOff(values, tuple(errors(float(value)) for value in values), best, errors(best))


def _rms(error: Floats) -> float:
    return float(np.sqrt(np.mean(error**2)))
