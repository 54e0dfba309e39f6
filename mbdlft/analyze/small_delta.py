"""Deltas that make I - M Delta singular: lower bounds of the structured singular value of a matrix.

A positive eigenvalue of M Delta with ||Delta|| <= 1 is a lower bound: Delta over it makes I - M Delta
singular. Starts come from the power iteration of Young, Doyle (Computation of mu with real and complex
uncertainties, CDC 1990) and at random; from each, the eigenvalue is made as large as it becomes while it
stays real, by sequential quadratic programming with exact slopes d lambda = u'M dDelta v/(u'v).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig

from mbdlft.base.array import Array
from mbdlft.lft.block import Block

_ITERATIONS, _STARTS, _STEPS = 60, 4, 60
_REAL = 1e-7  # imaginary part of an eigenvalue, of its size, that counts as zero
_ENOUGH = 1e-6  # of a bound that need not be improved
_CLEAR = 1e-12  # of the norm of M: an eigenvalue below this is zero

Complex = NDArray[np.complex128]


class SmallDelta(NamedTuple):
    """A Delta (n_w, n_z) that makes I - M Delta singular, and 1 over its norm.

    Attributes
    ----------
    bound : float
        0, if none was found; `delta` is then 0, too.
    delta : complex array (n_w, n_z)
    residual : float
        Smallest over largest singular value of I - M Delta.
    """

    bound: float
    delta: Complex
    residual: float


class _Part(NamedTuple):
    block: Block
    z: slice
    w: slice


def small_delta(M: Complex, blocks: Sequence[Block], enough: float = np.inf) -> SmallDelta:
    """The smallest Delta of the blocks that was found to make I - M Delta singular.

    The search ends when its bound is nearly `enough`, such as an upper bound.
    """
    parts = _parts(blocks)
    none = SmallDelta(0.0, np.zeros(M.T.shape, dtype=complex), 1.0)
    size = float(np.linalg.norm(M, 2)) if M.size else 0.0
    if size == 0.0:
        return none
    random, best = np.random.default_rng(0), none
    for _ in range(_STARTS):
        if best.bound >= enough * (1.0 - _ENOUGH):
            break
        for unit in (_iterated(M / size, parts, random), _random(parts, M.shape, random)):
            found = _enlarged(M, parts, unit)
            if found.bound > best.bound and found.bound > _CLEAR * size:
                best = found
    return best


def _parts(blocks: Sequence[Block]) -> list[_Part]:
    parts, z, w = [], 0, 0
    for block in blocks:
        parts.append(_Part(block, slice(z, z + block.inputs), slice(w, w + block.outputs)))
        z, w = z + block.inputs, w + block.outputs
    return [part for part in parts if part.block.size]


def _random(parts: Sequence[_Part], shape: tuple[int, int], random: Any) -> Complex:
    """A Delta of norm 1, real deltas at their ends."""
    found = np.zeros((shape[1], shape[0]), dtype=complex)
    for block, z, w in parts:
        if block.kind == "real":
            found[w, z] = random.choice([-1.0, 1.0]) * np.eye(block.size)
        elif block.kind == "complex":
            found[w, z] = np.exp(2j * np.pi * random.uniform()) * np.eye(block.size)
        else:
            u, v = (random.standard_normal(2 * n) for n in (block.outputs, block.inputs))
            u, v = (x[::2] + 1j * x[1::2] for x in (u, v))
            found[w, z] = np.outer(u, v.conj()) / (np.linalg.norm(u) * np.linalg.norm(v))
    return found


def _iterated(M: Complex, parts: Sequence[_Part], random: Any) -> Complex:
    """The Delta of norm 1 to which the power iteration leads, or comes near."""
    n_z, n_w = M.shape

    def unit(n: int) -> Complex:
        x = random.standard_normal(n) + 1j * random.standard_normal(n)
        return np.asarray(x / np.linalg.norm(x))

    b, w = unit(n_w), unit(n_w)
    q = np.ones(len(parts))
    for _ in range(_ITERATIONS):
        a = _normed(M @ b)
        z = _aligned(parts, q, a, b, w, n_z, to_z=True)
        w = _normed(M.conj().T @ z)
        b = _aligned(parts, q, a, b, w, n_w, to_z=False)
    found = np.zeros((n_w, n_z), dtype=complex)
    for k, (block, rows, columns) in enumerate(parts):
        left, right = w[columns], a[rows]
        if block.kind == "real":
            found[columns, rows] = q[k] * np.eye(block.size)
        elif block.kind == "complex":
            found[columns, rows] = _phase(np.vdot(right, left)) * np.eye(block.size)
        else:
            size = max(float(np.linalg.norm(left)) * float(np.linalg.norm(right)), 1e-300)
            found[columns, rows] = np.outer(left, right.conj()) / size
    return found


def _aligned(
    parts: Sequence[_Part], q: Array, a: Complex, b: Complex, w: Complex, size: int, *, to_z: bool
) -> Complex:
    """z from a and w, or b from them; the real deltas q are moved on the way."""
    found = np.zeros(size, dtype=complex)
    for k, (block, rows, columns) in enumerate(parts):
        x, y = a[rows], w[columns]
        here = rows if to_z else columns
        source = y if to_z else x
        sizes = max(float(np.linalg.norm(x)), 1e-300), max(float(np.linalg.norm(y)), 1e-300)
        if block.kind == "real":
            old = float(np.linalg.norm(b[columns])) / sizes[0]
            q[k] = np.clip(np.sign(q[k] or 1.0) * old + float(np.vdot(x, y).real), -1.0, 1.0)
            found[here] = q[k] * source
        elif block.kind == "complex":
            found[here] = (_phase(np.vdot(y, x)) if to_z else _phase(np.vdot(x, y))) * source
        else:
            found[here] = x * sizes[1] / sizes[0] if to_z else y * sizes[0] / sizes[1]
    return found


def _phase(number: Any) -> complex:
    return complex(number / abs(number)) if number else 1.0


def _normed(x: Complex) -> Complex:
    return np.asarray(x / max(float(np.linalg.norm(x)), 1e-300))


def _enlarged(M: Complex, parts: Sequence[_Part], unit: Complex) -> SmallDelta:
    """The real positive eigenvalue of M Delta nearest to what Delta begins with, made large."""
    from scipy.optimize import minimize  # here because it is slow to import

    real = [k for k, part in enumerate(parts) if part.block.kind == "real"]
    turns = [k for k, part in enumerate(parts) if part.block.kind != "real"]
    start = np.array([unit[parts[k].w, parts[k].z][0, 0].real for k in real] + [0.0 for _ in turns])

    def delta(x: Array) -> Complex:
        found = unit.copy()
        for value, k in zip(x, real + turns, strict=True):
            _, z, w = parts[k]
            if k in real:
                found[w, z] = value * np.eye(parts[k].block.size)
            else:
                found[w, z] = unit[w, z] * np.exp(1j * value)
        return found

    def value(x: Array) -> tuple[complex, Complex]:
        """An eigenvalue, and its derivatives."""
        D = delta(x)
        values, left, right = eig(M @ D, left=True, right=True)
        chosen = int(np.argmax(values.real - 2.0 * np.abs(values.imag)))
        u, v = left[:, chosen].conj() @ M, right[:, chosen]
        scale = np.vdot(left[:, chosen], v) or 1e-300
        slopes = []
        for k in real + turns:
            _, z, w = parts[k]
            step = u[w] @ v[z] if k in real else 1j * (u[w] @ D[w, z] @ v[z])
            slopes.append(step / scale)
        return complex(values[chosen]), np.array(slopes)

    bounds = [(-1.0, 1.0)] * len(real) + [(None, None)] * len(turns)
    size = max(abs(value(start)[0]), 1e-12 * float(np.linalg.norm(M)))

    def objective(x: Array) -> tuple[float, Array]:
        found, slopes = value(x)
        return -found.real / size, -slopes.real / size

    found = minimize(
        objective,
        start,
        jac=True,
        bounds=bounds,
        constraints={
            "type": "eq",
            "fun": lambda x: value(x)[0].imag / size,
            "jac": lambda x: value(x)[1].imag / size,
        },
        method="SLSQP",
        options={"maxiter": _STEPS, "ftol": 1e-12},
    )
    x = np.concatenate([np.clip(found.x[: len(real)], -1.0, 1.0), found.x[len(real) :]])
    if not np.all(np.isfinite(x)):
        x = start
    return _verified(M, delta(x))


def _verified(M: Complex, unit: Complex) -> SmallDelta:
    """What a Delta of norm at most 1 proves: by its largest real positive eigenvalue."""
    values = np.linalg.eigvals(M @ unit)
    fits = (values.real > 0.0) & (np.abs(values.imag) <= _REAL * np.abs(values))
    bound = float(np.max(values.real[fits], initial=0.0))
    if bound == 0.0:
        return SmallDelta(0.0, np.zeros_like(unit), 1.0)
    delta = unit / bound
    sizes = np.linalg.svd(np.eye(len(M)) - M @ delta, compute_uv=False)
    return SmallDelta(bound, delta, float(sizes[-1] / sizes[0]) if sizes[0] else 0.0)
