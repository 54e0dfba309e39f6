"""Margins and gains of random systems: no model in a proved box is unstable, and worst cases are.

Models are decided in rational numbers, with Hurwitz's criterion; proofs are proved again.
"""

from itertools import product
from pathlib import Path

import flint
import numpy as np

import mbdlft
from mbdlft import Block, MbdlftError, Parameter, Signal, System
from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT
from mbdlft.robust.ascent import abscissa
from mbdlft.robust.bisect.lyapunov import searched
from mbdlft.robust.realization import realization

KINDS = ("plain", "light", "jordan", "scaled", "fast", "loops", "static", "small integers", "border")
WORK, LYAPUNOV, LARGEST, RAYS, STEPS = 3.0, 0.3, 50.0, 100, 6
BEYOND = (0.0, 1e-12, 1e-9, 1e-6)  # of a worst case, which is computed in doubles


def attack(seed: int, folder: Path) -> str:
    """Analyze one system, and look for what its bounds exclude."""
    system, random = drawn(seed), np.random.default_rng(seed + 10**6)
    try:
        margin = mbdlft.robust_stability(system, work=WORK, largest=LARGEST)
        gain = mbdlft.worst_case_gain(system, work=WORK)
    except MbdlftError:
        return "refused"
    for found in (margin, gain):
        assert found.lower <= found.upper * (1.0 + 1e-12), found
        assert found.proof is None or mbdlft.verify(system, found) == "", found
    if margin.lower:
        for delta in worst_in(system, min(margin.lower, LARGEST) * (1.0 - 1e-9), random):
            assert is_stable(system, delta), f"{margin} is false at {delta.tolist()}"
    if np.isfinite(margin.upper):
        assert is_worst(system, margin), f"{margin} is reached by no pole"
        assert not has_function(system, margin.upper * (1.0 + BEYOND[-1])), f"{margin}, and a proof"
    if np.isinf(gain.lower):
        assert is_worst(system, gain), f"{gain} is stable"
        assert margin.lower <= 1.0, f"{gain} with {margin}"
    elif np.isfinite(gain.upper):
        q = len(system.parameters)
        deltas = np.vstack([corners(q), random.uniform(-1.0, 1.0, (20, q))])
        largest = max(norm_at(system, delta) for delta in deltas)
        assert largest <= gain.upper * (1.0 + 1e-8), f"{gain}, but {largest:.17g}"
    return "closed" if margin.gap <= 0.01 else "open"


def drawn(seed: int) -> System:
    """A system whose nominal model is stable."""
    random, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    n, q = int(random.integers(1, 6)) * (kind != "static"), int(random.integers(1, 4))
    sizes = random.integers(1, 4, q)
    N = int(np.sum(sizes))
    A, B, C = (random.standard_normal(shape) for shape in ((n, n), (n, N), (N, n)))
    D = np.zeros((N, N))
    if kind in ("loops", "static"):
        D = 0.3 * random.standard_normal((N, N))
    if kind == "jordan":
        A = np.diag(np.ones(n - 1), 1)
    elif kind == "small integers":
        A, B, C = np.round(2.0 * A), np.round(B), np.round(C)
    poles = np.linalg.eigvals(A)
    distance = {"light": 1e-6, "jordan": 0.2}.get(kind, 0.3)
    most = float(np.max(poles.real, initial=0.0) + distance * np.max(np.abs(poles), initial=1.0))
    A, B = A - most * np.eye(n), B * 10.0 ** random.uniform(-2.0, -0.3)
    if kind == "border":  # the last pole, -1 + d0, is on the axis at 1
        A = np.block([[A, np.zeros((n, 1))], [np.zeros((1, n)), -np.ones((1, 1))]])
        B, C, n = np.vstack([B, np.eye(1, N)]), np.hstack([C, np.eye(N, 1)]), n + 1
    time = 10.0 ** random.choice([-8.0, 8.0]) if kind == "fast" else 1.0
    scale = 10.0 ** random.uniform(-8.0, 8.0, n) if kind == "scaled" else np.ones(n)
    A, B, C = time * scale[:, None] * A / scale, time * scale[:, None] * B, C / scale
    E, G, F = random.standard_normal((n, 1)), random.standard_normal((1, n)), np.ones((N, 1))
    blocks = tuple(Block(f"d{k}", int(size)) for k, size in enumerate(sizes))
    own = tuple(Parameter(block.name, 0.0, low=-1.0, high=1.0) for block in blocks)
    inner = np.block([[A, scale[:, None] * E], [G / scale, np.ones((1, 1))]])
    lft = LFT(D, np.hstack([C, F]), np.vstack([B, F.T]), inner, blocks)
    states = tuple(Signal(f"x{k}", "1") for k in range(n))
    channels = (Signal("u", "1"),), (Signal("y", "1"),)
    return System(kind, lft, states, *channels, mbdlft.Parameters(own))


def has_function(system: System, k: float) -> bool:
    """Whether Lyapunov functions prove a size of the box, where no point is looked at."""
    model = realization(system)
    return searched(model, np.full(len(model.sizes), k), LYAPUNOV, lambda _: False).proof is not None


def corners(q: int) -> Array:
    """Corners, middles of faces, and the center of a box (3^q, q)."""
    return np.array(list(product([-1.0, 0.0, 1.0], repeat=q)))


def worst_in(system: System, k: float, random: np.random.Generator) -> list[Array]:
    """The deltas of a box that seem to be least stable: samples, and what is reached from the worst."""
    model, q = realization(system), len(system.parameters)
    shapes = np.vstack([corners(q), random.uniform(-1.0, 1.0, (RAYS, q))])
    worst = max(k * shapes, key=lambda delta: abscissa(model, delta)).copy()
    best, step = abscissa(model, worst), 0.3 * k
    for _ in range(STEPS):
        for move in step * np.vstack([np.eye(q), -np.eye(q)]):
            moved = np.clip(worst + move, -k, k)
            if (value := abscissa(model, moved)) > best:
                worst, best = moved, value
        step *= 0.5
    return [worst, *(k * shapes[: 3**q])]


def is_worst(system: System, found: mbdlft.Bounds) -> bool:
    """Whether the model at a worst case, or a rounding beyond it, is not stable."""
    delta = np.array([found.delta[name] for name in system.parameters.names])
    return any(not is_stable(system, delta * (1.0 + more)) for more in BEYOND)


def is_stable(system: System, delta: Array) -> bool:
    """Whether det(I - Delta D) > 0 and A(delta) is Hurwitz, in rational numbers."""
    w = np.repeat(delta, [block.size for block in system.lft.blocks])
    A, B, C, D = map(_exactly, (system.A, system.B_w, system.C_z, system.D_zw))
    loop = _exactly(np.eye(len(w))) - _exactly(np.diag(w)) * D
    if loop.det() <= 0:
        return False
    if not len(system.A):
        return True
    p = (A + B * loop.solve(_exactly(np.diag(w)) * C)).charpoly().coeffs()[::-1]
    upper, lower = p[::2], p[1::2]
    while lower:
        if not (upper[0] > 0 and lower[0] > 0):
            return False
        ratio, more = upper[0] / lower[0], [*lower[1:], flint.fmpq(0)]
        upper, lower = lower, [a - ratio * b for a, b in zip(upper[1:], more, strict=False)]
    return bool(upper[0] > 0)


def _exactly(a: Array) -> flint.fmpq_mat:
    entries = [flint.fmpq(*float(x).as_integer_ratio()) for x in a.ravel()]
    return flint.fmpq_mat(*a.shape, entries)


def norm_at(system: System, delta: Array) -> float:
    """The largest gain on a grid of frequencies, in doubles."""
    w = np.repeat(delta, [block.size for block in system.lft.blocks])
    inner = np.linalg.solve(np.eye(len(w)) - w[:, None] * system.D_zw, w[:, None] * system.lft.M12)
    whole, n = system.lft.M22 + system.lft.M21 @ inner, len(system.A)
    poles = np.abs(np.linalg.eigvals(whole[:n, :n]))
    omega = np.concatenate([[0.0], poles, *(poles * x for x in (0.9, 0.99, 1.01, 1.1))])
    shifted = 1j * omega[:, None, None] * np.eye(n) - whole[:n, :n]
    direct = whole[n:, n:]
    at = whole[n:, :n] @ np.linalg.solve(shifted, whole[:n, n:][None] + 0j) + direct if n else direct
    return float(np.max(np.abs(at)))
