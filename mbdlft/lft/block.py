"""Blocks of Delta: repeated real parameters, repeated complex scalars, and full complex matrices.

    w = Delta z,    Delta = diag(delta_1 I, ..., delta_c I, ..., Delta_1, ...)

A block has as many inputs as it reads of z, and as many outputs as it writes of w.
"""

from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import ArrayLike
from mbdlft.base.errors import StructureError


class Block(NamedTuple):
    """A real delta times the identity of a size; the name is the identity of the delta."""

    name: str
    size: int

    @property
    def kind(self) -> str:
        """``"real"``, ``"complex"`` or ``"full"``."""
        return "real"

    @property
    def inputs(self) -> int:
        """Number of entries of z that the block reads: rows of M11."""
        return self.size

    @property
    def outputs(self) -> int:
        """Number of entries of w that the block writes: columns of M11."""
        return self.size

    def of_size(self, size: int) -> "Block":
        """A block of the same name and kind with another number of repetitions."""
        return type(self)(self.name, size)


class _OtherBlock(Block):
    """A block that is not equal to the real one of its name and size."""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and tuple.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash((type(self).__name__, self.name, self.inputs, self.outputs))


class ComplexBlock(_OtherBlock):
    """A complex delta times the identity of a size: dynamics that are unknown, |delta| <= 1."""

    @property
    def kind(self) -> str:
        return "complex"


class FullBlock(_OtherBlock):
    """A complex matrix Delta (outputs, inputs) of which only the norm is known, ||Delta|| <= 1.

    It reads so many entries of z, its `size`, and writes as many of w if not told otherwise.
    """

    def __new__(cls, name: str, inputs: int, outputs: int | None = None) -> "FullBlock":
        made = super().__new__(cls, name, inputs)
        made.__dict__["_outputs"] = inputs if outputs is None else outputs
        return made

    def __getnewargs__(self) -> tuple[Any, ...]:
        return (self.name, self.size, self.outputs)

    def __eq__(self, other: object) -> bool:
        return super().__eq__(other) and self.outputs == other.outputs  # type: ignore[attr-defined]

    __hash__ = _OtherBlock.__hash__

    def __repr__(self) -> str:
        return f"FullBlock(name={self.name!r}, inputs={self.inputs}, outputs={self.outputs})"

    @property
    def kind(self) -> str:
        return "full"

    @property
    def outputs(self) -> int:
        return int(self.__dict__["_outputs"])


def block_value(block: Block, value: ArrayLike) -> Any:
    """A number for a repeated block, a matrix (..., outputs, inputs) for a full one, checked."""
    number = np.asarray(value)
    if number.dtype.kind not in "biufc":  # the text of an array takes longer than its value
        raise StructureError(f"LFT: {block.name}: expected a number, got {value!r}.")
    if block.kind == "real":
        if number.dtype.kind == "c":
            raise StructureError(f"LFT: {block.name} is a real delta, got {value!r}.")
        return np.asarray(number, dtype=float)
    shape = (block.outputs, block.inputs)
    check(
        block.kind != "full" or number.shape[-2:] == shape,
        f"{block.name} is a full block and needs shape {shape}, got {number.shape}",
    )
    return number


def gathered(a: Block, b: Block) -> Block:
    """The block of two of one name."""
    check(a.kind == b.kind, f"{a.name} is a {a.kind} block here and a {b.kind} one there")
    check(a.kind != "full", f"the full block {a.name} stands twice, and it cannot be repeated")
    return a.of_size(a.size + b.size)


def check(condition: bool, message: str) -> None:  # noqa: FBT001
    """Raise a StructureError with the message unless the condition holds."""
    if not condition:
        raise StructureError(f"LFT: {message}.")
