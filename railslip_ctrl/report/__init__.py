"""Records in, text and JSON out; computes nothing."""

from .files import check_directory, write_files
from .jsonable import design_check_json, linear_plant_json, margins_json
from .text import design_check_text, linearize_text, margins_text

__all__ = [
    "check_directory",
    "design_check_json",
    "design_check_text",
    "linear_plant_json",
    "linearize_text",
    "margins_json",
    "margins_text",
    "write_files",
]
