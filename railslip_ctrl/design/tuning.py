"""PI gains from a specification, for one plant or many ([Astrom1998]); the search itself is in `tuning_search`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import checked, number, numbers
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.loop import DeadTimeLoop, Margins, Rational

from .families import Worst, family_margins, worst_of
from .specification import Specification
from .tuning_search import Family, largest_ki, least_ms, pi_transfer_function

__all__ = ["PIDesign", "Specification", "pi_for_crossover", "pi_transfer_function", "tune_pi"]


@dataclass(frozen=True)
class PIDesign:
    """Tuned gains, the margins of every plant with them, and the worst.

    kp in units of plant input per output, ki in that per second.
    """

    kp: float
    ki: float
    worst: Worst
    margins: tuple[Margins, ...]
    specification: Specification


@checked
def tune_pi(
    plants: Any,
    dead_time: float | Sequence[float] = 0.0,
    *,
    ms_max: float | None = None,
    phase_min_deg: float | None = None,
    delay_min_s: float | None = None,
    crossover: tuple[float, float] | None = None,
    minimise_ms: bool = False,
    ki_min: float | None = None,
    compensator: Any = None,
    names: Sequence[str] = (),
) -> PIDesign:
    """One PI, kp + ki/s, for all the plants.

    Parameters
    ----------
    plants : python-control system, `Rational`, or a sequence of them
        From controller output to controlled variable, without the dead time; negative feedback.
    dead_time : float or sequence
        s; one for all plants, or one each.
    ms_max, phase_min_deg, delay_min_s : float
        What every loop must keep: Ms, a ratio, > 1; phase margin, deg; delay margin, s. ki is maximised under it.
    crossover : tuple of float
        Lowest and highest gain crossover, rad/s; see `Specification`.
    minimise_ms : bool
        Instead minimise the worst Ms at ki >= `ki_min`, under whatever else is asked for. Where all plants are stable
        that is next to no gain, and Ms next to 1: give `ms_max` then.
    ki_min : float
        In the plant's unit of gain per second, > 0; without it the integral action would vanish.
    compensator : python-control system, `Rational`, or a real number
        A further transfer function in series with the PI, such as a lead.
    names : sequence of str
        What an error calls each plant; left out, by number.

    Returns
    -------
    PIDesign
        kp, in units of the plants' input per output, ki, in that per second, and the margins of every plant.

    Raises
    ------
    InfeasibleDesignError
        No PI meets the specification; the message gives the best that can be achieved.
    InputError
        No plants, an argument of another kind, or a specification that contradicts itself.
    """
    specification = Specification(ms_max, phase_min_deg, delay_min_s, crossover)
    systems = _systems(plants, compensator)
    family = Family(systems, _dead_times(plants, dead_time), compensator is not None, tuple(names))
    if names and len(names) != len(systems):
        raise InputError(f"names: {len(names)} for {len(systems)} plants; give one for each, or none")
    if minimise_ms:
        if ki_min is None:
            raise InputError("ki_min: None is not allowed with minimise_ms; give a least ki > 0")
        number("ki_min", ki_min, gt=0)
        kp, ki = least_ms(family, specification, ki_min)
    else:
        if ms_max is None and phase_min_deg is None and delay_min_s is None:
            raise InputError("specification: nothing bounds ki; give ms_max, phase_min_deg or delay_min_s")
        if ki_min is not None:
            raise InputError("ki_min: goes with minimise_ms; ki is maximised otherwise")
        kp, ki = largest_ki(family, specification)
    loops = family.loops(kp, ki)
    worst = worst_of(family_margins(loops))
    assert worst is not None  # only stable gains are returned
    return PIDesign(kp, ki, worst, tuple(loop.margins() for loop in loops), specification)


@checked
def pi_for_crossover(plant: Any, dead_time: float, crossover: float, phase_margin_deg: float) -> tuple[float, float]:
    """(kp, ki) with |L(j crossover)| = 1 and arg L = -180 deg + phase margin there, exactly.

    Raises
    ------
    InfeasibleDesignError
        That PI does not stabilise the plant, needs ki < 0, or has a smaller phase margin at another crossover.
    """
    if not (math.isfinite(crossover) and crossover > 0):
        raise InputError(f"crossover: {crossover} rad/s is not allowed; give a finite frequency > 0")
    if not 0 < phase_margin_deg < 180:
        raise InputError(f"phase margin: {phase_margin_deg} deg is not allowed; give a value between 0 and 180")
    system = Rational.from_control(plant, "plant")
    at = DeadTimeLoop(system, dead_time)(1j * crossover)
    wanted = -np.exp(1j * math.radians(phase_margin_deg)) / at
    kp, ki = float(wanted.real), float(-wanted.imag * crossover)
    asked = f"crossover {crossover:g} rad/s with phase margin {phase_margin_deg:g} deg"
    if ki < 0:
        raise InfeasibleDesignError(
            f"{asked} needs ki = {ki:.4g} < 0: the plant's own phase there leaves {phase_margin_deg:g} deg only to a "
            "lead; ask for a smaller phase margin or another crossover, or add a lead"
        )
    loop = DeadTimeLoop(pi_transfer_function(kp, ki) * system, dead_time)
    if not loop.is_stable():
        raise InfeasibleDesignError(
            f"{asked} gives kp = {kp:.4g}, ki = {ki:.4g}, which does not stabilise the plant "
            f"({loop.unstable_closed_loop_poles:g} unstable poles); choose another crossover"
        )
    smallest = loop.margins().phase_deg
    if smallest < phase_margin_deg * (1 - 1e-9):
        raise InfeasibleDesignError(
            f"{asked} is met, but another gain crossover leaves only {smallest:.4g} deg; choose another crossover"
        )
    return kp, ki


# -- arguments ------------------------------------------------------------


def _systems(plants: Any, compensator: Any) -> list[Rational]:
    members = list(plants) if isinstance(plants, (list, tuple)) else [plants]
    if not members:
        raise InputError("plants: none is given; give at least one")
    extra = Rational.from_control(1.0 if compensator is None else compensator, "compensator")
    systems = [extra * Rational.from_control(plant, "plants") for plant in members]
    if not all(system.gain for system in systems):
        raise InputError("plants: one is 0, with its compensator; give plants with a gain")
    return systems


def _dead_times(plants: Any, dead_time: float | Sequence[float]) -> list[float]:
    given: list[float]
    count = len(plants) if isinstance(plants, (list, tuple)) else 1
    given = np.atleast_1d(numbers("dead_time", dead_time, "s", ge=0)).tolist()
    if len(given) not in (1, count):
        raise InputError(f"dead_time: {len(given)} values for {count} plants; give one, or one each")
    return given * count if len(given) == 1 else given
