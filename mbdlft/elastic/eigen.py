"""The lowest modes of K phi = w^2 M phi, K positive definite, M possibly singular."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError

_DENSE = 800  # rows; all modes of a smaller structure are computed, by a dense eigenvalue problem
_SINGULAR = 1e-12  # a pivot that is smaller, relative to its diagonal entry, counts as zero
# a negative 1/w^2 above this part of the largest 1/w^2 is not rounding of the data
_INDEFINITE = 1e-9
MASSLESS = 1e-13  # a 1/w^2 below this part of the largest counts as zero: no mass moves


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """The lowest modes of a structure.

    Attributes
    ----------
    frequencies : (k,) rad/s, ascending
    shapes : (n, k), scaled to unit modal mass
    complete : whether these are all modes that the structure has
    """

    frequencies: Array
    shapes: Array
    complete: bool

    def __len__(self) -> int:
        return len(self.frequencies)


class Solver:
    """Solutions of K x = b for a positive definite K, by one sparse factorization.

    Parameters
    ----------
    matrix : sparse (n, n), the stiffness matrix K
    names : function
        Gives the words by which an error message names a row of K.

    Raises
    ------
    StructureError
        K is singular or indefinite.
    """

    def __init__(self, matrix: Any, names: Callable[[int], str]) -> None:
        self.rows = int(matrix.shape[0])
        if not self.rows:
            return
        diagonal = matrix.diagonal()
        if np.any(diagonal <= 0.0):
            row = int(np.argmin(diagonal))
            kind = "no stiffness" if diagonal[row] == 0.0 else "a negative stiffness"
            raise StructureError(
                f"stiffness matrix: {names(row)} has {kind} ({diagonal[row]:g}). Leave out "
                "coordinates that nothing holds, or check the matrix."
            )
        # K is scaled to a unit diagonal. A pivot is then 1 for a coordinate that is coupled to no other,
        # and 0 for one that moves freely (a mechanism).
        self._scale = 1.0 / np.sqrt(diagonal)
        scaled = sp.csc_array(sp.diags_array(self._scale) @ matrix @ sp.diags_array(self._scale))
        try:
            self._factor = spl.splu(
                scaled,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError:
            raise StructureError(_mechanism("singular")) from None
        pivots = self._factor.U.diagonal()
        worst = int(np.argmin(pivots))
        if pivots[worst] < _SINGULAR:
            row = int(np.argmax(self._factor.perm_c == worst))
            if pivots[worst] < -_SINGULAR:
                raise StructureError(
                    "stiffness matrix: indefinite: the structure held at the parent has a negative "
                    f"stiffness, found at {names(row)}. Check the matrix, its signs and the order "
                    "of its rows."
                )
            raise StructureError(_mechanism(f"the free motion shows at {names(row)}"))

    def __call__(self, right: Array) -> Array:
        """K^-1 b for the right-hand sides b (n,) or (n, k)."""
        if not self.rows:
            return np.zeros_like(right)
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        return np.asarray(scale * self._factor.solve(np.ascontiguousarray(scale * right)))


def lowest_modes(mass: Any, solver: Solver, stiffness: Any, count: int) -> Modes:
    """At least `count` of the lowest modes, or all modes of finite frequency if there are fewer.

    The eigenvalue problem is solved for 1/w^2, as M phi = (1/w^2) K phi: the lowest frequencies are then
    the most accurate ones, and a coordinate without mass has the eigenvalue 0 instead of an infinite one.

    Parameters
    ----------
    mass, stiffness : (n, n), dense or sparse
    solver : Solver
        The factorization of `stiffness`.
    count : int

    Raises
    ------
    StructureError
        A motion has negative kinetic energy.
    """
    n, count = solver.rows, max(count, 1)
    if n <= _DENSE or 2 * count >= n:
        mu, shapes = scipy.linalg.eigh(_dense(mass), _dense(stiffness))
        complete = True
    else:
        operator = spl.LinearOperator((n, n), matvec=solver, dtype=float)
        start = np.random.default_rng(0).standard_normal(n)  # the same modes every time
        # with sigma = 0, eigsh finds the eigenvalues w^2 of K phi = w^2 M phi nearest to zero; it calls
        # `operator` for K^-1
        values, shapes = spl.eigsh(
            stiffness, k=count, M=mass, sigma=0.0, OPinv=operator, v0=start, which="LM"
        )
        mu = 1.0 / values
        norms = np.einsum("ik,ik->k", shapes, stiffness @ shapes)
        shapes = shapes / np.sqrt(norms)
        complete = False
    order = np.argsort(-mu, kind="stable")
    mu, shapes = mu[order], shapes[:, order]
    kept = mu > MASSLESS * max(float(mu[0]), 0.0) if len(mu) else np.zeros(0, dtype=bool)
    if len(mu) and mu[-1] < -_INDEFINITE * abs(mu[0]):
        raise StructureError(
            "mass matrix: indefinite: a motion of the structure has negative kinetic energy. Check "
            "the matrix, its signs and the order of its rows."
        )
    w = 1.0 / np.sqrt(mu[kept])
    return Modes(w, shapes[:, kept] * w, complete=complete)


def _mechanism(where: str) -> str:
    """The message for a structure with parts that move freely."""
    return (
        "stiffness matrix: singular although the structure is held at the parent: a part of it can "
        f"move freely ({where}). The nodes of the parent have to hold all rigid motions, and all "
        "parts have to be connected; make several nodes rigid if one has displacements only."
    )


def _dense(matrix: Any) -> Array:
    """The matrix as an array."""
    return np.asarray(matrix.toarray() if sp.issparse(matrix) else matrix, dtype=float)
