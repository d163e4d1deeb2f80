"""The `railslip` command group, which imports the module of a subcommand only when the user calls it."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

import click
from click.shell_completion import CompletionItem

from railslip_ctrl import __version__
from railslip_ctrl.core.errors import InputError, RailslipError

from .settings import HELP, options_named

PROGRAM = "railslip"

_COMMANDS = {
    "report": "recommend a controller for a vehicle, with the lowest speed for slip control and the reasons",
    "design": "shape the loop by hand in the browser, with a map of gains, exact margins and braking runs",
    "linearize": "compute the operating point, A, B, C, D, poles, zeros and transfer function",
    "margins": "compute all margins of a loop, certified if asked; judge a controller over an envelope",
    "tune": "find gains that meet a specification, over an envelope or at operating points",
    "derive": "derive the sliding-mode laws step by step, list the errata of Park et al., or write C99 or Python",
    "identify": "fit adhesion laws to brake-rig logs and find the reference slip",
    "campaign": "run a scenario many times with sampled or swept quantities, on all cores or a Dask cluster",
    "verify": "check whether the stability conditions of a sliding-mode law hold",
    "simulate": "simulate a braking run: numbers, time series, pictures",
    "reproduce": "compare our results with those of Park et al., and show which units lead to the published numbers",
}


class _LazyGroup(click.Group):
    """Command group that imports a command's module only when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        command: click.Command = import_module(f".{cmd_name}", __package__).command
        return command

    def invoke(self, ctx: click.Context) -> Any:
        try:  # Click would print an empty line when interrupted, and exit with 1 on a broken pipe
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise click.Abort from None
        except BrokenPipeError:
            _end_without_reader()

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in _COMMANDS and not ctx.resilient_parsing:
            from railslip_ctrl.core.units import shown
            from railslip_ctrl.core.user_files import close_match

            near = close_match(args[0].lower(), _COMMANDS).rstrip()
            raise InputError(f"unknown command {shown(args[0])}; {near or 'choose one of ' + ', '.join(_COMMANDS)}")
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None and not ctx.resilient_parsing:
            _check_repeated(ctx, command, rest)
        return name, command, rest

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        commands = [CompletionItem(name, help=text) for name, text in _COMMANDS.items() if name.startswith(incomplete)]
        return [*commands, *click.Command.shell_complete(self, ctx, incomplete)]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


def _check_repeated(ctx: click.Context, command: click.Command, arguments: Sequence[str]) -> None:
    # Click would silently use the last value of an option that takes one value
    parser = command.make_parser(click.Context(command, parent=ctx))  # the parent has the names of the help option
    given = parser.parse_args(list(arguments))[2]
    for option in dict.fromkeys(given):
        if not isinstance(option, click.Option) or option.multiple:
            continue
        is_switch = option.is_flag and not option.secondary_opts  # repeating a switch has no effect
        if given.count(option) > 1 and not is_switch:
            raise InputError(f"{option.opts[0]} is given {given.count(option)} times; give it once")


@click.group(cls=_LazyGroup, context_settings=HELP)
@click.version_option(__version__, prog_name=PROGRAM)
def railslip() -> None:
    """Design wheel-slip controllers for trains.

    Plain numbers are SI unless the option names a unit; a value may carry its own unit ("3.5 t", "65 N*m/(km/h)").
    Exit status: 0 done, 1 a check fails, 2 bad input.

    Example: railslip margins --rail dry --kp "65 N*m/(km/h)" --ki "1.4 N*m/(km/h)/s"
    """


def run(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit; every error is one line on standard error.

    Raises KeyboardInterrupt if the user interrupts the command.
    """
    for stream in (sys.stdout, sys.stderr):
        reconfigure: Any = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")  # a terminal without Unicode shows "?" instead of raising an error
    try:
        status = railslip.main(args=arguments, prog_name=PROGRAM, standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        sys.exit(2)
    except click.ClickException as error:
        _fail(error.format_message())
    except RailslipError as error:
        _fail(str(error))
    except ArithmeticError as error:
        # numbers that are allowed one by one can overflow together, e.g. a wheel of 1e12 kg m^2 under 1 kg
        _fail(f"the combination of numbers is outside the range of the computation ({error}); check all magnitudes")
    except click.Abort:
        raise KeyboardInterrupt from None
    except BrokenPipeError:
        _end_without_reader()
    except OSError as error:
        sys.stdout = None
        _fail(f"the output cannot be written ({error.strerror or error}); free some space or choose another place")
    sys.exit(status if isinstance(status, int) else 0)


def _end_without_reader() -> NoReturn:
    sys.stdout = None  # otherwise Python would flush the rest at exit
    sys.exit(141)  # the status of SIGPIPE: the reader of the output (head, less) has closed the pipe


# Quantities with the name of an option, at the beginning of a message of the package.
_OPTION_NAMED = re.compile(
    r"^(?:(?:slip|speed|initial speed|adhesion|rail|lead filter|lead|dead time)(?=[: ])"
    r"|(?:structure|controller|out|workers|scheduler|worst by|law|K|D|ki_min|inertia scale|port)(?=:))"
)


def _fail(message: str) -> NoReturn:
    line = options_named(" ".join(message.split()))
    line = _OPTION_NAMED.sub(lambda match: "--" + re.sub("[ _]", "-", match[0]), line)
    click.echo(f"{PROGRAM}: error: {line}", err=True)
    sys.exit(2)
