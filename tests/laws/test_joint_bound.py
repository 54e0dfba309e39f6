"""Laws of the lower bound by pairs and triples of parameters, on residues.

LFTs are written in doubles with numbers of few binary digits, so that their algebra is exact.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import cache, reduce
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from benchmarks.cases.chains import chain
from benchmarks.cases.orders import CASES, Case
from mbdlft.exact.matrices import ExactMatrix, identity, stacked
from mbdlft.lft.lft import LFT, Block, constant, delta, stack_columns, stack_diagonal, stack_rows
from mbdlft.matrix.relations import problem_of_matrix
from mbdlft.multibody.assembly import assemble
from mbdlft.order import lower_bound as module
from mbdlft.order.degree import Pair, Triple, least_more
from mbdlft.order.joint_bound import JointBound
from mbdlft.order.lower_bound import exact_degrees, is_constant, more_needed
from mbdlft.order.reduction import ExactLFT, reduce_exactly, transposed
from mbdlft.order.work import Work
from mbdlft.pipeline.extract import extract
from mbdlft.pipeline.forms import candidates
from mbdlft.problem.relations import linearize
from tests.extracted import exact_matrix, exactly
from tests.extracted import with_bits as with_bits
from tests.strategies import fewer

seeds = st.integers(0, 1000)
bits = st.booleans()


def small(a: LFT) -> ExactLFT:
    """An LFT whose doubles are what is meant, reduced."""
    return reduce_exactly(exactly(a))


def bound(a: ExactLFT) -> int:
    return JointBound(a, exact_degrees(a)).of_all(Work())


def eighths(random: np.random.Generator, *shape: int) -> np.ndarray:
    """Numbers of few digits from -2 to 2, none of them zero."""
    return random.integers(1, 17, shape) * random.choice([-1, 1], shape) / 8


def relations(links: int, *, spatial: bool) -> ExactLFT:
    """The LFT of the relations of a chain, all joints driven and measured."""
    equations = assemble(chain(links, spatial=spatial))
    return reduce_exactly(extract(linearize(equations, range(links), range(links))).lft)


@cache
def of_case(name: str) -> ExactLFT:
    """The smallest LFT of a matrix of the literature before any search."""
    problem = problem_of_matrix(next(case for case in CASES if case.name == name).problem())
    exact = candidates(problem, problem.forms)[0].exact
    assert exact is not None
    return exact


def parameter(name: str, nominal: float) -> LFT:
    return constant([[nominal]]) + delta(name)


def law_table(degrees: int, expected: int, a: ExactLFT) -> None:
    assert sum(exact_degrees(a).values()) == degrees
    assert bound(a) == expected


def test_planar_and_spatial_chains() -> None:
    """2 links in space: 21, which n-D reduction reaches; 3 in the plane: 30."""
    spatial = relations(2, spatial=True)
    law_table(19, 21, spatial)
    assert spatial.order == 21
    law_table(15, 15, relations(2, spatial=False))
    law_table(28, 30, relations(3, spatial=False))


@pytest.mark.long
def test_longer_chains() -> None:
    """6 links in the plane: 90, which n-D reduction reaches; 4 in space: 75, pairs alone prove 74."""
    planar = relations(6, spatial=False)
    law_table(85, 90, planar)
    assert planar.order == 90
    law_table(65, 75, relations(4, spatial=True))


def test_deeper_sections_need_more_lines() -> None:
    """Three links in space: H^1(G(-1, -2)) is not zero, so one line b = const is not enough."""
    a = relations(3, spatial=True)
    (pair,) = JointBound(a, exact_degrees(a)).pairs("L1", "t2", Work())
    assert (pair.first_more, pair.second_more) == (1, 2)


def test_a_matrix_of_the_literature() -> None:
    """O8, order 17 reached."""
    law_table(16, 17, of_case("O8"))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_nothing_is_added_to_a_sum_that_is_reached(case: Case) -> None:
    assert case.bound <= bound(of_case(case.name)) <= case.order


def some_lft(random: np.random.Generator, *, sparse: bool, affine: bool) -> LFT:
    """Two or three deltas up to four times; zeros by chance; some deltas enter affinely, M_kk = 0."""

    def entries(*shape: int) -> np.ndarray:
        zeros = sparse * (random.random(shape) < 0.5)
        return np.where(zeros, 0.0, eighths(random, *shape))

    sizes = random.integers(1, 5, random.integers(2, 4))
    n, (rows, columns) = int(np.sum(sizes)), random.integers(1, 4, 2)
    blocks = tuple(Block(name, int(size)) for name, size in zip("abc", sizes, strict=False))
    M11, M12, M21 = entries(n, n), entries(n, columns), entries(rows, n)
    for part in LFT(M11, M12, M21, np.zeros((rows, columns)), blocks).slices().values():
        if affine and random.random() < 0.5:
            M11[part, part] = 0.0
    return LFT(M11, M12, M21, np.zeros((rows, columns)), blocks)


def inflated(a: LFT, random: np.random.Generator) -> LFT:
    """The same value with more repetitions that n-D reduction keeps: d1 d2 - d2 d1 is zero."""
    for first, second in combinations([name for name, _ in a.blocks], 2):
        d1, d2 = delta(first), delta(second)
        left, right = (eighths(random, *shape) for shape in ((a.shape[0], 1), (1, a.shape[1])))
        a = a + left @ (d1 @ d2 - d2 @ d1) @ right
    return a


@fewer
@given(seeds, bits, bits)
def test_not_above_the_order_of_any_lft(seed: int, sparse: bool, affine: bool) -> None:
    random = np.random.default_rng(seed)
    a = some_lft(random, sparse=sparse, affine=affine)
    order = small(a).order
    assert bound(small(a)) <= order
    assert bound(small(inflated(a, random))) <= order


Word = tuple[np.ndarray, str, np.ndarray]


def word(
    random: np.random.Generator, left: list[np.ndarray], letters: str, most: int, right: list[np.ndarray]
) -> Word:
    """One term, of `most` letters at most."""
    return (
        left[random.integers(len(left))][:, None],
        "".join(random.choice(list(letters), random.integers(1, most + 1))),
        right[random.integers(len(right))][None, :],
    )


def words(random: np.random.Generator) -> list[Word]:
    """Terms x a b a y of a polynomial in two or three parameters; x and y are from a few vectors."""
    rows, columns = random.integers(1, 4, 2)
    left = [*np.eye(rows), *eighths(random, 2, rows)]
    right = [*np.eye(columns), *eighths(random, 2, columns)]
    letters = "abc"[: random.integers(2, 4)]
    return [word(random, left, letters, 4, right) for _ in range(random.integers(3, 7))]


def written(terms: list[Word], order: Callable[[str], Iterable[str]]) -> ExactLFT:
    """The polynomial with the letters of each word in some order, which do commute."""
    total = constant(np.zeros((len(terms[0][0]), terms[0][2].shape[1])))
    for left, word, right in terms:
        product_of_letters = constant(np.eye(1))
        for letter in order(word):
            product_of_letters = product_of_letters @ parameter(letter, (ord(letter) - 94) / 8)
        total = total + left @ product_of_letters @ right
    return small(total)


def in_three_ways(terms: list[Word]) -> list[ExactLFT]:
    ways: list[Callable[[str], Iterable[str]]] = [str, sorted, reversed]
    return [written(terms, way) for way in ways]


@fewer
@given(seeds)
def test_the_order_of_factors_does_not_matter(seed: int) -> None:
    ways = in_three_ways(words(np.random.default_rng(seed)))
    bounds = {bound(a) for a in ways}
    assert len(bounds) == 1
    assert max(bounds) <= min(a.order for a in ways)


def known(g: float, seed: int) -> LFT:
    """g [L^2 0 0 ; 0 0 0] + m N(L), N = [quadratic linear linear ; linear constant constant].

    D_L = D_m = 2. With g = 0 both are enough, as m N(L). Otherwise (1, 0) is in X by hand
    (docs/pairs.md), h = 1, and 5 are needed; they are enough: m for the rows of N, and L three times for
    [N ; L^2 0 0].
    """
    al, be, ga, de, ep, ze, et, ka, th = eighths(np.random.default_rng(seed), 9)
    L, m = parameter("L", 0.375), parameter("m", 0.625)
    slope = linear(de, ep, L)
    first = stack_columns(al + L @ linear(be, ga, L), slope, linear(ze, et, L))
    N = stack_rows(first, stack_columns(slope, [[ka]], [[th]]))
    square = constant([[g], [0.0]]) @ L @ L @ constant([[1.0, 0.0, 0.0]])
    # m at the inputs, three times: not the smallest way of writing
    return N @ stack_diagonal(m, m, m) + square


def linear(constant_part: float, slope: float, a: LFT) -> LFT:
    return constant([[constant_part]]) + constant([[slope]]) @ a


def law_known(g: float, seed: int, change: Callable[[ExactLFT], ExactLFT] = lambda a: a) -> None:
    a = change(small(known(g, seed)))
    degrees = exact_degrees(a)
    assert degrees == {"L": 2, "m": 2}
    assert a.order > 4
    assert bound(a) == (5 if g else 4)


@given(st.sampled_from([0.0, 1.0, -0.75]), seeds)
def test_closed_form(g: float, seed: int) -> None:
    law_known(g, seed)


def pieces(a: ExactLFT) -> tuple[ExactMatrix, ExactMatrix, ExactMatrix, ExactMatrix]:
    n = a.order
    return a.M[:n, :n], a.M[:n, n:], a.M[n:, :n], a.M[n:, n:]


def transformed(a: ExactLFT, random: np.random.Generator) -> ExactLFT:
    """Other inputs and outputs."""
    M11, M12, M21, M22 = pieces(a)
    outputs, inputs = (exact_matrix(3.0 * np.eye(n) + eighths(random, n, n)) for n in M22.shape)
    return ExactLFT(stacked([[M11, M12 @ inputs], [outputs @ M21, outputs @ M22 @ inputs]]), a.blocks)


def with_feedback(a: ExactLFT, random: np.random.Generator) -> ExactLFT:
    """u = v + K y, so y = (I - M22 K)^-1 (M21 w + M22 v)."""
    M11, M12, M21, M22 = pieces(a)
    K = exact_matrix(eighths(random, *M22.T.shape))
    loop = identity(M22.shape[0], a.M.prime) + -(M22 @ K)
    y = loop.solve(stacked([[M21, M22]]))
    return ExactLFT(stacked([[stacked([[M11, M12]]) + M12 @ K @ y], [y]]), a.blocks)


def moebius(a: ExactLFT, random: np.random.Generator) -> ExactLFT:
    """delta = (mu + c)/(1 + c mu), which is c z + (1 - c^2) mu (z - c w)."""
    M11, M12, M21, M22 = pieces(a)
    c = np.repeat(eighths(random, len(a.blocks)) / 4, [block.size for block in a.blocks])
    C, rest, one = (
        exact_matrix(np.diag(c)),
        exact_matrix(np.diag(1 - c * c)),
        identity(a.order, a.M.prime),
    )
    z = (one + -(M11 @ C)).solve(stacked([[M11 @ rest, M12]]))
    n = a.order
    w = C @ z + stacked([[rest, M12 @ exact_matrix(np.zeros((M12.shape[1],) * 2))]])
    outputs = M21 @ w + stacked([[exact_matrix(np.zeros(M21.shape)), M22]])
    top = stacked([[z[:, :n] + -C, z[:, n:]]])
    return ExactLFT(stacked([[top], [outputs]]), a.blocks)


CHANGES: dict[str, Callable[[ExactLFT, np.random.Generator], ExactLFT]] = {
    "inputs and outputs": transformed,
    "feedback": with_feedback,
    "Moebius": moebius,
    "transposition": lambda a, random: transposed(a),
}


@pytest.mark.parametrize("name", CHANGES)
@fewer
@given(st.sampled_from([0.0, 1.0]), seeds)
def test_changes_that_leave_the_problem_as_it_is(name: str, g: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    law_known(g, seed, lambda a: CHANGES[name](a, random))


pairs = st.lists(
    st.builds(
        lambda two, *more: Pair(*two, *more),
        st.sampled_from(list(combinations("abcd", 2))),
        st.integers(1, 3),
        st.integers(1, 3),
        st.lists(st.tuples(st.integers(1, 2), st.integers(1, 2), st.integers(1, 4)), max_size=2),
    ),
    max_size=4,
)


def allows(pair: Pair, more: Mapping[str, int]) -> bool:
    """Whether a pair leaves these repetitions above the degrees possible."""
    first, second = more[pair.first], more[pair.second]
    one_has_none = (first > 0 or second >= pair.second_more) and (second > 0 or first >= pair.first_more)
    return one_has_none and all(y * first + x * second >= h for y, x, h in pair.shared)


def law_least(
    least: Callable[[str, list[Pair], list[Triple]], dict[str, int]], found: list[Pair], number: int = 0
) -> None:
    """Against all repetitions up to 3 more of each; with triples of a delta that is in two pairs."""
    names = [set(pair[:2]) for pair in found]
    both = [(one & two, one ^ two) for one, two in combinations(names, 2) if len(one & two) == 1]
    triples = [Triple(*shared, *sorted(others)) for shared, others in both][:number]
    more = (dict(zip("abcd", counts, strict=True)) for counts in product(range(4), repeat=4))
    allowed = [
        sum(e.values())
        for e in more
        if all(allows(p, e) for p in found)
        and all(e[t.first] > 1 or e[t.second] or e[t.third] for t in triples)
    ]
    assert sum(least("abcd", found, triples).values()) == min(allowed)


@given(pairs, st.integers(0, 3))
def test_least_sum(found: list[Pair], number: int) -> None:
    law_least(least_more, found, number)


def test_a_triple_needs_a_second_repetition() -> None:
    """One more of a is enough for each pair, and not for the three together."""
    found = [Pair("a", "b", 1, 1), Pair("a", "c", 1, 1)]
    assert sum(least_more("abc", found).values()) == 1
    assert sum(least_more("abc", found, [Triple("a", "b", "c")]).values()) == 2


def symmetric(degree: int, count: int) -> str:
    """The sum of all products of so many of the variables."""
    return " + ".join("*".join(f"x{k}" for k in some) for some in combinations(range(count), degree))


DETERMINANT = "x0*(x4*x8 - x5*x7) - x1*(x3*x8 - x5*x6) + x2*(x3*x7 - x4*x6)"


@pytest.mark.parametrize(
    ("text", "order"),
    [
        (symmetric(2, 3), 4),
        (symmetric(2, 4), 6),
        (symmetric(3, 4), 6),
        (DETERMINANT, 12),
        ("(1 + x0)*x1*(2 - x2)", 3),
        ("x1*(x0 + x2)", 3),
    ],
)
def test_affine_triples(text: str, order: int) -> None:
    """Each variable has degree 1; some triples of them cannot all be single."""
    names = sorted({f"x{k}" for k in range(9) if f"x{k}" in text})
    matrix = mbdlft.matrix_problem([[text]], [mbdlft.Parameter(name, 1.5, percent=20) for name in names])
    problem = problem_of_matrix(matrix)
    exact = candidates(problem, problem.forms)[0].exact
    assert exact is not None
    law_table(len(names), order, exact)
    assert exact.order == order


def side_by_side(seed: int) -> ExactLFT:
    """Two matrices that share L, one with m and one with k."""
    first, second = known(1.0, seed), known(-0.75, seed + 1)
    blocks = tuple(Block("k" if name == "m" else name, size) for name, size in second.blocks)
    second = LFT(second.M11, second.M12, second.M21, second.M22, blocks)
    return small(stack_diagonal(first, second))


@pytest.mark.parametrize("seed", range(4))
def test_one_repetition_is_not_enough_for_two(seed: int) -> None:
    """Each needs 5 alone; one L more, which pairs allow, can do for one of them only."""
    a = side_by_side(seed)
    assert exact_degrees(a) == {"L": 4, "m": 2, "k": 2}
    assert a.order > 10
    assert bound(a) == 10


def test_both_together_need_more_than_one_each() -> None:
    """Six matrices that share both parameters: one more of each is not enough."""
    a = small(reduce(stack_diagonal, (known(1.0, seed) for seed in range(6))))
    (pair,) = JointBound(a, exact_degrees(a)).pairs("L", "m", Work())
    assert pair[2:5] == (6, 3, ((1, 3, 6), (2, 2, 6)))
    law_table(24, 27, a)


@pytest.mark.parametrize("most", [600, 120])
def test_a_part_can_need_more_than_the_whole(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """Rows [L^2, L + m, L m] need one more each: without more L, four m, though three do for all."""
    monkeypatch.setattr(module, "_MOST_COEFFICIENTS", {1: most})
    L, m = parameter("L", 0.375), parameter("m", 0.625)
    row = stack_columns(L @ L, L + m, L @ m)
    a = small(stack_diagonal(known(1.0, 0), row, row, row, row))
    (pair,) = JointBound(a, exact_degrees(a)).pairs("L", "m", Work())
    assert pair[2:5] == (5, 4, ((1, 2, 4), (1, 3, 5), (2, 1, 4), (2, 2, 5)))
    law_table(16, 19, a)


@pytest.mark.parametrize("most", [600, 265])
def test_one_side_is_enough(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """Six matrices and m^2, which needs no more; polynomials in m have more than 265 coefficients."""
    monkeypatch.setattr(module, "_MOST_COEFFICIENTS", {1: most})
    m = parameter("m", 0.625)
    a = small(stack_diagonal(*(known(1.0, seed) for seed in range(6)), m @ m))
    (pair,) = JointBound(a, exact_degrees(a)).pairs("L", "m", Work())
    assert (*pair[2:4], *sorted(pair.shared)) == (6, 3, (1, 3, 6), (2, 2, 6))


# where pairs prove one less than triples
TWO_LETTERS = (32, 136, *(pytest.param(k, marks=pytest.mark.long) for k in (251, 536, 559, 627, 818)))


def words_of_two_letters(random: np.random.Generator) -> list[Word]:
    """Like `words`, mostly in a and one of two others."""
    rows, columns = random.integers(1, 5, 2)
    left = [*np.eye(rows), *eighths(random, 1, rows)]
    right = [*np.eye(columns), *eighths(random, 1, columns)]
    return [
        word(random, left, letters, 3, right)
        for letters in random.choice(
            ["ab", "ac", "bc", "abc"], random.integers(4, 9), p=[0.4, 0.4, 0.1, 0.1]
        )
    ]


@pytest.mark.parametrize("seed", TWO_LETTERS)
def test_triples_are_reached(seed: int) -> None:
    """The bound is the order that n-D reduction reaches from one of three ways to write it."""
    ways = in_three_ways(words_of_two_letters(np.random.default_rng(seed)))
    assert {bound(a) for a in ways} == {min(a.order for a in ways)}


def test_models_say_what_is_proved() -> None:
    """Two links in space: 19 one by one, 21 by pairs, 21 reached."""
    scene = chain(2, spatial=True)
    certificate = mbdlft.to_lft(scene, search=20.0).certificate
    assert sum(certificate.lower_bound) == 19
    assert certificate.order_bound == 21 == sum(certificate.order)
    assert certificate.minimal
    # without a search the pairs are not looked at
    plain = mbdlft.to_lft(scene, search=0.0).certificate
    assert plain.order_bound == 19
    assert not plain.minimal


def test_work_is_counted() -> None:
    """Nothing is proved when the work is over, and proofs are counted, each once."""
    over, counted = Work(0.0), Work()
    over.add(1.0)
    assert over.is_over
    a = small(known(1.0, 0))
    degrees = exact_degrees(a)
    for work, more in ((over, (0, 0)), (counted, (1, 1))):
        assert more_needed(a, "L", "m", degrees, work, is_transposed=False)[:2] == more
    assert counted.spent > 0.0
    joint = JointBound(a, degrees)
    assert joint.of_all(over) == 4
    assert joint.of_all(Work(1e-4)) == 4  # cut off, and looked at again with more
    assert joint.of_all(counted) == 5 == joint.known
    spent = counted.spent
    assert joint.of_all(counted) == 5
    assert counted.spent == spent
    (a, *_) = in_three_ways(words_of_two_letters(np.random.default_rng(136)))
    names = ("a", "b", "c")
    assert not is_constant(a, names, exact_degrees(a), over, is_transposed=True)


def test_points_are_counted() -> None:
    """Ten times as many points take most of ten times the work."""
    a, spent = small(known(1.0, 0)), list[float]()
    for count in (10, 100):
        work, points = Work(), np.arange(1, count + 1)
        H = module._function(a, ("L", "m"), work, is_transposed=False)
        before = work.spent
        H.seen({"L": points, "m": points}, np.ones((count, H.shape[0]), dtype=np.int64))
        spent.append(work.spent - before)
    assert spent[1] > 5.0 * spent[0]


def test_points_that_take_too_long_are_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take what is left here, or in all; with more work they are taken."""
    a = small(known(1.0, 0))
    for most, units in ((0.1, 1.0), (1.0, 0.1)):
        joint, whole = JointBound(a, exact_degrees(a)), Work(most)
        with monkeypatch.context() as many:
            many.setattr(module, "_SURPLUS", 10_000)
            many.setattr(module._Function, "surplus", lambda *_: 10_000)
            assert joint.of_all(whole.limited(units)) == 4
        assert 0.0 < whole.spent < 0.1
        assert joint.of_all(Work()) == 5


def test_too_few_points_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_SURPLUS", -12)
    law_table(16, 17, of_case("O8"))
