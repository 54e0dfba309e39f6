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


def as_words(values: Any) -> list[str]:
    """Texts of a dataset."""
    return [text.decode() for text in np.asarray(values).tolist()]
