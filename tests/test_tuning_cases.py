"""Tuning at operating points, by structure."""

from __future__ import annotations

import pytest

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design.schedule import plant_at
from railslip_ctrl.design.tuning import Specification, tune_cases
from railslip_ctrl.model.vehicle import PARK2008, Actuator, Rail

PLANTS = [plant_at("bristle", PARK2008, Rail.DRY, 100.0)]


def test_a_lead_meets_what_a_pi_cannot():
    wanted = Specification(ms_max=1.8)
    lead = tune_cases(PLANTS, PARK2008.actuator, structure="pi-lead", specification=wanted)
    assert lead.design is not None
    assert lead.controller(lead.design).lead == PARK2008.actuator.lag
    pi = tune_cases(PLANTS, PARK2008.actuator, structure="pi", specification=wanted)
    assert pi.design is None
    assert "Ms <= 1.8" in pi.reason
    assert pi.asked == "maximise ki, Ms <= 1.8"


@pytest.mark.parametrize(
    ("actuator", "wanted", "ki_min"),
    [
        (Actuator(dead_time=0.05, lag=0.2), Specification(ms_max=1.8), None),
        (Actuator(dead_time=0.1, lag=0.0), Specification(), 50.0),
    ],
)
def test_a_pid_has_the_derivative_time_that_serves_best(actuator, wanted, ki_min):
    def tuned(structure, **given):
        return tune_cases(PLANTS, actuator, structure=structure, specification=wanted, ki_min=ki_min, **given)

    def worth(cases):
        return cases.design.ki if ki_min is None else -cases.design.worst.ms

    pid = tuned("pid")
    for factor in (0.9, 1.1):
        assert worth(tuned("pi-lead", lead=factor * pid.lead)) < worth(pid)
    if ki_min:
        assert pid.asked == "minimise Ms with ki >= 50 N*m/m"


@pytest.mark.parametrize(
    ("structure", "extra", "match"),
    [("pdf", {}, "choose one of"), ("pi", {"lead": 0.6}, "does not go with"), ("pid", {"lead": 0.6}, "searches")],
)
def test_structures_check_their_options(structure, extra, match):
    with pytest.raises(InputError, match=match):
        tune_cases(
            PLANTS,
            PARK2008.actuator,
            structure=structure,
            specification=Specification(ms_max=2.0),
            **extra,
        )
