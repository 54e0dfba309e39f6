"""Whether two LFTs have the same values: what every result of the search is checked by."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from mbdlft.base.array import Array
from mbdlft.lft.evaluate import evaluate_at, values_and_sizes
from mbdlft.lft.lft import LFT
from mbdlft.reduce.lines import equilibrate

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


def is_same(candidate: LFT, truth: Truth, largest: float = SAME) -> bool:
    """Whether the values are the same, and the loop is far from singular, at all points.

    Each entry is compared with its size; the difference is `largest` at most.
    """
    fields, values, size = truth.values
    nothing = np.zeros(len(values))
    points = np.array([fields.get(name, nothing) for name, _ in candidate.blocks]).T
    points = points.reshape(len(values), len(candidate.blocks))
    if candidate.order:
        spread = np.repeat(points, [block.size for block in candidate.blocks], axis=1)
        loop = np.eye(candidate.order) - candidate.M11[None] * spread[:, None, :]
        signs, _ = np.linalg.slogdet(loop)
        if np.any(signs <= 0) or np.max(np.linalg.cond(loop)) > _CONDITION:
            return False
    difference = np.abs(evaluate_at(candidate, points) - values)
    return bool(np.max(difference / np.where(size > 0, size, 1.0), initial=0.0) <= largest)


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
