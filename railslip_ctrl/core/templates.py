"""Texts from TOML files, and Jinja templates filled with values."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def texts(package: str | None, name: str) -> dict[str, Any]:
    """Tables of a TOML file in a package, usually the caller's `__package__`; cached, so do not change them."""
    return tomllib.loads(files(package or "").joinpath(name).read_text("utf-8"))


def environment(package: str, **options: Any) -> Any:
    """Jinja environment for a package's folder `templates/`; a line with only a Jinja statement prints nothing."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader(package),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        **options,
    )


def filled(text: str, numbers: Mapping[str, Any]) -> str:
    """Fill numbers into a template and return one line; floats have the format :g, or spec with the filter f(spec)."""
    return " ".join(_template(text).render(numbers).split())


@cache
def _template(text: str) -> Any:
    """Compiled Jinja template of a text."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, finalize=lambda value: f"{value:g}" if isinstance(value, float) else value
    )
    environment.filters["f"] = format
    return environment.from_string(text)
