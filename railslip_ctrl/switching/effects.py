"""What the actuator does to the sliding-mode proof, in records, a table and one paragraph made from their numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from railslip_ctrl.adhesion import published_law
from railslip_ctrl.adhesion.bristle import Bristle
from railslip_ctrl.errors import DomainError, InputError
from railslip_ctrl.linearization import linearize, operating_point
from railslip_ctrl.parameters import PARK2008, Rail, Vehicle
from railslip_ctrl.units import KMH

from .adaptation import (
    IdealAdaptation,
    Survivors,
    adaptive_unstable_poles,
    ideal_adaptation,
    survivors,
    without_actuator,
)
from .law import TABLE4_SLIDING, FeedForward, SlidingGains
from .limit_cycle import LimitCycle, exact_limit_cycle, predict_limit_cycle
from .surface_loop import SlidingExistence, SurfaceLoop

COMPARED_RELAYS = (70.0, 200.0, 400.0)
"""K, N*m: Table 4's, and what it takes to carry disturbances of the size the paper simulates."""


def published_loop(
    rail: Rail,
    *,
    inertia_scale: float = 1.0,
    adhesion: str = "bristle",
    speed: float = 100 * KMH,
    vehicle: Vehicle = PARK2008,
    gains: SlidingGains | None = None,
    feed_forward: FeedForward = FeedForward.MODEL,
) -> SurfaceLoop:
    """The published law's loop on a rail at a speed (m/s), at the law's reference slip.

    `inertia_scale` multiplies M, J, B and, as a change of units demands, the stiffness of the dynamic bristle model.
    Gains are Table 4's of the bristle column (beam for the beam law) unless given.
    """
    scaled = vehicle.model_copy(update={"inertia_scale": inertia_scale})
    law = published_law(adhesion, rail, wheel_load=vehicle.wheel_load)
    if isinstance(law, Bristle):
        law = law.model_copy(update={"alpha": inertia_scale * law.alpha})
    slip = law.reference_slip(rail)
    if slip is None:
        raise InputError(f"adhesion: {adhesion!r} has no reference slip; choose bristle, curve or beam")
    column = TABLE4_SLIDING["beam" if law.name == "beam" else "bristle"]
    plant = linearize(operating_point(law, scaled, speed, slip, rail=rail))
    return SurfaceLoop(plant, gains or column, scaled.actuator, feed_forward)


@dataclass(frozen=True)
class CyclePair:
    """The limit cycle by describing function and exactly, for one K; both with the load the law leaves out."""

    predicted: LimitCycle
    exact: LimitCycle

    @property
    def period_error(self) -> float:
        """Describing function over exact, less 1."""
        return self.predicted.period / self.exact.period - 1

    @property
    def amplitude_error(self) -> float:
        """Of the amplitude of s: describing function over exact, less 1."""
        return self.predicted.surface_amplitude / self.exact.surface_amplitude - 1


@dataclass(frozen=True)
class ActuatorEffect:
    """What lag and dead time do to the published law at one operating point.

    `cycles` holds a pair for each K compared that carries the load; `unstable_ideal` and `unstable_actual` are the
    right-half-plane poles of the adaptive loop without and with actuator, the relay as a gain of 0.
    """

    loop: SurfaceLoop
    existence: SlidingExistence
    cycles: tuple[CyclePair, ...]
    ideal: IdealAdaptation
    unstable_ideal: float
    unstable_actual: float
    survivors: Survivors

    @property
    def name(self) -> str:
        """For tables: adhesion, rail and inertia scale."""
        point = self.loop.plant.point
        return f"{point.adhesion} {point.rail.value}, inertia x {point.vehicle.inertia_scale:g}"

    @property
    def holds_the_wheel(self) -> bool:
        """Whether the cycle with the gains' own K keeps the slip between 0 and twice the reference."""
        return self.cycles[0].exact.sigma_amplitude < self.loop.plant.point.sigma

    @property
    def adaptation_hopeless(self) -> bool:
        """Whether the printed k is unstable at every relay gain."""
        return self.survivors.excursion == 0


def actuator_effect(loop: SurfaceLoop, *, slip_amplitude: float = 0.02) -> ActuatorEffect:
    """Analyse one loop; DomainError where its own K does not oscillate or does not carry the load."""
    relays = (loop.gains.K, *(K for K in COMPARED_RELAYS if K > loop.gains.K))
    pairs = tuple(
        CyclePair(predict_limit_cycle(loop, K=K, load=loop.load), exact_limit_cycle(loop, K=K, load=loop.load))
        for K in relays
    )
    return ActuatorEffect(
        loop=loop,
        existence=loop.sliding_existence(),
        cycles=pairs,
        ideal=ideal_adaptation(loop),
        unstable_ideal=adaptive_unstable_poles(without_actuator(loop)),
        unstable_actual=adaptive_unstable_poles(loop),
        survivors=survivors(loop, slip_amplitude=slip_amplitude),
    )


def cycle_table(effects: Sequence[ActuatorEffect]) -> str:
    """Limit cycles as text: K, period and amplitudes, exact, with the describing function's deviation.

    "lost" marks a cycle larger than the slip itself: the linear wheel's, which the real one does not live to see.
    """
    lines = [
        f"{'case':28} {'K':>5} {'period s':>9} {'s m/s':>7} {'slip':>7} {'torque N*m':>10} {'DF T':>6} {'DF s':>6}"
    ]
    for effect in effects:
        for pair in effect.cycles:
            c = pair.exact
            lost = "" if c.sigma_amplitude < effect.loop.plant.point.sigma else "  lost"
            lines.append(
                f"{effect.name:28} {c.K:5.0f} {c.period:9.3f} {c.surface_amplitude:7.3f} {c.slip_amplitude:7.4f} "
                f"{c.torque_amplitude:10.1f} {100 * pair.period_error:+5.1f}% {100 * pair.amplitude_error:+5.1f}%{lost}"
            )
    return "\n".join(lines)


def conclusion(effects: Sequence[ActuatorEffect]) -> str:
    """One paragraph for an engineer, from the numbers; DomainError without any effect to conclude from."""
    if not effects:
        raise DomainError("conclusion: no operating point was analysed; give at least one")
    first = effects[0]
    deviation = max(abs(pair.period_error) for effect in effects for pair in effect.cycles)
    opening = (
        f"With the actuator no ideal sliding mode exists: {first.existence.reason}. What takes its place is a limit "
        "cycle whose period hardly depends on K and whose amplitude grows with K (describing function "
        f"within {100 * deviation:.1f} % of the exact period)."
    )
    return " ".join([opening, *(_of_case(effect) for effect in effects), _advice(effects)])


def _of_case(effect: ActuatorEffect) -> str:
    cycle, left, k = effect.cycles[0].exact, effect.survivors, effect.loop.gains.k
    short = "" if effect.loop.load < left.K else f", less than the {effect.loop.load:.1f} N*m of travelling resistance"
    held = "" if effect.holds_the_wheel else ", as large as the slip itself, so the wheel is not held"
    if k == 0:
        adaptation = f"adaptation would be stable up to k = {left.k:.3g}"
    elif effect.adaptation_hopeless:
        adaptation = (
            f"the adaptation with k = {k:.3g} is unstable whatever the relay does ({effect.unstable_actual:.0f} poles; "
            f"ideal actuator: {effect.unstable_ideal:.0f}), k <= {left.k:.3g} survives"
        )
    elif effect.unstable_actual:
        adaptation = (
            f"the adaptation with k = {k:.3g} is unstable once s exceeds {left.excursion:.2g} m/s, for then the relay "
            f"is too small to damp it; k <= {left.k:.3g} survives"
        )
    else:
        adaptation = f"k = {k:.3g} is stable, {left.k / k:.2f} times as much is not"
    return (
        f"{effect.name}: K = {cycle.K:g} N*m cycles with {cycle.period:.2f} s and a slip amplitude of "
        f"{cycle.slip_amplitude:.4f}{held}; a slip amplitude of {left.slip_amplitude:g} allows K <= {left.K:.1f} N*m"
        f"{short}, a boundary layer must be at least {left.layer:.3f} m/s wide at K = {cycle.K:g} N*m; "
        f"rho <= {left.rho:.3g} 1/s and D <= {left.D:.4g} N*m/(m/s) keep the linear part stable; {adaptation}."
    )


def _advice(effects: Sequence[ActuatorEffect]) -> str:
    gain = min(e.survivors.relay_gain for e in effects)
    k = min(e.survivors.k for e in effects)
    text = f"So: replace the relay by a boundary layer with K/layer below {gain:.1f} N*m/(m/s)"
    slope = f"with half of it as a margin ({0.5 * gain:.1f})" if math.isfinite(gain) else "without upper bound"
    return (
        f"{text}, {slope}; keep k below {k:.2g} or, since theta steps when rail or load change, switch the adaptation "
        "off; and take robustness from a lead on the actuator's lag, not from a larger K: within a layer so designed "
        "the bound follows from the linear loop."
    )
