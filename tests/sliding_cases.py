"""Actuators, readings of the units and the layered design that the tests of the sliding mode share."""

from functools import cache
from types import SimpleNamespace

import numpy as np

from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008, Actuator, Rail
from railslip_ctrl.verification.actuator_effects import ActuatorEffect, actuator_effect, published_loop
from railslip_ctrl.verification.fixed_step import FineRun, whole_periods
from railslip_ctrl.verification.layered import LayeredDesign

ACTUATOR = PARK2008.actuator
IDEAL = Actuator(dead_time=0.0, lag=0.0)
AS_PUBLISHED = PARK2008.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})
READINGS = [(rail, scale) for scale in (1.0, AS_PUBLISHED_INERTIA_SCALE) for rail in Rail]
DESIGN = LayeredDesign(kp=312.3, ki=100.0, lead=0.6, lead_filter=0.06, K=450.0)


@cache
def effect_on(rail: Rail) -> ActuatorEffect:
    """What the published actuator does to the published law, SI."""
    return actuator_effect(published_loop(rail))


def measured_cycle(run: FineRun) -> SimpleNamespace:
    """Period and amplitudes over the whole periods of s in a run."""
    period, whole = whole_periods(run)
    amplitudes = {f"{name}_amplitude": np.ptp(getattr(whole, name)) / 2 for name in ("surface", "sigma", "torque")}
    return SimpleNamespace(period=period, surface_mean=whole.surface.mean(), **amplitudes)
