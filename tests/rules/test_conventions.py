"""The drawing of conventions states what the package does, and the file is that of the script."""

import numpy as np
import pytest

import mbdlft
from docs.site import conventions
from docs.site.conventions import MOTIONS, Motion
from mbdlft import Accelerometer, Fixed, Force, Inertia, PointMass, Position, RigidBody, Scene
from mbdlft.multibody.joint import KINDS
from tests.close import CLOSED_FORM, target


def scene_of(motion: Motion) -> Scene:
    """A body on this joint alone, with a sensor at the point."""
    joint = KINDS[motion.kind](name="joint", parent="ground", child="body", **motion.axes)
    body = RigidBody(name="body", mass=2.0, inertia=Inertia(xx=1, yy=1, zz=1), ports={"p": motion.point})
    return Scene(
        name="convention", bodies=[body], joints=[joint], sensors=[Position(name="at", port="body.p")]
    )  # fmt: skip


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: f"{m.kind}-{m.output}")
def test_a_positive_coordinate_moves_the_child_as_it_is_drawn(motion: Motion) -> None:
    model = mbdlft.to_lft(scene_of(motion), search=0.0)
    state = [s.name for s in model.states].index(f"joint.{motion.output}")
    rows = [[s.name for s in model.outputs].index(f"at.{k}") for k in "xyz"]
    target(model.C_y[rows, state], motion.moves, CLOSED_FORM)
    word = "torque" if motion.output.startswith(("angle", "rotation")) else "force"
    ending = motion.output.partition(".")[1:]
    effort = [s.name for s in model.inputs].index(f"joint.{word}{''.join(ending)}")
    rate = state + len(model.states) // 2
    assert model.B_u[rate, effort] > 0.1  # a positive effort pushes its child that way


def test_products_of_inertia_are_minus_the_integral() -> None:
    """Two point masses at (a, b) and (-a, -b) feel like one body with xy = -m x y."""
    a, b, m = 0.3, 0.5, 1.5
    ports = {"one": (a, b, 0.0), "two": (-a, -b, 0.0)}
    moments = Inertia(xx=2 * m * b**2, yy=2 * m * a**2, zz=2 * m * (a**2 + b**2), xy=-2 * m * a * b)

    def matrix(body: RigidBody, *more: object) -> np.ndarray:
        parts = {"bodies": [body], "joints": []}
        for name in ports if more else ():
            parts["bodies"].append(PointMass(name=name, mass=m))
            parts["joints"].append(Fixed(name=f"to_{name}", parent=f"body.{name}", child=name))
        parts["joints"].append(
            KINDS["universal"](name="joint", parent="ground", child="body", actuator_inertia=(1, 0))
        )
        return mbdlft.to_lft(Scene(name="two", **parts), search=0.0).B_u

    one = matrix(RigidBody(name="body", mass=2 * m, inertia=moments))
    massless = RigidBody(name="body", mass=0, inertia=Inertia(xx=0, yy=0, zz=0), ports=ports)
    target(matrix(massless, "masses"), one, CLOSED_FORM)
    assert one[2, 1] > 0.1  # m a b is positive: the torques help each other


def test_loads_and_accelerometers_have_the_signs_of_the_page() -> None:
    scene = Scene(
        name="push",
        bodies=[PointMass(name="mass", mass=4.0)],
        joints=[KINDS["prismatic"](name="rail", parent="ground", child="mass", axis=(1, 0, 0))],
        loads=[Force(name="push", port="mass", direction=(1, 0, 0), magnitude=0)],
        sensors=[Accelerometer(name="felt", port="mass")],
        outputs=["felt.x"],
        inputs=["push.force"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    target(model.D_yu, [[0.25]], CLOSED_FORM)


def test_the_file_is_that_of_the_script() -> None:
    """Words and arrows; the digits of matplotlib may differ from one version to the next."""
    from xml.etree import ElementTree as ET

    texts, counts = [], []
    for text in (conventions.svg(), conventions._FILE.read_text(encoding="utf-8")):
        root = ET.fromstring(text)
        texts.append(["".join(item.itertext()) for item in root.iter("{http://www.w3.org/2000/svg}text")])
        counts.append(len(list(root.iter("{http://www.w3.org/2000/svg}path"))))
    assert texts[0] == texts[1]
    assert counts[0] == counts[1]
    assert "+angle.2" in texts[0]
