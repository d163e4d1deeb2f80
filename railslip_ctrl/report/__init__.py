"""Records in, text and JSON out; computes nothing."""

from .files import write_files
from .jsonable import design_check_json, linear_plant_json, margins_json
from .text import design_check_text, linearize_text, margins_text

__all__ = [
    "design_check_json",
    "design_check_text",
    "linear_plant_json",
    "linearize_text",
    "margins_json",
    "margins_text",
    "write_files",
]
