"""LFTs that are singular in a small ball somewhere in the box, and regular ones that come near."""

import numpy as np

from mbdlft.lft.lft import LFT, add, constant, delta, inverse, multiply
from mbdlft.order.reduction import reduce_order

RADIUS = 1e-3


def planted(seed: int, square: float = -(RADIUS**2)) -> tuple[LFT, np.ndarray]:
    """An LFT with a factor 1/(sum_k w_k (delta_k - c_k)^2 + square), and the center c (q,).

    There are 1 to 8 deltas; other factors are regular, and the coordinates of each block are random.
    """
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 9))
    names = [f"p{k}" for k in range(count)]
    center = random.uniform(-0.95, 0.95, count)
    total, other, top = constant([[square]]), constant([[2.0 * count]]), constant([[1.0]])
    for name, at in zip(names, center, strict=True):
        d = delta(name)
        away = d - at * np.eye(1)
        total = add(total, random.uniform(0.3, 3.0) * np.eye(1) @ multiply(away, away))
        other = add(other, random.uniform(-1.0, 1.0) * np.eye(1) @ d)
        top = add(top, random.uniform(-0.5, 0.5) * np.eye(1) @ d)
    whole = multiply(top, inverse(total))
    if random.random() < 0.5:
        whole = multiply(whole, inverse(other))
    left, right = random.normal(size=(2, 1)), random.normal(size=(1, 2))
    found = reduce_order(add(left @ whole @ right, constant(random.normal(size=(2, 2)))))
    return _turned(found, random), center


def _turned(a: LFT, random: np.random.Generator) -> LFT:
    """The LFT in other coordinates of each block."""
    T = np.zeros((a.order, a.order))
    for part in a.slices().values():
        size = part.stop - part.start
        T[part, part] = random.normal(size=(size, size)) + 2.0 * np.eye(size)
    back = np.linalg.inv(T)
    return LFT(T @ a.M11 @ back, T @ a.M12, a.M21 @ back, a.M22, a.blocks)
