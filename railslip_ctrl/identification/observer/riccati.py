"""Steady Kalman covariances by python-control, their equations checked; white noise over an interval.

The solvers give numbers for any input; where noises lie so far apart that the numbers do not solve the equation, the
input is refused.
"""

from __future__ import annotations

import math

import numpy as np

from railslip_ctrl.core.errors import InputError

from .samples import Floats

# An equation's residual against the sum of its terms, entry by entry: sound solutions have 1e-10 and less, and what is
# refused has no digit right.
_LARGEST_RESIDUAL = 1e-6


def continuous_covariance(A: Floats, driven: Floats, noise: float) -> Floats:
    """P of A P + P A' - P C' C P/noise + driven = 0, C the first state; InputError where it cannot be had."""
    import control

    n = len(A)
    with np.errstate(all="ignore"):
        try:
            _, solved, _ = control.lqe(A, np.eye(n), np.eye(1, n), driven, np.array([[noise]]), method="scipy")
        except (ArithmeticError, ValueError):  # LinAlgError is a ValueError
            raise _refusal(driven, noise) from None
        P = np.asarray(solved, dtype=float)
        seen = np.outer(P[:, 0], P[0]) / noise
        terms = (A @ P, P @ A.T, -seen, driven)
        sound = _solves(terms) and np.linalg.eigvals(A - np.outer(P[:, 0] / noise, np.eye(1, n))).real.max() < 0
    if not sound:
        raise _refusal(driven, noise)
    return P


def sampled_covariance(transition: Floats, driven: Floats, noise: float) -> Floats:
    """P before a sample, of P = F (P - P C' C P/(C P C' + noise)) F' + driven; InputError where it cannot be had."""
    import control

    n = len(transition)
    with np.errstate(all="ignore"):
        try:
            _, solved, _ = control.dlqe(
                transition, np.eye(n), np.eye(1, n), driven, np.array([[noise]]), method="scipy"
            )
        except (ArithmeticError, ValueError):
            raise _refusal(driven, noise) from None
        P = np.asarray(solved, dtype=float)
        gain = P[:, 0] / (P[0, 0] + noise)
        after = P - np.outer(gain, P[0])
        terms = (transition @ P @ transition.T, -transition @ np.outer(gain, P[0]) @ transition.T, driven, -P)
        corrected = transition - np.outer(transition @ gain, np.eye(1, n))
        sound = _solves(terms) and after.diagonal().min() >= 0 and np.abs(np.linalg.eigvals(corrected)).max() < 1
    if not sound:
        raise _refusal(driven, noise)
    return P


def sampled_noise(A: Floats, intensity: Floats, interval: float) -> tuple[Floats, Floats]:
    """exp(A h), and the covariance that white noise of this intensity on x' adds within h.

    By a matrix exponential ([VanLoan1978]) for a short time, which is then doubled: the exponential holds exp(-A h),
    beside which over a long time nothing else keeps its digits. InputError where the numbers overflow.
    """
    from scipy.linalg import expm

    n = len(A)
    doublings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(A, 2)) * interval, 1.0))))
    with np.errstate(all="ignore"):
        generator = np.block([[-A, intensity], [np.zeros((n, n)), A.T]]) * (interval / 2**doublings)
        exponential = expm(generator) if np.isfinite(generator).all() else np.full_like(generator, np.nan)
        transition = exponential[n:, n:].T
        driven = transition @ exponential[:n, n:]
        for _ in range(doublings):
            driven = driven + transition @ driven @ transition.T
            transition = transition @ transition
        driven = (driven + driven.T) / 2  # symmetric but for rounding
    if not (np.isfinite(transition).all() and np.isfinite(driven).all()):
        raise InputError(
            f"interval: {interval:g} is not allowed with these noises; give values nearer to usual ones (s)"
        )
    return transition, driven


def _solves(terms: tuple[Floats, ...]) -> bool:
    residual, scale = np.abs(sum(terms)), sum(np.abs(term) for term in terms)
    return bool(np.isfinite(scale).all() and (residual <= _LARGEST_RESIDUAL * scale).all())


def _refusal(driven: Floats, noise: float) -> InputError:
    driving = float(np.abs(driven).max())
    return InputError(
        f"Kalman filter: no steady gain can be computed with measurement noise {noise:g} against driving noise "
        f"{driving:g}; give noises nearer to each other, and an interval near the filter's time constants"
    )
