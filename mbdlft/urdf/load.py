"""Scenes of URDF files: links become bodies and joints become joints; a report lists all the rest."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mbdlft.base.description import Quantity, Vector
from mbdlft.base.errors import NotRationalError, SceneError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import parse_unit
from mbdlft.multibody.body import GROUND, Body
from mbdlft.multibody.scene.check import check
from mbdlft.multibody.scene.scene import Constant, Scene
from mbdlft.urdf.file import ENTRIES, Robot, RobotJoint, read_robot_file
from mbdlft.urdf.limits import JointLimit, check_limits
from mbdlft.urdf.make import Making, bodies, holds, joint_of, limits, unchecked, unphysical
from mbdlft.urdf.values import AXIAL, Values, check_label, numbers, set_positions, varied

GRAVITY = (0.0, 0.0, -9.81)
RIGHT_ANGLE = 1e-8  # rad: files give right angles with about ten digits


@dataclass(frozen=True, slots=True)
class ImportReport:
    """The differences between a URDF file and the scene that was made of it.

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


def load_urdf(
    path: str | Path,
    *,
    parameters: Sequence[Parameter] = (),
    values: Mapping[str, Quantity] | None = None,
    vary: Mapping[str, float] | None = None,
    constants: Mapping[str, float | Constant] | None = None,
    base: Literal["fixed", "free"] = "fixed",
    moving: Iterable[str] | None = None,
    gravity: Vector = GRAVITY,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    right_angle: float = RIGHT_ANGLE,
    keep_unphysical: bool = False,
) -> tuple[Scene, ImportReport]:
    """Make a scene of a URDF file, and a report of what was ignored and what was assumed.

    The numbers of the file have labels: ``LINK.mass``, ``LINK.center_of_mass.x``,
    ``LINK.inertia.xx`` (kg m^2, in the axes of the link, about the center of mass),
    ``JOINT.origin.x`` (m), ``JOINT.origin.roll``, ``.pitch`` and ``.yaw`` (rad). A joint that turns
    or slides also has ``JOINT.position``, ``.stiffness``, ``.damping``, ``.actuator_inertia`` and
    ``.preload``. Its position (rad or m) is 0, or the middle of its limits if they exclude 0; the
    position of a mimic joint follows that of its leader.

    Parameters
    ----------
    path : file
    parameters : sequence of `Parameter` and `Angle`
        Parameters of the model, whose names `values` can use.
    values : mapping of labels to numbers (SI) or expressions
        These replace numbers of the file:
        ``{"tool0.mass": "payload", "elbow_joint.position": "theta3"}``.
    vary : mapping of labels to percent
        Each of these numbers becomes a parameter of its own, in a range around the number of the file:
        ``{"forearm_link.mass": 20}`` makes the parameter ``forearm_link_mass``.
    constants : mapping of names to numbers, or to `Constant` with a unit
    base : {"fixed", "free"}
        Whether the root link is clamped on the ground or free; the joint is called ``root_joint``.
        Six loads on its root, ``hold_force_x`` and so on, hold a free robot against gravity; the trim
        finds their magnitudes. Replace them in the scene by the loads that really hold it.
    moving : names of joints, optional
        The joints that move; the others are locked at their positions. By default all of them move.
    gravity : three numbers or expressions (m/s^2)
    inputs, outputs : sequence of str, optional
        As in `Scene`.
    right_angle : float
        An angle of the file that differs by less than this (rad) from a multiple of a right angle is
        replaced by this multiple.
    keep_unphysical : bool
        Whether to keep inertias that no body can have (a negative moment, or one larger than the sum
        of the other two) and report them, instead of raising an error.

    Returns
    -------
    scene : Scene
    report : ImportReport

    Raises
    ------
    SceneError
        The file cannot be read or is not a robot (the message names the line), a label is unknown, a
        position leaves the limits of its joint, a joint moves nothing that has a mass, or `Scene` raises
        an error.
    NotRationalError
        A value is not rational in the parameters.
    """
    if base not in ("fixed", "free"):
        raise SceneError(f"base: expected 'fixed' or 'free', got {base!r}.")
    robot = _on_the_ground(read_robot_file(path), base)
    assumed: list[str] = []
    numbers_by_label = numbers(robot, right_angle, assumed)
    added = {
        label: varied(label, percent, numbers_by_label) for label, percent in (vary or {}).items()
    }
    for label in values or {}:
        check_label("values", label, numbers_by_label)
        if label in added:
            raise SceneError(f"{label!r} is both in vary and in values; give it in one of them.")
    chosen = {label: p.name for label, p in added.items()} | dict(values or {})
    numbers_by_label |= chosen
    set_positions(robot, numbers_by_label, set(chosen), assumed)
    moves = _moves(robot, moving)
    _refuse_massless(robot, numbers_by_label, moves)
    names = _scene_names(robot, assumed)
    making = Making(robot, numbers_by_label, names, moves)
    fields: dict[str, Any] = {
        "name": robot.name or Path(path).stem,
        "description": f"Imported from {Path(path).name}",
        "gravity": gravity,
        "constants": constants or {},
        "parameters": (*parameters, *added.values()),
        "inputs": inputs,
        "outputs": outputs,
    }
    held = base == "free" and any(gravity)
    if held:
        assumed.append(
            "forces and torques along the axes of the root, hold_..., hold the free robot"
        )
    scene = Scene(
        **fields,
        bodies=_checked(bodies(making), Scene(**fields), assumed, keep=keep_unphysical),
        joints=[joint_of(making, joint) for joint in robot.joints.values()],
        loads=holds(making) if held else (),
    )
    _check(scene, making)
    check_limits(scene, limits(making))
    if tuple(gravity) == GRAVITY:
        assumed.append("gravity is 9.81 m/s^2 against the z axis of the ground")
    return scene, ImportReport(_ignored(robot, moves), tuple(assumed), tuple(limits(making)))


def _checked(made: list[Body], scene: Scene, assumed: list[str], *, keep: bool) -> list[Body]:
    """The bodies; an inertia that no body can have is an error, or marked as unchecked if `keep`."""
    nominal = scene.constant_values() | {
        p.name: p.nominal * parse_unit(p.unit).factor for p in scene.parameters
    }
    problems = unphysical(made, nominal)
    if problems and not keep:
        name, problem = next(iter(problems.items()))
        more = f" The same holds for {', '.join([*problems][1:])}." if len(problems) > 1 else ""
        raise SceneError(
            f"body {name!r}: {problem} Correct the file or give values to '{name}.inertia.xx', ...; or "
            "take such inertias as they are: keep_unphysical=True, on the command line "
            f"--keep-unphysical.{more}"
        )
    if problems:
        assumed.append(f"inertias that no body can have are kept: {', '.join(problems)}")
    return [unchecked(body) if body.name in problems else body for body in made]


def _check(scene: Scene, making: Making) -> None:
    """Check the scene; an error on the position of a mimic joint says which joint it follows."""
    try:
        check(scene)
    except NotRationalError as error:
        for joint in making.robot.joints.values():
            if joint.mimic and f"joint {making.names[joint.name]!r}, position" in str(error):
                raise NotRationalError(
                    f"{error} The joint mimics {joint.mimic.leader!r}; give '{joint.name}.position' a "
                    "value or a parameter of its own."
                ) from None
        raise


def _on_the_ground(robot: Robot, base: str) -> Robot:
    """The robot with one more joint, the first one, from the ground to its root."""
    name = "root_joint"
    while name in robot.joints:
        name += "_"
    kind = "fixed" if base == "fixed" else "floating"
    joint = RobotJoint(name=name, line=0, kind=kind, parent=GROUND, child=robot.root)
    return robot._replace(joints={name: joint, **robot.joints})


def _moves(robot: Robot, moving: Iterable[str] | None) -> frozenset[str]:
    """Names of the joints that move."""
    base, *joints = robot.joints.values()
    can = frozenset(joint.name for joint in joints if joint.kind != "fixed")
    always = frozenset([base.name] if base.kind != "fixed" else [])
    if moving is None:
        return can | always
    if isinstance(moving, str):
        raise SceneError(f"moving: expected a list of names of joints, got the text {moving!r}.")
    chosen = frozenset(moving)
    for name in sorted(chosen):
        if name not in can:
            raise SceneError(f"moving: {unknown_name('joint that can move', name, can)}")
    for name in sorted(can - chosen):
        if robot.joints[name].kind not in AXIAL:
            raise SceneError(
                f"moving: the {robot.joints[name].kind} joint {name!r} cannot be locked; name it too, or "
                "make it a fixed joint in the file."
            )
    return chosen | always


def _refuse_massless(robot: Robot, values: Values, moves: frozenset[str]) -> None:
    """Raise a SceneError for a moving joint if all links that move with it are without mass."""
    children: dict[str, list[RobotJoint]] = {}
    for joint in robot.joints.values():
        children.setdefault(joint.parent, []).append(joint)
    for joint in robot.joints.values():
        if joint.name not in moves or values.get(f"{joint.name}.actuator_inertia", 0.0) != 0.0:
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


def _scene_names(robot: Robot, assumed: list[str]) -> Mapping[str, str]:
    """Names of links and joints in the scene, by name in the file.

    They differ from those of the file where a scene cannot have the name: a dot separates a body from
    its port, and ``ground`` is the name of the ground.
    """
    names = {name: name.replace(".", "_") for name in (*robot.links, *robot.joints)}
    if GROUND in robot.links:
        names[GROUND] = f"{GROUND}_link"
    renamed = [f"{old} is {new}" for old, new in names.items() if old != new]
    if renamed:
        assumed.append(f"names that a scene cannot have: {', '.join(renamed)}")
    return names


def _ignored(robot: Robot, moves: frozenset[str]) -> tuple[str, ...]:
    """Sentences on the contents of the file that the scene does not have."""
    joints = [joint for joint in robot.joints.values() if joint.name in moves]
    ignored = [f"<{tag}>: {count}" for tag, count in robot.others.items()]
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
    planar = [
        joint.name for joint in joints if joint.kind in ("planar", "floating") and joint.damping
    ]
    if planar:
        ignored.append(f"damping of {', '.join(planar)}: give it in the scene")
    return tuple(ignored)
