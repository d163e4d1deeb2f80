"""The design envelope: its points, its loads and laws, its files, and what it refuses."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from sample_vehicles import COACH

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design.envelope import Envelope, load_envelope
from railslip_ctrl.model.adhesion import AdhesionLaw, published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.vehicle import PARK2008, Rail
from railslip_ctrl.model.vehicle_files import load_vehicle

SMALL = Envelope(COACH, speeds=(20, 100), slip=(0.6, 1.0), dead_time=(1.0, 1.3), lag=(1.0, 1.3))


def test_the_default_is_the_documented_one_and_complete():
    envelope = Envelope(COACH)
    points = envelope.points()
    assert len(points) == 2 * 2 * 6 * 2 * 3 * 3 * 3 * 2
    assert points.operating.sum() == 2 * 2 * 6 * 2
    assert points.skipped == ()
    names = ("slip", "dead_time", "lag", "radius")
    assert [getattr(envelope, name) for name in names] == [(0.6, 1.0, 1.25), *2 * [(0.7, 1.0, 1.3)], (0.94, 1.0)]


def test_every_case_is_its_own_combination_linearised():
    points = SMALL.points()
    tables = [points.case(i).table() for i in range(len(points))]
    assert len({tuple(table.values()) for table in tables}) == len(points) == 2 * 2 * 2 * 2 * 2 * 2 * 2 * 2
    for i in range(0, len(points), 37):
        case, table = points.case(i), tables[i]
        loaded = COACH.loaded() if table["load"] == "loaded" else COACH
        assert (table["mass_kg"], table["wheel_load_n"]) == (loaded.mass, loaded.wheel_load)
        worn = loaded.model_copy(update={"wheel": loaded.wheel.model_copy(update={"radius": table["radius_m"]})})
        law = published_law(table["adhesion"], table["rail"], wheel_load=loaded.wheel_load)
        own = linearize(operating_point(law, worn, table["speed_kmh"] / 3.6, table["slip"]))
        assert np.array_equal(case.plant.A, own.A)
        assert np.array_equal(points.plants[points.plant[i]].A, own.A)
        assert case.actuator == case.point.vehicle.actuator == points.actuators[points.actuator[i]]
        # mu is that of the rig at every load
        rig = operating_point(published_law(table["adhesion"], table["rail"]), PARK2008, 20.0, table["slip"])
        at_20 = operating_point(law, worn, 20.0, table["slip"])
        assert at_20.adhesion_coefficient == pytest.approx(rig.adhesion_coefficient, rel=1e-12)


def test_operating_points_are_there_whatever_the_factors_and_tolerances_are_combined():
    only = Envelope(COACH, laws="curve", rails="dry", speeds=60, loads="loaded", slip=(0.5, 1.25), radius=0.94)
    points = only.points()
    assert len(points) == 1 + 2 * 9
    assert [(points.case(i).point.slip, i) for i in np.flatnonzero(points.operating)] == [(0.132, 0)]
    assert {points.case(i).point.vehicle.wheel.radius for i in range(1, len(points))} == {0.94 * COACH.wheel.radius}
    nominal = only.points(nominal=True)
    assert len(nominal) == nominal.operating.sum() == 1
    assert nominal.case(0).words == "curve, dry, loaded, 60 km/h"
    assert points.case(1).words == "curve, dry, loaded, 60 km/h, slip -50 %, radius -6 %"
    assert points.case(2).words == "curve, dry, loaded, 60 km/h, slip -50 %, lag -30 %, radius -6 %"


def test_a_vehicle_without_load_and_a_brake_without_lag_have_each_point_once():
    empty = COACH.model_copy(update={"mass_loaded": COACH.mass, "wheel_load_loaded": COACH.wheel_load})
    prompt = empty.model_copy(update={"actuator": COACH.actuator.model_copy(update={"lag": 0.0})})
    points = Envelope(prompt, speeds=60, laws="curve").points()
    assert len(points) == 2 * 3 * 3 * 2
    assert points.operating.sum() == 2


LAW = """
law = "bristle"
{wheel_load}
[parameters]
{parameters}
[reference_slip]
dry = 0.1
wet = 0.08
"""


def test_laws_of_files_follow_the_wheel_load_with_mu_as_it_was(tmp_path: Path):
    rig = published_law("bristle", Rail.DRY)
    parameters = "\n".join(f"{name} = {value!r}" for name, (value, _) in rig.numbers().items())
    told = LAW.format(wheel_load="wheel_load = 34500", parameters=parameters)
    (tmp_path / "mine.toml").write_text(told, encoding="utf-8")
    (tmp_path / "car.toml").write_text('[envelope]\nlaws = ["mine.toml", "bristle"]\nspeeds = ["10 m/s"]', "utf-8")
    envelope = load_envelope(tmp_path / "car.toml", COACH)
    assert envelope.speeds == (36.0,)
    points = envelope.at(reference={"dry": 0.1, "wet": 0.08}).points(nominal=True)
    by_law = {}
    for i in range(len(points)):
        point = points.case(i).point
        by_law.setdefault((point.rail, points.case(i).load), []).append(point.adhesion_coefficient)
    assert len(by_law) == 4
    for first, second in by_law.values():
        assert first == pytest.approx(second, rel=1e-9)
    # a record has the load it was made for; where that is not known, it is the empty vehicle's
    own = published_law("bristle", Rail.DRY, wheel_load=COACH.wheel_load)
    for law in (rig, own, own.model_copy(update={"of_wheel_load": None})):
        cases = Envelope(COACH, laws=law, rails="dry", speeds=36).points(nominal=True)
        mu = [cases.case(i).point.adhesion_coefficient for i in range(2)]
        assert mu == pytest.approx([operating_point(rig, PARK2008, 10.0, 0.132).adhesion_coefficient] * 2, rel=1e-9)


def test_the_table_of_the_vehicle_s_file_is_read_and_written_back(tmp_path: Path):
    vehicle = "mass = 11000\nmass_loaded = 17437\n"
    path = tmp_path / "coach.toml"
    path.write_text(vehicle, encoding="utf-8")
    assert load_envelope(path) == Envelope(load_envelope(path).vehicle)
    path.write_text(
        f'{vehicle}[envelope]\nrails = ["wet"]\nlag = [1, 2]\nreference = {{dry = 0.1, wet = 0.07}}', "utf-8"
    )
    envelope = load_envelope(path)
    assert (envelope.rails, envelope.lag, envelope.reference.wet) == ((Rail.WET,), (1.0, 2.0), 0.07)
    assert Envelope(envelope.vehicle, **envelope.table()) == envelope
    assert envelope.points(nominal=True).case(0).point.slip == 0.07


def test_an_envelope_of_a_vehicle_begins_with_the_table_of_its_file(tmp_path: Path):
    (tmp_path / "law.toml").write_text('law = "polach"\n[parameters]\n', "utf-8")
    path = tmp_path / "coach.toml"
    path.write_text(
        'mass = 11000\n[envelope]\nlaws = ["law.toml", "curve"]\nspeeds = ["10 m/s"]\n'
        "reference = {dry = 0.1, wet = 0.07}",
        "utf-8",
    )
    car = load_vehicle(path)
    assert Envelope(car) == load_envelope(path)
    assert Envelope(car, speeds=60) == load_envelope(path).at(speeds=60)  # what is given wins
    assert Envelope(car.model_copy(update={"mass_loaded": 12e3})).speeds == (36.0,)  # a changed one keeps it
    assert Envelope(PARK2008) == Envelope()
    own = tmp_path / "own.toml"
    own.write_text("[envelope]\nspeeds = [20]", "utf-8")
    assert load_envelope(own, car).reference is None  # a file of its own stands for itself
    path.write_text("mass = 11000\n[envelope]\nspeeds = [0]", "utf-8")
    with pytest.raises(InputError, match="speeds: 0 is not allowed"):
        Envelope(load_vehicle(path))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[envelope]\nspeeds = []", "envelope: speeds: is empty"),
        ("[envelope]\nspeeds = [0]", "envelope: speeds: 0 is not allowed"),
        ('[envelope]\nspeeds = ["3 kg"]', "speeds: '3 kg' has the wrong dimension"),
        ("[envelope]\nlag = [-1]", "envelope: lag: -1 is not allowed"),
        ("[envelope]\nslip = [inf]", "envelope: slip: inf is not allowed"),
        ('[envelope]\nloads = ["half"]', "envelope: loads.0: 'half' is not allowed"),
        ("[envelope]\nspeed = [3]", "envelope: speed: unknown key; did you mean 'speeds'"),
        ("[envelope]\nvehicle = 3", "envelope.vehicle: unknown key"),
        ("envelope = 3", "write a table"),
        ("rails = ['dry']", r"has no table \[envelope\]"),
        ("rail = 3\n[envelope]", "rail: unknown key"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, text: str, match: str):
    path = tmp_path / "envelope.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=match) as caught:
        load_envelope(path, PARK2008)
    assert "\n" not in str(caught.value)


def test_an_envelope_without_points_a_vehicle_or_a_reference_is_refused(tmp_path: Path):
    path = tmp_path / "envelope.toml"
    path.write_text("[envelope]", encoding="utf-8")
    with pytest.raises(InputError, match="has no vehicle; give one too"):
        load_envelope(path)
    polach = Envelope(laws="polach")
    with pytest.raises(InputError, match="adhesion 'polach' has no reference slip"):
        polach.points()
    assert len(polach.at(reference={"dry": 0.02, "wet": 0.02}, speeds=60, loads="empty").points(nominal=True)) == 2
    (kink,) = published_law("beam", Rail.DRY).kinks(10.0, PARK2008.wheel_load)
    on_it = Envelope(laws="beam", rails="dry", speeds=36, reference={"dry": kink.slip, "wet": 0.1})
    with pytest.raises(InputError, match="no case is left; beam, dry, empty"):
        on_it.points(nominal=True)
    with pytest.raises(InputError, match="cases are more than 500000"):
        Envelope(speeds=range(1, 1000), slip=np.linspace(0.5, 1.5, 50)).points()


def test_what_a_law_does_not_reach_is_left_out_with_the_reason():
    points = Envelope(laws=("bristle", "beam"), speeds=100, slip=(1.0, 8.0)).points()
    assert points.skipped
    assert all("slip 8 times the reference: slip:" in told for told in points.skipped)
    assert len(points) > 0


def test_a_reference_slip_beside_the_peak_is_told():
    slips = np.linspace(0.1, 0.16, 601)  # to 1e-4
    law = published_law("curve", Rail.DRY)
    top = slips[np.argmax([operating_point(law, PARK2008, 20.0, slip).adhesion_force for slip in slips])]
    assert top == pytest.approx(0.1288, abs=1e-4)
    told = Envelope(rails="dry").knife_edges()
    assert [one.split(":")[0] for one in told] == ["curve, dry rail"]  # the bristle law falls from the start
    assert "0.132 is 2.5 % above the adhesion peak at 0.1288" in told[0]
    assert Envelope(rails="dry", reference={"dry": 0.11, "wet": 0.07}).knife_edges() == ()


def test_every_kind_of_law_stands_in_an_envelope():
    laws: list[str | AdhesionLaw] = ["bristle", published_law("curve", Rail.DRY)]
    points = Envelope(laws=laws, speeds=60, loads="empty").points(nominal=True)
    assert [points.case(i).point.adhesion for i in range(len(points))] == ["bristle", "curve"] * 2
    assert Envelope(laws=laws).table()["laws"] == ["bristle", "curve"]
    assert list(itertools.chain(points.load)) == ["empty"] * 4
