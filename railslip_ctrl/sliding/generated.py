"""The derived law's Python text, committed by `make generate`, so that running the law needs no SymPy.

As in `numeric`: the file carries a hash of the sources the text came from; where it does not fit, the law is derived
at once.
"""

from __future__ import annotations

import hashlib
import re
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from railslip_ctrl.kernels.text import plain

PACKAGE = Path(__file__).parents[1]
LAW_FILE = PACKAGE / "_generated" / "sliding_law.py"

SOURCES = (
    *("plant.py", "notation.py"),
    *("sliding/adaptation.py", "sliding/code_python.py", "sliding/derivation.py", "sliding/identities.py"),
    *("sliding/reaching.py", "sliding/sampled_law.py", "sliding/statement_steps.py", "sliding/steps.py"),
    *("sliding/surface.py", "sliding/symbols.py"),
)
"""What the text follows from."""

_HEAD = "# mypy: ignore-errors\n"
_FOOT = '\n\nSOURCES_SHA256 = "{}"\n'


@cache
def law_source() -> str:
    """Python source of the law of [Park2008] (45) with Ta as an argument, as `code.generate(derive())` gives it."""
    if LAW_FILE.is_file():
        text = LAW_FILE.read_text(encoding="utf-8")
        foot = _FOOT.format(sources_hash())
        if text.startswith(_HEAD) and text.endswith(foot):
            return text.removeprefix(_HEAD).removesuffix(foot)
    return _derived()


@cache
def generated_law() -> Any:
    """The law as a module: `Parameters`, `State`, `start`, `control`, `valid`, `step`."""
    module = ModuleType("railslip_sliding_law")
    exec(compile(law_source(), "<generated sliding-mode law>", "exec"), module.__dict__)
    return module


@cache
def law_kernel_text() -> str:
    """The law's functions for a kernel, and `law_parameters(c, first)`: its parameters, in order from c[first] on."""
    fields = len(generated_law().Parameters._fields)
    numbers = ", ".join(f"float(c[first + {i}])" for i in range(fields))
    text = re.sub(r"^def ", "@compiled\ndef ", plain(law_source()), flags=re.MULTILINE)
    return f"{text}\n\n@compiled\ndef law_parameters(c, first):\n    return Parameters({numbers})\n\n"


def generate_law() -> str:
    """Text of the committed file."""
    return _HEAD + _derived() + _FOOT.format(sources_hash())


def sources_hash() -> str:
    """SHA-256 of the text of `SOURCES`."""
    digest = hashlib.sha256()
    for name in SOURCES:
        digest.update((PACKAGE / name).read_text(encoding="utf-8").encode("utf-8"))  # as text: line ends do not count
    return digest.hexdigest()


def _derived() -> str:
    from .code import generate
    from .derivation import derive

    return generate(derive()).python
