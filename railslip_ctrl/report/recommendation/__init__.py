"""All that a design report of one vehicle shows, as one record.

Begin with `compute.design_report`; `stops` has the braking runs, `records` what comes out. It draws and prints nothing.
"""

from __future__ import annotations

from .compute import design_report
from .records import DesignReport, GainMap, LawCurve, Responses, Rival, ShownLoop, Stop

__all__ = ["DesignReport", "GainMap", "LawCurve", "Responses", "Rival", "ShownLoop", "Stop", "design_report"]
