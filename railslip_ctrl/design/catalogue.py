"""Controllers by name for a vehicle: those of [Park2008] Table 4, and this project's own.

The project's own hold the reference slip without knowing the adhesion curve. Their gains were found with
`design.tuning` over `design_points`: the largest ki with Ms <= `MS_MAX` behind a lead that cancels the brake's lag. Of
the published vehicle they are stored here in both readings of the units, and a test tunes them again; for any other
vehicle they are tuned when asked for. Unless a period is given all are sampled at every step of the scenario, as
[Park2008] says nothing of sampling, and all by the backward difference, with which their numbers were made.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, get_args

from railslip_ctrl.controllers.base import PERIOD, Controller
from railslip_ctrl.controllers.braking import braking_control
from railslip_ctrl.controllers.files import controller_kinds
from railslip_ctrl.controllers.linear import TRACKING_TIME, LinearControl, TransferFunction
from railslip_ctrl.controllers.pi import FILTER_RATIO, PI, PILead
from railslip_ctrl.controllers.scheduled import GainSchedule, Scheduled, ScheduleEntry
from railslip_ctrl.controllers.sliding import Sliding
from railslip_ctrl.controllers.systems import (
    PIController,
    actuated_plant,
    polynomials,
    wheel_slip_loop,
)
from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, named_law, published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008, TABLE4_PI, PIGains, Rail, Vehicle
from railslip_ctrl.sliding.law import TABLE4_LAWS, LawGains

from .schedule import schedule_gains
from .specification import family_margins
from .tuning import tune_pi

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from railslip_ctrl.loop.batch import BatchMargins
    from railslip_ctrl.model.linearization import LinearPlant


Kind = Literal["pi", "asmc"]
Column = Literal["beam", "bristle"]
COLUMNS: tuple[Column, ...] = get_args(Column)


@checked
def published_controller(
    kind: Kind,
    column: Column = "bristle",
    *,
    knows_rail: bool = True,
    adaptive: bool = False,
    reference: ReferenceSlip | None = None,
    period: float | None = None,
) -> PI | Sliding:
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
        gains = TABLE4_PI[column]
        return PI(kp=gains.kp, ki=gains.ki, reference=held, name="pi", period=period, anti_windup=False)
    law = published_law_gains(column, adaptive=adaptive)
    numbers = {name: getattr(law, name) for name in ("K", "D", "rho", "k1", "k2")}
    return Sliding(
        **numbers, reference=held, name="asmc", period=period, nominal_mass=PARK2008.mass, knows_rail=knows_rail
    )


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
) -> PI:
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
    gains = gains or _tuned_gains(car)
    kind = PILead if lead > 0 else PI
    return kind.for_vehicle(
        car,
        kp=gains.kp,
        ki=gains.ki,
        lead=lead,
        lead_filter=lead_filter,
        reference=reference or published_reference("bristle"),
        name="pi-lead",
        period=period,
        tracking_time=TRACKING_TIME,
        initial_torque=INITIAL_SHARE * car.wheel_load * car.wheel.radius,
    )


def recommended_schedule(
    vehicle: Vehicle | None = None, *, reference: ReferenceSlip | None = None, period: float | None = None
) -> Scheduled:
    """The gains of `recommended_pi_lead` scheduled over speed and rail on the static curve; arguments as there."""
    car = published_vehicle() if vehicle is None else vehicle
    return Scheduled.for_vehicle(
        car,
        schedule=_schedule(car),
        reference=reference or published_reference("bristle"),
        name="scheduled",
        period=period,
    )


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


def design_points(vehicle: Vehicle) -> list[LinearPlant]:
    """The linear plants the designs are tuned for: both published laws, dry and wet, `SPEEDS_KMH`, empty and loaded."""
    plants = []
    for name, rail, car in product(("curve", "bristle"), Rail, (vehicle, vehicle.loaded())):
        law = named_law(name, car).on(rail)
        slip = law.reference_slip(rail)
        assert slip is not None, "both laws have a published reference"
        plants += [linearize(operating_point(law, car, speed * KMH, slip, rail=rail)) for speed in SPEEDS_KMH]
    return plants


def margins_over_points(control: PI | Scheduled, vehicle: Vehicle | None = None) -> BatchMargins:
    """Margins of a linear controller at each of the vehicle's `design_points`, dead time exact, in their order.

    A scheduled one counts with the gains it has at each point. The published vehicle as published, if none is given.
    """
    car = published_vehicle() if vehicle is None else vehicle
    points = design_points(car)
    return family_margins([wheel_slip_loop(plant, control, car.actuator) for plant in points])


def _tuned_gains(vehicle: Vehicle) -> PIGains:
    """Those of `recommended_pi_lead` for a vehicle of which none are stored."""
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


def begun(kind: type[Controller], at: Sequence[LinearPlant] | LinearControl, reference: ReferenceSlip) -> Controller:
    """A controller of a kind to begin a design with, by the rule of its kind; of a PI SIMC's for J/r over s,
    [Skogestad2003] Table 1, with the lead on the brake's lag. It holds the slips of the plants that it is for, or is a
    linear one put as the ratio of polynomials that it is.

    InfeasibleDesignError, InputError: its kind allows none for the vehicle.
    """
    if isinstance(at, LinearControl):
        num, den = polynomials(at.system)
        kept = {name: value for name, value in at if name in LinearControl.model_fields and name != "name"}
        return TransferFunction(num=num, den=den, **{**kept, "period": at.period or PERIOD})
    vehicle, brake = at[0].point.vehicle, at[0].point.vehicle.actuator
    if not issubclass(kind, LinearControl):
        return kind.for_vehicle(vehicle)
    lead = 0.0 if kind is PI else brake.lag
    late = brake.dead_time + (FILTER_RATIO if lead else 1.0) * brake.lag or PERIOD
    kp = vehicle.effective_inertia / vehicle.wheel.radius / (2 * late)
    gains, made = PIGains(kp=kp, ki=kp / (8 * late)), PILead if kind is TransferFunction else kind
    points = [plant.point for plant in at]
    system = PIController(gains, lead, FILTER_RATIO * lead)
    found = braking_control(system, points, reference, name=made.kind, kind=made)
    return begun(kind, found, reference) if kind is TransferFunction else found


# --- by name ----------------------------------------------------------------------------------------------------------


BY_RULE: Mapping[str, type[Controller]] = MappingProxyType(
    {name: kind for name, kind in controller_kinds().items() if kind.by_rule}
)
"""Kinds that follow from the vehicle alone."""

NAMES = ("pi", "asmc", "pi-lead", "scheduled", *BY_RULE)
"""Names of the controllers that come with the package."""

_LINEAR = ("pi", "pi-lead")


def _holds_reference(name: str) -> bool:
    return name not in BY_RULE or BY_RULE[name].follows_reference


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
    if not _holds_reference(controller):
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
    - reference: another reference slip; of a kind that holds none, what its error is taken against.
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
    held = reference if reference is not None or not _holds_reference(name) else published_reference(column)
    vehicle = vehicle.empty()
    if name in BY_RULE:
        asked = {} if period is None else {"period": period}
        return BY_RULE[name].for_vehicle(vehicle, reference=held, name=name, **asked)
    if name == "scheduled":
        return recommended_schedule(vehicle, reference=held, period=period)
    if name == "pi-lead":
        return recommended_pi_lead(vehicle, gains=gains, reference=held, period=period)
    kind: Kind = "asmc" if name == "asmc" else "pi"
    made = published_controller(kind, column, knows_rail=knows_rail, adaptive=adaptive, reference=held, period=period)
    return made.model_copy(update={"kp": gains.kp, "ki": gains.ki}) if gains is not None else made
