"""A straight-line program as text for LLVM: each register is a vector of eight samples.

The text depends on the structure of the program alone: numbers are read from a table, so that scenes that
differ in numbers share their code. Operations are those of IEEE 754, one by one and never fused, so the
results are bit for bit those of numpy.

Code of thousands of instructions without a branch takes compilers a time like the square of its length,
so it is cut into functions. What one leaves for another goes through a table of slots, which stays in
the nearest cache.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mbdlft.lft.program.tape import (
    ADD,
    DIVIDE,
    LOST,
    MAXIMUM,
    MULTIPLY,
    ROOT,
    SIZE,
    SUBTRACT,
    Instruction,
    Operand,
    Program,
    needed,
    registers,
    results,
)

LANES = 8  # samples of a vector; processors with shorter vectors take several
_LENGTH = 400  # instructions of a function
_WRITTEN = 1000  # entries that a function writes
_VECTOR = f"<{LANES} x double>"
_BYTES = 8 * LANES
_BINARY = {ADD: "fadd", SUBTRACT: "fsub", MULTIPLY: "fmul", DIVIDE: "fdiv"}
_CALLED = {
    SIZE: f"@llvm.fabs.v{LANES}f64",
    ROOT: f"@llvm.sqrt.v{LANES}f64",
    MAXIMUM: f"@llvm.maximum.v{LANES}f64",
}


class Code(NamedTuple):
    """What LLVM compiles: text, the constants in the order of their table, and the number of slots.

    The function is `samples(blocks, inputs, numbers, slots, row, values, lost)` for blocks of `LANES`
    samples: inputs (blocks, inputs, LANES), numbers (constants,), slots (slots, LANES), the row of
    `size` entries that each sample starts from, values (samples, size), lost (samples,) of bytes.
    """

    text: str
    numbers: tuple[float, ...]
    slots: int


def code(program: Program, size: int) -> Code:
    """The text of a program without cosines and sines; entries have places (0, k) in rows."""
    kept = needed(program)
    pieces = [kept[start : start + _LENGTH] for start in range(0, len(kept), _LENGTH)]
    numbers = _Numbers()
    slots = _slots(program, pieces)
    names = [f"part{k}" for k in range(len(pieces))]
    functions = [
        _part(name, piece, program.inputs, slots, numbers)
        for name, piece in zip(names, pieces, strict=True)
    ]
    places = [(place, slots.get(register), register) for (_, place), register in program.entries]
    writers = [
        _writer(f"write{k}", places[start : start + _WRITTEN])
        for k, start in enumerate(range(0, len(places), _WRITTEN))
    ]
    functions += [*writers, _check(program, slots)]
    calls = [f"  call void @{name}(ptr %in, ptr %numbers, ptr %slots)" for name in names]
    calls += [
        f"  call void @write{k}(ptr %in, ptr %slots, ptr %lane_row, i64 %lane)"
        for k in range(len(writers))
    ]
    return Code(
        "\n".join([*functions, _loop(program.inputs, size, len(names), calls), *_DECLARED]),
        tuple(numbers.known),
        1 + max(slots.values(), default=0),
    )


class _Numbers:
    """Constants, each once, by their bits: 0.0 is not -0.0."""

    def __init__(self) -> None:
        self.known: list[float] = []
        self._places: dict[str, int] = {}

    def place(self, number: float) -> int:
        key = number.hex()
        if key not in self._places:
            self._places[key] = len(self.known)
            self.known.append(number)
        return self._places[key]


def _slots(program: Program, pieces: Sequence[Sequence[Instruction]]) -> dict[int, int]:
    """A slot for each register that another function reads; free again after its last reader."""
    final = len(pieces)
    last: dict[int, int] = {}
    for k, piece in enumerate(pieces):
        for instruction in piece:
            for operand in registers(instruction):
                last[operand] = k
    for register in results(program):
        last[register] = final
    slots: dict[int, int] = {}
    free: list[int] = []
    freed: list[list[int]] = [[] for _ in range(final + 1)]
    count = 0
    for k, piece in enumerate(pieces):
        free += freed[k]
        for instruction in piece:
            register = instruction.target
            until = last.get(register, k)
            if until == k:
                continue
            if not free:
                free.append(count)
                count += 1
            slots[register] = free.pop()
            if until + 1 <= final:
                freed[until + 1].append(slots[register])
    return slots


def _part(
    name: str,
    instructions: Sequence[Instruction],
    inputs: int,
    slots: Mapping[int, int],
    numbers: _Numbers,
) -> str:
    """A function of some instructions."""
    lines: list[str] = []
    known: dict[Operand | str, str] = {}

    def value(operand: Operand) -> str:
        key = operand if isinstance(operand, int) else operand.hex()
        if key in known:
            return known[key]
        text = f"%v{len(known)}"
        known[key] = text
        if isinstance(operand, int):
            pointer = "%in" if operand < inputs else "%slots"
            place = operand if operand < inputs else slots[operand]
            lines.extend(_loaded(text, pointer, place))
        else:
            lines.append(f"{text}p = getelementptr double, ptr %numbers, i64 {numbers.place(operand)}")
            lines.append(f"{text}s = load double, ptr {text}p, align 8")
            lines.extend(_spread(text, f"{text}s", f"{text}i"))
        return text

    for operation, target, left, right in instructions:
        formula: str
        if operation in _BINARY:
            formula = f"{_BINARY[operation]} {_VECTOR} {value(left)}, {value(right)}"
        else:
            both = (left, right) if operation == MAXIMUM else (left,)
            operands = ", ".join(f"{_VECTOR} {value(operand)}" for operand in both)
            formula = f"call {_VECTOR} {_CALLED[operation]}({operands})"
        text = f"%v{len(known)}"
        known[target] = text
        lines.append(f"{text} = {formula}")
        if target in slots:
            place = f"{text}o"
            lines.append(f"{place} = getelementptr {_VECTOR}, ptr %slots, i64 {slots[target]}")
            lines.append(f"store {_VECTOR} {text}, ptr {place}, align {_BYTES}")
    head = "ptr noalias readonly %in, ptr noalias readonly %numbers, ptr noalias %slots"
    return _function(name, head, lines)


def _function(name: str, head: str, lines: Sequence[str]) -> str:
    body = "\n  ".join(lines)
    return f"define internal void @{name}({head}) noinline {{\n  {body}\n  ret void\n}}\n"


def _spread(text: str, number: str, first: str) -> list[str]:
    """A vector of one number."""
    return [
        f"{first} = insertelement {_VECTOR} poison, double {number}, i64 0",
        f"{text} = shufflevector {_VECTOR} {first}, {_VECTOR} poison, <{LANES} x i32> zeroinitializer",
    ]


def _loaded(text: str, pointer: str, place: int) -> list[str]:
    return [
        f"{text}p = getelementptr {_VECTOR}, ptr {pointer}, i64 {place}",
        f"{text} = load {_VECTOR}, ptr {text}p, align {_BYTES}",
    ]


def _writer(name: str, places: Sequence[tuple[int, int | None, int]]) -> str:
    """A function that writes entries of one sample, a lane of the vectors."""
    lines = []
    for k, (place, slot, register) in enumerate(places):
        pointer, place_of_vector = ("%in", register) if slot is None else ("%slots", slot)
        lines += [
            f"%e{k}b = getelementptr {_VECTOR}, ptr {pointer}, i64 {place_of_vector}",
            f"%e{k}p = getelementptr double, ptr %e{k}b, i64 %lane",
            f"%e{k} = load double, ptr %e{k}p, align 8",
            f"%e{k}q = getelementptr double, ptr %row, i64 {place}",
            f"store double %e{k}, ptr %e{k}q, align 8",
        ]
    head = "ptr noalias readonly %in, ptr noalias readonly %slots, ptr noalias %row, i64 %lane"
    return _function(name, head, lines)


def _check(program: Program, slots: Mapping[int, int]) -> str:
    """A function that tells at which samples a pivot is too small."""
    bits = f"<{LANES} x i1>"
    lines = _spread("%least", f"{LOST:e}", "%least0")
    good = "splat (i1 true)"
    for k, pivot in enumerate(program.pivots):
        for text, register in ((f"%a{k}", pivot.value), (f"%b{k}", pivot.size)):
            is_input = register < program.inputs
            place = register if is_input else slots[register]
            lines += _loaded(text, "%in" if is_input else "%slots", place)
        lines += [
            f"%c{k} = call {_VECTOR} {_CALLED[SIZE]}({_VECTOR} %a{k})",
            f"%d{k} = fmul {_VECTOR} %b{k}, %least",
            f"%f{k} = fcmp oge {_VECTOR} %c{k}, %d{k}",
            f"%g{k} = and {bits} {good}, %f{k}",
        ]
        good = f"%g{k}"
    lines += [
        f"%bad = xor {bits} {good}, splat (i1 true)",
        f"%bytes = zext {bits} %bad to <{LANES} x i8>",
        f"store <{LANES} x i8> %bytes, ptr %lost, align 1",
    ]
    head = "ptr noalias readonly %in, ptr noalias readonly %slots, ptr noalias %lost"
    return _function("check", head, lines)


def _loop(inputs: int, size: int, computing: int, calls: Sequence[str]) -> str:
    """The loop over blocks; in it, one over the samples of a block, whose rows are copied and filled."""
    newline = "\n  "
    first, writing = calls[:computing], calls[computing:]
    return f"""
define void @samples(i64 %blocks, ptr %inputs, ptr %numbers, ptr %slots, ptr %row, ptr %values,
                     ptr %lost_all) {{
entry:
  %some = icmp sgt i64 %blocks, 0
  br i1 %some, label %block, label %done
block:
  %k = phi i64 [ 0, %entry ], [ %next, %end ]
  %first = mul i64 %k, {inputs}
  %in = getelementptr {_VECTOR}, ptr %inputs, i64 %first
  %sample = mul i64 %k, {LANES}
  %lost = getelementptr i8, ptr %lost_all, i64 %sample
{newline.join(first)}
  call void @check(ptr %in, ptr %slots, ptr %lost)
  br label %write
write:
  %lane = phi i64 [ 0, %block ], [ %lane_next, %write ]
  %own = add i64 %sample, %lane
  %start = mul i64 %own, {size}
  %lane_row = getelementptr double, ptr %values, i64 %start
  call void @llvm.memcpy.p0.p0.i64(ptr align 8 %lane_row, ptr align 8 %row, i64 {8 * size}, i1 false)
{newline.join(writing)}
  %lane_next = add i64 %lane, 1
  %more = icmp slt i64 %lane_next, {LANES}
  br i1 %more, label %write, label %end
end:
  %next = add i64 %k, 1
  %again = icmp slt i64 %next, %blocks
  br i1 %again, label %block, label %done
done:
  ret void
}}
"""


_DECLARED = (
    *(f"declare {_VECTOR} {_CALLED[name]}({_VECTOR})" for name in (SIZE, ROOT)),
    f"declare {_VECTOR} {_CALLED[MAXIMUM]}({_VECTOR}, {_VECTOR})",
    "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)",
)
