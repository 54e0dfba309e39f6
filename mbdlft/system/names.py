"""Signals by name: positions of those that are asked for, and names that stand once."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from mbdlft.base.errors import StructureError, unknown_name


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

    Raises
    ------
    StructureError
        A name is unknown or asked for twice, or a number has no signal.
    """
    if isinstance(asked, slice):
        start, stop = (_end(end, known, where) for end in (asked.start, asked.stop))
        if isinstance(asked.stop, str) and stop is not None:
            stop += 1
        return list(range(len(known)))[slice(start, stop, asked.step)]
    single = isinstance(asked, str | int | np.integer) or not isinstance(asked, Iterable)
    items = [asked] if single else list(asked)
    found = [_position(item, known, where) for item in items]
    check_once([known[k] for k in found], where)
    return found


def _end(item: Any, known: Sequence[str], where: str) -> int | None:
    return _position(item, known, where) if isinstance(item, str) else item


def _position(item: Any, known: Sequence[str], where: str) -> int:
    if isinstance(item, str) and item in known:
        return list(known).index(item)
    if isinstance(item, int | np.integer) and -len(known) <= item < len(known):
        return int(item) % len(known)
    raise StructureError(f"{where}: " + unknown_name("signal", str(item), known))
