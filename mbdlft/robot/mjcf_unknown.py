"""Contents of an MJCF file that a scene cannot have: some are refused, the rest is listed."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from mbdlft.base.errors import SceneError
from mbdlft.robot.mjcf_model import Compiled

_EQUALITIES = ("CONNECT", "WELD", "JOINT")


def refuse(model: Compiled) -> None:
    """Raise a SceneError for the first thing that moves or pushes the bodies in a way of its own."""
    for problem in _problems(model):
        raise SceneError(f"{problem} A scene does not have this; take it out of the file.")


def _problems(model: Compiled) -> Iterator[str]:
    """Sentences that name what is refused."""
    if model.count("nflex"):
        yield f"flex {model.name_of('FLEX', 0)!r} is a deformable body."
    for body in _where(model.of("body_plugin") >= 0):
        yield f"body {model.body(body)!r} has a plugin, whose forces are unknown."
    for joint in _where(np.any(model.of("jnt_stiffnesspoly") != 0.0, axis=1)):
        yield f"joint {model.joint(joint)!r} has a nonlinear spring."
    for joint in _where(model.of("jnt_springyield") > 0.0):
        yield f"joint {model.joint(joint)!r} has a spring that yields."
    for joint in range(model.count("njnt")):
        dof = int(model.of("jnt_dofadr")[joint])
        if model.kind(joint) == "floating" and model.of("dof_armature")[dof] != 0.0:
            yield (
                f"the free joint {model.joint(joint)!r} has an armature, "
                f"{model.of('dof_armature')[dof]:g}: its body would be heavier to move than to lift."
            )
    for k in range(model.count("neq")):
        kind = model.word("mjtEq", model.of("eq_type")[k])
        if model.of("eq_active0")[k] and kind not in _EQUALITIES and not model.disabled("EQUALITY"):
            yield f"equality {model.name_of('EQUALITY', k)!r} is of the type {kind.lower()}."


def _where(true: Any) -> list[int]:
    """The numbers of the entries of an array (n,) that are true."""
    return [int(k) for k in np.flatnonzero(true)]


def ignored(model: Compiled) -> tuple[str, ...]:
    """Sentences on what the scene does not have, and what is left out without harm."""
    said = []
    for count, what in (("ngeom", "shapes"), ("npair", "pairs of contacts")):
        if model.count(count):
            said.append(f"{model.count(count)} {what}: there are no contacts")
    tendons = [k for k in range(model.count("ntendon"))]
    if tendons:
        said.append(f"tendons {_names(model, 'TENDON', tendons)}" + _forces(model, tendons))
    off = [k for k in range(model.count("neq")) if not model.of("eq_active0")[k]]
    if off:
        said.append(f"equalities that do not act at first: {_names(model, 'EQUALITY', off)}")
    if model.arrays.opt.viscosity or (model.arrays.opt.density and np.any(model.arrays.opt.wind)):
        said.append("forces of the medium (density, viscosity, wind)")
    for array, what in (("jnt_stiffnesspoly", "springs"), ("dof_dampingpoly", "dampers")):
        if np.any(model.of(array)):
            said.append(f"parts of {what} that are not linear")
    if model.count("nmocap"):
        said.append(f"{model.count('nmocap')} mocap bodies are fixed on the ground")
    return tuple(said)


def _forces(model: Compiled, tendons: Iterable[int]) -> str:
    """Words on springs and dampers of tendons, if there are any."""
    keys = ("stiffness", "damping", "armature", "frictionloss")
    found = [key for key in keys if any(model.of(f"tendon_{key}")[k] for k in tendons)]
    return f", with their {', '.join(found)}" if found else ""


def _names(model: Compiled, kind: str, numbers: Iterable[int]) -> str:
    """Names of objects, the first of many."""
    names = [model.name_of(kind, number) for number in numbers]
    more = f" and {len(names) - 8} others" if len(names) > 8 else ""
    return ", ".join(names[:8]) + more
