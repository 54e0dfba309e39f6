"""Finite elements of a straight beam: matrices of numbers for each of its deformations.

A deformation (axial, torsion or bending) is a function on s in [0, 1], clamped at s = 0. Each node has
one coordinate of an axial deformation or torsion (linear shape functions); two of bending with cubic
shape functions, w and ds dw/ds; three with quintic ones, also ds^2 d2w/ds2. ds = 1/n for n elements.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray


class DeformationMatrices(NamedTuple):
    """Matrices of numbers of one deformation with n coordinates, on s in [0, 1], clamped at s = 0.

    Attributes
    ----------
    mass, rotary, stiffness : (n, n)
        Integrals of N'N, of dN'dN, and of products of the highest derivatives (first for axial and
        torsion, second for bending).
    shear : (n, n), the matrix K1 of Timoshenko elements
    moment0, moment1 : (n,), integrals of N and of s N
    """

    mass: NDArray[np.float64]
    rotary: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    shear: NDArray[np.float64]
    moment0: NDArray[np.float64]
    moment1: NDArray[np.float64]


def _per_node(name: str, functions: str) -> int:
    """Number of coordinates that one node has in the deformation `name`."""
    if not name.startswith("bending"):
        return 1
    return 2 if functions == "cubic" else 3


def _clamped(name: str, functions: str) -> int:
    """Number of coordinates of the first node that the clamp holds: all but its curvature."""
    return min(_per_node(name, functions), 2)


def displacement_index(name: str, functions: str, node: int) -> int:
    """Index of the displacement of a node among the coordinates of one deformation."""
    return node * _per_node(name, functions) - _clamped(name, functions)


@cache
def deformation_matrices(
    name: str, functions: str, elements: int, first: int = 0, last: int | None = None
) -> DeformationMatrices:
    """Matrices of one deformation, assembled of the elements between the nodes `first` and `last`.

    `functions` is ``cubic`` or ``quintic``; by default all `elements` of the beam are assembled.
    """
    bending = name.startswith("bending")
    order = 2 if bending else 1
    ds = 1.0 / elements
    shapes = element_shapes(name, functions, ds)
    count = _per_node(name, functions) * (elements + 1)
    total = {key: np.zeros((count, count)) for key in ("mass", "rotary", "stiffness", "shear")}
    moments = np.zeros((2, count))
    local = {
        "mass": _products(shapes, 0, ds),
        "rotary": _products(shapes, 1, ds),
        "stiffness": _products(shapes, order, ds),
        "shear": _shear(ds) if bending and functions == "cubic" else np.zeros((len(shapes),) * 2),
    }
    for element in range(first, elements if last is None else last):
        at = slice(start := element * len(shapes) // 2, start + len(shapes))
        for key, matrix in local.items():
            total[key][at, at] += matrix
        s = Polynomial([element * ds, 1.0])
        for k, weight in enumerate((Polynomial([1.0]), s)):
            moments[k, at] += [_integral(weight * shape, ds) for shape in shapes]
    free = slice(_clamped(name, functions), None)
    matrices = {key: matrix[free, free] for key, matrix in total.items()}
    return DeformationMatrices(**matrices, moment0=moments[0, free], moment1=moments[1, free])


@cache
def slope_integrals(functions: str, elements: int) -> NDArray[np.float64]:
    """Integrals (n,) of dN/ds over a bending beam: one for the displacement of the tip, else zero."""
    per_node = _per_node("bending_y", functions)
    integrals = np.zeros(per_node * (elements + 1) - _clamped("bending_y", functions))
    integrals[displacement_index("bending_y", functions, elements)] = 1.0
    return integrals


def element_shapes(name: str, functions: str, ds: float) -> tuple[Polynomial, ...]:
    """Shape functions of one deformation on an element of length ds, as polynomials on [0, ds]."""
    return _element(_per_node(name, functions), ds)


@cache
def _element(per_node: int, ds: float) -> tuple[Polynomial, ...]:
    """Shape functions on [0, ds] for the coordinates w, ds w' (and ds^2 w'') at both ends."""
    count = 2 * per_node
    rows = []
    for x in (0.0, ds):
        for derivative in range(per_node):
            monomials = [Polynomial.basis(k).deriv(derivative) for k in range(count)]
            rows.append([ds**derivative * monomial(x) for monomial in monomials])
    return tuple(Polynomial(column) for column in np.linalg.inv(np.array(rows)).T)


def _products(shapes: Sequence[Polynomial], order: int, ds: float) -> NDArray[np.float64]:
    """Integrals (m, m) over an element of the products of derivatives of its m shape functions."""
    derivatives = [shape.deriv(order) if order else shape for shape in shapes]
    integrals = np.array([[_integral(a * b, ds) for b in derivatives] for a in derivatives])
    return np.asarray(0.5 * (integrals + integrals.T))


def _shear(ds: float) -> NDArray[np.float64]:
    """K1 (4, 4) of an element: the part that shear adds to the stiffness against slopes."""
    stiffness = np.zeros((4, 4))
    stiffness[np.ix_([1, 3], [1, 3])] = [[1.0, -1.0], [-1.0, 1.0]]
    return stiffness / ds**3


_integral: Callable[[Polynomial, float], float] = lambda p, ds: float(p.integ()(ds))  # noqa: E731
