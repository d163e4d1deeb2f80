"""Figures drawn in this process and in another one beside it, or taken from those an earlier report has drawn."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from pydantic import BaseModel

from railslip_ctrl.kept import found, kept
from railslip_ctrl.machine import Submit, processes

from .style import figure_files

Files = dict[str, bytes]

_KEPT = "picture-"


class DrawingRoom:
    """Draws figures where there is time for it; made by `drawing_room`.

    What the other process has not begun when this one is free is drawn here. What the same drawing of the same data
    gave before is taken from the cache, unless all is to be drawn afresh.
    """

    def __init__(self, submit: Submit | None, *, fresh: bool) -> None:
        self._submit, self._fresh = submit, fresh
        self._given: dict[str, str] = {}  # what each figure is of, in the order in which they came
        self._sent: dict[str, Future[Files]] = {}
        self._here: dict[str, Files] = {}
        self._before: dict[str, Files] = {}

    def take(self, drawings: Mapping[str, Callable[[], Figure]]) -> list[Callable[[], None]]:
        """Send drawings, by name, to the other process; what remains to be done here, figure by figure, each at most.

        The other process begins with the first, this one with the last.
        """
        left = {}
        for name, make in drawings.items():
            self._given[name] = _contents(make)
            files = None if self._fresh else found(_KEPT + name, self._given[name])
            if files is None:
                left[name] = make
            else:
                self._before[name] = files
        if self._submit is not None:
            self._sent |= {name: self._submit(_drawn, make) for name, make in left.items()}
        return [partial(self._draw, name, make) for name, make in reversed(left.items())]

    @property
    def from_cache(self) -> tuple[str, ...]:
        """Names of the figures that were drawn before."""
        return tuple(self._before)

    def _draw(self, name: str, make: Callable[[], Figure]) -> None:
        if self._submit is None or self._sent[name].cancel():
            self._here[name] = _drawn(make)

    def files(self) -> dict[str, Files]:
        """The files by suffix of each figure by name, once all are drawn, here or there."""
        there = {name: sent.result() for name, sent in self._sent.items() if name not in self._here}
        for name, files in (self._here | there).items():
            kept(_KEPT + name, partial(_same, files), self._given[name], fresh=True)
        every = self._before | self._here | there
        return {name: every[name] for name in self._given}


@contextmanager
def drawing_room(*, helped: bool, fresh: bool = False) -> Iterator[DrawingRoom]:
    """A room with another process, started at once to be ready when the first figures are; without help none is.

    `fresh`: nothing is taken from the cache.
    """
    if not helped:
        yield DrawingRoom(None, fresh=fresh)
        return
    with processes(1) as submit:
        submit(_ready)
        yield DrawingRoom(submit, fresh=fresh)


def _contents(make: Callable[[], Figure]) -> str:
    """A hash of all that a figure shows, and of what it is drawn with; of the package's own source `kept` sees to."""
    content = BytesIO()
    _Contents(content).dump(make)
    digest = hashlib.sha256(content.getvalue())
    digest.update(f"{matplotlib.__version__} {matplotlib.rcParams}".encode())
    return digest.hexdigest()


class _Contents(pickle.Pickler):
    """Writes down what there is in a figure's data, the same for the same data, to be compared and never read."""

    def reducer_override(self, obj: Any) -> Any:
        """A record by its fields: with them pickle would write which were given, a set, in any order."""
        return (type(obj), tuple(vars(obj).items())) if isinstance(obj, BaseModel) else NotImplemented


def _same(files: Files) -> Files:
    return files


def _drawn(make: Callable[[], Figure]) -> Files:
    return figure_files(make())


def _ready() -> None:
    """Makes the other process start and import what it needs."""
