"""One thread for linear algebra on matrices of some hundred rows, which threads make slower."""

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[Any]:
    """In this context linear algebra runs in one thread: `with one_thread(): ...`.

    Results then do not depend on the number of cores, and on a busy machine threads that wait for each
    other would cost more than all the rest.
    """
    limit: AbstractContextManager[Any] = _controller().limit(limits=1)
    return limit


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()
