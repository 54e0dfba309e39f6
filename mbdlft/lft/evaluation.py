"""Values of an LFT at one or many values of its deltas: by dense matrices, or by a program.

Few values are solved for with dense matrices. For many a straight-line program is made of the LFT, which
does without the zeros (`mbdlft/lft/program/elimination.py`). Its pivots are on the diagonal, so samples
at which one of them has lost digits are solved for with dense matrices, and all samples are if some of
them differ.

A `ModelProgram` is a program that is known beside the LFT, such as that of the equations of a scene: it
is shorter where the LFT is nearly full, and a function of the physical values. It belongs to two LFTs,
and is used for these only: what is made of them has none.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError, WellPosednessError
from mbdlft.lft.block import block_value
from mbdlft.lft.lft import LFT, check, check_name
from mbdlft.lft.program.elimination import program
from mbdlft.lft.program.native import NativeProgram, is_available, native, run_natively, user_cache
from mbdlft.lft.program.tape import Instruction, Plan, Program, needed, plan, run

MUCH = 4  # times as many columns as rows are worth the digits that the left side may lose
_CHUNK, _CHUNK_ENTRIES = 512, 2**22  # samples and matrix entries that are held at once
NATIVE = 400_000  # samples from which on compiling the program takes less than it saves
MANY = 1024  # samples from which on a program is worth making
_LONGEST = 20_000  # instructions; making a program takes microseconds for each
_PROBES = 32  # samples at which a program is compared with the dense definition
_DIFFERENT = (
    1e-9  # of a row and column: what equations and an LFT may differ by as they are rounded
)
DENSE, OWN, KNOWN = "dense matrices", "program of the LFT", "stored program"
_ROUNDING = 64.0 * float(np.finfo(float).eps)  # times the order: what the two may differ by


LONGEST = 200_000  # instructions: more take minutes to compile
KNOWN_NATIVE = 100_000  # samples from which on compiling it takes less than it saves


@dataclass(frozen=True, slots=True, eq=False)
class ModelProgram:
    """The values of the LFTs of a model from its physical values.

    Attributes
    ----------
    program : Program
        Its inputs are the parameters, in their units; its entries have the places (0, k) in `row`.
    row : array (size,)
        The value of `lft`, row by row, then that of `trim`; the entries that depend on parameters are 0.
    lft, trim : LFT, or None
        Whose values these are.
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

    Parameters
    ----------
    a : LFT, shape (n_out, n_in)
    deltas : mapping of names to numbers [1] or arrays (N,)
        Of a full block: matrices (outputs, inputs) or (N, outputs, inputs).

    Returns
    -------
    array (n_out, n_in), or (N, n_out, n_in) if any delta is an array
        Complex where a block or an entry is.

    Raises
    ------
    StructureError
        A name is unknown, or the lengths differ.
    WellPosednessError
        I - M11 Delta is singular at one of the points.
    """
    for name in deltas:
        check_name(a, name)
    known = {block.name: block for block in a.blocks}
    deltas = {name: block_value(known[name], value) for name, value in deltas.items()}
    if any(block.kind != "real" for block in a.blocks):
        return _of_all_kinds(a, deltas)
    try:
        columns = np.broadcast_arrays(
            *(np.asarray(value, dtype=float) for value in deltas.values())
        )
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
        all(block.kind == "real" for block in a.blocks),
        "points have one real number for each block; use evaluate for blocks of other kinds",
    )
    p = np.asarray(points, dtype=float)
    check(
        p.ndim == 2 and p.shape[1] == len(a.blocks),
        f"points need shape (N, {len(a.blocks)}), got {p.shape}",
    )
    values = np.repeat(a.M22[None], len(p), axis=0)
    if a.is_complex:
        values = values.astype(complex)
    found = _plan(a) if len(p) >= MANY and not a.is_complex else None
    if found is None:
        _dense(a, p, values)
        return values
    native_program = _native(a) if len(p) >= NATIVE and is_available() else None
    if native_program is None:
        lost = run(found[1], p, values)
    else:  # bit for bit the same
        lost = run_natively(native_program, p, a.M22.ravel(), values.reshape(len(p), -1))
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

    Parameters
    ----------
    a : LFT
        One of those that the program belongs to.
    points : array (N, number of blocks) [1]
    known : ModelProgram
    physical : array (N, n_p)
        The same points in the units of the parameters.
    check_lost : function, optional
        Called with the points (n, number of blocks) at which digits were lost.

    Returns
    -------
    array (N, n_out, n_in)
        Samples at which a pivot has lost digits are those of dense matrices. None, too, if samples of
        these do not agree with dense matrices.
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
    if count < MANY or a.is_complex or any(block.kind != "real" for block in a.blocks):
        return DENSE
    own = _plan(a)
    if known is not None and (own is None or known.length < len(own[0].instructions)):
        return KNOWN
    return DENSE if own is None else OWN


def _again(a: LFT, points: Array, values: Array, lost: NDArray[np.bool_]) -> None:
    """Put the values of dense matrices where digits were lost."""
    if np.any(lost):
        again = np.repeat(a.M22[None], int(np.sum(lost)), axis=0)
        _dense(a, points[lost], again)
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
        repeated = known[name].kind != "full"
        part = value[..., None, None] * np.eye(known[name].size) if repeated else value
        Delta[:, w[name], z[name]] = part
    try:
        inner = np.linalg.solve(np.eye(a.order) - a.M11 @ Delta, np.tile(a.M12, (len(Delta), 1, 1)))
    except np.linalg.LinAlgError:
        raise WellPosednessError("I - M11 Delta is singular at one of the points.") from None
    values: Array = a.M22 + a.M21 @ Delta @ inner
    return values if lengths else values[0]


def values_and_sizes(a: LFT, points: Array) -> tuple[Array, Array]:
    """Values at points (N, number of blocks), and the sizes of their sums if nothing cancelled."""
    values = np.repeat(a.M22[None], len(points), axis=0)
    return values, _dense(a, points, values, sized=True)


@lru_cache(maxsize=4)
def _native(a: LFT) -> NativeProgram | None:
    """The program as native code, with the places of the entries in a row; nothing if LLVM fails."""
    found = _plan(a)
    assert found is not None
    width = a.shape[1]
    entries = tuple(((0, i * width + j), register) for (i, j), register in found[0].entries)
    try:
        return native(replace(found[0], entries=entries), a.M22.size, user_cache())
    except (RuntimeError, OSError):
        return None


@lru_cache(maxsize=16)
def _plan(a: LFT) -> tuple[Program, Plan] | None:
    """The program of an LFT, and for vectors, or nothing if dense matrices are faster."""
    found = program(a, min(_LONGEST, a.order**2 * (a.order + 12)))
    return None if found is None else (found, plan(found))


def agrees(
    a: LFT, points: Array, values: Array, lost: NDArray[np.bool_], different: float = _DIFFERENT
) -> bool:
    """Whether values are the dense ones at some of the points that are not lost, up to rounding.

    Entries may be `different`, too, by this part of the largest of their row and column.
    """
    probes = np.unique(np.linspace(0, len(points) - 1, _PROBES).astype(int))
    probes = probes[~lost[probes]]
    expected, sizes = values_and_sizes(a, points[probes])
    within = _ROUNDING * a.order * sizes
    if different:
        size = np.max(np.abs(expected), axis=0, initial=0.0)
        rows, columns = np.max(size, axis=1, initial=0.0), np.max(size, axis=0, initial=0.0)
        within = within + different * np.maximum(size, np.sqrt(np.outer(rows, columns)))
    return bool(np.all(np.abs(values[probes] - expected) <= within))


def _dense(a: LFT, points: Array, values: Array, *, sized: bool = False) -> Array:
    """Add M21 Delta (I - M11 Delta)^-1 M12 to values (N, n_out, n_in).

    Returns
    -------
    array (N, n_out, n_in), empty unless `sized`
        Sizes of the sums if nothing cancelled: |M22| + |M21 Delta| |(I - M11 Delta)^-1 M12|.
    """
    # only the rows and columns that depend on delta are solved for, from the right: columns have
    # digits of their own, whatever their sizes; from the left where that is much cheaper
    rows, columns = np.flatnonzero(a.M21.any(axis=1)), np.flatnonzero(a.M12.any(axis=0))
    sizes = np.abs(values) if sized else np.zeros(0)
    if not (a.order and len(rows) and len(columns)):
        return sizes
    wide = MUCH * len(rows) < len(columns)
    inner, first = (a.M11.T, a.M21[rows].T) if wide else (a.M11, a.M12[:, columns])
    last = a.M12[:, columns].T if wide else a.M21[rows]
    spread = np.repeat(points, [block.size for block in a.blocks], axis=1)
    eye = np.eye(a.order)
    for chunk in chunks(len(points), a.order):
        d = spread[chunk]
        # (I - M11 Delta)^-1 M12 from the right, or its transpose from the left
        loop = eye - inner[None] * d[:, None, :]
        try:
            solved = np.linalg.solve(loop, np.broadcast_to(first, (len(d), *first.shape)))
        except np.linalg.LinAlgError:
            raise WellPosednessError("I - M11 Delta is singular at one of the points.") from None
        outer = last * d[:, None, :]
        change = outer @ solved
        part = values[chunk]
        part[:, rows[:, None], columns] += np.swapaxes(change, 1, 2) if wide else change
        if sized:
            terms = np.abs(outer) @ np.abs(solved)
            sizes[chunk][:, rows[:, None], columns] += np.swapaxes(terms, 1, 2) if wide else terms
    return sizes


def chunks(count: int, order: int) -> Iterator[slice]:
    """Slices of `count` samples whose order x order matrices fit into memory together."""
    size = max(1, min(_CHUNK, _CHUNK_ENTRIES // max(1, order * order)))
    for start in range(0, count, size):
        yield slice(start, start + size)


def compact(program: Program) -> Program:
    """The instructions that results depend on; that with number k writes the register inputs + k."""
    kept = needed(program)
    names = {one.target: program.inputs + k for k, one in enumerate(kept)}

    def named(operand: int | float) -> int | float:
        return names.get(operand, operand) if isinstance(operand, int) else operand

    return Program(
        program.inputs,
        tuple(
            Instruction(one.operation, names[one.target], named(one.left), named(one.right))
            for one in kept
        ),
        tuple((place, names.get(register, register)) for place, register in program.entries),
        tuple(type(pivot)(*(names.get(k, k) for k in pivot)) for pivot in program.pivots),
    )


class _Part(NamedTuple):
    """The part of a program that one LFT needs, and its row (n_out n_in,)."""

    program: Program
    row: Array
    plan: Plan


@lru_cache(maxsize=8)
def _part(known: ModelProgram, first: int, size: int) -> _Part:
    entries = tuple(
        ((0, k - first), register)
        for (_, k), register in known.program.entries
        if first <= k < first + size
    )
    part = compact(
        Program(known.program.inputs, known.program.instructions, entries, known.program.pivots)
    )
    return _Part(part, known.row[first : first + size], plan(part))


@lru_cache(maxsize=4)
def _native_part(known: ModelProgram, first: int, size: int) -> NativeProgram | None:
    """The part as native code; nothing if LLVM fails."""
    try:
        return native(_part(known, first, size).program, size, user_cache())
    except (RuntimeError, OSError):
        return None


def is_native(known: ModelProgram, count: int) -> bool:
    """Whether so many samples are computed by native code."""
    return count >= KNOWN_NATIVE and is_available()


def values_by(known: ModelProgram, a: LFT, physical: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Values (N, n_out, n_in) of one of its LFTs, and where a pivot has lost digits (N,).

    Parameters
    ----------
    known : ModelProgram
    a : LFT
        `known.lft` or `known.trim`.
    physical : array (N, n_p), in the units of the parameters
    """
    first, size = (0 if a is known.lft else known.lft.M22.size), a.M22.size
    part, count = _part(known, first, size), len(physical)
    values = np.empty((count, size))
    found = _native_part(known, first, size) if is_native(known, count) else None
    if found is not None:
        lost = run_natively(found, physical, part.row, values)
    else:  # bit for bit the same
        values[:] = part.row
        lost = run(part.plan, physical, values[:, None, :])
    return values.reshape(count, *a.shape), lost
