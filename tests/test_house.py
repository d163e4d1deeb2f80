"""The house in order: modules and functions of a length that can be read. `make lint` checks imports and cycles."""

import ast

from mutants import PACKAGE, ROOMS
from project import ROOT

LONGEST_MODULE = 800
LONGEST_FUNCTION = 60  # lines without its docstring: a screen
MADE = {"_generated", "_build"}


def test_modules_and_functions_are_short() -> None:
    rooms, long = ("railslip_ctrl", "designs", "analysis", "docs", "tests"), []
    for path in (path for room in rooms for path in (ROOT / room).rglob("*.py")):
        if MADE & set(path.relative_to(ROOT).parts):
            continue
        text = path.read_text(encoding="utf-8")
        if len(text.splitlines()) > LONGEST_MODULE:
            long.append(path)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                told = node.body[0].end_lineno - node.body[0].lineno + 1 if ast.get_docstring(node) else 0
                if node.end_lineno - node.lineno + 1 - told > LONGEST_FUNCTION:
                    long.append(f"{path}, {node.name}")
    assert not long


def test_the_mutants_and_the_makefile_know_files_that_exist() -> None:
    delicate = (ROOT / "Makefile").read_text(encoding="utf-8").partition("$(addsuffix .py,")[2].partition("))")[0]
    asked = {name for names in (*ROOMS.values(), delicate.replace("\\\n", "")) for name in names.split()}
    assert "loop_oracles" in asked
    modules = [path.relative_to(ROOT / PACKAGE).as_posix() for path in (ROOT / PACKAGE).rglob("*.py")]
    assert not [room for room in ROOMS if not any(path.startswith(room) for path in modules)]
    assert not {name for name in asked if not (ROOT / "tests" / f"test_{name}.py").exists()}
