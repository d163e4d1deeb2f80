"""The house in order: modules and functions of a length that can be read. `make lint` checks imports and cycles."""

import ast
from collections.abc import Iterator

from mutants import ROOMS
from project import ROOT

LONGEST_MODULE = 800
LONGEST_FUNCTION = 60  # lines without its docstring: a screen
MADE = {"_generated", "_build"}
TEXTS = {
    path: path.read_text(encoding="utf-8")
    for room in ("railslip_ctrl", "designs", "analysis", "docs", "tests")
    for path in sorted((ROOT / room).rglob("*.py"))
    if not MADE & set(path.relative_to(ROOT).parts)
}


def functions(text: str) -> Iterator[tuple[str, int]]:
    """Name and length of every function in a module's text, methods and inner ones too."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            told = node.body[0].end_lineno - node.body[0].lineno + 1 if ast.get_docstring(node) else 0
            yield node.name, node.end_lineno - node.lineno + 1 - told


def test_modules_are_short() -> None:
    lengths = {path: len(text.splitlines()) for path, text in TEXTS.items()}
    assert not {str(path.relative_to(ROOT)): length for path, length in lengths.items() if length > LONGEST_MODULE}


def test_functions_are_short() -> None:
    assert not {
        f"{path.relative_to(ROOT)}, {name}": length
        for path, text in TEXTS.items()
        for name, length in functions(text)
        if length > LONGEST_FUNCTION
    }


def test_the_mutants_know_files_that_exist() -> None:
    asked = {name for names in ROOMS.values() for name in names.split()}
    assert not {name for name in asked if not (ROOT / "tests" / f"test_{name}.py").exists()}
