"""The tree of links and joints: unique names, its root, and links without mass that are added to it."""

from collections.abc import Container, Mapping, Sequence
from typing import TypeVar

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.robot.description import ZERO, RobotJoint, RobotLink, RobotLoop
from mbdlft.robot.turns import angles_of, three

Side = tuple[RobotLink, RobotJoint]
Item = TypeVar("Item", RobotLink, RobotJoint)


def unique(what: str, items: Sequence[Item]) -> dict[str, Item]:
    """The items by name; a SceneError if two have one name."""
    found: dict[str, Item] = {}
    for item in items:
        if item.name in found:
            raise SceneError(
                f"line {item.line}: {what} {item.name!r} is given twice; first in line "
                f"{found[item.name].line}."
            )
        found[item.name] = item
    return found


def unused(name: str, taken: Container[str]) -> str:
    """The name, with underscores after it until nothing else has it."""
    while name in taken:
        name += "_"
    return name


def root_of(links: Mapping[str, RobotLink], joints: Sequence[RobotJoint]) -> str:
    """The name of the only link without a parent, from which joints lead to all other links."""
    above: dict[str, RobotJoint] = {}
    for joint in joints:
        for side, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise SceneError(
                    f"line {joint.line}: joint {joint.name!r}, {side}: "
                    + unknown_name("link", name, links)
                )
        if joint.child in above:
            raise SceneError(
                f"line {joint.line}: link {joint.child!r} has two parents: it is the child of joints "
                f"{above[joint.child].name!r} and {joint.name!r}, so the joints close a loop. A robot is "
                "a tree; remove one of the two."
            )
        above[joint.child] = joint
    roots = [name for name in links if name not in above]
    for name in links:
        chain = [name]
        while chain[-1] in above:
            chain.append(above[chain[-1]].parent)
            if chain[-1] in chain[:-1]:
                loop = " -> ".join(reversed(chain[chain.index(chain[-1]) :]))
                raise SceneError(
                    f"line {above[chain[-1]].line}: the joints close a loop: {loop}. A robot is a tree; "
                    "open the loop at one joint."
                )
    if len(roots) > 1:
        raise SceneError(
            f"there are {len(roots)} links without a parent: {', '.join(roots)}. A robot is a tree with "
            "one root; connect the others to it, by a fixed joint if they are clamped on it."
        )
    return roots[0]


def welded(link: str, weld: str, parent: str, place: Array, R: Array, line: int = 0) -> Side:
    """A link without mass at a place (3,) of its parent, with the axes R (3, 3), and the joint `weld`."""
    joint = RobotJoint(weld, line, "fixed", parent, link, three(place), angles_of(R))
    return RobotLink(link, line, inertial=True), joint


def aligned(loop: RobotLoop, R_pc: Array, taken: Container[str]) -> tuple[RobotLoop, list[Side]]:
    """The loop, on a link without mass that is welded to its child and has the axes of its parent.

    R_pc (3, 3) are the axes of the child in those of the parent. A loop of the kind ``spherical``, or
    one between equal axes, stays as it is; then there is no link.
    """
    if loop.kind == "spherical" or np.array_equal(R_pc, np.eye(3)):
        return loop, []
    name = unused(f"{loop.name}_side", taken)
    at = np.array(loop.at_child)
    side = welded(name, unused(f"weld_{name}", taken), loop.child, at, R_pc.T)
    return loop._replace(child=name, at_child=ZERO), [side]
