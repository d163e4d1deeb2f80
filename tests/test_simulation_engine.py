"""The integration itself: balance, dead time, actuator, events, sensors, repeatability, and runs that fail."""

import math

import numpy as np
import pytest
from braking_runs import REFERENCE, bare_vehicle, constant_torque, pi, published_pi, scenario
from scipy.signal import lfilter

from railslip_ctrl import InputError, published_law
from railslip_ctrl import simulation as sim
from railslip_ctrl.model.vehicle import PARK2008, Rail, Resistance

# Rounding of some 1e5 additions to numbers near the starting energy, and the error of Runge-Kutta in it at 1 ms.
BALANCE = 1e-10


PATCH = (sim.Event(distance=100.0, adhesion_factor=0.3), sim.Event(distance=130.0, adhesion_factor=1.0))
LOADED = sim.Event(distance=300.0, mass=5276.0, rail=Rail.WET)
LIMITS = sim.BrakeLimits(rate=4000.0, dump_lag=0.2, torque_max=9000.0)
BALANCED = {
    "events by distance": (
        sim.published_scenario().with_changes(events=(*PATCH, LOADED), limits=LIMITS),
        published_pi(),
    ),
    "SI, the wheel locks": (sim.built_in_scenario("park2008-si"), constant_torque(9000.0)),
    "dynamic law": (sim.published_scenario(as_published=False, adhesion="bristle"), pi(190.0, 5.0)),
}


@pytest.mark.long
@pytest.mark.parametrize("case", BALANCED)
def test_the_energy_balance_closes(case: str) -> None:
    """1e-6 of the starting energy is asked."""
    run = sim.simulate(*BALANCED[case], seed=3, record_every=None)
    assert run.outcome is sim.Outcome.STOPPED
    assert abs(run.energies.error) < BALANCE
    assert run.locked_fraction > 0.5 if "locks" in case else run.locked_fraction < 0.1
    assert (run.energies.booked > 1e4) == (case != "SI, the wheel locks")  # which stops before 25 s


@pytest.mark.parametrize(
    ("dead_time", "period", "step"),
    [(0.0, 0.01, 1e-3), (0.15, 0.05, 1e-3), (0.1537, 0.01, 1e-3), (0.0031, 0.01, 1e-3), (0.15, 0.007, 2.3e-3)],
)
def test_dead_time_is_exact(dead_time: float, period: float, step: float) -> None:
    """Also where it is a multiple of neither the period nor the step; the torque moves all the time."""
    vehicle = bare_vehicle(dead_time=dead_time, lag=0.6)
    profile = sim.TorqueProfile((0.0, 0.8, 1.3, 2.0), (500.0, 3000.0, -800.0, 400.0), REFERENCE, period=period)
    run = sim.simulate(scenario(vehicle, longest_time=3.0, step=step), profile, seed=None)
    time, command = run.signals.time[:-1], run.signals.command[:-1]  # the last row is the end, not a sample
    # the lag's answer to a command held from sample to sample, by superposition of its steps
    since = np.maximum(time[:, None] - time[None, :] - dead_time, 0.0)
    expected = np.sum(-np.diff(command, prepend=0.0) * np.expm1(-since / 0.6), axis=1)
    # Runge-Kutta's own error over the run, (h/T)^4/120 of the torque: 2e-12 at the largest step
    np.testing.assert_allclose(run.signals.torque[:-1], expected, rtol=0, atol=3000.0 * (step / 0.6) ** 4 / 50 + 1e-9)


def test_fill_dump_and_rate_limit() -> None:
    """Filling by the vehicle's lag, emptying by another, both no faster than the limit."""
    fill, dump, rate, torque, end = 0.6, 0.25, 9000.0, 8000.0, 3.0
    limits = sim.BrakeLimits(torque_min=0.0, dump_lag=dump, rate=rate)
    vehicle = bare_vehicle(lag=fill, mass=1e6, mass_loaded=1e6)
    profile = sim.TorqueProfile((0.0, end - 1e-6, end), (torque, torque, 0.0), REFERENCE, period=0.01)
    run = sim.simulate(scenario(vehicle, longest_time=5.0, limits=limits), profile, seed=None)
    t, acting = run.signals.time, run.signals.torque
    linear_up = torque / rate - fill  # then the lag is slower than the limit
    up = np.where(t < linear_up, rate * t, torque - rate * fill * np.exp(-(t - linear_up) / fill))
    start = torque - rate * fill * math.exp(-(end - linear_up) / fill)
    linear_down = (start - rate * dump) / rate
    s = t - end
    down = np.where(s < linear_down, start - rate * s, rate * dump * np.exp(-(s - linear_down) / dump))
    # where the limit ends T'' jumps by rate/T inside one step: an error of at most h^2/8 of that, 0.005 N*m
    np.testing.assert_allclose(acting, np.where(t <= end, up, down), rtol=0, atol=1e-6 / 8 * rate / dump)
    assert run.max_torque_rate == pytest.approx(rate, rel=1e-12)
    assert run.max_torque == pytest.approx(start, abs=1e-2)


def test_events_and_the_stop_are_located_to_rounding() -> None:
    """A constant resistance decelerates the free train, in parabolas; samples of 0.1 s."""
    force, first, second = 3000.0, 3517.0, 5276.0

    def freely(**fields: object) -> sim.Run:
        base = scenario(bare_vehicle(resistance=Resistance(constant=force)), step=0.1, **fields)
        return sim.simulate(base, constant_torque(0.0, period=0.1), seed=None, record_every=None)

    run = freely(events=(sim.Event(distance=47.3, mass=second),), longest_time=5.0)
    at = math.sqrt(30.0**2 - 2 * force / first * 47.3)
    when = (30.0 - at) * first / force
    assert run.outcome is sim.Outcome.OUT_OF_TIME
    assert run.final_speed == pytest.approx(at - force / second * (5.0 - when), rel=1e-13)
    assert run.energies.booked == pytest.approx(0.5 * (second - first) * at**2, rel=1e-12)
    run = freely(events=(sim.Event(time=1.23456, mass=second),), longest_time=3.0)
    expected = 30.0 - force / first * 1.23456 - force / second * (3.0 - 1.23456)
    assert run.final_speed == pytest.approx(expected, rel=1e-13)
    run = freely(final_speed=19.0)
    assert run.stopped
    assert run.braking_time == pytest.approx((30.0 - 19.0) * first / force, rel=1e-13)
    assert run.braking_distance == pytest.approx((30.0**2 - 19.0**2) * first / (2 * force), rel=1e-13)


@pytest.mark.parametrize("scale", [1.0, 3.6])
def test_the_viscous_coefficient_over_time(scale: float) -> None:
    """B = max(12 - 3 t, 3) brakes the free wheel: omega = omega0 exp(-integral(B)/J), whatever the inertia scale."""
    vehicle = bare_vehicle(viscous=12.0, inertia_scale=scale)
    base = scenario(vehicle, viscous_rate=-3.0, viscous_least=3.0, longest_time=5.0)
    run = sim.simulate(base, constant_torque(0.0), seed=None)
    t = run.signals.time
    integral = np.where(t < 3.0, 12.0 * t - 1.5 * t**2, 22.5 + 3.0 * (t - 3.0))
    expected = 30.0 / 0.43 * np.exp(-integral / 60.35)
    # 1e-3 s times 0.2/s, to the fourth power, is below rounding; sigma = v - r omega gives omega to 1e-13 of v
    np.testing.assert_allclose(run.signals.wheel_speed, expected, rtol=1e-11)
    assert abs(run.energies.error) < BALANCE


def test_measurement_noise_and_random_force_have_their_statistics() -> None:
    vehicle = bare_vehicle(mass=1e9, mass_loaded=1e9)
    given = {"measurement": sim.Measurement(speed_noise=0.05, wheel_noise=0.2), "longest_time": 60.0}
    forces = sim.Disturbances(random_force=431.0, random_hold=0.02)
    s = sim.simulate(scenario(vehicle, disturbances=forces, **given), constant_torque(0.0), seed=11).signals
    speed_error, wheel_error = s.measured_speed[:-1] - s.speed[:-1], s.measured_wheel_speed[:-1] - s.wheel_speed[:-1]
    held = s.random_force[:-1].reshape(-1, 20)
    assert np.all(held == held[:, :1])  # 20 samples of 1 ms each
    for values, spread in ((speed_error, 0.05), (wheel_error, 0.2), (held[:, 0], 431.0)):
        # four standard errors of a mean and of a standard deviation; the seed is fixed
        assert abs(np.mean(values)) < 4 * spread / math.sqrt(values.size)
        assert np.std(values) == pytest.approx(spread, rel=4 / math.sqrt(2 * values.size))
    for one, other in ((speed_error, wheel_error), (held[1:, 0], held[:-1, 0])):
        assert abs(np.corrcoef(one, other)[0, 1]) < 4 / math.sqrt(one.size)
    alone = scenario(vehicle, measurement=sim.Measurement(speed_noise=0.05), longest_time=0.5)
    s = sim.simulate(alone, constant_torque(0.0), seed=1).signals
    assert np.std(s.measured_speed[:-1] - s.speed[:-1]) == pytest.approx(0.05, rel=0.2)  # 500 samples: 3 %
    assert np.array_equal(s.measured_wheel_speed[:-1], s.wheel_speed[:-1])


def test_quantised_and_filtered_measurements() -> None:
    vehicle = bare_vehicle(resistance=Resistance(constant=3000.0))
    sensors = (sim.Measurement(speed_quantum=0.1, wheel_quantum=0.25), sim.Measurement(filter_time=0.05))
    bases = [scenario(vehicle, measurement=one, longest_time=4.0) for one in sensors]
    grid, filtered = (sim.simulate(base, constant_torque(500.0), seed=None).signals for base in bases)
    for name, quantum in (("speed", 0.1), ("wheel_speed", 0.25)):
        measured, true = getattr(grid, f"measured_{name}")[:-1], getattr(grid, name)[:-1]
        assert np.max(np.abs(measured / quantum - np.round(measured / quantum))) < 1e-9
        assert np.max(np.abs(measured - true)) <= quantum / 2 * (1 + 1e-9)
        assert np.unique(measured).size > 10
    blend = -math.expm1(-1e-3 / 0.05)
    expected, _ = lfilter([blend], [1.0, blend - 1.0], filtered.speed[:-1], zi=[(1.0 - blend) * 30.0])
    np.testing.assert_allclose(filtered.measured_speed[:-1], expected, rtol=1e-12)


def numbers(run: sim.Run) -> tuple[float, ...]:
    return (run.braking_time, run.braking_distance, run.brake_energy, run.mean_abs_slip_error, run.rms_torque_rate)


def test_runs_repeat_with_their_seed() -> None:
    first, again = (sim.simulate(sim.built_in_scenario("park2008"), published_pi(), seed=5) for _ in range(2))
    assert numbers(first) == numbers(again)
    assert all(np.array_equal(a, b) for a, b in zip(first.signals, again.signals, strict=True))
    for seed, same in ((6, False), (5, True), (np.random.SeedSequence(5), True)):
        other = sim.simulate(sim.built_in_scenario("park2008"), published_pi(), seed=seed, record_every=None)
        assert (numbers(other) == numbers(first)) is same
        with pytest.raises(InputError, match="record_every"):
            other.plot()


@pytest.mark.parametrize("law", ["curve", "bristle"])
def test_interpreted_runs_equal_compiled_ones(law: str) -> None:
    """The same text, with all that a run can have, the locking of the wheel included."""
    base = sim.published_scenario(as_published=False, adhesion=law).with_changes(
        longest_time=2.5,
        events=(sim.Event(distance=11.0, adhesion_factor=0.4), sim.Event(time=1.2, mass=5276.0)),
        measurement=sim.Measurement(speed_noise=0.02, wheel_noise=0.05, wheel_quantum=0.01, filter_time=0.01),
        limits=sim.BrakeLimits(rate=2e4, dump_lag=0.3),
    )
    runs = [sim.simulate(base, pi(2000.0, 200.0, slip=0.95), seed=2, compiled=compiled) for compiled in (True, False)]
    compiled, interpreted = (run.signals for run in runs)
    assert np.max(compiled.locked) == 1.0
    for name, one, other in zip(compiled._fields, compiled, interpreted, strict=True):
        # exp and sin may differ by a rounding, which slip beyond the peak makes grow by e^(2 s * 3/s)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * (1 + np.max(np.abs(one))), err_msg=name)
    assert numbers(runs[0]) == pytest.approx(numbers(runs[1]), rel=1e-9)


def test_a_torque_that_is_no_number_or_overflows_ends_the_run() -> None:
    base = scenario(bare_vehicle(), longest_time=2.0, limits=sim.BrakeLimits(torque_min=-1e308))
    run = sim.simulate(base, pi(1e308), seed=None)  # times 0.132 v, 4 m/s
    assert (run.outcome, run.stopped, run.braking_time) == (sim.Outcome.NOT_FINITE, False, 0.0)
    run = sim.simulate(base, constant_torque(-1e308), seed=None)  # times 1/J and r: the wheel's speed overflows
    assert run.outcome is sim.Outcome.NOT_FINITE
    assert 0.0 < run.braking_time < 1.0
    assert np.isfinite(run.signals).all()  # what was last


@pytest.mark.long
@pytest.mark.parametrize(("torque", "step"), [(6000.0, 1e-3), (9000.0, 5e-3), (30000.0, 5e-3)])
def test_the_bristle_law_is_left_where_it_ends(torque: float, step: float) -> None:
    """[Park2008] (30)-(32) at 140 km/h hold to a slip velocity gamma: slip 0.828 at the start's speed."""
    law = published_law("bristle", Rail.DRY, initial_speed_kmh=140.0)
    base = sim.published_scenario(as_published=False).with_changes(adhesion=law, initial_speed=140 / 3.6, step=step)
    run = sim.simulate(base, constant_torque(torque), seed=None)
    assert run.outcome is sim.Outcome.OUTSIDE_DOMAIN
    s = run.signals
    gamma = law.domain_limit(run.final_speed)[0] * run.final_speed
    # a thousandth before it, where the rates grow beyond bounds
    assert gamma > s.slip_velocity[-1] >= (1 - 1e-3) * gamma
    assert np.all(s.slip_velocity[:-1] < (1 - 1e-3) * gamma)
    assert run.braking_time == s.time[-1] < 10.0
    # on the way the force stays between 0 and the most the law has
    assert np.min(s.adhesion_force[s.slip_velocity > 1.0]) > 0.0  # before, resistance drags the free wheel
    assert np.max(s.adhesion_force[:-1]) < 11_300.0


@pytest.mark.parametrize("alpha", [1e18, 1e300])
def test_a_law_too_stiff_to_integrate_is_named(alpha: float) -> None:
    """More than 1e5 steps a piece are refused; counts beyond the integers, too."""
    law = published_law("bristle", Rail.DRY).model_copy(update={"alpha": alpha})
    run = sim.simulate(scenario(PARK2008, adhesion=law), pi(2340.0, 97.2))
    assert run.outcome is sim.Outcome.TOO_STIFF
    assert run.braking_time < 1.0


def test_a_run_says_that_its_slip_never_came_to_the_reference() -> None:
    """An integral too slow for the stop; the same with a slip for reference that it comes to; no reference."""
    si = sim.built_in_scenario("park2008-si")
    slow = sim.simulate(si, pi(190.0, 5.0))
    assert not slow.reached
    assert f"slip at most {slow.max_slip:.3g}, never at the reference 0.132; no lock" in str(slow)
    assert sim.simulate(si, pi(190.0, 5.0, slip=0.2 * slow.max_slip)).reached
    assert sim.simulate(si, constant_torque(100.0)).reached
