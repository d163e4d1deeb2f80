"""Files and commands of a documentation page, in their order on the page.

    ```{file} tram.toml          write the text to tram.toml and show it
    :from: designs/tram.toml     use a file of the repository, shown with a link to download it
    :hidden:                     show only the link
    ```{railslip}                run each line as a command and show its output
    >>>                          Python, which the tests run as a doctest

All files and commands of a page share one folder.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
GENERATED = DOCS / "_generated"

_FENCE = re.compile(r"^```\{(file|railslip)\} *(.*?)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_OPTION = re.compile(r"^:([\w-]+): *(.*)\n", re.MULTILINE)
_PROGRAMS = ("railslip", "python")


@dataclass(frozen=True)
class Block:
    """A file with its name, or commands with an empty name.

    `tested` names the test file that runs the command, if it takes too long for the test of the page.
    """

    name: str
    text: str
    tested: str = ""

    @property
    def commands(self) -> list[list[str]]:
        """Commands as lists of words: `railslip ...`, or `python FILE` for a script of the page."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [shlex.split(line, comments=True) for line in lines if line.split(" ")[0] in _PROGRAMS]


def sources() -> list[Path]:
    """Return the paths of the pages that are not generated, sorted."""
    return sorted(path for path in DOCS.rglob("*.md") if not {"_generated", "_build"} & set(path.parts))


def blocks(text: str) -> list[Block]:
    """Return the blocks of files and commands of a page, in their order."""
    return [
        _block(name, _OPTION.sub("", body), dict(_OPTION.findall(body))) for _kind, name, body in _FENCE.findall(text)
    ]


def _block(name: str, body: str, options: dict[str, str]) -> Block:
    text = repository_text(options["from"]) if "from" in options else body
    return Block(name, text, options.get("tested", ""))


def repository_text(path: str) -> str:
    """Return the text of a file of the repository."""
    return (ROOT / path).read_text("utf-8")


def prepare(folder: Path) -> Path:
    """Create and return the folder in which the commands of a page run."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def renewed(folder: Path, text: str) -> Path:
    """Return the folder of a page, empty if the files or commands of the page, or the package, have changed.

    Old files must go, because a command may refuse them: a campaign refuses the folder of another campaign.
    """
    digest = hashlib.sha256(repr((blocks(text), package_digest())).encode()).hexdigest()
    mark = prepare(folder) / ".made-from"
    if not mark.is_file() or mark.read_text("utf-8") != digest:
        shutil.rmtree(folder)
        (prepare(folder) / mark.name).write_text(digest, encoding="utf-8")
    return folder


@cache
def package_digest() -> str:
    """Return a hash of every source file of the package and of the designs."""
    digest = hashlib.sha256()
    for folder in ("railslip_ctrl", "designs"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".toml", ".yaml") and path.is_file():
                digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return digest.hexdigest()


def run(words: list[str], folder: Path, history: str) -> str:
    """Return the standard output of a command, from a stored copy if package, command and `history` are unchanged.

    RuntimeError if the command fails.
    """
    key = hashlib.sha256(json.dumps([words, history, package_digest()]).encode()).hexdigest()[:16]
    stored = folder / f".{key}.txt"
    if stored.is_file():
        return stored.read_text("utf-8")
    environment = {**os.environ, "COLUMNS": "100", "NO_COLOR": "1"}
    program = {"railslip": ["-m", "railslip_ctrl"], "python": []}[words[0]]
    done = subprocess.run(
        [sys.executable, *program, *words[1:]],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    accepted = (0, 1) if words[0] == "railslip" else (0,)  # exit status 1 is a negative answer
    if done.returncode not in accepted:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr}")
    stored.write_text(done.stdout, encoding="utf-8")
    return done.stdout
