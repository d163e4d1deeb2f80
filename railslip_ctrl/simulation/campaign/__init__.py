"""Many braking runs: sampled or swept quantities, every core or a cluster, results on disk, statistics.

`specification` says what a campaign is and reads one from TOML, `execution` runs it into a folder and repeats single
runs, `statistics` tells what came out. `rare` has the probability of an event that a campaign of any length would not
meet, by the methods of `subset`.
"""

from __future__ import annotations

from .execution import Replay, Store, execute, replay
from .rare import ConfidenceLevels, RareEvent, confidence_levels, rare_event
from .specification import Campaign, Choice, Grid, LogNormal, Normal, Quantity, Sampling, Triangular, Uniform
from .statistics import CampaignSummary, campaign, summarise

__all__ = [
    "Campaign", "CampaignSummary", "Choice", "ConfidenceLevels", "Grid", "LogNormal", "Normal", "Quantity",
    "RareEvent", "Replay", "Sampling", "Store", "Triangular", "Uniform", "campaign", "confidence_levels", "execute",
    "rare_event", "replay", "summarise",
]  # fmt: skip
