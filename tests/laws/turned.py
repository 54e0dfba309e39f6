"""The inward pass as it is in the books: a displaced joint turns the forces that pass it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from unittest.mock import patch

import casadi as ca
import numpy as np

import mbdlft
from mbdlft.multibody.assembly.kinematics import Motions, Passed, pass_inward
from mbdlft.multibody.assembly.newton_euler import Assembly
from mbdlft.multibody.assembly.weights import Weights
from tests import close

_LEAST = 1e-3  # of its row: a smaller entry has cancelled


@contextmanager
def forces_turned_on_the_way() -> Iterator[None]:
    """Scenes are assembled with it, also where weights could be felt in the axes of each lever."""
    with patch.object(Weights, "passed", _pass), one_order_only():
        yield


@contextmanager
def one_order_only() -> Iterator[None]:
    """Scenes are assembled once, with the weights in one order of products."""
    with patch.object(Assembly, "second_order", lambda self: None):
        yield


def _pass(
    weights: Weights, moving: Motions, inertial: Mapping[str, ca.SX], loads: Mapping[str, ca.SX]
) -> Passed:
    return pass_inward(weights.placed, moving, {name: inertial[name] + loads[name] for name in inertial})


def compare(scene: mbdlft.Scene, one: mbdlft.LFTModel, bound: float) -> None:
    """A model of a scene has the values of that with forces turned on the way, at points and a corner."""
    with forces_turned_on_the_way():
        other = mbdlft.to_lft(scene, search=0.0)
    points = mbdlft.random(one.parameters, 5, seed=1)
    corner = {p.name: np.append(points[p.name], p.high) for p in one.parameters}
    for actual, expected in zip(
        mbdlft.matrices_at(one, corner), mbdlft.matrices_at(other, corner), strict=True
    ):
        size = np.abs(expected) if expected.ndim == 2 else np.max(np.abs(expected), axis=0)
        row = np.max(size, axis=1, keepdims=True, initial=0.0)
        scale = np.where(row > 0.0, np.maximum(size, _LEAST * row), 1.0)
        close.target(actual / scale, expected / scale, bound, scale=1.0)
