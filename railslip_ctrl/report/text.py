"""Plain-text reports to print and file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from itertools import zip_longest
from typing import Any

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from railslip_ctrl.core.rounding import BOUND_DIGITS, rounded_down, rounded_up
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design import PIController
from railslip_ctrl.design.assessment import Assessment, PadeRow
from railslip_ctrl.design.controllers import LinearController
from railslip_ctrl.loop import Certificate, Margins
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.model.vehicle import Actuator, Rail, Vehicle, remarks
from railslip_ctrl.report.laws import PUBLISHED, source_at, words_at

from .layout import counted, facts, fixed, heading, render, roots_text, table


def _matrix(matrix: Iterable[Iterable[float]]) -> str:
    return "[" + "; ".join(" ".join(f"{x:.7g}" for x in row) for row in matrix) + "]"


def case_title(point: OperatingPoint) -> str:
    """The case in a line."""
    return f"{words_at(point)}, {point.place}, inertia scale {point.vehicle.inertia_scale:g}" + (
        "" if point.initial_speed_kmh is None else f", v0 {point.initial_speed_kmh:g} km/h"
    )


def controller_text(controller: LinearController) -> str:
    """What a linear controller is, with its numbers."""
    if not isinstance(controller, PIController):
        numbers = {k: v for k, v in asdict(controller).items() if v is not None}
        return f"{controller.structure}: " + ", ".join(f"{k} {_plain(v)}" for k, v in numbers.items())
    kp, ki = controller.gains.kp, controller.gains.ki
    text = f"{controller.structure}: kp {kp:.6g} N·m/(m/s), ki {ki:.6g} N·m/m"
    text += f"   ({kp * KMH:.5g} N·m per km/h, {ki * KMH:.5g} N·m per km/h per s)"
    if controller.structure != "PI":
        text += f", lead ({controller.lead:g} s + 1)/({controller.lead_filter:g} s + 1)"
    return text


def _plain(value: float | tuple[Any, ...]) -> str:
    return f"[{' '.join(map(_plain, value))}]" if isinstance(value, tuple) else f"{value:.6g}"


def _actuator(actuator: Actuator) -> str:
    return f"dead time {actuator.dead_time:g} s (exact), lag {actuator.lag:g} s"


def vehicle_line(vehicle: Vehicle) -> str:
    """The vehicle's name, source and wheel load in a line."""
    source = f"  {vehicle.source}" if vehicle.source else ""
    return f"{vehicle.name}{source}, wheel load {vehicle.wheel_load:g} N"


def _masses(vehicle: Vehicle) -> str:
    if vehicle.mass == vehicle.mass_loaded:
        return f"{vehicle.mass:g} kg"  # one load, or taken as loaded
    return f"{vehicle.mass:g} kg empty, {vehicle.mass_loaded:g} kg loaded"


def vehicle_facts(vehicle: Vehicle) -> list[tuple[str, str]]:
    """The vehicle's parameters with units, and what was assumed of it."""
    wheel, resistance = vehicle.wheel, vehicle.resistance
    rows = [
        ("Vehicle", vehicle.name + (f"  {vehicle.source}" if vehicle.source else "")),
        ("Quarter-car mass M", _masses(vehicle)),
        ("Wheel load N", f"{vehicle.wheel_load:g} N"),
        (
            "Wheel",
            f"radius {wheel.radius:g} m, inertia {wheel.inertia:g} kg·m², "
            f"viscous friction {wheel.viscous_friction:g} N·m·s",
        ),
        (
            "Travelling resistance",
            f"{resistance.constant:.5g} + {resistance.linear:.5g} v + {resistance.quadratic:.5g} v² N, v in m/s",
        ),
        ("Brake actuator", _actuator(vehicle.actuator)),
        ("Inertia scale", f"{vehicle.inertia_scale:g} on M, J and B"),
    ]
    return rows + [("Note", note) for note in remarks(vehicle)]


def law_facts(points: Iterable[OperatingPoint]) -> list[tuple[str, str]]:
    """The law of the points on each rail with its parameters; of the user's own law also how wet ones follow."""
    found = {(point.rail, point.law.parameters()): point for point in points}
    dry = next((point.law for point in found.values() if point.rail is Rail.DRY), None)
    return [
        (
            f"Adhesion law, {point.rail} rail",
            f"{words_at(point)}: {_parameters(point.law)}{_wet_rule(point, dry)}",
        )
        for point in found.values()
    ]


def _parameters(law: AdhesionLaw) -> str:
    return ", ".join(f"{name} {_value(value)}{_unit(unit)}" for name, (value, unit) in law.numbers().items())


def _value(value: float | tuple[float, ...]) -> str:
    return f"{value:.6g}" if not isinstance(value, tuple) else f"[{' '.join(f'{x:.6g}' for x in value)}]"


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit.replace('*', '·')}"


def _wet_rule(point: OperatingPoint, dry: AdhesionLaw | None) -> str:
    """That wet parameters were derived from dry ones, by which factors; what is known where only wet rail is asked."""
    if point.rail is not Rail.WET or source_at(point) == PUBLISHED:
        return ""
    if dry is not None:
        derived = dry.wet().parameters() == point.law.parameters()
        return f"; wet by the rule of the law: {_factors(dry)}" if derived else ""
    rule = _factors(point.law.model_copy(update={"rail": Rail.DRY}))
    return f"; given for wet rail, or wet by the rule of the law from dry ones: {rule}" if rule else ""


def _factors(dry: AdhesionLaw) -> str:
    """What the parameters of a dry law are multiplied by on wet rail."""
    told = []
    wet = dry.wet().numbers()
    for name, (value, _) in dry.numbers().items():
        columns = zip(_column(wet[name][0]), _column(value), strict=True)
        ratios = [new / old for new, old in columns if old != 0.0]
        if ratios and ratios[0] != 1.0:
            told.append(f"{name} × {ratios[0]:g}")
    return ", ".join(told) or "no parameter changes"


def _column(value: float | tuple[float, ...]) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)


# -- linearize ------------------------------------------------------------------------------------------------


def linearize_text(plants: Sequence[LinearPlant]) -> str:
    """Operating points and linearisations."""
    parts: list[RenderableType] = []
    for plant in plants:
        parts += [*_linear_plant(plant), Text("")]
    return render(parts[:-1])


def _linear_plant(plant: LinearPlant) -> list[RenderableType]:
    point = plant.point
    num, den = plant.transfer_function()
    frozen = "speed as a state" if plant.speed_state else "speed frozen"
    rows = [
        ("Vehicle", vehicle_line(point.vehicle)),
        (
            "Operating point",
            f"slip velocity {point.sigma:.6g} m/s, adhesion coefficient {point.adhesion_coefficient:.5g}",
        ),
        ("Adhesion force", f"{point.adhesion_force:.7g} N"),
        ("Brake torque", f"{point.brake_torque:.7g} N·m (λ' = 0, travelling resistance included)"),
        ("Residual", f"{point.residual:.1e} (relative; λ' and the adhesion state at rest)"),
        ("States", ", ".join(plant.states)),
        ("Input", ", ".join(plant.inputs) + " at the wheel, N·m (the actuator is not in it)"),
        ("Outputs", ", ".join(plant.outputs) + f" (error = {point.slip:g} v − sigma)"),
        ("A", _matrix(plant.A)),
        ("B", _matrix(plant.B)),
        ("C", _matrix(plant.C)),
        ("D", _matrix(plant.D)),
        ("Poles, 1/s", roots_text(plant.poles)),
        ("Zeros, 1/s", roots_text(plant.zeros) + "   (torque to sigma)"),
        ("sigma/torque", f"({polynomial_text(num)}) / ({polynomial_text(den)})   (m/s)/(N·m)"),
    ]
    return [heading(f"Linearisation, {frozen}: {case_title(point)}"), facts(rows)]


def polynomial_text(coefficients: Iterable[float]) -> str:
    """A polynomial in s from its coefficients, highest power first."""
    values = list(coefficients)
    terms: list[str] = []
    for i, value in enumerate(values):
        power = len(values) - 1 - i
        symbol = "" if power == 0 else " s" if power == 1 else f" s^{power}"
        sign = " - " if value < 0 else " + " if terms else ""
        terms.append(f"{sign}{abs(value):.6g}{symbol}")
    return "".join(terms)


# -- margins --------------------------------------------------------------------------------------------------


def margins_text(assessments: Sequence[Assessment], certificates: Sequence[Certificate] = ()) -> str:
    """Stability-margin reports, one after the other, with their certificates where there are any."""
    parts: list[RenderableType] = []
    for assessment, certificate in zip_longest(assessments, certificates):
        parts += [*_assessment(assessment), *_certificate(certificate), Text("")]
    return render(parts[:-1])


def _assessment(assessment: Assessment) -> list[RenderableType]:
    limits = assessment.limits
    p = limits.unstable_pole
    poles = assessment.closed_loop_poles
    rows = [
        ("Vehicle", vehicle_line(assessment.point.vehicle)),
        ("Controller", controller_text(assessment.controller)),
        ("Actuator", _actuator(assessment.actuator)),
        ("Plant poles, 1/s", roots_text(assessment.plant.poles)),
        ("Limits", _limits(assessment) if p > 0 else "the plant is stable: none from an unstable pole"),
        ("Open loop", counted(assessment.loop.open_loop_unstable_poles, "unstable pole")),
        ("Closed-loop poles, 1/s", f"{roots_text(poles)}   (rightmost {poles.size}, exact dead time)"),
    ]
    parts: list[RenderableType] = [heading(f"Stability margins: {case_title(assessment.point)}"), facts(rows)]
    if assessment.margins is not None:
        parts.append(_margin_table(assessment, assessment.margins))
        parts.append(_crossover_line(assessment.margins))
    if assessment.pade:
        parts += _pade_part(assessment)
    if assessment.as_run is not None:
        parts.append(Text(_sampled_line(assessment.as_run.period, assessment.sampled)))
    parts.append(Text(f"Verdict: {assessment.verdict_line}"))
    return parts


def _sampled_line(period: float, sampled: Margins | None) -> str:
    if sampled is None:
        return f"As run, sampled every {period:g} s: unstable"
    return (
        f"As run, sampled every {period:g} s: Ms {rounded_up(sampled.ms):g}, phase margin {sampled.phase_deg:.4g} deg, "
        f"delay margin {sampled.delay_s:.4g} s"
    )


def _certificate(certificate: Certificate | None) -> list[RenderableType]:
    """Enclosures, every digit of their ends."""
    if certificate is None:
        return []
    balls = f"ball arithmetic, {certificate.bits} bits; |S| and |T| bounded on {certificate.parts} parts of the axis"
    if not certificate.stable:
        poles = f"{certificate.unstable_poles:g} in the closed right half plane"
        axis = f"; one on the imaginary axis or within 2^-{certificate.bits} of it" if certificate.marginal else ""
        return [Text(f"Certificate: unstable, closed-loop poles: {poles}{axis}")]
    rows = [
        (name, *map(str, ends), unit)
        for name, unit, ends in (
            ("Gain increase", "×", certificate.gain_increase),
            ("Gain decrease", "×", certificate.gain_decrease),
            ("Phase margin", "deg", certificate.phase_deg),
            ("Delay margin", "s", certificate.delay_s),
            ("Ms = max |S|", "-", certificate.ms),
            ("Mt = max |T|", "-", certificate.mt),
        )
        if ends is not None
    ]
    shown = table(("Certified", "Lowest", "Highest", "Unit"), rows)
    return [Padding(shown, (1, 0, 0, 0)), Text(f"Certificate: stable; {balls}")]


def _limits(assessment: Assessment) -> str:
    limits = assessment.limits
    against = "< 1, as a PI needs" if limits.actuator_product < 1 else ">= 1: no PI holds it"
    text = (
        f"unstable pole p = {limits.unstable_pole:.5g} 1/s (doubles in {limits.doubling_time:.3g} s); "
        f"p (dead time + lag) = {limits.actuator_product:.4g} {against}"
    )
    if rounded_down(limits.ms_bound, BOUND_DIGITS) > 1.0:  # as every loop's is
        text += f"; no controller gets Ms or Mt below {_least(limits.ms_bound)}"
    for structure in (limits.pi, limits.pi_lead):
        if structure is None:
            continue
        name = "a PI" if structure.structure == "PI" else "a PI with lead on the lag"
        if structure.feasible:
            phase = fixed(rounded_up(structure.phase_deg, BOUND_DIGITS), BOUND_DIGITS)
            text += f"; {name}: phase margin <= {phase} deg, Ms >= {_least(structure.ms_bound)}"
        else:
            text += f"; {name} cannot stabilise it"
    return text


def _least(bound: float) -> str:
    """A lower bound, rounded to the side that claims less."""
    return fixed(rounded_down(bound, BOUND_DIGITS), BOUND_DIGITS)


def _decibel(factor: float) -> str:
    return f"{20 * math.log10(factor):+.2f} dB" if 0 < factor < math.inf else ""


def _margin_table(assessment: Assessment, m: Margins) -> Padding:
    low, high = m.disk_gain_range
    rows = [
        ("Gain increase", fixed(m.gain_increase, 6), "×", fixed(m.gain_increase_frequency), _decibel(m.gain_increase)),
        (
            "Gain decrease",
            fixed(m.gain_decrease, 6) if m.gain_decrease > 0 else "unbounded",
            "×",
            fixed(m.gain_decrease_frequency),
            _decibel(m.gain_decrease),
        ),
        ("Phase margin", fixed(m.phase_deg, 6), "deg", fixed(m.phase_frequency), "smallest over all gain crossovers"),
        ("Delay margin", fixed(m.delay_s, 6), "s", fixed(m.delay_frequency), "added dead time that destabilises"),
        ("Ms = max |S|", fixed(m.ms, 6), "-", fixed(m.ms_frequency), f"distance to −1: {1 / m.ms:.4g}"),
        ("Mt = max |T|", fixed(m.mt, 6), "-", fixed(m.mt_frequency), ""),
        (
            "Disk margin",
            fixed(m.disk, 6),
            "-",
            fixed(m.disk_frequency),
            f"gain {low:.4g} to {fixed(high, 4)}, phase ±{m.disk_phase_deg:.4g} deg together",
        ),
    ]
    usable = assessment.stabilizing_gain_range
    if usable is not None:
        rows.append(("Stabilising gain", f"{usable[0]:.5g} to {fixed(usable[1])}", "×", "", "of this loop gain"))
    shown = table(("Margin", "Value", "Unit", "At ω, rad/s", ""), rows, words=(2, 4))
    return Padding(shown, (1, 0, 0, 0))


def _crossover_line(m: Margins) -> Text:
    pairs = [
        f"{w:.5g} rad/s ({phase:+.4g} deg)" for w, phase in zip(m.gain_crossovers, m.phase_margins_deg, strict=True)
    ]
    return Text("Gain crossovers: " + (", ".join(pairs) or "none") + "\n")


def _pade_part(assessment: Assessment) -> list[RenderableType]:
    """The Pade table; of an unstable loop only which orders see that it is."""
    if assessment.stable or any(row.margins is not None for row in assessment.pade):
        return [Text("Pade approximation of the dead time against exact:"), _pade_table(assessment)]
    orders = [row.order for row in assessment.pade]
    return [Text(f"Pade approximation of the dead time: orders {orders[0]} to {orders[-1]} say unstable too")]


def _pade_table(assessment: Assessment) -> RenderableType:
    rows = [_pade_row(row, assessment.margins) for row in assessment.pade]
    rows.append(["exact", *_pade_cells(assessment.margins), ""])
    return table(
        ("Order", "Closed loop", "Gain increase", "Gain decrease", "Phase, deg", "Delay, s", "Ms", "Ms error"), rows
    )


def _pade_cells(m: Margins | None) -> list[str]:
    if m is None:
        return ["unstable", "-", "-", "-", "-", "-"]
    decrease = fixed(m.gain_decrease) if m.gain_decrease > 0 else "unbounded"
    return ["stable", fixed(m.gain_increase), decrease, fixed(m.phase_deg), fixed(m.delay_s), fixed(m.ms)]


def _pade_row(row: PadeRow, exact: Margins | None) -> list[str]:
    error = ""
    if row.margins is not None and exact is not None:
        percent = 100 * (row.margins.ms / exact.ms - 1)
        error = f"{percent:+.2g} %" if abs(percent) >= 1e-9 else "< 1e-9 %"
    elif (row.margins is None) != (exact is None):
        error = "wrong verdict"
    return [str(row.order), *_pade_cells(row.margins), error]
