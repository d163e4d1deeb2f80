"""Figures drawn in this process and in another one beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context

from matplotlib.figure import Figure

from .style import figure_files

Files = dict[str, bytes]


class DrawingRoom:
    """Draws figures where there is time for it; made by `drawing_room`.

    What the other process has not begun when this one is free is drawn here.
    """

    def __init__(self, pool: ProcessPoolExecutor | None) -> None:
        self._pool = pool
        self._sent: dict[str, Future[Files]] = {}
        self._here: dict[str, Files] = {}

    def take(self, drawings: Mapping[str, Callable[[], Figure]]) -> list[Callable[[], None]]:
        """Send drawings, by name, to the other process; what remains to be done here, figure by figure, each at most.

        The other process begins with the first, this one with the last.
        """
        if self._pool is not None:
            self._sent |= {name: self._pool.submit(_drawn, make) for name, make in drawings.items()}
        return [partial(self._draw, name, make) for name, make in reversed(list(drawings.items()))]

    def _draw(self, name: str, make: Callable[[], Figure]) -> None:
        if self._pool is None or self._sent[name].cancel():
            self._here[name] = _drawn(make)

    def files(self) -> dict[str, Files]:
        """The files by suffix of each figure by name, once all are drawn, here or there."""
        there = {name: sent.result() for name, sent in self._sent.items() if name not in self._here}
        return self._here | there


@contextmanager
def drawing_room(*, helped: bool) -> Iterator[DrawingRoom]:
    """A room with another process, started at once to be ready when the first figures are; without help none is."""
    if not helped:
        yield DrawingRoom(None)
        return
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_ready)
    try:
        pool.submit(_ready)
        yield DrawingRoom(pool)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _drawn(make: Callable[[], Figure]) -> Files:
    return figure_files(make())


def _ready() -> None:
    """An interruption is left to the process that started this one."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
