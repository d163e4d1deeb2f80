"""Pool of processes, number of available cores, and delayed interruptions."""

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

_IMPORTING = 87  # exit status, used for nothing else, of a process whose script starts processes while it is imported

Submit: TypeAlias = "Callable[..., Future[Any]]"  #: function that submits a function with its arguments to the pool


def cpu_count() -> int:
    """Number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@contextmanager
def processes(count: int) -> Iterator[Submit]:
    """Make a pool of at most `count` processes; yield the function that submits work to the pool.

    All processes end when the calling process ends, or when an exception leaves the `with` block. InputError if a
    script calls this function without `if __name__ == "__main__":`, because each new process imports the script again.
    """
    from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
    from multiprocessing import current_process, get_context

    if getattr(current_process(), "_inheriting", False):  # this process is still importing the script
        sys.exit(_IMPORTING)
    # spawn, not fork: a forked process with threads may hang
    context: Any = _Context(get_context("spawn"))
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_follow)

    def submit(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        with undisturbed():
            return pool.submit(function, *arguments)

    try:
        yield submit
    except BaseException as error:
        if isinstance(error, BrokenExecutor):  # the shutdown collects the exit status of every process
            pool.shutdown()
        started = [process for process in context.made if process.pid is not None]
        if any(process.exitcode == _IMPORTING for process in started):
            raise InputError(
                "worker processes import the script, so the script must not start processes during the import; put the "
                'call of the package under if __name__ == "__main__":'
            ) from None
        for process in started:
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


class _Context:
    def __init__(self, context: BaseContext) -> None:
        self.context: Any = context
        self.made: list[BaseProcess] = []  # also processes that have ended, which Python does not list

    def __getattr__(self, name: str) -> Any:
        return getattr(self.context, name)

    def Process(self, *given: Any, **named: Any) -> BaseProcess:  # the pool calls this name
        self.made.append(self.context.Process(*given, **named))
        return self.made[-1]


def _follow() -> None:
    """End this process when its parent ends, even if the parent is killed."""
    from multiprocessing import parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # for systems, such as Windows, on which SIGINT is not blocked
    parent = parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def undisturbed() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM to the end of the `with` block; processes started in the block get no Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread receives signals
        yield
        return
    received: list[int] = []
    both = signal.SIGINT, signal.SIGTERM
    before = {number: signal.signal(number, lambda number, frame: received.append(number)) for number in both}
    mask: Callable[..., object] = getattr(signal, "pthread_sigmask", lambda *_: None)
    try:
        mask(getattr(signal, "SIG_BLOCK", 0), {signal.SIGINT})
        yield
    finally:
        mask(getattr(signal, "SIG_UNBLOCK", 0), {signal.SIGINT})
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)
        if received:
            signal.raise_signal(received[0])
