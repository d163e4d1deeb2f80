"""Texts with numbers in them: Jinja templates; a float is written as :g unless the filter f(spec) says otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any


def filled(text: str, numbers: Mapping[str, Any]) -> str:
    """The template's text with its numbers, in one line."""
    return " ".join(_template(text).render(numbers).split())


@cache
def _template(text: str) -> Any:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, finalize=lambda value: f"{value:g}" if isinstance(value, float) else value
    )
    environment.filters["f"] = format
    return environment.from_string(text)
