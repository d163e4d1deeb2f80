"""Many braking runs: sampled or swept quantities, every core or a cluster, results on disk, statistics."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from .execution import Replay, campaign, execute, replay
from .sampling import Choice, Grid, LogNormal, Normal, Sampling, Triangular, Uniform
from .specification import Campaign, Quantity
from .statistics import CampaignSummary, summarise
from .storage import Store

__all__ = [
    "Campaign",
    "CampaignSummary",
    "Choice",
    "Grid",
    "LogNormal",
    "Normal",
    "Quantity",
    "Replay",
    "Sampling",
    "Store",
    "Triangular",
    "Uniform",
    "campaign",
    "execute",
    "replay",
    "summarise",
]


class _Callable(ModuleType):
    """`railslip_ctrl.campaign` is this room, and the function too: one name for both, whichever comes first."""

    def __call__(self, *args: Any, **options: Any) -> CampaignSummary:
        return campaign(*args, **options)


sys.modules[__name__].__class__ = _Callable
