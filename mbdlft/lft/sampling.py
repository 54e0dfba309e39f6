"""Values of an LFT at one or many samples of its deltas: by dense matrices, or by a program.

Few values are solved for with dense matrices. For many a straight-line program is made of the LFT, which
does without the zeros (`mbdlft/lft/program/elimination.py`). Its pivots are on the diagonal, so samples
at which one of them has lost digits are solved for with dense matrices, and all samples are if some of
them differ. A `ModelProgram` is a program that is known beside the LFT, such as that of the equations of
a scene: it is shorter where the LFT is nearly full, and a function of the physical values.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError, WellPosednessError
from mbdlft.lft.block import block_value
from mbdlft.lft.lft import LFT, check, check_name
from mbdlft.lft.program import native
from mbdlft.lft.program.elimination import program
from mbdlft.lft.program.tape import Plan, Program, compact, plan, run
from mbdlft.lft.sparse import SparseLFT, regular_values
from mbdlft.lft.sparse import sizes as sizes_of_sparse

DENSE, OWN, KNOWN = "dense matrices", "program of the LFT", "stored program"
SPARSE = "sparse equations"
MANY = 1024  # samples from which on a program is worth making
NATIVE = 400_000  # samples from which on compiling the program takes less than it saves
KNOWN_NATIVE = 100_000  # the same for a program that is known
LONGEST = 200_000  # instructions of a program that is known: more take minutes to compile
_LONGEST = 20_000  # instructions of another one; making it takes microseconds for each
_MUCH = 4  # times as many columns as rows are worth the digits that the left side may lose
CHUNK, CHUNK_ENTRIES = 512, 2**22  # samples and matrix entries that are held at once
_PROBES = 32  # samples at which a program is compared with the dense definition
_DIFFERENT = 1e-9  # of a row and column: what rounding of equations and of an LFT may differ by
_ROUNDING = 64.0 * float(np.finfo(float).eps)  # times the order: what the two may differ by


@dataclass(frozen=True, slots=True, eq=False)
class ModelProgram:
    """The values of the LFTs of a model from its physical values.

    Its inputs are the parameters, in their units. Its entries have the places (0, k) in `row`: the values
    of `lft` and then of `trim`, 0 for what depends on parameters. It is used for these two LFTs only:
    what is made of them has no program.
    """

    program: Program
    row: Array
    lft: LFT
    trim: LFT | None = None

    @property
    def length(self) -> int:
        """Number of instructions."""
        return len(self.program.instructions)

    def is_of(self, lft: LFT, trim: LFT | None) -> bool:
        """Whether it is the program of these LFTs."""
        return self.lft is lft and self.trim is trim


def evaluate(a: LFT, deltas: Mapping[str, ArrayLike]) -> Array:
    """Values at deltas given by name, numbers or arrays of one length N; the others are 0.

    A value of a full block is a matrix (outputs, inputs) or (N, outputs, inputs). The result is
    (n_out, n_in), or (N, n_out, n_in) if any delta is an array, and complex where a block or an entry is.
    Unknown names and lengths that differ are a StructureError, a singular I - M11 Delta is a
    WellPosednessError.
    """
    for name in deltas:
        check_name(a, name)
    known = {block.name: block for block in a.blocks}
    deltas = {name: block_value(known[name], value) for name, value in deltas.items()}
    if any(block.kind != "real" for block in a.blocks):
        return _of_all_kinds(a, deltas)
    try:
        columns = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in deltas.values()))
    except ValueError:
        raise StructureError("evaluate: the arrays of deltas have different lengths.") from None
    single = not columns or columns[0].ndim == 0
    if not single and columns[0].ndim != 1:
        raise StructureError(
            f"evaluate: deltas are numbers or arrays of one axis, got shape {columns[0].shape}."
        )
    count = 1 if single else len(columns[0])
    points = np.zeros((count, len(a.blocks)))
    index = {block.name: k for k, block in enumerate(a.blocks)}
    for name, column in zip(deltas, columns, strict=True):
        points[:, index[name]] = column
    values = evaluate_at(a, points)
    return values[0] if single else values


def evaluate_at(a: LFT, points: ArrayLike) -> Array:
    """Values at many points: points (N, number of blocks) [1], result (N, n_out, n_in)."""
    check(
        {block.kind for block in a.blocks} <= {"real"},
        "points have one real number for each block; use evaluate for blocks of other kinds",
    )
    p = np.asarray(points, dtype=float)
    check(
        p.ndim == 2 and p.shape[1] == len(a.blocks),
        f"points need shape (N, {len(a.blocks)}), got {p.shape}",
    )
    if isinstance(a, SparseLFT):
        return regular_values(a, p)
    values = np.repeat(a.M22[None], len(p), axis=0)
    if a.is_complex:
        values = values.astype(complex)
    planned = _plan(a) if len(p) >= MANY and not a.is_complex else None
    if planned is None:
        _add_dense(a, p, values)
        return values
    compiled = _native(a) if len(p) >= NATIVE and native.is_available() else None
    if compiled is None:
        lost = run(planned[1], p, values)
    else:  # bit for bit the same: there are no cosines
        lost = native.run_natively(compiled, p, a.M22.ravel(), values.reshape(len(p), -1))
    if not agrees(a, p, values, lost, 0.0):
        lost[:] = True
    _again(a, p, values, lost)
    return values


def evaluate_known(
    a: LFT,
    points: Array,
    known: ModelProgram,
    physical: Array,
    check_lost: Callable[[Array], None] | None = None,
) -> Array | None:
    """Values by a program that is known beside the LFT; None if the LFT's own way is shorter.

    `physical` (N, n_p) are the points (N, number of blocks) in the units of the parameters. Samples at
    which a pivot has lost digits, for whose points `check_lost` is called, are those of dense matrices.
    None, too, if some of the values do not agree with dense matrices.
    """
    if way(a, len(points), known) != KNOWN:
        return None
    values, lost = values_by(known, a, physical)
    if not agrees(a, points, values, lost):
        return None
    if check_lost is not None and np.any(lost):
        check_lost(points[lost])
    _again(a, points, values, lost)
    return values


def way(a: LFT, count: int, known: ModelProgram | None = None) -> str:
    """How so many values are computed: by `DENSE` matrices, the `OWN` program, or a `KNOWN` one."""
    if isinstance(a, SparseLFT):
        return SPARSE
    if count < MANY or a.is_complex or any(block.kind != "real" for block in a.blocks):
        return DENSE
    planned = _plan(a)
    if known is not None and (planned is None or known.length < len(planned[0].instructions)):
        return KNOWN
    return DENSE if planned is None else OWN


def _again(a: LFT, points: Array, values: Array, lost: NDArray[np.bool_]) -> None:
    """Put the values of dense matrices where digits were lost."""
    if np.any(lost):
        again = np.repeat(a.M22[None], int(np.sum(lost)), axis=0)
        _add_dense(a, points[lost], again)
        values[lost] = again


def _of_all_kinds(a: LFT, deltas: Mapping[str, Any]) -> Array:
    """The definition with matrices Delta, the blocks that are not named at zero."""
    known = {block.name: block for block in a.blocks}
    shapes = {n: v.shape[:-2] if known[n].kind == "full" else v.shape for n, v in deltas.items()}
    lengths = {shape[0] for shape in shapes.values() if shape}
    check(
        len(lengths) < 2 and all(len(shape) < 2 for shape in shapes.values()),
        "evaluate: deltas are numbers, matrices for full blocks, or arrays of one length of them",
    )
    z, w = a.slices(), a.columns()
    Delta = np.zeros((max(lengths, default=1), a.M11.shape[1], a.order), dtype=complex)
    for name, value in deltas.items():
        full = known[name].kind == "full"
        Delta[:, w[name], z[name]] = value if full else value[..., None, None] * np.eye(known[name].size)
    try:
        inner = np.linalg.solve(np.eye(a.order) - a.M11 @ Delta, np.tile(a.M12, (len(Delta), 1, 1)))
    except np.linalg.LinAlgError:
        raise WellPosednessError("I - M11 Delta is singular at one of the points.") from None
    values: Array = a.M22 + a.M21 @ Delta @ inner
    return values if lengths else values[0]


def values_and_sizes(a: LFT, points: Array) -> tuple[Array, Array]:
    """Values at points (N, number of blocks), and the sizes of their sums if nothing cancelled."""
    values = np.repeat(a.M22[None], len(points), axis=0)
    sizes = np.abs(values)
    _add_dense(a, points, values, sizes)
    return values, sizes


def rounding_sizes(a: LFT, points: Array) -> Array:
    """Sizes (N, n_out, n_in) that rounding of all numbers of an LFT is relative to, at points.

    With X = (I - M11 Delta)^-1 M12 and Y = M21 Delta (I - M11 Delta)^-1, a change dM changes the value by
    dM22 + dM21 Delta X + Y (dM11 Delta X + dM12). Sizes are those with |dM| = |M| where nothing cancels,
    and with I + |M11 Delta| for the loop, which is rounded, too.
    """
    if isinstance(a, SparseLFT):
        return sizes_of_sparse(a, points)
    sizes = np.repeat(np.abs(a.M22)[None], len(points), axis=0)
    sides = Sides(a)
    rows, columns = sides.rows[:, None], sides.columns
    first, last = a.M12[:, columns], a.M21[sides.rows]
    n = len(a.M11)
    if not (n and first.size and last.size):
        return sizes
    spread = np.repeat(points, [block.size for block in a.blocks], axis=1)
    for chunk in chunks(len(points), n):
        d = spread[chunk, None, :]
        through = a.M11 * d
        inverse = np.linalg.inv(np.eye(n) - through)
        into, out = np.abs(inverse @ first), np.abs((last * d) @ inverse)
        read = np.abs(first) + into + np.abs(through) @ into
        sizes[chunk, rows, columns] += np.abs(last * d) @ into + out @ read
    return sizes


@lru_cache(maxsize=4)
def _native(a: LFT) -> native.NativeProgram | None:
    """The program as native code, with the places of the entries in a row; nothing if LLVM fails."""
    planned = _plan(a)
    assert planned is not None
    width = a.shape[1]
    entries = tuple(((0, i * width + j), register) for (i, j), register in planned[0].entries)
    return _compiled(replace(planned[0], entries=entries), a.M22.size)


def _compiled(program: Program, size: int) -> native.NativeProgram | None:
    """Native code for rows of a size; nothing if LLVM fails."""
    try:
        return native.compile_native(program, size, native.user_cache())
    except (RuntimeError, OSError):
        return None


@lru_cache(maxsize=16)
def _plan(a: LFT) -> tuple[Program, Plan] | None:
    """The program of an LFT, and for vectors, or nothing if dense matrices are faster."""
    closed = program(a, min(_LONGEST, a.order**2 * (a.order + 12)))
    return None if closed is None else (closed, plan(closed))


def agrees(
    a: LFT, points: Array, values: Array, lost: NDArray[np.bool_], different: float = _DIFFERENT
) -> bool:
    """Whether some values that are not lost are the dense ones up to rounding and a `different` part."""
    probes = np.unique(np.linspace(0, len(points) - 1, _PROBES).astype(int))
    probes = probes[~lost[probes]]
    expected, sizes = values_and_sizes(a, points[probes])
    within = _ROUNDING * a.order * sizes
    if different:
        size = np.max(np.abs(expected), axis=0, initial=0.0)
        rows, columns = np.max(size, axis=1, initial=0.0), np.max(size, axis=0, initial=0.0)
        within = within + different * np.maximum(size, np.sqrt(np.outer(rows, columns)))
    return bool(np.all(np.abs(values[probes] - expected) <= within))


class Sides:
    """M21 Delta (I - M11 Delta)^-1 M12, without rows and columns that depend on no delta.

    It is solved for from the right: columns have digits of their own, whatever their sizes. Where that is
    much cheaper it is solved for from the left, transposed.
    """

    def __init__(self, a: LFT) -> None:
        self.rows, self.columns = (np.flatnonzero(a.M21.any(axis=1)), np.flatnonzero(a.M12.any(axis=0)))
        self.wide = _MUCH * len(self.rows) < len(self.columns)
        first, last = a.M12[:, self.columns], a.M21[self.rows]
        self.inner = a.M11.T if self.wide else a.M11
        self.first, self.last = (last.T, first.T) if self.wide else (first, last)

    def add(self, values: Array, changes: Array) -> None:
        """Add changes, transposed where they are solved for from the left, to values (N, n_out, n_in)."""
        changes = np.swapaxes(changes, 1, 2) if self.wide else changes
        values[:, self.rows[:, None], self.columns] += changes


def _add_dense(a: LFT, points: Array, values: Array, sizes: Array | None = None) -> None:
    """Add M21 Delta (I - M11 Delta)^-1 M12 to values (N, n_out, n_in), sizes of its terms to sizes."""
    sides = Sides(a)
    n = len(a.M11)
    if not (n and sides.first.size and sides.last.size):
        return
    spread = np.repeat(points, [block.size for block in a.blocks], axis=1)
    for chunk in chunks(len(points), n):
        d = spread[chunk]
        loop = np.eye(n) - sides.inner * d[:, None, :]
        try:
            solved = np.linalg.solve(loop, np.broadcast_to(sides.first, (len(d), *sides.first.shape)))
        except np.linalg.LinAlgError:
            raise WellPosednessError("I - M11 Delta is singular at one of the points.") from None
        outer = sides.last * d[:, None, :]
        sides.add(values[chunk], outer @ solved)
        if sizes is not None:
            sides.add(sizes[chunk], np.abs(outer) @ np.abs(solved))


def chunks(count: int, order: int) -> Iterator[slice]:
    """Slices of `count` samples whose order x order matrices fit into memory together."""
    size = max(1, min(CHUNK, CHUNK_ENTRIES // max(1, order * order)))
    for start in range(0, count, size):
        yield slice(start, start + size)


@lru_cache(maxsize=8)
def _piece(known: ModelProgram, first: int, size: int) -> tuple[Program, Plan]:
    """What a program does for the entries of one LFT."""
    entries = tuple(
        ((0, k - first), register)
        for (_, k), register in known.program.entries
        if first <= k < first + size
    )
    piece = compact(replace(known.program, entries=entries))
    return piece, plan(piece)


@lru_cache(maxsize=4)
def _native_piece(known: ModelProgram, first: int, size: int) -> native.NativeProgram | None:
    """The same as native code; nothing if LLVM fails."""
    return _compiled(_piece(known, first, size)[0], size)


def is_native(count: int) -> bool:
    """Whether so many samples are computed by native code."""
    return count >= KNOWN_NATIVE and native.is_available()


def values_by(known: ModelProgram, a: LFT, physical: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Values (N, n_out, n_in) of one of its LFTs at physical values (N, n_p); where digits are lost."""
    first, size = (0 if a is known.lft else known.lft.M22.size), a.M22.size
    row, count = known.row[first : first + size], len(physical)
    values = np.empty((count, size))
    compiled = _native_piece(known, first, size) if is_native(count) else None
    if compiled is not None:
        lost = native.run_natively(compiled, physical, row, values)
    else:
        values[:] = row
        lost = run(_piece(known, first, size)[1], physical, values[:, None, :])
    return values.reshape(count, *a.shape), lost
