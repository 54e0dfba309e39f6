"""Laws of LFTs with complex entries and with blocks of all kinds, against the definition."""

import numpy as np
import pytest

from mbdlft import LFT, Block, ComplexBlock, FullBlock, StructureError
from mbdlft.lft import lft as algebra
from mbdlft.lft.box_gain import gain_bound
from mbdlft.lft.lft import constant, delta, fix
from mbdlft.lft.sampling import evaluate, evaluate_at, values_at
from mbdlft.order.degree import degree_bounds
from mbdlft.order.reduction import reduce_order
from mbdlft.system.truncation import truncate_lft
from tests.close import exact, roundoff
from tests.errors.table import says

KAPPA = 1e4
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


def value(a: LFT, at: dict[str, object]) -> np.ndarray:
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
        va, vb = value(a, at), value(b, {"a": at["a"], "c": at["c"]})
        roundoff(evaluate(a, at), va, KAPPA)
        roundoff(value(a + b, at), va + vb, KAPPA)
        roundoff(value(a @ b, at), va @ vb, KAPPA)
        roundoff(value(algebra.inverse(a), at), np.linalg.inv(va), KAPPA)
        roundoff(value(algebra.stack_columns(a, b), at), np.hstack([va, vb]), KAPPA)
        roundoff(value(algebra.stack_rows(a, b), at), np.vstack([va, vb]), KAPPA)
        closed = algebra.eliminate(a, 1)
        inner = -va[:1, 1:] / va[0, 0]
        roundoff(value(closed, at), np.vstack([inner, va[1:, 1:] + va[1:, :1] @ inner]), KAPPA)
        for name in at:
            left = {key: item for key, item in at.items() if key != name}
            roundoff(value(fix(a, {name: at[name]}), left), va, KAPPA)


def test_many_points_and_points_by_name() -> None:
    a = mixed(3)
    points = [point(seed) for seed in range(4)]
    many = evaluate(a, {name: np.array([p[name] for p in points]) for name in points[0]})
    for found, at in zip(many, points, strict=True):
        roundoff(found, value(a, at), KAPPA)
    real = LFT(a.M11[:2, :2], a.M12[:2], a.M21[:, :2], a.M22, a.blocks[:1])
    deltas = np.linspace(-1, 1, 1500)  # many: a program would be made of real ones
    found = evaluate_at(real, deltas[:, None])
    for k in (0, 700, 1499):
        roundoff(found[k], value(real, {"a": deltas[k]}), KAPPA)


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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda a: a + delta("c", 2), "c is a complex block here and a real one there."),
        (lambda a: a + a, "the full block f stands twice, and it cannot be repeated."),
        (lambda a: algebra.transpose(a), "the transpose of a full block is another block: f."),
        (lambda a: evaluate(a, {"a": 1j}), "a is a real delta, got 1j."),
        (lambda a: evaluate(a, {"f": np.eye(2)}), "f is a full block and needs shape (2, 3), got"),
        (lambda a: evaluate(a, {"f": "x"}), "f: expected a number, got 'x'."),
        (lambda a: evaluate_at(a, np.zeros((1, 3))), "points have one real number for each block"),
        (lambda a: reduce_order(a), "the reduction holds for real entries and repeated real par"),
        (lambda a: degree_bounds(a), "c is a complex block, f is a full block."),
        (lambda a: degree_bounds(constant([[1j]])), "parameters only; an entry is complex."),
        (lambda a: gain_bound(a), "the bound of the gain holds for real entries"),
        (lambda a: truncate_lft(a, 0.1), "truncation holds for real entries"),
        (lambda a: values_at(a, np.zeros((1, 3))), "the determinant at many points holds for"),
        (
            lambda a: LFT(a.M11, a.M12, a.M21, a.M22, BLOCKS[:2]),
            "LFT: M11 needs shape (6, 6), got (6, 5).",
        ),
    ],
)
def test_errors(make, message) -> None:
    with says(StructureError, message):
        make(mixed(2))
