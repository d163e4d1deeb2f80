"""Results as JSON, sources of adhesion laws, writing of files (all or none), and software versions."""

from __future__ import annotations

import json
import math
import os
import platform
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from enum import Enum
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from railslip_ctrl import __version__
from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.systems import LinearController, PIController
from railslip_ctrl.core.errors import InputError, RailslipError
from railslip_ctrl.core.folders import INCOMPLETE, staged
from railslip_ctrl.design.assessment import Assessment
from railslip_ctrl.loop import Certificate, Margins
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.model.adhesion import AdhesionLaw, published_law
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, notes_and_warnings

PUBLISHED, GIVEN = "published", "given"  #: sources of an adhesion law without a file

_PACKAGES = {
    **{"control": "python-control", "numpy": "NumPy", "scipy": "SciPy"},
    **{"sympy": "SymPy", "numba": "Numba", "matplotlib": "Matplotlib"},
}
_CERTIFIED = {
    **{name: name for name in ("gain_increase", "gain_decrease")},
    **{"phase_margin_deg": "phase_deg", "delay_margin_s": "delay_s", "ms": "ms", "mt": "mt"},
}
_MARGINS = {**_CERTIFIED, "disk_margin": "disk"}


def number(value: float) -> float | None:
    """Return a finite float, or None for any other number."""
    return float(value) if math.isfinite(value) else None


def plain(value: Any) -> Any:
    """Convert a value to JSON types.

    Arrays and tuples become lists. Named tuples become objects. Complex numbers become [re, im]. Numbers that are not
    finite become null.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, float):
        return number(value)
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    return [plain(entry) for entry in value] if isinstance(value, list | tuple) else value


def json_text(content: Mapping[str, Any], *, ensure_ascii: bool = True) -> str:
    """Return `content` as indented JSON text; ValueError if it contains a number that is not finite."""
    return json.dumps(content, indent=2, allow_nan=False, ensure_ascii=ensure_ascii) + "\n"


def exported(record: Any, *same: str, **named: str) -> dict[str, Any]:
    """Return some attributes of a record as JSON; if the record is None, all values are null.

    - same: names of attributes that are also the JSON keys.
    - named: further attributes with another JSON key; mass_kg="vehicle.mass" exports `record.vehicle.mass` as mass_kg.
    """
    paths = {name: name for name in same} | named
    return {name: None if record is None else plain(attrgetter(path)(record)) for name, path in paths.items()}


def case_json(point: OperatingPoint) -> dict[str, Any]:
    """Return the six keys that identify an operating point: law, rail, speed, slip, mass and inertia scale."""
    scale = "vehicle.inertia_scale"
    return exported(point, "adhesion", "rail", "speed_kmh", "slip", mass_kg="vehicle.mass", inertia_scale=scale)


def _context_json(point: OperatingPoint) -> dict[str, Any]:
    return {
        "adhesion_law": law_json(point.law, source_at(point)),
        **exported(point, "initial_speed_kmh", vehicle="vehicle.name", wheel_load_n="vehicle.wheel_load"),
        "notes": list(notes_and_warnings(point.vehicle)),
    }


def law_json(law: AdhesionLaw, source: str) -> dict[str, Any]:
    """Return an adhesion law as JSON: name, source, rail, and each parameter with its SI value and unit."""
    parameters = {name: {"value": plain(value), "unit": unit} for name, (value, unit) in law.numbers().items()}
    return {"name": law.name, "source": source, "rail": law.rail.value, "parameters": parameters}


def linear_plant_json(plant: LinearPlant) -> dict[str, Any]:
    """Return a linearisation as JSON: operating point, matrices, signal names, poles, zeros, transfer function."""
    num, den = plant.transfer_function()
    return {
        **case_json(plant.point),
        **_context_json(plant.point),
        **exported(plant.point, "residual", adhesion_force_n="adhesion_force", brake_torque_nm="brake_torque"),
        **exported(plant, "states", "inputs", "outputs", "A", "B", "C", "D", "poles", "zeros"),
        "transfer_function": {"num": num.tolist(), "den": den.tolist()},
    }


def margin_numbers(margins: Margins | None) -> dict[str, Any]:
    """Return each margin as JSON; null if it is unbounded or the loop is unstable."""
    numbers = exported(margins, **_MARGINS)
    return numbers | {"gain_decrease": numbers["gain_decrease"] or None}


def margin_frequencies(margins: Margins | None) -> dict[str, Any] | None:
    """Return the frequency of each margin, rad/s; null for an unstable loop."""
    names = ("gain_increase", "gain_decrease", "phase", "delay", "ms", "mt", "disk")
    keys = {"phase": "phase_margin", "delay": "delay_margin", "disk": "disk_margin"}
    return None if margins is None else exported(margins, **{keys.get(x, x): f"{x}_frequency" for x in names})


def margins_json(assessment: Assessment, certificate: Certificate | None = None) -> dict[str, Any]:
    """Return the margins of a loop (null if unstable), and the certificate if there is one, as JSON."""
    unstable = assessment.unstable_poles
    content = {
        **case_json(assessment.point),
        **_context_json(assessment.point),
        "controller": controller_json(assessment.controller),
        "actuator": exported(assessment.actuator, dead_time_s="dead_time", lag_s="lag"),
        **exported(
            assessment,
            "stable",
            "stabilizing_gain_range",
            "closed_loop_poles",
            "verdict",
            plant_poles="plant.poles",
            open_loop_unstable_poles="loop.open_loop_unstable_poles",
        ),
        "unstable_closed_loop_poles": int(unstable) if math.isfinite(unstable) else None,
        "gain_crossovers_rad_s": _crossovers(assessment),
        **margin_numbers(assessment.margins),
        "frequencies_rad_s": margin_frequencies(assessment.margins),
        "limits": _limits_json(assessment),
        "pade": [
            {"order": row.order, "stable": row.margins is not None, **margin_numbers(row.margins)}
            for row in assessment.pade
        ],
    }
    if assessment.as_run is not None:  # the sampled loop of a continuous controller
        stable = assessment.as_run.is_stable()
        margins = margin_numbers(assessment.sampled)
        content["sampled"] = {"period_s": assessment.as_run.period, "stable": stable, **margins}
    if certificate is not None:
        content["certificate"] = _certificate_json(certificate)
    return content


def controller_json(controller: LinearController | Controller) -> dict[str, Any]:
    """Return structure and parameters (SI) of a controller that has stability margins, as JSON."""
    if isinstance(controller, Controller):
        return {"structure": controller.kind, **controller.gain_values()}
    if not isinstance(controller, PIController):
        numbers = {name: value for name, value in asdict(controller).items() if value is not None}
        return {"structure": controller.structure, **numbers}
    lead = {} if controller.structure == "PI" else {"lead_s": "lead", "lead_filter_s": "lead_filter"}
    return exported(controller, kp_si="gains.kp", ki_si="gains.ki", **lead)


def _crossovers(assessment: Assessment) -> Any:
    if not isinstance(assessment.loop, SampledLoop):
        return plain(assessment.loop.gain_crossovers)
    return [] if assessment.margins is None else plain(assessment.margins.gain_crossovers)


def _certificate_json(certificate: Certificate) -> dict[str, Any]:
    pairs = {name: getattr(certificate, field) for name, field in _CERTIFIED.items()}
    ends = {name: None if pair is None else [number(end) for end in pair] for name, pair in pairs.items()}
    if ends["gain_decrease"] is not None:
        ends["gain_decrease"] = [end or None for end in ends["gain_decrease"]]  # 0 means unbounded
    return {
        **exported(certificate, "stable", "marginal", "bits", "parts", unstable_closed_loop_poles="unstable_poles"),
        "gain_crossovers_rad_s": [[number(w) for w in pair] for pair in certificate.gain_crossovers],
        **ends,
    }


def _limits_json(assessment: Assessment) -> dict[str, Any]:
    limits = assessment.limits
    names = {"unstable_pole_rad_s": "unstable_pole", "pole_times_dead_time_and_lag": "actuator_product"}
    content = exported(limits, **names, mt_lower_bound="mt_bound", ms_lower_bound="ms_bound")
    for name, structure in (("pi", limits.pi), ("pi_lead", limits.pi_lead)):
        keys = {f"{name}_phase_margin_upper_bound_deg": "phase_deg", f"{name}_ms_lower_bound": "ms_bound"}
        content |= exported(structure, **keys)
    return content


def law_text(law: AdhesionLaw, source: str) -> str:
    """Return an adhesion law as text: its name, and its source unless the law is published."""
    if source == PUBLISHED:
        return law.name
    return f"{law.name} as given" + ("" if source == GIVEN else f" ({source})")


def source_of(law: AdhesionLaw, published: Callable[[], AdhesionLaw]) -> str:
    """Return the file of an adhesion law; without a file "published" if the law equals `published()`, else "given"."""
    if law.file is not None:
        return law.file
    try:
        other = published()
    except RailslipError:  # there is no published law of this name
        return GIVEN
    return PUBLISHED if type(other) is type(law) and other.parameters() == law.parameters() else GIVEN


def source_at(point: OperatingPoint) -> str:
    """Return the source of the adhesion law of an operating point, see `source_of`."""
    v0 = INITIAL_SPEED_KMH if point.initial_speed_kmh is None else point.initial_speed_kmh
    return source_of(point.law, lambda: published_law(point.adhesion, point.rail, v0, point.vehicle.wheel_load))


def law_text_at(point: OperatingPoint) -> str:
    """Return name and source of the adhesion law of an operating point."""
    return law_text(point.law, source_at(point))


def check_directory(directory: Path, names: Iterable[str]) -> None:
    """Raise InputError if files `names` could not be written into `directory`, which need not exist yet."""
    if str(directory) in ("", "."):
        raise InputError(
            "--out: the working folder is not allowed, because files in it could be overwritten; give another folder"
        )
    existing = directory
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not _is_writable(existing):
        raise InputError(f"--out: {str(directory)!r} cannot be created or written to; choose another folder")
    for name in names:
        if (directory / name).is_dir():
            path = str(directory / name)
            raise InputError(f"--out: a folder has the name of the file {path!r}; remove it, or give another --out")


def _is_writable(directory: Path) -> bool:
    try:  # access rights alone are not reliable, for example in /proc
        with tempfile.TemporaryDirectory(prefix=INCOMPLETE, dir=directory):
            return True
    except OSError:
        return False


def check_file(path: Path, option: str) -> None:
    """Raise InputError, with the name of the `option`, if a file could not be written at `path`."""
    if path.is_dir() or not path.name:
        raise InputError(f"{option}: {str(path)!r} is a folder; give a file name")
    if path.exists() and not path.is_file():  # writing would replace a device or pipe
        raise InputError(f"{option}: {str(path)!r} is not a regular file; choose another")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{option}: {str(path.parent)!r} is not a writable folder; choose another")


FileContent = str | bytes | Callable[[Path], object]
"""Content of a file, or a function that writes it to a path."""


def write_files(directory: Path, files: Mapping[str, FileContent], *, option: str = "--out") -> list[Path]:
    """Write all `files`, a mapping of file name to content, into `directory`, or none of them; return the paths.

    InputError: the directory cannot be created or written to; existing files are then unchanged.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with staged(directory) as new:
            for name, content in files.items():
                if callable(content):
                    content(new / name)
                else:
                    (new / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    except OSError as error:
        raise InputError(
            f"{option}: {str(directory)!r} cannot be written to ({error.strerror or error}); choose another folder"
        ) from None
    return [directory / name for name in files]


def software() -> dict[str, str]:
    """Return the version of this package, of Python, and of each library in use, by name."""
    own = {"railslip_ctrl": __version__, "Python": platform.python_version()}
    return own | {shown: version(name) for name, shown in _PACKAGES.items()}
