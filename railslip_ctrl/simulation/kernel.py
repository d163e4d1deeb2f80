"""Integration loop of a braking run: classical Runge-Kutta steps between the instants at which a quantity jumps.

Some instants are known in advance: samples, changes of the delayed command, new random forces, events at a time. The
others are located by bisection inside a step: lock and release of the wheel, events at a distance, the end of the stop.
The command is constant between these instants, so that the dead time is exact and the method keeps its order. In the
functions, t is the time (s), y the state, p the parameters of the plant, c the numbers of the controller, x the state
of the controller, and a the `Settings`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from railslip_ctrl.model.kernels import (
    adhesion_force,
    command,
    compiled,
    entry,
    lag_rate,
    rates,
    rates_and_powers,
    stiffness,
)

V, SIGMA, Z, TORQUE, DISTANCE = 0, 1, 2, 3, 4
WORK = 5  # first of six works, J, taken from train and wheel: brake, slip, viscous, resistance, random, disturbance
STATES = 11

STOPPED, OUT_OF_TIME, OUTSIDE_DOMAIN, NOT_FINITE, TOO_STIFF = 0, 1, 2, 3, 4

# columns of the log after the states, before the controller's own state
TIME, COMMAND, FORCE, RANDOM, DISTURBANCE, MASS, REFERENCE, LOCKED, MEASURED_V, MEASURED_OMEGA = range(STATES, 21)
COLUMNS = 21

# indices into the plant's parameters `p` (`numeric.plant_parameters`) and the controller's row `c` (`Controller.row`)
P_MASS, P_INERTIA, P_VISCOUS, P_RADIUS, P_RESISTANCE, P_LAW = 0, 1, 2, 3, 4, 8
C_REFERENCE, C_SCENARIO_REFERENCE = 0, -1
# indices into `chosen`, which selects from `tables` and `limits`: for the plant's law and for the controller's model
PLANT, MODEL = 0, 1

# indices into `measured`, which keeps the signals of the previous sample and the state of the encoder: wheel angle,
# rad; number of teeth passed; time of the last tooth, s; true wheel speed, rad/s; speed last read, rad/s
MEASURED_SPEED, MEASURED_TURNING, ANGLE, TEETH, TOOTH_TIME, TRUE_TURNING, READ = range(7)

# indices into the summary of a run
(
    END_TIME,
    SLIP_ERROR,
    SLIP_ERROR_SCENARIO,
    HIGHEST_SLIP,
    LOCKED_TIME,
    FIRST_LOCK,
    HIGHEST_TORQUE,
    TORQUE_RATE_SQUARED,
    HIGHEST_TORQUE_RATE,
    BOOKED,
    STARTING_ENERGY,
    FINAL_ENERGY,
    SUBSTEPS,
) = range(13)
SUMMARY = 13

# Largest step times fastest rate. RK4 is stable up to 2.78; at 0.5 the error per step is below 1e-4 of the fast mode.
_STIFFNESS_LIMIT = 0.5
_MOST_SUBSTEPS = 100_000  # largest number of steps between two jumps
_EDGE = 1e-3  # a run ends at this relative distance from the end of a law's domain, where the rates become infinite
_DECAYED = 50.0  # exponent beyond which the disturbance is zero: exp(-50) = 2e-22 is below the rounding of the torque
_BISECTIONS = 52  # number of bisections; resolves a step to its last bit
_SAME_INSTANT = 1e-9  # share of a sampling period or hold time; instants closer than this are treated as one


class Settings(NamedTuple):
    """Numbers of a run that do not change, SI: period and step, brake, disturbances, end of the run, and sensors."""

    period: float
    step: float
    dead_time: float
    lag_fill: float
    lag_dump: float
    rate_limit: float
    torque_gain: float
    torque_min: float
    torque_max: float
    viscous: float
    viscous_rate: float
    viscous_least: float
    disturbance_fraction: float
    disturbance_decay: float
    disturbance_frequency: float
    random_hold: float
    final_speed: float
    longest_time: float
    speed_scale: float
    encoder_teeth: float
    speed_quantum: float
    wheel_quantum: float
    filter_time: float
    locked_share: float


class Events(NamedTuple):
    """Time (s) or distance (m) of each event, and the values of `p`, `c` and `chosen` after the event, row by row.

    A value of NaN, or of -1 in `chosen`, means that the event does not change this number.
    """

    time: np.ndarray
    distance: np.ndarray
    p: np.ndarray
    c: np.ndarray
    chosen: np.ndarray


@compiled
def disturbance(t, torque, a):
    """Return the caliper's disturbance Td, N*m: a decaying oscillation in proportion to the acting torque."""
    decay = a.disturbance_decay * t
    if decay > _DECAYED:
        return 0.0
    return a.disturbance_fraction * torque * math.exp(-decay) * math.sin(a.disturbance_frequency * t)


@compiled
def lag(torque, delayed, a):
    """Return the rate of the brake torque, N*m/s, of a first-order lag with a rate limit."""
    time_constant = a.lag_fill if delayed > torque else a.lag_dump
    rate = lag_rate(torque, delayed, time_constant)
    return min(max(rate, -a.rate_limit), a.rate_limit)


@compiled
def derivative(t, y, p, table, a, locked, delayed, random_torque, rate):
    """Write the rates of states and works (energies, J) into `rate`; sigma stays equal to v while `locked`."""
    p[P_VISCOUS] = max(a.viscous + a.viscous_rate * t, a.viscous_least)
    torque = y[TORQUE]
    td = disturbance(t, torque, a)
    values = rates_and_powers(y[V], y[SIGMA], y[Z], torque, td, random_torque, p, table)
    rate[V] = values[0]
    rate[SIGMA] = values[0] if locked else values[1]
    rate[Z] = values[2]
    rate[TORQUE] = lag(torque, delayed, a) if a.lag_fill > 0.0 else 0.0
    rate[DISTANCE] = y[V]
    for i in range(STATES - WORK):
        rate[WORK + i] = values[3 + i]


@compiled
def advance(t, y, h, p, table, a, locked, delayed, random_torque, k, new):
    """Make one classical Runge-Kutta step of length h, s, from y to `new`; `k` is memory for the stages' rates."""
    derivative(t, y, p, table, a, locked, delayed, random_torque, k[0])
    for i in range(STATES):
        new[i] = y[i] + 0.5 * h * k[0, i]
    derivative(t + 0.5 * h, new, p, table, a, locked, delayed, random_torque, k[1])
    for i in range(STATES):
        new[i] = y[i] + 0.5 * h * k[1, i]
    derivative(t + 0.5 * h, new, p, table, a, locked, delayed, random_torque, k[2])
    for i in range(STATES):
        new[i] = y[i] + h * k[2, i]
    derivative(t + h, new, p, table, a, locked, delayed, random_torque, k[3])
    for i in range(STATES):
        new[i] = y[i] + h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@compiled
def releases(t, y, p, table, a, random_torque):
    """Return True if a locked wheel starts to turn again: omega' > 0 at omega = 0."""
    p[P_VISCOUS] = max(a.viscous + a.viscous_rate * t, a.viscous_least)
    td = disturbance(t, y[TORQUE], a)
    v_rate, sigma_rate, _ = rates(y[V], y[V], y[Z], y[TORQUE], td, random_torque, p, table)
    return v_rate > sigma_rate


@compiled
def crossings(t, y, p, table, a, locked, random_torque, next_distance):
    """Return the sum of the codes of all changes: 1 end of the stop, 2 lock, 4 release, 8 event at a distance."""
    crossed = 0
    if y[V] <= a.final_speed:
        crossed |= 1
    if not locked and y[SIGMA] >= y[V]:
        crossed |= 2
    if locked and releases(t, y, p, table, a, random_torque):
        crossed |= 4
    if y[DISTANCE] >= next_distance:
        crossed |= 8
    return crossed


@compiled
def fastest(y, random_torque, p, table, a):
    """Return the spectral radius of the dynamics of sigma and z, 1/s, or 1/lag of the brake if this is larger."""
    a11, a12, a21, a22 = stiffness(y[V], y[SIGMA], y[Z], y[TORQUE], 0.0, random_torque, p, table)
    half_trace, determinant = 0.5 * (a11 + a22), a11 * a22 - a12 * a21
    discriminant = half_trace * half_trace - determinant
    radius = abs(half_trace) + math.sqrt(discriminant) if discriminant >= 0.0 else math.sqrt(determinant)
    if a.lag_fill > 0.0:
        radius = max(radius, 1.0 / min(a.lag_fill, a.lag_dump))
    return radius


@compiled
def energy(y, p):
    """Return the kinetic energy of train and wheel, J."""
    omega = (y[V] - y[SIGMA]) / p[P_RADIUS]
    return 0.5 * p[P_MASS] * y[V] * y[V] + 0.5 * p[P_INERTIA] * omega * omega


@compiled
def quantized(value, quantum):
    """Round a value to multiples of a sensor's resolution `quantum`; 0 means no rounding."""
    return value if quantum <= 0.0 else quantum * math.floor(value / quantum + 0.5)


@compiled
def domain_limit(v, limits):
    """Return the largest slip velocity, m/s, in the domain of the adhesion law at train speed v, m/s."""
    intervals = limits.size - 2
    position = min(max(v / limits[0] * intervals, 0.0), float(intervals))
    i = min(int(position), intervals - 1)
    return limits[1 + i] + (position - i) * (limits[2 + i] - limits[1 + i])


@compiled
def fire(i, y, p, c, chosen, events):
    """Apply event i to `p`, `c` and `chosen`; return the change of kinetic energy, J."""
    before = energy(y, p)
    for j in range(p.size):
        if not math.isnan(events.p[i, j]):
            p[j] = events.p[i, j]
    for j in range(c.size):
        if not math.isnan(events.c[i, j]):
            c[j] = events.c[i, j]
    for j in range(chosen.size):
        if events.chosen[i, j] >= 0:
            chosen[j] = events.chosen[i, j]
    return energy(y, p) - before


@compiled
def account(y, new, h, k, reference, scenario_reference, a, t, summary):
    """Add a step of length h, s, from state y to state `new` to the summary of the run."""
    slip, slip_after = y[SIGMA] / y[V], new[SIGMA] / new[V]
    summary[SLIP_ERROR] += 0.5 * h * (abs(slip - reference) + abs(slip_after - reference))
    summary[SLIP_ERROR_SCENARIO] += 0.5 * h * (abs(slip - scenario_reference) + abs(slip_after - scenario_reference))
    summary[HIGHEST_SLIP] = max(summary[HIGHEST_SLIP], slip_after)
    locked, locked_after = slip > 1.0 - a.locked_share, slip_after > 1.0 - a.locked_share
    summary[LOCKED_TIME] += 0.5 * h * ((1.0 if locked else 0.0) + (1.0 if locked_after else 0.0))
    if locked_after and math.isnan(summary[FIRST_LOCK]):
        summary[FIRST_LOCK] = t + h
    summary[HIGHEST_TORQUE] = max(summary[HIGHEST_TORQUE], new[TORQUE])
    rate = (new[TORQUE] - y[TORQUE]) / h if h > 0.0 else 0.0
    summary[TORQUE_RATE_SQUARED] += h * rate * rate
    summary[HIGHEST_TORQUE_RATE] = max(summary[HIGHEST_TORQUE_RATE], abs(k[0, TORQUE]))
    summary[SUBSTEPS] += 1.0


@compiled
def write_row(row, t, y, p, table, x, locked, last_command, random_torque, c, measured, a):
    """Write one row of the log: states, energies (works, J), the columns `TIME` to `MEASURED_OMEGA`, and then `x`."""
    td = disturbance(t, y[TORQUE], a)
    for i in range(STATES):
        row[i] = y[i]
    row[TIME], row[COMMAND], row[RANDOM], row[DISTURBANCE] = t, last_command, random_torque / p[P_RADIUS], td
    row[FORCE] = adhesion_force(y[V], y[SIGMA], y[Z], y[TORQUE], td, random_torque, p, table)
    row[MASS], row[REFERENCE], row[LOCKED] = p[P_MASS], c[C_REFERENCE], 1.0 if locked else 0.0
    row[MEASURED_V], row[MEASURED_OMEGA] = measured[MEASURED_SPEED], measured[MEASURED_TURNING]
    for i in range(x.size):
        row[COLUMNS + i] = x[i]


@compiled
def crossing_share(t, y, h, p, table, a, locked, delayed, random_torque, next_distance, k, new):
    """Return the share of the step h after which `crossings` is nonzero; write the state at this instant to `new`."""
    low, high = 0.0, 1.0
    for halving in range(_BISECTIONS + 1):
        share = 0.5 * (low + high) if halving < _BISECTIONS else high
        advance(t, y, share * h, p, table, a, locked, delayed, random_torque, k, new)
        if crossings(t + share * h, new, p, table, a, locked, random_torque, next_distance):
            high = share
        else:
            low = share
    return high


@compiled
def next_instant(t, sample_end, switch, a, events, fired, tiny):
    """Return the first instant, s, after t at which a quantity jumps, or the end of the sample if it is earlier."""
    until = sample_end
    if t < switch - tiny:
        until = min(until, switch)
    if a.random_hold > 0.0:
        following = (math.floor(t / a.random_hold + _SAME_INSTANT) + 1.0) * a.random_hold
        if following < until - tiny:
            until = following
    for i in range(fired.size):
        if not fired[i]:
            until = min(until, events.time[i])
    return until


@compiled
def fire_due(latest, distance, y, p, c, chosen, events, fired, summary):
    """Apply the events up to time `latest`, s, or `distance`, m; add the change of kinetic energy to the summary."""
    for i in range(fired.size):
        if not fired[i] and (events.time[i] <= latest or events.distance[i] <= distance):
            fired[i] = True
            summary[BOOKED] += fire(i, y, p, c, chosen, events)


@compiled
def whole_periods(a):
    """Return the number of whole sampling periods in the dead time, and the rest of the dead time, s."""
    delay = math.floor(a.dead_time / a.period + 1e-9)
    rest = a.dead_time - delay * a.period
    return delay, (rest if rest >= 1e-9 * a.period else 0.0)


@compiled
def random_torque_at(t, forces, p, a):
    """Return the torque of the random force at the wheel, N*m; `forces` are the random forces, N, in order of time."""
    return p[P_RADIUS] * forces[int(t / a.random_hold + 1e-9)] if a.random_hold > 0.0 else 0.0


@compiled
def encoder(sample, turning, a, measured):
    """Return the wheel speed, rad/s, as measured by the encoder of `Measurement`; `turning` is the true wheel speed."""
    if sample == 0:
        measured[TRUE_TURNING], measured[READ] = turning, turning
        return turning
    tooth = 2.0 * math.pi / a.encoder_teeth
    measured[ANGLE] += 0.5 * a.period * (measured[TRUE_TURNING] + turning)
    measured[TRUE_TURNING] = turning
    now, passed_by = sample * a.period, math.floor(measured[ANGLE] / tooth)
    # the time of the last tooth is computed as if the wheel had turned at its present speed since then
    if passed_by > measured[TEETH]:
        since = (measured[ANGLE] - passed_by * tooth) / turning if turning > 0.0 else 0.0
        last = now - min(since, a.period)
        measured[READ] = tooth * (passed_by - measured[TEETH]) / (last - measured[TOOTH_TIME])
        measured[TEETH], measured[TOOTH_TIME] = passed_by, last
    else:
        measured[READ] = min(measured[READ], tooth / (now - measured[TOOTH_TIME]))
    return measured[READ]


@compiled
def measure(sample, y, p, a, noise, measured):
    """Update the measured train speed and wheel speed in `measured`, with noise, rounding and filter."""
    speed, turning = a.speed_scale * y[V], (y[V] - y[SIGMA]) / p[P_RADIUS]
    if a.encoder_teeth > 0.0:
        turning = encoder(sample, turning, a, measured)
    if noise.shape[0] > 0:
        speed += noise[sample, 0]
        turning += noise[sample, 1]
    blend = 1.0 - math.exp(-a.period / a.filter_time) if a.filter_time > 0.0 else 1.0
    measured[MEASURED_SPEED] += blend * (quantized(speed, a.speed_quantum) - measured[MEASURED_SPEED])
    measured[MEASURED_TURNING] += blend * (quantized(turning, a.wheel_quantum) - measured[MEASURED_TURNING])


@entry
def run(a, events, forces, noise, p, c, chosen, tables, limits, y, x, log, every, summary):
    """Integrate a run; return the index of its outcome and the number of rows that are written to `log`.

    The arrays p, c, chosen, y, x, log and summary are changed. Before the first sample the command equals the initial
    torque. `every` is the number of samples between two rows of the log; 0: no rows.
    """
    k, new = np.empty((4, STATES)), np.empty(STATES)
    fired = np.zeros(events.time.size, dtype=np.bool_)
    delay, rest = whole_periods(a)
    history = np.full(delay + 2, y[TORQUE])
    measured = np.zeros(READ + 1)
    measured[MEASURED_SPEED], measured[MEASURED_TURNING] = a.speed_scale * y[V], (y[V] - y[SIGMA]) / p[P_RADIUS]
    tiny = 1e-9 * a.period
    summary[:] = 0.0
    summary[FIRST_LOCK], summary[STARTING_ENERGY] = math.nan, energy(y, p)
    # False at first; the constant False would make Numba compile the loop twice, for a constant and for a variable
    locked = math.isfinite(summary[FIRST_LOCK])
    rows, t, torque, status = 0, 0.0, y[TORQUE], OUT_OF_TIME
    for sample in range(math.ceil(a.longest_time / a.period - 1e-9)):
        t = sample * a.period
        # an event at the instant of a sample takes effect before the sample
        fire_due(t + tiny, -math.inf, y, p, c, chosen, events, fired, summary)
        measure(sample, y, p, a, noise, measured)
        wanted = command(x, t, measured[MEASURED_SPEED], measured[MEASURED_TURNING], torque, c, tables[chosen[MODEL]])
        torque = min(max(wanted, a.torque_min), a.torque_max)
        if not (math.isfinite(wanted) and math.isfinite(y[V]) and math.isfinite(y[SIGMA]) and math.isfinite(y[Z])):
            status = NOT_FINITE
            break
        history[sample % history.size] = torque
        if a.lag_fill <= 0.0:  # without a lag the torque follows the delayed command at once; log the new value
            first = sample - delay - (1 if rest > 0.0 else 0)
            y[TORQUE] = a.torque_gain * history[first % history.size] if first >= 0 else 0.0
        if every > 0 and sample % every == 0:
            random_torque = random_torque_at(t, forces, p, a)
            write_row(log[rows], t, y, p, tables[chosen[PLANT]], x, locked, torque, random_torque, c, measured, a)
            rows += 1
        status, t, locked = interval(
            sample, delay, rest, tiny, t, locked, a, events, fired, forces, history, p, c, chosen, tables, limits, y,
            k, new, summary,
        )  # fmt: skip
        if status != OUT_OF_TIME:
            break
    summary[END_TIME], summary[FINAL_ENERGY] = t, energy(y, p)
    if every > 0 and rows < log.shape[0]:
        random_torque = random_torque_at(t, forces, p, a)
        write_row(log[rows], t, y, p, tables[chosen[PLANT]], x, locked, torque, random_torque, c, measured, a)
        rows += 1
    return status, rows


@compiled
def interval(
    sample, delay, rest, tiny, t, locked, a, events, fired, forces, history, p, c, chosen, tables, limits, y, k, new,
    summary,
):  # fmt: skip
    """Integrate from one sample to the next; return status (OUT_OF_TIME: the run continues), time, s, and `locked`."""
    sample_end, switch = min((sample + 1) * a.period, a.longest_time), sample * a.period + rest
    standing = 0
    while t < sample_end - tiny:
        fire_due(t + tiny, -math.inf, y, p, c, chosen, events, fired, summary)
        until = next_instant(t, sample_end, switch, a, events, fired, tiny)
        known = sample - delay - (1 if t < switch - tiny else 0)
        delayed = a.torque_gain * history[known % history.size]
        if a.lag_fill <= 0.0:
            y[TORQUE] = delayed
        next_distance = math.inf
        for i in range(fired.size):
            if not fired[i]:
                next_distance = min(next_distance, events.distance[i])
        status, t_new, crossed, locked = piece(
            t, until, locked, a, delayed, random_torque_at(t, forces, p, a), next_distance, p, c, tables[chosen[PLANT]],
            limits[chosen[PLANT]], y, k, new, summary,
        )  # fmt: skip
        if status != OUT_OF_TIME:
            return status, t_new, locked
        standing = standing + 1 if t_new - t < tiny else 0
        if standing > 1000:  # lock and release repeat at one instant, so that time does not advance
            return TOO_STIFF, t_new, locked
        t = t_new
        if crossed & 8:
            fire_due(-math.inf, y[DISTANCE], y, p, c, chosen, events, fired, summary)
    return OUT_OF_TIME, sample_end, locked


@compiled
def piece(t, until, locked, a, delayed, random_torque, next_distance, p, c, table, limits, y, k, new, summary):
    """Integrate to time `until`, s, or to the first of `crossings`; return status, time, s, crossings and `locked`."""
    now = t
    while True:
        needed = (until - now) * max(fastest(y, random_torque, p, table, a) / _STIFFNESS_LIMIT, 1.0 / a.step)
        if not needed <= _MOST_SUBSTEPS:  # true for NaN too
            return TOO_STIFF, now, 0, locked
        count = max(math.ceil(needed - 1e-6), 1)
        h = (until - now) / count
        advance(now, y, h, p, table, a, locked, delayed, random_torque, k, new)
        crossed = crossings(now + h, new, p, table, a, locked, random_torque, next_distance)
        if crossed:
            h *= crossing_share(now, y, h, p, table, a, locked, delayed, random_torque, next_distance, k, new)
            crossed = crossings(now + h, new, p, table, a, locked, random_torque, next_distance)
        if not (math.isfinite(new[V]) and math.isfinite(new[SIGMA]) and math.isfinite(new[Z])):
            return NOT_FINITE, now + h, 0, locked  # y keeps the last finite state
        account(y, new, h, k, c[C_REFERENCE], c[C_SCENARIO_REFERENCE], a, now, summary)
        for i in range(STATES):
            y[i] = new[i]
        now += h
        if abs(y[SIGMA]) >= (1.0 - _EDGE) * domain_limit(y[V], limits):
            return OUTSIDE_DOMAIN, now, 0, locked
        if crossed:
            if crossed & 2:
                locked = True
                y[SIGMA] = y[V]
            elif crossed & 4:
                locked = False
            return STOPPED if crossed & 1 else OUT_OF_TIME, now, crossed, locked
        if count == 1:
            return OUT_OF_TIME, until, 0, locked
