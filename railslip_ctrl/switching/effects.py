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
from .limit_cycle import LimitCycle, linear_limit_cycle, predict_limit_cycle
from .nonlinear_cycle import LINEAR_CHANGE, linearisation_change, nonlinear_limit_cycle
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
class RelayCycle:
    """The limit cycle for one K, with the load the law leaves out.

    Attributes
    ----------
    predicted, linear : LimitCycle
        Of the linearised loop: by describing function, and with every harmonic.
    linear_change : float
        Change of the wheel's response over the swing of `linear`; see `linearisation_change`.
    actual : LimitCycle or None
        Of the wheel with its adhesion curve; None where none stays between 0 and v: the wheel is lost.
    """

    predicted: LimitCycle
    linear: LimitCycle
    linear_change: float
    actual: LimitCycle | None

    @property
    def linear_holds(self) -> bool:
        """Whether the linearisation holds over the swing."""
        return self.linear_change <= LINEAR_CHANGE

    @property
    def period_error(self) -> float:
        """Describing function over actual, less 1; NaN where the wheel is lost."""
        return math.nan if self.actual is None else self.predicted.period / self.actual.period - 1

    @property
    def amplitude_error(self) -> float:
        """Of the amplitude of s: describing function over actual, less 1; NaN where the wheel is lost."""
        actual = self.actual
        return math.nan if actual is None else self.predicted.surface_amplitude / actual.surface_amplitude - 1


@dataclass(frozen=True)
class ActuatorEffect:
    """What lag and dead time do to the published law at one operating point.

    `cycles` holds one for each K compared; `unstable_ideal` and `unstable_actual` are the
    right-half-plane poles of the adaptive loop without and with actuator, the relay as a gain of 0.
    """

    loop: SurfaceLoop
    existence: SlidingExistence
    cycles: tuple[RelayCycle, ...]
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
        actual = self.cycles[0].actual
        return actual is not None and actual.sigma_range[1] < 2 * self.loop.plant.point.sigma

    @property
    def cycle_text(self) -> str:
        """The cycle with the gains' own K in words, with the slip's range."""
        cycle = self.cycles[0]
        actual, K, speed = cycle.actual, cycle.linear.K, self.loop.plant.point.speed
        if actual is None:
            return f"with K = {K:g} N*m no cycle keeps the slip velocity between 0 and v, so the wheel is lost"
        low, high = (sigma / speed for sigma in actual.sigma_range)
        held = "" if self.holds_the_wheel else ", beyond twice the reference"
        beyond = "" if cycle.linear_holds else f"; the linearised loop would say {cycle.linear.slip_amplitude:.4f}"
        return (
            f"K = {K:g} N*m cycles with {actual.period:.2f} s and a slip amplitude of {actual.slip_amplitude:.4f} "
            f"({low:.3f} to {high:.3f}{held}{beyond})"
        )

    @property
    def adaptation_hopeless(self) -> bool:
        """Whether the printed k is unstable at every relay gain."""
        return self.survivors.excursion == 0


def actuator_effect(loop: SurfaceLoop, *, slip_amplitude: float = 0.02) -> ActuatorEffect:
    """Analyse one loop; DomainError where its own K does not oscillate or does not carry the load."""
    relays = (loop.gains.K, *(K for K in COMPARED_RELAYS if K > loop.gains.K))
    return ActuatorEffect(
        loop=loop,
        existence=loop.sliding_existence(),
        cycles=_relay_cycles(loop, relays),
        ideal=ideal_adaptation(loop),
        unstable_ideal=adaptive_unstable_poles(without_actuator(loop)),
        unstable_actual=adaptive_unstable_poles(loop),
        survivors=survivors(loop, slip_amplitude=slip_amplitude),
    )


def _relay_cycles(loop: SurfaceLoop, relays: Sequence[float]) -> tuple[RelayCycle, ...]:
    """For relays in ascending order: where one loses the wheel a higher one does."""
    cycles: list[RelayCycle] = []
    for K in relays:
        linear = linear_limit_cycle(loop, K=K, load=loop.load)
        lost = bool(cycles) and cycles[-1].actual is None
        actual = None if lost else nonlinear_limit_cycle(loop, K=K)
        predicted = predict_limit_cycle(loop, K=K, load=loop.load)
        cycles.append(RelayCycle(predicted, linear, linearisation_change(loop, linear), actual))
    return tuple(cycles)


def cycle_table(effects: Sequence[ActuatorEffect]) -> str:
    """Limit cycles as text, for each K: the wheel's, then the linearised loop's and the describing function's error."""
    lines = [
        f"{'case':28} {'K':>5} {'period s':>9} {'s m/s':>7} {'slip':>7} {'torque N*m':>10} "
        f"{'lin. T':>7} {'lin. slip':>10} {'DF T':>6} {'DF s':>6}"
    ]
    for effect in effects:
        lines += [f"{effect.name:28} {cycle.linear.K:5.0f} {_row(cycle)}" for cycle in effect.cycles]
    return "\n".join(
        [
            *lines,
            "lost: no cycle that keeps the slip velocity between 0 and v; DF: describing function against the wheel.",
            f"*: beyond the linearisation: over the swing the wheel's response changes by over {LINEAR_CHANGE:.0%}, or "
            "the slip leaves the model.",
        ]
    )


def _row(cycle: RelayCycle) -> str:
    c, linear = cycle.actual, cycle.linear
    own = f"{'lost':>9} {'-':>7} {'-':>7} {'-':>10}"
    errors = f"{'-':>6} {'-':>6}"
    if c is not None:
        own = f"{c.period:9.3f} {c.surface_amplitude:7.3f} {c.slip_amplitude:7.4f} {c.torque_amplitude:10.1f}"
        errors = f"{100 * cycle.period_error:+5.1f}% {100 * cycle.amplitude_error:+5.1f}%"
    mark = " " if cycle.linear_holds else "*"
    return f"{own} {linear.period:7.3f} {linear.slip_amplitude:9.4f}{mark} {errors}"


def conclusion(effects: Sequence[ActuatorEffect]) -> str:
    """One paragraph for an engineer, from the numbers; DomainError without any effect to conclude from."""
    if not effects:
        raise DomainError("conclusion: no operating point was analysed; give at least one")
    first = effects[0]
    small = [cycle for effect in effects for cycle in effect.cycles if cycle.actual is not None and cycle.linear_holds]
    opening = (
        f"With the actuator no ideal sliding mode exists: {first.existence.reason}. What takes its place is a limit "
        f"cycle whose period depends little on K and whose amplitude grows with K{_accuracy(small)}."
    )
    return " ".join([opening, *(_of_case(effect) for effect in effects), _advice(effects)])


def _accuracy(cycles: Sequence[RelayCycle]) -> str:
    """How good the describing function is for cycles over which the linearisation holds; nothing of none."""
    if not cycles:
        return ""
    period = 100 * max(abs(cycle.period_error) for cycle in cycles)
    amplitude = 100 * max(abs(cycle.amplitude_error) for cycle in cycles)
    return (
        f" (describing function within {period:.1f} % of the period and {amplitude:.1f} % of the amplitude of s, where "
        "the swing is small enough for the linearisation)"
    )


def _of_case(effect: ActuatorEffect) -> str:
    left, k = effect.survivors, effect.loop.gains.k
    short = "" if effect.loop.load < left.K else f", less than the {effect.loop.load:.1f} N*m of travelling resistance"
    hint = "" if left.linear_change <= LINEAR_CHANGE else " (linearised beyond its range)"
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
        f"{effect.name}: {effect.cycle_text}; a slip amplitude of {left.slip_amplitude:g} allows K <= "
        f"{left.K:.1f} N*m{hint}{short}, a boundary layer must be at least {left.layer:.3f} m/s wide at K = "
        f"{effect.loop.gains.K:g} N*m; "
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
