"""Rare events: estimates against closed forms, and their intervals; what cannot be trusted is reported."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from project import script
from scipy import integrate, stats

from railslip_ctrl import Campaign, InputError, confidence_levels, rare_event, simulate
from railslip_ctrl.design.catalogue import published_controller
from railslip_ctrl.simulation import built_in_scenario
from railslip_ctrl.simulation.campaign import Grid, LogNormal, Normal, Quantity, RareEvent, rare
from railslip_ctrl.simulation.campaign.execution import run_rows
from railslip_ctrl.simulation.campaign.rare import Event
from railslip_ctrl.simulation.run import LOCKED_SHARE


class Case(NamedTuple):
    """A limit state, its number of inputs, the event's threshold and its probability in closed form."""

    limit_state: Callable[[np.ndarray], np.ndarray]
    inputs: int
    threshold: float
    probability: float
    points: int = 1000


def linear(inputs: int, probability: float, points: int = 1000) -> Case:
    return Case(
        lambda z: z.sum(axis=1) / math.sqrt(inputs), inputs, float(-stats.norm.ppf(probability)), probability, points
    )


def _four_branches(z: np.ndarray) -> np.ndarray:
    """The series system of four branches, Waarts' example: the worst branch's excess over -1."""
    first, second = z.T
    curve, sum_ = 3.0 + 0.1 * (first - second) ** 2, (first + second) / math.sqrt(2.0)
    far = 7.0 / math.sqrt(2.0)
    return 1.0 - np.minimum.reduce([curve - sum_, curve + sum_, first - second + far, second - first + far])


def _four_branch_probability() -> float:
    """By quadrature in the axes u = (x + y)/sqrt 2, w = (x - y)/sqrt 2: safe for |w| < 3.5 and |u| < 3 + 0.2 w^2."""
    safe, _ = integrate.quad(lambda w: stats.norm.pdf(w) * (1 - 2 * stats.norm.sf(3 + 0.2 * w * w)), -3.5, 3.5)
    return 1.0 - safe


WEIGHTS = np.array([0.8, -0.5, 0.3, 0.1, 0.1])
PLANE = Case(lambda z: z @ WEIGHTS, 5, 5.0, float(stats.norm.sf(5.0)))
OPPOSITE = Case(lambda z: np.abs(z[:, 0]), 2, 4.0, 2.0 * float(stats.norm.sf(4.0)))
TWO_POINTS = Case(
    lambda z: np.minimum(np.abs(z[:, 0]), z[:, 1] + 2.0), 2, 3.5, 2 * stats.norm.sf(3.5) * stats.norm.sf(1.5)
)
DISCRETE = Case(lambda z: np.floor(2.0 * z[:, 0]), 3, 6.9, float(stats.norm.sf(3.5)))
THIN = Case(lambda z: 9.0 - np.abs(z[:, 0] - 3.0), 1, 9.0 - 1e-6, 0.0)  # a needle of a width of 2e-6
FLAT = Case(lambda z: np.where(z[:, 0] > 5.0, 1.0, 0.0), 2, 0.5, 0.0)
BOW = Case(
    lambda z: np.hypot(*z.T) * np.where(np.abs(np.arctan2(z[:, 1], z[:, 0])) < np.radians(75), 1.0, 0.1),
    2,
    6.0,
    150 / 360 * math.exp(-(6.0**2) / 2),
)
CASES = {
    **{f"linear {n} {p:g}": linear(n, p) for n in (2, 20) for p in (1e-3, 1e-6, 1e-9)},
    **{f"linear 5000 {p:g}": linear(5000, p, 500) for p in (1e-3, 1e-6, 1e-9)},
    "four branches": Case(_four_branches, 2, 1.0, _four_branch_probability()),
    "parallel system, two design points": TWO_POINTS,
    "discrete": DISCRETE,
}


@pytest.fixture
def estimated(monkeypatch: pytest.MonkeyPatch) -> Callable[..., RareEvent]:
    """The whole method on a closed form in place of a campaign's stops."""

    def found(case: Case, seed: int, groups: dict[str, slice] | None = None, **given: object) -> RareEvent:
        class Closed:
            def __init__(self, campaign: Campaign, measure: str) -> None:
                self.campaign, self.inputs, self.counts = campaign, case.inputs, np.zeros(2, dtype=int)
                self.groups = groups or {"all": slice(0, case.inputs)}

            def __call__(self, points: np.ndarray) -> np.ndarray:
                self.counts[0] += len(points)
                return case.limit_state(points)

            def drawn(self, point: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
                return {}, point

            def run(self, point: np.ndarray, record_every: int) -> None:
                return None

        monkeypatch.setattr(rare, "Stops", Closed)
        campaign = replace(CAMPAIGN, seed=seed)
        return rare_event(campaign, f"slip > {case.threshold!r}", **{"points": case.points, **given})

    return found


def study(estimated: Callable[..., RareEvent], case: Case, estimates: int) -> tuple[float, float, float]:
    found = [estimated(case, seed).probability for seed in range(estimates)]
    values = np.array([one.value for one in found]) / case.probability
    inside = np.mean([one.low <= case.probability <= one.high for one in found])
    return float(values.mean() - 1.0), float(values.std(ddof=1) / math.sqrt(estimates)), float(inside)


@pytest.mark.parametrize("name", ["linear 2 1e-06", "four branches", "discrete"])
def test_estimates_are_without_bias_and_intervals_hold(name, estimated):
    bias, error, inside = study(estimated, CASES[name], 24)
    assert abs(bias) < 4.0 * error  # chance reaches this in one of 16 000
    assert inside >= 18 / 24  # of 24 intervals of 95 % chance leaves out more than 6 in one of 10 000


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in CASES if "5000" not in name or "1e-06" in name])
def test_bias_and_coverage(name, estimated):
    """Over 200 estimates; over 40 of 5 000 inputs, which take seconds each."""
    count = 40 if "5000" in name else 200
    bias, error, inside = study(estimated, CASES[name], count)
    print(f"{name}: bias {bias:+.4f} +- {error:.4f}, inside {inside:.3f}")
    assert abs(bias) < max(0.05, 3.0 * error)
    assert 0.90 - (count < 200) * 0.1 <= inside <= 0.98 + (count < 200) * 0.02


# --- what makes it likely, and where the estimate cannot be trusted ---------------------------------------------------


def test_shares_design_point_and_importance_of_a_plane(estimated):
    found = estimated(PLANE, 1, {"a": slice(0, 1), "b": slice(1, 2), "rest": slice(2, 5)})
    assert [*found.shares.values()] == pytest.approx([0.64, 0.25, 0.11], abs=0.03)
    assert found.stop.distance == pytest.approx(5.0, rel=0.02)  # its direction is off by chance
    assert found.probability is found.importance
    assert found.importance.variation < 0.1
    assert found.subset.low < PLANE.probability < found.subset.high
    assert found.stops < 100_000
    assert not found.warnings


def test_chance_gives_inputs_that_do_not_matter_no_share(estimated):
    case = linear(2, 1e-5)._replace(
        inputs=2002, limit_state=lambda z: z[:, :2].sum(axis=1) / math.sqrt(2.0), points=500
    )
    found = estimated(case, 2, {"two": slice(0, 2), "others": slice(2, 2002)})
    assert found.shares["others"] < 0.05


@pytest.mark.parametrize(
    ("case", "words"),
    [
        (OPPOSITE, "may have several regions"),
        (CASES["four branches"], "may have several regions"),
        (DISCRETE, "equal results"),
        (FLAT, "occurred in no simulated stop"),
        (THIN, "% of a level's moves"),
        (linear(5000, 1e-6, 100), "coefficient of variation is"),
        (BOW, "methods disagree"),  # importance sampling misses the ends of the bow
    ],
)
def test_what_cannot_be_trusted_is_told(case, words, estimated):
    found = estimated(case, 3)
    assert any(words in warning for warning in found.warnings)
    assert found.probability is found.subset


# --- of stops ---------------------------------------------------------------------------------------------------------

BRIEF = {"initial_speed": 30 / 3.6, "final_speed": 27 / 3.6, "longest_time": 20.0, "step": 0.01, "events": ()}
NOISY = {"disturbances": {"random_force": 300.0}, "measurement": {"speed_noise": 0.02}}
SCENARIO = built_in_scenario("park2008-si").with_changes(**BRIEF, **NOISY)
CONTROLLER = published_controller("pi").model_copy(update={"period": 0.02})
MASS = Quantity(("vehicle.mass",), Normal(1.0, 0.03, 0.8, 1.2), relative=True)
ADHESION = Quantity(("adhesion_factor",), LogNormal(1.0, 0.05))
CAMPAIGN = Campaign(SCENARIO, (CONTROLLER,), 1, (MASS, ADHESION), 3)
EVENT = "distance > 10.85 m"
TOML = """
scenario = "brief.toml"
runs = 40
seed = 3
controller = [{ controller = "own.toml" }]

[[quantity]]
path = "vehicle.mass"
relative = true
distribution = "normal"
mean = 1.0
std = 0.03
low = 0.8
high = 1.2

[[quantity]]
path = "kp"
relative = true
distribution = "uniform"
low = 0.9
high = 1.1
"""
BRIEF_TOML = """
extends = "park2008-si"
initial_speed = "30 km/h"
final_speed = "27 km/h"
longest_time = 20
step = 0.01
events = []
disturbances = { random_force = 300.0 }
measurement = { speed_noise = 0.02 }
"""


def test_a_plain_campaign_has_the_same_tail():
    """The stops of a plain campaign have their numbers from another stream; one in 20 is beyond the threshold."""
    count, share = 800, 0.05
    rows = (run_rows(replace(CAMPAIGN, runs=count), i)[0] for i in range(count))
    threshold = float(np.quantile([row["braking_distance_m"] for row in rows], 1.0 - share))
    found = rare_event(CAMPAIGN, f"distance > {threshold} m", points=200, repeats=4)
    error = math.hypot(found.probability.variation, math.sqrt(1.0 / (count * share)))
    assert abs(math.log(found.probability.value / share)) < 3.5 * error
    assert found.importance.low < found.probability.high
    assert found.importance.high > found.probability.low
    assert sum(found.shares.values()) == pytest.approx(1.0)
    assert max(found.shares, key=found.shares.get) == "vehicle.mass factor"  # the rail has no say in so short a stop
    assert found.stop.run.braking_distance > threshold
    stop = found.stop.run
    again = simulate(stop.scenario, stop.controller, seed=found.stop.noise)
    assert again.braking_distance == found.stop.run.braking_distance


def test_stops_that_are_refused_count_as_the_event_and_are_told(monkeypatch):
    """Here those of a vehicle 6 % heavier than nominal: one in 44."""
    whole = rare.Stops.run

    def run(self, point, **given):
        if self.drawn(point)[0]["vehicle.mass factor"] > 1.06:
            raise InputError("it is refused")
        return whole(self, point, **given)

    monkeypatch.setattr(rare.Stops, "run", run)
    found = rare_event(CAMPAIGN, "distance > 100 m", points=100, repeats=3)
    assert any("not simulated to the end" in warning for warning in found.warnings)
    assert found.subset.low < stats.norm.sf(2.0) < found.subset.high


def test_a_campaign_whose_stops_all_take_too_long_is_refused():
    slow = replace(CAMPAIGN, scenario=SCENARIO.with_changes(longest_time=0.5))
    with pytest.raises(InputError, match=r"distance: no stop .* longest_time 0\.5 s"):
        rare_event(slow, EVENT, points=100, repeats=3)


def test_numbers_depend_neither_on_workers_nor_on_resuming(tmp_path):
    told, spent = [], {"points": 100, "repeats": 3}
    here = rare_event(CAMPAIGN, EVENT, folder=tmp_path, progress=told.append, **spent)
    (first,) = tmp_path.glob("rare-*")
    (first / "repeat-2.npz").unlink()
    kept = {path: path.stat().st_mtime_ns for path in first.iterdir()}
    there = rare_event(CAMPAIGN, EVENT, folder=tmp_path, workers=2, **spent)
    assert there == here
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(told) == 7  # the pilot, three repeats, importance samples for each


def test_confidence_levels_fall_from_the_median():
    found = confidence_levels(CAMPAIGN, points=100, repeats=3)
    factors = [one.factor for one in found.factors]
    assert [one.level for one in found.factors] == list(range(10))
    assert all(a.value > b.value for a, b in pairwise(factors))
    assert all(one.low < one.value < one.high for one in factors)
    assert factors[0].value == pytest.approx(1.0, abs=0.02)  # the median is about the nominal stop


@pytest.mark.parametrize(("event", "words"), [
    ("distanc > 3 m", "event: 'distanc > 3 m' is not allowed"), ("distance > 3", "event: 'distance > 3' .* unit"),
    ("time > 3 m", "wrong dimension"), ("slip > -0.5", "event: slip: -0.5 is not allowed"),
])  # fmt: skip
def test_other_events_are_refused(event, words):
    with pytest.raises(InputError, match=words):
        Event.read(event)


def test_a_lock_is_the_slip_at_which_runs_report_one():
    assert Event.read("lock") == Event("slip", 1.0 - LOCKED_SHARE)
    assert str(Event.read("distance > 0.42 km")) == "distance > 420 m"


@pytest.mark.parametrize(("changes", "words"), [
    ({"controllers": (CONTROLLER, published_controller("asmc"))}, "controllers: 2 given"),
    ({"quantities": (Quantity(("vehicle.mass",), Grid((3000.0,))),)}, "vehicle.mass.* is a grid"),
    ({"scenario": SCENARIO.with_changes(disturbances={}, measurement={}), "quantities": ()}, "random"),
])  # fmt: skip
def test_campaigns_without_a_probability_are_refused(changes, words):
    with pytest.raises(InputError, match=words):
        rare_event(replace(CAMPAIGN, **changes), "lock")


@pytest.mark.long
def test_a_dask_cluster_gives_the_same_numbers(tmp_path):
    from distributed import LocalCluster

    spent = {"points": 100, "repeats": 3}
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster:
        there = rare_event(CAMPAIGN, EVENT, folder=tmp_path, workers=None, scheduler=cluster.scheduler_address, **spent)
    assert there == rare_event(CAMPAIGN, EVENT, **spent)
    assert len(list(tmp_path.glob("rare-*/*.npz"))) == 7


@pytest.mark.long
def test_an_event_that_no_stop_meets():
    found = rare_event(CAMPAIGN, "slip > 1.5", points=100, repeats=3)
    assert found.probability.value == 0.0
    assert found.probability.high < 1e-9
    assert any("occurred in no simulated stop" in warning for warning in found.warnings)


def test_the_command_writes_a_stop_that_simulate_repeats(tmp_path, railslip):
    def run_cli(*words: object) -> str:
        status, out, err = railslip(*map(str, words))
        assert status == 0, err
        return out

    CONTROLLER.save(tmp_path / "own.toml")
    (tmp_path / "brief.toml").write_text(BRIEF_TOML)
    (tmp_path / "campaign.toml").write_text(TOML)
    out = tmp_path / "results"
    spent = ("campaign", tmp_path / "campaign.toml", "--out", out, "--points", 100, "--workers", 1)
    run_cli(*spent, "--rare", "distance > 10.7 m")
    report = json.loads((out / "rare.json").read_text())
    told = run_cli(
        *("simulate", "--scenario", out / "stop.toml", "--controller", out / "controller.toml"),
        *("--seed", out / "stop.npz", "--json"),
    )
    assert json.loads(told)["braking_distance_m"] == report["stop"]["braking_distance"]
    run_cli(*spent, "--confidence-levels")
    assert len((out / "confidence.csv").read_text().splitlines()) == 11
    assert (out / "tail.png").stat().st_size > 10_000


@pytest.mark.long
def test_three_methods_agree_on_the_vehicles():
    for found in script("analysis/rare_events.py").run(stops=400, points=100).values():
        assert 1e-11 < found.event.probability.value < 1e-7
        assert abs(math.log(found.event.importance.value / 1e-9)) < math.log(3.0)
        for _, plain, estimate in found.plain:
            assert plain.low < estimate.high
            assert estimate.low < plain.high
