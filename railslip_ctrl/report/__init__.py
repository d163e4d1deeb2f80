"""Reports: results of every command as text, JSON, HTML and pictures, and the recommendation of a controller.

Begin with `design_report`, the content of `railslip report`. Only this package uses matplotlib.
"""

from .export import linear_plant_json, margins_json
from .text import linearize_text, margins_text

__all__ = ["linear_plant_json", "linearize_text", "margins_json", "margins_text"]
