"""Laws of the bound by pairs and triples of parameters.

1. it has the values of the table: reached orders are proved minimal, attained sums get nothing more
2. it is not above the order of any LFT of the same matrix, whatever LFT it is computed from, and the
   same for all of them
3. it stays with constant transformations, feedback, transposition, units and Moebius
   changes of the parameters
4. a closed form where it is known by hand
5. the least sum of repetitions is that of an enumeration
"""

from collections.abc import Callable, Iterable
from itertools import combinations, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from benchmarks.cases.chains import chain
from benchmarks.cases.orders import CASES, Case
from mbdlft.lft.evaluation import evaluate_at
from mbdlft.lft.lft import (
    LFT,
    Block,
    constant,
    delta,
    stack_columns,
    stack_diagonal,
    stack_rows,
    transpose,
)
from mbdlft.multibody.assembly import assemble
from mbdlft.order import pairs as joint
from mbdlft.order import sections
from mbdlft.order.pairs import Pair, Triple, joint_bound, least_more
from mbdlft.order.reduction_in_doubles import reduce_order
from mbdlft.problem.relations import linearize
from tests.close import roundoff
from tests.extracted import extracted, lower_bound

KAPPA = 1e3
RESIDUE = 1e-17  # what cancelling leaves of terms of size one
seeds = st.integers(0, 1000)
bits = st.booleans()


def bound(a: LFT) -> int:
    """The bound, from the degrees in double precision."""
    return joint_bound(a, lower_bound(a))


def relations(links: int, *, spatial: bool) -> LFT:
    """The LFT of the relations of a chain, all joints driven and measured."""
    equations = assemble(chain(links, spatial=spatial))
    return reduce_order(extracted(linearize(equations, range(links), range(links))))


def parameter(name: str, nominal: float) -> LFT:
    return constant([[nominal]]) + delta(name)


def power(a: LFT, exponent: int) -> LFT:
    return a if exponent == 1 else power(a, exponent - 1) @ a


def o8() -> LFT:
    """O8 of the literature on order reduction, order 17 reached."""
    s, x, y, z = (parameter(name, 0.37 + 0.11 * k) for k, name in enumerate("sxyz"))
    square, cube = power(x, 2), power(z, 3)
    first = stack_columns(
        s @ square @ cube + constant([[3.0]]) @ x @ y @ z, square @ power(y, 2) @ cube, [[1.0]]
    )
    last = x @ power(y, 2) @ z - square @ y @ z
    second = stack_columns([[0.0]], power(s, 2) @ power(x, 3) @ y @ z, last)
    return reduce_order(stack_rows(first, second))


def law_table(degrees: int, expected: int, a: LFT) -> None:
    assert sum(lower_bound(a).values()) == degrees
    assert bound(a) == expected


def test_planar_and_spatial_chains() -> None:
    """2 links in space: 21 and 6 in the plane: 90, which n-D reduction reaches; 3 in the plane: 30."""
    spatial = relations(2, spatial=True)
    law_table(19, 21, spatial)
    assert spatial.order == 21
    law_table(15, 15, relations(2, spatial=False))
    law_table(28, 30, relations(3, spatial=False))
    planar = relations(6, spatial=False)
    law_table(85, 90, planar)
    assert planar.order == 90


def law_deeper() -> None:
    """Three links in space: H^1(G(-1, -2)) is not zero, so one line b = const is not enough."""
    a = relations(3, spatial=True)
    (pair,) = (p for p in joint.pair_bounds(a, lower_bound(a)) if p[:2] == ("L1", "t2"))
    assert (pair.first_more, pair.second_more) == (1, 2)


def test_deeper_sections_need_more_lines() -> None:
    law_deeper()


def test_planted_depth_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the sections that vanish once."""
    right = joint.obstruction

    def planted(*arguments: Any) -> Any:
        found = right(*arguments)
        return found._replace(dimensions=found.dimensions[:1])

    monkeypatch.setattr(joint, "obstruction", planted)
    with pytest.raises(AssertionError):
        law_deeper()


def test_a_matrix_of_the_literature() -> None:
    law_table(16, 17, o8())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_nothing_is_added_to_a_sum_that_is_reached(case: Case) -> None:
    model = mbdlft.realize(case.problem(), search=0.0)
    degrees = mbdlft.exact_lower_bound(case.problem())
    assert case.bound <= joint_bound(model.lft, degrees) <= case.order


def some_lft(random: np.random.Generator, *, sparse: bool, affine: bool) -> LFT:
    """Two or three deltas up to four times; zeros by chance; some deltas enter affinely, M_kk = 0."""

    def entries(*shape: int) -> np.ndarray:
        zeros = sparse * (random.random(shape) < 0.5)
        return np.where(zeros, 0.0, random.standard_normal(shape))

    sizes = random.integers(1, 5, random.integers(2, 4))
    n, (rows, columns) = int(np.sum(sizes)), random.integers(1, 4, 2)
    blocks = tuple(Block(name, int(size)) for name, size in zip("abc", sizes, strict=False))
    M11 = entries(n, n)
    M11 *= 0.6 / max(1.0, float(np.linalg.norm(M11, 2)))
    M12, M21 = entries(n, columns), entries(rows, n)
    for part in LFT(M11, M12, M21, np.zeros((rows, columns)), blocks).slices().values():
        if affine and random.random() < 0.5:
            M11[part, part] = 0.0
    return LFT(M11, M12, M21, np.zeros((rows, columns)), blocks)


def inflated(a: LFT, random: np.random.Generator) -> LFT:
    """The same value with more repetitions that n-D reduction keeps: d1 d2 - d2 d1 is zero."""
    for first, second in combinations([name for name, _ in a.blocks], 2):
        d1, d2 = delta(first), delta(second)
        left, right = (
            random.standard_normal(shape) for shape in ((a.shape[0], 1), (1, a.shape[1]))
        )
        a = a + left @ (d1 @ d2 - d2 @ d1) @ right
    return reduce_order(a)


def law_safe(seed: int, *, sparse: bool, affine: bool) -> None:
    random = np.random.default_rng(seed)
    small = reduce_order(some_lft(random, sparse=sparse, affine=affine))
    assert bound(small) <= small.order
    assert bound(inflated(small, random)) <= small.order


@given(seeds, bits, bits)
def test_not_above_the_order_of_any_lft(seed: int, sparse: bool, affine: bool) -> None:
    law_safe(seed, sparse=sparse, affine=affine)


Word = tuple[np.ndarray, str, np.ndarray]


def word(
    random: np.random.Generator,
    left: list[np.ndarray],
    letters: str,
    most: int,
    right: list[np.ndarray],
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
    left = [*np.eye(rows), *random.standard_normal((2, rows))]
    right = [*np.eye(columns), *random.standard_normal((2, columns))]
    letters = "abc"[: random.integers(2, 4)]
    return [word(random, left, letters, 4, right) for _ in range(random.integers(3, 7))]


def written(terms: list[Word], order: Callable[[str], Iterable[str]]) -> LFT:
    """The polynomial with the letters of each word in some order, which do commute."""
    total = constant(np.zeros((len(terms[0][0]), terms[0][2].shape[1])))
    for left, word, right in terms:
        product_of_letters = constant(np.eye(1))
        for letter in order(word):
            product_of_letters = product_of_letters @ parameter(letter, 0.1 * ord(letter) - 9.3)
        total = total + left @ product_of_letters @ right
    return reduce_order(total)


def in_three_ways(terms: list[Word]) -> list[LFT]:
    ways: list[Callable[[str], Iterable[str]]] = [str, sorted, reversed]
    return [written(terms, way) for way in ways]


def law_words(seed: int) -> None:
    found = in_three_ways(words(np.random.default_rng(seed)))
    bounds = {bound(a) for a in found}
    assert len(bounds) == 1
    assert max(bounds) <= min(a.order for a in found)


@given(seeds)
def test_the_order_of_factors_does_not_matter(seed: int) -> None:
    law_words(seed)


def known(g: float, seed: int) -> LFT:
    """g [L^2 0 0 ; 0 0 0] + m N(L), N = [quadratic linear linear ; linear constant constant].

    D_L = D_m = 2. With g = 0 both are enough, as m N(L). Otherwise (1, 0) is in X by hand
    (docs/method.md), h = 1, and 5 are needed; they are enough: m for the rows of N, and L three times for
    [N ; L^2 0 0].
    """
    random = np.random.default_rng(seed)
    al, be, ga, de, ep, ze, et, ka, th = random.uniform(0.5, 2.0, 9) * random.choice([-1, 1], 9)
    L, m = parameter("L", 0.4), parameter("m", 0.6)
    slope = linear(de, ep, L)
    first = stack_columns(al + L @ linear(be, ga, L), slope, linear(ze, et, L))
    N = stack_rows(first, stack_columns(slope, [[ka]], [[th]]))
    square = constant([[g], [0.0]]) @ L @ L @ constant([[1.0, 0.0, 0.0]])
    # m at the inputs, three times: not the smallest way of writing
    return reduce_order(N @ stack_diagonal(m, m, m) + square)


def linear(constant_part: float, slope: float, a: LFT) -> LFT:
    return constant([[constant_part]]) + constant([[slope]]) @ a


def law_known(g: float, seed: int, change: Callable[[LFT], LFT] = lambda a: a) -> None:
    a = change(known(g, seed))
    degrees = lower_bound(a)
    assert degrees == {"L": 2, "m": 2}
    assert a.order > 4
    assert joint_bound(a, degrees) == (5 if g else 4)


@given(st.sampled_from([0.0, 1.0, -0.7]), seeds)
def test_closed_form(g: float, seed: int) -> None:
    law_known(g, seed)


@given(st.sampled_from([0.0, 1.0]), seeds)
def test_rounding_proves_nothing(g: float, seed: int) -> None:
    """Two inputs that no delta changes, with rounding left: the source has the terms that cancelled."""
    a, random = known(g, seed), np.random.default_rng(seed)
    left = RESIDUE * random.standard_normal((a.order, 2))
    M22 = np.hstack([a.M22, np.ones((a.shape[0], 2))])
    rounded = LFT(a.M11, np.hstack([a.M12, left]), a.M21, M22, a.blocks)
    nothing = delta("L") @ delta("m") - delta("m") @ delta("L")
    both = constant(np.ones((a.shape[0], 1))) @ stack_columns(nothing, nothing)
    source = rounded + stack_columns(constant(np.zeros(a.shape)), both)
    degrees = lower_bound(a)
    assert joint_bound(rounded, degrees, source=source) == (5 if g else 4)
    assert joint_bound(rounded, degrees) != (
        5 if g else 4
    )  # without it, rounding is taken for real


def transformed(a: LFT, random: np.random.Generator) -> LFT:
    outputs, inputs = (np.eye(n) + 0.3 * random.standard_normal((n, n)) for n in a.shape)
    return outputs @ a @ inputs


def with_feedback(a: LFT, random: np.random.Generator) -> LFT:
    """u = v + K y."""
    K = 0.1 * random.standard_normal(a.shape[::-1])
    loop = np.linalg.inv(np.eye(a.shape[1]) - K @ a.M22)
    back = loop @ K @ a.M21
    return LFT(a.M11 + a.M12 @ back, a.M12 @ loop, a.M21 + a.M22 @ back, a.M22 @ loop, a.blocks)


def moebius(a: LFT, random: np.random.Generator) -> LFT:
    """delta = (mu + c)/(1 + c mu), which is c z + (1 - c^2) mu (z - c w)."""
    c = np.repeat(random.uniform(-0.5, 0.5, len(a.blocks)), [block.size for block in a.blocks])
    solve = np.linalg.inv(np.eye(a.order) - a.M11 * c)
    z_w, z_u = solve @ (a.M11 * (1 - c * c)), solve @ a.M12
    w_w, w_u = c[:, None] * z_w + np.diag(1 - c * c), c[:, None] * z_u
    return LFT(z_w - np.diag(c), z_u, a.M21 @ w_w, a.M22 + a.M21 @ w_u, a.blocks)


def scaled(a: LFT, random: np.random.Generator) -> LFT:
    """Other units of inputs, outputs and channels."""
    channels, outputs, inputs = (10.0 ** random.uniform(-3, 3, n) for n in (a.order, *a.shape))
    return LFT(
        channels[:, None] * a.M11 / channels,
        channels[:, None] * a.M12 * inputs,
        outputs[:, None] * a.M21 / channels,
        outputs[:, None] * a.M22 * inputs,
        a.blocks,
    )


CHANGES: dict[str, Callable[[LFT, np.random.Generator], LFT]] = {
    "inputs and outputs": transformed,
    "feedback": with_feedback,
    "Moebius": moebius,
    "units": scaled,
    "transposition": lambda a, random: transpose(a),
}


@pytest.mark.parametrize("name", CHANGES)
@given(st.sampled_from([0.0, 1.0]), seeds)
def test_changes_that_leave_the_problem_as_it_is(name: str, g: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    law_known(g, seed, lambda a: CHANGES[name](a, random))


def test_moebius_change_is_one() -> None:
    a = known(1.0, 0)
    changed = moebius(a, np.random.default_rng(3))
    c = np.random.default_rng(3).uniform(-0.5, 0.5, 2)
    mu = np.random.default_rng(4).uniform(-0.9, 0.9, (20, 2))
    roundoff(evaluate_at(changed, mu), evaluate_at(a, (mu + c) / (1 + c * mu)), KAPPA)


pairs = st.lists(
    st.builds(
        lambda two, first, second: Pair(*two, first, second),
        st.sampled_from(list(combinations("abcd", 2))),
        st.integers(1, 3),
        st.integers(1, 3),
    ),
    max_size=4,
)


def law_least(
    least: Callable[[str, list[Pair], list[Triple]], dict[str, int]],
    found: list[Pair],
    number: int = 0,
) -> None:
    """Against all repetitions up to 3 more of each; with triples of a delta that is in two pairs."""
    names = [set(pair[:2]) for pair in found]
    both = [(one & two, one ^ two) for one, two in combinations(names, 2) if len(one & two) == 1]
    triples = [Triple(*shared, *sorted(others)) for shared, others in both][:number]
    more = (dict(zip("abcd", counts, strict=True)) for counts in product(range(4), repeat=4))
    allowed = [
        sum(e.values())
        for e in more
        if all(e[p.first] or e[p.second] >= p.second_more for p in found)
        and all(e[p.second] or e[p.first] >= p.first_more for p in found)
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


def side_by_side(seed: int) -> LFT:
    """Two matrices that share L, one with m and one with k."""
    one, other = known(1.0, seed), known(-0.7, seed + 1)
    blocks = tuple(Block("k" if name == "m" else name, size) for name, size in other.blocks)
    other = LFT(other.M11, other.M12, other.M21, other.M22, blocks)
    return reduce_order(stack_diagonal(one, other))


def law_side_by_side(seed: int) -> None:
    """Each needs 5 alone; one L more, which pairs allow, can do for one of them only."""
    a = side_by_side(seed)
    degrees = lower_bound(a)
    assert degrees == {"L": 4, "m": 2, "k": 2}
    assert a.order > 10
    assert joint_bound(a, degrees) == 10


@given(seeds)
def test_one_repetition_is_not_enough_for_two(seed: int) -> None:
    law_side_by_side(seed)


# where pairs prove one less than triples, of 1 800
TWO_LETTERS = (32, 136, 251, 536, 559, 627, 818, 902, 1194, 1287, 1461, 1620, 1654, 1762)


def words_of_two_letters(random: np.random.Generator) -> list[Word]:
    """Like `words`, mostly in a and one of two others."""
    rows, columns = random.integers(1, 5, 2)
    left = [*np.eye(rows), *random.standard_normal((1, rows))]
    right = [*np.eye(columns), *random.standard_normal((1, columns))]
    return [
        word(random, left, letters, 3, right)
        for letters in random.choice(
            ["ab", "ac", "bc", "abc"], random.integers(4, 9), p=[0.4, 0.4, 0.1, 0.1]
        )
    ]


def law_of_two_letters(seed: int) -> None:
    """The bound is the order that n-D reduction reaches from one of three ways to write it."""
    found = in_three_ways(words_of_two_letters(np.random.default_rng(seed)))
    assert {bound(a) for a in found} == {min(a.order for a in found)}


@pytest.mark.parametrize("seed", TWO_LETTERS)
def test_triples_are_reached(seed: int) -> None:
    law_of_two_letters(seed)


def test_four_links_in_space() -> None:
    """Pairs alone prove 74."""
    law_table(65, 75, relations(4, spatial=True))


def test_models_say_what_is_proved() -> None:
    """Two links in space: 19 one by one, 21 by pairs, 21 reached."""
    scene = chain(2, spatial=True)
    certificate = mbdlft.to_lft(scene, search=20.0).certificate
    assert sum(certificate.lower_bound) == 19
    assert certificate.order_bound == 21 == sum(certificate.order)
    assert certificate.minimal
    plain = mbdlft.to_lft(
        scene, search=0.0
    ).certificate  # without a search the pairs are not looked at
    assert plain.order_bound == 19
    assert not plain.minimal


def test_missing_degree() -> None:
    with pytest.raises(mbdlft.StructureError, match=r"degrees of \['m'\] are missing"):
        joint_bound(known(1.0, 0), {"L": 2})


def test_planted_kappa_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines on which the pairs are not generated in degree 1 have to count."""
    right = joint.obstruction

    def planted(*arguments: Any) -> Any:
        return right(*arguments)._replace(kappa=1)

    a = o8()
    law_table(16, 17, a)
    monkeypatch.setattr(joint, "obstruction", planted)
    with pytest.raises(AssertionError, match="18 == 17"):
        law_table(16, 17, a)


def test_planted_line_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sections that need not vanish at infinity are too many: LFTs of a smaller order exist."""
    right = sections._inside
    law_known(0.0, 0)
    law_safe(2, sparse=False, affine=True)

    def planted(basis: Any, *moves: tuple[Any, int]) -> int:
        return right(basis, *((b, max(1, power - 1)) for b, power in moves))

    monkeypatch.setattr(sections, "_inside", planted)
    with pytest.raises(AssertionError):
        law_known(0.0, 0)
    with pytest.raises(AssertionError):
        law_safe(2, sparse=False, affine=True)
    with pytest.raises(AssertionError):
        law_words(3)


def test_planted_side_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The columns alone do not show what the rows do."""
    law_known(1.0, 0)
    law_known(1.0, 0, transpose)
    monkeypatch.setattr(joint, "transpose", lambda a: a)
    law_known(1.0, 0)
    with pytest.raises(AssertionError):
        law_known(1.0, 0, transpose)


def test_planted_sum_is_found() -> None:
    """Pairs that share a parameter need not be paid for twice, unless a triple says so."""
    found = [Pair("a", "b", 1, 1), Pair("a", "c", 1, 1)]
    law_least(least_more, found)
    law_least(least_more, found, 1)
    with pytest.raises(AssertionError, match="2 == 1"):
        law_least(lambda names, found, triples: {p.second: min(p[2:4]) for p in found}, found)
    with pytest.raises(AssertionError, match="1 == 2"):
        law_least(lambda names, found, triples: least_more(names, found), found, 1)


def test_planted_pairs_only_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    law_side_by_side(0)
    monkeypatch.setattr(joint, "_is_proved", lambda *arguments: False)
    with pytest.raises(AssertionError, match="9 == 10"):
        law_side_by_side(0)
    for seed in TWO_LETTERS:
        with pytest.raises(AssertionError):
            law_of_two_letters(seed)


def test_planted_poles_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """An obstruction of two deltas that has poles in the third says nothing about the three."""
    law_words(1008)
    monkeypatch.setattr(joint, "is_constant_in", lambda *arguments: True)
    with pytest.raises(AssertionError):
        law_words(1008)
