"""What `railslip identify` found, as text, JSON and the model's file."""

from __future__ import annotations

import math
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl import __version__
from railslip_ctrl.adhesion import ReferenceSlip
from railslip_ctrl.identification.comparison import Score, few_for
from railslip_ctrl.identification.fits import NORMAL_QUANTILE, Fit, Parameter
from railslip_ctrl.identification.identify import Campaign, Curve, Identification
from railslip_ctrl.identification.model_files import law_toml, polynomials_toml
from railslip_ctrl.identification.polynomials import ParameterPolynomial, of_known
from railslip_ctrl.identification.reference import LARGEST_LOSS, PeakSlip
from railslip_ctrl.identification.resolution import ColumnStep
from railslip_ctrl.identification.rolling import Rolling
from railslip_ctrl.units import KMH

from .jsonable import number
from .layout import counted, facts, fixed, heading, render, table

_IMPROBABLE = 0.01  # a misfit told

# --- JSON ----------------------------------------------------------------------------------------------------------


def identification_json(found: Identification) -> dict[str, Any]:
    """One log: the model chosen first, then the comparison, the curve, the peaks and the log."""
    fit, curve = found.chosen.fit, found.curve
    return {
        "model": fit.model.name,
        "parameters": {p.name: _parameter_json(p, fit) for p in fit.parameters},
        "mean_abs_error": number(found.chosen.mean_abs_error),
        "points": curve.survey.used,
        "mean_abs_error_adhesion": number(found.chosen.adhesion_error),
        "mean_abs_error_sliding": number(found.chosen.sliding_error),
        "known": {name: _plain(value) for name, value in fit.model.known.items()},
        "correlation": [[number(x) for x in row] for row in fit.correlation],
        "notes": [*fit.notes, *curve.notes],
        "reference_slip": None if found.reference is None else found.reference.model_dump(),
        "peaks": [_peak_json(peak) for peak in found.peaks],
        "models": [_score_json(score) for score in found.scores],
        "not_fitted": list(found.not_fitted),
        "curve": _bins_json(curve),
        "log": _log_json(found),
    }


def campaign_json(found: Campaign) -> dict[str, Any]:
    """Several logs: the parameters over the initial speed, `value` being that at the logs' mean, then each log."""
    first = found.logs[0].chosen.fit
    return {
        "model": first.model.name,
        "parameters": {p.name: _polynomial_json(p, first) for p in found.polynomials},
        "mean_abs_error": sum(each.chosen.mean_abs_error for each in found.logs) / len(found.logs),
        "points": sum(each.curve.survey.used for each in found.logs),
        "warnings": list(found.warnings),
        "logs": [identification_json(each) for each in found.logs],
    }


def _plain(value: float | tuple[float, ...]) -> float | list[float]:
    return list(value) if isinstance(value, tuple) else value


def _unit(name: str, fit: Fit) -> str:
    field = fit.model.force_law.model_fields.get(name)
    extra = None if field is None else field.json_schema_extra
    return str(extra["unit"]) if isinstance(extra, dict) else "1"


def _parameter_json(p: Parameter, fit: Fit) -> dict[str, Any]:
    return {
        "value": p.value,
        "stderr": number(p.stderr),
        "unit": _unit(p.name, fit),
        "interval_99": [number(x) for x in p.interval],
        "status": p.status,
    }


def _polynomial_json(p: ParameterPolynomial, fit: Fit) -> dict[str, Any]:
    mean = float(p.speeds_kmh.mean())
    return {
        "value": p.at(mean),
        "stderr": number(p.stderr_at(mean)),
        "at_initial_speed_kmh": mean,
        "unit": _unit(p.name, fit),
        "of": "initial speed in km/h",
        "coefficients": [float(x) for x in p.coefficients],
        "stderrs": [number(float(x)) for x in p.stderrs],
        "initial_speeds_kmh": [float(x) for x in p.speeds_kmh],
        "values": [float(x) for x in p.values],
        "misfit_probability": number(p.misfit_probability),
    }


def _peak_json(peak: PeakSlip) -> dict[str, Any]:
    return {
        "rail": peak.rail.value,
        "speed_kmh": peak.speed / KMH,
        "slip": number(peak.slip),
        "slip_stderr": number(peak.slip_stderr),
        "mu": number(peak.coefficient),
        "mu_stderr": number(peak.coefficient_stderr),
        "reference_slip": number(peak.reference),
        "mu_at_reference": number(peak.reference_coefficient),
    }


def _score_json(score: Score) -> dict[str, Any]:
    return {
        "model": score.fit.model.name,
        "parameters": {p.name: p.value for p in score.fit.parameters},
        "mean_abs_error": number(score.mean_abs_error),
        "mean_abs_error_adhesion": number(score.adhesion_error),
        "mean_abs_error_sliding": number(score.sliding_error),
        "aic": number(score.aic),
        "bic": number(score.bic),
        "independent_samples": number(score.independent),
        "notes": list(score.fit.notes),
    }


def _bins_json(curve: Curve) -> list[dict[str, Any]]:
    b = curve.bins
    return [
        {
            "slip_from": float(b.low[i]),
            "slip_to": float(b.high[i]),
            "slip": float(b.slip[i]),
            "count": int(b.count[i]),
            "max": float(b.most[i]),
            "mean": float(b.mean[i]),
            "min": float(b.least[i]),
            "standard_deviation": float(b.deviation[i]),
            "regime": _regime(curve, i),
        }
        for i in range(len(b.slip))
    ]


def _regime(curve: Curve, i: int) -> str:
    return "adhesion" if curve.bins.slip[i] < curve.peak_slip else "sliding"


def _log_json(found: Identification) -> dict[str, Any]:
    curve, survey = found.curve, found.curve.survey
    return {
        "file": curve.name,
        "vehicle": found.vehicle.name,
        "rail": found.setting.rail.value,
        "wheel_load_n": found.setting.wheel_load,
        "initial_speed_kmh": found.setting.initial_speed / KMH,
        "slip_acceleration": found.setting.slip_acceleration,
        "observer": found.options.observer.value,
        "tau_s": curve.time_constant,
        "rows": survey.rows,
        "runs": survey.runs,
        "adhesion_regime_points": curve.adhesion_samples,
        "sliding_regime_points": curve.sliding_samples,
        "data_peak_slip": curve.peak_slip,
        "regripping_rows": survey.regripping,
        "free_rolling": _rolling_json(curve.rolling),
        "steps": [_step_json(step) for step in curve.steps],
        "gaps": survey.gap_count,
        "outliers": curve.outliers,
        "broken_lines": curve.broken_lines,
        "warnings": list(found.warnings),
    }


def _rolling_json(rolling: Rolling | None) -> dict[str, Any] | None:
    if rolling is None:
        return None
    return {
        "slip": number(rolling.slip),
        "slip_stderr": number(rolling.slip_error),
        "brake_torque_nm": number(rolling.torque),
        "brake_torque_stderr_nm": number(rolling.torque_error),
        "speed_kmh": rolling.speed / KMH,
    }


def _step_json(step: ColumnStep) -> dict[str, Any]:
    return {"column": step.label, "step": step.step, "as_mu" if step.is_torque else "as_slip": step.share}


# --- text ----------------------------------------------------------------------------------------------------------


def identification_text(found: Identification) -> str:
    """One log as a report."""
    return render(_log_parts(found))


def campaign_text(found: Campaign) -> str:
    """Several logs as a report: each, then the parameters over the initial speed."""
    parts = [part for each in found.logs for part in (*_log_parts(each), Text())]
    parts.append(heading("Parameters over the initial speed v0 in km/h"))
    parts += [Text(f"Note: {text}") for text in found.warnings]
    rows = [
        (p.name, _unit(p.name, found.logs[0].chosen.fit), *(_pair(c, e) for c, e in zip(*_padded(p), strict=True)))
        for p in found.polynomials
    ]
    columns = ("Parameter", "Unit", *(("constant", "v0", "v0^2")[: max(len(row) for row in rows) - 2]))
    parts.append(table(columns, rows))
    parts += [
        Text(
            f"Note: {p.name}: the polynomial passes the logs' values by more than their errors allow; errors as large "
            f"come about with probability {p.misfit_probability:.1g}"
        )
        for p in found.polynomials
        if p.misfit_probability < _IMPROBABLE
    ]
    parts += [heading("Mean absolute error of mu, by model and initial speed in km/h", "-")]
    return render([*parts, _error_table(found)])


def _error_table(found: Campaign) -> RenderableType:
    """As [Park2008] Table 3."""
    errors = [{score.fit.model.name: score.mean_abs_error for score in each.scores} for each in found.logs]
    names = [name for name in errors[0] if all(name in each for each in errors)]
    speeds = (f"{each.setting.initial_speed / KMH:.4g}" for each in found.logs)
    return table(("Model", *speeds), [(name, *(f"{each[name]:.4f}" for each in errors)) for name in names])


def _padded(p: ParameterPolynomial) -> tuple[list[float], list[float]]:
    return list(p.coefficients), list(p.stderrs)


def _pair(value: float, stderr: float) -> str:
    return f"{fixed(value)} ± {fixed(stderr, 2)}" if math.isfinite(stderr) else fixed(value)


def _log_parts(found: Identification) -> list[RenderableType]:
    fit = found.chosen.fit
    parts: list[RenderableType] = [
        heading(f"Identification: {found.curve.name}"),
        facts(_log_facts(found)),
        Text(),
        heading(f"Model: {fit.law.title} ({fit.model.name})", "-"),
        _parameter_table(fit),
    ]
    parts += [Text(f"Note: {note}") for note in fit.notes]
    parts += [_correlation(fit), heading("Models compared, the best first", "-"), _score_table(found.scores)]
    parts.append(Text(f"{_weight(found.scores)}\n"))
    parts += [Text(f"Not fitted: {reason}") for reason in found.not_fitted]
    parts += [heading("Adhesion coefficient over slip", "-"), _bin_table(found.curve)]
    parts += [heading("Peak and reference slip", "-"), _peak_table(found.peaks), Text(_verdict(found))]
    return parts


def _log_facts(found: Identification) -> list[tuple[str, str]]:
    curve, survey, setting = found.curve, found.curve.survey, found.setting
    regrips = f"; {survey.regripping} more of a wheel that regrips are left out" if survey.regripping else ""
    ramp = "none" if setting.slip_acceleration is None else f"{setting.slip_acceleration:.4g} m/s^2"
    return [
        ("Vehicle", f"{found.vehicle.name}, wheel load {setting.wheel_load:g} N, {setting.rail} rail"),
        ("Initial speed", f"{setting.initial_speed / KMH:.4g} km/h; slip ramps {ramp}"),
        ("Observer", f"{found.options.observer}, tau {curve.time_constant:.4g} s"),
        ("Rows", f"{survey.rows}, of which {survey.used} under brake in {counted(survey.runs, 'run')}{regrips}"),
        *(("Resolution", str(step)) for step in curve.steps if step.matters),
        (
            "Regimes",
            f"adhesion {curve.adhesion_samples}, sliding {curve.sliding_samples}; "
            f"the data's peak is at slip {curve.peak_slip:.4g}",
        ),
    ]


def _parameter_table(fit: Fit) -> RenderableType:
    rows = [
        (p.name, _unit(p.name, fit), fixed(p.value, 6), fixed(p.stderr, 3), *(fixed(x) for x in p.interval), p.status)
        for p in fit.parameters
    ]
    for name, value in fit.model.known.items():
        if isinstance(value, float):
            rows.append((name, _unit(name, fit), fixed(value, 6), "-", "-", "-", "known"))
    return table(("Parameter", "Unit", "Value", "Std. error", "99 % from", "to", "Status"), rows, left=2)


def _correlation(fit: Fit) -> RenderableType:
    names = fit.model.names
    pairs = [
        f"{names[i]}, {names[j]} {fit.correlation[i, j]:+.3f}"
        for i in range(len(names))
        for j in range(i)
        if math.isfinite(fit.correlation[i, j]) and len(names) <= 6
    ]
    return Text(f"Correlation: {'; '.join(pairs)}\n" if pairs else "")


def _score_table(scores: tuple[Score, ...]) -> RenderableType:
    rows = [
        (
            score.fit.model.name,
            str(len(score.fit.parameters)),
            *(fixed(x, 3) for x in (score.mean_abs_error, score.adhesion_error, score.sliding_error)),
            f"{score.aic:.1f}",
            f"{score.bic:.1f}",
        )
        for score in scores
    ]
    return table(("Model", "Parameters", "Mean |error|", "adhesion", "sliding", "AIC", "BIC"), rows)


def _weight(scores: tuple[Score, ...]) -> str:
    text = f"AIC and BIC are of {scores[0].independent:.3g} independent samples"
    return f"{text}, too few for them to weigh these models: compare the errors" if few_for(scores) else text


def _bin_table(curve: Curve) -> RenderableType:
    b = curve.bins
    rows = [
        (
            f"{b.low[i]:.2f} to {b.high[i]:.2f}",
            _regime(curve, i),
            str(b.count[i]),
            *(f"{x[i]:.4f}" for x in (b.most, b.mean, b.least, b.deviation)),
        )
        for i in range(len(b.slip))
    ]
    return table(("Slip", "Regime", "Samples", "Max", "Mean", "Min", "Std. deviation"), rows, left=2)


def _peak_table(peaks: tuple[PeakSlip, ...]) -> RenderableType:
    rows = [
        (
            peak.rail.value,
            f"{peak.speed / KMH:.4g}",
            _pair(peak.slip, peak.slip_stderr),
            _pair(peak.coefficient, peak.coefficient_stderr),
            fixed(peak.reference, 4),
            fixed(peak.reference_coefficient, 4),
        )
        for peak in peaks
    ]
    return table(("Rail", "Speed, km/h", "Peak slip", "Peak mu", "Reference slip", "mu there"), rows)


def _verdict(found: Identification) -> str:
    if found.reference is None:
        return f"Reference: none; {_no_reference(found)}"
    held = f"{found.reference.wet:.4g} (wet)"
    if found.setting.rail.value == "dry":
        by_rule = "not from this log but from the dry law by the model's own rule"
        held = f"{found.reference.dry:.4g} (dry), {found.reference.wet:.4g} (wet, {by_rule})"
    return f"Reference: hold slip {held}{_doubt(found)}"


def _own_peak(found: Identification) -> PeakSlip:
    """At the initial speed, on the log's own rail."""
    return [each for each in found.peaks if each.rail is found.setting.rail][-1]


def _doubt(found: Identification) -> str:
    """What the uncertainty of the peak leaves open."""
    peak = _own_peak(found)
    low = peak.slip - NORMAL_QUANTILE * peak.slip_stderr
    if peak.reference <= low * (1.0 + 1e-9):
        return ""
    known = f"only from slip {max(low, 0.0):.3g} up" if math.isfinite(low) else "without an interval"
    return (
        f"; the peak is known {known} (99 %), so that what is held, {100 * LARGEST_LOSS:.0f} % below the highest mu, "
        "may lie beyond it: a log with more slip about the peak tells it better"
    )


def _no_reference(found: Identification) -> str:
    peak, seen = _own_peak(found), float(found.curve.cells.slip.max())
    if peak.slip > seen:
        return (
            f"the slip of this log goes up to {seen:.3g}, and the model's peak lies beyond; give a log that goes past "
            "the peak"
        )
    return "this model falls from the start, or nearly so; take the slip to hold from another model"


# --- the model's file ----------------------------------------------------------------------------------------------


def model_toml(found: Identification) -> str:
    """The chosen law for `--adhesion FILE`."""
    fit, curve = found.chosen.fit, found.curve
    comments = [
        f"Identified by railslip_ctrl {__version__} from {curve.name}, {curve.survey.used} samples.",
        f"Initial speed {found.setting.initial_speed / KMH:.4g} km/h, wheel load {found.setting.wheel_load:g} N.",
        f"Mean absolute error of mu {found.chosen.mean_abs_error:.3g}.",
        *(f"{p.name}: standard error {p.stderr:.3g}" for p in fit.parameters if math.isfinite(p.stderr)),
        *fit.notes,
    ]
    return law_toml(
        fit.law,
        reference=found.reference,
        wheel_load=found.setting.wheel_load,
        speeds_kmh=_initial_speeds(found),
        comments=comments,
    )


def _initial_speeds(found: Identification) -> tuple[float, float]:
    """The lowest and the highest v0 that the log stands for, km/h: of one that begins at many speeds all of them."""
    v0, survey = found.setting.initial_speed, found.curve.survey
    lowest = min(survey.slowest_start, v0) if survey.is_mixed else v0
    return round(lowest / KMH, 1), round(v0 / KMH, 1)


def campaign_toml(found: Campaign) -> str | None:
    """The law over the initial speed for `--adhesion FILE --initial-speed KMH`; None for tables, whose knots differ."""
    fits, speeds = [each.chosen.fit for each in found.logs], [each.setting.initial_speed for each in found.logs]
    if fits[0].model.name == "table":
        return None
    comments = [
        f"Identified by railslip_ctrl {__version__} from {len(fits)} logs; parameters over the initial speed.",
        "For --adhesion with --initial-speed. The slips to hold are those of the logs, at their speeds.",
        *found.warnings,
    ]
    coefficients = {p.name: p.coefficients for p in found.polynomials} | of_known(speeds, fits)
    limits = (float(round(min(speeds) / KMH)), float(round(max(speeds) / KMH)))
    return polynomials_toml(
        fits[0].law,
        {name: values.tolist() for name, values in coefficients.items()},
        limits,
        references=_references(found),
        wheel_load=sum(each.setting.wheel_load for each in found.logs) / len(fits),
        comments=comments,
    )


def _references(found: Campaign) -> dict[float, ReferenceSlip]:
    """The slips to hold by v0 in km/h, of logs at one speed the lowest; none unless every log has them."""
    held: dict[float, ReferenceSlip] = {}
    for each in found.logs:
        if each.reference is None:
            return {}
        v0 = float(round(each.setting.initial_speed / KMH, 1))
        other = held.get(v0, each.reference)
        held[v0] = ReferenceSlip(dry=min(each.reference.dry, other.dry), wet=min(each.reference.wet, other.wet))
    return held
