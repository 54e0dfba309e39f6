"""Errors of springs, loads, spin, closures, imposed joints and of scenes without an equilibrium."""

from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import (
    Angle,
    Constant,
    Force,
    Free,
    Ground,
    Inertia,
    Loop,
    NotRationalError,
    Parameter,
    Position,
    Prismatic,
    Revolute,
    RigidBody,
    Rotation,
    Scene,
    SceneError,
    Spin,
    Spring,
    TrimError,
    assemble,
    solve_trim,
    to_lft,
)
from tests.errors.scenes import cart, says

OMEGA = Parameter("omega", 2.0, percent=50, unit="rad/s")


def link(name: str, length: float | str = 1.0) -> RigidBody:
    return RigidBody(
        name=name,
        mass=1.0,
        center_of_mass=(0.0, 0.5, 0.0),
        inertia=Inertia(xx=0.1, yy=0.1, zz=0.1),
        ports={"tip": (0.0, length, 0.0)},
    )


def hinge(name: str, parent: str, child: str, position: float | str = 0.0, **fields: Any):
    return Revolute(
        name=name, parent=parent, child=child, axis=(1, 0, 0), position=position, **fields
    )


def four_bar(
    coupler: float | str = 1.0,
    angle: float | str = "th",
    loop: dict[str, Any] | None = None,
    **fields: Any,
) -> Scene:
    """A parallelogram between two pivots 1 m apart on the ground, in the plane across x."""
    pin = {"kind": "revolute", "axis": (1, 0, 0), "parent": "coupler.tip", "child": "right.tip"}
    return Scene(
        **{
            "name": "four",
            "gravity": (0, 0, -9.81),
            "parameters": [Angle("th", 30.0, low=10.0, high=80.0)],
            "bodies": [
                Ground(ports={"pivot": (0, 1, 0)}),
                link("left"),
                link("coupler", coupler),
                link("right"),
            ],
            "joints": [
                hinge("jl", "ground", "left", angle),
                hinge("jc", "left.tip", "coupler", f"-({angle})", preload=0),
                hinge("jr", "ground.pivot", "right", angle, preload=0),
            ],
            "loops": [Loop(name="pin", **{**pin, **(loop or {})})],
            **fields,
        }
    )


# springs and loads ---------------------------------------------------------------------------


def stayed(port: tuple[Any, ...] = (0, 2, 1), **fields: Any) -> Scene:
    return Scene(
        name="stayed",
        parameters=[Parameter("L", 1.0, percent=10, unit="m")],
        bodies=[Ground(ports={"wall": port}), link("arm", "L")],
        joints=[hinge("j", "ground", "arm")],
        loads=[Spring(**{"name": "s", "parent": "arm.tip", "child": "ground.wall", **fields})],
    )


def test_spring_between_ports_at_one_point():
    with says(SceneError, "load 's': its ports are at one point, so it has no direction."):
        assemble(stayed((0, 0, 0), parent="arm", rest_length=1.0, stiffness=5.0))


@pytest.mark.parametrize("density", [{"force_density": 2.0}, {}])
def test_spring_between_ports_at_one_point_without_a_rest_length(density):
    with says(SceneError, "load 's': its ports are at one point"):
        to_lft(stayed((0, 0, 0), parent="arm", stiffness=5.0, **density), search=0.0)


def test_rest_length_of_a_distance_that_depends_on_parameters():
    with says(
        NotRationalError,
        "load 's': the distance of its ports depends on parameters",
        "force_density (N/m), or leave both out and let the trim solve for it.",
    ):
        assemble(stayed(rest_length=1.0, stiffness=5.0))


def test_rest_length_and_force_density():
    with says(SceneError, "load 's'", "give rest_length or force_density, not both"):
        stayed(rest_length=1.0, force_density=2.0)


def test_port_of_a_load():
    with says(SceneError, "load 's'", "unknown port 'wal'. Did you mean 'wall'?"):
        assemble(stayed(child="ground.wal"))
    with says(SceneError, "load 's'", "unknown body 'amr'. Did you mean 'arm'?"):
        assemble(stayed(parent="amr.tip"))


@pytest.mark.parametrize("frame", ["world", "arm"])
def test_frame_of_a_load(frame):
    with says(SceneError, "load 'f'", "frame: expected 'body'", "or 'ground'", repr(frame)):
        Force(name="f", port="arm", direction=(1, 0, 0), frame=frame)


def test_frame_and_port_of_a_sensor():
    sensors = [Position(name="p", port="cart", frame="cat")]
    with says(
        SceneError, "sensor 'p', frame: unknown body 'cat'. Did you mean 'cart'? Existing: cart, "
    ):
        assemble(cart(sensors=sensors))
    with says(SceneError, "sensor 'p'", "unknown port 'tip'. Existing: origin."):
        assemble(cart(sensors=[Position(name="p", port="cart.tip")]))


# spin ----------------------------------------------------------------------------------------


def test_axis_of_the_spin_without_length():
    with says(SceneError, "spin: axis has zero length, got [0.0, 0.0, 0.0]."):
        Spin(axis=(0, 0, 0), rate=1.0)


def test_rotation_axis_without_length():
    with says(SceneError, "orientation: axis has zero length"):
        Rotation(axis=(0, 0, 0), angle=1.0)


@pytest.mark.parametrize("gravity", [(0, 0, -9.81), (0.0, "nudge*omega", 0.0), (3, 0, 1)])
def test_gravity_that_turns_in_the_spinning_frame(gravity):
    nudge = Constant(value=1e-6, unit="m/s")
    spin = Spin(axis=(1, 0, 0), rate="omega")
    scene = cart(gravity=gravity, spin=spin, parameters=[OMEGA], constants={"nudge": nudge})
    with says(
        SceneError,
        "scene 'cart_on_rail': gravity has",
        "m/s^2 across the axis of the spin [1.0, 0.0, 0.0].",
        "no steady equilibrium",
        "Expected gravity along the axis, or zero.",
    ):
        assemble(scene)


@pytest.mark.parametrize(
    ("gravity", "rate"), [((-9.81, 0, 0), "omega"), ((0, 0, 0), "omega"), ((0, 0, -9.81), 0.0)]
)
def test_gravity_that_is_steady_is_accepted(gravity, rate):
    assemble(cart(gravity=gravity, spin=Spin(axis=(1, 0, 0), rate=rate), parameters=[OMEGA]))


def test_unit_of_the_spin():
    with says(SceneError, "spin.rate", "rad/s"):
        assemble(
            cart(
                spin=Spin(axis=(1, 0, 0), rate="m"),
                parameters=[Parameter("m", 1.0, percent=10, unit="kg")],
            )
        )


# closures ------------------------------------------------------------------------------------


def test_closed_loop_is_accepted():
    assemble(four_bar())


def test_ports_of_a_loop_that_do_not_meet():
    with says(
        SceneError,
        "loop 'pin': the ports 'coupler.tip' and 'right.tip' do not meet: they are 0.2 m apart",
        "Correct the positions of the joints",
    ):
        assemble(four_bar(coupler=1.2))


def test_ports_of_a_loop_that_meet_at_nominal_only():
    scene = four_bar(
        coupler="L",
        parameters=[
            Angle("th", 30.0, low=10.0, high=80.0),
            Parameter("L", 1.0, percent=10, unit="m"),
        ],
    )
    with says(SceneError, "loop 'pin': the ports", "apart at nominal or elsewhere in the range"):
        assemble(scene)


def test_singular_position_of_a_loop():
    # stretched out the parallelogram can also turn into its crossed form
    scene = four_bar(angle=0.0, parameters=[])
    with says(
        SceneError, "scene 'four': the equilibrium is a singular position of the loops pin: 1 "
    ):
        assemble(scene)
    scene = four_bar(parameters=[Angle("th", 0.0, low=-10.0, high=10.0)])
    with says(SceneError, "scene 'four'", "loops pin", "singular position", "narrow the ranges."):
        assemble(scene)


def test_directions_of_a_loop_that_are_not_parallel():
    with says(SceneError, "loop 'pin': a direction that it holds is not the same in", "rad"):
        assemble(four_bar(loop={"axis": (0, 1, 0)}))
    with says(SceneError, "loop 'pin': a direction that it holds is not the same in", "rad"):
        assemble(four_bar(loop={"kind": "fixed", "axis": None}))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"axis": None}, "a closure of the kind 'revolute' needs axis"),
        (
            {"kind": "spherical"},
            "a closure of the kind 'spherical' has no axis; cylindrical, prismatic, revolute have",
        ),
        ({"kind": "revolut"}, "unknown kind 'revolut'. Did you mean 'revolute'?"),
        ({"axis": (0, 0, 0)}, "axis has zero length"),
    ],
)
def test_fields_of_a_loop(fields, message):
    with says(SceneError, "loop 'pin'", message):
        four_bar(loop=fields)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"parent": "coupler.top"}, "unknown port 'top'. Did you mean 'tip'?"),
        ({"child": "rihgt.tip"}, "unknown body 'rihgt'. Did you mean 'right'?"),
    ],
)
def test_ports_of_a_loop(fields, message):
    with says(SceneError, "loop 'pin'", message):
        assemble(four_bar(loop=fields))


# equilibrium ---------------------------------------------------------------------------------


def test_no_equilibrium_names_the_coordinate_and_the_size():
    scene = cart(gravity=(0, -9.81, 0), joint={"preload": 0})
    with says(
        TrimError,
        "scene 'cart_on_rail': no equilibrium: rail.force misses 19.62 N, and nothing is unknown.",
    ):
        to_lft(scene, search=0.0)


def test_no_equilibrium_names_the_unknowns_and_the_point():
    scene = Scene(
        name="rocket",
        gravity=(0, 0, -10.0),
        parameters=[Parameter("m", 2.0, percent=50, unit="kg")],
        bodies=[RigidBody(name="hull", mass="m", inertia=Inertia(xx=1, yy=1, zz=1))],
        joints=[Free(name="base", parent="ground", child="hull")],
        loads=[Force(name="thrust", port="hull", direction=(1, 0, 0))],
    )
    with says(
        TrimError,
        "scene 'rocket': no equilibrium at m = ",
        "base.force.z misses",
        "N with the trim unknowns thrust.force",
    ):
        to_lft(scene, search=0.0)


def test_redundant_unknowns_of_the_trim():
    load = Force(name="push", port="cart", direction=(0, 1, 0))
    with says(
        TrimError,
        "does not determine the trim unknowns rail.force, push.force: they are redundant, 1 too many.",
        "Give a value to that many of them",
    ):
        to_lft(cart(loads=[load]), search=0.0)


def test_redundant_efforts_of_a_closed_loop():
    scene = four_bar()
    free = [hinge(j.name, j.parent, j.child, j.position) for j in scene.joints]
    with says(TrimError, "scene 'four'", "they are redundant, 2 too many."):
        to_lft(four_bar(joints=free), search=0.0)


def test_imposed_joint_has_no_effort_and_no_preload():
    with says(SceneError, "joint 'rail': an imposed joint", "no preload, got 3.0."):
        cart(gravity=(0, -9.81, 0), joint={"imposed": True, "preload": 3.0})
    assemble(cart(gravity=(0, -9.81, 0), joint={"imposed": True}))


def test_input_of_an_imposed_joint():
    scene = cart(joint={"imposed": True}, inputs=["rail.force"])
    with says(SceneError, "unknown signal 'rail.force'.", "rail.acceleration"):
        to_lft(scene, search=0.0)


def test_trim_of_a_held_joint_is_its_weight():
    model = to_lft(cart(gravity=(0, -9.81, 0)), search=0.0)
    assert np.sign(mbdlft.trim_at(model, {})) == 1.0
    assert solve_trim(assemble(cart(gravity=(0, -9.81, 0)))).signals[0].name == "rail.force"


def test_imposed_prismatic_is_driven():
    scene = Scene(
        name="driven",
        bodies=[link("arm")],
        joints=[Prismatic(name="x", parent="ground", child="arm", axis=(0, 1, 0), imposed=True)],
    )
    assert [s.name for s in to_lft(scene, search=0.0).inputs] == ["x.acceleration"]
