"""From relations in CasADi to an LFT: a signal graph, reduced exactly, whose channels are closed.

A channel w = p z of a parameter with p = b0 + gain delta/(1 + a1 delta) is w = b0 z + gain w',
w' = delta (z - a1 w'). Each z, and each quotient, is solved for in inputs and w'. They follow from
each other but for the loops of the quotients, so one row after the other is enough, and what is zero by
structure is zero exactly. Numbers are exact.
"""

from collections import Counter
from collections.abc import Container, Sequence
from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.errors import NotRationalError, StructureError, WellPosednessError
from mbdlft.base.parameter import BilinearMap
from mbdlft.exact.matrices import ExactMatrix, from_rows, identity
from mbdlft.exact.numbers import Constant, Exact, Field, constant_of, decimal
from mbdlft.lft.block import Block
from mbdlft.lft.sampling import components
from mbdlft.order.reduction import ExactLFT
from mbdlft.pipeline.extract.graph import Element, Scaled, SignalGraph
from mbdlft.pipeline.extract.noncommuting import (
    Row,
    Term,
    Words,
    add,
    condensed,
    opened,
    reached,
    smallest,
    subtract,
)
from mbdlft.problem.relations import LinearModel
from mbdlft.problem.sx.constants import constants_in
from mbdlft.problem.sx.tapes import Rules, fold, rules


class Extraction(NamedTuple):
    """An LFT, and the channels by parameter of the graph it was made of."""

    lft: ExactLFT
    channels: dict[str, int]


def extract(model: LinearModel, maps: Sequence[BilinearMap] | None = None) -> Extraction:
    """LFT of [unknown ; known] -> [residual ; output] in the normalized deltas of the parameters.

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
    counts = Counter(names[parameter] for _, parameter, _ in graph.channels)
    lft = close(graph, names, maps or [parameter.map for parameter in model.parameters])
    return Extraction(lft, {name: counts[name] for name in sorted(names)})


def walk(tape: ca.Function, names: list[str], numbers: Sequence[Constant] = ()) -> SignalGraph:
    """Signal graph of a function (signals, p, constants) -> outputs, linear in the signals.

    `names` are those of the parameters p, for messages, and `numbers` what the constants are.
    """
    field = Field(numbers)
    graph = SignalGraph(tape.size1_in(0), field)
    signals = [Scaled(field.one, k) for k in range(graph.inputs)]
    parameters = [graph.node("parameter", float(k)) for k in range(tape.size1_in(1))]
    constants = [graph.constant(field.of(number)) for number in numbers]
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


def close(
    graph: SignalGraph, names: Sequence[str], maps: Sequence[BilinearMap], *, all_kept: bool = False
) -> ExactLFT:
    """Inputs to outputs as an LFT in the normalized deltas of the parameters `names`.

    With `all_kept`, every channel of the graph that something depends on is one of the LFT.
    """
    small = graph if all_kept else condensed(graph)
    words, quotients = opened(small), len(small.quotients)
    words = reached(words, all_kept=True) if all_kept else smallest(words)
    channels = _Channels(words, quotients, names, maps)
    for component in _components(words, quotients):
        channels.solve(component)
    return channels.lft()


class _Channels:
    """Rows [M11 M12] and those of the quotients, filled in one component after the other.

    Unknowns are numbered: quotients first, as they follow from their loops, then items.
    """

    def __init__(
        self, words: Words, quotients: int, names: Sequence[str], maps: Sequence[BilinearMap]
    ) -> None:
        self.words, self.quotients, self.field = words, quotients, words.field
        self.inputs = words.inputs - quotients
        letters = [item.letter for item in words.items if item.letter is not None]
        self.order = sorted(range(len(letters)), key=lambda k: names[letters[k]])
        self.column = [0] * len(letters)  # of w' of each item
        for k, item in enumerate(self.order):
            self.column[item] = k
        exact = [[self.field.rational(decimal(x)) for x in (m.b0, m.gain, m.a1)] for m in maps]
        self.b0, self.gain, self.a1 = ([exact[k][j] for k in letters] for j in range(3))
        counts = Counter(names[letter] for letter in letters)
        self.blocks = tuple(Block(name, counts[name]) for name in sorted(names))
        self.count = len(letters)
        self.rows: list[Row] = [{} for _ in range(quotients + self.count)]
        self.inverses: dict[bytes, ExactMatrix] = {}  # many loops are those of one divisor

    def solve(self, unknowns: list[int]) -> None:
        """Fill in the rows of unknowns that depend on each other; all others that they need are known."""
        if len(unknowns) == 1 and unknowns[0] >= self.quotients:
            self.rows[unknowns[0]] = self._added(self._given(unknowns[0]))
            return
        position = {u: k for k, u in enumerate(unknowns)}
        size, one, prime = len(unknowns), self.field.one, self.field.prime
        matrix: list[Row] = [{} for _ in unknowns]
        for k, u in enumerate(unknowns):
            if u >= self.quotients:
                matrix[k][k] = one
            for factor, number in self._given(u):
                at = number - self.inputs
                if at in position:
                    through = one if at < self.quotients else self.b0[at - self.quotients]
                    subtract(matrix[k], {position[at]: one}, factor * through)
        right = [self._added(self._given(u), position) for u in unknowns]
        columns = sorted({column for row in right for column in row})
        place = {column: k for k, column in enumerate(columns)}
        dense = [{place[c]: value for c, value in row.items()} for row in right]
        inverse = self._inverse(from_rows(matrix, size, prime))
        solution = inverse @ from_rows(dense, len(columns), prime)
        for k, column in zip(*np.nonzero(solution.residues), strict=True):
            residue = self.field.residue(int(solution.residues[k, column]))
            self.rows[unknowns[k]][columns[column]] = Exact(solution.balls[k, column], residue)

    def lft(self) -> ExactLFT:
        """The LFT, once all unknowns are solved for."""
        outputs = [self._added(terms) for terms in self.words.outputs[self.quotients :]]
        inner = [self.rows[self.quotients + item] for item in self.order]
        for k, item in enumerate(self.order):
            if self.a1[item].residue:
                subtract(inner[k], {k: self.field.one}, self.a1[item])
        width = self.count + self.inputs
        return ExactLFT(from_rows([*inner, *outputs], width, self.field.prime), self.blocks)

    def _given(self, unknown: int) -> Sequence[Term]:
        """The row that an unknown follows from: the loop of a quotient, or z."""
        if unknown < self.quotients:
            return self.words.outputs[unknown]
        return self.words.items[unknown - self.quotients].terms

    def _added(self, terms: Sequence[Term], unknowns: Container[int] = ()) -> Row:
        """A sum without its terms in b0 z and y of unknowns, by columns of [w', inputs]."""
        total: Row = {}
        for factor, number in terms:
            at = number - self.inputs
            if at < 0:
                add(total, {self.count + number: self.field.one}, factor)
                continue
            if at >= self.quotients:
                item = at - self.quotients
                add(total, {self.column[item]: self.gain[item]}, factor)
                if at not in unknowns and self.b0[item].residue:
                    add(total, self.rows[at], factor * self.b0[item])
            elif at not in unknowns:
                add(total, self.rows[at], factor)
        return total

    def _inverse(self, matrix: ExactMatrix) -> ExactMatrix:
        """matrix^-1, or an error that says the model is not well posed at nominal."""
        key = matrix.residues.tobytes()
        if key not in self.inverses:
            try:
                self.inverses[key] = matrix.solve(identity(len(matrix.residues), matrix.prime))
            except ZeroDivisionError:
                raise WellPosednessError(
                    "a denominator vanishes at the nominal values of the parameters, so there is no "
                    "linear fractional form around them. Move the nominal values."
                ) from None
        return self.inverses[key]


def _components(words: Words, quotients: int) -> list[list[int]]:
    """Unknowns that depend on each other, after all that they need; numbered as in `_Channels`."""
    inputs = words.inputs - quotients
    needs = [
        [number - inputs for _, number in terms if number >= inputs]
        for terms in (*words.outputs[:quotients], *(item.terms for item in words.items))
    ]
    if not quotients:
        return [[k] for k in range(len(needs))]
    readers = np.repeat(np.arange(len(needs)), [len(need) for need in needs])
    sources = np.array([k for need in needs for k in need], dtype=int)
    return [loop.tolist() for loop in components(readers, sources, len(needs))]
