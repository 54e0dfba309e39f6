"""The walk of the SX tape: each instruction becomes a constant, a coefficient or a signal."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import casadi as ca

from mbdlft.base.errors import NotRationalError, StructureError
from mbdlft.base.parameter import BilinearMap
from mbdlft.lft.lft import LFT
from mbdlft.pipeline.extract.close import close
from mbdlft.pipeline.extract.graph import ZERO, Scaled, SignalGraph, scaled
from mbdlft.problem.linearize import LinearModel

Element = int | Scaled  # number of a coefficient, or a signal
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
    graph.outputs = [ZERO] * tape.size1_out(0)
    work: list[Element] = [0] * tape.sz_w()
    for k in range(tape.n_instructions()):
        operation = tape.instruction_id(k)
        sources, targets = tape.instruction_input(k), tape.instruction_output(k)
        if operation == ca.OP_INPUT:
            argument, entry = sources
            work[targets[0]] = (
                Scaled(1.0, entry) if argument == 0 else graph.node("parameter", float(entry))
            )
        elif operation == ca.OP_CONST:
            work[targets[0]] = graph.constant(tape.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            graph.outputs[targets[1]] = _output(graph, work[sources[0]], targets[1])
        elif operation in _RULES:
            work[targets[0]] = _RULES[operation](graph, *(work[source] for source in sources))
        else:
            used = sorted(
                {name for source in sources for name in _used(graph, work[source], names)}
            )
            raise NotRationalError(
                f"{_operation_name(operation)} at instruction {k} of {tape.name()!r} is not a "
                f"rational operation (parameters: {', '.join(used) or 'none'}; "
                f"{'acts on a signal' if _any_signal(work, sources) else 'acts on a coefficient'}). "
                "Declare the whole function value as a parameter, or keep the equations implicit."
            )
    return graph


def _output(graph: SignalGraph, element: Element, row: int) -> Scaled:
    if isinstance(element, Scaled):
        return element
    if graph.constant_value(element) == 0.0:
        return ZERO
    raise StructureError(
        f"row {row} of the relations does not vanish with the signals: it is not linear in them. "
        "Linearize around an equilibrium first."
    )


def _add(graph: SignalGraph, a: Element, b: Element) -> Element:
    if isinstance(a, Scaled) and isinstance(b, Scaled):
        return graph.combine([a, b])
    if isinstance(a, Scaled) or isinstance(b, Scaled):
        signal, number = (a, b) if isinstance(a, Scaled) else (b, a)
        if not isinstance(number, Scaled) and graph.constant_value(number) == 0.0:
            return signal
        raise NotRationalError(
            "a signal and a coefficient are added, so the relations are not linear in the signals."
        )
    x, y = graph.constant_value(a), graph.constant_value(b)
    if x is not None and y is not None:
        return graph.constant(x + y)
    if x == 0.0:
        return b
    return a if y == 0.0 else graph.node("add", a, b)


def _multiply(graph: SignalGraph, a: Element, b: Element) -> Element:
    if isinstance(a, Scaled) and isinstance(b, Scaled):
        raise NotRationalError(
            "two signals are multiplied, so the relations are not linear in them."
        )
    if isinstance(b, Scaled):
        a, b = b, a
    if isinstance(a, Scaled):
        assert not isinstance(b, Scaled)
        constant = graph.constant_value(b)
        return graph.apply(b, a) if constant is None else scaled(constant, a)
    assert not isinstance(b, Scaled)
    x, y = graph.constant_value(a), graph.constant_value(b)
    if x is not None and y is not None:
        return graph.constant(x * y)
    if x == 1.0:
        return b
    return a if y == 1.0 else graph.node("multiply", a, b)


def _divide(graph: SignalGraph, a: Element, b: Element) -> Element:
    if isinstance(b, Scaled):
        raise NotRationalError(
            "a signal is a divisor, so the relations are not linear in the signals."
        )
    value = graph.constant_value(b)
    if isinstance(a, Scaled):
        if value is not None:
            return Scaled(a.factor / value, a.number)
        return graph.apply(graph.node("divide", graph.constant(1.0), b), a)
    x = graph.constant_value(a)
    if x is not None and value is not None:
        return graph.constant(x / value)
    return graph.node("divide", a, b)


def _negate(graph: SignalGraph, a: Element) -> Element:
    return scaled(-1.0, a) if isinstance(a, Scaled) else _multiply(graph, graph.constant(-1.0), a)


_RULES: dict[int, Callable[..., Element]] = {
    ca.OP_ADD: _add,
    ca.OP_SUB: lambda graph, a, b: _add(graph, a, _negate(graph, b)),
    ca.OP_MUL: _multiply,
    ca.OP_DIV: _divide,
    ca.OP_NEG: _negate,
    ca.OP_ASSIGN: lambda graph, a: a,
    ca.OP_TWICE: lambda graph, a: _multiply(graph, graph.constant(2.0), a),
    ca.OP_SQ: lambda graph, a: _multiply(graph, a, a),
    ca.OP_INV: lambda graph, a: _divide(graph, graph.constant(1.0), a),
}


def _any_signal(work: list[Element], sources: list[int]) -> bool:
    return any(isinstance(work[source], Scaled) for source in sources)


def _used(graph: SignalGraph, element: Element, names: list[str]) -> list[str]:
    if isinstance(element, Scaled):
        return []
    return [names[k] for k in graph.parameters_of(element)]


def _operation_name(operation: int) -> str:
    found: list[Any] = [
        name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == operation
    ]
    return str(found[0]) if found else f"operation {operation}"
