"""What `gain.proved` says of multipliers is true in exact arithmetic, near the border too."""

from collections.abc import Callable
from fractions import Fraction

import numpy as np

from mbdlft.lft import box_gain as gain
from mbdlft.lft.lft import LFT, Block
from tests.close import EPS

DRAWS = 100
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
