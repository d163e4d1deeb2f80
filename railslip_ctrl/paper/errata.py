"""All errata of [Park2008]: equations as printed against the derivation, numbers computed again."""

from __future__ import annotations

from railslip_ctrl.sliding.derivation import Derivation

from .errata_adhesion import adhesion_errata
from .errata_law import law_errata
from .errata_numbers import number_errata
from .erratum import Erratum

__all__ = ["Erratum", "errata"]


def errata(derivation: Derivation) -> tuple[Erratum, ...]:
    """The rows, those that agree among them, in the order adhesion and observer, law, numbers."""
    return (*adhesion_errata(), *law_errata(derivation), *number_errata(derivation))
