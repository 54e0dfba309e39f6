"""The straight-line program of a model as items, as docs/archive-format.md lists them, and the way back.

Whoever wrote the file, a program that is read here can do nothing but arithmetic on its registers: each
instruction reads what was written before it, and the number of instructions is limited.

Nonlinear functions of a model as items of its group: texts, names and ranges.
"""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.layout import VERSION, Items, floats, integers, texts, word, words
from mbdlft.base.array import Array
from mbdlft.base.errors import ArchiveError, MbdlftWarning, StructureError
from mbdlft.base.formula import parsed
from mbdlft.lft.evaluation import LONGEST, ModelProgram, compact
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
)
from mbdlft.system.model import LFTModel
from mbdlft.system.theta import ONE, DeltaThetaModel, Table, ThetaFunction

# the codes of a file: their order is part of the format
OPERATIONS = (ADD, SUBTRACT, MULTIPLY, DIVIDE, SIZE, MAXIMUM, ROOT, COSINE, SINE)
ONE_SIDED = (SIZE, ROOT, COSINE, SINE)  # what they have on the right does not count
_ITEMS = ("operation", "left", "right", "numbers", "result", "pivots")


def items_of_program(known: ModelProgram) -> Items:
    """The items of a program of a model."""
    return {f"program/{name}": array for name, array in coded(known.program, known.row).items()}


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
        "left": [code(one.left) for one in some],
        "right": [code(one.right) for one in some],
        "result": [code(one) for one in outcome],
        "pivots": [list(pivot) for pivot in program.pivots],
    }
    items: Items = {name: np.array(found, dtype="<i8") for name, found in integers.items()}
    items["pivots"] = items["pivots"].reshape(-1, 2)
    items["operation"] = np.array([OPERATIONS.index(one.operation) for one in some], dtype="i1")
    items["numbers"] = np.array(values, dtype="<f8")
    return {name: items[name] for name in _ITEMS}


def program_of_items(items: Items, inputs: int, lft: LFT, trim: LFT | None) -> ModelProgram | None:
    """The program of a model; None if it has none, or one of a newer version that is not understood.

    `inputs` is the number of its parameters.

    Raises
    ------
    ArchiveError
        An operation is unknown, an operand is not there yet, the sizes do not fit the model, or the
        program is longer than any that is written.
    """
    if "program/operation" not in items:
        return None
    try:
        size = lft.M22.size + (trim.M22.size if trim is not None else 0)
        own = {name: items[f"program/{name}"] for name in _ITEMS}
        return ModelProgram(*decoded(own, inputs, size), lft, trim)
    except ArchiveError as error:
        written = word(items, "@encoding_version")
        if written in ("1.0", VERSION):
            raise
        warnings.warn(
            f"the program of a model of version {written} is left out, and its LFT evaluated: {error}",
            MbdlftWarning,
            stacklevel=2,
        )
        return None


def decoded(items: Items, inputs: int, size: int) -> tuple[Program, Array]:
    """The program of arrays that `coded` makes, with the row (size,) of its constants.

    Raises
    ------
    ArchiveError
        As `program_of_items`.
    """
    operation, left, right, result, pivots = (
        items[name].astype(np.int64) for name in ("operation", "left", "right", "result", "pivots")
    )
    numbers, count = floats(items, "numbers"), len(operation)
    if count > LONGEST:
        raise ArchiveError(f"program has {count} instructions, at most {LONGEST} are run.")
    if not np.all(np.isfinite(numbers)):
        raise ArchiveError("program/numbers has a number that is not finite.")
    _check_operations(operation)
    if len(result) != size:
        raise ArchiveError(
            f"program/result has {len(result)} numbers, the matrices and the trim have {size}."
        )
    known = inputs + np.arange(count)
    for name, operands in (("left", left), ("right", right)):
        _check_operands(f"program/{name}", operands, known, len(numbers))
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
    entries = tuple(((0, k), one) for k, one in enumerate(outcome) if one >= 0)
    kept = tuple(Pivot(*pair) for pair in pivots.tolist())
    return Program(inputs, instructions, entries, kept), row


def _check_operations(operation: NDArray[Any]) -> None:
    unknown = np.flatnonzero((operation < 0) | (operation >= len(OPERATIONS)))
    if len(unknown):
        k = int(unknown[0])
        raise ArchiveError(
            f"program/operation: instruction {k} has the code {operation[k]}, which is unknown; known "
            f"are 0 to {len(OPERATIONS) - 1}."
        )


def _check_operands(what: str, operands: NDArray[Any], known: NDArray[Any], numbers: int) -> None:
    """Raise an ArchiveError unless operands are registers below `known`, or numbers that are there."""
    wrong = np.flatnonzero((operands >= known) | (operands < -numbers))
    if len(wrong):
        k = int(wrong[0])
        one = int(operands[k])
        have = f"number {-1 - one} of {numbers}" if one < 0 else f"register {one}"
        raise ArchiveError(
            f"{what}: entry {k} is {one}, {have}, and only registers below {int(known[k])} are "
            "known there."
        )


def items_of_theta(model: DeltaThetaModel) -> Items:
    """The items of the functions; arguments of all of them stand one behind the other."""
    functions = model.functions
    flat = [
        (signal, argument, low, high)
        for f in functions
        for signal, argument, (low, high) in zip(f.signals, f.arguments, f.ranges, strict=True)
    ]
    return {
        "theta/name": texts([f.name for f in functions]),
        "theta/unit": texts([f.unit for f in functions]),
        "theta/text": texts([f.text for f in functions]),
        "theta/count": np.array([len(f.signals) for f in functions], dtype="<i8"),
        "theta/signal": texts([signal for signal, _, _, _ in flat]),
        "theta/argument": texts([argument for _, argument, _, _ in flat]),
        "theta/low": np.array([low for _, _, low, _ in flat], dtype="<f8"),
        "theta/high": np.array([high for _, _, _, high in flat], dtype="<f8"),
        "theta/initial": np.array(model.initial, dtype="<f8"),
        "theta/zeta_at_start": np.array(model.zeta_at_start, dtype="<f8"),
        **_items_of_tables(functions),
    }


def _items_of_tables(functions: tuple[ThetaFunction, ...]) -> Items:
    """Tables of all functions, one behind the other; without any there are no items."""
    tables = [table for f in functions for table in f.tables]
    if not tables:
        return {}
    slopes = [pair for table in tables for pair in table.slopes]
    return {
        "theta/tables": np.array([len(f.tables) for f in functions], dtype="<i8"),
        "theta/table/count": np.array([len(t.values) for t in tables], dtype="<i8"),
        "theta/table/pairs": np.array([len(t.slopes) for t in tables], dtype="<i8"),
        "theta/table/breakpoint": np.array([x for t in tables for x in t.breakpoints], dtype="<f8"),
        "theta/table/value": np.array([x for t in tables for x in t.values], dtype="<f8"),
        "theta/table/below": np.array([t.below for t in tables], dtype="<f8"),
        "theta/table/above": np.array([t.above for t in tables], dtype="<f8"),
        "theta/table/slope": np.array(slopes, dtype="<f8").reshape(-1, 2),
    }


def _tables_of_items(items: Items, functions: int) -> list[tuple[Table, ...]]:
    """The tables of each function.

    Raises
    ------
    ArchiveError
        Counts do not agree, or numbers are those of no table.
    """
    if "theta/tables" not in items:
        return [()] * functions
    breakpoints, values, below, above = (
        floats(items, f"theta/table/{key}").tolist()
        for key in ("breakpoint", "value", "below", "above")
    )
    counts, pairs, owned = (
        integers(items, f"theta/{key}") for key in ("table/count", "table/pairs", "tables")
    )
    slopes = [(float(a), float(b)) for a, b in floats(items, "theta/table/slope")]
    for key, numbers, total in (
        ("tables", owned, len(counts)),
        ("table/count", counts, len(breakpoints)),
        ("table/pairs", pairs, len(slopes)),
    ):
        if any(n < 0 for n in numbers) or sum(numbers) != total:
            raise ArchiveError(f"theta/{key}: expected {total} together.")
    found, point, pair = [], 0, 0
    for k, (n, m) in enumerate(zip(counts, pairs, strict=True)):
        at, of = (tuple(x[point : point + n]) for x in (breakpoints, values))
        try:
            found.append(Table(at, of, below[k], above[k], tuple(slopes[pair : pair + m])))
        except StructureError as error:
            raise ArchiveError(f"theta/table: number {k + 1}: {error}") from None
        point, pair = point + n, pair + m
    behind = np.cumsum(owned).tolist()
    return [tuple(found[b - n : b]) for n, b in zip(owned, behind, strict=True)]


def theta_of_items(items: Items, linear: LFTModel) -> DeltaThetaModel:
    """The model with its functions.

    Raises
    ------
    ArchiveError
        Counts do not agree, a name stands twice, a range is empty.
    SceneError, StructureError
        A text is no formula, a signal is not one of the model.
    """
    names, units, formulas = (words(items, f"theta/{key}") for key in ("name", "unit", "text"))
    signals, arguments = words(items, "theta/signal"), words(items, "theta/argument")
    low, high = floats(items, "theta/low"), floats(items, "theta/high")
    counts = integers(items, "theta/count")
    if any(count < 1 for count in counts) or sum(counts) != len(signals):
        raise ArchiveError(f"theta/count: expected {len(signals)} together, as many as arguments.")
    if len(set(names)) != len(names):
        raise ArchiveError("theta/name: a name stands twice.")
    if not np.all(low < high):
        raise ArchiveError("theta/low: expected less than theta/high.")
    found, start = [], 0
    tables = _tables_of_items(items, len(names))
    rows = zip(names, units, formulas, counts, tables, strict=True)
    for name, unit, formula, count, own_tables in rows:
        part = slice(start, start + count)
        ranges = tuple(zip(low[part].tolist(), high[part].tolist(), strict=True))
        parsed(formula)
        own = (tuple(signals[part]), tuple(arguments[part]))
        found.append(ThetaFunction(name, *own, formula, ranges, unit, own_tables))
        start += count
    initial = tuple(floats(items, "theta/initial").tolist())
    at_start = tuple(floats(items, "theta/zeta_at_start").tolist())
    has_one = any(signal.name == ONE for signal in linear.inputs)
    return DeltaThetaModel(linear, tuple(found), has_one, initial, at_start)
