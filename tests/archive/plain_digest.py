"""The digest as docs/archive-format.md shows it to other tools, and changes of files that write it."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

PAGE = Path(__file__).parents[2] / "docs" / "archive-format.md"
_NAMES: dict[str, Any] = {}
exec(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1], _NAMES)
digest: Callable[[Any], str] = _NAMES["digest"]


def put_text(owner: Any, name: str, text: str) -> None:
    """Write an attribute as text of fixed length."""
    data = text.encode()
    owner.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", max(1, len(data))))


def edit(file: Path, change: Callable[[Any], None], group: str, *, right: bool = True) -> None:
    """Change a group of a file as another tool would; its digest is then `right`, if it can be."""
    with h5py.File(file, "r+") as archive:
        change(archive[group])
        if right and "digest" in archive[group].attrs:
            try:
                found = digest(archive[group])
            except (KeyError, TypeError, ValueError, AttributeError, OSError):
                return  # what the change has made is refused for other reasons
            put_text(archive[group], "digest", found)


def without(*names: str) -> Callable[[Any], None]:
    """A change that takes items out."""
    return lambda group: [group.__delitem__(name) for name in names] and None


def put(name: str, where: Any, value: Any) -> Callable[[Any], None]:
    """A change of entries of a dataset."""
    return lambda group: group[name].__setitem__(where, value)


def instead(name: str, value: Any) -> Callable[[Any], None]:
    """A change that writes something in the place of a dataset."""

    def change(group: Any) -> None:
        if name in group:
            del group[name]
        group[name] = value

    return change


def made(name: str, *shape: Any, **options: Any) -> Callable[[Any], None]:
    """A change that makes a dataset, in the place of one of this name."""

    def change(group: Any) -> None:
        if name in group:
            del group[name]
        group.create_dataset(name, *shape, **options)

    return change


def attributes(of: str, **values: Any) -> Callable[[Any], None]:
    """A change of attributes of a group, or of the model; None takes one out."""

    def change(model: Any) -> None:
        owner = model[of] if of else model
        for name, value in values.items():
            owner.attrs.pop(name, None)
            if isinstance(value, str):
                put_text(owner, name, value)
            elif value is not None:
                owner.attrs[name] = value

    return change


def as_words(values: Any) -> list[str]:
    """Texts of a dataset."""
    return [text.decode() for text in np.asarray(values).tolist()]
