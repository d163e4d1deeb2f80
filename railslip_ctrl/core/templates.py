"""Texts from TOML files, and Jinja templates filled with values."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def texts(package: str | None, name: str) -> dict[str, Any]:
    """Return the tables of the TOML file `name` in a package; the result is cached, so do not change it."""
    return tomllib.loads(files(package or "").joinpath(name).read_text("utf-8"))


def environment(package: str, **options: Any) -> Any:
    """Return the Jinja environment for the folder `templates/` of a package."""
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
    """Fill numbers into a template and return one line; floats have format :g unless the filter f(".2f") changes it."""
    return " ".join(_template(text).render(numbers).split())


@cache
def _template(text: str) -> Any:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, finalize=lambda value: f"{value:g}" if isinstance(value, float) else value
    )
    environment.filters["f"] = format
    return environment.from_string(text)
