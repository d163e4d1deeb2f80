"""Named controllers for a vehicle: those of [Park2008] Table 4, and this project's own.

This project's PI-lead and gain schedule are tuned for the largest ki with Ms <= `MS_MAX`. Their gains are stored for
the published vehicle and are tuned on request for any other.
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
    """Return a controller of [Park2008] Table 4, in SI.

    The gains are converted from the units with which the results of Table 5 are reproduced. The PI has no torque limits
    and no anti-windup. The ASMC is law (45) of [Park2008] with D and K as torques and rho in 1/s. It uses the mass
    of the empty vehicle, and the plant's adhesion law at the measured slip.

    - kind: {"pi", "asmc"}
    - column: {"beam", "bristle"}; column of Table 4 with gains and reference slip (beam 0.119 dry, 0.059 wet; bristle
      0.132, 0.092).
    - knows_rail: whether the adhesion model of the ASMC changes with the rail condition. The reference slip always
      does.
    - adaptive: whether the ASMC adapts two parameters of its adhesion model. The gain k = 2.1e-8 of Table 4 is in units
      with km/h; the SI gains are k1 = k and k2 = 3.6^2 k.
    - reference: reference slip; by default that of the column.
    - period: sampling period, s; by default the integration step of the scenario.

    InputError: an unknown kind or column, or an option of the ASMC with the PI.
    """
    slips = published_reference(column) if reference is None else reference
    if kind == "pi":
        if adaptive or not knows_rail:
            raise InputError(
                "controller: 'pi' has neither adaptation nor an adhesion model; leave out adaptive and knows_rail, or "
                "choose 'asmc'"
            )
        gains = TABLE4_PI[column]
        return PI(kp=gains.kp, ki=gains.ki, reference=slips, name="pi", period=period, anti_windup=False)
    law = published_law_gains(column, adaptive=adaptive)
    numbers = {name: getattr(law, name) for name in ("K", "D", "rho", "k1", "k2")}
    return Sliding(
        **numbers, reference=slips, name="asmc", period=period, nominal_mass=PARK2008.mass, knows_rail=knows_rail
    )


def published_law_gains(column: Column, *, adaptive: bool = False) -> LawGains:
    """Return the ASMC gains in a column of [Park2008] Table 4, SI; the adaptation gains are 0 unless `adaptive`."""
    gains = TABLE4_LAWS[column]
    return gains if adaptive else replace(gains, k1=0.0, k2=0.0)


def published_reference(column: Column) -> ReferenceSlip:
    """Return the reference slips, dry and wet, in a column of [Park2008] Table 4."""
    reference = published_law(column, Rail.DRY).reference
    assert reference is not None, "both published laws have a reference slip"
    return reference


MS_MAX = 2.0  #: largest Ms the designs are tuned for: the upper end of the reasonable range of [Astrom1998]
LEAD, LEAD_FILTER = 0.6, 0.06  #: s, lead and lead filter for the published brake; see `lead_of`

INITIAL_SHARE = 0.12
"""Initial torque of `recommended_pi_lead` over wheel load times radius; the peak on wet rail is 0.153 ([Park2008])."""

SPEEDS_KMH = (20.0, 60.0, 100.0)
_SCHEDULE_SPEEDS_KMH = (20.0, 40.0, 70.0, 100.0)

_PI_LEAD = MappingProxyType(
    {AS_PUBLISHED_INERTIA_SCALE: PIGains(kp=1210.0, ki=1220.0), 1.0: PIGains(kp=330.0, ki=129.0)}
)
# kp, ki at the speeds of _SCHEDULE_SPEEDS_KMH, dry then wet; lowest stable speed, km/h; worst Ms between entries
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
    """Return a PI-lead with anti-windup, whose lead cancels the brake's lag.

    - vehicle: quarter car; by default the published one in the as-published reading.
    - gains: kp and ki; by default 1210 N*m/(m/s) and 1220 N*m/m for the default vehicle. For a vehicle without stored
      gains, the function tunes them, which takes some seconds.
    - reference: reference slip; by default that of the bristle column of Table 4, 0.132 dry and 0.092 wet.
    - period: sampling period, s; by default the integration step of the scenario.

    InfeasibleDesignError: `gains` is not given, and no gains have Ms <= `MS_MAX` for this vehicle.
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
    """Return a PI-lead with gains for each speed and rail, tuned for the law `curve`; see `recommended_pi_lead`."""
    car = published_vehicle() if vehicle is None else vehicle
    return Scheduled.for_vehicle(
        car,
        schedule=_schedule(car),
        reference=reference or published_reference("bristle"),
        name="scheduled",
        period=period,
    )


def published_vehicle() -> Vehicle:
    """Return the quarter car of [Park2008] with M, J and B times 3.6 (as published)."""
    return PARK2008.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})


def is_published(vehicle: Vehicle) -> bool:
    """Return True if masses, wheel and wheel load are the published ones; brake and inertia scale may differ."""
    own, published = ((car.mass_loaded, car.wheel, car.wheel_load_loaded) for car in (vehicle, PARK2008))
    return own == published


def is_tuned_when_asked(name: str, vehicle: Vehicle, gains: PIGains | None = None) -> bool:
    """Return True if `gains` is None and no gains of the controller `name` are stored for the vehicle."""
    stored = {"pi-lead": _PI_LEAD.keys(), "scheduled": _SCHEDULES.keys()}.get(name)
    return stored is not None and gains is None and not (is_published(vehicle) and vehicle.inertia_scale in stored)


def lead_of(vehicle: Vehicle) -> tuple[float, float]:
    """Return the time constants, s, of the lead of `recommended_pi_lead` and of its filter.

    For the published vehicle they are 0.6 s and 0.06 s, else the lag of the brake and a tenth of this lag.
    """
    lag = vehicle.actuator.lag
    return (LEAD, LEAD_FILTER) if is_published(vehicle) else (lag, lag / 10.0)


def design_points(vehicle: Vehicle) -> list[LinearPlant]:
    """Return plants for tuning: laws "curve" and "bristle", dry and wet rail, `SPEEDS_KMH`, empty and loaded."""
    plants = []
    for name, rail, car in product(("curve", "bristle"), Rail, (vehicle, vehicle.loaded())):
        law = named_law(name, car).on(rail)
        slip = law.reference_slip(rail)
        assert slip is not None, "both laws have a published reference"
        plants += [linearize(operating_point(law, car, speed * KMH, slip, rail=rail)) for speed in SPEEDS_KMH]
    return plants


def margins_over_points(control: PI | Scheduled, vehicle: Vehicle | None = None) -> BatchMargins:
    """Return the exact margins of a linear controller at each of the `design_points` of a vehicle, in their order.

    At each point, a scheduled controller has the gains for this point. The default vehicle is `published_vehicle`.
    """
    car = published_vehicle() if vehicle is None else vehicle
    points = design_points(car)
    return family_margins([wheel_slip_loop(plant, control, car.actuator) for plant in points])


def _tuned_gains(vehicle: Vehicle) -> PIGains:
    (lead, lead_filter), plants = lead_of(vehicle), design_points(vehicle)
    compensator = PIController(PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function if lead > 0 else None
    systems = [actuated_plant(plant, vehicle.actuator) for plant in plants]
    names = [plant.point.description for plant in plants]
    try:
        design = tune_pi(systems, vehicle.actuator.dead_time, ms_max=MS_MAX, compensator=compensator, names=names)
    except InfeasibleDesignError as error:
        raise InfeasibleDesignError(f"controller: no pi-lead for {vehicle.name}: {error}; give its gains") from None
    return PIGains(kp=design.kp, ki=design.ki)


def _schedule(vehicle: Vehicle) -> GainSchedule:
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
    """Return the first controller of a kind, from which the user continues a design by hand.

    Each kind has a rule for the parameters. The rule for a PI is the SIMC rule, [Skogestad2003] Table 1, for the
    integrating plant (r/J)/s with dead time. If `at` is a linear controller, the function returns `at` as a ratio of
    polynomials.

    InfeasibleDesignError or InputError if the rule gives no controller for the vehicle.
    """
    if isinstance(at, LinearControl):
        num, den = polynomials(at.system)
        others = {name: value for name, value in at if name in LinearControl.model_fields and name != "name"}
        return TransferFunction(num=num, den=den, **{**others, "period": at.period or PERIOD})
    vehicle, brake = at[0].point.vehicle, at[0].point.vehicle.actuator
    if not issubclass(kind, LinearControl):
        return kind.for_vehicle(vehicle)
    lead = 0.0 if kind is PI else brake.lag
    delay = brake.dead_time + (FILTER_RATIO if lead else 1.0) * brake.lag or PERIOD
    kp = vehicle.effective_inertia / vehicle.wheel.radius / (2 * delay)
    gains, pi_kind = PIGains(kp=kp, ki=kp / (8 * delay)), PILead if kind is TransferFunction else kind
    points = [plant.point for plant in at]
    system = PIController(gains, lead, FILTER_RATIO * lead)
    control = braking_control(system, points, reference, name=pi_kind.kind, kind=pi_kind)
    return begun(kind, control, reference) if kind is TransferFunction else control


BY_RULE: Mapping[str, type[Controller]] = MappingProxyType(
    {name: kind for name, kind in controller_kinds().items() if kind.by_rule}
)
"""Kinds of controllers whose parameters are computed from the vehicle alone, by the name of the kind."""

NAMES = ("pi", "asmc", "pi-lead", "scheduled", *BY_RULE)
"""Names of the controllers that come with the package."""

_LINEAR = ("pi", "pi-lead")


def _tracks_reference(name: str) -> bool:
    return name not in BY_RULE or BY_RULE[name].follows_reference


def default_column(law: AdhesionLaw) -> Column:
    """Return the column of [Park2008] Table 4 for an adhesion law: "beam" for the beam law, else "bristle"."""
    return "beam" if law.name == "beam" else "bristle"


def tracked_reference(
    controller: str, law: AdhesionLaw, slip: float | None, column: Column | None, *, dashes: str = ""
) -> ReferenceSlip | None:
    """Return the reference slips of a controller of `NAMES`; None if it tracks no reference slip.

    The reference slip is `slip` if given, else that of the `column` of [Park2008] Table 4, else that of the adhesion
    law. InputError if no reference slip is known, or if an argument has no effect; messages write `dashes` before
    argument names.
    """
    if not _tracks_reference(controller):
        for name, given in (("slip", slip), ("gains", column)):
            if given is not None:
                message = f"{dashes}{name}: {given} has no effect with {controller}, which tracks no reference slip"
                raise InputError(f"{message}; leave {dashes}{name} out")
        return None
    if slip is not None:
        return ReferenceSlip(dry=slip, wet=slip)
    if column is not None:
        return published_reference(column)
    if law.reference is None:
        raise InputError(
            f"{dashes}slip: adhesion {law.name!r} has no reference slip; give {dashes}slip, or {dashes}gains to use a "
            "reference slip of [Park2008] Table 4"
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
    """Return a controller of `NAMES` for a vehicle, with gains for the empty vehicle.

    - name: "pi" or "asmc" is a controller of [Park2008] Table 4; the others are this project's own.
    - vehicle: quarter car to control.
    - column: {"beam", "bristle"}; column of Table 4 for the gains of "pi" and "asmc", and for the reference slip.
    - gains: gains for "pi" or "pi-lead", in place of the usual ones.
    - reference: reference slip in place of the column's. A controller that tracks no reference slip uses it only to
      state the slip error.
    - knows_rail, adaptive, period: as in `published_controller`.

    InputError: an unknown name, or an option that the controller does not have.
    """
    if name not in NAMES:
        raise InputError(
            f"controller: {name!r} is not known; {close_match(name, NAMES)}choose one of {', '.join(NAMES)}, or give a "
            "TOML file"
        )
    if gains is not None and name not in _LINEAR:
        raise InputError(f"controller: {name!r} has no kp and ki; leave them out or choose {' or '.join(_LINEAR)}")
    if name != "asmc" and (adaptive or not knows_rail):
        raise InputError(
            f"controller: {name!r} has neither adaptation nor an adhesion model; leave out the options for them "
            "(adaptive, unknown rail), or choose 'asmc'"
        )
    slips = reference if reference is not None or not _tracks_reference(name) else published_reference(column)
    vehicle = vehicle.empty()
    if name in BY_RULE:
        fields = {} if period is None else {"period": period}
        return BY_RULE[name].for_vehicle(vehicle, reference=slips, name=name, **fields)
    if name == "scheduled":
        return recommended_schedule(vehicle, reference=slips, period=period)
    if name == "pi-lead":
        return recommended_pi_lead(vehicle, gains=gains, reference=slips, period=period)
    kind: Kind = "asmc" if name == "asmc" else "pi"
    control = published_controller(
        kind, column, knows_rail=knows_rail, adaptive=adaptive, reference=slips, period=period
    )
    return control.model_copy(update={"kp": gains.kp, "ki": gains.ki}) if gains is not None else control
