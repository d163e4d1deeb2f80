"""The page in a notebook, or beside a script."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import Any

from railslip_ctrl.core.arguments import checked, number
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.workbench import Workbench
from railslip_ctrl.model.vehicle import PARK2008, Vehicle

from .server import Desk, PageServer

_HEIGHT = 1100  # CSS pixels of the frame: the map and four plots without scrolling


class DesignPage(ExitStack):
    """A design page that is served until its `close()`; `address` is where it is. See `design_page`."""

    def __init__(self, bench: Workbench, port: int) -> None:
        super().__init__()
        server = self.enter_context(PageServer(self.enter_context(Desk(bench).opened()), port))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self.callback(server.shutdown)
        self.address = server.address

    def __repr__(self) -> str:
        return f"DesignPage({self.address})"

    def _repr_html_(self) -> str:
        """The page in a frame, as a notebook shows it."""
        style = f'width="100%" height="{_HEIGHT}" style="border:0"'
        return f'<iframe src="{self.address}" title="Design page" {style}></iframe>'


@checked
def design_page(envelope: Envelope | Vehicle = PARK2008, controller: Any = None, *, port: int = 0) -> DesignPage:
    """The page of `railslip design`: a notebook shows it in a frame, a browser at its `address`.

    - envelope: what a design must hold, or a vehicle, whose envelope is taken.
    - controller: where the page begins: a controller of a kind, or its class, a linear system, or a design; left out, a
      PI-lead by a rule.
    - port: of 127.0.0.1; 0: a free one.

    Returns the page, served until its `close()` or the end of Python. InputError: a controller without numbers by name,
    an envelope without points, or a port that cannot be had.
    """
    number("port", port, ge=0, le=65_535)
    return DesignPage(Workbench(Envelope(envelope) if isinstance(envelope, Vehicle) else envelope, controller), port)
