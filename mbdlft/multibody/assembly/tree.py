"""The tree of a scene: every body hangs on one joint, and the ground is the root."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar, NamedTuple, final

import casadi as ca
from pydantic import InstanceOf

from mbdlft.base.description import Text, Values
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.body import GROUND, Body, ElasticBody, Ground
from mbdlft.multibody.joint import Joint, Move, coordinate_label
from mbdlft.multibody.joint.move import Deformed, shifted
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import Coordinate

_GROUND_PORTS = ' Declare it: [bodies.ground], kind = "ground", ports.{} = [x, y, z].'


@final
class PortFrame(Body):
    """The moving frame of a port of an elastic body: a body without mass, made for every such port."""

    kind: ClassVar[str] = "port"

    @classmethod
    def named(cls, body: str, port: str) -> "PortFrame":
        """The frame of one port; no user can give a name with a dot."""
        return cls(name=f"{body}.{port}")

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Nothing: it has no mass."""
        return ca.SX(3, 2)


@final
class PortJoint(Joint):
    """From the origin of an elastic body to the frame of one of its ports."""

    kind: ClassVar[str] = "port"
    freedoms: ClassVar[tuple[Freedom, ...]] = ()

    body: InstanceOf[ElasticBody]
    port: Text

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        """The place in the undeformed body, then the deformation; `values` are those of the body."""
        shape = partial(self.body.shape, self.port, values)
        transposed = partial(self.body.shape_transposed, self.port, values)
        place = self.body.port_position(self.port, values)
        return (*shifted(place), Deformed(shape, transposed, at))


@dataclass(frozen=True, slots=True)
class Link:
    """One joint with the body it carries; ports by name.

    `owner` says whose quantities the joint has.
    """

    joint: Joint
    parent: Body
    parent_port: str
    child: Body
    child_port: str
    owner: str = field(init=False)

    def __post_init__(self) -> None:
        item = self.parent if isinstance(self.joint, PortJoint) else self.joint
        object.__setattr__(self, "owner", owner_name(item))


class Owned(NamedTuple):
    """Coordinates of a joint or of an elastic body."""

    owner: str
    name: str
    freedoms: tuple[Freedom, ...]
    kind: str  # "joint", "imposed", "motion" or "elastic"


def coordinate_owners(links: tuple[Link, ...]) -> list[Owned]:
    """Joints and bodies from the ground outward; each body after the joint that holds it."""
    found = []
    for link in links:
        joint, body = link.joint, link.child
        if not isinstance(joint, PortJoint):
            imposed = getattr(joint, "imposed", False)
            kind = "motion" if imposed == "motion" else "imposed" if imposed else "joint"
            found.append(Owned(link.owner, joint.name, joint.freedoms, kind))
        found.append(Owned(owner_name(body), body.name, body.freedoms(), "elastic"))
    return found


class Degree(NamedTuple):
    """One coordinate of a joint or of an elastic body; `kind` is that of `Owned`."""

    owner: str
    name: str
    freedom: Freedom
    kind: str

    def measure(self, order: int) -> Signal:
        """The displacement (order 0), rate (1) or acceleration (2)."""
        measure = self.freedom.measures[order]
        return Signal(f"{self.name}.{measure.name}", measure.unit)

    @property
    def effort(self) -> Signal:
        """The effort."""
        return Signal(f"{self.name}.{self.freedom.effort.name}", self.freedom.effort.unit)

    def label(self, key: str) -> str:
        """Label of one of its quantities, such as ``stiffness``."""
        return coordinate_label(key, self.freedom)


def degrees(links: tuple[Link, ...]) -> list[Degree]:
    """All coordinates, in the order of `coordinate_owners`."""
    return [
        Degree(owned.owner, owned.name, freedom, owned.kind)
        for owned in coordinate_owners(links)
        for freedom in owned.freedoms
    ]


def tree(scene: Scene) -> tuple[Link, ...]:
    """Links of a scene, each after the link that carries its parent; otherwise in scene order.

    Raises
    ------
    SceneError
        A body or port is unknown, a body has two parents, a loop closes, or a body hangs on nothing.
    """
    bodies = all_bodies(scene)
    links: dict[str, Link] = {}
    for joint in scene.joints:
        parent, parent_port = find_port(bodies, f"joint {joint.name!r}", "parent", joint.parent)
        child, child_port = find_port(bodies, f"joint {joint.name!r}", "child", joint.child)
        if child.name == GROUND:
            raise SceneError(
                f"joint {joint.name!r}: the ground cannot be a child. Exchange parent and child."
            )
        if child.name in links:
            raise SceneError(
                f"body {child.name!r} has two parents: it is the child of joints "
                f"{links[child.name].joint.name!r} and {joint.name!r}. Joints make a tree: write one of "
                "them under 'loops' instead, as the closure of a loop, or exchange parent and child of "
                "the one that should lead away from the body."
            )
        if isinstance(child, PortFrame) or (
            isinstance(child, ElasticBody) and child_port != "origin"
        ):
            raise SceneError(
                f"joint {joint.name!r}, child: an elastic body is held at its origin, got "
                f"{joint.child!r}. Exchange parent and child, or describe it from its other end."
            )
        links[child.name] = Link(joint, parent, parent_port, child, child_port)
    for body in scene.bodies:
        if isinstance(body, ElasticBody):
            for port in body.elastic_ports():
                frame = bodies[f"{body.name}.{port}"]
                links[frame.name] = _port_link(body, port, frame)
    return _from_the_root(scene, links)


def all_bodies(scene: Scene) -> dict[str, Body]:
    """Bodies by name, with the ground and the frames of the ports of elastic bodies."""
    frames = [
        PortFrame.named(body.name, port)
        for body in scene.bodies
        if isinstance(body, ElasticBody)
        for port in body.elastic_ports()
    ]
    return {GROUND: Ground()} | {body.name: body for body in (*scene.bodies, *frames)}


def find_port(bodies: Mapping[str, Body], owner: str, key: str, text: str) -> tuple[Body, str]:
    """Body and port that ``body`` or ``body.port`` names; `owner` and `key` say where it stands.

    Raises
    ------
    SceneError
        The body or the port is unknown.
    """
    name, dot, port = text.partition(".")
    if name not in bodies:
        raise SceneError(f"{owner}, {key}: " + unknown_name("body", name, bodies))
    body = bodies[name]
    if dot and port not in body.port_names():
        declared = "" if name != GROUND else _GROUND_PORTS.format(port)
        unknown = unknown_name("port", port, body.port_names())
        raise SceneError(f"{owner}, {key}: body {name!r}: {unknown}{declared}")
    if isinstance(body, ElasticBody) and port in body.elastic_ports():
        return bodies[text], "origin"
    return body, port if dot else "origin"


def _port_link(body: ElasticBody, port: str, frame: Body) -> Link:
    joint = PortJoint(
        name=f"{body.name}.{port}", parent=body.name, child=frame.name, body=body, port=port
    )
    return Link(joint, body, "origin", frame, "origin")


def _from_the_root(scene: Scene, links: dict[str, Link]) -> tuple[Link, ...]:
    children: defaultdict[str, list[Link]] = defaultdict(list)
    for link in links.values():
        children[link.parent.name].append(link)
    ordered: list[Link] = []
    pending = list(children[GROUND])
    while pending:
        link = pending.pop(0)
        ordered.append(link)
        pending.extend(children[link.child.name])
    reached = {link.child.name for link in ordered}
    loose = [body.name for body in scene.bodies if body.name not in reached | {GROUND}]
    if loose:
        loop = _loop(links, loose[0])
        if loop:
            raise SceneError(
                f"scene {scene.name!r}: the joints close a loop: {' -> '.join(loop)}. Joints make a "
                "tree on the ground; write one of them under 'loops' instead, as its closure."
            )
        raise SceneError(
            f"scene {scene.name!r}: not connected to the ground: {', '.join(loose)}. Add a joint "
            "with parent = 'ground' or another connected body."
        )
    if not ordered:
        raise SceneError(
            f"scene {scene.name!r}: there is no joint on the ground, so nothing moves."
        )
    return tuple(ordered)


def _loop(links: dict[str, Link], start: str) -> list[str]:
    """Names of the bodies of the loop that the chain of parents of `start` runs into, or empty."""
    seen: list[str] = []
    name = start
    while name in links:
        if name in seen:
            return [*seen[seen.index(name) :], name]
        seen.append(name)
        name = links[name].parent.name
    return []
