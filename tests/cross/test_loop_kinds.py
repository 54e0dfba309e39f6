"""Closures that slide, and those with an orientation, against Lagrange's equations with constraints.

Their constraints are true gaps and cosines, and redundant rows stay.
"""

from collections.abc import Callable
from importlib import import_module

import casadi as ca
import pytest

import mbdlft
from mbdlft import Loop
from tests.cross.mechanism import linear_at, mechanism
from tests.cross.mechanisms import closed_by
from tests.cross.test_mechanism import compare, points_of

closing = import_module("mbdlft.multibody.assembly.closure")
FEW = {"prismatic": 0, "cylindrical": 0, "universal": 0}
MANY = [(kind, seed) for kind in mbdlft.multibody.loop.KINDS for seed in (2, 4, 5)]


def check(kind: str, seed: int, *, bare: bool) -> None:
    scene = closed_by(kind, seed)
    if bare:
        scene = scene.model_copy(update={"sensors": scene.sensors[6:8]})
    model, points = mbdlft.to_lft(scene, search=0.0, prove=0.0), points_of(scene)[:4]
    equations = mechanism(scene)
    compare(model, points, [linear_at(equations, model, point) for point in points])


@pytest.mark.parametrize("kind", FEW)
def test_kind_equals_lagrange(kind: str) -> None:
    check(kind, FEW[kind], bare=True)


@pytest.mark.long
@pytest.mark.parametrize(("kind", "seed"), MANY)
def test_many_kinds_equal_lagrange(kind: str, seed: int) -> None:
    check(kind, seed, bare=False)


Patch = pytest.MonkeyPatch


def turned_the_other_way(patch: Patch) -> None:
    patch.setattr(Loop, "in_parent_axes", Loop.in_own_axes)


def axis_that_stays(patch: Patch) -> None:
    """The second axis of a universal closure as it is at rest."""
    right = closing.second_axis

    def wrong(loop, own, across):
        found = right(loop, own, across)
        return ca.SX(ca.DM([2.0, 0.0, 1.0])) / 5.0**0.5 if loop.axis2 else found

    patch.setattr(closing, "second_axis", wrong)


@pytest.mark.parametrize(
    ("plant", "kind"), [(turned_the_other_way, "cylindrical"), (axis_that_stays, "universal")]
)
def test_planted_bug_is_found(plant: Callable[[Patch], None], kind: str, monkeypatch: Patch) -> None:
    plant(monkeypatch)
    with pytest.raises((AssertionError, mbdlft.MbdlftError)):
        check(kind, FEW[kind], bare=True)
