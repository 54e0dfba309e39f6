"""Controllers with free values: each is a fixed frame, closed by a matrix that is affine in the values.

A controller y = K(s, delta) u with values x is the star product of its frame and of a static matrix,

    [xdot ; y ; v] = F(delta) [x ; u ; q],        q = S(x) v,      S(x) = S_0 + x_1 S_1 + x_2 S_2 + ...

Products of values are frames whose v reads q, so that F has a path from q to v: of the PID controller
k_p + k_i/s + k_d N s/(s + N) the row q_1 = N (u - x_f) is read by q_2 = k_p u + k_i x_i + k_d q_1. A
schedule M_0 + delta_1 M_1 + ... has delta_1 v beside v (Apkarian, Gahinet, IEEE Transactions on Automatic
Control 40, 1995, have the same form for controllers that are LFTs).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, check_known
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.lft.lft import LFT, delta, stack_diagonal, stack_rows, with_blocks
from mbdlft.lft.sampling import evaluate_at
from mbdlft.pipeline.models import realize
from mbdlft.system.algebra import lft
from mbdlft.system.conversion import as_system, state_space
from mbdlft.system.model import Parameters, System

_DEPENDENT = 1e6  # condition of modes: beyond it other coordinates are no better
_IDLE = 1e-3  # of a scale: rows of B and columns of C that are no larger count as this
Names = str | Sequence[str]
Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class FreeValue:
    """A number that a tuner chooses.

    Attributes
    ----------
    name : str, that of the controller and of the value, such as ``pid.kp``
    initial : float, where the first search begins
    low, high : float, which may be infinite
    scale : float
        A typical size: other searches begin at random numbers of this size.
    """

    name: str
    initial: float
    low: float
    high: float
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class TunableSystem:
    """A controller with free values, as `tunable_pid` and its like make it.

    Attributes
    ----------
    name : str
    frame : System
        Its inputs are those of the controller, then q; its outputs those of the controller, then v.
    base, moves : arrays (nq, nv), (number of values, nq, nv)
        q = (base + sum of values times moves) v.
    free : tuple of FreeValue
    states : int
        The first rows of q and columns of v, if these are states in any coordinates; else 0.
    """

    name: str
    frame: System
    base: Array
    moves: Array
    free: tuple[FreeValue, ...]
    states: int = 0

    @property
    def channels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the inputs and of the outputs of the controller."""
        nq, nv = self.base.shape
        inputs, outputs = self.frame.inputs, self.frame.outputs
        return tuple(s.name for s in inputs[: len(inputs) - nq]), tuple(
            s.name for s in outputs[: len(outputs) - nv]
        )

    def with_values(self, values: Mapping[str, float]) -> System:
        """The controller with numbers in place of its values; those that are not named are initial.

        Parameters
        ----------
        values : mapping of names, as in `free`, to numbers
        """
        check_known("value", values, [v.name for v in self.free], self.name, StructureError)
        x = np.array([values.get(v.name, v.initial) for v in self.free])
        return lft(self.frame, self.base + np.tensordot(x, self.moves, 1))


def tunable_gain(
    name: str,
    inputs: Names,
    outputs: Names,
    *,
    structure: Any = None,
    initial: Mapping[str, float] | None = None,
    ranges: Ranges | None = None,
    scale: float = 1.0,
) -> TunableSystem:
    """A matrix of gains, y = D u, with the values ``D[row,column]`` counted from 1.

    Parameters
    ----------
    name : str
    inputs, outputs : name, or sequence of names
    structure : array (ny, nu) of bool, optional
        Where an entry is free; the others are zero. All are free by default.
    initial : mapping of names of values to numbers, optional
        Zero where not given.
    ranges : mapping of names of values to (low, high), optional
    scale : float
        A typical size of the entries.
    """
    u, y = listed(inputs), listed(outputs)
    free = _entries("D", np.ones((len(y), len(u))) if structure is None else np.asarray(structure))
    frame = _frame(name, u, y, np.zeros((0, 0)), {"u": np.eye(len(u))}, np.eye(len(y)))
    return _made(name, frame, (len(y), len(u)), free, {}, (initial, ranges, scale))


def tunable_state_space(
    name: str,
    inputs: Names,
    outputs: Names,
    order: int,
    *,
    strictly_proper: bool = False,
    speed: float = 1.0,
    initial: Mapping[str, float] | None = None,
    ranges: Ranges | None = None,
    scale: float = 1.0,
) -> TunableSystem:
    """A state-space controller of an order: xdot = speed (A x + B u), y = C x + D u, all entries free.

    Parameters
    ----------
    name : str
    inputs, outputs : name, or sequence of names
    order : int
    strictly_proper : bool
        Whether D is zero.
    speed : float
        A typical frequency of the loop (rad/s), with which entries of A and B are of the size of 1.
    initial, ranges, scale
        As for `tunable_gain`, of values ``A[1,1]``, ``B[1,1]``, ``C[1,1]``, ``D[1,1]`` and so on; the
        scale is that of C and D.
    """
    if not (isinstance(order, int) and order > 0):
        raise StructureError(
            f"{name}: expected an order of 1 or more, got {order!r}; of order 0 is tunable_gain."
        )
    u, y = listed(inputs), listed(outputs)
    n, nu, ny = order, len(u), len(y)
    free: Entries = {}
    for label, rows, columns in (
        ("A", slice(0, n), slice(0, n)),
        ("B", slice(0, n), slice(n, None)),
        ("C", slice(n, None), slice(0, n)),
        ("D", slice(n, None), slice(n, None)),
    ):
        place = np.zeros((n + ny, n + nu))
        place[rows, columns] = 1.0 - (label == "D") * strictly_proper
        free |= _entries(label, place, (rows.start, columns.start))
    first, last = np.eye(n + ny)[:n], np.eye(n + ny)[n:]
    v = {"x": np.eye(n + nu)[:, :n], "u": np.eye(n + nu)[:, n:]}
    frame = _frame(name, u, y, speed * first, v, last)
    made = _made(name, frame, (n + ny, n + nu), free, {}, (initial, ranges, scale))
    inner = {f"{name}.{label}" for label in free if label[0] in "AB"}
    values = tuple(replace(v, scale=abs(v.initial) or 1.0) if v.name in inner else v for v in made.free)
    return replace(made, free=values, states=0 if ranges else n)


def tunable_pid(
    name: str,
    input: str,
    output: str,
    *,
    filter: float | tuple[float, float] = 100.0,
    terms: str = "PID",
    initial: Mapping[str, float] | None = None,
    ranges: Ranges | None = None,
    scale: float = 1.0,
) -> TunableSystem:
    """A PID controller with filtered derivative, kp + ki/s + kd N s/(s + N).

    Parameters
    ----------
    name : str
    input, output : names
    filter : float, or (low, high)
        The pole N of the filter (rad/s); between two numbers it is the value ``N``.
    terms : str
        The terms that it has, such as ``"PD"``.
    initial, ranges, scale
        As for `tunable_gain`, of the values ``kp``, ``ki``, ``kd``, ``N``.
    """
    poles = (filter, filter) if isinstance(filter, int | float) else filter
    if not 0.0 < poles[0] <= poles[1] < np.inf:
        raise StructureError(f"{name}: expected a positive filter, or (low, high), got {filter!r}.")
    check_known("term", terms, "PID", name, StructureError)
    free: Entries = {label: {place: 1.0} for label, place in _PID.items() if label[1].upper() in terms}
    fixed, ranges = {}, dict(ranges or {})
    if poles[0] == poles[1]:
        fixed = {(0, 2): poles[0]}
    else:
        free, ranges["N"] = {**free, "N": {(0, 2): 1.0}}, poles
        initial = {"N": float(np.sqrt(poles[0] * poles[1])), **(initial or {})}
    # v = (u, x_i, u - x_f, q_1); x_i' = u, x_f' = q_1
    A, D = np.zeros((2, 2)), np.zeros((5, 3))
    B = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    C = np.zeros((5, 2))
    C[2, 0], C[3, 1] = 1.0, -1.0
    D[0, 2], D[1, 0], D[3, 0], D[4, 1] = 1.0, 1.0, 1.0, 1.0
    keep = [k for k, term in enumerate("ID") if term in terms]
    frame = state_space(A[np.ix_(keep, keep)], B[keep], C[:, keep], D, name=name)
    named = _named(frame, name, [input], [output])
    return _made(name, named, (2, 4), free, fixed, (initial, ranges, scale))


_PID = {"kp": (1, 0), "ki": (1, 1), "kd": (1, 3)}


def tunable_transfer(
    name: str,
    input: str,
    output: str,
    order: int,
    *,
    strictly_proper: bool = False,
    speed: float = 1.0,
    initial: Mapping[str, float] | None = None,
    ranges: Ranges | None = None,
    scale: float = 1.0,
) -> TunableSystem:
    """A transfer function (b_n p^n + ... + b_0)/(p^n + a_{n-1} p^(n-1) + ... + a_0), p = s/speed.

    Parameters
    ----------
    name : str
    input, output : names
    order : int
    strictly_proper : bool
        Whether b_n is zero.
    speed : float
        A typical frequency of the loop (rad/s), with which coefficients are of the size of 1.
    initial, ranges, scale
        As for `tunable_gain`, of the values ``a0``, ``a1``, ..., ``b0``, ``b1``, ...
    """
    if not (isinstance(order, int) and order > 0):
        raise StructureError(f"{name}: expected an order of 1 or more, got {order!r}.")
    n = order
    # x_k' = speed x_(k+1), x_n' = speed (u + q_1); v = (x, u + q_1), q_2 = y
    shift = speed * np.eye(n, k=1)
    last = speed * np.eye(n)[:, n - 1 :]
    C = np.vstack([np.zeros((1, n)), np.eye(n), np.zeros((1, n))])
    D = np.zeros((n + 2, 3))
    D[0, 2], D[n + 1, 0], D[n + 1, 1] = 1.0, 1.0, 1.0
    frame = state_space(shift, np.hstack([last, last, 0.0 * last]), C, D, name=name)
    free = {f"a{k}": {(0, k): -1.0} for k in range(n)}
    free |= {f"b{k}": {(1, k): 1.0} for k in range(n + (not strictly_proper))}
    named = _named(frame, name, [input], [output])
    return _made(name, named, (2, n + 1), free, {}, (initial, ranges, scale))


@arguments_checked
def scheduled(
    controller: TunableSystem, parameters: Sequence[Parameter], functions: Sequence[str] = ()
) -> TunableSystem:
    """A controller whose matrix is S = S(x) + f_1 S(x') + f_2 S(x'') + ..., with f_k of parameters.

    Parameters
    ----------
    controller : TunableSystem
        Without parameters. The values of S(x) keep their names; those of S(x') have ``*`` and the name
        of the parameter, or the function, behind, such as ``K.D[1,1]*angle``.
    parameters : sequence of Parameter
        Those of the plant, such as ``model.parameters["angle"]``, that the controller measures.
    functions : sequence of str, optional
        Expressions of the parameters, in their units, such as ``"v^2"``: each is moved and divided, so
        that it is 0 at nominal, and 1 or -1 at the corner of the ranges where it is largest. Without
        them, each f is the delta of a parameter, which is -1 and 1 at the ends of its range.

    Raises
    ------
    StructureError
        The controller is scheduled already, no parameters are given, or a function is constant.
    SceneError, NotRationalError
        A function cannot be read, or is not rational.
    """
    if controller.frame.parameters or not parameters:
        raise StructureError(
            f"{controller.name}: expected a controller that is not scheduled, and one parameter or more."
        )
    of_frame, nv = controller.frame, controller.base.shape[1]
    ordered = sorted(parameters, key=lambda p: p.name)
    labels = list(functions) or [p.name for p in ordered]
    factors = [_factor(f, ordered, controller.name) for f in functions]
    factors = factors or [delta(p.name) for p in ordered]
    inner = of_frame.lft.M22  # [A B ; C D] with v as the last outputs
    copies = inner[len(inner) - nv :]
    lft_of = stack_rows(inner, *(stack_diagonal(*[f] * nv) @ copies for f in factors))
    p = len(factors)
    signals = tuple(Signal(f"v.{nv + k + 1}", "1") for k in range(p * nv))
    frame = System(
        of_frame.name,
        with_blocks(lft_of, [q.name for q in ordered]),
        of_frame.states,
        of_frame.inputs,
        (*of_frame.outputs, *signals),
        Parameters(ordered),
    )
    nothing = np.zeros_like(controller.moves)
    moves = [
        np.concatenate([controller.moves if j == k else nothing for j in range(p + 1)], axis=2)
        for k in range(p + 1)
    ]
    free = list(controller.free)
    for label in labels:
        free += [
            replace(v, name=f"{v.name}*{label}", initial=0.0, low=-np.inf, high=np.inf)
            for v in controller.free
        ]
    base = np.hstack([controller.base, np.zeros((len(controller.base), p * nv))])
    return replace(controller, frame=frame, base=base, moves=np.concatenate(moves), free=tuple(free))


def _factor(function: str, parameters: Sequence[Parameter], name: str) -> LFT:
    """A function of parameters, 0 at nominal and of the size of 1."""
    made = realize([[function]], parameters, search=0.0, prove=0.0).lft
    ends = np.array(list(product((-1.0, 1.0), repeat=len(made.blocks))))
    middle = made.M22.item()
    size = float(np.max(np.abs(evaluate_at(made, ends) - middle), initial=0.0))
    if not size > 0.0:
        raise StructureError(f"{name}: scheduled: {function!r} has the same value at all corners.")
    return LFT(made.M11, made.M12, made.M21 / size, np.zeros((1, 1)), made.blocks)


def in_modes(controller: TunableSystem, x: Array) -> Array:
    """Values of the same controller in other states: the modes of its A, with B and C of like sizes.

    Slow poles are then entries of their own, not differences of large ones. Values (number of values,)
    are returned as they are if the structure fixes the states, or the modes are dependent.
    """
    n, (nq, nv) = controller.states, controller.base.shape
    if not n:
        return x
    S = controller.base + np.tensordot(x, controller.moves, 1)
    width = len(controller.frame.inputs) - nq + n  # of S of one function
    vectors = np.linalg.eig(S[:n, :n])
    columns: list[Array] = []
    for pole, shape in zip(vectors.eigenvalues, vectors.eigenvectors.T, strict=True):
        if pole.imag >= 0.0:
            columns += [shape.real, shape.imag][: 1 + int(pole.imag > 0.0)]
    T = np.array(columns).T
    if not np.linalg.cond(T) < _DEPENDENT:
        return x
    scale = max((value.scale for value in controller.free), default=1.0)
    into = np.linalg.norm(np.linalg.solve(T, S[:n, n:width]), axis=1)
    out = np.linalg.norm(S[n:, :n] @ T, axis=0) / scale
    T = T * np.sqrt((into + _IDLE) / (out + _IDLE))
    left, right = np.eye(nq), np.eye(width)
    left[:n, :n], right[:n, :n] = T, T
    moved = np.linalg.solve(left, S) @ np.kron(np.eye(nv // width), right)
    places = np.argmax(np.abs(controller.moves.reshape(len(x), -1)), axis=1)
    return np.asarray(moved.ravel()[places])


Entries = dict[str, dict[tuple[int, int], float]]  # by label: factors by place in S


def listed(names: Names) -> list[str]:
    """One name, or several, as a list."""
    return [names] if isinstance(names, str) else list(names)


def check_positive(where: str, **numbers: float) -> None:
    """Raise a StructureError unless all numbers are positive and finite."""
    for label, number in numbers.items():
        if not (isinstance(number, int | float) and 0.0 < number < np.inf):
            raise StructureError(f"{where}: expected a positive {label}, got {number!r}.")


def _entries(label: str, place: Array, shift: tuple[int, int] = (0, 0)) -> Entries:
    """Each free entry as a value of its own, named from 1 within its matrix."""
    i0, j0 = shift
    return {f"{label}[{i - i0 + 1},{j - j0 + 1}]": {(int(i), int(j)): 1.0} for i, j in np.argwhere(place)}


def _frame(
    name: str, u: list[str], y: list[str], B: Array, v: Mapping[str, Array], output: Array
) -> System:
    """A frame xdot = B q, y = output q, v = v_x x + v_u u."""
    n, nu, nq = len(B), len(u), output.shape[1]
    of_x = v.get("x", np.zeros((len(v["u"]), n)))
    made = state_space(
        np.zeros((n, n)),
        np.hstack([np.zeros((n, nu)), B.reshape(n, nq)]),
        np.vstack([np.zeros((len(y), n)), of_x]),
        np.block([[np.zeros((len(y), nu)), output], [v["u"], np.zeros((len(of_x), nq))]]),
        name=name,
    )
    return _named(made, name, u, y)


def _named(frame: System, name: str, u: Sequence[str], y: Sequence[str]) -> System:
    """A frame with names of its signals."""
    q = [f"q.{k + 1}" for k in range(len(frame.inputs) - len(u))]
    v = [f"v.{k + 1}" for k in range(len(frame.outputs) - len(y))]
    states = [f"{name}.x{k + 1}" for k in range(len(frame.states))]
    return as_system(frame, inputs=[*u, *q], outputs=[*y, *v], states=states)


def _made(
    name: str,
    frame: System,
    shape: tuple[int, int],
    free: Entries,
    fixed: Mapping[tuple[int, int], float],
    numbers: tuple[Mapping[str, float] | None, Ranges | None, float],
) -> TunableSystem:
    """A controller of its frame, the places of its values, and what is said of their numbers."""
    initial, ranges, scale = numbers[0] or {}, numbers[1] or {}, numbers[2]
    for names in (initial, ranges):
        check_known("value", names, free, name, StructureError)
    moves, base = np.zeros((len(free), *shape)), np.zeros(shape)
    for place, number in fixed.items():
        base[place] = number
    values = []
    for k, (label, places) in enumerate(free.items()):
        for place, factor in places.items():
            moves[k][place] = factor
        low, high = ranges.get(label, (-np.inf, np.inf))
        start = initial.get(label, float(np.clip(0.0, low, high)))
        size = max(abs(start), scale) if label in initial else scale
        if not (low < high and np.isfinite([start, scale]).all() and scale > 0.0):
            raise StructureError(
                f"{name}: {label}: expected a finite start, a positive scale and low < high, got "
                f"{start!r}, {scale!r}, ({low!r}, {high!r})."
            )
        values.append(FreeValue(f"{name}.{label}", float(np.clip(start, low, high)), low, high, size))
    return TunableSystem(name, frame, base, moves, tuple(values))
