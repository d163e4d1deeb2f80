"""Exceptions of the package, and the check for optional dependencies.

Each exception derives from `RailslipError` and from a builtin; callers may catch either. A message is one line with the
quantity, its value, the bound and the remedy.
"""

from __future__ import annotations

from importlib.util import find_spec


class RailslipError(Exception):
    """Base class of all exceptions that the package raises on purpose."""


class InputError(RailslipError, ValueError):
    """A value, key, unit or file from the user is not allowed."""


class DomainError(RailslipError, ValueError):
    """An argument is outside the domain of a model, for example a slip at which the adhesion law is not defined."""


class KinkError(RailslipError, ValueError):
    """The equations of the model have no unique derivative at the point of a linearisation."""


class MissingParametersError(RailslipError, LookupError):
    """An adhesion law has no published parameters and the user has given none."""


class UnstableLoopError(RailslipError, ArithmeticError):
    """Margins are not defined because the closed loop is unstable.

    - unstable_poles: number of closed-loop poles with non-negative real part; inf for a neutral loop with infinitely
      many of these poles.
    - stabilizing_gain_range: interval of loop-gain factors, ratios, that make the loop stable; if several exist, the
      interval nearest to 1 on a logarithmic scale. None if no factor stabilises the loop.
    """

    def __init__(
        self, message: str, *, unstable_poles: float, stabilizing_gain_range: tuple[float, float] | None
    ) -> None:
        super().__init__(message)
        self.unstable_poles = unstable_poles
        self.stabilizing_gain_range = stabilizing_gain_range


class InfeasibleDesignError(RailslipError, ValueError):
    """No controller of the given structure meets the specification; the message names a feasible specification."""


EXTRAS = {
    **{"campaign": ("pyarrow",), "cluster": ("distributed",), "gpu": ("numba_cuda",)},
    **{"html": ("latex2mathml",), "identify": ("pandas",)},
}
"""Packages that `check_extra` requires, by the name of the extra in pyproject.toml."""


def check_extra(name: str, wanted_by: str, otherwise: str = "") -> None:
    """Raise InputError if a package of the extra `name` is not installed.

    - wanted_by: option or argument that needs the package; the message begins with it.
    - otherwise: alternative remedy, appended to the message.
    """
    for package in EXTRAS[name]:
        if find_spec(package) is None:
            raise InputError(f'{wanted_by}: {package} is not installed; pip install "railslip_ctrl[{name}]"{otherwise}')
