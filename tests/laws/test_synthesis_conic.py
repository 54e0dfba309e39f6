"""Descents with bends of gains: what they know of a gain beside a place, and what steps they take."""

from collections.abc import Sequence
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from mbdlft.synthesis import gain_goal
from mbdlft.synthesis.conic import sqcqp
from mbdlft.synthesis.curvature import Bends, bends
from mbdlft.synthesis.descent import Problem, sqp
from mbdlft.synthesis.evaluation import Look, Piece
from tests.close import CROSS, FITTED, target
from tests.laws.test_synthesis import CONTROLLERS, GOALS, _gain, case

FREE = np.full(4, np.inf)


@pytest.mark.parametrize("is_moving", [False, True])
def test_bends_are_second_derivatives(is_moving: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against differences in 60 digits; a second singular value adds what it repels."""
    monkeypatch.setattr("mbdlft.synthesis.curvature._PAIRED", 0.1)
    goals = (GOALS[0], gain_goal(["r", "f"], ["u", "y"], limit=20.0))
    _, loops, _, _ = case(CONTROLLERS["pid"][0], *goals, points=2)
    x, step = np.array(CONTROLLERS["pid"][1]), mp.mpf(10) ** -15
    held = [(0, 1, 1.3), (1, 0, 0.7), (1, 1, 60.0), *((0, 0, 2.0**k) for k in range(-2, 5))]
    found = bends(loops, goals, x, held, np.full(len(held), is_moving))
    assert found is not None
    d, falls = 0.1 * x + 0.01, 0
    with mp.workdps(60):
        for k, (goal, point, omega) in enumerate(held):

            def gain(a: int, b: int, here: Any = (goal, point, omega)) -> Any:
                beside = [mp.mpf(v) + a * step * e for v, e in zip(x, d, strict=True)]
                return _gain(loops, goals, (*here[:2], mp.mpf(here[2]) * (1 + b * step)), beside)

            along = (gain(1, 0) - 2 * gain(0, 0) + gain(-1, 0)) / step**2
            of_peak = (gain(0, 1) - 2 * gain(0, 0) + gain(0, -1)) / step**2
            mixed = (gain(1, 1) - gain(1, -1) - gain(-1, 1) + gain(-1, -1)) / (4 * step**2)
            falls += of_peak < 0
            repelled = 0.0
            if np.isfinite(found.value[k]):
                repelled = 2.0 * abs(found.cross[k] @ d) ** 2 / (float(gain(0, 0)) - found.value[k])
            if is_moving and np.isfinite(found.value[k]):
                continue  # its peak is that without the second one
            wanted = along - (mixed**2 / of_peak if is_moving and of_peak < 0 else 0)
            target([d @ found.second[k] @ d + repelled], [float(wanted)], CROSS, abs(float(along)) + 1e-9)
    assert falls > 0
    assert np.any(np.isfinite(found.value))


def _curved(count: int, seed: int) -> tuple[Problem, list[float]]:
    """The largest of random quadratic gains, and what was seen of it."""
    random, looks = np.random.default_rng(seed), list[float]()
    values, slopes = random.uniform(0.9, 1.0, count), random.standard_normal((count, 4))
    roots = random.standard_normal((count, 2, 4)) * 10.0 ** random.uniform(-1.0, 2.0, (count, 1, 1))
    second = np.swapaxes(roots, 1, 2) @ roots

    def at(x: np.ndarray, _: Any = ()) -> Look:
        now = values + slopes @ x + 0.5 * np.einsum("kij,i,j->k", second, x, x)
        steep = slopes + second @ x
        looks.append(float(np.max(now)))
        pieces = tuple(Piece(0, k, 1.0, now[k], steep[k]) for k in range(count))
        return Look(looks[-1], -np.inf, pieces, -1.0)

    def bent(x: np.ndarray, held: Sequence[tuple[int, int, float]], _: Any) -> Bends:
        k, own = len(held), second[[point for _, point, _ in held]]
        return Bends(own, np.full(k, -np.inf), np.zeros((k, 4)), np.zeros((k, 4), complex))

    return Problem(at, -FREE, FREE, lambda _: False, 1.0, gains=frozenset({0}), bends=bent), looks


@pytest.mark.parametrize("seed", range(3))
def test_curved_gains_are_followed_in_a_few_steps(seed: int) -> None:
    """Where each gain has a curvature of its own, and several are equal at the end."""
    problem, looks = _curved(30, seed)
    found = sqcqp(problem, np.zeros(4), 60, 1e-9)
    assert len(looks) < 12
    other = sqp(problem._replace(bends=None), np.zeros(4), 500, 1e-12)
    target([found.merit], [min(found.merit, other.merit)], FITTED)


def test_coupled_singular_values_are_followed_together() -> None:
    """The larger eigenvalue of [1 + x, x + y ; x + y, 1 + z], from equal ones to the bounds."""
    looks = []

    def at(x: np.ndarray, _: Any = ()) -> Look:
        a = np.array([[1.0 + x[0], x[1] + x[0]], [x[1] + x[0], 1.0 + x[2]]])
        (_, size), vectors = np.linalg.eigh(a)
        u, v = vectors[:, 1]
        slope = np.array([u * u + 2.0 * u * v, 2.0 * u * v, v * v, 0.0])
        looks.append(float(size))
        return Look(looks[-1], -np.inf, (Piece(0, 0, 1.0, looks[-1], slope),), -1.0)

    def bent(x: np.ndarray, _: Any, __: Any) -> Bends:
        a = np.array([[1.0 + x[0], x[1] + x[0]], [x[1] + x[0], 1.0 + x[2]]])
        sizes, vectors = np.linalg.eigh(a)
        (p, q), (u, v) = vectors[:, 0], vectors[:, 1]
        slope = np.array([p * p + 2.0 * p * q, 2.0 * p * q, q * q, 0.0])
        cross = np.array([u * p + u * q + v * p, u * q + v * p, v * q, 0.0])
        return Bends(np.zeros((1, 4, 4)), sizes[:1], slope[None], cross[None].astype(complex))

    low = np.array([-0.5, -np.inf, -0.5, -1.0])
    problem = Problem(at, low, -low, lambda _: False, 1.0, gains=frozenset({0}), bends=bent)
    found = sqcqp(problem, np.zeros(4), 40, 1e-9)
    target(found.x[:3], [-0.5, 0.5, -0.5], FITTED)
    assert len(looks) < 5
