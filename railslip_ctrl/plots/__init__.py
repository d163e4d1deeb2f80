"""Figures: records in, matplotlib figures out. The only user of matplotlib; computes nothing."""

from .loops import bode_figure, nichols_figure, nyquist_figure, save_figure

__all__ = ["bode_figure", "nichols_figure", "nyquist_figure", "save_figure"]
