"""A verdict over an envelope of 5 000 points. Run with `make benchmark`; the time is that of one core."""

from __future__ import annotations

import time

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
    print(f"\n{len(judged.points)} points judged, worst case by the scalar engine included: {min(times):.2f} s")
    assert min(times) <= SECONDS
