"""What a scene measures: joints, sensors, and bodies themselves, whose inputs are voltages."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca

from mbdlft.base.description import Values
from mbdlft.base.unit import Signal
from mbdlft.multibody.assembly.aligned import Aligned
from mbdlft.multibody.assembly.symbols import Symbols
from mbdlft.multibody.assembly.tree import Link, degrees
from mbdlft.multibody.assembly.view import View
from mbdlft.multibody.body import Body
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene


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


def steady_angles(links: tuple[Link, ...]) -> list[int]:
    """Positions among the displacements of the angles of joints with a rate."""
    steady = {link.owner for link in links if getattr(link.joint, "rate", None) is not None}
    return [k for k, degree in enumerate(degrees(links)) if degree.owner in steady]


def measures(
    scene: Scene,
    links: tuple[Link, ...],
    symbols: Symbols,
    view: View,
    aligned: Aligned | None,
    channels: BodyChannels,
) -> tuple[ca.SX, tuple[Signal, ...], tuple[int, ...]]:
    """Outputs: measures of all joints, the sensors that are asked for, and those of bodies.

    Returns
    -------
    expressions (n_y,), signals (n_y), positions of the default outputs
    """
    entries: list[ca.SX] = []
    signals: list[Signal] = []
    default: list[int] = []
    steady = steady_angles(links)
    for row, degree in enumerate(degrees(links)):
        if degree.kind not in ("elastic", "motion"):
            default.append(len(entries) + (row in steady))
        entries += [symbols.q[row], symbols.v[row], symbols.a[row]]
        signals += [degree.measure(order) for order in range(3)]
    for sensor in scene.sensors:
        named = sensor.signals()
        if scene.outputs is not None and not {s.name for s in named} & set(scene.outputs):
            continue
        view.owner = f"sensor {sensor.name!r}"
        default += range(len(signals), len(signals) + len(named))
        measured = sensor.measure(view)
        entries.append(aligned.back(measured) if aligned else measured)
        signals += named
    default += range(len(signals), len(signals) + len(channels.signals))
    expressions = ca.vertcat(*entries, channels.outputs)
    return expressions, (*signals, *channels.signals), tuple(default)
