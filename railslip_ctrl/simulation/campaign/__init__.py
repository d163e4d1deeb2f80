"""Many braking runs: sampled or swept quantities, every core or a cluster, results on disk, statistics.

`specification` says what a campaign is and reads one from TOML, `execution` runs it into a folder and repeats single
runs, `statistics` tells what came out.
"""

from __future__ import annotations

from .execution import Replay, Store, execute, replay
from .specification import Campaign, Choice, Grid, LogNormal, Normal, Quantity, Sampling, Triangular, Uniform
from .statistics import CampaignSummary, campaign, summarise

__all__ = [
    "Campaign", "CampaignSummary", "Choice", "Grid", "LogNormal", "Normal", "Quantity", "Replay", "Sampling",
    "Store", "Triangular", "Uniform", "campaign", "execute", "replay", "summarise",
]  # fmt: skip
