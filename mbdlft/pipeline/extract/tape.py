"""The SX tape as a signal graph: each instruction becomes a constant, a coefficient or a signal."""

from collections import Counter
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import casadi as ca

from mbdlft.base.errors import NotRationalError, StructureError
from mbdlft.base.parameter import BilinearMap
from mbdlft.exact.numbers import Constant, Field, constant_of
from mbdlft.lft.exact import ExactLFT
from mbdlft.pipeline.extract.close import close
from mbdlft.pipeline.extract.graph import Element, Scaled, SignalGraph
from mbdlft.problem.linearize import LinearModel
from mbdlft.problem.sx.constants import constants_in
from mbdlft.problem.sx.fold import Rules, fold, rules


class Extraction(NamedTuple):
    """An LFT, and the channels by parameter of the graph it was made of."""

    lft: ExactLFT
    channels: dict[str, int]


def extract(model: LinearModel, maps: Sequence[BilinearMap] | None = None) -> Extraction:
    """LFT of [unknown ; known] -> [residual ; output] in the normalized deltas of the parameters.

    `maps` are those of the deltas to the symbols p, if these are not the internal values.

    Raises
    ------
    NotRationalError
        An operation on a coefficient is not rational, or one on a signal is not linear.
    StructureError
        Products are nested too deeply.
    WellPosednessError
        A denominator vanishes at the nominal values.
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
    (found,) = fold(tape, _graph_rules(graph, names), signals, parameters, constants)
    graph.outputs = [_output(graph, element, row) for row, element in enumerate(found)]
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
