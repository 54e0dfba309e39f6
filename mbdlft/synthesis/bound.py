"""What no controller can pass: the H-infinity norm that one of full order reaches, by two Riccati LMIs.

With N_R and N_S whose columns span the kernels of [B_2' D_12'] and [C_2 D_21], a controller with a norm
below gamma exists if and only if symmetric R and S exist with (Gahinet, Apkarian, International Journal
of Robust and Nonlinear Control 4, 1994)

    (N_R + I)' [ A R + R A'  R C_1'  B_1 ; C_1 R  -gamma I  D_11 ; B_1'  D_11'  -gamma I ] (N_R + I) < 0,
    (N_S + I)' [ A'S + S A   S B_1   C_1'; B_1'S  -gamma I  D_11'; C_1   D_11   -gamma I ] (N_S + I) < 0,
    [ R I ; I S ] >= 0,

where + stands for the block diagonal. The least gamma is a semidefinite program; its dual value is below
that of every controller with the same measurements, also of a fixed structure.
"""

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from mbdlft.base.array import Array
from mbdlft.robust.moving.variation import conic_solution, vectors
from mbdlft.synthesis.goals import Goal
from mbdlft.synthesis.loop import Network, family, weighted

_SURE = 0.99  # of the dual value, which a solver knows to some digits: it is computed, not proved
_NOTHING = 1e-6  # a solver does not tell smaller values from zero, which is a bound, too
_SOLVED = ("Solved", "AlmostSolved")  # a value of any other status may be far above
_MOST_STATES = 30  # beyond it the program takes minutes


def full_order_bound(opened: Network, goal: Goal) -> float:
    """A lower bound of the value of a norm at the nominal point; 0 for many states.

    In `opened`, controllers are matrices from all measurements to all actuators.
    """
    P = weighted(opened, [goal])
    if len(P.states) > _MOST_STATES:
        return 0.0
    parts = family(opened, P, np.zeros((1, len(P.parameters))))
    n = parts.states
    X, L, R = parts.X[0], parts.L[0], parts.R[0]
    nz, nw = len(X) - n, X.shape[1] - n
    A, B1, C1, D11 = (X[:n, :n], X[:n, n:], X[n:, :n], X[n:, n:])
    NR = _with_identity(linalg.null_space(L.T), nw)
    NS = _with_identity(linalg.null_space(R), nz)
    triangle = [(i, j) for i in range(n) for j in range(i, n)]
    columns: list[list[Array]] = []
    for side in range(2):
        for i, j in triangle:
            E = np.zeros((n, n))
            E[i, j] = E[j, i] = 1.0
            blocks = [np.zeros((NR.shape[1],) * 2), np.zeros((NS.shape[1],) * 2)]
            M = A @ E + E @ A.T if side == 0 else A.T @ E + E @ A
            V = E @ C1.T if side == 0 else E @ B1
            N, other = (NR, nw) if side == 0 else (NS, nz)
            whole = np.block([[M, V], [V.T, np.zeros((V.shape[1],) * 2)]])
            blocks[side] = N.T @ linalg.block_diag(whole, np.zeros((other, other))) @ N
            both = np.zeros((2 * n, 2 * n))
            both[side * n : side * n + n, side * n : side * n + n] = E
            columns.append([*blocks, -both])
    unit = [-N.T @ linalg.block_diag(np.zeros((n, n)), np.eye(nz + nw)) @ N for N in (NR, NS)]
    columns.append([*unit, np.zeros((2 * n, 2 * n))])
    first = []
    for N, W, D in ((NR, B1, D11), (NS, C1.T, D11.T)):
        corner = np.vstack([W, D])
        first.append(
            N.T
            @ np.block([[np.zeros((len(corner),) * 2), corner], [corner.T, np.zeros((W.shape[1],) * 2)]])
            @ N
        )
    coupling = np.block([[np.zeros((n, n)), np.eye(n)], [np.eye(n), np.zeros((n, n))]])
    return _SURE * _least(columns, [*first, -coupling]) / goal.limit


def _with_identity(kernel: Array, size: int) -> Array:
    return np.asarray(linalg.block_diag(kernel, np.eye(size)))


def _least(columns: Sequence[Sequence[Array]], first: Sequence[Array]) -> float:
    """The dual value of the least last unknown with first + sum of unknowns times columns <= 0."""
    import clarabel  # here because it is slow to import

    rows = np.column_stack([np.concatenate([vectors(M[None])[0] for M in column]) for column in columns])
    b = -np.concatenate([vectors(M[None])[0] for M in first])
    cones = [clarabel.PSDTriangleConeT(len(M)) for M in first if len(M)]
    cost = np.zeros(rows.shape[1])
    cost[-1] = 1.0
    solution = conic_solution(cost, rows, b, cones)
    if str(solution.status) not in _SOLVED:  # such as where R or S has to grow without end
        return 0.0
    # what misses the dual equations counts with the unknowns: R and S grow where no least is reached
    missed = np.abs(rows.T @ np.array(solution.z) + cost) @ np.abs(np.array(solution.x))
    value = float(solution.obj_val_dual) - float(missed)
    return value if np.isfinite(value) and value > _NOTHING else 0.0
