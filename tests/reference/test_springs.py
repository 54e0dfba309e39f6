"""Springs and axial loads against closed forms of textbooks."""

from collections.abc import Sequence

import numpy as np
import pytest

import mbdlft
from tests.close import CLOSED_FORM, published, target

GRAVITY = 9.81
M = mbdlft.Parameter("m", 2.0, percent=50, unit="kg")
LENGTH = mbdlft.Parameter("L", 0.8, low=0.5, high=1.2, unit="m")
K = mbdlft.Parameter("k", 90.0, low=60.0, high=150.0, unit="N/m")


def values_of(model: mbdlft.LFTModel) -> dict[str, np.ndarray]:
    """50 random points and all corners."""
    inside, outer = mbdlft.random(model.parameters, 50), mbdlft.corners(model.parameters)
    return {p.name: np.concatenate([inside[p.name], outer[p.name]]) for p in model.parameters}


def pin(name: str, parent: str, child: str, position: float | str = 0.0, **fields) -> mbdlft.Revolute:
    return mbdlft.Revolute(
        name=name, parent=parent, child=child, axis=(1, 0, 0), position=position, **fields
    )


def string(length: float | str, parameters: Sequence[mbdlft.Parameter], **fields: object) -> mbdlft.Scene:
    """A mass in the middle of a string of two springs, free along it and across it."""
    side = {"parent": "bead", "stiffness": "k", "damping": 3.0, **fields}
    opposite = f"-{length}" if isinstance(length, str) else -length
    return mbdlft.Scene(
        name="string",
        parameters=[M, K, *parameters],
        bodies=[
            mbdlft.Ground(ports={"left": (opposite, 0, 0), "right": (length, 0, 0)}),
            mbdlft.RigidBody(name="frame", mass=0),
            mbdlft.PointMass(name="bead", mass="m"),
        ],
        joints=[
            mbdlft.Prismatic(name="x", parent="ground", child="frame", axis=(1, 0, 0), preload=0),
            mbdlft.Prismatic(name="y", parent="frame", child="bead", axis=(0, 1, 0), preload=0),
        ],
        loads=[
            mbdlft.Spring(name="a", child="ground.left", **side),
            mbdlft.Spring(name="b", child="ground.right", **side),
        ],
    )


def test_mass_on_a_tight_string() -> None:
    """A mass in the middle of a tight string: 2 T/a across it, 2 k along it."""
    tension = mbdlft.Parameter("T", 20.0, percent=40, unit="N")
    scene = string("L", [LENGTH, tension], force_density="T/L")
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A
    nothing = np.zeros(len(A))
    expected = [
        [-2 * v["k"] / v["m"], nothing, -6.0 / v["m"], nothing],
        [nothing, -2 * v["T"] / v["L"] / v["m"], nothing, nothing],
    ]
    target(A[:, 2:], np.moveaxis(expected, 2, 0), CLOSED_FORM)


def test_mass_between_stretched_springs() -> None:
    """The tension of a spring that is 0.8 m long and 0.5 m at rest is k (0.8 - 0.5)."""
    model = mbdlft.to_lft(string(0.8, [], rest_length=0.5), search=0.0)
    v = values_of(model)
    across = mbdlft.matrices_at(model, v).A[:, 3, 1]
    target(across, -2.0 * v["k"] * (0.8 - 0.5) / 0.8 / v["m"], CLOSED_FORM)


@pytest.mark.parametrize(("frame", "sinking"), [("ground", 1.0), ("body", 0.0)])
def test_column_on_a_spring_under_an_axial_load(frame: str, sinking: float) -> None:
    """m L^2 qdd + (c - P L) q = 0 for a dead load P; a load that follows the column does nothing."""
    scene = mbdlft.Scene(
        name="column",
        parameters=[M, LENGTH, mbdlft.Parameter("P", 20.0, percent=90, unit="N")],
        bodies=[mbdlft.PointMass(name="tip", mass="m", ports={"foot": (0, 0, "-L")})],
        joints=[pin("foot", "ground", "tip.foot", stiffness=15.0, preload=0)],
        loads=[mbdlft.Force(name="P", port="tip", direction=(0, 0, -1), frame=frame, magnitude="P")],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    stiffness = 15.0 - sinking * v["P"] * v["L"]
    expected = -stiffness / (v["m"] * v["L"] ** 2)
    size = float(np.max((15.0 + v["P"] * v["L"]) / (v["m"] * v["L"] ** 2)))
    target(mbdlft.matrices_at(model, v).A[:, 1, 0], expected, CLOSED_FORM, scale=size)


def ziegler(frame: str) -> mbdlft.LFTModel:
    """Two rods with masses 2 m and m at their ends, springs of 1 N m/rad, a load along the last rod."""
    rod = {"ports": {"foot": (0, 0, "-L")}}
    return mbdlft.to_lft(
        mbdlft.Scene(
            name="ziegler",
            parameters=[M, LENGTH, mbdlft.Parameter("P", 2.0, low=0.5, high=3.0, unit="N")],
            bodies=[
                mbdlft.PointMass(name="a", mass="2*m", **rod),
                mbdlft.PointMass(name="b", mass="m", **rod),
            ],
            joints=[
                pin("ja", "ground", "a.foot", stiffness=1.0, preload=0),
                pin("jb", "a", "b.foot", stiffness=1.0, preload=0),
            ],
            loads=[mbdlft.Force(name="P", port="b", direction=(0, 0, -1), frame=frame, magnitude="P")],
        ),
        search=0.0,
    )


def ziegler_errors(frame: str = "body") -> None:
    """M = m L^2 [3 1; 1 1], K = [2c - PL, PL - c; -c, c] for the angles to the vertical."""
    model = ziegler(frame)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A[:, 2:, :2]
    to_vertical = np.array([[1.0, 0.0], [1.0, 1.0]])
    load, one = v["P"] * v["L"], np.ones(len(A))
    K = np.moveaxis(np.array([[2 - load, load - 1], [-one, one]]), 2, 0)
    mass = (v["m"] * v["L"] ** 2)[:, None, None] * np.array([[3.0, 1.0], [1.0, 1.0]])
    expected = -np.linalg.inv(to_vertical) @ np.linalg.solve(mass, K) @ to_vertical
    target(A, expected, CLOSED_FORM)


def test_column_of_ziegler() -> None:
    ziegler_errors()


def test_flutter_load_of_the_column_of_ziegler() -> None:
    """P L/c = 7/2 - sqrt(2) = 2.086: the discriminant of the frequencies vanishes there."""
    model = ziegler("body")
    loads = np.linspace(2.0, 2.2, 41)
    A = mbdlft.matrices_at(model, {"m": np.full(41, 2.0), "L": np.ones(41), "P": loads}).A
    square = A[:, 2:, :2]
    discriminant = np.trace(square, axis1=1, axis2=2) ** 2 - 4 * np.linalg.det(square)
    polynomial = np.polynomial.Polynomial.fit(loads, discriminant, 2)
    flutter = min(polynomial.roots().real)
    published(round(flutter, 3), "2.086")
    target(flutter, 3.5 - np.sqrt(2.0), CLOSED_FORM)
