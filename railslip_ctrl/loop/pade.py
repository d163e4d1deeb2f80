"""The diagonal Pade approximation of exp(-tau s), for comparison with the exact dead time only."""

from __future__ import annotations

from math import factorial

import numpy as np

from railslip_ctrl.arguments import checked, number

from .rational import Rational, polynomial_roots

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
    n = order
    # roots are taken in tau*s, where the coefficients are well scaled
    coefficients = [
        factorial(2 * n - k) * factorial(n) / (factorial(2 * n) * factorial(k) * factorial(n - k))
        for k in range(n, -1, -1)
    ]
    poles = polynomial_roots(coefficients) / dead_time
    return Rational(-poles, poles, (-1.0) ** n)
