"""A proof of stability, or of a gain, on a box of deltas, without frequencies: Lyapunov functions.

Let d = det(I - D Delta), and N = d A, both polynomials in the deltas. On a part of the box on which d > 0
and a polynomial P(delta) = P' has

    S(delta) = -(N'P + P N) > 0,

no model has a pole on the axis, as v'S v = -2 d Re(s) v'P v for a pole s with the vector v. Parts cover
the box, which is connected, and its middle is stable: so is all of it. P need not be positive.

P interpolates solutions of A'P + P A = -Q at Chebyshev nodes of the part. With the modes of its middle as
coordinates, each scaled, P is nearly the energy of the modes there, and Q = I what they dissipate; Q is
the same on the part. So S is d Q but for the error of the interpolation: where frequencies cancel in
P N and its transpose, they cancel in the coefficients. Parts are small only where modes turn into each
other within a range of deltas that is as small as their damping. (Polynomials P for boxes: Chesi,
Garulli, Tesi, Vicino, IEEE TAC 50, 2005.)

In each delta P has the least degree at which the tail of its Chebyshev series, along the line through the
middle, leaves most of S. A part that needs too much is cut along the delta of the largest tail, or of the
line on which most nodes have no P.

A gain is below 1/g, too, where (bounded real lemma) with P_+ = diag(P, I, I)

    S = -(N_+'P_+ + P_+ N_+) > 0,       N_+ = d [A E 0; 0 -I/2 0; g G  g J  -I/2].

Then P interpolates stabilizing solutions of the Riccati equation in which the Schur complement is Q in
place of 0: half of the largest multiple of the I of the modes for which there is one in the middle.

S > 0 if all of its Bernstein coefficients are, on pieces into which it is halved where they are far from
its values (`mbdlft.robust.bisect.bernstein`): that costs less than smaller parts with other P. Products
are in doubles, with bounds of their rounding, and Cholesky's factor of what is left without these proves
that it is positive (Rump, BIT 46, 2006). The proof is the list of cuts, and the degrees and coordinates
of each part; P is computed again.
"""

from collections.abc import Sequence
from math import isqrt, prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgees, dtrsyl

from mbdlft.base.array import Array
from mbdlft.base.running import tell
from mbdlft.exact.rounding import EPS, eigenvectors_of
from mbdlft.response.modes import balancing
from mbdlft.robust.bisect import bernstein
from mbdlft.robust.bisect.boxes import Check, Ends, split
from mbdlft.robust.bisect.characteristic import Realization, state_polynomials
from mbdlft.robust.evidence import BoxProof, LyapunovProof
from mbdlft.robust.realization import real_columns

_UP = 1.0 + 1e-9  # times sums of bounds: more than their rounding
_DEGREE = 8  # of P in a delta, at most
_TAIL = 0.05  # of S, which terms of P beyond its degrees may be, as far as the middle tells
_DEAREST = 1.0  # units of work of a part
_PRODUCT, _SOLUTION, _NODE, _PART = 1.2e-10, 3.0e-8, 3e-5, 2e-3  # units of work
_HALF = 6e-9  # units of work, for each entry of the halves of S
_PIECES, _AGAIN = 100, 4  # of S at most; times these in a proof, whose cuts may be others elsewhere
_RICCATI = 6.0  # times the work of a Lyapunov equation, that of a Riccati equation
# of eigenvalues of a Hamiltonian: what rounding moves off the axis is nearer, and P is another elsewhere
_ON_AXIS = 1e-6
_HALVINGS = 12  # of a share that is looked for
_UNSEEN = 1e-3  # of the largest size of modes at inputs or outputs: smaller ones count as this
_SLACK = 1e-4  # of S, which a proof has more than rounding needs: P is computed again elsewhere
_SMALLEST = 2.0**-20  # of the box: a part of this size is not cut again
# of the work: from then on, parts that are proved are this share, or the share of the work that is used,
# of those that would be if all took the same work. Soft corners come first, and take more
_EARLY, _ON_THE_WAY = 0.25, 0.4
_MIDDLE = np.array([0.5])


class _Subbox(NamedTuple):
    """N and d as Bernstein coefficients (r_1 + 1, ..., n^2 + 1) on deltas c - h to c + h, of a unit box.

    Their errors are at most `steps` EPS of `sizes`, which has their shape. With a gain it is N_+.
    """

    values: Array
    sizes: Array
    steps: int
    center: Array
    half: Array
    states: int
    inputs: int = 0  # of the gain

    @property
    def rows(self) -> int:
        """Of N, or of N_+."""
        return isqrt(self.values.shape[-1] - 1)


class Attempt(NamedTuple):
    """What came of a search."""

    proof: BoxProof | LyapunovProof | None
    counterexample: Array | None  # deltas of the unit box that are wrong
    center: Array  # of the last part, in the unit box: one that resisted, if there is neither
    work: float  # units that were used
    is_hopeless: bool = False  # whether more work of this size would not be enough, either


def is_small(model: Realization) -> bool:
    """Whether the work of a part is bearable, if P is affine in each delta."""
    return _cost(model, np.ones(len(model.sizes))) <= _DEAREST


def _cost(model: Realization, degrees: NDArray[Any] | None) -> float:
    """Units of work of a part of the box with P of these degrees, or of a look at it."""
    n, rows, q = len(model.A), len(model.A) + sum(model.J.shape), len(model.sizes)
    nodes = 0.0 if degrees is None else float(np.prod(degrees + 1.0))
    solution, more = _NODE + _SOLUTION * n**3, (_DEGREE + 1.0) * q
    if rows > n:
        solution, more = _RICCATI * solution, more + _HALVINGS
    products = _PRODUCT * nodes * model.coefficients / (n + 1) * rows**3
    return _PART + (nodes + more) * solution + products


def searched(model: Realization, ends: Ends, work: float, is_wrong: Check, gain: float = 0.0) -> Attempt:
    """Look for a proof that all models of the box |delta| <= ends are stable, of a gain below 1/gain."""
    waiting, log, states, degrees = [_whole(model, ends, gain)], list[int](), list[Array](), list[Any]()
    used, proved, subbox = 0.0, 0.0, waiting[0]
    while waiting:
        subbox = waiting.pop()
        if is_wrong(subbox.center):
            return Attempt(None, subbox.center, subbox.center, used)
        modes = _modes(subbox)
        tails = None if modes is None else _tails(subbox, modes)
        wanted, axis = None, _largest_change(subbox)
        if tails is not None:
            least = 1 + np.sum(tails > _TAIL / len(tails), axis=1)
            axis = int(np.argmax(least + tails[:, -1] / (1.0 + tails[:, -1])))
            wanted = least if np.max(least) <= _DEGREE and _cost(model, least) <= _DEAREST else None
        cost = _cost(model, wanted)
        is_slow = used > _EARLY * work and proved * work < max(_ON_THE_WAY, used / work) * used
        is_hopeless = is_slow or not subbox.half[axis] > _SMALLEST
        if used + cost > work or is_hopeless:
            return Attempt(None, None, subbox.center, used, is_hopeless)
        used += cost
        tell(used)
        is_proved = False
        if modes is not None and wanted is not None:
            is_proved, more = _proves(subbox, modes, wanted, _PIECES, _SLACK)
            used += more
        if is_proved and modes is not None:
            log.append(0)
            states.append(modes)
            degrees.append(wanted)
            proved += float(np.prod(subbox.half))
        else:
            log.append(1 + axis)
            waiting += reversed(_halves(subbox, axis))
    return Attempt(
        LyapunovProof(tuple(log), np.array(degrees), np.array(states)), None, subbox.center, used
    )


def replayed(model: Realization, ends: Ends, proof: LyapunovProof, gain: float = 0.0) -> bool:
    """Whether a list of cuts, and coordinates of the parts, prove what `searched` says."""
    n, q, count = len(model.A), len(model.sizes), proof.log.count(0)
    if proof.degrees.shape != (count, q) or proof.states.shape != (count, n, n):
        return False
    if not np.all((proof.degrees >= 0) & (proof.degrees <= _DEGREE)):
        return False
    leaves = zip(proof.states, proof.degrees, strict=True)
    waiting = [_whole(model, ends, gain)]
    for step in proof.log:
        if not waiting or not 0 <= step <= q:
            return False
        subbox = waiting.pop()
        if step:
            waiting += reversed(_halves(subbox, step - 1))
            continue
        modes, degrees = next(leaves)
        if not (np.all(np.isfinite(modes)) and _proves(subbox, modes, degrees, _AGAIN * _PIECES)[0]):
            return False
    return not waiting


def _whole(model: Realization, ends: Ends, gain: float) -> _Subbox:
    values, sizes = state_polynomials(model, ends, gain)
    (n, m), q = model.E.shape, len(model.sizes)
    return _Subbox(values, sizes, 2, np.zeros(q), np.ones(q), n, m if gain else 0)


def _halves(subbox: _Subbox, axis: int) -> list[_Subbox]:
    """Both halves along a delta, the lower first (de Casteljau)."""
    half = subbox.half.copy()
    half[axis] *= 0.5
    steps = subbox.steps + subbox.values.shape[axis]
    result = []
    halves = zip(split(subbox.values, axis), split(subbox.sizes, axis), strict=True)
    for side, pair in zip((-1.0, 1.0), halves, strict=True):
        center = subbox.center.copy()
        center[axis] += side * half[axis]
        values, sizes = pair
        result.append(subbox._replace(values=values, sizes=sizes, steps=steps, center=center, half=half))
    return result


def _modes(subbox: _Subbox) -> Array | None:
    """Columns (n, n) of the modes in the middle, in which -(A + A') is I; None if they are dependent.

    With a gain, they are larger: I is what the Riccati equation has in place of 0.
    """
    n, middle = subbox.states, [_MIDDLE] * len(subbox.center)
    N, d = _at_nodes(subbox, middle)
    if not d.item() > 0.0:
        return None
    A = N.reshape(N.shape[-2:])[:n, :n] / d.item()
    scale = balancing(A)
    values, vectors = eigenvectors_of(A * scale / scale[:, None])[::2]
    columns, owner = real_columns(values, vectors)
    decay = np.sqrt(2.0 * np.abs(values[owner].real))
    if columns.shape != A.shape or not (np.all(np.isfinite(columns)) and np.all(decay > 0.0)):
        return None
    modes = np.asarray(scale[:, None] * columns / decay)
    if not subbox.inputs:
        return modes
    if (whole := _in_modes(subbox, modes, middle)) is None:
        return None
    modes = modes / _weights(whole.reshape(N.shape[-2:]), decay, subbox.inputs, owner)
    if (whole := _in_modes(subbox, modes, middle)) is None:
        return None
    share = _largest_share(whole.reshape(N.shape[-2:]), n, subbox.inputs)
    return np.asarray(modes / np.sqrt(0.5 * share)) if share else None


def _weights(whole: Array, decay: Array, m: int, owner: NDArray[np.int64]) -> Array:
    """What modes (n,) are divided by, so that each is moved as much by inputs as outputs see of it.

    Alone, a mode has solutions P from |g G_i|^2 to 1/|E_i|^2, and P = |g G_i|/|E_i| leaves most of S.
    """
    n, sizes = len(decay), []
    for rows in (whole[n + m :, :n].T, whole[:n, n : n + m] / decay[:, None] ** 2):
        size = np.sqrt(np.bincount(owner, np.sum(rows**2, axis=1))[owner])
        sizes.append(size + _UNSEEN * max(float(np.max(size)), 1e-300))
    return np.asarray(np.sqrt(sizes[0] / sizes[1]))


def _largest_share(whole: Array, n: int, inputs: int) -> float:
    """Nearly the largest multiple of I for which a Riccati equation has a stabilizing solution; or 0."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        low, high = (low, share) if _riccati(whole, n, inputs, share) is None else (share, high)
    return low


def _at_nodes(subbox: _Subbox, nodes: Sequence[Array]) -> tuple[Array, Array]:
    """N (..., n, n) and d (...) at nodes of each delta, which go from 0 to 1 on the part."""
    values, n = bernstein.at_nodes(subbox.values, nodes), subbox.rows
    return values[..., :-1].reshape(*values.shape[:-1], n, n), values[..., -1]


def _proves(
    subbox: _Subbox, modes: Array, degrees: NDArray[Any], most: int, slack: float = 0.0
) -> tuple[bool, float]:
    """Whether P of these degrees, in these coordinates, proves a part; and the work of its pieces."""
    nodes = [_chebyshev(int(e)) for e in degrees]
    P = _solutions(subbox, modes, nodes)
    if P is None:
        return False, 0.0
    P = bernstein.interpolated(P, nodes)
    P = _beside(subbox, 0.5 * (P + P.mT), 1.0)
    if not np.all(np.isfinite(P)):
        return False, 0.0
    is_proved, pieces = _is_positive(subbox, modes, P, most, slack)
    entries = np.prod(np.add(subbox.values.shape[: len(degrees)], degrees)) * subbox.rows**2
    return is_proved, _HALF * float(entries) * pieces


def _tails(subbox: _Subbox, modes: Array) -> Array | None:
    """What terms of P beyond degrees 1, 2, ... add to S along each delta (q, _DEGREE); None without A.

    Where nodes have no P, it is how many.
    """
    n, q, t = subbox.rows, len(subbox.center), _chebyshev(_DEGREE)
    terms = np.linalg.inv(np.polynomial.chebyshev.chebvander(2.0 * t - 1.0, _DEGREE))
    A = _in_modes(subbox, modes, [_MIDDLE] * q)
    if A is None:
        return None
    tails = []
    for axis in range(q):
        line = _in_modes(subbox, modes, [t if k == axis else _MIDDLE for k in range(q)])
        rows: Any = () if line is None else line.reshape(-1, *A.shape[-2:])
        solutions = [P for each in rows if (P := _equation(subbox, each)) is not None]
        if missing := len(t) - len(solutions):  # cut first where most have none
            tails.append(np.full(_DEGREE, float(missing)))
            continue
        series = np.tensordot(terms, np.array(solutions), 1)
        half = _beside(subbox, series, 0.0) @ A.reshape(n, n)
        sizes = np.linalg.norm(half + half.mT, axis=(1, 2))
        tails.append(np.append(np.cumsum(sizes[::-1])[-3::-1], sizes[-1]))
    return np.array(tails) if np.all(np.isfinite(tails)) else None


def _chebyshev(degree: int) -> Array:
    """Chebyshev nodes from 0 to 1."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1)))


def _beside(subbox: _Subbox, matrices: Array, one: float) -> Array:
    """diag(X, one I, one I) for each of the matrices X of the states."""
    n, more = subbox.states, subbox.rows - subbox.states
    if not more:
        return matrices
    whole = np.zeros((*matrices.shape[:-2], n + more, n + more))
    whole[..., :n, :n] = matrices
    whole[..., range(n, n + more), range(n, n + more)] = one
    return whole


def _in_modes(subbox: _Subbox, modes: Array, nodes: Sequence[Array]) -> Array | None:
    """N/d (..., n, n) at nodes in coordinates; None if there is none."""
    N, d = _at_nodes(subbox, nodes)
    if not np.all(d > 0.0):
        return None
    try:
        modes = _beside(subbox, modes, 1.0)
        return np.asarray(np.linalg.solve(modes, N / d[..., None, None] @ modes))
    except np.linalg.LinAlgError:
        return None


def _solutions(subbox: _Subbox, modes: Array, nodes: Sequence[Array]) -> Array | None:
    """Solutions P (..., n, n) at nodes, in coordinates; None if one has none."""
    whole = _in_modes(subbox, modes, nodes)
    if whole is None:
        return None
    solutions = []
    for each in whole.reshape(-1, *whole.shape[-2:]):
        if (P := _equation(subbox, each)) is None:
            return None
        solutions.append(P)
    return np.array(solutions).reshape(*whole.shape[:-2], *modes.shape)


def _equation(subbox: _Subbox, whole: Array) -> Array | None:
    """The solution of Lyapunov's equation, or of Riccati's, of one matrix."""
    return _riccati(whole, subbox.states, subbox.inputs, 1.0) if subbox.inputs else _solution(whole)


def _solution(A: Array, Q: Array | None = None) -> Array:
    """The solution P of A'P + P A = -Q, or -I; of a matrix near to A where there is none."""
    R, _, _, _, U, _, _ = dgees(_unsorted, A.T)
    Y, scale, _ = dtrsyl(R, R, -U.T @ U if Q is None else -U.T @ Q @ U, tranb="T")
    return np.asarray(U @ (Y / scale) @ U.T)


def _riccati(whole: Array, n: int, m: int, share: float) -> Array | None:
    """The stabilizing P of A'P + P A + share I + G'G + (P E + G'J) (I - J'J)^-1 (P E + G'J)' = 0.

    [A E 0; 0 -I/2 0; G J -I/2] is the whole.
    """
    A, E, G, J = whole[:n, :n], whole[:n, n : n + m], whole[n + m :, :n], whole[n + m :, n : n + m]
    R = np.eye(m) - J.T @ J
    try:
        feedback, through = np.linalg.solve(R, J.T @ G), np.linalg.solve(R, E.T)
        F, Q = A + E @ feedback, share * np.eye(n) + G.T @ (G + J @ feedback)
        H = np.block([[F, E @ through], [-Q, -F.T]])
        _, stable, real, imag, U, _, info = dgees(lambda real, _: real < 0.0, H, sort_t=1)
        if info or stable != n or np.any(np.abs(real) <= _ON_AXIS * np.abs(imag)):
            return None
        P = np.linalg.solve(U[:n, :n].T, U[n:, :n].T)
        P = _solution(F + E @ through @ P, Q - P.T @ E @ through @ P)  # a step of Newton's method
        half = np.vstack([P @ whole[:n], whole[n:]])
        np.linalg.cholesky(-(half + half.T))  # not where eigenvalues of H are on the axis
    except np.linalg.LinAlgError:
        return None
    return P


def _unsorted(*_: float) -> None:
    """Eigenvalues of Schur's form stay as they come."""


def _is_positive(
    subbox: _Subbox, modes: Array, P: Array, most: int = 1, slack: float = 0.0
) -> tuple[bool, int]:
    """Whether d > 0 and S > 0 on a part are proved, with a share of the diagonal of S to spare.

    Also the number of pieces of S that were looked at, which is at most `most`.

    With W near to the inverse of T, the modes, P stands for W'P W, and T'S T is the sum of -E'P (W N T)
    and its transpose, E = W T. Each product of k terms is off by at most k EPS of that of sizes.
    Modes are scaled, by powers of two, until the diagonal of P is near to 1. Inputs and outputs of a gain
    stay as they are, so W and T have an exact I for them.
    """
    n, states, q = subbox.rows, subbox.states, len(subbox.center)
    shape, rounding = subbox.values.shape[:q], subbox.steps * EPS
    if not np.all(subbox.values[..., -1] > 2.0 * rounding * subbox.sizes[..., -1]):
        return False, 0
    energies = np.mean(np.abs(np.diagonal(P, axis1=-2, axis2=-1)), axis=tuple(range(q)))
    scale = 2.0 ** np.round(0.5 * np.log2(np.maximum(energies, 1e-300)))
    P, modes = P / np.outer(scale, scale), modes / scale[:states]
    W, modes = (_beside(subbox, np.asarray(each), 1.0) for each in (np.linalg.inv(modes), modes))
    N = W @ subbox.values[..., :-1].reshape(*shape, n, n) @ modes
    largest = np.outer(np.sum(np.abs(W), axis=0), np.sum(np.abs(modes), axis=1))
    errors = subbox.sizes[..., :-1] @ largest.ravel()
    near = W @ modes - np.eye(n)
    identity = float(np.linalg.norm(np.abs(near) + 2.0 * n * EPS * (np.abs(W) @ np.abs(modes))))
    share = rounding + (6.0 * n + 2.0 * prod(P.shape[:q]) + 40.0) * EPS
    at_corners = bernstein.corners(P) @ bernstein.corners(N)
    if not bernstein.are_positive(-(at_corners + at_corners.mT)):
        return False, 0
    half = bernstein.product(P, N)
    S = -(half + half.mT)
    norms = [np.linalg.norm(each, axis=(-2, -1))[..., None, None] for each in (P, N)]
    sizes, products = (
        bernstein.product(norms[0], each)[..., 0, 0] for each in (errors[..., None, None], norms[1])
    )
    off = share * sizes
    trace = np.trace(S, axis1=-2, axis2=-1)
    less = 2.0 * (off + identity * (products + off)) + bernstein.factor_rounding(n) * np.abs(trace)
    S = S - (less * _UP)[..., None, None] * np.eye(n)
    S[..., range(n), range(n)] *= 1.0 - slack
    return bernstein.pieces_positive(S, most) if np.all(np.isfinite(S)) else (False, 0)


def _largest_change(subbox: _Subbox) -> int:
    """The delta along which d and N change most."""
    q = len(subbox.center)
    largest = np.max(subbox.sizes, axis=tuple(range(q)))
    rows = subbox.values / np.where(largest > 0.0, largest, 1.0)
    return int(np.argmax([np.max(np.abs(np.diff(rows, axis=k)), initial=0.0) for k in range(q)]))
