"""Springs, axial loads and closed loops against closed forms of textbooks."""

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


# springs and loads ---------------------------------------------------------------------------


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


# closed loops --------------------------------------------------------------------------------


def test_parallelogram_is_a_pendulum() -> None:
    """A pendulum of the inertia J = Jl + Jr + mc L^2 and the moment S = ml dl + mr dr + mc L.

    J qdd = g sin(th) S q + u, held by u = g cos(th) S. The other angles are linear in that of the left
    bar, so the loads of the closure add no stiffness.
    """

    def bar(name: str, length: str, mass: float | str, center: str) -> mbdlft.RigidBody:
        return mbdlft.RigidBody(
            name=name,
            mass=mass,
            center_of_mass=(0, center, 0),
            inertia=mbdlft.Inertia(xx=0.1),
            ports={"tip": (0, length, 0)},
        )

    scene = mbdlft.Scene(
        name="parallelogram",
        gravity=(0, 0, -GRAVITY),
        parameters=[M, LENGTH, mbdlft.Angle("th", 40.0, low=15.0, high=80.0)],
        bodies=[
            mbdlft.Ground(ports={"right": (0, 1.5, 0)}),
            bar("left", "L", 1.0, "0.5*L"),
            bar("coupler", "1.5", "m", "0.6"),
            bar("right", "L", 0.7, "0.3*L"),
        ],
        joints=[
            pin("jl", "ground", "left", "th"),
            pin("jc", "left.tip", "coupler", "-th", preload=0),
            pin("jr", "ground.right", "right", "th", preload=0),
        ],
        loops=[
            mbdlft.Loop(
                name="pin", kind="revolute", parent="coupler.tip", child="right.tip", axis=(1, 0, 0)
            )
        ],
        inputs=["jl.torque"],
        outputs=["jl.angle", "jc.angle", "jr.angle"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    matrices, th, L, m = mbdlft.matrices_at(model, v), np.deg2rad(v["th"]), v["L"], v["m"]
    J = 0.2 + (0.25 + 0.7 * 0.09) * L**2 + m * L**2
    moment = (0.5 + 0.7 * 0.3 + m) * L
    target(matrices.A[:, 1, 0], GRAVITY * np.sin(th) * moment / J, CLOSED_FORM)
    target(matrices.B[:, 1, 0], 1 / J, CLOSED_FORM)
    held = [signal.name for signal in model.trim.signals].index("jl.torque")
    target(mbdlft.trim_at(model, v)[:, held], GRAVITY * np.cos(th) * moment, CLOSED_FORM)
    angles = np.broadcast_to([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]], (len(L), 3, 2))
    target(matrices.C, angles, CLOSED_FORM)


def test_slider_crank_under_load() -> None:
    """Crank and rod of length L at 60 degrees, slider at y = 2 L cos(th) under a force F and a spring.

    m y'^2 qdd + (k y'^2 - F y'') q = u,   y' = -2 L sin(th), y'' = -2 L cos(th),  u = -F y'.
    """
    rod = {"mass": 0.0, "inertia": mbdlft.Inertia(xx=0.0), "ports": {"tip": (0, "L", 0)}}
    scene = mbdlft.Scene(
        name="slider",
        parameters=[M, LENGTH, K, mbdlft.Parameter("F", 30.0, percent=60, unit="N")],
        bodies=[
            mbdlft.RigidBody(name="crank", **rod),
            mbdlft.RigidBody(name="rod", **rod),
            mbdlft.PointMass(name="slider", mass="m"),
        ],
        joints=[
            pin("jc", "ground", "crank", "60*deg"),
            pin("jr", "crank.tip", "rod", "-120*deg", preload=0),
            mbdlft.Prismatic(
                name="rail",
                parent="ground",
                child="slider",
                axis=(0, 1, 0),
                position="L",
                stiffness="k",
                preload="F",
            ),
        ],
        loops=[
            mbdlft.Loop(name="pin", kind="revolute", parent="rod.tip", child="slider", axis=(1, 0, 0))
        ],
        inputs=["jc.torque"],
        outputs=["jc.angle", "rail.position"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    assert [signal.name for signal in model.states] == ["jc.angle", "jc.rate"]
    v = values_of(model)
    matrices, m, L = mbdlft.matrices_at(model, v), v["m"], v["L"]
    slope, bend = -np.sqrt(3.0) * L, -L
    stiffness = v["k"] * slope**2 - v["F"] * bend
    target(matrices.A[:, 1, 0], -stiffness / (m * slope**2), CLOSED_FORM)
    target(matrices.B[:, 1, 0], 1 / (m * slope**2), CLOSED_FORM)
    target(matrices.C[:, 1, 0], slope, CLOSED_FORM)
    held = [signal.name for signal in model.trim.signals].index("jc.torque")
    target(mbdlft.trim_at(model, v)[:, held], -v["F"] * slope, CLOSED_FORM)
