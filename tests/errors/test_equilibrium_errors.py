"""Errors of springs, loads, spin, closures, imposed joints and of scenes without an equilibrium."""

from typing import Any

import numpy as np

import mbdlft
from tests import kit
from tests.errors.scenes import cart
from tests.errors.table import refused

OMEGA = mbdlft.Parameter("omega", 2.0, percent=50, unit="rad/s")


def link(name: str, length: float | str = 1.0) -> mbdlft.RigidBody:
    return kit.body(
        name, 1.0, (0.1, 0.1, 0.1), center_of_mass=(0.0, 0.5, 0.0), ports={"tip": (0.0, length, 0.0)}
    )


def hinge(name: str, parent: str, child: str, position: float | str = 0.0, **fields: Any):
    return kit.hinge(name, parent, child, (1, 0, 0), position=position, **fields)


def four_bar(
    coupler: float | str = 1.0, angle: float | str = "th", loop: Any = (), **fields: Any
) -> mbdlft.Scene:
    """A parallelogram between two pivots 1 m apart on the ground, in the plane across x."""
    pin = {"kind": "revolute", "axis": (1, 0, 0), "parent": "coupler.tip", "child": "right.tip"}
    scene = kit.scene(
        "four",
        mbdlft.Angle("th", 30.0, low=10.0, high=80.0),
        mbdlft.Ground(ports={"pivot": (0, 1, 0)}),
        *(link("left"), link("coupler", coupler), link("right")),
        hinge("jl", "ground", "left", angle),
        hinge("jc", "left.tip", "coupler", f"-({angle})", preload=0),
        hinge("jr", "ground.pivot", "right", angle, preload=0),
        kit.loop("pin", **{**pin, **dict(loop)}),
        gravity=(0, 0, -9.81),
    )
    return kit.changed(scene, **fields)


def stayed(port: tuple[Any, ...] = (0, 2, 1), **fields: Any) -> mbdlft.Scene:
    """A link on a hinge, held by a spring between its tip and a wall."""
    return kit.scene(
        "stayed",
        mbdlft.Parameter("L", 1.0, percent=10, unit="m"),
        mbdlft.Ground(ports={"wall": port}),
        link("arm", "L"),
        hinge("j", "ground", "arm"),
        kit.spring("s", **{"parent": "arm.tip", "child": "ground.wall", **fields}),
    )


test_messages = refused(
    r"""
assemble(stayed((0, 0, 0), parent="arm", rest_length=1.0, stiffness=5.0))
    => load 's': its ports are at one point, so it has no direction.
assemble(stayed(rest_length=1.0, stiffness=5.0))
    => NotRationalError: load 's': the distance of its ports depends on parameters … force_density
        (N/m), or leave both out and let the trim solve for it.
stayed(rest_length=1.0, force_density=2.0) => load 's' … give rest_length or force_density, not both
assemble(stayed(child="ground.wal")) => load 's' … unknown port 'wal'. Did you mean 'wall'?
assemble(stayed(parent="amr.tip")) => load 's' … unknown body 'amr'. Did you mean 'arm'?
assemble(cart(sensors=[Position(name='p', port='cart', frame='cat')]))
    => sensor 'p', frame: unknown body 'cat'. Did you mean 'cart'? Existing: cart,
assemble(cart(sensors=[Position(name="p", port="cart.tip")]))
    => sensor 'p' … unknown port 'tip'. Existing: origin.
Spin(axis=(0, 0, 0), rate=1.0) => spin: axis has zero length, got [0.0, 0.0, 0.0].
Rotation(axis=(0, 0, 0), angle=1.0) => orientation: axis has zero length
Strut(name="s", parent="a", child="b", direction=(0, 0, 0)) => direction has zero length
assemble(cart(spin=Spin(axis=(1, 0, 0), rate='m'), parameters=[Parameter('m', 1, percent=10, unit='kg')]))
    => spin.rate … rad/s
assemble(four_bar()) => accepted
to_lft(four_bar(outputs=["pin.force.x"])) => unknown signal 'pin.force.x' … kind joint_wrench
assemble(four_bar(coupler=1.2))
    => loop 'pin': the ports 'coupler.tip' and 'right.tip' do not meet: they are 0.2 m apart … Correct
        the positions of the joints
assemble(four_bar(coupler='L', parameters=[Angle('th', 30.0, low=10.0, high=80.0), Parameter('L', 1.0,
    percent=10, unit='m')]))
    =~ 0\.0\d+ m apart at L = 0\.9\d* m, th = .* deg, at \[(.*)\] and \[(?!\1\]).*fit_positions
assemble(four_bar(angle=0.0, parameters=[]))
    => scene 'four': the equilibrium is a singular position of the loops pin: 1
assemble(four_bar(parameters=[Angle('th', 0.0, low=-10.0, high=10.0)]))
    => scene 'four' … loops pin … singular position … narrow the ranges.
# both sides are there at first, the bars at 30 deg
assemble(four_bar(loop={"axis": (0, 1, 0)}))
    => loop 'pin': a direction that it holds is not the same in … 0.524 rad at nominal
assemble(four_bar(loop={"kind": "fixed", "axis": None}))
    => loop 'pin': a direction that it holds is not the same in … rad
to_lft(cart(gravity=(0, -9.81, 0), joint={'preload': 0}), search=0.0)
    => TrimError: scene 'cart_on_rail': no equilibrium: rail.force misses 19.62 N, and nothing is
        unknown.
to_lft(kit.scene("rocket", Parameter("m", 2.0, percent=50, unit="kg"), kit.body("hull", "m", (1, 1, 1)),
    kit.free("base", "ground", "hull"), kit.force("thrust", "hull", (1, 0, 0)), gravity=(0, 0, -10.0)),
    search=0.0)
    => TrimError: scene 'rocket': no equilibrium at m = … base.force.z misses … N with the trim unknowns
        thrust.force
to_lft(cart(loads=[Force(name='push', port='cart', direction=(0, 1, 0))]), search=0.0)
    => TrimError: does not determine the trim unknowns rail.force, push.force: they are redundant, 1 too
        many. … Give a value to that many of them
# a spring of which the line meets the axis of a hinge, is in one plane with it, or does neither
to_lft(stayed({(0, -1, 0)|(2, 3, 0)}), search=0.0)
    => TrimError: scene 'stayed': the equilibrium does not determine s.force_density, which moves nothing
        at nominal, as a spring … whose line meets the axis of a hinge … Give it a value
to_lft(stayed(), search=0.0) => TrimError: j.torque, s.force_density: they are redundant
to_lft(four_bar(joints=[hinge(j.name, j.parent, j.child, j.position) for j in four_bar().joints]),
    search=0.0)
    => TrimError: scene 'four' … they are redundant, 2 too many.
cart(gravity=(0, -9.81, 0), joint={"imposed": True, "preload": 3.0})
    => joint 'rail': an imposed joint … no preload, got 3.0.
assemble(cart(gravity=(0, -9.81, 0), joint={"imposed": True})) => accepted
to_lft(cart(joint={'imposed': True}, inputs=['rail.force']), search=0.0)
    => unknown signal 'rail.force'. … rail.acceleration
> to_lft(stayed((0, 0, 0), parent="arm", stiffness=5.0, **{}), search=0.0) => SceneError: load 's': its
    ports are at one point
{"force_density": 2.0}
{}
> Force(name="f", port="arm", direction=(1, 0, 0), frame={}) => SceneError: load 'f' … frame: expected
    'body' … or 'ground' …
"world" => 'world'
"arm" => 'arm'
> assemble(cart(gravity={}, spin=Spin(axis=(1, 0, 0), rate='omega'), parameters=[OMEGA],
    constants={'nudge': Constant(value=1e-06, unit='m/s')})) => SceneError: scene 'cart_on_rail':
    gravity has … m/s^2 across the axis of the spin [1.0, 0.0, 0.0]. … no steady equilibrium … Expected
    gravity along the axis, or zero.
(0, 0, -9.81)
(0.0, "nudge*omega", 0.0)
(3, 0, 1)
> (lambda gravity, rate: assemble(cart(gravity=gravity, spin=Spin(axis=(1, 0, 0), rate=rate),
    parameters=[OMEGA])))({}) => SceneError:
({-9.81|0}, 0, 0), "omega" => accepted
(0, 0, -9.81), 0.0 => accepted
> four_bar(loop={}) => SceneError: loop 'pin' …
{"axis": None} => a closure of the kind 'revolute' needs axis
{"kind": "spherical"}
    => a closure of the kind 'spherical' has no axis; cylindrical, prismatic, revolute have
{"kind": "revolut"} => unknown kind 'revolut'. Did you mean 'revolute'?
{"axis": (0, 0, 0)} => axis has zero length
> assemble(four_bar(loop={})) => SceneError: loop 'pin' …
{"parent": "coupler.top"} => unknown port 'top'. Did you mean 'tip'?
{"child": "rihgt.tip"} => unknown body 'rihgt'. Did you mean 'right'?
"""
)


def test_trim_of_a_held_joint_is_its_weight():
    model = mbdlft.to_lft(cart(gravity=(0, -9.81, 0)), search=0.0)
    assert np.sign(mbdlft.trim_at(model, {})) == 1.0
    assert mbdlft.solve_trim(mbdlft.assemble(cart(gravity=(0, -9.81, 0)))).signals[0].name == "rail.force"


def test_imposed_prismatic_is_driven():
    scene = kit.scene("driven", link("arm"), kit.rail("x", "ground", "arm", (0, 1, 0), imposed=True))
    assert [s.name for s in mbdlft.to_lft(scene, search=0.0).inputs] == ["x.acceleration"]
