"""Where everything of a scene is, at any parameters and positions: points and directions in SX.

Every frame leads from the one of its parent by the moves of the joint, R_0c = R_0p R_pc and
r_0c = r_0p + R_0p r_pc (see `mbdlft.multibody.spatial`), with 0 the axes of the ground. All points (m)
and directions are columns (3,) in these axes; they are functions of the physical values of the
parameters, in their units, and of the displacements q from the equilibrium (rad, m).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca

from mbdlft.base.description import Values
from mbdlft.multibody.assembly.closure import gap_of
from mbdlft.multibody.assembly.coupled import quantity_value, relations, rigid
from mbdlft.multibody.assembly.kinematics import View, position
from mbdlft.multibody.assembly.resolved import Resolved, resolve
from mbdlft.multibody.assembly.tree import Owned, coordinate_owners
from mbdlft.multibody.body import GROUND
from mbdlft.multibody.force import Load
from mbdlft.multibody.joint import coordinate_label
from mbdlft.multibody.joint.move import Hinge, Move, Slide
from mbdlft.multibody.scene.quantities import Place, owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.problem.equations import physical_symbols
from mbdlft.problem.sx.constants import in_doubles


class Frame(NamedTuple):
    """Origin r (3,) and axes R (3, 3) of a frame."""

    r: ca.SX
    R: ca.SX

    def at(self, point: ca.SX) -> ca.SX:
        """A point (3,) of the frame, from the origin of the ground (m)."""
        return self.r + ca.mtimes(self.R, point)


class Moving(NamedTuple):
    """The axis (3,) of one coordinate of a joint; whether it turns about it."""

    axis: ca.SX
    turns: bool


class JointPose(NamedTuple):
    """The ports of a joint on its parent and its child, and its axes."""

    parent: ca.SX
    child: ca.SX
    axes: tuple[Moving, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """A scene in motion, in the axes of its user; its coordinates stand by joint and elastic body.

    Bodies have the `frames` of their origins, by name, and `inboard` those of the ports that hold them.
    """

    resolved: Resolved
    view: View
    owned: tuple[Owned, ...]
    frames: Mapping[str, Frame] = field(default_factory=dict)
    inboard: Mapping[str, Frame] = field(default_factory=dict)
    joints: Mapping[str, JointPose] = field(default_factory=dict)

    @property
    def scene(self) -> Scene:
        return self.resolved.scene

    def port(self, port: str) -> ca.SX:
        """The point (3,) of ``body`` or ``body.port``, from the origin of the ground (m)."""
        body, name = self.view.find(port)
        return self.frames[body].at(position(self.view.now.bodies[body], name, self.values))

    @property
    def values(self) -> Mapping[str, Values]:
        """Quantities by owner and label."""
        return self.resolved.values

    def as_function(self, expressions: ca.SX, name: str) -> ca.Function:
        """A function (physical values (n_p,), q (n,)) of expressions, without exact constants."""
        symbols = self.resolved.symbols
        physical, p, cosine, sine = physical_symbols(self.resolved.parameters)
        normalized = ca.Function(
            name,
            [symbols.p, symbols.cosine, symbols.sine, symbols.q],
            [ca.densify(in_doubles(ca.densify(expressions)))],
        )
        q = ca.SX.sym("q", symbols.q.numel())
        return ca.Function(name, [physical, q], [normalized(p, cosine, sine, q)])


def scene_poses(scene: Scene) -> Poses:
    """The frames of a scene as functions of its parameters and positions; errors as of `resolve`."""
    r = resolve(scene)
    view = r.view()
    identity = Frame(ca.SX(3, 1), ca.SX.eye(3))
    inboard, frames, joints = {GROUND: identity}, {GROUND: identity}, {}
    for link in r.links:
        name, parent = link.child.name, inboard[link.parent.name]
        start = Frame(parent.at(view.now.arms[name]), parent.R)
        frame, axes = start, []
        for move in view.now.moves[name]:
            axes += _axes(move, frame)
            frame = Frame(frame.at(move.offset()), ca.mtimes(frame.R, _turned(move)))
        inboard[name] = frame
        frames[name] = Frame(frame.at(-view.now.inboard[name]), frame.R)
        joints[link.joint.name] = JointPose(start.r, frame.r, tuple(axes))
    return Poses(r, view, tuple(coordinate_owners(r.links)), frames, inboard, joints)


def _turned(move: Move) -> ca.SX:
    """R_pc (3, 3) of a move."""
    return move.in_parent_axes(ca.SX.eye(3))


def _axes(move: Move, frame: Frame) -> list[Moving]:
    """Axes of the coordinates of one move; a ball has those of its frame."""
    if isinstance(move, Hinge | Slide):
        return [Moving(ca.mtimes(frame.R, move.axis), isinstance(move, Hinge))]
    if move.degrees_of_freedom == 3:
        turned = ca.mtimes(frame.R, _turned(move))
        return [Moving(turned[:, k], turns=True) for k in range(3)]
    return []


def load_wrenches(poses: Poses, load: Load) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
    """Point, force and torque (3,) of a load at a magnitude of one, at each of its ports."""
    view = poses.view
    view.owner = owner_name(load)
    view.elastic = 0.0  # the magnitude alone, without what follows it
    try:
        on_bodies = load.wrenches(poses.values[view.owner], ca.SX(1.0), view)
    finally:
        view.elastic = 1.0
    still = ca.SX.zeros(poses.resolved.symbols.v.numel())
    wrenches = []
    for on, port in zip(on_bodies, load.ports().values(), strict=True):
        force, torque = ca.horzsplit(ca.substitute(on.wrench, poses.resolved.symbols.v, still))
        frame, point = poses.inboard[on.body], poses.port(port)
        arm = point - frame.r
        force = ca.mtimes(frame.R, force)
        torque = ca.mtimes(frame.R, torque) - ca.cross(arm, force)
        wrenches.append((point, force, torque))
    return wrenches


def equilibrium_positions(poses: Poses) -> list[ca.SX | None]:
    """Positions (rad, m) of all coordinates at equilibrium; None where a coordinate has none."""
    items = {owner_name(joint): joint for joint in poses.scene.joints}
    positions: list[ca.SX | None] = []
    for owned in poses.owned:
        quantities = items[owned.owner].quantities() if owned.owner in items else {}
        for freedom in owned.freedoms:
            place = Place(owned.owner, coordinate_label("position", freedom))
            expected, symbols = quantities.get(place.label), poses.resolved.symbols
            scene, values = poses.scene, poses.values.get(owned.owner, {})
            positions.append(
                None if expected is None else quantity_value(scene, place, expected, symbols, values)
            )
    return positions


def gaps(poses: Poses) -> ca.SX:
    """What closures of loops and rigid couplings keep at zero (m, rad, sines, cosines less 1)."""
    rows = []
    for loop in poses.scene.loops:
        gap, cosines = gap_of(loop, poses.view)
        rows += [gap, 1.0 - cosines]
    follow = relations(poses.scene, rigid(poses.scene), poses.view)
    return ca.vertcat(ca.SX(0, 1), *rows, ca.mtimes(follow, poses.resolved.symbols.q))
