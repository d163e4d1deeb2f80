"""The recommendation; records as text, JSON, HTML and pictures. The only user of matplotlib.

Imports every room but `page` and `cli`. Begin with `design_report`, which lays out what `recommendation` tunes and
judges and what `stops` runs. `candidates` ranks the controllers by these stops, `design_json` writes the report as
JSON. `document` has the blocks that text and HTML render, `export` turns records into JSON and writes files, `page` and
`templates/` make an HTML page, `plots/` the figures, which `pictures` writes, `design_files` the files of a design
shaped by hand. What a command prints: `text` (linearize, margins, tune), `derivation`, `verification`, `simulation`,
`campaign`, `identification`, `reproduction`.
"""

from .export import linear_plant_json, margins_json
from .text import linearize_text, margins_text

__all__ = ["linear_plant_json", "linearize_text", "margins_json", "margins_text"]
