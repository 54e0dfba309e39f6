"""From the tape of linear relations to an LFT; the last place that knows CasADi.

The tape becomes a signal graph: signals are unknowns of a sparse linear system, parameters are channels.

A coefficient depends on parameters only; a signal is linear in the inputs. Both are hash-consed, so
equal sub-expressions exist once. Coefficient times signal:

    constant c          scale
    parameter p_k       one channel, w = p_k z
    a + b               apply(a, s) + apply(b, s)
    a b                 apply(a, apply(b, s))
    a / b               y with apply(b, y) = s, then apply(a, y); needs no inverse

Numbers are exact, so terms that cancel leave nothing, and sums that are multiples of each other are one.
The graph is reduced, and its channels are closed (`noncommuting.py`).
"""

from collections import Counter
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca

from mbdlft.base.errors import NotRationalError, StructureError, WellPosednessError
from mbdlft.base.parameter import BilinearMap
from mbdlft.exact.numbers import Constant, Exact, Field, constant_of, zero_of
from mbdlft.order.reduction import ExactLFT
from mbdlft.order.sparse_bound import SparseResidues
from mbdlft.pipeline.extract.noncommuting import Item, Term, Words, closed, smallest, with_sums_put_in
from mbdlft.pipeline.extract.sparse_equations import sparse
from mbdlft.problem.relations import LinearModel
from mbdlft.problem.sx.constants import constants_in
from mbdlft.problem.sx.tapes import Rules, fold, rules


class Extraction(NamedTuple):
    """An LFT, and the channels by parameter of the graph it was made of."""

    lft: ExactLFT
    channels: dict[str, int]


class SparseExtraction(NamedTuple):
    """The same of an LFT that is sparse."""

    lft: SparseResidues
    channels: dict[str, int]
    unknown: int  # the first inputs and outputs are relations, to be solved


class Reduced(NamedTuple):
    """Relations as words, reduced, before their channels are closed."""

    words: Words
    quotients: int
    names: Sequence[str]
    maps: Sequence[BilinearMap]
    channels: dict[str, int]  # as of an `Extraction`
    unknown: int

    @property
    def order(self) -> int:
        """Number of its channels."""
        return sum(item.letter is not None for item in self.words.items)

    def closed(self) -> Extraction:
        """The LFT."""
        words = with_sums_put_in(self.words)
        return Extraction(closed(words, self.quotients, self.names, self.maps), self.channels)

    def sparse(self) -> SparseExtraction:
        """The LFT as sparse equations."""
        lft = sparse(self.words, self.quotients, self.names, self.maps)
        return SparseExtraction(lft, self.channels, self.unknown)


def extract_graph(model: LinearModel, maps: Sequence[BilinearMap] | None = None) -> Reduced:
    """Relations [unknown ; known] -> [residual ; output] in the normalized deltas of the parameters.

    `maps` are those of the deltas to the symbols p, if these are not the internal values. A
    NotRationalError if an operation on a coefficient is not rational, or one on a signal is not linear;
    a StructureError if products are nested too deeply; a WellPosednessError if a denominator vanishes
    at the nominal values.
    """
    signals = ca.vertcat(model.unknown, model.known)
    outputs = ca.vertcat(model.residual, model.output)
    constants, numbers = constants_in(outputs)
    tape = ca.Function("relations", [signals, model.p, constants], [ca.densify(outputs)])
    names = [parameter.name for parameter in model.parameters]
    try:
        graph = walk(tape, names, numbers)
    except RecursionError:
        raise StructureError(
            "products stand inside of each other more deeply than can be followed. Declare a part as a "
            "parameter."
        ) from None
    maps = maps or [parameter.map for parameter in model.parameters]
    return reduced(graph, names, maps, model.unknown.numel())


def reduced(
    graph: "SignalGraph", names: Sequence[str], maps: Sequence[BilinearMap], unknown: int = 0
) -> Reduced:
    """A graph as words; parameters have `names`."""
    counts = Counter(names[parameter] for _, parameter, _ in graph.channels)
    small = condensed(graph)
    channels = {name: counts[name] for name in sorted(names)}
    return Reduced(smallest(opened(small)), len(small.quotients), names, maps, channels, unknown)


class Coefficient(NamedTuple):
    """A node of a coefficient; the arguments are numbers of nodes, or the value of a constant."""

    operation: str
    arguments: tuple[Any, ...]


class Scaled(NamedTuple):
    """factor times a signal, by number; number -1 is the zero signal."""

    factor: Exact
    number: int


Element = int | Scaled  # number of a coefficient, or a signal


class SignalGraph:
    """Collects signals, channels and outputs; `close` solves the system once."""

    def __init__(self, inputs: int, field: Field) -> None:
        self.inputs, self.field = inputs, field
        self.zero, self.minus_one = Scaled(field.zero, -1), field.rational(-1)
        self.size = inputs  # signals 0 .. inputs-1 are the inputs
        self.equations: list[tuple[int, tuple[Scaled, ...]]] = []  # signal = sum
        self.quotients: list[tuple[int, int, Scaled]] = []  # (signal y, divisor b, s): b y = s
        self.products: list[Scaled] = []  # b y of each quotient
        self.channels: list[tuple[int, int, Scaled]] = []  # (signal w, parameter k, z)
        self.outputs: list[Scaled] = []
        self.nodes: list[Coefficient] = []
        self._numbers: dict[Coefficient, int] = {}
        self._constants: dict[int, int] = {}  # numbers of constants by their residues
        self._sums: dict[tuple[tuple[int, int], ...], int] = {}  # residue of a factor, and signal
        self._applied: dict[tuple[int, int], Scaled] = {}

    # coefficients ---------------------------------------------------------------------------

    def node(self, operation: str, *arguments: Any) -> int:
        """Number of a coefficient node; equal nodes have one number."""
        key = Coefficient(operation, arguments)
        if key not in self._numbers:
            self._numbers[key] = len(self.nodes)
            self.nodes.append(key)
        return self._numbers[key]

    def constant(self, value: Exact) -> int:
        """Number of a constant."""
        residue = int(value.residue)
        if residue not in self._constants:
            self._constants[residue] = len(self.nodes)
            one = self.field.one
            self.nodes.append(Coefficient("constant", (one if residue == 1 else value,)))
        number = self._constants[residue]
        if (known := self.nodes[number].arguments[0]) is not value:
            zero_of(value.ball - known.ball)
        return number

    def constant_value(self, number: int) -> Exact | None:
        """Value of a coefficient that is a constant, else None."""
        operation, arguments = self.nodes[number]
        return arguments[0] if operation == "constant" else None

    def parameters_of(self, number: int) -> set[int]:
        """Parameters a coefficient depends on."""
        operation, arguments = self.nodes[number]
        if operation == "constant":
            return set()
        if operation == "parameter":
            return {int(arguments[0])}
        return set().union(*(self.parameters_of(int(child)) for child in arguments))

    # signals --------------------------------------------------------------------------------

    def combine(self, terms: list[Scaled]) -> Scaled:
        """Sum of scaled signals."""
        # parts of numbers are written out here and in `scaled`: most numbers are made there
        merged: dict[int, Exact] = {}
        for factor, index in terms:
            if index >= 0:
                before = merged.get(index)
                if before is not None:
                    factor = Exact(before.ball + factor.ball, before.residue + factor.residue)
                merged[index] = factor
        kept = [Scaled(factor, k) for k, factor in sorted(merged.items()) if factor.residue]
        if not kept:
            return self.zero
        if len(kept) == 1:
            return kept[0]
        first = kept[0].factor
        if first is not self.field.one:
            ball, residue = first.ball, first.residue
            kept = [Scaled(Exact(f.ball / ball, f.residue / residue), index) for f, index in kept]
        key = tuple([(int(factor.residue), index) for factor, index in kept])
        if key not in self._sums:
            self._sums[key] = self._new()
            self.equations.append((self._sums[key], tuple(kept)))
        return Scaled(first, self._sums[key])

    def apply(self, number: int, signal: Scaled) -> Scaled:
        """Coefficient times signal."""
        factor, index = signal
        if index < 0:
            return self.zero
        key = (number, index)
        if key not in self._applied:
            self._applied[key] = self._apply(number, Scaled(self.field.one, index))
        return self.scaled(factor, self._applied[key])

    def scaled(self, factor: Exact, signal: Scaled) -> Scaled:
        """A number times a signal."""
        one = self.field.one
        if factor is one:
            return signal
        if not factor.residue or signal.number < 0:
            return self.zero
        other, number = signal
        if other is one:
            return Scaled(factor, number)
        return Scaled(Exact(factor.ball * other.ball, factor.residue * other.residue), number)

    def _apply(self, number: int, signal: Scaled) -> Scaled:
        operation, arguments = self.nodes[number]
        if operation == "constant":
            return self.scaled(arguments[0], signal)
        if operation == "parameter":
            channel = self._new()
            self.channels.append((channel, int(arguments[0]), signal))
            return Scaled(self.field.one, channel)
        first, second = (int(child) for child in arguments)
        if operation == "add":
            return self.combine([self.apply(term, signal) for term in self._terms(number)])
        if operation == "multiply":
            return self.apply(first, self.apply(second, signal))
        divisor = self.constant_value(second)
        if divisor is not None:
            return self._over(self.apply(first, signal), divisor)
        return self.apply(first, self.divide(second, signal))

    def _terms(self, number: int) -> list[int]:
        """Terms of a sum of coefficients, however it is nested."""
        terms, pending = [], [number]
        while pending:
            operation, arguments = self.nodes[current := pending.pop()]
            if operation == "add":
                pending += [int(arguments[1]), int(arguments[0])]
            else:
                terms.append(current)
        return terms

    def divide(self, number: int, signal: Scaled) -> Scaled:
        """y with apply(number, y) = signal."""
        factor, index = signal
        if index < 0:
            return self.zero
        key = (-1 - number, index)
        if key not in self._applied:
            quotient = Scaled(self.field.one, self._new())
            self._applied[key] = quotient
            self.quotients.append((quotient.number, number, Scaled(self.field.one, index)))
            position = len(self.products)
            self.products.append(self.zero)  # keeps its place: the divisor may divide again
            self.products[position] = self.apply(number, quotient)
        return Scaled(factor, self._applied[key].number)

    # either --------------------------------------------------------------------------------

    def add(self, a: Element, b: Element) -> Element:
        """Sum of two signals, or of two coefficients."""
        if isinstance(a, Scaled) and isinstance(b, Scaled):
            return self.combine([a, b])
        if isinstance(a, Scaled) or isinstance(b, Scaled):
            raise NotRationalError(
                "a signal and a coefficient are added, so the relations are not linear in the signals."
            )
        x, y = self.constant_value(a), self.constant_value(b)
        if x is not None and y is not None:
            return self.constant(x + y)
        if x is not None and not x.residue:
            return b
        return a if y is not None and not y.residue else self.node("add", a, b)

    def multiply(self, a: Element, b: Element) -> Element:
        """Product of a coefficient with a signal or another coefficient."""
        if isinstance(a, Scaled) and isinstance(b, Scaled):
            raise NotRationalError("two signals are multiplied, so the relations are not linear in them.")
        if isinstance(b, Scaled):
            a, b = b, a
        if isinstance(a, Scaled):
            assert not isinstance(b, Scaled)
            constant = self.constant_value(b)
            return self.apply(b, a) if constant is None else self.scaled(constant, a)
        assert not isinstance(b, Scaled)
        x, y = self.constant_value(a), self.constant_value(b)
        if x is not None and y is not None:
            return self.constant(x * y)
        for value, other in ((x, b), (y, a)):
            if value is not None and (value is self.field.one or not value.residue):
                return other if value.residue else self.constant(value)
        return self.node("multiply", a, b)

    def subtract(self, a: Element, b: Element) -> Element:
        """Difference of two signals, or of two coefficients."""
        return self.add(a, self.multiply(self.constant(self.minus_one), b))

    def quotient(self, a: Element, b: Element) -> Element:
        """A signal or a coefficient over a coefficient."""
        if isinstance(b, Scaled):
            raise NotRationalError(
                "a signal is a divisor, so the relations are not linear in the signals."
            )
        divisor = self.constant_value(b)
        if isinstance(a, Scaled):
            if divisor is not None:
                return self._over(a, divisor)
            return self.apply(self.node("divide", self.constant(self.field.one), b), a)
        if divisor is not None:
            one = self._over(Scaled(self.field.one, 0), divisor)
            return self.multiply(a, self.constant(one.factor))
        return self.node("divide", a, b)

    def _over(self, signal: Scaled, divisor: Exact) -> Scaled:
        if not divisor.residue:
            raise WellPosednessError("a divisor is zero, whatever the parameters are.")
        return self.scaled(self.field.one / divisor, signal)

    def _new(self) -> int:
        self.size += 1
        return self.size - 1

    def without_signals(self) -> "SignalGraph":
        """A graph of the same inputs and coefficients."""
        graph = SignalGraph(self.inputs, self.field)
        graph.nodes, graph._numbers = list(self.nodes), dict(self._numbers)
        graph._constants = dict(self._constants)
        return graph


def walk(tape: ca.Function, names: list[str], numbers: Sequence[Constant] = ()) -> SignalGraph:
    """Signal graph of a function (signals, p, constants) -> outputs, linear in the signals."""
    field = Field(numbers)
    graph = SignalGraph(tape.size1_in(0), field)
    signals = [Scaled(field.one, k) for k in range(graph.inputs)]
    parameters = [graph.node("parameter", float(k)) for k in range(tape.size1_in(1))]
    exact = [field.of(number) for number in numbers]
    constants = [graph.constant(number) for number in exact]
    (outputs,) = fold(tape, _graph_rules(graph, names), signals, parameters, constants)
    graph.outputs = [_output(graph, element, row) for row, element in enumerate(outputs)]
    return graph


def _graph_rules(graph: SignalGraph, names: list[str]) -> Rules:
    """Coefficients and signals of a graph as a number system."""

    def missing(operation: str, where: str, *operands: Element) -> Element:
        coefficients = [item for item in operands if not isinstance(item, Scaled)]
        used = sorted({names[k] for item in coefficients for k in graph.parameters_of(item)})
        raise NotRationalError(
            f"{where} is not a rational operation (parameters: {', '.join(used) or 'none'}; acts on a "
            f"{'signal' if len(coefficients) < len(operands) else 'coefficient'}). "
            "Declare the whole function value as a parameter, or keep the equations implicit."
        )

    return rules(
        cache(lambda value: graph.constant(graph.field.rational(constant_of(value)))),
        add=graph.add,
        sub=graph.subtract,
        neg=lambda a: graph.multiply(graph.constant(graph.minus_one), a),
        mul=graph.multiply,
        div=graph.quotient,
        missing=missing,
    )


def _output(graph: SignalGraph, element: Element, row: int) -> Scaled:
    if isinstance(element, Scaled):
        return element
    value = graph.constant_value(element)
    if value is not None and not value:
        return graph.zero
    raise StructureError(
        f"row {row} of the relations does not vanish with the signals: it is not linear in them. "
        "Linearize around an equilibrium first."
    )


def condensed(graph: SignalGraph) -> SignalGraph:
    """The same outputs from the fewest channels if divisors were letters, or the graph itself."""
    if not graph.quotients:
        return graph
    items: list[Item] = [Item(None, ())] * (graph.size - graph.inputs)
    for signal, terms in graph.equations:
        items[signal - graph.inputs] = Item(None, _given(*terms))
    letters = {k: graph.node("parameter", float(k)) for k in {k for _, k, _ in graph.channels}}
    for signal, parameter, z in graph.channels:
        items[signal - graph.inputs] = Item(letters[parameter], _given(z))
    for signal, divisor, z in graph.quotients:
        items[signal - graph.inputs] = Item(-1 - divisor, _given(z))
    outputs = [_given(output) for output in graph.outputs]
    words = smallest(Words(graph.inputs, items, outputs, graph.field))
    small = graph.without_signals()
    signals = [Scaled(graph.field.one, k) for k in range(words.inputs)]
    for item in words.items:
        z, number = _combined(small, signals, item.terms), item.letter
        if number is not None:
            z = small.divide(-1 - number, z) if number < 0 else small.apply(number, z)
        signals.append(z)
    small.outputs = [_combined(small, signals, output) for output in words.outputs]
    return small if len(small.channels) < len(graph.channels) else graph


def _given(*terms: Scaled) -> list[Term]:
    return [(factor, number) for factor, number in terms if number >= 0]


def _combined(graph: SignalGraph, signals: Sequence[Scaled], terms: Sequence[Term]) -> Scaled:
    return graph.combine([graph.scaled(factor, signals[number]) for factor, number in terms])


def opened(graph: SignalGraph) -> Words:
    """Channels by parameter; quotients are inputs, and b y - s of each is one of the first outputs."""
    quotients = [signal for signal, _, _ in graph.quotients]
    is_quotient = set(quotients)
    others = [k for k in range(graph.inputs, graph.size) if k not in is_quotient]
    order = [*range(graph.inputs), *quotients, *others]
    renumbered = {signal: k for k, signal in enumerate(order)}
    first = graph.inputs + len(quotients)

    def terms(*scaled: Scaled) -> list[Term]:
        return [(factor, renumbered[number]) for factor, number in _given(*scaled)]

    items: list[Item] = [Item(None, ())] * len(others)
    for signal, summed in graph.equations:
        items[renumbered[signal] - first] = Item(None, terms(*summed))
    for signal, parameter, z in graph.channels:
        items[renumbered[signal] - first] = Item(parameter, terms(z))
    loops = [
        terms(left, graph.scaled(graph.minus_one, right))
        for left, (_, _, right) in zip(graph.products, graph.quotients, strict=True)
    ]
    outputs = [*loops, *(terms(output) for output in graph.outputs)]
    return Words(first, items, outputs, graph.field)
