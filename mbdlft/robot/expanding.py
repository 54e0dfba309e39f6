"""The text of a robot that is written in xacro, in a process of its own."""

from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError


def expanded(path: str) -> dict[str, Array]:
    """The URDF text of a xacro file as bytes, for `arrays_of`."""
    import xacro  # here because it is no dependency

    read, folder = xacro.load_yaml, Path(path).parent.resolve()

    def below(name: str) -> Any:
        if not Path(xacro.abs_filename_spec(name)).resolve().is_relative_to(folder):
            raise SceneError(f"load_yaml reads files below {folder} only, got {name!r}")
        return read(name)

    try:
        xacro.load_yaml = below
        xacro._global_symbols = xacro.create_global_symbols()  # with the function above
        text = bytes(xacro.process_file(path).toxml(encoding="utf-8"))
    except Exception as error:  # expressions of the file raise what they like
        reason = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(
            f"xacro cannot expand it: {reason[:500]}. Files that it includes must be there; packages "
            "that it finds with $(find ...) need the package index of ROS."
        ) from None
    return {"text": np.frombuffer(text, np.uint8)}
