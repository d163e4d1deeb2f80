"""Scalar functions that kernels run: the NumPy ones of every law, and committed as the statement gives them."""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np
import pytest
from sample_laws import ALL_LAWS, sample_law

from railslip_ctrl.model.adhesion import AdhesionLaw, law_class, law_names
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.scalar_code import FOLDER, WORKS, adhesion_table, generate_scalar, has_table, scalar_source
from railslip_ctrl.model.vehicle import PARK2008, Resistance
from railslip_ctrl.simulation.steps import kernel_text, step_text

# all terms of the resistance at work
VEHICLE = PARK2008.model_copy(update={"resistance": Resistance(constant=210.0, linear=13.0, quadratic=0.63)})
# of a force from a table the cubic's error is below 1e-11 of the largest force; the others round alike
TABLE_ERROR = 1e-11


def interpreted(law: type[AdhesionLaw]) -> ModuleType:
    """The law's scalar functions in the interpreter, in a module put together as a kernel is."""
    module = ModuleType(f"scalar_{law.name}")
    exec(kernel_text(law, step_text("torque_profile"), compiled=False), module.__dict__)
    return module


def states(law: AdhesionLaw, count: int, seed: int) -> np.ndarray:
    """Rows (v, sigma, z, Tb, Td, Tr), slips of both signs within the law's domain."""
    rng = np.random.default_rng(seed)
    v = rng.uniform(1.5, 27.0, count)
    most = np.array([min(0.99, 0.99 * law.domain_limit(speed)[0]) for speed in v])
    slip = rng.uniform(0.003, 1.0, count) * most * rng.choice([-1.0, 1.0], count)
    torques = rng.uniform(-1.0, 1.0, (3, count)) * np.array([[2e4], [500.0], [400.0]])
    return np.stack([v, slip * v, rng.uniform(-0.5, 0.5, count), *torques], axis=1)


@pytest.mark.parametrize("name", ALL_LAWS)
def test_scalar_functions_are_the_numpy_ones(name: str) -> None:
    law = sample_law(name)
    scalar, numeric, table = interpreted(type(law)), numeric_plant(type(law)), adhesion_table(law, VEHICLE.wheel_load)
    p = plant_parameters(law, VEHICLE)
    points = states(law, 200, seed=3)
    largest = max(float(np.max(np.abs([numeric.force(*row, p) for row in points]))), 1.0)
    # a force from a table moves rates by its error over the inertia; sums of cancelling terms round at some 1e-14
    share = TABLE_ERROR if has_table(type(law)) else 2e-14
    per_force = VEHICLE.wheel.radius**2 / VEHICLE.effective_inertia + 1 / VEHICLE.effective_mass
    for row in points:
        assert scalar.adhesion_force(*row, p, table) == pytest.approx(
            float(numeric.force(*row, p)), rel=1e-12, abs=share * largest
        )
        rates = [float(x) for x in numeric.rates(*row, p)]
        tolerance = 10 * share * largest * per_force
        assert scalar.rates(*row, p, table) == pytest.approx(rates, rel=1e-11, abs=tolerance)
        assert scalar.rates_and_powers(*row, p, table)[:3] == pytest.approx(rates, rel=1e-11, abs=tolerance)
        assert scalar.rest_state(*row, p, table) == pytest.approx(float(numeric.rest_state(*row, p)), rel=1e-12)
        jacobian = [[float(x) for x in line] for line in numeric.jacobian(*row, p)]
        # the curve's slope is alpha times the difference of 1 and h F, which cancels: 1e-11 of its terms is left
        scale = max(max(map(abs, line)) for line in jacobian) + 1e3
        assert scalar.stiffness(*row, p, table) == pytest.approx(
            [jacobian[1][1], jacobian[1][2], jacobian[2][1], jacobian[2][2]], rel=1e-9, abs=1e-9 * scale
        )


@pytest.mark.parametrize("name", ALL_LAWS)
def test_powers_are_torque_times_speed_and_the_whole_loss_of_kinetic_energy(name: str) -> None:
    law = sample_law(name)
    scalar, numeric, table = interpreted(type(law)), numeric_plant(type(law)), adhesion_table(law, VEHICLE.wheel_load)
    p = plant_parameters(law, VEHICLE)
    r, J, M, B = VEHICLE.wheel.radius, VEHICLE.effective_inertia, VEHICLE.effective_mass, 0.25
    for v, sigma, z, Tb, Td, Tr in states(law, 50, seed=4):
        row = (v, sigma, z, Tb, Td, Tr)
        omega, force = (v - sigma) / r, float(numeric.force(*row, p))
        resistance = 210.0 + 13.0 * v + 0.63 * v**2
        expected = (Tb * omega, force * sigma, B * omega**2, resistance * v, Tr / r * sigma, Td * omega)
        powers = scalar.rates_and_powers(*row, p, table)[3:]
        assert len(powers) == len(WORKS)
        # a force from a table is within 1e-11 of 1e4 N: times the slip velocity at most 3e-6 W
        assert powers == pytest.approx(expected, rel=1e-12, abs=3e-6)
        v_rate, sigma_rate, _ = (float(x) for x in numeric.rates(*row, p))
        loss = -(M * v * v_rate + J * omega * (v_rate - sigma_rate) / r)
        assert math.fsum(powers) == pytest.approx(loss, rel=1e-9, abs=3e-5)  # some 1e6 W cancel in it


def test_the_table_is_the_curve_to_its_stated_error() -> None:
    law = sample_law("curve")
    scalar, table = interpreted(type(law)), adhesion_table(law, VEHICLE.wheel_load)
    p = plant_parameters(law, VEHICLE)
    slip = np.random.default_rng(5).uniform(-1.0, 1.0, 4000)
    exact = numeric_plant(type(law)).force(1.0, slip, 0.0, 0.0, 0.0, 0.0, p)
    read = np.array([scalar.adhesion_force(1.0, s, 0.0, 0.0, 0.0, 0.0, p, table) for s in slip])
    assert np.max(np.abs(read - exact)) < TABLE_ERROR * np.max(np.abs(exact))
    assert [name for name in ALL_LAWS if has_table(law_class(name))] == ["curve"]


@pytest.mark.parametrize("name", law_names())
def test_committed_text_is_what_the_statement_gives(name: str) -> None:
    law = law_class(name)
    committed = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    assert committed == generate_scalar(law), "run `make generate`"
    assert scalar_source(law) == committed
