"""Sums, products, selections, loops and star products of systems with named signals.

Operands are systems, python-control systems, numbers and matrices. Names follow python-control: the
inputs of the whole are those of the part that is reached first, its outputs those of the last part.
"""

from collections.abc import Sequence
from itertools import pairwise
from numbers import Number
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.base.unit import Signal
from mbdlft.lft.lft import LFT
from mbdlft.system.conversion import ControlSystem, as_system, check_once, positions_of
from mbdlft.system.evidence import Operation, composed
from mbdlft.system.model import System
from mbdlft.system.wiring import plain_wiring

if TYPE_CHECKING:
    from mbdlft.system.model import LFTModel


def combine(a: Any, b: Any, sign: float = 1.0) -> System:
    """a + sign b: the same inputs, outputs added up; a number is added to each entry of D."""
    first, second = _of_shape(a, b), _of_shape(b, a)
    ny, nu = len(first.outputs), len(first.inputs)
    if (len(second.outputs), len(second.inputs)) != (ny, nu):
        raise StructureError(
            f"{first.name} has {ny} outputs and {nu} inputs, {second.name} has {len(second.outputs)} and "
            f"{len(second.inputs)}; sums need as many of each."
        )
    systems = (first, second)
    wiring = plain_wiring(systems, nu, ny)
    wiring.E[:nu], wiring.E[nu:] = np.eye(nu), np.eye(nu)
    wiring.F[:, :ny], wiring.F[:, ny:] = np.eye(ny), sign * np.eye(ny)
    named = second if _is_matrix(a) else first
    asked = {"sign": sign} if sign != 1.0 else {}
    operation = Operation("sum", asked)
    return composed(systems, wiring, named.inputs, named.outputs, operation, like=named)


def negative(a: System) -> System:
    """The system with -y."""
    wiring = plain_wiring([a], len(a.inputs), len(a.outputs))
    wiring.E[:], wiring.F[:] = np.eye(len(a.inputs)), -np.eye(len(a.outputs))
    return composed([a], wiring, a.inputs, a.outputs, Operation("negative"))


def chain(items: Sequence[Any]) -> System:
    """The outputs of each part are the inputs of the next; a number multiplies all signals."""
    systems = list(items)
    for k in [*range(1, len(systems)), *reversed(range(len(systems) - 1))]:
        # numbers and matrices without names take those of what they stand beside
        before = systems[k - 1].outputs if k and isinstance(systems[k - 1], System) else None
        after = k + 1 < len(systems) and isinstance(systems[k + 1], System) and systems[k + 1].inputs
        if not isinstance(systems[k], System):
            systems[k] = _beside(systems[k], before, after or None)
    systems = [system if isinstance(system, System) else as_system(system) for system in systems]
    wiring = plain_wiring(systems, len(systems[0].inputs), len(systems[-1].outputs))
    u, y = len(systems[0].inputs), 0
    wiring.E[:u] = np.eye(u)
    for first, second in pairwise(systems):
        n = len(second.inputs)
        if len(first.outputs) != n:
            raise StructureError(
                f"series: {first.name} has {len(first.outputs)} outputs ({_listed(first.outputs)}) for "
                f"the {n} inputs of {second.name} ({_listed(second.inputs)})."
            )
        wiring.Ky[u : u + n, y : y + n] = np.eye(n)
        u, y = u + n, y + n
    wiring.F[:, y:] = np.eye(len(systems[-1].outputs))
    named = next(
        (system for system in reversed(systems) if system.states or system.parameters), systems[0]
    )
    return composed(
        systems, wiring, systems[0].inputs, systems[-1].outputs, Operation("series"), like=named
    )


def selected(a: System, key: Any) -> System:
    """Some outputs and inputs, in the order asked for; all states stay."""
    if not isinstance(key, tuple) or len(key) != 2:
        raise StructureError(
            f"model {a.name!r}: expected model[outputs, inputs], with names, lists of names or slices, "
            f"got model[{key!r}]."
        )
    rows, columns = (
        positions_of(asked, [signal.name for signal in signals], f"model {a.name!r}, {what}")
        for asked, signals, what in zip(key, (a.outputs, a.inputs), ("outputs", "inputs"), strict=True)
    )
    wiring = plain_wiring([a], len(columns), len(rows))
    wiring.E[columns, range(len(columns))] = 1.0
    wiring.F[range(len(rows)), rows] = 1.0
    inputs, outputs = [a.inputs[k] for k in columns], [a.outputs[k] for k in rows]
    asked = {"outputs": [s.name for s in outputs], "inputs": [s.name for s in inputs]}
    return composed([a], wiring, inputs, outputs, Operation("selection", asked))


def append(*items: Any) -> System:
    """Systems side by side: all inputs and all outputs, nothing connected.

    Parameters
    ----------
    items : System, python-control system, number or matrix
        One or more. The result has the name of the first.

    Returns
    -------
    System, or LFTModel where all items with parameters are

    Raises
    ------
    StructureError
        There are none, or a name of an input or of an output stands twice.
    """
    if not items:
        raise StructureError("append: expected one system or more.")
    systems = [as_system(item) for item in items]
    inputs, outputs = ([s for p in systems for s in getattr(p, k)] for k in ("inputs", "outputs"))
    check_once([s.name for s in inputs], "append, inputs")
    check_once([s.name for s in outputs], "append, outputs")
    wiring = plain_wiring(systems, len(inputs), len(outputs))
    wiring.E[:], wiring.F[:] = np.eye(len(inputs)), np.eye(len(outputs))
    return composed(systems, wiring, inputs, outputs, Operation("append"))


@overload
def feedback(
    plant: "LFTModel", controller: "LFTModel | float | Array | ControlSystem" = 1.0, sign: int = -1
) -> "LFTModel": ...
@overload
def feedback(plant: Any, controller: Any = 1.0, sign: int = -1) -> System: ...
def feedback(plant: Any, controller: Any = 1.0, sign: int = -1) -> System:
    """The loop y = P (u + sign K y) of a plant P and a controller K.

    Parameters
    ----------
    plant : System, python-control system, number or matrix
    controller : the same
        If its inputs are named like outputs of the plant and its outputs like inputs, these are
        connected and the others stay free; otherwise all are, in their order, and the numbers must fit. A
        number multiplies all signals.
    sign : -1 or 1
        Negative feedback, as in python-control, or positive.

    Returns
    -------
    System, or LFTModel where plant and controller are or have no parameters
        With the inputs, outputs and name of the plant; states of the plant, then of the controller.

    Raises
    ------
    StructureError
        The signals do not fit, or parameters of one name differ.
    WellPosednessError
        The loop is singular at nominal or in the range.
    """
    if sign not in (-1, 1):
        raise StructureError(f"feedback: sign is -1 or 1, got {sign!r}.")
    p = plant if isinstance(plant, System) else None
    k = controller if isinstance(controller, System) else None
    if p is None:
        p = _beside(plant, k.outputs if k else None, k.inputs if k else None)
    if k is None:
        k = _beside(controller, p.outputs, p.inputs)
    read, driven = _loop_positions(p, k)
    nu, ny = len(p.inputs), len(p.outputs)
    wiring = plain_wiring((p, k), nu, ny)
    wiring.E[:nu], wiring.F[:, :ny] = np.eye(nu), np.eye(ny)
    wiring.Ky[driven, range(ny, ny + len(k.outputs))] = sign
    wiring.Ky[range(nu, nu + len(k.inputs)), read] = 1.0
    return composed((p, k), wiring, p.inputs, p.outputs, Operation("feedback", {"sign": sign}))


def _loop_positions(plant: System, controller: System) -> tuple[list[int], list[int]]:
    """Outputs of the plant that a controller reads, and inputs that it drives."""
    measured, driven = ([signal.name for signal in signals] for signals in (plant.outputs, plant.inputs))
    reads, writes = (
        [signal.name for signal in signals] for signals in (controller.inputs, controller.outputs)
    )
    if set(reads) <= set(measured) and set(writes) <= set(driven):
        return [measured.index(n) for n in reads], [driven.index(n) for n in writes]
    if (len(reads), len(writes)) == (len(measured), len(driven)):
        return list(range(len(reads))), list(range(len(writes)))
    raise StructureError(
        f"feedback: {controller.name} reads {', '.join(reads)} and drives {', '.join(writes)}, which are "
        f"neither outputs ({', '.join(measured)}) and inputs ({', '.join(driven)}) of {plant.name} nor "
        "as many."
    )


def lft(upper: Any, lower: Any, outputs: Sequence[str] | int | None = None, inputs: Any = None) -> System:
    """The star product (Redheffer): `upper` closed through `lower`, as a plant through its controller.

    Parameters
    ----------
    upper, lower : System, python-control system, number or matrix
    outputs : sequence of str, or int, optional
        Outputs of `upper` that the first inputs of `lower` are connected to, in this order; a number: the
        last ones. By default as many as both have, as in python-control.
    inputs : the same of the inputs of `upper`, which the first outputs of `lower` drive

    Returns
    -------
    System, or LFTModel where both are or have no parameters
        Its inputs are the free ones of `upper`, then those of `lower`; likewise its outputs.

    Raises
    ------
    StructureError
        A name is unknown, there are too few signals, or a name of the whole stands twice.
    WellPosednessError
        The loop is singular at nominal or in the range.
    """
    p, k = as_system(upper), as_system(lower)
    closed = []
    for asked, signals, other, what in (
        (outputs, p.outputs, k.inputs, "outputs"),
        (inputs, p.inputs, k.outputs, "inputs"),
    ):
        if asked is None:
            asked = min(len(signals), len(other))
        names = [signal.name for signal in signals]
        if isinstance(asked, int | np.integer) and 0 <= asked <= len(names):
            asked = names[len(names) - asked :]
        chosen = positions_of(asked, names, f"lft: {what} of {p.name}")
        if len(chosen) > len(other):
            raise StructureError(
                f"lft: {what} of {p.name}: {', '.join(names[j] for j in chosen)} are {len(chosen)}, and "
                f"{k.name} has {len(other)} signals to connect them to: {_listed(other)}."
            )
        closed.append(chosen)
    read, driven = closed
    free_y, free_u = (
        [j for j in range(len(free_signals)) if j not in used]
        for free_signals, used in ((p.outputs, read), (p.inputs, driven))
    )
    nu, ny, a, b = len(p.inputs), len(p.outputs), len(free_u), len(free_y)
    new_u, new_y = [*(p.inputs[j] for j in free_u)], [*(p.outputs[j] for j in free_y)]
    new_u += k.inputs[len(read) :]
    new_y += k.outputs[len(driven) :]
    check_once([s.name for s in new_u], "lft, inputs")
    check_once([s.name for s in new_y], "lft, outputs")
    wiring = plain_wiring((p, k), len(new_u), len(new_y))
    wiring.E[free_u, range(a)], wiring.F[range(b), free_y] = 1.0, 1.0
    wiring.E[range(nu + len(read), nu + len(k.inputs)), range(a, len(new_u))] = 1.0
    wiring.F[range(b, len(new_y)), range(ny + len(driven), ny + len(k.outputs))] = 1.0
    wiring.Ky[driven, range(ny, ny + len(driven))] = 1.0
    wiring.Ky[range(nu, nu + len(read)), read] = 1.0
    closed_names = {
        "outputs": [p.outputs[j].name for j in read],
        "inputs": [p.inputs[j].name for j in driven],
    }
    return composed((p, k), wiring, new_u, new_y, Operation("lft", closed_names))


def _is_matrix(item: Any) -> bool:
    """Whether an operand is a number or a matrix, which has no names of its own."""
    return not isinstance(item, System | LFT) and not hasattr(item, "dt")


def _is_number(item: Any) -> bool:
    return isinstance(item, Number) or (isinstance(item, np.ndarray) and item.ndim == 0)


def _of_shape(item: Any, other: Any) -> System:
    """An operand of a sum; a number is a matrix of the shape of the other operand."""
    if _is_number(item) and isinstance(other, System):
        return as_system(np.full((len(other.outputs), len(other.inputs)), item))
    return as_system(item)


def _beside(item: Any, before: Sequence[Signal] | None, after: Sequence[Signal] | None) -> System:
    """A part between signals: a number multiplies all of them, a matrix takes names of those that fit."""
    near = before or after
    if _is_number(item) and near is not None:
        if before is not None and after is not None and len(before) != len(after):
            raise StructureError(
                f"the number {item} stands between {len(before)} signals ({_listed(before)}) and "
                f"{len(after)} ({_listed(after)}); give a matrix."
            )
        item = np.where(np.eye(len(near)), item, 0.0)
    made = as_system(item)
    if not _is_matrix(item):
        return made
    square = len(made.inputs) == len(made.outputs)
    source, target = before or (after if square else None), after or (before if square else None)
    return as_system(
        made,
        inputs=source if source and len(source) == len(made.inputs) else None,
        outputs=target if target and len(target) == len(made.outputs) else None,
    )


def _listed(signals: Sequence[Signal]) -> str:
    return ", ".join(signal.name for signal in signals) or "none"
