"""Every scene and Modelica model of the scenarios folder: how small it is, how exact, how long it takes.

    python -m benchmarks.scenarios [--search SECONDS] [--write docs/scenarios.md]

Each row is verified before it is printed: the certificate compares the model with the nonlinear
equations, trimmed and linearized again, at nominal, random points and corners.
"""

import argparse
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path

import mbdlft
from benchmarks.arm import write_between
from mbdlft.modelica import ModelicaTable, load_modelica, load_modelica_table, operating_point
from mbdlft.pipeline.dae_models import delta_theta, linearize_dae
from mbdlft.pipeline.models import SEARCH, build

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Row:
    """One scene and its model."""

    name: str
    description: str
    states: int
    parameters: int
    order: int
    bound: int
    error: float
    seconds: float


def scenes() -> list[Path]:
    """Files of the scenes, those of matrices left out."""
    files = sorted((ROOT / "scenarios").glob("*.toml"))
    return [path for path in files if "mbdlft-matrix" not in path.read_text(encoding="utf-8")]


def measure(path: Path, search: float) -> Row:
    """Build one scene."""
    scene = mbdlft.load_scene(path)
    built = build(scene, search)
    certificate = built.model.certificate
    return Row(
        scene.name,
        scene.description,
        len(built.model.states),
        len(scene.parameters),
        built.model.order,
        certificate.order_bound,
        certificate.max_relative_error,
        sum(built.seconds.values()),
    )


def table(rows: list[Row]) -> str:
    """Rows as a table."""
    lines = [
        "| scene | what it shows | states | parameters | order | proved bound | gap | error | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        gap = "minimal" if r.order == r.bound else f"{100.0 * (r.order / r.bound - 1.0):.0f} %"
        lines.append(
            f"| `{r.name}` | {r.description} | {r.states} | {r.parameters} | {r.order} | {r.bound} | "
            f"{gap} | {r.error:.0e} | {r.seconds:.1f} |"
        )
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class ModelicaRow:
    """One Modelica model: its structure, its linear model and its nonlinear functions."""

    name: str
    description: str
    equations: int
    index: int
    states: int
    functions: int
    row: Row


def measure_modelica(path: Path, search: float) -> ModelicaRow:
    """Linearize one Modelica model at its equilibrium, and count its nonlinear functions."""
    start = time.perf_counter()
    file = path.with_suffix(".toml")
    asked = load_modelica_table(file) if file.exists() else ModelicaTable()
    dae, report = load_modelica(path, asked)
    point = operating_point(dae, report, asked)
    model = linearize_dae(point, search=search)
    certificate, seconds = model.certificate, time.perf_counter() - start
    return ModelicaRow(
        path.stem,
        dae.description,
        len(dae.equations),
        point.structure.index,
        len(point.structure.states),
        len(delta_theta(point.structure, search=0.0, prove=0.0).functions),
        Row(
            path.stem,
            dae.description,
            len(model.states),
            len(dae.parameters),
            model.order,
            certificate.order_bound,
            certificate.max_relative_error,
            seconds,
        ),
    )


def modelica_table(rows: list[ModelicaRow]) -> str:
    """Rows as a table."""
    lines = [
        "| Modelica model | what it shows | equations | index | states | functions | parameters | "
        "order | proved bound | error | seconds |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| `{m.name}` | {m.description} | {m.equations} | {m.index} | {m.states} | {m.functions} | "
        f"{m.row.parameters} | {m.row.order} | {m.row.bound} | {m.row.error:.0e} | {m.row.seconds:.1f} |"
        for m in rows
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table, or write it into a page between its marks."""
    parser = argparse.ArgumentParser(description=textwrap.dedent(__doc__ or ""))
    parser.add_argument("--search", type=float, default=SEARCH)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    models = sorted((ROOT / "scenarios" / "modelica").glob("*.mo"))
    text = table([measure(path, options.search) for path in scenes()])
    text += "\n" + modelica_table([measure_modelica(path, options.search) for path in models])
    if options.write is None:
        print(text)
        return
    write_between(options.write, text)


if __name__ == "__main__":
    main()
