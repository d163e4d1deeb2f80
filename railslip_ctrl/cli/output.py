"""What commands print."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from typing import Any, ParamSpec

import click

from railslip_ctrl.report.layout import WIDTH, columns

P = ParamSpec("P")

_NARROWEST = 60
"""Columns; a narrower terminal breaks the lines itself."""


def print_json(content: dict[str, Any]) -> None:
    """One JSON object on standard output; a number that is not finite would be a defect here, and fails."""
    click.echo(json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False))


def print_text(report: Callable[P, str], *arguments: P.args, **named: P.kwargs) -> None:
    """What `report` says of its arguments, no wider than the terminal; of one width in a pipe or a file."""
    with columns(_terminal_width() if sys.stdout.isatty() else WIDTH):
        text = report(*arguments, **named)
    click.echo(text, nl=False)


def _terminal_width() -> int:
    return min(max(shutil.get_terminal_size().columns, _NARROWEST), WIDTH)


def progress(message: str) -> None:
    """A line of progress on standard error."""
    click.echo(f"railslip: {message}", err=True)
