"""One verdict over an envelope: which it is, from which speed on, and its worst cases against loops made one by one."""

from __future__ import annotations

import itertools
import math

import control as ct
import numpy as np
import pytest
from sample_vehicles import COACH

from railslip_ctrl.design import PIController, wheel_slip_loop
from railslip_ctrl.design.controllers import sampled_loop
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.judging import judge
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.vehicle import PARK2008, Actuator, PIGains
from railslip_ctrl.simulation import LinearControl

PI_LEAD = PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)
FAST = PIController(PIGains(kp=1100.0, ki=60.0), lead=0.4, lead_filter=0.04)  # for the coach

BRAKES = {
    "published": PARK2008,
    "coach": COACH,
    "prompt": COACH.model_copy(update={"actuator": Actuator(dead_time=0.05, lag=0.0)}),
}


def own_loop(car, controller, adhesion, rail, speed, load, slip, dead_time, lag, radius):
    """A loop of the envelope, made from its definition."""
    loaded = car.loaded() if load == "loaded" else car
    law = published_law(adhesion, rail, wheel_load=loaded.wheel_load)
    worn = loaded.model_copy(update={"wheel": loaded.wheel.model_copy(update={"radius": radius * car.wheel.radius})})
    brake = Actuator(dead_time=dead_time * car.actuator.dead_time, lag=lag * car.actuator.lag)
    point = operating_point(law, worn, speed / 3.6, slip * law.reference_slip(law.rail))
    return wheel_slip_loop(linearize(point), controller, brake)


@pytest.mark.parametrize(("name", "controller"), [("published", PI_LEAD), ("coach", FAST), ("prompt", FAST)])
def test_no_loop_of_the_envelope_is_worse_than_the_worst(name, controller):
    car, envelope = BRAKES[name], Envelope(BRAKES[name])
    judged = judge(controller, envelope)
    rng = np.random.default_rng(16)
    axes = [("bristle", "curve"), ("dry", "wet"), envelope.speeds, envelope.loads, *map(tuple, (
        envelope.slip, envelope.dead_time, envelope.lag, envelope.radius))]  # fmt: skip
    ms, usable = {}, judged.usable_from_kmh or 0.0
    for _ in range(150):
        chosen = tuple(axis[rng.integers(len(axis))] for axis in axes)
        loop = own_loop(car, controller, *chosen)
        ms[chosen] = loop.margins().ms if loop.is_stable() else math.inf
    assert judged.stable.mean() == pytest.approx(np.isfinite([*ms.values()]).mean(), abs=0.1)  # of 150, at least 0.04
    assert max(x for chosen, x in ms.items() if chosen[2] >= usable) <= judged.worst_with_tolerances.ms * (1 + 1e-9)
    for adhesion, rail, speed, load in itertools.product(*axes[:4]):
        loop = own_loop(car, controller, adhesion, rail, speed, load, 1.0, 1.0, 1.0, 1.0)
        if speed >= usable:
            assert (loop.margins().ms if loop.is_stable() else math.inf) <= judged.worst.ms * (1 + 1e-9)
    # and it is attained, where it says
    for worst in (judged.worst, judged.worst_with_tolerances):
        table = worst.case.table()
        of = car.actuator
        held = published_law(table["adhesion"], table["rail"]).reference_slip(table["rail"])
        again = own_loop(
            car, controller, *(table[key] for key in ("adhesion", "rail", "speed_kmh", "load")), table["slip"] / held,
            table["dead_time_s"] / of.dead_time, table["lag_s"] / of.lag if of.lag else 1.0,
            table["radius_m"] / car.wheel.radius,
        )  # fmt: skip
        assert again.is_stable() == (worst.margins is not None)
        assert worst.margins is None or worst.ms == pytest.approx(again.margins().ms, rel=1e-9)


def test_the_verdict_is_of_the_operating_points_and_of_the_tolerances():
    speeds = (20, 60, 100)
    on_bristle = Envelope(laws="bristle", speeds=speeds)
    judged = judge(PI_LEAD, on_bristle)
    assert judged.verdict == "robust"
    assert judged.verdict_line == (
        "robust: Ms 1.43 at bristle, dry, empty, 100 km/h; with tolerances Ms 2.02 at bristle, dry, empty, 100 km/h, "
        "slip +25 %, dead time +30 %, lag +30 %"
    )
    assert judged.usable_from_kmh == judged.robust_from_kmh == 20.0
    # on the curve every operating point is well damped, but past its peak a slow brake loses the wheel at low speed
    both = on_bristle.at(laws=("bristle", "curve"))
    judged, nominal = judge(PI_LEAD, both), judge(PI_LEAD, both, nominal=True)
    assert (judged.verdict, nominal.verdict) == ("fragile", "robust")
    assert nominal.verdict_line.startswith("robust at the operating points: Ms 1.57 at curve, dry, empty, 20 km/h")
    assert judged.worst.ms <= nominal.worst.ms
    assert judged.usable_from_kmh == judged.robust_from_kmh == 60.0
    assert judged.worst.point.speed_kmh >= 60.0
    assert "unstable at curve, dry, empty, 20 km/h, slip +25 %" in str(judged)
    assert "stable from 60 km/h up, there Ms 44.6 at curve, dry" in str(judged)
    slow = judge(PI_LEAD, both.at(speeds=(10, 100)))
    assert (slow.verdict, slow.usable_from_kmh) == ("unstable", 100.0)


def test_a_design_that_is_stable_nowhere_says_so():
    judged = judge(PIController(PIGains(kp=1e6, ki=1.0)), Envelope(speeds=(60, 100)))
    assert (judged.verdict, judged.usable_from_kmh, judged.robust_from_kmh) == ("unstable", None, None)
    assert judged.worst.margins is None
    assert judged.table()["worst"]["ms"] is None
    assert "not stable at 100 km/h either" in judged.verdict_line


def test_fragile_names_an_operating_point_over_the_limit():
    slips = {"dry": 0.1, "wet": 0.1}  # Ms 1.28, 1.84, 2.29: robust below 100 km/h, which no stop begins from
    envelope = Envelope(laws="curve", rails="dry", loads="empty", speeds=(20, 60, 100), reference=slips)
    judged = judge(PIController(PIGains(kp=900.0, ki=5.0), 0.6, 0.06), envelope, nominal=True)
    assert (judged.verdict, judged.usable_from_kmh, judged.robust_from_kmh) == ("fragile", 20.0, None)
    assert judged.verdict_line == "fragile at the operating points: Ms 2.3 at curve, dry, empty, 100 km/h"


def test_map_and_axes_are_of_the_cases():
    judged = judge(PI_LEAD, Envelope(speeds=(100, 60)))
    ms, points = judged.ms, judged.points
    assert judged.map.speeds_kmh.tolist() == [60.0, 100.0]
    for row, column in itertools.product(range(2), range(2)):
        here = (points.speed_kmh == judged.map.speeds_kmh[row]) & (points.load == judged.map.loads[column])
        assert judged.map.with_tolerances[row, column] == ms[here].max()
        assert judged.map.operating[row, column] == ms[here & points.operating].max()
    axes = judged.by_axis()
    assert axes["load"]["loaded"] == (1.0, ms[points.load == "loaded"].max())
    assert [len(values) for values in axes.values()] == [2, 2, 2, 2, 3, 2, 3, 3]


def test_a_controller_s_own_reference_is_where_it_is_judged():
    class Holding(PIController):
        reference = ReferenceSlip(dry=0.09, wet=0.06)

    small, holding = Envelope(laws="curve", rails="dry", speeds=60), Holding(PI_LEAD.gains, 0.6, 0.06)
    own = judge(holding, small)
    assert own.worst.point.slip == 0.09
    assert own.worst.ms == judge(PI_LEAD, small.at(reference=Holding.reference)).worst.ms
    # unless the envelope has one
    assert judge(holding, small.at(reference={"dry": 0.12, "wet": 0.08})).worst.point.slip == 0.12


def test_the_worst_is_a_loop_to_look_at():
    worst = judge(PI_LEAD, Envelope(speeds=60)).worst_with_tolerances
    again = wheel_slip_loop(linearize(worst.point), PI_LEAD, worst.point.vehicle.actuator)
    assert (again.margins().ms, again.margins().delay_s) == (worst.ms, worst.margins.delay_s)


# --- sampled ---------------------------------------------------------------------------------------------------------


def test_a_discrete_controller_is_judged_by_its_sampled_loops():
    s = ct.tf("s")
    discrete = ct.sample_system((229.4 + 5.0 / s) * (0.6 * s + 1) / (0.06 * s + 1), 0.05, "tustin")
    judged = judge(discrete, Envelope(laws="bristle", rails="dry", speeds=100, loads="empty"))
    points, rng = judged.points, np.random.default_rng(2)
    for i in rng.choice(len(points), 8, replace=False):
        loop = wheel_slip_loop(points.plants[points.plant[i]], discrete, points.actuators[points.actuator[i]])
        # a parabola's top, looked at over a 1e-5 of its width
        assert judged.ms[i] == pytest.approx(loop.margins().ms, rel=1e-8)
    assert judged.worst.margins.ms == judged.worst.loop.margins().ms
    assert np.isfinite(judged.margins.delay_s[points.operating]).all()


def test_the_verdict_on_a_controller_with_a_period_follows_what_runs():
    envelope = Envelope(laws="bristle", rails="dry", speeds=(60, 100), loads="empty")
    reference = ReferenceSlip(dry=0.132, wet=0.092)
    assert judge(PI_LEAD, envelope).verdict == "robust"
    verdicts = {}
    for period in (0.02, 0.3, 1.0):
        control = LinearControl(PI_LEAD, reference, period=period)
        found = judge(control, envelope)
        verdicts[period] = (found.verdict, found.usable_from_kmh, found.robust_from_kmh)
        for worst in (found.worst, found.worst_with_tolerances):
            run = sampled_loop(control.sampled(period), worst.case.plant, worst.case.actuator)
            ms = run.margins().ms if run.is_stable() else None
            assert worst.table()["sampled"] == {"period_s": period, "ms": ms}
            assert worst.ms == wheel_slip_loop(worst.case.plant, PI_LEAD, worst.case.actuator).margins().ms
        assert f"sampled every {period:g} s) at bristle" in found.verdict_line
    assert verdicts == {
        0.02: ("robust", 60.0, 60.0),
        0.3: ("fragile", 60.0, None),
        1.0: ("unstable", None, None),
    }
