"""Messages about a log and its fits, from the templates in `messages.toml`."""

from __future__ import annotations

from functools import cache
from typing import Any

from railslip_ctrl.core.templates import texts


def message(name: str, /, **numbers: Any) -> str:
    """Return the message `name` of `messages.toml`, with `numbers` inserted by `str.format`."""
    return _sentence(name).format(**numbers)


@cache
def _sentence(name: str) -> str:
    return " ".join(texts(__package__, "messages.toml")[name].split())
