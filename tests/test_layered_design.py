"""The layered law: its bounds, its runs, and the script that designs it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from project import ROOT, script, show
from sliding_cases import ACTUATOR, DESIGN, IDEAL

from railslip_ctrl.model.parameters import PARK2008, Rail, load_vehicle
from railslip_ctrl.report import plots
from railslip_ctrl.verification.actuator_effects import published_loop, stop_loops
from railslip_ctrl.verification.fine_simulation import holding_torque, simulate
from railslip_ctrl.verification.layered import (
    PUBLISHED_ADHESION,
    LayeredDesign,
    LayeredLaw,
    bounded_disturbance,
    induced_gains,
    layer_bound,
    layer_loop,
    layered_design,
    published_torque,
    random_torque,
)
from railslip_ctrl.verification.layered_conditions import open_loop_slip, range_left
from railslip_ctrl.verification.relay_loop import TABLE4_SLIDING


def test_induced_gain_of_a_first_order_loop_in_closed_form():
    # P control, lead = its own filter, ideal actuator, static law: y = b exp(-(kp b - p) t)
    plant = published_loop(Rail.DRY, adhesion="curve").plant
    design = LayeredDesign(kp=300.0, ki=0.0, lead=0.1, lead_filter=0.1, K=100.0)
    rate = 300.0 * plant.gain - float(plant.A[0, 0])
    gains = induced_gains(design, plant, IDEAL)
    assert gains.error == pytest.approx(plant.gain / rate, rel=1e-4)  # quadrature
    assert gains.surface == pytest.approx(gains.error, rel=1e-12)
    assert gains.command == pytest.approx(300.0 * plant.gain / rate, rel=1e-4)


def test_asmc_robust_script(tmp_path, capsys, monkeypatch):
    module = script("designs/asmc_robust.py")
    # the table's cycles and limits have tests of their own: one case a reading is enough here
    monkeypatch.setattr(module, "ADHESIONS", ("bristle",))
    result = module.run()
    drawn, save = [], plots.save_figure
    monkeypatch.setattr(plots, "save_figure", lambda figure, path: (drawn.append(figure), save(figure, path)))
    for found in result.values():
        for rail in Rail:
            bound, offset = found.bounds[rail].at_rest, found.bounds[rail].from_offset
            assert bound.layer_kept
            assert offset.layer_kept
            assert offset.command <= found.design.K / 1.05 * (1 + 1e-12)  # the margin of K; rounding
            plant = found.bounds[rail].plant
            assert bound.margins.ms == pytest.approx(layer_loop(found.design, plant, ACTUATOR).margins().ms)
            assert bound.margins.ms < 1.7
            # every simulated disturbance stays within the bound, and the worst shows that it is not idle
            for error, command in found.simulated[rail].values():
                assert error <= bound.error
                assert command <= bound.command
            assert found.simulated[rail]["worst case"][0] > 0.8 * bound.error
            assert np.abs(found.worst[rail].sigma - plant.point.sigma).max() == found.simulated[rail]["worst case"][0]
            assert bound.slip_error(plant.point.speed) < 0.008
    si = {effect.name: effect for effect in result["SI"].published}
    assert si["bristle dry, inertia x 1"].adaptation_hopeless
    assert not si["bristle dry, inertia x 1"].cycles[0].linear_holds
    # beside the published law: its own cycle, without any disturbance, against the bound with one
    assert (
        si["bristle wet, inertia x 1"].cycles[0].actual.sigma_amplitude
        > 4 * result["SI"].bounds[Rail.WET].at_rest.error
    )
    show(module, result, tmp_path, monkeypatch)
    out = capsys.readouterr().out
    assert "THE LAYERED LAW" in out
    assert f"{result['SI'].bounds[Rail.DRY].at_rest.error:.3f}" in out
    assert out.count("worst case") == 2
    assert (tmp_path / "asmc_robust.png").exists()
    for axes in drawn[0].axes[:2]:
        assert "100 km/h frozen, 3517 kg, from the reference slip at rest" in axes.get_title()
    # what it advises is stable at every point of the stop, checked together
    advice = result["SI"].advice
    for loop in stop_loops(70.0, TABLE4_SLIDING["bristle"].D, PARK2008).values():
        assert loop.is_stable(relay_gain=advice.relay_gain, adaptation=advice.k)


@pytest.mark.parametrize("offset", [-0.1, 0.1])
@pytest.mark.parametrize("rail", Rail)
def test_bound_from_an_offset_is_reached_in_the_time_given(rail, offset):
    plant = published_loop(rail).plant
    bound = layer_bound(DESIGN, plant, ACTUATOR, 20.0, offset=0.1)
    point, hold = plant.point, holding_torque(plant.point)
    run = simulate(
        point,
        LayeredLaw(point.slip, hold, design=DESIGN),
        ACTUATOR,
        duration=20.0,
        step=2e-3,
        disturbance=lambda t: math.copysign(20.0, math.sin(1.7 * t)),
        offset=offset,
    )
    error = np.abs(run.sigma - point.sigma)
    assert error.max() <= bound.largest_error
    assert error[run.time >= bound.reaching_time].max() <= bound.error + 0.01 * 0.1
    assert np.abs(run.command - hold).max() <= bound.command <= DESIGN.K


def test_layered_law_holds_the_slip_while_the_speed_falls():
    plant = published_loop(Rail.DRY).plant
    point = plant.point
    law = LayeredLaw(point.slip, point.brake_torque, design=DESIGN)
    run = simulate(point, law, ACTUATOR, duration=6.0, step=2e-3, frozen=False)
    assert run.speed[-1] < 10.0
    slip = run.sigma / run.speed
    # not part of the bound, which has the speed frozen: it errs towards less slip, so the wheel is not locked
    assert slip.max() < point.slip + 0.005
    assert slip.min() > 0.5 * point.slip


def test_static_law_has_its_own_remainder():
    plant = published_loop(Rail.WET, adhesion="curve").plant
    small, large = (layer_bound(DESIGN, plant, ACTUATOR, d) for d in (5.0, 10.0))
    # the remainder is of second order, so it grows about four times when the disturbance doubles
    assert 3.0 < large.remainder / small.remainder < 8.0
    assert small.error < large.error


def test_disturbed_stops_are_held_to_the_cut_out_and_not_to_5_kmh():
    """Other seeds than those of `verify`; the wet rail loaded is the worst of the four."""
    design, loaded = layered_design(PARK2008), PARK2008.loaded()
    point = PUBLISHED_ADHESION.plants(loaded)[Rail.WET].point
    left = [range_left(design, point, seed) for seed in range(3000, 3010)]
    assert sum(speed > 5.0 for speed in left) >= 5
    assert max(left) < 20.0
    # the speed frozen: the slip velocity's error does not fall with the speed, its reference does
    slow = PUBLISHED_ADHESION.plants(loaded, speed_kmh=10.0)[Rail.WET].point
    law = LayeredLaw(slow.slip, holding_torque(slow), design=design)
    torque = published_torque(design, slow, 3000, 15.0)
    run = simulate(slow, law, loaded.actuator, duration=15.0, step=5e-3, disturbance=torque)
    assert np.abs(run.sigma - slow.sigma).max() > slow.sigma
    # what takes the law's place
    point = PUBLISHED_ADHESION.plants(loaded, speed_kmh=20.0)[Rail.WET].point
    assert max(open_loop_slip(point, seed) for seed in range(3000, 3005)) < 1.0


def test_disturbances_grow_with_the_wheel_load():
    desiro = load_vehicle(ROOT / "designs/vehicles/desiro_classic.toml")
    for vehicle in (PARK2008, desiro.loaded()):
        point = PUBLISHED_ADHESION.plants(vehicle)[Rail.DRY].point
        J, r, M, N = vehicle.wheel.inertia, vehicle.wheel.radius, vehicle.mass, vehicle.wheel_load
        force = 431 / 34_500 * N * np.clip(np.random.default_rng(7).standard_normal(), -3, 3)
        # Tr adds to sigma' what -(r/J) Tr and -Tr/(r M) make of it, and (r/J) of a torque at the wheel is the same
        assert random_torque(point, 7, 1.0)(0.0) == pytest.approx(-(r + J / (r * M)) * force, rel=1e-9)
        assert bounded_disturbance(vehicle) == pytest.approx(20.0 * N * r / (34_500 * 0.43), rel=1e-12)
