"""What every command has; a module of its own, as listing the commands must import nothing heavy."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

Option = Callable[[Callable[..., Any]], Any]  #: what adds an option to a command

HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
"""`context_settings` of every command. Each has them itself: click keeps the names of the help option from the first
context a command meets, and that may be one without the program above it."""

_ARGUMENTS = {
    **dict.fromkeys(("initial_speed", "model", "rail", "slip", "slip_acceleration", "vehicle")),
    **{"bounds": "bound", "columns": "column", "delays": "delay", "fixed": "fix"},
    **{"time_constant": "tau", "units": "unit", "zeros": "zero"},
}
"""Arguments that texts of the package name in backticks, and the option that gives each where its name is another."""


def options_named(text: str) -> str:
    """A text of the package with its arguments named by the options that give them."""
    found = re.compile(f"`({'|'.join(_ARGUMENTS)})`")
    return found.sub(lambda match: "--" + (_ARGUMENTS[match[1]] or match[1].replace("_", "-")), text)


def option(name: str, metavar: str, text: str, left_out: str, *, to: str | None = None, **kind: Any) -> Option:
    """An option that may be left out: its help ends in what it is then; `to` is the argument that takes it."""
    names = (name,) if to is None else (name, to)
    return click.option(*names, metavar=metavar, help=f"{text}  [default: {left_out}]", **kind)


def preset(name: str, metavar: str, text: str, default: Any, **kind: Any) -> Option:
    """As `option`, of one that has a value when it is left out."""
    return option(name, metavar, text, str(default), default=default, **kind)


def path_option(name: str, metavar: str, text: str, left_out: str = "none") -> Option:
    """As `option`, for a file or a folder."""
    return option(name, metavar, text, left_out, type=click.Path(path_type=Path))


def switch(name: str, text: str, *, to: str | None = None) -> Option:
    """An option without a value."""
    return click.option(*((name,) if to is None else (name, to)), is_flag=True, help=text)


json_option = switch("--json", "Print one JSON object and nothing else.", to="as_json")
