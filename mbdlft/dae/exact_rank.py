"""Ranks of matrices of equations: exact where their numbers are, with names of what is singular."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError
from mbdlft.exact.matrices import Residues, null_space
from mbdlft.problem.sx.constants import in_doubles, modulo_prime

_SEED = 20230917  # of the residues that stand for parameters
_SMALL = (
    1e-10  # of the largest singular value of scaled rows: below it, a matrix is taken for singular
)


class Singular(NamedTuple):
    """Rows that depend on each other, columns that they do not determine; whether that is proved."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]
    exact: bool


def singular_part(
    matrix: ca.SX,
    signals: ca.SX,
    parameters: ca.SX,
    points: Callable[[], Sequence[Array]],
) -> Singular | None:
    """What is singular in a square matrix (n, n), or None.

    A matrix of numbers and parameters is decided in exact arithmetic, for parameters in general. One of
    signals is looked at in doubles at points, values of [signals ; parameters].
    """
    if not ca.depends_on(ca.densify(matrix), signals):
        try:
            return _by_residues(matrix)
        except NotRationalError:
            pass
    return _by_values(matrix, ca.vertcat(signals, parameters), points())


def _by_residues(matrix: ca.SX) -> Singular | None:
    """Modulo a prime above 2^60, with random residues for the parameters."""
    residues, prime = modulo_prime(matrix, _SEED)
    right = null_space(residues.astype(np.int64), prime)
    if not right.shape[1]:
        return None
    left = null_space(residues.T.astype(np.int64), prime)
    return Singular(_used(left), _used(right), exact=True)


def _used(space: Residues) -> tuple[int, ...]:
    return tuple(int(k) for k in np.flatnonzero(np.any(space != 0, axis=1)))


def _by_values(matrix: ca.SX, symbols: ca.SX, points: Sequence[Array]) -> Singular | None:
    """The singular part if the matrix is singular at all of the points."""
    function = ca.Function("matrix", [symbols], [ca.densify(in_doubles(matrix))])
    found = None
    for point in points:
        value = function(point).full()
        rows = np.max(np.abs(value), axis=1, keepdims=True)
        scaled = value / np.where(rows > 0, rows, 1.0)
        columns = np.max(np.abs(scaled), axis=0)
        scaled = scaled / np.where(columns > 0, columns, 1.0)
        if not np.all(np.isfinite(scaled)):
            continue
        u, s, vt = np.linalg.svd(scaled)
        null = s <= _SMALL * max(s[0], 1e-300)
        if not np.any(null):
            return None
        found = Singular(_large(u[:, null]), _large(vt[null].T), exact=False)
    return found


def _large(vectors: Array) -> tuple[int, ...]:
    return tuple(int(k) for k in np.flatnonzero(np.max(np.abs(vectors), axis=1) > 1e-3))
