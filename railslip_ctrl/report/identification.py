"""Results of `railslip identify`: report as text and JSON, adhesion law as TOML, and observed adhesion as CSV."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl import __version__
from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import staged
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.fits import Fit
from railslip_ctrl.identification.identify import Identification, LogSeries
from railslip_ctrl.identification.log_checks import Rolling
from railslip_ctrl.identification.observed import Observed
from railslip_ctrl.identification.results import (
    ParameterPolynomial,
    PeakSlip,
    Regimes,
    Score,
    criteria_note,
    known_polynomials,
)
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.vehicle import Rail

from .document import Facts, Table, counted, fixed, heading, render
from .export import exported, number, plain


def identification_text(result: Identification) -> str:
    """Return the report on one log as text."""
    return render(_log_parts(result))


def series_text(result: LogSeries) -> str:
    """Return the report on several logs as text: each log, and the parameters as polynomials in initial speed."""
    parts = [part for each in result.logs for part in (*_log_parts(each), Text())]
    parts.append(heading("Parameters over the initial speed v0 in km/h"))
    parts += [Text(f"Warning: {text}") for text in result.warnings]
    rows = [
        (p.name, result.logs[0].chosen.fit.model.unit(p.name), *map(_pair, p.coefficients, p.stderrs))
        for p in result.polynomials
    ]
    columns = ("Parameter", "Unit", *(("constant", "v0", "v0^2")[: max(len(row) for row in rows) - 2]))
    parts.append(Table(columns, rows))
    parts += [Text(f"Note: {p.misses}") for p in result.polynomials if p.misses]
    parts += [heading("Mean absolute error of mu, by model and initial speed in km/h", "-")]
    return render([*parts, _error_table(result)])


def _error_table(result: LogSeries) -> RenderableType:
    errors = [{score.fit.model.name: score.mean_abs_error for score in each.scores} for each in result.logs]
    names = [name for name in errors[0] if all(name in each for each in errors)]
    speeds = (f"{each.setting.initial_speed / KMH:.4g}" for each in result.logs)
    return Table(("Model", *speeds), [(name, *(f"{each[name]:.4f}" for each in errors)) for name in names])


def _pair(value: float, stderr: float) -> str:
    return f"{fixed(value)} ± {fixed(stderr, 2)}" if math.isfinite(stderr) else fixed(value)


def _range(value: float, interval: tuple[float, float], digits: int) -> str:
    text, low, high = (fixed(x, digits) for x in (value, *interval))
    if not math.isfinite(interval[0]):
        return text
    return f"{text} [{low}, {high}]" if math.isfinite(interval[1]) else f"{text} (from {low})"


def _log_parts(result: Identification) -> list[RenderableType]:
    fit = result.chosen.fit
    parts: list[RenderableType] = [
        heading(f"Identification: {result.curve.name}"),
        Facts(_log_facts(result)),
        *(Text(f"Warning: {warning}") for warning in result.warnings),
        *(Text(f"Note: {note}") for note in result.curve.notes),
        Text(),
        heading(f"Model: {fit.law.title} ({fit.model.name})", "-"),
        _parameter_table(fit),
    ]
    parts += [Text(f"Warning: {warning}") for warning in result.fit_warnings]
    parts += [Text(f"Note: {note}") for note in fit.notes]
    parts += [_correlation(fit), heading("Models compared, the best first", "-"), _score_table(result)]
    samples = f"{result.scores[0].independent:.3g} independent samples"
    weight = f"AIC and BIC are based on {samples}, and are only for comparing these models with each other"
    parts.append(Text(f"{criteria_note(result.scores) or weight}\n"))
    parts += [Text(f"Not fitted: {reason}") for reason in result.not_fitted]
    parts += [heading("Adhesion coefficient over slip", "-"), _bin_table(result)]
    parts += [heading("Peak and reference slip", "-"), _peak_table(result.peaks)]
    parts += [Text(f"Note: {note}") for note in result.peak_notes]
    return [*parts, Text(_verdict(result))]


def _load_of(result: Identification) -> str:
    own = result.vehicle.wheel_load
    same = math.isclose(result.setting.wheel_load, own, rel_tol=1e-6)
    return "" if same else f" (in the log; the vehicle has {own:g} N)"


def _log_facts(result: Identification) -> list[tuple[str, str]]:
    curve, survey, setting = result.curve, result.curve.survey, result.setting
    regrips = f"; {survey.readhesion} more are left out, because the wheel regrips" if survey.readhesion else ""
    adhesion, sliding = curve.split_counts(result.regimes.boundary)
    vehicle = f"{result.vehicle.name}, wheel load {setting.wheel_load:g} N{_load_of(result)}, {setting.rail} rail"
    ramp = "none" if setting.slip_acceleration is None else f"{setting.slip_acceleration:.4g} m/s^2"
    return [
        (
            "Vehicle",
            vehicle,
        ),
        ("Initial speed", f"{setting.initial_speed / KMH:.4g} km/h; slip ramps {ramp}"),
        ("Observer", f"{result.options.observer}, tau {curve.time_constant:.4g} s"),
        ("Rows", f"{survey.rows}, of which {survey.used} under brake in {counted(survey.runs, 'run')}{regrips}"),
        *((("Rows followed", curve.followed_note),) if curve.followed_note else ()),
        *(("Resolution", str(step)) for step in curve.steps if step.matters),
        (
            "Regimes",
            f"{adhesion} rows in adhesion, {sliding} in sliding; the boundary, slip {result.regimes.boundary:.4g}, is "
            f"{result.regimes.source}",
        ),
    ]


def _parameter_table(fit: Fit) -> RenderableType:
    rows = []
    for p in fit.parameters:
        numbers = (fixed(p.value, 6), fixed(p.stderr, 3), *(fixed(x) for x in p.interval))
        rows.append((p.name, fit.model.unit(p.name), *numbers, p.status))
    for name, value in fit.model.known.items():
        if isinstance(value, float):
            rows.append((name, fit.model.unit(name), fixed(value, 6), "-", "-", "-", "known"))
    return Table(("Parameter", "Unit", "Value", "Std. error", "99 % from", "to", "Status"), rows, left=2)


def _correlation(fit: Fit) -> RenderableType:
    names = fit.model.names
    pairs = [
        f"{names[i]}, {names[j]} {fit.correlation[i, j]:+.3f}"
        for i in range(len(names))
        for j in range(i)
        if math.isfinite(fit.correlation[i, j]) and len(names) <= 6
    ]
    return Text(f"Correlation: {'; '.join(pairs)}\n" if pairs else "")


def _score_table(result: Identification) -> RenderableType:
    rows = []
    for score in result.scores:
        errors = (fixed(x, 3) for x in (score.mean_abs_error, *result.regimes.errors(score)))
        name, count = score.fit.model.name, str(len(score.fit.parameters))
        rows.append((name, count, *errors, f"{score.aic:.1f}", f"{score.bic:.1f}"))
    return Table(("Model", "Parameters", "Mean |error|", "in adhesion", "in sliding", "AIC", "BIC"), rows)


def _bin_table(result: Identification) -> RenderableType:
    b, regimes = result.curve.bins, result.regimes.of(result.curve.bins.slip)
    rows = []
    for i in range(len(b.slip)):
        numbers = (f"{x[i]:.4f}" for x in (b.most, b.mean, b.least, b.deviation))
        rows.append((f"{b.low[i]:.2f} to {b.high[i]:.2f}", str(regimes[i]), str(b.count[i]), *numbers))
    return Table(("Slip", "Regime", "Samples", "Max", "Mean", "Min", "Std. deviation"), rows, left=2)


def _peak_table(peaks: tuple[PeakSlip, ...]) -> RenderableType:
    rows = []
    for peak in peaks:
        result = (_range(peak.slip, peak.slip_interval, 3), _range(peak.coefficient, peak.coefficient_interval, 4))
        held = (fixed(peak.reference, 4), fixed(peak.reference_coefficient, 4))
        rows.append((peak.rail.value, peak.basis, f"{peak.speed / KMH:.4g}", *result, *held))
    return Table(
        ("Rail", "Source", "km/h", "Peak slip (95 %)", "Peak mu (95 %)", "Reference", "mu there"),
        rows,
        left=2,
    )


def _verdict(result: Identification) -> str:
    if result.reference is None:
        return f"Reference slip: none; {result.no_reference}"
    held = f"{result.reference.wet:.4g} (wet)"
    if result.setting.rail.value == "dry":
        by_rule = "computed from the dry law by the rule of the model, not from this log"
        held = f"{result.reference.dry:.4g} (dry), {result.reference.wet:.4g} (wet, {by_rule})"
    return f"Reference slip: {held}{_peak_warning(result)}"


def _peak_warning(result: Identification) -> str:
    peak = result.own_peak
    low = peak.lowest_slip
    if peak.reference <= low * (1.0 + 1e-9):
        return ""
    lost = 100 * (1 - peak.reference_coefficient / peak.coefficient)
    known = f"has a 99 % interval from {max(low, 0.0):.3g}" if math.isfinite(low) else "has no 99 % interval"
    return (
        f"; the peak slip {known}; the reference slip, with mu {lost:.0f} % below the highest, may be beyond the peak; "
        "record a log with more samples near the peak"
    )


@checked
def model_toml(found: Identification) -> str:
    """Return the adhesion law that was chosen for a log as TOML text; option `--adhesion FILE` reads it.

    `found` is the result of `identify`. Parameters are in SI, speeds in km/h.
    """
    fit, curve, load = found.chosen.fit, found.curve, found.setting.wheel_load
    lowest, highest = (round(speed / KMH, 1) for speed in found.speeds_shown)
    comments = [
        f"Identified by railslip_ctrl {__version__} from {curve.name}, {curve.survey.used} samples.",
        f"Initial speed {found.setting.initial_speed / KMH:.4g} km/h, wheel load {load:g} N.",
        f"Mean absolute error of mu {found.chosen.mean_abs_error:.3g}.",
        *(f"{p.name}: standard error {p.stderr:.3g}" for p in fit.parameters if math.isfinite(p.stderr)),
        *(f"Warning: {warning}" for warning in (*found.warnings, *found.fit_warnings)),
        *fit.notes,
        *curve.notes,
        *found.peak_notes,
    ]
    speeds = lowest, highest
    return law_toml(fit.law, reference=found.reference, wheel_load=load, speeds_kmh=speeds, comments=comments)


def series_toml(result: LogSeries) -> str | None:
    """Return the adhesion law of several logs as TOML text; its parameters are polynomials in initial speed.

    None for a law given as a table, because its slips differ between the logs.
    """
    fits, speeds = [each.chosen.fit for each in result.logs], [each.setting.initial_speed for each in result.logs]
    if fits[0].model.name == "table":
        return None
    comments = [
        f"Identified by railslip_ctrl {__version__} from {len(fits)} logs; parameters over the initial speed.",
        "Use with --adhesion and --initial-speed. The reference slips come from the logs at their initial speeds.",
        *(text for p in result.polynomials for text in _errors_of(p)),
        *(f"Warning: {warning}" for each in result.logs for warning in (*each.warnings, *each.fit_warnings)),
        *(f"Warning: {warning}" for warning in result.warnings),
        *(f"{each.curve.name}: {note}" for each in result.logs for note in each.curve.notes),
    ]
    coefficients = {p.name: p.coefficients for p in result.polynomials} | known_polynomials(speeds, fits)
    limits = (float(round(min(speeds) / KMH)), float(round(max(speeds) / KMH)))
    numbers = {name: values.tolist() for name, values in coefficients.items()}
    held, load = _references(result), sum(each.setting.wheel_load for each in result.logs) / len(fits)
    return polynomials_toml(fits[0].law, numbers, limits, references=held, wheel_load=load, comments=comments)


def _errors_of(p: ParameterPolynomial) -> tuple[str, ...]:
    if not all(math.isfinite(x) for x in p.stderrs):
        return (f"{p.name}: standard errors unknown, because the fit of a log has none",)
    values = (f"{p.stderr_at(speed):.3g} at {speed:.4g} km/h" for speed in sorted({*p.speeds_kmh.tolist()}))
    errors = ", ".join(f"{x:.3g}" for x in p.stderrs)
    text = f"{p.name}: standard errors of the coefficients {errors}; of the value {', '.join(values)}"
    return (text, p.misses) if p.misses else (text,)


def _references(result: LogSeries) -> dict[float, ReferenceSlip]:
    slips: dict[float, ReferenceSlip] = {}
    for each in result.logs:
        if each.reference is None:
            return {}
        v0 = float(round(each.setting.initial_speed / KMH, 1))
        other = slips.get(v0, each.reference)
        slips[v0] = ReferenceSlip(dry=min(each.reference.dry, other.dry), wet=min(each.reference.wet, other.wet))
    return slips


def law_toml(
    law: AdhesionLaw,
    *,
    reference: ReferenceSlip | None,
    wheel_load: float,
    speeds_kmh: tuple[float, float] | None = None,
    comments: Iterable[str] = (),
) -> str:
    """Return an adhesion law as TOML text, with all digits of the numbers.

    - reference: reference slip ratios; None if there are none.
    - wheel_load, speeds_kmh: wheel load, N, and lowest and highest initial speed, km/h, of the log.
    - comments: comment lines at the beginning of the file.
    """
    lines = [*_head(law, wheel_load, speeds_kmh, comments), "", "[parameters]"]
    for name in law.parameter_names():
        unit = law.units().get(name, "1")
        meaning = f"{'' if unit == '1' else f'{unit}, '}{type(law).model_fields[name].description}"
        lines.append(f"{name} = {_number(getattr(law, name))}  # {meaning}")
    if reference is not None:
        slips = (f"{name} = {getattr(reference, name)!r}" for name in _rails_of(law, (reference,)))
        lines += ["", "[reference_slip]", *slips]
    return "\n".join(lines) + "\n"


def _rails_of(law: AdhesionLaw, references: Iterable[ReferenceSlip]) -> tuple[str, ...]:
    wet_alone = law.rail is Rail.WET and all(each.dry == each.wet for each in references)
    return (Rail.WET.value,) if wet_alone else tuple(ReferenceSlip.model_fields)


def _head(
    law: AdhesionLaw, wheel_load: float, speeds_kmh: tuple[float, float] | None, comments: Iterable[str]
) -> list[str]:
    lines = [*(f"# {' '.join(comment.split())}" for comment in comments)]
    lines += [f'law = "{law.name}"', f'condition = "{law.rail.value}"']
    if speeds_kmh is not None:
        lines.append(f"initial_speed_range = {_number(speeds_kmh)}  # km/h, range of v0 of the parameters")
    return [*lines, f"wheel_load = {wheel_load!r}  # N, in the log; force parameters are valid for this load"]


def polynomials_toml(
    law: AdhesionLaw,
    coefficients: Mapping[str, Sequence[float]],
    speeds_kmh: tuple[float, float],
    *,
    references: Mapping[float, ReferenceSlip],
    wheel_load: float,
    comments: Iterable[str] = (),
) -> str:
    """Return an adhesion law as TOML text whose parameters are polynomials in the initial speed v0, km/h.

    - law: adhesion law; only its name and its rail condition are used.
    - coefficients: for each parameter name, the coefficients of 1, v0, v0^2; values of the polynomial are in SI.
    - references: reference slip ratios for each v0, km/h; may be empty.
    - speeds_kmh, wheel_load, comments: as in `law_toml`.
    """
    lines = _head(law, wheel_load, speeds_kmh, comments)
    lines += ["", "[polynomials]  # in the initial speed v0, km/h: constant, factor of v0, factor of v0^2"]
    lines += [f"{name} = {_number(tuple(coefficients[name]))}" for name in law.parameter_names()]
    if references:
        speeds = tuple(sorted(references))
        lines += ["", "[reference_slip]  # at these initial speeds, km/h; linear between them"]
        lines.append(f"initial_speed = {_number(speeds)}")
        for name in _rails_of(law, references.values()):
            lines.append(f"{name} = {_number(tuple(getattr(references[speed], name) for speed in speeds))}")
    return "\n".join(lines) + "\n"


def _number(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_number(each) for each in value) + "]"
    assert math.isfinite(value), "records accept only finite numbers"
    return repr(float(value))


def identification_json(result: Identification) -> dict[str, Any]:
    """Return the result of one log as JSON: chosen model, all models, adhesion curve, peaks, and the log."""
    fit, curve = result.chosen.fit, result.curve
    return {
        **_errors_json(result.chosen, result.regimes),
        "parameters": {
            p.name: {**exported(p, "value", "stderr", "status", interval_99="interval"), "unit": fit.model.unit(p.name)}
            for p in fit.parameters
        },
        "points": curve.survey.used,
        **exported(fit, "correlation", known="model.known"),
        "notes": [*fit.notes, *curve.notes, *result.peak_notes],
        **exported(result, "not_fitted", reference_slip="reference", reference_slip_reason="no_reference"),
        "peaks": [_peak_json(peak) for peak in result.peaks],
        "models": [
            {
                **_errors_json(score, result.regimes),
                **exported(score, "aic", "bic", independent_samples="independent", notes="fit.notes"),
                "parameters": {p.name: p.value for p in score.fit.parameters},
            }
            for score in result.scores
        ],
        "models_note": criteria_note(result.scores) or None,
        "curve": _bins_json(result),
        "log": _log_json(result),
    }


def series_json(result: LogSeries) -> dict[str, Any]:
    """Return the result of several logs as JSON; the `value` of a parameter is for the mean initial speed."""
    first = result.logs[0].chosen.fit
    return {
        "model": first.model.name,
        "parameters": {p.name: _polynomial_json(p, first) for p in result.polynomials},
        "mean_abs_error": sum(each.chosen.mean_abs_error for each in result.logs) / len(result.logs),
        "points": sum(each.curve.survey.used for each in result.logs),
        "warnings": list(result.warnings),
        "logs": [identification_json(each) for each in result.logs],
    }


def _errors_json(score: Score, regimes: Regimes) -> dict[str, Any]:
    adhesion, sliding = regimes.errors(score)
    return {
        **exported(score, "mean_abs_error", model="fit.model.name"),
        "mean_abs_error_adhesion": number(adhesion),
        "mean_abs_error_sliding": number(sliding),
    }


def _polynomial_json(p: ParameterPolynomial, fit: Fit) -> dict[str, Any]:
    mean = float(p.speeds_kmh.mean())
    return {
        "value": p.at(mean),
        "stderr": number(p.stderr_at(mean)),
        "at_initial_speed_kmh": mean,
        "unit": fit.model.unit(p.name),
        "of": "initial speed in km/h",
        **exported(p, "coefficients", "stderrs", "covariance", "values", "misfit_probability"),
        "initial_speeds_kmh": plain(p.speeds_kmh),
    }


def _peak_json(peak: PeakSlip) -> dict[str, Any]:
    return {
        "from": "rule" if peak.by_rule else "log",
        "speed_kmh": peak.speed / KMH,
        **exported(peak, "rail", "extrapolated", "slip", "slip_stderr", slip_interval_95="slip_interval"),
        **exported(peak, mu="coefficient", mu_stderr="coefficient_stderr", mu_interval_95="coefficient_interval"),
        **exported(peak, reference_slip="reference", mu_at_reference="reference_coefficient"),
    }


def _bins_json(result: Identification) -> list[dict[str, Any]]:
    bins = result.curve.bins
    columns = exported(bins, "slip", "count", "mean", slip_from="low", slip_to="high", max="most", min="least")
    columns |= {"standard_deviation": plain(bins.deviation), "regime": result.regimes.of(bins.slip).tolist()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _log_json(result: Identification) -> dict[str, Any]:
    curve = result.curve
    adhesion, sliding = curve.split_counts(result.regimes.boundary)
    named = {"gaps": "gap_count", "regripping_rows": "readhesion"}
    rolling = curve.rolling
    return {
        **exported(curve, "outliers", "broken_lines", "deceleration_ratio", file="name", tau_s="time_constant"),
        **exported(curve.survey, "rows", "runs", **named),
        **exported(result.setting, "rail", "slip_acceleration", wheel_load_n="wheel_load"),
        **exported(result.regimes, sliding_from_slip="boundary", sliding_from="source"),
        "vehicle": result.vehicle.name,
        "initial_speed_kmh": result.setting.initial_speed / KMH,
        "observer": result.options.observer.value,
        "rows_followed": len(curve.record),
        "rows_followed_note": curve.followed_note or None,
        "adhesion_regime_points": adhesion,
        "sliding_regime_points": sliding,
        "data_peak_slip": curve.peak_slip,
        "free_rolling": None if rolling is None else _rolling_json(rolling),
        "steps": [
            {"column": step.label, "step": step.step, "as_mu" if step.is_torque else "as_slip": step.share}
            for step in curve.steps
        ],
        "warnings": [*result.warnings, *result.fit_warnings],
    }


def _rolling_json(rolling: Rolling) -> dict[str, Any]:
    names = {"slip_stderr": "slip_error", "brake_torque_nm": "torque", "brake_torque_stderr_nm": "torque_error"}
    return {**exported(rolling, "slip", **names), "speed_kmh": rolling.speed / KMH}


COLUMNS = (
    *("time [s]", "filtered train speed [km/h]", "filtered slip [1]", "filtered wheel load [N]"),
    *("adhesion torque [N*m]", "mu [1]", "regime"),
)
"""Header of the CSV file; all columns are filtered like the observed torque, so that they have the same delay."""

_SLIP = COLUMNS.index("filtered slip [1]")
_NUMBERS = len(COLUMNS) - 1
_BLOCK = 1 << 16  # number of rows in memory at a time


class ObservedRows:
    """Writes the observed adhesion of a log as CSV, with the regime (adhesion or sliding) of each row.

    The regimes are known only at the end of the log. Until then the rows are stored in a temporary file.
    """

    def __init__(self, path: Path, radius: float, rows: IO[bytes]) -> None:
        self._path, self._radius, self._rows = path, radius, rows

    def __call__(self, samples: Observed) -> None:
        """Store samples; each call must pass later samples than the call before."""
        torque = samples.mu * self._radius * samples.load
        columns = (samples.time, samples.speed / KMH, samples.slip, samples.load, torque, samples.mu)
        self._rows.write(np.column_stack(columns).tobytes())

    def finish(self, regimes: Regimes) -> None:
        """Write the CSV file."""
        import pandas as pd

        self._rows.seek(0)
        with self._path.open("w", encoding="utf-8") as file:
            file.write(",".join(COLUMNS) + "\n")
            while content := self._rows.read(8 * _BLOCK * _NUMBERS):
                block = np.frombuffer(content).reshape(-1, _NUMBERS)
                table = pd.DataFrame(block).assign(regime=regimes.of(block[:, _SLIP]))
                table.to_csv(file, float_format="%.10g", header=False, index=False)


@contextmanager
def observed_rows(path: Path | None, radius: float) -> Iterator[ObservedRows | None]:
    """Yield `ObservedRows` for the CSV file `path`, or None without a path; `radius` is the wheel radius, m.

    InputError: the file cannot be written.
    """
    if path is None:
        yield None
        return
    try:
        with tempfile.TemporaryFile(dir=path.parent) as rows, staged(path.parent) as new:
            yield ObservedRows(new / path.name, radius, rows)
    except OSError as error:
        raise InputError(
            f"--observed: {str(path)!r} cannot be written ({error.strerror or error}); give another file"
        ) from None
