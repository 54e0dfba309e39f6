"""Laws of pencils in exact numbers: values at which they lose rank, null spaces, eigenvalues."""

import flint
import numpy as np
import pytest

from mbdlft.exact import matrices, modular, pencils
from mbdlft.exact.matrices import ExactMatrix
from mbdlft.exact.numbers import RESIDUES_ALONE, precision
from tests.extracted import FIELD
from tests.extracted import with_bits as with_bits

PRIME = FIELD.prime


def exact(a: np.ndarray) -> ExactMatrix:
    return matrices.of_integers(np.asarray(a, dtype=float), PRIME)


def system(seed: int, n: int, outputs: int, inputs: int, zeros: list[int]) -> np.ndarray:
    """Integers [A B ; C D] with n states, whose pencil loses rank at some integers.

    A state x is moved by s x = A x + B u, and none of the outputs sees it beside u.
    """
    random = np.random.default_rng(seed)
    M = random.integers(-3, 4, (n + outputs, n + inputs))
    for k, s in enumerate(zeros):  # column k of A from column k of B: (s - A) e_k = B e_k
        M[:n, k] = s * np.eye(n, dtype=int)[k] - M[:n, n + k]
        M[n:, k] = -M[n:, n + k]
    T = np.tril(random.integers(-1, 2, (n, n)), -1) + np.eye(n, dtype=int)
    M[:n], inverse = T @ M[:n], np.round(np.linalg.inv(T)).astype(int)
    M[:, :n] = M[:, :n] @ inverse
    return M


@pytest.mark.parametrize(("outputs", "inputs", "count"), [(3, 3, 5), (6, 3, 2), (3, 5, 0)])
def test_zeros_are_where_the_pencil_loses_rank(outputs: int, inputs: int, count: int) -> None:
    """Two are where they were put; a pencil that is not square has no others, and a wide one none."""
    n = 5
    M = exact(system(outputs + inputs, n, outputs, inputs, [2, 7]))
    Z = pencils.invariant_zeros(M, n)
    assert Z.shape == (count, count)
    values = pencils.eigenvalues(Z)[1]
    for s in (2, 7):
        at = pencils.pencil(M, n, s, flint.arb(s))
        assert np.array_equal(pencils.residues_of_pencil(M.residues, n, s, PRIME), at.residues)
        kernel, free = pencils.null_space(at)
        assert len(free) == max(inputs - outputs, 0) + (count > 0)
        assert not (at @ kernel).residues.any()
        assert np.array_equal(kernel.residues[free], np.eye(len(free)))
        assert any(x.contains(s) for x in values) == (count > 0)


def test_eigenvalues_are_residues_and_balls() -> None:
    """Each once, however often it is there, and with as many vectors as it may have."""
    T = np.array([[1, 2, 0, 1], [0, 1, 1, 0], [0, 0, 1, 3], [0, 0, 0, 1]])
    inverse = np.round(np.linalg.inv(T)).astype(int)
    half = pow(2, -1, PRIME)
    for diagonal, extra, expected in (
        ([0, 4, 4, 6], 0, {0, 4, 6}),
        ([0, 4, 4, 6], 1, {0, 4, 6}),
        ([3, 4, 4, 4], 1, {3, 4}),
    ):
        D = np.diag(diagonal)
        D[1, 2] = extra
        a = exact(T @ D @ inverse)
        a = ExactMatrix(modular.entrywise(a.residues, np.full(a.shape, half), PRIME), a.balls / 2, PRIME)
        residues, values, above = pencils.eigenvalues(a)
        assert not above
        assert {2 * x % PRIME for x in residues} == set(diagonal)
        assert len(values) == len(expected)
        assert all(any((2 * x).contains(flint.arb(y)) for x in values) for y in expected)
        assert all(float(x.rad()) < 1e-60 for x in values)
    assert pencils.eigenvalues(exact(np.zeros((0, 0)))) == ([], [], [])
    with precision(1536):  # where a part of the bits is no double
        assert len(pencils.eigenvalues(exact(np.diag([1, 2])))[1]) == 2
    with precision(RESIDUES_ALONE):
        assert pencils.eigenvalues(exact(np.diag([2, 2]))) == ([2], [], [])
    residues, values, above = pencils.eigenvalues(exact(np.array([[0, -1], [1, 0]])))
    assert [complex(x.mid()) for x in above] == [1j]
    assert all(x * x % PRIME == PRIME - 1 for x in residues)
    assert not values
