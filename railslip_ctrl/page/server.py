"""Serve the page on 127.0.0.1: check requests, limit their number, and drop outdated requests.

A request is answered only if its address has the secret token of the server, its Host header is this server, and its
Origin header, if there is one, is the page itself. Requests for the loop are answered in this process, so that they do
not wait for slow requests; slow requests are answered in other processes.
"""

from __future__ import annotations

import json
import os
import pickle
import secrets
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor
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
from railslip_ctrl.core.processes import Submit, processes
from railslip_ctrl.core.units import shown
from railslip_ctrl.design.workbench import Workbench
from railslip_ctrl.model.adhesion import AdhesionLaw

from .answers import ANSWERS, encoded_answer

LARGEST_REQUEST = 65_536  #: largest request, bytes; those of the page have up to about 2000
_CONNECTIONS = 64  # largest number of open connections; a browser opens 6 for each tab
_TIMEOUT = 30.0  # s; a connection is closed after this time without data
_WAITING = 24  # largest number of slow requests at once
_TABS = 64  # number of tabs whose newest request numbers are stored
_FAST = ("start", "loop")  # requests answered in this process
_MEDIUM = ("envelope", "stops")  # requests with a separate process; other requests take seconds, a report a minute
_FILES = {"": "html", "page.css": "css", "page.js": "javascript"}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors http://127.0.0.1:* http://localhost:*"  # for notebooks
)


class Dispatcher:
    """Answers the requests of all browser tabs for the workbench `bench`; each tab numbers its requests."""

    def __init__(self, bench: Workbench) -> None:
        own = [law for law in bench.envelope.laws if isinstance(law, AdhesionLaw)]
        own += [bench.given] if bench.given is not None and python_file(type(bench.given)) else []
        self.bench, self._sent = bench, b"" if own else pickle.dumps((bench.envelope, bench.given))
        self._newest, self._lock = dict[tuple[str, str], int](), threading.Lock()
        self._waiting = threading.BoundedSemaphore(_WAITING)
        self._pools: list[tuple[threading.Semaphore, Callable[..., bytes]]] = []
        self._closed, self.computing = False, set[int]()  # threads of this process that compute an answer

    @contextmanager
    def opened(self) -> Iterator[Dispatcher]:
        """Start processes that answer slow requests; with a law or controller of the user this process answers."""
        with processes(1) as medium, processes(2) as slow:
            self._pools = [(threading.Semaphore(n), partial(self._answer_by, by)) for n, by in ((1, medium), (2, slow))]
            if not self._sent:
                self._pools = [(threading.Semaphore(1), self._answer_here)] * 2
            try:
                yield self
            finally:
                self._closed = True

    def answer(self, name: str, client: str, turn: int, request: dict[str, Any]) -> bytes | None:
        """Return the answer to a request; None if the request is outdated.

        - name: kind of request, a key of `ANSWERS`.
        - client: name of the browser tab.
        - turn: number of the request; it is outdated if the tab has sent a request of this kind with a higher number.
        - request: content of the request.

        InputError: invalid design; `queue.Full`: too many slow requests wait; RuntimeError: `opened` has ended.
        """
        key = client, name
        self._newest[key] = max(turn, self._newest.pop(key, turn))
        while len(self._newest) > _TABS * len(ANSWERS):
            self._newest.pop(next(iter(self._newest)), None)
        if name in _FAST:
            with self._lock:
                return self._answer_here(name, request) if self._newest.get(key, turn) <= turn else None
        if not self._waiting.acquire(blocking=False):
            raise Full
        try:
            free, answer = self._pools[name not in _MEDIUM]
            with free:
                return answer(name, request) if self._newest.get(key, turn) <= turn else None
        except BrokenExecutor:  # the processes were ended, or they import a script that would serve the page again
            return self._answer_here(name, request)
        finally:
            self._waiting.release()

    def _answer_by(self, submit: Submit, name: str, request: dict[str, Any]) -> bytes:
        return bytes(submit(_answer_in_process, self._sent, name, request).result())

    def _answer_here(self, name: str, request: dict[str, Any]) -> bytes:
        self.computing.add(threading.get_ident())
        try:
            if self._closed:
                raise RuntimeError("the page is no longer served")
            return encoded_answer(self.bench, name, request)
        finally:
            self.computing.discard(threading.get_ident())


@lru_cache(2)
def _bench(sent: bytes) -> Workbench:
    with suppress(AttributeError, OSError):  # Windows has no nice()
        os.nice(5)  # lower priority than the process that answers while the user drags
    return Workbench(*pickle.loads(sent))


def _answer_in_process(sent: bytes, name: str, request: dict[str, Any]) -> bytes:
    return encoded_answer(_bench(sent), name, request)


class PageServer(ThreadingHTTPServer):
    """HTTP server of the page on 127.0.0.1, whose requests the `dispatcher` answers.

    `address` contains a secret token. On a `port` that the user chooses, the token remains the same after a restart, so
    that open pages reconnect. InputError if the port is not available.
    """

    daemon_threads, request_queue_size = True, 128

    def __init__(self, dispatcher: Dispatcher, port: int = 0) -> None:
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as error:
            raise InputError(f"port: {port} is not available ({error.strerror or error}); give another") from None
        token = secrets.token_hex(20)
        self.dispatcher, self.token = dispatcher, private_text("page", f"token-{port}", token) if port else token
        self.hosts = [f"{host}:{self.server_port}" for host in ("127.0.0.1", "localhost")]
        self.address = f"http://{self.hosts[0]}/{self.token}/"
        folder = files(__package__).joinpath("static")
        self.files = {name: folder.joinpath(name or "page.html").read_bytes() for name in _FILES}
        self._connections = threading.BoundedSemaphore(_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start a thread for a connection; if too many connections are open, close it, and the browser tries again."""
        if self._connections.acquire(timeout=0.5):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._connections.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print an error in one line; errors of a closed connection, or while the server ends, are not printed."""
        kind, error, _ = sys.exc_info()
        if kind is not None and not issubclass(kind, OSError | RuntimeError):
            print(f"railslip: design: {kind.__name__}: {error}", file=sys.stderr)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    protocol_version, server_version, sys_version = "HTTP/1.1", "railslip", ""
    disable_nagle_algorithm, wbufsize, timeout = True, -1, _TIMEOUT  # send each answer at once, in one piece

    def log_message(self, *_: Any) -> None:
        """Log nothing, because addresses contain the token."""

    def do_GET(self) -> None:
        name = self._name()
        if name == "" and not self.path.partition("?")[0].endswith("/"):  # the page loads files relative to its address
            self._send(HTTPStatus.PERMANENT_REDIRECT, b"")
        elif name in self.server.files:
            self._send(HTTPStatus.OK, self.server.files[name], f"text/{_FILES[name]}; charset=utf-8")
        elif name is not None:
            self._reject(HTTPStatus.NOT_FOUND, "unknown page")

    def do_POST(self) -> None:
        name, length = self._name(), self.headers.get("Content-Length", "")
        if name is None:
            return
        if self.headers.get_content_type() != "application/json" or name not in ANSWERS:
            self._reject(HTTPStatus.NOT_FOUND, f"request one of {', '.join(ANSWERS)}, as application/json")
        elif not (length.isascii() and length.isdigit() and len(length) < 9 and int(length) <= LARGEST_REQUEST):
            self._reject(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"give Content-Length, at most {LARGEST_REQUEST} bytes")
        else:
            self._answer(name, self.rfile.read(int(length)))

    def _name(self) -> str | None:
        """Return the part of the address after the token; None if the request was rejected."""
        token, _, name = self.path.partition("?")[0].removeprefix("/").partition("/")
        hosts = self.server.hosts
        if self.headers.get("Host", "") not in hosts:
            self._reject(HTTPStatus.FORBIDDEN, "the Host header is not this server")
        elif not secrets.compare_digest(token.encode("utf-8", "replace"), self.server.token.encode()):
            self._reject(HTTPStatus.FORBIDDEN, "the address has no valid token; open the printed address")
        elif self.headers.get("Origin", f"http://{hosts[0]}").removeprefix("http://") not in hosts:
            self._reject(HTTPStatus.FORBIDDEN, "only the page itself may send requests")
        else:
            return name
        return None

    def _answer(self, name: str, body: bytes) -> None:
        try:
            turn = (request := json.loads(body)).get("turn", 0)
        except (ValueError, RecursionError, AttributeError):
            return self._reject(HTTPStatus.BAD_REQUEST, "the request is no JSON object, or has too long a number")
        try:
            if isinstance(turn, bool) or not isinstance(turn, int) or not 0 <= turn < 2**53:
                raise InputError(f"turn: {shown(turn)} is not allowed; give a whole number from 0 to 2**53 - 1")
            answer = self.server.dispatcher.answer(name, str(request.get("client", ""))[:40], turn, request)
        except (RailslipError, ArithmeticError) as error:  # numbers that are allowed singly can overflow together
            self._reject(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
        except Full:
            self._reject(HTTPStatus.SERVICE_UNAVAILABLE, "the server is busy; repeat the request")
        else:
            self._send(HTTPStatus.NO_CONTENT if answer is None else HTTPStatus.OK, answer or b"")

    def _reject(self, status: HTTPStatus, message: str) -> None:
        self.close_connection = True  # the rest of the request is not read
        self._send(status, json.dumps({"error": message}).encode(), "application/json")

    def _send(self, status: HTTPStatus, content: bytes, kind: str = "application/octet-stream") -> None:
        self.send_response(status)
        headers = {"Content-Type": kind, "Content-Length": str(len(content)), "Cache-Control": "no-store"}
        headers |= {"Content-Security-Policy": _POLICY, "X-Content-Type-Options": "nosniff"}
        headers |= {"Referrer-Policy": "no-referrer"} | ({"Connection": "close"} if self.close_connection else {})
        headers |= {"Location": f"/{self.server.token}/"} if status == HTTPStatus.PERMANENT_REDIRECT else {}
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)
