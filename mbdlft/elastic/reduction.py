"""Component modes: reduced matrices of a structure held at its parent.

A structure has n interior coordinates, e of all ports and r of the parent; the n and e coordinates
together are the f free ones. The methods describe the motion by

    Hurty                 modes of n with e and r fixed; constraint modes of e; rigid modes of r
    Craig-Bampton         modes of n with e and r fixed; constraint modes of e and r
    effective mass        modes of f with r fixed; rigid modes of r (Imbert)
    static correction     the same, and what they lack of the deflections K^-1 by unit loads on e

These are equations (4.21) to (4.31), (4.36) to (4.38) and (4.41) of the source in
`tests/reference/flexible.py`. The first two methods span the same motions. The last is the residual
flexibility of R. H. MacNeal (1971) as motions of their own. Each method gives the matrices M, K (q, q) of
q elastic coordinates, their coupling P' (q, r) with the rigid motions, and the motion (e, q) of ports.

Modes are the lowest ones of K phi = w^2 M phi with K positive definite and M possibly singular.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.elastic.nodes import Nodes
from mbdlft.elastic.partition import Partition

_DENSE = 800  # rows; all modes of a smaller structure are computed, by a dense eigenvalue problem
_SINGULAR = 1e-12  # a pivot that is smaller, relative to its diagonal entry, counts as zero
# a negative 1/w^2 above this part of the largest 1/w^2 is not rounding of the data
_INDEFINITE = 1e-9
_COMPLETE = 1e-9  # a smaller residual flexibility, of the whole one, is rounding of the matrices
MASSLESS = 1e-13  # a 1/w^2 below this part of the largest counts as zero: no mass moves
_FIRST = 20  # modes computed at first; the number is doubled until there are enough
_BELOW = {"frequency": np.inf, "effective_mass": 1.0}
_EXPECTED = {
    "frequency": "a positive number (rad/s)",
    "effective_mass": "a fraction of the rigid mass between 0 and 1",
}
_MOST = 640  # most modes of a large structure that are computed for an effective mass
NO_MASS = 1e-9  # a smaller mass, of the largest, is none: a bar has no inertia about its own axis


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """The lowest modes of a structure, or all of them if `complete`.

    `frequencies` (k,) rise (rad/s), `shapes` (n, k) have unit modal mass.
    """

    frequencies: Array
    shapes: Array
    complete: bool

    def __len__(self) -> int:
        return len(self.frequencies)


class Solver:
    """Solutions of K x = b for a positive definite K, a sparse `matrix` (n, n), by one factorization.

    `names` gives the words by which an error message names a row of K.
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
                scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
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
    `mass` and `stiffness` are (n, n), dense or sparse; `solver` is the factorization of `stiffness`.
    """
    n, count = solver.rows, max(count, 1)
    if n <= _DENSE or 2 * count >= n:
        dense = (m.toarray() if sp.issparse(m) else m for m in (mass, stiffness))
        mu, shapes = scipy.linalg.eigh(*dense)
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


class Reduced(NamedTuple):
    """Matrices of the elastic coordinates: mass and stiffness (q, q), coupling (q, r), ports (e, q)."""

    mass: Array
    stiffness: Array
    coupling: Array
    ports: Array


class Structure(NamedTuple):
    """Mass and stiffness matrices (f + r, f + r) of a structure, and its partition `at`."""

    mass: Any
    stiffness: Any
    at: Partition


class Candidates(NamedTuple):
    """The modes among which the user chooses, and what is made of them."""

    modes: Callable[[int], Modes]  # computes at least so many modes, or all
    reduce: Callable[[Modes], Reduced]  # the modes come first, then the motions of the ports
    deflections: Callable[[], Array]  # (f, e), K^-1 by unit loads on the ports: parent fixed, ports free
    corrects: bool = False  # the motions of the ports depend on which modes there are


def candidates(structure: Structure, method: str, nodes: Nodes) -> Candidates:
    """The modes from which a method of `modal_model` starts, and its reduction with them."""
    at, n = structure.at, structure.at.interior
    if method in ("effective-mass", "static-correction"):
        modes, solver = _computed(structure, nodes, at.free)
        deflections = cache(lambda: solver(np.eye(at.free)[:, n:]))
        if method == "effective-mass":
            return Candidates(modes, lambda modes: projected(structure, modes.shapes), deflections)
        reduce = lambda modes: static_correction(structure, modes, deflections())  # noqa: E731
        return Candidates(modes, reduce, deflections, corrects=True)
    modes, solver = _computed(structure, nodes, n)
    none = lambda: np.zeros((at.free, 0))  # noqa: E731
    constraint = -solver(structure.stiffness[:n, n:].toarray())
    if method == "hurty":
        ports = constraint[:, : at.free - n]
        return Candidates(modes, lambda modes: hurty(structure, modes, ports), none)
    reduce = lambda modes: craig_bampton(structure, modes, constraint)  # noqa: E731
    return Candidates(modes, reduce, none)


def _computed(structure: Structure, nodes: Nodes, rows: int) -> tuple[Callable[[int], Modes], Solver]:
    """A function that computes, and remembers, modes of the first `rows` coordinates; and K^-1."""
    mass, stiffness = (matrix[:rows, :rows] for matrix in structure[:2])
    solver = Solver(stiffness, _names(structure, nodes))
    last: list[Modes] = []

    def modes(count: int) -> Modes:
        if not last or not (last[-1].complete or len(last[-1]) >= count):
            last.append(lowest_modes(mass, solver, stiffness, count))
        return last[-1]

    return modes, solver


def hurty(structure: Structure, modes: Modes, constraint: Array) -> Reduced:
    """Reduced matrices with fixed-interface modes and the constraint modes (n, e) of the ports."""
    n, free = structure.at.interior, structure.at.free
    basis = np.zeros((free, len(modes) + free - n))
    basis[:n, : len(modes)] = modes.shapes
    basis[:n, len(modes) :] = constraint
    basis[n:, len(modes) :] = np.eye(free - n)
    return projected(structure, basis)


def craig_bampton(structure: Structure, modes: Modes, constraint: Array) -> Reduced:
    """Reduced matrices with fixed-interface modes and the constraint modes (n, e + r) of all interfaces.

    The matrices of the whole structure are reduced first; then its parent is held.
    """
    n, free, k = structure.at.interior, structure.at.free, len(modes)
    size = structure.mass.shape[0]
    basis = np.zeros((size, k + size - n))
    basis[:n] = np.hstack([modes.shapes, constraint])
    basis[n:, k:] = np.eye(size - n)
    mass, stiffness = (basis.T @ (matrix @ basis) for matrix in structure[:2])
    # in these coordinates a rigid motion moves the interfaces only; the coordinates of the modes are zero
    rigid = np.vstack([np.zeros((k, structure.at.rigid.shape[1])), structure.at.rigid[n:]])
    elastic = slice(k + free - n)
    ports = np.hstack([np.zeros((free - n, k)), np.eye(free - n)])
    return Reduced(mass[elastic, elastic], stiffness[elastic, elastic], (mass @ rigid)[elastic], ports)


def static_correction(structure: Structure, modes: Modes, deflections: Array) -> Reduced:
    """Reduced matrices as `effective_mass`, with what the modes lack of the deflections (f, e).

    The residual flexibility K^-1 - phi phi'/w^2 is orthogonal to the modes, which stay as they are. Where
    it is the rounding of the flexibility, nothing is lacking.
    """
    moved = modes.shapes[structure.at.interior :]
    residual = deflections - modes.shapes @ (moved / modes.frequencies**2).T
    scale = 1.0 / np.sqrt(np.diag(deflections[structure.at.interior :]))
    flexibility = residual[structure.at.interior :] * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (flexibility + flexibility.T))
    lacking = values > _COMPLETE
    correction = (residual * scale) @ (vectors[:, lacking] / np.sqrt(values[lacking]))
    return projected(structure, np.hstack([modes.shapes, correction]))


def projected(structure: Structure, basis: Array) -> Reduced:
    """Reduced matrices with the columns of `basis` (f, q), motions with the parent held."""
    free = structure.at.free
    inertia = structure.mass @ structure.at.rigid
    return Reduced(
        mass=basis.T @ (structure.mass[:free, :free] @ basis),
        stiffness=basis.T @ (structure.stiffness[:free, :free] @ basis),
        coupling=basis.T @ inertia[:free],
        ports=basis[structure.at.interior :],
    )


def _names(structure: Structure, nodes: Nodes) -> Callable[[int], str]:
    """A function that names a coordinate of the partition in words, for error messages."""
    dof, at = np.asarray(nodes.dof), structure.at

    def name(row: int) -> str:
        if row < at.interior:
            node, component = dof[at.rows[row]]
            return f"component {component} of node {node}"
        return next(f"port {port!r}" for port, place in at.ports.items() if row < place.stop)

    return name


# how many modes a body keeps ------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Limit:
    """One of: number of modes, highest frequency (rad/s), smallest fraction of the rigid mass."""

    modes: int | None
    frequency: float | None
    effective_mass: float | None

    def __post_init__(self) -> None:
        limits = {name: value for name, value in asdict(self).items() if value is not None}
        if len(limits) != 1:
            raise StructureError(
                "expected one of modes (a number), frequency (rad/s) and effective_mass (a "
                f"fraction), got {' and '.join(limits) or 'none'}."
            )
        ((name, value),) = limits.items()
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if name == "modes" and not (whole and value >= 0):
            raise StructureError(f"modes: expected a whole number, 0 or more, got {value!r}.")
        if name != "modes" and not 0.0 < float(value) < _BELOW[name]:
            raise StructureError(f"{name}: expected {_EXPECTED[name]}, got {value!r}.")


def chosen(candidates: Candidates, limit: Limit, rigid: Array) -> tuple[int, Reduced]:
    """The number of modes that `limit` asks for, and the reduced matrices with these modes.

    `rigid` (r,) is the rigid mass of each direction, about the origin.
    """
    if limit.effective_mass is not None:
        return _by_mass(candidates, limit.effective_mass, rigid)
    if limit.modes is not None:
        modes = candidates.modes(limit.modes)
        if len(modes) < limit.modes:
            raise StructureError(
                f"modes: {limit.modes} are asked for and there are {len(modes)}; ask for fewer, or "
                "refine the mesh."
            )
        count = limit.modes
    else:
        top = float(limit.frequency or 0.0)
        modes = _until(candidates, lambda modes: bool(modes.frequencies[-1] > top))
        count = int(np.sum(modes.frequencies <= top))
    reduced = candidates.reduce(first(modes, count))
    if not len(reduced.mass):
        lowest = f", the first is at {modes.frequencies[0]:g} rad/s" if len(modes) else ""
        raise StructureError(f"no mode is kept{lowest}: ask for at least one.")
    return count, reduced


def first(modes: Modes, count: int) -> Modes:
    """The first `count` modes."""
    return Modes(modes.frequencies[:count], modes.shapes[:, :count], complete=False)


def effective(reduced: Reduced) -> Array:
    """Effective mass (r,) of all modes in each direction: the diagonal of P M^-1 P'."""
    scale = 1.0 / np.sqrt(np.diag(reduced.mass))
    coupling = scale[:, None] * reduced.coupling
    solved = np.linalg.solve(reduced.mass * np.outer(scale, scale), coupling)
    return np.asarray(np.einsum("qr,qr->r", coupling, solved))


def _until(candidates: Candidates, enough: Callable[[Modes], bool]) -> Modes:
    """Modes that are `enough`, or all modes; their number is doubled as long as they are not enough."""
    count = _FIRST
    while True:
        modes = candidates.modes(count)
        if modes.complete or not len(modes) or enough(modes):
            return modes
        count *= 2


def _by_mass(candidates: Candidates, fraction: float, rigid: Array) -> tuple[int, Reduced]:
    """The fewest modes whose effective mass is this fraction of `rigid` (r,), and their matrices."""
    has_mass = rigid > NO_MASS * np.max(rigid)

    def enough(reduced: Reduced) -> bool:
        if not len(reduced.mass):
            return False
        return bool(np.all(effective(reduced)[has_mass] >= fraction * rigid[has_mass]))

    modes = _until(candidates, lambda modes: len(modes) >= _MOST or enough(candidates.reduce(modes)))
    total = candidates.reduce(modes)

    def with_first(count: int) -> Reduced:
        if candidates.corrects:
            return candidates.reduce(first(modes, count))
        keep = [*range(count), *range(len(modes), len(total.mass))]
        both = np.ix_(keep, keep)
        ports = total.ports[:, keep]
        return Reduced(total.mass[both], total.stiffness[both], total.coupling[keep], ports)

    if not enough(total):
        reached = np.min(effective(total)[has_mass] / rigid[has_mass])
        raise StructureError(
            f"effective_mass: {fraction:g} is asked for; {len(modes)} modes have {reached:.4g} of "
            "the rigid mass in the direction that has least. What moves with the parent is in no "
            "mode; ask for less, or refine the mesh."
        )
    low, high = -1, len(modes)  # bisection: the effective mass never falls with the number of modes
    while high - low > 1:
        middle = (low + high) // 2
        if enough(with_first(middle)):
            high = middle
        else:
            low = middle
    return high, with_first(high)
