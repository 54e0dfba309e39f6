"""Random mechanisms whose joints are coupled: gears of all kinds between angles and distances."""

import numpy as np

from mbdlft import Parameter, Scene
from mbdlft.multibody.coupling import KINDS, Coupling
from mbdlft.multibody.joint import Joint
from tests.cross.mixed_mechanisms import mixed

RATIO = Parameter("ratio", 1.5, low=1.0, high=2.5)
LEVER = Parameter("lever", 0.3, low=0.2, high=0.5, unit="m")
_TREES = 7  # every such seed of `mixed` is a tree


def coupled(seed: int) -> Scene:
    """A mixed mechanism, two of three times a tree, with one coupling, or a chain of them."""
    random = np.random.default_rng(12000 + seed)
    base = mixed(seed if seed % 3 == 0 else _TREES * seed)
    angles, distances = _coordinates(base, turns=True), _coordinates(base, turns=False)
    random.shuffle(angles)
    random.shuffle(distances)
    couplings: list[Coupling] = []
    joints = {joint.name: joint for joint in base.joints}
    for count in range(2):
        kinds = [kind for kind in KINDS if _fits(kind, angles, distances)]
        if not kinds or (count and random.random() < 0.5):
            break
        kind = str(random.choice(kinds))
        if kind == "cable" and couplings and couplings[0].kind == kind:
            break  # its distances have one factor in both, and what the first has beside them is locked
        made = _drawn(f"c{count}", kind, angles, distances, random)
        alone = [x for x in (term.coordinate for term in made.terms()) if _is_driven(x, joints)]
        follower = alone[0] if alone else made.terms()[0].coordinate
        if random.random() < 0.4 or not alone:
            soft = {"stiffness": float(random.uniform(1.0, 50.0)), "damping": 0.3, "preload": 0.7}
            made = made.model_copy(update=soft)
        else:  # the coupling holds it
            name = follower.partition(".")[0]
            joints[name] = joints[name].model_copy(update={"preload": 0.4})
        couplings.append(made)
        (angles if follower in angles else distances).remove(follower)  # coupled once: nothing locks
    signals = [coupling.signal(base.joints).name for coupling in couplings]
    return base.model_copy(
        update={
            "name": f"coupled_{seed}",
            "parameters": (*base.parameters, RATIO, LEVER),
            "joints": tuple(joints.values()),
            "couplings": tuple(couplings),
            "outputs": (*base.outputs, *signals),
        }
    )


def _coordinates(scene: Scene, *, turns: bool) -> list[str]:
    """Names of coordinates that are angles, or distances, and may be coupled."""
    return [
        f"{joint.name}.{freedom.measures[0].name}"
        for joint in scene.joints
        for freedom in joint.freedoms
        if freedom.turns == turns
        and not (turns and joint.kind in ("free", "spherical"))
        and getattr(joint, "rate", None) is None
        and not joint.imposed
    ]


def _fits(kind: str, angles: list[str], distances: list[str]) -> bool:
    need = {"gear": (2, 0), "belt": (2, 0), "planetary": (3, 0), "differential": (3, 0)}
    need |= {"rack": (1, 1), "screw": (1, 1)}
    a, d = need.get(kind, (0, 0))
    return len(angles) >= a and len(distances) >= d and len(angles) + len(distances) >= 2


def _drawn(name: str, kind: str, angles: list[str], distances: list[str], random) -> Coupling:
    ratio = "ratio" if random.random() < 0.5 else float(random.uniform(-3.0, -0.5))
    lever = "lever" if random.random() < 0.5 else float(random.uniform(0.1, 0.6))
    both = [*angles, *distances]
    fields: dict = {
        "gear": {"joints": angles[:2], "ratio": ratio},
        "belt": {"joints": angles[:2], "radii": (lever, 0.2), "crossed": bool(random.random() < 0.5)},
        "planetary": dict(zip(("sun", "ring", "carrier"), angles, strict=False)) | {"ratio": ratio},
        "differential": dict(zip(("left", "right", "carrier"), angles, strict=False)),
        "rack": {"radius": lever},
        "screw": {"pitch": lever},
        "cable": {"strands": {x: lever if x in angles else ratio for x in both[-3:]}},
        "linear": {"factors": {both[0]: 0.8}},
        "mimic": {"joint": both[0], "leader": both[1]},
    }[kind]
    if kind in ("rack", "screw"):
        fields |= {"joint": angles[0], "slider": distances[0]}
    factor = ratio if (both[0] in angles) == (both[1] in angles) else float(random.uniform(0.3, 2.0))
    if kind == "mimic":
        fields["multiplier"] = factor
    if kind == "linear":
        fields["factors"][both[1]] = factor
    return KINDS[kind](name=name, **fields)


def _is_driven(coordinate: str, joints: dict[str, Joint]) -> bool:
    """Whether the effort of a joint with one coordinate is unknown."""
    joint = joints[coordinate.partition(".")[0]]
    return len(joint.freedoms) == 1 and joint.preload is None
