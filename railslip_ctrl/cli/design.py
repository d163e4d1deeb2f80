"""The command `railslip design`."""

from __future__ import annotations

import os
import sys
import webbrowser

import click

from railslip_ctrl.design.workbench import Workbench
from railslip_ctrl.page.server import Dispatcher, PageServer
from railslip_ctrl.report.export import json_text

from .margins import given_controller
from .options import (
    DEFAULT_ENVELOPE,
    CaseOptions,
    case_options,
    chosen_gains,
    controller_option,
    gain_options,
    whole_number,
)
from .output import progress
from .settings import HELP, option, preset, switch

_LARGEST_PORT = 65_535


@click.command(context_settings=HELP)
@case_options(over=True)
@option(
    "--envelope",
    "default|FILE",
    "Envelope for the design, as in `margins`; --rail, --adhesion, --speed, --slip and --loaded change it.",
    "the vehicle's own or the default",
)
@gain_options("chosen by the page")
@controller_option("a PI-lead with gains chosen by the page; with --kp and --ki a PI")
@preset(
    "--port",
    "N",
    "Port number on 127.0.0.1; 0: any free port. With a fixed port, open pages reconnect after a restart.",
    "0",
)
@switch("--no-browser", "Only print the address; do not open a browser.")
def command(
    cases: CaseOptions,
    as_json: bool,
    envelope: str | None,
    controller: str | None,
    kp: float | None,
    ki: float | None,
    port: str,
    no_browser: bool,
) -> None:
    """Shape the loop by hand in the browser.

    While you drag the gains on a map, the page shows which gains stabilise the whole envelope, the loop with its exact
    margins, and braking runs. The page saves the controller as a file for the other commands. Only this machine
    can reach the page. Interrupt the command to end it. Exit status 0, or 2 for bad input.

    Example: railslip design --vehicle my_train.toml --no-browser --port 8050
    """
    judged = cases.envelope(envelope or DEFAULT_ENVELOPE)
    gains = chosen_gains(kp, ki)
    given = None
    if controller is not None or gains is not None:
        point = judged.points(nominal=True).plants[0].point
        given = given_controller(controller or "pi", point, gains, judged.reference)
    dispatcher = Dispatcher(Workbench(judged, given))
    server = PageServer(dispatcher, whole_number("--port", port, 0, _LARGEST_PORT))
    try:
        with server, dispatcher.opened():
            click.echo(json_text({"address": server.address}) if as_json else server.address)
            if not no_browser:
                webbrowser.open(server.address)
            server.serve_forever()
    except KeyboardInterrupt:  # the usual way to end the command
        progress("the page is no longer served")
        if dispatcher.computing:  # do not wait; Python may abort if it ends while a thread is in native code
            sys.stdout.flush()
            os._exit(0)
