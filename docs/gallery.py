"""Gallery pages: run every script of designs/ and analysis/, and show its pictures, output and code.

The results of a script are stored until the package or the script changes.
"""

from __future__ import annotations

import ast
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from pages import ROOT, package_digest

FOLDERS = ("designs", "analysis")
THUMBNAIL = (480, 360)
"""Largest width and height, pixels, of a picture on the overview page of the gallery."""

NUMBERS = {
    **{"RUNS": "200", "SEEDS": "16", "CURVES": "8", "FIRST": "0", "SPREAD": "0"},
    **{"STOPS": "400", "POINTS": "100"},
}
"""Values of the arguments in the usage lines of the scripts: small, so that the build of the site takes minutes."""

_PRINTED = "printed.txt"
_DONE = "done"


@dataclass(frozen=True)
class Script:
    """A script, and the folder of the gallery with its results."""

    path: Path
    folder: Path

    @property
    def name(self) -> str:
        """Name without folder and suffix: "pi_dry" of designs/pi_dry.py."""
        return self.path.stem

    @property
    def docstring(self) -> list[str]:
        """Lines of the script's docstring; the first line is the question."""
        text = ast.get_docstring(ast.parse(self.path.read_text("utf-8")))
        assert text is not None, "every script has a docstring"
        return text.splitlines()

    @property
    def usage(self) -> str:
        """Usage line of the docstring: `python designs/... [ARGUMENTS]`."""
        called = f"python {self.path.relative_to(ROOT)}"
        return next(line.strip() for line in self.docstring if line.strip().startswith(called))

    def arguments(self) -> list[str]:
        """Return the arguments for the gallery's run, in the order of the usage line."""
        given = {**NUMBERS, "FOLDER": str(self.folder)}
        return [given[name] for name in re.findall(r"\[([A-Z]+)", self.usage)]

    @property
    def digest(self) -> str:
        """Hash of the package and the script."""
        return hashlib.sha256(self.path.read_bytes() + package_digest().encode()).hexdigest()

    @property
    def fresh(self) -> bool:
        """True if the stored results come from the present script and package."""
        done = self.folder / _DONE
        return done.is_file() and done.read_text() == self.digest

    @property
    def pictures(self) -> list[Path]:
        """Paths of the pictures that the script drew, sorted by name."""
        return sorted(self.folder.glob("*.png"))

    @property
    def thumbnail(self) -> Path:
        """Path of the small copy of the first picture."""
        return self.folder / "thumbnail" / "first.png"

    @property
    def printed(self) -> str:
        """Printed output, empty if the script has not run."""
        path = self.folder / _PRINTED
        return path.read_text("utf-8") if path.is_file() else ""


def scripts(folder: Path) -> list[Script]:
    """Return all scripts, first the designs, sorted by name."""
    return [Script(path, folder / path.stem) for name in FOLDERS for path in sorted((ROOT / name).glob("*.py"))]


def write_gallery(folder: Path, *, run: bool) -> None:
    """Run the changed scripts if `run`, then write a page for each script and the overview."""
    every = scripts(folder)
    for script in every:
        script.folder.mkdir(parents=True, exist_ok=True)
    if run:
        stale = [script for script in every if not script.fresh]
        # one process with one thread for each processor
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(_run, stale))
    for script in every:
        _draw_thumbnail(script)
        (folder / f"{script.name}.md").write_text("\n".join(_page(script)), encoding="utf-8")
    (folder / "index.md").write_text("\n".join(_index(every)), encoding="utf-8")


def _run(script: Script) -> None:
    """Run one script, which writes into its folder; RuntimeError if it fails."""
    shutil.rmtree(script.folder)
    script.folder.mkdir()
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "110", "NO_COLOR": "1"}
    done = subprocess.run(
        [sys.executable, str(script.path), *script.arguments()],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"{script.path.relative_to(ROOT)} failed:\n{done.stderr}")
    printed = done.stdout.replace(str(script.folder), "FOLDER")
    (script.folder / _PRINTED).write_text(printed, encoding="utf-8")
    (script.folder / _DONE).write_text(script.digest)


def _draw_thumbnail(script: Script) -> None:
    """Write the small copy of the first picture, if the script has pictures and no copy exists."""
    from PIL import Image

    if not script.pictures or script.thumbnail.is_file():
        return
    script.thumbnail.parent.mkdir(exist_ok=True)
    with Image.open(script.pictures[0]) as picture:
        small = picture.convert("RGB")
        small.thumbnail(THUMBNAIL)
        small.quantize(64).save(script.thumbnail, optimize=True)


def _page(script: Script) -> Iterator[str]:
    where = script.path.relative_to(ROOT)
    title, *rest = script.docstring
    yield from (f"# {script.name}", "", f"**{title}**", "")
    yield from (line for line in rest if line.strip() != script.usage)
    yield from ("", "```sh", script.usage, "```", "")
    for picture in script.pictures:
        alt = f"{picture.stem.replace('_', ' ')}, drawn by {where}"
        yield from (f"![{alt}]({script.name}/{picture.name})", "")
    if script.printed:
        yield from ("## Output", "", "```text", script.printed.rstrip(), "```", "")
    source = "/".join([".."] * 3 + [str(where)])
    yield from (f"## {where}", "", f"```{{literalinclude}} {source}", ":language: python", "```", "")


def _index(every: list[Script]) -> Iterator[str]:
    yield from ("# Gallery", "")
    yield "For readers who learn from complete examples. Each script of the repository answers one question. Its page"
    yield from ("has the pictures, the output and the code. The scripts ran when this page was built.", "")
    for folder, title in zip(FOLDERS, ("Designs", "Questions"), strict=True):
        yield from (f"## {title}", "", "::::{container} gallery", "")
        for script in every:
            if script.path.parent.name != folder:
                continue
            yield from (":::{container}", "", f"**[{script.name}]({script.name}.md)**", "", script.docstring[0], "")
            if script.thumbnail.is_file():
                small = f"{script.name}/thumbnail/{script.thumbnail.name}"
                yield from (f"[![{script.name}, first picture]({small})]({script.name}.md)", "")
            yield from (":::", "")
        yield from ("::::", "")
    yield from ("```{toctree}", ":hidden:", "", *(script.name for script in every), "```", "")
