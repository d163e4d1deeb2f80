"""Random loops (zeros, poles, gain, dead time) of the kinds that once were answered wrongly, each by its seed."""

import numpy as np
from scipy.signal import butter


def decades(rng, low, high):
    return float(10 ** rng.uniform(low, high))


def pair(real, imag):
    return [complex(real, imag), complex(real, -imag)]


def wheel_slip(rng):
    values = [x * 10 ** rng.normal(0, 0.15) for x in (-0.0263, -7.81, -1.667, 0.821, -8.636, 2.256, 0.15)]
    return values[:2], [0.0, *values[2:5]], *values[5:]


def extremum_of_gain_near_one(rng):
    poles = [*pair(-rng.uniform(0.2, 0.6), rng.uniform(0.8, 2)), -rng.uniform(0.1, 1)]
    omega = np.geomspace(0.01, 10, 4000)
    size = 1 / np.abs(np.prod(1j * omega[:, None] - np.array(poles), axis=1))
    extrema = np.flatnonzero(np.diff(np.sign(np.diff(size)))) + 1
    gain = 1 / size[rng.choice(extrema) if extrema.size else 0]
    return [], poles, gain * (1 + rng.choice([-1, 1]) * decades(rng, -14, -1)), decades(rng, -1, 1)


def gain_one_at_zero(rng):
    poles = [-decades(rng, -1, 1) for _ in range(rng.integers(1, 5))]
    gain = np.prod(np.abs(poles)) * (1 + rng.choice([-1, 0, 1]) * decades(rng, -16, -6))
    return [], poles, gain * rng.choice([1, 1, -1]), rng.choice([0.0, decades(rng, -2, 1)])


def flat(rng):
    _, poles, gain = butter(rng.integers(1, 9), decades(rng, -1, 1), analog=True, output="zpk")
    upper = poles[poles.imag > 1e-9 * abs(poles)]
    poles = [*poles[abs(poles.imag) <= 1e-9 * abs(poles)].real, *upper, *upper.conj()]
    gain *= 1 + rng.choice([-1, 0, 1]) * decades(rng, -15, -3)
    return [], poles, gain, rng.choice([0.0, decades(rng, -2, 1)])


def fast_integrator(rng):
    velocity = decades(rng, 0, 18)
    return [], [0.0], velocity, rng.uniform(0.5, 1.5) * np.pi / 2 / velocity


def many_crossovers(rng):
    poles = [p for _ in range(rng.integers(2, 5)) for p in pair(-decades(rng, -4, -2), decades(rng, -0.5, 1))]
    return poles[2:], [p * 1.1 for p in poles], decades(rng, -2, 1), decades(rng, -1, 1.5)


def neutral(rng):
    zeros, poles = ([rng.choice([-1, -1, 1]) * decades(rng, -1, 1) for _ in range(2)] for _ in range(2))
    gain = rng.choice([rng.uniform(-1, 1), 1 - decades(rng, -8, -1)])
    return zeros, poles, gain, rng.choice([0, 1]) * decades(rng, -2, 1)


def hidden_mode(rng):
    zeros, poles, gain, dead_time = wheel_slip(rng)
    hidden = rng.choice([-1, -1, 1]) * decades(rng, -1, 1)
    return [*zeros, hidden], [*poles, hidden], gain, dead_time


def poles_on_axis(rng):
    poles = [*rng.choice([[0.0, 0.0], pair(0.0, decades(rng, -0.5, 0.5))]), *(-decades(rng, -1, 1) for _ in range(2))]
    zeros = [rng.choice([-1, -1, 1]) * decades(rng, -1, 1)]
    return zeros, poles, decades(rng, -2, 1), rng.choice([0, 1]) * decades(rng, -2, 0)


def scaled(rng):
    zeros, poles, gain, dead_time = wheel_slip(rng)
    time = decades(rng, -6, 6)
    return [z * time for z in zeros], [p * time for p in poles], gain * time**2, dead_time / time


KINDS = (
    *(wheel_slip, extremum_of_gain_near_one, gain_one_at_zero, flat, fast_integrator, many_crossovers),
    *(neutral, hidden_mode, poles_on_axis, scaled),
)


def loops(kind, count):
    """`count` loops of a kind as (zeros, poles, gain, dead time)."""
    for seed in range(count):
        zeros, poles, gain, dead_time = kind(np.random.default_rng([KINDS.index(kind), seed]))
        yield np.array(zeros, complex), np.array(poles, complex), float(gain), float(dead_time)
