"""Matrix problems and CasADi SX: an SX matrix as texts, and texts as an SX matrix."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.errors import NotRationalError, SceneError, check_known
from mbdlft.base.expression import Binary, Call, Expression, Name, Negative, Number, names, write
from mbdlft.base.parameter import Parameter
from mbdlft.matrix.expressions import Resolved, matrix_values, outside, parts
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.problem.equations import cosines_sines
from mbdlft.problem.sx.constants import FUNCTIONS, literal, pi_times
from mbdlft.problem.sx.tapes import Rules, fold, rules

_DEEPEST = 12  # nesting beyond which a part of an expression gets a name


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

    Raises
    ------
    SceneError
        As `MatrixProblem`; or a symbol is not a parameter.
    NotRationalError
        An operation of an SX matrix is not rational; the message names the entry and the parameters.
    """
    if not isinstance(matrix, ca.SX):
        if symbols is not None:
            raise SceneError("symbols belong to an SX matrix; rows of texts have names.")
        return MatrixProblem(matrix=matrix, parameters=parameters, **fields)
    if "expressions" in fields:
        raise SceneError("expressions belong to rows of texts; an SX matrix has its own.")
    name = str(fields.get("name", "matrix"))
    parameters = tuple(parameters) if isinstance(parameters, Iterable) else parameters
    if not isinstance(parameters, tuple) or not all(isinstance(p, Parameter) for p in parameters):
        raise SceneError(
            f"matrix {name!r}: parameters: expected a list of parameters, got {parameters!r}."
        )
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


class _Node(NamedTuple):
    """An instruction: how its expression is made of those of other nodes, and their numbers."""

    write_node: Callable[..., Expression]
    sources: tuple[int, ...]


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
        self.nodes: list[_Node] = []
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
        uses = Counter(source for node in self.nodes for source in node.sources)
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
        self.nodes.append(_Node(write_node, sources))
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
        for k, node in enumerate(self.nodes):
            if reached & {*node.sources}:
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
