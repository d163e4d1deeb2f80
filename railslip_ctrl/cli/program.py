"""The `railslip` command: one module a subcommand, loaded when it is called."""

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
    "report": "the main job: the controller to use for a vehicle, from which speed, and why",
    "design": "the loop shaped by hand in the browser: map of gains, exact margins, braking runs",
    "linearize": "operating point, A B C D, poles, zeros, transfer function",
    "margins": "every margin of a loop, certified if asked; the verdict over an envelope",
    "tune": "gains from a specification, over an envelope or at operating points",
    "derive": "the sliding-mode law derived step by step; the paper's errata; C99 and Python code",
    "identify": "an adhesion law and the slip to hold, from a brake-rig log",
    "campaign": "many runs with sampled or swept quantities, on every core or a Dask cluster",
    "verify": "the stability conditions of a sliding-mode law, decided",
    "simulate": "a braking run: numbers, time series, pictures",
    "reproduce": "the paper's tables and figures beside ours, and the units that reproduce them",
}


class _LazyGroup(click.Group):
    """Lists the commands without importing them; each costs only its own imports."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        command: click.Command = import_module(f".{cmd_name}", __package__).command
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command. Click would print an empty line when interrupted, and exit with 1 on a broken pipe."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise click.Abort from None
        except BrokenPipeError:
            _end_without_reader()

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command, after a look at its options for one that is given twice; InputError for one there is not."""
        if args[0] not in _COMMANDS and not ctx.resilient_parsing:
            from railslip_ctrl.core.units import shown
            from railslip_ctrl.core.user_files import close_match

            near = close_match(args[0].lower(), _COMMANDS).rstrip()
            raise InputError(f"{shown(args[0])} is no command; {near or 'choose one of ' + ', '.join(_COMMANDS)}")
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None and not ctx.resilient_parsing:
            _check_repeated(ctx, command, rest)
        return name, command, rest

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Command names without their modules, so that a shell does not wait for them; then the options."""
        commands = [CompletionItem(name, help=text) for name, text in _COMMANDS.items() if name.startswith(incomplete)]
        return [*commands, *click.Command.shell_complete(self, ctx, incomplete)]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


def _check_repeated(ctx: click.Context, command: click.Command, arguments: Sequence[str]) -> None:
    """InputError for an option that takes one value and is given two, of which click would take the last."""
    parser = command.make_parser(click.Context(command, parent=ctx))  # which has the names of the help from its parent
    given = parser.parse_args(list(arguments))[2]
    for option in dict.fromkeys(given):
        if not isinstance(option, click.Option) or option.multiple:
            continue
        is_switch = option.is_flag and not option.secondary_opts  # the same, however often it is given
        if given.count(option) > 1 and not is_switch:
            raise InputError(f"{option.opts[0]}: is given {given.count(option)} times; give it once")


@click.group(cls=_LazyGroup, context_settings=HELP)
@click.version_option(__version__, prog_name=PROGRAM)
def railslip() -> None:
    """Wheel-slip control design for trains. Plain numbers are SI unless the option names a unit; a value may carry
    its own unit ("3.5 t", "65 N*m/(km/h)"). Exit status: 0 done, 1 the check does not hold, 2 bad input.

    Example: railslip margins --rail dry --kp "65 N*m/(km/h)" --ki "1.4 N*m/(km/h)/s"
    """


def run(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit; every error is one line on standard error. KeyboardInterrupt is the caller's."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure: Any = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")  # a terminal without Unicode shows "?", it does not fail
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
        # numbers each allowed but absurd together (a wheel of 1e12 kg m^2 under 1 kg) may leave the range of doubles
        _fail(f"these numbers together are beyond the range of the computation ({error}); check their sizes")
    except click.Abort:
        raise KeyboardInterrupt from None
    except BrokenPipeError:
        _end_without_reader()
    except OSError as error:
        sys.stdout = None
        _fail(f"the output cannot be written ({error.strerror or error}); make room or choose another place")
    sys.exit(status if isinstance(status, int) else 0)


def _end_without_reader() -> NoReturn:
    """Exit as a shell reports a program that SIGPIPE has ended: the reader of the output (head, less) has gone."""
    sys.stdout = None  # else Python would try to write the rest
    sys.exit(141)


# What the package calls a quantity that an option gives, where a message begins with it.
_OPTION_NAMED = re.compile(
    r"^(?:(?:slip|speed|initial speed|adhesion|rail|lead filter|lead|dead time)(?=[: ])"
    r"|(?:structure|controller|out|workers|scheduler|worst by|law|K|D|ki_min|inertia scale|port)(?=:))"
)


def _fail(message: str) -> NoReturn:
    line = options_named(" ".join(message.split()))
    line = _OPTION_NAMED.sub(lambda match: "--" + re.sub("[ _]", "-", match[0]), line)
    click.echo(f"{PROGRAM}: error: {line}", err=True)
    sys.exit(2)
