"""Writing items into HDF5 groups, and copying all that an archive has."""

from io import BytesIO
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5t

from mbdlft.archive.hdf5 import attribute_names, check_link, member, names_of
from mbdlft.archive.items import Items
from mbdlft.base.errors import ArchiveError


def write_items(group: Any, items: Items) -> None:
    """Write items into an empty group, numbers and texts as they are, bytes and programs compressed."""
    for path, values in items.items():
        owner, at, name = path.partition("@")
        kind = h5py.string_dtype("utf-8", values.dtype.itemsize)
        stored = kind if values.dtype.kind == "S" else values.dtype
        if at:
            target = group.require_group(owner) if owner else group
            target.attrs.create(name, values.astype(stored), dtype=stored)
        else:
            is_program = path.startswith("program/")
            long = values.size and (values.dtype == np.uint8 or is_program)
            packed = {"compression": "gzip", "shuffle": is_program} if long else {}
            group.create_dataset(path, data=values.astype(stored), dtype=stored, **packed)


def copy_all(old: Any, new: Any, replaced: str) -> None:
    """Copy all contents of an archive but the group `replaced`, such as ``models/NAME``.

    HDF5 does not reuse the space of a group that is deleted, so the new file is made by copying.
    """
    parent, _, left_out = replaced.partition("/")
    _copy(old, new, parent)
    inner = new.require_group(parent)
    if parent not in names_of(old):
        return
    group = member(old, parent)
    if not isinstance(group, h5py.Group):
        raise ArchiveError(f"/{parent} is not a group.")
    _copy(group, inner, left_out)


def _copy(old: Any, new: Any, left_out: str) -> None:
    """Copy the members of a group but one, and its attributes, their types unchanged."""
    for name in attribute_names(old):
        found = h5a.open(old.id, name.encode("utf-8"))
        if found.get_type().get_class() == h5t.REFERENCE:
            raise ArchiveError(f"attribute {name!r} of {old.name} leads to another place.")
        new.attrs.create(name, old.attrs[name], dtype=found.dtype)
    for name in names_of(old):
        check_link(old, name)
        if name != left_out:
            old.copy(name, new)


def image_of_copy(archive: Any, replaced: str) -> bytes:
    """What `copy_all` makes of a file, in memory."""
    image = BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110")) as new:
        copy_all(archive, new, replaced)
    return image.getvalue()
