"""The linear model of a scene with 50 digits, and how much rounding of its data alone changes it.

The equations are those of `benchmarks/cases/lagrangian.py`; every instruction of their CasADi function is
run with mpmath. All numbers of the scene are arguments, so their condition can be measured.
"""

import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import mpmath as mp
import numpy as np

import mbdlft
from benchmarks.cases.lagrangian import NAMES, Energy, derivatives
from mbdlft.base.expression import evaluate, parse

Row = list[Any]
Matrix = list[Row]
DIGITS = 50
DRAWS = 12
_MANY = 50  # coordinates: one draw, as each takes a minute
_NOTHING = 1e-30
_STEP = 80  # bits: relative change of the data, far below their own rounding, far above 50 digits


class Motion(NamedTuple):
    """M a + D v + K q = u with 50 digits, each (n, n)."""

    M: Matrix
    D: Matrix
    K: Matrix


class Truth(NamedTuple):
    """[A B] (2 n, 3 n) rounded from 50 digits, and the size of what rounding may do to each entry.

    `size` times eps is what relative changes of eps of all data do, plus the error of a backward
    stable solution with the mass matrix: |M^-1| |M| |X| (Skeel 1979).
    """

    values: np.ndarray
    size: np.ndarray

    def of_inputs(self, count: int) -> "Truth":
        """With the first inputs only: elastic coordinates have none."""
        columns = len(self.values) + count
        return Truth(self.values[:, :columns], self.size[:, :columns])

    @property
    def condition(self) -> float:
        """Largest size of an entry relative to its value."""
        used = self.values != 0.0
        return float(np.max(self.size[used] / np.abs(self.values[used])))

    def factor(self, found: np.ndarray) -> float:
        """Largest error of [A B] in units of eps times size; inf where an entry must be exact."""
        error, size = np.abs(found - self.values), self.size * np.finfo(float).eps
        assert np.all(np.isfinite(error))
        safe = np.where(size > 0.0, size, 1.0)
        return float(np.max(np.where(error > 0.0, np.where(size > 0.0, error / safe, np.inf), 0.0)))

    def error(self, found: np.ndarray) -> float:
        """Largest error of an entry relative to its value; zeros relative to their columns."""
        column = np.max(np.abs(self.values), axis=0, keepdims=True)
        scale = np.where(self.values != 0.0, np.abs(self.values), np.where(column > 0, column, 1.0))
        return float(np.max(np.abs(found - self.values) / scale))


def truth(motion: Callable[[Sequence[Any]], Motion], data: Sequence[Any]) -> Truth:
    """The model of `motion` at its data, and its condition by random changes of them."""
    with mp.workdps(DIGITS):
        exact = motion(data)
        X, skeel = solution(exact)
        change = np.zeros(np.shape(X))
        signs = random.Random(0)
        step = mp.mpf(2) ** -_STEP
        for _ in range(DRAWS if len(exact.M) < _MANY else 1):
            moved = [value * (1 + signs.choice((-1, 1)) * step) for value in data]
            other, _ = solution(motion(moved))
            change = np.maximum(change, np.abs(to_float((other - X) / step)))
        size = change + to_float(skeel)
        # what is left of terms that cancel for all values of the data is rounding of 50 digits
        values = np.where(np.abs(to_float(X)) > _NOTHING * size, to_float(X), 0.0)
    return Truth(values, size)


def solution(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """[A B] of [q ; v], and |M^-1| |M| |X|; arrays of mpf."""
    M, D, K = (np.array(part, dtype=object) for part in motion)
    n = len(M)
    zero, eye = (
        np.array([[mp.mpf(int(k and i == j)) for j in range(n)] for i in range(n)], dtype=object)
        for k in (0, 1)
    )
    solved = eliminate(M, np.hstack([-K, -D, eye]))
    skeel = np.abs(solved[:, 2 * n :]) @ (np.abs(M) @ np.abs(solved))
    top = np.hstack([zero, eye, zero])
    return np.vstack([top, solved]), np.vstack([top * 0, skeel])


def eliminate(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """matrix^-1 right by Gauss with pivots, on arrays of mpf."""
    a, n = np.hstack([matrix, right]), len(matrix)
    for k in range(n):
        pivot = k + int(np.argmax([abs(value) for value in a[k:, k]]))
        a[[k, pivot]] = a[[pivot, k]]
        a[k] = a[k] / a[k, k]
        for row in range(n):
            if row != k and a[row, k] != 0:
                a[row] = a[row] - a[row, k] * a[k]
    return np.asarray(a[:, n:])


def to_float(values: np.ndarray) -> np.ndarray:
    """mpf rounded to double precision."""
    return np.array(values, dtype=float)


# scenes ---------------------------------------------------------------------------------------


class _Data(Energy):
    """The energies with all numbers of the scene as symbols."""

    numbers: list[float]
    symbols: list[ca.SX]

    def value(self, source: float | str) -> ca.SX:
        if isinstance(source, str):
            return ca.SX(evaluate(parse(source), self.values))
        if source == 0.0:
            return ca.SX(0)
        self.numbers.append(float(source))
        self.symbols.append(ca.SX.sym("data"))
        return self.symbols[-1]


def scene_truth(scene: mbdlft.Scene, values: Mapping[str, float]) -> Truth:
    """The truth of a tree of revolute and prismatic joints at physical values in their units."""
    names = [p.name for p in scene.parameters]
    symbols = {name: ca.SX.sym(name) for name in ("pi", "deg", *names)}
    units = {"deg": symbols["deg"]}
    inner = symbols | {p.name: symbols[p.name] * units.get(p.unit, 1) for p in scene.parameters}
    moving = tuple(joint for joint in scene.joints if joint.kind in NAMES)
    q, qdot = ca.SX.sym("q", len(moving)), ca.SX.sym("qdot", len(moving))
    _Data.numbers, _Data.symbols = [], []
    energy = _Data(scene, inner, moving, q, qdot)
    damping = ca.diag(ca.vertcat(*(energy.value(joint.damping) for joint in moving)))
    _, K = derivatives(energy.potential, q)
    _, M = derivatives(energy.kinetic, qdot)
    known = ca.vertcat(*(symbols[name] for name in names), *_Data.symbols)
    constants = ca.vertcat(symbols["pi"], symbols["deg"])
    tape = ca.Function(
        "motion", [q, qdot, constants, known], [ca.densify(part) for part in (M, damping, K)]
    )

    def motion(data: Sequence[Any]) -> Motion:
        rest = [mp.mpf(0)] * len(moving)
        return Motion(*run(tape, [rest, rest, [mp.pi, mp.pi / 180], list(data)]))

    with mp.workdps(DIGITS):
        data = [mp.mpf(float(values[name])) for name in names]
        data += [mp.mpf(number) for number in _Data.numbers]
    return truth(motion, data)


def run(tape: ca.Function, arguments: Sequence[Sequence[Any]]) -> list[Matrix]:
    """Values of a function of dense columns, instruction by instruction, with mpmath."""
    work: list[Any] = [mp.mpf(0)] * tape.sz_w()
    found = [[mp.mpf(0)] * tape.numel_out(k) for k in range(tape.n_out())]
    for k in range(tape.n_instructions()):
        operation = tape.instruction_id(k)
        sources, targets = tape.instruction_input(k), tape.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[targets[0]] = arguments[sources[0]][sources[1]]
        elif operation == ca.OP_CONST:
            work[targets[0]] = mp.mpf(tape.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            found[targets[0]][targets[1]] = work[sources[0]]
        else:
            work[targets[0]] = _OPERATIONS[operation](*(work[source] for source in sources))
    shapes = [tape.size_out(k) for k in range(tape.n_out())]
    return [
        [[entries[i + j * rows] for j in range(columns)] for i in range(rows)]
        for entries, (rows, columns) in zip(found, shapes, strict=True)
    ]


_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_NEG: lambda a: -a,
    ca.OP_TWICE: lambda a: 2 * a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_INV: lambda a: 1 / a,
    ca.OP_COS: mp.cos,
    ca.OP_SIN: mp.sin,
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
}
