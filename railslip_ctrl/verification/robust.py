"""Variants of the law whose promises survive disturbances, derived: layer, dead zone, projection, leak, matrix gain.

All start from the derived error dynamics and from V with a gain for each component. With Td = q Tb, Tb acting, they
are s' = theta_tilde' phi + h (d - D0 s - K0 sgn s), h = 1 + q > 0, phi = (Ta_hat, omega) as the law has it, with an
effective disturbance d in which the errors of Ta_hat and v'_hat are, and neither s, D nor K (`effective_disturbance`).
d_max bounds |d|, m/s^2; in torque it is (J/r) d_max, which is K_min of (40). Nothing here is about the actuator: the
torque acts at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import sympy as sp

from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import Vehicle
from railslip_ctrl.sliding.derivation import Derivation, derive
from railslip_ctrl.sliding.gains import PUBLISHED_LAW, LawGains
from railslip_ctrl.sliding.identities import identical
from railslip_ctrl.sliding.symbols import sliding_symbol

from .ideal_loop import true_theta
from .reaching_bound import TORQUE_FRACTION, ReachingSet, effective_rate, least_gain, operating_set

s, D, K, k1, k2 = (sliding_symbol(name) for name in ("s", "D", "K", "k1", "k2"))
THETA = tuple(sliding_symbol(f"theta{i}") for i in (1, 2))
HAT = tuple(sliding_symbol(f"theta{i}_hat") for i in (1, 2))
TILDE = tuple(sliding_symbol(f"theta{i}_tilde") for i in (1, 2))
RATE = tuple(sliding_symbol(f"theta{i}_hat_rate") for i in (1, 2))
GAINS = (k1, k2)
LAYER = sp.Symbol("Phi", positive=True)
LEAK = sp.Symbol("ell", positive=True)
d, d_max = sp.Symbol("d", real=True), sp.Symbol("d_max", nonnegative=True)
SHARE = sp.Symbol("h", positive=True)  # 1 + Td/Tb
# slacks of the proofs: how far s is outside a bound, d below d_max, the gain above what (40) asks
_outside = sp.Symbol("x", positive=True)
_below, _spare = sp.Symbol("y", nonnegative=True), sp.Symbol("m", nonnegative=True)

D0, K0 = plant.r / plant.J * D, plant.r / plant.J * K

SIGMAS = 3.0
"""The random adhesion force is bounded at this many standard deviations in the designs here."""

ESTIMATE_ERROR = 0.1
"""Share by which Ta_hat and v'_hat may be wrong in the designs here, each."""

GAIN_MARGIN = 1.1
"""K over the least gain of (40)."""

LAYER_WIDTH = 0.2  # m/s, 0.7 % of slip at 100 km/h
_BOX_MARGIN = 0.1  # of its width, at either side
LOWEST_FRICTION = -0.25  # N m s: the printed 0.25 - 0.01 t after 50 s, the longest published stop


@dataclass(frozen=True)
class Variant:
    """A variant as derived.

    Attributes
    ----------
    name : str
    result : Expr
        The bound, or V', that the variant promises.
    proved : bool
        Whether every identity and sign of the derivation was proved.
    argument : str
        The proof in a sentence.
    """

    name: str
    result: sp.Expr
    proved: bool
    argument: str


@cache
def effective_disturbance() -> sp.Expr:
    """d of s' = theta_tilde' phi + h (d - D0 s - K0 sgn s), m/s^2, where Td = (h - 1) Tb of the law itself.

    ArithmeticError where s, D or K is left in it: then no bound of d could be given before the gains.
    """
    made = derive()
    free = effective_rate(made, SHARE) + SHARE * (D0 * s + K0 * sp.sign(s))
    effective = sp.expand(free / SHARE)
    if effective.has(s, D, K, *TILDE):
        raise ArithmeticError("the effective disturbance depends on s, D or K; the plant or the law has been changed")
    return effective


def _error_rate(made: Derivation) -> sp.Expr:
    """s' in theta_tilde, h and the symbol d in place of `effective_disturbance`."""
    effective_disturbance()  # raises where s' has not this form
    ideal = made.error_dynamics - made.disturbance_perturbed
    known = ideal.subs(dict.fromkeys(TILDE, 0))
    return sp.expand(ideal - known + SHARE * (known + d))


def _lyapunov_rate(made: Derivation, error_rate: sp.Expr) -> sp.Expr:
    """V' for the matrix gain along a given s', theta_hat' free; theta is constant."""
    rate = sp.diff(made.V_matrix, s) * error_rate
    return rate - sum(sp.diff(made.V_matrix, a) * b for a, b in zip(TILDE, RATE, strict=True))


@cache
def boundary_layer() -> Variant:
    """sat(s/Phi) for sgn s with theta known: |s| ends below d_max/(D0 + K0/Phi) where d_max <= K0 + D0 Phi."""
    known = _error_rate(derive()).subs(dict.fromkeys(TILDE, 0))
    inside = known.subs(sp.sign(s), s / LAYER)
    bound = sp.solve(inside.subs(d, d_max), s)[0]
    # above the bound (its mirror below follows, s' being odd in (s, d)) s falls at least at the rate h x (D0 + K0/Phi)
    beyond = inside.subs(d, d_max - _below).subs(s, bound + _outside)
    above = known.subs(sp.sign(s), 1).subs(s, LAYER + _outside).subs(d, d_max - _below)
    entered = sp.expand(above.subs(d_max, K0 + D0 * LAYER - _spare))
    odd = identical(known.subs({s: -s, d: -d}, simultaneous=True), -known)
    proved = (
        odd,
        sp.expand(sp.simplify(beyond)).equals(sp.expand(-SHARE * (_below + (D0 + K0 / LAYER) * _outside))),
        bool(sp.expand(-entered).is_positive),
        bool(sp.simplify(LAYER - bound.subs(d_max, K0 + D0 * LAYER - _spare)).is_nonnegative),
    )
    return Variant(
        "boundary layer",
        sp.factor(bound),
        all(map(bool, proved)),
        "s'/h < 0 above the layer, and <= -(D0 + K0/Phi) x within it at x above the bound, h = 1 + Td/Tb > 0",
    )


@cache
def dead_zone() -> Variant:
    """Boundary layer with theta_hat' = k_i s_D phi_i, s_D = s - Phi sat(s/Phi): V' <= -h D0 s_D^2, so |s| -> [0, Phi].

    V has s_D in place of s. Inside the layer s_D = 0, nothing moves theta_hat and V' = 0.
    """
    made = derive()
    above = _error_rate(made).subs(sp.sign(s), 1)
    # s > Phi, with s_D = x; below -Phi is its mirror
    value = (made.V_matrix.subs(s, s - LAYER)).diff(s) * above
    value -= sum(sp.diff(made.V_matrix, a) * b for a, b in zip(TILDE, RATE, strict=True))
    adaptation = sp.solve([sp.diff(value, a) for a in TILDE], RATE, dict=True)[0]
    final = value.subs(adaptation).subs(s, LAYER + _outside)
    final = sp.expand(final.subs(d, d_max - _below).subs(d_max, K0 + D0 * LAYER - _spare))
    drives = [(adaptation[a] - gain * (s - LAYER) * p) for a, gain, p in zip(RATE, GAINS, made.phi, strict=True)]
    proved = (
        all(sp.expand(one) == 0 for one in drives),
        not final.has(*TILDE),
        bool(sp.expand(-final - SHARE * D0 * _outside**2).is_nonnegative),
    )
    return Variant(
        "dead zone",
        -SHARE * D0 * _outside**2,
        all(proved),
        "above the layer -V'/h - D0 s_D^2 = x (slack of d) + x (spare gain) >= 0, h = 1 + Td/Tb",
    )


@cache
def projection() -> Variant:
    """theta_hat held in a box that contains theta: the cross term of V' is 0 inside and <= 0 on a face."""
    made = derive()
    rate = sp.expand(_lyapunov_rate(made, _error_rate(made)))
    cross = sp.expand(rate - rate.subs(dict.fromkeys(TILDE, 0)))
    free = dict(zip(RATE, made.adaptation_matrix, strict=True))
    distance, push = sp.Symbol("w", nonnegative=True), sp.Symbol("g", positive=True)
    signs = []
    for i, (tilde, phi) in enumerate(zip(TILDE, made.phi, strict=True)):
        other = {TILDE[1 - i]: 0}
        signs.append(sp.expand(cross.subs(free)) == 0)
        # upper face: theta_tilde = -w, and s phi_i = g > 0 wants to leave; lower face: both signs change
        for side in (1, -1):
            at_face = cross.subs(other).subs({RATE[0]: 0, RATE[1]: 0}).subs(tilde, -side * distance)
            signs.append(bool((-at_face).subs(s, side * push / phi).is_nonnegative))
    return Variant(
        "projection",
        sp.factor(rate.subs(free)),
        all(signs),
        "on a face that the free law would pass the cross term is -w g <= 0 (w >= 0 the distance of theta from it, "
        "g > 0 the push), else it is 0",
    )


@cache
def leak() -> Variant:
    """theta_hat_i' = k_i s phi_i - ell theta_hat_i, K0 >= d_max: V' <= -c V + ell V_theta, c = min(2 h D0, ell).

    V_theta = sum theta_i^2/(2 k_i), so V ends below ell V_theta/c for the smallest h.
    """
    made = derive()
    rate = _lyapunov_rate(made, _error_rate(made))
    leaking = {a: free - LEAK * hat for a, free, hat in zip(RATE, made.adaptation_matrix, HAT, strict=True)}
    hats = {hat: theta - tilde for hat, theta, tilde in zip(HAT, THETA, TILDE, strict=True)}
    rate = sp.expand(rate.subs(leaking).subs(hats))
    of_theta = sum(theta**2 / (2 * gain) for theta, gain in zip(THETA, GAINS, strict=True))
    of_error = sum(tilde**2 / (2 * gain) for tilde, gain in zip(TILDE, GAINS, strict=True))
    bound = -2 * SHARE * D0 * s**2 / 2 - LEAK * of_error + LEAK * of_theta
    # what is left is |s| (K0 - d sgn s) and ell theta_hat^2/(2 k): squares and a term that (40) makes positive
    slack = sp.expand(bound - rate)
    squares = sum(LEAK * (theta - tilde) ** 2 / (2 * g) for theta, tilde, g in zip(THETA, TILDE, GAINS, strict=True))
    rest = SHARE * (K0 * s * sp.sign(s) - s * d)
    return Variant(
        "sigma-modification",
        LEAK * of_theta / sp.Min(2 * SHARE * D0, LEAK),
        identical(slack, squares + rest),
        "V' is that bound less sum ell theta_hat_i^2/(2 k_i) + h |s| (K0 - d sgn s), not negative where K0 >= d_max",
    )


@cache
def matrix_gain() -> Variant:
    """theta_hat_i' = k_i s phi_i: the cross term vanishes for any two positive gains; V' = -(r/J)(D s^2 + K |s|)."""
    made = derive()
    rate = _lyapunov_rate(made, _error_rate(made).subs({d: 0, SHARE: 1}))
    final = sp.expand(rate.subs(dict(zip(RATE, made.adaptation_matrix, strict=True))))
    expected = -D0 * s**2 - K0 * s * sp.sign(s)
    return Variant("matrix gain", sp.factor(final), identical(final, expected), "the cross term vanishes identically")


# --- units: exponents of kg, m, s -----------------------------------------------------------------------------------

_UNITS = {"s": (0, 1, -1), "Ta": (1, 2, -2), "omega": (0, 0, -1), "s_rate": (0, 1, -2)}


def gain_units() -> tuple[str, str]:
    """Units of the gains of theta1 and theta2, from s' = theta' phi and theta_hat_i' = k_i s phi_i alone."""
    return tuple(_gain_unit(phi) for phi in ("Ta", "omega"))  # type: ignore[return-value]


def _gain_unit(phi: str) -> str:
    of_phi, of_s, of_rate = _UNITS[phi], _UNITS["s"], _UNITS["s_rate"]
    # theta = s'/phi, theta' one more 1/s, k = theta'/(s phi)
    exponents = [rate - 2 * a - b for rate, a, b in zip(of_rate, of_phi, of_s, strict=True)]
    exponents[2] -= 1
    parts = [f"{name}^{power}" for name, power in zip(("kg", "m", "s"), exponents, strict=True) if power]
    return " ".join(parts) or "1"


# --- a design ------------------------------------------------------------------------------------------------------


def robust_set(vehicle: Vehicle) -> ReachingSet:
    """The published run with the random force at `SIGMAS` deviations, theta_hat in `parameter_box`, estimates wrong."""
    first, second = parameter_box(vehicle)
    wrong = (-ESTIMATE_ERROR, ESTIMATE_ERROR)
    box = operating_set(vehicle, sigmas=SIGMAS)
    return replace(box, theta_hat1=first, theta_hat2=second, torque_error=wrong, rate_error=wrong)


def effective_torque(vehicle: Vehicle) -> float:
    """(J/r) d_max over `robust_set`, N*m: the least K of (40)."""
    return least_gain(vehicle, robust_set(vehicle))


def design_gain(vehicle: Vehicle) -> float:
    """K, N*m: `GAIN_MARGIN` over (40)'s for `robust_set`."""
    return GAIN_MARGIN * effective_torque(vehicle)


def layered_design(vehicle: Vehicle, *, K: float | None = None, D: float = PUBLISHED_LAW.D) -> LawGains:
    """Boundary layer, dead zone in the adaptation, projection, matrix gain; K of `design_gain` unless given."""
    return replace(
        PUBLISHED_LAW,
        K=design_gain(vehicle) if K is None else K,
        D=D,
        layer=LAYER_WIDTH,
        dead_zone=True,
        box=parameter_box(vehicle),
    )


def leaking_design(vehicle: Vehicle, *, K: float | None = None, D: float = PUBLISHED_LAW.D) -> LawGains:
    """Relay with the leak ell = 2 h D0 at the smallest h: the largest that costs nothing in the bound."""
    rate = slowest_rate(vehicle, D)
    return replace(PUBLISHED_LAW, K=design_gain(vehicle) if K is None else K, D=D, leak=rate)


def slowest_rate(vehicle: Vehicle, D: float) -> float:
    """2 h D0, 1/s, at the smallest h = 1 + Td/Tb."""
    return 2.0 * (1.0 - TORQUE_FRACTION) * vehicle.wheel.radius / vehicle.effective_inertia * D


def parameter_box(vehicle: Vehicle) -> tuple[tuple[float, float], tuple[float, float]]:
    """theta over empty to loaded mass and B from its nominal value to that of the longest stop, widened by a tenth."""
    worn = vehicle.wheel.model_copy(update={"viscous_friction": LOWEST_FRICTION})
    far = vehicle.model_copy(update={"mass": vehicle.mass_loaded, "wheel": worn})
    sides = []
    for corner in true_theta(far, vehicle):
        low, high = min(0.0, corner), max(0.0, corner)
        spare = _BOX_MARGIN * (high - low)
        sides.append((float(low - spare), float(high + spare)))
    return sides[0], sides[1]
