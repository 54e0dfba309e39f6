"""Errors of the description of a scene: fields, names, joints and the tree."""

from itertools import pairwise

import mbdlft
from mbdlft import Parameter, PointMass, Prismatic
from tests.errors.scenes import arm, cart
from tests.errors.table import refused, says

M = Parameter("m", 1.0, percent=10, unit="kg")


def ball(name: str) -> PointMass:
    return PointMass(name=name, mass=1.0)


def rail(name: str, parent: str, child: str) -> Prismatic:
    return Prismatic(name=name, parent=parent, child=child, axis=(1, 0, 0))


test_messages = refused(
    r"""
PointMass(name="b", mas=1.0, mass=1.0) => unknown key 'mas'. Did you mean 'mass'?
PointMass(name="b") => 'mass' is missing.
PointMass(name="b", mass=float("nan")) => mass: expected a finite number or an expression, got nan.
PointMass(name="b", mass=True) => mass: expected a finite number or an expression, got True.
PointMass(name="b", mass="") => mass: expected a finite number or an expression, got ''.
RigidBody(name="b", mass=1, center_of_mass=[0, 1])
    => center_of_mass: expected three numbers or expressions, got [0, 1].
RigidBody(name="b", mass=1, ports={"tip": (0, 1)})
    => ports: expected a table of positions, three numbers or expressions each, got
Free(name="j", parent="ground", child="b", stiffness=[1, 2, 3])
    => stiffness: expected a list of 6 numbers or expressions, got [1, 2, 3].
Mode(frequency=3.0, damping=0.01, participation=[0, 0, 4, -17, 0])
    => participation: expected a list of 6 numbers or expressions, got [0, 0, 4, -17, 0].
Beam(name="b", length=1, density=1, area=1, elements=0)
    => elements: expected a whole number from 1 to 200, got 0.
Universal(name='j', parent='ground', child='b', axis1=(2, 0, 0), axis2=(-1, 0, 0))
    => axis1 [2.0, 0.0, 0.0] and axis2 [-1.0, 0.0, 0.0] are parallel, which is one rotation.
PointMass(name=3, mass=1.0) => name: expected a text, got 3.
Inertia(xw=1.0)
    => inertia: unknown key 'xw'. Did you mean 'xz'? Existing: about, unchecked, xx, xy, xz, yy, yz, zz.
Inertia(unchecked="perhaps") => inertia: unchecked: expected true or false, got 'perhaps'.
Inertia(xx=[1]) => inertia: xx: expected a finite number or an expression, got [1].
Revolute(name="j", parent="ground", child="b", axis=("L", 0, 0))
    => axis: expected three numbers, got ('L', 0, 0).
Revolute(name="j", parent="ground", axis=(1, 0, 0)) => 'child' is missing.
Scene(name="s", gravity=(0, 0))
    => scene 's': gravity: expected three numbers or expressions, got (0, 0).
Scene(gravity=(0, 0, 0)) => scene '': 'name' is missing.
Scene(name=5) => scene 5: name: expected a text, got 5.
Scene(name="s", gravitation=(0, 0, 0)) => scene 's': unknown key 'gravitation'. Did you mean 'gravity'?
Scene(name="s", inputs=[]) => scene 's': inputs: expected a list of at least one signal name, got [].
Scene(name="s", outputs="j.angle")
    => scene 's': outputs: expected a list of at least one signal name, got 'j.angle'.
PointMass(name="b", weight=1.0) => 'mass' is missing. … unknown key 'weight'.
{Revolute|Prismatic|Fixed}(name='hinge', parent='ground', child='b', axis=(0, 0, 0))
    => 'hinge' … axis has zero length, got [0.0, 0.0, 0.0]. Give a direction; its length
{RigidBody|PointMass}(name="b") =~ ^body 'b'
{Revolute|Prismatic}(name="b") =~ ^joint 'b'
assemble(Scene(name='s', bodies=[ball(name) for name in 'abc'], joints=[rail('i', 'ground', 'c'),
    rail('j', 'a', 'b'), rail('k', 'c', 'a')]))
    => accepted
arm('parent = "link1.tip"', 'parent = "link1.tp"')
    => joint 'elbow', parent: body 'link1': unknown port 'tp'. Did you mean 'tip'? Existing:
        center_of_mass, origin, tip.
arm("inertia = { xx = 0.1 }", 'inertia = { xx = 0.1, about = "tpi" }')
    => body 'link2' … inertia.about: unknown port 'tpi'. Did you mean 'tip'?
PointMass(name="b", mass=1.0, ports={"tip.x": (0, 0, 1)})
    => body 'b' … the name of the port 'tip.x' has a dot.
assemble(Scene(name='s', bodies=[ball('b'), RigidBody(name='ground', mass=1.0)], joints=[rail('j',
    'ground', 'b')]))
    => 'ground'
Ground(name="earth") => 'earth' … 'ground'
RigidBody(name="b", mass=1.0, inertia=5.0) => 'b' … inertia: expected … xx
assemble(cart("2*L", constants={"L": Constant(value=1.0, unit="furlong")}))
    => 'L' … unknown symbol 'furlong'
scene_to_toml(Scene(name='s', parameters=[Parameter('a', 20, 10, 30, unit='deg',
    substitution='half-angle', reference=0.8647975870165865)]))
    => a reference angle of 0.8647975870165865 rad has no equal in the unit of its parameter; give the
        parameter the unit 'rad'.
scene_to_toml(Scene(name="s", parameters=[Angle("a", 20, 10, 30, reference=49.5)])) => accepted
mbdlft.to_ltf => AttributeError: module 'mbdlft' has no attribute 'to_ltf'
> Scene(name="s", {}) => SceneError: scene 's':
parameters=[M, M] => parameter or constant 'm' is given twice.
parameters=[M], constants={"m": 1.0} => parameter or constant 'm' is given twice.
bodies=[ball("b"), ball("b")] => body 'b' is given twice.
joints=[rail("j", "ground", "b")] * 2 => joint 'j' is given twice.
inputs=["j.force", "j.force"] => input 'j.force' is given twice.
outputs=["j.rate", "j.rate"] => output 'j.rate' is given twice.
constants={"pi": 3.0}
    => 'pi' cannot name a parameter or constant. Use letters, digits and underscores, and none of atan,
        cos, deg, pi, sin, sqrt.
parameters=[Parameter("sin", 1, percent=10)] => 'sin' cannot name a parameter
constants={"2a": 3.0} => '2a' cannot name a parameter or constant.
bodies=[ball("b.c")]
    => the name 'b.c' has a dot; dots separate a body from its port and a joint from its signals.
joints=[rail("j.k", "ground", "b")] => the name 'j.k' has a dot;
> (lambda bodies, joints: assemble(Scene(name="s", bodies=[ball(name) for name in bodies],
    joints=joints)))({}) => SceneError:
["link"], [rail("j", "ground", "lnk")]
    => joint 'j', child: unknown body 'lnk'. Did you mean 'link'? Existing: ground, link.
["link"], [rail("j", "groud", "link")]
    => joint 'j', parent: unknown body 'groud'. Did you mean 'ground'?
["link"], [rail("j", "ground", "link.tip")]
    => joint 'j', child: body 'link': unknown port 'tip'. Existing: origin.
["link"], [rail("j", "ground.orgin", "link")]
    => joint 'j', parent: body 'ground': unknown port 'orgin'. Did you mean 'origin'?
["link"], [rail("j", "link", "ground")]
    => joint 'j': the ground cannot be a child. Exchange parent and child.
["a", "b"], [rail("i", "ground", "a"), rail("j", "ground", "b"), rail("k", "a", "b")]
    => body 'b' has two parents: it is the child of joints 'j' and 'k'. Joints make a tree: write one of
        them under 'loops' instead
["a", "b", "c"], [rail("i", "c", "a"), rail("j", "a", "b"), rail("k", "b", "c")]
    => scene 's': the joints close a loop: a -> c -> b -> a. Joints make a tree on the ground; write one
        of them under 'loops' instead, as its closure.
["top", "a", "b"], [rail("i", "b", "a"), rail("j", "a", "b"), rail("k", "a", "top")]
    => scene 's': the joints close a loop: a -> b -> a.
["a"], [rail("i", "a", "a")] => scene 's': the joints close a loop: a -> a.
["a", "b", "c"], [rail("i", "ground", "a"), rail("j", "b", "c")]
    => scene 's': not connected to the ground: b, c. Add a joint with parent = 'ground' or another
        connected body.
["a"], [] => scene 's': not connected to the ground: a.
[], [] => scene 's': there is no joint on the ground, so nothing moves.
["a"], [Fixed(name="j", parent="ground", child="a")]
    => scene 's': all joints are fixed, so nothing moves.
> (lambda what, name: to_lft(cart(2.0, **{what: [name]}), search=0.0))({}) => SceneError: scene
    'cart_on_rail',
"inputs", "rail.forse" => inputs: unknown signal 'rail.forse'. Did you mean 'rail.force'?
"outputs", "rail.positon" => outputs: unknown signal 'rail.positon'. Did you mean 'rail.position'?
"outputs", "cart.position" => outputs: unknown signal 'cart.position'.
> arm('ports.tip = [0, "L2', 'ports.' + {} + ' = [1, 2, 3]\nports.tip = [0, "L2')
    => SceneError: body 'link2' …
"origin" => 'origin'
"center_of_mass" => 'center_of_mass'
> arm({}) => SceneError: 'a\x00' has the character '\x00', which cannot be printed and stored.
'name = "two_link_arm"', 'name = "a\\u0000"'
"[bodies.link2]", '[bodies."a\\u0000"]'
"[joints.shoulder]", '[joints."a\\u0000"]'
'outputs = ["shoulder.angle"', 'outputs = ["a\\u0000"'
"ports.tip =", 'ports."a\\u0000" ='
'"Two-link robotic arm with a load at its tip, scheduled on both joint angles"', '"a\\u0000"'
> Scene(name="s", constants={"L": {}}) => SceneError: constant 'L' … number
"2*m"
[1.0]
"""
)


def test_too_many_joints() -> None:
    names = ["ground", *(f"b{k}" for k in range(251))]
    rails = [rail(f"j{k}", *pair) for k, pair in enumerate(pairwise(names))]
    scene = mbdlft.Scene(name="chain", bodies=[ball(name) for name in names[1:]], joints=rails)
    with says(mbdlft.SceneError, "scene 'chain': its joints have 251 freedoms. 250 take minutes"):
        mbdlft.to_lft(scene)
