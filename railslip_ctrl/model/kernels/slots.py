"""What a kernel's text finds in its own module when it is put together: here only named and typed, for reading.

Loops and controllers are ordinary modules, but they are run as text: `text` joins the scalar
functions of an adhesion law, one controller and the kernel into one module, in which these names are real, and has
numba compile it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Marks what numba compiles into the loop, and what may not allocate; in interpreted use it does nothing."""
    return function


def entry(function: F) -> F:
    """Marks what Python calls: compiled, kept, and free to allocate; in interpreted use it does nothing."""
    return function


def _filled_in(name: str) -> Callable[..., object]:
    def slot(*_: object) -> object:
        raise NotImplementedError(f"{name} is filled in where a kernel is put together")

    return slot


adhesion_force = _filled_in("adhesion_force")
command = _filled_in("command")
lag_rate = _filled_in("lag_rate")
rates = _filled_in("rates")
rates_and_powers = _filled_in("rates_and_powers")
rest_state = _filled_in("rest_state")
stiffness = _filled_in("stiffness")

# of the sliding-mode law
assumed_torque = _filled_in("assumed_torque")
law_control = _filled_in("law_control")
law_parameters = _filled_in("law_parameters")
law_state = _filled_in("law_state")
step = _filled_in("step")
store_state = _filled_in("store_state")
