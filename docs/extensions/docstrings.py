"""Docstrings of the package for Sphinx: markup characters are escaped, and names are linked.

In the docstrings |x| is an absolute value, N*m a unit, and text in backticks a name. A name is linked if its object
exists.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import desc_annotation, pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

from railslip_ctrl.model.vehicle import Record

LONGEST_VALUE = 300  # characters, three lines: a longer value of a constant is not shown

_CODE = re.compile(r"(``.+?``|`[^`]+`)", re.DOTALL)
_SIGNS = re.compile(r"[*|]|(?<=\w)_(?=\W|$)")


def escape(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escape markup characters outside code before the extension napoleon reads the sections of the docstring."""
    lines[:] = _escaped("\n".join(lines)).split("\n")
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]  # an empty comment, because napoleon reads a first line with a colon as a type


def signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, given: str | None, returned: str | None
) -> tuple[str, str | None] | None:
    """Return the signature of a record with argument names only; the list of fields shows the types."""
    if what != "class" or not (isinstance(obj, type) and issubclass(obj, Record)):
        return None
    names = [name if info.is_required() else f"{name}=..." for name, info in obj.model_fields.items()]
    return f"(*, {', '.join(names)})" if names else "()", returned


def _escaped(text: str) -> str:
    parts = _CODE.split(text)
    for i in range(0, len(parts), 2):
        parts[i] = _SIGNS.sub(lambda sign: "\\" + sign[0], parts[i])
        if i and re.match(r"[\w^]", parts[i]):
            parts[i] = "\\ " + parts[i]  # separates a name from the text that follows it
    return "".join(parts)


def resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement) -> Any:
    """Link a name to the only object whose full name ends with it, otherwise show the name without a link.

    Full names in pages and signatures must resolve; Sphinx reports a full name without an object.
    """
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    loose = node["reftype"] == "obj" or bool(node.get("refspecific"))
    if loose or "." not in target or target.startswith("railslip_ctrl."):
        return _link(app, env, node, content) or (content if loose else None)
    return None


def _link(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement) -> Any:
    target = node["reftarget"].removeprefix("~").removesuffix("()")
    objects = env.domains["py"].data["objects"]
    package, _, last = target.removeprefix("railslip_ctrl.").rpartition(".")
    ends = [full for full in objects if full.endswith("." + target)] or [
        full for full in objects if full.endswith("." + last) and full.startswith(f"railslip_ctrl.{package}")
    ]
    if len(ends) != 1:
        return None
    found = objects[ends[0]]
    uri = app.builder.get_relative_uri(node.get("refdoc", env.docname), found.docname)
    return nodes.reference("", "", content, internal=True, refuri=f"{uri}#{found.node_id}")


def leave_out_tables(app: Sphinx, doctree: nodes.document) -> None:
    """Remove the value of a constant if it has more than `LONGEST_VALUE` characters, such as a table of symbols."""
    for value in list(doctree.findall(desc_annotation)):
        if len(value.astext()) > LONGEST_VALUE:
            value.parent.remove(value)


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the handlers; priority 400 runs before napoleon, whose priority is 500."""
    app.connect("autodoc-process-docstring", escape, priority=400)
    app.connect("autodoc-process-signature", signature)
    app.connect("missing-reference", resolve)
    app.connect("doctree-read", leave_out_tables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
