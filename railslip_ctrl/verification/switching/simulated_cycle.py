"""The wheel behind the published law as it is simulated: the relay's cycle on both sides of 0, and the whole law.

Slip below 0 is a wheel that the brake has released and that runs ahead; the adhesion laws are odd in it. A wheel is
lost where it locks or leaves its adhesion law's domain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.core.units import KMH

from .limit_cycle import LimitCycle
from .simulate import Run, simulate, whole_periods
from .stepped import PublishedLaw
from .surface_loop import SurfaceLoop

_SETTLING, _MEASURED = 30.0, 20.0  # s, times the inertia scale: some 8 and 5 periods
_STEP = 2e-3  # s: the instant of a switch is good to a two-thousandth of a period of 4 s
_LAW_STEP = 5e-3  # s: extremes of the slip only
_OFFSET = 0.05  # of the reference, where the runs of the whole law start above it
_FROZEN = 60.0  # s, times the inertia scale
_STOP = 60.0  # s, times the inertia scale: longer than any stop
END_SPEED = 5.0 * KMH
"""m/s, where a stop ends ([Park2008] p. 56)."""


def simulated_limit_cycle(loop: SurfaceLoop, *, K: float | None = None) -> LimitCycle | None:
    """The cycle measured in a fine simulation, adaptation off, speed frozen; None where the wheel is lost.

    Parameters
    ----------
    loop : SurfaceLoop
        The load is the vehicle's own.
    K : float, optional
        Height of the relay, N*m; left out, the gains' own.

    Raises
    ------
    DomainError
        s does not cycle.
    """
    height, point = loop.gains.K if K is None else K, loop.plant.point
    law = PublishedLaw(point, replace(loop.gains, K=height, k=0.0), feed_forward=loop.feed_forward)
    scale = point.vehicle.inertia_scale
    duration = (_SETTLING + _MEASURED) * scale
    try:
        run = simulate(point, law, loop.actuator, duration=duration, step=_STEP, offset=_OFFSET * point.sigma)
    except DomainError:
        return None
    period, run = whole_periods(run.after(_SETTLING * scale))
    turn = np.exp(-2j * math.pi / period * run.time)
    gain = abs(np.sum(height * np.sign(run.surface) * turn) / np.sum(run.surface * turn))
    swing = 0.5 * float(np.ptp(run.sigma))
    return LimitCycle(
        method="simulated",
        K=height,
        load=loop.load,
        layer=0.0,
        frequency=2 * math.pi / period,
        relay_gain=float(gain),
        surface_amplitude=0.5 * float(np.ptp(run.surface)),
        sigma_amplitude=swing,
        torque_amplitude=0.5 * float(np.ptp(run.torque)),
        surface_mean=float(run.surface.mean()),
        slip_amplitude=swing / point.speed,
        sigma_range=(float(run.sigma.min()), float(run.sigma.max())),
        stable=True,
    )


@dataclass(frozen=True)
class LawRun:
    """The slip in a run of the whole law: its range, and where the wheel was lost (a sentence; None: it was not).

    `spared`: the slip stayed between 0 and twice the reference. Ranges of a lost wheel are NaN.
    """

    name: str
    slip_range: tuple[float, float]
    lost: str | None
    spared: bool

    @property
    def text(self) -> str:
        """In words."""
        if self.lost is not None:
            return f"{self.name}: {self.lost.removeprefix('simulation: ')}"
        low, high = self.slip_range
        released = ", released" if low <= 0.0 else ""
        return f"{self.name}: slip {low:.3f} to {high:.3f}{released}"


def law_runs(loop: SurfaceLoop) -> tuple[LawRun, LawRun]:
    """The law with relay, adaptation and actuator, from 5 % above the reference, undisturbed and with known parameters.

    At the loop's speed, frozen, for 60 s times the inertia scale; and with the speed falling from it to 5 km/h.
    """
    return _law_run(loop, frozen=True), _law_run(loop, frozen=False)


def _law_run(loop: SurfaceLoop, *, frozen: bool) -> LawRun:
    point = loop.plant.point
    name = f"{point.speed / KMH:.3g} km/h frozen" if frozen else "speed falling"
    law = PublishedLaw(point, loop.gains, feed_forward=loop.feed_forward, frozen=frozen)
    duration = (_FROZEN if frozen else _STOP) * point.vehicle.inertia_scale
    try:
        run = simulate(
            point,
            law,
            loop.actuator,
            duration=duration,
            step=_LAW_STEP,
            offset=_OFFSET * point.sigma,
            frozen=frozen,
            end_speed=END_SPEED,
        )
    except DomainError as error:
        return LawRun(name, (math.nan, math.nan), str(error), False)
    low, high = slip_range(run)
    return LawRun(name, (low, high), None, low > 0.0 and high < 2.0 * point.slip)


def slip_range(run: Run) -> tuple[float, float]:
    """Least and largest slip ratio of a run."""
    slip = run.sigma / run.speed
    return float(slip.min()), float(slip.max())
