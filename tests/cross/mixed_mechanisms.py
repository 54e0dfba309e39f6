"""Random mechanisms that have all at once: loops, rotors, gears, struts, imposed motions."""

import numpy as np

import mbdlft
from mbdlft import Parameter, Scene
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.loop import KINDS
from tests.cross.mechanisms import closed_by, open_tree
from tests.cross.steady_mechanisms import spinning

GEAR = Parameter("gear", 3.0, low=2.0, high=5.0)


def mixed(seed: int) -> Scene:
    """A tree, or a chain closed by one of the kinds; two of three carry rotors."""
    random = np.random.default_rng(11000 + seed)
    kind = ("tree", *KINDS)[seed % (1 + len(KINDS))]
    base = open_tree(seed) if kind == "tree" else closed_by(kind, seed)
    if seed % 3:
        base = spinning(seed, base)
    joints = [_geared(joint, random) for joint in base.joints]
    if kind != "tree":
        joints = _imposed(joints, random)
    rigid = [b.name for b in base.bodies if b.kind == "rigid" and "side" in b.ports]
    leg = mbdlft.Strut(
        name="brace",
        parent=f"{rigid[0]}.tip",
        child=f"{rigid[-1]}.side",
        direction=tuple(random.uniform(-1.0, 1.0, 3)),
        stiffness=float(random.uniform(5.0, 40.0)),
        damping=float(random.uniform(0.0, 2.0)),
        force=float(random.uniform(-3.0, 3.0)),
    )
    kept = random.choice(len(base.sensors), 3, replace=False)
    sensors = tuple(base.sensors[k] for k in kept)
    return base.model_copy(
        update={
            "name": f"mixed_{kind}_{seed}",
            "parameters": (*base.parameters, GEAR),
            "joints": tuple(joints),
            "loads": (*base.loads, leg),
            "sensors": sensors,
            "inputs": None,
            "outputs": _outputs(joints, sensors),
        }
    )


def _outputs(joints: list[Joint], sensors) -> tuple[str, ...]:
    names = [f"{joint.name}.{m.name}" for joint in joints for f in joint.freedoms for m in f.measures]
    return (*names, *(signal.name for sensor in sensors for signal in sensor.signals()))


def _geared(joint: Joint, random) -> Joint:
    """Half of the hinges have a gear, and some an inertia that they alone feel."""
    fields = {}
    if joint.kind == "revolute" and random.random() < 0.5:
        fields["gear_ratio"] = "gear" if random.random() < 0.5 else float(random.uniform(-4.0, 4.0))
    if joint.kind == "revolute" and random.random() < 0.3:
        fields["reflected_inertia"] = float(random.uniform(0.01, 0.2))
    return joint.model_copy(update=fields)


def _imposed(joints: list[Joint], random) -> list[Joint]:
    """In half of the loops a joint that is driven moves as its inputs say."""
    free = [
        k
        for k, joint in enumerate(joints)
        if joint.freedoms and joint.preload is None and getattr(joint, "rate", None) is None
    ]
    if free and random.random() < 0.5:
        k = int(random.choice(free))
        joints[k] = joints[k].model_copy(update={"imposed": [True, "motion"][int(random.integers(2))]})
    return joints
