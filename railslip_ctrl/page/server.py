"""The page served on 127.0.0.1: who may ask, how much at once, and that the newest question wins.

A request is answered if its address has the token, it names this server as its host, and comes from its own page or
from no page. The loop is answered in this process, all else in others, so that it never waits.
"""

from __future__ import annotations

import json
import os
import pickle
import secrets
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from queue import Full
from typing import Any

from railslip_ctrl.controllers.base import python_file
from railslip_ctrl.core.errors import InputError, RailslipError
from railslip_ctrl.core.folders import private_text
from railslip_ctrl.core.processes import processes
from railslip_ctrl.core.units import shown
from railslip_ctrl.design.workbench import Workbench
from railslip_ctrl.model.adhesion import AdhesionLaw

from .answers import ANSWERS, answered

LARGEST_REQUEST = 65_536  #: bytes of a question; the largest of the page has some 2 000
_CONNECTIONS, _PATIENCE = 64, 30.0  # at once, of which a browser has 6 a tab; s, for which one may be silent
_WAITING, _TABS = 24, 64  # slow questions at once; tabs whose newest questions are remembered
_HERE, _SOON = ("start", "loop"), ("envelope", "stops")  # the rest takes seconds, a report a minute: in two processes
_FILES = {"": "html", "page.css": "css", "page.js": "javascript"}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors http://127.0.0.1:* http://localhost:*"  # of notebooks
)


class Desk:
    """Answers the questions of all tabs; each tab numbers its own."""

    def __init__(self, bench: Workbench) -> None:
        own = [law for law in bench.envelope.laws if isinstance(law, AdhesionLaw)]
        own += [bench.given] if bench.given is not None and python_file(type(bench.given)) else []
        self.bench, self._sent = bench, b"" if own else pickle.dumps((bench.envelope, bench.given))
        self._newest, self._lock = dict[tuple[str, str], int](), threading.Lock()
        self._waiting = threading.BoundedSemaphore(_WAITING)
        self._pools: list[tuple[threading.Semaphore, Callable[..., Any]]] = []

    @contextmanager
    def opened(self) -> Iterator[Desk]:
        """With its processes; in threads of this one if the class of an adhesion law or a kind is the user's own, which
        no other process knows."""
        with processes(1) as soon, processes(2) as later, ThreadPoolExecutor(1) as here:
            ask = partial(_elsewhere, self._sent) if self._sent else partial(answered, self.bench)
            pools = ((1, soon), (2, later)) if self._sent else ((1, here.submit), (1, here.submit))
            self._pools = [(threading.Semaphore(count), partial(submit, ask)) for count, submit in pools]
            yield self

    def answer(self, what: str, client: str, turn: int, asked: dict[str, Any]) -> bytes | None:
        """The answer; None where the same tab has asked again since. InputError as of `answered`; Full where too many
        wait."""
        key = client, what
        self._newest[key] = max(turn, self._newest.pop(key, turn))
        while len(self._newest) > _TABS * len(ANSWERS):
            self._newest.pop(next(iter(self._newest)), None)
        if what in _HERE:
            with self._lock:
                return answered(self.bench, what, asked) if self._newest.get(key, turn) <= turn else None
        if not self._waiting.acquire(blocking=False):
            raise Full
        try:
            mine, submit = self._pools[what not in _SOON]
            with mine:
                return submit(what, asked).result() if self._newest.get(key, turn) <= turn else None
        except BrokenExecutor:  # its processes were ended, or import a script that serves the page again: here then
            return answered(self.bench, what, asked)
        finally:
            self._waiting.release()


@lru_cache(2)
def _bench(sent: bytes) -> Workbench:
    with suppress(AttributeError, OSError):  # not on Windows
        os.nice(5)  # what is dragged comes first
    return Workbench(*pickle.loads(sent))


def _elsewhere(sent: bytes, what: str, asked: dict[str, Any]) -> bytes:
    return answered(_bench(sent), what, asked)


class PageServer(ThreadingHTTPServer):
    """The server of a desk at an `address` with a token; on a port of the user's choice with the one of last time, so
    that open pages go on after a restart. InputError for a port that cannot be had."""

    daemon_threads, request_queue_size = True, 128

    def __init__(self, desk: Desk, port: int = 0) -> None:
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as error:
            raise InputError(f"port: {port} cannot be had ({error.strerror or error}); give another") from None
        token = secrets.token_hex(20)
        self.desk, self.token = desk, private_text("page", f"token-{port}", token) if port else token
        self.hosts = [f"{host}:{self.server_port}" for host in ("127.0.0.1", "localhost")]
        self.address = f"http://{self.hosts[0]}/{self.token}/"
        folder = files(__package__).joinpath("static")
        self.files = {name: folder.joinpath(name or "page.html").read_bytes() for name in _FILES}
        self._room = threading.BoundedSemaphore(_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """A thread for each connection, for some of which there is room; others are closed, to come again."""
        if self._room.acquire(timeout=0.5):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A line of what went wrong, unless the browser has gone or the server ends."""
        kind, error, _ = sys.exc_info()
        if kind is not None and not issubclass(kind, OSError | RuntimeError):
            print(f"railslip: design: {kind.__name__}: {error}", file=sys.stderr)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    protocol_version, server_version, sys_version = "HTTP/1.1", "railslip", ""
    disable_nagle_algorithm, wbufsize, timeout = True, -1, _PATIENCE  # an answer is one packet, as soon as it is there

    def log_message(self, *_: Any) -> None:
        """Nothing: addresses have the token."""

    def do_GET(self) -> None:
        name = self._asked_for()
        if name in self.server.files:
            self._send(HTTPStatus.OK, self.server.files[name], f"text/{_FILES[name]}; charset=utf-8")
        elif name is not None:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")

    def do_POST(self) -> None:
        name, length = self._asked_for(), self.headers.get("Content-Length", "")
        if name is None:
            return
        if self.headers.get_content_type() != "application/json" or name not in ANSWERS:
            self._refuse(HTTPStatus.NOT_FOUND, f"ask {', '.join(ANSWERS)}, in application/json")
        elif not (length.isascii() and length.isdigit() and len(length) < 9 and int(length) <= LARGEST_REQUEST):
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"send Content-Length, at most {LARGEST_REQUEST} bytes")
        else:
            self._answer(name, self.rfile.read(int(length)))

    def _asked_for(self) -> str | None:
        """What comes after the token; None if it has been refused."""
        token, _, name = self.path.partition("?")[0].removeprefix("/").partition("/")
        hosts = self.server.hosts
        if self.headers.get("Host", "") not in hosts:
            self._refuse(HTTPStatus.FORBIDDEN, "this host is not served")
        elif not secrets.compare_digest(token.encode("utf-8", "replace"), self.server.token.encode()):
            self._refuse(HTTPStatus.FORBIDDEN, "the address has no token, or an old one; open the one that was printed")
        elif self.headers.get("Origin", f"http://{hosts[0]}").removeprefix("http://") not in hosts:
            self._refuse(HTTPStatus.FORBIDDEN, "only the page itself may ask")
        else:
            return name
        return None

    def _answer(self, what: str, body: bytes) -> None:
        try:
            asked = json.loads(body)
            turn = asked.get("turn", 0) if isinstance(asked, dict) else None
            if isinstance(turn, bool) or not isinstance(turn, int) or not 0 <= turn < 2**53:
                raise InputError(f"{shown(asked)} is no question; give an object with a turn, a count")
            found = self.server.desk.answer(what, str(asked.get("client", ""))[:40], turn, asked)
        except (RailslipError, ArithmeticError) as error:  # numbers each allowed but absurd together
            self._refuse(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
        except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
            self._refuse(HTTPStatus.BAD_REQUEST, "this is no JSON")
        except Full:
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "busy; ask again")
        else:
            self._send(HTTPStatus.NO_CONTENT if found is None else HTTPStatus.OK, found or b"")

    def _refuse(self, status: HTTPStatus, told: str) -> None:
        self.close_connection = True  # what else was sent is not read
        self._send(status, json.dumps({"error": told}).encode(), "application/json")

    def _send(self, status: HTTPStatus, content: bytes, kind: str = "application/octet-stream") -> None:
        self.send_response(status)
        headers = {"Content-Type": kind, "Content-Length": str(len(content)), "Cache-Control": "no-store"}
        headers |= {"Content-Security-Policy": _POLICY, "X-Content-Type-Options": "nosniff"}
        headers |= {"Referrer-Policy": "no-referrer"} | ({"Connection": "close"} if self.close_connection else {})
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)
