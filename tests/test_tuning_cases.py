"""Tuning at operating points, by structure."""

from __future__ import annotations

import pytest

from railslip_ctrl.design.schedule import plant_at
from railslip_ctrl.design.tuning import Specification
from railslip_ctrl.design.tuning_cases import tune_cases
from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters import PARK2008, Rail


def test_structures_rank_as_their_freedom():
    plants = [plant_at("bristle", PARK2008, Rail.DRY, 100.0)]
    wanted = Specification(ms_max=1.8)
    lead = tune_cases(plants, PARK2008.actuator, structure="pi-lead", specification=wanted)
    pid = tune_cases(plants, PARK2008.actuator, structure="pid", specification=wanted)
    assert lead.design is not None
    assert pid.design is not None
    assert pid.design.ki >= lead.design.ki  # it may choose the lead's own derivative time
    pi = tune_cases(plants, PARK2008.actuator, structure="pi", specification=wanted)
    assert pi.design is None
    assert "Ms <= 1.8" in pi.reason


@pytest.mark.parametrize(
    ("structure", "extra", "match"),
    [("pdf", {}, "choose one of"), ("pi", {"lead": 0.6}, "does not go with"), ("pid", {"lead": 0.6}, "searches")],
)
def test_structures_check_their_options(structure, extra, match):
    with pytest.raises(InputError, match=match):
        tune_cases(
            [plant_at("bristle", PARK2008, Rail.DRY, 100.0)],
            PARK2008.actuator,
            structure=structure,
            specification=Specification(ms_max=2.0),
            **extra,
        )
