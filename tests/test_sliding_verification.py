"""The sliding laws behind the actuator: limit cycles, what is left of the gains, the conditions."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from railslip_ctrl import PARK2008, Actuator, Rail
from railslip_ctrl.core.errors import DomainError, UnstableLoopError
from railslip_ctrl.report.verification import evidence, findings_text
from railslip_ctrl.sliding.law import NOT_HOLDING, PUBLISHED_LAW
from railslip_ctrl.verification import actuator_effects as effects
from railslip_ctrl.verification import limit_cycles as cycles
from railslip_ctrl.verification.actuator_effects import published_loop, without_actuator
from railslip_ctrl.verification.fixed_step import PublishedLaw, simulate_fine, whole_periods
from railslip_ctrl.verification.joint_verification import FullVerification, verify_with_actuator
from railslip_ctrl.verification.limit_cycles import linear_limit_cycle, nonlinear_limit_cycle, predict_limit_cycle
from railslip_ctrl.verification.relay_loop import SlidingGains
from railslip_ctrl.verification.verdict import Verification

ACTUATOR = PARK2008.actuator
READINGS = [(rail, scale) for scale in (1.0, 3.6) for rail in Rail]


@cache
def effect_on(rail):
    return effects.actuator_effect(published_loop(rail))


# --- limit cycles: describing function, linearised, nonlinear, simulated -------------------------------------------


CYCLES = [
    *((Rail.DRY, 3.6, 400.0), (Rail.WET, 1.0, 30.0)),
    *(pytest.param(*case, marks=pytest.mark.long) for case in ((Rail.WET, 3.6, 70.0), (Rail.DRY, 1.0, 90.0))),
]
AMPLITUDES = ("surface_amplitude", "sigma_amplitude", "torque_amplitude")


@pytest.mark.parametrize(("rail", "scale", "K"), CYCLES)
def test_limit_cycle_against_the_nonlinear_wheel(rail, scale, K):
    loop = published_loop(rail, inertia_scale=scale)
    actual = nonlinear_limit_cycle(loop, K=K)
    linear, predicted = (make(loop, K=K, load=loop.load) for make in (linear_limit_cycle, predict_limit_cycle))
    measured = _simulated(loop, K, actual.sigma_amplitude)
    # of the same wheel: what is left is 2 ms of the switches and, at K = 30, 2 % of a transient that dies out slowly
    assert actual.period == pytest.approx(measured["period"], rel=0.005)
    for name in (*AMPLITUDES, "surface_mean"):
        assert getattr(actual, name) == pytest.approx(measured[name], rel=0.03), name
    # the linearised cycles are within 10 % wherever their own criterion says so
    assert predicted.period == pytest.approx(measured["period"], rel=0.05)
    if cycles.linearisation_change(loop, linear) <= cycles.LINEAR_CHANGE:
        for name in AMPLITUDES:
            assert getattr(linear, name) == pytest.approx(measured[name], rel=0.1), name
            if 2 * loop.load < K:  # the describing function: where the relay does more than carry the load
                assert getattr(predicted, name) == pytest.approx(measured[name], rel=0.1), name


def _simulated(loop, K, amplitude):
    """Period, mean of s and amplitudes in the fine nonlinear simulation, 30 s after 50 s for the transient."""
    law = PublishedLaw(loop.plant.point, replace(loop.gains, K=K, k=0.0))
    run = simulate_fine(loop.plant.point, law, ACTUATOR, duration=80.0, step=2e-3, offset=0.5 * amplitude)
    period, whole = whole_periods(run.after(50.0))
    swings = {f"{name}_amplitude": np.ptp(getattr(whole, name)) / 2 for name in ("surface", "sigma", "torque")}
    return {"period": period, "surface_mean": whole.surface.mean(), **swings}


# range of the slip and period from an own simulator in C, steps of 0.5 ms, of the same law on the same wheel
@pytest.mark.long
@pytest.mark.parametrize(("rail", "low", "high", "period"), [
    (Rail.DRY, -0.016, 0.286, 3.60), (Rail.WET, -0.009, 0.198, 3.23),
])  # fmt: skip
def test_a_high_relay_releases_the_wheel_once_a_period_and_does_not_lose_it(rail, low, high, period):
    loop = published_loop(rail).with_gains(K=400.0)
    assert nonlinear_limit_cycle(loop) is None  # it leaves 0 to v
    cycle, speed = cycles.simulated_limit_cycle(loop), loop.plant.point.speed
    # the extremes of that simulator are over its whole run, and 2 ms of a switch move the slip by 0.001
    assert np.array(cycle.sigma_range) / speed == pytest.approx([low, high], abs=0.004)
    assert cycle.period == pytest.approx(period, rel=0.01)
    effect = effects.actuator_effect(loop)
    assert not effect.holds_the_wheel
    assert effect.own_cycle.actual == cycle


def test_a_wheel_that_locks_is_lost():
    loop = published_loop(Rail.DRY, inertia_scale=0.05).with_gains(K=5000.0)  # a light wheel under a heavy relay
    assert cycles.simulated_limit_cycle(loop) is None
    with pytest.raises(DomainError, match=r"the wheel is lost at .* outside \+-"):
        _simulated(loop, 5000.0, 1.0)
    effect = effect_on(Rail.WET)
    lost = replace(effect, cycles=tuple(replace(cycle, actual=None) for cycle in effect.cycles))
    assert (lost.holds_the_wheel, math.isnan(lost.cycles[0].period_error)) == (False, True)


def test_integrator_with_dead_time_has_the_textbook_cycle():
    # s' = (r/J) u(t - tau): period 4 tau, amplitude (r/J) K tau
    base = published_loop(Rail.DRY, adhesion="curve")
    wheel = PARK2008.wheel.model_copy(update={"viscous_friction": 0.0})
    point = replace(base.plant.point, vehicle=PARK2008.model_copy(update={"wheel": wheel}))
    plant = replace(base.plant, point=point, A=np.zeros((1, 1)))
    loop = replace(base, plant=plant, gains=SlidingGains(K=70.0, D=0.0, rho=0.0))
    loop = replace(loop, actuator=Actuator(dead_time=0.15, lag=0.0))
    cycle = linear_limit_cycle(loop)
    assert cycle.period == pytest.approx(0.6, rel=1e-6)
    assert cycle.surface_amplitude == pytest.approx(plant.gain * 70 * 0.15, rel=2e-3)  # the series of a triangle
    # the describing function's own closed form: W = b exp(-j w tau)/(j w) is real at w = pi/(2 tau)
    assert predict_limit_cycle(loop).surface_amplitude == pytest.approx(4 / math.pi * plant.gain * 70 * 0.3 / math.pi)


@pytest.mark.parametrize("rail", Rail)
def test_response_of_the_loop_solves_the_equations_of_the_law(rail):
    # wheel, model, law and actuator as separate linear equations, solved together at each frequency
    loop = published_loop(rail)
    point, A = loop.plant.point, loop.plant.A
    vehicle, law = point.vehicle, point.law
    M, J, r, B = vehicle.effective_mass, vehicle.effective_inertia, vehicle.wheel.radius, 0.25
    for omega in (0.3, 1.5, 6.0, 40.0):
        s = 1j * omega
        model = law.alpha * A[1, 0] / (s - A[1, 1])
        # unknowns: sigma, z, q, command; the relay's output is 1
        surface = -(1 + loop.gains.rho / s)
        command = J / r * ((1 / M + r**2 / J) * model + B / J - loop.gains.rho) + loop.gains.D * surface
        ga = np.exp(-ACTUATOR.dead_time * s) / (ACTUATOR.lag * s + 1)
        matrix = np.array(
            [[s - A[0, 0], -A[0, 1], -r / J, 0], [-A[1, 0], s - A[1, 1], 0, 0], [0, 0, 1, -ga], [-command, 0, 0, 1]]
        )
        sigma, _, torque, _ = np.linalg.solve(matrix, [0, 0, 0, 1])
        assert loop.slip_response(omega) == pytest.approx(sigma, rel=1e-9)
        assert loop.surface_response(omega) == pytest.approx(-surface * sigma, rel=1e-9)
        assert loop.torque_response(omega) == pytest.approx(torque, rel=1e-9)


@pytest.mark.parametrize(("dead_time", "lag", "degree"), [(0.0, 0.0, 1), (0.0, 0.6, 2), (0.15, 0.0, 1), (0.15, 0.6, 2)])
def test_sliding_exists_only_with_an_ideal_actuator(dead_time, lag, degree):
    loop = replace(published_loop(Rail.DRY), actuator=Actuator(dead_time=dead_time, lag=lag))
    existence, omega = loop.sliding_existence(), 1e6
    assert (existence.exists, existence.relative_degree) == (dead_time == lag == 0, degree)
    size = abs(complex(loop.surface_response(omega))) * omega**degree
    assert size == pytest.approx(existence.high_frequency_gain, rel=1e-4)


def test_published_adaptation_is_unstable_with_the_actuator_and_stable_without():
    loop = published_loop(Rail.DRY)
    k = loop.gains.k
    assert without_actuator(loop).is_stable(adaptation=k)
    for relay_gain in np.linspace(0.0, 20.0, 11):
        assert loop.linear_loop(relay_gain=relay_gain, adaptation=k).unstable_closed_loop_poles == 2
    assert effects.survivable_excursion(loop) == 0.0
    # on the static curve, as published, it is unstable where the relay is small beside s
    curve = published_loop(Rail.DRY, inertia_scale=3.6, adhesion="curve")
    assert not curve.is_stable(adaptation=k)
    assert without_actuator(curve).is_stable(adaptation=k)
    gain = 4 * 70 / (math.pi * effects.survivable_excursion(curve))
    assert [curve.is_stable(relay_gain=f * gain, adaptation=k) for f in (0.999, 1.001)] == [False, True]


@pytest.mark.parametrize(("rail", "scale"), READINGS)
def test_largest_gains_are_confirmed_by_the_exact_root_count(rail, scale):
    loop = published_loop(rail, inertia_scale=scale)
    found, first = effects.survivors(loop), cycles.critical_gains(loop)[0]
    assert (found.stable, first.stable_below) == (True, True)
    assert loop.linear_loop(relay_gain=first.gain * (1 - 1e-6)).unstable_closed_loop_poles == 0
    assert loop.linear_loop(relay_gain=first.gain * (1 + 1e-6)).unstable_closed_loop_poles == 2
    assert cycles.smallest_layer(loop) == pytest.approx(loop.gains.K / first.gain, rel=1e-12)
    assert loop.is_stable(adaptation=found.k * (1 - 1e-6))
    assert loop.linear_loop(adaptation=found.k * (1 + 1e-6)).unstable_closed_loop_poles == 2
    # independently: at the limit a pole is on the axis
    assert abs(loop.linear_loop(adaptation=found.k).closed_loop_poles(2)[0].real) < 1e-6
    for name, value in (("rho", found.rho), ("D", found.D)):
        assert [loop.with_gains(**{name: value * (1 + x)}).is_stable() for x in (-1e-6, 1e-6)] == [True, False]
    assert linear_limit_cycle(loop, K=found.K).slip_amplitude == pytest.approx(0.02, rel=1e-6)
    assert found.relay_gain == pytest.approx(first.gain, rel=1e-9)


def test_cycles_that_do_not_exist():
    loop, heavy = published_loop(Rail.WET), published_loop(Rail.DRY, inertia_scale=3.6)
    law = PublishedLaw(loop.plant.point, loop.gains)
    run = simulate_fine(loop.plant.point, law, ACTUATOR, duration=2.0, step=5e-3)
    for make, error, match in (
        (lambda: predict_limit_cycle(loop, K=10.0, load=19.4), DomainError, "does not carry the load"),
        (lambda: predict_limit_cycle(without_actuator(loop)), DomainError, "no stable limit cycle"),
        (lambda: cycles.smallest_layer(loop.with_gains(rho=10.0)), DomainError, "unstable at every relay gain"),
        # the load takes 99 % of K
        (lambda: linear_limit_cycle(heavy, K=19.6, load=heavy.load), DomainError, "two switches a period"),
        (lambda: whole_periods(run), DomainError, "simulate longer"),
        (lambda: effects.first_limit(lambda value: False, 1.0), UnstableLoopError, "where the search starts"),
    ):
        with pytest.raises(error, match=match):
            make()
    assert cycles.smallest_layer(without_actuator(loop)) == 0.0


# --- the conditions -------------------------------------------------------------------------------------------------

SLIDING, _, WHOLE, ADAPTIVE = ACTUATOR_CONDITIONS = [
    *("sliding exists behind the actuator", "the relay's own cycle spares the wheel"),
    *("the law behind the actuator spares the wheel", "the adaptive loop is stable behind the actuator"),
]
BEHIND = ["the layer is stable behind the actuator", "the relay slides behind the actuator"]


@pytest.fixture(scope="module")
def published():
    """Conditions by name and conclusion of the published law; those without actuator: test_verification."""
    conditions, findings = effects.published_behind_actuator(PUBLISHED_LAW.K, PUBLISHED_LAW.D, PARK2008)
    return {one.name: one for one in conditions}, findings


def test_published_law_fails_behind_its_actuator_in_si(published):
    conditions, findings = published
    # the relay's cycle alone takes the slip to 0.233 on dry rail, less than twice the reference; the law does not stop
    assert [conditions[name].holds for name in ACTUATOR_CONDITIONS] == [False, True, False, False]
    assert {name for name in NOT_HOLDING if "actuator" in name} == {SLIDING, WHOLE, ADAPTIVE}
    assert [conditions[name].claimed for name in ACTUATOR_CONDITIONS] == [True, False, True, True]
    assert "100 km/h frozen: slip -0.0" in evidence(conditions[WHOLE])
    assert "2 unstable poles (ideal actuator: 0)" in evidence(conditions[ADAPTIVE])
    dry, wet = findings.effects
    assert dry.cycles[0].linear.period == pytest.approx(4.12, abs=5.1e-3)
    assert (dry.cycles[0].linear_holds, wet.cycles[0].linear_holds) == (False, True)
    told = findings_text(findings)
    for left in (dry.survivors, wet.survivors):
        assert f"K <= {left.K:.1f} N*m" in told
        assert f"{left.layer:.3f} m/s at K = 70 N*m; rho <= {left.rho:.3g} 1/s; D <= {left.D:.4g}" in told
    assert "verify --law predictive" in told
    # how near the as-published adaptation is to unstable, by the exact root count on either side
    assert set(findings.as_published) == {f"{law} {rail}" for law in ("bristle", "curve") for rail in Rail}
    for name, ratio in findings.as_published.items():
        loop = published_loop(Rail(name.split()[1]), inertia_scale=3.6, adhesion=name.split()[0])
        assert f"{name} {ratio:.2f}" in told
        assert loop.is_stable(adaptation=0.99 * ratio * 2.1e-8)
        assert not loop.is_stable(adaptation=1.01 * ratio * 2.1e-8)


@pytest.mark.long
@pytest.mark.parametrize(("scale", "K", "D", "holds"), [
    (1.0, 70.0, 30.0, [False, False, False, False]),  # dry is unstable, wet is not
    (1.0, 0.0, PUBLISHED_LAW.D, [False, True, False, False]),  # no relay, no cycle
    (3.6, PUBLISHED_LAW.K, PUBLISHED_LAW.D, [False, True, True, True]),  # spared, but no sliding
])  # fmt: skip
def test_other_gains_and_the_other_reading_are_decided(scale, K, D, holds, monkeypatch):
    monkeypatch.setattr("railslip_ctrl.verification.actuator_effects.COMPARED_RELAYS", ())  # for the table alone
    vehicle = PARK2008.model_copy(update={"inertia_scale": scale})
    conditions, findings = effects.published_behind_actuator(K, D, vehicle)
    assert [(one.name, one.holds) for one in conditions] == list(zip(ACTUATOR_CONDITIONS, holds, strict=True))
    told = findings_text(findings)
    assert ("no layer and no k makes it stable" in told) == (D > 21.2)  # what dry rail bears
    assert ("does not carry the 19.4 N*m" in told) == (K == 0.0)


def test_the_command_prints_what_fails_of_the_published_law(railslip, monkeypatch, published):
    conditions, findings = published
    full = FullVerification(Verification("paper", 1.0, 70.0, 5.5, 2008, tuple(conditions.values())), findings)
    monkeypatch.setattr("railslip_ctrl.cli.verify.verify_with_actuator", lambda **_: full)
    status, out, _ = railslip("verify")
    assert (status, " ".join(findings_text(findings).split()) in " ".join(out.split())) == (1, True)


@pytest.mark.long
def test_robust_variants_are_not_passed_off_as_fit_for_the_actuator(railslip, monkeypatch):
    full = verify_with_actuator(law="robust")
    failing = ["robust gain, torque limits", "robust gain, rail mistaken", *BEHIND]
    assert [one.name for one in full.verification.failing] == failing
    assert "dry: UNSTABLE, stable up to K = 3.121 N m" in evidence(full.verification[BEHIND[0]])
    monkeypatch.setattr("railslip_ctrl.cli.verify.verify_with_actuator", lambda **_: full)
    content = json.loads(railslip("verify", "--law", "robust", "--json")[1])
    assert (set(content), content["all_hold"]) == ({"conditions", "all_hold"}, False)
    (gain,) = (one for one in content["conditions"] if one["name"] == "robust gain")
    assert set(gain) == {"name", "statement", "holds", "how", "evidence", "down_to_kmh", "tolerated_errors"}
    assert (gain["down_to_kmh"], gain["tolerated_errors"]["Ta_hat"] > 0.1) == (5.0, True)
    status, out, _ = railslip("verify", "--law", "robust")
    assert (status, "Verdict: 4 of 15 conditions do not hold." in out) == (1, True)
    # a K that the layer carries behind the actuator is far below what (40) asks: no K does both
    (layer, _relay), findings = effects.variants_behind_actuator(3.0, PUBLISHED_LAW.D, PARK2008)
    assert layer.holds
    assert all(number in findings_text(findings) for number in ("3.121 N m", "4038 N m"))
