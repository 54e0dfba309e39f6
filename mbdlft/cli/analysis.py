"""The commands `margin`, `wcgain`, `worst`, `verify`: guarantees for a model, and their proofs."""

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from mbdlft.base.errors import AnalysisError
from mbdlft.cli.bounds import (
    Archive,
    AsJson,
    Controller,
    Gap,
    Inputs,
    LeaveOut,
    Model,
    NoSave,
    Outputs,
    Plot,
    Rate,
    Work,
    Workers,
    answer,
    loop_of,
    number,
)
from mbdlft.cli.progress import progress_of
from mbdlft.cli.response import chosen_channels
from mbdlft.cli.tables import console, print_json


class Property(StrEnum):
    """What `worst` looks for."""

    REAL_PART = "real-part"
    DAMPING = "damping"
    DISK_MARGIN = "disk-margin"
    H2_NORM = "h2-norm"


def margin(
    archive: Archive,
    controller: Controller = None,
    model: Model = None,
    gap: Gap = 0.01,
    work: Work = 30.0,
    rate: Rate = None,
    fixed: Annotated[
        list[str] | None,
        typer.Option(
            "--fixed", help="Parameter or block that stays in its range; may be repeated."
        ),
    ] = None,
    leave_out: LeaveOut = None,
    workers: Workers = 1,
    figure: Plot = None,
    no_save: NoSave = False,
    as_json: AsJson = False,
) -> None:
    """Bounds of the margin of robust stability, proved for all frequencies and values."""
    from mbdlft.robust.stability import robust_stability

    _check(figure)
    system = loop_of(archive, model, controller)
    asked = {"gap": gap, "work": work, "rates": _rates(rate), "leave_out": leave_out or ()}
    asked |= {"workers": workers, "fixed": fixed or ()}
    found = answer(archive, system, robust_stability, asked, store=not no_save, as_json=as_json)
    if figure is not None:
        from mbdlft.show.figures.mu import save_mu

        save_mu(figure, system, found, leave_out=leave_out or ())


def wcgain(
    archive: Archive,
    inputs: Inputs = None,
    outputs: Outputs = None,
    controller: Controller = None,
    model: Model = None,
    gap: Gap = 0.01,
    work: Work = 30.0,
    rate: Rate = None,
    leave_out: LeaveOut = None,
    workers: Workers = 1,
    figure: Plot = None,
    no_save: NoSave = False,
    as_json: AsJson = False,
) -> None:
    """Bounds of the largest gain over the declared ranges, proved for all frequencies and values."""
    from mbdlft.robust.gain import worst_case_gain

    _check(figure)
    system = loop_of(archive, model, controller)
    channels = {"inputs": inputs or slice(None), "outputs": outputs or slice(None)}
    asked = {"gap": gap, "work": work, "rates": _rates(rate), "leave_out": leave_out or ()}
    asked |= {"workers": workers}
    found = answer(
        archive, system, worst_case_gain, channels | asked, store=not no_save, as_json=as_json
    )
    if figure is not None:
        from mbdlft.show.figures.singular_values import save_singular_values

        bound = found.upper if found.proved else None
        shown = chosen_channels(system, outputs, inputs)
        save_singular_values(figure, shown, worst=found.worst or None, bound=bound)


def worst(
    archive: Archive,
    what: Annotated[Property, typer.Option("--of", help="What is to be bad.")],
    inputs: Inputs = None,
    outputs: Outputs = None,
    controller: Controller = None,
    model: Model = None,
    gap: Gap = 0.01,
    work: Work = 30.0,
    leave_out: LeaveOut = None,
    workers: Workers = 1,
    no_save: NoSave = False,
    as_json: AsJson = False,
) -> None:
    """The worst real part, damping, disk margin or H2 norm over the ranges, with proved bounds."""
    from mbdlft.robust.worst import worst_case

    system = loop_of(archive, model, controller)
    property_of = {"h2-norm": "H2 norm"}.get(what, what.replace("-", " "))
    asked: dict[str, Any] = {
        "what": property_of,
        "inputs": inputs or slice(None),
        "outputs": outputs or slice(None),
    }
    asked |= {"gap": gap, "work": work, "leave_out": leave_out or (), "workers": workers}
    answer(archive, system, worst_case, asked, store=not no_save, as_json=as_json)


def verify(archive: Archive, as_json: AsJson = False) -> None:
    """Check every stored proof again, without a search."""
    from mbdlft.archive.analysis import analysis_names, load_analysis
    from mbdlft.robust.proofs import verify as check

    names = analysis_names(archive)
    if not names:
        raise AnalysisError(
            f"{archive}: there is no analysis to be checked. `mbdlft margin` makes one."
        )
    found = []
    with progress_of(archive.stem) as progress:
        for count, name in enumerate(names):
            progress.counted(count, len(names))
            system, bounds = load_analysis(archive, name)
            start = time.perf_counter()
            wrong = check(system, bounds)
            seconds = time.perf_counter() - start
            found.append(
                {
                    "name": name,
                    "lower": number(bounds.lower),
                    "upper": number(bounds.upper),
                    "proved": not wrong,
                    "reason": wrong,
                    "seconds": seconds,
                }
            )
    if as_json:
        print_json(found)
    else:
        for entry in found:
            said = "proved" if entry["proved"] else f"NOT PROVED: {entry['reason']}"
            console().print(f"{entry['name']}: {said}", soft_wrap=True, highlight=False)
    if not all(entry["proved"] for entry in found):
        raise typer.Exit(1)


def _rates(texts: list[str] | None) -> dict[str, float]:
    """Bounds of rates by name, of texts NAME=BOUND."""
    found = {}
    for text in texts or ():
        name, _, bound = text.partition("=")
        try:
            found[name.strip()] = float(bound)
        except ValueError:
            raise AnalysisError(
                f"--rate {text}: expected NAME=BOUND, such as mass=0.1 or mass=inf."
            ) from None
    return found


def _check(figure: Path | None) -> None:
    """Raise an error if it is known before the work that a figure cannot be written."""
    if figure is not None:
        from mbdlft.show.figures.figures import check_figure

        check_figure(figure)
