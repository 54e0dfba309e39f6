"""Modelica models on the command line: their report, and their linear model."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mbdlft.cli.tables import console, parameters_data, print_json
from mbdlft.cli.tables import table as new_table
from mbdlft.system.model import LFTModel

if TYPE_CHECKING:
    from mbdlft.dae import Dae
    from mbdlft.dae.trim import DaeTrim
    from mbdlft.modelica import ModelicaReport, ModelicaTable

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
