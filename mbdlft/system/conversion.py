"""Systems made of python-control systems, numbers, matrices and LFTs; signals found by their names."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from mbdlft.base.arguments import advice, said
from mbdlft.base.array import ArrayLike
from mbdlft.base.errors import StructureError, naming, unknown_name
from mbdlft.base.unit import Signal
from mbdlft.lft.lft import LFT, constant, matrix_of
from mbdlft.system.model import Parameters, System

Names = Sequence[str | Signal] | Mapping[str, str] | None

_STATE_SPACE = ("A", "B", "C", "D", "nstates", "dt")
_TRANSFER = ("num", "den", "dt")


class ControlSystem(Protocol):
    """What a system of python-control has, and a `System` has not."""

    @property
    def ninputs(self) -> Any: ...
    @property
    def noutputs(self) -> Any: ...
    @property
    def nstates(self) -> Any: ...


def as_system(
    item: Any,
    *,
    name: str | None = None,
    inputs: Names = None,
    outputs: Names = None,
    states: Names = None,
) -> System:
    """A system of anything that acts like one, or a system with other names.

    Parameters
    ----------
    item : System, LFTModel, control.StateSpace, control.TransferFunction, LFT, number or matrix
        An LFT or a matrix is static. Blocks of an LFT must not be real: parameters have ranges.
    name : str, optional
        By default the name of the item, or ``gain``.
    inputs, outputs, states : sequence of str or Signal, or mapping of old to new names
        By default those of the item, or ``u0``, ``u1``, ... and ``y0``, ...; a name without a unit keeps
        the unit that the signal has.

    Returns
    -------
    System, or LFTModel if the item is one
    """
    made = _converted(item)
    names = {"inputs": inputs, "outputs": outputs, "states": states}
    signals = {key: _named(made, key, given) for key, given in names.items()}
    return replace(made, name=made.name if name is None else name, **signals)  # type: ignore[arg-type]


def operand(item: Any, what: str) -> System:
    """The system of an argument; errors begin with its name."""
    with naming(what, StructureError):
        return as_system(item)


def state_space(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    *,
    name: str = "system",
    inputs: Names = None,
    outputs: Names = None,
    states: Names = None,
) -> System:
    """The system xdot = A x + B u, y = C x + D u in numbers.

    Parameters
    ----------
    A : array (nx, nx)
    B : array (nx, nu)
    C : array (ny, nx)
    D : array (ny, nu), or a number that all its entries have
    name : str
    inputs, outputs, states : as in `as_system`
    """
    a, b, c, d = (np.atleast_2d(np.asarray(matrix)) for matrix in (A, B, C, D))
    if np.ndim(D) == 0:
        d = np.full((c.shape[0], b.shape[1]), np.asarray(D))
    n = a.shape[0] if a.size else 0
    shapes = {"A": (n, n), "B": (n, d.shape[1]), "C": (d.shape[0], n)}
    matrices = dict(zip(shapes, (a, b, c), strict=True))
    for label, shape in shapes.items():
        if matrices[label].shape != shape and (matrices[label].size or 0 not in shape):
            raise StructureError(
                f"system {name!r}: {label} needs shape {shape}, got {matrices[label].shape}."
            )
    a, b, c = (matrices[label].reshape(shape) for label, shape in shapes.items())
    made = _static(np.block([[a, b], [c, d]]), n, name)
    return as_system(made, inputs=inputs, outputs=outputs, states=states)


def _converted(item: Any) -> System:
    if isinstance(item, System):
        return item
    if isinstance(item, LFT):
        real = [block.name for block in item.blocks if block.kind == "real" and block.size]
        if real:
            raise StructureError(
                f"an LFT with the real deltas {', '.join(real)} has no ranges: give them as System(...) "
                "with its parameters."
            )
        return _static(item, 0, "gain")
    if all(hasattr(item, label) for label in _TRANSFER):
        import control  # here because it is slow to import

        try:
            item = control.ss(item, name=item.name)
        except (ValueError, NotImplementedError) as error:
            raise StructureError(f"system {item.name!r}: no state space of it: {error}") from None
    if all(hasattr(item, label) for label in _STATE_SPACE):
        if item.dt not in (None, 0):
            raise StructureError(
                f"system {item.name!r}: expected continuous time (dt = 0), got dt = {item.dt!r}."
            )
        value = np.block([[item.A, item.B], [item.C, item.D]]).reshape(item.nstates + item.noutputs, -1)
        labels = {"inputs": item.input_labels, "outputs": item.output_labels, "states": item.state_labels}
        return as_system(_static(value, item.nstates, item.name), **labels)
    try:
        matrix = matrix_of(item)
        if item is None:
            raise TypeError
    except (TypeError, ValueError):
        raise StructureError(
            "expected a System, an LFTModel, a continuous python-control system, a number or a matrix, "
            f"got {said(item)}.{advice([System], item)}"
        ) from None
    if not np.all(np.isfinite(matrix)):
        raise StructureError(f"a gain needs finite numbers, got {matrix.tolist()}.")
    return _static(matrix, 0, "gain")


def _static(matrix: Any, states: int, name: str) -> System:
    """Value [A B ; C D] with default names."""
    lft = matrix if isinstance(matrix, LFT) else constant(matrix)
    sizes = {"x": states, "u": lft.shape[1] - states, "y": lft.shape[0] - states}
    x, u, y = (tuple(Signal(f"{c}{k}", "1") for k in range(n)) for c, n in sizes.items())
    lft = replace(lft, blocks=tuple(block for block in lft.blocks if block.kind != "real"))
    return System(name, lft, x, u, y, Parameters())


def _named(made: System, what: str, names: Names) -> tuple[Signal, ...]:
    """Its inputs, outputs or states with other names."""
    signals: tuple[Signal, ...] = getattr(made, what)
    if names is None:
        return signals
    where = f"model {made.name!r}, {what}"
    known = [signal.name for signal in signals]
    if isinstance(names, str):
        names = [names]
    if isinstance(names, Mapping):
        positions_of(names, known, where)
        names = [names.get(name, name) for name in known]
    if len(names) != len(signals):
        raise StructureError(f"{where}: expected {len(signals)} names, got {len(names)}.")
    renamed = tuple(
        name if isinstance(name, Signal) else Signal(str(name), signal.unit)
        for signal, name in zip(signals, names, strict=True)
    )
    check_once([signal.name for signal in renamed], where)
    return renamed


def check_once(names: Sequence[str], where: str) -> None:
    """Raise a StructureError that lists the names that stand twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        verb = "stands" if len(twice) == 1 else "stand"
        raise StructureError(
            f"{where}: {', '.join(twice)} {verb} more than once among {', '.join(names)}. "
            "as_system(item, inputs={old: new}, outputs={old: new}) gives signals other names."
        )


def positions_of(asked: Any, known: Sequence[str], where: str) -> list[int]:
    """Positions of signals: a name, a number, a slice of numbers or names, or a list of these.

    A slice between names includes both, as there is no name behind the last.
    """
    if isinstance(asked, slice):
        start, stop = (
            _position(end, known, where) if isinstance(end, str) else end
            for end in (asked.start, asked.stop)
        )
        if isinstance(asked.stop, str) and stop is not None:
            stop += 1
        return list(range(len(known)))[slice(start, stop, asked.step)]
    single = isinstance(asked, str | int | np.integer) or not isinstance(asked, Iterable)
    items = [asked] if single else list(asked)
    positions = [_position(item, known, where) for item in items]
    check_once([known[k] for k in positions], where)
    return positions


def _position(item: Any, known: Sequence[str], where: str) -> int:
    if isinstance(item, str) and item in known:
        return list(known).index(item)
    if isinstance(item, int | np.integer) and -len(known) <= item < len(known):
        return int(item) % len(known)
    raise StructureError(f"{where}: " + unknown_name("signal", str(item), known))
