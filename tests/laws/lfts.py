"""Generated LFTs and points for the laws of the algebra."""

import numpy as np
from hypothesis import strategies as st

from mbdlft.lft.lft import LFT, Block

NAMES = ("a", "b", "c")


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


def points(seed: int, count: int = 5) -> dict[str, np.ndarray]:
    """Random deltas and two corners, for all names."""
    random = np.random.default_rng(seed)
    inside = random.uniform(-1, 1, (count, len(NAMES)))
    corners = np.array([[1.0] * len(NAMES), [-1.0] * len(NAMES)])
    return dict(zip(NAMES, np.vstack([inside, corners]).T, strict=True))


def padded(a: LFT, random: np.random.Generator) -> LFT:
    """The same value with channels that nothing reaches or nobody sees, in mixed coordinates."""
    blocks, rows = [], []
    for name, part in a.slices().items():
        size = part.stop - part.start
        T, _ = np.linalg.qr(random.standard_normal((size + 2, size + 2)))
        blocks.append(Block(name, size + 2))
        rows.append((part, T))
    n = sum(block.size for block in blocks)
    M11, M12, M21 = np.zeros((n, n)), np.zeros((n, a.shape[1])), np.zeros((a.shape[0], n))
    T_all = np.zeros((n, n))
    position, old, unseen, unreached = 0, [], [], []
    for part, T in rows:
        size = part.stop - part.start
        T_all[position : position + size + 2, position : position + size + 2] = T
        old += range(position, position + size)
        unseen.append(position + size)
        unreached.append(position + size + 1)
        position += size + 2
    M11[np.ix_(old, old)], M12[old], M21[:, old] = a.M11, a.M12, a.M21
    M11[np.ix_(unseen, old)] = random.standard_normal((len(unseen), len(old)))
    M12[unseen] = random.standard_normal((len(unseen), a.shape[1]))
    M11[np.ix_(old, unreached)] = random.standard_normal((len(old), len(unreached)))
    M21[:, unreached] = random.standard_normal((a.shape[0], len(unreached)))
    return LFT(T_all @ M11 @ T_all.T, T_all @ M12, M21 @ T_all.T, a.M22, tuple(blocks))
