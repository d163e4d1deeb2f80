"""`railslip identify`."""

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

from .options import from_file, number_option, tell_remarks, whole_number
from .output import progress, show
from .settings import HELP, json_option, option, options_named, path_option, preset, switch

_BAR_FROM_BYTES = 8 << 20  # a smaller log is read before a bar can be seen
_MOST_SKIPPED = 10_000  # lines; the header must be in a log's first megabyte


@click.command(context_settings=HELP)
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="LOG.csv...")
@preset(
    "--model",
    "|".join(("best", *MODELS)),
    "Model to fit. best: all but bristle_rest; of those with a formula the one with the lowest BIC.",
    "best",
)
@preset("--rail", "dry|wet", "Rail condition of the log.", "dry")
@path_option("--vehicle", "FILE", "Vehicle.", "the published")
@switch("--loaded", "Use the vehicle's loaded wheel load.")
@number_option("--initial-speed", "km/h", "Speed v0 at which the brake was applied, km/h.", "the log's highest", gt=0)
@number_option(
    "--slip-acceleration",
    "m/s^2",
    "Slip acceleration R of the ramps, m/s^2, for bristle and curve.",
    "the log's; curve: 2.93",
    gt=0,
)
@number_option(
    "--tau", "s", "Time constant of the observer, s.", "0.05, or five intervals of the log if that is more", gt=0
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
    f"Column header, or column number from 1, of a quantity NAME, one of {', '.join(UNITS)}; repeatable.",
    "its name",
    multiple=True,
)
@option(
    "--unit",
    "NAME=UNIT",
    "Unit of the column of a quantity, NAME as of --column; repeatable.",
    "the header's",
    multiple=True,
)
@preset("--skip-lines", "N", "Number of lines to skip at the beginning of each log.", "0")
@option(
    "--delay",
    "NAME=S",
    "Column delay of a quantity, s; for differences of encoder counts half their interval; repeatable.",
    "0",
    multiple=True,
)
@option(
    "--zero", "NAME=VALUE", "Sensor offset of a quantity's column, SI or with a unit; repeatable.", "0", multiple=True
)
@option("--fix", "PARAMETER=VALUE", "Parameter not to be fitted, SI or with a unit; repeatable.", "none", multiple=True)
@option(
    "--bound", "PARAMETER=LOW:HIGH", "Bounds of a parameter, SI or with units; repeatable.", "its own", multiple=True
)
@path_option("--out", "DIR", "Folder for the model's file, reports and pictures.")
@path_option(
    "--observed",
    "FILE",
    "CSV to write: observed adhesion torque and coefficient, slip, speed and load behind the observer's filter, "
    "for each row under brake, with its regime: adhesion below the slip of the chosen model's peak, else sliding.",
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
    """Adhesion-slip curve, fitted models and the slip to hold, from a log. Several logs give the parameters over v0.

    LOG.csv has a header with the columns time, train speed, wheel speed or wheel angular speed, brake torque and
    optionally wheel load, each with its unit: "train speed [km/h]", "brake torque [kNm]", "time_ms". The units may
    stand in the line below, the header in a comment (#). Lines above the header are skipped. The file may be gzipped;
    - is standard input. The model is for --adhesion fitted/model.toml of linearize, margins, tune, simulate, report,
    derive and verify --law predictive. That of several logs is over v0, and is taken at --initial-speed. Exit status
    0, or 2 for bad input.

    Example: railslip identify run.csv --rail wet --out fitted
    """
    options = _options(given)
    if len(logs) > 1 and options.initial_speed is not None:
        raise InputError("--initial-speed: is one speed, but there are several logs; leave it to them")
    if sum(str(log) == STANDARD_INPUT for log in logs) > 1:
        raise InputError(f"LOG.csv: {STANDARD_INPUT} is given more than once; standard input can be read once")
    if observed is not None:
        if len(logs) > 1:
            raise InputError(f"--observed: is for one log, but there are {len(logs)}; give them one by one")
        check_file(observed, "--observed")
        if observed.exists() and any(log.exists() and log.samefile(observed) for log in logs):
            raise InputError(f"--observed: {str(observed)!r} is the log itself; give another file")
    if out is not None:
        check_directory(out, _file_names(len(logs)))
        if observed is not None and observed.resolve() in {out.resolve(), *(out.resolve() / n for n in _file_names(1))}:
            raise InputError(f"--observed: {str(observed)!r} is --out or a file of it; give another file")
    chosen = PARK2008 if vehicle is None else from_file("--vehicle", vehicle, load_vehicle)
    tell_remarks(chosen)
    chosen = chosen.loaded() if loaded else chosen
    with _bar(logs, as_json) as advance, observed_rows(observed, chosen.wheel.radius) as sink:
        found: Identification | LogSeries = (
            identify(logs[0], chosen, options, progress=advance, observed=sink)
            if len(logs) == 1
            else identify_several(logs, chosen, options, progress=advance)
        )
        if sink is not None and isinstance(found, Identification):
            sink.finish(found.regimes)
    _warn(found)
    text = _report(found)
    record = identification_json(found) if isinstance(found, Identification) else series_json(found)
    content = json.loads(options_named(json.dumps(record)))
    try:
        if out is not None:
            files = _files(found, text, content)
            count = write_results(out, files, partial(_drawings, found))
            told = ", the model to model.toml" if "model.toml" in files else ""
            if isinstance(found, LogSeries):
                told += ", to be taken at --initial-speed" if told else ""
                told += "; model-1.toml and so on are for the v0 of their log"
            progress(f"wrote {count} files to {out}{told}")
    finally:
        show(as_json, lambda: content, lambda: _report(found))


def _report(found: Identification | LogSeries) -> str:
    return options_named(identification_text(found) if isinstance(found, Identification) else series_text(found))


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
    found = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not (sign and name.strip() and value.strip()):
            raise InputError(f"{option}: {shown(text)} is not allowed; give NAME=VALUE")
        if name.strip() in found:
            raise InputError(f"{option}: {name.strip()} is given twice; give it once")
        found[name.strip()] = value.strip()
    return found


def _value(option: str, name: str, text: str) -> float:
    return to_unit(text, parameter_unit(name), name=f"{option} {name}")


def _bounds(name: str, text: str) -> tuple[float, float]:
    low, sign, high = text.partition(":")
    if not sign:
        raise InputError(f"--bound {name}: {shown(text)} is not allowed; give LOW:HIGH")
    return _value("--bound", name, low), _value("--bound", name, high)


@contextmanager
def _bar(logs: tuple[Path, ...], as_json: bool) -> Iterator[Callable[[float], None] | None]:
    """A progress bar on standard error while large logs are read."""
    if sum(path.stat().st_size for path in logs if path.is_file()) < _BAR_FROM_BYTES:
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda share: bar.update(task, completed=share)


def _warn(found: Identification | LogSeries) -> None:
    for each in (found,) if isinstance(found, Identification) else found.logs:
        for note in each.curve.notes:
            progress(options_named(f"note: {each.curve.name}: {note}"))
        for warning in (*each.warnings, *each.doubts):
            progress(options_named(f"warning: {warning}"))
    if isinstance(found, LogSeries):
        for warning in found.warnings:
            progress(options_named(f"warning: {warning}"))


# --- files ---------------------------------------------------------------------------------------------------------


def _model_names(count: int) -> list[str]:
    """Of the logs' own models."""
    return ["model.toml"] if count == 1 else [f"model-{i + 1}.toml" for i in range(count)]


def _pictures(count: int) -> tuple[str, ...]:
    return ("adhesion", "peak", "braking") if count == 1 else ("adhesion", "coefficients")


def _file_names(count: int) -> list[str]:
    pictures = [f"{name}.{suffix}" for name in _pictures(count) for suffix in ("png", "svg")]
    several = [] if count == 1 else ["model.toml"]
    return [*several, *_model_names(count), "identification.txt", "identification.json", *pictures]


def _files(found: Identification | LogSeries, text: str, content: Mapping[str, Any]) -> dict[str, FileContent]:
    logs = found.logs if isinstance(found, LogSeries) else (found,)
    named = zip(_model_names(len(logs)), logs, strict=True)
    files: dict[str, FileContent] = {name: options_named(model_toml(each)) for name, each in named}
    files |= {"identification.txt": text, "identification.json": json_text(content)}
    whole = series_toml(found) if isinstance(found, LogSeries) else None
    return files if whole is None else files | {"model.toml": options_named(whole)}


def _drawings(found: Identification | LogSeries) -> Drawings:
    from railslip_ctrl.report import plots

    if isinstance(found, LogSeries):
        logs, others = found.logs, [plots.coefficients_figure(found)]
    else:
        logs, others = (found,), [plots.drift_figure(found), plots.braking_figure(found)]
    return dict(zip(_pictures(len(logs)), [plots.adhesion_figure(logs), *others], strict=True))
