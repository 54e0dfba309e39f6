"""Flexible systems of the literature: data, published results, and scenes.

Source: J. A. Perez, PhD thesis on two-port models of flexible multibody systems (ISAE, Toulouse, 2016);
numbers of equations and tables are those of the thesis. Some of its data are printed with few digits:

* table 6.3 (rotatory spacecraft) is rounded from round imperial numbers, which reproduce table 6.4 to
  its printed digits; the density 1.3017 kg/m does so best;
* the axial stiffness of the two-link arm (table 6.5) is not printed: 1e6 N or more reproduces table 6.6;
* the stiffness of the mast (table 9.1) is not printed: 1.465e4 N m^2, from its first mode.
"""

import numpy as np

import mbdlft
from mbdlft import (
    Acceleration,
    Beam,
    Fixed,
    Force,
    Inertia,
    JointWrench,
    Parameter,
    Prismatic,
    Revolute,
    RigidBody,
    Scene,
)
from mbdlft.multibody.body import Body
from mbdlft.multibody.joint import Joint

# table 6.4 (rad/s): modes 1, 3, 5 with the hub at rest, 2, 4, 6 with the hub in motion
SPACECRAFT = {
    4: (4.3722, 7.9066, 51.4286, 52.7819, 156.4701, 157.2609),  # N = 8 unknowns, 4 elements
    9: (4.3722, 7.9066, 51.3999, 52.7525, 155.7516, 156.5407),
    14: (4.3722, 7.9066, 51.3989, 52.7515, 155.7257, 156.5147),
    50: (4.3722, 7.9066, 51.3987, 52.7513, 155.7203, 156.5094),  # the reference of the source
}
# table 6.4: assumed modes, by their number
ASSUMED = {
    5: (4.3731, 7.9084, 51.7234, 53.0829, 160.2661, 161.0962),
    10: (4.3723, 7.9070, 51.4518, 52.8066, 157.5591, 158.3683),
    15: (4.3722, 7.9067, 51.4259, 52.7797, 156.7351, 157.5382),
}
# table 6.6 (rad/s), two-port columns, by the angle of the second joint in degrees
ARM = {
    0: (8.9215, 16.6341, 101.4696, 140.2959),
    30: (8.9227, 16.4060, 101.1769, 140.2595),
    90: (8.9284, 15.7884, 100.4178, 140.1671),
}
# table 6.2: first frequency (Hz) of a clamped beam, by its length (m)
LENGTHS = {1.05: 6.708, 1.5: 3.287}
# sections 6.1.3 and 8.3: repetitions of the source
REPETITIONS = {"length": 19, "two beams": 48, "three beams": 51, "section": 71}
REPETITIONS |= {"section and length": 100, "rotatory spacecraft": 125}
VARIED = Parameter("L", 1.0, percent=50, unit="m")  # section 6.1.3
# table 9.1, section 9.2: mass (kg), center (m) and inertia (kg m^2) about the hub, modes (rad/s)
MAST_TOTAL = {"mass": 568.15, "center": 1.504, "inertia": 11294.0}
MAST = (3.89, 17.57, 53.81)

# table 6.3 in imperial units: 1 ft, 8 slug ft^2, 0.1584e10 lbf/ft^2, 4 ft, 1/8 in, 6 in, ...
HUB_RADIUS, HUB_INERTIA = 0.3048, 10.84654
DENSITY, MODULUS, LENGTH = 1.3017, 75.84233e9, 1.2192
THICKNESS, HEIGHT = 3.175e-3, 0.1524
TIP_MASS, TIP_INERTIA = 2.290382, 2.44046e-3
# table 6.1: the beam of the examples of section 6.1
STRIP = {"density": 2600.0, "modulus": 60e9, "thickness": 9.53e-3, "width": 30e-3}


def appendage(name: str, elements: int, length: float | str = LENGTH) -> Beam:
    """One appendage of the rotatory spacecraft; `density` is per length, so that the area is 1."""
    return Beam(
        name=name,
        length=length,
        density=DENSITY,
        area=1.0,
        modulus=MODULUS,
        I_z=HEIGHT * THICKNESS**3 / 12.0,
        elements=elements,
        deformations=("bending_y",),
    )


def spacecraft(elements: int, count: int = 4, *, parametric: bool = False) -> Scene:
    """Hub on a pin with four appendages; `count` = 1: one of them, with a quarter of the hub.

    Parameters: lengths and tip masses, +-30 % (section 8.3).
    """
    bodies: list[Body] = [
        RigidBody(
            name="hub",
            mass=1.0,
            inertia=Inertia(zz=HUB_INERTIA * count / 4),
            ports={
                f"p{k}": (HUB_RADIUS * (1, 0, -1, 0)[k], HUB_RADIUS * (0, 1, 0, -1)[k], 0)
                for k in range(count)
            },
        )
    ]
    joints: list[Joint] = [Revolute(name="pin", parent="ground", child="hub", axis=(0, 0, 1))]
    parameters = []
    for k in range(count):
        length: float | str = f"L{k}" if parametric else LENGTH
        mass: float | str = f"M{k}" if parametric else TIP_MASS
        if parametric:
            parameters += [
                Parameter(f"L{k}", LENGTH, percent=30, unit="m"),
                Parameter(f"M{k}", TIP_MASS, percent=30, unit="kg"),
            ]
        bodies += [
            appendage(f"beam{k}", elements, length),
            RigidBody(name=f"tip{k}", mass=mass, inertia=Inertia(zz=TIP_INERTIA)),
        ]
        joints += [
            Fixed(
                name=f"root{k}",
                parent=f"hub.p{k}",
                child=f"beam{k}",
                axis=(0, 0, 1),
                position=k * np.pi / 2,
            ),
            Fixed(name=f"end{k}", parent=f"beam{k}.tip", child=f"tip{k}"),
        ]
    return Scene(
        name=f"spacecraft_{count}_{elements}",
        parameters=parameters,
        bodies=bodies,
        joints=joints,
        inputs=("pin.torque",),
        outputs=("pin.angle",),
    )


def clamped_appendage(elements: int) -> Scene:
    """One appendage with its hub at rest."""
    scene = spacecraft(elements, 1)
    pin = scene.joints[0].model_copy(update={"imposed": True})
    return scene.model_copy(update={"joints": (pin, *scene.joints[1:]), "inputs": None})


def arm(angle: float, *, axial: bool = True) -> Scene:
    """Two flexible links on free hinges (table 6.5); the angle of the second in degrees."""
    deformations = ("bending_y", "axial") if axial else ("bending_y",)

    def link(name: str) -> Beam:
        return Beam(
            name=name,
            length=0.5,
            density=0.2,
            area=1.0,
            modulus=1e6,
            I_z=1e-6,
            elements=2,
            deformations=deformations,
        )

    def rigid(name: str, mass: float, inertia: float) -> RigidBody:
        return RigidBody(name=name, mass=mass, inertia=Inertia(zz=inertia))

    return Scene(
        name=f"flexible_arm_{angle:g}",
        bodies=[
            rigid("shoulder", 1.0, 0.1),
            link("link1"),
            rigid("elbow", 1.0, 0.1),
            link("link2"),
            rigid("payload", 0.1, 0.5e-3),
        ],
        joints=[
            Revolute(name="joint1", parent="ground", child="shoulder", axis=(0, 0, 1)),
            Fixed(name="root1", parent="shoulder", child="link1"),
            Revolute(
                name="joint2",
                parent="link1.tip",
                child="elbow",
                axis=(0, 0, 1),
                position=float(np.radians(angle)),
            ),
            Fixed(name="root2", parent="elbow", child="link2"),
            Fixed(name="grip", parent="link2.tip", child="payload"),
        ],
    )


def strip(
    name: str, length: float | str, elements: int, functions: str = "cubic", **given: float | str
) -> Beam:
    """The beam of table 6.1 with another length, or with a section `t` and `b`."""
    t, b = given.get("thickness", STRIP["thickness"]), given.get("width", STRIP["width"])
    return Beam(
        name=name,
        length=length,
        density=STRIP["density"],
        area=f"{b}*{t}",
        modulus=STRIP["modulus"],
        I_z=f"{b}*{t}^3/12",
        elements=elements,
        shape_functions=functions,
        deformations=("bending_y",),
    )


def row(name: str, beams: list[Beam], parameters: list[Parameter], *, lift: bool = True) -> Scene:
    """Beams in a row on a root whose motion is imposed: both channels of the two-port model.

    In: accelerations of the root (across, with `lift`, and angular) and a force at the tip. Out:
    acceleration of the tip, and the force (with `lift`) and torque at the root.
    """
    names = [beam.name for beam in beams]
    joints: list[Joint] = [
        Prismatic(name="lift", parent="ground", child="slider", axis=(0, 1, 0), imposed=True),
        Revolute(name="root", parent="slider", child="hub", axis=(0, 0, 1), imposed=True),
    ]
    for before, after in zip(["hub", *(f"{name}.tip" for name in names)], names, strict=False):
        joints.append(Fixed(name=f"clamp_{after}", parent=before, child=after))
    tip = f"{names[-1]}.tip"
    rigid = {"mass": 1.0, "inertia": Inertia(zz=1.0)}
    turn_in = ("root.acceleration", "push.force")
    return Scene(
        name=name,
        parameters=parameters,
        bodies=[RigidBody(name="slider", **rigid), RigidBody(name="hub", **rigid), *beams],
        joints=joints,
        loads=[Force(name="push", port=tip, direction=(0, 1, 0), magnitude=0)],
        sensors=[
            Acceleration(name="end", port=tip),
            JointWrench(name="reaction", joint=f"clamp_{names[0]}"),
        ],
        inputs=("lift.acceleration", *turn_in) if lift else turn_in,
        outputs=("end.y", "reaction.force.y", "reaction.torque.z")
        if lift
        else ("end.y", "reaction.torque.z"),
    )


def counted(name: str) -> Scene:
    """The scenes whose repetitions the source counts (`REPETITIONS`); one quintic element a beam.

    "length": angular acceleration of the root and force at the tip to acceleration of the tip and torque
    at the root; the other rows have the acceleration across and the force at the root as well.
    """
    L, quintic = VARIED, "quintic"
    t = Parameter("t", STRIP["thickness"], percent=30, unit="m")
    b = Parameter("b", STRIP["width"], percent=30, unit="m")

    def section(length: float | str) -> Beam:
        return strip("beam1", length, 1, quintic, thickness="t", width="b")

    def part(k: int, length: float | str) -> Beam:
        return strip(f"beam{k}", length, 1, quintic)

    if name == "length":
        return row("length", [part(1, "L")], [L], lift=False)
    if name == "two beams":
        return row("two_beams", [part(1, "L"), part(2, "2 - L")], [L])
    if name == "three beams":
        return row("three_beams", [part(1, "L"), part(2, 0.2), part(3, "1.8 - L")], [L])
    if name == "section":
        return row("section", [section(1.0)], [t, b])
    if name == "section and length":
        return row("section_and_length", [section("L")], [t, b, L])
    return spacecraft(3, parametric=True)


def large() -> Scene:
    """98 states, 20 parameters: the rotatory spacecraft with six elements and more that varies."""
    scene = spacecraft(6, parametric=True)
    parameters = [*scene.parameters]
    bodies: list[Body] = []
    for body in scene.bodies:
        k = body.name[-1]
        if isinstance(body, Beam):
            parameters += [
                Parameter(f"E{k}", MODULUS, percent=20, unit="Pa"),
                Parameter(f"rho{k}", DENSITY, percent=20, unit="kg m^-3"),
            ]
            body = body.model_copy(update={"modulus": f"E{k}", "density": f"rho{k}"})
        elif body.name != "hub":
            parameters.append(Parameter(f"J{k}", TIP_INERTIA, percent=20, unit="kg m^2"))
            body = body.model_copy(update={"inertia": Inertia(zz=f"J{k}")})
        bodies.append(body)
    return scene.model_copy(
        update={"name": "large", "bodies": tuple(bodies), "parameters": tuple(parameters)}
    )


def chain(fractions: list[float], elements: int) -> Scene:
    """Beams of length `fractions` in a row, clamped: example 6.1.1, section of table 6.1."""
    beams = [strip(f"beam{k}", part, elements) for k, part in enumerate(fractions)]
    scene = row("chain", beams, [])
    return scene.model_copy(update={"inputs": ("push.force",), "outputs": ("end.y",)})


def mast(elements: int = 4) -> Scene:
    """Satellite with a mast of three segments (table 9.1), free in the plane."""
    count, segment, hub = 3, 4.06, Inertia(zz=250.0, xz=0, yz=0)
    bodies: list[Body] = [RigidBody(name="hub", mass=500.0, inertia=hub, ports={"side": (1.0, 0, 0)})]
    joints: list[Joint] = [mbdlft.Planar(name="flight", parent="ground", child="hub", axis=(0, 0, 1))]
    for k in range(count):
        bodies.append(
            Beam(
                name=f"mast{k}",
                length=segment,
                density=0.5870,
                area=1.0,
                modulus=1.465e4,
                I_z=1.0,
                elements=elements,
                deformations=("bending_y",),
            )
        )
        parent = f"mast{k - 1}.tip" if k else "hub.side"
        joints.append(Fixed(name=f"latch{k}", parent=parent, child=f"mast{k}"))
    bodies.append(mbdlft.PointMass(name="payload", mass=61.0))
    joints.append(Fixed(name="grip", parent=f"mast{count - 1}.tip", child="payload"))
    return Scene(
        name="mast",
        bodies=bodies,
        joints=joints,
        sensors=[mbdlft.Momentum(name="momentum"), mbdlft.CenterOfMass(name="center")],
        outputs=("momentum.linear.y", "momentum.angular.z", "center.y"),
    )


def frequencies(model: mbdlft.LFTModel, **values: float) -> np.ndarray:
    """Frequencies (rad/s) of the modes of an undamped model, with their multiplicity, without those
    of rigid bodies."""
    found = np.abs(np.linalg.eigvals(mbdlft.matrices_at(model, values).A).imag)
    found = np.sort(found)[::2] if len(found) % 2 == 0 else np.sort(found)[1::2]
    return np.asarray(found[found > RIGID])


RIGID = 0.1  # rad/s; a slower mode is one of a rigid body


def distinct(found: np.ndarray) -> np.ndarray:
    """One frequency for each group of equal ones."""
    return found[np.append(True, np.diff(found) > EQUAL * found[1:])]


EQUAL = 1e-5
