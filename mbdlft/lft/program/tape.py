"""Straight-line programs: sums, products, quotients of registers, each for many samples at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

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
