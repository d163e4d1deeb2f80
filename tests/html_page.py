"""A page as a reader of HTML sees it, for tests: its text, pictures and tables, and what is wrong."""

import re
from collections import Counter
from xml.etree import ElementTree

LARGEST_BYTES = 5_000_000
CITED = ("https://doi.org/", "https://github.com/railtoolkit/")
"""Where a source may be looked up: a link loads nothing until it is followed."""
_VOID = re.compile(r"<((?:meta|link|img|br|hr|input)\b[^>]*)>")
_PROGRAM = re.compile(r"(?<=<style>).*?(?=</style>)|(?<=<script>).*?(?=</script>)", re.DOTALL)
_LOADS = ("src", "srcset", "poster", "data", "action")


class Page:
    """The page of a text, read as XML: a tag that is not closed where it should be is an error already."""

    def __init__(self, text: str) -> None:
        self.programs = " ".join(_PROGRAM.findall(text))
        self.root = ElementTree.fromstring(_VOID.sub(r"<\1/>", _PROGRAM.sub("", text)))
        self.pictures = self.root.findall(".//img")
        self.text = "".join(self.root.itertext()).replace("\N{NO-BREAK SPACE}", " ")

    def rows(self, section: str) -> list[list[str]]:
        return [["".join(cell.itertext()) for cell in row] for row in self.root.findall(f".//*[@id='{section}']//tr")]

    def problems(self) -> list[str]:
        ids = Counter(self.attributes("id"))
        links = [link.get("href", "") for link in self.root.iter("a")]
        loaded = [one for one in self.attributes("href", *_LOADS) if one not in links]
        return [
            *(f"id {name} twice" for name, count in ids.items() if count > 1),
            *(f"{one} leads nowhere" for one in links if not (one.startswith(CITED) or one[1:] in ids)),
            *(f"loads {one}" for one in loaded if not one.startswith("data:")),
            *(f"style or script: {one}" for one in re.findall(r"url\(|@import|fetch\(|https?:", self.programs)),
            *(f"{word} in the text" for word in re.findall(r"\b(?:nan|None|inf)\b", self.text)),
            *("img without a sentence as alt text" for one in self.pictures if len(one.get("alt", "")) < 40),
        ]

    def attributes(self, *names: str) -> list[str]:
        return [one.attrib[name] for one in self.root.iter() for name in names if name in one.attrib]
