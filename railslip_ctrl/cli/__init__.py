"""The `railslip` command, one subcommand a file: parse, call, show.

Imports every room. Begin with `program`, which has the list of commands. `options` has the options that commands share
and what they name, `settings` the helper for one of a command's own, `output` prints.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from typing import NoReturn


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit; errors, and an interruption at any time, are one line on standard error."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: nothing stays behind
    try:
        from .program import run

        run(arguments)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it ends already
        print("\n" * sys.stderr.isatty() + "railslip: interrupted", file=sys.stderr)  # a terminal has shown ^C
        sys.exit(130)
