"""A straight-line program of the values of a model, known beside its LFT: that of a scene's equations.

A program is shorter than the LFT where that is nearly full. It is a function of the physical values. It
belongs to two LFTs, and is used for these only: what is made of them has none.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT
from mbdlft.lft.program.cache import user_cache
from mbdlft.lft.program.native import NativeProgram, is_available, native, run_natively
from mbdlft.lft.program.run import Plan, plan, run
from mbdlft.lft.program.tape import Instruction, Program, needed

LONGEST = 200_000  # instructions: more take minutes to compile
NATIVE = 100_000  # samples from which on compiling it takes less than it saves


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
def _native(known: ModelProgram, first: int, size: int) -> NativeProgram | None:
    """The part as native code; nothing if LLVM fails."""
    try:
        return native(_part(known, first, size).program, size, user_cache())
    except (RuntimeError, OSError):
        return None


def is_native(known: ModelProgram, count: int) -> bool:
    """Whether so many samples are computed by native code."""
    return count >= NATIVE and is_available()


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
    found = _native(known, first, size) if is_native(known, count) else None
    if found is not None:
        lost = run_natively(found, physical, part.row, values)
    else:  # bit for bit the same
        values[:] = part.row
        lost = run(part.plan, physical, values[:, None, :])
    return values.reshape(count, *a.shape), lost
