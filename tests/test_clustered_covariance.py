"""Intervals from tests that differ: the jackknife over tests against refits, its coverage, and the fit that uses it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from rig_logs import identified, rig_rows
from scipy.stats import t as student

from railslip_ctrl.identification.fits import LEAST_TESTS, clustered_covariance, search, whole_tests
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.models import Coordinates
from railslip_ctrl.identification.observed import BrakedRows
from railslip_ctrl.identification.prediction import Intervals
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.vehicle import Rail

ROWS = 40  # of a test


def straight_line(seed, tests, scatter, rows=ROWS):
    """Residuals of a line through data with a level and a slope of its own in each test, slopes, tests, and errors."""
    generator = np.random.default_rng(seed)
    x = generator.uniform(0.0, 1.0, tests * rows)
    design = np.stack([np.ones_like(x), x], axis=1)
    test = np.repeat(np.arange(tests), rows)
    level = scatter * generator.standard_normal((tests, 2))
    y = np.sum(level[test] * design, axis=1) + generator.standard_normal(x.size)
    found = np.linalg.lstsq(design, y, rcond=None)[0]
    return design, design @ found - y, y, test, found


def test_the_covariance_is_that_of_refits_without_each_test():
    """By definition: (G - 1)/G times the scatter of the estimates that leave out one test, here by solving anew."""
    design, residuals, y, test, _ = straight_line(1, 7, 2.0)
    known = clustered_covariance(design, residuals, test)
    without = np.array([np.linalg.lstsq(design[test != i], y[test != i], rcond=None)[0] for i in range(7)])
    scatter = without - without.mean(axis=0)
    assert known.covariance == pytest.approx(6.0 / 7.0 * scatter.T @ scatter, rel=1e-9)  # rounding of a linear problem
    assert known.freedom == 6


def test_intervals_hold_the_truth_where_tests_differ_and_where_they_agree():
    """Of 600 logs 99 % hold it, give or take 3 standard deviations of such a count; the residuals alone do not."""
    held, by_rows = 0, 0
    for seed in range(600):
        design, residuals, _, test, found = straight_line(seed, 6, 1.0)
        known = clustered_covariance(design, residuals, test)
        assert known is not None
        held += abs(found[0]) <= student.ppf(0.995, known.freedom) * math.sqrt(known.covariance[0, 0])
        by_rows += abs(found[0]) <= 2.576 * math.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    assert held >= 600 * 0.99 - 3.0 * math.sqrt(600 * 0.99 * 0.01)
    assert by_rows < 0.8 * 600
    agreeing = [clustered_covariance(*(straight_line(seed, 6, 0.0)[i] for i in (0, 1, 3))) for seed in range(200)]
    told = sum(each is not None for each in agreeing)
    assert told <= 2 + 3.0 * math.sqrt(2)  # of 200, 2 by the level of 1 % at which tests are taken to differ


def test_it_says_nothing_of_few_tests_nor_of_one_that_alone_shows_a_parameter():
    few = straight_line(0, LEAST_TESTS - 1, 2.0)
    assert clustered_covariance(few[0], few[1], few[3]) is None
    design, residuals, _, test, _ = straight_line(0, 6, 2.0)
    design[test > 0, 1] = 0.0
    assert clustered_covariance(design, residuals, test) is None
    assert clustered_covariance(design[:0], residuals[:0], test[:0]) is None


def test_pieces_of_a_test_are_one():
    """Runs of 2 s: 0.3 s apart they are one test that was interrupted, 30 s apart two tests."""
    end = np.concatenate([begin + 0.1 * np.arange(1, 21) for begin in (0.0, 2.3, 34.3, 66.3)])
    run = np.repeat(np.arange(4), 20)
    found = whole_tests(end, np.full(80, 0.1), run)
    assert found.tolist() == np.repeat([0, 0, 1, 2], 20).tolist()
    assert whole_tests(end[:0], end[:0], run[:0]).size == 0


# --- the fit -------------------------------------------------------------------------------------------------------


def test_scatter_from_test_to_test_widens_what_it_shifts():
    """The adhesion of six tests scattered by 3 %, by their wheel loads: of mu_max that is an error, and is told.

    The noise within the tests would have it a fifth of that; and what the scatter does not shift stays well known.
    """
    law = published_law("beam", Rail.DRY)
    factor = np.exp(0.03 * np.random.default_rng(8).standard_normal(6))
    widths = {}
    for name, loads in (("scattered", factor), ("alike", np.ones(6))):
        rows = rig_rows(law, runs=6, seed=4, loads=tuple(loads))[0]
        rows.columns.pop("wheel_load", None)  # nobody knows it
        found = identified(apart(rows, 6), initial_speed=100.0 / 3.6)
        parameters = {p.name: p for p in found.chosen.fit.parameters}
        assert all(p.interval[0] <= getattr(law, p.name) <= p.interval[1] for p in parameters.values())
        widths[name] = {p.name: (p.interval[1] - p.interval[0]) / getattr(law, p.name) for p in parameters.values()}
    # of a mean of six, with 5 degrees of freedom; the noise within the tests is a quarter of that
    expected = 2.0 * student.ppf(0.995, 5) * np.std(factor, ddof=1) / math.sqrt(6)
    assert widths["scattered"]["mu_max"] == pytest.approx(expected, rel=0.3)
    assert widths["scattered"]["mu_max"] > 3.0 * widths["alike"]["mu_max"]
    assert widths["scattered"]["a"] < 3.0 * widths["alike"]["a"]


def apart(rows: Rows, runs: int) -> Rows:
    """The runs of a log 30 s apart."""
    columns = dict(rows.columns)
    size = columns["time"].size
    columns["time"] = columns["time"] + 30.0 * (np.arange(size) // (size // runs))
    return dataclasses.replace(rows, columns=columns)


# --- between the rows ----------------------------------------------------------------------------------------------


def test_the_bend_of_the_train_s_speed_is_that_of_a_parabola_and_of_a_corner_one_side_s():
    step = 0.01
    time = step * np.arange(40)
    one, run = np.ones_like(time), np.zeros_like(time)
    record = BrakedRows(time, 20.0 - 3.0 * time**2, one, one, one, run)
    assert Intervals.of(record).speed_bend == pytest.approx(np.zeros(39))
    assert Intervals.of(record).bent().speed_bend == pytest.approx(-6.0 * step**2, rel=1e-6)  # rounding of differences
    corner = BrakedRows(time, 20.0 - np.maximum(time - 20.5 * step, 0.0), one, one, one, run)
    straight, steeper = (Intervals.of(corner).bent(steeper=each).speed_bend for each in (False, True))
    assert np.count_nonzero(np.abs(straight) > 1e-9) == 1  # the interval with the corner in it, and no neighbour
    assert np.flatnonzero(np.abs(steeper) > 1e-9).tolist() == [19, 20, 21]
    two = BrakedRows(time, corner.speed, one, one, one, np.repeat([0.0, 1.0], 20))
    assert Intervals.of(two).bent(steeper=True).speed_bend[:19] == pytest.approx(0.0, abs=1e-9)  # not from the next run


def test_a_search_has_one_end_where_the_data_tell_a_sum_alone():
    """Residuals of x0 + x1: both move alike from the centre, and as the normal equations of the pull have it."""
    coordinates = Coordinates.of(("first", "second"), np.full(2, -np.inf), np.full(2, np.inf), np.array([1.0, 2.0]))
    centre, weight = np.array([1.0, 2.0]), 0.1
    matrix, aim = np.ones((3, 2)), 5.0
    pull = np.diag((weight / centre) ** 2)
    expected = centre + np.linalg.solve(matrix.T @ matrix + pull, matrix.T @ (aim - matrix @ centre))
    for begin in (centre, np.array([-30.0, 40.0]), np.array([7.0, -1.0])):
        squares, x = search(
            lambda x: matrix @ x - aim, coordinates, begin, weight=weight, centre=centre, tolerance=1e-14, most=100
        )
        assert x == pytest.approx(expected, rel=1e-6)  # rounding of 1e-16/1e-4 in the slopes, by a curvature of 0.01
        assert squares == pytest.approx(3.0 * (x.sum() - aim) ** 2, abs=1e-12)
