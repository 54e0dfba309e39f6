"""The reader of each format of robots: URDF, also written in xacro, SDF and MJCF."""

from pathlib import Path

from mbdlft.base.errors import SceneError
from mbdlft.base.worker import content_of
from mbdlft.robot.description import Robot
from mbdlft.robot.elements import Element, parse
from mbdlft.robot.mjcf import read_mjcf
from mbdlft.robot.sdf import read_sdf
from mbdlft.robot.urdf import read_urdf


def read_robot(path: str | Path, model: str | None = None, keyframe: str | None = None) -> Robot:
    """Read a robot from a file; errors name the file.

    Parameters
    ----------
    path : file
    model : str, optional
        Which model of an SDF file that has several.
    keyframe : str, optional
        Which keyframe of an MJCF file gives the positions.

    Raises
    ------
    SceneError
        The file cannot be read, is not a robot, or has what a scene cannot have.
    """
    file = Path(path)
    top = top_of(file)
    try:
        _refuse_options(top, model, keyframe)
        if top.tag == "robot":
            return read_urdf(top)
        if top.tag == "sdf":
            return read_sdf(top, model)
        if top.tag == "mujoco":
            return read_mjcf(file, top, keyframe)
        raise SceneError(
            f"line {top.line}: expected a robot, whose first element is <robot> (URDF), <sdf> or "
            f"<mujoco> (MJCF), got <{top.tag}>."
        )
    except SceneError as error:
        raise SceneError(f"{file}: {error}") from None
    except RecursionError:
        raise SceneError(
            f"{file}: its elements are in each other, or follow each other, hundreds of times; expected "
            "a robot with fewer."
        ) from None


def top_of(file: Path) -> Element:
    """The first element of a file, expanded if it is written in xacro; errors name the file.

    Raises
    ------
    SceneError
        The file cannot be read, is not XML, or cannot be expanded.
    """
    content = content_of(file, SceneError)
    try:
        top = parse(content)
        return parse(_expanded(file)) if _is_xacro(file, top) else top
    except SceneError as error:
        raise SceneError(f"{file}: {error}") from None


def _refuse_options(top: Element, model: str | None, keyframe: str | None) -> None:
    """Raise a SceneError for an option that the format does not have."""
    for option, given, tag, name in (
        ("model", model, "sdf", "an SDF"),
        ("keyframe", keyframe, "mujoco", "an MJCF"),
    ):
        if given is not None and top.tag != tag:
            raise SceneError(f"{option} = {given!r}: only {name} file has this, got <{top.tag}>.")


def _is_xacro(file: Path, top: Element) -> bool:
    """Whether a file is one of xacro, by its name: expressions of such a file are evaluated by Python."""
    return file.suffix.lower() == ".xacro" and top.tag == "robot"


def _expanded(file: Path) -> bytes:
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
