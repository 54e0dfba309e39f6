"""A straight-line program as text for LLVM: each register is a vector of samples.

The text depends on the structure of the program alone: numbers are read from a table, so that scenes that
differ in numbers share their code. Operations are those of IEEE 754, one by one and never fused, so the
results are those of numpy bit for bit, but for cosines and sines: numpy takes them from the library of
the system, whose last bits differ.

Code of thousands of instructions without a branch takes compilers a time like the square of its length,
so it is cut into functions. What one leaves for another goes through a table of slots, which stays in
the nearest cache. The first slots are the inputs.

Values are written in squares, as many entries as samples: the vectors of some entries are transposed
into pieces of rows. What is constant in all rows is copied.

Cosine and sine: x = k pi/2 + y + z with an integer k, |y| <= pi/4, and a correction z below the last bit
of y. pi/2 has two parts of 33 bits, whose products with k < 2^20 are exact, and a rest (Cody, Waite
1980), so y + z is known to 2^-98. Polynomials of y (fdlibm: Ng 1993; errors below 2^-57) give cosine and
sine of it; k mod 4 says which of the two is asked for, and the sign. Larger arguments give no number.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.lft.program import tape

_LENGTH = 400  # instructions of a function
_WRITTEN = 1000  # entries that a function writes
_BINARY = {tape.ADD: "fadd", tape.SUBTRACT: "fsub", tape.MULTIPLY: "fmul", tape.DIVIDE: "fdiv"}
_CALLED = {tape.SIZE: "fabs", tape.ROOT: "sqrt", tape.MAXIMUM: "maximum"}
_SLOTS = "ptr noalias readonly %slots"

_FARTHEST = float.fromhex("0x1.9p+20")  # argument of a cosine: k is below 2^20
_ROUNDER = float.fromhex("0x1.8p+52")  # a number added to it is an integer, in the last bits of the sum
_QUADRANTS = float.fromhex("0x1.45f306dc9c883p-1")  # in an angle of 1: 2 / pi
_QUADRANT = tuple(
    float.fromhex(part) for part in ("0x1.921fb544p+0", "0x1.0b4611a6p-34", "0x1.3198a2e037073p-69")
)
_SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


class Code(NamedTuple):
    """What LLVM compiles: text, the constants in the order of their table, and the number of slots.

    The function is `samples(blocks, between, stride, points, numbers, slots, row, values, columns, lost)`
    for blocks of `lanes` samples: points (inputs, between), numbers (constants,), slots (slots, lanes),
    the row of `size` entries with the constants of all rows, values (samples, size), columns (., stride),
    lost (samples,) of bytes. Of points and columns the first so many numbers are read and written.
    """

    text: str
    numbers: tuple[float, ...]
    slots: int
    lanes: int


def code(program: tape.Program, size: int, lanes: int) -> Code:
    """The text of a program for vectors of `lanes` samples.

    Its entries have places (0, k): in rows if k < size, and in the column k - size otherwise.
    """
    kept = tape.needed(program)
    pieces = [kept[start : start + _LENGTH] for start in range(0, len(kept), _LENGTH)]
    numbers: dict[str, int] = {}
    slots = _slots(program, pieces)
    functions = {"read": _reader(program.inputs, lanes)}
    for k, piece in enumerate(pieces):
        functions[f"part{k}"] = _part(piece, slots, numbers, lanes)
    written = {place: slots[register] for (_, place), register in program.entries}
    for k, start in enumerate(range(0, size, _WRITTEN)):
        functions[f"write{k}"] = _writer(written, start, min(start + _WRITTEN, size), size, lanes)
    columns = {place - size: slot for place, slot in written.items() if place >= size}
    functions["columns"] = _columns(columns, lanes)
    functions["check"] = _check(program, slots, lanes)
    calls = [f"call void @{name}({_arguments(body.head)})" for name, body in functions.items()]
    texts = [body.text(name) for name, body in functions.items()]
    table = tuple(float.fromhex(number) for number in numbers)
    return Code(
        "\n".join([*texts, _loop(size, calls, lanes), *_declared(lanes)]),
        table,
        1 + max(slots.values(), default=0),
        lanes,
    )


def _slots(program: tape.Program, pieces: Sequence[Sequence[tape.Instruction]]) -> dict[int, int]:
    """A slot for each input, and each register that another function reads, free after the last one."""
    final = len(pieces)
    last: dict[int, int] = {}
    for k, piece in enumerate(pieces):
        for instruction in piece:
            for operand in tape.registers(instruction):
                last[operand] = k
    for register in tape.results(program):
        last[register] = final
    slots = {k: k for k in range(program.inputs)}
    free: list[int] = []
    freed: list[list[int]] = [[] for _ in range(final + 1)]
    count = program.inputs
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


def _arguments(head: str) -> str:
    """The arguments of a call, of those of the function."""
    return head.replace("noalias ", "").replace("readonly ", "")


class _Body:
    """The lines of a function without a result; `head` are its arguments."""

    def __init__(self, head: str, lanes: int) -> None:
        self.head, self.lanes = head, lanes
        self.vector = f"<{lanes} x double>"
        self.lines: list[str] = []

    def put(self, formula: str) -> str:
        """The name of a new value."""
        name = f"%v{len(self.lines)}"
        self.lines.append(f"{name} = {formula}")
        return name

    def operation(self, formula: str, *operands: str) -> str:
        return self.put(f"{formula} {self.vector} {', '.join(operands)}")

    def call(self, name: str, *operands: str) -> str:
        arguments = ", ".join(f"{self.vector} {operand}" for operand in operands)
        return self.put(f"call {self.vector} @llvm.{name}.v{self.lanes}f64({arguments})")

    def place(self, base: str, k: int, kind: str = "double") -> str:
        return self.put(f"getelementptr {kind}, ptr {base}, i64 {k}")

    def number(self, base: str, k: int) -> str:
        """The number with the place k of a table."""
        return self.put(f"load double, ptr {self.place(base, k)}, align 8")

    def spread(self, number: str) -> str:
        """A vector of one number."""
        first = self.put(f"insertelement {self.vector} poison, double {number}, i64 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        return self.put(f"shufflevector {self.vector} {first}, {self.vector} poison, {zeros}")

    def slot(self, k: int) -> str:
        """The vector in a slot."""
        place = self.place("%slots", k, self.vector)
        return self.put(f"load {self.vector}, ptr {place}, align {8 * self.lanes}")

    def keep(self, vector: str, k: int) -> None:
        """Put a vector into a slot."""
        self.store(f"{self.vector} {vector}", self.place("%slots", k, self.vector), 8 * self.lanes)

    def column(self, base: str, stride: str, k: int) -> str:
        """The place of the first sample in the column k of a table."""
        start = self.put(f"mul i64 {stride}, {k}")
        return self.put(f"getelementptr double, ptr {base}, i64 {start}")

    def store(self, value: str, place: str, align: int = 8) -> None:
        self.lines.append(f"store {value}, ptr {place}, align {align}")

    def text(self, name: str) -> str:
        lines = "\n  ".join([*self.lines, "ret void"])
        return f"define internal void @{name}({self.head}) noinline {{\n  {lines}\n}}\n"


def _reader(inputs: int, lanes: int) -> _Body:
    """Inputs of some samples, put into slots."""
    body = _Body("ptr noalias readonly %points, i64 %between, ptr noalias %slots", lanes)
    for k in range(inputs):
        place = body.column("%points", "%between", k)
        body.keep(body.put(f"load {body.vector}, ptr {place}, align 8"), k)
    return body


def _part(
    instructions: Sequence[tape.Instruction],
    slots: Mapping[int, int],
    numbers: dict[str, int],
    lanes: int,
) -> _Body:
    """Some instructions. A constant is known by its bits, as 0.0 is not -0.0."""
    body = _Body("ptr noalias readonly %numbers, ptr noalias %slots", lanes)
    known: dict[tape.Operand | str, str] = {}
    circles: dict[tape.Operand, tuple[str, str]] = {}

    def value(operand: tape.Operand) -> str:
        key = operand if isinstance(operand, int) else operand.hex()
        if key not in known:
            if isinstance(key, int):
                known[key] = body.slot(slots[key])
            else:
                place = numbers.setdefault(key, len(numbers))
                known[key] = body.spread(body.number("%numbers", place))
        return known[key]

    for operation, target, left, right in instructions:
        if operation in _BINARY:
            vector = body.operation(_BINARY[operation], value(left), value(right))
        elif operation in (tape.COSINE, tape.SINE):
            if left not in circles:
                circles[left] = _circle(body, value(left))
            vector = circles[left][operation == tape.SINE]
        else:
            both = (left, right) if operation == tape.MAXIMUM else (left,)
            vector = body.call(_CALLED[operation], *map(value, both))
        known[target] = vector
        if target in slots:
            body.keep(vector, slots[target])
    return body


def _circle(body: _Body, angle: str) -> tuple[str, str]:
    """Cosine and sine of a vector."""
    bools, integers = f"<{body.lanes} x i1>", f"<{body.lanes} x i64>"

    def add(a: str, b: str) -> str:
        return body.operation("fadd", a, b)

    def subtract(a: str, b: str) -> str:
        return body.operation("fsub", a, b)

    def multiply(a: str, b: str) -> str:
        return body.operation("fmul", a, b)

    def choose(condition: str, a: str, b: str) -> str:
        return body.put(f"select {bools} {condition}, {body.vector} {a}, {body.vector} {b}")

    def polynomial(coefficients: Sequence[float], z: str) -> str:
        total = _constant(coefficients[-1])
        for coefficient in reversed(coefficients[:-1]):
            total = add(multiply(total, z), _constant(coefficient))
        return total

    near = body.operation("fcmp ole", body.call("fabs", angle), _constant(_FARTHEST))
    x = choose(near, angle, _constant(float("nan")))
    rounded = add(multiply(x, _constant(_QUADRANTS)), _constant(_ROUNDER))
    k = subtract(rounded, _constant(_ROUNDER))
    rough, middle, fine = (multiply(k, _constant(part)) for part in _QUADRANT)
    first = subtract(x, rough)
    second = subtract(first, middle)
    missed = subtract(fine, subtract(subtract(first, second), middle))
    y = subtract(second, missed)
    z = subtract(subtract(second, y), missed)
    square, half = multiply(y, y), _constant(0.5)
    cube, halved = multiply(square, y), multiply(half, square)
    # sin(y + z) = y + s y^3 + y^5 p(y^2) + (1 - y^2 / 2) z, the small terms first
    higher = subtract(multiply(half, z), multiply(cube, polynomial(_SINE[1:], square)))
    lower = subtract(multiply(square, higher), z)
    sine = subtract(y, subtract(lower, multiply(cube, _constant(_SINE[0]))))
    # cos(y + z) = 1 - y^2 / 2 + y^4 p(y^2) - y z; what 1 - y^2 / 2 has lost is added again
    most = subtract(_constant(1.0), halved)
    rest = subtract(subtract(_constant(1.0), most), halved)
    fourth = multiply(multiply(square, square), polynomial(_COSINE, square))
    cosine = add(most, add(rest, subtract(fourth, multiply(y, z))))
    quadrant = body.put(f"bitcast {body.vector} {rounded} to {integers}")
    after = body.put(f"add {integers} {quadrant}, splat (i64 1)")
    is_odd = body.put(f"trunc {integers} {quadrant} to {bools}")
    chosen = []
    pair = choose(is_odd, sine, cosine), choose(is_odd, cosine, sine)
    for vector, turns in zip(pair, (after, quadrant), strict=True):  # the second bit is the sign
        bit = body.put(f"and {integers} {turns}, splat (i64 2)")
        sign = body.put(f"shl {integers} {bit}, splat (i64 62)")
        bits = body.put(f"bitcast {body.vector} {vector} to {integers}")
        signed = body.put(f"xor {integers} {bits}, {sign}")
        chosen.append(body.put(f"bitcast {integers} {signed} to {body.vector}"))
    return chosen[0], chosen[1]


def _constant(number: float) -> str:
    return f"splat (double 0x{np.float64(number).view(np.uint64):016X})"


def _writer(slots: Mapping[int, int], start: int, stop: int, size: int, lanes: int) -> _Body:
    """Entries from `start` to `stop` of the rows of some samples; those in `slots` are not constant.

    Rows are copied whole, one after the other, as memory is written fastest in its order.
    """
    body = _Body(f"{_SLOTS}, ptr noalias readonly %row, ptr noalias %values", lanes)
    source = body.place("%row", start)
    for lane in range(lanes):
        target = body.place("%values", lane * size + start)
        body.lines.append(
            f"call void @llvm.memcpy.p0.p0.i64(ptr align 8 {target}, ptr align 8 {source}, "
            f"i64 {8 * (stop - start)}, i1 false)"
        )

    def column(k: int) -> str:
        return body.slot(slots[k]) if k in slots else body.spread(body.number("%row", k))

    tail = stop - (stop - start) % lanes
    for at in range(start, tail, lanes):
        if any(k in slots for k in range(at, at + lanes)):
            rows = _transposed(body, [column(k) for k in range(at, at + lanes)])
            for lane, row in enumerate(rows):
                body.store(f"{body.vector} {row}", body.place("%values", lane * size + at))
    for k in filter(slots.__contains__, range(tail, stop)):
        vector = column(k)
        for lane in range(lanes):
            number = body.put(f"extractelement {body.vector} {vector}, i64 {lane}")
            body.store(f"double {number}", body.place("%values", lane * size + k))
    return body


def _columns(slots: Mapping[int, int], lanes: int) -> _Body:
    """Entries beside the rows, one column of all samples for each."""
    body = _Body(f"{_SLOTS}, ptr noalias %columns, i64 %stride", lanes)
    for column, slot in slots.items():
        body.store(f"{body.vector} {body.slot(slot)}", body.column("%columns", "%stride", column))
    return body


def _transposed(body: _Body, vectors: Sequence[str]) -> list[str]:
    """As many vectors as they have lanes; bit by bit, places in vectors become places of vectors."""
    lanes, some = len(vectors), list(vectors)
    bit = 1
    while bit < lanes:
        upper = [lane & ~bit if lane & bit == 0 else lanes + lane - bit for lane in range(lanes)]
        lower = [lane + bit if lane & bit == 0 else lanes + lane for lane in range(lanes)]
        for k in range(lanes):
            if k & bit == 0:
                pair = f"{body.vector} {some[k]}, {body.vector} {some[k + bit]}"
                some[k], some[k + bit] = (
                    body.put(
                        f"shufflevector {pair}, <{lanes} x i32> <{', '.join(f'i32 {j}' for j in mask)}>"
                    )
                    for mask in (upper, lower)
                )
        bit *= 2
    return some


def _check(program: tape.Program, slots: Mapping[int, int], lanes: int) -> _Body:
    """Tell at which samples a pivot is too small."""
    body = _Body(f"{_SLOTS}, ptr noalias %lost", lanes)
    bits, good = f"<{lanes} x i1>", "splat (i1 true)"
    for pivot in program.pivots:
        size = body.call("fabs", body.slot(slots[pivot.value]))
        least = body.operation("fmul", body.slot(slots[pivot.size]), _constant(tape.LOST))
        enough = body.operation("fcmp oge", size, least)
        good = body.put(f"and {bits} {good}, {enough}")
    bad = body.put(f"xor {bits} {good}, splat (i1 true)")
    bytes_ = body.put(f"zext {bits} {bad} to <{lanes} x i8>")
    body.store(f"<{lanes} x i8> {bytes_}", "%lost", 1)
    return body


def _loop(size: int, calls: Sequence[str], lanes: int) -> str:
    """The loop over blocks of samples."""
    newline = "\n  "
    return f"""
define void @samples(i64 %blocks, i64 %between, i64 %stride, ptr %all_points, ptr %numbers, ptr %slots,
                     ptr %row, ptr %all_values, ptr %all_columns, ptr %all_lost) {{
entry:
  %some = icmp sgt i64 %blocks, 0
  br i1 %some, label %block, label %done
block:
  %k = phi i64 [ 0, %entry ], [ %next, %block ]
  %sample = mul i64 %k, {lanes}
  %start = mul i64 %sample, {size}
  %points = getelementptr double, ptr %all_points, i64 %sample
  %values = getelementptr double, ptr %all_values, i64 %start
  %columns = getelementptr double, ptr %all_columns, i64 %sample
  %lost = getelementptr i8, ptr %all_lost, i64 %sample
  {newline.join(calls)}
  %next = add i64 %k, 1
  %again = icmp slt i64 %next, %blocks
  br i1 %again, label %block, label %done
done:
  ret void
}}
"""


def _declared(lanes: int) -> list[str]:
    vector = f"<{lanes} x double>"
    return [
        *(f"declare {vector} @llvm.{name}.v{lanes}f64({vector})" for name in ("fabs", "sqrt")),
        f"declare {vector} @llvm.maximum.v{lanes}f64({vector}, {vector})",
        "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)",
    ]
