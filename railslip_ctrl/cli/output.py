"""What commands print."""

from __future__ import annotations

import json
from typing import Any

import click


def print_json(content: dict[str, Any]) -> None:
    """One JSON object on standard output; a number that is not finite would be a defect here, and fails."""
    click.echo(json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False))


def progress(message: str) -> None:
    """A line of progress on standard error."""
    click.echo(f"railslip: {message}", err=True)
