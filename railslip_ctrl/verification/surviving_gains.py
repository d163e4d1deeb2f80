"""The adaptive law about s = 0, and gains that survive the actuator: one at a time, and together at many points.

theta_hat' = k s phi ([Park2008] (49)) with a constant regressor phi adds (J/r) w int s dt to the torque, with
w = k (Ta^2 + 12.96 omega^2) in SI (published k, units of `relay_loop`). With an ideal actuator and exact feed-forward
s'' + (r/J) D s' + w s = 0: an oscillator that only D damps. With the actuator the integral path costs phase the loop
does not have. The relay enters as a gain N: 0 for excursions far above its height, larger for smaller ones.

A largest K/layer found with k = 0 and a largest k found without relay are not advice: used together they may be
unstable. `joint_advice` bounds the relay gain over all points at once, takes half of it, and bounds k with that half.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from railslip_ctrl.core.errors import InputError, UnstableLoopError
from railslip_ctrl.model.vehicle import (
    Actuator,
)

from .limit_cycles import critical_gains, largest_relay_gain, linear_limit_cycle, linearisation_change
from .relay_loop import (
    SurfaceLoop,
)

_RATIO = 1.2  # steps in which a gain is raised until the loop is lost; the limit is then bisected
_STEPS = 76  # up to a factor of 1e6, beyond which a limit is none
_TOLERANCE = 1e-9  # relative, of the bisection: far above the rounding of the root count
_FIRST = 1e-4  # 1/s^2, the adaptation's k |phi|^2 tried first: an oscillation with a period of 10 minutes
_RELAY_SAMPLES = 11  # relay gains tried between 0 and the limit cycle's, for the most favourable


def without_actuator(loop: SurfaceLoop) -> SurfaceLoop:
    """The same loop with an ideal actuator."""
    return replace(loop, actuator=Actuator(dead_time=0.0, lag=0.0))


def adaptive_unstable_poles(loop: SurfaceLoop, *, relay_gain: float = 0.0) -> float:
    """Poles in the closed right half plane of the loop with its adaptation k, exactly counted."""
    return loop.linear_loop(relay_gain=relay_gain, adaptation=loop.gains.k).unstable_closed_loop_poles


def first_limit(stable: Callable[[float], bool], start: float) -> float:
    """Smallest value above `start` (> 0) at which `stable` is lost, bisected to 1e-9; inf beyond 1e6 start.

    Raised in steps of 20 %: an unstable interval narrower than that may be passed over. InputError for a start that is
    not positive, UnstableLoopError where the loop is not stable there.
    """
    if not (math.isfinite(start) and start > 0):
        raise InputError(f"start: {start} is not allowed; give a finite value > 0")
    if not stable(start):
        raise UnstableLoopError(
            f"largest gain: the loop is unstable at {start:.6g}, where the search starts; start where it is stable",
            unstable_poles=math.nan,
            stabilizing_gain_range=None,
        )
    low = start
    for _ in range(_STEPS):
        high = low * _RATIO
        if not stable(high):
            break
        low = high
    else:
        return math.inf
    while high - low > _TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def largest_adaptation(loop: SurfaceLoop, *, relay_gain: float = 0.0) -> float:
    """Largest k (as printed, see `SlidingGains`) with which the linear loop is stable; inf without bound, 0 where it is
    unstable without adaptation. `relay_gain` stands for the relay, N*m/(m/s), >= 0.
    """
    start = _FIRST / loop.regressor_power
    if not loop.is_stable(relay_gain=relay_gain, adaptation=start):
        return 0.0
    return first_limit(lambda k: loop.is_stable(relay_gain=relay_gain, adaptation=k), start)


def survivable_excursion(loop: SurfaceLoop) -> float:
    """Amplitude of s, m/s, up to which the adaptive loop with its relay comes back, by the describing function.

    inf where the linear loop with its k is stable without the relay's help; 0 where no relay gain (sampled) helps.
    """
    k = loop.gains.k
    if loop.is_stable(adaptation=k):
        return math.inf
    top = max((c.gain for c in critical_gains(loop) if c.stable_below), default=0.0)
    tried: list[float] = np.linspace(0.0, top, _RELAY_SAMPLES).tolist()
    helped = [n for n in tried if loop.is_stable(relay_gain=n, adaptation=k)]
    if not helped:
        return 0.0
    low, high = 0.0, helped[0]
    while high - low > _TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if loop.is_stable(relay_gain=middle, adaptation=k) else (middle, high)
    return 4 * loop.gains.K / (math.pi * high)


def largest_relay(loop: SurfaceLoop, slip_amplitude: float) -> float:
    """Largest K, N*m, whose linearised limit cycle without load stays within a slip amplitude (half of the slip's
    swing, a ratio, > 0, else InputError); a load makes it smaller. DomainError where the relay does not oscillate.
    """
    if not (math.isfinite(slip_amplitude) and slip_amplitude > 0):
        raise InputError(f"slip amplitude: {slip_amplitude} is not allowed; give a finite value > 0")
    return slip_amplitude / linear_limit_cycle(loop, K=1.0).slip_amplitude


@dataclass(frozen=True)
class Survivors:
    """The largest gains that survive the actuator, each with the others as they are and the relay as a gain of 0.

    stable: whether the linear part (rho, D, feed-forward) is stable at all; if not, the largest gains are 0. k:
    largest k. K: largest, N*m, for
    a limit cycle within slip_amplitude, linearised; 0 where no K gives a stable cycle, inf where none oscillates.
    linear_change: `linearisation_change` over that amplitude; beyond `LINEAR_CHANGE` the K is no more than a hint. rho,
    D: 1/s, N*m/(m/s); inf without bound. relay_gain: largest that may replace the relay, N*m/(m/s). layer: smallest
    without limit cycle at the gains' own K, m/s; inf where there is none. excursion: see `survivable_excursion`, m/s.
    """

    stable: bool
    k: float
    K: float
    slip_amplitude: float
    linear_change: float
    rho: float
    D: float
    relay_gain: float
    layer: float
    excursion: float


def survivors(loop: SurfaceLoop, *, slip_amplitude: float = 0.02) -> Survivors:
    """Bisect each gain on exact stability; K by the linearised limit cycle within a slip amplitude."""
    gains = loop.gains
    stable = loop.is_stable()
    gain = largest_relay_gain(loop)
    # without a finite gain at which it starts there is no cycle: nothing to bound, or nothing that is stable
    relay = largest_relay(loop, slip_amplitude) if 0.0 < gain < math.inf else gain
    finite = 0.0 < relay < math.inf
    return Survivors(
        stable=stable,
        k=largest_adaptation(loop),
        K=relay,
        slip_amplitude=slip_amplitude,
        linear_change=linearisation_change(loop, linear_limit_cycle(loop, K=relay)) if finite else 0.0,
        rho=first_limit(lambda rho: loop.with_gains(rho=rho).is_stable(), gains.rho) if stable else 0.0,
        D=first_limit(lambda D: loop.with_gains(D=D).is_stable(), gains.D) if stable else 0.0,
        relay_gain=gain,
        layer=gains.K / gain if gain > 0 else math.inf,
        excursion=survivable_excursion(loop),
    )


# --- gains that were checked together ---------------------------------------------------------------------------------


MARGIN = 0.5
"""Share of a joint limit that is advised."""

FIT_MS = 2.0
"""Largest sensitivity peak with which a loop is called fit for service, as of the design checks."""

_NAMED = 3  # unstable points named in a sentence
_FIRST_K = 1e-4  # 1/s^2 of k |phi|^2 the search starts with: an oscillation with a period of 10 minutes
_LARGEST_K = 1.0  # 1/s^2: a period of 6 s, that of the loop itself
_LEAST_D = 0.1  # N*m/(m/s): nothing beside (J/r) rho
_JOINT_TOLERANCE = 1e-3  # relative, of the bisections: far below the margin taken


@dataclass(frozen=True)
class JointAdvice:
    """Gains decided together over `points` operating points.

    unstable: points that are unstable without relay and adaptation; with any, the gains below are 0. relay_limit,
    relay_gain: largest K/layer, N*m/(m/s), that all points bear with k = 0; the advised one. k_limit, k: largest k, as
    printed, that all points bear with `relay_gain`, and the advised one. ms, ms_with_k, ms_without: largest sensitivity
    peak over the points with `relay_gain`, with `k` too, and with neither; inf where unstable. worst: the point of
    `ms`. D_limit: largest D, N*m/(m/s), with which no point is unstable; 0 where there is none, NaN where none is
    unstable.
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
    """Decide K/layer and k together for loops of one law, by the names of their points."""
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
        while limit - below > _JOINT_TOLERANCE * limit:
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
