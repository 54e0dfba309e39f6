"""Errors of beams with piezoelectric patches."""

from collections.abc import Callable

import pytest

from mbdlft import Fixed, Parameter, PiezoBeam, PiezoPatch, Scene, SceneError, assemble
from tests.errors.scenes import says


def patch(**fields: object) -> PiezoPatch:
    given = {
        "start": 0,
        "end": 2,
        "width": 0.02,
        "thickness": 1e-3,
        "density": 7600,
        "modulus": 5e10,
        "d31": -1.5e-10,
        "permittivity": 1.59e-8,
    }
    return PiezoPatch(**(given | fields))


def beam(*patches: PiezoPatch, **fields: object) -> PiezoBeam:
    given = {
        "name": "b",
        "length": 1,
        "density": 2600,
        "area": 1e-4,
        "modulus": 6e10,
        "I_z": 1e-9,
        "thickness": 0.01,
        "elements": 2,
        "deformations": ["axial", "bending_y"],
        "patches": patches,
    }
    return PiezoBeam(**(given | fields))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: patch(side="left"), "patches: unknown side 'left'. "),
        (lambda: patch(start=2), "patches: expected a node 'end' after 'start', got start = 2 and"),
        (lambda: patch(wdth=1), "patches: unknown key 'wdth'."),
        (lambda: beam(), "body 'b': patches: at least one is needed; without any the beam is a"),
        (lambda: beam(patch(end=3)), "patch 1: expected nodes from 0 to 2, got end = 3."),
        (
            lambda: beam(patch(), deformations=["bending_y"]),
            "patch 1, side 'top': it needs the deformation 'axial', which the beam does not have",
        ),
        (
            lambda: beam(patch(side="both"), deformations=["axial"]),
            "patch 1, side 'both': it needs the deformation 'bending_y'",
        ),
        (
            lambda: beam(patch(), shear_coefficient=0.8, shear_modulus=2e10),
            "shear_coefficient: a beam with patches has no shear.",
        ),
    ],
)
def test_description(make: Callable[[], object], message: str) -> None:
    with says(SceneError, message):
        make()


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            beam(patch(permittivity=1.59e-12)),  # as printed, erratum 12
            "body 'b': patch1: permittivity - d31^2 modulus, that at constant strain, is not positive",
        ),
        (beam(patch(), patch(thickness="q")), "body 'b': patch2.thickness is not positive in the"),
        (
            beam(patch(), thickness=-0.01),
            "body 'b': thickness is not positive in the range: -0.01.",
        ),
        (beam(patch(), area=-1e-4), "body 'b': area is not positive in the range"),
    ],
)
def test_physics(body: PiezoBeam, message: str) -> None:
    scene = Scene(
        name="s",
        parameters=[Parameter("q", 1e-3, low=-1e-3, high=2e-3, unit="m")],
        bodies=[body],
        joints=[Fixed(name="wall", parent="ground", child="b")],
    )
    with says(SceneError, message):
        assemble(scene)
