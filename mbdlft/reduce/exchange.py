"""Better bases by exchanges, the pivots of linear algebra, scored on lines.

An opened block of size d has [A B ; C D] with rows (z, y) and columns (w, u). An exchange replaces one
basis vector by a column of [A B] (or, transposed, one coordinate by a row of [A ; C]). The score of a
basis is the sum of the degrees in all other deltas. Degrees are ranks of matrices of generic directions
(see `lines`), so only products with these are formed: a basis is scored in the time of a few small
products, whatever the number of signals.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.reduce.basis import Exchange
from mbdlft.reduce.lines import Lines, Values, directions, equilibrate, rank

_VANISHES = 1e-8  # of the size of its terms: a pivot below is zero
_SMALL = 1e-6  # of the largest pivot on a line
_NOMINAL = 1e-3  # of the median over the box: a smaller pivot at delta = 0 is not divided by
_MOST_STEPS = 6

Basis = dict[str, tuple[NDArray[Any], NDArray[Any]]]  # T^-1 and T at the points of each line
_BOX = ""  # the name of the box among the lines; no delta has it


class _Line(NamedTuple):
    """What the score needs of [A B ; C D] on one line: l for left points, r for right ones, and
    generic directions on the outer sides."""

    A: NDArray[Any]
    B: NDArray[Any]
    C: NDArray[Any]
    inputs_l: NDArray[Any]
    outputs_l: NDArray[Any]
    direct_l: NDArray[Any]
    inputs_r: NDArray[Any]
    outputs_r: NDArray[Any]
    direct_r: NDArray[Any]
    distances: NDArray[Any]


def search_exchanges(
    values: Values, d: int, lines: Lines, score: int, floor: int, trials: int, seed: int
) -> tuple[int, tuple[Exchange, ...]]:
    """The lowest score that is found, and the exchanges that lead to it.

    Parameters
    ----------
    values : Values
        Of an opened LFT with a block of size d.
    score, floor : int
        Sum of the degrees now, and where to stop.
    trials : int
        Bases that may be scored.
    """
    random = np.random.default_rng(seed)
    data = {name: _line(item, d, lines.circles[name]) for name, item in values.circles.items()}
    eye = np.eye(d, dtype=complex)
    basis: Basis = {
        name: (np.broadcast_to(eye, item.A.shape), np.broadcast_to(eye, item.A.shape))
        for name, item in data.items()
    }
    box = values.box
    data[_BOX] = data[next(iter(data))]._replace(
        A=box[:, :d, :d], B=box[:, :d, d:], C=box[:, d:, :d]
    )
    basis[_BOX] = (np.broadcast_to(np.eye(d), data[_BOX].A.shape),) * 2
    rows, columns = box.shape[1], box.shape[2]
    moves = list(_moves(d, rows, columns))
    done: tuple[Exchange, ...] = ()
    while score > floor and trials > 0 and len(done) < _MOST_STEPS:
        best: tuple[Exchange, Basis] | None = None
        for k in random.permutation(len(moves)):
            if trials <= 0 or score <= floor:
                break
            changed = _exchanged(data, basis, moves[k])
            if changed is None:
                continue
            trials -= 1
            found = _score(data, changed, score)
            if floor <= found < score:
                score, best = found, (moves[k], changed)
        if best is None:
            break
        done, basis = (*done, best[0]), best[1]
    return score, done


def _line(values: NDArray[Any], d: int, circle: NDArray[Any]) -> _Line:
    count = len(circle) // 2
    A, B, C, D = values[:, :d, :d], values[:, :d, d:], values[:, d:, :d], values[:, d:, d:]
    rows, columns = equilibrate(values)
    left = (directions(0, len(rows) - d, count) * rows[d:, None]).T
    right = directions(1, len(columns) - d, count) * columns[d:, None]
    ls, rs = slice(0, None, 2), slice(1, None, 2)
    return _Line(
        A=A,
        B=B,
        C=C,
        inputs_l=B[ls] @ right,
        outputs_l=(left[:, None, :] @ C[ls]),
        direct_l=(left[:, None, :] @ D[ls])[:, 0] @ right,
        inputs_r=B[rs] @ right.T[:, :, None],
        outputs_r=left @ C[rs],
        direct_r=(left @ (D[rs] @ right.T[:, :, None]))[:, :, 0].T,
        distances=circle[ls, None] - circle[rs],
    )


def _score(data: dict[str, _Line], basis: Basis, most: int) -> int:
    """Sum of the degrees, or `most` as soon as it is reached."""
    total = 0
    for name, line in data.items():
        if name == _BOX:
            continue
        S, T = basis[name]
        d, count = S.shape[1], len(S) // 2
        left, right = directions(2, d, count).T, directions(3, d, count)
        TR = T[::2] @ right
        head = left[:, None, :] @ S[::2]
        one = (head @ (line.A[::2] @ TR + line.inputs_l) + line.outputs_l @ TR)[:, 0]
        tr = T[1::2] @ right.T[:, :, None]
        tail = (left @ S[1::2]) @ (line.A[1::2] @ tr + line.inputs_r) + line.outputs_r @ tr
        difference = one + line.direct_l - tail[:, :, 0].T - line.direct_r
        total += rank(difference / line.distances)
        if total >= most:
            return most
    return total


def _exchanged(data: dict[str, _Line], basis: Basis, move: Exchange) -> Basis | None:
    """The basis after an exchange; None if the pivot vanishes on a line or at delta = 0."""
    changed: Basis = {}
    i, c = move.position, move.signal
    for name, line in data.items():
        S, T = basis[name]
        if move.transposed:
            source, S, T = _row(line, S, c), T.transpose(0, 2, 1), S.transpose(0, 2, 1)
        else:
            source = _column(line, T, c)
        vector = S @ source[:, :, None]
        pivot, size = vector[:, i, 0], np.max(np.abs(S) @ np.abs(source)[:, :, None])
        lengths = np.abs(pivot)
        if not (np.max(lengths) > _VANISHES * size and np.min(lengths) > 0.0):
            return None
        if name == _BOX and lengths[0] < _NOMINAL * np.median(lengths):
            return None
        if name != _BOX and np.min(lengths) < _SMALL * np.max(lengths):
            return None
        new_column = T @ vector
        row = S[:, [i], :] / pivot[:, None, None]
        vector[:, i] = 0.0
        S = S - vector * row
        S[:, i], T = row[:, 0], T.copy()
        T[:, :, i] = new_column[:, :, 0]
        changed[name] = (T.transpose(0, 2, 1), S.transpose(0, 2, 1)) if move.transposed else (S, T)
    return changed


def _column(line: _Line, T: NDArray[Any], c: int) -> NDArray[Any]:
    """Column c of [A T, B] at each point."""
    d = T.shape[2]
    return np.asarray((line.A @ T[:, :, [c]])[:, :, 0] if c < d else line.B[:, :, c - d])


def _row(line: _Line, S: NDArray[Any], c: int) -> NDArray[Any]:
    """Row c of [T^-1 A ; C] at each point."""
    d = S.shape[1]
    return np.asarray((S[:, [c], :] @ line.A)[:, 0] if c < d else line.C[:, c - d, :])


def _moves(d: int, rows: int, columns: int) -> Iterator[Exchange]:
    """Every exchange of a block of size d in an opened LFT of this shape."""
    for transposed, signals in ((False, columns), (True, rows)):
        for signal in range(signals):
            for index in range(d):
                yield Exchange(index, signal, transposed)
