"""The command `simulate`: motions of a scene of any size, beside those of its linear model."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from mbdlft import dae, pipeline, show
from mbdlft.base.errors import AnalysisError
from mbdlft.cli import options
from mbdlft.cli.output import print_files, print_json, print_table, write_text

if TYPE_CHECKING:
    from mbdlft.base.array import Array
    from mbdlft.dae import Simulation
    from mbdlft.multibody import Scene
    from mbdlft.system import LFTModel

_INPUT = (
    "NAME=number, held from the beginning; NAME=step:SIZE@TIME; or NAME=sine:SIZE:RATE with the rate in "
    "rad/s, such as shoulder.torque=step:1@0.5."
)


def simulate(
    scene_file: Annotated[Path, typer.Argument(help="Scene, a TOML file.")],
    assignments: options.Values = None,
    inputs: Annotated[
        options.Texts,
        typer.Option("--input", help="name=number, step:SIZE@TIME or sine:SIZE:RATE; may be repeated."),
    ] = None,
    initial: Annotated[
        options.Texts, typer.Option("--initial", help="state=number at the beginning; may be repeated.")
    ] = None,
    until: Annotated[float, typer.Option(help="Last time (s).")] = 10.0,
    steps: Annotated[int, typer.Option(min=1, help="Number of times after the first.")] = 400,
    amplitudes: Annotated[
        list[float] | None,
        typer.Option("--amplitude", help="Factor of inputs and initial states; may be repeated."),
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Figure of the outputs over time.")] = None,
    width: options.FigureWidth = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Table of times, states and outputs of the last run, as CSV."
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Simulate the motion of a scene, of any size, beside its linear model."""
    options.check_paths(None, plot)
    if not until > 0.0:
        raise AnalysisError(f"--until {until:g}: expected a positive time (s).")
    values, scene = options.values_of(assignments), options.scene_in(scene_file)
    times = np.linspace(0.0, until, steps + 1)
    of_time = options.by_name("--input", inputs, _INPUT, lambda text: _signal(text, times), AnalysisError)
    start = options.numbers_by_name("--initial", initial, "state=number, such as shoulder.angle=0.1.")
    factors = amplitudes or [1.0]
    model, rows = pipeline.to_lft(scene, search=0.0, prove=0.0), list[dict[str, float]]()
    curves: dict[str, Array] = {}
    for factor in factors:
        moved, begun = ({name: factor * x for name, x in each.items()} for each in (of_time, start))
        run, beside = _both(scene, model, times, inputs=moved, parameters=values, initial=begun)
        size, off = (float(np.max(np.abs(x), initial=0.0)) for x in (run.outputs, run.outputs - beside))
        rows.append({"amplitude": factor, "largest": size, "linear_error": off / size if size else 0.0})
        label = f" at {factor:g}" if len(factors) > 1 else ""
        curves |= {f"motion{label}": run.outputs, f"linear model{label}": beside}
    files: list[tuple[str, Path]] = []
    if plot is not None:
        signals = [next(s for s in model.outputs if s.name == name) for name in run.output_names]
        with options.on_paper(width):
            show.save_motions(plot, scene.name, times, signals, curves)
        files.append(("figure", plot))
    if output is not None:
        write_text(output, _table(run))
        files.append(("motion", output))
    if as_json:
        written = [str(file) for _, file in files]
        print_json({"name": scene.name, "until": until, "runs": rows, "files": written})
        return
    table = [(f"{r['amplitude']:g}", f"{r['largest']:.4g}", f"{r['linear_error']:.2g}") for r in rows]
    title = f"{scene.name}: outputs until {until:g} s"
    print_table(title, "amplitude > | largest > | linear model off by >", table)
    print_files(*files, as_json=False)


def _both(
    scene: "Scene", model: "LFTModel", times: "Array", **asked: Any
) -> tuple["Simulation", "Array"]:
    """The motion, and its outputs by the model; forces of constraints are of the model only."""
    run, linear = (dae.simulate(each, times, **asked) for each in (scene, model))
    return run, linear.outputs[:, [linear.output_names.index(name) for name in run.output_names]]


def _table(run: "Simulation") -> str:
    """Times, states and outputs as text with commas."""
    lines = [",".join(["time", *run.state_names, *run.output_names])]
    whole = np.column_stack([run.times, run.states, run.outputs])
    return "\n".join([*lines, *(",".join(f"{x:.17g}" for x in row) for row in whole)]) + "\n"


def _signal(text: str, times: "Array") -> "Array":
    """Values (N,) of an input at times; a ValueError if the text is none."""
    kind, colon, rest = text.partition(":")
    if not colon:
        return np.full(len(times), float(text))
    if kind == "step":
        size, _, begin = rest.partition("@")
        return np.where(times >= float(begin or 0.0), float(size), 0.0)
    if kind == "sine":
        height, rate = map(float, rest.split(":"))
        return np.asarray(height * np.sin(rate * times))
    raise ValueError(text)
