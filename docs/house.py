"""Print the size of the package by subpackage, and draw which subpackage imports which.

The names `room` and `floor` mean subpackage and level of imports.

python docs/house.py [PICTURE.svg]
"""

from __future__ import annotations

import ast
import sys
from collections import Counter, defaultdict
from pathlib import Path
from textwrap import fill

import grimp

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "railslip_ctrl"
SAME = 6
"""Number of equal consecutive lines, without blank lines and imports, that count as a duplicate."""


def rooms() -> dict[str, tuple[set[str], int, int]]:
    """Return, for each subpackage, its imported subpackages and its numbers of files and lines; top level first."""
    graph = grimp.build_graph("railslip_ctrl")
    below: dict[str, set[str]] = defaultdict(set)
    for module in graph.modules:
        for imported in graph.find_modules_directly_imported_by(module):
            above, under = (name.split(".")[1] for name in (f"{module}.", f"{imported}."))
            if above and under and above != under and (PACKAGE / above).is_dir():
                below[above].add(under)
    found = {}
    for folder in sorted(path.parent for path in PACKAGE.glob("*/__init__.py")):
        texts = sources(folder)
        found[folder.name] = (below[folder.name], len(texts), sum(len(text.splitlines()) for text in texts.values()))
    return dict(sorted(found.items(), key=lambda room: -floor(room[0], below)))


def floor(room: str, below: dict[str, set[str]]) -> int:
    """Return the level of a subpackage: one above the highest that it imports, 1 without imports."""
    return 1 + max((floor(one, below) for one in below[room]), default=0)


def sources(folder: Path) -> dict[Path, str]:
    """Return the text of every module in a folder, without generated modules."""
    return {path: path.read_text("utf-8") for path in sorted(folder.rglob("*.py")) if "_generated" not in path.parts}


def names_used_twice() -> list[str]:
    """Return the class names that are defined more than once."""
    trees = [ast.parse(text) for text in sources(PACKAGE).values()]
    counted = Counter(node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))
    return sorted(name for name, count in counted.items() if count > 1)


def written_twice() -> int:
    """Return the number of duplicates: pairs of places that share at least `SAME` lines."""
    places: dict[tuple[str, ...], list[tuple[Path, int]]] = defaultdict(list)
    for path, text in sources(PACKAGE).items():
        stripped = (line.strip() for line in text.splitlines())
        lines = [line for line in stripped if line and not line.startswith(("from ", "import "))]
        for start in range(len(lines) - SAME + 1):
            places[tuple(lines[start : start + SAME])].append((path, start))
    pairs = {(a, b) for same in places.values() for a in same for b in same if a < b}
    # a longer duplicate counts once, at its first line
    return sum(((a[0], a[1] - 1), (b[0], b[1] - 1)) not in pairs for a, b in pairs)


def counts() -> str:
    """Return the counts of the package as a text table, then one line for each subpackage."""
    house = rooms()
    below = defaultdict(set, {name: room[0] for name, room in house.items()})
    package, tests = sources(PACKAGE), sources(ROOT / "tests")
    rows = {
        "lines of the package": sum(len(text.splitlines()) for text in package.values()),
        "files": len(package),
        "subpackages": len(house),
        "levels of imports": max(floor(name, below) for name in house),
        "imports between them": sum(len(room[0]) for room in house.values()),
        "class names used twice": len(names_used_twice()),
        "pairs of equal code": written_twice(),
        "lines of the tests": sum(len(text.splitlines()) for text in tests.values()),
    }
    lines = [f"{name:24}{count:7}" for name, count in rows.items()]
    lines += ["", "generated code is not counted", ""]
    lines += [f"{name:16}{files:4} files{count:7} lines" for name, (_, files, count) in house.items()]
    return "\n".join(lines)


def shown_arrows(below: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Return the imports between subpackages, without those that follow from other imports."""
    reached: dict[str, set[str]] = {}
    for room in sorted(below, key=lambda room: floor(room, below)):
        reached[room] = set().union(below[room], *(reached[one] for one in below[room]))
    return [(a, b) for a in below for b in below[a] if not any(b in reached[one] for one in below[a])]


def picture(path: Path) -> None:
    """Draw the subpackages by level, with an arrow to each imported subpackage."""
    import matplotlib.pyplot as plt

    house = rooms()
    below = defaultdict(set, {name: room[0] for name, room in house.items()})
    drawn, height = shown_arrows(dict(below)), {name: floor(name, below) for name in house}
    figure, axes = plt.subplots(figsize=(7.5, 6.0), layout="constrained")
    boxes = {}
    for name, (_, files, lines) in house.items():
        beside = sorted(one for one in house if height[one] == height[name])
        passed = any(height[a] > height[name] > height[b] for a, b in drawn)  # an arrow needs the space on the left
        x = 0.75 if passed else (beside.index(name) + 0.5) / len(beside)
        doc = ast.get_docstring(ast.parse((PACKAGE / name / "__init__.py").read_text("utf-8"))) or ""
        text = fill(doc.splitlines()[0].replace("`", ""), 62)
        title = f"$\\bf{{{name}}}$ ({files} files, {lines} lines)"
        boxes[name] = axes.text(
            *(x, height[name], f"{title}\n{text}"),
            **{"ha": "center", "va": "center", "fontsize": 7, "bbox": {"boxstyle": "round", "fc": "0.93", "ec": "0.3"}},
        )
    axes.set(xlim=(0, 1), ylim=(0.5, max(height.values()) + 0.5))
    axes.set_axis_off()
    for above, under in drawn:
        ends = {"patchA": boxes[above].get_bbox_patch(), "patchB": boxes[under].get_bbox_patch()}
        style = {"arrowstyle": "-|>", "color": "0.3", "shrinkA": 0, "shrinkB": 0, **ends}
        axes.annotate("", boxes[under].get_position(), boxes[above].get_position(), arrowprops=style)
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    print(counts())
    if len(sys.argv) > 1:
        picture(Path(sys.argv[1]))
