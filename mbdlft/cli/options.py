"""Options that several commands have, and what is known to be wrong with them before the work."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from mbdlft.base.errors import AnalysisError, MbdlftError, SceneError
from mbdlft.cli import rooms

SEARCH = 4.0  # equal to SEARCH of mbdlft.order.search, which is slow to import
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
Samples = Annotated[int, typer.Option("--samples", min=0, help="Number of random samples.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Of the samples.")]
Figure = Annotated[Path | None, typer.Option("-o", "--figure", help="Figure to draw, such as fig.png.")]
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
    Texts, typer.Option("--leave-out", help="State on which nothing else depends; may be repeated.")
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


def check_paths(archive: Path | None, *figures: Path | None) -> None:
    """Raise an error if it is known before the work that one of the files cannot be written."""
    if archive is not None:
        rooms.archive.check_file(archive)
    for figure in filter(None, figures):
        rooms.figures.check_figure(figure)


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
        name, equals, value = (part.strip() for part in text.partition("="))
        try:
            if not (name and equals):
                raise ValueError
            values[name] = value_of(value)
        except ValueError:
            raise error(f"{option} {text}: expected {expected}") from None
    return values


def numbers_by_name(option: str, texts: Iterable[str] | None, expected: str) -> dict[str, float]:
    """Numbers by name of an option of an analysis."""
    return by_name(option, texts, expected, float, AnalysisError)


def values_of(texts: Iterable[str] | None, known: str = "") -> dict[str, float]:
    """Values of parameters by name, of the options ``--set name=value``; `known` says which there are."""
    expected = "name=value with a number, such as m1=3.2. The unit is that of the parameter."
    return by_name("--set", texts, expected + known, float)
