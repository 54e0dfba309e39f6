"""Closures that slide, and those with an orientation, against Lagrange's equations with constraints.

Their constraints are true gaps and cosines, and redundant rows stay.
"""

import pytest

import mbdlft
from tests.cross.mechanism import linear_at, mechanism
from tests.cross.mechanisms import closed_by
from tests.cross.mixed_mechanisms import mixed
from tests.cross.test_mechanism import compare, points_of

FEW = {"prismatic": 0, "cylindrical": 0, "universal": 0}
MANY = [(kind, seed) for kind in mbdlft.multibody.loop.KINDS for seed in (2, 4, 5)]


def check(kind: str, seed: int, *, bare: bool) -> None:
    scene = closed_by(kind, seed)
    if bare:
        scene = scene.model_copy(update={"sensors": scene.sensors[6:8]})
    equals_lagrange(scene)


def equals_lagrange(scene: mbdlft.Scene) -> None:
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


def test_a_mixed_mechanism_equals_lagrange() -> None:
    """A chain with gears, a strut, a sleeve that closes it, and a joint that moves as inputs say."""
    equals_lagrange(mixed(15))
