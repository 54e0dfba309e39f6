"""The report of an import: what the scene does not have of the file, and the file not of the scene."""

from dataclasses import dataclass

from mbdlft.robot.description import Robot
from mbdlft.robot.limits import JointLimit
from mbdlft.robot.values import AXIAL


@dataclass(frozen=True, slots=True)
class ImportReport:
    """The differences between the file of a robot and the scene that was made of it.

    Attributes
    ----------
    ignored : tuple of str
        Contents of the file that the scene does not have: geometry, friction, transmissions, ...
    assumed : tuple of str
        Contents of the scene that the file does not have: gravity, positions, right angles, names, ...
    limits : tuple of JointLimit
        Limits of the joints that turn or slide: position (rad or m), effort (N m or N), rate (rad/s
        or m/s).
    """

    ignored: tuple[str, ...]
    assumed: tuple[str, ...]
    limits: tuple[JointLimit, ...]

    def __str__(self) -> str:
        lines = [f"ignored: {line}" for line in self.ignored]
        return "\n".join(lines + [f"assumed: {line}" for line in self.assumed])


def ignored_of(robot: Robot, moves: frozenset[str]) -> tuple[str, ...]:
    """Sentences on the contents of the file that the scene does not have."""
    joints = [joint for joint in robot.joints.values() if joint.name in moves]
    ignored = [f"<{tag}>: {count}" for tag, count in robot.others.items()] + [*robot.ignored]
    rubbing = [joint.name for joint in joints if joint.friction]
    if rubbing:
        ignored.append(f"Coulomb friction of {', '.join(rubbing)}: it is not linear")
    bounded = [joint.name for joint in joints if joint.effort or joint.velocity]
    if bounded:
        ignored.append(
            f"limits of effort and velocity of {len(bounded)} joints; the report has them"
        )
    coupled = [joint.name for joint in joints if joint.mimic and joint.kind in AXIAL]
    if coupled:
        ignored.append(
            f"<mimic> of {', '.join(coupled)}: their positions follow their leaders, their motions are "
            "free; leave them out of `moving` to lock them"
        )
    planar = [joint.name for joint in joints if joint.kind == "planar" and joint.damping]
    if planar:
        ignored.append(f"damping of {', '.join(planar)}: give it in the scene")
    return tuple(ignored)
