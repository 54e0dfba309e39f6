"""Which joints of a robot move, and whether its root does."""

from collections.abc import Iterable

from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.robot.description import ENTRIES, WORLD, Robot, RobotJoint
from mbdlft.robot.values import AXIAL, Values

_INERTIAS = ("actuator_inertia", "reflected_inertia")


def on_the_ground(robot: Robot, base: str | None) -> Robot:
    """The robot with its links on the ground fixed there or free, as `base` says."""
    if base is None:
        return robot
    kinds = {"fixed": "fixed", "free": "floating"}
    if base not in kinds:
        raise SceneError(f"base: expected 'fixed' or 'free', got {base!r}.")
    chosen = {
        joint.name: joint._replace(kind=kinds[base])
        for joint in robot.joints.values()
        if _is_base(joint)
    }
    if not chosen:
        roots = [joint.name for joint in robot.joints.values() if joint.parent == WORLD]
        raise SceneError(
            f"base: nothing is clamped on the ground or free: the root moves on {', '.join(roots)}. "
            "Leave out `base`."
        )
    return robot._replace(joints={**robot.joints, **chosen})


def _is_base(joint: RobotJoint) -> bool:
    """Whether the joint clamps a link on the ground or leaves it free."""
    return joint.parent == WORLD and joint.kind in ("fixed", "floating")


def moves_of(robot: Robot, moving: Iterable[str] | None) -> frozenset[str]:
    """Names of the joints that move."""
    joints = [joint for joint in robot.joints.values() if not _is_base(joint)]
    can = frozenset(joint.name for joint in joints if joint.kind != "fixed")
    always = frozenset(
        joint.name
        for joint in robot.joints.values()
        if _is_base(joint) and joint.kind == "floating"
    )
    if moving is None:
        return can | always
    if isinstance(moving, str):
        raise SceneError(f"moving: expected a list of names of joints, got the text {moving!r}.")
    chosen = frozenset(moving)
    for name in sorted(chosen):
        if name not in can:
            raise SceneError(f"moving: {unknown_name('joint that can move', name, can)}")
    for name in sorted(can - chosen):
        if robot.joints[name].kind not in (*AXIAL, "spherical"):
            raise SceneError(
                f"moving: the {robot.joints[name].kind} joint {name!r} cannot be locked; name it too, or "
                "make it a fixed joint in the file."
            )
    return chosen | always


def refuse_massless(robot: Robot, values: Values, moves: frozenset[str]) -> None:
    """Raise a SceneError for a moving joint if all links that move with it are without mass.

    A loop may move masses on its other side; then the equations say whether they can be solved.
    """
    if robot.loops:
        return
    children: dict[str, list[RobotJoint]] = {}
    for joint in robot.joints.values():
        children.setdefault(joint.parent, []).append(joint)
    for joint in robot.joints.values():
        inertias = (values.get(f"{joint.name}.{key}", 0.0) for key in _INERTIAS)
        if joint.name not in moves or any(inertia != 0.0 for inertia in inertias):
            continue
        pending, carried = [joint.child], []
        while pending:
            carried.append(pending.pop())
            pending += [other.child for other in children.get(carried[-1], [])]
        keys = ("mass", *(f"inertia.{entry}" for entry in ENTRIES))
        if all(values[f"{link}.{key}"] == 0.0 for link in carried for key in keys):
            where = f"line {joint.line}: " if joint.line else ""
            raise SceneError(
                f"{where}joint {joint.name!r} moves nothing that has a mass or an inertia: "
                f"{', '.join(carried)}. Give one of these an <inertial>, or a value to "
                f"'{joint.child}.mass' and '{joint.child}.inertia.xx', ..., or to "
                f"'{joint.name}.actuator_inertia'; or leave the joint out of `moving`."
            )
