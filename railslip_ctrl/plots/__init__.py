"""Figures: records in, matplotlib figures out. The only user of matplotlib; computes nothing."""

from .designs import gang_of_four_figure, margin_map_figure, region_figure, response_figure, sweep_figure
from .loops import bode_figure, nichols_figure, nyquist_figure
from .style import save_figure

__all__ = [
    "bode_figure",
    "gang_of_four_figure",
    "margin_map_figure",
    "nichols_figure",
    "nyquist_figure",
    "region_figure",
    "response_figure",
    "save_figure",
    "sweep_figure",
]
