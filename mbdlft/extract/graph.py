"""The signal graph: signals as unknowns of a sparse linear system, parameters as channels.

A coefficient depends on parameters only; a signal is linear in the inputs. Both are hash-consed, so
equal sub-expressions exist once. Coefficient times signal:

    constant c          scale
    parameter p_k       one channel, w = p_k z
    a + b               apply(a, s) + apply(b, s)
    a b                 apply(a, apply(b, s))
    a / b               y with apply(b, y) = s, then apply(a, y); needs no inverse
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu

from mbdlft.errors import WellPosednessError
from mbdlft.lft.lft import LFT, Array, Block
from mbdlft.lft.rounding import cleaned, is_rounding, solution_size
from mbdlft.parameter import BilinearMap

_MOST_CLEANED = 3000  # quotients and channels; the full inverse of more would not fit


class Coefficient(NamedTuple):
    """A node of a coefficient; the arguments are numbers of nodes, or the value of a constant."""

    operation: str
    arguments: tuple[float, ...]


class Scaled(NamedTuple):
    """factor times a signal, by number; number -1 is the zero signal."""

    factor: float
    number: int


ZERO = Scaled(0.0, -1)


def scaled(factor: float, signal: Scaled) -> Scaled:
    """A number times a signal."""
    return Scaled(factor * signal.factor, signal.number) if factor and signal.factor else ZERO


class SignalGraph:
    """Collects signals, channels and outputs; `to_lft` solves the system once."""

    def __init__(self, inputs: int) -> None:
        self.inputs = inputs
        self.size = inputs  # signals 0 .. inputs-1 are the inputs
        self.equations: list[tuple[int, tuple[Scaled, ...]]] = []  # signal = sum
        self.implicit: list[tuple[Scaled, Scaled]] = []  # left = right, one for each quotient
        self.quotients: list[int] = []
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
        for factor, index in terms:
            if index >= 0:
                merged[index] = merged.get(index, 0.0) + factor
        kept = [Scaled(factor, index) for index, factor in sorted(merged.items()) if factor != 0.0]
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
        return self.apply(first, self._divide(second, signal))

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

    def _divide(self, number: int, signal: Scaled) -> Scaled:
        """y with apply(number, y) = signal."""
        key = (-1 - number, signal.number)
        if key not in self._applied:
            quotient = Scaled(1.0, self._new())
            self._applied[key] = quotient
            self.quotients.append(quotient.number)
            position = len(self.implicit)
            self.implicit.append((ZERO, ZERO))  # keeps its place: the divisor may divide again
            self.implicit[position] = (self.apply(number, quotient), signal)
        return self._applied[key]

    def _new(self) -> int:
        self.size += 1
        return self.size - 1

    # the LFT --------------------------------------------------------------------------------

    def to_lft(self, names: list[str], maps: list[BilinearMap]) -> LFT:
        """Inputs to outputs as an LFT in the normalized deltas of the parameters `names`.

        Sums are put in, one into the other; what is left is a system for the quotients and channels. A
        channel w = p z of a parameter with p = b0 + gain delta/(1 + a1 delta) is w = b0 z + gain w',
        w' = delta (z - a1 w').

        Raises
        ------
        WellPosednessError
            The system is singular: a denominator vanishes at the nominal values.
        """
        channels = sorted(self.channels, key=lambda channel: names[channel[1]])
        nu, nq, nw = self.inputs, len(self.quotients), len(channels)
        owners = [maps[parameter] for _, parameter, _ in channels]
        rows = self._open(channels)
        loops, reads = rows[:nq], rows[nq:]
        # unknown quotients y and channels w: loops = 0, w = b0 z + gain w'
        b0, gain = (np.array([getattr(o, key) for o in owners]) for key in ("b0", "gain"))
        matrix = np.vstack([loops[:, nu:], -b0[:, None] * reads[:nw, nu:]])
        matrix[nq + np.arange(nw), nq + np.arange(nw)] += 1.0
        right = np.zeros((nq + nw, nu + nw))
        right[:nq, :nu], right[nq:, :nu] = -loops[:, :nu], b0[:, None] * reads[:nw, :nu]
        right[nq + np.arange(nw), nu + np.arange(nw)] = gain
        sources = [*self.quotients, *(signal for signal, _, _ in channels)]
        depends = self._depends(channels)
        solution = _solve(matrix, right)
        solution[~depends[sources]] = 0.0  # what is zero by structure is zero exactly
        read = _read(reads, solution, nu)
        number = [z.number for _, _, z in channels] + [output.number for output in self.outputs]
        read[~depends[number] | (np.array(number) < 0)[:, None]] = 0.0
        read[np.arange(nw), nu + np.arange(nw)] -= [owner.a1 for owner in owners]
        counts = Counter(parameter for _, parameter, _ in self.channels)
        blocks = tuple(sorted(Block(name, counts[k]) for k, name in enumerate(names)))
        return LFT(read[:nw, nu:], read[:nw, :nu], read[nw:, nu:], read[nw:, :nu], blocks)

    def _open(self, channels: Sequence[tuple[int, int, Scaled]]) -> Array:
        """Rows [left - right of quotients ; z of channels ; outputs] by [inputs, quotients, channels].

        A sum refers to signals that are older than itself, so one pass in the order of their numbers is
        enough. A row is dropped after its last use: there are many more signals than rows that stay.
        """
        sources = [*range(self.inputs), *self.quotients, *(signal for signal, _, _ in channels)]
        width = len(sources)
        asked: list[tuple[Scaled, ...]] = [
            (left, Scaled(-right.factor, right.number)) for left, right in self.implicit
        ]
        asked += [(z,) for _, _, z in channels] + [(output,) for output in self.outputs]
        left_over = Counter(
            term.number for terms in (*(t for _, t in self.equations), *asked) for term in terms
        )
        # values by source, and their sizes if nothing cancelled
        held: dict[int, tuple[dict[int, float], dict[int, float]]] = {
            signal: ({k: 1.0}, {k: 1.0}) for k, signal in enumerate(sources)
        }
        kept = set(sources)

        def added(terms: Sequence[Scaled]) -> tuple[dict[int, float], dict[int, float]]:
            values: dict[int, float] = {}
            sizes: dict[int, float] = {}
            for factor, number in terms:
                if number < 0:
                    continue
                of_term, of_size = held[number]
                for k, value in of_term.items():
                    values[k] = values.get(k, 0.0) + factor * value
                    sizes[k] = sizes.get(k, 0.0) + abs(factor) * of_size[k]
                if number not in kept:
                    left_over[number] -= 1
                    if not left_over[number]:
                        del held[number]
            for k, value in values.items():
                if is_rounding(value, sizes[k]):
                    values[k] = 0.0
            return values, sizes

        for signal, terms in self.equations:
            if left_over[signal]:
                held[signal] = added(terms)
        rows = np.zeros((len(asked), width))
        for row, terms in zip(rows, asked, strict=True):
            values, _ = added(terms)
            row[list(values)] = list(values.values())
        return rows

    def _depends(self, channels: Sequence[tuple[int, int, Scaled]]) -> NDArray[np.bool_]:
        """Whether each signal can depend on each input and channel: (signals, inputs + channels)."""
        sources: list[list[int]] = [[] for _ in range(self.size)]
        for signal, terms in self.equations:
            sources[signal] += [term.number for term in terms]
        for signal, (left, right) in zip(self.quotients, self.implicit, strict=True):
            sources[signal] += [left.number, right.number]
        bits = [1 << k if k < self.inputs else 0 for k in range(self.size)]
        for k, (signal, _, z) in enumerate(channels):
            bits[signal] |= 1 << (self.inputs + k)
            sources[signal].append(z.number)
        changed = True
        while changed:
            changed = False
            for signal, used in enumerate(sources):
                union = bits[signal]
                for number in used:
                    union |= bits[number] if number >= 0 else 0
                if union != bits[signal]:
                    bits[signal], changed = union, True
        width = self.inputs + len(channels)
        packed = b"".join(mask.to_bytes((width + 7) // 8, "little") for mask in bits)
        table = np.frombuffer(packed, dtype=np.uint8).reshape(self.size, -1)
        return np.unpackbits(table, axis=1, count=width, bitorder="little").astype(bool)


def _read(rows: Array, solution: Array, inputs: int) -> Array:
    """Values (rows, columns) of rows by [inputs, unknowns], the unknowns being a solution by columns."""
    direct = np.hstack([rows[:, :inputs], np.zeros((len(rows), solution.shape[1] - inputs))])
    sparse = _sparse(rows[:, inputs:])
    return cleaned(direct + sparse @ solution, np.abs(direct) + abs(sparse) @ np.abs(solution))


def _sparse(matrix: Array) -> csr_array:
    """The nonzeros of a matrix by rows; scipy's own way takes three times as long for small ones."""
    at, columns = matrix.nonzero()
    starts = np.searchsorted(at, np.arange(len(matrix) + 1))
    return csr_array((matrix[at, columns], columns, starts), shape=matrix.shape)


def _solve(matrix: Array, right: Array) -> Array:
    """matrix^-1 right, or an error that says the model is not well posed at nominal."""
    if not matrix.size:
        return np.zeros(right.shape)
    largest = np.max(np.abs(matrix), axis=1)
    scale = 2.0 ** -np.round(np.log2(np.where(largest > 0.0, largest, 1.0)))
    try:
        # rows of one size: pivots then make no noise
        scaled = _sparse((scale[:, None] * matrix).T).T
        factors, terms = splu(scaled), scale[:, None] * right
        solution = np.asarray(factors.solve(terms))
        if len(scale) <= _MOST_CLEANED and np.all(np.isfinite(solution)):
            # one or two of a hundred entries of the inverse are not zero
            inverse = _sparse(factors.solve(np.eye(len(scale))))
            size = np.asarray(solution_size(inverse, scaled, solution, terms))
            solution = cleaned(solution, 0.25 * size)
    except RuntimeError:
        solution = np.full_like(right, np.nan)
    if not np.all(np.isfinite(solution)):
        raise WellPosednessError(
            "a denominator vanishes at the nominal values of the parameters, so there is no linear "
            "fractional form around them. Move the nominal values."
        )
    return solution
