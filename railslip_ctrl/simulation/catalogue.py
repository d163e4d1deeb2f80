"""Controllers by name for a vehicle: those of [Park2008] Table 4, and this project's own.

The project's own hold the reference slip without knowing the adhesion curve. Their gains were found with
`design.tuning` over `design_points`: the largest ki with Ms <= `MS_MAX` behind a lead that cancels the brake's lag. Of
the published vehicle they are stored here in both readings of the units, and a test tunes them again; for any other
vehicle they are tuned when asked for. Unless a period is given all are sampled at every step of the scenario, as
[Park2008] says nothing of sampling, and all by the backward difference, with which their numbers were made.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.design.controllers import (
    PERIOD,
    PIController,
    Rule,
    actuated_plant,
    linear_controller,
    run_period,
    wheel_slip_loop,
)
from railslip_ctrl.design.envelope_tuning import SURE_SHARE, EnvelopeDesign, operating_plants
from railslip_ctrl.design.schedule import GainSchedule, ScheduleEntry
from railslip_ctrl.design.seeking import seeking_gains
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, published_law
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008, TABLE4_PI, PIGains, Rail, Vehicle
from railslip_ctrl.sliding.law import TABLE4_LAWS, LawGains

from .controllers import Controller, LinearControl, ScheduledControl, SlideProtection, SlidingControl
from .scenario import named_law
from .seeking import SeekingControl

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from railslip_ctrl.design.judging import Judgement
    from railslip_ctrl.loop.batch import BatchMargins
    from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint


Kind = Literal["pi", "asmc"]
Column = Literal["beam", "bristle"]
COLUMNS: tuple[Column, ...] = get_args(Column)

FILTER_TIME = 0.1  #: s, of the filter that estimates v' in the ASMC; any value serves, [Park2008] gives none


@checked
def published_controller(
    kind: Kind,
    column: Column = "bristle",
    *,
    knows_rail: bool = True,
    adaptive: bool = False,
    reference: ReferenceSlip | None = None,
    period: float | None = None,
) -> LinearControl | SlidingControl:
    """A controller of [Park2008] Table 4, SI, in the reading under which Table 5 comes out.

    PI: the column's gains, no limits or anti-windup of its own. ASMC: law (45) with D and K added as torque, rho per
    second, Ta from the plant's adhesion law at the measured slip, Mn the empty mass, the adaptation off.

    - kind: {"pi", "asmc"}
    - column: {"beam", "bristle"}; of Table 4: its gains and its reference slip (beam 0.119 dry, 0.059 wet; bristle
      0.132, 0.092).
    - knows_rail: aSMC: whether its adhesion model turns wet with the rail; the reference always does.
    - adaptive: aSMC: the printed adaptation, k = 2.1e-8 read in km/h: k1 = k, k2 = 3.6^2 k.
    - reference: another reference slip.
    - period: sampling period, s; every step of the scenario if not given.

    InputError: another kind or column, or an option of the ASMC with the PI.
    """
    held = published_reference(column) if reference is None else reference
    if kind == "pi":
        if adaptive or not knows_rail:
            raise InputError("controller: 'pi' has neither adaptation nor adhesion model; choose 'asmc' for those")
        design = PIController(TABLE4_PI[column])
        return LinearControl(design, held, period=period, rule=Rule.BACKWARD, tracking_time=math.inf)
    law, mass = published_law_gains(column, adaptive=adaptive), PARK2008.mass
    return SlidingControl(law, held, period=period, nominal_mass=mass, filter_time=FILTER_TIME, knows_rail=knows_rail)


def published_law_gains(column: Column, *, adaptive: bool = False) -> LawGains:
    """Table 4's ASMC gains of a column, SI; without `adaptive` k1 = k2 = 0."""
    gains = TABLE4_LAWS[column]
    return gains if adaptive else replace(gains, k1=0.0, k2=0.0)


def published_reference(column: Column) -> ReferenceSlip:
    """A column's reference slip, dry and wet."""
    reference = published_law(column, Rail.DRY).reference
    assert reference is not None, "both published laws have one"
    return reference


# --- this project's own -----------------------------------------------------------------------------------------------


MS_MAX = 2.0  #: largest Ms the designs are tuned for: the upper end of what [Astrom1998] calls reasonable
LEAD, LEAD_FILTER = 0.6, 0.06  #: s, for the published brake; see `lead_of`
TORQUE_LIMIT = 9000.0  #: N*m, of the published vehicle: twice what the best adhesion, 0.3 of the wheel load, can take
TRACKING_TIME = 2.0  #: Tt of the anti-windup, s; 1 to 5 s differ by less than 1 % in braking distance

INITIAL_SHARE = 0.12
"""Initial torque of `recommended_pi_lead` by wheel load times radius: less than even the wet rail of [Park2008] takes,
whose peak is 0.153."""

SPEEDS_KMH = (20.0, 60.0, 100.0)
_SCHEDULE_SPEEDS_KMH = (20.0, 40.0, 70.0, 100.0)

_PI_LEAD = MappingProxyType(
    {AS_PUBLISHED_INERTIA_SCALE: PIGains(kp=1210.0, ki=1220.0), 1.0: PIGains(kp=330.0, ki=129.0)}
)
# kp, ki at the speeds of _SCHEDULE_SPEEDS_KMH, dry then wet, and lowest speed held, km/h, worst Ms between entries
_SCHEDULES = MappingProxyType(
    {
        AS_PUBLISHED_INERTIA_SCALE: (
            ((1212, 1228), (1217, 1386), (1220, 1455), (1221, 1483)),
            ((1237, 1894), (1230, 1719), (1227, 1645), (1226, 1616)),
            3.174,
            2.018,
        ),
        1.0: (
            ((330, 130), (334, 273), (337, 339), (337, 366)),
            ((356, 791), (347, 606), (344, 529), (343, 499)),
            9.241,
            2.059,
        ),
    }
)


def recommended_pi_lead(
    vehicle: Vehicle | None = None,
    *,
    gains: PIGains | None = None,
    reference: ReferenceSlip | None = None,
    period: float | None = None,
) -> LinearControl:
    """The lag-compensated PI with anti-windup that beats [Park2008] Table 5 in its own scenario.

    As published (the default vehicle): kp 1210 N*m/(m/s), ki 1220 N*m/m, worst Ms 2.0 over `design_points`; without
    the adhesion curve it stops in about 547 m and 47.6 s with a mean slip error of 0.017, where the best of Table 5
    needs 581 m and 50.7 s with 0.027.

    - vehicle: the quarter car; one that is not the published one has a lead for its own brake and gains tuned for it,
      which takes some seconds.
    - gains: other gains behind the lead for the vehicle's brake.
    - reference: the bristle column's, 0.132 dry and 0.092 wet, if not given.
    - period: sampling period, s; every step of the scenario if not given.

    InfeasibleDesignError: no gains with Ms <= `MS_MAX` for that vehicle, and none are given.
    """
    car = published_vehicle() if vehicle is None else vehicle
    lead, lead_filter = lead_of(car)
    if gains is None and not is_tuned_when_asked("pi-lead", car):
        gains = _PI_LEAD[car.inertia_scale]
    return LinearControl(
        PIController(gains or _tuned_gains(car), lead, lead_filter),
        reference or published_reference("bristle"),
        name="pi-lead",
        period=period,
        torque_low=0.0,
        torque_high=full_brake_torque(car),
        tracking_time=TRACKING_TIME,
        rule=Rule.BACKWARD,
        initial_torque=INITIAL_SHARE * car.wheel_load * car.wheel.radius,
    )


def braking_control(
    design: Any,
    points: Sequence[OperatingPoint],
    reference: ReferenceSlip,
    *,
    name: str,
    hand_over_kmh: float = 0.0,
    period: float | None = None,
) -> LinearControl:
    """A linear design for some operating points as it brakes: sampled by Tustin's rule, at its own period if it has one
    (`controllers.run_period`), within 0 and their full brake, with anti-windup.

    It begins with `SURE_SHARE` of the torque that the least adhesive point takes, which every rail surely does, and
    hands over to it below a speed (km/h; 0: never).
    """
    sure = SURE_SHARE * min(point.brake_torque for point in points)
    return LinearControl(
        design,
        reference,
        name=name,
        period=run_period(linear_controller(design), period),
        torque_low=0.0,
        torque_high=full_brake_torque(points[0].vehicle),
        tracking_time=TRACKING_TIME,
        rule=Rule.TUSTIN,
        initial_torque=sure,
        cut_out_speed=hand_over_kmh * KMH,
        cut_out_torque=sure if hand_over_kmh else 0.0,
    )


def hand_over_of(judgement: Judgement) -> float:
    """The speed, km/h, below which slip is no longer controlled: the lowest at which a design is robust, or if it is
    nowhere, stable with every tolerance; 0, never, over a single speed."""
    robust = judgement.robust_from_kmh
    lowest = robust if robust is not None else judgement.usable_from_kmh or 0.0
    return lowest if len(judgement.envelope.speeds) > 1 else 0.0


def tuned_control(
    design: EnvelopeDesign, reference: ReferenceSlip | None = None, *, name: str | None = None
) -> LinearControl:
    """A controller tuned over an envelope as it brakes; `reference` where it holds no single one.

    InputError without either.
    """
    held = design.reference or reference
    if held is None:
        raise InputError("controller: the laws of its envelope hold different slips; give the envelope a reference")
    judged = design.judgement
    assert judged is not None, "a tuned controller has been judged"
    points = [plant.point for plant in operating_plants(judged.points)]
    own, hand_over = name or design.structure.lower(), hand_over_of(judged)
    return braking_control(design.as_run.design, points, held, name=own, hand_over_kmh=hand_over, period=design.period)


def recommended_schedule(
    vehicle: Vehicle | None = None, *, reference: ReferenceSlip | None = None, period: float | None = None
) -> ScheduledControl:
    """The gains of `recommended_pi_lead` scheduled over speed and rail on the static curve; arguments as there."""
    car = published_vehicle() if vehicle is None else vehicle
    return ScheduledControl(
        _schedule(car),
        reference or published_reference("bristle"),
        period=period,
        torque_high=full_brake_torque(car),
        tracking_time=TRACKING_TIME,
        rule=Rule.BACKWARD,
    )


@checked
def slide_protection(
    vehicle: Vehicle | None = None, *, reference: ReferenceSlip | None = None, period: float | None = None
) -> SlideProtection:
    """The rule-based baseline, its rates and full brake in proportion to what the vehicle's adhesion can take.

    - vehicle: left out, the published one, SI.
    - reference: slip ratios that its error is taken against; left out, none.
    - period: sampling period, s.
    """
    car = published_vehicle() if vehicle is None else vehicle
    baseline = SlideProtection(reference)
    share = _share(car, car.wheel_load)
    return SlideProtection(
        reference,
        fill_rate=share * baseline.fill_rate,
        dump_rate=share * baseline.dump_rate,
        torque_high=full_brake_torque(car),
        period=baseline.period if period is None else period,
    )


@checked
def seeking_control(
    vehicle: Vehicle | None = None, *, reference: ReferenceSlip | None = None, period: float | None = None
) -> SeekingControl:
    """The controller that seeks the peak of adhesion, with the gains that `seeking_gains` has for a vehicle.

    - vehicle: left out, the published one, SI. Its wheel, wheel load and actuator count, its mass does not.
    - reference: slip ratios that its error is taken against; left out, none.
    - period: sampling period, s, at most a twelfth of the dead time, with which sampling adds at most 4 % to Ms; left
      out, 10 ms or that, whichever is less.

    In SI. InputError: a vehicle whose brake has no dead time, by which its gains go, or a longer period.
    """
    car = PARK2008 if vehicle is None else vehicle
    # its largest torque, with which it starts, is what an empty wheel bears until the dead time is over
    gains = seeking_gains(car, TORQUE_LIMIT * _share(car, car.wheel_load))
    longest = car.actuator.dead_time / 12
    if period is not None and period > longest:
        raise InputError(
            f"period: {period:g} s is not allowed for the seeking controller; give a value <= {longest:g} s, a twelfth "
            "of the brake's dead time, or leave it out"
        )
    return SeekingControl(gains, reference, period=min(PERIOD, longest) if period is None else period)


def published_vehicle() -> Vehicle:
    """The published quarter car in the as-published reading."""
    return PARK2008.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})


def is_published(vehicle: Vehicle) -> bool:
    """Whether a vehicle has the published masses, wheel and wheel load; its brake and its scale may differ."""
    own, published = ((car.mass_loaded, car.wheel, car.wheel_load_loaded) for car in (vehicle, PARK2008))
    return own == published


def is_tuned_when_asked(name: str, vehicle: Vehicle, gains: PIGains | None = None) -> bool:
    """Whether the controller of a name has no gains stored here for the vehicle, and none given."""
    stored = {"pi-lead": _PI_LEAD.keys(), "scheduled": _SCHEDULES.keys()}.get(name)
    return stored is not None and gains is None and not (is_published(vehicle) and vehicle.inertia_scale in stored)


def lead_of(vehicle: Vehicle) -> tuple[float, float]:
    """Lead and its filter, s, of `recommended_pi_lead`: the lead cancels the brake's lag, the filter is a tenth of it.

    The published vehicle keeps its controller where its brake is made to differ. Without a lag there is no lead: 0, 0.
    """
    lag = vehicle.actuator.lag
    return (LEAD, LEAD_FILTER) if is_published(vehicle) else (lag, lag / 10.0)


def full_brake_torque(vehicle: Vehicle) -> float:
    """The largest torque of a vehicle's brake, N*m, at which designs are limited and bounds taken: `TORQUE_LIMIT`, in
    proportion to wheel load, loaded where that is more, times radius."""
    return TORQUE_LIMIT * _share(vehicle, max(vehicle.wheel_load, vehicle.wheel_load_loaded))


def _share(vehicle: Vehicle, wheel_load: float) -> float:
    """What the adhesion of a wheel load takes, over that of the published vehicle."""
    return wheel_load * vehicle.wheel.radius / (PARK2008.wheel_load * PARK2008.wheel.radius)


def design_points(vehicle: Vehicle) -> list[LinearPlant]:
    """The linear plants the designs are tuned for: both published laws, dry and wet, `SPEEDS_KMH`, empty and loaded."""
    from railslip_ctrl.model.linearization import linearize, operating_point

    plants = []
    for name, rail, car in product(("curve", "bristle"), Rail, (vehicle, vehicle.loaded())):
        law = named_law(name, car).on(rail)
        slip = law.reference_slip(rail)
        assert slip is not None, "both laws have a published reference"
        plants += [linearize(operating_point(law, car, speed * KMH, slip, rail=rail)) for speed in SPEEDS_KMH]
    return plants


def margins_over_points(control: LinearControl | ScheduledControl, vehicle: Vehicle | None = None) -> BatchMargins:
    """Margins of a linear controller at each of the vehicle's `design_points`, dead time exact, in their order.

    A scheduled one counts with the gains it has at each point. The published vehicle as published, if none is given.
    """
    from railslip_ctrl.design.specification import family_margins

    car = published_vehicle() if vehicle is None else vehicle
    points = design_points(car)
    return family_margins([wheel_slip_loop(plant, control, car.actuator) for plant in points])


def _tuned_gains(vehicle: Vehicle) -> PIGains:
    """Those of `recommended_pi_lead` for a vehicle of which none are stored."""
    from railslip_ctrl.design.tuning import tune_pi

    (lead, lead_filter), plants = lead_of(vehicle), design_points(vehicle)
    compensator = PIController(PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function if lead > 0 else None
    systems, names = [actuated_plant(one, vehicle.actuator) for one in plants], [one.point.words for one in plants]
    try:
        design = tune_pi(systems, vehicle.actuator.dead_time, ms_max=MS_MAX, compensator=compensator, names=names)
    except InfeasibleDesignError as error:
        raise InfeasibleDesignError(f"controller: no pi-lead for {vehicle.name}: {error}; give its gains") from None
    return PIGains(kp=design.kp, ki=design.ki)


def _schedule(vehicle: Vehicle) -> GainSchedule:
    """The gains of `recommended_schedule`: stored, or tuned now."""
    if is_tuned_when_asked("scheduled", vehicle):
        from railslip_ctrl.design.schedule import schedule_gains

        lead, lead_filter = lead_of(vehicle)
        return schedule_gains(
            _SCHEDULE_SPEEDS_KMH, law="curve", vehicle=vehicle, ms_max=MS_MAX, lead=lead, lead_filter=lead_filter
        )
    dry, wet, lowest, ms = _SCHEDULES[vehicle.inertia_scale]
    entries = tuple(
        ScheduleEntry(rail, speed, PIGains(kp=kp, ki=ki), MS_MAX)
        for rail, gains in ((Rail.DRY, dry), (Rail.WET, wet))
        for speed, (kp, ki) in zip(_SCHEDULE_SPEEDS_KMH, gains, strict=True)
    )
    return GainSchedule(entries, LEAD, LEAD_FILTER, lowest, ms)


# --- by name ----------------------------------------------------------------------------------------------------------


NAMES = ("pi", "asmc", "pi-lead", "scheduled", "slide-protection", "seeking")
"""Names of the controllers that come with the package."""

_LINEAR = ("pi", "pi-lead")
_WITHOUT_REFERENCE = ("slide-protection", "seeking")


def default_column(law: AdhesionLaw) -> Column:
    """The column of Table 4 for an adhesion law: its own for the beam, else that of the bristles."""
    return "beam" if law.name == "beam" else "bristle"


def held_reference(
    controller: str, law: AdhesionLaw, slip: float | None, column: Column | None, *, dashes: str = ""
) -> ReferenceSlip | None:
    """The slips that a controller of `NAMES` holds: a given one, or those of a column of Table 4, or those of the
    adhesion law; None if it holds none.

    InputError, in which `dashes` stand before the names of options, if there are none to hold, or they are not used.
    """
    if controller in _WITHOUT_REFERENCE:
        for name, given in (("slip", slip), ("gains", column)):
            if given is not None:
                told = f"{dashes}{name}: {given} does not go with {controller}, which holds no reference slip"
                raise InputError(f"{told}; leave it out")
        return None
    if slip is not None:
        return ReferenceSlip(dry=slip, wet=slip)
    if column is not None:
        return published_reference(column)
    if law.reference is None:
        raise InputError(
            f"{dashes}slip: adhesion {law.name!r} has no reference slip; give {dashes}slip, or {dashes}gains for that "
            "of Table 4"
        )
    return law.reference


def controller_named(
    name: str,
    vehicle: Vehicle,
    *,
    column: Column = "bristle",
    gains: PIGains | None = None,
    reference: ReferenceSlip | None = None,
    knows_rail: bool = True,
    adaptive: bool = False,
    period: float | None = None,
) -> Controller:
    """A controller of `NAMES` for a vehicle, with the gains of the empty one also where it is `loaded`.

    - name: "pi" and "asmc" are [Park2008] Table 4's (see `published_controller`), the others this project's
      (`designed`).
    - column: {"beam", "bristle"}; of Table 4: gains of "pi" and "asmc", and the reference slip of all.
    - gains: in place of those of "pi" or "pi-lead".
    - reference: another reference slip; of "slide-protection" and "seeking", which hold none, what their error is
      taken against.
    - knows_rail, adaptive, period: as in `published_controller`.

    InputError: another name, or an option that the controller does not have.
    """
    if name not in NAMES:
        raise InputError(
            f"controller: {name!r} is not one; {close_match(name, NAMES)}choose one of {', '.join(NAMES)}, or give a "
            "TOML file"
        )
    if gains is not None and name not in _LINEAR:
        raise InputError(f"controller: {name!r} has no kp and ki; leave them out or choose {' or '.join(_LINEAR)}")
    if name != "asmc" and (adaptive or not knows_rail):
        raise InputError(
            f"controller: {name!r} has neither adaptation nor a model of the rail to keep dry; choose 'asmc' for those"
        )
    held = reference if reference is not None or name in _WITHOUT_REFERENCE else published_reference(column)
    vehicle = vehicle.empty()
    without_gains: dict[str, Callable[..., Controller]] = {
        "scheduled": recommended_schedule, "slide-protection": slide_protection, "seeking": seeking_control
    }  # fmt: skip
    if name in without_gains:
        return without_gains[name](vehicle, reference=held, period=period)
    if name == "pi-lead":
        return recommended_pi_lead(vehicle, gains=gains, reference=held, period=period)
    kind: Kind = "asmc" if name == "asmc" else "pi"
    made = published_controller(kind, column, knows_rail=knows_rail, adaptive=adaptive, reference=held, period=period)
    return replace(made, design=PIController(gains)) if gains and isinstance(made, LinearControl) else made
