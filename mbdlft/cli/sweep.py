"""The command `sweep`: it writes numeric trims and linearizations at many samples into an archive."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from mbdlft.base.errors import AnalysisError
from mbdlft.cli.notes import warn
from mbdlft.cli.progress import progress_of
from mbdlft.cli.source import scene_in, stored_system
from mbdlft.cli.tables import console, print_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mbdlft.base.array import Array
    from mbdlft.batch import GridSamples, RandomSamples, SweepReport
    from mbdlft.multibody.scene import Scene
    from mbdlft.system.model import LFTModel


Grid = Annotated[
    list[str] | None,
    typer.Option(
        "--grid", help="NAME=COUNT evenly spaced values; the others are nominal; may be repeated."
    ),
]
Poles = Annotated[bool, typer.Option("--poles", help="Compute the eigenvalues of A, too.")]
OwnFunction = Annotated[
    str | None,
    typer.Option(
        "--function", help="MODULE:NAME of a function of samples that gives numbers by name."
    ),
]
Single = Annotated[
    bool, typer.Option("--float32", help="Store in single precision: half the space, 7 digits.")
]


def sweep(
    source: Annotated[
        Path,
        typer.Argument(
            help="Scene, a TOML file: its equations are trimmed and linearized at each sample. Or an "
            "archive, an HDF5 file: its model is evaluated."
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Archive to write the sweep into.")
    ],
    grid: Grid = None,
    random: Annotated[
        int | None, typer.Option("--random", help="Number of random samples.")
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option("--file", help="Samples: names in the first line, numbers in the others."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of --random; 0 by default.")] = None,
    name: Annotated[str | None, typer.Option(help="Of the sweep in the archive.")] = None,
    model: Annotated[str | None, typer.Option(help="Model of an archive that has several.")] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", help="Processes; one for each core by default.")
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Throw away what an unfinished sweep has left.")
    ] = False,
    poles: Poles = False,
    function: OwnFunction = None,
    float32: Single = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Trim and linearize at many samples; the same command goes on after a kill."""
    from mbdlft import batch

    samples = _samples(grid, random, file, seed)
    evaluated = _source(source, model)
    _warn_of_rows(output, name or evaluated.name)
    with progress_of(evaluated.name) as progress:
        report = batch.sweep(
            evaluated,
            samples,
            output,
            name=name,
            workers=workers,
            restart=restart,
            poles=poles,
            function=function,
            float32=float32,
            progress=progress.counted,
        )
    if as_json:
        print_json(asdict(report))
        return
    _print_report(report, output)


def _warn_of_rows(output: Path, name: str) -> None:
    """Warn of a stored sweep of this name, which is going to be replaced."""
    from mbdlft.archive.sweep import sweep_names

    if output.exists() and name in sweep_names(output):
        warn(f"{output}: the sweep {name!r} that is stored there is replaced; --name keeps it.")


def _print_report(report: "SweepReport", output: Path) -> None:
    """Print the numbers of samples of a sweep."""
    out = console()
    out.print(
        f"{report.name}: {report.count} samples, {report.solved} solved, {report.not_converged} not "
        f"converged, {report.no_equilibrium} without equilibrium",
        highlight=False,
    )
    if report.failed:
        out.print(f"the function failed at {report.failed} samples", highlight=False)
    if report.resumed:
        out.print(f"{report.resumed} samples were there from an earlier run")
    out.print(f"seconds: {report.seconds:.3f}")
    out.print(f"archive: {output}", soft_wrap=True)


def _source(file: Path, model: str | None) -> "Scene | LFTModel":
    """The scene of a file, or the model `model` if the file is an archive."""
    if file.suffix.lower() in (".h5", ".hdf5"):
        # the sweep refuses what is neither
        return cast("Scene | LFTModel", stored_system(file, model))
    if model is not None:
        raise AnalysisError(f"--model {model}: {file} is a scene; only an archive has models.")
    return scene_in(file)


def _samples(
    grid: list[str] | None, random: int | None, file: Path | None, seed: int | None
) -> "GridSamples | RandomSamples | Mapping[str, Array]":
    """The samples that exactly one of the options --grid, --random and --file gives."""
    from mbdlft.batch import GridSamples, RandomSamples, read_samples

    if (bool(grid) + (random is not None) + (file is not None)) != 1:
        raise AnalysisError("sweep: expected exactly one of --grid, --random and --file.")
    if seed is not None and random is None:
        raise AnalysisError("--seed: only --random has a seed.")
    if random is not None:
        return RandomSamples(random, seed or 0)
    if file is not None:
        return read_samples(file)
    counts = {}
    for text in grid or []:
        key, _, number = (part.strip() for part in text.partition("="))
        if not key or not number.isdecimal():
            raise AnalysisError(
                f"--grid {text}: expected NAME=COUNT with a whole number, such as theta1=10."
            )
        counts[key] = int(number)
    return GridSamples(counts)
