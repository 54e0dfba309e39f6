"""A chain with one mass at its tip: the stiffness of its weight, at the minimum for any number of joints.

K_ab = (e_a x g) . (e_b x c) for joints a <= b, with c = R_1 ... R_n d from any joint to the tip. K is
minus the Hessian of g . R_1 ... R_n d in the angles, which is affine in the cosine and sine of each: at
the two poles of the tangent of half an angle K has rank n, so each angle needs 2n repetitions.
"""

import casadi as ca
import numpy as np
import pytest

from mbdlft.base.array import Array
from mbdlft.lft import lft
from mbdlft.lft.sampling import evaluate_at
from mbdlft.order.reduction import reduce_order
from tests.close import roundoff
from tests.extracted import lower_bound

LOAD, TIP = np.array([0.0, 0.3, -1.0]), np.array([0.2, 1.0, 0.1])
KAPPA = 1e2
LEAST, SPAN = 0.2, 0.3  # of the tangents of half the angles


def axis(k: int) -> Array:
    """Unit vector (3,) of joint k: x and z in turn."""
    return np.eye(3)[2 if k % 2 else 0]


def cross(v: Array) -> Array:
    """v x, as a matrix (3, 3)."""
    return np.cross(v, np.eye(3)).T


def rotation(k: int) -> lft.LFT:
    """Cayley transform of the tangent t of half of angle k: 2 (I - t [e])^-1 - I, two repetitions."""
    t = LEAST + SPAN * np.eye(1) @ lft.delta(f"t{k}")
    turned = lft.constant(np.eye(3)) - cross(axis(k)) @ lft.stack_diagonal(t, t, t)
    return reduce_order(2.0 * np.eye(3) @ lft.inverse(turned) - np.eye(3))


def as_it_is(n: int) -> lft.LFT:
    """Entry by entry: from the tip inward to the load."""
    R = [rotation(k) for k in range(n)]
    rows = []
    for a in range(n):
        row = lft.constant(np.zeros((1, n)))
        for b in range(n):
            inner, outer = min(a, b), max(a, b)
            v = TIP[:, None] @ lft.constant(np.eye(n)[[b]])
            for k in reversed(range(n)):
                v = R[k] @ v
                v = cross(axis(k)) @ v if k == outer else v
                v = -cross(axis(k)) @ v if k == inner else v
            row = reduce_order(row + LOAD[None] @ v)
        rows.append(row)
    return reduce_order(lft.stack_rows(*rows))


def by_products(n: int) -> lft.LFT:
    """e_a . vec(g Theta c), Theta all that has turned, and a Green's matrix h_min f_max.

    f = e . c is a function of the angles outside of a joint, h = e . g of those inside; what joint 1 has
    of both is part of the first term.
    """
    R, e = [rotation(k) for k in range(n)], [axis(k)[:, None] for k in range(n)]
    q = [lft.constant(np.eye(n)[[k]]) for k in range(n)]
    turned = lft.constant(np.zeros((3, n)))
    for k in reversed(range(n)):
        outside = R[k] @ turned  # without joint k
        turned = reduce_order(outside + e[k] @ q[k])
    scalar = reduce_order(LOAD[None] @ outside)
    F = cross(LOAD) @ turned
    for k in range(n):
        F = lft.transpose(R[k]) @ F
    H = -cross(TIP) @ F - TIP[:, None] @ scalar
    rows: list[lft.LFT] = []
    for k in reversed(range(n)):
        rows.insert(0, e[k].T @ H)
        H = R[k] @ H
    f: dict[tuple[int, int], lft.LFT] = {}
    for b in range(1, n):
        c = TIP[:, None] @ q[b]
        for a in reversed(range(b, n)):
            f[a, b] = reduce_order(e[a].T @ c)
            c = R[a] @ c
    for a in range(n - 1):
        v = e[a] @ sum((f[b, b] for b in range(max(a, 1), n)), lft.constant(np.zeros((1, n))))
        for b in reversed(range(a)):
            v = R[b] @ v
            v = reduce_order(v + e[b] @ f[a, b] if b else v)
        rows[a] = rows[a] + LOAD[None] @ v
    rows[-1] = rows[-1] + (e[-1].T @ TIP[:, None]) @ scalar
    return reduce_order(lft.stack_rows(*rows))


@pytest.mark.parametrize("n", [2, 3, 4, 5, 6])
def test_products_are_the_minimum(n: int) -> None:
    direct, found = as_it_is(n), by_products(n)
    names = [f"t{k}" for k in range(n)]
    direct, found = lft.with_blocks(direct, names), lft.with_blocks(found, names)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, n))
    roundoff(evaluate_at(found, points), evaluate_at(direct, points), KAPPA)
    assert [block.size for block in found.blocks] == [2 * n] * n
    assert lower_bound(found) == dict.fromkeys(names, 2 * n)
    assert [block.size for block in direct.blocks] == [2 * k * (n + 1 - k) for k in range(1, n + 1)]


def test_as_it_is_is_the_hessian() -> None:
    """By automatic differentiation of g . R_1 ... R_n d, with the cosine and sine of each angle."""
    n = 4
    theta = ca.SX.sym("theta", n)
    v = ca.SX(TIP)
    for k in reversed(range(n)):
        E = cross(axis(k))
        v = v + ca.sin(theta[k]) * (E @ v) + (1.0 - ca.cos(theta[k])) * (E @ E @ v)
    hessian = ca.Function("hessian", [theta], [ca.hessian(ca.dot(LOAD, v), theta)[0]])
    tangents = np.random.default_rng(1).uniform(-1.0, 1.0, (5, n))
    found = evaluate_at(as_it_is(n), tangents)
    expected = [-hessian(2.0 * np.arctan(LEAST + SPAN * t)).full() for t in tangents]
    roundoff(found, expected, KAPPA)
