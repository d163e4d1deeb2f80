"""The command `railslip identify`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, shown, to_unit
from railslip_ctrl.identification.curves import Options
from railslip_ctrl.identification.identify import Identification, LogSeries, identify, identify_several
from railslip_ctrl.identification.logs import STANDARD_INPUT, UNITS
from railslip_ctrl.identification.models import MODELS, parameter_unit
from railslip_ctrl.identification.observed import Observer
from railslip_ctrl.model.vehicle import PARK2008, Rail
from railslip_ctrl.model.vehicle_files import load_vehicle
from railslip_ctrl.report.export import FileContent, check_directory, check_file, json_text
from railslip_ctrl.report.identification import (
    identification_json,
    identification_text,
    model_toml,
    observed_rows,
    series_json,
    series_text,
    series_toml,
)
from railslip_ctrl.report.pictures import Drawings, write_results

from .options import from_file, number_option, print_remarks, whole_number
from .output import progress, show
from .settings import HELP, json_option, option, options_named, path_option, preset, switch

_BAR_FROM_BYTES = 8 << 20  # size of logs from which a progress bar is shown, bytes; smaller ones are read quickly
_MOST_SKIPPED = 10_000  # largest --skip-lines; the header must be in a log's first megabyte


@click.command(context_settings=HELP)
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="LOG.csv...")
@preset(
    "--model",
    "|".join(("best", *MODELS)),
    "Model to fit. best: of all but bristle_rest, the formula with the lowest BIC that fits, or table if none fits.",
    "best",
)
@preset("--rail", "dry|wet", "Rail condition of the log.", "dry")
@path_option("--vehicle", "FILE", "Vehicle file.", "the published vehicle")
@switch("--loaded", "Use the wheel load of the loaded vehicle.")
@number_option("--initial-speed", "km/h", "Speed v0 at which the brake was applied, km/h.", "highest in the log", gt=0)
@number_option(
    "--slip-acceleration",
    "m/s^2",
    "Slip acceleration R of the slip ramps, m/s^2, for bristle and curve.",
    "from the log; curve: 2.93",
    gt=0,
)
@number_option(
    "--tau",
    "s",
    "Time constant of the observer, s.",
    "0.05, or five intervals between rows if that is more",
    gt=0,
)
@preset(
    "--observer",
    "|".join(Observer),
    "Observer of the adhesion torque. It affects the observed curve and lugre, bristle_rest and table; it hardly "
    "affects the prediction-error fits (beam, polach, burckhardt, curve, bristle).",
    "corrected",
)
@option(
    "--column",
    "NAME=HEADER",
    f"Header or number (from 1) of the column of a quantity NAME, one of {', '.join(UNITS)}; repeatable.",
    "the quantity's name",
    multiple=True,
)
@option(
    "--unit",
    "NAME=UNIT",
    "Unit of a quantity's column, NAME as in --column; repeatable.",
    "from the header",
    multiple=True,
)
@preset("--skip-lines", "N", "Number of lines to skip at the beginning of each log.", "0")
@option(
    "--delay",
    "NAME=S",
    "Delay of a quantity's column, s; half an interval if a speed is a difference of encoder counts; repeatable.",
    "0",
    multiple=True,
)
@option(
    "--zero", "NAME=VALUE", "Sensor offset of a quantity's column, SI or with a unit; repeatable.", "0", multiple=True
)
@option(
    "--fix",
    "PARAMETER=VALUE",
    "Value of a parameter that is not fitted, SI or with a unit; repeatable.",
    "none",
    multiple=True,
)
@option(
    "--bound",
    "PARAMETER=LOW:HIGH",
    "Bounds of a parameter, SI or with units; repeatable.",
    "those of the model",
    multiple=True,
)
@path_option("--out", "DIR", "Folder for the model's file, reports and pictures.")
@path_option(
    "--observed",
    "FILE",
    "CSV file with one row for each row of the log under brake: observed adhesion torque and coefficient, slip, speed "
    "and load after the observer's filter, and the regime (adhesion below the slip of the chosen model's peak, "
    "sliding above it).",
)
@json_option
def command(
    logs: tuple[Path, ...],
    vehicle: Path | None,
    loaded: bool,
    out: Path | None,
    observed: Path | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Fit adhesion models to a brake-rig log; print the adhesion curve, the models and the reference slip.

    With several logs the parameters are fitted as functions of the initial speed v0.

    LOG.csv has a header with the columns time, train speed, wheel speed or wheel angular speed, brake torque and
    optionally wheel load, each with its unit: "train speed [km/h]", "brake torque [kNm]", "time_ms". The units may
    be in the line below the header, and the header may be in a comment (#). Lines above the header are skipped. The
    file may be gzipped; the name - means standard input. With --adhesion fitted/model.toml the commands linearize,
    margins, tune, simulate, report, derive and verify --law predictive use the fitted model. If the model was fitted
    to several logs, --initial-speed selects v0. Exit status 0, or 2 for bad input.

    Example: railslip identify run.csv --rail wet --out fitted
    """
    options = _options(given)
    if len(logs) > 1 and options.initial_speed is not None:
        raise InputError(f"--initial-speed is only for one log, but there are {len(logs)}; leave --initial-speed out")
    if sum(str(log) == STANDARD_INPUT for log in logs) > 1:
        raise InputError(f"LOG.csv: {STANDARD_INPUT} is given more than once; standard input can be read once")
    if observed is not None:
        if len(logs) > 1:
            raise InputError(f"--observed is only for one log, but there are {len(logs)}; give the logs one by one")
        check_file(observed, "--observed")
        if observed.exists() and any(log.exists() and log.samefile(observed) for log in logs):
            raise InputError(f"--observed: {str(observed)!r} is the log itself; give another file")
    if out is not None:
        check_directory(out, _file_names(len(logs)))
        if observed is not None and observed.resolve() in {out.resolve(), *(out.resolve() / n for n in _file_names(1))}:
            raise InputError(f"--observed: {str(observed)!r} is --out, or a file that --out writes; give another file")
    chosen = PARK2008 if vehicle is None else from_file("--vehicle", vehicle, load_vehicle)
    print_remarks(chosen)
    chosen = chosen.loaded() if loaded else chosen
    with _bar(logs, as_json) as advance, observed_rows(observed, chosen.wheel.radius) as sink:
        result: Identification | LogSeries = (
            identify(logs[0], chosen, options, progress=advance, observed=sink)
            if len(logs) == 1
            else identify_several(logs, chosen, options, progress=advance)
        )
        if sink is not None and isinstance(result, Identification):
            sink.finish(result.regimes)
    _warn(result)
    text = _report(result)
    record = identification_json(result) if isinstance(result, Identification) else series_json(result)
    content = json.loads(options_named(json.dumps(record)))
    try:
        if out is not None:
            files = _files(result, text, content)
            count = write_results(out, files, partial(_drawings, result))
            message = f"wrote {count} files to {out}"
            message += ", the model to model.toml" if "model.toml" in files else ""
            if isinstance(result, LogSeries):
                message += " (select v0 by --initial-speed)" if "model.toml" in files else ""
                message += "; model-1.toml and so on are valid only for the v0 of their log"
            progress(message)
    finally:
        show(as_json, lambda: content, lambda: _report(result))


def _report(result: Identification | LogSeries) -> str:
    return options_named(identification_text(result) if isinstance(result, Identification) else series_text(result))


def _options(given: Mapping[str, Any]) -> Options:
    rail, observer, initial = given["rail"].lower(), given["observer"].lower(), given["initial_speed"]
    if rail not in tuple(Rail):
        raise InputError(f"--rail: {shown(given['rail'])} is not a rail condition; choose dry or wet")
    if observer not in tuple(Observer):
        raise InputError(f"--observer: {shown(given['observer'])} is not known; choose {', '.join(Observer)}")
    return Options(
        model=given["model"].lower().replace("-", "_"),
        rail=Rail(rail),
        initial_speed=None if initial is None else initial * KMH,
        slip_acceleration=given["slip_acceleration"],
        time_constant=given["tau"],
        observer=Observer(observer),
        columns=_pairs("--column", given["column"]),
        units=_pairs("--unit", given["unit"]),
        skip_lines=whole_number("--skip-lines", given["skip_lines"], 0, _MOST_SKIPPED),
        delays={
            name: to_unit(text, "s", name=f"--delay {name}") for name, text in _pairs("--delay", given["delay"]).items()
        },
        zeros={
            name: to_unit(text, UNITS.get(name, "1"), name=f"--zero {name}")
            for name, text in _pairs("--zero", given["zero"]).items()
        },
        fixed={name: _value("--fix", name, text) for name, text in _pairs("--fix", given["fix"]).items()},
        bounds={name: _bounds(name, text) for name, text in _pairs("--bound", given["bound"]).items()},
    )


def _pairs(option: str, texts: tuple[str, ...]) -> dict[str, str]:
    pairs = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not (sign and name.strip() and value.strip()):
            raise InputError(f"{option}: {shown(text)} is not allowed; give NAME=VALUE")
        if name.strip() in pairs:
            raise InputError(f"{option}: {name.strip()} is given twice; give it once")
        pairs[name.strip()] = value.strip()
    return pairs


def _value(option: str, name: str, text: str) -> float:
    return to_unit(text, parameter_unit(name), name=f"{option} {name}")


def _bounds(name: str, text: str) -> tuple[float, float]:
    low, sign, high = text.partition(":")
    if not sign:
        raise InputError(f"--bound {name}: {shown(text)} is not allowed; give LOW:HIGH")
    return _value("--bound", name, low), _value("--bound", name, high)


@contextmanager
def _bar(logs: tuple[Path, ...], as_json: bool) -> Iterator[Callable[[float], None] | None]:
    if sum(path.stat().st_size for path in logs if path.is_file()) < _BAR_FROM_BYTES:
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda share: bar.update(task, completed=share)


def _warn(result: Identification | LogSeries) -> None:
    for each in (result,) if isinstance(result, Identification) else result.logs:
        for note in each.curve.notes:
            progress(options_named(f"note: {each.curve.name}: {note}"))
        for warning in (*each.warnings, *each.fit_warnings):
            progress(options_named(f"warning: {warning}"))
    if isinstance(result, LogSeries):
        for warning in result.warnings:
            progress(options_named(f"warning: {warning}"))


def _model_names(count: int) -> list[str]:
    return ["model.toml"] if count == 1 else [f"model-{i + 1}.toml" for i in range(count)]


def _pictures(count: int) -> tuple[str, ...]:
    return ("adhesion", "peak", "braking") if count == 1 else ("adhesion", "coefficients")


def _file_names(count: int) -> list[str]:
    pictures = [f"{name}.{suffix}" for name in _pictures(count) for suffix in ("png", "svg")]
    several = [] if count == 1 else ["model.toml"]
    return [*several, *_model_names(count), "identification.txt", "identification.json", *pictures]


def _files(result: Identification | LogSeries, text: str, content: Mapping[str, Any]) -> dict[str, FileContent]:
    logs = result.logs if isinstance(result, LogSeries) else (result,)
    named = zip(_model_names(len(logs)), logs, strict=True)
    files: dict[str, FileContent] = {name: options_named(model_toml(each)) for name, each in named}
    files |= {"identification.txt": text, "identification.json": json_text(content)}
    whole = series_toml(result) if isinstance(result, LogSeries) else None
    return files if whole is None else files | {"model.toml": options_named(whole)}


def _drawings(result: Identification | LogSeries) -> Drawings:
    from railslip_ctrl.report import plots

    if isinstance(result, LogSeries):
        logs, others = result.logs, [plots.coefficients_figure(result)]
    else:
        logs, others = (result,), [plots.drift_figure(result), plots.braking_figure(result)]
    return dict(zip(_pictures(len(logs)), [plots.adhesion_figure(logs), *others], strict=True))
