"""While work runs: one thread, no searches for cycles of objects, and how much of a budget is done.

A budget is an upper limit: work may end before it. Nothing depends on whether somebody listens.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
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
    limit: AbstractContextManager[Any] = _controller().limit(limits=1)
    return limit


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
    """Who listens, what was done before this part of the work, and the most there may be."""

    listener: Listener
    before: float
    most: float


_HEARD: ContextVar[_Heard | None] = ContextVar("_HEARD", default=None)


@contextmanager
def heard(listener: Listener) -> Iterator[None]:
    """Whatever works inside tells this function."""
    token = _HEARD.set(_Heard(listener, 0.0, 0.0))
    try:
        yield
    finally:
        _HEARD.reset(token)


@contextmanager
def budget(most: float) -> Iterator[None]:
    """A work of at most so many units begins; that of which it is a part has told its own."""
    around = _HEARD.get()
    if around is None or around.most > 0.0:
        yield
        return
    token = _HEARD.set(around._replace(most=most))
    try:
        tell(0.0)
        yield
    finally:
        _HEARD.reset(token)


@contextmanager
def after(done: float) -> Iterator[None]:
    """What is told inside comes after so many units of the work around."""
    around = _HEARD.get()
    if around is None:
        yield
        return
    token = _HEARD.set(around._replace(before=around.before + done))
    try:
        yield
    finally:
        _HEARD.reset(token)


def tell(done: float) -> None:
    """So many units of this part of the work are done."""
    listening = _HEARD.get()
    if listening is not None and listening.most > 0.0:
        listening.listener(min(listening.before + done, listening.most), listening.most)


def pass_on(done: float, most: float) -> None:
    """Another process has done so many units of at most so many."""
    listening = _HEARD.get()
    if listening is not None and listening.most > 0.0:
        tell(done)
    elif listening is not None:
        listening.listener(min(done, most), most)
