"""Campaigns: what is drawn and where it goes; the same rows whatever runs them, nothing lost by a kill; statistics."""

import hashlib
import json
import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from project import refused
from scipy import stats

from railslip_ctrl import InputError, PIGains, ReferenceSlip
from railslip_ctrl.controllers.braking import linear_control
from railslip_ctrl.design.catalogue import published_controller
from railslip_ctrl.report.campaign import campaign_json, campaign_text, replay_json, replay_text
from railslip_ctrl.report.plots.runs import distributions_figure, replay_figure, scatter_figure
from railslip_ctrl.simulation import Outcome, built_in_scenario
from railslip_ctrl.simulation.campaign import Campaign, Choice, Grid, Store, execute, replay, statistics, summarise
from railslip_ctrl.simulation.campaign import specification as drawn
from railslip_ctrl.simulation.campaign.execution import MANIFEST, MEASURES, REFUSED, Part, run_part, run_rows
from railslip_ctrl.simulation.campaign.specification import LogNormal, Normal, Quantity, Triangular, Uniform, described
from railslip_ctrl.simulation.campaign.statistics import CONFIDENCE, WORST, Moments, quantile, share

BRIEF = {"initial_speed": 30 / 3.6, "final_speed": 27 / 3.6, "longest_time": 20.0, "events": ()}
SHORT = built_in_scenario("park2008").with_changes(**BRIEF)
PI = published_controller("pi")
SOFT = linear_control(PIGains(kp=1500.0, ki=97.0), reference=PI.reference, name="soft")
IDLE = linear_control(PIGains(kp=1e-9, ki=1e-9), reference=PI.reference, name="idle")
MASS = Quantity(("vehicle.mass",), Uniform(3000.0, 4000.0))
DEAD_TIME = Quantity(("vehicle.actuator.dead_time",), Normal(0.15, 0.02))

COMMAND = [sys.executable, "-m", "railslip_ctrl", "campaign"]
TOML = """
scenario = "short.toml"
runs = {runs}
seed = 3

[[controller]]
controller = "pi"

[[controller]]
controller = "pi"
name = "soft"
kp = 1500
ki = "27 N*m/(km/h)/s"

[[quantity]]
path = "vehicle.mass"
distribution = "uniform"
low = "3 t"
high = 4000
"""
SHORT_TOML = 'extends = "park2008"\ninitial_speed = "30 km/h"\nfinal_speed = 7.5\nlongest_time = 20\nevents = []\n'


def short(runs: int = 24, quantities: tuple[Quantity, ...] = (MASS, DEAD_TIME), **changes: object) -> Campaign:
    return Campaign(SHORT, (PI, SOFT), runs, quantities, 3, **changes)


def write_campaign(folder, runs: int):
    (folder / "short.toml").write_text(SHORT_TOML)
    path = folder / "campaign.toml"
    path.write_text(TOML.format(runs=runs))
    return path


def rows_of(store: Store) -> pd.DataFrame:
    assert store.complete
    return pa.concat_tables(store.read(part) for part in store.parts()).to_pandas()


def run_command(*arguments):
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Store:
    return execute(short(), tmp_path_factory.mktemp("finished") / "out", workers=1, part_runs=5)


@pytest.mark.parametrize(("ours", "theirs"), [
    (Uniform(-2.0, 5.0), stats.uniform(-2.0, 7.0)),
    (Normal(3.0, 0.5), stats.norm(3.0, 0.5)),
    (Normal(0.0, 1.0, 2.0, 6.5), stats.truncnorm(2.0, 6.5)),
    (Normal(0.0, 1.0, -6.5, -2.0), stats.truncnorm(-6.5, -2.0)),
    (Triangular(1.0, 1.5, 4.0), stats.triang(0.5 / 3.0, loc=1.0, scale=3.0)),
    (Triangular(1.0, 1.0, 4.0), stats.triang(0.0, loc=1.0, scale=3.0)),
    (LogNormal(2.0, 0.3), stats.lognorm(0.3, scale=2.0)),
    (Choice((7.0, 8.0, 9.0), (1.0, 2.0, 1.0)), stats.rv_discrete(values=((7, 8, 9), (0.25, 0.5, 0.25)))),
    (Choice((7.0, 8.0)), stats.rv_discrete(values=((7, 8), (0.5, 0.5)))),
])  # fmt: skip
def test_quantile_functions_are_scipys(ours, theirs):
    levels, tails = np.array([1e-9, 0.01, 0.2, 0.49999, 0.50001, 0.77, 0.99, 1 - 1e-9]), stats.norm.cdf([-4, 4])
    if math.isinf(theirs.support()[1]):  # ours ends at 4 standard deviations
        ends, expected = theirs.ppf(tails), theirs.ppf(tails[0] + levels * (tails[1] - tails[0]))
    else:
        ends, expected = theirs.support(), theirs.ppf(levels)
    # the distribution function's inverse loses digits in the tails: 1e-9 is what double precision leaves there
    assert [ours.at(u) for u in levels] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert [ours.at(0.0), ours.at(1.0)] == pytest.approx(ours.ends)
    assert ours.ends == pytest.approx(ends)


@pytest.mark.parametrize(("sampling", "even"), [("latin-hypercube", True), ("sobol", True), ("random", False)])
def test_designs_fill_the_cube_evenly(sampling, even):
    """Each of n strata has one point of a Latin hypercube, and of Sobol's 2^k; random points leave some empty."""
    campaign, longer = (short(runs, sampling=drawn.Sampling(sampling)) for runs in (64, 128))
    masses = np.array([campaign.values(i)["vehicle.mass"] for i in range(64)])
    assert (sorted(np.floor((masses - 3000.0) / 1000.0 * 64)) == list(range(64))) is even
    assert (longer.values(5) == campaign.values(5)) is (sampling != "latin-hypercube")  # which alone is laid out anew
    assert replace(campaign, seed=4).values(5) != campaign.values(5)


def test_every_controller_gets_the_same_vehicle_and_noise():
    gain = Quantity(("soft.kp",), Uniform(1000.0, 2000.0))
    lag = Quantity(("vehicle.actuator.lag",), Uniform(0.5, 0.7), relative=True)
    case = short(4, (MASS, lag, gain)).case(2)
    assert case.scenario.vehicle.mass == case.values["vehicle.mass"]
    assert case.scenario.vehicle.actuator.lag == 0.6 * case.values["vehicle.actuator.lag factor"]
    assert case.controllers[0] == PI.believing(SHORT.vehicle)
    assert case.controllers[1].kp == case.values["soft.kp"]
    assert case.seed.spawn_key == (2,)
    both = short(4, (Quantity(("kp",), Uniform(1000.0, 2000.0)),)).case(0)
    assert both.controllers[0].kp == both.controllers[1].kp != PI.kp


def mass(distribution, relative=False, *paths):
    return short(4, (Quantity(paths or ("vehicle.mass",), distribution, relative),))


@pytest.mark.parametrize(("make", "words"), [
    (lambda: Uniform(2.0, 1.0), "uniform: from 2 to 1 .* low < high"),
    (lambda: Uniform(0.0, math.inf), "finite bounds"),
    (lambda: Normal(0.0, 0.0), "std: 0 is not allowed"),
    (lambda: Normal(0.0, 1.0, 9.0, 10.0), r"normal: .*low and high"),
    (lambda: LogNormal(-1.0, 0.1), "median: -1"), (lambda: Triangular(0.0, 3.0, 2.0), "mode 3"),
    (lambda: Choice(()), "choice: .* at least one"), (lambda: Choice((1.0,), (0.0,)), "weights"),
    (lambda: Grid((math.nan,)), "grid: .* finite"),
    (lambda: mass(Uniform(-1.0, 4000.0)), r"vehicle: mass: -1 is not allowed; give a value > 0 \(kg\)"),
    (lambda: mass(Uniform(3000.0, 9000.0)), "mass_loaded: 5276 is not allowed"),
    (lambda: mass(Uniform(0.9, 1.1), True, "limits.torque_max"), "limits.torque_max.* factor"),
    (lambda: mass(Uniform(3000.0, 4000.0), False, "vehicle.mass", "vehicle.mass"), "given twice"),
    (lambda: mass(Grid((3000.0, 3300.0, 3500.0))), "multiple of 3: 3 or 6"),
    (lambda: Campaign(SHORT, (), 4), "controllers: "),
    (lambda: Campaign(SHORT, (SOFT, SOFT), 4), "two have the name 'soft'"),
    (lambda: Campaign(SHORT, (PI,), 0), "runs: 0"),
    (lambda: short(24, sampling=drawn.Sampling.SOBOL), "powers of 2; give 16 or 32"),
    (lambda: short(4).case(4), "runs 0 to 3"),
])  # fmt: skip
def test_the_impossible_is_refused_before_anything_runs(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_the_hash_is_of_everything_that_matters():
    base = short()
    changes = (
        *({"runs": 25}, {"quantities": (MASS,)}, {"quantities": (DEAD_TIME, MASS)}, {"controllers": (SOFT, PI)}),
        *({"sampling": drawn.Sampling.LATIN_HYPERCUBE}, {"seed": 4}),
        {"scenario": SHORT.with_changes(adhesion_factor=0.9)},
    )
    assert len({replace(base, **change).fingerprint for change in ({}, {}, *changes)}) == 8
    assert replace(base, device="gpu").fingerprint != base.fingerprint
    before = {name: value for name, value in described(base).items() if name != "device"}  # older folders go on
    assert hashlib.sha256(json.dumps(before, sort_keys=True).encode()).hexdigest() == base.fingerprint


def test_a_file_gives_the_campaign(tmp_path):
    path = write_campaign(tmp_path, 24)
    found = drawn.load_campaign(path)
    assert found.quantities == (MASS,)
    assert (found.runs, found.seed, found.controller_names) == (24, 3, ("pi", "soft"))
    assert found.controllers[1].ki == pytest.approx(3.6 * 27)
    assert found.controllers[0].reference == ReferenceSlip(dry=0.132, wet=0.092)
    assert found.scenario.initial_speed == pytest.approx(30 / 3.6)
    (tmp_path / "own.py").write_text("def step(t, v, omega):\n    return 1500.0\n\n\nCONTROLLER = step\n")
    IDLE.save(tmp_path / "idle.toml")
    others = drawn.load_campaign(path, controllers=("pi-lead", str(tmp_path / "idle.toml"), str(tmp_path / "own.py")))
    assert others.controller_names == ("pi-lead", "idle", "own")


@pytest.mark.parametrize(("old", "new", "words"), [
    ('"vehicle.mass"', '"vehicle.mas"', "toml: quantity 0: 'vehicle.mas' .* did you mean 'vehicle.mass'"),
    ('"3 t"', '"3 m"', "low: '3 m' has the wrong dimension"),
    ('"uniform"', '"unifrom"', "did you mean 'uniform'"),
    ("high = 4000", "high = 4000\nstd = 3", "std: unknown key of uniform"),
    ("kp = 1500", "", "kp and ki: "),
    ('controller = "pi"\nname', 'controller = "pid"\nname', "toml: controller 1: 'pid' is "),
    ('controller = "pi"\nname', 'controller = "x.toml"\nname', "ki is not allowed .*x.toml"),
    ("seed = 3", 'seed = 3\nsampling = "sobl"', "'sobl' is not allowed; .* 'sobol'"),
    ('path = "vehicle.mass"', 'path = ["vehicle.mass", "adhesion_factor"]', "different units"),
])  # fmt: skip
def test_bad_files_are_refused_in_one_line(tmp_path, old, new, words):
    path = write_campaign(tmp_path, 24)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words) as refused:
        drawn.load_campaign(path)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(str(path))


def test_rows_depend_on_neither_workers_nor_parts(finished, tmp_path):
    told = []
    other = execute(short(), tmp_path / "out", workers=2, part_runs=7, progress=told.append)
    expected = rows_of(finished)
    assert rows_of(other).equals(expected)
    assert [told[0], sum(told)] == [0, 24]
    rows = [row for i in reversed(range(24)) for row in reversed(run_rows(short(), i))]
    assert pd.DataFrame(rows[::-1]).astype(expected.dtypes).equals(expected)  # a column of None alone has no type
    schema = finished.schema()
    assert [schema.field(name).metadata[b"unit"] for name in ("vehicle.mass", "max_torque_nm")] == [b"kg", b"N*m"]


@pytest.mark.long
def test_a_dask_cluster_gives_the_same_rows(tmp_path):
    from distributed import LocalCluster

    path = write_campaign(tmp_path, 24)
    here = execute(drawn.load_campaign(path), tmp_path / "here", workers=1)
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster:
        there = run_command(path, "--out", tmp_path / "there", "--scheduler", cluster.scheduler_address, "--json")
    assert there.returncode == 0, there.stderr
    assert json.loads(there.stdout) == campaign_json(summarise(here))
    assert rows_of(Store.open(here.campaign, tmp_path / "there")).equals(rows_of(here))


@pytest.mark.long
def test_a_killed_campaign_loses_and_repeats_nothing(tmp_path):
    path, out = write_campaign(tmp_path, 160), tmp_path / "out"
    parts, deadline = out / "parts", time.monotonic() + 120
    campaign = subprocess.Popen([*COMMAND, str(path), "--out", str(out), "--workers", "2"], stderr=subprocess.PIPE)
    while not (parts.is_dir() and len(list(parts.glob("*.parquet"))) >= 3):
        assert campaign.poll() is None, campaign.stderr.read().decode()
        assert time.monotonic() < deadline
        time.sleep(0.002)
    workers = psutil.Process(campaign.pid).children(recursive=True)
    campaign.kill()
    campaign.communicate()
    left = {part: part.stat().st_mtime_ns for part in parts.glob("*.parquet")}
    assert 3 <= len(left) < 40  # it was killed in the middle
    assert len(workers) >= 2
    assert psutil.wait_procs(workers, timeout=20)[1] == []  # they do not outlive it
    (parts / ".incomplete-of-the-kill").mkdir()
    resumed = run_command(path, "--out", out, "--workers", "1", "--json")
    assert resumed.returncode == 0, resumed.stderr
    assert {part: part.stat().st_mtime_ns for part in left} == left  # none was run again
    assert not list(out.rglob(".incomplete-*"))
    unkilled = execute(drawn.load_campaign(path), tmp_path / "whole", workers=1)
    assert rows_of(Store.open(unkilled.campaign, out)).equals(rows_of(unkilled))
    assert json.loads(resumed.stdout) == campaign_json(summarise(unkilled))


def test_what_cannot_be_executed_or_summed_up_is_refused(finished, tmp_path):
    out = tmp_path / "out"
    for options, words in (
        ({"workers": 0}, "workers: 0"),
        ({"workers": 2, "scheduler": "tcp://127.0.0.1:1"}, "workers: .* scheduler"),
        ({"part_runs": 0}, "part_runs: 0"),
        ({"scheduler": "nonsense://here"}, "cannot be reached"),
    ):
        with pytest.raises(InputError, match=words):
            execute(short(), out, **options)
        assert not out.exists()
    with pytest.raises(InputError, match="a worker has version"):
        run_part(short(), Part(0, 1), "0.0.0")
    with pytest.raises(InputError, match=r"out: .*no results yet"):
        summarise(Store.open(short(), out))
    with pytest.raises(InputError, match="different campaign"):
        execute(replace(finished.campaign, seed=4), finished.folder)
    out.mkdir()
    manifest, content = out / MANIFEST, (finished.folder / MANIFEST).read_text()
    version = json.loads(content)["version"]
    for text, words in ((content.replace(version, "0.0.1"), r"begun with version 0\.0\.1"), ("{}", MANIFEST)):
        manifest.write_text(text)
        with pytest.raises(InputError, match=words):
            execute(finished.campaign, out)
    for place in (tmp_path, manifest):
        with pytest.raises(InputError, match="other files"):
            execute(finished.campaign, place)
    assert os.listdir(tmp_path) == ["out"]


def test_two_do_not_write_into_one_folder_and_a_damaged_part_is_named(finished, tmp_path):
    store = Store.open(finished.campaign, tmp_path / "out", part_runs=12)
    with store.claimed(), pytest.raises(InputError, match="being written to by another process"):
        execute(finished.campaign, tmp_path / "out", workers=1)
    execute(finished.campaign, tmp_path / "out", workers=1, part_runs=12)
    first = store.path(next(store.parts()))
    first.write_bytes(first.read_bytes()[:100])
    with pytest.raises(InputError, match=r"runs-0000000000-0000000011\.parquet .*delete"):
        summarise(store)
    pq.write_table(finished.read(Part(0, 5)).slice(0, 3), first)
    with pytest.raises(InputError, match=r"3 rows .* 24"):
        summarise(store)


def test_a_replay_is_the_stored_run_to_the_last_bit(finished, tmp_path):
    again, stored = replay(finished.campaign, 13, finished.folder), finished.row(13)["soft"]
    assert again.stored
    signals = again.runs["soft"].signals
    assert signals.distance[-1] == stored["braking_distance_m"]
    assert signals.slip.max() == pytest.approx(stored["max_slip"], rel=1e-3)  # the record has every sample, not step
    assert again.values["vehicle.mass"] == stored["vehicle.mass"]
    assert not replay(finished.campaign, 13).stored
    assert len(replay_figure(again).axes) == 6
    with Store.open(finished.campaign, tmp_path / "out", part_runs=5).claimed() as store:
        rows = finished.read(Part(0, 5)).to_pylist()
        rows[3]["max_slip"] = np.nextafter(rows[3]["max_slip"], 1.0)
        store.write(Part(0, 5), rows)
    with pytest.raises(InputError, match="run 1, soft: max_slip is"):
        replay(store.campaign, 1, store.folder)


def test_means_quantiles_and_shares_with_their_intervals():
    """Quantiles: Conover, Practical Nonparametric Statistics, 3.2."""
    data = np.random.default_rng(0).lognormal(size=1001)
    found = Moments.of(np.array([math.nan, *data, math.inf]))
    assert (found.count, found.low, found.high) == (1001, data.min(), data.max())
    low, high = stats.t.interval(CONFIDENCE, 1000, loc=data.mean(), scale=stats.sem(data))
    assert found.estimate == pytest.approx((data.mean(), low, high), rel=1e-12)
    assert np.isnan(Moments.of(np.array([math.nan])).estimate).all()
    assert Moments.of(np.array([5.0])).estimate == (5.0, -math.inf, math.inf)
    assert quantile(np.arange(1.0, 101.0), 0.5) == (50, 40, 61)
    assert quantile(np.arange(1.0, 6.0), 0.5) == (3, -math.inf, math.inf)  # 2 * 0.5^5 > 5 %
    assert quantile(np.arange(1.0, 101.0), 0.05)[0] == 5
    assert (share(3, 40).value, math.isnan(share(0, 0).value)) == (3 / 40, True)
    # a picture has at most the bins of Rice's rule, 2 n^(1/3), of those that the bins counted make without a rest
    data = np.random.default_rng(1).normal(size=1100)  # 20.6 bins
    found = statistics.Histogram.of(data).merged()
    bins = max(k for k in range(1, 21) if statistics.BINS % k == 0)
    counts, edges = np.histogram(data, bins)
    assert (found.counts.tolist(), found.edges.tolist()) == (counts.tolist(), pytest.approx(edges.tolist()))


def test_intervals_hold_the_truth_as_often_as_they_say():
    """The mean's counted; a quantile's by the ranks of its ends, at least as often as said; Wilson's exactly: as often
    as said on average over the shares, and not at each of them ([Agresti1998])."""
    means = [Moments.of(one).estimate for one in np.random.default_rng(4).normal(3.0, 2.0, (500, 6))]
    assert stats.binomtest(sum(one.low <= 3.0 <= one.high for one in means), 500, CONFIDENCE).pvalue > 0.01
    for size, level in ((12, 0.5), (100, 0.5), (100, 0.05)):
        _, low, high = quantile(np.arange(1.0, size + 1.0), level)  # numbers below the quantile: binomial
        covered = stats.binom.cdf(high - 1, size, level) - stats.binom.cdf(low - 1, size, level)
        assert CONFIDENCE <= covered < 0.99
    shares, k = np.linspace(0.1, 0.9, 81), np.arange(41)[:, None]
    ends = np.array([share(one, 40)[1:] for one in range(41)])
    covered = np.sum((ends[:, :1] <= shares) * (shares <= ends[:, 1:]) * stats.binom.pmf(k, 40, shares), axis=0)
    assert covered.mean() == pytest.approx(CONFIDENCE, abs=0.005)
    assert np.abs(covered - CONFIDENCE).max() < 0.04


def test_statistics_are_numpys(finished):
    summary, frame = summarise(finished, worst_by="max_slip"), rows_of(finished)
    for name, own in frame.groupby("controller"):
        for measure, found in summary.controllers[name].measures.items():
            values, moments = own[measure].to_numpy(), (found.moments.mean, found.moments.std)
            assert moments == pytest.approx((values.mean(), values.std(ddof=1)), rel=1e-9, abs=1e-15)
            expected = {p: np.quantile(values, p, method="inverted_cdf") for p in statistics.LEVELS}
            assert {level: estimate.value for level, estimate in found.quantiles.items()} == expected
        worst = own.sort_values("max_slip", ascending=False)["run"].tolist()[:WORST]
        assert [row["run"] for row in summary.controllers[name].worst] == worst
    assert list(summary.controllers["pi"].measures) == [measure.name for measure in MEASURES]
    wide = frame.pivot(index="run", columns="controller", values="braking_time_s")
    pair = next(p for p in summary.paired if p.measure == "braking_time_s")
    assert pair.difference.value == pytest.approx((wide.soft - wide.pi).mean(), rel=1e-9)
    assert pair.second_smaller.value == (wide.soft < wide.pi).mean()
    assert (pair.first, pair.second, pair.pairs) == ("pi", "soft", 24)
    with pytest.raises(InputError, match="did you mean 'max_slip'"):
        summarise(finished, worst_by="max_slp")


def test_runs_that_fail_are_counted_listed_and_in_no_mean(tmp_path):
    hurried = SHORT.with_changes(longest_time=3.2, vehicle=SHORT.vehicle.model_copy(update={"mass_loaded": 4500.0}))
    loaded = Quantity(("vehicle.mass_loaded",), Uniform(3700.0, 5000.0))
    store = execute(Campaign(hurried, (PI, IDLE), 60, (MASS, loaded), 5), tmp_path / "out", workers=1)
    summary, frame = summarise(store), rows_of(store)
    found, frame = summary.controllers["pi"], frame[frame.controller == "pi"]
    assert found.outcomes == frame.outcome.value_counts().to_dict()
    assert set(found.outcomes) == {Outcome.STOPPED, Outcome.OUT_OF_TIME, REFUSED}
    assert (frame["vehicle.mass"] > frame["vehicle.mass_loaded"]).sum() == found.outcomes[REFUSED]
    stopped, late = frame[frame.outcome == "stopped"], frame[frame.outcome == Outcome.OUT_OF_TIME]
    assert found.measures["braking_time_s"].moments.mean == pytest.approx(stopped.braking_time_s.mean())
    assert found.not_stopped.value == pytest.approx(1 - len(stopped) / 60)
    assert found.failed[Outcome.OUT_OF_TIME] == late.run.tolist()[: statistics.LISTED]
    assert set(found.failed) == {Outcome.OUT_OF_TIME, REFUSED}
    assert late[["braking_time_s", "braking_distance_m", "brake_energy_j", "mean_abs_slip_error"]].isna().all(axis=None)
    assert late.ended_at_s.to_list() == pytest.approx([3.2] * len(late))  # the longest time
    assert late.ended_at_m.between(3.2 * 27 / 3.6, 3.2 * 30 / 3.6).all()  # between the speeds' distances
    text = campaign_text(summary)
    assert text.count(f"pi, {Outcome.OUT_OF_TIME}: runs {late.run.iloc[0]}, ") == 2  # of the outcomes, and of the worst
    lines = [line.split()[3:] for line in text.splitlines() if "braking time" in line]
    told = [line for line in lines if line[0] == "idle"]
    assert told == [["idle", "0", *"----"], ["idle", *"---"], ["idle", "-", "pi", "0", *"--"]]
    legend = distributions_figure(summary).legends[0].get_texts()
    assert [entry.get_text() for entry in legend] == [f"pi ({len(stopped)})", "idle (none)"]
    again = replay(store.campaign, int(late.run.iloc[0]), store.folder)
    content = replay_json(again)["controllers"]["idle"]
    assert (content["braking_time_s"], content["ended_at_s"]) == (None, again.runs["idle"].braking_time)
    assert "did not stop after 3.2 s" in replay_text(again)
    alone = summarise(execute(Campaign(SHORT, (IDLE,), 4), tmp_path / "alone", workers=1))
    found = campaign_json(alone)["controllers"]["idle"]
    assert (found["measures"]["max_slip"]["mean"]["value"], found["share_not_stopped"]["value"]) == (None, 1.0)
    assert "no statistics and no pictures" in campaign_text(alone)
    assert distributions_figure(alone) is scatter_figure(alone) is None


def test_grids_are_combined_the_rest_is_drawn_anew_and_told_point_by_point(tmp_path):
    masses, factors = (3000.0, 4000.0), (0.9, 1.0, 1.1)
    sweep = (Quantity(("vehicle.mass",), Grid(masses)), DEAD_TIME, Quantity(("adhesion_factor",), Grid(factors)))
    store = execute(short(12, sweep), tmp_path / "out", workers=1, part_runs=5)
    summary, frame = summarise(store), rows_of(store)
    own = frame[frame.controller == "soft"]
    points = [(mass, factor) for factor in factors for mass in masses]
    assert list(zip(own["vehicle.mass"], own["adhesion_factor"], strict=True)) == 2 * points
    assert own["vehicle.actuator.dead_time"].nunique() == 12
    for point, (mass, factor) in zip(summary.points, points, strict=True):
        there = own[(own["vehicle.mass"] == mass) & (own["adhesion_factor"] == factor)]
        assert (point.values, len(there)) == ({"vehicle.mass": mass, "adhesion_factor": factor}, 2)
        assert point.means["soft", "braking_time_s"].value == pytest.approx(there.braking_time_s.mean(), rel=1e-12)
        assert point.not_stopped["soft"].value == 0.0
    assert "Grid" in campaign_text(summary)


def test_the_command(tmp_path, railslip):
    path, out = write_campaign(tmp_path, 8), tmp_path / "out"
    status, text, errors = railslip("campaign", path, "--out", out, "--workers", "1")
    assert (status, text) == (0, (out / "report.txt").read_text())
    assert "8/8" in errors
    assert {"manifest.json", "parts", "report.json", "distributions.png", "scatter.png"} <= set(os.listdir(out))
    content = json.loads(railslip("campaign", path, "--out", out, "--replay", "5", "--json")[1])
    assert content["stored"] is True
    log = Path(out / "run-5-soft.csv").read_text().splitlines()
    assert log[0].startswith("time,distance,speed,")
    again = np.column_stack(replay(drawn.load_campaign(path), 5).runs["soft"].signals)
    assert [[float(cell) for cell in line.split(",")[: again.shape[1]]] for line in log[1:]] == again.tolist()
    assert float(log[-1].split(",")[1]) == content["controllers"]["soft"]["braking_distance_m"]
    for wrong, words in (
        (("--replay", "8"), "--replay: 8 is not allowed; the campaign has runs 0 to 7"),
        (("--worst-by", "speed"), "--worst-by: unknown measure 'speed'"),
        (("--controller", "pi-lad"), "--controller: 'pi-lad' is "),
    ):
        assert refused(railslip("campaign", path, "--out", out, *wrong)).startswith(f"railslip: error: {words}")


@pytest.mark.long
def test_the_monte_carlo_script(tmp_path, ran):
    """24 of its vehicles; what is said of each vehicle is asserted of each, the rest of the means."""
    result, out, pictures = ran("analysis/monte_carlo.py", folder=tmp_path / "runs", runs=24, workers=1)
    shorter = {(p.first, p.second): p for p in result.paired if p.measure == "braking_distance_m"}
    assert shorter["pi", "pi-lead"].second_smaller.value == shorter["asmc", "pi-lead"].second_smaller.value == 1.0
    assert shorter["pi", "asmc"].difference.high < 0.0  # beyond its interval
    pi, asmc, lead = (result.controllers[name].measures["mean_abs_slip_error"] for name in ("pi", "asmc", "pi-lead"))
    assert lead.quantiles[0.5].value < 0.7 * pi.quantiles[0.5].value
    assert asmc.moments.mean > pi.moments.mean
    assert result.controllers["pi"].locked.value == 0.0 < result.controllers["pi-lead"].locked.value
    locks = pd.concat(pd.read_parquet(part) for part in tmp_path.rglob("*.parquet"))["first_lock_s"].dropna()
    assert locks.between(25.0, 27.0).all()  # the rail turns wet at 25 s
    assert ("pi-lead - pi" in out, len(pictures)) == (True, 2)
