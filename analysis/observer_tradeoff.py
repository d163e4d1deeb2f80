"""How fast may an adhesion-torque observer be, which error does the printed one have, and is a Kalman filter better?

The script compares the observer of [Park2008] (27) as printed, the same observer with every term filtered, and a Kalman
filter. The test is a brake application as in Fig. 12: the torque rises until the slip exceeds 50 %, and is then
released. Encoder and torque sensor are assumptions, because the paper does not name any. For every setting the script
computes the error from lag and the error from noise. It finds the setting with the smallest total error, also for other
sampling intervals.

    python analysis/observer_tradeoff.py [FOLDER for the pictures]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.identification.observer import (
    Encoder,
    FilterObserver,
    Form,
    KalmanObserver,
    ObserverResponses,
    TorqueObserver,
    TorqueSensor,
    adhesion_coefficient,
    noise_deviation,
    observer_responses,
)
from railslip_ctrl.identification.virtual_rig import (
    BrakeCourse,
    BrakeTrial,
    brake_trial,
    measured,
)
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.vehicle import PARK2008, Rail
from railslip_ctrl.paper import printed
from railslip_ctrl.paper.errata import corrected_observer, passed_at_once

if TYPE_CHECKING:  # only the figures need Matplotlib
    from matplotlib.figure import Figure

VEHICLE = PARK2008
INITIAL_SPEED_KMH = 140.0  # Fig. 12
COURSE = BrakeCourse()
LAW = "beam"  # the bristle model has no damping and oscillates after the release, which would distort the errors
ENCODER = Encoder(counts=4096)  # 1024 lines on each of two tracks
SENSOR = TorqueSensor(noise=50.0, resolution=5.0)  # N*m
INTERVAL = 5e-3  # s, sampling interval
INTERVALS = (1e-3, 2e-3, 5e-3, 10e-3, 20e-3)  # s
TAUS = np.geomspace(4e-3, 0.5, 25)  # s, time constants of the filter
WALKS = np.geomspace(1e4, 1e9, 25)  # (N*m)^2/s, intensities of the random walk of Ta
OMEGA = np.geomspace(0.1, 600, 300)  # rad/s, up to pi/INTERVAL
SEED = 2008
NAMES = ("printed (27)", "corrected", "Kalman filter")
LABELS = dict(zip(NAMES, ("τ (s)", "τ (s)", "random walk of Ta ((N·m)²/s)"), strict=True))


# --- lag against noise -----------------------------------------------------------------------------------------------


_LOG_TOLERANCE = 1e-4  # tolerance of the logarithm of the best setting; the error is flat at its minimum


@dataclass(frozen=True)
class ObserverErrors:
    """Root mean square errors of Ta_hat in a trial, N*m, from the time at which the brake is applied.

    Before this time the observer settles. `lag` is the error with perfect sensors. `noise` is the error that the
    sensors add, from the H2 norm. `simulated` is the error with simulated encoder counts and torque noise, an
    independent check of `total`.
    """

    lag: float
    noise: float
    simulated: float

    @property
    def total(self) -> float:
        """Root of the sum of squares of lag and noise, N*m."""
        return math.hypot(self.lag, self.noise)


@dataclass(frozen=True)
class TradeOff:
    """Errors over a setting of an observer: tau (s) of a filter, or the walk ((N*m)^2/s) of the Kalman filter.

    `errors` are those at the `settings`, 1-D. `best` is the setting of smallest total error, with errors `at_best`.
    """

    settings: Floats
    errors: tuple[ObserverErrors, ...]
    best: float
    at_best: ObserverErrors


def estimated(observer: TorqueObserver, trial: BrakeTrial) -> Floats:
    """Return Ta_hat (N*m) with perfect sensors, whose speed is a difference of angles, at all times but the first."""
    speed = np.diff(trial.angle) / np.diff(trial.time)
    return observer.run(trial.time[1:], trial.brake_torque[1:], speed).adhesion_torque


def observer_errors(
    observer: TorqueObserver, trial: BrakeTrial, encoder: Encoder, sensor: TorqueSensor, *, seed: int
) -> ObserverErrors:
    """Return the errors of an `observer` in a `trial` with `encoder` and `sensor`; `seed` sets the torque noise."""
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
    make: Callable[[float], TorqueObserver],
    settings: ArrayLike,
    trial: BrakeTrial,
    encoder: Encoder,
    sensor: TorqueSensor,
    *,
    seed: int,
) -> TradeOff:
    """Return the errors over a setting of an observer, and the best setting between the first and the last.

    `make` returns the observer for a setting. `settings`, s or (N*m)^2/s, 1-D, are > 0 and rise. `trial`, `encoder`,
    `sensor` and `seed` are those of `observer_errors`.
    """
    from scipy.optimize import minimize_scalar

    values = np.asarray(settings, dtype=float)

    def errors(setting: float) -> ObserverErrors:
        return observer_errors(make(setting), trial, encoder, sensor, seed=seed)

    minimum = minimize_scalar(
        lambda logarithm: errors(math.exp(logarithm)).total,
        bounds=(math.log(values[0]), math.log(values[-1])),
        method="bounded",
        options={"xatol": _LOG_TOLERANCE},
    )
    best = math.exp(minimum.x)
    return TradeOff(values, tuple(errors(float(value)) for value in values), best, errors(best))


def _rms(error: Floats) -> float:
    return float(np.sqrt(np.mean(error**2)))


# --- the comparison ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ObserverComparison:
    """Results by observer, in the order of `NAMES`.

    - passed_at_once: share of a step of the brake torque that appears in the estimate immediately, from the symbolic
      transfer function (filters only).
    - curves: errors over the setting, and the best setting.
    - estimates, errors: Ta_hat from noisy measurements at the best setting, and Ta_hat - Ta, N*m, at all times of the
      trial but the first.
    - responses: frequency responses at the best setting.
    - coefficient_errors: total rms error at the best setting as an adhesion coefficient.
    - by_interval: by sampling interval (s) and observer, the best setting and its total rms error (N*m).
    """

    trial: BrakeTrial
    passed_at_once: dict[str, float]
    curves: dict[str, TradeOff]
    estimates: dict[str, np.ndarray]
    errors: dict[str, np.ndarray]
    responses: dict[str, ObserverResponses]
    coefficient_errors: dict[str, float]
    by_interval: dict[float, dict[str, tuple[float, float]]]


def makers(interval: float) -> dict[str, Callable[[float], TorqueObserver]]:
    """Return the observers as functions of their setting: tau, or the intensity of the walk."""
    return {
        NAMES[0]: lambda tau: FilterObserver.of(VEHICLE, tau, Form.PRINTED),
        NAMES[1]: lambda tau: FilterObserver.of(VEHICLE, tau),
        NAMES[2]: lambda walk: KalmanObserver.of(
            VEHICLE, ENCODER, SENSOR, interval=interval, change=math.sqrt(walk), within=1.0
        ),
    }


def run() -> ObserverComparison:
    """Return the trial, the errors over the settings, and the best settings for all sampling intervals."""
    trial = trial_at(INTERVAL)
    make = makers(INTERVAL)
    curves = curves_at(trial, TAUS, WALKS)
    best = {name: make[name](curve.best) for name, curve in curves.items()}
    seen = measured(trial, ENCODER, SENSOR, seed=SEED)
    forms = {NAMES[0]: printed.observer, NAMES[1]: corrected_observer()}
    at_once = {name: float(passed_at_once(form)) for name, form in forms.items()}
    estimates = {n: o.run(seen.time, seen.torque, seen.omega).adhesion_torque for n, o in best.items()}
    ends = [np.array([values[0], values[-1]]) for values in (TAUS, WALKS)]
    return ObserverComparison(
        trial=trial,
        passed_at_once=at_once,
        curves=curves,
        estimates=estimates,
        errors={name: estimate - trial.adhesion_torque[1:] for name, estimate in estimates.items()},
        responses={name: observer_responses(observer, OMEGA) for name, observer in best.items()},
        coefficient_errors={
            name: float(adhesion_coefficient(curve.at_best.total, VEHICLE)) for name, curve in curves.items()
        },
        by_interval={
            interval: {
                name: (curve.best, curve.at_best.total)
                for name, curve in curves_at(trial_at(interval), ends[0], ends[1]).items()
            }
            for interval in INTERVALS
        },
    )


def trial_at(interval: float) -> BrakeTrial:
    """Return the brake application, sampled at an interval, s."""
    law = published_law(LAW, Rail.DRY, INITIAL_SPEED_KMH)
    return brake_trial(law, VEHICLE, INITIAL_SPEED_KMH / 3.6, interval=interval, course=COURSE)


def curves_at(trial: BrakeTrial, taus: np.ndarray, walks: np.ndarray) -> dict[str, TradeOff]:
    """Return the errors of each observer over its setting, for a trial."""
    return {
        name: trade_off(make, walks if name == NAMES[2] else taus, trial, ENCODER, SENSOR, seed=SEED)
        for name, make in makers(trial.interval).items()
    }


def main() -> None:
    """Print the tables; with a folder, draw the figures."""
    result = run()
    for name, share in result.passed_at_once.items():
        print(f"{name}: {100 * share:.0f} % of a step of the brake torque is in the estimate at once")
    print(f"\nBest settings at {1e3 * INTERVAL:g} ms; rms errors in N*m: lag, noise, both, simulated; both as mu")
    for name, curve in result.curves.items():
        e = curve.at_best
        errors = f"{e.lag:7.0f} {e.noise:7.0f} {e.total:7.0f} {e.simulated:7.0f}"
        print(f"  {name:14s} {LABELS[name]:30s} {curve.best:9.3g} {errors}   {result.coefficient_errors[name]:.4f}")
    print("\nBest setting and its rms error (N*m), by sampling interval")
    for interval, row in result.by_interval.items():
        cells = (f"{name}: {best:.3g}, {total:.0f}" for name, (best, total) in row.items())
        print(f"  {1e3 * interval:4.0f} ms   " + ";  ".join(cells))
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def tradeoff_figure(curves: Mapping[str, TradeOff], labels: Mapping[str, str], *, title: str) -> Figure:
    """Return a figure of the errors over each observer's setting; `labels` name the setting with its unit."""
    from railslip_ctrl.report.plots import style

    columns = min(len(curves), 3)
    figure, axes = style.grid_of(len(curves), columns, title, (1.0, 2.8), sharey=True)
    for ax, (name, curve) in zip(axes, curves.items(), strict=True):
        for i, (kind, label) in enumerate((("lag", "lag"), ("noise", "noise (H2 norm)"), ("total", "both"))):
            ax.loglog(curve.settings, [getattr(e, kind) for e in curve.errors], label=label, **style.line_style(i))
        simulated = [error.simulated for error in curve.errors]
        ax.loglog(curve.settings, simulated, "o", color="black", markersize=3.5, fillstyle="none", label="simulated")
        ax.axvline(curve.best, color="0.5", linewidth=0.8)
        ax.set_title(f"{name}:\nbest at {curve.best:.3g}: {curve.at_best.total:.0f} N·m", fontsize=style.TEXT)
        ax.set_xlabel(style.folded(labels[name], 0.9 * style.PAGE_WIDTH / columns))
    for ax in axes[::columns]:
        ax.set_ylabel("rms error of the adhesion torque (N·m)")
    style.legend_of_figure(figure, axes[0], columns=4)
    return figure


def draw(result: ObserverComparison, folder: Path) -> None:
    """Draw the errors over the settings, the estimates with the true torque, and the responses."""
    from railslip_ctrl.report.plots import estimates_figure, observer_responses_figure, save_figure

    folder.mkdir(parents=True, exist_ok=True)
    sensors = f"{ENCODER.counts} counts a turn, torque noise {SENSOR.noise:g} N·m, every {1e3 * INTERVAL:g} ms"
    about = f"{VEHICLE.name}, {LAW}, brake application from {INITIAL_SPEED_KMH:g} km/h\n{sensors}"
    figure = tradeoff_figure(result.curves, LABELS, title=f"Lag against noise. {about}")
    save_figure(figure, folder / "observer_tradeoff.png")
    figure = estimates_figure(
        result.trial,
        result.trial.time[1:],
        result.estimates,
        result.errors,
        title=f"Estimates, each at its best. {about}",
    )
    save_figure(figure, folder / "observer_estimates.png")
    figure = observer_responses_figure(result.responses, title=f"Observers at their best. {about}")
    save_figure(figure, folder / "observer_responses.png")


if __name__ == "__main__":
    main()
