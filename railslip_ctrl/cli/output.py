"""Printing: JSON, text as wide as the terminal, progress."""

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

_NARROWEST = 60  # columns; a narrower terminal breaks the lines itself


def show(as_json: bool, content: Callable[[], dict[str, Any]], text: Callable[[], str]) -> None:
    """One JSON object on standard output, if that is asked for, else the text."""
    if as_json:
        click.echo(json_text(content(), ensure_ascii=False), nl=False)
    else:
        print_text(text)


def print_text(text: Callable[[], str]) -> None:
    """A text no wider than the terminal; of one width in a pipe or a file."""
    terminal = min(max(shutil.get_terminal_size().columns, _NARROWEST), WIDTH)
    with columns(terminal if sys.stdout.isatty() else WIDTH):
        told = text()
    click.echo(told, nl=False)


def progress(message: str) -> None:
    """A line of progress on standard error; work goes on when its reader has gone (`2>&1 | head`)."""
    try:
        click.echo(f"railslip: {message}", err=True)
    except OSError:
        sys.stderr = None


def command_line(ctx: click.Context) -> str:
    """The command line as it could be typed again."""
    words = [ctx.command_path]
    for option in ctx.command.params:
        given = ctx.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE
        value = ctx.params.get(option.name or "")
        values = list(value) if isinstance(value, tuple) else [value]
        if given and isinstance(option, click.Option):
            words += [option.opts[0]] if value is True else [option.secondary_opts[0]] if value is False else []
            words += [] if isinstance(value, bool) else [f"{option.opts[0]} {shlex.quote(str(one))}" for one in values]
    return " ".join(words)
