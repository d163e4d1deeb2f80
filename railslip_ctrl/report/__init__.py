"""Recommendation of a controller, and all records as text, JSON, HTML and pictures; the only user of matplotlib.

It imports every room but `page` and `cli`. Begin with `design_report`, which lays out the report: `recommendation`
tunes and judges, `stops` simulates, `candidates` ranks the controllers, `design_json` writes JSON. `document` has the
blocks that text and HTML render, `export` turns records into JSON and writes files, `page` and `templates/` make an
HTML page, `plots/` the figures, which `pictures` writes, `design_files` the files of a design from the design page.
Output of commands: `text` (linearize, margins, tune), `derivation`, `verification`, `simulation`, `campaign` and
`rare`, `identification`, `reproduction`.
"""

from .export import linear_plant_json, margins_json
from .text import linearize_text, margins_text

__all__ = ["linear_plant_json", "linearize_text", "margins_json", "margins_text"]
