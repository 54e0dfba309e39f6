"""Loops of robots whose two links have different axes."""

from collections.abc import Container

import numpy as np

from mbdlft.base.array import Array
from mbdlft.robot.description import RobotJoint, RobotLink, RobotLoop
from mbdlft.robot.tree import unused
from mbdlft.robot.turns import angles_of, three


def aligned(
    loop: RobotLoop, R_pc: Array, taken: Container[str]
) -> tuple[RobotLoop, tuple[RobotLink, RobotJoint] | None]:
    """The loop, on a link without mass that is welded to its child and has the axes of its parent.

    R_pc (3, 3) are the axes of the child in those of the parent. A loop of the kind ``spherical``, or
    one between equal axes, stays as it is; then there is no link.
    """
    if loop.kind == "spherical" or np.array_equal(R_pc, np.eye(3)):
        return loop, None
    name = unused(f"{loop.name}_side", taken)
    weld = RobotJoint(
        unused(f"weld_{name}", taken),
        0,
        "fixed",
        loop.child,
        name,
        xyz=loop.at_child,
        rpy=angles_of(R_pc.T),
    )
    link = RobotLink(name, 0, inertial=True)
    return loop._replace(child=name, at_child=three(np.zeros(3))), (link, weld)
