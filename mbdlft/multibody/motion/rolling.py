"""Contacts with the ground, and loads with a line, at displacements of any size.

A wheel about e on a plane across n touches it at the lowest point of its torus, from the center

    r = -r0 n - (R - r0) (n - (n . e) e)/|n - (n . e) e|

with the radius R of the wheel and r0 of its tire; a ball at -R n. The gap n . (C + r) is held at zero,
and the point of the wheel there has no velocity over the ground along the plane. The scene moves over
the ground with V, and a wheel that turns steadily has W e x r there besides. A knife edge has no velocity
along n x h for its heading h.

A tire has the slip a = e_t . v/(h . V_C), the velocity v of that point along the axis e_t in the plane
over that of the center ahead, h = e_t x n, and the camber g = n . e; its laws are those of
`force.guided`. Those of creep hold for a wheel that stays near its place on the rail.
"""

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca

from mbdlft.base.description import Values
from mbdlft.multibody.assembly.touching import values_of
from mbdlft.multibody.contact import Contact, KnifeEdge, Patch, Rolling
from mbdlft.multibody.force import BodyWrench, Support, Tire, Wheel
from mbdlft.multibody.force.guided import Creep, Guided
from mbdlft.multibody.force.kinds import pull
from mbdlft.multibody.motion.space import LargeView
from mbdlft.problem.sx.constants import unit_vector


class Held(NamedTuple):
    """Gaps and rates that a contact holds at zero, and the rates on which its forces do work."""

    gaps: ca.SX
    rates: ca.SX
    worked: ca.SX


def held(contacts: Sequence[Contact], space: LargeView) -> Held:
    """What all contacts hold, in the order of their constraints."""
    every = [_held(contact, values_of(contact, space), space) for contact in contacts]
    columns = zip(Held(*[ca.SX(0, 1)] * 3), *every, strict=True)
    return Held(*(ca.vertcat(*column) for column in columns))


def _held(contact: Contact, values: Values, space: LargeView) -> Held:
    none, n, V = ca.SX(0, 1), unit_vector(contact.normal), space.velocity
    if isinstance(contact, Patch):
        tire, wheel = contact.tire, _Wheel(contact.tire, values, space)
        worked = ca.dot(wheel.across, space.velocity_at(contact.port, wheel.lowest))
        deflection = ca.dot(wheel.axis, space.place(contact.port) - space.place(tire.child))
        slope = deflection / values["relaxation"] + values["camber"] / values["cornering"] * wheel.camber
        return Held(none, worked + ca.dot(wheel.across, V) + wheel.speed * slope, worked)
    if isinstance(contact, KnifeEdge):
        heading = space.turned(unit_vector(contact.heading), contact.port)
        side = ca.cross(n, heading)
        worked = ca.dot(side / ca.norm_2(side), space.velocity_at(contact.port, ca.SX(3, 1)))
        return Held(none, worked + ca.dot(side / ca.norm_2(side), V), worked)
    assert isinstance(contact, Rolling)
    axis = None
    if contact.axis is not None:
        axis = space.turned(unit_vector(contact.axis), contact.port)
    lowest = _lowest(axis, n, values["radius"], values["tire"])
    gap = ca.dot(n, space.between(contact.plane, contact.port) + lowest)
    worked = space.velocity_at(contact.port, lowest)
    rates = worked + V if axis is None else worked + V + ca.cross(axis * values["rate"], lowest)
    tangents = ca.horzcat(*contact.tangents).T
    return Held(gap, ca.mtimes(tangents, rates), ca.mtimes(tangents, worked))


def _lowest(axis: ca.SX | None, n: ca.SX, radius: ca.SX, tire: ca.SX) -> ca.SX:
    """The point (3,) of a wheel or ball that touches, from its center."""
    if axis is None:
        return ca.SX(-radius * n)
    up = n - axis * ca.dot(n, axis)
    return ca.SX(-tire * n - (radius - tire) * up / ca.norm_2(up))


class _Wheel:
    """A wheel with a tire or creep: vectors (3,) in the axes of the scene."""

    def __init__(self, wheel: Wheel, values: Values, space: LargeView) -> None:
        self.normal = space.turned(unit_vector(wheel.normal), wheel.parent)
        self.axis = space.turned(unit_vector(wheel.axis), wheel.child)
        self.camber = ca.dot(self.normal, self.axis)
        across = self.axis - self.camber * self.normal
        self.across = across / ca.norm_2(across)
        self.lowest = _lowest(
            self.axis, self.normal, values["radius"], values.get("crown", values["radius"])
        )
        self.over_ground = space.velocity - space.rate(space.place(wheel.parent))
        ahead = ca.cross(self.across, self.normal)
        center = space.velocity_at(wheel.child, ca.SX(3, 1))
        self.speed = ca.dot(ahead, center + self.over_ground)


def guided(load: Guided, magnitude: ca.SX, space: LargeView) -> list[BodyWrench]:
    """Wrenches on both bodies of a strut, support, tire or creep."""
    values = space.owned(load)
    body, at = space.port(load.parent)
    other, there = space.port(load.child)
    line, apart = unit_vector(load.line), space.between(load.parent, load.child)
    moved = apart - space.between_at_rest(load.parent, load.child)
    stretch, foot, across = ca.dot(line, moved), ca.SX(3, 1), ca.SX(3, 1)
    if isinstance(load, Support):
        across = -values["side_stiffness"] * moved - values["side_damping"] * space.rate(moved)
        across -= line * ca.dot(line, across)
    elif isinstance(load, Wheel):
        wheel = _Wheel(load, values, space)
        stretch += ca.dot(wheel.normal, wheel.lowest) + values["radius"]
        foot = space.across_now(wheel.lowest, "ground", other)
        across = load.across(values, space)
        if isinstance(load, Tire) and not load.patch:
            velocity = space.velocity_at(load.child, wheel.lowest) + wheel.over_ground
            slip = ca.dot(wheel.across, velocity) / wheel.speed
            side = -values["cornering"] * slip - values["camber"] * wheel.camber
            across = space.across_now(wheel.across * side, "ground", body)
    size = magnitude - values["stiffness"] * stretch - values["damping"] * space.rate(stretch)
    force, at = line * size + across, at + apart + space.across_now(foot, other, body)
    on_child = space.across_now(force, body, other)
    wrenches = [pull(body, -force, at), pull(other, on_child, there + foot)]
    if isinstance(load, Creep):
        torque = space.across_now(
            unit_vector(load.normal) * load.creep(values, space)[2], "ground", other
        )
        wrenches.append(BodyWrench(other, ca.horzcat(ca.SX(3, 1), torque)))
    return wrenches
