"""What is told of a log and of what was fitted to it: the sentences of `words.toml`, with their numbers."""

from __future__ import annotations

from functools import cache
from typing import Any

from railslip_ctrl.core.templates import texts


def told(name: str, /, **numbers: Any) -> str:
    """The sentence of a name with its numbers put in, as `str.format` does."""
    return _sentence(name).format(**numbers)


@cache
def _sentence(name: str) -> str:
    return " ".join(texts(__package__, "words.toml")[name].split())
