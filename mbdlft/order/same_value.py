"""Whether two LFTs have the same values: what every result of the search is checked by."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from mbdlft.base.array import Array
from mbdlft.exact.scale import equilibrate, or_one
from mbdlft.lft.evaluate import evaluate_at, values_and_sizes
from mbdlft.lft.lft import LFT
from mbdlft.order.work import Work, singular_values, solutions

_POINTS = 64
SAME = 1e-11  # relative difference of values, far above rounding and far below a wrong step
FITTED = 1e-12  # of the finished values of LFTs that are fitted, so that they are not much worse
_CONDITION = 1e7  # of I - M11 Delta on the range
_NEGLIGIBLE = 1e-6  # of the largest entry: a smaller one is compared with that part of it
_CANCELED = 1e-2  # of the terms of an entry: a smaller one is compared with that part of them


class Truth:
    """Values at random points and corners of the unit box; not computed before there is a candidate.

    Parameters
    ----------
    form : function that makes the LFT
    floor : function of values (N, rows, columns)
        What an entry is compared with at least, (rows, columns) or one for all.
    """

    def __init__(self, form: Callable[[], LFT], floor: Callable[[Array], Array | float]) -> None:
        self._form, self._floor = form, floor

    @cached_property
    def values(self) -> tuple[dict[str, Array], Array, Array]:
        """Points (N,) by name, values (N, rows, columns) and sizes of entries (rows, columns).

        What is left of an entry after its terms have cancelled is no size to compare it with.
        """
        form = self._form()
        points = _check_points(len(form.blocks))
        values, terms = values_and_sizes(form, points)
        size = np.max(np.abs(values), axis=0, initial=0.0)
        least = np.maximum(self._floor(values), _CANCELED * np.max(terms, axis=0, initial=0.0))
        fields = {block.name: points[:, k] for k, block in enumerate(form.blocks)}
        return fields, values, np.maximum(size, least)


def is_same(candidate: LFT, truth: Truth, work: Work, largest: float = SAME) -> bool:
    """Whether the values are the same, and the loop is far from singular, at all points.

    Each entry is compared with its size; the difference is `largest` at most.
    """
    fields, values, size = truth.values
    n, count, inputs = candidate.order, len(values), candidate.shape[1]
    work.add(2 * solutions(count, n, inputs, is_complex=False))
    nothing = np.zeros(len(values))
    points = np.array([fields.get(name, nothing) for name, _ in candidate.blocks]).T
    points = points.reshape(len(values), len(candidate.blocks))
    loop = np.zeros((0, n, n))
    if n:
        spread = np.repeat(points, [block.size for block in candidate.blocks], axis=1)
        loop = np.eye(n) - candidate.M11[None] * spread[:, None, :]
        signs, _ = np.linalg.slogdet(loop)
        if np.any(signs <= 0):
            return False
    difference = np.abs(evaluate_at(candidate, points) - values)
    if not np.max(difference / or_one(size), initial=0.0) <= largest:
        return False
    work.add(singular_values(n, n, count) / 3.0)
    return bool(np.max(np.linalg.cond(loop), initial=0.0) <= _CONDITION)


def part_of_largest(values: Array) -> float:
    """A small part of the largest entry."""
    return _NEGLIGIBLE * float(np.max(np.abs(values), initial=0.0))


def part_of_row_and_column(values: Array) -> Array:
    """(rows, columns); an entry is no larger than what its row and its column give it."""
    rows, columns = equilibrate(values)
    used = np.max(np.abs(values), initial=0.0) > 0.0
    return np.asarray(_CANCELED * used / np.outer(rows, columns))


def part_of_either(values: Array) -> Array:
    """(rows, columns); the larger of the two: for rows that are zero but for rounding, too."""
    return np.maximum(part_of_largest(values), part_of_row_and_column(values))


def _check_points(count: int) -> Array:
    """Random points and corners of the unit box (N, count)."""
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (2 * _POINTS, count))
    points[_POINTS:] = np.sign(points[_POINTS:])
    return points
