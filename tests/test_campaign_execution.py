"""Campaigns run: the same rows whatever runs them, nothing lost by a kill, flat memory, runs replayed."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from campaigns import DEAD_TIME, MASS, PI, SHORT, short_campaign, write_campaign
from project import script

import railslip_ctrl.simulation.campaign.execution as execution
import railslip_ctrl.simulation.campaign.statistics as statistics
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design import PIController
from railslip_ctrl.model.vehicle import PIGains
from railslip_ctrl.report.campaign import campaign_json, campaign_text, replay_json, replay_text
from railslip_ctrl.report.plots.campaign import distributions_figure, replay_figure, scatter_figure
from railslip_ctrl.simulation import LinearControl, Outcome
from railslip_ctrl.simulation.campaign import Campaign, Grid, Quantity, Uniform, execute, replay, summarise
from railslip_ctrl.simulation.campaign.execution import run_part, run_rows
from railslip_ctrl.simulation.campaign.files import load_campaign
from railslip_ctrl.simulation.campaign.rows import MEASURES, REFUSED
from railslip_ctrl.simulation.campaign.storage import LOCK, MANIFEST, Part, Store

OF_STOP = ("braking_time_s", "braking_distance_m", "brake_energy_j", "mean_abs_slip_error")
"""What `simulate --json` has null too of a run that did not stop."""

COMMAND = [sys.executable, "-m", "railslip_ctrl", "campaign"]


def rows_of(store: Store) -> pd.DataFrame:
    """Every row; `equals` of two frames is to the last bit, NaN equal to NaN."""
    assert store.complete
    return pa.concat_tables(store.tables()).to_pandas()


def run_command(*arguments, **options):
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False, **options)


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Store:
    """The short campaign, run in this process."""
    return execute(short_campaign(), tmp_path_factory.mktemp("finished") / "out", workers=1, part_runs=5)


# --- the same rows --------------------------------------------------------------------------------------------------


def test_rows_depend_on_neither_workers_nor_parts(finished, tmp_path):
    told = []
    other = execute(short_campaign(), tmp_path / "out", workers=2, part_runs=7, progress=told.append)
    assert rows_of(other).equals(rows_of(finished))
    assert [told[0], sum(told)] == [0, 24]
    assert len(list(finished.parts())) == 5
    rows = [row for i in reversed(range(24)) for row in reversed(run_rows(short_campaign(), i))]
    expected = rows_of(finished)
    assert pd.DataFrame(rows[::-1]).astype(expected.dtypes).equals(expected)  # a column of None alone has no type


def test_a_dask_cluster_gives_the_same_rows(tmp_path):
    """The same command, on a scheduler with two worker processes."""
    from distributed import LocalCluster

    path = write_campaign(tmp_path, 24)
    here = execute(load_campaign(path), tmp_path / "here", workers=1)
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        there = run_command(path, "--out", tmp_path / "there", "--scheduler", address, "--json")
        assert len(cluster.scheduler_info["workers"]) == 2
    assert there.returncode == 0, there.stderr
    assert json.loads(there.stdout) == campaign_json(summarise(here))
    parts = sorted((here.folder / "parts").iterdir())
    assert len(parts) == 6
    for part in parts:
        assert pd.read_parquet(tmp_path / "there" / "parts" / part.name).equals(pd.read_parquet(part))


def test_columns_carry_their_units(finished):
    schema = pq.read_schema(finished.path(next(finished.parts())))
    assert schema.field("vehicle.mass").metadata[b"unit"] == b"kg"
    assert schema.field("braking_distance_m").metadata[b"unit"] == b"m"


# --- kills ----------------------------------------------------------------------------------------------------------


def test_a_killed_campaign_loses_and_repeats_nothing(tmp_path):
    runs = 160
    path, out = write_campaign(tmp_path, runs), tmp_path / "out"
    campaign = subprocess.Popen([*COMMAND, str(path), "--out", str(out), "--workers", "2"], stderr=subprocess.PIPE)
    parts = out / "parts"
    deadline = time.monotonic() + 120
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
    (parts / ".incomplete-of-the-kill").write_bytes(b"half a part")
    resumed = run_command(path, "--out", out, "--workers", "1", "--json")
    assert resumed.returncode == 0, resumed.stderr
    assert {part: part.stat().st_mtime_ns for part in left} == left  # none was run again
    assert not list(out.rglob(".incomplete-*"))
    unkilled = execute(load_campaign(path), tmp_path / "whole", workers=1)
    found = rows_of(Store.open(unkilled.campaign, out))
    assert found["run"].tolist() == [i for i in range(runs) for _ in range(2)]
    assert found.equals(rows_of(unkilled))
    assert json.loads(resumed.stdout) == campaign_json(summarise(unkilled))


def test_another_campaign_in_the_folder_is_refused(finished, tmp_path):
    with pytest.raises(InputError, match="holds another campaign"):
        execute(replace(finished.campaign, seed=4), finished.folder)
    manifest = finished.folder / MANIFEST
    content = manifest.read_text()
    try:
        manifest.write_text(content.replace(json.loads(content)["version"], "0.0.1"))
        with pytest.raises(InputError, match=r"begun with version 0\.0\.1"):
            execute(finished.campaign, finished.folder)
        manifest.write_text("{}")
        with pytest.raises(InputError, match="no campaign's"):
            execute(finished.campaign, finished.folder)
    finally:
        manifest.write_text(content)
    (tmp_path / "letter.txt").write_text("mine")
    with pytest.raises(InputError, match="holds something else"):
        execute(finished.campaign, tmp_path)
    with pytest.raises(InputError, match="holds something else"):
        execute(finished.campaign, tmp_path / "letter.txt")
    assert os.listdir(tmp_path) == ["letter.txt"]


def test_a_damaged_part_is_named(finished, tmp_path):
    store = execute(finished.campaign, tmp_path / "out", workers=1, part_runs=12)
    first = store.path(next(store.parts()))
    first.write_bytes(first.read_bytes()[:100])
    with pytest.raises(InputError, match="delete it and resume"):
        summarise(store)
    pq.write_table(finished.read(Part(0, 5)).slice(0, 3), first)
    with pytest.raises(InputError, match="3 rows in place of 24"):
        summarise(store)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"workers": 0}, "--workers: 0"),
        ({"workers": 2, "scheduler": "tcp://127.0.0.1:1"}, "leave it out with --scheduler"),
        ({"part_runs": 0}, "part_runs: 0"),
        ({"scheduler": "nonsense://here"}, "cannot be reached"),
        ({"scheduler": "foo"}, "--scheduler: 'foo' cannot be reached .*port"),
    ],
)
def test_impossible_executions_are_refused(tmp_path, options, words):
    with pytest.raises(InputError, match=words):
        execute(short_campaign(), tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="a worker has version"):
        run_part(short_campaign(), Part(0, 1), "0.0.0")


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path, monkeypatch):
    """In a process of its own: what a client says while it goes is said at the end."""
    path, out = write_campaign(tmp_path, 4), tmp_path / "out"
    refused = run_command(path, "--out", out, "--scheduler", "foo", timeout=60)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.startswith("railslip: error: --scheduler: 'foo' cannot be reached")
    assert refused.stderr.count("\n") == 1
    monkeypatch.setattr(execution, "_REACH", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:  # takes the call and says nothing
        began = time.monotonic()
        with pytest.raises(InputError, match=r"cannot be reached \(.+\); give its address"):
            execute(short_campaign(), out, scheduler=f"tcp://127.0.0.1:{silent.getsockname()[1]}")
        assert time.monotonic() - began < 5.0  # far below the minutes of a client that waits, far above 0.2 s
    assert not out.exists()


def test_two_processes_do_not_write_into_one_folder(tmp_path):
    """The second is refused while the first is alive; a lock that a killed one leaves is none."""
    path, out = write_campaign(tmp_path, 4), tmp_path / "out"
    hold = (
        "import sys, time; from pathlib import Path\n"
        "from railslip_ctrl.simulation.campaign import Store\n"
        "from railslip_ctrl.simulation.campaign.files import load_campaign\n"
        "with Store.open(load_campaign(Path(sys.argv[1])), Path(sys.argv[2])).claimed():\n"
        "    print('held', flush=True)\n"
        "    time.sleep(120)\n"
    )
    other = subprocess.Popen([sys.executable, "-c", hold, str(path), str(out)], stdout=subprocess.PIPE)
    try:
        assert other.stdout.readline() == b"held\n"
        before = sorted(out.rglob("*"))
        with pytest.raises(InputError, match="being written to by another process"):
            execute(load_campaign(path), out, workers=1)
        assert sorted(out.rglob("*")) == before
    finally:
        other.kill()
        other.communicate()
    assert (out / LOCK).exists()
    assert execute(load_campaign(path), out, workers=1).complete


# --- memory ---------------------------------------------------------------------------------------------------------


def test_memory_is_flat_as_runs_grow(tmp_path, monkeypatch):
    """Peak of ten times the runs within a tenth: what grows is a hundred bytes of bookkeeping a part, rows would
    double it. What is kept for speed and for pictures up to a bound is kept out."""
    monkeypatch.setattr(statistics, "_HELD", 0)
    monkeypatch.setattr(statistics, "_SHOWN", 50)
    blink = SHORT.with_changes(initial_speed=28 / 3.6, longest_time=5.0)

    def peak(runs: int) -> tuple[int, int]:
        campaign = Campaign(blink, (PI,), runs, (MASS,))
        tracemalloc.start()
        arrow = pa.total_allocated_bytes()
        summarise(execute(campaign, tmp_path / f"{runs}", workers=1, part_runs=20))
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found, pa.total_allocated_bytes() - arrow

    peak(20)  # imports and kernels
    (few, few_arrow), (many, many_arrow) = peak(100), peak(1000)
    assert many < 1.1 * few
    assert few_arrow == many_arrow == 0  # Arrow's own memory is given back part by part


# --- results --------------------------------------------------------------------------------------------------------


def test_a_replay_is_the_stored_run_to_the_last_bit(finished):
    again = replay(finished.campaign, 13, finished.folder)
    assert again.stored
    signals = again.runs["soft"].signals
    stored = finished.row(13)["soft"]
    assert signals.distance[-1] == stored["braking_distance_m"]
    assert signals.slip.max() == pytest.approx(stored["max_slip"], rel=1e-3)  # the record has every sample, not step
    assert again.values["vehicle.mass"] == stored["vehicle.mass"]
    assert not replay(finished.campaign, 13).stored
    figure = replay_figure(again)
    assert len(figure.axes) == 6


def test_a_replay_that_differs_is_no_replay(finished, tmp_path):
    store = execute(finished.campaign, tmp_path / "out", workers=1, part_runs=24)
    (part,) = store.parts()
    rows = store.read(part).to_pylist()
    rows[3]["max_slip"] = np.nextafter(rows[3]["max_slip"], 1.0)
    store.write(part, rows)
    with pytest.raises(InputError, match="run 1, soft: max_slip is"):
        replay(store.campaign, 1, store.folder)


def test_statistics_are_numpys(finished):
    summary = summarise(finished, worst_by="max_slip")
    frame = rows_of(finished)
    for name in ("pi", "soft"):
        own = frame[frame.controller == name]
        for measure in MEASURES:
            found, values = summary.controllers[name].measures[measure.name], own[measure.name].to_numpy()
            assert found.mean.value == pytest.approx(values.mean(), rel=1e-12)
            assert found.moments.std == pytest.approx(values.std(ddof=1), rel=1e-9, abs=1e-15)
            for level, quantile in found.quantiles.items():
                assert quantile.value == np.quantile(values, level, method="inverted_cdf")
            assert found.histogram.counts.sum() == found.histogram.merged().counts.sum() == 24
        worst = own.sort_values("max_slip", ascending=False)["run"].tolist()[: statistics.WORST]
        assert [row["run"] for row in summary.controllers[name].worst] == worst
    wide = frame.pivot(index="run", columns="controller", values="braking_time_s")
    pair = next(p for p in summary.paired if p.measure == "braking_time_s")
    assert pair.difference.value == pytest.approx((wide.soft - wide.pi).mean(), rel=1e-9)
    assert pair.second_smaller.value == (wide.soft < wide.pi).mean()
    assert (pair.first, pair.second, pair.pairs) == ("pi", "soft", 24)
    with pytest.raises(InputError, match="did you mean 'max_slip'"):
        summarise(finished, worst_by="max_slp")


def test_runs_that_fail_are_counted_listed_and_in_no_mean(tmp_path):
    """Some are too slow to stop in the time given, some have values that contradict each other."""
    hurried = SHORT.with_changes(longest_time=3.2, vehicle=SHORT.vehicle.model_copy(update={"mass_loaded": 4500.0}))
    loaded = Quantity(("vehicle.mass_loaded",), Uniform(3700.0, 5000.0))
    campaign = Campaign(hurried, (PI,), 60, (MASS, loaded), 5)
    store = execute(campaign, tmp_path / "out", workers=1)
    summary = summarise(store)
    found, frame = summary.controllers["pi"], rows_of(store)
    expected = frame.outcome.value_counts().to_dict()
    assert found.outcomes == expected
    assert set(expected) == {Outcome.STOPPED, Outcome.OUT_OF_TIME, REFUSED}
    stopped = frame[frame.outcome == "stopped"]
    assert (frame["vehicle.mass"] > frame["vehicle.mass_loaded"]).sum() == expected[REFUSED]
    assert found.measures["braking_time_s"].mean.value == pytest.approx(stopped.braking_time_s.mean())
    assert found.measures["braking_time_s"].moments.high <= 3.2
    assert found.not_stopped.value == pytest.approx(1 - len(stopped) / 60)
    late = frame.run[frame.outcome == Outcome.OUT_OF_TIME].tolist()
    assert list(found.failed[Outcome.OUT_OF_TIME]) == late[: statistics.LISTED]
    text = campaign_text(summary)
    assert text.count(f"pi, {Outcome.OUT_OF_TIME}: runs {late[0]}, ") == 2  # of the outcomes, and of the worst
    assert "They are in no average below." in text
    ended = frame[frame.outcome == Outcome.OUT_OF_TIME]
    assert ended[list(OF_STOP)].isna().all(axis=None)
    assert ended.ended_at_s.to_list() == pytest.approx([3.2] * len(ended))  # the longest time
    assert ended.ended_at_m.between(3.2 * 27 / 3.6, 3.2 * 30 / 3.6).all()  # between the speeds' distances
    assert (stopped.ended_at_s == stopped.braking_time_s).all()
    assert (stopped.ended_at_m == stopped.braking_distance_m).all()


def test_a_campaign_in_which_nothing_stops_has_no_means(tmp_path):
    campaign = Campaign(SHORT.with_changes(longest_time=0.5), (PI,), 4)
    store = execute(campaign, tmp_path / "out", workers=1)
    summary = summarise(store)
    content = campaign_json(summary)
    assert content["controllers"]["pi"]["measures"]["braking_time_s"]["mean"]["value"] is None
    assert content["controllers"]["pi"]["share_not_stopped"]["value"] == 1.0
    text = campaign_text(summary)
    assert "nothing but the noise" in text
    assert "None: there are no statistics and no pictures." in text
    assert "unbounded" not in text
    assert text.count("pi, did not stop: runs 0, 1, 2, 3\n") == 2
    assert distributions_figure(summary) is None
    for column in OF_STOP:
        assert pa.concat_tables(store.tables([column]))[column].null_count == 4  # null, as every reader knows it


def test_a_controller_that_never_stops_beside_one_that_does(tmp_path):
    """Without torque there is no stop in the time given: its numbers are "-", and it is in the pictures by name."""
    idle = LinearControl(PIController(PIGains(kp=1e-9, ki=1e-9)), PI.reference, name="idle")
    store = execute(Campaign(SHORT, (PI, idle), 4, (MASS,)), tmp_path / "out", workers=1)
    summary = summarise(store)
    lines = [line.split() for line in campaign_text(summary).splitlines() if "braking time" in line]
    idles = [line[3:] for line in lines if line[3] == "idle"]
    assert idles == [["idle", "0", *"----"], ["idle", *"---"], ["idle", "-", "pi", "0", *"--"]]
    assert "unbounded" not in campaign_text(summary)
    figure = distributions_figure(summary)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["pi (4)", "idle (none)"]
    assert len(scatter_figure(summary).axes) == 1
    again = replay(store.campaign, 1, store.folder)
    assert again.stored
    content = replay_json(again)["controllers"]["idle"]
    assert [content[column] for column in OF_STOP] == [None] * len(OF_STOP)
    assert content["ended_at_s"] == again.runs["idle"].braking_time == pytest.approx(20.0)
    assert "did not stop after 20 s" in replay_text(again)


def test_tables_and_pictures_have_short_heads_and_readable_units(finished):
    summary = summarise(finished, worst_by="brake_energy_j")
    worst = campaign_text(summary).partition("Worst runs by brake energy")[2]
    for head in ("brake energy (MJ)", "mass (kg)", "dead_time (s)"):
        assert head in worst
    scatter, distributions = scatter_figure(summary), distributions_figure(summary)
    assert [ax.get_xlabel() for ax in scatter.axes] == ["mass (kg)", "dead time (s)"]
    assert scatter.axes[0].get_ylabel() == "brake energy (MJ)"
    top = summary.controllers["pi"].worst[0]
    assert scatter.axes[0].texts[0].xy == (top["vehicle.mass"], 1e-6 * top["brake_energy_j"])
    (energy,) = (ax for ax in distributions.axes if ax.get_xlabel() == "brake energy (MJ)" and ax.lines)
    edges = 1e-6 * summary.controllers["pi"].measures["brake_energy_j"].histogram.edges
    assert energy.lines[0].get_xdata() == pytest.approx(edges)
    corners = {tuple(ax.texts[i].xyann) for ax in scatter.axes for i in range(2)}
    assert len(corners) == 2  # the two controllers' labels stand in different corners


def test_a_sweep_is_told_point_by_point(tmp_path):
    factor = Quantity(("vehicle.mass",), Grid((3000.0, 4000.0)))
    store = execute(short_campaign(12, (factor, DEAD_TIME)), tmp_path / "out", workers=1, part_runs=5)
    summary = summarise(store)
    frame = rows_of(store)
    for point in summary.points:
        own = frame[(frame["vehicle.mass"] == point.values["vehicle.mass"]) & (frame.controller == "soft")]
        assert len(own) == 6
        assert point.means["soft", "braking_time_s"].value == pytest.approx(own.braking_time_s.mean(), rel=1e-12)
    assert "Grid" in campaign_text(summary)
    assert len(scatter_figure(summary).axes) == 2


# --- the command ----------------------------------------------------------------------------------------------------


def test_the_command(tmp_path, railslip):
    path, out = write_campaign(tmp_path, 8), tmp_path / "out"
    status, text, errors = railslip("campaign", path, "--out", out, "--workers", "1")
    assert (status, text) == (0, (out / "report.txt").read_text())
    assert "second smaller" in text
    assert "8/8" in errors
    assert {"manifest.json", "parts", "report.json", "distributions.png", "scatter.png"} <= set(os.listdir(out))
    content = json.loads(railslip("campaign", path, "--out", out, "--replay", "5", "--json")[1])
    assert content["stored"] is True
    log = Path(out / "run-5-soft.csv").read_text().splitlines()
    assert log[0].startswith("time,distance,speed,")
    assert float(log[-1].split(",")[1]) == content["controllers"]["soft"]["braking_distance_m"]
    for wrong, words in (
        (("--replay", "8"), "--replay: 8 is not allowed; the campaign has runs 0 to 7"),
        (("--replay", "-1"), "--replay: -1"),
        (("--workers", "0"), "--workers: 0"),
        (("--worst-by", "speed"), "--worst-by: 'speed' is no measure"),
    ):
        status, text, errors = railslip("campaign", path, "--out", out, *wrong)
        assert (status, text) == (2, "")
        assert errors.startswith("railslip: error: ")
        assert words in errors
        assert errors.count("\n") == 1


def test_the_monte_carlo_script(tmp_path, capsys, monkeypatch):
    """24 of its vehicles; what is said of each vehicle is asserted of each, the rest of the means."""
    monte_carlo = script("analysis/monte_carlo.py")
    result = monte_carlo.run(tmp_path, runs=24, workers=1)
    shorter = {(p.first, p.second): p for p in result.paired if p.measure == "braking_distance_m"}
    assert shorter["pi", "pi-lead"].second_smaller.value == shorter["asmc", "pi-lead"].second_smaller.value == 1.0
    assert shorter["pi", "asmc"].difference.high < 0.0  # beyond its interval
    pi, asmc, lead = (result.controllers[name] for name in monte_carlo.CONTROLLERS)
    slip = "mean_abs_slip_error"
    assert lead.measures[slip].quantiles[0.5].value < 0.7 * pi.measures[slip].quantiles[0.5].value
    assert asmc.measures[slip].mean.value > pi.measures[slip].mean.value
    assert pi.locked.value == 0.0 < lead.locked.value
    locks = pd.concat(pd.read_parquet(part) for part in (tmp_path / "parts").iterdir())["first_lock_s"].dropna()
    assert locks.between(25.0, 27.0).all()  # the rail turns wet at 25 s
    monkeypatch.setattr(sys, "argv", ["monte_carlo.py", str(tmp_path), "24"])
    monte_carlo.main()
    assert "pi-lead - pi" in capsys.readouterr().out
    assert len(list(tmp_path.glob("*.png"))) == 2
