"""A copy of a chain that stands still: loops that are closed on it are closed in all digits.

Positions of ports that doubles round leave a gap of 1e-16. Whoever takes derivatives of a closure finds
other numbers there, by the gap times the condition of the loop: 4,500 roundings were seen.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbdlft import Fixed, PointMass, Rotation

Texts = list[str]  # the entries of a vector (3,)


def at_rest(bodies: Sequence[Any], joints: Sequence[Any]) -> tuple[list[PointMass], list[Fixed], Texts]:
    """Bodies of a chain on the ground, fixed where its joints are at rest, and the port of the first.

    The last one has the port "anchor" where that of the chain has "tip".
    """
    copies, welds, first = list[PointMass](), list[Fixed](), ["0", "0", "0"]
    for k, (body, joint) in enumerate(zip(bodies, joints, strict=True)):
        slid, turns = _placed(joint)
        (tilt,) = joint.orientation
        away = turned(tilt.axis, tilt.angle, slid)
        if k:
            ports = copies[-1].ports
            at = tuple(f"{x} + {d}" for x, d in zip(ports["anchor"], away, strict=True))
            copies[-1] = copies[-1].model_copy(update={"ports": ports | {"anchor": at}})
        else:
            first = away
        name, side = f"g{k}", joint.child.partition(".")[2]
        ports = {"anchor": tuple(map(repr, body.ports["tip"]))}
        if side:
            ports["held"] = body.ports[side]
        copies.append(PointMass(name=name, mass=1.0, ports=ports))
        parent = f"g{k - 1}.anchor" if k else "ground.anchor"
        child = f"{name}.held" if side else name
        welds.append(Fixed(name=f"rest{k}", parent=parent, child=child, orientation=[tilt, *turns]))
    return copies, welds, first


def _placed(joint: Any) -> tuple[Texts, list[Rotation]]:
    """Where a joint at rest has the child: a place in its tilted axes, and rotations."""
    q = np.atleast_1d(getattr(joint, "position", ())).tolist()
    match joint.kind:
        case "revolute":
            return ["0", "0", "0"], [Rotation(axis=joint.axis, angle=q[0])]
        case "prismatic":
            return _times(q[0], unit(joint.axis)), []
        case "cylindrical":
            return _times(q[0], unit(joint.axis)), [Rotation(axis=joint.axis, angle=q[1])]
        case "universal":
            axes = (joint.axis1, joint.axis2)
            turns = [Rotation(axis=a, angle=x) for a, x in zip(axes, q, strict=True)]
            return ["0", "0", "0"], turns
        case "planar":
            x, y = _plane(joint.axis)
            place = [f"{a} + {b}" for a, b in zip(_times(q[0], x), _times(q[1], y), strict=True)]
            return place, [Rotation(axis=joint.axis, angle=q[2])]
    return ["0", "0", "0"], []


def _plane(axis: Sequence[float]) -> tuple[Texts, Texts]:
    """x and y of a planar joint whose normal is a coordinate axis: the axes that follow it."""
    assert np.count_nonzero(axis) == 1
    x = [repr(float(entry)) for entry in np.roll(np.sign(np.abs(axis)), 1)]
    return x, _cross(unit(axis), x)


def turned(axis: Sequence[float], angle: float | str, v: Texts) -> Texts:
    """A vector turned about an axis (Rodrigues)."""
    a = unit(axis)
    along, across = "(" + " + ".join(f"{x}*({y})" for x, y in zip(a, v, strict=True)) + ")", _cross(a, v)
    return [
        f"(({x})*cos({angle}) + {w}*sin({angle}) + {n}*{along}*(1 - cos({angle})))"
        for x, w, n in zip(v, across, a, strict=True)
    ]


def unit(axis: Sequence[Any]) -> Texts:
    entries = [f"({x})" if isinstance(x, str) else f"({x!r})" for x in axis]
    size = "sqrt(" + " + ".join(f"{x}*{x}" for x in entries) + ")"
    return [f"({x}/{size})" for x in entries]


def _times(factor: float, v: Texts) -> Texts:
    return [f"({factor!r})*{x}" for x in v]


def _cross(a: Texts, b: Texts) -> Texts:
    return [f"({a[i]}*({b[j]}) - {a[j]}*({b[i]}))" for i, j in ((1, 2), (2, 0), (0, 1))]
