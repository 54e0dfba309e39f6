"""Rotations as roll, pitch and yaw, with the right angles that they have.

R = R_z(yaw) R_y(pitch) R_x(roll)
"""

import math

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError
from mbdlft.robot.description import Triple

_STEEP = 1e-9  # cosine of a pitch near 90 deg, where yaw and roll turn about the same axis


def of_quaternion(quaternion: Array) -> Array:
    """The rotation (3, 3) of a quaternion (4,), w first; its length is ignored.

    Raises
    ------
    SceneError
        The quaternion is zero, or not finite.
    """
    size = float(np.max(np.abs(quaternion)))
    if not 0.0 < size < np.inf:
        listed = " ".join(f"{entry:g}" for entry in quaternion)
        raise SceneError(f"the quaternion {listed} is no rotation; its length must not be zero.")
    entries = np.asarray(quaternion, dtype=float) / size  # no overflow
    w, x, y, z = entries / np.linalg.norm(entries)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def of_angles(rpy: Triple) -> Array:
    """The rotation (3, 3) of roll, pitch and yaw (rad)."""
    turned = np.eye(3)
    for axis, angle in enumerate(rpy):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[[i, j], [i, j]] = math.cos(angle)
        turn[i, j], turn[j, i] = -math.sin(angle), math.sin(angle)
        turned = turn @ turned
    return turned


def between(a: Array, b: Array) -> Array:
    """The rotation (3, 3) by the least angle that turns the direction `a` (3,) into that of `b`.

    Raises
    ------
    SceneError
        One of them is zero, or not finite.
    """
    with np.errstate(all="ignore"):
        u, v = (vector / np.max(np.abs(vector)) for vector in (a, b))
        u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    if not np.isfinite([u, v]).all():
        raise SceneError("a direction has no length; expected three numbers that are not all zero.")
    half = u + v
    if np.linalg.norm(half) < _STEEP:  # opposite: half a turn about any axis across
        across = np.cross(u, np.eye(3)[np.argmin(np.abs(u))])
        across /= np.linalg.norm(across)
        return 2.0 * np.outer(across, across) - np.eye(3)
    half /= np.linalg.norm(half)
    # a half turn about a, then one about the direction in the middle
    return (2.0 * np.outer(half, half) - np.eye(3)) @ (2.0 * np.outer(u, u) - np.eye(3))


def angles_of(R: Array) -> Triple:
    """Roll, pitch and yaw (rad) of a rotation (3, 3).

    The rotation of these angles is R up to rounding, also near a pitch of 90 deg, where each of roll and
    yaw alone is not determined: the yaw is zero there.
    """
    cosine = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], cosine)
    yaw = math.atan2(R[1, 0], R[0, 0]) if cosine > _STEEP else 0.0
    along = np.array([-math.sin(yaw), math.cos(yaw), 0.0])  # the second row of R_z(-yaw)
    roll = math.atan2(-(along @ R[:, 2]), along @ R[:, 1])
    return roll, pitch, yaw


def three(vector: Array) -> Triple:
    """The entries of a vector (3,) as numbers, without negative zeros."""
    x, y, z = (float(entry) + 0.0 for entry in vector)
    return x, y, z
