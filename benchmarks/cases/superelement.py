"""The superelement of a beam as a matrix that is rational in the length, in exact fractions."""

import flint
import numpy as np

import mbdlft
from benchmarks.cases.beams import superelement
from benchmarks.cases.flexible import VARIED


def superelement_matrix(*, lift: bool) -> mbdlft.MatrixProblem:
    """[A B ; C D] of the superelement with unit stiffness and density, in exact fractions of L."""

    def fractions(matrix: np.ndarray) -> flint.fmpq_mat:
        rows = [[flint.fmpq(round(x)) for x in row] for row in matrix]
        return flint.fmpq_mat(rows)

    unit = superelement(1.0, 70.0, 55440.0)
    M, K = fractions(unit.M), fractions(unit.K)
    root = [0, 1] if lift else [1]
    free = [2, 3, 4, 5]

    def part(matrix: flint.fmpq_mat, rows: list[int], columns: list[int]) -> flint.fmpq_mat:
        return flint.fmpq_mat([[matrix[i, j] for j in columns] for i in rows])

    mass, stiff = flint.fmpq(1, 55440), flint.fmpq(1, 70)
    inverse = (mass * part(M, free, free)).inv()
    tip = flint.fmpq_mat([[0], [1], [0], [0]])
    own = inverse * (-stiff * part(K, free, free))  # / L^4
    by_root = inverse * (-mass * part(M, free, root))  # scaled unknowns: slopes are L times slopes
    by_force = inverse * tip
    back = mass * part(M, root, free)
    held = stiff * part(K, root, free)
    # powers of L: of unknowns 0; of root rotations 1; of forces -1 (density L); of torques 1 + ...
    powers = [0, 1] if lift else [1]
    rows: list[list[str]] = []
    n = 4

    def text(value: object, power: int) -> str:
        return "0" if value == 0 else f"({value})*L^({power})" if power else f"({value})"

    for i in range(n):
        rows.append(["0"] * n + [str(int(i == j)) for j in range(n)] + ["0"] * (len(root) + 1))
    for i in range(n):
        rows.append(
            [text(own[i, j], -4) for j in range(n)]
            + ["0"] * n
            + [text(by_root[i, j], powers[j]) for j in range(len(root))]
            + [text(by_force[i, 0], -1)]
        )
    rows.append(list(rows[n + 1]))  # acceleration of the tip
    reaction, feed = back * own + held, back * by_root + mass * part(M, root, root)
    pushed = back * by_force
    for i, power in enumerate(powers):
        rows.append(
            [text(reaction[i, j], power - 3) for j in range(n)]
            + ["0"] * n
            + [text(feed[i, j], power + 1 + powers[j]) for j in range(len(root))]
            + [text(pushed[i, 0] - (1 if root[i] == 0 else 0), power)]
        )
    names = tuple(f"x{k}" for k in range(2 * n))
    return mbdlft.matrix_problem(rows, [VARIED], states=names)
