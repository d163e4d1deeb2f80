"""Messages about a log and its fits: the sentences of `messages.toml` with their numbers filled in."""

from __future__ import annotations

from functools import cache
from typing import Any

from railslip_ctrl.core.templates import texts


def message(name: str, /, **numbers: Any) -> str:
    """Return the sentence called `name`, formatted by `str.format` with the numbers."""
    return _sentence(name).format(**numbers)


@cache
def _sentence(name: str) -> str:
    return " ".join(texts(__package__, "messages.toml")[name].split())
