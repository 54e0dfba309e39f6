"""Straight-line programs of registers, and their runs by numpy.

A program is a list of sums, products and quotients of registers. Each instruction is one operation on a
vector of samples; registers share vectors once they are no longer needed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array

Operand = int | float  # a register, or a number

ADD, SUBTRACT, MULTIPLY, DIVIDE, SIZE = "add", "subtract", "multiply", "divide", "size"
MAXIMUM, ROOT, COSINE, SINE = "maximum", "root", "cosine", "sine"


class Instruction(NamedTuple):
    """target := left operation right; `SIZE` is |left|, and like roots and cosines has no right side."""

    operation: str
    target: int
    left: Operand
    right: Operand


class Pivot(NamedTuple):
    """1 - delta_i T_ii, and the size of the terms it was added up from: registers."""

    value: int
    size: int


@dataclass(frozen=True, slots=True)
class Program:
    """Entries of a matrix from numbers, such as the values of an LFT from its deltas.

    Attributes
    ----------
    inputs : number of inputs; they are registers 0, 1, ...
    instructions : tuple of Instruction
    entries : tuple of ((row, column), register)
        Entries that depend on an input; the others are constants that the program does not know.
    pivots : tuple of Pivot
        Where one of them is small beside its size, digits are lost.
    """

    inputs: int
    instructions: tuple[Instruction, ...]
    entries: tuple[tuple[tuple[int, int], int], ...]
    pivots: tuple[Pivot, ...]


class TooLongError(Exception):
    """The program would have more instructions than it may have."""


class Tape:
    """Instructions that are written once each; sums and products of numbers are computed at once."""

    def __init__(self, inputs: int, most: int) -> None:
        self.inputs, self.most = inputs, most
        self.instructions: list[Instruction] = []
        self.known: dict[tuple[str, Operand, Operand], int] = {}

    def put(self, operation: str, left: Operand, right: Operand = 0.0) -> int:
        if operation in (ADD, MULTIPLY, MAXIMUM) and (type(left) is float, left) > (
            type(right) is float,
            right,
        ):
            left, right = right, left
        key = (operation, left, right)
        # 1 and 1.0 are the same key, a register and a number are not the same
        typed = (f"{operation}{type(left) is int}{type(right) is int}", left, right)
        if typed not in self.known:
            if len(self.instructions) >= self.most:
                raise TooLongError
            target = self.inputs + len(self.instructions)
            self.instructions.append(Instruction(key[0], target, left, right))
            self.known[typed] = target
        return self.known[typed]

    def add(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a + b
        if a == 0.0 and isinstance(a, float):
            return b
        if b == 0.0 and isinstance(b, float):
            return a
        return self.put(ADD, a, b)

    def subtract(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a - b
        if b == 0.0 and isinstance(b, float):
            return a
        return self.put(SUBTRACT, a, b)

    def multiply(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a * b
        if isinstance(a, float):
            a, b = b, a
        if isinstance(b, float) and b in (0.0, 1.0):
            return a if b else 0.0
        return self.put(MULTIPLY, a, b)

    def add_product(self, a: Operand, b: Operand, c: Operand) -> Operand:
        """a + b c, without a product where b or c is 1 or -1."""
        for one, other in ((b, c), (c, b)):
            if isinstance(one, float) and one == -1.0 and not isinstance(other, float):
                return self.put(SUBTRACT, a, other)
        return self.add(a, self.multiply(b, c))

    def divide(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a / b
        if a == 0.0 and isinstance(a, float):
            return a
        if b == 1.0 and isinstance(b, float):
            return a
        return self.put(DIVIDE, a, b)

    def maximum(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return max(a, b)
        return self.put(MAXIMUM, a, b)

    def size(self, a: Operand) -> Operand:
        return abs(a) if isinstance(a, float) else self.put(SIZE, a)


def rows_of_numbers(
    tape: Tape, outcome: Sequence[Operand], pivots: Sequence[Pivot]
) -> tuple[Program, Array]:
    """A program of rows, and the row (size,) of those of its numbers that are constants.

    One more pivot is 1 where all numbers of a row are finite, and not a number elsewhere.
    """
    row = np.array([one if isinstance(one, float) else 0.0 for one in outcome])
    places = tuple(((0, k), one) for k, one in enumerate(outcome) if not isinstance(one, float))
    found = list(pivots)
    total: Operand = 1.0
    for register in dict.fromkeys(register for _, register in places):
        total = tape.add(total, tape.put(MULTIPLY, register, 0.0))
    if isinstance(total, int):
        found.append(Pivot(total, total))
    return Program(tape.inputs, tuple(tape.instructions), places, tuple(found)), row


def needed(found: Program) -> list[Instruction]:
    """Instructions that a result depends on."""
    wanted = results(found)
    kept = []
    for instruction in reversed(found.instructions):
        if instruction.target in wanted:
            kept.append(instruction)
            wanted.update(registers(instruction))
    return kept[::-1]


def results(found: Program) -> set[int]:
    """Registers that are asked for."""
    entries = {register for _, register in found.entries}
    return entries | {register for pivot in found.pivots for register in pivot}


def registers(instruction: Instruction) -> list[int]:
    """Registers that an instruction reads."""
    return [o for o in (instruction.left, instruction.right) if isinstance(o, int)]


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
