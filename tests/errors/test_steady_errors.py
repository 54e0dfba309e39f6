"""Messages of joints that turn at a steady rate: what would be periodic is refused by name."""

import pytest

import mbdlft
from mbdlft import Inertia, Loop, Parameter, Revolute, RigidBody, Rotation, Scene
from mbdlft.base.errors import SceneError, TrimError
from tests.close import CLOSED_FORM, target

ROUND = {"xx": 0.1, "yy": 0.1, "zz": 0.15}


def scene(joint: dict | None = None, more: tuple = (), joints: tuple = (), **body) -> Scene:
    fields = {"mass": 2.0, "inertia": Inertia(**ROUND), **body}
    fields["ports"] = {"top": (0, 0, 0.2), "rim": (0.3, 0, 0)}
    hub = RigidBody(name="hub", mass=9.0, inertia=Inertia(xx=1, yy=1, zz=1))
    wheel = {"name": "wheel", "parent": "hub", "child": "rotor", "axis": (0, 0, 1), "rate": "W"}
    return Scene(
        name="rotor",
        parameters=[
            Parameter("W", 100.0, percent=20, unit="rad/s"),
            Parameter("J", 0.1, percent=20, unit="kg m^2"),
        ],
        bodies=[hub, RigidBody(name="rotor", **fields), *more],
        joints=[
            mbdlft.Spherical(name="ball", parent="ground", child="hub"),
            Revolute(**{**wheel, **(joint or {})}),
            *joints,
        ],
    )


def refused(given: Scene, *words: str) -> None:
    with pytest.raises(SceneError) as caught:
        mbdlft.assemble(given)
    for word in words:
        assert word in str(caught.value)


def test_the_plain_one_is_a_scene() -> None:
    assert mbdlft.assemble(scene()).ignorable == (3,)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({"center_of_mass": (0.001, 0, 0)}, "first moment about the axis (kg m) 0.002"),
        (
            {"inertia": Inertia(xx=0.1, yy=0.11, zz=0.15)},
            "difference of the moments across the axis (kg m^2) 0.01",
        ),
        (
            {"inertia": Inertia(xx="J", yy=0.1, zz=0.15)},
            "difference of the moments across the axis (kg m^2) 0.0",
        ),
        (
            {"inertia": Inertia(**ROUND, xy=0.02)},
            "product of inertia across the axis (kg m^2) 0.02",
        ),
        (
            {"inertia": Inertia(**ROUND, yz=0.03)},
            "products of inertia with the axis (kg m^2) 0.03",
        ),
    ],
)
def test_asymmetry_says_what_and_by_how_much(body: dict, words: str) -> None:
    refused(scene(**body), "joint 'wheel'", "not symmetric", words, "periodic", "imbalance")


def test_symmetry_is_exact_not_nearly() -> None:
    """A part in 1e15 of asymmetry is one; what cancels exactly is none."""
    refused(scene(inertia=Inertia(xx=0.1, yy=0.100000000000001, zz=0.15)), "not symmetric")
    third = Inertia(xx="J/3 + J/7", yy="10*J/21", zz="0.9*J")
    assert mbdlft.assemble(scene(inertia=third))


@pytest.mark.parametrize(
    ("field", "value"), [("position", 0.1), ("stiffness", 3.0), ("stiffness", "W")]
)
def test_position_and_stiffness_are_refused(field: str, value: float | str) -> None:
    with pytest.raises(SceneError, match=f"joint 'wheel': {field}: a joint that turns at a steady"):
        scene({field: value})


def other(name: str = "other", **fields) -> RigidBody:
    return RigidBody(name=name, mass=1.0, inertia=Inertia(**ROUND), **fields)


def test_what_moves_on_a_rotor_moves_along_its_axis() -> None:
    tilted = {"name": "tilt", "parent": "rotor", "child": "other"}
    words = ("joint 'tilt'", "joint 'wheel' turns", "not the same line", "periodic")
    refused(scene(more=(other(),), joints=(Revolute(**tilted, axis=(1, 0, 0)),)), *words)
    aside = {**tilted, "parent": "rotor.rim"}
    refused(scene(more=(other(),), joints=(Revolute(**aside, axis=(0, 0, 1)),)), *words)
    turned = Revolute(
        **tilted, axis=(0, 0, 1), orientation=[Rotation(axis=(1, 0, 0), angle="1*deg")]
    )
    refused(scene(more=(other(),), joints=(turned,)), *words)
    ball = mbdlft.Spherical(**tilted)
    refused(scene(more=(other(),), joints=(ball,)), *words)
    twice = Revolute(**tilted, axis=(0, 0, 1), rate=3.0)
    refused(scene(more=(other(),), joints=(twice,)), "turns steadily already", "total rate")


def test_elastic_bodies_are_refused() -> None:
    section = {"length": 1.0, "density": 1.0, "area": 1.0, "modulus": 1.0, "I_z": 1.0}
    beam = mbdlft.Beam(name="blade", deformations=["bending_y"], **section)
    weld = mbdlft.Fixed(name="root", parent="rotor", child="blade")
    refused(scene(more=(beam,), joints=(weld,)), "body 'blade'", "'beam'", "periodic")


@pytest.mark.parametrize(
    ("load", "words"),
    [
        (
            mbdlft.Force(name="f", port="rotor.rim", direction=(0, 0, 1), magnitude=1.0),
            "'rotor.rim', which is not on the axis",
        ),
        (
            mbdlft.Force(name="f", port="rotor.top", direction=(0, 1, 1), magnitude=1.0),
            "in a direction that turns with the body",
        ),
        (
            mbdlft.Torque(name="f", port="rotor", direction=(0, 1, 0), magnitude=1.0),
            "in a direction that turns with the body",
        ),
        (
            mbdlft.Spring(name="f", parent="ground", child="rotor.rim", force_density=1.0),
            "not on the axis",
        ),
    ],
)
def test_loads_that_turn_are_refused(load, words: str) -> None:
    refused(scene().model_copy(update={"loads": (load,)}), "load 'f'", "'wheel'", words)


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (mbdlft.Gyro(name="s", port="rotor"), "body 'rotor' is turned"),
        (mbdlft.Position(name="s", port="rotor.rim"), "a port on the axis"),
        (mbdlft.Position(name="s", port="hub", frame="rotor"), "frame 'rotor' turns"),
        (mbdlft.JointWrench(name="s", joint="weld"), "joint 'weld' turns"),
    ],
)
def test_sensors_that_turn_are_refused(sensor, words: str) -> None:
    given = scene(
        more=(other(),), joints=(mbdlft.Fixed(name="weld", parent="rotor", child="other"),)
    )
    refused(given.model_copy(update={"sensors": (sensor,)}), "sensor 's'", words, "periodic")


@pytest.mark.parametrize(
    "loop",
    [
        Loop(name="l", kind="fixed", parent="ground", child="rotor"),
        Loop(name="l", kind="spherical", parent="ground", child="rotor.rim"),
        Loop(name="l", kind="revolute", parent="ground", child="rotor", axis=(1, 0, 0)),
    ],
)
def test_loops_that_hold_a_rotor_are_refused(loop: Loop) -> None:
    refused(scene().model_copy(update={"loops": (loop,)}), "loop 'l'", "second bearing")


def test_missing_moments_are_asked_for_where_they_are_felt() -> None:
    refused(scene(inertia=Inertia(xx=0.1, yy=0.1)), "body 'rotor'", "inertia.zz: needed")
    refused(scene(inertia=Inertia(xx=0.1, zz=0.1)), "unknown without rotor.inertia.yy")
    plain = scene(inertia=Inertia(zz=0.1))
    hinge = Revolute(name="ball", parent="ground", child="hub", axis=(0, 0, 1))
    assert mbdlft.assemble(plain.model_copy(update={"joints": (hinge, plain.joints[1])}))


def test_a_rotor_has_no_position_to_be_found() -> None:
    with pytest.raises(TrimError, match="'wheel' turns at a steady rate, so it has no position"):
        mbdlft.find_equilibrium(scene(), positions=["wheel"])


def test_friction_without_a_motor_is_no_equilibrium() -> None:
    """A free wheel with friction does not keep its rate."""
    with pytest.raises(TrimError, match=r"wheel.torque misses 0\.5 N m"):
        mbdlft.to_lft(scene({"preload": 0.0, "damping": 0.005}))
    point = mbdlft.find_equilibrium(scene({"damping": 0.005}))
    target(point.efforts["wheel.torque"], 0.5, CLOSED_FORM)
