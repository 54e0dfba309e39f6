"""What a scene measures: positions, rates and accelerations of its joints, and its sensors."""

import casadi as ca

from mbdlft.base.signal import Signal
from mbdlft.multibody.assembly.aligned import Aligned
from mbdlft.multibody.assembly.symbols import Symbols, coordinate_owners
from mbdlft.multibody.assembly.tree import Link
from mbdlft.multibody.assembly.view import View
from mbdlft.multibody.scene.scene import Scene


def steady_angles(links: tuple[Link, ...]) -> list[int]:
    """Positions among the displacements of the angles of joints with a rate."""
    owners = [link.owner for link in links if getattr(link.joint, "rate", None) is not None]
    owned = [owner for owner, _, freedoms, _ in coordinate_owners(links) for _ in freedoms]
    return [k for k, owner in enumerate(owned) if owner in owners]


def measures(
    scene: Scene, links: tuple[Link, ...], symbols: Symbols, view: View, aligned: Aligned | None
) -> tuple[ca.SX, tuple[Signal, ...], tuple[int, ...]]:
    """Outputs: measures of all joints, and the sensors that are asked for.

    Returns
    -------
    expressions (n_y,), signals (n_y), positions of the default outputs
    """
    entries: list[ca.SX] = []
    signals: list[Signal] = []
    default: list[int] = []
    row = 0
    steady = steady_angles(links)
    for _, name, freedoms, kind in coordinate_owners(links):
        for freedom in freedoms:
            if kind not in ("elastic", "motion"):
                default.append(len(entries) + (row in steady))
            for measure, value in zip(
                freedom.measures, (symbols.q, symbols.v, symbols.a), strict=True
            ):
                entries.append(value[row])
                signals.append(Signal(f"{name}.{measure.name}", measure.unit))
            row += 1
    for sensor in scene.sensors:
        named = sensor.signals()
        if scene.outputs is not None and not {s.name for s in named} & set(scene.outputs):
            continue
        view.owner = f"sensor {sensor.name!r}"
        default += range(len(signals), len(signals) + len(named))
        measured = sensor.measure(view)
        entries.append(aligned.back(measured) if aligned else measured)
        signals += named
    return ca.vertcat(*entries), tuple(signals), tuple(default)
