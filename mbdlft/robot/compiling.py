"""Compiling an MJCF file with the package mujoco, in a process of its own with limits (`base.worker`).

A file may ask for more memory than there is, such as a field of 10^10 heights, or end the process. This
module imports nothing that takes long to start.
"""

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.errors import SceneError

MEMORY = 2**31  # bytes that compiling may need


def binary(path: str) -> dict[str, NDArray[np.uint8]]:
    """A file as the bytes of a compiled model, and what the compiler says."""
    import mujoco

    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)  # without it a log file is written into the folder
    try:
        model = mujoco.MjModel.from_xml_path(path)
    except Exception as error:  # also of memory, without a class of its own
        reason = " ".join(str(error).split())
        raise SceneError(
            f"mujoco cannot compile it: {reason[:500]}. Files that it includes and meshes, whose mass "
            f"counts, must be there, and {MEMORY // 2**20} MB of memory have to do."
        ) from None
    finally:
        mujoco.set_mju_user_warning(None)
    content = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    lines = "\n".join(" ".join(text.split()) for text in said)
    return {"model": content, "warnings": np.frombuffer(lines.encode(), dtype=np.uint8)}
