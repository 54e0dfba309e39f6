"""The two-port of a body: what it does between the port that carries it and the ports it carries.

    [acceleration of the children C ; load F_A/P of the body on its parent at P] =
        G(s, delta) [loads F_C/A of the children on the body ; acceleration of P]

Six signals per port (or fewer `axes`), translations first, in the axes of the body; the convention is
that of equations (5.6) to (5.15) of the two-port models in `tests/reference/flexible.py`, for any number
of children. The body is clamped at P and free at C. No equation is new: the body is put into a scene with
an imposed free joint at P, loads of magnitude zero and accelerations at C, and the wrench of the joint.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbdlft.base.description import AXES
from mbdlft.base.errors import AnalysisError, SceneError, check_known
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.lft.lft import LFT, select
from mbdlft.multibody.body import GROUND, Beam, Body, ElasticBody
from mbdlft.multibody.force import Force, Torque
from mbdlft.multibody.joint import Free
from mbdlft.multibody.scene import Constant, Scene
from mbdlft.multibody.sensor import Acceleration, AngularAcceleration, JointWrench
from mbdlft.order.search import SEARCH
from mbdlft.pipeline.models import to_lft
from mbdlft.system.model import LFTModel

DIRECTIONS = (*AXES, *(f"r{axis}" for axis in AXES))
_HOLD, _WRENCH = "hold", "wrench"
_UNITS = {"force": "N", "torque": "N m", "acceleration": "m/s^2", "angular_acceleration": "rad/s^2"}
_ACCELERATIONS = ("acceleration", "angular_acceleration")
_LOADS = ("force", "torque")


def two_port(
    body: Body,
    parameters: Sequence[Parameter] = (),
    children: Sequence[str] | None = None,
    *,
    parent: str = "origin",
    axes: Sequence[str] = DIRECTIONS,
    constants: Mapping[str, float | Constant] | None = None,
    search: float = SEARCH,
) -> LFTModel:
    """The LFT model of [acceleration of C ; F_A/P] = G [F_C/A ; acceleration of P] of one body.

    Parameters
    ----------
    body : a body of any kind but the ground
    parameters : sequence of `Parameter` and `Angle` that its quantities use
    children : sequence of str
        Ports C where it carries others; by default all that are declared (of a beam: its tip and
        stations). None of them gives the one-port.
    parent : str
        Port P where it is held; an elastic body is held at its origin.
    axes : sequence of str
        Which of ``x``, ``y``, ``z`` (translations), ``rx``, ``ry``, ``rz`` (rotations) every port has:
        ``("y", "rz")`` for bending in a plane. In the others no load acts, and P does not move.
    constants : mapping of names to numbers or `Constant`, optional
    search : float
        Seconds to look for a smaller model, as in `to_lft`.

    Returns
    -------
    LFTModel
        Inputs ``C.force.x`` (N) to ``C.torque.z`` (N m) of each child, then ``P.acceleration.x`` (m/s^2)
        to ``P.angular_acceleration.z`` (rad/s^2), under the names of the ports; outputs, in the same
        places, ``C.acceleration.x`` and so on, then ``P.force.x`` and so on; voltages and charges of
        piezoelectric patches come last. Its states are those of the
        deformations. Its ``at(...)`` gives a `control.StateSpace`, and `invert_channels` other boundary
        conditions.

    Raises
    ------
    SceneError
        A port or an axis is unknown, a port is named twice or cannot hold the body.
    """
    ports = _ports(body, children, parent)
    check_known("axis", map(str, axes), DIRECTIONS, f"two_port of body {body.name!r}")
    if not axes:
        raise SceneError(f"two_port of body {body.name!r}: axes: name at least one.")
    used = tuple(axis for axis in DIRECTIONS if axis in axes)
    whole = _with_areas(body, used) if isinstance(body, Beam) else body
    model = to_lft(_scene(whole, parameters, constants or {}, ports, parent, used), search)
    loads, accelerations = (
        {port: _signals(port, kinds, used) for port in (*ports, parent)}
        for kinds in (_LOADS, _ACCELERATIONS)
    )
    body_signals = _own(body)
    return replace(
        model,
        lft=_without_rigid_motion(model, [signal.name for signal in model.outputs]),
        states=tuple(s for s in model.states if not _is_rigid(s)),
        inputs=(*(s for port in ports for s in loads[port]), *accelerations[parent], *body_signals[0]),
        outputs=(*(s for port in ports for s in accelerations[port]), *loads[parent], *body_signals[1]),
    )


def _ports(body: Body, children: Sequence[str] | None, parent: str) -> tuple[str, ...]:
    """The children's ports, checked."""
    if not isinstance(body, Body) or body.name == GROUND:
        got = f"the kind {body.kind!r}" if isinstance(body, Body) else type(body).__name__
        raise SceneError(f"two_port: expected a body other than the ground, got {got}.")
    if isinstance(children, str):
        raise SceneError(f"two_port: children: expected a list of ports, got {children!r}.")
    if children is None:
        declared = body.elastic_ports() if isinstance(body, ElasticBody) else tuple(body.ports)
        children = [port for port in declared if port != parent]
    where = f"two_port of body {body.name!r}"
    check_known("port", map(str, (*children, parent)), body.port_names(), where)
    if len({*children, parent}) < len(children) + 1:
        raise SceneError(
            f"{where}: a port is named twice among the children "
            f"{', '.join(children)} and the parent {parent}. Each port is one of them."
        )
    if isinstance(body, ElasticBody) and parent != "origin":
        raise SceneError(
            f"{where}: an elastic body is held at its origin, got the parent "
            f"{parent!r}. Take the two-port at the origin and exchange its ends with invert_channels."
        )
    return tuple(children)


def _with_areas(beam: Beam, axes: Sequence[str]) -> Beam:
    """The beam with some value of each moment of area that only a rotation feels which no port has.

    P does not turn about that axis, so that no signal depends on the value.
    """
    if "rx" in axes:
        return beam
    turns = {"I_y": "ry", "I_z": "rz"}
    free = [k for k in turns if not (beam.has_rotary_inertia and turns[k] in axes)]
    given = [value for value in (beam.I_y, beam.I_z) if value is not None]
    some = given[0] if given else 1e-6  # m^4
    return beam.model_copy(update={k: some for k in free if getattr(beam, k) is None})


def _scene(
    body: Body,
    parameters: Sequence[Parameter],
    constants: Mapping[str, float | Constant],
    ports: Sequence[str],
    parent: str,
    axes: Sequence[str],
) -> Scene:
    """The body on an imposed free joint, with loads and sensors at its ports; no gravity."""
    loads: list[Force | Torque] = []
    sensors: list[Acceleration | AngularAcceleration | JointWrench] = []
    for k, port in enumerate(ports):
        at = f"{body.name}.{port}"
        for kind, axis in _split(axes, _LOADS):
            cls = Force if kind == "force" else Torque
            direction = tuple(float(axis == other) for other in AXES)
            loads.append(cls(name=f"{kind}_{k}_{axis}", port=at, direction=direction, magnitude=0.0))
        sensors.append(Acceleration(name=f"{_ACCELERATIONS[0]}_{k}", port=at))
        sensors.append(AngularAcceleration(name=f"{_ACCELERATIONS[1]}_{k}", port=at))
    sensors.append(JointWrench(name=_WRENCH, joint=_HOLD))
    imposed = [f"{_HOLD}.{kind}.{axis}" for kind, axis in _split(axes, _ACCELERATIONS)]
    measured = [
        f"{kind}_{k}.{axis}" for k in range(len(ports)) for kind, axis in _split(axes, _ACCELERATIONS)
    ]
    wrench = [f"{_WRENCH}.{kind}.{axis}" for kind, axis in _split(axes, _LOADS)]
    body_names = [[signal.name for signal in signals] for signals in _own(body)]
    return Scene(
        name=body.name,
        description=f"two-port of the body {body.name}",
        constants=dict(constants),
        parameters=tuple(parameters),
        bodies=(body,),
        joints=(Free(name=_HOLD, parent=GROUND, child=f"{body.name}.{parent}", imposed=True),),
        loads=tuple(loads),
        sensors=tuple(sensors),
        inputs=(*(f"{load.name}.{load.kind}" for load in loads), *imposed, *body_names[0]),
        outputs=(*measured, *wrench, *body_names[1]),
    )


def _own(body: Body) -> tuple[list[Signal], list[Signal]]:
    """Inputs and outputs of the body itself, as the model names them."""
    return [s.of(body.name) for s in body.inputs()], [s.of(body.name) for s in body.outputs()]


def _split(axes: Sequence[str], kinds: tuple[str, str]) -> list[tuple[str, str]]:
    """Kind and axis of each signal of one port, such as force and x, or torque and x for rx."""
    return [(kinds[len(axis) - 1], axis[-1]) for axis in axes]


def _signals(port: str, kinds: tuple[str, str], axes: Sequence[str]) -> list[Signal]:
    return [Signal(f"{port}.{kind}.{axis}", _UNITS[kind]) for kind, axis in _split(axes, kinds)]


def _is_rigid(signal: Signal) -> bool:
    return signal.name.startswith(f"{_HOLD}.")


def _without_rigid_motion(model: LFTModel, outputs: Sequence[str]) -> LFT:
    """The LFT without the position and rate of P, and with the reaction of the wrench that holds P.

    Nothing depends on them: there is no load at equilibrium, and P moves as it is told to.
    """
    rigid = [k for k, signal in enumerate(model.states) if _is_rigid(signal)]
    rows = [k for k in range(model.lft.shape[0]) if k not in rigid]
    columns = [k for k in range(model.lft.shape[1]) if k not in rigid]
    seen = np.any(model.lft.M12[:, rigid]) or np.any(model.lft.M22[np.ix_(rows, rigid)])
    if seen:
        raise AnalysisError(
            f"two_port of body {model.name!r}: its signals depend on its position, which they cannot. "
            "This is a bug: please report the body."
        )
    lft = select(model.lft, rows, columns)
    # the joint measures P on A, the port has A on P
    reaction = [name.startswith(f"{_WRENCH}.") for name in outputs]
    sign = np.where([False] * (len(rows) - len(outputs)) + reaction, -1.0, 1.0)
    return LFT(lft.M11, lft.M12, sign[:, None] * lft.M21, sign[:, None] * lft.M22, lft.blocks)
