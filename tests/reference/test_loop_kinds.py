"""Closures: slider-crank, Cardan joint, and messages of kinds and axes."""

import numpy as np
import pytest

import mbdlft
from mbdlft import Inertia, Parameter, RigidBody, Scene
from mbdlft.base.errors import SceneError
from tests import kit
from tests.close import CLOSED_FORM, target
from tests.cross.test_mechanism import equals_truth, points_of
from tests.errors.table import refused

PISTON = Parameter("m", 0.8, percent=30, unit="kg")


def slider_crank(*, cut_at_piston: bool) -> Scene:
    """A crank of 0.3 m upright, a rod of 0.5 m to a piston at x = 0.4 m; cut at one end or the other."""
    crank = kit.body("crank", 1.0, zz=0.02, ports={"pin": (0, 0.3, 0)})
    rod = kit.body("rod", 0.5, zz=0.01, center_of_mass=(0.25, 0, 0), ports={"end": (0.5, 0, 0)})
    piston = kit.body("piston", "m", zz=0.001)
    down = [kit.turn((0, 0, 1), "-2*atan(1/3)")]  # cos 4/5, sin -3/5
    up = [kit.turn((0, 0, 1), "2*atan(1/3)")]
    joints = [
        kit.hinge("motor", "ground", "crank", (0, 0, 1)),
        kit.hinge("knee", "crank.pin", "rod", (0, 0, 1), orientation=down, preload=0),
    ]
    if cut_at_piston:
        joints += [kit.hinge("wrist", "rod.end", "piston", (0, 0, 1), orientation=up, preload=0)]
        # the bore stands at an angle to the ground, and its axis along x of that frame
        loop = kit.loop("bore", "prismatic", "ground", "piston", axis=(1, 0, 0))
    else:
        joints += [kit.rail("bore", "ground", "piston", (1, 0, 0), position=0.4, preload=0)]
        loop = kit.loop("wrist", "revolute", "piston", "rod.end", axis=(0, 0, 1), orientation=down)
    return kit.scene(
        "slider_crank",
        PISTON,
        crank,
        rod,
        piston,
        *joints,
        loop,
        mbdlft.Position(name="piston_at", port="piston"),
        gravity=(0, -9.81, 0),
        inputs=["motor.torque"],
        outputs=["motor.angle", "piston_at.x"],
    )


@pytest.mark.parametrize("cut_at_piston", [True, False])
def test_slider_crank(*, cut_at_piston: bool) -> None:
    equals_truth(slider_crank(cut_at_piston=cut_at_piston))


def cardan(kind: str) -> Scene:
    """Two shafts at the angle b, on bearings, joined by a cross whose first axis is across both."""
    b = mbdlft.Angle("b", 30.0, low=10.0, high=50.0)
    shaft = {"mass": 1.0, "inertia": Inertia(xx=1, yy=1, zz="J")}
    tilt = [kit.turn((1, 0, 0), "b")]
    axes = {"axis1": (1, 0, 0), "axis2": (0, 1, 0)}
    return kit.scene(
        "cardan",
        b,
        Parameter("J", 0.6, percent=20, unit="kg m^2"),
        kit.body("driver", 1.0, (1, 1, 0.4)),
        RigidBody(name="driven", **shaft),
        kit.hinge("motor", "ground", "driver", (0, 0, 1)),
        kit.hinge("load", "ground", "driven", (0, 0, 1), orientation=tilt, preload=0),
        kit.loop("cross", kind, "driver", "driven", **axes),
        inputs=["motor.torque"],
        outputs=["motor.rate", "load.rate"],
    )


def test_cardan_joint_is_faster_by_the_cosine() -> None:
    """With the cross across both shafts the driven one turns cos b times as fast, which is exact."""
    model = mbdlft.to_lft(cardan("universal"), search=0.0)
    assert model.certificate.minimal
    for point in points_of(cardan("universal")):
        cosine, J = np.cos(np.radians(point["b"])), point["J"]
        A, B, C, _ = mbdlft.matrices_at(model, point)
        target(B[1, 0], 1.0 / (0.4 + J * cosine**2), CLOSED_FORM)
        target(C[:, 1], [1.0, cosine], CLOSED_FORM)
        assert not A[1].any()


def test_an_equilibrium_is_found_through_a_sliding_loop() -> None:
    """The crank falls until the rod hangs: the bore is kept, and the loop closes."""
    scene = slider_crank(cut_at_piston=True)
    motor = scene.joints[0].model_copy(update={"preload": 0.0})
    scene = scene.model_copy(update={"joints": (motor, *scene.joints[1:])})
    point = mbdlft.find_equilibrium(scene)
    hanging = mbdlft.at_equilibrium(scene, point)
    assert mbdlft.assemble(hanging).degrees_of_freedom == 3
    q = point.positions["motor.angle"]
    target(abs(np.sin(q)), 0.0, CLOSED_FORM**0.5, 1.0)


test_axes_belong_to_kinds = refused(
    r"""
> kit.loop("l", parent="ground", child="b", {}) => SceneError:
kind="prismatic" => closure of the kind 'prismatic' needs axis
kind="spherical", axis=(0, 0, 1) => closure of the kind 'spherical' has no axis
kind="universal", axis1=(0, 0, 1) => kind 'universal' needs axis2
kind="universal", axis1=(0, 0, 1), axis2=(0, 0, -2) => axis1 and axis2 are parallel
kind="planar" => kind 'planar'
"""
)


def test_ports_of_what_slides_are_on_one_line() -> None:
    scene = slider_crank(cut_at_piston=True)
    aside = scene.bodies[2].model_copy(update={"ports": {"edge": (0, 0.1, 0)}})
    loop = scene.loops[0].model_copy(update={"child": "piston.edge"})
    wrong = scene.model_copy(update={"bodies": (*scene.bodies[:2], aside), "loops": (loop,)})
    with pytest.raises(SceneError, match=r"do not meet: they are 0\.1 m apart across the axis"):
        mbdlft.assemble(wrong)


def test_orientation_is_needed_where_axes_differ() -> None:
    scene = slider_crank(cut_at_piston=True)
    turned = scene.joints[2].model_copy(update={"orientation": ()})
    wrong = scene.model_copy(update={"joints": (*scene.joints[:2], turned)})
    with pytest.raises(SceneError, match="Give the loop or the joints an orientation"):
        mbdlft.assemble(wrong)


def test_loops_go_to_toml_and_back() -> None:
    for scene in (cardan("universal"), *(slider_crank(cut_at_piston=cut) for cut in (True, False))):
        assert mbdlft.scene_from_toml(mbdlft.scene_to_toml(scene)) == scene
