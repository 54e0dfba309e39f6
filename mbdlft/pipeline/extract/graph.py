"""The signal graph: signals as unknowns of a sparse linear system, parameters as channels.

A coefficient depends on parameters only; a signal is linear in the inputs. Both are hash-consed, so
equal sub-expressions exist once. Coefficient times signal:

    constant c          scale
    parameter p_k       one channel, w = p_k z
    a + b               apply(a, s) + apply(b, s)
    a b                 apply(a, apply(b, s))
    a / b               y with apply(b, y) = s, then apply(a, y); needs no inverse
"""

from typing import NamedTuple

from mbdlft.base.errors import NotRationalError
from mbdlft.number.rounding import ROUNDING


class Coefficient(NamedTuple):
    """A node of a coefficient; the arguments are numbers of nodes, or the value of a constant."""

    operation: str
    arguments: tuple[float, ...]


class Scaled(NamedTuple):
    """factor times a signal, by number; number -1 is the zero signal."""

    factor: float
    number: int


Element = int | Scaled  # number of a coefficient, or a signal
ZERO = Scaled(0.0, -1)


def scaled(factor: float, signal: Scaled) -> Scaled:
    """A number times a signal."""
    return Scaled(factor * signal.factor, signal.number) if factor and signal.factor else ZERO


class SignalGraph:
    """Collects signals, channels and outputs; `close` solves the system once."""

    def __init__(self, inputs: int) -> None:
        self.inputs = inputs
        self.size = inputs  # signals 0 .. inputs-1 are the inputs
        self.equations: list[tuple[int, tuple[Scaled, ...]]] = []  # signal = sum
        self.quotients: list[tuple[int, int, Scaled]] = []  # (signal y, divisor b, s): b y = s
        self.products: list[Scaled] = []  # b y of each quotient
        self.channels: list[tuple[int, int, Scaled]] = []  # (signal w, parameter k, z)
        self.outputs: list[Scaled] = []
        self.nodes: list[Coefficient] = []
        self._numbers: dict[Coefficient, int] = {}
        self._sums: dict[tuple[Scaled, ...], int] = {}
        self._applied: dict[tuple[int, int], Scaled] = {}

    # coefficients ---------------------------------------------------------------------------

    def node(self, operation: str, *arguments: float) -> int:
        """Number of a coefficient node; equal nodes have one number."""
        key = Coefficient(operation, arguments)
        if key not in self._numbers:
            self._numbers[key] = len(self.nodes)
            self.nodes.append(key)
        return self._numbers[key]

    def constant(self, value: float) -> int:
        """Number of a constant."""
        return self.node("constant", value)

    def constant_value(self, number: int) -> float | None:
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
        merged: dict[int, float] = {}
        sizes: dict[int, float] = {}
        for factor, index in terms:
            if index >= 0:
                merged[index] = merged.get(index, 0.0) + factor
                sizes[index] = sizes.get(index, 0.0) + abs(factor)
        kept = [
            Scaled(factor, index)
            for index, factor in sorted(merged.items())
            if abs(factor) > ROUNDING * sizes[index]
        ]
        if not kept:
            return ZERO
        if len(kept) == 1:
            return kept[0]
        sign = 1.0 if kept[0].factor > 0 else -1.0
        key = tuple(Scaled(sign * factor, index) for factor, index in kept)
        if key not in self._sums:
            self._sums[key] = self._new()
            self.equations.append((self._sums[key], key))
        return Scaled(sign, self._sums[key])

    def apply(self, number: int, signal: Scaled) -> Scaled:
        """Coefficient times signal."""
        factor, index = signal
        if index < 0:
            return ZERO
        key = (number, index)
        if key not in self._applied:
            self._applied[key] = self._apply(number, Scaled(1.0, index))
        applied = self._applied[key]
        return Scaled(factor * applied.factor, applied.number) if factor else ZERO

    def _apply(self, number: int, signal: Scaled) -> Scaled:
        operation, arguments = self.nodes[number]
        if operation == "constant":
            return Scaled(arguments[0], signal.number) if arguments[0] else ZERO
        if operation == "parameter":
            channel = self._new()
            self.channels.append((channel, int(arguments[0]), signal))
            return Scaled(1.0, channel)
        first, second = (int(child) for child in arguments)
        if operation == "add":
            return self.combine([self.apply(term, signal) for term in self._terms(number)])
        if operation == "multiply":
            return self.apply(first, self.apply(second, signal))
        divisor = self.constant_value(second)
        if divisor is not None:
            applied = self.apply(first, signal)
            return Scaled(applied.factor / divisor, applied.number)
        return self.apply(first, self.divide(second, signal))

    def _terms(self, number: int) -> list[int]:
        """Terms of a sum of coefficients, however it is nested."""
        found, pending = [], [number]
        while pending:
            operation, arguments = self.nodes[current := pending.pop()]
            if operation == "add":
                pending += [int(arguments[1]), int(arguments[0])]
            else:
                found.append(current)
        return found

    def divide(self, number: int, signal: Scaled) -> Scaled:
        """y with apply(number, y) = signal."""
        factor, index = signal
        if index < 0 or not factor:
            return ZERO
        key = (-1 - number, index)
        if key not in self._applied:
            quotient = Scaled(1.0, self._new())
            self._applied[key] = quotient
            self.quotients.append((quotient.number, number, Scaled(1.0, index)))
            position = len(self.products)
            self.products.append(ZERO)  # keeps its place: the divisor may divide again
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
        return self.node("add", a, b)

    def multiply(self, a: Element, b: Element) -> Element:
        """Product of a coefficient with a signal or another coefficient."""
        if isinstance(a, Scaled) and isinstance(b, Scaled):
            raise NotRationalError(
                "two signals are multiplied, so the relations are not linear in them."
            )
        if isinstance(b, Scaled):
            a, b = b, a
        if isinstance(a, Scaled):
            assert not isinstance(b, Scaled)
            constant = self.constant_value(b)
            return self.apply(b, a) if constant is None else scaled(constant, a)
        assert not isinstance(b, Scaled)
        x, y = self.constant_value(a), self.constant_value(b)
        return self.node("multiply", a, b) if x is None or y is None else self.constant(x * y)

    def quotient(self, a: Element, b: Element) -> Element:
        """A signal or a coefficient over a coefficient."""
        if isinstance(b, Scaled):
            raise NotRationalError(
                "a signal is a divisor, so the relations are not linear in the signals."
            )
        value = self.constant_value(b)
        if isinstance(a, Scaled):
            if value is not None:
                return Scaled(a.factor / value, a.number)
            return self.apply(self.node("divide", self.constant(1.0), b), a)
        return self.node("divide", a, b)

    def _new(self) -> int:
        self.size += 1
        return self.size - 1

    def without_signals(self) -> "SignalGraph":
        """A graph of the same inputs and coefficients."""
        graph = SignalGraph(self.inputs)
        graph.nodes, graph._numbers = list(self.nodes), dict(self._numbers)
        return graph
