"""Definition of a campaign: a scenario, controllers, quantities with distributions, a number of runs and a seed.

In a campaign file, a value is a number in SI units, or text with a unit.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum, StrEnum
from functools import cached_property, lru_cache, partial
from itertools import accumulate, chain, count
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.files import as_control, load_controller, own_name
from railslip_ctrl.controllers.user_step import UserStep
from railslip_ctrl.core import units
from railslip_ctrl.core.arguments import Floats, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.user_files import close_match, file_name, given_path, read_toml, validated
from railslip_ctrl.design.catalogue import controller_named, default_column, tracked_reference
from railslip_ctrl.model.vehicle import PIGains, Record
from railslip_ctrl.simulation.counted import Counted
from railslip_ctrl.simulation.paths import Number, members, numbers, replaced
from railslip_ctrl.simulation.scenario import Scenario, load_scenario

T = TypeVar("T")

MOST_RUNS = 10**9  #: largest number of runs of a campaign
LARGEST_SEED = 2**63 - 1  #: largest seed of a campaign
CUT = 4.0  #: standard deviations from the mean at which a normal distribution is truncated by default

_FARTHEST = 8.0  # standard deviations; bounds farther out leave a probability below 1e-15 and are refused as a mistake
_LISTED = 200  # number of characters of the list of paths in a message
_DRAW = 2  # index of the child of a run's seed for the quantities; children 0 and 1 are for random force and noise
_DESIGN = 2**32 - 1  # index of the campaign's child seed for points that are drawn together; no run has this number


class Distribution:
    """Base class of the distributions of a quantity, SI; a derived class defines the quantile function `at`."""

    low: Any
    high: Any
    _positive: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name in self._positive:
            if getattr(self, name) is not None:
                number(f"{self.kind}: {name}", getattr(self, name), gt=0)
        low, high = self.ends
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InputError(f"{self.kind}: from {low:g} to {high:g} is not allowed; give finite bounds, low < high")

    @property
    def kind(self) -> str:
        """Name of the distribution in files and messages."""
        return type(self).__name__.lower()

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return self.low, self.high

    def at(self, u: float) -> float:
        """Return the quantile at probability `u`, a ratio, 0 <= u < 1."""
        raise NotImplementedError


@dataclass(frozen=True)
class Uniform(Distribution):
    """Uniform distribution from `low` to `high`, SI. InputError unless low < high."""

    low: float
    high: float

    def at(self, u: float) -> float:
        return self.low + u * (self.high - self.low)


@dataclass(frozen=True)
class Normal(Distribution):
    """Normal distribution with `mean` and standard deviation `std`, SI, truncated to the range from `low` to `high`.

    By default the range is `CUT` standard deviations to each side of the mean. InputError for `std` <= 0, or if the
    probability of the range is almost zero.
    """

    mean: float
    std: float
    low: float | None = None
    high: float | None = None
    _positive = ("std",)

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self._cut
        if low > _FARTHEST or high < -_FARTHEST:
            raise InputError(
                "normal: almost no probability is left between low and high; give bounds nearer to the mean"
            )

    @property
    def ends(self) -> tuple[float, float]:
        low = self.mean - CUT * self.std if self.low is None else self.low
        return low, self.mean + CUT * self.std if self.high is None else self.high

    @property
    def _cut(self) -> tuple[float, float]:
        low, high = self.ends
        return (low - self.mean) / self.std, (high - self.mean) / self.std

    def at(self, u: float) -> float:
        from scipy.special import ndtr, ndtri  # scipy.stats would take half a second to import in each worker

        (low, high), (least, most) = self._cut, self.ends
        if low > 0.0:  # above the mean the upper tail has smaller rounding errors
            above, below = ndtr(-low), ndtr(-high)
            z = -float(ndtri(above - u * (above - below)))
        else:
            below, above = ndtr(low), ndtr(high)
            z = float(ndtri(below + u * (above - below)))
        return min(max(self.mean + self.std * z, least), most)


@dataclass(frozen=True)
class LogNormal(Distribution):
    """Log-normal distribution with `median`, SI, and `spread`, the standard deviation of the natural logarithm.

    It is truncated to the range from `low` to `high`. By default the logarithm is truncated at `CUT` standard
    deviations to each side. InputError for a median, spread or low that is not positive.
    """

    median: float
    spread: float
    low: float | None = None
    high: float | None = None
    _positive = ("median", "spread", "low")

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self._logarithm

    @property
    def ends(self) -> tuple[float, float]:
        low = self.median * math.exp(-CUT * self.spread) if self.low is None else self.low
        return low, self.median * math.exp(CUT * self.spread) if self.high is None else self.high

    @cached_property
    def _logarithm(self) -> Normal:
        return Normal(math.log(self.median), self.spread, *(math.log(end) for end in self.ends))

    def at(self, u: float) -> float:
        return math.exp(self._logarithm.at(u))


@dataclass(frozen=True)
class Triangular(Distribution):
    """Triangular density from `low` to `high` with its maximum at `mode`, SI. InputError unless low <= mode <= high."""

    low: float
    mode: float
    high: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low <= self.mode <= self.high:
            raise InputError(
                f"triangular: mode {self.mode:g} is not allowed; give a value from {self.low:g} to {self.high:g}"
            )

    def at(self, u: float) -> float:
        width, rise, fall = self.high - self.low, self.mode - self.low, self.high - self.mode
        if u * width < rise:
            return self.low + math.sqrt(u * width * rise)
        return self.high - math.sqrt((1.0 - u) * width * fall)


@dataclass(frozen=True)
class _Listed(Distribution):
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.values or not all(map(math.isfinite, self.values)):
            raise InputError(f"{self.kind}: values {list(self.values)} are not allowed; give at least one, all finite")

    @property
    def ends(self) -> tuple[float, float]:
        return min(self.values), max(self.values)

    def at(self, u: float) -> float:
        return self.values[min(int(u * len(self.values)), len(self.values) - 1)]


@dataclass(frozen=True)
class Choice(_Listed):
    """Distribution over a few `values`, SI, with equal probabilities or in proportion to `weights` (ratios).

    InputError for a weight <= 0.
    """

    weights: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        weights = self.weights
        if weights is not None and (len(weights) != len(self.values) or any(not 0 < w < math.inf for w in weights)):
            raise InputError(f"choice: weights {list(weights)} are not allowed; give one weight > 0 for each value")

    def at(self, u: float) -> float:
        if self.weights is None:
            return super().at(u)
        upto = list(accumulate(self.weights))
        return next((v for v, w in zip(self.values, upto, strict=True) if u * upto[-1] < w), self.values[-1])


@dataclass(frozen=True)
class Grid(_Listed):
    """List of `values`, SI, which are not random: the runs use all of them, in all combinations with other grids."""


DISTRIBUTIONS: dict[str, Any] = {
    made.__name__.lower(): made for made in (Uniform, Normal, LogNormal, Triangular, Choice, Grid)
}
"""Classes of distributions by their names in campaign files."""


class Sampling(StrEnum):
    """Method of sampling points in the unit cube; each coordinate is the probability of one quantity's quantile."""

    RANDOM = "random"
    LATIN_HYPERCUBE = "latin-hypercube"
    SOBOL = "sobol"


def _unit_point(sampling: Sampling, dimensions: int, runs: int, seed: int, i: int) -> Floats:
    if dimensions == 0 or sampling is Sampling.RANDOM:
        return stream(seed, i, _DRAW).random(dimensions)
    if sampling is Sampling.LATIN_HYPERCUBE:
        point: Floats = _latin_hypercube(dimensions, runs, seed)[i]
    else:
        from scipy.stats import qmc

        points = qmc.Sobol(dimensions, rng=stream(seed, _DESIGN))
        if i:  # SciPy does not allow skipping 0 points
            points.fast_forward(i)
        point = points.random(1)[0]
    return point


@lru_cache(maxsize=4)
def _latin_hypercube(dimensions: int, runs: int, seed: int) -> Floats:
    from scipy.stats import qmc

    points: Floats = qmc.LatinHypercube(dimensions, rng=stream(seed, _DESIGN)).random(runs)
    return points


def stream(seed: int, *key: int) -> np.random.Generator:
    """Return a random generator; for a given seed, different numbers `key` give independent generators."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def described(value: Any) -> Any:
    """Return a record as data for JSON: the name of its class, and its fields by name."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, (str, bool, int, float)):
        return str(value) if isinstance(value, float) and not math.isfinite(value) else value
    if isinstance(value, (tuple, list)):
        return [described(member) for member in value]
    if isinstance(value, UserStep):
        return value.fingerprint
    if not isinstance(value, BaseModel) and not is_dataclass(value):
        raise InputError(f"campaign: {type(value).__name__} cannot be written to JSON; give records and numbers")
    return {"kind": type(value).__name__, **{name: described(member) for name, member in members(value).items()}}


@dataclass(frozen=True)
class Quantity:
    """A quantity that varies from run to run: its `distribution`, SI, and the `paths` of the numbers that it sets.

    A path such as "vehicle.mass" names a number of the scenario. A path that the scenario does not have, such as "kp",
    names a number of every controller that has the path. A path that begins with the name of a controller, such as
    "pi.kp", names a number of this controller only. If `relative` is True, the numbers are multiplied by the value of
    the quantity.
    """

    paths: tuple[str, ...]
    distribution: Distribution
    relative: bool = False

    @property
    def name(self) -> str:
        """Name of the quantity's column in the results."""
        return self.paths[0] + (" factor" if self.relative else "")


@dataclass(frozen=True)
class SampledRun:
    """Inputs of a run of a campaign: sampled values by name, scenario and controllers with these values, and seed."""

    values: dict[str, float]
    scenario: Scenario
    controllers: tuple[Controller, ...]
    seed: np.random.SeedSequence | Counted


@dataclass(frozen=True)
class Campaign:
    """Many runs of a scenario in which quantities vary; run number i (from 0) depends only on the campaign and on i.

    In each run the sampled vehicle, the rail and the noise are the same for every controller.

    - scenario: the braking run.
    - controllers: any controllers that `simulate` accepts. If two have the same default name, the second ends in 2.
    - quantities: quantities of scenario and controllers that vary from run to run.
    - runs: number of runs, 1 to `MOST_RUNS`.
    - seed: seed of the campaign, 0 to 2^63 - 1.
    - sampling: method of sampling the quantities.
    - device: "cpu" or "gpu". On the GPU the random numbers come from the counter-based generator `Counted`, and
      therefore differ from those on the CPU.

    InputError: no controller; two controllers with the same name; a path that does not exist or is given twice; a
    number of runs or a seed out of range; a number of runs that does not fit the grid or the Sobol sequence; a quantity
    whose smallest or largest value is not allowed.
    """

    scenario: Scenario
    controllers: tuple[Controller, ...]
    runs: int
    quantities: tuple[Quantity, ...] = ()
    seed: int = 0
    sampling: Sampling = Sampling.RANDOM
    device: Literal["cpu", "gpu"] = "cpu"

    def __post_init__(self) -> None:
        vehicle, reference = self.scenario.believed_vehicle, self.scenario.adhesion.reference
        given = tuple(self.controllers)
        object.__setattr__(
            self, "controllers", _numbered(given, (as_control(each, vehicle, reference) for each in given))
        )
        names = self.controller_names
        if not names:
            raise InputError("controllers: the list is empty; give at least one")
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(
                f"controllers: two have the name {twice[0]!r}; give each its own name (key or argument `name`)"
            )
        if not 1 <= self.runs <= MOST_RUNS:
            raise InputError(f"runs: {self.runs} is not allowed; give an integer from 1 to {MOST_RUNS}")
        if not 0 <= self.seed <= LARGEST_SEED:
            raise InputError(f"seed: {self.seed} is not allowed; give an integer from 0 to 2^63 - 1")
        for path in (path for quantity in self.quantities for path in quantity.paths):
            self.number_at(path)
        self._check_points()
        self._check_ends()

    @property
    def controller_names(self) -> tuple[str, ...]:
        """Names of the controllers in order."""
        return tuple(controller.label for controller in self.controllers)

    @property
    def grid_points(self) -> int:
        """Number of combinations of the values of all grids; 1 without a grid."""
        return math.prod(len(d.values) for d in self._distributions if isinstance(d, Grid))

    @property
    def quantity_units(self) -> dict[str, str]:
        """Unit of each quantity by name: "1" if the quantity is a factor, "" if the unit is not known."""
        return {q.name: "1" if q.relative else self.number_at(q.paths[0]).unit for q in self.quantities}

    @cached_property
    def fingerprint(self) -> str:
        """Hash of all inputs on which the results depend."""
        content = described(self)
        if self.device == "cpu":  # left out, because folders of older versions do not have it
            del content["device"]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def number_at(self, path: str) -> Number:
        """Return the number that a `path` of a `Quantity` names; InputError for an unknown path."""
        if path not in self._paths:
            near = close_match(path, self._paths) or f"scenario: {', '.join(self._paths)[:_LISTED]} ... "
            raise InputError(f"quantity: {path!r} is not a number of the scenario or of a controller; {near.rstrip()}")
        owner, own = self._paths[path][0]
        return self._numbers[owner][own]

    def case(self, i: int) -> SampledRun:
        """Return the inputs of run number i; InputError for an i out of range or for values that are not allowed."""
        values, seed = self.values(i), np.random.SeedSequence(self.seed, spawn_key=(i,))
        draws = Counted(*seed.generate_state(2).tolist()) if self.device == "gpu" else seed
        return SampledRun(values, *self.with_values(values.values()), draws)

    def values(self, i: int) -> dict[str, float]:
        """Return the sampled values of run number i by name; InputError for an i out of range.

        If there are grids, run i has the combination of grid values with the number i modulo `grid_points`.
        """
        if not 0 <= i < self.runs:
            raise InputError(f"run: {i} is not allowed; the campaign has runs 0 to {self.runs - 1}")
        dimensions = sum(not isinstance(d, Grid) for d in self._distributions)
        shares = iter(_unit_point(self.sampling, dimensions, self.runs, self.seed, i).tolist())
        point, values = i % self.grid_points, {}
        for quantity in self.quantities:
            if isinstance(quantity.distribution, Grid):
                point, place = divmod(point, len(quantity.distribution.values))
                values[quantity.name] = quantity.distribution.values[place]
            else:
                values[quantity.name] = quantity.distribution.at(next(shares))
        return values

    def grid_values(self, point: int) -> dict[str, float]:
        """Return the combination of grid values with the number `point`, from 0, by name of the quantity."""
        grids = {quantity.name for quantity in self.quantities if isinstance(quantity.distribution, Grid)}
        return {name: value for name, value in self.values(point).items() if name in grids}

    @property
    def _distributions(self) -> list[Distribution]:
        return [quantity.distribution for quantity in self.quantities]

    @cached_property
    def _numbers(self) -> tuple[dict[str, Number], ...]:
        return tuple(map(numbers, (self.scenario, *self.controllers)))

    @cached_property
    def _paths(self) -> dict[str, list[tuple[int, str]]]:
        """For each path, the numbers that it names, as (k, own path); k is 0 for the scenario, else a controller."""
        paths: dict[str, list[tuple[int, str]]] = {}
        for k, own in enumerate(self._numbers[1:], 1):
            for path in own:
                paths.setdefault(path, []).append((k, path))
        for k, (name, own) in enumerate(zip(self.controller_names, self._numbers[1:], strict=True), 1):
            paths |= {f"{name}.{path}": [(k, path)] for path in own}
        return paths | {path: [(0, path)] for path in self._numbers[0]}

    @cached_property
    def _targets(self) -> list[list[tuple[int, str, float]]]:
        """For each quantity, the numbers that it sets, as (k, own path, factor on the value); k as in `_paths`."""
        taken: set[tuple[int, str]] = set()
        all_targets: list[list[tuple[int, str, float]]] = []
        for quantity in self.quantities:
            all_targets.append([])
            for owner, path in (target for given in quantity.paths for target in self._paths[given]):
                if (owner, path) in taken:
                    raise InputError(f"quantity: {path!r} is given twice; leave one out")
                scale = self._numbers[owner][path].value if quantity.relative else 1.0
                if scale is None:
                    raise InputError(
                        f"quantity: {path!r} has no value to multiply by a factor; give values instead of factors"
                    )
                taken.add((owner, path))
                all_targets[-1].append((owner, path, scale))
        return all_targets

    def changes(self, values: Iterable[float]) -> dict[int, dict[str, float]]:
        """Return the numbers, SI, for the `values` of all quantities, as {k: {path: number}}; k as in `_paths`."""
        changed: dict[int, dict[str, float]] = {}
        for targets, value in zip(self._targets, values, strict=True):
            for owner, path, scale in targets:
                changed.setdefault(owner, {})[path] = value * scale
        return changed

    def with_values(self, values: Iterable[float]) -> tuple[Scenario, tuple[Controller, ...]]:
        """Return scenario and controllers with `values`, SI, of all quantities; InputError if one is not allowed."""
        records: list[Any] = [self.scenario, *self.controllers]
        for owner, change in self.changes(values).items():
            records[owner] = replaced(records[owner], change)
        scenario, nominal = records[0], self.scenario
        if scenario.beliefs != nominal.beliefs:  # the controllers assume the nominal vehicle, not the sampled one
            believed, before = scenario.beliefs.of(nominal.vehicle), nominal.believed_vehicle
            records[1:] = [control.believing(believed, before) for control in records[1:]]
        return scenario, tuple(records[1:])

    def _check_points(self) -> None:
        points = self.grid_points
        if self.runs % points:
            less, more = self.runs // points * points, (self.runs // points + 1) * points
            raise InputError(
                f"runs: {self.runs} is not allowed; the grid has {points} points; give a multiple of {points}: "
                f"{f'{less} or ' if less else ''}{more}"
            )
        if self.sampling is Sampling.SOBOL and self.runs & (self.runs - 1):
            more = 1 << self.runs.bit_length()
            raise InputError(
                f"runs: {self.runs} is not allowed; Sobol points are balanced for powers of 2; give {more // 2} or "
                f"{more}"
            )

    def _check_ends(self) -> None:
        middle = [distribution.at(0.5) for distribution in self._distributions]
        for k, distribution in enumerate(self._distributions):
            for end in distribution.ends:  # all other quantities have their medians
                self.with_values((*middle[:k], end, *middle[k + 1 :]))


def _numbered(given: Iterable[Any], made: Iterable[Controller]) -> tuple[Controller, ...]:
    """Add a number to each default name that is already used; names that the user has set do not change."""
    named: dict[str, Controller] = {}
    twice = []  # controllers with a name that the user has given twice, which `Campaign` refuses
    for original, control in zip(given, made, strict=True):
        name = control.label
        if own_name(original) in (None, control.kind):
            name = next(n for n in chain([name], (f"{name} {i}" for i in count(2))) if n not in named)
            control = control if name == control.label else control.model_copy(update={"name": name})
        if name in named:
            twice.append(control)
        else:
            named[name] = control
    return (*named.values(), *twice)


KEYS_OF = {kind: tuple(field.name for field in fields(made)) for kind, made in DISTRIBUTIONS.items()}
"""Parameters of each distribution, which are keys in the table of a quantity."""

_WITHOUT_UNIT = ("spread", "weights")
_LISTS = ("values", "weights")


class ControllerTable(Record):
    """Table `[[controller]]` of a campaign file; `name` distinguishes controllers of the same kind."""

    controller: str
    name: str | None = Field(None, pattern=r"^[\w-]+$")
    gains: Literal["beam", "bristle"] | None = None
    kp: float | None = units.quantity("N*m/(m/s)", "proportional gain", default=None)
    ki: float | None = units.quantity("N*m/m", "integral gain", default=None)
    slip: float | None = units.quantity("1", "reference slip ratio on dry and on wet rail", gt=0, lt=1, default=None)
    knows_rail: bool = True
    adaptive: bool = False


class QuantityKeys(BaseModel):
    """Table `[[quantity]]` of a campaign file; its other keys are the parameters of the distribution (`KEYS_OF`)."""

    model_config = ConfigDict(frozen=True, extra="allow")

    path: str | list[str] = Field(min_length=1, description="dotted path of a number, or a list of them")
    distribution: str = Field(description=", ".join(KEYS_OF))
    relative: bool = Field(False, strict=True)


class CampaignKeys(BaseModel):
    """Keys of a campaign's TOML file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenario: str = Field(description="name of a built-in scenario, or of a TOML file in the folder of this file")
    runs: int = Field(strict=True, ge=1, le=MOST_RUNS, description="number of runs")
    seed: int = Field(0, strict=True, ge=0, le=LARGEST_SEED)
    sampling: Sampling = Sampling.RANDOM
    controller: list[ControllerTable] = Field([], description="one table for each controller")
    quantity: list[QuantityKeys] = []


def load_campaign(path: str | Path, *, controllers: Sequence[str] = ()) -> Campaign:
    """Load a campaign from a TOML file; InputError names the file, the key, the value and what is allowed.

    If `controllers`, names or files, are given, they replace the controllers of the file.
    """
    path = given_path(path)
    where = file_name(path)
    keys = validated(CampaignKeys, read_toml(path), where)
    named = path.parent / keys.scenario if keys.scenario.lower().endswith(".toml") else keys.scenario
    scenario = _located(f"{where}: scenario", lambda: load_scenario(named))
    if controllers:
        tables = [("--controller", ControllerTable(controller=text), Path()) for text in controllers]
    else:
        tables = [(f"{where}: controller {i}", table, path.parent) for i, table in enumerate(keys.controller)]
    made = tuple(_located(place, partial(_controller, table, scenario, beside)) for place, table, beside in tables)
    nominal = _located(where, lambda: Campaign(scenario, made, 1))
    quantities = tuple(
        _located(f"{where}: quantity {i}", partial(_quantity, given, nominal)) for i, given in enumerate(keys.quantity)
    )
    return _located(where, lambda: Campaign(scenario, made, keys.runs, quantities, keys.seed, keys.sampling))


def _located(where: str, make: Callable[[], T]) -> T:
    try:
        return make()
    except InputError as error:
        table = where.rpartition(": ")[2].partition(" ")[0].lstrip("-")  # "quantity" of "file: quantity 0"
        raise InputError(f"{where}: {str(error).removeprefix(f'{table}: ')}") from None


def _controller(keys: ControllerTable, scenario: Scenario, beside: Path) -> Controller:
    if (keys.kp is None) != (keys.ki is None):
        raise InputError("kp and ki: only one is given; give both, or neither")
    gains = None if keys.kp is None or keys.ki is None else PIGains(kp=keys.kp, ki=keys.ki)
    if keys.controller.lower().endswith((".toml", ".py")):
        for key in sorted(keys.model_fields_set - {"controller", "name"}):
            raise InputError(f"{key} is not allowed with the controller file {keys.controller}; set {key} in that file")
        path = beside / keys.controller
        loaded = load_controller(path, initial_speed=scenario.initial_speed)
        control = as_control(loaded, scenario.believed_vehicle, scenario.adhesion.reference, path.stem)
    else:
        control = controller_named(
            keys.controller,
            scenario.believed_vehicle,
            column=keys.gains or default_column(scenario.adhesion),
            gains=gains,
            reference=tracked_reference(keys.controller, scenario.adhesion, keys.slip, keys.gains),
            knows_rail=keys.knows_rail,
            adaptive=keys.adaptive,
        )
    return control if keys.name is None else control.model_copy(update={"name": keys.name})


def _quantity(keys: QuantityKeys, nominal: Campaign) -> Quantity:
    paths = (keys.path,) if isinstance(keys.path, str) else tuple(keys.path)
    units = {nominal.number_at(path).unit for path in paths}
    if len(units) > 1 and not keys.relative:
        raise InputError(
            f"path: {', '.join(paths)} have different units; write one [[quantity]] table for each, or relative = true"
        )
    unit = "1" if keys.relative else units.pop()
    return Quantity(paths, _distribution(keys, unit), keys.relative)


def _distribution(keys: QuantityKeys, unit: str) -> Distribution:
    kind = keys.distribution
    if kind not in KEYS_OF:
        raise InputError(
            f"distribution: unknown kind {kind!r}; {close_match(kind, KEYS_OF)}choose one of {', '.join(KEYS_OF)}"
        )
    given = keys.model_extra or {}
    for name in given:
        if name not in KEYS_OF[kind]:
            near = close_match(name, KEYS_OF[kind])
            raise InputError(f"{name}: unknown key of {kind}; {near}allowed: {', '.join(KEYS_OF[kind])}")
    for field in fields(DISTRIBUTIONS[kind]):
        if field.name not in given and field.default is MISSING:
            raise InputError(f"{field.name}: missing; give it for the distribution {kind}")
    made: Distribution = DISTRIBUTIONS[kind](**{name: _si(value, unit, name) for name, value in given.items()})
    return made


def _si(value: Any, unit: str, name: str) -> Any:
    unit = "1" if name in _WITHOUT_UNIT else unit or "1"  # without a known unit, only a plain number is allowed
    if name in _LISTS:
        if not isinstance(value, list):
            raise InputError(f"{name}: {units.shown(value)} is not allowed; give a list")
        return tuple(units.to_unit(member, unit, name=name, text_needs_unit=True) for member in value)
    return units.to_unit(value, unit, name=name, text_needs_unit=True)
