"""The signal graph: signals as unknowns of a sparse linear system, parameters as channels.

A coefficient depends on parameters only; a signal is linear in the inputs. Both are hash-consed, so
equal sub-expressions exist once. Coefficient times signal:

    constant c          scale
    parameter p_k       one channel, w = p_k z
    a + b               apply(a, s) + apply(b, s)
    a b                 apply(a, apply(b, s))
    a / b               y with apply(b, y) = s, then apply(a, y); needs no inverse

Numbers are exact, so terms that cancel leave nothing, and sums that are multiples of each other are one.
"""

from typing import Any, NamedTuple

from mbdlft.base.errors import NotRationalError, WellPosednessError
from mbdlft.exact.numbers import Exact, Field


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
        self.zero = Scaled(field.zero, -1)
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
        return self._constants[residue]

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
        merged: dict[int, Exact] = {}
        for factor, index in terms:
            if index >= 0:
                merged[index] = merged[index] + factor if index in merged else factor
        kept = [Scaled(factor, k) for k, factor in sorted(merged.items()) if factor.residue]
        if not kept:
            return self.zero
        if len(kept) == 1:
            return kept[0]
        first = kept[0].factor
        if first is not self.field.one:
            kept = [Scaled(factor / first, index) for factor, index in kept]
        key = tuple((int(factor.residue), index) for factor, index in kept)
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
        return Scaled(factor if signal.factor is one else factor * signal.factor, signal.number)

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
