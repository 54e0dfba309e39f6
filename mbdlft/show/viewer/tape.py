"""Functions of SX as tapes of straight-line operations that a page can follow without CasADi."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from mbdlft.problem.sx.tapes import steps

# the operations that `interpret` of assets/interpret.js knows, by their place in this list
OPERATIONS = (
    "const", "input", "output", "assign", "add", "sub", "mul", "div", "neg", "sq", "twice", "inv",
    "sqrt", "sin", "cos", "tan", "atan",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Tape:
    """A function (first argument, second argument, ...) as numbers.

    Attributes
    ----------
    steps : four integers for each operation
        Its place in `OPERATIONS`, the register of its result, those of its operands. An input has the
        number of its argument and of its entry, a constant its place in `constants`, an output the
        number of its entry in place of a register.
    constants : floats
    registers, outputs : how many there are
    """

    steps: tuple[int, ...]
    constants: tuple[float, ...]
    registers: int
    outputs: int

    def as_data(self) -> dict[str, object]:
        """The tape as plain data, for JSON."""
        return {
            "steps": list(self.steps),
            "constants": list(self.constants),
            "registers": self.registers,
            "outputs": self.outputs,
        }


def tape_of(function: ca.Function) -> Tape:
    """The tape of a function of SX with one result, which is dense.

    Raises
    ------
    NotImplementedError
        An operation is none of `OPERATIONS`: a kind of joint or body uses one that pages do not know.
    """
    found: list[int] = []
    constants: dict[float, int] = {}
    for operation, target, sources in steps(function):
        if operation not in OPERATIONS:
            raise NotImplementedError(f"the operation {operation!r} of {function.name()!r}")
        code = OPERATIONS.index(operation)
        if operation == "const":
            entry = [constants.setdefault(sources[0], len(constants)), 0]
            found += [code, target, *entry]
        elif operation == "output":
            found += [code, target[1], sources[0], 0]
        else:
            found += [code, target, *_two(sources)]
    return Tape(tuple(found), tuple(constants), int(function.sz_w()), int(function.nnz_out(0)))


def _two(sources: Sequence[int]) -> tuple[int, int]:
    return (sources[0], sources[1] if len(sources) > 1 else 0)
