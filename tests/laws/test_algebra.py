"""The value of an operation on LFTs is the operation on their values."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft import ComplexBlock, FullBlock
from mbdlft.lft import determinant
from mbdlft.lft import lft as algebra
from mbdlft.lft.lft import LFT, Block, constant, delta, fix
from mbdlft.lft.sampling import evaluate, evaluate_at
from tests.close import exact, roundoff
from tests.laws.lfts import lfts, points

KAPPA = 1e4  # condition of the loops that the generated LFTs reach
seeds = st.integers(0, 1000)


def value(a: LFT, at: dict[str, np.ndarray]) -> np.ndarray:
    """Values by the definition, one point at a time, with an explicit inverse."""
    count = len(next(iter(at.values())))
    found = np.zeros((count, *a.shape))
    for k in range(count):
        spread = [at[block.name][k] for block in a.blocks for _ in range(block.size)]
        Delta = np.diag(np.array(spread, dtype=float))
        loop = np.linalg.inv(np.eye(a.order) - a.M11 @ Delta) if a.order else np.zeros((0, 0))
        found[k] = a.M22 + a.M21 @ Delta @ loop @ a.M12
    return found


@given(lfts(2, 3), lfts(2, 3), lfts(3, 2), seeds)
def test_sum_difference_product_negative(a: LFT, b: LFT, c: LFT, seed: int) -> None:
    at = points(seed)
    roundoff(value(a + b, at), value(a, at) + value(b, at), KAPPA)
    roundoff(value(a @ c, at), value(a, at) @ value(c, at), KAPPA)
    roundoff(value(a - b, at), value(a, at) - value(b, at), KAPPA, scale=_size(a, b, at))
    roundoff(value(-a, at), -value(a, at), KAPPA)
    roundoff(value(a - a, at), 0 * value(a, at), KAPPA, scale=_size(a, a, at))
    roundoff(value(1.5 * np.ones((4, 2)) @ a, at), 1.5 * np.ones((4, 2)) @ value(a, at), KAPPA)
    roundoff(value(np.ones((2, 3)) + a, at), 1.0 + value(a, at), KAPPA)
    roundoff(value(np.ones((2, 3)) - a, at), 1.0 - value(a, at), KAPPA, scale=1 + _size(a, a, at))


def _size(a: LFT, b: LFT, at: dict[str, np.ndarray]) -> float:
    return float(np.max(np.abs(value(a, at))) + np.max(np.abs(value(b, at))))


@given(lfts(3, 3), seeds)
def test_inverse_and_transpose(a: LFT, seed: int) -> None:
    at = points(seed)
    inverse = algebra.inverse(a)
    product = value(inverse, at) @ value(a, at)
    roundoff(product, np.broadcast_to(np.eye(3), product.shape), KAPPA)
    assert inverse.blocks == a.blocks
    roundoff(value(algebra.transpose(a), at), np.swapaxes(value(a, at), 1, 2), KAPPA)


@given(lfts(2, 3), lfts(1, 3), lfts(2, 1), seeds)
def test_stacking_and_selecting(a: LFT, b: LFT, c: LFT, seed: int) -> None:
    at = points(seed)
    va, vb, vc = value(a, at), value(b, at), value(c, at)
    roundoff(value(algebra.stack_rows(a, b), at), np.concatenate([va, vb], 1), KAPPA)
    roundoff(value(algebra.stack_columns(a, c), at), np.concatenate([va, vc], 2), KAPPA)
    diagonal = np.zeros((len(va), 3, 6))
    diagonal[:, :2, :3], diagonal[:, 2:, 3:] = va, vb
    roundoff(value(algebra.stack_diagonal(a, b), at), diagonal, KAPPA)
    roundoff(value(algebra.select(a, [1, 0, 1], [2, 0]), at), va[:, [1, 0, 1]][:, :, [2, 0]], KAPPA)


@given(lfts(4, 4), st.integers(1, 4), seeds)
def test_eliminate(a: LFT, n: int, seed: int) -> None:
    at, closed = points(seed), algebra.eliminate(a, n)
    values = value(a, at)
    solved = -np.linalg.solve(values[:, :n, :n], values[:, :n, n:])
    read = values[:, n:, n:] + values[:, n:, :n] @ solved
    roundoff(value(closed, at), np.concatenate([solved, read], 1), KAPPA)
    assert closed.order == a.order


@given(lfts(2, 2), seeds)
def test_fix_and_evaluate(a: LFT, seed: int) -> None:
    at = points(seed)
    given_names = {name: at[name] for name, _ in a.blocks}
    many = evaluate(a, given_names) if given_names else a.M22[None]
    roundoff(many, value(a, at)[: len(many)], KAPPA)
    for k in range(len(many) if given_names else 0):
        single = {name: float(column[k]) for name, column in given_names.items()}
        roundoff(evaluate(a, single), many[k], KAPPA)
        if a.blocks:
            first = a.blocks[0].name
            rest = {name: number for name, number in single.items() if name != first}
            fixed = fix(a, {first: single[first]})
            assert first not in dict(fixed.blocks)
            roundoff(evaluate(fixed, rest), many[k], KAPPA)


def test_evaluate_takes_the_thin_side_either_way() -> None:
    """Wide and tall LFTs go through different solves; both are the definition."""
    random = np.random.default_rng(3)
    for rows, columns in ((1, 6), (6, 1)):
        a = LFT(
            0.1 * random.standard_normal((4, 4)),
            random.standard_normal((4, columns)),
            random.standard_normal((rows, 4)),
            random.standard_normal((rows, columns)),
            (Block("a", 1), Block("b", 3)),
        )
        at = points(1, count=1100)
        roundoff(evaluate_at(a, np.stack([at["a"], at["b"]], 1)), value(a, at), KAPPA)


def test_names_are_identity_and_order_is_by_name() -> None:
    a, b = delta("a", 2), delta("b", 2)
    assert (a + b).blocks == (b + a).blocks == (Block("a", 2), Block("b", 2))
    assert (a + a).blocks == (Block("a", 4),)
    assert constant([[1.0, 2.0]]).blocks == ()
    exact(constant([[1.0, 2.0]]).M22, [[1.0, 2.0]])


def test_arrays_are_frozen_copies() -> None:
    source = np.eye(2)
    a = constant(source)
    source[0, 0] = 5.0
    exact(a.M22, np.eye(2))
    with pytest.raises(ValueError, match="read-only"):
        a.M22[0, 0] = 1.0


# Laws of LFTs with complex entries and with blocks of all kinds, against the definition.


BLOCKS = (Block("a", 2), ComplexBlock("c", 1), FullBlock("f", 3, 2))


def mixed(seed: int, n_out: int = 2, n_in: int = 2, blocks=BLOCKS, imaginary: float = 1.0) -> LFT:
    random = np.random.default_rng(seed)
    z, w = sum(b.inputs for b in blocks), sum(b.outputs for b in blocks)

    def some(*shape: int) -> np.ndarray:
        return random.standard_normal(shape) + 1j * imaginary * random.standard_normal(shape)

    M22 = some(n_out, n_in) + 4.0 * np.eye(n_out, n_in)
    return LFT(0.1 * some(z, w), some(z, n_in), some(n_out, w), M22, blocks)


def point(seed: int) -> dict[str, object]:
    random = np.random.default_rng(seed)
    full = random.standard_normal((2, 3)) + 1j * random.standard_normal((2, 3))
    return {"a": random.uniform(-1, 1), "c": 0.6 - 0.7j, "f": 0.5 * full}


def value_of_kinds(a: LFT, at: dict[str, object]) -> np.ndarray:
    """The definition, with an explicit inverse."""
    parts = [at[b.name] if b.kind == "full" else at[b.name] * np.eye(b.size) for b in a.blocks if b.size]
    Delta = np.zeros((a.M11.shape[1], a.M11.shape[0]), dtype=complex)
    row = column = 0
    for part in parts:
        Delta[row : row + part.shape[0], column : column + part.shape[1]] = part
        row, column = row + part.shape[0], column + part.shape[1]
    return a.M22 + a.M21 @ Delta @ np.linalg.inv(np.eye(a.order) - a.M11 @ Delta) @ a.M12


@pytest.mark.parametrize("imaginary", [0.0, 1.0])
def test_values_of_the_algebra(imaginary: float) -> None:
    for seed in range(5):
        a, c = mixed(seed, imaginary=imaginary), mixed(seed + 50, imaginary=imaginary)
        b = LFT(c.M11[:3, :3], c.M12[:3], c.M21[:, :3], c.M22, (Block("a", 2), ComplexBlock("c", 1)))
        at = point(seed)
        va, vb = value_of_kinds(a, at), value_of_kinds(b, {"a": at["a"], "c": at["c"]})
        roundoff(evaluate(a, at), va, KAPPA)
        roundoff(value_of_kinds(a + b, at), va + vb, KAPPA)
        roundoff(value_of_kinds(a @ b, at), va @ vb, KAPPA)
        roundoff(value_of_kinds(algebra.inverse(a), at), np.linalg.inv(va), KAPPA)
        roundoff(value_of_kinds(algebra.stack_columns(a, b), at), np.hstack([va, vb]), KAPPA)
        roundoff(value_of_kinds(algebra.stack_rows(a, b), at), np.vstack([va, vb]), KAPPA)
        closed = algebra.eliminate(a, 1)
        inner = -va[:1, 1:] / va[0, 0]
        roundoff(value_of_kinds(closed, at), np.vstack([inner, va[1:, 1:] + va[1:, :1] @ inner]), KAPPA)
        for name in at:
            left = {key: item for key, item in at.items() if key != name}
            roundoff(value_of_kinds(fix(a, {name: at[name]}), left), va, KAPPA)
            opened = algebra.open_blocks(a, [name])
            again = algebra.close_blocks(opened, [b for b in a.blocks if b.name == name])
            roundoff(value_of_kinds(again, at), va, KAPPA)


def test_many_points_and_points_by_name() -> None:
    a = mixed(3)
    points = [point(seed) for seed in range(4)]
    many = evaluate(a, {name: np.array([p[name] for p in points]) for name in points[0]})
    for found, at in zip(many, points, strict=True):
        roundoff(found, value_of_kinds(a, at), KAPPA)
    real = LFT(a.M11[:2, :2], a.M12[:2], a.M21[:, :2], a.M22, a.blocks[:1])
    deltas = np.linspace(-1, 1, 1500)  # many: a program would be made of real ones
    found = evaluate_at(real, deltas[:, None])
    for k in (0, 700, 1499):
        roundoff(found[k], value_of_kinds(real, {"a": deltas[k]}), KAPPA)


def test_real_stays_real() -> None:
    a = mixed(1, imaginary=0.0)
    assert not a.is_complex
    for item in (a, a + a.M22, a @ a.M22, algebra.inverse(a), constant(1.0 + 0j)):
        assert {m.dtype.name for m in (item.M11, item.M12, item.M21, item.M22)} == {"float64"}
    assert mixed(1).is_complex
    exact(constant([[1j]]).M22, np.array([[1j]]))


def test_names_and_sizes() -> None:
    a = mixed(0)
    assert a.order == 6
    assert a.M11.shape == (6, 5)
    assert a.columns()["f"] == slice(3, 5)
    assert ComplexBlock("a", 2) != Block("a", 2)
    assert Block("a", 2) != ComplexBlock("a", 2)
    assert FullBlock("f", 2, 2) == FullBlock("f", 2) != FullBlock("f", 2, 3)
    assert delta(FullBlock("f", 3, 2)).shape == (2, 3)


# Values, signs and vanishing determinants by the loops of an LFT are those of the whole matrix.


KAPPA_OF_LOOPS = 1e6  # condition of the loops below at the points that are compared


def deltas(a: LFT, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(a.blocks)))


def chained(loops: tuple[int, ...], seed: int, shape: tuple[int, int] = (3, 2)) -> LFT:
    """Loops of such sizes that read from one or two earlier ones, with their channels shuffled."""
    random = np.random.default_rng(seed)
    n = sum(loops)
    M11, end = np.zeros((n, n)), 0
    for size in loops:
        part = slice(end, end + size)
        M11[part, part] = random.standard_normal((size, size)) / (size + 1.0)
        for source in random.integers(0, end, min(end, 2)):
            M11[end + random.integers(size), source] = random.standard_normal()
        end += size
    order = random.permutation(n)
    cut = n // 3
    return LFT(
        M11[np.ix_(order, order)],
        random.standard_normal((n, shape[1])),
        random.standard_normal((shape[0], n)),
        random.standard_normal(shape),
        (Block("a", cut), Block("b", n - cut)),
    )


# small ones are one block; those of the last two have blocks that are factored point by point
LOOPS = [(1,), (3, 1, 2), (1,) * 100, (2, 3) * 30, (70, 1, 1, 20, 5, 90), (1, 1, 120) + (2,) * 40]


def spread(a: LFT, at: np.ndarray) -> np.ndarray:
    return np.repeat(at, [block.size for block in a.blocks], axis=1)


def signs_of(a: LFT, at: np.ndarray) -> list[float]:
    return [np.linalg.slogdet(np.eye(a.order) - a.M11 * row)[0] for row in spread(a, at)]


def law_values(a: LFT, at: np.ndarray) -> None:
    values, signs = determinant.values_at(a, at)
    exact(signs, signs_of(a, at))
    roundoff(values, evaluate_at(a, at), KAPPA_OF_LOOPS)


@pytest.mark.parametrize("loops", LOOPS)
@pytest.mark.parametrize("shape", [(3, 2), (2, 3)])
def test_chained_loops(loops: tuple[int, ...], shape: tuple[int, int]) -> None:
    a = chained(loops, 1, shape)
    blocks = determinant.diagonal_blocks(a.M11)
    exact(np.sort(np.concatenate(blocks)), np.arange(a.order))
    for k, block in enumerate(blocks):
        assert not any(a.M11[np.ix_(block, later)].any() for later in blocks[k + 1 :])
    assert (len(blocks) > 1) == (a.order > 48)
    law_values(a, deltas(a, 7))
    at = 3.0 * deltas(a, 7)  # every line is searched: at most 32 points, small blocks
    poles = [np.linalg.eigvals(a.M11 * row) for row in spread(a, at)]
    vanishing = [bool(np.any((s.imag == 0.0) & (s.real >= 1.0))) for s in poles]
    exact(determinant.vanishes(a, at), vanishing)


def test_signs_far_from_nominal() -> None:
    """Where rows are exchanged in the factorization, and each exchange changes the sign."""
    a = chained((70,), 2)
    at = 20.0 * deltas(a, 12)
    assert set(signs_of(a, at)) == {-1.0, 1.0}
    exact(determinant.values_at(a, at)[1], signs_of(a, at))


@given(lfts(2, 3), seeds)
def test_small_lfts(a: LFT, seed: int) -> None:
    law_values(a, deltas(a, 3, seed))


def test_an_lft_without_channels() -> None:
    a = LFT(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.ones((1, 2)))
    values, signs = determinant.values_at(a, np.zeros((3, 0)))
    exact(values, np.ones((3, 1, 2)))
    exact(signs, np.ones(3))
    assert not determinant.vanishes(a, np.zeros((3, 0))).any()


@pytest.mark.parametrize("size", [1, 70])
def test_a_singular_point_has_the_sign_zero(size: int) -> None:
    a = LFT(np.eye(size), np.ones((size, 1)), np.ones((1, size)), np.zeros((1, 1)), (Block("a", size),))
    _, signs = determinant.values_at(a, np.array([[0.5], [1.0], [2.0]]))
    exact(signs, [1.0, 0.0, (-1.0) ** size])
    exact(determinant.vanishes(a, np.array([[0.5], [1.0], [2.0], [-2.0]])), [False, True, True, False])


def test_a_double_root_does_not_change_the_sign() -> None:
    """det = (1 - d/2)^2 + e^2: touches zero at d = 2 for e = 0 only."""
    for gap, expected in ((0.0, True), (0.1, False)):
        M11 = np.array([[0.5, gap], [-gap, 0.5]])
        a = LFT(M11, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), (Block("a", 2),))
        exact(determinant.values_at(a, np.array([[3.0]]))[1], [1.0])
        exact(determinant.vanishes(a, np.array([[3.0]])), [expected])


def test_eigenvalues_that_are_not_found_show_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """No line is seen to vanish, and a pole is not nearer than the norm allows."""

    def failing(matrix: np.ndarray) -> np.ndarray:
        raise np.linalg.LinAlgError

    monkeypatch.setattr(np.linalg, "eigvals", failing)
    a = LFT(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), (Block("a", 1),))
    assert not determinant.vanishes(a, np.array([[2.0]])).any()
