"""Laws of the exact reduction of words.

1. what a graph says at values of the parameters, its LFT says, with all channels and with those that stay
2. what stays has the order that n-D reduction finds; without quotients nothing is left for it to do
3. a row is a combination of earlier ones where the rank says so, and not where it nearly is one
4. a graph with many channels becomes an LFT without any matrix between all of them
"""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scaling import scene
from mbdlft.build import choose_signals
from mbdlft.extract import dependence, extract, words
from mbdlft.extract.close import close
from mbdlft.extract.dependence import Dependence, Row
from mbdlft.extract.graph import Scaled, SignalGraph
from mbdlft.lft.evaluate import evaluate
from mbdlft.lft.lft import LFT
from mbdlft.lft.reduce import reduce_order
from mbdlft.linearize import linearize
from mbdlft.parameter import BilinearMap
from mbdlft.scene import assemble
from tests.close import exact, roundoff

NAMES = ["q", "a", "m"]  # not sorted: blocks are
MAPS = [BilinearMap(0.5, 0.25, 0.0), BilinearMap(1.5, 0.5, 0.25), BilinearMap(-0.75, 0.5, 0.0)]
INPUTS = 2
KAPPA = 1e3
seeds = st.integers(0, 2**32 - 1)


def random_graph(seed: int, *, divisors: bool) -> SignalGraph:
    """Sums, products and quotients by chance, of few kinds: many are equal in the end."""
    random = np.random.default_rng(seed)
    graph = SignalGraph(INPUTS)
    p = [graph.node("parameter", float(k)) for k in range(len(NAMES))]
    square = graph.node("multiply", p[0], p[0])
    by = [
        graph.node("add", graph.constant(1.0), square),
        graph.node("add", graph.constant(4.0), graph.node("multiply", p[1], p[2])),
    ]
    signals = [Scaled(1.0, k) for k in range(INPUTS)]
    for _ in range(24):
        kind = random.integers(5 if divisors else 4)
        one = signals[random.integers(max(0, len(signals) - 8), len(signals))]
        if kind < 2:
            signals.append(graph.apply(p[random.integers(len(p))], one))
        elif kind < 4:
            chosen = random.integers(0, len(signals), 2)
            factors = random.choice([-2.0, -1.0, 0.1, 1.0, 3.0], 2)
            parts = [
                Scaled(factor * signals[k].factor, signals[k].number)
                for factor, k in zip(factors, chosen, strict=True)
            ]
            signals.append(graph.combine(parts))
        else:
            signals.append(graph.divide(by[random.integers(len(by))], one))
    graph.outputs = signals[-3:]
    return graph


def coefficient(graph: SignalGraph, number: int, p: np.ndarray) -> float:
    operation, arguments = graph.nodes[number]
    if operation == "constant":
        return arguments[0]
    if operation == "parameter":
        return float(p[int(arguments[0])])
    a, b = (coefficient(graph, int(argument), p) for argument in arguments)
    return a + b if operation == "add" else a * b


def graph_value(graph: SignalGraph, p: np.ndarray) -> np.ndarray:
    """The outputs at values of the parameters: each signal is computed from those before it."""
    values = np.vstack([np.eye(graph.inputs), np.zeros((graph.size - graph.inputs, graph.inputs))])
    found = {signal: (1.0, terms) for signal, terms in graph.equations}
    found |= {signal: (p[k], (z,)) for signal, k, z in graph.channels}
    found |= {signal: (1.0 / coefficient(graph, b, p), (s,)) for signal, b, s in graph.quotients}
    for signal, (factor, terms) in sorted(found.items()):
        values[signal] = factor * sum(
            term.factor * values[term.number] for term in terms if term.number >= 0
        )
    return np.array(
        [out.factor * values[out.number] if out.number >= 0 else 0.0 * values[0] for out in graph.outputs]
    )


def law_values(graph: SignalGraph, seed: int) -> LFT:
    deltas = np.random.default_rng(seed).uniform(-0.8, 0.8, (4, len(NAMES)))
    p = np.array([[m.b0 + m.gain * d / (1.0 + m.a1 * d) for m, d in zip(MAPS, row, strict=True)] for row in deltas])
    expected = np.array([graph_value(graph, row) for row in p])
    size = max(1.0, float(np.max(np.abs(expected))))
    at = dict(zip(NAMES, deltas.T, strict=True))
    whole, small = close(graph, NAMES, MAPS, all_kept=True), close(graph, NAMES, MAPS)
    for lft in (whole, small):
        roundoff(evaluate(lft, at), expected, KAPPA, size)
    return small


def law_orders(graph: SignalGraph) -> None:
    whole, small = close(graph, NAMES, MAPS, all_kept=True), close(graph, NAMES, MAPS)
    expected = reduce_order(whole).blocks
    assert reduce_order(small).blocks == expected
    assert all(a.size <= b.size for a, b in zip(small.blocks, whole.blocks, strict=True))
    if not graph.quotients:
        assert small.blocks == expected


@given(seeds, st.booleans())
def test_values_stay(seed: int, divisors: bool) -> None:
    law_values(random_graph(seed, divisors=divisors), seed)


@given(seeds, st.booleans())
def test_orders_are_those_of_the_dense_reduction(seed: int, divisors: bool) -> None:
    law_orders(random_graph(seed, divisors=divisors))


def test_nothing_is_an_lft_too() -> None:
    graph = SignalGraph(INPUTS)
    graph.outputs = [Scaled(3.0, 1), Scaled(0.0, -1)]
    assert law_values(graph, 0).order == 0


def found_by(law: object, monkeypatch: pytest.MonkeyPatch) -> bool:
    for seed in range(40):
        try:
            graph = random_graph(seed, divisors=bool(seed % 2))
            law(graph, seed) if law is law_values else law(graph)  # type: ignore[operator]
        except AssertionError:
            return True
    return False


def test_planted_factor_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Dependence.combination

    def wrong(self: Dependence, number: int, row: Row) -> Row | None:
        found = right(self, number, row)
        return None if found is None else {k: 1.001 * factor for k, factor in found.items()}

    monkeypatch.setattr(Dependence, "combination", wrong)
    assert found_by(law_values, monkeypatch)


def test_planted_row_too_few_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Dependence.combination

    def wrong(self: Dependence, number: int, row: Row) -> Row | None:
        return dict.fromkeys(self.rows, 1.0) if len(self.rows) == 2 else right(self, number, row)

    monkeypatch.setattr(Dependence, "combination", wrong)
    assert found_by(law_values, monkeypatch)


def test_planted_blindness_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is ever seen to be a combination; or nobody looks from the side of the outputs."""
    with monkeypatch.context() as patch:
        patch.setattr(Dependence, "_is_sum", lambda *_: False)
        assert found_by(law_orders, monkeypatch)
    monkeypatch.setattr("mbdlft.extract.close.smallest", words.reached)
    assert found_by(law_orders, monkeypatch)
