"""Random systems with parameters: lightly damped, badly scaled, of all sizes; and their true margins."""

from itertools import product

import numpy as np

import mbdlft
from mbdlft import Block, ComplexBlock, FullBlock, Signal, System
from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT
from tests.reference.robust_cases import of_matrices

KINDS = ("plain", "light", "scaled", "feedthrough")


def random_system(seed: int, most_states: int = 8, most_parameters: int = 4) -> System:
    """A stable system of 2 states or more with repeated parameters; the kind goes round with the seed."""
    random = np.random.default_rng(seed)
    n, q = int(random.integers(2, most_states + 1)), int(random.integers(1, most_parameters + 1))
    sizes = random.integers(1, 4, q)
    kind = KINDS[seed % len(KINDS)]
    A = random.standard_normal((n, n))
    shift = float(np.max(np.linalg.eigvals(A).real))
    light = float(np.max(np.abs(np.linalg.eigvals(A)))) * (1e-3 if kind == "light" else 0.3)
    A = A - (shift + light) * np.eye(n)
    N = int(np.sum(sizes))
    B, C = random.standard_normal((n, N)), random.standard_normal((N, n))
    D = 0.2 * random.standard_normal((N, N)) if kind == "feedthrough" else np.zeros((N, N))
    if kind == "scaled":
        states = 10.0 ** random.uniform(-3.0, 3.0, n)
        A, B, C = states[:, None] * A / states, states[:, None] * B, C / states
    B = B * 10.0 ** random.uniform(-1.5, -0.5)
    blocks = tuple(Block(f"d{k}", int(size)) for k, size in enumerate(sizes))
    return of_matrices(A, B, C, D, *blocks)


def mixed_system(seed: int) -> System:
    """A stable system with a real, a complex and a full block."""
    random = np.random.default_rng(seed)
    n = int(random.integers(2, 7))
    A = random.standard_normal((n, n))
    A = A - (float(np.max(np.linalg.eigvals(A).real)) + 0.2) * np.eye(n)
    rows, columns = (int(k) for k in random.integers(1, 4, 2))
    blocks = (Block("a", 2), ComplexBlock("b", 1), FullBlock("c", rows, columns))
    z, w = 3 + rows, 3 + columns
    B, C = 0.2 * random.standard_normal((n, w)), random.standard_normal((z, n))
    states = tuple(Signal(f"x{k}", "1") for k in range(n))
    own = mbdlft.Parameters((mbdlft.Parameter("a", 0.0, low=-1.0, high=1.0),))
    return System("mixed", LFT(np.zeros((z, w)), C, B, A, blocks), states, (), (), own)


def state_matrices(system: System, deltas: Array) -> Array:
    """A at deltas (N, q), beyond the box, too; by the definition."""
    sizes = [block.size for block in system.lft.blocks]
    w = np.repeat(deltas, sizes, axis=1)
    loop = np.eye(system.order) - w[:, :, None] * system.D_zw
    return np.asarray(system.A + system.B_w @ np.linalg.solve(loop, w[:, :, None] * system.C_z))


def reached(system: System, rays: int, largest: float, seed: int = 0) -> float:
    """The smallest size at which a model on some rays is unstable or singular: no margin is above it."""
    random, q = np.random.default_rng(seed), len(system.parameters)
    corners = np.array(list(product([-1.0, 1.0], repeat=q)))
    inner = random.uniform(-1.0, 1.0, (rays, q))
    inner = inner / np.max(np.abs(inner), axis=1, keepdims=True)
    best = largest
    for ray in np.concatenate([corners, inner]):
        sizes = np.linspace(0.0, best, 60)[1:]
        deltas = sizes[:, None] * ray
        unstable = np.max(np.linalg.eigvals(state_matrices(system, deltas)).real, axis=1) > 0.0
        w = np.repeat(deltas, [block.size for block in system.lft.blocks], axis=1)
        loop = np.eye(system.order) - w[:, :, None] * system.D_zw
        bad = unstable | (np.linalg.slogdet(loop)[0] <= 0.0)
        if np.any(bad):
            best = float(sizes[int(np.argmax(bad))])
    return best


def blocks_system(seed: int, most_states: int = 8) -> System:
    """A stable system with one to three repeated parameters and a complex, a tall or a wide block."""
    random = np.random.default_rng(1000 + seed)
    plain = random_system(seed, most_states, 3)
    kind, n = KINDS[seed % len(KINDS)], len(plain.A)
    rows, columns = (int(k) for k in random.integers(1, 4, 2))
    others = [FullBlock("f", rows, columns), ComplexBlock("e", int(random.integers(1, 3)))]
    others = others[:1] if seed % 3 == 0 else others[1:] if seed % 3 == 1 else others
    z = plain.order + sum(block.inputs for block in others)
    w = plain.order + sum(block.outputs for block in others)
    B, C = random.standard_normal((n, w)), random.standard_normal((z, n))
    D = 0.1 * random.standard_normal((z, w)) if kind == "feedthrough" else np.zeros((z, w))
    size = np.max(np.abs(plain.B_w), axis=1, keepdims=True)
    B = 0.1 * B * size
    C = C * np.max(np.abs(plain.C_z), axis=0)
    B[:, : plain.order], C[: plain.order] = plain.B_w, plain.C_z
    D[: plain.order, : plain.order] = plain.D_zw
    blocks = tuple(sorted([*plain.lft.blocks, *others], key=lambda block: block.name))
    return System("blocks", LFT(D, C, B, plain.A, blocks), plain.states, (), (), plain.parameters)
