"""Random vehicles: wheels, balls and knife edges under a frame with forks, a load, a motor.

In two of seven the wheels have tires without relaxation, or are on rails.
"""

import numpy as np

import mbdlft
from mbdlft import Inertia, Parameter, Prismatic, Revolute, RigidBody, Scene
from mbdlft.multibody.contact import Contact, KnifeEdge, Rolling
from mbdlft.multibody.coupling import Belt, Coupling, Gear
from mbdlft.multibody.force import Creep, Load, Tire
from mbdlft.multibody.joint import Joint
from tests import kit

SPEED = Parameter("v", 3.0, low=1.0, high=6.0, unit="m/s")
RADIUS = Parameter("R", 0.4, low=0.3, high=0.5, unit="m")
MASS = Parameter("m", 2.0, low=1.0, high=4.0, unit="kg")
_NOTHING = Inertia(xx=0.0, yy=0.0, zz=0.0)


def rolling(seed: int) -> Scene:
    """A frame on three slides and three hinges, on two or three contacts, at rest or at the speed v."""
    random = np.random.default_rng(13000 + seed)
    moves = seed % 4 != 3
    bodies, joints = _carrier()
    ports: dict[str, tuple] = {"head": tuple(random.uniform(0.2, 1.0, 3)), "keel": (0.4, 0.2, 0.1)}
    contacts: list[Contact] = []
    count = 2 + seed % 2
    places = [(0.0, 0.0), (1.2, 0.0), (0.3, 0.6)][:count]
    sides = random.uniform(-0.3, 0.3, count)
    for k, (x, y) in enumerate(places):
        kind = (
            "wheel" if k == 0 else str(random.choice(["wheel", "fork", "ball" if not moves else "fork"]))
        )
        radius = "R" if k == 0 else float(np.round(random.uniform(0.2, 0.5), 3))
        place = (x + float(sides[k]), y, 0.0)
        _under(f"w{k}", kind, radius, place, moves, random, ports, bodies, joints, contacts)
    if seed % 5 == 4:
        contacts.append(KnifeEdge(name="keel", port="frame.keel", heading=(1, 0, 0)))
    wheels = _as_loads(seed, random, contacts) if moves and seed % 7 in (2, 5) else []
    frame = kit.body(
        "frame",
        float(random.uniform(3.0, 9.0)),
        center_of_mass=(*random.uniform(-0.2, 0.7, 2), float(random.uniform(0.3, 1.0))),
        inertia=_inertia(random),
        ports=ports,
    )
    bodies.insert(0, frame)
    _swing(random, bodies, joints)
    # two contacts leave the lean to what holds it, and two hold the frame sideways: others, their forks
    forks = [joint.name for joint in joints if joint.name.endswith("_steer")]
    held: dict[str, float | None] = {"lean": None} if count == 2 else {}
    if seed % 3 == 1:  # the motor drives against what holds the frame back
        held["x"] = None
    sideways = sum(getattr(contact, "axis", contact) is not None for contact in contacts)
    held |= dict.fromkeys(forks[: sideways - 2], 0.0)
    joints = [
        joint.model_copy(update={"preload": held[joint.name]}) if joint.name in held else joint
        for joint in joints
    ]
    # what slips ahead holds nothing, so the motor turns freely then
    torque = None if wheels else 0.4
    couplings = [_drive(random, moves, torque, bodies, joints)] if seed % 3 == 1 else []
    names = [f"{joint.name}.{f.measures[1].name}" for joint in joints for f in joint.freedoms]
    return kit.scene(
        f"rolling_{seed}",
        *([SPEED, RADIUS, MASS] if moves else [RADIUS, MASS]),
        *bodies,
        *joints,
        *contacts,
        *wheels,
        *couplings,
        mbdlft.multibody.Accelerometer(name="felt", port="frame.head"),
        mbdlft.multibody.Velocity(name="way", port="frame.head"),
        gravity=(0.0, 0.0, -9.81),
        velocity=("v", 0.0, 0.0) if moves else (0.0, 0.0, 0.0),
        outputs=[
            *names,
            *(coupling.signal(joints).name for coupling in couplings),
            *(f"{wheel.name}.{signal.name}" for wheel in wheels for signal in wheel.outputs()),
            *("lean.angle", "felt.x", "felt.y", "felt.z", "way.x", "way.y", "way.z"),
        ],
    )


def _carrier() -> tuple[list[RigidBody], list[Joint]]:
    """Three slides and three hinges to the frame, without mass between them."""
    steps = [
        ("x", Prismatic, (1, 0, 0)), ("y", Prismatic, (0, 1, 0)), ("z", Prismatic, (0, 0, 1)),
        ("yaw", Revolute, (0, 0, 1)), ("pitch", Revolute, (0, 1, 0)), ("lean", Revolute, (1, 0, 0)),
    ]  # fmt: skip
    bodies, joints, parent = list[RigidBody](), list[Joint](), "ground"
    for name, kind, axis in steps[:-1]:
        bodies.append(kit.body(f"after_{name}", 0.0, inertia=_NOTHING))
        joints.append(kind(name=name, parent=parent, child=f"after_{name}", axis=axis, preload=0.0))
        parent = f"after_{name}"
    joints.append(kit.hinge("lean", parent, "frame", (1, 0, 0), preload=0.0))
    return bodies, joints


def _inertia(random: np.random.Generator) -> Inertia:
    """Of a few points."""
    points, masses = random.uniform(-0.3, 0.3, (4, 3)), random.uniform(0.5, 2.0, 4)
    J = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, points, strict=True))
    entries = {f"{'xyz'[i]}{'xyz'[j]}": float(J[i, j]) for i in range(3) for j in range(i, 3)}
    return Inertia(**entries)


def _under(name, kind, radius, place, moves, random, ports, bodies, joints, contacts) -> None:
    """A contact under the frame: a wheel, one on a fork that is steered, or a ball."""
    x, y, _ = place
    ports[name] = (x, y, radius)
    parent = f"frame.{name}"
    if kind == "fork":
        trail, tilt = float(random.uniform(0.02, 0.2)), float(random.uniform(-0.4, 0.4))
        bodies.append(
            kit.body(
                f"{name}_fork",
                float(random.uniform(0.5, 2.0)),
                center_of_mass=tuple(random.uniform(-0.1, 0.3, 3)),
                inertia=_inertia(random),
                ports={"crown": (trail, 0.0, 0.0)},
            )
        )
        axis = (float(np.sin(tilt)), 0.0, float(np.cos(tilt)))
        ports[f"{name}_crown"] = (x + trail, y, radius)
        joints.append(
            kit.hinge(f"{name}_steer", f"frame.{name}_crown", f"{name}_fork.crown", axis, damping=0.1)
        )
        parent = f"{name}_fork"
    transverse, spin = random.uniform(0.03, 0.05), random.uniform(0.02, 0.06)
    bodies.append(kit.body(name, "m" if kind == "wheel" else 1.5, (transverse, spin, transverse)))
    rate = {"rate": f"v/({radius}{'' if isinstance(radius, str) else ' [m]'})"} if moves else {}
    if kind == "ball":
        joints.append(kit.ball(f"{name}_axle", parent, name, preload=(0, 0, 0)))
        contacts.append(Rolling(name=f"{name}_touch", port=name, radius=radius))
        return
    joints.append(kit.hinge(f"{name}_axle", parent, name, (0, 1, 0), preload=0.0, **rate))
    tire = float(random.uniform(0.0, 0.1))
    contacts.append(Rolling(name=f"{name}_touch", port=name, axis=(0, 1, 0), radius=radius, tire=tire))


def _swing(random, bodies, joints) -> None:
    """A load on a spring that swings about any axis."""
    bodies.append(
        kit.body(
            "load", "m", center_of_mass=tuple(random.uniform(-0.2, 0.2, 3)), inertia=_inertia(random)
        )
    )
    axis = tuple(random.uniform(-1.0, 1.0, 3))
    turn = kit.turn((1, 2, 0), float(random.uniform(-0.5, 0.5)))
    joints.append(
        kit.hinge(
            "swing",
            "frame.head",
            "load",
            axis,
            orientation=(turn,),
            stiffness=float(random.uniform(5.0, 40.0)),
            damping=0.3,
        )
    )


def _drive(random, moves, torque, bodies, joints) -> Coupling:
    """A motor on the frame that turns the first wheel by a gear or a belt, rigid or soft."""
    spin = float(random.uniform(0.01, 0.03))
    bodies.append(kit.body("rotor", 0.8, (0.02, spin, 0.02)))
    ratio = float(random.choice([-3.0, 2.5]))
    rate = {"rate": f"{ratio}*v/R"} if moves else {}
    place = {"parent": "frame.head", "child": "rotor", "axis": (0, 1, 0)}
    joints.append(kit.hinge("motor", **place, **rate, preload=torque))
    law = {"stiffness": 30.0, "damping": 0.2} if random.random() < 0.5 else {}
    shafts = ("motor", "w0_axle")
    if ratio < 0.0:
        return Gear(name="drive", joints=shafts, ratio=ratio, **law)
    return Belt(name="drive", joints=shafts, radii=(0.1, 0.1 * ratio), **law)


def _as_loads(seed, random, contacts) -> list[Load]:
    """Loads in place of the contacts of wheels: tires, or wheels on rails."""
    loads = list[Load]()
    for contact in [x for x in contacts if getattr(x, "axis", None) is not None]:
        contacts.remove(contact)
        law = {"stiffness": float(random.uniform(2e3, 9e3)), "damping": float(random.uniform(5.0, 50.0))}
        place = {
            "name": contact.name,
            "child": contact.port,
            "axis": contact.axis,
            "radius": contact.radius,
        }
        sizes = [float(x) for x in random.uniform(50.0, 900.0, 2)]
        if seed % 7 == 2:
            sides = {"cornering": sizes[0], "camber": 0.1 * sizes[1], "crown": contact.tire}
            loads.append(Tire(**place, **law, **sides))
            continue
        spin = {"lateral_spin": float(random.uniform(1.0, 9.0)), "spin": 0.5}
        ahead = {
            "longitudinal": sizes[0],
            "lateral": sizes[1],
            "conicity": float(random.uniform(-0.2, 0.2)),
        }
        loads.append(Creep(**place, **law, **spin, **ahead))
    return loads
