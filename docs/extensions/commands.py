"""Sphinx directives `file` and `railslip` (see `pages`): they show files, and commands with their output."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from pages import GENERATED, Block, renewed, repository_text, run
from sphinx.addnodes import download_reference
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

_LANGUAGES = {".toml": "toml", ".yaml": "yaml", ".c": "c", ".py": "python", ".csv": "text", ".json": "json"}
_LINES = 40


class _OnPage(SphinxDirective):
    """Base of both directives: folder in which a page's commands run, and hash of the commands and files so far."""

    def folder(self) -> Path:
        text = Path(self.env.doc2path(self.env.docname)).read_text("utf-8")
        return renewed(GENERATED / "run" / self.env.docname, text)

    def history(self, more: str = "") -> str:
        """Return a hash of all earlier commands and files of the page, and of `more`."""
        text = self.env.temp_data.get("railslip", "") + more
        digest = hashlib.sha256(text.encode()).hexdigest()
        self.env.temp_data["railslip"] = digest
        return digest


class FileDirective(_OnPage):
    """Write the text, or a file of the repository, to a file of the page's folder, and show it."""

    has_content = True
    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {"from": directives.unchanged, "hidden": directives.flag}

    def run(self) -> list[nodes.Node]:
        """Return the text with its file name as caption, or only a download link."""
        name, source = self.arguments[0], self.options.get("from", "")
        text = repository_text(source) if source else "\n".join(self.content) + "\n"
        (self.folder() / name).write_text(text, encoding="utf-8")
        self.history(name + text)
        block = nodes.literal_block(text, text, language=_LANGUAGES.get(Path(name).suffix, "text"))
        shown = nodes.literal(name, name)
        link = download_reference("", "", shown, reftarget=f"/../{source}", refdoc=self.env.docname)
        if "hidden" in self.options:
            return [nodes.paragraph("", "", link)]
        caption = nodes.caption("", "", link if source else shown)
        return [nodes.container("", caption, block, literal_block=True, classes=["literal-block-wrapper"])]


class RailslipDirective(_OnPage):
    """Run commands and show them with their output (first `lines` lines, or last `tail`) and `pictures`."""

    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "lines": directives.nonnegative_int,
        "tail": directives.positive_int,
        "pictures": directives.unchanged,
        "alt": directives.unchanged,
        "language": directives.unchanged,
        "tested": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        """Return the commands, their output and their pictures as document nodes."""
        text = "\n".join(self.content) + "\n"
        shown: list[nodes.Node] = [nodes.literal_block(text, text, language="sh")]
        for words in Block("", text).commands:
            output = run(words, self.folder(), self.history(" ".join(words)))
            shown += self._output(output)
        for picture in self.options.get("pictures", "").split():
            uri = f"/_generated/run/{self.env.docname}/{picture}"
            shown.append(nodes.image(uri=uri, alt=self.options.get("alt", picture)))
        return shown

    def _output(self, output: str) -> list[nodes.Node]:
        lines = output.rstrip().splitlines()
        limit = self.options.get("lines", _LINES)
        if limit == 0 or not lines:
            return []
        if tail := self.options.get("tail"):
            lines = ["...", *lines[-tail:]]
            limit = len(lines)
        shown = "\n".join(lines[:limit] + (["..."] if len(lines) > limit else []))
        block = nodes.literal_block(shown, shown, language=self.options.get("language", "text"))
        return [nodes.container("", block, classes=["output"])]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("file", FileDirective)
    app.add_directive("railslip", RailslipDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
