"""URDF files that are written in xacro, expanded by the package xacro."""

from pathlib import Path

from mbdlft.base.errors import SceneError
from mbdlft.robot.elements import Element

_ENDING = ".xacro"


def is_xacro(file: Path, top: Element) -> bool:
    """Whether a file is one of xacro, by its name: expressions of such a file are evaluated by Python."""
    return file.suffix.lower() == _ENDING and top.tag == "robot"


def expanded(file: Path) -> bytes:
    """The URDF text of a xacro file, with the default values of its arguments.

    Raises
    ------
    SceneError
        The package is not installed, or cannot expand the file.
    """
    try:
        import xacro
    except ImportError:
        raise SceneError(
            "xacro files are expanded by the package xacro, which is not installed: pip install "
            "'mbdlft[xacro]'."
        ) from None
    try:
        return bytes(xacro.process_file(str(file)).toxml(encoding="utf-8"))
    except Exception as error:  # expressions of the file raise what they like
        reason = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(
            f"xacro cannot expand it: {reason[:500]}. Files that it includes must be there; packages "
            "that it finds with $(find ...) need the package index of ROS."
        ) from None
