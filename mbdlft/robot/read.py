"""The reader of each format of robots: URDF, also written in xacro, SDF and MJCF."""

from pathlib import Path

from mbdlft.base.content import content_of
from mbdlft.base.errors import SceneError
from mbdlft.robot.description import Robot
from mbdlft.robot.elements import Element, parse
from mbdlft.robot.mjcf import read_mjcf
from mbdlft.robot.sdf import read_sdf
from mbdlft.robot.urdf import read_urdf
from mbdlft.robot.xacro import expanded, is_xacro


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
        return parse(expanded(file)) if is_xacro(file, top) else top
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
