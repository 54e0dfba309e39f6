"""Random mechanisms with rotors at steady rates: wheels, shafts with sprung discs, two bearings."""

import numpy as np

import mbdlft
from mbdlft import Inertia, Loop, Parameter, Prismatic, Revolute, RigidBody, Rotation, Scene
from tests.cross.mechanisms import closed_loop, open_tree

WHEEL = Parameter("wheel_rate", 40.0, low=-20.0, high=90.0, unit="rad/s")
AXIAL = Parameter("axial", 0.4, percent=30, unit="kg m^2")


def spinning(seed: int, base: Scene | None = None) -> Scene:
    """Rotors on a mechanism: every third one is a closed loop; odd ones stand in a frame that spins."""
    if base is None:
        base = closed_loop(seed) if seed % 3 == 2 else open_tree(seed)
    random = np.random.default_rng(7000 + seed)
    rigid = [body.name for body in base.bodies if body.kind == "rigid" and "side" in body.ports]
    bodies, joints, loads, sensors = [], [], [], []
    for k in range(1 + seed % 2):
        carrier = str(random.choice(rigid))
        name = f"w{k}"
        bodies.append(_wheel(random, name, parameters=k == 0))
        joints.append(_bearing(random, k, carrier))
        loads += _loads(name, k)
        sensors += [
            mbdlft.Position(name=f"{name}_pos", port=f"{name}.top", frame=carrier),
            mbdlft.Acceleration(name=f"{name}_acc", port=f"{name}.top"),
        ]
    more = (_disc, _halves)[seed // 2 % 2]
    extra_bodies, extra_joints = more(random)
    bodies, joints = [*bodies, *extra_bodies], [*joints, *extra_joints]
    every = [*base.joints, *joints]
    outputs = [f"{joint.name}.{m.name}" for joint in every for f in joint.freedoms for m in f.measures]
    outputs += [s.name for sensor in (*base.sensors, *sensors) for s in sensor.signals()]
    return base.model_copy(
        update={
            "name": f"spinning_{seed}",
            "parameters": (*base.parameters, WHEEL, AXIAL),
            "bodies": (*base.bodies, *bodies),
            "joints": tuple(every),
            "loads": (*base.loads, *loads),
            "sensors": (*base.sensors, *sensors),
            "inputs": None,
            "outputs": tuple(outputs),
        }
    )


def second_bearing() -> Scene:
    """A rotor between two bearings of a frame on springs: the second one closes a loop."""
    frame = RigidBody(
        name="frame",
        mass=4.0,
        inertia=Inertia(xx=0.3, yy=0.4, zz=0.5, xy=0.05),
        ports={"left": (-0.4, 0, 0.1), "right": (0.4, 0, 0.1)},
    )
    rotor = RigidBody(
        name="rotor",
        mass=2.0,
        center_of_mass=(0.5, 0, 0),
        inertia=Inertia(xx="axial", yy="0.7*axial", zz="0.7*axial"),
        ports={"end": (0.8, 0, 0)},
    )
    return Scene(
        name="second_bearing",
        gravity=(0, 1.0, -9.81),
        parameters=(WHEEL, AXIAL),
        bodies=(frame, rotor),
        joints=(
            mbdlft.Universal(
                name="table",
                parent="ground",
                child="frame",
                axis1=(0, 1, 0),
                axis2=(0, 0, 1),
                stiffness=(30.0, 40.0),
                damping=(0.3, 0.4),
            ),
            Revolute(
                name="motor",
                parent="frame.left",
                child="rotor",
                axis=(1, 0, 0),
                rate="wheel_rate",
                damping=0.02,
                actuator_inertia=0.03,
            ),
        ),
        loops=(
            Loop(
                name="bearing", kind="revolute", parent="frame.right", child="rotor.end", axis=(1, 0, 0)
            ),
        ),
        outputs=("motor.angle", "table.angle.1", "table.angle.2", "motor.acceleration"),
    )


def _wheel(random, name: str, *, parameters: bool) -> RigidBody:
    axial = "axial" if parameters else float(random.uniform(0.2, 0.6))
    across = "0.6*axial + 0.01" if parameters else 0.4
    return RigidBody(
        name=name,
        mass=float(random.uniform(0.5, 2.0)),
        center_of_mass=(0.0, 0.0, float(random.uniform(-0.3, 0.3))),
        inertia=Inertia(xx=across, yy=across, zz=axial),
        ports={"top": (0.0, 0.0, 0.35)},
    )


def _bearing(random, k: int, carrier: str) -> Revolute:
    """The rate is a parameter, or a multiple of it: two wheels may turn against each other."""
    return Revolute(
        name=f"r{k}",
        parent=f"{carrier}.side",
        child=f"w{k}",
        axis=(0, 0, 1 if k == 0 else -2),
        orientation=[Rotation(axis=tuple(random.uniform(-1, 1, 3)), angle=float(random.uniform(-2, 2)))],
        rate="wheel_rate" if k == 0 else "3.0 - 0.5*wheel_rate",
        damping=float(random.uniform(0.01, 0.1)),
        actuator_inertia=float(random.uniform(0.01, 0.1)),
    )


def _loads(name: str, k: int) -> list[mbdlft.multibody.force.Load]:
    top = f"{name}.top"
    return [
        mbdlft.Force(name=f"f{k}", port=top, direction=(0.3, -1, 0.5), frame="ground", magnitude=3.0),
        mbdlft.Force(name=f"p{k}", port=top, direction=(0, 0, 1), magnitude=-2.0),
        mbdlft.Torque(name=f"t{k}", port=name, direction=(0, 0, 1), magnitude=0.7),
        mbdlft.Torque(name=f"g{k}", port=name, direction=(1, 0, 0.2), frame="ground", magnitude=0.5),
        mbdlft.Spring(name=f"s{k}", parent=top, child="ground.wall", stiffness=20.0, force_density=1.5),
    ]


def _disc(random):
    """A disc on a twisting shaft that slides, both along the axis of the wheel, in the other sense."""
    slider = RigidBody(name="slider", mass=0.3, inertia=Inertia(xx=0.02, yy=0.02, zz=0.03))
    disc = RigidBody(
        name="disc",
        mass=0.8,
        center_of_mass=(0, 0, 0.1),
        inertia=Inertia(xx=0.2, yy=0.2, zz="0.5*axial"),
        ports={"hub": (0, 0, -0.05)},
    )
    held = {"stiffness": 15.0, "damping": 0.2}
    return [slider, disc], [
        Prismatic(name="play", parent="w0.top", child="slider", axis=(0, 0, 1), **held),
        Revolute(
            name="torsion",
            parent="slider",
            child="disc.hub",
            axis=(0, 0, -1),
            actuator_inertia=0.05,
            **held,
        ),
    ]


def _halves(random):
    """Two bodies on the wheel that are symmetric only together: at right angles to each other."""
    blades = [
        RigidBody(
            name=name,
            mass=0.5,
            center_of_mass=(x, y, 0.2),
            inertia=Inertia(xx=0.01, yy=0.02, zz=0.03, about="center_of_mass"),
        )
        for name, x, y in (("b_x", 0.3, 0), ("b_mx", 0.3, 0), ("b_y", 0.3, 0), ("b_my", 0.3, 0))
    ]
    turns = (0, 180, 90, -90)
    return blades, [
        mbdlft.Fixed(
            name=f"root{k}", parent="w0", child=blade.name, axis=(0, 0, 1), position=f"{turn}*deg"
        )
        for k, (blade, turn) in enumerate(zip(blades, turns, strict=True))
    ]
