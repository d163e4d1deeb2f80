"""One sample of the seeking slip controller: it finds the peak of adhesion without being told rail, mass or curve.

The text of this module is compiled into the loop of a braking run. The parts, in the order in which a sample runs them:
model of the actuator, adhesion-torque observer, predictor over the dead time, map of adhesion and peak seeking, then
fast start or inner loop, low-speed hand-over, re-adhesion. x and c are laid out by the names below; SI.
"""

from __future__ import annotations

import math

from railslip_ctrl.model.kernels import compiled

# the controller's row c: reference slip and wheel radius, then its own numbers
RADIUS = 1
(
    INERTIA,
    FRICTION,
    WHEEL_LOAD,
    DEAD_TIME,
    LAG,
    PERIOD,
    TORQUE_HIGH,
    KAPPA,
    TAU_C,
    TAU_O,
    TAU_A,
    START_LEAD,
    START_SLIP,
    ELASTICITY,
    AGAIN_SHARE,
    FIRST_SLIP,
    LEAST_SLIP,
    LARGEST_SLIP,
    FORGETTING,
    CURVATURE,
    FLATNESS,
    RISE,
    FALL,
    HAND_OVER_SPEED,
    FADE_SPEED,
    HAND_OVER_SHARE,
    LAST_SHARE,
    LAST_SPEED,
    RING,
    KNOTS,
    FIRST_KNOT,
) = range(2, 33)

# the state x
(
    SAMPLES,
    TORQUE_AHEAD,
    FILTERED_OMEGA,
    FILTERED_TORQUE,
    FILTERED_SIGMA,
    FILTERED_SPEED,
    SLOW_SPEED,
    ADHESION_TORQUE,
    DECELERATION,
    HOLDING_TORQUE,
    SIGMA_AHEAD,
    SPEED_AHEAD,
    SLIP_RATE,
    REFERENCE_SLIP,
    PEAK,
    STARTING,
    LAST_LOG_TORQUE,
    LAST_LOG_SLIP,
    FLAT_SAMPLES,
    LOW_TIME,
    MEAN_TORQUE,
    QUICK_TORQUE,
    MEAN_HOLDING,
    HANDED_OVER,  # 1; 0 before, -1 where the slip has run away
    SLOW,
    STEP_LOG_TORQUE,
    STEP_LOG_SLIP,
    MEAN_SLIP,
    MEAN_ADHESION,
    SLIP_SCATTER,
    ADHESION_SCATTER,
    STIFF_TIME,
    HISTORY,
) = range(33)

_MEAN_TIME = 0.5  # s, of the means that a rise of adhesion and the hand-over are judged by
QUICK_TIME = 0.05  # s
_GROWTH = 0.7  # 1/s, largest relative rate of the reference slip, upwards: slip follows it no faster where it is low
AGAIN, RISEN = 2.0, 3.0  # in STARTING: slip stayed low, adhesion rose; 1: the first start, 0: none
_LOW_SLIP = 0.6  # of the first reference: a new start is worth its price to a slip that is lower
_START_SPEED = 1.1  # of that at which the reference fades: below, a start anew would lock more than it gains
_LOG_STEP = 0.05  # of slip, over which the elasticity of a rail just met is judged: its noise is high
_FLAT_STEPS, _FLAT_TIME = 2.0, 0.01  # in turn; s, of a step at least
_SLOW_ELASTICITY = 0.4  # below which the peak is near, and a start slows down
_SLOW_STEP = 0.1  # of ln slip, that it is taken over
SLOW_FROM = 0.003  # slip from which it does: below, bristles bend
SLOW_SHARE = 2.0  # of the holding torque, that a slow start takes
_SCATTER_TIME = 0.4  # s, of the means that scatter is taken from, and for which a reference is in doubt
_STIFF = 3.0  # relative scatter of slip over that of adhesion torque: with less the peak is far
_LEAST_SCATTER = 0.003  # relative, of adhesion torque: with less there is no noise to go by
_FAR = 2.0  # of the reference: a slip above comes back from past the peak
_CALM = 1.4  # of the mean slip: what is farther is a motion, and no scatter
_LOW_REFERENCE, _HIGHER = 0.4, 3.0  # of the first reference, below which one is low; by what it is raised in doubt
# such a ratio, share of the first reference and time, s, where it is less low: it may be right, as past beam's wet peak
_STIFFER, _FAIR_REFERENCE, _FAIR_TIME = 1.7, 0.8, 1.0
_ASSUMED = 0.1  # adhesion coefficient of a rail of which nothing is known yet, at the hand-over
_LOCKED = 0.9  # slip of a wheel that turns no more, at the hand-over
# slip that has run away before; share of the torque to be held meanwhile, and afterwards
_RUN_AWAY, _LET_GO, _LESS = 0.25, 0.5, 0.8
_REACHED = 0.85  # of the reference: with less slip the map does not lower it, if it is not low
_MOST_THROWN = 0.5  # slip that a start's torque adds in a dead time: with more a heavy wheel locks on a weak rail
_TINY = 1e-9  # of the map: weight of a knot never visited
_WEIGHED_TIME = 0.01  # s, that weighs 1 in the map, against its curvature
_LOWEST_SLIP = 1e-4  # whose logarithm is taken


@compiled
def actuator_model(x, c, applied):
    """Acting torque ahead of the dead time, from the command that the brake took; into its history."""
    k, ring = int(x[SAMPLES]), int(c[RING])
    if k > 0:
        x[TORQUE_AHEAD] += (1.0 - math.exp(-c[PERIOD] / c[LAG]) if c[LAG] > 0.0 else 1.0) * (applied - x[TORQUE_AHEAD])
    x[HISTORY + k % ring] = x[TORQUE_AHEAD]


@compiled
def torque_ago(x, c, samples):
    """The modelled torque a number of samples ago, N*m; 0 before the first, in between linear."""
    k, ring, whole = int(x[SAMPLES]), int(c[RING]), int(samples)
    share = samples - whole
    late = x[HISTORY + (k - whole) % ring] if k >= whole else 0.0
    later = x[HISTORY + (k - whole - 1) % ring] if k > whole else 0.0
    return (1.0 - share) * late + share * later


@compiled
def observe(x, c, v, omega, reference):
    """Adhesion torque Ta = (J omega' + B omega + T)/(tau_o s + 1), and the torque that holds the reference slip."""
    sigma = v - c[RADIUS] * omega
    if x[SAMPLES] == 0.0:
        x[FILTERED_OMEGA], x[FILTERED_SIGMA], x[FILTERED_SPEED], x[SLOW_SPEED] = omega, sigma, v, v
    blend, slow = 1.0 - math.exp(-c[PERIOD] / c[TAU_O]), 1.0 - math.exp(-c[PERIOD] / c[TAU_A])
    acting = torque_ago(x, c, c[DEAD_TIME] / c[PERIOD])
    x[FILTERED_OMEGA] += blend * (omega - x[FILTERED_OMEGA])
    x[FILTERED_TORQUE] += blend * (acting - x[FILTERED_TORQUE])
    x[FILTERED_SIGMA] += blend * (sigma - x[FILTERED_SIGMA])
    x[FILTERED_SPEED] += blend * (v - x[FILTERED_SPEED])
    rate = blend / (1.0 - blend) / c[PERIOD]  # of a filtered value to its derivative
    x[SLIP_RATE] = rate * (sigma - x[FILTERED_SIGMA])
    spin = rate * (omega - x[FILTERED_OMEGA])
    x[ADHESION_TORQUE] = c[INERTIA] * spin + c[FRICTION] * x[FILTERED_OMEGA] + x[FILTERED_TORQUE]
    x[SLOW_SPEED] += slow * (v - x[SLOW_SPEED])
    x[DECELERATION] = slow / (1.0 - slow) / c[PERIOD] * (x[SLOW_SPEED] - v)
    turning = c[INERTIA] / c[RADIUS] * x[DECELERATION] * (1.0 - reference)
    x[HOLDING_TORQUE] = x[ADHESION_TORQUE] + turning - c[FRICTION] * x[FILTERED_OMEGA]


@compiled
def predict(x, c, v, sigma):
    """Slip velocity and train speed when a command of now acts, the adhesion torque as it is."""
    count = c[DEAD_TIME] / c[PERIOD]
    under_way = 0.0
    for i in range(int(count)):
        under_way += torque_ago(x, c, float(i)) * c[PERIOD]
    under_way += (count - int(count)) * c[PERIOD] * torque_ago(x, c, count)
    x[SIGMA_AHEAD] = sigma + c[RADIUS] / c[INERTIA] * (under_way - c[DEAD_TIME] * x[HOLDING_TORQUE])
    x[SPEED_AHEAD] = v - c[DEAD_TIME] * x[DECELERATION]


@compiled
def learn(x, c):
    """Weigh the adhesion of now into the map, linear between its knots of slip; what is old is forgotten."""
    knots = int(c[KNOTS])
    matrix, side = HISTORY + int(c[RING]), HISTORY + int(c[RING]) + 2 * knots
    kept = math.exp(-c[PERIOD] / c[FORGETTING])
    for i in range(knots):
        x[matrix + 2 * i] *= kept
        x[matrix + 2 * i + 1] *= kept
        x[side + i] *= kept
    slip = x[FILTERED_SIGMA] / x[FILTERED_SPEED]
    if x[SAMPLES] * c[PERIOD] <= c[DEAD_TIME] + 2.0 * c[TAU_O] or not 0.0 < slip < c[FIRST_KNOT + knots - 1]:
        return
    coefficient = x[ADHESION_TORQUE] / (c[WHEEL_LOAD] * c[RADIUS])
    j = 0
    while slip > c[FIRST_KNOT + j + 1]:
        j += 1
    share = (slip - c[FIRST_KNOT + j]) / (c[FIRST_KNOT + j + 1] - c[FIRST_KNOT + j])
    weight = c[PERIOD] / _WEIGHED_TIME
    x[matrix + 2 * j] += weight * (1.0 - share) ** 2
    x[matrix + 2 * j + 1] += weight * share * (1.0 - share)
    x[matrix + 2 * j + 2] += weight * share**2
    x[side + j] += weight * (1.0 - share) * coefficient
    x[side + j + 1] += weight * share * coefficient


@compiled
def forget(x, c):
    """Empty the map."""
    matrix = HISTORY + int(c[RING])
    for i in range(3 * int(c[KNOTS])):
        x[matrix + i] = 0.0


@compiled
def solve_map(x, c):
    """The adhesion coefficients at the knots that fit what was weighed in, with little curvature: regularised least
    squares, by Cholesky's factors of a matrix with five diagonals; into the room behind the sums."""
    knots = int(c[KNOTS])
    matrix = HISTORY + int(c[RING])
    side, factors, found = matrix + 2 * knots, matrix + 3 * knots, matrix + 6 * knots
    for i in range(knots):
        x[factors + 3 * i] = x[matrix + 2 * i] + _TINY
        x[factors + 3 * i + 1] = x[matrix + 2 * i + 1]
        x[factors + 3 * i + 2] = 0.0
        x[found + i] = x[side + i]
    for i in range(knots - 2):
        near = c[FIRST_KNOT + i + 1] - c[FIRST_KNOT + i]
        far = c[FIRST_KNOT + i + 2] - c[FIRST_KNOT + i + 1]
        mean = 0.5 * (near + far)
        a, b, d = mean / near, -mean / near - mean / far, mean / far
        x[factors + 3 * i] += c[CURVATURE] * a * a
        x[factors + 3 * i + 1] += c[CURVATURE] * a * b
        x[factors + 3 * i + 2] += c[CURVATURE] * a * d
        x[factors + 3 * i + 3] += c[CURVATURE] * b * b
        x[factors + 3 * i + 4] += c[CURVATURE] * b * d
        x[factors + 3 * i + 6] += c[CURVATURE] * d * d
    for i in range(knots):  # L D L', rows of D, and of L' next to it
        pivot, first, second = x[factors + 3 * i], x[factors + 3 * i + 1], x[factors + 3 * i + 2]
        if i + 1 < knots:
            x[factors + 3 * i + 3] -= first * first / pivot
            x[factors + 3 * i + 4] -= first * second / pivot
            x[found + i + 1] -= first / pivot * x[found + i]
        if i + 2 < knots:
            x[factors + 3 * i + 6] -= second * second / pivot
            x[found + i + 2] -= second / pivot * x[found + i]
    for back in range(knots):
        i = knots - 1 - back
        total = x[found + i]
        if i + 1 < knots:
            total -= x[factors + 3 * i + 1] * x[found + i + 1]
        if i + 2 < knots:
            total -= x[factors + 3 * i + 2] * x[found + i + 2]
        x[found + i] = total / x[factors + 3 * i]


@compiled
def peak_of_map(x, c):
    """The least slip ratio within the flatness of the map's highest adhesion."""
    knots = int(c[KNOTS])
    found = HISTORY + int(c[RING]) + 6 * knots
    best = x[found]
    for i in range(knots):
        best = max(best, x[found + i])
    enough = best * (1.0 - c[FLATNESS])
    for i in range(knots - 1):
        low, high = x[found + i], x[found + i + 1]
        if low < enough <= high:
            return c[FIRST_KNOT + i] + (enough - low) / (high - low) * (c[FIRST_KNOT + i + 1] - c[FIRST_KNOT + i])
    return c[LARGEST_SLIP]


@compiled
def seek(x, c, reference):
    """Move the reference slip towards the peak of the map, at most at its rates; a reference that is not low, not down
    before the slip has reached it: the map knows nothing of the adhesion there."""
    learn(x, c)
    if int(x[SAMPLES]) % 5 == 0 and x[SAMPLES] * c[PERIOD] > 2.0 * c[DEAD_TIME]:
        solve_map(x, c)
        x[PEAK] = peak_of_map(x, c)
    if x[PEAK] > 0.0 and x[STARTING] == 0.0:
        goal = min(max(x[PEAK], c[LEAST_SLIP]), c[LARGEST_SLIP])
        rise = min(c[RISE], _GROWTH * x[REFERENCE_SLIP])
        reached = x[FILTERED_SIGMA] >= _REACHED * reference * x[FILTERED_SPEED]
        fall = c[FALL] if reached or x[REFERENCE_SLIP] < _LOW_REFERENCE * c[FIRST_SLIP] else 0.0
        x[REFERENCE_SLIP] += min(max(goal - x[REFERENCE_SLIP], -fall * c[PERIOD]), rise * c[PERIOD])


@compiled
def fading(v, c):
    """The share of the reference slip to be held at a speed."""
    if v >= c[FADE_SPEED]:
        return 1.0
    return 0.7 + 0.3 * max(v - c[HAND_OVER_SPEED], 0.0) / (c[FADE_SPEED] - c[HAND_OVER_SPEED])


@compiled
def quick_torque(x, c, wanted):
    """The command that gives the acting torque the time constant tau_c towards what is wanted."""
    quick = max(c[LAG] / c[TAU_C], 1.0 - math.exp(-c[PERIOD] / c[TAU_C]))  # the latter of a brake without lag
    return x[TORQUE_AHEAD] + quick * (wanted - x[TORQUE_AHEAD])


@compiled
def fast_start(x, c, v, sigma, reference):
    """The largest torque; less where it would throw a heavy wheel past the peak, and at most twice the holding torque
    once adhesion rises little with slip. It ends where the slip is about to pass the start's, or adhesion rises no
    more with it."""
    if sigma + c[START_LEAD] * x[SLIP_RATE] >= min(c[START_SLIP], 0.85 * reference) * v:
        x[STARTING] = 0.0
    slip, step = x[FILTERED_SIGMA] / x[FILTERED_SPEED], _LOG_STEP if x[STARTING] == RISEN else 1e-3
    every = int(_FLAT_TIME / c[PERIOD] + 0.5)
    due = every < 2 or int(x[SAMPLES]) % every == 0
    if due and x[ADHESION_TORQUE] > 0.1 * c[WHEEL_LOAD] * c[RADIUS] and slip > _LOWEST_SLIP:
        log_torque, log_slip = math.log(x[ADHESION_TORQUE]), math.log(slip)
        if x[LAST_LOG_SLIP] == 0.0 or log_slip < x[LAST_LOG_SLIP] - step:
            x[LAST_LOG_TORQUE], x[LAST_LOG_SLIP], x[FLAT_SAMPLES] = log_torque, log_slip, 0.0
        elif log_slip > x[LAST_LOG_SLIP] + step:
            flat = log_torque - x[LAST_LOG_TORQUE] < c[ELASTICITY] * (log_slip - x[LAST_LOG_SLIP])
            x[FLAT_SAMPLES] = x[FLAT_SAMPLES] + 1.0 if flat else 0.0
            x[LAST_LOG_TORQUE], x[LAST_LOG_SLIP] = log_torque, log_slip
        gained, stepped = log_torque - x[STEP_LOG_TORQUE], log_slip - x[STEP_LOG_SLIP]
        if x[STEP_LOG_SLIP] == 0.0 or not -_SLOW_STEP <= stepped <= _SLOW_STEP:
            rose = x[STEP_LOG_SLIP] != 0.0 and stepped > 0.0 and slip > SLOW_FROM
            if rose and gained < _SLOW_ELASTICITY * stepped:
                x[SLOW] = 1.0
            x[STEP_LOG_TORQUE], x[STEP_LOG_SLIP] = log_torque, log_slip
    if x[FLAT_SAMPLES] >= _FLAT_STEPS and x[STARTING] > 0.0:
        x[STARTING] = 0.0
        x[REFERENCE_SLIP] = min(max(1.2 * slip, c[LEAST_SLIP]), x[REFERENCE_SLIP])
    x[LOW_TIME], x[MEAN_TORQUE], x[QUICK_TORQUE] = 0.0, x[ADHESION_TORQUE], x[ADHESION_TORQUE]
    throw = _MOST_THROWN * v / max(c[DEAD_TIME], c[PERIOD]) * c[INERTIA] / c[RADIUS]  # N*m beyond what holds
    most = min(c[TORQUE_HIGH], x[HOLDING_TORQUE] + throw)
    if x[SLOW] > 0.0:
        most = min(most, quick_torque(x, c, SLOW_SHARE * x[HOLDING_TORQUE]))
    if x[STARTING] > 1.0:
        return min(most, c[AGAIN_SHARE] * max(x[MEAN_HOLDING], x[HOLDING_TORQUE]))
    return most


@compiled
def inner_loop(x, c, reference):
    """The command that brings the predicted slip to the reference with kappa, the acting torque in tau_c."""
    error = reference * x[SPEED_AHEAD] - x[SIGMA_AHEAD]
    wanted = x[HOLDING_TORQUE] + c[INERTIA] / c[RADIUS] * c[KAPPA] * error
    below = min(max((error / (reference * x[SPEED_AHEAD]) - 0.25) / 0.75, 0.0), 1.0)
    if below > 0.0:
        wanted = max(wanted, x[HOLDING_TORQUE] * (1.0 + 0.3 * below))
    return quick_torque(x, c, wanted)


@compiled
def hand_over(x, c, v, torque, reference):
    """Below the hand-over speed at most a share of what held the slip before, which falls with the square of the speed
    lost; that share itself from where the slip is below its reference: then nothing is fed back, and the brake's lag is
    left alone. But before that a slip that has run away is let go, and a wheel that has locked at any time; afterwards
    less is held."""
    if v >= c[HAND_OVER_SPEED]:
        x[MEAN_HOLDING] += c[PERIOD] / _MEAN_TIME * (x[HOLDING_TORQUE] - x[MEAN_HOLDING])
        return torque
    slip = x[FILTERED_SIGMA] / x[FILTERED_SPEED]
    if slip > _LOCKED or (x[HANDED_OVER] <= 0.0 and slip > _RUN_AWAY):
        x[HANDED_OVER] = -1.0
    elif x[HANDED_OVER] <= 0.0 and max(slip, x[SIGMA_AHEAD] / x[SPEED_AHEAD]) < reference:
        x[MEAN_HOLDING] *= _LESS if x[HANDED_OVER] < 0.0 else 1.0
        x[HANDED_OVER] = 1.0
    slow = min((c[HAND_OVER_SPEED] - v) / (c[HAND_OVER_SPEED] - c[LAST_SPEED]), 1.0)
    held = (c[HAND_OVER_SHARE] - (c[HAND_OVER_SHARE] - c[LAST_SHARE]) * slow**2) * x[MEAN_HOLDING]
    if slip > _LOCKED:
        return 0.0
    if x[HANDED_OVER] > 0.0:
        return held
    return min(torque, _LET_GO * held if slip > _RUN_AWAY else held)


@compiled
def doubt(x, c):
    """Triple a low reference where slip scatters little compared with the adhesion torque: the peak is then far; one
    less low where it scatters less, and for longer. The map cannot tell, as at a constant reference its slope is that
    of the random force."""
    slip, torque = x[FILTERED_SIGMA] / x[FILTERED_SPEED], x[ADHESION_TORQUE]
    if not x[MEAN_SLIP] / _CALM < slip < x[MEAN_SLIP] * _CALM:
        x[MEAN_SLIP], x[MEAN_ADHESION], x[SLIP_SCATTER], x[ADHESION_SCATTER] = slip, torque, 0.0, 0.0
        x[STIFF_TIME] = 0.0
    blend = c[PERIOD] / _SCATTER_TIME
    slip_error, torque_error = slip - x[MEAN_SLIP], torque - x[MEAN_ADHESION]
    x[MEAN_SLIP] += blend * slip_error
    x[MEAN_ADHESION] += blend * torque_error
    x[SLIP_SCATTER] = (1.0 - blend) * (x[SLIP_SCATTER] + blend * slip_error**2)
    x[ADHESION_SCATTER] = (1.0 - blend) * (x[ADHESION_SCATTER] + blend * torque_error**2)
    low = x[REFERENCE_SLIP] < _LOW_REFERENCE * c[FIRST_SLIP]
    limit = _STIFF if low else _STIFFER
    stiff = x[SLIP_SCATTER] * x[MEAN_ADHESION] ** 2 < limit**2 * x[ADHESION_SCATTER] * x[MEAN_SLIP] ** 2
    stiff = stiff and x[ADHESION_SCATTER] > (_LEAST_SCATTER * x[MEAN_ADHESION]) ** 2
    stiff = stiff and slip < _FAR * x[REFERENCE_SLIP]
    stiff = stiff and x[REFERENCE_SLIP] < _FAIR_REFERENCE * c[FIRST_SLIP]
    x[STIFF_TIME] = x[STIFF_TIME] + c[PERIOD] if stiff else 0.0
    if x[STIFF_TIME] > (_SCATTER_TIME if low else _FAIR_TIME):
        x[REFERENCE_SLIP], x[STIFF_TIME] = min(_HIGHER * x[REFERENCE_SLIP], c[LARGEST_SLIP]), 0.0


@compiled
def readhesion(x, c, v, slip, reference):
    """Start anew where the slip stays far below its reference, or adhesion rises: the rail holds more than before, and
    nothing is known of its peak."""
    x[LOW_TIME] = x[LOW_TIME] + c[PERIOD] if slip < 0.69 * reference else 0.0
    x[QUICK_TORQUE] += c[PERIOD] / QUICK_TIME * (x[ADHESION_TORQUE] - x[QUICK_TORQUE])
    if slip < 1.2 * reference:
        x[MEAN_TORQUE] += c[PERIOD] / _MEAN_TIME * (x[ADHESION_TORQUE] - x[MEAN_TORQUE])
    else:  # what rises as the slip comes back from past the peak is no news of the rail
        x[MEAN_TORQUE] = x[QUICK_TORQUE]
    rises = x[QUICK_TORQUE] > 1.08 * x[MEAN_TORQUE] and slip < 0.85 * reference
    # with a slip above a low reference: the wheel spins up, and adhesion is more than any torque on its way can hold
    spins = c[INERTIA] / c[RADIUS] * x[SLIP_RATE] < -0.2 * x[MEAN_TORQUE]
    if spins and 0.85 * reference < slip < _LOW_SLIP * c[FIRST_SLIP]:
        rises = x[ADHESION_TORQUE] > max(1.08 * x[MEAN_TORQUE], 1.03 * x[TORQUE_AHEAD])
    if v <= _START_SPEED * c[FADE_SPEED]:
        return
    doubt(x, c)
    if x[LOW_TIME] > c[DEAD_TIME] or rises:
        x[STARTING], x[FLAT_SAMPLES], x[LAST_LOG_SLIP], x[LOW_TIME] = RISEN if rises else AGAIN, 0.0, 0.0, 0.0
        if rises:
            x[REFERENCE_SLIP] = max(x[REFERENCE_SLIP], c[FIRST_SLIP])
        x[SLOW], x[STEP_LOG_SLIP], x[MEAN_SLIP] = 0.0, 0.0, 0.0
        forget(x, c)


@compiled
def seeking(x, t, v, omega, applied, c, table):
    """The seeking controller; x: what the names above say, the history of torque, then the map."""
    if not math.isfinite(applied):
        return x[TORQUE_AHEAD]
    if not (math.isfinite(v) and math.isfinite(omega)) or v <= 0.0:
        return applied
    if x[SAMPLES] == 0.0:
        x[REFERENCE_SLIP], x[STARTING] = c[FIRST_SLIP], 1.0 if v >= c[HAND_OVER_SPEED] else 0.0
        x[MEAN_HOLDING] = _ASSUMED * c[WHEEL_LOAD] * c[RADIUS]
    sigma = v - c[RADIUS] * omega
    reference = x[REFERENCE_SLIP] * fading(v, c)
    actuator_model(x, c, applied)
    observe(x, c, v, omega, reference)
    predict(x, c, v, sigma)
    seek(x, c, reference)
    if x[STARTING] > 0.0:
        if v >= c[HAND_OVER_SPEED] and x[STARTING] > 1.0:
            x[MEAN_HOLDING] += c[PERIOD] / _MEAN_TIME * (x[HOLDING_TORQUE] - x[MEAN_HOLDING])
        torque = fast_start(x, c, v, sigma, reference)
    else:
        torque = hand_over(x, c, v, inner_loop(x, c, reference), reference)
        readhesion(x, c, v, sigma / v, reference)
    x[SAMPLES] += 1.0
    return min(max(torque, 0.0), c[TORQUE_HIGH])
