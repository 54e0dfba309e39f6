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
from mbdlft.base.errors import StructureError, naming
from mbdlft.base.unit import Signal
from mbdlft.lft.lft import LFT
from mbdlft.system.conversion import ControlSystem, as_system, operand, positions_of
from mbdlft.system.evidence import Operation, composed, linked
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
    operation = Operation("sum", {"sign": sign} if sign != 1.0 else {})
    return composed(systems, wiring, named.inputs, named.outputs, operation, like=named)


def chain(items: Sequence[Any]) -> System:
    """The outputs of each part are the inputs of the next; a number multiplies all signals."""
    systems = list(items)
    for k in [*range(1, len(systems)), *reversed(range(len(systems) - 1))]:
        # numbers and matrices without names take those of what they stand beside
        before = systems[k - 1].outputs if k and isinstance(systems[k - 1], System) else None
        after = k + 1 < len(systems) and isinstance(systems[k + 1], System) and systems[k + 1].inputs
        if not isinstance(systems[k], System):
            with naming(f"series: part {k + 1}", StructureError):
                systems[k] = _beside(systems[k], before, after or None)
    systems = [as_system(system) for system in systems]
    u, y, rows, columns = len(systems[0].inputs), 0, list[int](), list[int]()
    for first, second in pairwise(systems):
        n = len(second.inputs)
        if len(first.outputs) != n:
            raise StructureError(
                f"series: {first.name} has {len(first.outputs)} outputs ({_listed(first.outputs)}) for "
                f"the {n} inputs of {second.name} ({_listed(second.inputs)})."
            )
        rows += range(u, u + n)
        columns += range(y, y + n)
        u, y = u + n, y + n
    like = next(
        (system for system in reversed(systems) if system.states or system.parameters), systems[0]
    )
    ends = range(len(systems[0].inputs)), range(y, y + len(systems[-1].outputs))
    return linked(systems, (rows, columns), *ends, Operation("series"), like=like)


def selected(a: System, key: Any) -> System:
    """Some outputs and inputs, in the order asked for; all states stay."""
    if not isinstance(key, tuple) or len(key) != 2:
        raise StructureError(
            f"model {a.name!r}: expected model[outputs, inputs], with names, lists of names or slices, "
            f"got model[{key!r}]."
        )
    inputs, outputs = ({signal.name for signal in signals} for signals in (a.inputs, a.outputs))
    first, second = (name if isinstance(name, str) else "" for name in key)
    if first in inputs - outputs and second in outputs - inputs:
        raise StructureError(
            f"model {a.name!r}: {first!r} is an input, {second!r} an output, and outputs come first: "
            f"model[{second!r}, {first!r}]."
        )
    rows, columns = (
        positions_of(asked, [signal.name for signal in signals], f"model {a.name!r}, {what}")
        for asked, signals, what in zip(key, (a.outputs, a.inputs), ("outputs", "inputs"), strict=True)
    )
    names = {"outputs": [a.outputs[k].name for k in rows], "inputs": [a.inputs[k].name for k in columns]}
    return linked([a], ((), ()), columns, rows, Operation("selection", names))


def append(*items: Any) -> System:
    """Systems side by side: all inputs and all outputs, nothing connected.

    Parameters
    ----------
    items : System, python-control system, number or matrix
        One or more. The result has the name of the first.

    Returns
    -------
    System, or LFTModel where all items with parameters are
    """
    if not items:
        raise StructureError("append: expected one system or more.")
    systems = [operand(item, f"append: items[{k}]") for k, item in enumerate(items)]
    nu, ny = (sum(len(getattr(system, key)) for system in systems) for key in ("inputs", "outputs"))
    return linked(systems, ((), ()), range(nu), range(ny), Operation("append"))


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
    WellPosednessError
        The loop is singular at nominal or in the range.
    """
    if sign not in (-1, 1):
        raise StructureError(f"feedback: sign is -1 or 1, got {sign!r}.")
    p = plant if isinstance(plant, System) else None
    k = controller if isinstance(controller, System) else None
    if p is None:
        with naming("feedback: plant", StructureError):
            p = _beside(plant, k.outputs if k else None, k.inputs if k else None)
    if k is None:
        with naming("feedback: controller", StructureError):
            k = _beside(controller, p.outputs, p.inputs)
    read, driven = _loop_positions(p, k)
    nu, ny = len(p.inputs), len(p.outputs)
    links = ([*driven, *range(nu, nu + len(read))], [*range(ny, ny + len(driven)), *read])
    gains = [sign] * len(driven) + [1] * len(read)
    operation = Operation("feedback", {"sign": sign})
    return linked((p, k), links, range(nu), range(ny), operation, gains=gains)


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
    WellPosednessError
        The loop is singular at nominal or in the range.
    """
    p, k = operand(upper, "lft: upper"), operand(lower, "lft: lower")
    read = _closed(p, "outputs", outputs, k, "inputs")
    driven = _closed(p, "inputs", inputs, k, "outputs")
    nu, ny, n, m = len(p.inputs), len(p.outputs), len(read), len(driven)
    free_u = [*(j for j in range(nu) if j not in driven), *range(nu + n, nu + len(k.inputs))]
    free_y = [*(j for j in range(ny) if j not in read), *range(ny + m, ny + len(k.outputs))]
    links = ([*driven, *range(nu, nu + n)], [*range(ny, ny + m), *read])
    names = {"outputs": [p.outputs[j].name for j in read], "inputs": [p.inputs[j].name for j in driven]}
    return linked((p, k), links, free_u, free_y, Operation("lft", names))


def _closed(p: System, what: str, asked: Any, k: System, what_of_k: str) -> list[int]:
    """Positions of the signals of the upper system that are connected to the first ones of the lower."""
    signals, other = getattr(p, what), getattr(k, what_of_k)
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
    return chosen


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
