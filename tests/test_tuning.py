"""Tuning: optima of the specification, equality designs, families, structures."""

from __future__ import annotations

import math

import control as ct
import numpy as np
import pytest

from railslip_ctrl import DeadTimeLoop, tune_pi
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.design import PIController, actuated_plant
from railslip_ctrl.design.schedule import plant_at
from railslip_ctrl.design.specification import family_margins, worst_of
from railslip_ctrl.design.tuning import pi_for_crossover, pi_transfer_function
from railslip_ctrl.design.tuning_search import Forbidden
from railslip_ctrl.loop import Rational
from railslip_ctrl.model.vehicle import PARK2008, PIGains, Rail

S = ct.tf("s")
LEAD = PIController(PIGains(kp=1.0, ki=0.0), lead=0.6, lead_filter=0.06).transfer_function


def twelve_points():
    """Dry and wet, 20, 60, 100 km/h, 3517 and 5276 kg, v0 = 100 km/h, as the project's issue names them."""
    plants = []
    for rail in Rail:
        for speed in (20.0, 60.0, 100.0):
            for mass in (3517.0, 5276.0):
                vehicle = PARK2008.model_copy(update={"mass": mass})
                plants.append(actuated_plant(plant_at("bristle", vehicle, rail, speed), PARK2008.actuator))
    return plants


@pytest.mark.parametrize(
    ("ki_min", "compensator", "ms", "kp"),
    [(5.0, None, 5.42, 211), (1e-6, None, 4.69, 192), (5.0, LEAD, 1.4291, 229)],
    ids=["PI", "PI, ki to 0", "PI-lead"],
)
def test_least_worst_ms_over_the_twelve_points(ki_min, compensator, ms, kp):
    design = tune_pi(twelve_points(), 0.15, minimise_ms=True, ki_min=ki_min, compensator=compensator)
    assert design.worst.ms == pytest.approx(ms, abs=0.5001 * 10.0 ** -len(str(ms).split(".")[1]))
    assert design.kp == pytest.approx(kp, abs=0.6)
    assert design.ki == ki_min
    # a brute-force search around and across finds nothing better
    rng = np.random.default_rng(3)
    for factor, more in zip(rng.uniform(0.7, 1.5, 25), rng.uniform(1.0, 1.5, 25), strict=True):
        controller = pi_transfer_function(design.kp * factor, ki_min * more)
        extra = compensator if compensator is not None else Rational(np.array([]), np.array([]), 1.0)
        worst = worst_of(family_margins([DeadTimeLoop(controller * extra * g, 0.15) for g in twelve_points()]))
        assert worst is None or worst.ms >= design.worst.ms * (1 - 1e-9)


@pytest.mark.parametrize("compensator", [None, LEAD], ids=["PI", "PI-lead"])
def test_largest_ki_under_ms_is_on_the_bound_and_the_largest(compensator):
    ms_max = 6.0 if compensator is None else 1.8
    plants = twelve_points()
    design = tune_pi(plants, 0.15, ms_max=ms_max, compensator=compensator)
    assert design.worst.ms == pytest.approx(ms_max, rel=1e-9)
    assert design.worst.ms <= ms_max
    extra = compensator if compensator is not None else Rational(np.array([]), np.array([]), 1.0)
    for kp in design.kp * np.linspace(0.8, 1.25, 19):
        controller = pi_transfer_function(kp, design.ki * 1.0005)
        worst = worst_of(family_margins([DeadTimeLoop(controller * extra * g, 0.15) for g in plants]))
        assert worst is None or worst.ms > ms_max


def test_where_the_ellipses_mislead_the_exact_margins_are_searched(monkeypatch):
    plant = twelve_points()[4]
    expected = tune_pi(plant, 0.15, ms_max=1.8, compensator=LEAD)
    end = Forbidden.end_above
    # as if a bound lay beyond their frequencies, and the more so the smaller kp is
    monkeypatch.setattr(Forbidden, "end_above", lambda self, kp, *args: end(self, kp, *args) * min(kp / 1000, 0.9))
    found = tune_pi(plant, 0.15, ms_max=1.8, compensator=LEAD)
    assert found.worst.ms == pytest.approx(1.8, rel=1e-9)
    assert found.ki == pytest.approx(expected.ki, rel=1e-9)


def test_stable_first_order_plant_against_migo_s_own_example():
    # exp(-s)/(s + 1) with Ms = 1.4 and 2.0; optimum by a dense grid of gains, independent of the ellipses
    plant, tau = 1 / (S + 1), 1.0
    for ms_max in (1.4, 2.0):
        design = tune_pi(plant, tau, ms_max=ms_max)
        omega = np.geomspace(1e-3, 30, 4000)
        p = 1 / (1j * omega + 1) * np.exp(-1j * omega * tau)
        kp, ki = np.meshgrid(np.linspace(0.05, 1.5, 60), np.linspace(0.05, 1.5, 291))
        ms = np.array(
            [1 / np.abs(1 + (a + b / (1j * omega)) * p).min() for a, b in zip(kp.ravel(), ki.ravel(), strict=True)]
        )
        ok = (ms <= ms_max) & np.array(
            [b < 1.2 and a < 1.2 for a, b in zip(kp.ravel(), ki.ravel(), strict=True)]
        )  # the stable part of the plane
        best = ki.ravel()[ok].max()
        assert design.ki == pytest.approx(best, abs=0.01)  # the grid's step is 0.005 in ki and 0.025 in kp
        assert design.ki >= best - 1e-9


def test_phase_and_delay_margins_can_bind():
    plant = twelve_points()[4]
    by_phase = tune_pi(plant, 0.15, ms_max=8.0, phase_min_deg=9.0)
    assert by_phase.worst.phase_deg == pytest.approx(9.0, rel=1e-9)
    assert by_phase.worst.ms < 8.0
    by_delay = tune_pi(plant, 0.15, delay_min_s=0.2, compensator=LEAD)
    assert by_delay.worst.delay_s == pytest.approx(0.2, rel=1e-9)


def test_crossover_bounds_are_kept():
    plant = twelve_points()[4]
    free = tune_pi(plant, 0.15, ms_max=1.8, compensator=LEAD)
    for low, high, bound in ((0.0, 1.2, 1.2), (2.2, 5.0, 2.2)):
        design = tune_pi(plant, 0.15, ms_max=1.8, crossover=(low, high), compensator=LEAD)
        found = design.margins[0].phase_frequency
        assert low * (1 - 1e-9) <= found <= high * (1 + 1e-9)
        assert found == pytest.approx(bound, rel=1e-4)  # ki changes little along the bound on Ms
        assert design.ki < free.ki


def test_infeasible_specification_says_what_can_be_had():
    with pytest.raises(InfeasibleDesignError, match=r"Ms <= 2 is asked for.*least worst Ms 4\.69.*add a lead"):
        tune_pi(twelve_points(), 0.15, ms_max=2.0)
    with pytest.raises(InfeasibleDesignError, match="no PI stabilises"):
        tune_pi(1 / (S - 5), 2.4, ms_max=3.0)
    with pytest.raises(
        InfeasibleDesignError, match=r"ki >= 1e\+06 holds all plants; the largest ki that does is about"
    ):
        tune_pi(twelve_points()[4], 0.15, minimise_ms=True, ki_min=1e6)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"ms_max": 2.0, "crossover": (2.0, 1.0)}, "crossover"),
        ({}, "nothing bounds ki"),
        ({"minimise_ms": True}, "ki_min: None is not allowed with"),
        ({"ms_max": 2.0, "ki_min": 1.0}, "goes with minimise_ms"),
    ],
)
def test_contradictory_specifications_are_refused(arguments, match):
    with pytest.raises(InputError, match=match):
        tune_pi(1 / (S + 1), 0.1, **arguments)


def test_plants_without_a_common_pi_are_called_by_their_names():
    with pytest.raises(InfeasibleDesignError, match=r"stabilises the plant\(s\): icy: no kp.*no PI can: add a lead"):
        tune_pi([1 / (S - 0.2), 1 / (S - 5)], 2.4, ms_max=3.0, names=("dry", "icy"))
    with pytest.raises(InfeasibleDesignError, match=r"behind the compensator.*icy: no kp") as caught:
        tune_pi([1 / (S - 0.2), 1 / (S - 5)], 2.4, ms_max=3.0, names=("dry", "icy"), compensator=LEAD)
    assert "add a lead" not in str(caught.value)
    with pytest.raises(InfeasibleDesignError, match=r"no PI stabilises the plant\(s\)"):
        tune_pi([1 / (S - 0.2), 1 / (S - 5)], 2.4, ms_max=3.0)
    with pytest.raises(InputError, match="names: 1 for 2 plants"):
        tune_pi([1 / (S - 0.2), 1 / (S - 5)], 2.4, ms_max=3.0, names=("dry",))


def test_plants_and_dead_times_must_match():
    with pytest.raises(InputError, match="none is given"):
        tune_pi([], 0.1, ms_max=2.0)
    with pytest.raises(InputError, match="3 values for 2 plants"):
        tune_pi([1 / (S + 1), 1 / (S + 2)], [0.1, 0.2, 0.3], ms_max=2.0)


@pytest.mark.parametrize(("crossover", "margin"), [(0.7, 8.0), (1.0, 9.0)])
def test_crossover_and_phase_margin_as_an_equality(crossover, margin):
    plant = twelve_points()[4]
    kp, ki = pi_for_crossover(plant, 0.15, crossover, margin)
    loop = DeadTimeLoop(pi_transfer_function(kp, ki) * plant, 0.15)
    at = loop(1j * crossover)
    assert abs(at) == pytest.approx(1.0, abs=1e-12)
    assert math.degrees(np.angle(-at)) == pytest.approx(margin, abs=1e-9)
    assert loop.margins().phase_deg == pytest.approx(margin, abs=1e-9)


def test_an_equality_design_of_a_plant_with_a_mode():
    mode = 1 / S + 0.1 * S / (S**2 + 0.1 * S + 25)  # |P| is 1 once more at 5 rad/s
    kp, ki = pi_for_crossover(mode, 0.03, 1.5, 80.0)
    at = (kp + ki / 1.5j) * mode(1.5j) * np.exp(-0.03 * 1.5j)
    assert at == pytest.approx(-np.exp(1j * np.radians(80.0)), abs=1e-12)
    with pytest.raises(InfeasibleDesignError, match=r"another gain crossover leaves only 71\.9"):
        pi_for_crossover(mode, 0.06, 3.0, 75.0)


@pytest.mark.parametrize(
    ("crossover", "margin", "match"),
    [(0.7, 60.0, "needs ki"), (0.05, 5.0, "does not stabilise|needs ki"), (2.5, 1.0, "ki")],
)
def test_impossible_equality_designs_are_refused(crossover, margin, match):
    with pytest.raises(InfeasibleDesignError, match=match):
        pi_for_crossover(twelve_points()[4], 0.15, crossover, margin)


@pytest.mark.parametrize(("crossover", "margin"), [(0.0, 30.0), (float("nan"), 30.0), (1.0, 0.0), (1.0, 180.0)])
def test_equality_design_checks_its_input(crossover, margin):
    with pytest.raises(InputError):
        pi_for_crossover(1 / (S + 1), 0.1, crossover, margin)


FAMILY, DEAD_TIMES = [1 / (S + 1), 2 / (S + 1.5) / (0.3 * S + 1), 1 / (S - 0.3)], [0.2, 0.3, 0.1]


@pytest.mark.parametrize(
    ("plants", "dead_times", "asked", "found_by_brute_force"),
    [
        (FAMILY, DEAD_TIMES, {"ms_max": 2.5, "phase_min_deg": 30, "delay_min_s": 0.1}, 1.2210),
        (FAMILY, DEAD_TIMES, {"phase_min_deg": 40}, 1.0605),
        (0.908 / (S - 0.3193), 0.2808, {"phase_min_deg": 30}, 1.5315),
    ],
)
def test_several_bounds_together_are_searched_to_their_corners(plants, dead_times, asked, found_by_brute_force):
    assert tune_pi(plants, dead_times, **asked).ki >= found_by_brute_force


@pytest.mark.parametrize("ms_max", [1.015, 1.001])
def test_a_stable_plant_meets_every_ms_above_1(ms_max):
    assert tune_pi(1 / (S + 1), 1.0, ms_max=ms_max).worst.ms == pytest.approx(ms_max, rel=1e-9)


def test_least_ms_keeps_ms_max_too():
    with pytest.raises(InfeasibleDesignError, match=r"least worst Ms is 1\.366"):
        tune_pi(FAMILY, DEAD_TIMES, minimise_ms=True, ki_min=0.1, ms_max=1.2)


def test_the_best_that_can_be_had_is_of_what_was_asked():
    with pytest.raises(InfeasibleDesignError, match=r"largest phase margin 12\.\d+ deg"):
        tune_pi(twelve_points()[4], 0.15, phase_min_deg=20)
    with pytest.raises(InfeasibleDesignError, match=r"least worst Ms 1\.27\d"):
        tune_pi(FAMILY, DEAD_TIMES, ms_max=1.1)
    # under P control the crossover may tend to 0, where the phase leaves 1/0.5 s less the dead time
    with pytest.raises(InfeasibleDesignError, match=r"least worst Ms 1\.107, largest delay margin 1\.899 s; each"):
        tune_pi(1 / (S - 0.5), 0.1, ms_max=1.6, delay_min_s=1.5)


@pytest.mark.parametrize(
    ("plant", "asked"), [(1 / S, {"ms_max": 2.0}), (1 / (S + 1), {"ms_max": 2.0}), (1 / S, {"phase_min_deg": 60})]
)
def test_unbounded_gains_are_said_to_be_so(plant, asked):
    with pytest.raises(InfeasibleDesignError, match="no largest value"):
        tune_pi(plant, **asked)


# -- free of scale, and nothing better by brute force ---------------------------------------------------------


def rescaled(plant, gain, time):
    """gain P(time s)."""
    return Rational(plant.zeros / time, plant.poles / time, gain * plant.gain * time ** -float(plant.relative_degree))


@pytest.mark.parametrize(("gain", "time"), [(300.0, 1.0), (1e12, 1e-6), (1e-12, 1e6)])
@pytest.mark.parametrize(
    ("poles", "dead_time", "asked"),
    [
        ([0.0], 1.0, {"ms_max": 2.5}),
        ([0.3, -2.0], 0.1, {"ms_max": 3.0, "phase_min_deg": 25.0}),
        ([-1.0], 1.0, {"delay_min_s": 0.05}),
        ([-1.0, -0.1 + 0.5j, -0.1 - 0.5j], 0.3, {"ms_max": 2.0}),
        ([-1.0], 1.0, {"minimise_ms": True, "ki_min": 0.2}),
    ],
    ids=["integrator", "unstable", "delay", "resonant", "least Ms"],
)
def test_tuning_is_free_of_scale(poles, dead_time, asked, gain, time):
    plant = Rational(np.array([]), np.array(poles), 1.0)
    unit = {"delay_min_s": time, "ki_min": 1 / (gain * time)}
    here = tune_pi(plant, dead_time, **asked)
    there = tune_pi(
        rescaled(plant, gain, time), dead_time * time, **{k: v * unit[k] if k in unit else v for k, v in asked.items()}
    )
    # where the optimum is flat, kp is known to the square root of what ki is
    assert there.ki * gain * time == pytest.approx(here.ki, rel=1e-6)
    assert there.kp * gain == pytest.approx(here.kp, rel=1e-4)
    assert there.worst.ms == pytest.approx(here.worst.ms, rel=1e-6)


def test_tuning_is_continuous_as_the_dead_time_vanishes():
    three_lags, lag = Rational([], [-1.0, -5.0, -20.0], 100.0), Rational([], [-1.0], 1.0)
    without = tune_pi(three_lags, ms_max=1.8).ki
    for dead_time in (1e-6, 1e-12):  # 13 per s of dead time, of the size of the lags
        assert tune_pi(three_lags, dead_time, ms_max=1.8).ki == pytest.approx(without, rel=30 * dead_time + 1e-9)
    # a lag far slower than the dead time is an integrator, whose time is the dead time's alone
    integrator = tune_pi(Rational([], [0.0], 1.0), 1.0, ms_max=2.0).ki
    for dead_time in (1e-6, 1e-10):
        assert tune_pi(lag, dead_time, ms_max=2.0).ki * dead_time**2 == pytest.approx(integrator, rel=10 * dead_time)


def test_a_plant_that_needs_integral_action_is_tuned():
    island = Rational(np.array([-0.4]), np.array([-0.2 + 2.9j, -0.2 - 2.9j, 0.3]), 1.0)
    # no ki below 3 stabilises it; the island ends in a tip, which ever finer grids of gains come up to: 5.08, 5.0801
    assert tune_pi(island, 0.1, ms_max=10.0).ki == pytest.approx(5.0801932, rel=1e-7)


def brute_force(plants, dead_times, ms_max, kp, ki):
    """The largest ki of a grid with Ms <= ms_max at 1500 frequencies and a stable loop; 0 if there is none."""
    omega = np.geomspace(1e-3, 1e3, 1500)
    kps, kis = (grid.ravel() for grid in np.meshgrid(kp, ki))
    least = np.full(kps.size, np.inf)
    for plant, dead_time in zip(plants, dead_times, strict=True):
        response = plant(1j * omega) * np.exp(-1j * omega * dead_time)
        loop = (kps[:, None] - 1j * kis[:, None] / omega) * response
        least = np.minimum(least, np.abs(1 + loop).min(axis=1))
    for i in np.argsort(-kis):
        if least[i] >= 1 / ms_max:
            controller = pi_transfer_function(kps[i], kis[i])
            if all(DeadTimeLoop(controller * g, tau).is_stable() for g, tau in zip(plants, dead_times, strict=True)):
                return kis[i]
    return 0.0


@pytest.mark.parametrize("seed", range(5))
def test_brute_force_finds_nothing_better(seed):
    rng = np.random.default_rng(seed)
    pole, rest = rng.uniform(-1, 0.5), -(10 ** rng.uniform(-0.5, 1, int(rng.integers(0, 3))))
    plants = [Rational([], [pole * x, *(rest * x)], abs(np.prod(rest)) * x) for x in rng.uniform(0.7, 1.5, 2)]
    dead_times, ms_max = rng.uniform(0.05, 0.4, 2), 1.5 + 10 ** rng.uniform(-1, 0.5)
    gain, time = 10 ** rng.uniform(-12, 12), 10 ** rng.uniform(-6, 6)
    found = brute_force(plants, dead_times, ms_max, np.linspace(-1, 15, 33), np.geomspace(1e-3, 30, 36))
    try:
        design = tune_pi([rescaled(g, gain, time) for g in plants], (dead_times * time).tolist(), ms_max=ms_max)
    except InfeasibleDesignError:
        assert found == 0.0
    else:
        assert design.ki * gain * time >= found
        assert design.worst.ms == pytest.approx(ms_max, rel=1e-9)
