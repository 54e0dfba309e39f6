"""An MJCF file as the package mujoco compiles it: its arrays, with names for everything."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.base.errors import SceneError
from mbdlft.robot.description import Triple
from mbdlft.robot.elements import Element
from mbdlft.robot.tree import unused

_MOST = 10_000  # copies that a file may ask for
_COPIES = ("replicate", "composite", "flexcomp")
_KINDS = {"FREE": "floating", "BALL": "spherical", "SLIDE": "prismatic", "HINGE": "revolute"}


@dataclass(frozen=True)
class Compiled:
    """A compiled model: `arrays` is the MjModel, `library` the module mujoco.

    `warnings` is what the compiler says.
    """

    arrays: Any
    library: Any
    warnings: tuple[str, ...] = ()

    def of(self, name: str) -> Any:
        """An array of the model."""
        return getattr(self.arrays, name)

    def count(self, name: str) -> int:
        """A size of the model."""
        return int(getattr(self.arrays, name))

    def code(self, enumeration: str, name: str) -> int:
        """The number of a constant, such as HINGE of mjtJoint."""
        kinds = getattr(self.library, enumeration)
        prefix = next(iter(kinds.__members__)).partition("_")[0]
        return int(kinds.__members__[f"{prefix}_{name}"].value)

    def word(self, enumeration: str, code: int) -> str:
        """The name of a constant without its prefix, such as HINGE."""
        return str(getattr(self.library, enumeration)(int(code)).name).partition("_")[2]

    def disabled(self, flag: str) -> bool:
        """Whether the options disable a part of the physics."""
        return bool(self.arrays.opt.disableflags & self.code("mjtDisableBit", flag))

    @property
    def name(self) -> str:
        """The name of the model."""
        return bytes(self.arrays.names).split(b"\0", 1)[0].decode("utf-8", "replace")

    @property
    def gravity(self) -> Triple:
        """Gravity (m/s^2)."""
        if self.disabled("GRAVITY"):
            return (0.0, 0.0, 0.0)
        x, y, z = (float(entry) + 0.0 for entry in self.arrays.opt.gravity)
        return x, y, z

    def name_of(self, kind: str, number: int) -> str:
        """The name that the file gives to an object, or its kind with its number."""
        code = getattr(self.library.mjtObj, f"mjOBJ_{kind}")
        return self.library.mj_id2name(self.arrays, code, int(number)) or f"{kind.lower()}_{number}"

    def names_of(self, kind: str, count: str) -> list[str]:
        """The names of all objects of a kind, all different."""
        names: list[str] = []
        for number in range(self.count(count)):
            names.append(unused(self.name_of(kind, number), names))
        return names

    @cached_property
    def body_names(self) -> list[str]:
        """Names of the bodies, the world first."""
        return self.names_of("BODY", "nbody")

    @cached_property
    def joint_names(self) -> list[str]:
        """Names of the joints."""
        return self.names_of("JOINT", "njnt")

    def body(self, number: int) -> str:
        """The name of a body."""
        return self.body_names[number]

    def joint(self, number: int) -> str:
        """The name of a joint."""
        return self.joint_names[number]

    def joints(self, body: int) -> list[int]:
        """The joints of a body, in their order."""
        first, count = self.of("body_jntadr")[body], self.of("body_jntnum")[body]
        return [int(first) + k for k in range(int(count))]

    def kind(self, joint: int) -> str:
        """The kind of a joint: floating, spherical, prismatic or revolute."""
        return _KINDS[self.word("mjtJoint", self.of("jnt_type")[joint])]

    def between(self, body: int) -> list[str]:
        """Names of the links without mass after each joint of a body but the last."""
        return [
            unused(f"{self.body(body)}_after_{self.joint(number)}", self.body_names)
            for number in self.joints(body)[:-1]
        ]


def compiled(file: Path, top: Element) -> Compiled:
    """The model of a file, compiled by the package mujoco.

    Raises
    ------
    SceneError
        The package is not installed or cannot compile the file, the file asks for very many copies of
        something, or a number is not finite.
    """
    _refuse_many(top)
    try:
        import mujoco
    except ImportError:
        raise SceneError(
            "MJCF files are compiled by the package mujoco, which is not installed: pip install "
            "'mbdlft[mjcf]'."
        ) from None
    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)  # without it a log file is written into the folder
    try:
        arrays = mujoco.MjModel.from_xml_path(str(file))
        model = Compiled(arrays, mujoco, tuple(" ".join(text.split()) for text in said))
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise SceneError(
            f"mujoco cannot compile it: {reason[:500]}. Files that it includes and meshes, whose mass "
            "counts, must be there."
        ) from None
    finally:
        mujoco.set_mju_user_warning(before)
    _refuse_not_finite(model)
    return model


def _refuse_many(top: Element) -> None:
    """Raise a SceneError if the file asks for more copies than any mechanism has."""
    pending = [top]
    while pending:
        element = pending.pop()
        pending += element.children
        counts = element.attributes.get("count", "") if element.tag in _COPIES else ""
        asked = np.prod([float(n) for n in counts.split() if n.isdigit()])
        if asked > _MOST:
            raise SceneError(
                f"line {element.line}: <{element.tag}> asks for {asked:g} copies, expected at most "
                f"{_MOST}."
            )


_MEASURED: Mapping[str, str] = {
    "body_mass": "body", "body_inertia": "body", "body_pos": "body", "body_quat": "body",
    "body_ipos": "body", "body_iquat": "body", "jnt_pos": "joint", "jnt_axis": "joint",
    "jnt_stiffness": "joint", "jnt_range": "joint",
}  # fmt: skip


def _refuse_not_finite(model: Compiled) -> None:
    """Raise a SceneError for a number that is not finite."""
    for array, owner in _MEASURED.items():
        bad = ~np.all(np.isfinite(np.atleast_2d(np.asarray(model.of(array)).T)), axis=0)
        if bad.any():
            name = getattr(model, owner)(int(np.argmax(bad)))
            what = array.partition("_")[2]
            raise SceneError(f"{owner} {name!r}: its {what} is not finite.")
