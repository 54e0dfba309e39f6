"""What a process of another library may do, in a module that loads little."""

import os
from importlib import import_module

import numpy as np

from mbdlft.base.errors import StructureError


def die(*_: object) -> None:
    os._exit(3)


def read(what: str) -> dict[str, np.ndarray]:
    """An array; or no end, too much memory, an end of the process, noise, errors."""
    if what == "loop":
        while True:
            pass
    if what == "memory":
        return {"a": np.ones(2**29)}
    if what == "die":
        die()
    if what == "print":
        print("noise")  # noqa: T201
    if what == "error":
        raise LookupError("lost")
    if what == "library":
        import_module("slow_to_import")
    if what == "named":
        raise StructureError("named")
    return {"a": np.arange(3)}
