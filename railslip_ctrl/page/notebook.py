"""Show the design page in a notebook, or serve it beside a script."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import Any

from railslip_ctrl.core.arguments import checked, number
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.workbench import Workbench
from railslip_ctrl.model.vehicle import PARK2008, Vehicle

from .server import Dispatcher, PageServer

_HEIGHT = 1100  # height of the frame, CSS pixels; shows the map and four plots without scrolling


class DesignPage(ExitStack):
    """Design page that is served at `address` until `close()` is called; `design_page` returns it."""

    def __init__(self, bench: Workbench, port: int) -> None:
        super().__init__()
        server = self.enter_context(PageServer(self.enter_context(Dispatcher(bench).opened()), port))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self.callback(server.shutdown)
        self.address = server.address

    def __repr__(self) -> str:
        return f"DesignPage({self.address})"

    def _repr_html_(self) -> str:
        """Return the frame in which a notebook shows the page."""
        style = f'width="100%" height="{_HEIGHT}" style="border:0"'
        return f'<iframe src="{self.address}" title="Design page" {style}></iframe>'


@checked
def design_page(envelope: Envelope | Vehicle = PARK2008, controller: Any = None, *, port: int = 0) -> DesignPage:
    """Serve the page of `railslip design`.

    A notebook shows the returned page in a frame; a browser shows it at its `address`. The page is served until its
    `close()` is called, or Python ends.

    - envelope: operating points and tolerances of the design; or a vehicle, which means the envelope of this vehicle.
    - controller: design at the start: controller, controller class, linear system or result of `tune`; default PI-lead.
    - port: port number on 127.0.0.1; with 0 any free port is used.

    InputError if the controller has no named parameters, the envelope has no operating points, or the port is in use.
    """
    number("port", port, ge=0, le=65_535)
    return DesignPage(Workbench(Envelope(envelope) if isinstance(envelope, Vehicle) else envelope, controller), port)
