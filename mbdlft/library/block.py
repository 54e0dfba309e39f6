"""Models to be connected: linear blocks of actuators, and the two-port of a body.

Quantities of blocks are numbers or expressions of parameters, in SI units. A parameter is repeated no
more than it must be. Equation (7.10) of the two-port models in `tests/reference/flexible.py` is the band
pass.

The two-port says what a body does between the port that carries it and the ports it carries:

    [acceleration of the children C ; load F_A/P of the body on its parent at P] =
        G(s, delta) [loads F_C/A of the children on the body ; acceleration of P]

Six signals per port (or fewer `axes`), translations first, in the axes of the body; the convention is
that of equations (5.6) to (5.15) there, for any number of children. The body is clamped at P and free at
C. No equation is new: the body is put into a scene with an imposed free joint at P, loads of magnitude
zero and accelerations at C, and the wrench of the joint.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.description import AXES, Expected
from mbdlft.base.errors import AnalysisError, SceneError, check_known
from mbdlft.base.expression import BUILTIN_CONSTANTS
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import corners
from mbdlft.base.unit import Signal, parse_unit
from mbdlft.exact.operators import Dimension
from mbdlft.lft.lft import LFT, select
from mbdlft.multibody.body import GROUND, Beam, Body, ElasticBody
from mbdlft.multibody.force import Force, Torque
from mbdlft.multibody.joint import Free
from mbdlft.multibody.scene import Constant, Scene
from mbdlft.multibody.scene.quantities import Place, check_dimension, expression_at, value_at
from mbdlft.multibody.sensor import Acceleration, AngularAcceleration, JointWrench
from mbdlft.order.work import SEARCH
from mbdlft.pipeline.models import realize, to_lft
from mbdlft.system.evidence import NOTHING_FREE
from mbdlft.system.model import LFTModel

_MOST = 20


@arguments_checked
def low_pass(
    bandwidth: float | str,
    damping: float | str | None = None,
    parameters: Sequence[Parameter] = (),
    *,
    name: str = "low_pass",
) -> LFTModel:
    """A low pass: w/(s + w), or w^2/(s^2 + 2 xi w s + w^2) with a damping xi; a reaction wheel, a motor.

    Parameters
    ----------
    bandwidth : number or expression, w (rad/s)
    damping : number or expression, xi [1]; without it the block is of first order
    parameters : sequence of Parameter
        Those of the expressions, each with its unit, for example Hz.
    name : str
    """
    quantities = {"bandwidth": Expected(bandwidth, "rad/s")}
    if damping is not None:
        quantities["damping"] = Expected(damping, "1")

    def matrix(v: Mapping[str, Any]) -> list[list[Any]]:
        w, xi = v["bandwidth"], v.get("damping")
        if xi is None:
            return [[-w, w], [1.0, 0.0]]
        return [[0.0, w, 0.0], [-w, -2.0 * w * xi, w], [1.0, 0.0, 0.0]]

    states = ["lag"] if damping is None else ["low", "low_rate"]
    return _filter(name, quantities, parameters, matrix, states)


@arguments_checked
def band_pass(
    low: float | str,
    high: float | str,
    damping: float | str = 0.7,
    parameters: Sequence[Parameter] = (),
    *,
    name: str = "band_pass",
) -> LFTModel:
    """s^2/(s^2 + 2 xi w_l s + w_l^2) w_h^2/(s^2 + 2 xi w_h s + w_h^2); a piezo actuator, an amplifier.

    Parameters
    ----------
    low, high : numbers or expressions, w_l and w_h (rad/s)
    damping : number or expression, xi [1] of both
    parameters : sequence of Parameter
    name : str
    """
    quantities = {
        "low": Expected(low, "rad/s"),
        "high": Expected(high, "rad/s"),
        "damping": Expected(damping, "1"),
    }

    def matrix(v: Mapping[str, Any]) -> list[list[Any]]:
        a, b, xi = v["low"], v["high"], v["damping"]
        c = -2.0 * xi
        return [
            [0.0, a, 0.0, 0.0, 0.0],
            [-a, a * c, 0.0, 0.0, a],
            [0.0, 0.0, 0.0, b, 0.0],
            [-b, b * c, -b, b * c, b],
            [0.0, 0.0, 1.0, 0.0, 0.0],
        ]

    states = ["high", "high_rate", "low", "low_rate"]
    return _filter(name, quantities, parameters, matrix, states)


@arguments_checked
def delay(
    time: float | str, order: int = 2, parameters: Sequence[Parameter] = (), *, name: str = "delay"
) -> LFTModel:
    """The Pade approximation [n/n] of exp(-s T): its response has gain 1 and the phase of 2 n + 1 terms.

    With exp(-s T) = (1 - h)/(1 + h), h = tanh(x), x = s T/2, and the continued fraction
    h = 1/(1/x + 1/(3/x + 1/(5/x + ...))) cut after n terms: a ladder whose numbers are integers.

    Parameters
    ----------
    time : number or expression, T (s)
    order : int, n, 1 to 20
    parameters : sequence of Parameter
    name : str

    Returns
    -------
    LFTModel with one input and one output, for `series`
    """
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= _MOST:
        raise SceneError(f"{name}, order: expected a whole number from 1 to {_MOST}, got {order!r}.")
    quantities = {"time": Expected(time, "s")}
    return _filter(name, quantities, parameters, lambda v: _ladder(order, 2.0 / v["time"]), order)


def _filter(
    name: str,
    quantities: Mapping[str, Expected],
    parameters: Sequence[Parameter],
    matrix: Callable[[Mapping[str, Any]], list[list[Any]]],
    states: Sequence[str] | int,
) -> LFTModel:
    """A linear block with one input, the command, and one output."""
    ends = {"inputs": ["command"], "outputs": ["output"]}
    return linear_block(name, quantities, parameters, matrix, states=states, **ends)


def _ladder(order: int, rate: Any) -> list[list[Any]]:
    """Rows of [A B ; C D]: currents of inductors (states 1, 3, ...), voltages of capacitors (2, 4, ...).

    The source u drives the ladder through a resistor 1, u = i + v, and the output is i - v = 2 i - u.
    """
    n = order
    odd = [float(k % 2 == 0) for k in range(n)]  # states counted from 1
    even = [1.0 - entry for entry in odd]
    if n % 2:  # the last element carries all that is left of the current
        i, v = [*odd, 0.0], [*(-entry for entry in odd), 1.0]
    else:
        v, i = [*even, 0.0], [*(-entry for entry in even), 1.0]
    rows: list[list[Any]] = []
    for k in range(n):
        total, passed = (v, even) if k % 2 == 0 else (i, odd)
        row = [total[j] - (passed[j] if j < k else 0.0) for j in range(n)] + [total[n]]
        rows.append([(2 * k + 1) * entry * rate if entry else 0.0 for entry in row])
    return [*rows, [2.0 * entry - float(j == n) for j, entry in enumerate(i)]]


@arguments_checked
def imbalance(
    static: float | str,
    dynamic: float | str,
    speed: float | str,
    parameters: Sequence[Parameter] = (),
    *,
    name: str = "imbalance",
) -> LFTModel:
    """Force m r w^2 and torque m r h w^2 of an imbalance on the body that carries the wheel.

    A mass m at the radius r and the height h above the port, at the angle w t from x about the spin axis
    z, pulls with m r w^2 [cos, sin, 0] and turns with m r h w^2 [-sin, cos, 0].

    Parameters
    ----------
    static : number or expression, m r (kg m)
    dynamic : number or expression, m r h (kg m^2)
    speed : number or expression, w (rad/s)
    parameters : sequence of Parameter
    name : str

    Returns
    -------
    LFTModel
        Static; inputs ``NAME.cosine`` and ``NAME.sine`` [1], which are cos w t and sin w t; outputs
        ``force.x``, ``force.y`` (N), ``torque.x``, ``torque.y`` (N m). To be put in series with
        the inputs of two forces and two torques of magnitude 0 at the port of the wheel.
    """

    def matrix(v: Mapping[str, Any]) -> list[list[Any]]:
        force, torque = (v[key] * (v["speed"] * v["speed"]) for key in ("static", "dynamic"))
        return [[force, 0.0], [0.0, force], [0.0, -torque], [torque, 0.0]]

    quantities = {
        "static": Expected(static, "kg m"),
        "dynamic": Expected(dynamic, "kg m^2"),
        "speed": Expected(speed, "rad/s"),
    }
    signals = {
        "inputs": [f"{name}.cosine", f"{name}.sine"],
        "outputs": ["force.x", "force.y", "torque.x", "torque.y"],
    }
    return linear_block(name, quantities, parameters, matrix, ("static", "dynamic"), **signals)


def linear_block(
    name: str,
    quantities: Mapping[str, Expected],
    parameters: Sequence[Parameter],
    matrix: Callable[[Mapping[str, Any]], Any],
    may_vanish: Sequence[str] = (),
    **signals: Any,
) -> LFTModel:
    """The LFT model of [A B ; C D] = matrix(values), with the values of the quantities in SI units.

    `quantities` must be positive, those that `may_vanish` not negative; `signals` are the states, inputs
    and outputs, as of `realize`.
    """
    symbols = {p.name: ca.SX.sym(p.name) for p in parameters}
    in_si = {p.name: p.factor * symbols[p.name] for p in parameters}
    dimensions = {p.name: Dimension(parse_unit(p.unit).dimension) for p in parameters}
    values = {}
    for label, expected in quantities.items():
        where, place = f"{name}, {label} = {expected.source!r}", Place(name, label)
        if isinstance(expected.source, bool) or not isinstance(expected.source, int | float | str):
            raise SceneError(f"{where}: expected a number or an expression.")
        values[label] = value_at(place, expected, {**BUILTIN_CONSTANTS, **in_si})
        expression = expression_at(place, expected)
        check_dimension(place, expected, expression, {**BUILTIN_CONSTANTS, **dimensions})
        lowest = _lowest(values[label], parameters, symbols)
        if not (lowest > 0.0 or (lowest == 0.0 and label in may_vanish)):
            raise SceneError(
                f"{where}: expected a positive number, got {lowest:g} {expected.unit} in the range."
            )
    used = tuple(
        p
        for p in parameters
        if any(ca.depends_on(ca.SX(value), symbols[p.name]) for value in values.values())
    )
    rows = [[ca.SX(entry) for entry in row] for row in matrix(values)]
    stacked = ca.vertcat(*(ca.horzcat(*row) for row in rows))
    used_symbols = {p.name: symbols[p.name] for p in used}
    return realize(stacked, used, symbols=used_symbols, name=name, search=0.0, **signals)


def _lowest(value: Any, parameters: Sequence[Parameter], symbols: Mapping[str, ca.SX]) -> float:
    """Smallest value at nominal and at all corners of the range."""
    used = [p for p in parameters if ca.depends_on(ca.SX(value), symbols[p.name])]
    if not used:
        return float(ca.DM(ca.SX(value)))
    function = ca.Function("value", [symbols[p.name] for p in used], [ca.SX(value)])
    columns = corners(used)
    table = [np.append(columns[p.name], p.nominal) for p in used]
    return min(float(function(*point)) for point in zip(*table, strict=True))


DIRECTIONS = (*AXES, *(f"r{axis}" for axis in AXES))
_HOLD, _WRENCH = "hold", "wrench"
_UNITS = {"force": "N", "torque": "N m", "acceleration": "m/s^2", "angular_acceleration": "rad/s^2"}
_ACCELERATIONS = ("acceleration", "angular_acceleration")
_LOADS = ("force", "torque")


@arguments_checked
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
    """
    ports = _ports(body, children, parent)
    check_known("axis", map(str, axes), DIRECTIONS, f"two_port of body {body.name!r}")
    if not axes:
        raise SceneError(f"two_port of body {body.name!r}: axes: name at least one.")
    used = tuple(axis for axis in DIRECTIONS if axis in axes)
    whole = _with_areas(body, used) if isinstance(body, Beam) else body
    model = to_lft(_scene(whole, parameters, constants or {}, ports, parent, used), search)
    loads, accelerations = (
        {
            port: [Signal(f"{port}.{kind}.{axis}", _UNITS[kind]) for kind, axis in _split(used, kinds)]
            for port in (*ports, parent)
        }
        for kinds in (_LOADS, _ACCELERATIONS)
    )
    body_signals = _own(body)
    return replace(
        model,
        lft=_without_rigid_motion(model, [signal.name for signal in model.outputs]),
        states=tuple(s for s in model.states if not s.name.startswith(f"{_HOLD}.")),
        inputs=(*(s for port in ports for s in loads[port]), *accelerations[parent], *body_signals[0]),
        outputs=(*(s for port in ports for s in accelerations[port]), *loads[parent], *body_signals[1]),
        certificate=replace(model.certificate, **NOTHING_FREE),  # P moves, too
    )


def _ports(body: Body, children: Sequence[str] | None, parent: str) -> tuple[str, ...]:
    """The children's ports, checked."""
    if body.name == GROUND:
        raise SceneError(f"two_port: expected a body other than the ground, got {body.kind!r}.")
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


def _without_rigid_motion(model: LFTModel, outputs: Sequence[str]) -> LFT:
    """The LFT without the position and rate of P, and with the reaction of the wrench that holds P.

    Nothing depends on them: there is no load at equilibrium, and P moves as it is told to.
    """
    rigid = [k for k, signal in enumerate(model.states) if signal.name.startswith(f"{_HOLD}.")]
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
