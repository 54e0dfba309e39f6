"""While work runs: one thread, no searches for cycles of objects, and how much of a budget is done.

A budget is an upper limit: work may end before it. Nothing depends on whether somebody listens.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[Any]:
    """In this context linear algebra runs in one thread: `with one_thread(): ...`.

    Results then do not depend on the number of cores. On a busy machine, threads that wait for each other
    would take more time than the rest of the work.
    """
    _keep_memory()
    limit: AbstractContextManager[Any] = _controller().limit(limits=1)
    return limit


_KEPT = 31 << 20  # bytes: glibc learns from arrays up to 32 MB


@cache
def _keep_memory() -> None:
    """Have freed memory of arrays kept for the next ones: glibc does from the size of one freed array on.

    Without that it gives memory of some hundred kilobytes back and gets it again, page by page, which
    takes longer than a Newton step with matrices of that size. No page of this array is touched.
    """
    import numpy as np  # `--version` does without it

    np.empty(_KEPT, dtype=np.uint8)


@contextmanager
def without_collection() -> Iterator[None]:
    """In this context Python does not look for cycles of objects that nothing else refers to.

    Millions of numbers that live for a while, in which there are no cycles, make it look again and again.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@cache
def _controller() -> "ThreadpoolController":
    from threadpoolctl import ThreadpoolController  # reading an archive does without it

    return ThreadpoolController()


Listener = Callable[[float, float], None]  # units that are done, and the most there may be


class _Heard(NamedTuple):
    """Who listens to a budget."""

    listener: Listener
    before: float  # units that were done before
    most: float  # units there may be; 0 before a budget begins


_HEARD: ContextVar[_Heard | None] = ContextVar("_HEARD", default=None)


@contextmanager
def _hearing(heard: _Heard) -> Iterator[None]:
    token = _HEARD.set(heard)
    try:
        yield
    finally:
        _HEARD.reset(token)


def heard(listener: Listener) -> AbstractContextManager[None]:
    """In this context `listener` is told what is done of a budget."""
    return _hearing(_Heard(listener, 0.0, 0.0))


@contextmanager
def budget(most: float) -> Iterator[None]:
    """In this context at most `most` units of work are done; inside another budget, that one counts."""
    around = _HEARD.get()
    if around is None or around.most > 0.0:
        yield
        return
    with _hearing(around._replace(most=most)):
        tell(0.0)
        yield


def after(done: float) -> AbstractContextManager[None]:
    """In this context `tell` counts from `done` units of the work around it."""
    around = _HEARD.get()
    return nullcontext() if around is None else _hearing(around._replace(before=around.before + done))


def tell(done: float) -> None:
    """Tell the listener that `done` units are done, beside those before `after`."""
    around = _HEARD.get()
    if around is not None and around.most > 0.0:
        around.listener(min(around.before + done, around.most), around.most)


def pass_on(done: float, most: float) -> None:
    """Tell the listener what another process has done of its own budget `most`."""
    around = _HEARD.get()
    if around is not None and around.most > 0.0:
        tell(done)
    elif around is not None:
        around.listener(min(done, most), most)
