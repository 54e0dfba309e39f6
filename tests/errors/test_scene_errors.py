"""Errors of the description of a scene: fields, names, joints and the tree."""

import pytest

import mbdlft
from mbdlft import (
    Angle,
    Beam,
    Constant,
    Fixed,
    Free,
    Ground,
    Inertia,
    Mode,
    Parameter,
    PointMass,
    Prismatic,
    Revolute,
    RigidBody,
    Scene,
    SceneError,
    Universal,
    assemble,
    scene_to_toml,
    to_lft,
)
from tests.errors.scenes import arm, cart, says

M = Parameter("m", 1.0, percent=10, unit="kg")


def ball(name: str) -> PointMass:
    return PointMass(name=name, mass=1.0)


def rail(name: str, parent: str, child: str) -> Prismatic:
    return Prismatic(name=name, parent=parent, child=child, axis=(1, 0, 0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PointMass(name="b", mas=1.0, mass=1.0), "unknown key 'mas'. Did you mean 'mass'?"),
        (lambda: PointMass(name="b"), "'mass' is missing."),
        (
            lambda: PointMass(name="b", mass=float("nan")),
            "mass: expected a finite number or an expression, got nan.",
        ),
        (
            lambda: PointMass(name="b", mass=True),
            "mass: expected a finite number or an expression, got True.",
        ),
        (
            lambda: PointMass(name="b", mass=""),
            "mass: expected a finite number or an expression, got ''.",
        ),
        (
            lambda: RigidBody(name="b", mass=1, center_of_mass=[0, 1]),
            "center_of_mass: expected three numbers or expressions, got [0, 1].",
        ),
        (
            lambda: RigidBody(name="b", mass=1, ports={"tip": (0, 1)}),
            "ports: expected a table of positions, three numbers or expressions each, got",
        ),
        (
            lambda: Free(name="j", parent="ground", child="b", stiffness=[1, 2, 3]),
            "stiffness: expected a list of 6 numbers or expressions, got [1, 2, 3].",
        ),
        (
            lambda: Mode(frequency=3.0, damping=0.01, participation=[0, 0, 4, -17, 0]),
            "participation: expected a list of 6 numbers or expressions, got [0, 0, 4, -17, 0].",
        ),
        (
            lambda: Beam(name="b", length=1, density=1, area=1, elements=0),
            "elements: expected a whole number of at least 1, got 0.",
        ),
        (
            lambda: Universal(
                name="j", parent="ground", child="b", axis1=(2, 0, 0), axis2=(-1, 0, 0)
            ),
            "axis1 [2.0, 0.0, 0.0] and axis2 [-1.0, 0.0, 0.0] are parallel, which is one rotation. ",
        ),
        (lambda: PointMass(name=3, mass=1.0), "name: expected a text, got 3."),
        (
            lambda: Inertia(xw=1.0),
            "inertia: unknown key 'xw'. Did you mean 'xz'? "
            "Existing: about, unchecked, xx, xy, xz, yy, yz, zz.",
        ),
        (
            lambda: Inertia(unchecked="perhaps"),
            "inertia: unchecked: expected true or false, got 'perhaps'.",
        ),
        (
            lambda: Inertia(xx=[1]),
            "inertia: xx: expected a finite number or an expression, got [1].",
        ),
        (
            lambda: Revolute(name="j", parent="ground", child="b", axis=("L", 0, 0)),
            "axis: expected three numbers, got ('L', 0, 0).",
        ),
        (lambda: Revolute(name="j", parent="ground", axis=(1, 0, 0)), "'child' is missing."),
        (
            lambda: Scene(name="s", gravity=(0, 0)),
            "scene 's': gravity: expected three numbers or expressions, got (0, 0).",
        ),
        (lambda: Scene(gravity=(0, 0, 0)), "scene '': 'name' is missing."),
        (lambda: Scene(name=5), "scene 5: name: expected a text, got 5."),
        (
            lambda: Scene(name="s", gravitation=(0, 0, 0)),
            "scene 's': unknown key 'gravitation'. Did you mean 'gravity'?",
        ),
        (
            lambda: Scene(name="s", inputs=[]),
            "scene 's': inputs: expected a list of signal names, got [].",
        ),
        (
            lambda: Scene(name="s", outputs="j.angle"),
            "scene 's': outputs: expected a list of signal names, got 'j.angle'.",
        ),
    ],
)
def test_field(make, message):
    with says(SceneError, message):
        make()


def test_all_wrong_fields_in_one_message():
    with says(SceneError, "'mass' is missing.\n", "unknown key 'weight'."):
        PointMass(name="b", weight=1.0)


@pytest.mark.parametrize("kind", [Revolute, Prismatic, Fixed])
def test_zero_axis_names_the_joint(kind):
    with says(
        SceneError, "axis has zero length, got [0.0, 0.0, 0.0]. Give a direction; its length"
    ):
        kind(name="hinge", parent="ground", child="b", axis=(0, 0, 0))
    with says(SceneError, "'hinge'"):
        kind(name="hinge", parent="ground", child="b", axis=(0, 0, 0))


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (lambda: RigidBody(name="b"), "body"),
        (lambda: PointMass(name="b"), "body"),
        (lambda: Revolute(name="b"), "joint"),
        (lambda: Prismatic(name="b"), "joint"),
    ],
)
def test_messages_name_things_as_the_other_messages_do(make, kind):
    with pytest.raises(SceneError, match=f"^{kind} 'b'"):
        make()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"parameters": [M, M]}, "parameter or constant 'm' is given twice."),
        ({"parameters": [M], "constants": {"m": 1.0}}, "parameter or constant 'm' is given twice."),
        ({"bodies": [ball("b"), ball("b")]}, "body 'b' is given twice."),
        ({"joints": [rail("j", "ground", "b")] * 2}, "joint 'j' is given twice."),
        ({"inputs": ["j.force", "j.force"]}, "input 'j.force' is given twice."),
        ({"outputs": ["j.rate", "j.rate"]}, "output 'j.rate' is given twice."),
        (
            {"constants": {"pi": 3.0}},
            "'pi' cannot name a parameter or constant. Use letters, digits and underscores, and none "
            "of atan, cos, deg, pi, sin, sqrt.",
        ),
        ({"parameters": [Parameter("sin", 1, percent=10)]}, "'sin' cannot name a parameter"),
        ({"constants": {"2a": 3.0}}, "'2a' cannot name a parameter or constant."),
        (
            {"bodies": [ball("b.c")]},
            "the name 'b.c' has a dot; dots separate a body from its port and a joint from its "
            "signals.",
        ),
        ({"joints": [rail("j.k", "ground", "b")]}, "the name 'j.k' has a dot;"),
    ],
)
def test_names(fields, message):
    with says(SceneError, f"scene 's': {message}"):
        Scene(name="s", **fields)


@pytest.mark.parametrize(
    ("bodies", "joints", "message"),
    [
        (
            ["link"],
            [rail("j", "ground", "lnk")],
            "joint 'j', child: unknown body 'lnk'. Did you mean 'link'? Existing: ground, link.",
        ),
        (
            ["link"],
            [rail("j", "groud", "link")],
            "joint 'j', parent: unknown body 'groud'. Did you mean 'ground'?",
        ),
        (
            ["link"],
            [rail("j", "ground", "link.tip")],
            "joint 'j', child: body 'link': unknown port 'tip'. Existing: origin.",
        ),
        (
            ["link"],
            [rail("j", "ground.orgin", "link")],
            "joint 'j', parent: body 'ground': unknown port 'orgin'. Did you mean 'origin'?",
        ),
        (
            ["link"],
            [rail("j", "link", "ground")],
            "joint 'j': the ground cannot be a child. Exchange parent and child.",
        ),
        (
            ["a", "b"],
            [rail("i", "ground", "a"), rail("j", "ground", "b"), rail("k", "a", "b")],
            "body 'b' has two parents: it is the child of joints 'j' and 'k'. Joints make a "
            "tree: write one of them under 'loops' instead",
        ),
        (
            ["a", "b", "c"],
            [rail("i", "c", "a"), rail("j", "a", "b"), rail("k", "b", "c")],
            "scene 's': the joints close a loop: a -> c -> b -> a. Joints make a tree on the ground; "
            "write one of them under 'loops' instead, as its closure.",
        ),
        (
            ["top", "a", "b"],
            [rail("i", "b", "a"), rail("j", "a", "b"), rail("k", "a", "top")],
            "scene 's': the joints close a loop: a -> b -> a.",
        ),
        (["a"], [rail("i", "a", "a")], "scene 's': the joints close a loop: a -> a."),
        (
            ["a", "b", "c"],
            [rail("i", "ground", "a"), rail("j", "b", "c")],
            "scene 's': not connected to the ground: b, c. Add a joint with parent = 'ground' or "
            "another connected body.",
        ),
        (["a"], [], "scene 's': not connected to the ground: a."),
        ([], [], "scene 's': there is no joint on the ground, so nothing moves."),
        (
            ["a"],
            [Fixed(name="j", parent="ground", child="a")],
            "scene 's': all joints are fixed, so nothing moves.",
        ),
    ],
)
def test_tree(bodies, joints, message):
    with says(SceneError, message):
        assemble(Scene(name="s", bodies=[ball(name) for name in bodies], joints=joints))


def test_tree_with_the_wrong_joint_exchanged_is_accepted():
    joints = [rail("i", "ground", "c"), rail("j", "a", "b"), rail("k", "c", "a")]
    assemble(Scene(name="s", bodies=[ball(name) for name in "abc"], joints=joints))


def test_port_of_a_body_did_you_mean():
    with says(
        SceneError,
        "joint 'elbow', parent: body 'link1': unknown port 'tp'. Did you mean 'tip'? "
        "Existing: center_of_mass, origin, tip.",
    ):
        arm('parent = "link1.tip"', 'parent = "link1.tp"')


@pytest.mark.parametrize(
    ("what", "name", "message"),
    [
        ("inputs", "rail.forse", "unknown signal 'rail.forse'. Did you mean 'rail.force'?"),
        ("outputs", "rail.positon", "unknown signal 'rail.positon'. Did you mean 'rail.position'?"),
        ("outputs", "cart.position", "unknown signal 'cart.position'."),
    ],
)
def test_signal(what, name, message):
    with says(SceneError, f"scene 'cart_on_rail', {what}: {message}"):
        to_lft(cart(2.0, **{what: [name]}), search=0.0)


def test_point_of_the_inertia():
    with says(SceneError, "body 'link2'", "inertia.about: unknown port 'tpi'. Did you mean 'tip'?"):
        arm("inertia = { xx = 0.1 }", 'inertia = { xx = 0.1, about = "tpi" }')


@pytest.mark.parametrize("port", ["origin", "center_of_mass"])
def test_port_with_the_name_of_a_built_in_one(port):
    with says(SceneError, "body 'link2'", f"'{port}'"):
        arm('ports.tip = [0, "L2', f'ports.{port} = [1, 2, 3]\nports.tip = [0, "L2')


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name = "two_link_arm"', 'name = "a\\u0000"'),
        ("[bodies.link2]", '[bodies."a\\u0000"]'),
        ("[joints.shoulder]", '[joints."a\\u0000"]'),
        ('outputs = ["shoulder.angle"', 'outputs = ["a\\u0000"'),
        ("ports.tip =", 'ports."a\\u0000" ='),
        (
            '"Two-link robotic arm with a load at its tip, scheduled on both joint angles"',
            '"a\\u0000"',
        ),
    ],
)
def test_control_character(old, new):
    with says(SceneError, r"'a\x00' has the character '\x00', which cannot be printed and stored."):
        arm(old, new)


def test_port_with_a_dot():
    with says(SceneError, "body 'b'", "the name of the port 'tip.x' has a dot."):
        PointMass(name="b", mass=1.0, ports={"tip.x": (0, 0, 1)})


def test_rigid_body_named_ground():
    with says(SceneError, "'ground'"):
        assemble(
            Scene(
                name="s",
                bodies=[ball("b"), RigidBody(name="ground", mass=1.0)],
                joints=[rail("j", "ground", "b")],
            )
        )


def test_ground_with_another_name():
    with says(SceneError, "'earth'", "'ground'"):
        Ground(name="earth")


def test_inertia_that_is_a_number_says_that_a_table_is_expected():
    with says(SceneError, "'b'", "inertia: expected", "xx"):
        RigidBody(name="b", mass=1.0, inertia=5.0)


@pytest.mark.parametrize("value", ["2*m", [1.0]])
def test_constant_that_is_not_a_number_is_named(value):
    with says(SceneError, "constant 'L'", "number"):
        Scene(name="s", constants={"L": value})


def test_unit_of_a_constant_names_the_constant():
    with says(SceneError, "'L'", "unknown symbol 'furlong'"):
        assemble(cart("2*L", constants={"L": Constant(value=1.0, unit="furlong")}))


def test_reference_angle_without_equal_in_degrees():
    # found by search: no double times pi/180 rounds to this number
    angle = Parameter(
        "a", 20, 10, 30, unit="deg", substitution="half-angle", reference=0.8647975870165865
    )
    with says(
        SceneError,
        "a reference angle of 0.8647975870165865 rad has no equal in the unit of its parameter; give "
        "the parameter the unit 'rad'.",
    ):
        scene_to_toml(Scene(name="s", parameters=[angle]))
    scene_to_toml(Scene(name="s", parameters=[Angle("a", 20, 10, 30, reference=49.5)]))


def test_attribute_of_the_package():
    with says(AttributeError, "module 'mbdlft' has no attribute 'to_ltf'"):
        _ = mbdlft.to_ltf
