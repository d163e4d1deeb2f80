"""Docstrings and comments of the code: the first line says enough, the words are spelt correctly.

Ruff's rules D check the form of docstrings. Both leave out the files that pyproject.toml lists.
"""

import ast
import io
import re
import tokenize
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest
from project import ROOT

PACKAGE = ROOT / "railslip_ctrl"


def patterns(pattern: str) -> list[str]:
    """Expand the braces of a pattern, as ruff does."""
    start, brace, rest = pattern.partition("{")
    choices, _, end = rest.partition("}")
    return [f"{start}{choice}{end}" for choice in choices.split(",")] if brace else [pattern]


PER_FILE = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["ruff"]["lint"]["per-file-ignores"]
LEFT_OUT = [single for pattern in PER_FILE for single in patterns(pattern)]
MODULES = [
    path
    for path in sorted(PACKAGE.rglob("*.py"))
    if path.parent.name != "_generated"
    and not any(fnmatch(path.relative_to(ROOT).as_posix(), pattern) for pattern in LEFT_OUT)
]

DIRECTIVE = re.compile(r"#\s*(type:|noqa|mypy:|fmt:)")
# code, addresses, quotations, sources
NO_WORDS = re.compile(r"`+[^`]*`+|https?://\S+|doi:\S+|\"[^\"]*\"|'[^'\s]*'|\[[^\]]*\]")
WORD = re.compile(r"(?<![\w.'/^])[A-Za-z][a-z']{3,}(?![\w'(/^])")  # up to three letters it may be a symbol or a unit


def docstrings(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value.value


def comments(path: Path) -> Iterator[str]:
    for token in tokenize.generate_tokens(io.StringIO(path.read_text("utf-8")).readline):
        if token.type == tokenize.COMMENT and not DIRECTIVE.match(token.string):
            yield token.string


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_the_first_line_of_a_docstring_is_a_phrase(path):
    for text in docstrings(path):
        first = text.strip().partition("\n")[0]
        assert first.endswith(".")
        assert len(re.findall(r"[\w|(){}`/^*'-]+", first)) >= 3, first


def test_spelling_of_docstrings_and_comments():
    """Words are English, or in docs/words.txt or tests/data/code_words.txt."""
    from spellchecker import SpellChecker

    dictionary = SpellChecker(language="en")
    for name in ("docs/words.txt", "tests/data/code_words.txt"):
        dictionary.word_frequency.load_words((ROOT / name).read_text("utf-8").split())
    for path in MODULES:
        text = NO_WORDS.sub("", "\n".join([*docstrings(path), *comments(path)]))
        words = {word.lower().removesuffix("'s").strip("'") for word in WORD.findall(text)}
        plurals = {word for word in words if dictionary.known([word.removesuffix("s")])}
        assert not dictionary.unknown(words - plurals), path.relative_to(PACKAGE)
