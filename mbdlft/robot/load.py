"""Scenes of robots: links become bodies and joints become joints; a report lists what else the file has.

Each format has a reader of its own: URDF, also written in xacro, SDF and MJCF. The equilibrium must be
inside the limits of the joints for every value of the parameters.
"""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from itertools import product
from math import atan
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

import numpy as np

from mbdlft.base.description import Expected, Quantity
from mbdlft.base.errors import NotRationalError, SceneError, naming
from mbdlft.base.expression import evaluate, names
from mbdlft.base.parameter import Parameter
from mbdlft.base.worker import arrays_of, content_of
from mbdlft.multibody.body import Body, RigidBody
from mbdlft.multibody.coupling import Linear, Mimic
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.scene.checks import check
from mbdlft.multibody.scene.quantities import Place, angle_at, expression_at
from mbdlft.multibody.scene.scene import Constant, Scene
from mbdlft.robot import make
from mbdlft.robot.mjcf import read_mjcf
from mbdlft.robot.robot import JointLimit, Robot, RobotCoupling, body_name, said, unused
from mbdlft.robot.sdf import read_sdf
from mbdlft.robot.urdf import Element, parse, read_urdf

GRAVITY = (0.0, 0.0, -9.81)  # m/s^2, of files that do not say
RIGHT_ANGLE = 1e-8  # rad: files give right angles with about ten digits
_P = ParamSpec("_P")
_R = TypeVar("_R")
_SECONDS = 10  # of the processor, to expand a xacro file: its expressions can ask for anything
_ROUNDING = 1e-12  # a position may leave a limit by this part of it


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


def read_robot(path: str | Path, model: str | None = None, keyframe: str | None = None) -> Robot:
    """Read a robot from a file; errors name the file.

    `model` chooses one of an SDF file, `keyframe` the positions of an MJCF file.
    """
    file = Path(path)
    top = top_of(file)
    try:
        for option, choice, tag, name in (
            ("model", model, "sdf", "an SDF"),
            ("keyframe", keyframe, "mujoco", "an MJCF"),
        ):
            if choice is not None and top.tag != tag:
                raise SceneError(f"{option} = {choice!r}: only {name} file has this, got <{top.tag}>.")
        if top.tag == "robot":
            return read_urdf(top)
        if top.tag == "sdf":
            return read_sdf(top, model)
        if top.tag == "mujoco":
            return read_mjcf(file, top, keyframe)
        raise SceneError(
            f"line {top.line}: expected a robot, whose first element is <robot> (URDF), <sdf> or "
            f"<mujoco> (MJCF), got <{top.tag}>."
        )
    except SceneError as error:
        raise SceneError(f"{file}: {error}") from None
    except RecursionError:
        raise SceneError(
            f"{file}: its elements are in each other, or follow each other, hundreds of times; expected "
            "a robot with fewer."
        ) from None


def top_of(file: Path) -> Element:
    """The first element of a file, expanded if it is written in xacro; errors name the file.

    Python evaluates the expressions of a xacro file, so its name must say that it is one.
    """
    content = content_of(file, SceneError)
    with naming(file, SceneError):
        top = parse(content)
        is_xacro = file.suffix.lower() == ".xacro" and top.tag == "robot"
        return parse(_expanded(file)) if is_xacro else top


def _expanded(file: Path) -> bytes:
    """The URDF text of a xacro file, with the default values of its arguments."""
    try:
        import xacro
    except ImportError:
        raise SceneError(
            "xacro files are expanded by the package xacro, which is not installed: pip install "
            "'mbdlft[xacro]'."
        ) from None
    arguments = {"path": str(file)}
    allowed: dict[str, Any] = {"seconds": _SECONDS, "memory": 2**30, "error": SceneError}
    made = arrays_of("mbdlft.robot.expanding:expanded", arguments, **allowed, libraries=(xacro.__name__,))
    return made["text"].tobytes()


def _naming_its_file(load: Callable[_P, _R]) -> Callable[_P, _R]:
    """Begin each error with the file, the first argument: most are found after it was read."""

    @wraps(load)
    def named(*given: _P.args, **options: _P.kwargs) -> _R:
        with naming(Path(str(given[0]))):
            return load(*given, **options)

    return named


@_naming_its_file
def load_robot(
    path: str | Path,
    *,
    parameters: Sequence[Parameter] = (),
    values: Mapping[str, float | str] | None = None,
    vary: Mapping[str, float] | None = None,
    constants: Mapping[str, float | Constant] | None = None,
    base: Literal["fixed", "free"] | None = None,
    moving: Iterable[str] | None = None,
    gravity: Sequence[float | str] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    right_angle: float = RIGHT_ANGLE,
    keep_unphysical: bool = False,
    model: str | None = None,
    keyframe: str | None = None,
) -> tuple[Scene, ImportReport]:
    """Make a scene of a URDF, SDF or MJCF file, and a report of what was ignored and what was assumed.

    The first element of the file says which format it has: ``<robot>``, ``<sdf>`` or ``<mujoco>``. MJCF
    files are compiled by the package mujoco; URDF files that are written in xacro are expanded by the
    package xacro.

    The numbers of the file have labels: ``LINK.mass``, ``LINK.center_of_mass.x``, ``LINK.inertia.xx``
    (kg m^2, in the axes of the link, about the center of mass), ``JOINT.origin.x`` (m, in the parent),
    ``JOINT.origin.roll``, ``.pitch`` and ``.yaw`` (rad), and ``JOINT.anchor.x`` (m, in the child). A
    joint that turns or slides also has ``JOINT.position``, ``.stiffness``, ``.damping``,
    ``.actuator_inertia``, ``.reflected_inertia`` and ``.preload``. Its position (rad or m) is 0, or the
    middle of its limits if they exclude 0; the position of a mimic joint follows that of its leader. A
    position is counted from the place that the file gives to the links.

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
    base : {"fixed", "free"}, optional
        Whether the root link is clamped on the ground or free; by default as the file says, which is
        fixed for URDF. The joint is called ``root_joint`` if the file does not name it. Six loads on a
        free link, ``hold_force_x`` and so on, hold it against gravity; the trim finds their magnitudes.
        Replace them in the scene by the loads that really hold it.
    moving : names of joints, optional
        The joints that move; the others are locked at their positions. By default all of them move.
    gravity : three numbers or expressions (m/s^2), optional
        By default that of the file, or 9.81 m/s^2 against the z axis.
    inputs, outputs : sequence of str, optional
        As in `Scene`. By default the inputs are what the actuators of an MJCF file act on.
    right_angle : float
        An angle of the file that differs by less than this (rad) from a multiple of a right angle is
        replaced by this multiple.
    keep_unphysical : bool
        Whether to keep inertias that no body can have (a negative moment, or one larger than the sum
        of the other two) and report them, instead of raising an error.
    model : str, optional
        Which model of an SDF file that has several.
    keyframe : str, optional
        The keyframe of an MJCF file whose positions are taken.

    Raises
    ------
    SceneError
        The file cannot be read or is not a robot (the message names the line), it has what a scene
        cannot have, a label is unknown, a position leaves the limits of its joint, a joint moves nothing
        that has a mass, or `Scene` raises an error.
    NotRationalError
        A value is not rational in the parameters.
    """
    robot = make.on_the_ground(read_robot(path, model, keyframe), base)
    numbers = make.numbers(robot, right_angle, assumed := list(robot.assumed))
    added = {label: make.varied(label, percent, numbers) for label, percent in (vary or {}).items()}
    chosen = _chosen(added, values or {}, numbers)
    make.set_positions(robot, numbers, set(chosen), assumed)
    moves = make.moves_of(robot, moving)
    make.refuse_massless(robot, numbers, moves)
    making = make.Making(robot, numbers, _scene_names(robot, assumed), moves)
    earth = gravity if gravity is not None else (robot.gravity or GRAVITY)
    fields: dict[str, Any] = {
        "name": robot.name or Path(path).stem,
        "description": f"Imported from {Path(path).name}",
        "gravity": earth,
        "constants": constants or {},
        "parameters": (*parameters, *added.values()),
    }
    if held := make.holds(making) if any(earth) else []:
        assumed.append("forces and torques along the axes of the root, hold_..., hold the free robot")
    joints = [make.joint_of(making, joint) for joint in robot.joints.values()]
    scene = Scene(
        **fields,
        bodies=_checked(make.bodies(making), Scene(**fields), assumed, keep=keep_unphysical),
        joints=joints,
        loads=[*(make.load_of(making, load) for load in robot.loads), *held],
        sensors=make.sensors(making),
        loops=make.loops(making),
        couplings=_couplings(making, [*making.names.values(), *(load.name for load in held)], assumed),
        inputs=inputs if inputs is not None else _inputs(making, joints),
        outputs=outputs if outputs is not None else _outputs(making, joints),
    )
    _check(scene, making)
    # limits may exclude the place where the file closes its loops
    stay = {
        making.names[joint.name]
        for joint in robot.joints.values()
        if robot.loops and make.outside(joint) and f"{joint.name}.position" not in chosen
    }
    limits = make.limits(making)
    check_limits(scene, {k: position for k, position in limits.items() if k.joint not in stay})
    if gravity is None and robot.gravity is None:
        assumed.append("gravity is 9.81 m/s^2 against the z axis of the ground")
    return scene, ImportReport(ignored_of(making), tuple(assumed), tuple(limits))


def _couplings(making: make.Making, taken: Container[str], assumed: list[str]) -> list[Mimic | Linear]:
    """Joints that follow others, by the multipliers of the file, and tendons over those that move."""
    mimics = [
        Mimic(
            name=unused(f"{making.names[joint.name]}_mimic", taken),
            joint=making.names[joint.name],
            leader=making.names[making.leader(joint)],
            multiplier=joint.mimic.multiplier,
        )
        for joint in making.robot.joints.values()
        if joint.mimic and making.leader(joint)
    ]
    tendons = (each for each in making.robot.couplings if each.couples(making.moves))
    return [*mimics, *(_tendon(making, coupling, taken, assumed) for coupling in tendons)]


def _tendon(
    making: make.Making, coupling: RobotCoupling, taken: Container[str], assumed: list[str]
) -> Linear:
    """The relation of the joints that move; the others keep their positions.

    A force at rest, which is linear in angles, is no rational function of their parameters.
    """
    factors = {making.names[name]: c for name, c in coupling.factors.items() if name in making.moves}
    places = {name: making.values[f"{name}.position"] for name in coupling.factors}
    known = {name: x for name, x in places.items() if isinstance(x, float | int)}
    terms = {name: coupling.factors[name] * x for name, x in known.items()}
    is_known, laws = len(terms) == len(places), dict[str, Any]()
    if coupling.stiffness is not None:
        force = -coupling.stiffness * (sum(terms.values()) - coupling.offset) if is_known else 0.0
        laws = {"stiffness": coupling.stiffness, "damping": coupling.damping, "preload": force}
        if not is_known:
            assumed.append(f"the efforts of its joints at rest have the force of {coupling.name} in them")
    elif is_known:
        locked = sum(term for name, term in terms.items() if name not in making.moves)
        laws = {"offset": coupling.offset - locked}
    return Linear(name=unused(coupling.name.replace(".", "_"), taken), factors=factors, **laws)


def _chosen(
    added: Mapping[str, Parameter], values: Mapping[str, Quantity], file: make.Values
) -> dict[str, Quantity]:
    """What the user gives for numbers of the file, by label; it replaces them in `file`."""
    for label in values:
        make.check_label("values", label, file)
        if label in added:
            raise SceneError(f"{label!r} is both in vary and in values; give it in one of them.")
    chosen = {label: p.name for label, p in added.items()} | dict(values)
    file |= chosen
    return chosen


def _inputs(making: make.Making, joints: Sequence[Joint]) -> list[str] | None:
    """Signals of the joints and loads that have an actuator, or None if the file has no actuators."""
    if making.robot.inputs is None:
        return None
    chosen = {making.names[name] for name in making.robot.inputs}
    efforts = [f"{j.name}.{f.effort.name}" for j in joints if j.name in chosen for f in j.freedoms]
    thrusts = (load for load in making.robot.loads if load.name in making.robot.inputs)
    return [*efforts, *(f"{making.names[load.name]}.{load.kind}" for load in thrusts)] or None


def _outputs(making: make.Making, joints: Sequence[Joint]) -> list[str] | None:
    """All positions and sensors, and the rates that are measured; None if none are."""
    rates = {making.names[name] for name in making.robot.rates}
    if not rates:
        return None
    positions = [f"{j.name}.{f.measures[0].name}" for j in joints for f in j.freedoms]
    measured = [f"{j.name}.{f.measures[1].name}" for j in joints if j.name in rates for f in j.freedoms]
    sensed = [signal.name for sensor in make.sensors(making) for signal in sensor.signals()]
    return [*positions, *measured, *sensed]


def _checked(made: list[Body], scene: Scene, assumed: list[str], *, keep: bool) -> list[Body]:
    """The bodies; an inertia that no body can have is an error, or marked as unchecked if `keep`."""
    problems = make.unphysical(scene, made)
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
    return [
        body.model_copy(update={"inertia": body.inertia.model_copy(update={"unchecked": True})})
        if body.name in problems and isinstance(body, RigidBody)
        else body
        for body in made
    ]


def _check(scene: Scene, making: make.Making) -> None:
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


load_urdf = load_robot  # its name in earlier versions


def _scene_names(robot: Robot, assumed: list[str]) -> Mapping[str, str]:
    """Names of links and joints in the scene, by name in the file.

    They differ from those of the file where a scene cannot have the name: a dot separates a body from
    its port, and ``ground`` is the name of the ground.
    """
    known = [*robot.links, *robot.joints, *(load.name for load in robot.loads)]
    known += [sensor.name for sensor in robot.sensors] + [loop.name for loop in robot.loops]
    names = {name: name.replace(".", "_") for name in known}
    names |= {link: body_name(link) for link in robot.links}
    renamed = (f"{old} is {new}" for old, new in names.items() if old != new)
    assumed += said("names that a scene cannot have: {}", renamed)
    return names


def ignored_of(making: make.Making) -> tuple[str, ...]:
    """Sentences on the contents of the file that the scene does not have."""
    robot = making.robot
    joints = [joint for joint in robot.joints.values() if joint.name in making.moves]
    bounded = [joint.name for joint in joints if joint.effort or joint.velocity]
    limited = f"limits of effort and velocity of {len(bounded)} joints; the report has them"
    alone = (j.name for j in joints if j.mimic and j.kind in make.AXIAL and not making.leader(j))
    still = (j.name for j in robot.joints.values() if j.mimic and not j.mimic.multiplier)
    slack = (c.name for c in robot.couplings if not c.couples(making.moves))
    planar = (joint.name for joint in joints if joint.kind == "planar" and joint.damping)
    return (
        *(f"<{tag}>: {count}" for tag, count in robot.others.items()),
        *robot.ignored,
        *said("Coulomb friction of {}: it is not linear", (j.name for j in joints if j.friction)),
        *([limited] if bounded else []),
        *said(
            "<mimic> of {}: their leaders do not move, and their motions are free; leave them out of "
            "`moving` to lock them",
            alone,
        ),
        *said("<mimic> of {}: the multiplier is 0, so they do not move", still),
        *said("couplings {}: fewer than two of their joints move", slack),
        *said("damping of {}: give it in the scene", planar),
    )


def check_limits(scene: Scene, positions: Mapping[JointLimit, Quantity]) -> None:
    """Raise a SceneError for the first joint whose position leaves its limits for some parameters."""
    for limit, position in positions.items():
        if limit.lower is None or limit.upper is None:
            continue
        low, high = position_range(scene, limit.joint, Expected(position, limit.unit))
        below, above = (_ROUNDING * abs(end) for end in (limit.lower, limit.upper))
        if low < limit.lower - below or high > limit.upper + above:
            raise SceneError(
                f"joint {limit.joint!r}, position = {position!r}: its values [{_both(low, limit.unit)}, "
                f"{_both(high, limit.unit)}] leave the limits of the file "
                f"[{_both(limit.lower, limit.unit)}, {_both(limit.upper, limit.unit)}]. Narrow the range "
                "of its parameters, or change the limits in the file."
            )


def position_range(scene: Scene, joint: str, expected: Expected) -> tuple[float, float]:
    """Least and largest equilibrium position (rad or m) at the corners of the range of the parameters.

    For a sum of angles these are the ends of its range.
    """
    place = Place(f"joint {joint!r}", "position")
    expression = expression_at(place, expected)
    angle = angle_at(scene, place, expected) if expected.unit == "rad" else None

    def position(values: Mapping[str, float]) -> float:
        if angle is None:
            return float(evaluate(expression, values))
        turned = sum(count * values[name] for name, count in angle.multiples.items())
        halves = angle.arctangents.items()
        return float(angle.constant + turned + sum(n * atan(evaluate(r, values)) for r, n in halves))

    used = [p for p in scene.parameters if p.name in names(expression)]
    ends = [[(p.name, end * p.factor) for end in (p.low, p.high)] for p in used]
    positions = [position(scene.constant_values() | dict(corner)) for corner in product(*ends)]
    return min(positions), max(positions)


def _both(value: float, unit: str) -> str:
    """A value as a text for a message, with that in degrees if it is an angle."""
    if unit != "rad":
        return f"{value:.6g} {unit}"
    return f"{value:.6g} rad = {np.degrees(value):.6g} deg"
