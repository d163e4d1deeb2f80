"""The predictive law: its derivation against the contract, broken plants, a delayed simulation and block arithmetic."""

from collections import namedtuple
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from sample_laws import sample_law
from scipy.integrate import solve_ivp

from railslip_ctrl import PARK2008
from railslip_ctrl.controllers.guard import mutable, step_parameters
from railslip_ctrl.controllers.predictive import Predictive
from railslip_ctrl.controllers.seeking import Seeking
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Actuator, Rail
from railslip_ctrl.sliding.predictive import derive_predictive
from railslip_ctrl.sliding.proof import sliding_symbol

R, J = PARK2008.wheel.radius, PARK2008.effective_inertia


def test_every_step_holds_and_the_law_is_as_typed(railslip) -> None:
    found = derive_predictive()
    assert found.all_checked
    names = "kappa k K sat theta tau_o p g T_plus H H_hat H_hat_rate S torque_max"
    kappa, k, K, sat, theta, tau_o, p, g, T_plus, H, H_hat, H_hat_rate, S, most = map(sliding_symbol, names.split())
    law = T_plus + (T := symbol("T")) * (-kappa * (T_plus - H_hat) + k * S + K * sat)
    rate = kappa * (H - H_hat) + (1 + kappa * theta) * H_hat_rate - k * S - K * sat
    assert sp.simplify(found.control_law - law) == sp.simplify(found.closed_rate - rate) == 0
    assert [sp.simplify(one.subs(T_plus, H_hat)) for one in found.authority] == [H_hat / T, (most - H_hat) / T]
    assert sp.simplify(sp.limit(found.small_gain, g, sp.oo) - 2 * p * (theta + tau_o)) == 0
    assert found.relative_degrees == (2, 1)
    for form in ("--json", "--format=text", "--format=markdown", "--format=latex"):
        status, out, err = railslip("derive", "--law", "predictive", form)
        assert (status, err, "Errata" in out, "C99" in out, '"python"' in out) == (0, "", *[False] * 3)
        assert all(step.name in out for step in found.steps)


BROKEN = {
    "WHEEL": (plant.WHEEL.subs(plant.Td, -plant.Td), {"accelerations", "holding torque"}),
    "SLIP_RATIO": (plant.SLIP_RATIO.subs(plant.sigma, -plant.sigma), {"holding torque"}),
    "actuator_lag_rate": (lambda: (plant.Tb - symbol("Tc")) / symbol("T"), {"predictive law", "loop of the layer"}),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_plant_fails_its_steps(name, monkeypatch) -> None:
    monkeypatch.setattr(plant, name, BROKEN[name][0])
    for cached in (plant.motion, plant.trim_torque):
        monkeypatch.setattr(plant, cached.__name__, cached.__wrapped__)
    assert {step.name for step in derive_predictive.__wrapped__().steps if not step.checked} >= BROKEN[name][1]


def test_the_identities_hold_along_a_delayed_simulation() -> None:
    """By the method of steps, the train's speed changing; to 1e-6, far above the solver's tolerance of 1e-10."""
    found, law = derive_predictive(), sample_law("burckhardt")
    parts = (found.holding_torque, found.surface, found.control_law, found.closed_rate, found.reduced_rate)
    known = sorted({one for part in parts for one in part.free_symbols}, key=str)
    H, S, u, S_rate, e_hat_rate = (sp.lambdify([known], part) for part in parts)
    functions, p = numeric_plant(type(law)), plant_parameters(law, PARK2008)
    theta, Td, Tr = 0.15, 50.0, 100.0
    fixed = {"r": R, "J": J, "B": 0.25, "T": 0.6, "theta": theta, "lambda_d": 0.08, "lambda_d_rate": 0.0, "kappa": 1.8}
    fixed |= {"Td": Td, "Tr": Tr, "k": 2.0, "K": 4500.0, "phi": 400.0} | dict.fromkeys(("H", "e_hat", "S", "sat"), 0.0)
    pieces = [lambda _: [0.0, 0.0, 4000.0]]  # the constant torque before t = 0

    def torque_ago(t):
        return pieces[min(int(np.ceil(t / theta - 1.0 - 1e-12)), len(pieces) - 1)](t - theta)[2]

    def values(t, v, sigma, torque, under_way, *_):
        now = {**fixed, "v": v, "omega": (v - sigma) / R, "T_plus": torque}
        now["a"] = -functions.rates(v, sigma, 0.0, torque_ago(t), Td, Tr, p)[0]
        now["Ta"] = R * functions.force(v, sigma, 0.0, 0.0, 0.0, 0.0, p)
        now |= {"H_hat": 4200.0 + 200.0 * np.sin(3.0 * t), "H_hat_rate": 600.0 * np.cos(3.0 * t)}
        now["H"] = H([now[str(one)] for one in known])
        now["e_hat"] = 0.08 * v - sigma - R / J * (under_way - theta * now["H_hat"])
        now["S"] = S([now[str(one)] for one in known])
        return {**now, "sat": np.clip(now["S"] / 400.0, -1.0, 1.0)}

    def rates(t, y):
        now, late = values(t, *y), torque_ago(t)
        command, *grow = (part([now[str(one)] for one in known]) for part in (u, S_rate, e_hat_rate))
        moving = functions.rates(y[0], y[1], 0.0, late, Td, Tr, p)[:2]
        return [*moving, (command - y[2]) / 0.6, y[2] - late, *grow, now["H"]]

    y = np.array([25.0, 1.2, 4000.0, 4000.0 * theta, 0.0, 0.0, 0.0])
    first = then = values(0.0, *y)
    for start in theta * np.arange(8):
        grown = solve_ivp(rates, (start, start + theta), y, "DOP853", dense_output=True, rtol=1e-10, atol=1e-9)
        pieces.append(grown.sol)
        surplus = grown.y[6, -1] - y[6] - theta * then["H_hat"]
        y = grown.y[:, -1]
        assert 0.08 * y[0] - y[1] - then["e_hat"] == pytest.approx(R / J * surplus, abs=1e-6)
        then = values(start + theta, *y)
        assert then["S"] - first["S"] == pytest.approx(y[4], abs=1e-6 * abs(first["S"]))
        assert then["e_hat"] - first["e_hat"] == pytest.approx(y[5], abs=1e-6)
    assert abs(first["S"]) > 400.0 > abs(then["S"])  # from outside the layer into it


Layer = namedtuple("Layer", "kappa gain dead_time lag observer_time deceleration_time wheel_inertia")


def layer_loop(s, point, layer, brake):
    frozen, moving = linearize(point), linearize(point, speed_state=True)
    rows = np.array([[float(name == "sigma") for name in frozen.states], moving.A[0, 1:]])
    inverse = s[:, None, None] * np.eye(len(frozen.states)) - frozen.A
    to_sigma, to_v_rate = (rows @ np.linalg.solve(inverse, frozen.B.astype(complex)))[..., 0].T
    delay, ga = np.exp(-layer.dead_time * s), np.exp(-brake.dead_time * s) / (brake.lag * s + 1)
    filters = {"Q": 1 / (layer.observer_time * s + 1), "Qa": 1 / (layer.deceleration_time * s + 1)}
    values = {"E": delay, "G": to_sigma, "A": to_v_rate, "Ga": ga, **filters, "theta": layer.dead_time}
    values |= {"kappa": layer.kappa, "g": layer.gain, "lambda_d": point.slip}
    known = {sliding_symbol(name): value for name, value in values.items()}
    known |= {symbol("s"): s, symbol("T"): layer.lag, plant.J: layer.wheel_inertia, plant.r: R}
    return sp.lambdify(list(known), derive_predictive().loop, "numpy")(*known.values())


@pytest.mark.parametrize("law", ["curve", "bristle"])
def test_the_layer_s_loop_against_its_blocks(law) -> None:
    layer, brake = Layer(1.8, 13.25, 0.15, 0.6, 0.051, 0.078, 1.1 * J), Actuator(dead_time=0.2, lag=0.4)
    point, ratio = operating_point(published_law(law, "dry"), PARK2008, 60 / 3.6, 0.09), 1.1 * J / R
    frozen, moving = linearize(point), linearize(point, speed_state=True)

    def returned(s):
        x = np.linalg.solve(s * np.eye(len(frozen.A)) - frozen.A, frozen.B[:, 0])
        sigma, v_rate, q, late = x[0], moving.A[0, 1:] @ x, 1 / (0.051 * s + 1), np.exp(-0.15 * s)

        def ahead_rate(T_plus):  # with an acting torque of 1
            H_hat = q * (ratio * (v_rate - s * sigma) + late * T_plus) - ratio * 0.91 * v_rate / (0.078 * s + 1)
            e_hat = -sigma - ((1 - late) / s * T_plus - 0.15 * H_hat) / ratio
            return -1.8 * (T_plus - H_hat) + 13.25 * (H_hat + ratio * 1.8 * e_hat - T_plus)

        T_plus = ahead_rate(0) / (s - ahead_rate(1) + ahead_rate(0))
        return -(0.6 * s + 1) * T_plus * np.exp(-0.2 * s) / (0.4 * s + 1)

    s = np.concatenate([1j * np.geomspace(1e-2, 60, 20), [0.3 + 2j, -0.5 + 1j]])
    np.testing.assert_allclose(layer_loop(s, point, layer, brake), [returned(one) for one in s], rtol=1e-9)


@pytest.mark.parametrize("kind", [Predictive, Seeking])
def test_the_loop_of_the_controller_is_the_derived_one(kind) -> None:
    control, brake = kind.for_vehicle(PARK2008), Actuator(dead_time=0.2, lag=0.4)
    layer = Layer(
        *(control.kappa, control.reaching_rate + control.switching_gain / control.layer, control.dead_time),
        *(control.lag, control.observer_time, control.deceleration_time, control.wheel_inertia),
    )
    s = 1j * np.geomspace(1e-2, 60, 40)
    for law, kmh, slip in (("curve", 60, 0.09), ("bristle", 20, 0.11), ("beam", 100, 0.12)):
        point = operating_point(published_law(law, "dry"), PARK2008, kmh / 3.6, slip)
        np.testing.assert_allclose(control.loop(point, brake)(s), layer_loop(s, point, layer, brake), rtol=1e-9)


def test_the_printed_python_steps_as_the_controller(railslip) -> None:
    printed: dict = {}
    exec(railslip("derive", "--law", "predictive", "--format", "python")[1], printed)
    control = Predictive.for_vehicle(PARK2008)
    state, numbers = mutable(control.start(25.0, control.period)), step_parameters(control, Rail.DRY, control.period)
    parameters, noise, torque = SimpleNamespace(**numbers), np.random.default_rng(3), 0.0
    for k in range(300):
        v = 25.0 - 0.01 * k
        measured = SimpleNamespace(time=0.01 * k, train_speed=v, wheel_speed=v * noise.uniform(0.8, 1.0) / R)
        measured.applied_torque = torque
        torque = Predictive.step(state, measured, parameters)
        assert printed["step"](printed["state"], measured, printed["PARAMETERS"]) == torque
