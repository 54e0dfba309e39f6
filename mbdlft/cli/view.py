"""The commands `view` and `report`: pages that show a scene, and a model with its evidence."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbdlft.base.errors import AnalysisError, SceneError
from mbdlft.cli.options import AsJson
from mbdlft.cli.source import ARCHIVES, is_robot, scene_in, values_of
from mbdlft.cli.tables import print_files

if TYPE_CHECKING:
    from mbdlft.multibody.scene import Scene

Model = Annotated[str | None, typer.Option("--model", help="Model of an archive that has several.")]


def view(
    source: Annotated[
        Path,
        typer.Argument(help="Scene (TOML), robot (URDF, SDF, MJCF), or archive (HDF5) of a model."),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Page to write; the name of the source by default."),
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", help="name=value at which the page begins; may be repeated."),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="Model of an archive, or of an SDF file, that has several.")
    ] = None,
    robot: Annotated[
        Path | None,
        typer.Option(
            help="Robot (URDF, SDF, MJCF) of which the scene was made: its shapes are shown."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a web page that shows a scene, with sliders, loads at equilibrium and moving modes."""
    from mbdlft.show.viewer.page import view as page_of

    file = _page(output or Path(f"{source.stem}.html"))
    scene = _scene(source, model)
    looks = source if robot is None and is_robot(source) else robot
    shown = model if looks is not None and source == looks else None
    page = page_of(scene, values_of(assignments or []), robot=looks, model=shown)
    print_files(("page", page.save(file)), as_json=as_json)


def _scene(source: Path, model: str | None) -> "Scene":
    """The scene of a file, or that of a model of an archive."""
    if source.suffix.lower() in ARCHIVES:
        from mbdlft.archive.archive import load
        from mbdlft.show.viewer.page import scene_of

        return scene_of(load(source, model))
    if model is not None and not is_robot(source):
        raise AnalysisError(
            f"--model {model}: {source} is no archive and no SDF file; only these have several models."
        )
    return scene_in(source, model, look=True)


def _page(file: Path) -> Path:
    """The file, if its ending and its folder are those of a page."""
    if file.suffix.lower() not in (".html", ".htm"):
        raise SceneError(f"{file}: expected the ending .html of a page, got {file.suffix!r}.")
    if not file.parent.is_dir():
        raise SceneError(f"{file}: {file.parent} is not a folder.")
    return file


def report(
    source: Annotated[
        Path,
        typer.Argument(help="Archive (HDF5), or a scene, robot or matrix, to be linearized."),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Page to write; the name of the source by default."),
    ] = None,
    model: Model = None,
    as_json: AsJson = False,
) -> None:
    """Write a page on a model: scene, parameters, what is proved, equilibrium, poles, responses."""
    from mbdlft.cli.source import load_system
    from mbdlft.show.report.page import model_report

    file = _page(output or Path(f"{source.stem}.html"))
    system = load_system(source, model)
    archive = source if source.suffix.lower() in ARCHIVES else None
    print_files(("page", model_report(system, archive).save(file)), as_json=as_json)
