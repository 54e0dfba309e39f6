"""The SX tape as a signal graph: each instruction becomes a constant, a coefficient or a signal."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple

import casadi as ca

from mbdlft.base.errors import NotRationalError, StructureError
from mbdlft.base.parameter import BilinearMap
from mbdlft.lft.lft import LFT
from mbdlft.pipeline.extract.close import close
from mbdlft.pipeline.extract.graph import ZERO, Element, Scaled, SignalGraph
from mbdlft.problem.linearize import LinearModel
from mbdlft.sx.fold import Rules, fold, rules

_FEW = 1000  # channels: up to here, `reduce_order` alone takes less time than reducing words before


class Extraction(NamedTuple):
    """An LFT, the channels by parameter of the graph it was made of, and the LFT with all of them."""

    lft: LFT
    channels: dict[str, int]
    whole: Callable[[], LFT]

    @property
    def order(self) -> int:
        """Channels before any reduction."""
        return sum(self.channels.values())


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
    tape = ca.Function("relations", [signals, model.p], [ca.densify(outputs)])
    names = [parameter.name for parameter in model.parameters]
    try:
        graph = walk(tape, names)
    except RecursionError:
        raise StructureError(
            "products stand inside of each other more deeply than can be followed. Declare a part as a "
            "parameter."
        ) from None
    counts = Counter(names[parameter] for _, parameter, _ in graph.channels)
    maps = maps or [parameter.map for parameter in model.parameters]
    whole = cache(partial(close, graph, names, maps, all_kept=True))
    lft = whole() if len(graph.channels) <= _FEW else close(graph, names, maps)
    return Extraction(lft, {name: counts[name] for name in sorted(names)}, whole)


def walk(tape: ca.Function, names: list[str]) -> SignalGraph:
    """Signal graph of a function (signals, p) -> outputs, linear in the signals.

    `names` are those of the parameters p, for messages.
    """
    graph = SignalGraph(tape.size1_in(0))
    signals = [Scaled(1.0, k) for k in range(graph.inputs)]
    parameters = [graph.node("parameter", float(k)) for k in range(tape.size1_in(1))]
    (found,) = fold(tape, _graph_rules(graph, names), signals, parameters)
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
        graph.constant,
        add=graph.add,
        mul=graph.multiply,
        div=graph.quotient,
        missing=missing,
    )


def _output(graph: SignalGraph, element: Element, row: int) -> Scaled:
    if isinstance(element, Scaled):
        return element
    if graph.constant_value(element) == 0.0:
        return ZERO
    raise StructureError(
        f"row {row} of the relations does not vanish with the signals: it is not linear in them. "
        "Linearize around an equilibrium first."
    )
