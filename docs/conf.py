"""Sphinx configuration. `make docs` runs `generate.py` first; the build needs no network."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "extensions"), str(HERE)]

from railslip_ctrl import __version__  # noqa: E402  import after the path is set

project = "railslip_ctrl"
author = "the railslip_ctrl developers"
project_copyright = author
release = version = __version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_parser",
    "mathml",
    "docstrings",
    "commands",
]
exclude_patterns = ["_build", "_generated/equations", "_generated/run", "_generated/*.md"]

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
myst_links_external_new_tab = False
suppress_warnings = [
    "myst.header",  # an included file may begin below the first heading level
    "ref.python",  # a name in backticks that belongs to several records is not linked
]

autodoc_default_options = {
    "members": True,
    "exclude-members": "model_config",  # setting of pydantic, equal for every record
    "show-inheritance": True,
    "member-order": "bysource",
}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_ivar = True  # list attributes below the class; separate entries would appear twice
napoleon_use_rtype = False
default_role = "py:obj"  # links `name` in a docstring if the object exists, see extensions/docstrings.py
toc_object_entries_show_parents = "hide"

nitpicky = True
# Objects of other projects cannot be linked: their inventories need the network.
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|np|control|ct|sympy|sp|scipy|pandas|pd|pyarrow|pa|matplotlib)\..*"),
    (r"py:.*", r"(pydantic\w*|annotated_types|http|click|markupsafe|rich|numba|flint|datetime|ast)\..*"),
    (r"py:.*", r"(abc|collections\.abc|concurrent|pathlib|enum|types|typing|dataclasses|contextlib|distributed)\..*"),
    (r"py:class", r"(NDArray|ArrayLike|Figure|Axes|Path|Any|RenderableType|ValidationError|BaseModel|Self|Literal)"),
    (
        r"py:class",
        r"(Markup|FrequencyResponseData|layout\.\w+|None\.\w+)",
    ),  # names imported only for type checkers, or renamed on import
    (r"py:class", r"railslip_ctrl\..*\._\w+"),  # private bases of public classes
    (r"py:class", r"railslip_ctrl\.design\.tuning\.TunedCases"),
    # type aliases
    (
        r"py:class",
        r"(.*\.)?(Floats|Integers|Complexes|Bools|Booleans|Columns"
        r"|Indices|Batch|Flags|State|Method|How|Reference|F|L|R|T|_M)",
    ),
    (r"py:class", r".*\[.*"),  # parts of a generic type, which Sphinx splits at its commas
]

html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"railslip_ctrl {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
