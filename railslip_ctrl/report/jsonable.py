"""Records as plain dictionaries for JSON; non-finite numbers become null."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from railslip_ctrl.design.assessment import Assessment, PadeRow
from railslip_ctrl.design.controllers import LinearController, PIController
from railslip_ctrl.design.limits import Limits
from railslip_ctrl.loop import Certificate, Margins
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.model.vehicle import remarks
from railslip_ctrl.report.laws import source_at

from .laws import law_json


def number(value: float) -> float | None:
    """A finite float, or None."""
    return float(value) if math.isfinite(value) else None


def _complex_pairs(values: Iterable[complex]) -> list[list[float]]:
    return [[float(v.real), float(v.imag)] for v in values]


def case_json(point: OperatingPoint) -> dict[str, Any]:
    """The six keys that name a case."""
    return {
        "adhesion": point.adhesion,
        "rail": point.rail.value,
        "speed_kmh": point.speed_kmh,
        "slip": point.slip,
        "mass_kg": point.vehicle.mass,
        "inertia_scale": point.vehicle.inertia_scale,
    }


def _context_json(point: OperatingPoint) -> dict[str, Any]:
    """What else a case depends on, beside the six keys."""
    return {
        "adhesion_law": law_json(point.law, source_at(point)),
        "initial_speed_kmh": point.initial_speed_kmh,
        "vehicle": point.vehicle.name,
        "wheel_load_n": point.vehicle.wheel_load,
        "notes": list(remarks(point.vehicle)),
    }


def linear_plant_json(plant: LinearPlant) -> dict[str, Any]:
    """A linearisation: operating point, matrices with names, poles and zeros, torque to sigma."""
    num, den = plant.transfer_function()
    return {
        **case_json(plant.point),
        **_context_json(plant.point),
        "adhesion_force_n": plant.point.adhesion_force,
        "brake_torque_nm": plant.point.brake_torque,
        "residual": plant.point.residual,
        "states": list(plant.states),
        "inputs": list(plant.inputs),
        "outputs": list(plant.outputs),
        "A": plant.A.tolist(),
        "B": plant.B.tolist(),
        "C": plant.C.tolist(),
        "D": plant.D.tolist(),
        "poles": _complex_pairs(plant.poles),
        "zeros": _complex_pairs(plant.zeros),
        "transfer_function": {"num": num.tolist(), "den": den.tolist()},
    }


def margin_numbers(margins: Margins | None) -> dict[str, float | None]:
    if margins is None:
        names = ("gain_increase", "gain_decrease", "phase_margin_deg", "delay_margin_s", "ms", "mt", "disk_margin")
        return dict.fromkeys(names)
    return {
        "gain_increase": number(margins.gain_increase),
        "gain_decrease": margins.gain_decrease if margins.gain_decrease > 0 else None,  # null: without bound
        "phase_margin_deg": number(margins.phase_deg),
        "delay_margin_s": number(margins.delay_s),
        "ms": number(margins.ms),
        "mt": number(margins.mt),
        "disk_margin": number(margins.disk),
    }


def _frequencies(margins: Margins | None) -> dict[str, float | None] | None:
    if margins is None:
        return None
    return {
        "gain_increase": number(margins.gain_increase_frequency),
        "gain_decrease": number(margins.gain_decrease_frequency),
        "phase_margin": number(margins.phase_frequency),
        "delay_margin": number(margins.delay_frequency),
        "ms": number(margins.ms_frequency),
        "mt": number(margins.mt_frequency),
        "disk_margin": number(margins.disk_frequency),
    }


def _pade_json(row: PadeRow) -> dict[str, Any]:
    return {"order": row.order, "stable": row.margins is not None, **margin_numbers(row.margins)}


def margins_json(assessment: Assessment, certificate: Certificate | None = None) -> dict[str, Any]:
    """One loop's margins, of an unstable loop null, and its certificate where there is one."""
    usable = assessment.stabilizing_gain_range
    limits = assessment.limits
    return {
        **case_json(assessment.point),
        **_context_json(assessment.point),
        "controller": controller_json(assessment.controller),
        "actuator": {"dead_time_s": assessment.actuator.dead_time, "lag_s": assessment.actuator.lag},
        "plant_poles": _complex_pairs(assessment.plant.poles),
        "open_loop_unstable_poles": assessment.loop.open_loop_unstable_poles,
        "stable": assessment.stable,
        "unstable_closed_loop_poles": (
            int(assessment.unstable_poles) if math.isfinite(assessment.unstable_poles) else None
        ),
        "closed_loop_poles": _complex_pairs(assessment.closed_loop_poles),
        "gain_crossovers_rad_s": [float(w) for w in _crossovers(assessment)],
        **margin_numbers(assessment.margins),
        "stabilizing_gain_range": None if usable is None else [number(usable[0]), number(usable[1])],
        "frequencies_rad_s": _frequencies(assessment.margins),
        "limits": {
            "unstable_pole_rad_s": limits.unstable_pole,
            "pole_times_dead_time_and_lag": limits.actuator_product,
            "mt_lower_bound": number(limits.mt_bound),
            "ms_lower_bound": number(limits.ms_bound),
            **_structure_limits(limits),
        },
        "pade": [_pade_json(row) for row in assessment.pade],
        "verdict": assessment.verdict.value,
        **_sampled_json(assessment),
        **({} if certificate is None else {"certificate": _certificate_json(certificate)}),
    }


def controller_json(controller: LinearController) -> dict[str, Any]:
    """The numbers of a linear controller, SI."""
    if isinstance(controller, PIController):
        found: dict[str, Any] = {"kp_si": controller.gains.kp, "ki_si": controller.gains.ki}
        if controller.structure != "PI":
            found |= {"lead_s": controller.lead, "lead_filter_s": controller.lead_filter}
        return found
    return {"structure": controller.structure, **{k: v for k, v in asdict(controller).items() if v is not None}}


def _crossovers(assessment: Assessment) -> Sequence[float]:
    if isinstance(assessment.loop, SampledLoop):
        return () if assessment.margins is None else assessment.margins.gain_crossovers.tolist()
    return list(assessment.loop.gain_crossovers)


def _sampled_json(assessment: Assessment) -> dict[str, Any]:
    """Margins of what is run, where a continuous controller says how it is sampled."""
    if assessment.as_run is None:
        return {}
    stable = assessment.as_run.is_stable()
    return {"sampled": {"period_s": assessment.as_run.period, "stable": stable, **margin_numbers(assessment.sampled)}}


def _certificate_json(certificate: Certificate) -> dict[str, Any]:
    """Enclosures as [lowest, highest]; null for an end without bound, or for all of an unstable loop."""
    crossovers = [[number(w) for w in ends] for ends in certificate.gain_crossovers]
    found: dict[str, Any] = {
        "stable": certificate.stable,
        "marginal": certificate.marginal,
        "unstable_closed_loop_poles": number(certificate.unstable_poles),
        "gain_crossovers_rad_s": crossovers,
        "bits": certificate.bits,
        "parts": certificate.parts,
    }
    for name, field in CERTIFIED.items():
        ends = getattr(certificate, field)
        found[name] = None if ends is None else [number(end) for end in ends]
    return found


CERTIFIED = {
    **{"gain_increase": "gain_increase", "gain_decrease": "gain_decrease", "phase_margin_deg": "phase_deg"},
    **{"delay_margin_s": "delay_s", "ms": "ms", "mt": "mt"},
}
"""Names in JSON of what a certificate encloses, and in its record."""


def _structure_limits(limits: Limits) -> dict[str, Any]:
    """What a PI, and a PI with a lead on the lag, may hope for; null where the theorem does not apply."""
    found: dict[str, Any] = {}
    for name, structure in (("pi", limits.pi), ("pi_lead", limits.pi_lead)):
        found[f"{name}_phase_margin_upper_bound_deg"] = None if structure is None else number(structure.phase_deg)
        found[f"{name}_ms_lower_bound"] = None if structure is None else number(structure.ms_bound)
    return found
