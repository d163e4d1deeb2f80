"""Numbers with units: conversion, refusal, and that no text can break or hang the parser."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, shown, to_unit

# conversions are a product or two in floating point
ROUNDING = 1e-12


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (3517, "kg", 3517.0),
        (np.int64(3), "kg", 3.0),
        (np.float32(0.5), "kg", 0.5),
        (Fraction(1, 4), "kg", 0.25),
        ("3517", "kg", 3517.0),
        (" 3.5e1 ", "kg", 35.0),
        (".5", "1", 0.5),
        ("34.5 kN", "N", 34_500.0),
        ("68t", "kg", 68_000.0),
        ("430 mm", "m", 0.43),
        ("100 km/h", "m/s", 100.0 * KMH),
        ("65 N*m/(km/h)", "N*m/(m/s)", 65.0 * 3.6),
        ("65 N·m/(km/h)", "N*m/(m/s)", 65.0 * 3.6),
        ("0.63 N/(m/s)²", "N/(m/s)^2", 0.63),
        ("0.63 N/(m/s)**2", "N/(m/s)^2", 0.63),
        ("60.35 kg m^2", "kg*m^2", 60.35),
        ("2 s^-1", "1/s", 2.0),
        ("2 1/s", "1/s", 2.0),
        ("0.25 N*m*s/rad", "N*m*s", 0.25),
        ("13.2 %", "1", 0.132),
        ("-1 m", "m", -1.0),
    ],
)
def test_value_is_converted_to_the_asked_unit(value: object, unit: str, expected: float) -> None:
    assert to_unit(value, unit, name="x") == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.parametrize(
    ("value", "unit", "message"),
    [
        ("65 N*m", "kg", "x: '65 N*m' has the wrong dimension; it must be convertible to 'kg'"),
        ("65 N", "1", "x: '65 N' has the wrong dimension; it must be convertible to '1'"),
        ("65 furlongz", "m", "x: 'furlongz' in '65 furlongz' is not a unit; give a number in m"),
        ("heavy", "kg", "x: 'heavy' is not a number in kg, with or without a unit"),
        ("", "kg", "x: '' is not a number in kg, with or without a unit"),
        ("nan", "kg", "x: nan is not allowed; give a finite number in kg"),
        (" -Inf ", "kg", "x: -inf is not allowed; give a finite number in kg"),
        (math.inf, "1", "x: inf is not allowed; give a finite number"),
        ("1e308 km", "m", "x: inf is not allowed; give a finite number in m"),
        (True, "kg", "x: True is not a number in kg"),
        ([1.0], "kg", "x: a list is not a number in kg"),
        ({"a": 1}, "kg", "x: a table is not a number in kg"),
        (None, "kg", "x: None is not a number in kg"),
        pytest.param(
            16**9000, "kg", "x: an integer of 36001 bits is too large; give a finite number in kg", id="36001 bits"
        ),
    ],
)
def test_refusal_names_the_quantity_the_value_and_the_remedy(value: object, unit: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        to_unit(value, unit, name="x")
    assert str(caught.value) == message


def test_refusal_without_a_name_begins_with_the_value() -> None:
    with pytest.raises(InputError, match=r"^'heavy' is not a number"):
        to_unit("heavy", "kg")


@pytest.mark.parametrize(
    ("text", "unit", "remedy"),
    [
        ("150", "s", "is text without a unit; write the unit too, or give the number of s without quotes"),
        (" 1.5e2 ", "s", "is text without a unit; write the unit too, or give the number of s without quotes"),
        ("3.6", "1", "is text; give the number without quotes"),
    ],
)
def test_text_that_needs_a_unit_is_refused_without_one(text: str, unit: str, remedy: str) -> None:
    with pytest.raises(InputError) as caught:
        to_unit(text, unit, name="x", text_needs_unit=True)
    assert str(caught.value) == f"x: {text!r} {remedy}"
    assert to_unit(text, unit) == float(text)  # the command line, where all is text


def test_text_with_its_unit_and_plain_numbers_need_no_more() -> None:
    assert to_unit("150 ms", "s", text_needs_unit=True) == pytest.approx(0.15, rel=ROUNDING)
    assert to_unit("13.2 %", "1", text_needs_unit=True) == pytest.approx(0.132, rel=ROUNDING)
    assert to_unit(150, "s", text_needs_unit=True) == 150.0


@pytest.mark.parametrize(
    "text",
    [
        "1 m**999999999",
        "1 m**9**9**9**9",
        "1 m^4^4",
        "1 m²^4",
        "1 (((((((min^4)^4)^4)^4)^4)^4)^4)^4",
        "1 m*99999999**99999999",
        "1 m.__class__",
        "1 m**-(9)",
        "1 __import__('os')",
    ],
)
def test_power_towers_and_code_never_reach_the_unit_parser(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("railslip_ctrl.core.units._registry", lambda: pytest.fail("the text reached Pint"))
    with pytest.raises(InputError, match="is not a unit"):
        to_unit(text, "m", name="x")


# Pint alone reads 2**2**2**2**2**2**2 here, and computes it
SQUARED = "1 m squared squared squared squared squared squared squared"


@pytest.mark.parametrize(
    "text", ["3 dB", "3 degC", "3 (m", "3 m)", "3 ()", "3 N*", "3 *", "3 m//s", "3 N per m", SQUARED]
)
def test_what_is_no_multiple_of_a_unit_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        to_unit(text, "1", name="x")


_UNIT_TEXT = st.lists(
    st.sampled_from(["m", "min", "dB", "degC", "squared", "per", "°", "%", "(", ")", "*", "/", "**", "^", "²", " "])
    | st.sampled_from(["1", "4", "9", "-", ".", "_", "e", "kg", "\n", "#", "'", "\\", "µ", "Δ"]),
    max_size=20,
).map(lambda words: "1 " + "".join(words))


@given(text=st.text(max_size=80) | _UNIT_TEXT, unit=st.sampled_from(["m", "1", "N/(m/s)^2"]))
@example(text="1 m**999999999", unit="m")
@settings(max_examples=500, deadline=5000)  # ms; the first call builds Pint's registry, a hang takes for ever
def test_any_text_is_a_finite_number_or_an_input_error_of_one_line(text: str, unit: str) -> None:
    refusal = ""
    number = math.nan
    try:
        number = to_unit(text, unit, name="x")
    except InputError as error:
        refusal = str(error)
    assert math.isfinite(number) or (refusal.startswith("x: ") and refusal.isprintable())


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_written_as_text_is_that_number(number: float) -> None:
    assert to_unit(repr(number), "kg", name="x") == number


def test_shown_values_are_short() -> None:
    assert shown("a" * 1000) == repr("a" * 60 + "...")
    assert len(shown(object())) <= 63
    assert shown("two\nlines") == r"'two\nlines'"


def test_hertz_are_not_taken_for_radians() -> None:
    """To Pint 2 Hz are 2 1/s, and so 2 rad/s: a factor of 2 pi lost in silence."""
    with pytest.raises(InputError, match="cycles or radians"):
        to_unit("2 Hz", "rad/s")
    assert to_unit("60 rpm", "rad/s") == pytest.approx(2 * math.pi)
    assert to_unit("2 Hz", "1/s") == 2.0
