"""Options that several commands have, and the files that they write."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from mbdlft.system.model import LFTModel

Output = Annotated[
    Path | None, typer.Option("-o", "--output", help="Archive to write the model into.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Search = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Work to look for a smaller model, as parameters commute, about seconds of one core; "
        "0: none.",
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option("--seconds", min=0.0, help="Upper limit of the time of the search (s)."),
]
Prove = Annotated[
    float,
    typer.Option(
        min=0.0, help="Work to prove that the model is regular in the whole range, about seconds."
    ),
]
Archive = Annotated[Path, typer.Argument(help="Archive, an HDF5 file.")]
Model = Annotated[str | None, typer.Option("--model", help="Model of an archive that has several.")]
Controller = Annotated[
    Path | None,
    typer.Option(
        "--controller", help="Archive or .mat file (A, B, C, D) of a controller: u - K y is closed."
    ),
]
Gap = Annotated[float, typer.Option(help="Part by which the bounds may differ.")]
Work = Annotated[float, typer.Option(help="Units of work, each at most about a second.")]
LeaveOut = Annotated[
    list[str] | None,
    typer.Option("--leave-out", help="State on which nothing else depends; may be repeated."),
]
Rate = Annotated[
    list[str] | None,
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
Inputs = Annotated[
    list[str] | None, typer.Option("--input", help="Input; all by default; may be repeated.")
]
Outputs = Annotated[
    list[str] | None, typer.Option("--output", help="Output; all by default; may be repeated.")
]
Workers = Annotated[int, typer.Option("--workers", help="Processes; the result does not change.")]
NoSave = Annotated[bool, typer.Option("--no-save", help="Do not store the result.")]
SEARCH = 4.0  # equal to SEARCH of mbdlft.order.search, which is slow to import


def check_paths(archive: Path | None, figures: Sequence[tuple[str, Path]] = ()) -> None:
    """Raise an error if it is known before the work that one of the files cannot be written."""
    if archive is not None:
        from mbdlft.archive.archive import check_file

        check_file(archive)
    for _, file in figures:
        from mbdlft.show.figures.figures import check_figure

        check_figure(file)


def write_model(archive: Path, model: LFTModel) -> float:
    """Save a model; return the seconds that this took."""
    from mbdlft.archive.archive import save

    start = time.perf_counter()
    save(archive, model)
    return time.perf_counter() - start
