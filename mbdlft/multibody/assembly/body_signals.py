"""Inputs and outputs of bodies themselves: voltages, charges."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca

from mbdlft.base.description import Values
from mbdlft.base.signal import Signal
from mbdlft.multibody.assembly.tree import Link
from mbdlft.multibody.assembly.view import View
from mbdlft.multibody.body import Body
from mbdlft.multibody.scene.quantities import owner_name


class BodyChannels(NamedTuple):
    """Generalized forces (n,) of all coordinates by the inputs of bodies; what bodies measure."""

    forces: ca.SX
    outputs: ca.SX
    signals: tuple[Signal, ...]


def body_inputs(body: Body) -> list[Signal]:
    """Inputs of a body, with its name."""
    return _named(body, body.inputs())


def body_channels(
    links: tuple[Link, ...],
    values: Mapping[str, Values],
    view: View,
    u: ca.SX,
    names: Sequence[str],
) -> BodyChannels:
    """Forces and outputs of the bodies of a tree; `names` are those of the entries of u."""
    forces: list[ca.SX] = [ca.SX(0, 1)]
    outputs: list[ca.SX] = [ca.SX(0, 1)]
    signals: list[Signal] = []
    for link in links:
        body, own = link.child, values.get(owner_name(link.child), {})
        forces.append(ca.SX(len(link.joint.freedoms), 1))
        given = ca.vertcat(ca.SX(0, 1), *(u[names.index(s.name)] for s in body_inputs(body)))
        forces.append(body.driven(own, given))
        outputs.append(body.measure(own, given, view.coordinates[owner_name(body)]))
        signals += _named(body, body.outputs())
    return BodyChannels(ca.vertcat(*forces), ca.vertcat(*outputs), tuple(signals))


def _named(body: Body, signals: Sequence[Signal]) -> list[Signal]:
    return [Signal(f"{body.name}.{signal.name}", signal.unit) for signal in signals]
