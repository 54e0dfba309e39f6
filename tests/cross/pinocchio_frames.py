"""Configurations of pinocchio for displacements of the coordinates of a scene."""

import numpy as np
import pinocchio as pin

import mbdlft
from tests.cross.pinocchio_tree import Tree


def configuration(scene: mbdlft.Scene, tree: Tree, displaced: dict[str, float]) -> np.ndarray:
    """Configuration (nq,) for displacements (rad, m) from the equilibrium by name."""
    q, model = np.array(tree.q), tree.model
    by_velocity = np.zeros(model.nv)
    for joint in scene.joints:
        names = [f"{joint.name}.{freedom.measures[0].name}" for freedom in joint.freedoms]
        for place, name in zip(tree.coordinates[joint.name], names, strict=True):
            by_velocity[place] = displaced[name]
    for joint in list(model.joints)[1:]:
        own = by_velocity[joint.idx_v : joint.idx_v + joint.nv]
        if joint.nv == 3:  # 2 tan(angle/2) along the axis, a quaternion in pinocchio
            size = np.linalg.norm(own)
            turn = own / size * (2.0 * np.arctan(size / 2.0)) if size else own
            q[joint.idx_q : joint.idx_q + 4] = pin.Quaternion(pin.exp3(turn)).coeffs()
        elif joint.nv == 1:
            q[joint.idx_q] += own[0]
    return q
