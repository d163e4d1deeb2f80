"""Figures show the records they are given: lines, labels, units; nothing is lost in grey."""

from __future__ import annotations

import matplotlib.colors
import numpy as np
import pytest

from railslip_ctrl.design import PIController, margin_grid, outline, stabilizing_pi
from railslip_ctrl.design.robustness import OperatingRange, robustness
from railslip_ctrl.design.schedule import plant_at
from railslip_ctrl.design.sweeps import sweep_slip, sweep_speed
from railslip_ctrl.design_check import design_check
from railslip_ctrl.errors import InputError
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.curves import frequency_curve, gang_of_four
from railslip_ctrl.loop.responses import step_response
from railslip_ctrl.parameters import PARK2008, PIGains, Rail
from railslip_ctrl.plots import (
    bode_figure,
    gang_of_four_figure,
    margin_map_figure,
    nichols_figure,
    nyquist_figure,
    region_figure,
    response_figure,
    save_figure,
    sweep_figure,
)
from railslip_ctrl.plots.style import line_style

PI_LEAD = PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)
PI = PIController(PIGains(kp=190.0, ki=5.0))


@pytest.fixture(scope="module")
def groups():
    return design_check(PARK2008, [plant_at("bristle", PARK2008, rail, 100.0).point for rail in Rail]).groups


def labels(figure):
    return [ax.get_xlabel() + ax.get_ylabel() + ax.get_title() for ax in figure.axes]


def test_bode_draws_the_curve_it_is_given(groups):
    figure = bode_figure(groups)
    curve = groups[0].curves[0]
    line = figure.axes[0].lines[0]
    assert np.array_equal(line.get_xdata(), curve.omega)
    assert np.array_equal(line.get_ydata(), curve.magnitude_db)
    assert any("(rad/s)" in text for text in labels(figure))
    assert any("(dB)" in text for text in labels(figure))
    assert any("(deg)" in text for text in labels(figure))


def test_nyquist_shows_minus_one_encirclements_and_closing_arc(groups):
    figure = nyquist_figure(groups)
    texts = [t.get_text() for ax in figure.axes for t in ax.texts]
    assert texts.count("−1") == 2 * len(groups)
    legend = [t.get_text() for t in figure.axes[0].get_legend().get_texts()]
    assert legend[0] == "dry, 100 km/h: P = 1, N = -1, Z = P − N = 2"
    arcs = [line for line in figure.axes[0].lines if line.get_linestyle() == ":" and len(line.get_xdata()) == 181]
    assert arcs
    # one turn, drawn: the whole curve of the unstable loop winds once clockwise around -1 (at -1/2 in the picture)
    curve, arc = groups[0].curves[0], arcs[-2]
    w = curve.response / (1 + np.abs(curve.response))
    closed = np.concatenate([np.conj(w[::-1]), arc.get_xdata() + 1j * arc.get_ydata(), w])
    turns = np.angle((closed[1:] + 0.5) / (closed[:-1] + 0.5)).sum() / (2 * np.pi)
    assert round(-turns) == 1


def test_nichols_shares_its_phase_axis(groups):
    figure = nichols_figure(groups)
    assert len({ax.get_xlim() for ax in figure.axes}) == 1


def test_figures_say_whose_they_are(groups):
    for draw in (bode_figure, nyquist_figure, nichols_figure):
        title = draw(groups).get_suptitle()
        for text in ("Park et al. 2008", "bristle", "slip dry 0.132, wet 0.092", "railslip_ctrl"):
            assert text in title


def test_lines_differ_in_dash_and_in_grey():
    styles = [line_style(i) for i in range(30)]
    assert len({(s["color"], str(s["linestyle"])) for s in styles}) == 30
    grey = [matplotlib.colors.rgb_to_hsv(matplotlib.colors.to_rgb(s["color"]))[2] for s in styles[:5]]
    assert len({str(s["linestyle"]) for s in styles[:5]}) == 5
    assert len(set(np.round(grey, 2))) >= 4


def test_region_figure_outlines_the_set_and_marks_the_choice():
    plant = Rational(np.array([]), np.array([0.25, -1 / 0.6]), 1 / (4 * 0.6))
    region = stabilizing_pi(plant, dead_time=0.15)
    strips = outline(region)
    grid = margin_grid(region, np.linspace(1.1, 20, 25), np.linspace(0.05, 6, 25))
    figure = region_figure(strips, grid, {"chosen": (5.0, 1.0)}, title="a region")
    patch = figure.axes[0].patches[0].get_xy()
    assert patch[:, 0].min() == pytest.approx(1.0, abs=0.01)
    assert patch[:, 0].max() == pytest.approx(23.3988, abs=0.05)
    assert all("kp (N·m/(m/s))" in text for text in labels(figure))
    at = np.nanargmin(np.abs(grid.kp - 5.0)), np.nanargmin(np.abs(grid.ki - 1.0))
    assert np.isfinite(grid.ms[at])


def test_margin_grid_equals_the_loops_themselves():
    plant = Rational(np.array([]), np.array([0.25, -1 / 0.6]), 1 / (4 * 0.6))
    region = stabilizing_pi(plant, dead_time=0.15)
    grid = margin_grid(region, [0.5, 2.0, 12.0, 30.0], [0.0, 0.5, 3.0])
    for i, kp in enumerate(grid.kp):
        for j, ki in enumerate(grid.ki):
            assert np.isfinite(grid.ms[i, j]) == region.contains(kp, ki)
            if region.contains(kp, ki):
                assert grid.ms[i, j] == pytest.approx(region.loops(kp, ki)[0].margins().ms, rel=1e-7)
    with pytest.raises(InputError, match="not finite"):
        margin_grid(region, [np.nan], [1.0])


def test_sweep_figure_leaves_gaps_where_unstable():
    slow = sweep_speed({"PI": PI}, [5.0, 10.0, 40.0, 100.0], law="curve")
    assert np.isnan(slow.margins["PI"].ms[0])
    assert np.isfinite(slow.margins["PI"].ms[-1])
    figure = sweep_figure([slow, sweep_slip({"PI": PI}, [0.05, 0.1, 0.13])], title="sweeps")
    assert np.isnan(figure.axes[0].lines[0].get_ydata()[0])
    assert any("speed (km/h)" in text for text in labels(figure))
    scheduled = sweep_speed({"fixed": PI, "scheduled": lambda v: PI}, [40.0, 100.0])
    assert np.array_equal(scheduled.margins["fixed"].ms, scheduled.margins["scheduled"].ms)
    with pytest.raises(InputError, match="at least one"):
        sweep_speed({}, [40.0])


def test_response_and_gang_of_four_figures(tmp_path):
    plant = Rational(np.array([]), np.array([0.0]), 2.0)
    response = step_response(Rational(np.array([]), np.array([]), 1.0), plant, 0.3, final_time=5.0)
    figure = response_figure({"P": response}, {"P": response}, title="r", reference_label="a", load_label="b")
    assert np.array_equal(figure.axes[0].lines[0].get_ydata(), response.output)
    gang = gang_of_four(Rational(np.array([]), np.array([]), 1.0), DeadTimeLoop(plant, 0.3), 0.01, 100.0)
    assert np.abs(gang.s + gang.t - 1).max() < 1e-12
    drawn = gang_of_four_figure({"P": gang}, title="gang")
    assert any("N·m/(m/s)" in text for text in labels(drawn))
    for path in (tmp_path / "a.png", tmp_path / "b.png"):
        save_figure(gang_of_four_figure({"P": gang}, title="gang"), path)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_margin_map_figure_writes_the_numbers():
    result = robustness(PI_LEAD, OperatingRange(laws=("bristle",), speeds_kmh=(40.0, 100.0), slip_factors=(1.0, 1.5)))
    figure = margin_map_figure({"PI-lead": result}, "bristle", title="map")
    _, _, worst = result.speed_slip_map("bristle", Rail.DRY)
    texts = {t.get_text() for t in figure.axes[0].texts}
    assert texts == {f"{x:.3g}" for x in worst.ravel()}


def test_frequency_curve_contains_its_crossovers():
    loop = DeadTimeLoop(Rational(np.array([]), np.array([0.0]), 2.0), 0.3)
    curve = frequency_curve(loop, 0.1, 10.0)
    assert 2.0 in np.round(curve.omega, 12)


def test_title_names_every_mass_shown(groups):
    loaded = PARK2008.loaded()
    both = (groups[0], design_check(loaded, [plant_at("bristle", loaded, Rail.DRY, 100.0).point]).groups[0])
    assert "M 3517, 5276 kg" in bode_figure(both).get_suptitle()
