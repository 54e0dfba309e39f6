"""The commands that write other files: `sweep`, `export`, `view`, `report`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from mbdlft import archive as archives
from mbdlft import batch, multibody, show
from mbdlft import system as systems
from mbdlft.base.errors import AnalysisError, SceneError
from mbdlft.cli import options, rooms
from mbdlft.cli.commands import warn
from mbdlft.cli.output import print_files, print_json, progress_of, say

Grid = Annotated[
    options.Texts,
    typer.Option(
        "--grid", help="NAME=COUNT evenly spaced values; the others are nominal; may be repeated."
    ),
]
SampleFile = Annotated[
    Path | None, typer.Option("--file", help="Samples: names in the first line, numbers in the others.")
]
OwnFunction = Annotated[
    str | None,
    typer.Option("--function", help="MODULE:NAME of a function of samples that gives numbers by name."),
]


def sweep(
    source: Annotated[
        Path,
        typer.Argument(
            help="Scene, a TOML file: its equations are trimmed and linearized at each sample. Or an "
            "archive, an HDF5 file: its model is evaluated."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Archive to write the sweep into.")],
    grid: Grid = None,
    random: Annotated[int | None, typer.Option("--random", help="Number of random samples.")] = None,
    file: SampleFile = None,
    seed: Annotated[int | None, typer.Option(help="Of --random; 0 by default.")] = None,
    name: Annotated[str | None, typer.Option(help="Of the sweep in the archive.")] = None,
    model: options.Model = None,
    workers: Annotated[
        int | None, typer.Option("--workers", help="Processes; one for each core by default.")
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Throw away what an unfinished sweep has left.")
    ] = False,
    poles: Annotated[bool, typer.Option("--poles", help="Compute the eigenvalues of A, too.")] = False,
    function: OwnFunction = None,
    float32: Annotated[
        bool, typer.Option("--float32", help="Store in single precision: half the space, 7 digits.")
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Trim and linearize at many samples; the same command goes on after a kill."""
    samples = _samples(grid, random, file, seed)
    evaluated = _source(source, model)
    key = name or evaluated.name
    if output.exists() and key in archives.sweep_names(output):
        warn(f"{output}: the sweep {key!r} that is stored there is replaced; --name keeps it.")
    with progress_of(evaluated.name) as progress:
        counts = batch.sweep(
            evaluated, samples, output,
            name=name, workers=workers, restart=restart, poles=poles, function=function,
            float32=float32, progress=progress.counted,
        )  # fmt: skip
    if as_json:
        print_json(asdict(counts))
        return
    say(
        f"{counts.name}: {counts.count} samples, {counts.solved} solved, {counts.not_converged} not "
        f"converged, {counts.no_equilibrium} without equilibrium"
    )
    if counts.failed:
        say(f"the function failed at {counts.failed} samples")
    if counts.resumed:
        say(f"{counts.resumed} samples were there from an earlier run")
    say(f"seconds: {counts.seconds:.3f}", f"archive: {output}")


def _source(file: Path, model: str | None) -> "multibody.Scene | systems.LFTModel":
    """The scene of a file, or the model `model` if the file is an archive."""
    if options.is_archive(file):
        # the sweep refuses what is neither
        return cast("multibody.Scene | systems.LFTModel", options.stored_system(file, model))
    if model is not None:
        raise AnalysisError(f"--model {model}: {file} is a scene; only an archive has models.")
    return options.scene_in(file)


def _samples(
    grid: options.Texts, random: int | None, file: Path | None, seed: int | None
) -> "batch.GridSamples | batch.RandomSamples | dict[str, Any]":
    """The samples that exactly one of the options --grid, --random and --file gives."""
    if (bool(grid) + (random is not None) + (file is not None)) != 1:
        raise AnalysisError("sweep: expected exactly one of --grid, --random and --file.")
    if seed is not None and random is None:
        raise AnalysisError("--seed: only --random has a seed.")
    if random is not None:
        return batch.RandomSamples(random, seed or 0)
    if file is not None:
        return batch.read_samples(file)
    expected = "NAME=COUNT with a whole number, such as theta1=10."
    return batch.GridSamples(options.by_name("--grid", grid, expected, _whole, AnalysisError))


def _whole(text: str) -> int:
    """A whole number of less than ten digits, or a ValueError."""
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise ValueError(text)
    return int(text)


def export(
    source: options.Source,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output",
            help="File to write: .mat (MATLAB, Octave), .c (C99), .fmu (FMI), .jl (Julia), .mo "
            "(Modelica); with --grid .mat, .csv, .npz.",
        ),
    ],
    grid: Annotated[
        options.Texts,
        typer.Option(
            "--grid",
            help="State matrices at COUNT evenly spaced values of each parameter, or with NAME=COUNT of "
            "this one, which may be repeated; the others are nominal.",
        ),
    ] = None,
    model: options.Model = None,
    fmi: Annotated[int, typer.Option(min=2, max=3, help="Version of FMI of a .fmu.")] = 3,
    as_json: options.AsJson = False,
) -> None:  # fmt: skip
    """Write a model for another tool, or its matrices on a grid."""
    counts = _counts(grid)
    rooms.exports.check_suffix(output, grid=counts is not None)
    is_stored = options.is_archive(source)
    exported = archives.load(source, model) if is_stored else options.load_system(source, model)
    files = rooms.exports.export_model(output, exported, counts, source if is_stored else None, fmi)
    print_files(*(("file", path) for path in files), as_json=as_json)


def _counts(texts: options.Texts) -> "int | dict[str, int] | None":
    """Numbers of values of the options --grid: one for all parameters, or one for each of some names."""
    if not texts:
        return None
    counts: dict[str, int] = {}
    for text in texts:
        name, equals, count = (entry.strip() for entry in text.rpartition("="))
        try:
            if bool(name) != bool(equals) or name in counts:
                raise ValueError(text)
            counts[name] = _whole(count)
        except ValueError:
            raise AnalysisError(
                f"--grid {text}: expected a whole number of values such as 5, or NAME=COUNT such as "
                "theta1=10, each name once."
            ) from None
    if "" in counts and len(counts) > 1:
        raise AnalysisError(
            "--grid: expected either one number for all parameters, or NAME=COUNT for some."
        )
    return counts.get("", counts)


def view(
    source: Annotated[
        Path, typer.Argument(help="Scene (TOML), robot (URDF, SDF, MJCF), or archive (HDF5) of a model.")
    ],
    output: options.Page = None,
    assignments: Annotated[
        options.Texts, typer.Option("--set", help="name=value at which the page begins; may be repeated.")
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="Model of an archive, or of an SDF file, that has several.")
    ] = None,
    robot: Annotated[
        Path | None,
        typer.Option(help="Robot (URDF, SDF, MJCF) of which the scene was made: its shapes are shown."),
    ] = None,
    over: Annotated[
        Path | None, typer.Option(help="Scene or archive whose poles stay beside those of the sliders.")
    ] = None,
    response: Annotated[
        str | None, typer.Option(help="What the page plays when it is opened: step.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Write a web page that shows a scene, with sliders, loads at equilibrium and moving modes.

    Poles are those of the sliders, and steps can be played. Worst cases that are stored beside the
    model of an archive are buttons.
    """
    file = _page(output or Path(f"{source.stem}.html"))
    scene = _scene(source, model)
    looks = source if robot is None and options.is_robot(source) else robot
    shown = model if looks is not None and source == looks else None
    other = None if over is None else _scene(over, None)
    page = show.view(
        scene,
        options.values_of(assignments),
        robot=looks,
        model=shown,
        over=other,
        places=_worst_cases(source, scene),
        response=response,
    )
    print_files(("page", page.save(file)), as_json=as_json)


def _worst_cases(source: Path, scene: "multibody.Scene") -> dict[str, dict[str, float]]:
    """Values of the parameters of a scene in the worst cases that an archive has, by title."""
    if not options.is_archive(source):
        return {}
    names = {parameter.name for parameter in scene.parameters}
    points = {}
    for name in archives.analysis_names(source):
        _, bounds = archives.load_analysis(source, name)
        if bounds.worst and set(bounds.worst) <= names:
            points[f"worst case of {name}"] = dict(bounds.worst)
    return points


def _scene(source: Path, model: str | None) -> "multibody.Scene":
    """The scene of a file, or that of a model of an archive."""
    if options.is_archive(source):
        return show.scene_of(archives.load(source, model))
    if model is not None and not options.is_robot(source):
        raise AnalysisError(
            f"--model {model}: {source} is no archive and no SDF file; only these have several models."
        )
    return options.scene_in(source, model, look=True)


def _page(file: Path) -> Path:
    """The file, if its ending and its folder are those of a page."""
    if file.suffix.lower() not in (".html", ".htm"):
        raise SceneError(f"{file}: expected the ending .html of a page, got {file.suffix!r}.")
    if not file.parent.is_dir():
        raise SceneError(f"{file}: {file.parent} is not a folder.")
    return file


def report(
    source: Annotated[
        Path, typer.Argument(help="Archive (HDF5), or a scene, robot or matrix, to be linearized.")
    ],
    output: options.Page = None,
    model: options.Model = None,
    as_json: options.AsJson = False,
) -> None:
    """Write a page on a model: scene, parameters, what is proved, equilibrium, poles, responses."""
    file = _page(output or Path(f"{source.stem}.html"))
    system = options.load_system(source, model)
    archive = source if options.is_archive(source) else None
    print_files(("page", show.model_report(system, archive).save(file)), as_json=as_json)
