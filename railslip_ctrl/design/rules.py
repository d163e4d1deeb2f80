"""Published tuning rules, for comparison: applied to a first-order model where they hold, refused where they do not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.loop import Rational
from railslip_ctrl.model.vehicle import PIGains

# Relative imaginary part that rounding leaves of a triple real root of an expanded polynomial.
_REAL = 1e-3


class Kind(StrEnum):
    """What the slowest pole of a model does."""

    STABLE = "stable"
    INTEGRATING = "integrating"
    UNSTABLE = "unstable"


@dataclass(frozen=True)
class FirstOrderModel:
    """A first-order model with dead time, as the rules want it.

    Attributes
    ----------
    kind : Kind
        stable: gain exp(-theta s)/(T s + 1); unstable: gain exp(-theta s)/(T s - 1); integrating: gain exp(-theta s)/s.
    gain : float
        Output over input, (m/s)/(N*m) for the wheel; per second if integrating.
    time_constant, dead_time : float
        T (inf if integrating) and theta, s.
    """

    kind: Kind
    gain: float
    time_constant: float
    dead_time: float

    @property
    def transfer_function(self) -> Rational:
        """The model without its dead time."""
        if self.kind is Kind.INTEGRATING:
            return Rational(np.array([]), np.array([0.0]), self.gain)
        sign = 1.0 if self.kind is Kind.UNSTABLE else -1.0
        return Rational(np.array([]), np.array([sign / self.time_constant]), self.gain / self.time_constant)


@dataclass(frozen=True)
class RuleTuning:
    """What a rule gives: C(s) = kp + ki/s + kd s, and the model it was applied to.

    `derivative_gain` is kd, N*m/(m/s^2) for the wheel; 0 for a PI. `closed_loop_time` is the rule's knob, s.
    Nothing here says that the full plant is stable with it: close the exact loop and look.
    """

    rule: str
    gains: PIGains
    derivative_gain: float
    model: FirstOrderModel
    closed_loop_time: float

    def transfer_function(self, derivative_filter: float = 0.0) -> Rational:
        """C(s) with the derivative filtered, kd s/(derivative_filter s + 1); a PID needs a filter > 0 s.

        Raises InputError for a filter time that is negative, not finite, or 0 with a derivative part.
        """
        tf, kp, ki, kd = derivative_filter, self.gains.kp, self.gains.ki, self.derivative_gain
        if not (math.isfinite(tf) and tf >= 0 and (tf > 0 or kd == 0)):
            raise InputError(f"derivative filter: {tf} s is not allowed; give a finite value > 0")
        num = [kp * tf + kd, kp + ki * tf, ki]
        return Rational.from_polynomials(num, [tf, 1.0, 0.0])


@checked
def first_order_model(plant: Any, dead_time: float) -> FirstOrderModel:
    """Reduce a plant with real poles to first order by the half rule ([Skogestad2003]).

    Of a stable or integrating plant the largest lag (or the integrator) is kept; half of the next one is added to it
    and half to the dead time; all smaller lags, and 1/z of each zero z right of the axis, go to the dead time. A zero
    left of the axis takes its time constant off the dead time, if that is the larger. Of an unstable plant the
    unstable pole is kept as it is and every lag goes to the dead time: to move half a lag over to 1/p, as the half
    rule would, makes an unstable pole look slower, so safer, than it is. (A deviation: the source is for stable and
    integrating plants, and the rules for unstable ones come with no reduction.)

    Parameters
    ----------
    plant : python-control system, `Rational`, or a real number
        From command to output, without the dead time; poles real, at most one of them not left of the axis.
    dead_time : float
        s, >= 0.

    Raises
    ------
    InputError
        The plant or the dead time is not of this form.
    """
    if not (math.isfinite(dead_time) and dead_time >= 0):
        raise InputError(f"dead time: {dead_time} s is not allowed; give a finite value >= 0")
    plant = Rational.from_control(plant, "plant")
    roots = np.concatenate([plant.poles, plant.zeros])
    if plant.poles.size == 0 or np.any(np.abs(roots.imag) > _REAL * np.abs(roots)) or np.any(plant.zeros == 0):
        raise InputError("first-order model: the plant must have poles, all roots real, and no zero at the origin")
    poles, zeros = plant.poles.real, plant.zeros.real
    if np.count_nonzero(poles >= 0) > 1:
        raise InputError(
            "first-order model: the plant has several poles right of or on the axis; rules want one at most"
        )
    lags = np.sort(-1 / poles[poles < 0])[::-1]
    unstable, integrating = poles[poles > 0], poles[poles == 0]
    # value at s = 0 with the slow pole's own factor taken out
    rest = Rational(plant.zeros, plant.poles[plant.poles != 0], plant.gain).dc_gain
    if unstable.size:
        kind, gain, time_constant, half = Kind.UNSTABLE, -rest, float(1 / unstable[0]), 0.0
    elif integrating.size:
        kind, gain, time_constant = Kind.INTEGRATING, rest, math.inf
        half = lags[0] / 2 if lags.size else 0.0
    else:
        kind, gain, half = Kind.STABLE, rest, lags[1] / 2 if lags.size > 1 else 0.0
        time_constant, lags = float(lags[0] + half), lags[1:]
    theta = dead_time + float(lags.sum() - half + (1 / zeros[zeros > 0]).sum())
    leads = -1 / zeros[zeros < 0]
    if np.any(leads > theta):
        raise InputError(
            f"first-order model: a zero of time constant {leads.max():.4g} s is slower than the effective dead time "
            f"{theta:.4g} s; cancel it in the controller first"
        )
    theta -= float(leads.sum())
    if theta < 0:
        raise InputError(f"first-order model: the zeros leave a dead time of {theta:.4g} s; no rule applies")
    return FirstOrderModel(kind, float(gain), time_constant, theta)


@checked
def simc_pi(plant: Any, dead_time: float, *, closed_loop_time: float | None = None) -> RuleTuning:
    """SIMC PI ([Skogestad2003]): kp = T/(k (tau_c + theta)), integral time min(T, 4 (tau_c + theta)).

    Parameters
    ----------
    closed_loop_time : float, optional
        tau_c, s, > -theta; left out, theta ("tight control").

    Raises
    ------
    InputError
        An unstable plant, for which the rule does not hold, a model without dead time and no tau_c, or as
        `first_order_model`.
    """
    model = first_order_model(plant, dead_time)
    if model.kind is Kind.UNSTABLE:
        raise InputError(
            f"SIMC: the plant has an unstable pole at {1 / model.time_constant:.4g} 1/s; the rule holds for stable and "
            "integrating plants only; use rotstein_lewin or a computed design"
        )
    tau_c = model.dead_time if closed_loop_time is None else closed_loop_time
    total = tau_c + model.dead_time
    if closed_loop_time is None and total == 0:
        raise InputError("SIMC: the model has no dead time, from which the rule takes tau_c; give closed_loop_time")
    if not (math.isfinite(total) and total > 0):
        raise InputError(f"closed-loop time: {tau_c} s is not allowed; give a finite value > {-model.dead_time:.4g} s")
    if model.kind is Kind.INTEGRATING:
        kp, integral_time = 1 / (model.gain * total), 4 * total
    else:
        kp, integral_time = model.time_constant / (model.gain * total), min(model.time_constant, 4 * total)
    return RuleTuning("SIMC PI", PIGains(kp=kp, ki=kp / integral_time), 0.0, model, tau_c)


@checked
def rotstein_lewin(plant: Any, dead_time: float, *, closed_loop_time: float, derivative: bool = False) -> RuleTuning:
    """PI or PID for an unstable first-order plant with dead time, by internal model control ([Rotstein1991]).

    The formulas are derived by internal model control as the source does, and tested to place the poles exactly
    without dead time; they are not copied from its tables.

    With lambda the closed-loop time and alpha = lambda (lambda/T + 2): PI kp = T alpha/(k lambda^2), integral time
    alpha, which without dead time makes T(s) = (alpha s + 1)/(lambda s + 1)^2 exactly; PID the same in series with
    (theta s/2 + 1), against the dead time: kp = T (alpha + theta/2)/(k lambda^2), integral time alpha + theta/2,
    derivative time alpha (theta/2)/(alpha + theta/2).

    Parameters
    ----------
    closed_loop_time : float
        lambda, s, > 0. With dead time only an interval of it stabilises, which the source gives as a graph.

    Raises
    ------
    InputError
        A plant that is not unstable, or whose model no controller of the structure stabilises (theta >= T for a PI,
        >= 2 T for a PID), a lambda that is not > 0, or as `first_order_model`.
    """
    model = first_order_model(plant, dead_time)
    if model.kind is not Kind.UNSTABLE:
        raise InputError(f"Rotstein-Lewin: the plant is {model.kind.value}; the rule is for unstable ones; use simc_pi")
    lam, k, t, half = closed_loop_time, model.gain, model.time_constant, model.dead_time / 2 if derivative else 0.0
    if not (math.isfinite(lam) and lam > 0):
        raise InputError(f"closed-loop time: {lam} s is not allowed; give a finite value > 0")
    most = (2 if derivative else 1) * t
    if model.dead_time >= most:
        raise InputError(
            f"Rotstein-Lewin: effective dead time {model.dead_time:.4g} s against a largest {most:.4g} s that a "
            f"{'PID' if derivative else 'PI'} can stabilise; shorten the dead time or cancel the lag"
        )
    alpha = lam * (lam / t + 2)
    kp = t * (alpha + half) / (k * lam**2)
    gains = PIGains(kp=kp, ki=kp / (alpha + half))
    name = "Rotstein-Lewin PID" if derivative else "Rotstein-Lewin PI"
    return RuleTuning(name, gains, kp * alpha * half / (alpha + half), model, lam)
