"""Interval arithmetic: SymPy expressions and adhesion laws with balls, and the largest value of a function in a box.

A ball is python-flint's `arb`: a midpoint and a radius, rounded outward. A function of balls returns
a ball that contains the result for all values in these balls.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import count, pairwise
from typing import Any

import sympy as sp
from flint import acb, arb

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.adhesion.curve import Curve

Box = Mapping[str, tuple[float, float]]
"""Ranges (lowest, highest) by the name of the quantity."""


def ball(low: float, high: float) -> arb:
    """Return the smallest ball that contains a range."""
    return arb(low).union(arb(high))


def upper(value: arb) -> float:
    """Return the upper end of a ball as a double, rounded up; inf for a ball that is not finite."""
    if value.is_exact() and arb(float(value)) == value:
        return float(value)
    return math.nextafter(float(value.upper()), math.inf) if value.is_finite() else math.inf


def _monotone(function: Callable[[arb], arb]) -> Callable[[arb], arb]:
    # narrower than flint's enclosure of an increasing function
    return lambda x: function(x.lower()).union(function(x.upper()))


def _pieces(*parts: arb) -> arb:
    """Return a ball that contains a Piecewise; `parts`: value and slack of each earlier branch, value of the last."""
    # the first branch with a slack >= 0 applies; the slack of a branch is a ball, so that several may apply
    possible = []
    for value, slack in zip(parts[:-1:2], parts[1::2], strict=True):
        if slack < 0:
            continue
        possible.append(value)
        if slack > 0:
            break
    else:
        possible.append(parts[-1])
    hull = possible[0]
    for one in possible[1:]:
        hull = hull.union(one)
    return hull


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "exp": _monotone(lambda x: x.exp()),
    "tanh": _monotone(lambda x: x.tanh()),
    "atan": _monotone(lambda x: x.atan()),
    "log": lambda x: x.log(),
    "sqrt": lambda x: x.sqrt(),
    "Abs": abs,
    "pieces": _pieces,
    "ratio": lambda p, q: arb(p) / q,
}


def on_balls(arguments: Sequence[sp.Symbol], expressions: Sequence[sp.Expr], **functions: Any) -> Callable[..., Any]:
    """Return a function from balls of the `arguments` to a list of enclosures of the expressions.

    functions: enclosures of further SymPy functions, as keywords. InputError for a function without enclosure.
    """
    known = {**_FUNCTIONS, "pi": arb.pi(), **functions}
    exact = [_exact(expression) for expression in expressions]
    for function in {type(one) for each in exact for one in each.atoms(sp.Function)}:
        if function.__name__ not in known:
            name = function.__name__
            raise InputError(
                f"adhesion: the function {name} cannot be bounded over intervals; give a law without {name}"
            )
    made: Callable[..., Any] = sp.lambdify(list(arguments), exact, modules=[known], cse=True)
    return made


def _exact(expression: sp.Expr) -> sp.Expr:
    # `sympy.lambdify` would round fractions, and would evaluate one branch of a Piecewise
    pieces, ratio = sp.Function("pieces"), sp.Function("ratio")

    def split(one: sp.Piecewise) -> sp.Expr:
        parts: list[sp.Expr] = []
        for value, condition in one.args[:-1]:
            if not isinstance(condition, (sp.Le, sp.Lt, sp.Ge, sp.Gt)):
                raise InputError(f"adhesion: the condition {condition} of a Piecewise is not supported; use <= or >=")
            parts += [value, condition.gts - condition.lts]
        return pieces(*parts, one.args[-1][0])

    whole = expression.replace(lambda x: isinstance(x, sp.Piecewise), split)
    return whole.replace(lambda x: x.is_Rational and not x.is_Integer, lambda x: ratio(x.p, x.q))


Enclosure = Callable[[arb, arb, arb], list[arb]]
"""Function from v (m/s), slip and N (N) to F (N), dF/dslip at constant v (N) and dF/dv at constant slip (N s/m)."""

# slip between nodes of the curve; the enclosure of the slope near the peak is within 1 % of the range of the pole
_CURVE_STEP = 1.0 / 4096.0


@cache
def adhesion_on_balls(law: AdhesionLaw) -> Enclosure:
    """Return the enclosure of a static law's force and its derivatives in braking, slip > 0.

    InputError for a law with a state, or with a function that has no enclosure.
    """
    if law.has_state:
        raise InputError(
            f"adhesion: the law {law.name} has a state, and verification over boxes needs a static law; give 'curve' "
            "or another static law"
        )
    v, slip, N = sp.Symbol("v", positive=True), sp.Symbol("slip", positive=True), sp.Symbol("N", positive=True)
    statement = law.statement()
    force = statement.force.subs({symbol("sigma"): slip * v, symbol("v"): v, symbol("N"): N})
    own = {"BristleCurve": _curve_on_balls(law)} if isinstance(law, Curve) else {}
    symbols = law.symbols()
    made = on_balls([v, slip, N, *symbols], [force, sp.diff(force, slip), sp.diff(force, v)], **own)
    values = [arb(one) for one in law.parameters()]
    return lambda v, slip, N: [one if isinstance(one, arb) else arb(one) for one in made(v, slip, N, *values)]


def _curve_on_balls(law: Curve) -> Callable[..., arb]:
    # F' has the sign of G - F, and G = (gamma - s)/beta falls with s: F rises until it meets G, then falls. In a range
    # of slips the smaller F of the two ends is a lower bound; if the peak is inside, G at the lower end is an upper one
    alpha, beta, gamma, R, v0 = (arb(one) for one in (law.alpha, law.beta, law.gamma, law.R, law.v0))

    def level(slip: arb) -> arb:
        return (gamma - slip * v0) / beta

    def hull(first: arb, at_first: arb, last: arb, at_last: arb) -> arb:
        if at_last < level(last):  # F still rises at the last point
            most = at_last.upper()
        else:
            most = at_first.upper() if at_first > level(first) else level(first).upper()
        return at_first.min(at_last).lower().union(most)

    def at(slip: arb) -> arb:
        index = int((slip / _CURVE_STEP).floor().unique_fmpz())
        start, force = arb(index * _CURVE_STEP), _curve_node(law, index)
        if slip == start:
            return force
        around = hull(start, force, arb((index + 1) * _CURVE_STEP), _curve_node(law, index + 1))
        s = start.union(slip) * v0
        slope = v0 * alpha * (1 - beta * around / (gamma - s)) * s / R
        return force + slope * (slip - start)

    def force(slip: arb, *_: arb) -> arb:
        first, last = slip.lower(), slip.upper()
        if not (first >= 0 and last < arb(law.domain_limit(1.0)[0] - 2.0 * _CURVE_STEP)):
            return arb("nan")
        return hull(first, at(first), last, at(last))

    return force


@cache
def _curve_node(law: Curve, index: int) -> arb:
    # validated integration of `curve.curve_force`
    alpha, beta, gamma, R = (arb(one) for one in (law.alpha, law.beta, law.gamma, law.R))
    c, s = alpha * beta / R, arb(index * _CURVE_STEP) * arb(law.v0)

    def integrand(t: acb, analytic: bool) -> acb:
        back = s - t
        return t * (-c * (gamma * (1 + back / (gamma - s)).log(analytic) - back)).exp()

    if index == 0:
        return arb(0)
    return (alpha / R * acb.integral(integrand, 0, s)).real


@dataclass(frozen=True)
class Largest:
    """Bounds of the largest value of a function over a box.

    - attained: lower bound; at `point` the function has at least this value.
    - bound: upper bound, rounded up.
    - parts: number of boxes examined.
    """

    attained: float
    bound: float
    point: Mapping[str, float]
    parts: int


def largest(
    function: Callable[[Mapping[str, arb]], arb], box: Box, *, relative: float, absolute: float = 0.0, most: int = 2000
) -> Largest:
    """Enclose the largest value of a function over a box by branch and bound.

    The search ends when the upper bound exceeds the attained value by at most `relative` times the attained value or by
    at most `absolute`, or after `most` sub-boxes.
    """
    order, attained, at = count(), -math.inf, dict.fromkeys(box, math.nan)

    def examined(part: dict[str, tuple[float, float]]) -> tuple[float, int, dict[str, tuple[float, float]]]:
        nonlocal attained, at
        middle = {name: 0.5 * (low + high) for name, (low, high) in part.items()}
        value = function({name: arb(x) for name, x in middle.items()})
        if value.is_finite() and float(value.lower()) > attained:
            attained, at = math.nextafter(float(value.lower()), -math.inf), middle
        return -upper(function({name: ball(*ends) for name, ends in part.items()})), next(order), part

    parts = [examined(dict(box))]
    while True:
        bound = -parts[0][0]
        narrow = bound - attained <= max(relative * abs(attained), absolute)
        if narrow or next(order) > most or all(low == high for low, high in parts[0][2].values()):
            return Largest(attained, bound, at, next(order))
        _, _, part = heapq.heappop(parts)
        whole = {name: ball(*ends) for name, ends in part.items()}
        middles = {name: 0.5 * (low + high) for name, (low, high) in part.items() if low < high}
        # the quantity that lowers the upper bound most if it is fixed at its middle
        name = min(middles, key=lambda name: upper(function({**whole, name: arb(middles[name])})))
        low, high = part[name]
        for half in pairwise((low, 0.5 * (low + high), high)):
            heapq.heappush(parts, examined({**part, name: half}))
