"""Systems connected by the names of their signals.

input = sum of (signed) outputs of systems and of inputs of the whole
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.base.signal import Signal
from mbdlft.system.conversion import as_system
from mbdlft.system.evidence import Operation, composed
from mbdlft.system.names import check_once
from mbdlft.system.system import System
from mbdlft.system.wiring import Wiring, plain_wiring


def connect(
    systems: Sequence[Any],
    connections: Sequence[Sequence[str]] | Mapping[str, str | Sequence[str]] | None = None,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    name: str | None = None,
) -> System:
    """Systems wired by the names of their signals.

    Parameters
    ----------
    systems : sequence of System or python-control systems
    connections : sequence of sequences of str, or mapping of str to str or sequence of str, optional
        ``["controller.e", "r", "-plant.y"]`` or ``{"controller.e": ["r", "-plant.y"]}``: an input of
        a system, then the outputs, or inputs of the whole, that add up to it; ``-`` takes one away. A
        signal is called by its name, or, where several systems have it, by ``SYSTEM.NAME``. Not given:
        inputs get the outputs of the same name.
    inputs : sequence of str
        Inputs of the whole: inputs of systems (all of that name), to which they are added, or new names
        that stand in `connections`.
    outputs : sequence of str
        Outputs of the whole: outputs of systems, or inputs of systems, which are what adds up there.
    name : str, optional
        That of the first system by default.

    Returns
    -------
    System, or LFTModel where all systems with parameters are
        The states are those of the systems, in their order.

    Raises
    ------
    StructureError
        A name is unknown, stands for several signals or stands twice, or an input is not connected.
    WellPosednessError
        A loop is singular at nominal or in the range.
    """
    parts = [as_system(item) for item in systems]
    if not parts:
        raise StructureError("connect: expected one system or more.")
    for asked, what in ((inputs, "inputs"), (outputs, "outputs")):
        if isinstance(asked, str):
            raise StructureError(f"connect, {what}: expected a list of names, got {asked!r}.")
        check_once(list(asked), f"connect, {what}")
    table = _Table.of(parts)
    wiring = plain_wiring(parts, len(inputs), len(outputs))
    asked_for = _pairs(connections)
    if asked_for is None:
        _by_name(table, wiring)
    else:
        _as_asked(table, wiring, asked_for, list(inputs))
    given = [_drive(table, wiring, name, k, asked_for) for k, name in enumerate(inputs)]
    read = [_read(table, wiring, name, k) for k, name in enumerate(outputs)]
    _check_driven(table, wiring)
    operation = Operation("connect", {"connections": [[a, *b] for a, b in (asked_for or [])]})
    like = as_system(parts[0], name=name)
    return composed(parts, wiring, given, read, operation, like=like)


class _Table(NamedTuple):
    """Inputs and outputs of all systems: system, signal; their positions are those in the wiring."""

    inputs: list[tuple[str, Signal]]
    outputs: list[tuple[str, Signal]]

    @classmethod
    def of(cls, parts: Sequence[System]) -> "_Table":
        return cls(
            [(part.name, signal) for part in parts for signal in part.inputs],
            [(part.name, signal) for part in parts for signal in part.outputs],
        )


def _matches(entries: Sequence[tuple[str, Signal]], name: str) -> list[int]:
    """Positions of a name, alone or with that of its system."""
    return [
        k
        for k, (owner, signal) in enumerate(entries)
        if name in (signal.name, f"{owner}.{signal.name}")
    ]


def _one(entries: Sequence[tuple[str, Signal]], name: str, what: str) -> int:
    """The position of a name that stands for one signal."""
    found = _matches(entries, name)
    if not found:
        every = [f"{owner}.{signal.name}" for owner, signal in entries]
        raise StructureError("connect: " + unknown_name(what, name, every))
    if len(found) > 1:
        several = [f"{entries[k][0]}.{entries[k][1].name}" for k in found]
        says = f"Say which: {', '.join(several)}."
        if len(set(several)) < len(several):
            says = "Two systems have one name: as_system(item, name=...) gives another one."
        raise StructureError(f"connect: the {what} {name!r} is not one signal. {says}")
    return found[0]


def _pairs(connections: Any) -> list[tuple[str, list[str]]] | None:
    """Each input with what adds up to it."""
    if connections is None:
        return None
    if isinstance(connections, Mapping):
        connections = [
            [key, *([value] if isinstance(value, str) else value)]
            for key, value in connections.items()
        ]
    found = []
    for entry in connections:
        if isinstance(entry, str) or len(entry) < 2 or not all(isinstance(n, str) for n in entry):
            raise StructureError(
                "connect, connections: expected lists of an input and one or more outputs, such as "
                f"['controller.e', 'r', '-plant.y'], got {entry!r}."
            )
        found.append((entry[0], list(entry[1:])))
    return found


def _by_name(table: _Table, wiring: Wiring) -> None:
    """Each input gets the output of its name, if there is one."""
    for k, (_, signal) in enumerate(table.inputs):
        if any(output.name == signal.name for _, output in table.outputs):
            wiring.Ky[k, _one(table.outputs, signal.name, "output")] += 1.0


def _as_asked(
    table: _Table, wiring: Wiring, pairs: Sequence[tuple[str, list[str]]], inputs: list[str]
) -> None:
    for target, sources in pairs:
        k = _one(table.inputs, target, "input")
        for source in sources:
            sign, name = (-1.0, source[1:]) if source.startswith("-") else (1.0, source)
            if name in inputs and not _matches(table.outputs, name):
                wiring.E[k, inputs.index(name)] += sign
            else:
                wiring.Ky[k, _one(table.outputs, name, "output")] += sign


def _drive(table: _Table, wiring: Wiring, name: str, k: int, pairs: Sequence[Any] | None) -> Signal:
    """Let an input of the whole drive the inputs of its name; its signal."""
    found = _matches(table.inputs, name)
    named = wiring.E[:, k].any()
    if not found and not named:
        every = [f"{owner}.{signal.name}" for owner, signal in table.inputs]
        advice = "" if pairs is None else " No connection has it either."
        raise StructureError("connect, inputs: " + unknown_name("input", name, every) + advice)
    if not named:
        wiring.E[found, k] += 1.0
    driven = [int(j) for j in wiring.E[:, k].nonzero()[0]]
    units = {table.inputs[j][1].unit for j in driven}
    return Signal(name, units.pop() if len(units) == 1 else "1")


def _read(table: _Table, wiring: Wiring, name: str, k: int) -> Signal:
    """Let an output of the whole be an output of a system, or one of its inputs; its signal."""
    if _matches(table.outputs, name) or not _matches(table.inputs, name):
        j = _one(table.outputs, name, "output")
        wiring.F[k, j] = 1.0
        return Signal(name, table.outputs[j][1].unit)
    j = _one(table.inputs, name, "input")
    wiring.G[k, j] = 1.0
    return Signal(name, table.inputs[j][1].unit)


def _check_driven(table: _Table, wiring: Wiring) -> None:
    idle = [
        f"{owner}.{signal.name}"
        for k, (owner, signal) in enumerate(table.inputs)
        if not (wiring.Ky[k].any() or wiring.E[k].any())
    ]
    if idle:
        raise StructureError(
            f"connect: nothing drives {', '.join(idle)}. Name them in inputs or connections, or leave "
            "them out with system[outputs, inputs]."
        )
