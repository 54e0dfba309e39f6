"""Contacts of the bodies of a tree with the ground: their constraints, reactions and what is checked."""

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import Direction, Values
from mbdlft.base.errors import SceneError
from mbdlft.multibody.assembly.kinematics import View, port_arm
from mbdlft.multibody.contact import Contact, Patch, Rolling
from mbdlft.multibody.force import BodyWrench, Tire, Wheel
from mbdlft.multibody.joint import Revolute
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
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


def contact_rows(contacts: Sequence[Contact], view: View, order: int) -> tuple[ca.SX, ca.SX]:
    """Constraints of one order: holonomic ones of contacts, and those of rates."""
    rows = [c.rows(values_of(c, view), view, order) for c in contacts]
    held, rolling = zip(*rows, strict=True)
    return ca.vertcat(*held), ca.vertcat(*rolling)


def contact_reactions(
    contacts: Sequence[Contact], view: View, held: ca.SX, rolling: ca.SX
) -> list[BodyWrench]:
    """Wrenches of contacts on bodies, by the multipliers of both kinds of constraints."""
    wrenches, i, j = [], 0, 0
    for contact in contacts:
        first, second = contact.signals()
        ends = i + len(first), j + len(second)
        values = values_of(contact, view)
        wrenches.append(contact.reaction(values, view, held[i : ends[0]], rolling[j : ends[1]]))
        i, j = ends
    return wrenches


def check_contacts(scene: Scene, view: View, evaluate: Callable[[ca.SX], Sequence[Array]]) -> None:
    """Bodies touch their planes, stand upright and do not slip, at nominal and elsewhere in the range."""
    velocity = view.velocity
    if scene.rolling and scene.spin and ca.sparsify(velocity).nnz():
        raise SceneError(
            f"scene {scene.name!r}: the ground of {owner_name(scene.rolling[0])} turns with the spin "
            f"of the frame, as a turntable, and moves along with the velocity {list(scene.velocity)}: "
            "that is no steady motion. Leave out spin or velocity."
        )
    speed = max(float(np.max(np.abs(at))) for at in evaluate(velocity)) or 1.0
    for contact in scene.touches:
        values = values_of(contact, view)
        if not isinstance(contact, Patch):
            _check_body(contact, view)
            _check_upright(contact, contact.port, contact.direction, view, evaluate)
        if isinstance(contact, Rolling):
            _check_height(contact, contact.plane, contact.port, values, view, evaluate)
        if (worst := _largest(evaluate(contact.slip(values, view)))) > _GAP * speed:
            given = ", ".join(f"{x:.6g}" for x in evaluate(velocity)[0][:, 0])
            body = view.find(contact.port)[0]
            raise SceneError(
                f"{owner_name(contact)}: the rate of body {body!r} does not fit the "
                f"velocity [{given}] m/s of the scene: it would slip by {worst:.4g} m/s at nominal or "
                "elsewhere in the range. A wheel rolls with rate = 'speed/radius' about its axis, along "
                "axis x normal."
            )


def check_wheel(
    wheel: Wheel, scene: Scene, view: View, evaluate: Callable[[ca.SX], Sequence[Array]]
) -> None:
    """A wheel that is a load stands upright on its road and rolls ahead, everywhere in the range."""
    values = view.owned(wheel)
    _check_upright(wheel, wheel.child, wheel.axis, view, evaluate)
    _check_height(wheel, wheel.parent, wheel.child, values, view, evaluate)
    axis, _, speed = wheel.along(view)
    speeds = np.array(evaluate(speed))
    size = max(float(np.max(np.abs(speeds))), 1e-300)
    if (worst := _largest(evaluate(ca.dot(axis, view.velocity)))) > _GAP * size:
        raise SceneError(
            f"{owner_name(wheel)}: the scene moves along the axis of the wheel with {worst:.4g} m/s "
            "at nominal or elsewhere in the range. A wheel rolls along axis x normal."
        )
    stops = isinstance(wheel, Tire) and wheel.patch
    if np.min(speeds) < 0.0 or (not stops and np.min(speeds) <= 0.0):
        raise SceneError(
            f"{owner_name(wheel)}: the speed along axis x normal goes down to {np.min(speeds):.4g} "
            f"m/s in the range; the scene has velocity = {list(scene.velocity)}. It must be positive "
            "(velocity = [20, 0, 0]), or zero where a tire has a relaxation length. Turn the axis "
            "round where the wheel rolls the other way."
        )


def _check_upright(
    item: Contact | Wheel,
    port: str,
    axis: Direction | None,
    view: View,
    evaluate: Callable[[ca.SX], Sequence[Array]],
) -> None:
    """The axis or heading of a body is across the normal."""
    if axis is None:
        return
    body = view.find(port)[0]
    lean = ca.dot(view.across(unit_vector(axis), body, "ground"), unit_vector(item.normal))
    if (worst := _largest(evaluate(lean))) > _GAP:
        raise SceneError(
            f"{owner_name(item)}: {list(axis)} of body {body!r} is not across the normal of the plane, "
            f"but {np.degrees(np.arcsin(min(worst, 1.0))):.4g} deg off at nominal or elsewhere in "
            "the range. A wheel stands upright at equilibrium."
        )


def _check_height(
    item: Contact | Wheel,
    plane: str,
    port: str,
    values: Values,
    view: View,
    evaluate: Callable[[ca.SX], Sequence[Array]],
) -> None:
    """The center of a wheel is at its radius above the plane."""
    _, reach = view.gaps(plane, port, evaluate)
    height = ca.dot(view.between_at_rest(plane, port), unit_vector(item.normal))
    if (worst := _largest(evaluate(height - values["radius"]))) > _GAP * reach:
        at = evaluate(ca.vertcat(height, values["radius"]))[0][:, 0]
        raise SceneError(
            f"{owner_name(item)}: {port!r} is {at[0]:.6g} m above the plane at nominal, and the "
            f"radius is {at[1]:.6g} m: it misses the ground by {worst:.3g} m at nominal or "
            "elsewhere in the range. Correct height or radius; where a parameter changes one, "
            "the other must follow it."
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
