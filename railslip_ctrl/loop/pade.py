"""The diagonal Pade approximation of exp(-tau s), for comparison with the exact dead time only."""

from __future__ import annotations

from functools import lru_cache
from math import factorial
from typing import TYPE_CHECKING

import numpy as np
from flint import fmpq, fmpq_poly

from railslip_ctrl.core.arguments import checked, number

from .polynomials import rounded_roots
from .rational import Rational

if TYPE_CHECKING:
    from numpy.typing import NDArray

LARGEST_ORDER = 100
"""From order 10 on the approximation is exact to rounding where the phase of the dead time is a few radians."""


@checked
def pade(dead_time: float, order: int) -> Rational:
    """Diagonal Pade approximation of order `order`, 1 to 100, of exp(-dead_time s), dead_time >= 0, s; 1 without any.

    Coefficient of (tau s)^k: (2n - k)! n!/((2n)! k! (n - k)!), sign (-1)^k in the numerator; see e.g.
    G. H. Golub, C. F. Van Loan: Matrix Computations, 3rd edition, Johns Hopkins University Press, 1996, p. 572.
    """
    number("Pade order", order, ge=1, le=LARGEST_ORDER)
    number("dead time", dead_time, "s", ge=0)
    if dead_time == 0:
        return Rational(np.array([]), np.array([]), 1.0)
    poles = _poles(order) / dead_time
    return Rational(-poles, poles, (-1.0) ** order)


@lru_cache
def _poles(n: int) -> NDArray[np.complex128]:
    """Those of dead time 1."""
    coefficients = [fmpq(factorial(2 * n - k), factorial(k) * factorial(n - k)) for k in range(n + 1)]
    return rounded_roots(fmpq_poly(coefficients))
