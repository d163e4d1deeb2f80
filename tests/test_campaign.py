"""Campaigns: what is drawn, by which path it goes where, what statistics say; against SciPy and NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from campaigns import DEAD_TIME, MASS, PI, SHORT, SOFT, short_campaign, write_campaign
from scipy import stats

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.simulation.campaign import (
    Campaign,
    Choice,
    Grid,
    LogNormal,
    Normal,
    Quantity,
    Sampling,
    Triangular,
    Uniform,
)
from railslip_ctrl.simulation.campaign.files import load_campaign
from railslip_ctrl.simulation.campaign.intervals import CONFIDENCE, Moments, quantile_ranks, share
from railslip_ctrl.simulation.campaign.paths import numbers, replaced
from railslip_ctrl.simulation.campaign.selection import order_statistics
from railslip_ctrl.simulation.catalogue import controller_named
from railslip_ctrl.simulation.scenario import Event

LEVELS = np.array([0.0, 1e-9, 0.01, 0.2, 0.5, 0.77, 0.99, 1 - 1e-9])


def truncated(mean, std, low, high):
    return stats.truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (Uniform(-2.0, 5.0), stats.uniform(-2.0, 7.0)),
        (Normal(3.0, 0.5), truncated(3.0, 0.5, 1.0, 5.0)),
        (Normal(0.0, 1.0, 2.0, 6.5), truncated(0.0, 1.0, 2.0, 6.5)),
        (Normal(0.0, 1.0, -6.5, -2.0), truncated(0.0, 1.0, -6.5, -2.0)),
        (Triangular(1.0, 1.5, 4.0), stats.triang(0.5 / 3.0, loc=1.0, scale=3.0)),
        (Triangular(1.0, 1.0, 4.0), stats.triang(0.0, loc=1.0, scale=3.0)),
    ],
)
def test_quantile_functions_are_scipys(ours, theirs):
    # the distribution function's inverse loses digits in the tails: 1e-9 is what double precision leaves there
    assert [ours.at(u) for u in LEVELS] == pytest.approx(theirs.ppf(LEVELS), rel=1e-9, abs=1e-9)
    assert ours.ends == pytest.approx(theirs.support())


def test_a_lognormal_is_a_normal_logarithm():
    distribution = LogNormal(2.0, 0.3)
    expected = np.exp(truncated(math.log(2.0), 0.3, math.log(2.0) - 1.2, math.log(2.0) + 1.2).ppf(LEVELS))
    assert [distribution.at(u) for u in LEVELS] == pytest.approx(expected, rel=1e-9)


def test_choices_come_as_often_as_their_weights():
    distribution = Choice((7.0, 8.0, 9.0), (1.0, 2.0, 1.0))
    assert [distribution.at(u) for u in (0.0, 0.2499, 0.25, 0.7499, 0.75, 1 - 1e-16)] == [7, 7, 8, 8, 9, 9]
    assert [Choice((7.0, 8.0)).at(u) for u in (0.4999, 0.5)] == [7, 8]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Uniform(2.0, 1.0), "low < high"),
        (lambda: Uniform(0.0, math.inf), "finite bounds"),
        (lambda: Normal(0.0, 0.0), "std 0 is not allowed"),
        (lambda: Normal(0.0, 1.0, 9.0, 10.0), "nothing of the distribution"),
        (lambda: LogNormal(-1.0, 0.1), "median -1"),
        (lambda: LogNormal(1.0, 0.1, low=0.0), "low 0"),
        (lambda: Triangular(0.0, 3.0, 2.0), "mode 3"),
        (lambda: Choice(()), "at least one"),
        (lambda: Choice((1.0,), (0.0,)), "weights"),
        (lambda: Grid((math.nan,)), "finite"),
    ],
)
def test_impossible_distributions_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_run_is_a_function_of_its_number_alone():
    """The same number gives the same values, whatever was asked for before, in a campaign of any length."""
    forward = [short_campaign().values(i) for i in range(24)]
    assert [short_campaign().values(i) for i in reversed(range(24))] == forward[::-1]
    assert short_campaign(1000).values(7) == forward[7]
    assert len({tuple(values.values()) for values in forward}) == 24
    first = Campaign(SHORT, (PI,), 24, (MASS, DEAD_TIME), seed=4).values(7)
    assert first != forward[7]


def test_designs_fill_the_cube_evenly():
    """Each of n strata has one point of a Latin hypercube, and of Sobol's 2^k; random points leave some empty."""
    for sampling, even in (("latin-hypercube", True), ("sobol", True), ("random", False)):
        campaign = short_campaign(64, (MASS, DEAD_TIME), sampling=Sampling(sampling))
        masses = np.array([campaign.values(i)["vehicle.mass"] for i in range(64)])
        strata = np.floor((masses - 3000.0) / 1000.0 * 64).astype(int)
        assert (sorted(strata) == list(range(64))) is even


def test_grids_are_combined():
    mass, factor = Grid((3000.0, 3300.0)), Grid((0.5, 1.0, 1.5))
    quantities = (Quantity(("vehicle.mass",), mass), DEAD_TIME, Quantity(("adhesion_factor",), factor))
    campaign = short_campaign(12, quantities)
    found = [tuple(campaign.values(i).values()) for i in range(12)]
    assert {(m, f) for m, _, f in found[:6]} == {(m, f) for m in mass.values for f in factor.values}
    assert [(m, f) for m, _, f in found[6:]] == [(m, f) for m, _, f in found[:6]]
    assert len({t for _, t, _ in found}) == 12  # the rest is drawn anew
    with pytest.raises(InputError, match="give a multiple of them: 6 or 12"):
        short_campaign(10, quantities)


def test_heads_are_the_ends_of_paths_that_tell_them_apart():
    lead = (Uniform(0.9, 1.1), True)
    paths = ("pi.design.gains.kp", "soft.design.gains.kp", "pi.design.gains.ki")
    quantities = (MASS, DEAD_TIME, *(Quantity((path,), *lead) for path in paths))
    assert short_campaign(4, quantities).quantity_heads == {
        "vehicle.mass": "mass (kg)",
        "vehicle.actuator.dead_time": "dead_time (s)",
        "pi.design.gains.kp factor": "pi.design.gains.kp factor",
        "soft.design.gains.kp factor": "soft.design.gains.kp factor",
        "pi.design.gains.ki factor": "ki factor",
    }


def test_every_controller_gets_the_same_vehicle_and_noise():
    gain = Quantity(("soft.design.gains.kp",), Uniform(1000.0, 2000.0))
    lag = Quantity(("vehicle.actuator.lag",), Uniform(0.5, 0.7), relative=True)
    case = short_campaign(4, (MASS, lag, gain)).case(2)
    assert case.scenario.vehicle.mass == case.values["vehicle.mass"]
    assert case.scenario.vehicle.actuator.lag == 0.6 * case.values["vehicle.actuator.lag factor"]
    assert case.controllers[0] == PI
    assert case.controllers[1].design.gains.kp == case.values["soft.design.gains.kp"]
    assert case.seed.spawn_key == (2,)
    both = short_campaign(4, (Quantity(("design.gains.kp",), Uniform(1000.0, 2000.0)),)).case(0)
    assert both.controllers[0].design.gains.kp == both.controllers[1].design.gains.kp != PI.design.gains.kp


def test_every_path_of_every_controller_can_be_set():
    """What is set is there, and nothing else has changed."""
    scenario = SHORT.with_changes(events=(Event(time=25.0, mass=5276.0),))
    for record in (scenario, *(controller_named(n, SHORT.vehicle) for n in ("pi", "asmc", "slide-protection"))):
        places = numbers(record)
        for path, place in places.items():
            if place.value is None or path in ("events.0.time", "limits.torque_min"):
                continue
            value = place.value * (1 - 1e-6) if place.value != 0.0 else 1e-6
            if path in ("vehicle.mass_loaded", "design.lead") or math.isinf(place.value):  # bound to another number
                continue
            after = numbers(replaced(record, {path: value}))
            assert {p for p in places if after[p] != places[p]} == {path}
            assert after[path].value == value


@pytest.mark.parametrize(
    ("quantity", "words"),
    [
        (Quantity(("vehicle.maas",), Uniform(1.0, 2.0)), r"did you mean 'vehicle.mass'\?"),
        (
            Quantity(("vehicle.mass",), Uniform(-1.0, 4000.0)),
            r"vehicle: mass: -1 is not allowed; give a value > 0 \(kg\)",
        ),
        (Quantity(("vehicle.mass",), Uniform(3000.0, 9000.0)), "mass_loaded: 5276 is not allowed"),
        (Quantity(("limits.torque_max",), Uniform(0.9, 1.1), relative=True), "no number for a factor"),
        (Quantity(("vehicle.mass", "vehicle.mass"), Uniform(3000.0, 4000.0)), "given twice"),
        (Quantity(("zzz",), Uniform(0.0, 1.0)), "is no number of the scenario"),
    ],
)
def test_impossible_quantities_are_refused_before_anything_runs(quantity, words):
    with pytest.raises(InputError, match=words):
        short_campaign(4, (quantity,))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Campaign(SHORT, (), 4), "none given"),
        (lambda: Campaign(SHORT, (PI, PI), 4), "two have the name 'pi'"),
        (lambda: Campaign(SHORT, (PI,), 0), "runs: 0"),
        (lambda: Campaign(SHORT, (PI,), 4, seed=-1), "seed: -1"),
        (lambda: short_campaign(24, sampling=Sampling.SOBOL), "powers of 2: 16 or 32"),
        (lambda: short_campaign(4).case(4), "runs 0 to 3"),
    ],
)
def test_impossible_campaigns_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_the_hash_is_of_everything_that_matters():
    base = short_campaign()
    assert base.fingerprint == short_campaign().fingerprint
    other = [
        short_campaign(25),
        short_campaign(quantities=(MASS,)),
        short_campaign(quantities=(DEAD_TIME, MASS)),
        short_campaign(sampling=Sampling.LATIN_HYPERCUBE),
        Campaign(SHORT, (SOFT, PI), 24, (MASS, DEAD_TIME), 3),
        Campaign(SHORT, (PI, SOFT), 24, (MASS, DEAD_TIME), 4),
        Campaign(SHORT.with_changes(adhesion_factor=0.9), (PI, SOFT), 24, (MASS, DEAD_TIME), 3),
    ]
    assert len({campaign.fingerprint for campaign in (base, *other)}) == 1 + len(other)


# --- statistics -----------------------------------------------------------------------------------------------------


def test_moments_of_parts_are_those_of_the_whole():
    data = np.random.default_rng(0).lognormal(size=1001) + 1e6  # a large mean, which a plain sum of squares loses
    found = Moments()
    for part in np.array_split(data, 13):
        found = found.joined(Moments(part.size, part.mean(), ((part - part.mean()) ** 2).sum(), part.min(), part.max()))
    assert (found.count, found.low, found.high) == (1001, data.min(), data.max())
    assert found.std == pytest.approx(data.std(ddof=1), rel=1e-9)  # 1e-16 times (1e6)^2 over the variance
    low, high = stats.t.interval(CONFIDENCE, 1000, loc=data.mean(), scale=stats.sem(data))
    assert found.estimate == pytest.approx((data.mean(), low, high), rel=1e-12)
    assert math.isnan(Moments().estimate.value)
    assert Moments(1, 5.0).estimate == (5.0, -math.inf, math.inf)


def test_order_statistics_without_holding_the_data():
    rng = np.random.default_rng(1)
    data = np.concatenate([rng.normal(size=4000), np.zeros(30), 1e300 * rng.normal(size=50), [5e-324, -5e-324]])
    rng.shuffle(data)
    ranks = [0, 1, 1999, 2000, 2040, 2041, 3000, data.size - 1]
    parts = [{"a": part, "b": -part} for part in np.array_split(data, 7)]
    found = order_statistics(lambda: parts, {"a": ranks, "b": [0]})
    assert np.array_equal(found["a"], np.sort(data)[ranks])
    assert found["b"] == [-data.max()]


@pytest.mark.parametrize(("level", "count"), [(0.5, 5), (0.5, 100), (0.05, 100), (0.95, 1000)])
def test_quantile_intervals_hold_as_often_as_they_say(level, count):
    """P(X_(l) <= q < X_(u)) is the binomial sum over the ranks between, at least 95 %; one rank less is too few."""
    _, low, high = quantile_ranks(level, count)
    below = stats.binom(count, level).cdf
    tail = 0.5 * (1 - CONFIDENCE)
    assert low is None or below(low) <= tail + 1e-12 or below(low - 1) <= tail
    assert (0.0 if low is None else below(low)) < 0.5
    covered = (1.0 if high is None else below(high)) - (0.0 if low is None else below(low))
    assert covered >= CONFIDENCE - 1e-12
    tighter = (0 if low is None else low + 1), (count if high is None else high - 1)
    assert below(tighter[0]) > tail
    assert below(tighter[1] - 1) < 1 - tail or high is None


def test_quantile_ranks_are_numpys():
    data = np.arange(200.0)
    for level in (0.05, 0.5, 0.951, 1.0):
        assert quantile_ranks(level, 200)[0] == np.quantile(data, level, method="inverted_cdf")
    assert quantile_ranks(0.07, 200)[0] == 13  # the 14th of 200; 0.07 * 200 is 14.000000000000002


def test_shares():
    """Wilson's interval in its closed form."""
    k, n, z = 3, 40, stats.norm.ppf(0.975)
    centre, half = (k + z * z / 2) / (n + z * z), z / (n + z * z) * math.sqrt(k * (n - k) / n + z * z / 4)
    assert share(k, n) == pytest.approx((k / n, centre - half, centre + half), rel=1e-12)
    assert math.isnan(share(0, 0).value)


# --- files ----------------------------------------------------------------------------------------------------------


def test_a_file_gives_the_campaign(tmp_path):
    found = load_campaign(write_campaign(tmp_path, 24))
    assert found.quantities == (MASS,)
    assert (found.runs, found.seed, found.controller_names) == (24, 3, ("pi", "soft"))
    assert found.controllers[1].design.gains.ki == pytest.approx(3.6 * 27)
    assert found.controllers[0].reference == ReferenceSlip(dry=0.132, wet=0.092)
    assert found.scenario.initial_speed == pytest.approx(30 / 3.6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"vehicle.mass"', '"vehicle.mas"', "toml: quantity 0: 'vehicle.mas' is no .* did you mean 'vehicle.mass'"),
        ('"3 t"', '"3 m"', "low: '3 m' has the wrong dimension"),
        ('"uniform"', '"unifrom"', "did you mean 'uniform'"),
        ("high = 4000", "hihg = 4000", "did you mean 'high'"),
        ("high = 4000", "", "high: missing"),
        ("high = 4000", "high = 4000\nstd = 3", "uniform has no such key"),
        ("high = 4000", "high = 4000\nrelative = 1", "relative: 1 is not allowed; give true or false"),
        ("kp = 1500", "", "kp and ki: give both"),
        ('controller = "pi"\nname', 'controller = "pid"\nname', "toml: controller 1: 'pid' is not one"),
        ("seed = 3", 'seed = 3\nsampling = "sobl"', "did you mean 'sobol'"),
        ("runs = 24", "runs = 0", "runs: 0 is not allowed; give a value >= 1"),
        ("seed = 3", "sede = 3", "sede: unknown key; did you mean 'seed'"),
        ('"short.toml"', '"park"', "campaign.toml: scenario: 'park' is not one"),
        ('path = "vehicle.mass"', 'path = ["vehicle.mass", "adhesion_factor"]', "different units"),
        ('controller = "pi"\nname', 'controller = "x.toml"\nname', "x.toml has its own"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, old, new, words):
    path = write_campaign(tmp_path, 24)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words) as refused:
        load_campaign(path)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(str(path))
