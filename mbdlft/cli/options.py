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
