"""A page as a reader of HTML sees it, for tests: ids, links, pictures, tables, text, and what is wrong."""

from __future__ import annotations

import re
from collections import Counter
from html.parser import HTMLParser

LARGEST_BYTES = 5_000_000
CITED = ("https://doi.org/", "https://github.com/railtoolkit/")
"""Where a source may be looked up: a link loads nothing until it is followed."""
_VOID = {"meta", "link", "img", "br", "hr", "input"}
_LOADS = {"src", "srcset", "poster", "data", "action"}


class Page(HTMLParser):
    """Made by `parsed`."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.found: list[str] = []
        self.pieces: list[str] = []
        self.cells: list[tuple[str, list[str]]] = []
        self.figures, self._section, self._in_cell = 0, "", False
        self._open: list[str] = []

    @classmethod
    def parsed(cls, text: str) -> Page:
        """The page of a text."""
        page = cls()
        page.feed(text)
        page.close()
        return page

    @property
    def text(self) -> str:
        """All text but that of style and script, its no-break spaces as others."""
        return "".join(self.pieces).replace("\N{NO-BREAK SPACE}", " ")

    def rows(self, section: str) -> list[list[str]]:
        """Cells of the table rows in a section, by its id."""
        return [row for where, row in self.cells if where == section]

    def problems(self) -> list[str]:
        """What is wrong, a line each."""
        twice = [f"id {name} twice" for name, count in Counter(self.ids).items() if count > 1]
        dead = [f"#{link} leads nowhere" for link in self.links if link not in self.ids]
        odd = [f"{word!r} in the text" for word in ("nan", "None", "inf") if re.search(rf"\b{word}\b", self.text)]
        left = [f"{tag} is not closed" for tag in self._open]
        return [*self.found, *twice, *dead, *odd, *left]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        if tag not in _VOID:
            self._open.append(tag)
        if "id" in given:
            self.ids.append(given["id"])
            if tag in ("section", "footer") and "section" not in self._open[:-1]:
                self._section = given["id"]
        self._check_loads(tag, given)
        if tag == "img":
            self.figures += 1
            if len(given.get("alt", "")) < 40:  # a sentence, not a word
                self.found.append("img without an alt text")
        if tag == "tr":
            self.cells.append((self._section, []))
        self._in_cell = tag in ("td", "th") or (self._in_cell and tag not in ("tr", "table"))
        if tag in ("td", "th"):
            self.cells[-1][1].append("")
        if tag == "mtd" and self._in_cell:  # an entry of a matrix is a number of its own
            self.cells[-1][1][-1] += " "

    def _check_loads(self, tag: str, given: dict[str, str]) -> None:
        href = given.get("href", "")
        if tag == "a" and href.startswith("#"):
            self.links.append(href[1:])
        elif href and not href.startswith("data:") and not (tag == "a" and href.startswith(CITED)):
            self.found.append(f"{tag} leads to {href}")
        for name in _LOADS & set(given):
            if not given[name].startswith("data:"):
                self.found.append(f"{tag} loads {given[name]}")

    def handle_endtag(self, tag: str) -> None:
        if not self._open or self._open[-1] != tag:
            self.found.append(f"</{tag}> closes {self._open[-1:] or 'nothing'}")
        elif tag not in _VOID:
            self._open.pop()
        if tag in ("td", "th"):
            self._in_cell = False

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] in ("style", "script"):
            if re.search(r"url\(|@import|fetch\(|https?:", data):
                self.found.append("style or script loads something: url( or the like")
            return
        self.pieces.append(data)
        if self._in_cell and self.cells:
            self.cells[-1][1][-1] += data
