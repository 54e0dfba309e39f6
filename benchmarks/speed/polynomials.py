"""The common practice: linearize on a grid of the parameters, and fit a polynomial to each entry.

The grid has one value more for each parameter than the degree; the polynomial has all monomials up to
the degree in all parameters together, by least squares.
"""

from itertools import combinations_with_replacement, product

import numpy as np

from benchmarks.speed.motion import Circle, state_space
from benchmarks.speed.robots import Array, Method, Samples
from benchmarks.speed.systems import System

_CHUNK = 4096


def by_polynomials(system: System, degree: int) -> Method:
    """Polynomials of a degree in the parameters, scaled to [-1, 1]."""
    low, high = np.array([(p.low, p.high) for p in system.parameters]).T
    names = [p.name for p in system.parameters]
    powers = [
        chosen
        for d in range(1, degree + 1)
        for chosen in combinations_with_replacement(range(len(names)), d)
    ]
    levels = np.linspace(-1.0, 1.0, degree + 1)
    grid = np.array(list(product(levels, repeat=len(names))))
    gram, right, seen = np.zeros((1 + len(powers),) * 2), None, None
    for start in range(0, len(grid), _CHUNK):
        part = grid[start : start + _CHUNK]
        physical = 0.5 * (low + high) + 0.5 * (high - low) * part
        values = closed_form(system, dict(zip(names, physical.T, strict=True)))
        flat = values.reshape(len(part), -1)
        basis = monomials(part, powers)
        gram += basis.T @ basis
        right = basis.T @ flat if right is None else right + basis.T @ flat
        ends = np.stack([flat.min(axis=0), flat.max(axis=0)])
        seen = (
            ends
            if seen is None
            else np.stack([np.minimum(seen[0], ends[0]), np.maximum(seen[1], ends[1])])
        )
    assert right is not None
    assert seen is not None
    varying = np.flatnonzero(seen[0] < seen[1])
    factors = np.linalg.solve(gram, right[:, varying])
    shape, constant = values.shape[1:], seen[0]

    def method(samples: Samples) -> Array:
        points = np.stack([samples[name] for name in names], axis=-1)
        scaled = (points - 0.5 * (low + high)) / (0.5 * (high - low))
        found = np.tile(constant, (len(points), 1))
        found[:, varying] = monomials(scaled, powers) @ factors
        return found.reshape(len(points), *shape)

    return method


def monomials(points: Array, powers: list[tuple[int, ...]]) -> Array:
    """1 and all products (N, 1 + number of powers); each is made from one of a lower degree."""
    columns: dict[tuple[int, ...], Array] = {(): np.ones(len(points))}
    for chosen in powers:
        columns[chosen] = columns[chosen[:-1]] * points[:, chosen[-1]]
    return np.stack(list(columns.values()), axis=-1)


def closed_form(system: System, samples: Samples) -> Array:
    """[A B ; C D] (N, ., .) of the motion written down by hand, with NumPy."""
    motion = system.motion(system.in_radians(samples, np.pi / 180.0), Circle(np.cos, np.sin))
    rows = state_space(motion)
    count = len(next(iter(samples.values())))
    values = np.empty((count, len(rows), len(rows[0])))
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            values[:, i, j] = entry
    return values
