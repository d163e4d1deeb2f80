"""Text and JSON of a verdict over an envelope."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl.core.rounding import rounded_up
from railslip_ctrl.design.assessment import assess
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.judging import Judgement, WorstCase

from .jsonable import margins_json
from .layout import facts, fixed, heading, render, table


def judgement_json(judgement: Judgement) -> dict[str, Any]:
    """The judgement, and as `cases` the margins of each operating point."""
    points = judgement.points
    operating = [points.case(int(i)) for i in np.flatnonzero(points.operating)]
    cases = [margins_json(assess(case.plant, judgement.controller, case.actuator)) for case in operating]
    named = [case | {"load": one.load} for case, one in zip(cases, operating, strict=True)]
    return {**judgement.table(), "cases": named}


def judgement_text(judgement: Judgement) -> str:
    """The verdict, the worst cases, and the worst Ms over speed and load."""
    return render(judgement_parts(judgement))


def judgement_parts(judgement: Judgement) -> list[RenderableType]:
    """What `judgement_text` renders."""
    rows = [
        ("Envelope", envelope_words(judgement.envelope)),
        ("Points", f"{len(judgement.points)}, of them {int(judgement.points.operating.sum())} operating points"),
        ("Usable from", _speed(judgement.usable_from_kmh, "at no speed all loops are stable")),
        ("Robust from", _speed(judgement.robust_from_kmh, "at no speed")),
    ]
    # the first line of the judgement is its verdict
    verdict, *told = str(judgement).splitlines()
    return [
        heading("Verdict over the envelope"),
        facts(rows),
        _worst_table(judgement),
        _map_table(judgement),
        *(Text(line) for line in told),
        Text(f"Verdict: {verdict}"),
    ]


def envelope_words(envelope: Envelope) -> str:
    """An envelope in a line."""
    car, said = envelope.vehicle, envelope.table()
    lists = [", ".join(said[name]) for name in ("rails", "laws", "loads")]
    speeds = f"{', '.join(f'{v:g}' for v in envelope.speeds)} km/h"
    names = ("slip", "dead_time", "lag", "radius")
    factors = (f"{name.replace('_', ' ')} {', '.join(f'{x:g}' for x in said[name])}" for name in names)
    return "; ".join([car.name, *lists, speeds, f"times {'; '.join(factors)}"])


def _speed(speed: float | None, never: str) -> str:
    return never if speed is None else f"{speed:g} km/h"


def _worst_table(judgement: Judgement) -> RenderableType:
    kinds = [("operating points", judgement.worst)]
    if not judgement.nominal:
        kinds.append(("with tolerances", judgement.worst_with_tolerances))
    return table(("Worst of", "Ms", "Phase, deg", "Delay, s", "Where"), [_row(*one) for one in kinds], words=(4,))


def _row(name: str, worst: WorstCase) -> list[str]:
    m = worst.margins
    numbers = ["unstable", "-", "-"] if m is None else [_ms(m.ms), fixed(m.phase_deg, 3), fixed(m.delay_s, 3)]
    return [name, *numbers, worst.case.words]


def _map_table(judgement: Judgement) -> RenderableType:
    found = judgement.map
    kinds = {"": found.operating} if judgement.nominal else {"": found.operating, ", tol.": found.with_tolerances}
    head = ["Worst Ms at, km/h", *(f"{load}{kind}" for kind in kinds for load in found.loads)]
    rows = [
        [f"{speed:g}", *(_ms(float(ms)) for values in kinds.values() for ms in values[i])]
        for i, speed in enumerate(found.speeds_kmh.tolist())
    ]
    return table(head, rows)


def _ms(ms: float) -> str:
    if np.isnan(ms):
        return "-"
    return "unstable" if np.isinf(ms) else fixed(rounded_up(ms), 3)
