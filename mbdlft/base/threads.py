"""How work is done: linear algebra in one thread, many small objects without searches for cycles."""

import gc
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from typing import Any

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
def _controller() -> ThreadpoolController:
    return ThreadpoolController()
