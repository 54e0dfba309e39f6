"""The inward pass as it is in the books: a displaced joint turns the forces that pass it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from unittest.mock import patch

import casadi as ca
import numpy as np

import mbdlft
from mbdlft.multibody.assembly.kinematics import Motions, Passed, Placed, pass_inward
from tests import close

_LEAST = 1e-3  # of its row: a smaller entry has cancelled


@contextmanager
def forces_turned_on_the_way() -> Iterator[None]:
    """Scenes are assembled with it, also where weights could be felt in the axes of each lever."""
    assembled = patch.object(
        import_module("mbdlft.multibody.assembly.newton_euler"), "pass_weights_inward", _pass
    )
    with assembled, one_order_only():
        yield


@contextmanager
def one_order_only() -> Iterator[None]:
    """Scenes are assembled once, with the weights in one order of products."""
    module = import_module("mbdlft.multibody.to_problem")
    right = module.assembly
    with patch.object(module, "assembly", lambda scene: replace(right(scene), second_order=lambda: None)):
        yield


def _pass(
    placed: Placed, found: Motions, inertial: Mapping[str, ca.SX], loads: Mapping[str, ca.SX], load: ca.SX
) -> Passed:
    return pass_inward(placed, found, {name: inertial[name] + loads[name] for name in inertial})


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
