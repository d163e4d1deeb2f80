"""Helpers for the options of a command. The module imports little, so that the list of commands appears fast."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

Option = Callable[[Callable[..., Any]], Any]  #: decorator that adds an option to a command

# Every command needs its own settings: Click takes the names of the help option from the first context of a command,
# and that context may have no parent.
HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 110}

# option of each argument that messages name in backticks; None: the option has the name of the argument
_ARGUMENTS = {
    **dict.fromkeys(("initial_speed", "model", "rail", "slip", "slip_acceleration", "vehicle")),
    **{"bounds": "bound", "columns": "column", "delays": "delay", "fixed": "fix"},
    **{"time_constant": "tau", "units": "unit", "zeros": "zero"},
}


def options_named(text: str) -> str:
    """Replace each argument name in backticks in a message by the name of the option."""
    argument = re.compile(f"`({'|'.join(_ARGUMENTS)})`")
    return argument.sub(lambda match: "--" + (_ARGUMENTS[match[1]] or match[1].replace("_", "-")), text)


def option(name: str, metavar: str, text: str, default_text: str, *, to: str | None = None, **kind: Any) -> Option:
    """Return a Click option that may be left out; its help ends with `default_text`.

    `to` is the parameter of the command function that gets the value; by default its name is that of the option.
    """
    names = (name,) if to is None else (name, to)
    return click.option(*names, metavar=metavar, help=f"{text}  [default: {default_text}]", **kind)


def preset(name: str, metavar: str, text: str, default: Any, **kind: Any) -> Option:
    """Return an `option` with a `default` value, which its help shows."""
    return option(name, metavar, text, str(default), default=default, **kind)


def path_option(name: str, metavar: str, text: str, default_text: str = "none") -> Option:
    """Return an `option` for a file or a folder."""
    return option(name, metavar, text, default_text, type=click.Path(path_type=Path))


def switch(name: str, text: str, *, to: str | None = None) -> Option:
    """Return an option without a value."""
    return click.option(*((name,) if to is None else (name, to)), is_flag=True, help=text)


json_option = switch("--json", "Print one JSON object and nothing else.", to="as_json")
