"""The models that can be fitted: law, free parameters, starting values and bounds of each model.

The model "bristle" is fitted twice: to the measured curve, with the force that builds up while the slip velocity rises
at a constant rate ([Park2008] Fig. 17), and to the wheel's motion (`prediction`). Only the second fit determines alpha.
"bristle_rest" and "lugre" are fitted with their steady-state force, and only to the sliding regime.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, shown
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.model.adhesion import INITIAL_SPEED_RANGE_KMH, AdhesionLaw, law_class
from railslip_ctrl.model.adhesion.bristle import published_coefficients
from railslip_ctrl.model.adhesion.curve import SLIP_ACCELERATION
from railslip_ctrl.model.adhesion.polach import KALKER_C11, SEMI_AXIS, SHEAR_MODULUS
from railslip_ctrl.model.numeric import numeric_plant
from railslip_ctrl.model.vehicle import Rail

from .curves import Cells
from .messages import message

# --- coordinates of the search ---------------------------------------------------------------------------------------

# In the search coordinates the force of a model is nearly linear. The steady-state force of the bristles is
# (gamma - |sigma|)/beta; if a log hardly shows that this force falls, beta and gamma could grow together without bound.

FLAT = 1e-6  #: lower bound of (least gamma)/gamma; with a smaller ratio the fall of the force would not be visible

_TINY = 1e-12  # lower bound that represents an open bound of 0
_SMALL = 0.01  # least size of a coordinate, relative to its typical value
_SMALLEST = 1e-9  # least size of a coordinate, absolute


@dataclass(frozen=True)
class Coordinates:
    """Search coordinates of the free parameters: their bounds, and the conversion from and to parameter values.

    The coordinate of a parameter is its value; `pair` and `inverse` give the exceptions, for beta and gamma.
    """

    names: tuple[str, ...]
    least: Floats  # lower bounds of the values
    most: Floats  # upper bounds of the values
    typical: Floats  # values of usual size
    lower: Floats  # lower bounds of the coordinates
    upper: Floats  # upper bounds of the coordinates
    pair: tuple[int, int] | None = None  # indices of beta and gamma with the coordinates gamma/beta and 1/gamma
    inverse: int | None = None  # index of beta with the coordinate 1/beta

    @classmethod
    def of(cls, names: tuple[str, ...], least: Floats, most: Floats, typical: Floats) -> Coordinates:
        low, high, ends = least.copy(), most.copy(), (least, most)
        b = names.index("beta") if "beta" in names else None
        if b is None:
            return cls(names, *ends, typical, low, high)
        if "gamma" not in names:
            low[b], high[b] = max(1.0 / most[b], _TINY), 1.0 / least[b]
            return cls(names, *ends, typical, low, high, inverse=b)
        if least[b] > _TINY or np.isfinite(most[b]):  # bounds of beta are not bounds of the level or of 1/gamma
            return cls(names, *ends, typical, low, high)
        g = names.index("gamma")
        low[b], high[b] = _TINY, np.inf
        low[g], high[g] = max(1.0 / most[g], FLAT / least[g]), 1.0 / least[g]
        return cls(names, *ends, typical, low, high, pair=(b, g))

    def without(self, index: int) -> Coordinates:
        others = np.arange(len(self.names)) != index
        names = tuple(name for i, name in enumerate(self.names) if i != index)
        return Coordinates.of(names, self.least[others], self.most[others], self.typical[others])

    def at(self, values: Floats) -> Floats:
        """Convert parameter values to search coordinates."""
        x = np.array(values, dtype=float)
        if self.pair is not None:
            b, g = self.pair
            x[b], x[g] = values[g] / values[b], 1.0 / values[g]
        elif self.inverse is not None:
            x[self.inverse] = 1.0 / values[self.inverse]
        return x

    def values(self, x: Floats) -> Floats:
        """Convert search coordinates to parameter values."""
        values = np.array(x, dtype=float)
        if self.pair is not None:
            b, g = self.pair
            values[b], values[g] = 1.0 / (x[b] * x[g]), 1.0 / x[g]
        elif self.inverse is not None:
            values[self.inverse] = 1.0 / x[self.inverse]
        return values

    def slopes(self, x: Floats) -> Floats:
        """Derivatives of the parameter values (rows) with respect to the coordinates (columns)."""
        result, values = np.eye(len(x)), self.values(x)
        if self.pair is not None:
            b, g = self.pair
            result[b, b], result[b, g] = -values[b] / x[b], -values[b] / x[g]
            result[g, g] = -values[g] / x[g]
        elif self.inverse is not None:
            result[self.inverse, self.inverse] = -values[self.inverse] / x[self.inverse]
        return result

    def sizes(self, x: Floats) -> Floats:
        """Magnitude of each coordinate, or a lower limit if the magnitude is smaller."""
        result: Floats = np.maximum(np.abs(x), _SMALL * np.abs(self.at(self.typical)))
        return np.maximum(result, _SMALLEST)

    def inside(self, x: Floats, margin: float) -> Floats:
        """Move the coordinates x away from their bounds, to a distance of `margin` times `sizes`."""
        off = margin * self.sizes(x)
        low, high = self.lower + off, self.upper - off
        return np.where(low < high, np.clip(x, low, np.maximum(low, high)), np.clip(x, self.lower, self.upper))

    # --- single parameters ------------------------------------------------------------------------------------------

    def by_inverse(self, index: int) -> bool:
        return index == self.inverse or (self.pair is not None and index in self.pair)

    def represented(self, index: int, value: float) -> float:
        """Return 1/`value` for a parameter whose coordinate is an inverse, else `value`."""
        return 1.0 / value if self.by_inverse(index) else value

    def range_of(self, index: int, x: Floats) -> tuple[float, float]:
        """Bounds of the number that `represented` returns, in a search that starts at the coordinates x."""
        if self.pair is not None and index == self.pair[0]:
            return float(x[index] * self.lower[self.pair[1]]), float(1.0 / self.least[index])
        return float(self.lower[index]), float(self.upper[index])

    def moved(self, values: Floats, index: int, value: float) -> Floats:
        result = values.copy()
        if self.pair is not None and index in self.pair:
            other = self.pair[1 - self.pair.index(index)]
            result[other] *= value / values[index]
        result[index] = value
        return result


# --- a model and its known quantities --------------------------------------------------------------------------------

TABLE_KNOTS = 25  #: largest number of knots of a fitted table; resolves a curve with one peak to 0.3 % of its height

_ROWS_A_KNOT = 8  # least rows for each value of a table; with fewer rows the table would follow the noise
_LEAST_KNOTS = 5
_LAW_POINTS = 8  # points of the lookup table for each knot; its monotone cubics then follow the spline to 1e-4 of mu


@dataclass(frozen=True)
class Setting:
    """Known quantities of a fit, and the settings by the user."""

    wheel_load: float  # N
    initial_speed: float  # v0, m/s
    slip_acceleration: float | None  # R measured on the slip ramps of the log, m/s^2
    given_acceleration: float | None = None  # R given by the user, m/s^2
    rail: Rail = Rail.DRY
    fixed: Mapping[str, float] = field(default_factory=dict)  # values given by the user, SI
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # given by the user, SI
    acceleration_spread: float | None = None  # standard deviation of R from run to run, m/s^2


@dataclass(frozen=True)
class Shape:
    """Features of the measured curve, from which the starting values of the fits are computed."""

    slope: float  # dmu/dslip at low slip
    peak_slip: float  # slip ratio of the highest mu
    peak: float  # mu at this slip
    end_slip: float  # slip ratio near the largest slip
    end: float  # mu at this slip
    speed: float  # mean train speed, m/s


@dataclass(frozen=True)
class FitModel:
    """A model to be fitted: adhesion law, free parameters, starting values and bounds."""

    name: str
    law: type[AdhesionLaw]  # class of the fitted law
    force_law: type[AdhesionLaw]  # class whose force is fitted to the measured curve; "bristle": `curve`
    names: tuple[str, ...]  # free parameters
    starts: Floats  # sets of starting values, (sets, names)
    lower: Floats  # bounds of the values
    upper: Floats
    known: Mapping[str, float | tuple[float, ...]]  # values of the other parameters
    notes: tuple[str, ...] = ()

    def coefficient(self, values: Floats, slip: Floats, speed: Floats, wheel_load: float | Floats) -> Floats:
        """mu of the model with the parameter `values`; 0 outside the domain of the adhesion law.

        `slip` (ratio) and `speed` (m/s) are arrays of equal shape; `wheel_load` (N) is a number or such an array.
        """
        if self.name == "table":
            return np.asarray(spline(self.knots, values)(np.clip(slip, 0.0, self.knots[-1])))
        functions = numeric_plant(self.force_law)
        p = (*_NO_VEHICLE, wheel_load, *self._flat(values))
        sigma = slip * speed
        z = functions.rest_state(speed, sigma, 0.0, 0.0, 0.0, 0.0, p)
        mu = np.asarray(functions.force(speed, sigma, z, 0.0, 0.0, 0.0, p), dtype=float) / wheel_load
        return np.where(np.isfinite(mu), mu, 0.0)

    @property
    def coordinates(self) -> Coordinates:
        typical = np.abs(self.starts).max(axis=0)
        if self.name == "table":  # all values are mu, so they share one size
            typical[:] = typical.max()
        return Coordinates.of(self.names, self.lower, self.upper, typical)

    def unit(self, name: str) -> str:
        """SI unit of the parameter `name`; "1" for the values of a table."""
        return self.force_law.units().get(name, "1")

    @property
    def knots(self) -> Floats:
        return np.array(self.known["slip"])

    def with_knots(self, kept: Sequence[int]) -> FitModel:
        """Return the table with only those knots whose indices are in `kept`."""
        return replace(
            self,
            names=tuple(self.names[i] for i in kept),
            starts=self.starts[:, kept],
            lower=self.lower[kept],
            upper=self.upper[kept],
            known={"slip": tuple(self.knots[kept].tolist())},
        )

    def _flat(self, values: Floats) -> tuple[float, ...]:
        given = {**self.known, **dict(zip(self.names, values, strict=True))}
        return tuple(float(given[name]) for name in self.force_law.parameter_names())

    def make(self, values: Floats, rail: Rail) -> AdhesionLaw:
        return self._made(self.law, values, rail)

    def make_force_law(self, values: Floats, rail: Rail) -> AdhesionLaw:
        """Return the law that is fitted to the measured curve (class `force_law`), with the parameter `values`."""
        return self._made(self.force_law, values, rail)

    def _made(self, law: type[AdhesionLaw], values: Floats, rail: Rail) -> AdhesionLaw:
        if self.name == "table":
            knots = np.append(0.0, self.knots)
            slip = np.interp(np.arange(1, _LAW_POINTS * len(values) + 1) / _LAW_POINTS, np.arange(len(knots)), knots)
            mu = np.maximum(spline(self.knots, values)(slip), 0.0)
            return law.model_validate({"slip": tuple(slip.tolist()), "mu": tuple(mu.tolist()), "rail": rail})
        given = {**self.known, **dict(zip(self.names, values.tolist(), strict=True))}
        return law.model_validate({**{name: given[name] for name in law.parameter_names()}, "rail": rail})


@lru_cache(maxsize=64)
def _cardinal_splines(knots: tuple[float, ...]) -> Any:
    from scipy.interpolate import CubicSpline

    return CubicSpline((0.0, *knots), np.eye(len(knots) + 1)[:, 1:])


def spline(knots: Floats, values: Floats) -> Callable[[Floats], Floats]:
    """Cubic spline through (0, 0) and `values` at `knots`; `values` of shape (knots, k) give k splines."""
    from scipy.interpolate import PPoly

    each = _cardinal_splines(tuple(knots.tolist()))
    return PPoly(each.c @ np.asarray(values), each.x)  # type: ignore[no-any-return]


_NO_VEHICLE = (1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)  # placeholders for vehicle data; the force needs only N


def shape_of(cells: Cells, peak_slip: float) -> Shape:
    """Compute the features of the measured curve; `peak_slip` is the slip ratio of the highest mu."""
    order = np.argsort(cells.slip)
    slip, mu, n = cells.slip[order], cells.mu[order], cells.count[order]
    near = np.abs(slip - peak_slip) <= 0.1 * peak_slip
    last = slip >= slip[-1] - 0.1 * (slip[-1] - slip[0])
    first = slip <= max(0.3 * peak_slip, slip[0])
    return Shape(
        slope=max(float(np.sum(n * mu * slip * first) / np.sum(n * slip**2 * first)), 1e-3),
        peak_slip=peak_slip,
        peak=max(float(np.average(mu[near], weights=n[near])) if near.any() else float(mu.max()), 1e-3),
        end_slip=float(np.average(slip[last], weights=n[last])),
        end=max(float(np.average(mu[last], weights=n[last])), 1e-4),
        speed=float(np.average(cells.speed, weights=cells.count)),
    )


def fit_model(name: str, cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    """Prepare the model `name` for a fit to the cells; InputError for an unknown name or empty bounds."""
    check_model(name)
    model = _MODELS[name](cells, shape, setting)
    return _restricted(model, setting)


def check_model(name: str) -> None:
    """Raise InputError with the known names if `name` is neither a model nor "best"."""
    if name != "best" and name not in _MODELS:
        hint = close_match(name, _MODELS)
        raise InputError(f"`model`: {shown(name)} cannot be fitted; {hint}choose 'best' or one of {', '.join(_MODELS)}")


def check_options(names: Sequence[str], fixed: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raise InputError if no model in `names` has a given parameter, or if a fixed value is outside its bounds."""
    known = {p for name in names for p in law_class(_LAWS[name]).parameter_names()}
    for option, given in (("`fixed`", fixed), ("`bounds`", bounds)):
        for parameter in given:
            if parameter not in known:
                raise InputError(
                    message("no parameter", option=option, name=shown(parameter), known=", ".join(sorted(known)))
                )
    for name in fixed.keys() & bounds.keys():
        low, high = bounds[name]
        if not low <= fixed[name] <= high:
            raise InputError(message("fixed outside", name=name, value=fixed[name], low=low, high=high))


def _restricted(model: FitModel, setting: Setting) -> FitModel:
    fixed = {name: value for name, value in setting.fixed.items() if name in (*model.names, *model.known)}
    keep = [i for i, name in enumerate(model.names) if name not in fixed]
    names = tuple(model.names[i] for i in keep)
    lower, upper = model.lower[keep].copy(), model.upper[keep].copy()
    for i, name in enumerate(names):
        low, high = setting.bounds.get(name, (-math.inf, math.inf))
        if not low < high:
            raise InputError(f"`bounds` {name}: {low:g}:{high:g} is not allowed; give the lower bound first")
        lower[i], upper[i] = max(lower[i], low), min(upper[i], high)
        if not lower[i] < upper[i]:
            raise InputError(
                f"`bounds` {name}: {low:g} to {high:g} has no allowed value; include values > {lower[i]:g}"
            )
    if not names:
        raise InputError(f"`fixed`: every parameter of {model.name!r} is fixed; leave one to be fitted")
    starts = np.clip(model.starts[:, keep], lower, upper)
    known = {**model.known, **fixed}
    return replace(model, names=names, starts=starts, lower=lower, upper=upper, known=known)


# --- the models ----------------------------------------------------------------------------------------------------


def _build(
    name: str,
    starts: Sequence[Mapping[str, float]],
    known: Mapping[str, float],
    *,
    lower: Mapping[str, float] | None = None,
) -> FitModel:
    law = law_class(name)
    names = tuple(starts[0])
    least = {**dict.fromkeys(names, 0.0), **(lower or {})}
    most = {**dict.fromkeys(names, math.inf), **({"A": 1.0} if name == "polach" else {})}
    return FitModel(
        name,
        law,
        law,
        names,
        np.array([[start[n] for n in names] for start in starts]),
        # a bound of 0 is open for most parameters; a tiny number represents it
        np.array([max(least[n], _TINY) for n in names]),
        np.array([most[n] for n in names]),
        known,
    )


def _beam(cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    mu_max = 1.1 * shape.peak
    a = max((mu_max - shape.end) / (shape.end_slip * shape.speed), 1e-4)
    Kx = 3.0 * mu_max * setting.wheel_load / shape.peak_slip
    return _build("beam", [{"mu_max": mu_max, "a": a, "Kx": f * Kx} for f in (0.7, 1.3)], {})


def _bristle_starts(shape: Shape, setting: Setting, R: float) -> tuple[Mapping[str, float], float]:
    v0, load = setting.initial_speed, setting.wheel_load
    fall = max(shape.peak - shape.end, 0.02 * shape.peak) * load
    slid = max(shape.end_slip - shape.peak_slip, 0.1 * shape.end_slip) * v0
    beta = slid / fall
    gamma = shape.end_slip * v0 + beta * shape.end * load
    # along a ramp the force begins as alpha s^2/(2 R); the peak is near 4 times the s at which this is the peak force
    alpha = 9.0 * R * shape.peak * load / (shape.peak_slip * v0) ** 2
    return {"alpha": alpha, "beta": beta, "gamma": gamma}, v0


def _curve(cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    R = SLIP_ACCELERATION if setting.given_acceleration is None else setting.given_acceleration
    built = _built_up(cells, shape, setting, R)
    return replace(built, notes=(message("alpha by R", R=R),))


def _built_up(cells: Cells, shape: Shape, setting: Setting, R: float) -> FitModel:
    start, v0 = _bristle_starts(shape, setting, R)
    starts = [{**start, "alpha": f * start["alpha"]} for f in (0.4, 1.0, 2.5)]
    beyond = 1.0001 * float(cells.nodes.max()) * v0
    return _build("curve", starts, {"R": R, "v0": v0}, lower={"gamma": beyond})


def _bristle(cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    R = setting.given_acceleration or setting.slip_acceleration
    if R is None:
        raise InputError(message("no ramp"))
    built = _built_up(cells, shape, setting, R)
    return replace(built, name="bristle", law=law_class("bristle"), notes=(message("built up", R=R),))


def _stiffness(setting: Setting) -> float:
    # [Park2008] (30); it has no effect on a steady-state force
    low, high = INITIAL_SPEED_RANGE_KMH
    return published_coefficients(min(max(setting.initial_speed / KMH, low), high), setting.wheel_load)[0]


def _at_rest(model: FitModel, name: str, kept: str) -> FitModel:
    return replace(model, name=name, notes=("fitted to the sliding regime only", message("kept", names=kept)))


def _bristle_rest(cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    start, _ = _bristle_starts(shape, setting, 1.0)
    beyond = 1.0001 * float((cells.nodes * cells.node_speeds).max())
    starts = [{name: start[name] for name in ("beta", "gamma")}]
    model = _build("bristle", starts, {"alpha": _stiffness(setting)}, lower={"gamma": beyond})
    return _at_rest(model, "bristle_rest", "alpha")


def _lugre(cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    Fs, Fc = 1.05 * shape.peak * setting.wheel_load, 0.9 * shape.end * setting.wheel_load
    vs = 0.5 * shape.end_slip * shape.speed
    starts = [{"Fs": Fs, "Fc": Fc, "vs": f * vs, "alpha2": 10.0} for f in (0.3, 1.0)]
    model = _build("lugre", starts, {"alpha": _stiffness(setting), "alpha1": 0.0})
    return _at_rest(model, "lugre", "alpha and alpha1")


def _polach(cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    known = {"G": SHEAR_MODULUS, "a": SEMI_AXIS, "b": SEMI_AXIS, "c11": KALKER_C11}
    # initial slope of mu over slip per unit of kA + kS
    unit = SHEAR_MODULUS * SEMI_AXIS**2 * KALKER_C11 / (2.0 * setting.wheel_load)
    stiffness = max(shape.slope, shape.peak / shape.peak_slip) / unit
    fall = max(shape.peak / shape.end, 1.05)
    starts = [
        {"kA": 0.7 * f * stiffness, "kS": 0.3 * f * stiffness, "mu0": 1.3 * shape.peak, "A": A, "Bw": rate}
        for f in (0.7, 2.0)
        for A, rate in ((0.4, 0.4), (0.7 / fall, 2.0 / (shape.end_slip * shape.speed)))
    ]
    return _build("polach", starts, known)


def _burckhardt(cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    c1 = 1.05 * shape.peak
    c3 = max((c1 - shape.end) / shape.end_slip, 1e-3)
    return _build("burckhardt", [{"c1": c1, "c2": 4.0 / shape.peak_slip, "c3": c3}], {})


def _table(cells: Cells, shape: Shape, setting: Setting) -> FitModel:
    # no knot lies outside the data; below the peak the knots are equally spaced, beyond it by equal ratios
    low, high = (math.asinh(end / shape.peak_slip) for end in (cells.slip.min(), min(cells.nodes.max(), 1.0)))
    count = max(min(int(cells.count.sum() / _ROWS_A_KNOT), len(cells.slip) - 1, TABLE_KNOTS), _LEAST_KNOTS)
    knots = tuple((shape.peak_slip * np.sinh(np.linspace(low, high, count))).tolist())
    order = np.argsort(cells.slip)
    start = np.interp(knots, cells.slip[order], np.maximum(cells.mu[order], 1e-6))
    law = law_class("table")
    names = tuple(f"mu({slip:.4g})" for slip in knots)
    zeros = np.zeros(len(knots))
    return FitModel("table", law, law, names, start[None], zeros, zeros + np.inf, {"slip": knots})


_MODELS: Mapping[str, Callable[[Cells, Shape, Setting], FitModel]] = MappingProxyType(
    {
        "bristle": _bristle,
        "beam": _beam,
        "polach": _polach,
        "burckhardt": _burckhardt,
        "lugre": _lugre,
        "bristle_rest": _bristle_rest,
        "curve": _curve,
        "table": _table,
    }
)
_LAWS = MappingProxyType({name: "bristle" if name == "bristle_rest" else name for name in _MODELS})

SLIDING_ALONE = ("lugre", "bristle_rest")  #: models that are fitted only to the sliding regime

MODELS = tuple(_MODELS)  #: names of the models that can be fitted

#: models compared for "best"
CANDIDATES = tuple(name for name in MODELS if name != "bristle_rest")


def parameter_unit(name: str) -> str:
    """SI unit of a parameter of any of the models; "1" for an unknown parameter."""
    units = (law_class(law).units() for law in _LAWS.values())
    return next((found[name] for found in units if name in found), "1")
