"""Vehicles: the published record, TOML files, railtoolkit files, and every way a file can be wrong."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.user_files import LARGEST_FILE, one_line, read_toml
from railslip_ctrl.model.vehicle import GRAVITY, PARK2008, TABLE4_PI, USUAL_RANGES, Vehicle, doubts, remarks
from railslip_ctrl.model.vehicle_files import VehicleKeys, load_vehicle, read_rolling_stock

DATA = Path(__file__).parent / "data" / "rolling-stock"
DESIRO = DATA / "siemens_desiro_classic.yaml"
FACS = DATA / "Facs124.yaml"
TRAXX = DATA / "Bombardier_Traxx_2_P160.yaml"
EXAMPLE = Path(__file__).parents[1] / "designs" / "vehicles" / "desiro_classic.toml"

# the expected values are the same few products in another order
ROUNDING = 1e-12

PARK_TOML = """
name = "as published"
mass = 3517
mass_loaded = "5.276 t"
wheel_load = "34.5 kN"
wheel_load_loaded = 34500
inertia_scale = 3.6
[wheel]
radius = "43 cm"
inertia = 60.35
viscous_friction = 0.25
[resistance]
quadratic = "0.63 N/(m/s)^2"
[actuator]
dead_time = "150 ms"
lag = 0.6
"""


def _toml(folder: Path, text: str) -> Path:
    path = folder / "vehicle.toml"
    path.write_text(text, encoding="utf-8")
    return path


def _yaml(folder: Path, text: str, name: str = "stock.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def _message(path: Path) -> str:
    """The error of a bad file, without its folder; one printable line."""
    with pytest.raises(InputError) as caught:
        load_vehicle(path)
    message = str(caught.value)
    assert message.isprintable()
    return message.replace(str(path.parent) + os.sep, "")


# --- records -----------------------------------------------------------------------------------------------


def test_published_wheel_load_is_the_weight_of_the_empty_quarter_car() -> None:
    # printed to three digits: 34 500 for 34 490
    assert PARK2008.mass * GRAVITY == pytest.approx(PARK2008.wheel_load, rel=5e-4)


def test_published_gains_are_table_4_per_kmh_in_si() -> None:
    assert TABLE4_PI["bristle"].kp == pytest.approx(2340.0, rel=ROUNDING)
    assert TABLE4_PI["beam"].ki == pytest.approx(194.4, rel=ROUNDING)


def test_inertia_scale_multiplies_mass_inertia_and_friction() -> None:
    scaled = PARK2008.model_copy(update={"inertia_scale": 3.6})
    assert scaled.effective_mass == pytest.approx(3.6 * 3517.0, rel=ROUNDING)
    assert scaled.effective_inertia == pytest.approx(3.6 * 60.35, rel=ROUNDING)
    assert scaled.effective_viscous_friction == pytest.approx(3.6 * 0.25, rel=ROUNDING)


def test_loaded_vehicle_uses_the_loaded_mass_and_wheel_load() -> None:
    vehicle = PARK2008.model_copy(update={"wheel_load_loaded": 50_000.0}).loaded()
    assert (vehicle.mass, vehicle.wheel_load) == (5276.0, 50_000.0)


def test_records_are_immutable_and_refuse_a_load_that_lightens() -> None:
    with pytest.raises(InputError, match="Vehicle: mass: cannot be set"):
        PARK2008.mass = 1.0  # type: ignore[misc]
    with pytest.raises(InputError, match="mass_loaded: 3000 is not allowed; give a value >= mass = 3517"):
        Vehicle.model_validate({**PARK2008.model_dump(), "mass_loaded": 3000.0})


# --- TOML --------------------------------------------------------------------------------------------------


def test_published_vehicle_written_as_toml_is_the_published_vehicle(tmp_path: Path) -> None:
    vehicle = load_vehicle(_toml(tmp_path, PARK_TOML))
    expected = PARK2008.model_copy(
        update={"name": "as published", "inertia_scale": 3.6, "source": "vehicle.toml", "notes": ()}
    )
    # the text's own units cost a rounding: compared number by number
    assert vehicle.wheel.radius == pytest.approx(0.43, rel=ROUNDING)
    assert vehicle.actuator == expected.actuator
    assert vehicle.resistance == expected.resistance
    exact = {"wheel": expected.wheel, "mass_loaded": expected.mass_loaded}
    assert vehicle.mass_loaded == pytest.approx(5276.0, rel=ROUNDING)
    assert vehicle.model_copy(update=exact) == expected


def test_mass_alone_takes_weight_as_wheel_load_and_the_published_rest_and_says_so(tmp_path: Path) -> None:
    vehicle = load_vehicle(_toml(tmp_path, "mass = 4000\n"))
    assert vehicle.name == "vehicle"
    assert vehicle.mass_loaded == 4000.0
    assert vehicle.wheel_load == pytest.approx(4000.0 * 9.80665, rel=ROUNDING)
    assert vehicle.wheel_load_loaded == vehicle.wheel_load
    assert (vehicle.wheel, vehicle.actuator) == (PARK2008.wheel, PARK2008.actuator)
    assert vehicle.resistance.model_dump() == {"constant": 0.0, "linear": 0.0, "quadratic": 0.0}
    notes = " ".join(vehicle.notes)
    for said in ("No load", "radius = 0.43 m", "inertia = 60.35 kg*m^2", "dead_time = 0.15 s", "No travelling"):
        assert said in notes


def test_only_the_lacking_keys_of_a_table_are_the_published_ones(tmp_path: Path) -> None:
    vehicle = load_vehicle(_toml(tmp_path, "mass = 4000\n[wheel]\nradius = 0.5\n[actuator]\nlag = 0\n"))
    assert (vehicle.wheel.radius, vehicle.wheel.inertia) == (0.5, 60.35)
    assert (vehicle.actuator.dead_time, vehicle.actuator.lag) == (0.15, 0.0)
    assert not any("radius" in note or "lag =" in note for note in vehicle.notes)


def test_loaded_wheel_load_left_out_grows_with_the_mass(tmp_path: Path) -> None:
    vehicle = load_vehicle(_toml(tmp_path, 'mass = 4000\nmass_loaded = 6000\nwheel_load = "40 kN"\n'))
    assert vehicle.wheel_load_loaded == pytest.approx(60_000.0, rel=ROUNDING)


def test_byte_order_mark_and_windows_line_ends_are_read(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_bytes(b"\xef\xbb\xbfmass = 4000\r\n[wheel]\r\nradius = 0.5\r\n")
    assert load_vehicle(path).wheel.radius == 0.5


# --- allowed, and yet far from what vehicles have -----------------------------------------------------------

PLAUSIBLE = """
mass = 4000
mass_loaded = 6000
wheel_load = 39000
wheel_load_loaded = 58000
[wheel]
radius = 0.43
inertia = 60
viscous_friction = 0.25
[resistance]
quadratic = 0.6
[actuator]
dead_time = 0.15
lag = 0.6
"""

# what stands in place of a line above, and what is said of it: the value, the range, the remedy
IMPLAUSIBLE = {
    "mass = 4": ("mass = 4 kg", "1000 to 45000 kg", 'if 4 t is meant, give "4 t"'),
    "mass = 60": ("mass = 60 kg", "1000 to 45000 kg", "divide the mass of a whole vehicle by the number of its axles"),
    "mass_loaded = 88000": ("mass_loaded = 88000 kg", "1000 to 45000 kg", "by the number of its axles"),
    # half and three halves of the weight, 39.2 and 58.8 kN
    "wheel_load = 39.2": ("wheel_load = 39.2 N", "19600 to 58800 N", 'if 39.2 kN is meant, give "39.2 kN"'),
    "wheel_load_loaded = 5900": ("wheel_load_loaded = 5900 N", "29400 to 88300 N", "check the number and its unit"),
    "radius = 4": ("radius = 4 m", "0.15 to 0.75 m", "check the number and its unit"),
    "radius = 430": ("radius = 430 m", "0.15 to 0.75 m", 'if 430 mm is meant, give "430 mm"'),
    "radius = 43": ("radius = 43 m", "0.15 to 0.75 m", 'if 43 cm is meant, give "43 cm"'),
    # M r^2 = 739.6 kg m^2
    "inertia = 1e4": ("inertia = 10000 kg*m^2", "3.7 to 370 kg*m^2", "check the number and its unit"),
    "inertia = 0.6": ("inertia = 0.6 kg*m^2", "3.7 to 370 kg*m^2", "check the number and its unit"),
    # 0.01 times 39 kN times r^2/v = 2.60
    "viscous_friction = 250": ("viscous_friction = 250 N*m*s", "0 to 2.6 N*m*s", "check the number and its unit"),
    # 60 v^2 at 100 km/h
    "quadratic = 60": ("resistance = 46296.3 N at 100 km/h", "0 to 1950 N at 100 km/h", "check the number"),
    "dead_time = 150": ("dead_time = 150 s", "0 to 2 s", 'if 150 ms is meant, give "150 ms"'),
    "lag = 600": ("lag = 600 s", "0 to 10 s", 'if 600 ms is meant, give "600 ms"'),
}


def _with(line: str) -> str:
    """The plausible file with a line of the same key in place of its own."""
    key = line.split(" = ")[0]
    return re.sub(rf"^{key} = .*$", line, PLAUSIBLE, flags=re.MULTILINE)


@pytest.mark.parametrize("line", IMPLAUSIBLE)
def test_an_implausible_number_is_taken_and_told_with_range_and_remedy(tmp_path: Path, line: str) -> None:
    vehicle = load_vehicle(_toml(tmp_path, _with(line)))
    (told,) = doubts(vehicle)  # one number, one sentence, though others are computed from it
    value, usual, remedy = IMPLAUSIBLE[line]
    assert told.startswith(f"{value} is taken as given, but is outside the usual {usual} (")
    assert remedy in told.partition("); ")[2]
    assert remarks(vehicle) == (*vehicle.notes, told)


def test_every_usual_range_has_a_case_outside_it() -> None:
    assert {value.split(" = ")[0] for value, _, _ in IMPLAUSIBLE.values()} == {one.key for one in USUAL_RANGES}


@pytest.mark.parametrize(
    ("line", "told"),
    [("dead_time = 2", 0), ("dead_time = 2.001", 1), ("mass_loaded = 45000", 0), ("mass_loaded = 45001", 1)],
)  # fmt: skip
def test_ends_of_a_range_are_usual(tmp_path: Path, line: str, told: int) -> None:
    text = _with(line).replace("wheel_load_loaded = 58000\n", "")  # the weight of the loaded mass, then
    assert len(doubts(load_vehicle(_toml(tmp_path, text)))) == told


@pytest.mark.parametrize("path", [EXAMPLE, DESIRO, FACS, TRAXX], ids=lambda path: path.stem)
def test_of_real_vehicles_nothing_is_doubted(path: Path) -> None:
    for vehicle in (load_vehicle(path), load_vehicle(path).loaded()):
        assert doubts(vehicle) == ()


def test_of_the_published_vehicle_nothing_is_doubted_in_either_reading_of_its_units(tmp_path: Path) -> None:
    for vehicle in (PARK2008, PARK2008.loaded(), PARK2008.model_copy(update={"inertia_scale": 3.6})):
        assert doubts(vehicle) == ()
    assert doubts(load_vehicle(_toml(tmp_path, PLAUSIBLE))) == ()


LINEARIZE, SIMULATE = ("linearize", "--rail", "dry"), ("simulate", "--controller", "slide-protection")


@pytest.mark.parametrize(
    ("words", "line", "doubted"),
    [
        (LINEARIZE, "dead_time = 150", "dead_time = 150 s"),
        ((*LINEARIZE, "--dead-time", "2.5"), "lag = 0.6", "dead_time = 2.5 s"),
        ((*LINEARIZE, "--dead-time", "0.2"), "dead_time = 150", ""),
        (SIMULATE, "mass_loaded = 88000", "mass_loaded = 88000 kg"),
        ((*SIMULATE, "--dead-time", "2.5"), "lag = 0.6", "dead_time = 2.5 s"),
    ],
)
def test_commands_tell_it_of_the_vehicle_in_use(
    tmp_path: Path, railslip: Any, words: tuple[str, ...], line: str, doubted: str
) -> None:
    path = _toml(tmp_path, _with(line))
    status, out, err = railslip(*words, "--vehicle", path, "--json")
    assert status == 0
    assert err.count("is taken as given, but is outside the usual") == bool(doubted)
    assert f"railslip: note: vehicle: {doubted}" in err or not doubted
    assert (f'"{doubted} is taken as given' in out) == bool(doubted)


# --- railtoolkit -------------------------------------------------------------------------------------------


def test_railtoolkit_file_alone_takes_four_axles_and_the_published_wheel_and_brake() -> None:
    vehicle = load_vehicle(DESIRO)
    assert vehicle.name == "Siemens Desiro Classic"
    assert vehicle.mass == pytest.approx(68_000.0 / 4, rel=ROUNDING)
    assert vehicle.mass_loaded == pytest.approx(88_000.0 / 4, rel=ROUNDING)
    assert vehicle.wheel_load == pytest.approx(17_000.0 * GRAVITY, rel=ROUNDING)
    assert vehicle.wheel_load_loaded == pytest.approx(22_000.0 * GRAVITY, rel=ROUNDING)
    assert (vehicle.wheel, vehicle.actuator) == (PARK2008.wheel, PARK2008.actuator)
    assert vehicle.source == "siemens_desiro_classic.yaml [railtoolkit]"
    notes = " ".join(vehicle.notes)
    for said in ("4 axles are assumed", "Published wheel", "Published actuator", "empty mass"):
        assert said in notes


def test_running_resistance_at_100_kmh_is_the_sum_of_the_coefficients_per_mille_of_the_weight() -> None:
    vehicle = load_vehicle(DESIRO)
    speed = 100.0 / 3.6
    force = vehicle.resistance.constant + vehicle.resistance.linear * speed + vehicle.resistance.quadratic * speed**2
    assert force == pytest.approx((3.0 + 1.4 + 3.9) * 1e-3 * vehicle.mass * GRAVITY, rel=ROUNDING)
    # at half that speed a half of the linear part and a quarter of the quadratic one
    force = vehicle.resistance.linear * speed / 2 + vehicle.resistance.quadratic * speed**2 / 4
    assert force == pytest.approx((0.7 + 0.975) * 1e-3 * vehicle.mass * GRAVITY, rel=ROUNDING)


def test_rotating_mass_is_not_counted_twice_and_the_inertia_it_implies_is_told() -> None:
    # (1.08 - 1) * 17 000 kg * (0.43 m)^2
    assert any("J = 251.5 kg*m^2" in note and "60.35" in note for note in load_vehicle(DESIRO).notes)


def test_absent_load_limit_and_resistance_coefficient_are_told() -> None:
    vehicle = load_vehicle(TRAXX)
    assert vehicle.mass_loaded == vehicle.mass == 21_250.0
    assert vehicle.resistance.linear == 0.0
    notes = " ".join(vehicle.notes)
    assert "No load is given" in notes
    assert "rolling_resistance of the running resistance not given" in notes
    assert "load" not in " ".join(load_vehicle(FACS).notes).replace("when loaded", "")


def test_toml_wins_over_the_railtoolkit_file_key_by_key(tmp_path: Path) -> None:
    shutil.copy(DESIRO, tmp_path)
    text = f"""
        name = "mine"
        rolling_stock = "{DESIRO.name}"
        axles = 6
        mass = "12 t"
        [resistance]
        constant = 1.0
        """
    vehicle = load_vehicle(_toml(tmp_path, text))
    assert (vehicle.name, vehicle.mass, vehicle.resistance.constant) == ("mine", 12_000.0, 1.0)
    # the YAML's load on each of six axles is added to the mass of the TOML, and the rest keeps the YAML's coefficients
    assert vehicle.mass_loaded == pytest.approx(12_000.0 + 20_000.0 / 6, rel=ROUNDING)
    assert vehicle.resistance.linear == pytest.approx(1.4e-3 * 12_000.0 * GRAVITY * 0.036, rel=ROUNDING)
    assert vehicle.source == "vehicle.toml with siemens_desiro_classic.yaml [railtoolkit]"


def test_example_design_has_six_axles_its_own_wheel_and_no_assumption_left() -> None:
    vehicle = load_vehicle(EXAMPLE)
    assert vehicle.mass == pytest.approx(68_000.0 / 6, rel=ROUNDING)
    assert vehicle.wheel.radius == pytest.approx(0.385, rel=ROUNDING)
    assert not any("assumed" in note or "Published" in note for note in vehicle.notes)


def test_path_of_the_rolling_stock_is_relative_to_the_toml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_vehicle(EXAMPLE).mass_loaded > 0.0


TWO = """
vehicles:
  - {name: first, id: A1, mass: 40}
  - {name: second, id: B2, mass: 6.0e+1}
"""


def test_vehicle_is_chosen_by_its_id(tmp_path: Path) -> None:
    _yaml(tmp_path, TWO)
    vehicle = load_vehicle(_toml(tmp_path, 'rolling_stock = "stock.yaml"\nvehicle_id = "B2"\n'))
    assert (vehicle.name, vehicle.mass) == ("second", 15_000.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds 2 vehicles; give vehicle_id in a TOML file, one of 'A1', 'B2'"),
        ('vehicle_id = "B2x"\n', "vehicle_id: no vehicle 'B2x'; did you mean 'B2'? the file has 'A1', 'B2'"),
    ],
)
def test_vehicle_that_is_not_determined_lists_the_ids(tmp_path: Path, text: str, message: str) -> None:
    _yaml(tmp_path, TWO)
    found = _message(_toml(tmp_path, 'rolling_stock = "stock.yaml"\n' + text))
    assert found == f"vehicle.toml: rolling_stock: stock.yaml: {message}"


def test_doubled_id_is_refused_and_a_long_list_of_ids_is_cut(tmp_path: Path) -> None:
    rows = "".join(f"  - {{name: n, id: V{i}, mass: 40}}\n" for i in range(12))
    _yaml(tmp_path, f"vehicles:\n{rows}  - {{name: n, id: V3, mass: 40}}\n")
    found = _message(_toml(tmp_path, 'rolling_stock = "stock.yaml"\nvehicle_id = "V3"\n'))
    assert found.endswith("vehicle_id: 2 vehicles have the id 'V3'; make it unique")
    assert _message(tmp_path / "stock.yaml").endswith("'V9' and 3 more")


def test_unknown_keys_and_empty_values_of_the_foreign_schema_are_ignored(tmp_path: Path) -> None:
    path = _yaml(tmp_path, "vehicles: [{name: n, id: i, mass: 4e1, load_limit: , colour: red}]")
    stock = read_rolling_stock(path)
    # YAML 1.1 readers take 4e1 for text, YAML 1.2 says a number
    assert (stock.mass, stock.load_limit) == (40.0, None)


ONE = "vehicles: [{{name: n, id: i, {}}}]"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ONE.format("length: 3"), "vehicle 'i': mass: missing; give it (t): mass of the empty vehicle"),
        (ONE.format("mass: -3"), "vehicle 'i': mass: -3 is not allowed; give a value > 0 (t)"),
        (ONE.format("mass: 0"), "vehicle 'i': mass: 0 is not allowed; give a value > 0 (t)"),
        (ONE.format("mass: .nan"), "vehicle 'i': mass: nan is not allowed; give a finite number in t"),
        (ONE.format("mass: true"), "vehicle 'i': mass: True is not a number in t"),
        (ONE.format("mass: [1]"), "vehicle 'i': mass: a list is not a number in t"),
        (ONE.format("mass: heavy"), "vehicle 'i': mass: 'heavy' is not a number in t, with or without a unit"),
        (
            ONE.format("mass: 1, load_limit: -1"),
            "vehicle 'i': load_limit: -1 is not allowed; give a value >= 0 (t)",
        ),
        (
            ONE.format("mass: 1, rotation_mass: 0.9"),
            "vehicle 'i': rotation_mass: 0.9 is not allowed; give a value >= 1",
        ),
        (
            ONE.format("mass: 1, air_resistance: -1"),
            "vehicle 'i': air_resistance: -1 is not allowed; give a value >= 0 (permille)",
        ),
        ("vehicles: [{name: 3, id: i, mass: 1}]", "vehicle 'i': name: 3 is not allowed; give text in quotes"),
        ("vehicles: []", "vehicles: missing or not a list of vehicles; give a railtoolkit rolling-stock file"),
        ("vehicles: [1]", "vehicles: missing or not a list of vehicles; give a railtoolkit rolling-stock file"),
        ("just text", "vehicles: missing or not a list of vehicles; give a railtoolkit rolling-stock file"),
        ("a: b: c", "not valid YAML: mapping values are not allowed in this context (at line 1, column 5)"),
        ("a: 2022-99-99", "not valid YAML: month must be in 1..12"),
        ("a: 1\n---\nb: 2\n", "not valid YAML: but found another document (at line 2, column 1)"),
        ("a: \x01", "not valid YAML: unacceptable character #x0001: control characters are not allowed in"),
        ("a: !!python/name:os.system x", "not valid YAML: could not determine a constructor for the tag"),
        ("a: &x [1]\nb: [*x, *x]\n", "aliases ('*x') are not read; write the value out in their place"),
        pytest.param(
            "vehicles: [{id: 0x" + "f" * 5000 + "}, {}]",
            "holds 2 vehicles; give vehicle_id in a TOML file, one of an integer of 20000 bits, None",
            id="id of 20000 bits",
        ),
        ("vehicles: [{name: n, id: 642, mass: 1}]", "vehicle 642: id: 642 is not allowed; give text in quotes"),
        pytest.param("[" * 100_000, "is nested more than 20 levels deep; give a railtoolkit file", id="deep"),
    ],
)
def test_wrong_railtoolkit_file_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    assert _message(_yaml(tmp_path, text)).startswith(f"stock.yaml: {message}")


# --- wrong TOML ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mass = -5", "mass: -5 is not allowed; give a value > 0 (kg)"),
        ("mass = 0", "mass: 0 is not allowed; give a value > 0 (kg)"),
        ("mass = nan", "mass: nan is not allowed; give a finite number in kg"),
        ("mass = -inf", "mass: -inf is not allowed; give a finite number in kg"),
        ("mass = true", "mass: True is not a number in kg"),
        ("mass = [3517]", "mass: a list is not a number in kg"),
        ("mass = 'heavy'", "mass: 'heavy' is not a number in kg, with or without a unit"),
        (
            "mass = 10\nactuator.dead_time = '150'",  # 150 ms were meant, 150 s would be read
            "actuator.dead_time: '150' is text without a unit; write the unit too, or give the number of s without",
        ),
        ("mass = 10\ninertia_scale = '3.6'", "inertia_scale: '3.6' is text; give the number without quotes"),
        ("mass = 10\ninertia_scale = true", "inertia_scale: True is not a number"),
        ("mass = '65 N*m'", "mass: '65 N*m' has the wrong dimension; it must be convertible to 'kg'"),
        ("mass = 1e308\nwheel.radius = 1e200\nmass_loaded = 1e-3", "wheel_load: inf is not allowed"),
        ("name = 'x'", "mass: missing; give mass (quarter car, kg) or rolling_stock (a railtoolkit file)"),
        ("mass = 10\nmass_loaded = 9", "mass_loaded: 9 is not allowed; give a value >= mass = 10 (kg)"),
        ("mass = 10\nwheel.radius = -0.4", "wheel.radius: -0.4 is not allowed; give a value > 0 (m)"),
        ("mass = 10\nwheel.viscous_friction = -1", "wheel.viscous_friction: -1 is not allowed; give a value >= 0 (N*m"),
        ("mass = 10\nactuator.lag = '3 m'", "actuator.lag: '3 m' has the wrong dimension"),
        ("mass = 10\ninertia_scale = 0", "inertia_scale: 0 is not allowed; give a value > 0"),
        ("mass = 10\nwheel = 3", "wheel: 3 is not allowed; give a table of keys"),
        ("name = 3", "name: 3 is not allowed; give text in quotes"),
        ("mass = 10\naxles = 4", "axles: only read with rolling_stock; remove it"),
        ("mass = 10\nvehicle_id = 'x'", "vehicle_id: only read with rolling_stock; remove it"),
        ("axles = 0", "axles: 0 is not allowed; give a value >= 1"),
        ("axles = 101", "axles: 101 is not allowed; give a value <= 100"),
        ("axles = 4.5", "axles: 4.5 is not allowed; give an integer"),
        ("axles = true", "axles: True is not allowed; give an integer"),
        ("mas = 10", "mas: unknown key; did you mean 'mass'? allowed: name, mass, mass_loaded, wheel_load,"),
        ("xyz = 10", "xyz: unknown key; allowed: name, mass,"),
        (
            "mass = 10\nwheel.radios = 1",
            "wheel.radios: unknown key; did you mean 'radius'? allowed: radius, inertia, viscous_friction",
        ),
        ('"two\\nlines" = 1', "'two\\nlines': unknown key;"),
        ("mass = -1\nname = 3", "name: 3 is not allowed; give text in quotes (and 1 more)"),
        ("mass = 1\nmass ==", "not valid TOML: Invalid value (at line 2, column 7)"),
        ("mass = 1\nmass = 2\n\n", "not valid TOML: Cannot overwrite a value (at line 2, column 9)"),
        pytest.param("mass = " + "9" * 5000, "not valid TOML: Exceeds the limit", id="5000 digits"),
        pytest.param("mass = 0x" + "f" * 5000, "mass: an integer of 20000 bits is too large", id="20000 bits"),
        pytest.param("mass = " + "[" * 100_000, "is nested too deeply; give plain tables of keys", id="deep list"),
        pytest.param("mass" + ".a" * 5_000 + " = 1", "mass: a table is not a number in kg", id="deep table"),
        (" \n", "the file is empty; give at least one key"),
        ("rolling_stock = 'none.yaml'", "rolling_stock: none.yaml: no such file; check the path"),
        ("rolling_stock = '.'", "rolling_stock: "),
    ],
)
def test_wrong_toml_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    assert _message(_toml(tmp_path, text)).startswith(f"vehicle.toml: {message}")


@pytest.mark.parametrize("suffix", [".toml", ".yaml"])
class TestFileItself:
    def test_missing(self, tmp_path: Path, suffix: str) -> None:
        assert _message(tmp_path / f"v{suffix}") == f"v{suffix}: no such file; check the path"

    def test_directory(self, tmp_path: Path, suffix: str) -> None:
        (tmp_path / f"v{suffix}").mkdir()
        assert _message(tmp_path / f"v{suffix}") == f"v{suffix}: is a directory; give a file"

    def test_empty(self, tmp_path: Path, suffix: str) -> None:
        (tmp_path / f"v{suffix}").touch()
        assert _message(tmp_path / f"v{suffix}") == f"v{suffix}: the file is empty; give at least one key"

    def test_binary(self, tmp_path: Path, suffix: str) -> None:
        (tmp_path / f"v{suffix}").write_bytes(b"ab\xff\xfe\x00")
        assert _message(tmp_path / f"v{suffix}") == f"v{suffix}: byte 3 is not UTF-8; save the file as UTF-8 text"

    def test_too_large(self, tmp_path: Path, suffix: str) -> None:
        (tmp_path / f"v{suffix}").write_bytes(b"#" * (LARGEST_FILE + 1))
        assert _message(tmp_path / f"v{suffix}").startswith(f"v{suffix}: is larger than 1000000 bytes")

    def test_unreadable(self, tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_: object, **__: object) -> None:
            raise PermissionError(13, "Permission denied")

        # not by chmod: it does not bind the superuser, whom containers run as
        (tmp_path / f"v{suffix}").touch()
        monkeypatch.setattr(Path, "open", refuse)
        assert _message(tmp_path / f"v{suffix}") == f"v{suffix}: cannot be read; check the file's permissions"

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
    def test_pipe_that_would_block(self, tmp_path: Path, suffix: str) -> None:
        os.mkfifo(tmp_path / f"v{suffix}")
        assert _message(tmp_path / f"v{suffix}") == f"v{suffix}: is not a regular file; give a file"

    def test_name_that_no_file_can_have(self, tmp_path: Path, suffix: str) -> None:
        assert "cannot be read" in _message(tmp_path / ("v" * 5000 + suffix))
        assert "check the path" in _message(tmp_path / ("v\0" + suffix))


def test_other_suffix_is_refused(tmp_path: Path) -> None:
    assert _message(tmp_path / "v.json") == "v.json: the file's name must end in .toml, .yaml or .yml"


@given(content=st.binary(max_size=200), suffix=st.sampled_from([".toml", ".yaml"]))
@settings(max_examples=300, deadline=None)
def test_any_bytes_are_refused_in_one_line(content: bytes, suffix: str) -> None:
    # 200 random bytes are never a vehicle
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"v{suffix}"
        path.write_bytes(content)
        _message(path)


_SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.dates()
_ANYTHING = st.recursive(
    _SCALARS, lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=5), inner, max_size=2)
)
_KEYS = st.sampled_from(sorted(VehicleKeys.model_fields)) | st.text(max_size=5)


@given(st.dictionaries(_KEYS, _ANYTHING, min_size=1, max_size=4))
@settings(max_examples=300, deadline=None)
def test_any_refused_values_make_one_printable_line(values: dict[str, object]) -> None:
    lines = []
    try:
        VehicleKeys.__pydantic_validator__.validate_python(values)  # below what makes its error one of the package
    except ValidationError as error:
        lines = [one_line(error, "v.toml", model=VehicleKeys), one_line(error, "v.toml")]
    assert all(line.startswith("v.toml: ") and line.isprintable() for line in lines)


def test_line_without_a_record_still_names_key_value_and_bound() -> None:
    with pytest.raises(ValidationError) as caught:
        VehicleKeys.__pydantic_validator__.validate_python({"wheel": {"radius": -0.4}})
    assert one_line(caught.value, "law.toml") == "law.toml: wheel.radius: -0.4 is not allowed; give a value > 0"


def test_line_of_an_unforeseen_complaint_keeps_the_checkers_words() -> None:
    class Choice(BaseModel):
        rail: bytes

    with pytest.raises(ValidationError) as caught:
        Choice.model_validate({"rail": 3})
    assert one_line(caught.value, "x.toml") == "x.toml: rail: 3 is not allowed; Input should be a valid bytes"


def test_read_toml_returns_the_tables(tmp_path: Path) -> None:
    assert read_toml(_toml(tmp_path, "a = 1\n[b]\nc = 'd'\n")) == {"a": 1, "b": {"c": "d"}}


def test_importing_the_records_loads_no_parser_and_no_unit_library() -> None:
    heavy = ("yaml", "tomllib", "pint")
    code = f"import sys, railslip_ctrl.model.vehicle; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
