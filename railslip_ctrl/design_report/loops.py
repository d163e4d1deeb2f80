"""Linear part of a design report: adhesion curves, the stabilising region, designs side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from railslip_ctrl.adhesion import AdhesionLaw, published_law
from railslip_ctrl.assessment import assess
from railslip_ctrl.design import PIController, actuated_plant, intersection, margin_grid, outline, stabilizing_pi
from railslip_ctrl.design.compensators import Compensator, filtered_smith_predictor, smith_predictor
from railslip_ctrl.design.effort import Effort, control_effort
from railslip_ctrl.design.holding import needs_feedback
from railslip_ctrl.design.rules import RuleTuning, simc_pi
from railslip_ctrl.design.stabilizing import Region
from railslip_ctrl.design_check import ControllerGroup, DesignCheck, controller_group
from railslip_ctrl.errors import InputError, RailslipError
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.curves import gang_of_four
from railslip_ctrl.loop.responses import disturbance_response, step_response
from railslip_ctrl.numeric import adhesion_coefficient, peak
from railslip_ctrl.parameters import PIGains, Rail, Vehicle, table4_gains
from railslip_ctrl.units import KMH

from .candidates import Candidate, candidates, design_names
from .records import Attempt, GainRegion, LawCurve, LoopDesign, LoopDesigns
from .shortfall import shortfall
from .speed_range import speed_range

COMPARED_LAWS = ("beam", "curve", "bristle")
"""Published laws drawn beside the one the report is about."""

LARGEST_SLIP = 0.5
"""End of the adhesion curves; what a brake does happens well before."""

LOAD_STEP = 100.0  # N*m at the wheel
_RESPONSE_TIME = 30.0  # s, in which the slow integral action is seen to work
_GANG = (0.01, 100.0)  # rad/s
_PREDICTOR_FILTER = 0.1  # s
_SLIPS = 401
_GRID = (48, 40)  # kp, ki: contours are smooth
_PAST_THE_END = 10.0  # times the least stabilising kp: a picture of what has no bound ends there, or further on
_ROOM = 1.5  # times a gain that is marked, to the end of such a picture
_AT_THE_EDGE = 1.3  # a gain nearer to its end, as a ratio, would be neither in nor out


# --- adhesion -------------------------------------------------------------------------------------------------------


def law_curves(plants: Sequence[LinearPlant]) -> tuple[LawCurve, ...]:
    """The law asked for at each of the speeds, then the published ones at the first speed; rail by rail."""
    found: list[LawCurve] = []
    for rail in dict.fromkeys(plant.point.rail for plant in plants):
        points = [plant.point for plant in plants if plant.point.rail is rail]
        for speed in dict.fromkeys(point.speed for point in points):
            on_it = tuple(point for point in points if point.speed == speed)
            found.append(_curve(on_it[0].law, rail, speed, on_it[0].vehicle.wheel_load, on_it))
        first = points[0]
        for law in _compared(first.law, rail, first.initial_speed_kmh, first.vehicle.wheel_load):
            found.append(_curve(law, rail, first.speed, first.vehicle.wheel_load, ()))
    return tuple(found)


def _compared(law: AdhesionLaw, rail: Rail, v0: float | None, wheel_load: float) -> list[AdhesionLaw]:
    if v0 is None:
        return []
    try:
        return [published_law(name, rail, v0, wheel_load) for name in COMPARED_LAWS if name != law.name]
    except InputError:  # outside the speeds the published parameters are for
        return []


def _curve(law: AdhesionLaw, rail: Rail, speed: float, wheel_load: float, points: tuple[object, ...]) -> LawCurve:
    end = min(LARGEST_SLIP, law.domain_limit(speed)[0] * (1.0 - 1e-9))
    slip = np.linspace(1e-6 if law.has_state else 0.0, end, _SLIPS)  # no rest state of a dynamic law without slip
    return LawCurve(
        law=law.name,
        title=law.title,
        parameters=law.model_dump(mode="json"),
        rail=rail,
        speed_kmh=speed / KMH,
        slip=slip,
        coefficient=np.asarray(adhesion_coefficient(law, speed, slip, wheel_load)),
        peak=peak(law, speed, wheel_load),
        points=points,  # type: ignore[arg-type]
        asked=bool(points),
    )


# --- the region -----------------------------------------------------------------------------------------------------


def gain_region(check: DesignCheck, plants: Sequence[LinearPlant]) -> GainRegion:
    """The PI gains that stabilise every operating point, with the margins inside."""
    actuator = check.vehicle.actuator
    chosen = _chosen_gains(check, plants)
    kp_range = None
    try:
        region = intersection(
            [stabilizing_pi(actuated_plant(plant, actuator), dead_time=actuator.dead_time) for plant in plants],
            [plant.point.words for plant in plants],
        )
        kp_range = region.kp_range
        if kp_range is None:
            return GainRegion(None, (), None, chosen, region.reason)
        kp_limit, ki_limit = _drawn_up_to(region, kp_range, chosen)
        strips = outline(region, kp_limit=kp_limit, ki_limit=ki_limit)
        top = max(float(strip.ki_high.max()) for strip in strips)
        columns = np.linspace(max(kp_range[0], -kp_limit), min(kp_range[1], kp_limit), _GRID[0])
        grid = margin_grid(region, columns, np.linspace(0.0, top, _GRID[1]))
    except RailslipError as error:
        return GainRegion(kp_range, (), None, chosen, str(error))
    return GainRegion(kp_range, strips, grid, chosen, "")


def _drawn_up_to(
    region: Region, kp_range: tuple[float, float], chosen: dict[str, tuple[float, float]]
) -> tuple[float, float]:
    """The kp and the ki up to which to draw what has no bound; inf for what has one.

    Without dead time and with one lag kp has none, and without the lag ki has none either. Shown are the least
    stabilising gains and at least one of the chosen: all of them would leave the others in a corner.
    """
    kp_limit = ki_limit = math.inf
    if not all(map(math.isfinite, kp_range)):
        end = min(abs(kp) for kp in kp_range)
        kp_limit = max(_PAST_THE_END * end, _ROOM * min(kp for kp, _ in chosen.values()))
        for kp, _ in sorted(chosen.values()):
            if kp_limit / _AT_THE_EDGE < kp < _AT_THE_EDGE * kp_limit:
                kp_limit = _ROOM * kp
    middle = 0.5 * (max(kp_range[0], -kp_limit) + min(kp_range[1], kp_limit))
    if math.isinf(region.ki_limit(middle)):
        ki_limit = _ROOM * max(ki for kp, ki in chosen.values() if kp < kp_limit)
    return kp_limit, ki_limit


def _chosen_gains(check: DesignCheck, plants: Sequence[LinearPlant]) -> dict[str, tuple[float, float]]:
    published = table4_gains(plants[0].point.adhesion)
    chosen = {"published PI": (published.kp, published.ki)}
    if check.holding is not None:
        gains = check.holding.controller.gains
        chosen["holding PI"] = (gains.kp, gains.ki)
    return chosen


# --- designs --------------------------------------------------------------------------------------------------------


def loop_designs(check: DesignCheck, plants: Sequence[LinearPlant], given: PIGains | None) -> LoopDesigns:
    """Published, given, held and lag-compensated designs at every operating point."""
    vehicle = check.vehicle
    compared, refused = candidates(check, plants, given)
    designs = tuple(_design(one, plants, vehicle) for one in compared)
    wheel, tau, lag = plants[0], vehicle.actuator.dead_time, vehicle.actuator.lag
    bare = Rational(wheel.zeros, wheel.poles, wheel.gain)
    brake = (
        Rational(np.array([]), np.array([-1 / lag]), 1 / lag) if lag > 0 else Rational(np.array([]), np.array([]), 1)
    )
    reference, load, gangs = {}, {}, {}
    plant = DeadTimeLoop(actuated_plant(wheel, vehicle.actuator), tau)
    for one in designs:
        if not one.assessments[0].stable:
            continue
        c = one.controller.transfer_function
        gangs[one.name] = gang_of_four(c, plant, *_GANG)
        try:
            step = step_response(c, bare, tau, final_time=_RESPONSE_TIME, actuator=brake, height=KMH)
            push = disturbance_response(c, bare, tau, final_time=_RESPONSE_TIME, actuator=brake, height=LOAD_STEP)
        except InputError as error:  # a loop far faster than the time shown
            refused[f"responses of {one.name}"] = str(error)
            continue
        reference[one.name], load[one.name] = step, push
    found = LoopDesigns(
        designs=designs,
        refused=refused,
        attempts=tuple(_attempts(plants, vehicle, compared)),
        shown_at=wheel.point,
        load_step=LOAD_STEP,
        reference=reference,
        load=load,
        gangs=gangs,
    )
    taken = found.recommended
    if (taken is None or not taken.robust) and needs_feedback(plants):
        found = replace(found, shortfall=shortfall(plants, vehicle, held_together=taken is not None))
    return found if taken is None else replace(found, speeds=speed_range(taken.name, taken.controller, plants))


def recommended_group(loops: LoopDesigns) -> ControllerGroup | None:
    """The recommended design's loops as one more group of the design check; None if none is recommended."""
    taken = loops.recommended
    if taken is None:
        return None
    scale = loops.shown_at.vehicle.inertia_scale
    standing = "Recommended by its margins" if taken.robust else "Least fragile"  # no stop was looked at
    return controller_group(f"{standing}: {taken.name}, inertia scale {scale:g}", taken.how, taken.assessments)


def _design(one: Candidate, plants: Sequence[LinearPlant], vehicle: Vehicle) -> LoopDesign:
    assessments = tuple(assess(plant, one.controller, vehicle.actuator, label=one.name) for plant in plants)
    efforts = tuple(_effort(one.controller, each.plant, vehicle) if each.stable else None for each in assessments)
    return LoopDesign(
        one.name, one.how, one.origin, one.over_range, one.needs_hold, one.controller, assessments, efforts
    )


def _effort(controller: PIController, plant: LinearPlant, vehicle: Vehicle) -> Effort:
    actuator = vehicle.actuator
    loop = actuated_plant(plant, actuator)
    return control_effort(controller.transfer_function, loop, actuator.dead_time, lag=actuator.lag)


def _attempts(plants: Sequence[LinearPlant], vehicle: Vehicle, compared: Sequence[Candidate]) -> list[Attempt]:
    """A known rule and two predictors at each operating point, each made for it with its exact model."""
    tau = vehicle.actuator.dead_time
    named = {one.name: one.controller for one in compared}
    primary = named.get(design_names(vehicle).least_ms, compared[0].controller).transfer_function
    found = []
    for plant in plants:
        system = actuated_plant(plant, vehicle.actuator)
        made: dict[str, Callable[[], Compensator | RuleTuning]] = {
            "SIMC rule, PI": lambda system=system: simc_pi(system, tau),  # type: ignore[misc]
            "Smith predictor": lambda system=system: smith_predictor(system, tau, primary),  # type: ignore[misc]
            "filtered Smith predictor": lambda system=system: filtered_smith_predictor(  # type: ignore[misc]
                system, tau, primary, filter_time=_PREDICTOR_FILTER
            ),
        }
        for name, make in made.items():
            try:
                design = make()
                loop = (
                    DeadTimeLoop(design.transfer_function() * system, tau) if isinstance(design, RuleTuning) else design
                )
                found.append(Attempt(name, plant.point, loop.margins(), ""))
            except RailslipError as error:
                found.append(Attempt(name, plant.point, None, str(error)))
    return found
