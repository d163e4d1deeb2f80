"""The numbers of [Park2008] beside what the software obtains: tables, the reading, what each of its rules is worth."""

from __future__ import annotations

from .alternatives import ALTERNATIVES, Alternative
from .curves import AdhesionCurve, model_curves
from .facts import Fact, published_facts
from .reading import READING, Basis, Rule
from .runs import CASES, QUANTITIES, Case, CaseResult, Setup, published_runs, published_setup, run_setups
from .sensitivity import Sensitivity, SensitivityRow, sensitivity
from .table3 import Table3, table3
from .table5 import TABLE5, TOLERANCE_PERCENT, Row, Table5, table5

__all__ = [
    "ALTERNATIVES",
    "CASES",
    "QUANTITIES",
    "READING",
    "TABLE5",
    "TOLERANCE_PERCENT",
    "AdhesionCurve",
    "Alternative",
    "Basis",
    "Case",
    "CaseResult",
    "Fact",
    "Row",
    "Rule",
    "Sensitivity",
    "SensitivityRow",
    "Setup",
    "Table3",
    "Table5",
    "model_curves",
    "published_facts",
    "published_runs",
    "published_setup",
    "run_setups",
    "sensitivity",
    "table3",
    "table5",
]
