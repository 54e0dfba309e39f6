"""Random MJCF files: trees of bodies with joints of all kinds, springs and servos, turned in any way."""

import re

import numpy as np

_ENDS = "</mujoco>"


def numbers(random: np.random.Generator, count: int, size: float = 1.0) -> str:
    return " ".join(f"{x:.6g}" for x in random.uniform(-size, size, count))


def written(seed: int) -> str:
    """A file without a keyframe."""
    random = np.random.default_rng(seed)
    bodies, count = "", 0
    for _ in range(random.integers(1, 3)):
        text, count = _body(random, count, 0)
        bodies += text
    order = random.choice(["xyz", "zyx", "XYZ", "yxz"])
    actuators = ""
    for joint in re.findall(r'name="(j\d+_\d+)"', bodies):
        gear = f'gear="{random.uniform(0.5, 3.0):.3g}"'
        if random.random() < 0.4:
            actuators += f'<position joint="{joint}" kp="{random.uniform(1, 9):.3g}" kv=".3" {gear}/>'
        if random.random() < 0.2:
            actuators += f'<motor joint="{joint}" armature=".01" {gear}/>'
    gravity = numbers(random, 3, 9)
    return (
        f'<mujoco><compiler angle="degree" eulerseq="{order}"/><option gravity="{gravity}"/>'
        f"<worldbody>{bodies}</worldbody><actuator>{actuators}</actuator>{_ENDS}"
    )


def with_keyframe(text: str, qpos: np.ndarray) -> str:
    """The file with a keyframe ``k``."""
    values = " ".join(repr(float(x)) for x in qpos)
    return text.replace(_ENDS, f'<keyframe><key name="k" qpos="{values}"/></keyframe>{_ENDS}')


def _body(random: np.random.Generator, number: int, depth: int) -> tuple[str, int]:
    """A body with those on it, and the number of the next one."""
    turned = random.choice(
        [
            f'quat="{numbers(random, 4)}"',
            f'euler="{numbers(random, 3, 180)}"',
            f'axisangle="{numbers(random, 4)}"',
            f'zaxis="{numbers(random, 3)}"',
            "",
        ]
    )
    free = depth == 0 and random.random() < 0.4
    held = f'gravcomp="{random.uniform():.3g}"' if random.random() < 0.3 else ""
    text = f'<body name="body{number}" pos="{numbers(random, 3)}" {turned} {held}>'
    text += f'<freejoint name="f{number}"/>' if free else _joints(random, number)
    text += random.choice(
        [
            f'<geom type="box" size=".1 .2 .05" pos="{numbers(random, 3, 0.2)}" '
            f'euler="{numbers(random, 3, 90)}"/>',
            f'<geom type="capsule" size=".05" fromto="0 0 0 {numbers(random, 3, 0.4)}"/>',
            f'<inertial pos="{numbers(random, 3, 0.2)}" mass="{random.uniform(0.5, 3):.4g}" '
            f'diaginertia=".1 .12 .15" quat="{numbers(random, 4)}"/>',
        ]
    )
    after = number + 1
    for _ in range(random.integers(0, 3) if depth < 3 else 0):
        child, after = _body(random, after, depth + 1)
        text += child
    return text + "</body>", after


def _joints(random: np.random.Generator, number: int) -> str:
    """Up to three joints of a body; a ball turns alone."""
    text, turns = "", ""
    for k in range(random.integers(0, 4)):
        kind = str(random.choice(["hinge", "slide", "ball"], p=[0.5, 0.3, 0.2]))
        if (kind == "ball" and turns) or (kind == "hinge" and turns == "ball"):
            continue
        turns = kind if kind != "slide" else turns
        place = f'pos="{numbers(random, 3, 0.2)}" damping="{random.uniform(0, 0.3):.3g}"'
        place += f' armature="{random.uniform(0, 0.1) * random.integers(2):.3g}"'
        if kind == "ball":
            text += f'<joint name="b{number}_{k}" type="ball" {place}/>'
            continue
        axis, reference = numbers(random, 3), random.uniform(-1, 1) * random.integers(2)
        stiffness = random.uniform(0, 3) * random.integers(2)
        text += (
            f'<joint name="j{number}_{k}" type="{kind}" axis="{axis}" {place} range="-300 300" '
            f'stiffness="{stiffness:.3g}" ref="{reference:.3g}"/>'
        )
    return text
