"""Dead-time compensators with exact loops: Smith predictors and an observer with prediction.

The plant is G(s) exp(-tau s). Its input is the commanded torque, N*m, its output is -e, m/s, where e is the slip error.
We write G = N/D and q = exp(-tau s). C0 = N0/D0 is the controller inside a Smith predictor. A loop is also unstable if
an unstable mode cancels in L (a hidden mode). The margins hold for changes of the true plant; the model of the plant in
the controller does not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Complexes, Floats, number
from railslip_ctrl.core.errors import InputError, UnstableLoopError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import Margins, Rational
from railslip_ctrl.loop.quasi import DelayedLoop, DelayedRatio, QuasiPolynomial

_LARGEST_CONDITION = 1e12  # largest condition number of a controllability matrix, whose inverse has four correct digits


@dataclass(frozen=True)
class Compensator:
    """Dead-time compensator C(s), N*m/(m/s), with its loop L = C G exp(-tau s).

    `hidden_unstable_poles` are closed-loop poles, 1/s, with real part >= 0 that cancel in L.
    """

    structure: str
    controller: DelayedRatio
    loop: DelayedLoop
    hidden_unstable_poles: tuple[complex, ...] = ()

    def is_stable(self) -> bool:
        """Return True if the loop is stable, including hidden modes."""
        return not self.hidden_unstable_poles and self.loop.is_stable()

    @property
    def reason(self) -> str:
        """Reason for instability by hidden modes; empty if there is none."""
        if not self.hidden_unstable_poles:
            return ""
        one = len(self.hidden_unstable_poles) == 1
        word, stay = ("pole", "stays") if one else ("poles", "stay")
        poles = ", ".join(f"{p.real:.4g}" if p.imag == 0 else f"{p:.4g}" for p in self.hidden_unstable_poles)
        return (
            f"the {self.structure} cancels the plant's {word} at {poles} 1/s, which {stay} in the closed loop as "
            f"{'a hidden mode' if one else 'hidden modes'}: after any disturbance at the plant's input the output "
            "grows without bound; use a filtered predictor or an observer"
        )

    def margins(self) -> Margins:
        """Return the exact margins; UnstableLoopError if the loop is not stable."""
        if self.hidden_unstable_poles:
            raise UnstableLoopError(
                f"margins are not defined: {self.reason}",
                unstable_poles=self.loop.root_count.right,
                stabilizing_gain_range=None,
            )
        return self.loop.margins()


def smith_predictor(plant: Any, dead_time: float, controller: Any) -> Compensator:
    """Return the classic Smith predictor ([Smith1957]): C = C0/(1 + C0 G (1 - q)) with q = exp(-tau s).

    - plant: G, the plant without dead time.
    - dead_time: tau, s, >= 0.
    - controller: C0, designed for the plant without dead time.

    With an unstable plant the loop is unstable for every C0, because unstable plant poles are hidden modes. InputError
    if C0 G is not strictly proper.
    """
    plant, controller = Rational.from_control(plant, "plant"), Rational.from_control(controller, "controller")
    num, den, num0, den0 = _polynomials(plant, dead_time, controller)
    forward, base = np.polymul(num0, num), np.polymul(den0, den)
    inner = QuasiPolynomial([np.polyadd(base, forward), -forward], dead_time)
    c = DelayedRatio(QuasiPolynomial([np.polymul(num0, den)], dead_time), inner)
    # keep both the plant's D and the model's D, because cancelled modes remain in the loop
    loop = DelayedRatio(QuasiPolynomial([[0.0], np.polymul(forward, den)], dead_time), inner.times(den))
    hidden = tuple(complex(p) for p in plant.poles if p.real >= 0)
    return Compensator("Smith predictor", c, DelayedLoop(loop), hidden)


def filtered_smith_predictor(
    plant: Any, dead_time: float, controller: Any, *, filter_time: float, roll_off: int = 0
) -> Compensator:
    """Return the filtered Smith predictor ([NormeyRico2009]): C = C0 F/(1 + C0 G (1 - F q)).

    F(s) = (1 + b_1 s + ... + b_m s^m)/(filter_time s + 1)^(m + roll_off), where m is the number of unstable plant poles
    p_i. The b_i are chosen such that F(p_i) = exp(p_i tau). G (1 - F q) then has no unstable pole, and the loop no
    unstable hidden mode. If the model in the controller is exact, the closed-loop poles are those of the loop with C0
    and G, those of F, and the stable poles of G.

    - plant: G, the plant without dead time.
    - dead_time: tau, s, >= 0.
    - controller: C0, designed for the plant without dead time.
    - filter_time: time constant of F, s, > 0; a larger one gives more robustness and slower rejection of disturbances.
    - roll_off: number of additional poles of F, against noise.

    InputError if C0 G is not strictly proper, or if unstable poles of the plant coincide.
    """
    number("filter time", filter_time, "s", gt=0)
    number("roll-off", roll_off, ge=0)
    plant, controller = Rational.from_control(plant, "plant"), Rational.from_control(controller, "controller")
    num, den, num0, den0 = _polynomials(plant, dead_time, controller)
    num_f, den_f = _prediction_filter(plant.poles, dead_time, filter_time, roll_off)
    forward, base = np.polymul(num0, num), np.polymul(den0, den)
    inner = QuasiPolynomial([np.polymul(np.polyadd(base, forward), den_f), -np.polymul(forward, num_f)], dead_time)
    feedback = np.polymul(num0, num_f)
    c = DelayedRatio(QuasiPolynomial([np.polymul(feedback, den)], dead_time), inner)
    kept = np.real(np.poly(plant.poles[plant.poles.real < 0]))  # modes of the model that remain in the predictor
    top = np.polymul(np.polymul(feedback, num), kept)
    loop = DelayedRatio(QuasiPolynomial([[0.0], top], dead_time), inner.times(kept))
    return Compensator("filtered Smith predictor", c, DelayedLoop(loop))


def _prediction_filter(poles: Complexes, dead_time: float, filter_time: float, roll_off: int) -> tuple[Floats, Floats]:
    unstable = poles[poles.real >= 0]
    apart = np.abs(unstable[:, None] - unstable)
    np.fill_diagonal(apart, np.inf)
    if np.any(apart <= 1e-6 * (1e-300 + np.abs(unstable))):
        raise InputError("filtered Smith predictor: unstable poles that coincide are not supported; move one slightly")
    unstable = unstable[unstable != 0]  # for a pole at the origin F(0) = 1 is the condition already
    m = unstable.size
    den = np.atleast_1d(np.poly(np.full(m + roll_off, -1 / filter_time))) * filter_time ** (m + roll_off)
    if m == 0:
        return np.ones(1), den
    powers = unstable[:, None] ** np.arange(1, m + 1)
    b = np.linalg.solve(powers, np.polyval(den, unstable) * np.exp(dead_time * unstable) - 1).real
    return np.append(b[::-1], 1.0), den


def observer_compensator(
    plant: Any, dead_time: float, *, feedback_poles: Sequence[complex], observer_poles: Sequence[complex]
) -> Compensator:
    """Return state feedback with an observer, prediction over the dead time, and integral action.

    The plant without dead time is x' = A x + B u, y = C x. An observer with gain Lo estimates the state: x^' = A x^ + B
    u(t - tau) + Lo (y - C x^). The state and the integral of y are predicted exactly over the dead time tau
    ([ManitiusOlbrot1979], [Artstein1982]). The control u is -K times the predicted vector. The closed loop has exactly
    the poles `feedback_poles` and `observer_poles`.

    - plant: plant of order n without dead time.
    - dead_time: tau, s, >= 0.
    - feedback_poles: n + 1 poles of the plant and the integrator with state feedback, 1/s.
    - observer_poles: n poles of the observer, 1/s.

    InputError for poles that are not in the left half plane or not in conjugate pairs, or for a plant that is not
    strictly proper, has a pole equal to a zero, or has a zero at the origin.
    """
    plant = Rational.from_control(plant, "plant")
    n = plant.poles.size
    number("dead time", dead_time, "s", ge=0)
    _check_poles("feedback poles", feedback_poles, n + 1)
    _check_poles("observer poles", observer_poles, n)
    if plant.relative_degree == 0:
        raise InputError("observer design: the plant is not strictly proper; add the actuator's lag")
    from scipy.linalg import expm
    from scipy.signal import tf2ss

    num = np.atleast_1d(np.real(np.poly(plant.zeros)) * plant.gain)
    a, b, c, _ = tf2ss(num, np.real(np.poly(plant.poles)))
    extended = np.block([[a, np.zeros((n, 1))], [c, np.zeros((1, 1))]])
    b_extended = np.vstack([b, [[0.0]]])
    k = _placed(extended, b_extended, feedback_poles)
    gain_o = _placed(a.T, c.T, observer_poles).T
    ahead = expm(extended * dead_time)
    k_ahead = k @ ahead
    k_x, k_i = k_ahead[:, :n], float(k_ahead[0, n])
    observer = a - gain_o @ c
    # row (sI - M)^-1 column = (det(sI - M + column row) - det(sI - M))/det(sI - M)
    den, den_o, den_e = np.poly(a), np.poly(observer), np.append(np.poly(a), 0.0)
    now = _adjugate_form(extended, b_extended, k)
    before = _adjugate_form(extended, ahead @ b_extended, k)
    before[-1] = now[-1]  # equal except for rounding, because the finite-time integral has no pole at the origin
    model = _adjugate_form(observer, b, k_x)
    measured = np.polyadd(np.append(_adjugate_form(observer, gain_o, k_x), 0.0), k_i * den_o)
    inner = QuasiPolynomial(
        [np.polymul(np.polyadd(den_e, now), den_o), np.polysub(np.polymul(den_e, model), np.polymul(before, den_o))],
        dead_time,
    )
    controller = DelayedRatio(QuasiPolynomial([np.polymul(measured, den)], dead_time), inner)
    loop = DelayedRatio(QuasiPolynomial([[0.0], np.polymul(measured, num)], dead_time), inner)
    return Compensator("observer with prediction", controller, DelayedLoop(loop))


def _polynomials(plant: Rational, dead_time: float, controller: Rational) -> tuple[Floats, Floats, Floats, Floats]:
    number("dead time", dead_time, "s", ge=0)
    if plant.relative_degree + controller.relative_degree < 1:
        raise InputError("Smith predictor: controller and plant together are not strictly proper; add a lag")
    polynomials = []
    for system in (plant, controller):
        polynomials += [system.gain * np.atleast_1d(np.real(np.poly(system.zeros)))]
        polynomials += [np.atleast_1d(np.real(np.poly(system.poles)))]
    return polynomials[0], polynomials[1], polynomials[2], polynomials[3]


def _check_poles(name: str, poles: Sequence[complex], count: int) -> None:
    values = np.asarray(poles, dtype=complex)
    if values.size != count:
        raise InputError(f"{name}: {values.size} given; give {count}")
    if not (np.isfinite(values).all() and np.all(values.real < 0)):
        raise InputError(f"{name}: {list(poles)} are not all left of the imaginary axis; give negative real parts")
    if np.abs(np.poly(values).imag).max() > 1e-9 * np.abs(np.poly(values)).max():
        raise InputError(f"{name}: {list(poles)} are not in conjugate pairs; give both poles of each pair")


def _placed(a: Floats, b: Floats, poles: Sequence[complex]) -> Floats:
    # Ackermann's formula: SciPy's `place_poles` rejects repeated poles, and `place_acker` fails for bad scaling
    n = a.shape[0]
    reach = np.hstack([np.linalg.matrix_power(a, i) @ b for i in range(n)])
    scale = np.abs(reach).max(axis=0)
    if not np.all(scale > 0) or np.linalg.cond(reach / scale) > _LARGEST_CONDITION:
        raise InputError("observer design: the plant with its integrator is not reachable or observable; cancel the "
                         "common poles and zeros (a zero at the origin forbids integral action)")  # fmt: skip
    last = np.linalg.solve(reach.T, np.eye(n)[-1])
    value = np.zeros((n, n))
    for coefficient in np.real(np.poly(np.asarray(poles, dtype=complex))):
        value = value @ a + coefficient * np.eye(n)
    return np.asarray(last @ value).reshape(1, n)


def _adjugate_form(matrix: Floats, column: Floats, row: Floats) -> Floats:
    """Return the polynomial row * adj(s I - matrix) * column in descending powers of s."""
    return np.asarray(np.real(np.poly(matrix - column @ row) - np.poly(matrix))[1:])
