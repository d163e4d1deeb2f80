"""Sources cited by key in docstrings, reports and derivations: "[Park2008] (45)" is equation 45 of it."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from types import MappingProxyType

_TEXTS = tomllib.loads(files(__package__).joinpath("sources.toml").read_text("utf-8"))
SOURCES = MappingProxyType({key: " ".join(text.split()) for key, text in _TEXTS.items()})  #: full references by key


def cite(key: str, where: str = "") -> str:
    """Return "[key] where"; raises KeyError for a key that is not in `SOURCES`."""
    SOURCES[key]
    return f"[{key}] {where}".rstrip()
