"""The reaching condition, [Park2008] (40), as a lower bound of the gain K over a box of operating points.

The disturbance d of s' is given as a torque, (J/r) d. The disturbance torque is Td = q Tb, with the acting torque
Tb = Ueq + D s + K sgn s. With |q| <= c < 1

    (J/r) s' sgn s = sgn s [(J/r) d(Tr, Fr) - q Ueq] - (1 + q)(D |s| + K),

so (40) requires K > (sgn s [...] + (J/r) eta)/(1 + q) - D |s|. The term D |s| lowers the bound
by its full value. Td raises the bound by up to c/(1 - c) |Ueq|, and Ueq contains (J/r) rho e. The law uses estimates
Ta_hat = (1 + a) Ta and v'_hat = (1 + b) v', whose errors are part of d, and the wheel inertia (1 + j) J.
The gain of the brake multiplies 1 + q.

The bound is affine in each of 1/M, Tr, Fr, Ta, v, slip, theta_hat1, theta_hat2, a, b and j, and monotone in q. So its
maximum over a box of these quantities is at a corner. The adhesion torque is an independent state, as in the bristle
model. Ta and Tr grow with the wheel load, which is convex in 1/M, so the maximum stays at a corner.

`search` looks for a counterexample with the s' that results from plant and law, including its term theta_tilde' phi.
The bound of K omits this term, because the adaptation cancels the term in V'.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any, Literal

import numpy as np
import sympy as sp

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.adhesion.base import RANDOM_SHARE
from railslip_ctrl.model.numeric import NumericPlant, numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Rail, Vehicle
from railslip_ctrl.sliding.derivation import Derivation, derive
from railslip_ctrl.sliding.generate import generated_law
from railslip_ctrl.sliding.law import PUBLISHED_LAW, LawGains
from railslip_ctrl.sliding.proof import sliding_symbol

ADHESION_NOISE = RANDOM_SHARE  #: standard deviation of the random adhesion force divided by the wheel load

TORQUE_FRACTION = 0.05  #: bound of |Td|/Tb for Td = 0.05 Tb exp(-4t) sin(10 pi t) ([Park2008] p. 55)
TORQUE_DECAY, TORQUE_FREQUENCY = 4.0, 10.0 * math.pi  #: decay, 1/s, and frequency, rad/s, of Td


def torque_share(time: Floats) -> Floats:
    """Return the ratio of the published disturbance torque Td to the acting brake torque; `time`, s, has any shape."""
    return np.asarray(TORQUE_FRACTION * np.exp(-TORQUE_DECAY * time) * np.sin(TORQUE_FREQUENCY * time))


LOWEST_SPEED_KMH = 5.0  #: speed at which the published stop ends ([Park2008] p. 56)
_VANISHING_SLIP = 1e-9  # slip of the largest steady-state adhesion: the curve jumps to it at slip 0+, then falls

Range = tuple[float, float]


@dataclass(frozen=True)
class ReachingSet:
    """Box of operating points over which the reaching condition (40) is decided; ranges are (lowest, highest).

    - random_torque: bound of |Tr|, N*m.
    - torque_fraction: c < 1 in |Td| <= c |Tb|.
    - resistance, adhesion_torque: ranges of Fr, N, and Ta, N*m.
    - speed, slip: ranges of v, m/s, and of the slip ratio; they give e = (lambda_d - slip) v, omega = (1 - slip) v/r.
    - mass: range of the true mass, kg, not multiplied by `vehicle.inertia_scale`.
    - theta_hat1, theta_hat2: ranges of the law's estimates, 1/(kg m) and m/s.
    - torque_error, rate_error: ranges of Ta_hat/Ta - 1 and v'_hat/v' - 1, ratios.
    - inertia_error: range of the relative error of the law's J.
    - brake_gain: largest relative error of the brake's gain, < 1.
    - torque_limits: limits of the command, N*m.
    - heavier: factor on Ta and Tr at the largest mass. It is 1 at the smallest mass and linear in the mass in between.
    """

    random_torque: float
    torque_fraction: float
    resistance: Range
    adhesion_torque: Range
    speed: Range
    slip: Range
    mass: Range
    theta_hat1: Range = (0.0, 0.0)
    theta_hat2: Range = (0.0, 0.0)
    torque_error: Range = (0.0, 0.0)
    rate_error: Range = (0.0, 0.0)
    inertia_error: Range = (0.0, 0.0)
    brake_gain: float = 0.0
    torque_limits: Range = (-math.inf, math.inf)
    heavier: float = 1.0

    @property
    def share(self) -> Range:
        """Range of (acting torque + Td)/commanded torque - 1, a ratio, over Td and the brake's gain."""
        c, g = self.torque_fraction, self.brake_gain
        return (1.0 - c) * (1.0 - g) - 1.0, (1.0 + c) * (1.0 + g) - 1.0


def reference_set(vehicle: Vehicle, *, sigmas: float, with_torque: bool = True) -> ReachingSet:
    """Return a box with only the reference point of the published run: 100 km/h, dry, e = 0, steady-state adhesion.

    The random force is at most `sigmas` standard deviations. `with_torque=False` neglects Td.
    """
    slip, speed = reference_slip(), INITIAL_SPEED_KMH * KMH
    torque = rest_adhesion_torque(vehicle, speed, slip)
    return ReachingSet(
        random_torque=vehicle.wheel.radius * sigmas * ADHESION_NOISE * vehicle.wheel_load,
        torque_fraction=TORQUE_FRACTION if with_torque else 0.0,
        resistance=(0.0, vehicle.resistance.force(speed)),
        adhesion_torque=(torque, torque),
        speed=(speed, speed),
        slip=(slip, slip),
        mass=(vehicle.mass, vehicle.mass),
    )


def operating_set(vehicle: Vehicle, *, sigmas: float) -> ReachingSet:
    """Return the box of the published run, dry: 100 to 5 km/h, slip 0 to twice the reference, empty to loaded."""
    # the adhesion torque starts at 0 (z = 0), and is independent of the slip in the box
    return replace(
        reference_set(vehicle, sigmas=sigmas),
        adhesion_torque=(0.0, vanishing_slip_torque(vehicle)),
        speed=(LOWEST_SPEED_KMH * KMH, INITIAL_SPEED_KMH * KMH),
        slip=(0.0, 2.0 * reference_slip()),
        mass=(vehicle.mass, vehicle.mass_loaded),
        heavier=load_ratio(vehicle),
    )


def load_ratio(vehicle: Vehicle) -> float:
    """Return the ratio of loaded to empty wheel load; if these are equal, the ratio of loaded to empty mass."""
    if vehicle.wheel_load_loaded != vehicle.wheel_load:
        return vehicle.wheel_load_loaded / vehicle.wheel_load
    return vehicle.mass_loaded / vehicle.mass


def reference_slip(rail: Rail = Rail.DRY) -> float:
    """Return the reference slip of the published bristle model on a rail."""
    slip = published_law("bristle", rail).reference_slip(rail)
    assert slip is not None, "the bristle model has a published reference"
    return slip


def bristle_plant(vehicle: Vehicle, rail: Rail = Rail.DRY) -> tuple[NumericPlant, tuple[float, ...]]:
    """Return numeric functions and parameters of the plant with the published bristle model."""
    law = published_law("bristle", rail, wheel_load=vehicle.wheel_load)
    return numeric_plant(type(law)), plant_parameters(law, vehicle)


def rest_adhesion_torque(vehicle: Vehicle, speed: float, slip: float, rail: Rail = Rail.DRY) -> float:
    """Return the steady-state Ta (z' = 0), N*m, of the bristle model at a speed, m/s, and a slip ratio."""
    functions, p = bristle_plant(vehicle, rail)
    z = functions.rest_state(speed, slip * speed, 0.0, 0.0, 0.0, 0.0, p)
    return vehicle.wheel.radius * float(functions.force(speed, slip * speed, z, 0.0, 0.0, 0.0, p))


def vanishing_slip_torque(vehicle: Vehicle, rail: Rail = Rail.DRY) -> float:
    """Return the largest steady-state Ta, N*m: that at 100 km/h and a slip just above 0."""
    return rest_adhesion_torque(vehicle, INITIAL_SPEED_KMH * KMH, _VANISHING_SLIP, rail)


def with_friction(vehicle: Vehicle, friction: float) -> Vehicle:
    """Return the vehicle with another viscous friction, N m s."""
    wheel = vehicle.wheel.model_copy(update={"viscous_friction": friction})
    return vehicle.model_copy(update={"wheel": wheel})


@cache
def derived(arguments: str, which: str) -> Callable[..., Any]:
    """Return the field `which` of `Derivation` as a function in SI units of the symbols named in `arguments`."""
    symbols = [getattr(plant, name, None) or sliding_symbol(name) for name in arguments.split()]
    expression = getattr(derive(), which)
    if which == "adaptive_law_control":  # `switch` stands for sgn s
        symbols.append(switch := sp.Symbol("switch", real=True))
        expression = expression.subs(sp.sign(_s), switch)
    made: Callable[..., Any] = sp.lambdify(symbols, expression, "numpy", cse=True)
    return made


def true_theta(vehicle: Vehicle, nominal: Vehicle) -> Floats:
    """Return a vehicle's theta, [Park2008] (44) corrected, 1/(kg m) and m/s, for a law that assumes `nominal`."""
    Mn, Bn = nominal.effective_mass, nominal.effective_viscous_friction
    known = (vehicle.wheel.radius, vehicle.effective_inertia)
    perturbation = (vehicle.effective_mass - Mn, vehicle.effective_viscous_friction - Bn)
    return np.asarray(derived("r J Mn Mp Bp", "theta")(*known, Mn, *perturbation), dtype=float)


def law_parameters(**values: float) -> Any:
    """Return the generated law's parameters: `values`, and defaults without boundary layer and torque limits."""
    free = {"boundary": 0.0, "torque_min": -np.inf, "torque_max": np.inf, "period": 1.0, "filter_time": 1.0}
    return generated_law().Parameters(**{**free, **values})


_FRACTION = sp.Symbol("q", real=True)  # Td/Tb
_SIDE = sp.Symbol("side", real=True)  # sgn s, 1 or -1
_INVERSE_MASS = sp.Symbol("m_inverse", positive=True)
_SLIP = sp.Symbol("slip", real=True)
_s, _K, _e, _lambda = (sliding_symbol(name) for name in ("s", "K", "e", "lambda_d"))
_HATS = tuple(sliding_symbol(f"theta{i}_hat") for i in (1, 2))
_Mn, _Mp, _Bn, _rho = (sliding_symbol(name) for name in ("Mn", "Mp", "Bn", "rho"))

_ERRORS = (sp.Symbol("a", real=True), sp.Symbol("b", real=True))  # Ta_hat/Ta - 1, v'_hat/v' - 1
_INERTIA_ERROR = sp.Symbol("j", real=True)  # J of the law divided by the wheel's J, minus 1

BOX_VARIABLES = (_INVERSE_MASS, plant.Tr, plant.Fr, plant.Ta, plant.v, _SLIP, *_HATS, *_ERRORS, _INERTIA_ERROR)
"""Variables of `required_gain`; the K that (40) requires is affine in each of them."""

_PARAMETERS = (_SIDE, _FRACTION, _rho, _lambda, plant.J, plant.r, _Mn, _Bn)


def effective_rate(made: Derivation, share: sp.Expr) -> sp.Expr:
    """Return s', m/s^2, under the law [Park2008] (45), without the term theta_tilde' phi_hat.

    `share` is the ratio of acting to commanded torque; phi_hat = (Ta_hat, omega).
    """
    estimates = (plant.Ta * (1 + _ERRORS[0]), plant.v_rate * (1 + _ERRORS[1]))
    seen = dict(zip((plant.Ta, plant.v_rate), estimates, strict=True))
    hats = dict(zip((sliding_symbol("Ta_hat"), sliding_symbol("v_rate_hat")), estimates, strict=True))
    # Td is a fraction of the law's torque, which contains the estimates
    commanded = sp.expand(made.adaptive_law_control.subs(seen))
    acting = share * commanded.subs(plant.J, plant.J * (1 + _INERTIA_ERROR)) - commanded
    disturbed = made.error_dynamics.subs(plant.Td, acting)
    tilde = [sliding_symbol(f"theta{i}_tilde") for i in (1, 2)]
    taken = sum(one * phi.subs(seen) for one, phi in zip(tilde, made.phi, strict=True))
    rate = disturbed + made.estimation_disturbance.subs(hats) - taken
    true = {one: theta - hat for one, theta, hat in zip(tilde, made.theta, _HATS, strict=True)}
    return sp.expand(rate.subs(true))


@cache
def required_gain() -> Callable[..., Any]:
    """Return a function of `BOX_VARIABLES` and `_PARAMETERS`: the K, N*m, with which `effective_rate` is 0 at s = 0.

    ArithmeticError if K is not affine in each of the variables.
    """
    rate = effective_rate(derive(), 1 + _FRACTION)
    approach = sp.expand(_SIDE * rate.subs(sp.sign(_s), _SIDE).subs(_s, 0)).subs(_SIDE**2, 1)
    slope = sp.expand(sp.diff(approach, _K))  # `approach` is linear in K
    train = sp.solve(plant.TRAIN.subs(plant.Fa, sp.solve(plant.ADHESION_TORQUE, plant.Fa)[0]), plant.v_rate)[0]
    rest = approach.subs(_K, 0).subs(plant.v_rate, train.subs(plant.M, _Mn + _Mp)).subs(_Mp, 1 / _INVERSE_MASS - _Mn)
    wheel_speed = sp.solve(plant.SLIP_VELOCITY, plant.omega)[0].subs(plant.sigma, _SLIP * plant.v)
    rest = sp.expand(rest.subs({_e: (_lambda - _SLIP) * plant.v, plant.omega: wheel_speed}))
    # if rest and slope are linear in q, K = -rest/slope is monotone in q
    if any(sp.diff(rest, x, 2) != 0 for x in (*BOX_VARIABLES, _FRACTION)) or sp.diff(slope, _FRACTION, 2) != 0:
        raise ArithmeticError(
            "K: the gain that (40) of [Park2008] requires is not affine in each variable of the box, because the plant "
            "was changed; adapt the proof"
        )
    made: Callable[..., Any] = sp.lambdify([*BOX_VARIABLES, *_PARAMETERS], -rest / slope, "numpy", cse=True)
    return made


def least_gain(vehicle: Vehicle, box: ReachingSet, *, rho: float = PUBLISHED_LAW.rho) -> float:
    """Return the least K, N*m, >= 0, above which the reaching condition (40) holds over the box for every s."""
    return max(0.0, float(np.max(_at_corners(vehicle, box, rho))))


def _at_corners(vehicle: Vehicle, box: ReachingSet, rho: float = PUBLISHED_LAW.rho) -> Any:
    random = (-box.random_torque, box.random_torque)
    axes = (random, box.resistance, box.adhesion_torque, box.speed, box.slip, box.theta_hat1, box.theta_hat2)
    errors, sides = (box.torque_error, box.rate_error, box.inertia_error), ((-1.0, 1.0), box.share)
    loads = ((box.mass[0], 1.0), (box.mass[1], box.heavier))
    corners = [
        (1.0 / (vehicle.inertia_scale * mass), factor * Tr, Fr, factor * Ta, *others)
        for mass, factor in loads
        for Tr, Fr, Ta, *others in product(*axes, *errors, *sides)
    ]
    parameters = (rho, reference_slip(), vehicle.effective_inertia, vehicle.wheel.radius)
    nominal = (vehicle.effective_mass, vehicle.effective_viscous_friction)
    return required_gain()(*np.array(corners).T, *parameters, *nominal)


def surface_needed(vehicle: Vehicle, box: ReachingSet, *, K: float, D: float) -> float:
    """Return the least |s|, m/s, at which D |s| (D > 0) makes up for a K, N*m, below `least_gain`; 0 if K suffices."""
    return max(0.0, least_gain(vehicle, box) - K) / D


def reaching_time(vehicle: Vehicle, *, K: float, D: float, start: float) -> float:
    """Return the time in seconds in which s falls from `start` (m/s) to 0 without disturbances; inf for K = 0."""
    if K == 0.0:
        return math.inf
    return math.log1p(D * abs(start) / K) * vehicle.effective_inertia / (vehicle.wheel.radius * D)


def tolerated_error(
    vehicle: Vehicle, box: ReachingSet, name: Literal["torque_error", "rate_error"], *, K: float
) -> float:
    """Return the largest relative error `name` for which K (N*m) satisfies (40) over the box; 0 if there is none."""
    # exact, because the K that (40) requires is affine in the error
    errors: tuple[dict[str, Any], ...] = ({name: (0.0, 0.0)}, {name: (-1.0, 1.0)})
    exact, wrong = (_at_corners(vehicle, replace(box, **error)) for error in errors)
    if np.max(exact) >= K:
        return 0.0
    grows = wrong > exact
    return float(np.min((K - exact[grows]) / (wrong - exact)[grows], initial=math.inf))


SEARCHED = ("v", "slip", "Ta", "M", "Tr", "share", "theta_hat1", "theta_hat2", "a", "b", "j", "side")
"""Coordinates of the search, in this order.

Units: m/s, 1, N*m, kg, N*m, 1, 1/(kg m), m/s, and 1 for the others. share: see `ReachingSet.share`; a, b: relative
errors of Ta_hat and v'_hat; j: relative error of the law's J; side: a number with the sign of s.
"""

_RANDOM_POINTS, _STARTS = 20_000, 2  # random points, and best points from which the optimiser starts


@dataclass(frozen=True)
class WorstPoint:
    """Result of `search`: largest s s'/|s| (`excess`, m/s^2), the point where it occurs, and number of evaluations."""

    excess: float
    point: tuple[float, ...]
    evaluations: int


def approach(
    points: Floats, vehicle: Vehicle, gains: LawGains, surface: float = 0.0, *, limits: Range = (-math.inf, math.inf)
) -> Floats:
    """Return s s'/|s|, m/s^2, of the plant on dry rail under the law [Park2008] (45).

    - points: (12, n), the coordinates `SEARCHED` of n points.
    - surface: |s|, m/s, which is independent of e because s contains the integral of e.
    - limits: lower and upper limit of the command, N*m.
    """
    v, slip, Ta, mass, Tr, fraction, theta1, theta2, a, b, j, side = points
    functions, parameters = bristle_plant(vehicle)
    slip_d, r, sign = reference_slip(), vehicle.wheel.radius, np.where(side >= 0, 1.0, -1.0)
    sigma, J, B = slip * v, vehicle.effective_inertia, vehicle.effective_viscous_friction
    p = (vehicle.inertia_scale * mass, *parameters[1:])
    # the force is proportional to the adhesion state
    z = Ta / (r * functions.force(v, sigma, np.ones_like(v), 0.0, 0.0, 0.0, p))
    v_rate = functions.rates(v, sigma, z, 0.0, 0.0, Tr, p)[0]
    e = slip_d * v - sigma
    control = derived("s e v_rate Ta omega theta1_hat theta2_hat J r D K rho lambda_d Mn Bn", "adaptive_law_control")
    measured = (sign * surface, e, (1.0 + b) * v_rate, (1.0 + a) * Ta, (v - sigma) / r, theta1, theta2)
    known = (gains.D, gains.K, gains.rho, slip_d, vehicle.effective_mass, B)
    Tb = np.clip(control(*measured, (1.0 + j) * J, r, *known, sign), *limits)
    rates = functions.rates(v, sigma, z, Tb, fraction * Tb, Tr, p)
    return np.asarray(sign * (slip_d * rates[0] - rates[1] + gains.rho * e), dtype=float)


def search(box: ReachingSet, vehicle: Vehicle, gains: LawGains, *, seed: int, known_mass: bool = False) -> WorstPoint:
    """Search for the largest s s'/|s| as s -> 0 at corners and random points of the box, then by L-BFGS-B.

    With `known_mass=True` theta_hat1 is the true theta1 of each point; otherwise the box gives its range.
    """
    from scipy.optimize import minimize

    corners = np.array(list(product((0.0, 1.0), repeat=len(SEARCHED)))).T
    inside = np.random.default_rng(seed).random((len(SEARCHED), _RANDOM_POINTS))
    evaluated = 0

    def points_at(shares: Floats) -> Floats:
        points = points_of(box, shares)
        if known_mass:
            points[6] = (1.0 / points[3] - 1.0 / vehicle.mass) / vehicle.inertia_scale / vehicle.wheel.radius
        return points

    def value(shares: Floats) -> Floats:
        nonlocal evaluated
        columns = shares.reshape(len(SEARCHED), -1)
        evaluated += columns.shape[1]
        return approach(points_at(columns), vehicle, gains, limits=box.torque_limits)

    tried = np.hstack((corners, inside))
    starts = tried[:, np.argsort(value(tried))[-_STARTS:]].T
    found = [minimize(lambda x: -float(value(x)[0]), x, bounds=[(0.0, 1.0)] * len(SEARCHED)) for x in starts]
    best = min(found, key=lambda one: float(one.fun))
    return WorstPoint(-float(best.fun), tuple(points_at(best.x[:, None])[:, 0].tolist()), evaluated)


def points_of(box: ReachingSet, shares: Floats) -> Floats:
    """Return points of the box, (12, n); `shares`, (12, n), are 0 at the lower and 1 at the upper end of a range."""
    random = (-box.random_torque, box.random_torque)
    known = (box.theta_hat1, box.theta_hat2, box.torque_error, box.rate_error, box.inertia_error)
    sides = (box.speed, box.slip, box.adhesion_torque, box.mass, random, box.share, *known, (-1.0, 1.0))
    low, high = np.array(sides).T[:, :, None]
    points = np.asarray(low + (high - low) * shares, dtype=float)
    points[[2, 4]] *= 1.0 + (box.heavier - 1.0) * shares[3]
    return points
