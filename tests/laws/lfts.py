"""Generated LFTs and points for the laws of the algebra."""

import numpy as np
from hypothesis import strategies as st
from scipy.linalg import block_diag

from mbdlft.lft.lft import LFT, Block

NAMES = ("a", "b", "c")
DENOMINATOR = 4  # entries are integers over this: exact in floating point and modulo a prime


@st.composite
def lfts(
    draw: st.DrawFn,
    n_out: int | None = None,
    n_in: int | None = None,
    most: int = 3,
    scales: tuple[float, ...] = (1.0, 1e-6, 1e6),
) -> LFT:
    """Random LFTs in up to three deltas; well posed on |delta| <= 1; sizes from zero."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows = draw(st.integers(1, 3)) if n_out is None else n_out
    columns = draw(st.integers(1, 3)) if n_in is None else n_in
    names = draw(st.lists(st.sampled_from(NAMES), unique=True))
    blocks = tuple(Block(name, draw(st.integers(0, most))) for name in sorted(names))
    n = sum(block.size for block in blocks)
    M11 = random.standard_normal((n, n))
    M11 *= 0.6 / max(float(np.linalg.norm(M11, 2)), 1e-9) if n else 1.0
    scale = draw(st.sampled_from(scales))
    M12, M21 = (random.standard_normal((n, columns)) * scale, random.standard_normal((rows, n)) / scale)
    if draw(st.booleans()) and n:
        M12[draw(st.integers(0, n - 1))] = 0.0
    M22 = random.standard_normal((rows, columns))
    if rows == columns:
        M22 = M22 + 3.0 * rows * np.eye(rows)
    return LFT(M11, M12, M21, M22, blocks)


@st.composite
def sparse_lfts(draw: st.DrawFn) -> LFT:
    """LFTs with few entries, small fractions: most are not minimal."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    blocks = tuple(Block(name, draw(st.integers(0, 4))) for name in ("a", "b", "c"))
    n, n_out, n_in = sum(block.size for block in blocks), *random.integers(1, 4, 2)
    density = draw(st.sampled_from([0.15, 0.3, 0.6]))

    def some(rows: int, columns: int) -> np.ndarray:
        entries = random.integers(-3, 4, (rows, columns)) / DENOMINATOR
        return entries * (random.random((rows, columns)) < density)

    return LFT(some(n, n), some(n, n_in), some(n_out, n), some(n_out, n_in), blocks)


def points(seed: int, count: int = 5) -> dict[str, np.ndarray]:
    """Random deltas and two corners, for all names."""
    random = np.random.default_rng(seed)
    inside = random.uniform(-1, 1, (count, len(NAMES)))
    corners = np.array([[1.0] * len(NAMES), [-1.0] * len(NAMES)])
    return dict(zip(NAMES, np.vstack([inside, corners]).T, strict=True))


def padded(a: LFT, random: np.random.Generator, *, exact: bool = False) -> LFT:
    """The same value with channels that nothing reaches or nobody sees, in mixed coordinates.

    `exact` ones are whole numbers with a determinant of one, and what is added are quarters.
    """
    sizes = [block.size + 2 for block in a.blocks]
    ends = np.cumsum(sizes, dtype=int)
    unseen, unreached = ends - 2, ends - 1
    n = sum(sizes)
    old = np.setdiff1d(np.arange(n), [*unseen, *unreached])
    if exact:
        parts = [np.tril(random.integers(-2, 3, (k, k)), -1) + np.eye(k) for k in sizes]
    else:
        parts = [np.linalg.qr(random.standard_normal((k, k)))[0] for k in sizes]
    T = block_diag(*parts) if parts else np.eye(0)
    inverse = block_diag(*(np.rint(np.linalg.inv(x)) if exact else x.T for x in parts)) if parts else T

    def some(*shape: int) -> np.ndarray:
        return random.integers(-3, 4, shape) / 4.0 if exact else random.standard_normal(shape)

    M11, M12, M21 = np.zeros((n, n)), np.zeros((n, a.shape[1])), np.zeros((a.shape[0], n))
    M11[np.ix_(old, old)], M12[old], M21[:, old] = a.M11, a.M12, a.M21
    M11[np.ix_(unseen, old)], M12[unseen] = some(len(unseen), len(old)), some(len(unseen), a.shape[1])
    M11[np.ix_(old, unreached)] = some(len(old), len(unreached))
    M21[:, unreached] = some(a.shape[0], len(unreached))
    blocks = tuple(Block(block.name, block.size + 2) for block in a.blocks)
    return LFT(T @ M11 @ inverse, T @ M12, M21 @ inverse, a.M22, blocks)
