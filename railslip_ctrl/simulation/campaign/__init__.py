"""Campaigns: many braking runs with sampled or swept quantities, on all cores or a cluster, with statistics.

`specification` defines a campaign and reads it from a TOML file. `execution` simulates its runs, stores the results in
a folder, and repeats single runs. `statistics` computes statistics of the results. `rare` computes the probability of
an event that is too rare for a campaign, by the methods of `subset`.
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
