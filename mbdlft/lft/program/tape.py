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

    Inputs are the registers 0, 1, ... The entries ((row, column), register) depend on an input; the
    others are constants that the program does not know. Where a pivot is small beside its size, digits
    are lost.
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
        if operation in (ADD, MULTIPLY, MAXIMUM):  # in one order: registers before numbers
            left, right = sorted((left, right), key=lambda o: (type(o) is float, o))
        # the register 1 and the number 1.0 would be one key
        key = (f"{operation}{type(left) is int}{type(right) is int}", left, right)
        if key not in self.known:
            if len(self.instructions) >= self.most:
                raise TooLongError
            target = self.inputs + len(self.instructions)
            self.instructions.append(Instruction(operation, target, left, right))
            self.known[key] = target
        return self.known[key]

    def add(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a + b
        if is_number(a, 0.0):
            return b
        return a if is_number(b, 0.0) else self.put(ADD, a, b)

    def subtract(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a - b
        return a if is_number(b, 0.0) else self.put(SUBTRACT, a, b)

    def multiply(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a * b
        if isinstance(a, float):
            a, b = b, a
        if is_number(b, 0.0):
            return 0.0
        return a if is_number(b, 1.0) else self.put(MULTIPLY, a, b)

    def add_product(self, a: Operand, b: Operand, c: Operand) -> Operand:
        """a + b c, without a product where b or c is 1 or -1."""
        for factor, other in ((b, c), (c, b)):
            if is_number(factor, -1.0) and not isinstance(other, float):
                return self.put(SUBTRACT, a, other)
        return self.add(a, self.multiply(b, c))

    def divide(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a / b
        return a if is_number(a, 0.0) or is_number(b, 1.0) else self.put(DIVIDE, a, b)

    def maximum(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return max(a, b)
        return self.put(MAXIMUM, a, b)

    def size(self, a: Operand) -> Operand:
        return abs(a) if isinstance(a, float) else self.put(SIZE, a)


def is_number(operand: Operand, value: float) -> bool:
    """Whether an operand is this number; a register is none."""
    return isinstance(operand, float) and operand == value


def rows_of_numbers(
    tape: Tape, outcome: Sequence[Operand], pivots: Sequence[Pivot]
) -> tuple[Program, Array]:
    """A program of rows with a pivot that tells finite numbers, and the constant row (size,)."""
    row = np.array([number if isinstance(number, float) else 0.0 for number in outcome])
    places = tuple(((0, k), number) for k, number in enumerate(outcome) if isinstance(number, int))
    total: Operand = 0.0
    for register in dict.fromkeys(register for _, register in places):
        total = tape.add(total, register)
    finite = []
    if isinstance(total, int):  # 1, or not a number
        number = tape.put(ADD, tape.put(MULTIPLY, total, 0.0), 1.0)
        finite.append(Pivot(number, number))
    return Program(tape.inputs, tuple(tape.instructions), places, (*pivots, *finite)), row


def needed(program: Program) -> list[Instruction]:
    """Instructions that a result depends on."""
    wanted = results(program)
    kept = []
    for instruction in reversed(program.instructions):
        if instruction.target in wanted:
            kept.append(instruction)
            wanted.update(registers(instruction))
    return kept[::-1]


def results(program: Program) -> set[int]:
    """Registers that are asked for."""
    entries = {register for _, register in program.entries}
    return entries | {register for pivot in program.pivots for register in pivot}


def registers(instruction: Instruction) -> list[int]:
    """Registers that an instruction reads."""
    return [o for o in (instruction.left, instruction.right) if isinstance(o, int)]


def compact(program: Program) -> Program:
    """The instructions that results depend on; that with number k writes the register inputs + k."""
    kept = needed(program)
    names = {instruction.target: program.inputs + k for k, instruction in enumerate(kept)}

    def operand(o: Operand) -> Operand:
        return names.get(o, o) if isinstance(o, int) else o

    def name(register: int) -> int:
        return names.get(register, register)

    return Program(
        program.inputs,
        tuple(Instruction(i.operation, name(i.target), operand(i.left), operand(i.right)) for i in kept),
        tuple((place, name(register)) for place, register in program.entries),
        tuple(Pivot(name(pivot.value), name(pivot.size)) for pivot in program.pivots),
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
    """A program whose registers share so many vectors of so many samples."""

    program: Program
    vectors: int
    samples: int


def plan(program: Program) -> Plan:
    """Give each register a vector, and the vector to another register after its last use."""
    kept, last = needed(program), dict[int, int]()
    for position, instruction in enumerate(kept):
        for operand in registers(instruction):
            last[operand] = position
    # inputs keep their vectors, which are filled once for each chunk
    lasting = results(program) | set(range(program.inputs))
    place = {k: k for k in range(program.inputs)}
    free: list[int] = []
    count, instructions = program.inputs, []
    for position, (operation, target, *operands) in enumerate(kept):
        left, right = (place[o] if isinstance(o, int) else o for o in operands)
        for register in {o for o in operands if isinstance(o, int)} - lasting:
            if last[register] == position:
                free.append(place[register])
        if not free:
            free.append(count)
            count += 1
        place[target] = free.pop()
        instructions.append(Instruction(operation, place[target], left, right))
    placed = Program(
        program.inputs,
        tuple(instructions),
        tuple((entry, place[register]) for entry, register in program.entries),
        tuple(Pivot(place[pivot.value], place[pivot.size]) for pivot in program.pivots),
    )
    return Plan(placed, count, max(_SHORTEST, min(_LONGEST, _CACHE // max(1, count))))


def run(planned: Plan, points: Array, values: Array) -> NDArray[np.bool_]:
    """Write entries at inputs (N, inputs) to values (N, n_out, n_in); True (N,) where digits are lost."""
    program = planned.program
    size = -(-len(points) // max(1, -(-len(points) // planned.samples)))  # vectors of one length
    room, bound = np.empty((planned.vectors, size)), []
    lost = np.zeros(len(points), dtype=bool)
    with np.errstate(all="ignore"):  # what comes of a pivot of zero is computed again
        for start in range(0, len(points), size):
            chunk = points[start : start + size]
            if start == 0 or len(chunk) < size:
                rows = list(room[:, : len(chunk)])
                bound = _bind(program, rows)
            room[: program.inputs, : len(chunk)] = chunk.T
            for call, left, right, target in bound:
                call(left, right, target)
            bad = lost[start : start + size]
            for pivot in program.pivots:
                bad |= ~(np.abs(rows[pivot.value]) >= LOST * rows[pivot.size])
            written = values[start : start + size]
            for (row, column), register in program.entries:
                written[:, row, column] = rows[register]
    return lost


def _bind(program: Program, rows: list[Array]) -> list[tuple[Callable[..., Any], Array, Array, Array]]:
    """The calls of a program on vectors; numbers are arrays without axes, the fastest form of them."""

    def operand(o: Operand) -> Array:
        return rows[o] if isinstance(o, int) else np.array(o)

    return [
        (_CALLS[i.operation], operand(i.left), operand(i.right), rows[i.target])
        for i in program.instructions
    ]
