"""Messages of joints that turn at a steady rate: what would be periodic is refused by name."""

import mbdlft
from mbdlft import Inertia, Parameter, Revolute, RigidBody, Scene
from tests import kit
from tests.close import CLOSED_FORM, target
from tests.errors.table import refused

ROUND = {"xx": 0.1, "yy": 0.1, "zz": 0.15}


def scene(joint: dict | None = None, more: tuple = (), joints: tuple = (), **body) -> Scene:
    """A rotor that turns steadily on a hub, with more bodies and joints."""
    ports = {"top": (0, 0, 0.2), "rim": (0.3, 0, 0)}
    return kit.scene(
        "rotor",
        Parameter("W", 100.0, percent=20, unit="rad/s"),
        Parameter("J", 0.1, percent=20, unit="kg m^2"),
        kit.body("hub", 9.0, (1, 1, 1)),
        RigidBody(name="rotor", ports=ports, **{"mass": 2.0, "inertia": Inertia(**ROUND), **body}),
        *more,
        kit.ball("ball", "ground", "hub"),
        kit.hinge("wheel", "hub", "rotor", (0, 0, 1), **{"rate": "W", **(joint or {})}),
        *joints,
    )


def other() -> RigidBody:
    return RigidBody(name="other", mass=1.0, inertia=Inertia(**ROUND))


def tilt(**fields) -> Revolute:
    return Revolute(**{"name": "tilt", "parent": "rotor", "child": "other", **fields})


SECTION = {"length": 1.0, "density": 1.0, "area": 1.0, "modulus": 1.0, "I_z": 1.0}
BLADE = mbdlft.Beam(name="blade", deformations=["bending_y"], **SECTION)
welded = scene(more=(other(),), joints=(mbdlft.Fixed(name="weld", parent="rotor", child="other"),))

test_messages = refused(
    r"""
> mbdlft.assemble(scene({})) => SceneError: joint 'wheel' … not symmetric …
center_of_mass=(0.001, 0, 0) => first moment about the axis (kg m) 0.002 … periodic … imbalance
inertia=Inertia(xx=0.1, yy=0.11, zz=0.15)
    => difference of the moments across the axis (kg m^2) 0.01 … periodic … imbalance
inertia=Inertia(xx="J", yy=0.1, zz=0.15)
    => difference of the moments across the axis (kg m^2) 0.0 … periodic … imbalance
inertia=Inertia(**ROUND, xy=0.02)
    => product of inertia across the axis (kg m^2) 0.02 … periodic … imbalance
inertia=Inertia(**ROUND, yz=0.03)
    => products of inertia with the axis (kg m^2) 0.03 … periodic … imbalance
# A part in 1e15 of asymmetry is one; what cancels exactly is none.
inertia=Inertia(xx=0.1, yy=0.100000000000001, zz=0.15)
inertia=Inertia(xx="J/3 + J/7", yy="10*J/21", zz="0.9*J") => accepted
> scene({}) => SceneError:
{"position": 0.1} => joint 'wheel': position: a joint that turns at a steady
{"stiffness": 3.0} => joint 'wheel': stiffness: a joint that turns at a steady
{"stiffness": "W"} => joint 'wheel': stiffness: a joint that turns at a steady
> mbdlft.assemble(scene(more=(other(),), joints=({},))) => SceneError:
# What moves on a rotor moves along its axis.
tilt(axis=(1, 0, 0)) => joint 'tilt' … joint 'wheel' turns … not the same line … periodic
tilt(axis=(0, 0, 1), parent="rotor.rim")
    => joint 'tilt' … joint 'wheel' turns … not the same line … periodic
tilt(axis=(0, 0, 1), orientation=[Rotation(axis=(1, 0, 0), angle="1*deg")])
    => joint 'tilt' … joint 'wheel' turns … not the same line … periodic
mbdlft.Spherical(name="tilt", parent="rotor", child="other")
    => joint 'tilt' … joint 'wheel' turns … not the same line … periodic
tilt(axis=(0, 0, 1), rate=3.0) => turns steadily already … total rate
> mbdlft.assemble(scene(more=(BLADE,), joints=({},))) => SceneError: body 'blade' …
mbdlft.Fixed(name="root", parent="rotor", child="blade")
    => 'beam' … periodic … each disc on it: kind = 'revolute', axis = [0.0, 0.0, 1.0], rate = 'W'.
> mbdlft.assemble(scene().model_copy(update={"loads": ({},)})) => SceneError: load 'f' …
mbdlft.Force(name="f", port="rotor.rim", direction=(0, 0, 1), magnitude=1.0)
    => 'wheel' … 'rotor.rim', which is not on the axis
mbdlft.Force(name="f", port="rotor.top", direction=(0, 1, 1), magnitude=1.0)
    => 'wheel' … in a direction that turns with the body
mbdlft.Torque(name="f", port="rotor", direction=(0, 1, 0), magnitude=1.0)
    => 'wheel' … in a direction that turns with the body
mbdlft.Spring(name="f", parent="ground", child="rotor.rim", force_density=1.0)
    => 'wheel' … not on the axis
> mbdlft.assemble(welded.model_copy(update={"sensors": ({},)})) => SceneError: sensor 's' …
mbdlft.Gyro(name="s", port="rotor") => body 'rotor' is turned … periodic
mbdlft.Position(name="s", port="rotor.rim") => periodic … a port on the axis
mbdlft.Position(name="s", port="hub", frame="rotor") => frame 'rotor' turns … periodic
mbdlft.JointWrench(name="s", joint="weld") => joint 'weld' turns … periodic
> mbdlft.assemble(scene().model_copy(update={"loops": (Loop(name="l", parent="ground", {}),)}))
    => SceneError: loop 'l' … second bearing
kind="fixed", child="rotor"
kind="spherical", child="rotor.rim"
kind="revolute", child="rotor", axis=(1, 0, 0)
> mbdlft.assemble(scene(inertia=Inertia(xx=0.1, {}))) => SceneError:
# Moments are asked for where they are felt.
yy=0.1 => body 'rotor' … inertia.zz: needed
zz=0.1 => unknown without rotor.inertia.yy
> {} => TrimError:
mbdlft.find_equilibrium(scene(), positions=["wheel"])
    => 'wheel' turns at a steady rate, so it has no position
# A free wheel with friction does not keep its rate.
mbdlft.to_lft(scene({"preload": 0.0, "damping": 0.005})) => wheel.torque misses 0.5 N m
"""
)


def test_what_turns_steadily_is_a_scene() -> None:
    assert mbdlft.assemble(scene()).ignorable == (3,)
    plain = scene(inertia=Inertia(zz=0.1))
    hinge = Revolute(name="ball", parent="ground", child="hub", axis=(0, 0, 1))
    assert mbdlft.assemble(plain.model_copy(update={"joints": (hinge, plain.joints[1])}))
    point = mbdlft.find_equilibrium(scene({"damping": 0.005}))
    target(point.efforts["wheel.torque"], 0.5, CLOSED_FORM)
