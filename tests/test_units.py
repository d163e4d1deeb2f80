"""Numbers with units: conversion, refusal, and that no text can break or hang the parser; rounding."""

import math
from fractions import Fraction
from typing import ClassVar

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from railslip_ctrl.cli.options import Number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.notation import cite
from railslip_ctrl.core.units import ms_down, ms_up, quantity, rounded, rounded_down, rounded_up, shown, to_unit
from railslip_ctrl.identification.logs import find_columns
from railslip_ctrl.model.vehicle import Record


@pytest.mark.parametrize(("value", "unit", "expected"), [
    (3517, "kg", 3517.0), (Fraction(1, 4), "kg", 0.25), (" 3.5e1 ", "kg", 35.0), (".5", "1", 0.5),
    *((repr(number), "kg", number) for number in (5e-324, -1.7976931348623157e308, 0.1 + 0.2)),
    ("34.5 kN", "N", 34_500.0), ("68t", "kg", 68_000.0), ("65 N*m/(km/h)", "N*m/(m/s)", 65.0 * 3.6),
    ("0.63 N/(m/s)²", "N/(m/s)^2", 0.63), ("60.35 kg m^2", "kg*m^2", 60.35), ("0.25 N*m*s/rad", "N*m*s", 0.25),
    ("2 Hz", "1/s", 2.0), ("60 rpm", "rad/s", 2 * math.pi), ("13.2 %", "1", 0.132), ("-1 m", "m", -1.0),
])  # fmt: skip
def test_value_is_converted_to_the_asked_unit(value: object, unit: str, expected: float) -> None:
    # conversions are a product or two in floating point
    assert to_unit(value, unit, name="x") == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("value", "unit", "message"), [
    ("65 N*m", "kg", "'65 N*m' has the wrong dimension; it must be convertible to 'kg'"),
    ("65 furlongz", "m", "'furlongz' in '65 furlongz' is not a unit; give a number in m"),
    ("heavy", "kg", "'heavy' is not a number in kg, with or without a unit"),
    ("nan", "kg", "nan is not allowed; give a finite number in kg"),
    (" -Inf ", "kg", "-inf is not allowed; give a finite number in kg"),
    (math.inf, "1", "inf is not allowed; give a finite number"),
    ("1e308 km", "m", "inf is not allowed; give a finite number in m"),
    (True, "kg", "True is not a number in kg"),
    ({"a": 1}, "kg", "a table is not a number in kg"),
    (None, "kg", "None is not a number in kg"),
    (16**9000, "kg", "an integer of 36001 bits is too large; give a finite number in kg"),
    # to Pint 2 Hz are 2 1/s, and so 2 rad/s: a factor of 2 pi lost in silence
    ("2 Hz", "rad/s", "'2 Hz' may mean cycles or radians; give a number in 'rad/s'"),
], ids=lambda one: str(one)[:30] if isinstance(one, str) else "")  # fmt: skip
def test_refusal_names_the_quantity_the_value_and_the_remedy(value: object, unit: str, message: str) -> None:
    for name in ("x", ""):
        with pytest.raises(InputError) as caught:
            to_unit(value, unit, name=name)
        assert str(caught.value) == (f"x: {message}" if name else message)


@pytest.mark.parametrize(("text", "unit", "remedy"), [
    (" 1.5e2 ", "s", "is text without a unit; write the unit too, or give the number of s without quotes"),
    ("3.6", "1", "is text; give the number without quotes"),
])  # fmt: skip
def test_text_that_needs_a_unit_is_refused_without_one(text: str, unit: str, remedy: str) -> None:
    with pytest.raises(InputError) as caught:
        to_unit(text, unit, name="x", text_needs_unit=True)
    assert str(caught.value) == f"x: {text!r} {remedy}"
    assert to_unit(text, unit) == float(text)  # the command line, where all is text
    for given_, of, expected in (("150 ms", "s", 0.15), ("13.2 %", "1", 0.132), (150, "s", 150.0)):
        assert to_unit(given_, of, text_needs_unit=True) == pytest.approx(expected, rel=1e-12)


class Given(Record):
    """A record as of a TOML file, with a key for each quantity of a log."""

    text_needs_unit: ClassVar[bool] = True
    time: float = quantity("s", "time", default=0.0)
    train_speed: float = quantity("m/s", "speed", default=0.0)
    wheel_angular_speed: float = quantity("rad/s", "angular speed", default=0.0)
    brake_torque: float = quantity("N*m", "torque", default=0.0)
    wheel_load: float = quantity("N", "load", default=0.0)
    mass: float = quantity("kg", "mass", default=0.0)


HEADER = {"time": "t", "train_speed": "v", "wheel_angular_speed": "omega", "brake_torque": "Tb"}
TRADE = [
    ("time", "s", 1e-3, "ms msec MS"),
    ("time", "s", 60.0, "min MIN Min"),
    ("train_speed", "m/s", 1 / 3.6, "km/h KM/H Km/h kmh kph KPH kmph KMPH km/hr km·h⁻¹ km.h-1"),
    ("train_speed", "m/s", 1.0, "m/s M/S mps m.s-1 m·s^-1"),
    ("train_speed", "m/s", 0.44704, "mph MPH mi/h"),
    ("train_speed", "m/s", 1852 / 3600, "kn kt"),
    ("wheel_angular_speed", "rad/s", math.pi / 30, "rpm RPM Rpm 1/min min-1 min^-1 min⁻¹ /min U/min Upm rev/min r/min"),
    ("wheel_angular_speed", "rad/s", 1.0, "rad/s RAD/S rads rad/sec"),
    ("brake_torque", "N*m", 1.0, "Nm N.m N-m N·m N⋅m nm NM"),
    ("brake_torque", "N*m", 1e3, "kNm kN.m kN-m kN*m KNM knm"),
    ("brake_torque", "N*m", 10.0, "daNm daN.m"),
    ("brake_torque", "N*m", 1e6, "MNm MN.m"),
    ("wheel_load", "N", 1e3, "kN KN kn"),
    ("mass", "kg", 1e3, "t T tonne tonnes Tonnes"),
]


@pytest.mark.parametrize(("name", "unit", "factor", "spellings"), TRADE, ids=lambda one: str(one)[:20])
def test_the_trade_s_names_mean_the_same_in_an_option_a_file_and_a_log(name, unit, factor, spellings) -> None:
    wanted = pytest.approx(2.0 * factor, rel=1e-12)  # a product or two
    for spelling in spellings.split():
        text = f"2 {spelling}"
        assert Number(unit).convert(text, None, None) == wanted, spelling
        assert getattr(Given.model_validate({name: text}), name) == wanted, spelling
        if name != "mass":
            header = [f"{cell} [{spelling}]" if key == name else cell for key, cell in HEADER.items()]
            header += [f"wheel load [{spelling}]"] * (name == "wheel_load")
            assert 2.0 * find_columns(header)[name].factor == wanted, spelling
    assert to_unit("9 kNm/(m/s)", "N*m/(m/s)") == pytest.approx(9e3)


@pytest.mark.parametrize(("text", "unit", "message"), [
    *((f"40 {ton}", "kg", "may be a tonne, a short or a long ton; write t,") for ton in ("tons", "ton", "TON", "kton")),
    *((f"3 {per}", "rad/s", "may mean cycles or radians") for per in ("1/s", "s-1", "1/h")),  # 2 pi apart
    ("3 mNm", "N*m", "has the wrong dimension"), ("3 MNM", "N*m", "is not a unit"),  # milli or mega
    ("3 psi", "N*m", "wrong dimension"), ("3 C", "N", "wrong dimension"), ("10² m", "m", "is not a unit"),
])  # fmt: skip
def test_a_unit_of_two_meanings_is_asked_back(text: str, unit: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        to_unit(text, unit)


TOWERS = ("m**999999999", "m**9**9**9**9", "m^4^4", "m²^4", "(((((((min^4)^4)^4)^4)^4)^4)^4)^4", "m*99999999**99999999")


@pytest.mark.parametrize("unit", [*TOWERS, "m.__class__", "m**-(9)", "__import__('os')"])
def test_power_towers_and_code_never_reach_the_unit_parser(unit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("railslip_ctrl.core.units._registry", lambda: pytest.fail("the text reached Pint"))
    with pytest.raises(InputError, match="is not a unit"):
        to_unit(f"1 {unit}", "m", name="x")


# of m squared squared ... Pint alone reads 2**2**2**2**2**2**2, and computes it
@pytest.mark.parametrize("unit", ["dB", "degC", "(m", "m)", "()", "N*", "*", "m//s", "N per m", "m" + 7 * " squared"])
def test_what_is_no_multiple_of_a_unit_is_refused(unit: str) -> None:
    with pytest.raises(InputError):
        to_unit(f"3 {unit}", "1", name="x")


_UNIT_TEXT = st.lists(
    st.sampled_from(["m", "min", "dB", "degC", "squared", "per", "°", "%", "(", ")", "*", "/", "**", "^", "²", " "])
    | st.sampled_from(["1", "4", "9", "-", ".", "_", "e", "kg", "\n", "#", "'", "\\", "µ", "Δ"]),
    max_size=20,
).map(lambda words: "1 " + "".join(words))


@given(text=st.text(max_size=80) | _UNIT_TEXT, unit=st.sampled_from(["m", "1", "N/(m/s)^2"]))
@example(text="1 m**999999999", unit="m")
@settings(max_examples=40, deadline=5000)  # ms; the first call builds Pint's registry, a hang takes for ever
def test_any_text_is_a_finite_number_or_an_input_error_of_one_line(text: str, unit: str) -> None:
    refusal, number = "", math.nan
    try:
        number = to_unit(text, unit, name="x")
    except InputError as error:
        refusal = str(error)
    assert math.isfinite(number) or (refusal.startswith("x: ") and refusal.isprintable())


@given(st.floats(1e-9, 1e9).flatmap(lambda size: st.sampled_from((size, -size))), st.integers(1, 6))
def test_rounding_promises_no_more_and_keeps_what_has_the_digits(value: float, digits: int) -> None:
    low, near, high = (f(value, digits) for f in (rounded_down, rounded, rounded_up))
    margin = 2e-12 * abs(value)
    assert low <= value + margin
    assert high >= value - margin
    assert near in (pytest.approx(low, rel=1e-9), pytest.approx(high, rel=1e-9))
    assert high - low <= 10.0 ** (1 - digits) * abs(value) * (1 + 1e-9)
    kept = float(f"{value:.{digits - 1}e}")
    assert (rounded_down(kept, digits), rounded_up(kept, digits)) == pytest.approx((kept, kept), rel=1e-12)


def test_values_are_shown_short_and_citations_are_of_a_source_and_an_ms_is_on_the_safe_side() -> None:
    up = [ms_up(x) for x in (1.9326, 1.9, 2.0 * (1 + 5e-7), 123.4, math.inf)]  # two decimals
    assert up == ["1.94", "1.90", "2.00", "124", "inf"]
    assert [ms_down(x) for x in (1.9379, 1.9, 1.0)] == ["1.93", "1.90", "1.00"]
    assert shown("a" * 1000) == repr("a" * 60 + "...")
    assert len(shown(object())) <= 63
    assert shown("two\nlines") == r"'two\nlines'"
    assert cite("Park2008", "(45)") == "[Park2008] (45)"
    with pytest.raises(KeyError):
        cite("Nobody1999")
