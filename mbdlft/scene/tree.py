"""The tree of a scene: every body hangs on one joint, and the ground is the root."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

from mbdlft.body import GROUND, Body, Ground
from mbdlft.errors import SceneError, unknown_name
from mbdlft.joint import Joint
from mbdlft.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class Link:
    """One joint with the body it carries; ports by name."""

    joint: Joint
    parent: Body
    parent_port: str
    child: Body
    child_port: str


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
        links[child.name] = Link(joint, parent, parent_port, child, child_port)
    return _from_the_root(scene, links)


def all_bodies(scene: Scene) -> dict[str, Body]:
    """Bodies by name, the ground among them."""
    return {GROUND: Ground()} | {body.name: body for body in scene.bodies}


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
        raise SceneError(
            f"{owner}, {key}: body {name!r}: " + unknown_name("port", port, body.port_names())
        )
    return body, port if dot else "origin"


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
