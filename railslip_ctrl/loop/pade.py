"""The diagonal Pade approximation of exp(-tau s), for comparison with the exact dead time only."""

from __future__ import annotations

from math import factorial

import numpy as np

from railslip_ctrl.errors import InputError

from .rational import Rational, polynomial_roots


def pade(dead_time: float, order: int) -> Rational:
    """Diagonal Pade approximation of order `order` >= 1 of exp(-dead_time s); 1 for dead_time = 0.

    Coefficient of (tau s)^k: (2n - k)! n!/((2n)! k! (n - k)!), sign (-1)^k in the numerator; see e.g.
    G. H. Golub, C. F. Van Loan: Matrix Computations, 3rd edition, Johns Hopkins University Press, 1996, p. 572.
    """
    if order < 1:
        raise InputError(f"Pade order: {order} is not allowed; give an order >= 1")
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
