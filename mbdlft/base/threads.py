"""One thread for linear algebra: on matrices of some hundred rows several threads are slower."""

from contextlib import AbstractContextManager
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


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()
