"""The house in order: modules and functions of a length that can be read. `make lint` checks imports and cycles."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from project import ROOT

LONGEST_MODULE, LONGEST_TEST_MODULE = 500, 600
LONGEST_FUNCTION = 60  # lines without its docstring: a screen

GENERATED = ROOT / "railslip_ctrl" / "_generated"
MODULES = sorted(
    path
    for room in ("railslip_ctrl", "designs", "analysis", "docs", "tests")
    for path in (ROOT / room).rglob("*.py")
    if GENERATED not in path.parents
)


def functions(text: str) -> Iterator[tuple[str, int]]:
    """Name and length of every function in a module's text, methods and inner ones too."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            told = node.body[0].end_lineno - node.body[0].lineno + 1 if ast.get_docstring(node) else 0
            yield node.name, node.end_lineno - node.lineno + 1 - told


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_modules_and_functions_are_short(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    longest = LONGEST_TEST_MODULE if path.parent == ROOT / "tests" else LONGEST_MODULE
    assert len(text.splitlines()) <= longest
    assert not {name: length for name, length in functions(text) if length > LONGEST_FUNCTION}


def test_length_is_counted_without_the_docstring() -> None:
    text = (
        'def f():\n    """One.\n\n    Two.\n    """\n    return 1\n\n\nclass C:\n    async def g(self):\n        pass\n'
    )
    assert dict(functions(text)) == {"f": 2, "g": 2}
