"""Loop shaping by hand: where the loop has most phase, and the gain that puts the crossover there."""

from __future__ import annotations

import numpy as np

from railslip_ctrl.core.arguments import checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.loop.crossings import bracketed_roots
from railslip_ctrl.loop.deadtime import frequency_curve


@checked
def most_phase(loop: DeadTimeLoop) -> tuple[float, float]:
    """Where a loop has most phase.

    Parameters
    ----------
    loop : DeadTimeLoop
        L.

    Returns
    -------
    tuple[float, float]
        Frequency, rad/s, at which L(j omega) has its largest phase, and that phase, rad, continuous.

    Raises
    ------
    InputError
        The phase has no interior maximum (it only falls).
    """
    curve = frequency_curve(loop, *loop.feature_band())
    top = int(np.argmax(curve.phase_deg))
    if top in (0, curve.omega.size - 1):
        raise InputError("loop shaping: the phase of this loop has no maximum; choose the crossover by hand")
    low, high = curve.omega[[top - 1]], curve.omega[[top + 1]]
    omega = float(bracketed_roots(lambda w, _: loop.phase_slope(w), low, high)[0])
    return omega, float(loop.phase(omega))


@checked
def gain_for_crossover(loop: DeadTimeLoop, omega: float) -> float:
    """Factor on the gain of a loop that makes |L(j omega)| = 1.

    Parameters
    ----------
    loop : DeadTimeLoop
        L.
    omega : float
        rad/s, > 0.

    Returns
    -------
    float
        The factor, > 0.

    Raises
    ------
    InputError
        omega is not finite and positive.
    """
    number("crossover", omega, "rad/s", gt=0)
    return float(1 / np.abs(loop(1j * omega)))
