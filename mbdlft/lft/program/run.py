"""Runs of a program of an LFT: each instruction is one operation on a vector of samples."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.lft.program.tape import (
    ADD,
    COSINE,
    DIVIDE,
    MAXIMUM,
    MULTIPLY,
    ROOT,
    SINE,
    SIZE,
    SUBTRACT,
    Instruction,
    Program,
    needed,
    registers,
    results,
)

_CACHE = 2**20  # numbers in all vectors of a run: they stay near a core
_SHORTEST, _LONGEST = 512, 5120  # samples of a vector
LOST = 2.0**-5  # a pivot below this part of its terms has lost five binary digits
_CALLS: dict[str, Callable[..., Any]] = {
    ADD: np.add,
    SUBTRACT: np.subtract,
    MULTIPLY: np.multiply,
    DIVIDE: np.divide,
    SIZE: np.copysign,  # of +0: the absolute value
    MAXIMUM: lambda left, right, target: np.maximum(left, right, out=target),
    ROOT: lambda left, _, target: np.sqrt(left, target),
    COSINE: lambda left, _, target: np.cos(left, target),
    SINE: lambda left, _, target: np.sin(left, target),
}


@dataclass(frozen=True, slots=True)
class Plan:
    """A program whose registers share vectors once they are no longer needed.

    Attributes
    ----------
    program : Program
        Its registers are vectors now.
    vectors : number of vectors
    samples : samples of a vector
    """

    program: Program
    vectors: int
    samples: int


def plan(found: Program) -> Plan:
    """Give each register a vector, and the vector to another one after its last use."""
    kept = needed(found)
    last: dict[int, int] = {}
    for position, instruction in enumerate(kept):
        for operand in registers(instruction):
            last[operand] = position
    asked = results(found)
    place = {k: k for k in range(found.inputs)}
    free: list[int] = []
    count, instructions = found.inputs, []
    for position, instruction in enumerate(kept):
        operands = (instruction.left, instruction.right)
        left, right = (place[o] if isinstance(o, int) else o for o in operands)
        for register in set(registers(instruction)):
            # the deltas stay: their vectors are filled once for each chunk
            if last[register] == position and register not in asked and register >= found.inputs:
                free.append(place[register])
        if not free:
            free.append(count)
            count += 1
        place[instruction.target] = free.pop()
        instructions.append(
            Instruction(instruction.operation, place[instruction.target], left, right)
        )
    placed = Program(
        found.inputs,
        tuple(instructions),
        tuple((entry, place[register]) for entry, register in found.entries),
        tuple(type(pivot)(*(place[register] for register in pivot)) for pivot in found.pivots),
    )
    return Plan(placed, count, max(_SHORTEST, min(_LONGEST, _CACHE // max(1, count))))


def run(found: Plan, points: Array, values: Array) -> NDArray[np.bool_]:
    """Write the entries that depend on deltas into values (N, n_out, n_in).

    Parameters
    ----------
    found : Plan
    points : array (N, number of deltas) [1]
    values : array (N, n_out, n_in)
        The other entries are left as they are.

    Returns
    -------
    bool array (N,)
        Samples at which a pivot is so small beside its terms that digits are lost, or not a number.
    """
    program = found.program
    size = -(-len(points) // max(1, -(-len(points) // found.samples)))  # all vectors of one length
    room, bound = np.empty((found.vectors, size)), []
    lost = np.zeros(len(points), dtype=bool)
    with np.errstate(all="ignore"):  # what comes of a pivot of zero is computed again
        for start in range(0, len(points), size):
            part = points[start : start + size]
            if start == 0 or len(part) < size:
                rows = list(room[:, : len(part)])
                bound = _bind(program, rows)
            room[: program.inputs, : len(part)] = part.T
            for call, left, right, target in bound:
                call(left, right, target)
            bad = lost[start : start + size]
            for pivot in program.pivots:
                bad |= ~(np.abs(rows[pivot.value]) >= LOST * rows[pivot.size])
            written = values[start : start + size]
            for (row, column), register in program.entries:
                written[:, row, column] = rows[register]
    return lost


def _bind(
    program: Program, rows: list[Array]
) -> list[tuple[Callable[..., Any], Array, Array, Array]]:
    """The calls of a program on vectors; numbers are arrays without axes, the fastest form of them."""
    return [
        (
            _CALLS[operation],
            rows[left] if isinstance(left, int) else np.array(left),
            rows[right] if isinstance(right, int) else np.array(right),
            rows[target],
        )
        for operation, target, left, right in program.instructions
    ]
