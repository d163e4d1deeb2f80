"""What every command has; a module of its own, as listing the commands must import nothing heavy."""

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])

HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
"""`context_settings` of every command. Each has them itself: click keeps the names of the help option from the first
context a command meets, and that may be one without the program above it."""


def option(name: str, metavar: str, text: str, default: str, *, to: str | None = None, **kind: Any) -> Callable[[F], F]:
    """An option that may be left out: its help ends in what it is then; `to` is the argument that takes it."""
    names = (name,) if to is None else (name, to)
    return click.option(*names, metavar=metavar, help=f"{text}  [default: {default}]", **kind)
