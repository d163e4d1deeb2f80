"""Matplotlib figures of results that other packages compute; no other package imports matplotlib."""

from .designs import (
    bode_figure,
    gang_of_four_figure,
    loop_figure,
    ms_map_figure,
    nichols_figure,
    nyquist_figure,
    region_figure,
    response_figure,
    sweep_figure,
)
from .identification import (
    adhesion_figure,
    braking_figure,
    coefficients_figure,
    drift_figure,
    estimates_figure,
    observer_responses_figure,
    rig_test_figure,
)
from .runs import adaptation_figure, lyapunov_runs_figure, no_lock_figure, run_comparison_figure
from .style import save_figure

__all__ = [
    "adaptation_figure", "adhesion_figure", "bode_figure", "braking_figure", "coefficients_figure", "drift_figure",
    "estimates_figure", "gang_of_four_figure", "loop_figure", "lyapunov_runs_figure", "ms_map_figure",
    "nichols_figure", "no_lock_figure", "nyquist_figure", "observer_responses_figure", "region_figure",
    "response_figure", "rig_test_figure", "run_comparison_figure", "save_figure", "sweep_figure",
]  # fmt: skip
