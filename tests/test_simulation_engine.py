"""Braking runs: closed forms, an independent integration in the paper's units, the linearised loop, runs that fail;
controllers over the same runs, and the stop no controller can beat."""

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lfilter

from railslip_ctrl import Actuator, DeadTimeLoop, InputError, published_law, wheel_slip_loop
from railslip_ctrl import simulation as sim
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.controllers.torque_profile import TorqueProfile
from railslip_ctrl.design.catalogue import published_controller
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.adhesion.curve import Curve, curve_force
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.vehicle import PARK2008, Rail, Resistance, Vehicle
from railslip_ctrl.report.simulation import run_comparison_text
from railslip_ctrl.simulation import kernel as layout
from railslip_ctrl.simulation.bound import attainable_stop, clairvoyant_stop, compare_runs

REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)
NO_ADHESION = Curve(alpha=1e-20, beta=0.0475, gamma=41.5, v0=100 / 3.6, reference=REFERENCE)  # a force below 1e-16 N
PUBLISHED_PI = published_controller("pi")

# Rounding of some 1e5 additions to numbers near the starting energy, and the error of Runge-Kutta in it at 1 ms.
BALANCE = 1e-10


def pi(kp: float, ki: float = 0.0, slip: float = 0.132) -> PI:
    return PI(kp=kp, ki=ki, reference=ReferenceSlip(dry=slip, wet=slip), anti_windup=False)


def constant_torque(torque: float, **fields: object) -> TorqueProfile:
    return TorqueProfile(times=(0.0,), torques=(torque,), **fields)


def bare_vehicle(*, dead_time: float = 0.0, lag: float = 0.0, viscous: float = 0.0, **fields: object) -> Vehicle:
    """The published wheel and mass without travelling resistance, with an actuator of choice."""
    wheel = PARK2008.wheel.model_copy(update={"viscous_friction": viscous})
    actuator = Actuator(dead_time=dead_time, lag=lag)
    return PARK2008.model_copy(update={"wheel": wheel, "resistance": Resistance(), "actuator": actuator, **fields})


def scenario(vehicle: Vehicle, **fields: object) -> sim.Scenario:
    """From 30 m/s, without adhesion unless one is given, and without limits on the command."""
    given = {"adhesion": NO_ADHESION, "initial_speed": 30.0, "limits": sim.BrakeLimits(torque_min=-1e9), **fields}
    return sim.Scenario(name="test", vehicle=vehicle, **given)


def paper_curve(wet: bool) -> CubicHermiteSpline:
    """F(lambda), N, from the paper's differential equation along a slip ramp of 10.548 km/h/s, speeds in km/h."""
    v0, ramp = 100.0, 2.93 * 3.6
    alpha = (5.455e4 - 3.641e2 * v0 + 3.798e-1 * v0**2) / 3.6  # N/m read as N per (km/h s)
    beta = (1.873e-2 - 6.059e-5 * v0 + 5.500e-8 * v0**2) * (2 if wet else 1)
    gamma = 2.345e2 - 8.620e-1 * v0 + 1.053e-4 * v0**2

    def slope(sigma: float, force: np.ndarray) -> np.ndarray:
        return alpha * (1 - beta / (gamma - sigma) * force) * sigma / ramp

    nodes = np.linspace(0.0, v0, 8001)
    found = solve_ivp(slope, (0.0, v0), [0.0], method="DOP853", rtol=1e-13, atol=1e-9, t_eval=nodes)
    return CubicHermiteSpline(nodes / v0, found.y[0], slope(nodes, found.y[0]) * v0)


def paper_run(random_force: np.ndarray) -> np.ndarray:
    """The published PI bristle run in km/h, N and s with no factor 3.6 in (3) and (4); rows (v, sigma, Tb, x) each ms.

    Written from [Park2008] alone: classical Runge-Kutta, PI in its units, sampled each ms; x in m.
    """
    M, J, B0, r, h = 3517.0, 60.35, 0.25, 0.43, 1e-3
    coefficients = {wet: (c.c.T.tolist(), 1 / 8000) for wet, c in ((w, paper_curve(w)) for w in (False, True))}

    def curve(slip: float, wet: bool) -> float:
        pieces, width = coefficients[wet]
        i = int(abs(slip) / width)
        c3, c2, c1, c0 = pieces[i]
        u = abs(slip) - i * width
        return math.copysign(((c3 * u + c2) * u + c1) * u + c0, slip)

    def rates(t: float, v: float, w: float, Tb: float, Tc: float, Fn: float, wet: bool, M: float) -> tuple[float, ...]:
        Fa = curve((v - r * w) / v, wet)
        Td = 0.05 * Tb * math.exp(-4 * t) * math.sin(10 * math.pi * t)
        v_rate = (-Fa - 0.63 * (v / 3.6) ** 2 - Fn) / M
        w_rate = (-(B0 - 0.01 * t) * w + r * Fa - Tb - Td + r * Fn) / J
        return v_rate, w_rate, (Tc - Tb) / 0.6, v / 3.6

    v, w, Tb, x, integral, commands, rows = 100.0, 100.0 / r, 0.0, 0.0, 0.0, [], []
    for n in range(random_force.size):
        t, wet = n * h, n >= 25000
        if n == 25000:
            M = 5276.0
        rows.append((v, v - r * w, Tb, x))
        error = (0.092 if wet else 0.132) * v - (v - r * w)
        integral += 27.0 * h * error
        commands.append(max(650.0 * error + integral, 0.0))
        Tc = commands[n - 150] if n >= 150 else 0.0
        y, Fn = (v, w, Tb, x), float(random_force[n])
        k1 = rates(t, *y[:3], Tc, Fn, wet, M)
        k2 = rates(t + h / 2, *(a + h / 2 * b for a, b in zip(y[:3], k1[:3], strict=True)), Tc, Fn, wet, M)
        k3 = rates(t + h / 2, *(a + h / 2 * b for a, b in zip(y[:3], k2[:3], strict=True)), Tc, Fn, wet, M)
        k4 = rates(t + h, *(a + h * b for a, b in zip(y[:3], k3[:3], strict=True)), Tc, Fn, wet, M)
        v, w, Tb, x = (a + h / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(y, k1, k2, k3, k4, strict=True))
    return np.array(rows)


def test_the_as_published_run_is_the_mixed_unit_one() -> None:
    """Inertia scale 3.6 in SI is speeds in km/h with forces in N: the same run to 1e-9, noise and switch included."""
    run = sim.simulate(sim.built_in_scenario("park2008"), PUBLISHED_PI, seed=4)
    assert run.stopped
    s = run.signals
    rows = paper_run(s.random_force[:-1])
    for ours, theirs in zip((3.6 * s.speed, 3.6 * s.slip_velocity, s.torque, s.distance), rows.T, strict=True):
        np.testing.assert_allclose(ours[:-1], theirs, rtol=0, atol=1e-9 * np.max(np.abs(theirs)))


def test_the_wheel_locks_when_the_torque_has_taken_its_momentum() -> None:
    """Without adhesion J omega' = -T after the dead time; slip is then 1, and its mean tells the lock to rounding."""
    torque, dead_time, end = 4000.0, 0.0837, 2.0
    base = scenario(bare_vehicle(dead_time=dead_time), longest_time=end)
    controller = constant_torque(torque, reference=REFERENCE.model_copy(update={"dry": 1e-9}), period=0.01)
    run = sim.simulate(base, controller, seed=None)
    lock = dead_time + PARK2008.wheel.inertia * (30.0 / PARK2008.wheel.radius) / torque
    assert np.array_equal(run.signals.locked, run.signals.time > lock)
    mean_slip = (0.5 * (lock - dead_time) + end - lock) / end
    # the reference of 1e-9 is missed on the other side for the first 1e-9 of the ramp
    assert run.mean_abs_slip_error == pytest.approx(mean_slip - 1e-9, abs=1e-9)
    assert run.first_lock == pytest.approx(dead_time + 0.98 * (lock - dead_time), abs=1.01e-3)  # steps of 1 ms
    assert run.energies.works["brake"] == pytest.approx(0.5 * 60.35 * (30.0 / 0.43) ** 2, rel=1e-12)


def test_the_wheel_is_released_when_adhesion_overcomes_the_torque() -> None:
    """Locked, v falls at F(1)/M; the torque dumps exponentially; omega' > 0 from T = r F(1) on."""
    dump, torque, off, dead_time, end = 0.2, 8000.0, 4.0, 0.15, 6.0
    law = published_law("curve", Rail.DRY)
    limits = sim.BrakeLimits(torque_min=0.0, dump_lag=dump)
    base = scenario(bare_vehicle(dead_time=dead_time, lag=0.3), adhesion=law, limits=limits, longest_time=end)
    controller = TorqueProfile(times=(0.0, off - 1e-6, off), torques=(torque, torque, 0.0), period=0.01)
    run = sim.simulate(base, controller, seed=None)
    s = run.signals
    r, J, M = PARK2008.wheel.radius, PARK2008.wheel.inertia, PARK2008.mass
    sliding = float(curve_force(1.0, *law.parameters()))
    release = off + dead_time + dump * math.log(torque / (r * sliding))  # filled up to torque: exp(-12) is missing
    locked = s.time[s.locked == 1.0]
    assert locked[-1] == pytest.approx(release, abs=1e-3)
    during = (s.time >= locked[0]) & (s.time <= locked[-1])
    v = s.speed[during]
    np.testing.assert_allclose(v, v[0] - sliding / M * (s.time[during] - s.time[during][0]), rtol=1e-12)
    assert np.all(s.wheel_speed[during] == 0.0)

    def motion(t: float, y: np.ndarray) -> list[float]:
        force = float(curve_force((y[0] - r * y[1]) / y[0], *law.parameters()))
        left = acting * math.exp(-(t - locked[-1]) / dump)
        return [-force / M, (r * force - left) / J if t > begin else 0.0]

    acting = float(s.torque[s.time == locked[-1]][0])
    begin = locked[-1] + dump * math.log(acting / (r * sliding))
    assert begin == pytest.approx(release, abs=1e-5)
    at = v[-1] - sliding / M * (begin - locked[-1])
    found = solve_ivp(motion, (begin, end), [at, 0.0], method="DOP853", rtol=1e-12, atol=1e-12)
    assert run.final_speed == pytest.approx(found.y[0, -1], rel=1e-9)
    assert s.wheel_speed[-1] == pytest.approx(found.y[1, -1], rel=1e-9)
    assert abs(run.energies.error) < 1e-12


HEAVY = 1e15  # kg: the speed stays what it is, as the linearisation with frozen speed has it


def small_perturbation(gain: float, extra: float, end: float) -> tuple[DeadTimeLoop, np.ndarray, np.ndarray]:
    """The dry bristle loop at 100 km/h, slip 0.132, kp 190, ki 5: the loop, times and the slip velocity's deviation.

    The command before the start is the torque that acts at it, as at an operating point.
    """
    law, dead_time = published_law("bristle", Rail.DRY), PARK2008.actuator.dead_time + extra
    vehicle = bare_vehicle(dead_time=dead_time, lag=PARK2008.actuator.lag, viscous=0.25, mass=HEAVY, mass_loaded=HEAVY)
    point = operating_point(law, vehicle, 100 / 3.6, 0.132)
    controller = pi(190.0 * gain, 5.0 * gain)
    loop = wheel_slip_loop(linearize(point), controller.system, Actuator(dead_time=dead_time, lag=0.6))
    base = scenario(vehicle, adhesion=law, initial_speed=100 / 3.6, longest_time=end, step=1e-4)
    torque, z = point.brake_torque, point.adhesion_state or 0.0
    start = {layout.V: point.speed, layout.SIGMA: point.sigma + 1e-5, layout.Z: z, layout.TORQUE: torque}
    simulator, every = sim.Simulator(base, controller), 10
    held = controller.model_copy(update={"initial_torque": torque})
    memory = np.array(controller.flat(held.start(point.speed, simulator.period)))
    plan, kernel = simulator.plan, simulator._kernel
    y, summary = np.zeros(layout.STATES), np.empty(layout.SUMMARY)
    y[list(start)] = list(start.values())
    log = np.empty((plan.samples // every + 2, layout.COLUMNS + len(memory)))
    _, written = kernel.run(
        kernel.Settings(**plan.settings), kernel.Events(*plan.events), np.zeros(1), np.zeros((0, 2)), plan.p.copy(),
        plan.c.copy(), plan.chosen.copy(), plan.tables, plan.limits, y, memory, log, every, summary,
    )  # fmt: skip
    return loop, log[:written, layout.TIME], log[:written, layout.SIGMA] - point.sigma


@pytest.mark.parametrize("factor", [0.99, 1.01])
@pytest.mark.parametrize("what", ["gain", "delay"])
def test_both_sides_of_a_margin(what: str, factor: float) -> None:
    margins = small_perturbation(1.0, 0.0, 0.1)[0].margins()  # [Park2008]'s loop, frozen speed, without 1/M
    changed = (factor * margins.gain_increase, 0.0, 40.0) if what == "gain" else (1.0, factor * margins.delay_s, 120.0)
    loop, t, deviation = small_perturbation(*changed)
    window = t[-1] / 4  # over a period of the slowest oscillation, 8 s
    early = np.max(np.abs(deviation[(t > window) & (t < 2 * window)]))
    late = np.max(np.abs(deviation[t > 3 * window]))
    assert loop.is_stable() == (factor < 1)
    assert (late < early) == loop.is_stable()
    assert late < 1e-2  # small still, so that the linearisation is what is compared


PATCH = (sim.Event(distance=100.0, adhesion_factor=0.3), sim.Event(distance=130.0, adhesion_factor=1.0))
LOADED = sim.Event(distance=300.0, mass=5276.0, rail=Rail.WET)
LIMITS = sim.BrakeLimits(rate=4000.0, dump_lag=0.2, torque_max=9000.0)
BALANCED = {
    "events by distance": (sim.published_scenario().with_changes(events=(*PATCH, LOADED), limits=LIMITS), PUBLISHED_PI),
    "SI, the wheel locks": (sim.built_in_scenario("park2008-si"), constant_torque(9000.0)),
    "dynamic law": (sim.published_scenario(as_published=False, adhesion="bristle"), pi(190.0, 5.0)),
}


@pytest.mark.parametrize("case", BALANCED)
def test_the_energy_balance_closes(case: str) -> None:
    """1e-6 of the starting energy is asked."""
    run = sim.simulate(*BALANCED[case], seed=3, record_every=None)
    assert run.outcome is sim.Outcome.STOPPED
    assert abs(run.energies.error) < BALANCE
    assert run.locked_fraction > 0.5 if "locks" in case else run.locked_fraction < 0.1
    assert (run.energies.booked > 1e4) == (case != "SI, the wheel locks")  # which stops before 25 s


@pytest.mark.parametrize(("dead_time", "period", "step"), [
    (0.0, 0.01, 1e-3), (0.15, 0.05, 1e-3), (0.1537, 0.01, 1e-3), (0.0031, 0.01, 1e-3), (0.15, 0.007, 2.3e-3),
])  # fmt: skip
def test_dead_time_is_exact(dead_time: float, period: float, step: float) -> None:
    vehicle = bare_vehicle(dead_time=dead_time, lag=0.6)
    profile = TorqueProfile(times=(0.0, 0.8, 1.3, 2.0), torques=(500.0, 3000.0, -800.0, 400.0), period=period)
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
    profile = TorqueProfile(times=(0.0, end - 1e-6, end), torques=(torque, torque, 0.0), period=0.01)
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
    first, again = (sim.simulate(sim.built_in_scenario("park2008"), PUBLISHED_PI, seed=5) for _ in range(2))
    assert numbers(first) == numbers(again)
    assert all(np.array_equal(a, b) for a, b in zip(first.signals, again.signals, strict=True))
    for seed, same in ((6, False), (5, True), (np.random.SeedSequence(5), True)):
        other = sim.simulate(sim.built_in_scenario("park2008"), PUBLISHED_PI, seed=seed, record_every=None)
        assert (numbers(other) == numbers(first)) is same
        with pytest.raises(InputError, match="record_every"):
            other.plot()


@pytest.mark.parametrize("law", ["curve", "bristle"])
def test_interpreted_runs_equal_compiled_ones(law: str) -> None:
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
    assert np.isfinite(run.signals._replace(reference=np.zeros(2))).all()  # what was last; it holds no slip


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
    si = sim.built_in_scenario("park2008-si")
    slow = sim.simulate(si, pi(190.0, 5.0))
    assert not slow.reached
    assert f"slip {slow.max_slip:.3g}; never at the reference 0.132; no lock" in str(slow)
    assert sim.simulate(si, pi(190.0, 5.0, slip=0.2 * slow.max_slip)).reached
    assert sim.simulate(si, constant_torque(100.0)).reached


# --- controllers over the same runs, and the bound ------------------------------------------------------------------

SI = sim.published_scenario(as_published=False)


def test_what_the_script_says(ran) -> None:
    """[Park2008] Table 5, best column: 581 m, 50.7 s, 0.0272; ours knows the reference slip, not the adhesion curve.

    published.md: with the dry curve kept after 25 s the wheel locks; in SI the stop ends before 25 s.
    """
    comparison, out, pictures = ran("designs/compare_runs.py", seeds=range(3))
    published, si = comparison.runs
    row = published.row("PI-lead")
    assert (row.braking_distance.value < 550, row.braking_time.value < 48, row.slip_error.value < 0.02) == (True,) * 3
    assert published.row("ASMC bristle").lock_time.value == 0 < 1 < published.row("ASMC, rail unknown").lock_time.value
    assert si.row("ASMC, rail unknown").braking_distance == si.row("ASMC bristle").braking_distance
    for runs in comparison.runs:
        for row in runs.rows:  # nobody beats the clairvoyant
            assert row.braking_distance.value > runs.bound.braking_distance
            assert row.braking_time.value > runs.bound.braking_time
        assert {runs.row(name).lock_time.value for name in ("PI-lead", "PI-lead scheduled")} == {0}
        assert runs.row("slide protection").lock_time.value < 0.3  # at the end, below 8 km/h
    lead, scheduled = (one for one in comparison.margins[0] if one.name.startswith("PI-lead"))
    assert (lead.unstable_points, scheduled.unstable_points, lead.gain_increase > 2) == (0, 0, True)
    assert lead.ms < 2.01  # what it was tuned for, 2, and the rounding of its gains
    assert "PI bristle 24/24" in " ".join(out.split())  # unstable, in SI
    assert ("…" in out, len(pictures)) == (False, 1)


def test_the_bound_against_a_closed_form() -> None:
    """Without actuator, resistance and viscous friction the clairvoyant brakes with mu_max N/M."""
    scenario = SI.with_changes(vehicle=bare_vehicle(), events=())
    bound = clairvoyant_stop(scenario)
    deceleration = 0.299 * 34_500 / 3517  # published peak of the curve, three digits
    v0, v1 = 100 / 3.6, 5 / 3.6
    assert bound.braking_time == pytest.approx((v0 - v1) / deceleration, rel=2e-3)  # its third digit
    assert bound.braking_distance == pytest.approx((v0**2 - v1**2) / (2 * deceleration), rel=2e-3)
    # a mass doubled after 3 s halves the deceleration, also after an event that leaves it
    events = (sim.Event(time=3.0, mass=2 * 3517.0), sim.Event(time=6.0, rail=Rail.DRY))
    late = clairvoyant_stop(scenario.with_changes(events=events))
    assert late.braking_time == pytest.approx(3.0 + 2 * ((v0 - v1) / deceleration - 3.0), rel=2e-3)
    with pytest.raises(InputError, match="some change the adhesion at a time, others at a distance"):
        clairvoyant_stop(scenario.with_changes(events=(*events, sim.Event(distance=100.0, adhesion_factor=0.5))))


def test_without_a_brake_the_resistance_alone_stops() -> None:
    """M v' = -(Fr0 + Fr1 v + Fr2 v^2) by quadrature over the speed."""
    vehicle = bare_vehicle(dead_time=1000.0, resistance=Resistance(constant=2000.0, linear=100.0, quadratic=10.0))
    bound = clairvoyant_stop(SI.with_changes(vehicle=vehicle, events=()))
    for found, power in ((bound.braking_time, 0), (bound.braking_distance, 1)):
        over_speed = quad(lambda v, n=power: 3517 * v**n / (2000 + 100 * v + 10 * v * v), 5 / 3.6, 100 / 3.6)[0]
        assert found == pytest.approx(over_speed, rel=1e-6)  # of the integration


@pytest.mark.parametrize(("lag", "rate"), [(0.0, math.inf), (3.0, math.inf), (1e-9, 500.0)])
def test_a_weak_brake_stops_by_its_torque_behind_dead_time_and_lag_or_rate(lag: float, rate: float) -> None:
    """M (v0 - v) = Tmax/r (s - late), s after the dead time, below the adhesion all the time; of a lag
    late = lag (1 - exp(-s/lag)), of a rate Tmax/(2 rate)."""
    limits = sim.BrakeLimits(torque_max=1000.0, **({"rate": rate} if math.isfinite(rate) else {}))
    scenario = SI.with_changes(vehicle=bare_vehicle(dead_time=0.5, lag=lag), events=(), limits=limits)
    since = clairvoyant_stop(scenario).braking_time - 0.5
    late = 1000.0 / (2 * rate) + (lag * (1.0 - math.exp(-since / lag)) if lag else 0.0)
    assert 1000.0 / 0.43 * (since - late) == pytest.approx(3517 * 95 / 3.6, rel=1e-6)  # of the integration


@pytest.mark.parametrize("law", ["curve", "bristle"])
def test_what_is_attainable_tends_to_that_without_lag(law: str) -> None:
    found = []
    for lag in (0.0, 1e-3):
        scenario = sim.stop(bare_vehicle(dead_time=0.15, lag=lag), "dry", adhesion=law)
        found.append(attainable_stop(scenario.with_changes(limits=sim.BrakeLimits(torque_max=9000.0))).braking_distance)
    assert found[0] == pytest.approx(found[1], rel=3e-3)  # of the lag, and of the search


def test_runs_that_do_not_stop_are_told_not_averaged() -> None:
    scenario = sim.built_in_scenario("park2008").with_changes(longest_time=20.0, disturbances=sim.Disturbances())
    found = compare_runs(scenario, {"PI": PUBLISHED_PI}, range(2))
    assert (found.rows[0].stopped, math.isnan(found.rows[0].braking_distance.value)) == (0, True)
    assert "PI: 2 of 2 runs did not stop." in run_comparison_text(found)
    assert math.isinf(found.bound.braking_distance)


def coasting(**changes: object) -> sim.Run:
    """A run without torque and without noise: only the sensors are looked at."""
    scenario = sim.stop(PARK2008, speed_kmh=40).with_changes(longest_time=20.0, **changes)
    return sim.simulate(scenario, constant_torque(0.0, period=0.01), seed=None)


def test_an_encoder_gives_the_mean_of_the_time_between_teeth():
    uphill = coasting(gradient=0.02, measurement=sim.Measurement(encoder_teeth=100))
    signals = uphill.signals
    wheel = np.interp(signals.time - 0.5 * signals.time[1], signals.time, signals.wheel_speed)
    read, tooth = signals.measured_wheel_speed[2:-1], 2 * np.pi / 100  # the last row is no sample
    deceleration = 0.02 * 9.80665 / PARK2008.wheel.radius
    late = tooth / signals.wheel_speed[2:-1]  # a tooth's time, by which the last may have passed
    assert np.all(read > wheel[2:-1] - 1e-6)  # slower than it was, a half of the time between the teeth ago
    assert np.all(read - wheel[2:-1] < 1.1 * deceleration * late + 1e-3)
    few = coasting(gradient=0.02, measurement=sim.Measurement(encoder_teeth=4))  # not one a sample
    assert np.abs(few.signals.measured_wheel_speed - few.signals.wheel_speed).max() < 4 * deceleration * np.pi / 2 / 5


def test_a_scale_of_the_train_s_speed_is_what_the_controller_sees():
    run = coasting(measurement=sim.Measurement(speed_scale=0.98))
    np.testing.assert_allclose(run.signals.measured_speed[:-1], 0.98 * run.signals.speed[:-1], rtol=1e-12)


def test_a_gradient_is_weight_along_the_track():
    """Without brake and resistance the train gains g times the gradient; an inertia scale does not weigh more."""
    car = PARK2008.model_copy(update={"resistance": Resistance(), "wheel": PARK2008.wheel.model_copy(
        update={"viscous_friction": 0.0, "inertia": 1e-3})})  # fmt: skip
    for scale in (1.0, 3.6):
        one = coasting(vehicle=car.model_copy(update={"inertia_scale": scale}), gradient=-0.03)
        gained = (one.final_speed - one.scenario.initial_speed) / one.braking_time
        assert gained == pytest.approx(0.03 * 9.80665 / scale, rel=1e-4)  # of the wheel's inertia
    event = coasting(vehicle=car, gradient=-0.03, events=(sim.Event(time=0.0, mass=2 * car.mass),))
    assert (event.final_speed - 40 / 3.6) / event.braking_time == pytest.approx(0.03 * 9.80665, rel=1e-4)


def test_bounds_are_longer_downhill():
    """By the force that is lacking: between 5 % and 25 % of the adhesion on 1 in 50."""
    plain = sim.stop(PARK2008, "wet").with_changes(limits=sim.BrakeLimits(torque_max=9000.0))
    steep = plain.with_changes(gradient=-0.02)
    for of in (clairvoyant_stop, attainable_stop):
        assert 1.05 < of(steep).braking_distance / of(plain).braking_distance < 1.25
