"""Answer the requests of the page with numbers, texts and arrays of a design.

The functions that the commands use compute the answers.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.files import structures
from railslip_ctrl.controllers.linear import LinearControl
from railslip_ctrl.controllers.pi import PI, PID
from railslip_ctrl.controllers.systems import wheel_slip_loop
from railslip_ctrl.core.arguments import Floats, sized
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.assessment import limits_of, slip_responses
from railslip_ctrl.design.envelope_tuning import operating_plants, tune_over
from railslip_ctrl.design.gain_map import gain_levels, hard_plants, ms_cells
from railslip_ctrl.design.judging import bounds_over, judge_points
from railslip_ctrl.design.specification import ROBUST_MS, Specification
from railslip_ctrl.design.workbench import Workbench
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.vehicle import Rail
from railslip_ctrl.report.design_files import FILES
from railslip_ctrl.report.export import margin_frequencies, margin_numbers, plain
from railslip_ctrl.report.recommendation import LOAD_STEP
from railslip_ctrl.report.stops import stop_scenario
from railslip_ctrl.simulation import Simulator
from railslip_ctrl.simulation.scenario import with_patch

POINTS = 600  #: number of points of each line of a plot
_STEP_TIME = 16.0  # duration of step responses, in units of dead time plus lag; usable loops settle within this time
_CELLS = 17, 13  # columns and rows of the map of two parameters, for controllers other than a PI
_SAMPLES = 400  # points of a line of a braking run
_PATCH = 3.0  # s at the initial speed: distance to the wet patch, and length of the patch

Answer = tuple[dict[str, Any], dict[str, Floats]]
Request = Mapping[str, Any]


def encoded_answer(bench: Workbench, name: str, request: Request) -> bytes:
    """Return the answer to the request `name` of `ANSWERS`, encoded for the page; InputError for an invalid design.

    The answer consists of a head (numbers and texts) and arrays. The bytes are the length of the head, the head as
    JSON, and the arrays as 32-bit floats.
    """
    with np.errstate(all="ignore"):
        head, arrays = ANSWERS[name](bench, request)
        columns = {key: np.ascontiguousarray(values, dtype="<f4") for key, values in arrays.items()}
    sizes = {key: int(column.size) for key, column in columns.items()}
    text = json.dumps({**plain(head), "arrays": sizes}, allow_nan=False, ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([len(text).to_bytes(4, "little"), text, *(column.tobytes() for column in columns.values())])


def _design(request: Request) -> tuple[str, dict[str, float], ReferenceSlip | None]:
    """Return kind, parameters by name and reference slips of the design in a request; InputError if it is invalid."""
    sent = request.get("design")
    kind, values, slips = map(sent.get, ("kind", "values", "reference")) if isinstance(sent, dict) else (None,) * 3
    if not isinstance(kind, str) or not isinstance(values, dict) or not isinstance(slips, dict | None):
        raise InputError(
            "design: a part is missing or of a wrong type; give kind (a text), values (numbers with parameter names) "
            "and reference (dry and wet)"
        )
    reference = slips and ReferenceSlip(**{rail: sized(f"{rail} slip", slip) for rail, slip in slips.items()})
    return kind, {name[:60]: sized(name[:60], value) for name, value in values.items()}, reference or None


def _control(bench: Workbench, request: Request) -> Controller:
    return bench.control(*_design(request))


def start_answer(bench: Workbench, request: Request) -> Answer:
    """Return the content of the page at its start: vehicle, kinds with their parameters, reference slips."""
    envelope, brake = bench.envelope, bench.envelope.vehicle.actuator
    kinds = bench.with_ratio_of(_control(bench, request)) if request.get("design") else bench.kinds
    rails = f"{', '.join(envelope.rails)} rail; {min(envelope.speeds):g} to {max(envelope.speeds):g} km/h"
    return {
        "vehicle": f"{envelope.vehicle.name}: dead time {brake.dead_time:g} s, lag {brake.lag:g} s",
        "envelope": f"{rails}; {', '.join(envelope.loads)}",
        "kinds": {name: _kind(control) for name, control in kinds.items()},
        "kind": bench.given.kind if bench.given is not None else next(n for n in ("pi-lead", *kinds) if n in kinds),
        "reference": {rail.value: bench.reference.on(rail) for rail in Rail},
        "fixed": envelope.reference is not None,
        "robust_ms": ROBUST_MS,
        "load_step": LOAD_STEP,
    }, {}


def _kind(control: Controller) -> dict[str, Any]:
    """Return title, parameters and properties of a controller; `sampled`: its verdict is also on a sampled loop."""
    loop = isinstance(control, LinearControl) or control.kind in structures()
    kind = {"title": control.title, "tuned": isinstance(control, PI), "loop": loop}
    kind |= {"follows": control.follows_reference, "sampled": getattr(control, "as_run", None) is not None}
    return {**kind, "sliders": control.design_numbers()}


def loop_answer(bench: Workbench, request: Request) -> Answer:
    """Return exact margins, Nyquist and Bode plot, step response and load response at one operating point.

    `point` in the request is the index of the operating point. Without a valid index, the hardest operating point at or
    above the speed `from` of the request, km/h, is used.
    """
    control = _control(bench, request)
    _, points = bench.points(control)
    index = request.get("point")
    if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(points.plants):
        index = bench.hardest(control, points, sized("from", request.get("from") or 0.0))
    plant, brake = points.plants[index], points.vehicle.actuator
    case = points.case(int(np.flatnonzero((points.plant == index) & points.operating)[0]))
    head: dict[str, Any] = {"point": index, "where": case.description}
    try:
        loop = wheel_slip_loop(plant, control, brake)
    except InputError as error:
        return {**head, "no_loop": str(error).removeprefix("controller: ")}, {}
    limits = bench.of_points(points, index, lambda _: limits_of(plant, brake))
    head |= {"least_ms": limits.ms_bound, "crossover": limits.crossover_range}
    low, high = loop.feature_band()
    omega = np.geomspace(low, high, POINTS)
    response = loop.response(omega)
    arrays = {"omega": omega, "re": response.real, "im": response.imag, "db": 20 * np.log10(np.abs(response))}
    arrays["phase"] = np.degrees(loop.phase(omega))
    m = loop.margins() if loop.is_stable() else None
    head |= {"stable": m is not None, **margin_numbers(m), "frequencies": margin_frequencies(m)}
    head["range"] = loop.stabilizing_gain_range if m is None else None
    slowest = brake.dead_time + brake.lag or 1 / float(np.abs(plant.poles).max(initial=1.0))
    own, end = control.loop_as_run(plant.point, brake), _STEP_TIME * slowest
    steps = {"reference": 1.0, "torque": LOAD_STEP}
    if own is not None:
        return head, {**arrays, **dict(zip(("time", "step", "load"), own.responses(end, POINTS, **steps), strict=True))}
    if not isinstance(loop, DeadTimeLoop):
        return {**head, "no_step": "no step response for a discrete controller; see the braking run"}, arrays
    times = np.linspace(0.0, end, POINTS)
    try:
        step, load = slip_responses(control.linear(None), plant, brake, times, **steps)
    except InputError as error:
        return {**head, "no_step": str(error)}, arrays
    return head, {**arrays, "time": times, "step": step.output, "load": load.output}


def envelope_answer(bench: Workbench, request: Request, *, nominal: bool = True) -> Answer:
    """Return the verdict, the worst Ms over speed and load, and, if `nominal`, the lower bound of Ms.

    If `nominal`, only the operating points are judged, without tolerances.
    """
    control = _control(bench, request)
    envelope, points = bench.points(control, nominal=nominal)
    judgement = judge_points(envelope, control, points, nominal=nominal)
    over, least = judgement.map, None
    if judgement.usable_from_kmh is not None and (not nominal or isinstance(control, LinearControl)):
        names = ("phase_deg", "delay_s", "gain_increase", "gain_decrease")
        least = {name: judgement.least(name, largest=name == "gain_decrease")[0] for name in names}
    cases = {points.case(i).description: int(points.plant[i]) for i in np.flatnonzero(points.operating).tolist()}
    head: dict[str, Any] = {"verdict": judgement.verdict, "line": judgement.verdict_line, "least": least}
    head |= {"notes": judgement.slip_notes, "usable_from_kmh": judgement.usable_from_kmh, "map": vars(over)}
    if nominal:
        hardest = cases[judgement.worst.case.description]
        head |= {"bounds": bounds_over(points, over), "points": cases, "hardest": hardest}
    return head, {}


def verdict_answer(bench: Workbench, request: Request) -> Answer:
    """Return the answer of `envelope_answer` for all cases, with tolerances."""
    return envelope_answer(bench, request, nominal=False)


def stops_answer(bench: Workbench, request: Request) -> Answer:
    """Return braking runs from the envelope's initial speed: on dry rail, wet rail, and dry rail with a wet patch."""
    control, texts, arrays = _control(bench, request), {}, dict[str, Floats]()
    envelope, points = bench.points(control)
    law, load = points.plants[0].point.law.name, points.loads[0]
    dry, wet = (stop_scenario(envelope, points, law, load, rail) for rail in Rail)
    length = _PATCH * dry.initial_speed
    for name, scenario in (("dry", dry), ("wet", wet), ("patch", with_patch(dry, length, length))):
        run = Simulator(scenario, control).run(0, record_every=1)
        s = run.signals
        assert s is not None, "the run is recorded"
        texts[name] = str(run)
        columns = {"time": s.time, "slip": s.slip, "reference": s.reference, "torque": s.torque}
        columns |= {"train": s.speed / KMH, "wheel": (s.speed - s.slip_velocity) / KMH}
        kept = np.unique(np.linspace(0, s.time.size - 1, _SAMPLES).astype(int))
        arrays |= {f"{name} {column}": values[kept] for column, values in columns.items()}
    return {"descriptions": texts}, arrays


def region_answer(bench: Workbench, request: Request) -> Answer:
    """Return a map of two parameters of the design.

    For a PI, the map has the region of (kp, ki) in which all loops are stable, and regions in which Ms of every loop is
    below a level. The loops are those at a few of the hardest operating points, or at every operating point if the
    request has `all`. For another controller, the map has the worst Ms at a few of the hardest operating points, on a
    grid of the two parameters that `axes` of the request names.
    """
    kind, values, reference = _design(request)
    control, brake = bench.control(kind, values, reference), bench.envelope.vehicle.actuator
    plants = operating_plants(bench.points(control)[1])
    if isinstance(control, PI):
        levels = gain_levels(control, plants if request.get("all") else hard_plants(plants), brake)
        return {"levels": [vars(level) for level in levels], "few": not request.get("all")}, {}
    axes = request.get("axes")
    if not isinstance(axes, list) or len(axes) != 2 or not {*map(str, axes)} <= values.keys():
        raise InputError("axes: give the names of two parameters of the design")

    def with_pair(*pair: float) -> Controller:
        return bench.control(kind, {**values, **dict(zip(axes, pair, strict=True))}, reference)

    centre = values[axes[0]], values[axes[1]]
    return dict(zip("xym", ms_cells(with_pair, centre, _CELLS, hard_plants(plants), brake), strict=True)), {}


def tune_answer(bench: Workbench, request: Request) -> Answer:
    """Return the parameters of the design after tuning as `railslip tune` does.

    If the request has `ki_min`, the worst Ms is minimised with ki >= `ki_min`; if it has `ms_max`, ki is maximised with
    Ms <= `ms_max`.
    """
    control = _control(bench, request)
    given = {name: sized(name, request[name]) for name in ("ms_max", "ki_min") if request.get(name)}
    if not isinstance(control, PI) or len(given) != 1 or min(given.values()) <= 0:
        raise InputError("tune: give the design of a PI, and either ms_max > 1 or ki_min > 0")
    leads = {"lead": control.lead, "lead_filter": control.lead_filter}
    leads = leads if control.lead and not isinstance(control, PID) else {}
    specification, ki_min, period = Specification(given.get("ms_max")), given.get("ki_min"), control.period
    envelope, kind = bench.points(control)[0], type(control)
    tuned, design = tune_over(envelope, specification, kind, ki_min=ki_min, nominal=True, period=period, **leads)
    if design is None:
        raise InputError(f"{tuned.reason}; railslip report names the brake that this vehicle needs")
    return {"values": {number.name: number.value for number in design.controller.design_numbers()}}, {}


def file_answer(bench: Workbench, request: Request) -> Answer:
    """Return the text of a file that describes the design; `name` in the request is one of `FILES`."""
    name, control = str(request.get("name")), _control(bench, request)
    if name not in FILES:
        raise InputError(f"file: give one of {', '.join(FILES)}")
    return {"text": FILES[name](bench.points(control)[0], control)}, {}


ANSWERS: Mapping[str, Callable[[Workbench, Request], Answer]] = MappingProxyType(
    {"start": start_answer, "loop": loop_answer, "envelope": envelope_answer, "stops": stops_answer}
    | {"verdict": verdict_answer, "region": region_answer, "tune": tune_answer, "file": file_answer}
)
