"""Parts of scenes, with what each of them has given by its place; scenes of parts; plants; transfers."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

import mbdlft
from mbdlft import Inertia, Parameter, RigidBody, Scene, System
from mbdlft.multibody.body import Body
from mbdlft.multibody.contact import Contact
from mbdlft.multibody.coupling import Coupling
from mbdlft.multibody.force import Load
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.sensor import Sensor

_LISTS: dict[str, type] = {
    "parameters": Parameter, "bodies": Body, "joints": Joint, "loops": mbdlft.Loop, "loads": Load,
    "couplings": Coupling, "contacts": Contact, "sensors": Sensor,
}  # fmt: skip
_TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz", "about")


def scene(name: str, *parts: Any, **fields: Any) -> Scene:
    """A scene of parameters, bodies, joints and what else there is; each list in the order given."""
    lists = {key: [x for x in parts if isinstance(x, kind)] for key, kind in _LISTS.items()}
    assert sum(map(len, lists.values())) == len(parts)
    return Scene(name=name, **{key: given for key, given in lists.items() if given}, **fields)


def changed(scene: Scene, **fields: Any) -> Scene:
    """A scene with other fields, which are checked as in any scene."""
    given = {name: getattr(scene, name) for name in scene.model_fields_set}
    return Scene(**{**given, **fields})


def body(name: str, mass: float | str, moments: Sequence[float | str] = (), **fields: Any) -> RigidBody:
    """A rigid body with the moments of inertia (xx, yy, zz); other entries of its tensor are fields."""
    tensor = dict(zip(_TENSOR, moments, strict=False))
    tensor |= {key: fields.pop(key) for key in _TENSOR if key in fields}
    if tensor:
        fields["inertia"] = Inertia(**tensor)
    return RigidBody(name=name, mass=mass, **fields)


def _by_place(kind: Callable[..., Any], *names: str) -> Callable[..., Any]:
    """What makes parts of a kind, with these fields given by place."""

    def make(*values: Any, **fields: Any) -> Any:
        return kind(**dict(zip(names, values, strict=False)), **fields)

    return make


_ENDS = ("name", "parent", "child")
point = _by_place(mbdlft.PointMass, "name", "mass")
turn = _by_place(mbdlft.Rotation, "axis", "angle")
hinge = _by_place(mbdlft.Revolute, *_ENDS, "axis")
rail = _by_place(mbdlft.Prismatic, *_ENDS, "axis")
weld = _by_place(mbdlft.Fixed, *_ENDS, "axis")
ball = _by_place(mbdlft.Spherical, *_ENDS)
cross = _by_place(mbdlft.Universal, *_ENDS)
free = _by_place(mbdlft.Free, *_ENDS)
loop = _by_place(mbdlft.Loop, "name", "kind", "parent", "child")
spring = _by_place(mbdlft.Spring, *_ENDS)
strut = _by_place(mbdlft.Strut, *_ENDS, "direction")
force = _by_place(mbdlft.Force, "name", "port", "direction")
torque = _by_place(mbdlft.Torque, "name", "port", "direction")
planar = _by_place(mbdlft.Planar, *_ENDS, "axis")


def rows(text: str) -> list[list[str]]:
    """A matrix of texts: entries between blanks, rows between semicolons."""
    return [row.split() for row in text.split(";")]


def plant(
    text: str,
    parameters: Iterable[Parameter],
    states: int | str,
    inputs: str = "",
    outputs: str = "",
    **how: Any,
) -> mbdlft.LFTModel:
    """The model of a matrix of texts, with names between blanks."""
    named = states.split() if isinstance(states, str) else states
    signals = {"inputs": inputs.split(), "outputs": outputs.split()}
    return mbdlft.realize(rows(text), list(parameters), states=named, **signals, **how)


def transfer(system: System, s: complex, values: Mapping[str, Any]) -> np.ndarray:
    """C (s I - A)^-1 B + D at values of the parameters."""
    A, B, C, D = mbdlft.matrices_at(system, values)
    return np.asarray(C @ np.linalg.solve(s * np.eye(A.shape[-1]) - A, B + 0j) + D)
