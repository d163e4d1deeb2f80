"""SISO feedback loop with exact dead time: `DeadTimeLoop`, and `Loop`, the base of all kinds of loops."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from flint import ctx
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.arguments import Complexes, Floats, checked, complexes, number, numbers
from railslip_ctrl.core.errors import InputError, UnstableLoopError
from railslip_ctrl.core.records import dataclass

from .certificate import Certificate, certify
from .crossings import GAIN, REFINED_BITS, SMALLEST_LISTED, Piece, Response, phase_crossovers, pieces
from .margins import GainLimit, Margins, compute_margins, gain_limits, smallest_at, stabilizing_range
from .rational import Rational, pade
from .responses import TimeResponse, step_response
from .stability import RootCount, count_right_of, rightmost_poles, root_count

if TYPE_CHECKING:
    from control import FrequencyResponseData, TransferFunction

# Rounds of listing phase crossovers; each lowers the smallest |L| listed to below 1/(largest stabilising gain found).
# Two suffice unless one resonance hides another.
_MOST_LISTINGS = 5
_ALL_LISTED = 1000  # unstable poles up to which every gain limit that causes them is certainly listed
_SHARP, _MOST_SHARPENED = 1e-12, 20  # relative error above which balls refine a gain limit, and most limits refined
_NEAR_ONE = 1e-12  # distance of a gain limit from 1 that rounding of its phase crossover may cause

MOST_POLES = 1000  #: closed-loop poles computed at most; a few dozen describe a loop

_POINTS = 4000  # points of a frequency response: a smooth line in print, the turns of the dead time included

_ILL_POSED = "the loop is not well posed: 1 + L(inf) = 0; change the gain or make G strictly proper"


class Loop(ABC):
    """Base class of loops, continuous or sampled: operators, plots and the interface of python-control's systems.

    `2 * loop`, `loop / 2`, `C * loop` and `-loop` are loops with exact dead time. Sums, quotients and `feedback` return
    python-control's frequency-response data at the frequencies `frequency_response().omega`. `control.margin(loop)`
    interpolates these data. Functions that need a rational system, for example `control.step_response`, accept
    `DeadTimeLoop.to_tf`, a Pade approximation. The methods of the loop itself are exact.
    """

    __array_ufunc__ = None  # a NumPy number times a loop calls the loop's __rmul__
    _dt: float | None = None  # sampling period of the frequency-response data, s; None: continuous

    def __array__(self, *_: Any, **__: Any) -> NDArray[Any]:
        raise TypeError(self._unsupported)

    def __getitem__(self, _: Any) -> Any:
        raise TypeError(self._unsupported)

    def __len__(self) -> int:
        return 3

    def __iter__(self) -> Iterator[Floats]:
        """Yield magnitude, phase (deg) and frequencies (rad/s), the sequence that `control.margin` takes."""
        return iter((self._record.magnitude, np.degrees(self._record.phase), self._record.omega))

    @property
    def _unsupported(self) -> str:
        pade = ", or loop.to_tf(order), a Pade approximation," if isinstance(self, DeadTimeLoop) else ""
        return (
            f"{type(self).__name__} is not a python-control system; pass loop.frequency_response(omega)"
            f"{pade} to python-control, or call loop.margins(), loop.step_response(time), loop.bode_plot(), "
            "loop.nyquist_plot() or loop.nichols_plot()"
        )

    @abstractmethod
    def __mul__(self, other: Any) -> Self:
        """Connect in series with a SISO system without dead time, or multiply the gain by a number.

        For a sampled loop the system must be sampled too.
        """

    def __rmul__(self, other: Any) -> Self:
        return self.__mul__(other)

    @property
    @abstractmethod
    def integrators(self) -> int:
        """Number of poles of L at s = 0, or at z = 1 for a sampled loop."""

    @property
    @abstractmethod
    def open_loop_unstable_poles(self) -> int:
        """Number of poles of L right of the imaginary axis, or outside the unit circle for a sampled loop."""

    @abstractmethod
    def scaled(self, factor: float) -> Self:
        """The loop with its gain multiplied by `factor`, which may be negative. InputError: `factor` is not finite."""

    def __truediv__(self, divisor: Any) -> Any:
        """Divide the gain by a number; for a system or loop as divisor return frequency-response data of L/divisor."""
        if hasattr(divisor, "ninputs"):
            return self._record / self._operand(divisor)
        number("divisor", divisor)
        return self.scaled(1 / divisor if divisor else math.inf)

    def __rtruediv__(self, other: float) -> FrequencyResponseData:
        return other / self._record

    def __add__(self, other: Any) -> FrequencyResponseData:
        return self._record + self._operand(other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> FrequencyResponseData:
        return self._record - self._operand(other)

    def __rsub__(self, other: Any) -> FrequencyResponseData:
        return other - self._record

    def feedback(self, other: Any = 1, sign: int = -1) -> FrequencyResponseData:
        """Closed loop, as python-control's frequency-response data.

        - other: a number, system or loop in the feedback path.
        - sign: -1 for negative feedback, 1 for positive.
        """
        # not FrequencyResponseData.feedback: it ignores the sign
        return self._record / (1 - self._operand(other) * self._record * sign)

    def _operand(self, other: Any) -> Any:
        return other.frequency_response(self._record.omega) if isinstance(other, Loop) else other

    @cached_property
    def _record(self) -> FrequencyResponseData:
        return self.frequency_response()

    def __neg__(self) -> Self:
        return self.scaled(-1.0)

    @abstractmethod
    def response(self, omega: ArrayLike) -> Complexes:
        """L at the frequencies `omega`, rad/s, finite: complex, of the same shape."""

    def frequency_response(
        self, omega: ArrayLike | None = None, *, squeeze: bool | None = None
    ) -> FrequencyResponseData:
        """L as frequency-response data of python-control, for functions of python-control.

        `loop.response(omega)` gives L as a plain array.

        - omega: 1-D, rad/s, finite; by default frequencies of `feature_band`, gain crossovers included. The data can be
          interpolated if `omega` has at least two values and ascends.
        - squeeze: as in `control.frequency_response`.
        """
        if omega is None:
            low, high = self.feature_band()
            omega = np.union1d(np.geomspace(low, high, _POINTS), self.gain_crossovers.clip(low, high))
        grid = np.atleast_1d(numbers("omega", omega, "rad/s"))
        made: Any = import_module("control").FrequencyResponseData
        smooth = grid.size > 1 and bool((np.diff(grid) > 0).all())  # python-control's splines need ascending points
        return made(self.response(grid), grid, sysname="L", squeeze=squeeze, smooth=smooth, dt=self._dt or 0)

    def sensitivity(self, omega: ArrayLike) -> Complexes:
        """Sensitivity S = 1/(1 + L), complex, of the shape of `omega` (rad/s, finite)."""
        return np.asarray(1 / (1 + self.response(omega)))

    def complementary_sensitivity(self, omega: ArrayLike) -> Complexes:
        """Complementary sensitivity T = L/(1 + L), complex, of the shape of `omega` (rad/s, finite)."""
        return np.asarray(1 - self.sensitivity(omega))

    @property
    @abstractmethod
    def root_count(self) -> RootCount:
        """Number of unstable closed-loop poles, and whether poles are on the stability boundary."""

    @property
    @abstractmethod
    def gain_crossovers(self) -> Floats:
        """All frequencies > 0 with |L| = 1, rad/s, ascending; available also for an unstable loop."""

    @abstractmethod
    def phase(self, omega: ArrayLike) -> Floats:
        """Continuous phase of L, rad, dead time included; it needs no unwrapping.

        - omega: rad/s, > 0, any shape; at most pi/h for a sampled loop with period h.

        InputError: a frequency that is not finite and positive.
        """

    @abstractmethod
    def feature_band(self) -> tuple[float, float]:
        """Lowest and highest frequency, rad/s, of a plot that shows all poles, zeros and gain crossovers of L."""

    @abstractmethod
    def margins(self) -> Margins:
        """All margins of the loop; see `Margins`.

        Raises UnstableLoopError, with the interval of stabilising gain factors, if the loop is unstable.
        """

    def is_stable(self) -> bool:
        """True if every closed-loop pole is stable, including all of the infinitely many poles of a neutral loop."""
        return self.root_count.stable

    @property
    def unstable_closed_loop_poles(self) -> float:
        """Number of closed-loop poles on or beyond the stability boundary; inf for an unstable neutral loop."""
        return self.root_count.right

    def bode_plot(self, omega: ArrayLike | None = None) -> Any:
        """Plot magnitude and phase of L; return a matplotlib figure.

        The plot extends from the lowest to the highest frequency of `omega`, rad/s; by default over `feature_band`.
        """
        return self._drawn("bode", omega)

    def nyquist_plot(self, omega: ArrayLike | None = None) -> Any:
        """Plot the Nyquist curve, whole and near -1; return a matplotlib figure. `omega`, rad/s, as in `bode_plot`."""
        return self._drawn("nyquist", omega)

    def nichols_plot(self, omega: ArrayLike | None = None) -> Any:
        """Plot magnitude against phase of L; return a matplotlib figure. `omega`, rad/s, as in `bode_plot`."""
        return self._drawn("nichols", omega)

    def _drawn(self, kind: str, omega: ArrayLike | None) -> Any:
        band = None if omega is None else np.ravel(numbers("omega", omega, "rad/s", gt=0))
        # imported at run time, because the package `report` imports this one
        return import_module("railslip_ctrl.report.plots").loop_figure(self, kind, band)


def _system_attribute(name: str, *, delegated: bool) -> property:
    def value(loop: Loop) -> Any:
        if not delegated:
            raise AttributeError(loop._unsupported, name=name, obj=loop)
        return getattr(loop._record, name)

    return property(value, doc=f"Attribute {name} of python-control's systems.")


_DELEGATED = ("dt", "isctime", "isdtime", "issiso", "ninputs", "noutputs", "update_names")
_REFUSED = (
    *("append", "contour", "damp", "frdata", "input_labels", "magnitude", "minreal", "name", "nstates", "plot"),
    *("plot_phase", "sample", "zeros"),
)
for _name in (*_DELEGATED, *_REFUSED):
    setattr(Loop, _name, _system_attribute(_name, delegated=_name in _DELEGATED))


def unstable_error(kind: str, poles: str, count: float, usable: tuple[float, float] | None) -> UnstableLoopError:
    """Return the error that `margins` raises for an unstable loop.

    - kind, poles: kind of the loop and description of its unstable poles, for the message.
    - count: number of unstable poles.
    - usable: interval of loop-gain factors that stabilise the loop; None if no factor does.
    """
    remedy = "no factor on the loop gain alone stabilises it"
    if usable is not None:
        remedy = f"loop-gain factors between {usable[0]:.6g} and {usable[1]:.6g} stabilise it"
    message = f"margins are not defined: the {kind} is unstable with {poles}; {remedy}"
    return UnstableLoopError(message, unstable_poles=count, stabilizing_gain_range=usable)


@dataclass(frozen=True, init=False, repr=False)
class DeadTimeLoop(Loop):
    """The loop transfer function L(s) = G(s) exp(-dead_time s) under unity negative feedback.

    - system: G; python-control TransferFunction or StateSpace, `Rational`, or a real number; continuous-time, SISO and
      proper. A pole cancelled by a zero (hidden mode) still counts for stability.
    - dead_time: s, >= 0.

    InputError: `system` is of another kind, or the dead time is negative, not finite or not a number.

    The dead time is not approximated: unstable closed-loop poles are counted exactly ([WaltonMarshall1987]). A neutral
    loop (as many zeros as poles, with dead time) is stable only if |G(inf)| < 1; its margins include the limit of L at
    infinite frequency.
    """

    system: Rational
    dead_time: float

    def __init__(self, system: Any, dead_time: float = 0.0) -> None:
        object.__setattr__(self, "dead_time", number("dead time", dead_time, "s", ge=0))
        object.__setattr__(self, "system", Rational.from_control(system))

    def __repr__(self) -> str:
        order = self.system.poles.size
        return f"DeadTimeLoop(order {order}, relative degree {self.system.relative_degree}, {self.dead_time:g} s)"

    def scaled(self, factor: float) -> DeadTimeLoop:
        return DeadTimeLoop(self.system * number("gain factor", factor), self.dead_time)

    def __mul__(self, other: Any) -> DeadTimeLoop:
        if isinstance(other, DeadTimeLoop):
            return DeadTimeLoop(other.system * self.system, self.dead_time + other.dead_time)
        return DeadTimeLoop(Rational.from_control(other, "factor") * self.system, self.dead_time)

    def delayed(self, extra: float) -> DeadTimeLoop:
        """The loop with `extra`, s, added to the dead time; InputError if the sum is negative or not finite."""
        return DeadTimeLoop(self.system, self.dead_time + number("extra dead time", extra, "s"))

    def pade(self, order: int) -> DeadTimeLoop:
        """The loop with its dead time replaced by a diagonal Pade approximation; `order` 1 to 100."""
        return DeadTimeLoop(self.system * pade(self.dead_time, order), 0.0)

    # -- frequency response -------------------------------------------------------------------------------

    def __call__(self, s: ArrayLike) -> Complexes:
        """L(s) at complex `s`, 1/s, of the same shape; `loop(1j * omega)` is the frequency response, a plain array.

        At a pole, for example at 0 for a loop with an integrator, the value is inf + 0j, which makes 1/(1 + L)
        zero. InputError: `s` is not finite.
        """
        s = complexes("s", s)
        if not np.isfinite(s).all():
            raise InputError("s: a value is not finite; give finite numbers")
        value = self.system(s)
        with np.errstate(invalid="ignore"):
            return np.where(np.isinf(value), value, value * np.exp(-s * self.dead_time))

    def response(self, omega: ArrayLike) -> Complexes:
        return self._response(numbers("omega", omega, "rad/s"))

    def phase(self, omega: ArrayLike) -> Floats:
        return self._response.phase(numbers("omega", omega, "rad/s", gt=0))[0]

    def phase_slope(self, omega: ArrayLike) -> Floats:
        """Slope d(arg L)/d omega of the phase, s; its negative is the group delay.

        - omega: rad/s, > 0, any shape.

        InputError: a frequency that is not finite and positive.
        """
        return self._response.phase(numbers("omega", omega, "rad/s", gt=0))[1]

    def feature_band(self) -> tuple[float, float]:
        scales = self._response.scales
        return float(scales.min() / 10), float(scales.max() * 10)

    # -- stability ----------------------------------------------------------------------------------------

    @cached_property
    def root_count(self) -> RootCount:
        return root_count(self._response)

    @property
    def is_well_posed(self) -> bool:
        """False if the loop has no dead time and 1 + L(inf) = 0: the feedback equations then have no solution."""
        return self.dead_time > 0 or self._response.exact.through != -1

    @property
    def open_loop_unstable_poles(self) -> int:
        return int(np.count_nonzero(self.system.poles.real > 0))

    @property
    def integrators(self) -> int:
        return int(np.count_nonzero(self.system.poles == 0))

    def to_tf(self, order: int) -> TransferFunction:
        """L as a python-control system; a diagonal Pade approximation of order `order` replaces the dead time."""
        made: Any = import_module("control").TransferFunction
        both = ([float(c) for c in one.coeffs()[::-1]] for one in self.pade(order).system.polynomials)
        return made(*both, name=f"L, Pade of order {order}")

    def zeros(self) -> Complexes:
        """Zeros of G, 1/s; named as in python-control."""
        return self.system.zeros.copy()

    def dcgain(self) -> float:
        """Value of L at s = 0; infinite with an integrator."""
        return float(self(0.0).real)

    def poles(self) -> Complexes:
        """Open-loop poles (of G), 1/s; named as in python-control. See also `closed_loop_poles`."""
        return self.system.poles.copy()

    @checked
    def closed_loop_poles(self, count: int = 6) -> Complexes:
        """The `count` rightmost closed-loop poles, rightmost first, 1/s; a conjugate pair counts as two.

        Without dead time the loop has only as many poles as G. Raises SpectrumError if the exact root count differs
        from the number of computed poles; InputError for a count outside 1 to 1000, or for an unstable neutral loop,
        which has no rightmost pole.
        """
        number("count", count, ge=1, le=MOST_POLES)
        if not self.is_well_posed:
            raise InputError(f"closed-loop poles: {_ILL_POSED}")
        if self.dead_time > 0 and abs(self.system.feedthrough) >= 1:
            raise InputError(
                f"closed-loop poles: a neutral loop with |G(inf)| = {abs(self.system.feedthrough):g} >= 1 has "
                "infinitely many poles and no rightmost one; make G strictly proper"
            )
        return rightmost_poles(self.system, self.dead_time, count)

    # -- responses and figures ----------------------------------------------------------------------------

    def step_response(self, time: ArrayLike) -> TimeResponse:
        """Exact response of the closed loop T to a unit step of the reference at t = 0.

        To get the controller's command too, give controller and plant separately to `loop.responses.step_response`.

        - time: array, shape (n,), s, >= 0, ascending; or a float, s, > 0, the end of 1001 equally spaced times from 0.
        """
        times: Any = (None, time) if np.ndim(time) == 0 else (time, None)
        return step_response(1.0, self.system, self.dead_time, time=times[0], final_time=times[1])

    # -- margins ------------------------------------------------------------------------------------------

    @cached_property
    def gain_crossovers(self) -> Floats:
        return self._response.gain_crossovers

    @cached_property
    def stabilizing_gain_range(self) -> tuple[float, float] | None:
        """Interval of loop-gain factors that make the loop stable; None if no factor does.

        The interval contains 1 if the loop is stable; otherwise it is the interval nearest to 1 in ratio. The lower end
        is 0 if every smaller factor stabilises too; the upper end is inf if every larger factor does.
        """
        interval = self._range_within(self._gain_limits)
        if interval is None or self.is_stable():
            return interval
        # if L contains only even powers of s, poles are on the axis on both sides of a limit: check inside the interval
        low, high = interval
        inside = min(1.0, high / 2) if low == 0 else math.sqrt(low * high) if high < math.inf else 2 * low
        return interval if self.scaled(inside).is_stable() else None

    def _range_within(self, limits: list[GainLimit]) -> tuple[float, float] | None:
        count = self.root_count
        if not count.marginal and count.right <= min(2 * len(limits), _ALL_LISTED):
            return stabilizing_range(limits, count.right)
        # the loop is on a limit, beyond the neutral limit, or beyond unlisted limits: count below the smallest limit
        low = 0.5 * min((limit.factor for limit in limits), default=1.0)
        at_low = count_right_of(self.system * low, self.dead_time)
        interval = stabilizing_range([g._replace(factor=g.factor / low) for g in limits], at_low.right)
        return None if interval is None or at_low.marginal else (interval[0] * low, interval[1] * low)

    def margins(self) -> Margins:
        if not self.is_stable():
            raise self._unstable_error()
        return self._margins

    @cached_property
    def _margins(self) -> Margins:
        response = self._response
        rest = [one for _, one in response.crossover_phases]
        for i in smallest_at(rest, crossovers := self.gain_crossovers.tolist()):
            if response.rounding(crossovers[i]) > _SHARP * abs(rest[i]):
                rest[i] = response.exact.offset(GAIN, i)[1]
        return compute_margins(response, self._pieces, rest, self._listed, self._gain_limits)

    def certificate(self) -> Certificate:
        """Stability and margins as enclosures by ball arithmetic; see `Certificate`.

        Raises CertificateError if 4000 bits do not suffice, because the loop is too near the stability boundary.
        """
        return certify(self._response, self._margins if self.is_stable() else None)

    def _unstable_error(self) -> UnstableLoopError:
        count, usable = self.root_count.right, self.stabilizing_gain_range
        if not self.is_well_posed:
            return UnstableLoopError(
                f"margins are not defined: {_ILL_POSED}", unstable_poles=count, stabilizing_gain_range=usable
            )
        poles = "infinitely many poles" if math.isinf(count) else f"{count:g} pole{'' if count == 1 else 's'}"
        where = " (on the imaginary axis)" if self.root_count.marginal else ""
        return unstable_error("closed loop", f"{poles} in the closed right half plane{where}", count, usable)

    @cached_property
    def _response(self) -> Response:
        return Response(self.system, self.dead_time)

    @cached_property
    def _pieces(self) -> list[Piece]:
        return pieces(self._response)

    @cached_property
    def _listed(self) -> list[GainLimit]:
        """Gain limits; phase crossovers with |L| too small to limit the stabilising gains are left out."""
        # a gain factor that stabilises makes |L| at least 1 above the slowest unstable pole
        smallest = SMALLEST_LISTED * min(1.0, self._size_at_unstable_poles())
        for _ in range(_MOST_LISTINGS):
            limits = gain_limits(self._response, phase_crossovers(self._response, self._pieces, smallest=smallest))
            usable = self._range_within(limits)
            if usable is None or math.isinf(usable[1]) or usable[1] * smallest <= 1:
                break
            smallest = 0.9 / usable[1]  # unlisted crossovers with |L| above 1/usable[1] may limit the gain first
        return limits

    def _size_at_unstable_poles(self) -> float:
        """Largest |L| at frequencies above 0.3 times the slowest unstable open-loop pole; 1 if no pole is unstable."""
        sizes = [abs(pole) for pole in self.system.poles.tolist() if pole.real > 0]
        if not sizes or self.system.gain == 0:
            return 1.0
        slowest = 0.3 * min(sizes)
        beyond = [size for piece in self._pieces if piece.low >= slowest for size in piece.size]
        return math.exp(max([*beyond, self._response.log_size(slowest)]))

    @cached_property
    def _gain_limits(self) -> list[GainLimit]:
        limits = self._listed
        inner = [limit for limit in limits if 0 < limit.frequency < math.inf]
        inner = sorted(inner, key=lambda limit: abs(math.log(limit.factor or math.ulp(0.0))))[:_MOST_SHARPENED]
        sharp = {limit: self._sharpened(limit) for limit in inner}
        limits = [self._decided(sharp.get(limit, limit)) for limit in limits]
        return sorted(limits, key=lambda limit: limit.factor)

    def _sharpened(self, limit: GainLimit) -> GainLimit:
        omega, response, slope = limit.frequency, self._response, limit.rate.imag
        # ball arithmetic, if rounding of the phase makes the limit inaccurate
        if slope == 0 or abs(limit.rate.real) * math.pi * response.rounding(omega) <= _SHARP * abs(slope):
            return limit
        odd = 2 * round((response.turned(omega)[0] / math.pi - 1) / 2) + 1
        with ctx.workprec(REFINED_BITS):
            frequency = response.exact.phase_crossover(omega, slope, odd)
            factor = float((1 / abs(response.exact.value(frequency)[0])).mid())
        return limit._replace(factor=factor, frequency=float(frequency))

    def _decided(self, limit: GainLimit) -> GainLimit:
        """Move a gain limit that equals 1 within rounding to the side of 1 that the exact root count gives."""
        away = abs(limit.factor - 1)
        if away > _NEAR_ONE or self.root_count.right > _ALL_LISTED:  # with so many poles neither side is stable
            return limit
        below = count_right_of(self.system * (1 - 2 * _NEAR_ONE), self.dead_time)
        return limit._replace(factor=math.nextafter(1.0, 2.0 if below == self.root_count else 0.0))


# -- records for plotting -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FrequencyCurve:
    """Samples of L(j omega) for plots: omega in rad/s, L as complex numbers, continuous phase in deg."""

    omega: Floats
    response: Complexes
    phase_deg: Floats

    @property
    def magnitude_db(self) -> Floats:
        """Magnitude 20 log10 |L|, dB; -inf where L is 0."""
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(np.abs(self.response)))


@checked
def frequency_curve(loop: Loop, low: float, high: float) -> FrequencyCurve:
    """Sample a loop with exact dead time from `low` to `high`, rad/s; the samples include the gain crossovers."""
    _check_band(low, high)
    omega = np.union1d(np.geomspace(low, high, _POINTS), loop.gain_crossovers.clip(low, high))
    return FrequencyCurve(omega, loop.response(omega), np.degrees(loop.phase(omega)))


@dataclass(frozen=True)
class GangOfFour:
    """The gang of four closed-loop responses ([Astrom2021] 12.1), complex, at frequencies omega (rad/s).

    S = 1/(1 + C P), T = C P/(1 + C P), PS = P/(1 + C P) (load to output), CS = C/(1 + C P) (noise to control).
    """

    omega: Floats
    s: Complexes
    t: Complexes
    ps: Complexes
    cs: Complexes


@checked
def gang_of_four(controller: Callable[[Any], Any], plant: DeadTimeLoop, low: float, high: float) -> GangOfFour:
    """Compute the gang of four at frequencies from `low` to `high`, rad/s.

    - controller: C, called with an array of complex s (1/s).
    - plant: P, with exact dead time.
    """
    _check_band(low, high)
    omega = np.geomspace(low, high, _POINTS)
    p, c = plant(1j * omega), controller(1j * omega)
    s = 1 / (1 + c * p)
    return GangOfFour(omega, np.asarray(s), np.asarray(c * p * s), np.asarray(p * s), np.asarray(c * s))


def _check_band(low: float, high: float) -> None:
    number("low", low, "rad/s", gt=0)
    number("high", high, "rad/s", gt=low)
