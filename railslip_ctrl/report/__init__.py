"""The recommendation; records as text, JSON, HTML and pictures. The only user of matplotlib.

`document` has the blocks that text and HTML render, `export` turns records into JSON and writes files, `text` and
the modules named for a command print its records, `page` and `templates/` make an HTML page, `plots/` the figures.
`recommendation` tunes, judges and runs what `report` shows; `design_report` lays it out: begin there.
Imports every room
but `cli`.
"""

from .export import check_directory, linear_plant_json, margins_json, write_files
from .text import linearize_text, margins_text

__all__ = ["check_directory", "linear_plant_json", "linearize_text", "margins_json", "margins_text", "write_files"]
