"""The package's exceptions, and the check for packages that `pip install .` leaves out.

Each exception derives from `RailslipError` and from a builtin, so that callers may catch either. A message is one
line: the quantity, its value, the bound and the remedy.
"""

from __future__ import annotations

from importlib.util import find_spec


class RailslipError(Exception):
    """Base of every exception this package raises on purpose."""


class InputError(RailslipError, ValueError):
    """A value, key, unit or file given by the user is not acceptable."""


class DomainError(RailslipError, ValueError):
    """A model is asked for a point outside its domain (for example slip velocity >= gamma)."""


class KinkError(RailslipError, ValueError):
    """A linearisation is asked for at a point where the right-hand side has no unique derivative."""


class MissingParametersError(RailslipError, LookupError):
    """An adhesion law without published parameters is used without parameters from the user."""


class UnstableLoopError(RailslipError, ArithmeticError):
    """Margins are asked for of a closed loop that is not stable.

    unstable_poles: closed-loop poles with non-negative real part, inf for a neutral loop with a chain of them;
    stabilizing_gain_range: factors on the loop gain, nearest to 1 in ratio, for which the loop is stable, or None.
    """

    def __init__(
        self, message: str, *, unstable_poles: float, stabilizing_gain_range: tuple[float, float] | None
    ) -> None:
        super().__init__(message)
        self.unstable_poles = unstable_poles
        self.stabilizing_gain_range = stabilizing_gain_range


class InfeasibleDesignError(RailslipError, ValueError):
    """No controller of the asked structure meets the specification; the message says what can be met."""


EXTRAS = {
    **{"campaign": ("pyarrow",), "cluster": ("distributed",), "gpu": ("numba_cuda",)},
    **{"html": ("latex2mathml",), "identify": ("pandas",)},
}
"""Packages that one command needs, by the extra of pyproject.toml that has them."""


def check_extra(name: str, wanted_by: str, otherwise: str = "") -> None:
    """InputError, which begins with `wanted_by`, where a package of the extra `name` is not installed.

    `otherwise` says what could be done instead.
    """
    for package in EXTRAS[name]:
        if find_spec(package) is None:
            raise InputError(f'{wanted_by}: {package} is not installed; pip install "railslip_ctrl[{name}]"{otherwise}')
