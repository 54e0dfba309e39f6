"""The same random chain of links, written as URDF, as SDF and as MJCF.

The files do not say it in the same way: SDF has the poses of links in the model, relative to other
frames, in degrees or as quaternions, and axes in the axes of the model; MJCF has joints away from the
origin of their bodies, angles in any unit and order, and defaults.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Link:
    """A link with the joint that carries it; frames as in URDF, the joint at the origin of the link."""

    xyz: np.ndarray
    rpy: np.ndarray
    axis: np.ndarray
    slides: bool
    damping: float
    stiffness: float
    mass: float
    center: np.ndarray
    inertia: np.ndarray  # (3, 3), in the axes of the link


def chain(seed: int, count: int = 3) -> list[Link]:
    """A random chain; each link hangs on the one before it, the first on the ground."""
    random = np.random.default_rng(seed)
    links = []
    for k in range(count):
        corners = random.uniform(-0.3, 0.3, (8, 3))
        spread = corners.T @ corners
        links.append(
            Link(
                xyz=random.uniform(-0.5, 0.5, 3),
                rpy=random.uniform(-3.0, 3.0, 3) * [1.0, 0.45, 1.0],
                axis=random.uniform(-1.0, 1.0, 3),
                slides=k % 3 == 2,
                damping=random.uniform(0.0, 0.5),
                stiffness=random.uniform(0.0, 5.0),
                mass=random.uniform(0.5, 4.0),
                center=random.uniform(-0.3, 0.3, 3),
                inertia=np.trace(spread) * np.eye(3) - spread,
            )
        )
    return links


def numbers(values: np.ndarray) -> str:
    """Numbers of a text, with all their digits."""
    return " ".join(repr(float(value)) for value in np.ravel(values))


def entries(J: np.ndarray) -> dict[str, float]:
    """The six entries of an inertia matrix."""
    return {f"{'xyz'[i]}{'xyz'[j]}": float(J[i, j]) for i in range(3) for j in range(i, 3)}


def turned(rpy: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) of roll, pitch and yaw."""
    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def as_urdf(links: list[Link]) -> str:
    """The chain as URDF."""
    parts = ['<robot name="chain"><link name="base"/>']
    for k, link in enumerate(links):
        inertia = " ".join(f'i{name}="{value!r}"' for name, value in entries(link.inertia).items())
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="{numbers(link.center)}"/>'
            f'<mass value="{link.mass!r}"/><inertia {inertia}/></inertial></link>'
            f'<joint name="joint{k}" type="{"prismatic" if link.slides else "continuous"}">'
            f'<parent link="{f"link{k - 1}" if k else "base"}"/><child link="link{k}"/>'
            f'<origin xyz="{numbers(link.xyz)}" rpy="{numbers(link.rpy)}"/>'
            f'<axis xyz="{numbers(link.axis)}"/>'
            '<limit lower="-9" upper="9" effort="9" velocity="9"/>'
            f'<dynamics damping="{link.damping!r}"/></joint>'
        )
    return "".join(parts) + "</robot>"


def as_sdf(links: list[Link], version: str = "1.9") -> str:
    """The chain as SDF: its links relative to the model, every third one to the link before it."""
    older = version < "1.7"
    parts = [f'<sdf version="{version}"><model name="chain">']
    place, R = np.zeros(3), np.eye(3)
    for k, link in enumerate(links):
        step = turned(link.rpy)
        place, R = place + R @ link.xyz, R @ step
        spin = Rotation.from_matrix(R)
        if k % 3 == 1 and not older:
            pose = (
                f'<pose relative_to="link{k - 1}" degrees="true">{numbers(link.xyz)} '
                f"{numbers(np.degrees(link.rpy))}</pose>"
            )
        elif k % 3 == 2 and not older:
            pose = f'<pose rotation_format="quat_xyzw">{numbers(place)} {numbers(spin.as_quat())}</pose>'
        else:
            pose = f"<pose>{numbers(place)} {numbers(spin.as_euler('xyz'))}</pose>"
        inertia = "".join(f"<i{n}>{value!r}</i{n}>" for n, value in entries(link.inertia).items())
        if older:
            axis = f"<xyz>{numbers(R @ link.axis)}</xyz>"
            axis += "<use_parent_model_frame>1</use_parent_model_frame>" if version > "1.4" else ""
        else:
            expressed = ' expressed_in="__model__"' if k % 2 else ""
            axis = f"<xyz{expressed}>{numbers(R @ link.axis if k % 2 else link.axis)}</xyz>"
        parts.append(
            f'<link name="link{k}">{pose}<inertial><pose>{numbers(link.center)} 0 0 0</pose>'
            f"<mass>{link.mass!r}</mass><inertia>{inertia}</inertia></inertial></link>"
            f'<joint name="joint{k}" type="{"prismatic" if link.slides else "revolute"}">'
            f"<parent>{f'link{k - 1}' if k else 'world'}</parent><child>link{k}</child><axis>{axis}"
            f"<limit><lower>-inf</lower><upper>inf</upper></limit><dynamics>"
            f"<damping>{link.damping!r}</damping></dynamics></axis></joint>"
        )
    return "".join(parts) + "</model></sdf>"


def as_mjcf(links: list[Link], seed: int = 0) -> str:
    """The chain as MJCF: each body has its origin away from the joint, angles are in degrees, z y x."""
    random = np.random.default_rng(seed)
    parts = [
        '<mujoco model="chain"><compiler angle="degree" eulerseq="zyx" balanceinertia="false"/>'
        '<option gravity="0 0 -9.81"/><default><joint armature="0"/></default><worldbody>'
    ]
    away = np.zeros(3)  # of the frame of the body around, seen from that of URDF
    for k, link in enumerate(links):
        offset = random.uniform(-0.2, 0.2, 3)  # of the new origin, in the axes of the link
        R = turned(link.rpy)
        place = link.xyz - away + R @ offset
        yaw_pitch_roll = np.degrees(link.rpy[::-1])
        J = link.inertia
        full = numbers(np.concatenate([np.diag(J), J[0, 1:], J[1, 2:]]))
        parts.append(
            f'<body name="link{k}" pos="{numbers(place)}" euler="{numbers(yaw_pitch_roll)}">'
            f'<inertial pos="{numbers(link.center - offset)}" mass="{link.mass!r}" fullinertia="{full}"/>'
            f'<joint name="joint{k}" type="{"slide" if link.slides else "hinge"}" '
            f'pos="{numbers(-offset)}" axis="{numbers(link.axis)}" damping="{link.damping!r}"/>'
        )
        away = offset
    return "".join(parts) + "</body>" * len(links) + "</worldbody></mujoco>"
