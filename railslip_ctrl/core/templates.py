"""Texts loaded from TOML files, and Jinja templates filled."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def texts(package: str | None, name: str) -> dict[str, Any]:
    """The tables of a TOML file of a package, `__package__` of who asks; not to be changed."""
    return tomllib.loads(files(package or "").joinpath(name).read_text("utf-8"))


def environment(package: str, **options: Any) -> Any:
    """Jinja's environment of the files in `templates/` of a package; lines with nothing but a statement leave none."""
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
    """The template's text with its numbers, in one line; a float as :g unless the filter f(spec) says otherwise."""
    return " ".join(_template(text).render(numbers).split())


@cache
def _template(text: str) -> Any:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, finalize=lambda value: f"{value:g}" if isinstance(value, float) else value
    )
    environment.filters["f"] = format
    return environment.from_string(text)
