"""Laws of rational matrices: fractions, relations and LFTs that follow from values."""

import itertools
import operator
import tracemalloc
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import flint
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scaling import scene
from mbdlft import Parameter, realize
from mbdlft.base.parameter import BilinearMap
from mbdlft.exact.numbers import BITS, Exact, precision
from mbdlft.exact.ratio import NotFractionError, Polynomial, Ratio, sign_on, square_root
from mbdlft.lft.lft import LFT
from mbdlft.lft.sampling import evaluate
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals
from mbdlft.order import rational
from mbdlft.order.rational import RationalMatrix, Terms, _monomials, lifted, low_relations
from mbdlft.order.recovery import Recovered, recovered
from mbdlft.order.reduction import reduce_order
from mbdlft.order.work import Work
from mbdlft.pipeline.extract import extract
from mbdlft.pipeline.extract import noncommuting as words
from mbdlft.pipeline.extract.graph import Scaled, SignalGraph, opened, reduced
from mbdlft.pipeline.extract.noncommuting import Dependence, Row
from mbdlft.problem.relations import linearize
from tests.close import roundoff, target
from tests.extracted import FIELD

CONTEXT = flint.fmpq_mpoly_ctx.get(["x", "y"])
ARITHMETIC = [operator.add, operator.sub, operator.mul]
Point = Sequence[Fraction]


def fraction(x: Any) -> Fraction:
    return Fraction(int(x.p), int(x.q))


def at(terms: Terms, point: Point) -> Fraction:
    return sum(
        (
            c * np.prod([x**e for x, e in zip(point, exponents, strict=True)])
            for exponents, c in terms.items()
        ),
        Fraction(0),
    )


def terms_of(polynomial: Any) -> Terms:
    return {tuple(map(int, e)): fraction(c) for e, c in polynomial.to_dict().items()}


def ratio(random: np.random.Generator) -> Ratio:
    n, d = (
        CONTEXT.from_dict({tuple(e): int(c) for *e, c in random.integers(0, 4, (4, 3)).tolist() if c})
        for _ in range(2)
    )
    return Ratio(n, d + 5)


@pytest.mark.parametrize("operation", ARITHMETIC, ids=lambda each: each.__name__)
@pytest.mark.parametrize("seed", range(10))
def test_ratios(operation: Callable[[Any, Any], Any], seed: int) -> None:
    random, point = np.random.default_rng(seed), (Fraction(2, 7), Fraction(-5, 3))
    a, b = ratio(random), ratio(random)

    def value(x: Ratio) -> Fraction:
        return at(terms_of(x.n), point) / at(terms_of(x.d), point)

    assert value(operation(a, b)) == operation(value(a), value(b))
    assert value(operation(a, 0.3)) == operation(value(a), Fraction(3, 10))
    assert value(operation(0.3, a)) == operation(Fraction(3, 10), value(a))
    assert value(a / (b * b + 1)) == value(a) / (value(b) ** 2 + 1)
    assert value(-a) == -value(a)
    product = operation(a, b)
    assert product.d.leading_coefficient() == 1
    assert product.n.gcd(product.d).is_constant()


@pytest.mark.parametrize("seed", range(10))
def test_roots_of_squares(seed: int) -> None:
    random = np.random.default_rng(seed)
    a = ratio(random) + 1
    number, r = square_root(a * a * 2)
    assert (r * r * number - a * a * 2).n == 0
    assert square_root(a * a * -2) is None
    assert square_root(a * a * Ratio(CONTEXT.gens()[0], a.d.context().constant(1))) is None
    zero = a - a
    assert square_root(zero)[1].n == 0
    assert sign_on(zero, [(Fraction(0), Fraction(1))] * 2) == 1


def test_signs_on_a_box() -> None:
    """Zeros at corners, edges and inside; a curve that leaves no corner on its other side."""
    x, y = (Ratio(symbol, CONTEXT.constant(1)) for symbol in CONTEXT.gens())
    box = [(Fraction(1), Fraction(2)), (Fraction(3), Fraction(4))]
    cases = [
        (x - 1, 1), (1 - x, -1), (x - 2, -1), ((x - 1) * (y - 4), -1), (x * y - 3, 1), (x * x * y - 3, 1),
        ((x - y) * (x - y), 1), (x - 1.5, 0), (x * y - 4, 0), (x * x + y - 4, 1),
        (x * x - 2.5 * x + 1.5625, 1), ((x - 1.25) * (x * x - 2.5 * x + 1.5625), 0),
        ((x - 1.1) * (x - 1.1) - 0.001, 0), ((x - 1.9) * (x - 1.9) - 0.001, 0),
        ((x - 1.5) * (x - 1.5) + 0.1 - 0.1 * (y - 3), 1), (y * y * y - 27 * x * x + 90, 1),
        ((x - 1.5) * (x - 1.5) - 0.1, 0), ((x - 1.5) * (x - 1.5) - 0.001, 0), (1 / (x - 3), -1),
        ((x - 1) / (1 - y), -1), ((x - 1.5) * (x - 1.5) + (y - 3.5) * (y - 3.5) + 1e-3, 1),
    ]  # fmt: skip
    for k, (function, sign) in enumerate(cases):
        assert sign_on(function, box) == sign, k
        assert sign_on(-function, box) == -sign, k


def test_polynomials_are_not_divided_by_polynomials() -> None:
    x, one = CONTEXT.gens()[0], CONTEXT.constant(1)
    for divisor in (Polynomial(x, one), Polynomial(x - x, one)):
        with pytest.raises(NotFractionError):
            Polynomial(x, one) / divisor


def known(seed: int) -> tuple[RationalMatrix, int]:
    """N / d of a random LFT in 1 to 3 parameters, with entries of halves, and its order."""
    random = np.random.default_rng(seed)
    sizes = random.integers(1, 4, int(random.integers(1, 4))).tolist()
    n, p, q = sum(sizes), *random.integers(1, 4, 2).tolist()
    M = random.integers(-3, 4, (n + p, n + q)) * (random.random((n + p, n + q)) < 0.7)
    names = [f"p{k}" for k in range(len(sizes))]
    context = flint.fmpq_mpoly_ctx.get(names)
    channels = [context.gens()[k] for k, size in enumerate(sizes) for _ in range(size)]
    loop = [
        [context.constant(int(i == j)) - flint.fmpq(int(M[i, j]), 2) * channels[j] for j in range(n)]
        for i in range(n)
    ]
    d = determinant(loop, context)
    # y_i of u_j: the determinant of the loop with a row of M21 p and a column of -M12 beside it, over d
    N = []
    for i in range(p):
        row = []
        for j in range(q):
            border = [*(flint.fmpq(int(M[n + i, k]), 2) * channels[k] for k in range(n))]
            column = [context.constant(flint.fmpq(-int(M[k, n + j]), 2)) for k in range(n)]
            corner = context.constant(flint.fmpq(int(M[n + i, n + j]), 2))
            matrix = [[*line, x] for line, x in zip(loop, column, strict=True)] + [[*border, corner]]
            row.append(determinant(matrix, context))
        N.append(row)
    shared = d
    for x in itertools.chain(*N):
        shared = shared.gcd(x)
    reduced = [[terms_of(divmod(x, shared)[0]) for x in row] for row in N]
    return RationalMatrix(reduced, terms_of(divmod(d, shared)[0]), len(sizes)), n


def determinant(matrix: list[list[Any]], context: Any) -> Any:
    """Bareiss: every division is exact."""
    a, sign, previous = [list(row) for row in matrix], 1, context.constant(1)
    for k in range(len(a) - 1):
        pivot = next((i for i in range(k, len(a)) if a[i][k] != 0), None)
        if pivot is None:
            return context.constant(0)
        if pivot != k:
            a[k], a[pivot], sign = a[pivot], a[k], -sign
        for i in range(k + 1, len(a)):
            for j in range(k + 1, len(a)):
                a[i][j] = divmod(a[i][j] * a[k][k] - a[i][k] * a[k][j], previous)[0]
        previous = a[k][k]
    return sign * a[-1][-1]


def value_of(lft: Recovered, point: Point) -> Any:
    """M22 + M21 P (I - M11 P)^-1 M12 in fractions."""
    n = lft.order
    P = [point[k] for k, size in lft.blocks for _ in range(size)]
    to = lambda a: flint.fmpq_mat(  # noqa: E731
        len(a), len(a[0]), [flint.fmpq(x.numerator, x.denominator) for row in a for x in row]
    )
    M = lft.M.tolist()
    direct = to([row[n:] for row in M[n:]])
    if not n:
        return direct
    loop = to([[Fraction(int(i == j)) - M[i][j] * P[j] for j in range(n)] for i in range(n)])
    seen = to([[x * P[j] for j, x in enumerate(row[:n])] for row in M[n:]])
    return direct + seen * loop.solve(to([row[n:] for row in M[:n]]))


@pytest.mark.parametrize("seed", [*range(16), 230, 306])  # a second prime; columns
def test_lft_of_values(seed: int) -> None:
    """It has the values, at fractions, and is no larger than the LFT that they came from."""
    F, order = known(seed)
    lft = recovered(F, Work(4.0))
    assert lft is not None or (len(F.N), len(F.N[0])) == (1, 1)  # one entry alone is a nonlinear problem
    if lft is None:
        return
    assert lft.order <= order
    for point in ([Fraction(3, 11), Fraction(-2, 7), Fraction(5, 13)], [Fraction(1, 9)] * 3):
        found, d = value_of(lft, point[: F.parameters]), at(F.d, point[: F.parameters])
        for i, row in enumerate(F.N):
            assert [fraction(found[i, j]) * d for j in range(len(row))] == [
                at(x, point[: F.parameters]) for x in row
            ]


@pytest.mark.parametrize("seed", [2, 3, 6, 12, 14, 20, 23, 35])  # orders up to 4, and so degrees
def test_relations_of_values(seed: int) -> None:
    """D F = N at fractions, with D regular."""
    F, _ = known(seed)
    rows, p = low_relations(F, Work(4.0)), len(F.N)
    assert rows is not None
    point = [Fraction(3, 11), Fraction(-2, 7), Fraction(5, 13)][: F.parameters]
    values = [[at(x, point) for x in row] for row in F.N]
    D = np.array([[at(x, point) for x in row[:p]] for row in rows])
    N = np.array([[at(x, point) for x in row[p:]] for row in rows])
    assert np.all(D @ np.array(values) == N * at(F.d, point))
    assert flint.fmpq_mat(p, p, [flint.fmpq(x.numerator, x.denominator) for x in D.flat]).rank() == p


SYMMETRIC = [["b*c - e^2", "e*f - d*c", "d*e - b*f"], ["e*f - d*c", "a*c - f^2", "d*f - a*e"]]
SYMMETRIC += [["d*e - b*f", "d*f - a*e", "a*b - d^2"]]
DETERMINANT = "(a*b*c + 2*d*e*f - a*e^2 - b*f^2 - c*d^2)"
BOX = [Parameter(name, 2.0, 1.8, 2.2) for name in "abc"] + [
    Parameter(name, 0.3, 0.2, 0.4) for name in "def"
]


def test_residues_of_no_fractions_are_not_lifted_for_long() -> None:
    """55 primes were the most of 250 random matrices; those in vain are seconds."""
    random, used = np.random.default_rng(0), list[int]()

    def modulo(prime: int) -> np.ndarray:
        used.append(prime)
        return random.integers(0, prime, 3)

    assert lifted(modulo, Work()) is None
    assert 55 < len(used) < 100


@pytest.mark.parametrize(
    "entry",
    ["({})/" + DETERMINANT, pytest.param("({}) * (1/" + DETERMINANT + ")", marks=pytest.mark.long)],
)
def test_inverse_of_a_symmetric_matrix(entry: str) -> None:
    """Adjugate over determinant: 49 repetitions as it is written; 9 by relations, one for each entry."""
    model = realize([[entry.format(x) for x in row] for row in SYMMETRIC], BOX, search=0.0)
    assert model.order == sum(model.certificate.lower_bound) == 9
    at_corner = model.at(a=1.8, b=2.2, c=1.8, d=0.2, e=0.4, f=0.4).D
    expected = np.linalg.inv([[1.8, 0.2, 0.4], [0.2, 2.2, 0.4], [0.4, 0.4, 1.8]])
    target(at_corner, expected, 1e-12)


def test_a_denominator_that_is_zero_where_all_parameters_are() -> None:
    entries = [[f"{x}/(a*b - d^2)" for x in row] for row in ("bd", "da")]
    model = realize(entries, BOX, search=0.0)
    assert model.order == sum(model.certificate.lower_bound) == 4
    target(model.at(a=1.8, b=2.2, d=0.2).D, np.linalg.inv([[1.8, -0.2], [-0.2, 2.2]]), 1e-12)


# Laws of the exact reduction of words.

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
        whole = words.closed(words.with_sums_put_in(opened(graph)), len(graph.quotients), NAMES, MAPS)
        return whole.rounded(), reduced(graph, NAMES, MAPS).closed().lft.rounded()


def law_values(graph: SignalGraph, seed: int) -> LFT:
    deltas = np.random.default_rng(seed).uniform(-0.8, 0.8, (4, len(NAMES)))
    p = np.array(
        [[m.b0 + m.gain * d / (1.0 + m.a1 * d) for m, d in zip(MAPS, row, strict=True)] for row in deltas]
    )
    expected = np.array([graph_value(graph, row) for row in p])
    size = max(1.0, float(np.max(np.abs(expected))))
    at = dict(zip(NAMES, deltas.T, strict=True))
    whole, small = both(graph)
    with precision(BITS), pytest.MonkeyPatch.context() as patch:
        patch.setattr(words, "_MANY", 0)
        long = reduced(graph, NAMES, MAPS)
        sparse, closed = long.sparse().lft.lft, long.closed().lft.rounded()
    for lft in (whole, small, sparse, closed):
        roundoff(evaluate(lft, at), expected, KAPPA, size)
    assert sparse.blocks == small.blocks
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


def test_monomials_of_many_parameters() -> None:
    """Of 40 parameters up to the second degree; of 400 they are too many, and not all are listed."""
    found = _monomials((2,) * 40, 2)
    assert len(found) == len(set(found)) == 1 + 40 + 40 * 39 // 2
    assert found == sorted(found, key=lambda e: (-sum(e), e))
    assert _monomials((3, 2), 2) == [(1, 1), (2, 0), (0, 1), (1, 0), (0, 0)]
    assert rational._MOST_UNKNOWNS < len(_monomials((2,) * 400, 4)) < 400**3
