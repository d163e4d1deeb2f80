"""Everything a design review looks at, of one vehicle, as one frozen record: what `report.html` shows."""

from .assemble import SECTIONS, design_report
from .records import (
    Attempt,
    DesignReport,
    GainRegion,
    LawCurve,
    LinearPart,
    LoopDesign,
    LoopDesigns,
    Origin,
    RangeLine,
    RunPart,
    Shortfall,
    SlidingVerdict,
    SlowEnd,
    SlowRun,
    SpeedRange,
    Stop,
    StopRun,
)

__all__ = [
    "SECTIONS",
    "Attempt",
    "DesignReport",
    "GainRegion",
    "LawCurve",
    "LinearPart",
    "LoopDesign",
    "LoopDesigns",
    "Origin",
    "RangeLine",
    "RunPart",
    "Shortfall",
    "SlidingVerdict",
    "SlowEnd",
    "SlowRun",
    "SpeedRange",
    "Stop",
    "StopRun",
    "design_report",
]
