"""The command `poles`: damping table, transmission zeros, and what is known of stability."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbdlft.cli.output import console, print_json, progress_of, table
from mbdlft.cli.sources import load_system, point_of

if TYPE_CHECKING:
    from mbdlft.response.modes import ModeRow
    from mbdlft.robust.stability import StabilityVerdict
    from mbdlft.system.model import System

_SHORT = 8  # rows of the table that comes with a model


def poles(
    source: Annotated[
        Path,
        typer.Argument(help="Archive (HDF5), or a scene or a matrix (TOML), to be linearized."),
    ],
    model: Annotated[str | None, typer.Option(help="Model of an archive that has several.")] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", help="name=value in the unit of the parameter; may be repeated."),
    ] = None,
    samples: Annotated[
        int, typer.Option(min=0, help="Random samples, to look for unstable values.")
    ] = 300,
    seed: Annotated[int, typer.Option(min=0, help="Of the samples.")] = 0,
    prove: Annotated[
        float, typer.Option(min=0.0, help="Work (about seconds) for a proof of stability.")
    ] = 0.0,
    figure: Annotated[
        Path | None, typer.Option("-o", "--figure", help="Figure of the poles, such as fig.png.")
    ] = None,
    over: Annotated[
        str | None, typer.Option(help="Parameter over which the figure shows the poles.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Print poles with their damping, transmission zeros, and whether values make it unstable."""
    from mbdlft.response.modes import damping_table
    from mbdlft.response.staircase import zeros
    from mbdlft.robust.stability import check_stability

    if figure is not None:
        from mbdlft.show.figures.figures import check_figure

        check_figure(figure)
    system = load_system(source, model)
    point = point_of(system, assignments)
    found = damping_table(system, point)
    rows = found.rows()
    channels = bool(system.inputs and system.outputs)
    at_zero = zeros(system, point)[0].tolist() if channels else None
    with progress_of(system.name):
        verdict = check_stability(system, samples, seed, prove=prove)
    try:
        if as_json:
            said = _summary(system, point, rows, at_zero, verdict, found.stability())
            print_json(said)
        else:
            _print(system, point, rows, at_zero, verdict)
    finally:  # a figure that fails takes nothing away
        if figure is not None:
            from mbdlft.show.figures.pole_map import save_pole_map

            save_pole_map(figure, system, over, seed)
    if figure is not None and not as_json:
        console().print(f"figure: {figure}", soft_wrap=True)


def print_poles(system: "System") -> None:
    """Print a short table of the poles at nominal, and a line if it is not stable there."""
    from mbdlft.response.modes import damping_table

    if not system.states:
        return
    found = damping_table(system)
    rows = found.rows()
    _print_rows(rows, "poles at nominal", _SHORT)
    print_stability(found.stability(), rows)


def print_stability(stability: str, rows: "Sequence[ModeRow]") -> None:
    """A line if a system is not stable at nominal."""
    out = console()
    if stability == "unstable":
        growing = [row for row in rows if row.time_constant < 0.0 and not row.on_axis]
        fastest = max(growing, key=lambda row: row.pole.real)
        out.print(
            f"UNSTABLE at nominal: {len(growing)} of {len(rows)} modes grow, the fastest by e in "
            f"{-fastest.time_constant:.4g} s",
            highlight=False,
        )
    elif stability == "marginal":
        out.print("not asymptotically stable at nominal: poles are on the axis", highlight=False)


def poles_summary(system: "System") -> dict[str, object]:
    """Poles at nominal as plain data, for JSON."""
    from mbdlft.response.modes import damping_table

    found = damping_table(system)
    return {"poles": [_plain(row) for row in found.rows()], "stability": found.stability()}


def _print(
    system: "System",
    point: dict[str, float],
    rows: "Sequence[ModeRow]",
    found: list[complex] | None,
    verdict: "StabilityVerdict",
) -> None:
    """Tables and sentences."""
    out = console()
    where = ", ".join(f"{name} = {value:g}" for name, value in point.items()) or "nominal"
    if rows:
        _print_rows(rows, f"{system.name}: poles at {where}", None)
    else:
        out.print(f"{system.name}: no states, so no poles", highlight=False)
    if found:
        listed = ", ".join(_complex(z) for z in found if z.imag >= 0.0)
        out.print(f"transmission zeros ({len(found)}): {listed} rad/s", highlight=False)
    elif found is not None:
        out.print("transmission zeros: none")
    out.print(str(verdict), highlight=False)


def _print_rows(rows: "Sequence[ModeRow]", title: str, most: int | None) -> None:
    """A table of modes, equal ones in one row; the slowest ones if not all have room."""
    from mbdlft.response.modes import cells

    texts = Counter(tuple(cell.strip() for cell in cells(row)) for row in rows)
    rows_of_table = table(
        title, "pole (rad/s)", "natural (rad/s) >", "(Hz) >", "damping >", "time constant (s) >",
        "times >",
    )  # fmt: skip
    for k, (texts_of_row, count) in enumerate(texts.items()):
        if most is None or k < most:
            rows_of_table.add_row(*texts_of_row, str(count) if count > 1 else "")
    console().print(rows_of_table)
    if most is not None and len(texts) > most:
        console().print(f"and {len(texts) - most} faster ones: mbdlft poles lists all")


def _summary(
    system: "System",
    point: dict[str, float],
    rows: "Sequence[ModeRow]",
    found: list[complex] | None,
    verdict: "StabilityVerdict",
    stability: str,
) -> dict[str, object]:
    """Everything as plain data."""
    return {
        "name": system.name,
        "point": point,
        "poles": [_plain(row) for row in rows],
        "stability": stability,
        "zeros": None if found is None else [{"real": z.real, "imag": z.imag} for z in found],
        "verdict": {
            "sentence": str(verdict),
            "nominal": verdict.nominal,
            "counterexample": dict(verdict.counterexample) or None,
            "worst": dict(verdict.worst),
            "worst_pole": _pole(verdict.worst_pole),
            "points": verdict.points,
            "proved": bool(verdict.proof),
        },
    }


def _plain(row: "ModeRow") -> dict[str, Any]:
    """A row of the table as plain data; what is no number is null."""
    plain: dict[str, Any] = {"real": row.pole.real, "imag": row.pole.imag}
    for name in ("natural_frequency", "frequency", "damping", "time_constant"):
        value = getattr(row, name)
        plain[name] = value if math.isfinite(value) else None
    return {**plain, "on_axis": row.on_axis}


def _pole(pole: complex) -> dict[str, float] | None:
    return {"real": pole.real, "imag": pole.imag} if math.isfinite(pole.real) else None


def _complex(number: complex) -> str:
    """A real number, or a pair."""
    return f"{number.real:.6g}" + (f" +- {number.imag:.6g}j" if number.imag else "")
