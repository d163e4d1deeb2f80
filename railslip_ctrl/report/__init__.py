"""Recommendation of a controller, and all results as text, JSON, HTML and pictures.

Only this package uses matplotlib. It may import every other package except `railslip_ctrl.page` and `cli`. Begin with
`design_report`, the content of the design report: `recommendation` tunes and judges, `stops` simulates, `candidates`
ranks the controllers, `design_json` writes JSON. `document` has the blocks that text and HTML share, `export` converts
results to JSON and writes files, `page` and `templates/` make an HTML page, `plots/` draws figures, `pictures` writes
them, and `design_files` makes the files that the design page saves. Results of commands: `text` (linearize, margins,
tune), `derivation`, `verification`, `simulation`, `campaign` and `rare`, `identification`, `reproduction`.
"""

from .export import linear_plant_json, margins_json
from .text import linearize_text, margins_text

__all__ = ["linear_plant_json", "linearize_text", "margins_json", "margins_text"]
