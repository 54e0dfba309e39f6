"""Values in 150 digits, and what their terms add up to if nothing cancels."""

import numpy as np

from tests.cross.poses import solve, times, zeros

Sized = tuple[np.ndarray, np.ndarray]  # values and sizes


def plain(values: np.ndarray) -> Sized:
    return values, np.abs(values.astype(float))


def sized(matrix: np.ndarray, sides: Sized, less: list[tuple[np.ndarray, np.ndarray, Sized]]) -> Sized:
    """matrix^-1 (right - sum of products), and its size if nothing cancelled (Skeel 1979)."""
    right, size = sides
    for factor, its_size, (value, size_of_value) in less:
        right = right - times(factor, value)
        size = size + its_size @ size_of_value
    solution, doubles = solve(matrix, right), matrix.astype(float)
    of_matrix = np.abs(doubles) @ np.abs(solution.astype(float))
    return solution, np.abs(np.linalg.inv(doubles)) @ (of_matrix + size)


class Sum:
    """A sum and its size if nothing cancelled."""

    def __init__(self, *shape: int) -> None:
        self.value, self.size = zeros(*shape), np.zeros(shape)

    def add(self, part: slice, term: np.ndarray, size: np.ndarray | None = None) -> None:
        self.value[part] += term
        self.size[part] += np.abs(term.astype(float)) if size is None else size
