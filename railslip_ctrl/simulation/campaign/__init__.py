"""Many braking runs: sampled or swept quantities, every core or a cluster, results on disk, statistics."""

from __future__ import annotations

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
