"""Processes, how many the machine has room for, and interruptions."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

from .errors import InputError

if TYPE_CHECKING:
    from concurrent.futures import Future
    from multiprocessing.context import BaseContext
    from multiprocessing.process import BaseProcess

_IMPORTING = 87  # exit status of a process that could not import the script, as that starts processes itself

Submit: TypeAlias = "Callable[..., Future[Any]]"  #: takes a function and its arguments


def cpu_count() -> int:
    """Cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@contextmanager
def processes(count: int) -> Iterator[Submit]:
    """Pool of at most `count` processes, each started when there is work for it; yields what submits work.

    Only this process is interrupted; the others end with it, or when an exception leaves the context. InputError where
    a script calls this as it is imported: each process imports it again.
    """
    from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
    from multiprocessing import current_process, get_context

    if getattr(current_process(), "_inheriting", False):  # one that is yet to import the script may start none
        sys.exit(_IMPORTING)
    # new ones, not copies: a copy of a process with threads may hang
    context: Any = _Context(get_context("spawn"))
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_follow)

    def submit(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        with undisturbed():
            return pool.submit(function, *arguments)

    try:
        yield submit
    except BaseException as error:
        if isinstance(error, BrokenExecutor):  # ends the others; who waits beside it may miss the status of one
            pool.shutdown()
        started = [process for process in context.made if process.pid is not None]
        if any(process.exitcode == _IMPORTING for process in started):
            raise InputError(
                "the script starts processes, which run it again as they import it; put the call under if __name__ == "
                '"__main__":'
            ) from None
        for process in started:
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


class _Context:
    """A context of processes that remembers those made of it: one that has ended is no active child any more."""

    def __init__(self, context: BaseContext) -> None:
        self.context: Any = context
        self.made: list[BaseProcess] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self.context, name)

    def Process(self, *given: Any, **named: Any) -> BaseProcess:  # as the pool calls it
        self.made.append(self.context.Process(*given, **named))
        return self.made[-1]


def _follow() -> None:
    """End with the parent process, also if that is killed."""
    from multiprocessing import parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it is not blocked by now, as on Windows
    parent = parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def undisturbed() -> Iterator[None]:
    """Delay an interruption (Ctrl-C, SIGTERM) until this is done; processes that are started in it never get Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():  # which alone hears it
        yield
        return
    heard: list[int] = []
    both = signal.SIGINT, signal.SIGTERM
    before = {number: signal.signal(number, lambda number, frame: heard.append(number)) for number in both}
    mask: Callable[..., object] = getattr(signal, "pthread_sigmask", lambda *_: None)
    try:
        mask(getattr(signal, "SIG_BLOCK", 0), {signal.SIGINT})
        yield
    finally:
        mask(getattr(signal, "SIG_UNBLOCK", 0), {signal.SIGINT})
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)
        if heard:
            signal.raise_signal(heard[0])
