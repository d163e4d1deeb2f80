"""A verdict over an envelope of 5 000 points. Run with `make benchmark`; the time is that of one core."""

import time

import control as ct

from railslip_ctrl.design import PIController
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.judging import judge
from railslip_ctrl.model.vehicle import PIGains

POINTS = 5000
SECONDS = 2.0


def test_5000_points_are_judged_in_two_seconds():
    controller = PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)
    envelope = Envelope(speeds=[8 * i for i in range(1, 13)])
    judge(controller, Envelope(speeds=60))  # imports
    times = []
    for _ in range(3):
        begin = time.process_time()
        judged = judge(controller, envelope)
        assert judged.worst.ms <= judged.worst_with_tolerances.ms
        times.append(time.process_time() - begin)
    assert len(judged.points) >= POINTS
    each = min(times) / len(judged.points)
    pade = ct.tf(*ct.pade(0.15, 5)) * ct.tf([1.0], [0.6, 1.0]) * ct.tf([229.4, 5.0], [1.0, 0.0])
    loops = [pade * ct.tf([1e-3 * k], [1.0, -1.0]) for k in range(1, 21)]
    begin = time.process_time()
    for loop in loops:
        ct.stability_margins(loop)
    peer = (time.process_time() - begin) / len(loops)
    print(f"\n{len(judged.points)} points judged, worst case by the scalar engine included: {min(times):.2f} s,")
    print(f"a point {peer / each:.1f} times as fast as python-control's stability_margins with a Pade of order 5")
    assert min(times) <= SECONDS
