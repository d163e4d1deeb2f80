"""Vehicles: the published record, TOML files, railtoolkit files, and every way a file can be wrong."""

import os
import re
import shutil
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.user_files import LARGEST_FILE
from railslip_ctrl.model.vehicle import GRAVITY, PARK2008, TABLE4_PI, USUAL_RANGES, notes_and_warnings, vehicle_warnings
from railslip_ctrl.model.vehicle_files import load_vehicle, read_rolling_stock

FILES = ("siemens_desiro_classic.yaml", "Facs124.yaml", "Bombardier_Traxx_2_P160.yaml")
DESIRO, FACS, TRAXX = (Path(__file__).parent / "data" / "rolling-stock" / name for name in FILES)
EXAMPLE = Path(__file__).parents[1] / "designs" / "vehicles" / "desiro_classic.toml"


def approx(value: Any) -> Any:
    """The expected values are the same few products in another order."""
    return pytest.approx(value, rel=1e-12)


@pytest.fixture
def file(file: Any) -> Any:
    return lambda text, name="vehicle.toml": Path(file(name, text))


def _message(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_vehicle(path)
    assert str(caught.value).isprintable()
    return str(caught.value).replace(str(path.parent) + os.sep, "")


def test_the_published_vehicle() -> None:
    # printed to three digits: 34 500 for 34 490
    assert PARK2008.mass * GRAVITY == pytest.approx(PARK2008.wheel_load, rel=5e-4)
    assert (TABLE4_PI["bristle"].kp, TABLE4_PI["beam"].ki) == approx((2340.0, 194.4))  # Table 4, per km/h
    one = PARK2008.model_copy(update={"inertia_scale": 3.6})
    effective = (one.effective_mass, one.effective_inertia, one.effective_viscous_friction)
    assert effective == approx((3.6 * 3517.0, 3.6 * 60.35, 3.6 * 0.25))
    loaded = PARK2008.model_copy(update={"wheel_load_loaded": 50_000.0}).loaded()
    assert (loaded.mass, loaded.wheel_load) == (5276.0, 50_000.0)
    for heavy, alone in ((5276.0, False), (3517.0, False), (6000.0, True)):
        assert bool(PARK2008.with_mass(heavy).mass_alone) == alone
    assert PARK2008.with_mass(6000.0).mass_loaded == 6000.0


def test_published_vehicle_written_as_toml_is_the_published_vehicle(file: Any) -> None:
    text = """
        name = "as published"
        inertia_scale = 3.6
        mass = 3517
        mass_loaded = "5.276 t"
        wheel_load = "34.5 kN"
        wheel_load_loaded = 34500
        wheel = {radius = "43 cm", inertia = 60.35, viscous_friction = 0.25}
        resistance.quadratic = "0.63 N/(m/s)^2"
        actuator = {dead_time = "150 ms", lag = 0.6}
        """
    vehicle = load_vehicle(file("\ufeff" + text.replace("\n", "\r\n")))  # a byte-order mark, Windows' line ends
    given = {"name": "as published", "inertia_scale": 3.6, "source": "vehicle.toml", "notes": ()}
    # the text's own units cost a rounding: compared number by number
    assert (vehicle.wheel.radius, vehicle.mass_loaded) == approx((0.43, 5276.0))
    exact = {"wheel": PARK2008.wheel, "mass_loaded": 5276.0}
    assert vehicle.model_copy(update=exact) == PARK2008.model_copy(update=given)


def test_what_a_file_lacks_is_the_published_rest_or_follows_from_the_mass_and_is_told(file: Any) -> None:
    vehicle = load_vehicle(file("mass = 4000\n"))
    assert (vehicle.name, vehicle.mass_loaded) == ("vehicle", 4000.0)
    assert vehicle.wheel_load == approx(4000.0 * 9.80665) == vehicle.wheel_load_loaded
    assert (vehicle.wheel, vehicle.actuator) == (PARK2008.wheel, PARK2008.actuator)
    assert vehicle.resistance.model_dump() == {"constant": 0.0, "linear": 0.0, "quadratic": 0.0}
    notes = " ".join(vehicle.notes)
    for said in ("No load", "radius = 0.43 m", "inertia = 60.35 kg*m^2", "dead_time = 0.15 s", "No travelling"):
        assert said in notes
    part = load_vehicle(file("mass = 4000\nwheel.radius = 0.5\nactuator.lag = 0\n"))
    numbers = (part.wheel.radius, part.wheel.inertia, part.actuator.dead_time, part.actuator.lag)
    assert numbers == (0.5, 60.35, 0.15, 0.0)
    assert not any("radius" in note or "lag =" in note for note in part.notes)
    loaded = load_vehicle(file('mass = 4000\nmass_loaded = 6000\nwheel_load = "40 kN"\n'))
    assert loaded.wheel_load_loaded == approx(60_000.0)


PLAUSIBLE = {
    **{"mass": 4000, "mass_loaded": 6000, "wheel_load": 39000, "wheel_load_loaded": 58000, "wheel.radius": 0.43},
    **{"wheel.inertia": 60, "wheel.viscous_friction": 0.25, "resistance.quadratic": 0.6},
    **{"actuator.dead_time": 0.15, "actuator.lag": 0.6},
}

# what stands in place of a number above, and what is said of it: the value, the range, the remedy
IMPLAUSIBLE = {
    "mass = 4": ("mass = 4 kg", "1000 to 45000 kg", 'if 4 t is meant, give "4 t"'),
    "mass = 60": ("mass = 60 kg", "1000 to 45000 kg", "divide the mass of a whole vehicle by the number of its axles"),
    "mass_loaded = 88000": ("mass_loaded = 88000 kg", "1000 to 45000 kg", "by the number of its axles"),
    # half and three halves of the weight, 39.2 and 58.8 kN
    "wheel_load = 39.2": ("wheel_load = 39.2 N", "19600 to 58800 N", 'if 39.2 kN is meant, give "39.2 kN"'),
    "wheel_load_loaded = 5900": ("wheel_load_loaded = 5900 N", "29400 to 88300 N", "check the number and its unit"),
    "radius = 4": ("radius = 4 m", "0.15 to 0.75 m", "check the number and its unit"),
    "radius = 430": ("radius = 430 m", "0.15 to 0.75 m", 'if 430 mm is meant, give "430 mm"'),
    # M r^2 = 739.6 kg m^2
    "inertia = 1e4": ("inertia = 10000 kg*m^2", "3.7 to 370 kg*m^2", "check the number and its unit"),
    # 0.01 times 39 kN times r^2/v = 2.60
    "viscous_friction = 250": ("viscous_friction = 250 N*m*s", "0 to 2.6 N*m*s", "check the number and its unit"),
    # 60 v^2 at 100 km/h
    "quadratic = 60": ("resistance = 46296.3 N at 100 km/h", "0 to 1950 N at 100 km/h", "check the number"),
    "dead_time = 150": ("dead_time = 150 s", "0 to 2 s", 'if 150 ms is meant, give "150 ms"'),
    "lag = 600": ("lag = 600 s", "0 to 10 s", 'if 600 ms is meant, give "600 ms"'),
}


def _with(line: str = "mass = 4000", without: str = "") -> str:
    key, _, number = line.partition(" = ")
    (name,) = (one for one in PLAUSIBLE if one.rpartition(".")[2] == key)
    return "".join(f"{one} = {value}\n" for one, value in (PLAUSIBLE | {name: number}).items() if one != without)


@pytest.mark.parametrize("line", IMPLAUSIBLE)
def test_an_implausible_number_is_taken_and_told_with_range_and_remedy(file: Any, line: str) -> None:
    vehicle = load_vehicle(file(_with(line)))
    (told,) = vehicle_warnings(vehicle)  # one number, one sentence, though others are computed from it
    value, usual, remedy = IMPLAUSIBLE[line]
    assert told.startswith(f"{value} is taken as given, but is outside the usual {usual} (")
    assert remedy in told.partition("); ")[2]
    assert notes_and_warnings(vehicle) == (*vehicle.notes, told)


def test_what_is_usual_is_not_doubted(file: Any) -> None:
    assert {value.split(" = ")[0] for value, _, _ in IMPLAUSIBLE.values()} == set(USUAL_RANGES)
    edges = {"dead_time = 2": 0, "dead_time = 2.001": 1, "mass_loaded = 45000": 0, "mass_loaded = 45001": 1}
    for line, told in edges.items():
        text = _with(line, without="wheel_load_loaded")  # the weight of the loaded mass, then
        assert len(vehicle_warnings(load_vehicle(file(text)))) == told
    scaled, plausible = PARK2008.model_copy(update={"inertia_scale": 3.6}), file(_with())
    for vehicle in (PARK2008, scaled, *map(load_vehicle, (plausible, EXAMPLE, DESIRO, FACS, TRAXX))):
        assert vehicle_warnings(vehicle) == vehicle_warnings(vehicle.loaded()) == ()


def test_railtoolkit_file_alone_takes_four_axles_and_the_published_wheel_and_brake() -> None:
    vehicle = load_vehicle(DESIRO)
    assert (vehicle.name, vehicle.source) == ("Siemens Desiro Classic", "siemens_desiro_classic.yaml [railtoolkit]")
    assert (vehicle.mass, vehicle.mass_loaded) == approx((68_000.0 / 4, 88_000.0 / 4))
    assert (vehicle.wheel_load, vehicle.wheel_load_loaded) == approx((17_000.0 * GRAVITY, 22_000.0 * GRAVITY))
    assert (vehicle.wheel, vehicle.actuator) == (PARK2008.wheel, PARK2008.actuator)
    notes = " ".join(vehicle.notes)
    # rotating mass is not counted twice: (1.08 - 1) * 17 000 kg * (0.43 m)^2 is told
    for said in ("4 axles are assumed", "of the wheel are", "of the actuator are", "empty mass", "J = 251.5 kg*m^2"):
        assert said in notes
    # running resistance: coefficients per mille of the weight, at 100 km/h and at half that speed
    resistance, per_mille = vehicle.resistance, 1e-3 * vehicle.mass * GRAVITY
    for share in (1.0, 0.5):
        v = share * 100.0 / 3.6
        force = resistance.constant + resistance.linear * v + resistance.quadratic * v**2
        assert force == approx((3.0 + 1.4 * share + 3.9 * share**2) * per_mille)


def test_toml_wins_over_the_railtoolkit_file_key_by_key(file: Any, tmp_path: Path, monkeypatch: Any) -> None:
    shutil.copy(DESIRO, tmp_path)
    text = f'name = "mine"\nrolling_stock = "{DESIRO.name}"\naxles = 6\nmass = "12 t"\nresistance.constant = 1.0\n'
    vehicle = load_vehicle(file(text))
    assert (vehicle.name, vehicle.mass, vehicle.resistance.constant) == ("mine", 12_000.0, 1.0)
    # the YAML's load on each of six axles is added to the mass of the TOML, and the rest keeps the YAML's coefficients
    assert vehicle.mass_loaded == approx(12_000.0 + 20_000.0 / 6)
    assert vehicle.resistance.linear == approx(1.4e-3 * 12_000.0 * GRAVITY * 0.036)
    assert vehicle.source == "vehicle.toml with siemens_desiro_classic.yaml [railtoolkit]"
    monkeypatch.chdir(tmp_path)  # the path of the rolling stock is relative to the TOML
    example = load_vehicle(EXAMPLE)
    assert (example.mass, example.wheel.radius) == approx((68_000.0 / 6, 0.385))
    assert not any("assumed" in note or "Published" in note for note in example.notes)


def test_a_vehicle_is_chosen_by_its_id(file: Any, tmp_path: Path) -> None:
    file("vehicles:\n  - {name: first, id: A1, mass: 40}\n  - {name: second, id: B2, mass: 6.0e+1}\n", "stock.yaml")
    vehicle = load_vehicle(file('rolling_stock = "stock.yaml"\nvehicle_id = "B2"\n'))
    assert (vehicle.name, vehicle.mass) == ("second", 15_000.0)
    for text, message in (
        ("", r"the file contains 2 vehicles; .*vehicle_id.*'A1', 'B2'"),
        ('vehicle_id = "B2x"\n', r"vehicle_id: no vehicle 'B2x'; did you mean 'B2'\? .*'A1', 'B2'"),
    ):
        found = _message(file('rolling_stock = "stock.yaml"\n' + text))
        assert re.fullmatch(rf"vehicle\.toml: rolling_stock: stock\.yaml: {message}", found)
    rows = "".join(f"  - {{name: n, id: V{i}, mass: 40}}\n" for i in (*range(12), 3))
    stock = file(f"vehicles:\n{rows}", "stock.yaml")
    found = _message(file('rolling_stock = "stock.yaml"\nvehicle_id = "V3"\n'))
    assert found.endswith("vehicle_id: 2 vehicles have the id 'V3'; make it unique")
    assert _message(stock).endswith("'V9' and 3 more")


def test_unknown_keys_and_empty_values_of_the_foreign_schema_are_ignored(file: Any) -> None:
    stock = read_rolling_stock(file("vehicles: [{name: n, id: i, mass: 4e1, load_limit: , colour: red}]", "s.yaml"))
    assert (stock.mass, stock.load_limit) == (40.0, None)  # 4e1 is text to YAML 1.1, and a number to YAML 1.2


# keys of a vehicle, and what is said of them
WRONG_VEHICLE = {
    "length: 3": "mass: missing; give it (t): mass of the empty vehicle",
    "mass: 0": "mass: 0 is not allowed; give a value > 0 (t)",
    "mass: heavy": "mass: 'heavy' is not a number in t, with or without a unit",
    "mass: 1, rotation_mass: 0.9": "rotation_mass: 0.9 is not allowed; give a value >= 1",
    "mass: 1, name: 3": "name: 3 is not allowed; give text in quotes",
}
NO_LIST = "vehicles: missing or not a list of vehicles; give a railtoolkit rolling-stock file"
WRONG_YAML = {
    **{f"vehicles: [{{name: n, id: i, {keys}}}]": f"vehicle 'i': {told}" for keys, told in WRONG_VEHICLE.items()},
    **dict.fromkeys(("vehicles: []", "vehicles: [1]", "just text"), NO_LIST),
    "a: b: c": "not valid YAML: mapping values are not allowed in this context (at line 1, column 5)",
    "a: \x01": "not valid YAML: unacceptable character #x0001: control characters are not allowed in",
    "a: !!python/name:os.system x": "not valid YAML: could not determine a constructor for the tag",
    "a: &x [1]\nb: [*x, *x]\n": "aliases ('*x') are not read; ",
    "vehicles: [{id: 0x" + "f" * 5000 + "}, {}]": (
        "the file contains 2 vehicles; write a TOML vehicle file with rolling_stock = this file and vehicle_id = one "
        "of an integer of 20000 bits, None"
    ),
    "[" * 100_000: "the file is nested more than 20 levels deep; give a railtoolkit file",
    f"vehicles: {'[' * 19}{']' * 19}": NO_LIST,
}

# lines after `mass = 10`, and lines alone
WRONG_KEYS = {
    "actuator.dead_time = '150'": (  # 150 ms were meant, 150 s would be read
        "actuator.dead_time: '150' is text without a unit; write the unit too, or give the number of s without"
    ),
    "mass_loaded = 9": "mass_loaded: 9 is not allowed; give a value >= mass = 10 (kg)",
    "wheel.radios = 1": "wheel.radios: unknown key; did you mean 'radius'? allowed: radius, inertia, viscous_friction",
    "wheel = 3": "wheel: 3 is not allowed; give a table",
    "axles = 4": "axles is used only with rolling_stock; remove axles",
}
WRONG_TOML = {
    **{f"mass = 10\n{line}": told for line, told in WRONG_KEYS.items()},
    "mass = 1e308\nwheel.radius = 1e200\nmass_loaded = 1e-3": "wheel_load: inf is not allowed",
    "name = 'x'": "mass: missing; give mass (quarter car, kg) or rolling_stock (a railtoolkit file)",
    "axles = 0": "axles: 0 is not allowed; give a value >= 1",
    "mas = 10": "mas: unknown key; did you mean 'mass'? allowed: name, mass, mass_loaded, wheel_load,",
    '"two\\nlines" = 1': "'two\\nlines': unknown key;",
    "mass = -1\nname = 3": "name: 3 is not allowed; give text in quotes (and 1 more)",
    "mass = -1\nmasses = 3": "masses: unknown key; did you mean 'mass'?",  # told first, as it may be why
    "mass = 1\nmass ==": "not valid TOML: Invalid value (at line 2, column 7)",
    "mass = " + "9" * 5000: "not valid TOML: Exceeds the limit",
    "mass = " + "[" * 100_000: "tables or lists are nested too deeply",
    " \n": "the file is empty; give at least one key",
    "rolling_stock = 'none.yaml'": "rolling_stock: none.yaml: no such file; check the path",
}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [(name, *one) for name, wrong in (("v.yaml", WRONG_YAML), ("v.toml", WRONG_TOML)) for one in wrong.items()],
    ids=lambda text: text[:30],
)
def test_a_wrong_file_is_refused_in_one_line(file: Any, name: str, text: str, message: str) -> None:
    assert _message(file(text, name)).startswith(f"{name}: {message}")


@pytest.mark.parametrize("suffix", [".toml", ".yaml"])
def test_a_file_that_is_none(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / f"v{suffix}"
    assert _message(path) == f"{path.name}: no such file; check the path"
    (tmp_path / f"d{suffix}").mkdir()
    assert _message(tmp_path / f"d{suffix}") == f"d{suffix} is a directory; give a file"
    path.write_bytes(b"ab\xff\xfe\x00")
    assert _message(path) == f"{path.name}: byte 3 is not UTF-8; save the file as UTF-8 text"
    path.write_bytes(b"#" * (LARGEST_FILE + 1))
    assert _message(path).startswith(f"{path.name} is larger than 1000000 bytes")
    path.write_bytes(b"#" * LARGEST_FILE)
    assert "larger" not in _message(path)
    if hasattr(os, "mkfifo"):  # would block
        os.mkfifo(tmp_path / f"p{suffix}")
        assert _message(tmp_path / f"p{suffix}") == f"p{suffix} is not a regular file; give a file"
    for name in ("v" * 5000 + suffix, "v\0" + suffix):
        assert re.search(r"cannot be read \(.+\); check the path", _message(tmp_path / name))
    assert re.fullmatch(r"v\.json: .*'\.json'.*; give \.toml, \.yaml or \.yml", _message(tmp_path / "v.json"))

    # not by chmod: it does not bind the superuser, whom containers run as
    monkeypatch.setattr(Path, "open", Mock(side_effect=PermissionError(13, "Permission denied")))
    assert _message(path) == f"{path.name} cannot be read (Permission denied); check the path and its permissions"
