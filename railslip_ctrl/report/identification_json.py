"""What `railslip identify` found, as JSON."""

from __future__ import annotations

from typing import Any

from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.fits import Fit, Parameter
from railslip_ctrl.identification.identify import Campaign, Identification
from railslip_ctrl.identification.log_checks import ColumnStep, Rolling, TrainLag
from railslip_ctrl.identification.results import ParameterPolynomial, PeakSlip, Regimes, Score, too_few

from .jsonable import number


def identification_json(found: Identification) -> dict[str, Any]:
    """One log: the model chosen first, then the comparison, the curve, the peaks and the log."""
    fit, curve = found.chosen.fit, found.curve
    adhesion, sliding = found.regimes.errors(found.chosen)
    return {
        "model": fit.model.name,
        "parameters": {p.name: _parameter_json(p, fit) for p in fit.parameters},
        "mean_abs_error": number(found.chosen.mean_abs_error),
        "points": curve.survey.used,
        "mean_abs_error_adhesion": number(adhesion),
        "mean_abs_error_sliding": number(sliding),
        "known": {name: _plain(value) for name, value in fit.model.known.items()},
        "correlation": [[number(x) for x in row] for row in fit.correlation],
        "notes": [*fit.notes, *curve.notes, *found.peak_notes],
        "reference_slip": None if found.reference is None else found.reference.model_dump(),
        "reference_slip_reason": found.no_reference,
        "peaks": [_peak_json(peak) for peak in found.peaks],
        "models": [_score_json(score, found.regimes) for score in found.scores],
        "models_note": too_few(found.scores) or None,
        "not_fitted": list(found.not_fitted),
        "curve": _bins_json(found),
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


def _parameter_json(p: Parameter, fit: Fit) -> dict[str, Any]:
    return {
        "value": p.value,
        "stderr": number(p.stderr),
        "unit": fit.model.unit(p.name),
        "interval_99": [number(x) for x in p.interval],
        "status": p.status,
    }


def _polynomial_json(p: ParameterPolynomial, fit: Fit) -> dict[str, Any]:
    mean = float(p.speeds_kmh.mean())
    return {
        "value": p.at(mean),
        "stderr": number(p.stderr_at(mean)),
        "at_initial_speed_kmh": mean,
        "unit": fit.model.unit(p.name),
        "of": "initial speed in km/h",
        "coefficients": [float(x) for x in p.coefficients],
        "stderrs": [number(float(x)) for x in p.stderrs],
        "covariance": [[number(float(x)) for x in row] for row in p.covariance],
        "initial_speeds_kmh": [float(x) for x in p.speeds_kmh],
        "values": [float(x) for x in p.values],
        "misfit_probability": number(p.misfit_probability),
    }


def _peak_json(peak: PeakSlip) -> dict[str, Any]:
    return {
        "rail": peak.rail.value,
        "from": "rule" if peak.by_rule else "log",
        "extrapolated": peak.extrapolated,
        "speed_kmh": peak.speed / KMH,
        "slip": number(peak.slip),
        "slip_stderr": number(peak.slip_stderr),
        "mu": number(peak.coefficient),
        "mu_stderr": number(peak.coefficient_stderr),
        "reference_slip": number(peak.reference),
        "mu_at_reference": number(peak.reference_coefficient),
    }


def _score_json(score: Score, regimes: Regimes) -> dict[str, Any]:
    adhesion, sliding = regimes.errors(score)
    return {
        "model": score.fit.model.name,
        "parameters": {p.name: p.value for p in score.fit.parameters},
        "mean_abs_error": number(score.mean_abs_error),
        "mean_abs_error_adhesion": number(adhesion),
        "mean_abs_error_sliding": number(sliding),
        "aic": number(score.aic),
        "bic": number(score.bic),
        "independent_samples": number(score.independent),
        "notes": list(score.fit.notes),
    }


def _bins_json(found: Identification) -> list[dict[str, Any]]:
    b, regimes = found.curve.bins, found.regimes.of(found.curve.bins.slip)
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
            "regime": str(regimes[i]),
        }
        for i in range(len(b.slip))
    ]


def _log_json(found: Identification) -> dict[str, Any]:
    curve, survey = found.curve, found.curve.survey
    adhesion, sliding = curve.parted_at(found.regimes.boundary)
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
        "rows_followed": len(curve.record),
        "rows_followed_note": curve.followed_note or None,
        "adhesion_regime_points": adhesion,
        "sliding_regime_points": sliding,
        "sliding_from_slip": found.regimes.boundary,
        "sliding_from": found.regimes.source,
        "data_peak_slip": curve.peak_slip,
        "deceleration_ratio": number(curve.deceleration_ratio),
        "regripping_rows": survey.readhesion,
        "free_rolling": _rolling_json(curve.rolling),
        "steps": [_step_json(step) for step in curve.steps],
        "gaps": survey.gap_count,
        "outliers": curve.outliers,
        "broken_lines": curve.broken_lines,
        "train_speed_lag": _train_lag_json(found.train_lag),
        "warnings": [*found.warnings, *found.doubts],
    }


def _train_lag_json(told: TrainLag | None) -> dict[str, Any] | None:
    if told is None:
        return None
    return {
        "lag_s": told.lag,
        "slip_shift": told.slip_shift,
        "peak_slip": told.peak_slip,
        "deceleration": told.deceleration,
        "speed_kmh": told.speed / KMH,
        "note": str(told),
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
