"""What a search may cost and has done, in operations: the same on every machine and under every load.

Linear algebra counts itself where it is done, by the sizes of its matrices. Weights of the three kinds
and of the loops around them make the sums follow the time of one current core to about a factor of two.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from mbdlft.exact.modular import done

SEARCH = 2.0  # units of a search; a small part is enough where the order meets the bound at once
UNIT = 1.5e10  # operations in one unit of work, about a second of one core
_CALL = 3e6  # what a call costs beside its operations
_EACH = 6e3  # of each row of a small matrix, beside its operations
_SINGULAR_VALUES = 12.0  # per entry and row: they take several sweeps


class Budget(NamedTuple):
    """What a search may cost: units of work, which decide its result, and at most so many seconds."""

    work: float
    seconds: float | None = None


class Work:
    """A count of operations with an end, after units or when `is_late`; `tell` gets what is spent."""

    def __init__(
        self,
        most: float = math.inf,
        is_late: Callable[[], bool] = lambda: False,
        tell: Callable[[float], None] = lambda spent: None,
    ) -> None:
        self.most, self.spent, self.is_cut_off = most, 0.0, False
        self._is_late, self._tell = is_late, tell
        self._whole: Work | None = None
        self._whole_to_ask: Work | None = None  # whether it is over

    def part(self, share: float) -> "Work":
        """A share of what is left; what it spends is spent here too."""
        return self.limited(share * self.left)

    def limited(self, units: float) -> "Work":
        """So many units, or fewer where the whole ends; nothing but that depends on the whole."""
        share_of_work = Work(units)
        share_of_work._whole = share_of_work._whole_to_ask = self
        return share_of_work

    @property
    def left(self) -> float:
        """Units that are left here."""
        return max(0.0, self.most - self.spent)

    @property
    def is_over(self) -> bool:
        """Whether nothing is left, or it is late."""
        if self.left <= 0.0:
            return True
        if self._whole_to_ask is not None:
            return self._whole_to_ask.is_over
        self.is_cut_off = self.is_cut_off or self._is_late()
        return self.is_cut_off

    def has_room(self, operations: float) -> bool:
        """Whether a step of so many operations ends here; where it does not, this is over."""
        left = min(self.left, self._whole_to_ask.left if self._whole_to_ask else math.inf)
        if operations > UNIT * left:
            self.most = self.spent
        return self.left > 0.0

    def of_try(self, least: float) -> "Work":
        """For what goes on beyond this part to its own end: so many units, or all of a larger part."""
        attempt = Work(max(least, self.most))
        attempt._whole = attempt._whole_to_ask = self
        while attempt._whole_to_ask._whole is not None:
            attempt._whole_to_ask = attempt._whole_to_ask._whole
        return attempt

    def add(self, operations: float) -> None:
        """Count operations, and the call."""
        self._add_units((operations + _CALL) / UNIT)

    @contextmanager
    def counting(self, times: float = 1.0) -> Iterator[None]:
        """Count operations modulo primes of what is done inside, each so many times."""
        before = done.operations
        try:
            yield
        finally:
            self.add(times * (done.operations - before))

    def _add_units(self, units: float) -> None:
        self.spent += units
        self._tell(self.spent)
        if self._whole is not None:
            self._whole._add_units(units)


def late_after(seconds: float | None) -> Callable[[], bool]:
    """Whether so many seconds have passed since this call."""
    if seconds is None:
        return lambda: False
    until = time.monotonic() + seconds
    return lambda: time.monotonic() > until


def exact_solutions(count: int, n: int) -> float:
    """Operations of `count` systems of n equations modulo a prime; most of the time goes to entries."""
    return count * (1e6 + 4e3 * n * n + 75.0 * n**3)


def exact_resolvents(count: int, n: int) -> float:
    """Operations of `count` systems of n equations modulo a prime that differ in their diagonals."""
    return count * (1.5e5 + 2e4 * n + 500.0 * n * n)


def exact_elimination(rows: int, columns: int) -> float:
    """Operations of an echelon form modulo a prime."""
    return (1e4 + 40.0 * min(rows, columns)) * rows * columns


def singular_values(rows: int, columns: int, count: int = 1) -> float:
    """Operations of the singular values and vectors of matrices."""
    least = min(rows, columns)
    return count * least * (_SINGULAR_VALUES * rows * columns + 10.0 * _EACH)


def product(rows: int, inner: int, columns: int) -> float:
    """Operations of a product, or of an orthogonal or triangular factor: these are the fastest."""
    return 0.5 * rows * inner * columns
