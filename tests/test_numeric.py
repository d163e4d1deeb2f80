"""Generated numeric functions against the SymPy statement, finite differences, and the committed files."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp
from sample_laws import ALL_LAWS, sample_law

import railslip_ctrl
import railslip_ctrl.model.adhesion
from railslip_ctrl.core.errors import KinkError
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import law_class, law_names
from railslip_ctrl.model.adhesion.curve import curve_force
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import (
    FUNCTIONS,
    PACKAGE,
    adhesion_coefficient,
    generate,
    numeric_plant,
    peak,
    plant_parameters,
)
from railslip_ctrl.model.vehicle import PARK2008

GENERATED = PACKAGE / "model" / "_generated"


def sampled_states(count: int, seed: int) -> np.ndarray:
    """Rows (v, sigma, z, Tb, Td, Tr) over the range of braking runs, sigma of both signs."""
    rng = np.random.default_rng(seed)
    v = rng.uniform(1.5, 35.0, count)
    slip = rng.uniform(0.005, 0.95, count) * rng.choice([-1.0, 1.0], count)
    torques = rng.uniform(-1.0, 1.0, (3, count)) * np.array([[2e4], [500.0], [400.0]])
    return np.stack([v, slip * v, rng.uniform(-0.6, 0.6, count), *torques], axis=1)


def flat(value: object) -> list[object]:
    return [item for part in value for item in flat(part)] if isinstance(value, tuple) else [value]


def oracle(expressions: list[sp.Expr], symbols: list[sp.Symbol]) -> Callable[..., list[float]]:
    """The statement itself in mpmath, 30 digits; the curve by its numeric function, which is tested elsewhere."""
    curve = {"BristleCurve": lambda *arguments: mpmath.mpf(float(curve_force(*map(float, arguments))))}
    exact = sp.lambdify(symbols, [sp.sympify(expression) for expression in expressions], [curve, "mpmath"])

    def numbers(*values: float) -> list[float]:
        with mpmath.workdps(30):
            return [float(value) for value in exact(*map(mpmath.mpf, values))]

    return numbers


@pytest.mark.parametrize("name", ALL_LAWS)
def test_numeric_functions_are_the_statement(name: str) -> None:
    law = sample_law(name)
    functions, closed = numeric_plant(type(law)), plant.close(type(law))
    p = plant_parameters(law, PARK2008)
    symbols = [*(symbol(n) for n in (*plant.ARGUMENTS, *plant.VEHICLE_PARAMETERS)), *type(law).symbols()]
    for function in FUNCTIONS:
        exact = oracle(flat(getattr(closed, function)), symbols)
        for state in sampled_states(6, seed=1):
            expected = exact(*map(float, state), *p)
            obtained = np.array(flat(getattr(functions, function)(*state, p)), dtype=float)
            # Machine precision of sums whose terms cancel: some ten roundings of the largest entry's terms.
            scale = max(1.0, float(np.max(np.abs(expected))))
            np.testing.assert_allclose(obtained, expected, rtol=1e-12, atol=2e-14 * scale)


@pytest.mark.parametrize("name", ALL_LAWS)
def test_numeric_functions_are_vectorised(name: str) -> None:
    law = sample_law(name)
    functions, p = numeric_plant(type(law)), plant_parameters(law, PARK2008)
    states = sampled_states(12, seed=2)
    for function in FUNCTIONS:
        together = flat(getattr(functions, function)(*states.T, p))
        one_by_one = [flat(getattr(functions, function)(*state, p)) for state in states]
        for column, value in enumerate(together):
            expected = [float(row[column]) for row in one_by_one]
            # array and scalar kernels of exp and sqrt may differ in the last place
            np.testing.assert_allclose(np.broadcast_to(value, len(states)), expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("name", ALL_LAWS)
def test_jacobian_against_central_differences(name: str) -> None:
    law = sample_law(name)
    functions, p = numeric_plant(type(law)), plant_parameters(law, PARK2008)
    for state in sampled_states(40, seed=3):
        if any(abs(abs(state[1] / state[0]) - k.slip) < 1e-3 for k in law.kinks(state[0], PARK2008.wheel_load)):
            continue
        analytic = np.array(functions.jacobian(*state, p), dtype=float)
        size = float(np.max(np.abs(functions.rates(*state, p))))
        for column in range(4):
            step = 2e-4 * max(abs(state[column]), 1e-2)
            derivative = _richardson(
                lambda x, c=column, s=state: functions.rates(*_with(s, c, x), p), state[column], step
            )
            # extrapolated difference: truncation of order step^4, some 1e-9; rounding of the rates over the step
            tolerance = 1e-8 * np.max(np.abs(analytic[:, column])) + 20 * np.finfo(float).eps * size / step
            np.testing.assert_allclose(analytic[:, column], derivative, rtol=1e-8, atol=tolerance)


def _with(state: np.ndarray, column: int, value: float) -> list[float]:
    changed = list(state)
    changed[column] = value
    return changed


def _richardson(function: Callable[[float], Any], x: float, step: float) -> np.ndarray:
    def difference(h: float) -> np.ndarray:
        return (np.array(function(x + h), dtype=float) - np.array(function(x - h), dtype=float)) / (2 * h)

    return (4 * difference(step / 2) - difference(step)) / 3


@pytest.mark.parametrize("name", ALL_LAWS)
def test_force_gradient_is_in_the_jacobian(name: str) -> None:
    law = sample_law(name)
    functions, p = numeric_plant(type(law)), plant_parameters(law, PARK2008)
    for state in sampled_states(5, seed=4):
        gradient = np.array(functions.force_gradient(*state, p), dtype=float)
        jacobian = np.array(functions.jacobian(*state, p), dtype=float)
        # [Park2008] (4): d v'/d(sigma, z) = -dFa/M
        np.testing.assert_allclose(jacobian[0, 1:3], -gradient[1:] / PARK2008.effective_mass, rtol=1e-12, atol=1e-15)


def test_effective_inertias_enter() -> None:
    law = sample_law("bristle")
    scaled = PARK2008.model_copy(update={"inertia_scale": 3.6})
    one, other = plant_parameters(law, PARK2008), plant_parameters(law, scaled)
    assert other[:3] == pytest.approx([3.6 * value for value in one[:3]], rel=1e-15)
    assert other[3:] == one[3:]


def test_adhesion_coefficient_shapes() -> None:
    law = sample_law("beam")
    grid = np.linspace(0.0, 0.5, 6).reshape(2, 3)
    mu = adhesion_coefficient(law, 20.0, grid, 34_500.0)
    assert mu.shape == (2, 3)
    assert mu[1, 2] == adhesion_coefficient(law, 20.0, 0.5, 34_500.0)
    assert adhesion_coefficient(law, 20.0, [], 34_500.0).shape == (0,)


# --- the committed files -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL_LAWS)
def test_committed_code_is_what_the_statement_generates(name: str) -> None:
    file = GENERATED / f"{name}.py"
    if not file.exists():
        pytest.skip(f"{name} runs from code generated at run time; `make generate` gives it a fast start")
    committed = file.read_text(encoding="utf-8")
    assert committed == generate(law_class(name)), "run `make generate`"
    assert not numeric_plant(law_class(name)).generated_in_memory


def test_no_generated_file_without_its_law() -> None:
    found = {path.stem for path in GENERATED.glob("*.py")}
    assert found <= {*law_names(), "__init__", "sliding_law"}
    assert {"beam", "bristle", "curve", "dahl", "lugre", "tyre_lugre"} <= found


def _run(code: str, *, path: Path | None = None) -> str:
    environment = dict(os.environ) | ({"PYTHONPATH": str(path)} if path else {})
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=path, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


TORQUE = """
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import numeric_plant
from railslip_ctrl.model.vehicle import PARK2008, Rail
law = published_law("bristle", Rail.DRY)
point = operating_point(law, PARK2008, 100 / 3.6, 0.132)
linearize(point)
"""


def test_evaluating_numbers_imports_no_sympy() -> None:
    code = TORQUE + "import sys; print([m for m in ('sympy', 'control', 'matplotlib', 'scipy') if m in sys.modules])"
    assert _run(code).strip() == "[]"


@pytest.fixture
def scratch_package(tmp_path: Path) -> Path:
    shutil.copytree(PACKAGE, tmp_path / "railslip_ctrl", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def test_an_edited_plant_changes_the_numbers_at_once(scratch_package: Path) -> None:
    """A sign changed in the statement must reach the numbers, without generating by hand."""
    code = TORQUE + "print(point.brake_torque, numeric_plant(type(law)).generated_in_memory)"
    before, in_memory = _run(code, path=scratch_package).split()
    assert in_memory == "False"
    source = scratch_package / "railslip_ctrl" / "model" / "plant.py"
    text = source.read_text()
    assert text.count("-Fa - Fr - Tr / r") == 1
    source.write_text(text.replace("-Fa - Fr - Tr / r", "-Fa + Fr - Tr / r"))
    after, in_memory = _run(code, path=scratch_package).split()
    assert in_memory == "True"
    # Fr = 0.63 v^2 = 486.1 N enters the trim torque as (J/(r M)) (1 - slip) Fr = 16.84 N*m, twice
    assert float(before) - float(after) == pytest.approx(2 * 16.84, abs=0.01)


def test_main_writes_what_is_committed(scratch_package: Path) -> None:
    target = scratch_package / "railslip_ctrl" / "model" / "_generated"
    for name in ALL_LAWS:
        (target / f"{name}.py").unlink()
        (target / "scalar" / f"{name}.py").unlink()
    _run("from railslip_ctrl.sliding.generate import main; main()", path=scratch_package)
    for file in (file for name in ALL_LAWS for file in (f"{name}.py", f"scalar/{name}.py")):
        assert (target / file).read_text() == (GENERATED / file).read_text()


# --- a law is one file ---------------------------------------------------------------------------------------------

NEW_LAW = '''
"""Burckhardt's curve under another name, as an example of a law added by one file."""
from typing import ClassVar
from railslip_ctrl.model.adhesion.base import AdhesionLaw, Statement
from railslip_ctrl.core.units import quantity

class NewLaw(AdhesionLaw):
    name: ClassVar[str] = "new_law"
    title: ClassVar[str] = "Burckhardt curve, static"
    source: ClassVar[str] = "Burckhardt 1993"
    has_state: ClassVar[bool] = False
    b1: float = quantity("1", "height", gt=0)
    b2: float = quantity("1", "rise", gt=0)
    b3: float = quantity("1", "fall", ge=0)

    @classmethod
    def statement(cls):
        import sympy as sp
        from railslip_ctrl.core.notation import symbol
        b1, b2, b3 = cls.symbols()
        slip = symbol("sigma") / symbol("v")
        mu = sp.sign(slip) * b1 * (1 - sp.exp(-b2 * sp.Abs(slip))) - b3 * slip
        return Statement(force=symbol("N") * mu)
'''


@pytest.fixture
def new_law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[type]:
    (tmp_path / "new_law.py").write_text(NEW_LAW)
    monkeypatch.setattr(
        railslip_ctrl.model.adhesion, "__path__", [*railslip_ctrl.model.adhesion.__path__, str(tmp_path)]
    )
    importlib.invalidate_caches()
    yield law_class("new_law")
    sys.modules.pop("railslip_ctrl.model.adhesion.new_law", None)


def test_adding_a_law_is_one_file(new_law: type) -> None:
    assert "new_law" in law_names()
    law = new_law(b1=0.86, b2=33.82, b3=0.35)
    assert numeric_plant(new_law).generated_in_memory
    found = peak(law, 20.0, 34_500.0)
    # oracle: Burckhardt wet, peak 0.80391 at 0.13069; tolerance half a unit of the last digit
    assert found.slip == pytest.approx(0.13069, abs=0.5e-5)
    assert found.coefficient == pytest.approx(0.80391, abs=0.5e-5)
    plant_there = linearize(operating_point(law, PARK2008, 20.0, 0.2))
    slope = 34_500.0 * (0.86 * 33.82 * np.exp(-33.82 * 0.2) - 0.35) / 20.0
    pole = -(1 / PARK2008.mass + 0.43**2 / 60.35) * slope - 0.25 / 60.35  # system.md, section 2
    assert plant_there.poles[0].real == pytest.approx(pole, rel=1e-12)  # rounding


def test_a_law_stated_with_sign_is_not_linearised_at_zero_slip(new_law: type) -> None:
    """SymPy's derivative drops the jump of sign(sigma) at 0: a silent -b3 instead of b1 b2 - b3."""
    point = operating_point(new_law(b1=0.86, b2=33.82, b3=0.35), PARK2008, 20.0, 0.0)
    with pytest.raises(KinkError, match="slip: 0"):
        linearize(point)
