"""A system as the matrices whose stability or gain is asked for, and coordinates near to one in size.

The nominal system has to be stable; an error names the pole that is not. In modal coordinates the modes
are scaled by powers of two until B and C are of one size for each.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.parameter import to_physical
from mbdlft.exact.rounding import eigenvectors_of
from mbdlft.lft.block import Block
from mbdlft.lft.lft import check_plain
from mbdlft.response.modes import balancing
from mbdlft.robust.bisect.characteristic import Realization, is_hurwitz
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import System

AXIS = 1e-9  # of the size of a pole, or of the largest: nearer to the axis, it is said to lie on it
_DEPENDENT = 1e10  # condition of modes from which on states are only scaled


def realization(
    model: System,
    inputs: Sequence[int] = (),
    outputs: Sequence[int] = (),
    leave_out: Sequence[str] = (),
    *,
    others_are_zero: bool = False,
    balanced: bool = False,
) -> Realization:
    """The matrices of a system with parameters only, and of the channels whose gain is asked for.

    With `others_are_zero`, blocks that are not parameters are left out; else they are an error. With
    `balanced`, states are scaled by powers of 2.
    """
    lft = model.lft
    if not others_are_zero:
        check_plain(lft, f"the analysis of {model.name!r}")
    blocks = [block for block in lft.blocks if block.size and block.kind == "real"]
    stay = states_that_stay(model, leave_out, outputs)
    names, sizes = tuple(block.name for block in blocks), tuple(block.size for block in blocks)
    plain = Realization(names, sizes, *matrices_of(model, blocks, stay, inputs, outputs))
    if not balanced:
        return plain
    scale = balancing(plain.A)
    return turned(plain, np.diag(1.0 / scale), np.diag(scale))


def matrices_of(
    model: System,
    blocks: Sequence[Block],
    states: Sequence[int],
    inputs: Sequence[int],
    outputs: Sequence[int],
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array]:
    """A, B, C, D, E, F, G, H, J of a `Realization`, of some blocks, states, inputs and outputs."""
    lft = model.lft
    z = [k for block in blocks for k in range(lft.order)[lft.slices()[block.name]]]
    w = [k for block in blocks for k in range(lft.M11.shape[1])[lft.columns()[block.name]]]
    x, i, j = list(states), list(outputs), list(inputs)
    return (
        model.A[np.ix_(x, x)],
        model.B_w[np.ix_(x, w)],
        model.C_z[np.ix_(z, x)],
        model.D_zw[np.ix_(z, w)],
        model.B_u[np.ix_(x, j)],
        model.D_zu[np.ix_(z, j)],
        model.C_y[np.ix_(i, x)],
        model.D_yw[np.ix_(i, w)],
        model.D_yu[np.ix_(i, j)],
    )


CYCLIC = "cyclic"  # what `leave_out` says for all `cyclic_states`


def left_out(model: System, leave_out: Sequence[str], outputs: Sequence[int] = ()) -> tuple[str, ...]:
    """The names of states that are left out, with those of all cyclic ones in place of the word."""
    asked = [leave_out] if isinstance(leave_out, str) else list(leave_out)
    if CYCLIC not in asked:
        return tuple(asked)
    every = (*(name for name in asked if name != CYCLIC), *cyclic_states(model, outputs))
    return tuple(dict.fromkeys(every))


def cyclic_states(model: System, outputs: Sequence[int] = ()) -> tuple[str, ...]:
    """Names of the integrators on which nothing depends but others of them, and no output that is chosen.

    Such are positions and rates of a free body. One that depends on itself, or on each other, is none.
    """
    rows = np.vstack([model.A, model.C_z, model.C_y[list(outputs)]])
    cyclic: list[int] = []
    while True:
        others = np.delete(np.arange(len(rows)), cyclic)
        further = [k for k in range(len(model.states)) if k not in cyclic and not np.any(rows[others, k])]
        if not further:
            return tuple(model.states[k].name for k in sorted(cyclic))
        cyclic += further


def or_left_out(model: System, outputs: Sequence[int] = ()) -> str:
    """The end of an advice: which states can be left out, or how a scene is made without a free mode."""
    if not (cyclic := cyclic_states(model, outputs)):
        return (
            "; or, where it is free, such as the heading of a vehicle or a drive that turns, make the "
            "scene without outputs that see it, with states = 'needed'"
        )
    return (
        f"; or leave out states on which nothing else depends, leave_out = 'cyclic': {', '.join(cyclic)}"
    )


def states_that_stay(model: System, leave_out: Sequence[str], outputs: Sequence[int] = ()) -> list[int]:
    """Positions of the states that are not left out; an error if one of those depends on one of these."""
    names = [state.name for state in model.states]
    gone = positions_of(list(leave_out), names, f"model {model.name!r}, states to leave out")
    stay = [k for k in range(len(names)) if k not in gone]
    channels = [block.name for block in model.lft.blocks for _ in range(block.inputs)]
    readers = (
        ("state", [names[k] for k in stay], model.A[stay]),
        ("uncertain quantity", channels, model.C_z),
        ("output", [model.outputs[k].name for k in outputs], model.C_y[list(outputs)]),
    )
    for what, readers_of, rows in readers:
        for k in gone:
            reading = np.flatnonzero(rows[:, k])
            if len(reading):
                raise AnalysisError(
                    f"model {model.name!r}: the state {names[k]} cannot be left out: the {what} "
                    f"{readers_of[int(reading[0])]} depends on it. Leave that out, too, or close a loop."
                )
    return stay


def stable_states(
    model: System, leave_out: Sequence[str], what: str, outputs: Sequence[int] = ()
) -> list[int]:
    """As `states_that_stay`, of a model that is nominally stable; else the error names the pole."""
    stay = states_that_stay(model, leave_out, outputs)
    A = model.A[np.ix_(stay, stay)]
    if not stay:
        return stay
    if model.lft.is_complex:
        raise AnalysisError(f"{what}: model {model.name!r}: expected real matrices; an entry is complex.")
    poles, _, shapes = eigenvectors_of(A)
    if np.max(poles.real) < 0.0 and is_hurwitz(A):
        return stay
    worst = int(np.argmax(poles.real))
    pole, size = poles[worst], float(np.max(np.abs(poles)))
    names = moving_most(model, stay, shapes[:, worst])
    where = f"{pole.real:.4g}{pole.imag:+.4g}j rad/s, in which {names} move"
    if abs(pole.real) <= AXIS * max(abs(pole), size):
        raise AnalysisError(
            f"{what}: model {model.name!r}: the nominal model has a pole on the imaginary axis, {where}: "
            "no range is robustly stable. Close a loop around this mode, or give it damping"
            f"{or_left_out(model, outputs)}."
        )
    raise AnalysisError(
        f"{what}: model {model.name!r}: the nominal model is unstable, with the pole {where}. Close "
        "the loop with a controller that stabilizes it, such as feedback(model, controller), first."
    )


def moving_most(model: System, states: Sequence[int], shape: Array) -> str:
    """Names of up to three states that move most in a mode, whose shape has an entry for each state."""
    size = np.abs(shape)
    largest = [k for k in np.argsort(-size)[:3] if size[k] > 0.1 * np.max(size)]
    return ", ".join(model.states[states[k]].name for k in largest)


def check_parameters(model: System, what: str) -> None:
    """Raise an AnalysisError if Delta is empty."""
    if not model.order:
        raise AnalysisError(
            f"{what}: model {model.name!r} has no parameter and no uncertain block: there is no margin. "
            "Its poles say all."
        )


def check_constant(system: System, what: str) -> None:
    """Raise an AnalysisError if gains of nonlinear functions would be taken as constant."""
    moving = [p.name for p in system.parameters if p.role == "nonlinear"]
    if moving:
        raise AnalysisError(
            f"{what}: model {system.name!r}: {', '.join(moving)} stand for nonlinear functions, and "
            "move; this analysis takes parameters as constant, which robust_stability and "
            "worst_case_gain do not."
        )


def physical(model: System, names: Sequence[str], delta: Array) -> dict[str, float]:
    """Physical values of all parameters by name, those without a delta at nominal."""
    values = dict(zip(names, delta.tolist(), strict=True))
    return {p.name: float(to_physical(p, values.get(p.name, 0.0))) for p in model.parameters}


def shares(names: Sequence[str], changes: Array) -> Mapping[str, float]:
    """Parts of a sum, none negative, by name; they add up to 1."""
    total = float(np.sum(np.abs(changes)))
    sizes = np.abs(changes) / total if total > 0.0 else np.zeros(len(changes))
    return dict(zip(names, sizes.tolist(), strict=True))


class Coordinates(NamedTuple):
    """What states are multiplied with, (n, n), and what back; powers of two.

    These are what channels (r,) are divided by, and time (rad/s) is multiplied with.
    """

    states: Array
    back: Array
    channels: Array
    time: float


def modal(model: Realization) -> Coordinates:
    """The modes of A, of one or two real states; scaled states if modes are nearly dependent."""
    n = len(model.A)
    if not n:
        return Coordinates(np.zeros((0, 0)), np.zeros((0, 0)), np.ones(len(model.D)), 1.0)
    scale = balancing(model.A)
    values, _, vectors = eigenvectors_of(model.A * scale / scale[:, None])
    sizes = np.abs(values[values != 0.0])
    time = float(2.0 ** np.round(np.mean(np.log2(sizes)))) if len(sizes) else 1.0
    modes, owner = real_columns(values, vectors)
    if np.linalg.cond(modes) > _DEPENDENT:
        modes, owner = np.eye(n), np.arange(n)
    B, C = np.linalg.solve(modes, model.B / scale[:, None]), model.C * scale @ modes
    back: Array = scale[:, None] * modes * _between(C.T, np.asarray(B), owner)
    states = np.asarray(np.linalg.inv(back))
    channel = np.repeat(np.arange(len(model.sizes)), model.sizes)
    channels = _between((states @ model.B).T / time, model.C @ back, channel)
    return Coordinates(states, back, channels, time)


def real_columns(values: Array, vectors: Array) -> tuple[Array, NDArray[np.int64]]:
    """Real and imaginary parts of modes as columns (n, n), of one of each pair, and the mode of each."""
    columns: list[Array] = []
    owner: list[int] = []
    for k in np.flatnonzero(values.imag >= 0.0):
        shapes = (vectors[:, k].real, vectors[:, k].imag)[: 1 + int(values[k].imag > 0.0)]
        columns += shapes
        owner += [int(k)] * len(shapes)
    return np.array(columns).T, np.array(owner, dtype=np.int64)


def turned(model: Realization, states: Array, back: Array) -> Realization:
    """The model with other states."""
    return model._replace(
        A=states @ model.A @ back,
        B=states @ model.B,
        C=model.C @ back,
        E=states @ model.E,
        G=model.G @ back,
    )


def _between(first: Array, second: Array, owner: NDArray[np.int64]) -> Array:
    """Powers of two that make rows of `one` times them and of `other` over them equal, by owners."""
    sizes = []
    for rows in (first, second):
        squares = np.bincount(
            owner, np.sum(rows**2, axis=1), minlength=int(np.max(owner, initial=-1)) + 1
        )
        sizes.append(np.sqrt(squares[owner]))
    both = (sizes[0] > 0.0) & (sizes[1] > 0.0)
    ratio = np.where(both, sizes[1], 1.0) / np.where(both, sizes[0], 1.0)
    return np.asarray(2.0 ** np.round(0.5 * np.log2(ratio)))
