"""Figures show the records they are given: lines, labels, units; nothing is lost in grey or on paper.

Every figure that a test saves is looked at besides (conftest.py); here are those that no other test saves, and what the
look itself is worth.
"""

import numpy as np
import pytest
from figure_checks import defects

from railslip_ctrl import PARK2008, Envelope, PIController, PIGains, Rail, Rational, judge
from railslip_ctrl.design.assessment import assess, controller_group, published_groups
from railslip_ctrl.design.schedule import plant_at, sweep_slip, sweep_speed
from railslip_ctrl.loop.responses import step_response
from railslip_ctrl.report import plots
from railslip_ctrl.report.plots.style import figure_bytes, new_figure

PI = PIController(PIGains(kp=190.0, ki=5.0))


@pytest.fixture(scope="module")
def groups():
    return published_groups([plant_at("bristle", PARK2008, rail, 100.0).point for rail in Rail])


def defects_of(figure):
    figure.draw_without_rendering()
    return defects(figure)


def test_a_loop_without_gain_is_drawn_without_a_curve(groups):
    """Its magnitude is -inf dB, alone and beside others; a warning of numpy would be an error here."""
    plant = plant_at("bristle", PARK2008, Rail.DRY, 100.0)
    zero = controller_group("no gain", (assess(plant, PIController(PIGains(kp=0.0, ki=0.0)), PARK2008.actuator),))
    assert np.all(zero.curves[0].magnitude_db == -np.inf)
    drawn = [draw((zero,)) for draw in (plots.bode_figure, plots.nyquist_figure, plots.nichols_figure)]
    beside, curve = plots.bode_figure((zero, groups[0])), groups[0].curves[0]
    assert not any(map(defects_of, [*drawn, beside]))
    assert np.array_equal(beside.axes[1].lines[0].get_data(), [curve.omega, curve.magnitude_db])


def test_nyquist_shows_minus_one_encirclements_and_closing_arc(groups):
    figure = plots.nyquist_figure(groups)
    critical = [line.get_data() for ax in figure.axes for line in ax.lines if line.get_marker() == "+"]
    assert critical == [([-0.5], [0])] * len(groups) + [([-1], [0])] * len(groups)
    assert "+: −1" in figure.get_supxlabel()
    legend = [t.get_text() for t in figure.axes[len(groups)].get_legend().get_texts()]
    assert legend[0] == "dry, 100 km/h (unstable): P 1, N −1, Z 2"
    arcs = [line for line in figure.axes[0].lines if line.get_linestyle() == ":" and len(line.get_xdata()) == 181]
    assert arcs
    # one turn, drawn: the whole curve of the unstable loop winds once clockwise around -1 (at -1/2 in the picture)
    curve, arc = groups[0].curves[0], arcs[-2]
    w = curve.response / (1 + np.abs(curve.response))
    closed = np.concatenate([np.conj(w[::-1]), arc.get_xdata() + 1j * arc.get_ydata(), w])
    turns = np.angle((closed[1:] + 0.5) / (closed[:-1] + 0.5)).sum() / (2 * np.pi)
    assert round(-turns) == 1


def test_sweep_figure_leaves_gaps_where_unstable():
    slow = sweep_speed({"PI": PI}, [5.0, 10.0, 40.0, 100.0], law="curve")
    assert np.isnan(slow.margins["PI"].ms[[0, -1]]).tolist() == [True, False]
    figure = plots.sweep_figure([slow, sweep_slip({"PI": PI}, [0.05, 0.1, 0.13])], title="sweeps")
    assert np.isnan(figure.axes[0].lines[0].get_ydata()[0])


def test_the_map_of_a_judgement_writes_its_numbers():
    lead = PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)
    found = judge(lead, Envelope(speeds=(20.0, 100.0))).map
    figure = found.plot()
    for ax, worst in zip(figure.axes, (found.operating, found.with_tolerances), strict=True):
        cells = [t.get_text() for t in ax.texts]
        assert [one == "unst." for one in cells] == np.isinf(worst.ravel()).tolist()
        up = [float(one) - x for one, x in zip(cells, worst.ravel(), strict=True) if np.isfinite(x)]
        assert 0 <= min(up) <= max(up) < 0.0101 * max(1.0, np.max(worst[np.isfinite(worst)]) / 10)  # never below
    assert found.operating.max() < 9.99
    assert np.isinf(found.with_tolerances).any()


def test_a_command_that_begins_far_above_the_rest_is_cut_off_and_says_so():
    plant, lag = Rational(np.array([]), np.array([-0.2]), 2.0), Rational(np.array([]), np.array([-1.0]), 1.0)
    for lead, highest in (((0.0, 0.0), 0.5), ((1.0, 0.02), 25.0)):  # kp, and kp times 1/0.02
        c = PIController(PIGains(kp=0.5, ki=0.1), *lead).transfer_function
        steps = {"PI": step_response(c, plant, 0.1, final_time=30.0, actuator=lag)}
        figure = plots.response_figure(steps, steps, title="r", reference_label="a", load_label="b")
        assert steps["PI"].control[0] == pytest.approx(highest, rel=1e-6)
        told = [text.get_text() for text in figure.axes[2].texts]
        assert told == ["cut off: down to 0.0526 N·m and up to 25 N·m"] * (highest > 1)
        top = figure.axes[2].get_ylim()[1]
        assert top < 2.0 if told else top > steps["PI"].control.max()
        assert defects_of(figure) == []


def test_the_same_figure_gives_the_same_file():
    def drawn(form):
        figure = new_figure(2.0, "twice")
        figure.subplots().plot([0.0, 1.0], [0.0, 1.0])
        return figure_bytes(figure, form)

    assert all(drawn(form) == drawn(form) for form in ("png", "svg"))
