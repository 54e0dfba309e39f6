"""Laws of truncation and of the bound behind it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import product
from pathlib import Path

import flint
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft.lft import box_gain as gain
from mbdlft.lft.box_gain import gain_bound, restrict
from mbdlft.lft.lft import LFT, Block, constant, delta, inverse, stack_columns, stack_diagonal, stack_rows
from mbdlft.lft.sampling import evaluate_at
from mbdlft.order.reduction import reduce_order
from mbdlft.pipeline.models import build
from mbdlft.system.truncation import truncate_lft, typical_sizes
from tests.archive.models import arm, same
from tests.close import BOUND, EPS, exact, roundoff
from tests.laws.lfts import lfts

ARM = Path(__file__).parents[2] / "scenarios" / "two_link_arm.toml"


@cache
def small_arm() -> mbdlft.LFTModel:
    return build(mbdlft.load_scene(ARM), search=60.0).model


def box_points(count: int, seed: int = 11) -> np.ndarray:
    """Random points, all corners, and points on edges of the unit box (N, count)."""
    random = np.random.default_rng(seed)
    corners = np.array(list(product((-1.0, 1.0), repeat=count))).reshape(2**count, count)
    edges = random.choice(corners, 300)
    if count:
        edges[np.arange(300), random.integers(0, count, 300)] = random.uniform(-1, 1, 300)
    return np.vstack([random.uniform(-1, 1, (1000, count)), corners, edges])


def sampled_error(exact_one: LFT, small: LFT) -> float:
    rows, columns = typical_sizes(exact_one)
    at = box_points(len(exact_one.blocks))
    difference = evaluate_at(small, at) - evaluate_at(exact_one, at)
    return float(np.max(np.linalg.norm(difference / rows[:, None] / columns, 2, axis=(1, 2))))


def law_bound(a: LFT, tolerance: float) -> tuple[LFT, float]:
    """The truncated LFT is within its bound, the bound within the tolerance."""
    small, error = truncate_lft(a, tolerance)
    assert error <= tolerance
    assert sampled_error(a, small) <= error
    return small, error


def fading(seed: int) -> LFT:
    """Two deltas whose channels matter less and less."""
    random = np.random.default_rng(seed)
    size = np.array([1.0, 0.1, 1e-2, 1e-4, 1.0, 0.05, 1e-3])
    M11 = random.standard_normal((7, 7))
    M11 *= 0.5 / np.linalg.norm(M11, 2)
    return LFT(
        M11 * np.sqrt(np.outer(size, size)),
        random.standard_normal((7, 2)) * np.sqrt(size)[:, None],
        random.standard_normal((2, 7)) * np.sqrt(size),
        random.standard_normal((2, 2)),
        (Block("a", 4), Block("b", 3)),
    )


def with_small_part(size: float) -> LFT:
    """1 + a/2 + size b/(1 - b/2): leaving b out does 2 size at most, at b = 1."""
    fraction = delta("b") @ inverse(constant([[1.0]]) - delta("b") @ constant([[0.5]]))
    rest = constant([[1.0]]) + delta("a") @ constant([[0.5]])
    return reduce_order(rest + fraction @ constant([[size]]))


def known_gains() -> list[tuple[LFT, float]]:
    one, a, b = constant([[1.0]]), delta("a"), delta("b")
    square = a @ a
    return [
        (one - square, 1.0),  # largest inside the box
        (a @ inverse(one + square @ constant([[4.0]])), 0.25),  # at a = 1/2
        (a @ b - b @ a @ constant([[3.0]]), 2.0),  # deltas that commute
        (stack_diagonal(one + a, b @ constant([[0.5]])), 2.0),
        (constant([[3.0, 4.0]]), 5.0),
        (constant([[1.0]]) + a - a, 1.0),
    ]


@given(lfts(scales=(1.0,)))
def test_gain_is_an_upper_bound(a: LFT) -> None:
    at = box_points(len(a.blocks))
    largest = float(np.max(np.linalg.norm(evaluate_at(a, at), 2, axis=(1, 2))))
    assert gain_bound(a) >= largest


@pytest.mark.parametrize("case", range(len(known_gains())))
def test_gain_of_closed_forms(case: int) -> None:
    a, largest = known_gains()[case]
    found = gain_bound(a, largest * (1.0 + BOUND), boxes=64)
    assert largest <= found <= largest * (1.0 + BOUND)


@given(lfts(scales=(1.0,)), st.integers(0, 1000))
def test_restriction_to_a_part_of_the_box(a: LFT, seed: int) -> None:
    random = np.random.default_rng(seed)
    q = len(a.blocks)
    center, half = random.uniform(-0.6, 0.6, q), random.uniform(0.0, 0.4, q)
    at = random.uniform(-1, 1, (5, q))
    part = evaluate_at(restrict(a, center, half), at)
    roundoff(part, evaluate_at(a, center + half * at), kappa=1e3)


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e-1])
def test_a_part_of_known_size_is_left_out(size: float) -> None:
    a = with_small_part(size)
    known = 2.0 * size / (1.5 + 2.0 * size)  # of the largest value, at a = b = 1
    small, error = law_bound(a, 1.1 * known)
    assert dict(small.blocks) == {"a": 1, "b": 0}
    assert known <= error <= known * (1.0 + BOUND)
    kept, error = truncate_lft(a, 0.5 * known)
    assert kept is a
    assert error == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_a_larger_tolerance_is_not_a_larger_model(seed: int) -> None:
    a = fading(seed)
    orders = [law_bound(a, tolerance)[0].order for tolerance in (1e-7, 1e-3, 1e-2, 0.1, 0.5)]
    assert orders == sorted(orders, reverse=True)
    assert orders[0] == a.order > orders[2] > orders[-1]


def test_units_do_not_matter() -> None:
    a = fading(0)
    rows, columns = np.array([1e3, 0.02]), np.array([1.0, 57.0])
    other = LFT(a.M11, a.M12 * columns, rows[:, None] * a.M21, rows[:, None] * a.M22 * columns, a.blocks)
    first, second = truncate_lft(a, 0.05), truncate_lft(other, 0.05)
    assert first[0].blocks == second[0].blocks
    assert abs(first[1] - second[1]) <= BOUND * first[1]


def test_rounding_is_not_a_typical_size() -> None:
    """An entry p q - q p is zero up to rounding; the sizes of the others are not changed by it."""
    p, q = (constant([[0.3]]) + delta(name) for name in "pq")
    rest = p @ q - q @ p
    a = stack_rows(stack_columns(p, rest), stack_columns(q, p))
    rows, columns = typical_sizes(a)
    size = np.outer(rows, columns)
    assert np.min(size) > 1.0
    assert np.max(size) < 2.0


@pytest.mark.parametrize("tolerance", [0.1, 0.2])
def test_arm(tolerance: float) -> None:
    model = small_arm()
    small = mbdlft.truncate(model, tolerance)
    found, promised = sampled_error(model.lft, small.lft), small.certificate.truncation_error
    assert small.order <= model.order - 4
    assert small.order == sum(small.certificate.order)
    assert found <= promised <= tolerance
    exact(small.lft.M22, model.lft.M22)
    assert small.trim is model.trim
    assert not small.certificate.exact
    assert not small.certificate.minimal


def exact_value(a: LFT, deltas: Sequence[float]) -> flint.fmpq_mat:
    """The value of the doubles of an LFT, without rounding."""
    M11, M12, M21, M22, one, spread = (
        flint.fmpq_mat(*m.shape, [flint.fmpq(*x.as_integer_ratio()) for x in m.ravel().tolist()])
        for m in (
            *(a.M11, a.M12, a.M21, a.M22, np.eye(a.order)),
            np.diag(np.repeat(deltas, [block.size for block in a.blocks])),
        )
    )
    return M22 + M21 * spread * (one - M11 * spread).solve(M12)


@pytest.mark.parametrize(("weak", "size"), [(1e-9, 1e-8), (1e-9, 1e-7), (1e-10, 1e-6)])
def test_rounding_of_coordinates_is_in_the_bound(weak: float, size: float) -> None:
    """A direction that is hardly reached, and seen as much more, loses digits when it is balanced."""
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    M12, M21 = np.zeros((3, 2)), np.zeros((2, 3))
    M12[:2], M12[2, 0] = turn @ np.diag([1.0, weak]), size
    M21[:, :2], M21[0, 2] = np.diag([1.0, 1.0 / weak]) @ turn.T, 1.0
    a = LFT(np.zeros((3, 3)), M12, M21, np.eye(2), (Block("a", 2), Block("b", 1)))
    small, bound = truncate_lft(a, 30.0 * size)
    assert small.order == 2
    rows, columns = typical_sizes(a)
    for corner in product((-1.0, 1.0), repeat=2):
        entries = (exact_value(small, corner) - exact_value(a, corner)).entries()
        difference = np.array([int(x.p) / int(x.q) for x in entries]).reshape(2, 2)
        error = np.linalg.norm(difference / rows[:, None] / columns, 2)
        assert error <= bound


def test_not_minimal_where_the_order_is_the_bound() -> None:
    certificate = replace(arm().certificate, lower_bound=arm().certificate.order, order_bound=0)
    assert certificate.minimal
    assert not replace(certificate, exact=False).minimal


def test_archive_keeps_the_error_and_reads_old_files(tmp_path: Path) -> None:
    small = mbdlft.truncate(small_arm(), 0.1)
    mbdlft.save(tmp_path / "a.h5", small)
    same(mbdlft.load(tmp_path / "a.h5"), small)
    mbdlft.save(tmp_path / "b.h5", arm())
    same(mbdlft.load(tmp_path / "b.h5"), arm())


@pytest.mark.parametrize("tolerance", [0.0, -1e-3, float("nan"), float("inf"), True, "1e-3", None])
def test_tolerances_that_make_no_sense(tolerance: object) -> None:
    with pytest.raises(mbdlft.StructureError, match="tolerance above 0"):
        mbdlft.truncate(arm(), tolerance)  # type: ignore[arg-type]


def test_a_truncated_model_is_not_truncated_again() -> None:
    once = replace(arm(), certificate=replace(arm().certificate, exact=False))
    with pytest.raises(mbdlft.StructureError, match="not exact already"):
        mbdlft.truncate(once, 0.1)


def test_no_guarantee_where_the_model_is_singular() -> None:
    """1/(1 - 1.2 a) has a pole on the range."""
    pole = inverse(constant([[1.0]]) - delta("a") @ constant([[1.2]]))
    with pytest.raises(mbdlft.AnalysisError, match="no guarantee"):
        truncate_lft(pole + delta("b") @ constant([[1e-6]]), 0.1)


def test_without_parameters() -> None:
    a = constant([[1.0, 2.0]])
    assert truncate_lft(a, 0.1) == (a, 0.0)


# What `gain.proved` says of multipliers is true in exact arithmetic, near the border too ------------

DRAWS = 30
SIDES = range(-6, 7)  # how many roundings g is away from the border

Proved = Callable[[gain._Form, float, np.ndarray], bool]


def draw(seed: int) -> tuple[LFT, np.ndarray]:
    """An LFT with two blocks and one input, and multipliers whose terms cancel in S."""
    random = np.random.default_rng(seed)
    M = random.standard_normal((4, 4))
    M[:3, :3] *= 0.5 / np.linalg.norm(M[:3, :3], 2)
    X = np.zeros((3, 3))
    for part in (slice(0, 1), slice(1, 3)):
        size = part.stop - part.start
        skew = random.standard_normal((size, size))
        X[part, part] = 100.0 * (np.eye(size) + 0.1 * (skew - skew.T))
    return LFT(M[:3, :3], M[:3, 3:], M[3:, :3], M[3:, 3:], (Block("a", 1), Block("b", 2))), X


def form_of(a: LFT) -> gain._Form:
    Z, W = np.hstack([a.M11, a.M12]), np.eye(3, 4)
    Y = np.hstack([a.M21, a.M22])
    return gain._Form(Z - W, Z + W, Y.T @ Y, 1, *gain._places(a))


def is_positive(matrix: list[list[Fraction]]) -> bool:
    """By elimination in fractions: all pivots are above zero."""
    rows = [list(row) for row in matrix]
    for k, row in enumerate(rows):
        if row[k] <= 0:
            return False
        for other in rows[k + 1 :]:
            factor = other[k] / row[k]
            other[:] = [x - factor * y for x, y in zip(other, row, strict=True)]
    return True


def is_true(a: LFT, g: float, X: np.ndarray) -> bool:
    """S = g E - Y'Y - sym((Z - W)'X (Z + W)) > 0 and X + X' > 0, without rounding."""
    exact = np.vectorize(Fraction, otypes=[object])
    Z, W = exact(np.hstack([a.M11, a.M12])), exact(np.eye(3, 4))
    Y, X = exact(np.hstack([a.M21, a.M22])), exact(X)
    S = (Z - W).T @ X @ (Z + W)
    S = -(S + S.T) / 2 - Y.T @ Y
    S[3, 3] += Fraction(g)
    return is_positive(S.tolist()) and is_positive((X + X.T).tolist())


def border(a: LFT, X: np.ndarray) -> float:
    """The g at which S is singular, in floats."""
    S = form_of(a).matrix(0.0, X)
    return float(S[3, :3] @ np.linalg.solve(S[:3, :3], S[:3, 3]) - S[3, 3])


def law_proved_is_true(proved: Proved) -> None:
    close, certain = 0, 0
    for seed in range(DRAWS):
        a, X = draw(seed)
        g = border(a, X)
        for near in [g * (1.0 + k * EPS) for k in SIDES]:
            assert is_true(a, near, X) or not proved(form_of(a), near, X), f"draw {seed}"
            close += is_true(a, near, X)
        assert not proved(form_of(a), 2.0 * g, X - np.diag([2.0 * X[0, 0], 0.0, 0.0]))
        certain += proved(form_of(a), g + abs(g), X)
    assert 0 < close < DRAWS * len(SIDES)  # the draws are on both sides of the border
    assert certain == DRAWS


def test_what_is_proved_is_true() -> None:
    law_proved_is_true(gain.proved)


def test_multipliers_must_be_positive() -> None:
    """S > 0 with X + X' < 0 is no proof: here I - delta is singular at delta = 1."""
    a = LFT(*(np.array([[x]]) for x in (1.5, 0.0, 0.0, 0.0)), (Block("a", 1),))
    form = gain._Form(*(np.array([[x, 0.0]]) for x in (0.5, 2.5)), np.zeros((2, 2)), 1, *gain._places(a))
    X = np.array([[-1.0]])
    assert np.linalg.eigvalsh(form.matrix(1.0, X))[0] > 0.0
    assert not gain.proved(form, 1.0, X)
    assert gain.gain_bound(a) == np.inf
