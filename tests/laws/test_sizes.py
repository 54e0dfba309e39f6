"""Laws of models of many equations: what is sparse stays so, and says the same as dense matrices do."""

from typing import Any

import numpy as np
import pytest
import scipy.linalg
from scipy.sparse import csc_array

import mbdlft
from benchmarks.geared_chain import geared_chain, ratio
from mbdlft.dae import index
from mbdlft.exact import matrices as exact_matrices
from mbdlft.exact import modular
from mbdlft.exact.matrices import is_regular
from mbdlft.exact.modular import rank
from mbdlft.exact.numbers import BITS, precision
from mbdlft.modelica import flat_model, operating_point, translate
from mbdlft.problem import sparse
from tests import kit
from tests.close import CROSS, ENCLOSURE, NOTHING, target
from tests.extracted import FIELD, exact_matrix


def _transfer(stages: int, values: dict[str, float], s: complex, *, springs: bool) -> complex:
    """From the torque at the beginning to the speed at the end, by masses and springs."""
    M = np.diag([values.get(f"J{i}", 1.0 + i % 7 / 10.0) for i in range(stages)]).astype(complex)
    K = np.zeros((stages, stages), dtype=complex)
    T = np.eye(stages)
    for i in range(stages):
        stretch = np.zeros(stages)
        stretch[i] = -1.0 / ratio(i)
        if i + 1 < stages:
            stretch[i + 1] = 1.0
        if springs or i + 1 == stages:
            K += (values.get(f"c{i}", 100.0 + i % 5) + 0.5 * s) * np.outer(stretch, stretch)
        else:
            T[i + 1] = T[i] / ratio(i)
    T = T if springs else T[:, :1]
    moved = T @ np.linalg.solve(T.T @ (s * s * M + K) @ T, T[0])
    return complex(s * moved[-1])


@pytest.mark.parametrize("springs", [False, True])
def test_geared_chain(springs: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    stages = 12 if springs else 20
    sizes: list[int] = []

    def looked_at(module: Any, name: str) -> None:
        called = getattr(module, name)

        def with_size(a: Any, *others: Any, **named: Any) -> Any:
            shape = a.shape[-2:] if isinstance(a, np.ndarray) else (a.nrows(), a.ncols())
            sizes.append(min(shape))
            return called(a, *others, **named)

        monkeypatch.setattr(module, name, with_size)

    for name in ("solve", "inv", "pinv", "svd", "lstsq", "slogdet", "eigvals"):
        looked_at(np.linalg, name)
    looked_at(scipy.linalg, "qr")
    looked_at(index, "qr")
    looked_at(modular, "_residue_matrix")
    looked_at(exact_matrices, "ball_matrix")
    for module, name in ((sparse, "LARGE"), (index, "LARGE"), (exact_matrices, "_LARGE")):
        monkeypatch.setattr(module, name, 24)
    dae, report = translate(flat_model(geared_chain(stages, springs=springs)))
    at = operating_point(dae, report)
    model = mbdlft.linearize_dae(at, search=0.0, prove=0.0)
    # the state space is dense, and so are the differentiated constraints
    assert max(sizes) <= 2 * stages + 1 < len(at.structure.equations) / 3
    point = {p.name: p.low for p in model.parameters}
    for s in (0.3j, 1.0 + 2.0j):
        target(kit.transfer(model, s, point)[0, 0], _transfer(stages, point, s, springs=springs), CROSS)


def _sparse(seed: int, n: int, m: int, *, dependent: int = 0) -> np.ndarray:
    """A matrix with some entries in each row, the last rows being sums of rows before."""
    drawn = np.random.default_rng(seed)
    A = drawn.uniform(1.0, 2.0, (n, m)) * (drawn.random((n, m)) < 2.0 / m)
    A[np.arange(n), drawn.permutation(max(n, m))[:n] % m] += 2.0
    for k in range(dependent):
        A[n - 1 - k] = A[2 * k] + A[2 * k + 1]
    return A


@pytest.mark.parametrize("seed", range(6))
def test_sparse_solutions(seed: int) -> None:
    drawn, sizes = np.random.default_rng(seed), 10.0 ** np.random.default_rng(seed).uniform(-6, 6, 30)
    A, right = _sparse(seed, 30, 30) * sizes, drawn.standard_normal((30, 3))
    expected = np.linalg.solve(A, right)
    for solved in (sparse.solve(csc_array(A), right), sparse.solve_scaled(A[None], right)[0]):
        target(solved / np.abs(expected), expected / np.abs(expected), CROSS)
    B = _sparse(seed, 20, 30, dependent=2)
    some = B @ drawn.standard_normal(30)
    target(sparse.smallest(csc_array(B), some), np.linalg.pinv(B) @ some, CROSS)
    inverse, norms = sparse.pseudo_inverse(csc_array(B), np.ones(30))
    target(inverse / norms @ B, np.linalg.pinv(B) @ B, ENCLOSURE)  # sizes are all that it is for


@pytest.mark.parametrize("seed", range(6))
def test_independent_columns(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    A = _sparse(seed, 30, 36, dependent=3)
    classes = np.arange(36) % 2
    densely = index.independent(A, classes)
    monkeypatch.setattr(index, "LARGE", 0)
    sparsely = index.independent(A, classes)
    for chosen in (densely, sparsely):
        assert np.linalg.matrix_rank(A[:, chosen]) == len(chosen) == np.linalg.matrix_rank(A)
    first = np.linalg.matrix_rank(A[:, classes == 0])
    assert sum(classes[sparsely] == 0) == sum(classes[densely] == 0) == first


@pytest.mark.parametrize("seed", range(6))
def test_exact_sparse_solutions(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    with precision(BITS):
        A, right = exact_matrix(_sparse(seed, 12, 12)), exact_matrix(_sparse(seed + 1, 12, 4))
        singular = exact_matrix(_sparse(seed, 12, 12, dependent=2).round(2))
        expected = A.solve(right)
        monkeypatch.setattr(exact_matrices, "_LARGE", 0)
        found = A.solve(right)
        assert np.array_equal(found.residues, expected.residues)
        target(found.values(), expected.values(), NOTHING)
        for matrix in (A, singular):
            full = rank(matrix.residues, FIELD.prime) == 12
            assert is_regular(matrix.residues, FIELD.prime) is full
        with pytest.raises(ZeroDivisionError):
            singular.solve(right)
