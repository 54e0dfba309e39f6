"""Contacts of the bodies of a tree with the ground: their constraints, reactions and what is checked."""

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import AXES, Values
from mbdlft.base.errors import SceneError
from mbdlft.multibody.assembly.kinematics import View, port_arm
from mbdlft.multibody.contact import Contact, Rolling
from mbdlft.multibody.force import BodyWrench
from mbdlft.multibody.joint import Revolute
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import column
from mbdlft.problem.sx.constants import unit_vector

_GAP = 1e-9  # of the lengths, or of the speed, of the scene: what is farther off does not touch, or slips


def values_of(contact: Contact, view: View) -> Values:
    """The quantities of a contact, and the steady ``rate`` of its body (rad/s); messages name it now."""
    values = view.owned(contact)
    body = view.find(contact.port)[0]
    rates = (
        view.now.values[link.owner].get("rate", 0.0) for link in view.now.links if link.child.name == body
    )
    return {**values, "rate": next(rates, 0.0)}


def velocity_of(scene: Scene, view: View) -> ca.SX:
    """Velocity (3,) of the scene over the ground (m/s)."""
    uniform = view.now.values[f"scene {scene.name!r}"]
    return column(uniform[f"velocity.{axis}"] for axis in AXES)


def contact_rows(scene: Scene, view: View, order: int) -> tuple[ca.SX, ca.SX]:
    """Constraints of one order: holonomic ones of all contacts, and those of rates."""
    velocity = velocity_of(scene, view)
    rows = [c.rows(values_of(c, view), view, order, velocity) for c in scene.contacts]
    held, rolling = zip(*rows, strict=True) if rows else ((), ())
    return ca.vertcat(ca.SX(0, 1), *held), ca.vertcat(ca.SX(0, 1), *rolling)


def contact_reactions(scene: Scene, view: View, held: ca.SX, rolling: ca.SX) -> list[BodyWrench]:
    """Wrenches of contacts on bodies, by the multipliers of both kinds of constraints."""
    wrenches, i, j = [], 0, 0
    for contact in scene.contacts:
        first, second = contact.signals()
        ends = i + len(first), j + len(second)
        values = values_of(contact, view)
        wrenches.append(contact.reaction(values, view, held[i : ends[0]], rolling[j : ends[1]]))
        i, j = ends
    return wrenches


def check_contacts(scene: Scene, view: View, evaluate: Callable[[ca.SX], Sequence[Array]]) -> None:
    """Bodies touch their planes, stand upright and do not slip, at nominal and elsewhere in the range."""
    velocity = velocity_of(scene, view)
    if scene.contacts and scene.spin and ca.sparsify(velocity).nnz():
        raise SceneError(
            f"scene {scene.name!r}: the ground of contact {scene.contacts[0].name!r} turns with the spin "
            f"of the frame, as a turntable, and moves along with the velocity {list(scene.velocity)}: "
            "that is no steady motion. Leave out spin or velocity."
        )
    speed = max(float(np.max(np.abs(at))) for at in evaluate(velocity)) or 1.0
    for contact in scene.contacts:
        values = values_of(contact, view)
        where, normal = owner_name(contact), unit_vector(contact.normal)
        _check_body(contact, view)
        axis = contact.direction
        body = view.find(contact.port)[0]
        if axis is not None:
            lean = ca.dot(view.across(unit_vector(axis), body, "ground"), normal)
            if (worst := _largest(evaluate(lean))) > _GAP:
                raise SceneError(
                    f"{where}: {list(axis)} of body {body!r} is not across the normal of the plane, but "
                    f"{np.degrees(np.arcsin(min(worst, 1.0))):.4g} deg off at nominal or elsewhere in "
                    "the range. A wheel stands upright at equilibrium."
                )
        if isinstance(contact, Rolling):
            _, reach = view.gaps(contact.plane, contact.port, evaluate)
            height = ca.dot(view.between_at_rest(contact.plane, contact.port), normal)
            if (worst := _largest(evaluate(height - values["radius"]))) > _GAP * reach:
                at = evaluate(ca.vertcat(height, values["radius"]))[0][:, 0]
                raise SceneError(
                    f"{where}: {contact.port!r} is {at[0]:.6g} m above the plane at nominal, and the "
                    f"radius is {at[1]:.6g} m: it misses the ground by {worst:.3g} m at nominal or "
                    "elsewhere in the range. Correct height or radius; where a parameter changes one, "
                    "the other must follow it."
                )
        if (worst := _largest(evaluate(contact.slip(values, view, velocity)))) > _GAP * speed:
            given = ", ".join(f"{x:.6g}" for x in evaluate(velocity)[0][:, 0])
            raise SceneError(
                f"{where}: the rate of body {body!r} does not fit the velocity [{given}] m/s of the "
                f"scene: it would slip by {worst:.4g} m/s at nominal or elsewhere in the range. A wheel "
                "rolls with rate = 'speed/radius' about its axis, along axis x normal."
            )


def _check_body(contact: Contact, view: View) -> None:
    """The body does not turn steadily, or as a wheel about the axis of the contact, by its own joint."""
    body, port = view.find(contact.port)
    if body == "ground":
        raise SceneError(f"{owner_name(contact)}: {contact.port!r} is on the ground: it touches itself.")
    links, name, is_own = {link.child.name: link for link in view.now.links}, body, True
    while name in links:
        link = links[name]
        if "rate" in view.now.values[link.owner] and isinstance(link.joint, Revolute):
            axis = getattr(contact, "axis", None)
            arm = port_arm(view.now, body, port)
            along = is_own and axis is not None and not any(np.cross(axis, link.joint.axis))
            if not along or ca.sparsify(ca.cross(unit_vector(link.joint.axis), arm)).nnz():
                raise SceneError(
                    f"{owner_name(contact)}: joint {link.joint.name!r} turns body {body!r} steadily, "
                    "so it must be a wheel about the axis of this joint, which holds it, with its "
                    "center on the axis."
                )
        name, is_own = link.parent.name, False


def _largest(values: Sequence[Array]) -> float:
    return max(float(np.max(np.abs(at), initial=0.0)) for at in values)
