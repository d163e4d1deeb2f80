"""The `railslip` command, one subcommand a file: parse, call, show.

Imports every room. Begin with `program`, which has the list of commands. `options` has the options that commands share
and what they name, `settings` the helper for one of a command's own, `output` prints.
"""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import NoReturn


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit; errors, and an interruption at any time, are one line on standard error."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: nothing stays behind
    _settle()
    try:
        from .program import run

        run(arguments)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it ends already
        print("\n" * sys.stderr.isatty() + "railslip: interrupted", file=sys.stderr)  # a terminal has shown ^C
        sys.exit(130)


def _settle() -> None:
    """Make this process, and those that it starts, independent of the user's settings for plots, warnings and streams.

    A stream that the shell has closed (>&-) is None: its number would go to the next file that is opened.
    """
    os.environ["MPLBACKEND"] = "agg"  # Jupyter's own is not valid in another environment; Matplotlib reads it on import
    sys.stdin = sys.stdin or open(os.devnull)  # noqa: SIM115  # as those below, open to the end
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    if any("error" in choice for choice in sys.warnoptions):  # a deprecation in a library must not end the work
        os.environ.pop("PYTHONWARNINGS", None)
        sys.warnoptions.clear()
        warnings.resetwarnings()
        for category in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", category)  # as Python has it without options
