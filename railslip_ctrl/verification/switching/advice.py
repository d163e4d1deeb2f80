"""Gains for the published structure behind its actuator that were checked together, at many operating points.

A largest K/layer found with k = 0 and a largest k found without relay are not advice: used together they may be
unstable. Here the relay gain is bounded over all points at once, half of it is taken, and k is bounded with that half
in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from .limit_cycle import largest_relay_gain
from .surface_loop import SurfaceLoop

MARGIN = 0.5
"""Share of a joint limit that is advised."""

FIT_MS = 2.0
"""Largest sensitivity peak with which a loop is called fit for service, as of the design checks."""

_NAMED = 3  # unstable points named in a sentence
_FIRST_K = 1e-4  # 1/s^2 of k |phi|^2 the search starts with: an oscillation with a period of 10 minutes
_LARGEST_K = 1.0  # 1/s^2: a period of 6 s, that of the loop itself
_LEAST_D = 0.1  # N*m/(m/s): nothing beside (J/r) rho
_TOLERANCE = 1e-3  # relative, of the bisections: far below the margin taken


@dataclass(frozen=True)
class JointAdvice:
    """Gains decided together.

    Attributes
    ----------
    points : int
        Operating points looked at.
    unstable : tuple of str
        Points that are unstable without relay and adaptation: with any, the gains below are 0.
    relay_limit, relay_gain : float
        Largest K/layer, N*m/(m/s), that all points bear with k = 0; the advised one.
    k_limit, k : float
        Largest k, as printed, that all points bear with `relay_gain`, and the advised one.
    ms, ms_with_k, ms_without : float
        Largest sensitivity peak, a ratio, over the points with `relay_gain`, with `k` too, and with neither; inf where
        unstable.
    worst : str
        The point of `ms`.
    D_limit : float
        Largest D, N*m/(m/s), with which no point is unstable; 0 where there is none. NaN where none is unstable.
    """

    points: int
    unstable: tuple[str, ...]
    relay_limit: float
    relay_gain: float
    k_limit: float
    k: float
    ms: float
    ms_with_k: float
    ms_without: float
    worst: str
    D_limit: float

    @property
    def fit(self) -> bool:
        """Whether the loop so advised has the margins of one fit for service."""
        return self.ms <= FIT_MS


def joint_advice(loops: Mapping[str, SurfaceLoop]) -> JointAdvice:
    """Decide K/layer and k together; D and rho stay as they are.

    Parameters
    ----------
    loops : mapping
        Loops of the same law by their names: the operating points.
    """
    unstable = tuple(name for name, loop in loops.items() if not loop.is_stable())
    every = list(loops.values())
    if unstable:
        limit = _joint_limit(every, lambda loop, D: loop.with_gains(D=D).is_stable(), _LEAST_D, every[0].gains.D)
        return JointAdvice(len(every), unstable, 0.0, 0.0, 0.0, 0.0, *3 * (math.inf,), unstable[0], limit)
    relay_limit = min(largest_relay_gain(loop) for loop in every)
    # without a bound no layer is needed for stability: the relay's place is then taken by D alone
    gain = MARGIN * relay_limit if relay_limit < math.inf else 0.0
    power = max(loop.regressor_power for loop in every)
    k_limit = _joint_limit(
        every,
        lambda loop, k: loop.is_stable(relay_gain=gain, adaptation=k),
        _FIRST_K / power,
        _LARGEST_K / min(loop.regressor_power for loop in every),
    )
    peaks = {name: _peak(loop, gain, 0.0) for name, loop in loops.items()}
    worst = max(peaks, key=lambda name: peaks[name])
    k = MARGIN * k_limit
    with_k, without = (max(_peak(loop, *gains) for loop in every) for gains in ((gain, k), (0.0, 0.0)))
    return JointAdvice(len(every), (), relay_limit, gain, k_limit, k, peaks[worst], with_k, without, worst, math.nan)


def _joint_limit(
    loops: list[SurfaceLoop], stable: Callable[[SurfaceLoop, float], bool], low: float, high: float
) -> float:
    """Largest value up to `high` that every loop bears, bisected; 0 where one does not bear `low`."""
    limit = high
    for loop in loops:
        if stable(loop, limit):
            continue
        if not stable(loop, low):
            return 0.0
        below = low
        while limit - below > _TOLERANCE * limit:
            middle = 0.5 * (below + limit)
            below, limit = (middle, limit) if stable(loop, middle) else (below, middle)
        limit = below
    return limit


def _peak(loop: SurfaceLoop, relay_gain: float, k: float) -> float:
    """Ms; inf where the loop is unstable."""
    linear = loop.linear_loop(relay_gain=relay_gain, adaptation=k)
    return linear.margins().ms if linear.is_stable() else math.inf


def advice_text(advice: JointAdvice, points: str) -> str:
    """What to do with the published structure, from gains that were checked together."""
    layered = (
        "If it is to be a sliding-mode law, use the layered one with a lead on the actuator's lag: "
        "`railslip verify --law layered` gives its gains and decides its conditions."
    )
    if advice.unstable:
        named = "; ".join(advice.unstable[:_NAMED]) + (" and others" if len(advice.unstable) > _NAMED else "")
        remedy = (
            f"D <= {0.5 * advice.D_limit:.3g} N*m/(m/s), half of the joint limit {advice.D_limit:.4g}, would be stable "
            "at all of them; ask again with it. "
            if advice.D_limit > 0
            else "No smaller D mends it at this rho. "
        )
        return (
            f"So, over {advice.points} points together ({points}): do not use these gains. D and rho alone are "
            f"unstable at {len(advice.unstable)} of them ({named}), and no layer and no k makes up for it. "
            f"{remedy}{layered}"
        )
    slope = (
        f"K/layer = {advice.relay_gain:.3g} N*m/(m/s), half of the joint limit {advice.relay_limit:.3g},"
        if advice.relay_limit < math.inf
        else "a layer of any width"
    )
    adaptation = (
        f"with it k <= {advice.k:.2g}, half of what all points bear beside that layer, is stable too (largest Ms "
        f"{advice.ms_with_k:.1f})"
        if advice.k > 0
        else "no k is stable beside it"
    )
    verdict = (
        "Fit for service."
        if advice.fit
        else f"That is stable, but not fit for service (Ms <= {FIT_MS:g} is); a smaller K/layer helps little. {layered}"
    )
    return (
        f"So, over {advice.points} points together ({points}): if the published structure has to stay, switch the "
        "adaptation off (k = 0; theta steps when rail or load change) and replace the relay by a boundary layer with "
        f"{slope} which is stable at every point, largest Ms {advice.ms:.1f} ({advice.worst}; {advice.ms_without:.1f} "
        f"without any relay); {adaptation}. {verdict}"
    )
