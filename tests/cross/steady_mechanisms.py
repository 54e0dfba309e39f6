"""Random mechanisms with rotors at steady rates: wheels, shafts with sprung discs, two bearings."""

import numpy as np

import mbdlft
from mbdlft import Parameter, Revolute, RigidBody, Scene
from tests import kit
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
    frame = kit.body(
        "frame", 4.0, (0.3, 0.4, 0.5), xy=0.05, ports={"left": (-0.4, 0, 0.1), "right": (0.4, 0, 0.1)}
    )
    rotor = kit.body(
        "rotor",
        2.0,
        ("axial", "0.7*axial", "0.7*axial"),
        center_of_mass=(0.5, 0, 0),
        ports={"end": (0.8, 0, 0)},
    )
    return kit.scene(
        "second_bearing",
        WHEEL,
        AXIAL,
        frame,
        rotor,
        kit.cross(
            "table",
            "ground",
            "frame",
            axis1=(0, 1, 0),
            axis2=(0, 0, 1),
            stiffness=(30.0, 40.0),
            damping=(0.3, 0.4),
        ),
        kit.hinge(
            "motor",
            "frame.left",
            "rotor",
            (1, 0, 0),
            rate="wheel_rate",
            damping=0.02,
            actuator_inertia=0.03,
        ),
        kit.loop("bearing", "revolute", "frame.right", "rotor.end", axis=(1, 0, 0)),
        gravity=(0, 1.0, -9.81),
        outputs=("motor.angle", "table.angle.1", "table.angle.2", "motor.acceleration"),
    )


def _wheel(random, name: str, *, parameters: bool) -> RigidBody:
    axial = "axial" if parameters else float(random.uniform(0.2, 0.6))
    across = "0.6*axial + 0.01" if parameters else 0.4
    return kit.body(
        name,
        float(random.uniform(0.5, 2.0)),
        (across, across, axial),
        center_of_mass=(0.0, 0.0, float(random.uniform(-0.3, 0.3))),
        ports={"top": (0.0, 0.0, 0.35)},
    )


def _bearing(random, k: int, carrier: str) -> Revolute:
    """The rate is a parameter, or a multiple of it: two wheels may turn against each other."""
    return kit.hinge(
        f"r{k}",
        f"{carrier}.side",
        f"w{k}",
        (0, 0, 1 if k == 0 else -2),
        orientation=[kit.turn(tuple(random.uniform(-1, 1, 3)), float(random.uniform(-2, 2)))],
        rate="wheel_rate" if k == 0 else "3.0 - 0.5*wheel_rate",
        damping=float(random.uniform(0.01, 0.1)),
        actuator_inertia=float(random.uniform(0.01, 0.1)),
    )


def _loads(name: str, k: int) -> list[mbdlft.multibody.force.Load]:
    top = f"{name}.top"
    return [
        kit.force(f"f{k}", top, (0.3, -1, 0.5), frame="ground", magnitude=3.0),
        kit.force(f"p{k}", top, (0, 0, 1), magnitude=-2.0),
        kit.torque(f"t{k}", name, (0, 0, 1), magnitude=0.7),
        kit.torque(f"g{k}", name, (1, 0, 0.2), frame="ground", magnitude=0.5),
        kit.spring(f"s{k}", top, "ground.wall", stiffness=20.0, force_density=1.5),
    ]


def _disc(random):
    """A disc on a twisting shaft that slides, both along the axis of the wheel, in the other sense."""
    slider = kit.body("slider", 0.3, (0.02, 0.02, 0.03))
    disc = kit.body(
        "disc", 0.8, (0.2, 0.2, "0.5*axial"), center_of_mass=(0, 0, 0.1), ports={"hub": (0, 0, -0.05)}
    )
    held = {"stiffness": 15.0, "damping": 0.2}
    return [slider, disc], [
        kit.rail("play", "w0.top", "slider", (0, 0, 1), **held),
        kit.hinge("torsion", "slider", "disc.hub", (0, 0, -1), actuator_inertia=0.05, **held),
    ]


def _halves(random):
    """Two bodies on the wheel that are symmetric only together: at right angles to each other."""
    blades = [
        kit.body(name, 0.5, (0.01, 0.02, 0.03), about="center_of_mass", center_of_mass=(x, y, 0.2))
        for name, x, y in (("b_x", 0.3, 0), ("b_mx", 0.3, 0), ("b_y", 0.3, 0), ("b_my", 0.3, 0))
    ]
    turns = (0, 180, 90, -90)
    return blades, [
        kit.weld(f"root{k}", "w0", blade.name, (0, 0, 1), position=f"{turn}*deg")
        for k, (blade, turn) in enumerate(zip(blades, turns, strict=True))
    ]
