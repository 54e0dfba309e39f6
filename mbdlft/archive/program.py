"""What is evaluated of a model: its straight-line program and its nonlinear functions, as items and back.

Whoever wrote the file, a program that is read here can do nothing but arithmetic on its registers: each
instruction reads what was written before it, and the number of instructions is limited. A function is a
formula, which is parsed and never run as code.

A program whose values are not those of its LFT is not used. Entries of an LFT are smooth, so those of a
program depend on no size and no maximum. And the values are compared at points of a Latin hypercube: the
range of each parameter is cut into as many slabs as there are points, and one point is in each slab. So
no slab of a parameter that is twice as wide can have other values. Rounding keeps residues from deciding:
the program has the numbers of the equations, and the LFT its own, both rounded to doubles.
"""

import warnings
from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.layout import VERSION, Items, columns, nested, word, words
from mbdlft.base.array import Array
from mbdlft.base.errors import ArchiveError, MbdlftWarning, StructureError, WellPosednessError
from mbdlft.base.formula import parsed
from mbdlft.base.parameter import Parameter, to_physical
from mbdlft.lft.lft import LFT
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
    Operand,
    Pivot,
    Program,
    compact,
)
from mbdlft.lft.sampling import LONGEST, ModelProgram, agrees, values_by
from mbdlft.system.model import LFTModel
from mbdlft.system.theta import ONE, DeltaThetaModel, Table, ThetaFunction

# the codes of a file: their order is part of the format
OPERATIONS = (ADD, SUBTRACT, MULTIPLY, DIVIDE, SIZE, MAXIMUM, ROOT, COSINE, SINE)
ONE_SIDED = (SIZE, ROOT, COSINE, SINE)  # what they have on the right does not count
_STEPS = (SIZE, MAXIMUM)  # of pivots alone
# points at which a program is compared with its LFT: of bumps in 0.5 % of the box 4e-5 are missed
_SLABS, _FEWEST = 2048, 32
_WORK = 1e9  # products for that, about: a second at most
_ITEMS = ("operation", "left", "right", "numbers", "result", "pivots")


def coded(program: Program, row: Array) -> Items:
    """A program whose entries have the places (0, k) of a row, as arrays.

    Operands are registers, or -1 - k for number k.
    """
    program = compact(program)
    numbers: dict[str, int] = {}
    values: list[float] = []

    def code(operand: Operand) -> int:
        if isinstance(operand, int):
            return operand
        place = numbers.setdefault(float(operand).hex(), len(numbers))
        if place == len(values):
            values.append(float(operand))
        return -1 - place

    outcome: list[Operand] = [float(x) for x in row]
    for (_, k), register in program.entries:
        outcome[k] = register
    some = program.instructions
    integers = {
        "left": [code(instruction.left) for instruction in some],
        "right": [code(instruction.right) for instruction in some],
        "result": [code(operand) for operand in outcome],
        "pivots": [list(pivot) for pivot in program.pivots],
    }
    items: Items = {name: np.array(codes, dtype="<i8") for name, codes in integers.items()}
    items["pivots"] = items["pivots"].reshape(-1, 2)
    codes = [OPERATIONS.index(instruction.operation) for instruction in some]
    items["operation"] = np.array(codes, dtype="i1")
    items["numbers"] = np.array(values, dtype="<f8")
    return {name: items[name] for name in _ITEMS}


def program_of_items(
    items: Items, parameters: Sequence[Parameter], lft: LFT, trim: LFT | None
) -> ModelProgram | None:
    """The program of a model; None if it has none, or one that is false or newer than this version."""
    if "program/operation" not in items:
        return None
    written = word(items, "@encoding_version")
    try:
        size = lft.M22.size + (trim.M22.size if trim is not None else 0)
        arrays = {name: items[f"program/{name}"] for name in _ITEMS}
        known = ModelProgram(*decoded(arrays, len(parameters), size), lft, trim)
        problem = mistake_of(known, parameters)
    except ArchiveError as error:
        if written in ("1.0", VERSION):
            raise
        problem = str(error)
    if not problem:
        return known
    text = f"the program of a model of version {written} is left out, and its LFT evaluated: {problem}"
    warnings.warn(text, MbdlftWarning, stacklevel=2)
    return None


def mistake_of(known: ModelProgram, parameters: Sequence[Parameter]) -> str:
    """Why the values of a program are not those of its LFTs; empty if nothing speaks against them."""
    stepped: set[Operand] = set()
    for instruction in known.program.instructions:
        reads = {k for k in (instruction.left, instruction.right) if isinstance(k, int)}
        if instruction.operation in _STEPS or reads & stepped:
            stepped.add(instruction.target)
    if any(register in stepped for _, register in known.program.entries):
        return "an entry of its matrices depends on a size or a maximum, which entries of an LFT do not."
    if known.lft.is_complex or any(block.kind != "real" for block in known.lft.blocks):
        return ""  # it is not used
    count = int(np.clip(_WORK / max(1, known.lft.order) ** 3, _FEWEST, _SLABS))
    drawn = np.random.default_rng(0)
    deltas, physical = np.empty((count, len(parameters))), np.empty((count, len(parameters)))
    for k, p in enumerate(parameters):
        slabs = drawn.permutation(count)
        deltas[:, k] = 2.0 * (slabs + drawn.uniform(size=count)) / count - 1.0
        physical[:, k] = to_physical(p, deltas[:, k])
    for lft in filter(None, (known.lft, known.trim)):
        values, lost = values_by(known, lft, physical)
        try:
            for start in range(0, count, _FEWEST):  # which `agrees` compares at a time
                at = slice(start, start + _FEWEST)
                if not agrees(lft, deltas[at], values[at], lost[at]):
                    return "it has other values."
        except WellPosednessError as error:
            return str(error)
    return ""


def decoded(items: Items, inputs: int, size: int) -> tuple[Program, Array]:
    """The program of arrays that `coded` makes, with the row (size,) of its constants.

    Errors are those of `program_of_items`.
    """
    operation, left, right, result, pivots = (
        items[name].astype(np.int64) for name in ("operation", "left", "right", "result", "pivots")
    )
    numbers, count = items["numbers"], len(operation)
    if count > LONGEST:
        raise ArchiveError(f"program has {count} instructions, at most {LONGEST} are run.")
    if not np.all(np.isfinite(numbers)):
        raise ArchiveError("program/numbers has a number that is not finite.")
    unknown = np.flatnonzero((operation < 0) | (operation >= len(OPERATIONS)))
    if len(unknown):
        raise ArchiveError(
            f"program/operation: instruction {unknown[0]} has the code {operation[unknown[0]]}, which is "
            f"unknown; known are 0 to {len(OPERATIONS) - 1}."
        )
    if len(result) != size:
        raise ArchiveError(
            f"program/result has {len(result)} numbers, the matrices and the trim have {size}."
        )
    known = inputs + np.arange(count)
    _check_operands("program/left", left, known, len(numbers))
    _check_operands("program/right", right, known, len(numbers))
    every = np.full(size, inputs + count)
    _check_operands("program/result", result, every, len(numbers))
    _check_operands("program/pivots", pivots.ravel(), np.full(pivots.size, inputs + count), 0)

    values = numbers.tolist()
    names = [OPERATIONS[code] for code in operation.tolist()]
    lefts = [k if k >= 0 else values[-1 - k] for k in left.tolist()]
    rights: list[Operand] = [k if k >= 0 else values[-1 - k] for k in right.tolist()]
    rights = [0.0 if n in ONE_SIDED else k for n, k in zip(names, rights, strict=True)]
    targets = range(inputs, inputs + count)
    instructions = tuple(map(Instruction, names, targets, lefts, rights))
    outcome = result.tolist()
    row: Array = np.array([0.0 if k >= 0 else values[-1 - k] for k in outcome])
    entries = tuple(((0, k), register) for k, register in enumerate(outcome) if register >= 0)
    kept = tuple(Pivot(*pair) for pair in pivots.tolist())
    return Program(inputs, instructions, entries, kept), row


def _check_operands(what: str, operands: NDArray[Any], known: NDArray[Any], numbers: int) -> None:
    """Raise an ArchiveError unless operands are registers below `known`, or numbers that are there."""
    wrong = np.flatnonzero((operands >= known) | (operands < -numbers))
    if len(wrong):
        k = int(wrong[0])
        code = int(operands[k])
        have = f"number {-1 - code} of {numbers}" if code < 0 else f"register {code}"
        raise ArchiveError(
            f"{what}: entry {k} is {code}, {have}, and only registers below {int(known[k])} are "
            "known there."
        )


def theta_values(model: DeltaThetaModel) -> dict[str, Any]:
    """Nonlinear functions as values by path; arguments of all of them stand one behind the other."""
    functions = model.functions
    ranges = [ends for f in functions for ends in f.ranges]
    return {
        **columns("theta", ("name", "unit", "text"), functions),
        "theta/count": [len(f.signals) for f in functions],
        "theta/signal": [signal for f in functions for signal in f.signals],
        "theta/argument": [argument for f in functions for argument in f.arguments],
        "theta/low": [low for low, _ in ranges],
        "theta/high": [high for _, high in ranges],
        "theta/initial": model.initial,
        "theta/zeta_at_start": model.zeta_at_start,
        **_table_values(functions),
    }


def _table_values(functions: tuple[ThetaFunction, ...]) -> dict[str, Any]:
    """Tables of all functions, one behind the other; without any there are no items."""
    tables = [table for f in functions for table in f.tables]
    if not tables:
        return {}
    return {
        "theta/tables": [len(f.tables) for f in functions],
        "theta/table/count": [len(t.values) for t in tables],
        "theta/table/pairs": [len(t.slopes) for t in tables],
        "theta/table/breakpoint": [x for t in tables for x in t.breakpoints],
        "theta/table/value": [x for t in tables for x in t.values],
        **columns("theta/table", ("below", "above"), tables),
        "theta/table/slope": [pair for t in tables for pair in t.slopes],
    }


def theta_of_items(items: Items, linear: LFTModel) -> DeltaThetaModel:
    """The model with its functions."""
    names, units, formulas, signals, arguments = (
        words(items, f"theta/{name}") for name in ("name", "unit", "text", "signal", "argument")
    )
    low, high = items["theta/low"], items["theta/high"]
    counts = items["theta/count"].tolist()
    if any(count < 1 for count in counts) or sum(counts) != len(signals):
        raise ArchiveError(f"theta/count: expected {len(signals)} together, as many as arguments.")
    if len(set(names)) != len(names):
        raise ArchiveError("theta/name: a name stands twice.")
    if not np.all(low < high):
        raise ArchiveError("theta/low: expected less than theta/high.")
    for formula in formulas:
        parsed(formula)
    ranges = tuple(zip(low.tolist(), high.tolist(), strict=True))
    functions = tuple(
        ThetaFunction(name, signals[at], arguments[at], formula, ranges[at], unit, tables)
        for name, unit, formula, at, tables in zip(
            names, units, formulas, _behind(counts), _tables(items, len(names)), strict=True
        )
    )
    initial, at_start = (tuple(items[f"theta/{name}"].tolist()) for name in ("initial", "zeta_at_start"))
    has_one = any(signal.name == ONE for signal in linear.inputs)
    return DeltaThetaModel(linear, functions, has_one, initial, at_start)


def _tables(items: Items, functions: int) -> list[tuple[Table, ...]]:
    """The tables of each function; an ArchiveError if counts do not agree, or numbers are of no table."""
    if "theta/tables" not in items:
        return [()] * functions
    counts, pairs, below, above, breakpoints, values, slopes = (
        nested(items[f"theta/table/{name}"].tolist())
        for name in ("count", "pairs", "below", "above", "breakpoint", "value", "slope")
    )
    of_functions = items["theta/tables"].tolist()
    for name, numbers, total in (
        ("tables", of_functions, len(counts)),
        ("table/count", counts, len(breakpoints)),
        ("table/pairs", pairs, len(slopes)),
    ):
        if any(n < 0 for n in numbers) or sum(numbers) != total:
            raise ArchiveError(f"theta/{name}: expected {total} together.")
    tables = []
    for k, (at, cubics) in enumerate(zip(_behind(counts), _behind(pairs), strict=True)):
        try:
            tables.append(Table(breakpoints[at], values[at], below[k], above[k], slopes[cubics]))
        except StructureError as error:
            raise ArchiveError(f"theta/table: number {k + 1}: {error}") from None
    return [tuple(tables[at]) for at in _behind(of_functions)]


def _behind(counts: list[int]) -> list[slice]:
    """Slices of so many entries each, one behind the other."""
    return [slice(start, stop) for start, stop in pairwise(accumulate(counts, initial=0))]
