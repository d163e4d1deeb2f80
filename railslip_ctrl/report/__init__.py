"""Records in; text, JSON, HTML and pictures out. The only user of matplotlib."""

from .export import check_directory, linear_plant_json, margins_json, write_files
from .text import linearize_text, margins_text

__all__ = [
    "check_directory",
    "linear_plant_json",
    "linearize_text",
    "margins_json",
    "margins_text",
    "write_files",
]
