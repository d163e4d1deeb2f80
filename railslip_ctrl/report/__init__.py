"""Reports: results of every command as text, JSON, HTML and pictures, and the recommendation of a controller.

Only this package uses matplotlib. It may import every other package except `railslip_ctrl.page` and `cli`.

- Design report: `recommendation` tunes and judges controllers, `stops` simulates stops with them, `candidates` sorts
  them, `design_report` writes the report (begin there), `design_json` writes it as JSON. `design_files` makes the
  files that the page of `railslip design` saves.
- Other commands: `text` (linearize, margins, tune), `derivation`, `verification`, `simulation`, `campaign` and `rare`,
  `identification`, `reproduction`.
- Shared modules: `document` defines paragraphs, tables and other blocks for text and HTML. `export` converts results to
  JSON and writes files. `page` and `templates/` make an HTML page. `plots/` draws figures, and `pictures` writes them.
"""

from .export import linear_plant_json, margins_json
from .text import linearize_text, margins_text

__all__ = ["linear_plant_json", "linearize_text", "margins_json", "margins_text"]
