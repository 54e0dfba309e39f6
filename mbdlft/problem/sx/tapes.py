"""The fold over SX tapes: the instructions of a CasADi function, followed in any number system.

A number system is one table of rules (`Rules`): how it makes an element of a constant, and what each
operation makes of elements. Rules are found by the names of CasADi's operations, `casadi.OP_ADD` is
"add". An operation without a rule is refused by name.

Values at many points are one such fold. For few points the function is called. For many its instructions
are run one after the other, each on a vector of points, as those of an LFT are
(`mbdlft/lft/program/tape.py`): that does without the zeros of dense results and without the calls of a
virtual machine. The sizes of the terms of which results are sums are another fold.
"""

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise, starmap
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError
from mbdlft.exact.operators import FUNCTIONS_OF_DOUBLES
from mbdlft.lft.program.tape import (
    COSINE,
    DIVIDE,
    MULTIPLY,
    ROOT,
    SINE,
    SIZE,
    SUBTRACT,
    Plan,
    Program,
    Tape,
    plan,
    run,
)

_NAMES = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}

Rule = Callable[..., Any]


class Rules(NamedTuple):
    """A number system."""

    constant: Rule  # makes an element of a float
    operations: Mapping[str, Rule]  # by the names of operations, functions of elements
    # what an operation without a rule gives, or raises: it gets the name of the operation, a text
    # that tells its place, too, and the elements
    missing: Rule


def refused(operation: str, where: str, *operands: Any) -> Any:
    """Raise a NotRationalError for an operation without a rule; `Rules.missing` by default."""
    raise NotRationalError(
        f"{where} has no rule in this number system. Write the function with + - * /, integer powers "
        "up to 100, sqrt, sin, cos and tan."
    )


def rules(
    constant: Rule, *, add: Rule, mul: Rule, div: Rule, missing: Rule = refused, **others: Rule
) -> Rules:
    """The table of a number system; rules of -a, a - b, 2a, a^2, 1/a follow where not given."""
    neg: Rule = others.get("neg") or (lambda a: mul(constant(-1.0), a))
    follow: dict[str, Rule] = {
        "assign": lambda a: a,
        "neg": neg,
        "sub": lambda a, b: add(a, neg(b)),
        "twice": lambda a: mul(constant(2.0), a),
        "sq": lambda a: mul(a, a),
        "inv": lambda a: div(constant(1.0), a),
    }
    return Rules(constant, {**follow, "add": add, "mul": mul, "div": div, **others}, missing)


def arithmetic(number: Rule, functions: Mapping[str, Rule]) -> Rules:
    """The table of a number system that has + - * / with floats.

    `number` makes one of a float; `functions` are others, such as "sqrt". Constants stay floats, of
    which results are made before anything is done with floats alone, so that rounding is counted.
    """

    def counted(rule: Rule) -> Rule:
        return lambda *x: rule(*(map(number, x) if all(isinstance(a, float) for a in x) else x))

    operations: dict[str, Rule] = {"neg": operator.neg}
    operations |= {"tan": lambda a: functions["sin"](a) / functions["cos"](a), **functions}
    operations |= {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}
    return rules(float, **{name: counted(rule) for name, rule in operations.items()})


@lru_cache(maxsize=8)  # few are folded more than once, but those again and again
def steps(function: ca.Function) -> tuple[tuple[str, Any, Sequence[Any]], ...]:
    """The instructions of a function of SX: operation, register of the result, registers of operands.

    An "input" has the numbers of an argument and its entry for operands, a "const" its value; the target
    of an "output" are the numbers of a result and its entry.
    """
    instructions = []
    for k in range(function.n_instructions()):
        operation, targets = _NAMES[function.instruction_id(k)], function.instruction_output(k)
        sources: Any = function.instruction_input(k)
        if operation == "const":
            sources = [float(function.instruction_constant(k))]
        instructions.append((operation, targets if operation == "output" else targets[0], sources))
    return tuple(instructions)


def fold(function: ca.Function, table: Rules, *arguments: Any) -> list[list[Any]]:
    """Results of a function of SX in a number system, a list of elements for each.

    Elements stand by columns, those of results without structural zeros; arguments are sequences, or
    arrays whose rows are elements. An operation without a rule raises what the table says, by default a
    NotRationalError.
    """
    work: list[Any] = [None] * function.sz_w()
    results: list[list[Any]] = [[None] * function.nnz_out(k) for k in range(function.n_out())]
    constant, operations = table.constant, table.operations
    for k, (operation, target, sources) in enumerate(steps(function)):
        if operation == "input":
            argument, entry = sources
            work[target] = arguments[argument][entry]
        elif operation == "const":
            work[target] = constant(sources[0])
        elif operation == "output":
            result, entry = target
            results[result][entry] = work[sources[0]]
        elif (rule := operations.get(operation)) is None:
            where = f"OP_{operation.upper()} at instruction {k} of {function.name()!r}"
            work[target] = table.missing(operation, where, *(work[source] for source in sources))
        elif len(sources) == 1:
            work[target] = rule(work[sources[0]])
        else:
            work[target] = rule(work[sources[0]], work[sources[1]])
    return results


MANY = 256  # points from which on making vectors of them is worth it
_LONGEST = 50_000  # instructions; reading one takes some microseconds
_SHORTEST, _NEAR = 64, 2**17  # points of a chunk, and numbers of one


class Vectors(NamedTuple):
    """A function whose arguments are columns, as a program for vectors of points."""

    plan: Plan  # of the entries that depend on arguments
    # (number of these,), where they stand in all results one behind the other, row by row
    places: NDArray[np.intp]
    # (numbers in all results,), the other entries; 0 where one depends on arguments
    constant: Array


def evaluate_many(function: ca.Function, points: Array, *others: Array) -> list[Array]:
    """Values of a function of column vectors at many points, each (N, rows, columns); all are dense."""
    program = vectors(function) if len(points) >= MANY else None
    if program is None:
        return _called(function, points, *others)
    values = np.tile(program.constant, (len(points), 1))
    values[:, program.places] = _varying(program, points, *others).T
    return _parts(function, values)


def _called(function: ca.Function, *points: Array) -> list[Array]:
    """Values by one call for all points, each of the dense results (N, rows, columns)."""
    count = len(points[0])
    # CasADi's matrices are by columns, and those of the points beside each other
    shapes = [(count, *function.size_out(k)[::-1]) for k in range(function.n_out())]
    if not count:
        return [np.empty(shape).transpose(0, 2, 1) for shape in shapes]
    results = BufferedCall(function.map(count))(*map(np.ravel, points))
    pairs = zip(results, shapes, strict=True)
    return [result.reshape(shape).transpose(0, 2, 1) for result, shape in pairs]


class BufferedCall:
    """A function of dense column vectors, called on buffers: 1 us where matrices of CasADi take 80.

    Results are the entries of its matrices that are not always zero, by columns, until the next call.
    """

    def __init__(self, function: ca.Function) -> None:
        self._arguments = [np.empty(function.numel_in(k)) for k in range(function.n_in())]
        self._results = [np.empty(function.nnz_out(k)) for k in range(function.n_out())]
        buffer: Any = function.buffer()
        self._memory, self._call = buffer  # the call does not keep the memory
        for k, argument in enumerate(self._arguments):
            self._memory.set_arg(k, argument.data)
        for k, result in enumerate(self._results):
            self._memory.set_res(k, result.data)

    def __call__(self, *values: Array) -> list[Array]:
        for argument, value in zip(self._arguments, values, strict=True):
            argument[:] = value
        self._call()
        return self._results


def evaluate_in_chunks(
    function: ca.Function, points: Array, *others: Array
) -> Iterator[tuple[slice, list[Array]]]:
    """As `evaluate_many`, by chunks that stay near a core; the next one overwrites the values."""
    count = len(points)
    program = vectors(function) if count >= MANY else None
    if program is None:
        yield slice(0, count), evaluate_many(function, points, *others)
        return
    varying = _varying(program, points, *others)
    size = max(_SHORTEST, _NEAR // max(1, len(program.constant)))
    values = np.tile(program.constant, (min(size, count), 1))
    for start in range(0, count, size):
        chunk = slice(start, min(start + size, count))
        now = values[: chunk.stop - start]
        now[:, program.places] = varying[:, chunk].T
        yield chunk, _parts(function, now)


def _varying(program: Vectors, points: Array, *others: Array) -> Array:
    """Entries that depend on arguments, (number of entries, N)."""
    values = np.empty((len(program.places), len(points)))
    run(program.plan, np.hstack([points, *others]), values.T[:, None, :])
    return values


def _parts(function: ca.Function, values: Array) -> list[Array]:
    """The results (N, rows, columns) in values that stand one behind the other (N, all)."""
    shapes = [function.size_out(k) for k in range(function.n_out())]
    results = np.split(values, np.cumsum([rows * columns for rows, columns in shapes])[:-1], axis=1)
    return [result.reshape(len(values), *shape) for result, shape in zip(results, shapes, strict=True)]


@lru_cache(maxsize=8)  # a sweep asks for the same ones again and again
def vectors(function: ca.Function) -> Vectors | None:
    """The program of a function of SX; nothing if it is long, or has an operation without one here."""
    count = function.n_instructions() if function.is_a("SXFunction") else _LONGEST + 1
    if count > _LONGEST or not all(function.sparsity_in(k).is_dense() for k in range(function.n_in())):
        return None
    starts = np.cumsum([0, *(function.numel_in(k) for k in range(function.n_in()))]).tolist()
    tape = Tape(starts[-1], _LONGEST)
    try:
        results = fold(function, program_rules(tape), *starmap(range, pairwise(starts)))
    except NotRationalError:
        return None
    constant = np.zeros(sum(function.numel_out(k) for k in range(function.n_out())))
    entries: dict[int, int] = {}
    start = 0
    for k, result in enumerate(results):
        for place, value in zip(_row_by_row(function.sparsity_out(k)), result, strict=True):
            if isinstance(value, float):
                constant[start + place] = value
            else:
                entries[start + place] = value
        start += function.numel_out(k)
    columns = tuple(((0, k), register) for k, register in enumerate(entries.values()))
    program = Program(tape.inputs, tuple(tape.instructions), columns, ())
    return Vectors(plan(program), np.array(list(entries), dtype=np.intp), constant)


def program_rules(tape: Tape) -> Rules:
    """Registers of a program, and numbers, as a number system: each operation is written down."""

    def written(operation: str) -> Rule:
        return lambda a, b=0.0: tape.put(operation, a, b)

    return rules(
        float,
        add=tape.add,
        sub=written(SUBTRACT),
        mul=written(MULTIPLY),
        div=written(DIVIDE),
        neg=lambda a: tape.put(SUBTRACT, 0.0, a),
        fabs=written(SIZE),
        sqrt=written(ROOT),
        cos=written(COSINE),
        sin=written(SINE),
    )


def _row_by_row(sparsity: ca.Sparsity) -> list[int]:
    """Places of the entries of a matrix, which CasADi has column by column, in its rows."""
    rows, columns = sparsity.get_triplet()
    return [i * sparsity.size2() + j for i, j in zip(rows, columns, strict=True)]


Pair = tuple[Any, Any]  # a value and its size: numbers (N,), or one for all points
_OUTGROWN = 2.0**20  # times the largest value of a function: larger sizes are looked at again
_SHAKES, _SHAKE = 8, 2.0**-30  # how often each step is changed, and by which part of its result
_LONG = 8.0  # times what is felt: changes of many terms cancel in part


def term_sizes(tape: ca.Function, *points: Array) -> Array:
    """Sizes (N, entries) of the result of a function if nothing cancelled: |a| + |b| for a + b.

    The arguments are columns, each (N, rows); the columns of a result, without structural zeros, stand
    one below the other. A root has the root of the size; another function of a number has the size of its
    own value.

    Along a chain of turned frames sizes grow by a factor for each turn, and rounding does not: where they
    have outgrown all values, they are no more than what rounding of every step is felt as (a stochastic
    arithmetic: Vignes, Mathematics and Computers in Simulation 35, 1993).
    """
    arguments = [[_of_itself(x) for x in np.ascontiguousarray(columns.T)] for columns in points]
    values, sizes = np.empty((2, tape.nnz_out(0), len(points[0])))
    for k, pair in enumerate(fold(tape, _SIZES, *arguments)[0]):
        values[k], sizes[k] = pair
    if np.any(sizes > _OUTGROWN * np.max(np.abs(values), axis=0, initial=0.0)):
        sizes = np.fmin(sizes, np.maximum(np.abs(values), felt_terms(tape, *points)))
    return sizes.T


def felt_terms(tape: ca.Function, *points: Array) -> Array:
    """How far results (entries, N) move when the result of each step does, in parts of its change."""
    random = np.random.default_rng(0)

    def shaken(value: Any) -> Array:
        changes = random.uniform(-1.0, 1.0, (_SHAKES, len(points[0])))
        return np.asarray(value * (1.0 + _SHAKE * changes))

    def of(rule: Rule) -> Rule:
        return lambda *x: shaken(rule(*x))

    exact: dict[str, Rule] = {"add": operator.add, "sub": operator.sub, "mul": operator.mul}
    exact |= {"div": operator.truediv, **FUNCTIONS_OF_DOUBLES}
    table = rules(shaken, **{name: of(rule) for name, rule in exact.items()}, neg=operator.neg)
    arguments = [[shaken(x) for x in np.ascontiguousarray(columns.T)] for columns in points]
    moved = np.empty((tape.nnz_out(0), len(points[0])))
    with np.errstate(all="ignore"):  # what is no number moves by nothing that is known
        for row, value in zip(moved, fold(tape, table, *arguments)[0], strict=True):
            row[:] = np.ptp(value, axis=0)
    return _LONG * moved / _SHAKE


def _of_itself(value: Any) -> Pair:
    return value, np.abs(value)


def _function(values: Rule) -> Rule:
    return lambda *pairs: _of_itself(values(*(value for value, _ in pairs)))


_SIZES = rules(
    lambda value: _of_itself(np.float64(value)),
    add=lambda x, y: (x[0] + y[0], x[1] + y[1]),
    sub=lambda x, y: (x[0] - y[0], x[1] + y[1]),
    neg=lambda x: (-x[0], x[1]),
    mul=lambda x, y: (x[0] * y[0], x[1] * y[1]),
    div=lambda x, y: (x[0] / y[0], x[1] * y[1] / (y[0] * y[0])),
    **{name: _function(values) for name, values in FUNCTIONS_OF_DOUBLES.items()}
    | {"fabs": lambda x: (np.abs(x[0]), x[1]), "sqrt": lambda x: (np.sqrt(x[0]), np.sqrt(x[1]))},
)
