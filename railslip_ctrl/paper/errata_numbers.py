"""Errata of [Park2008]'s numbers and units: (40), B(t), Tables 3, 4, 5; computed from the printed numbers."""

from __future__ import annotations

import sympy as sp

from railslip_ctrl.core.units import KMH, to_unit
from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import (
    AS_PUBLISHED_INERTIA_SCALE,
    PARK2008,
    TABLE4_PI,
    TABLE4_PI_PRINTED,
    TABLE4_SLIDING_PRINTED,
)
from railslip_ctrl.sliding.derivation import Derivation
from railslip_ctrl.sliding.gains import PUBLISHED_LAW
from railslip_ctrl.verification.reaching_bound import least_gain, operating_set, reference_set, surface_needed

from . import printed
from .erratum import Erratum, told

_WHEEL = PARK2008.wheel


def number_errata(derivation: Derivation) -> tuple[Erratum, ...]:
    """The rows, in the order of the source."""
    return (_reaching_gain(derivation), _viscous(), _table3(), _table4_kp(), _table4_ki(), _table4_asmc(), *_table5())


def random_disturbance(derivation: Derivation) -> float:
    """What one standard deviation of the random adhesion force adds to s', m/s^2, SI."""
    values = {
        plant.r: _WHEEL.radius,
        plant.J: _WHEEL.inertia,
        plant.M: PARK2008.mass,
        plant.Tr: _WHEEL.radius * printed.RANDOM_FORCE,
        plant.Fr: 0,
        plant.Td: 0,
    }
    return float(derivation.disturbance.subs(values))


def _reaching_gain(derivation: Derivation) -> Erratum:
    D, K = PUBLISHED_LAW.D, PUBLISHED_LAW.K
    ratio = _WHEEL.radius / _WHEEL.inertia
    resistance = PARK2008.resistance.quadratic * (printed.SPEEDS_KMH[0] * KMH) ** 2 / PARK2008.mass
    d = random_disturbance(derivation) + resistance
    K0 = ratio * K
    boxes = [reference_set(PARK2008, sigmas=1.0, with_torque=torque) for torque in (False, True)]
    without, needed = (surface_needed(PARK2008, box, K=K, D=D) for box in boxes)
    least = ratio * least_gain(PARK2008, boxes[1])
    widest = least_gain(PARK2008, operating_set(PARK2008, sigmas=3.0))
    return told(
        "(40) with Table 4",
        r"D_0 |s| + K_0 > |d| + \eta",
        rf"K_0 = {K0:.3f} < |d| = {d:.3f}\ \mathrm{{m/s^2}}",
        how="computed",
        sign_and_size=(
            f"K0 = (r/J) K = {K0:.3f} m/s^2; without Td, one standard deviation of Tr with Fr at 100 km/h is {d:.3f} "
            f"m/s^2 ({d / K0:.1f} times as much) and |s| would have to exceed {without:.1f} m/s of "
            f"{printed.SPEEDS_KMH[0] * KMH:.1f} m/s; with Td = 0.05 of the acting torque, the law's own in it, K0 > "
            f"{least:.3f} m/s^2 or |s| > {needed:.1f} m/s; over the whole run at three deviations K > {widest:.0f} N*m "
            f"is asked of {K:g} N*m"
        ),
        explanation="(40) is assumed in the source, never evaluated. Gaussian noise has no bound, so no K holds it for "
        "certain. D and K are read as N*m per km/h and N*m, bristle column; `verify` has the bound and its set.",
    )


def _viscous() -> Erratum:
    t = sp.Symbol("t", real=True)
    B = printed.VISCOUS[0] + printed.VISCOUS[1] * t
    zero = float(sp.solve(B, t)[0])
    last = float(B.subs(t, printed.TABLE5_TIMES[0]))
    return told(
        "B = 0.25 - 0.01 t",
        r"B = 0.25 - 0.01 t > 0",
        rf"B(t) < 0 \text{{ for }} t > {zero:g}\ \mathrm{{s}}",
        how="computed",
        sign_and_size=f"zero at {zero:g} s, {last:+.3f} N*m*s at {printed.TABLE5_TIMES[0]:g} s, the end of the stop",
        explanation="A negative viscous coefficient drives the wheel. Its torque is a few N*m, so it is harmless in "
        "the result; it is kept as printed in the published scenario.",
    )


def _table3() -> Erratum:
    means = {name: sum(row) / len(row) for name, row in printed.TABLE3.items()}
    improvement = 100.0 * (1.0 - means["bristle"] / means["beam"])
    rounded = 100.0 * (1.0 - printed.TABLE3_MEANS["bristle"] / printed.TABLE3_MEANS["beam"])
    return told(
        "Table 3",
        rf"{printed.TABLE3_MEANS['beam']:g},\ {printed.TABLE3_MEANS['bristle']:g}\ \mathrm{{km/h}},\ "
        rf"{printed.TABLE3_IMPROVEMENT:g}\,\%",
        rf"{means['beam']:.4f},\ {means['bristle']:.6f},\ {improvement:.1f}\,\%",
        how="computed",
        sign_and_size=(
            f"row means {means['beam']:.4f} and {means['bristle']:.6f}: {improvement:.1f} % better, printed "
            f"{printed.TABLE3_IMPROVEMENT:g} % (that is {rounded:.1f} % from 0.011 and 0.0083)"
        ),
        explanation="The bristle model's mean is 0.008475, not 0.0083, and an error of an adhesion coefficient has no "
        "unit.",
    )


def _columns(texts: dict[str, str]) -> str:
    """One text where both columns of Table 4 have the same, else each with its column."""
    if len(set(texts.values())) == 1:
        return next(iter(texts.values()))
    return "; ".join(f"{name}: {text}" for name, text in texts.items())


def _table4_kp() -> Erratum:
    rows, reading = TABLE4_PI_PRINTED, TABLE4_PI
    one = to_unit("1 N*h", "N*m/(m/s)")
    same = to_unit("1 kN*m/(km/h)", "N*m/(m/s)") / one
    sizes = {
        name: f"as printed {row.Kp * one:.4g} N*m/(m/s), as read {reading[name].kp:.4g}, a factor of "
        f"{row.Kp * one / reading[name].kp:.0f}"
        for name, row in rows.items()
    }
    values = r",\ ".join(f"{row.Kp:g}" for row in rows.values())
    return told(
        "Table 4, Kp",
        rf"{values}\ \mathrm{{N\,h}},\ 1\ \mathrm{{N\,h}} = {same:g}\ \mathrm{{kN\,m/(km/h)}}",
        rf"{values}\ \mathrm{{N\,m/(km/h)}}",
        how="computed",
        sign_and_size=_columns(sizes),
        explanation="N-h is exactly kN*m/(km/h): an error of 1 km/h would ask for hundreds of kN*m of a brake whose "
        "torque is a few kN*m. That N*m/(km/h) is meant is an inference, confirmed by simulation (`reproduce`).",
    )


def _table4_ki() -> Erratum:
    rows, reading = TABLE4_PI_PRINTED, TABLE4_PI
    sizes = {
        name: f"as printed {to_unit(f'{row.Ki} N', 'N*m/m'):.4g} N*m/m, as read {reading[name].ki:.4g}, a factor of "
        f"{to_unit(f'{row.Ki} N', 'N*m/m') / reading[name].ki:.3f}"
        for name, row in rows.items()
    }
    values = r",\ ".join(f"{row.Ki:g}" for row in rows.values())
    return told(
        "Table 4, Ki",
        rf"{values}\ \mathrm{{N}},\ 1\ \mathrm{{N}} = 1\ \mathrm{{kN\,m/(km/h)/h}}",
        rf"{values}\ \mathrm{{N\,m/(km/h)/s}}",
        how="computed",
        sign_and_size=_columns(sizes),
        explanation="N is kN*m/(km/h) per hour, which differs from the reading by 1000/3600, not by 1000: kilo and "
        "hour nearly cancel. The reading per second is an inference, confirmed by simulation (`reproduce`).",
    )


def _table4_asmc() -> Erratum:
    rows = TABLE4_SLIDING_PRINTED
    D, K, rho = (r",\ ".join(dict.fromkeys(f"{row[i]:g}" for row in rows.values())) for i in range(3))
    return told(
        "Table 4, D, K, rho",
        rf"D = {D}\ \mathrm{{h}}^{{-1}},\ K = {K}\ \mathrm{{km/h^2}},\ \rho = {rho}\ \mathrm{{h}}^{{-1}}",
        rf"D = {D}\ \mathrm{{N\,m/(km/h)}},\ K = {K}\ \mathrm{{N\,m}},\ \rho = {rho}\ \mathrm{{s}}^{{-1}}",
        how="computed",
        sign_and_size=_columns({name: _sliding_sizes(*row[:3]) for name, row in rows.items()}),
        explanation="1/h and km/h^2 are the units of (39), not of (41), and an integral that acts within an hour does "
        "nothing in a stop of a minute. The readings are inferences, confirmed by simulation (`reproduce`).",
    )


def _sliding_sizes(D: float, K: float, rho: float) -> str:
    """One column's D, K, rho as printed and as read."""
    D0, K0 = to_unit(f"{D} 1/h", "1/s"), to_unit(f"{K} km/h^2", "m/s^2")
    ratio = _WHEEL.radius / _WHEEL.inertia
    return (
        f"as rates, the units of (39), D and K would be {D0:.2e} 1/s and {K0:.2e} m/s^2, i.e. torques of "
        f"{D0 / ratio:.2e} N*m/(m/s) and {K0 / ratio:.2e} N*m; as read {D / KMH:.2f} N*m/(m/s) and {K:g} N*m, i.e. "
        f"{D / KMH * ratio:.2e} 1/s and {K * ratio:.2e} m/s^2; rho as printed {to_unit(f'{rho} 1/h', '1/s'):.2e} 1/s"
    )


def _table5() -> tuple[Erratum, Erratum]:
    v0, v1 = (speed * KMH for speed in printed.SPEEDS_KMH)
    scale = AS_PUBLISHED_INERTIA_SCALE
    kinetic = 0.5 * scale * PARK2008.mass * (v0**2 - v1**2)
    joules = printed.TABLE5_ENERGY["PI"] * 1e14 / scale
    energy = told(
        "Table 5, energy",
        rf"{printed.TABLE5_ENERGY['PI'] * 1e7:.2f} \times 10^{{-7}}\ \mathrm{{kN\,m}}",
        rf"{printed.TABLE5_ENERGY['PI'] * 1e7:.2f} \times 10^{{7}} \text{{ as published}} = "
        rf"{joules / 1e6:.1f} \times 10^{{6}}\ \mathrm{{J}}",
        how="computed",
        sign_and_size=(
            f"printed {printed.TABLE5_ENERGY['PI'] * 1e3:.2e} J; the kinetic energy to be lost is "
            f"{kinetic / scale:.3g} J in SI, {kinetic:.3g} J at inertia scale {scale:g}, and {scale:g} times that, "
            f"{scale * kinetic:.3g}, is the size of the 1.77e7 of p. 56"
        ),
        explanation="The table's exponent and kilo are wrong; p. 56 has 10^7 N*m. That number is 3.6 times the joules "
        "of a run with inertia scale 3.6. The exact value (mass step, slip losses) takes a simulation (`reproduce`).",
    )
    decelerations = {rail: mu * PARK2008.wheel_load / PARK2008.mass for rail, mu in printed.PEAK_ADHESION.items()}
    times = {rail: (v0 - v1) / a for rail, a in decelerations.items()}
    heavy = times["wet"] * PARK2008.mass_loaded / PARK2008.mass
    least = _least_time(scale, v0, v1)
    duration = told(
        "Table 5 / (4), braking time",
        rf"{min(printed.TABLE5_TIMES):g} \text{{ to }} {max(printed.TABLE5_TIMES):g}\ \mathrm{{s}}",
        rf"{times['dry']:.1f}\ \mathrm{{s}} \text{{ in SI at peak adhesion; at inertia scale }} {scale:g}: "
        rf"\ge {least:.1f}\ \mathrm{{s}}",
        how="computed",
        sign_and_size=(
            f"0.30 N/M = {decelerations['dry']:.2f} m/s^2 on dry rail stops from 100 to 5 km/h in {times['dry']:.1f} s "
            f"({times['wet']:.1f} s wet, {heavy:.1f} s wet and loaded): before the step at "
            f"{printed.MASS_STEP_TIME:g} s. At inertia scale {scale:g} the step is reached and peak adhesion all the "
            f"way gives {least:.1f} s"
        ),
        explanation="The published times need M, J and B multiplied by 3.6 (speeds in km/h, forces in N). That all "
        "sixteen numbers follow takes a simulation (`reproduce`); peak adhesion gives the bound.",
    )
    return energy, duration


def _least_time(scale: float, v0: float, v1: float) -> float:
    """Braking time, s, at peak adhesion, dry and empty until the step, then wet and loaded; resistance left out."""
    load = PARK2008.wheel_load
    dry = printed.PEAK_ADHESION["dry"] * load / (scale * PARK2008.mass)
    wet = printed.PEAK_ADHESION["wet"] * load / (scale * PARK2008.mass_loaded)
    left = v0 - v1 - dry * printed.MASS_STEP_TIME
    return (v0 - v1) / dry if left <= 0 else printed.MASS_STEP_TIME + left / wet
