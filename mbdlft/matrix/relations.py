"""The front end for matrices: from a matrix of expressions to the problem that the pipeline solves.

Its values come from balls of 50 digits, without any LFT, with what rounding changes in them.
An SX matrix becomes texts, and texts an SX matrix.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import casadi as ca
import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, SceneError, WellPosednessError, check_known
from mbdlft.base.expression import Binary, Call, Expression, Name, Negative, Number, names, write
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import SEED, check_points
from mbdlft.exact.numbers import decimal, precision
from mbdlft.exact.operators import Operators
from mbdlft.exact.rounding import or_one
from mbdlft.matrix.expressions import (
    Resolved,
    check_denominators,
    entry_place,
    matrix_values,
    outside,
    parts,
    resolve,
)
from mbdlft.matrix.problem import MatrixProblem, matrix_to_toml
from mbdlft.matrix.rational import expanded_matrix, least_forms
from mbdlft.problem.digits import BITS, Balls, ball, rounded, transfers_of
from mbdlft.problem.equations import cosines_sines
from mbdlft.problem.references import NEGLIGIBLE, transfers
from mbdlft.problem.relations import Form, LinearModel, Nouns, Problem, Reference, Stage
from mbdlft.problem.sx.constants import FUNCTIONS, literal, pi_times
from mbdlft.problem.sx.tapes import Rules, fold, rules

_SCALINGS = 10  # of rows and columns; each halves the digits in which they differ
_MORE_BITS = 2400  # terms up to 1e308 may cancel to 1e-280, and 130 digits are left
_CLEAR = 100  # bits of an entry, of its `BITS`, that rounding of its terms has left
_LEAST = 1e-280  # of an entry: its rounding is a float, too


def problem_of_matrix(matrix: MatrixProblem, stage: Stage = nullcontext) -> Problem:
    """The entries of a matrix as relations, written in several ways, and its values in 50 digits."""
    parameters = tuple(sorted(matrix.parameters, key=lambda p: p.name))
    with stage("resolve"):
        resolved = resolve(matrix)
        check_denominators(matrix, resolved)
        scaled = _scaled(matrix, resolved, parameters)
        forms = tuple(_forms(matrix, resolved, scaled.factors))
    states, inputs, outputs = matrix.signals()
    return Problem(
        nouns=Nouns(
            "matrix",
            matrix.name,
            "the matrix",
            "its numbers are so different in size that double precision does not carry them",
        ),
        description=matrix.description,
        text=matrix_to_toml(matrix),
        states=states,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        forms=forms,
        more_forms=lambda: tuple(least_forms(matrix, resolved, scaled.rows, scaled.columns)),
        points=scaled.points,
        reference=lambda: scaled.reference,
        row_units=scaled.rows,
        column_units=scaled.columns,
    )


class _Scaled(NamedTuple):
    """Values of a matrix, and how it is scaled."""

    points: Array  # (N, n_p), physical
    reference: Reference  # values at the points
    rows: Array  # powers of two by which rows are divided
    columns: Array  # and columns
    factors: Array  # (rows, columns), by which entries are multiplied for that


def _scaled(matrix: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter]) -> _Scaled:
    points = check_points(parameters, SEED)
    in_balls = _values_in_digits(matrix, resolved, parameters, points)
    values, terms, states = in_balls.values, in_balls.sizes, len(matrix.signals()[0])
    largest = np.max(np.abs(values), axis=0)
    rows, columns = _units(values)
    # smaller values are negligible beside what parameters change in the row and the column
    both = np.outer(rows, columns)
    least = NEGLIGIBLE * both
    scale = np.where(largest > 0.0, np.maximum(largest, least), both)

    def in_digits(some: Sequence[int], frequencies: Array) -> NDArray[np.complex128]:
        with precision(BITS):
            return transfers_of([in_balls.balls[k] for k in some], states, frequencies)

    reference = Reference(
        values=values,
        scale=scale,
        if_cancelled=lambda: scale,
        sizes=lambda: terms,
        least=least,
        trimmed=np.zeros((len(points), 0)),
        trim_scale=np.zeros(0),
        transfers=lambda some, frequencies: transfers(values[list(some)], states, frequencies),
        transfers_in_digits=in_digits,
    )
    return _Scaled(points, reference, rows, columns, 1.0 / both)


def _units(values: Array) -> tuple[Array, Array]:
    """What parameters change in each row and column at most: values (N, rows, columns); Ruiz 2001."""
    change = np.max(np.abs(values - values[0]), axis=0)
    rows, columns = np.ones(len(change)), np.ones(change.shape[1])
    for _ in range(_SCALINGS):
        scaled = change / rows[:, None] / columns
        rows *= np.sqrt(or_one(np.max(scaled, axis=1)))
        columns *= np.sqrt(or_one(np.max(scaled, axis=0)))
    first, second = (np.ldexp(1.0, np.rint(np.log2(size)).astype(int)) for size in (rows, columns))
    return first, second


def _forms(matrix: MatrixProblem, resolved: Resolved, factors: Array) -> Iterator[Form]:
    """The divided matrix as it is written and expanded, from its rows and from its columns, where
    products meet in opposite orders.
    """
    for form in (written_matrix, expanded_matrix):
        q = ca.SX.sym("q", len(matrix.parameters))
        written = form(matrix, resolved, q)
        if written is None:
            continue
        for is_transposed in (False, True):
            entries = ca.DM(factors) * written
            entries = entries.T if is_transposed else entries
            known, nothing = ca.SX.sym("input", entries.shape[1]), ca.SX(0, 1)
            relations = LinearModel(nothing, entries @ known, nothing, known, q, tuple(matrix.parameters))
            yield Form(relations, is_transposed=is_transposed)


class MatrixValues(NamedTuple):
    """Values of a matrix at N points."""

    values: Array  # (N, rows, columns)
    sizes: Array  # (N, rows, columns), of the values if nothing cancelled in sums
    balls: Balls  # (N, rows, columns), the values before they are rounded


class Sized(Operators):
    """A value and its size; ``+ - * /`` as for numbers.

    The size of a number is its own. Sizes of terms add up; of two factors the one counts in which
    more cancelled. Rounding of all numbers changes the value by about 2.2e-16 of the size.
    """

    __slots__ = ("size", "value")
    __array_ufunc__ = None

    def __init__(self, value: Any, size: Any) -> None:
        self.value, self.size = value, size

    @staticmethod
    def of(number: Any) -> "Sized":
        """A number or array, of its own size."""
        return number if isinstance(number, Sized) else Sized(number, np.abs(number))

    def __add__(self, other: "Sized | float") -> "Sized":
        o = Sized.of(other)
        return Sized(self.value + o.value, self.size + o.size)

    def __neg__(self) -> "Sized":
        return Sized(-self.value, self.size)

    def __mul__(self, other: "Sized | float") -> "Sized":
        o = Sized.of(other)
        size = np.maximum(np.abs(self.value) * o.size, self.size * np.abs(o.value))
        return Sized(self.value * o.value, size)

    def __truediv__(self, other: "Sized | float") -> "Sized":
        o = Sized.of(other)
        if isinstance(o.value, float) and o.value == 0.0:
            raise SceneError("division by zero in a constant.")
        inverse = 1.0 / o.value
        return self * Sized(inverse, o.size * inverse * inverse)


def _values_in_digits(
    problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter], points: Array
) -> MatrixValues:
    """The matrix at physical points (N, n_p), the numbers in its texts taken as decimals.

    Functions of constants and of angles have all digits, too. An entry that loses digits, as its terms
    cancel, is computed with more bits; if it may be zero then, it is.
    """
    balls = _in_balls(problem, resolved, parameters, points, BITS)
    # bits that are right: not above 0 where a ball may be zero and is not known to be
    bits = np.vectorize(lambda x: min(int(x.rel_accuracy_bits()), _MORE_BITS), otypes=[int])(balls)
    lost = np.any(bits < _CLEAR, axis=0)
    if np.any(lost):
        entries = tuple(
            tuple(entry if lost[i, j] else Number(0.0) for j, entry in enumerate(row))
            for i, row in enumerate(resolved.entries)
        )
        more = replace(resolved, entries=entries)
        again = _in_balls(problem, more, parameters, points, _MORE_BITS)
        balls = np.where(lost, again, balls)
    values = np.vectorize(rounded, otypes=[float])(balls)
    sizes = _sizes(problem, resolved, parameters, points)
    _check_sizes(problem, np.max(np.abs(values), axis=0), np.max(sizes, axis=0))
    return MatrixValues(values, sizes, balls)


def _in_balls(
    problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter], points: Array, bits: int
) -> Balls:
    """Values (N, ., .) with so many bits."""
    with precision(bits):
        known: dict[str, Any] = {k: ball(decimal(x)) for k, x in problem.constant_values().items()}
        known |= {"pi": flint.arb.pi(), "deg": flint.arb.pi() / 180}
        for k, p in enumerate(parameters):
            physical = np.array([flint.arb(x) for x in points[:, k].tolist()], dtype=object)
            known[p.name] = physical
            if p.is_angle:
                angles = physical * (known["deg"] if p.unit == "deg" else 1)
                both = ([x.cos() for x in angles], [x.sin() for x in angles])
                known |= parts(p.name, *(np.array(x, dtype=object) for x in both))
        rows = matrix_values(problem, resolved, known, lambda x: ball(decimal(x)), _FUNCTIONS)
        balls = _stacked(rows, len(points), object)
    is_finite = np.vectorize(lambda x: x.is_finite() and abs(float(x)) < np.inf, otypes=[bool])(balls)
    if not np.all(is_finite):
        k, i, j = np.argwhere(~is_finite)[0]
        raise WellPosednessError(
            f"{entry_place(problem, i, j)}: is not finite at "
            f"{', '.join(f'{p.name} = {x:g}' for p, x in zip(parameters, points[k], strict=True))}."
        )
    return balls


_FUNCTIONS = {name: getattr(flint.arb, name) for name in ("cos", "sin", "atan", "sqrt")}


def _sizes(
    problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter], points: Array
) -> Array:
    """Sizes (N, ., .) of the entries if nothing cancelled but numbers."""
    known: dict[str, Any] = dict(problem.constant_values())
    for k, p in enumerate(parameters):
        known[p.name] = Sized.of(points[:, k])
        if p.is_angle:
            angle = points[:, k] * p.factor
            known |= parts(p.name, Sized.of(np.cos(angle)), Sized.of(np.sin(angle)))
    with np.errstate(all="ignore"):
        rows = matrix_values(problem, resolved, known, float)
        return _stacked([[Sized.of(entry).size for entry in row] for row in rows], len(points), float)


def _check_sizes(problem: MatrixProblem, largest: Array, terms: Array) -> None:
    """Raise a SceneError if an entry is too small, or its terms too large, for a float."""
    for i, j in np.ndindex(problem.shape):
        if not np.isfinite(terms[i, j]) or 0.0 < largest[i, j] < _LEAST:
            raise SceneError(
                f"{entry_place(problem, i, j)} has the size {largest[i, j]:.3g}, and its terms "
                f"{terms[i, j]:.3g}. Expected at least {_LEAST:g}, or zero, and finite terms. Choose "
                "other units."
            )


def _stacked(rows: Sequence[Sequence[Any]], count: int, kind: type) -> NDArray[Any]:
    """Entries, one number or `count` of them each, as an array (count, rows, columns) of a kind."""
    entries: list[list[NDArray[Any]]] = [
        [np.broadcast_to(np.asarray(entry, dtype=kind), count) for entry in r] for r in rows
    ]
    return np.moveaxis(np.array(entries), 2, 0)


_DEEPEST = 12  # nesting beyond which a part of an expression gets a name


@arguments_checked
def matrix_problem(
    matrix: Any,
    parameters: Sequence[Parameter] = (),
    *,
    symbols: Mapping[str, ca.SX] | None = None,
    **fields: Any,
) -> MatrixProblem:
    """Matrix problem of rows of numbers and texts, or of a CasADi SX matrix.

    Parameters
    ----------
    matrix : rows of numbers or expressions, or SX
    parameters : sequence of `Parameter` and `Angle`
    symbols : mapping of names of parameters to SX symbols, optional
        For an SX matrix whose symbols are not named like the parameters.
    fields
        The other fields of `MatrixProblem`.
    """
    if not isinstance(matrix, ca.SX):
        if symbols is not None:
            raise SceneError("symbols belong to an SX matrix; rows of texts have names.")
        return MatrixProblem(matrix=matrix, parameters=parameters, **fields)
    if "expressions" in fields:
        raise SceneError("expressions belong to rows of texts; an SX matrix has its own.")
    name = str(fields.get("name", "matrix"))
    parameters = tuple(parameters)
    symbols = {} if symbols is None else symbols
    if not isinstance(symbols, Mapping) or not all(
        isinstance(name, str) and isinstance(x, ca.SX) and x.is_scalar() and x.is_symbolic()
        for name, x in symbols.items()
    ):
        raise SceneError(
            f"matrix {name!r}: symbols: expected SX symbols by the names of parameters, such as "
            f"{{'m': m}}, got {symbols!r}."
        )
    constants = fields.get("constants")
    taken = {p.name for p in parameters} | set(constants if isinstance(constants, Mapping) else ())
    symbolic = _Texts(name, matrix, parameters, symbols, taken)
    return MatrixProblem(
        matrix=symbolic.rows, expressions=symbolic.shared, parameters=parameters, **fields
    )


def written_matrix(problem: MatrixProblem, resolved: Resolved, q: ca.SX) -> ca.SX:
    """The matrix as it is written, in the internal values q (n_p,) of the parameters."""
    cosine, sine = cosines_sines(problem.parameters, q)
    values: dict[str, Any] = {name: literal(value) for name, value in problem.constant_values().items()}
    values |= {"pi": pi_times(1), "deg": pi_times(Fraction(1, 180))}
    for k, parameter in enumerate(problem.parameters):
        if parameter.is_angle:
            values |= parts(parameter.name, cosine[k], sine[k])
        else:
            values[parameter.name] = q[k]
    rows = matrix_values(problem, resolved, values, literal, FUNCTIONS)
    return ca.vertcat(*(ca.horzcat(*(ca.SX(entry) for entry in row)) for row in rows))


class _Texts:
    """The instructions of an SX matrix as expressions; what is used twice gets a name."""

    def __init__(
        self,
        name: str,
        matrix: ca.SX,
        parameters: Sequence[Parameter],
        symbols: Mapping[str, ca.SX],
        taken: set[str],
    ) -> None:
        self.name, self.taken = name, taken
        self.angles = {p.name for p in parameters if p.is_angle}
        self.parameters = {p.name for p in parameters}
        self.shared: dict[str, str] = {}
        self.depends: dict[str, frozenset[str]] = {}
        # how its expression is made of those of other nodes, and their numbers
        self.nodes: list[tuple[Callable[..., Expression], tuple[int, ...]]] = []
        if 0 in matrix.shape:
            self.rows: list[list[float | str]] = []
            return
        free, self.free_names = self._free(matrix, symbols)
        self.shape = matrix.shape
        self.tape = ca.Function("matrix", [free], [ca.densify(matrix)])
        by_columns = np.array(self._run(), dtype=object).reshape(self.shape[::-1])
        self.rows = by_columns.T.tolist()

    def _free(self, matrix: ca.SX, symbols: Mapping[str, ca.SX]) -> tuple[ca.SX, list[str]]:
        where = f"matrix {self.name!r}"
        check_known("parameter", symbols, self.parameters, f"{where}, symbols")
        free, used = [], []
        for symbol in ca.symvar(matrix):
            matching = [name for name, item in symbols.items() if ca.is_equal(item, symbol)]
            name = matching[0] if matching else symbol.name()
            check_known("symbol", [name], self.parameters, where)
            if name in used:
                raise SceneError(
                    f"{where}: two symbols are named {name!r}. Use one symbol for each "
                    "parameter, or tell them apart with symbols={'parameter': symbol}."
                )
            free.append(symbol)
            used.append(name)
        return ca.vertcat(ca.SX(0, 1), *free), used

    def _run(self) -> list[float | str]:
        """Texts of the entries, by columns: first a node for each instruction, then names for nodes."""
        inputs = [self._node(partial(Name, name)) for name in self.free_names]
        (self.entries,) = fold(self.tape, self._rules(), inputs)
        uses = Counter(source for _, sources in self.nodes for source in sources)
        uses.update(self.entries)
        done: list[tuple[Expression, int]] = []  # and the depth
        for k, (write_node, sources) in enumerate(self.nodes):
            self.node = k
            expression = write_node(*(done[source][0] for source in sources))
            depth = 1 + max((done[source][1] for source in sources), default=-1)
            done.append(self._named(expression, depth, uses[k]) if sources else (expression, 0))
        texts = [done[k][0] for k in self.entries]
        return [e.value if isinstance(e, Number) else write(e) for e in texts]

    def _node(self, write_node: Callable[..., Expression], *sources: int) -> int:
        self.nodes.append((write_node, sources))
        return len(self.nodes) - 1

    def _rules(self) -> Rules:
        """Nodes, by their numbers, as a number system."""
        node = partial(partial, self._node)  # the rule that makes a node of a way to write it
        binary = {name: node(partial(Binary, sign)) for name, sign in _BINARY.items()}
        return rules(
            lambda value: self._node(partial(self._constant, value)),
            missing=lambda name, _, *sources: self._node(partial(self._refuse, name), *sources),
            neg=node(Negative),
            sq=node(lambda a: Binary("*", a, a)),
            sin=node(partial(self._call, "sin")),
            cos=node(partial(self._call, "cos")),
            **binary,
        )

    def _constant(self, value: float) -> Expression:
        if not math.isfinite(value):
            raise SceneError(
                f"matrix {self.name!r}: the constant {value} is not a finite number. A division by a "
                "constant that is zero gives one."
            )
        return Number(value) if value >= 0 else Negative(Number(-value))  # no negative literals

    def _call(self, function: str, argument: Expression) -> Expression:
        if self._parameters(argument) <= outside(argument) & self.angles:
            return Call(function, argument)
        return self._refuse(function, argument)

    def _refuse(self, operation: str, *operands: Expression) -> Expression:
        used = sorted({name for operand in operands for name in self._parameters(operand)})
        reached = {self.node}
        for k, (_, sources) in enumerate(self.nodes):
            if reached & {*sources}:
                reached.add(k)
        first = next(entry for entry, k in enumerate(self.entries) if k in reached)
        j, i = divmod(first, self.shape[0])
        raise NotRationalError(
            f"matrix {self.name!r}, entry ({i}, {j}): {operation} is not a rational operation "
            f"(parameters: {', '.join(used) or 'none'}). Declare the whole function value as a "
            "parameter instead."
        )

    def _parameters(self, expression: Expression) -> frozenset[str]:
        parameters: set[str] = set()
        for name in names(expression):
            parameters |= self.depends.get(name, frozenset({name}))
        return frozenset(parameters)

    def _named(self, expression: Expression, depth: int, uses: int) -> tuple[Expression, int]:
        """The expression, or its name if it is used more than once or is deeply nested.

        What has an angle outside of sin and cos keeps its form: sums of angles have no name.
        """
        bare = outside(expression) & self.angles
        if bare or (uses < 2 and depth <= _DEEPEST):
            return expression, depth
        numbered = (f"e{number}" for number in count(len(self.shared) + 1))
        name = next(name for name in numbered if name not in self.taken)
        self.taken.add(name)
        self.shared[name] = write(expression)
        self.depends[name] = self._parameters(expression)
        return Name(name), 0


_BINARY = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
