"""Laws of the exact reduction of words.

1. what a graph says at values of the parameters, its LFT says, with all channels and with those that stay
2. what stays has the order that n-D reduction finds; without quotients nothing is left for it to do
3. a row is a combination of earlier ones where the rank says so, and not where it nearly is one
4. a graph with many channels becomes an LFT without any matrix between all of them
"""

import tracemalloc
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scaling import scene
from mbdlft.base.parameter import BilinearMap
from mbdlft.exact.numbers import BITS, Exact, precision
from mbdlft.lft.lft import LFT
from mbdlft.lft.sampling import evaluate
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals
from mbdlft.order.reduction import reduce_order
from mbdlft.pipeline.extract import extract
from mbdlft.pipeline.extract import noncommuting as words
from mbdlft.pipeline.extract.graph import Scaled, SignalGraph, close
from mbdlft.pipeline.extract.noncommuting import Dependence, Row
from mbdlft.problem.relations import linearize
from tests.close import roundoff
from tests.extracted import FIELD

NAMES = ["q", "a", "m"]  # not sorted: blocks are
MAPS = [BilinearMap(0.5, 0.25, 0.0), BilinearMap(1.5, 0.5, 0.25), BilinearMap(-0.75, 0.5, 0.0)]
INPUTS = 2
KAPPA = 1e3
seeds = st.integers(0, 2**32 - 1)


def number(value: float) -> Exact:
    with precision(BITS):
        return FIELD.rational(Fraction(value))


@precision(BITS)
def random_graph(seed: int, *, divisors: bool) -> SignalGraph:
    """Sums, products and quotients by chance, of few kinds: many are equal in the end."""
    random = np.random.default_rng(seed)
    graph = SignalGraph(INPUTS, FIELD)
    p = [graph.node("parameter", float(k)) for k in range(len(NAMES))]
    square = graph.node("multiply", p[0], p[0])
    by = [
        graph.node("add", graph.constant(number(1.0)), square),
        graph.node("add", graph.constant(number(4.0)), graph.node("multiply", p[1], p[2])),
    ]
    signals = [Scaled(FIELD.one, k) for k in range(INPUTS)]
    for _ in range(24):
        kind = random.integers(5 if divisors else 4)
        one = signals[random.integers(max(0, len(signals) - 8), len(signals))]
        if kind < 2:
            signals.append(graph.apply(p[random.integers(len(p))], one))
        elif kind < 4:
            chosen = random.integers(0, len(signals), 2)
            factors = random.choice([-2.0, -1.0, 0.1, 1.0, 3.0], 2)
            parts = [
                graph.scaled(number(factor), signals[k])
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
        return float(arguments[0])
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
            float(term.factor) * values[term.number] for term in terms if term.number >= 0
        )
    return np.array(
        [
            float(out.factor) * values[out.number] if out.number >= 0 else 0.0 * values[0]
            for out in graph.outputs
        ]
    )


def both(graph: SignalGraph) -> tuple[LFT, LFT]:
    """In doubles, with all channels and with those that stay."""
    with precision(BITS):
        whole = close(graph, NAMES, MAPS, all_kept=True)
        return whole.rounded(), close(graph, NAMES, MAPS).rounded()


def law_values(graph: SignalGraph, seed: int) -> LFT:
    deltas = np.random.default_rng(seed).uniform(-0.8, 0.8, (4, len(NAMES)))
    p = np.array(
        [[m.b0 + m.gain * d / (1.0 + m.a1 * d) for m, d in zip(MAPS, row, strict=True)] for row in deltas]
    )
    expected = np.array([graph_value(graph, row) for row in p])
    size = max(1.0, float(np.max(np.abs(expected))))
    at = dict(zip(NAMES, deltas.T, strict=True))
    whole, small = both(graph)
    for lft in (whole, small):
        roundoff(evaluate(lft, at), expected, KAPPA, size)
    return small


def law_orders(graph: SignalGraph, seed: int = 0) -> None:
    whole, small = both(graph)
    expected = reduce_order(whole).blocks
    assert reduce_order(small).blocks == expected
    assert small.order <= whole.order
    if not graph.quotients:
        assert small.blocks == expected


@given(seeds, st.booleans())
def test_values_stay(seed: int, divisors: bool) -> None:
    law_values(random_graph(seed, divisors=divisors), seed)


@given(seeds, st.booleans())
def test_orders_are_those_of_the_dense_reduction(seed: int, divisors: bool) -> None:
    law_orders(random_graph(seed, divisors=divisors))


def test_nothing_is_an_lft_too() -> None:
    graph = SignalGraph(INPUTS, FIELD)
    graph.outputs = [Scaled(number(3.0), 1), graph.zero]
    assert law_values(graph, 0).order == 0


def found_by(law: Callable[[SignalGraph, int], object]) -> bool:
    """Whether a law does not hold for some graph."""
    for seed in range(40):
        try:
            law(random_graph(seed, divisors=bool(seed % 2)), seed)
        except AssertionError:
            return True
    return False


def test_planted_factor_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Dependence.combination

    def wrong(self: Dependence, own: int, row: Row) -> Row | None:
        found = right(self, own, row)
        return None if found is None else {k: number(1.001) * f for k, f in found.items()}

    assert not found_by(law_values)
    monkeypatch.setattr(Dependence, "combination", wrong)
    assert found_by(law_values)


def test_planted_row_too_few_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Dependence.combination

    def wrong(self: Dependence, k: int, row: Row) -> Row | None:
        return dict.fromkeys(self.rows, FIELD.one) if len(self.rows) == 2 else right(self, k, row)

    monkeypatch.setattr(Dependence, "combination", wrong)
    assert found_by(law_values)


def test_planted_blindness_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is ever seen to be a combination, or nobody looks from the side of the outputs."""
    assert not found_by(law_orders)
    with monkeypatch.context() as patch:
        patch.setattr(Dependence, "combination", lambda *_: None)
        assert found_by(law_orders)
    monkeypatch.setattr("mbdlft.pipeline.extract.graph.smallest", words.reached)
    assert found_by(law_orders)


# rows ---------------------------------------------------------------------------------------


def random_rows(seed: int, count: int = 14, width: int = 9) -> np.ndarray:
    """Rows of small whole numbers; some are combinations of two others."""
    random = np.random.default_rng(seed)
    rows = random.integers(-2, 3, (count, width)) * (random.random((count, width)) < 0.4)
    for k in range(3, count):
        if random.random() < 0.4:
            i, j = random.integers(0, k, 2)
            rows[k] = rows[i] * random.integers(-2, 3) + rows[j]
    return rows.astype(float)


def sparse(row: np.ndarray) -> Row:
    return {int(k): number(row[k]) for k in np.flatnonzero(row)}


def law_combinations(seed: int) -> None:
    rows = random_rows(seed)
    known, kept = Dependence(), []
    for k, row in enumerate(rows):
        found = known.combination(k, sparse(row))
        rank = np.linalg.matrix_rank(rows[[*kept, k]]) if row.any() else len(kept)
        assert (found is None) == (rank > len(kept))
        if found is None:
            kept.append(k)
            continue
        assert set(found) <= set(kept)
        total = sum((float(f) * rows[j] for j, f in found.items()), np.zeros(len(row)))
        roundoff(total, row, KAPPA)


def test_combinations_are_found_where_the_rank_says_so() -> None:
    with precision(BITS):
        for seed in range(300):
            law_combinations(seed)


@pytest.mark.parametrize("distance", [2.0**-300, 2.0**-60, 2.0**-40, 2.0**-20])
def test_a_row_that_nearly_is_a_combination_is_kept(distance: float) -> None:
    rows = [sparse(np.array(row)) for row in ((1.0, 1.0, 0.0), (1.0, 0.0, 3.0), (2.0, 1.0, 3.0))]
    known = Dependence()
    with precision(BITS):
        assert [known.combination(k, row) for k, row in enumerate(rows[:2])] == [None, None]
        beside = number(1.0) + number(distance)
        assert known.combination(2, rows[2] | {1: beside}) is None
        assert known.combination(3, rows[2]) == {0: FIELD.one, 1: FIELD.one}


@pytest.mark.parametrize("distance", [2.0**-10, 2.0**-60, 2.0**-300])
def test_rows_that_are_nearly_one_carry_what_lies_beside_them(distance: float) -> None:
    """A large difference of the two is exact."""
    known = Dependence()
    rows = [{0: number(1.0), 1: number(1.0)}, {0: number(1.0)}, {1: number(1.0)}]
    with precision(2 * BITS):
        rows[1][1] = number(1.0) + number(distance)
        found = [known.combination(k, row) for k, row in enumerate(rows)]
        assert found[:2] == [None, None]
        assert found[2] == {0: number(-1.0 / distance), 1: number(1.0 / distance)}


# size -----------------------------------------------------------------------------------------


def test_no_matrix_between_all_channels() -> None:
    """A chain in the plane with 21 parameters: hundreds of channels."""
    chain = scene("planar chain", 7, few=False)
    equations = assemble(chain)
    relations = linearize(equations, *choose_signals(chain, equations))
    tracemalloc.start()
    with precision(BITS):
        found = extract(relations)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    raw = sum(found.channels.values())
    assert 3 * found.lft.order < raw
    assert peak < 16 * raw**2, "a matrix between all channels: a residue and a ball each"
