"""What commands are given: options that several have, and files of scenes, robots, models, archives."""

import itertools
import math
import time
import tomllib
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import typer
from rich.console import Console
from rich.markup import escape

from mbdlft import archive as archives
from mbdlft import dae, matrix, modelica, multibody, robot, show, system
from mbdlft.base.errors import AnalysisError, MbdlftError, SceneError
from mbdlft.cli import rooms

SEARCH = 2.0  # equal to SEARCH of mbdlft.order.work, which is slow to import
MOST = 1_000_000  # samples or times of an analysis; sweeps have more
Texts = list[str] | None
Archive = Annotated[Path, typer.Argument(help="Archive, an HDF5 file.")]
Source = Annotated[
    Path, typer.Argument(help="Archive (HDF5), or a scene or a matrix (TOML), to be linearized.")
]
Output = Annotated[Path | None, typer.Option("-o", "--output", help="Archive to write the model into.")]
Page = Annotated[
    Path | None, typer.Option("-o", "--output", help="Page to write; the name of the source by default.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Model = Annotated[str | None, typer.Option("--model", help="Model of an archive that has several.")]
Values = Annotated[
    Texts, typer.Option("--set", help="name=value in the unit of the parameter; may be repeated.")
]
Inputs = Annotated[Texts, typer.Option("--input", help="Input; all by default; may be repeated.")]
Outputs = Annotated[Texts, typer.Option("--output", help="Output; all by default; may be repeated.")]
Samples = Annotated[int, typer.Option("--samples", min=0, max=MOST, help="Number of random samples.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Of the samples.")]
Figure = Annotated[Path | None, typer.Option("-o", "--figure", help="Figure to draw, such as fig.png.")]
FigureWidth = Annotated[
    float | None,
    typer.Option("--figure-width", help="Of figures for print, cm: 8.5 for one column, 17 for two."),
]
# of commands that make models
Search = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Work to look for a smaller model, as parameters commute, about seconds of one core; "
        "0: none.",
    ),
]
Seconds = Annotated[
    float | None, typer.Option("--seconds", min=0.0, help="Upper limit of the time of the search (s).")
]
Prove = Annotated[
    float,
    typer.Option(
        min=0.0, help="Work to prove that the model is regular in the whole range, about seconds."
    ),
]
# of Modelica models
Vary = Annotated[
    Texts,
    typer.Option(
        "--vary",
        help="NAME=20% or NAME=LOW:HIGH of a parameter of a Modelica model that stays; may be repeated.",
    ),
]
Point = Annotated[
    str | None,
    typer.Option(
        "--at",
        help="Operating point of a Modelica model: equilibrium, or start, the start values as they are.",
    ),
]
# of commands that prove bounds
Controller = Annotated[
    Path | None,
    typer.Option(
        "--controller", help="Archive or .mat file (A, B, C, D) of a controller: u - K y is closed."
    ),
]
Gap = Annotated[float, typer.Option(help="Part by which the bounds may differ.")]
Work = Annotated[float, typer.Option(help="Units of work, each at most about a second.")]
LeaveOut = Annotated[
    Texts,
    typer.Option(
        "--leave-out", help="State on which nothing else depends; cyclic: all; may be repeated."
    ),
]
Rate = Annotated[
    Texts,
    typer.Option(
        "--rate",
        help="NAME=BOUND of how fast a parameter moves, in its unit per second; inf for any motion; "
        "may be repeated. Others are constant.",
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--plot",
        help="Figure: bounds of mu over frequency, or singular values with the worst case.",
    ),
]
Workers = Annotated[int, typer.Option("--workers", help="Processes; the result does not change.")]
NoSave = Annotated[bool, typer.Option("--no-save", help="Do not store the result.")]


def on_paper(width: float | None) -> AbstractContextManager[None]:
    """Where figures have a width for print, if one is given."""
    return nullcontext() if width is None else show.for_paper(width)


def check_paths(archive: Path | None, *figures: Path | None, beside: Iterable[Path | None] = ()) -> None:
    """Raise an error if it is known before the work that one of the files cannot be written.

    No two of them, and of the files `beside` that are read or written, may be one.
    """
    check_different(archive, *figures, *beside)
    if archive is not None:
        rooms.archive.check_file(archive)
    for figure in filter(None, figures):
        rooms.figures.check_figure(figure)


def check_different(*files: Path | None) -> None:
    """Raise an error if a command would write two things, or one that it reads, into one file."""
    places = [file.resolve() for file in files if file is not None]
    for place in places:
        if places.count(place) > 1:
            raise AnalysisError(
                f"{place}: it is given twice, and one would be lost. Give different names."
            )


def finite(text: str) -> float:
    """The number of a text, or a ValueError."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(text)
    return number


def by_name(
    option: str,
    texts: Iterable[str] | None,
    expected: str,
    value_of: Callable[[str], Any],
    error: type[MbdlftError] = SceneError,
) -> dict[str, Any]:
    """Values by name of the texts ``name=value`` of an option; `expected` says how one is written.

    A text without a name, or whose value is a ValueError of `value_of`, is an error.
    """
    values = {}
    for text in texts or ():
        name, equals, value = (side.strip() for side in text.partition("="))
        if name in values:
            raise error(f"{option} {text}: {name} is given twice.")
        try:
            if not (name and equals):
                raise ValueError
            values[name] = value_of(value)
        except ValueError:
            raise error(f"{option} {text}: expected {expected}") from None
    return values


def numbers_by_name(
    option: str, texts: Iterable[str] | None, expected: str, value_of: Callable[[str], float] = float
) -> dict[str, float]:
    """Numbers by name of an option of an analysis."""
    return by_name(option, texts, expected, value_of, AnalysisError)


def values_of(texts: Iterable[str] | None, known: str = "") -> dict[str, float]:
    """Values of parameters by name, of the options ``--set name=value``; `known` says which there are."""
    expected = "name=value with a number, such as m1=3.2. The unit is that of the parameter."
    return by_name("--set", texts, expected + known, float)


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


def scene_in(file: Path, model: str | None = None, *, look: bool = False) -> "multibody.Scene":
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


def _range_of(text: str) -> dict[str, float]:
    """The entries of a parameter with a range such as 20% or 100:400."""
    if text.endswith("%"):
        return {"percent": float(text[:-1])}
    low, high = map(float, text.split(":"))
    return {"low": low, "high": high}


_VARY = "NAME=20% or NAME=LOW:HIGH, such as spring.c=100:400. The unit is that of the parameter."


def read_modelica(
    file: Path, table_file: Path | None, name: str | None, vary: Texts = None, at: str | None = None
) -> "tuple[dae.Dae, modelica.ModelicaReport, modelica.ModelicaTable]":
    """A Modelica model, the report on it, and the table beside it; `name` says which one of the file.

    Parameters that `vary`, and the operating point `at`, are those of the options; they come before what
    the table says.
    """
    kept = modelica.ModelicaTable() if table_file is None else modelica.load_modelica_table(table_file)
    ranges = by_name("--vary", vary, _VARY, _range_of)
    point = kept.point if at is None else rooms.table.point_of(at, "--at")
    kept = replace(kept, parameters={**kept.parameters, **ranges}, point=point)
    dae, report = modelica.load_modelica(file, kept, model=name)
    return dae, report, kept


def modelica_model(
    file: Path,
    table_file: Path | None = None,
    name: str | None = None,
    vary: Texts = None,
    at: str | None = None,
    *,
    search: float,
    seconds: float | None,
    prove: float,
    progress: Callable[[str], None],
) -> "tuple[system.LFTModel, dict[str, float], list[str]]":
    """The linear model of a Modelica model, the seconds of its stages, and notes."""
    times = [time.perf_counter()]
    dae, report, kept = read_modelica(file, table_file, name, vary, at)
    times.append(time.perf_counter())
    progress("structure and trim")
    point = modelica.operating_point(dae, report, kept)
    times.append(time.perf_counter())
    model = rooms.dae_models.linearize_dae(
        point, search=search, seconds=seconds, prove=prove, progress=progress
    )
    times.append(time.perf_counter())
    stages = zip(("read", "trim", "linearize"), itertools.pairwise(times), strict=True)
    notes = [*str(report).splitlines(), *rooms.translation.notes_of_point(point)]
    return model, {stage: b - a for stage, (a, b) in stages}, notes


def load_system(file: Path, name: str | None = None) -> "system.System":
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


def stored_system(archive: Path, name: str | None) -> "system.System":
    """A linear model of an archive; nonlinear functions, not to be left out, are an AnalysisError."""
    model = archives.load(archive, name)
    if isinstance(model, system.DeltaThetaModel):
        raise AnalysisError(
            f"{archive}: model {model.name!r} has {len(model.functions)} nonlinear functions, and is not "
            "linear. Linearize it around an equilibrium (linearize_dae); in Python, model.linear is its "
            "linear part with the functions left open."
        )
    return cast("system.System", model)
