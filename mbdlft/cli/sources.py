"""What is in a file: a scene, a robot, a matrix, a Modelica model, or an archive."""

import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

from rich.console import Console
from rich.markup import escape

from mbdlft.base.errors import AnalysisError, SceneError
from mbdlft.cli.output import console, parameters_data, print_json
from mbdlft.cli.output import table as new_table
from mbdlft.system.model import LFTModel, System

if TYPE_CHECKING:
    from mbdlft.dae import Dae
    from mbdlft.dae.equilibria import DaeTrim
    from mbdlft.modelica import ModelicaReport, ModelicaTable
    from mbdlft.multibody.scene import Scene
    from mbdlft.system.theta import DeltaThetaModel

ARCHIVES = (".h5", ".hdf5")
ROBOTS = (".urdf", ".sdf", ".world", ".xml", ".mjcf", ".xacro")


def is_robot(file: Path) -> bool:
    """Whether a file is one of a robot, by its ending."""
    return file.suffix.lower() in ROBOTS


def scene_in(file: Path, model: str | None = None, *, look: bool = False) -> "Scene":
    """The scene of a TOML file, or that of a robot, whose report goes to stderr.

    Parameters
    ----------
    file : a scene (TOML) or a robot (URDF, SDF, MJCF)
    model : str, optional
        Which model of an SDF file that has several.
    look : bool
        Whether it is only looked at, so that inertias that no body can have do no harm.

    Raises
    ------
    SceneError
        The file cannot be read, or is no scene and no robot.
    """
    if not is_robot(file):
        from mbdlft.multibody.scene import load_scene

        return load_scene(file)
    from mbdlft.robot import load_robot

    scene, report = load_robot(file, model=model, keep_unphysical=look)
    if not look:
        Console(stderr=True, soft_wrap=True).print(escape(str(report)), highlight=False)
    return scene


def load_model(file: Path, name: str | None = None) -> "System | DeltaThetaModel":
    """As `load_system`, with nonlinear functions where an archive has them."""
    if file.suffix.lower() in ARCHIVES:
        from mbdlft.archive.archive import load

        return cast("System | DeltaThetaModel", load(file, name))
    return load_system(file, name)


def load_system(file: Path, name: str | None = None) -> System:
    """The system of an archive, or one that is made of a scene, a matrix or a Modelica model.

    Parameters
    ----------
    file : an archive (.h5, .hdf5), a scene or a matrix (TOML), a robot, or a Modelica model
    name : str, optional
        Which model of an archive that has several.

    Raises
    ------
    AnalysisError
        A name is given for a file that is no archive.
    ArchiveError, SceneError, and those of making a model
        The file cannot be read, or no model can be made of it.
    """
    if file.suffix.lower() in ARCHIVES:
        return stored_system(file, name)
    if name is not None:
        raise AnalysisError(f"--model {name}: {file} is no archive; only an archive has models.")
    if is_modelica(file):
        return linear_model(Asked(file), 0.0, None, 0.0, lambda stage: None)[0]
    from mbdlft.matrix import load_matrix
    from mbdlft.pipeline import realize, to_lft

    if _is_matrix(file):
        return realize(load_matrix(file), search=0.0, prove=0.0)
    return to_lft(scene_in(file), search=0.0, prove=0.0)


def _is_matrix(file: Path) -> bool:
    """Whether a TOML file says that it is a matrix; a scene says what is wrong with other files."""
    try:
        found = tomllib.loads(file.read_text(encoding="utf-8")).get("format")
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False
    return isinstance(found, str) and found.startswith("mbdlft-matrix")


def point_of(system: System, texts: list[str] | None) -> dict[str, float]:
    """Values by name of the options --set name=value.

    Raises
    ------
    SceneError
        A text is not a name, = and a number.
    """
    values = {}
    for text in texts or []:
        name, equals, value = (part.strip() for part in text.partition("="))
        try:
            values[name] = float(value)
        except ValueError:
            equals = ""
        if not (name and equals):
            known = ", ".join(system.parameters.names) or "none"
            raise SceneError(
                f"--set {text}: expected name=value with a number, such as m1=3.2. The unit is that of "
                f"the parameter. Parameters: {known}."
            )
    return values


def stored_system(archive: Path, name: str | None) -> System:
    """A linear model of an archive.

    Raises
    ------
    AnalysisError
        It has nonlinear functions, which linear analysis must not leave out.
    ArchiveError
        It cannot be read.
    """
    from mbdlft.archive.archive import load
    from mbdlft.system.theta import DeltaThetaModel

    model = load(archive, name)
    if isinstance(model, DeltaThetaModel):
        raise AnalysisError(
            f"{archive}: model {model.name!r} has {len(model.functions)} nonlinear functions, and is not "
            "linear. Linearize it around an equilibrium (linearize_dae); in Python, model.linear is its "
            "linear part with the functions left open."
        )
    return cast(System, model)


def values_of(texts: list[str]) -> dict[str, float]:
    """Values by name of the options --set name=value.

    Raises
    ------
    SceneError
        A text is not a name, = and a number.
    """
    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise SceneError(
                f"--set {text}: expected name=value with a number, such as m1=3.2. The unit is that "
                "of the parameter."
            )
    return values


SUFFIXES = (".mo", ".mof")


class Asked(NamedTuple):
    """What is asked for: a file, the table beside it, and which model of the file."""

    file: Path
    table_file: Path | None = None
    model: str | None = None


def is_modelica(file: Path) -> bool:
    """Whether this is a file of a Modelica model."""
    return file.suffix.lower() in SUFFIXES


def check_modelica(asked: Asked, *, as_json: bool = False) -> None:
    """Print the structure of a model, its parameters and its equilibrium."""
    from mbdlft.modelica import operating_point

    dae, report, table = _read(asked)
    point = operating_point(dae, report, table)
    if as_json:
        _print_data(dae, report, point)
        return
    out = console()
    out.print(str(point.structure), highlight=False)
    if dae.parameters:
        rows = new_table("parameters", "name", "unit", "low >", "nominal >", "high >", "role")
        for p in dae.parameters:
            rows.add_row(p.name, p.unit, f"{p.low:g}", f"{p.nominal:g}", f"{p.high:g}", p.role)
        out.print(rows)
    rows = new_table("equilibrium, parameters at nominal", "quantity", "value >", "unit", "is")
    for kind, quantities in (("input", point.structure.inputs), ("state", point.structure.states)):
        for q in quantities:
            what = "found" if q.name in point.free else kind
            rows.add_row(q.name, f"{point.nominal[q.name]:.8g}", q.unit, what)
    out.print(rows)
    for note in str(report).splitlines():
        out.print(note)
    out.print("The model is usable.")


def _print_data(dae: "Dae", report: "ModelicaReport", point: "DaeTrim") -> None:
    """Print what a check finds as one JSON object."""
    kinds = (("input", point.structure.inputs), ("state", point.structure.states))
    print_json(
        {
            "name": dae.name,
            "parameters": parameters_data(dae.parameters),
            "equilibrium": [
                {
                    "name": q.name,
                    "value": point.nominal[q.name],
                    "unit": q.unit,
                    "is": "found" if q.name in point.free else kind,
                }
                for kind, quantities in kinds
                for q in quantities
            ],
            "notes": str(report).splitlines(),
        }
    )


def linear_model(
    asked: Asked,
    search: float,
    most_seconds: float | None,
    prove: float,
    progress: Callable[[str], None],
) -> tuple[LFTModel, dict[str, float], list[str]]:
    """The linear model of a Modelica model, the seconds of its stages, and notes."""
    from mbdlft.modelica import operating_point
    from mbdlft.pipeline.models import linearize_dae

    seconds, start = {}, time.perf_counter()
    dae, report, table = _read(asked)
    seconds["read"], start = time.perf_counter() - start, time.perf_counter()
    progress("structure and trim")
    point = operating_point(dae, report, table)
    seconds["trim"], start = time.perf_counter() - start, time.perf_counter()
    model = linearize_dae(
        point,
        search=search,
        seconds=most_seconds,
        prove=prove,
        progress=progress,
    )
    seconds["linearize"] = time.perf_counter() - start
    return model, seconds, str(report).splitlines()


def _read(asked: Asked) -> "tuple[Dae, ModelicaReport, ModelicaTable]":
    from mbdlft.modelica import ModelicaTable, load_modelica, load_modelica_table

    table = ModelicaTable() if asked.table_file is None else load_modelica_table(asked.table_file)
    dae, report = load_modelica(asked.file, table, model=asked.model)
    return dae, report, table
