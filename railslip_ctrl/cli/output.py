"""Printing of JSON, of text that fits the terminal, and of progress lines."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Callable
from typing import Any

import click
from click.core import ParameterSource

from railslip_ctrl.report.document import WIDTH, columns
from railslip_ctrl.report.export import json_text

_NARROWEST = 60  # smallest text width, columns; a narrower terminal wraps the lines


def show(as_json: bool, content: Callable[[], dict[str, Any]], text: Callable[[], str]) -> None:
    """Print the result of `content` as one JSON object if `as_json`, else the result of `text`."""
    if as_json:
        click.echo(json_text(content(), ensure_ascii=False), nl=False)
    else:
        print_text(text)


def print_text(text: Callable[[], str]) -> None:
    """Print the result of `text`, wrapped to the terminal's width, or to `WIDTH` columns in a pipe or a file."""
    terminal = min(max(shutil.get_terminal_size().columns, _NARROWEST), WIDTH)
    with columns(terminal if sys.stdout.isatty() else WIDTH):
        wrapped = text()
    click.echo(wrapped, nl=False)


def progress(message: str) -> None:
    """Print a progress line on standard error; a closed pipe (`2>&1 | head`) is ignored."""
    try:
        click.echo(f"railslip: {message}", err=True)
    except OSError:
        sys.stderr = None


def command_line(ctx: click.Context) -> str:
    """Return the command line of the present call: the command, and the options that the user gave."""
    parts = [ctx.command_path]
    for option in ctx.command.params:
        given = ctx.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE
        value = ctx.params.get(option.name or "")
        values = list(value) if isinstance(value, tuple) else [value]
        if given and isinstance(option, click.Option):
            parts += [option.opts[0]] if value is True else [option.secondary_opts[0]] if value is False else []
            parts += [] if isinstance(value, bool) else [f"{option.opts[0]} {shlex.quote(str(v))}" for v in values]
    return " ".join(parts)
