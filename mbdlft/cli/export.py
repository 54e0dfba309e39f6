"""The command `export`: it writes a model for MATLAB, Octave, C or Julia, or matrices on a grid."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbdlft.base.errors import AnalysisError
from mbdlft.cli.options import AsJson
from mbdlft.cli.source import ARCHIVES, load_model
from mbdlft.cli.tables import print_files

if TYPE_CHECKING:
    from mbdlft.export.grid import Counts


def export(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE[:MODEL]",
            help="Archive (HDF5), with :MODEL if it has several; or a scene or a matrix (TOML), to be "
            "linearized.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output",
            help="File to write: .mat (MATLAB, Octave), .c (C99), .jl (Julia); with --grid .mat, .csv, "
            ".npz.",
        ),
    ],
    grid: Annotated[
        list[str] | None,
        typer.Option(
            "--grid",
            help="State matrices at COUNT evenly spaced values of each parameter, or with NAME=COUNT of "
            "this one, which may be repeated; the others are nominal.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """Write a model for another tool, or its matrices on a grid."""
    from mbdlft.export.exports import check_suffix, export_model

    counts = _counts(grid)
    check_suffix(output, grid=counts is not None)
    file, name = _parts(source)
    model = load_model(file, name)
    archive = file if file.suffix.lower() in ARCHIVES else None
    files = export_model(output, model, counts, archive)
    print_files(*(("file", path) for path in files), as_json=as_json)


def _parts(text: str) -> tuple[Path, str | None]:
    """A file, and the name of a model behind a colon."""
    file, colon, name = text.rpartition(":")
    if colon and name and Path(file).suffix.lower() in ARCHIVES and not Path(text).exists():
        return Path(file), name
    return Path(text), None


def _counts(texts: list[str] | None) -> "Counts | None":
    """Numbers of values of the options --grid.

    Raises
    ------
    AnalysisError
        A text is neither a whole number nor NAME=COUNT, or there are both.
    """
    if not texts:
        return None
    found: dict[str, int] = {}
    for text in texts:
        name, equals, count = (part.strip() for part in text.rpartition("="))
        usable = count.isascii() and count.isdecimal() and len(count) < 10
        if not usable or bool(name) != bool(equals) or name in found:
            raise AnalysisError(
                f"--grid {text}: expected a whole number of values such as 5, or NAME=COUNT such as "
                "theta1=10, each name once."
            )
        found[name] = int(count)
    if "" in found and len(found) > 1:
        raise AnalysisError(
            "--grid: expected either one number for all parameters, or NAME=COUNT for some."
        )
    return found.get("", found)
