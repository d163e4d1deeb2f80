"""The package's exceptions.

Each derives from `RailslipError` and from a builtin, so that callers may catch either. A message is one
line: the quantity, its value, the bound and the remedy.
"""

from __future__ import annotations


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
