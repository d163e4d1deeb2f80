"""The kernel of a braking run: the functions of a law, a controller and the loop of `kernel`, as one module."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import ModuleType

from railslip_ctrl.design import difference
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.kernels import module_of, module_text, plain

_HERE = Path(__file__).parent


def kernel_text(law: type[AdhesionLaw], controller: str, *, compiled: bool = True) -> str:
    """The module of a law and a controller's source text (see `steps`), to be compiled or to be interpreted."""
    return module_text(law, controller, plain((_HERE / "kernel.py").read_text("utf-8")), compiled=compiled)


def step_text(name: str) -> str:
    """The source of a file of `steps/`, without its imports."""
    return plain((_HERE / "steps" / f"{name}.py").read_text("utf-8"))


def difference_text() -> str:
    """The source of a linear controller's difference equations, without its imports."""
    return plain(Path(difference.__file__).read_text("utf-8"))


@cache
def kernel(law: type[AdhesionLaw], controller: str, *, compiled: bool = True) -> ModuleType:
    """The kernel module, ready to run."""
    return module_of(kernel_text(law, controller, compiled=compiled), compiled=compiled)
