"""The `railslip` command; each subcommand has its own file, which parses the options, calls the package and prints.

Begin with `program`, which has the list of commands. `options` has the options that commands share, `settings` the
helpers for a command's own options, and `output` the functions that print.
"""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import NoReturn


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit; an error or an interruption is reported in one line on standard error."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # cleans up as after Ctrl-C
    _ignore_user_settings()
    try:
        from .program import run

        run(arguments)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not disturb the exit
        print("\n" * sys.stderr.isatty() + "railslip: interrupted", file=sys.stderr)  # new line after the terminal's ^C
        sys.exit(130)


def _ignore_user_settings() -> None:
    os.environ["MPLBACKEND"] = "agg"  # Matplotlib reads it on import; Jupyter's choice may not be installed here
    # a stream that the shell has closed (>&-) is None in Python, and the next opened file would get its descriptor
    sys.stdin = sys.stdin or open(os.devnull)  # noqa: SIM115  # these streams stay open until the process ends
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    if any("error" in choice for choice in sys.warnoptions):  # a library's DeprecationWarning must not stop the command
        os.environ.pop("PYTHONWARNINGS", None)
        sys.warnoptions.clear()
        warnings.resetwarnings()
        for category in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", category)  # Python's default filters
