"""What is in a file: a scene, a robot, a matrix, a Modelica model, or an archive."""

import itertools
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast

from rich.console import Console
from rich.markup import escape

from mbdlft import archive as archives
from mbdlft import matrix, modelica, multibody, robot, system
from mbdlft.base.errors import AnalysisError
from mbdlft.cli import rooms

if TYPE_CHECKING:
    from mbdlft.dae import Dae
    from mbdlft.modelica import ModelicaReport, ModelicaTable
    from mbdlft.multibody import Scene
    from mbdlft.system import DeltaThetaModel, LFTModel, System

    ModelicaFile = tuple[Dae, ModelicaReport, ModelicaTable]

_ARCHIVES = (".h5", ".hdf5")
_ROBOTS = (".urdf", ".sdf", ".world", ".xml", ".mjcf", ".xacro")
SUFFIXES = (".mo", ".mof")


def is_archive(file: Path) -> bool:
    """Whether a file is an archive, by its ending."""
    return file.suffix.lower() in _ARCHIVES


def is_robot(file: Path) -> bool:
    """Whether a file is one of a robot, by its ending."""
    return file.suffix.lower() in _ROBOTS


def is_modelica(file: Path) -> bool:
    """Whether this is a file of a Modelica model, by its ending."""
    return file.suffix.lower() in SUFFIXES


def scene_in(file: Path, model: str | None = None, *, look: bool = False) -> "Scene":
    """The scene of a TOML file, or that of a robot (URDF, SDF, MJCF), whose report goes to stderr.

    `model` says which one of an SDF file that has several. A scene that somebody will only `look` at may
    have inertias that no body can have.
    """
    if not is_robot(file):
        return multibody.load_scene(file)
    scene, report = robot.load_robot(file, model=model, keep_unphysical=look)
    if not look:
        Console(stderr=True, soft_wrap=True).print(escape(str(report)), highlight=False)
    return scene


def read_modelica(file: Path, table_file: Path | None, name: str | None) -> "ModelicaFile":
    """A Modelica model, the report on it, and the table beside it; `name` says which one of the file."""
    kept = modelica.ModelicaTable() if table_file is None else modelica.load_modelica_table(table_file)
    dae, report = modelica.load_modelica(file, kept, model=name)
    return dae, report, kept


def modelica_model(
    file: Path,
    table_file: Path | None = None,
    name: str | None = None,
    *,
    search: float,
    seconds: float | None,
    prove: float,
    progress: Callable[[str], None],
) -> "tuple[LFTModel, dict[str, float], list[str]]":
    """The linear model of a Modelica model, the seconds of its stages, and notes."""
    times = [time.perf_counter()]
    dae, report, kept = read_modelica(file, table_file, name)
    times.append(time.perf_counter())
    progress("structure and trim")
    point = modelica.operating_point(dae, report, kept)
    times.append(time.perf_counter())
    model = rooms.models.linearize_dae(
        point, search=search, seconds=seconds, prove=prove, progress=progress
    )
    times.append(time.perf_counter())
    stages = zip(("read", "trim", "linearize"), itertools.pairwise(times), strict=True)
    return model, {stage: b - a for stage, (a, b) in stages}, str(report).splitlines()


def load_model(file: Path, name: str | None = None) -> "System | DeltaThetaModel":
    """As `load_system`, with nonlinear functions where an archive has them."""
    if is_archive(file):
        return cast("System | DeltaThetaModel", archives.load(file, name))
    return load_system(file, name)


def load_system(file: Path, name: str | None = None) -> "System":
    """The system of an archive, or one that is made of a scene, a robot, a matrix or a Modelica model.

    `name` says which model of an archive that has several; for other files it is an AnalysisError.
    """
    if is_archive(file):
        return stored_system(file, name)
    if name is not None:
        raise AnalysisError(f"--model {name}: {file} is no archive; only an archive has models.")
    if is_modelica(file):
        how = {"search": 0.0, "seconds": None, "prove": 0.0}
        return modelica_model(file, **how, progress=lambda stage: None)[0]  # type: ignore[arg-type]
    if _is_matrix(file):
        return rooms.models.realize(matrix.load_matrix(file), search=0.0, prove=0.0)
    return rooms.models.to_lft(scene_in(file), search=0.0, prove=0.0)


def _is_matrix(file: Path) -> bool:
    """Whether a TOML file says that it is a matrix; a scene says what is wrong with other files."""
    try:
        form = tomllib.loads(file.read_text(encoding="utf-8")).get("format")
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False
    return isinstance(form, str) and form.startswith("mbdlft-matrix")


def stored_system(archive: Path, name: str | None) -> "System":
    """A linear model of an archive; nonlinear functions, not to be left out, are an AnalysisError."""
    model = archives.load(archive, name)
    if isinstance(model, system.DeltaThetaModel):
        raise AnalysisError(
            f"{archive}: model {model.name!r} has {len(model.functions)} nonlinear functions, and is not "
            "linear. Linearize it around an equilibrium (linearize_dae); in Python, model.linear is its "
            "linear part with the functions left open."
        )
    return cast("System", model)
